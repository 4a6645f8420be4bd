"""The paper's experiment: synthetic real system, simulation model, estimation model, with the paper's errors and
tuning.

The real system is the crane as given. The simulation and the estimation model share its errors (Tables 3 and 4 as far
as they are known): masses and inertias of both booms, brackets, payload, joint coordinates, pump pressure and start.
The simulation model runs open loop; the estimation model is corrected by the filter from noisy z1, z4, p1, p4 at 1 kHz.

Two estimators: `paper`, the paper's tuning (32), (33) and P0 to the letter; `own`, the estimator's own means: what the
model may be wrong about is estimated along with the state, so that the process noise can be small.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath, paper_cycle
from crane_exudyn.measurement import Measurement
from crane_exudyn.statics import visible
from ukf.augment import Augment
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.filter import Belief
from ukf.noise import PaperNoise, ProcessNoise, paper_start_covariance
from ukf.process import accepts_parameters, engine_of
from ukf.signals import Series, Signals
from ukf.tuning import cut

from . import metrics
from .workers import results_of

STATES = ("z1", "z4", "dz1", "dz4", "p1", "p2", "p3", "p4")
#: PN-RMSE in %, 15 % case, first input set, as published
PUBLISHED = dict(zip(STATES, (0.33, 1.07, 2.05, 2.58, 0.1209, 1.91, 5.92, 0.3127), strict=True))
MODEL_ERRORS = (0.05, 0.15, 0.25)
STEP, DURATION = 1e-3, 25.0
SENSOR_STD = {"z1": np.radians(1.0), "z4": np.radians(1.0), "p1": 1.5e5, "p4": 1.5e5}
#: start of the models off the real system's: +2° in z1, -3° in z4, +3 bar in each pressure
START_ERROR = np.array([np.radians(2.0), np.radians(-3.0), 0.0, 0.0, 3e5, 3e5, 3e5, 3e5])
_PUMP_ERROR, _PAYLOAD, _JOINT_ERROR = 20e5, 10.0, 5e-3
#: growth of the unknowns' standard deviation in parts of that at the start, per √s
_DRIFT = 0.01
#: what is known of a payload before it is lifted: something up to 400 kg, and that it does not grow on the way, kg,
#: kg/√s
_PAYLOAD_STD, _PAYLOAD_DRIFT = 200.0, 0.3


def _pulses(time: np.ndarray, pulses: Sequence[tuple[int, float, float, float]]) -> np.ndarray:
    """Return commands (n, 2): each pulse is (valve, from, to, value)."""
    out = np.zeros((time.size, 2))
    for valve, begin, end, value in pulses:
        out[(time >= begin) & (time < end), valve] = value
    return out


def both_at_once(time: np.ndarray) -> np.ndarray:
    """Return the second input set (n, 2): both booms move at the same time, at other speeds than in the paper's
    cycle.
    """
    lift = ((0, 1.5, 5.5, 0.35), (0, 10.0, 12.0, -0.30), (0, 16.0, 18.5, -0.40))
    tilt = ((1, 3.0, 6.0, 0.30), (1, 11.0, 14.0, -0.25), (1, 17.0, 18.5, 0.30))
    return _pulses(time, (*lift, *tilt))


def ramps(time: np.ndarray) -> np.ndarray:
    """Return the third input set (n, 2): smooth commands without steps, sin² windows of different length."""
    out = np.zeros((time.size, 2))
    windows = ((0, 1.0, 7.0, 0.45), (0, 9.0, 13.0, -0.35), (0, 15.0, 21.0, -0.30))
    for valve, begin, end, value in (*windows, (1, 2.0, 8.0, 0.35), (1, 10.0, 15.0, -0.35), (1, 17.0, 22.0, 0.25)):
        inside = (time >= begin) & (time < end)
        out[inside, valve] += value * np.sin(np.pi * (time[inside] - begin) / (end - begin)) ** 2
    return out


#: commands of the three input sets: the paper's cycle and two of our own
INPUT_SETS: dict[int, Callable[[np.ndarray], np.ndarray]] = {1: paper_cycle, 2: both_at_once, 3: ramps}


def wrong_crane(crane: Crane, model_error: float) -> Crane:
    """Return the estimation model: `crane` with the paper's errors; `model_error` is that of the booms' mass and
    inertia.
    """
    changes = {"payload.mass": _PAYLOAD, "supply.pump_pressure": crane["supply.pump_pressure"] + _PUMP_ERROR}
    for bodies, factor in (("lift_boom", "outer_boom"), 1 + model_error), (("bracket_1", "bracket_2"), 1.05):
        for name in (f"bodies.{b}.{q}" for b in bodies for q in ("mass", "inertia")):
            changes[name] = crane[name] * factor
    for joint in "ABCD":
        changes[f"joints.{joint}.x"] = crane[f"joints.{joint}.x"] + _JOINT_ERROR
        changes[f"joints.{joint}.y"] = crane[f"joints.{joint}.y"] - _JOINT_ERROR
    return crane.with_parameters(changes)


def unknowns(crane: Crane) -> tuple[Augment, ...]:
    """Return what the estimator's own means estimate along with the state, for an estimation model.

    Everything that the experiment's setting says may be wrong: payload, pump, masses and inertias of the booms,
    coordinates of the joints. The brackets are left out: 5 % of 20 kg are below what the sensors can tell; for such
    rests every quantity drifts by a hundredth of its uncertainty per √s, so that the filter never becomes surer than
    its model is right.

    The payload's standard deviation has to be wide. The first samples weigh the load before the angles are known; with
    30 kg the filter settles too early at 5 to 10 kg in smooth motion (input set 3), and p3 is then outside its interval
    most of the time.
    """
    masses = [f"bodies.{b}.{q}" for b in ("lift_boom", "outer_boom") for q in ("mass", "inertia")]
    joints = [f"joints.{j}.{axis}" for j in "ABCD" for axis in "xy"]
    std = {"supply.pump_pressure": _PUMP_ERROR}
    std |= {name: 0.15 * crane[name] for name in masses} | dict.fromkeys(joints, _JOINT_ERROR)
    payload = Augment("payload.mass", _PAYLOAD_STD, drift=_PAYLOAD_DRIFT)
    return (payload, *(Augment(name, value, drift=_DRIFT * value) for name, value in std.items()))


@dataclass(frozen=True)
class Experiment:
    """The real system's run: time (N,), commands (N, 2), inputs (N, 4), states (N, 8), noisy measurements as
    signals.
    """

    crane: Crane
    time: np.ndarray
    commands: np.ndarray
    inputs: np.ndarray
    truth: np.ndarray
    signals: Signals


@dataclass(frozen=True)
class Case:
    """One run of the experiment.

    Attributes:
        model_error, inputs, tuning, engine: which case it is; tuning is "paper" or "own".
        experiment: the real system.
        open_loop: (N, 8) states of the simulation model; NaN after it has left its limits.
        estimate: what the filter made of it.
        seconds: time the filter took.
    """

    model_error: float
    inputs: int
    tuning: str
    engine: str
    experiment: Experiment
    open_loop: np.ndarray
    estimate: Estimate
    seconds: float

    @property
    def pn_rmse(self) -> dict[str, float]:
        """PN-RMSE of the estimate in %, by state."""
        return _named(metrics.pn_rmse(self.estimate.mean[:, :8], self.experiment.truth))

    @property
    def pn_rmse_open_loop(self) -> dict[str, float]:
        """PN-RMSE of the simulation model in %, by state."""
        return _named(metrics.pn_rmse(self.open_loop, self.experiment.truth))

    @property
    def published(self) -> dict[str, float] | None:
        """The published row, where there is one for this case (it is for the whole cycle)."""
        return PUBLISHED if (self.model_error, self.inputs) == (0.15, 1) else None

    @property
    def coverage(self) -> dict[str, float]:
        """Share of time in which the truth is inside the 95 % interval, by state."""
        return self.estimate.coverage(self.experiment.truth)

    @property
    def nees_mean(self) -> float:
        """Mean NEES of the eight states; 8 for a consistent filter."""
        assert self.estimate.covariance is not None
        return float(np.mean(metrics.nees(self.estimate.mean, self.experiment.truth, self.estimate.covariance)))

    @property
    def realtime_factor(self) -> float:
        """Duration of the run over the time that the filter took."""
        return float((self.experiment.time[-1] - self.experiment.time[0]) / self.seconds)

    def document(self) -> dict[str, Any]:
        """Return the case as JSON."""
        return {
            "model_error": self.model_error,
            "inputs": self.inputs,
            "tuning": self.tuning,
            "engine": self.engine,
            "pn_rmse": self.pn_rmse,
            "published": self.published,
            "pn_rmse_open_loop": self.pn_rmse_open_loop,
            "coverage95": self.coverage,
            "nees_mean": self.nees_mean,
            "nis_mean": self.estimate.nis_mean,
            "nis_bounds": list(self.estimate.nis_bounds),
            "consistent": self.estimate.consistent,
            "realtime_factor": self.realtime_factor,
            "found": {
                n: {"value": float(self.estimate[n][-1]), "std": float(self.estimate.std[-1, 8 + k])}
                for k, n in enumerate(self.estimate.state_names[8:])
            },
        }


def _named(values: np.ndarray) -> dict[str, float]:
    return dict(zip(STATES, values.tolist(), strict=True))


def real_system(crane: Crane, inputs: int, engine: str, seed: int, duration: float = DURATION) -> Experiment:
    """Return a run of the synthetic real system and its noisy sensors.

    Raises:
        CraneError: an input set that does not exist.
    """
    if inputs not in INPUT_SETS:
        raise CraneError(f"There is no input set {inputs}. Use one of {', '.join(map(str, INPUT_SETS))}.")
    time = np.arange(round(duration / STEP) + 1) * STEP
    commands = INPUT_SETS[inputs](time)
    w = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    model = engine_of(engine, crane)
    truth = visible(crane, model.simulate(model.static_start(*crane.initial.pose), time, w, step=STEP))
    rng = np.random.default_rng(seed)
    signals = Signals(time, commands, noisy_sensors(crane, time, truth, rng), name=f"input set {inputs}")
    return Experiment(crane, time, commands, w, truth, signals)


def noisy_sensors(crane: Crane, time: np.ndarray, truth: np.ndarray, rng: np.random.Generator) -> dict[str, Series]:
    """Return what the paper's sensors show of states (N, nx) at `time` (N,), with their noise."""
    shown = Measurement.of(crane, tuple(SENSOR_STD)).shown(truth, time, settled=True)
    return {
        n: (time, y + s * rng.normal(size=time.size)) for (n, s), y in zip(SENSOR_STD.items(), shown.T, strict=True)
    }


def simulation_model(wrong: Crane, experiment: Experiment, engine: str) -> np.ndarray:
    """Return the open-loop run (N, 8) of the model with errors; NaN from where it leaves what it can simulate."""
    model = engine_of(engine, wrong)
    out = np.full_like(experiment.truth, np.nan)
    out[0] = experiment.truth[0] + START_ERROR
    pieces = range(0, experiment.time.size - 1, 1000)
    for i in pieces:
        part = slice(i, min(i + 1001, experiment.time.size))
        try:
            out[part] = model.simulate(out[i], experiment.time[part], experiment.inputs[part], step=STEP)
        except CraneError:
            break
    return visible(wrong, out)


def estimator(wrong: Crane, experiment: Experiment, engine: Any, tuning: str, method: str = "ukf") -> Estimator:
    """Return the estimator of a tuning ("paper" or "own") for the estimation model.

    Raises:
        CraneError: no such tuning.
    """
    mean = experiment.truth[0] + START_ERROR
    if tuning == "paper":
        start = Belief(mean, paper_start_covariance())
        return Estimator(wrong, engine, SENSOR_STD, PaperNoise(), method, start=start, gate=None, max_step=STEP)
    if tuning != "own":
        raise CraneError(f'There is no tuning {tuning!r}. Use "paper" or "own".')
    deviation = np.array([*np.radians([3.0, 4.0, 3.0, 3.0]), *[5e5] * 4])
    start = Belief(mean, np.diag(deviation**2))
    noise = ProcessNoise((1e-5, 1e-5), (1e7, 1e7, 1e7, 1e7))
    return Estimator(wrong, engine, SENSOR_STD, noise, method, unknowns(wrong), start, max_step=STEP)


def run_case(
    model_error: float = 0.15,
    inputs: int = 1,
    engine: str = "exudyn",
    seed: int = 0,
    *,
    tuning: str = "paper",
    crane: Crane | None = None,
    duration: float = DURATION,
    experiment: Experiment | None = None,
    open_loop: np.ndarray | None = None,
    progress: Callable[[float], None] | None = None,
) -> Case:
    """Return one case of the experiment.

    Args:
        model_error: relative error of the booms' masses and inertias.
        inputs: 1 for the paper's cycle, 2 or 3 for ours.
        engine: "exudyn" or "semi-recursive", for all three models.
        seed: of the sensors' noise.
        tuning: "paper", or "own" for the estimator's own means.
        crane: the real system; default the built-in crane.
        duration: length of the run, s.
        experiment, open_loop: what an earlier case has computed already for the same engine, inputs, seed and error.
        progress: called with the fraction of the filter's run that is done.
    """
    crane = crane if crane is not None else Crane.load("patu655")
    experiment = experiment if experiment is not None else real_system(crane, inputs, engine, seed, duration)
    wrong = wrong_crane(crane, model_error)
    open_loop = open_loop if open_loop is not None else simulation_model(wrong, experiment, engine)
    model, used = engine_of(engine, wrong), engine
    if tuning == "own" and not accepts_parameters(model):
        model, used = engine_of("semi-recursive", wrong), "semi-recursive"
    filter_ = estimator(wrong, experiment, model, tuning)
    filter_.run(cut(experiment.signals, 0.0, 0.02))  # compiles, so that the clock does not count it
    begin = clock.perf_counter()
    estimate = filter_.run(experiment.signals, keep_covariance=True, progress=progress)
    seconds = clock.perf_counter() - begin
    return Case(model_error, inputs, tuning, used, experiment, open_loop, estimate, seconds)


@dataclass(frozen=True)
class Reproduction:
    """All cases as documents, and the cases of `shown` (15 % error, first input set) whole, for figures, by tuning."""

    documents: tuple[dict[str, Any], ...]
    shown: dict[str, Case]
    seconds: float

    @property
    def realtime_factor(self) -> float:
        """Smallest real-time factor of the 17-point filter over all cases of the paper's tuning."""
        return min((d["realtime_factor"] for d in self.documents if d["tuning"] == "paper"), default=float("nan"))

    def document(self) -> dict[str, Any]:
        """Return the result as JSON."""
        return {"cases": list(self.documents), "realtime_factor": self.realtime_factor, "seconds": self.seconds}


def reproduce(
    model_errors: Sequence[float] = MODEL_ERRORS,
    inputs: Sequence[int] = tuple(INPUT_SETS),
    engine: str = "exudyn",
    seed: int = 0,
    *,
    tunings: Sequence[str] = ("paper", "own"),
    crane: Crane | None = None,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Reproduction:
    """Return the paper's table: every model error with every input set, by every tuning.

    Args:
        jobs: processes; one input set is one piece of work, since its cases share the real system.
    """
    begin = clock.perf_counter()
    crane = crane if crane is not None else Crane.load("patu655")
    work = [(error, i) for i in inputs for error in model_errors]
    tasks = [(_both_tunings, error, i, engine, seed, tuple(tunings), crane) for error, i in work]
    documents: list[dict[str, Any]] = []
    shown: dict[str, Case] = {}
    for k, (found, cases) in enumerate(results_of(tasks, jobs)):
        documents += found
        shown |= cases
        if progress is not None:
            progress((k + 1) / len(work))
    order = {t: k for k, t in enumerate(tunings)}
    documents.sort(key=lambda d: (order[d["tuning"]], d["inputs"], d["model_error"]))
    return Reproduction(tuple(documents), shown, clock.perf_counter() - begin)


def _both_tunings(
    error: float, inputs: int, engine: str, seed: int, tunings: tuple[str, ...], crane: Crane
) -> tuple[list[dict[str, Any]], dict[str, Case]]:
    """Return the documents of one error and input set, and the cases themselves where figures show them."""
    experiment = real_system(crane, inputs, engine, seed)
    open_loop = simulation_model(wrong_crane(crane, error), experiment, engine)
    documents, shown = [], {}
    for tuning in tunings:
        case = run_case(
            error, inputs, engine, seed, tuning=tuning, crane=crane, experiment=experiment, open_loop=open_loop
        )
        documents.append(case.document())
        if (error, inputs) == (0.15, 1):
            shown[tuning] = case
    return documents, shown


def pressure_floor(std: float = SENSOR_STD["p1"], variance: float | None = None) -> float:
    """Return the error (Pa) that a sensor's noise alone leaves in a pressure which the filter takes for a random walk.

    With a variance q a step (the paper's σ_p²) and a sensor variance r the stationary Riccati equation gives
    P⁻ = (q + √(q² + 4 q r))/2 and the gain K = P⁻/(P⁻ + r). Even if the model predicted every step exactly, the error
    would obey e' = (1 - K) e + K ν, whose variance is r K/(2 - K).
    """
    from ukf.noise import PAPER_PRESSURE

    q, r = PAPER_PRESSURE if variance is None else variance, std**2
    prior = 0.5 * (q + np.sqrt(q * q + 4 * q * r))
    gain = prior / (prior + r)
    return float(np.sqrt(r * gain / (2.0 - gain)))
