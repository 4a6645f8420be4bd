"""`patu diagnose`: which physical effect is missing."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .options import (
    DEFAULT_CRANE,
    AnywayOption,
    CheckOption,
    CraneOption,
    EffectsOption,
    JobsOption,
    JsonOption,
    MapFileOption,
    MapOption,
    PerRecordingOption,
    PlotOption,
    RecordingsArgument,
    ReportOption,
    SchedulerOption,
    looked_at,
)
from .output import Printer, progress
from .outputs import saving
from .reading import listed, load_crane, load_with_check

if TYPE_CHECKING:
    from validation.diagnosis import Diagnosis


def command(
    recordings: RecordingsArgument,
    check: CheckOption = None,
    per_recording: PerRecordingOption = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    jobs: JobsOption = 2,
    scheduler: SchedulerOption = None,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Find which physical effect the model lacks.

    First the nominal parameters are fitted within their uncertainty. Then every effect at every place is tested, alone
    and in pairs. The result names the effects that the recording cannot separate, and says if no known effect explains
    it. Several recordings of one machine are fitted together; each has its own start, clocks and the parameters that
    --per-recording names.
    """
    chosen = load_crane(crane, effects)
    measured, other = load_with_check(
        recordings, check, chosen, mapping, map_file, anyway=anyway, needs=("semi-recursive", "filter", "fit")
    )
    from validation.diagnosis import diagnose
    from validation.workers import scheduled

    with progress("Diagnose") as done, scheduled(scheduler):
        result = diagnose(
            chosen,
            measured,
            other,
            per_recording=per_recording or (),
            jobs=jobs,
            progress=lambda part, share: done(share, part),
        )
    from validation.plots import save as save_figure
    from validation.reports import Examined, report_diagnosis

    options = looked_at(crane, effects, mapping, map_file, check=check, per_recording=per_recording, anyway=anyway)
    examined = Examined(measured, other, options)
    printer = Printer(json)
    tell(printer, result)
    if result.verdict == "unknown" and not result.misses_check:
        printer.line(f"Next step: {examined.command('learn')}   looks for a law that is not in the library")
    given = {"check": other.name if other else None, "own effects": listed(effects) or None}
    with saving(printer) as save:
        save.json(json, {"recording": listed(recordings), "crane": chosen.name} | result.to_dict())
        save(plot, lambda path: save_figure(result.plot(), path))
        save(report, lambda path: report_diagnosis(result, path, given, examined))


def tell(printer: Printer, d: Diagnosis) -> None:
    """Print verdict, candidates, parameters that moved, and what to do next."""
    from validation.diagnosis import own_values, sentence
    from validation.report import three_digits
    from validation.reports import interval_text

    printer.line(f"Verdict: {d.verdict} — {sentence(d)}.")
    printer.table(
        "Explanations, best first",
        ("explanation", "log evidence", "probability", "error / noise", "on check"),
        _rows(d),
    )
    if d.effects or d.verdict == "parameters":
        chosen = next((c for c in d.candidates if c.effects == d.effects), d.candidates[0])
        for name, p in chosen.parameters.items():
            in_si = f"{p['value']:.4g} {p['unit']}".strip()
            printer.line(f"  {name} = {interval_text(p)} (95 %; {in_si})")
    moved = list(d.parameters.items())[:6]
    if moved:
        printer.table(
            "Nominal parameters of the best fit" if d.nearest else "Nominal parameters that changed most",
            ("parameter", "value", "std", "nominal", "unit"),
            [(n, p["value"], p["std"], p["nominal"], p["unit"]) for n, p in moved],
        )
    if d.recordings:
        rows = [
            (r["recording"], three_digits(r["error_before"]), three_digits(r["error_after"]), own_values(r))
            for r in d.recordings
        ]
        printer.table("By recording", ("recording", "error before", "after", "own values"), rows)
    for entry in d.where[:5]:
        printer.line(f"  unexplained{' with these' if moved else ''}: {entry['text']}")
    for note in d.notes:
        printer.line(f"note: {note}")
    if d.next_manoeuvre:
        printer.line(f"Next: {d.next_manoeuvre}")
    printer.line(f"({d.seconds:.0f} s)")


def _rows(d: Diagnosis) -> list[tuple[object, ...]]:
    from validation.report import evidence_difference

    best = d.candidates[0].evidence if d.candidates else 0.0
    return [
        (c.name, evidence_difference(c.evidence, best), f"{c.probability:.3f}", *c.errors_after)
        for c in d.candidates[:8]
    ]
