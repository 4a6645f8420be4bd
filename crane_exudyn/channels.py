"""The channels that a recording may have: their names, their SI units, and one measured channel."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache

import numpy as np

from .errors import CraneError
from .frozen import frozen
from .layout import Layout

#: by unit, the size that no reading of a crane has: turns that no boom makes, rad/s, 1000 bar, m, m/s
BEYOND: Mapping[str, float] = frozen({"rad": 2.5 * math.pi, "rad/s": 20.0, "Pa": 1000e5, "m": 100.0, "m/s": 20.0})
#: by unit, in words, and what numbers beyond the above mostly are, with what makes SI of them in Python, and their unit
_BEYOND_IN_WORDS = {
    "rad": ("radians", "degrees", "np.deg2rad({})", "deg"),
    "rad/s": ("radians per second", "degrees per second", "np.deg2rad({})", "deg/s"),
    "m": ("metres", "millimetres", "1e-3 * {}", "mm"),
    "m/s": ("metres per second", "millimetres per second", "1e-3 * {}", "mm/s"),
}
#: a command, or a spool, may read a little beyond fully open, as sensors do; more than this is another unit
FULLY_OPEN = 1.05
#: a command above this opens a valve enough to be felt
OPEN = 0.05


@cache
def of(layout: Layout) -> Mapping[str, str]:
    """Return all channels that a recording of a machine may have, in their order, and their SI units ("" is a pure
    number).
    """
    return frozen(
        dict.fromkeys(layout.commands, "")
        | dict.fromkeys(layout.voltages, "V")
        | {name: sensor.unit for name, sensor in layout.sensors.items()}
        | dict.fromkeys(layout.supply, "Pa")
        | unseen(layout)
    )


def refuse_beyond(where: str, name: str, value: float, unit: str, written: str = "", *, in_file: bool = False) -> None:
    """Raise CraneError where a coordinate or rate in SI has a size that no machine's has: it is in another unit.

    Args:
        where: begins the message;  name, value, unit: of the number;  written: how the mend calls it, its value by
            default;  in_file: it stands in a file, where its unit can be written.
    """
    if unit in _BEYOND_IN_WORDS and abs(value) > BEYOND[unit]:
        si, meant, python, short = _BEYOND_IN_WORDS[unit]
        mend = f'"{{}} {short}"' if in_file else python
        raise CraneError(
            f"{where}: {name} = {value:g} is in {si}, and no crane exceeds {BEYOND[unit]:.3g}. If these are "
            f"{meant}, write {mend.format(written or f'{value:g}')}."
        )


def unseen(layout: Layout) -> dict[str, str]:
    """Return what no sensor measures, but simulations and estimates hold, and its SI units: angle and rate of a payload
    on a pendulum.
    """
    return {name: layout.unit_of(name) for name in layout.added}


#: a pause in a channel is a gap if it is so many times longer than usual, and this long in s
_GAP_RATIO, _GAP = 3.0, 0.05
#: seconds by which the end of a hold stands before the sample that shows something new
JUST_BEFORE = 1e-6


@dataclass(frozen=True)
class Channel:
    """One measured channel: `time` (n,) in s, increasing, not necessarily evenly, and `values` (n,) in SI."""

    time: np.ndarray
    values: np.ndarray
    unit: str = ""

    def __post_init__(self) -> None:
        for name in ("time", "values"):
            array = np.asarray(getattr(self, name), dtype=float)
            if array.flags.writeable:  # channels of one clock share what nobody can change
                array = array.copy()
                array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.time)

    def __repr__(self) -> str:
        span = f"{self.time[0]:g} … {self.time[-1]:g} s" if len(self) else "no time"
        return f"<Channel: {len(self)} samples over {span}, unit {self.unit or '1'}>"

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return values at `time`, linear between samples, NaN outside the channel's own range."""
        return np.interp(time, self.time, self.values, left=np.nan, right=np.nan)

    def held(self, time: np.ndarray) -> np.ndarray:
        """Return values at `time`, linear between samples, the first and last value held outside."""
        return np.interp(time, self.time, self.values)

    @property
    def longest_pause(self) -> float:
        """Return the longest time in s between two samples that is no gap."""
        steps = np.diff(self.time)
        return max(_GAP_RATIO * float(np.median(steps)), _GAP) if len(steps) else np.inf

    def gaps(self) -> np.ndarray:
        """Return the gaps (g, 2) in s: last sample before and first sample after each pause that is far longer than
        usual.
        """
        before = np.flatnonzero(np.diff(self.time) > self.longest_pause)
        return np.column_stack([self.time[before], self.time[before + 1]])

    def held_until(self, instants: np.ndarray) -> Channel:
        """Return the channel with one more sample just before each of some of its instants (g,), which still shows the
        value before it.
        """
        after = np.searchsorted(self.time, instants)
        time = np.insert(self.time, after, self.time[after] - JUST_BEFORE)
        return Channel(time, np.insert(self.values, after, self.values[after - 1]), self.unit)
