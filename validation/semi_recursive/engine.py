"""SemiRecursiveEngine: the independent engine behind the same methods as the Exudyn engine."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np

from crane_exudyn import faulty_laws
from crane_exudyn import parameters as names
from crane_exudyn.compiled import njit
from crane_exudyn.crane import Crane
from crane_exudyn.effects import hooks, registry
from crane_exudyn.errors import CraneError, listed, nearest
from crane_exudyn.layout import Layout
from crane_exudyn.step_control import MOST_HALVINGS

from . import equations, kernel
from .terms import TERM_NAMES, terms


@njit
def _chamber_lengths(X, P, E):
    out = np.empty((X.shape[0], 4))
    for i in range(X.shape[0]):
        equations.chamber_lengths(X[i], P, E, out[i])
    return out


@njit
def _held(z1, z4, less_loaded, P, E, x):
    F1, F2, s1, s2 = equations.static_forces(z1, z4, P, E)
    x[4], x[5] = equations.held_pressures(0, s1, F1, less_loaded[0], P, E)
    x[6], x[7] = equations.held_pressures(1, s2, F2, less_loaded[1], P, E)
    gx, gy = equations.hooks.gravity(E, 0.0, -1.0)
    return math.atan2(gx, -gy)


def _find_column(layout: Layout, name: str) -> tuple[str, int]:
    if name in layout.disturbances:
        return "w", layout.all_inputs.index(name)
    if name in names.INDEX:
        return "P", names.INDEX[name]
    key, _, last = name.rpartition(".")
    if "@" in key or key in {e.name for e in registry.known()}:
        effect, place = registry.split_key(key)
        for i, parameter in enumerate(effect.parameters):
            if parameter.name == last:
                return "E", registry.slot(effect.name, place) + i
    known = [*names.NAMES, *layout.disturbances]
    raise CraneError(f"Semi-recursive engine: no parameter {name!r} can differ from row to row.{nearest(name, known)}")


class SemiRecursiveEngine:
    """The crane by the double-step semi-recursive method; states in, states out, no hidden state.

    Args:
        crane: the crane, with its effects.
        step: longest inner time step, s.
        accuracy: local error that a step may have, in units of `step_control.*_ERROR`; a step beyond it is halved.
    """

    def __init__(self, crane: Crane, *, step: float = 1e-3, accuracy: float = 1.0):
        self.crane, self.step, self.accuracy = crane, float(step), float(accuracy)
        self._P, self._E = crane.parameter_vector(), crane.effect_vector()
        self._columns: dict[str, tuple[str, int]] = {}
        #: steps that were halved so far, because their local error was too large or Newton's method did not converge
        self.halved = 0
        self._layout, swings = crane.layout, hooks.pendulum(self._E)[0] > 0.0
        self.state_names = self._layout.all_states if swings else self._layout.states

    def static_start(self, z1: float, z4: float, less_loaded: float | Sequence[float] = 20e5) -> np.ndarray:
        """Return the state (nx,) at rest with closed valves; in each cylinder the lower pressure is `less_loaded` (Pa).

        Raises:
            CraneError: the loop cannot be closed at z1, z4 (rad), or a cylinder would be beyond its stroke.
        """
        x = self.at_rest(z1, z4, less_loaded)
        self._refuse_stroke_end(x[None], np.zeros(1))
        return x

    def at_rest(self, z1: float, z4: float, less_loaded: float | Sequence[float] = 20e5) -> np.ndarray:
        """Return the same state wherever the loop can be closed: a measured pose may lie a little beyond the file's stroke."""
        x = np.zeros(len(self.state_names))
        x[self._layout.positions] = z1, z4
        angle = _held(
            float(z1), float(z4), np.broadcast_to(np.asarray(less_loaded, dtype=float), 2).copy(), self._P, self._E, x
        )
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
            inputs: w = [U1 U2 pp pt] at the start and the end of the step, (2, 4) or (2, n, 4).
            time: time at the start of the step, s.
            parameters: {name: (n,)}, what differs from row to row (SI): nominal parameters such as "payload.mass",
                parameters of effects such as "internal_leakage@lift.k", and the disturbances of the layout.

        Raises:
            CraneError: wrong shapes, an unknown parameter, or a state whose step does not converge.
        """
        x = np.ascontiguousarray(states, dtype=float)
        self._check_shape("states", x, (None, len(self.state_names)))
        w = np.ascontiguousarray(inputs, dtype=float)
        m = len(self._layout.inputs)
        if w.shape not in ((2, m), (2, len(x), m)):
            raise CraneError(
                f"inputs have the shape {w.shape}; expected (2, {m}) or (2, {len(x)}, {m}): w at start and end."
            )
        w, P, E = w.reshape(2, -1, m), self._P[None], self._E[None]
        if parameters:
            w, P, E = self._by_row(len(x), w, parameters)
        n = max(1, math.ceil(dt / self.step - 1e-6))
        out, status, row, halved = kernel.propagate_batch(x, w[0], w[1], float(time), float(dt), n, P, E, self.accuracy)
        self.halved += halved
        if status != kernel.OK:
            raise faulty_laws.where_run_failed(
                self.crane, x[row], w[0, min(row, w.shape[1] - 1)], time, dt
            ) or CraneError(self._failure(status, out[row], time, dt / n, f"row {row} of the batch"))
        return out

    def _by_row(
        self, rows: int, w: np.ndarray, parameters: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return inputs (2, rows, 12), P (rows, .) and E (rows, .) with what differs from row to row."""
        wide = np.zeros((2, rows, len(self._layout.all_inputs)))
        wide[:, :, self._layout.driving] = w
        P, E = np.tile(self._P, (rows, 1)), np.tile(self._E, (rows, 1))
        for name, values in parameters.items():
            table, column = self._column(name)
            if table == "w":
                wide[:, :, column] = values
            else:
                (P if table == "P" else E)[:, column] = values
        return wide, P, E

    def _column(self, name: str) -> tuple[str, int]:
        """Return where a quantity that may differ from row to row stands: "w", "P" or "E", and the column."""
        if name not in self._columns:
            self._columns[name] = _find_column(self._layout, name)
        return self._columns[name]

    def simulate(
        self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, *, step: float | None = None
    ) -> np.ndarray:
        """Return states (N, nx) at `time` (N,) s, from x0 (nx,), with inputs (N, 4) linear between.

        Raises:
            CraneError: wrong shapes, a step that does not converge, or a cylinder that reaches the end of its stroke.
        """
        x, t, w = (np.ascontiguousarray(a, dtype=float) for a in (x0, time, inputs))
        self._check_run(x, t, w)
        h = self.step if step is None else float(step)
        X, status, k, halved = kernel.simulate(x, w, t, h, self._P, self._E, self.accuracy)
        self.halved += halved
        self._refuse_stroke_end(X[: k + 1] if status != kernel.OK else X, t)
        if status != kernel.OK:
            last = X[k + 1] if np.isfinite(X[k + 1]).all() else X[k]
            raise faulty_laws.where_run_failed(self.crane, last, w[k], t[k], t[k + 1] - t[k]) or CraneError(
                self._failure(status, X[k + 1], t[k], h, f"sample {k}")
            )
        return X

    def terms(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
        """Return every term of the balances by name at a state (nx,) and inputs w (4,); SI."""
        values = self.terms_along(np.asarray(state)[None], np.asarray(w)[None], np.array([time]))
        return {name: float(v[0]) for name, v in values.items()}

    def terms_along(self, states: np.ndarray, inputs: np.ndarray, time: np.ndarray) -> dict[str, np.ndarray]:
        """Return every term by name along states (N, nx), inputs (N, 4) and times (N,)."""
        x, w, t = (np.ascontiguousarray(a, dtype=float) for a in (states, inputs, time))
        return dict(zip(TERM_NAMES, terms(x, w, t, self._P, self._E).T, strict=True))

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
        if not np.all(np.isfinite(w[:, self._layout.spools])):
            k = int(np.argmin(np.all(np.isfinite(w[:, self._layout.spools]), axis=1)))
            raise CraneError(
                f"inputs: the spool position at sample {k} ({t[k]:g} s) is {w[k, self._layout.spools]}. Give finite numbers."
            )

    def _refuse_stroke_end(self, states: np.ndarray, time: np.ndarray) -> None:
        lengths = _chamber_lengths(np.ascontiguousarray(states), self._P, self._E)
        for c, name in enumerate(self._layout.cylinders):
            if self.crane.effect(f"end_stop@{name}") is not None:
                lengths[:, self._layout.chambers_of(c)] = 1.0
        if not (lengths < 0.0).any():
            return
        k, chamber = np.argwhere(lengths < 0.0)[0]
        raise CraneError(
            f"Semi-recursive engine: a cylinder reached the end of its stroke at t = {time[k]:.3f} s "
            f"({self._chamber(chamber)} empty, {-1e3 * lengths[k, chamber]:.1f} mm beyond). State: {self._told(states[k])}. "
            "Shorten the motion, start elsewhere, or add the effect end_stop to the crane."
        )

    def _failure(self, status: int, x: np.ndarray, time: float, h: float, where: str) -> str:
        if not np.all(np.isfinite(x)):
            return f"Semi-recursive engine: at t = {time:.4f} s ({where}) the state is not finite: {self._told(x)}."
        lengths = _chamber_lengths(x[None], self._P, self._E)[0]
        if np.isnan(lengths).any():
            return self._unreachable(x) + f" It was met at t = {time:.4f} s ({where})."
        chamber = int(np.argmin(lengths))
        what = "did not converge" if status == kernel.NOT_CONVERGED else "is not accurate"
        return (
            f"Semi-recursive engine: the step after t = {time:.4f} s ({where}) {what}, neither with {h:g} s nor "
            f"halved up to {MOST_HALVINGS} times. State: {self._told(x)}. Shortest chamber: "
            f"{self._chamber(chamber)}, {1e3 * lengths[chamber]:.1f} mm. Look for a pose near the limit of the "
            "loop A-B-C-D, a chamber near its end, or parameters out of proportion."
        )

    def _unreachable(self, x: np.ndarray) -> str:
        pose = listed(self._layout.coordinates, np.degrees(x[self._layout.positions]), "{:.2f} deg")
        return f"Semi-recursive engine: the loop A-B-C-D of {self.crane.name} cannot be closed at {pose}: D is out of reach of the brackets. Mend z4 or the joints B, C, D."

    def _chamber(self, k: int) -> str:
        return self._layout.side_of(self._layout.chambers[k])

    def _told(self, x: np.ndarray) -> str:
        lay = self._layout
        angles = listed(lay.coordinates, np.degrees(x[lay.positions]), "{:.3f} deg")
        rates = listed(lay.rates, x[lay.velocities], "{:.4g} rad/s")
        return f"{angles}, {rates}, {listed(lay.chambers, x[lay.pressures] / 1e5, '{:.2f} bar')}"
