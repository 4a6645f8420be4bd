"""The search where errors are white noise, but for stretches that no model explains: to one effect or two, and on where
hardly more than noise is left.

A round fits the likeliest moves in loosely joined windows and carries the leading ones to stiffly joined ones; looks at
what came in beside others alone, and for what parameters help at its other places.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

from crane_exudyn.effects import registry

from ..criteria import CRITERIA
from ..fit.staged import LOOSE, STIFF, TIGHT, WHOLE, timings
from ..workers import in_parallel
from .ending import still_to_do, taken_on
from .lean import leaner
from .levels import noise_level
from .model import Fitted, Model, best_of_each, effects_of, excess, fitted, plausible, together
from .moves import starts
from .race import in_heats, raced, still_leading
from .screen import best_starts, likely, screened, stopping, unseen
from .search import Move, Path, Problem, Progress, Regime, Round, moves_of
from .whole_runs import end_of_learned, first_part


@dataclass(frozen=True, kw_only=True)
class WhitePath(Path[Fitted]):
    """The path of a search.

    Attributes:
        given: the crane as it is; fewest: with the fewest moved parameters that do, where that was needed.
        left_out: errors on blocks that were left out, before and after, of a model that leaves something, by its
            effects.
    """

    given: Fitted
    fewest: Fitted
    left_out: Mapping[frozenset[str], tuple[float, float]] = field(default_factory=dict)

    @cached_property
    def bare(self) -> float:
        """Evidence of the better model without effects."""
        return max(self.given.evidence, self.parameters.evidence)

    @property
    def adequate(self) -> bool:
        """Whether the machine as it is leaves hardly more than noise, and moved parameters explain no more."""
        return self.given.good and self.parameters.evidence < self.given.evidence + CRITERIA.proof

    @cached_property
    def whole(self) -> float:
        """Open-loop error of the machine without effects, its parameters moved."""
        return together(self.problem.recordings, self.problem.errors([self.parameters.fit])[0])

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
        more than noise, or has several effects and leaves little: of several that are still missing perhaps none takes
        away most of what is left.
        """
        return self.done[0] if self.done and _leaves_little(self.done[0]) else self.best


def _begun(problem: Problem) -> WhitePath:
    """Return the path before its first round: the crane as it is, and with its parameters moved."""
    crane, data = problem.crane, problem.data
    given = fitted(crane, data, Model(tuple(timings(data))), problem.nominal, (TIGHT, STIFF))
    given = replace(given, loose=problem.nominal)
    parameters = fitted(crane, data, Model(problem.shared), problem.base, (TIGHT, STIFF))
    if parameters.plausible and parameters.level < CRITERIA.left_level and (ways := still_to_do(parameters)):
        parameters = taken_on(problem, parameters, ways)
    parameters = replace(parameters, loose=problem.base)
    return _with_parameters(WhitePath(problem, parameters, given=given, fewest=parameters), parameters)


def _with_parameters(path: WhitePath, parameters: Fitted) -> WhitePath:
    """Return the path with another fit of the machine without effects."""
    parameters = replace(parameters, loose=path.parameters.loose)
    path, problem = replace(path, parameters=parameters, fewest=parameters), path.problem
    if parameters.good and not path.adequate:
        path = replace(path, fewest=leaner(problem.crane, problem.data, parameters))
    return path


def _beam(path: WhitePath, most: int) -> Sequence[Fitted]:
    """Return the models that a round goes on from, the leading one first: the best alone if it leaves hardly more than
    noise. No round goes on from the same effects again, unless these leave so little that other windows tell of more.
    """
    best, ahead = path.best, path.ahead
    if not path.rounds:
        return [path.parameters]
    if best is None or ahead is None:
        return []
    first = path.rounds[0].tried[: CRITERIA.beam]
    if len(path.rounds) == 1 and not (best.good or path.parameters.good):
        return first
    most = most if _leaves_little(ahead) else CRITERIA.most
    again = len(path.rounds) > 1 and not ahead.near and ahead.keys in [w.keys for w in first]
    return [ahead] if len(ahead.keys) < most and ahead.level < CRITERIA.misled and not again else []


def _leaves_little(w: Fitted) -> bool:
    """Whether a model leaves hardly more than noise, or little beside as many effects as are looked for where much is
    left.
    """
    return w.near or (len(w.keys) >= CRITERIA.most and w.level < CRITERIA.left_level)


def _is_near(path: WhitePath, parents: Sequence[Fitted]) -> bool:
    """Whether a round goes on from one model that leaves little: what is missing beside it shows in stiffly joined
    windows only. Parameters may leave little in windows and much in one run: then much is missing.
    """
    near = len(parents) == 1 and _leaves_little(parents[0])
    return near and (bool(parents[0].keys) or path.whole <= CRITERIA.left_level)


def _likely(path: WhitePath, beam: Sequence[Fitted]) -> list[Move]:
    """Return the likeliest effects beside each model of a beam, as the screen sees them from where it stands; beside
    one that is near those that must show; beside one whose parameters do an effect's work from the machine as given.
    """
    near, moves = _is_near(path, beam), list[Move]()
    for parent in beam:
        fit, stiffness = (parent.fit, STIFF.stiffness) if near else (parent.loose, LOOSE.stiffness)
        if parent.keys and not (near or parent.plausible):
            ended = next((w for w in path.done if w.keys == parent.keys), parent)
            fit = path.problem.as_given(ended.effects, ended.fit)
        most = CRITERIA.nearly if near else CRITERIA.others if parent.keys else CRITERIA.singles
        least = CRITERIA.tie if near else CRITERIA.promise
        scores = screened(fit, stiffness)
        offered = likely(best_starts(scores) if near else scores, most, least)
        variables = parent.model.variables if near else path.problem.shared
        moves += moves_of(Model(variables, effects_of(fit.crane, parent.keys)), offered, fit)
    return moves


def _tried(path: WhitePath, beam: Sequence[Fitted], moves: Sequence[Move]) -> list[Fitted]:
    """Return the moves fitted, the best of each; near the end the cost is quadratic at once: no walk from loose to
    stiff.
    """
    if _is_near(path, beam):
        return best_of_each(path.problem.run(moves, (STIFF,)))
    return best_of_each(raced(path.problem, beam, moves, lambda: _hidden(path, beam, moves)))


def _unseen(path: WhitePath, parent: Fitted, led: Sequence[Fitted]) -> list[Fitted]:
    """Return the effects that no screen sees fitted from the machine as given, those that bring evidence: what softens,
    beside a model that leaves little because its parameters moved, as they may stand for it; and what stops a cylinder,
    where first states may. None where one of those that were seen explains all that is left, without such help.
    """
    left = CRITERIA.left_of_rest * excess(parent.level)
    if any(w.good and w.move_cost < CRITERIA.helped and excess(w.level) < left for w in led):
        return []
    moved = parent.move_cost >= CRITERIA.helped if parent.keys else not path.adequate
    little = parent.level < (noise_level(parent.fit.data) if parent.keys else CRITERIA.left_level)
    hidden = [*(unseen(parent.fit) if moved and little else []), *stopping(parent.loose)]
    if not hidden:
        return []
    problem = path.problem
    models = [Model(problem.shared, {**parent.effects, s.key: s.values}) for s in hidden]
    found = problem.fits([(problem.anew, model, (LOOSE, TIGHT)) for model in models])
    before = fitted(problem.crane, problem.data, parent.model, parent.fit, (TIGHT,))
    leading = [w for w in found if w.evidence >= before.evidence + CRITERIA.proof]
    ended = problem.further(leading, (STIFF,))
    return [w for w in ended if w.evidence >= parent.evidence + CRITERIA.proof]


def _hidden(path: WhitePath, beam: Sequence[Fitted], moves: Sequence[Move]) -> list[Move]:
    """Return the likeliest effects that the machine as given shows and no move adds yet, where parameters may do an
    effect's work.
    """
    if beam[0].keys or not path.beyond_uncertainty:
        return []
    held, known = path.problem.as_given({}), {key for m in moves for key in m.model.keys}
    more = likely(screened(held, LOOSE.stiffness), CRITERIA.as_given + len(moves), CRITERIA.promise)
    new = [s for s in more if s.start.key not in known]
    return moves_of(Model(path.problem.shared), new[: CRITERIA.as_given], held)


def _judged(path: WhitePath, beam: Sequence[Fitted], tried: Sequence[Fitted]) -> Round[Fitted]:
    """Return the round, the leading models carried to the end."""
    near = _is_near(path, beam)
    led = tried if near else path.problem.further(_leading(beam, tried), (TIGHT, STIFF))
    done = _further(path, [], [*led, *_unseen(path, beam[0], led)])
    done = _exchanged(path, _relocated(path, done, beam, tried) if not path.rounds else done)
    tasks = path.problem.tasks(_dropped(path, done, near), (TIGHT, STIFF))
    tasks += path.problem.tasks(_again(beam[0], done) if near else [], (WHOLE, STIFF))
    done = best_of_each([*done, *path.problem.fits(tasks)])
    acting = tuple(w for w in done if w.keys)
    return Round(tuple(tried), acting, _deciding(path, acting), next((w for w in done if not w.keys), None))


def _leading(parents: Sequence[Fitted], tried: Sequence[Fitted]) -> list[Fitted]:
    """Return the fits to be carried to the end: the best two, or one if it leaves hardly more than noise; one more that
    is near; and the one that parameters help least if they help the best too much.
    """
    if not tried:
        return []
    least = still_leading(parents, tried)
    most = 1 if tried[0].good else CRITERIA.finished
    leading = list(tried[:most])
    if not parents[0].keys:
        leading += [w for w in tried[most : CRITERIA.finished + 1] if w.evidence > least]
    elif not leading[0].plausible:
        calmest = min(
            (w for w in tried if set(parents[0].keys) <= set(w.keys)), key=lambda w: w.move_cost, default=leading[0]
        )
        leading += [calmest] if all(calmest is not w for w in leading) else []
    return leading


def _relocated(path: WhitePath, done: list[Fitted], parents: Sequence[Fitted], tried: Sequence[Fitted]) -> list[Fitted]:
    """Return the fits with the leading effect at its other places added, where it explains something and moved
    parameters help it.

    An effect at the wrong place explains much of a recording if parameters may help, and they can hide the right place
    from the screen.
    """
    if not done or done[0].move_cost < CRITERIA.helped or done[0].evidence < path.bare + CRITERIA.proof:
        return done
    problem, known = path.problem, {key for w in done for key in w.keys}
    effect, _ = registry.split_key(done[0].keys[0])
    lay = problem.crane.layout
    found = [s for s in starts(problem.crane, problem.data) if s.key in set(effect.keys(lay)) - known]
    moves = [Move(Model(problem.shared, {s.key: s.values}), problem.base) for s in found]
    least = still_leading(parents, tried)
    leading = [w for w in in_heats(problem, parents, moves)[:1] if w.evidence > least]
    return _further(path, done, problem.further(leading, (TIGHT, STIFF)))


def _exchanged(path: WhitePath, done: list[Fitted]) -> list[Fitted]:
    """Return the fits with one of the leading model's several effects exchanged for what the screen sees beside them,
    where they leave something.

    Of two laws that are nearly alike the one that was fitted first takes the other's place: only then does the other
    show.
    """
    best = done[0] if done else path.parameters
    if len(best.keys) < 2 or best.level >= CRITERIA.left_level:
        return done
    problem, model = path.problem, Model(best.model.variables, best.effects)
    shown = likely(best_starts(screened(best.fit, STIFF.stiffness)), 1, CRITERIA.tie)
    wider = problem.run(moves_of(model, shown, best.fit), (STIFF,))
    moves = [_without(w, key) for w in wider if w.near for key in best.keys]  # what three leave two leave as well
    return _further(path, done, problem.run(moves, (TIGHT, STIFF)))


def _without(w: Fitted, key: str) -> Move:
    """Return the move that drops one of a model's effects."""
    return Move(Model(w.model.variables, {k: values for k, values in w.effects.items() if k != key}), w.fit)


def _further(path: WhitePath, done: Sequence[Fitted], more: Sequence[Fitted]) -> list[Fitted]:
    """Return fits and more of them, of these the leading ones taken further where they are not at their end: beside
    fits that stand already only those that come near the best.

    Where parameters have moved further than they may to do an effect's work, the fit begins anew at the crane as given
    with the effects as they were found, and as one long run: what is slow does not show in short windows.
    """
    problem, tasks = path.problem, list[tuple[Any, ...]]()
    best = min([*done, *more], key=lambda w: w.level, default=path.parameters)
    first = sorted(more, key=lambda w: w.move_cost - w.evidence)  # rather those helped less
    near = max((w.evidence for w in [*done, *more]), default=0.0) - CRITERIA.apart
    for w in (w for i, w in enumerate(first) if w.evidence > near or (i < CRITERIA.further and not done)):
        beaten = len(w.keys) > 1 or best.level < CRITERIA.left_level
        hopeless = beaten and w.level > CRITERIA.left_level
        if hopeless or w.evidence < path.parameters.evidence + CRITERIA.proof:
            continue
        if not w.plausible:
            tasks.append((problem.anew, w.as_found, (WHOLE, STIFF)))
        elif (ways := still_to_do(w)) or w.model.variables == problem.shared:
            tasks.append((taken_on, problem, w, ways))
    return best_of_each([*done, *more, *problem.fits(tasks)])


def _dropped(path: WhitePath, done: Sequence[Fitted], near: bool) -> list[Move]:
    """Return models to be fitted without one of their effects: one that does nothing, or beside which the others have
    not been seen alone.

    What came in beside another may be the one that is missing, and the first a surrogate; or have only led the fit to
    the better minimum.
    """
    known = {frozenset(w.keys) for r in path.rounds for w in r.done} | {frozenset(w.keys) for w in done}
    moves: dict[frozenset[str], Move] = {}
    for w in (w for w in done if w.evidence > path.bare):
        for key in w.keys:
            rest = frozenset(w.keys) - {key}
            if key in w.inactive or not (near or not rest or rest in known):
                moves.setdefault(rest, _without(w, key))
    return list(moves.values())


def _again(parent: Fitted, done: Sequence[Fitted]) -> list[Move]:
    """Return the model that leaves little, from which a round went on, to be fitted anew as one long run, where a
    further effect brings something: that must not be what its own fit had missed.
    """
    proven = any(w.evidence >= parent.evidence + CRITERIA.proof for w in done)
    return [Move(parent.model, parent.fit)] if proven else []


def _deciding(path: WhitePath, done: Sequence[Fitted]) -> dict[frozenset[str], float]:
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
    least = first.evidence + CRITERIA.proof
    more = [w for w in done if len(w.keys) > len(first.keys) and w.evidence > least]
    weighed = [first, *more] if more else []
    errors = path.problem.errors([w.fit for w in weighed])
    return {frozenset(w.keys): together(path.problem.recordings, e) for w, e in zip(weighed, errors, strict=True)}


def _after(path: WhitePath, found: Round[Fitted]) -> WhitePath:
    """Return the path with a round; with a better fit without effects, where the round came upon one."""
    if found.bare is not None and found.bare.evidence > path.parameters.evidence:
        path = _with_parameters(path, found.bare)
    return replace(path, rounds=(*path.rounds, found))


def taken_otherwise(path: WhitePath, problem: Problem) -> WhitePath:
    """Return a path with its models fitted to a problem whose recordings are taken otherwise (commands between samples,
    noise).
    """
    problem, before = replace(problem, told=path.problem.shared), path.done
    moves = [Move(w.model, w.fit) for w in (path.given, path.parameters)]
    given, parameters = in_parallel(problem.jobs, problem.tasks(moves, (STIFF,)))
    path = _with_parameters(replace(path, problem=problem, given=given, rounds=(), left_out={}), parameters)
    done = tuple(best_of_each(problem.further(before, (STIFF,))))
    return replace(path, rounds=(Round(done, done, _deciding(path, done)),)) if done else path


def _gained(path: WhitePath) -> bool:
    """Whether the last round brought a model that has the proof against the one before it, or one without effects. The
    first need not where nothing explains the recordings: of two missing effects neither may do better than all
    parameters moved.
    """
    before, after = replace(path, rounds=path.rounds[:-1]).ahead, path.ahead
    if before is None and not (path.given.good or path.parameters.good):
        return after is not None
    least = path.bare if before is None else before.evidence
    return after is not None and after.evidence >= least + CRITERIA.proof


def _finished(path: WhitePath, most: int, progress: Progress) -> WhitePath:
    """Return the path with errors on blocks that were left out, where the best model repairs something and leaves
    something.
    """
    best = path.best
    if best is None or best.good or not best.plausible or best.evidence < path.bare + CRITERIA.proof:
        return path
    if best.level > CRITERIA.misled:
        return path
    return replace(path, left_out={frozenset(best.keys): _left_out(path.problem, best)})


def _left_out(problem: Problem, w: Fitted) -> tuple[float, float]:
    """Return the errors, of the crane as given and of a model fitted to the first part of each recording, on the
    rest.
    """
    ends = list(enumerate((end_of_learned(p), float(p.time[-1])) for p in problem.data.parts))
    found = fitted(problem.crane, first_part(problem.data), Model(w.model.variables, w.effects), w.fit, (STIFF,))
    given = [(problem.crane, i, span) for i, span in ends]
    rest, errors = problem.errors_over([*given, *((found.fit.of(i).crane, i, span) for i, span in ends)])
    n = len(ends)
    return together(rest[:n], errors[:n]), together(rest[n:], errors[n:])


WHITE = Regime(_begun, _beam, _likely, _tried, _judged, _after, _gained, _finished)
