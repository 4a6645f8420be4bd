"""Sigma points and means that stay physical: pressures not below the vapour floor, pistons inside their cylinders.

Clipping sigma points would move the mean and shrink the covariance. Instead each point is propagated from the nearest
physical state and its excess is carried through unchanged::

    f⁺(χ) = f(χ') + (χ - χ'),    χ' = χ clipped to the limits

Inside the limits f⁺ = f. Outside, f⁺ extends f linearly with unit slope, so the spread of the points, and with it the
covariance, survives, and no engine ever sees an impossible state. A corrected mean with a pressure below the floor is
moved back along the covariance, to the most probable state on the limit (Simon, IET Control Theory Appl. 4 (2010)
1303): x - P_i/P_ii (x_i - limit). States that are correlated with it move along. Angles are not moved: vapour is a
fact, but strokes come from a crane file, and where the sensors are beyond them it is the file that is wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.crane import Crane


@dataclass(frozen=True)
class Bounds:
    """Limits `lower` (n,) and `upper` (n,) of the states; infinite where there is none."""

    lower: np.ndarray
    upper: np.ndarray

    def without(self, columns: slice) -> Bounds:
        """Return the same limits but for some states, which are left free."""
        lower, upper = self.lower.copy(), self.upper.copy()
        lower[columns], upper[columns] = -np.inf, np.inf
        return Bounds(lower, upper)

    def split(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the physical points (m, n) and the excess (m, n), or None where all points are physical."""
        if not _outside(points, self.lower, self.upper):
            return points, None
        return _clipped(points, self.lower, self.upper)

    def broken(self, mean: np.ndarray) -> bool:
        """Whether a mean (n,) is outside."""
        return bool(_outside(mean.reshape(1, -1), self.lower, self.upper))

    def project(self, mean: np.ndarray, covariance: np.ndarray) -> np.ndarray:
        """Return the mean (n,) moved inside along the covariance (n, n); the same array where it is inside."""
        if not self.broken(mean):
            return mean
        out = mean.copy()
        for i in np.flatnonzero((mean < self.lower) | (mean > self.upper)):
            target = np.clip(out[i], self.lower[i], self.upper[i])
            out -= covariance[:, i] / covariance[i, i] * (out[i] - target)
        return np.clip(out, self.lower, self.upper)


@njit()
def _outside(points, lower, upper):  # type: ignore[no-untyped-def]
    for k in range(points.shape[0]):
        for i in range(points.shape[1]):
            if points[k, i] < lower[i] or points[k, i] > upper[i]:
                return True
    return False


@njit()
def _clipped(points, lower, upper):  # type: ignore[no-untyped-def]
    inside, excess = points.copy(), np.zeros_like(points)
    for k in range(points.shape[0]):
        for i in range(points.shape[1]):
            inside[k, i] = min(max(points[k, i], lower[i]), upper[i])
            excess[k, i] = points[k, i] - inside[k, i]
    return inside, excess


#: largest share of a chamber that may be void; a state remembers a void as a pressure that far below zero
_MOST_VOID = 0.5
#: what keeps both chambers of a cylinder a little longer than nothing, m
_MARGIN = 5e-3
#: values of a coordinate at which a cylinder's length is looked at
_GRID = 1441


def crane_bounds(crane: Crane, lengths: Callable[[np.ndarray], np.ndarray] | None, states: int) -> Bounds:
    """Return the limits of a crane's states: half a chamber empty, and the coordinates at which a piston meets its
    cylinder's end.

    `lengths` maps z (m, n) to cylinder lengths (m, n), NaN where a loop cannot close; without it coordinates are free.
    """
    lower, upper = np.full(states, -np.inf), np.full(states, np.inf)
    lower[crane.layout.pressures] = -_MOST_VOID * crane["fluid.oil_bulk_modulus"]
    if lengths is not None:
        for c, (cylinder, driven) in enumerate(zip(crane.layout.cylinders, crane.layout.driven, strict=True)):
            i = crane.layout.index(driven)
            empty = crane[f"cylinders.{cylinder}.empty_length"] + _MARGIN
            full = empty + crane[f"cylinders.{cylinder}.chamber_range"] - 2 * _MARGIN
            start, turns = np.array(crane.initial.pose), crane.layout.unit_of(driven) == "rad"
            grid = np.linspace(-np.pi, np.pi, _GRID) if turns else start[i] + np.linspace(-2, 2, _GRID) * (full - empty)
            lower[i], upper[i] = _range(lengths, c, i, start, grid, empty, full)
    return Bounds(lower, upper)


def _range(
    lengths: Callable[[np.ndarray], np.ndarray],
    c: int,
    i: int,
    start: np.ndarray,
    grid: np.ndarray,
    empty: float,
    full: float,
) -> tuple[float, float]:
    """Return the connected range of coordinate i around the start in which the length of cylinder c stays in its
    limits.

    A boom may pass the pose at which its cylinder is shortest; nothing but the length is a limit.
    """
    z = np.tile(start, (grid.size, 1))
    z[:, i] = grid
    s = lengths(z)[:, c]
    good = (s > empty) & (s < full)  # a loop that cannot close has NaN lengths and is not good
    home = int(np.argmin(np.abs(grid - start[i])))
    if not good[home]:
        return -np.inf, np.inf
    below, above = np.flatnonzero(~good[:home]), np.flatnonzero(~good[home:])
    first = grid[below[-1] + 1] if below.size else -np.inf
    last = grid[home + above[0] - 1] if above.size else np.inf
    return float(first), float(last)
