"""Labels of a drawing that avoid each other, the lines and the shapes that stand there.

Each label has candidates around its place, from near to far. What speaks against one is added up in one cost, and
labels are placed one after the other, again and again, until none finds a better place: cyclic coordinate descent.
Everything is in points of the page, y upwards.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

#: distances in points and directions in which a label may stand from its place
_AWAY = (5.0, 10.0, 16.0, 24.0, 34.0, 46.0, 60.0, 78.0, 100.0)
_TURNS = np.radians(np.arange(0.0, 360.0, 15.0))
#: costs, in points that a label would rather be away: a point outside of the page, a square point over another label,
#: a dot of a line below it, a point of a shape's edge below it, a label all over a shape, a crossing of a leader
_OUTSIDE, _OVER, _HIT, _EDGE, _COVERED, _CROSSED = 50.0, 5.0, 20.0, 2.5, 12.0, 60.0
#: points between the dots of a line; the distance beyond which a leader is drawn; times that labels are placed anew
_SPACING, LEADER, _SWEEPS = 4.0, 9.0, 8
#: points that a label stays clear of a line; dots along a leader
_CLEAR, _DOTS = 3.0, 12


@dataclass(frozen=True)
class Label:
    """A label to be placed: where it belongs, and half its width and height."""

    own: np.ndarray
    half: np.ndarray

    @cached_property
    def candidates(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles (n, 2) at which it may stand, and how far off (n,) each is."""
        toward = np.column_stack([np.cos(_TURNS), np.sin(_TURNS)])
        # the edge of the box, not its middle, is that far from the place
        reach = np.minimum(*(self.half / np.maximum(np.abs(toward), 1e-9)).T)
        middles = [self.own + toward * (away + reach)[:, None] for away in _AWAY]
        return np.vstack(middles), np.repeat(_AWAY, len(_TURNS))


class Shapes:
    """What is filled on the page, as sums over its pixels of one point: how much of a box is covered, or is edge."""

    def __init__(self, page: np.ndarray, triangles: Iterable[np.ndarray]) -> None:
        """Fill triangles (n, 3, 2) on a page (width, height); each set of them is one shape with an edge of its own."""
        from PIL import Image, ImageDraw

        size = (int(page[0]) + 2, int(page[1]) + 2)
        edges, covered = np.zeros(size[::-1], dtype=bool), np.zeros(size[::-1], dtype=bool)
        for some in triangles:
            image = Image.new("1", size)
            draw = ImageDraw.Draw(image)
            for corners in some:
                draw.polygon([tuple(c) for c in corners], fill=1, outline=1)
            filled = np.array(image, dtype=bool)
            inside = filled.copy()
            inside[1:-1, 1:-1] &= filled[2:, 1:-1] & filled[:-2, 1:-1] & filled[1:-1, 2:] & filled[1:-1, :-2]
            edges = (edges & ~inside) | (filled & ~inside)  # what is nearer hides what is behind
            covered |= filled
        self._sums = [np.pad(a.astype(float), ((1, 0), (1, 0))).cumsum(0).cumsum(1) for a in (covered, edges)]

    def under(self, low: np.ndarray, top: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the share of boxes (n, 2) to (n, 2) that is covered (n,), and the length of edges in them (n,)."""
        rows, columns = self._sums[0].shape
        x0, x1 = (np.clip(a[:, 0].round().astype(int), 0, columns - 1) for a in (low, top))
        y0, y1 = (np.clip(a[:, 1].round().astype(int), 0, rows - 1) for a in (low, top))
        covered, edge = (s[y1, x1] - s[y0, x1] - s[y1, x0] + s[y0, x0] for s in self._sums)
        return covered / np.prod(top - low, axis=1), edge


def place(labels: Sequence[Label], page: np.ndarray, dots: np.ndarray, shapes: Shapes) -> list[np.ndarray]:
    """Return where the middles of labels stand best on a page (width, height) with dots (n, 2) and shapes on it."""
    fixed = [_alone(label, page, dots, shapes) for label in labels]
    chosen: dict[int, int] = {}
    for _ in range(_SWEEPS):
        before = dict(chosen)
        for i, label in enumerate(labels):
            middles = label.candidates[0]
            others = [(labels[j], labels[j].candidates[0][k]) for j, k in chosen.items() if j != i]
            chosen[i] = int(np.argmin(fixed[i] + _among(label, middles, others)))
        if chosen == before:
            break
    return [label.candidates[0][chosen[i]] for i, label in enumerate(labels)]


def leader(label: Label, middle: np.ndarray) -> np.ndarray | None:
    """Return the end of the line that leads from a label's place to its box; nothing where it stands next to it."""
    edge = np.clip(label.own, middle - label.half, middle + label.half)
    return edge if math.dist(edge, label.own) > LEADER else None


def dotted(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Return dots (n, 2) along a line."""
    return start + np.linspace(0.0, 1.0, 2 + int(math.dist(start, end) / _SPACING))[:, None] * (end - start)


def _alone(label: Label, page: np.ndarray, dots: np.ndarray, shapes: Shapes) -> np.ndarray:
    """Return what speaks against each candidate of a label (n,), other labels aside."""
    middles, away = label.candidates
    low, top = middles - label.half, middles + label.half
    outside = np.maximum(2.0 - low, 0.0).sum(axis=1) + np.maximum(top - page + 2.0, 0.0).sum(axis=1)
    hit = _inside(dots, low - _CLEAR, top + _CLEAR).sum(axis=1)
    covered, edge = shapes.under(low, top)
    others = dots[np.linalg.norm(dots - label.own, axis=1) > 2.0 * LEADER]
    leaders = _leaders(label, middles)
    passed = (((leaders[:, :, None] - others) ** 2).sum(axis=3) < _CLEAR**2).any(axis=(1, 2))
    return away + _OUTSIDE * outside + _HIT * (hit + passed) + _EDGE * edge + _COVERED * covered


def _among(label: Label, middles: np.ndarray, others: Sequence[tuple[Label, np.ndarray]]) -> np.ndarray:
    """Return what other labels, where they stand, speak against each middle (n, 2) of a label."""
    if not others:
        return np.zeros(len(middles))
    at, half = np.array([a for _, a in others]), np.array([o.half for o, _ in others])
    shared = np.maximum(label.half + half - np.abs(middles[:, None] - at), 0.0)
    crossing = _inside(_leaders(label, middles)[:, :, None], at - half, at + half).any(axis=1).sum(axis=1)
    theirs = np.vstack([_leaders(o, a[None])[0] for o, a in others])
    below = _inside(theirs, middles - label.half, middles + label.half).any(axis=1)
    return _OVER * shared.prod(axis=2).sum(axis=1) + _CROSSED * (crossing + below)


def _leaders(label: Label, middles: np.ndarray) -> np.ndarray:
    """Return dots (n, _DOTS, 2) along the leaders of a label at middles (n, 2), all at its place where there is
    none.
    """
    edge = np.clip(label.own, middles - label.half, middles + label.half)
    near = np.linalg.norm(edge - label.own, axis=1) <= LEADER
    ends = np.where(near[:, None], label.own, edge)
    return label.own + np.linspace(0.0, 1.0, _DOTS)[:, None] * (ends - label.own)[:, None]


def _inside(dots: np.ndarray, low: np.ndarray, top: np.ndarray) -> np.ndarray:
    """Return which dots (m, 2) lie in which of the boxes (n, 2) to (n, 2), as (n, m); arrays of dots that broadcast
    against the boxes are taken as they are.
    """
    if dots.ndim == 2:
        dots, low, top = dots[None], low[:, None], top[:, None]
    return np.asarray(((dots > low) & (dots < top)).all(axis=-1))
