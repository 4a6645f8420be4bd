"""First states of windows: taken over from a fit in other windows, and begun anew where one was caught."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import NamedTuple

import numpy as np

from crane_exudyn.crane import Crane

from .data import Data, FitData, Joint
from .linear import Window, follows, jump_of, left_in, model_at, ran, robust, with_states
from .model import Model
from .solve import Fit
from .start import knots_of
from .variables import Variable

#: error of a window, in noise units, from which on its first state may be caught in a false minimum
_CAUGHT = 1.3


def reknot(fit: Fit, windows: Sequence[Window]) -> np.ndarray:
    """Return first states (K, nx) of other windows: those of the fit's own, and where they begin within one of these
    its run's.
    """
    if isinstance(fit.data, Joint):
        each = range(len(fit.data.parts))
        own = [[replace(w, recording=0) for w in windows if w.recording == i] for i in each]
        return np.concatenate([reknot(fit.of(i), own[i]) for i in each])
    begins = np.array([w.data.time[0] for w in fit.windows])
    wanted = np.array([w.data.time[0] for w in windows])
    knots = fit.knots[[int(np.argmin(np.abs(begins - t))) for t in wanted]]
    within = np.searchsorted(begins, wanted + 0.5 * fit.data.step, side="right") - 1
    away = np.abs(begins[:, None] - wanted).min(axis=0) > 0.5 * fit.data.step
    model = model_at(fit.origin, fit.variables, fit.u, fit.data) if away.any() else None
    for k in sorted(set(within[away])):
        if k >= 0 and model is not None:
            rows = away & (within == k)
            states = _states(fit.windows[k], fit.knots[k], model, wanted[rows])
            knots[rows] = np.where(np.isnan(states), knots[rows], states)
    return knots


def _states(window: Window, x0: np.ndarray, model: Model, times: np.ndarray) -> np.ndarray:
    """Return states (n, nx) at times in a window that begins with x0; NaN where the run does not reach."""
    data = window.data
    W = model.W[window.start : window.start + len(data.time)]
    X, _, _ = model.run(x0, W, data.time, data.step)
    index = np.round((times - data.time[0]) / data.step).astype(int)
    inside = index < len(X)
    found = np.full((len(times), len(x0)), math.nan)
    found[inside] = X[index[inside]]
    return found


def begun_anew(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable],
    u: np.ndarray,
    stiffness: float,
) -> np.ndarray:
    """Return first states (K, nx) of windows: of those that stay unexplained the best of its own, as measured, and
    where the window before ends.

    What a window leaves counts by its logarithm only, so one whose first state was caught in a false minimum (of a
    cylinder that has run through its stop, say) pulls at nothing and stays there, though the model be right.
    """
    found = []
    for i, part in enumerate(data.parts):
        mine = [k for k, w in enumerate(windows) if w.recording == i]
        model = model_at(crane, variables, u, part, recording=i)
        found.append(_uncaught(part, [windows[k] for k in mine], with_states(knots[mine], model.nx), model, stiffness))
    return np.concatenate(found)


class _Begun(NamedTuple):
    """A window that begins with x0 (nx,), ends with `end` (nx,), and leaves an error in noise units; cost: with the
    jumps at both ends.
    """

    x0: np.ndarray
    end: np.ndarray
    error: float
    cost: float


def _uncaught(
    data: FitData, windows: Sequence[Window], knots: np.ndarray, model: Model, stiffness: float
) -> np.ndarray:
    knots, scale, end = knots.copy(), jump_of(model.crane.layout)[: model.nx] / stiffness, knots[0]
    for k, window in enumerate(windows):
        before = end if k and follows(windows[k - 1], window) else None
        after = knots[k + 1] if k + 1 < len(windows) and follows(window, windows[k + 1]) else None
        begun = partial(_begun, window=window, model=model, before=before, after=after, scale=scale)
        best = begun(knots[k])
        if best.error > _CAUGHT:
            others = [with_states(knots_of(model.crane, data, [window]), model.nx)[0]]
            others += [] if before is None else [before]
            best = min(best, *map(begun, others), key=lambda one: one.cost)
        knots[k], end = best.x0, best.end
    return knots


def _begun(
    x0: np.ndarray, window: Window, model: Model, before: np.ndarray | None, after: np.ndarray | None, scale: np.ndarray
) -> _Begun:
    X, status = ran(window, x0, model)
    if status != 0 or not np.isfinite(X[-1]).all():
        return _Begun(x0, X[-1], math.inf, math.inf)
    squares = sum(float(r @ r) for r in left_in(window, X, model))
    jumps = [(a - b) / scale for a, b in ((x0, before), (X[-1], after)) if b is not None]
    cost = robust(squares, window.data.count)[0] + sum(robust(float(j @ j), len(j))[0] for j in jumps)
    return _Begun(x0, X[-1], math.sqrt(squares / max(1, window.data.count)), cost)
