"""The fewest nominal parameters that have to move.

A fit that moves everything that is uncertain explains a recording as well as one that moves what was wrong, but
predicts worse: small moves that the data hardly determine add up elsewhere. So of the chosen explanation those
parameters alone stay free that bring more evidence than their freedom costs: chosen one by one, all others held where
the crane file has them, by the normal equations where the explanation stands, and a few more where the fit of these
ends.
"""

from __future__ import annotations

from collections.abc import Sequence, Set
from dataclasses import replace

import numpy as np

from crane_exudyn.crane import Crane

from ..criteria import CRITERIA
from ..fit.data import Data
from ..fit.linear import linearised
from ..fit.solve import Fit, bounded_step, reduce, with_prior
from ..fit.staged import STIFF, timings
from ..fit.variables import NominalDirection, Variable, stated_effects
from ..workers import single_threaded
from .model import Fitted, each_parameter, fitted


@single_threaded()
def leaner(crane: Crane, data: Data, full: Fitted) -> Fitted:
    """Return the explanation with the fewest moved parameters, or `full` where moving everything is better
    supported.
    """
    held: list[Variable] = [*timings(data), *stated_effects(crane)]
    tried = [full]
    for most in (CRITERIA.freed, CRITERIA.freed_again):
        let_go, begun = _needed(tried[-1].fit, {v.name for v in held}, most)
        if not let_go and len(tried) > 1:
            break
        held = [*held, *let_go]
        tried.append(fitted(crane, data, replace(full.model, variables=tuple(held)), begun, (STIFF,)))
    return max(tried, key=lambda w: w.evidence)


def _needed(fit: Fit, free: Set[str], most: int) -> tuple[list[Variable], Fit]:
    """Return the nominal parameters whose freedom the linearised fit supports beside those that are free, the most
    telling first; and where it ends with these alone, all others as the crane file has them.
    """
    every = [*zip(*each_parameter(fit), strict=True)]
    every.sort(key=lambda pair: isinstance(pair[0], NominalDirection) and pair[0].name not in free)
    variables, u = [v for v, _ in every], np.array([x for _, x in every])
    m = sum(not isinstance(v, NominalDirection) or v.name in free for v in variables)
    linear, knots = linearised(fit.origin, fit.data, fit.windows, fit.knots, variables, u, STIFF.stiffness)
    reduced = reduce(linear, knots, knots)
    if reduced is None:
        return [], fit
    H, g = with_prior(reduced, variables, u)
    held = np.r_[u[:m], np.zeros(len(u) - m)]
    slope = g + H @ (held - u)
    chosen = [m + j for j in _forward(H, slope, m, most, variables[m:])]
    moved = [*range(m), *chosen]
    lower, upper = (np.array([getattr(variables[i], end) for i in moved]) for end in ("lower", "upper"))
    ended = held.copy()
    ended[moved] += bounded_step(H[np.ix_(moved, moved)], slope[moved], held[moved], lower, upper, 0.0)
    begun = knots + (reduced.knots_step + reduced.knots_by_u @ (ended - u)) * linear.jump
    return [variables[i] for i in chosen], replace(fit.begun(fit.origin, variables, ended), knots=begun)


def _forward(H: np.ndarray, g: np.ndarray, m: int, most: int, offered: Sequence[Variable]) -> list[int]:
    """Choose columns one by one by the evidence they add, those chosen and the first m projected out."""
    chosen: list[int] = []
    while len(chosen) < most:
        fixed = [*range(m), *(m + j for j in chosen)]
        solved = np.linalg.lstsq(H[np.ix_(fixed, fixed)], np.column_stack([H[fixed], g[fixed]]), rcond=None)[0]
        slope = g - H[:, fixed] @ solved[:, -1]
        bend = np.diag(H) - np.einsum("ij,ji->i", H[:, fixed], solved[:, :-1])
        gains = {}
        for j, variable in enumerate(offered):
            if j in chosen or not bend[m + j] > 1e-9:
                continue
            prior = 1.0 if np.isfinite(variable.prior) else 1.0 / CRITERIA.broad**2
            total = bend[m + j] + (0.0 if np.isfinite(variable.prior) else prior)
            gains[j] = 0.5 * slope[m + j] ** 2 / total - 0.5 * np.log(max(total / prior, 1.0))
        best = max(gains, key=lambda j: gains[j], default=None)
        if best is None or gains[best] < CRITERIA.let_go:
            break
        chosen.append(best)
    return chosen
