"""Windows of a recording, each with a first state of its own; and many side by side, as compiled code runs them.

Neighbouring windows are held together by a penalty on the jump between them, so that a model that lacks something stays
near the machine instead of drifting away. One window is an open-loop run.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import pairwise
from typing import Any, TypeVar

import numpy as np

from crane_exudyn.layout import Layout

from .data import Data, FitData, Samples

V = TypeVar("V", list[Any], np.ndarray)
#: size of a jump between two windows that is taken as one standard deviation, by unit; and that of a pendulum's states
_JUMP: Mapping[str, float] = {"rad": 3e-3, "m": 3e-3, "rad/s": 2e-2, "m/s": 2e-2, "Pa": 1e5}
_JUMP_OF_PENDULUM = 3e-2
#: most grid points of windows that are run side by side: much is shared, and their sensitivities stay in the cache
_SIDE_BY_SIDE = 1200


@cache
def jump_of(layout: Layout) -> np.ndarray:
    """Return the size of a jump between two windows that is taken as one standard deviation, for each state that there
    may be.
    """
    return np.array([*layout.sized(layout.states, _JUMP), *[_JUMP_OF_PENDULUM] * len(layout.added)])


@dataclass(frozen=True)
class Window:
    """A stretch of the grid with the samples that lie in it, of one of the recordings."""

    start: int
    data: FitData
    recording: int = 0


def cut(data: Data, seconds: float) -> list[Window]:
    """Return windows of about `seconds` each, one recording after the other; none where the commands are unknown.

    They are joined where a sample lies, so that windows of other steps are the same.
    """
    windows = []
    for i, part in enumerate(data.parts):
        unit = max(1, round(part.interval / part.step))
        for first, last in part.stretches:
            number = max(1, min(round((last - first) * part.step / seconds), (last - first) // unit))
            inner = first + unit * np.round(np.linspace(0, (last - first) / unit, number + 1)[1:-1]).astype(int)
            edges = [first, *inner.tolist(), last]
            windows += [Window(int(a), part.part(int(a), int(b)), i) for a, b in pairwise(edges)]
    return windows


def follows(before: Window, after: Window) -> bool:
    """Whether a window begins where another ends; between them commands may be unknown, and then nothing joins them."""
    return before.recording == after.recording and before.start + len(before.data.time) - 1 == after.start


def alike(some: Sequence[Window], others: Sequence[Window]) -> bool:
    """Whether windows hold the same samples, whatever the steps of their runs."""
    return len(some) == len(others) and all(
        a.recording == b.recording and abs(a.data.time[0] - b.data.time[0]) < 1e-9 and a.data.count == b.data.count
        for a, b in zip(some, others, strict=True)
    )


@dataclass(frozen=True)
class Group:
    """K windows of one recording side by side, N instants in all: each window has all of its own, the first and the
    last one too.
    """

    windows: tuple[Window, ...]

    @cached_property
    def first(self) -> np.ndarray:
        """Instant at which each window begins, (K,)."""
        return np.cumsum([0, *(len(w.data.time) for w in self.windows[:-1])])

    @cached_property
    def last(self) -> np.ndarray:
        """And the one at which it ends, (K,)."""
        return np.cumsum([len(w.data.time) for w in self.windows]) - 1

    @property
    def step(self) -> float:
        """Of the recording's grid, s."""
        return self.windows[0].data.step

    @cached_property
    def time(self) -> np.ndarray:
        """Of each instant, s, (N,)."""
        return np.concatenate([w.data.time for w in self.windows])

    @cached_property
    def place(self) -> np.ndarray:
        """Where each instant lies on the grid of the whole recording, (N,)."""
        return np.concatenate([np.arange(w.start, w.start + len(w.data.time)) for w in self.windows])

    @cached_property
    def owner(self) -> tuple[np.ndarray, ...]:
        """By channel the window of each sample."""
        numbers = np.arange(len(self.windows))
        each = zip(*(w.data.samples for w in self.windows), strict=True)
        return tuple(np.repeat(numbers, [len(s.values) for s in own]) for own in each)

    @cached_property
    def samples(self) -> tuple[Samples, ...]:
        """By channel the samples of all windows, where they lie among the instants."""
        if len(self.windows) == 1:
            return self.windows[0].data.samples
        found = []
        for owner, own in zip(self.owner, zip(*(w.data.samples for w in self.windows), strict=True), strict=True):
            index = np.concatenate([s.index for s in own]) + self.first[owner]
            fraction, values = (np.concatenate([getattr(s, name) for s in own]) for name in ("fraction", "values"))
            around = None if own[0].around is None else np.concatenate([s.around for s in own])
            found.append(replace(own[0], index=index, fraction=fraction, values=values, around=around))
        return tuple(found)

    def by_window(self, rows: np.ndarray) -> list[np.ndarray]:
        """Return rows (N, …) of all instants, window by window."""
        return np.split(rows, self.first[1:])

    def split(self, by_channel: Sequence[np.ndarray]) -> list[list[np.ndarray]]:
        """Return by window, and in it by channel, what is given by channel for all samples (n, …)."""
        numbers = np.arange(1, len(self.windows))
        each = [np.split(r, np.searchsorted(own, numbers)) for r, own in zip(by_channel, self.owner, strict=True)]
        return [list(own) for own in zip(*each, strict=True)]


def by_recording(data: Data, windows: Sequence[Window]) -> Iterator[tuple[int, FitData, list[int]]]:
    """Yield the number of each recording, its data, and which of the windows are its own."""
    for i, part in enumerate(data.parts):
        yield i, part, [k for k, w in enumerate(windows) if w.recording == i]


def side_by_side(windows: Sequence[Window], most: int = _SIDE_BY_SIDE) -> list[Group]:
    """Return windows of one recording in groups of at most so many instants, at least one in each."""
    groups, own, count = list[Group](), list[Window](), 0
    for window in windows:
        if own and count + len(window.data.time) > most:
            groups.append(Group(tuple(own)))
            own, count = [], 0
        own.append(window)
        count += len(window.data.time)
    return [*groups, Group(tuple(own))] if own else groups


def shared_out(groups: Sequence[Group], rows: V) -> list[V]:
    """Return rows, one a window, by group."""
    last = np.cumsum([len(g.windows) for g in groups]).tolist()
    return [rows[end - len(g.windows) : end] for g, end in zip(groups, last, strict=True)]


def pieces_of(window: Window, longest: int) -> list[Window]:
    """Return a window as pieces of equal length, each from the last grid point of the one before."""
    last = len(window.data.time) - 1
    edges = np.linspace(0, last, 1 + math.ceil(last / longest)).round().astype(int).tolist()
    return [Window(window.start + a, window.data.part(a, b), window.recording) for a, b in pairwise(edges)]
