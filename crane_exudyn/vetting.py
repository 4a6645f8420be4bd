"""Whether a recording's contents can be true of a crane: units, poses, supply and clock, each finding with its likely mend.

    for finding in vet(recording, crane):
        print(finding.severity, finding.text, finding.mend)

Only what no crane can do, or hardly any, is found here, from values that occur often (a single spike is not a wrong unit), in well
under a second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from .channels import BEYOND, Channel
from .crane import Crane
from .errors import CraneError
from .geometry import cylinder_lengths
from .recording import Recording
from .signals import noise_std, sampling_rate

Severity = Literal["error", "warning", "note"]
Kind = Literal["scale", "clock", "pose", "swapped", "offset"]

_SEVERITIES: tuple[Severity, ...] = ("error", "warning", "note")
#: pressures in Pa that a working crane stays between, most of the time; a chamber may stand at vapour pressure, but not all the time
_LOW, _HIGH, _VACUUM = 0.1e5, BEYOND["Pa"], -0.5e5
#: by unit, sizes between which the usual largest reading lies
_LIKELY = {"rad": (0.01, math.pi), "m": (0.01, 10.0), "rad/s": (0.01, 2.0), "m/s": (0.001, 2.0)}
#: samples a second between which sensors of a crane are read
_SLOWEST_CLOCK, _FASTEST_CLOCK = 2.0, 2e5
#: m by which a cylinder may seem longer or shorter than it can be: pins and zero points are known to that
_PLAY = 0.03
#: how many poses are looked at, and the share of them beyond reach that is no longer an outlier
_POSES, _SHARE = 400, 0.05
#: units that are mistaken for one another: what a value must be multiplied with, and what then was given as what
_MISTAKEN = {
    "Pa": ((1e5, "bar", "Pa"), (1e6, "MPa", "Pa"), (1e-5, "Pa", "bar"), (10.0, "MPa", "bar"), (1e3, "kPa", "Pa")),
    "rad": ((math.pi / 180, "deg", "rad"), (180 / math.pi, "rad", "deg"), (1e-3, "mrad", "rad")),
    "rad/s": ((math.pi / 180, "deg/s", "rad/s"), (180 / math.pi, "rad/s", "deg/s")),
    "m": ((1e-3, "mm", "m"), (1e3, "m", "mm"), (1e-2, "cm", "m")),
    "m/s": ((1e-3, "mm/s", "m/s"), (1e3, "m/s", "mm/s")),
}


@dataclass(frozen=True)
class Finding:
    """Something about a recording: what kind, which channels, how bad, what was found and how to mend it.

    "error" is what cannot be true, "warning" what is hardly so, "note" what a reader should know.
    """

    kind: Kind
    channels: tuple[str, ...]
    severity: Severity
    text: str
    mend: str


def vet(recording: Recording, crane: Crane) -> list[Finding]:
    """Return what is implausible about a recording of a crane, worst first; empty for a sound one."""
    looks = (_pressures, _supply, _motion, _lengths, _poses, _clock)
    found = [finding for look in looks for finding in look(recording, crane)]
    return sorted(found, key=lambda f: _SEVERITIES.index(f.severity))


def vetted(recording: Recording, crane: Crane) -> Recording:
    """Return the recording, with notes on what is hardly plausible about it.

    Raises:
        CraneError: something in it cannot be true; all such findings, each with its mend.
    """
    findings = vet(recording, crane)
    errors = [f"{f.text}. {f.mend}" for f in findings if f.severity == "error"]
    if errors:
        raise CraneError(f"{recording.source or recording.name}: {' '.join(errors)}")
    return replace(recording, notes=(*recording.notes, *(f"{f.text}. {f.mend}".removesuffix(".") for f in findings)))


# -- one look each ---------------------------------------------------------------------------------------------------


def _usual(channel: Channel) -> tuple[float, float]:
    """Return the values (low, high) between which a channel is nearly all the time."""
    low, high = np.quantile(channel.values, [0.01, 0.99])
    return float(low), float(high)


def _mistaken(name: str, unit: str, value: float, low: float, high: float) -> str:
    """Return the mend of a channel one of whose values would lie between low and high in another unit, or the advice to leave it out."""
    for factor, was, given in _MISTAKEN[unit]:
        if low < factor * value < high:
            return f"The values look like {was} given as {given}: write the unit as {name}[{was}]."
    return "Mend its unit, or leave the channel out."


def _people(unit: str) -> tuple[float, str]:
    """Return the unit in which people read coordinates and rates of a SI unit, behind what one of the latter is in it."""
    return (math.degrees(1.0), "deg") if unit == "rad" else (1.0, unit)


def _is_constant(channel: Channel) -> bool:
    return bool(np.ptp(channel.values) == 0.0)


def _pressures(recording: Recording, crane: Crane) -> Iterator[Finding]:
    lay = crane.layout
    for name in (n for n in recording.channels if n in (*lay.chambers, lay.supply[0])):
        low, high = _usual(recording[name])
        if _is_constant(recording[name]) and high == 0.0:  # a sensor that is not connected, told elsewhere
            continue
        if low < _VACUUM - 3.0 * noise_std(
            recording[name].values
        ):  # a noisy sensor of a boiling chamber reads below nothing
            text = f"{name} falls to {low / 1e5:.3g} bar, expected absolute pressures, which are never negative"
            yield Finding(
                "offset", (name,), "error", text, "Mend its zero point or its sign; add 1 bar to a gauge pressure."
            )
        elif not _LOW < high < _HIGH:
            limit = "never exceeds" if high <= _LOW else "reaches"
            text = f"{name} {limit} {high / 1e5:.3g} bar, expected a pressure of a crane whose pump gives {crane['supply.pump_pressure'] / 1e5:.3g} bar"
            mend = _mistaken(name, "Pa", high, 10.0 * _LOW, 4.0 * crane["supply.pump_pressure"])
            yield Finding("scale", (name,), "error", text, mend)


def _supply(recording: Recording, crane: Crane) -> Iterator[Finding]:
    names = crane.layout.supply
    pump, tank = (
        float(np.median(recording[n].values)) if recording.has(n) else crane[f"supply.{word}_pressure"]
        for n, word in zip(names, ("pump", "tank"), strict=True)
    )
    if any(map(recording.has, names)) and pump <= tank:
        told = [f"the {word} ({p / 1e5:.3g} bar)" for word, p in (("pump", pump), ("tank", tank))]
        mend = f"Swap {' and '.join(names)}, or mend their units."
        yield Finding("swapped", names, "error", f"{told[0]} stands below {told[1]}, so nothing could move", mend)


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
            yield Finding("scale", (name,), "error", text, _mistaken(name, unit, most, *_LIKELY[unit]))


def _lengths(recording: Recording, crane: Crane) -> Iterator[Finding]:
    for c, name in enumerate(crane.layout.lengths):
        if not recording.has(name):
            continue
        low, high = _usual(recording[name])
        shortest, longest = _reach(crane, c)
        if low < shortest - _PLAY or high > longest + _PLAY:
            text = (
                f"{name} goes from {low:.4g} to {high:.4g} m, expected {shortest:.4g} to {longest:.4g} m, "
                f"the {crane.layout.cylinders[c]} cylinder from pin to pin"
            )
            if low > -_PLAY and high < longest - shortest + _PLAY:
                mend = f"Is it the stroke? Then add the empty length, {shortest:.4g} m."
            else:
                mend = _mistaken(name, "m", 0.5 * (low + high), shortest, longest)
            yield Finding("scale", (name,), "error", text, mend)


def _reach(crane: Crane, c: int) -> tuple[float, float]:
    """Return the shortest and the longest pin-to-pin length of cylinder c in m."""
    empty = crane[f"cylinders.{crane.layout.cylinders[c]}.empty_length"]
    return empty, empty + crane[f"cylinders.{crane.layout.cylinders[c]}.chamber_range"]


def _poses(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find coordinates that the linkage or the stroke of the cylinder that drives them does not reach."""
    for c, name in enumerate(crane.layout.driven):
        unit = crane.layout.unit_of(name)
        if not recording.has(name) or max(map(abs, _usual(recording[name]))) > BEYOND[unit]:
            continue
        values = recording[name].values
        shown = values[np.linspace(0, len(values) - 1, min(_POSES, len(values))).astype(int)]
        share = _beyond(crane, c, shown)
        if share > _SHARE:
            factor, people = _people(unit)
            low, high = factor * np.array(_usual(recording[name]))
            text = (
                f"{name} goes from {low:.4g} to {high:.4g} {people}; in {100 * share:.0f} % of the samples this is beyond what the "
                f"{crane.layout.cylinders[c]} cylinder's stroke and linkage reach"
            )
            severity: Severity = "error" if share > 0.5 else "warning"
            yield Finding("pose", (name,), severity, text, _other_coordinate(recording, crane, c, shown))


def _other_coordinate(recording: Recording, crane: Crane, c: int, shown: np.ndarray) -> str:
    """Return what would bring a coordinate into reach: another sign, unit, or the horizontal as the line it is measured against."""
    name = crane.layout.driven[c]
    units = [(was, given, factor) for factor, was, given in _MISTAKEN[crane.layout.unit_of(name)][:2]]
    others = {"with the other sign": -shown} | {
        f"in {was} where {given} is given": f * shown for was, given, f in units
    }
    for words, values in others.items():
        if _beyond(crane, c, values) <= _SHARE:
            return f"It would fit {words}. Mend the column, or is it another crane? Then give its file with --crane."
    carriers = crane.layout.carriers(name)
    if carriers and recording.has(*carriers):
        base = sum(float(np.median(recording[n].values)) for n in carriers)
        if _beyond(crane, c, shown - base) <= _SHARE:
            return f"It would fit as the angle against the horizontal: name the column {name}_abs."
    return f"Mend the zero point of {name}, or is it another crane? Then give its file with --crane."


def _beyond(crane: Crane, c: int, values: np.ndarray) -> float:
    """Return the share of values (n,) of the coordinate that cylinder c drives that the cylinder or a loop does not reach."""
    z = np.tile(crane.initial.pose, (len(values), 1))
    z[:, crane.layout.index(crane.layout.driven[c])] = values
    lengths = cylinder_lengths(crane, z)[:, c]  # NaN where a loop cannot close
    shortest, longest = _reach(crane, c)
    good = (lengths > shortest - _PLAY) & (lengths < longest + _PLAY)
    return 1.0 - float(good.sum()) / len(values)


def _clock(recording: Recording, crane: Crane) -> Iterator[Finding]:
    if not recording.sensors:
        return
    rate = max(sampling_rate(recording[n].time) for n in recording.sensors)
    if not _SLOWEST_CLOCK <= rate <= _FASTEST_CLOCK:
        text = (
            f"the sensors are read {rate:.3g} times a second, expected {_SLOWEST_CLOCK:g} to {_FASTEST_CLOCK:g} times"
        )
        mend = "Is the time in ms? Write time[ms]." if rate < _SLOWEST_CLOCK else "Is the time in s? Write time[s]."
        yield Finding("clock", ("time",), "error", text, mend)
