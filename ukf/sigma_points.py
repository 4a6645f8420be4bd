"""Sigma points of (27) and of the cubature rule, with their weights.

With L states, λ = L(A² - 1) (more generally A²(L + κ) - L) and the lower Cholesky factor S of P::

    χ0 = x,   χj = x + √(L + λ) S_j,   χ(L+j) = x - √(L + λ) S_j          (27), with the factor inside the root
    W0m = λ/(L + λ),   W0c = W0m + 1 - A² + B,   Wi = 1/(2 (L + λ))

A = 0.99, B = 0, κ = 0 are filterpy's ``MerweScaledSigmaPoints(n, alpha=0.99, beta=0, kappa=0)``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.errors import CraneError

from .linear_algebra import cholesky


@dataclass(frozen=True)
class Weights:
    """Weights of m sigma points for n states: `mean` (m,), `covariance` (m,), spread √(L + λ), centre point or not."""

    n: int
    mean: np.ndarray
    covariance: np.ndarray
    spread: float

    @property
    def centred(self) -> bool:
        """Whether the first point is the mean itself (2n + 1 points instead of 2n)."""
        return self.mean.size == 2 * self.n + 1

    @property
    def count(self) -> int:
        """Number of sigma points."""
        return self.mean.size


def merwe(n: int, alpha: float = 0.99, beta: float = 0.0, kappa: float = 0.0) -> Weights:
    """Return the weights of (27) for `n` states: 2n + 1 points; `alpha` is the paper's A, `beta` its B.

    Raises:
        CraneError: the spread is not positive, or the weights can give an indefinite covariance (`root_column`).
    """
    total = alpha**2 * (n + kappa)
    if not total > 0:
        raise CraneError(
            f"sigma points: alpha²(n + kappa) = {total:g} with alpha = {alpha:g}, n = {n}, kappa = {kappa:g}; "
            "the spread needs a positive number. Use 0 < alpha <= 1 and kappa > -n."
        )
    mean = np.full(2 * n + 1, 0.5 / total)
    mean[0] = (total - n) / total
    covariance = mean.copy()
    covariance[0] += 1.0 - alpha**2 + beta
    weights = Weights(n, mean, covariance, float(np.sqrt(total)))
    if centre_gain(weights) < -1e-12:
        raise CraneError(
            f"sigma points: alpha = {alpha:g}, beta = {beta:g}, kappa = {kappa:g} weigh the centre point so negatively "
            "that the covariance may become indefinite. Raise beta, or use kappa = 0."
        )
    return weights


def cubature(n: int) -> Weights:
    """Return the weights of the third-degree spherical cubature rule: 2n points of weight 1/(2n), spread √n."""
    equal = np.full(2 * n, 0.5 / n)
    return Weights(n, equal, equal.copy(), float(np.sqrt(n)))


def centre_gain(weights: Weights) -> float:
    """Return 1 + W0c (1 - W0m)/W0m², which must not be negative for the covariance to be semidefinite.

    Why: Σ Wim (χi - x̂) = 0 makes the centre point's deviation d0 a combination of the others, d0 = -Σ Wi di / W0m.
    With the columns √Wi di in D and w = (√W1, √W2, …), |w|² = 1 - W0m, the covariance (29) is
    D (I + W0c/W0m² w wᵀ) Dᵀ. For κ = 0 and B = 0 the number is exactly 0, for every A: semidefinite, no more, no less.
    A covariance of (29) therefore never needs a downdate, although W0c is negative.
    """
    if not weights.centred or weights.covariance[0] >= 0.0:
        return 1.0
    w0 = weights.mean[0]
    return float(1.0 + weights.covariance[0] * (1.0 - w0) / w0**2)


@njit()
def place(mean: np.ndarray, root: np.ndarray, spread: float, count: int) -> np.ndarray:
    """Return the sigma points (count, n) around `mean` (n,) with the lower root (n, n) of the covariance."""
    n = mean.size
    points = np.empty((count, n))
    first = count - 2 * n
    for i in range(n):
        if first == 1:
            points[0, i] = mean[i]
        for j in range(n):
            step = spread * root[i, j]
            points[first + j, i] = mean[i] + step
            points[first + n + j, i] = mean[i] - step
    return points


@njit()
def drawn(mean, covariance, spread, count):  # type: ignore[no-untyped-def]
    """Return the sigma points (count, n) of a mean (n,) and a covariance (n, n), and whether that has no Cholesky
    factor.
    """
    root = np.empty_like(covariance)
    if cholesky(covariance, root) >= 0:
        return np.empty((0, mean.size)), True
    return place(mean, root, spread, count), False
