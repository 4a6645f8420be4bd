"""How far an estimate is from the truth, in numbers that can be compared between quantities."""

from __future__ import annotations

import numpy as np

from ukf.consistency import nees as _nees


def rmse(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the root mean square error (n,) of estimates (N, n); NaN samples are left out."""
    return np.asarray(np.sqrt(np.nanmean((estimate - truth) ** 2, axis=0)))


def pn_rmse(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the paper's percent normalised RMSE (n,): 100 RMSE/(max - min of the truth); NaN for a constant truth."""
    span = np.nanmax(truth, axis=0) - np.nanmin(truth, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(span > 0, 100.0 * rmse(estimate, truth) / span, np.nan)


def r2(estimate: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Return the coefficient of determination (n,): 1 - residual variance over variance of the truth."""
    left = np.nansum((truth - estimate) ** 2, axis=0)
    total = np.nansum((truth - np.nanmean(truth, axis=0)) ** 2, axis=0)
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(total > 0, 1.0 - left / total, np.nan)


def nees(estimate: np.ndarray, truth: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Return the normalised estimation error squared (N,) of the first m states; truth is (N, m)."""
    m = truth.shape[1]
    return _nees(estimate[:, :m] - truth, covariance[:, :m, :m])
