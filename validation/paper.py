"""The paper's experiment: synthetic real system, simulation model, estimation model, with the paper's errors and
tuning.

The real system is the crane as given. The simulation and the estimation model share its errors (Tables 3 and 4 as far
as they are known): masses and inertias of both booms, brackets, payload, joint coordinates, pump pressure and start.
The simulation model runs open loop; the estimation model is corrected by the filter from noisy z1, z4, p1, p4 at 1 kHz.

Three rows: `paper`, the paper's tuning (32), (33) and P0 to the letter; `paper-0.15-bar`, the same with gauges of 0.15
instead of 1.5 bar; `own`, the estimator's own tuning: what the model may be wrong about is estimated along with the
state, so that the process noise can be small. How wrong it may be follows from the crane file's uncertainties, one, two
or four times as wide: the innovations of the first motion say which is likeliest. `own-file`, `own-half` and
`own-twice` take them as they are, half and twice as wide.
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import hooks
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath, paper_cycle
from crane_exudyn.layout import Layout
from crane_exudyn.measurement import Measurement
from crane_exudyn.sensors import sensor
from crane_exudyn.statics import visible
from ukf.augment import Augment
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.filter import Belief
from ukf.noise import PaperNoise, ProcessNoise, paper_start_covariance
from ukf.process import accepts_parameters, engine_of
from ukf.revisit import Revisit
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
#: noise of the paper's sensors by unit; a range of a state that is smaller than twice of it is nothing to divide an
#: error by
_NOISE = {"rad": np.radians(1.0), "Pa": 1.5e5, "rad/s": np.radians(1.0)}
#: start of the models off the real system's: +2° in z1, -3° in z4, +3 bar in each pressure
START_ERROR = np.array([np.radians(2.0), np.radians(-3.0), 0.0, 0.0, 3e5, 3e5, 3e5, 3e5])
_PUMP_ERROR, _PAYLOAD, _JOINT_ERROR = 20e5, 10.0, 5e-3
#: booms and brackets of the paper's machine
_BODIES = ("lift_boom", "outer_boom", "bracket_1", "bracket_2")
#: growth of the unknowns' standard deviation in parts of that at the start, per √s
_DRIFT = 1e-3
#: standard deviations of the own tuning at the start: 3°, 4°, 3°/s, 5 bar
_START_STD = np.array([*np.radians([3.0, 4.0, 3.0, 3.0]), *[5e5] * 4])
#: growth of the pose's standard deviation in parts of that at the start, per √s
_CREEP = 1e-2
#: s from which the likeliest width of the priors is found: the first motion
_LISTENING = 5.0
#: the own tuning repeats this beginning too; engines agree to four digits
_REVISIT = Revisit(_LISTENING, "semi-recursive")


#: the filter of the own tuning. Sigma points of 22 states lie 4.7 standard deviations out, where masses are negative;
#: and it takes slopes, which can be kept, and taken again for the beginning
_OWN = "ekf"


@dataclass(frozen=True)
class Tuning:
    """What a row of the table says, the noise of its gauges in Pa (the paper's where none), how wide the priors of
    `own` may be, and the filter.
    """

    text: str
    gauges: float | None = None
    widths: tuple[float, ...] = ()
    method: str = "ukf"


TUNINGS = {
    "paper": Tuning("the paper's tuning"),
    "paper-0.15-bar": Tuning("the paper's tuning, pressure sensors of 0.15 bar", gauges=0.15e5),
    "own": Tuning("own tuning: unknown parameters are estimated too", widths=(1.0, 2.0, 4.0), method=_OWN),
    "own-file": Tuning("own tuning, priors as in the crane file", widths=(1.0,), method=_OWN),
    "own-half": Tuning("own tuning, priors half as wide as in the crane file", widths=(0.5,), method=_OWN),
    "own-twice": Tuning("own tuning, priors twice as wide as in the crane file", widths=(2.0,), method=_OWN),
}
#: rows of the table where nothing else is asked for
ROWS = ("paper", "paper-0.15-bar", "own")


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


def check_machine(crane: Crane) -> None:
    """Raise CraneError for a crane on which the paper's experiment cannot be made: its errors are of the bodies and
    joints of the PATU 655, its covariances of eight states.
    """
    whole = crane.layout.states == STATES and not hooks.swings(crane.effect_vector())
    if not whole or any(f"bodies.{body}.mass" not in crane.machine.index for body in _BODIES):
        raise CraneError(
            f"{crane.name}: the paper's experiment is that of a PATU 655, with the states {' '.join(STATES)}. Give a "
            "crane file of that machine, without effects that add states; `patu montecarlo` takes any machine."
        )


def check_inputs(inputs: int) -> None:
    """Raise CraneError for an input set that is none of `INPUT_SETS`."""
    if inputs not in INPUT_SETS:
        raise CraneError(f"There is no input set {inputs}. Use one of {', '.join(map(str, INPUT_SETS))}.")


def check_error(model_error: float) -> None:
    """Raise CraneError for a relative error of masses that is not from 0 to below 1."""
    if not 0.0 <= model_error < 1.0:
        raise CraneError(f"A model error of {model_error:g}: give a share between 0 and 1, such as 0.15 for 15 %.")


def wrong_crane(crane: Crane, model_error: float) -> Crane:
    """Return the estimation model: `crane` with the paper's errors; `model_error` is that of the booms' mass and
    inertia.

    Raises:
        CraneError: another machine than the paper's.
    """
    check_machine(crane)
    changes = {"payload.mass": _PAYLOAD, "supply.pump_pressure": crane["supply.pump_pressure"] + _PUMP_ERROR}
    for bodies, factor in (_BODIES[:2], 1 + model_error), (_BODIES[2:], 1.05):
        for name in (f"bodies.{b}.{q}" for b in bodies for q in ("mass", "inertia")):
            changes[name] = crane[name] * factor
    for joint in "ABCD":
        changes[f"joints.{joint}.x"] = crane[f"joints.{joint}.x"] + _JOINT_ERROR
        changes[f"joints.{joint}.y"] = crane[f"joints.{joint}.y"] - _JOINT_ERROR
    return crane.with_parameters(changes)


def unknowns(crane: Crane, width: float = 1.0) -> tuple[Augment, ...]:
    """Return what the estimator's own tuning estimates along with the state, for an estimation model.

    Payload, pump, masses and inertias of the booms, coordinates of the joints, each with `width` times the standard
    deviation that the crane file states; a payload that the file calls unknown has that of its range. Nothing is taken
    from the errors that the experiment makes. Every quantity drifts by a thousandth of its uncertainty per √s, for what
    is not among them, so that the filter never becomes surer than its model is right.
    """
    masses = [f"bodies.{b}.{q}" for b in ("lift_boom", "outer_boom") for q in ("mass", "inertia")]
    joints = [f"joints.{j}.{axis}" for j in "ABCD" for axis in "xy"]
    unstated = [n for n in ("supply.pump_pressure", "payload.mass", *masses, *joints) if n not in crane.uncertainty]
    if unstated:
        raise CraneError(
            f"{crane.name} states no uncertainty of {', '.join(unstated)}, which the own tuning needs. "
            "Add it to [uncertainty]."
        )
    std = {n: width * crane.uncertainty[n].std for n in ("supply.pump_pressure", *masses, *joints)}
    load = crane.uncertainty["payload.mass"]
    std["payload.mass"] = load.std if np.isfinite(load.std) else (load.upper - load.lower) / np.sqrt(12.0)
    return tuple(Augment(name, value, drift=_DRIFT * value) for name, value in std.items())


@dataclass(frozen=True)
class Experiment:
    """The real system's run: time (N,), commands (N, 2), inputs (N, 4), states (N, 8), noisy measurements as signals,
    and their noise in SI.
    """

    crane: Crane
    time: np.ndarray
    commands: np.ndarray
    inputs: np.ndarray
    truth: np.ndarray
    signals: Signals
    sensors: Mapping[str, float]

    def seen(self, sensors: Mapping[str, float], seed: int) -> Experiment:
        """Return the same run as other sensors show it: channels with their noise in SI."""
        shown = noisy_sensors(self.crane, self.time, self.truth, np.random.default_rng(seed), sensors)
        return replace(self, signals=replace(self.signals, sensors=shown), sensors=dict(sensors))


@dataclass(frozen=True)
class Case:
    """One run of the experiment.

    Attributes:
        model_error, inputs, tuning, engine: which case it is; tuning is one of `TUNINGS`, or what the filter is called.
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
        """PN-RMSE of the estimate in %, by state; NaN for a state that does not move."""
        return self._percent(self.estimate.mean[:, :8])

    @property
    def rmse(self) -> dict[str, float]:
        """RMSE of the estimate in SI, by state."""
        return _named(metrics.rmse(self.estimate.mean[:, :8], self.experiment.truth))

    @property
    def pn_rmse_open_loop(self) -> dict[str, float]:
        """PN-RMSE of the simulation model in %, by state."""
        return self._percent(self.open_loop)

    def _percent(self, states: np.ndarray) -> dict[str, float]:
        return percent_errors(states, self.experiment.truth, STATES, self.experiment.crane.layout)

    @property
    def published(self) -> dict[str, float] | None:
        """The published row, where there is one for this case (it is for the whole cycle)."""
        return PUBLISHED if (self.model_error, self.inputs) == (0.15, 1) else None

    @property
    def coverage(self) -> dict[str, float]:
        """Share of time in which the truth is inside the 95 % interval, by state."""
        return self.estimate.coverage(self.experiment.truth)

    @property
    def width(self) -> dict[str, float]:
        """Half the mean width of the 95 % interval over the RMS error, by state; 2 where a filter errs as it believes,
        less where its belief changes much in a run.
        """
        half = 1.96 * self.estimate.std[:, :8].mean(axis=0)
        return _named(half / metrics.rmse(self.estimate.mean[:, :8], self.experiment.truth))

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
            "pn_rmse": or_none(self.pn_rmse),
            "rmse": self.rmse,
            "sensors": dict(self.experiment.sensors),
            "published": self.published,
            "pn_rmse_open_loop": or_none(self.pn_rmse_open_loop),
            "coverage95": self.coverage,
            "width95": self.width,
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


def or_none(values: Mapping[str, float]) -> dict[str, float | None]:
    """Return numbers for JSON, which has no NaN."""
    return {name: value if np.isfinite(value) else None for name, value in values.items()}


def percent_errors(estimate: np.ndarray, truth: np.ndarray, names: Sequence[str], layout: Layout) -> dict[str, float]:
    """Return the PN-RMSE in % of states (N, n) by name; NaN where the range is too small to divide by."""
    noise = sensors_of([n for n in names if n in layout.sensors], {}, layout)
    least = np.array([2.0 * noise.get(n, 0.0) for n in names])
    moves = np.ptp(truth, axis=0) > least
    return dict(zip(names, np.where(moves, metrics.pn_rmse(estimate, truth), np.nan).tolist(), strict=True))


def _named(values: np.ndarray) -> dict[str, float]:
    return dict(zip(STATES, values.tolist(), strict=True))


def real_system(
    crane: Crane,
    inputs: int,
    engine: str,
    seed: int,
    duration: float = DURATION,
    sensors: Mapping[str, float] = SENSOR_STD,
) -> Experiment:
    """Return a run of the synthetic real system and its noisy sensors: channels with their noise in SI.

    Raises:
        CraneError: an input set that does not exist, or another machine than the paper's.
    """
    check_machine(crane)
    check_inputs(inputs)
    time = np.arange(round(duration / STEP) + 1) * STEP
    commands = INPUT_SETS[inputs](time)
    w = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    model = engine_of(engine, crane)
    truth = visible(crane, model.simulate(model.static_start(*crane.initial.pose), time, w, step=STEP))
    blank = Experiment(crane, time, commands, w, truth, Signals(time, commands, {}, name=f"input set {inputs}"), {})
    return blank.seen(sensors, seed)


def noisy_sensors(
    crane: Crane,
    time: np.ndarray,
    truth: np.ndarray,
    rng: np.random.Generator,
    sensors: Mapping[str, float] = SENSOR_STD,
) -> dict[str, Series]:
    """Return what sensors (channels with their noise in SI) show of states (N, nx) at `time` (N,)."""
    shown = Measurement.of(crane, tuple(sensors)).shown(truth, time, settled=True)
    return {n: (time, y + s * rng.normal(size=time.size)) for (n, s), y in zip(sensors.items(), shown.T, strict=True)}


def sensors_of(names: Sequence[str], noise: Mapping[str, float], layout: Layout) -> dict[str, float]:
    """Return {channel: noise in SI} of some sensors: as given, else the paper's for the channel's unit, else a usual
    one.

    Raises:
        CraneError: an unknown sensor, or noise of one that is not used.
    """
    for name in (*names, *noise):
        sensor(name, layout.sensors)
        if name not in names:
            raise CraneError(
                f"There is a noise for {name}, but no such sensor among {', '.join(names)}. Add it to the sensors."
            )
    known = {n: layout.sensors[n] for n in names}
    return {n: float(noise.get(n, SENSOR_STD.get(n, _NOISE.get(s.unit, s.sizes.noise)))) for n, s in known.items()}


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


def estimator(
    wrong: Crane,
    experiment: Experiment,
    engine: Any,
    tuning: str,
    method: str | None = None,
    width: float | None = None,
) -> Estimator:
    """Return the estimator of one of the `TUNINGS` for the estimation model.

    Args:
        wrong, experiment, engine: the estimation model, what it sees, and what runs it.
        tuning: name of the tuning.
        method: the filter; None for the tuning's.
        width: of the priors of the own tuning, in parts of the crane file's uncertainties; None for `likeliest_width`.

    Raises:
        CraneError: no such tuning.
    """
    mean, method = experiment.truth[0] + START_ERROR, method or tuning_of(tuning).method
    if not tuning_of(tuning).widths:
        start = Belief(mean, paper_start_covariance())
        return Estimator(wrong, engine, experiment.sensors, PaperNoise(), method, start=start, gate=None, max_step=STEP)
    start = Belief(mean, np.diag(_START_STD**2))
    creep = tuple((_CREEP * _START_STD[:2]) ** 2)
    noise = ProcessNoise((1e-5, 1e-5), (1e7, 1e7, 1e7, 1e7), creep)
    augment = unknowns(wrong, likeliest_width(wrong, experiment, tuning) if width is None else width)
    revisit = _REVISIT if method == "ekf" else None
    return Estimator(
        wrong, engine, experiment.sensors, noise, method, augment, start=start, max_step=STEP, revisit=revisit
    )


def likeliest_width(wrong: Crane, experiment: Experiment, tuning: str) -> float:
    """Return that of a tuning's widths under which the innovations of the first motion are likeliest.

    The tuning's filter on the semi-recursive engine decides, for every method and engine: the engines agree to four
    digits. It goes through nothing again, which moves the likelihoods of all widths alike.
    """
    widths = tuning_of(tuning).widths
    if len(widths) < 2:
        return widths[0] if widths else 1.0
    part, engine = cut(experiment.signals, 0.0, _LISTENING), engine_of("semi-recursive", wrong)
    filters = {w: estimator(wrong, experiment, engine, tuning, width=w).varied(revisit=None) for w in widths}
    tried = {w: filter_.run(part).log_likelihood for w, filter_ in filters.items()}
    return max(tried, key=tried.__getitem__)


def tuning_of(name: str) -> Tuning:
    """Return a tuning by its name. Raises CraneError where there is none."""
    if name not in TUNINGS:
        raise CraneError(f"There is no tuning {name!r}. Use one of {', '.join(TUNINGS)}.")
    return TUNINGS[name]


#: makes a filter for the estimation model, the real system as it was seen, and an engine of that model
MakeFilter = Callable[[Crane, Experiment, Any], Estimator]


def run_case(
    model_error: float = 0.15,
    inputs: int = 1,
    engine: str = "exudyn",
    seed: int = 0,
    *,
    tuning: str = "paper",
    filter: str | MakeFilter | None = None,
    sensors: Sequence[str] = tuple(SENSOR_STD),
    noise: Mapping[str, float] | None = None,
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
        tuning: one of `TUNINGS`: "paper", or "own" for the estimator's own tuning.
        filter: one of `ukf.methods.METHODS`, or a function that makes a filter of one's own (which the tuning has no
            part in); None for the tuning's.
        sensors: channels that the filter gets.
        noise: their noise in SI where it is not the paper's (1°, 1.5 bar).
        crane: the real system; default the built-in crane.
        duration: length of the run, s.
        experiment, open_loop: what an earlier case has computed already for the same engine, inputs, seed and error.
        progress: called with the fraction of the filter's run that is done.

    Raises:
        CraneError: another machine than the paper's, an unknown sensor, input set, tuning or filter.
    """
    crane = crane if crane is not None else Crane.load("patu655")
    check_machine(crane)
    gauges = tuning_of(tuning).gauges
    own = {n: gauges for n in sensors if gauges is not None and crane.layout.sensors[n].unit == "Pa"} | dict(
        noise or {}
    )
    believed = sensors_of(sensors, own, crane.layout)
    if experiment is None:
        experiment = real_system(crane, inputs, engine, seed, duration, believed)
    elif dict(experiment.sensors) != believed:
        experiment = experiment.seen(believed, seed)
    wrong = wrong_crane(crane, model_error)
    open_loop = open_loop if open_loop is not None else simulation_model(wrong, experiment, engine)
    model, used = engine_of(engine, wrong), engine
    if TUNINGS[tuning].widths and not accepts_parameters(model):
        model, used = engine_of("semi-recursive", wrong), "semi-recursive"
    filter_ = (
        filter(wrong, experiment, model) if callable(filter) else estimator(wrong, experiment, model, tuning, filter)
    )
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
        return min(
            (d["realtime_factor"] for d in self.documents if d["tuning"].startswith("paper")), default=float("nan")
        )

    def document(self) -> dict[str, Any]:
        """Return the result as JSON."""
        return {"cases": list(self.documents), "realtime_factor": self.realtime_factor, "seconds": self.seconds}


def reproduce(
    model_errors: Sequence[float] = MODEL_ERRORS,
    inputs: Sequence[int] = tuple(INPUT_SETS),
    engine: str = "exudyn",
    seed: int = 0,
    *,
    tunings: Sequence[str] = ROWS,
    sensors: Sequence[str] = tuple(SENSOR_STD),
    noise: Mapping[str, float] | None = None,
    crane: Crane | None = None,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
) -> Reproduction:
    """Return the paper's table: every model error with every input set, by every tuning.

    Args:
        jobs: processes; one error with one input set is one piece of work.
    """
    begin = clock.perf_counter()
    crane = crane if crane is not None else Crane.load("patu655")
    work = [(error, i) for i in inputs for error in model_errors]
    seen = {"sensors": tuple(sensors), "noise": dict(noise or {})}
    tasks = [(all_tunings, error, i, engine, seed, tuple(tunings), crane, seen) for error, i in work]
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


def all_tunings(
    error: float, inputs: int, engine: str, seed: int, tunings: tuple[str, ...], crane: Crane, seen: Mapping[str, Any]
) -> tuple[list[dict[str, Any]], dict[str, Case]]:
    """Return the documents of one error and input set, and the cases themselves where figures show them."""
    experiment = real_system(crane, inputs, engine, seed)
    open_loop = simulation_model(wrong_crane(crane, error), experiment, engine)
    documents, shown = [], {}
    for tuning in tunings:
        case = run_case(
            error, inputs, engine, seed, tuning=tuning, crane=crane, experiment=experiment, open_loop=open_loop, **seen
        )
        documents.append(case.document())
        if (error, inputs) == (0.15, 1):
            shown[tuning] = case
    return documents, shown


@dataclass(frozen=True)
class SensorSetResult:
    """What the filter finds with a set of sensors: the payload, mean and standard deviation in kg at `INSTANTS`, and
    PN-RMSE in % by state.
    """

    sensors: tuple[str, ...]
    payload: tuple[tuple[float, float], ...]
    pn_rmse: dict[str, float]

    def document(self) -> dict[str, Any]:
        """Return the row as JSON."""
        return {
            "sensors": list(self.sensors),
            "payload": [list(p) for p in self.payload],
            "pn_rmse": or_none(self.pn_rmse),
        }


#: s at which the payload is given, and the sensors beside the paper's
INSTANTS = (5.0, 10.0, 25.0)
_MORE: tuple[tuple[str, ...], ...] = ((), ("p2",), ("p3",), ("p2", "p3"), ("dz1", "dz4"))


def what_sensors_tell(
    engine: str = "exudyn",
    seed: int = 0,
    *,
    crane: Crane | None = None,
    jobs: int = 1,
    progress: Callable[[float], None] | None = None,
) -> list[SensorSetResult]:
    """Return what the paper's four sensors tell of the 15 % case with the estimator's own tuning, and what more sensors
    would.
    """
    crane = crane if crane is not None else Crane.load("patu655")
    experiment = real_system(crane, 1, engine, seed)
    tasks = [(_result_with, engine, seed, crane, experiment, (*SENSOR_STD, *more)) for more in _MORE]
    found = []
    for result in results_of(tasks, jobs):
        found.append(result)
        if progress is not None:
            progress(len(found) / len(tasks))
    return sorted(found, key=lambda t: _MORE.index(t.sensors[len(SENSOR_STD) :]))


def _result_with(
    engine: str, seed: int, crane: Crane, experiment: Experiment, sensors: tuple[str, ...]
) -> SensorSetResult:
    case = run_case(
        0.15,
        1,
        engine,
        seed,
        tuning="own",
        sensors=sensors,
        crane=crane,
        experiment=experiment,
        open_loop=experiment.truth,
    )
    at, column = np.searchsorted(experiment.time, INSTANTS), case.estimate.state_names.index("payload.mass")
    at = np.minimum(at, experiment.time.size - 1)
    payload = zip(case.estimate.mean[at, column].tolist(), case.estimate.std[at, column].tolist(), strict=True)
    return SensorSetResult(sensors, tuple(payload), case.pn_rmse)


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
