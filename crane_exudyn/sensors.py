"""The sensors that a machine may have, as data: one table from which names, units, places of effects and what is measured follow."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

from .errors import CraneError, nearest

#: the order of the state, but for what effects add to it
STATES = ("z1", "z4", "dz1", "dz4", "p1", "p2", "p3", "p4")


class Sizes(NamedTuple):
    """Sizes of one SI unit: noise of a usual sensor and an unknown bias, as standard deviations, and a bias that matters."""

    noise: float
    bias: float
    telling: float


_DEGREE = math.radians(1.0)
SIZES: Mapping[str, Sizes] = {
    "rad": Sizes(2e-3, _DEGREE, _DEGREE), "rad/s": Sizes(1e-2, _DEGREE, _DEGREE), "Pa": Sizes(5e4, 2e5, 1e5), "m": Sizes(1e-3, 5e-3, 1e-3)
}  # fmt: skip


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


#: The sensors of the PATU. The outer boom has one place: an encoder at A shows z4, an inclinometer z4_abs, and an effect at "z4" acts
#: on what that sensor shows, whichever of the two it is.
_PATU = (
    Sensor("z1", "rad", ("z1",), 0, "z1"), Sensor("z4", "rad", ("z4",), 1, "z4"), Sensor("z4_abs", "rad", ("z1", "z4"), 1, "z4"),
    Sensor("dz1", "rad/s", ("dz1",), 0), Sensor("dz4", "rad/s", ("dz4",), 1), Sensor("dz4_abs", "rad/s", ("dz1", "dz4"), 1),
    Sensor("p1", "Pa", ("p1",), 0, "p1"), Sensor("p2", "Pa", ("p2",), 0, "p2"),
    Sensor("p3", "Pa", ("p3",), 1, "p3"), Sensor("p4", "Pa", ("p4",), 1, "p4"),
    Sensor("s1", "m", (), 0), Sensor("s2", "m", (), 1),
)  # fmt: skip
#: by name
SENSORS: Mapping[str, Sensor] = MappingProxyType({sensor.name: sensor for sensor in _PATU})
#: the places of effects on sensors, in the order in which the hooks number them
PLACES = tuple(name for name, sensor in SENSORS.items() if sensor.place == name)


def sensor(name: str, table: Mapping[str, Sensor] = SENSORS) -> Sensor:
    """Return the sensor of that name. Raises CraneError with the nearest known one."""
    if name not in table:
        raise CraneError(f"sensor {name!r} is not known.{nearest(name, list(table))}")
    return table[name]
