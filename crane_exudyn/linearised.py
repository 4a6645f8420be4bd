"""The machine linear about one state: how fast it rings, how well it is damped, what each input does.

Exudyn's own eigenvalue solver looks at coordinates of motion only. The oil's stiffness stands in coordinates of first
order, so what it tells of a hydraulic machine is not what the machine does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .crane import Crane, checked_crane
from .statics import checked_inputs, checked_state, terms

#: half-widths of the central differences by unit; laws bend over 2 bar and some mrad/s
_WIDTH = {"rad": 1e-6, "m": 1e-6, "rad/s": 1e-6, "m/s": 1e-6, "Pa": 1e3}
#: and of a spool's position
_OPENING = 1e-4


@dataclass(frozen=True, repr=False)
class Linearised:
    """x' = rate + A (x - state) + B (w - inputs), in SI.

    Attributes:
        crane: the machine.
        state, inputs: (nx,) and (m,), about which it is linear; supply pressures in numbers.
        rate: (nx,) x' there, zero in equilibrium.
        A, B: (nx, nx), (nx, m).
    """

    crane: Crane
    state: np.ndarray
    inputs: np.ndarray
    rate: np.ndarray
    A: np.ndarray
    B: np.ndarray

    @property
    def eigenvalues(self) -> np.ndarray:
        """Eigenvalues (nx,) of A in 1/s, slowest first."""
        found = np.linalg.eigvals(self.A)
        return np.asarray(found[np.argsort(np.abs(found), kind="stable")])

    @property
    def modes(self) -> tuple[tuple[float, float], ...]:
        """Natural frequency in Hz and damping ratio of every pair of conjugate eigenvalues, slowest first."""
        found = self.eigenvalues
        pairs = (e for e in found if e.imag > 1e-9 * abs(found[-1]))  # the oil of a closed valve leaves zeros
        return tuple((abs(e) / (2.0 * math.pi), float(-e.real / abs(e))) for e in pairs)

    def __repr__(self) -> str:
        rings = ", ".join(f"{f:.3g} Hz (damping ratio {d:.2g})" for f, d in self.modes)
        return f"<Linearised {self.crane.name}: rings with {rings or 'nothing'}>"


def linearise(crane: Crane, state: np.ndarray, inputs: np.ndarray | None = None, time: float = 0.0) -> Linearised:
    """Return the machine linear about a state, by central differences of its balances.

    Args:
        crane: the machine.
        state: (nx,), such as `ExudynEngine(crane).static_start(*crane.initial.pose)`.
        inputs: (m,) w = [spools, pp, pt]; valves closed by default; NaN in pp or pt: the machine's own.
        time: s; effects that begin at a time need it.

    Raises:
        CraneError: a state or inputs of another length, or a machine that cannot stand like that.
    """
    lay = checked_crane(crane, "linearise").layout
    x = checked_state(crane, state)
    w = checked_inputs(crane, np.array(lay.closed if inputs is None else inputs, float))[: len(lay.inputs)].copy()
    own = crane["supply.pump_pressure"], crane["supply.tank_pressure"]
    w[-2:] = np.where(np.isnan(w[-2:]), own, w[-2:])
    names = lay.all_states[: x.size]

    def rates(point: np.ndarray) -> np.ndarray:
        """Return x' at a state with inputs behind it; the rate of a coordinate is a state itself."""
        known = terms(crane, point[: x.size], point[x.size :], time) | dict(zip(names, point, strict=False))
        return np.array([known[f"d{name}"] for name in names])

    point = np.concatenate([x, w])
    widths = [*lay.sized(names, _WIDTH), *[_OPENING] * len(lay.voltages), *[_WIDTH["Pa"]] * len(lay.supply)]
    columns = []
    for moved in np.diag(widths):
        columns.append((rates(point + moved) - rates(point - moved)) / (2.0 * moved.sum()))
    both = np.column_stack(columns)
    return Linearised(crane, x, w, rates(point), both[:, : x.size], both[:, x.size :])
