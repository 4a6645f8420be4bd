"""The part of a crane file that says how its bodies, joints and cylinders hang together; what is impossible is refused
here.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from functools import cache
from importlib import resources
from typing import Any

from .errors import CraneError, nearest, refuse_unknown
from .layout import MOST_COORDINATES, Layout
from .machine import GROUND, PRISMATIC, REVOLUTE, Cylinder, Joint, Machine
from .toml_reading import table_of

#: keys that describe a machine, by section; the other keys there are numbers
OF_CYLINDER = ("bodies", "chambers", "loaded", "length", "command", "voltage")
OF_PAYLOAD = ("body", "at")
OF_JOINT = ("name", "kind", "bodies", "at", "on", "coordinate", "bend", "direction")
#: names that may head a column of a recording, beside its unit in brackets
_IN_HEADINGS = re.compile(r"\w([\w.\- ]*\w)?")
_BENDS = {"left": 1, "right": -1}
#: the machine of files that describe none, as those of earlier versions
_EARLIER = "patu655"


def machine_of(document: Mapping[str, Any], where: str) -> Machine:
    """Return the machine that a parsed crane file describes.

    Raises:
        CraneError: field, what was found, what is possible, and how to mend it.
    """
    if "joint" not in document:
        return _described_by_none(document, where)
    tables = document["joint"]
    if not isinstance(tables, list) or not all(isinstance(t, Mapping) for t in tables):
        raise CraneError(f"{where}: joint = {str(tables)[:60]} should be tables, each headed by [[joint]].")
    bodies = tuple(_section(document, "bodies", where))
    if GROUND in bodies:
        raise CraneError(f"{where}: a body is named {GROUND!r}, which is reserved for the ground. Choose another name.")
    joints = [_joint(table, bodies, where) for table in tables]
    _refuse_repeated(where, "joint", [j.name for j in joints])
    _refuse_repeated(where, "coordinate", [j.coordinate for j in joints if not j.closes])
    carriers = _carriers(bodies, joints, where)
    independent = _independent(document, joints, where)
    joints = [_turned(j, carriers, independent, where) if j.closes else j for j in joints]
    ordered = _ordered(bodies, carriers, [j for j in joints if j.closes], where)
    joints = [*(carriers[b] for b in ordered), *(j for j in joints if j.closes)]
    independent = tuple(j.coordinate for j in joints if j.coordinate in independent)  # carriers before what they carry
    cylinders, points = _cylinders(document, bodies, joints, where)
    payload = _payload(document, bodies, points, where)
    _check_points(document, joints, points, where)
    machine = Machine(
        bodies=ordered,
        joints=tuple(joints),
        independent=independent,
        cylinders=cylinders,
        payload=payload,
        points=points,
    )
    _check_drives(machine, where)
    return machine


def _described_by_none(document: Mapping[str, Any], where: str) -> Machine:
    """Return the machine of a file without joints, which must have the bodies of that one."""
    bodies = document.get("bodies", {})
    if isinstance(bodies, Mapping) and not (bodies and set(bodies) <= set(_earlier().bodies)):
        raise CraneError(
            f"{where}: there is no [[joint]], so the structure of the machine is unknown. Give one for each body, "
            "with its name, bodies and coordinate."
        )
    return _earlier()


@cache
def _earlier() -> Machine:
    text = resources.files("crane_exudyn.data").joinpath(f"{_EARLIER}.toml").read_text(encoding="utf-8")
    return machine_of(tomllib.loads(text), _EARLIER)


def usual_layout() -> Layout:
    """Return the layout of the machine of crane files that describe none: that of patu655."""
    return _earlier().layout


def _section(document: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    table = table_of(document, key, where)
    if not all(isinstance(t, Mapping) for t in table.values()):
        raise CraneError(f"{where}: {key} should be tables, each headed by [{key}.NAME].")
    return table


def _known(where: str, value: object, known: Sequence[str], *, several: int = 1) -> Any:
    """Return a name, or a list of several, that must be known."""
    names = value if several > 1 else [value]
    if not isinstance(names, list) or len(names) != several:
        raise CraneError(f"{where} = {value!r} should be {several} names in brackets. Known: {', '.join(known)}.")
    for name in names:
        if name not in known:
            raise CraneError(f"{where} = {name!r} is not known.{nearest(str(name), list(known))}")
    return names if several > 1 else value


def _refuse_repeated(where: str, what: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise CraneError(f"{where}: two things are named {what} {name!r}. Give one of them another name.")


# -- joints ------------------------------------------------------------------------------------------------------------


def _joint(table: Mapping[str, Any], bodies: Sequence[str], where: str) -> Joint:
    name = table.get("name")
    if not isinstance(name, str) or not name.isidentifier():
        raise CraneError(f"{where}: a [[joint]] needs a name in letters, digits and underscores, found {name!r}.")
    place = f"{where}: joint {name!r}"
    refuse_unknown(place, table, OF_JOINT)
    carrier, body = _known(f"{place}: bodies", table.get("bodies"), (GROUND, *bodies), several=2)
    kind = _known(f"{place}: kind", table.get("kind", REVOLUTE), (REVOLUTE, PRISMATIC))
    if "direction" in table and kind == REVOLUTE:
        raise CraneError(
            f'{place}: direction is that in which a body slides, but this joint turns. Add kind = "{PRISMATIC}", or '
            "remove it."
        )
    side = _BENDS[_known(f"{place}: bend", table.get("bend", "left"), tuple(_BENDS))]
    own = f"joints.{table['on']}" if "on" in table else ""
    joint = Joint(
        name, kind, carrier, body, f"joints.{table.get('at', name)}", own, str(table.get("coordinate", "")), side
    )
    if carrier == body or body == GROUND:
        raise CraneError(
            f"{place}: bodies = {[carrier, body]} should be the body that carries (or {GROUND!r}) and another one that "
            "is carried."
        )
    if joint.closes and (kind == PRISMATIC or not own):
        raise CraneError(
            f"{place} has no coordinate, so it closes a loop: it must be {REVOLUTE}, with its pin on both bodies (at "
            "and on)."
        )
    if joint.closes and joint.pin == own and "at" not in table:
        raise CraneError(
            f"{place} closes a loop, so its pin is a point on both bodies: on = {table['on']!r} is that on {body}. "
            f"Give at, too, a point of its own on {carrier}."
        )
    return joint


def _carriers(bodies: Sequence[str], joints: Sequence[Joint], where: str) -> dict[str, Joint]:
    """Return the joint that carries each body."""
    found: dict[str, Joint] = {}
    for joint in joints:
        if joint.closes:
            continue
        if joint.body in found:
            raise CraneError(
                f"{where}: body {joint.body!r} is carried by two joints, {found[joint.body].name!r} and "
                f"{joint.name!r}. "
                "Leave the coordinate of one of them out: it closes a loop."
            )
        found[joint.body] = joint
    for body in bodies:
        if body not in found:
            raise CraneError(
                f"{where}: body {body!r} hangs on nothing. Give the [[joint]] with a coordinate that carries it."
            )
        seen, at = {body}, found[body].carrier
        while at != GROUND:
            if at in seen or at not in found:
                raise CraneError(f"{where}: body {body!r} is carried by itself. Correct the bodies of its joints.")
            seen.add(at)
            at = found[at].carrier
    if not bodies:
        raise CraneError(f"{where}: there is no body. Give at least one [bodies.NAME].")
    return found


def _independent(document: Mapping[str, Any], joints: Sequence[Joint], where: str) -> tuple[str, ...]:
    """Return the independent coordinates: those stated, else those with a place at the start, else all."""
    names = [j.coordinate for j in joints if not j.closes]
    stated = document.get("independent", [n for n in names if n in table_of(document, "initial", where)] or names)
    if not isinstance(stated, list):
        raise CraneError(f"{where}: independent = {stated!r} should be a list of coordinates: {', '.join(names)}.")
    for name in stated:
        _known(f"{where}: independent", name, names)
    loops = sum(j.closes for j in joints)
    if len(set(stated)) == len(stated) < len(names) - 2 * loops:
        raise _open_chain(stated, joints, where)
    if len(stated) != len(names) - 2 * loops or len(set(stated)) != len(stated):
        each = {0: "no loop makes any", 1: "the loop makes two"}.get(loops, f"each of the {loops} loops makes two")
        raise CraneError(
            f"{where}: independent = {stated} should be {len(names) - 2 * loops} of the coordinates "
            f"{', '.join(names)}: {each} of them depend on the others."
        )
    if len(stated) > MOST_COORDINATES:
        raise CraneError(
            f"{where}: there are {len(stated)} independent coordinates, at most {MOST_COORDINATES} are possible."
        )
    return tuple(n for n in names if n in stated)


def _open_chain(independent: Sequence[str], joints: Sequence[Joint], where: str) -> CraneError:
    """Return the error that says which coordinates nothing holds: neither are they independent, nor does a loop close
    over their bodies.
    """
    left = {j.body: j for j in joints if not j.closes and j.coordinate not in independent}
    for ends in ((j.carrier, j.body) for j in joints if j.closes):
        second = next((b for b in ends if b in left and left[b].carrier in left), None)
        if second:  # both bodies of this loop are held
            del left[left.pop(second).carrier]
    free, several = " and ".join(left), len(left) > 1
    return CraneError(
        f"{where}: {free} {'form an open chain' if several else 'hangs freely'}: "
        f"{', '.join(j.coordinate for j in left.values())} {'are' if several else 'is'} not independent (those are "
        f"{', '.join(independent)}), and no joint closes a loop there, which would make two coordinates depend on the "
        "others. Give that [[joint]], with bodies, at and on but no coordinate, or state the coordinate"
        f"{'s' * several} in independent, too."
    )


def _turned(joint: Joint, carriers: Mapping[str, Joint], independent: Sequence[str], where: str) -> Joint:
    """Return a joint that closes a loop from its second dependent body to the body that the loop ends on."""

    def follows(body: str) -> bool:
        return body != GROUND and carriers[body].coordinate not in independent and carriers[body].kind == REVOLUTE

    def ends(body: str) -> bool:
        return (
            follows(body) and follows(carriers[body].carrier) and not follows(carriers[carriers[body].carrier].carrier)
        )

    if ends(joint.carrier):
        return joint
    if ends(joint.body):
        return Joint(joint.name, joint.kind, joint.body, joint.carrier, joint.own_pin, joint.pin, "", -joint.side)
    mend = f"State other independent coordinates than {', '.join(independent)}, or build the loop that way."
    if follows(joint.carrier) and follows(joint.body):
        other = carriers[joint.carrier].name
        mend = (
            f"Close it at joint {other!r} instead: bodies = {[joint.body, joint.carrier]} and the coordinate of "
            f"{other!r} for joint {joint.name!r}, and {other!r} without a coordinate, with its pin on both bodies (at "
            "and on)."
        )
    raise CraneError(
        f"{where}: joint {joint.name!r} closes a loop whose dependent bodies are not two, one carried by the other on "
        f"revolute joints. {mend}"
    )


def _ordered(
    bodies: Sequence[str], carriers: Mapping[str, Joint], loops: Sequence[Joint], where: str
) -> tuple[str, ...]:
    """Return the bodies in the order in which they can be placed."""
    pairs = {carriers[j.carrier].carrier: j for j in loops}
    dependent = {body for j in loops for body in (carriers[j.carrier].carrier, j.carrier)}
    placed: list[str] = []

    def ready(body: str) -> bool:
        return body in (GROUND, *placed)

    while len(placed) < len(bodies):
        before = len(placed)
        for body in bodies:
            if ready(body) or not ready(carriers[body].carrier):
                continue
            if body not in dependent:
                placed.append(body)
            elif body in pairs and ready(pairs[body].body):
                placed += [body, pairs[body].carrier]
        if len(placed) == before:
            left = [b for b in bodies if not ready(b)]
            raise CraneError(
                f"{where}: the bodies {', '.join(left)} cannot be placed: their loops end on one another. "
                "State other independent coordinates."
            )
    return tuple(placed)


# -- cylinders and payload -----------------------------------------------------------------------------------------


def _joint_points(joints: Sequence[Joint]) -> Iterator[tuple[str, str]]:
    for joint in joints:
        yield joint.pin, joint.carrier
        if joint.own_pin:
            yield joint.own_pin, joint.body


def _cylinders(
    document: Mapping[str, Any], bodies: Sequence[str], joints: Sequence[Joint], where: str
) -> tuple[tuple[Cylinder, ...], dict[str, str]]:
    """Return the cylinders, and the body that carries each point of joints and cylinders."""
    points = dict(_joint_points(joints))
    found = []
    for k, (name, table) in enumerate(_section(document, "cylinders", where).items()):
        place = f"{where}: cylinders.{name}"
        on = _known(f"{place}.bodies", table.get("bodies"), (GROUND, *bodies), several=2)
        if on[0] == on[1]:
            raise CraneError(f"{place}.bodies = {on}: a cylinder joins two bodies. Name the other one.")
        ends = []
        for key, body in zip(("base", "rod_end"), on, strict=True):
            given = table.get(key)
            point = f"joints.{given}" if isinstance(given, str) else f"cylinders.{name}.{key}"
            if isinstance(given, str) and points.get(point) != body:
                known = [p.removeprefix("joints.") for p, b in points.items() if b == body]
                raise CraneError(f"{place}.{key} = {given!r} is no point of {body}.{nearest(given, known)}")
            points.setdefault(point, body)
            ends.append(point)
        chambers = table.get("chambers", [f"p{2 * k + 1}", f"p{2 * k + 2}"])
        if not (isinstance(chambers, list) and len(chambers) == 2 and all(isinstance(c, str) for c in chambers)):
            raise CraneError(f'{place}.chambers = {chambers!r} should be two names, such as ["p1", "p2"].')
        loaded = _known(f"{place}.loaded", table.get("loaded", chambers[0]), chambers)
        channels = [
            str(table.get(key, f"{letter}{k + 1}"))
            for key, letter in (("length", "s"), ("command", "u"), ("voltage", "U"))
        ]
        found.append(Cylinder(name, (on[0], on[1]), (ends[0], ends[1]), (chambers[0], chambers[1]), loaded, *channels))
    channels = [n for c in found for n in (*c.chambers, c.length, c.command, c.voltage)]
    coordinates = [n for j in joints if not j.closes for n in (j.coordinate, f"d{j.coordinate}", f"{j.coordinate}_abs")]
    for name in (*channels, *coordinates):
        if not _IN_HEADINGS.fullmatch(name):
            raise CraneError(
                f"{where}: {name!r} cannot name a channel, because recordings are headed by it. Use letters, digits, "
                "underscores, dots and hyphens."
            )
    _refuse_repeated(where, "channel", [*channels, *coordinates, "pp", "pt", "theta", "dtheta", "time"])
    return tuple(found), points


def _payload(document: Mapping[str, Any], bodies: Sequence[str], points: dict[str, str], where: str) -> tuple[str, str]:
    """Return body and point of the payload; the point becomes one of the points of the file."""
    table = table_of(document, "payload", where)
    if "body" not in table and "at" not in table:
        return "", ""
    body = _known(f"{where}: payload.body", table.get("body"), bodies)
    point = f"joints.{table.get('at')}"
    if points.setdefault(point, body) != body:
        raise CraneError(f"{where}: payload.at = {table.get('at')!r} is a point of {points[point]}, not of {body}.")
    return body, point


def _check_points(document: Mapping[str, Any], joints: Sequence[Joint], points: Mapping[str, str], where: str) -> None:
    """Refuse points that are named but not given in [joints], and those given there that nothing is at."""
    given = table_of(document, "joints", where)
    named = [p.removeprefix("joints.") for p in points if p.startswith("joints.")]
    idle = [name for name in given if name not in named]
    for name in (n for n in named if n not in given):
        like = nearest(name, idle) if idle else f' Give it, such as {name} = ["1.2 m", "0 m"].'
        raise CraneError(f"{where}: {_asks_for(name, joints)}, but [joints] has no point {name!r}.{like}")
    if idle:
        raise CraneError(
            f"{where}: joints.{idle[0]} is not used by anything, so its body is unknown. A point is "
            "the pin of a joint (of its name, or its at or on), the end of a cylinder or the payload's at. Remove "
            "the point, or name it in one of these."
        )


def _asks_for(name: str, joints: Sequence[Joint]) -> str:
    """Return which key of a file names a point."""
    for joint in joints:
        if f"joints.{name}" in (joint.pin, joint.own_pin):
            own = joint.name == name and f"joints.{name}" == joint.pin
            return f"joint {joint.name!r} {'has its pin at the point of its name' if own else f'names {name!r}'}"
    return f"payload.at = {name!r}"


def _check_drives(machine: Machine, where: str) -> None:
    """Refuse cylinders that drive nothing, two that drive one freedom, and coordinates that nothing drives."""
    for cylinder in machine.cylinders:
        if not machine.moved_by(cylinder):
            raise CraneError(
                f"{where}: cylinders.{cylinder.name} joins {' and '.join(cylinder.bodies)}, which do not move against "
                "each other. Correct its bodies."
            )
    driven = machine.driven
    for cylinder, coordinate in zip(machine.cylinders, driven, strict=True):
        if not coordinate:
            others = [
                c.name for c in machine.cylinders if machine.moved_by(c) & machine.moved_by(cylinder) and c != cylinder
            ]
            moved = ", ".join(sorted(machine.moved_by(cylinder)))
            raise CraneError(
                f"{where}: cylinders.{cylinder.name} drives {moved}, which {' and '.join(others)} drives already: two "
                "drives for one freedom. "
                "Remove one of them, or correct its bodies."
            )
    free = [name for name in machine.independent if name not in driven]
    if free:
        raise CraneError(
            f"{where}: nothing drives the coordinate {free[0]!r}. Give a cylinder that moves it; a payload that swings "
            "is the effect payload_swing."
        )
