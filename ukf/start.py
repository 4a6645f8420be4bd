"""The belief to start with: the pose, the rates and the pressures that the sensors first show, else a crane at rest."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.geometry import cylinder_lengths
from crane_exudyn.statics import vapour_pressure

from .filter import Belief

#: standard deviations of what no sensor shows: rad, rad/s, Pa
ANGLE, RATE, PRESSURE = 0.1, 0.05, 10e5


#: what the start is not taken from when the channel is there, and so what must go where the channel shall be believed
RIVALS = {"z4_abs": ("z4",), "s1": ("z1",), "s2": ("z4", "z4_abs"), "dz4_abs": ("dz4",)}


def taken(first: Mapping[str, float]) -> tuple[str, ...]:
    """Return the channels that the start is taken from: those that are known and have no known rival."""
    known = [n for n, v in first.items() if np.isfinite(v)]
    return tuple(n for n in known if not set(RIVALS.get(n, ())) & set(known))


def start_belief(crane: Crane, engine: Any, first: Mapping[str, float], std: Mapping[str, float]) -> Belief:
    """Return the belief (8, …) from the first measurements `first` (SI, NaN for missing) and their noise `std`.

    Angles come from z1, z4, z4_abs or the cylinder lengths, else from the crane file. Pressures follow from the balance
    of moments at rest (`engine.static_start`): the cylinder's force is known, so one measured pressure gives the other.
    """
    known = {n: v for n, v in first.items() if np.isfinite(v)}
    z, z_std = _angles(crane, known, std)
    nx = len(engine.state_names)
    mean, deviation = np.zeros(nx), np.full(nx, 0.05)
    mean[:] = engine.static_start(z[0], z[1])
    mean[2:4] = [known.get("dz1", 0.0), known.get("dz4", known.get("dz4_abs", 0.0) - known.get("dz1", 0.0))]
    deviation[:8] = [*z_std, *np.hypot(RATE, 0.5 * mean[2:4]), *[PRESSURE] * 4]
    for cylinder in (0, 1):
        _set_pressures(crane, cylinder, mean, deviation, known, std)
    return Belief(mean, np.diag(deviation**2))


def _angles(crane: Crane, known: Mapping[str, float], std: Mapping[str, float]) -> tuple[np.ndarray, np.ndarray]:
    z = np.array([crane.initial.z1, crane.initial.z4])
    deviation = np.array([ANGLE, ANGLE])
    if "z1" in known:
        z[0], deviation[0] = known["z1"], std["z1"]
    elif "s1" in known:
        z[0], deviation[0] = _angle_of_length(crane, z, 0, known["s1"]), 5 * std["s1"] / 0.3
    if "z4" in known:
        z[1], deviation[1] = known["z4"], std["z4"]
    elif "z4_abs" in known:
        z[1], deviation[1] = known["z4_abs"] - z[0], np.hypot(std["z4_abs"], deviation[0])
    elif "s2" in known:
        z[1], deviation[1] = _angle_of_length(crane, z, 1, known["s2"]), 5 * std["s2"] / 0.3
    return z, np.minimum(2.0 * deviation, 0.2)  # a first sample may be off by more than one standard deviation


def _angle_of_length(crane: Crane, z: np.ndarray, i: int, length: float) -> float:
    """Return the angle i nearest to z at which cylinder i has this length."""
    grid = np.tile(z, (4001, 1))
    grid[:, i] = z[i] + np.linspace(-1.5, 1.5, 4001)
    off = np.abs(cylinder_lengths(crane, grid)[:, i] - length)
    off = np.where(np.isfinite(off), off, np.inf)
    good = np.flatnonzero(off < off.min() + 1e-3)
    return float(grid[good[np.argmin(np.abs(grid[good, i] - z[i]))], i])


def _set_pressures(
    crane: Crane,
    cylinder: int,
    mean: np.ndarray,
    deviation: np.ndarray,
    known: Mapping[str, float],
    std: Mapping[str, float],
) -> None:
    """Fill in the pressures of one cylinder: measured ones as measured, a missing one from the cylinder's static force."""
    name = ("lift", "tilt")[cylinder]
    bore, rod = crane[f"cylinders.{name}.bore"], crane[f"cylinders.{name}.rod"]
    area = np.pi / 4 * np.array([bore**2, bore**2 - rod**2])
    at = 4 + 2 * cylinder
    force = mean[at] * area[0] - mean[at + 1] * area[1]
    channels = (f"p{at - 3}", f"p{at - 2}")
    for side, channel in enumerate(channels):
        if channel in known:
            mean[at + side], deviation[at + side] = known[channel], 2.0 * std[channel]
    if (channels[0] in known) != (channels[1] in known):
        other = 1 if channels[0] in known else 0
        measured = mean[at + 1 - other] * area[1 - other]
        balance = (measured - force) / area[1] if other == 1 else (measured + force) / area[0]
        mean[at + other] = max(balance, vapour_pressure(crane), crane["supply.tank_pressure"])
