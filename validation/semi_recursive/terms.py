"""Every term of the balances by name, for cross-checks and for laying beside residuals."""

from __future__ import annotations

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.parameters import POINT_NAMES

from .equations import FLOOR, balance

#: names of the columns of `terms`
TERM_NAMES: tuple[str, ...] = (
    *(f"{axis}_{name}" for name in POINT_NAMES for axis in "xy"),
    "phi_bracket_1", "phi_bracket_2", "z2", "z3", "dz2_dz4", "dz3_dz4", "s1", "s2", "ds1", "ds2",
    "pp", "pt", "Q1", "Q2", "Q3", "Q4", "leak1", "leak2", "leak3", "leak4", "V1", "V2", "V3", "V4",
    "Be1", "Be2", "Be3", "Be4", "dp1", "dp2", "dp3", "dp4", "Fmu1", "Fmu2", "F1", "F2",
    "M11", "M12", "M22", "Qg1", "Qg4", "Qv1", "Qv4", "Qh1", "Qh4", "Qj1", "Qj4", "ddz1", "ddz4", "ddtheta",
    "l1", "l2", "l3", "l4", "v_h1", "v_h2",
)  # fmt: skip
_COUNT, _DP1 = len(TERM_NAMES), TERM_NAMES.index("dp1")


@njit(cache=False)
def _angle(e):
    return np.arctan2(e.imag, e.real)


@njit(cache=False)
def _fill(b, out):
    z, m, c, d = b.z, b.m, b.c1, b.c2
    k = 0
    for r in (z.O, z.F, z.G, z.H, z.B, z.A, z.C, z.D_bracket, z.D, z.E):
        out[k], out[k + 1] = r.real, r.imag
        k += 2
    for value in (
        _angle(z.e2), _angle(z.e3), _angle(z.e2 * z.e1.conjugate()), _angle(z.e3 * z.e2.conjugate()),
        m.R2, m.R3, b.lift.s, b.tilt.s, b.lift.v, b.tilt.v,
        b.pp, b.pt, c.Qa, c.Qb, d.Qa, d.Qb, c.leak_a, c.leak_b, d.leak_a, d.leak_b, c.Va, c.Vb, d.Va, d.Vb,
        c.Ba, c.Bb, d.Ba, d.Bb, c.dpa, c.dpb, d.dpa, d.dpb, c.Fmu, d.Fmu, c.F, d.F,
        b.M11, b.M14, b.M44, b.Qg1, b.Qg4, b.Qv1, b.Qv4, b.Qh1, b.Qh4, b.Qj1, b.Qj4, b.ddz1, b.ddz4, b.ddtheta,
        c.la, c.lb, d.la, d.lb, c.v, d.v,
    ):  # fmt: skip
        out[k] = value
        k += 1


@njit(cache=False)
def _hold_at_floor(x, floor, out):
    for k in range(4):
        if x[4 + k] <= floor and out[_DP1 + k] < 0.0:
            out[_DP1 + k] = 0.0


@njit
def terms(X, W, time, P, E):
    """Return all terms (N, len(TERM_NAMES)) at states X (N, nx), inputs W (N, 4) and times (N,).

    Forces on the joints: M zdd = Qg + Qv + Qh + Qj for [z1 z4], where Qh holds the cylinder forces with their friction and
    Qj the joints' own torques and the force on the tip. Be are effective bulk moduli, v_h hydraulic cylinder rates.
    Pressure rates stop at the vapour floor as in `rhs`.
    """
    out = np.empty((X.shape[0], _COUNT))
    for i in range(X.shape[0]):
        _fill(balance(X[i], W[i], time[i], P, E), out[i])
        _hold_at_floor(X[i], P[FLOOR], out[i])
    return out
