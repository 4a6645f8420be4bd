"""How channels stand in a file: under which column, in which unit, with which sign and offset; from `--map` options and
map files.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from . import channels
from .errors import CraneError, nearest, refuse_unknown
from .layout import Layout
from .tables import split_header
from .toml_reading import why_no_toml
from .units import factor_to_si, people_of, to_si

_KEYS = ("column", "unit", "sign", "scale", "offset", "late", "drift", "held")


@dataclass(frozen=True)
class Column:
    """Where a channel comes from: channel = factor * column + offset.

    Attributes:
        header: of the column, with or without its unit in brackets.
        unit: that the values have, whatever the file says; None: as the file, or the header here, says.
        factor: sign and scale; offset: in SI.
        late: s by which the file's stamps come after what they stand beside; drift: by how much more in each second.
        held: of a command, whether all commands keep their value until the next sample.
        said: where that was said, for messages.
    """

    header: str
    unit: str | None = None
    factor: float = 1.0
    offset: float = 0.0
    late: float = 0.0
    drift: float = 0.0
    held: bool = False
    said: str = "--map"

    @classmethod
    def parse(cls, text: str) -> Column:
        """Return what `--map` says behind its "=": COLUMN[UNIT], with a minus before it for the other sign."""
        return cls(text.removeprefix("-"), factor=-1.0 if text.startswith("-") else 1.0)

    @property
    def names(self) -> set[str]:
        """What the column may be called."""
        return {self.header, split_header(self.header)[0]}

    def stamped(self, time: np.ndarray) -> np.ndarray:
        """Return the times (n,) in s at which samples were taken that are stamped `time`."""
        if self.late == 0.0 and self.drift == 0.0:
            return time
        return time - self.late - self.drift * (time - time[0])


MappingLike = Mapping[str, str | Column]


def columns_of(mapping: MappingLike, layout: Layout) -> dict[str, Column]:
    """Return what each channel of a machine is read from.

    Raises:
        CraneError: a channel that there is none of, a column that stands for two, or a time that is to be changed.
    """
    found = {name: Column.parse(c) if isinstance(c, str) else c for name, c in mapping.items()}
    known = ["time", *channels.of(layout)]
    first: dict[str, str] = {}
    for name, column in found.items():
        if name not in known:
            raise CraneError(
                f"{column.said} {name}={column.header}: there is no channel {name!r}.{nearest(name, known)}"
            )
        if column.header in first:
            raise CraneError(
                f"{column.said} takes column {column.header!r} for two channels, {first[column.header]} and {name}. "
                "Map each column once."
            )
        if name == "time" and replace(column, header="", unit=None, said="") != Column("", said=""):
            raise CraneError(f"{column.said}: only the name and unit of a time can be mapped.")
        first[column.header] = name
    return found


def parse_map(entries: Sequence[str] | None) -> dict[str, Column]:
    """Return {channel: column} of `--map z1=BoomAngle[deg]` options.

    Raises:
        CraneError: an entry without "=", or a channel mapped twice.
    """
    mapping: dict[str, Column] = {}
    for entry in entries or ():
        name, equals, column = (part.strip() for part in entry.partition("="))
        if not (name and equals and column.removeprefix("-")):
            raise CraneError(f"--map {entry!r} is not of the form NAME=COLUMN[UNIT], such as z1=BoomAngle[deg].")
        if name in mapping:
            raise CraneError(f"--map gives {name!r} twice: {mapping[name].header!r} and {column!r}. Keep one.")
        mapping[name] = Column.parse(column)
    return mapping


# -- map files -------------------------------------------------------------------------------------------------------


def load_map(path: Path, layout: Layout) -> dict[str, Column]:
    """Return {channel: column} of a map file for recordings of a machine: TOML with a table a channel. ::

        [z1]
        column = "BoomAngle"  # the channel's own name where absent
        unit = "deg"          # as the file says where absent
        sign = -1
        scale = 0.5
        offset = "2 deg"      # added last
        late = "0.1 s"        # the stamps come so much after the event,
        drift = 0.001         # and by so much more in each second

        [u1]
        held = true           # commands keep their value until the next sample, instead of going there in a line

    Raises:
        CraneError: names the file, the table and the key, what was found, what was expected and how to mend it.
    """
    text = ""
    try:
        document = tomllib.loads(text := path.read_text(encoding="utf-8-sig"))
    except FileNotFoundError:
        raise CraneError(
            f"{path}: there is no such map file. Check the name and the folder; `patu check REC --write-map FILE` "
            "writes one."
        ) from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as problem:
        why = why_no_toml(problem, text) if isinstance(problem, tomllib.TOMLDecodeError) else f"{problem}."
        raise CraneError(
            f'{path}: not a TOML file: {why} Expected tables such as [z1] with column = "BoomAngle".'
        ) from problem
    return {name: _column(f"{path}, [{name}]", name, table, layout) for name, table in document.items()}


def _column(where: str, name: str, table: Any, layout: Layout) -> Column:
    units = {"time": "s", **channels.of(layout)}
    if name not in units:
        raise CraneError(f"{where}: there is no channel {name!r}.{nearest(name, list(units))}")
    if not isinstance(table, dict):
        raise CraneError(
            f"{where}: found {table!r}, expected a table. Write [{name}] and below it column = {str(table)!r}."
        )
    refuse_unknown(where, table, _KEYS)
    si = units[name]
    column, unit = table.get("column", name), table.get("unit")
    for key, value in (("column", column), ("unit", unit)):
        if value is not None and not (isinstance(value, str) and (value or key == "unit")):
            raise CraneError(f"{where}: {key} = {value!r}, expected a text.")
    if unit is not None:
        _check_unit(where, unit, si)
    sign, scale = table.get("sign", 1), to_si(table.get("scale", 1.0), "", f"{where}: scale")
    if sign not in (1, -1) or isinstance(sign, bool):
        raise CraneError(f"{where}: sign = {sign!r}, expected 1 or -1. Write another factor as scale.")
    if scale == 0.0:
        raise CraneError(f"{where}: scale = 0 removes the whole signal. Give another factor, or leave it out.")
    offset, late = (to_si(table.get(key, 0.0), u, f"{where}: {key}") for key, u in (("offset", si), ("late", "s")))
    drift = to_si(table.get("drift", 0.0), "", f"{where}: drift")
    if not abs(drift) < 0.5:
        raise CraneError(
            f"{where}: drift = {drift:g}, expected a small number: seconds by which the stamps fall behind in each "
            "second."
        )
    held = table.get("held", False)
    if not isinstance(held, bool) or (held and name not in (*layout.commands, *layout.voltages)):
        raise CraneError(f"{where}: held = {held!r}, expected true or false, of a command.")
    return Column(column, unit, sign * scale, offset, late, drift, held, where)


def _check_unit(where: str, unit: str, si: str) -> None:
    try:
        factor_to_si(unit, si)
    except CraneError as problem:
        raise CraneError(f"{where}: {problem}. Correct the unit.") from None


def map_text(mapping: Mapping[str, Column], layout: Layout) -> str:
    """Return a mapping of a machine's channels as the text of a map file."""
    units = channels.of(layout)
    return "\n".join(_table(name, column, units.get(name, "s")) for name, column in mapping.items())


def _table(name: str, column: Column, unit: str) -> str:
    return "\n".join([f"[{name}]", *(f"{key} = {value}" for key, value in keys_of(column, unit).items())]) + "\n"


def keys_of(column: Column, si: str) -> dict[str, str]:
    """Return what a map file says of a column whose channel has the SI unit `si`: keys and values as TOML writes
    them.
    """
    size, (unit, one) = abs(column.factor), people_of(si)
    found = {
        "column": _quoted(column.header),
        "unit": None if column.unit is None else _quoted(column.unit),
        "sign": "-1" if column.factor < 0.0 else None,
        "scale": f"{size:.12g}" if size != 1.0 else None,
        "offset": _quoted(f"{column.offset / one:.12g} {unit}".strip()) if column.offset else None,
        "late": f'"{column.late:.6g} s"' if column.late else None,
        "drift": f"{column.drift:.6g}" if column.drift else None,
        "held": "true" if column.held else None,
    }
    return {key: value for key, value in found.items() if value is not None}


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'
