"""Draws the sketches of docs/physics.md and docs/howto/own-crane.md from the crane files.

python docs/make_sketches.py [FOLDER]     # default: docs/images
"""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, FancyArrowPatch, Polygon, Rectangle

from crane_exudyn import Crane
from crane_exudyn.geometry import pose
from crane_exudyn.render_frames import sketch
from validation.plots import save, style

INK, SOFT, LIFT, TILT = "#1b1b1b", "#777777", "#D55E00", "#0072B2"
#: what the sketch calls ends of cylinders
_LETTERS = {"lift_base": "F", "lift_rod_end": "G", "tilt_base": "H"}
Z1, Z4 = math.radians(20.0), math.radians(-55.0)


def crane_sketch(crane: Crane) -> Figure:
    """Return the crane at a pose with its points, angles, lengths and chambers named."""
    figure, axes = _page(8.2, 5.0)
    points = {_LETTERS.get(name, name): at[0] for name, at in pose(crane, Z1, Z4).points.items()}
    o, f, g, h, b, a, c, d, e = (points[n] for n in ("O", "F", "G", "H", "B", "A", "C", "D", "E"))
    axes.add_patch(
        Polygon([(-0.30, 0), (0.06, 0), np.add(o, (0.07, 0.02)), np.add(o, (-0.07, 0.02))], fc="#e3e3e3", ec=SOFT)
    )
    axes.plot([-0.6, 5.0], [0, 0], color=INK, lw=1.2)
    for body, fill in (((o, g, b, a, h), "#f6dccb"), ((a, d, e), "#d8e6f2")):
        axes.add_patch(Polygon(body, fc=fill, ec=INK, lw=1.2, joinstyle="round"))
    for start, end in ((b, c), (c, d)):
        axes.plot(*zip(start, end, strict=True), color=INK, lw=4, solid_capstyle="round")
    _cylinder(axes, f, g, LIFT, ("p1", "p2"), -0.17)
    _cylinder(axes, h, c, TILT, ("p3", "p4"), 0.15)
    _angle(axes, o, 0.0, Z1, 2.1, "z1")
    _angle(axes, a, Z1, Z1 + Z4, 0.95, "z4")
    _name_points(axes, points)
    _frame(axes, np.array([0.0, 0.0]), 0.0, "x", "y", 0.5)
    named = {
        "pillar": (-0.55, 0.75),
        "lift boom": g + 0.45 * (a - g) + (0.12, -0.26),
        "outer boom": 0.5 * (a + e) + (0.62, 0.12),
        "bracket 1 from B to C, bracket 2 from C to D": 0.5 * (c + d) + (0.0, 0.27),
        "payload": np.add(e, (0.1, -0.22)),
    }
    for words, at in named.items():
        axes.text(*at, words, color=SOFT, style="italic", ha="center")
    _arrow(axes, (4.75, 2.6), (4.75, 2.0))
    axes.text(4.82, 2.3, "g", va="center")
    axes.set(xlim=(-1.0, 5.1), ylim=(-0.35, 3.45), aspect="equal")
    return figure


def hydraulic_sketch() -> Figure:
    """Return one cylinder with its valve: areas, pressures, flows and the directions that count as positive."""
    figure, axes = _page(7.6, 3.6)
    axes.add_patch(Rectangle((0, 1.0), 2.9, 1.2, fc="#f6dccb", ec="none"))
    axes.add_patch(Rectangle((3.1, 1.0), 2.9, 1.2, fc="#d8e6f2", ec="none"))
    axes.add_patch(Rectangle((2.9, 1.0), 0.2, 1.2, fc=INK))
    axes.add_patch(Rectangle((3.1, 1.18), 4.0, 0.28, fc="#cccccc", ec=INK))
    axes.add_patch(Rectangle((0, 1.0), 6.0, 1.2, fill=False, ec=INK, lw=1.6))
    for x in (-0.35, 7.25):
        axes.add_patch(Circle((x, 1.32), 0.15, fc="white", ec=INK, lw=1.4, zorder=4))
    axes.plot([-0.22, 0], [1.32, 1.32], color=INK, lw=1.6)
    axes.text(1.45, 1.62, "$p_a$   $V_a = V_{h,a} + A_a\\,l_a$", ha="center", va="center")
    axes.text(4.55, 1.82, "$p_b$   $V_b = V_{h,b} + A_b\\,l_b$", ha="center", va="center")
    axes.text(1.45, 2.3, "a: piston side (p1, p3)", ha="center", color=LIFT)
    axes.text(4.55, 2.3, "b: rod side (p2, p4)", ha="center", color=TILT)
    _measure(axes, 0.0, 2.9, 0.62, "$l_a = s -$ empty length")
    _measure(axes, 3.1, 6.0, 0.62, "$l_b =$ chamber range $- l_a$")
    _measure(axes, -0.35, 7.25, 2.75, "$s$ from pin to pin; $\\dot s > 0$ extends")
    _arrow(axes, (7.45, 1.32), (8.1, 1.32))
    axes.text(7.5, 1.75, "$F = p_a A_a - p_b A_b - F_\\mu$", va="center")
    axes.text(7.5, 0.9, "pushes the pins apart", va="center", color=SOFT)
    _arrow(axes, (0.2, -0.6), (0.2, 1.0), LIFT)
    _arrow(axes, (5.8, 1.0), (5.8, -0.6), TILT)
    axes.text(0.32, 0.1, "$Q_a > 0$: into the chamber", color=LIFT)
    axes.text(5.68, -0.3, "$Q_b > 0$: out of the chamber", color=TILT, ha="right")
    axes.add_patch(Rectangle((0.0, -1.2), 6.0, 0.6, fc="#f4f4f4", ec=INK))
    axes.text(
        3.0,
        -0.9,
        "valve, $U > 0$: pump $p_p$ to a, b to tank $p_t$;  $U < 0$ the reverse",
        ha="center",
        va="center",
        fontsize=9,
    )
    axes.set(xlim=(-0.7, 10.6), ylim=(-1.35, 3.2), aspect="equal")
    return figure


def _page(width: float, height: float) -> tuple[Figure, Axes]:
    with style():
        figure = Figure(figsize=(width, height), layout="constrained")
        axes = figure.subplots()
    axes.axis("off")
    return figure, axes


def _cylinder(
    axes: Axes, base: np.ndarray, end: np.ndarray, color: str, chambers: tuple[str, str], aside: float
) -> None:
    """Draw barrel and rod between two pins, and name the chambers."""
    along = (end - base) / np.linalg.norm(end - base)
    across = np.array([-along[1], along[0]])
    split = base + 0.66 * (end - base)
    axes.plot(*zip(base, split, strict=True), color=color, lw=9, alpha=0.55, solid_capstyle="butt")
    axes.plot(*zip(split, end, strict=True), color=color, lw=3)
    for share, name in zip((0.15, 0.55), chambers, strict=True):
        axes.text(
            *(base + share * (end - base) + aside * across), name, color=color, ha="center", va="center", fontsize=9
        )


def _name_points(axes: Axes, points: dict[str, np.ndarray]) -> None:
    away = {
        "O": (-0.16, 0.1),
        "F": (0.16, -0.08),
        "G": (0.17, -0.10),
        "H": (-0.14, 0.08),
        "B": (-0.02, -0.17),
        "A": (0.06, -0.17),
        "C": (-0.12, 0.12),
        "D": (0.15, 0.1),
        "E": (0.18, 0.04),
    }
    for name, offset in away.items():
        axes.plot(*points[name], "o", ms=6, mfc="white", mec=INK, zorder=5)
        axes.text(*(points[name] + offset), name, weight="bold", ha="center", va="center", zorder=6)


def _angle(axes: Axes, at: np.ndarray, start: float, end: float, radius: float, name: str) -> None:
    """Draw an angle as an arc with an arrow head, from a dashed reference line."""
    line = at + radius * 1.12 * np.array([math.cos(start), math.sin(start)])
    axes.plot(*zip(at, line, strict=True), color=SOFT, lw=1, ls=(0, (4, 3)))
    low, high = sorted((math.degrees(start), math.degrees(end)))
    axes.add_patch(Arc(at, 2 * radius, 2 * radius, theta1=low, theta2=high, color=INK))
    turn = 0.02 if end > start else -0.02
    tip, before = (at + radius * np.array([math.cos(t), math.sin(t)]) for t in (end, end - turn))
    axes.add_patch(FancyArrowPatch(before, tip, arrowstyle="-|>", mutation_scale=11, color=INK, lw=0))
    middle = at + (radius + 0.17) * np.array([math.cos((start + end) / 2), math.sin((start + end) / 2)])
    axes.text(*middle, name, ha="center", va="center", weight="bold")


def _frame(axes: Axes, at: np.ndarray, angle: float, x: str, y: str, length: float) -> None:
    for turn, name in ((angle, x), (angle + math.pi / 2, y)):
        tip = at + length * np.array([math.cos(turn), math.sin(turn)])
        _arrow(axes, at, tip)
        beside = np.array([math.sin(turn), -math.cos(turn)])  # off the lines that go on where the arrow ends
        axes.text(*(tip + 0.05 * (tip - at) / length + 0.1 * beside), name, ha="center", va="center")


def _arrow(axes: Axes, start, end, color: str = INK) -> None:  # type: ignore[no-untyped-def]
    axes.add_patch(
        FancyArrowPatch(start, end, arrowstyle="-|>", mutation_scale=12, color=color, lw=1.4, shrinkA=0, shrinkB=0)
    )


def _measure(axes: Axes, left: float, right: float, y: float, words: str) -> None:
    axes.add_patch(
        FancyArrowPatch((left, y), (right, y), arrowstyle="<|-|>", mutation_scale=9, color=SOFT, shrinkA=0, shrinkB=0)
    )
    axes.text((left + right) / 2, y + 0.07, words, ha="center", va="bottom", color=SOFT, fontsize=9)


def main(folder: Path) -> None:
    """Write all pictures to a folder."""
    crane = Crane.load("patu655")
    save(crane_sketch(crane), folder / "crane.svg")
    save(hydraulic_sketch(), folder / "cylinder.svg")
    for name in ("loader", "excavator"):
        save(sketch(Crane.load(name)), folder / f"{name}-frames.png")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent / "images")
