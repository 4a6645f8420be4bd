"""`patu compare`: how well the model predicts a recording, and where it fails."""

from __future__ import annotations

from functools import partial
from math import isfinite
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
    load_crane,
    load_several,
)
from .output import Printer, progress
from .outputs import Writes, saving

if TYPE_CHECKING:
    from collections.abc import Sequence

    from validation.compare import Comparison
    from validation.report import Section

_COLUMNS = ("channel", "unit", "RMSE", "% of range", "bias", "noise", "error / noise", "R²", "whiteness p")
_SHOWN = 10
_CAPTIONS = {
    "where": "What fails when: time from left to right, channels (filter) and balances (smoother) from top to bottom, dark is bad.",
    "open_loop": "The crane started as the recording starts and then saw only the commands.",
    "balances": "Flow and moment that each balance lacks, with 95 % interval from the sensors' noise.",
    "balances_by_work": "The same, averaged over each kind of work.",
}


def command(
    recordings: RecordingsArgument,
    crane: CraneOption = DEFAULT_CRANE,
    engine: EngineOption = "semi-recursive",
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Write pictures there."),
        Writes(files=tuple(f"*{name}.png" for name in _CAPTIONS)),
    ] = None,
    report: ReportOption = None,
    per_recording: PerRecordingOption = None,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    anyway: AnywayOption = False,
    json: JsonOption = None,
) -> None:
    """Lay the model beside a measurement: how large the errors are, when they arise, which balance is violated.

    The crane starts as the recording starts (the start is fitted) and then sees only the commands; a filter predicts each next
    sample; a smoother finds the flow of each chamber and the moment of each joint that the model lacks. Several recordings are compared
    one after the other; what --per-recording names is fitted to each.
    """
    chosen = load_crane(crane, effects)
    measured = load_several(recordings, chosen, mapping, map_file, anyway=anyway)
    from validation.compare import compare_all

    with progress("Comparing", json) as step:
        results = compare_all(chosen, measured, engine, per_recording=per_recording or (), progress=step)
    printer = Printer(json)
    for result in results:
        tell(printer, result)
    with saving(printer) as save:
        save.json(json, results[0].to_dict() if len(results) == 1 else {"recordings": [r.to_dict() for r in results]})
        save(output, partial(save_figures, results))
        save(report, partial(write, results))


def tell(printer: Printer, result: Comparison) -> None:
    """Print the verdict, the tables and the worst places."""
    printer.line(f"{result.recording} against {result.crane} on {result.engine}")
    for note in result.notes:
        printer.line(f"note: {note}")
    printer.table("Open loop, start fitted", _COLUMNS, error_rows(result))
    printer.line(filter_words(result))
    printer.table("What the balances lack, by work done (± 95 %)", *balance_table(result))
    if result.where:
        printer.table("Where the model fails, worst first", ("score", "where"), worst(result))
        if len(result.where) > _SHOWN:
            printer.line(f"… and {len(result.where) - _SHOWN} more; --json gives all.")
    printer.line(result.verdict)


def error_rows(result: Comparison) -> list[tuple[object, ...]]:
    """Return the table of channels."""
    white = result.estimate.whiteness
    return [
        (n, c.unit, c.rmse, c.pn_rmse, c.bias, c.noise_std, c.error_over_noise, c.r2, white.get(n))
        for n, c in result.channels.items()
    ]


def filter_words(result: Comparison) -> str:
    """Return what the filter's innovations say."""
    low, high = result.nis_bounds
    word = "consistent with the model" if result.consistent else "NOT consistent with the model"
    return f"Filter that trusts the model: mean NIS {result.estimate.nis_mean:.3g}, expected {low:.3g} … {high:.3g}; {word}."


def balance_table(result: Comparison) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """Return columns and rows of what each balance lacks in each kind of work; a star marks what is clearly not zero."""
    from validation.findings import VIOLATED, people_unit, rounded

    equations = result.layout.equations
    units = [people_unit(e, result.layout) for e in equations]
    columns = ("work", *(f"{e} {unit}" for e, (unit, _) in zip(equations, units, strict=True)))
    rows = []
    for kind, mean, std in result.scores.by_kind():
        cells = [
            (rounded(m / factor, 1.96 * s / factor) + ("*" if abs(m) > VIOLATED * s else " "))
            if isfinite(s)
            else "unknown "
            for m, s, (_, factor) in zip(mean, std, units, strict=True)
        ]
        rows.append((kind, *cells))
    return columns, rows


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


def write(results: Sequence[Comparison], folder: Path) -> Path:
    """Write the report and return its path."""
    from validation.report import Mood, write_report

    first = results[0]
    several = len(results) > 1
    sections = [
        (f"{r.recording}: {title}" if several else title, parts) for r in results for title, parts in sections_of(r)
    ]
    names = ", ".join(r.recording for r in results)
    verdict = " ".join(f"{r.recording}: {r.verdict}" if several else r.verdict for r in results)
    mood: Mood = "good" if all(not r.where and r.error < 1.2 for r in results) else "bad"
    parameters = {
        "crane": first.crane, "recording": names, "engine": first.engine,
        "noise of the sensors": ", ".join(f"{n} {c.noise_std:.3g} {c.unit}" for n, c in first.channels.items()),
    }  # fmt: skip
    return write_report(folder, f"{names} against {first.crane}", verdict, sections, parameters=parameters, mood=mood)


def sections_of(result: Comparison) -> list[Section]:
    """Return what a report says of one recording."""
    from validation.report import Picture, Table

    pictures = {name: Picture(figure, _CAPTIONS[name]) for name, figure in result.figures().items()}
    columns, by_work = balance_table(result)
    headings = [c.replace("torque.", "moment at ").replace("flow.", "flow into ") for c in columns]
    return [
        ("Where the model fails", [pictures["where"], Table(("score", "where"), worst(result, 20))]),
        ("What the balances lack", [Table(headings, by_work), pictures["balances_by_work"], pictures["balances"]]),
        ("Open loop", [Table(_COLUMNS, error_rows(result)), pictures["open_loop"]]),
        ("Filter", [filter_words(result), *(f"Note: {note}." for note in result.notes)]),
    ]
