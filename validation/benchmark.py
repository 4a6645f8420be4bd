"""How fast and how large: measured in one run, so that ratios mean something on any machine.

Kernels are compiled before the clock starts; times are the best of a few repetitions where one is short.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError, nearest

#: length of the paper's working cycle, and of the stretch in which the slow filters are timed, s
CYCLE, STRETCH, NAIVE_STRETCH = 25.0, 3.0, 0.05
#: when the stretch begins: the lift boom is moving
_BEGIN = 2.5
_STEP = 1e-3


@dataclass(frozen=True)
class Measure:
    """One measured quantity: value, its unit, and what it is compared with in the same run."""

    value: float
    unit: str
    ratio_to: str = ""


@dataclass
class Results:
    """Measured quantities by name, in the order in which they came."""

    measures: dict[str, Measure] = field(default_factory=dict)

    def add(self, name: str, value: float, unit: str, ratio_to: str = "") -> None:
        """Keep one quantity; `ratio_to` names one that is measured in the same run."""
        self.measures[name] = Measure(float(value), unit, ratio_to)

    def document(self) -> dict[str, dict[str, Any]]:
        """Return {name: {value, unit, ratio_to, ratio}}; ratio is null where there is nothing to compare with."""
        out = {}
        for name, m in self.measures.items():
            other = self.measures.get(m.ratio_to)
            ratio = m.value / other.value if other is not None and other.value else None
            out[name] = {"value": m.value, "unit": m.unit, "ratio_to": m.ratio_to or None, "ratio": ratio}
        return out


def run(
    only: list[str] | None = None, crane: Crane | None = None, progress: Callable[[float], None] | None = None
) -> Results:
    """Return the measures of the chosen parts (`PARTS`), all by default.

    Raises:
        CraneError: there is no such part.
    """
    for name in only or ():
        if name not in PARTS:
            raise CraneError(f"There is no benchmark {name!r}.{nearest(name, list(PARTS))}")
    chosen = [name for name in PARTS if not only or name in only]
    results = Results()
    results.add("real_time", CYCLE, "s")
    for k, name in enumerate(chosen):
        PARTS[name](results, crane or Crane.load("patu655"))
        if progress is not None:
            progress((k + 1) / len(chosen))
    return results


def seconds_of(call: Callable[[], Any], repetitions: int = 1) -> float:
    """Return the shortest time of a call in s; what else runs on the machine only ever adds."""
    best = np.inf
    for _ in range(repetitions):
        begin = time.perf_counter()
        call()
        best = min(best, time.perf_counter() - begin)
    return float(best)


def resident() -> float:
    """Return the memory of this process in MB that is in use now."""
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * 4096 / 1e6


# -- parts -----------------------------------------------------------------------------------------------------------


def start_up(results: Results, crane: Crane) -> None:
    """Time until `patu --help` has answered, beside an empty Python program."""
    empty = partial(subprocess.run, [sys.executable, "-c", "pass"], check=True)
    help_ = partial(subprocess.run, [sys.executable, "-m", "patu", "--help"], check=True, stdout=subprocess.DEVNULL)
    results.add("start_up.python", seconds_of(empty, 3), "s")
    results.add("start_up.help", seconds_of(help_, 3), "s", "start_up.python")


def open_loop(results: Results, crane: Crane) -> None:
    """25 s of the paper's cycle at 1 ms on both engines, and what a run leaves in memory."""
    from ukf.process import engine_of

    for name in ("exudyn", "semi-recursive"):
        engine = engine_of(name, crane)
        x0, grid, inputs = _cycle(crane, engine)
        engine.simulate(x0, grid[:50], inputs[:50])
        before = resident()
        seconds = seconds_of(partial(engine.simulate, x0, grid, inputs), 1 if name == "exudyn" else 3)
        key = name.replace("-", "_")
        results.add(f"open_loop.{key}", seconds, "s", "real_time" if name == "exudyn" else "open_loop.exudyn")
        results.add(f"open_loop.{key}.memory", resident() - before, "MB")


def _cycle(crane: Crane, engine: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    from crane_exudyn.inputs import SpoolPath, paper_cycle
    from crane_exudyn.simulation import initial_state, paper_time

    grid = paper_time()
    spool = SpoolPath(crane).run(grid, paper_cycle(grid, len(crane.layout.cylinders)))
    return initial_state(crane, engine), grid, np.column_stack([spool, np.full((len(grid), 2), np.nan)])


def filters(results: Results, crane: Crane) -> None:
    """The paper's UKF at 1 kHz as real-time factors: Exudyn, semi-recursive, and the naive way; and where the time
    goes.
    """
    from . import paper

    experiment = paper.real_system(crane, 1, "semi-recursive", seed=0, duration=_BEGIN + STRETCH)
    signals = _part(experiment, _BEGIN, _BEGIN + STRETCH)
    for name in ("exudyn", "semi-recursive"):
        estimator = _estimator(crane, experiment, name)
        estimator.run(_part(experiment, _BEGIN, _BEGIN + 0.05))
        clocks: dict[str, float] = {}
        busy = time.process_time()
        with _split(estimator.engine, clocks, name):
            seconds = seconds_of(partial(estimator.run, signals))
        busy = time.process_time() - busy
        key = name.replace("-", "_")
        results.add(f"filter.{key}.realtime_factor", STRETCH / seconds, "1", "filter.naive.realtime_factor")
        # on a core that others use as well, only processor time says what the program needs
        results.add(f"filter.{key}.realtime_factor_alone", STRETCH / busy, "1")
        _add_split(results, f"filter.{key}", seconds, clocks)
    results.add("filter.naive.realtime_factor", NAIVE_STRETCH / _naive(crane, experiment), "1")


def _part(experiment: Any, begin: float, end: float) -> Any:
    """Return the signals of an experiment between two times."""
    from dataclasses import replace

    signals = experiment.signals
    inside = (signals.command_time >= begin - 1e-9) & (signals.command_time <= end + 1e-9)
    sensors = {name: (t[inside], y[inside]) for name, (t, y) in signals.sensors.items()}
    return replace(
        signals, command_time=signals.command_time[inside], commands=signals.commands[inside], sensors=sensors
    )


def _estimator(crane: Crane, experiment: Any, engine: str) -> Any:
    """Return the paper's filter, started at the truth where the stretch begins; the model is perfect here."""
    from ukf.estimator import Estimator
    from ukf.filter import Belief
    from ukf.noise import PaperNoise, paper_start_covariance

    from .paper import SENSOR_STD

    start = Belief(experiment.truth[round(_BEGIN / _STEP)], paper_start_covariance())
    return Estimator(crane, engine, SENSOR_STD, PaperNoise(), start=start, gate=None, max_step=_STEP)


@contextmanager
def _split(engine: Any, clocks: dict[str, float], name: str) -> Iterator[None]:
    """Add up in `clocks` the time within the engine: all of it, and on Exudyn restoring states and Exudyn's
    residual.
    """
    from crane_exudyn import engine as module

    places: list[tuple[Any, str, str]] = [(engine, "propagate", "engine")]
    if name == "exudyn":
        places += [(module.trapezoidal, "predict", "restore"), (module._System, "_residual", "exudyn")]
    originals = [(owner, name, getattr(owner, name)) for owner, name, _ in places]
    for owner, name, label in places:
        setattr(owner, name, _timed(getattr(owner, name), clocks, label))
    try:
        yield
    finally:
        for owner, name, original in originals:
            if owner is engine:
                delattr(owner, name)  # uncovers the method of the class
            else:
                setattr(owner, name, original)


def _timed(function: Callable[..., Any], clocks: dict[str, float], label: str) -> Callable[..., Any]:
    def timed(*args: Any, **options: Any) -> Any:
        begin = time.perf_counter()
        try:
            return function(*args, **options)
        finally:
            clocks[label] = clocks.get(label, 0.0) + time.perf_counter() - begin

    return timed


def _add_split(results: Results, key: str, seconds: float, clocks: dict[str, float]) -> None:
    """Keep the time of one filter step of 17 sigma points, whole and in parts, in ms."""
    per_step = 1e3 / round(STRETCH / _STEP)
    whole = f"{key}.step"
    parts = {"engine": clocks["engine"]}
    if "exudyn" in clocks:
        newton = clocks["engine"] - clocks["restore"] - clocks["exudyn"]
        parts = {"restore": clocks["restore"], "exudyn_residual": clocks["exudyn"], "newton": newton}
    results.add(whole, seconds * per_step, "ms")
    for name, spent in (parts | {"filter_algebra": seconds - clocks["engine"]}).items():
        results.add(f"{whole}.{name}", spent * per_step, "ms", whole)


def _naive(crane: Crane, experiment: Any) -> float:
    """Return the time that filterpy's UKF takes for the short stretch with one SolveDynamic per sigma point."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    from crane_exudyn.naive import SolveDynamicEngine
    from ukf.noise import PaperNoise, paper_start_covariance

    from .paper import SENSOR_STD

    engine = SolveDynamicEngine(crane)
    columns = [0, 1, 4, 7]
    points = MerweScaledSigmaPoints(8, alpha=0.99, beta=0.0, kappa=0.0)
    inputs: list[np.ndarray] = [np.empty((2, 4))]
    ukf = UnscentedKalmanFilter(
        8, 4, _STEP, lambda x: x[columns], lambda x, dt: engine.propagate(x[None], inputs[0], dt)[0], points
    )
    first = round(_BEGIN / _STEP)
    ukf.x, ukf.P = experiment.truth[first].copy(), paper_start_covariance()
    ukf.Q, ukf.R = PaperNoise().covariance(_STEP), np.diag([s**2 for s in SENSOR_STD.values()])
    measured = np.column_stack([experiment.signals.sensors[n][1] for n in SENSOR_STD])

    def walk() -> None:
        for k in range(first + 1, first + 1 + round(NAIVE_STRETCH / _STEP)):
            inputs[0] = experiment.inputs[k - 1 : k + 1]
            ukf.predict()
            ukf.update(measured[k])

    engine.propagate(ukf.x[None], experiment.inputs[first : first + 2], _STEP)  # compiles
    return seconds_of(walk)


def diagnosis(results: Results, crane: Crane) -> None:
    """A diagnosis of 25 s at 200 Hz against all effects and places with two processes, and where its time goes."""
    from .diagnosis import diagnose

    diagnose_once = partial(diagnose, crane, leaking_recording(crane), jobs=2)
    stages: list[tuple[str, float]] = []
    begin = time.perf_counter()
    found = diagnose_once(progress=lambda text, _: stages.append((text, time.perf_counter())))
    end = time.perf_counter()
    results.add("diagnosis", end - begin, "s", "real_time")
    results.add("diagnosis.weighed", len(found.candidates), "1")
    ends = [at for _, at in stages[1:]] + [end]
    for (text, at), until in zip(stages, ends, strict=True):
        results.add(f"diagnosis.{text.replace(' ', '_')}", until - at, "s", "diagnosis")


def leaking_recording(crane: Crane, rate: float = 200.0) -> Any:
    """Return a recording of the paper's cycle on a crane whose first cylinder leaks: coordinates and all pressures,
    with noise.
    """
    from crane_exudyn.recording import Recording
    from crane_exudyn.simulation import simulate
    from ukf.process import engine_of

    leaking = crane.with_effect(f"internal_leakage@{crane.layout.cylinders[0]}", {"k": 5e-12})
    run = simulate(leaking, engine=engine_of("semi-recursive", leaking))
    every = slice(None, None, round(1.0 / (rate * _STEP)))
    rng = np.random.default_rng(0)
    lay = crane.layout
    noise = dict.fromkeys(lay.coordinates, math.radians(0.05)) | dict.fromkeys(lay.chambers, 0.3e5)
    measured = {n: run[n][every] + std * rng.normal(size=len(run.time[every])) for n, std in noise.items()}
    commands = {n: run[n][every] for n in lay.commands}
    return Recording.from_arrays("leaking cylinder", run.time[every], commands | measured, layout=lay)


def memory(results: Results, crane: Crane) -> None:
    """Memory of this process: now, and how much four open-loop runs more leave behind."""
    from ukf.process import engine_of

    engine = engine_of("semi-recursive", crane)
    x0, grid, inputs = _cycle(crane, engine)
    engine.simulate(x0, grid, inputs)
    before = resident()
    for _ in range(4):
        engine.simulate(x0, grid, inputs)
    results.add("memory.process", before, "MB")
    results.add("memory.left_by_four_runs", resident() - before, "MB", "memory.process")


#: what can be measured, by name
PARTS: dict[str, Callable[[Results, Crane], None]] = {
    "start_up": start_up,
    "open_loop": open_loop,
    "filters": filters,
    "diagnosis": diagnosis,
    "memory": memory,
}
