"""`patu improve`: compare, diagnose, add, until nothing more is justified."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from crane_exudyn.errors import CraneError

from .diagnose import JobsOption
from .options import (
    DEFAULT_CRANE,
    CheckOption,
    CraneOption,
    EffectsOption,
    JsonOption,
    MapOption,
    RecordingArgument,
    ReportOption,
    load_crane,
    load_recording,
)
from .output import Printer, announce_compilation, progress, write_json

if TYPE_CHECKING:
    from validation.improvement import Step


def command(
    recording: RecordingArgument,
    output: Annotated[Path, typer.Option("-o", "--output", metavar="NEW.toml", help="Crane file to write.")],
    check: CheckOption = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    jobs: JobsOption = 2,
    most: Annotated[int, typer.Option("--most", metavar="N", help="At most so many steps.", min=1)] = 4,
    plot: Annotated[Path | None, typer.Option("--plot", metavar="FILE", help="Picture of the falling error.")] = None,
    report: ReportOption = None,
    json: JsonOption = None,
) -> None:
    """Improve a crane file on a recording step by step; errors are open-loop, in units of the sensors' noise.

    Every accepted step is confirmed on the Exudyn engine. The crane file keeps what was added, from which recording and with
    which evidence; `patu remove` undoes it.
    """
    if not output.resolve().parent.is_dir():
        raise CraneError(
            f"{output}: the folder {output.resolve().parent} does not exist. Create it, or give another path."
        )
    chosen = load_crane(crane, effects)
    measured = load_recording(recording, mapping)
    other = None if check is None else load_recording(check, mapping)
    announce_compilation()
    from validation.improvement import improve

    printer = Printer(json)
    with progress("Improve") as done:
        result = improve(
            chosen, measured, other, jobs=jobs, most=most,
            told=lambda step: tell(printer, step), progress=lambda text, share: done(share),
        )  # fmt: skip
    result.crane.save(output)
    if plot is not None:
        from validation.plots import save

        save(result.plot(), plot)
    if report is not None:
        from validation.search.reports import report_improvement

        given = {"check": other.name if other else None, "most steps": most, "crane file written": str(output)}
        report_improvement(result, report, given)
    write_json(json, {"recording": str(recording)} | result.to_dict(output))
    for note in result.notes:
        printer.line(f"{note}.")
    printer.line(f"Left: {result.verdict}. Written: {output}")


def tell(printer: Printer, step: Step) -> None:
    """Print one step as soon as it is known."""
    name = "as given" if step.added is None else f"+ {step.added}"
    check = f", on the check recording {step.check_error:.3g}" if step.check_error == step.check_error else ""
    printer.line(f"{name}: error {step.error:.3g}{check}, NIS {step.nis_mean:.3g} — {step.text}.")
