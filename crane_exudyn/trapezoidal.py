"""The implicit trapezoidal rule (index 2) in redundant coordinates: predictor, and Newton's correction for Exudyn's residual.

    q1 = q0 + h/2 (v0 + v1)     v1 = v0 + h/2 (a0 + a1)     N1 = N0 + h/2 (N0' + N1')
    M a1 - f(q1, v1, p1) + G^T lambda = 0                   G v1 = 0

N are the amounts of oil in the chambers, so that what flows is what is there more. Exudyn has the pressures y as coordinates and
assembles the residual "rates - dy" of (34); dy is what makes it zero exactly when the rule holds for N:

    dy = (2/h (N1 - N0) - N0' - growth) / slope,            slope dy/dt = N' - growth,  see hydraulics.chamber_balances

The rest is what Exudyn's solver does with Newmark beta = 1/4, gamma = 1/2 and velocity-level constraints. Exudyn
assembles the residual for all cranes; only the linear algebra of Newton's method is done here, crane by
crane and with lambda eliminated by the null space, because Exudyn would differentiate the user functions numerically,
one call a coordinate.

The local error of a step is the defect of the trapezoidal rule against Simpson's, h/3 (f0 + f1 - 2 fm), with the rates fm in the
middle of Hermite's interpolation.
"""

from __future__ import annotations

import math

import numpy as np

from . import hydraulics as hyd
from . import reduction as red
from .compiled import njit
from .effects import hooks
from .parameters import FLUID
from .step_control import POSITION_ERROR, PRESSURE_ERROR, RATE_ERROR

# status of a crane in a step
DONE, ITERATING, UNREACHABLE, SINGULAR, DIVERGED, COARSE = 0, 1, -1, -2, -3, -4
#: increments of Newton's method count in these units: rad/s and Pa
RATE_UNIT, PRESSURE_UNIT = 1.0, 1e7
#: Newton stops when the error left is below this fraction of the units above: 1e-9 rad/s, 0.01 Pa
TOLERANCE = 1e-9
#: finite differences of forces and flows: m/s, rad/s and Pa
_DV, _DP = 1e-7, 20.0
GAIN, AMOUNT, DRAW, SLOPE, N_BALANCES = hyd.GAIN, hyd.AMOUNT, hyd.DRAW, hyd.SLOPE, hyd.N_BALANCES


@njit
def start(P, E, t, inertia, x, w, arms, N, q, v, a, p, dp, held, udd):
    """Fill q, v, a, p, dp of one crane from its state x (8 or 10,): joints closed, accelerations and rates consistent.

    Args:
        held: (N_BALANCES, 4), filled with `hydraulics.chamber_balances`; udd: (nu,), with the independent accelerations.

    Returns:
        ITERATING, or UNREACHABLE or SINGULAR.
    """
    width, nu = q.size, N.shape[0]
    if not red.place(P, E, inertia, x, arms, N, q, v):
        return UNREACHABLE
    p[:] = x[4:8]
    f, work, M = np.empty(width), np.empty(width), np.empty((nu, nu))
    if not red.accelerations(P, E, t, w, inertia, N, arms, q, v, p, work, f, M, udd, a):
        return SINGULAR
    s1, s2, ds1, ds2, _, _, _, _ = red.cylinder_kinematics(P, arms, q, v)
    v1, v2, _ = hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, held)
    hyd.pressure_rates(held, v1, v2, dp)
    return ITERATING


@njit
def _refer(P, E, before, inertia, x, udd, arms, N, q, v, a):
    """Refer q, v, a of one crane to the centres of mass that it has at the end of a step, if they move within it.

    A payload that is taken up moves the centre of its body, but not the body.
    """
    if np.array_equal(before, inertia):
        return
    red.place(P, E, inertia, x, arms, N, q, v)
    red.centripetal(arms, v, a)
    for j in range(a.size):
        for i in range(udd.size):
            a[j] += N[i, j] * udd[i]


@njit
def predict(P, E, t, h, start_inertia, inertia, x, w, udd, q, v, a, p, dp, held, status, last):
    """Fill the (n, .) arrays of the end of the step with a first guess: a1 = a0 and dp1 = dp0.

    Args:
        t, h: start and length of the step in s.
        P, E: (n, .) parameters.
        start_inertia, inertia: (n, 5, 4) masses at the start and the end of the step.
        x, w: states (n, nx) and inputs (n, 12) at the start of the step.
        held: (n, N_BALANCES, 4) filled with the chambers' balances at the start;  udd: (n, nu) with the accelerations there.
        status, last: (n,), set for the first iteration.

    Returns:
        False if a crane's status tells that it has no start.
    """
    width = q.shape[1]
    arms, N, balances = np.zeros((red.N_ARMS, 2)), np.zeros((width // 2 - 4, width)), np.empty((N_BALANCES, 4))
    good = True
    for k in range(x.shape[0]):
        ends = (q[k], v[k], a[k], p[k], dp[k], held[k], udd[k])
        status[k] = start(P[k], E[k], t, start_inertia[k], x[k], w[k], arms, N, *ends)
        last[k] = math.inf
        good = good and status[k] == ITERATING
        _refer(P[k], E[k], start_inertia[k], inertia[k], x[k], udd[k], arms, N, q[k], v[k], a[k])
        for j in range(width):
            v1 = v[k, j] + h * a[k, j]
            q[k, j] += 0.5 * h * (v[k, j] + v1)
            v[k, j] = v1
        red.arms_of(P[k], inertia[k], q[k], arms)
        for j in range(4):
            p[k, j] += h * dp[k, j]
        s1, s2, ds1, ds2, _, _, _, _ = red.cylinder_kinematics(P[k], arms, q[k], v[k])
        _required_rates(P[k], E[k], w[k], h, s1, s2, ds1, ds2, p[k], held[k], balances, dp[k])
    return good


@njit
def _required_rates(P, E, w, h, s1, s2, ds1, ds2, p, held, balances, dp):
    """Fill dp (4,) with the pressure rates at the end of a step with which the rule holds for the amounts of oil."""
    v1, v2, _ = hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, balances)
    for j in range(4):
        growth = balances[DRAW, j] * (v1 if j < 2 else v2)
        wanted = 2.0 / h * (balances[AMOUNT, j] - held[AMOUNT, j]) - held[GAIN, j]
        dp[j] = (wanted - growth) / balances[SLOPE, j]


@njit
def _tangents(P, E, w, h, s1, s2, ds1, ds2, p, base, Fv, Fp, Rv, Rp):
    """Fill the derivatives of cylinder forces and chambers' defects after cylinder speeds and pressures.

    The defect of a chamber is (dN/dt - 2/h N)/(dN/dy). A speed at the end of the step moves the length by h/2 of it, which
    belongs to the derivative after the speed; flows do not depend on it. The rest is by differences.

    base (N_BALANCES, 4): filled with the balances here. Fv (2,): dF_c/dv_c. Fp (2, 4), Rv (4, 2), Rp (4, 4) likewise. Chamber j
    and j + 2 belong to different cylinders and are moved together, except where an effect ties both cylinders to the supply.
    """
    F1, F2 = hyd.cylinder_forces(P, E, w, s1, s2, ds1, ds2, p)
    moved, ds = np.empty((N_BALANCES, 4)), 0.5 * h * _DV
    _, _, tied = hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, base)
    G1, G2 = hyd.cylinder_forces(P, E, w, s1 + ds, s2 + ds, ds1 + _DV, ds2 + _DV, p)
    Fv[0], Fv[1] = (G1 - F1) / _DV, (G2 - F2) / _DV
    for i in range(4):
        Rv[i, i // 2] = -base[DRAW, i] / base[SLOPE, i]
    for j in range(2):
        pa, pb = p[j], p[j + 2]
        p[j], p[j + 2] = pa + _DP, pb + _DP
        G1, G2 = hyd.cylinder_forces(P, E, w, s1, s2, ds1, ds2, p)
        Fp[0, j], Fp[1, j + 2] = (G1 - F1) / _DP, (G2 - F2) / _DP
        if not tied:
            hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, moved)
            Rp[0, j], Rp[1, j] = _defect_by_pressure(base, moved, h, 0), _defect_by_pressure(base, moved, h, 1)
            Rp[2, j + 2], Rp[3, j + 2] = _defect_by_pressure(base, moved, h, 2), _defect_by_pressure(base, moved, h, 3)
        p[j], p[j + 2] = pa, pb
    if tied:
        for j in range(4):
            saved = p[j]
            p[j] = saved + _DP
            hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, moved)
            p[j] = saved
            for i in range(4):
                Rp[i, j] = _defect_by_pressure(base, moved, h, i)


@njit
def _defect_by_pressure(base, moved, h, i):
    """Return the derivative of the defect of chamber i, from the balances before and after a change by _DP."""
    change = moved[GAIN, i] - base[GAIN, i] - 2.0 / h * (moved[AMOUNT, i] - base[AMOUNT, i])
    return change / (_DP * base[SLOPE, i])


@njit
def _joint_tangents(E, v):
    """Return the derivatives of the two joint torques after their relative rates, by differences."""
    rate_o, rate_a = v[2], v[11] - v[2]
    at_o = (hooks.joint_torque(E, 0, rate_o + _DV) - hooks.joint_torque(E, 0, rate_o)) / _DV
    at_a = (hooks.joint_torque(E, 1, rate_a + _DV) - hooks.joint_torque(E, 1, rate_a)) / _DV
    return at_o, at_a


@njit
def correct(P, E, h, scale, inertia, w, residual, q, v, a, p, dp, held, status, last):
    """Improve the end of the step by one Newton iteration for every crane that needs it, given Exudyn's residual there.

    A crane that has converged is left alone, so that its result does not depend on its neighbours.

    Args:
        P, E, inertia: (n, .), (n, .), (n, 5, 4) parameters and masses at the end of the step.
        h: step in s.
        scale: factor that Exudyn's solver has put on the ODE2 rows.
        residual: Exudyn's [M a - f, rates - dp, G v] of all cranes, joint forces left out.
        q, v, a, p, dp: (n, .) end of the step, improved in place;  held: (n, N_BALANCES, 4) the chambers' balances at its start.
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
    Fv, Rv, balances = np.zeros(2), np.zeros((4, 2)), np.empty((N_BALANCES, 4))
    active = 0
    for k in range(n):
        if status[k] != ITERATING:
            continue
        Pk, Ek, mk, qk, vk, pk = P[k], E[k], inertia[k], q[k], v[k], p[k]
        red.arms_of(Pk, mk, qk, arms)
        e1x, e1y, e2x, e2y = _linearised(Pk, Ek, h, mk, w[k], qk, vk, pk, arms, N, D, Fv, Rv, balances, work, A)
        start_g = n * (width + 4) + rows * k
        for i in range(rows):
            g[i] = -residual[start_g + i]
        red.chain(arms, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, g, d)  # the change of velocity that closes the joints
        red.mass_times(mk, d, work)
        for j in range(width):
            work[j] = residual[width * k + j] / scale + 2.0 / h * work[j]
        d1, d2 = red.cylinder_rates(arms, d, e1x, e1y, e2x, e2y)
        _fill_right_side(N, D, Fv, Rv, d1, d2, work, residual[n * width + 4 * k :], b)
        if not red.solve(A, b):
            status[k] = SINGULAR
            continue
        change = _apply(Pk, Ek, w[k], h, mk, N, d, b, arms, balances, qk, vk, a[k], pk, dp[k], held[k])
        status[k], last[k] = _judge(change, last[k]), change
        active += status[k] == ITERATING
    return active


@njit
def _linearised(P, E, h, inertia, w, q, v, p, arms, N, D, Fv, Rv, balances, work, A):
    """Fill null space N, cylinder rates D, derivatives Fv, Rv, the chambers' balances and the system A of a crane.

    Returns:
        the cylinders' directions.
    """
    red.null_space(arms, N)
    s1, s2, ds1, ds2, e1x, e1y, e2x, e2y = red.cylinder_kinematics(P, arms, q, v)
    for i in range(N.shape[0]):
        D[0, i], D[1, i] = red.cylinder_rates(arms, N[i], e1x, e1y, e2x, e2y)
    Fp, Rp = np.zeros((2, 4)), np.zeros((4, 4))
    _tangents(P, E, w, h, s1, s2, ds1, ds2, p, balances, Fv, Fp, Rv, Rp)
    _fill_system(E, h, inertia, N, D, v, Fv, Fp, Rv, Rp, work, A)
    return e1x, e1y, e2x, e2y


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
            A[nu + i, nu + j] = Rp[i, j]


@njit
def _apply(P, E, w, h, inertia, N, d, change, arms, balances, q, v, a, p, dp, held):
    """Add one Newton increment; return its size. `balances` are those before it, and scratch.

    The amounts of oil take the linear change, the pressures follow from them: so the iteration meets no kink where a void
    closes or gas is pressed together.
    """
    nu, size = N.shape[0], 0.0
    s1, s2, _, _, _, _, _, _ = red.cylinder_kinematics(P, arms, q, v)
    for j in range(q.size):
        dv = d[j]
        for i in range(nu):
            dv += N[i, j] * change[i]
        v[j] += dv
        q[j] += 0.5 * h * dv
        a[j] += 2.0 / h * dv
        size = max(size, abs(dv) / RATE_UNIT) if not math.isnan(dv) else math.nan
    for j in range(4):
        step = abs(change[nu + j]) / PRESSURE_UNIT
        size = max(size, step) if not math.isnan(step + size) else math.nan
    red.arms_of(P, inertia, q, arms)
    s3, s4, ds3, ds4, _, _, _, _ = red.cylinder_kinematics(P, arms, q, v)
    a1, a2 = hyd.changed_amounts(P, E, 0, balances, p[0], p[1], s3 - s1, change[nu], change[nu + 1])
    a3, a4 = hyd.changed_amounts(P, E, 1, balances, p[2], p[3], s4 - s2, change[nu + 2], change[nu + 3])
    p[0], p[1] = hyd.settled_pressures(P, E, 0, s3, a1, a2, p[0], p[1])
    p[2], p[3] = hyd.settled_pressures(P, E, 1, s4, a3, a4, p[2], p[3])
    _required_rates(P, E, w, h, s3, s4, ds3, ds4, p, held, balances, dp)
    return size


@njit
def finish(P, E, t, h, allowed, inertia, x, w0, w1, q, v, p, held, udd, status, errors, out):
    """Fill out (n, nx) with the independent states at the end of the step, of the cranes that are DONE.

    `errors` (n,) get the local errors of their steps. A crane whose error is too large becomes COARSE.

    Args:
        t, h: start and length of the step in s;  x, w0: (n, .) states and inputs at its start;  w1: inputs at its end.
        allowed: local error in units of `step_control.*_ERROR`.
        inertia: (n, 5, 4) masses at the end of the step.

    Returns:
        the first crane that is beyond its stroke, or -1.
    """
    width = q.shape[1]
    arms, N, balances = np.zeros((red.N_ARMS, 2)), np.zeros((width // 2 - 4, width)), np.empty((N_BALANCES, 4))
    beyond = -1
    for k in range(q.shape[0]):
        if status[k] != DONE:
            continue
        read_motion(P[k], inertia[k], x[k], q[k], v[k], arms, out[k])
        s1, s2 = _settle(P[k], E[k], h, inertia[k], w1[k], arms, q[k], v[k], p[k], held[k], balances, out[k])
        if beyond < 0 and stroke_end(P[k], E[k], s1, s2, out[k, 4:8]) > 0:
            beyond = k
        what = (inertia[k], x[k], out[k], w0[k], w1[k], arms, N, q[k], v[k], held[k], balances[GAIN], udd[k])
        errors[k] = _local_error(P[k], E[k], t, h, allowed, *what)
        if not errors[k] <= allowed:
            status[k] = COARSE
    return beyond


@njit
def read_motion(P, inertia, x, q, v, arms, out):
    """Write the independent coordinates and rates of redundant ones to out (nx,); a pendulum's angle stays near that in x."""
    out[0], out[1] = q[2], q[11] - q[2]
    out[2], out[3] = v[2], v[11] - v[2]
    if q.size > 12:
        red.arms_of(P, inertia, q, arms)
        theta = math.atan2(arms[red.ROD, 0], -arms[red.ROD, 1])
        out[8] = theta + 2.0 * math.pi * round((x[8] - theta) / (2.0 * math.pi))
        out[9] = red.pendulum_rate(arms, v)


@njit
def _settle(P, E, h, inertia, w, arms, q, v, p, held, balances, out):
    """Write the pressures that belong to the amounts of oil at the end of a step to out (nx,), at its pose with all joints closed.

    Returns:
        pin-to-pin lengths of the cylinders in m; `balances` (N_BALANCES, 4) is filled.
    """
    theta = out[8] if q.size > 12 else 0.0
    red.close_position(P, E, inertia, out[0], out[1], theta, arms, q)
    s1, s2, ds1, ds2, _, _, _, _ = red.cylinder_kinematics(P, arms, q, v)
    hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, balances)
    for j in range(4):
        balances[AMOUNT, j] = held[AMOUNT, j] + 0.5 * h * (held[GAIN, j] + balances[GAIN, j])
    N1, N2, N3, N4 = balances[AMOUNT]
    out[4], out[5] = hyd.settled_pressures(P, E, 0, s1, N1, N2, p[0], p[1])
    out[6], out[7] = hyd.settled_pressures(P, E, 1, s2, N3, N4, p[2], p[3])
    return s1, s2


@njit
def _local_error(P, E, t, h, allowed, inertia, x, out, w0, w1, arms, N, q, v, held, gain, udd):
    """Return the local error of one crane's step in units of `step_control.*_ERROR`; arms, N, q, v are scratch.

    First by the change of the rates over the step, which bounds the defect of rates that change one way; then by the rates in
    the middle; then after what the system's stiffness makes of it.
    """
    nu = udd.size
    after, defect = np.empty(nu), np.empty(nu + 4)
    for i in range(nu):
        rate = 2 + i if i < 2 else 9
        after[i] = 2.0 / h * (out[rate] - x[rate]) - udd[i]
        defect[i] = h / 3.0 * (after[i] - udd[i])
    for j in range(4):
        defect[nu + j] = h / 3.0 * (gain[j] - held[GAIN, j])
    positions = 0.25 * h * np.abs(defect[:nu])
    error = _size(P, held, defect, positions)
    if error <= allowed:
        return error
    middle, w, width = np.empty(x.size), np.empty(w0.size), q.size
    for i in range(w.size):
        w[i] = 0.5 * (w0[i] + w1[i])
    amount, between, dp = np.empty(4), np.empty((N_BALANCES, 4)), np.empty(4)
    for i in range(nu):
        place, rate = (i, 2 + i) if i < 2 else (8, 9)
        middle[place] = 0.5 * (x[place] + out[place]) + 0.125 * h * (x[rate] - out[rate])
        middle[rate] = 0.5 * (x[rate] + out[rate]) + 0.125 * h * (udd[i] - after[i])
    theta = middle[8] if nu > 2 else 0.0
    if not red.close_position(P, E, inertia, middle[0], middle[1], theta, arms, q):
        return math.inf
    s1, s2, _, _, _, _, _, _ = red.cylinder_kinematics(P, arms, q, v)
    for j in range(4):
        amount[j] = (
            held[AMOUNT, j] + 0.5 * h * (0.5 * (held[GAIN, j] + gain[j])) + 0.125 * h * (held[GAIN, j] - gain[j])
        )
    middle[4], middle[5] = hyd.settled_pressures(P, E, 0, s1, amount[0], amount[1], x[4], x[5])
    middle[6], middle[7] = hyd.settled_pressures(P, E, 1, s2, amount[2], amount[3], x[6], x[7])
    a, p, there = np.empty(width), np.empty(4), np.empty(nu)
    if start(P, E, t + 0.5 * h, inertia, middle, w, arms, N, q, v, a, p, dp, between, there) != ITERATING:
        return math.inf
    for i in range(nu):
        defect[i] = h / 3.0 * (udd[i] + after[i] - 2.0 * there[i])
    for j in range(4):
        defect[nu + j] = h / 3.0 * (held[GAIN, j] + gain[j] - 2.0 * between[GAIN, j])
    error = _size(P, held, defect, positions)
    if error <= allowed:
        return error
    return _stiff_error(P, E, h, inertia, w, arms, N, q, v, p, held, between, defect, positions)


@njit
def _size(P, held, defect, positions):
    """Return the largest of the defects (nu + 4,) of rates and amounts, and of the positions' (nu,), in units of `step_control.*_ERROR`."""
    nu, error = positions.size, 0.0
    for i in range(nu):
        error = max(error, abs(defect[i]) / RATE_ERROR, positions[i] / POSITION_ERROR)
    for j in range(4):
        error = max(error, abs(defect[nu + j]) * P[FLUID + hyd.OIL] / (held[AMOUNT, j] * PRESSURE_ERROR))
    return error if error == error else math.inf


@njit
def _stiff_error(P, E, h, inertia, w, arms, N, q, v, p, held, balances, defect, positions):
    """Return the error left of a defect by one iteration of Newton's method towards Simpson's rule, around the middle of the step."""
    nu, width = positions.size, q.size
    D, Fv, Rv, work = np.zeros((2, nu)), np.zeros(2), np.zeros((4, 2)), np.zeros(width)
    A, b, M = np.zeros((nu + 4, nu + 4)), np.empty(nu + 4), np.zeros((nu, nu))
    _linearised(P, E, h, inertia, w, q, v, p, arms, N, D, Fv, Rv, balances, work, A)
    red.reduced_mass(inertia, N, work, M)
    for i in range(nu):
        b[i] = 2.0 / h * red.dot(M[i], defect[:nu])
    for j in range(4):
        b[nu + j] = -2.0 / h * defect[nu + j] / balances[SLOPE, j]
    if not red.solve(A, b):
        return math.inf
    left = np.empty(nu + 4)
    left[:nu] = b[:nu]
    for j in range(4):
        left[nu + j] = b[nu + j] * balances[SLOPE, j]
    return _size(P, held, left, positions)


@njit
def stroke_end(P, E, s1, s2, p):
    """Return 0, or 1 + chamber number (0 to 3) of the first chamber that is shorter than nothing and has no end stop.

    A cylinder that pushes back when its chamber is shortened by a millimetre has an end stop.
    """
    for c in range(2):
        s, pa, pb = (s1, p[0], p[1]) if c == 0 else (s2, p[2], p[3])
        la, lb, va, vb, _, _ = hyd.chambers(P, E, c, s, pa, pb)
        pa, pb = max(pa, hyd.vapour_pressure(P)), max(pb, hyd.vapour_pressure(P))
        if la < 0.0 and (va <= 0.0 or hooks.cylinder_force(E, c, 0.0, pa, pb, la, lb) <= 0.0):
            return 1 + 2 * c
        if lb < 0.0 and (vb <= 0.0 or hooks.cylinder_force(E, c, 0.0, pa, pb, la, lb) >= 0.0):
            return 2 + 2 * c
    return 0
