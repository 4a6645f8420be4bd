"""Windows run and swept: what a model leaves of their samples, and how that changes with first states and variables.

Windows stand side by side, so that compiled code runs many at once; a long one is swept in pieces, each from where the
one before ended.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crane_exudyn.effects.registry import slots_of
from crane_exudyn.measurement import Measurement

from ..semi_recursive import sensitivity
from .columns import Columns, acting
from .data import ACCURACY, COARSE, Samples
from .model import Model
from .windows import Group, Window, jump_of, pieces_of

#: most numbers that the sensitivities of a piece of a window may hold: 50 MB
_LARGE = 6_000_000
#: error that a window counts with whose run fails, in noise units: it explains nothing, whatever the model
_LOST = 1e3
#: how many times further from the truth than usual the steps of a run may be along which derivatives are taken: these
#: show where to go, and what is left there is told by runs as accurate as the model asks for
ROUGHLY = 10.0
#: hooks by which sensors lag
_LAGS = frozenset({"lag"})
#: by the unit of a sensor: what it shows at the start of a window where it lags is known to its lag times this rate
RATE: Mapping[str, float] = {"rad": 0.3, "m": 0.3, "rad/s": 0.3, "m/s": 0.3, "Pa": 5e7}


@dataclass
class Swept:
    """One window swept: sums of squared residuals (noise units) and counts by channel; J'J and J'r by first state and
    variables; end state and its derivative; J itself, one channel after the other, where it is kept.
    """

    squares: list[float]
    counts: list[int]
    JJ: np.ndarray
    Jr: np.ndarray
    end: np.ndarray
    end_jacobian: np.ndarray
    volume: float
    failed: bool
    J: np.ndarray | None = None


def ran(group: Group, x0: np.ndarray, base: Model) -> tuple[np.ndarray, np.ndarray]:
    """Return the states (N, nx) of runs from x0 (K, nx) in the data's own steps, and their status (K,); one that leaves
    what the crane can do stands still from there on.

    base: the model of the whole recording: a spool does not begin anew with a window.
    """
    X, status, last = base.each(x0, group.first, base.W[group.place], group.time, group.step)
    for k in np.flatnonzero(status):
        X[last[k] + 1 : group.last[k] + 1] = X[last[k]]
    return X, status


def left_in(group: Group, X: np.ndarray, base: Model) -> list[np.ndarray]:
    """Return by channel the residuals of states (N, nx), in noise units; what a lagging sensor showed before a window
    is forgotten.
    """
    measurement, residuals = base.measurement(group.windows[0].data.channels), []
    Z, lags = _shown(measurement, group, X), dict(measurement.lags)
    for j, sample in enumerate(group.samples):
        r = sample.residuals(Z[:, j])
        residuals.append(_without_memory(r[:, None], group, j, lags[j], base)[0][:, 0] if j in lags else r)
    return residuals


def _shown(measurement: Measurement, group: Group, X: np.ndarray, first: np.ndarray | None = None) -> np.ndarray:
    """Return what the sensors show (N, channels) of states (N, nx); lags begin anew with each window, or at `first`."""
    if not measurement.lags:
        return measurement.shown(X, group.time)
    each = zip(group.by_window(X), group.by_window(group.time), strict=True)
    return np.concatenate([measurement.shown(own, time, first=first) for own, time in each])


def run_again(group: Group, x0: np.ndarray, kept: Sequence[Swept | None], base: Model, m: int) -> list[Swept]:
    """Return what runs leave, with the derivatives of an earlier sweep by first states and m variables; zeros where
    they were not kept.
    """
    X, status = ran(group, x0, base)
    found = []
    for k, residuals in enumerate(group.split(left_in(group, X, base))):
        window, before, end = group.windows[k], kept[k], X[group.last[k]]
        if before is None or before.J is None:
            before = replace(lost(window, x0[k], m), J=None)
        squares = [float(r @ r) for r in residuals]
        if status[k] != 0 or not (np.isfinite(end).all() and math.isfinite(sum(squares))):
            found.append(lost(window, x0[k], m, before.J))
            continue
        Jr = before.Jr if before.J is None else before.J.T @ np.concatenate(residuals)
        found.append(replace(before, squares=squares, Jr=Jr, end=end, failed=False))
    return found


def lost(window: Window, x0: np.ndarray, m: int, J: np.ndarray | None = None) -> Swept:
    """Return a window whose run fails, as one that explains nothing and does not say which way to go."""
    counts, nx = [len(s.values) for s in window.data.samples], len(x0)
    n = nx + m
    return Swept(
        [_LOST**2 * c for c in counts], counts, np.zeros((n, n)), np.zeros(n), x0, np.zeros((nx, n)), 0.0, True, J,
    )  # fmt: skip


def sweep(group: Group, x0: np.ndarray, base: Model, columns: Columns, largest: int = _LARGE) -> list[Swept]:
    """Return residuals of windows and their derivative by their first states x0 (K, nx) and by all variables; pieces of
    a single window whose sensitivities hold at most `largest` numbers are swept one after the other.
    """
    nx = x0.shape[1]
    longest = max(1, int(largest / (nx * (nx + len(columns.size))) * max(1.0, COARSE / group.step)))
    pieces = [group] if len(group.windows) > 1 else [Group((p,)) for p in pieces_of(group.windows[0], longest)]
    swept, end = _sweep_piece(pieces[0], _Begun(x0), base, columns)
    for piece in pieces[1:]:
        if swept[0].failed:
            break
        later, end = _sweep_piece(piece, end, base, columns)
        swept = [_followed_by(swept[0], later[0])]
    return swept


class _Grid(NamedTuple):
    """Instants at which windows are differentiated.

    Attributes:
        time: (N,) s; first, last: (K,) instants at which each window begins and ends; steps: (K,) between them, s.
        W: (n_W, N, inputs) input signals of the base and of perturbed cranes.
        fine: whether they are the data's own.
    """

    time: np.ndarray
    first: np.ndarray
    last: np.ndarray
    steps: np.ndarray
    W: np.ndarray
    fine: bool

    @classmethod
    def of(cls, group: Group, W: np.ndarray) -> _Grid:
        """Return the grid of windows with steps of at most COARSE, or the data's own where these are not shorter; W
        are signals on the grid of the whole recording.
        """
        lengths, step = group.last - group.first, group.step
        numbers = np.ceil(lengths * step / COARSE - 1e-6).astype(int)
        if (numbers >= lengths).all():
            return cls(group.time, group.first, group.last, np.full(len(lengths), step), W[:, group.place], True)
        numbers = np.minimum(numbers, lengths)
        within = np.concatenate([np.linspace(0.0, n, k + 1) for n, k in zip(lengths, numbers, strict=True)])
        owner = np.repeat(np.arange(len(lengths)), numbers + 1)
        before = np.minimum(within.astype(int), lengths[owner] - 1)
        rows, share = group.place[group.first][owner] + before, (within - before)[:, None]
        between = W[:, rows] + share * (W[:, rows + 1] - W[:, rows])
        last = np.cumsum(numbers + 1) - 1
        time = group.time[group.first][owner] + step * within
        return cls(time, last - numbers, last, step * lengths / numbers, between, False)

    def taken(self, sample: Samples, owner: np.ndarray, group: Group, grid: np.ndarray) -> np.ndarray:
        """Return what `grid` (N, …) is at a channel's samples, of which each has an owner among the windows."""
        if self.fine:
            return sample.taken(grid)
        within = (sample.index - group.first[owner] + sample.fraction) * (group.step / self.steps[owner])
        index = np.minimum((within + 1e-9).astype(np.int64), (self.last - self.first)[owner] - 1)
        return replace(sample, index=self.first[owner] + index, fraction=within - index).taken(grid)


class _Begun(NamedTuple):
    """How windows begin: their states (K, nx); and what an earlier piece of a single one left.

    Attributes:
        by_all: (nx, nx + m) the state's derivative by the window's first state and all variables.
        shown: (channels,) what the sensors show, and (channels, nx + m) its derivative.
        shown_on: (channels, m) what they show of the same state on the perturbed cranes.
    """

    x: np.ndarray
    by_all: np.ndarray | None = None
    shown: tuple[np.ndarray, np.ndarray] | None = None
    shown_on: np.ndarray | None = None

    def along(self, x: np.ndarray, seen: np.ndarray) -> _Begun:
        """Return the same with the derivatives along another run, which ends at x (1, nx), where sensors show `seen`
        (channels,).
        """
        assert self.shown is not None and self.shown_on is not None
        before, by_all = self.shown
        return self._replace(x=x, shown=(seen, by_all), shown_on=self.shown_on + (seen - before)[:, None])


def _sweep_piece(group: Group, begun: _Begun, base: Model, columns: Columns) -> tuple[list[Swept], _Begun]:
    """Return residuals of windows, their derivative, and how the next piece of a single one begins."""
    nx, grid = begun.x.shape[1], _Grid.of(group, columns.W)
    roughly = replace(base, accuracy=ROUGHLY * max(base.accuracy, ACCURACY))
    X, S, status = _states(grid, begun, roughly, columns)
    measurement = base.measurement(group.windows[0].data.channels)
    Z, dZ, end = _seen(grid, begun, X, S, measurement, base, columns)
    X, ended = ran(group, begun.x, base)
    status, Z = np.maximum(status, ended), _shown(measurement, group, X, begun.shown and begun.shown[0])
    residuals, jacobians, volume = [], [], np.zeros(len(group.windows))
    lags, others = dict(measurement.lags), _other_lags(measurement, base, columns)
    for j, (sample, owner) in enumerate(zip(group.samples, group.owner, strict=True)):
        r, dr = sample.residuals(Z[:, j]), grid.taken(sample, owner, group, dZ[:, j]) / sample.noise
        if begun.shown is None and j in lags:
            both, own = _without_memory(np.column_stack([r, dr]), group, j, lags[j], base)
            for c, tau in others.get(j, ()):  # with another lag, something else is forgotten
                beside, _ = _without_memory(r[:, None], group, j, tau, base)
                both[:, 1 + nx + c] += (both[:, 0] - beside[:, 0]) / columns.size[c]
            r, dr, volume = both[:, 0], both[:, 1:], volume + own
        residuals.append(r)
        jacobians.append(dr)
    scale, found = jump_of(base.crane.layout)[:nx], []
    for k, (own_r, own_J) in enumerate(zip(group.split(residuals), group.split(jacobians), strict=True)):
        r, J, at = np.concatenate(own_r), np.concatenate(own_J), group.last[k]
        J[:, :nx] *= scale
        Jr = J.T @ r
        failed = status[k] != 0 or not (np.isfinite(X[at]).all() and np.isfinite(Jr).all())
        squares = [float(part @ part) for part in own_r]
        found.append(Swept(
            squares, [len(part) for part in own_r], J.T @ J, Jr, X[at].copy(), S[grid.last[k]].copy(), volume[k],
            bool(failed), J,
        ))  # fmt: skip
    return found, end.along(X[-1:].copy(), Z[-1].copy())


def _states(grid: _Grid, begun: _Begun, base: Model, columns: Columns) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return states (N, nx), their derivative (N, nx, nx + m) by a window's first state and all variables, and a status
    (K,).
    """
    nx, m = begun.x.shape[1], len(columns.size)
    here, own_E, moving, of = acting(columns, base, float(grid.time[0]), float(grid.time[-1]), grid.W)
    sloped, run = np.flatnonzero(~here.by_run), np.flatnonzero(here.by_run)
    swept = sensitivity.sweep(
        begun.x, grid.first, grid.W, grid.steps, grid.time[grid.first], base.P, own_E, here.P[sloped],
        here.E[sloped], here.size[sloped], here.W_index[sloped], topology=base.topology,
        allowed=base.accuracy,
    )  # fmt: skip
    if begun.by_all is None and len(sloped) == m:
        return swept.X, swept.S, swept.status
    by_columns = np.empty((*swept.X.shape, len(here.size)))
    by_columns[:, :, sloped] = swept.S[:, :, nx:]
    for j in run:
        by_columns[:, :, j] = _by_run(grid, begun.x, swept.X, here, int(j), base)
    if begun.by_all is None:
        S = np.zeros((*swept.X.shape, nx + m))
        S[:, :, :nx] = swept.S[:, :, :nx]
    else:
        S = swept.S[:, :, :nx] @ begun.by_all
    S[:, :, nx + moving] += by_columns[:, :, of]
    return swept.X, S, swept.status


def _by_run(grid: _Grid, x0: np.ndarray, X: np.ndarray, columns: Columns, j: int, base: Model) -> np.ndarray:
    """Return the difference (N, nx) between runs from x0 (K, nx) of the machine of column j and the base's runs X
    (N, nx), by the column's size; nothing from where one failed.
    """
    W, model = grid.W[columns.W_index[j]], replace(base, P=columns.P[j], E=columns.E[j])
    own, status, last = model.each(x0, grid.first, W, grid.time, float(grid.steps.max()))
    for k in np.flatnonzero(status):
        rest = slice(last[k] + 1, grid.last[k] + 1)
        own[rest] = X[rest]
    return (own - X) / columns.size[j]


def _seen(
    grid: _Grid, begun: _Begun, X: np.ndarray, S: np.ndarray, measurement: Measurement, base: Model, columns: Columns
) -> tuple[np.ndarray, np.ndarray, _Begun]:
    """Return what sensors show (N, channels), its derivative (N, channels, nx + m), and how the next piece begins; lags
    begin anew with each window.
    """
    slots = slots_of(_LAGS)
    lagging = bool(measurement.lags) or (columns.E[:, slots] != base.E[slots]).any()
    spans = [slice(a, b + 1) for a, b in zip(grid.first, grid.last, strict=True)] if lagging else [slice(None)]
    parts, nx, end = [], X.shape[1], begun
    for span in spans:
        Z, dZ = measurement.shown_rows(X[span], S[span], grid.time[span], begun.shown)
        by_state = dZ[-1].copy()
        shown_on = _add_own(dZ[:, :, nx:], Z, measurement, X[span], grid.time[span], columns, begun.shown_on)
        end = _Begun(begun.x, S[-1].copy(), (Z[-1].copy(), by_state), shown_on)
        parts.append((Z, dZ))
    Zs, dZs = zip(*parts, strict=True)
    return (Zs[0], dZs[0], end) if len(parts) == 1 else (np.concatenate(Zs), np.concatenate(dZs), end)


def _add_own(
    dZ: np.ndarray,
    Z: np.ndarray,
    measurement: Measurement,
    X: np.ndarray,
    time: np.ndarray,
    columns: Columns,
    first: np.ndarray | None,
) -> np.ndarray:
    """Add to derivatives dZ (n, channels, m) by the variables what the sensors show otherwise of equal states X: by
    pins, bias, lag, … Return what they show at the end (channels, m); lags begin at such, `first`.
    """
    last = np.repeat(Z[-1][:, None], len(columns.size), axis=1)
    own = measurement.differs(X, columns.P, columns.E)
    if own.any():
        began = None if first is None else first[:, own]
        moved = measurement.shown_on(X, time, columns.P[own], columns.E[own], began)
        dZ[:, :, own] += (moved - Z[:, :, None]) / columns.size[own]
        last[:, own] = moved[-1]
    return last


def _followed_by(a: Swept, b: Swept) -> Swept:
    """Return two pieces of a window as one."""
    return Swept(
        [x + y for x, y in zip(a.squares, b.squares, strict=True)],
        [x + y for x, y in zip(a.counts, b.counts, strict=True)],
        a.JJ + b.JJ, a.Jr + b.Jr, b.end, b.end_jacobian, a.volume + b.volume, a.failed or b.failed,
    )  # fmt: skip


def _other_lags(measurement: Measurement, base: Model, columns: Columns) -> dict[int, list[tuple[int, float]]]:
    """Return by channel that lags which columns change that, and the lags (s) that they make of it."""
    slots, found = slots_of(_LAGS), dict[int, list[tuple[int, float]]]()
    if measurement.lags:
        for c in np.flatnonzero((columns.E[:, slots] != base.E[slots]).any(axis=1)).tolist():
            beside = dict(measurement.beside(base.P, columns.E[c]).lags)
            for j, tau in measurement.lags:
                if beside.get(j, 0.0) not in (0.0, tau):
                    found.setdefault(j, []).append((c, beside[j]))
    return found


def _without_memory(
    columns: np.ndarray, group: Group, j: int, tau: float, base: Model
) -> tuple[np.ndarray, np.ndarray]:
    """Return columns (n, m) at the samples of channel j, which lags by tau (s), without what its unknown first value in
    each window may have done, and the cost of that (K,); nothing where it was known as the recording began.
    """
    cost = np.zeros(len(group.windows))
    rate, parts = RATE[base.crane.layout.sensors[group.samples[j].channel].unit], []
    for k, window in enumerate(group.windows):
        own = columns[group.owner[j] == k]
        if window.start > 0:
            own, cost[k] = forgotten(own, window.data.samples[j], group.step, tau, rate)
        parts.append(own)
    return np.concatenate(parts), cost


def forgotten(columns: np.ndarray, sample: Samples, step: float, tau: float, rate: float) -> tuple[np.ndarray, float]:
    """Return columns (n, m) of a sensor, in noise units, without what its unknown first value in a window may have
    done, and the cost of that.

    A sensor that lags (by tau, s) remembers what was before the window. Its first value is one more unknown, of which
    only a size is known, tau times `rate`, and dies out as exp(-t / tau); it is integrated out. The cost is minus twice
    the log of the share that is left of its prior volume.
    """
    shape = np.exp(-step * (sample.index + sample.fraction) / tau) * (tau * rate / sample.noise)
    size = 1.0 + float(shape @ shape)
    # the root of the inverse of 1 + shape shape' takes this share of the shape out
    share = (1.0 - 1.0 / math.sqrt(size)) / max(size - 1.0, 1e-300)
    return columns - np.outer(shape, share * (shape @ columns)), math.log(size)
