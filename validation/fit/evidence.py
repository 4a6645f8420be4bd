"""How well a fitted model explains a recording: the likelihood of its residuals, with honest weight for what is correlated.

Residuals of a wrong model are not thousands of independent numbers: they drift. So each channel's residual is taken as white
sensor noise plus a drift, an Ornstein-Uhlenbeck process whose size and correlation time are chosen by likelihood. A
model that leaves only noise has no drift to pay for; one that leaves a drift pays for it about once a correlation time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from crane_exudyn.compiled import njit

from .solve import Fit, reduce, with_prior

#: sizes (noise units) and correlation times (s) that the drift of a channel may have
DRIFT_SIZES = np.array([0.0, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6, 51.2, 102.4])
DRIFT_TIMES = np.array([0.02, 0.1, 0.5, 2.5, 10.0])
#: prior standard deviation, in units of u, of a variable that has no prior of its own
BROAD = 2.0


@dataclass(frozen=True)
class Drift:
    """What one channel's residual is beside white noise: size in noise units, correlation time in s, log-likelihood."""

    size: float
    time: float
    log_likelihood: float


@njit
def drift_log_likelihood(r, gaps, size, time):
    """Return the log-likelihood of residuals r (noise units) as unit white noise plus a drift, by a scalar Kalman filter.

    The noise level itself is free within 20 %: it is known no better. gaps: seconds since the sample before.
    """
    n, mean, variance = r.size, 0.0, size * size
    total, logs = 0.0, 0.0
    for k in range(n):
        if k:
            keep = math.exp(-gaps[k] / time)
            mean *= keep
            variance = keep * keep * variance + size * size * (1.0 - keep * keep)
        S = variance + 1.0
        e = r[k] - mean
        total += e * e / S
        logs += math.log(S)
        gain = variance / S
        mean += gain * e
        variance *= 1.0 - gain
    level = min(max(total / n, 0.64), 1.44)
    return -0.5 * (logs + n * math.log(2.0 * math.pi * level) + total / level)


@njit
def best_drift(r, gaps, sizes, times):
    """Return size, time and log-likelihood of the drift that explains r best."""
    best = (0.0, times[0], drift_log_likelihood(r, gaps, 0.0, times[0]))
    for time in times:
        for size in sizes:
            if size > 0.0:
                value = drift_log_likelihood(r, gaps, size, time)
                if value > best[2]:
                    best = (size, time, value)
    return best


def drifts(residuals: dict[str, tuple[np.ndarray, np.ndarray]]) -> dict[str, Drift]:
    """Return the drift of each channel; residuals: channel -> (times, residual in noise units)."""
    found = {}
    for channel, (times, r) in residuals.items():
        gaps = np.diff(times, prepend=times[0])
        found[channel] = Drift(*best_drift(np.ascontiguousarray(r), gaps, DRIFT_SIZES, DRIFT_TIMES))
    return found


def occam(fit: Fit) -> float:
    """Return the log of the share of the prior volume of all variables that the data leave (negative)."""
    if not len(fit.u):
        return 0.0
    reduced = reduce(fit.linear, fit.knots, fit.knots)
    H, _ = with_prior(reduced, fit.variables, fit.u)
    scale = np.array([BROAD if math.isinf(v.prior) else v.prior for v in fit.variables])
    broad = np.array([1.0 / BROAD**2 if math.isinf(v.prior) else 0.0 for v in fit.variables])
    A = scale[:, None] * (H + np.diag(broad)) * scale
    sign, value = np.linalg.slogdet(A)
    return -0.5 * float(value) if sign > 0 else -math.inf


def log_evidence(fit: Fit, drift: dict[str, Drift]) -> float:
    """Return the log marginal likelihood of a fit (Laplace approximation, residual drift included)."""
    if fit.linear.failed:
        return -math.inf
    return sum(d.log_likelihood for d in drift.values()) - fit.prior_cost + occam(fit)
