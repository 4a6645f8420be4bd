"""What is written into pictures: title, time, which crane is which, colour scales, names beside arrows."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

Colour = Literal["pressure", "residual"]
#: left, top, right and bottom in pixels
Box = tuple[float, float, float, float]

#: how people read a unit: how many of theirs it is, and their name
READ = {"Pa": (1e-5, "bar"), "rad": (math.degrees(1.0), "°"), "m": (1e3, "mm")}
#: colour maps whose lightness rises or falls steadily, so that they read in greyscale
MAPS = {"pressure": "viridis", "residual": "YlOrRd"}
#: values in a line of a colour scale
_PER_LINE = 4
#: lengths in m that a scale bar may stand for
_LENGTHS = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
#: how far a label is moved to be legible, in tens of pixels of a picture 720 high, to a side; up and down less
_FARTHEST = 30
#: steps to a side and up or down by which a label is moved, the shortest way first
_WAYS = sorted(
    ((i, k) for i in range(-_FARTHEST, _FARTHEST + 1) for k in range(-9, 10)), key=lambda way: math.hypot(*way)
)
_QUANTITIES = {"Pa": "pressure", "rad": "angle", "m": "way"}
_INK, _SOFT, _MARK = (25, 27, 30), (85, 90, 96), (176, 0, 98)


class Entry(NamedTuple):
    """An entry of the legend: which crane, and its colour (red, green, blue from 0 to 1)."""

    label: str
    color: tuple[float, float, float]


class Scale(NamedTuple):
    """A colour scale from zero to `end`, with present values by name; SI, NaN where it is not known."""

    unit: str
    end: float
    values: Mapping[str, float]


class Mark(NamedTuple):
    """What an arrow points at, and its tail and tip (2,) in pixels."""

    words: str
    tail: np.ndarray
    tip: np.ndarray


@dataclass(frozen=True)
class Texts:
    """What is written into a picture at a time.

    Attributes:
        time: s; None for a machine that stands at its start.
        pose: coordinates by name: value and unit, SI.
        width: what the picture shows from left to right, m.
        colour: what colours stand for.
    """

    title: str
    time: float | None
    pose: Mapping[str, tuple[float, str]]
    width: float
    legend: Sequence[Entry]
    colour: Colour | None
    scales: Sequence[Scale]
    marks: Sequence[Mark]


def write_on(picture: np.ndarray, texts: Texts) -> np.ndarray:
    """Return the picture (height, width, 3) with texts."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    unit = max(image.height / 720.0, 0.7)  # sizes below are pixels of a picture 720 high; small ones stay legible
    taken = [
        *_heading(draw, texts, unit),
        *_legend(draw, texts.legend, unit),
        *_metres(draw, texts.width, unit, image.size),
    ]
    if texts.colour is not None:
        taken += _scales(draw, texts.colour, texts.scales, unit, image.size)
    for mark in texts.marks:
        taken.append(write_mark(draw, mark, unit, taken, image.size))
    return np.asarray(image)


@cache
def _font(size: int, bold: bool = False) -> Any:
    """Return DejaVu Sans, which comes with matplotlib and so is there on every machine."""
    import matplotlib
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)


def _heading(draw: Any, texts: Texts, unit: float) -> list[Box]:
    """Write title, time and coordinates; return where they stand."""
    places = (28 * unit, 20 * unit), (28 * unit, 54 * unit)
    small, room = _font(round(17 * unit)), draw.im.size[0] - 2 * places[0][0]
    sizes = range(round(24 * unit), round(12 * unit), -1)  # a long title is written smaller
    title = next((f for f in (_font(size, True) for size in sizes) if f.getlength(texts.title) < room), None)
    title = title or _font(sizes[-1], True)
    draw.text(places[0], texts.title, font=title, fill=_INK)
    words = ["at its start" if texts.time is None else f"t = {texts.time:6.2f} s"]
    for name, (value, si_unit) in texts.pose.items():
        factor, symbol = READ[si_unit]
        words.append(f"{name} = {value * factor:6.1f}{'' if symbol == '°' else ' '}{symbol}")
    line = "    ".join(words).replace("-", "−")
    draw.text(places[1], line, font=small, fill=_SOFT)
    return [draw.textbbox(places[0], texts.title, font=title), draw.textbbox(places[1], line, font=small)]


def _legend(draw: Any, legend: Sequence[Entry], unit: float) -> list[Box]:
    """Write which crane is which; return where that stands."""
    font = _font(round(17 * unit))
    for i, (label, color) in enumerate(legend):
        y = (90 + 28 * i) * unit
        fill = tuple(round(255 * c) for c in color)
        draw.rectangle((28 * unit, y, 62 * unit, y + 16 * unit), fill=fill, outline=_INK, width=max(1, round(unit)))
        draw.text((72 * unit, y - 3 * unit), label, font=font, fill=_INK)
    if not legend:
        return []
    longest = max(draw.textlength(label, font=font) for label, _ in legend)
    return [(28 * unit, 90 * unit, 72 * unit + longest, (90 + 28 * len(legend)) * unit)]


def _metres(draw: Any, width: float, unit: float, size: tuple[int, int]) -> list[Box]:
    """Draw how long a metre is in the picture, or another round length of about an eighth of its width; return where it
    stands.
    """
    length = min(_LENGTHS, key=lambda m: abs(math.log(8.0 * m / width)))
    left, y, tick = 28 * unit, size[1] - 30 * unit, 5 * unit
    right = left + length / width * size[0]
    for line in ((left, y, right, y), *((x, y - tick, x, y + tick) for x in (left, right))):
        draw.line(line, fill=_INK, width=max(1, round(2 * unit)))
    draw.text(
        (0.5 * (left + right), y - 8 * unit), f"{length:g} m", font=_font(round(15 * unit)), fill=_INK, anchor="ms"
    )
    return [(left, y - 24 * unit, right, y + tick)]


def _scales(draw: Any, colour: Colour, scales: Sequence[Scale], unit: float, size: tuple[int, int]) -> list[Box]:
    """Draw one bar for each quantity, with the present values written beside it; return where they stand."""
    panels = []
    for i, (si_unit, end, values) in enumerate(scales):
        factor, symbol = READ[si_unit]
        x = size[0] - (330 + 350 * i) * unit
        words = [f"{name} {value * factor:.1f}" for name, value in values.items() if not math.isnan(value)]
        lines = ["   ".join(words[k : k + _PER_LINE]) for k in range(0, len(words), _PER_LINE)]
        y = size[1] - (78 + 18 * max(len(lines) - 1, 0)) * unit
        panel = (x - 16 * unit, y - 32 * unit, x + 318 * unit, size[1] - 16 * unit)
        panels.append(panel)
        draw.rounded_rectangle(panel, radius=8 * unit, fill=(255, 255, 255, 200))
        _bar(draw, MAPS[colour], (x, y, x + 300 * unit, y + 14 * unit))
        quantity = _QUANTITIES[si_unit] + ("" if colour == "pressure" else " residual")
        heading = f"{quantity} / {symbol}"
        draw.text((x, y - 25 * unit), heading, font=_font(round(16 * unit)), fill=_INK)
        for fraction in (0.0, 0.5, 1.0):
            at = (x + 300 * unit * fraction, y + 17 * unit)
            draw.text(at, f"{end * factor * fraction:g}", font=_font(round(14 * unit)), fill=_INK, anchor="ma")
        draw.text((x, y + 36 * unit), "\n".join(lines), font=_font(round(14 * unit)), fill=_SOFT)
    return panels


def _bar(draw: Any, colours: str, box: tuple[float, float, float, float]) -> None:
    from matplotlib import colormaps

    left, top, right, bottom = box
    steps = 60
    for k in range(steps):
        r, g, b, _ = colormaps[colours]((k + 0.5) / steps)
        at = left + (right - left) * k / steps
        color = (round(255 * r), round(255 * g), round(255 * b))
        draw.rectangle((at, top, left + (right - left) * (k + 1) / steps, bottom), fill=color)
    draw.rectangle(box, outline=_INK, width=1)


def write_mark(draw: Any, mark: Mark, unit: float, taken: Sequence[Box], size: tuple[int, int]) -> Box:
    """Write the name of a marked place beside the tail of its arrow, on a white ground, clear of what is written
    elsewhere; return where it stands.
    """
    words, (x, y), (x_tip, y_tip) = mark
    font = _font(round(19 * unit), True)
    pad = 6 * unit
    x += (draw.textlength(words, font=font) / 2.0 + pad) * (x - x_tip) / math.hypot(x - x_tip, y - y_tip)
    y += 20 * unit * (y - y_tip) / math.hypot(x - x_tip, y - y_tip)
    left, top, right, bottom = draw.textbbox((x, y), words, font=font, anchor="mm")
    box = (left - pad, top - pad, right + pad, bottom + pad)
    tip = (x_tip - pad, y_tip - pad, x_tip + pad, y_tip + pad)
    dx, dy = _aside(box, [*taken, tip], size, unit)
    box = (box[0] + dx, box[1] + dy, box[2] + dx, box[3] + dy)
    draw.rounded_rectangle(
        box, radius=6 * unit, fill=(255, 255, 255, 225), outline=_MARK, width=max(1, round(1.5 * unit))
    )
    draw.text((x + dx, y + dy), words, font=font, fill=_MARK, anchor="mm")
    return box


def _aside(box: Box, taken: Sequence[Box], size: tuple[int, int], unit: float) -> tuple[float, float]:
    """Return the shortest way in pixels that takes a box into the picture and clear of what is taken; none at all
    where there is no room.
    """
    for dx, dy in ((10 * unit * i, 10 * unit * k) for i, k in _WAYS):
        left, top, right, bottom = box[0] + dx, box[1] + dy, box[2] + dx, box[3] + dy
        inside = left >= 0.0 and top >= 0.0 and right <= size[0] and bottom <= size[1]
        if inside and not any(left < t[2] and right > t[0] and top < t[3] and bottom > t[1] for t in taken):
            return dx, dy
    return 0.0, 0.0
