"""A crane written as text: into that of the file that it was read from, where comments, units and order stay and only
what differs is changed; or anew.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT, Table

from . import parameters
from .crane_toml import REFERENCE, REFERENCES, as_given, as_written, from_document, keys_of
from .description import Description, Uncertainty
from .effects.base import Acting
from .machine import PRISMATIC, Machine
from .machine_toml import OF_CYLINDER
from .units import factor_to_si, to_si

#: a plain number with its unit; anything else is an expression
_PLAIN = re.compile(r"\s*[-+]?[\d.]+(?:[eE][-+]?\d+)?\s*(.*)", re.DOTALL)


def to_text(crane: Description) -> str:
    """Return a crane as TOML text: the text that it was read from with what differs, or one section after the other, in
    SI.
    """
    if crane.text:
        before = from_document(Description, tomllib.loads(crane.text), crane.name)
        if before.machine == crane.machine and before.voltage == crane.voltage and before.sources == crane.sources:
            text = edited(crane.text, before, crane)
            # an uncertainty that a pattern gives cannot be taken out by itself
            if from_document(Description, tomllib.loads(text), crane.name).uncertainty == crane.uncertainty:
                return text
    return whole_text(crane)


def edited(text: str, before: Description, crane: Description) -> str:
    """Return the text of a crane file that was read as `before`, changed so that it reads as `crane`, whose machine is
    the same.
    """
    document = tomlkit.parse(text)
    for key in ("name", "description"):
        if getattr(crane, key) != getattr(before, key):
            document[key] = getattr(crane, key)
    for name, value in crane.values.items():
        if value != before.values[name]:
            _set_value(document, crane.machine, name, value)
    _set_all(document, "sensors", before.sensors, crane.sensors)
    # shares of values that have changed are others now
    now = from_document(Description, document.unwrap(), crane.name)
    _set_uncertainties(document, now.uncertainty, crane.uncertainty)
    if crane.initial != before.initial:
        pose = dict(zip(crane.layout.coordinates, crane.initial.pose, strict=True))
        _set_all(document, "initial", {}, pose | {"less_loaded_pressure": list(crane.initial.less_loaded_pressure)})
    if crane.effects != before.effects:
        _set_effects(document, before.effects, crane.effects)
    if crane.model_error != before.model_error:
        given = [{n: _inline(as_given(e)) for n, e in c.model_error.items()} for c in (before, crane)]
        _set_all(document, "model_error", *given)
    if crane.history != before.history:
        pairs = zip(before.history, crane.history, strict=False)
        kept = next((k for k, (a, b) in enumerate(pairs) if a != b), min(len(before.history), len(crane.history)))
        if kept < len(before.history):
            del document["history"][kept:]
            if not kept:
                document.pop("history")
        _append(document, "history", crane.history[kept:])
    return tomlkit.dumps(document)


def _set_all(document: Any, section: str, before: Mapping[str, Any], now: Mapping[str, Any]) -> None:
    changed = {key: value for key, value in now.items() if before.get(key) != value}
    gone = [key for key in before if key not in now]
    if changed or gone:
        table = document.setdefault(section, tomlkit.table())
        for key in gone:
            table.remove(key)
        table.update(changed)


def _set_uncertainties(document: Any, before: Mapping[str, Uncertainty], now: Mapping[str, Uncertainty]) -> None:
    """Give each parameter whose uncertainty differs a line of its own, behind the patterns; take out those that are
    gone.
    """
    for name in (n for n in before if n not in now):
        document["uncertainty"].pop(name, None)
    for name, given in now.items():
        if before.get(name) != given:
            table = document.setdefault("uncertainty", tomlkit.table())
            table.pop(name, None)
            table[name] = _inline(as_given(given))


def _set_value(document: Any, machine: Machine, name: str, value: float) -> None:
    """Put a parameter's value in the place of the one that the text has, in its unit."""
    if name == REFERENCE:
        document["supply"]["pressure_reference"] = REFERENCES[int(value)]
        return
    *path, key = keys_of(machine, name)
    if path[:1] == ["slides"]:
        place: Any = next(joint for joint in document["joint"] if joint["name"] == path[1])
    else:
        place = document
        for part in path:
            place = place.setdefault(part, tomlkit.table())
    at: Any = {"x": 0, "y": 1}[key] if isinstance(place, list) else key
    old = place[at] if isinstance(place, list) or at in place else ""
    place[at] = _in_unit_of(old, value, parameters.unit_of(name))


def _in_unit_of(old: object, value: float, unit: str) -> Any:
    """Return a value as the old text has it, a number with a unit, if that reads back as the very value; else in SI."""
    plain = _PLAIN.fullmatch(old) if isinstance(old, str) else None
    if plain is None or not plain[1]:
        return float(value)
    text = f"{value / factor_to_si(plain[1], unit)!r} {plain[1]}"
    return text if to_si(text, unit, "") == value else float(value)


def _set_effects(document: Any, before: tuple[Acting, ...], now: tuple[Acting, ...]) -> None:
    """Keep the tables of effects that stay, with the values that they have now, and add those that are new."""
    known = {acting.key for acting in before}
    kept, new = {a.key: a for a in now if a.key in known}, [a for a in now if a.key not in known]
    if [a.key for a in before if a.key in kept] + [a.key for a in new] != [a.key for a in now]:
        kept, new = {}, list(now)  # in another order than the file's
    tables = document.get("effect", [])
    for k in reversed(range(len(before))):
        if before[k].key not in kept:
            del tables[k]
        elif kept[before[k].key] != before[k]:
            tables[k]["parameters"] = _parameters(kept[before[k].key])
    if not tables:
        document.pop("effect", None)
    _append(document, "effect", map(_entry, new))


def _parameters(acting: Acting) -> Any:
    """Return an effect's parameters as they stand in a file: on one line, or the table of a curve on several."""
    values = as_written(acting)
    if values is acting.parameters:
        return _inline(values)
    table = tomlkit.table()
    table.update({name: _plain(value) for name, value in values.items()})
    return table


def _inline(values: Mapping[str, Any]) -> Any:
    table = tomlkit.inline_table()
    table.update({str(name): _plain(value) for name, value in values.items()})
    return table


def _append(document: Any, key: str, entries: Iterable[Mapping[str, Any]]) -> None:
    """Add tables [[key]] at the end of the list of those, the first behind an empty line."""
    for entry in entries:
        if key not in document and not tomlkit.dumps(document).endswith("\n\n"):
            document.add(tomlkit.nl())
        tables: AoT = document.setdefault(key, tomlkit.aot())
        table: Table = tomlkit.table()
        table.update({name: _plain(value) for name, value in entry.items()})
        table.add(tomlkit.nl())
        tables.append(table)


def _plain(value: Any) -> Any:
    """Return a value of inline tables, lists and numbers."""
    if isinstance(value, Table):
        return value
    if isinstance(value, Mapping):
        return _inline(value)
    if isinstance(value, list | tuple):
        return [_plain(v) for v in value]
    return value if isinstance(value, bool | int | float | str) else str(value)


# -- anew ------------------------------------------------------------------------------------------------------------


def whole_text(crane: Description) -> str:
    """Return a crane as TOML text: SI numbers at full precision, one section after the other."""
    top = {"name": crane.name} | ({"description": crane.description} if crane.description else {})
    pose = dict(zip(crane.layout.coordinates, crane.initial.pose, strict=True))
    known, errors = ({n: as_given(e) for n, e in of.items()} for of in (crane.uncertainty, crane.model_error))
    parts = [
        _section(top | {"gravity": crane["gravity"], "independent": crane.machine.independent}),
        *(_section(joint, "joint", listed=True) for joint in _joints(crane)),
        *(_section(table, *path) for path, table in _numbers(crane).items()),
        _section(pose | {"less_loaded_pressure": crane.initial.less_loaded_pressure}, "initial"),
        *([_section(crane.sensors, "sensors")] if crane.sensors else []),
        _section(known, "uncertainty"),
        *([_section(crane.sources, "sources")] if crane.sources else []),
        *(_section(_entry(acting), "effect", listed=True) for acting in crane.effects),
        *([_section(errors, "model_error")] if errors else []),
        *(_section(entry, "history", listed=True) for entry in crane.history),
    ]
    return "\n".join(parts)


def _section(table: Mapping[str, Any], *path: str, listed: bool = False) -> str:
    """Return the text of a table [path], or [[path]] where it is one of several, each of its values on a line."""
    found: Any = {key: _plain(value) for key, value in table.items()}
    found = [found] if listed else found
    for key in reversed(path):
        found = {key: found}
    return tomlkit.dumps(found)


def _joints(crane: Description) -> Iterator[dict[str, Any]]:
    for joint in crane.machine.joints:
        found: dict[str, Any] = {
            "name": joint.name,
            "bodies": (joint.carrier, joint.body),
            "at": joint.pin.removeprefix("joints."),
        }
        if joint.own_pin:
            found["on"] = joint.own_pin.removeprefix("joints.")
        if joint.kind == PRISMATIC:
            found |= {"kind": PRISMATIC, "direction": crane[f"slides.{joint.name}.direction"]}
        turned = {"bend": "left" if joint.side > 0 else "right"}
        yield found | (turned if joint.closes else {"coordinate": joint.coordinate})


def _numbers(crane: Description) -> dict[tuple[str, ...], dict[str, Any]]:
    """Return the tables of numbers by their keys in the file, with what says how things hang together."""
    machine = crane.machine
    found: dict[tuple[str, ...], dict[str, Any]] = {("bodies", body): {} for body in machine.bodies}
    for name in machine.names:
        *path, key = keys_of(machine, name)
        if not path or path[0] == "slides" or key == "y" or (path[-1] == "edges" and crane[name] == 1.0):
            continue
        value: Any = REFERENCES[int(crane[name])] if name == REFERENCE else crane[name]
        if key == "x":
            key, value = path.pop(), (value, crane[f"{name.removesuffix('x')}y"])
        found.setdefault(tuple(path), {})[key] = value
    body, point = machine.payload
    found["payload",] |= {"body": body, "at": point.removeprefix("joints.")} if body else {}
    for c in machine.cylinders:
        about = {key: getattr(c, key) for key in OF_CYLINDER}
        ends = zip(("base", "rod_end"), c.points, strict=True)
        about |= {key: p.removeprefix("joints.") for key, p in ends if p.startswith("joints.")}
        found["cylinders", c.name] |= about
    for valve, voltage in crane.voltage.items():
        found["valves", valve]["voltage"] = vars(voltage)
    return found


def _entry(acting: Acting) -> dict[str, Any]:
    """Return an effect as a table [[effect]]."""
    return (
        {"name": acting.name} | ({"place": acting.place} if acting.place else {}) | {"parameters": _parameters(acting)}
    )
