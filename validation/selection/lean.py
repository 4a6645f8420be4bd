"""The fewest nominal parameters that have to move.

A fit that moves everything that is uncertain explains a recording as well as one that moves what was wrong, but
predicts worse: small moves that the data hardly determine add up elsewhere. So the chosen explanation is fitted again
with the nominal parameters held, and those are let go one by one that bring more evidence than their freedom costs.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from crane_exudyn.crane import Crane

from ..criteria import CRITERIA
from ..fit.data import Data
from ..fit.linear import linearised
from ..fit.solve import Fit, reduce, with_prior
from ..fit.staged import STIFF, timings
from ..fit.variables import Variable, stated_effects, uncertain_parameters
from .model import Fitted, fitted


def leaner(crane: Crane, data: Data, full: Fitted) -> Fitted:
    """Return the explanation with the fewest moved parameters, or `full` where moving everything is better
    supported.
    """
    held: list[Variable] = [*timings(data), *stated_effects(crane)]
    tried = [full, _with(crane, data, full, full.fit, held)]
    for again, most in enumerate((CRITERIA.freed, CRITERIA.freed_again)):
        let_go = needed(crane, tried[-1].fit, most)
        if not let_go:
            break
        held = [*held, *let_go]
        tried.append(_with(crane, data, full, tried[-1].fit if again else full.fit, held))
    return max(tried, key=lambda w: w.evidence)


def _with(crane: Crane, data: Data, full: Fitted, before: Fit, variables: Sequence[Variable]) -> Fitted:
    return fitted(crane, data, replace(full.model, variables=tuple(variables)), before, (STIFF,))


def needed(crane: Crane, fit: Fit, most: int) -> list[Variable]:
    """Return the nominal parameters whose freedom the linearised fit supports, the most telling first."""
    names = {v.name for v in fit.variables}
    every = uncertain_parameters(crane, fit.data.own, len(fit.data.parts))
    offered: list[Variable] = [v for v in every if v.name not in names]
    variables = [*fit.variables, *offered]
    u = np.concatenate([fit.u, np.zeros(len(offered))])
    linear, _ = linearised(crane, fit.data, fit.windows, fit.knots, variables, u, STIFF.stiffness)
    if linear.failed:
        return []
    H, g = with_prior(reduce(linear, fit.knots, fit.knots), variables, u)
    return [offered[j] for j in _forward(H, g, len(fit.u), most, offered)]


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
