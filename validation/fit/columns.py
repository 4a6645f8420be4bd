"""What a fit is differentiated by: machines and inputs that differ a little from the base, one column each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects.base import SENSING
from crane_exudyn.effects.registry import events, slots_of, slots_of_events

from .data import FitData
from .model import Model, model_of
from .variables import Variable, acts, lateness, with_variables


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

    def timed(self, base: Model) -> bool:
        """Whether any differs from the base in an event at a moment."""
        slots = slots_of_events()
        return bool((self.E[:, slots] != base.E[slots]).any())


Probes = Callable[[Model, FitData, int], Columns]


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


def join(a: Columns, b: Columns) -> Columns:
    """Return the columns of both, one after the other (both around the same base)."""
    return Columns(
        np.concatenate([a.P, b.P]), np.concatenate([a.E, b.E]), np.concatenate([a.W, b.W[1:]]),
        np.concatenate([a.W_index, np.where(b.W_index > 0, b.W_index + len(a.W) - 1, 0)]),
        np.concatenate([a.size, b.size]), np.concatenate([a.dynamic, b.dynamic]),
        np.concatenate([a.by_run, b.by_run]),
    )  # fmt: skip


class Acting(NamedTuple):
    """The columns that move the machine from one moment to another, no two alike, and the base's E there; then which of
    all columns do, and which of the first they are.
    """

    columns: Columns
    E: np.ndarray
    moving: np.ndarray
    of: np.ndarray


def acting(columns: Columns, base: Model, begin: float, end: float, W: np.ndarray) -> Acting:
    """Return the columns that act from `begin` to `end`, in s, with input signals W (n_W, N, …) of that time.

    Most events happen in other windows: where they are over or not yet begun, all moments are one.
    """
    E, own_E = _within(columns.E, begin, end), _within(base.E[None], begin, end)[0]
    same = (W == W[0]).all(axis=(1, 2))
    index = np.where(same[columns.W_index], 0, columns.W_index)
    acts = (columns.P != base.P).any(axis=1) | (E != own_E).any(axis=1) | (index != 0)
    moving = np.flatnonzero(columns.dynamic & acts)
    of, first = _distinct(moving, E, base, columns, index)
    here = replace(columns, P=columns.P[first], E=E[first], size=columns.size[first], W_index=index[first],
                   by_run=columns.by_run[first])  # fmt: skip
    return Acting(here, own_E, moving, of)


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
