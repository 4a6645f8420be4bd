"""Channels that disagree with each other: those that are not what their names say, commands on another clock than the
sensors, and commands that stay closed while pistons move.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping

import numpy as np

from ..crane import Crane
from ..mapping import Column
from ..recording import Recording
from .balances import LONGEST, Figures, Grid, misfits, travels
from .clocks import Clock, clock_of, mended
from .corrections import reread, shifted, typed
from .findings import Finding, Severity
from .readings import Reading, Weighed, closer, mistaken

#: log by which another reading must be better to be reported
_SEEN = 0.9
#: log by which it must be better to be an error
_DECISIVE = 1.4
#: how often readings and clock are looked for in turn
_TURNS = 3
#: readings that a finding names as almost as likely
_RIVALS = 2
#: s by which motion may seem to come before its command; no error of a model makes more
_EARLY = 0.04
#: s of delay that several valves hardly have in common
_DELAYED = 0.1
#: s of delay that no valve has
_LONG = 0.6

_MISMATCHES = {
    "flow": "the mismatch between the flow into {} and the motion of its piston",
    "trapped": "the mismatch between {} and the motion of its piston while the valve is closed",
    "held": "the mismatch between the changes of the {} cylinder's force and of its load",
    "moment": "the mismatch between the {} cylinder's force and the weights",
    "length": "the mismatch between {} and the pose",
    "rate": "the mismatch between {} and the change of its angle",
    "sum": "the mismatch between {} and the sum of its angles",
    "reach": "the share of poses that the {} cylinder cannot reach",
}


def disagreements(recording: Recording, crane: Crane) -> list[Finding]:
    """Return the channels whose balances close only if they are read otherwise, and the commands that are late or
    dead.
    """
    grid = Grid.of(recording, crane)
    if grid is None:
        return []
    machine, columns = Figures(crane), {n: recording.columns.get(n, Column(n)) for n in recording.channels}
    found, clock = _readings_and_clock(machine, grid)
    chosen, findings = _chosen(found), list[Finding]()
    for rivals in found:
        finding = _misread(recording, crane, rivals[0], _almost_as_likely(rivals, chosen), columns)
        columns |= finding.columns
        findings.append(finding)
    findings += _clock(recording, crane, clock, columns)
    return [*findings, *_dead_commands(recording, crane, travels(machine, _read(grid, chosen)))]


def _readings_and_clock(machine: Figures, grid: Grid) -> tuple[list[list[Weighed]], Clock | None]:
    """Return the readings that a recording asks for, each with its rivals, and the clock of its commands.

    Where a machine goes to and fro, a command of the wrong sign looks like one of another time. So what seems to be a
    clock is held against readings on the clock as it was recorded.
    """
    first = clock_of(machine, grid)  # None: pistons do not follow commands before channels are read otherwise
    found = _in_turn(machine, grid, first)
    if first is None or np.max(np.abs(first.lateness(grid.time))) < _EARLY:
        return found
    other = _in_turn(machine, grid, None)
    told = (_on_clock(machine, _read(grid, _chosen(readings)), clock) for readings, clock in (found, other))
    apart = closer(*(misfits(machine, each) for each in told))
    return other if other[0] and apart > _SEEN else found


def _in_turn(machine: Figures, grid: Grid, clock: Clock | None) -> tuple[list[list[Weighed]], Clock | None]:
    """Return readings and clock, beginning with a clock.

    Readings are weighed on the commands' own clock. The clock is judged with the channels as they are read, because
    pistons seem far ahead of commands that belong to another one. So both are looked for in turn until they agree.
    """
    first, found = clock, list[list[Weighed]]()
    for _ in range(_TURNS):
        found = mistaken(machine, _on_clock(machine, grid, clock), _SEEN)
        if not found:
            return [], first
        before, clock = clock, clock_of(machine, _read(grid, _chosen(found)))
        if clock is None or (before is not None and before.apart(clock, grid.time) < _EARLY):
            break
    return found, clock


def _chosen(found: list[list[Weighed]]) -> list[Reading]:
    return [rivals[0].reading for rivals in found]


def _on_clock(machine: Figures, grid: Grid, clock: Clock | None) -> Grid:
    """Return the channels with the commands on a clock; None: as they were recorded."""
    return grid if clock is None else mended(grid, clock, machine.layout.commands)


def _read(grid: Grid, readings: Iterable[Reading]) -> Grid:
    """Return the channels under one reading after the other."""
    for reading in readings:
        grid = reading.of(grid)
    return grid


def _almost_as_likely(rivals: list[Weighed], chosen: list[Reading]) -> list[Reading]:
    """Return the readings of other channels that do as well as the first one and are not chosen, too."""
    own = set(rivals[0].reading.channels)
    return [w.reading for w in rivals[1:] if set(w.reading.channels) != own and w.reading not in chosen][:_RIVALS]


def _misread(
    recording: Recording, crane: Crane, best: Weighed, others: list[Reading], columns: Mapping[str, Column]
) -> Finding:
    """Return the finding about channels that are read otherwise, with the `others` that are almost as likely."""
    reading, ((balance, of), before, after) = best.reading, best.best
    names = _recorded(recording, crane, reading.channels)
    text = (
        f"{' and '.join(names)} agree{'s' * (len(names) == 1)} with the other channels only {reading.words}: "
        f"{_MISMATCHES[balance].format(of)} is then {after:.2g} instead of {before:.2g} (0: perfect agreement, 1: no "
        "relation)"
    )
    if others:
        rivals = [f"{' and '.join(_recorded(recording, crane, r.channels))} {r.words}" for r in others]
        text += f"; almost as likely: {' or '.join(rivals)}"
    severity: Severity = "error" if best.gain > _DECISIVE else "warning"
    fix, *other_fixes = (reread(r, columns, crane.layout) for r in (reading, *others))
    mend = "Correct the valves' calibration in the crane file, or the columns of the voltages."
    if fix:
        mend = " Or: ".join(typed(f, columns, crane.layout) for f in (fix, *other_fixes) if f)
    return Finding(reading.kind, names, severity, text, mend, fix)


def _clock(recording: Recording, crane: Crane, clock: Clock | None, columns: Mapping[str, Column]) -> Iterator[Finding]:
    """Find commands stamped after the motion or long before it, or by a clock that drifts; short delays are a valve's
    own.
    """
    if clock is None:
        return
    names = _recorded(recording, crane, crane.layout.commands)
    if clock.drift:
        gone = clock.drift * min(recording.duration, LONGEST)
        text = (
            f"the clock of {' and '.join(names)} and that of the sensors drift apart by {1e3 * abs(clock.drift):.2g} "
            f"ms per second, {abs(gone):.2g} s in total"
        )
        fix = shifted(columns, names, 0.5 * gone - float(np.nanmean(clock.late)), -clock.drift)
        yield Finding("clock", names, "error", text, typed(fix, columns, crane.layout), fix)
        return
    late = clock.late[~np.isnan(clock.late)]
    shift = float(late.min())  # a valve may delay, but nothing moves before its command
    if shift < -_EARLY or shift > (_DELAYED if len(late) > 1 else _LONG):
        words = "before the commands" if shift < 0.0 else "after the commands"
        severity: Severity = "error" if shift < -2.0 * _EARLY or shift > _LONG else "warning"
        text = f"{' and '.join(names)}: the machine moves {abs(shift):.2g} s {words}"
        fix = shifted(columns, names, -shift)
        delay = "" if shift < 0.0 else " Or the valves have a delay: see the effect command_delay."
        yield Finding("clock", names, severity, text, typed(fix, columns, crane.layout) + delay, fix)


def _dead_commands(recording: Recording, crane: Crane, travelled: Mapping[str, float]) -> Iterator[Finding]:
    """Find commands that stay closed while their pistons have `travelled` farther than a leak lets them (m)."""
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
    """Return channels as they were recorded: a command may have been recorded as a voltage."""
    voltage = dict(zip(crane.layout.commands, crane.layout.voltages, strict=True))
    return tuple(n if recording.has(n) else voltage.get(n, n) for n in names)
