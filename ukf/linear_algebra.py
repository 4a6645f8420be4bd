"""Small dense factorisations, compiled: a filter step on 8 states costs microseconds, not the calls around it.

All matrices are C-contiguous float64. Cholesky factors and the triangular results of `lower_factor` are lower
triangular. Mixed units (rad² beside Pa²) do no harm here: Cholesky and Householder rows commute with a diagonal
scaling of the state, so conditioning is that of the correlation matrix.
"""

from __future__ import annotations

import numpy as np

from crane_exudyn.compiled import njit


@njit()
def cholesky(matrix: np.ndarray, root: np.ndarray) -> int:
    """Fill `root` (n, n) with the lower Cholesky factor of `matrix` (n, n); return -1, or the column that fails."""
    n = matrix.shape[0]
    for j in range(n):
        for i in range(j):
            root[i, j] = 0.0
        pivot = matrix[j, j]
        for k in range(j):
            pivot -= root[j, k] * root[j, k]
        if not pivot > 0.0:  # catches NaN as well
            return j
        root[j, j] = np.sqrt(pivot)
        for i in range(j + 1, n):
            total = matrix[i, j]
            for k in range(j):
                total -= root[i, k] * root[j, k]
            root[i, j] = total / root[j, j]
    return -1


@njit()
def all_finite(points: np.ndarray) -> bool:
    """Return whether no entry of `points` (m, n) is infinite or not a number."""
    for k in range(points.shape[0]):
        for i in range(points.shape[1]):
            if not np.isfinite(points[k, i]):
                return False
    return True


@njit()
def solve_lower(root: np.ndarray, rhs: np.ndarray) -> np.ndarray:
    """Return root⁻¹ rhs (n, m) for a lower triangular `root` (n, n)."""
    n, m = rhs.shape
    out = np.empty((n, m))
    for j in range(m):
        for i in range(n):
            total = rhs[i, j]
            for k in range(i):
                total -= root[i, k] * out[k, j]
            out[i, j] = total / root[i, i]
    return out


@njit()
def lower_factor(wide: np.ndarray) -> np.ndarray:
    """Return the lower triangular L (n, n), diagonal not negative, with L Lᵀ = wide wideᵀ; `wide` (n, m), m >= n.

    Householder reflections from the right, row by row (the LQ decomposition): no product wide wideᵀ is formed, so
    the result is a root of a positive semidefinite matrix whatever rounding does.
    """
    n, m = wide.shape
    a = wide.copy()
    v = np.empty(m)
    for i in range(n):
        norm2 = 0.0
        for k in range(i, m):
            norm2 += a[i, k] * a[i, k]
        if norm2 == 0.0:
            continue
        head = -np.sqrt(norm2) if a[i, i] > 0.0 else np.sqrt(norm2)
        for k in range(i, m):
            v[k] = a[i, k]
        v[i] -= head
        v2 = 2.0 * (norm2 - head * a[i, i])  # |v|², from the definition of v; positive by the choice of sign
        for r in range(i, n):
            dot = 0.0
            for k in range(i, m):
                dot += a[r, k] * v[k]
            dot *= 2.0 / v2
            for k in range(i, m):
                a[r, k] -= dot * v[k]
    out = np.zeros((n, n))
    for j in range(n):
        sign = -1.0 if a[j, j] < 0.0 else 1.0
        for i in range(j, n):
            out[i, j] = sign * a[i, j]
    return out


def semidefinite_root(matrix: np.ndarray) -> np.ndarray:
    """Return a root G (n, n) with G Gᵀ = `matrix` (n, n), symmetric and positive semidefinite.

    A process noise may leave states alone, and then has no Cholesky factor. Scaled to unit diagonal first, because rad²
    and Pa² differ by many powers of ten.

    Raises:
        ValueError: an eigenvalue of the scaled matrix is below -1e-9.
    """
    scale = np.sqrt(np.diag(matrix))
    safe = np.where(scale > 0, scale, 1.0)
    values, vectors = np.linalg.eigh(matrix / np.outer(safe, safe))
    if values.min(initial=0.0) < -1e-9:
        raise ValueError(f"noise covariance is not positive semidefinite: scaled eigenvalues {values}")
    return np.ascontiguousarray(safe[:, None] * vectors * np.sqrt(np.clip(values, 0.0, None)))
