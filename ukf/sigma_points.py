"""Sigma points of (27) and of the cubature rule, with their weights.

With L states, λ = L(A² - 1) (more generally A²(L + κ) - L) and the lower Cholesky factor S of P::

    χ0 = x,   χj = x + √(L + λ) S_j,   χ(L+j) = x - √(L + λ) S_j          (27), with the factor inside the root
    W0m = λ/(L + λ),   W0c = W0m + 1 - A² + B,   Wi = 1/(2 (L + λ))

The n + 1 corners of a simplex (Julier 2003) hold mean and covariance as exactly with half as many points, but not third
moments, which are zero for points in pairs: what a curved model makes of them pushes the mean to one side.

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
    """Weights of m sigma points for n states.

    Attributes:
        mean, covariance: (m,).
        directions: (m, n) where the points lie for zero mean and unit covariance; they add up to zero with the weights
            of the mean.
    """

    mean: np.ndarray
    covariance: np.ndarray
    directions: np.ndarray

    @property
    def count(self) -> int:
        """Number of sigma points."""
        return self.mean.size


#: the paper's A
ALPHA = 0.99


def merwe(n: int, alpha: float = ALPHA, beta: float = 0.0, kappa: float = 0.0) -> Weights:
    """Return the weights of (27) for `n` states: 2n + 1 points; `alpha` is the paper's A, `beta` its B.

    Raises:
        CraneError: the spread is not positive, or the weights can give an indefinite covariance (`centre_gain`).
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
    weights = Weights(mean, covariance, np.sqrt(total) * np.vstack([np.zeros((1, n)), np.eye(n), -np.eye(n)]))
    if centre_gain(weights) < -1e-12:
        raise CraneError(
            f"sigma points: alpha = {alpha:g}, beta = {beta:g}, kappa = {kappa:g} weigh the centre point so negatively "
            "that the covariance may become indefinite. Raise beta, or use kappa = 0."
        )
    return weights


def cubature(n: int) -> Weights:
    """Return the weights of the third-degree spherical cubature rule: 2n points of weight 1/(2n), spread √n."""
    equal = np.full(2 * n, 0.5 / n)
    return Weights(equal, equal.copy(), np.sqrt(n) * np.vstack([np.eye(n), -np.eye(n)]))


def simplex(n: int, sign: float = 1.0) -> Weights:
    """Return the weights of the spherical simplex rule without its centre for `n` states: n + 1 points of equal weight
    w = 1/(n + 1).

    From dimension j - 1 to j, all corners so far move to -1/√(j (j + 1) w) along the new axis, and one more lies at
    j/√(j (j + 1) w). `sign` -1 gives the simplex mirrored in its middle.
    """
    w = 1.0 / (n + 1)
    corners = np.zeros((n + 1, n))
    for j in range(1, n + 1):
        corners[:j, j - 1] = -1.0 / np.sqrt(j * (j + 1) * w)
        corners[j, j - 1] = j / np.sqrt(j * (j + 1) * w)
    mean = np.full(n + 1, w)
    return Weights(mean, mean.copy(), sign * corners)


def centre_gain(weights: Weights) -> float:
    """Return 1 + W0c (1 - W0m)/W0m², which must not be negative for the covariance to be semidefinite.

    Why: Σ Wim (χi - x̂) = 0 makes the centre point's deviation d0 a combination of the others, d0 = -Σ Wi di / W0m.
    With the columns √Wi di in D and w = (√W1, √W2, …), |w|² = 1 - W0m, the covariance (29) is
    D (I + W0c/W0m² w wᵀ) Dᵀ. For κ = 0 and B = 0 the number is exactly 0, for every A: semidefinite, no more, no less.
    A covariance of (29) therefore never needs a downdate, although W0c is negative.
    """
    if weights.covariance[0] >= 0.0:
        return 1.0
    w0 = weights.mean[0]
    return float(1.0 + weights.covariance[0] * (1.0 - w0) / w0**2)


@njit()
def place(mean: np.ndarray, root: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return the sigma points (m, n) around `mean` (n,) with the lower root (n, n) of the covariance; `directions` (m,
    n) of `Weights`.
    """
    m, n = directions.shape
    points = np.empty((m, n))
    for k in range(m):
        for i in range(n):
            step = 0.0
            for j in range(i + 1):
                step += root[i, j] * directions[k, j]
            points[k, i] = mean[i] + step
    return points


@njit()
def drawn(mean, covariance, directions):  # type: ignore[no-untyped-def]
    """Return the sigma points (m, n) of a mean (n,) and a covariance (n, n), and whether that has no Cholesky
    factor.
    """
    root = np.empty_like(covariance)
    if cholesky(covariance, root) >= 0:
        return np.empty((0, mean.size)), True
    return place(mean, root, directions), False
