"""From the columns of a file to the channels of a recording: names, units and clocks are judged here."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from . import channels as channel_names
from .channels import Channel
from .errors import CraneError, nearest
from .layout import Layout
from .mapping import Column
from .tables import RawColumn, RawTable, remarks, split_header
from .units import PEOPLE, factor_to_si, reference_mend, reference_of

#: share of repeated times up to which the repeated samples are left out with a remark
_MOST_REPEATED = 0.1
#: columns that a message names
_SHOWN = 12
#: a pause of all channels beyond so many seconds, and so many times longer than usual, splits a recording; beyond a day
#: the clock is wrong
_SPLIT, _SPLIT_RATIO, _DAY = 10.0, 100.0, 86400.0


def _written(si_unit: str) -> str:
    """Return a unit that people write of a quantity, for messages."""
    return PEOPLE.get(si_unit, si_unit or "-")


def example(layout: Layout) -> str:
    """Return an example of what `--map` takes, such as "z1=BoomAngle[deg]"."""
    name = layout.coordinates[0]
    return f"{name}=BoomAngle[{_written(layout.unit_of(name))}]"


def wanted(mapping: Mapping[str, Column], layout: Layout) -> set[str]:
    """Return the names of columns that matter."""
    return {"time", *channel_names.of(layout)}.union(*(column.names for column in mapping.values()))


def assemble(path: Path, table: RawTable, mapping: Mapping[str, Column], layout: Layout) -> dict[str, Any]:
    """Return name, channels, source, notes, columns, those ignored, and layout of the recording that a file's columns
    make.

    Names, units and clocks are judged, missing samples dropped.
    """
    units = channel_names.of(layout)
    named, notes, ignored = _name_columns(path, table, mapping, layout)
    clock = named.pop("time", None)
    if not named:
        raise CraneError(
            f"{path}: found no known channel among the columns {_headers(table)}. Expected some of "
            f"{', '.join(n for n in units if n not in layout.added)}; give other names with --map {example(layout)}, "
            "or the crane that was recorded with --crane FILE (in Python: layout=crane.layout)."
        )
    notes = [*table.notes, *notes]
    shared = {} if clock is None or all(c.clock for c, _ in named.values()) else {"time": clock}
    for refuse in (_refuse_without_unit, _refuse_referenced):
        refuse(path, shared | named, {"time": "s", **units})
    times: dict[int, np.ndarray] = {}
    channels: dict[str, Channel] = {}
    repeated: dict[tuple[int, str], list[str]] = {}
    for name in (n for n in units if n in named):  # in the order of the contract, whatever the file's
        own = _clock_of(path, named[name], clock, table)
        if id(own) not in times:
            times[id(own)] = _seconds(path, own, table)
        channel = _channel(path, name, named[name], times[id(own)], table, mapping.get(name), layout)
        if channel is None:
            notes.append(f"channel {name} has no sample")
            continue
        channels[name] = channel
        stamps = times[id(own)][~np.isnan(named[name][0].values)]
        if len(channel) < len(stamps):
            repeated.setdefault((len(stamps) - len(channel), _where_repeated(stamps)), []).append(name)
    notes += [
        f"channel{'s' * (len(names) > 1)} {', '.join(names)}: {again} samples with a repeated time are left out, "
        f"{where}"
        for (again, where), names in repeated.items()
    ]
    if max((len(c) for c in channels.values()), default=0) < 2:
        raise CraneError(f"{path}: found fewer than two samples, expected a recording over time. Record longer.")
    channels, split = _longest_stretch(channels)
    notes += split
    origin = named | ({} if clock is None else {"time": clock})
    read_from = {
        n: replace(mapping.get(n, Column("")), header=column.header, unit=unit)
        for n, (column, unit) in origin.items()
        if n == "time" or n in channels
    }
    return {
        "name": path.name.partition(".")[0], "channels": channels, "source": str(path), "notes": tuple(notes),
        "columns": read_from, "ignored": tuple(ignored), "held": any(column.held for column in mapping.values()),
        "layout": layout,
    }  # fmt: skip


def _name_columns(
    path: Path, table: RawTable, mapping: Mapping[str, Column], layout: Layout
) -> tuple[dict[str, tuple[RawColumn, str | None]], list[str], list[str]]:
    """Return {channel: (column, unit)}, remarks on columns that were left alone, and those that are of no channel.

    A column that merely has the name of something unseen, without a unit, is somebody's own.
    """
    known = ("time", *channel_names.of(layout))
    by_column = {id(_find(path, table, column.header, column.said)): name for name, column in mapping.items()}
    named: dict[str, tuple[RawColumn, str | None]] = {}
    left: dict[str, tuple[str, str | None]] = {}
    for column in table.columns:
        name, unit = split_header(column.header)
        unit = column.unit if unit is None else unit
        if id(column) in by_column:
            name = by_column[id(column)]
            unit = _mapped_unit(path, column.header, unit, mapping[name])
        elif name in mapping or name not in known or (name in layout.added and unit is None):
            left[column.header] = (name, unit)
            continue
        if name in named:
            raise _twice(path, name, named[name][0].header, column.header)
        named[name] = (column, unit)
    aside = [header for header, (name, _) in left.items() if name in mapping]
    notes = [f"column {h!r} was replaced by column {mapping[left[h][0]].header!r}" for h in aside]
    others = {header: own for header, own in left.items() if header not in aside}
    like = {header: _like(name, unit, named, layout) for header, (name, unit) in others.items()}
    likely = [h for h in others if like[h] and (len(others) <= _SHOWN or _plain(others[h][0]) in map(_plain, like[h]))]
    notes += [_remark(header, *others[header], like[header], layout) for header in likely]
    notes += remarks("column", [header for header in others if header not in likely], "was ignored")
    ignored = [header for header, (name, _) in others.items() if _plain(name) not in map(_plain, like[header])]
    return named, notes, ignored


def _twice(path: Path, name: str, first: str, second: str) -> CraneError:
    """Return the error on two columns of one channel, which `--map` can only choose from where their headers differ."""
    choose = f", or choose, as with --map {_quoted(f'{name}={first}')}" if first != second else ""
    return CraneError(
        f"{path}: channel {name} occurs twice, as columns {first!r} and {second!r}. Delete or rename one{choose}."
    )


def _plain(name: str) -> str:
    """Return a name without what people write differently: capitals, and signs between its parts."""
    return re.sub(r"[\W_]", "", name).lower()


def _digits(name: str) -> str:
    return re.sub(r"\D", "", name)


def _like(name: str, unit: str | None, named: Collection[str], layout: Layout) -> list[str]:
    """Return the channels that a column of another name may be: the one of this name but for capitals and signs; or
    those that are still wanted, have its dimension and, where it has any, its digits.
    """
    units = channel_names.of(layout)
    same = [c for c in units if _plain(c) == _plain(name)]
    if same or unit is None:
        return [c for c in same if c not in named]
    wanted = [c for c in units if units[c] and c not in (*named, *layout.added) and c.removesuffix("_abs") not in named]
    return [c for c in wanted if _digits(name) in ("", _digits(c)) and _fits(unit, units[c])]


def _fits(unit: str, si_unit: str) -> bool:
    """Whether a unit has the dimension of an SI unit."""
    try:
        factor_to_si(unit, si_unit)
    except CraneError:
        return False
    return True


def _quoted(typed: str) -> str:
    """Return what is typed as a shell takes it for one word."""
    return f"'{typed}'" if re.search(r"\s", typed) else typed


def _headers(table: RawTable) -> str:
    """Return the headers of a file as one text, the first of them where there are many."""
    headers = [c.header for c in table.columns]
    return ", ".join(headers[:_SHOWN]) + ", …" * (len(headers) > _SHOWN)


def _refuse_without_unit(path: Path, named: Mapping[str, tuple[RawColumn, str | None]], si: Mapping[str, str]) -> None:
    """Refuse the columns that need a unit and have none, all at once."""
    without = {n: (column.header, _written(si[n])) for n, (column, unit) in named.items() if unit is None and si[n]}
    if without:
        s = "s" * (len(without) > 1)
        written = ", ".join(f"{n}[{unit}]" for n, (_, unit) in without.items())
        typed = " ".join(f"--map {n}={header}[{unit}]" for n, (header, unit) in without.items())
        raise CraneError(
            f"{path}, column{s} {', '.join(header for header, _ in without.values())}: no unit is given. Write it into "
            f"the name{s}, as {written}, or give {typed}. Files in SI units have rad, m and Pa."
        )


def _refuse_referenced(path: Path, named: Mapping[str, tuple[RawColumn, str | None]], si: Mapping[str, str]) -> None:
    """Refuse the columns of gauge or of absolute pressures by their unit, all of one unit at once."""
    found = {n: unit for n, (_, unit) in named.items() if unit and si[n] == "Pa" and reference_of(unit)}
    for unit in found.values():
        names = [n for n, own in found.items() if own == unit]
        raise CraneError(
            f"{path}: {', '.join(names)} in [{unit}]: the crane file states the reference of pressures, not the unit. "
            f"{reference_mend(unit)}, below {' and again below '.join(f'[{n}]' for n in names)}."
        )


def _where_repeated(stamps: np.ndarray) -> str:
    """Return where times (n,) stand there once more, in words."""
    at = np.unique(stamps[1:][np.diff(stamps) == 0.0])
    return f"where the time stays at {at[0]:.6g} s" if len(at) == 1 else f"the first at {at[0]:.6g} s"


def _remark(header: str, name: str, unit: str | None, like: Sequence[str], layout: Layout) -> str:
    """Return what is told of a column that was ignored and may be one of some channels."""
    si = channel_names.of(layout)[like[0]]
    written = unit or (_written(si) if si else "")
    typed = _quoted(f"{like[0]}={name}" + (f"[{written}]" if written else ""))
    mean = f"did you mean {like[0]}? Then" if len(like) == 1 else f"it may be {' or '.join(like)}: if it is {like[0]},"
    return f"column {header!r} was ignored, {mean} give --map {typed}"


def _find(path: Path, table: RawTable, wanted: str, said: str) -> RawColumn:
    """Return the column that a mapping names: by its whole header, else by its name without unit."""
    whole = [c for c in table.columns if c.header.strip() == wanted.strip()]
    name = split_header(wanted)[0]
    found = whole or [c for c in table.columns if split_header(c.header)[0] == name]
    if len(found) == 1:
        return found[0]
    if found:
        raise CraneError(f"{path}: column {wanted!r} of {said} occurs {len(found)} times. Rename one.")
    headers = [split_header(c.header)[0] for c in table.columns]
    why = _left_out(table, name)
    raise CraneError(f"{path}: there is no column {name!r}, as {said} says.{why or nearest(name, headers)}")


def _left_out(table: RawTable, name: str) -> str:
    """Return why something of that name in the file makes no column; "" where there is nothing of it."""
    return next((f" The file's {note}." for note in table.notes if f" {name!r} " in note), "")


def _mapped_unit(path: Path, header: str, own: str | None, column: Column) -> str | None:
    given = split_header(column.header)[1]
    if column.unit is not None:
        return column.unit
    if own is not None and given is not None and own != given:
        overrule = (
            f'Leave the unit out there; or, if the file is wrong, write unit = "{given}" into a map file (--map-file), '
            "which takes precedence over the file"
        )
        raise CraneError(
            f"{path}, column {header}: the file says [{own}], {column.said} says [{given}]. "
            f"{reference_mend(own) if reference_of(own) else overrule}."
        )
    return own if given is None else given


def _clock_of(
    path: Path, column: tuple[RawColumn, str | None], clock: tuple[RawColumn, str | None] | None, table: RawTable
) -> tuple[RawColumn, str | None] | RawColumn:
    if column[0].clock is not None:
        return column[0].clock
    if clock is None:
        raise CraneError(
            f"{path}: there is no column time[s], found {_headers(table)}.{_left_out(table, 'time')} Add it, or give "
            "its name: --map time=Zeit[s]."
        )
    return clock


def _seconds(path: Path, clock: tuple[RawColumn, str | None] | RawColumn, table: RawTable) -> np.ndarray:
    """Return the times of a clock in s, finite and never going back."""
    column, unit = (clock, clock.unit or "s") if isinstance(clock, RawColumn) else clock
    with np.errstate(over="ignore"):  # what is infinite in s is refused below
        time = column.values * _factor(path, "time", column.header, unit, "s")
    bad = np.flatnonzero(~np.isfinite(time))
    if len(bad):
        raise CraneError(
            f"{path}, {table.place(bad[0])}, column {column.header}: the time is missing or not finite. Fill it in, or "
            "delete the line."
        )
    back = np.flatnonzero(np.diff(time) < 0.0)
    if len(back):
        row = int(back[0]) + 1
        raise CraneError(
            f"{path}, {table.place(row)}, column {column.header}: time {time[row]:.6g} s goes back from "
            f"{time[row - 1]:.6g} s, "
            "expected increasing times. Sort the samples."
        )
    leaps = np.flatnonzero(np.diff(time) > _DAY)
    if len(leaps):
        row = int(leaps[0]) + 1
        raise CraneError(
            f"{path}, {table.place(row)}, column {column.header}: time leaps from {time[row - 1]:.6g} s to "
            f"{time[row]:.6g} s, "
            "expected a continuous clock. Correct the clock or its unit, or delete the lines before or after the leap."
        )
    time.setflags(write=False)
    return np.asarray(time)


def _longest_stretch(channels: dict[str, Channel]) -> tuple[dict[str, Channel], list[str]]:
    """Return the channels between two long pauses of all of them, where most samples are, and what is left out."""
    stamps = np.unique(np.concatenate([c.time for c in channels.values()]))
    steps = np.diff(stamps)
    ends = np.flatnonzero((steps > _SPLIT) & (steps > _SPLIT_RATIO * np.median(steps)))
    if not len(ends):
        return channels, []
    stretches = np.split(stamps, ends + 1)
    kept = max(stretches, key=len)
    words = ", ".join(f"{s[0]:.6g} … {s[-1]:.6g} s" for s in stretches if s is not kept)
    inside = {name: (c.time >= kept[0]) & (c.time <= kept[-1]) for name, c in channels.items()}
    chosen = {
        n: Channel(c.time[inside[n]], c.values[inside[n]], c.unit) for n, c in channels.items() if inside[n].any()
    }
    return chosen, [
        f"pauses of more than {_SPLIT:g} s split the recording into {len(stretches)} stretches: the one from "
        f"{kept[0]:.6g} to {kept[-1]:.6g} s "
        f"is used, not {words}. Cut the file there to use them as separate recordings"
    ]


def _first_of_stamp(path: Path, header: str, time: np.ndarray, rows: np.ndarray, table: RawTable) -> np.ndarray:
    """Return the rows without those whose time stands there already: loggers repeat a sample now and then.

    Where many do, it is the time that has too few digits, and leaving samples out would falsify the recording.
    """
    again = np.concatenate([[False], np.diff(time[rows]) == 0.0])
    if again.sum() > _MOST_REPEATED * len(rows):
        row = int(rows[again][0])
        raise CraneError(
            f"{path}, {table.place(row)}, column {header}: time {time[row]:.6g} s is repeated, as {again.sum()} of "
            f"{len(rows)} "
            "times are, expected increasing times. Delete repeated samples, or give the time with more digits."
        )
    return np.asarray(rows[~again])


def _factor(path: Path, name: str, header: str, unit: str | None, si_unit: str) -> float:
    try:
        return factor_to_si(unit or "", si_unit)
    except CraneError as problem:
        raise CraneError(
            f"{path}, column {header}: {problem}, such as {name}[{_written(si_unit)}]. Correct the unit."
        ) from None


def _channel(
    path: Path,
    name: str,
    column: tuple[RawColumn, str | None],
    time: np.ndarray,
    table: RawTable,
    mapped: Column | None,
    layout: Layout,
) -> Channel | None:
    (raw, unit), si_unit = column, channel_names.of(layout)[name]
    if raw.values.shape != time.shape:
        raise CraneError(
            f"{path}, column {raw.header}: found {raw.values.size} samples, expected {time.size} as in its time. "
            f"Give it its own time column, or export it again."
        )
    with np.errstate(over="ignore"):  # what is infinite in SI is refused below
        values = raw.values * _factor(path, name, raw.header, unit, si_unit)
    if mapped is not None:
        values, time = mapped.factor * values + mapped.offset, mapped.stamped(time)
    there = ~np.isnan(values)
    infinite = np.flatnonzero(np.isinf(values))
    if len(infinite):
        raise CraneError(
            f"{path}, {table.place(infinite[0])}, column {raw.header}: found an infinite value. Leave it empty if it "
            "is missing."
        )
    if name in layout.commands:
        voltage = layout.voltages[layout.commands.index(name)]
        _check_command(path, raw, values, table, f"Write percent as {name}[%], and valve voltages as {voltage}[V].")
    if not there.any():
        return None
    rows = _first_of_stamp(path, raw.header, time, np.flatnonzero(there), table)
    if len(rows) == len(time):
        return Channel(time, values, si_unit)
    return Channel(time[rows], values[rows], si_unit)


def _check_command(path: Path, raw: RawColumn, values: np.ndarray, table: RawTable, mend: str) -> None:
    beyond = np.flatnonzero(np.abs(np.nan_to_num(values)) > channel_names.FULLY_OPEN)
    if len(beyond):
        raise CraneError(
            f"{path}, {table.place(beyond[0])}, column {raw.header}: found the command {values[beyond[0]]:g}, expected "
            f"-1 to 1. {mend}"
        )
