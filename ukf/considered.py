"""What a filter's estimate is off by where the machine is not as the crane file says, in what is not estimated along.

A filter believes the parameters of its model. If one of them is off by its standard uncertainty σ, the truth goes over
by another model than the estimate, and the estimate is off by s (n,): beside the filter's own trajectory m, with its
gain K and the slope H of the sensors,

    s⁻ = f(m + s; p + σ) - f(m; p),    s = s⁻ - K H s⁻

whatever the noise. Parameters are off independently, so that squares add up ("consider" covariance of Schmidt and
Jazwinski). A fading unknown d' = -d/T + w is taken for a constant of its size in the same way: an error of a model is
no noise that averages out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np

from crane_exudyn.errors import CraneError

from .estimator import Estimator
from .monitor import USED

#: step of the sensors' slope, in standard deviations of the state
_SLOPE = 0.1


def consider(
    estimator: Estimator, recording: Any, names: Sequence[str], progress: Callable[[float], None] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return instants (N,), s, and the standard deviation (N, len(names)), SI, that comes to each of these estimated
    quantities from what the filter believes, beside that of the filter itself.

    Args:
        estimator: with an engine that takes parameters which differ from row to row.
        recording: a Recording or Signals.
        names: quantities among the estimator's states.
        progress: called with the fraction done.

    Raises:
        CraneError: as `Estimator.run`.
    """
    plan = estimator.set_out(recording)
    extras, crane = estimator.extras, estimator.crane
    rows = {e.name: k for k, e in enumerate(extras, estimator.size - len(extras))}
    known = {n: u.std for n, u in crane.uncertainty.items() if n in crane.machine.index}
    filed = {n: std for n, std in known.items() if 0.0 < std < np.inf}
    fading = {e.name: float(np.hypot(e.std, filed.get(e.name, 0.0))) for e in extras if e.memory < np.inf}
    believed = {n: std for n, std in filed.items() if n not in rows}
    off = np.zeros((estimator.size, len(fading) + len(believed)))
    held = [rows[n] for n in fading]
    off[held, np.arange(len(held))] = list(fading.values())
    parameters = {
        n: crane[n] + np.r_[0.0, std * (np.arange(off.shape[1]) == c)]
        for c, (n, std) in enumerate(believed.items(), len(fading))
    }
    found, wanted = np.zeros((plan.time.size, len(names))), [estimator.state_names.index(n) for n in names]
    found[0] = np.linalg.norm(off[wanted], axis=1)
    for k in range(1, plan.time.size):
        mean, before = estimator.belief.mean, off
        with suppress(CraneError, ArithmeticError):  # a machine that cannot be there tells nothing of this step
            carried = estimator.carried(np.vstack([mean, mean + off.T]), plan, k, parameters)
            off = (carried[1:] - carried[0]).T
            off[held, np.arange(len(held))] += _constant(estimator, fading, float(plan.time[k] - plan.time[k - 1]))
        used = estimator.on_plan(plan, k).flags == USED
        off = _corrected(estimator, off if np.isfinite(off).all() else before, used, plan.values[k])
        found[k] = np.linalg.norm(off[wanted], axis=1)
        if progress is not None and k % 100 == 0:
            progress(k / plan.time.size)
    return plan.time, found


def _constant(estimator: Estimator, fading: dict[str, float], dt: float) -> np.ndarray:
    """Return what the true values of the fading unknowns gain on their estimates in `dt` s, as they do not fade."""
    return np.array([(1.0 - e.kept(dt)) * fading[e.name] for e in estimator.extras if e.name in fading])


def _corrected(estimator: Estimator, off: np.ndarray, used: np.ndarray, shown: np.ndarray) -> np.ndarray:
    """Return the deviations (n, q) that are left after a correction by the sensors `used` (k,) of all that show (k,);
    K = P Hᵀ R⁻¹.
    """
    belief = estimator.belief
    covariance, n = belief.covariance, len(off)
    step = _SLOPE * np.sqrt(covariance.diagonal())
    seen = estimator.observe(np.vstack([belief.mean + np.diag(step), belief.mean - np.diag(step)]), shown)[:, used]
    slope = ((seen[:n] - seen[n:]) / (2.0 * step[:, None])).T
    return np.asarray(off - covariance @ (slope.T / estimator.sensor_variance[used]) @ (slope @ off))
