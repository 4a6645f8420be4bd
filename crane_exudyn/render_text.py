"""What is written into pictures: title, time, which crane is which, colour scales, names beside arrows.

Title, coordinates and legend stand at the top, a metre and the colour scales at the bottom, and the machine between
(`margins`). In a small picture less is written. Names of marks stand where nothing else does.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from .units import people_of

Colour = Literal["pressure", "residual"]
#: left, top, right and bottom in pixels
Box = tuple[float, float, float, float]

#: how people read a unit: how many of theirs it is, and their name
READ = {u: (1.0 / one, unit.replace("deg", "°")) for u in ("Pa", "rad", "m") for unit, one in [people_of(u)]}
#: colour maps whose lightness rises or falls steadily, so that they read in greyscale
MAPS = {"pressure": "viridis", "residual": "YlOrRd"}
#: what is left out of a picture too small for everything, one after the other: until at most this share is written on
_LEFT_OUT, _MOST_WRITTEN = ("values", "pose", "legend", "scales", "metres", "title"), 0.5
#: share of the width that is kept for the bar of a metre
_METRES = 0.2
#: how wide a colour scale is at most, with its ground; how far it is from its ground's edge, from the next one and from
#: the picture's lower right corner; and how far the rest is from the picture's edge
_PANEL, _PAD, _GAP, _EDGE = 324, 12, 12, 28
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
        covered: triangles (n, 3, 2) in pixels that machines are seen in, on which no name should stand.
    """

    title: str
    time: float | None
    pose: Mapping[str, tuple[float, str]]
    width: float
    legend: Sequence[Entry]
    colour: Colour | None
    scales: Sequence[Scale]
    marks: Sequence[Mark] = ()
    covered: np.ndarray = field(default_factory=lambda: np.empty((0, 3, 2)))


def write_on(picture: np.ndarray, texts: Texts) -> np.ndarray:
    """Return the picture (height, width, 3) with texts."""
    from PIL import Image, ImageDraw

    image = Image.fromarray(picture)
    draw = ImageDraw.Draw(image, "RGBA")
    page = _Page.of(texts, image.size)
    for part, write in (("title", _title), ("pose", _pose), ("legend", _legend), ("metres", _metres)):
        if part in page.parts:
            write(draw, page)
    if "scales" in page.parts:
        for number in range(len(texts.scales)):
            _scale(draw, page, number)
    if texts.marks:
        space = Space(image.size, texts.covered)
        for box in page.boxes:
            space.take(box)
        for mark in texts.marks:
            space.take_line(0.7 * mark.tail + 0.3 * mark.tip, mark.tip, 12 * page.unit)
        for mark in texts.marks:
            write_mark(draw, mark, page.unit, space)
    return np.asarray(image)


def margins(texts: Texts, size: tuple[int, int]) -> tuple[float, float]:
    """Return the heights in pixels that are written on at the top and at the bottom of a picture of a size in pixels;
    the same at all times.
    """
    page = _Page.of(texts, size)
    return page.top, page.bottom


# -- where things stand ------------------------------------------------------------------------------------------------


def _flow(widths: Sequence[float], gap: float, room: float) -> list[tuple[float, int]]:
    """Return x and row of things of some widths, one after the other in as many rows as it takes."""
    places, x, row = [], 0.0, 0
    for width in widths:
        if x > 0.0 and x + width > room:
            x, row = 0.0, row + 1
        places.append((x, row))
        x += width + gap
    return places


def _rows(places: Sequence[tuple[float, int]]) -> int:
    return 1 + max((row for _, row in places), default=-1)


@dataclass(frozen=True)
class _Page:
    """Which parts of the texts a picture of a size in pixels has, and where they stand; sizes in code are pixels of a
    picture 720 high, times `unit`.
    """

    texts: Texts
    size: tuple[int, int]
    parts: frozenset[str]

    @classmethod
    def of(cls, texts: Texts, size: tuple[int, int]) -> _Page:
        """Return the page with all parts that there are, but for as many of `_LEFT_OUT` as leave the machine room."""
        there = {"legend": bool(texts.legend), "scales": bool(texts.scales), "values": bool(texts.scales)}
        for first in range(len(_LEFT_OUT) + 1):
            page = cls(texts, size, frozenset(part for part in _LEFT_OUT[first:] if there.get(part, True)))
            if page.top + page.bottom <= _MOST_WRITTEN * size[1] and page._fits():
                return page
        return page

    @property
    def unit(self) -> float:
        """Factor of all sizes; small pictures stay legible."""
        return max(self.size[1] / 720.0, 0.7)

    @property
    def air(self) -> float:
        """Pixels above and below all that is written, for each pixel of a picture 720 high; little in small ones."""
        return self.size[1] / 720.0

    @property
    def room(self) -> float:
        """Width between the edges."""
        return self.size[0] - 2 * _EDGE * self.unit

    def font(self, size: float, bold: bool = False) -> Any:
        """Return a font by its size."""
        return _font(round(size * self.unit), bold)

    @property
    def pose(self) -> list[tuple[str, str]]:
        """Time and coordinates in words, each with the longest that it may become."""
        time = self.texts.time
        words = [("at its start",) * 2 if time is None else (f"t = {time:6.2f} s", "t = 000.00 s")]
        for name, (value, si_unit) in self.texts.pose.items():
            factor, symbol = READ[si_unit]
            unit = symbol if symbol == "°" else f" {symbol}"
            words.append((f"{name} = {value * factor:6.1f}{unit}".replace("-", "−"), f"{name} = −000.0{unit}"))
        return words

    @property
    def pose_places(self) -> list[tuple[float, int]]:
        """Where each of `pose` stands; nothing moves in a film."""
        return _flow(self.pose_widths, 20 * self.unit, self.room)

    @property
    def pose_widths(self) -> list[float]:
        """How wide each of `pose` is at most."""
        return [self.font(17).getlength(longest) for _, longest in self.pose]

    @property
    def legend_places(self) -> list[tuple[float, int]]:
        """Where each entry of the legend stands."""
        return _flow(self.legend_widths, 24 * self.unit, self.room)

    @property
    def legend_widths(self) -> list[float]:
        """How wide each entry of the legend is, with its colour."""
        return [44 * self.unit + self.font(17).getlength(entry.label) for entry in self.texts.legend]

    @property
    def pose_top(self) -> float:
        """Where time and coordinates begin."""
        return 20 * self.air + (34 * self.unit if "title" in self.parts else 0.0)

    @property
    def legend_top(self) -> float:
        """Where the legend begins."""
        rows = _rows(self.pose_places) if "pose" in self.parts else 0
        return self.pose_top + (26 * rows + (10 if rows else 0)) * self.unit

    @property
    def top(self) -> float:
        """How far what is written reaches down."""
        rows = _rows(self.legend_places) if "legend" in self.parts else 0
        return self.legend_top + 28 * rows * self.unit if {"title", "pose", "legend"} & self.parts else 0.0

    @property
    def panel(self) -> float:
        """Width of a colour scale with its ground."""
        room = self.room - (_METRES * self.size[0] + _GAP * self.unit if "metres" in self.parts else 0.0)
        count = max(len(self.texts.scales), 1)
        return min(_PANEL * self.unit, room / count - _GAP * self.unit)

    @property
    def bar(self) -> float:
        """Width of a colour scale."""
        return self.panel - 2 * _PAD * self.unit

    def values(self, scale: Scale) -> list[tuple[str, float, int]]:
        """Return what is written below a colour scale: name and value, x, and row."""
        factor, _ = READ[scale.unit]
        font, widest = self.font(14), f"{scale.end * factor:.1f}"
        places = _flow([font.getlength(f"{name} {widest}") for name in scale.values], 14 * self.unit, self.bar)
        shown = [
            f"{name} {'–' if math.isnan(value) else f'{value * factor:.1f}'}" for name, value in scale.values.items()
        ]
        return [(word, x, row) for word, (x, row) in zip(shown, places, strict=True)]

    @property
    def panel_height(self) -> float:
        """Height of the colour scales with their ground, all the same."""
        rows = max((row + 1 for scale in self.texts.scales for *_, row in self.values(scale)), default=0)
        return (68 + (18 * rows + 8 if "values" in self.parts else 0)) * self.unit

    @property
    def bottom(self) -> float:
        """How far what is written reaches up from the lower edge."""
        if "scales" in self.parts:
            return self.panel_height + 8 * self.unit + _GAP * self.air
        return 28 * self.unit + 30 * self.air if "metres" in self.parts else 0.0

    def heading(self, scale: Scale) -> str:
        """Return what is written above a colour scale, as long as there is room."""
        symbol, quantity = READ[scale.unit][1], _QUANTITIES[scale.unit]
        whole = quantity if self.texts.colour == "pressure" else f"{quantity} residual"
        found = (f"{whole} / {symbol}", f"{quantity} / {symbol}", symbol)
        return next((h for h in found if self.font(16).getlength(h) <= self.bar), symbol)

    def _fits(self) -> bool:
        """Whether colour scales have room for their ends."""
        ends = (self.font(14).getlength(f"0   {s.end * READ[s.unit][0]:g}") for s in self.texts.scales)
        return "scales" not in self.parts or self.bar > max(ends, default=0.0)

    @property
    def boxes(self) -> list[Box]:
        """Where texts stand, above and below the machine."""
        (width, height), edge, y = self.size, _EDGE * self.unit, self.size[1] - self.bottom
        ends = [min(self.font(24, bold=True).getlength(self.texts.title), self.room)]
        ends += [x + w for (x, _), w in zip(self.pose_places, self.pose_widths, strict=True)]
        ends += [x + w for (x, _), w in zip(self.legend_places, self.legend_widths, strict=True)]
        scales = (self.panel + _GAP * self.unit) * len(self.texts.scales) if "scales" in self.parts else 0.0
        metres = edge + _METRES * width if "metres" in self.parts else 0.0
        return [(0.0, 0.0, edge + max(ends), self.top), (0.0, y, metres, height), (width - scales, y, width, height)]


class Space:
    """The pixels of a picture that are free for names: neither covered by machines nor written on."""

    def __init__(self, size: tuple[int, int], covered: np.ndarray) -> None:
        """Begin with triangles (n, 3, 2) in pixels that machines cover."""
        from PIL import Image, ImageDraw

        self.size = size
        self._machine, self._taken = Image.new("L", size), Image.new("L", size)
        draw = ImageDraw.Draw(self._machine)
        for corners in covered.round().astype(int).tolist():
            draw.polygon([tuple(c) for c in corners], fill=1)

    def take(self, box: Box) -> None:
        """Let nothing else stand in a box."""
        from PIL import ImageDraw

        ImageDraw.Draw(self._taken).rectangle(box, fill=1)

    def take_line(self, start: np.ndarray, end: np.ndarray, width: float) -> None:
        """Let nothing stand on a line, such as an arrow."""
        from PIL import ImageDraw

        ImageDraw.Draw(self._taken).line([*start.tolist(), *end.tolist()], fill=1, width=round(width))

    def aside(self, box: Box, step: float) -> tuple[float, float]:
        """Return the shortest way in pixels that takes a box clear of everything; of what is written at least; none at
        all where there is no room. step: by how much it is moved at a time.
        """
        taken = np.asarray(self._taken)
        for full in (np.maximum(taken, np.asarray(self._machine)), taken):
            sums = np.pad(full.astype(int).cumsum(axis=0).cumsum(axis=1), ((1, 0), (1, 0)))
            for dx, dy in ((step * i, step * k) for i, k in _WAYS):
                left, top = math.floor(box[0] + dx), math.floor(box[1] + dy)
                right, bottom = math.ceil(box[2] + dx), math.ceil(box[3] + dy)
                inside = left >= 0 and top >= 0 and right <= self.size[0] and bottom <= self.size[1]
                if inside and sums[bottom, right] - sums[top, right] - sums[bottom, left] + sums[top, left] == 0:
                    return dx, dy
        return 0.0, 0.0


# -- what is written ---------------------------------------------------------------------------------------------------


@cache
def _font(size: int, bold: bool = False) -> Any:
    """Return DejaVu Sans, which comes with matplotlib and so is there on every machine."""
    import matplotlib
    from PIL import ImageFont

    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)


def _title(draw: Any, page: _Page) -> None:
    """Write the title: a long one smaller, one that is too long without its end."""
    title = page.texts.title
    fonts = [page.font(size, bold=True) for size in range(24, 15, -1)]
    font = next((f for f in fonts if f.getlength(title) < page.room), fonts[-1])
    if font.getlength(title) > page.room:
        count = next(n for n in range(len(title), -1, -1) if font.getlength(title[:n] + "…") < page.room or n == 0)
        title = title[:count] + "…"
    draw.text((_EDGE * page.unit, 20 * page.air), title, font=font, fill=_INK)


def _pose(draw: Any, page: _Page) -> None:
    """Write time and coordinates."""
    left, row_height = _EDGE * page.unit, 26 * page.unit
    for (word, _), (x, row) in zip(page.pose, page.pose_places, strict=True):
        draw.text((left + x, page.pose_top + row_height * row), word, font=page.font(17), fill=_SOFT)


def _legend(draw: Any, page: _Page) -> None:
    """Write which crane is which."""
    unit = page.unit
    for (label, color), (across, row) in zip(page.texts.legend, page.legend_places, strict=True):
        x, y = _EDGE * unit + across, page.legend_top + 28 * row * unit
        fill = tuple(round(255 * c) for c in color)
        draw.rectangle((x, y, x + 34 * unit, y + 16 * unit), fill=fill, outline=_INK, width=max(1, round(unit)))
        draw.text((x + 44 * unit, y - 3 * unit), label, font=page.font(17), fill=_INK)


def _metres(draw: Any, page: _Page) -> None:
    """Draw how long a metre is in the picture, or another round length of about an eighth of its width."""
    unit, size, width = page.unit, page.size, page.texts.width
    length = min(_LENGTHS, key=lambda m: abs(math.log(8.0 * m / width)))
    left, y, tick = _EDGE * unit, size[1] - 5 * unit - 25 * page.air, 5 * unit
    right = left + length / width * size[0]
    for line in ((left, y, right, y), *((x, y - tick, x, y + tick) for x in (left, right))):
        draw.line(line, fill=_INK, width=max(1, round(2 * unit)))
    draw.text((0.5 * (left + right), y - 8 * unit), f"{length:g} m", font=page.font(15), fill=_INK, anchor="ms")


def _scale(draw: Any, page: _Page, number: int) -> None:
    """Draw the n-th colour scale from the right, with the present values written below it."""
    scale, unit, (width, height) = page.texts.scales[number], page.unit, page.size
    factor, bar = READ[scale.unit][0], page.bar
    left = width - _GAP * unit - (number + 1) * page.panel - number * _GAP * unit
    top = height - _GAP * page.air - page.panel_height
    panel = (left, top, left + page.panel, top + page.panel_height)
    draw.rounded_rectangle(panel, radius=8 * unit, fill=(255, 255, 255, 200))
    x, y, font = left + _PAD * unit, top + 30 * unit, page.font(14)
    draw.text((x, y - 25 * unit), page.heading(scale), font=page.font(16), fill=_INK)
    _bar(draw, MAPS[page.texts.colour or "pressure"], (x, y, x + bar, y + 14 * unit))
    ticks = {fraction: f"{scale.end * factor * fraction:g}" for fraction in (0.0, 0.5, 1.0)}
    if font.getlength("  ".join(ticks.values())) > bar:
        del ticks[0.5]
    for fraction, words in ticks.items():
        draw.text((x + bar * fraction, y + 17 * unit), words, font=font, fill=_INK, anchor="ma")
    if "values" in page.parts:
        for words, across, row in page.values(scale):
            draw.text((x + across, y + (36 + 18 * row) * unit), words, font=font, fill=_SOFT)


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


def write_mark(draw: Any, mark: Mark, unit: float, space: Space) -> Box:
    """Write the name of a marked place beside the tail of its arrow, on a white ground, where there is space, which it
    takes; return where it stands. A line leads to a name that does not stand at its arrow.
    """
    words, tail, tip = mark
    font = _font(round(19 * unit), True)
    pad = 6 * unit
    back = (tail - tip) / math.hypot(*(tail - tip))
    x, y = tail + back * [draw.textlength(words, font=font) / 2.0 + pad, 20 * unit]
    left, top, right, bottom = draw.textbbox((x, y), words, font=font, anchor="mm")
    box = (left - pad, top - pad, right + pad, bottom + pad)
    dx, dy = space.aside(box, 10 * unit)
    box = (box[0] + dx, box[1] + dy, box[2] + dx, box[3] + dy)
    near = (min(max(tail[0], box[0]), box[2]), min(max(tail[1], box[1]), box[3]))
    draw.line([*tail.tolist(), *near], fill=_MARK, width=max(1, round(1.5 * unit)))
    draw.rounded_rectangle(
        box, radius=6 * unit, fill=(255, 255, 255, 225), outline=_MARK, width=max(1, round(1.5 * unit))
    )
    draw.text((x + dx, y + dy), words, font=font, fill=_MARK, anchor="mm")
    space.take(box)
    return box
