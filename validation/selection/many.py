"""The search where no effect alone, nor two, explain the recordings: many effects, one a round, and something is always
left.

The same moves and the same score as in `search`, but for three things: the error levels follow the model (`levels`), so
that a round's models share those of the model that it goes on from; windows are two seconds long, all but joined, so
that a ring dies out or a drift shows in them; and what is taken is judged by open-loop runs, also over the last part of
each recording, which is not fitted before the end. At last everything is fitted in one open-loop run, and each effect
is left out once to see what the others make of the recordings without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects.registry import split_key

from ..fit.data import Data, FitData, Joint
from ..fit.evidence import log_evidence
from ..fit.linear import cut
from ..fit.solve import Fit, fit, reknot
from ..fit.staged import (
    LONG,
    SHORT,
    Stage,
    all_parameters,
    first_knots,
    informed_directions,
    residuals,
    staged,
    start_fitted,
    timings,
)
from ..fit.variables import (
    CurveDirection,
    EffectParameter,
    EffectVariable,
    NominalDirection,
    Timing,
    Variable,
    effect_variables,
    stated_effects,
    uncertain_parameters,
)
from ..workers import in_parallel
from .criteria import CRITERIA
from .levels import DRIFT, Errors, Levels, falls, levels_of, likelihood
from .model import Fitted, Model, at_bound, begin, parameters_of, values_of, with_effects
from .moves import scaled, starts
from .screen import screen
from .search import Problem, Progress, silent

#: windows in s, how many times smaller than usual their jumps are, and the longest simulation step
WINDOW, JOINED, STEP = 2.0, 100.0, 5e-3
#: how often the last fit takes up the error levels that it leaves
SETTLED = 3
#: of two numbers that a fit finds for variables the correlation from which on they are said not to be separated
ALIKE = 0.9
Judged = tuple[Errors, Errors]


def joined(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of windows that are all but joined."""
    return (Stage(WINDOW, JOINED, iterations, STEP),)


def run(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of one open-loop run."""
    return (Stage(LONG, 1.0, iterations, STEP),)


@dataclass(frozen=True)
class Taken:
    """One effect that was taken in: the log evidence that it brought, and what else was fitted in its round would have
    brought.
    """

    key: str
    evidence: float
    rivals: Mapping[str, float]


@dataclass(frozen=True)
class Many:
    """The crane with all effects that were taken in, and how each proved itself; errors are open loop, in units of the
    sensors' noise.

    Attributes:
        taken: the rounds in their order, of the effects that stayed.
        before, after: errors of the crane as given, its start fitted, and of the crane at the end.
        needed, without: effect -> log evidence lost and errors when it is left out and all else is fitted again.
        nominal, predicted: errors on what was left out, of parameters alone and with effects, fitted to the rest only.
        deviations: parameter -> standard deviation (SI). alike: variables that can hardly be told apart -> their
            correlation.
        moved: nominal parameter -> how far it moved, in standard uncertainties; where only a range is known, in shares
            of it.
        ranges: channel -> its range in units of the noise.
    """

    crane: Crane
    taken: tuple[Taken, ...]
    before: Errors
    after: Errors
    needed: Mapping[str, float]
    without: Mapping[str, Errors]
    nominal: Errors
    predicted: Errors
    deviations: Mapping[str, float]
    alike: Mapping[tuple[str, str], float]
    moved: Mapping[str, float]
    ranges: Mapping[str, float]

    @property
    def predicts_better(self) -> bool:
        """Whether what was not fitted is predicted better by a tenth, on the average of the channels, than by the
        fitted nominal model.
        """
        first, last = self.nominal, self.predicted
        return sum(math.log(first[c] / last[c]) for c in last) / len(last) > -math.log(1.0 - CRITERIA.worth)


@dataclass(frozen=True)
class Standing:
    """Where the search stands: a fit to the first part of each recording (`learned`, with the sensors' noise), the
    effects that it took in, the error levels of the round, and effects that were demanded but not taken: a linear look
    from a model without them may not show them a second time.
    """

    learned: Data
    fit: Fit
    keys: tuple[str, ...]
    levels: Levels
    tried: Mapping[str, Mapping[str, float]]


def search_many(problem: Problem, most: int, progress: Progress = silent) -> Many | None:
    """Return the crane with at most so many effects taken in one by one, or None where none is worth it."""
    problem, standing = _begun(problem)
    nominal = last = judged(problem, standing.fit)
    taken: list[Taken] = []
    while len(taken) < most:
        progress(f"looking for effect {len(taken) + 1}", 0.05 + 0.6 * len(taken) / most)
        offered = _offered(problem, standing)
        chosen = _best(problem, offered, last)
        if chosen is None:
            break
        key, found, last = chosen
        gains = {k: gain for k, gain, _ in offered}
        taken.append(Taken(key, gains.pop(key), gains))
        again = {k: parameters_of(f.crane, k) for k, gain, f in offered if gain > CRITERIA.demanded and k != key}
        standing = _relevelled(problem, replace(standing, fit=found, keys=(*standing.keys, key), tried=again))
    if not taken:
        return None
    progress("fitting everything together", 0.7)
    return _together(problem, standing, taken, (nominal[1], last[1]), progress)


def _begun(problem: Problem) -> tuple[Problem, Standing]:
    """Return the problem in coarse steps, and where its search begins: nominal parameters fitted, levels of the
    channels found.
    """
    crane, whole = problem.crane, problem.data.stepped(STEP)
    learned = replace(whole, parts=tuple(map(_part, whole.parts))) if isinstance(whole, Joint) else _part(whole)
    base = all_parameters(crane, learned, (Stage(SHORT, 1.0, 5, STEP),))
    shared = (*informed_directions(base), *stated_effects(crane))
    raised = Levels({c: max(1.0, e) for c, e in base.errors.items()}).raised(learned)
    current = staged(crane, raised, shared, _begins(shared, base), base, joined(8))
    problem = replace(problem, data=whole, shared=shared)
    standing = Standing(learned, current, (), Levels(dict.fromkeys(base.errors, math.inf)), {})
    return problem, _relevelled(problem, standing)


def _begins(variables: Sequence[Variable], before: Fit) -> np.ndarray:
    known = values_of(before)
    return np.array([known.get(v.name, begin(v, before, known)) for v in variables])


def _part(data: FitData) -> FitData:
    """Return the part of a recording that is learned from."""
    return data.part(0, int(np.searchsorted(data.time, _end(data))))


def _end(data: FitData) -> float:
    return float(data.time[0] + CRITERIA.learned * (data.time[-1] - data.time[0]))


def _variables(crane: Crane, keys: Sequence[str]) -> list[EffectVariable]:
    """Return the variables of effects that a crane has, as they are."""
    return [v for k in keys for v in effect_variables(k, parameters_of(crane, k), crane.layout)]


def _carried(
    crane: Crane, data: Data, shared: Sequence[Variable], effects: Sequence[EffectVariable], before: Fit,
    stages: Sequence[Stage], kept: Sequence[str],
) -> Fit:  # fmt: skip
    """Return a fit that goes on from another; of the effects those in `kept` that would fall asleep are held as they
    were before.

    Where everything moves at once, parameters may slide into a valley in which an effect that was found before does
    nothing. Another effect is to come in addition to it.
    """
    variables = [*shared, *effects]
    found = staged(crane, data, variables, _begins(variables, before), before, stages)
    asleep = [k for k in kept if any(v.key == k for v in effects) and _neutral(found, k)]
    if not asleep:
        return found
    crane = with_effects(crane, {k: parameters_of(before.crane, k) for k in asleep})
    return _carried(crane, data, shared, [v for v in effects if v.key not in asleep], before, stages, kept)


def _neutral(found: Fit, key: str) -> bool:
    """Whether an effect that a fit moves has gone where it does nothing."""
    return not any(isinstance(v, CurveDirection) and v.key == key for v in found.variables) and all(
        abs(u - v.neutral) < 1e-3
        for v, u in zip(found.variables, found.u, strict=True)
        if isinstance(v, EffectParameter) and v.key == key and not v.parameter.shape
    )


def _relevelled(problem: Problem, now: Standing) -> Standing:
    """Return the standing with the channels' levels as its model leaves them, never higher than before, all fitted
    again.

    By way of one open-loop run: slow drifts do not show in windows of two seconds.
    """
    levels = levels_of(now.fit, now.learned, now.levels.of)
    data, crane, shared, keys = levels.raised(now.learned), problem.crane, problem.shared, now.keys
    long = _carried(crane, data, shared, _variables(now.fit.crane, keys), now.fit, run(6), keys)
    near = replace(long, knots=now.fit.knots, windows=now.fit.windows)  # its parameters, where the windows stand
    again = _carried(crane, data, shared, _variables(long.crane, keys), near, joined(6), keys)
    return replace(now, fit=again, levels=levels)


# -- one round -------------------------------------------------------------------------------------------------------


def _offered(problem: Problem, now: Standing) -> list[tuple[str, float, Fit]]:
    """Return effects fitted beside those taken in: key, gain in log evidence, fit; best first."""
    begins = _promising(problem, now) | dict(now.tried)
    own = [effect_variables(k, v, problem.crane.layout) for k, v in begins.items()]
    fits = in_parallel(problem.jobs, [(_tried, problem, now, variables) for variables in own])
    bare = log_evidence(now.fit)
    gains = [(k, log_evidence(f) - bare, f) for k, f in zip(begins, fits, strict=True) if not at_bound(f, k)]
    return sorted((g for g in gains if math.isfinite(g[1])), key=lambda g: -g[1])


def _promising(problem: Problem, now: Standing) -> dict[str, Mapping[str, float]]:
    """Return what to try: the best of a screen in long windows, and the best of one in short windows that follow the
    machine.

    The long ones show what adds up; in the short ones a chamber that the model takes for stiff still stands where the
    machine's stands, so that an effect that changes all from there on (air) is seen at all.
    """
    begins = starts(now.fit.crane, now.learned)
    looks = [screen(f, begins, stiffness) for f, stiffness in ((now.fit, JOINED), (_following(problem, now), 1.0))]
    best = [
        list({s.start.key: s for s in reversed(look) if s.gain >= CRITERIA.promise}.values())[::-1] for look in looks
    ]
    chosen: dict[str, Mapping[str, float]] = {}
    for score in (s for pair in zip_longest(*best) for s in pair if s is not None):
        if len(chosen) < CRITERIA.tried:
            chosen.setdefault(score.start.key, scaled(score.start, score.amplitude))
    return chosen


def _following(problem: Problem, now: Standing) -> Fit:
    """Return the current model in short, loosely joined windows, with the error levels that it has there."""
    data, knots = now.learned, first_knots(now.fit.crane, now.learned, SHORT)
    for _ in range(2):
        windows = cut(data, SHORT)
        found = fit(problem.crane, data, windows, knots, now.fit.variables, now.fit.u, stiffness=1.0, iterations=2)
        data = levels_of(found, now.learned).raised(now.learned)
    return replace(found, data=data, windows=tuple(cut(data, SHORT)))


def _tried(problem: Problem, now: Standing, new: Sequence[EffectVariable]) -> Fit:
    """Return the fit with a new effect: first everything else finds its place beside it, then it is free as well.

    Where an effect starts with its full size, a step in all variables at once is far from linear and stalls.
    """
    data, old = now.fit.data, _variables(now.fit.crane, now.keys)
    values = {v.parameter.name: v.start for v in new if isinstance(v, EffectParameter)}
    beside = problem.crane.with_effect(new[0].key, values)
    first = _carried(beside, data, problem.shared, old, now.fit, joined(3), now.keys)
    return _carried(problem.crane, data, problem.shared, [*old, *new], first, joined(6), now.keys)


def _best(problem: Problem, offered: Sequence[tuple[str, float, Fit]], last: Judged) -> tuple[str, Fit, Judged] | None:
    """Return the effect with which whole runs have the least error, over what was learned from and what was not: key,
    fit, errors.

    Of those that the data demand, at least half as much as the first, and that make the errors fall; None if there is
    none. Windows tell what is at work, but not whether it adds up over a whole run; and what merely imitates the cause
    predicts worse. Where whole runs differ by less than counts as a fall, the evidence decides.
    """
    found = []
    for key, gain, fit_with in offered:
        if gain < max(CRITERIA.demanded, CRITERIA.serious * offered[0][1]):
            break
        errors = judged(problem, fit_with)
        fall, ahead = (falls(a, b) for a, b in zip(last, errors, strict=True))
        if fall + ahead > CRITERIA.gained and ahead > -CRITERIA.tolerated:
            found.append((fall + ahead, key, fit_with, errors))
    most = max((f[0] for f in found), default=0.0)
    return next((f[1:] for f in found if f[0] > most - CRITERIA.gained), None)  # they stand best evidence first


def judged(problem: Problem, found: Fit) -> Judged:
    """Return open-loop errors by channel over what was learned from, and over the rest, into which the same runs go
    on.
    """
    runs = []
    for i, learned in enumerate(found.data.parts):
        own = found.of(i)
        windows = cut(learned, LONG)
        run = fit(own.crane, learned.shifted(own.late), windows, reknot(own, windows), (), np.zeros(0), iterations=5)
        runs.append(replace(own, knots=run.knots, windows=run.windows))
    return _errors(problem, runs, rest=False), _errors(problem, runs, rest=True)


def _errors(problem: Problem, runs: Sequence[Fit], rest: bool | None = None) -> dict[str, float]:
    """Return by channel the errors of open-loop runs, one a recording, over all of it, or without or with nothing but
    the rest (not learned from).
    """
    left: dict[str, list[np.ndarray]] = {}
    for data, run in zip(problem.data.parts, runs, strict=True):
        for c, (time, r) in residuals(run.crane, data, run.starts, run.late).items():
            left.setdefault(c, []).append(r if rest is None else r[(time >= _end(data)) == rest])
    every = {c: np.concatenate(own) for c, own in left.items()}
    return {c: float(np.sqrt(np.mean(r**2))) for c, r in every.items() if len(r)}


# -- everything together ---------------------------------------------------------------------------------------------


def _everything(problem: Problem, keys: Sequence[str], before: Fit, crane: Crane) -> tuple[list[Variable], np.ndarray]:
    """Return clocks, all uncertain parameters and all effects as variables, and their values in a crane; clocks as a
    fit found them.
    """
    given, data = problem.crane, problem.data
    nominal = [_believable(v) for v in uncertain_parameters(given, data.own, len(data.parts))]
    stated, clocks, known = stated_effects(given), timings(data), values_of(before)
    values: list[float] = [known.get(v.name, 0.0) for v in clocks]
    for v in nominal:
        name = next(iter(v.weights))
        has = crane if v.recording is None else before.of(v.recording).crane
        values.append((has[name] - given[name]) / v.weights[name])
    values += [
        v.to_u(parameters_of(crane, v.key)[v.parameter.name]) if isinstance(v, EffectParameter) else v.begin
        for v in stated
    ]
    own = _variables(crane, keys)
    return [*clocks, *nominal, *stated, *own], np.array([*values, *(v.begin for v in own)])


def _believable(v: NominalDirection) -> NominalDirection:
    """Return a nominal parameter that stays within what can be believed of it."""
    return (
        v if math.isinf(v.prior) else replace(v, lower=-CRITERIA.believed * v.prior, upper=CRITERIA.believed * v.prior)
    )


def _open_loop(problem: Problem, keys: Sequence[str], data: Data, before: Fit, crane: Crane, iterations: int) -> Fit:
    """Return everything fitted to one open-loop run, by way of long windows."""
    variables, u = _everything(problem, keys, before, crane)
    windows = staged(problem.crane, data, variables, u, before, joined(iterations))
    return staged(problem.crane, data, variables, windows.u, windows, run(2 * iterations))


def _together(
    problem: Problem, standing: Standing, taken: Sequence[Taken], left_out: tuple[Errors, Errors], progress: Progress
) -> Many:
    """Fit everything to the whole recordings, leave out what is not needed, and say how well each effect is
    determined.
    """
    final, keys = _whole_run(problem, standing), list(standing.keys)
    each = range(len(problem.data.parts))
    full = _errors(problem, [final.of(i) for i in each])
    while True:
        progress("leaving out each effect once", 0.8)
        fits = in_parallel(
            problem.jobs, [(_best_run, problem, [k for k in keys if k != key], final, key) for key in keys]
        )
        left = dict(zip(keys, fits, strict=True))
        needed = {k: log_evidence(final) - log_evidence(f) for k, f in left.items()}
        without = {k: _errors(problem, [f.of(i) for i in each]) for k, f in left.items()}
        idle = [k for k in keys if needed[k] < CRITERIA.demanded and not mends(without[k], full)]
        if not idle or len(keys) == 1:
            break
        weakest = min(idle, key=lambda k: needed[k])
        keys.remove(weakest)
        final = left[weakest]
    parts = problem.data.parts
    before = _errors(problem, [start_fitted(problem.crane, p) for p in parts])
    ranges = {s.channel: float(np.ptp(s.values)) / s.noise for p in parts for s in p.samples}
    shared = zip(final.variables, final.u, strict=True)
    moved = {v.name: float(u) for v, u in shared if isinstance(v, NominalDirection) and v.recording is None}
    return Many(
        final.crane, tuple(t for t in taken if t.key in keys), before, _errors(problem, [final.of(i) for i in each]),
        needed, without,
        *left_out, _deviations(final, keys), _alike(final, keys), moved, ranges,
    )  # fmt: skip


def mends(without: Errors, full: Errors) -> bool:
    """Whether a channel's error is half as large again without an effect as with everything, and more than its sensor's
    noise.
    """
    return any(without[c] > CRITERIA.mended * max(full[c], 1.0) for c in full)


def _whole_run(problem: Problem, standing: Standing) -> Fit:
    """Return the open-loop fit to the whole recordings: the most likely of those that begin at the current fit, at the
    machine, and anew.

    Anew is the crane as given, with effects of the size that is met in practice: where much has moved step by step,
    that valley may be the deeper one.
    """
    data = standing.levels.raised(problem.data)
    found, keys = _extended(problem, standing, data), standing.keys
    fresh, windows = _typical(problem.crane, keys), tuple(cut(data, WINDOW))
    machine = [replace(found, windows=windows, knots=first_knots(c, data, WINDOW)) for c in (found.crane, fresh)]
    begins = [(found, found.crane), (machine[0], found.crane), (machine[1], fresh)]
    fits: list[Fit] = in_parallel(problem.jobs, [(_settled, problem, keys, data, f, crane) for f, crane in begins])
    return max(fits, key=lambda f: likelihood(f, problem.data))


def _typical(crane: Crane, keys: Sequence[str]) -> Crane:
    """Return the crane with effects of the size that is met in practice."""
    effects = {k: split_key(k)[0].parameters for k in keys}
    return with_effects(
        crane, {k: {p.name: p.neutral if p.shape else p.typical for p in own} for k, own in effects.items()}
    )


def _settled(problem: Problem, keys: Sequence[str], data: Data, start: Fit, crane: Crane) -> Fit:
    """Return the open-loop fit from a start, fitted again a few times with the error levels that it leaves."""
    found = _open_loop(problem, keys, data, start, crane, 6)
    for _ in range(SETTLED):
        data = levels_of(found, problem.data, apart=DRIFT).raised(problem.data)
        found = staged(problem.crane, data, found.variables, found.u, found, run(12))
    return found


def _extended(problem: Problem, standing: Standing, data: Data) -> Fit:
    """Return the current crane in windows over the whole recordings, of which the fit has seen only the first part."""
    found, windows = standing.fit, cut(data, WINDOW)
    guess = first_knots(found.crane, data, WINDOW)
    near = reknot(found, windows)
    known = np.array([w.data.time[0] <= _end(problem.data.parts[w.recording]) - WINDOW for w in windows])
    if near.shape == guess.shape:
        guess[known] = near[known]
    kept = [i for i, v in enumerate(found.variables) if isinstance(v, Timing) or v.recording is not None]
    variables = [found.variables[i] for i in kept]
    return fit(found.crane, data, windows, guess, variables, found.u[kept], stiffness=JOINED)


def _best_run(problem: Problem, keys: Sequence[str], final: Fit, without: str) -> Fit:
    """Return the best of three fits of one open-loop run without an effect: straight from where the final one stands,
    and by way of long windows that begin on its run, or on the machine's: without an effect the run may be far from
    both.
    """
    crane, data = final.crane.without_effect(without), final.data
    straight = staged(problem.crane, data, *_everything(problem, keys, final, crane), final, run(8))
    measured = replace(final, windows=tuple(cut(data, WINDOW)), knots=first_knots(crane, data, WINDOW))
    ways = [straight, *(_open_loop(problem, keys, data, start, crane, 4) for start in (final, measured))]
    return max(ways, key=log_evidence)


def _deviations(final: Fit, keys: Sequence[str]) -> dict[str, float]:
    """Return the standard deviation (SI) of each parameter of the effects, and of each nominal parameter that moved."""
    model = Fitted(Model((), {key: {} for key in keys}), final, math.nan, final)
    found = {f"{k}:{name}": spread for k in keys for name, spread in model.deviations(k).items()}
    nominal = {v.name: next(iter(v.weights.values())) for v in final.variables if isinstance(v, NominalDirection)}
    return found | {name: scale * final.std(name) for name, scale in nominal.items()}


def _alike(final: Fit, keys: Sequence[str]) -> dict[tuple[str, str], float]:
    """Return pairs of variables, one of them an effect's that was taken in, whose errors are correlated."""
    spread = np.sqrt(np.maximum(np.diag(final.cov), 1e-300))
    R = final.cov / np.outer(spread, spread)
    found = {}
    for i, v in enumerate(final.variables):
        if not (isinstance(v, EffectParameter) and v.key in keys):
            continue
        for j, other in enumerate(final.variables):
            if abs(R[i, j]) > ALIKE and (j > i or not isinstance(other, EffectParameter)) and i != j:
                found[v.name, other.name] = float(R[i, j])
    return found
