"""ExudynEngine: states of the crane in, states out; one or many cranes at once, by a kept Exudyn system."""

from __future__ import annotations

import math
from collections import OrderedDict
from typing import Any

import numpy as np

from . import geometry, mechanism, statics, trapezoidal
from .crane import Crane
from .effects import hooks
from .errors import CraneError

STATE_NAMES = ("z1", "z4", "dz1", "dz4", "p1", "p2", "p3", "p4")
SWING_NAMES = ("theta", "dtheta")
#: Newton stops when the error left is below this fraction of trapezoidal.RATE_UNIT and PRESSURE_UNIT (1e-9 rad/s, 0.01 Pa)
TOLERANCE = 1e-9
_MOST_ITERATIONS = 15
#: a step that Newton cannot solve is halved this often before the engine gives up
_MOST_HALVINGS = 6
#: systems that are kept for further steps (batch sizes, payload masses)
_MOST_SYSTEMS = 6


class ExudynEngine:
    """Propagates states of one crane description through Exudyn.

    Every step is a pure function of what it is given: the state is written to the kept Exudyn system, Exudyn assembles
    the residual at each Newton iterate, and nothing of an earlier step enters.

    Args:
        crane: the crane.
        size: batch size that is built at once; others are built when first asked for.

    Example:
        >>> engine = ExudynEngine(Crane.load("patu655"))
        >>> x = engine.static_start(0.17, -0.7)
        >>> engine.propagate(x[None], np.array([[0.1, 0, np.nan, np.nan]] * 2), 1e-3)
    """

    def __init__(self, crane: Crane, size: int = 1) -> None:
        self.crane = crane
        self._P, self._E = crane.parameter_vector(), crane.effect_vector()
        self._swings = bool(hooks.pendulum(self._E)[0] > 0.0)
        self.state_names = STATE_NAMES + (SWING_NAMES if self._swings else ())
        self._systems: OrderedDict[tuple[int, float], _System] = OrderedDict()
        self._system(size, 0.0)

    def __repr__(self) -> str:
        return f"<ExudynEngine of {self.crane!r}, states {' '.join(self.state_names)}>"

    def static_start(self, z1: float, z4: float, less_loaded: float | Any = 20e5) -> np.ndarray:
        """Return the state (nx,) at rest with valves closed; see `statics.static_start`."""
        return statics.static_start(self.crane, z1, z4, less_loaded)

    def propagate(self, states: np.ndarray, inputs: np.ndarray, dt: float, time: float = 0.0) -> np.ndarray:
        """Return the states (n, nx) after one step of the trapezoidal rule; pure, repeats bit for bit.

        Args:
            states: (n, nx).
            inputs: (2, 4) or (2, n, 4): w = [U1 U2 pp pt] at the start and the end of the step.
            dt: step in s.
            time: start of the step in s; effects that begin at a time need it.

        Raises:
            CraneError: wrong shapes, a pose that cannot be reached, an end of stroke, or no convergence.
        """
        x = np.ascontiguousarray(states, dtype=float)
        if x.ndim != 2 or x.shape[1] != len(self.state_names):
            raise CraneError(
                f"propagate: states have shape {x.shape}, expected (n, {len(self.state_names)}) for "
                f"{' '.join(self.state_names)}. A single state is states[None]."
            )
        if not dt > 0.0:
            raise CraneError(f"propagate: dt = {dt:g} s is not positive.")
        w = np.asarray(inputs, dtype=float)
        if w.shape not in ((2, 4), (2, len(x), 4)):
            raise CraneError(
                f"propagate: inputs have shape {w.shape}, expected (2, 4) or (2, {len(x)}, 4): [U1 U2 pp pt] at the "
                "start and the end of the step."
            )
        rows = np.empty((2, len(x), 4))
        rows[...] = w[:, None, :] if w.ndim == 2 else w
        return self._step(x, rows[0], rows[1], dt, time, 0)

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, *, step: float = 1e-3) -> np.ndarray:
        """Return the states (N, nx) at `time`, from x0 at time[0].

        Args:
            x0: (nx,) state at time[0].
            time: (N,) increasing, in s; need not be even.
            inputs: (N, 4) w = [U1 U2 pp pt] at `time`, linear between.
            step: largest inner step in s; every interval is cut into equal steps no longer than it.

        Raises:
            CraneError: wrong shapes, time that does not increase, or what `propagate` raises.
        """
        t, w = np.asarray(time, dtype=float), np.asarray(inputs, dtype=float)
        _check_grid(t, w, step)
        x = np.ascontiguousarray(x0, dtype=float)[None].copy()
        if x.shape[1] != len(self.state_names):
            raise CraneError(f"simulate: x0 has {x.shape[1]} numbers, expected {len(self.state_names)}.")
        out = np.empty((t.size, x.shape[1]))
        out[0] = x[0]
        for k in range(t.size - 1):
            span = t[k + 1] - t[k]
            parts = max(1, math.ceil(span / step - 1e-9))
            h = span / parts
            for i in range(parts):
                a, b = w[k] + (w[k + 1] - w[k]) * (i / parts), w[k] + (w[k + 1] - w[k]) * ((i + 1) / parts)
                x = self._step(x, a[None], b[None], h, t[k] + i * h, 0)
            out[k + 1] = x[0]
        return out

    def terms(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
        """Return every term of the balances at one state by name; see `statics.terms`."""
        return statics.terms(self.crane, state, w, time)

    def residual(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, np.ndarray]:
        """Return what Exudyn itself assembles at one state with consistent accelerations, for checks.

        Returns:
            "mass": (nq, nq), "force": (nq,) applied forces, "joint": rows of G v, "joint_jacobian": (rows, nq),
            "pressure_rates": (4,), "q", "v", "a": redundant coordinates and their rates.
        """
        return self._system(1, time).inspect(np.asarray(state, dtype=float), np.asarray(w, dtype=float), time)

    # -- one step ------------------------------------------------------------------------------------------------

    def _system(self, size: int, time: float) -> _System:
        """Return the kept system of a batch size and the payload's mass at a time; build it where there is none."""
        mass = float(hooks.payload_mass(self._E, time, self.crane["payload.mass"]))
        key = (size, mass)
        system = self._systems.get(key)
        if system is None:
            system = self._systems[key] = _System(self.crane, size, time)
            if len(self._systems) > _MOST_SYSTEMS:
                self._systems.popitem(last=False)
        else:
            self._systems.move_to_end(key)
        return system

    def _step(self, x: np.ndarray, w0: np.ndarray, w1: np.ndarray, h: float, time: float, halved: int) -> np.ndarray:
        """Take one step, or two of half the length where Newton's method does not converge."""
        system = self._system(len(x), time + h)
        before = self._system(len(x), time)
        problem, crane, out = system.step(x, w0, w1, h, time, before.plant.inertia)
        if problem == "":
            return out
        if halved < _MOST_HALVINGS and problem != "unreachable":
            middle = 0.5 * (w0 + w1)
            x = self._step(x, w0, middle, 0.5 * h, time, halved + 1)
            return self._step(x, middle, w1, 0.5 * h, time + 0.5 * h, halved + 1)
        raise self._failure(problem, x[crane], time, h, halved)

    def _failure(self, problem: str, state: np.ndarray, time: float, h: float, halved: int) -> CraneError:
        if problem == "unreachable":
            return geometry.unreachable(f"{self.crane.name}, t = {time:.6g} s", state[0], state[1])
        values = ", ".join(f"{n} = {v:.6g}" for n, v in zip(self.state_names, state, strict=True))
        tried = f"Tried {halved} halvings of the step, down to {h:.3g} s, {_MOST_ITERATIONS} Newton iterations each."
        mend = {
            "newton": "Look for values that make the equations stiff or impossible, such as a spring far too hard.",
            "singular": "The mechanism is singular there: brackets in one line, or a body without inertia.",
        }.get(
            problem,
            "Add the effect end_stop to this cylinder, shorten the command, or mend the lengths of the cylinder.",
        )
        what = {
            "newton": "Newton's method does not converge",
            "singular": "the equations of motion are singular",
        }.get(problem, problem)
        return CraneError(f"{self.crane.name}: {what} at t = {time:.6g} s, {values}. {tried} {mend}")


def _check_grid(t: np.ndarray, w: np.ndarray, step: float) -> None:
    if t.ndim != 1 or t.size < 1 or w.shape != (t.size, 4):
        raise CraneError(
            f"simulate: time has shape {t.shape} and inputs {w.shape}, expected (N,) and (N, 4) with [U1 U2 pp pt]."
        )
    back = np.flatnonzero(~(np.diff(t) > 0.0))
    if back.size:
        k = int(back[0])
        raise CraneError(
            f"simulate: time does not increase from sample {k} ({t[k]:g} s) to sample {k + 1} ({t[k + 1]:g} s). Sort the "
            "samples and remove repeated ones."
        )
    if not step > 0.0:
        raise CraneError(f"simulate: step = {step:g} s is not positive.")


class _System:
    """A kept Exudyn system of n cranes and the solver that assembles its residuals."""

    def __init__(self, crane: Crane, size: int, time: float) -> None:
        self._container, self.mbs = mechanism.main_system()
        self.plant = mechanism.build(self.mbs, crane, states=np.tile(mechanism.start_pose(crane), (size, 1)), time=time)
        self.mbs.Assemble()
        self._settings = mechanism.settings(1e-3, 1.0, sparse=size > 1)
        self.solver = mechanism.exu.MainSolverImplicitSecondOrder()
        if not self.solver.InitializeSolver(self.mbs, self._settings):
            raise CraneError(f"{crane.name}: Exudyn cannot initialise its solver: {self.solver.GetErrorString()}")
        self.solver.it.currentStepSize = 1.0  # Exudyn scales the rows of ODE2 by beta h^2; h is not used otherwise
        self._scale = 0.25
        width = self.plant.coordinates
        self._q, self._v, self._a = np.zeros((size, width)), np.zeros((size, width)), np.zeros((size, width))
        self._p, self._dp, self._p0, self._dp0 = (np.zeros((size, 4)) for _ in range(4))

    def step(
        self, x: np.ndarray, w0: np.ndarray, w1: np.ndarray, h: float, time: float, inertia0: np.ndarray
    ) -> tuple[str, int, np.ndarray]:
        """Return (problem, crane, states): problem is "" where the step was solved."""
        plant = self.plant
        out = np.empty_like(x)
        flag, crane = trapezoidal.predict(
            plant.P,
            plant.E,
            time,
            h,
            inertia0,
            x,
            w0,
            self._q,
            self._v,
            self._a,
            self._p,
            self._dp,
            self._p0,
            self._dp0,
        )
        if flag < 0.0:
            return ("unreachable" if flag == trapezoidal.UNREACHABLE else "singular"), crane, out
        plant.inputs[...] = w1
        self.mbs.systemData.SetTime(time + h)
        last = math.inf
        for iteration in range(_MOST_ITERATIONS):
            size, crane = self._newton(h)
            if not 0.0 <= size < math.inf:
                return ("singular" if size == trapezoidal.SINGULAR else "newton"), crane, out
            # the error left after this correction is about its size times the last contraction
            if size <= TOLERANCE or (iteration > 0 and size < last and size * size / last <= TOLERANCE):
                return self._finished(x, out)
            last = size
        return "newton", crane, out

    def _newton(self, h: float) -> tuple[float, int]:
        plant = self.plant
        residual = self._residual()
        return trapezoidal.correct(
            plant.P, plant.E, h, self._scale, plant.inertia, plant.inputs, residual,
            self._q, self._v, self._a, self._p, self._dp, self._p0, self._dp0,
        )  # fmt: skip

    def _residual(self) -> np.ndarray:
        """Return Exudyn's residual [M a - f, rates - dp, G v] at the present iterate."""
        data = self.mbs.systemData
        data.SetODE2Coordinates(self._q.ravel())
        data.SetODE2Coordinates_t(self._v.ravel())
        data.SetODE2Coordinates_tt(self._a.ravel())
        data.SetODE1Coordinates(self._p.ravel())
        data.SetODE1Coordinates_t(self._dp.ravel())
        self.solver.ComputeNewtonResidual(self.mbs, self._settings)
        return self.solver.GetSystemResidual()

    def _finished(self, x: np.ndarray, out: np.ndarray) -> tuple[str, int, np.ndarray]:
        plant = self.plant
        beyond = trapezoidal.finish(plant.P, plant.E, plant.inertia, x, self._q, self._v, self._p, out)
        if beyond < 0:
            return "", 0, out
        return statics.stroke_message(plant.crane, out[beyond]), beyond, out
