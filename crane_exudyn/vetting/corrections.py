"""How to correct what channels are read from: the columns after a correction, and what a user types for it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace

from ..channels import of as units_of
from ..layout import Layout
from ..mapping import Column, keys_of
from ..recording import Recording
from ..tables import split_header
from ..units import factor_to_si, unit_of
from .findings import Finding
from .readings import Reading


def mended_columns(recording: Recording, findings: Iterable[Finding]) -> dict[str, Column]:
    """Return what each channel is to be read from after all corrections of the findings. A column that became another
    channel is no longer its old one.
    """
    fixed = {n: c for f in findings for n, c in f.columns.items()}
    taken = {c.header for c in fixed.values()}
    return {n: c for n, c in recording.columns.items() if c.header not in taken} | fixed


def reread(reading: Reading, columns: Mapping[str, Column], layout: Layout) -> dict[str, Column]:
    """Return the columns of a reading's channels; none if it is of commands that were recorded as voltages."""
    if any(s.channel not in columns for s in reading.made.values()):
        return {}
    units = units_of(layout)
    return {name: _rescaled(columns[s.channel], s.factor, s.offset, units[name]) for name, s in reading.made.items()}


def _rescaled(column: Column, factor: float, offset: float, si: str) -> Column:
    """Return a column whose channel is factor * channel + offset, in SI; in another unit, where the factor is one
    between units.
    """
    same = column.unit is None or abs(factor) == 1.0
    unit = None if same else unit_of(abs(factor) * factor_to_si(column.unit or "", si), si)
    if unit is None:
        return replace(column, factor=factor * column.factor, offset=factor * column.offset + offset)
    turned = math.copysign(1.0, factor) * column.factor
    return replace(column, unit=unit, factor=turned, offset=factor * column.offset + offset)


def shifted(columns: Mapping[str, Column], names: Iterable[str], late: float, drift: float = 0.0) -> dict[str, Column]:
    """Return the columns of some channels with stamps that are later after the event, and drift more, by so much."""
    return {n: replace(columns[n], late=columns[n].late + late, drift=columns[n].drift + drift) for n in names}


def typed(fix: Mapping[str, Column], was: Mapping[str, Column], layout: Layout) -> str:
    """Return what to type for a correction: `--map` options if they can express it, else the keys of a map file that
    change.
    """
    options = {n: _option(n, c, units_of(layout)[n]) for n, c in fix.items()}
    if all(options.values()):
        return f"Type {' '.join(f'--map {option}' for option in options.values())}."
    changed: dict[str, list[str]] = {}
    for n, c in fix.items():
        si = units_of(layout)[n]
        old, new = keys_of(was.get(n, Column(n)), si), keys_of(c, si)
        changes = [f"{key} = {value}" for key, value in new.items() if old.get(key) != value]
        changes += [f"no {key}" for key in old if key not in new]
        changed.setdefault(" and ".join(changes), []).append(f"[{n}]")
    lines = "; ".join(f"{changes} for {', '.join(names)}" for changes, names in changed.items())
    return f"Let `patu check --write-map FILE` write a map file (for --map-file): {lines}."


def _option(name: str, column: Column, si: str) -> str:
    """Return the `--map` option for a column, "" if an option cannot express all of it."""
    header, written = split_header(column.header)
    plain = column.offset == column.late == column.drift == 0.0 and abs(column.factor) == 1.0
    if not plain or (written is not None and column.unit is not None and written != column.unit):
        return ""
    unit = f"[{column.unit}]" if written is None and column.unit and si else ""
    return f"{name}={'-' if column.factor < 0.0 else ''}{header}{unit}"
