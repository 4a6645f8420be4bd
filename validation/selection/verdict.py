"""What the path of a search means: a pure function of it."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import islice
from typing import Literal

import numpy as np

from crane_exudyn.effects import registry
from crane_exudyn.effects.base import COMMANDING

from ..criteria import CRITERIA
from ..fit.data import FitData
from ..fit.model import spool_path
from .model import Fitted, at_bound, excess
from .search import Problem
from .white import WhitePath

Kind = Literal["adequate", "parameters", "effect", "tied", "unknown"]
#: parameters of an explanation that are named where they are not believed
_NAMED = 3


@dataclass(frozen=True)
class Verdict:
    """What is missing: kind, the model that says so, what is tied with it, and remarks."""

    kind: Kind
    chosen: Fitted
    ties: tuple[Fitted, ...] = ()
    notes: tuple[str, ...] = ()


def verdict_of(path: WhitePath) -> Verdict:
    """Return the verdict on a path."""
    best, moved = path.best, path.parameters
    enough = path.given.good or moved.good
    proven = best is not None and best.evidence > path.bare + CRITERIA.proof
    if enough and not (proven and best is not None and not within_clocks(path.problem, best)):
        at_once = _at_once(path, path.fewest, moved.evidence)
        if at_once is not None:
            return Verdict("tied", at_once, (path.fewest,), (_far_moves(path.fewest, at_once), *_bounds(at_once)))
        return Verdict("adequate", path.given) if path.adequate else Verdict("parameters", path.fewest)
    if best is None or not explains(path, best):
        return Verdict("unknown", path.given, notes=_beyond_belief(best))
    at_once = _at_once(path, best, best.evidence)
    if at_once is not None:
        return Verdict("tied", at_once, (best,), (_far_moves(best, at_once), *_bounds(at_once)))
    ties = tuple(
        w for w in path.weighed[1:]
        if w.evidence > best.evidence - CRITERIA.tie and len(w.keys) <= len(best.keys)
    )  # fmt: skip
    nearly = "the best explanation predicts data outside its fit, but its law differs slightly from the machine's"
    notes = () if best.good or _repairs(path, best) else (nearly,)
    return Verdict("tied" if ties else "effect", best, ties, (*notes, *_bounds(best)))


def explains(path: WhitePath, w: Fitted) -> bool:
    """Whether effects explain the recordings: hardly more than noise left, or nearly all that was wrong repaired, here
    or where they were not fitted.
    """
    if w.evidence < path.parameters.evidence + CRITERIA.proof or not w.plausible:
        return False
    return w.good or _repairs(path, w) or _predicts(path, w)


def _repairs(path: WhitePath, w: Fitted) -> bool:
    wrong = max(1, int(path.parameters.bad.sum()))
    return w.level < CRITERIA.left_level and 1.0 - w.bad.sum() / wrong >= CRITERIA.repaired


def _predicts(path: WhitePath, w: Fitted) -> bool:
    before, after = path.left_out.get(frozenset(w.keys), (1.0, np.inf))
    return after < CRITERIA.left_level and excess(after) < CRITERIA.left_of_rest * excess(before)


def _at_once(path: WhitePath, w: Fitted, evidence: float) -> Fitted | None:
    """Return the best model with one effect more that explains at once what parameters explain beside those of another
    only by several far moves; None where they need no such moves.
    """
    if not w.beyond_uncertainty:
        return None
    more = (v for v in path.done if len(v.keys) == len(w.keys) + 1 and set(w.keys) <= set(v.keys) and v.good)
    able = (v for v in more if len(v.far) < CRITERIA.several and not v.inactive)
    return next((v for v in able if v.evidence > evidence - CRITERIA.tie), None)


def _far_moves(w: Fitted, at_once: Fitted) -> str:
    """Return what a model needs that does with one effect less, and how much likelier the one is that has it."""
    gap = at_once.evidence - w.evidence
    less = f", and is less likely by {gap:.0f} units of log evidence" if gap > CRITERIA.tie else ""
    return (
        f"{' and '.join(w.keys) or 'no effect'} alone would need {len(w.far)} nominal parameters at more than twice "
        f"their stated uncertainty{less}"
    )


def _beyond_belief(w: Fitted | None) -> tuple[str, ...]:
    """Return why a model is not named that leaves hardly more than noise; nothing of one that leaves more."""
    if w is None or not w.near or w.plausible:
        return ()
    moves = ", ".join(f"{n} by {move:.1f} standard uncertainties" for n, move in islice(w.far.items(), _NAMED))
    return (
        f"{' and '.join(w.keys)} would leave hardly more than noise, but only with nominal parameters further off than "
        f"the crane file allows ({moves}). Probably something else is missing as well: `patu improve` searches for "
        "more effects",
    )


def _bounds(w: Fitted) -> tuple[str, ...]:
    return tuple(f"{k}: {p} is at an end of its range" for k in w.keys for p in at_bound(w.fit, k))


def within_clocks(problem: Problem, w: Fitted) -> bool:
    """Whether all that the effects do is what commands do that come less than a sampling interval later: when in it
    they came is not recorded.
    """
    if not all(set(registry.split_key(k)[0].hooks()) <= COMMANDING for k in w.keys):
        return False
    return all(_is_a_shift(problem, w, i, part) for i, part in enumerate(problem.data.parts))


def _is_a_shift(problem: Problem, w: Fitted, recording: int, data: FitData) -> bool:
    fit = w.fit.of(recording)
    plain = fit.crane
    for key in w.keys:
        plain = plain.without_effect(key)
    interval = float(np.median(np.diff(data.command_time)))
    shares = np.linspace(0.0, 1.0, CRITERIA.shifts + 1)
    acting, without = (spool_path(c, data, fit.late) for c in (fit.crane, plain))
    shifted = [spool_path(plain, data, fit.late + share * interval) for share in shares]
    left = np.min([np.square(acting - s).sum(axis=0) for s in shifted], axis=0)
    return bool(np.all(left <= CRITERIA.clock**2 * np.square(acting - without).sum(axis=0)))
