"""The filters by name, behind one pair of calls: predict(belief, …) and update(belief, …)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from crane_exudyn.errors import CraneError, nearest

from . import filter as kf
from .linear_algebra import semidefinite_root
from .sigma_points import ALPHA, Weights, cubature, merwe, simplex

#: standard deviations of the mean from the trajectory about which a filter is linearised, at most
_LEASH = 3.0
#: step of the EKF's slopes in standard deviations of the first belief: far above the engines' solver tolerance, far
#: below any curvature
INCREMENT = 1e-3
#: steps after which the simplex is mirrored: in between, its points hardly move, and engines keep what stays the same
_TURN = 8
METHODS = ("ukf", "sr-ukf", "ckf", "simplex", "ekf")


class Method(Protocol):
    """One filter: `begin` makes its kind of belief, `predict` and `update` return new ones."""

    def begin(self, mean: np.ndarray, covariance: np.ndarray) -> Any:
        """Return the belief to start with, of mean (n,) and covariance (n, n)."""
        ...

    def predict(self, belief: Any, propagate: kf.Points, noise: np.ndarray, step: int) -> Any:
        """Return the belief one step on: points (m, n) go over by `propagate`, `noise` (n, n) is added; `step` counts.

        Raises:
            FilterError: the covariance has no Cholesky factor.
        """
        ...

    def update(self, belief: Any, observe: kf.Points, y: np.ndarray, noise: np.ndarray, step: int) -> Any:
        """Return the belief corrected by measurements `y` (k,), whose noise has the covariance `noise` (k, k);
        `observe` tells what sensors show (m, k) of points (m, n). Raises FilterError as `predict` does.
        """
        ...


@dataclass(frozen=True)
class SigmaPoints:
    """UKF, CKF or simplex, by the weights, which take turns from step to step."""

    weights: tuple[Weights, ...]

    def begin(self, mean: np.ndarray, covariance: np.ndarray) -> kf.Belief:
        """Return the belief to start with."""
        return kf.Belief(mean, covariance)

    def predict(self, belief: kf.Belief, propagate: kf.Points, noise: np.ndarray, step: int) -> kf.Prediction:
        """Return (28), (29)."""
        return kf.predict(belief, propagate, noise, self.weights[step % len(self.weights)], step=step)

    def update(
        self, belief: kf.Belief, observe: kf.Points, y: np.ndarray, noise: np.ndarray, step: int
    ) -> kf.Correction:
        """Return (30), (31)."""
        return kf.update(belief, observe, y, noise, self.weights[step % len(self.weights)], step=step)


class SquareRoot:
    """The square-root UKF."""

    def __init__(self, weights: Weights) -> None:
        """Keep the roots of process noises that were met, because there are few different steps."""
        self.weights = weights
        self._roots: dict[bytes, np.ndarray] = {}

    def begin(self, mean: np.ndarray, covariance: np.ndarray) -> kf.RootBelief:
        """Return the belief to start with."""
        return kf.root_of(kf.Belief(mean, covariance))

    def predict(self, belief: kf.RootBelief, propagate: kf.Points, noise: np.ndarray, step: int) -> kf.RootPrediction:
        """Return (28), (29) in square-root form."""
        key = noise.tobytes()
        if key not in self._roots:
            if len(self._roots) > 100:
                self._roots.clear()
            self._roots[key] = semidefinite_root(noise)
        return kf.predict_root(belief, propagate, self._roots[key], self.weights)

    def update(
        self, belief: kf.RootBelief, observe: kf.Points, y: np.ndarray, noise: np.ndarray, step: int
    ) -> kf.RootCorrection:
        """Return (30), (31) in square-root form; `noise` (k, k) is diagonal."""
        return kf.update_root(belief, observe, y, np.sqrt(noise), self.weights)


@dataclass(frozen=True)
class Linearised:
    """EKF with Jacobians from differences; `increments` (n,) in state units.

    With `constants`, states that do not change, slopes are taken along a trajectory of the model instead of at the
    mean: it begins where the belief was set up, keeps its constants, and takes up the mean of the other states when
    that is further off than `_LEASH`. Slopes that follow every estimate tell in sum what no sensor has shown (Huang,
    Mourikis and Roumeliotis, A first-estimates Jacobian EKF for improving SLAM consistency, ISER 2008).
    """

    increments: np.ndarray
    constants: Sequence[int] = ()

    def begin(self, mean: np.ndarray, covariance: np.ndarray) -> kf.Belief:
        """Return the belief to start with."""
        return kf.Belief(mean, covariance, at=mean if len(self.constants) else None)

    def predict(self, belief: kf.Belief, propagate: kf.Points, noise: np.ndarray, step: int) -> kf.Prediction:
        """Return the linearised prediction."""
        return kf.predict_linearised(belief, propagate, noise, self.increments)

    def update(
        self, belief: kf.Belief, observe: kf.Points, y: np.ndarray, noise: np.ndarray, step: int
    ) -> kf.Correction:
        """Return the linearised correction."""
        found = kf.update_linearised(belief, observe, y, noise, self.increments, step=step)
        if found.at is None:
            return found
        spread = np.sqrt(found.covariance.diagonal())
        return replace(found, at=leashed(found.at, found.mean, spread, self.constants))


def leashed(at: np.ndarray, mean: np.ndarray, spread: np.ndarray, constants: Sequence[int]) -> np.ndarray:
    """Return where slopes are taken (n,): at the model's own trajectory `at`, or, where a state of that is further than
    `_LEASH` standard deviations `spread` from `mean`, at the mean with the trajectory's constants.
    """
    away = np.abs(mean - at) > _LEASH * spread
    away[constants] = False
    if not away.any():
        return at
    near = mean.copy()
    near[constants] = at[constants]
    return near


def method_of(name: str, std: np.ndarray, constants: Sequence[int] = (), near: bool = False) -> Method:
    """Return the filter called `name` for states whose standard deviations at the start are `std` (n,); `constants`
    as in `Linearised`.

    `near` keeps the points of the UKF within √3 standard deviations, where they also have a normal distribution's
    fourth moment along each axis; else they lie 0.99 √n out, as the paper has them.

    Raises:
        CraneError: no such filter.
    """
    alpha = min(ALPHA, np.sqrt(3.0 / std.size)) if near else ALPHA
    if name == "ukf":
        return SigmaPoints((merwe(std.size, alpha),))
    if name == "ckf":
        return SigmaPoints((cubature(std.size),))
    if name == "simplex":
        # what third moments do to the mean takes turns
        return SigmaPoints((simplex(std.size),) * _TURN + (simplex(std.size, -1.0),) * _TURN)
    if name == "sr-ukf":
        return SquareRoot(merwe(std.size, alpha))
    if name == "ekf":
        return Linearised(INCREMENT * std, constants)
    raise CraneError(f"There is no filter {name!r}.{nearest(name, list(METHODS))}")
