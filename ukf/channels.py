"""What the sensors should read in the filter's states: the crane's measurement function, behind it lagged readings and
estimated biases.

A sensor with a lag shows a first-order follower of its reading, which is a state of its own.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.measurement import Measurement, lagged

from .augment import Extra
from .linear_algebra import all_finite


class Channels:
    """The measurement function of a set of sensors, for states of the engine with lagged readings and extra states
    after them.
    """

    def __init__(self, crane: Crane, names: Sequence[str], engine_states: int, extras: Sequence[Extra] = ()) -> None:
        """Raises CraneError for an unknown sensor, or for a bias of one that is not among the names."""
        self._crane, self._measurement = crane, Measurement.of(crane, names)
        self.names, self.lags = self._measurement.names, self._measurement.lags
        self._engine_states = engine_states
        self._biases = [
            (self._row(extra.name), engine_states + len(self.lags) + k)
            for k, extra in enumerate(extras)
            if extra.kind == "bias"
        ]

    def _row(self, bias: str) -> int:
        channel = bias.removeprefix("bias.")
        if channel not in self.names:
            raise CraneError(
                f"augmented state {bias!r}: there is no sensor {channel!r}. Add the sensor, or leave its bias out."
            )
        return self.names.index(channel)

    def read(self, points: np.ndarray, full: np.ndarray | None = None) -> np.ndarray:
        """Return what the sensors would read without lag (m, k), from points (m, n); `full` as of `observe`."""
        out = self._measurement.read(points, full)
        if self._measurement.has_laws and not all_finite(out):
            self._measurement.check(self._crane, out, points)
        for row, column in self._biases:
            out[:, row] += points[:, column]
        return out

    def observe(self, points: np.ndarray, full: np.ndarray | None = None) -> np.ndarray:
        """Return the measurements (m, k) expected in points (m, n); a sensor with a lag shows its own state.

        full: (k,) which chambers are known to have no void: that of a point counts there as the pressure that is
            missing.
        """
        out = self.read(points, full)
        for k, (row, _) in enumerate(self.lags):
            out[:, row] = points[:, self._engine_states + k]
        return out

    def follow(self, before: np.ndarray, after: np.ndarray, dt: float) -> np.ndarray:
        """Return the lag states (m, lags) after `dt`: first-order followers of readings that are linear between."""
        both, time = np.stack([self.read(before), self.read(after)]), np.array([0.0, dt])
        out = np.empty((len(before), len(self.lags)))
        for k, (row, tau) in enumerate(self.lags):
            out[:, k] = lagged(both[:, :, row], time, tau, first=before[:, self._engine_states + k])[1]
        return out
