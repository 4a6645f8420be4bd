"""The search where no effect alone, nor two, explain the recordings: many effects, one a round, and something is always
left.

The same moves, the same beam and the same score as in `search`, but for three things: the error levels follow the model
(`levels`), so that a round's models share those of the best that it goes on from; windows are two seconds long, all but
joined, so that a ring dies out or a drift shows in them; and models are ranked by open-loop runs, also over the last
part of each recording, which is not fitted before the end. At last everything is fitted in one open-loop run, and each
effect is left out once to see what the others make of the recordings without it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import zip_longest
from typing import Any

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
    run_fitted,
    staged,
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
from .levels import Errors, Levels, falls, levels_of, likelihoods
from .model import Fitted, Model, at_bound, begin, best_of_each, parameters_of, values_of, with_effects
from .moves import scaled, starts
from .screen import best_starts, screen
from .search import Problem, Progress, silent

Judged = tuple[Errors, Errors]


def loose(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of short windows that follow the machine."""
    return (Stage(SHORT, 1.0, iterations, CRITERIA.step),)


def joined(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of windows that are all but joined."""
    return (Stage(CRITERIA.window, CRITERIA.joined, iterations, CRITERIA.step),)


def run(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of one open-loop run."""
    return (Stage(LONG, 1.0, iterations, CRITERIA.step),)


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
    def explains(self) -> bool:
        """Whether it leaves hardly more than noise, on the average of the channels."""
        return math.sqrt(sum(e**2 for e in self.after.values()) / len(self.after)) < CRITERIA.level

    @property
    def predicts_better(self) -> bool:
        """Whether what was not fitted is predicted better by a tenth, on the average of the channels, than by the
        fitted nominal model.
        """
        first, last = self.nominal, self.predicted
        return sum(math.log(first[c] / last[c]) for c in last) / len(last) > -math.log(1.0 - CRITERIA.worth)


@dataclass(frozen=True)
class Standing:
    """A model that the search goes on from.

    Attributes:
        fit: to the first part of each recording, or to all of it.
        levels: the error levels of its round.
        taken: how its effects were taken in, one a round.
        errors: of open-loop runs, over what was learned from and over the rest.
        tried: effects that were demanded but not taken: a linear look from a model without them may not show them a
            second time.
        unseen: where it learned from all of each recording, the errors over the rest of the model that it grew from.
    """

    fit: Fit
    levels: Levels
    taken: tuple[Taken, ...] = ()
    errors: Judged = ({}, {})
    tried: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    unseen: Errors | None = None

    @property
    def predicted(self) -> Errors:
        """Errors over what it had not learned from."""
        return self.errors[1] if self.unseen is None else self.unseen

    @property
    def keys(self) -> tuple[str, ...]:
        """The effects that it took in."""
        return tuple(t.key for t in self.taken)

    @cached_property
    def evidence(self) -> float:
        """Its log evidence, with the error levels of its round."""
        return log_evidence(self.fit)

    @property
    def left(self) -> tuple[float, float]:
        """The log by which its errors could still fall, over what was learned from and over the rest."""
        first, rest = (falls(e, dict.fromkeys(e, 1.0)) for e in self.errors)
        return first, rest

    def fall(self, before: Standing) -> float:
        """Return the log by which open-loop errors fall against those of another model, on both stretches together."""
        return sum(falls(a, b) for a, b in zip(before.errors, self.errors, strict=True))

    @property
    def worth(self) -> float:
        """The log by which errors must fall against its own: a tenth, or the share of what is left that the best of
        several effects takes away at least.
        """
        return min(CRITERIA.gained, CRITERIA.part * sum(self.left))

    def serves(self, before: Standing) -> bool:
        """Whether errors of open-loop runs fall, and not at the cost of what was not learned from."""
        return self.fall(before) > before.worth and falls(before.errors[1], self.errors[1]) > -CRITERIA.tolerated


def search_many(problem: Problem, most: int, progress: Progress = silent) -> Many | None:
    """Return the crane with at most so many effects taken in one by one, or None where none is worth it."""
    problem, nominal = _begun(problem)
    best, last, beam = nominal, list[Standing](), [nominal]
    for size in range(most):
        progress(f"looking for effect {size + 1}", 0.05 + 0.6 * size / most)
        beam = _widened(problem, beam)
        found = _round(problem, beam, best)
        if not found:
            break
        beam = _relevelled(problem, found)
        if found[0].serves(best):
            best = beam[0]
            last = [one for one in beam if one.evidence > best.evidence - CRITERIA.proof]
        if sum(best.left) <= CRITERIA.gained:
            break
    if not last:
        return None
    progress("fitting everything together", 0.7)
    return _together(problem, last, nominal.errors[1], progress)


def _begun(problem: Problem) -> tuple[Problem, Standing]:
    """Return the problem in coarse steps, and where its search begins: nominal parameters fitted, levels of the
    channels found.
    """
    crane = problem.crane
    problem = replace(problem, data=problem.data.stepped(CRITERIA.step))
    learned = _first_part(problem)
    base = all_parameters(crane, learned, loose(5))
    problem = replace(problem, shared=(*informed_directions(base), *stated_effects(crane)))
    raised = Levels({c: max(1.0, e) for c, e in base.errors.items()}).raised(learned)
    current = staged(crane, raised, problem.shared, _begins(problem.shared, base), base, joined(8))
    standing = Standing(current, Levels(dict.fromkeys(base.errors, math.inf)))
    return problem, _relevelled(problem, [standing])[0]


def _begins(variables: Sequence[Variable], before: Fit) -> np.ndarray:
    known = values_of(before)
    return np.array([known.get(v.name, begin(v, before, known)) for v in variables])


def _learned(problem: Problem, now: Standing) -> Data:
    """Return what a model learned from, with the sensors' noise."""
    return _first_part(problem) if now.unseen is None else problem.data


def _first_part(problem: Problem) -> Data:
    whole = problem.data
    return replace(whole, parts=tuple(map(_part, whole.parts))) if isinstance(whole, Joint) else _part(whole)


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
    """Return a fit that goes on from another; of the effects those in `kept` that would become inactive are held as
    they were before.

    Where everything moves at once, parameters may slide into a valley in which an effect that was found before does
    nothing. Another effect is to come in addition to it.
    """
    variables = [*shared, *effects]
    found = staged(crane, data, variables, _begins(variables, before), before, stages)
    inactive = [k for k in kept if any(v.key == k for v in effects) and _neutral(found, k)]
    if not inactive:
        return found
    crane = with_effects(crane, {k: parameters_of(before.crane, k) for k in inactive})
    return _carried(crane, data, shared, [v for v in effects if v.key not in inactive], before, stages, kept)


def _neutral(found: Fit, key: str) -> bool:
    """Whether an effect that a fit moves has gone where it does nothing."""
    return not any(isinstance(v, CurveDirection) and v.key == key for v in found.variables) and all(
        abs(u - v.neutral) < CRITERIA.at_end
        for v, u in zip(found.variables, found.u, strict=True)
        if isinstance(v, EffectParameter) and v.key == key and not v.parameter.shape
    )


def _relevelled(problem: Problem, found: Sequence[Standing]) -> list[Standing]:
    """Return models with the channels' levels as the first of them leaves them, never higher than before, all fitted
    again and judged.
    """
    levels = levels_of(found[0].fit, _learned(problem, found[0]), found[0].levels.of)
    return in_parallel(problem.jobs, [(_at, problem, now, levels) for now in found])


def _at(problem: Problem, now: Standing, levels: Levels) -> Standing:
    """Return a model fitted with other levels, by way of one open-loop run: slow drifts do not show in windows of two
    seconds.
    """
    data, crane, shared, keys = levels.raised(_learned(problem, now)), problem.crane, problem.shared, now.keys
    long = _carried(crane, data, shared, _variables(now.fit.crane, keys), now.fit, run(6), keys)
    near = replace(long, knots=now.fit.knots, windows=now.fit.windows)  # its parameters, where the windows stand
    again = _carried(crane, data, shared, _variables(long.crane, keys), near, joined(6), keys)
    return replace(now, fit=again, levels=levels, errors=judged(problem, again))


def _widened(problem: Problem, beam: list[Standing]) -> list[Standing]:
    """Return models that learn from all of each recording, where the first of them leaves only noise in what it learned
    from: what is still missing shows in the rest alone.
    """
    if beam[0].unseen is not None or beam[0].left[0] > CRITERIA.gained:
        return beam
    return _relevelled(problem, in_parallel(problem.jobs, [(_on_all, problem, now) for now in beam]))


def _on_all(problem: Problem, now: Standing) -> Standing:
    data = now.levels.raised(problem.data)
    near = _extended(problem, now, data)
    found = replace(now.fit, data=data, windows=near.windows, knots=near.knots)
    return replace(now, fit=found, levels=Levels(dict.fromkeys(now.levels.of, math.inf)), unseen=now.errors[1])


# -- one round -------------------------------------------------------------------------------------------------------


def _round(problem: Problem, beam: Sequence[Standing], best: Standing) -> list[Standing]:
    """Return the models with one effect more that a round finds, best first, at most as many as a beam holds.

    Of those whose effect the data demand, at least half as much as the first beside the same model, and that make the
    errors of whole runs fall, over what was learned from and what was not, below those of the best model with fewer:
    windows tell what is at work, but not whether it adds up over a whole run, and what merely imitates the cause
    predicts worse. Where whole runs differ by less than counts as a fall, the evidence decides.
    """
    jobs = problem.jobs
    begins = in_parallel(jobs, [(_promising, problem, now) for now in beam])
    moves = [(now, key, values) for now, own in zip(beam, begins, strict=True) for key, values in own.items()]
    fits = _added(problem, moves)
    children = []
    for now in beam:
        own = {m[1]: f for m, f in zip(moves, fits, strict=True) if m[0] is now and f is not None}
        children += [(now, one) for one in _demanded(now, own)]
    errors = in_parallel(jobs, [(judged, problem, one.fit) for _, one in children])
    ran = [(now, replace(one, errors=e)) for (now, one), e in zip(children, errors, strict=True)]
    found = [one for now, one in ran if one.fall(now) > now.worth and one.fall(best) > 0.0]
    return _leading(best_of_each(found), best)


def _promising(problem: Problem, now: Standing) -> dict[str, Mapping[str, float]]:
    """Return what to try beside a model: the best of a screen in long windows, the best of one in short windows that
    follow the machine, and what was demanded before.

    The long ones show what adds up; in the short ones a chamber that the model takes for stiff still stands where the
    machine's stands, so that an effect that changes all from there on (air) is seen at all.
    """
    begins = starts(now.fit.crane, _learned(problem, now))
    looks = (now.fit, CRITERIA.joined), (_following(problem, now), 1.0)
    best = [best_starts(screen(f, begins, stiffness)) for f, stiffness in looks]
    chosen: dict[str, Mapping[str, float]] = {}
    for score in (s for pair in zip_longest(*best) for s in pair if s is not None):
        if len(chosen) < CRITERIA.tried:
            chosen.setdefault(score.start.key, scaled(score.start, score.amplitude))
    return chosen | dict(now.tried)


def _following(problem: Problem, now: Standing) -> Fit:
    """Return the current model in short, loosely joined windows, with the error levels that it has there."""
    learned = data = _learned(problem, now)
    knots = first_knots(now.fit.crane, data, SHORT)
    for _ in range(2):
        windows = cut(data, SHORT)
        found = fit(problem.crane, data, windows, knots, now.fit.variables, now.fit.u, stiffness=1.0, iterations=2)
        data = levels_of(found, learned).raised(learned)
    return replace(found, data=data, windows=tuple(cut(data, SHORT)))


def _added(problem: Problem, moves: Sequence[tuple[Standing, str, Mapping[str, float]]]) -> list[Fit | None]:
    """Return for each model, new effect and its values the likeliest fit in which all effects act, if there is one; the
    same for all models that it leads to the same effects.

    One fit begins in long windows and one in short ones: in long windows a ring has a false minimum a period, in short
    ones what adds up slowly is not seen, and may be lost.
    """
    sets = [frozenset((*now.keys, key)) for now, key, _ in moves]
    distinct = dict(zip(reversed(sets), reversed(moves), strict=True))
    ways = ((CRITERIA.window, joined(12)), (SHORT, (*loose(3), *joined(12))))
    fits = in_parallel(problem.jobs, [(_anew, problem, *m, *way) for m in distinct.values() for way in ways])
    best = dict[frozenset[str], Fit | None]()
    for k, (keys, (now, key, _)) in enumerate(distinct.items()):
        acting = [f for f in fits[len(ways) * k : len(ways) * (k + 1)] if _acting(f, (*now.keys, key))]
        best[keys] = max(acting, key=log_evidence, default=None)
    return [best[keys] for keys in sets]


def _anew(
    problem: Problem, now: Standing, key: str, values: Mapping[str, float], seconds: float, stages: Sequence[Stage]
) -> Fit:
    """Return a model's effects and a new one fitted from the crane as given, each of the size that is met in practice.

    Where earlier effects have gone far to do the work of one that was missing, no step leads from there to what they
    are beside it.
    """
    data, effects = now.fit.data, {k: parameters_of(now.fit.crane, k) for k in now.keys} | {key: values}
    crane = _typical(problem.crane, effects)
    variables = [*problem.shared, *_variables(crane, list(effects))]
    u = np.array([begin(v, now.fit, {}) for v in variables])
    return staged(problem.crane, data, variables, u, first_knots(crane, data, seconds), stages)


def _demanded(now: Standing, fits: Mapping[str, Fit]) -> list[Standing]:
    """Return a model with each effect that the data demand beside it, at least half as much as the first."""
    gains = {k: log_evidence(f) - now.evidence for k, f in fits.items()}
    gains = {k: gains[k] for k in sorted(gains, key=lambda k: -gains[k]) if math.isfinite(gains[k])}
    serious = max(CRITERIA.demanded, CRITERIA.serious * max(gains.values(), default=0.0))
    demanded = {k: parameters_of(fits[k].crane, k) for k, gain in gains.items() if gain > CRITERIA.demanded}
    return [
        replace(
            now,
            fit=fits[key],
            taken=(*now.taken, Taken(key, gain, {k: g for k, g in gains.items() if k != key})),
            tried={k: values for k, values in demanded.items() if k != key},
        )
        for key, gain in gains.items()
        if gain >= serious
    ]


def _acting(found: Fit, keys: Sequence[str]) -> bool:
    """Whether all effects act, the last one within its bounds: else it is a model with fewer, or none."""
    return not at_bound(found, keys[-1]) and not any(_neutral(found, key) for key in keys)


def _leading(found: Sequence[Standing], before: Standing) -> list[Standing]:
    """Return the models whose whole runs are best, as many as a beam holds; found stand best evidence first."""
    left, leading = list(found), list[Standing]()
    while left and len(leading) < CRITERIA.beam:
        most = max(one.fall(before) for one in left)
        first = next(i for i, one in enumerate(left) if one.fall(before) >= most - before.worth)
        leading.append(left.pop(first))
    return leading


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
    nominal = [believable(v) for v in uncertain_parameters(given, data.own, len(data.parts))]
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


def believable(v: NominalDirection) -> NominalDirection:
    """Return a nominal parameter that stays within what can be believed of it."""
    return (
        v if math.isinf(v.prior) else replace(v, lower=-CRITERIA.believed * v.prior, upper=CRITERIA.believed * v.prior)
    )


def _open_loop(problem: Problem, keys: Sequence[str], data: Data, before: Fit, crane: Crane, iterations: int) -> Fit:
    """Return everything fitted to one open-loop run, by way of long windows."""
    variables, u = _everything(problem, keys, before, crane)
    windows = staged(problem.crane, data, variables, u, before, joined(iterations))
    return staged(problem.crane, data, variables, windows.u, windows, run(2 * iterations))


def _together(problem: Problem, last: Sequence[Standing], nominal: Errors, progress: Progress) -> Many:
    """Fit everything to the whole recordings, leave out what is not needed, and say how well each effect is
    determined.
    """
    final, standing = _whole_run(problem, last)
    keys = list(standing.keys)
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
        unneeded = [k for k in keys if needed[k] < CRITERIA.demanded and not mends(without[k], full)]
        if not unneeded or len(keys) == 1:
            break
        weakest = min(unneeded, key=lambda k: needed[k])
        keys.remove(weakest)
        final = left[weakest]
    parts = problem.data.parts
    before = _errors(problem, [run_fitted(problem.crane, p) for p in parts])
    ranges = {s.channel: float(np.ptp(s.values)) / s.noise for p in parts for s in p.samples}
    shared = zip(final.variables, final.u, strict=True)
    moved = {v.name: float(u) for v, u in shared if isinstance(v, NominalDirection) and v.recording is None}
    return Many(
        final.crane, tuple(t for t in standing.taken if t.key in keys),
        before, _errors(problem, [final.of(i) for i in each]), needed, without,
        nominal, standing.predicted, _deviations(final, keys), _alike(final, keys), moved, ranges,
    )  # fmt: skip


def mends(without: Errors, full: Errors) -> bool:
    """Whether a channel's error is half as large again without an effect as with everything, and more than its sensor's
    noise.
    """
    return any(without[c] > CRITERIA.mended * max(full[c], 1.0) for c in full)


def _whole_run(problem: Problem, last: Sequence[Standing]) -> tuple[Fit, Standing]:
    """Return the most likely of the open-loop fits to the whole recordings of the last round's models, and its model.

    Each begins at its fit, at the machine, and anew: at the crane as given, with effects of the size that is met in
    practice. Where much has moved step by step, that valley may be the deeper one.
    """
    tasks, models = list[tuple[Any, ...]](), list[Standing]()
    for standing in last:
        data = standing.levels.raised(problem.data)
        found, keys = _extended(problem, standing, data), standing.keys
        effects = {k: parameters_of(found.crane, k) for k in keys}
        fresh, windows = _typical(problem.crane, effects), tuple(cut(data, CRITERIA.window))
        machine = [
            replace(found, windows=windows, knots=first_knots(c, data, CRITERIA.window)) for c in (found.crane, fresh)
        ]
        begins = [(found, found.crane), (machine[0], found.crane), (machine[1], fresh)]
        tasks += [(_settled, problem, keys, data, f, crane) for f, crane in begins]
        models += [standing] * len(begins)
    fits: list[Fit] = in_parallel(problem.jobs, tasks)
    likely = likelihoods(fits, problem.data)
    best = likely.index(max(likely))
    return fits[best], models[best]


def _typical(crane: Crane, effects: Mapping[str, Mapping[str, float]]) -> Crane:
    """Return the crane with effects of the size that is met in practice; what gives one its shape (a moment, a place of
    the stroke) as it is.
    """
    of = {k: split_key(k)[0].parameters for k in effects}
    return with_effects(
        crane, {k: {p.name: effects[k][p.name] if p.shape else p.typical for p in own} for k, own in of.items()}
    )


def _settled(problem: Problem, keys: Sequence[str], data: Data, start: Fit, crane: Crane) -> Fit:
    """Return the open-loop fit from a start, fitted again a few times with the error levels that it leaves."""
    found = _open_loop(problem, keys, data, start, crane, 6)
    for _ in range(CRITERIA.settled):
        data = levels_of(found, problem.data, apart=CRITERIA.drifts).raised(problem.data)
        found = staged(problem.crane, data, found.variables, found.u, found, run(12))
    return found


def _extended(problem: Problem, standing: Standing, data: Data) -> Fit:
    """Return the current crane in windows over the whole recordings, of which the fit has seen only the first part."""
    found, windows = standing.fit, cut(data, CRITERIA.window)
    guess = first_knots(found.crane, data, CRITERIA.window)
    near = reknot(found, windows)
    known = np.array([w.data.time[0] <= _end(problem.data.parts[w.recording]) - CRITERIA.window for w in windows])
    if near.shape == guess.shape:
        guess[known] = near[known]
    kept = [i for i, v in enumerate(found.variables) if isinstance(v, Timing) or v.recording is not None]
    variables = [found.variables[i] for i in kept]
    return fit(found.crane, data, windows, guess, variables, found.u[kept], stiffness=CRITERIA.joined)


def _best_run(problem: Problem, keys: Sequence[str], final: Fit, without: str) -> Fit:
    """Return the best of three fits of one open-loop run without an effect: straight from where the final one stands,
    and by way of long windows that begin on its run, or on the machine's: without an effect the run may be far from
    both.
    """
    crane, data = final.crane.without_effect(without), final.data
    straight = staged(problem.crane, data, *_everything(problem, keys, final, crane), final, run(8))
    measured = replace(
        final, windows=tuple(cut(data, CRITERIA.window)), knots=first_knots(crane, data, CRITERIA.window)
    )
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
            if abs(R[i, j]) > CRITERIA.alike and (j > i or not isinstance(other, EffectParameter)) and i != j:
                found[v.name, other.name] = float(R[i, j])
    return found
