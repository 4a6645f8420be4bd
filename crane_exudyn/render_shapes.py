"""Shapes of a machine's parts as Exudyn graphics data, each in the frame of its own body.

Shapes follow from a machine's points, its centres of mass and its cylinders, so every machine looks like itself. Plates
stand in the plane of the machine and are drawn out sideways; how thick steel is follows from the bores. Of a body

- two pins and no more: a link of two plates;
- else a beam, from its farthest pin through the centre of mass to the pin behind that is most in line, with a knuckle
  plate around what lies
  behind its own pin, and lugs for cylinders' ends that stand off;
- one that slides: a beam about its centre of mass, and around it a sheath, the beam of its carrier.

The parts, with origin and x axis of their frames:

    bodies.NAME: as in the crane file
    cylinders.NAME.barrel: the base pin, x towards the rod end;   cylinders.NAME.rod: the rod end, x away from the base
    rope: the payload's point, hangs along -y; only where the payload hangs on a pendulum
    payload: its point, or the rope's end; turns with the body that carries it, or as the rope hangs
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from .crane import Crane
from .effects import hooks
from .exudyn_quietly import draw
from .machine import GROUND, PRISMATIC, Joint

Graphics = dict[str, Any]
Color = tuple[float, float, float, float]
Disc = tuple[float, float, float]  # x, y, radius

#: the bore in m of a machine with the sizes below, which are in m; others are larger or smaller by theirs
_USUAL_BORE = 0.1
#: half widths across the plane: beams, what one is narrower than its carrier, links and the next lane, the cheeks of a
#: lug
_BEAM, _NARROWER, _LINK, _LANE, _LUG = 0.085, 0.006, (0.098, 0.122), 0.026, (0.052, 0.07)
_PIN, _WALL, _LOG_LENGTH = 0.026, 0.011, 1.5
#: radii of a beam at its beginning, in its middle and at its end, and at most as a share of its length
_RADII, _SLIMMEST = (0.08, 0.095, 0.055), 0.2
#: how far a column's foot reaches to either side of its pin
_FOOT = (-0.35, 0.45)
#: how far arrows stand in front of the machine of the usual size, or of its payload, m
FRONT = 0.3
#: how thick pistons are, m
_PISTON = 0.03
#: m: the size of a grapple
_GRAPPLE = 0.12
#: a beam is at least so long, m, and bends at most by this share of its length
_SHORTEST, _MOST_BENT = 0.05, 0.35
#: share of a sliding body's beam that its sheath covers when it is drawn in
_SHEATHED = 0.75
#: m from a payload's point within which pins are those of the bucket
_BUCKET = 0.6
#: a body of two pins that is shorter than this share of the longest body is a link
_SHORT = 0.35


@dataclass(frozen=True)
class Paint:
    """Colours of one machine, RGBA.

    Attributes:
        beam, link, pillar, barrel, rod, pin, log, wood, soil: what each thing is painted with.
        edges: colour of the outlines.
        barrels: whether the barrels are drawn; without them the oil inside shows.
    """

    beam: Color = (0.86, 0.36, 0.07, 1.0)
    link: Color = (0.20, 0.22, 0.25, 1.0)
    pillar: Color = (0.33, 0.36, 0.40, 1.0)
    barrel: Color = (0.17, 0.19, 0.22, 1.0)
    rod: Color = (0.82, 0.84, 0.87, 1.0)
    pin: Color = (0.66, 0.68, 0.72, 1.0)
    log: Color = (0.45, 0.31, 0.19, 1.0)
    wood: Color = (0.86, 0.70, 0.47, 1.0)
    soil: Color = (0.50, 0.40, 0.28, 1.0)
    edges: Color = (0.10, 0.10, 0.11, 1.0)
    barrels: bool = True

    @classmethod
    def single(cls, color: tuple[float, float, float]) -> Paint:
        """Return a paint of one colour with dark outlines, for machines that are told apart by it."""
        fill = (*color, 1.0)
        edges = (*(0.35 * c for c in color), 1.0)
        names = ("beam", "link", "pillar", "barrel", "rod", "pin", "log", "wood", "soil")
        return cls(**dict.fromkeys(names, fill), edges=edges)  # type: ignore[arg-type]


# -- building blocks ---------------------------------------------------------------------------------------------------


def hull(discs: Iterable[Sequence[float]], segments: int = 20) -> np.ndarray:
    """Return the convex hull of discs (x, y, radius) as a polygon (n, 2), counter-clockwise (Andrew's monotone
    chain).
    """
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


def bent(start: np.ndarray, middle: np.ndarray, end: np.ndarray, radii: Sequence[float], steps: int = 16) -> np.ndarray:
    """Return the outline (n, 2), counter-clockwise, of a beam with round ends along a parabola through three points.

    radii: at the three points, between them along a parabola too.
    """
    share = float(np.clip(math.dist(start, middle) / (math.dist(start, middle) + math.dist(middle, end)), 0.2, 0.8))
    t = np.linspace(0.0, 1.0, steps)
    weights = np.column_stack(
        [(t - share) * (t - 1) / share, t * (t - 1) / (share * (share - 1)), t * (t - share) / (1 - share)]
    )
    line, radius = weights @ np.array([start, middle, end]), weights @ np.asarray(radii)
    along = np.gradient(line, axis=0)
    across = np.column_stack([-along[:, 1], along[:, 0]]) / np.linalg.norm(along, axis=1)[:, None]
    caps = []
    for k, first in ((-1, -0.5 * math.pi), (0, 0.5 * math.pi)):
        turn = first + math.atan2(along[k, 1], along[k, 0]) + np.linspace(0.0, math.pi, 9)[1:-1]
        caps.append(line[k] + radius[k] * np.column_stack([np.cos(turn), np.sin(turn)]))
    right, left = line - radius[:, None] * across, line + radius[:, None] * across
    return np.vstack([right, caps[0], left[::-1], caps[1]])


def plate(outline: np.ndarray, near: float, far: float, color: Color, edges: Color) -> Graphics:
    """Return an outline (n, 2) drawn out from z = near to z = far, with outlined rims."""
    n = len(outline)
    ring = [[i, (i + 1) % n] for i in range(n)]
    made: Graphics = draw.SolidExtrusion(
        outline.tolist(), ring, far - near, pOff=[0, 0, near], color=list(color), addEdges=True, edgeColor=list(edges)
    )
    return made


def bar(start: Sequence[float], axis: Sequence[float], radius: float, color: Color, edges: Color) -> Graphics:
    """Return a round bar from `start` along `axis` (both 3D, m)."""
    made: Graphics = draw.Cylinder(
        list(start), list(axis), radius, color=list(color), nTiles=32, addEdges=True, edgeColor=list(edges)
    )
    return made


def _across(at: np.ndarray, half: float, radius: float, color: Color, paint: Paint) -> Graphics:
    """Return a bar across the plane, such as a pin."""
    return bar([at[0], at[1], -half], [0, 0, 2 * half], radius, color, paint.edges)


def _cheeks(outline: np.ndarray, inner: float, outer: float, color: Color, paint: Paint) -> list[Graphics]:
    """Return two plates with what is between them left free."""
    return [plate(outline, near, far, color, paint.edges) for near, far in ((-outer, -inner), (inner, outer))]


# -- what the shape of a body follows from ---------------------------------------------------------------------------


def size(crane: Crane) -> float:
    """Return how thick the machine's steel is against that of the usual size: by its widest bore."""
    return max((crane[f"cylinders.{c.name}.bore"] for c in crane.machine.cylinders), default=_USUAL_BORE) / _USUAL_BORE


def place(crane: Crane, point: str) -> np.ndarray:
    """Return a point (2,) of the crane file in the frame of its body; the origin for ""."""
    return np.array([crane[f"{point}.x"], crane[f"{point}.y"]]) if point else np.zeros(2)


def joints_of(crane: Crane, body: str) -> Iterator[tuple[Joint, str]]:
    """Yield the joints on a body or the ground, and the point at which each one is; "" for the origin of its frame."""
    for joint in crane.machine.joints:
        if joint.carrier == body:
            yield joint, joint.pin
        elif joint.body == body:
            yield joint, joint.own_pin


@dataclass(frozen=True)
class _Body:
    """The places of a body in its own frame that its shape follows from; all (2,) in m.

    Attributes:
        root: its own pin;  pins: of all revolute joints on it, the own one and the payload's point among them.
        ends: ends of cylinders.
        com: its centre of mass.
        sheath: beginning and end of the sheath around a body that slides in it, or None.
        slides: whether it slides itself.
    """

    root: np.ndarray
    pins: list[np.ndarray]
    ends: list[np.ndarray]
    com: np.ndarray
    sheath: tuple[np.ndarray, np.ndarray] | None
    slides: bool

    @property
    def length(self) -> float:
        """Distance of the two places that are farthest from one another."""
        places = np.array([*self.pins, *self.ends])
        return float(max((math.dist(a, b) for a in places for b in places), default=0.0))


def _body(crane: Crane, name: str) -> _Body:
    machine = crane.machine
    joints = list(joints_of(crane, name))
    slides = machine.carriers[name].kind == PRISMATIC
    pins = [place(crane, point) for joint, point in joints if joint.kind != PRISMATIC]
    if machine.payload[0] == name:
        pins.append(place(crane, machine.payload[1]))
    ends = [place(crane, p) for c in machine.cylinders for b, p in zip(c.bodies, c.points, strict=True) if b == name]
    com = np.array([crane[f"bodies.{name}.com.x"], crane[f"bodies.{name}.com.y"]])
    root = place(crane, machine.carriers[name].own_pin)
    return _Body(root, pins, ends, com, _sheath(crane, name), slides)


def _sheath(crane: Crane, carrier: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Return where the sheath around a sliding body begins and ends, in the frame of its carrier; None without one."""
    for joint, point in joints_of(crane, carrier):
        if joint.kind == PRISMATIC and joint.carrier == carrier:
            start, _, end = _axis(_body(crane, joint.body))
            moved = place(crane, point) - place(crane, joint.own_pin)
            return start + moved, start + _SHEATHED * (end - start) + moved
    return None


def _axis(body: _Body) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return beginning, middle and end of a body's beam."""
    if body.sheath is not None:
        return body.sheath[0], 0.5 * (body.sheath[0] + body.sheath[1]), body.sheath[1]
    others = [p for p in body.pins if math.dist(p, body.root) > 1e-3] or body.ends or [2.0 * body.com - body.root]
    begin = body.com if body.slides else body.root
    end = max(others, key=lambda p: math.dist(p, begin))
    if math.dist(end, begin) < _SHORTEST:
        end = begin + np.array([_SHORTEST, 0.0])
    if body.slides:
        return 2.0 * body.com - end, body.com, end
    length, along = math.dist(end, body.root), end - body.root
    share, off = float((body.com - body.root) @ along) / length**2, _cross(along, body.com - body.root) / length**2
    middle = body.com if 0.2 < share < 0.8 and abs(off) < _MOST_BENT else 0.5 * (body.root + end)
    back = (middle - end) / math.dist(middle, end)
    start = max(_behind(body, end), key=lambda p: float((p - middle) @ back) / max(math.dist(p, middle), 1e-9))
    return start, middle, end


def _behind(body: _Body, end: np.ndarray) -> list[np.ndarray]:
    """Return the own pin of a body, and what lies behind it as seen from the end of its beam."""
    behind = [p for p in (*body.pins, *body.ends) if float((p - body.root) @ (end - body.root)) < 0.0]
    return [body.root, *behind]


# -- bodies ----------------------------------------------------------------------------------------------------------


def body_shape(crane: Crane, name: str, paint: Paint, color: Color | None = None) -> list[Graphics]:
    """Return the graphics of a body in its own frame; color: of its steel but the pins, if not the paint's."""
    body, unit = _body(crane, name), size(crane)
    links = [b for b in crane.machine.bodies if _is_link(crane, _body(crane, b))]
    if name in links:
        return _link(body, unit, links.index(name) % 2, paint, color or paint.link)
    half = unit * (_BEAM - _NARROWER * (len(crane.machine.path(name)) - 1) - (0.02 if body.slides else 0.0))
    half = max(half, 0.5 * unit * _BEAM)
    bucket = _bucket(crane, name)
    if bucket is None:
        return _beam(body, unit, half, paint, color or paint.beam)
    near = [p for p in body.pins if math.dist(p, body.pins[-1]) < _BUCKET]
    whole = math.dist(body.root, body.pins[-1]) < _BUCKET  # the body is the bucket, with no boom before it
    made = _beam(body, unit, half, paint, color or (paint.link if whole else paint.beam))
    outline = hull([*bucket, *((*p, 2.0 * _PIN * unit) for p in near)])
    return made + _cheeks(outline, _load_half(crane), _load_half(crane) + 0.02, color or paint.link, paint)


def _is_link(crane: Crane, body: _Body) -> bool:
    """Whether a body is short and has two pins, and no cylinder away from them."""
    longest = max(_body(crane, b).length for b in crane.machine.bodies)
    near = 0.06 * size(crane)
    two = len(body.pins) == 2 and all(min(math.dist(e, p) for p in body.pins) < near for e in body.ends)
    return two and not body.slides and body.length < _SHORT * longest and body.sheath is None


def _link(body: _Body, unit: float, lane: int, paint: Paint, color: Color) -> list[Graphics]:
    """Return two plates from pin to pin; lanes keep links of one loop beside each other."""
    near, far = (unit * (s + _LANE * lane) for s in _LINK)
    start, end = body.pins
    outline = hull([(*start, 0.05 * unit), (*(0.5 * (start + end)), 0.055 * unit), (*end, 0.05 * unit)])
    return [
        *_cheeks(outline, near, far, color, paint),
        *(_across(p, 0.16 * unit, _PIN * unit, paint.pin, paint) for p in body.pins),
    ]


def _beam(body: _Body, unit: float, half: float, paint: Paint, color: Color) -> list[Graphics]:
    """Return the beam of a body with its knuckle, lugs and pins."""
    start, middle, end = _axis(body)
    radii = [min(r * unit * (0.7 if body.slides else 1.0), _SLIMMEST * math.dist(start, end)) for r in _RADII]
    if body.sheath is not None or body.slides:
        radii = [radii[1 if body.sheath is not None else 2]] * 3
    made = [plate(bent(start, middle, end, radii), -half, half, color, paint.edges)]
    root = start + 0.35 * (middle - start)
    knuckle = _behind(body, end)
    if len(knuckle) > 1 or (math.dist(start, body.root) > 1e-3 and not body.slides):
        discs = [*((*p, 0.07 * unit) for p in knuckle), (*root, 0.8 * radii[1])]
        made.append(plate(hull(discs), -half + 0.004 * unit, half - 0.004 * unit, color, paint.edges))
    for p in (*body.pins, *body.ends):
        if not any(p is k for k in knuckle):
            made += _lug(
                p, (start, middle, end), radii[1], unit, half, paint, color, solid=any(p is q for q in body.pins)
            )
        made.append(_across(p, half + 0.012 * unit, 1.8 * _PIN * unit, color, paint))
        made.append(_across(p, half + 0.05 * unit, _PIN * unit, paint.pin, paint))
    return made


def _lug(
    tip: np.ndarray,
    line: Sequence[np.ndarray],
    radius: float,
    unit: float,
    half: float,
    paint: Paint,
    color: Color,
    *,
    solid: bool,
) -> list[Graphics]:
    """Return what holds a pin at `tip` that stands off a beam along `line`: two cheeks, or a solid plate for a
    joint.
    """
    distance, foot, along = min((_foot(tip, a, b) for a, b in pairwise(line)), key=lambda found: found[0])
    if distance < 0.9 * radius:
        return []
    wide = min(0.14 * unit, 0.3 * math.dist(line[0], line[-1]))
    outline = hull([(*tip, 2.0 * _PIN * unit), *((*(foot + s * wide * along), 0.03 * unit) for s in (-1.0, 1.0))])
    if solid:
        return [plate(outline, -half + 0.006 * unit, half - 0.006 * unit, color, paint.edges)]
    return _cheeks(outline, _LUG[0] * unit, _LUG[1] * unit, color, paint)


def _foot(tip: np.ndarray, start: np.ndarray, end: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """Return distance of a point from a line between two points, where it is nearest, and the line's direction."""
    along = (end - start) / math.dist(start, end)
    foot = start + np.clip(float((tip - start) @ along), 0.0, math.dist(start, end)) * along
    return math.dist(tip, foot), foot, along


# -- ground ----------------------------------------------------------------------------------------------------------


def pillar(crane: Crane, paint: Paint, floor: float = 0.0) -> list[Graphics]:
    """Return what is fixed, in world coordinates: a column for each pin on the ground, lugs for cylinders; floor: its
    height in m.
    """
    machine, unit, made = crane.machine, size(crane), []
    pins = ground_pins(crane)
    for pin in pins:
        made += _column(pin, floor, unit, paint)
    sheath = _sheath(crane, GROUND)
    if sheath is not None:
        start, end = sheath
        made.append(
            plate(
                bent(start, 0.5 * (start + end), end, [_RADII[1] * unit] * 3),
                -0.1 * unit,
                0.1 * unit,
                paint.pillar,
                paint.edges,
            )
        )
        made += _column(start, floor, unit, paint)
    for cylinder in machine.cylinders:
        for body, point in zip(cylinder.bodies, cylinder.points, strict=True):
            if body == GROUND:
                made += _ground_lug(place(crane, point), pins, floor, unit, paint)
    return made


def ground_pins(crane: Crane) -> list[np.ndarray]:
    """Return the pins (2,) on the ground."""
    return [place(crane, p) for joint, p in joints_of(crane, GROUND) if joint.kind != PRISMATIC]


def feet(pins: Sequence[np.ndarray], unit: float) -> tuple[float, float]:
    """Return from which x to which x the feet of the columns at some pins reach, m; unit: `size`."""
    return min(p[0] for p in pins) + _FOOT[0] * unit, max(p[0] for p in pins) + _FOOT[1] * unit


def _column(pin: np.ndarray, floor: float, unit: float, paint: Paint) -> list[Graphics]:
    """Return foot, column and cheeks that hold a pin on the ground."""
    x, height = pin[0], pin[1] - floor
    left, right = feet([pin], unit)
    foot = hull([(left + 0.03, floor + 0.03, 0.03), (right - 0.03, floor + 0.03, 0.03)])
    top = floor + min(0.82 * height, height - 0.1 * unit)
    column = hull([(x - 0.12 * unit, floor + 0.06, 0.02), (x + 0.12 * unit, floor + 0.06, 0.02), (x, top, 0.13 * unit)])
    cheeks = hull([(x, top - 0.1 * height, 0.12 * unit), (*pin, 0.085 * unit)])
    inner = _BEAM * unit + 0.006
    return [
        plate(foot, -0.32 * unit, 0.32 * unit, paint.pillar, paint.edges),
        plate(column, -0.14 * unit, 0.14 * unit, paint.pillar, paint.edges),
        *_cheeks(cheeks, inner, inner + 0.03 * unit, paint.pillar, paint),
        _across(pin, 0.15 * unit, _PIN * unit, paint.pin, paint),
    ]


def _ground_lug(at: np.ndarray, pins: Sequence[np.ndarray], floor: float, unit: float, paint: Paint) -> list[Graphics]:
    """Return a lug that holds a cylinder's end: on the nearest column, or on the floor."""
    column = min((p[0] for p in pins), key=lambda x: abs(x - at[0]), default=math.inf)
    reach = 0.12 * unit
    if abs(column - at[0]) < 0.6 * unit and at[1] - floor > 2.0 * reach:
        x = column + math.copysign(0.08 * unit, at[0] - column)
        feet = [(x, at[1] - reach, 0.02 * unit), (x, at[1] + reach, 0.02 * unit)]
    else:
        feet = [(at[0] - reach, floor + 0.02, 0.02), (at[0] + reach, floor + 0.02, 0.02)]
    outline = hull([(*at, 2.0 * _PIN * unit), *feet])
    return [
        *_cheeks(outline, _LUG[0] * unit, _LUG[1] * unit, paint.pillar, paint),
        _across(at, 0.1 * unit, _PIN * unit, paint.pin, paint),
    ]


def ground(
    middle: float,
    radius: float,
    floor: float,
    thick: float,
    color: Color = (0.80, 0.81, 0.78, 1.0),
    line: Color = (0.70, 0.71, 0.68, 1.0),
) -> list[Graphics]:
    """Return the floor at a height, round about x = middle so that its far edge is level from every side, with lines
    every metre; all in m.
    """
    top = floor + 0.003
    disc = draw.Cylinder([middle, floor - thick, 0.0], [0.0, thick, 0.0], radius, color=list(color), nTiles=180)
    made: list[Graphics] = [disc]
    for at in np.arange(math.ceil(middle - radius), middle + radius):
        half = math.sqrt(radius**2 - (at - middle) ** 2)
        made.append(draw.Lines([[at, top, -half], [at, top, half]], color=list(line)))
    for at in np.arange(math.ceil(-radius), radius):
        half = math.sqrt(radius**2 - at**2)
        made.append(draw.Lines([[middle - half, top, at], [middle + half, top, at]], color=list(line)))
    return made


# -- cylinders -------------------------------------------------------------------------------------------------------


def barrel(crane: Crane, cylinder: str, paint: Paint) -> list[Graphics]:
    """Return the barrel of a cylinder in its own frame, with an eye at the base pin; only its caps if oil is to be
    seen.
    """
    radius, unit = _outer_radius(crane, cylinder), _bore(crane, cylinder) / _USUAL_BORE
    start, length = _barrel_span(crane, cylinder)
    half = 0.05 * unit
    eye = plate(hull([(0, 0, 0.045 * unit), (0.07 * unit, 0, radius * 0.8)]), -half, half, paint.barrel, paint.edges)
    if not paint.barrels:
        caps = [(start, 0.02), (start + length - 0.03, 0.03)]
        return [eye, *(bar([at, 0, 0], [w, 0, 0], radius, paint.barrel, paint.edges) for at, w in caps)]
    gland = bar([start + length - 0.04, 0, 0], [0.04, 0, 0], radius * 1.13, paint.barrel, paint.edges)
    return [eye, bar([start, 0, 0], [length, 0, 0], radius, paint.barrel, paint.edges), gland]


def _bore(crane: Crane, cylinder: str) -> float:
    return crane[f"cylinders.{cylinder}.bore"]


def _outer_radius(crane: Crane, cylinder: str) -> float:
    """Return the radius of a cylinder's barrel with its wall, m."""
    return _bore(crane, cylinder) * (0.5 + _WALL / _USUAL_BORE)


def _barrel_span(crane: Crane, cylinder: str) -> tuple[float, float]:
    """Return where the barrel begins along the cylinder's axis, and its length: up to short of the rod eye when drawn
    in.
    """
    start, shortest = 0.6 * _bore(crane, cylinder), _shortest(crane, cylinder)
    return start, max(0.3 * shortest, shortest - start - _bore(crane, cylinder))


def _shortest(crane: Crane, cylinder: str) -> float:
    """Return the pin-to-pin length with the rod drawn in.

    A real cylinder is longer than its stroke then, whichever way round a sheet means `empty_length` and
    `chamber_range`; their sum, the greatest length, is the same either way.
    """
    return max(crane[f"cylinders.{cylinder}.empty_length"], crane[f"cylinders.{cylinder}.chamber_range"])


def rod(crane: Crane, cylinder: str, paint: Paint) -> list[Graphics]:
    """Return the rod of a cylinder in its own frame: eye at the rod end, rod reaching back into the barrel."""
    radius, unit = crane[f"cylinders.{cylinder}.rod"] / 2.0, _bore(crane, cylinder) / _USUAL_BORE
    back, half = _rod_length(crane, cylinder), 0.048 * unit
    eye = plate(hull([(0, 0, 0.042 * unit), (-0.05 * unit, 0, radius)]), -half, half, paint.barrel, paint.edges)
    return [
        eye,
        bar(
            [-back, 0, 0], [back - 0.03 * unit, 0, 0], max(radius, 0.1 * _bore(crane, cylinder)), paint.rod, paint.edges
        ),
    ]


def _rod_length(crane: Crane, cylinder: str) -> float:
    """Return the distance from the rod end to the piston, which stands at the barrel's foot when the rod is drawn
    in.
    """
    return _shortest(crane, cylinder) - _barrel_span(crane, cylinder)[0] - 0.03


def oil(crane: Crane, cylinder: str, length: float, colors: tuple[Color, Color]) -> list[Graphics]:
    """Return the oil of both chambers in the barrel's frame, at a pin-to-pin length in m: piston side, piston, rod
    side.
    """
    radius = 0.5 * (_outer_radius(crane, cylinder) + 0.5 * _bore(crane, cylinder))
    (start, piston), (after, end) = chambers(crane, cylinder, length)
    dark: Color = (0.12, 0.12, 0.13, 1.0)
    return [
        bar([start, 0, 0], [piston - start, 0, 0], radius, colors[0], dark),
        bar([piston, 0, 0], [after - piston, 0, 0], radius * 1.04, dark, dark),
        bar([after, 0, 0], [end - after, 0, 0], radius, colors[1], dark),
    ]


def chambers(crane: Crane, cylinder: str, length: float) -> tuple[tuple[float, float], tuple[float, float]]:
    """Return from where to where in m the chambers reach along the axis of a cylinder of a pin-to-pin length in m:
    piston side, rod side.
    """
    start, whole = _barrel_span(crane, cylinder)
    piston = min(max(length - _rod_length(crane, cylinder), start), start + whole - 0.05)
    after = piston + _PISTON
    return (start, max(piston, start + 1e-3)), (after, max(start + whole, after + 1e-3))


# -- payload ---------------------------------------------------------------------------------------------------------


def payload(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return the payload about its point: a log across the plane where it is as high as wide, else a heap of soil."""
    corners = _corners(crane)
    if corners is not None:
        return [plate(hull(corners), -_load_half(crane), _load_half(crane), paint.soil, paint.edges)]
    radius, half = max(0.04, crane["payload.height"] / 2.0), _LOG_LENGTH / 2.0
    ends = [bar([0, 0, z], [0, 0, 0.004], 0.9 * radius, paint.wood, paint.edges) for z in (-half - 0.004, half)]
    rings = [bar([0, 0, half + 0.004], [0, 0, 0.002], 0.45 * radius, paint.log, paint.edges)]
    log = [bar([0, 0, -half], [0, 0, 2 * half], radius, paint.log, paint.edges), *ends, *rings]
    return [*log, *_grapple(radius, paint)]


def _grapple(radius: float, paint: Paint) -> list[Graphics]:
    """Return a grapple that holds a log of so many m: a rotator above it, and two pairs of claws around."""
    top = radius + 0.5 * _GRAPPLE
    made = [plate(hull([(0.0, top, 0.5 * _GRAPPLE)]), -1.2 * _GRAPPLE, 1.2 * _GRAPPLE, paint.link, paint.edges)]
    for side in (-1.0, 1.0):
        start, middle = np.array([0.0, top]), np.array([side * (radius + 0.4 * _GRAPPLE), 0.0])
        end = np.array([side * 0.2 * radius, -radius - 0.2 * _GRAPPLE])
        outline = bent(start, middle, end, [0.35 * _GRAPPLE, 0.3 * _GRAPPLE, 0.12 * _GRAPPLE])
        for at in (-1.0, 0.7):
            made.append(plate(outline, at * _GRAPPLE, (at + 0.3) * _GRAPPLE, paint.link, paint.edges))
    return made


def payload_extent(crane: Crane) -> tuple[float, float]:
    """Return how far the payload reaches from its point: in the plane and across it, in m; zeros without one."""
    if not crane.machine.payload[0]:
        return 0.0, 0.0
    width, height = crane["payload.width"], crane["payload.height"]
    round_ = _corners(crane) is None
    return (
        (max(0.04, height / 2.0) + _GRAPPLE, _LOG_LENGTH / 2.0)
        if round_
        else (0.5 * math.hypot(width, height), _load_half(crane))
    )


def _corners(crane: Crane) -> list[Disc] | None:
    """Return the corners of a payload that is wider than high or higher than wide, about its point; else None."""
    width, height = crane["payload.width"], crane["payload.height"]
    if abs(width - height) < 0.1 * max(width, height) or min(width, height) <= 0.0:
        return None
    r = 0.2 * min(width, height)
    return [(sx * (width / 2 - r), sy * (height / 2 - r), r) for sx in (-1, 1) for sy in (-1, 1)]


def _load_half(crane: Crane) -> float:
    """Return half of how far soil reaches across the plane, m."""
    return 0.6 * max(crane["payload.width"], crane["payload.height"])


def _bucket(crane: Crane, body: str) -> list[Disc] | None:
    """Return the corners of the bucket on a body, in its frame: around soil that is fixed to it; None without one."""
    carrier, point = crane.machine.payload
    corners = _corners(crane) if carrier == body and pendulum_length(crane) == 0.0 else None
    at = place(crane, point)
    return None if corners is None else [(at[0] + x, at[1] + y, r) for x, y, r in corners]


def pendulum_length(crane: Crane) -> float:
    """Return the length in m of the pendulum on which the payload hangs; 0 without one."""
    return float(hooks.plain("pendulum")(crane.effect_vector())[0])


def rope(crane: Crane, paint: Paint) -> list[Graphics]:
    """Return the rod from the payload's point down to the payload; nothing where it is fixed to its body."""
    length = pendulum_length(crane)
    return [bar([0, 0, 0], [0, -length, 0], 0.016, paint.rod, paint.edges)] if length > 0.0 else []


# -- all parts -------------------------------------------------------------------------------------------------------


def parts(crane: Crane, paint: Paint) -> Mapping[str, list[Graphics]]:
    """Return the graphics of every moving part by name, in the order of `part_names`."""
    made = {f"bodies.{name}": body_shape(crane, name, paint) for name in crane.machine.bodies}
    for c in crane.machine.cylinders:
        made[f"cylinders.{c.name}.barrel"] = barrel(crane, c.name, paint)
        made[f"cylinders.{c.name}.rod"] = rod(crane, c.name, paint)
    return made | {"rope": rope(crane, paint), "payload": payload(crane, paint)} if crane.machine.payload[0] else made


def part_names(crane: Crane) -> tuple[str, ...]:
    """Return the names of the moving parts: bodies, then barrel and rod of each cylinder, then rope and payload."""
    machine = crane.machine
    cylinders = [f"cylinders.{c.name}.{part}" for c in machine.cylinders for part in ("barrel", "rod")]
    return (*(f"bodies.{b}" for b in machine.bodies), *cylinders, *(("rope", "payload") if machine.payload[0] else ()))


def outlines(crane: Crane, centres: Mapping[str, np.ndarray]) -> dict[str, list[Graphics]]:
    """Return the graphics of the ground and of each body about its centre (2,) in its frame, with a payload that is
    fixed to it.

    A payload on a pendulum stands under the name "payload", about itself.
    """
    paint = Paint()
    made = {GROUND: pillar(crane, paint)} | {name: body_shape(crane, name, paint) for name in crane.machine.bodies}
    body, point = crane.machine.payload
    if body and pendulum_length(crane) > 0.0:
        made["payload"] = payload(crane, paint)
    elif body:
        made[body] += [moved(g, (*place(crane, point), 0.0)) for g in payload(crane, paint)]
    for name, (x, y) in centres.items():
        made[name] = [moved(g, (-x, -y, 0.0)) for g in made[name]]
    return made


def moved(graphics: Graphics, by: tuple[float, float, float], angle: float = 0.0) -> Graphics:
    """Return graphics turned about the z axis and then moved."""
    c, s = math.cos(angle), math.sin(angle)
    turned: Graphics = draw.Move(graphics, list(by), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    return turned


def arrow(tip: np.ndarray, direction: Sequence[float], length: float, color: Color) -> Graphics:
    """Return an arrow that ends at `tip` (3,), coming along a direction (2,) of the plane."""
    axis = length * np.array([*direction, 0.0]) / math.hypot(*direction)
    made: Graphics = draw.Arrow(
        (tip - axis).tolist(), axis.tolist(), radius=0.047 * length, color=list(color), nTiles=24
    )
    return made


def triangles(graphics: Graphics) -> np.ndarray:
    """Return the corners (n, 3, 3) of the triangles of graphics; none of lines."""
    key, width = ("triangles6", 6) if "triangles6" in graphics else ("triangles", 3)  # of six, three are corners
    corners = np.reshape(np.array(graphics.get(key, []), dtype=int), (-1, width))[:, :3]
    return np.reshape(graphics.get("points", []), (-1, 3))[corners]
