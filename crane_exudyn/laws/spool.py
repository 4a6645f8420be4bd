"""Spool dynamics, equation (16)."""

import math

from ..compiled import njit


@njit
def spool_step(position: float, start: float, end: float, dt: float, time_constant: float) -> float:
    """Return the spool position after `dt`: the exact solution of dU/dt = (U_ref - U) / tau, (16), for linear U_ref.

    Args:
        position: spool position at the start, in [-1, 1].
        start, end: U_ref at start and end of the step, linear between.
        dt: length of the step in s; 0 leaves the spool where it is.
        time_constant: tau in s; 0 lets the spool follow without lag.
    """
    if dt <= 0.0:
        return position
    if time_constant <= 0.0:
        return end
    lag = (end - start) / dt * time_constant  # U trails a ramp by slope * tau
    return end - lag + (position - start + lag) * math.exp(-dt / time_constant)
