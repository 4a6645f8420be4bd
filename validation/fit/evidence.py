"""How well a fitted model explains a recording, as a log marginal likelihood.

The likelihood counts each short window of the recording with an error level of its own (`linear.robust`): thousands of
correlated residuals of a wrong model are not thousands of independent proofs. Priors and the share of the prior volume
that the data leave (the Occam factor of Laplace's approximation) charge for every parameter.
"""

from __future__ import annotations

import math

import numpy as np

from ..criteria import CRITERIA
from ..workers import single_threaded
from .solve import Fit, reduce, with_prior
from .variables import expected_std


@single_threaded()
def occam(fit: Fit) -> float:
    """Return the log of the share of the prior volume of all variables that the data leave (negative); minus infinity
    for a model that failed.
    """
    reduced = reduce(fit.linear, fit.knots, fit.knots) if len(fit.u) else None
    if reduced is None:
        return -math.inf if fit.linear.failed else 0.0
    H, _ = with_prior(reduced, fit.variables, fit.u)
    scale = expected_std(fit.variables)
    broad = np.array([1.0 / CRITERIA.broad**2 if math.isinf(v.prior) else 0.0 for v in fit.variables])
    A = scale[:, None] * (H + np.diag(broad)) * scale
    sign, value = np.linalg.slogdet(0.5 * (A + A.T))
    return -0.5 * float(value) if sign > 0 else 0.0


def log_evidence(fit: Fit) -> float:
    """Return the log marginal likelihood of a fit up to a constant of the recording (Laplace's approximation)."""
    left = occam(fit)
    return -0.5 * (fit.linear.cost + fit.linear.volume) - fit.prior_cost + left if math.isfinite(left) else left
