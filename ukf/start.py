"""The belief to start with: the pose, the rates and the pressures that the sensors first show, else a crane at rest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.layout import Layout
from crane_exudyn.pose import shown_pose, sources
from crane_exudyn.statics import vapour_pressure

from .filter import Belief
from .linear_algebra import cholesky

#: standard deviations of what no sensor shows, by unit
UNSHOWN: Mapping[str, float] = {"rad": 0.1, "m": 0.1, "rad/s": 0.05, "m/s": 0.05, "Pa": 10e5}
#: a machine stands as its file says it begins where no coordinate is further off, rad or m, beside two standard
#: deviations; standard deviation of the lower pressures that the file says for it: a share, and at least so many Pa
_AS_FILED, _FILED, _LEAST_FILED = 0.05, 0.2, 0.5e5
#: by the unit of a coordinate, by how many metres a cylinder is longer for one more of it
_LEVER = {"rad": 0.3, "m": 1.0}
#: by how much correlations at the start may differ from their mirror images
_UNEVEN = 1e-6


def check_start(start: Belief, states: Sequence[str]) -> None:
    """Raise CraneError for a start that is no belief in these states."""
    n, names = len(states), " ".join(states)
    mean, covariance = (np.asarray(getattr(start, part, None)) for part in ("mean", "covariance"))
    if mean.shape != (n,) or covariance.shape != (n, n):
        raise CraneError(
            f"start: mean and covariance have shapes {mean.shape} and {covariance.shape}, expected ({n},) and "
            f"({n}, {n}) for {names}. From variances, np.diag makes a covariance: Belief(mean, np.diag(variances))."
        )
    if not (np.isfinite(mean).all() and np.isfinite(covariance).all()):
        raise CraneError(f"start: mean or covariance of {names} is not finite. Give numbers in SI.")
    for name, variance in zip(states, np.diag(covariance), strict=True):
        if not variance > 0.0:
            raise CraneError(f"start: {name} has variance {variance:g}. Give a small positive one.")
    scale = np.sqrt(np.diag(covariance))
    correlation = np.asarray(covariance / np.outer(scale, scale), float)
    uneven = np.abs(correlation - correlation.T) > _UNEVEN
    if uneven.any():
        one, other = (states[i] for i in np.argwhere(uneven)[0])
        raise CraneError(
            f"start: the covariance of {one} and {other} differs from that of {other} and {one}. Make both equal."
        )
    column = cholesky(correlation, np.empty_like(correlation))
    if column >= 0:
        raise CraneError(
            f"start: the covariance is not positive definite: {states[column]} follows exactly from the states before "
            "it, or is correlated with them more than is possible. Give smaller covariances."
        )


def showing(layout: Layout, coordinate: str) -> tuple[str, ...]:
    """Return the sensors from which a coordinate may be taken: its own, and the length of the cylinder that drives
    it.
    """
    length = layout.lengths[layout.driven.index(coordinate)]
    return (*(n for n, own in layout.sensors.items() if own.place == coordinate), length)


@cache
def rivals(layout: Layout) -> Mapping[str, tuple[str, ...]]:
    """Return what the start is not taken from when a channel is there, and so what must go where the channel shall be
    believed.
    """
    return {n: own.shows[-1:] for n, own in layout.sensors.items() if len(own.shows) > 1} | {
        length: showing(layout, driven)[:-1] for length, driven in zip(layout.lengths, layout.driven, strict=True)
    }


def taken(layout: Layout, first: Mapping[str, float]) -> tuple[str, ...]:
    """Return the channels that the start is taken from: those that are known and have no known rival."""
    known = [n for n, v in first.items() if np.isfinite(v)]
    return tuple(n for n in known if not set(rivals(layout).get(n, ())) & set(known))


def start_belief(
    crane: Crane,
    at_rest: Callable[..., np.ndarray],
    first: Mapping[str, float],
    std: Mapping[str, float],
    pressure: float = UNSHOWN["Pa"],
    begins: bool = False,
) -> Belief:
    """Return the belief (nx, …) from the first measurements `first` (SI, NaN for missing) and their noise `std`.

    `pressure` is the standard deviation of a pressure that no sensor shows and that follows from the balance of
    moments, Pa; `begins` says that a recording begins here, where the machine may be as its file says it begins.

    Coordinates come from their own sensors or the cylinder lengths, else from the crane file. Pressures follow from the
    balance of moments at rest (`at_rest`, an engine's `static_start`): the cylinder's force is known, so one measured
    pressure gives the other. Where the machine stands as its file says it begins, the file also says the lower pressure
    of each cylinder, and what is known better counts more.
    """
    known = {n: v for n, v in first.items() if np.isfinite(v)}
    z, z_std = _pose(crane, known, std)
    lay = crane.layout
    filed = np.broadcast_to(crane.initial.less_loaded_pressure, len(lay.cylinders))
    mean = np.array(at_rest(*z, less_loaded=filed))
    deviation = np.full(mean.size, 0.05)
    for name in lay.coordinates:
        carried = sum(known.get(f"d{n}", 0.0) for n in lay.carriers(name))
        mean[lay.index(f"d{name}")] = known.get(f"d{name}", known.get(f"d{name}_abs", carried) - carried)
    deviation[lay.positions], deviation[lay.pressures] = z_std, pressure
    deviation[lay.velocities] = np.hypot(lay.sized(lay.rates, UNSHOWN), 0.5 * mean[lay.velocities])
    begins = begins and _as_filed(crane, mean, deviation)
    for cylinder, lower in enumerate(filed):
        _set_pressures(crane, cylinder, mean, deviation, known, std, float(lower) if begins else np.inf)
    return Belief(mean, np.diag(deviation**2))


def _as_filed(crane: Crane, mean: np.ndarray, deviation: np.ndarray) -> bool:
    """Whether a machine stands still in the pose in which its file says that it begins."""
    lay = crane.layout
    off = np.abs(mean[lay.positions] - crane.initial.pose)
    return not mean[lay.velocities].any() and bool((off <= _AS_FILED + 2.0 * deviation[lay.positions]).all())


def _pose(crane: Crane, known: Mapping[str, float], std: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    z, lay, deviation = (
        shown_pose(crane, known),
        crane.layout,
        np.array(crane.layout.sized(crane.layout.coordinates, UNSHOWN)),
    )
    for i, (name, source) in enumerate(zip(lay.coordinates, sources(lay, known), strict=True)):
        if source == name:
            deviation[i] = std[name]
        elif source == f"{name}_abs":
            carriers = [lay.index(n) for n in lay.carriers(name)]
            deviation[i] = np.hypot(std[source], np.linalg.norm(deviation[carriers]))
        elif source:
            deviation[i] = 5 * std[source] / _LEVER[lay.unit_of(name)]
    return z, np.minimum(2.0 * deviation, 0.2)  # a first sample may be off by more than one standard deviation


def _set_pressures(
    crane: Crane,
    cylinder: int,
    mean: np.ndarray,
    deviation: np.ndarray,
    known: Mapping[str, float],
    std: Mapping[str, float],
    filed: float,
) -> None:
    """Fill in the pressures of one cylinder: measured ones as measured, a missing one from the cylinder's static
    force and, where it is the lower one and the file says it (`filed`, Pa, infinite for nothing), from the file.
    """
    name, channels = crane.layout.cylinders[cylinder], crane.layout.sides[cylinder]
    area = crane.areas(name)
    at = crane.layout.pressures_of(cylinder).start
    force = mean[at] * area[0] - mean[at + 1] * area[1]
    for side, channel in enumerate(channels):
        if channel in known:
            mean[at + side], deviation[at + side] = known[channel], 2.0 * std[channel]
    if (channels[0] in known) != (channels[1] in known):
        other = 1 if channels[0] in known else 0
        measured = mean[at + 1 - other] * area[1 - other]
        balance = (measured - force) / area[1] if other == 1 else (measured + force) / area[0]
        balance = max(balance, vapour_pressure(crane), crane["supply.tank_pressure"])
        spread = max(_FILED * filed, _LEAST_FILED) if mean[at + other] <= 1.001 * filed < np.inf else np.inf
        share = 1.0 / (1.0 + (spread / deviation[at + other]) ** 2)
        mean[at + other] = balance if share == 0.0 else balance + share * (filed - balance)
        deviation[at + other] *= np.sqrt(1.0 - share)
