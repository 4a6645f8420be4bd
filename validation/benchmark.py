"""How fast and how large: measured in one run, so that ratios mean something on any machine.

Kernels are compiled before the clock starts; times are the best of a few repetitions where one is short.
"""

from __future__ import annotations

import math
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
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
#: states of the filter that estimates parameters along with the state
_MANY = 22


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


@dataclass(frozen=True)
class _Stretch:
    """Part of the cycle as a filter sees it: times (n,), states (n, nx), inputs (n, nw), and readings (n, k) of the
    sensors that an `Estimator` uses by default, with their noise.
    """

    time: np.ndarray
    states: np.ndarray
    inputs: np.ndarray
    sensors: Mapping[str, float]
    readings: np.ndarray

    @classmethod
    def of(cls, crane: Crane) -> _Stretch:
        from ukf.estimator import default_sensors
        from ukf.process import engine_of

        from .paper import noisy_sensors

        engine = engine_of("semi-recursive", crane)
        x0, grid, inputs = _cycle(crane, engine)
        begin, end = round(_BEGIN / _STEP), round((_BEGIN + STRETCH) / _STEP) + 1
        states = engine.simulate(x0, grid[:end], inputs[:end])[begin:]
        time, sensors = grid[begin:end], default_sensors(crane)
        readings = noisy_sensors(crane, time, states, np.random.default_rng(0), sensors)
        return cls(time, states, inputs[begin:end], sensors, np.column_stack([y for _, y in readings.values()]))

    def signals(self, crane: Crane, seconds: float) -> Any:
        """Return the first seconds of it as an estimator takes them."""
        from crane_exudyn.inputs import paper_cycle
        from ukf.signals import Signals

        n = round(seconds / _STEP) + 1
        time = self.time[:n]
        sensors = {name: (time, y[:n]) for name, y in zip(self.sensors, self.readings.T, strict=True)}
        return Signals(time, paper_cycle(time, len(crane.layout.cylinders)), sensors)


def filters(results: Results, crane: Crane) -> None:
    """The UKF at 1 kHz as real-time factors: Exudyn, semi-recursive, and the naive way; and where the time goes."""
    from ukf.estimator import Estimator
    from ukf.filter import Belief
    from ukf.noise import ProcessNoise

    stretch, noise = _Stretch.of(crane), ProcessNoise.of(crane.layout)
    # the model is perfect; the filter starts at the truth, as unsure as of what a second without sensors brings
    start = Belief(stretch.states[0], noise.covariance(1.0))
    signals = stretch.signals(crane, STRETCH)
    for name in ("exudyn", "semi-recursive"):
        estimator = Estimator(crane, name, noise=noise, start=start, gate=None, max_step=_STEP)
        estimator.run(stretch.signals(crane, NAIVE_STRETCH))
        clocks: dict[str, float] = {}
        key = f"filter.{name.replace('-', '_')}"
        with _split(estimator.engine, clocks, name):
            seconds = _add_factors(results, key, estimator, signals)
        _add_split(results, key, seconds, clocks)
        simplex = estimator.varied(method="simplex")
        _add_factors(results, f"{key}.simplex", simplex, signals)
        many = simplex.varied(start=None, augment=_uncertain(crane, _MANY - start.mean.size))
        _add_factors(results, f"{key}.simplex_{_MANY}_states", many, signals)
    results.add("filter.naive.realtime_factor", NAIVE_STRETCH / _naive(crane, stretch, start, noise), "1")


def _add_factors(results: Results, key: str, estimator: Any, signals: Any) -> float:
    """Add how many times real time a filter runs; return the seconds that it took.

    On a core that others use as well only processor time says what the program needs.
    """
    busy = time.process_time()
    seconds = seconds_of(partial(estimator.run, signals))
    busy = time.process_time() - busy
    results.add(f"{key}.realtime_factor", STRETCH / seconds, "1", "filter.naive.realtime_factor")
    results.add(f"{key}.realtime_factor_alone", STRETCH / busy, "1")
    return seconds


def _uncertain(crane: Crane, count: int) -> tuple[str, ...]:
    """Return the names of so many parameters that the crane file calls uncertain."""
    return tuple(n for n, known in crane.uncertainty.items() if math.isfinite(known.std))[:count]


@contextmanager
def _split(engine: Any, clocks: dict[str, float], name: str) -> Iterator[None]:
    """Add up in `clocks` the time within the engine: all of it, and on Exudyn restoring states and Exudyn's
    residual.
    """
    from crane_exudyn import engine as module

    places: list[tuple[Any, str, str]] = [(engine, "propagate", "engine")]
    if name == "exudyn":
        places += [(module.trapezoidal, "predict", "restore"), (module.System, "residual", "exudyn")]
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
    """Keep the time of one filter step, whole and in parts, in ms."""
    per_step = 1e3 / round(STRETCH / _STEP)
    whole = f"{key}.step"
    parts = {"engine": clocks["engine"]}
    if "exudyn" in clocks:
        newton = clocks["engine"] - clocks["restore"] - clocks["exudyn"]
        parts = {"restore": clocks["restore"], "exudyn_residual": clocks["exudyn"], "newton": newton}
    results.add(whole, seconds * per_step, "ms")
    for name, spent in (parts | {"filter_algebra": seconds - clocks["engine"]}).items():
        results.add(f"{whole}.{name}", spent * per_step, "ms", whole)


def _naive(crane: Crane, stretch: _Stretch, start: Any, noise: Any) -> float:
    """Return the time that filterpy's UKF takes for the short stretch with one SolveDynamic per sigma point."""
    from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter

    from crane_exudyn.measurement import Measurement
    from crane_exudyn.naive import SolveDynamicEngine
    from ukf.noise import measurement_noise

    engine = SolveDynamicEngine(crane)
    sensors = Measurement.of(crane, tuple(stretch.sensors))
    nx, inputs = start.mean.size, stretch.inputs
    points = MerweScaledSigmaPoints(nx, alpha=0.99, beta=0.0, kappa=0.0)
    ukf = UnscentedKalmanFilter(
        nx,
        len(stretch.sensors),
        _STEP,
        lambda x: sensors.read(x[None])[0],
        lambda x, dt, w: engine.propagate(x[None], w, dt)[0],
        points,
    )
    ukf.x, ukf.P = start.mean.copy(), start.covariance.copy()
    ukf.Q, ukf.R = noise.covariance(_STEP), measurement_noise(np.array(list(stretch.sensors.values())))

    def walk() -> None:
        for k in range(1, 1 + round(NAIVE_STRETCH / _STEP)):
            ukf.predict(w=inputs[k - 1 : k + 1])
            ukf.update(stretch.readings[k])

    engine.propagate(ukf.x[None], inputs[:2], _STEP)  # compiles
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
    ends, spent = [at for _, at in stages[1:]] + [end], dict[str, float]()
    for (text, at), until in zip(stages, ends, strict=True):
        spent[text] = spent.get(text, 0.0) + until - at  # effects are looked for in several rounds
    for text, seconds in spent.items():
        results.add(f"diagnosis.{text.replace(' ', '_')}", seconds, "s", "diagnosis")


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
