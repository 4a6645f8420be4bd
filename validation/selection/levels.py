"""The error levels of a model that is wrong: one for each channel, and how many independent samples its errors are
worth.

Where something is always left, the level of a channel is the model's error and not the sensor's alone, and samples
count as many times as they are independent: errors of a wrong model drift, and taken as white noise they would prove
anything. When only noise is left, the levels are one, and so is the factor.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import minimize_scalar

from crane_exudyn.signals import noise_between, noise_uncertainty, shown_of

from ..criteria import CRITERIA
from ..fit.data import Data, FitData
from ..fit.linear import with_states
from ..fit.model import model_of
from ..fit.solve import Fit
from ..fit.sweeps import left_in, ran
from ..fit.windows import shared_out, side_by_side

Errors = Mapping[str, float]
#: distances of samples at which noise is looked at, and how far the farthest must be
_LAG = 4


@dataclass(frozen=True)
class Levels:
    """Error levels by channel in units of the sensors' noise, and the factor on them at which samples weigh what the
    independent ones are worth.
    """

    of: Errors
    factor: float = 1.0

    def raised(self, data: Data) -> Data:
        """Return data with sensors' noise with these levels instead."""
        return each_part(data, self._raised)

    def _raised(self, part: FitData) -> FitData:
        samples = (replace(s, noise=s.noise * self.factor * self.of[s.channel]) for s in part.samples)
        return replace(part, samples=tuple(samples))


def noise_level(data: Data) -> float:
    """Return the level (RMS error in noise units) below which hardly more than noise is left: noise that is estimated
    from few samples is itself wrong.
    """
    samples = [s for part in data.parts for s in part.samples]
    counts, unsure = (np.array(each) for each in ([len(s.values) for s in samples], [s.unsure for s in samples]))
    spread = float(np.linalg.norm(counts * unsure)) / max(1, counts.sum())
    return max(CRITERIA.level, 1.0 + CRITERIA.doubt * spread)


def noise_in_full(found: Fit, data: Data) -> dict[str, list[float]]:
    """Return by channel and recording the noise of samples in units of what was estimated, where a fit leaves hardly
    more than noise and that is alike from one sample to the next, so that their differences do not show all of it; else
    1.

    Such noise grows with the distance of samples, least at last; what a wrong model leaves grows most at last. Empty
    where no noise was estimated, or the mean is not above `noise_level`.
    """
    errors, full = window_errors(found, data), dict[str, list[float]]()
    for part in data.parts:
        lag = int(CRITERIA.shared / part.interval + 1e-6)
        for sample in part.samples:  # which a channel has in some recordings only
            r = errors[sample.channel].pop(0)
            if sample.unsure:
                full.setdefault(sample.channel, []).append(_in_full(r, lag))
    each = [np.mean(several) for several in full.values()]
    return full if each and np.mean(each) > noise_level(data) else {}


def _in_full(r: np.ndarray, lag: int) -> float:
    """Return the noise of residuals r (n,) if it grows with the distance of samples as noise does whose neighbours
    share the same part everywhere, up to `lag`, where little is shared, and if it is all that they are; else 1.
    """
    if lag < _LAG or len(r) <= 3 * lag:
        return 1.0
    lags = np.unique(np.geomspace(1, lag, _LAG).round())
    shown = np.log([noise_between(r, int(k)) for k in lags])

    def full(shared: float) -> np.ndarray:
        return np.asarray(shown - np.log(shown_of(shared**lags)))

    most = CRITERIA.shared_at_last ** (1.0 / lag)
    each = full(minimize_scalar(lambda shared: np.var(full(shared)), bounds=(0.0, most), method="bounded").x)
    found = math.exp(each.mean())
    alike = np.abs(each - each.mean()).max() < CRITERIA.scattered * noise_uncertainty(r)
    all_of_it = math.sqrt(float(r @ r) / len(r)) < CRITERIA.left_level * found
    return max(1.0, found) if alike and all_of_it else 1.0


def each_part(data: Data, change: Callable[[FitData], FitData]) -> Data:
    """Return data with each recording's changed."""
    return change(data) if isinstance(data, FitData) else replace(data, parts=tuple(map(change, data.parts)))


def independent(r: np.ndarray) -> float:
    """Return how many independent samples the residuals r (n,) are worth: n over the sum of their autocorrelation.

    The sum runs to the first lag without positive correlation, which is careful with errors that ring.
    """
    n, power = len(r), float(r @ r)
    if n < 2 or power == 0.0:
        return float(n)
    spectrum = np.abs(np.fft.rfft(r, 2 * n)) ** 2
    rho = np.fft.irfft(spectrum)[:n] / power
    ends = np.flatnonzero(rho <= 0.0)
    return n / (1.0 + 2.0 * float(rho[1 : int(ends[0]) if len(ends) else n].sum()))


def levels_of(found: Fit, data: Data, most: Errors | None = None, apart: float | None = None) -> Levels:
    """Return the error levels that a fit leaves.

    A level is the channel's RMS error, at least its sensor's noise and at most `most` where that is given: a channel
    that a better model fits worse than the one before must not be given up. The factor is the root of how many samples
    make an independent one, on the average of the channels: one for each would weigh down just those channels that show
    best what is missing.

    Args:
        found: a fit to the data, whatever levels it was fitted with.
        data: the same data with the sensors' noise.
        most: levels of the model before.
        apart: samples so many seconds from one another are independent; by default those of short windows.
    """
    apart = CRITERIA.independent if apart is None else apart
    errors = window_errors(found, data)
    each = [r for parts in errors.values() for r in parts if len(r)]
    squares = {c: np.concatenate(parts) ** 2 for c, parts in errors.items()}
    levels = {c: max(1.0, math.sqrt(float(r2.mean()))) if len(r2) else 1.0 for c, r2 in squares.items()}
    if most is not None:
        levels = {c: min(level, max(1.0, most[c])) for c, level in levels.items()}
    interval = max(p.interval for p in data.parts)
    worth = [len(r) / max(independent(r), len(r) * interval / apart) for r in each]
    return Levels(levels, math.sqrt(float(np.mean(worth))))


def window_errors(found: Fit, data: Data) -> dict[str, list[np.ndarray]]:
    """Return by channel and recording the errors of all windows of a fit, one after the other, in units of the sensors'
    noise.
    """
    errors: dict[str, list[np.ndarray]] = {}
    for i, part in enumerate(data.parts):
        fit, own = found.of(i), dict[str, list[np.ndarray]]()
        model = model_of(fit.crane, fit.data.parts[0], fit.late)
        noise = {s.channel: s.noise for s in part.samples}
        groups = side_by_side(fit.windows)
        for group, x0 in zip(groups, shared_out(groups, with_states(fit.knots, model.nx)), strict=True):
            left = left_in(group, ran(group, x0, model)[0], model)
            for s, r in zip(group.samples, left, strict=True):
                own.setdefault(s.channel, []).append(r * s.noise / noise[s.channel])
        for c, pieces in own.items():
            errors.setdefault(c, []).append(np.concatenate(pieces))
    return errors


def falls(before: Errors, after: Errors) -> float:
    """Return the mean over channels of the log of the error's fall; below its sensor's noise an error no longer
    counts.
    """
    return float(np.mean([math.log(max(before[c], 1.0) / max(after[c], 1.0)) for c in before]))


def left_over(errors: Errors) -> float:
    """Return the mean over channels of the log by which errors could still fall: to the sensors' noise."""
    return falls(errors, dict.fromkeys(errors, 1.0))


def likelihoods(fits: Sequence[Fit], data: Data) -> list[float]:
    """Return the log-likelihoods of fits to the same data, each channel's level at its most likely value that is not
    below its sensor's noise, with the log prior, up to a constant that all share.

    A channel that is given up costs the log of its level. Samples count for all fits as they are independent in the
    one that leaves least: a fit must not look better because its errors drift.
    """
    costs = []
    for found in fits:
        levels, cost = levels_of(found, data, apart=CRITERIA.drifts), 0.0
        for c, parts in window_errors(found, data).items():
            r, level = np.concatenate(parts), levels.of[c]
            cost += len(r) * math.log(level) + 0.5 * float(r @ r) / level**2
        costs.append((cost, levels.factor))
    _, factor = min(costs)
    return [-cost / factor**2 - found.prior_cost for (cost, _), found in zip(costs, fits, strict=True)]
