"""The search for laws: as where errors are white noise, but every law at every place over every argument is a move
beside the library's effects, and a law must predict blocks of time that it was not fitted to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from ..criteria import CRITERIA
from ..fit.solve import Fit
from ..fit.staged import LOOSE, STIFF, TIGHT
from ..selection.ending import still_to_do, taken_on
from ..selection.model import Fitted, Model, best_of_each, excess, fitted, plausible, retold
from ..selection.race import raced, still_leading
from ..selection.screen import likely, screened
from ..selection.search import Move, Path, Problem, Progress, Regime, Round, moves_of
from ..workers import in_parallel
from .fits import laws_of, left_out_gain, refined, spread
from .laws import possible_laws
from .screen import allowed
from .screen import screened as screened_laws


@dataclass(frozen=True, kw_only=True)
class LearningPath(Path[Fitted]):
    """The path of a search for laws.

    Attributes:
        best: the model that it has come to; rivals: what its last round left tied with it.
        notes: why something that was found is not given.
    """

    best: Fitted
    rivals: tuple[Fitted, ...] = ()
    notes: tuple[str, ...] = ()


def named(w: Fitted) -> str:
    """Return the laws of a model in words."""
    return " and ".join(n for k, n in zip(w.keys, w.names, strict=True) if k in w.model.curves)


def sound(w: Fitted) -> bool:
    """Whether all curves have the sign that physics asks of them."""
    for key, found in laws_of(w).items():
        neutral, (y, std) = found.law.neutral, spread(w, key)
        astray = (neutral - y) - CRITERIA.astray * std
        if found.law.one_sided and (astray > CRITERIA.below * abs(y - neutral).max()).any():
            return False
    return True


def _begun(problem: Problem) -> LearningPath:
    nothing = fitted(problem.crane, problem.data, Model(problem.shared), problem.base, (TIGHT, STIFF))
    nothing = replace(nothing, loose=problem.base)
    return LearningPath(problem, nothing, best=nothing)


def _beam(path: LearningPath, most: int) -> Sequence[Fitted]:
    """Return the best model, in loosely joined windows as well, unless it leaves hardly more than noise with a law."""
    best, problem = path.best, path.problem
    if len(path.rounds) == most or (path.rounds and best.good):
        return ()
    if not best.keys:
        return (best,)
    return (replace(best, loose=fitted(problem.crane, problem.data, best.model, best.fit, (LOOSE,)).fit),)


def _likely(path: LearningPath, beam: Sequence[Fitted]) -> list[Move]:
    return _promising(path.problem, beam[0], beam[0].loose)


def _promising(problem: Problem, parent: Fitted, fit: Fit) -> list[Move]:
    """Return the laws and the effects of the library that a screen at a fit finds most promising beside a model."""
    model, moves = replace(parent.as_found, variables=problem.shared), list[Move]()
    found = screened_laws(fit, possible_laws(fit), LOOSE.stiffness)
    least = max(CRITERIA.proof, CRITERIA.hopeless * found[0].gain) if found else CRITERIA.proof
    for f in [f for f in found if allowed(f) and f.gain > least][: CRITERIA.screened]:
        effects = {**model.effects, f.law.key: f.law.values(f.y)}
        moves.append(Move(replace(model, effects=effects, curves={**model.curves, f.law.key: f}), fit, f.gain))
    return [*moves, *moves_of(model, likely(screened(fit, LOOSE.stiffness), CRITERIA.beside, CRITERIA.promise), fit)]


def _tried(path: LearningPath, beam: Sequence[Fitted], moves: Sequence[Move]) -> list[Fitted]:
    return best_of_each(raced(path.problem, beam, moves, lambda: _as_given(path.problem, beam[0])))


def _as_given(problem: Problem, parent: Fitted) -> list[Move]:
    """Return what the machine as given shows, where parameters have moved further than they may: they may do a law's
    work and hide it.
    """
    if parent.keys or plausible(parent.loose):
        return []
    return _promising(problem, parent, problem.as_given({}))


def _judged(path: LearningPath, beam: Sequence[Fitted], tried: Sequence[Fitted]) -> Round[Fitted]:
    """Return the round, the leading laws and the leading effect carried to the end."""
    if not tried:
        return Round((), ())
    problem, (parent,) = path.problem, beam
    least, laws = still_leading(beam, tried), len(parent.model.curves)
    near = [w for w in tried if w.evidence >= least]
    curved = [w for w in near if len(w.model.curves) > laws]
    plain = [w for w in near if len(w.model.curves) == laws]
    leading = [w if w.plausible else _anew(problem, w) for w in curved[: CRITERIA.carried]]
    return Round(tuple(tried), tuple(problem.further([*leading, *plain[:1]], (TIGHT, STIFF))))


def _anew(problem: Problem, w: Fitted) -> Fitted:
    """Return a model fitted anew from the crane as given, where that does no worse: parameters that did a law's work
    before it was there come back slowly.
    """
    return max(w, problem.anew(w.as_found, (LOOSE,)), key=lambda one: one.evidence)


def _after(path: LearningPath, found: Round[Fitted]) -> LearningPath:
    """Return the path with a round; with its best model, where that has the proof, repairs and predicts, by the
    combinations of parameters that it tells of itself; where it leaves more than noise, with knots where its curves
    bend: what too few cannot follow another law would make good.
    """
    path, before = replace(path, rounds=(*path.rounds, found)), path.best
    chosen = _chosen(found.done, before)
    if chosen is None or (before.keys and not repairs(chosen, before)):
        return path
    if len(chosen.model.curves) > len(before.model.curves) and (failed := _failing(before, chosen)):
        return replace(path, notes=(*path.notes, failed))
    tied = [w for w in found.done if w is not chosen and w.evidence > chosen.evidence - CRITERIA.tie]
    best, *rivals = in_parallel(path.problem.jobs, [(retold, w) for w in (chosen, *tied)])
    problem = replace(path.problem, told=best.model.variables)
    if best.model.curves and not best.good:
        best = refined(problem, best)
        best = taken_on(problem, best, still_to_do(best))
    problem = replace(problem, told=best.model.variables)
    return replace(path, problem=problem, best=best, rivals=tuple(rivals))


def _chosen(found: Sequence[Fitted], best: Fitted) -> Fitted | None:
    """Return the best of the models that bring the proof; one with a law must bring it against those without a further
    one as well.
    """
    proven = [w for w in found if w.evidence > best.evidence + CRITERIA.proof and sound(w)]
    plain = next((w for w in proven if len(w.model.curves) == len(best.model.curves)), None)
    if plain is not None and plain.evidence > proven[0].evidence - CRITERIA.proof:
        return plain
    return proven[0] if proven else None


def repairs(after: Fitted, before: Fitted) -> bool:
    """Whether a model leaves hardly more than noise, or less than half of the excess error of the one before."""
    left, was = excess(after.level), excess(before.level)
    return after.good or left < CRITERIA.left * was


def _failing(before: Fitted, after: Fitted) -> str:
    """Return in words that a law does not gain on blocks of time that were left out what it should; "" where it
    does.
    """
    outside, inside = left_out_gain(before, after, CRITERIA.block)
    if outside > CRITERIA.predicts * inside:
        return ""
    return (
        f"{after.keys[-1]} would gain {inside:.0f} units of log-likelihood where it was fitted, but {outside:.0f} on "
        "blocks left out, so it does not predict"
    )


def _gained(path: LearningPath) -> bool:
    return len(path.best.keys) == len(path.rounds)


def _finished(path: LearningPath, most: int, progress: Progress) -> LearningPath:
    """Return the path; without laws that leave too much, or need parameters where they cannot be."""
    best, nothing = path.best, path.parameters
    if not best.model.curves or (repairs(best, nothing) and best.plausible):
        return path
    note = f"{named(best)} would be the best, but leaves too large an error, or changes parameters too much"
    return replace(path, best=nothing, rivals=(), notes=(*path.notes, note))


LEARNING = Regime(_begun, _beam, _likely, _tried, _judged, _after, _gained, _finished)
