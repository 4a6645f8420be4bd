"""`patu compare`: how well the model predicts a recording, and where it fails."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .options import (
    DEFAULT_CRANE,
    AnywayOption,
    CraneOption,
    EffectsOption,
    EngineOption,
    JsonOption,
    MapFileOption,
    MapOption,
    PerRecordingOption,
    RecordingsArgument,
    ReportOption,
    looked_at,
)
from .output import Printer, progress
from .outputs import Writes, saving
from .reading import load_checked, load_crane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from validation.comparison import Comparison

_SHOWN = 10
_PICTURES = ("where", "open_loop", "balances", "balances_by_work")


def command(
    recordings: RecordingsArgument,
    crane: CraneOption = DEFAULT_CRANE,
    engine: EngineOption = "semi-recursive",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Write pictures to this folder."),
        Writes(files=tuple(f"*{name}.png" for name in _PICTURES)),
    ] = None,
    report: ReportOption = None,
    per_recording: PerRecordingOption = None,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    json: JsonOption = None,
) -> None:
    """Compare the model with a measurement: how large the errors are, when they occur, which balance is violated.

    The simulated crane starts at the fitted start of the recording and then gets only the commands. A filter predicts
    each next sample. A smoother finds the flow into each chamber and the moment at each joint that the model lacks.
    Several recordings are compared one after the other; parameters named by --per-recording are fitted to each.
    """
    chosen = load_crane(crane, effects)
    measured = load_checked(
        recordings, chosen, mapping, map_file, anyway=anyway, needs=(engine, "semi-recursive", "filter", "fit")
    )
    from validation.comparison import compare_all

    with progress("Comparing") as step:
        results = compare_all(chosen, measured, engine, per_recording=per_recording or (), progress=step)
    from validation.reports import Examined, report_comparison

    options = looked_at(crane, effects, mapping, map_file, per_recording=per_recording, anyway=anyway)
    examined = Examined(measured, options=options)
    printer = Printer(json)
    for result in results:
        tell(printer, result)
    with saving(printer) as save:
        save.json(json, results[0].to_dict() if len(results) == 1 else {"recordings": [r.to_dict() for r in results]})
        save(output, partial(save_figures, results))
        save(report, partial(report_comparison, results, chosen, examined))


def tell(printer: Printer, result: Comparison) -> None:
    """Print the verdict, the tables and the worst places."""
    from validation.reports import ERROR_COLUMNS, balance_table, error_rows, filter_words

    printer.line(f"{result.recording} against {result.crane} on {result.engine}")
    if result.fitted:
        printer.line(f"  {result.fitted}")
    for note in result.notes:
        printer.line(f"note: {note}")
    printer.table("Open loop, start fitted", ERROR_COLUMNS, error_rows(result))
    printer.line(result.started)
    printer.line(filter_words(result))
    printer.table("What the balances lack, by kind of work (± 95 %)", *balance_table(result))
    if result.where:
        printer.table("Where the model fails, worst first", ("score", "where"), worst(result))
        if len(result.where) > _SHOWN:
            printer.line(f"… and {len(result.where) - _SHOWN} more; --json writes all.")
    printer.line(result.verdict)


def worst(result: Comparison, most: int = _SHOWN) -> list[tuple[str, str]]:
    """Return score and sentence of the worst places."""
    return [(f"{f.score:.1f}", f.text) for f in result.where[:most]]


def save_figures(results: Sequence[Comparison], folder: Path) -> list[Path]:
    """Write all pictures to a folder and return their paths."""
    from validation import plots

    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for result in results:
        prefix = f"{Path(result.recording).stem}_" if len(results) > 1 else ""
        for name, figure in result.figures().items():
            paths.append(folder / f"{prefix}{name}.png")
            plots.save(figure, paths[-1])
    return paths
