"""Is the filter consistent? Many runs of a crane that is shaken as the filter believes it to be.

In each run the true start is drawn from the filter's own start belief, the true state gets the filter's own process
noise at every step, and the sensors their noise. If model, filter and covariances agree, NEES is χ² at any instant over
the runs with as many degrees of freedom as there are states, and NIS with as many as there are sensors. With model
errors they do not agree, and the same numbers say so.

Any machine will do. On that of the paper the commands are those of an input set; on another one they are those of the
paper's cycle for as many valves, let go before a stroke ends.

Runs go through joblib, on the cores of one machine or on a Dask cluster. Every finished run is a line of a file, so
that a killed series goes on where it stopped.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.files import write_text
from crane_exudyn.inputs import SpoolPath, paper_cycle
from crane_exudyn.layout import Layout
from crane_exudyn.statics import visible
from crane_exudyn.strokes import within_strokes
from ukf.consistency import mean_bounds
from ukf.estimator import Estimator, default_sensors
from ukf.filter import Belief
from ukf.linear_algebra import semidefinite_root
from ukf.noise import ProcessNoise
from ukf.process import engine_of
from ukf.signals import Signals

from . import metrics, paper
from .json_lines import add_line, read_lines
from .workers import results_of, scheduled

#: shares of the run at which NEES is compared over the runs: instants of one run are not independent
CHECKPOINTS = (0.1, 0.3, 0.5, 0.7, 0.9, 1.0)
#: standard deviations of the start by the unit of the state
START = {"rad": np.radians(1.0), "m": 0.01, "rad/s": 0.02, "m/s": 0.02, "Pa": 2e5}


@dataclass(frozen=True)
class Settings:
    """What all runs of a series share.

    Attributes:
        model_error: of the booms' masses in the filter's model (`paper.wrong_crane`); 0 for a perfect model.
        inputs: input set of `paper.INPUT_SETS`, on a machine with two valves; 3 keeps all chambers of the PATU 655 full
            of oil, so that nothing but the laws is nonlinear.
        duration, step: length of a run and time between two samples, s.
        engine, method: which engine and which filter.
        acceleration, pressure: densities of the process noise, rad²/s³ and Pa²/s.
        seed: of the series; run k draws from (seed, k).
    """

    model_error: float = 0.0
    inputs: int = 3
    duration: float = 25.0
    step: float = 1e-3
    engine: str = "semi-recursive"
    method: str = "ukf"
    acceleration: float = 1e-4
    pressure: float = 1e9
    seed: int = 0

    def noise(self, layout: Layout) -> ProcessNoise:
        """Return the process noise of truth and filter."""
        return ProcessNoise((self.acceleration,) * len(layout.coordinates), (self.pressure,) * len(layout.chambers))

    @property
    def time(self) -> np.ndarray:
        """Instants (N,) of the samples, s."""
        return np.arange(round(self.duration / self.step) + 1) * self.step


def one_run(settings: Settings, number: int, crane: Crane) -> dict[str, Any]:
    """Return NEES, NIS, coverage and verdict of one run."""
    rng = np.random.default_rng([settings.seed, number])
    time, lay = settings.time, crane.layout
    model = engine_of(settings.engine, crane)
    nominal = model.static_start(*crane.initial.pose)
    commands = driven(settings, crane, nominal)
    spread = np.array(lay.sized(model.state_names, START))
    start = nominal + spread * rng.normal(size=spread.size)
    truth = visible(crane, shaken(model, crane, start, time, commands, settings, rng))
    gauges = paper.sensors_of(tuple(default_sensors(crane)), {}, lay)
    sensors = paper.noisy_sensors(crane, time, truth, rng, gauges)
    believed = crane if settings.model_error == 0 else paper.wrong_crane(crane, settings.model_error)
    filter_ = Estimator(
        believed,
        model if believed is crane else settings.engine,
        gauges,
        settings.noise(lay),
        settings.method,
        start=Belief(nominal, np.diag(spread**2)),
        gate=None,
        max_step=settings.step,
    )
    estimate = filter_.run(Signals(time, commands, sensors), keep_covariance=True)
    assert estimate.covariance is not None
    mean = estimate.mean[:, : len(spread)]
    values = metrics.nees(estimate.mean, truth, estimate.covariance)
    at = [round(share * (time.size - 1)) for share in CHECKPOINTS]
    return {
        "run": number,
        "nees": [float(values[k]) for k in at],
        "nees_mean": float(values.mean()),
        "nis_sum": float(np.nansum(estimate.nis)),
        "nis_dof": float(estimate.dof.sum()),
        "coverage95": estimate.coverage(truth),
        "pn_rmse": paper.or_none(paper.percent_errors(mean, truth, model.state_names, lay)),
        "consistent": estimate.consistent,
        "events": len(estimate.events),
    }


def driven(settings: Settings, crane: Crane, start: np.ndarray) -> np.ndarray:
    """Return the commands (N, valves) of all runs: of the input set on a machine like the paper's; on another one of
    the paper's cycle, kept off the ends of the strokes from the nominal start (nx,).
    """
    time = settings.time
    if crane.layout.states == paper.STATES:
        return paper.INPUT_SETS[settings.inputs](time)
    cycle = paper_cycle(time, len(crane.layout.commands))
    kept = within_strokes(crane, time, cycle, start)
    return cycle if kept is None else kept


def shaken(
    model: Any,
    crane: Crane,
    start: np.ndarray,
    time: np.ndarray,
    commands: np.ndarray,
    settings: Settings,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return the states (N, nx) of a crane that gets the process noise of `settings` at every step; states that effects
    add get none.
    """
    inputs = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    root = semidefinite_root(settings.noise(crane.layout).covariance(settings.step))
    states, pushes = np.empty((time.size, start.size)), np.zeros((time.size, start.size))
    states[0] = start
    pushes[:, : len(root)] = rng.normal(size=(time.size, len(root))) @ root.T
    for k in range(1, time.size):
        h = time[k] - time[k - 1]
        states[k] = model.propagate(states[k - 1][None], inputs[k - 1 : k + 1], h, time[k - 1])[0] + pushes[k]
    return states


@dataclass(frozen=True)
class Series:
    """All runs of a series, in the order of their numbers."""

    settings: Settings
    runs: tuple[dict[str, Any], ...]

    @property
    def nees(self) -> np.ndarray:
        """Mean NEES over the runs at each of the CHECKPOINTS."""
        return np.mean([r["nees"] for r in self.runs], axis=0)

    @property
    def nees_bounds(self) -> tuple[float, float]:
        """Interval that holds each of these means with 99.8 %, so that all of them together stay inside with about 99
        %.
        """
        return mean_bounds(self.expected_nees, len(self.runs), 0.998)

    @property
    def expected_nees(self) -> int:
        """How many states there are, which NEES is on the average."""
        return len(self.runs[0]["coverage95"])

    @property
    def nis(self) -> float:
        """NIS a measured value, over all runs; 1 is expected."""
        return float(sum(r["nis_sum"] for r in self.runs) / sum(r["nis_dof"] for r in self.runs))

    @property
    def nis_bounds(self) -> tuple[float, float]:
        """Interval that holds the NIS a measured value with 99 %."""
        return mean_bounds(1, sum(r["nis_dof"] for r in self.runs), 0.99)

    @property
    def consistent(self) -> bool:
        """Whether NEES and NIS are inside their bounds."""
        low, high = self.nees_bounds
        return bool(
            ((low <= self.nees) & (self.nees <= high)).all() and self.nis_bounds[0] <= self.nis <= self.nis_bounds[1]
        )

    def document(self) -> dict[str, Any]:
        """Return the series as JSON."""
        states = self.runs[0]["coverage95"]
        errors = {s: [r["pn_rmse"][s] for r in self.runs if r["pn_rmse"][s] is not None] for s in states}
        return {
            "settings": asdict(self.settings),
            "runs": len(self.runs),
            "nees": dict(zip(map(str, CHECKPOINTS), self.nees.tolist(), strict=True)),
            "nees_expected": self.expected_nees,
            "nees_bounds": list(self.nees_bounds),
            "nis_per_value": self.nis,
            "nis_bounds": list(self.nis_bounds),
            "coverage95": {s: float(np.mean([r["coverage95"][s] for r in self.runs])) for s in states},
            "pn_rmse": {s: float(np.mean(e)) if e else None for s, e in errors.items()},
            "runs_called_consistent": sum(r["consistent"] for r in self.runs),
            "consistent": self.consistent,
        }


def run_series(
    settings: Settings,
    runs: int,
    *,
    crane: Crane | None = None,
    jobs: int = 1,
    scheduler: str | None = None,
    file: str | Path | None = None,
    progress: Callable[[float], None] | None = None,
) -> Series:
    """Return a series of runs 0 … runs - 1; those that `file` already holds are not run again.

    Args:
        jobs: processes on this machine.
        scheduler: address of a Dask scheduler, or "local" for one on this machine; then `jobs` is left to Dask.
        file: JSON lines; the first one holds settings and crane, each other one a finished run.

    Raises:
        CraneError: the file belongs to another series.
    """
    crane = crane if crane is not None else Crane.load("patu655")
    path = None if file is None else Path(file)
    done = {} if path is None else finished(path, settings, crane)
    missing = [k for k in range(runs) if k not in done]
    with scheduled(scheduler):
        tasks = [(one_run, settings, k, crane) for k in missing]
        for result in results_of(tasks, jobs, "generator_unordered"):
            done[result["run"]] = result
            if path is not None:
                add_line(path, result)
            if progress is not None:
                progress(len(done) / runs)
    return Series(settings, tuple(done[k] for k in sorted(done) if k < runs))


def finished(path: Path, settings: Settings, crane: Crane) -> dict[int, dict[str, Any]]:
    """Return the runs that the file holds, by number; begin the file where there is none.

    A last line that was cut off when the series was killed is dropped, and its run done again.
    """
    head = {"settings": asdict(settings), "crane": crane.to_toml()}
    if not path.exists():
        write_text(path, json.dumps(head) + "\n")
        return {}
    found = read_lines(path)
    if not found or found[0] != head:
        raise CraneError(
            f"{path}: contains another series (other settings or another crane). Give another file, or delete it."
        )
    return {r["run"]: r for r in found[1:]}
