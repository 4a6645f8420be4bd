"""`patu compare`: how well the model predicts a recording, and where it fails."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    DEFAULT_CRANE,
    CraneOption,
    EffectsOption,
    EngineOption,
    JsonOption,
    MapOption,
    RecordingArgument,
    ReportOption,
    load_crane,
    load_recording,
)
from .output import Printer, announce_compilation, progress, write_json

if TYPE_CHECKING:
    from validation.compare import Comparison

_COLUMNS = ("channel", "unit", "RMSE", "% of range", "bias", "noise", "error / noise", "R²", "whiteness p")
_SHOWN = 10


def command(
    recording: RecordingArgument,
    crane: CraneOption = DEFAULT_CRANE,
    engine: EngineOption = "semi-recursive",
    output: Annotated[Path | None, typer.Option("-o", "--output", metavar="DIR", help="Write pictures there.")] = None,
    report: ReportOption = None,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    json: JsonOption = None,
) -> None:
    """Lay the model beside a measurement: how large the errors are, when they arise, which balance is violated.

    The crane starts as the recording starts (the start is fitted) and then sees only the commands; a filter predicts each next
    sample; a smoother finds the flow of each chamber and the moment of each joint that the model lacks.
    """
    chosen = load_crane(crane, effects)
    measured = load_recording(recording, mapping)
    announce_compilation()
    from validation.compare import compare

    with progress("Comparing", json) as step:
        result = compare(chosen, measured, engine, progress=step)
    write_json(json, result.to_dict())
    tell(Printer(json), result)


def tell(printer: Printer, result: Comparison) -> None:
    """Print the tables and the sentences."""
    printer.line(f"{result.recording} against {result.crane} on {result.engine}")
    for note in result.notes:
        printer.line(f"note: {note}")
    white = result.estimate.whiteness
    rows = [
        (n, c.unit, c.rmse, c.pn_rmse, c.bias, c.noise_std, c.error_over_noise, c.r2, white.get(n))
        for n, c in result.channels.items()
    ]
    printer.table("Open loop, start fitted", _COLUMNS, rows)
    low, high = result.estimate.nis_bounds
    word = "consistent" if result.estimate.consistent else "not consistent"
    printer.line(f"Filter: mean NIS {result.estimate.nis_mean:.3g}, expected {low:.3g} … {high:.3g}: {word}.")
    for finding in result.where[:_SHOWN]:
        printer.line(f"  {finding.score:6.1f}  {finding.text}")
