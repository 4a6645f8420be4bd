"""What a measured signal says about its own noise and rate."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from scipy.optimize import brentq

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
#: a larger part of their noise than this neighbours do not share
_MOST_SHARED = 0.999


def sampling_rate(time: np.ndarray) -> float:
    """Return samples per second: one over the median step of `time` (n,), 0 for fewer than two samples."""
    return float(1.0 / np.median(np.diff(time))) if len(time) > 1 else 0.0


def usual_range(values: np.ndarray) -> tuple[float, float]:
    """Return the values (low, high) between which a channel is nearly all the time."""
    low, high = np.quantile(values, [0.01, 0.99])
    return float(low), float(high)


def early(time: np.ndarray, at: float, span: float = 0.1) -> slice:
    """Return which stamps (n,) of a sensor tell what it shows at `at`, s: those within the next `span` seconds, or
    within two of its own usual intervals where these are longer.
    """
    reach = max(span, 2.0 * float(np.median(np.diff(time)))) if len(time) > 1 else span
    begin, end = np.searchsorted(time, [at, at + 1.000001 * reach])  # a stamp at the end belongs, whatever its rounding
    return slice(int(begin), int(end))


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
    return max(noise_between(own), floor)


def noise_between(values: np.ndarray, lag: int = 1) -> float:
    """Return what third differences of samples `lag` apart show of noise, as a standard deviation; 0 for too few.

    Where noise is alike from one sample to the next, it shows in full only between samples that are farther apart.
    """
    if len(values) <= 3 * lag:
        return 0.0
    third = values[3 * lag :] - 3.0 * values[2 * lag : -lag] + 3.0 * values[lag : -2 * lag] - values[: -3 * lag]
    squares = _window_squares(third)
    return math.sqrt(float(np.median(squares)) / _median_share(len(squares), len(third))) / _THIRD_DIFFERENCE


def shown_of(shared: Any) -> Any:
    """Return the share of noise, as a standard deviation, that `noise_between` shows where neighbours share a part (n,)
    of it, those twice as far apart the square of that, and so on.
    """
    return np.sqrt(1.0 - 1.5 * shared + 0.6 * shared**2 - 0.1 * shared**3)


def of_mean(shared: float, number: int) -> float:
    """Return the noise of a mean of so many samples, as a standard deviation, of which neighbours share a part; 1 is
    that of one sample.
    """
    apart = np.arange(1, number)
    return math.sqrt((1.0 + 2.0 * float(((1.0 - apart / number) * shared**apart).sum())) / number)


def shared_part(ratio: float, number: int) -> float:
    """Return the part of noise that neighbours share, where the noise of a mean of so many samples is by a `ratio`
    larger than what neighbours show makes it.
    """

    def left(shared: float) -> float:
        return float(of_mean(shared, number) * math.sqrt(number) / shown_of(shared)) - ratio

    return float(brentq(left, 0.0, _MOST_SHARED)) if 1.0 < ratio < left(_MOST_SHARED) + ratio else 0.0


def noise_uncertainty(values: np.ndarray) -> float:
    """Return the relative standard error of `noise_std`: the median of windows tells the square of the noise √(π/2)
    times less surely than the mean of n/2.31 independent squares.
    """
    values = np.asarray(values, dtype=float)
    count = len(_own_samples(values, quantisation(values)))
    return math.sqrt(0.25 * math.pi * _CORRELATED / max(1, count))


def is_noise_free(values: np.ndarray, *, beside: bool = False) -> bool:
    """Whether a channel that moves has less noise than any sensor, as those of simulations do; where it stands still
    nothing is seen. Beside another one that has none, its motion may be as rough as it will.
    """
    values = np.asarray(values, dtype=float)
    span = float(np.ptp(values))
    squares = _window_squares(np.diff(values, n=3)) if len(values) > 3 else np.empty(0)
    squares = squares[squares > 0.0]
    if not len(squares):
        return False
    quietest, usual = (math.sqrt(float(f(squares))) / _THIRD_DIFFERENCE for f in (np.min, np.median))
    clear = quietest < min(_QUIETEST * span, _QUIETER * usual) and (beside or usual < _MOTION * span)
    return (clear or usual < NO_SENSOR * span) and quantisation(values) < _FINEST * span


def with_noise(values: np.ndarray, std: float | None = None, seed: int = 0) -> np.ndarray:
    """Return a channel with the white noise of a sensor added, that of a usual one by default.

    Without noise no error can be called large or small, and channels that follow from each other make equations
    singular.
    """
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


# -- samples that were not measured ------------------------------------------------------------------------------------

#: a leap that no machine makes: so many times every other one of its channel, and so many standard deviations of noise
_LEAP, _LEAP_NOISE = 4.0, 8.0
#: s in which no machine leaps away and is back as if nothing had been: its cylinders ring at a few Hz, and its valves
#: take as long to open
_BLINK = 0.05
#: steps of a clock that are none of its usual ones; share of samples equal to the one before, beyond which a channel
#: comes in steps or is held, so that equal samples tell nothing; how often a value of a logger's own comes at least
_PAUSE, _EQUAL, _OFTEN = 2.5, 0.2, 3
#: samples of which nothing can be said
_TOO_FEW = 20


class Stray(NamedTuple):
    """A stretch of samples that show nothing of what is measured: from `first` to before `after`, `height` beyond their
    neighbours; `filled`: whether they are one value that stands there for "no value".
    """

    first: int
    after: int
    height: float
    filled: bool


class _Stretches(NamedTuple):
    """Stretches (k,) of equal samples, or of samples that are all impossible.

    Attributes:
        first, after: number of the first sample, and of the one behind the last.
        into, back: leaps from the sample before, and to the one behind; took: s that the longer one took.
        inner: whether there are both; height: the lesser of both, the only one where there is one.
    """

    first: np.ndarray
    after: np.ndarray
    into: np.ndarray
    back: np.ndarray
    took: np.ndarray

    @classmethod
    def of(cls, time: np.ndarray, values: np.ndarray, impossible: np.ndarray) -> _Stretches:
        border = np.flatnonzero((np.diff(values) != 0.0) & ~(impossible[1:] & impossible[:-1])) + 1
        first, after = np.concatenate([[0], border]), np.concatenate([border, [len(values)]])
        before, behind = np.maximum(first - 1, 0), np.minimum(after, len(values) - 1)
        into, back = values[first] - values[before], values[after - 1] - values[behind]
        return cls(first, after, into, back, np.maximum(time[first] - time[before], time[behind] - time[after - 1]))

    @property
    def inner(self) -> np.ndarray:
        return (self.first > 0) & (self.after < self.after[-1])

    @property
    def height(self) -> np.ndarray:
        leaps = np.abs([self.into, self.back])
        return np.where(self.inner, leaps.min(axis=0), leaps.max(axis=0))


def strays(
    time: np.ndarray, values: np.ndarray, impossible: np.ndarray, fastest: float = math.inf, noise: float | None = None
) -> list[Stray]:
    """Return the stretches of a channel that were not measured: a glitch, a dropout, a value that stands for none.

    A stretch has equal samples, or impossible ones. Leaps lead into it and back that are far beyond every other leap of
    the channel and beyond its noise; and it has impossible values, or leaps that nothing can follow, or is of one
    sample between two that agree, too short for a machine to come back, or one of several that have exactly the same
    value. A valve's step, an end stop, a peak of several samples and a ring are none: they leap one way, or come back
    with other leaps.

    Args:
        time: (n,) s, increasing; values: (n,).
        impossible: (n,) whether no machine shows such a value.
        fastest: change a second that nothing exceeds.
        noise: standard deviation of the channel's noise; estimated by default.
    """
    if len(values) < _TOO_FEW or impossible.all():
        return []
    all_ = _Stretches.of(time, values, impossible)
    low, high = usual_range(values[~impossible])
    noise = max(noise_std(values) if noise is None else noise, USUAL_SENSOR * (high - low))
    clear = (all_.height > _LEAP_NOISE * noise) & (~all_.inner | (all_.into * all_.back > 0.0))
    if not clear.any():
        return []
    lone = clear & ~_beside(clear)
    rushed = lone & (all_.height > fastest * np.where(all_.took > 0.0, all_.took, math.inf))
    chosen = np.flatnonzero((clear & impossible[all_.first]) | rushed | _brief(time, values, all_, clear, lone))
    chosen = chosen[all_.height[chosen] > _LEAP * _ordinary(time, values, all_, chosen)]
    own, lengths = values[all_.first[chosen]], all_.after[chosen] - all_.first[chosen]
    return [
        Stray(int(all_.first[k]), int(all_.after[k]), float(all_.height[k]), int(lengths[own == v].sum()) >= _OFTEN)
        for k, v in zip(chosen, own, strict=True)
    ]


def _brief(time: np.ndarray, values: np.ndarray, all_: _Stretches, clear: np.ndarray, lone: np.ndarray) -> np.ndarray:
    """Return which stretches (k,) are left and entered so fast that no machine does: a single sample between two that
    agree, or a value that comes again and again and nowhere else.
    """
    usual, lengths = float(np.median(np.diff(time))), all_.after - all_.first
    brief = clear & all_.inner & (all_.took < _PAUSE * usual) & (2.0 * usual < _BLINK)
    if not brief.any() or is_noise_free(values):  # where nothing scatters, the lowest pressure comes exactly, too
        return np.zeros_like(brief)
    blink = brief & lone & (lengths == 1) & (np.abs(all_.into - all_.back) < 0.5 * all_.height)
    own, (found, number) = values[all_.first], np.unique(values[all_.first][brief], return_inverse=True)
    samples = np.bincount(number, lengths[brief], len(found))
    often = [v for v, n in zip(found, samples, strict=True) if n >= _OFTEN and (values == v).sum() == n]
    filled = brief & np.isin(own, often)
    others = np.delete(np.diff(values), _within(all_, filled))
    return blink | filled if np.mean(others == 0.0) < _EQUAL else blink


def _beside(clear: np.ndarray) -> np.ndarray:
    """Return whether a neighbour of each stretch (k,) leaps, too: a ring does so again and again."""
    beside = np.zeros_like(clear)
    beside[1:] |= clear[:-1]
    beside[:-1] |= clear[1:]
    return beside


def _ordinary(time: np.ndarray, values: np.ndarray, all_: _Stretches, chosen: np.ndarray) -> float:
    """Return the largest leap of a channel apart from those of the chosen stretches, and those over a pause."""
    leaps, took = np.abs(np.diff(values)), np.diff(time)
    leaps[took > _PAUSE * np.median(took)] = 0.0
    ends = np.concatenate([all_.first[chosen] - 1, all_.after[chosen] - 1])
    leaps[ends[(ends >= 0) & (ends < len(leaps))]] = 0.0
    leaps[_within(all_, chosen)] = 0.0
    return float(leaps.max())


def _within(all_: _Stretches, chosen: np.ndarray) -> np.ndarray:
    """Return the numbers of the steps between samples of one and the same of the chosen stretches."""
    spans = [np.arange(a, b - 1) for a, b in zip(all_.first[chosen], all_.after[chosen], strict=True)]
    return np.concatenate([np.empty(0, dtype=int), *spans])
