"""What a measured signal says about its own noise and rate."""

from __future__ import annotations

import math

import numpy as np

_WINDOW = 64  # samples whose noise is judged together
#: noise as a share of the channel's range: less than any sensor has, and that of a usual one; integration and averaging
#: of samples leave
#: less of a right model
NO_SENSOR, USUAL_SENSOR = 1e-6, 2e-3
#: motion makes third differences too: without noise they are next to nothing where it is quietest, many times less than
#: usual, and never
#: large (shares of the range, of what is usual, of the range); the values come in finer steps than those of 16 bits
_QUIETEST, _QUIETER, _MOTION, _FINEST = 5e-6, 0.1, 3e-4, 1e-5
_THIRD_DIFFERENCE = math.sqrt(20.0)  # 1² + 3² + 3² + 1²: what a third difference makes of white noise
#: third differences are correlated (-3/4, 3/10, -1/20): 1 + 2 Σ ρ² of them tell as much as an independent one
_CORRELATED = 2.31


def sampling_rate(time: np.ndarray) -> float:
    """Return samples per second: one over the median step of `time` (n,), 0 for fewer than two samples."""
    return float(1.0 / np.median(np.diff(time))) if len(time) > 1 else 0.0


def quantisation(values: np.ndarray) -> float:
    """Return the step in which `values` (n,) come, in their unit; 0 for a constant signal."""
    steps = np.abs(np.diff(values))
    steps = steps[steps > 1e-12 * max(1e-300, float(np.max(np.abs(values), initial=0.0)))]
    return float(np.min(steps)) if len(steps) else 0.0


def noise_std(values: np.ndarray) -> float:
    """Return an estimate of the standard deviation of white sensor noise in `values` (n,).

    Third differences remove what is smooth; their RMS is taken over short windows and the median window counts, so that
    jumps and ringing in a part of the signal do no harm. A channel that was interpolated from a slower one is judged
    at its own samples, where its slope changes. The result is never below what rounding alone makes (step / √12).
    """
    values = np.asarray(values, dtype=float)
    step = quantisation(values)
    floor = step / math.sqrt(12.0)
    own = values[_own_samples(values, step)]
    if len(own) < 4:
        return floor
    third = np.diff(own, n=3)
    squares = _window_squares(third)
    square = float(np.median(squares)) / _median_share(len(squares), len(third))
    return max(math.sqrt(square) / _THIRD_DIFFERENCE, floor)


def noise_uncertainty(values: np.ndarray) -> float:
    """Return the relative standard error of `noise_std`: the median of windows tells the square of the noise √(π/2)
    times less surely than the mean of n/2.31 independent squares.
    """
    values = np.asarray(values, dtype=float)
    count = len(_own_samples(values, quantisation(values)))
    return math.sqrt(0.25 * math.pi * _CORRELATED / max(1, count))


def is_noise_free(values: np.ndarray) -> bool:
    """Whether a channel that moves has less noise than any sensor, as those of simulations do; where it stands still
    nothing is seen.
    """
    values = np.asarray(values, dtype=float)
    span = float(np.ptp(values))
    squares = _window_squares(np.diff(values, n=3)) if len(values) > 3 else np.empty(0)
    squares = squares[squares > 0.0]
    if not len(squares):
        return False
    quietest, usual = (math.sqrt(float(f(squares))) / _THIRD_DIFFERENCE for f in (np.min, np.median))
    clear = quietest < min(_QUIETEST * span, _QUIETER * usual) and usual < _MOTION * span
    return (clear or usual < NO_SENSOR * span) and quantisation(values) < _FINEST * span


def noisy(values: np.ndarray, std: float | None = None, seed: int = 0) -> np.ndarray:
    """Return a channel free of noise with the white noise of a sensor added, that of a usual one by default; any other
    channel as it is.

    Without noise no error can be called large or small, and channels that follow from each other make equations
    singular.
    """
    if not is_noise_free(values):
        return values
    std = USUAL_SENSOR * float(np.ptp(values)) if std is None else std
    return values + std * np.random.default_rng(seed).standard_normal(len(values))


def _window_squares(third: np.ndarray) -> np.ndarray:
    """Return the mean square of third differences in each short window."""
    lengths = np.array([len(w) for w in np.array_split(np.empty(len(third)), max(1, len(third) // _WINDOW))])
    return np.asarray(np.add.reduceat(third**2, np.cumsum(lengths) - lengths) / lengths)


def _median_share(windows: int, count: int) -> float:
    """Return the median of a window's mean square over its expectation: that of χ²/dof, (1 - 2/(9 dof))³ (Wilson,
    Hilferty).

    Third differences are correlated, so that a window has 2.31 times fewer degrees of freedom.
    """
    if windows < 3:  # the median of one or two is their mean
        return 1.0
    return float((1.0 - 2.0 / (9.0 * count / windows / _CORRELATED)) ** 3)


def _own_samples(values: np.ndarray, step: float) -> np.ndarray:
    """Return indices of the samples that were measured, not put between two others by linear interpolation.

    Between two own samples an interpolated channel is steep but does not bend by more than rounding makes it.
    """
    bend = np.abs(np.diff(values, n=2)) > 2.5 * step
    steep = np.abs(np.diff(values)[:-1]) > 4.0 * step
    if not steep.any() or bend[steep].mean() > 0.34:
        return np.arange(len(values))
    return np.concatenate([[0], np.flatnonzero(bend) + 1, [len(values) - 1]])
