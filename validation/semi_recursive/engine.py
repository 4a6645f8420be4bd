"""SemiRecursiveEngine: the independent engine behind the same methods as the Exudyn engine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from crane_exudyn import faulty_laws
from crane_exudyn.compiled import njit
from crane_exudyn.crane import Crane, checked_crane
from crane_exudyn.effects import hooks
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import loop_bends, pose_text
from crane_exudyn.machine import CYLINDERS, Joint, Machine
from crane_exudyn.row_values import RowValues
from crane_exudyn.statics import check_less_loaded, check_spools, checked_inputs, checked_state, state_text
from crane_exudyn.step_control import MOST_HALVINGS

from . import equations, kernel
from .hydraulics import held_pressures
from .sheet import BY, CYLINDER, JOINTS, LENGTH, N_CYLINDER, RANGE, WEIGHT, first_cylinder, sheet
from .terms import point_rows, term_names, terms

#: a chamber that is shorter than nothing by this (m) shows whether anything pushes back
_BEYOND = 1e-3
#: a cylinder that moves by less than this (m per rad or m) for any motion of its machine has no leverage
_LEAST_LEVERAGE = 1e-6
#: sine of the angle between the dependent bodies of a loop below which they count as in line
_IN_LINE = 0.05


@njit
def _chamber_lengths(X, P, E, topology):
    out, s = np.empty((X.shape[0], X.shape[1] // 4 * 2)), sheet(topology)
    for i in range(X.shape[0]):
        equations.chamber_lengths(X[i], P, E, s, out[i])
    return out


@njit
def _rest(x, P, E, topology):
    """Return generalised forces (n,) of all but cylinders at rest, those of a unit force in each cylinder (n, n), and
    the lengths (n,).
    """
    s = sheet(topology)
    equations.at_rest(x, P, E, s)
    n, first = topology[0, CYLINDERS], first_cylinder(s)
    units = s.numbers[first : first + n, BY : BY + n].copy()
    return (
        s.general[WEIGHT] + s.general[JOINTS],
        units,
        s.numbers[first : first + n, LENGTH].copy(),
    )


@njit
def _held(lengths, forces, less_loaded, P, E, pressures):
    for c in range(forces.size):
        pressures[2 * c], pressures[2 * c + 1] = held_pressures(c, lengths[c], forces[c], less_loaded[c], P, E)
    gx, gy = hooks.gravity(E, 0.0, -1.0)
    return math.atan2(gx, -gy)


@njit
def _asked(P, E, n):
    """Return the length of the pendulum, and of each chamber (2n,) whether something stops the piston at its end."""
    stopped = np.empty(2 * n, np.bool_)
    for c in range(n):
        whole = P[CYLINDER + N_CYLINDER * c + RANGE]
        for side in (0, 1):
            sign, beyond, end = 1.0 - 2.0 * side, -_BEYOND, 0.0
            if side == 1:
                beyond, end = whole + _BEYOND, whole
            push = hooks.cylinder_force(E, c, 0.0, 0.0, 0.0, beyond, whole - beyond)
            stopped[2 * c + side] = sign * (push - hooks.cylinder_force(E, c, 0.0, 0.0, 0.0, end, whole - end)) > 0.0
    return hooks.pendulum(E)[0], stopped


class SemiRecursiveEngine:
    """A crane, whatever its machine, by the double-step semi-recursive method; states in, states out, no hidden state.

    Args:
        crane: the crane, with its effects.
        step: longest inner time step, s.
        accuracy: local error that a step may have, in units of `step_control.*_ERROR`; a step beyond it is halved.
    """

    def __init__(self, crane: Crane, *, step: float = 1e-3, accuracy: float = 1.0):
        if checked_crane(crane, "SemiRecursiveEngine").objects:
            raise CraneError(
                f"{crane.name}: only the Exudyn engine knows user-defined objects. Use it, or a crane without them."
            )
        self.crane, self.step, self.accuracy = crane, float(step), float(accuracy)
        self._P, self._E = crane.parameter_vector(), crane.effect_vector()
        self._topology = crane.machine.topology
        self._row_values = RowValues(crane)
        #: steps that were halved so far, because their local error was too large or Newton's method did not converge
        self.halved = 0
        self._layout = crane.layout
        length, self._stopped = _asked(self._P, self._E, len(self._layout.cylinders))
        self.state_names = self._layout.all_states if length > 0.0 else self._layout.states

    def __repr__(self) -> str:
        return f"<SemiRecursiveEngine of {self.crane!r}, states {' '.join(self.state_names)}>"

    def static_start(self, *pose: float, less_loaded: float | Sequence[float] | None = None) -> np.ndarray:
        """Return the state (nx,) at rest with closed valves; in each cylinder the lower pressure is `less_loaded`.

        Args:
            pose: the independent coordinates, rad or m; `less_loaded` may stand behind them.
            less_loaded: Pa, one for all cylinders or one each; the crane file's by default.

        A measured pose may lie a little beyond the file's stroke: only a run from there is refused.

        Raises:
            CraneError: a loop cannot be closed there, a pressure is below vapour pressure, or no pressures balance the
                load.
        """
        n, x = len(self._layout.coordinates), np.zeros(len(self.state_names))
        given = [v for v in (*pose[n:], less_loaded) if v is not None]
        if len(pose) < n or len(given) > 1:
            raise CraneError(
                f"A static start wants {n} numbers, {', '.join(self._layout.coordinates)}, and the less loaded "
                f"pressure; found {len(pose)}."
            )
        chosen = given[0] if given else self.crane.initial.less_loaded_pressure
        low = np.broadcast_to(np.asarray(chosen, dtype=float), n).copy()
        check_less_loaded(self.crane, low, "the pressure")
        x[self._layout.positions] = pose[:n]
        load, units, lengths = _rest(x, self._P, self._E, self._topology)
        if np.isfinite(units).all() and np.linalg.svd(units, compute_uv=False)[-1] < _LEAST_LEVERAGE:
            raise CraneError(
                f"Semi-recursive engine: the cylinders of {self.crane.name} have no leverage at {self._pose(x)}, so no "
                "pressures balance "
                "the load. Start at another pose."
            )
        forces = np.linalg.solve(units.T, -load)
        angle = _held(lengths, forces, low, self._P, self._E, x[self._layout.pressures])
        x[self._layout.extra][:1] = angle
        if not np.all(np.isfinite(x)):
            raise faulty_laws.where_start_failed(self.crane, x) or CraneError(
                f"{self._unreachable(x)} There is no static start."
            )
        return x

    def propagate(
        self,
        states: np.ndarray,
        inputs: np.ndarray,
        dt: float,
        time: float = 0.0,
        parameters: Mapping[str, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Return states (n, nx) one dt (s) later.

        Args:
            states: (n, nx).
            inputs: w = [U pp pt] at the start and the end of the step, (2, m) or (2, n, m).
            time: time at the start of the step, s.
            parameters: {name: (n,)}, what differs from row to row (SI): nominal parameters such as "payload.mass",
                parameters of effects such as "internal_leakage@lift.k", and the disturbances of the layout.

        Raises:
            CraneError: wrong shapes, a spool position that is missing or far beyond ±1, a step that is not positive, a
                parameter that is unknown or that no crane has, or a state whose step does not converge.
        """
        x = np.ascontiguousarray(states, dtype=float)
        self._check_shape("states", x, (None, len(self.state_names)))
        if not dt > 0.0:
            raise CraneError(f"propagate: dt = {dt:g} s is not positive.")
        w = np.ascontiguousarray(inputs, dtype=float)
        m = len(self._layout.inputs)
        if w.shape not in ((2, m), (2, len(x), m)):
            raise CraneError(
                f"inputs have the shape {w.shape}; expected (2, {m}) or (2, {len(x)}, {m}): w at start and end."
            )
        check_spools(self._layout.voltages, w, step=True)
        w, P, E = w.reshape(2, -1, m), self._P[None], self._E[None]
        if parameters:
            w, P, E = self._by_row(len(x), w, parameters)
        n = max(1, math.ceil(dt / self.step - 1e-6))
        out, status, row, halved = kernel.propagate_batch(
            x, w[0], w[1], float(time), float(dt), n, P, E, self._topology, self.accuracy
        )
        self.halved += halved
        if status != kernel.OK:
            raise faulty_laws.where_run_failed(
                self.crane, x[row], w[0, min(row, w.shape[1] - 1)], time, dt
            ) or CraneError(self._failure(status, out[row], time, dt / n, f"row {row} of the batch"))
        return out

    def _by_row(
        self, rows: int, w: np.ndarray, parameters: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return inputs (2, rows or 1, .), with disturbances where these differ, P (rows or 1, .) and E (rows or 1, .)
        with what differs from row to row.
        """
        differ, P, E = self._row_values.differing(tuple(parameters)), self._P[None], self._E[None]
        if 0 in differ:
            P = P.repeat(rows, 0)
        if 1 in differ:
            E = E.repeat(rows, 0)
        if 2 in differ:
            wide = np.zeros((2, rows, len(self._layout.all_inputs)))
            wide[:, :, self._layout.driving] = w
            w = wide
        self._row_values.fill(parameters, P, E, w)
        return w, P, E

    def simulate(
        self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, *, step: float | None = None
    ) -> np.ndarray:
        """Return states (N, nx) at `time` (N,) s, from x0 (nx,), with inputs (N, m) linear between.

        Raises:
            CraneError: wrong shapes, a step that does not converge, or a cylinder that reaches the end of its stroke.
        """
        x, t, w = (np.ascontiguousarray(a, dtype=float) for a in (x0, time, inputs))
        self._check_run(x, t, w)
        h = self.step if step is None else float(step)
        machine = self._P, self._E, self._topology
        X, status, k, halved = kernel.simulate(x, w, t, h, *machine, self.accuracy, math.inf)
        self.halved += halved
        self._refuse_stroke_end(X[: k + 1] if status != kernel.OK else X, t)
        if status != kernel.OK:
            last = X[k + 1] if np.isfinite(X[k + 1]).all() else X[k]
            raise faulty_laws.where_run_failed(self.crane, last, w[k], t[k], t[k + 1] - t[k]) or CraneError(
                self._failure(status, X[k + 1], t[k], h, f"sample {k}")
            )
        return X

    def terms(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
        """Return every term of the balances by name at a state (nx,) and inputs w (m,), which may have the disturbances
        behind; SI.

        Raises:
            CraneError: a state or inputs of another length.
        """
        x, given = checked_state(self.crane, state), checked_inputs(self.crane, w)
        values = self.terms_along(x[None], given[None], np.array([time]))
        return {name: float(v[0]) for name, v in values.items()}

    def terms_along(self, states: np.ndarray, inputs: np.ndarray, time: np.ndarray) -> dict[str, np.ndarray]:
        """Return every term by name along states (N, nx), inputs (N, m) and times (N,). Raises CraneError for wrong
        shapes.
        """
        x, w, t = (np.ascontiguousarray(a, dtype=float) for a in (states, inputs, time))
        self._check_shape("states", x, (None, len(self.state_names)))
        widths = len(self._layout.inputs), len(self._layout.all_inputs)
        if w.shape not in [(len(x), m) for m in widths] or t.shape != (len(x),):
            raise CraneError(
                f"inputs have the shape {w.shape} and time {t.shape}; expected ({len(x)}, {widths[0]}), or ({len(x)}, "
                f"{widths[1]}) with disturbances, and ({len(x)},): one row for each state."
            )
        names = term_names(self.crane.machine)
        values = terms(x, w, t, self._P, self._E, self._topology, point_rows(self.crane.machine), len(names))
        return dict(zip(names, values.T, strict=True))

    # -- refusals --------------------------------------------------------------------------------------------------

    def _check_shape(self, name: str, array: np.ndarray, shape: tuple[int | None, ...]) -> None:
        fits = array.ndim == len(shape) and all(s is None or s == n for s, n in zip(shape, array.shape, strict=False))
        if not fits:
            expected = "(" + ", ".join("n" if s is None else str(s) for s in shape) + ")"
            raise CraneError(
                f"{name} have the shape {array.shape}; expected {expected}: {', '.join(self.state_names)}."
            )

    def _check_run(self, x: np.ndarray, t: np.ndarray, w: np.ndarray) -> None:
        self._check_shape("x0", x, (len(self.state_names),))
        m = len(self._layout.inputs)
        if t.ndim != 1 or w.shape != (len(t), m):
            raise CraneError(f"time has the shape {t.shape} and inputs {w.shape}; expected (N,) and (N, {m}).")
        if not np.all(np.diff(t) > 0.0):
            k = int(np.argmin(np.diff(t) > 0.0))
            raise CraneError(f"time does not increase from sample {k} ({t[k]:g} s) to {k + 1} ({t[k + 1]:g} s).")
        check_spools(self._layout.voltages, w, step=False)

    def _refuse_stroke_end(self, states: np.ndarray, time: np.ndarray) -> None:
        lengths = _chamber_lengths(np.ascontiguousarray(states), self._P, self._E, self._topology)
        lengths[:, self._stopped] = 1.0
        if not (lengths < 0.0).any():
            return
        k, chamber = np.argwhere(lengths < 0.0)[0]
        raise CraneError(
            f"Semi-recursive engine: a cylinder reached the end of its stroke at t = {time[k]:.3f} s "
            f"({self._chamber(chamber)} empty, {-1e3 * lengths[k, chamber]:.1f} mm beyond). State: "
            f"{state_text(self.crane, states[k])}. "
            "Shorten the motion, start elsewhere, or add the effect end_stop to the crane."
        )

    def _failure(self, status: int, x: np.ndarray, time: float, h: float, where: str) -> str:
        if not np.all(np.isfinite(x)):
            found = state_text(self.crane, x)
            return f"Semi-recursive engine: at t = {time:.4f} s ({where}) the state is not finite: {found}."
        lengths = _chamber_lengths(x[None], self._P, self._E, self._topology)[0]
        if np.isnan(lengths).any():
            return self._unreachable(x) + f" It was met at t = {time:.4f} s ({where})."
        chamber = int(np.argmin(lengths))
        what = "did not converge" if status == kernel.NOT_CONVERGED else "is not accurate"
        return (
            f"Semi-recursive engine: the step after t = {time:.4f} s ({where}) {what}, neither with {h:g} s nor "
            f"halved up to {MOST_HALVINGS} times. State: {state_text(self.crane, x)}. Shortest chamber: "
            f"{self._chamber(chamber)}, {1e3 * lengths[chamber]:.1f} mm. "
            f"{self._in_line(x) or 'Look for a chamber near its end, or parameters out of proportion.'}"
        )

    def _in_line(self, x: np.ndarray) -> str:
        """Return a sentence on the loop whose dependent bodies are in line, where it locks; "" where none are."""
        machine = self.crane.machine
        for joint, bend in zip(machine.loops, loop_bends(self.crane, x[None, self._layout.positions])[0], strict=True):
            first, second = machine.pair(joint)
            if math.sin(bend) < _IN_LINE:
                return (
                    f"The loop {_around(machine, joint)} is at its limit: {first.body} and {second.body} are in line "
                    f"within {math.degrees(min(bend, math.pi - bend)):.1f} deg, and it locks. Shorten the motion, or "
                    f"correct the joints {first.name}, {second.name}, {joint.name}."
                )
        return ""

    def _unreachable(self, x: np.ndarray) -> str:
        machine, terms = self.crane.machine, self.terms(x, np.array(self._layout.closed))
        for joint in machine.loops:
            inner, outer = machine.pair(joint)
            if math.isnan(terms[f"phi_{joint.carrier}"]):
                return (
                    f"Semi-recursive engine: the loop {_around(machine, joint)} of {self.crane.name} cannot be closed "
                    f"at {self._pose(x)}: "
                    f"{joint.name} is out of reach of {inner.body} and {outer.body}. "
                    f"Correct the pose or the joints {inner.name}, {outer.name}, {joint.name}."
                )
        return f"Semi-recursive engine: the forces of {self.crane.name} at {self._pose(x)} are not finite."

    def _pose(self, x: np.ndarray) -> str:
        return pose_text(self._layout, x[self._layout.positions])

    def _chamber(self, k: int) -> str:
        return self._layout.side_of(self._layout.chambers[k])


def _around(machine: Machine, closing: Joint) -> str:
    """Return the joints of a loop in their order, such as "A-B-C-D", the closing one last."""
    there, here = machine.path(closing.carrier), machine.path(closing.body)
    common = sum(a == b for a, b in zip(there, here, strict=False))
    bodies = (*reversed(here[common:]), *there[common:])
    return "-".join([*(machine.carriers[b].name for b in bodies), closing.name])
