"""A fit's model made linear: windows of the recording swept with sensitivities, summed up to normal equations.

The recording is cut into windows. Each begins with a state of its own (a knot), and neighbouring windows are held
together by a penalty on the jump between them, so that a model that lacks something stays near the machine instead of
drifting away. One window is an open-loop run.
"""

from __future__ import annotations

import math
import multiprocessing
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cache, partial
from itertools import pairwise
from typing import NamedTuple, TypeVar

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects.registry import events, slots_of, slots_of_events
from crane_exudyn.layout import Layout
from crane_exudyn.measurement import SENSING, Measurement

from ..semi_recursive import sensitivity
from ..workers import single_threaded
from .data import ACCURACY, Data, FitData, Samples
from .model import Model, model_of
from .variables import Variable, acts, lateness, with_variables

#: size of a jump between two windows that is taken as one standard deviation, by unit; and that of a pendulum's states
_JUMP: Mapping[str, float] = {"rad": 3e-3, "m": 3e-3, "rad/s": 2e-2, "m/s": 2e-2, "Pa": 1e5}
_JUMP_OF_PENDULUM = 3e-2
#: likewise, how far a first state may be from its guess
_GUESS: Mapping[str, float] = {"rad": 0.1, "m": 0.1, "rad/s": 0.1, "m/s": 0.1, "Pa": 50e5}
_GUESS_OF_PENDULUM = 0.3
THREADS = 2
T = TypeVar("T")
V = TypeVar("V")
#: most grid points that are swept at once: the sensitivities of a piece of a window take some 50 MB
_LARGE = 30_000
#: most numbers that are kept of swept windows, 200 MB
_KEPT = 25_000_000
#: longest step of the runs that derivatives are taken of, s. What is left is told by a run in the data's own steps, so
#: that the minimum is theirs; derivatives but for some hundredths lead to it as well. What probes do is then taken at
#: every second step
DERIVED = 2.5e-3
#: error that a window counts with whose run fails, in noise units: it explains nothing, whatever the model
_LOST = 1e3
#: by the unit of a sensor: what it shows at the start of a window where it lags is known to its lag times this rate
RATE: Mapping[str, float] = {"rad": 0.3, "m": 0.3, "rad/s": 0.3, "m/s": 0.3, "Pa": 5e7}


@cache
def jump_of(layout: Layout) -> np.ndarray:
    """Return the size of a jump between two windows that is taken as one standard deviation, for each state that there
    may be.
    """
    return np.array([*layout.sized(layout.states, _JUMP), *[_JUMP_OF_PENDULUM] * len(layout.added)])


@cache
def _guess_of(layout: Layout) -> np.ndarray:
    return np.array([*layout.sized(layout.states, _GUESS), *[_GUESS_OF_PENDULUM] * len(layout.added)])


@dataclass(frozen=True)
class Window:
    """A stretch of the grid with the samples that lie in it, of one of the recordings."""

    start: int
    data: FitData
    recording: int = 0


@dataclass
class Linear:
    """Normal equations of one linearised fit: knots x (K, nx) in units of `jump` (nx,), variables u (m,).

    Hxx (K, nx, nx), Hxo (K-1, nx, nx) between knot k and k+1, Hxu (K, nx, m), Huu (m, m); gx, gu are the gradients.
    squares, counts: sum of squared residuals in noise units and number of samples, by channel. window_error (K,): RMS
    residual of each window; window_cost (K,), jump_cost (K-1,): what they add to the cost, see `robust`. weak (nx,):
    weights of a weak prior that holds the first state near its guess. swept: the windows that were summed up, where
    they are not too large to be kept. volume: what lagging sensors' unknown first values add to minus twice the log
    evidence, see `forgotten`.
    """

    Hxx: np.ndarray
    Hxo: np.ndarray
    Hxu: np.ndarray
    Huu: np.ndarray
    gx: np.ndarray
    gu: np.ndarray
    squares: dict[str, float]
    counts: dict[str, int]
    window_error: np.ndarray
    window_cost: np.ndarray
    jump_cost: np.ndarray
    jump: np.ndarray
    weak: np.ndarray
    swept: tuple[Swept, ...] = ()
    volume: float = 0.0
    failed: bool = False

    @property
    def error(self) -> float:
        """RMS residual over all channels, in noise units."""
        return float(np.sqrt(sum(self.squares.values()) / max(1, sum(self.counts.values()))))

    @property
    def cost(self) -> float:
        """Minus twice the log-likelihood of residuals and jumps, up to a constant."""
        return float(self.window_cost.sum() + self.jump_cost.sum())


def robust(squares: float, number: int) -> tuple[float, float]:
    """Return cost and weight of a group of residuals with that sum of squares (noise units).

    Up to what noise makes (squares = number) the cost is the sum of squares; beyond, it grows with the logarithm only,
    which is the likelihood of a group whose own error level is unknown. So what a model cannot explain anywhere in a
    short stretch is counted once, instead of bending all parameters.
    """
    excess = max(squares - number, 0.0)
    return min(squares, number) + number * float(np.log1p(excess / number)), 1.0 / (1.0 + excess / number)


def cut(data: Data, seconds: float) -> list[Window]:
    """Return windows of about `seconds` each, one recording after the other; none where the commands are unknown.

    They are joined where a sample lies, so that windows of other steps are the same.
    """
    windows = []
    for i, part in enumerate(data.parts):
        unit = max(1, round(part.interval / part.step))
        for first, last in part.stretches:
            number = max(1, round((last - first) * part.step / seconds))
            inner = first + unit * np.round(np.linspace(0, (last - first) / unit, number + 1)[1:-1]).astype(int)
            edges = [first, *inner.tolist(), last]
            windows += [Window(int(a), part.part(int(a), int(b)), i) for a, b in pairwise(edges)]
    return windows


def follows(before: Window, after: Window) -> bool:
    """Whether a window begins where another ends; between them commands may be unknown, and then nothing joins them."""
    return before.recording == after.recording and before.start + len(before.data.time) - 1 == after.start


def alike(some: Sequence[Window], others: Sequence[Window]) -> bool:
    """Whether windows hold the same samples, whatever the steps of their runs."""
    return len(some) == len(others) and all(
        a.recording == b.recording and abs(a.data.time[0] - b.data.time[0]) < 1e-9 and a.data.count == b.data.count
        for a, b in zip(some, others, strict=True)
    )


@dataclass(frozen=True)
class Columns:
    """What compiled code needs to differentiate by m variables: perturbed vectors and input signals."""

    P: np.ndarray
    E: np.ndarray
    W: np.ndarray
    W_index: np.ndarray
    size: np.ndarray
    dynamic: np.ndarray  # which columns change the motion (the others only what sensors show)
    by_run: np.ndarray  # which are answered by a run of their own machine (a pendulum that the base lacks, softer oil)


def columns_of(
    crane: Crane, variables: Sequence[Variable], u: np.ndarray, base: Model, data: FitData, recording: int = 0
) -> Columns:
    """Return the perturbed vectors of every variable; the step points into the range that the variable may take."""
    moved, sizes = [], []
    for j, variable in enumerate(variables):
        if not acts(variable, recording):
            moved.append(base)
            sizes.append(1.0)
            continue
        size = variable.difference if u[j] + variable.difference <= variable.upper else -variable.difference
        shifted = u.copy()
        shifted[j] += size
        moved.append(model_at(crane, variables, shifted, data, base, recording))
        sizes.append(size)
    return pack(base, moved, np.array(sizes))


def model_at(
    crane: Crane,
    variables: Sequence[Variable],
    u: np.ndarray,
    data: FitData,
    near: Model | None = None,
    recording: int = 0,
) -> Model:
    """Return the model of a recording that the values u of the variables describe; `near` as in `model_of`."""
    crane = with_variables(crane, variables, u, recording)
    return model_of(crane, data, lateness(variables, u, recording), near)


Probes = Callable[[Model, FitData, int], Columns]


def linearised(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable],
    u: np.ndarray,
    stiffness: float,
    probes: Probes | None = None,
) -> tuple[Linear, np.ndarray]:
    """Return the linearised fit of all recordings, and the knots with as many states as the model has.

    Args:
        probes: (model, data, number of the recording) -> columns that come behind those of the variables.
    """  # fmt: skip
    found = []
    for i, part in enumerate(data.parts):
        mine = [k for k, w in enumerate(windows) if w.recording == i]
        base = model_at(crane, variables, u, part, recording=i)
        columns = columns_of(crane, variables, u, base, part, i)
        if probes is not None:
            columns = join(columns, probes(base, part, i))
        states = base.nx if probes is None else max(base.nx, knots.shape[1])
        knots = with_states(knots, states)
        found.append(
            normal_equations([windows[k] for k in mine], knots[mine], base, columns, stiffness, keep=probes is None)
        )
    return joined(found), knots


def near(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable],
    u: np.ndarray,
    stiffness: float,
    before: Linear,
) -> Linear | None:
    """Return the fit near a point at which it was linearised, with the derivatives that it had there: runs alone take a
    fraction of the time. None where the number of states is another one.

    Where windows were not kept, only its cost is told.
    """
    found, swept = [], iter(before.swept or [None] * len(windows))
    for i, part in enumerate(data.parts):
        base = model_at(crane, variables, u, part, recording=i)
        if base.nx != knots.shape[1] or base.nx != len(before.jump):
            return None
        mine = [k for k, w in enumerate(windows) if w.recording == i]
        own = [(windows[k], next(swept)) for k in mine]
        parts = _each(partial(_run_again, base=base, m=len(u)), own, knots[mine])
        here = [w for w, _ in own]
        found.append(_summed(here, knots[mine], parts, base, len(u), stiffness))
    return joined(found)


def _run_again(window_and_kept: tuple[Window, Swept | None], x0: np.ndarray, base: Model, m: int) -> Swept:
    """Return what a run of a window leaves, with the derivatives of an earlier sweep; zeros where it was not kept."""
    window, kept = window_and_kept
    X, status = ran(window, x0, base)
    if kept is None or kept.J is None:
        kept = replace(_lost(window, x0, m), J=None)
    if status != 0 or not np.isfinite(X[-1]).all():
        return _lost(window, x0, m, kept.J)
    residuals = left_in(window, X, base)
    squares = [float(r @ r) for r in residuals]
    if not math.isfinite(sum(squares)):
        return _lost(window, x0, m, kept.J)
    Jr = kept.Jr if kept.J is None else kept.J.T @ np.concatenate(residuals)
    return replace(kept, squares=squares, Jr=Jr, end=X[-1], failed=False)


def _lost(window: Window, x0: np.ndarray, m: int, J: np.ndarray | None = None) -> Swept:
    """Return a window whose run fails, as one that explains nothing and does not say which way to go."""
    counts, nx = [len(s.values) for s in window.data.samples], len(x0)
    n = nx + m
    return Swept(
        [_LOST**2 * c for c in counts], counts, np.zeros((n, n)), np.zeros(n), x0, np.zeros((nx, n)), 0.0, True, J,
    )  # fmt: skip


def ran(window: Window, x0: np.ndarray, base: Model) -> tuple[np.ndarray, int]:
    """Return the states (n, nx) of a window's run in the data's own steps, and its status; a run that leaves what the
    crane can do stands still from there on.

    base: the model of the whole recording: a spool does not begin anew with a window.
    """
    data = window.data
    return base.whole(x0, base.W[window.start : window.start + len(data.time)], data.time, data.step)


def left_in(window: Window, X: np.ndarray, base: Model) -> list[np.ndarray]:
    """Return by channel the residuals of a window's states (n, nx), in noise units; what a lagging sensor showed before
    is forgotten.
    """
    data, measurement = window.data, base.measurement(window.data.channels)
    Z, lags, residuals = measurement.shown(X, data.time), dict(measurement.lags), []
    for j, sample in enumerate(data.samples):
        r = sample.residuals(Z[:, j])
        if window.start > 0 and j in lags:
            r = _without_memory(r[:, None], sample, data.step, lags[j], base)[0][:, 0]
        residuals.append(r)
    return residuals


def with_states(knots: np.ndarray, nx: int) -> np.ndarray:
    """Return knots with as many states as a model has: a pendulum begins at rest, hanging."""
    n = min(nx, knots.shape[1])
    return knots if knots.shape[1] == nx else np.pad(knots[:, :n], ((0, 0), (0, nx - n)))


def joined(parts: Sequence[Linear]) -> Linear:
    """Return the normal equations of several recordings as one: variables in common, knots one recording after the
    other.
    """
    if len(parts) == 1:
        return parts[0]
    nx = len(parts[0].jump)
    squares, counts = Counter[str](), Counter[str]()
    for p in parts:
        squares.update(p.squares)  # type: ignore[arg-type]  # adds up floats as well
        counts.update(p.counts)
    apart = [row for p in parts for row in (p.Hxo, np.zeros((1, nx, nx)))][:-1]
    jumps = [row for p in parts for row in (p.jump_cost, np.zeros(1))][:-1]
    together = {
        n: np.concatenate([getattr(p, n) for p in parts]) for n in ("Hxx", "Hxu", "gx", "window_error", "window_cost")
    }
    return Linear(
        Hxo=np.concatenate(apart), jump_cost=np.concatenate(jumps), Huu=np.sum([p.Huu for p in parts], axis=0),
        gu=np.sum([p.gu for p in parts], axis=0),
        squares=dict(squares), counts=dict(counts), jump=parts[0].jump, weak=parts[0].weak,
        swept=tuple(s for p in parts for s in p.swept) if all(p.swept for p in parts) else (),
        volume=sum(p.volume for p in parts),
        failed=any(p.failed for p in parts), **together,
    )  # fmt: skip


def join(a: Columns, b: Columns) -> Columns:
    """Return the columns of both, one after the other (both around the same base)."""
    return Columns(
        np.concatenate([a.P, b.P]), np.concatenate([a.E, b.E]), np.concatenate([a.W, b.W[1:]]),
        np.concatenate([a.W_index, np.where(b.W_index > 0, b.W_index + len(a.W) - 1, 0)]),
        np.concatenate([a.size, b.size]), np.concatenate([a.dynamic, b.dynamic]),
        np.concatenate([a.by_run, b.by_run]),
    )  # fmt: skip


def pack(base: Model, moved: Sequence[Model], sizes: np.ndarray) -> Columns:
    """Return columns from models that differ from the base by a step each; equal inputs are stored once."""
    known, signals, index = {base.W.tobytes(): 0}, [base.W], list[int]()
    for model in moved:
        index.append(0 if model.W is base.W else known.setdefault(model.W.tobytes(), len(signals)))
        if index[-1] == len(signals):
            signals.append(model.W)
    P = np.array([m.P for m in moved]).reshape(len(moved), base.P.size)
    E = np.array([m.E for m in moved]).reshape(len(moved), base.E.size)
    dynamic = (P != base.P).any(axis=1) | (np.array(index) != 0)
    different = E != base.E
    different[:, slots_of(SENSING, only=True)] = False
    by_run = np.array([m.nx > base.nx for m in moved], dtype=bool)
    signal_index = np.array(index, dtype=np.int64)
    return Columns(P, E, np.array(signals), signal_index, sizes, dynamic | different.any(axis=1), by_run)


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


def sweep_window(
    window: Window, x0: np.ndarray, base: Model, columns: Columns, channels: tuple[str, ...], longest: int = _LARGE
) -> Swept:
    """Return residuals of one window and their derivative by its first state and by all variables; pieces of at most
    `longest` grid points are swept one after the other.
    """
    pieces = _pieces(window, longest)
    swept, end = _sweep_piece(pieces[0], _Begun(x0), base, columns, channels)
    for piece in pieces[1:]:
        if swept.failed:
            break
        later, end = _sweep_piece(piece, end, base, columns, channels)
        swept = _followed_by(swept, later)
    return swept


def _pieces(window: Window, longest: int) -> list[Window]:
    """Return a window as pieces of equal length, each from the last grid point of the one before."""
    last = len(window.data.time) - 1
    edges = np.linspace(0, last, 1 + math.ceil(last / longest)).round().astype(int).tolist()
    return [Window(window.start + a, window.data.part(a, b), window.recording) for a, b in pairwise(edges)]


class _Grid(NamedTuple):
    """Grid on which a piece of a window is differentiated.

    Attributes:
        time: (n,) s, at equal steps; step: s.
        W: (n_W, n, inputs) input signals of the base and of perturbed cranes.
        fine: whether it is the data's own.
    """

    time: np.ndarray
    step: float
    W: np.ndarray
    fine: bool

    @classmethod
    def of(cls, window: Window, W: np.ndarray) -> _Grid:
        """Return the grid of a window with steps of at most DERIVED, or the data's own where these are not shorter; W
        are signals on the grid of the whole recording.
        """
        data, own = window.data, W[:, window.start : window.start + len(window.data.time)]
        last = len(data.time) - 1
        steps = math.ceil(last * data.step / DERIVED - 1e-6)
        if steps >= last:
            return cls(data.time, data.step, own, True)
        place = np.linspace(0.0, last, steps + 1)
        before = np.minimum(place.astype(int), last - 1)
        share = (place - before)[:, None]
        between = own[:, before] + share * (own[:, before + 1] - own[:, before])
        return cls(data.time[0] + data.step * place, data.step * last / steps, between, False)

    def taken(self, sample: Samples, grid: np.ndarray, data: FitData) -> np.ndarray:
        """Return what `grid` (n, …) on this grid is at a channel's samples."""
        if self.fine:
            return sample.taken(grid)
        place = (sample.index + sample.fraction) * (data.step / self.step)
        index = np.minimum((place + 1e-9).astype(np.int64), len(self.time) - 2)
        return replace(sample, index=index, fraction=place - index).taken(grid)


class _Begun(NamedTuple):
    """How a piece of a window begins: its state (nx,), and what an earlier piece left.

    Attributes:
        by_all: (nx, nx + m) the state's derivative by the window's first state and all variables.
        shown: (channels,) what the sensors show, and (channels, nx + m) its derivative.
        shown_on: (channels, m) what they show of the same state on the perturbed cranes.
    """

    x: np.ndarray
    by_all: np.ndarray | None = None
    shown: tuple[np.ndarray, np.ndarray] | None = None
    shown_on: np.ndarray | None = None


def _sweep_piece(
    window: Window, begun: _Begun, base: Model, columns: Columns, channels: tuple[str, ...]
) -> tuple[Swept, _Begun]:
    """Return residuals of one piece of a window, their derivative, and how the next piece begins."""
    data, nx, grid = window.data, len(begun.x), _Grid.of(window, columns.W)
    X, S, status = _states(grid, begun, base, columns)
    measurement = base.measurement(channels)
    Z, dZ = measurement.shown_rows(X, S, grid.time, begun.shown)
    by_state = dZ[-1].copy()
    shown_on = _add_own(dZ[:, :, nx:], Z, measurement, X, grid.time, columns, begun.shown_on)
    if not grid.fine:
        X, ended = ran(window, begun.x, base)
        status, Z = max(status, ended), measurement.shown(X, data.time, first=begun.shown and begun.shown[0])
    end = _Begun(X[-1].copy(), S[-1].copy(), (Z[-1].copy(), by_state), shown_on)
    lags, residuals, jacobians, volume = dict(measurement.lags), [], [], 0.0
    for j, sample in enumerate(data.samples):
        r, dr = sample.residuals(Z[:, j]), grid.taken(sample, dZ[:, j], data) / sample.noise
        if window.start > 0 and begun.shown is None and j in lags:
            both, own = _without_memory(np.column_stack([r, dr]), sample, data.step, lags[j], base)
            r, dr, volume = both[:, 0], both[:, 1:], volume + own
        residuals.append(r)
        jacobians.append(dr)
    r, J = np.concatenate(residuals), np.concatenate(jacobians)
    J[:, :nx] *= jump_of(base.crane.layout)[:nx]
    Jr = J.T @ r
    failed = status != 0 or not (np.isfinite(X[-1]).all() and np.isfinite(Jr).all())
    return Swept(
        [float(part @ part) for part in residuals], [len(part) for part in residuals], J.T @ J, Jr,
        end.x, S[-1].copy(), volume, failed, J,
    ), end  # fmt: skip


def _states(grid: _Grid, begun: _Begun, base: Model, columns: Columns) -> tuple[np.ndarray, np.ndarray, int]:
    """Return states (n, nx), their derivative (n, nx, nx + m) by the window's first state and all variables, and a
    status.
    """
    nx, (here, own_E, moving, of) = len(begun.x), _acting(grid, base, columns)
    sloped, run = np.flatnonzero(~here.by_run), np.flatnonzero(here.by_run)
    swept = sensitivity.sweep(
        begun.x[None], np.zeros(1), grid.W, grid.step, float(grid.time[0]), base.P, own_E, here.P[sloped],
        here.E[sloped], here.size[sloped], here.W_index[sloped], topology=base.topology, allowed=ACCURACY,
        thinned=grid.step < 1.01 * DERIVED,
    )  # fmt: skip
    if begun.by_all is None and len(sloped) == len(columns.size):
        return swept.X, swept.S, swept.status
    by_columns = np.empty((*swept.X.shape, len(here.size)))
    by_columns[:, :, sloped] = swept.S[:, :, nx:]
    for j in run:
        by_columns[:, :, j] = _by_run(grid, begun.x, swept.X, here, int(j), base)
    by_first = np.eye(nx, nx + len(columns.size)) if begun.by_all is None else begun.by_all
    S = swept.S[:, :, :nx] @ by_first
    S[:, :, nx + moving] += by_columns[:, :, of]
    return swept.X, S, swept.status


def _by_run(grid: _Grid, x0: np.ndarray, X: np.ndarray, columns: Columns, j: int, base: Model) -> np.ndarray:
    """Return the difference (n, nx) between a run from x0 of the machine of column j and the base's run X (n, nx), by
    the column's size; nothing from where it failed.
    """
    W = grid.W[columns.W_index[j]]
    own, status, last = replace(base, P=columns.P[j], E=columns.E[j]).run(x0, W, grid.time, grid.step)
    if status != 0:
        own[last + 1 :] = X[last + 1 :]
    return (own - X) / columns.size[j]


def _acting(grid: _Grid, base: Model, columns: Columns) -> tuple[Columns, np.ndarray, np.ndarray, np.ndarray]:
    """Return the columns that move the machine within a window, no two alike, and the base's E there; then which of all
    columns do, and which of the first they are.

    Most events happen in other windows: where they are over or not yet begun, all moments are one.
    """
    begin, end = float(grid.time[0]), float(grid.time[-1])
    E, own_E = _within(columns.E, begin, end), _within(base.E[None], begin, end)[0]
    same = (grid.W == grid.W[0]).all(axis=(1, 2))
    index = np.where(same[columns.W_index], 0, columns.W_index)
    acts = (columns.P != base.P).any(axis=1) | (E != own_E).any(axis=1) | (index != 0)
    moving = np.flatnonzero(columns.dynamic & acts)
    of, first = _distinct(moving, E, base, columns, index)
    here = replace(columns, P=columns.P[first], E=E[first], size=columns.size[first], W_index=index[first],
                   by_run=columns.by_run[first])  # fmt: skip
    return here, own_E, moving, of


def _distinct(
    moving: np.ndarray, E: np.ndarray, base: Model, columns: Columns, index: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return for the columns `moving` (k,) which of the distinct ones each is (k,), and where these stand.

    Only events can be alike: those that lie outside of a window, in which E (m, …) acts.
    """
    slots = slots_of_events()
    timed = np.flatnonzero((columns.E[np.ix_(moving, slots)] != base.E[slots]).any(axis=1))
    rows, known, same = moving[timed], dict[bytes, int](), np.arange(len(moving))
    told = np.column_stack([columns.P[rows], E[rows], columns.size[rows], index[rows], columns.by_run[rows]])
    for k, row in zip(timed.tolist(), told, strict=True):
        same[k] = known.setdefault(row.tobytes(), k)
    distinct, of = np.unique(same, return_inverse=True)
    return of, moving[distinct]


def _within(E: np.ndarray, begin: float, end: float) -> np.ndarray:
    """Return E (m, …) as it acts from `begin` to `end`, in s: events that come later do nothing, and of those before it
    is all the same when they were.
    """
    E = E.copy()
    for own, moment, neutral in events():
        E[E[:, moment] > end, own] = neutral
        E[:, moment] = np.maximum(E[:, moment], begin)
    return E


def _followed_by(a: Swept, b: Swept) -> Swept:
    """Return two pieces of a window as one."""
    return Swept(
        [x + y for x, y in zip(a.squares, b.squares, strict=True)],
        [x + y for x, y in zip(a.counts, b.counts, strict=True)],
        a.JJ + b.JJ, a.Jr + b.Jr, b.end, b.end_jacobian, a.volume + b.volume, a.failed or b.failed,
    )  # fmt: skip


def _without_memory(
    columns: np.ndarray, sample: Samples, step: float, tau: float, base: Model
) -> tuple[np.ndarray, float]:
    return forgotten(columns, sample, step, tau, RATE[base.crane.layout.sensors[sample.channel].unit])


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


def normal_equations(
    windows: Sequence[Window], knots: np.ndarray, base: Model, columns: Columns, stiffness: float, *, keep: bool = False
) -> Linear:
    """Return the linearised fit.

    Args:
        windows: K windows, held together where one follows the other.
        knots: first states (K, nx) in SI.
        base, columns: the model and its perturbed kin.
        stiffness: how many times smaller than `jump_of` says a jump between two windows is expected to be.
        keep: whether the swept windows are kept, unless they are too large.
    """
    channels, n = windows[0].data.channels, knots.shape[1] + len(columns.size)
    keep = keep and n * (sum(w.data.count for w in windows) + n * len(windows)) <= _KEPT
    sweep = partial(_swept, base=base, columns=columns, channels=channels, keep=keep)
    return _summed(windows, knots, _each(sweep, windows, knots), base, len(columns.size), stiffness)


def _swept(
    window: Window, x0: np.ndarray, base: Model, columns: Columns, channels: tuple[str, ...], keep: bool
) -> Swept:
    found = sweep_window(window, x0, base, columns, channels)
    if found.failed:
        m = len(columns.size)
        found = _lost(window, x0, m, np.zeros((window.data.count, len(x0) + m)))
    return found if keep else replace(found, J=None)


def _summed(
    windows: Sequence[Window], knots: np.ndarray, parts: Iterable[Swept], base: Model, m: int, stiffness: float
) -> Linear:
    """Return the normal equations of swept windows and the jumps between them; a model of which no window runs fails.

    A window whose run fails is not joined to the next; its first state goes towards the end of the one before.
    """
    K, nx = len(windows), knots.shape[1]
    scale = jump_of(base.crane.layout)[:nx]
    weak = (scale / _guess_of(base.crane.layout)[:nx]) ** 2
    linear = Linear(
        np.zeros((K, nx, nx)), np.zeros((max(K - 1, 0), nx, nx)), np.zeros((K, nx, m)), np.zeros((m, m)),
        np.zeros((K, nx)), np.zeros(m), {}, {}, np.zeros(K), np.zeros(K), np.zeros(max(K - 1, 0)), scale, weak,
    )  # fmt: skip
    swept, linear.failed = [], K > 0
    for k, part in enumerate(parts):
        linear.failed &= part.failed
        if part.J is not None:
            swept.append(part)
        linear.volume += part.volume
        _add_data(linear, k, part, windows[0].data.channels, scale)
        if not part.failed and k + 1 < K and follows(windows[k], windows[k + 1]):
            _add_jump(linear, k, part, knots[k + 1], scale, stiffness)
    linear.swept = tuple(swept) if len(swept) == K else ()
    return linear


def _each(task: Callable[[V, np.ndarray], T], windows: Sequence[V], knots: np.ndarray) -> Iterator[T]:
    """Yield a task done with each window and its knot, in order; compiled code lets two threads work side by side."""
    if multiprocessing.parent_process() is not None:  # a worker process has one core to itself
        yield from map(task, windows, knots)
        return
    with single_threaded():
        yield from _threads().map(task, windows, knots)


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(THREADS)


def _add_data(linear: Linear, k: int, part: Swept, channels: tuple[str, ...], scale: np.ndarray) -> None:
    nx = len(scale)
    for channel, own, count in zip(channels, part.squares, part.counts, strict=True):
        linear.squares[channel] = linear.squares.get(channel, 0.0) + own
        linear.counts[channel] = linear.counts.get(channel, 0) + count
    squares, number = sum(part.squares), max(1, sum(part.counts))
    linear.window_error[k] = np.sqrt(squares / number)
    linear.window_cost[k], weight = robust(squares, number)
    H, g = weight * part.JJ, -weight * part.Jr
    linear.Hxx[k] += H[:nx, :nx]
    linear.Hxu[k] += H[:nx, nx:]
    linear.Huu += H[nx:, nx:]
    linear.gx[k] += g[:nx]
    linear.gu += g[nx:]


def _add_jump(linear: Linear, k: int, part: Swept, after: np.ndarray, scale: np.ndarray, stiffness: float) -> None:
    nx = len(scale)
    jump = (part.end - after) * stiffness / scale
    linear.jump_cost[k], weight = robust(float(jump @ jump), nx)
    J = part.end_jacobian * (stiffness / scale)[:, None]
    Jx, Ju = J[:, :nx] * scale, J[:, nx:]
    linear.Hxx[k] += weight * (Jx.T @ Jx)
    linear.Hxx[k + 1] += weight * stiffness**2 * np.eye(nx)
    linear.Hxo[k] -= weight * stiffness * Jx.T
    linear.Hxu[k] += weight * (Jx.T @ Ju)
    linear.Hxu[k + 1] -= weight * stiffness * Ju
    linear.Huu += weight * (Ju.T @ Ju)
    linear.gx[k] += weight * (Jx.T @ jump)
    linear.gx[k + 1] -= weight * stiffness * jump
    linear.gu += weight * (Ju.T @ jump)
