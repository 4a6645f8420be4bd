"""`patu improve`: compare, diagnose, add, until nothing more is justified."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

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
    RecordingsArgument,
    ReportOption,
    SchedulerOption,
    picture,
)
from .output import Printer, progress
from .outputs import Writes, saving
from .reading import listed, load_crane, load_with_check

if TYPE_CHECKING:
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
    most: Annotated[int, typer.Option("--most", metavar="N", help="At most so many effects.", min=1)] = 4,
    learn: Annotated[
        bool, typer.Option("--learn", help="Learn laws where named effects do not explain the recordings.")
    ] = False,
    plot: Annotated[
        Path | None, typer.Option("--plot", metavar="FILE", help="Picture of the falling error."), Writes(picture)
    ] = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Improve a crane file on a recording step by step; errors are open-loop, in units of the sensors' noise.

    Every accepted step is confirmed on the Exudyn engine. The crane file keeps what was added, from which recording and
    with which evidence; `patu remove` undoes it. Learned laws are a last resort: a named effect that does as well later
    replaces them.
    """
    chosen = load_crane(crane, effects)
    measured, other = load_with_check(
        recordings, check, chosen, mapping, map_file, anyway=anyway, needs=("exudyn", "semi-recursive", "filter", "fit")
    )
    from validation.improvement import improve
    from validation.workers import scheduled

    printer = Printer(json)
    with progress("Improve") as done, scheduled(scheduler):
        result = improve(
            chosen, measured, other, per_recording=per_recording or (), jobs=jobs, most=most, learn=learn,
            told=lambda step: tell(printer, step), progress=lambda part, share: done(share, part),
        )  # fmt: skip
    from validation.plots import save as save_figure
    from validation.reports import Examined, report_improvement

    for note in result.notes:
        printer.line(f"{note}.")
    printer.line(f"Left: {result.verdict}.")
    given = {"check": other.name if other else None, "most effects": most, "crane file written": str(output)}
    with saving(printer) as save:
        save(output, result.crane.save, result.crane.to_toml())
        save.json(json, {"recording": listed(recordings)} | result.to_dict(output))
        save(plot, lambda path: save_figure(result.plot(), path))
        save(report, lambda path: report_improvement(result, path, given, Examined(measured, other)))


def tell(printer: Printer, step: Step) -> None:
    """Print one step as soon as it is known."""
    name = "as given" if step.added is None else f"+ {step.added}"
    check = f", on the check recording {step.check_error:.3g}" if step.check_error == step.check_error else ""
    nis = f"mean NIS of a filter that trusts it {step.nis_mean:.3g}"
    printer.line(f"{name}: error {step.error:.3g}{check}, {nis} — {step.text}.")
