"""How well a recording was taken: channels that are cut off, coarse or smoothed, and a start in motion. Such channels
can be true, so nothing here is an error.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from ..channels import OPEN, Channel
from ..crane import Crane
from ..recording import Recording
from ..signals import quantisation, sampling_rate
from ..statics import vapour_pressure
from .findings import Check, Finding

#: share of samples that stay at a limit, beyond which a channel is cut off
_CUT = 0.01
#: share of its other samples that stay where they are, below which it is
_KEPT = 0.2
#: share of what a channel shows that makes a step coarse
_COARSE = 0.01
#: s in which a machine does not ring
_RING = 0.1
#: correlation of neighbouring samples from which on noise is not white
_ALIKE = 0.5
#: fall of the power where no machine rings (`_fall`) that must be seen, too
_FALLS = 0.3
#: s at the beginning, and as many after them, in which nothing should move
_FIRST = 0.3
#: rad/s, or m/s, from which on a coordinate moves
_MOVES = 0.04
#: times the scatter of its samples beyond which a rate counts
_MOVED = 6.0


def cut_off(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find channels that are cut off: they stay exactly at their largest or smallest value, and at no other."""
    free = recording.noise_free()
    for name in (n for n in recording.sensors if n not in free and np.ptp(recording[n].values) != 0.0):
        values, unit = recording[name].values, recording[name].unit
        kept = values[1:] == values[:-1]
        for limit, word in ((values.max(), "largest"), (values.min(), "smallest")):
            there = values[1:] == limit
            cut = (kept & there).mean() > _CUT and (there.all() or kept[~there].mean() < _KEPT)
            if cut and not boils(limit, unit, crane):
                text = (
                    f"{name} is at its {word} value {limit:.4g} {unit} in {100 * there.mean():.0f} % of its samples: "
                    "it is cut off, frozen or not connected"
                )
                yield Finding("saturation", (name,), "warning", text, "Correct its range, or leave the channel out.")


def boils(limit: float, unit: str, crane: Crane) -> bool:
    """Whether a channel that stays at a limit (SI) is the pressure of a chamber that boils."""
    return unit == "Pa" and limit <= vapour_pressure(crane)


def coarse_steps(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find channels whose steps are coarse for what they show; too few samples show no finer ones."""
    for name in recording.sensors:
        values = recording[name].values
        step, span = quantisation(values), float(np.ptp(values))
        if span > 0.0 and step > _COARSE * span and len(values) > 1.0 / _COARSE:
            text = f"{name} comes in steps of {step:.3g} {recording[name].unit}, {100 * step / span:.2g} % of its range"
            yield Finding("noise", (name,), "note", text, "Record it with more digits, or with a suitable range.")


def coloured_noise(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find sensors whose noise is not white, also above all frequencies at which a machine rings: neighbouring samples
    err alike, as loggers that smooth, or hum, make them.
    """
    free = recording.noise_free()
    for name in (n for n in recording.sensors if n not in free):
        channel = recording[name]
        wide = 1 + 2 * round(0.5 * _RING * sampling_rate(channel.time))
        if wide < 6 or len(channel) < 10 * wide:
            continue
        alike = _correlation(channel.values, wide)
        if alike > _ALIKE and _fall(channel.values, sampling_rate(channel.time)) > _FALLS:
            text = f"the noise of {name} is not white: neighbouring samples are correlated by {alike:.2g}"
            mend = "Switch off smoothing in the logger, or write the sensor's noise into [sensors] of the crane file."
            yield Finding("noise", (name,), "note", text, mend)


def _correlation(values: np.ndarray, wide: int) -> float:
    """Return the correlation of neighbouring samples about their mean over `wide` samples, in the quietest quarter of
    the recording.
    """
    fast = (values - np.convolve(values, np.full(wide, 1.0 / wide), "same"))[wide:-wide]
    parts = [p for p in np.array_split(fast, max(4, len(fast) // (4 * wide))) if p.std() > 0.0]
    quiet = sorted(parts, key=lambda p: float(p.std()))[: max(1, len(parts) // 4)]
    return float(np.median([p[1:] @ p[:-1] / (p @ p) for p in quiet])) if quiet else 0.0


def _fall(values: np.ndarray, rate: float) -> float:
    """Return how far a channel's power falls above all frequencies at which a machine rings: 0 where it is even, as
    that of white noise, or samples are too rare; 1 where all of it is at the lowest of these frequencies.

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
    turns = np.cos(2.0 * np.pi * frequency[chosen] / rate)  # correlation of neighbouring samples at each frequency
    return float((power @ turns / max(power.sum(), 1e-300) - turns.mean()) / (turns.max() - turns.mean()))


def start_in_motion(recording: Recording, crane: Crane) -> Iterator[Finding]:
    """Find a recording that begins in motion: its start can hardly be estimated."""
    mend = "Cut the recording so that it starts at rest, or record a second of rest first."
    opened = [n for n in crane.layout.commands if recording.has(n) and abs(recording[n].values[0]) > OPEN]
    if opened:
        text = f"{' and '.join(opened)}: the recording starts with an open valve"
        yield Finding("motion", tuple(opened), "warning", text, mend)
    moving = tuple(n for n in crane.layout.coordinates if recording.has(n) and _begins_moving(recording[n]))
    if moving and not opened:
        yield Finding("motion", moving, "warning", f"{' and '.join(moving)} in motion from the first sample on", mend)


def _begins_moving(channel: Channel) -> bool:
    """Whether a coordinate changes clearly and fast within its first moments, and goes on so."""
    after = channel.time - channel.time[0]
    rates = [_rate(channel, (after >= a) & (after < a + _FIRST)) for a in (0.0, _FIRST)]
    return all(abs(rate) > _MOVES for rate in rates) and rates[0] * rates[1] > 0.0


def _rate(channel: Channel, chosen: np.ndarray) -> float:
    """Return the rate of a channel over some samples, 0 where it is not well above their scatter."""
    t, values = channel.time[chosen], channel.values[chosen]
    if len(t) < 5:
        return 0.0
    slope, offset = np.polyfit(t - t[0], values, 1)
    scatter = float(np.std(values - slope * (t - t[0]) - offset)) * math.sqrt(12.0 / len(t)) / _FIRST
    return float(slope) if abs(slope) > _MOVED * scatter else 0.0


CHECKS: tuple[Check, ...] = (cut_off, coarse_steps, coloured_noise, start_in_motion)
