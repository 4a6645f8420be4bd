"""What is written into pictures: title, time, which crane is which, colour scales, names beside arrows."""

from __future__ import annotations

import math
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .render_shapes import FRONT

if TYPE_CHECKING:
    from .render import Scene

#: how people read a unit: how many of theirs it is, and their name
READ = {"Pa": (1e-5, "bar"), "rad": (math.degrees(1.0), "°"), "m": (1e3, "mm")}
#: colour maps whose lightness rises or falls steadily, so that they read in greyscale
MAPS = {"pressure": "viridis", "residual": "YlOrRd"}
#: values in a line of a colour scale
_PER_LINE = 4
#: lengths in m that a scale bar may stand for
_LENGTHS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
_QUANTITIES = {"Pa": "pressure", "rad": "angle", "m": "way"}
_INK, _SOFT, _MARK = (25, 27, 30), (85, 90, 96), (176, 0, 98)


def write_on(picture: np.ndarray, scene: Scene, time: float) -> np.ndarray:
    """Return the picture (height, width, 3) with the scene's texts at a time in s."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    unit = max(image.height / 720.0, 0.7)  # sizes below are pixels of a picture 720 high; small ones stay legible
    _heading(draw, scene, time, unit)
    if len(scene.trajectories) > 1:
        _legend(draw, scene, unit)
    _metres(draw, scene, unit, image.size)
    if scene.colour is not None:
        _scales(draw, scene, time, unit, image.size)
    for mark in scene.marks:
        _mark(draw, scene, mark, time, unit)
    return np.asarray(image)


@cache
def _font(size: int, bold: bool = False) -> Any:
    """Return DejaVu Sans, which comes with matplotlib and so is there on every machine."""
    import matplotlib
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)


def _heading(draw: Any, scene: Scene, time: float, unit: float) -> None:
    title = scene.title or scene.crane.name
    draw.text((28 * unit, 20 * unit), title, font=_font(round(24 * unit), True), fill=_INK)
    layout = scene.crane.layout
    words = [f"t = {time:6.2f} s"]
    for name, value in zip(layout.coordinates, scene.trajectories[0].at(time), strict=True):
        factor, symbol = READ[layout.unit_of(name)]
        words.append(f"{name} = {value * factor:6.1f}{'' if symbol == '°' else ' '}{symbol}")
    draw.text((28 * unit, 54 * unit), "    ".join(words).replace("-", "−"), font=_font(round(17 * unit)), fill=_SOFT)


def _legend(draw: Any, scene: Scene, unit: float) -> None:
    for i, trajectory in enumerate(scene.trajectories):
        y = (90 + 28 * i) * unit
        plain = i == 0 and scene.colour is not None
        color = (255, 255, 255) if plain else tuple(round(255 * c) for c in scene.ghost_color(i))
        draw.rectangle((28 * unit, y, 62 * unit, y + 16 * unit), fill=color, outline=_INK, width=max(1, round(unit)))
        how = " (coloured)" if plain else ""
        draw.text((72 * unit, y - 3 * unit), trajectory.label + how, font=_font(round(17 * unit)), fill=_INK)


def _metres(draw: Any, scene: Scene, unit: float, size: tuple[int, int]) -> None:
    """Draw how long a metre is in the picture, or another round length of about an eighth of its width."""
    length = min(_LENGTHS, key=lambda m: abs(math.log(8.0 * m / scene.width)))
    left, y, tick = 28 * unit, size[1] - 30 * unit, 5 * unit
    right = left + length / scene.width * size[0]
    for line in ((left, y, right, y), *((x, y - tick, x, y + tick) for x in (left, right))):
        draw.line(line, fill=_INK, width=max(1, round(2 * unit)))
    draw.text(
        (0.5 * (left + right), y - 8 * unit), f"{length:g} m", font=_font(round(15 * unit)), fill=_INK, anchor="ms"
    )


def _scales(draw: Any, scene: Scene, time: float, unit: float, size: tuple[int, int]) -> None:
    """Draw one bar for each quantity, with the present values written beside it."""
    layout = scene.crane.layout
    shown = layout.chambers if scene.colour == "pressure" else (*layout.chambers, *layout.coordinates)
    for i, (unit_name, end) in enumerate(scene.scales.items()):
        (factor, symbol), channels = READ[unit_name], [c for c in shown if layout.unit_of(c) == unit_name]
        x = size[0] - (330 + 350 * i) * unit
        values = [(c, scene.value(c, time) * factor) for c in channels]
        words = [f"{c} {v:.1f}" for c, v in values if not math.isnan(v)]
        lines = ["   ".join(words[k : k + _PER_LINE]) for k in range(0, len(words), _PER_LINE)]
        y = size[1] - (78 + 18 * max(len(lines) - 1, 0)) * unit
        panel = (x - 16 * unit, y - 32 * unit, x + 318 * unit, size[1] - 16 * unit)
        draw.rounded_rectangle(panel, radius=8 * unit, fill=(255, 255, 255, 200))
        _bar(draw, scene, (x, y, x + 300 * unit, y + 14 * unit))
        quantity = _QUANTITIES[unit_name] + ("" if scene.colour == "pressure" else " residual")
        heading = f"{quantity} / {symbol}"
        draw.text((x, y - 25 * unit), heading, font=_font(round(16 * unit)), fill=_INK)
        for fraction in (0.0, 0.5, 1.0):
            at = (x + 300 * unit * fraction, y + 17 * unit)
            draw.text(at, f"{end * factor * fraction:g}", font=_font(round(14 * unit)), fill=_INK, anchor="ma")
        draw.text((x, y + 36 * unit), "\n".join(lines), font=_font(round(14 * unit)), fill=_SOFT)


def _bar(draw: Any, scene: Scene, box: tuple[float, float, float, float]) -> None:
    from matplotlib import colormaps

    left, top, right, bottom = box
    steps = 60
    for k in range(steps):
        r, g, b, _ = colormaps[MAPS[scene.colour or "pressure"]]((k + 0.5) / steps)
        at = left + (right - left) * k / steps
        color = (round(255 * r), round(255 * g), round(255 * b))
        draw.rectangle((at, top, left + (right - left) * (k + 1) / steps, bottom), fill=color)
    draw.rectangle(box, outline=_INK, width=1)


def _mark(draw: Any, scene: Scene, mark: str, time: float, unit: float) -> None:
    """Write the name of a marked place beside the tail of its arrow, on a white ground."""
    tip, direction = scene.mark_at(mark, time)
    tail = tip - 1.04 * scene.arrow_length * np.asarray(direction) / math.hypot(*direction)
    (x, y), (x_tip, y_tip) = scene.project(np.array([[*tail, FRONT], [*tip, FRONT]]))
    font = _font(round(19 * unit), True)
    words = mark if mark not in scene.crane.layout.cylinders else f"{mark} cylinder"
    pad = 6 * unit
    x += (draw.textlength(words, font=font) / 2.0 + pad) * (x - x_tip) / math.hypot(x - x_tip, y - y_tip)
    y += 20 * unit * (y - y_tip) / math.hypot(x - x_tip, y - y_tip)
    box = draw.textbbox((x, y), words, font=font, anchor="mm")
    draw.rounded_rectangle(
        (box[0] - pad, box[1] - pad, box[2] + pad, box[3] + pad), radius=6 * unit, fill=(255, 255, 255, 225),
        outline=_MARK, width=max(1, round(1.5 * unit)),
    )  # fmt: skip
    draw.text((x, y), words, font=font, fill=_MARK, anchor="mm")
