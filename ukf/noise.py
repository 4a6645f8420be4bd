"""Noise covariances of measurement and process: the paper's (32), (33), and a form that does not depend on the step."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: The paper's tuning: variances of acceleration in rad²/s⁴ and of pressure in Pa² a step
PAPER_ACCELERATION = 0.0175
PAPER_PRESSURE = 259.8e8
#: The paper's start: variances in rad², rad²/s², Pa²
PAPER_START = (0.035, 0.087, 22.5e7)


def measurement_noise(standard_deviations: np.ndarray) -> np.ndarray:
    """Return Rv (k, k) of independent sensors, (32), from their standard deviations (k,) in SI."""
    return np.diag(np.asarray(standard_deviations, float) ** 2)


def paper_process_noise(
    dt: float, acceleration: float = PAPER_ACCELERATION, pressure: float = PAPER_PRESSURE
) -> np.ndarray:
    """Return Rw (8, 8) as (33) prints it, for [z1 z4 ż1 ż4 p1 p2 p3 p4].

    The block of an angle and its rate is σ² [[dt³, dt²], [dt², dt]]; the pressure variance stands on the diagonal as
    it is, whatever the step. `acceleration` in rad²/s⁴ and `pressure` in Pa² are variances.
    """
    out = np.zeros((8, 8))
    for i in (0, 1):
        out[np.ix_((i, i + 2), (i, i + 2))] = acceleration * np.array([[dt**3, dt**2], [dt**2, dt]])
    out[range(4, 8), range(4, 8)] = pressure
    return out


def paper_start_covariance() -> np.ndarray:
    """Return the paper's P0 (8, 8): independent angles, rates and pressures."""
    angle, rate, pressure = PAPER_START
    return np.diag([angle, angle, rate, rate, pressure, pressure, pressure, pressure])


@dataclass(frozen=True)
class ProcessNoise:
    """White-noise densities: what the model does not know, per second, so that any step gives the same growth.

    acceleration: rad²/s³ (one for each of z̈1, z̈4); pressure: Pa²/s (one for each chamber).
    """

    acceleration: tuple[float, float] = (1e-4, 1e-4)
    pressure: tuple[float, float, float, float] = (1e8, 1e8, 1e8, 1e8)

    def covariance(self, dt: float) -> np.ndarray:
        """Return Q (8, 8) over `dt` seconds: Van Loan's integral of white acceleration, and white pressure rates."""
        out = np.zeros((8, 8))
        for i, density in enumerate(self.acceleration):
            block = density * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            out[np.ix_((i, i + 2), (i, i + 2))] = block
        out[range(4, 8), range(4, 8)] = np.asarray(self.pressure) * dt
        return out


@dataclass(frozen=True)
class PaperNoise:
    """The paper's (33): its pressure variance is added at every step of the filter, however long the step is."""

    acceleration: float = PAPER_ACCELERATION
    pressure: float = PAPER_PRESSURE

    def covariance(self, dt: float) -> np.ndarray:
        """Return Rw (8, 8) of one step of `dt` seconds."""
        return paper_process_noise(dt, self.acceleration, self.pressure)
