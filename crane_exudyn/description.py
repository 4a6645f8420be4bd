"""What a crane file says of a crane, as numbers by name in SI, and which numbers no crane can have."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np

from . import parameters
from .effects import registry
from .effects.base import Acting
from .errors import CraneError, nearest, refuse_unknown, shortened
from .frozen import AdvisingDict, frozen
from .layout import Layout
from .machine import Machine


@dataclass(frozen=True)
class Uncertainty:
    """How well a nominal parameter is known.

    Attributes:
        std: standard uncertainty in the parameter's SI unit; infinite where only a range is known.
        lower, upper: hard limits in SI.
    """

    std: float
    lower: float = -math.inf
    upper: float = math.inf


@dataclass(frozen=True)
class Voltage:
    """Calibration of one valve: the voltages at which its spool command is -1, 0 and +1.

    The command is linear on either side of `neutral`; voltages beyond the ends are taken as the ends.
    """

    neutral: float
    extend: float
    retract: float

    def command(self, volts: np.ndarray) -> np.ndarray:
        """Return spool commands in [-1, 1], same shape as `volts`."""
        off = np.asarray(volts, dtype=float) - self.neutral
        up, down = self.extend - self.neutral, self.retract - self.neutral
        return np.clip(np.where(off * np.sign(up) >= 0.0, off / up, -off / down), -1.0, 1.0)


@dataclass(frozen=True)
class Initial:
    """The crane file's start: at rest, valves closed, the less loaded chamber of each cylinder at a pressure.

    Attributes:
        pose: independent coordinates in the order of the state, rad or m.
        less_loaded_pressure: Pa, one a cylinder, or one for all.
    """

    pose: tuple[float, ...]
    less_loaded_pressure: tuple[float, ...] = (20e5,)


@dataclass(frozen=True)
class GaussMarkov:
    """What a model errs by, as noise that lasts (first-order Gauss-Markov): standard deviation in SI, and memory in
    s.
    """

    std: float
    memory: float = math.inf


@dataclass(frozen=True)
class Description:
    """What a crane file says: the machine, numbers by name in SI, valve calibration, start, sensors, uncertainties,
    effects, what the model is known to err by, and what was done to it.

    `text` is that of the file that it was read from; what is written keeps its comments and units. `file` is the file's
    name, "" for what comes with the package or was made in Python; changed copies keep both.
    """

    name: str
    machine: Machine
    values: Mapping[str, float]
    initial: Initial
    description: str = ""
    voltage: Mapping[str, Voltage] = field(default_factory=dict)
    sensors: Mapping[str, float] = field(default_factory=dict)
    uncertainty: Mapping[str, Uncertainty] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    effects: tuple[Acting, ...] = ()
    model_error: Mapping[str, GaussMarkov] = field(default_factory=dict)
    history: tuple[Mapping[str, Any], ...] = ()
    text: str = field(default="", repr=False, compare=False)
    file: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        said = (
            f"{self.name} has no voltage calibration of a valve {{0!r}}: add [valves.{{0}}.voltage] with neutral, "
            "extend and retract to its file."
        )
        object.__setattr__(self, "voltage", AdvisingDict(self.voltage, said))
        for name in ("values", "voltage", "sensors", "uncertainty", "sources", "model_error"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        check(self.name, self.machine, self.values, self.effects)
        object.__setattr__(self, "initial", _of_each(self.initial, self.name, self.layout))

    @property
    def layout(self) -> Layout:
        """Where its coordinates, chambers and valves stand in states and inputs."""
        return self.machine.layout

    @property
    def label(self) -> str:
        """Its name in messages about what its file says: after that of the file, where it was read from one."""
        return f"{self.file}: {self.name}" if self.file else self.name

    def __getitem__(self, name: str) -> float:
        """Return a nominal parameter in SI by its name, such as "payload.mass"."""
        try:
            return self.values[name]
        except KeyError:
            raise CraneError(
                f"{self.name}: there is no parameter {name!r}.{nearest(name, list(self.machine.names))}"
            ) from None

    def __contains__(self, name: object) -> bool:
        return name in self.values

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the nominal parameters."""
        return iter(self.machine.names)


def _of_each(initial: Initial, where: str, layout: Layout) -> Initial:
    """Return a start with one pressure a cylinder, also where one is given for all. Raises CraneError for other
    numbers of them, or of coordinates.
    """
    pose, low, n = initial.pose, initial.less_loaded_pressure, len(layout.cylinders)
    low = tuple(np.atleast_1d(low).tolist())
    low = low * n if len(low) == 1 else low
    for what, found, names in (("pose", pose, layout.coordinates), ("less_loaded_pressure", low, layout.cylinders)):
        if len(found) != len(names):
            raise CraneError(f"{where}: initial.{what} has {len(found)} numbers. Give one each for {', '.join(names)}.")
    return Initial(tuple(pose), low)


def complete(effect: type[registry.Effect], values: Mapping[str, Any]) -> dict[str, float]:
    """Return all parameters of an effect: those given, and the neutral (or shaping) value of the others. Of a curve the
    table may be given as it stands in a crane file.

    Raises:
        CraneError: a value that is no number.
    """
    if effect.curve is not None and isinstance(values.get("over"), str):
        values = effect.curve.read(values, f"effect {effect.name!r}")
    units = {p.name: p.unit for p in effect.parameters}
    given = {n: number(v, f"effect {effect.name!r}: {n}", units.get(n, "")) for n, v in values.items()}
    return {p.name: given.get(p.name, float(p.neutral)) for p in effect.parameters} | given


def number(value: Any, what: str, unit: str) -> float:
    """Return a value as a float.

    Raises:
        CraneError: it is anything but one number, such as a text with a unit; `what` names it.
    """
    if isinstance(value, float):
        return float(value)
    try:
        if np.ndim(value) == 0 and not isinstance(value, (str, bytes, bool, np.bool_)):
            return float(value)
    except (TypeError, ValueError):
        pass
    found = shortened(value)
    raise CraneError(f"{what} = {found} is not a number. Give one number in SI, {f'in {unit}' if unit else 'no unit'}.")


# -- what is possible ------------------------------------------------------------------------------------------------

#: last part of a name -> (smallest value, whether that value itself is allowed)
_LIMITS = {
    "air_pressure": (0.0, True),
    "mass": (0.0, False), "inertia": (0.0, False), "width": (0.0, True), "height": (0.0, True), "bore": (0.0, False),
    "rod": (0.0, True), "empty_length": (0.0, True), "chamber_range": (0.0, False), "hose_volume_piston": (0.0, False),
    "hose_volume_rod": (0.0, False), "coulomb_friction": (0.0, True), "static_friction": (0.0, True),
    "stribeck_speed": (0.0, False), "viscous_friction": (0.0, True), "flow_coefficient": (0.0, False),
    "time_constant": (0.0, True), "oil_bulk_modulus": (0.0, False), "cylinder_bulk_modulus": (0.0, False),
    "hose_bulk_modulus": (0.0, False), "vapour_pressure": (0.0, True), "laminar_pressure": (0.0, False),
    "pump_pressure": (0.0, False), "tank_pressure": (0.0, True), "gravity": (0.0, True),
    **dict.fromkeys(parameters.EDGES, (0.0, False)),
}  # fmt: skip
#: last part of a name -> what its limit comes from
_REASONS = dict.fromkeys(
    ("vapour_pressure", "air_pressure"),
    " It is absolute in every crane file, also where all other pressures are gauge pressures.",
)
#: last part of a name -> the only values that it may have, with what they stand for
_CHOICES = {"pressure_reference": {0.0: "absolute", 1.0: "gauge"}}


def check(where: str, machine: Machine, values: Mapping[str, float], effects: Sequence[Acting]) -> None:
    """Raise CraneError for numbers and effects that no crane can have; `where` begins the message."""
    check_values(where, machine, values)
    for acting in effects:
        check_effect(where, machine.layout, acting)
    keys = [e.key for e in effects]
    for key in keys:
        if keys.count(key) > 1:
            raise CraneError(f"{where}: effect {key!r} occurs twice. Remove one of them.")


def check_values(where: str, machine: Machine, values: Mapping[str, float]) -> None:
    """Raise CraneError for a missing, unknown or impossible number: field, value, limit and mend."""
    refuse_unknown(where, values, machine.index, "parameter")
    missing = [n for n in machine.names if n not in values]
    if missing:
        more = f" ({len(missing)} in all)" if len(missing) > 1 else ""
        raise CraneError(f"{where}: {missing[0]} is missing{more}. Give it, in {parameters.unit_of(missing[0])}.")
    for name, value in values.items():
        check_value(where, name, value)
    if not machine.payload[0]:
        for name in (n for n in values if n.startswith("payload.") and values[n] != 0.0):
            raise CraneError(
                f"{where}: {name} = {values[name]:g} {parameters.unit_of(name)}, but nothing carries a payload: give "
                "body and at in [payload], which body and which of its points do."
            )
    for c in machine.layout.cylinders:
        check_rod(where, c, values[f"cylinders.{c}.bore"], values[f"cylinders.{c}.rod"])
    if values["supply.pump_pressure"] <= values["supply.tank_pressure"]:
        raise CraneError(
            f"{where}: supply.pump_pressure = {values['supply.pump_pressure']:g} Pa is not above the tank's "
            f"{values['supply.tank_pressure']:g} Pa, so nothing could move. Correct one of them."
        )


@cache
def range_of(name: str) -> tuple[float, bool, Mapping[float, str]]:
    """Return the smallest value of a parameter, whether it may be that itself; its only values where they are few."""
    last = name.rsplit(".", 1)[-1]
    least, allowed = (0.0, True) if name == "payload.mass" else _LIMITS.get(last, (-math.inf, False))
    return least, allowed, _CHOICES.get(last, {})


def check_value(where: str, name: str, value: float) -> None:
    """Raise CraneError for a value of a parameter that no crane can have; `where` begins the message."""
    least, allowed, choices = range_of(name)
    if least < value < math.inf and not choices:
        return
    if not math.isfinite(value):
        raise CraneError(f"{where}: {name} = {value} is not finite. Give a number in {parameters.unit_of(name)}.")
    if choices and value not in choices:
        known = " or ".join(f"{number:g} ({meaning})" for number, meaning in choices.items())
        raise CraneError(f"{where}: {name} = {value:g} is impossible: it must be {known}.")
    if value < least or (value == least and not allowed):
        sign = ">=" if allowed else ">"
        raise CraneError(
            f"{where}: {name} = {value:g} {parameters.unit_of(name)} is impossible: it must be {sign} {least:g}."
            f"{_REASONS.get(name.rsplit('.', 1)[-1], '')}"
        )


def check_rod(where: str, cylinder: str, bore: float, rod: float) -> None:
    """Raise CraneError for a rod that is not thinner than its bore, both in m; `where` begins the message."""
    if not rod < bore:
        raise CraneError(
            f"{where}: cylinders.{cylinder}.rod = {rod:g} m is not thinner than the bore of {bore:g} m. Swap or "
            "correct them."
        )


def check_effect(where: str, layout: Layout, acting: Acting) -> None:
    """Raise CraneError for an unknown effect, place or parameter, or a value outside its range."""
    effect, _ = registry.split_key(acting.key, layout)
    ranges = {p.name: p for p in effect.parameters}
    for name, value in acting.parameters.items():
        if name not in ranges:
            raise CraneError(f"{where}: effect {acting.key!r} has no parameter {name!r}.{nearest(name, list(ranges))}")
        p = ranges[name]
        if not p.lower <= value <= p.upper:
            raise CraneError(
                f"{where}: effect {acting.key!r}: {name} = {value:g} {p.unit} is outside {p.lower:g} … {p.upper:g}. "
                f"The neutral value is {p.neutral:g}."
            )
    if effect.curve is not None:
        effect.curve.check(f"{where}: effect {acting.key!r}", acting.parameters)
