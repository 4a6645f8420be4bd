"""One search: models grow by moves, round by round, until no move brings what it must.

A round goes on from a beam of models. All moves are screened linearly, the likeliest are fitted (from their parent, and
from the machine as given where parameters may do their work), the leading ones are carried to the end, and the best one
is gone on from. What came in beside others is also looked at alone, and what parameters help is looked for at its other
places. The path of a search holds all that was fitted; what it means is said by `verdict`, which changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.recording import Recording

from ..fit.data import Data, data_of
from ..fit.evidence import log_evidence
from ..fit.solve import Fit
from ..fit.staged import LOOSE, STIFF, TIGHT, WHOLE, Stage, all_parameters, informed_directions, timings
from ..fit.variables import Variable, stated_effects
from ..workers import in_parallel
from .criteria import CRITERIA
from .lean import leaner
from .manoeuvre import best_manoeuvre
from .model import (
    Fitted,
    Model,
    best_of_each,
    excess,
    fitted,
    parameters_of,
    plausible,
    run_error,
    together,
    unmoving,
    values_of,
    with_effects,
)
from .moves import scaled, starts
from .screen import Score, best_starts, likely, screened

Progress = Callable[[str, float], None]
#: one run over the whole recording, from which windows begin anew: the first state of one may be caught in a false
#: minimum, where its errors count by their logarithm only
_RUN = replace(WHOLE, iterations=2)


def silent(text: str, share: float) -> None:
    """Tell nobody of the progress."""


Stages = Sequence[Stage]


@dataclass(frozen=True)
class Move:
    """A model to be fitted, from the knots (and values) of an earlier fit; promise: the fall of the cost that the
    screen expects.
    """

    model: Model
    before: Fit
    promise: float = math.inf


@dataclass(frozen=True)
class Round:
    """What was fitted in a round: with the first stages, best first, and to the end, best first; open-loop errors by
    effects where they decide; bare: without effects, where one that does nothing had led to another minimum.
    """

    tried: tuple[Fitted, ...]
    done: tuple[Fitted, ...]
    errors: Mapping[frozenset[str], float] = field(default_factory=dict)
    bare: Fitted | None = None


@dataclass(frozen=True)
class Path:
    """All that a search fitted.

    Attributes:
        given: the crane as it is; parameters: with its uncertain parameters moved; fewest: with the fewest of them that
            do, where that was needed.
        left_out: errors on blocks that were left out, before and after, of a model that leaves something, by its
            effects.
    """

    problem: Problem
    given: Fitted
    parameters: Fitted
    fewest: Fitted
    rounds: tuple[Round, ...] = ()
    left_out: Mapping[frozenset[str], tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def bare(self) -> float:
        """Evidence of the better model without effects."""
        return max(self.given.evidence, self.parameters.evidence)

    @property
    def beyond_uncertainty(self) -> bool:
        """Whether parameters without effects have moved so far that they may do an effect's work, in short windows, or
        as the whole explanation.
        """
        return not plausible(self.problem.base) or (self.parameters.good and self.fewest.beyond_uncertainty)

    @cached_property
    def done(self) -> list[Fitted]:
        """All models with effects that were fitted to the end, best first, the best of each set of effects."""
        return best_of_each([w for r in self.rounds for w in r.done])

    @cached_property
    def weighed(self) -> tuple[Fitted, ...]:
        """Models with effects that were fitted to the end and justify each of their effects, best first."""
        weighed = list[Fitted]()
        for w in sorted(self.done, key=lambda w: len(w.keys)):
            if len(w.keys) == 1 or self._justified(w, [v for v in weighed if len(v.keys) < len(w.keys)]):
                weighed.append(w)
        return tuple(sorted(weighed, key=lambda w: -w.evidence))

    def _justified(self, w: Fitted, fewer: Sequence[Fitted]) -> bool:
        """Whether each effect of several brings evidence, and together they take away most of what the best justified
        model with fewer leaves.
        """
        least = max([self.bare, *(v.evidence for v in self.done if set(v.keys) < set(w.keys))])
        if w.evidence < least + CRITERIA.proof:
            return False
        best = max(fewer, key=lambda v: v.evidence, default=self.parameters)
        if best.good:
            errors = {keys: e for r in self.rounds for keys, e in r.errors.items()}
            after, before = (errors.get(frozenset(v.keys), math.inf) for v in (w, best))
            return math.isfinite(after) and excess(after) < CRITERIA.left * excess(before)
        return w.good or w.level**2 - 1.0 < CRITERIA.left * (best.level**2 - 1.0)

    @property
    def best(self) -> Fitted | None:
        """The best model with effects."""
        return self.weighed[0] if self.weighed else None

    @cached_property
    def ahead(self) -> Fitted | None:
        """The model that the search goes on from: the best one, or the one with the most evidence if it leaves hardly
        more than noise: of several that are still missing perhaps none takes away most of what is left.
        """
        return self.done[0] if self.done and self.done[0].near else self.best


@dataclass(frozen=True)
class Problem:
    """What is searched: a crane, its recordings, and the variables that all models share.

    Attributes:
        base: the crane in loosely joined windows, all its uncertain parameters free.
    """

    crane: Crane
    recordings: tuple[Recording, ...]
    data: Data
    jobs: int
    base: Fit = field(repr=False)
    shared: tuple[Variable, ...]

    @classmethod
    def of(cls, crane: Crane, recordings: Sequence[Recording], own: Sequence[str], jobs: int) -> Problem:
        """Return the problem, nominal parameters fitted in loosely joined windows."""
        data = data_of(recordings, crane, own)
        base = all_parameters(crane, data)
        return cls(crane, tuple(recordings), data, jobs, base, (*informed_directions(base), *stated_effects(crane)))

    @cached_property
    def nominal(self) -> Fit:
        """The crane as it is, in loosely joined windows."""
        return self.with_effects({})

    def run(self, moves: Sequence[Move], stages: Stages) -> list[Fitted]:
        """Return the moves fitted, on as many processes as may be used, best first."""
        found = in_parallel(self.jobs, [(fitted, self.crane, self.data, m.model, m.before, stages) for m in moves])
        return sorted((w for w in found if math.isfinite(w.evidence)), key=lambda w: -w.evidence)

    def errors(self, fits: Sequence[Fit], check: Recording | None = None) -> list[list[float]]:
        """Return by fit the open-loop errors of cranes as they were fitted, by recording and last on the check
        recording.
        """
        n, own = len(self.recordings), [fit.of(i) for fit in fits for i in range(len(self.recordings))]
        tasks: list[tuple[Any, ...]] = [(run_error, f.crane, self.recordings[k % n], f) for k, f in enumerate(own)]
        if check is not None:
            tasks += [(run_error, fit.crane, check, None, self.data.own) for fit in fits]
        found: list[float] = in_parallel(self.jobs, tasks)
        return [[*found[n * k : n * (k + 1)], *found[len(own) + k : len(own) + k + 1]] for k in range(len(fits))]

    def with_effects(self, effects: Mapping[str, Mapping[str, float]]) -> Fit:
        """Return the crane as given with effects as they were found, none of its parameters moved, in loosely joined
        windows.
        """
        return all_parameters(unmoving(with_effects(self.crane, effects)), self.data)

    def unmoved(self, fit: Fit, model: Model) -> Fit:
        """Return a fit of the crane as given with effects, in which all uncertain parameters may move from where the
        crane states them.
        """
        known = values_of(fit)
        own = model.own(self.crane.layout)
        variables = (*self.base.variables, *own)
        u = [known.get(v.name, 0.0) for v in self.base.variables] + [v.begin for v in own]
        return fit.begun(self.crane, variables, np.array(u))

    def telling(self, first: Crane, second: Crane) -> str:
        """Return in words the manoeuvre on which two explanations differ most, as these sensors see them."""
        noise = {s.channel: s.noise for p in self.data.parts for s in p.samples}
        return best_manoeuvre(first, second, noise, self.data.channels)


def search(problem: Problem, most: int = CRITERIA.most, progress: Progress = silent) -> Path:
    """Return the path to the best model with one effect, or two; with at most so many where hardly more than noise is
    left.
    """
    path = _begun(problem)
    while True:
        progress("looking for effects", 0.2 + 0.6 * min(len(path.rounds) / CRITERIA.most, 1.0))
        found = _round(path, most)
        if found is None:
            return _judged(path)
        if found.bare is not None and found.bare.evidence > path.parameters.evidence:
            path = _with_parameters(path, found.bare)
        before, path = path, replace(path, rounds=(*path.rounds, found))
        if not _gained(before.ahead, path.ahead):
            return _judged(path)


def _gained(before: Fitted | None, after: Fitted | None) -> bool:
    """Whether a model has the proof against the one before it."""
    return after is not None and (before is None or after.evidence >= before.evidence + CRITERIA.proof)


def _begun(problem: Problem) -> Path:
    """Return the path before its first round: the crane as it is, and with its parameters moved."""
    crane, data = problem.crane, problem.data
    given = fitted(crane, data, Model(tuple(timings(data))), problem.nominal, (TIGHT, STIFF))
    given = replace(given, loose=problem.nominal)
    parameters = fitted(crane, data, Model(problem.shared), problem.base, (TIGHT, STIFF))
    if parameters.plausible and parameters.level < CRITERIA.left_level and (stages := _still_to_do(parameters)):
        parameters = max(parameters, _on(problem, parameters, stages), key=lambda w: w.evidence)
    return _with_parameters(Path(problem, given, parameters, parameters), parameters)


def _with_parameters(path: Path, parameters: Fitted) -> Path:
    """Return the path with another fit of the machine without effects."""
    parameters = replace(parameters, loose=path.problem.base)
    enough = parameters.good and not path.given.good
    fewest = leaner(path.problem.crane, path.problem.data, parameters) if enough else parameters
    return replace(path, parameters=parameters, fewest=fewest)


def _round(path: Path, most: int) -> Round | None:
    """Return what a round fitted; None where no move promises anything."""
    problem, parents = path.problem, _beam(path, most)
    near = _is_near(parents)
    moves = [m for parent in parents for m in _additions(path, parent, near)]
    # near the end the cost is quadratic at once: no walk from loose to stiff
    tried = best_of_each(problem.run(moves, (STIFF,)) if near else _raced(path, parents, moves))
    if not tried:
        return None
    done = tried if near else problem.run([Move(w.model, w.fit) for w in _leading(parents, tried)], (TIGHT, STIFF))
    done = _relocated(path, done) if not path.rounds else done
    done = _further(path, done)
    done = best_of_each([*done, *_dropped(path, done, near)])
    acting = [w for w in done if w.keys]
    return Round(tuple(tried), tuple(acting), _deciding(path, acting), next((w for w in done if not w.keys), None))


def _deciding(path: Path, done: Sequence[Fitted]) -> dict[frozenset[str], float]:
    """Return open-loop errors where a model leaves hardly more than noise and further effects bring evidence: they must
    show there as well.

    Moved parameters can make up for a further effect, but not for nothing: their prior charges for it, and the screen
    knows that.
    """
    known = best_of_each([*path.done, *done])
    leading = {len(w.keys): w for w in reversed(known)}  # of each number of effects the best
    first = next((leading[n] for n in sorted(leading) if leading[n].good), None)
    if first is None:
        return {}
    more = [
        w for w in done
        if len(w.keys) > len(first.keys) and w.evidence > first.evidence + CRITERIA.proof
    ]  # fmt: skip
    if not more:
        return {}
    errors = path.problem.errors([w.fit for w in (first, *more)])
    return {
        frozenset(w.keys): together(path.problem.recordings, e) for w, e in zip((first, *more), errors, strict=True)
    }


def _beam(path: Path, most: int) -> Sequence[Fitted]:
    """Return the models that a round goes on from, the leading one first: the best alone if it leaves hardly more than
    noise.
    """
    best, ahead = path.best, path.ahead
    if not path.rounds:
        return [path.parameters]
    if best is None or ahead is None or (path.parameters.good and best.evidence < path.bare + CRITERIA.proof):
        return []
    if len(path.rounds) == 1 and not (best.good or path.parameters.good):
        return path.rounds[0].tried[: CRITERIA.beam]
    return (
        [ahead] if len(ahead.keys) < (most if ahead.near else CRITERIA.most) and ahead.level < CRITERIA.misled else []
    )


def _is_near(parents: Sequence[Fitted]) -> bool:
    """Whether a round goes on from one model that leaves hardly more than noise: what little is missing beside it shows
    in stiffly joined windows only.
    """
    return len(parents) == 1 and parents[0].near


def _additions(path: Path, parent: Fitted, near: bool) -> list[Move]:
    """Return the likeliest effects beside a model, as the screen sees them from where it stands; beside one that is
    `near` those that must show.
    """
    fit, stiffness = (parent.fit, STIFF.stiffness) if near else (parent.loose, LOOSE.stiffness)
    most = CRITERIA.nearly if near else CRITERIA.others if parent.keys else CRITERIA.singles
    least = CRITERIA.proof if near or parent.good else CRITERIA.promise
    scores = screened(fit, stiffness)
    own = {k: parameters_of(fit.crane, k) for k in parent.keys}
    return _moves(path.problem, own, likely(best_starts(scores) if near else scores, most, least), fit)


def _as_given(path: Path, parent: Fitted, moves: Sequence[Move]) -> list[Move]:
    """Return the likeliest effects that the machine as given shows beside those of a model, and no move adds yet: where
    parameters may do an effect's work.
    """
    if parent.plausible if parent.keys else not path.beyond_uncertainty:
        return []
    problem, own = path.problem, {k: parameters_of(parent.loose.crane, k) for k in parent.keys}
    held = problem.with_effects(own) if own else problem.nominal
    held = problem.unmoved(held, Model(problem.shared, own))
    known = {frozenset(m.model.keys) for m in moves}
    more = likely(screened(held, LOOSE.stiffness), CRITERIA.as_given + len(moves), CRITERIA.promise)
    new = [s for s in more if frozenset((*parent.keys, s.start.key)) not in known]
    return _moves(problem, own, new[: CRITERIA.as_given], held)


def _moves(
    problem: Problem, own: Mapping[str, Mapping[str, float]], scores: Sequence[Score], before: Fit
) -> list[Move]:
    """Return the models that add what was screened to the effects of a model, each once: a start of another size may
    have come to the same.
    """
    found = dict[tuple[object, ...], Move]()
    for s in scores:
        values = scaled(s.start, s.amplitude)
        alike = (s.start.key, *(f"{x:.2g}" for x in values.values()))
        found.setdefault(alike, Move(Model(problem.shared, {**own, s.start.key: values}), before, s.gain))
    return list(found.values())


def _raced(path: Path, parents: Sequence[Fitted], moves: Sequence[Move]) -> list[Fitted]:
    """Return the moves fitted loosely, those first that promise most; once one leaves hardly more than noise and has no
    help from parameters, the others only where they promise about as much, else also what the machine as given shows.
    """
    moves = sorted(moves, key=lambda m: -m.promise)
    done = path.problem.run(moves[: CRITERIA.first], (LOOSE,))
    rest = moves[CRITERIA.first :]
    if done and done[0].good and done[0].move_cost < CRITERIA.helped:
        most = moves[0].promise
        rest = [m for m in rest if m.promise > most - max(CRITERIA.apart, CRITERIA.left * most)]
    else:
        rest += [m for parent in parents for m in _as_given(path, parent, moves)]
    return [*done, *path.problem.run(rest, (LOOSE,))]


def _leading(parents: Sequence[Fitted], tried: Sequence[Fitted]) -> list[Fitted]:
    """Return the fits to be carried to the end: the best two, or one if it leaves hardly more than noise; one more that
    is near; and the one that parameters help least if they help the best too much.
    """
    if not tried:
        return []
    best = tried[0].evidence
    near = max(CRITERIA.apart, CRITERIA.near * (best - log_evidence(parents[0].loose)))
    most = 1 if tried[0].good else CRITERIA.finished
    leading = list(tried[:most])
    if not parents[0].keys:
        leading += [w for w in tried[most : CRITERIA.finished + 1] if w.evidence > best - near]
    elif not leading[0].plausible:
        calmest = min(
            (w for w in tried if set(parents[0].keys) <= set(w.keys)), key=lambda w: w.move_cost, default=leading[0]
        )
        leading += [calmest] if all(calmest is not w for w in leading) else []
    return leading


def _relocated(path: Path, done: list[Fitted]) -> list[Fitted]:
    """Return the fits with the leading effect at its other places added, where moved parameters help it.

    An effect at the wrong place explains much of a recording if parameters may help, and they can hide the right place
    from the screen.
    """
    if not done or done[0].move_cost < CRITERIA.helped:
        return done
    problem, tried = path.problem, {key for w in done for key in w.keys}
    effect, _ = registry.split_key(done[0].keys[0])
    lay = problem.crane.layout
    found = [s for s in starts(problem.crane, problem.data) if s.key in set(effect.keys(lay)) - tried]
    moves = [Move(Model(problem.shared, {s.key: s.values}), problem.base) for s in found]
    leading = best_of_each(problem.run(moves, (LOOSE,)))[:1]
    return best_of_each([*done, *problem.run([Move(w.model, w.fit) for w in leading], (TIGHT, STIFF))])


def _further(path: Path, done: Sequence[Fitted]) -> list[Fitted]:
    """Return the fits, the leading ones taken further where they are not at their end.

    Where parameters have moved further than they may to do an effect's work, the fit begins anew at the crane as given
    with the effects as they were found, and as one long run: what is slow does not show in short windows.
    """
    problem, tasks = path.problem, list[tuple[Any, ...]]()
    best = min(done, key=lambda w: w.level, default=path.parameters)
    for w in sorted(done, key=lambda w: w.move_cost - w.evidence)[: CRITERIA.further]:  # rather those helped less
        beaten = len(w.keys) > 1 or best.level < CRITERIA.left_level
        hopeless = beaten and w.level > CRITERIA.left_level
        if hopeless or w.evidence < path.parameters.evidence + CRITERIA.proof:
            continue
        if not w.plausible:
            tasks.append((_anew, problem, Model(w.model.variables, {k: w.values(k) for k in w.keys})))
        elif stages := _still_to_do(w):
            tasks.append((_on, problem, w, stages))
    return best_of_each([*done, *(w for w in in_parallel(problem.jobs, tasks) if math.isfinite(w.evidence))])


def _still_to_do(w: Fitted) -> Stages:
    """Return the stages that take a fit to its end: windows that begin anew on its own run, where little is left that
    is more than noise; more iterations, where it had not converged.
    """
    if w.level < CRITERIA.left_level and not w.good:
        return _RUN, STIFF
    return () if w.fit.converged else (STIFF, STIFF)


def _on(problem: Problem, w: Fitted, stages: Stages) -> Fitted:
    """Return a model fitted further."""
    return replace(fitted(problem.crane, problem.data, w.model, w.fit, stages), loose=w.loose)


def _anew(problem: Problem, model: Model) -> Fitted:
    return fitted(problem.crane, problem.data, model, problem.with_effects(model.effects), (WHOLE, STIFF))


def _dropped(path: Path, done: Sequence[Fitted], near: bool) -> list[Fitted]:
    """Return models fitted without one of their effects: one that does nothing, or beside which the others have not
    been seen alone.

    What came in beside another may be the one that is missing, and the first a surrogate; or have only led the fit to
    the better minimum.
    """
    known = {frozenset(w.keys) for r in path.rounds for w in r.done} | {frozenset(w.keys) for w in done}
    moves: dict[frozenset[str], Move] = {}
    for w in (w for w in done if w.evidence > path.bare):
        for key in w.keys:
            rest = {k: w.values(k) for k in w.keys if k != key}
            if key in w.inactive or not (near or not rest or frozenset(rest) in known):
                moves.setdefault(frozenset(rest), Move(Model(w.model.variables, rest), w.fit))
    return path.problem.run(list(moves.values()), (TIGHT, STIFF))


def _judged(path: Path) -> Path:
    """Return the path with errors on blocks that were left out, where the best model repairs something and leaves
    something.
    """
    best = path.best
    if best is None or best.good or not best.plausible or best.evidence < path.bare + CRITERIA.proof:
        return path
    if best.level > CRITERIA.misled:
        return path
    return replace(path, left_out={frozenset(best.keys): left_out(path.problem, best)})


def left_out(problem: Problem, w: Fitted) -> tuple[float, float]:
    """Return the errors, of the crane as given and of a model fitted to the first part of each recording, on the
    rest.
    """
    spans = [(float(p.time[0]), float(p.time[-1])) for p in problem.data.parts]
    parts = [
        (r.window(a, a + CRITERIA.learned * (b - a)), r.window(a + CRITERIA.learned * (b - a), b))
        for r, (a, b) in zip(problem.recordings, spans, strict=True)
    ]
    data = data_of([first for first, _ in parts], problem.crane, problem.data.own)
    found = fitted(problem.crane, data, Model(w.model.variables, {k: w.values(k) for k in w.keys}), w.fit, (STIFF,))
    rest = [last for _, last in parts]
    cranes = [problem.crane] * len(rest) + [found.fit.of(i).crane for i in range(len(rest))]
    errors = in_parallel(problem.jobs, [(run_error, c, rest[k % len(rest)], None) for k, c in enumerate(cranes)])
    return together(rest, errors[: len(rest)]), together(rest, errors[len(rest) :])
