"""Every intermediate quantity of the two engines at the same states, term by term, with how much may differ and why."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import pose_text
from crane_exudyn.layout import Layout

from .crosscheck_cases import States


class Engine(Protocol):
    """What a cross-check needs of an engine."""

    crane: Crane
    accuracy: float

    @property
    def state_names(self) -> tuple[str, ...]: ...

    def static_start(self, *pose: Any, less_loaded: Any = 20e5) -> np.ndarray: ...

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, *, step: float = 1e-3) -> np.ndarray: ...

    def terms(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]: ...


@dataclass(frozen=True)
class Group:
    """Quantities that are judged alike.

    Attributes:
        text, unit: what they are.
        names: of the terms.
        tolerance: largest accepted difference relative to the quantity's largest value over the states.
        reason: why that much.
        floor: smallest value that the difference is taken relative to, in SI: rounding of what the quantity is a sum
            of.
        angle: whether values that differ by full turns are equal.
    """

    text: str
    unit: str
    names: tuple[str, ...]
    tolerance: float
    reason: str
    floor: float = 0.0
    angle: bool = False


ROUNDING = "rounding of closed forms"


def groups_of(crane: Crane) -> tuple[Group, ...]:
    """Return what is compared of a machine, in the order in which one quantity follows from another."""
    lay, machine = crane.layout, crane.machine
    z, dependent = lay.coordinates, [machine.carriers[body].coordinate for body in machine.dependent]

    def chamber(prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}{i + 1}" for i in range(len(lay.chambers)))

    def cylinder(prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}{i + 1}" for i in range(len(lay.cylinders)))

    def each(prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}_{name}" for name in z)

    mass = tuple(f"M_{z[i]}_{z[j]}" for i in range(len(z)) for j in range(i, len(z)))
    angles = (*(f"phi_{body}" for body in machine.bodies), *dependent)
    loop = tuple(f"d{a}_d{b}" for a in dependent for b in z)
    return (
        Group("joints", "m", tuple(f"{a}_{p}" for p in machine.point_names for a in "xy"), 1e-9, ROUNDING, 1.0),
        Group("angles of bodies", "rad", angles, 1e-9, ROUNDING, 1.0, angle=True),
        Group("loop Jacobian", "-", loop, 1e-9, ROUNDING, 1.0),
        Group("cylinder lengths", "m", lay.lengths, 1e-9, ROUNDING),
        Group("cylinder rates", "m/s", tuple(f"d{s}" for s in lay.lengths), 1e-9, ROUNDING, 1e-2),
        Group("chamber volumes", "m^3", chamber("V"), 1e-9, ROUNDING),
        Group("amounts of oil", "m^3", chamber("N"), 1e-9, ROUNDING),
        Group("bulk moduli", "Pa", chamber("Be"), 1e-9, ROUNDING),
        Group("supply pressures", "Pa", lay.supply, 1e-9, "iterated to rounding", 1e5),
        Group("port flows", "m^3/s", chamber("Q"), 1e-9, "root of an iterated drop", 1e-5),
        Group("leakages", "m^3/s", chamber("leak"), 1e-9, ROUNDING, 1e-7),
        Group("friction forces", "N", cylinder("Fmu"), 1e-9, ROUNDING, 10.0),
        Group("cylinder forces", "N", cylinder("F"), 1e-9, ROUNDING, 1e3),
        Group("pressure rates", "Pa/s", tuple(f"d{p}" for p in lay.chambers), 1e-9, ROUNDING, 1e6),
        Group("mass matrix", "kg m^2", mass, 1e-9, ROUNDING, 1.0),
        Group("gravity forces", "N m", each("Qg"), 1e-9, ROUNDING, 10.0),
        Group("velocity forces", "N m", each("Qv"), 1e-9, ROUNDING, 10.0),
        Group("hydraulic forces", "N m", each("Qh"), 1e-9, ROUNDING, 100.0),
        Group("joint and tip forces", "N m", each("Qj"), 1e-9, ROUNDING, 10.0),
        Group("accelerations", "rad/s^2", tuple(f"dd{n}" for n in z), 1e-8, "rounding times a condition", 0.1),
    )


def split_by_pendulum(crane: Crane) -> tuple[str, ...]:
    """Return terms of a payload on a pendulum that each engine may split differently between M and Q; their sum, ddz,
    is compared.
    """
    names = ("mass matrix", "gravity forces", "velocity forces", "joint and tip forces")
    return tuple(n for group in groups_of(crane) if group.text in names for n in group.names)


@dataclass(frozen=True)
class Quantity:
    """One line of the result.

    Attributes:
        name: of the quantity; of another crane or an effect with that name before a colon.
        max_abs: largest difference, SI.
        relative: the same, relative to the quantity's size; this is what the tolerance is for unless `absolute`.
        tolerance, reason: how much is accepted, and why.
        place: where the difference is largest, in words.
        absolute: whether the tolerance is for max_abs.
        refused: why it could not be run, so that nothing was compared; "" where it was.
    """

    name: str
    unit: str
    max_abs: float
    relative: float
    tolerance: float
    reason: str
    place: str = ""
    absolute: bool = False
    refused: str = ""

    @classmethod
    def not_run(cls, name: str, problem: CraneError) -> Quantity:
        """Return the line of what could not be run."""
        return cls(name, "-", math.nan, math.nan, math.nan, f"could not be run: {problem}", refused=str(problem))

    @property
    def ok(self) -> bool:
        """Whether the difference is within tolerance; what is not a number never is."""
        return bool((self.max_abs if self.absolute else self.relative) <= self.tolerance)


def compare_terms(first: Engine, second: Engine, states: States, *, skip: Sequence[str] = ()) -> list[Quantity]:
    """Return one Quantity a term, over all states, in the order of `groups_of`."""
    rows = [
        (first.terms(x, w, t), second.terms(x, w, t)) for x, w, t in zip(states.x, states.w, states.time, strict=True)
    ]
    out = []
    for group in groups_of(first.crane):
        for name in group.names:
            if name not in skip:
                values = np.array([(a.get(name, math.nan), b.get(name, math.nan)) for a, b in rows])
                out.append(_judge(first.crane.layout, group, name, values, states))
    return out


def _judge(layout: Layout, group: Group, name: str, values: np.ndarray, states: States) -> Quantity:
    difference = values[:, 0] - values[:, 1]
    if group.angle:
        difference = np.remainder(difference + math.pi, math.tau) - math.pi
    size = np.abs(difference)
    worst = int(np.argmax(np.where(np.isnan(size), np.inf, size)))
    scale = max(float(np.nanmax(np.abs(values), initial=0.0)), group.floor, 1e-300)
    place = pose_text(layout, states.x[worst])
    worst_size = float(size[worst])
    return Quantity(name, group.unit, worst_size, worst_size / scale, group.tolerance, group.reason, place)


def worst_of(name: str, quantities: Sequence[Quantity]) -> Quantity:
    """Return one line for many: the first that is out of tolerance, or else the one that uses most of its own."""
    failing = [q for q in quantities if not q.ok]
    worst = failing[0] if failing else max(quantities, key=lambda q: q.relative / q.tolerance)
    return replace(worst, name=name, place=f"{worst.name}, {worst.place}")


def compare_static_starts(first: Engine, second: Engine, states: States) -> list[Quantity]:
    """Return the pressures of the static start, compared over the poses of the states."""
    lay, pressures = first.crane.layout, []
    for x in states.x:
        pose = x[lay.positions].tolist()
        pressures.append([e.static_start(*pose)[lay.pressures] for e in (first, second)])
    values = np.array(pressures)
    reason = ROUNDING
    group = Group("static start", "Pa", (), 1e-9, reason, 1e5)
    out = []
    for i, name in enumerate(lay.chambers):
        q = _judge(lay, group, f"static start: {name}", values[:, :, i], states)
        out.append(q)
    return out


def acts(engine: Engine, states: States) -> bool:
    """Whether the effects of an engine's crane change any term at any of the states."""
    from .semi_recursive import SemiRecursiveEngine

    neutral = SemiRecursiveEngine(engine.crane.nominal())
    for x, w, t in zip(states.x, states.w, states.time, strict=True):
        with_it, without = engine.terms(x, w, t), neutral.terms(x[engine.crane.layout.basic], w, t)
        if any(with_it[n] != without[n] for n in with_it.keys() & without.keys()):
            return True
    return False
