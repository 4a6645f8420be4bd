"""Whether a recording can bear what is asked of it: the checks that come before any comparison or diagnosis, and all
that `patu check` tells.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import combinations
from typing import Literal

import numpy as np

from crane_exudyn.channels import OPEN, Channel
from crane_exudyn.crane import Crane
from crane_exudyn.display import engineering
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.signals import USUAL_SENSOR, noise_std
from crane_exudyn.vetting import vet, vetted
from crane_exudyn.vetting.findings import Finding, accepted, blamed, worst_first
from crane_exudyn.vetting.quality import boils

from .fit.data import constant_sensors, is_constant

Purpose = Literal["compare", "diagnose"]

#: shortest recording, s; a spool alone needs a tenth of that to open
SHORTEST = 1.0
#: samples of a channel that are too few
_FEWEST = 10
#: a channel that stands at its extreme for more than this share of the time is saturated
_STUCK_SHARE = 0.5
#: seconds of closed valves in which slow errors of a sensor are looked for, and by how much they must exceed its white
#: noise
_REST, _WAVERS = 0.25, 1.5
#: seconds with an open valve that a sound sensor does not sit through without the slightest change
_STUCK_SECONDS = 0.3


def examine(recording: Recording, crane: Crane) -> list[Finding]:
    """Return all that speaks against a recording, worst first: what is implausible about it (`crane_exudyn.vetting`),
    what no comparison takes, and as notes what is left out of one and what no diagnosis takes.
    """
    found = vet(recording, crane)
    wrong = blamed(found)
    found += [f for f in unfit(recording, crane) if not wrong.intersection(f.channels)]
    cut_off = blamed(f for f in found if f.kind == "saturation")
    found = [f for f in found if f.severity == "error" or f.kind != "saturation" or not cut_off & set(f.channels)]
    if not blamed(found):
        found += [
            replace(f, severity="note", text=f"`patu diagnose` will refuse it: {f.text}")
            for f in unfit(recording, crane, "diagnose")
        ]
        dead, mend = constant_sensors(recording, crane.sensors), "Check that it was connected."
        found += [Finding("saturation", (n,), "note", _left_out(n), mend) for n in dead]
    return worst_first(found)


def unfit(recording: Recording, crane: Crane, purpose: Purpose = "compare") -> list[Finding]:
    """Return what forbids to use a recording, all of it errors; empty for one that can be used.

    Of any purpose: no commands, no sensor, shorter than 1 s, sensors that overlap with the commands for less than that,
    all sensors constant, a saturated sensor. Of "diagnose" also: a single sensor, and a crane that never moves.
    """
    lacking = _lacking(recording, crane, purpose)
    if lacking is not None:
        return [lacking]
    time, commands = recording.commands(crane)
    found = [*_short(recording, time), *_dead(recording)]
    for name in recording.sensors if not found else ():
        found += _saturated(name, recording[name], time, commands[:, crane.layout.sensors[name].cylinder], crane)
    if purpose == "diagnose" and not _moves(recording, crane, commands):
        text = f"nothing moves: no valve opens by more than {OPEN:g} and no angle changes by more than its noise"
        mend = "A diagnosis needs motion; record a run in which every cylinder extends and retracts."
        found.append(Finding("motion", crane.layout.coordinates, "error", text, mend))
    return found


def check_recording(
    recording: Recording, crane: Crane, purpose: Purpose = "compare", explained: bool = False
) -> list[str]:
    """Return notes on a recording (one sentence each); what cannot be used at all is refused with the reason.

    Refused are contents that cannot be true (`crane_exudyn.vetting`), and what is `unfit` for the purpose.

    Args:
        explained: whether a model is known that leaves only noise of it: what wavers at rest is then the machine.

    Raises:
        CraneError: what is wrong with the recording, and how to mend it.
    """
    lacking = _lacking(recording, crane, purpose)
    accepted(recording, [] if lacking is None else [lacking])
    recording = vetted(recording, crane)
    accepted(recording, unfit(recording, crane, purpose))
    time, commands = recording.commands(crane)
    constant = constant_sensors(recording, crane.sensors)
    notes = _notes(recording, crane, time, commands, constant, _moves(recording, crane, commands))
    return notes if explained else notes + _wavering(recording, crane, time, commands, constant)


def check_all(
    recordings: Sequence[Recording], check: Recording | None, crane: Crane, explained: bool = False
) -> list[str]:
    """Return notes on recordings to be diagnosed and the one that is only predicted, each with its recording's name
    where there are several; `explained`: whether a model is known that leaves only noise.

    Raises:
        CraneError: one of them cannot be used.
    """
    if not recordings:
        raise CraneError("There is no recording. Give at least one.")
    each = [check_recording(r, crane, "diagnose", explained) for r in recordings]
    notes = [f"{r.name}: {n}" if len(each) > 1 else n for r, own in zip(recordings, each, strict=True) for n in own]
    where = [r.source or r.name for r in recordings]
    notes += [
        f"{where[j]} is the same recording as {where[i]} and adds no information"
        for i, j in combinations(range(len(recordings)), 2)
        if same(recordings[i], recordings[j])
    ]
    return notes if check is None else check_check(check, recordings, crane, explained) + notes


def check_check(check: Recording, learned: Sequence[Recording], crane: Crane, explained: bool = False) -> list[str]:
    """Return notes on a recording that is only predicted, beside those that are learned from.

    Raises:
        CraneError: it cannot be compared with the crane, or has no sensor of the others.
    """
    notes = check_recording(check, crane, explained=explained)
    where = check.source or check.name
    sensors = list(dict.fromkeys(c for r in learned for c in r.sensors))
    if not set(check.sensors) & set(sensors):
        raise CraneError(
            f"{where}: has {', '.join(check.sensors)}, but none of the sensors of {', '.join(r.name for r in learned)} "
            f"({', '.join(sensors)}). "
            "A check recording must be of the same machine, with the same sensors."
        )
    if any(same(check, r) for r in learned):
        return [f"{where} is the recording that is learned from, so it is no independent check"]
    return [f"check recording: {note}" for note in notes]


def same(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same samples, whatever their names."""
    return set(one.channels) == set(other.channels) and all(
        np.array_equal(one[n].time, other[n].time) and np.array_equal(one[n].values, other[n].values)
        for n in one.channels
    )


def _lacking(recording: Recording, crane: Crane, purpose: Purpose) -> Finding | None:
    """Return which channels are missing, None where none is: nothing tells then what moves the machine, or whether it
    does.
    """
    where, lay = recording.source or recording.name, crane.layout
    try:
        recording.require(commands=True, sensors=2 if purpose == "diagnose" else 1).commands(crane)
    except CraneError as problem:
        text, _, mend = str(problem).removeprefix(f"{where}: ").partition(". ")
        sets = (lay.commands, lay.voltages)
        driven = any(recording.has(*names) for names in sets)
        missing = tuple(n for n in max(sets, key=lambda s: sum(map(recording.has, s))) if not recording.has(n))
        return Finding("motion", recording.sensors or lay.coordinates if driven else missing, "error", text, mend)
    return None


def _short(recording: Recording, command_time: np.ndarray) -> Iterator[Finding]:
    """Find a recording that is too short, commands on another clock, and channels of a few samples."""
    first = min(recording[n].time[0] for n in recording.sensors)
    last = max(recording[n].time[-1] for n in recording.sensors)
    if last - first < SHORTEST:
        text = f"the sensors cover {last - first:.3g} s; at least {SHORTEST:g} s is needed"
        yield Finding("clock", ("time",), "error", text, "Record a longer run.")
        return
    common = min(last, command_time[-1]) - max(first, command_time[0])
    if common < SHORTEST:
        text = (
            f"commands cover {command_time[0]:g} … {command_time[-1]:g} s and sensors {first:g} … {last:g} s: "
            f"only {max(common, 0.0):.3g} s in common, at least {SHORTEST:g} s is needed"
        )
        yield Finding("clock", ("time",), "error", text, "Check the clocks.")
    for n in (n for n in recording.sensors if len(recording[n]) < _FEWEST):
        text = f"channel {n} has only {len(recording[n])} samples; at least {_FEWEST} are needed"
        yield Finding("clock", (n,), "error", text, "Leave it out, or sample faster.")


def _left_out(name: str) -> str:
    return f"{name} has a constant value and is left out"


def _dead(recording: Recording) -> Iterator[Finding]:
    constant = constant_sensors(recording)
    if len(constant) == len(recording.sensors):
        shown = ", ".join(constant)
        text = f"every sensor ({shown}) has a constant value, so there is nothing to compare"
        mend = "Check that the sensors were connected and the logger was running."
        yield Finding("saturation", tuple(constant), "error", text, mend)


def _saturated(name: str, channel: Channel, time: np.ndarray, command: np.ndarray, crane: Crane) -> Iterator[Finding]:
    """Find a channel that sits exactly at its largest or smallest value most of the time, also while its valve is open;
    a pressure that is that of a void now and then may.
    """
    valve = np.abs(np.interp(channel.time, time, command)) > OPEN
    step = float(np.median(np.diff(channel.time)))
    limits = ((channel.values.max(), "largest"), (channel.values.min(), "smallest"))
    for value, word in limits[:1] if is_constant(channel) else limits:
        stuck = channel.values == value
        if boils(value, channel.unit, crane) and not stuck.all():
            continue
        share, through = float(stuck.mean()), float((stuck & valve).sum()) * step
        if share > _STUCK_SHARE and through > _STUCK_SECONDS:
            text = (
                f"sensor {name} is exactly at its {word} value ({value:g} SI) for {share:.0%} of the time, and for "
                f"{through:.1f} s of it while its valve is open: it is saturated, frozen or not connected"
            )
            yield Finding("saturation", (name,), "error", text, "Correct its range, or leave the channel out.")


def _moves(recording: Recording, crane: Crane, commands: np.ndarray) -> bool:
    if (np.abs(commands) > OPEN).any():
        return True
    shown = [recording[n] for n in recording.sensors if crane.layout.sensors[n].unit in ("rad", "m")]
    return any(_range(c) > 10.0 * max(noise_std(c.values), 1e-12) for c in shown)


def _range(channel: Channel) -> float:
    """Return by how much the channel's mean changes between tenths of the recording."""
    means = [float(part.mean()) for part in np.array_split(channel.values, 10) if len(part)]
    return max(means) - min(means)


def _notes(
    recording: Recording, crane: Crane, time: np.ndarray, commands: np.ndarray, constant: list[str], moves: bool
) -> list[str]:
    notes = list(recording.notes)
    notes += map(_left_out, constant)
    valves = zip(crane.layout.cylinders, commands.T, strict=True)
    notes += [f"the {name} valve is never opened" for name, command in valves if not _opened(command)]
    if free := recording.noise_free():
        notes.append(
            f"{', '.join(free)} show{'s' * (len(free) == 1)} no noise, like simulations: noise is added as in "
            "[sensors] of the crane file, "
            f"or {USUAL_SENSOR:g} of the channel's range"
        )
    if not moves:
        notes.append("the crane does not move, so only its state at rest is compared")
    if recording.duration < 5.0:
        notes.append(f"the recording is short ({recording.duration:.1f} s): small errors will not be visible")
    count = len(recording.sensors) - len(constant)
    if count < 4:
        notes.append(f"only {count} sensor{'s' * (count > 1)}: the failing equation can hardly be identified")
    late = max(recording[n].time[-1] for n in recording.sensors) - time[-1]
    if late > 0.1:
        notes.append(f"the last command is held for {late:.1f} s, because sensors go on after the commands end")
    return notes


def _wavering(
    recording: Recording, crane: Crane, time: np.ndarray, commands: np.ndarray, constant: list[str]
) -> list[str]:
    """Name the sensors that waver at rest by more than neighbouring samples differ: hum, a logger that smooths, or a
    machine that rings.

    Noise is estimated from neighbouring samples. Where it is slower than that, a right model seems to leave something.
    """
    factors = []
    known = {*crane.sensors, *constant, *recording.noise_free()}
    for name in (n for n in recording.sensors if n not in known):
        slow = noise_at_rest(recording[name], time, commands)
        factors.append((slow / max(noise_std(recording[name].values), 1e-300), name, slow))
    units = {name: engineering(crane.layout.sensors[name].unit) for _, name, _ in factors}
    found = [
        f"{name} by {slow / units[name][1]:.2g} {units[name][0]} ({f:.1f} times)"
        for f, name, slow in factors
        if f > _WAVERS
    ]
    if not found:
        return []
    return [
        f"at rest sensors vary by more than neighbouring samples differ: {', '.join(found)}. Unless the machine "
        "itself oscillates there, this is "
        "their noise: write it into [sensors] of the crane file, or it will look like an effect that the model lacks"
    ]


def noise_at_rest(channel: Channel, time: np.ndarray, commands: np.ndarray) -> float:
    """Return the standard deviation (SI) of a sensor about parabolas through stretches of closed valves; 0 without such
    stretches.

    The quietest quarter of the stretches counts, because after a motion the machine itself rings.
    """
    opened = np.concatenate([[0], np.cumsum(np.abs(commands).max(axis=1) > OPEN)])
    starts = np.arange(channel.time[0], channel.time[-1] - _REST, _REST)
    spans = np.searchsorted(channel.time, [starts, starts + _REST]).T
    commanded = np.searchsorted(time, [starts - _REST, starts + _REST]).T
    found = []
    for (a, b), (first, last) in zip(spans, commanded, strict=True):
        if b - a > 6 and last > first and opened[last] == opened[first]:
            t, values = channel.time[a:b] - channel.time[a], channel.values[a:b]
            left = values - np.polyval(np.polyfit(t, values, 2), t)
            found.append(float(left @ left) / (len(left) - 3))
    return float(np.sqrt(np.quantile(found, 0.25))) if found else 0.0


def _opened(command: np.ndarray) -> bool:
    return bool((np.abs(command) > OPEN).any())
