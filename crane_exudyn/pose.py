"""The pose that sensors show: coordinates from their own sensors, from angles against the ground, or from lengths of
cylinders.
"""

from __future__ import annotations

from collections.abc import Container, Mapping

import numpy as np

from .crane import Crane
from .geometry import cylinder_lengths
from .layout import Layout

#: rad or m about a pose within which the one with a cylinder's length is looked for, and at how many places
_REACH, _PLACES = 1.5, 4001
#: m by which lengths on that grid may differ and still be the same
_SAME_LENGTH = 1e-3
#: rad or m over which a length is differentiated, and m/rad below which it tells nothing of the coordinate
_STEP, _LEAST_LEVER = 1e-6, 1e-2


def sources(layout: Layout, channels: Container[str]) -> tuple[str, ...]:
    """Return the channel that each coordinate is taken from, "" where none shows it."""
    found = []
    for name in layout.coordinates:
        ways = (name, f"{name}_abs", layout.lengths[layout.driven.index(name)])
        found.append(next((n for n in ways if n in channels), ""))
    return tuple(found)


def shown_pose(crane: Crane, shown: Mapping[str, float]) -> np.ndarray:
    """Return the coordinates (n,) that channels show (SI); those that none shows as the crane file has them."""
    lay, z = crane.layout, np.array(crane.initial.pose)
    for i, (name, source) in enumerate(zip(lay.coordinates, sources(lay, shown), strict=True)):
        if source == name:
            z[i] = shown[name]
        elif source == f"{name}_abs":
            z[i] = shown[source] - z[[lay.index(n) for n in lay.carriers(name)]].sum()
        elif source:
            z[i] = _coordinate_of_length(crane, z, i, lay.lengths.index(source), shown[source])
    return z


def _coordinate_of_length(crane: Crane, z: np.ndarray, i: int, cylinder: int, length: float) -> float:
    """Return the coordinate i nearest to z at which a cylinder has this length, or comes nearest to it."""

    def lengths(values: np.ndarray) -> np.ndarray:
        poses = np.tile(z, (len(values), 1))
        poses[:, i] = values
        return cylinder_lengths(crane, poses)[:, cylinder]

    grid = z[i] + np.linspace(-_REACH, _REACH, _PLACES)
    off = np.abs(lengths(grid) - length)
    off = np.where(np.isfinite(off), off, np.inf)
    good = grid[off < off.min() + _SAME_LENGTH]
    found = float(good[np.argmin(np.abs(good - z[i]))])
    for _ in range(3):
        below, here, above = lengths(found + _STEP * np.array([-1.0, 0.0, 1.0]))
        lever = (above - below) / (2.0 * _STEP)
        if not abs(lever) > _LEAST_LEVER or not abs(here - length) < 2.0 * _SAME_LENGTH:
            break
        found -= float((here - length) / lever)
    return found
