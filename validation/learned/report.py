"""The report of what was learned: the answer first, then each curve."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from ..criteria import CRITERIA
from ..learning import Learned, sentence
from ..report import Mood, Part, Picture, Section, Table, three_digits, write_report
from .learned_law import LearnedLaw

_CAPTION = (
    "Each curve over the range that the recording visited, with its 95 % interval; the marks at the bottom show "
    "where it was. Outside this range the curve is not known; the model goes on with the named form, or straight."
)


def report_learned(found: Learned, directory: str | Path, given: Mapping[str, object] | None = None) -> Path:
    """Write the report and return its path; `given` are more parameters of the run, by name."""
    text = sentence(found).replace("->", "→")
    sections: list[Section] = []
    if found.laws:
        sections.append(("The curves", curve_parts(found)))
    tied = [
        f"{law.effect}: the recording cannot separate it from {', or '.join(law.tied_with)}."
        for law in found.laws
        if law.tied_with
    ]
    next_one = [f"Next: {found.next_manoeuvre}."] if found.next_manoeuvre else []
    remarks = [*tied, *next_one, *(f"{n[0].upper()}{n[1:].rstrip('.')}." for n in found.notes)]
    if remarks:
        sections.append(("Remarks", remarks))
    errors = Table(
        ("", "before", "after"),
        [
            ("learned from", three_digits(found.error_before), three_digits(found.error_after)),
            ("only predicted", three_digits(found.check_error_before), three_digits(found.check_error_after)),
        ],
        note="Open-loop RMS in units of the sensors' noise.",
    )
    sections.append(("Errors", [errors]))
    parameters = {"crane": found.given.name, "recording": found.recording} | dict(given or {})
    mood: Mood = "good" if found.laws and found.error_after < CRITERIA.left_level else "neutral"
    return write_report(
        directory,
        f"Learned from {found.recording}",
        f"{text[0].upper()}{text[1:]}.",
        sections,
        parameters=parameters,
        mood=mood,
    )


def curve_parts(found: Learned) -> list[Part]:
    """Return the picture of the curves that were learned, and their knots."""
    return [Picture(found.plot(), _CAPTION), *(_knots(law) for law in found.laws)]


def _knots(law: LearnedLaw) -> Table:
    note = f"{law.effect} over {law.over.replace('_', ' ')}" + (f": {law.resembles}" if law.resembles else "")
    return Table(*law.table(), note=note)
