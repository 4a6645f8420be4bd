"""Whether a recording can bear what is asked of it: the checks that come before any comparison or diagnosis."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

import numpy as np

from crane_exudyn.channels import Channel
from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.signals import USUAL_SENSOR, noise_std
from crane_exudyn.vetting import OPEN, vetted

Purpose = Literal["compare", "diagnose"]

#: shortest recording, s; a spool alone needs a tenth of that to open
SHORTEST = 1.0
#: a channel that stands at its extreme for more than this share of the time is saturated
_STUCK_SHARE = 0.5
#: seconds of closed valves in which slow errors of a sensor are looked for, and by how much they must exceed its white
#: noise
_REST, _WAVERS = 0.25, 1.5
#: seconds with an open valve that a sound sensor does not sit through without the slightest change
_STUCK_SECONDS = 0.3


def check_recording(recording: Recording, crane: Crane, purpose: Purpose = "compare") -> list[str]:
    """Return notes on a recording (one sentence each); what cannot be used at all is refused with the reason.

    Refused for any purpose: contents that cannot be true (`crane_exudyn.vetting`), no commands, no sensor, shorter than
    1 s, sensors that overlap with the commands for less than that, all sensors constant, a saturated sensor. Refused
    for "diagnose" also: a single sensor, and a crane that never moves.

    Raises:
        CraneError: what is wrong with the recording, and how to mend it.
    """
    recording = vetted(recording.require(commands=True, sensors=2 if purpose == "diagnose" else 1), crane)
    time, commands = recording.commands(crane)
    _refuse_short(recording, time)
    constant = [name for name in recording.sensors if _is_constant(recording[name])]
    where = recording.source or recording.name
    if len(constant) == len(recording.sensors):
        raise CraneError(
            f"{where}: every sensor ({', '.join(constant)}) shows one value from beginning to end, so there is nothing "
            "to compare. "
            "Check that the sensors were connected and the logger was running."
        )
    for name in recording.sensors:
        command = commands[:, crane.layout.sensors[name].cylinder]
        _refuse_saturated(where, name, recording[name], time, command)
    moves = _moves(recording, crane, commands)
    if purpose == "diagnose" and not moves:
        raise CraneError(
            f"{where}: nothing moves: no valve is opened by more than {OPEN:g} and no angle leaves its noise. A "
            "diagnosis needs "
            "motion; record a run in which every cylinder extends and retracts."
        )
    notes = _notes(recording, crane, time, commands, constant, moves)
    return notes + _wavering(recording, crane, time, commands, constant)


def check_all(recordings: Sequence[Recording], check: Recording | None, crane: Crane) -> list[str]:
    """Return notes on recordings to be diagnosed and the one that is only predicted, each with its recording's name
    where there are several.

    Raises:
        CraneError: one of them cannot be used.
    """
    if not recordings:
        raise CraneError("There is no recording. Give at least one.")
    each = [check_recording(r, crane, purpose="diagnose") for r in recordings]
    notes = [f"{r.name}: {n}" if len(each) > 1 else n for r, own in zip(recordings, each, strict=True) for n in own]
    where = [r.source or r.name for r in recordings]
    notes += [
        f"{where[j]} is {where[i]} once more: it proves nothing further"
        for i, j in combinations(range(len(recordings)), 2)
        if same(recordings[i], recordings[j])
    ]
    return notes if check is None else check_check(check, recordings, crane) + notes


def check_check(check: Recording, learned: Sequence[Recording], crane: Crane) -> list[str]:
    """Return notes on a recording that is only predicted, beside those that are learned from.

    Raises:
        CraneError: it cannot be compared with the crane, or has no sensor of the others.
    """
    notes = check_recording(check, crane)
    where = check.source or check.name
    sensors = list(dict.fromkeys(c for r in learned for c in r.sensors))
    if not set(check.sensors) & set(sensors):
        raise CraneError(
            f"{where}: has {', '.join(check.sensors)}, but no sensor of {', '.join(r.name for r in learned)} "
            f"({', '.join(sensors)}). "
            "A check recording is of the same machine, with the same sensors."
        )
    if any(same(check, r) for r in learned):
        return [f"{where} is the recording that is learned from: as a check it confirms nothing"]
    return [f"check recording: {note}" for note in notes]


def same(one: Recording, other: Recording) -> bool:
    """Whether two recordings hold the same samples, whatever their names."""
    return set(one.channels) == set(other.channels) and all(
        np.array_equal(one[n].time, other[n].time) and np.array_equal(one[n].values, other[n].values)
        for n in one.channels
    )


def usable(recording: Recording) -> Recording:
    """Return the recording without sensors that show one value throughout: they have no noise to be measured
    against.
    """
    dead = {name for name in recording.sensors if _is_constant(recording[name])}
    return recording.select([n for n in recording.channels if n not in dead]) if dead else recording


def _refuse_short(recording: Recording, command_time: np.ndarray) -> None:
    first = min(recording[n].time[0] for n in recording.sensors)
    last = max(recording[n].time[-1] for n in recording.sensors)
    where = recording.source or recording.name
    if last - first < SHORTEST:
        raise CraneError(
            f"{where}: the sensors cover {last - first:.3g} s; at least {SHORTEST:g} s is needed. Record a longer run."
        )
    common = min(last, command_time[-1]) - max(first, command_time[0])
    if common < SHORTEST:
        raise CraneError(
            f"{where}: commands cover {command_time[0]:g} … {command_time[-1]:g} s and sensors {first:g} … {last:g} s: "
            f"only {max(common, 0.0):.3g} s in common, at least {SHORTEST:g} s is needed. Check the clocks."
        )
    few = next((n for n in recording.sensors if len(recording[n]) < 10), None)
    if few is not None:
        raise CraneError(
            f"{where}: channel {few} has only {len(recording[few])} samples; at least 10 are needed. Leave it out, or "
            "sample faster."
        )


def _is_constant(channel: Channel) -> bool:
    return bool(np.ptp(channel.values) <= 1e-9 * max(float(np.max(np.abs(channel.values))), 1e-9))


def _refuse_saturated(where: str, name: str, channel: Channel, time: np.ndarray, command: np.ndarray) -> None:
    """Refuse a channel that sits exactly at its largest or smallest value most of the time, also while its valve is
    open.
    """
    valve = np.abs(np.interp(channel.time, time, command)) > OPEN
    step = float(np.median(np.diff(channel.time)))
    for value, word in ((channel.values.max(), "largest"), (channel.values.min(), "smallest")):
        stuck = channel.values == value
        share, through = float(stuck.mean()), float((stuck & valve).sum()) * step
        if share > _STUCK_SHARE and through > _STUCK_SECONDS:
            raise CraneError(
                f"{where}: sensor {name} stands exactly at its {word} value ({value:g} SI) for {share:.0%} of the "
                "time, and for "
                f"{through:.1f} s of it while its valve is open: it is saturated, frozen or not connected. Mend its "
                "range, or "
                "leave the channel out."
            )


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
    notes += [f"{name} shows one value throughout and is left out" for name in constant]
    valves = zip(crane.layout.cylinders, commands.T, strict=True)
    notes += [f"the {name} valve is never opened" for name, command in valves if not _opened(command)]
    if free := recording.noise_free():
        notes.append(
            f"{', '.join(free)} show{'s' * (len(free) == 1)} no noise, as simulations do: noise is added as [sensors] "
            "of the crane file says, "
            f"or {USUAL_SENSOR:g} of the channel's range"
        )
    if not moves:
        notes.append("the crane does not move: only its state at rest is compared")
    if recording.duration < 5.0:
        notes.append(f"the recording is short ({recording.duration:.1f} s): small errors will not show")
    count = len(recording.sensors) - len(constant)
    if count < 4:
        notes.append(f"only {count} sensor{'s' * (count > 1)}: which equation fails can hardly be told apart")
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
    found = [
        f"{name} by {slow:.2g} {crane.layout.sensors[name].unit} ({f:.1f} times)"
        for f, name, slow in factors
        if f > _WAVERS
    ]
    if not found:
        return []
    return [
        f"at rest sensors waver by more than neighbouring samples differ: {', '.join(found)}. Unless the machine "
        "itself rings there, this is "
        "their noise: write it into [sensors] of the crane file, or what is only hum will look like something missing"
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
