"""Crane: the immutable description of a hydraulic crane, read from and written to TOML."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from . import crane_toml, parameters
from .effects import registry
from .effects.base import Acting
from .effects.curve import X, Y
from .errors import CraneError, nearest
from .files import write_text
from .frozen import frozen
from .layout import Layout
from .machine import Machine

_DATA = "crane_exudyn.data"


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
class Crane:
    """A crane: its machine, numbers by name in SI, valve calibration, start, sensors, uncertainties, effects, and what
    was done to it.

    Immutable; `with_parameters`, `with_effect` and their kin return changed copies. `crane["payload.mass"]` gives a
    number.
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
    history: tuple[Mapping[str, Any], ...] = ()
    #: functions f(mbs, plant, number) that add Exudyn objects of one's own to machine `number` of a plant; see
    #: `with_objects`
    objects: tuple[Callable[..., None], ...] = field(default=(), repr=False)
    #: of the file that it was read from; what is written keeps its comments and units
    text: str = field(default="", repr=False, compare=False)

    def __post_init__(self) -> None:
        for name in ("values", "voltage", "sensors", "uncertainty", "sources"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        check(self.name, self.machine, self.values, self.effects)

    # -- reading and writing -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, name_or_path: str | Path) -> Crane:
        """Return a built-in crane ("patu655", "patu655-lab") or one from a TOML file.

        Raises:
            CraneError: no such crane, bad TOML, an unknown key, a wrong unit or an impossible value.
        """
        text, where = _read(name_or_path)
        try:
            document = tomllib.loads(text)
        except tomllib.TOMLDecodeError as problem:
            raise CraneError(f"{where}: not a whole TOML file: {problem}.") from problem
        except RecursionError:
            raise CraneError(f"{where}: not a crane file: its lists or tables are nested too deep.") from None
        return crane_toml.from_document(document, where, text)

    def save(self, path: str | Path) -> None:
        """Write the crane as TOML, whole or not at all; reading it again gives an equal crane."""
        write_text(path, self.to_toml())

    def to_toml(self) -> str:
        """Return the crane as TOML text, values in SI at full precision."""
        return crane_toml.to_text(self)

    @property
    def layout(self) -> Layout:
        """Where its coordinates, chambers and valves stand in states and inputs."""
        return self.machine.layout

    # -- numbers -------------------------------------------------------------------------------------------------

    def areas(self, cylinder: str) -> tuple[float, float]:
        """Return the areas in m² of a cylinder's piston side and rod side."""
        bore, rod = self[f"cylinders.{cylinder}.bore"], self[f"cylinders.{cylinder}.rod"]
        return 0.25 * math.pi * bore**2, 0.25 * math.pi * (bore**2 - rod**2)

    def __getitem__(self, name: str) -> float:
        """Return a nominal parameter in SI by its name, such as "payload.mass"."""
        try:
            return self.values[name]
        except KeyError:
            raise CraneError(
                f"{self.name}: there is no parameter {name!r}.{nearest(name, list(self.machine.names))}"
            ) from None

    def parameter_vector(self) -> np.ndarray:
        """Return P, shape (len(machine.names),): all nominal parameters in SI."""
        return np.array([self.values[name] for name in self.machine.names])

    def effect_vector(self) -> np.ndarray:
        """Return E: parameters of every effect at every place, neutral where the crane has no such effect."""
        vector = registry.neutral_vector()
        for acting in self.effects:
            start, effect = registry.slot(acting.name, acting.place, self.layout), registry.find(acting.name)
            for i, parameter in enumerate(effect.parameters):
                vector[start + i] = acting.parameters.get(parameter.name, parameter.neutral)
            origin = effect.curve.origin_of(acting.parameters, acting.place) if effect.curve else ""
            if origin:
                for i in range(start + X, start + Y):
                    vector[i] -= self.values[origin]
        return np.array(vector)

    def commands_from_voltages(self, volts: np.ndarray) -> np.ndarray:
        """Return spool commands of valve voltages, both (n, cylinders), through the calibration of the crane file."""
        missing = [c for c in self.layout.cylinders if c not in self.voltage]
        if missing:
            raise CraneError(
                f"{self.name}: the recording holds valve voltages, but the crane has no calibration for the "
                f"{missing[0]} valve. Add [valves.{missing[0]}.voltage] with neutral, extend and retract, or "
                f"record {' and '.join(self.layout.commands)}."
            )
        volts = np.asarray(volts, dtype=float)
        return np.column_stack([self.voltage[c].command(volts[:, i]) for i, c in enumerate(self.layout.cylinders)])

    # -- changed copies ------------------------------------------------------------------------------------------

    def with_parameters(self, changes: Mapping[str, float]) -> Crane:
        """Return a copy with other nominal parameters (SI)."""
        for name in changes:
            _ = self[name]
        return replace(self, values={**self.values, **{n: float(v) for n, v in changes.items()}})

    def with_effect(self, key: str, values: Mapping[str, float]) -> Crane:
        """Return a copy with the effect "name@place" added, or given other parameters where it is there already."""
        effect, place = registry.split_key(key, self.layout)
        acting = Acting(effect.name, place, frozen(complete(effect, values)))
        kept = [e for e in self.effects if e.key != key]
        at = next((i for i, e in enumerate(self.effects) if e.key == key), len(kept))
        return replace(self, effects=(*kept[:at], acting, *kept[at:]))

    def without_effect(self, key: str) -> Crane:
        """Return a copy without the effect "name@place"."""
        if key not in [e.key for e in self.effects]:
            raise CraneError(f"{self.name} has no effect {key!r}.{nearest(key, [e.key for e in self.effects])}")
        return replace(self, effects=tuple(e for e in self.effects if e.key != key))

    def nominal(self) -> Crane:
        """Return a copy without any effect."""
        return replace(self, effects=())

    def effect(self, key: str) -> Acting | None:
        """Return the effect "name@place" of this crane, or None."""
        return next((e for e in self.effects if e.key == key), None)

    def with_objects(self, *functions: Callable[..., None]) -> Crane:
        """Return a copy to which functions f(mbs, plant, number) add objects of one's own, such as a spring to ground
        or a contact.

        They are part of every Exudyn system of the crane, also of a batch; `plant.marker("E", number)` gives a marker
        at a named point.
        """
        return replace(self, objects=(*self.objects, *functions))

    def with_history(self, entry: Mapping[str, Any]) -> Crane:
        """Return a copy whose history has one entry more."""
        return replace(self, history=(*self.history, frozen(entry)))

    def __repr__(self) -> str:
        effects = ", ".join(e.key for e in self.effects) or "no effects"
        return (
            f"<Crane {self.name}: {effects}; payload {self['payload.mass']:g} kg, pump "
            f"{self['supply.pump_pressure'] / 1e5:g} bar>"
        )


def built_in() -> list[str]:
    """Return the names of the cranes that come with the package."""
    return sorted(f.name.removesuffix(".toml") for f in resources.files(_DATA).iterdir() if f.name.endswith(".toml"))


def _read(name_or_path: str | Path) -> tuple[str, str]:
    name = str(name_or_path)
    if name in built_in():
        return resources.files(_DATA).joinpath(f"{name}.toml").read_text(encoding="utf-8"), name
    path = Path(name_or_path)
    if not path.is_file():
        raise CraneError(f"There is no crane {name!r}: neither a file nor built in.{nearest(name, built_in())}")
    data = path.read_bytes()
    marked = "utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"  # as editors on Windows write
    try:
        return data.decode(marked), str(path)
    except UnicodeDecodeError as problem:
        raise CraneError(f"{path}: not a text file in UTF-8 ({problem.reason}). A crane file is TOML.") from problem


def complete(effect: type[registry.Effect], values: Mapping[str, float]) -> dict[str, float]:
    """Return all parameters of an effect: those given, and the neutral (or shaping) value of the others."""
    return {p.name: float(values.get(p.name, p.neutral)) for p in effect.parameters} | {
        n: float(v) for n, v in values.items() if n not in {p.name for p in effect.parameters}
    }


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
            raise CraneError(f"{where}: effect {key!r} stands twice. Remove one of them.")


def check_values(where: str, machine: Machine, values: Mapping[str, float]) -> None:
    """Raise CraneError for a missing, unknown or impossible number: field, value, limit and mend."""
    for name in values:
        if name not in machine.index:
            raise CraneError(f"{where}: unknown parameter {name!r}.{nearest(name, list(machine.names))}")
    missing = [n for n in machine.names if n not in values]
    if missing:
        raise CraneError(
            f"{where}: {missing[0]} is missing ({len(missing)} in all). Give it, in {parameters.unit_of(missing[0])}."
        )
    for name, value in values.items():
        _check_one(where, name, value)
    for c in machine.layout.cylinders:
        bore, rod = values[f"cylinders.{c}.bore"], values[f"cylinders.{c}.rod"]
        if rod >= bore:
            raise CraneError(
                f"{where}: cylinders.{c}.rod = {rod:g} m is not thinner than the bore of {bore:g} m. Swap or mend them."
            )
    if values["supply.pump_pressure"] <= values["supply.tank_pressure"]:
        raise CraneError(
            f"{where}: supply.pump_pressure = {values['supply.pump_pressure']:g} Pa is not above the tank's "
            f"{values['supply.tank_pressure']:g} Pa. Nothing could move; mend one of them."
        )


def _check_one(where: str, name: str, value: float) -> None:
    if not math.isfinite(value):
        raise CraneError(f"{where}: {name} = {value} is not finite. Give a number in {parameters.unit_of(name)}.")
    last = name.rsplit(".", 1)[-1]
    if value not in _CHOICES.get(last, (value,)):
        known = " or ".join(f"{number:g} ({meaning})" for number, meaning in _CHOICES[last].items())
        raise CraneError(f"{where}: {name} = {value:g} is impossible: it must be {known}.")
    limit = _LIMITS.get(last)
    if limit is None:
        return
    least, allowed = limit if name != "payload.mass" else (0.0, True)
    if value < least or (value == least and not allowed):
        sign = ">=" if allowed else ">"
        raise CraneError(
            f"{where}: {name} = {value:g} {parameters.unit_of(name)} is impossible: it must be {sign} {least:g}."
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


def names_matching(pattern: str, names: Iterable[str]) -> list[str]:
    """Return the parameters among `names` that a name or a pattern with * stands for."""
    from fnmatch import fnmatchcase

    return [n for n in names if fnmatchcase(n, pattern)]
