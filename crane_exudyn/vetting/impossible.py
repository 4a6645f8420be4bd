"""What no crane shows: sizes of pressures, coordinates, rates and lengths, poses out of reach, a sampling rate; each
channel by itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from itertools import permutations

import numpy as np

from ..channels import BEYOND
from ..channels import of as units_of
from ..crane import Crane
from ..recording import Recording
from ..signals import noise_std, sampling_rate, usual_range
from ..statics import vapour_pressure
from ..units import factor_to_si
from .balances import PLAY, Figures, Grid, Misfit, reach
from .findings import Check, Finding, Severity

#: Pa above vapour pressure that a pressure exceeds: a chamber may stand at vapour pressure, but not all the time
_LOW = 0.1e5
#: Pa below vapour pressure, and below what noise makes of it, at which a pressure is too low
_VACUUM = 0.5e5
#: Pa above which the usual largest pressure lies, if read in the right unit
_LIKELY_LOW = 1e5
#: pump pressures below which it lies
_LIKELY_PUMPS = 4.0
#: by unit, sizes between which the usual largest reading lies
_LIKELY = {"rad": (0.01, math.pi), "m": (0.01, 10.0), "rad/s": (0.01, 2.0), "m/s": (0.001, 2.0)}
#: units that a column is likely to be in, whatever it says, the likeliest first
_WRITTEN = {
    "Pa": ("bar", "MPa", "Pa", "kPa", "psi"),
    "rad": ("deg", "rad", "mrad"),
    "rad/s": ("deg/s", "rad/s"),
    "m": ("mm", "m", "cm"),
    "m/s": ("mm/s", "m/s"),
}
#: samples a second below which no sensor of a crane is read
_SLOWEST = 2.0
#: samples a second above which none is read
_FASTEST = 2e5
#: instants at which poses are looked at
_POSES = 400
#: share of them beyond reach that is no longer an outlier
_SHARE = 0.05
#: columns that a message names of many
_NAMED = 4

_ANOTHER_CRANE = "If it is another crane, give its file with --crane."


def foreign_columns(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find files with more columns that are no channels of the crane than channels, none of which shows the pose: a few
    names may agree by chance.
    """
    lay, ignored = crane.layout, recording.ignored
    poses = (*lay.coordinates, *(f"{n}_abs" for n in lay.coordinates), *lay.lengths)
    if len(ignored) > len(recording.channels) and not any(map(recording.has, poses)):
        named = ", ".join(ignored[:_NAMED]) + ", …" * (len(ignored) > _NAMED)
        text = (
            f"{len(ignored)} of {len(ignored) + len(recording.channels)} columns ({named}) are not channels of "
            f"{crane.name}, and none of {', '.join(lay.coordinates)} is there"
        )
        yield Finding("pose", (), "warning", text, _ANOTHER_CRANE)


def pressures(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find pressures of chambers and pump that fall too low, or are far too small or too large."""
    lay, floor, pump = crane.layout, vapour_pressure(crane), crane["supply.pump_pressure"]
    absolute = crane["supply.pressure_reference"] == 0.0
    expected = "absolute pressures, which are never negative" if absolute else f"at least {floor / 1e5:.3g} bar, vacuum"
    for name in (n for n in recording.channels if n in (*lay.chambers, lay.supply[0])):
        values = recording[name].values
        low, high = usual_range(values)
        if not values.any():  # not connected: that is reported elsewhere
            continue
        # a noisy sensor of a boiling chamber reads below nothing; in a wrong unit, by any number
        if high < BEYOND["Pa"] and low < floor - _VACUUM - 3.0 * noise_std(values):
            text = f"{name} falls to {low / 1e5:.3g} bar, expected {expected}"
            severity: Severity = "error" if np.median(values) < floor else "warning"
            mend = "Correct its zero point or its sign; add 1 bar to a gauge pressure."
            yield Finding("offset", (name,), severity, text, mend)
        elif not floor + _LOW < high < BEYOND["Pa"]:
            text = (
                f"{name} {'never exceeds' if high <= floor + _LOW else 'reaches'} {high / 1e5:.3g} bar, expected a "
                f"pressure of a crane whose pump gives {pump / 1e5:.3g} bar"
            )
            mend = _other_unit(recording, name, high, _LIKELY_LOW, _LIKELY_PUMPS * pump)
            yield Finding("scale", (name,), "error", text, mend)


def supply(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find a pump pressure below that of the tank."""
    names = crane.layout.supply
    pump, tank = (
        float(np.median(recording[n].values)) if recording.has(n) else crane[f"supply.{word}_pressure"]
        for n, word in zip(names, ("pump", "tank"), strict=True)
    )
    if any(map(recording.has, names)) and pump <= tank:
        text = f"the pump ({pump / 1e5:.3g} bar) is below the tank ({tank / 1e5:.3g} bar), so nothing could move"
        yield Finding("swapped", names, "error", text, f"Swap {' and '.join(names)}, or correct their units.")


def motion(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find coordinates and rates that are larger than those of any crane."""
    for name in (n for n in recording.sensors if n not in (*crane.layout.chambers, *crane.layout.lengths)):
        unit = crane.layout.sensors[name].unit
        most = max(map(abs, usual_range(recording[name].values)))
        if most > BEYOND[unit]:
            factor, people = _in_messages(unit)
            text = (
                f"{name} reaches {factor * most:.3g} {people}, expected less than {factor * BEYOND[unit]:.3g} {people}"
            )
            yield Finding("scale", (name,), "error", text, _other_unit(recording, name, most, *_LIKELY[unit]))


def lengths(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find lengths that a cylinder does not have."""
    for cylinder, name in zip(crane.layout.cylinders, crane.layout.lengths, strict=True):
        if not recording.has(name):
            continue
        low, high = usual_range(recording[name].values)
        shortest, longest = crane.stroke(cylinder)
        if low < shortest - PLAY or high > longest + PLAY:
            text = (
                f"{name} goes from {low:.4g} to {high:.4g} m, expected {shortest:.4g} to {longest:.4g} m, "
                f"the {cylinder} cylinder from pin to pin"
            )
            if low > -PLAY and high < longest - shortest + PLAY:
                mend = f"If it is the stroke, add the empty length of {shortest:.4g} m."
            else:
                mend = _other_unit(recording, name, 0.5 * (low + high), shortest, longest)
            yield Finding("scale", (name,), "error", text, mend)


def poses(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find coordinates that the linkage, or the stroke of the cylinder that drives them, does not reach."""
    lay, machine, grid = crane.layout, Figures(crane), _coordinates(recording, crane)
    for cylinder, name in zip(lay.cylinders, lay.driven, strict=True):
        share = _beyond(machine, grid, cylinder)
        if name in grid.channels and share > _SHARE:
            factor, people = _in_messages(lay.unit_of(name))
            low, high = factor * np.array(usual_range(recording[name].values))
            text = (
                f"{name} goes from {low:.4g} to {high:.4g} {people}; in {100 * share:.0f} % of the samples this is "
                f"beyond the reach of the {cylinder} cylinder's stroke and linkage"
            )
            severity: Severity = "error" if share > 0.5 else "warning"
            yield Finding("pose", (name,), severity, text, _other_coordinate(machine, grid, name, cylinder))


def rate(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find a time in another unit: sensors seem to be read too rarely or too often."""
    if not recording.sensors:
        return
    fastest = max(sampling_rate(recording[n].time) for n in recording.sensors)
    if not _SLOWEST <= fastest <= _FASTEST:
        text = f"the sensors are read {fastest:.3g} times a second, expected {_SLOWEST:g} to {_FASTEST:g} times"
        unit = "ms" if fastest < _SLOWEST else "s"
        yield Finding("clock", ("time",), "error", text, f"If the time is in {unit}, write time[{unit}].")


CHECKS: tuple[Check, ...] = (foreign_columns, pressures, supply, motion, lengths, poses, rate)


# -- units and poses ---------------------------------------------------------------------------------------------------


def _other_unit(recording: Recording, name: str, value: float, low: float, high: float) -> str:
    """Return the correction of a channel whose `value` would lie between low and high in another unit; without such a
    unit, the advice to leave the channel out.
    """
    unit = units_of(recording.layout)[name]
    stated = (recording.columns[name].unit if name in recording.columns else None) or unit
    # numbers in SI may have been converted before they came here, from any unit
    for given in [stated] if stated != unit else dict.fromkeys([unit, *_WRITTEN[unit]]):
        for was in _WRITTEN[unit]:
            if was != given and low < factor_to_si(was, unit) / factor_to_si(given, unit) * value < high:
                return f"The values look like {was} recorded as {given}: write the unit as {name}[{was}]."
    return "Correct its unit, or leave the channel out."


def _in_messages(unit: str) -> tuple[float, str]:
    """Return what to multiply a coordinate or rate in SI by for a message, and its unit there."""
    return (math.degrees(1.0), "deg") if unit == "rad" else (1.0, unit)


def _coordinates(recording: Recording, crane: Crane) -> Grid:
    """Return the recorded coordinates that can be true, at a few instants."""
    lay = crane.layout
    shown = {n: sensor.unit for n, sensor in lay.sensors.items() if n.removesuffix("_abs") in lay.coordinates}
    there = ((n, recording[n], unit) for n, unit in shown.items() if recording.has(n))
    known = {n: channel for n, channel, unit in there if max(map(abs, usual_range(channel.values))) <= BEYOND[unit]}
    first, last = (f((c.time[k] for c in known.values()), default=0.0) for f, k in ((max, 0), (min, -1)))
    time = np.linspace(first, last, _POSES)
    return Grid(time, {n: c.held(time) for n, c in known.items()}, {})


def _beyond(machine: Figures, grid: Grid, cylinder: str) -> float:
    """Return the share of instants at which a cylinder or a loop does not reach the pose; 0 if the pose is unknown."""
    return reach(machine, grid).get(("reach", cylinder), Misfit(0.0)).off


def _other_coordinate(machine: Figures, grid: Grid, name: str, cylinder: str) -> str:
    """Return what would bring a coordinate into reach: another sign, another unit, or the horizontal as its
    reference.
    """
    lay, shown = machine.layout, grid.channels[name]
    sizes = {unit: factor_to_si(unit, lay.unit_of(name)) for unit in _WRITTEN[lay.unit_of(name)][:2]}
    others = {"with the opposite sign": -shown} | {
        f"in {was} instead of {given}": sizes[was] / sizes[given] * shown for was, given in permutations(sizes, 2)
    }
    for words, values in others.items():
        if _beyond(machine, replace(grid, channels={**grid.channels, name: values}), cylinder) <= _SHARE:
            return f"It would fit {words}. Correct the column. {_ANOTHER_CRANE}"
    absolute = {n: values for n, values in grid.channels.items() if n != name} | {f"{name}_abs": shown}
    carried = lay.carriers(name) and absolute.keys() >= set(lay.carriers(name))
    if carried and _beyond(machine, replace(grid, channels=absolute), cylinder) <= _SHARE:
        return f"It would fit as the angle relative to the horizontal: name the column {name}_abs."
    return f"Correct the zero point of {name}. {_ANOTHER_CRANE}"
