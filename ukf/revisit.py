"""The beginning of a run gone through again, linearised where the machine is now known to have been.

A filter takes every slope where it believes the machine to be at that moment, and never again. Where much is unknown at
first (a payload between 0 and 400 kg, masses, joints) and the first estimates are far off, slopes of different places
are put together, and together they tell what no sensor has shown: the filter comes to believe too much. So all samples
since the start are taken anew from the same first belief. About a trajectory the model is affine, and its Kalman filter
and smoother are exact; the next pass linearises where the smoothed trajectory of the one before says. That is
Gauss-Newton's method for the most probable trajectory, and its last belief is what the filter goes on from.

Slopes are those of a trajectory that the model itself can go: it begins where the smoothed one does, and takes up the
states of that only where they are further off than filters allow (`methods.leashed`). The smoothed trajectory is none:
process noise moves it, and limits cut it off. Slopes along it tell of constants what no motion of the machine has.

Bell, The iterated Kalman smoother as a Gauss-Newton method, SIAM J. Optimization 4 (1994).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .filter import Belief, Points, predict_linearised, update_linearised
from .methods import INCREMENT, leashed
from .smoother import smooth

#: share of the standard deviation of a constant from which on it is known much better
_KNOWN = 0.5
#: passes at most, and the change of the first state, in its standard deviations, at which they end
_PASSES, _SETTLED = 12, 0.1
#: share of the change before above which passes go half of the way only, as they else may go to and fro
_FALLING = 0.5


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
    as it was when slopes were taken last, when the run is twice as long as it was then, and at the end.

    Attributes:
        over: nothing is to be gone through any more.
        settled: the last time it was gone through, the trajectory stayed where it was before the passes were up.
    """

    def __init__(self, start: Belief, until: float, constants: Sequence[int]) -> None:
        """`start` is the first belief; `until` in s; `constants` are the states that do not change."""
        self._start, self._until, self._constants = start, until, list(constants)
        self._steps: list[Step] = []
        self._means, self._spreads = [start.mean], [_spread(start)]
        self._known = self._spreads[0][self._constants]
        self._due: float = np.inf
        self._last = False
        self.over, self.settled = not constants, True

    def end(self) -> None:
        """Go through nothing any more."""
        self.over, self._steps, self._means, self._spreads = True, [], [], []

    def add(self, time: float, step: Step, belief: Belief) -> bool:
        """Note a step that led to a filter's belief at `time`; return whether all is to be gone through again."""
        spread = _spread(belief)
        self._steps.append(step)
        self._means.append(belief.mean)
        self._spreads.append(spread)
        self._last = time >= self._until
        due = len(self._steps) >= self._due
        return self._last or due or bool((spread[self._constants] < _KNOWN * self._known).any())

    def again(self, inside: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Belief:
        """Go through all steps until the smoothed trajectory stays where it is, and return the belief at its end, with
        where the model's own trajectory ends.

        `inside` moves a mean (n,) with a covariance (n, n) to where it is physical.

        Raises:
            FilterError, ArithmeticError: a pass left what the model can do.
        """
        means, spreads = np.array(self._means), np.array(self._spreads)
        increments = INCREMENT * _spread(self._start)
        change = np.inf
        for _ in range(_PASSES):
            mean, covariance, end = self._through(means, spreads, increments)
            found, spreads = np.array([*map(inside, mean, covariance)]), np.sqrt(covariance.diagonal(0, 1, 2))
            before, change = change, float((np.abs(found[0] - means[0]) / spreads[0]).max())
            means = found if change < _FALLING * before else 0.5 * (means + found)
            if change < _SETTLED:
                break
        self.settled = change < _SETTLED
        self._means, self._spreads = list(means), list(spreads)
        self._known, self._due = _spread(end)[self._constants], 2 * len(self._steps)
        if self._last:
            self.end()
        return Belief(inside(end.mean, end.covariance), end.covariance, at=end.at)

    def _through(
        self, near: np.ndarray, spreads: np.ndarray, increments: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, Belief]:
        """Return the smoothed means (N, n) and covariances (N, n, n) and the last belief of the model made affine about
        its own trajectory from near[0], which stays near a trajectory (N, n) with its standard deviations (N, n).
        """
        steps, belief, at = self._steps, self._start, near[0]
        n = at.size
        means, prior_means = np.empty((2, len(steps) + 1, n))
        covariances, prior_covariances, crosses = np.empty((3, len(steps) + 1, n, n))
        means[0], covariances[0] = belief.mean, belief.covariance
        for k, step in enumerate(steps, 1):
            prior = predict_linearised(Belief(belief.mean, belief.covariance, at=at), step.over, step.noise, increments)
            prior_means[k], prior_covariances[k], crosses[k] = prior.mean, prior.covariance, prior.cross
            assert prior.at is not None
            at = leashed(prior.at, near[k], spreads[k], self._constants)
            belief = prior
            if step.shown.size:
                about = Belief(prior.mean, prior.covariance, at=at)
                belief = update_linearised(about, step.observe, step.shown, step.variance, increments)
            means[k], covariances[k] = belief.mean, belief.covariance
        if not np.isfinite(means).all():
            raise ArithmeticError("the repeated beginning is not finite")
        smoothed, covariance = smooth(means, covariances, prior_means, prior_covariances, crosses)
        return smoothed, covariance, Belief(belief.mean, belief.covariance, at=at)


def _spread(belief: Belief) -> np.ndarray:
    return np.sqrt(belief.covariance.diagonal())
