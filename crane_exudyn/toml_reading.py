"""TOML files of people: what is no TOML is told with the line, in words that name the key and the mend."""

from __future__ import annotations

import re
import textwrap
import tomllib
from collections.abc import Mapping
from typing import Any

from .errors import CraneError, shortened

_PLACE = re.compile(r"\s*\(at line (\d+), column \d+\)")
#: text in quotes, and a comment: what is left of a value was written without quotes
_QUOTED = re.compile(r'"[^"]*"|\'[^\']*\'|#.*')
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+")


def why_no_toml(problem: tomllib.TOMLDecodeError, text: str) -> str:
    """Return in words, which end with a full stop, what is wrong in a text that is no TOML, where, and the mend."""
    place = _PLACE.search(str(problem))
    if place is None:  # at the end of the file
        return f"{problem}."
    lines = text.replace("\r\n", "\n").split("\n")[: int(place[1])]
    line, said = lines[-1].strip(), str(problem)[: place.start()]
    table = next((kept for above in reversed(lines[:-1]) if (kept := above.strip()).startswith("[")), "")
    where = f"line {place[1]}"
    if said.startswith("Cannot declare"):
        return f"{where}: the table {line} occurs twice. Give one of them another name, or merge them."
    key, _, value = (part.strip() for part in line.partition("="))
    if said == "Cannot overwrite a value":
        within = f" in {_bare(table)}" if table and not line.startswith("[") else ""
        return f"{where}: {key} occurs twice{within}. Remove one."
    shown = textwrap.shorten(line, 60, placeholder=" …")
    return f"{where}, {shown}: {said}.{_mend(key, value)}"


def table_of(document: Mapping[str, Any], key: str, where: str) -> Mapping[str, Any]:
    """Return a table of a document, empty where there is none. Raises CraneError for anything that is no table; `where`
    names the file.
    """
    table = document.get(key, {})
    if not isinstance(table, Mapping):
        raise CraneError(f"{where}: {key} = {shortened(table)} should be a table [{key}].")
    return table


def _bare(header: str) -> str:
    """Return a line that heads a table without the comment behind it."""
    return header.partition("#")[0].strip()


def _mend(key: str, value: str) -> str:
    """Return what to write of a value with a unit or a decimal comma; "" where it is something else."""
    value = value.partition("#")[0].strip()
    if _DECIMAL_COMMA.fullmatch(value):
        return f" Write a decimal point: {key} = {value.replace(',', '.')}."
    unquoted = _QUOTED.sub("", value)
    if not re.search(r"[^\W\d_]|[°%*/]", unquoted) or unquoted.count('"') % 2:
        return ""
    example = f'{key} = "{value}"' if unquoted == value and not value.startswith(("[", "{")) else 'mass = "95 kg"'
    return f" Put a value with a unit, or a name, in quotes, as {example}."
