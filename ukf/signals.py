"""A recording as the filter needs it: when to predict, with which inputs, and what was measured then.

Every channel may have its own clock. The instants of the filter are all those at which one of its sensors was read;
between two of them the engine takes even inner steps. Oddities are told, not repaired in silence: repeated stamps, time
running backwards, gaps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.layout import Layout
from crane_exudyn.recording import given_recording
from crane_exudyn.signals import early
from crane_exudyn.simulation import inner_grid

from .samples import impossible

Series = tuple[np.ndarray, np.ndarray]
_SAME = 1e-7  # s: stamps of different clocks that are closer than this are one instant
_FIRST = 5  # samples of a sensor that the start is taken from, so that a single bad one does no harm
#: s without any sample beyond which nothing can be predicted that is worth its time
LONG_GAP = 10.0
_GLANCE = 0.1  # s, in which the angles must show a rate for it to be believed


@dataclass(frozen=True)
class Plan:
    """Instants `time` (N,), s, measurements `values` (N, k), SI, with NaN, inner `grid` (G,), s, with `inputs` (G,
    valves + 2), in [-1, 1] and Pa.

    `inner[k]` is where instant k stands in the grid; `series` are the known samples of each sensor of a machine with
    this `layout`.
    """

    time: np.ndarray
    values: np.ndarray
    grid: np.ndarray
    inputs: np.ndarray
    inner: np.ndarray
    series: Mapping[str, Series]
    events: list[tuple[float, str, str]]
    layout: Layout

    def first_readings(self, at: float = -np.inf) -> tuple[dict[str, float], dict[str, float]]:
        """Return the readings, SI, to start from at `at`, s, or at the first instant, and how far they may be from that
        instant because the crane moves, SI, both by channel.

        A sensor that is first read later (`crane_exudyn.signals.early`) says nothing of that instant and is left out.
        Rates are given where the coordinates show them.
        """
        at = max(at, float(self.time[0]))
        early_on = {n: early(t, at) for n, (t, _) in self.series.items()}
        shown = {n: (t[early_on[n]], y[early_on[n]]) for n, (t, y) in self.series.items()}
        shown = {n: (t, y) for n, (t, y) in shown.items() if t.size}
        first = {c: float(np.median(y[:_FIRST])) for c, (_, y) in shown.items()} | _rates(shown, self.layout)
        spread = {c: float(np.subtract(*np.percentile(y[:_FIRST], [75, 25]))) for c, (_, y) in shown.items()}
        return first, spread

    def without(self, channels: Sequence[str], since: Mapping[str, float]) -> Plan:
        """Return the plan without what the channels (the columns of `values`) in `since` showed before those times."""
        if not since:
            return self
        values, series = self.values.copy(), dict(self.series)
        for name, begin in since.items():
            values[self.time < begin, channels.index(name)] = np.nan
            time, own = series[name]
            series[name] = time[time >= begin], own[time >= begin]
        return replace(self, values=values, series=series)

    def until(self, time: float) -> int:
        """Return how many instants there are up to `time`, the one that follows included."""
        return min(int(np.searchsorted(self.time, time, side="right")) + 1, self.time.size)


@dataclass(frozen=True)
class Signals:
    """Spool commands, sensors and supply pressures in SI, each with its own clock.

    Attributes:
        command_time: (n,) s; commands: (n, valves) in [-1, 1], linear between samples.
        sensors: {channel: (time (m,), values (m,))}, NaN for missing.
        supply: {"pp" or "pt": (time, values)} if measured.
    """

    command_time: np.ndarray
    commands: np.ndarray
    sensors: Mapping[str, Series]
    supply: Mapping[str, Series] = field(default_factory=dict)
    name: str = "recording"
    notes: tuple[str, ...] = ()

    @classmethod
    def of(cls, recording: Any, crane: Crane) -> Signals:
        """Return the signals of a `crane_exudyn.recording.Recording`, or of its file or a simulation; voltages are
        turned into commands by the crane.
        """
        recording = given_recording(recording, crane.layout, "recording")
        time, commands = recording.commands(crane)
        series = {n: (c.time, c.values) for n, c in recording.channels.items()}
        return cls(
            np.asarray(time, float),
            np.asarray(commands, float),
            {n: series[n] for n in crane.layout.sensors if n in series},
            {n: series[n] for n in crane.layout.supply if n in series},
            str(recording.name),
            tuple(recording.notes),
        )

    def thinned(self, rate: float, layout: Layout) -> Signals:
        """Return the signals with at most about `rate` known samples a second of each sensor of a machine."""

        def part(name: str, time: np.ndarray, values: np.ndarray) -> Series:
            time, values = clean(time, values, name, layout.sensors[name].unit, [])
            every = max(1, round(1.0 / (rate * float(np.median(np.diff(time)))))) if time.size > 1 else 1
            return time[::every], values[::every]

        return replace(self, sensors={n: part(n, *series) for n, series in self.sensors.items()})

    def plan(self, crane: Crane, channels: Sequence[str], max_step: float) -> Plan:
        """Return the filter's instants for these channels.

        Raises:
            CraneError: none of the channels was recorded, or fewer than two samples.
        """
        from crane_exudyn.drive import spool_on

        events = [(float("nan"), "file", note) for note in self.notes]
        present = [c for c in channels if c in self.sensors]
        if not present:
            raise CraneError(
                f"{self.name}: none of the estimator's sensors ({', '.join(channels)}) was recorded; "
                f"there are {', '.join(self.sensors) or 'none'}. Choose the sensors among these."
            )
        lay = crane.layout
        series = {c: clean(*self.sensors[c], c, lay.sensors[c].unit, events) for c in present}
        time = instants(series)
        if time.size < 2:
            raise CraneError(f"{self.name}: fewer than two samples of {', '.join(present)}. Give a longer recording.")
        values = np.full((time.size, len(channels)), np.nan)
        for column, name in enumerate(channels):
            if name in series:
                t, y = series[name]
                values[nearest_index(time, t), column] = y
        _note_gaps(time, events)
        grid, inner = _grid(time, max_step)
        spool = spool_on(crane, grid, self.command_time, self.commands)
        inputs = np.column_stack([spool, *(self._supply(n, grid) for n in lay.supply)])
        return Plan(time, values, grid, np.ascontiguousarray(inputs), inner, series, events, lay)

    def _supply(self, name: str, grid: np.ndarray) -> np.ndarray:
        if name not in self.supply:
            return np.full(grid.size, np.nan)
        t, y = clean(*self.supply[name], name, "Pa", [])
        return _interpolated(grid, t, y)


def _grid(time: np.ndarray, max_step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return the inner grid (G,) and where the instants stand in it; nothing is between the two ends of a long gap."""
    stretches = np.split(time, np.flatnonzero(np.diff(time) > LONG_GAP) + 1)
    grids, rows = zip(*(inner_grid(stretch, max_step) for stretch in stretches), strict=True)
    before = np.cumsum([0, *(grid.size for grid in grids[:-1])])
    return np.concatenate(grids), np.concatenate([r + b for r, b in zip(rows, before, strict=True)])


def _interpolated(grid: np.ndarray, time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return values linear between samples, constant outside; NaN samples are skipped."""
    known = np.isfinite(values)
    return np.interp(grid, time[known], values[known]) if known.any() else np.full(grid.size, np.nan)


def _rates(series: Mapping[str, Series], layout: Layout) -> dict[str, float]:
    """Return the rates with which the coordinates set out, where they stand out of the noise: a recording may begin in
    motion.
    """
    rates = {}
    for shown in (n for n, own in layout.sensors.items() if own.place in layout.coordinates):
        time, values = series.get(shown, (np.empty(0), np.empty(0)))
        glance = time <= time[:1] + _GLANCE
        if glance.sum() < _FIRST or f"d{shown}" in series:
            continue
        (slope, _), covariance = np.polyfit(time[glance] - time[0], values[glance], 1, cov=True)
        if abs(slope) > 6.0 * np.sqrt(covariance[0, 0]):
            rates[f"d{shown}"] = float(slope)
    return rates


def clean(time: np.ndarray, values: np.ndarray, name: str, unit: str, events: list[tuple[float, str, str]]) -> Series:
    """Return the known samples in increasing order of time; repeated and backward stamps are left out and told."""
    time, values = np.asarray(time, float), np.asarray(values, float)
    wrong = impossible(unit, values)
    if wrong.any():
        text = f"no crane shows {values[wrong][0]:g}: {wrong.sum()} such samples treated as missing"
        events.append((float(time[wrong][0]), name, text))
    known = np.isfinite(time) & np.isfinite(values) & ~wrong
    if not known.all():
        time, values = time[known], values[known]
    if time.size == 0:
        events.append((float("nan"), name, "no sample at all"))
        return time, values
    latest = np.maximum.accumulate(time)
    late = np.concatenate([[False], time[1:] <= latest[:-1]])
    for stamp in time[late]:
        events.append((float(stamp), name, "time stamp not later than the last one: sample left out"))
    return (time[~late], values[~late]) if late.any() else (time, values)


def instants(series: Mapping[str, Series]) -> np.ndarray:
    """Return all different instants (N,) at which any channel was read."""
    stacked = np.sort(np.concatenate([t for t, _ in series.values()]))
    return stacked[np.concatenate([[True], np.diff(stacked) > _SAME])] if stacked.size else stacked


def nearest_index(time: np.ndarray, stamps: np.ndarray) -> np.ndarray:
    """Return the index in `time` (N,) of the instant to which each stamp (m,) belongs."""
    return np.clip(np.searchsorted(time, stamps + _SAME, side="right") - 1, 0, time.size - 1)


def _note_gaps(time: np.ndarray, events: list[tuple[float, str, str]]) -> None:
    steps = np.diff(time)
    usual = float(np.median(steps))
    for k in np.flatnonzero((steps > 10 * usual) & (steps > 0.05) & (steps <= LONG_GAP)):
        events.append((float(time[k]), "time", f"gap of {steps[k]:.3f} s, bridged by the prediction"))
