"""Rauch-Tung-Striebel smoother from the cross-covariances that the sigma-point predictions leave behind.

With G = C_k+1 (P⁻_k+1)⁻¹, where C_k+1 is the covariance between the state at k and its prediction at k + 1::

    x_k|N = x_k|k + G (x_k+1|N - x⁻_k+1),    P_k|N = P_k|k + G (P_k+1|N - P⁻_k+1) Gᵀ

Särkkä, Unscented Rauch-Tung-Striebel smoother, IEEE Trans. Automatic Control 53 (2008).
"""

from __future__ import annotations

import numpy as np


def smooth(
    means: np.ndarray,
    covariances: np.ndarray,
    predicted_means: np.ndarray,
    predicted_covariances: np.ndarray,
    crosses: np.ndarray,
    *,
    gains: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]:
    """Return smoothed means (N, n) and covariances (N, n, n) from a filter's run.

    `predicted_means[k]` (N, n), `predicted_covariances[k]` and `crosses[k]` (N, n, n) belong to the step from k - 1
    to k; their first entries are not used. `gains` (N, n, n), where given, is filled with G of the steps from k to
    k + 1.
    """
    mean, covariance = means.copy(), covariances.copy()
    for k in range(len(means) - 2, -1, -1):
        gain = _gain(crosses[k + 1], predicted_covariances[k + 1])
        if gains is not None:
            gains[k] = gain
        mean[k] += gain @ (mean[k + 1] - predicted_means[k + 1])
        change = gain @ (covariance[k + 1] - predicted_covariances[k + 1]) @ gain.T
        covariance[k] += 0.5 * (change + change.T)
    return mean, covariance


def _gain(cross: np.ndarray, predicted: np.ndarray) -> np.ndarray:
    """Return C P⁻¹, solved with unit diagonal; states that are known exactly (zero variance) get no correction."""
    scale = np.sqrt(np.diag(predicted))
    known = scale == 0.0
    scale[known] = 1.0
    unit = predicted / np.outer(scale, scale)
    unit[known, known] = 1.0
    return np.linalg.solve(unit, (cross / scale).T).T / scale
