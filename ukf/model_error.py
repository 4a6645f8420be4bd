"""What the model may be wrong about, as states with a memory whose sizes the innovations tell.

Process noise that is white says that a model errs anew at every instant, and averages out. Errors of a model do not: a
leak, a load or a valve that is not as the file says acts for seconds in one direction, and what no sensor measures
follows it. So the filter estimates along with the state what may act so, each unknown as first-order Gauss-Markov
noise; "When the model is wrong" in docs/estimator.md has the table of them.

How large each is follows from the recording: the sizes, and the white noise beside them, are those under which the
innovations are most likely (`replay`), held back from leaving what is expected by a prior: of one and a half powers of
ten for a model, of half a one for sensors and what the crane file calls unknown. Then each size is widened by a quarter
of a power of ten, or as much less as leaves the innovations nearly as likely: they tell of an unknown what it does to
the sensors, and what is not measured may suffer more. With a model that is right all sizes fall, and the intervals are
those of the filter without them.

Where all pressures were measured once, more is known than that: `lasting` finds sizes and memories from all sensors,
a crane file keeps them under [model_error], and these are then what is expected.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.description import GaussMarkov
from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.geometry import pose
from crane_exudyn.static_start import static_start

from .augment import Augment, resolve, unit_of
from .considered import consider
from .estimate import Account, Estimate
from .estimator import Estimator, sensor_std
from .noise import ProcessNoise
from .replay import Replay
from .side_by_side import SideBySide
from .signals import Signals
from .tuning import busiest, cut, descend, limits_of, logs_of, noise_of

#: (size that is expected, memory in s) of a moment, in parts of what the joint's cylinder can do; of a flow, in parts
#: of the valve's under full pump pressure; of a flow coefficient, the pump pressure and a volume of hoses, in parts of
#: each; of an offset of a pressure sensor and of any other, in parts of the sensor's noise
_MOMENT, _FLOW, _VALVE, _PUMP, _HOSES = (0.05, 10.0), (0.005, 3.0), (0.1, 3.0), (0.05, 3.0), (0.5, 1.0)
_GAUGE, _OTHER = (1.0 / 3.0, 10.0), (1.0 / 3.0, 0.2)
#: the same of how the bulk modulus of the oil walks away from a constant error, which the crane file states: by how
#: fast a boom rings the filter weighs its load
_OIL, _SOFT = "fluid.oil_bulk_modulus", (0.05, 3.0)
#: standard deviations of priors, powers of ten: of how wrong a model is; of what a sensor errs by, which its noise
#: states, of what the crane file calls unknown, and of a memory; and of the white noise; by how much sizes are widened
#: afterwards. Most of a wrong model is right, so that sizes scatter widely: by 1.5, found with a prior of 1.5; by 1.1
#: with 0.5, by 1.7 with 3
_MODEL, _ELSE, _PRIOR_NOISE, _WIDENED = 1.5, 0.5, 3.0, 0.25
#: shares of that that are tried, the widest first
_SHARES = (1.0, 0.75, 0.5, 0.25)
#: largest offset of a sensor in parts of its noise; and of a gauge where a crane file is to tell of the model: what is
#: held against a gauge is lost there, and no recording tells a gauge that drifts from a moment that does
_DRIFT, _STEADY = 30.0, 1.0 / 3.0
#: how far below what is expected a size is searched, powers of ten
_BELOW = -4.0
#: unknowns whose size is so many powers of ten below what is expected are left out
_NOTHING = -2.5
#: log-likelihood a sample that widened sizes may cost
_PRICE = 0.02
#: first step of the search in each run that is replayed, powers of ten, and what a round of it must gain in
#: log-likelihood
_STEPS, _GAIN = (1.0, 0.5), 0.5
#: time constant of sizes in live use, s
_ADAPT = 4.0
#: shortest memory of a moment that is searched, s: inertia swings within it; friction that reverses does so sooner, but
#: then stays as long as a motion
_QUICK = 1.0
#: least share of what is expected of any model that a crane file keeps, one standard deviation of the prior: the next
#: run finds the model wrong elsewhere
_LEAST = 10.0**-_MODEL
#: how much of a recording the search uses, around its busiest part, s: before an estimate, and for a crane file
_SECONDS, _LONG = 10.0, 60.0
#: what `patu estimate --model-error` may say
MODES = ("auto", "off", "on")
#: most samples a second and longest integration step that the search uses
_RATE, _STEP = 100.0, 5e-3
#: standard deviation of a pressure that no sensor shows at the start, in parts of the pump pressure: the balance of
#: moments may be wrong
_PRESSURE = 0.3


@dataclass(frozen=True)
class Unknown:
    """Quantities that share a size: their names, the size that is expected (SI), how long they last (s), the largest
    size, a part that stays, of which the size says nothing, the shortest memory that is searched (s; infinite: none
    is), whether it is left out where the innovations are as likely without it, where it begins (None: as the crane file
    says), and by how many powers of ten the expected size may be off.

    With a part that stays it is a random walk from there, as fast as noise of that size and memory is at first.
    """

    names: tuple[str, ...]
    size: float
    memory: float
    most: float
    stays: float = 0.0
    least: float = np.inf
    spared: bool = False
    begins: float | None = None
    prior: float = _MODEL

    def augments(self, size: float) -> tuple[Augment, ...]:
        """Return the quantities as states of the filter, of a given size."""
        if self.stays:
            pace, std = size * np.sqrt(2.0 / self.memory), float(np.hypot(size, self.stays))
            return tuple(Augment(n, std, drift=pace) for n in self.names)
        return tuple(Augment(n, size, 0.0, self.memory, self.names[0], self.begins) for n in self.names)


@dataclass(frozen=True)
class ModelError:
    """What the filter estimates along with the state because the model may be wrong, with sizes.

    Attributes:
        unknowns, sizes: what may be wrong, and how large each is (SI).
        noise: the white noise beside them.
        pressure_std: of a pressure that no sensor shows, at the start, Pa.
    """

    unknowns: tuple[Unknown, ...]
    sizes: tuple[float, ...]
    noise: ProcessNoise
    pressure_std: float

    @property
    def augment(self) -> tuple[Augment, ...]:
        """The unknowns as states of the filter."""
        pairs = zip(self.unknowns, self.sizes, strict=True)
        return tuple(a for unknown, size in pairs for a in unknown.augments(size))

    def behind(self, plain: Estimator) -> Estimator:
        """Return an estimator as `plain`, with these unknowns behind all that it estimates."""
        return plain.varied(noise=self.noise, augment=(*plain.augment, *self.augment), pressure_std=self.pressure_std)

    def __repr__(self) -> str:
        pairs = zip(self.unknowns, self.sizes, strict=True)
        listed = [f"{' '.join(u.names)} ± {size:.2g}" for u, size in pairs]
        return f"<ModelError: {', '.join(listed) or 'nothing'}>"


def unknowns(
    crane: Crane, sensors: Mapping[str, float], without: Collection[str] = (), drift: float = _DRIFT
) -> tuple[Unknown, ...]:
    """Return what may be wrong about a crane's model and its sensors, with the sizes that are expected; `without` some
    names.

    `sensors` are channels with the standard deviation of their noise, SI; `drift` is the largest offset of a gauge in
    parts of that.
    """
    lay, pump = crane.layout, crane["supply.pump_pressure"]
    found = [
        Unknown((name,), *_share(most, _MOMENT), most, stays)
        if stays > _MOMENT[0] * most
        else Unknown((name,), *_share(most, _MOMENT), most, least=_QUICK)
        for name, most, stays in zip(lay.torques, _moments(crane), filed_moments(crane), strict=True)
    ]
    for cylinder, sides in zip(lay.cylinders, lay.sides, strict=True):
        valve = f"valves.{cylinder}.flow_coefficient"
        hoses = tuple(f"cylinders.{cylinder}.hose_volume_{side}" for side in ("piston", "rod"))
        flow, volume = crane[valve] * np.sqrt(pump), float(np.mean([crane[h] for h in hoses]))
        found += [
            Unknown(tuple(f"flow.{chamber}" for chamber in sides), *_share(flow, _FLOW), flow),
            Unknown((valve,), *_share(crane[valve], _VALVE), crane[valve]),
            Unknown(hoses, *_share(volume, _HOSES), volume),
        ]
    found.append(Unknown(("supply.pump_pressure",), *_share(pump, _PUMP), pump))
    gauges = [n for n in sensors if lay.sensors[n].unit == "Pa"]
    found = [_as_filed(u, crane) for u in found]
    if np.isfinite(soft := _filed(crane, _OIL)) and soft > 0.0:
        found.append(Unknown((_OIL,), *_share(crane[_OIL], _SOFT), crane[_OIL] / 2.0, soft))
    found += [Unknown((f"bias.{n}",), *_share(sensors[n], _GAUGE), drift * sensors[n], prior=_ELSE) for n in gauges]
    others = [n for n in sensors if n not in gauges]
    found += [Unknown((f"bias.{n}",), *_share(sensors[n], _OTHER), _DRIFT * sensors[n], prior=_ELSE) for n in others]
    found += [
        Unknown((e.name,), e.std, np.inf, 10.0 * e.std, spared=True, prior=_ELSE)
        for e in resolve(crane, _openly_unknown(crane))
    ]
    return tuple(u for u in found if u.size > 0.0 and not set(u.names) & set(without))  # machines without hoses


def _share(whole: float, kind: tuple[float, float]) -> tuple[float, float]:
    """Return the size and the memory of an unknown of a kind."""
    return kind[0] * whole, kind[1]


def _filed(crane: Crane, name: str) -> float:
    """Return the standard uncertainty that a crane file states of a parameter; NaN for none."""
    return crane.uncertainty[name].std if name in crane.uncertainty else np.nan


def _openly_unknown(crane: Crane) -> list[str]:
    """Return the nominal parameters of which the crane file knows a range at most."""
    return [n for n, known in crane.uncertainty.items() if not np.isfinite(known.std) and n in crane.machine.index]


def _as_filed(unknown: Unknown, crane: Crane) -> Unknown:
    """Return an unknown with the size and memory that the crane file gives it, if it does."""
    known = crane.model_error.get(unknown.names[0])
    if known is None:
        return unknown
    return replace(unknown, size=min(known.std, unknown.most), memory=known.memory, stays=0.0)


def _moments(crane: Crane) -> list[float]:
    """Return the moment (N m; sliding: force, N) that each joint's cylinder can do under pump pressure, in the pose to
    start with.
    """
    pump, (own, arms) = crane["supply.pump_pressure"], _own_arms(crane)
    return [
        pump * crane.areas(crane.layout.cylinders[c])[0] * abs(float(arm)) for c, arm in zip(own, arms, strict=True)
    ]


def _own_arms(crane: Crane) -> tuple[list[int], np.ndarray]:
    """Return the number of each joint's own cylinder, and its arm (coordinates,), m (sliding: 1), in the pose to start
    with.
    """
    own = [crane.layout.driven.index(name) for name in crane.layout.coordinates]
    return own, pose(crane, *crane.initial.pose).length_rates[0][own, range(len(own))]


def filed_moments(crane: Crane) -> list[float]:
    """Return the standard deviation (N m; sliding: N) of each joint's balance at rest, in the pose to start with, by
    what the crane file says of the uncertainty of its parameters.
    """
    held_by = _holding_moments(crane)
    squares = np.zeros(len(crane.layout.coordinates))
    for name, known in crane.uncertainty.items():
        if np.isfinite(known.std) and name in crane.machine.index:
            # a parameter with which the machine cannot stand there tells nothing
            with suppress(CraneError):
                squares += (_holding_moments(crane.with_parameters({name: crane[name] + known.std})) - held_by) ** 2
    return np.sqrt(squares).tolist()


def _holding_moments(crane: Crane) -> np.ndarray:
    """Return the moments (coordinates,) by which the pressures hold a crane at rest in the pose to start with, as far
    as its own cylinder does for each joint.
    """
    lay, rule = crane.layout, crane.initial
    pressures = static_start(crane, *rule.pose, less_loaded=rule.less_loaded_pressure)[lay.pressures]
    areas = np.array([crane.areas(n) for n in lay.cylinders])
    forces = np.sum(areas * [1.0, -1.0] * pressures.reshape(areas.shape), axis=1)
    own, arms = _own_arms(crane)
    return arms * forces[own]


def expected(
    crane: Crane, sensors: Mapping[str, float], without: Collection[str] = (), drift: float = _DRIFT
) -> ModelError:
    """Return the model error with the sizes that are expected; arguments as of `unknowns`."""
    found = unknowns(crane, sensors, without, drift)
    noise, pressure = ProcessNoise.of(crane.layout), _PRESSURE * crane["supply.pump_pressure"]
    return ModelError(found, tuple(u.size for u in found), noise, pressure)


def live(plain: Estimator, adapt: float = _ADAPT) -> Estimator:
    """Return an estimator like `plain` that allows for errors of the model, for live use.

    Nothing has been recorded yet, so the sizes begin wide and follow what is found with a time constant `adapt`, s.
    """
    first = expected(plain.crane, plain.std_of, _names(plain.augment))
    start = _Search(replace(first, unknowns=tuple(replace(u, stays=0.0) for u in first.unknowns)))
    return start.widened(start.first).behind(plain).varied(adapt=adapt)


def _names(augment: Iterable[Any]) -> list[str]:
    return [a if isinstance(a, str) else a.name for a in augment]


def find(
    crane: Crane,
    recording: Any,
    sensors: Mapping[str, float],
    *,
    engine: Any = "semi-recursive",
    augment: tuple[Any, ...] = (),
    seconds: float = _SECONDS,
    progress: Callable[[float], None] | None = None,
) -> ModelError:
    """Return the model error under which the innovations of a recording are most likely, with its sizes widened.

    Args:
        crane: the model.
        recording: a Recording or Signals.
        sensors: channels with noise standard deviations (SI).
        augment: quantities that are estimated in any case.
        seconds: how much of the recording is used, around its busiest part.
        progress: called with the fraction done.
    """
    search, logs, replay = _searched(crane, recording, sensors, engine, augment, seconds, progress)
    return search.widened(logs, search.widening(replay, logs))


def lasting(
    crane: Crane,
    recordings: Sequence[tuple[Any, Mapping[str, float]]],
    *,
    engine: Any = "semi-recursive",
    progress: Callable[[float], None] | None = None,
) -> dict[str, GaussMarkov]:
    """Return the sizes and memories of what is wrong about the model itself, as a crane file keeps them: those under
    which the innovations of a recording are most likely, but a thirtieth of what is expected at least; of several
    recordings the geometric mean.

    Of use where pressures are measured that an estimate later does without. What the sensors err by, and what the file
    calls unknown, is of these recordings and not told.

    Args:
        crane: the model.
        recordings: each with its sensors and their noise standard deviations (SI).
        progress: called with the fraction done.
    """
    crane = replace(crane, model_error={})
    lasts = set(crane.layout.disturbances) | set(crane.machine.index) - {*_openly_unknown(crane), _OIL}
    found: dict[str, list[tuple[float, float]]] = {}
    for k, (recording, sensors) in enumerate(recordings):
        done = None if progress is None else partial(_share_of, progress, k, len(recordings))
        search, logs, _ = _searched(crane, recording, sensors, engine, (), _LONG, done, _STEADY)
        model, usual = search.model_error(logs), search.start.sizes
        for unknown, size, expected_size in zip(model.unknowns, model.sizes, usual, strict=True):
            if unknown.names[0] in lasts:
                found.setdefault(unknown.names[0], []).append((max(size, _LEAST * expected_size), unknown.memory))
    means = {name: np.exp(np.log(pairs).mean(axis=0)) for name, pairs in found.items()}
    return {name: GaussMarkov(*(float(f"{m:.3g}") for m in mean)) for name, mean in means.items()}


def _share_of(progress: Callable[[float], None], k: int, count: int, done: float) -> None:
    progress((k + done) / count)


def _searched(
    crane: Crane,
    recording: Any,
    sensors: Mapping[str, float],
    engine: Any,
    augment: tuple[Any, ...],
    seconds: float,
    progress: Callable[[float], None] | None,
    drift: float = _DRIFT,
) -> tuple[_Search, np.ndarray, Replay]:
    """Return the search, the most likely logarithms, and the last run in which they were searched."""
    std = sensor_std(crane, sensors)
    signals = recording if isinstance(recording, Signals) else Signals.of(recording, crane)
    piece = busiest(signals, seconds).thinned(_RATE, crane.layout)
    search = _Search(expected(crane, std, _names(augment), drift))
    logs = search.first
    for k, step in enumerate(_STEPS):
        if progress is not None:
            progress(k / len(_STEPS))
        now = search.model_error(logs)
        estimator = now.behind(Estimator(crane, engine, std, augment=augment, max_step=_STEP))
        replay = Replay(estimator, piece, estimator.extras[len(augment) :])
        logs = search.climb(replay, logs, step)
        search.begin_again(crane, dict(zip(estimator.state_names[-len(replay.ended) :], replay.ended, strict=True)))
    return search, search.sparing(replay, logs), replay


class _Search:
    """The search over the logarithms [size of each unknown over what is expected, memory of those that may fade faster
    over what is expected, white noise as in `tuning`].
    """

    def __init__(self, start: ModelError) -> None:
        self.start, self.count = start, len(start.unknowns)
        self._fading = [k for k, u in enumerate(start.unknowns) if u.least < u.memory < np.inf]
        noise = logs_of(start.noise)
        self.first = np.concatenate([np.zeros(self.count + len(self._fading)), noise])
        self._width = np.array(
            [*(u.prior for u in start.unknowns), *[_ELSE] * len(self._fading), *[_PRIOR_NOISE] * noise.size]
        )
        self._most = np.log10([u.most / u.size for u in start.unknowns])
        sizes = [(_BELOW, float(most)) for most in self._most]
        memories = [(float(np.log10(u.least / u.memory)), 0.0) for u in (start.unknowns[k] for k in self._fading)]
        self._limits = [*sizes, *memories, *limits_of(noise)]

    def model_error(self, logs: np.ndarray) -> ModelError:
        """Return the model error of some logarithms."""
        found, near = list(self.start.unknowns), self.count + len(self._fading)
        for k, e in zip(self._fading, logs[self.count : near], strict=True):
            found[k] = replace(found[k], memory=float(found[k].memory * 10.0**e))
        sizes = tuple(float(u.size * 10.0**e) for u, e in zip(found, self._sizes(logs), strict=True))
        return ModelError(tuple(found), sizes, noise_of(logs[near:]), self.start.pressure_std)

    def _sizes(self, logs: np.ndarray) -> np.ndarray:
        """Return the logarithms of the sizes over what is expected.

        What innovations tell of an unknown is how fast it changes, size²/memory; the search keeps that while it changes
        a memory.
        """
        sizes = logs[: self.count].copy()
        sizes[self._fading] += 0.5 * logs[self.count : self.count + len(self._fading)]
        return sizes

    def begin_again(self, crane: Crane, ended: Mapping[str, float]) -> None:
        """Begin what is openly unknown where a run ended, {name: value}: about a payload that is far off the slopes are
        others, and so are the pressures that hold it.
        """
        found = list(self.start.unknowns)
        for k, unknown in enumerate(found):
            if unknown.spared:
                known, value = crane.uncertainty[unknown.names[0]], ended[unknown.names[0]]
                found[k] = replace(unknown, begins=float(np.clip(value, known.lower, known.upper)))
        self.start = replace(self.start, unknowns=tuple(found))

    def climb(self, replay: Replay, logs: np.ndarray, step: float) -> np.ndarray:
        """Return the most likely logarithms, searched with steps from `step` down to a quarter of it."""

        def cost(trial: np.ndarray) -> float:
            off = (np.concatenate([self._sizes(trial), trial[self.count :]]) - self.first) / self._width
            return 0.5 * float(off @ off) - self._log_likelihood(replay, trial)

        return descend(cost, logs, cost(logs), self._limits, step=step, finest=step / 4, gain=_GAIN)[0]

    def sparing(self, replay: Replay, logs: np.ndarray) -> np.ndarray:
        """Return the logarithms without what is openly unknown, where the innovations are as likely without it.

        A payload that is as the file says may be told from one that is not, as a model from another: of how far it is
        off, if it is, the expected size says little.
        """
        for k, unknown in enumerate(self.start.unknowns):
            if unknown.spared:
                bare = logs.copy()
                bare[k] = _BELOW
                if self._log_likelihood(replay, bare) >= self._log_likelihood(replay, logs):
                    logs = bare
        return logs

    def _log_likelihood(self, replay: Replay, logs: np.ndarray) -> float:
        now = self.model_error(logs)
        return replay.log_likelihood(now.noise, now.augment)

    def widening(self, replay: Replay, logs: np.ndarray) -> float:
        """Return by how many powers of ten sizes may be widened before the innovations become less likely than that is
        worth.
        """
        least = self._log_likelihood(replay, logs) - _PRICE * replay.used
        shares = (s for s in _SHARES if self._log_likelihood(replay, self._wide(logs, s * _WIDENED)) >= least)
        return _WIDENED * next(shares, 0.0)

    def _wide(self, logs: np.ndarray, by: float) -> np.ndarray:
        wide = logs.copy()
        wide[: self.count] = np.minimum(wide[: self.count] + by, self._most)
        return wide

    def widened(self, logs: np.ndarray, by: float = _WIDENED) -> ModelError:
        """Return the model error with sizes that are widened, without unknowns of no account."""
        wide = self._wide(logs, by)
        found = self.model_error(wide)
        sizes = self._sizes(wide)
        kept = [k for k, u in enumerate(found.unknowns) if sizes[k] > _NOTHING or u.stays]
        return ModelError(
            tuple(found.unknowns[k] for k in kept), tuple(found.sizes[k] for k in kept), found.noise, found.pressure_std
        )


#: makes a function that takes the fraction done of what its text says
Stage = Callable[[str], AbstractContextManager[Callable[[float], None]]]


@contextmanager
def _silent(_: str) -> Iterator[Callable[[float], None]]:
    yield lambda fraction: None


def mode_of(name: str) -> str:
    """Return a mode of `MODES` by its name. Raises CraneError where there is none."""
    if name not in MODES:
        raise CraneError(f"model error {name!r} is not known.{nearest(name, list(MODES))}")
    return name


def estimate(
    plain: Estimator,
    recording: Any,
    *,
    mode: str = "auto",
    smooth: bool = False,
    noise_slack: float = 0.0,
    stage: Stage = _silent,
) -> Estimate:
    """Return the estimate over a recording, with intervals that allow for an error of the model where the innovations
    ask for it.

    Args:
        plain: the estimator without model error.
        recording: a Recording or Signals.
        mode: "off"; "on", whatever the innovations say; or "auto": where the plain filter is not consistent. Where its
            innovations are larger than it believes or keep their sign they must not be less likely with model error,
            else they must be more likely.
        smooth: as of `Estimator.run`.
        noise_slack: as of `Estimate`.
        stage: shows progress.

    Raises:
        CraneError: no such mode, or as `Estimator.run`.
    """
    found = list[ModelError]()

    def wider() -> Estimate:
        with stage("Model error") as done:
            found.append(find(plain.crane, recording, plain.std_of, augment=plain.augment, progress=done))
        with stage("Estimate") as done:
            return _run(found[0].behind(plain), recording, smooth, noise_slack, done)

    def first() -> Estimate:
        with stage("Estimate") as done:
            return _run(plain, recording, smooth, noise_slack, done)

    result, account = _chosen(mode, first, wider)
    if mode != "off":
        with stage("Uncertainties of the crane file") as done:
            chosen = found[0] if account.used else ModelError((), (), plain.noise, plain.options.pressure_std)
            result = _widened(result, plain, chosen, recording, done)
    if account.used:
        return _without_unknowns(plain.crane, result, found[0], account)
    return replace(result, model_error=account)


def _widened(
    result: Estimate, plain: Estimator, error: ModelError, recording: Any, progress: Callable[[float], None]
) -> Estimate:
    """Return an estimate with wider intervals of what is openly unknown: what the filter knows of a payload it takes
    from masses, joints and oil that are not as the crane file says, and from unknowns that do not fade.

    A run of the same filter, with fewer samples on the fast engine, tells by how much.
    """
    crane = plain.crane
    rows = [k for k, n in enumerate(result.state_names) if n in _openly_unknown(crane)]
    if not rows or result.failed:
        return result
    signals = recording if isinstance(recording, Signals) else Signals.of(recording, crane)
    piece = cut(signals, float(signals.command_time[0]), _LONG).thinned(_RATE, crane.layout)
    coarse = Estimator(crane, "semi-recursive", plain.std_of, augment=plain.augment, max_step=_STEP)
    time, spread = consider(error.behind(coarse), piece, [result.state_names[k] for k in rows], progress)
    std = result.std.copy()
    for k, more in zip(rows, spread.T, strict=True):
        std[:, k] = np.hypot(std[:, k], np.interp(result.time, time, more))
    smoothed = result.smoothed
    if smoothed is not None:
        wide = smoothed.std.copy()
        wide[:, rows] = np.hypot(wide[:, rows], spread[-1])
        smoothed = replace(smoothed, std=wide)
    return replace(result, std=std, smoothed=smoothed)


def estimate_side_by_side(
    estimators: Mapping[str, Estimator],
    recording: Any,
    *,
    mode: str = "auto",
    noise_slack: float = 0.0,
    stage: Stage = _silent,
) -> Estimate:
    """Return the mixed estimate of several models, each with a model error of its own where the innovations ask for it;
    arguments as of `estimate`.
    """

    def mixed(filters: Mapping[str, Estimator]) -> Estimate:
        with stage("Estimate") as done:
            return replace(SideBySide(filters).run(recording, progress=done), noise_slack=noise_slack)

    def wider() -> Estimate:
        found = dict[str, Estimator]()
        for name, plain in estimators.items():
            with stage(f"Model error of {name}") as done:
                error = find(plain.crane, recording, plain.std_of, augment=plain.augment, progress=done)
            found[name] = error.behind(plain)
        return mixed(found)

    result, account = _chosen(mode, partial(mixed, estimators), wider)
    return replace(result, model_error=account)


def _chosen(mode: str, first: Callable[[], Estimate], wider: Callable[[], Estimate]) -> tuple[Estimate, Account]:
    """Return the estimate without or with model error, and why it is that one."""
    plain = None if mode_of(mode) == "on" else first()
    if plain is not None:
        why = "not asked for" if mode == "off" else unasked(plain)
        if why:
            return plain, Account(mode, False, why, {})
    second = wider()
    if plain is None:
        return second, Account(mode, True, "asked for", {})
    price = _PRICE * float(plain.dof.sum())
    if second.log_likelihood < plain.log_likelihood + (-price if lacking(plain) else price):
        why = f"the innovations are {'less' if lacking(plain) else 'not more'} likely with it"
        return plain, Account(mode, False, why, {})
    return second, Account(mode, True, f"without it, {plain.verdict}", {})


def _run(
    estimator: Estimator, recording: Any, smooth: bool, noise_slack: float, progress: Callable[[float], None]
) -> Estimate:
    result = estimator.run(recording, smooth=smooth, progress=progress)
    smoothed = result.smoothed and replace(result.smoothed, noise_slack=noise_slack)
    return replace(result, noise_slack=noise_slack, smoothed=smoothed)


def unasked(plain: Estimate) -> str:
    """Return why the innovations of a filter do not ask for model error, in words; "" where they do."""
    return plain.verdict if plain.unjudged or plain.consistent else ""


def lacking(plain: Estimate) -> bool:
    """Whether the innovations of a filter are those of a model that lacks something: too large, or they keep their
    sign.

    Where white noise was scaled up until it covers what the model lacks, they may be neither.
    """
    return plain.judgement in ("too narrow", "lacking")


def _without_unknowns(crane: Crane, result: Estimate, found: ModelError, account: Account) -> Estimate:
    """Return an estimate without the unknowns among its states, and with an account of them."""
    count = len(result.state_names) - len(found.augment)
    ends = {
        e.name: {
            "size": e.std,
            "nominal": e.value,
            "value": float(result.mean[-1, count + k]),
            "std": float(result.std[-1, count + k]),
            "unit": unit_of(e.name, crane.layout),
        }
        for k, e in enumerate(resolve(crane, found.augment))
    }
    return result.first(count, model_error=replace(account, found=ends))
