"""Every term of the balances by name, for cross-checks and for laying beside residuals."""

from __future__ import annotations

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.parameters import POINT_NAMES

from .equations import CYLINDER, HOSE_A, HOSE_B, N_CYLINDER, balance, piston_areas, pressure_rate

#: names of the columns of `terms`
TERM_NAMES: tuple[str, ...] = (
    *(f"{axis}_{name}" for name in POINT_NAMES for axis in "xy"),
    "phi_bracket_1", "phi_bracket_2", "z2", "z3", "dz2_dz4", "dz3_dz4", "s1", "s2", "ds1", "ds2",
    "pp", "pt", "Q1", "Q2", "Q3", "Q4", "leak1", "leak2", "leak3", "leak4", "V1", "V2", "V3", "V4",
    "Be1", "Be2", "Be3", "Be4", "dp1", "dp2", "dp3", "dp4", "Fmu1", "Fmu2", "F1", "F2",
    "M11", "M12", "M22", "Qg1", "Qg4", "Qv1", "Qv4", "Qh1", "Qh4", "Qj1", "Qj4", "ddz1", "ddz4", "ddtheta",
    "l1", "l2", "l3", "l4", "v_h1", "v_h2", "N1", "N2", "N3", "N4",
)  # fmt: skip
_COUNT = len(TERM_NAMES)


@njit(cache=False)
def _angle(e):
    return np.arctan2(e.imag, e.real)


@njit(cache=False)
def bulk(oil, V):
    """Return the effective bulk modulus Be (14), (41) of a chamber of volume V: V dp = Be dN / k."""
    return oil.density * V / oil.by_pressure


@njit(cache=False)
def _fill(b, P, out):
    z, m, c, d = b.z, b.m, b.c1, b.c2
    A1, A2 = piston_areas(CYLINDER, P)
    A3, A4 = piston_areas(CYLINDER + N_CYLINDER, P)
    V1, V2 = P[CYLINDER + HOSE_A] + A1 * c.la, P[CYLINDER + HOSE_B] + A2 * c.lb
    V3, V4 = P[CYLINDER + N_CYLINDER + HOSE_A] + A3 * d.la, P[CYLINDER + N_CYLINDER + HOSE_B] + A4 * d.lb
    k = 0
    for r in (z.O, z.F, z.G, z.H, z.B, z.A, z.C, z.D_bracket, z.D, z.E):
        out[k], out[k + 1] = r.real, r.imag
        k += 2
    for value in (
        _angle(z.e2), _angle(z.e3), _angle(z.e2 * z.e1.conjugate()), _angle(z.e3 * z.e2.conjugate()),
        m.R2, m.R3, b.lift.s, b.tilt.s, b.lift.v, b.tilt.v,
        b.pp, b.pt, c.Qa, c.Qb, d.Qa, d.Qb, c.leak_a, c.leak_b, d.leak_a, d.leak_b, V1, V2, V3, V4,
        bulk(c.a, V1), bulk(c.b, V2), bulk(d.a, V3), bulk(d.b, V4),
        pressure_rate(c.a, c.Ga, A1, c.v), pressure_rate(c.b, c.Gb, -A2, c.v),
        pressure_rate(d.a, d.Ga, A3, d.v), pressure_rate(d.b, d.Gb, -A4, d.v), c.Fmu, d.Fmu, c.F, d.F,
        b.M11, b.M14, b.M44, b.Qg1, b.Qg4, b.Qv1, b.Qv4, b.Qh1, b.Qh4, b.Qj1, b.Qj4, b.ddz1, b.ddz4, b.ddtheta,
        c.la, c.lb, d.la, d.lb, c.v, d.v, c.a.amount, c.b.amount, d.a.amount, d.b.amount,
    ):  # fmt: skip
        out[k] = value
        k += 1


@njit
def terms(X, W, time, P, E):
    """Return all terms (N, len(TERM_NAMES)) at states X (N, nx), inputs W (N, 4) and times (N,).

    Forces on the joints: M zdd = Qg + Qv + Qh + Qj for [z1 z4], where Qh holds the cylinder forces with their friction and
    Qj the joints' own torques and the force on the tip. Be are effective bulk moduli, v_h hydraulic cylinder rates.
    N are amounts of oil; pressures and their rates are those of the state, which go on below vapour pressure where a void opens.
    """
    out = np.empty((X.shape[0], _COUNT))
    for i in range(X.shape[0]):
        _fill(balance(X[i], W[i], time[i], P, E), P, out[i])
    return out
