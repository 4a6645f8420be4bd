"""The implicit trapezoidal rule (index 2) in redundant coordinates: predictor, and Newton's correction for Exudyn's residual.

    q1 = q0 + h/2 (v0 + v1)     v1 = v0 + h/2 (a0 + a1)     p1 = p0 + h/2 (dp0 + dp1)
    M a1 - f(q1, v1, p1) + G^T lambda = 0                   dp1 = rates(q1, v1, p1, w1)               G v1 = 0

This is what Exudyn's solver does with Newmark beta = 1/4, gamma = 1/2 and velocity-level constraints. Exudyn
assembles the residual of the last line for all cranes; only the linear algebra of Newton's method is done here, crane by
crane and with lambda eliminated by the null space, because Exudyn would differentiate the user functions numerically,
one call a coordinate.
"""

from __future__ import annotations

import math

import numpy as np

from . import hydraulics as hyd
from . import reduction as red
from .compiled import njit
from .effects import hooks
from .parameters import FLUID

# status of a crane in a step
DONE, ITERATING, UNREACHABLE, SINGULAR, DIVERGED = 0, 1, -1, -2, -3
#: increments of Newton's method count in these units: rad/s and Pa
RATE_UNIT, PRESSURE_UNIT = 1.0, 1e7
#: Newton stops when the error left is below this fraction of the units above: 1e-9 rad/s, 0.01 Pa
TOLERANCE = 1e-9
#: finite differences of forces and flows: m/s, rad/s and Pa
_DV, _DP = 1e-7, 20.0


@njit
def start(P, E, t, inertia, x, w, arms, N, q, v, a, p, dp):
    """Fill q, v, a, p, dp of one crane from its state x (8 or 10,): joints closed, accelerations and rates consistent.

    Returns:
        ITERATING, or UNREACHABLE or SINGULAR.
    """
    width, nu = q.size, N.shape[0]
    theta = x[8] if width > 12 else 0.0
    if not red.close_position(P, E, inertia, x[0], x[1], theta, arms, q):
        return UNREACHABLE
    red.null_space(arms, N)
    u = np.empty(nu)
    u[0], u[1] = x[2], x[3]
    if nu > 2:
        u[2] = x[9]
    red.velocities(N, u, v)
    p[:] = x[4:8]
    f, work, M, udd = np.empty(width), np.empty(width), np.empty((nu, nu)), np.empty(nu)
    if not red.accelerations(P, E, t, w, inertia, N, arms, q, v, p, work, f, M, udd, a):
        return SINGULAR
    s1, s2, ds1, ds2, _, _, _, _ = red.cylinder_kinematics(P, arms, q, v)
    hyd.all_pressure_rates(P, E, w, s1, s2, ds1, ds2, p, dp)
    hyd.hold_at_vapour_pressure(P, p, dp)
    return ITERATING


@njit
def predict(P, E, t, h, start_inertia, x, w, q, v, a, p, dp, p0, dp0, status, last):
    """Fill the (n, .) arrays of the end of the step with a first guess: a1 = a0 and dp1 = dp0.

    Args:
        t, h: start and length of the step in s.
        P, E: (n, .) parameters.
        start_inertia: (n, 5, 4) masses at the start of the step.
        x, w: states (n, nx) and inputs (n, 12) at the start of the step.
        p0, dp0: (n, 4), filled with pressures and rates at the start.
        status, last: (n,), set for the first iteration.

    Returns:
        False if a crane's status tells that it has no start.
    """
    width = q.shape[1]
    arms, N = np.zeros((red.N_ARMS, 2)), np.zeros((width // 2 - 4, width))
    good = True
    for k in range(x.shape[0]):
        floor = P[k, FLUID + hyd.VAPOUR]
        status[k] = start(P[k], E[k], t, start_inertia[k], x[k], w[k], arms, N, q[k], v[k], a[k], p0[k], dp0[k])
        last[k] = math.inf
        good = good and status[k] == ITERATING
        for j in range(width):
            v1 = v[k, j] + h * a[k, j]
            q[k, j] += 0.5 * h * (v[k, j] + v1)
            v[k, j] = v1
        for j in range(4):
            p[k, j] = max(p0[k, j] + h * dp0[k, j], floor)
            dp[k, j] = 2.0 / h * (p[k, j] - p0[k, j]) - dp0[k, j]
    return good


@njit
def _tangents(P, E, w, h, s1, s2, ds1, ds2, p, rates, Fv, Fp, Rv, Rp):
    """Fill the derivatives of cylinder forces and pressure rates after cylinder speeds and pressures, by differences.

    A speed at the end of the step moves the length by h/2 of it, which belongs to the derivative after the speed.

    rates (4,): raw pressure rates. Fv (2,): dF_c/dv_c. Fp (2, 4), Rv (4, 2), Rp (4, 4) likewise. Chamber j and j + 2 belong to
    different cylinders and are moved together, except where an effect ties both cylinders to the supply.
    """
    F1, F2 = hyd.cylinder_forces(P, E, w, s1, s2, ds1, ds2, p)
    tied = hyd.all_pressure_rates(P, E, w, s1, s2, ds1, ds2, p, rates)
    moved, ds = np.empty(4), 0.5 * h * _DV
    G1, G2 = hyd.cylinder_forces(P, E, w, s1 + ds, s2 + ds, ds1 + _DV, ds2 + _DV, p)
    Fv[0], Fv[1] = (G1 - F1) / _DV, (G2 - F2) / _DV
    hyd.all_pressure_rates(P, E, w, s1 + ds, s2 + ds, ds1 + _DV, ds2 + _DV, p, moved)
    for i in range(4):
        Rv[i, i // 2] = (moved[i] - rates[i]) / _DV
    for j in range(2):
        pa, pb = p[j], p[j + 2]
        p[j], p[j + 2] = pa + _DP, pb + _DP
        G1, G2 = hyd.cylinder_forces(P, E, w, s1, s2, ds1, ds2, p)
        Fp[0, j], Fp[1, j + 2] = (G1 - F1) / _DP, (G2 - F2) / _DP
        if not tied:
            hyd.all_pressure_rates(P, E, w, s1, s2, ds1, ds2, p, moved)
            Rp[0, j], Rp[1, j] = (moved[0] - rates[0]) / _DP, (moved[1] - rates[1]) / _DP
            Rp[2, j + 2], Rp[3, j + 2] = (moved[2] - rates[2]) / _DP, (moved[3] - rates[3]) / _DP
        p[j], p[j + 2] = pa, pb
    if tied:
        _tied_tangents(P, E, w, s1, s2, ds1, ds2, p, rates, moved, Rp)


@njit
def _tied_tangents(P, E, w, s1, s2, ds1, ds2, p, rates, moved, Rp):
    for j in range(4):
        saved = p[j]
        p[j] = saved + _DP
        hyd.all_pressure_rates(P, E, w, s1, s2, ds1, ds2, p, moved)
        p[j] = saved
        for i in range(4):
            Rp[i, j] = (moved[i] - rates[i]) / _DP


@njit
def _joint_tangents(E, v):
    """Return the derivatives of the two joint torques after their relative rates, by differences."""
    rate_o, rate_a = v[2], v[11] - v[2]
    at_o = (hooks.joint_torque(E, 0, rate_o + _DV) - hooks.joint_torque(E, 0, rate_o)) / _DV
    at_a = (hooks.joint_torque(E, 1, rate_a + _DV) - hooks.joint_torque(E, 1, rate_a)) / _DV
    return at_o, at_a


@njit
def correct(P, E, h, scale, inertia, w, residual, q, v, a, p, dp, p0, dp0, status, last):
    """Improve the end of the step by one Newton iteration for every crane that needs it, given Exudyn's residual there.

    A crane that has converged is left alone, so that its result does not depend on its neighbours.

    Args:
        P, E, inertia: (n, .), (n, .), (n, 5, 4) parameters and masses at the end of the step.
        h: step in s.
        scale: factor that Exudyn's solver has put on the ODE2 rows.
        residual: Exudyn's [M a - f, rates - dp, G v] of all cranes, joint forces left out.
        q, v, a, p, dp: (n, .) end of the step, improved in place;  p0, dp0: (n, 4) its start.
        status: (n,) updated;  last: (n,) size of each crane's last increment in RATE_UNIT and PRESSURE_UNIT.

    Returns:
        how many cranes need a further iteration.
    """
    n, width = q.shape
    nu = width // 2 - 4
    rows = red.N_JOINT_ROWS + nu - 2
    size = nu + 4
    arms, N = np.zeros((red.N_ARMS, 2)), np.zeros((nu, width))
    D, d, work, g = np.zeros((2, nu)), np.zeros(width), np.zeros(width), np.zeros(red.N_JOINT_ROWS + 1)
    A, b = np.zeros((size, size)), np.zeros(size)
    rates, Fv, Fp, Rv, Rp = np.zeros(4), np.zeros(2), np.zeros((2, 4)), np.zeros((4, 2)), np.zeros((4, 4))
    active = 0
    for k in range(n):
        if status[k] != ITERATING:
            continue
        Pk, Ek, mk, qk, vk, pk = P[k], E[k], inertia[k], q[k], v[k], p[k]
        red.arms_of(Pk, mk, qk, arms)
        red.null_space(arms, N)
        s1, s2, ds1, ds2, e1x, e1y, e2x, e2y = red.cylinder_kinematics(Pk, arms, qk, vk)
        for i in range(nu):
            D[0, i], D[1, i] = red.cylinder_rates(arms, N[i], e1x, e1y, e2x, e2y)
        Rp[:] = 0.0
        _tangents(Pk, Ek, w[k], h, s1, s2, ds1, ds2, pk, rates, Fv, Fp, Rv, Rp)
        start_g = n * (width + 4) + rows * k
        for i in range(rows):
            g[i] = -residual[start_g + i]
        red.chain(arms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, g, d)  # the change of velocity that closes the joints
        _fill_system(Ek, h, mk, N, D, vk, Fv, Fp, Rv, Rp, work, A)
        red.mass_times(mk, d, work)
        for j in range(width):
            work[j] = residual[width * k + j] / scale + 2.0 / h * work[j]
        d1, d2 = red.cylinder_rates(arms, d, e1x, e1y, e2x, e2y)
        _fill_right_side(N, D, Fv, Rv, d1, d2, work, residual[n * width + 4 * k :], b)
        _hold_floor(Pk, h, rates, pk, p0[k], dp0[k], nu, A, b)
        if not red.solve(A, b):
            status[k] = SINGULAR
            continue
        change = _apply(Pk, h, N, d, b, qk, vk, a[k], pk, dp[k], p0[k], dp0[k])
        status[k], last[k] = _judge(change, last[k]), change
        active += status[k] == ITERATING
    return active


@njit
def _fill_right_side(N, D, Fv, Rv, d1, d2, force, rate, b):
    """Fill b for residuals `force` (nq,) and `rate` (4,), and cylinder speeds d1, d2 that closing the joints adds."""
    nu = N.shape[0]
    for i in range(nu):
        b[i] = D[0, i] * Fv[0] * d1 + D[1, i] * Fv[1] * d2 - red.dot(N[i], force)
    for j in range(4):
        b[nu + j] = -rate[j] - Rv[j, 0] * d1 - Rv[j, 1] * d2


@njit
def _judge(size, last):
    """Return the status after an increment: the error left is about its size times the last contraction."""
    if not size < math.inf:
        return DIVERGED
    contracted = size < last < math.inf and size * size / last <= TOLERANCE
    return DONE if size <= TOLERANCE or contracted else ITERATING


@njit
def _fill_system(E, h, inertia, N, D, v, Fv, Fp, Rv, Rp, work, A):
    """Fill A: reduced balance (2/h M - dF/dv) and pressure equations, unknowns (du, dp)."""
    nu = N.shape[0]
    at_o, at_a = _joint_tangents(E, v)
    for i in range(nu):
        red.mass_times(inertia, N[i], work)
        for m in range(nu):
            A[m, i] = 2.0 / h * red.dot(N[m], work) - D[0, m] * Fv[0] * D[0, i] - D[1, m] * Fv[1] * D[1, i]
        for j in range(4):
            A[i, nu + j] = -D[0, i] * Fp[0, j] - D[1, i] * Fp[1, j]
            A[nu + j, i] = Rv[j, 0] * D[0, i] + Rv[j, 1] * D[1, i]
    A[0, 0] -= at_o
    A[1, 1] -= at_a
    if nu > 2:
        A[2, 2] += hooks.pendulum(E)[1]
    for i in range(4):
        for j in range(4):
            A[nu + i, nu + j] = Rp[i, j] - (2.0 / h if i == j else 0.0)


@njit
def _hold_floor(P, h, rates, p, p0, dp0, nu, A, b):
    """Replace the equation of a chamber that stays at vapour pressure: its pressure does not change in this iteration.

    It stays there if the trapezoidal rule, with the rate that it would have, leads below the floor.
    """
    floor = P[FLUID + hyd.VAPOUR]
    for j in range(4):
        if p[j] <= floor and p0[j] + 0.5 * h * (dp0[j] + rates[j]) <= floor:
            A[nu + j, :] = 0.0
            A[nu + j, nu + j] = 1.0
            b[nu + j] = 0.0


@njit
def _apply(P, h, N, d, change, q, v, a, p, dp, p0, dp0):
    """Add one Newton increment; return its size."""
    nu, floor = N.shape[0], P[FLUID + hyd.VAPOUR]
    size = 0.0
    for j in range(q.size):
        dv = d[j]
        for i in range(nu):
            dv += N[i, j] * change[i]
        v[j] += dv
        q[j] += 0.5 * h * dv
        a[j] += 2.0 / h * dv
        size = max(size, abs(dv) / RATE_UNIT) if not math.isnan(dv) else math.nan
    for j in range(4):
        moved = max(p[j] + change[nu + j], floor)
        step = abs(moved - p[j]) / PRESSURE_UNIT
        size = max(size, step) if not math.isnan(step + size) else math.nan
        p[j] = moved
        dp[j] = 2.0 / h * (moved - p0[j]) - dp0[j]
    return size


@njit
def finish(P, E, inertia, x, q, v, p, status, out):
    """Fill out (n, nx) with the independent states at the end of the step, of the cranes that are DONE.

    Returns:
        the first crane that is beyond its stroke, or -1.
    """
    width = q.shape[1]
    arms = np.zeros((red.N_ARMS, 2))
    beyond = -1
    for k in range(q.shape[0]):
        if status[k] != DONE:
            continue
        out[k, 0], out[k, 1] = q[k, 2], q[k, 11] - q[k, 2]
        out[k, 2], out[k, 3] = v[k, 2], v[k, 11] - v[k, 2]
        out[k, 4:8] = p[k]
        red.arms_of(P[k], inertia[k], q[k], arms)
        if width > 12:
            theta = math.atan2(arms[red.ROD, 0], -arms[red.ROD, 1])
            out[k, 8] = theta + 2.0 * math.pi * round((x[k, 8] - theta) / (2.0 * math.pi))
            out[k, 9] = red.pendulum_rate(arms, v[k])
        s1, s2, _, _, _, _, _, _ = red.cylinder_kinematics(P[k], arms, q[k], v[k])
        if beyond < 0 and stroke_end(P[k], E[k], s1, s2, p[k]) > 0:
            beyond = k
    return beyond


@njit
def stroke_end(P, E, s1, s2, p):
    """Return 0, or 1 + chamber number (0 to 3) of the first chamber that is shorter than nothing and has no end stop.

    A cylinder that pushes back when its chamber is shortened by a millimetre has an end stop.
    """
    for c in range(2):
        s, pa, pb = (s1, p[0], p[1]) if c == 0 else (s2, p[2], p[3])
        la, lb, va, vb, _, _ = hyd.chambers(P, E, c, s, pa, pb)
        if la < 0.0 and (va <= 0.0 or hooks.cylinder_force(E, c, 0.0, pa, pb, la, lb) <= 0.0):
            return 1 + 2 * c
        if lb < 0.0 and (vb <= 0.0 or hooks.cylinder_force(E, c, 0.0, pa, pb, la, lb) >= 0.0):
            return 2 + 2 * c
    return 0
