"""The beginning of a run gone through again, linearised where the machine is now known to have been.

A filter takes every slope where it believes the machine to be at that moment, and never again. Where much is unknown at
first (a payload between 0 and 400 kg, masses, joints) and the first estimates are far off, slopes of different places
are put together, and together they tell what no sensor has shown: the filter comes to believe too much. So all samples
since the start are taken anew from the same first belief. About a trajectory the model is affine, and its Kalman filter
and smoother are exact; the next pass linearises about the smoothed trajectory of the one before. That is Gauss-Newton's
method for the most probable trajectory, and its last belief is what the filter goes on from.

Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optimization 4 (1994).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .filter import Belief, Points, predict_linearised, update_linearised
from .methods import INCREMENT
from .smoother import smooth

#: share of the standard deviation of a constant from which on it is known much better
_KNOWN = 0.5
#: passes at most, and the change of the first state, in its standard deviations, at which they end
_PASSES, _SETTLED = 5, 0.1


@dataclass(frozen=True)
class Revisit:
    """For how long a run goes through its beginning again, s after the start, and on which engine: as of `Estimator`,
    None for the filter's own.
    """

    until: float
    engine: Any = None


@dataclass(frozen=True)
class Step:
    """One step of a run: how points go over it and the noise (n, n) of that; what sensors would show of points, what
    they showed (k,) and the variance (k, k) of their noise.
    """

    over: Points
    noise: np.ndarray
    observe: Points
    shown: np.ndarray
    variance: np.ndarray


class Beginning:
    """What a run has gone through since its start, to be gone through again whenever a constant is known twice as well
    as it was when slopes were taken last, and at the end.
    """

    def __init__(self, start: Belief, until: float, constants: Sequence[int]) -> None:
        """`start` is the first belief; `until` in s; `constants` are the states that do not change."""
        self._start, self._until, self._constants = start, until, constants
        self._steps: list[Step] = []
        self._trajectory = [start.mean]
        self._known = self._spread(start)
        self._last = False
        self.over = not constants

    def _spread(self, belief: Belief) -> np.ndarray:
        return np.sqrt(belief.covariance.diagonal()[self._constants])

    def end(self) -> None:
        """Go through nothing any more."""
        self.over, self._steps, self._trajectory = True, [], []

    def add(self, time: float, step: Step, belief: Belief) -> bool:
        """Note a step that led to a filter's belief at `time`; return whether all is to be gone through again."""
        self._steps.append(step)
        self._trajectory.append(belief.mean)
        self._last = time >= self._until
        return self._last or bool((self._spread(belief) < _KNOWN * self._known).any())

    def again(self, inside: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Belief:
        """Go through all steps until the smoothed trajectory stays where it is, and return the belief at its end.

        `inside` moves a mean (n,) with a covariance (n, n) to where it is physical.

        Raises:
            FilterError, ArithmeticError: a pass left what the model can do.
        """
        trajectory = np.array(self._trajectory)
        increments = INCREMENT * np.sqrt(np.diag(self._start.covariance))
        for _ in range(_PASSES):
            mean, covariance, end = _through(self._start, self._steps, trajectory, increments)
            before, trajectory = trajectory[0], np.array([*map(inside, mean, covariance)])
            if (np.abs(trajectory[0] - before) < _SETTLED * np.sqrt(np.diag(covariance[0]))).all():
                break
        self._trajectory, self._known = list(trajectory), self._spread(end)
        if self._last:
            self.end()
        return Belief(inside(end.mean, end.covariance), end.covariance)


def _through(
    start: Belief, steps: Sequence[Step], trajectory: np.ndarray, increments: np.ndarray
) -> tuple[np.ndarray, np.ndarray, Belief]:
    """Return the smoothed means (N, n) and covariances (N, n, n) and the last belief of the model made affine about a
    trajectory (N, n).
    """
    n = start.mean.size
    means, prior_means = np.empty((2, len(steps) + 1, n))
    covariances, prior_covariances, crosses = np.empty((3, len(steps) + 1, n, n))
    belief = start
    means[0], covariances[0] = start.mean, start.covariance
    for k, step in enumerate(steps, 1):
        about = Belief(belief.mean, belief.covariance, at=trajectory[k - 1])
        prior = predict_linearised(about, step.over, step.noise, increments)
        prior_means[k], prior_covariances[k], crosses[k] = prior.mean, prior.covariance, prior.cross
        belief = prior
        if step.shown.size:
            about = Belief(prior.mean, prior.covariance, at=trajectory[k])
            belief = update_linearised(about, step.observe, step.shown, step.variance, increments)
        means[k], covariances[k] = belief.mean, belief.covariance
    if not np.isfinite(means).all():
        raise ArithmeticError("the beginning, gone through again, is not finite")
    smoothed, spread = smooth(means, covariances, prior_means, prior_covariances, crosses)
    return smoothed, spread, belief
