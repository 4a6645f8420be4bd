"""Noise covariances of measurement and process: the paper's (32), (33), and a form that does not depend on the step."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_exudyn.errors import CraneError
from crane_exudyn.layout import Layout

#: The paper's tuning: variances of acceleration in rad²/s⁴ and of pressure in Pa² a step
PAPER_ACCELERATION = 0.0175
PAPER_PRESSURE = 259.8e8
#: The paper's start: variances in rad², rad²/s², Pa²; and how many angles, rates and pressures its crane has
PAPER_START = (0.035, 0.087, 22.5e7)
_COUNTS = (2, 2, 4)
#: usual densities: of acceleration by the unit of the coordinate, rad²/s³ and m²/s³, and of pressure, Pa²/s
_ACCELERATION: Mapping[str, float] = {"rad": 1e-4, "m": 1e-4}
_PRESSURE = 1e8


def measurement_noise(standard_deviations: np.ndarray) -> np.ndarray:
    """Return Rv (k, k) of independent sensors, (32), from their standard deviations (k,) in SI."""
    return np.diag(np.asarray(standard_deviations, float) ** 2)


class SensorNoise:
    """Independent noise of sensors, from their standard deviations in SI.

    Attributes:
        std: (k,) standard deviations.
        covariance: (k, k), (32).
        log_peak: (k,) minus the logarithm of each density at its peak; log_peaks: their sum.
    """

    def __init__(self, standard_deviations: Iterable[float]) -> None:
        self.std = np.array(list(standard_deviations))
        self.covariance = measurement_noise(self.std)
        self.log_peak = np.log(np.sqrt(2.0 * np.pi) * self.std)
        self.log_peaks = float(self.log_peak.sum())


def _in_blocks(dt: float, accelerations: Sequence[float], pressures: Sequence[float]) -> np.ndarray:
    """Return the covariance (n, n) of states over `dt` seconds: of each coordinate and its rate Van Loan's integral of
    a white acceleration, by its density; variances of pressures.
    """
    m, block = len(accelerations), np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    out = np.diag([*[0.0] * 2 * m, *pressures])
    for i, density in enumerate(accelerations):
        out[np.ix_((i, i + m), (i, i + m))] = density * block
    return out


def paper_start_covariance() -> np.ndarray:
    """Return the paper's P0 (8, 8): independent angles, rates and pressures."""
    return np.diag(np.repeat(PAPER_START, _COUNTS))


@dataclass(frozen=True)
class ProcessNoise:
    """White-noise densities: what the model does not know, per second, so that any step gives the same growth.

    acceleration: rad²/s³ or m²/s³ (one for each coordinate); pressure: Pa²/s (one for each chamber); creep: of the
    coordinates themselves, rad²/s or m²/s (one for each, or none): a boom that sinks while its pressures stand.
    """

    acceleration: tuple[float, ...]
    pressure: tuple[float, ...]
    creep: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        """Raises CraneError for a density that is none, or a creep of some coordinates only."""
        for name in ("acceleration", "pressure", "creep"):
            densities = getattr(self, name)
            if np.ndim(densities) != 1 or not np.all(np.isfinite(densities) & (np.asarray(densities) >= 0.0)):
                raise CraneError(
                    f"process noise: {name} is {densities}, expected densities in a tuple. Give one for each "
                    "coordinate or chamber, not below zero, or take ProcessNoise.of(crane.layout)."
                )
        if len(self.creep) not in (0, len(self.acceleration)):
            raise CraneError(
                f"process noise: found {len(self.creep)} densities of creep and {len(self.acceleration)} of "
                "acceleration. Give as many of creep, or none."
            )

    @classmethod
    def of(
        cls, layout: Layout, acceleration: Mapping[str, float] = _ACCELERATION, pressure: float = _PRESSURE
    ) -> ProcessNoise:
        """Return the noise of a machine from densities of acceleration by the unit of the coordinate, and of
        pressure.
        """
        return cls(layout.sized(layout.coordinates, acceleration), (pressure,) * len(layout.chambers))

    def covariance(self, dt: float) -> np.ndarray:
        """Return Q (n, n) over `dt` seconds: Van Loan's integral of white acceleration, and white pressure rates."""
        out = _in_blocks(dt, self.acceleration, [density * dt for density in self.pressure])
        for i, density in enumerate(self.creep):
            out[i, i] += density * dt
        return out


@dataclass(frozen=True)
class PaperNoise:
    """The paper's (33): variances of acceleration, rad²/s⁴, and of pressure, Pa², which is added at every step of the
    filter, however long the step is.
    """

    acceleration: float = PAPER_ACCELERATION
    pressure: float = PAPER_PRESSURE

    def covariance(self, dt: float) -> np.ndarray:
        """Return Rw (8, 8) of one step of `dt` seconds, for [z1 z4 ż1 ż4 p1 p2 p3 p4]."""
        return _in_blocks(dt, [self.acceleration] * _COUNTS[0], [self.pressure] * _COUNTS[2])


def added_by(noise: Any, dt: float, sizes: Collection[int], names: Sequence[str]) -> np.ndarray:
    """Return the covariance (n, n) that a process noise adds to the states `names` in `dt` s, n being one of `sizes`.

    Raises:
        CraneError: it has no method `covariance`, or that returns something else.
    """
    mend = (
        "Give ProcessNoise an acceleration for each coordinate and a pressure for each chamber, as "
        "ProcessNoise.of(crane.layout) does, or an object of your own whose method covariance(dt) returns that."
    )
    if not callable(getattr(noise, "covariance", None)):
        raise CraneError(f"noise is of type {type(noise).__name__}, which has no method covariance(dt). {mend}")
    found = np.asarray(noise.covariance(dt), dtype=float)
    if found.shape not in [(n, n) for n in sizes] or not np.isfinite(found).all():
        expected = " or ".join(str((n, n)) for n in sorted(set(sizes)))
        raise CraneError(
            f"noise: its covariance over {dt:g} s has shape {found.shape}, expected {expected} and finite, for "
            f"{' '.join(names)}. {mend}"
        )
    return found
