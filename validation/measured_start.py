"""The state in which a recording begins, as far as its sensors show it."""

from __future__ import annotations

from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.recording import Recording
from crane_exudyn.vetting import vetted
from ukf.start import start_belief


def measured_start(crane: Crane, engine: Any, recording: Recording) -> np.ndarray:
    """Return the state (nx,) at rest in the pose and at the pressures that the sensors first show.

    A pressure that was not measured follows from the measured one of its cylinder and the balance of moments.

    Args:
        crane: what was recorded.
        engine: one of the crane, such as `ExudynEngine(crane)`.
        recording: with at least one sensor.

    Raises:
        CraneError: no sensor, or a recording that cannot be true of the crane.
    """
    first = vetted(recording.require(sensors=1), crane).first_values()
    mean: np.ndarray = start_belief(crane, engine.static_start, first, recording.noise()).mean
    mean[crane.layout.velocities] = 0.0
    return mean
