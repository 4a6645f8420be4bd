"""By how much the commands' clock is off: when pistons follow their valves best."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from .balances import Figures, Grid, flow_misfits

#: s of lateness that are tried first
_COARSE = np.arange(-3.0, 3.01, 0.1)
#: s around the best of these that are tried then
_FINE = np.arange(-0.1, 0.101, 0.02)
#: s around the lateness of each piston that are tried with each drift
_AROUND = np.arange(-0.4, 0.401, 0.1)
#: s per s of drift that are tried first
_DRIFTS = np.array([-0.05, -0.03, -0.02, -0.01, -0.005, 0.005, 0.01, 0.02, 0.03, 0.05])
#: drifts around the best of these that are tried then: how many halves of it they are away
_FINE_DRIFTS = np.linspace(-0.5, 0.5, 9)
#: misfit of flows that the best machine has
_BEST = 0.003
#: misfit of flows up to which a piston follows its commands
_FOLLOWS = 0.25
#: log by which another clock must be better
_BETTER = 1.0
#: log by which clocks of their own must be better for the valves than one for all
_APART = 0.7


@dataclass(frozen=True)
class Clock:
    """How late the machine acts on its commands, by their stamps.

    Attributes:
        late: (cylinders,) s by which each piston follows its commands beyond what its spool takes; negative: before
            them. NaN where nothing shows it.
        drift: s by which they are later with each second.
    """

    late: np.ndarray
    drift: float = 0.0

    def lateness(self, time: np.ndarray) -> float | np.ndarray:
        """Return by how much commands stamped `time` (N,) act late, on average of the cylinders."""
        return float(np.nanmean(self.late)) + self.drift * (time - time.mean())

    def apart(self, other: Clock, time: np.ndarray) -> float:
        """Return by how many s another clock differs at most within `time` (N,)."""
        return float(np.max(np.abs(self.lateness(time) - other.lateness(time))))


def clock_of(machine: Figures, grid: Grid) -> Clock | None:
    """Return how late the machine acts on its commands; None if no piston follows them at any lateness."""
    stands = _logs(machine, grid, np.zeros(1))
    if stands is None or np.isnan(stands).all():
        return None
    seen = np.flatnonzero(~np.isnan(stands[0]))
    late = np.full(stands.shape[1], np.nan)
    late[seen] = _late(machine, grid, stands[0, seen], seen)
    left = np.diag(_seen_logs(machine, grid, late[seen], seen))
    late[seen[left > math.log(_FOLLOWS)]] = np.nan
    if np.isnan(late).all():
        return None
    return Clock(late, _drift(machine, grid, late, left[left <= math.log(_FOLLOWS)]))


def _late(machine: Figures, grid: Grid, stands: np.ndarray, seen: np.ndarray) -> np.ndarray:
    """Return how late each piston that is seen (s,) follows: all by the same time, unless they follow far better each
    by its own.
    """
    if (stands - math.log(_BEST)).sum() < _BETTER:  # no room for anything better
        return np.zeros(len(seen))
    tried, logs = _COARSE, _seen_logs(machine, grid, _COARSE, seen)
    own, alike = logs.argmin(axis=0), logs.sum(axis=1).argmin()
    tried = np.unique(np.round(np.append(tried[own], tried[alike])[:, None] + _FINE, 6))
    logs = _seen_logs(machine, grid, tried, seen)
    own, alike = logs.argmin(axis=0), logs.sum(axis=1).argmin()
    if stands.sum() - logs[alike].sum() > _BETTER and logs[alike].sum() - logs.min(axis=0).sum() < _APART:
        return np.full(len(seen), tried[alike])
    return np.where(stands - logs.min(axis=0) > _BETTER, tried[own], 0.0)


def _logs(machine: Figures, grid: Grid, late: np.ndarray, drift: float = 0.0) -> np.ndarray | None:
    """Return the logarithms of the misfits of each cylinder's flows (L, cylinders) for some lateness (L,)."""
    found = flow_misfits(machine, grid, late[:, None] + drift * (grid.time - grid.time.mean()))
    return None if found is None else np.log(found + _BEST)


def _seen_logs(machine: Figures, grid: Grid, late: np.ndarray, seen: np.ndarray, drift: float = 0.0) -> np.ndarray:
    """Return `_logs` of the cylinders that are seen (L, s)."""
    logs = _logs(machine, grid, late, drift)
    assert logs is not None, "of cylinders that were seen there are commands"
    return logs[:, seen]


def _drift(machine: Figures, grid: Grid, late: np.ndarray, stands: np.ndarray) -> float:
    """Return the drift with which the pistons follow their commands far better, 0 if there is none."""
    seen = np.flatnonzero(~np.isnan(late))
    if (stands - math.log(_BEST)).sum() < _BETTER:
        return 0.0
    around = np.unique(np.round(late[seen][:, None] + _AROUND, 6))

    def left(drift: float) -> np.ndarray:
        return np.asarray(_seen_logs(machine, grid, around, seen, drift).min(axis=0))

    coarse = min(_DRIFTS.tolist(), key=lambda drift: left(drift).sum())
    fine = min((coarse + 0.5 * abs(coarse) * _FINE_DRIFTS).tolist(), key=lambda drift: left(drift).sum())
    gains = stands - left(fine)
    return float(fine) if gains.sum() > _BETTER and gains.min() > 0.0 else 0.0


def mended(grid: Grid, clock: Clock, commands: tuple[str, ...]) -> Grid:
    """Return the grid with its commands on the sensors' clock."""
    when = grid.time - clock.lateness(grid.time)
    moved = {n: np.interp(when, grid.time, grid.channels[n]) for n in commands}
    return replace(grid, channels={**grid.channels, **moved})
