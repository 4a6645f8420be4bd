"""`patu improve`: compare, diagnose, add, until nothing more is justified."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

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
from .outputs import Writes, saving
from .reading import listed, load_crane, load_with_check

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from validation.improvement import Step


def command(
    recordings: RecordingsArgument,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.toml", help="Crane file to write."), Writes()],
    check: CheckOption = None,
    per_recording: PerRecordingOption = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    jobs: JobsOption = 2,
    scheduler: SchedulerOption = None,
    most: Annotated[int, typer.Option("--most", metavar="N", help="Largest number of effects to add.", min=1)] = 4,
    learn: Annotated[
        bool, typer.Option("--learn", help="Learn laws if named effects do not explain the recordings.")
    ] = False,
    plot: PlotOption = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Improve a crane file step by step on a recording. Errors are open-loop RMS, in units of the sensors' noise.

    Every accepted step is confirmed on the Exudyn engine. The crane file records what was added, from which recording
    and with what evidence; `patu remove` undoes it. Learned laws are a last resort: a named effect that later explains
    the data equally well replaces them.
    """
    chosen = load_crane(crane, effects)
    measured, other = load_with_check(
        recordings, check, chosen, mapping, map_file, anyway=anyway, needs=("exudyn", "semi-recursive", "filter", "fit")
    )
    from validation.improvement import improve
    from validation.reports import Examined, improved_own, report_improvement
    from validation.workers import scheduled

    printer = Printer(json)
    with progress("Improve") as done, scheduled(scheduler):
        result = improve(
            chosen, measured, other, per_recording=per_recording or (), jobs=jobs, most=most, learn=learn,
            told=lambda step: tell(printer, step), progress=lambda part, share: done(share, part),
        )  # fmt: skip
        own = improved_own(result, measured)
    from validation.plots import save as save_figure

    tell_own(printer, own)
    for note in result.notes:
        printer.line(f"note: {note}." if note in result.about else f"{note}.")
    printer.line(f"Left: {result.verdict}.")
    given = {"check": other.name if other else None, "most effects": most, "crane file written": str(output)}
    options = looked_at(crane, effects, mapping, map_file, check=check, per_recording=per_recording, anyway=anyway)
    examined = Examined(measured, other, options)
    with saving(printer) as save:
        save(output, result.crane.save, result.crane.to_toml())
        by_recording = {"recordings": own} if own else {}
        save.json(json, {"recording": listed(recordings)} | result.to_dict(output) | by_recording)
        save(plot, lambda path: save_figure(result.plot(), path))
        save(report, lambda path: report_improvement(result, path, given, examined, own))


def tell(printer: Printer, step: Step) -> None:
    """Print one step as soon as it is known."""
    name = "as given" if step.added is None else f"+ {step.added}"
    check = f", on the check recording {step.check_error:.3g}" if step.check_error == step.check_error else ""
    nis = f"mean NIS of a filter that trusts the model {step.nis_mean:.3g}"
    printer.line(f"{name}: error {step.error:.3g}{check}, {nis} — {step.text}.")


def tell_own(printer: Printer, own: Sequence[Mapping[str, Any]]) -> None:
    """Print what differs from recording to recording, as the last crane has it."""
    from validation.diagnosis import own_values

    if own:
        rows = [(entry["recording"], own_values(entry)) for entry in own]
        printer.table("By recording", ("recording", "own values"), rows)
