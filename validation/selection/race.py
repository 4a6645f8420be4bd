"""Which of many moves are worth a fit, and how far: those that promise most begin, and what is far behind stops."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from ..criteria import CRITERIA
from ..fit.evidence import log_evidence
from ..fit.staged import LOOSE
from .model import Fitted
from .search import Move, Problem


def raced(
    problem: Problem, parents: Sequence[Fitted], moves: Sequence[Move], more: Callable[[], Sequence[Move]]
) -> list[Fitted]:
    """Return the moves fitted loosely, those first that promise most; once one leaves hardly more than noise and has no
    help from parameters, the others only where they promise about as much, else also `more`.
    """
    moves = sorted(moves, key=lambda m: -m.promise)
    done, rest = in_heats(problem, parents, moves[: CRITERIA.first]), moves[CRITERIA.first :]
    if done and done[0].good and done[0].move_cost < CRITERIA.helped:
        most = moves[0].promise
        rest = [m for m in rest if m.promise > most - max(CRITERIA.apart, CRITERIA.left * most)]
    else:
        rest += more()
    return [*done, *in_heats(problem, parents, rest)]


def in_heats(problem: Problem, parents: Sequence[Fitted], moves: Sequence[Move]) -> list[Fitted]:
    """Return the moves fitted loosely, best first; after a few iterations those alone go on that are not far behind."""
    begun = problem.run(moves, (replace(LOOSE, iterations=CRITERIA.sifted),))
    least = _brought(parents, begun, CRITERIA.chance)
    ended = problem.further([w for w in begun if w.evidence >= least], (LOOSE,))
    stopped = [w for w in begun if w.evidence < least]
    return sorted([*ended, *stopped], key=lambda w: -w.evidence)


def still_leading(parents: Sequence[Fitted], tried: Sequence[Fitted]) -> float:
    """Return the evidence of loose fits, best first, from which on they may still lead at their end."""
    return min(tried[0].evidence - CRITERIA.apart, _brought(parents, tried, 1.0 - CRITERIA.near))


def _brought(parents: Sequence[Fitted], found: Sequence[Fitted], share: float) -> float:
    """Return the evidence of a loose fit that brings a share of what the best of some brings where they grew from."""
    before = log_evidence(parents[0].loose)
    return before + share * max((w.evidence - before for w in found), default=0.0)
