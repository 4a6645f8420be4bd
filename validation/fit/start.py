"""First guesses of a machine's state along a recording, from the measurements alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.pose import shown_pose, sources
from crane_exudyn.statics import vapour_pressure

from ..semi_recursive.engine import SemiRecursiveEngine
from .data import FitData, Samples
from .windows import Window

#: seconds to either side over which an angle and its rate, or a pressure, are averaged
_ANGLE_SPAN, _PRESSURE_SPAN = 0.12, 0.03
#: s over which a pose that moves on is compared with itself for its rates
_SOON = 0.01


def knots_of(crane: Crane, data: FitData, windows: Sequence[Window]) -> np.ndarray:
    """Return guessed states (K, nx) at the start of each window.

    Coordinates and rates come from straight lines through the samples around, of angles or of cylinders' lengths,
    pressures from their mean; a pressure that is not measured is the one that balances the load at rest.
    """
    samples = {s.channel: s for s in data.samples if len(s.values)}
    engine = SemiRecursiveEngine(crane.nominal())
    return np.array([_state(crane, engine, data, samples, data.time[w.start]) for w in windows])


def _state(
    crane: Crane, engine: SemiRecursiveEngine, data: FitData, samples: dict[str, Samples], t: float
) -> np.ndarray:
    lay = crane.layout
    lines = {name: _line(data, samples[name], t) for name in sources(lay, samples) if name}
    z = shown_pose(crane, {name: value for name, (value, _) in lines.items()})
    soon = shown_pose(crane, {name: value + _SOON * slope for name, (value, slope) in lines.items()})
    dz = (soon - z) / _SOON
    vacuum, rest = vapour_pressure(crane), engine.static_start(*z)[lay.pressures]
    pressures = [_mean(data, samples.get(name), t) for name in lay.chambers]
    for c, name in enumerate(lay.cylinders):
        _complete(crane, name, pressures, rest, c)
    return np.array([*z, *dz, *(max(p or 0.0, vacuum) for p in pressures)])


def _complete(crane: Crane, name: str, pressures: list[float | None], rest: np.ndarray, c: int) -> None:
    """Fill in the pressures of cylinder c that are not measured from those of all chambers at rest."""
    Aa, Ab = crane.areas(name)
    a, b = 2 * c, 2 * c + 1
    force = rest[a] * Aa - rest[b] * Ab
    pa, pb = pressures[a], pressures[b]
    if pa is None and pb is None:
        pressures[a], pressures[b] = float(rest[a]), float(rest[b])
    elif pa is None and pb is not None:
        pressures[a] = (force + pb * Ab) / Aa
    elif pb is None and pa is not None:
        pressures[b] = (pa * Aa - force) / Ab


def _near(data: FitData, sample: Samples, t: float, span: float) -> tuple[np.ndarray, np.ndarray]:
    """Return times against t and values of the samples that are at most `span` (s) from t, at least of the four nearest
    ones.
    """
    reach = np.array([-span, span]) + (t - data.time[0])
    first, last = np.searchsorted(sample.index, reach / data.step + [-1.0, 2.0])
    around = slice(max(first - 4, 0), last + 4)
    times = data.time[sample.index[around]] + sample.fraction[around] * data.step - t
    near = np.abs(times) <= span
    if near.sum() < 4:
        near = np.zeros(len(times), dtype=bool)
        near[np.argsort(np.abs(times))[:4]] = True
    return times[near], sample.values[around][near]


def _line(data: FitData, sample: Samples, t: float) -> tuple[float, float]:
    slope, value = np.polyfit(*_near(data, sample, t, _ANGLE_SPAN), 1)
    return float(value), float(slope)


def _mean(data: FitData, sample: Samples | None, t: float) -> float | None:
    return None if sample is None else float(np.mean(_near(data, sample, t, _PRESSURE_SPAN)[1]))
