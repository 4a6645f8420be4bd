"""How recorded commands drive the crane: between samples, and on the grid of a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from .channels import JUST_BEFORE
from .crane import Crane
from .inputs import SpoolPath

#: a change of a command is a step if it is this large, and so many times larger than the changes before and after it
_STEP, _RATIO = 0.02, 4.0
#: a step of a command: when the sample that shows the new value was taken, s, and which valve's
Step = tuple[float, int]


def steps_in(time: np.ndarray, commands: np.ndarray) -> dict[Step, float]:
    """Return the steps of commands (n, valves) sampled at `time` (n,), and how long the sampling interval of each is,
    s.

    A ramp shows in many samples, a step in one.
    """
    return {
        (float(time[row]), c): float(time[row] - time[row - 1])
        for c, u in enumerate(commands.T)
        for row in _rows(time, u, held=False)
    }


def _rows(time: np.ndarray, command: np.ndarray, held: bool) -> np.ndarray:
    """Return the samples (k,) that are the first to show a new value of one command (n,)."""
    change = np.abs(np.diff(command))
    around = np.maximum(np.append(0.0, change[:-1]), np.append(change[1:], 0.0))
    stepped = change > 0.0 if held else (change > _STEP) & (change > _RATIO * around)
    return np.flatnonzero(stepped & (np.diff(time) > 2.0 * JUST_BEFORE)) + 1


def with_steps(
    time: np.ndarray, commands: np.ndarray, held: bool = False, early: Mapping[Step, float] = MappingProxyType({})
) -> tuple[np.ndarray, np.ndarray]:
    """Return commands in which steps stay steps: time (n + k,), commands (n + k, valves), linear between the points.

    Joining the two samples around a step by a line would begin it up to a sampling interval early. A command that
    jumps is held until the sample that shows the new value; with `held` every change is such a jump, as of a controller
    whose output is logged in its own cycle.

    Args:
        early: by how many seconds steps come before the samples that show them, where that is known.
    """
    each = []
    for c, u in enumerate(commands.T):
        rows = _rows(time, u, held)
        at = np.array([t - early.get((t, c), 0.0) for t in time[rows].tolist()])
        pairs = np.repeat(rows, 2)
        stamps = np.insert(time, pairs, np.column_stack([at - JUST_BEFORE, at]).ravel())
        each.append((stamps, np.insert(u, pairs, np.column_stack([u[rows - 1], u[rows]]).ravel())))
    union = np.unique(np.concatenate([time, *(stamps for stamps, _ in each)]))
    return union, np.column_stack([np.interp(union, *one) for one in each])


def spool_on(
    crane: Crane,
    grid: np.ndarray,
    time: np.ndarray,
    commands: np.ndarray,
    late: float = 0.0,
    valve: int | None = None,
) -> np.ndarray:
    """Return spool positions (N, valves) on a grid (N,), exact for commands (n, valves) that are linear between their
    own samples; those before the grid count as well, for a spool follows them late.

    Args:
        late: seconds by which the commands come after their stamps `time` (n,).
        valve: the only one to be computed (the others stay at 0); all by default.
    """
    stamps = time + late
    every = np.unique(np.concatenate([grid, stamps[stamps < grid[-1]]]))
    on_all = np.column_stack([np.interp(every, stamps, u) for u in commands.T])
    spool: np.ndarray = SpoolPath(crane).run(every, on_all, valve)
    return spool[np.searchsorted(every, grid)]


def inputs_on(
    crane: Crane, grid: np.ndarray, time: np.ndarray, commands: np.ndarray, supply: np.ndarray | None = None
) -> np.ndarray:
    """Return the inputs w (N, valves + 2) of engines on a grid (N,), of commands (n, valves) as `spool_on` takes them;
    supply: pressures (N, 2) in Pa, by default the crane's own.
    """
    supply = np.full((len(grid), 2), np.nan) if supply is None else supply
    return np.column_stack([spool_on(crane, grid, time, commands), supply])
