"""Crane files read. Only the form is known here; what the numbers mean stands in description.py, and crane_edit.py
writes.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from fnmatch import fnmatchcase
from typing import Any, TypeVar

from . import parameters
from .channels import refuse_beyond
from .description import Description, GaussMarkov, Initial, Uncertainty, Voltage, check, complete
from .effects import registry
from .effects.base import Acting
from .errors import CraneError, nearest, refuse_unknown
from .frozen import frozen
from .layout import Layout
from .machine import PRISMATIC, Machine
from .machine_toml import OF_CYLINDER, OF_PAYLOAD, machine_of
from .toml_reading import table_of
from .units import to_si

D = TypeVar("D", bound=Description)

_SECTIONS = (
    "name", "description", "gravity", "independent", "bodies", "payload", "joint", "joints", "cylinders", "valves",
    "fluid", "supply",
    "initial", "sensors", "uncertainty", "sources", "effect", "model_error", "history",
)  # fmt: skip
#: of these, what is no table: in TOML it must stand above the first one
_ABOVE_TABLES = ("name", "description", "gravity", "independent")


def from_document(kind: type[D], document: Mapping[str, Any], where: str, text: str = "") -> D:
    """Return what a parsed TOML document describes, a `Description` or a crane; `where` names the file in errors,
    `text` is the file's.
    """
    refuse_unknown(where, document, _SECTIONS, "section")
    machine = machine_of(document, where)
    values, lay = _values(document, machine, where), machine.layout
    effects = tuple(_effect(table, lay, where) for table in _tables(document, "effect", where))
    check(where, machine, values, effects)  # as every crane does, but here the message can name the file
    return kind(
        name=str(document.get("name", where)),
        machine=machine,
        description=str(document.get("description", "")),
        values=values,
        initial=_initial(table_of(document, "initial", where), lay, where),
        voltage=_voltages(table_of(document, "valves", where), lay, where),
        sensors=_sensors(table_of(document, "sensors", where), lay, where),
        uncertainty=_uncertainties(table_of(document, "uncertainty", where), values, where),
        sources={str(k): str(v) for k, v in table_of(document, "sources", where).items()},
        effects=effects,
        model_error=_model_errors(table_of(document, "model_error", where), machine, where),
        history=tuple(frozen(entry) for entry in _tables(document, "history", where)),
        text=text,
    )


#: what files of earlier versions do not say: their pressures are absolute, and no air presses on the rods
_EARLIER = {"supply.air_pressure": 0.0, "supply.pressure_reference": 0.0}
#: of a machine without payload
_NO_PAYLOAD = dict.fromkeys(("payload.mass", "payload.width", "payload.height"), 0.0)
#: what its pressures count from; the place in the list is its number
REFERENCE, REFERENCES = "supply.pressure_reference", ("absolute", "gauge")


def _tables(document: Mapping[str, Any], key: str, where: str) -> list[Mapping[str, Any]]:
    tables = document.get(key, [])
    if not isinstance(tables, list) or not all(isinstance(table, Mapping) for table in tables):
        raise CraneError(f"{where}: {key} = {str(tables)[:60]} should be tables, each headed by [[{key}]].")
    return tables


def keys_of(machine: Machine, name: str) -> tuple[str, ...]:
    """Return the keys under which a parameter stands in a file, one a table; names of things may hold dots."""
    cylinders = [c.name for c in machine.cylinders]
    kinds = {"bodies": machine.bodies, "cylinders": cylinders, "valves": cylinders}
    owners = [(kind, own) for kind, known in kinds.items() for own in known]
    owners += [("joints", p.removeprefix("joints.")) for p in machine.points if p.startswith("joints.")]
    fitting = (owner for owner in owners if name.startswith(f"{'.'.join(owner)}."))
    owner = max(fitting, key=lambda owner: len(owner[1]), default=())
    return *owner, *name.removeprefix(f"{'.'.join(owner)}.").split(".")


def _values(document: Mapping[str, Any], machine: Machine, where: str) -> dict[str, float]:
    values: dict[str, float] = dict(_EARLIER) | ({} if machine.payload[0] else _NO_PAYLOAD)
    values |= {name: 1.0 for name in machine.names if ".edges." in name}
    for section in ("gravity", "bodies", "payload", "joints", "cylinders", "valves", "fluid", "supply"):
        if section in document:
            _flatten(section, document[section], machine, where, values)
    directions = {t["name"]: t.get("direction", 0.0) for t in document.get("joint", ())}
    for joint in machine.joints:
        if joint.kind == PRISMATIC:
            name = f"slides.{joint.name}.direction"
            values[name] = to_si(directions[joint.name], parameters.unit_of(name), f"{where}: {name}")
    return values


def _describes(section: str, key: str, value: Any) -> bool:
    """Whether a key says how the machine hangs together, which is no number."""
    if section.startswith("cylinders."):
        return key in OF_CYLINDER or (key in ("base", "rod_end") and isinstance(value, str))
    return (section == "payload" and key in OF_PAYLOAD) or (section.startswith("valves.") and key == "voltage")


def _flatten(name: str, value: Any, machine: Machine, where: str, values: dict[str, float]) -> None:
    if isinstance(value, Mapping):
        for key, inner in value.items():
            if not _describes(name, key, inner):
                _flatten(f"{name}.{key}", inner, machine, where, values)
    elif isinstance(value, list) and f"{name}.x" in machine.index:
        if len(value) != 2:
            raise CraneError(f"{where}: {name} = {value!r} should be a point [x, y].")
        _flatten(f"{name}.x", value[0], machine, where, values)
        _flatten(f"{name}.y", value[1], machine, where, values)
    elif name not in machine.index:
        if (key := name.rpartition(".")[2]) in _ABOVE_TABLES and key != name:
            raise CraneError(f"{where}: {key} stands in a table, as {name}. Move it above the first table.")
        raise CraneError(f"{where}: unknown key {name!r}.{nearest(name, list(machine.names))}")
    elif name == REFERENCE:
        if value not in REFERENCES:
            raise CraneError(f'{where}: {name} = {value!r} is not known. Give "absolute" or "gauge".')
        values[name] = float(REFERENCES.index(value))
    else:
        values[name] = to_si(value, parameters.unit_of(name), f"{where}: {name}")


def _read(table: object, units: Mapping[str, str], where: str, infinite: Collection[str] = ()) -> dict[str, float]:
    """Return the numbers of a table in SI, of which those named may be infinite."""
    if not isinstance(table, Mapping):
        raise CraneError(f"{where} = {str(table)[:60]} should be a table {{ {', '.join(units)} }}.")
    refuse_unknown(where, table, units)
    return {key: to_si(v, units[key], f"{where}.{key}", infinite=key in infinite) for key, v in table.items()}


def _initial(table: Mapping[str, Any], layout: Layout, where: str) -> Initial:
    table = dict(table)
    pressure = table.pop("less_loaded_pressure", 20e5)
    each = pressure if isinstance(pressure, list) else [pressure] * len(layout.cylinders)
    if len(each) != len(layout.cylinders):
        raise CraneError(
            f"{where}: initial.less_loaded_pressure = {pressure!r} should be one pressure, or one for each of "
            f"{', '.join(layout.cylinders)}."
        )
    units = {name: layout.unit_of(name) for name in layout.coordinates}
    numbers = _read(table, units, f"{where}: initial")
    for key, unit in units.items():
        if key not in numbers:
            example = "10 deg" if unit == "rad" else "0.5 m"
            raise CraneError(f'{where}: initial.{key} is missing. Give its value at the start, such as "{example}".')
        refuse_beyond(where, f"initial.{key}", numbers[key], unit, in_file=True)
    pressures = tuple(to_si(p, "Pa", f"{where}: initial.less_loaded_pressure") for p in each)
    return Initial(tuple(numbers[key] for key in units), pressures)


def _voltages(valves: Mapping[str, Any], layout: Layout, where: str) -> dict[str, Voltage]:
    found = {}
    for valve in layout.cylinders:
        table = valves.get(valve, {}).get("voltage") if isinstance(valves.get(valve, {}), Mapping) else None
        if table is None:
            continue
        place = f"{where}: valves.{valve}.voltage"
        numbers = _read(table, dict.fromkeys(("neutral", "extend", "retract"), "V"), place)
        for key in ("neutral", "extend", "retract"):
            if key not in numbers:
                raise CraneError(f"{place}.{key} is missing: the voltage of that spool position.")
        if (numbers["extend"] - numbers["neutral"]) * (numbers["retract"] - numbers["neutral"]) >= 0:
            raise CraneError(f"{place}: neutral = {numbers['neutral']:g} V must lie between extend and retract.")
        found[valve] = Voltage(**numbers)
    return found


def _sensors(table: Mapping[str, Any], layout: Layout, where: str) -> dict[str, float]:
    numbers = _read(table, {name: s.unit for name, s in layout.sensors.items()}, f"{where}: sensors")
    for name, value in numbers.items():
        if value <= 0:
            raise CraneError(
                f"{where}: sensors.{name} = {value:g} is impossible: a noise standard deviation must be > 0."
            )
    return numbers


def _uncertainties(table: Mapping[str, Any], values: Mapping[str, float], where: str) -> dict[str, Uncertainty]:
    found: dict[str, Uncertainty] = {}
    for pattern, entry in table.items():
        names = [pattern] if pattern in values else [n for n in values if fnmatchcase(n, pattern)]  # with *
        if not names:
            raise CraneError(f"{where}: uncertainty {pattern!r} fits no parameter.{nearest(pattern, list(values))}")
        for name in names:
            found[name] = _uncertainty(name, entry, values[name], f"{where}: uncertainty {name!r}")
    return found


def _uncertainty(name: str, entry: Any, value: float, where: str) -> Uncertainty:
    entry = entry if isinstance(entry, Mapping) else {"std": entry}
    refuse_unknown(where, entry, ("std", "lower", "upper"))
    unit = parameters.unit_of(name)
    std = entry.get("std", math.inf)
    if isinstance(std, str) and std.strip().endswith("%"):
        std = float(f"{to_si(std, '', where) * abs(value):.12g}")  # 4 % of 70 kg are 2.8, not 2.8000000000000003
    std = to_si(std, unit, where, infinite=True)
    if not std > 0:
        raise CraneError(
            f"{where}: std = {std:g} is impossible: it must be > 0. Leave the line out if the value is exact."
        )
    lower, upper = (
        to_si(entry.get(k, v), unit, where, infinite=True) for k, v in (("lower", -math.inf), ("upper", math.inf))
    )
    if not lower <= value <= upper:
        raise CraneError(f"{where}: the value {value:g} {unit} itself is outside {lower:g} … {upper:g}.")
    return Uncertainty(std, lower, upper)


def _model_errors(table: Mapping[str, Any], machine: Machine, where: str) -> dict[str, GaussMarkov]:
    lay, found = machine.layout, {}
    units = {n: lay.unit_of(n) for n in lay.disturbances} | {n: parameters.unit_of(n) for n in machine.names}
    refuse_unknown(f"{where}: model_error", table, units)
    for name, entry in table.items():
        place = f"{where}: model_error {name!r}"
        numbers = _read(entry, {"std": units[name], "memory": "s"}, place, ("memory",))
        if not numbers.get("std", 0.0) > 0.0 or not numbers.get("memory", math.inf) > 0.0:
            raise CraneError(
                f"{place} needs a std > 0, and a memory > 0 s if it has one. Leave the line out if unknown."
            )
        found[name] = GaussMarkov(**numbers)
    return found


def _effect(table: Mapping[str, Any], layout: Layout, where: str) -> Acting:
    if "name" not in table:
        raise CraneError(f"{where}: an [[effect]] needs a name. `patu effects` lists them.")
    refuse_unknown(f"{where}: effect {table['name']!r}", table, ("name", "place", "parameters"))
    place = str(table.get("place", ""))
    try:
        effect, _ = registry.split_key(f"{table['name']}@{place}" if place else str(table["name"]), layout)
    except CraneError as problem:
        raise CraneError(f"{where}: {problem}") from problem
    about, given = f"{where}: effect {effect.name!r}: parameters", table.get("parameters", {})
    if effect.curve is not None:
        return Acting(effect.name, place, frozen(complete(effect, effect.curve.read(given, about))))
    units = {p.name: unit_at(p.unit, place, layout) for p in effect.parameters}
    numbers = _read(given, units, about, units)
    return Acting(effect.name, place, frozen(complete(effect, numbers)))


def as_written(acting: Acting) -> Mapping[str, Any]:
    """Return an effect's parameters as a crane file has them: numbers in SI, or the table of a curve."""
    curve = registry.find(acting.name).curve
    if curve is None:
        return acting.parameters
    t = curve.table(acting.parameters)
    against = {"against_motion": t.against_motion} if len(t.over.against) > 1 else {}
    units = {"unit_over": t.over.unit, "x": list(t.x), "unit": curve.unit, "y": list(t.y)}
    return {"over": t.over.name, **against, **units}


def unit_at(unit: str, place: str, layout: Layout) -> str:
    """Return the SI unit of an effect's parameter at a place ("channel" becomes the sensor's unit)."""
    return layout.sensors[place].unit if unit == "channel" else unit


def as_given(numbers: Uncertainty | GaussMarkov) -> dict[str, float]:
    """Return numbers as a crane file has them: without what is unlimited."""
    return {k: v for k, v in vars(numbers).items() if math.isfinite(v)}
