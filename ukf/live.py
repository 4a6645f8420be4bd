"""Samples that come one after the other: what the model gets of them as inputs, and what is odd about them.

A recording is looked at as a whole before a filter runs over it (`signals.Signals.plan`); live, every sample has to be
taken as it comes.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from crane_exudyn.crane import Crane

from .monitor import ABSENT
from .recorder import REJECTED, kind_of
from .samples import impossible

if TYPE_CHECKING:
    from crane_exudyn.inputs import SpoolPath

#: after so many growing stamps that are not later than the last good one the clock has gone back
_LATE_STAMPS = 10
#: the last stamp that was not later than a good one, and how many of them grew in a row
_IN_ORDER = (np.inf, 0)

#: what is odd about a sample: (where, what)
Odd = list[tuple[str, str]]


class Stream:
    """What has to be remembered from one live sample to the next, of a crane and some sensors."""

    def __init__(self, crane: Crane, sensors: Sequence[str], units: Sequence[str]) -> None:
        """`sensors` are channels, `units` their SI units."""
        self._crane, self._sensors = crane, tuple(sensors)
        self._units = (*units, *("Pa" for _ in crane.layout.supply))
        self._spool: SpoolPath | None = None
        self._input: np.ndarray | None = None
        self._command: np.ndarray | None = None
        self._late = _IN_ORDER
        self._odd: set[tuple[str, str]] = set()
        self._flags = np.zeros(len(self._sensors), np.uint8)

    @property
    def begun(self) -> bool:
        """Whether there was a sample; before it, the filter may have gone over a recording."""
        return self._input is not None

    def usable(self, command: np.ndarray, readings: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, Odd]:
        """Return command (valves,), values (k,) of the sensors and supply pressures (2,) of a sample as the filter
        takes them, and what is odd about it.

        A command that is missing stays as it was, one beyond ±1 is cut; a reading that no crane shows is missing; a
        supply pressure that is missing stays as it was, NaN before the first.
        """
        lay, odd = self._crane.layout, Odd()
        for k, (name, unit) in enumerate(zip((*self._sensors, *lay.supply), self._units, strict=True)):
            if impossible(unit, readings[k]):
                odd.append((name, f"no crane shows this: {readings[k]:g}, treated as missing"))
                readings[k] = np.nan
        values, supply = readings[: len(self._sensors)], readings[len(self._sensors) :]
        if self._input is not None:
            supply = np.where(np.isnan(supply), self._input[lay.supplies], supply)
        missing = ~np.isfinite(command)
        if missing.any():
            odd.append(("commands", "missing: the last one is kept"))
            command[missing] = 0.0 if self._command is None else self._command[missing]
        if (np.abs(command) > 1.0).any():
            odd.append(("commands", "beyond ±1: limited to ±1"))
            command = np.clip(command, -1.0, 1.0)
        return command, values, supply, odd

    def in_order(self) -> None:
        """Note that a stamp was later than the last good one."""
        self._late = _IN_ORDER

    def went_back(self, time: float) -> bool:
        """Whether so many stamps in a row were not later than the last good one that it must be that one which was
        wrong.
        """
        last, count = self._late
        self._late = (time, count + 1 if time > last else 1)
        return self._late[1] >= _LATE_STAMPS

    def news(self, odd: Odd) -> Odd:
        """Return what is odd about a sample and was not so about the one before."""
        before, self._odd = self._odd, {(where, kind_of(text)) for where, text in odd}
        return [(where, text) for where, text in odd if (where, kind_of(text)) not in before]

    def rejected(self, flags: np.ndarray) -> Odd:
        """Return which sensors begin to be rejected, and why, by how each was used (k,)."""
        found = Odd()
        for row in np.flatnonzero((flags != self._flags) & (flags != ABSENT)):
            if flags[row] in REJECTED:
                found.append((self._sensors[row], REJECTED[int(flags[row])]))
            self._flags[row] = flags[row]
        return found

    def rest(self, time: float, command: np.ndarray, supply: np.ndarray) -> None:
        """Take the spools to be at rest at a command (valves,)."""
        from crane_exudyn.inputs import SpoolPath

        self._spool = SpoolPath(self._crane)
        spool = np.asarray(self._spool.step(time, command), float)
        self._input = np.concatenate([spool, supply])
        self._command = command

    def inputs(self, times: np.ndarray, command: np.ndarray, supply: np.ndarray) -> np.ndarray:
        """Return the inputs (s, valves + 2) at `times` (s,) between the last sample and one with a command (valves,)
        and supply pressures (2,), commands being linear between.
        """
        assert self._spool is not None and self._command is not None and self._input is not None
        inputs = np.empty((times.size, self._input.size))
        inputs[0] = self._input
        for k in range(1, times.size):
            share = (times[k] - times[0]) / (times[-1] - times[0])
            between = self._command + share * (command - self._command)
            inputs[k] = [*self._spool.step(float(times[k]), between), *supply]
        self._command, self._input = command, inputs[-1].copy()
        return inputs
