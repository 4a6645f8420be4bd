"""`patu paper`: the paper's tables and figures, by the paper's tuning and by the estimator's own."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from .compiling import compile_for
from .options import DEFAULT_CRANE, CraneOption, EffectsOption, EngineOption, JobsOption, JsonOption
from .output import Printer, progress
from .outputs import Writes, saving
from .reading import load_crane

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from validation.filters import Row
    from validation.paper import Case, Reproduction, SensorSetResult


FolderOption = Annotated[
    Path,
    typer.Option(
        "-o", "--output", "--report", metavar="DIR", help="Folder for figures and report; created if missing."
    ),
    Writes(files=("figure[567]_*.png", "report.html")),
]
ErrorsOption = Annotated[
    list[float] | None,
    typer.Option(
        "--error", metavar="SHARE", help="Only this relative error of the booms' masses, such as 0.15; repeatable."
    ),
]
InputsOption = Annotated[
    list[int] | None, typer.Option("--inputs", metavar="1|2|3", help="Only this input set; repeatable.")
]
TuningOption = Annotated[
    list[str] | None,
    typer.Option(
        "--tuning",
        metavar="NAME",
        help="Only this row: paper, paper-0.15-bar, own, own-file, own-half, own-twice; repeatable.",
    ),
]
SensorsOption = Annotated[
    list[str] | None,
    typer.Option("--sensors", metavar="CHANNEL …", help="Sensors of the filter instead of z1 z4 p1 p4."),
]
NoiseOption = Annotated[
    list[str] | None,
    typer.Option("--sensor-noise", metavar="CHANNEL=STD[UNIT] …", help="Noise of a sensor, such as 'p1=0.15[bar]'."),
]
SeedOption = Annotated[int, typer.Option("--seed", help="Seed of the sensors' noise.")]
FiltersOption = Annotated[
    bool,
    typer.Option("--filters", help="Also compare UKF, square root, cubature, simplex and EKF on the 15 % case."),
]
SensorSetsOption = Annotated[
    bool, typer.Option("--what-sensors-tell", help="Also estimate the payload with more and more sensors.")
]


def command(
    output: FolderOption = Path("out/paper"),
    engine: EngineOption = "exudyn",
    model_error: ErrorsOption = None,
    inputs: InputsOption = None,
    tuning: TuningOption = None,
    sensors: SensorsOption = None,
    noise: NoiseOption = None,
    seed: SeedOption = 0,
    jobs: JobsOption = 1,
    filters: FiltersOption = False,
    what_sensors_tell: SensorSetsOption = False,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    json: JsonOption = None,
) -> None:
    """Reproduce the paper: 5, 15 and 25 % model error, three input sets, table, Figures 5, 6 and 7.

    The first rows use exactly the paper's covariances; the next use pressure sensors with a noise of 0.15 bar. The rows
    "own" estimate payload, pump pressure, masses and joint coordinates together with the state, with at least the
    uncertainty that the crane file states. Published rows and the model without a filter are shown for comparison.
    """
    chosen = load_crane(crane, effects)
    _check(chosen, model_error, inputs, tuning)
    seen, shown = _seen(sensors, noise, chosen)
    compile_for(engine, "semi-recursive", "filter")
    found = Found(
        _reproduced(model_error, inputs, tuning, engine=engine, seed=seed, crane=chosen, jobs=jobs, **seen),
        _compare(engine, seed, chosen) if filters else [],
        _what_sensors_tell(engine, seed, chosen, jobs) if what_sensors_tell else [],
        shown,
    )
    printer = Printer(json)
    tell(printer, found)
    with saving(printer) as save:
        save(output, partial(write, found, seed, engine, chosen))
        save.json(json, found.document())


@dataclass(frozen=True)
class Found:
    """The cases, and what was asked for beside them: filters compared, and what sensors tell; the sensors in words, by
    their channels.
    """

    cases: Reproduction
    compared: list[Row]
    sensor_sets: list[SensorSetResult]
    sensors: dict[str, str]

    @property
    def words(self) -> str:
        """The sensors with their noise, as one text."""
        return ", ".join(self.sensors.values())

    def document(self) -> dict[str, Any]:
        """Return all of it as JSON."""
        more: dict[str, Sequence[Row | SensorSetResult]] = {
            "filters": self.compared,
            "what_sensors_tell": self.sensor_sets,
        }
        return self.cases.document() | {name: [r.document() for r in rows] for name, rows in more.items() if rows}

    def tables(self) -> list[tuple[str, tuple[str, ...], list[tuple[object, ...]]]]:
        """Return title, columns and rows of every table."""
        tables = [
            ("PN-RMSE in % of the state's range", COLUMNS, rows(self.cases)),
            (
                f"Inside the 95 % interval, % of the time; NEES (8 expected), NIS ({len(self.sensors)} expected)",
                COVERAGE_COLUMNS,
                coverage_rows(self.cases),
            ),
            ("Filters on the 15 % case, PN-RMSE in % and cost of a step", FILTER_COLUMNS, filter_rows(self.compared)),
            (
                "Payload estimated in the 15 % case, kg ± one standard deviation; PN-RMSE in %",
                SENSOR_SET_COLUMNS,
                sensor_set_rows(self.sensor_sets),
            ),
        ]
        return [table for table in tables if table[2]]


def _seen(sensors: list[str] | None, noise: list[str] | None, crane: Crane) -> tuple[dict[str, Any], dict[str, str]]:
    """Return the sensors that the filter gets, and their noise where it is not the paper's, as keywords; and the noise
    of each in words.
    """
    from validation.paper import SENSOR_STD, sensors_of
    from validation.report import amount

    own, channels, units = _noise(noise, crane), tuple(sensors or SENSOR_STD), crane.layout.sensors
    used = sensors_of(channels, own, crane.layout)
    shown = {name: f"{name} ± {amount(std, units[name].unit)}" for name, std in used.items()}
    return {"sensors": channels, "noise": own}, shown


def _reproduced(
    errors: list[float] | None, inputs: list[int] | None, tunings: list[str] | None, **seen: Any
) -> Reproduction:
    from validation.paper import INPUT_SETS, MODEL_ERRORS, ROWS, reproduce

    chosen = tuple(errors or MODEL_ERRORS), tuple(inputs or INPUT_SETS)
    with progress("Cases") as done:
        return reproduce(*chosen, tunings=tuple(tunings or ROWS), progress=done, **seen)


def _compare(engine: str, seed: int, crane: Crane) -> list[Row]:
    from validation.filters import compare_filters

    with progress("Filters") as done:
        return compare_filters(engine, seed=seed, crane=crane, progress=done)


def _what_sensors_tell(engine: str, seed: int, crane: Crane, jobs: int) -> list[SensorSetResult]:
    from validation.paper import what_sensors_tell

    with progress("Sensors") as done:
        return what_sensors_tell(engine, seed, crane=crane, jobs=jobs, progress=done)


def _noise(entries: list[str] | None, crane: Crane) -> dict[str, float]:
    """Return {channel: noise in SI} of entries such as "p1=0.15[bar]"."""
    from crane_exudyn.sensors import sensor
    from crane_exudyn.units import to_si

    found = {}
    for entry in entries or ():
        name, _, rest = entry.partition("=")
        value, _, unit = rest.partition("[")
        si = sensor(name, crane.layout.sensors).unit
        found[name] = to_si(f"{value} {unit.removesuffix(']')}", si, f"--sensor-noise {entry}")
    return found


SENSOR_SET_COLUMNS = ("sensors", "at 5 s", "at 10 s", "at 25 s", "p2", "p3")


def sensor_set_rows(results: list[SensorSetResult]) -> list[tuple[object, ...]]:
    """Return the payload at some instants and the errors of the two pressures that the paper does not measure, by
    sensors.
    """
    return [
        (" ".join(r.sensors), *(f"{m:.1f} ± {s:.1f}" for m, s in r.payload), r.pn_rmse["p2"], r.pn_rmse["p3"])
        for r in results
    ]


FILTER_COLUMNS = (
    "filter",
    "tuning",
    "z1",
    "z4",
    "ż1",
    "ż4",
    "p1",
    "p2",
    "p3",
    "p4",
    "NEES",
    "NIS",
    "states/step",
    "engine µs",
    "algebra µs",
)


def filter_rows(compared: list[Row]) -> list[tuple[object, ...]]:
    """Return PN-RMSE in %, NEES, NIS and cost of a step of every filter."""
    return [
        (
            r.method,
            r.tuning,
            *r.pn_rmse.values(),
            round(r.nees_mean, 2),
            round(r.nis_mean, 3),
            round(r.states_per_step),
            round(r.engine_us),
            round(r.algebra_us),
        )
        for r in compared
    ]


def _check(crane: Crane, errors: list[float] | None, inputs: list[int] | None, tunings: list[str] | None) -> None:
    from validation.paper import check_error, check_inputs, check_machine, tuning_of

    check_machine(crane)
    for error in errors or ():
        check_error(error)
    for i in inputs or ():
        check_inputs(i)
    for name in tunings or ():
        tuning_of(name)


_CAPTIONS = (
    "As Figure 5 of the paper: angles and rates, 15 % case, input set 1.",
    "As Figure 6: pressures.",
    "As Figure 7: error of each estimate, and its 95 % interval.",
)
COLUMNS = ("error", "inputs", "row", "z1", "z4", "ż1", "ż4", "p1", "p2", "p3", "p4")


def rows(result: Reproduction) -> list[tuple[object, ...]]:
    """Return the table of PN-RMSE in %: filter by tuning, published, model alone; errors in %."""
    out: list[tuple[object, ...]] = []
    begun = set()
    for d in sorted(result.documents, key=lambda d: (d["inputs"], d["model_error"])):
        case = (f"{100 * d['model_error']:g} %", d["inputs"])
        if case not in begun:
            begun.add(case)
            if d["published"]:
                out.append((*case, "published", *d["published"].values()))
            out.append((*case, "model alone", *d["pn_rmse_open_loop"].values()))
        out.append((*case, f"filter, {d['tuning']}", *_shown(d)))
    return out


def _shown(document: Mapping[str, Any]) -> list[object]:
    """Return PN-RMSE by state; the RMSE of a state whose range is too small to divide by."""
    errors = zip(document["pn_rmse"].items(), document["rmse"].values(), strict=True)
    return [
        value if value is not None else f"{_small(state, rmse)}, range too small" for (state, value), rmse in errors
    ]


def _small(state: str, rmse: float) -> str:
    return (
        f"{rmse / 1e5:.2g} bar" if state.startswith("p") else f"{math.degrees(rmse):.2g}°{'/s' * state.startswith('d')}"
    )


def coverage_rows(result: Reproduction) -> list[tuple[object, ...]]:
    """Return shares of time in % inside the 95 % interval, NEES and NIS."""
    return [
        (
            f"{100 * d['model_error']:g} %",
            d["inputs"],
            d["tuning"],
            *(round(100 * v, 1) for v in d["coverage95"].values()),
            round(d["nees_mean"], 2),
            round(d["nis_mean"], 3),
        )
        for d in result.documents
    ]


COVERAGE_COLUMNS = (*COLUMNS[:2], "tuning", *COLUMNS[3:], "NEES", "NIS")


def tell(printer: Printer, found: Found) -> None:
    """Print the tables, and what they say."""
    for table in found.tables():
        printer.table(*table)
    printer.line(f"Sensors, except where a row says otherwise: {found.words}.")
    for line in findings(found.cases):
        printer.line(line)
    printer.line(f"Time of the cases above: {found.cases.seconds:.0f} s.")


def findings(result: Reproduction) -> list[str]:
    """Return in words what came out: goals met by which tuning, why not by the other, what was found on the way."""
    from validation.paper import TUNINGS

    lines = []
    for name, case in result.shown.items():
        better = [s for s, v in (case.published or {}).items() if case.pn_rmse[s] <= v]
        inside = [s for s, v in case.coverage.items() if v >= 0.9]
        lines.append(
            f"15 % case, {TUNINGS[name].text}: {len(better)} of 8 states at or below the published error, "
            f"{len(inside)} of 8 inside "
            f"their intervals at least 90 % of the time; {case.realtime_factor:.2g} times real time ({case.engine})."
        )
    if "paper" in result.shown:
        lines += _why(result.shown["paper"])
    if "own" in result.shown:
        lines.append(_found(result.shown["own"]))
    if not result.shown:
        lines.append("Figures are drawn only for the 15 % case with the first input set (--error 0.15 --inputs 1).")
    return lines


def _why(case: Case) -> list[str]:
    """Return in words what the gauges' noise alone leaves of each measured pressure."""
    from validation.paper import STATES, pressure_floor

    parts = []
    for name, std in case.experiment.sensors.items():
        if name in STATES[4:]:
            floor, span = pressure_floor(std), float(np.ptp(case.experiment.truth[:, STATES.index(name)]))
            parts.append(f"{floor / 1e5:.2f} bar in {name} ({100 * floor / span:.2f} % of its range)")
    if not parts:
        return []
    return [
        "Lower limit of the error with the paper's tuning: its process noise lets each pressure vary by 1.6 bar per "
        f"millisecond, so the filter hardly averages. The sensors' noise alone causes {', '.join(parts)}, however good "
        "the model is."
    ]


def _found(case: Case) -> str:
    payload = case.estimate["payload.mass"][-1]
    true = case.experiment.crane["payload.mass"]
    std = case.estimate.std[-1, case.estimate.state_names.index("payload.mass")]
    pump = case.estimate["supply.pump_pressure"][-1] / 1e5
    return (
        f"Also estimated: payload {payload:.1f} ± {1.96 * std:.1f} kg (95 %; true: {true:g}), pump {pump:.2f} bar "
        f"(true: {case.experiment.crane['supply.pump_pressure'] / 1e5:g})."
    )


def write(found: Found, seed: int, engine: str, crane: Crane, folder: Path) -> list[Path]:
    """Write figures and report to `folder`, and return the files."""
    from validation.report import Table, write_report

    folder.mkdir(parents=True, exist_ok=True)
    cases, said = found.cases, findings(found.cases)
    drawn = [_drawn(tuning, case, folder) for tuning, case in cases.shown.items()]
    sections: list[tuple[str, list[Any]]] = [
        ("Results", list(said)),
        *((title, [Table(columns, rows)]) for title, columns, rows in found.tables()),
        *(section for section, _ in drawn),
    ]
    parameters = {"crane": crane.name, "engine": engine, "cases": len(cases.documents), "sensors": found.words}
    report = write_report(folder, "The paper's experiment", said[0], sections, seed=seed, parameters=parameters)
    return [*(path for _, paths in drawn for path in paths), report]


def _drawn(tuning: str, case: Case, folder: Path) -> tuple[tuple[str, list[Any]], list[Path]]:
    """Draw a case's figures into `folder`; return the section of the report that shows them, and the files."""
    from validation import paper_figures, plots
    from validation.paper import TUNINGS
    from validation.report import Picture

    figures = {
        folder / f"figure{number}_{tuning}.png": draw(case)
        for number, draw in enumerate((paper_figures.figure_5, paper_figures.figure_6, paper_figures.figure_7), 5)
    }
    for path, figure in figures.items():
        plots.save(figure, path)
    pictures = [Picture(figure, words) for figure, words in zip(figures.values(), _CAPTIONS, strict=True)]
    return (f"Figures 5, 6, 7: {TUNINGS[tuning].text}", pictures), list(figures)
