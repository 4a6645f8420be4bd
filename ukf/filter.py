"""Kalman filters (27)-(31) as plain functions: predict and update take a belief and return a new one.

`propagate` is a function from points (m, n) to points (m, n), one time step on; `observe` one from points (m, n) to
predicted measurements (m, k). Both see all sigma points at once, and no function here keeps any state.

    UKF, CKF, ...   predict, update              weights: `sigma_points.merwe`, `cubature` or `simplex`
    square root     predict_root, update_root    the same numbers, the root of the covariance instead of it
    EKF             predict_linearised, update_linearised

Sigma points are drawn anew after the prediction, so the process noise reaches the predicted measurements; the paper
does so, and filterpy 2 (filterpy 1 does not).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from crane_exudyn.compiled import njit

from .linear_algebra import cholesky, lower_factor, solve_lower
from .sigma_points import Weights, centre_gain, drawn, place

Points = Callable[[np.ndarray], np.ndarray]


class FilterError(ArithmeticError):
    """A covariance that is not positive definite, with the step and its eigenvalues (scaled to unit diagonal)."""

    def __init__(self, what: str, matrix: np.ndarray, step: int | None) -> None:
        """`matrix` (n, n) is the offending covariance; `step` the number of the filter step, if it has one."""
        self.step = step
        self.eigenvalues = scaled_eigenvalues(matrix)
        place_ = "" if step is None else f" at step {step}"
        listed = np.array2string(self.eigenvalues, precision=3)
        super().__init__(
            f"{what}{place_} is not positive definite: eigenvalues of the matrix scaled to unit diagonal {listed}. "
            "Check the noise covariances, or use the square-root filter."
        )


def scaled_eigenvalues(matrix: np.ndarray) -> np.ndarray:
    """Return the ascending eigenvalues (n,) of `matrix` (n, n) scaled to unit diagonal, NaN if it is not finite."""
    if not np.isfinite(matrix).all():
        return np.full(len(matrix), np.nan)
    scale = np.sqrt(np.abs(np.diag(matrix)))
    scale[scale == 0] = 1.0
    return np.linalg.eigvalsh(matrix / np.outer(scale, scale))


@dataclass(frozen=True, slots=True)
class Belief:
    """A Gaussian belief: `mean` (n,) and `covariance` (n, n); `at` (n,) is where slopes are taken, None for the
    mean.
    """

    mean: np.ndarray
    covariance: np.ndarray
    at: np.ndarray | None = field(default=None, kw_only=True)


@dataclass(frozen=True, slots=True)
class Prediction(Belief):
    """A belief one step on; `cross` (n, n) is the covariance between the state before and after, for the smoother."""

    cross: np.ndarray


@dataclass(frozen=True, slots=True)
class Correction(Belief):
    """A belief after k measurements, with the innovation (k,), its covariance (k, k), NIS and log-likelihood."""

    innovation: np.ndarray
    innovation_covariance: np.ndarray
    nis: float
    log_likelihood: float


@dataclass(frozen=True, slots=True)
class RootBelief:
    """A Gaussian belief by the lower triangular `root` (n, n) of its covariance."""

    mean: np.ndarray
    root: np.ndarray

    @property
    def covariance(self) -> np.ndarray:
        """The covariance (n, n)."""
        return self.root @ self.root.T


@dataclass(frozen=True, slots=True)
class RootPrediction(RootBelief):
    """As `Prediction`, in square-root form."""

    cross: np.ndarray


@dataclass(frozen=True, slots=True)
class RootCorrection(RootBelief):
    """As `Correction`, in square-root form."""

    innovation: np.ndarray
    innovation_covariance: np.ndarray
    nis: float
    log_likelihood: float


def draw(belief: Belief, weights: Weights, *, step: int | None = None) -> np.ndarray:
    """Return the sigma points (m, n) of a belief, (27).

    Raises:
        FilterError: the covariance has no Cholesky factor.
    """
    points: np.ndarray
    points, failed = drawn(belief.mean, belief.covariance, weights.directions)
    if failed:
        raise FilterError("state covariance", belief.covariance, step)
    return points


def root_of(belief: Belief, *, step: int | None = None) -> RootBelief:
    """Return the square-root form of a belief. Raises FilterError if the covariance is not positive definite."""
    root = np.empty_like(belief.covariance)
    if cholesky(belief.covariance, root) >= 0:
        raise FilterError("state covariance", belief.covariance, step)
    return RootBelief(belief.mean, root)


def predict(
    belief: Belief, propagate: Points, noise: np.ndarray, weights: Weights, *, step: int | None = None
) -> Prediction:
    """Return the belief one step on, (28) and (29); `noise` (n, n) is Rw. Raises FilterError as `draw` does."""
    before = draw(belief, weights, step=step)
    after = propagate(before)
    _check_points(after, before.shape)
    return Prediction(*_moments(before, belief.mean, after, weights.mean, weights.covariance, noise))


def update(
    belief: Belief,
    observe: Points,
    measurement: np.ndarray,
    noise: np.ndarray,
    weights: Weights,
    *,
    step: int | None = None,
) -> Correction:
    """Return the belief corrected by `measurement` (k,), (30) and (31), with sigma points drawn anew.

    `noise` (k, k) is Rv. Missing measurements are left out by the caller, with their rows of `observe` and `noise`.

    Raises:
        FilterError: the state covariance or the innovation covariance has no Cholesky factor.
    """
    points = draw(belief, weights, step=step)
    seen = observe(points)
    _check_points(seen, (weights.count, measurement.size))
    result = _correct(
        belief.mean, belief.covariance, points, seen, weights.mean, weights.covariance, measurement, noise
    )
    mean, covariance, innovation, spread, nis, log_likelihood, failed = result
    if failed:
        raise FilterError("innovation covariance", spread, step)
    return Correction(mean, covariance, innovation, spread, nis, log_likelihood)


def predict_root(belief: RootBelief, propagate: Points, noise_root: np.ndarray, weights: Weights) -> RootPrediction:
    """Return the belief one step on, (28) and (29), by one orthogonal factorisation; `noise_root` (n, q).

    The negative weight of the centre point needs no downdate: see `sigma_points.centre_gain`.
    """
    before = place(belief.mean, belief.root, weights.directions)
    after = propagate(before)
    _check_points(after, before.shape)
    gain = centre_gain(weights)
    return RootPrediction(
        *_root_moments(before, belief.mean, after, weights.mean, weights.covariance, gain, noise_root)
    )


def update_root(
    belief: RootBelief, observe: Points, measurement: np.ndarray, noise_root: np.ndarray, weights: Weights
) -> RootCorrection:
    """Return the belief corrected by `measurement` (k,) in square-root form, (30) and (31); `noise_root` (k, k).

    One factorisation of [[Rv^½, Y], [0, X]] gives the root of Py, the gain and the new root together; nothing is
    subtracted, so nothing can become indefinite. Here X, Y are the weighted deviations of states and measurements.
    """
    points = place(belief.mean, belief.root, weights.directions)
    seen = observe(points)
    _check_points(seen, (weights.count, measurement.size))
    gain = centre_gain(weights)
    return RootCorrection(
        *_root_correct(belief.mean, points, seen, weights.mean, weights.covariance, gain, measurement, noise_root)
    )


def predict_linearised(belief: Belief, propagate: Points, noise: np.ndarray, increments: np.ndarray) -> Prediction:
    """Return the EKF's belief one step on: x = f(at) + F (x - at), P = F P Fᵀ + Q, F by differences in one batch.

    `increments` (n,) are the finite-difference steps in state units. Where `at` is given, the prediction's is f(at).
    """
    at = belief.mean if belief.at is None else belief.at
    after, jacobian = linearise(propagate, at, increments)
    spread = jacobian @ belief.covariance
    mean = after + jacobian @ (belief.mean - at)
    return Prediction(
        mean,
        _symmetric(spread @ jacobian.T + noise),
        np.ascontiguousarray(spread.T),
        at=None if belief.at is None else after,
    )


def update_linearised(
    belief: Belief,
    observe: Points,
    measurement: np.ndarray,
    noise: np.ndarray,
    increments: np.ndarray,
    *,
    step: int | None = None,
) -> Correction:
    """Return the EKF's belief corrected by `measurement` (k,); H by differences. Raises FilterError."""
    at = belief.mean if belief.at is None else belief.at
    predicted, jacobian = linearise(observe, at, increments)
    innovation = measurement - predicted - jacobian @ (belief.mean - at)
    return update_linear(belief, jacobian, innovation, noise, step=step)


def update_linear(
    belief: Belief, jacobian: np.ndarray, innovation: np.ndarray, noise: np.ndarray, *, step: int | None = None
) -> Correction:
    """Return the Kalman correction by an `innovation` (k,) whose sensitivity to the state is `jacobian` (k, n)."""
    result = _linear_correct(belief.mean, belief.covariance, jacobian, innovation, noise)
    mean, covariance, spread, nis, log_likelihood, failed = result
    if failed:
        raise FilterError("innovation covariance", spread, step)
    return Correction(mean, covariance, innovation, spread, nis, log_likelihood, at=belief.at)


def linearise(function: Points, at: np.ndarray, increments: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return f(x) (k,) and its Jacobian (k, n) by forward differences, all n + 1 points in one call."""
    points = at[None].repeat(at.size + 1, 0)
    points[1:].reshape(-1)[:: at.size + 1] += increments  # the diagonal
    values = function(points)
    return values[0], np.ascontiguousarray(((values[1:] - values[0]) / increments[:, None]).T)


def _check_points(points: np.ndarray, shape: tuple[int, ...]) -> None:
    """Raise ValueError for points of a wrong shape, at which compiled code does not look."""
    if points.shape != shape:
        raise ValueError(f"a model function returned points of shape {points.shape}; expected {shape}")


def _symmetric(matrix: np.ndarray) -> np.ndarray:
    return 0.5 * (matrix + matrix.T)


@njit()
def _weighted_mean(points, weights):  # type: ignore[no-untyped-def]
    """Return Σ Wi χi as χ0 + Σ Wi (χi - χ0): large values do not cancel."""
    m, n = points.shape
    mean = np.zeros(n)
    for k in range(m):
        for i in range(n):
            mean[i] += weights[k] * (points[k, i] - points[0, i])
    for i in range(n):
        mean[i] += points[0, i]
    return mean


@njit()
def _add_products(left, right, weights, out):  # type: ignore[no-untyped-def]
    """Add Σ Wk left_k right_kᵀ to `out`; rows of `left` (m, n) and `right` (m, p) are deviations."""
    m, n = left.shape
    p = right.shape[1]
    for k in range(m):
        for i in range(n):
            factor = weights[k] * left[k, i]
            for j in range(p):
                out[i, j] += factor * right[k, j]


@njit()
def _moments(before, mean_before, after, weights_mean, weights_covariance, noise):  # type: ignore[no-untyped-def]
    mean = _weighted_mean(after, weights_mean)
    deviations = after - mean
    covariance = noise.copy()
    _add_products(deviations, deviations, weights_covariance, covariance)
    cross = np.zeros_like(covariance)
    _add_products(before - mean_before, deviations, weights_covariance, cross)
    return mean, covariance, cross


@njit()
def _correct(mean, covariance, points, seen, weights_mean, weights_covariance, measurement, noise):  # type: ignore[no-untyped-def]
    predicted = _weighted_mean(seen, weights_mean)
    deviations = seen - predicted
    spread = noise.copy()
    _add_products(deviations, deviations, weights_covariance, spread)
    cross = np.zeros((mean.size, predicted.size))
    _add_products(points - mean, deviations, weights_covariance, cross)
    innovation = measurement - predicted
    new, less, nis, log_likelihood, failed = _gain(mean, covariance, cross, spread, innovation)
    return new, less, innovation, spread, nis, log_likelihood, failed


@njit()
def _linear_correct(mean, covariance, jacobian, innovation, noise):  # type: ignore[no-untyped-def]
    cross = covariance @ jacobian.T
    spread = jacobian @ cross + noise
    new, less, nis, log_likelihood, failed = _gain(mean, covariance, cross, spread, innovation)
    return new, less, spread, nis, log_likelihood, failed


@njit()
def _gain(mean, covariance, cross, spread, innovation):  # type: ignore[no-untyped-def]
    """Return mean + K ν and P - K Py Kᵀ by the Cholesky factor of Py, with NIS and log-likelihood, (31)."""
    k = innovation.size
    root = np.empty((k, k))
    if cholesky(spread, root) >= 0:
        return mean, covariance, np.nan, np.nan, True
    half = solve_lower(root, cross.T.copy())  # (k, n): K Py Kᵀ = halfᵀ half, symmetric to the last bit
    white = solve_lower(root, innovation.copy().reshape(k, 1))
    new, less = mean.copy(), covariance.copy()
    nis, log_likelihood = 0.0, -0.5 * k * np.log(2 * np.pi)
    for r in range(k):
        nis += white[r, 0] ** 2
        log_likelihood -= np.log(root[r, r])
        for i in range(mean.size):
            new[i] += half[r, i] * white[r, 0]
            for j in range(mean.size):
                less[i, j] -= half[r, i] * half[r, j]
    return new, less, nis, log_likelihood - 0.5 * nis, False


@njit()
def _weighted_deviations(points, mean, weights_mean, weights_covariance, gain):  # type: ignore[no-untyped-def]
    """Return D (n, 2n or 2n + 1) with D Dᵀ = Σ Wic di diᵀ, also for a negative centre weight (`centre_gain`)."""
    m, n = points.shape
    first = 1 if weights_covariance[0] < 0.0 else 0
    out = np.empty((n, m - first))
    for k in range(first, m):
        for i in range(n):
            out[i, k - first] = np.sqrt(weights_covariance[k]) * (points[k, i] - mean[i])
    if first == 1:
        # D (I - c ŵ ŵᵀ) with c = 1 - √gain is a root of D (I + (gain - 1) ŵ ŵᵀ) Dᵀ
        total = 1.0 - weights_mean[0]
        for i in range(n):
            along = 0.0
            for k in range(1, m):
                along += out[i, k - 1] * np.sqrt(weights_mean[k])
            along *= (1.0 - np.sqrt(max(gain, 0.0))) / total
            for k in range(1, m):
                out[i, k - 1] -= along * np.sqrt(weights_mean[k])
    return out


@njit()
def _root_moments(before, mean_before, after, weights_mean, weights_covariance, gain, noise_root):  # type: ignore[no-untyped-def]
    mean = _weighted_mean(after, weights_mean)
    wide = np.hstack((_weighted_deviations(after, mean, weights_mean, weights_covariance, gain), noise_root))
    cross = np.zeros((mean.size, mean.size))
    _add_products(before - mean_before, after - mean, weights_covariance, cross)
    return mean, lower_factor(wide), cross


@njit()
def _root_correct(mean, points, seen, weights_mean, weights_covariance, gain, measurement, noise_root):  # type: ignore[no-untyped-def]
    predicted = _weighted_mean(seen, weights_mean)
    k, n = predicted.size, mean.size
    joint = np.hstack((seen, points))
    centre = np.concatenate((predicted, mean))
    # The drawn states repeat the root exactly, so their centre deviation is zero; the measurements' need not be.
    columns = _weighted_deviations(joint, centre, weights_mean, weights_covariance, gain)
    wide = np.zeros((k + n, k + columns.shape[1]))
    wide[:k, :k] = noise_root
    wide[:, k:] = columns
    lower = lower_factor(wide)
    root = np.ascontiguousarray(lower[:k, :k])
    innovation = measurement - predicted
    white = solve_lower(root, innovation.copy().reshape(k, 1))
    new = mean + (lower[k:, :k].copy() @ white)[:, 0]
    nis, log_likelihood = 0.0, -0.5 * k * np.log(2 * np.pi)
    for r in range(k):
        nis += white[r, 0] ** 2
        log_likelihood -= np.log(root[r, r])
    return new, np.ascontiguousarray(lower[k:, k:]), innovation, root @ root.T, nis, log_likelihood - 0.5 * nis
