"""First states of windows: taken over from a fit in other windows, and begun anew where one was caught."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.hydraulics import vapour_pressure

from ..criteria import CRITERIA
from .columns import model_at
from .data import Data, FitData, Joint
from .linear import robust, with_states
from .model import Model
from .solve import Fit
from .start import knots_of
from .sweeps import left_in, ran
from .variables import Variable
from .windows import Group, Window, by_recording, follows, jump_of, shared_out, side_by_side


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
    where the window before ends; of those in which a chamber boils the void that the window before leaves.

    What a window leaves counts by its logarithm only, so one whose first state was caught in a false minimum (of a
    cylinder that has run through its stop, say) pulls at nothing and stays there, though the model be right. Of a void
    no sensor tells the size; begun as none in every window, it is wrong by a thousand times what a jump may be.
    """
    found = []
    for i, part, mine in by_recording(data, windows):
        model = model_at(crane, variables, u, part, recording=i)
        found.append(_uncaught(part, [windows[k] for k in mine], with_states(knots[mine], model.nx), model, stiffness))
    return np.concatenate(found)


class _Begun(NamedTuple):
    """A window that begins with x0 (nx,) and ends with `end` (nx,), and the sum of squares that it leaves, in noise
    units.
    """

    x0: np.ndarray
    end: np.ndarray
    squares: float


def _uncaught(
    data: FitData, windows: Sequence[Window], knots: np.ndarray, model: Model, stiffness: float
) -> np.ndarray:
    knots, scale = knots.copy(), jump_of(model.crane.layout)[: model.nx] / stiffness
    ends, errors = _with_voids(windows, knots, model, *_runs(windows, knots, model))
    for k in np.flatnonzero(errors > CRITERIA.caught).tolist():
        window, count = windows[k], windows[k].data.count
        before = ends[k - 1] if k and follows(windows[k - 1], window) else None
        after = knots[k + 1] if k + 1 < len(windows) and follows(window, windows[k + 1]) else None
        measured = with_states(knots_of(model.crane, data, [window]), model.nx)[0]
        error = float(errors[k])  # of a run that goes far astray its square is infinite
        tried = [_Begun(knots[k], ends[k], error * error * max(1, count))]
        tried += [_begun(x0, window, model) for x0 in (measured, before) if x0 is not None]
        knots[k], ends[k], _ = min(tried, key=lambda one: _cost(one, count, before, after, scale))
    return knots


def _with_voids(
    windows: Sequence[Window], knots: np.ndarray, model: Model, ends: np.ndarray, errors: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return where windows end and what they leave with voids, which are put into their knots, taken over from one
    window to the next.
    """
    p, floor = model.crane.layout.pressures, float(vapour_pressure(model.P))
    most = floor + jump_of(model.crane.layout)[p]
    for k, (a, b) in enumerate(pairwise(windows), 1):
        void = (ends[k - 1, p] < floor) & (knots[k, p] < most) & np.isfinite(ends[k - 1, p])
        if not (void.any() and follows(a, b)):
            continue
        x0 = knots[k].copy()
        x0[p] = np.where(void, ends[k - 1, p], x0[p])
        (end,), (error,) = _runs([b], x0[None], model)
        if error < max(errors[k], CRITERIA.caught):
            knots[k], ends[k], errors[k] = x0, end, error
    return ends, errors


def _runs(windows: Sequence[Window], knots: np.ndarray, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return where windows end (K, nx), and what they leave (K,) in noise units."""
    ends, errors, groups = [], list[float](), side_by_side(windows)
    for group, x0 in zip(groups, shared_out(groups, knots), strict=True):
        X, status = ran(group, x0, model)
        ends.append(X[group.last])
        each = zip(group.windows, group.split(left_in(group, X, model)), strict=True)
        own = [math.sqrt(sum(float(r @ r) for r in left) / max(1, w.data.count)) for w, left in each]
        errors += [math.inf if failed else e for failed, e in zip(status, own, strict=True)]
    return np.concatenate(ends), np.nan_to_num(errors, nan=math.inf)


def _begun(x0: np.ndarray, window: Window, model: Model) -> _Begun:
    alone = Group((window,))
    X, status = ran(alone, x0[None], model)
    squares = sum(float(r @ r) for r in left_in(alone, X, model)) if status[0] == 0 else math.inf
    return _Begun(x0, X[-1], squares)


def _cost(one: _Begun, count: int, before: np.ndarray | None, after: np.ndarray | None, scale: np.ndarray) -> float:
    """Return what a window of so many samples adds to the cost by what it leaves and by the jumps at both ends."""
    if not (math.isfinite(one.squares) and np.isfinite(one.end).all()):
        return math.inf
    jumps = [(a - b) / scale for a, b in ((one.x0, before), (one.end, after)) if b is not None]
    return robust(one.squares, count)[0] + sum(robust(float(j @ j), len(j))[0] for j in jumps)
