"""The plain way to step states through Exudyn: one `SolveDynamic` of one step per state, Exudyn's own Newton
throughout.

It gives what `ExudynEngine.propagate` gives, to solver tolerance, and takes many times longer; it is there to check the
engine against Exudyn's own solver, and to measure what the engine saves.
"""

from __future__ import annotations

import numpy as np

from . import mechanism, reduction
from .crane import Crane
from .errors import CraneError


class SolveDynamicEngine:
    """Propagates states one by one, each by `mbs.SolveDynamic`; same `propagate` as `ExudynEngine`.

    Args:
        crane: the crane; its payload must not change its mass with time.
        tolerance: relative tolerance of Exudyn's Newton method.
    """

    def __init__(self, crane: Crane, tolerance: float = 1e-10) -> None:
        self.crane = crane
        self._container, self.mbs = mechanism.main_system()
        self.plant = mechanism.build(self.mbs, crane, graphics=False)
        self.mbs.Assemble()
        self._tolerance = tolerance

    def propagate(self, states: np.ndarray, inputs: np.ndarray, dt: float, time: float = 0.0) -> np.ndarray:
        """Return the states (n, nx) after one step; arguments as in `ExudynEngine.propagate`."""
        x, w = np.atleast_2d(np.asarray(states, dtype=float)), np.asarray(inputs, dtype=float)
        rows = np.broadcast_to(w[:, None, :] if w.ndim == 2 else w, (2, len(x), w.shape[-1]))
        return np.array([self._step(x[k], rows[0, k].copy(), rows[1, k], dt, time) for k in range(len(x))])

    def _step(self, x: np.ndarray, w0: np.ndarray, w1: np.ndarray, dt: float, time: float) -> np.ndarray:
        plant, data = self.plant, self.mbs.systemData
        self._set_start(x, w0, time)
        plant.inputs[:, self.crane.layout.driving] = w1
        settings = mechanism.settings(dt, dt)
        settings.timeIntegration.startTime, settings.timeIntegration.endTime = time, time + dt
        settings.timeIntegration.generalizedAlpha.computeInitialAccelerations = False  # they are set
        settings.timeIntegration.generalizedAlpha.resetAccelerations = False
        settings.timeIntegration.newton.relativeTolerance = self._tolerance
        if not self.mbs.SolveDynamic(settings):
            raise CraneError(f"{self.crane.name}: Exudyn's solver fails at t = {time:g} s, state {x}.")
        q, v = (np.array(f()) for f in (data.GetODE2Coordinates, data.GetODE2Coordinates_t))
        out = np.empty(x.size)
        arms = reduction.new_arms(plant.topology)
        reduction.arms_of(plant.topology, plant.P[0], plant.inertia[0], q, arms)
        reduction.read_motion(plant.topology, arms, x, q, v, out)
        out[self.crane.layout.pressures] = data.GetODE1Coordinates()
        return out

    def _set_start(self, x: np.ndarray, w: np.ndarray, time: float) -> None:
        """Write one state, with consistent accelerations and pressure rates, as Exudyn's initial configuration."""
        q, v, a, p, dp = mechanism.consistent(self.plant, x, w, time)
        data, initial = self.mbs.systemData, mechanism.exu.ConfigurationType.Initial
        data.SetODE2Coordinates(q, initial)
        data.SetODE2Coordinates_t(v, initial)
        data.SetODE2Coordinates_tt(a, initial)
        data.SetODE1Coordinates(p, initial)
        data.SetODE1Coordinates_t(dp, initial)
