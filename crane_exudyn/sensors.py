"""The sensors that a machine may have, as data: one table from which names, units, places of effects and what is
measured follow.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

from .errors import CraneError, nearest


class Sizes(NamedTuple):
    """Sizes of one SI unit: noise of a usual sensor and an unknown bias, as standard deviations, and a bias that
    matters.
    """

    noise: float
    bias: float
    telling: float


_DEGREE = math.radians(1.0)
SIZES: Mapping[str, Sizes] = {
    "rad": Sizes(2e-3, _DEGREE, _DEGREE),
    "rad/s": Sizes(1e-2, _DEGREE, _DEGREE),
    "Pa": Sizes(5e4, 2e5, 1e5),
    "m": Sizes(1e-3, 5e-3, 1e-3),
    "m/s": Sizes(1e-2, 5e-3, 5e-3),
}


@dataclass(frozen=True)
class Sensor:
    """One sensor.

    Attributes:
        name: of its channel; unit: SI.
        shows: the states of which it shows the sum; none: it shows the pin-to-pin length of its cylinder.
        cylinder: the number of the cylinder whose valve moves what it shows.
        place: where effects act on what it shows; "": only those of the whole machine do.
    """

    name: str
    unit: str
    shows: tuple[str, ...]
    cylinder: int
    place: str = ""

    @property
    def sizes(self) -> Sizes:
        """Sizes of what it shows."""
        return SIZES[self.unit]


def sensor(name: str, table: Mapping[str, Sensor]) -> Sensor:
    """Return the sensor of that name among those of a layout. Raises CraneError with the nearest known one."""
    if name not in table:
        raise CraneError(f"sensor {name!r} is not known.{nearest(name, list(table))}")
    return table[name]
