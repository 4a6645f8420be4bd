"""The pose that sensors show: coordinates from their own sensors, from angles against the ground, or from lengths of
cylinders.
"""

from __future__ import annotations

from collections.abc import Container, Mapping
from typing import Any

import numpy as np

from .crane import Crane
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


def relative(layout: Layout, channels: Mapping[str, Any], known: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """Return the coordinates that channels show, rad or m, in the order of the layout: each from its own channel, or
    from that against the ground, where what carries it is there too; the others as they are `known`, or not at all.
    """
    found: dict[str, Any] = {}
    for name in layout.coordinates:
        carriers, against_ground = layout.carriers(name), f"{name}_abs"
        if name in channels:
            found[name] = channels[name]
        elif against_ground in channels and all(c in found for c in carriers):
            found[name] = channels[against_ground] - sum(found[c] for c in carriers)
        elif known is not None:
            found[name] = known[name]
    return found


def shown_pose(crane: Crane, shown: Mapping[str, float]) -> np.ndarray:
    """Return the coordinates (n,) that channels show (SI); those that none shows as the crane file has them."""
    lay, channels = crane.layout, dict(shown)
    filed = dict(zip(lay.coordinates, crane.initial.pose, strict=True))

    def pose() -> np.ndarray:
        return np.array([*relative(lay, channels, filed).values()])

    for i, (name, source) in enumerate(zip(lay.coordinates, sources(lay, shown), strict=True)):
        if source in lay.lengths:
            channels[name] = _coordinate_of_length(crane, pose(), i, lay.lengths.index(source), shown[source])
    return pose()


def _coordinate_of_length(crane: Crane, z: np.ndarray, i: int, cylinder: int, length: float) -> float:
    """Return the coordinate i nearest to z at which a cylinder has this length, or comes nearest to it."""
    from .geometry import cylinder_lengths  # compiled code, of which the effects must be part

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
