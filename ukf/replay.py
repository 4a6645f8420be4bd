"""What the likelihood of a run would have been with other noise, without the engine.

A run of the filter leaves, for every step, how the state before goes over into the state after: of the covariance P
before and the cross-covariance C = cov(before, after) follows F = Cᵀ P⁻¹, the regression that the sigma points
themselves make. Around the trajectory of that run the filter is an exact linear Kalman filter in F and in the slope H
of the sensors, so that the likelihood of the innovations under other noise, and other sizes and starts of what fades,
costs some ten microseconds a step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from crane_exudyn.compiled import njit

from .augment import Augment, Extra
from .estimator import Estimator
from .monitor import USED
from .noise import ProcessNoise

#: step of the sensors' slope, in standard deviations of the state
_SLOPE = 0.1


class _Steps(NamedTuple):
    """N steps of a run, a row each: how the state goes over, what the sensors see, and what the varied states do.

    Attributes:
        transition: (N, n, n); slope: (N, k, n) of the sensors; innovation: (N, k), NaN where there is none.
        which: (N,) number of the step's noise.
        kept, added: (N, varied) share of a varied state's deviation that is left, and the variance that comes to it.
        offset: (N, n) by which the reference goes elsewhere than the state would.
    """

    transition: np.ndarray
    slope: np.ndarray
    innovation: np.ndarray
    which: np.ndarray
    kept: np.ndarray
    added: np.ndarray
    offset: np.ndarray


class Replay:
    """A run of an estimator over a recording, to be repeated with other noise and other sizes of its last extra
    states.
    """

    def __init__(self, estimator: Estimator, recording: Any, varied: Sequence[Extra]) -> None:
        """`varied` are the last extra states of the estimator; raises CraneError as its `run` does."""
        self._varied, self._first = tuple(varied), estimator.size - len(varied)
        recorder, plan = estimator.recorded(recording, smooth=True)
        self._dt = np.diff(plan.time)
        mean, prior = recorder.mean, recorder.prior_mean
        self._transition = _transitions(recorder.covariance, recorder.cross)
        cuts = np.flatnonzero(~recorder.cross[1:].any(axis=(1, 2)))  # steps at which the filter began anew
        self._stretches = list(zip([0, *(cuts + 1)], [*cuts, len(self._dt)], strict=True))
        self._prior_covariance = recorder.prior_covariance
        seen = estimator.observe(prior[1:], plan.values[1:])
        self._slope = _slopes(estimator, recorder, plan.values[1:])
        self._innovation = np.where(recorder.flags[1:] == USED, plan.values[1:] - seen, np.nan)
        self._variance = estimator.sensor_variance
        self.used = int(np.isfinite(self._innovation).sum())
        # the reference goes over from its corrected mean to its prior; the replay's state is a deviation from the prior
        self._moved = prior - mean
        self._offset = np.zeros_like(mean[1:])
        self._offset[1:] = np.einsum("kij,kj->ki", self._transition[1:], self._moved[1:-1])
        nominal = np.array([e.value for e in varied])
        self._before, self._after = mean[:-1, self._first :] - nominal, prior[1:, self._first :] - nominal
        #: the reference may begin elsewhere than what is expected
        self._begin = np.zeros(estimator.size)
        self._begin[self._first :] = [e.value - e.begins for e in varied]
        #: mean of the varied states at the end of the run
        self.ended = mean[-1, self._first :].copy()
        self._others = estimator.extras[: len(estimator.extras) - len(varied)]

    def log_likelihood(self, noise: ProcessNoise, varied: Sequence[Augment]) -> float:
        """Return the log-likelihood of all samples, as of `Estimate`, for a noise and the varied states as they are in
        `varied`: with other standard deviations, drifts and memories.
        """
        dt = self._dt[:, None]
        pairs = zip(self._varied, varied, strict=True)
        extras = [replace(e, std=e.std if a.std is None else a.std, drift=a.drift, memory=a.memory) for e, a in pairs]
        kept = np.exp(-dt / np.array([e.memory for e in extras]))
        added = np.array([e.std for e in extras]) ** 2 * (1.0 - kept**2) + np.array([e.drift for e in extras]) ** 2 * dt
        offset = self._offset.copy()
        offset[:, self._first :] = kept * self._before - self._after
        offset[1:, self._first :] += kept[1:] * self._moved[1:-1, self._first :]
        lengths, which = np.unique(np.round(self._dt, 9), return_inverse=True)
        noises = np.stack([self._noise(noise, h) for h in lengths])
        steps = _Steps(self._transition, self._slope, self._innovation, which, kept, added, offset)
        total = 0.0
        for begin, end in self._stretches:
            start, stretch = self._start_covariance(begin, extras), tuple(a[begin:end] for a in steps)
            first = self._begin if begin == 0 else np.zeros_like(self._begin)
            total += _run(stretch, self._variance, first, start, noises, self._first)
        return total

    def _noise(self, noise: ProcessNoise, dt: float) -> np.ndarray:
        """Return the covariance that `dt` s add to the states that are not varied."""
        out = np.zeros((self._first, self._first))
        known, others = noise.covariance(dt), range(self._first - len(self._others), self._first)
        out[: len(known), : len(known)] = known
        out[others, others] = [e.variance(dt) for e in self._others]
        return out

    def _start_covariance(self, at: int, extras: Sequence[Extra]) -> np.ndarray:
        """Return the covariance (n, n) that the run began with before step `at`, with other variances of the
        varied states.
        """
        out = self._prior_covariance[at].copy()
        out[self._first :] = 0.0
        out[:, self._first :] = 0.0
        out[np.arange(self._first, len(out)), np.arange(self._first, len(out))] = [e.std**2 for e in extras]
        return out


def _transitions(covariance: np.ndarray, cross: np.ndarray) -> np.ndarray:
    """Return F (N - 1, n, n) of each step from P (N, n, n) and cov(before, after) (N, n, n), scaled to unit variances
    to solve.
    """
    scale = np.sqrt(np.einsum("kii->ki", covariance[:-1]))
    unit = covariance[:-1] / (scale[:, :, None] * scale[:, None, :])
    solved = np.linalg.solve(unit, cross[1:] / scale[:, :, None])
    return np.ascontiguousarray(np.swapaxes(solved, 1, 2) / scale[:, None, :])


def _slopes(estimator: Estimator, recorder: Any, shown: np.ndarray) -> np.ndarray:
    """Return the derivative (N - 1, k, n) of what the sensors should show by the states, by central differences, where
    they show (N - 1, k).
    """
    prior = recorder.prior_mean[1:]
    step = _SLOPE * np.sqrt(np.einsum("kii->ki", recorder.prior_covariance[1:]))
    out = []
    for j in range(estimator.size):
        above, below = prior.copy(), prior.copy()
        above[:, j] += step[:, j]
        below[:, j] -= step[:, j]
        out.append((estimator.observe(above, shown) - estimator.observe(below, shown)) / (2.0 * step[:, j, None]))
    return np.stack(out, axis=2)


@njit()
def _run(steps, variance, begin, start, noises, first):  # type: ignore[no-untyped-def]
    steps = _Steps(*steps)
    n = steps.offset.shape[1]
    deviation, covariance, total = begin.copy(), start.copy(), 0.0
    carried, gain = np.zeros((first, n)), np.zeros(n)
    for t in range(steps.offset.shape[0]):
        _predict(deviation, covariance, carried, steps, t, noises[steps.which[t]], first)
        for c in range(variance.size):
            innovation = steps.innovation[t, c]
            if innovation == innovation:
                total -= _correct(deviation, covariance, gain, steps.slope[t, c], innovation, variance[c])
    return total


@njit()
def _predict(deviation, covariance, carried, steps, t, noise, first):  # type: ignore[no-untyped-def]
    """Carry a deviation (n,) and a covariance (n, n) over step t; the states from `first` on fade by themselves."""
    n, transition = deviation.size, steps.transition[t]
    kept, added, offset = steps.kept[t], steps.added[t], steps.offset[t]
    carried[:] = 0.0
    for i in range(first):
        for m in range(n):
            a = transition[i, m]
            if a != 0.0:
                for j in range(n):
                    carried[i, j] += a * covariance[m, j]
    deviation[:first] = transition[:first] @ deviation
    deviation[first:] *= kept
    deviation += offset
    for i in range(first):
        for j in range(i, first):
            total = noise[i, j]
            for m in range(n):
                total += carried[i, m] * transition[j, m]
            covariance[i, j] = total
            covariance[j, i] = total
        for j in range(first, n):
            covariance[i, j] = carried[i, j] * kept[j - first]
            covariance[j, i] = covariance[i, j]
    for i in range(first, n):
        for j in range(first, n):
            covariance[i, j] *= kept[i - first] * kept[j - first]
        covariance[i, i] += added[i - first]


@njit()
def _correct(deviation, covariance, gain, slope, innovation, variance):  # type: ignore[no-untyped-def]
    """Correct by one sensor and return minus its log-likelihood, in units of its noise."""
    n = deviation.size
    spread, error = variance, innovation
    gain[:] = 0.0
    for m in range(n):
        h = slope[m]
        if h != 0.0:
            error -= h * deviation[m]
            for i in range(n):
                gain[i] += covariance[i, m] * h
    for m in range(n):
        spread += slope[m] * gain[m]
    for i in range(n):
        share = gain[i] / spread
        deviation[i] += share * error
        for j in range(n):
            covariance[i, j] -= share * gain[j]
    return 0.5 * (error * error / spread + np.log(spread / variance))
