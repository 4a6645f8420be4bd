"""Results of long series in a file, a JSON line each, so that a killed series goes on where it was."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from crane_exudyn.errors import CraneError
from crane_exudyn.files import write_text


def read_lines(path: Path) -> list[dict[str, Any]]:
    """Return what the lines of a file hold; a last one that was cut off is taken out of the file."""
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines(keepends=True)
    found = [_parsed(line) for line in lines]
    whole = [line for line, value in zip(lines, found, strict=True) if value is not None]
    if len(whole) < len(lines):
        write_text(path, "".join(whole))
    return [value for value in found if value is not None]


def _parsed(line: str) -> dict[str, Any] | None:
    try:
        value = json.loads(line) if line.endswith("\n") else None
    except ValueError:
        return None
    return value if isinstance(value, dict) else None


def add_line(path: Path, result: Mapping[str, Any]) -> None:
    """Add one result to a file, as one write.

    Raises:
        CraneError: there is no room.
    """
    try:
        with path.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(result) + "\n")
    except OSError as problem:
        raise CraneError(
            f"{path}: a result cannot be added: {problem.strerror}. Free some space; the series then continues."
        ) from problem
