"""What models do to whole runs, where errors drift: over what they learned from and over the rest; and at the end of a
search all effects and parameters fitted in one open-loop run to all of the recordings, and each effect left out once.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects.registry import split_key

from ..fit.data import Data, FitData
from ..fit.evidence import log_evidence
from ..fit.knots import reknot
from ..fit.solve import Fit, fit
from ..fit.staged import LONG, SHORT, Stage, first_knots, residuals, run_fitted, staged, timings
from ..fit.variables import EffectParameter, NominalDirection, Timing, Variable, stated_effects, uncertain_parameters
from ..fit.windows import cut
from ..workers import in_parallel
from .criteria import CRITERIA
from .levels import Errors, Levels, each_part, falls, levels_of, likelihoods
from .model import Fitted, Model, effects_of, moved_to, parameters_of, values_of, with_effects
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
class Standing(Fitted):
    """A fitted model, to the first part of each recording or to all of it.

    Attributes:
        levels: the error levels of its round.
        taken: how its effects were taken in, one a round.
        errors: of open-loop runs, over what was learned from and over the rest.
        asked: effects that were demanded but not taken, with their values: a linear look from a model without them may
            not show them a second time.
        unseen: where it learned from all of each recording, the errors over the rest of the model that it grew from.
    """

    levels: Levels
    taken: tuple[Taken, ...] = ()
    errors: Judged = ({}, {})
    asked: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    unseen: Errors | None = None

    @property
    def predicted(self) -> Errors:
        """Errors over what it had not learned from."""
        return self.errors[1] if self.unseen is None else self.unseen

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

    def learned(self, problem: Problem) -> Data:
        """Return what it learned from, with the sensors' noise."""
        return first_part(problem.data) if self.unseen is None else problem.data

    def extended(self, problem: Problem) -> Fit:
        """Return its crane in windows over the whole recordings, of which the fit has seen only the first part."""
        data = self.levels.raised(problem.data)
        windows = cut(data, CRITERIA.window)
        guess = first_knots(self.fit.crane, data, CRITERIA.window)
        near = reknot(self.fit, windows)
        ends = [end_of_learned(part) - CRITERIA.window for part in problem.data.parts]
        known = np.array([w.data.time[0] <= ends[w.recording] for w in windows])
        if near.shape == guess.shape:
            guess[known] = near[known]
        kept = [i for i, v in enumerate(self.fit.variables) if isinstance(v, Timing) or v.recording is not None]
        variables = [self.fit.variables[i] for i in kept]
        return fit(
            self.fit.crane, data, windows, guess, variables, self.fit.u[kept], stiffness=CRITERIA.joined
        )  # fmt: skip


def first_part(whole: Data) -> Data:
    """Return the part of each recording that is learned from."""
    return each_part(whole, lambda part: part.part(0, int(np.searchsorted(part.time, end_of_learned(part)))))


def end_of_learned(data: FitData) -> float:
    """Return the time (s) up to which a recording is learned from, where a choice is judged on the rest."""
    return float(data.time[0] + CRITERIA.learned * (data.time[-1] - data.time[0]))


def typical(crane: Crane, effects: Mapping[str, Mapping[str, float]]) -> Crane:
    """Return the crane with effects of the size that is met in practice; what gives one its shape (a moment, a place of
    the stroke) as it is.
    """
    of = {k: split_key(k)[0].parameters for k in effects}
    return with_effects(
        crane, {k: {p.name: effects[k][p.name] if p.shape else p.typical for p in own} for k, own in of.items()}
    )


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
    return errors_of(problem, runs, rest=False), errors_of(problem, runs, rest=True)


def errors_of(problem: Problem, runs: Sequence[Fit], rest: bool | None = None) -> dict[str, float]:
    """Return by channel the errors of open-loop runs, one a recording, over all of it, or without or with nothing but
    the rest (not learned from).
    """
    left: dict[str, list[np.ndarray]] = {}
    for data, run in zip(problem.data.parts, runs, strict=True):
        for c, (time, r) in residuals(run.crane, data, run.starts, run.late).items():
            left.setdefault(c, []).append(r if rest is None else r[(time >= end_of_learned(data)) == rest])
    every = {c: np.concatenate(own) for c, own in left.items()}
    return {c: float(np.sqrt(np.mean(r**2))) for c, r in every.items() if len(r)}


# -- everything together ----------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Proven:
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


def proven(problem: Problem, last: Sequence[Standing], nominal: Errors, progress: Progress = silent) -> Proven:
    """Return the best of several models fitted to the whole recordings, without what is not needed, and how well each
    effect is determined; nominal: errors of the model without effects on what was left out.
    """
    progress("fitting everything together", 0.7)
    final, standing = _whole_run(problem, last)
    keys = list(standing.keys)
    each = range(len(problem.data.parts))
    progress("leaving out each effect once", 0.8)
    left = _left_out(problem, keys, final)
    again = _brought_back(problem, keys, final, left)
    if again is not final:
        final, left = again, _left_out(problem, keys, again)
    while True:
        full = errors_of(problem, [final.of(i) for i in each])
        needed = {k: log_evidence(final) - log_evidence(f) for k, f in left.items()}
        without = {k: errors_of(problem, [f.of(i) for i in each]) for k, f in left.items()}
        unneeded = [k for k in keys if needed[k] < CRITERIA.demanded and not mends(without[k], full)]
        if not unneeded or len(keys) == 1:
            break
        weakest = min(unneeded, key=lambda k: needed[k])
        keys.remove(weakest)
        final = left[weakest]
        progress("leaving out each effect once", 0.9)
        left = _left_out(problem, keys, final)
    parts = problem.data.parts
    before = errors_of(problem, [run_fitted(problem.crane, p) for p in parts])
    ranges = {s.channel: float(np.ptp(s.values)) / s.noise for p in parts for s in p.samples}
    shared = zip(final.variables, final.u, strict=True)
    moved = {v.name: float(u) for v, u in shared if isinstance(v, NominalDirection) and v.recording is None}
    return Proven(
        final.crane, tuple(t for t in standing.taken if t.key in keys),
        before, full, needed, without,
        nominal, standing.predicted, _deviations(final, keys), _alike(final, keys), moved, ranges,
    )  # fmt: skip


def _left_out(problem: Problem, keys: Sequence[str], final: Fit) -> dict[str, Fit]:
    """Return the fits without each of the effects."""
    rest = [[k for k in keys if k != key] for key in keys]
    tasks = [(_best_run, problem, others, final, key) for others, key in zip(rest, keys, strict=True)]
    return dict(zip(keys, in_parallel(problem.jobs, tasks), strict=True))


def _brought_back(problem: Problem, keys: Sequence[str], final: Fit, left: Mapping[str, Fit]) -> Fit:
    """Return the fit, or a likelier one to which an effect leads that is brought back, as large as is met in practice,
    where all else has settled without it.

    Two effects can hold each other in a false minimum: metering that hardly acts, and air that comes too late.
    """
    tasks = [
        (_settled, problem, keys, final.data, without, typical(without.crane, effects_of(final.crane, [key])))
        for key, without in left.items()
    ]
    found: list[Fit] = [final, *in_parallel(problem.jobs, tasks)]
    likely = likelihoods(found, problem.data)
    best = likely.index(max(likely))
    return found[best] if likely[best] > likely[0] + CRITERIA.proof else final


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
        found, keys = standing.extended(problem), standing.keys
        data, fresh = found.data, typical(problem.crane, standing.effects)
        windows = tuple(cut(data, CRITERIA.window))
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


def _everything(problem: Problem, keys: Sequence[str], before: Fit, crane: Crane) -> tuple[list[Variable], np.ndarray]:
    """Return clocks, all uncertain parameters and all effects as variables, and their values in a crane; clocks as a
    fit found them.
    """
    given, data = problem.crane, problem.data
    nominal = [believable(v) for v in uncertain_parameters(given, data.own, len(data.parts))]
    stated, clocks, known = stated_effects(given), timings(data), values_of(before)
    values: list[float] = [known.get(v.name, 0.0) for v in clocks]
    values += [moved_to(v, crane, before) for v in nominal]
    values += [
        v.to_u(parameters_of(crane, v.key)[v.parameter.name]) if isinstance(v, EffectParameter) else v.begin
        for v in stated
    ]
    own = Model((), effects_of(crane, keys)).own(crane.layout)
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


def _settled(problem: Problem, keys: Sequence[str], data: Data, start: Fit, crane: Crane) -> Fit:
    """Return the open-loop fit from a start, fitted again a few times with the error levels that it leaves."""
    found = _open_loop(problem, keys, data, start, crane, 6)
    for _ in range(CRITERIA.settled):
        data = levels_of(found, problem.data, apart=CRITERIA.drifts).raised(problem.data)
        found = staged(problem.crane, data, found.variables, found.u, found, run(12))
    return found


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
    model = Fitted(Model((), {key: {} for key in keys}), final, final)
    found = {f"{k}:{name}": spread for k in keys for name, spread in model.deviations(k).items()}
    nominal = {v.name: next(iter(v.weights.values())) for v in final.variables if isinstance(v, NominalDirection)}
    return found | {name: scale * final.std(name) for name, scale in nominal.items()}


def _alike(final: Fit, keys: Sequence[str]) -> dict[tuple[str, str], float]:
    """Return pairs of variables, one of them an effect's that was taken in, whose errors are correlated."""
    spread = np.sqrt(np.maximum(np.diag(final.cov), 1e-300))
    R = final.cov / np.outer(spread, spread)
    own = [isinstance(v, EffectParameter) for v in final.variables]
    names = [v.name for v in final.variables]
    taken = [i for i, v in enumerate(final.variables) if isinstance(v, EffectParameter) and v.key in keys]
    pairs = ((i, j) for i in taken for j in range(len(names)) if i != j and (j > i or not own[j]))
    return {(names[i], names[j]): float(R[i, j]) for i, j in pairs if abs(R[i, j]) > CRITERIA.alike}
