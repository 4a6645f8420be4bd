"""Colours of a picture: of cranes beside each other, and of values on a scale that ends at a round number."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from .errors import CraneError
from .layout import Layout
from .render_shapes import Color
from .render_text import MAPS, READ, Colour
from .trajectory import Trajectory

#: what a crane of each kind looks like beside others; light, middle and dark, so that they differ without colour
GHOSTS = {"measured": (0.90, 0.90, 0.88), "simulated": (0.95, 0.55, 0.20), "estimated": (0.05, 0.38, 0.68)}
#: beside a crane whose colours mean something: blue greys, which no scale has, light, middle and dark
PLAIN_GHOSTS = ((0.80, 0.82, 0.85), (0.50, 0.57, 0.68), (0.26, 0.31, 0.40))
OTHER_GHOSTS = ((0.0, 0.50, 0.36), (0.55, 0.35, 0.65), (0.80, 0.68, 0.20), (0.30, 0.25, 0.22))
#: the end of a scale of residuals at least, in SI: less is rounding
_LEAST = {"Pa": 1e5, "rad": math.radians(0.1), "m": 1e-3}
#: of oil and bodies whose value is not known, and of arrows
NO_VALUE: Color = (0.75, 0.75, 0.75, 1.0)
MARK: Color = (0.80, 0.0, 0.45, 1.0)


def map_color(colour: Colour | None, fraction: float) -> Color:
    """Return the colour at a fraction of the scale for pressures or residuals; beyond its ends that of the end."""
    from matplotlib import colormaps

    r, g, b, _ = colormaps[MAPS[colour or "pressure"]](min(max(fraction, 0.0), 1.0))
    return (float(r), float(g), float(b), 1.0)


def scale_ends(layout: Layout, trajectories: Sequence[Trajectory], colour: Colour | None) -> dict[str, float]:
    """Return by unit the values in SI at which the colours end: numbers that are round as people read them, at or above
    the greatest.
    """
    if colour is None:
        return {}
    main = trajectories[0]
    if colour == "pressure":
        return {"Pa": _round_up(max(float(np.nanmax(v, initial=0.0)) for v in main.pressures.values()), "Pa")}
    other, found = trajectories[1], {"Pa": [_LEAST["Pa"]]}
    both = [p for p in layout.chambers if p in main.pressures and p in other.pressures]
    pairs = [(name, main.positions[:, i], other.positions[:, i]) for i, name in enumerate(layout.coordinates)]
    times = np.array([t for t in np.union1d(main.time, other.time) if main.covers(t) and other.covers(t)])
    if not times.size:
        raise CraneError(
            f"Colours by residual need a time that both runs cover, but {main.label!r} goes from {main.time[0]:g} to "
            f"{main.time[-1]:g} s and {other.label!r} from {other.time[0]:g} to {other.time[-1]:g} s. Give runs that "
            "overlap in time."
        )
    for name, mine, its in (*pairs, *((p, main.pressures[p], other.pressures[p]) for p in both)):
        difference = np.abs(np.interp(times, main.time, mine) - np.interp(times, other.time, its))
        found.setdefault(layout.unit_of(name), [_LEAST[layout.unit_of(name)]]).append(
            float(np.nanmax(difference, initial=0.0))
        )
    return {unit: _round_up(max(values), unit) for unit, values in found.items()}


def _round_up(value: float, unit: str) -> float:
    """Return the next number that is round as people read it: 1, 1.5, 2, 3, 4, 5, 6, 8 or 10 times a power of ten."""
    factor = READ[unit][0]
    power = 10.0 ** math.floor(math.log10(max(value * factor, 1e-6)))
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * power for step in steps if step * power >= value * factor * (1.0 - 1e-12)) / factor
