"""The estimator: a crane, an engine, a filter and sensors, live one sample at a time or over a whole recording.

estimator = Estimator(crane, engine="semi-recursive", sensors={"z1": 0.017, "z4": 0.017, "p1": 1.5e5, "p4": 1.5e5})
now = estimator.step((0.5, 0.0), {"z1": 0.17, "p1": 62e5})     # what is missing is missing
estimate = estimator.run(recording)                            # the whole state with intervals
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane, checked_crane
from crane_exudyn.engines import of_this_crane
from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.geometry import cylinder_lengths
from crane_exudyn.sensors import sensor
from crane_exudyn.static_start import static_start
from crane_exudyn.statics import vapour_pressure

from .agreed_start import agreed_start
from .augment import Augment, Sizes, resolve
from .bounds import Bounds, crane_bounds
from .channels import Channels
from .estimate import Estimate
from .filter import Belief, FilterError
from .live import Stream
from .methods import method_of
from .monitor import ABSENT, OUTLIER, USED, Doubt, Monitor
from .noise import ProcessNoise, SensorNoise, added_by
from .options import Options
from .process import EngineMisfit, Process, engine_of
from .recorder import Outcome, Recorder
from .revisit import Beginning, Revisit, Step
from .samples import command_of, first_stamp, number, positive, readings_of
from .second_opinion import SecondOpinion
from .signals import LONG_GAP, Plan, Signals
from .start import UNSHOWN, check_start, rivals, showing, start_belief, taken
from .visible import show

#: standard deviations of its noise above vapour pressure from which on a gauge shows that its chamber has no void
_CLEAR = 4.0
#: what a step of the filter may end in
_FAILURES = (FilterError, ArithmeticError, np.linalg.LinAlgError, CraneError)


@dataclass(frozen=True)
class Now:
    """What the estimator knows after one sample: SI units, names as in `Estimator.state_names`, pressures as gauges
    would show them.
    """

    time: float
    mean: np.ndarray
    std: np.ndarray
    innovation: Mapping[str, float]
    rejected: tuple[str, ...]
    nis: float
    names: tuple[str, ...]

    def __getitem__(self, name: str) -> float:
        """Return one estimated quantity by its name. Raises CraneError, which lists the names, for another one."""
        if name not in self.names:
            raise CraneError(f"There is no estimated quantity {name!r}.{nearest(name, list(self.names))}")
        return float(self.mean[self.names.index(name)])

    def __repr__(self) -> str:
        shown = ", ".join(f"{n} {self.mean[i]:.4g} ± {1.96 * self.std[i]:.2g}" for i, n in enumerate(self.names))
        return f"<t = {self.time:.3f} s: {shown}>"


class Estimator:
    """Estimates the crane's state (and what else is unknown) from commands and whatever sensors there are.

    Args:
        crane: the model that the filter believes in.
        engine: "exudyn", "semi-recursive", or an engine object with this crane.
        sensors: channels with their noise standard deviation in SI, or channel names alone (then the crane file's
            standard deviation, else a default of the channel's kind); by default all coordinates and the chambers that
            carry loads.
        noise: process noise with a method `covariance(dt)` -> (nx, nx); `noise.ProcessNoise` or `noise.PaperNoise`. nx
            may leave out the states that effects add.
        method: "ukf", "sr-ukf", "ckf", "simplex" or "ekf".
        augment: quantities to estimate along with the state, see `augment`.
        start: mean and covariance (nx, …) of the state to start with; without it, pose, rates and pressures as the
            sensors first show them.
        gate: how many standard deviations an innovation may leap before the sample is rejected; None for no gate.
        max_step: longest integration step of the engine, s; longer intervals are cut evenly.
        pressure_std: standard deviation at the start of a pressure that no sensor shows, Pa.
        adapt: time constant, s, with which the sizes of unknowns with a memory follow what is found (`augment.Sizes`).
        strokes: whether angles stay where the pistons are inside their cylinders; without, a recording may pass a dead
            centre, and measured angles say on which side.
        revisit: when all samples since the start of a recording are processed again, linearised where the machine is
            now known to have been (`revisit`); in between, slopes are taken along the model's own trajectory from
            there (`methods.Linearised`). For the filter "ekf" only; live steps are never repeated.

    Raises:
        CraneError: an unknown sensor, filter, engine or quantity, an engine of another crane, a noise, a time or a gate
            that is not positive, or a noise or start of another shape.
    """

    def __init__(
        self,
        crane: Crane,
        engine: Any = "exudyn",
        sensors: Mapping[str, float] | Sequence[str] | str | None = None,
        noise: Any = None,
        method: str = "ukf",
        augment: Iterable[Augment | str] | Augment | str = (),
        *,
        start: Belief | None = None,
        gate: float | None = 6.0,
        max_step: float = 1e-3,
        pressure_std: float = UNSHOWN["Pa"],
        adapt: float = np.inf,
        strokes: bool = True,
        revisit: Revisit | None = None,
    ) -> None:
        self.crane = checked_crane(crane, "Estimator")
        self.engine = _engine_for(crane, engine)
        self.std_of = default_sensors(crane) if sensors is None else sensor_std(crane, sensors)
        self.noise = noise if noise is not None else ProcessNoise.of(crane.layout)
        self.augment = (augment,) if isinstance(augment, str | Augment) else tuple(augment)
        self.extras = resolve(crane, self.augment)
        gate = np.inf if gate is None else gate
        self.options = Options(method, start, gate, max_step, pressure_std, adapt, strokes, revisit)
        self._sensors = SensorNoise(self.std_of.values())
        self._floor = vapour_pressure(crane)
        #: (k,) what a gauge shows only of a chamber without a void, Pa
        self._clear = self._floor + _CLEAR * self._sensors.std
        self._engine_states = len(self.engine.state_names)
        self._channels = Channels(crane, list(self.std_of), self._engine_states, self.extras)
        self._bounds = self._all_bounds(partial(cylinder_lengths, crane) if strokes else None)
        self._limits = self._bounds.without(crane.layout.positions)
        self._process = self._process_on(self.engine)
        self._again = self._process_of_revisit()
        self._method = method_of(method, np.ones(self.size))  # until a start gives deviations
        self._noises: dict[int, np.ndarray] = {}
        self._refuse_misfits()
        self.reset()

    def _process_on(self, engine: Any) -> Process:
        """Return the transition of all that is estimated, on an engine."""
        return Process(engine, self._channels, self.extras, self._bounds)

    def _process_of_revisit(self) -> Process:
        """Return the transition with which the beginning is gone through again: on the filter's engine or another."""
        revisit = self.options.revisit
        if revisit is None or revisit.engine is None:
            return self._process
        return self._process_on(_engine_for(self.crane, revisit.engine))

    def _refuse_misfits(self) -> None:
        """Raise CraneError for a start or a noise of other states here, not in the middle of a run."""
        if self.options.start is not None:
            check_start(self.options.start, self.engine.state_names)
        self._known_noise(self.options.max_step)

    def __repr__(self) -> str:
        sensors = ", ".join(f"{n} ± {std:.2g}" for n, std in self.std_of.items())
        kind, names = type(self.engine).__name__, " ".join(self.state_names)
        return f"<Estimator of {self.crane.name} by {self.options.method} on {kind}: {names} from sensors {sensors}>"

    def varied(self, **changes: Any) -> Estimator:
        """Return a fresh estimator with some arguments changed."""
        same: dict[str, Any] = {"noise": self.noise, "augment": self.augment, **vars(self.options)}
        return Estimator(self.crane, self.engine, self.std_of, **(same | changes))

    @property
    def channel_names(self) -> tuple[str, ...]:
        """Names of the sensors, in the order of the innovations."""
        return self._channels.names

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of everything that is estimated: engine states, lagged readings, augmented quantities."""
        lagged = tuple(f"reading.{self._channels.names[row]}" for row, _ in self._channels.lags)
        return (*self.engine.state_names, *lagged, *(e.name for e in self.extras))

    @property
    def size(self) -> int:
        """Number of estimated quantities."""
        return self._engine_states + len(self._channels.lags) + len(self.extras)

    @property
    def _constants(self) -> list[int]:
        """Positions of what does not change, whose slopes stay where the beginning is gone through again; else none."""
        if self.options.revisit is None:
            return []
        return [k for k, e in enumerate(self.extras, self.size - len(self.extras)) if e.memory == np.inf]

    @property
    def sensor_variance(self) -> np.ndarray:
        """Variance (k,) of the noise of each sensor."""
        return self._sensors.covariance.diagonal()

    def observe(self, points: np.ndarray, shown: np.ndarray) -> np.ndarray:
        """Return what the sensors (m, k) should show of states (m, n), where they show (k,), or (m, k) of each.

        A gauge shows nothing of how large a void is. But what it shows clearly above vapour pressure is the pressure of
        a chamber without a void: one that a state has there counts as the pressure that is missing. The filter would
        learn nothing else, and put what the gauge shows on an offset of it.
        """
        if shown.ndim == 1:
            return self._observing(points.mean(axis=0), shown)(points)
        every = np.ones(shown.shape[1], dtype=bool)
        return np.where(shown > self._clear, self._channels.observe(points, every), self._channels.observe(points))

    def _observing(self, mean: np.ndarray, shown: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return what the sensors should show (m, k) of states (m, n) around a mean (n,), where they show (k,): only a
        mean with a void makes a difference, and none does of what is no pressure.
        """
        void = self._fills and (mean[self.crane.layout.pressures] < self._floor).any()
        return partial(self._channels.observe, full=shown > self._clear) if void else self._channels.observe

    def reset(self, fills: bool = False) -> None:
        """Forget everything that was measured.

        fills: whether gauges fill voids from now on, as of `observe`. While a start is tried, and live, they do not:
            what reads zero there may not work yet, or no more.
        """
        self._fills = fills
        self.belief: Any = None
        self.time: float | None = None
        self.count = 0
        self.events: list[tuple[float, str, str]] = []
        units = tuple(self.crane.layout.sensors[n].unit for n in self.std_of)
        self._monitor = Monitor(self._channels.names, units, self._sensors.std, self.options.gate, self._floor)
        self._belief_in_doubt = Doubt(self.options.gate)
        self._opinion: SecondOpinion | None = None
        self._stream = Stream(self.crane, self._channels.names, units)
        self._broken = False  # whether the belief was set up anew on the way
        self._sizes = Sizes(self.extras, self._engine_states + len(self._channels.lags), self.options.adapt)

    # -- live ----------------------------------------------------------------------------------------------------

    def step(
        self,
        commands: Sequence[float] | Mapping[str, float],
        measurements: Mapping[str, float],
        time: float | None = None,
    ) -> Now:
        """Return what is known after one more sample.

        Args:
            commands: spool commands in [-1, 1] at `time`; between two calls they are taken as linear.
            measurements: any of the sensors, SI; what is missing or NaN is missing. `pp`, `pt` go to the model as
                inputs, and stay as they were where they are missing.
            time: s; without it one `max_step` after the last call. A time that is not later than the last one is
                not a new sample: the call changes nothing, and adds an event. After more than `LONG_GAP` seconds,
                and when the clock went back for good, the estimator restarts from the sensors.

        Raises:
            CraneError: a command or measurement with an unknown name or of a wrong shape, or a first time that is no
                number.
        """
        lay = self.crane.layout
        command = command_of(commands, lay.commands)
        readings = readings_of(measurements, (*self.std_of, *lay.supply))
        if self.time is None:
            time = 0.0 if time is None else first_stamp(time)
        else:
            time = self.time + self.options.max_step if time is None else number(time, "time")
        command, values, supply, odd = self._stream.usable(command, readings)
        late = self.time is not None and not (np.isfinite(time) and (time > self.time or self._stream.went_back(time)))
        if late:
            odd.append(("time", "time stamp not later than the last one: sample left out"))
        self.events += [(time, *what) for what in self._stream.news(odd)]
        if late:
            return self._unchanged()
        if self.time is None:
            self.start_at(time, dict(zip(self._channels.names, values, strict=True)))
            self._stream.rest(time, command, supply)
            return self._unchanged()
        if not 0.0 < time - self.time <= LONG_GAP:
            self._resume(time, dict(zip(self._channels.names, values, strict=True)), {})
            self._stream.rest(time, command, supply)
            self._stream.in_order()
            return self._unchanged()
        self._stream.in_order()
        if not self._stream.begun:  # what was before is a recording
            self._stream.rest(self.time, command, supply)
        times = inner_times(self.time, time, self.options.max_step)
        outcome = self._advance(times, self._stream.inputs(times, command, supply), values)
        self.events += [(time, *what) for what in self._stream.rejected(outcome.flags)]
        return self._now(outcome)

    @property
    def _clock(self) -> float:
        """Time of the last sample, s; NaN before the first."""
        return float("nan") if self.time is None else self.time

    def _unchanged(self) -> Now:
        """Return what is known after a call that was corrected by no sensor."""
        return self._now(Outcome.none(len(self.std_of)))

    def _now(self, outcome: Outcome) -> Now:
        assert self.time is not None
        names = self._channels.names
        mean, variance = self.belief.mean.copy(), self.belief.covariance.diagonal().copy()
        show(mean, variance, self.crane.layout.pressures, self._floor)
        return Now(
            time=self.time,
            mean=mean,
            std=np.sqrt(variance),
            innovation={n: float(v) for n, v in zip(names, outcome.innovation, strict=True) if np.isfinite(v)},
            rejected=tuple(n for n, f in zip(names, outcome.flags, strict=True) if f not in (USED, ABSENT)),
            nis=outcome.nis,
            names=self.state_names,
        )

    # -- the recursion -------------------------------------------------------------------------------------------

    def start_at(self, time: float, first: Mapping[str, float], spread: Mapping[str, float] | None = None) -> None:
        """Set the belief at `time` from the first measurements (NaN is missing), or from the `start` that was given.

        `spread` is what the measurements may be off by, beside their noise, because the crane moves already.
        """
        start = self.options.start if self.options.start is not None else self._shown(first, spread or {}, begins=True)
        mean, covariance = np.zeros(self.size), np.zeros((self.size, self.size))
        extras = slice(self._engine_states + len(self._channels.lags), None)
        mean[extras] = [e.begins for e in self.extras]
        covariance[extras, extras] = np.diag([e.std**2 for e in self.extras])
        self._set_states(start, mean, covariance)
        self._start_covariance = covariance
        self._method = method_of(self.options.method, np.sqrt(np.diag(covariance)), self._constants, bool(self.extras))
        self.belief = self._method.begin(mean, covariance)
        self._forget_doubts(time, taken(self.crane.layout, first) if self.options.start is None else ())
        self.time = time

    def _forget_doubts(self, time: float, read: Collection[str]) -> None:
        """Note that the belief was set at `time` from the channels `read`."""
        self._monitor.begin(time, read)
        self._belief_in_doubt = Doubt(self.options.gate)
        self._opinion = None

    def _shown(self, first: Mapping[str, float], spread: Mapping[str, float], begins: bool = False) -> Belief:
        """Return the belief (nx, …) in which the sensors show `first`, give or take their noise and `spread`; `begins`
        as of `start_belief`.
        """
        std = {n: float(np.hypot(self.std_of.get(n, 0.0), spread.get(n, 0.0))) for n in {*self.std_of, *spread}}
        crane, at_rest = self.crane, self.engine.static_start
        moved = {e.name: e.begins for e in self.extras if e.begins != e.value and e.name in crane.machine.index}
        if moved:  # another load is held by other pressures
            crane = crane.with_parameters(moved)
            at_rest = partial(static_start, crane)
        return start_belief(crane, at_rest, first, std, self.options.pressure_std, begins)

    def _set_states(self, start: Belief, mean: np.ndarray, covariance: np.ndarray) -> None:
        """Fill the engine's states and the lagged readings that belong to them into a mean (n,) and a covariance (n,
        n).
        """
        n = self._engine_states
        mean[:n], covariance[:n, :n] = start.mean, start.covariance
        for k, (row, _) in enumerate(self._channels.lags):
            mean[n + k] = self._channels.read(mean[None])[0, row]
            covariance[n + k, n + k] = self._sensors.std[row] ** 2

    def _advance(
        self, times: np.ndarray, inputs: np.ndarray, values: np.ndarray, recorder: Recorder | None = None
    ) -> Outcome:
        """Predict to times[-1] and correct by `values` (k,), NaN for missing."""
        try:
            outcome = self._predict_and_correct(times, inputs, values, recorder)
        except EngineMisfit:
            raise
        except _FAILURES as problem:
            self._restart(float(times[-1]), str(problem))
            unlikely = self.options.unlikely * np.count_nonzero(~np.isnan(values))
            outcome = Outcome.none(values.size)._replace(log_likelihood=-unlikely)
            if recorder is not None and recorder.smooth:
                recorder.cut(self.belief)
        self.time = float(times[-1])
        self.count += 1
        lost = self._belief_in_doubt.ripe(self.time, outcome.nis)
        if self._opinion is not None:
            self._hear(times, inputs, values, outcome, recorder)
        elif lost or (outcome.flags == OUTLIER).any():
            self._doubt(lost, values, outcome.flags, recorder)
        return outcome

    def _doubt(self, lost: bool, values: np.ndarray, flags: np.ndarray, recorder: Recorder | None) -> None:
        """Set up a second filter that believes a sensor which stays rejected, or the sensors where they do not fit the
        belief.

        A sensor that is at odds with a few readings of its own only is believed without a hearing.
        """
        assert self.time is not None
        outvoted, disputed = self._monitor.outvoted(flags), self._monitor.disputed(self.time, flags)
        row = outvoted if outvoted >= 0 else disputed
        if row < 0 and not lost:
            return
        doubted = row if row >= 0 else None
        since = self._monitor.since(row) if row >= 0 else self._belief_in_doubt.since
        try:
            self._opinion = SecondOpinion(doubted, self._believing(doubted, values, flags), self.time, since)
        except _FAILURES:
            self._dismiss(doubted)
        else:
            if outvoted >= 0:
                self._overturn(np.full(flags.size, np.nan), recorder)

    def _hear(
        self, times: np.ndarray, inputs: np.ndarray, values: np.ndarray, first: Outcome, recorder: Recorder | None
    ) -> None:
        """Let the second filter weigh one more sample, and go on with it where it is right."""
        assert self._opinion is not None
        time, flags, row = float(times[-1]), first.flags, self._opinion.row
        rows = flags == USED
        if row is not None:
            rows[row] = not np.isnan(values[row])
        try:
            prior = self._method.predict(
                self._opinion.belief,
                self._process.over(inputs, times),
                self.process_noise(times[-1] - times[0]),
                self.count,
            )
            second, innovation, variance = self._correct_some(prior, values, rows)
        except _FAILURES:
            right: bool | None = False
        else:
            self._opinion.belief = self._inside(prior if second is None else second)
            self._opinion.weigh(time, (first.innovation, first.variance), (innovation, variance), rows)
            right = self._opinion.right(time)
        if right:
            self._overturn(innovation, recorder)
        elif right is False or (row is not None and flags[row] == USED):
            self._dismiss(row)

    def _dismiss(self, row: int | None) -> None:
        """Go on with the first filter, and listen to the sensor in `row` (None: to all that do not fit) later again."""
        assert self.time is not None
        self._opinion = None
        if row is None:
            self._belief_in_doubt.heard()
        else:
            self._monitor.dismiss(self.time, row)

    def _believing(self, row: int | None, values: np.ndarray, flags: np.ndarray) -> Any:
        """Return a belief from what the believed sensors and the one in `row` (None: no other) read now."""
        names = self._channels.names
        believed = {names[i]: float(values[i]) for i in np.flatnonzero(flags == USED)}
        if row is not None:
            others = rivals(self.crane.layout).get(names[row], ())
            believed = {n: v for n, v in believed.items() if n not in others} | {names[row]: float(values[row])}
        return self._anew(believed)

    def _anew(self, first: Mapping[str, float], spread: Mapping[str, float] | None = None) -> Any:
        """Return a belief from what the sensors read now; what they do not show of pose and motion, and the extras,
        stay.
        """
        old = self.belief
        lay = self.crane.layout
        kept = dict(zip(lay.states[lay.motion], old.mean[lay.motion].tolist(), strict=True))
        for name in lay.coordinates:
            if any(n in first and np.isfinite(first[n]) for n in showing(lay, name)):
                del kept[name]
        mean, covariance = old.mean.copy(), np.diag(np.diag(old.covariance))
        spreads = dict(zip(kept, lay.sized(kept, UNSHOWN), strict=True)) | dict(spread or {})
        self._set_states(self._shown(kept | dict(first), spreads), mean, covariance)
        return self._method.begin(mean, covariance)

    def _resume(
        self, time: float, first: Mapping[str, float], spread: Mapping[str, float], recorder: Recorder | None = None
    ) -> None:
        """Go on after a gap that is too long to be predicted through."""
        by = time - self._clock
        what = f"no sample for {by:.3g} s" if by > 0.0 else f"clock went back by {-by:.3g} s"
        self.events.append((time, "time", f"{what}: restarted from the sensors"))
        self.belief, self._broken = self._anew(first, spread), True
        self._forget_doubts(time, taken(self.crane.layout, first))
        if recorder is not None and recorder.smooth:
            recorder.cut(self.belief)
        self.time = time
        self.count += 1

    def _overturn(self, innovation: np.ndarray, recorder: Recorder | None) -> None:
        """Go on with the second filter, whose innovations (k,) are given: the sensor that was rejected, or all that did
        not fit, are right.
        """
        assert self._opinion is not None and self.time is not None
        row, since, self.belief = self._opinion.row, self._opinion.since, self._opinion.belief
        self._opinion, self._broken = None, True
        self._belief_in_doubt.heard()
        self._monitor.believe(self.time, row, innovation)
        if row is None:
            where, text = "state", f"replaced: since {since:.3f} s the sensors contradicted the filter"
        else:
            where = self._channels.names[row]
            text = f"accepted again: since {since:.3f} s it was right and the filter was wrong"
        self.events.append((self.time, where, f"{text}, which restarted from the sensors"))
        if recorder is not None and recorder.smooth:
            recorder.cut(self.belief)

    def _predict_and_correct(
        self, times: np.ndarray, inputs: np.ndarray, values: np.ndarray, recorder: Recorder | None
    ) -> Outcome:
        noise = self.process_noise(float(times[-1] - times[0]))
        prior = self._method.predict(self.belief, self._process.over(inputs, times), noise, self.count)
        if recorder is not None and recorder.smooth:
            recorder.predicted(prior)
        return self._correct(prior, float(times[-1]), values)

    def _correct(self, prior: Any, time: float, values: np.ndarray) -> Outcome:
        """Correct by what is there, let the monitor judge it, and correct anew without what cannot be believed."""
        energy = values.dot(values)
        if energy == energy:  # no NaN: every sensor was read, which is worth a short cut
            seen = self._observing(prior.mean, values)
            result = self._method.update(prior, seen, values, self._sensors.covariance, self.count)
            innovation, variance = result.innovation, result.innovation_covariance.diagonal()
        else:
            result, innovation, variance = self._correct_some(prior, values, ~np.isnan(values))
        flags, bad = self._monitor.judge(time, values, innovation, variance)
        if bad:
            result, _, _ = self._correct_some(prior, values, flags == USED)
        every = energy == energy and not bad
        peaks = self._sensors.log_peaks if every else float(self._sensors.log_peak[flags == USED].sum())
        unlikely = self.options.unlikely * np.count_nonzero(flags == OUTLIER) if bad else 0.0
        if result is None:
            self.belief = prior
            return Outcome(innovation, variance, flags, float("nan"), -unlikely)
        self.belief = self._inside(result)
        if self._sizes.adapted:
            self._sizes.follow(self.belief.mean, self.belief.covariance.diagonal(), time - self._clock)
        return Outcome(innovation, variance, flags, result.nis, result.log_likelihood + peaks - unlikely)

    def _inside(self, belief: Any) -> Any:
        """Return a belief whose mean is physical."""
        if not self._limits.broken(belief.mean):
            return belief
        return replace(belief, mean=self._limits.project(belief.mean, belief.covariance))

    def _correct_some(self, prior: Any, values: np.ndarray, rows: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray]:
        """Return the correction by some sensors, or None for none, with innovation and variance (k,), NaN elsewhere."""
        innovation, variance = np.full(values.size, np.nan), np.full(values.size, np.nan)
        if not rows.any():
            return None, innovation, variance
        noise = np.ascontiguousarray(self._sensors.covariance[np.ix_(rows, rows)])
        seen = self._observing(prior.mean, values)
        result = self._method.update(
            prior, lambda p: np.ascontiguousarray(seen(p)[:, rows]), values[rows], noise, self.count
        )
        innovation[rows], variance[rows] = result.innovation, result.innovation_covariance.diagonal()
        return result, innovation, variance

    def process_noise(self, dt: float) -> np.ndarray:
        """Return the covariance (n, n) that `dt` s add to all that is estimated."""
        key = int(1e9 * dt + 0.5)  # round(dt, 9) costs ten times as much
        if key not in self._noises:
            if len(self._noises) > 1000:
                self._noises.clear()
            full = np.zeros((self.size, self.size))
            known = self._known_noise(dt)
            full[: len(known), : len(known)] = known
            for k, extra in enumerate(self.extras):
                at = self._engine_states + len(self._channels.lags) + k
                full[at, at] = extra.variance(dt)
            self._noises[key] = full
        if not self._sizes.adapted:
            return self._noises[key]
        noise, rows = self._noises[key].copy(), self._sizes.rows
        noise[rows, rows] = self._sizes.added(dt)
        return noise

    def _known_noise(self, dt: float) -> np.ndarray:
        """Return the covariance that the process noise adds in `dt` s, of the engine's states or of the machine's."""
        sizes = {self._engine_states, min(self._engine_states, len(self.crane.layout.states))}
        return added_by(self.noise, dt, sizes, self.engine.state_names)

    def _restart(self, time: float, why: str) -> None:
        """Open the belief again around the last good mean: a filter that has lost its covariance knows nothing."""
        self.events.append((time, "filter", f"restarted: {why}"))
        mean = self.belief.mean
        if not np.isfinite(mean).all():
            mean = np.where(np.isfinite(mean), mean, 0.0)
        mean = np.clip(mean, self._limits.lower, self._limits.upper)
        self.belief, self._broken = self._method.begin(mean, self._start_covariance), True

    def _all_bounds(self, lengths: Callable[[np.ndarray], np.ndarray] | None) -> Bounds:
        engine = crane_bounds(self.crane, lengths, self._engine_states)
        lagged = np.full(len(self._channels.lags), np.inf)
        extra = np.array([e.lower for e in self.extras], float)
        return Bounds(
            np.concatenate([engine.lower, -lagged, extra]),
            np.concatenate([engine.upper, lagged, np.full(extra.size, np.inf)]),
        )

    # -- a whole recording ---------------------------------------------------------------------------------------

    def run(
        self,
        recording: Any,
        *,
        smooth: bool = False,
        keep_covariance: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> Estimate:
        """Return the estimate over a whole recording, at every instant at which some sensor of this estimator was read.

        Args:
            recording: a `crane_exudyn.recording.Recording`, its file, a simulation, or `signals.Signals`.
            smooth: also run the RTS smoother back over the recording; needs 32 n² bytes a sample for n states.
            keep_covariance: keep the covariance (N, n, n) of every instant, for NEES.
            progress: called with the fraction done, now and then.

        Raises:
            CraneError: the recording has none of the sensors, or no commands.
        """
        recorder, plan = self.recorded(recording, smooth=smooth, keep_covariance=keep_covariance, progress=progress)
        return self.estimate_of(recorder, plan, self.events)

    def estimate_of(self, recorder: Recorder, plan: Plan, events: list[tuple[float, str, str]]) -> Estimate:
        """Return the estimate that a recorder has collected over a plan, with what happened on the way."""
        return recorder.estimate(plan, events, self.crane, self.options.method, self._sensors.std, self._floor)

    def recorded(
        self,
        recording: Any,
        *,
        smooth: bool = False,
        keep_covariance: bool = False,
        progress: Callable[[float], None] | None = None,
    ) -> tuple[Recorder, Plan]:
        """Return what a run over a recording leaves behind, and the instants that it went over; see `run`."""
        plan = self.set_out(recording)
        recorder = Recorder(self.state_names, self.channel_names, plan.time, smooth, keep_covariance)
        recorder.start(self.belief)
        until = plan.time[0] + (self.options.revisit.until if self.options.revisit else 0.0)
        beginning = Beginning(self.belief, float(until), self._constants)
        for k in range(1, plan.time.size):
            outcome = self.on_plan(plan, k, recorder)
            if not beginning.over:
                self._look_back(beginning, plan, k, outcome.flags == USED, recorder)
            recorder.note(k, self.belief, outcome)
            if progress is not None and k % 500 == 0:
                progress(k / plan.time.size)
        return recorder, plan

    def set_out(self, recording: Any) -> Plan:
        """Return the instants of a recording (as of `run`), with the belief set up at the first of them."""
        signals = recording if isinstance(recording, Signals) else Signals.of(recording, self.crane)
        self.reset()
        plan = signals.plan(self.crane, self.channel_names, self.options.max_step)
        since = agreed_start(self, plan) if self.options.start is None else {}
        self.reset(fills=True)
        self.events.extend(plan.events)
        for name, begin in since.items():
            text = f"samples before {begin:.3f} s contradict later ones and the other sensors: left out"
            self.events.append((float(plan.time[0]), name, text))
        plan = plan.without(self.channel_names, since)
        self.start_at(float(plan.time[0]), *plan.first_readings())
        return plan

    def believe(self, belief: Belief) -> None:
        """Go on from another belief, of all that is estimated, at the same time; slopes from where it says."""
        begun = self._method.begin(belief.mean, belief.covariance)
        self.belief = begun if belief.at is None else replace(begun, at=belief.at)

    def on_plan(self, plan: Plan, k: int, recorder: Recorder | None = None) -> Outcome:
        """Go on to instant k of a plan: by prediction and correction, or anew from the sensors after a long gap."""
        i, j = plan.inner[k - 1], plan.inner[k] + 1
        if plan.time[k] - plan.time[k - 1] > LONG_GAP:
            self._resume(float(plan.time[k]), *plan.first_readings(at=float(plan.time[k])), recorder)
            return Outcome.none(plan.values.shape[1])
        return self._advance(plan.grid[i:j], plan.inputs[i:j], plan.values[k], recorder)

    def carried(self, points: np.ndarray, plan: Plan, k: int, parameters: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return points (m, n) of all that is estimated, carried from instant k - 1 of a plan to instant k;
        `parameters` are {name: (m,)}, SI, of what is not estimated, in each point's machine.
        """
        i, j = plan.inner[k - 1], plan.inner[k] + 1
        inside, excess = self._bounds.split(points)
        return self._process.carried(inside, excess, plan.inputs[i:j], plan.grid[i:j], parameters)

    def _look_back(self, beginning: Beginning, plan: Plan, k: int, used: np.ndarray, recorder: Recorder) -> None:
        """Note instant k of a plan, at which the sensors `used` (k,) were believed, and go on from what the whole
        beginning tells where it is time for that.
        """
        if self._broken:
            beginning.end()
            return
        i, j, time = plan.inner[k - 1], plan.inner[k] + 1, float(plan.time[k])
        step = Step(
            self._again.over(plan.inputs[i:j], plan.grid[i:j]),
            self.process_noise(time - float(plan.time[k - 1])),
            lambda points: np.ascontiguousarray(self.observe(points, plan.values[k])[:, used]),
            plan.values[k, used],
            np.ascontiguousarray(self._sensors.covariance[np.ix_(used, used)]),
        )
        if not beginning.add(time, step, self.belief):
            return
        try:
            found = beginning.again(self._limits.project)
        except EngineMisfit:
            raise
        except _FAILURES as problem:
            self.events.append((time, "filter", f"the beginning could not be repeated: {problem}"))
            beginning.end()
            return
        if not beginning.settled:
            self.events.append((time, "filter", "the repeated beginning did not settle"))
        self.believe(found)
        if recorder.smooth:
            recorder.cut(self.belief)


def _engine_for(crane: Crane, engine: Any) -> Any:
    """Return an engine by its name, or one that was given, which must be of this crane."""
    return of_this_crane(engine_of(engine, crane), crane)


def inner_times(start: float, end: float, max_step: float) -> np.ndarray:
    """Return instants from `start` to `end` inclusive, evenly apart, at most `max_step`."""
    pieces = max(1, int(np.ceil((end - start) / max_step - 1e-6)))
    return start + (end - start) * np.arange(pieces + 1) / pieces


def default_sensors(crane: Crane) -> dict[str, float]:
    """Return {channel: noise in SI} of the sensors that a filter uses where none are named: all coordinates and the
    chambers that carry loads.
    """
    return sensor_std(crane, (*crane.layout.coordinates, *crane.layout.loaded))


def sensor_std(crane: Crane, sensors: Mapping[str, float] | Sequence[str] | str) -> dict[str, float]:
    """Return {channel: noise standard deviation in SI}: as given, else the crane file's, else a default; a lone text is
    one channel.

    Raises:
        CraneError: no sensor, an unknown one, or a standard deviation that is not positive.
    """
    names = (sensors,) if isinstance(sensors, str) else sensors
    given = dict(names) if isinstance(names, Mapping) else dict.fromkeys(names)
    table = crane.layout.sensors
    if not given:
        raise CraneError(f"The estimator has no sensor. Give at least one of {', '.join(table)}.")
    for name, std in given.items():
        sensor(name, table)
        if std is not None:
            given[name] = positive(std, f"sensor {name!r}: the noise", f"a positive deviation in {table[name].unit}")
    return {n: float(s if s is not None else crane.sensors.get(n, table[n].sizes.noise)) for n, s in given.items()}
