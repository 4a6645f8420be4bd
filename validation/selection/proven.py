"""All effects and parameters of the models that a search ends with, fitted together in one open-loop run to all of the
recordings; each effect left out once, and what acts beside them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects.registry import split_key

from ..criteria import CRITERIA
from ..fit.evidence import log_evidence
from ..fit.solve import Fit
from ..fit.staged import first_knots, staged, timings
from ..fit.variables import EffectParameter, NominalDirection, Variable, stated_effects, uncertain_parameters
from ..fit.windows import cut
from ..workers import in_parallel
from .levels import Errors, left_over, levels_of, likelihoods, noise_level
from .model import Fitted, Model, effects_of, moved_to, parameters_of, values_of
from .moves import scaled, starts
from .screen import best_starts, screen, unseen
from .search import Problem, Progress, Stages, silent
from .whole_runs import Judged, Standing, Taken, errors_of, first_part, joined, judged, run, typical


@dataclass(frozen=True)
class Proven:
    """The crane with all effects that were taken in, and how each proved itself; errors are open loop, in units of the
    sensors' noise.

    Attributes:
        taken: the rounds in their order, of the effects that stayed.
        after: errors of the crane at the end.
        needed, without: effect -> log evidence lost and errors when it is left out and all else is fitted again.
        nominal, predicted: errors on what was left out, of parameters alone and with effects, fitted to the rest only.
        deviations: parameter -> standard deviation (SI). alike: variables that can hardly be told apart -> their
            correlation.
        moved: nominal parameter -> how far it moved, in standard uncertainties; where only a range is known, in shares
            of it.
        ranges: channel -> its range in units of the noise. level: below which hardly more than noise is left.
    """

    crane: Crane
    taken: tuple[Taken, ...]
    after: Errors
    needed: Mapping[str, float]
    without: Mapping[str, Errors]
    nominal: Errors
    predicted: Errors
    deviations: Mapping[str, float]
    alike: Mapping[tuple[str, str], float]
    moved: Mapping[str, float]
    ranges: Mapping[str, float]
    level: float

    @property
    def explains(self) -> bool:
        """Whether it leaves hardly more than noise, on the average of the channels."""
        return math.sqrt(sum(e**2 for e in self.after.values()) / len(self.after)) < self.level

    @property
    def predicts_better(self) -> bool:
        """Whether what was not fitted is predicted better by a tenth, on the average of the channels, than by the
        fitted nominal model.
        """
        first, last = self.nominal, self.predicted
        return sum(math.log(first[c] / last[c]) for c in last) / len(last) > -math.log(1.0 - CRITERIA.worth)


def proven(
    problem: Problem, last: Sequence[Standing], nominal: Errors, most: int, progress: Progress = silent
) -> Proven:
    """Return the best of several models fitted to the whole recordings, without what is not needed, and how well each
    effect is determined; nominal: errors of the model without effects on what was left out; most: how many effects at
    most.
    """
    progress("fitting everything together", 0.7)
    now, kept, settled = _whole_run(problem, last), None, set[frozenset[str]]()
    while True:
        progress("looking for what acts beside them", 0.8)
        grown = _grown(problem, now, most)
        if grown is kept:  # nothing came in for what was left out
            break
        progress("leaving out each effect once", 0.9)
        now, full, left = _needed(problem, grown)
        if frozenset(now.keys) in settled:  # what was brought back among these has found its place
            break
        settled.add(frozenset(now.keys))
        kept, now = now, _brought_back(problem, now, left)
        if now is grown:
            break
    final, keys, parts = now.fit, now.keys, problem.data.parts
    ranges = {s.channel: float(np.ptp(s.values)) / s.noise for p in parts for s in p.samples}
    shared = zip(final.variables, final.u, strict=True)
    moved = {v.name: float(u) for v, u in shared if isinstance(v, NominalDirection) and v.recording is None}
    return Proven(
        final.crane, tuple(t for t in now.taken if t.key in keys),
        full, {k: w.brought for k, w in left.items()}, {k: w.errors for k, w in left.items()},
        nominal, now.predicted, _deviations(final, keys), _alike(final, keys), moved, ranges,
        noise_level(problem.data),
    )  # fmt: skip


@dataclass(frozen=True)
class _Without:
    """The fit without one of the effects, its errors, and the log evidence that the effect brought."""

    fit: Fit
    errors: Errors
    brought: float


def _whole_errors(problem: Problem, final: Fit) -> dict[str, float]:
    return errors_of(problem, [final.of(i) for i in range(len(problem.data.parts))])


def _needed(problem: Problem, now: Standing) -> tuple[Standing, Errors, dict[str, _Without]]:
    """Return the model without effects that are not needed, one dropped after the other; its errors, and the fits
    without each.
    """
    while True:
        fits: list[Fit] = in_parallel(problem.jobs, [(_best_run, problem, now, key) for key in now.keys])
        full, evidence = _whole_errors(problem, now.fit), log_evidence(now.fit)
        left = {
            key: _Without(fit, _whole_errors(problem, fit), evidence - log_evidence(fit))
            for key, fit in zip(now.keys, fits, strict=True)
        }
        unneeded = [k for k, w in left.items() if w.brought < CRITERIA.demanded and not mends(w.errors, full)]
        if not unneeded or len(left) == 1:
            return now, full, left
        weakest = min(unneeded, key=lambda k: left[k].brought)
        now = _with_fit(now, left[weakest].fit, [k for k in now.keys if k != weakest])


def _with_fit(now: Standing, fit: Fit, keys: Sequence[str]) -> Standing:
    return replace(now, model=Model((), effects_of(fit.crane, keys)), fit=fit, loose=fit)


def _grown(problem: Problem, now: Standing, most: int) -> Standing:
    """Return a likelier model with more effects, taken in one by one as long as they lower the errors, or two at once
    where neither of the likeliest alone does; or the same one.

    Which of several a round took first, and at which values of all else, hangs on little, and what was not demanded
    then may be now.
    """
    grown = now
    while (room := most - len(grown.keys)) > 0 and left_over(_whole_errors(problem, grown.fit)) > CRITERIA.gained:
        parent = replace(grown, errors=_judged_apart(problem, grown), unseen=None) if grown is now else grown
        likelier = _likelier(problem, parent, _one_more(parent))
        if room > 1 and likelier and not any(one.serves(parent) for one in likelier):
            likelier = _likelier(problem, parent, [way for one in likelier for way in _one_more(one)])
        further = next((one for one in likelier if one.serves(parent)), None)
        if further is None:
            break
        grown = further
    return grown


def _brought_back(problem: Problem, now: Standing, left: Mapping[str, _Without]) -> Standing:
    """Return a likelier model with the same effects, one of them brought back, as large as is met in practice, where
    all else has settled without it; or the same one.

    Two effects can hold each other in a false minimum, such as metering that hardly acts and air that comes too late.
    """
    ways = [
        _Way(now, now.keys, typical(without.fit.crane, effects_of(now.fit.crane, [key])), without.fit)
        for key, without in left.items()
    ]
    return next(iter(_likelier(problem, now, [*ways, *_of_other_shapes(now)])), now)


def _as_measured(fit: Fit, crane: Crane) -> Fit:
    """Return the fit with long windows that begin as a crane shows what was measured."""
    windows = tuple(cut(fit.data, CRITERIA.window))
    return replace(fit, windows=windows, knots=first_knots(crane, fit.data, CRITERIA.window))


def _of_other_shapes(now: Standing) -> list[_Way]:
    """Return ways that begin with one effect in each of the shapes that the library tries of it (the pressure up to
    which air is free, say), in long windows that begin as measured: from one shape to another a fit seldom finds.
    """
    crane, ways = now.fit.crane, []
    for key in now.keys:
        own = [p.name for p in split_key(key)[0].parameters if p.shape and not (p.moment or p.along_stroke)]
        begins = [s.values for s in starts(crane.without_effect(key), now.fit.data) if s.key == key]
        shapes = {tuple(v.get(name) for name in own) for v in begins}
        for values in begins if len(shapes) > 1 else ():
            begun = crane.with_effect(key, values)
            ways.append(_Way(now, now.keys, begun, _as_measured(now.fit, begun)))
    return ways


def _likelier(problem: Problem, now: Standing, ways: Sequence[_Way]) -> list[Standing]:
    """Return the models that ways lead to which the data demand instead of `now`, best first; those with more effects
    with their open-loop errors.
    """
    found = _settled(problem, ways, now.fit) if ways else []
    likelier = []
    for one, gain in found[: CRITERIA.finished]:
        if gain > CRITERIA.proof:
            if len(one.keys) > len(now.keys):
                before = sum(t.evidence for t in one.taken[len(now.taken) :])
                beside = {w.keys[-1]: g - before for w, g in found if w.keys[:-1] == one.keys[:-1]}
                taken = Taken(one.keys[-1], beside.pop(one.keys[-1]), beside)
                one = replace(one, errors=_judged_apart(problem, one), taken=(*one.taken, taken))
            likelier.append(one)
    return likelier


def _one_more(now: Standing) -> list[_Way]:
    """Return the ways to what a look along its runs promises beside a model, at least half as much as the first, in
    long windows that begin on these runs, or as measured: without an effect a run may be far from the machine; and to
    the effects that no look along them sees, as measured.
    """
    found = best_starts(screen(now.fit, starts(now.fit.crane, now.fit.data), 1.0))[: CRITERIA.tried]
    shown = {s.start.key: scaled(s.start, s.amplitude) for s in found if s.gain >= CRITERIA.serious * found[0].gain}
    ways = [_wider(now, key, values, along) for key, values in shown.items() for along in (True, False)]
    return [*ways, *(_wider(now, s.key, s.values, False) for s in unseen(now.fit))]


def _wider(now: Standing, key: str, values: Mapping[str, float], along: bool) -> _Way:
    """Return the way to a model with one effect more, in long windows that begin along its runs, or as measured."""
    crane = now.fit.crane.with_effect(key, values)
    return _Way(now, (*now.keys, key), crane, now.fit if along else _as_measured(now.fit, crane))


def _judged_apart(problem: Problem, now: Standing) -> Judged:
    """Return open-loop errors of a model of which all was fitted together, over the first part of each recording,
    fitted to that alone, and over the rest.
    """
    variables, u = _everything(problem, now.keys, now.fit, now.fit.crane)
    learned = first_part(now.fit.data)
    return judged(problem, staged(problem.crane, learned, variables, u, now.fit, run(12)))


def mends(without: Errors, full: Errors) -> bool:
    """Whether a channel's error is half as large again without an effect as with everything, and more than its sensor's
    noise.
    """
    return any(without[c] > CRITERIA.mended * max(full[c], 1.0) for c in full)


@dataclass(frozen=True)
class _Way:
    """Where an open-loop fit of everything begins: the model that it grows from, its effects, the values of all in a
    crane, and the fit with its windows, their first states and the levels of the channels.
    """

    parent: Standing
    keys: Sequence[str]
    crane: Crane
    before: Fit


def _whole_run(problem: Problem, last: Sequence[Standing]) -> Standing:
    """Return the most likely of the last round's models, fitted to open-loop runs of the whole recordings.

    Parameters may have moved step by step to do the work of what is still missing. So each model begins with the
    parameters as given and its effects, in windows that begin at its fit and at the machine; and anew, with effects of
    the size that is met in practice and the parameters as far on the other side as they had moved: another valley.
    """
    ways = []
    for standing in last:
        found, fresh = standing.extended(problem), typical(problem.crane, standing.effects)
        begins = (found.crane, found), *((c, _as_measured(found, c)) for c in (found.crane, fresh))
        ways += [_Way(standing, standing.keys, crane, fit) for crane, fit in begins]
    return _settled(problem, ways)[0][0]


def _settled(problem: Problem, ways: Sequence[_Way], beside: Fit | None = None) -> list[tuple[Standing, float]]:
    """Return where several ways lead, of those with the same effects the likeliest, and by how much each is likelier
    than a fit beside them (than the first); best first, these carried to their ends with the error levels that they
    leave.

    Beside a fit, those that are far behind after a few iterations stop. Of those that bring at least half as much as
    the first the best of each set of effects is fitted with its own levels before they are compared: at those of a
    model without it, what an effect mends of a channel that was given up hardly counts.
    """
    fits: list[Fit] = in_parallel(problem.jobs, [(_begun, problem, w, _sifting()) for w in ways])

    def gains() -> list[float]:
        first, *likely = likelihoods([fits[0] if beside is None else beside, *fits], problem.data)
        return [one - first for one in likely]

    def carried(chosen: Sequence[int], further: Callable[..., Fit], *how: int) -> None:
        ended: list[Fit] = in_parallel(problem.jobs, [(further, problem, fits[k], *how) for k in chosen])
        for k, fit in zip(chosen, ended, strict=True):
            fits[k] = fit

    def likeliest(gain: Sequence[float]) -> list[int]:
        found = dict[frozenset[str], int]()
        for k in sorted(range(len(ways)), key=lambda k: -gain[k]):
            found.setdefault(frozenset(ways[k].keys), k)
        return list(found.values())

    gain = gains()
    least = -math.inf if beside is None else min(max(gain) - CRITERIA.apart, CRITERIA.chance * max(gain))
    carried([k for k in range(len(ways)) if gain[k] >= least and not fits[k].converged], _further)
    gain = gains()
    best = likeliest(gain)
    carried([k for k in best if gain[k] >= CRITERIA.serious * max(gain)], _at_own_levels, 1)
    gain = gains()
    leading = sorted(range(len(ways)), key=lambda k: (k in best, gain[k]), reverse=True)[: CRITERIA.finished]
    carried(leading, _at_own_levels, CRITERIA.settled)
    gain = gains()
    return [(_with_fit(ways[k].parent, fits[k], ways[k].keys), gain[k]) for k in likeliest(gain)]


def _everything(problem: Problem, keys: Sequence[str], before: Fit, crane: Crane) -> tuple[list[Variable], np.ndarray]:
    """Return clocks, all uncertain parameters and all effects as variables, and their values in a crane, parameters as
    they differ from what a fit began at; clocks as the fit found them.
    """
    given, data = problem.crane, problem.data
    nominal = [believable(v) for v in uncertain_parameters(given, data.own, len(data.parts))]
    stated, clocks, known = stated_effects(given), timings(data), values_of(before)
    values: list[float] = [known.get(v.name, 0.0) for v in clocks]
    values += [moved_to(v, before.origin, crane, before) for v in nominal]
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


def _begun(problem: Problem, way: _Way, stages: Stages) -> Fit:
    """Return the first iterations of everything fitted to one open-loop run."""
    variables, u = _everything(problem, way.keys, way.before, way.crane)
    return staged(problem.crane, way.before.data, variables, u, way.before, stages)


def _sifting() -> Stages:
    """Return the stages after which ways are compared: by way of long windows, to one open-loop run."""
    return (*joined(6), *run(CRITERIA.sifted))


def _further(problem: Problem, found: Fit) -> Fit:
    """Return such a fit at its end."""
    return staged(problem.crane, found.data, found.variables, found.u, found, run(9))


def _at_own_levels(problem: Problem, found: Fit, times: int) -> Fit:
    """Return an open-loop fit made again so many times with the error levels that it leaves."""
    for _ in range(times):
        data = levels_of(found, problem.data, apart=CRITERIA.drifts).raised(problem.data)
        found = staged(problem.crane, data, found.variables, found.u, found, run(12))
    return found


def _best_run(problem: Problem, now: Standing, without: str) -> Fit:
    """Return the best of three fits of one open-loop run without an effect: straight from where all of them stand, and
    by way of long windows that begin on that run, or on the machine's: without an effect the run may be far from both.
    """
    crane, keys = now.fit.crane.without_effect(without), [k for k in now.keys if k != without]
    measured, sifting = _as_measured(now.fit, crane), _sifting()
    ways = (now.fit, run(CRITERIA.sifted)), (now.fit, sifting), (measured, sifting)
    begun = [_begun(problem, _Way(now, keys, crane, start), stages) for start, stages in ways]
    best = max(begun, key=log_evidence)
    return best if best.converged else _further(problem, best)


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
