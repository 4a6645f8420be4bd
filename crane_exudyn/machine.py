"""Machine: which bodies, joints, loops and cylinders a planar hydraulic machine has, as data.

A machine is a tree of bodies, each carried by another one or by the ground through a joint with a coordinate of its
own, and loops: two bodies one behind the other whose angles follow from a joint that closes the loop. Everything that
compiled code needs to know of it stands in one table of integers, `Machine.topology`; its numbers stand in the vector
P.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import takewhile

import numpy as np

from . import parameters
from .layout import Layout

GROUND = "ground"
REVOLUTE, PRISMATIC = "revolute", "prismatic"

# The table `topology`. Row 0 holds counts; then a row a body, a row a loop, a row a cylinder, a row a pin.
# row 0: numbers of bodies, loops and cylinders (as many as coordinates), the payload's body (-1: none) and point
BODIES, LOOPS, CYLINDERS, TIP_BODY, TIP_POINT = range(5)
# a body: the body that carries it (-1: the ground), its kind, the pin on the carrier and on itself (places in P; -1:
# its origin), where its numbers stand in P, its coordinate (a dependent body: -1), and where the direction stands in P
# along which it slides
CARRIER, KIND, PIN, OWN_PIN, NUMBERS, COORDINATE, DIRECTION = range(7)
TURNS, SLIDES, FIRST_OF_LOOP, SECOND_OF_LOOP = range(4)
# a loop: its first dependent body (the second is the next), the body that the loop ends on, the pin on the second
# dependent body and on that one, and the side of the line from first pin to last on which the pin between the dependent
# bodies lies (1: left, -1: right)
DEPENDENT, LAST, CUT_PIN, LAST_PIN, SIDE = range(5)
# a cylinder: body and point of its base, body and point of its rod end, and which chamber carries the load (0: piston
# side)
BASE_BODY, BASE, ROD_BODY, ROD_END, LOADED = range(5)
# a pin: the body that it is on (-1: the ground), its place in P, and the body, loop or cylinder (by its row, the tip
# behind them) that it is the first or second pin of
PIN_BODY, PIN_POINT, PIN_OF, PIN_END = range(4)
N_COLUMNS = 7


@dataclass(frozen=True)
class Joint:
    """A joint between two bodies.

    Attributes:
        name: its own;  kind: "revolute" or "prismatic";  carrier, body: the bodies that it joins, one of them carried
            by the other.
        pin: point on the carrier;  own_pin: point on the body; "" for the origin of its frame.
        coordinate: name of the angle (or way) of the body against its carrier; "" for a joint that closes a loop.
        side: of a joint that closes a loop: 1 where the pin between the two dependent bodies lies left of the line from
            the first pin to the last, -1 where it lies right of it.
    """

    name: str
    kind: str
    carrier: str
    body: str
    pin: str
    own_pin: str = ""
    coordinate: str = ""
    side: int = 1

    @property
    def closes(self) -> bool:
        """Whether it closes a loop."""
        return not self.coordinate


@dataclass(frozen=True)
class Cylinder:
    """A cylinder between a point (base) of one body and a point (rod end) of another, with its valve and its
    channels.
    """

    name: str
    bodies: tuple[str, str]
    points: tuple[str, str]
    chambers: tuple[str, str]
    loaded: str
    length: str
    command: str
    voltage: str


@dataclass(frozen=True)
class Machine:
    """Bodies, joints and cylinders of a machine by name, and what follows from them.

    Attributes:
        bodies: in the order in which they can be placed: a body comes after its carrier, the two dependent bodies of a
            loop come one after the other, behind the body that the loop ends on.
        joints: the one that carries each body, in the order of the bodies, then those that close loops.
        independent: coordinates of the state, in its order.
        cylinders: in the order of valves and chambers.
        payload: body and point of the payload, at which forces on the tip act as well; ("", "") without.
        points: the body that carries each point ("ground" for the ground), in the order of P.
    """

    bodies: tuple[str, ...]
    joints: tuple[Joint, ...]
    independent: tuple[str, ...]
    cylinders: tuple[Cylinder, ...]
    payload: tuple[str, str]
    points: Mapping[str, str]

    def __repr__(self) -> str:
        return f"<Machine: bodies {', '.join(self.bodies)}; cylinders {', '.join(c.name for c in self.cylinders)}>"

    def __hash__(self) -> int:
        return hash((self.bodies, self.joints, self.independent, self.cylinders, self.payload, tuple(self.points)))

    # -- the tree and its loops --------------------------------------------------------------------------------------

    @cached_property
    def carriers(self) -> dict[str, Joint]:
        """The joint that carries each body."""
        return {joint.body: joint for joint in self.joints if not joint.closes}

    @cached_property
    def loops(self) -> tuple[Joint, ...]:
        """The joints that close loops: from the second dependent body to the body that the loop ends on."""
        return tuple(joint for joint in self.joints if joint.closes)

    @cached_property
    def dependent(self) -> dict[str, Joint]:
        """The loop that each dependent body belongs to."""
        return {carrier.body: joint for joint in self.loops for carrier in self.pair(joint)}

    def pair(self, closing: Joint) -> tuple[Joint, Joint]:
        """Return the joints that carry the two dependent bodies of a loop, in their order."""
        second = self.carriers[closing.carrier]
        return self.carriers[second.carrier], second

    def path(self, body: str) -> tuple[str, ...]:
        """Return the bodies from the ground to a body, itself included."""
        return () if body == GROUND else (*self.path(self.carriers[body].carrier), body)

    def moved_by(self, cylinder: Cylinder) -> frozenset[str]:
        """Return the independent coordinates that a cylinder's length depends on."""
        return self._between(*cylinder.bodies)

    def _between(self, first: str, second: str) -> frozenset[str]:
        """Return the independent coordinates that move one body against another."""
        one, other = self.path(first), self.path(second)
        shared = sum(1 for _ in takewhile(lambda pair: pair[0] == pair[1], zip(one, other, strict=False)))
        return frozenset[str]().union(*map(self._turned_by, (*one[shared:], *other[shared:])))

    def _turned_by(self, body: str) -> frozenset[str]:
        """Return the independent coordinates that move a body against its carrier: its own, or those that move the ends
        of its loop against each other.
        """
        if body not in self.dependent:
            return frozenset({self.carriers[body].coordinate})
        loop = self.dependent[body]
        return self._between(self.pair(loop)[0].carrier, loop.body)

    # -- places ------------------------------------------------------------------------------------------------------

    @cached_property
    def layout(self) -> Layout:
        """Where everything stands in states and inputs."""
        carriers = {joint.coordinate: joint for joint in self.carriers.values()}
        joints = [carriers[name] for name in self.independent]
        return Layout(
            coordinates=self.independent,
            joints=tuple(j.name for j in joints),
            bodies=tuple(j.body for j in joints),
            parents=tuple(self._parent(j) for j in joints),
            slides=tuple(j.kind == PRISMATIC for j in joints),
            cylinders=tuple(c.name for c in self.cylinders),
            sides=tuple(c.chambers for c in self.cylinders),
            loaded=tuple(c.loaded for c in self.cylinders),
            lengths=tuple(c.length for c in self.cylinders),
            commands=tuple(c.command for c in self.cylinders),
            voltages=tuple(c.voltage for c in self.cylinders),
            driven=self.driven,
            added=("theta", "dtheta"),
            has_payload=bool(self.payload[0]),
        )

    def _parent(self, joint: Joint) -> str:
        """Return the independent coordinate that carries a joint; "" where that is the ground or a body of a loop."""
        carrier = self.carriers.get(joint.carrier)
        if carrier is None or joint.carrier in self.dependent:
            return ""
        return carrier.coordinate if carrier.kind == REVOLUTE else self._parent(carrier)

    @cached_property
    def driven(self) -> tuple[str, ...]:
        """The coordinate that each cylinder drives, one each; "" for those for which none is left."""
        owner: dict[str, Cylinder] = {}  # of each coordinate that is driven

        def give(cylinder: Cylinder, tried: set[str]) -> bool:
            """Give a cylinder a coordinate, also one whose owner can be given another."""
            own = [name for name in reversed(self.independent) if name in self.moved_by(cylinder)]
            for name in sorted(own, key=owner.__contains__):  # free ones first
                if name not in tried:
                    tried.add(name)
                    if name not in owner or give(owner[name], tried):
                        owner[name] = cylinder
                        return True
            return False

        for cylinder in sorted(self.cylinders, key=lambda c: len(self.moved_by(c))):
            give(cylinder, set())
        found = {c.name: name for name, c in owner.items()}
        return tuple(found.get(c.name, "") for c in self.cylinders)

    @cached_property
    def point_names(self) -> tuple[str, ...]:
        """Short names of the points in the order of P: E for "joints.E", lift_base for "cylinders.lift.base"."""
        return tuple(p.partition(".")[2].replace(".", "_") for p in self.points)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of all nominal parameters, in the order of the vector P."""
        return (
            *parameters.SHARED,
            *(name for c in self.cylinders for name in parameters.of_cylinder(c.name)),
            *(f"bodies.{b}.{p}" for b in self.bodies for p in parameters.OF_BODY),
            *(f"{p}.{axis}" for p in self.points for axis in "xy"),
            *(f"slides.{j.name}.direction" for j in self.joints if j.kind == PRISMATIC),
        )

    @cached_property
    def index(self) -> dict[str, int]:
        """Where each nominal parameter stands in P."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def topology(self) -> np.ndarray:
        """The table of integers (rows, N_COLUMNS) that compiled code reads; see the top of this file."""
        number = {GROUND: -1} | {name: i for i, name in enumerate(self.bodies)}
        body, point = self.payload
        rows = [[len(self.bodies), len(self.loops), len(self.cylinders), number.get(body, -1), self._point(point)]]
        rows += [self._body_row(name, number) for name in self.bodies]
        for joint in self.loops:
            first = self.carriers[joint.carrier].carrier
            rows.append(
                [number[first], number[joint.body], self._point(joint.pin), self._point(joint.own_pin), joint.side]
            )
        for c in self.cylinders:
            ends = [place for b, p in zip(c.bodies, c.points, strict=True) for place in (number[b], self._point(p))]
            rows.append([*ends, c.chambers.index(c.loaded)])
        rows += [*self._pin_rows(rows)]
        table = np.zeros((len(rows), N_COLUMNS), dtype=np.int64)
        for k, row in enumerate(rows):
            table[k, : len(row)] = row
        table.setflags(write=False)
        return table

    def _body_row(self, name: str, number: Mapping[str, int]) -> list[int]:
        joint = self.carriers[name]
        kind = SLIDES if joint.kind == PRISMATIC else TURNS
        if name in self.dependent:
            kind = SECOND_OF_LOOP if joint.carrier in self.dependent else FIRST_OF_LOOP
        coordinate = self.independent.index(joint.coordinate) if joint.coordinate in self.independent else -1
        direction = self.index.get(f"slides.{joint.name}.direction", -1)
        numbers = self.index[f"bodies.{name}.{parameters.OF_BODY[0]}"]
        return [
            number[joint.carrier],
            kind,
            self._point(joint.pin),
            self._point(joint.own_pin),
            numbers,
            coordinate,
            direction,
        ]

    def _pin_rows(self, rows: list[list[int]]) -> Iterator[list[int]]:
        """Yield a row for each pin of bodies, loops and cylinders, and for the payload's point."""
        loops, cylinders = len(self.bodies) + 1, len(self.bodies) + len(self.loops) + 1
        for k, row in enumerate(rows[1:], 1):
            if k < loops:
                pins = ((k - 1, row[OWN_PIN]), (row[CARRIER], row[PIN]))
            elif k < cylinders:
                pins = ((row[DEPENDENT] + 1, row[CUT_PIN]), (row[LAST], row[LAST_PIN]))
            else:
                pins = ((row[BASE_BODY], row[BASE]), (row[ROD_BODY], row[ROD_END]))
            yield from ([body, point, k - 1, end] for end, (body, point) in enumerate(pins))
        yield [rows[0][TIP_BODY], rows[0][TIP_POINT], len(rows) - 1, 0]

    def _point(self, name: str) -> int:
        """Return where a point begins in P, -1 for "" (the origin of a frame)."""
        return self.index[f"{name}.x"] if name else -1
