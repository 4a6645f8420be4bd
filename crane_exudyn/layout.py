"""Layout: where a machine's coordinates, chambers, valves and supplies stand in its state and in its inputs."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

from .frozen import frozen
from .sensors import Sensor

#: the most coordinates (and cylinders) of a machine: how many places compiled code keeps for what acts on them
MOST_COORDINATES = 6
#: kinds of places at which effects act, and how many places compiled code keeps for each
MOST = {
    "": 1,
    "cylinders": MOST_COORDINATES,
    "chambers": 2 * MOST_COORDINATES,
    "joints": MOST_COORDINATES,
    "sensors": 3 * MOST_COORDINATES,
}


@dataclass(frozen=True)
class Layout:
    """The names of a machine's things, in order, and the places that follow from it. ::

        state   coordinates | their rates | pressures of the chambers | states that effects add
        inputs  spool positions | supply pressures | disturbances: moments, forces on E, flows into chambers

    Attributes:
        coordinates: of the joints; joints, bodies: which joint each one belongs to, and which body it moves.
        parents: the coordinate that carries each coordinate's base, which stands before it; "" where that is fixed.
        slides: whether each coordinate is a way in m instead of an angle in rad.
        cylinders: names; sides: (piston side, rod side) of each, its chambers; loaded: the chamber of each
            that carries its load; lengths: the channels of their lengths.
        commands, voltages: the channels of their valves; a valve's spool position has the name of its voltage.
        driven: the coordinate that each cylinder drives.
        supply: pump and tank pressure.
        added: states that effects may add.
        has_payload: whether there is one, for effects to act on.
    """

    coordinates: tuple[str, ...]
    joints: tuple[str, ...]
    bodies: tuple[str, ...]
    parents: tuple[str, ...]
    cylinders: tuple[str, ...]
    sides: tuple[tuple[str, str], ...]
    loaded: tuple[str, ...]
    lengths: tuple[str, ...]
    commands: tuple[str, ...]
    voltages: tuple[str, ...]
    driven: tuple[str, ...]
    slides: tuple[bool, ...] = ()
    supply: tuple[str, str] = ("pp", "pt")
    added: tuple[str, ...] = ()
    has_payload: bool = True

    def __repr__(self) -> str:
        return f"<Layout: coordinates {', '.join(self.coordinates)}; chambers {', '.join(self.chambers)}>"

    # -- the state -------------------------------------------------------------------------------------------------

    @cached_property
    def rates(self) -> tuple[str, ...]:
        """Names of the coordinates' rates."""
        return tuple(f"d{name}" for name in self.coordinates)

    @cached_property
    def chambers(self) -> tuple[str, ...]:
        """Names of all chambers, piston side before rod side."""
        return tuple(name for pair in self.sides for name in pair)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states, without those that effects add."""
        return (*self.coordinates, *self.rates, *self.chambers)

    @cached_property
    def all_states(self) -> tuple[str, ...]:
        """Names of the states, with those that effects add."""
        return (*self.states, *self.added)

    def index(self, name: str) -> int:
        """Return where a state stands. Raises ValueError for a name that is none."""
        return self.all_states.index(name)

    @property
    def positions(self) -> slice:
        """Where the coordinates stand in a state."""
        return slice(0, len(self.coordinates))

    @property
    def velocities(self) -> slice:
        """Where the rates stand in a state."""
        return slice(len(self.coordinates), 2 * len(self.coordinates))

    @property
    def motion(self) -> slice:
        """Where coordinates and rates stand in a state."""
        return slice(0, 2 * len(self.coordinates))

    @property
    def pressures(self) -> slice:
        """Where the chambers' pressures stand in a state."""
        first = 2 * len(self.coordinates)
        return slice(first, first + 2 * len(self.sides))

    @property
    def basic(self) -> slice:
        """Where everything stands in a state but what effects add."""
        return slice(0, self.pressures.stop)

    @property
    def extra(self) -> slice:
        """Where the states stand that effects add."""
        return slice(self.pressures.stop, self.pressures.stop + len(self.added))

    def unit_of(self, state: str) -> str:
        """Return the SI unit of a state or of a disturbance."""
        if state in self.chambers:
            return "Pa"
        if state in self.disturbances:
            return self._unit_of_disturbance(state)
        name = state.removeprefix("d") if state in (*self.rates, *self.added[1:]) else state
        way = name in self.coordinates and any(self.slides) and self.slides[self.coordinates.index(name)]
        return ("m" if way else "rad") + ("" if name == state else "/s")

    def _unit_of_disturbance(self, name: str) -> str:
        if name in self.flows:
            return "m^3/s"
        turns = name in self.torques and not (self.slides and self.slides[self.torques.index(name)])
        return "N*m" if turns else "N"

    def sized(self, names: Iterable[str], sizes: Mapping[str, float]) -> tuple[float, ...]:
        """Return a size for each of some states or disturbances, from a table of sizes by their SI unit."""
        return tuple(sizes[self.unit_of(name)] for name in names)

    @cached_property
    def sensors(self) -> Mapping[str, Sensor]:
        """The sensors that the machine may have, by name."""
        return frozen({sensor.name: sensor for sensor in sensors_of(self)})

    # -- where effects act ------------------------------------------------------------------------------------------

    def places(self, kind: str) -> tuple[str, ...]:
        """Return the places of a kind of `MOST`; of sensors, those of coordinates and chambers."""
        sensors = (*self.coordinates, *self.chambers)
        return {
            "": ("",),
            "cylinders": self.cylinders,
            "chambers": self.chambers,
            "joints": self.joints,
            "sensors": sensors,
        }[kind]

    def place_number(self, kind: str, place: str) -> int:
        """Return the number by which compiled code knows a place. Raises ValueError for one that the machine does not
        have.
        """
        if kind == "sensors" and place in self.chambers:
            return MOST_COORDINATES + self.chambers.index(place)
        return self.places(kind).index(place)

    # -- cylinders and joints --------------------------------------------------------------------------------------

    def cylinder_of(self, name: str) -> int:
        """Return the number of the cylinder that has a chamber, or drives a coordinate, of that name."""
        owned = zip(self.driven, self.sides, strict=True)
        return next(c for c, (driven, sides) in enumerate(owned) if name in (driven, *sides))

    def chambers_of(self, cylinder: int) -> slice:
        """Return where a cylinder's chambers stand among all chambers."""
        return slice(2 * cylinder, 2 * cylinder + 2)

    def pressures_of(self, cylinder: int) -> slice:
        """Return where a cylinder's pressures (piston side, rod side) stand in a state."""
        first = self.pressures.start + 2 * cylinder
        return slice(first, first + 2)

    def side_of(self, chamber: str) -> str:
        """Return a chamber as people say it, such as "lift, piston side"."""
        cylinder = self.cylinder_of(chamber)
        return f"{self.cylinders[cylinder]}, {('piston', 'rod')[self.sides[cylinder].index(chamber)]} side"

    def absolute(self, coordinate: str) -> tuple[str, ...]:
        """Return the coordinates whose sum is a body's coordinate against the ground, from the ground on."""
        k = self.coordinates.index(coordinate)
        own = () if self.slides and self.slides[k] else (coordinate,)
        return (*(self.absolute(self.parents[k]) if self.parents[k] else ()), *own)

    def carriers(self, coordinate: str) -> tuple[str, ...]:
        """Return the coordinates whose sum is the angle of what carries a body, from the ground on."""
        return tuple(name for name in self.absolute(coordinate) if name != coordinate)

    # -- the inputs ------------------------------------------------------------------------------------------------

    @cached_property
    def inputs(self) -> tuple[str, ...]:
        """Names of the inputs without disturbances: spool positions and supply pressures."""
        return (*self.voltages, *self.supply)

    @cached_property
    def disturbances(self) -> tuple[str, ...]:
        """Names of what may act without a law that explains it: moments (forces on sliding joints), forces on E, flows
        into chambers.
        """
        return (*self.torques, "force.x", "force.y", *self.flows)

    @cached_property
    def torques(self) -> tuple[str, ...]:
        """Names of unknown moments on the joints."""
        return tuple(f"torque.{name}" for name in self.joints)

    @cached_property
    def flows(self) -> tuple[str, ...]:
        """Names of unknown flows into the chambers."""
        return tuple(f"flow.{name}" for name in self.chambers)

    @property
    def equations(self) -> tuple[str, ...]:
        """Names of the balances, by what is missing in them: moments on the joints, flows into the chambers."""
        return (*self.torques, *self.flows)

    @cached_property
    def all_inputs(self) -> tuple[str, ...]:
        """Names of the inputs with disturbances behind."""
        return (*self.inputs, *self.disturbances)

    @property
    def closed(self) -> tuple[float, ...]:
        """The inputs with closed valves and the machine's own supply pressures (NaN)."""
        return (*(0.0 for _ in self.voltages), *(math.nan for _ in self.supply))

    @property
    def spools(self) -> slice:
        """Where the spool positions stand in the inputs."""
        return slice(0, len(self.voltages))

    @property
    def supplies(self) -> slice:
        """Where the supply pressures stand in the inputs."""
        return slice(len(self.voltages), len(self.inputs))

    @property
    def driving(self) -> slice:
        """Where everything stands in the inputs but disturbances."""
        return slice(0, len(self.inputs))


def sensors_of(layout: Layout) -> Iterator[Sensor]:
    """Yield the sensors that a machine may have.

    A body that stands on another has one place: an encoder at its joint shows the coordinate, an inclinometer the
    absolute angle, and an effect at that place acts on what the sensor shows, whichever of the two it is.
    """
    for rate in ("", "d"):
        for name in layout.coordinates:
            cylinder, place, sum_ = layout.cylinder_of(name), "" if rate else name, layout.absolute(name)
            unit = layout.unit_of(rate + name)
            yield Sensor(rate + name, unit, (rate + name,), cylinder, place)
            if len(sum_) > 1 and sum_[-1] == name:
                yield Sensor(f"{rate}{name}_abs", unit, tuple(rate + n for n in sum_), cylinder, place)
    for name in layout.chambers:
        yield Sensor(name, "Pa", (name,), layout.cylinder_of(name), name)
    for cylinder, name in enumerate(layout.lengths):
        yield Sensor(name, "m", (), cylinder)
