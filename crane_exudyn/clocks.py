"""By how much the commands' clock is off: when pistons follow their valves best."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .consistency import Grid, Machine, flow_misfits

#: s: lateness that is tried, coarsely and finely; and drifts in s per s, and steps by which the best of them is looked at more closely
_COARSE, _FINE = np.arange(-3.0, 3.01, 0.1), np.arange(-0.1, 0.101, 0.02)
_DRIFTS, _FINE_DRIFTS = (
    np.array([-0.05, -0.03, -0.02, -0.01, -0.005, 0.005, 0.01, 0.02, 0.03, 0.05]),
    np.linspace(-0.5, 0.5, 9),
)
#: misfit of flows that the best machine has; what counts as following; log by which another clock must be better
_BEST, _FOLLOWS, _BETTER = 0.003, 0.25, 1.0


@dataclass(frozen=True)
class Clock:
    """How late the machine acts on its commands, by their stamps.

    Attributes:
        late: (cylinders,) s by which each piston follows its commands beyond what its spool takes; negative: before them. NaN where nothing tells.
        drift: by how much more in each second.
    """

    late: np.ndarray
    drift: float = 0.0

    def lateness(self, time: np.ndarray) -> float | np.ndarray:
        """Return by how much commands stamped `time` (N,) act late, on average of the cylinders."""
        return float(np.nanmean(self.late)) + self.drift * (time - time.mean())


def clock_of(machine: Machine, grid: Grid) -> Clock | None:
    """Return how late the machine acts on its commands; None where no piston follows them however late."""
    stands = _misfits(machine, grid, np.zeros(1))
    if stands is None or np.isnan(stands).all():
        return None
    late, misfit = np.where(np.isnan(stands[0]), np.nan, 0.0), stands[0]
    if _could_gain(misfit).any():
        late = _best(machine, grid, np.zeros(stands.shape[1]), _COARSE)[1]
        misfit, late = _best(machine, grid, late, _FINE)
    told = np.log((stands[0] + _BEST) / (misfit + _BEST)) > _BETTER
    late = np.where(misfit < _FOLLOWS, np.where(told, late, 0.0), np.nan)
    if np.isnan(late).all():
        return None
    return Clock(late, _drift(machine, grid, late, misfit))


def _could_gain(misfit: np.ndarray) -> np.ndarray:
    """Return where misfits (n,) leave room for a clock that is better by enough."""
    return np.asarray(np.log((misfit + _BEST) / _BEST) > _BETTER)


def _misfits(machine: Machine, grid: Grid, late: np.ndarray, drift: float = 0.0) -> np.ndarray | None:
    return flow_misfits(machine, grid, late[:, None] + drift * (grid.time - grid.time.mean()))


def _best(
    machine: Machine, grid: Grid, around: np.ndarray, steps: np.ndarray, drift: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return the least misfit of each cylinder (cylinders,) and the lateness that has it, by steps around given ones."""
    tried = np.unique(np.round(np.nan_to_num(around)[:, None] + steps, 6))
    found = _misfits(machine, grid, tried, drift)
    assert found is not None
    known = ~np.isnan(found).all(axis=0)
    at = np.nanargmin(np.where(known, found, 0.0), axis=0)
    return np.where(known, found[at, np.arange(found.shape[1])], np.nan), np.where(known, tried[at], np.nan)


def _drift(machine: Machine, grid: Grid, late: np.ndarray, misfit: np.ndarray) -> float:
    """Return the drift with which every piston follows its commands far better, 0 if there is none."""
    steps, seen = np.arange(-0.4, 0.401, 0.1), ~np.isnan(late)
    if not _could_gain(misfit[seen]).any():
        return 0.0

    def left(drift: float) -> float:
        return float(np.mean(np.log(_best(machine, grid, late, steps, drift)[0][seen] + _BEST)))

    coarse = min(_DRIFTS.tolist(), key=left)
    fine = min((coarse + 0.5 * abs(coarse) * _FINE_DRIFTS).tolist(), key=left)
    gains = np.log(misfit[seen] + _BEST) - np.log(_best(machine, grid, late, steps, fine)[0][seen] + _BEST)
    return fine if gains.min() > 0.0 and gains.mean() > _BETTER else 0.0


def mended(grid: Grid, clock: Clock, commands: tuple[str, ...]) -> Grid:
    """Return the grid with its commands on the sensors' clock."""
    when = grid.time - clock.lateness(grid.time)
    moved = {n: np.interp(when, grid.time, grid.channels[n]) for n in commands}
    return replace(grid, channels={**grid.channels, **moved})
