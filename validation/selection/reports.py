"""Reports of a diagnosis and of an improvement: the verdict first."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from ..diagnosis import Candidate, Diagnosis, own_values, sentence
from ..improvement import Improvement
from ..report import Mood, Picture, Section, Table, write_report
from .plots import in_words

_MOODS: Mapping[str, Mood] = {"adequate": "good", "unknown": "bad"}


def report_diagnosis(d: Diagnosis, directory: str | Path, given: Mapping[str, object] | None = None) -> Path:
    """Write the report of a diagnosis and return its path; `given` are more parameters of the run, by name."""
    parameters = {"crane": d.given.name, "recording": d.recording} | dict(given or {})
    mood = _MOODS.get(d.verdict, "neutral")
    return write_report(
        directory, f"Diagnosis of {d.recording}", verdict(d), diagnosis_sections(d), parameters=parameters, mood=mood
    )


def verdict(d: Diagnosis) -> str:
    """Return the verdict in one or two sentences, effects named in words and by their keys."""
    if not d.effects:
        text = sentence(d).replace("->", "→")
        return f"{text[0].upper()}{text[1:]}."
    named = " and ".join(in_words(e) for e in d.effects)
    fall = f"the open-loop error falls from {d.error_before:.3g} to {d.error_after:.3g} times the sensors' noise"
    keys = ", ".join(f"`{e}`" for e in d.effects)
    if d.verdict == "tied":
        others = " or ".join(in_words(e) for e in d.tied_with)
        text = f"{named} is missing, or {others}: this recording cannot tell ({fall}; {keys})."
    else:
        text = f"{named} is missing ({keys}): {fall}."
    return text[0].upper() + text[1:]


def diagnosis_sections(d: Diagnosis) -> list[Section]:
    """Return the sections of a diagnosis."""
    weighed = Table(
        ("explanation", "log evidence", "probability", "error", "on check"),
        [
            (
                in_words(c.name),
                round(c.evidence - d.candidates[0].evidence, 1),
                _share(c.probability),
                c.error_after,
                c.check_error_after,
            )
            for c in d.candidates
        ],
        note="Evidence is relative to the best. Errors are open-loop RMS in units of the sensors' noise.",
    )
    caption = (
        "How much likelier than moved parameters alone each explanation makes the recording (in full colour what was chosen), "
        "and the error before and after."
    )
    sections: list[Section] = [("What was weighed", [Picture(d.plot(), caption), weighed])]
    effects = [row for c in d.candidates[:3] for row in _parameter_rows(c)]
    if effects:
        columns = ("parameter", "value", "± (95 %)", "unit")
        sections.append(("Parameters of the leading effects", [Table(columns, effects)]))
    if d.parameters:
        rows = [(n, p["value"], 1.96 * p["std"], p["nominal"], p["unit"]) for n, p in d.parameters.items()]
        wide = ("parameter", "value", "± (95 %)", "nominal", "unit")
        sections.append(("Nominal parameters that moved", [Table(wide, rows)]))
    if d.recordings:
        each = [(r["recording"], r["error_before"], r["error_after"], own_values(r)) for r in d.recordings]
        sections.append(("By recording", [Table(("recording", "error before", "after", "its own"), each)]))
    remarks = [*d.notes, *(w["text"] for w in d.where), *([f"Next: {d.next_manoeuvre}"] if d.next_manoeuvre else [])]
    if remarks:
        sections.append(("Remarks", [f"{r[0].upper()}{r[1:].rstrip('.')}." for r in remarks]))
    return sections


def _share(probability: float) -> str:
    return "< 0.001" if probability < 1e-3 else f"{probability:.3f}"


def _parameter_rows(c: Candidate) -> list[tuple[object, ...]]:
    return [
        (f"{in_words(c.name)}: {n}", p["value"], 1.96 * p["std"], p["unit"] or "–") for n, p in c.parameters.items()
    ]


def report_improvement(result: Improvement, directory: str | Path, given: Mapping[str, object] | None = None) -> Path:
    """Write the report of an improvement and return its path; `given` are more parameters of the run, by name."""
    rows = [(in_words(s.added or "as given"), s.error, s.check_error, s.nis_mean, s.text) for s in result.steps]
    table = Table(("step", "error", "on check", "NIS", "what was found"), rows)
    caption = "Open-loop error on the Exudyn engine after each step, in units of the sensors' noise."
    sections: list[Section] = [("Step by step", [Picture(result.plot(), caption), table])]
    for i, d in enumerate(result.diagnoses):
        sections += [(f"Diagnosis {i + 1}: {title}", parts) for title, parts in diagnosis_sections(d)]
    parameters = {"crane": result.diagnoses[0].given.name, "recording": result.recording} | dict(given or {})
    mood = _MOODS.get(result.verdict, "neutral")
    title = f"Improvement on {result.recording}"
    return write_report(directory, title, _outcome(result), sections, parameters=parameters, mood=mood)


def _outcome(result: Improvement) -> str:
    """Return in one or two sentences what was added, what that did, and what is left."""
    first, last = result.steps[0], result.steps[-1]
    added = [in_words(s.added) for s in result.steps if s.added]
    left = (
        "Nothing is left that noise does not explain." if result.verdict == "adequate" else f"Left: {result.verdict}."
    )
    if not added:
        return f"Nothing was added; the open-loop error is {first.error:.3g} times the sensors' noise. {left}"
    check = "" if math.isnan(last.check_error) else f", on the check recording to {last.check_error:.3g}"
    return (
        f"With {' and '.join(added)} the open-loop error falls from {first.error:.3g} to {last.error:.3g} times the "
        f"sensors' noise{check}. {left}"
    )
