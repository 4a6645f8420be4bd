"""How recorded commands drive the crane: between samples, and on the grid of a simulation."""

from __future__ import annotations

import numpy as np

from .channels import JUST_BEFORE
from .crane import Crane
from .inputs import SpoolPath

#: a change of a command is a step if it is this large, and so many times larger than the changes before and after it
_STEP, _RATIO = 0.02, 4.0


def with_steps(time: np.ndarray, commands: np.ndarray, held: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return commands in which steps stay steps: time (n + k,), commands (n + k, valves), linear between the points.

    A ramp shows in many samples, a step in one: joining the two samples around a step by a line would begin it up to a
    sampling interval early. A command that jumps is held until the sample that shows the new value; with `held` every
    change is such a jump, as of a controller whose output is logged in its own cycle.
    """
    change = np.abs(np.diff(commands, axis=0))
    around = np.maximum(np.pad(change[:-1], ((1, 0), (0, 0))), np.pad(change[1:], ((0, 1), (0, 0))))
    stepped = change > 0.0 if held else (change > _STEP) & (change > _RATIO * around)
    jumps = np.flatnonzero(stepped.any(axis=1))
    jumps = jumps[np.diff(time)[jumps] > 2.0 * JUST_BEFORE]
    before = np.where(stepped[jumps], commands[jumps], commands[jumps + 1])
    return (
        np.insert(time, jumps + 1, time[jumps + 1] - JUST_BEFORE),
        np.insert(commands, jumps + 1, before, axis=0),
    )


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
