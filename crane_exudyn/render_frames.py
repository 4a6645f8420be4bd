"""A sketch of a machine's file: every body in its own frame with its points, and the whole machine at its start."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from . import render_labels as labels
from . import render_shapes as shapes
from .crane import Crane
from .geometry import pose, pose_text
from .machine import GROUND, PRISMATIC
from .plots import empty_figure, style
from .render_placement import coordinates

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
_OVERVIEW, _LOWEST, _HIGHEST = 5.4, 1.8, 4.2  # inches: width of the machine alone; how low and high it may be
_ABOVE = 0.45  # inches that the machine alone leaves free above and below
_SIZE = 8.5  # points of most texts
_MARGIN = 0.13  # share of a panel left free on each side for labels
_PALER = 0.62
_SIDE = 62.0  # points: length of the sides of an angle


def sketch(crane: Crane) -> Figure:
    """Return the figure: the machine in its start pose above, below it the ground and every body in its own frame."""
    names = (GROUND, *crane.machine.bodies)
    rows = math.ceil(len(names) / 2)
    height = _TITLE + _WHOLE + rows * (_TITLE + _PANEL) + _GAP
    with style():
        figure = empty_figure(_WIDTH, height)
        top = height - _TITLE
        _draw_machine(
            _Panel.on(figure, (_GAP, top - _WHOLE, _WIDTH - 2 * _GAP, _WHOLE), _start_words(crane)),
            crane,
            _machine_seen(crane),
        )
        wide = (_WIDTH - 3 * _GAP) / 2
        for k, name in enumerate(names):
            row, column = divmod(k, 2)
            y = top - _WHOLE - (row + 1) * (_TITLE + _PANEL)
            box = (_GAP + column * (wide + _GAP), y, wide, _PANEL)
            _draw_frame(_Panel.on(figure, box, _body_words(crane, name)), crane, name)
    return figure


def overview(crane: Crane, marks: Sequence[str] = ()) -> Figure:
    """Return a figure of the machine at its start, on which places are marked.

    Args:
        crane: the machine.
        marks: cylinders, chambers, joints or sensors, by the machine's names; what has no place on it is left out.
    """
    wide = _OVERVIEW - 0.1
    seen = _machine_seen(crane)
    across, up = np.ptp(_corners(seen), axis=0)
    high = min(max((1.0 - 2.0 * _MARGIN) * wide * up / across + 2.0 * _ABOVE, _LOWEST), _HIGHEST)
    with style():
        figure = empty_figure(_OVERVIEW, high + _TITLE)
        panel = _Panel.on(figure, (0.05, 0.05, wide, high), f"{crane.name} at its start")
        _draw_machine(panel, crane, seen, marks)
    return figure


def _start_words(crane: Crane) -> str:
    started = pose_text(crane.layout, np.array(crane.initial.pose)).replace("-", "−")
    return f"{crane.name} at its start: {started}"


def _body_words(crane: Crane, name: str) -> str:
    if name == GROUND:
        return "ground"
    return f"{name}: {crane[f'bodies.{name}.mass']:.4g} kg, {crane[f'bodies.{name}.inertia']:.4g} kg m² about c"


# -- a panel whose labels do not overlap -----------------------------------------------------------------------------


@dataclass
class _Panel:
    """Axes of a fixed size in inches, and what has been put into them.

    Attributes:
        dots: places in points that labels keep clear of;  filled: triangles (n, 3, 2) in m of each shape.
        labels: what is still to be placed: text, place (2,) in m, and how it looks.
    """

    axes: Axes
    inches: tuple[float, float]
    dots: list[np.ndarray] = field(default_factory=list)
    filled: list[np.ndarray] = field(default_factory=list)
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

    def reveal(self, places: np.ndarray) -> None:
        """Move what the axes show by as much as places (n, 2) in m would be cut off."""
        low, high = np.array([self.axes.get_xlim(), self.axes.get_ylim()]).T
        edge = 4.0 * (high - low) / (72.0 * np.array(self.inches))
        move = np.maximum(places.max(axis=0) + edge - high, 0.0) - np.maximum(low - places.min(axis=0) + edge, 0.0)
        for limits, some in ((self.axes.set_xlim, 0), (self.axes.set_ylim, 1)):
            limits(low[some] + move[some], high[some] + move[some])

    def draw_axes(self, scale: float) -> None:
        """Draw the axes of the frame that the panel shows; scale: m a point of the page."""
        for turn, name in ((0.0, "x"), (0.5 * math.pi, "y")):
            tip = 36.0 * scale * _toward(turn)
            _arrow(self.axes, np.zeros(2), tip)
            self.keep_clear([np.zeros(2), 1.3 * tip])
            self.axes.text(1.2 * tip[0], 1.2 * tip[1], name, ha="center", va="center", fontsize=_SIZE, color=_SOFT)

    def keep_clear(self, line: Iterable[np.ndarray]) -> None:
        """Keep labels off a line through places in m."""
        corners = self._points(np.array(list(line)))
        for a, b in zip(corners, corners[1:] if len(corners) > 1 else corners, strict=False):
            self.dots += list(labels.dotted(a, b))

    def label(self, text: str, at: np.ndarray, **look: Any) -> None:
        """Note a text for a place in m; `place_labels` finds where there is room for it."""
        self.labels.append((text, np.asarray(at, dtype=float), look))

    def place_labels(self) -> None:
        """Write all labels where each overlaps least with what stands there, as near to its place as possible."""
        boxes = [labels.Label(self._points(at), _half(text, look)) for text, at, look in self.labels]
        page = 72.0 * np.array(self.inches)
        standing = labels.Shapes(page, [self._points(t) for t in self.filled])
        middles = labels.place(boxes, page, np.array(self.dots).reshape(-1, 2), standing)
        for (text, at, look), box, middle in zip(self.labels, boxes, middles, strict=True):
            end = labels.leader(box, middle)
            if end is not None:
                self.axes.plot(*zip(at, self._metres(end), strict=True), color=_SOFT, lw=0.6, zorder=7)
            x, y = self._metres(middle)
            looks: dict[str, Any] = {"color": _INK, "path_effects": [_halo()]} | look
            self.axes.text(x, y, text, ha="center", va="center", fontsize=_SIZE, zorder=9, **looks)

    def _points(self, places: np.ndarray) -> np.ndarray:
        """Return places (..., 2) in m as points of the page."""
        low, high = np.array([self.axes.get_xlim(), self.axes.get_ylim()]).T
        return (places - low) * 72.0 * np.array(self.inches) / (high - low)

    def _metres(self, points: np.ndarray) -> np.ndarray:
        """Return points (..., 2) of the page as places in m."""
        low, high = np.array([self.axes.get_xlim(), self.axes.get_ylim()]).T
        return low + points * (high - low) / (72.0 * np.array(self.inches))


def _half(text: str, look: Mapping[str, Any]) -> np.ndarray:
    """Return half the width and height in points that a text takes, with a margin."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import TextPath

    font = FontProperties(family="DejaVu Sans", weight=look.get("fontweight"), style=look.get("fontstyle"))
    lines = text.split("\n")
    wide = max(TextPath((0.0, 0.0), line, size=_SIZE, prop=font).get_extents().width for line in lines)
    return 0.5 * np.array([wide + 4.0, 1.2 * _SIZE * len(lines) + 1.0])


def _halo() -> Any:
    """Return a pale border that keeps a text legible where it stands on an edge all the same."""
    from matplotlib.patheffects import withStroke

    return withStroke(linewidth=1.4, foreground="white", alpha=0.85)


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
    seen = _side_view([(made, (0.0, 0.0, 0.0))])
    panel.draw_axes(panel.show(np.vstack([np.zeros((1, 2)), _corners(seen), *points.values(), *mass])))
    _fill(panel, seen)
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


def _draw_machine(panel: _Panel, crane: Crane, seen: _Seen, marks: Sequence[str] = ()) -> None:
    """Draw the machine at its start, with joints, coordinates, cylinders and bodies by name, and marks at places."""
    machine, start = crane.machine, np.array(crane.initial.pose)
    closed = pose(crane, *start)
    points = {name: at[0] for name, at in closed.points.items()}
    short = dict(zip(machine.points, machine.point_names, strict=True))
    frames = coordinates(crane, start)[0].reshape(-1, 3)
    angles = {GROUND: 0.0} | {name: float(angle[0]) for name, angle in closed.angles.items()}
    scale = panel.show(np.vstack([np.zeros((1, 2)), _corners(seen)]))
    turning = [j for j in machine.joints if j.coordinate in machine.independent and j.kind != PRISMATIC]
    sides = [points[short[j.pin]] + _SIDE * scale * _toward(angles[b]) for j in turning for b in (j.carrier, j.body)]
    panel.reveal(np.array(sides).reshape(-1, 2))
    _fill(panel, seen)
    panel.draw_axes(scale)
    for mark in marks:
        line = _place_of(crane, points, mark)
        look: dict[str, Any] = {"lw": 15, "solid_capstyle": "round"} if len(line) > 1 else {"marker": "o", "ms": 22}
        panel.axes.plot(*np.reshape(line, (-1, 2)).T, color=_MARK, alpha=0.6, zorder=5, **look)
        panel.keep_clear(line)
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


#: what is seen of graphics from the side: how near, corners (n, 2) in m, and the graphics
_Seen = list[tuple[float, np.ndarray, shapes.Graphics]]


def _machine_seen(crane: Crane) -> _Seen:
    """Return the side view of the machine and its pillar at its start."""
    frames = coordinates(crane, np.array(crane.initial.pose))[0].reshape(-1, 3)
    parts = zip(shapes.parts(crane, _paint()).values(), frames, strict=True)
    return _side_view([*parts, (shapes.pillar(crane, _paint()), (0.0, 0.0, 0.0))])


def _side_view(parts: Iterable[tuple[Sequence[shapes.Graphics], Sequence[float]]]) -> _Seen:
    """Return the side view of graphics, each list at a frame (x, y, angle), what is nearer after what is behind."""
    seen: _Seen = []
    for made, (x, y, angle) in parts:
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        for part in made:
            points = np.reshape(part["points"], (-1, 3))
            seen.append((points[:, 2].max(), np.delete(points, 2, axis=1) @ turn + [x, y], part))
    return sorted(seen, key=lambda s: s[0])


def _corners(seen: _Seen) -> np.ndarray:
    return np.vstack([corners for _, corners, _ in seen])


def _fill(panel: _Panel, seen: _Seen) -> None:
    """Fill what is seen from the side."""
    from matplotlib.collections import PolyCollection

    for _, corners, part in seen:
        color = tuple(np.reshape(part["colors"], (-1, 4))[0])
        triangles = np.array(part["triangles"] if "triangles" in part else part["triangles6"])[
            :, :3
        ]  # the first three are corners
        panel.filled.append(corners[triangles])
        panel.axes.add_collection(
            PolyCollection(list(corners[triangles]), facecolors=[color], edgecolors=[color], linewidths=0.4),
            autolim=False,
        )


def _angle(panel: _Panel, at: np.ndarray, start: float, end: float, scale: float) -> None:
    """Draw a coordinate as an arc from the direction of the carrier's x axis, which is dashed, to that of the
    body's.
    """
    for turn, dashes in ((start, (0, (4, 3))), (end, "-")):
        line = [at, at + _SIDE * scale * _toward(turn)]
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
