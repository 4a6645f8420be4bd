"""A sketch of a machine's file: every body in its own frame with its points, and the whole machine at its start."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from . import render_shapes as shapes
from .crane import Crane
from .geometry import pose, told
from .machine import GROUND, PRISMATIC
from .plots import empty_figure, style
from .render import coordinates

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_INK, _SOFT, _CYLINDER, _COORDINATE = "#1b1b1b", "#666666", "#0072B2", "#B00062"
_MARK = "#FFB000"
_WIDTH, _WHOLE, _PANEL, _TITLE, _GAP = (
    11.0,
    5.6,
    3.1,
    0.34,
    0.2,
)  # inches: page, the whole machine, a body, a title, between
_OVERVIEW = (5.4, 3.0)  # inches: the machine alone
_SIZE = 8.5  # points of most texts
_MARGIN = 0.13  # share of a panel left free on each side for labels
_PALER = 0.62


def sketch(crane: Crane) -> Figure:
    """Return the figure: the machine in its start pose above, below it the ground and every body in its own frame."""
    names = (GROUND, *crane.machine.bodies)
    rows = math.ceil(len(names) / 2)
    height = _TITLE + _WHOLE + rows * (_TITLE + _PANEL) + _GAP
    with style():
        figure = empty_figure(_WIDTH, height)
        top = height - _TITLE
        _draw_machine(_Panel.on(figure, (_GAP, top - _WHOLE, _WIDTH - 2 * _GAP, _WHOLE), _told_start(crane)), crane)
        wide = (_WIDTH - 3 * _GAP) / 2
        for k, name in enumerate(names):
            row, column = divmod(k, 2)
            y = top - _WHOLE - (row + 1) * (_TITLE + _PANEL)
            box = (_GAP + column * (wide + _GAP), y, wide, _PANEL)
            _draw_frame(_Panel.on(figure, box, _told_body(crane, name)), crane, name)
    return figure


def overview(crane: Crane, marks: Sequence[str] = ()) -> Figure:
    """Return a figure of the machine at its start, on which places are marked.

    Args:
        crane: the machine.
        marks: cylinders, chambers, joints or sensors, by the machine's names; what has no place on it is left out.
    """
    wide, high = _OVERVIEW
    with style():
        figure = empty_figure(wide, high + _TITLE)
        panel = _Panel.on(figure, (0.05, 0.05, wide - 0.1, high), f"{crane.name} at its start")
        _draw_machine(panel, crane, marks)
    return figure


def _told_start(crane: Crane) -> str:
    started = told(crane.layout, np.array(crane.initial.pose)).replace("-", "−")
    return f"{crane.name} at its start: {started}"


def _told_body(crane: Crane, name: str) -> str:
    if name == GROUND:
        return "ground"
    return f"{name}: {crane[f'bodies.{name}.mass']:.4g} kg, {crane[f'bodies.{name}.inertia']:.4g} kg m² about c"


# -- a panel whose labels do not overlap -----------------------------------------------------------------------------


@dataclass
class _Panel:
    """Axes of a fixed size in inches, and what has been put into them.

    Attributes:
        taken: boxes (x0, y0, x1, y1) in points that labels stand in;  dots: places in points that labels keep clear of.
        labels: what is still to be placed: text, place (2,) in m, and how it looks.
    """

    axes: Axes
    inches: tuple[float, float]
    taken: list[tuple[float, ...]] = field(default_factory=list)
    dots: list[np.ndarray] = field(default_factory=list)
    labels: list[tuple[str, np.ndarray, dict[str, Any]]] = field(default_factory=list)

    @classmethod
    def on(cls, figure: Figure, box: tuple[float, float, float, float], title: str) -> _Panel:
        """Return a panel at a box (left, bottom, width, height) in inches of a figure, with a title above."""
        wide, high = figure.get_size_inches()
        axes = figure.add_axes((box[0] / wide, box[1] / high, box[2] / wide, box[3] / high))
        axes.set(xticks=[], yticks=[])
        axes.set_title(title, loc="left", fontsize=10, fontweight="bold", pad=4)
        for spine in axes.spines.values():
            spine.set(visible=True, color="#cccccc")
        return cls(axes, (box[2], box[3]))

    def show(self, places: np.ndarray) -> float:
        """Choose what the axes show, so that places (n, 2) in m have room for labels around; return m a point of the
        page.
        """
        low, high = places.min(axis=0), places.max(axis=0)
        scale = max((high - low) / (np.array(self.inches) * (1.0 - 2.0 * _MARGIN) * 72.0))
        half = 0.5 * scale * 72.0 * np.array(self.inches)
        middle = 0.5 * (low + high)
        (x0, y0), (x1, y1) = middle - half, middle + half
        self.axes.set(xlim=(x0, x1), ylim=(y0, y1))
        return float(scale)

    def draw_axes(self, scale: float) -> None:
        """Draw the axes of the frame that the panel shows; scale: m a point of the page."""
        for turn, name in ((0.0, "x"), (0.5 * math.pi, "y")):
            tip = 36.0 * scale * _toward(turn)
            _arrow(self.axes, np.zeros(2), tip)
            self.keep_clear([np.zeros(2), 1.3 * tip])
            self.axes.text(1.2 * tip[0], 1.2 * tip[1], name, ha="center", va="center", fontsize=_SIZE, color=_SOFT)

    def keep_clear(self, line: Iterable[np.ndarray]) -> None:
        """Keep labels off a line through places in m."""
        (x0, x1), (y0, y1) = self.axes.get_xlim(), self.axes.get_ylim()
        per = 72.0 * np.array(self.inches) / [x1 - x0, y1 - y0]
        corners = (np.array(list(line)) - [x0, y0]) * per
        for a, b in zip(corners, corners[1:] if len(corners) > 1 else corners, strict=False):
            self.dots += list(a + np.linspace(0.0, 1.0, 2 + int(math.dist(a, b) / 5.0))[:, None] * (b - a))

    def label(self, text: str, at: np.ndarray, **look: Any) -> None:
        """Note a text for a place in m; `place_labels` finds where there is room for it."""
        self.labels.append((text, np.asarray(at, dtype=float), look))

    def place_labels(self) -> None:
        """Write all labels where each overlaps least with what stands there, as near to its place as possible."""
        for text, at, look in self.labels:
            self._place(text, at, look)

    def _place(self, text: str, at: np.ndarray, look: dict[str, Any]) -> None:
        (x0, x1), (y0, y1) = self.axes.get_xlim(), self.axes.get_ylim()
        page = 72.0 * np.array(self.inches)
        own = (at - [x0, y0]) * page / [x1 - x0, y1 - y0]
        lines = text.split("\n")
        half = 0.5 * np.array([0.58 * _SIZE * max(map(len, lines)) + 4.0, 1.25 * _SIZE * len(lines) + 2.0])
        best = min(self._candidates(own, half, page), key=lambda c: c[0])[1]
        self.taken.append((*(best - half), *(best + half)))
        middle = np.array([x0, y0]) + best * [x1 - x0, y1 - y0] / page
        edge = np.clip(own, best - half, best + half)
        if math.dist(edge, own) > 9.0:
            end = np.array([x0, y0]) + edge * [x1 - x0, y1 - y0] / page
            self.axes.plot(*zip(at, end, strict=True), color=_SOFT, lw=0.6, zorder=7)
        self.axes.text(
            middle[0], middle[1], text, ha="center", va="center", fontsize=_SIZE, zorder=9, **({"color": _INK} | look)
        )

    def _candidates(self, own: np.ndarray, half: np.ndarray, page: np.ndarray) -> Iterable[tuple[float, np.ndarray]]:
        """Yield places for the middle of a label with what speaks against each."""
        dots = np.array(self.dots).reshape(-1, 2)
        starts, ends = np.split(np.array(self.taken).reshape(-1, 4), 2, axis=1)
        for away in (6.0, 14.0, 26.0, 40.0, 58.0, 80.0):
            for turn in np.radians(np.arange(0.0, 360.0, 22.5)):
                toward = np.array([math.cos(turn), math.sin(turn)])
                middle = own + toward * (away + half)
                low, top = middle - half, middle + half
                outside = float(np.maximum(2.0 - low, 0.0).sum() + np.maximum(top - page + 2.0, 0.0).sum())
                near = np.minimum(top, ends) - np.maximum(low, starts)
                over = float((np.maximum(near[:, 0], 0.0) * np.maximum(near[:, 1], 0.0)).sum())
                hit = int(((dots > low - 1.5) & (dots < top + 1.5)).all(axis=1).sum())
                yield 50.0 * outside + 5.0 * over + 20.0 * hit + away, middle


# -- what is drawn ---------------------------------------------------------------------------------------------------


def _draw_frame(panel: _Panel, crane: Crane, body: str) -> None:
    """Draw a body (or the ground) in its frame: shape, origin and axes, points with coordinates, centre of mass."""
    machine = crane.machine
    points = {
        name: shapes.place(crane, p)
        for (p, b), name in zip(machine.points.items(), machine.point_names, strict=True)
        if b == body
    }
    mass = [] if body == GROUND else [shapes.place(crane, f"bodies.{body}.com")]
    made = shapes.pillar(crane, _paint()) if body == GROUND else shapes.body_shape(crane, body, _paint())
    corners = _fill(panel.axes, [(made, (0.0, 0.0, 0.0))])
    panel.draw_axes(panel.show(np.vstack([np.zeros((1, 2)), corners, *points.values(), *mass])))
    own = None if body == GROUND else machine.carriers[body]
    if own is None or not own.own_pin:
        panel.label("origin" if own is None else f"origin, joint {own.name}", np.zeros(2), color=_SOFT)
    for at in points.values():
        panel.axes.plot(*at, "o", ms=5, mfc="white", mec=_INK, zorder=8)
        panel.keep_clear([at])
    for at in mass:
        panel.axes.plot(*at, "P", ms=7, mfc=_CYLINDER, mec="white", zorder=8)
        panel.keep_clear([at])
        panel.label(f"c {_pair(at)}", at, color=_CYLINDER)
    ordered = sorted(points.items(), key=lambda item: -item[1][1])
    for name, at in ordered:
        panel.label(f"{name} {_pair(at)}", at)
    panel.place_labels()


def _draw_machine(panel: _Panel, crane: Crane, marks: Sequence[str] = ()) -> None:
    """Draw the machine at its start, with joints, coordinates, cylinders and bodies by name, and marks at places."""
    machine, start = crane.machine, np.array(crane.initial.pose)
    closed = pose(crane, *start)
    points = {name: at[0] for name, at in closed.points.items()}
    short = dict(zip(machine.points, machine.point_names, strict=True))
    frames = coordinates(crane, start)[0].reshape(-1, 3)
    made = [
        *zip(shapes.parts(crane, _paint()).values(), frames, strict=True),
        (shapes.pillar(crane, _paint()), np.zeros(3)),
    ]
    scale = panel.show(np.vstack([np.zeros((1, 2)), _fill(panel.axes, made)]))
    panel.draw_axes(scale)
    for mark in marks:
        line = _place_of(crane, points, mark)
        look: dict[str, Any] = {"lw": 15, "solid_capstyle": "round"} if len(line) > 1 else {"marker": "o", "ms": 22}
        panel.axes.plot(*np.reshape(line, (-1, 2)).T, color=_MARK, alpha=0.6, zorder=5, **look)
        panel.keep_clear(line)
    angles = {GROUND: 0.0} | {name: float(angle[0]) for name, angle in closed.angles.items()}
    for joint in machine.joints:
        if joint.coordinate in machine.independent:
            at, turned = points[short[joint.pin]], angles[joint.carrier]
            if joint.kind == PRISMATIC:
                turned += crane[f"slides.{joint.name}.direction"]
                _arrow(panel.axes, at, at + 60.0 * scale * _toward(turned), _COORDINATE)
            else:
                _angle(panel, at, turned, angles[joint.body], scale)
    for joint in machine.joints:
        at = points[short[joint.pin]]
        panel.axes.plot(*at, "s" if joint.kind == PRISMATIC else "o", ms=5, mfc="white", mec=_INK, zorder=8)
        panel.keep_clear([at])
        own = joint.coordinate if joint.coordinate in machine.independent else ""
        panel.label(
            joint.name + (f": {own}" if own else ""), at, fontweight="bold", **({"color": _COORDINATE} if own else {})
        )
    for cylinder in machine.cylinders:
        base, end = (points[short[p]] for p in cylinder.points)
        panel.keep_clear([base, end])
        panel.label(
            f"{cylinder.name} cylinder\n{cylinder.chambers[0]}, {cylinder.chambers[1]}",
            0.5 * (base + end),
            color=_CYLINDER,
        )
    body, point = machine.payload
    if body:
        panel.axes.plot(*points[short[point]], "D", ms=4, mfc="white", mec=_INK, zorder=8)
        panel.label(f"payload at {short[point]}", points[short[point]])
    for name, frame in zip(machine.bodies, frames, strict=False):
        com, (x, y, angle) = shapes.place(crane, f"bodies.{name}.com"), frame
        c, s = math.cos(angle), math.sin(angle)
        panel.label(
            name, np.array([x + c * com[0] - s * com[1], y + s * com[0] + c * com[1]]), color=_SOFT, fontstyle="italic"
        )
    panel.place_labels()


def _place_of(crane: Crane, points: Mapping[str, np.ndarray], mark: str) -> list[np.ndarray]:
    """Return the line along which a place lies, in m: a cylinder, half of it for a chamber, a joint; nothing where it
    has none.
    """
    machine, lay = crane.machine, crane.layout
    short = dict(zip(machine.points, machine.point_names, strict=True))
    for c, cylinder in enumerate(machine.cylinders):
        base, end = (points[short[p]] for p in cylinder.points)
        if mark in (cylinder.name, lay.lengths[c]):
            return [base, end]
        if mark in cylinder.chambers:
            return [base, 0.5 * (base + end)] if mark == cylinder.chambers[0] else [0.5 * (base + end), end]
    return [points[short[j.pin]] for j in machine.joints if mark in (j.name, j.coordinate, f"{j.coordinate}_abs")]


def _paint() -> shapes.Paint:
    """Return the usual paint, paler, so that labels read on it."""
    usual = vars(shapes.Paint())
    pale = {
        k: (*(c + _PALER * (1.0 - c) for c in v[:3]), 1.0) for k, v in usual.items() if k not in ("edges", "barrels")
    }
    return shapes.Paint(**pale)  # type: ignore[arg-type]


def _fill(axes: Axes, parts: Iterable[tuple[Sequence[shapes.Graphics], Sequence[float]]]) -> np.ndarray:
    """Fill the side view of graphics, each list at a frame (x, y, angle), what is nearer over what is behind; return
    its corners (n, 2).
    """
    from matplotlib.collections import PolyCollection

    seen = []
    for made, (x, y, angle) in parts:
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        for part in made:
            points = np.reshape(part["points"], (-1, 3))
            seen.append((points[:, 2].max(), np.delete(points, 2, axis=1) @ turn + [x, y], part))
    for _, corners, part in sorted(seen, key=lambda s: s[0]):
        color = tuple(np.reshape(part["colors"], (-1, 4))[0])
        triangles = np.array(part["triangles"] if "triangles" in part else part["triangles6"])[
            :, :3
        ]  # the first three are corners
        axes.add_collection(
            PolyCollection(list(corners[triangles]), facecolors=[color], edgecolors=[color], linewidths=0.4),
            autolim=False,
        )
    return np.vstack([corners for _, corners, _ in seen])


def _angle(panel: _Panel, at: np.ndarray, start: float, end: float, scale: float) -> None:
    """Draw a coordinate as an arc from the direction of the carrier's x axis, which is dashed, to that of the
    body's.
    """
    for turn, dashes in ((start, (0, (4, 3))), (end, "-")):
        line = [at, at + 62.0 * scale * _toward(turn)]
        panel.axes.plot(*zip(*line, strict=True), color=_COORDINATE, lw=0.9, ls=dashes, zorder=6)
        panel.keep_clear(line)
    arc = at + 46.0 * scale * np.array([_toward(turn) for turn in np.linspace(start, end, 40)])
    panel.axes.plot(*arc[:-2].T, color=_COORDINATE, lw=0.9, zorder=6)
    _arrow(panel.axes, arc[-6], arc[-1], _COORDINATE)
    panel.keep_clear(arc)


def _toward(angle: float) -> np.ndarray:
    return np.array([math.cos(angle), math.sin(angle)])


def _arrow(axes: Axes, start: np.ndarray, end: np.ndarray, color: str = _SOFT) -> None:
    look = {"arrowstyle": "-|>", "color": color, "lw": 1.1, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (end[0], end[1]), (start[0], start[1]), arrowprops=look, zorder=6)


def _pair(at: np.ndarray) -> str:
    """Return coordinates in m, to 0.1 mm."""
    return "({:g}, {:g})".format(*(round(float(v), 4) + 0.0 for v in at)).replace("-", "−")
