"""Taking a fit to its end, where few windows are still unexplained or iterations ended too soon."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from ..criteria import CRITERIA
from ..fit.staged import STIFF
from .model import Fitted, fitted, retold
from .search import Problem, Stages


def still_to_do(w: Fitted) -> Sequence[Stages]:
    """Return ways to take a fit to its end: once more, those windows that stay unexplained begun anew, or windows that
    end elsewhere (the moment of an event may be caught at the end of one, which the jump makes good), where little is
    left that is more than noise, be it in a single window; more iterations, where it had not converged.
    """
    if w.level < CRITERIA.left_level and (not w.good or w.bad.any()):
        elsewhere = replace(STIFF, seconds=CRITERIA.elsewhere)
        return (STIFF,), (elsewhere, STIFF)
    return () if w.fit.converged else ((STIFF, STIFF),)


def taken_on(problem: Problem, w: Fitted, ways: Sequence[Stages]) -> Fitted:
    """Return a model fitted further, a second way where the first leaves a few windows unexplained; at last by the
    combinations of parameters that it tells of itself.
    """
    found = w
    for stages in ways:
        further = fitted(problem.crane, problem.data, w.model, w.fit, stages)
        found = max(found, further, key=lambda one: one.evidence)
        if not (found.near and found.bad.any()):
            break
    if found.model.variables == problem.shared:
        found = retold(found)
    return replace(found, loose=w.loose)
