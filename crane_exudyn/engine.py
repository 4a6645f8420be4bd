"""ExudynEngine: states of the crane in, states out; one or many cranes at once, by a kept Exudyn system."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Iterator, Mapping
from contextlib import contextmanager, nullcontext
from functools import partial
from typing import Any

import numpy as np

from . import faulty_laws, geometry, mechanism, reduction, statics, trapezoidal
from .crane import Crane, checked_crane
from .description import number
from .effects import hooks
from .errors import CraneError, counted
from .item_values import ItemValues, round_to_spread
from .row_values import RowValues
from .static_start import static_start
from .step_control import MOST_HALVINGS, enough_to_grow, is_rough, limit, next_level

_MOST_ITERATIONS = 15
#: systems that are kept for further steps, one a batch size
_MOST_SYSTEMS = 6


class ExudynEngine:
    """Propagates states of one crane description through Exudyn.

    Every step is a pure function of what it is given: the state is written to the kept Exudyn system, Exudyn assembles
    the residual at each Newton iterate, and nothing of an earlier step enters.

    Args:
        crane: the crane.
        size: batch size that is built at once; others are built when first asked for.
        accuracy: local error that a step may have, in units of `step_control.*_ERROR`; a step beyond it is halved.

    Example:
        >>> engine = ExudynEngine(Crane.load("patu655"))
        >>> x = engine.static_start(0.17, -0.7)
        >>> engine.propagate(x[None], np.array([[0.1, 0, np.nan, np.nan]] * 2), 1e-3)
    """

    def __init__(self, crane: Crane, size: int = 1, *, accuracy: float = 1.0) -> None:
        self.crane = checked_crane(crane, "ExudynEngine")
        self.accuracy = number(accuracy, "ExudynEngine: accuracy", "")
        if not self.accuracy > 0.0:
            raise CraneError(
                f"ExudynEngine: accuracy = {self.accuracy:g} is not positive. Give a larger one, such as 1."
            )
        self._P, self._E = crane.parameter_vector(), crane.effect_vector()
        self._row_values, self.state_names = RowValues(crane), statics.state_names(crane)
        self._systems: OrderedDict[int, System] = OrderedDict()
        #: steps that were halved so far, because their local error was too large or Newton's method did not converge
        self.halved = 0
        self._system(counted(size, "ExudynEngine: size"))

    def __repr__(self) -> str:
        return f"<ExudynEngine of {self.crane!r}, states {' '.join(self.state_names)}>"

    def static_start(self, *pose: Any, less_loaded: Any = None) -> np.ndarray:
        """Return the state (nx,) at rest with valves closed; see `static_start`."""
        return static_start(self.crane, *pose, less_loaded=less_loaded)

    def propagate(
        self,
        states: np.ndarray,
        inputs: np.ndarray,
        dt: float,
        time: float = 0.0,
        parameters: Mapping[str, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Return the states (n, nx) after one step of the trapezoidal rule; pure, repeats bit for bit.

        Args:
            states: (n, nx).
            inputs: (2, m) or (2, n, m): the m inputs w = [spools, pp, pt] at the start and the end of the step.
            dt: step in s.
            time: start of the step in s; effects that begin at a time need it.
            parameters: {name: (n,)}, what differs from row to row (SI): nominal parameters such as "payload.mass",
                parameters of effects such as "internal_leakage@lift.k", and disturbances such as "flow.p1".

        Raises:
            CraneError: wrong shapes, a spool position that is missing or far beyond ±1, parameters that no crane has, a
                pose that cannot be reached, an end of stroke, or no convergence.
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
        names = self.crane.layout.inputs
        if w.shape not in ((2, len(names)), (2, len(x), len(names))):
            raise CraneError(
                f"propagate: inputs have shape {w.shape}, expected (2, {len(names)}) or (2, {len(x)}, {len(names)}): "
                f"[{' '.join(names)}] at the "
                "start and the end of the step."
            )
        statics.check_spools(self.crane.layout.voltages, w, step=True)
        rows = np.zeros((2, len(x), len(self.crane.layout.all_inputs)))
        rows[:, :, self.crane.layout.driving] = w[:, None, :] if w.ndim == 2 else w
        P, E = self._rows(parameters, rows) if parameters else (None, None)
        return self._step(x, rows[0], rows[1], dt, time, P, E)

    def _rows(self, parameters: Mapping[str, np.ndarray], w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return P (n, .), rounded for rough steps, and E (n, .) with what differs from row to row; disturbances go
        into w (2, n, .).
        """
        P, E = np.tile(self._P, (w.shape[1], 1)), np.tile(self._E, (w.shape[1], 1))
        self._row_values.fill(parameters, P, E, w)
        if is_rough(self.accuracy):
            round_to_spread(P)
        return P, E

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, *, step: float = 1e-3) -> np.ndarray:
        """Return the states (N, nx) at `time`, from x0 at time[0].

        Args:
            x0: (nx,) state at time[0].
            time: (N,) increasing, in s; need not be even.
            inputs: (N, m) w = [spools, pp, pt] at `time`, linear between.
            step: largest inner step in s; every interval is cut into equal steps no longer than it.

        Raises:
            CraneError: wrong shapes, time that does not increase, or what `propagate` raises.
        """
        t, w = np.asarray(time, dtype=float), np.asarray(inputs, dtype=float)
        _check_grid(self.crane.layout.inputs, t, w, step)
        statics.check_spools(self.crane.layout.voltages, w, step=False)
        driving = self.crane.layout.driving
        x = statics.checked_state(self.crane, x0)[None].copy()
        rows = np.zeros((2, 1, len(self.crane.layout.all_inputs)))
        out = np.empty((t.size, x.shape[1]))
        out[0], level = x[0], 0
        for k in range(t.size - 1):
            span = t[k + 1] - t[k]
            parts = max(1, math.ceil(span / step - 1e-9))
            h = span / parts
            for i in range(parts):
                rows[0, 0, driving] = w[k] if i == 0 else w[k] + (w[k + 1] - w[k]) * (i / parts)
                rows[1, 0, driving] = w[k + 1] if i + 1 == parts else w[k] + (w[k + 1] - w[k]) * ((i + 1) / parts)
                x, level = self._in_parts(x, rows[0], rows[1], h, t[k] + i * h, level)
            out[k + 1] = x[0]
        return out

    def terms(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
        """Return every term of the balances at one state by name; see `statics.terms`."""
        return statics.terms(self.crane, state, w, time)

    def object_moments(self, states: np.ndarray, time: np.ndarray) -> np.ndarray:
        """Return what objects of one's own put on the coordinates (n, coordinates) at states (n, nx) and times (n,), in
        N m, or N where a joint slides.
        """
        lay, system = self.crane.layout, self._system(1)
        w = np.zeros((1, len(lay.all_inputs)))
        w[0, lay.driving] = lay.closed
        N = [statics.reduced(self.crane, x, t).N[lay.positions] for x, t in zip(states, time, strict=True)]
        return np.array([n @ system.push(x[None], w, t)[0] for n, x, t in zip(N, states, time, strict=True)])

    def residual(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, np.ndarray]:
        """Return what Exudyn itself assembles at one state with consistent accelerations, for checks.

        Returns:
            "mass": (nq, nq), "force": (nq,) applied forces, "joint": rows of G v, "joint_jacobian": G (rows, nq),
            "pressure_rates": (chambers,); and what it was given: "q", "v", "a" (nq,) redundant coordinates and their
                rates, "dp".

        Raises:
            CraneError: a state or inputs of another length, or a pose that cannot be reached.
        """
        x, w = statics.checked_state(self.crane, state), statics.checked_inputs(self.crane, w)
        return self._system(1).inspect(x, w, time)

    # -- one step ------------------------------------------------------------------------------------------------

    def _system(self, size: int) -> System:
        """Return the kept system of a batch size; build it where there is none that can go on."""
        system = self._systems.get(size)
        if system is None or system.spoilt:
            system = self._systems[size] = System(self.crane, size, self.accuracy)
            if len(self._systems) > _MOST_SYSTEMS:
                self._systems.popitem(last=False)
        else:
            self._systems.move_to_end(size)
        return system

    def _step(
        self,
        x: np.ndarray,
        w0: np.ndarray,
        w1: np.ndarray,
        h: float,
        time: float,
        P: np.ndarray | None = None,
        E: np.ndarray | None = None,
    ) -> np.ndarray:
        """Take one step; a crane that cannot take it, or whose error would be too large, goes on alone in parts of it.

        Args:
            x: (n, nx);  w0, w1: (n, .) inputs and disturbances at start and end;  P, E: (n, .), or None for the crane's
                own.
        """
        system = self._system(len(x))
        out, beyond = system.step(x, w0, w1, h, time, P, E, self.accuracy, self.accuracy)
        status = system.status.tolist() if system.status.any() else []
        for k, cause in enumerate(status):
            if cause == trapezoidal.DONE:
                continue
            if cause == trapezoidal.UNREACHABLE:
                raise self._failure(cause, x[k], w0[k], time, h, 0)
            own = (None, None) if P is None or E is None else (P[k, None], E[k, None])
            self.halved += 1
            out[k] = self._in_parts(x[k, None], w0[k, None], w1[k, None], h, time, 1, *own)[0][0]
        if beyond >= 0:
            raise self._stroke_end(out[beyond], time + h)
        return out

    def _in_parts(
        self,
        x: np.ndarray,
        w0: np.ndarray,
        w1: np.ndarray,
        h: float,
        time: float,
        level: int,
        P: np.ndarray | None = None,
        E: np.ndarray | None = None,
    ) -> tuple[np.ndarray, int]:
        """Return the state (1, nx) of one crane after a step, and how often the next is halved; this one begins with
        parts halved `level` times.
        """
        system, done = self._system(1), 0.0
        while done < 1.0:
            part = 0.5**level
            start = w0 + done * (w1 - w0) if done > 0.0 else w0
            end = w0 + (done + part) * (w1 - w0) if done + part < 1.0 else w1
            t = time + done * h
            errors = limit(level, part * h, self.accuracy), enough_to_grow(level, part * h, self.accuracy)
            out, beyond = system.step(x, start, end, part * h, t, P, E, *errors)
            cause = int(system.status[0])
            if cause == trapezoidal.DONE:
                if beyond >= 0:
                    raise self._stroke_end(out[0], t + part * h)
                x, done = out, done + part
                level = next_level(level, done, part * h, system.errors[0], self.accuracy)
            elif cause == trapezoidal.UNREACHABLE or level == MOST_HALVINGS:
                raise self._failure(cause, x[0], start[0], t, part * h, level)
            else:
                level, self.halved = level + 1, self.halved + 1
        return x, level

    def _stroke_end(self, state: np.ndarray, time: float) -> CraneError:
        return CraneError(
            f"{self.crane.name}: {statics.stroke_message(self.crane, state)} at t = {time:.6g} s, "
            f"{statics.state_text(self.crane, state)}. Add the effect end_stop to this cylinder, shorten the command, "
            "or correct the cylinder's lengths."
        )

    def _failure(self, status: int, state: np.ndarray, w: np.ndarray, time: float, h: float, halved: int) -> CraneError:
        if not np.isfinite(state).all() or np.isinf(w).any():
            inputs = " ".join(f"{u:g}" for u in w[: len(self.crane.layout.inputs)])
            return CraneError(
                f"{self.crane.name}: the state or an input is not finite at t = {time:.6g} s: "
                f"{statics.state_text(self.crane, state)}, inputs {inputs}. Only pp and pt may be NaN."
            )
        law = faulty_laws.where_run_failed(self.crane, state, w, time, h)
        if law is not None:
            return law
        if status == trapezoidal.UNREACHABLE:
            return geometry.unreachable(self.crane, state, f", t = {time:.6g} s")
        what, mend = {
            trapezoidal.SINGULAR: (
                "the equations of motion are singular",
                "Check for two dependent bodies of a loop that are in line, or a body without inertia.",
            ),
            trapezoidal.COARSE: (
                "the step is not accurate",
                "Check for values that make the equations stiff or impossible, such as a far too stiff spring.",
            ),
        }.get(
            status,
            (
                "Newton's method does not converge",
                "Check for values that make the equations stiff or impossible, such as a far too stiff spring.",
            ),
        )
        return CraneError(
            f"{self.crane.name}: {what} at t = {time:.6g} s, {statics.state_text(self.crane, state)}. Tried {halved} "
            f"halvings of the step, down to {h:.3g} s, {_MOST_ITERATIONS} iterations each. {mend}"
        )


def _check_grid(names: tuple[str, ...], t: np.ndarray, w: np.ndarray, step: float) -> None:
    if t.ndim != 1 or t.size < 1 or w.shape != (t.size, len(names)):
        raise CraneError(
            f"simulate: time has shape {t.shape} and inputs {w.shape}, expected (N,) and (N, {len(names)}) with "
            f"[{' '.join(names)}]."
        )
    back = np.flatnonzero(~(np.diff(t) > 0.0))
    if back.size:
        k = int(back[0])
        raise CraneError(
            f"simulate: time does not increase from sample {k} ({t[k]:g} s) to sample {k + 1} ({t[k + 1]:g} s). Sort "
            "the "
            "samples and remove repeated ones."
        )
    if not step > 0.0:
        raise CraneError(f"simulate: step = {step:g} s is not positive.")


def _refuse_coordinates(mbs: Any, plant: mechanism.Plant) -> None:
    """Raise CraneError where objects of one's own bring coordinates along: the engine assembles forces, and neither
    moves what is not the machine's nor lets a contact decide between two steps.
    """
    data, n, machine = mbs.systemData, plant.size, plant.crane.layout
    for what, found, own in (
        ("coordinates of motion (a body or node of their own)", data.GetODE2Coordinates(), n * plant.coordinates),
        ("coordinates of first order", data.GetODE1Coordinates(), n * len(machine.chambers)),
        (
            "algebraic coordinates (a joint, or a rope or rod that is rigid)",
            data.GetAECoordinates(),
            n * plant.joint_rows,
        ),
        ("data coordinates (a contact, a limit stop, or friction with a memory)", data.GetDataCoordinates(), 0),
    ):
        if len(found) != own:
            raise CraneError(
                f"{plant.crane.name}: user-defined objects add {len(found) - own} {what}. In the engine's systems they "
                "may only apply forces that follow from the state of the machine, such as a spring or a user "
                "function. Use `build` and Exudyn's own solver for such a model."
            )


@contextmanager
def _blaming_objects(crane: Crane) -> Iterator[None]:
    """Tell what Exudyn raises of a crane with objects of one's own as theirs."""
    try:
        yield
    except CraneError:
        raise
    except Exception as problem:
        said = " ".join(str(problem).split())
        raise CraneError(f"{crane.name}: Exudyn refuses the user-defined objects: {said[:500]}") from problem


class System:
    """A kept Exudyn system of n cranes and the solver that assembles its residuals."""

    def __init__(self, crane: Crane, size: int, accuracy: float) -> None:
        self._tolerance = trapezoidal.ROUGHLY * accuracy if is_rough(accuracy) else trapezoidal.TOLERANCE
        self._container, self.mbs = mechanism.main_system()
        states = np.tile(mechanism.start_pose(crane), (size, 1))
        self.plant = mechanism.build(self.mbs, crane, states=states, graphics=False)
        self.spoilt = False  # whether its items hold what nobody knows
        self.plant.guarded = False  # an iterate may be beyond a stroke where the step is not
        # who tells what Exudyn raises; without objects of one's own it is nobody's
        self._blaming = partial(_blaming_objects, crane) if crane.objects else nullcontext
        with self._blaming():
            self.mbs.Assemble()
        self._items = ItemValues(self.mbs, self.plant)
        self._push, self._has_objects = np.zeros((size, self.plant.coordinates)), bool(crane.objects)
        if crane.objects:
            _refuse_coordinates(self.mbs, self.plant)
        self._settings = mechanism.settings(1e-3, 1.0, sparse=size > 1)
        self.solver = mechanism.new_solver()
        with self._blaming():
            ready = self.solver.InitializeSolver(self.mbs, self._settings)
        if not ready:
            raise CraneError(f"{crane.name}: Exudyn cannot initialise its solver: {self.solver.GetErrorString()}")
        self.solver.it.currentStepSize = 1.0  # Exudyn scales the rows of ODE2 by beta h^2; h is not used otherwise
        self._scale = 0.25
        data = self.mbs.systemData
        data.SetAECoordinates(np.zeros(size * self.plant.joint_rows))  # the start left joint forces there
        width, chambers = self.plant.coordinates, len(crane.layout.chambers)
        self._q, self._v, self._a = np.zeros((size, width)), np.zeros((size, width)), np.zeros((size, width))
        self._p, self._dp = np.zeros((size, chambers)), np.zeros((size, chambers))
        self._held, self._udd = (
            np.zeros((size, trapezoidal.N_BALANCES, chambers)),
            np.zeros((size, self.plant.velocities)),
        )
        self._P, self._E = self.plant.P.copy(), self.plant.E.copy()
        self._before, self._varied, self._payload = np.zeros_like(self.plant.inertia), False, crane["payload.mass"]
        self.status, self.errors, self._last = np.zeros(size, dtype=np.int64), np.zeros(size), np.zeros(size)

    def step(
        self,
        x: np.ndarray,
        w0: np.ndarray,
        w1: np.ndarray,
        h: float,
        time: float,
        P: np.ndarray | None,
        E: np.ndarray | None,
        allowed: float,
        enough: float,
    ) -> tuple[np.ndarray, int]:
        """Return (states, first crane beyond its stroke or -1); `status` and `errors` say crane by crane how the step
        went.

        A local error below `allowed` is good; one above `enough` is estimated as well as can be.
        """
        plant, out = self.plant, np.empty_like(x)
        before = self._set_parameters(P, E, time, time + h)
        if self._has_objects:
            self._measure_push(before, x, w0, time)
        machines, step = (plant.topology, plant.P, plant.E, plant.inertia), (time, h, x, w0, w1, self._push)
        ends = (self._q, self._v, self._a, self._p, self._dp, self._held, self._udd)
        if not trapezoidal.predict(machines, before, step, ends, self.status, self._last):
            self.status[self.status == trapezoidal.ITERATING] = trapezoidal.DONE
            return out, -1
        plant.inputs[...] = w1
        self.mbs.systemData.SetTime(time + h)
        for _ in range(_MOST_ITERATIONS):
            residual = self.residual()
            state = ends, self.status, self._last
            if not trapezoidal.correct(machines, h, self._scale, w1, residual, *state, self._tolerance):
                break
        return out, trapezoidal.finish(machines, step, allowed, enough, ends, self.status, self.errors, out)

    def push(self, x: np.ndarray, w: np.ndarray, time: float) -> np.ndarray:
        """Return the forces (n, width) of objects of one's own on the redundant coordinates at states x."""
        self._measure_push(self._set_parameters(None, None, time, time), x, w, time)
        return self._push

    def _measure_push(self, inertia: np.ndarray, x: np.ndarray, w: np.ndarray, time: float) -> None:
        """Fill the forces of objects of one's own at states x: what Exudyn assembles beyond the machine's own
        forces.
        """
        plant, own = self.plant, np.empty_like(self._q)
        machines = (plant.topology, plant.P, plant.E, inertia)
        trapezoidal.forces_at(machines, time, x, w, self._q, self._v, self._p, own)
        self._a[:], self._dp[:], plant.inputs[...] = 0.0, 0.0, w
        self.mbs.systemData.SetTime(time)
        total = -np.asarray(self.residual())[: own.size].reshape(own.shape) / self._scale
        self._push[...] = total - own

    def _set_parameters(self, P: np.ndarray | None, E: np.ndarray | None, start: float, end: float) -> np.ndarray:
        """Bring the cranes' numbers up to date for the end of a step; return the masses (n, bodies + 1, 4) at its
        start.
        """
        plant = self.plant
        if P is None and E is None and not self._varied and self._payload_is(start) and self._payload_is(end):
            return plant.inertia
        self._varied = P is not None or E is not None
        P, E = (self._P if P is None else P), (self._E if E is None else E)
        reduction.all_inertias(plant.topology, P, E, start, self._before)
        try:
            changed = self._items.set(P, E, end)
        except ValueError as problem:  # of Exudyn's range checks: limits hold one by one, what effects make of them not
            self.spoilt = True  # some items were changed already, and others not
            raise CraneError(
                f"{plant.crane.name}: the parameters and effects of a row make a body or a cylinder impossible at "
                f"t = {end:g} s ({str(problem).partition(' (range')[0]}). Correct payload.mass, payload_change or the "
                "cylinders."
            ) from problem
        if not self._varied and plant.payload_mass[0] < 0.0:  # a sigma point's may be, beside an effect
            self.spoilt = True
            raise statics.weightless(plant.crane, plant.payload_mass[0], end)
        if changed:
            self.solver.ComputeMassMatrix(self.mbs)
        return self._before

    def _payload_is(self, time: float) -> bool:
        """Whether the bodies have the payload's mass of a time, all cranes being alike."""
        return bool(hooks.plain("payload_mass")(self._E[0], time, self._payload) == self.plant.payload_mass[0])

    def residual(self) -> np.ndarray:
        """Return Exudyn's residual [M a - f, rates - dp, G v] at the present iterate."""
        data = self.mbs.systemData
        data.SetODE2Coordinates(self._q.ravel())
        data.SetODE2Coordinates_t(self._v.ravel())
        data.SetODE2Coordinates_tt(self._a.ravel())
        data.SetODE1Coordinates(self._p.ravel())
        data.SetODE1Coordinates_t(self._dp.ravel())
        with self._blaming():
            self.solver.ComputeNewtonResidual(self.mbs, self._settings)
        return self.solver.GetSystemResidual()

    def inspect(self, x: np.ndarray, w: np.ndarray, time: float) -> dict[str, np.ndarray]:
        """Return what Exudyn assembles for one crane; see `ExudynEngine.residual`."""
        plant, width, rows = self.plant, self.plant.coordinates, self.plant.joint_rows
        self._set_parameters(None, None, time, time)
        self._q[0], self._v[0], self._a[0], self._p[0], self._dp[0] = mechanism.consistent(plant, x, w, time)
        plant.inputs[...] = 0.0
        plant.inputs[:, : w.size] = w
        self.mbs.systemData.SetTime(time)
        out = {"q": self._q[0].copy(), "v": self._v[0].copy(), "a": self._a[0].copy(), "dp": self._dp[0].copy()}
        self._a[:], self._dp[:] = 0.0, 0.0
        residual = np.array(self.residual())
        behind = width + self._p.shape[1]
        out |= {"force": -residual[:width] / self._scale, "pressure_rates": residual[width:behind]}
        out |= {"joint": residual[behind:], "mass": np.array(self.solver.GetSystemMassMatrix())[:width, :width]}
        self.solver.ComputeNewtonJacobian(self.mbs, self._settings)
        jacobian = np.array(self.solver.GetSystemJacobian())
        return out | {"joint_jacobian": jacobian[:width, behind : behind + rows].T}  # beside G^T: the joint forces
