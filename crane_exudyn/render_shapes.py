"""Shapes of the crane's parts as Exudyn graphics data, each in the frame of its own body.

Shapes follow from the crane's own points, so a crane of other proportions looks like itself. A plate is the convex hull
of discs in the plane of the crane, drawn out sideways; booms, brackets, lugs and the pillar are made of such plates.
Names of the parts, with origin and x axis of their frames:

    pillar (world) · lift_boom (O) · bracket_1 (B) · bracket_2 (C) · outer_boom (A): as in the crane file
    lift_barrel, tilt_barrel: the base pin F or H, x towards the rod end
    lift_rod, tilt_rod: the rod end G or C, x away from the base
    rope (E): hangs along -y; only where the payload hangs on a pendulum
    log (E, or the rope's end): parallel to the outer boom, or as the rope hangs
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from .crane import Crane
from .effects import hooks
from .mechanism import exu  # imports Exudyn quietly, and always the same build of it
from .parameters import LAYOUT

Graphics = dict[str, Any]
Color = tuple[float, float, float, float]
Disc = tuple[float, float, float]  # x, y, radius

PARTS = (
    "lift_boom", "bracket_1", "bracket_2", "outer_boom",
    "lift_barrel", "lift_rod", "tilt_barrel", "tilt_rod", "rope", "log",
)  # fmt: skip

#: half widths across the plane of the crane, m: what stands beside what
_LIFT, _OUTER, _EXTENSION, _BRACKET, _LUG = 0.085, 0.075, 0.055, (0.098, 0.122), 0.078
_PIN, _WALL, _LOG_LENGTH = 0.026, 0.011, 1.5


@dataclass(frozen=True)
class Paint:
    """Colours of one crane, RGBA.

    Attributes:
        boom, bracket, pillar, barrel, rod, pin, log, wood: what each thing is painted with.
        edges: colour of the outlines.
        barrels: whether the barrels are drawn; without them the oil inside shows.
    """

    boom: Color = (0.86, 0.36, 0.07, 1.0)
    bracket: Color = (0.20, 0.22, 0.25, 1.0)
    pillar: Color = (0.33, 0.36, 0.40, 1.0)
    barrel: Color = (0.17, 0.19, 0.22, 1.0)
    rod: Color = (0.82, 0.84, 0.87, 1.0)
    pin: Color = (0.66, 0.68, 0.72, 1.0)
    log: Color = (0.45, 0.31, 0.19, 1.0)
    wood: Color = (0.86, 0.70, 0.47, 1.0)
    edges: Color = (0.10, 0.10, 0.11, 1.0)
    barrels: bool = True

    @classmethod
    def single(cls, color: tuple[float, float, float]) -> Paint:
        """Return a paint of one colour with dark outlines, for cranes that are told apart by it."""
        fill = (*color, 1.0)
        edges = (*(0.35 * c for c in color), 1.0)
        names = ("boom", "bracket", "pillar", "barrel", "rod", "pin", "log", "wood")
        return cls(**dict.fromkeys(names, fill), edges=edges)  # type: ignore[arg-type]


# -- building blocks ---------------------------------------------------------------------------------------------------


def hull(discs: Iterable[Disc], segments: int = 20) -> np.ndarray:
    """Return the convex hull of discs as a polygon (n, 2), counter-clockwise (Andrew's monotone chain)."""
    turn = np.linspace(0.0, 2.0 * math.pi, segments, endpoint=False)
    rim = np.column_stack([np.cos(turn), np.sin(turn)])
    points = np.unique(np.vstack([np.array([x, y]) + r * rim for x, y, r in discs]).round(9), axis=0)
    lower, upper = _chain(points), _chain(points[::-1])
    return np.array(lower[:-1] + upper[:-1])


def _chain(points: np.ndarray) -> list[np.ndarray]:
    """Return the points of one side of the hull of sorted points, those that turn left."""
    kept: list[np.ndarray] = []
    for p in points:
        while len(kept) > 1 and _cross(kept[-1] - kept[-2], p - kept[-2]) <= 1e-12:
            kept.pop()
        kept.append(p)
    return kept


def _cross(a: np.ndarray, b: np.ndarray) -> float:
    return float(a[0] * b[1] - a[1] * b[0])


def plate(outline: np.ndarray, near: float, far: float, color: Color, edges: Color) -> Graphics:
    """Return a convex outline (n, 2) drawn out from z = near to z = far, with outlined rims."""
    from exudyn.graphics import SolidExtrusion

    n = len(outline)
    ring = [[i, (i + 1) % n] for i in range(n)]
    made: Graphics = SolidExtrusion(
        outline.tolist(), ring, far - near, pOff=[0, 0, near], color=list(color), addEdges=True, edgeColor=list(edges)
    )
    return made


def bar(start: Sequence[float], axis: Sequence[float], radius: float, color: Color, edges: Color) -> Graphics:
    """Return a round bar from `start` along `axis` (both 3D, m)."""
    from exudyn.graphics import Cylinder

    made: Graphics = Cylinder(
        list(start), list(axis), radius, color=list(color), nTiles=32, addEdges=True, edgeColor=list(edges)
    )
    return made


def _both_sides(discs: Sequence[Disc], half: float, color: Color, paint: Paint) -> Graphics:
    return plate(hull(discs), -half, half, color, paint.edges)


def _pin(at: tuple[float, float], paint: Paint, half: float = 0.135, radius: float = _PIN) -> Graphics:
    return bar([*at, -half], [0, 0, 2 * half], radius, paint.pin, paint.edges)


def _lug(tip: tuple[float, float], feet: Sequence[Disc], paint: Paint, color: Color) -> list[Graphics]:
    """Return two cheeks that hold a pin at `tip`, standing on `feet`."""
    outline = hull([(*tip, 2.0 * _PIN), *feet])
    inner, outer = _LUG - 0.018, _LUG
    return [plate(outline, -outer, -inner, color, paint.edges), plate(outline, inner, outer, color, paint.edges)]


def _point(crane: Crane, name: str) -> tuple[float, float]:
    return crane[f"{name}.x"], crane[f"{name}.y"]


# -- the parts ---------------------------------------------------------------------------------------------------------


def pillar(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return the fixed pillar in world coordinates: foot, column up to O, lug of the lift cylinder at F."""
    o, f = _point(crane, "joints.O"), _point(crane, "cylinders.lift.base")
    foot = plate(hull([(o[0] - 0.32, 0.03, 0.03), (o[0] + 0.42, 0.03, 0.03)]), -0.32, 0.32, paint.pillar, paint.edges)
    column = [(o[0] - 0.12, 0.06, 0.02), (o[0] + 0.12, 0.06, 0.02), (o[0], 0.82 * o[1], 0.13)]
    cheeks = hull([(o[0], 0.72 * o[1], 0.12), (*o, 0.085)])
    inner, outer = _LIFT + 0.006, _LIFT + 0.035
    parts = [foot, _both_sides(column, 0.13, paint.pillar, paint)]
    parts += [plate(cheeks, s, e, paint.pillar, paint.edges) for s, e in ((-outer, -inner), (inner, outer))]
    parts += _lug(f, [(o[0] + 0.08, f[1] - 0.12, 0.02), (o[0] + 0.08, f[1] + 0.12, 0.02)], paint, paint.pillar)
    return [*parts, _pin(o, paint, 0.15), _pin(f, paint, 0.1)]


def lift_boom(crane: Crane, paint: Paint, color: Color | None = None) -> list[Graphics]:
    """Return the lift boom: a tapered box from O to A with a lug below for G and one on top for H."""
    color = color or paint.boom
    a, b, g, h = (_point(crane, n) for n in ("joints.A", "joints.B", "cylinders.lift.rod_end", "cylinders.tilt.base"))
    waist = (0.42 * a[0], 0.055)
    profile = [(0.0, 0.0, 0.075), (0.12 * a[0], 0.03, 0.11), (*waist, 0.10), (*b, 0.06), (*a, 0.065)]
    parts = [_both_sides(profile, _LIFT, color, paint)]
    parts += _lug(g, [(g[0] - 0.12, 0.0, 0.03), (g[0] + 0.14, 0.0, 0.03)], paint, color)
    parts += _lug(h, [(h[0] - 0.16, waist[1] + 0.05, 0.02), (h[0] + 0.10, waist[1] + 0.05, 0.02)], paint, color)
    return [*parts, _pin(g, paint, 0.1), _pin(h, paint, 0.1), _pin(a, paint), _pin(b, paint)]


def _bracket(tip: tuple[float, float], waist: float, paint: Paint, lane: int) -> list[Graphics]:
    """Return two plates from the frame's origin to `tip`; lanes keep the two brackets beside each other."""
    near, far = (s + 0.026 * lane for s in _BRACKET)
    middle = (0.5 * tip[0], 0.5 * tip[1], waist)
    outline = hull([(0.0, 0.0, 0.05), middle, (*tip, 0.05)])
    return [plate(outline, s, e, paint.bracket, paint.edges) for s, e in ((-far, -near), (near, far))]


def bracket_1(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return bracket 1 from B to C, with the pin at C that also holds the tilt cylinder's rod."""
    c = _point(crane, "joints.C")
    return [*_bracket(c, 0.055, paint, 0), _pin(c, paint, 0.16)]


def bracket_2(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return bracket 2 from C to D, with the pin at D."""
    d = _point(crane, "joints.D_bracket")
    return [*_bracket(d, 0.05, paint, 1), _pin(d, paint, 0.16)]


def outer_boom(crane: Crane, paint: Paint, color: Color | None = None) -> list[Graphics]:
    """Return the outer boom: knuckle around A and D, box along the line to E, and the extension that slides out of it."""
    color = color or paint.boom
    d, e = _point(crane, "joints.D"), _point(crane, "joints.E")
    along = np.subtract(e, d) / math.dist(d, e)
    start, middle = np.add(d, 0.16 * along), np.add(d, 0.62 * math.dist(d, e) * along)
    knuckle = [(0.0, 0.0, 0.07), (*d, 0.07), (start[0] + 0.28, start[1] - 0.03, 0.06)]
    box = [(start[0], start[1], 0.085), (middle[0], middle[1], 0.07)]
    extension = [(middle[0] - 0.1, middle[1], 0.05), (*e, 0.045)]
    return [
        _both_sides(knuckle, _OUTER, color, paint),
        _both_sides(box, _OUTER + 0.004, color, paint),
        _both_sides(extension, _EXTENSION, color, paint),
        _pin(e, paint, 0.075),
    ]  # fmt: skip


def barrel(crane: Crane, cylinder: str, paint: Paint) -> list[Graphics]:
    """Return the barrel of a cylinder in its own frame, with an eye at the base pin; only its caps if oil is to be seen."""
    radius = crane[f"cylinders.{cylinder}.bore"] / 2.0 + _WALL
    start, length = _barrel_span(crane, cylinder)
    eye = _eye(radius, paint)
    if not paint.barrels:
        caps = [(start, 0.02), (start + length - 0.03, 0.03)]
        return [eye, *(bar([at, 0, 0], [w, 0, 0], radius, paint.barrel, paint.edges) for at, w in caps)]
    gland = bar([start + length - 0.04, 0, 0], [0.04, 0, 0], radius * 1.13, paint.barrel, paint.edges)
    return [eye, bar([start, 0, 0], [length, 0, 0], radius, paint.barrel, paint.edges), gland]


def _eye(radius: float, paint: Paint) -> Graphics:
    half = 0.05
    return plate(hull([(0, 0, 0.045), (0.07, 0, radius * 0.8)]), -half, half, paint.barrel, paint.edges)


def _barrel_span(crane: Crane, cylinder: str) -> tuple[float, float]:
    """Return where the barrel begins along the cylinder's axis, and its length: up to short of the rod eye when drawn in."""
    start = 0.06
    return start, max(0.25, _shortest(crane, cylinder) - start - 0.1)


def _shortest(crane: Crane, cylinder: str) -> float:
    """Return the pin-to-pin length with the rod drawn in.

    A real cylinder is longer than its stroke then, whichever way round the sheet means `empty_length` and
    `chamber_range` (see the note there); their sum, the greatest length, is the same either way.
    """
    return max(crane[f"cylinders.{cylinder}.empty_length"], crane[f"cylinders.{cylinder}.chamber_range"])


def rod(crane: Crane, cylinder: str, paint: Paint) -> list[Graphics]:
    """Return the rod of a cylinder in its own frame: eye at the rod end, rod reaching back into the barrel."""
    radius = crane[f"cylinders.{cylinder}.rod"] / 2.0
    back = _rod_length(crane, cylinder)
    half = 0.048
    eye = plate(hull([(0, 0, 0.042), (-0.05, 0, radius)]), -half, half, paint.barrel, paint.edges)
    return [eye, bar([-back, 0, 0], [back - 0.03, 0, 0], max(radius, 0.01), paint.rod, paint.edges)]


def _rod_length(crane: Crane, cylinder: str) -> float:
    """Return the distance from the rod end to the piston, which stands at the barrel's foot when the rod is drawn in."""
    return _shortest(crane, cylinder) - _barrel_span(crane, cylinder)[0] - 0.03


def log(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return the payload as a log across the plane, centred at E, with bark and sawn ends."""
    radius = max(0.04, crane["payload.height"] / 2.0)
    half = _LOG_LENGTH / 2.0
    ends = [bar([0, 0, z], [0, 0, 0.004], 0.9 * radius, paint.wood, paint.edges) for z in (-half - 0.004, half)]
    rings = [bar([0, 0, half + 0.004], [0, 0, 0.002], 0.45 * radius, paint.log, paint.edges)]
    return [bar([0, 0, -half], [0, 0, 2 * half], radius, paint.log, paint.edges), *ends, *rings]


def pendulum_length(crane: Crane) -> float:
    """Return the length in m of the pendulum on which the payload hangs; 0 without one."""
    return float(hooks.pendulum(crane.effect_vector())[0])


def rope(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return the rod from E down to the payload; nothing where the payload is fixed to the boom."""
    length = pendulum_length(crane)
    return [bar([0, 0, 0], [0, -length, 0], 0.016, paint.rod, paint.edges)] if length > 0.0 else []


def parts(crane: Crane, paint: Paint) -> Mapping[str, list[Graphics]]:
    """Return the graphics of every moving part by name, in the order of `PARTS`."""
    made = {
        "lift_boom": lift_boom(crane, paint),
        "bracket_1": bracket_1(crane, paint),
        "bracket_2": bracket_2(crane, paint),
        "outer_boom": outer_boom(crane, paint),
    }
    for name in LAYOUT.cylinders:
        made[f"{name}_barrel"] = barrel(crane, name, paint)
        made[f"{name}_rod"] = rod(crane, name, paint)
    return made | {"rope": rope(crane, paint), "log": log(crane, paint)}


def oil(crane: Crane, cylinder: str, length: float, colors: tuple[Color, Color]) -> list[Graphics]:
    """Return the oil of both chambers in the barrel's frame, at a pin-to-pin length in m: piston side, piston, rod side."""
    radius = crane[f"cylinders.{cylinder}.bore"] / 2.0 + _WALL * 0.5
    start, whole = _barrel_span(crane, cylinder)
    piston = min(max(length - _rod_length(crane, cylinder), start), start + whole - 0.05)
    thick = 0.03
    dark: Color = (0.12, 0.12, 0.13, 1.0)
    return [
        bar([start, 0, 0], [max(piston - start, 1e-3), 0, 0], radius, colors[0], dark),
        bar([piston, 0, 0], [thick, 0, 0], radius * 1.04, dark, dark),
        bar([piston + thick, 0, 0], [max(start + whole - piston - thick, 1e-3), 0, 0], radius, colors[1], dark),
    ]


def arrow(tip: Sequence[float], direction: Sequence[float], length: float, color: Color) -> Graphics:
    """Return an arrow in the plane z = 0.3 (in front of the crane) that ends at `tip`, coming along `direction`."""
    from exudyn.graphics import Arrow

    unit = np.asarray(direction, dtype=float) / math.hypot(*direction)
    start = np.asarray(tip, dtype=float) - length * unit
    made: Graphics = Arrow([*start, 0.3], [*(length * unit), 0.0], radius=0.026, color=list(color), nTiles=24)
    return made


def ground(color: Color = (0.80, 0.81, 0.78, 1.0), line: Color = (0.70, 0.71, 0.68, 1.0)) -> list[Graphics]:
    """Return the ground: a plate with lines every metre."""
    from exudyn.graphics import Brick, Lines

    plate_ = Brick([2.0, -0.03, 0.0], [10.0, 0.06, 3.6], color=list(color), addEdges=True, edgeColor=list(line))
    made: list[Graphics] = [plate_]
    for x in range(-2, 7):
        made.append(Lines([[x, 0.003, -1.8], [x, 0.003, 1.8]], color=list(line)))
    for z in (-1.2, -0.6, 0.0, 0.6, 1.2):
        made.append(Lines([[-3.0, 0.003, z], [7.0, 0.003, z]], color=list(line)))
    return made


__all__ = ["PARTS", "Graphics", "Paint", "arrow", "exu", "ground", "oil", "parts", "pillar"]
