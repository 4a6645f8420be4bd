"""Reports of a diagnosis and of an improvement: the verdict first."""

from __future__ import annotations

from pathlib import Path

from ..diagnosis import Diagnosis, sentence
from ..improvement import Improvement
from ..report import Section, Table, write_report


def report_diagnosis(d: Diagnosis, directory: str | Path) -> Path:
    """Write the report of a diagnosis and return its path."""
    text = sentence(d)
    return write_report(
        directory, f"Diagnosis of {d.recording}", f"{text[0].upper()}{text[1:]}.", diagnosis_sections(d)
    )


def diagnosis_sections(d: Diagnosis) -> list[Section]:
    """Return the sections of a diagnosis."""
    weighed = Table(
        ("explanation", "log evidence", "probability", "error after", "check error after"),
        [
            (c.name, c.evidence - d.candidates[0].evidence, c.probability, c.error_after, c.check_error_after)
            for c in d.candidates
        ],
        note="Evidence is relative to the best. Errors are open-loop RMS in units of the sensors' noise.",
    )
    sections: list[Section] = [("What was weighed", [d.plot(), weighed])]
    effects = [(c.name, n, p["value"], p["std"], p["unit"]) for c in d.candidates[:3] for n, p in c.parameters.items()]
    if effects:
        sections.append(
            ("Parameters of the leading effects", [Table(("effect", "parameter", "value", "std", "unit"), effects)])
        )
    if d.parameters:
        rows = [(n, p["value"], p["std"], p["nominal"], p["unit"]) for n, p in d.parameters.items()]
        sections.append(
            ("Nominal parameters that moved", [Table(("parameter", "value", "std", "nominal", "unit"), rows)])
        )
    remarks = [*d.notes, *(w["text"] for w in d.where), *([f"Next: {d.next_manoeuvre}"] if d.next_manoeuvre else [])]
    if remarks:
        sections.append(("Remarks", remarks))
    return sections


def report_improvement(result: Improvement, directory: str | Path) -> Path:
    """Write the report of an improvement and return its path."""
    rows = [(s.added or "as given", s.error, s.check_error, s.nis_mean, s.text) for s in result.steps]
    table = Table(("added", "error", "check error", "NIS", "what was found"), rows)
    sections: list[Section] = [("Step by step", [result.plot(), table])]
    for i, d in enumerate(result.diagnoses):
        sections += [(f"Diagnosis {i + 1}: {title}", parts) for title, parts in diagnosis_sections(d)]
    first, last = result.steps[0].error, result.steps[-1].error
    verdict = f"The error falls from {first:.3g} to {last:.3g} times the noise; what is left: {result.verdict}."
    return write_report(directory, f"Improvement on {result.recording}", verdict, sections)
