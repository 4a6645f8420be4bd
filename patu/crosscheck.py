"""`patu crosscheck`: the two engines against each other, quantity by quantity."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .compiling import compile_for
from .options import DEFAULT_CRANE, CraneOption, EffectsOption, JsonOption, ReportOption
from .output import Printer, progress
from .outputs import Writes, saving
from .reading import load_crane

if TYPE_CHECKING:
    from collections.abc import Sequence

    from validation.crosscheck import CrossCheck
    from validation.crosscheck_quantities import Quantity

_COLUMNS = ("quantity", "unit", "largest difference", "relative", "tolerance", "ok", "where; reason for the tolerance")


def command(
    crane: CraneOption = DEFAULT_CRANE,
    states: Annotated[
        int, typer.Option(min=10, help="Number of random states at which the quantities are compared.")
    ] = 200,
    seconds: Annotated[float, typer.Option(min=1.0, help="Length of the runs in s.")] = 25.0,
    quick: Annotated[bool, typer.Option("--quick", help="Only 50 states and runs of 6 s.")] = False,
    seed: Annotated[int, typer.Option(help="Seed of the random states, cranes and joystick inputs.")] = 1,
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Write pictures to this folder."),
        Writes(files=("crosscheck-*.png",)),
    ] = None,
    report: ReportOption = None,
    effects: EffectsOption = None,
    without: Annotated[
        list[str] | None,
        typer.Option(metavar="EFFECT", help="Effect to leave out, such as end_stop or end_stop@lift; repeatable."),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Compare the Exudyn engine with the semi-recursive one: every quantity, the static start, every effect,
    trajectories.

    The exit status is 1 if anything is out of its tolerance or could not be run. The first line out of tolerance is
    closest to the cause.
    """
    chosen = load_crane(crane, effects)
    from validation.crosscheck import crosscheck
    from validation.crosscheck_figures import save_figures

    if quick:
        states, seconds = min(states, 50), min(seconds, 6.0)
    compile_for("exudyn", "semi-recursive")
    with progress("Comparing the engines") as step:
        result = crosscheck(chosen, states=states, seconds=seconds, seed=seed, without=without or (), progress=step)
    printer = Printer(json)
    printer.table(
        f"Cross-check of {chosen.name}: Exudyn and semi-recursive", _COLUMNS, [_row(q) for q in result.quantities]
    )
    printer.line(verdict(result))
    with saving(printer) as save:
        save.json(json, result.to_dict())
        save(output, partial(save_figures, result))
        save(report, partial(_write_report, result, seed, states, seconds))
    raise typer.Exit(0 if result.ok else 1)


def verdict(result: CrossCheck) -> str:
    """Return the answer in one to three sentences."""
    count, unknown = len(result.quantities) - len(result.not_run), result.not_run
    said = [f"The engines agree in all {count} quantities{' that could be compared' * bool(unknown)}."]
    if result.failures:
        first = result.failures[0].name
        said = [f"The engines differ in {len(result.failures)} of {count} quantities, first in {first}: "
                f"{_names(result.failures)}."]  # fmt: skip
    if unknown:
        said.append(f"{len(unknown)} could not be run: {_names(unknown)}.")
    return " ".join(said)


def _names(quantities: Sequence[Quantity]) -> str:
    return "; ".join(q.name for q in quantities[:5]) + ("; …" if len(quantities) > 5 else "")


def _row(q: Quantity) -> tuple[object, ...]:
    why = f"{q.place}; {q.reason}" if q.place else q.reason
    if q.refused:
        return q.name, q.unit, "-", "-", "-", "not run", why
    return q.name, q.unit, f"{q.max_abs:.2e}", f"{q.relative:.1e}", f"{q.tolerance:.0e}", q.ok, why


def _write_report(result: CrossCheck, seed: int, states: int, seconds: float, directory: Path) -> Path:
    from validation.crosscheck_figures import by_name, figure_of
    from validation.report import Picture, Table, write_report

    pictures = [
        Picture(
            figure_of(result.layout, runs),
            f"{name}: both engines on top of each other, and their difference at each step",
        )
        for name, runs in by_name(result.runs).items()
    ]
    table = Table(
        _COLUMNS,
        [_row(q) for q in result.quantities],
        note="Relative tolerances refer to the largest value of the quantity.",
    )
    return write_report(
        directory, f"Cross-check of {result.crane}", verdict(result),
        [("Trajectories", pictures), ("Quantities", [table])],
        parameters={"crane": result.crane, "random states": states, "length of the runs / s": seconds}, seed=seed,
        mood="good" if result.ok else "bad",
    )  # fmt: skip
