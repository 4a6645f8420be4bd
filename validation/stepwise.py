"""Effects added one by one to a model that no single effect repairs.

`diagnose` asks whether one effect, or two, explain a recording down to the noise. A real machine lacks many at once, and something is always
left. Then the next best effect is still worth having if the recording asks for it and the model with it predicts better what it was
not fitted to. Three things differ from the search of a diagnosis:

- The error level of each channel is that of the model and not of the sensor alone, and its samples count as many times as they are
  independent. Errors of a wrong model drift; taken as white noise they would prove anything.
- Windows are two seconds long, all but joined: so long that a ring dies out or a drift shows in them.
- An effect's parameters have a size that is met in practice: what needs fifty times as much explains nothing.

What is added is judged on a stretch that was not fitted: the check recording, or the last third of the recording itself. At last everything is
fitted together in one open-loop run, and each effect is taken out once to see what the others make of the recording without it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import zip_longest

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects.registry import split_key
from crane_exudyn.layout import Layout
from crane_exudyn.parameters import unit_of
from crane_exudyn.recording import Recording

from .diagnosis import in_parallel
from .fit.data import FitData, grid_step
from .fit.evidence import log_evidence
from .fit.linear import cut
from .fit.solve import Fit, fit, reknot
from .fit.staged import LONG, SHORT, Stage, all_parameters, first_knots, informed_directions, residuals, timing_of
from .fit.variables import (
    CurveDirection,
    EffectParameter,
    EffectVariable,
    NominalDirection,
    Variable,
    effect_variables,
    uncertain_parameters,
)
from .search.candidates import scaled, starts
from .search.screen import Score, screen
from .search.weigh import deviation

#: windows in s, how many times smaller than usual their jumps are, and the longest simulation step
WINDOW, JOINED, STEP = 2.0, 100.0, 5e-3
#: errors are taken as independent at the latest after so many seconds
APART = 0.25
#: the same for errors of a run over the whole recording, which drift
DRIFT = 1.0
#: share of a recording that is learned from where there is no check recording
LEARNED = 0.625
#: log evidence (of independent samples) that an effect must bring, and within which another would do nearly as well
DEMANDED, NEAR = 5.0, 5.0
#: share of the best candidate's evidence from which on another is looked at over the whole run
SERIOUS = 0.5
#: log of the error by which what was not fitted may be predicted worse, on the average of the channels, for one step
TOLERATED = 0.1
#: and the least by which one must fall, fitted and not fitted stretch together: much evidence for next to nothing is a makeshift's
GAINED = 0.1
#: an effect stays, for all its evidence, if the error of a channel is so many times as large without it
MENDED = 1.5
#: nominal parameters are told that moved by more than so many standard uncertainties, doubted from so many on, and held within so many
TOLD, STRAINED, BELIEVED = 1.0, 2.9, 3.0
#: how often the last fit takes up the error levels that it leaves
SETTLED = 3
#: how many starts are fitted in a step, and how many effects are taken in at most
TRIED, MOST = 9, 10
#: sizes beyond this many typical ones are implausible: standard deviation of an effect's parameter before the data
PLAUSIBLE = 3.0
Errors = Mapping[str, float]


@dataclass(frozen=True)
class Plausible(EffectParameter):
    """An effect's parameter with a prior: it is not many times what is met in practice."""

    @property
    def prior(self) -> float:
        """Standard deviation of u; none for what only shapes a law."""
        return math.inf if self.parameter.shape else PLAUSIBLE


@dataclass(frozen=True)
class Stated(EffectParameter):
    """A parameter of an effect that the crane file has: u = 0 is the file's value, known to a third like a nominal parameter."""

    @property
    def prior(self) -> float:
        """Standard deviation of u."""
        return 1.0

    @property
    def scale(self) -> float:
        """A third of the value, or the typical size where the file has none."""
        if self.inverse or self.start == 0.0:
            return super().scale
        return abs(self.start) / 3.0

    @property
    def _origin(self) -> float:
        return 0.0 if self.inverse else self.start


@dataclass(frozen=True)
class Found:
    """One effect that was taken in.

    Attributes:
        key: the effect.
        evidence: log evidence that it brought over the model before.
        rivals: what else was fitted in the same step, with the evidence that it would have brought.
        errors: open-loop error by channel with it, as a share of the channel's range; held_out: of the stretch not fitted.
    """

    key: str
    evidence: float
    rivals: Mapping[str, float]
    errors: Errors
    held_out: Errors


@dataclass(frozen=True)
class Grown:
    """The crane with all effects taken in, and how each proved itself.

    Attributes:
        found: the steps in the order in which they were taken.
        before: open-loop errors of the crane as given, its start fitted; after: of the crane at the end; both as shares of the range.
        needed: effect -> log evidence lost when it is left out and all else is fitted again, as far as that fit went in a few steps.
        without: effect -> open-loop errors when it is left out.
        nominal, predicted: errors on what was held out, by the model that was fitted to the rest only: parameters alone, and with effects.
        deviations: parameter -> standard deviation (SI), with as many independent samples as the errors leave.
        spread: names of parameters -> correlation, where two can hardly be told apart.
        moved: nominal parameter -> how far it moved, in standard uncertainties; where only a range is known, in shares of it.
    """

    crane: Crane
    found: tuple[Found, ...]
    before: Errors
    after: Errors
    needed: Mapping[str, float]
    without: Mapping[str, Errors]
    nominal: Errors
    predicted: Errors
    deviations: Mapping[str, float]
    spread: Mapping[tuple[str, str], float]
    moved: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True)
class _Held:
    """What a step is judged on: data and from when on; start_late tells how its first state is found."""

    data: FitData
    start: float
    own: bool


def independent(r: np.ndarray) -> float:
    """Return how many independent samples the residuals r (n,) are worth: n over the sum of their autocorrelation.

    The sum runs to the first lag without positive correlation, which is careful with errors that ring.
    """
    n, power = len(r), float(r @ r)
    if n < 2 or power == 0.0:
        return float(n)
    spectrum = np.abs(np.fft.rfft(r, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n] / power
    ends = np.flatnonzero(rho <= 0.0)
    return n / (1.0 + 2.0 * float(rho[1 : int(ends[0]) if len(ends) else n].sum()))


def levels_of(
    found: Fit, noise: Mapping[str, float], most: Mapping[str, float] | None = None, apart: float = APART
) -> tuple[dict[str, float], float]:
    """Return the error level of each channel (SI), and the factor on it at which samples weigh what the independent ones are worth.

    The level is the channel's RMS error, at least its sensor's noise and at most `most` where that is given: a channel that a better model fits worse than
    the one before must not be given up. The factor is the root of how many samples make an independent one, on the average of
    the channels: one for each would weigh down just those channels that show best what is missing. Samples `apart` seconds from one
    another are independent.
    """
    errors = window_errors(found)
    worth = []
    levels = {}
    for c, r in errors.items():
        rms = float(np.sqrt(np.mean(r**2)))
        levels[c] = max(noise[c], rms if most is None else min(rms, most[c]))
        worth.append(len(r) / max(independent(r), len(r) * found.data.parts[0].interval / apart))
    factor = math.sqrt(float(np.mean(worth)))
    return levels, factor


def window_errors(found: Fit) -> dict[str, np.ndarray]:
    """Return by channel the errors (SI) of all windows of a fit, one after the other."""
    parts: dict[str, list[np.ndarray]] = {}
    for window, x0 in zip(found.windows, found.knots, strict=True):
        left = residuals(found.crane, window.data, x0, found.late)
        for s in window.data.samples:
            parts.setdefault(s.channel, []).append(left[s.channel][1] * s.noise)
    return {c: np.concatenate(pieces) for c, pieces in parts.items()}


def with_noise(data: FitData, levels: Mapping[str, float]) -> FitData:
    """Return the data with other noise levels (SI)."""
    return replace(data, samples=tuple(replace(s, noise=levels[s.channel]) for s in data.samples))


def shares(crane: Crane, data: FitData, x0: np.ndarray, late: float, start: float = -math.inf) -> dict[str, float]:
    """Return by channel the RMS error of an open-loop run from x0 (as in `residuals`) over the samples from `start` on, as a share of the channel's range."""
    left = residuals(crane, data, x0, late)
    found = {}
    for s in data.samples:
        time, r = left[s.channel]
        kept = r[time >= start] * s.noise
        found[s.channel] = float(np.sqrt(np.mean(kept**2)) / max(np.ptp(s.values), s.noise)) if len(kept) else math.nan
    return found


@dataclass
class _Growth:
    """The state of one growth: where the fit stands, and what the next fits share.

    `tried`: effects that the data demanded in a step before and that were not taken, with the values that were fitted. They come again: a
    linear look from a model without them may not show them a second time.
    """

    crane: Crane
    data: FitData
    noise: dict[str, float]
    shared: list[Variable]
    current: Fit
    keys: list[str]
    jobs: int
    levels: Mapping[str, float]
    tried: Mapping[str, Mapping[str, float]] = field(default_factory=dict)


def _parameters(crane: Crane, key: str) -> Mapping[str, float]:
    acting = crane.effect(key)
    assert acting is not None
    return acting.parameters


def plausible(key: str, values: Mapping[str, float], layout: Layout) -> list[EffectVariable]:
    """Return the variables of an effect with priors of plausible size."""
    return [_as(Plausible, v) for v in effect_variables(key, values, layout)]


def stated(key: str, values: Mapping[str, float], layout: Layout) -> list[EffectVariable]:
    """Return the variables of an effect that the crane file has, held near the file's values."""
    return [_as(Stated, v) for v in effect_variables(key, values, layout)]


def _as(kind: type[EffectParameter], v: EffectVariable) -> EffectVariable:
    """Return a variable with the prior of a kind; those of curves have one of their own."""
    return kind(v.key, v.parameter, v.start, v.difference) if isinstance(v, EffectParameter) else v


def fitted(
    crane: Crane, data: FitData, variables: Sequence[Variable], before: Fit, stage: Stage, values: Mapping[str, float]
) -> Fit:
    """Return a fit from the knots of another; variables start at `values` (u by name), or at the effect's own start."""
    windows = cut(data, stage.seconds)
    u = np.array([values.get(v.name, v.begin if isinstance(v, EffectVariable) else 0.0) for v in variables])
    knots = reknot(before, windows)
    return fit(crane, data, windows, knots, variables, u, stiffness=stage.stiffness, iterations=stage.iterations)


def values_of(found: Fit) -> dict[str, float]:
    """Return u by the names of a fit's variables."""
    return {v.name: float(x) for v, x in zip(found.variables, found.u, strict=True)}


def carried(
    crane: Crane,
    data: FitData,
    shared: Sequence[Variable],
    effects: Sequence[EffectVariable],
    before: Fit,
    stage: Stage,
    kept: Sequence[str],
) -> Fit:
    """Return a fit that goes on from another; of the effects those in `kept` that would fall asleep are held as they were before.

    Where everything moves at once, parameters may slide into a valley in which an effect that was found before does nothing. Another
    effect is to come in addition to it.
    """
    found = fitted(crane, data, [*shared, *effects], before, stage, values_of(before))
    asleep = [k for k in kept if any(v.key == k for v in effects) and neutral(found, k)]
    if not asleep:
        return found
    for key in asleep:
        crane = crane.with_effect(key, _parameters(before.crane, key))
    awake = [v for v in effects if v.key not in asleep]
    return carried(crane, data, shared, awake, before, stage, kept)


def neutral(found: Fit, key: str) -> bool:
    """Whether an effect that a fit moves has gone where it does nothing."""
    return not any(isinstance(v, CurveDirection) and v.key == key for v in found.variables) and all(
        abs(u - v.neutral) < 1e-3
        for v, u in zip(found.variables, found.u, strict=True)
        if isinstance(v, EffectParameter) and v.key == key and not v.parameter.shape
    )


def _tried(
    crane: Crane,
    data: FitData,
    shared: Sequence[Variable],
    keys: Sequence[str],
    new: Sequence[EffectParameter],
    before: Fit,
) -> Fit:
    """Return the fit with a new effect: first everything else finds its place beside it, then it is free as well.

    Where an effect starts with its full size, a step in all variables at once is far from linear and stalls.
    """
    old = acting(before.crane, keys)
    beside = crane.with_effect(new[0].key, {v.parameter.name: v.start for v in new})
    first = carried(beside, data, shared, old, before, Stage(WINDOW, JOINED, 3, STEP), keys)
    return carried(crane, data, shared, [*old, *new], first, Stage(WINDOW, JOINED, 6, STEP), keys)


def acting(crane: Crane, keys: Sequence[str]) -> list[EffectVariable]:
    """Return the variables of effects that a crane has, as they are."""
    return [v for k in keys for v in plausible(k, _parameters(crane, k), crane.layout)]


def begun(crane: Crane, data: FitData, jobs: int = 1) -> _Growth:
    """Return the growth before its first step: nominal parameters fitted, levels of the channels found."""
    noise = {s.channel: s.noise for s in data.samples}
    base = all_parameters(crane, data, (Stage(SHORT, 1.0, 5, STEP),))
    own: list[Variable] = [v for e in crane.effects for v in stated(e.key, e.parameters, crane.layout)]
    shared = [*informed_directions(base), *own]
    raised = with_noise(data, {c: noise[c] * max(1.0, e) for c, e in base.errors.items()})
    projected = _projected(shared, base)
    current = fitted(crane, raised, shared, base, Stage(WINDOW, JOINED, 8, STEP), projected)
    return relevelled(_Growth(crane, data, noise, shared, current, [], jobs, {c: math.inf for c in noise}))


def _projected(shared: Sequence[Variable], base: Fit) -> dict[str, float]:
    from .search.weigh import projected

    known = values_of(base)
    return {v.name: projected(v, base, known) for v in shared if isinstance(v, NominalDirection)}


def relevelled(growth: _Growth) -> _Growth:
    """Return the growth with the channels' levels as the current model leaves them, never higher than before, all fitted again.

    By way of one open-loop run: slow drifts do not show in windows of two seconds.
    """
    now = growth.current
    levels, factor = levels_of(now, growth.noise, growth.levels)
    data = with_noise(growth.data, {c: factor * level for c, level in levels.items()})
    crane, shared, keys = growth.crane, growth.shared, growth.keys
    run = carried(crane, data, shared, acting(now.crane, keys), now, Stage(LONG, 1.0, 6, STEP), keys)
    near = replace(run, knots=now.knots, windows=now.windows)  # its parameters, where the windows stand
    again = carried(crane, data, shared, acting(run.crane, keys), near, Stage(WINDOW, JOINED, 6, STEP), keys)
    return replace(growth, current=again, levels=levels)


def likely(scores: Sequence[Score], most: int) -> list[Score]:
    """Return the best start of each effect at each place, at most so many, and none that promises next to nothing."""
    chosen: dict[str, Score] = {}
    for score in scores:
        if len(chosen) == most or score.gain < 1.0:
            break
        chosen.setdefault(score.start.key, score)
    return list(chosen.values())


def measured(key: str, data: FitData) -> bool:
    """Whether an effect acts on a supply pressure that the recording tells: what the pump or the tank line does is in it already."""
    hooks = set(split_key(key)[0].hooks())
    known = [not np.isnan(column).any() for column in data.supply.T]
    return any(k and hooks <= {name} for name, k in zip(("supply_pressure", "tank_pressure"), known, strict=True))


def promising(growth: _Growth) -> list[Score]:
    """Return what to try: the best of a screen in long windows, and the best of one in short windows that follow the machine.

    The long ones show what adds up; in the short ones a chamber that the model takes for stiff still stands where the machine's stands, so
    that an effect that changes all from there on (air) is seen at all.
    """
    now = growth.current
    short = _following(growth)
    offered = [s for s in starts(now.crane, now.data.parts[0]) if not measured(s.key, now.data.parts[0])]
    found = [likely(screen(f, offered, stiffness), TRIED) for f, stiffness in ((now, JOINED), (short, 1.0))]
    chosen: dict[str, Score] = {}
    for pair in zip_longest(*found):
        for score in (s for s in pair if s is not None):
            if len(chosen) < TRIED:
                chosen.setdefault(score.start.key, score)
    return list(chosen.values())


def _following(growth: _Growth) -> Fit:
    """Return the current model in short, loosely joined windows, with the error levels that it has there."""
    now = growth.current
    data = with_noise(growth.data, growth.noise)
    for _ in range(2):
        windows = cut(data, SHORT)
        knots = first_knots(now.crane, data, SHORT)
        found = fit(growth.crane, data, windows, knots, now.variables, now.u, stiffness=1.0, iterations=2)
        levels, factor = levels_of(found, growth.noise)
        data = with_noise(growth.data, {c: factor * level for c, level in levels.items()})
    return replace(found, data=data, windows=tuple(cut(data, SHORT)))


def candidates(growth: _Growth) -> list[tuple[str, float, Fit]]:
    """Return effects fitted beside those taken in: key, gain in log evidence, fit; best first."""
    now, data = growth.current, growth.current.data
    begins = {s.start.key: scaled(s.start, s.amplitude) for s in promising(growth)} | dict(growth.tried)
    own = [plausible(k, v, growth.crane.layout) for k, v in begins.items()]
    tasks = [(_tried, growth.crane, data, growth.shared, growth.keys, variables, now) for variables in own]
    bare = log_evidence(now)
    fits = in_parallel(growth.jobs, tasks)
    gains = [(k, log_evidence(f) - bare, f) for k, f in zip(begins, fits, strict=True) if not at_end(f, k)]
    return sorted((g for g in gains if math.isfinite(g[1])), key=lambda g: -g[1])


def at_end(found: Fit, key: str) -> bool:
    """Whether an effect acts with a parameter at an end of its range: then something else is the cause."""
    for v, u in zip(found.variables, found.u, strict=True):
        if isinstance(v, EffectParameter) and v.key == key and not v.parameter.shape:
            ends = [e for e in (v.lower, v.upper) if math.isfinite(e) and abs(e - v.neutral) > 1e-12]
            if any(abs(u - e) < 1e-3 * max(1.0, abs(e)) for e in ends):
                return True
    return False


def run_of(found: Fit, data: FitData, iterations: int = 5) -> Fit:
    """Return the open-loop run over `data` of the crane that a fit found, its first state fitted."""
    windows = cut(data, LONG)
    return fit(
        found.crane, data.shifted(found.late), windows, reknot(found, windows), (), np.zeros(0), iterations=iterations
    )


def started_run(crane: Crane, data: FitData, late: float) -> Fit:
    """Return the open-loop run of a crane over data that no fit has seen yet, its first state fitted."""
    data = data.shifted(late)
    short = fit(crane, data, cut(data, SHORT), first_knots(crane, data), stiffness=1.0, iterations=3)
    windows = cut(data, WINDOW)
    joined = fit(crane, data, windows, reknot(short, windows), stiffness=JOINED, iterations=4)
    return run_of(joined, data)


def judged(found: Fit, learned: FitData, held: FitData, start: float) -> tuple[dict[str, float], dict[str, float]]:
    """Return open-loop errors on what was learned from, and on the held-out data from `start` on, as shares of the range.

    Where the held-out data are the rest of the same recording, one run goes on from the learned stretch into it.
    """
    levels = {s.channel: s.noise for s in found.data.parts[0].samples}
    run = run_of(found, with_noise(learned, levels))
    x0, late = run.starts, found.late
    own = shares(found.crane, learned, x0, late)
    if math.isinf(start):
        x0 = started_run(found.crane, with_noise(held, levels), late).starts
    return own, shares(found.crane, held, x0, late, start)


def falls(before: Errors, after: Errors, noise: Mapping[str, float], ranges: Mapping[str, float]) -> float:
    """Return the mean over channels of the log of the error's fall; below its sensor's noise an error no longer counts."""
    floor = {c: noise[c] / ranges[c] for c in before}
    return float(np.mean([math.log(max(before[c], floor[c]) / max(after[c], floor[c])) for c in before]))


def grow(
    crane: Crane,
    recording: Recording,
    check: Recording | None = None,
    *,
    jobs: int = 1,
    most: int = MOST,
    told: Callable[[Found], None] = lambda found: None,
    progress: Callable[[str, float], None] = lambda text, share: None,
) -> Grown | None:
    """Return the crane with effects taken in one by one, or None where none is worth it.

    Args:
        crane: the crane file as given.
        recording: learned from; without a check recording only its first five eighths, until all is fitted together at last.
        check: another recording, on which each step must predict better.
        jobs: processes to use.
        most: how many effects are taken in at most.
        told: called with each effect that is taken in.
        progress: called with a text and the share that is done.
    """
    whole = FitData.of(recording, crane)
    whole = whole.with_step(grid_step(whole.interval, STEP))
    end = float(whole.time[0] + LEARNED * (whole.time[-1] - whole.time[0]))
    learned = whole if check is not None else _until(whole, end)
    held = whole if check is None else _stepped(FitData.of(check, crane))
    start = end if check is None else -math.inf
    progress("fitting the nominal parameters", 0.02)
    growth = begun(crane, learned, jobs)
    given = judged(growth.current, learned, held, start)
    found = _steps(growth, (learned, held, start), given, most, told, progress)
    if not found:
        return None
    growth, steps = found
    progress("fitting everything together", 0.7)
    return _together(growth, whole, steps, given, progress)


def _best_step(
    offered: Sequence[tuple[str, float, Fit]],
    judge: tuple[FitData, FitData, float],
    last: tuple[dict[str, float], dict[str, float]],
    noise: Mapping[str, float],
    ranges: Mapping[str, float],
) -> tuple[str, Fit, tuple[dict[str, float], dict[str, float]]] | None:
    """Return the effect with which whole runs have the least error, over what was learned from and what was not: key, fit, errors.

    Of those that the data demand, at least half as much as the first, and that make the errors fall; None if there is none. Windows
    tell what is at work, but not whether it adds up over a whole run; and what merely imitates the cause predicts worse.
    """
    found = []
    for key, gain, fit_with in offered:
        if gain < max(DEMANDED, SERIOUS * offered[0][1]):
            break
        errors = judged(fit_with, *judge)
        fall, ahead = (falls(a, b, noise, ranges) for a, b in zip(last, errors, strict=True))
        if fall + ahead > GAINED and ahead > -TOLERATED:
            found.append((fall + ahead, key, fit_with, errors))
    return max(found, key=lambda f: f[0])[1:] if found else None


def _stepped(data: FitData) -> FitData:
    return data.with_step(grid_step(data.interval, STEP))


def _until(data: FitData, end: float) -> FitData:
    return data.part(0, int(np.searchsorted(data.time, end)))


def _steps(
    growth: _Growth,
    judge: tuple[FitData, FitData, float],
    given: tuple[dict[str, float], dict[str, float]],
    most: int,
    told: Callable[[Found], None],
    progress: Callable[[str, float], None],
) -> tuple[_Growth, tuple[Found, ...]] | None:
    """Take in effects as long as one brings evidence and predicts better."""
    ranges = {s.channel: max(float(np.ptp(s.values)), s.noise) for s in judge[0].samples}
    steps: list[Found] = []
    last = given
    while len(steps) < most:
        progress(f"looking for effect {len(steps) + 1}", 0.05 + 0.6 * len(steps) / most)
        offered = candidates(growth)
        step = _best_step(offered, judge, last, growth.noise, ranges)
        if step is None:
            break
        key, found, errors = step
        gains = {k: float(g) for k, g, _ in offered}
        steps.append(Found(key, gains.pop(key), gains, *errors))
        told(steps[-1])
        again = {k: _parameters(f.crane, k) for k, g, f in offered if g > DEMANDED and k != key}
        growth = relevelled(replace(growth, current=found, keys=[*growth.keys, key], tried=again))
        last = errors
    return (growth, tuple(steps)) if steps else None


def _everything(
    crane: Crane, given: Crane, keys: Sequence[str], data: FitData
) -> tuple[list[Variable], dict[str, float]]:
    """Return timing, all uncertain parameters and all effects as variables, and their values in a crane."""
    nominal = [_believable(v) for v in uncertain_parameters(given)]
    found = acting(crane, keys)
    own = [v for e in given.effects for v in stated(e.key, e.parameters, given.layout)]
    moved = {v.name: v.to_u(_parameters(crane, v.key)[v.parameter.name]) for v in own if isinstance(v, EffectParameter)}
    values = {v.name: (crane[v.name] - given[v.name]) / v.weights[v.name] for v in nominal}
    values |= {v.name: v.begin for v in found} | moved
    return [timing_of(data), *nominal, *own, *found], values


def _believable(v: NominalDirection) -> NominalDirection:
    """Return a nominal parameter that stays within what can be believed of it."""
    return v if math.isinf(v.prior) else replace(v, lower=-BELIEVED * v.prior, upper=BELIEVED * v.prior)


def _open_loop(crane: Crane, given: Crane, keys: Sequence[str], data: FitData, before: Fit, iterations: int) -> Fit:
    """Return everything fitted to one open-loop run, by way of long windows."""
    variables, values = _everything(crane, given, keys, data)
    values["timing"] = before.late / timing_of(data).scale
    joined = fitted(given, data, variables, before, Stage(WINDOW, JOINED, iterations, STEP), values)
    return fitted(given, data, variables, joined, Stage(LONG, 1.0, 2 * iterations, STEP), values_of(joined))


def _together(
    growth: _Growth,
    whole: FitData,
    steps: tuple[Found, ...],
    given: tuple[dict[str, float], dict[str, float]],
    progress: Callable[[str, float], None],
) -> Grown:
    """Fit everything to the whole recording, leave out what is not needed, and say how well each effect is determined."""
    final = _whole_run(growth, whole)
    keys = list(growth.keys)
    full = shares(final.crane, whole, final.starts, final.late)
    floor = {s.channel: s.noise / max(float(np.ptp(s.values)), s.noise) for s in whole.samples}
    while True:
        progress("leaving out each effect once", 0.8)
        left = _left_out(growth, keys, final)
        needed = {k: log_evidence(final) - log_evidence(f) for k, f in left.items()}
        without = {k: shares(f.crane, whole, f.starts, f.late) for k, f in left.items()}
        idle = [k for k in keys if needed[k] < DEMANDED and not mends(without[k], full, floor)]
        if not idle or len(keys) == 1:
            break
        weakest = min(idle, key=lambda k: needed[k])
        keys.remove(weakest)
        final = left[weakest]
    x0 = final.starts
    before = started_run(growth.crane, whole, 0.0)
    return Grown(
        final.crane, tuple(s for s in steps if s.key in keys), shares(growth.crane, whole, before.starts, 0.0),
        shares(final.crane, whole, x0, final.late), needed, without, given[1], steps[-1].held_out, _deviations(final), _alike(final, keys),
        {v.name: float(u) for v, u in zip(final.variables, final.u, strict=True) if isinstance(v, NominalDirection)},
    )  # fmt: skip


def mends(without: Errors, full: Errors, floor: Errors) -> bool:
    """Whether a channel's error is half as large again without an effect as with everything, and more than its sensor's noise."""
    return any(without[c] > MENDED * max(full[c], floor[c]) for c in full)


def _whole_run(growth: _Growth, whole: FitData) -> Fit:
    """Return the open-loop fit to the whole recording: the most likely of those that begin at the current fit, at the machine, and anew.

    Anew is the crane as given, with effects of the size that is met in practice: where much has moved step by step, that valley may
    be the deeper one.
    """
    data = with_noise(whole, {s.channel: s.noise for s in growth.current.data.parts[0].samples})
    found = _extended(growth, data)
    fresh = typical(growth.crane, growth.keys)
    windows = tuple(cut(data, WINDOW))
    machine = [replace(found, windows=windows, knots=first_knots(c, data, WINDOW)) for c in (found.crane, fresh)]
    begins = [(found, found.crane), (machine[0], found.crane), (machine[1], fresh)]
    fits: list[Fit] = in_parallel(growth.jobs, [(_settled, growth, whole, start, crane) for start, crane in begins])
    return fits[int(np.argmax(_likelihoods(fits, growth.noise)))]


def typical(crane: Crane, keys: Sequence[str]) -> Crane:
    """Return the crane with effects of the size that is met in practice."""
    for key in keys:
        effect, _ = split_key(key)
        crane = crane.with_effect(key, {p.name: p.neutral if p.shape else p.typical for p in effect.parameters})
    return crane


def _settled(growth: _Growth, whole: FitData, start: Fit, crane: Crane) -> Fit:
    """Return the open-loop fit from a start, fitted again a few times with the error levels that it leaves."""
    found = _open_loop(crane, growth.crane, growth.keys, start.data.parts[0], start, 6)
    for _ in range(SETTLED):
        levels, factor = levels_of(found, growth.noise, apart=DRIFT)
        data = with_noise(whole, {c: factor * level for c, level in levels.items()})
        found = fitted(growth.crane, data, found.variables, found, Stage(LONG, 1.0, 12, STEP), values_of(found))
    return found


def _likelihoods(fits: Sequence[Fit], noise: Mapping[str, float]) -> list[float]:
    """Return the log-likelihood of each fit, each channel's error level at its most likely value, and the log prior, up to a constant.

    A channel that is given up costs the log of its level. All fits take samples as equally independent.
    """
    found = [levels_of(f, noise, apart=DRIFT) for f in fits]
    factor = float(np.mean([factor for _, factor in found]))
    counts = {s.channel: len(s.values) for s in fits[0].data.parts[0].samples}
    return [
        -sum(n / factor**2 * math.log(levels[c] / noise[c]) for c, n in counts.items()) - f.prior_cost
        for f, (levels, _) in zip(fits, found, strict=True)
    ]


def _extended(growth: _Growth, data: FitData) -> Fit:
    """Return the current crane in windows over the whole recording, of which the fit may have seen only the first part."""
    found = growth.current
    windows = cut(data, WINDOW)
    guess = first_knots(found.crane, data, WINDOW)
    near = reknot(found, windows)
    known = np.array([w.data.time[0] <= found.data.time[-1] - WINDOW for w in windows])
    if near.shape == guess.shape:
        guess[known] = near[known]
    variables = [timing_of(data)]
    return fit(
        found.crane, data, windows, guess, variables, np.array([found.late / variables[0].scale]), stiffness=JOINED
    )


def _left_out(growth: _Growth, keys: Sequence[str], final: Fit) -> dict[str, Fit]:
    """Return, for each effect, the fit of everything but it."""
    tasks = []
    for key in keys:
        rest = [k for k in keys if k != key]
        crane = final.crane.without_effect(key)
        tasks.append((_best_run, crane, growth.crane, rest, final))
    return dict(zip(keys, in_parallel(growth.jobs, tasks), strict=True))


def _best_run(crane: Crane, given: Crane, keys: Sequence[str], final: Fit) -> Fit:
    """Return the best of three fits of one open-loop run: straight from where the final one stands, and by way of long windows that
    begin on its run, or on the machine's: without an effect the run may be far from both."""
    data = final.data.parts[0]
    variables, values = _everything(crane, given, keys, data)
    values["timing"] = final.late / timing_of(data).scale
    straight = fitted(given, data, variables, final, Stage(LONG, 1.0, 8, STEP), values)
    windows = cut(data, WINDOW)
    measured = replace(final, windows=tuple(windows), knots=first_knots(crane, data, WINDOW))
    ways = [straight, *(_open_loop(crane, given, keys, data, start, 4) for start in (final, measured))]
    return max(ways, key=log_evidence)


def _deviations(final: Fit) -> dict[str, float]:
    """Return the standard deviation (SI) of each variable that the data determine better than its prior."""
    found = {}
    for i, v in enumerate(final.variables):
        spread = math.sqrt(max(float(final.cov[i, i]), 0.0))
        if isinstance(v, NominalDirection):
            found[v.name] = spread * v.weights[v.name]
        elif isinstance(v, EffectParameter):
            found[v.name] = deviation(v, float(final.u[i]), spread)
    return found


def _alike(final: Fit, keys: Sequence[str], least: float = 0.9) -> dict[tuple[str, str], float]:
    """Return pairs of variables, one of them an effect's that was taken in, whose errors are correlated beyond `least`."""
    spread = np.sqrt(np.maximum(np.diag(final.cov), 1e-300))
    R = final.cov / np.outer(spread, spread)
    found = {}
    for i, v in enumerate(final.variables):
        if not (isinstance(v, EffectParameter) and v.key in keys):
            continue
        for j, other in enumerate(final.variables):
            if abs(R[i, j]) > least and (j > i or not isinstance(other, EffectParameter)) and i != j:
                found[v.name, other.name] = float(R[i, j])
    return found


def explained(grown: Grown) -> list[str]:
    """Return in plain words what the data demand, what they cannot separate, and what is left."""
    texts = [_demanded(grown, key) for key in sorted(grown.needed, key=lambda k: -grown.needed[k])]
    for step in grown.found:
        near = [k for k, g in sorted(step.rivals.items(), key=lambda r: -r[1]) if g > SERIOUS * step.evidence][:3]
        if near:
            texts.append(
                f"Not separated: when {step.key} was taken in, {', '.join(near)} would have brought half its evidence or more"
            )
    for (first, other), r in sorted(grown.spread.items(), key=lambda p: -abs(p[1]))[:5]:
        texts.append(f"Not separated: {first} and {other} (correlation {r:+.2f}); only what they do together is known")
    texts += _identified(grown)
    texts.append(f"Left, in % of each channel's range, open loop over the whole recording: {percent(grown.after)}")
    texts.append(f"Of what was not fitted when the effects were chosen: {percent(grown.predicted)}")
    return texts


def _identified(grown: Grown) -> list[str]:
    """Return the sentences on the nominal parameters: the furthest moved with their intervals, and those not to be believed."""
    furthest = sorted((n for n, u in grown.moved.items() if abs(u) > TOLD), key=lambda n: -abs(grown.moved[n]))
    values = [
        f"{n} = {grown.crane[n]:.4g} ± {grown.deviations.get(n, math.inf):.2g} {unit_of(n)}".strip() for n in furthest
    ]
    texts = [f"Parameters that moved with them: {', '.join(values)}"] if values else []
    known = grown.crane.uncertainty
    strained = [n for n in furthest if abs(grown.moved[n]) > STRAINED and math.isfinite(known[n].std)]
    if strained:
        far = ", ".join(f"{n} by {abs(grown.moved[n]):.1f}" for n in strained)
        texts.append(
            f"Hardly plausible, as many standard uncertainties from the crane file: {far}. They do the work of something that is "
            "not in the model, or that this recording does not separate from them"
        )
    return texts


def _demanded(grown: Grown, key: str) -> str:
    """Return the sentence on one effect: evidence, the errors that it mends, its values."""
    without = grown.without[key]
    worse = sorted(grown.after, key=lambda c: grown.after[c] - without[c])[:3]
    errors = ", ".join(
        f"{c} {100 * without[c]:.3g} -> {100 * grown.after[c]:.3g} %"
        for c in worse
        if without[c] > 1.05 * grown.after[c]
    )
    values = ", ".join(
        f"{n} = {x:.3g} ± {grown.deviations.get(f'{key}:{n}', math.inf):.2g}"
        for n, x in _parameters(grown.crane, key).items()
    )
    return f"Demanded: {key} ({values}); log evidence lost without it {grown.needed[key]:.0f}" + (
        f"; with it {errors} of the range" if errors else ""
    )


def percent(errors: Errors) -> str:
    """Return errors by channel as text, in per cent."""
    return ", ".join(f"{c} {100 * e:.3g}" for c, e in errors.items())
