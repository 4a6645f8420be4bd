"""The channels that a recording may have: their names, their SI units, and one measured channel."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

COMMANDS = ("u1", "u2")
VOLTAGES = ("U1", "U2")
SUPPLY = ("pp", "pt")
#: measured channels and their SI units
SENSORS: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(("z1", "z4", "z4_abs"), "rad")
    | dict.fromkeys(("dz1", "dz4", "dz4_abs"), "rad/s")
    | dict.fromkeys(("p1", "p2", "p3", "p4"), "Pa")
    | dict.fromkeys(("s1", "s2"), "m")
)
#: what no sensor measures, but simulations and estimates hold: angle and rate of a payload on a pendulum
UNSEEN: Mapping[str, str] = MappingProxyType({"theta": "rad", "dtheta": "rad/s"})
#: all channels that a recording may have, and their SI units ("" is a pure number)
CHANNELS: Mapping[str, str] = MappingProxyType(
    dict.fromkeys(COMMANDS, "")
    | dict.fromkeys(VOLTAGES, "V")
    | dict(SENSORS)
    | dict.fromkeys(SUPPLY, "Pa")
    | dict(UNSEEN)
)


@dataclass(frozen=True)
class Channel:
    """One measured channel: `time` (n,) in s, increasing, not necessarily evenly, and `values` (n,) in SI."""

    time: np.ndarray
    values: np.ndarray
    unit: str = ""

    def __post_init__(self) -> None:
        for name in ("time", "values"):
            array = np.array(getattr(self, name), dtype=float)
            array.setflags(write=False)
            object.__setattr__(self, name, array)

    def __len__(self) -> int:
        return len(self.time)

    def at(self, time: np.ndarray) -> np.ndarray:
        """Return values at `time`, linear between samples, NaN outside the channel's own range."""
        return np.interp(time, self.time, self.values, left=np.nan, right=np.nan)

    def held(self, time: np.ndarray) -> np.ndarray:
        """Return values at `time`, linear between samples, the first and last value held outside."""
        return np.interp(time, self.time, self.values)
