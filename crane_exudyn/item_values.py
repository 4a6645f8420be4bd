"""The numbers that Exudyn's items hold, where parameters differ from machine to machine and change from step to step.

A call that sets one costs as much as a tenth of a machine's residual, so only what differs is set. What each column of
a machine's row of numbers means to which item is settled once.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from . import hydraulics as hyd
from . import reduction as red
from .compiled import njit
from .effects import hooks
from .mechanism import PENDULUM, SWINGING, Plant, axes_of
from .parameters import GRAVITY, PAYLOAD

#: parameters are rounded to this share of their standard deviation, at most; a filter's estimates then move by less
#: than a hundredth of theirs
_ROUNDING = 1 / 64
#: sets what a machine's row of numbers says on one item
Setter = Callable[[list[float]], Any]


class ItemValues:
    """What the items of a plant hold, as it stands when this is made, and what sets them.

    Args:
        mbs: exudyn.MainSystem, assembled or not;  plant: the machines in it.
    """

    def __init__(self, mbs: Any, plant: Plant) -> None:
        machine = plant.crane.machine
        self.plant = plant
        self._slides = [name.split(".")[1] for name in machine.names if name.endswith(".direction")]
        self._directions = np.array([machine.index[f"slides.{n}.direction"] for n in self._slides], dtype=np.int64)
        self._places = np.array([(body, point) for _, body, point in plant.markers[0]])
        slots = [self._slots(mbs, plant, k) for k in range(plant.size)]
        self._setters = [[setter for _, setter in own] for own in slots]
        widths = [width for width, _ in slots[0]]
        self._begin = np.cumsum([0, *widths[:-1]])
        self._masses = 2 * len(machine.bodies) + 1
        self._now, self._before = np.empty((plant.size, sum(widths))), np.empty((plant.size, sum(widths)))
        self._fill()

    def set(self, P: np.ndarray, E: np.ndarray, time: float) -> bool:
        """Give every machine parameters of its own, P (size, .) and E (size, .), and the payload that it has at a time
        (s); return whether a mass or an inertia is another one, so that a kept mass matrix is to be computed anew.
        """
        plant = self.plant
        plant.P[...], plant.E[...] = P, E
        red.all_inertias(plant.topology, plant.P, plant.E, time, plant.inertia)
        _payload_masses(plant.P, plant.E, time, plant.payload_mass)
        self._now, self._before = self._before, self._now
        self._fill()
        changed = np.logical_or.reduceat(self._now != self._before, self._begin, axis=1)
        rows = self._now.tolist()
        for k, i in zip(*(found.tolist() for found in changed.nonzero()), strict=True):
            self._setters[k][i](rows[k])
        return bool(changed[:, : self._masses].any())

    def _fill(self) -> None:
        plant = self.plant
        n_cylinders = len(plant.crane.machine.cylinders)
        _fill_values(plant.P, plant.E, plant.inertia, n_cylinders, self._directions, self._places, self._now)

    def _slots(self, mbs: Any, plant: Plant, k: int) -> list[tuple[int, Setter]]:
        """Return how many numbers each slot of machine k's row has, and what sets them, in the order of
        `_fill_values`.
        """
        numbers, slots = plant.bodies[k], list[tuple[int, Setter]]()

        def begin() -> int:
            return sum(width for width, _ in slots)

        for name in plant.crane.machine.bodies:
            slots.append((1, _number(mbs, numbers[name], "mass", begin())))
            slots.append((1, _number(mbs, numbers[name], "inertia", begin())))
        first, loads = begin(), plant.loads[k]
        hanging = {name: load for name, load in loads.items() if name == SWINGING}
        masses = [_number(mbs, numbers[name], "mass", first) for name in hanging]
        slots.append((1, _all_of(*masses, *(_weight(mbs, load, first + 1, first) for load in hanging.values()))))
        heavy = [_weight(mbs, load, first + 1, first if name in hanging else None) for name, load in loads.items()]
        slots.append((2, _all_of(*heavy)))
        rods = [plant.joints[k][name] for name in plant.joints[k] if name == PENDULUM]
        slots.append((1, _all_of(*(_number(mbs, rod, "distance", begin()) for rod in rods))))
        for actuator in plant.actuators[k]:
            slots.append((1, _number(mbs, actuator, "chamberCrossSection0", begin())))
            slots.append((1, _number(mbs, actuator, "chamberCrossSection1", begin())))
        slots += [(1, _direction(mbs, plant.joints[k][name], begin() + i)) for i, name in enumerate(self._slides)]
        first = begin()
        return slots + [(2, _place(mbs, m, first + 2 * i)) for i, (m, _, _) in enumerate(plant.markers[k])]


def _all_of(*setters: Setter) -> Setter:
    return lambda row: [setter(row) for setter in setters]


def _number(mbs: Any, item: int, name: str, column: int) -> Setter:
    return lambda row: mbs.SetObjectParameter(item, name, row[column])


def _place(mbs: Any, marker: int, column: int) -> Setter:
    return lambda row: mbs.SetMarkerParameter(marker, "localPosition", [row[column], row[column + 1], 0.0])


def _weight(mbs: Any, load: int, gravity: int, mass: int | None) -> Setter:
    """Return what sets a body's load: the weight of the mass in a column, or gravity itself for a load that is
    proportional to mass.
    """

    def set_load(row: list[float]) -> None:
        factor = 1.0 if mass is None else row[mass]
        mbs.SetLoadParameter(load, "loadVector", [factor * row[gravity], factor * row[gravity + 1], 0.0])

    return set_load


def _direction(mbs: Any, joint: int, column: int) -> Setter:
    def set_axes(row: list[float]) -> None:
        axis, normal = axes_of(row[column])
        mbs.SetObjectParameter(joint, "axisMarker0", axis)
        mbs.SetObjectParameter(joint, "normalMarker1", normal)

    return set_axes


@njit
def round_to_spread(P):
    """Round the parameters P (n, .) of n machines to a small part of how far each differs from machine to machine.

    From step to step a filter's sigma points move by less. What stays the same need not be set again, which otherwise
    takes more time than the step itself.
    """
    for j in range(P.shape[1]):
        spread = np.std(P[:, j])
        if spread > 0.0:
            unit = np.exp2(np.floor(np.log2(_ROUNDING * spread)))  # the same while the spread hardly changes
            for k in range(P.shape[0]):
                P[k, j] = unit * np.rint(P[k, j] / unit)


@njit
def _payload_masses(P, E, time, out):
    for k in range(out.size):
        out[k] = hooks.payload_mass(E[k], time, P[k, PAYLOAD])


@njit
def _fill_values(P, E, inertia, n_cylinders, directions, places, out):
    """Fill out (n, .): mass and inertia of the bodies, mass, gravity, length of the pendulum, areas, directions,
    markers' places.

    places (m, 2): body (-1: ground) and point in P (-1: origin) of every marker.
    """
    bodies = inertia.shape[1] - 1
    for k in range(out.shape[0]):
        for b in range(bodies):
            out[k, 2 * b], out[k, 2 * b + 1] = inertia[k, b, red.MASS], inertia[k, b, red.INERTIA]
        j = 2 * bodies
        out[k, j] = inertia[k, bodies, red.MASS]
        out[k, j + 1], out[k, j + 2] = hooks.gravity(E[k], 0.0, -P[k, GRAVITY])
        out[k, j + 3], _ = hooks.pendulum(E[k])
        j += 4
        for c in range(n_cylinders):
            out[k, j], out[k, j + 1] = hyd.areas(P[k], c)
            j += 2
        for place in directions:
            out[k, j] = P[k, place]
            j += 1
        for m in range(places.shape[0]):
            body, point = places[m]
            for axis in (0, 1):
                local = 0.0 if point < 0 else P[k, point + axis]
                out[k, j] = local if body < 0 else local - inertia[k, body, red.COM_X + axis]
                j += 1
