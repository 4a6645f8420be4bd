"""Samples that were not measured: outliers, and values that a logger writes for "no value"."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from ..channels import BEYOND, Channel
from ..channels import of as units_of
from ..crane import Crane
from ..mapping import Column
from ..recording import Recording
from ..signals import USUAL_SENSOR, Stray, noise_std, strays, usual_range
from ..statics import vapour_pressure
from ..units import factor_to_si
from .findings import Finding, Severity

#: Pa below vapour pressure that not even a gauge set too low shows
_LOWEST = 1.5e5
#: standard deviations of noise that may come on top of it
_UNLIKELY = 8.0
#: Pa from vapour pressure within which a chamber may be empty, so that a gauge may be cut off there
_EMPTY = 1.2e5
#: share of the noise's sum of squares beyond which what outliers add is an error
_SPOILT = 0.1
#: outliers whose times are listed
_LISTED = 5


def without_strays(recording: Recording, crane: Crane) -> tuple[Recording, list[Finding]]:
    """Return the recording without the samples that were not measured, and the findings about these."""
    channels, found = dict(recording.channels), list[Finding]()
    for name in (n for n in (*recording.sensors, *crane.layout.supply) if recording.has(n)):
        channel, unit = recording[name], units_of(recording.layout)[name]
        noise = noise_std(channel.values)
        impossible = np.abs(channel.values) > BEYOND[unit]
        if unit == "Pa":
            impossible |= channel.values < vapour_pressure(crane) - _LOWEST - _UNLIKELY * noise
        astray = strays(channel.time, channel.values, impossible, BEYOND.get(f"{unit}/s", math.inf), noise)
        if astray:
            gone = np.concatenate([np.arange(s.first, s.after) for s in astray])
            channels[name] = Channel(np.delete(channel.time, gone), np.delete(channel.values, gone), channel.unit)
            found += _fill_values(recording, crane, name, [s for s in astray if s.filled])
            low, high = usual_range(channels[name].values)
            usual = max(noise, USUAL_SENSOR * (high - low))
            found += _outliers(recording, name, [s for s in astray if not s.filled], usual)
    return (replace(recording, channels=channels), found) if found else (recording, [])


def _fill_values(recording: Recording, crane: Crane, name: str, filled: list[Stray]) -> Iterator[Finding]:
    """Find values that stand for "no value"; only a warning where an empty chamber may show them."""
    counts = Counter[float]()
    for s in filled:
        counts[float(recording[name].values[s.first])] += s.after - s.first
    for value, count in counts.items():
        is_pressure = units_of(recording.layout)[name] == "Pa"
        empty = is_pressure and abs(value - vapour_pressure(crane)) < _EMPTY
        text = (
            f"{count} samples of {name} are exactly {_as_written(recording, name, value)}, which looks like a fill "
            'value for "no value"'
        )
        yield Finding("noise", (name,), "warning" if empty else "error", text, "Leave these fields empty.")


def _outliers(recording: Recording, name: str, outliers: list[Stray], usual: float) -> Iterator[Finding]:
    """Find samples that leap away and back; an error where they add clearly to the errors that noise of standard
    deviation `usual` leaves of a right model.
    """
    if not outliers:
        return
    channel, worst = recording[name], max(outliers, key=lambda s: s.height)
    count, when = sum(s.after - s.first for s in outliers), [f"{channel.time[s.first]:.6g}" for s in outliers]
    more = f" and {len(when) - _LISTED} more" if len(when) > _LISTED else ""
    beside = [channel.values[k] for k in (worst.first - 1, worst.after) if 0 <= k < len(channel)]
    text = (
        f"{name} has {count} outlier{'s' * (count > 1)} at t = {', '.join(when[:_LISTED])} s{more}: "
        f"{_as_written(recording, name, channel.values[worst.first])} next to "
        f"{' and '.join(_as_written(recording, name, v) for v in beside)}"
    )
    added = sum((s.after - s.first) * (s.height / usual) ** 2 for s in outliers)
    severity: Severity = "error" if added > _SPOILT * len(channel) else "warning"
    yield Finding("noise", (name,), severity, text, f"Leave {'these fields' if count > 1 else 'the field'} empty.")


def _as_written(recording: Recording, name: str, value: float) -> str:
    """Return a value in SI as the file has it, with its unit."""
    column, si = recording.columns.get(name, Column(name)), units_of(recording.layout)[name]
    unit = column.unit or si
    return f"{(value - column.offset) / column.factor / factor_to_si(unit, si):.6g} {unit}"
