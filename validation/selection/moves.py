"""Which effects could be tried on a recording, and from which parameter values."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import SENSING, SENSORS, Effect, Parameter
from crane_exudyn.geometry import chamber_lengths
from crane_exudyn.layout import Layout

from ..criteria import CRITERIA, PLACES
from ..fit.data import Data
from ..fit.start import knots_of
from ..fit.variables import at_place
from ..fit.windows import Window


@dataclass(frozen=True)
class Start:
    """One effect at one place with parameter values (SI) to begin from; two_sided: it may act with either sign."""

    key: str
    values: Mapping[str, float] = field(default_factory=dict)
    two_sided: bool = False


def starts(crane: Crane, data: Data) -> list[Start]:
    """Return the starts of every effect at every place that the recording could show and the crane does not have
    yet.
    """
    found, lay, lengths = [], crane.layout, _first_lengths(crane, data)
    for effect in registry.known():
        if _is_measured(effect, data):
            continue
        for key, place in zip(effect.keys(lay), effect.on(lay), strict=True):
            if effect.curve is None and crane.effect(key) is None and _can_show(effect, place, data, lay):
                first = at_place(effect.parameters[0], place, lay)
                values = _values(effect, first, data, lengths.get(place, 0.0))
                found += [Start(key, each, _two_sided(effect)) for each in values]
    return found


def _first_lengths(crane: Crane, data: Data) -> dict[str, float]:
    """Return the length of each cylinder's piston-side chamber in m where the first recording begins."""
    part, lay = data.parts[0], crane.layout
    state = knots_of(crane, part, [Window(0, part)])[0]
    lengths = chamber_lengths(crane, state[None, lay.positions])[0]
    return {n: float(x) for n, x in zip(lay.cylinders, lengths, strict=True)}


def _is_measured(effect: type[Effect], data: Data) -> bool:
    """Whether an effect acts on nothing but a supply pressure that every recording tells: what the pump or the tank
    line does is in it already.
    """
    known = {
        hook
        for k, hook in enumerate(("supply_pressure", "tank_pressure"))
        if all(not np.isnan(p.supply[:, k]).any() for p in data.parts)
    }
    return bool(effect.hooks()) and set(effect.hooks()) <= known


def _can_show(effect: type[Effect], place: str, data: Data, layout: Layout) -> bool:
    """Whether a sensor's effect stands at a sensor that was recorded; other effects always may show."""
    if effect.places != SENSORS or not set(effect.hooks()) <= SENSING:
        return True
    return any(layout.sensors[name].place == place for name in data.channels)


def _two_sided(effect: type[Effect]) -> bool:
    first = effect.parameters[0]
    return math.isfinite(first.neutral) and first.lower < first.neutral


def _values(effect: type[Effect], first: Parameter, data: Data, length: float) -> list[dict[str, float]]:
    """Return the values to begin from; `first` is the effect's first parameter at its place, `length` (m) the chamber's
    there.
    """
    if effect.probes:
        return [dict(p) for p in effect.probes]
    size, along = first.typical, next((p for p in effect.parameters if p.along_stroke), None)
    if along is not None:
        places = (length + away for away in PLACES)  # a fit may have moved the pins far
        return [{first.name: size, along.name: x} for x in places if along.lower <= x <= along.upper]
    timed = _timing(effect)
    if timed is None:
        return [{first.name: size}]
    begin, end, apart = float(data.time[0]), float(data.time[-1]), CRITERIA.moments
    times = np.arange(begin + apart, end - apart, max(apart, (end - begin) / CRITERIA.moments_at_most))
    return [{first.name: size, timed.name: float(t)} for t in (begin, *times)]


def _timing(effect: type[Effect]) -> Parameter | None:
    return next((p for p in effect.parameters if p.moment), None)


def moment_of(start: Start) -> float | None:
    """Return the moment from which on a start acts, s; None for an effect without a moment of its own."""
    timed = _timing(registry.split_key(start.key)[0])
    return None if timed is None else start.values.get(timed.name)


def around(start: Start) -> list[Start]:
    """Return starts at moments close to that of a start, to either side; none for an effect without a moment of its
    own.
    """
    timed, moment = _timing(registry.split_key(start.key)[0]), moment_of(start)
    if timed is None or moment is None:
        return []
    steps = round(CRITERIA.moments / 2 / CRITERIA.closer)
    moments = [moment + k * CRITERIA.closer for k in range(-steps, steps + 1) if k]
    return [Start(start.key, {**start.values, timed.name: t}, start.two_sided) for t in moments if t >= timed.lower]


def of_typical_size(key: str, values: Mapping[str, float]) -> dict[str, float]:
    """Return values of an effect of the size that is met in practice; what gives it its shape (a moment, a place of the
    stroke) as it is.
    """
    return {p.name: values[p.name] if p.shape else p.typical for p in registry.split_key(key)[0].parameters}


def sizes(key: str) -> list[Parameter]:
    """Return the parameters with which what an effect does grows in proportion; a valve with a setting has none."""
    return [p for p in registry.split_key(key)[0].parameters if not (p.shape or p.threshold)]


def scaled(start: Start, amplitude: float) -> dict[str, float]:
    """Return the start's values with its acting parameters scaled by an amplitude (1 = as they are), within their
    range; thresholds as they are.
    """
    effect, _ = registry.split_key(start.key)
    values, scaling = dict[str, float](), sizes(start.key)
    for p in effect.parameters:
        value = start.values.get(p.name, p.neutral)
        if p in scaling:
            value = (
                value / max(amplitude, 1e-6) if math.isinf(p.neutral) else p.neutral + amplitude * (value - p.neutral)
            )
        values[p.name] = min(max(value, p.lower), p.upper)
    return values
