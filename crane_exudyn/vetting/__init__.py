"""Whether a recording is what it says it is, as findings with their mend: what no crane can do, and what makes its
channels disagree.

    for finding in vet(recording, crane):
        print(finding.severity, finding.text, finding.mend)

What no crane can do is seen in single channels. Samples that were not measured at all (`signals.strays`: a glitch, a
value that stands for none) are told first, and the rest is looked at without them: a single spike is no wrong unit.
Whether a channel is another one, has another sign, unit, line of reference or clock is seen in the balances: it is
found where they close far better with it read otherwise (`readings`, `clocks`), which no wear of a machine makes them
do.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from itertools import permutations
from typing import Literal

import numpy as np

from ..channels import BEYOND, Channel
from ..channels import of as units_of
from ..crane import Crane
from ..errors import CraneError
from ..mapping import Column, keys_of
from ..recording import Recording
from ..signals import USUAL_SENSOR, Stray, noise_std, quantisation, sampling_rate, strays
from ..statics import vapour_pressure
from ..tables import split_header
from ..units import factor_to_si, unit_of
from .balances import LONGEST, PLAY, Figures, Grid, Misfit, reach, travels
from .clocks import Clock, clock_of, mended
from .readings import Reading, Weighed, mistaken

Severity = Literal["error", "warning", "note"]
Kind = Literal["sign", "swapped", "absolute", "scale", "offset", "clock", "pose", "noise", "saturation", "motion"]

_SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
#: pressures in Pa that a working crane stays between, most of the time; a chamber may stand at vapour pressure, but not
#: all the time
_LOW, _HIGH, _VACUUM = 0.1e5, BEYOND["Pa"], -0.5e5
#: by unit, sizes between which the usual largest reading lies
_LIKELY = {"rad": (0.01, math.pi), "m": (0.01, 10.0), "rad/s": (0.01, 2.0), "m/s": (0.001, 2.0)}
#: samples a second between which sensors of a crane are read
_SLOWEST_CLOCK, _FASTEST_CLOCK = 2.0, 2e5
#: Pa above vapour pressure that not even a gauge set too low shows, by how many standard deviations of noise, and
#: beside which a chamber may be empty
_LOWEST, _UNLIKELY, _EMPTY = -1.5e5, 8.0, 1.2e5
#: share of the noise's sum of squares that outliers add to be an error; outliers whose times are told
_SPOILT, _TOLD = 0.1, 5
#: how many poses are looked at, and the share of them beyond reach that is no longer an outlier
_POSES, _SHARE = 400, 0.05
#: logs by which another reading must be better to be told, and to be decisive; how often readings and clock are looked
#: for in turn
_SEEN, _DECISIVE, _TURNS = 0.9, 1.4, 3
#: s: motion before its command that no error of a model makes, delays that two valves have not, or hardly, and that no
#: valve has
_EARLY, _DELAYED, _LONG = 0.04, 0.1, 0.6
#: share of samples that stay at a limit beyond which a channel is cut off, where of the others not so many stay
_CUT, _KEPT = 0.01, 0.2
#: share of what a channel shows that makes a step coarse
_COARSE = 0.01
#: a spool command above this opens a valve enough to be felt
OPEN = 0.05
#: s in which a machine does not ring; correlation of neighbouring samples from which noise is not white; share of it
#: that must be seen where no machine rings
_RING, _ALIKE, _FALLS = 0.1, 0.5, 0.3
#: s at the beginning, and the s after them, in which nothing should move faster than so many rad/s, and so many times
#: more than its samples scatter
_FIRST, _MOVES, _MOVED = 0.3, 0.04, 6.0
#: units that a column is likely to be in, whatever it says, the likeliest first
_WRITTEN = {
    "Pa": ("bar", "MPa", "Pa", "kPa", "psi"),
    "rad": ("deg", "rad", "mrad"),
    "rad/s": ("deg/s", "rad/s"),
    "m": ("mm", "m", "cm"),
    "m/s": ("mm/s", "m/s"),
}
#: names that a message tells of many
_NAMED = 4


@dataclass(frozen=True, eq=False)
class Finding:
    """Something about a recording: what kind, which channels, how bad, what was found and how to mend it.

    "error" is what cannot be true, "warning" what is hardly so, "note" what a reader should know. `columns`: what its
    channels are to be read from, where that mends it.
    """

    kind: Kind
    channels: tuple[str, ...]
    severity: Severity
    text: str
    mend: str
    columns: Mapping[str, Column] = field(default_factory=dict, repr=False)


def vet(recording: Recording, crane: Crane) -> list[Finding]:
    """Return what is implausible about a recording of a crane, worst first; empty for a sound one."""
    measured, astray = _without_strays(recording, crane)
    mistaken = _disagreements(measured, crane)
    told = {n for f in mistaken for n in f.channels}
    kept = [
        f for f in _looks(measured, crane) if not told.intersection(f.channels)
    ]  # what a channel is, says more than that it cannot be
    return worst_first([*astray, *mistaken, *kept])


def contents(recording: Recording, crane: Crane) -> list[Finding]:
    """Return what cannot be true of single channels, or hardly, worst first; in well under a second."""
    measured, astray = _without_strays(recording, crane)
    return worst_first([*astray, *_looks(measured, crane)])


def _looks(recording: Recording, crane: Crane) -> list[Finding]:
    looks = (
        _of_another_crane,
        _pressures,
        _supply,
        _motion,
        _lengths,
        _poses,
        _clock,
        _saturation,
        _steps,
        _noise,
        _start,
    )
    found: list[Finding] = []
    for finding in (f for look in looks for f in look(recording, crane)):
        wrong = {n for f in found if f.severity == "error" for n in f.channels}
        if not wrong.intersection(finding.channels):  # one reason is enough
            found.append(finding)
    return found


def worst_first(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings by their severity, those of one as they come."""
    return sorted(findings, key=lambda f: _SEVERITIES.index(f.severity))


def vetted(recording: Recording, crane: Crane) -> Recording:
    """Return the recording with notes on what is hardly plausible about its contents; one that was accepted before as
    it is.

    Raises:
        CraneError: something in it cannot be true; all such findings, each with its mend.
    """
    return recording if recording.vouched else accepted(recording, contents(recording, crane))


def accepted(recording: Recording, findings: Iterable[Finding], *, anyway: bool = False) -> Recording:
    """Return the recording with its findings as notes.

    Raises:
        CraneError: some are errors, and it is not to be used anyway.
    """
    told = {f: f"{f.text}. {f.mend}" for f in findings}
    errors = [text for f, text in told.items() if f.severity == "error"]
    if errors and not anyway:
        raise CraneError(f"{recording.source or recording.name}: {' '.join(errors)}")
    return replace(recording, notes=(*recording.notes, *(t.removesuffix(".") for t in told.values())), vouched=True)


def mended_columns(recording: Recording, findings: Iterable[Finding]) -> dict[str, Column]:
    """Return what each channel is to be read from, with all mends of the findings; a column that became another channel
    is no longer its old one.
    """
    fixed = {n: c for f in findings for n, c in f.columns.items()}
    taken = {c.header for c in fixed.values()}
    return {n: c for n, c in recording.columns.items() if c.header not in taken} | fixed


# -- what the channels say of each other -------------------------------------------------------------------------------


def _disagreements(recording: Recording, crane: Crane) -> list[Finding]:
    """Return which channels are not what they are said to be, by the balances that close only if they are something
    else.
    """
    grid = Grid.of(recording, crane)
    if grid is None:
        return []
    machine, columns = Figures(crane), {n: recording.columns.get(n, Column(n)) for n in recording.channels}
    found, clock = _readings(machine, grid)
    chosen = [rivals[0].reading for rivals in found]
    return [
        *(_of_reading(recording, crane, rivals, chosen, columns) for rivals in found),
        *_of_clock(recording, crane, clock, columns),
        *_of_dead_commands(recording, crane, travels(machine, _read(grid, found))),
    ]


def _readings(machine: Figures, grid: Grid) -> tuple[list[list[Weighed]], Clock | None]:
    """Return the readings that a recording asks for, each with its rivals, and the clock of its commands.

    Readings are weighed on the commands' own clock, and that is judged with the channels as they are read: pistons seem
    to be far ahead of commands that are another's. So both are looked for in turn until they agree.
    """
    first = clock = clock_of(machine, grid)  # None: pistons do not follow commands before the channels are others
    found: list[list[Weighed]] = []
    for _ in range(_TURNS):
        timed = grid if clock is None else mended(grid, clock, machine.layout.commands)
        found, _ = mistaken(machine, timed, _SEEN)
        if not found:
            return [], first
        before, clock = clock, clock_of(machine, _read(grid, found))
        if clock is None or (before is not None and before.apart(clock, grid.time) < _EARLY):
            break
    return found, clock


def _read(grid: Grid, found: list[list[Weighed]]) -> Grid:
    """Return the channels as all that was found reads them."""
    for rivals in found:
        grid = rivals[0].reading.of(grid)
    return grid


def _of_reading(
    recording: Recording, crane: Crane, rivals: list[Weighed], chosen: list[Reading], columns: dict[str, Column]
) -> Finding:
    """Return the finding of a reading, with those that would do as well and are not chosen, too; what its channels are
    read from is changed in `columns`.
    """
    reading = rivals[0].reading
    (balance, of), before, after = rivals[0].best
    names = _recorded(recording, crane, reading.channels)
    others = [
        w.reading for w in rivals[1:] if set(w.reading.channels) != set(reading.channels) and w.reading not in chosen
    ][:2]
    text = (
        f"{' and '.join(names)} agree{'s' * (len(names) == 1)} with the other channels only {reading.words}: "
        f"{_BALANCES[balance].format(of)} is then {after:.2g} instead of {before:.2g} (0: perfect agreement, 1: no "
        "relation)"
    )
    if others:
        rival = [f"{' and '.join(_recorded(recording, crane, r.channels))} {r.words}" for r in others]
        text += f"; almost as likely: {' or '.join(rival)}"
    severity: Severity = "error" if rivals[0].gain > _DECISIVE else "warning"
    fix = _columns_of(crane, reading, columns)
    if not fix:
        mend = "Correct the valves' calibration in the crane file, or the columns of the voltages."
        return Finding(reading.kind, names, severity, text, mend)
    tried = (fix, *(_columns_of(crane, r, columns) for r in others))
    mend = " Or: ".join(_typed(crane, columns, c) for c in tried if c)
    columns |= fix
    return Finding(reading.kind, names, severity, text, mend, fix)


def _columns_of(crane: Crane, reading: Reading, columns: Mapping[str, Column]) -> dict[str, Column]:
    """Return what channels are read from under a reading; nothing where it is of commands that were recorded as
    voltages.
    """
    if any(s.channel not in columns for s in reading.made.values()):
        return {}
    units = units_of(crane.layout)
    return {name: _rescaled(columns[s.channel], s.factor, s.offset, units[name]) for name, s in reading.made.items()}


def _rescaled(column: Column, factor: float, offset: float, si: str) -> Column:
    """Return a column whose channel is a factor times what it was, and an offset in SI; in another unit, where the
    factor is that of one.
    """
    same = column.unit is None or abs(factor) == 1.0
    unit = None if same else unit_of(abs(factor) * factor_to_si(column.unit or "", si), si)
    if unit is None:
        return replace(column, factor=factor * column.factor, offset=factor * column.offset + offset)
    turned = math.copysign(1.0, factor) * column.factor
    return replace(column, unit=unit, factor=turned, offset=factor * column.offset + offset)


_BALANCES = {
    "flow": "the mismatch between the flow into {} and the motion of its piston",
    "trapped": "the mismatch between {} and the motion of its piston while the valve is closed",
    "held": "the mismatch between the changes of the {} cylinder's force and of its load",
    "moment": "the mismatch between the {} cylinder's force and the weights",
    "length": "the mismatch between {} and the pose",
    "rate": "the mismatch between {} and the change of its angle",
    "sum": "the mismatch between {} and the sum of its angles",
    "reach": "the share of poses that the {} cylinder cannot reach",
}


def _of_clock(
    recording: Recording, crane: Crane, clock: Clock | None, columns: Mapping[str, Column]
) -> Iterator[Finding]:
    """Find commands that come after the motion, long before it, or from a clock that drifts; short delays are a valve's
    own.
    """
    if clock is None:
        return
    commands = crane.layout.commands
    if clock.drift:
        names, gone = _recorded(recording, crane, commands), clock.drift * min(recording.duration, LONGEST)
        text = (
            f"the clock of {' and '.join(names)} and that of the sensors drift apart by {1e3 * abs(clock.drift):.2g} "
            f"ms per second, {abs(gone):.2g} s in total"
        )
        late = -float(np.nanmean(clock.late)) + 0.5 * gone
        fix = _shifted(columns, names, late, -clock.drift)
        yield Finding("clock", names, "error", text, _typed(crane, columns, fix), fix)
        return
    told = clock.late[~np.isnan(clock.late)]
    shift = float(told.min())  # a valve may delay, but nothing moves before its command
    if shift < -_EARLY or shift > (_DELAYED if len(told) > 1 else _LONG):
        names = _recorded(recording, crane, commands)
        words = "before the commands" if shift < 0.0 else "after the commands"
        severity: Severity = "error" if shift < -2.0 * _EARLY or shift > _LONG else "warning"
        text = f"{' and '.join(names)}: the machine moves {abs(shift):.2g} s {words}"
        fix = _shifted(columns, names, -shift)
        delay = "" if shift < 0.0 else " Or the valves have a delay: see the effect command_delay."
        yield Finding("clock", names, severity, text, _typed(crane, columns, fix) + delay, fix)


def _shifted(columns: Mapping[str, Column], names: Iterable[str], late: float, drift: float = 0.0) -> dict[str, Column]:
    """Return columns whose stamps come so much later after their events, and drift so much more, than they were said
    to.
    """
    return {n: replace(columns[n], late=columns[n].late + late, drift=columns[n].drift + drift) for n in names}


def _of_dead_commands(recording: Recording, crane: Crane, travelled: Mapping[str, float]) -> Iterator[Finding]:
    """Find valves whose commands stay closed while their pistons move as no leakage lets them."""
    commands = dict(zip(crane.layout.cylinders, crane.layout.commands, strict=True))
    dead = tuple(dict.fromkeys(_recorded(recording, crane, (commands[c] for c in travelled))))
    if dead:
        ways = " and ".join(f"{1e3 * way:.3g} mm" for way in travelled.values())
        several = len(dead) > 1
        text = (
            f"the {' and the '.join(travelled)} cylinder{'s' * several} move{'s' * (not several)} by {ways}, but "
            f"{'their valves are' if several else 'its valve is'} never commanded: {' and '.join(dead)} "
            f"{'are' if several else 'is'} dead (not connected, or not logged)"
        )
        yield Finding("motion", dead, "error", text, "Record the commands, or correct their columns.")


def _recorded(recording: Recording, crane: Crane, names: Iterable[str]) -> tuple[str, ...]:
    """Return the channels that were recorded, voltages for the commands that they stand for."""
    voltage = dict(zip(crane.layout.commands, crane.layout.voltages, strict=True))
    return tuple(n if recording.has(n) else voltage.get(n, n) for n in names)


def _typed(crane: Crane, was: Mapping[str, Column], fix: Mapping[str, Column]) -> str:
    """Return what to type: options where they can say it, else the keys of a map file that change."""
    told = {n: _option(n, c, units_of(crane.layout)[n]) for n, c in fix.items()}
    if all(told.values()):
        return f"Type {' '.join(f'--map {option}' for option in told.values())}."
    changed: dict[str, list[str]] = {}
    for n, c in fix.items():
        si = units_of(crane.layout)[n]
        old, new = keys_of(was.get(n, Column(n)), si), keys_of(c, si)
        changes = [f"{key} = {value}" for key, value in new.items() if old.get(key) != value]
        changes += [f"no {key}" for key in old if key not in new]
        changed.setdefault(" and ".join(changes), []).append(f"[{n}]")
    lines = "; ".join(f"{changes} for {', '.join(names)}" for changes, names in changed.items())
    return f"Let `patu check --write-map FILE` write a map file (for --map-file): {lines}."


def _option(name: str, column: Column, si: str) -> str:
    """Return what `--map` takes where it can say all of a column, else ""."""
    header, written = split_header(column.header)
    plain = column.offset == column.late == column.drift == 0.0 and abs(column.factor) == 1.0
    if not plain or (written is not None and column.unit is not None and written != column.unit):
        return ""
    unit = f"[{column.unit}]" if written is None and column.unit and si else ""
    return f"{name}={'-' if column.factor < 0.0 else ''}{header}{unit}"


# -- samples that were not measured ----------------------------------------------------------------------------------


def _without_strays(recording: Recording, crane: Crane) -> tuple[Recording, list[Finding]]:
    """Return the recording without the samples that were not measured, and what is told of these."""
    channels, found = dict(recording.channels), list[Finding]()
    for name in (n for n in (*recording.sensors, *crane.layout.supply) if recording.has(n)):
        channel, unit = recording[name], units_of(recording.layout)[name]
        noise = noise_std(channel.values)
        impossible = np.abs(channel.values) > BEYOND[unit]
        if unit == "Pa":
            impossible |= channel.values < vapour_pressure(crane) + _LOWEST - _UNLIKELY * noise
        astray = strays(channel.time, channel.values, impossible, BEYOND.get(f"{unit}/s", math.inf), noise)
        if astray:
            gone = np.concatenate([np.arange(s.first, s.after) for s in astray])
            channels[name] = Channel(np.delete(channel.time, gone), np.delete(channel.values, gone), channel.unit)
            found += _of_fills(recording, crane, name, [s for s in astray if s.filled])
            usual = max(noise, USUAL_SENSOR * float(np.subtract(*_usual(channels[name])[::-1])))
            found += _of_outliers(recording, name, [s for s in astray if not s.filled], usual)
    return (replace(recording, channels=channels), found) if found else (recording, [])


def _of_fills(recording: Recording, crane: Crane, name: str, filled: list[Stray]) -> Iterator[Finding]:
    """Find values that stand in a channel for none."""
    counts: dict[float, int] = {}
    for s in filled:
        value = float(recording[name].values[s.first])
        counts[value] = counts.get(value, 0) + s.after - s.first
    for value, count in counts.items():
        gauge = units_of(recording.layout)[name] == "Pa"
        empty = gauge and abs(value - vapour_pressure(crane)) < _EMPTY  # where a gauge may be cut off
        text = (
            f"{count} samples of {name} are exactly {_as_written(recording, name, value)}, which looks like a fill "
            'value for "no value"'
        )
        yield Finding("noise", (name,), "warning" if empty else "error", text, "Leave these fields empty.")


def _of_outliers(recording: Recording, name: str, outliers: list[Stray], usual: float) -> Iterator[Finding]:
    """Find samples that leap away and back; an error where they add clearly to what noise of `usual` leaves of a right
    model.
    """
    if not outliers:
        return
    channel, worst = recording[name], max(outliers, key=lambda s: s.height)
    count, when = sum(s.after - s.first for s in outliers), [f"{channel.time[s.first]:.6g}" for s in outliers]
    more = f" and {len(when) - _TOLD} more" if len(when) > _TOLD else ""
    beside = [channel.values[k] for k in (worst.first - 1, worst.after) if 0 <= k < len(channel)]
    text = (
        f"{name} has {count} outlier{'s' * (count > 1)} at t = {', '.join(when[:_TOLD])} s{more}: "
        f"{_as_written(recording, name, channel.values[worst.first])} next to "
        f"{' and '.join(_as_written(recording, name, v) for v in beside)}"
    )
    added = sum((s.after - s.first) * (s.height / usual) ** 2 for s in outliers)
    severity: Severity = "error" if added > _SPOILT * len(channel) else "warning"
    yield Finding("noise", (name,), severity, text, f"Leave {'these fields' if count > 1 else 'the field'} empty.")


def _as_written(recording: Recording, name: str, value: float) -> str:
    """Return a value in SI as it stands in the file, with its unit."""
    column, si = recording.columns.get(name, Column(name)), units_of(recording.layout)[name]
    unit = column.unit or si
    return f"{(value - column.offset) / column.factor / factor_to_si(unit, si):.6g} {unit}"


# -- one look each ---------------------------------------------------------------------------------------------------


def _usual(channel: Channel) -> tuple[float, float]:
    """Return the values (low, high) between which a channel is nearly all the time."""
    low, high = np.quantile(channel.values, [0.01, 0.99])
    return float(low), float(high)


def _of_another_crane(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find files of which most columns are no channels of the crane, and none shows how it stands: by chance some have
    the names of its own.
    """
    lay, ignored = crane.layout, recording.ignored
    poses = (*lay.coordinates, *(f"{n}_abs" for n in lay.coordinates), *lay.lengths)
    if len(ignored) > len(recording.channels) and not any(map(recording.has, poses)):
        named = ", ".join(ignored[:_NAMED]) + ", …" * (len(ignored) > _NAMED)
        text = (
            f"{len(ignored)} of {len(ignored) + len(recording.channels)} columns ({named}) are not channels of "
            f"{crane.name}, and none of {', '.join(lay.coordinates)} is there"
        )
        yield Finding("pose", (), "warning", text, "If it is another crane, give its file with --crane.")


def _mistaken(recording: Recording, name: str, value: float, low: float, high: float) -> str:
    """Return the mend of a channel one of whose values would lie between low and high in another unit, or the advice to
    leave it out.
    """
    unit = units_of(recording.layout)[name]
    stated = (recording.columns[name].unit if name in recording.columns else None) or unit
    # numbers in SI may have been converted before they came here, from any unit
    for given in [stated] if stated != unit else dict.fromkeys([unit, *_WRITTEN[unit]]):
        for was in _WRITTEN[unit]:
            if was != given and low < factor_to_si(was, unit) / factor_to_si(given, unit) * value < high:
                return f"The values look like {was} recorded as {given}: write the unit as {name}[{was}]."
    return "Correct its unit, or leave the channel out."


def _people(unit: str) -> tuple[float, str]:
    """Return the unit in which people read coordinates and rates of a SI unit, behind what one of the latter is in
    it.
    """
    return (math.degrees(1.0), "deg") if unit == "rad" else (1.0, unit)


def _is_constant(channel: Channel) -> bool:
    return bool(np.ptp(channel.values) == 0.0)


def _pressures(recording: Recording, crane: Crane) -> Iterator[Finding]:
    lay, floor = crane.layout, vapour_pressure(crane)
    absolute = crane["supply.pressure_reference"] == 0.0
    expected = "absolute pressures, which are never negative" if absolute else f"at least {floor / 1e5:.3g} bar, vacuum"
    for name in (n for n in recording.channels if n in (*lay.chambers, lay.supply[0])):
        low, high = _usual(recording[name])
        if _is_constant(recording[name]) and high == 0.0:  # a sensor that is not connected, told elsewhere
            continue
        # a noisy sensor of a boiling chamber reads below nothing; in a wrong unit, by any number
        if high < _HIGH and low < floor + _VACUUM - 3.0 * noise_std(recording[name].values):
            text = f"{name} falls to {low / 1e5:.3g} bar, expected {expected}"
            severity: Severity = "error" if np.median(recording[name].values) < floor else "warning"
            yield Finding(
                "offset", (name,), severity, text, "Correct its zero point or its sign; add 1 bar to a gauge pressure."
            )
        elif not floor + _LOW < high < _HIGH:
            limit = "never exceeds" if high <= floor + _LOW else "reaches"
            text = (
                f"{name} {limit} {high / 1e5:.3g} bar, expected a pressure of a crane whose pump gives "
                f"{crane['supply.pump_pressure'] / 1e5:.3g} bar"
            )
            mend = _mistaken(recording, name, high, 10.0 * _LOW, 4.0 * crane["supply.pump_pressure"])
            yield Finding("scale", (name,), "error", text, mend)


def _supply(recording: Recording, crane: Crane) -> Iterator[Finding]:
    names = crane.layout.supply
    pump, tank = (
        float(np.median(recording[n].values)) if recording.has(n) else crane[f"supply.{word}_pressure"]
        for n, word in zip(names, ("pump", "tank"), strict=True)
    )
    if any(map(recording.has, names)) and pump <= tank:
        told = [f"the {word} ({p / 1e5:.3g} bar)" for word, p in (("pump", pump), ("tank", tank))]
        mend = f"Swap {' and '.join(names)}, or correct their units."
        yield Finding("swapped", names, "error", f"{told[0]} is below {told[1]}, so nothing could move", mend)


def _motion(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find coordinates and rates that are larger than those of any crane."""
    for name in (n for n in recording.sensors if n not in (*crane.layout.chambers, *crane.layout.lengths)):
        unit = crane.layout.sensors[name].unit
        most = max(map(abs, _usual(recording[name])))
        if most > BEYOND[unit]:
            factor, people = _people(unit)
            text = (
                f"{name} reaches {factor * most:.3g} {people}, expected less than {factor * BEYOND[unit]:.3g} {people}"
            )
            yield Finding("scale", (name,), "error", text, _mistaken(recording, name, most, *_LIKELY[unit]))


def _lengths(recording: Recording, crane: Crane) -> Iterator[Finding]:
    for c, name in enumerate(crane.layout.lengths):
        if not recording.has(name):
            continue
        low, high = _usual(recording[name])
        shortest, longest = crane.stroke(crane.layout.cylinders[c])
        if low < shortest - PLAY or high > longest + PLAY:
            text = (
                f"{name} goes from {low:.4g} to {high:.4g} m, expected {shortest:.4g} to {longest:.4g} m, "
                f"the {crane.layout.cylinders[c]} cylinder from pin to pin"
            )
            if low > -PLAY and high < longest - shortest + PLAY:
                mend = f"If it is the stroke, add the empty length of {shortest:.4g} m."
            else:
                mend = _mistaken(recording, name, 0.5 * (low + high), shortest, longest)
            yield Finding("scale", (name,), "error", text, mend)


def _poses(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find coordinates that the linkage or the stroke of the cylinder that drives them does not reach."""
    lay, machine, grid = crane.layout, Figures(crane), _turns(recording, crane)
    for cylinder, name in zip(lay.cylinders, lay.driven, strict=True):
        share = _beyond(machine, grid, cylinder)
        if name in grid.channels and share > _SHARE:
            factor, people = _people(lay.unit_of(name))
            low, high = factor * np.array(_usual(recording[name]))
            text = (
                f"{name} goes from {low:.4g} to {high:.4g} {people}; in {100 * share:.0f} % of the samples this is "
                f"beyond the reach of the {cylinder} cylinder's stroke and linkage"
            )
            severity: Severity = "error" if share > 0.5 else "warning"
            yield Finding("pose", (name,), severity, text, _other_coordinate(machine, grid, name, cylinder))


def _turns(recording: Recording, crane: Crane) -> Grid:
    """Return the coordinates of a recording, as they were recorded and where they can be true, at a few instants."""
    lay = crane.layout
    shown = {n: sensor.unit for n, sensor in lay.sensors.items() if n.removesuffix("_abs") in lay.coordinates}
    there = ((n, recording[n], unit) for n, unit in shown.items() if recording.has(n))
    known = {n: channel for n, channel, unit in there if max(map(abs, _usual(channel))) <= BEYOND[unit]}
    first, last = (f((c.time[k] for c in known.values()), default=0.0) for f, k in ((max, 0), (min, -1)))
    time = np.linspace(first, last, _POSES)
    return Grid(time, {n: c.held(time) for n, c in known.items()}, {})


def _beyond(machine: Figures, grid: Grid, cylinder: str) -> float:
    """Return the share of instants at which a cylinder or a loop does not reach the pose; 0 where that is not known."""
    return reach(machine, grid).get(("reach", cylinder), Misfit(0.0)).off


def _other_coordinate(machine: Figures, grid: Grid, name: str, cylinder: str) -> str:
    """Return what would bring a coordinate into reach: another sign, unit, or the horizontal as the line it is measured
    against.
    """
    lay, shown = machine.layout, grid.channels[name]
    sizes = {unit: factor_to_si(unit, lay.unit_of(name)) for unit in _WRITTEN[lay.unit_of(name)][:2]}
    others = {"with the opposite sign": -shown} | {
        f"in {was} instead of {given}": sizes[was] / sizes[given] * shown for was, given in permutations(sizes, 2)
    }
    for words, values in others.items():
        if _beyond(machine, replace(grid, channels={**grid.channels, name: values}), cylinder) <= _SHARE:
            return f"It would fit {words}. Correct the column. If it is another crane, give its file with --crane."
    absolute = {n: values for n, values in grid.channels.items() if n != name} | {f"{name}_abs": shown}
    carried = lay.carriers(name) and absolute.keys() >= set(lay.carriers(name))
    if carried and _beyond(machine, replace(grid, channels=absolute), cylinder) <= _SHARE:
        return f"It would fit as the angle relative to the horizontal: name the column {name}_abs."
    return f"Correct the zero point of {name}. If it is another crane, give its file with --crane."


def _clock(recording: Recording, crane: Crane) -> Iterator[Finding]:
    if not recording.sensors:
        return
    rate = max(sampling_rate(recording[n].time) for n in recording.sensors)
    if not _SLOWEST_CLOCK <= rate <= _FASTEST_CLOCK:
        text = (
            f"the sensors are read {rate:.3g} times a second, expected {_SLOWEST_CLOCK:g} to {_FASTEST_CLOCK:g} times"
        )
        unit = "ms" if rate < _SLOWEST_CLOCK else "s"
        mend = f"If the time is in {unit}, write time[{unit}]."
        yield Finding("clock", ("time",), "error", text, mend)


# -- what a sensor and its logger make of a channel -------------------------------------------------------------------


def _saturation(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find channels that are cut off: they keep exactly their largest or smallest value, and no other."""
    free = recording.noise_free()
    for name in (n for n in recording.sensors if n not in free and not _is_constant(recording[n])):
        values, unit = recording[name].values, recording[name].unit
        kept = values[1:] == values[:-1]
        for limit, word in ((values.max(), "largest"), (values.min(), "smallest")):
            there = values[1:] == limit
            cut = (kept & there).mean() > _CUT and (there.all() or kept[~there].mean() < _KEPT)
            if cut and not (unit == "Pa" and limit <= vapour_pressure(crane)):
                text = (
                    f"{name} is at its {word} value {limit:.4g} {unit} in {100 * there.mean():.0f} % of its "
                    "samples: "
                    "it is cut off, frozen or not connected"
                )
                yield Finding("saturation", (name,), "warning", text, "Correct its range, or leave the channel out.")


def _steps(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find channels whose steps are coarse beside what they show; too few samples show no finer ones."""
    for name in recording.sensors:
        values = recording[name].values
        step, span = quantisation(values), float(np.ptp(values))
        if span > 0.0 and step > _COARSE * span and len(values) > 1.0 / _COARSE:
            text = f"{name} comes in steps of {step:.3g} {recording[name].unit}, {100 * step / span:.2g} % of its range"
            yield Finding("noise", (name,), "note", text, "Record it with more digits, or with a suitable range.")


def _noise(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find sensors whose noise is not white: neighbouring samples err alike, as those of loggers that smooth do, or of
    hum; also above all that a machine rings with.
    """
    free = recording.noise_free()
    for name in (n for n in recording.sensors if n not in free):
        channel = recording[name]
        wide = 1 + 2 * round(0.5 * _RING * sampling_rate(channel.time))
        if wide < 6 or len(channel) < 10 * wide:
            continue
        alike = _alike(channel.values, wide)
        if alike > _ALIKE and _falls(channel.values, sampling_rate(channel.time)) > _FALLS:
            text = f"the noise of {name} is not white: neighbouring samples are correlated by {alike:.2g}"
            mend = "Switch off smoothing in the logger, or write the sensor's noise into [sensors] of the crane file."
            yield Finding("noise", (name,), "note", text, mend)


def _alike(values: np.ndarray, wide: int) -> float:
    """Return the correlation of neighbouring samples about their mean over so many, in the quietest quarter of the
    recording.
    """
    fast = (values - np.convolve(values, np.full(wide, 1.0 / wide), "same"))[wide:-wide]
    parts = [p for p in np.array_split(fast, max(4, len(fast) // (4 * wide))) if p.std() > 0.0]
    quiet = sorted(parts, key=lambda p: float(p.std()))[: max(1, len(parts) // 4)]
    return float(np.median([p[1:] @ p[:-1] / (p @ p) for p in quiet])) if quiet else 0.0


def _falls(values: np.ndarray, rate: float) -> float:
    """Return how far the power of what a channel shows falls above all frequencies that a machine rings with: 0 where
    it is even, as that of white noise; 1 where nothing is left but at the lowest of them; 0 where samples are too rare.

    Power is that of a second, in the quietest quarter of them.
    """
    n = 2 * max(16, round(0.5 * rate))
    frequency = np.fft.rfftfreq(n, 1.0 / rate)
    chosen = (frequency >= 1.0 / _RING) & (frequency < 0.499 * rate)
    if chosen.sum() < 4 or len(values) < 4 * n:
        return 0.0
    parts = np.lib.stride_tricks.sliding_window_view(values, n)[:: n // 2]
    time = np.arange(n) - 0.5 * (n - 1)
    parts = parts - parts.mean(axis=1, keepdims=True) - np.outer(parts @ time / (time @ time), time)
    power = np.quantile(np.abs(np.fft.rfft(parts * np.hanning(n), axis=1)) ** 2, 0.25, axis=0)[chosen]
    turns = np.cos(2.0 * np.pi * frequency[chosen] / rate)  # what a sample has of the one before
    return float((power @ turns / max(power.sum(), 1e-300) - turns.mean()) / (turns.max() - turns.mean()))


def _start(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find a recording that begins in motion, whose start can hardly be told."""
    mend = "Cut the recording so that it starts at rest, or record a second of rest first."
    opened = [n for n in (*crane.layout.commands,) if recording.has(n) and abs(recording[n].values[0]) > OPEN]
    if opened:
        text = f"{' and '.join(opened)}: the recording starts with an open valve"
        yield Finding("motion", tuple(opened), "warning", text, mend)
    moving = tuple(n for n in crane.layout.coordinates if recording.has(n) and _begins_moving(recording[n]))
    if moving and not opened:
        yield Finding("motion", moving, "warning", f"{' and '.join(moving)} in motion from the first sample on", mend)


def _begins_moving(channel: Channel) -> bool:
    """Whether an angle changes clearly and fast within its first moments, and goes on so."""
    after = channel.time - channel.time[0]
    rates = [_rate(channel, (after >= a) & (after < a + _FIRST)) for a in (0.0, _FIRST)]
    return all(abs(rate) > _MOVES for rate in rates) and rates[0] * rates[1] > 0.0


def _rate(channel: Channel, chosen: np.ndarray) -> float:
    """Return the rate of a channel over some samples, 0 where it is not well above what they scatter by."""
    t, values = channel.time[chosen], channel.values[chosen]
    if len(t) < 5:
        return 0.0
    slope, offset = np.polyfit(t - t[0], values, 1)
    scatter = float(np.std(values - slope * (t - t[0]) - offset)) * math.sqrt(12.0 / len(t)) / _FIRST
    return float(slope) if abs(slope) > _MOVED * scatter else 0.0
