"""Crane: the immutable description of a hydraulic crane, read from and written to TOML."""

from __future__ import annotations

import logging
import math
import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np

from . import crane_toml
from .description import Description, complete, number
from .effects import registry
from .effects.base import Acting, Effect
from .effects.curve import X, Y
from .errors import CraneError, by_name, named_file, nearest, shortened
from .files import write_text
from .frozen import frozen
from .parameters import unit_of
from .plausible import implausible
from .toml_reading import why_no_toml

_DATA = "crane_exudyn.data"
#: how people come to a crane file
_BEGIN = 'begin with one that is there, Crane.load("patu655").save("my-crane.toml").'


@dataclass(frozen=True)
class _Adding:
    """A function that adds objects of one's own; what goes wrong in it is told as its, not the program's."""

    function: Callable[..., None]

    def __call__(self, mbs: Any, plant: Any, number: int) -> None:
        try:
            self.function(mbs, plant, number)
        except CraneError:
            raise
        except Exception as problem:
            name = getattr(self.function, "__name__", repr(self.function))
            raise CraneError(
                f"{plant.crane.name}: the function {name} of with_objects, which adds user-defined objects, fails for "
                f"machine {number}: {type(problem).__name__}: {problem}"
            ) from problem


@dataclass(frozen=True)
class Crane(Description):
    """A crane: what its file says (`Description`), read and written, as vectors for compiled code, and with changes.

    Immutable; `with_parameters`, `with_effect` and their kin return changed copies. `crane["payload.mass"]` gives a
    number.
    """

    #: functions f(mbs, plant, number) that add Exudyn objects of one's own to machine `number` of a plant; see
    #: `with_objects`
    objects: tuple[Callable[..., None], ...] = field(default=(), repr=False)

    # -- reading and writing -------------------------------------------------------------------------------------

    @classmethod
    def load(cls, name_or_path: str | Path) -> Crane:
        """Return a built-in crane ("patu655", "patu655-lab") or one from a TOML file.

        Numbers that no machine is likely to have, as where a unit was left out, are told by the logger "crane_exudyn".

        Raises:
            CraneError: no such crane, bad TOML, an unknown key, a wrong unit or an impossible value.
        """
        text, where = _read(name_or_path)
        try:
            document = tomllib.loads(text)
        except tomllib.TOMLDecodeError as problem:
            raise CraneError(f"{where}: not a whole TOML file: {why_no_toml(problem, text)}") from problem
        except RecursionError:
            raise CraneError(f"{where}: not a crane file: its lists or tables are nested too deep.") from None
        if not document:
            raise CraneError(f"{where}: there is nothing in this file. A machine is one TOML file; {_BEGIN}")
        file = "" if where in built_in() else where
        crane = replace(cls.from_document(document, where, text), file=file)
        for remark in implausible(crane):
            logging.getLogger(__package__).warning("%s: %s", where, remark)
        return crane

    @classmethod
    def from_document(cls, document: Mapping[str, Any], where: str, text: str = "") -> Crane:
        """Return the crane that a parsed TOML document describes; `where` names the file in errors, `text` is the
        file's.
        """
        return crane_toml.from_document(cls, document, where, text)

    def save(self, path: str | Path) -> None:
        """Write the crane as TOML, whole or not at all; reading it again gives an equal crane.

        Raises:
            CraneError: it has objects of one's own, which no file holds.
        """
        write_text(named_file(path, "Crane.save"), self.to_toml())

    def to_toml(self) -> str:
        """Return the crane as TOML text, values in SI at full precision. Raises CraneError as `save` does."""
        from .crane_edit import to_text

        if self.objects:
            raise CraneError(
                f"{self.name} has {self._own}, and a crane file cannot contain functions. Save "
                "crane.without_objects(), and add them again with with_objects after loading."
            )
        return to_text(self)

    # -- numbers -------------------------------------------------------------------------------------------------

    def areas(self, cylinder: str) -> tuple[float, float]:
        """Return the areas in m² of a cylinder's piston side and rod side."""
        bore, rod = self[f"cylinders.{cylinder}.bore"], self[f"cylinders.{cylinder}.rod"]
        return 0.25 * math.pi * bore**2, 0.25 * math.pi * (bore**2 - rod**2)

    def stroke(self, cylinder: str) -> tuple[float, float]:
        """Return the shortest and the longest pin-to-pin length of a cylinder in m."""
        empty = self[f"cylinders.{cylinder}.empty_length"]
        return empty, empty + self[f"cylinders.{cylinder}.chamber_range"]

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
                f"{self.name}: the recording contains valve voltages, but the crane has no calibration for the "
                f"{missing[0]} valve. Add [valves.{missing[0]}.voltage] with neutral, extend and retract, or "
                f"record {' and '.join(self.layout.commands)}."
            )
        volts = np.asarray(volts, dtype=float)
        return np.column_stack([self.voltage[c].command(volts[:, i]) for i, c in enumerate(self.layout.cylinders)])

    # -- changed copies ------------------------------------------------------------------------------------------

    def with_parameters(self, changes: Mapping[str, float] | None = None) -> Crane:
        """Return a copy with other nominal parameters, numbers in SI such as {"payload.mass": 150.0} in kg."""
        return self.changed(changes, {})

    def with_effect(self, key: str, values: Mapping[str, Any] | None = None) -> Crane:
        """Return a copy with the effect "name@place" added, or given other parameters where it is there already:
        numbers in SI by name, or the table of a curve as it stands in a crane file.
        """
        return self.changed({}, {str(key): values})

    def changed(self, parameters: Mapping[str, float] | None, effects: Mapping[str, Mapping[str, Any] | None]) -> Crane:
        """Return a copy with other nominal parameters (SI), and with effects as `with_effect` sets them.

        Raises:
            CraneError: None or anything else that is no dict; an unknown name, or an impossible value.
        """
        given = by_name(parameters, f"{self.name}: parameters", "{'payload.mass': 150.0}")
        for name in given:
            _ = self[name]
        acting = {e.key: e for e in self.effects}
        for key, values in effects.items():
            effect, place = registry.split_key(key, self.layout)
            own = by_name(values, f"{self.name}: effect {key!r}", f"{_example(effect)}, in SI")
            acting[key] = Acting(effect.name, place, frozen(complete(effect, own)))
        numbers = {n: number(v, f"{self.name}: {n}", unit_of(n)) for n, v in given.items()}
        return replace(self, values={**self.values, **numbers}, effects=tuple(acting.values()))

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
        at a named point. No crane file holds them: `save` refuses such a crane.
        """
        return replace(self, objects=(*self.objects, *map(_Adding, functions)))

    def without_objects(self) -> Crane:
        """Return a copy without objects of one's own."""
        return replace(self, objects=())

    def with_history(self, entry: Mapping[str, Any]) -> Crane:
        """Return a copy whose history has one entry more."""
        return replace(self, history=(*self.history, frozen(entry)))

    @property
    def _own(self) -> str:
        return f"{len(self.objects)} user-defined object{'s' * (len(self.objects) > 1)}"

    def __repr__(self) -> str:
        effects = ", ".join(e.key for e in self.effects) or "no effects"
        return (
            f"<Crane {self.name}: {effects}{f', {self._own}' if self.objects else ''}; payload "
            f"{self['payload.mass']:g} kg, pump {self['supply.pump_pressure'] / 1e5:g} bar>"
        )


def _example(effect: type[Effect]) -> str:
    """Return values of an effect as Python writes them, of a usual size."""
    if effect.curve is not None:
        return f"{{'over': {effect.curve.over[0].name!r}, 'x': […], 'y': […]}}"
    return str({p.name: p.typical for p in effect.parameters if not p.shape})


def checked_crane(given: Any, whom: str) -> Crane:
    """Return `given`, which must be a crane. Raises CraneError, which says what to write, where it is none; `whom` it
    was given to.
    """
    if isinstance(given, Crane):
        return given
    name = str(given) if isinstance(given, str | Path) else "patu655"
    raise CraneError(f"{whom}: found {shortened(given)} instead of a crane. Crane.load({name!r}) gives one.")


def given_crane(given: Any, whom: str) -> Crane:
    """Return a crane that was given as such, or by its name or file, to `whom`. Raises CraneError for anything else."""
    return checked_crane(Crane.load(given) if isinstance(given, str | Path) else given, whom)


def built_in() -> list[str]:
    """Return the names of the cranes that come with the package."""
    return sorted(f.name.removesuffix(".toml") for f in resources.files(_DATA).iterdir() if f.name.endswith(".toml"))


def _read(name_or_path: str | Path) -> tuple[str, str]:
    name = str(name_or_path)
    if name in built_in():
        return resources.files(_DATA).joinpath(f"{name}.toml").read_text(encoding="utf-8"), name
    path = named_file(name_or_path, "Crane.load")
    if not path.is_file():
        raise CraneError(f"There is no crane {name!r}: neither a file nor built in.{nearest(name, built_in())}")
    data = path.read_bytes()
    marked = "utf-16" if data.startswith((b"\xff\xfe", b"\xfe\xff")) else "utf-8-sig"  # as editors on Windows write
    try:
        return data.decode(marked), str(path)
    except UnicodeDecodeError as problem:
        raise CraneError(f"{path}: not a text file in UTF-8 ({problem.reason}). A crane file is TOML.") from problem
