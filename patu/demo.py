"""`patu demo`: the paper's experiment on the Exudyn engine, with its table, plots and a report."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .options import DEFAULT_CRANE, CraneOption, EffectsOption, EngineOption, JsonOption, load_crane
from .output import Printer, progress
from .outputs import Writes, saving

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from validation.paper import Case

MODEL_ERROR = 0.15


def command(
    output: Annotated[
        Path,
        typer.Option("-o", "--output", metavar="DIR", help="Folder for plots, states and report; made if missing."),
        Writes(files=("states.png", "errors.png", "states.csv", "report.html")),
    ] = Path("out/demo"),
    crane: CraneOption = DEFAULT_CRANE,
    engine: EngineOption = "exudyn",
    effects: EffectsOption = None,
    seed: Annotated[int, typer.Option("--seed", help="Of the sensors' noise.")] = 0,
    json: JsonOption = None,
) -> None:
    """Run the paper's experiment: a crane with true numbers, a model with wrong ones, and a filter that holds the model on the truth.

    The model has 15 % too much mass and inertia in its booms, a payload of 10 kg, shifted joints, 20 bar too much pump pressure
    and a wrong start. The filter sees two angles and two pressures, with noise, at 1 kHz for 25 s.
    """
    printer = Printer(json)
    begin = perf_counter()
    chosen = load_crane(crane, effects)
    from validation.paper import run_case

    printer.line(f"The paper's experiment on {chosen.name}, {engine} engine: 25 s at 1 kHz, 17 sigma points …")
    with progress("Filter") as done:
        case = run_case(MODEL_ERROR, engine=engine, seed=seed, crane=chosen, progress=done)
    seconds = perf_counter() - begin
    tell(printer, case, seconds)
    with saving(printer) as save:
        save(output, partial(write, case, seed))
        save.json(json, document(case, seconds))


def document(case: Case, seconds: float) -> dict[str, Any]:
    """Return the JSON result, shaped as that of `patu paper` with its one case."""
    return {"cases": [case.document()], "realtime_factor": case.realtime_factor, "seconds": seconds}


def rows(case: Case) -> list[tuple[object, ...]]:
    """Return the table: PN-RMSE in % of each state by the filter, as published, by the model alone; share inside 95 %."""
    from crane_exudyn.plots import shown

    published = case.published or {}
    filtered, alone, inside = case.pn_rmse, case.pn_rmse_open_loop, case.coverage
    return [(shown(s).symbol, filtered[s], published.get(s), alone[s], 100 * inside[s]) for s in filtered]


OWN_MEANS = (
    "This is the filter with the paper's own covariances. `patu paper` shows all cases of the paper, why these covariances cannot "
    "do better here, and how far the filter gets when it estimates along with the state what the model may be wrong about."
)
COLUMNS = ("state", "filter %", "published %", "model alone %", "inside 95 % interval, % of time")


def tell(printer: Printer, case: Case, seconds: float) -> None:
    """Print the table, and what to make of it."""
    printer.table("PN-RMSE: error in % of the state's range", COLUMNS, rows(case))
    printer.line(f"{verdict(case)} Filter at {case.realtime_factor:.2g} times real time; all in {seconds:.0f} s.")
    printer.line(OWN_MEANS)


def verdict(case: Case) -> str:
    """Return in one sentence how the filter compares with the published one."""

    published = case.published or {}
    better = [s for s, value in published.items() if case.pn_rmse[s] <= value]
    return f"{len(better)} of {len(published)} states are at or below the published error."


def write(case: Case, seed: int, folder: Path) -> list[Path]:
    """Write plots, states and report to `folder`, and return the files."""
    from validation import paper_figures, plots
    from validation.report import Picture, Table, write_report

    folder.mkdir(parents=True, exist_ok=True)
    figures = {"states.png": states_figure(case, columns=2), "errors.png": paper_figures.figure_7(case)}
    for name, figure in figures.items():
        plots.save(figure, folder / name)
    case.estimate.to_csv(folder / "states.csv")
    sections: list[tuple[str, list[Any]]] = [
        ("Errors", [Table(COLUMNS, rows(case), note="PN-RMSE: 100 RMSE / (max - min of the true state)."), OWN_MEANS]),
        ("States", [Picture(states_figure(case), "True states, the model without filter, and the estimate.")]),
        (
            "Errors and 95 % intervals",
            [Picture(figures["errors.png"], "Error of the estimate, over its 95 % interval.")],
        ),
    ]
    title = f"The paper's experiment on {case.experiment.crane.name}"
    parameters = {
        "crane": case.experiment.crane.name, "engine": case.engine, "tuning": case.tuning,
        "error of the booms' masses and inertias": f"{100 * case.model_error:g} %", "sensors": "z1, z4, p1, p4 at 1 kHz",
    }  # fmt: skip
    report = write_report(folder, title, verdict(case), sections, seed=seed, parameters=parameters)
    return [*(folder / name for name in figures), folder / "states.csv", report]


def states_figure(case: Case, columns: int = 1) -> Figure:
    """Return all eight states over time: true, model alone, estimated with 95 % interval; one column, or two for wide pages."""
    from validation import plots
    from validation.paper import STATES

    truth, alone = case.experiment.truth, case.open_loop
    low, high = case.estimate.interval()
    made = plots.figure(8 // columns, columns, height=1.25 if columns == 1 else 1.5, width=plots.WIDTH * columns**0.5)
    for i, (axes, name) in enumerate(zip(made.axes, STATES, strict=True)):
        lines = {"true": truth[:, i], "model alone": alone[:, i], "estimated": case.estimate.mean[:, i]}
        plots.draw_lines(axes, case.experiment.time, lines, channel=name, band=(low[:, i], high[:, i]))
    for axes in made.axes[-columns:]:
        axes.set_xlabel("time / s")
    made.align_ylabels()
    plots.legend_above(made, columns=4 if columns > 1 else 2)
    return made
