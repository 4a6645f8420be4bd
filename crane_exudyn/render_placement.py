"""Where the parts of a machine are drawn: the closed geometry places every one of them."""

from __future__ import annotations

import numpy as np

from . import render_shapes as shapes
from .crane import Crane
from .geometry import Pose, pose


def coordinates(crane: Crane, positions: np.ndarray, theta: np.ndarray | float = 0.0) -> np.ndarray:
    """Return x, y, angle of every part of `render_shapes.part_names` at n poses, shape (n, 3 * parts), in m and rad.

    Args:
        positions: (n, coordinates) or (coordinates,) independent coordinates.
        theta: angle of the payload's pendulum, where the crane has one (hook `pendulum`).
    """
    machine, closed = crane.machine, pose(crane, *np.atleast_2d(positions).T)
    short = dict(zip(machine.points, machine.point_names, strict=True))
    placed = {}
    for name in machine.bodies:
        point = next(p for p, body in machine.points.items() if body == name)
        placed[f"bodies.{name}"] = (
            _origin(closed, name, short[point], shapes.place(crane, point)),
            closed.angles[name],
        )
    for cylinder in machine.cylinders:
        base, end = (closed.points[short[p]] for p in cylinder.points)
        line = np.arctan2(*(end - base).T[::-1])
        placed |= {f"cylinders.{cylinder.name}.barrel": (base, line), f"cylinders.{cylinder.name}.rod": (end, line)}
    body, point = machine.payload
    if body:
        tip, length, swing = (
            closed.points[short[point]],
            shapes.pendulum_length(crane),
            np.broadcast_to(theta, len(closed.lengths)),
        )
        hanging = tip + length * np.column_stack([np.sin(swing), -np.cos(swing)])
        placed |= {"rope": (tip, swing), "payload": (hanging, swing if length > 0.0 else closed.angles[body])}
    return np.column_stack([np.column_stack(placed[part]) for part in shapes.part_names(crane)])


def _origin(closed: Pose, body: str, point: str, local: np.ndarray) -> np.ndarray:
    """Return where the origin (n, 2) of a body's frame lies, from one of its points, which is at `local` in that
    frame.
    """
    c, s = np.cos(closed.angles[body]), np.sin(closed.angles[body])
    turned = np.column_stack([c * local[0] - s * local[1], s * local[0] + c * local[1]])
    return np.asarray(closed.points[point] - turned)


def box_corners(points: np.ndarray, margin: float, half: float) -> np.ndarray:
    """Return the corners (8n, 3) of boxes around points (n, 2): a margin in the plane, half a width across it."""
    corners = [(x, y, z) for x in (-margin, margin) for y in (-margin, margin) for z in (-half, half)]
    return np.vstack([np.column_stack([points, np.zeros(len(points))]) + corner for corner in corners])


def in_world(graphics: shapes.Graphics, frame: np.ndarray) -> shapes.Graphics:
    """Return graphics of a part's frame in world coordinates; frame is x, y, angle."""
    return shapes.moved(graphics, (frame[0], frame[1], 0.0), frame[2])
