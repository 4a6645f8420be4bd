"""Is a filter as good as it says? NIS, NEES, whiteness of the innovations, coverage of the intervals.

Bar-Shalom, Li, Kirubarajan, Estimation with Applications to Tracking and Navigation, 5.4. A consistent filter has
innovations that are white with the covariance it states (NIS), and errors with the covariance it states (NEES).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from scipy import stats

from crane_exudyn.crane import Crane
from crane_exudyn.recording import Recording

#: lags over which whiteness is judged; a series needs twice as many values
LAGS = 20


def nis(innovations: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Return νᵀ S⁻¹ ν (N,) from innovations (N, k) and their covariances (N, k, k): χ² with k degrees of freedom."""
    return np.einsum("ni,ni->n", innovations, np.linalg.solve(covariances, innovations[..., None])[..., 0])


def nees(errors: np.ndarray, covariances: np.ndarray) -> np.ndarray:
    """Return eᵀ P⁻¹ e (N,) from errors (N, n) and covariances (N, n, n), scaled to unit diagonal before solving."""
    scale = np.sqrt(np.einsum("nii->ni", covariances))
    unit = covariances / (scale[:, :, None] * scale[:, None, :])
    return nis(errors / scale, unit)


def log_likelihood(innovation: np.ndarray, variance: np.ndarray) -> float:
    """Return the log-likelihood of independent normal innovations (k,) of zero mean with these variances (k,)."""
    return float(-0.5 * np.sum(innovation**2 / variance + np.log(2.0 * np.pi * variance)))


def mean_bounds(degrees: float, count: float, probability: float = 0.95) -> tuple[float, float]:
    """Return the interval that holds the mean of `count` independent χ²(degrees) values with this probability."""
    low, high = stats.chi2.ppf([0.5 - probability / 2, 0.5 + probability / 2], degrees * count)
    return float(low / count), float(high / count)


def noise_slack(crane: Crane, recording: Recording, names: Iterable[str]) -> float:
    """Return the standard deviation of the mean NIS that comes from sensor noise estimated from the recording; 0 where
    the crane file says all.

    From n samples it is known to 1.3/√n (`crane_exudyn.signals.noise_std`), and each sensor adds its innovation squared
    over its variance, which is off by twice as much.
    """
    return float(2.0 * 1.3 * np.sqrt(sum(1.0 / len(recording[n]) for n in names if n not in crane.sensors)))


def coverage(errors: np.ndarray, std: np.ndarray, probability: float = 0.95) -> np.ndarray:
    """Return the share of samples (n,) inside the interval ±z·std; errors and std are (N, n), NaN rows left out."""
    inside = np.abs(errors) <= stats.norm.ppf(0.5 + probability / 2) * std
    known = np.isfinite(errors) & np.isfinite(std)
    return (inside & known).sum(axis=0) / np.maximum(known.sum(axis=0), 1)


def autocorrelation(series: np.ndarray, lags: int) -> np.ndarray:
    """Return the autocorrelation (lags,) of a series (N,) at lags 1 … lags, its mean taken as known zero.

    Innovations of a right filter have zero mean; subtracting the sample mean would hide a bias.
    """
    energy = float(series @ series)
    if energy == 0.0:
        return np.zeros(lags)
    return np.array([float(series[k:] @ series[:-k]) / energy for k in range(1, lags + 1)])


def persistence(series: np.ndarray, lags: int = LAGS) -> float:
    """Return Σ r_k over the first lags of a series (N,): positive where it keeps its sign for a while, 0 for white
    noise.

    A model that lacks something makes innovations that persist; process noise that is too large, ones that swing back.
    """
    values = np.asarray(series, float)
    values = values[np.isfinite(values)]
    return float(autocorrelation(values, lags).sum()) if values.size >= 2 * lags else 0.0


def ljung_box(series: np.ndarray, lags: int = LAGS) -> float:
    """Return the p-value of whiteness of a series (N,) by Ljung and Box; NaN with fewer than 2·lags values.

    Q = N (N + 2) Σ r_k²/(N - k) is χ²(lags) for white noise of zero mean.
    """
    values = np.asarray(series, float)
    values = values[np.isfinite(values)]
    n = values.size
    if n < 2 * lags:
        return float("nan")
    r = autocorrelation(values, lags)
    statistic = n * (n + 2) * np.sum(r**2 / (n - np.arange(1, lags + 1)))
    return float(stats.chi2.sf(statistic, lags))
