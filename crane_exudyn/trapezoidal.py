"""The implicit trapezoidal rule (index 2) in redundant coordinates: predictor, and Newton's correction for Exudyn's
residual.

    q1 = q0 + h/2 (v0 + v1)     v1 = v0 + h/2 (a0 + a1)     N1 = N0 + h/2 (N0' + N1')
    M a1 - f(q1, v1, p1) + G^T lambda = 0                   G v1 = 0

N are the amounts of oil in the chambers, so that what flows is what is there more. Exudyn has the pressures y as
coordinates and assembles the residual "rates - dy" of (34); dy is what makes it zero exactly when the rule holds for N:

    dy = (2/h (N1 - N0) - N0' - growth) / slope,            slope dy/dt = N' - growth,  see hydraulics.chamber_balances

The rest is what Exudyn's solver does with Newmark beta = 1/4, gamma = 1/2 and velocity-level constraints. Exudyn
assembles the residual for all cranes; only the linear algebra of Newton's method is done here, crane by
crane and with lambda eliminated by the null space, because Exudyn would differentiate the user functions numerically,
one call a coordinate.

The local error of a step is the defect of the trapezoidal rule against Simpson's, h/3 (f0 + f1 - 2 fm), with the rates
fm in the middle of Hermite's interpolation.
"""

from __future__ import annotations

import math

import numpy as np

from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from .compiled import njit, part
from .effects import hooks
from .geometry import LENGTH, RATE
from .machine import BODIES, CYLINDERS
from .parameters import FLUID
from .step_control import POSITION_ERROR, PRESSURE_ERROR, RATE_ERROR

# status of a machine in a step
DONE, ITERATING, UNREACHABLE, SINGULAR, DIVERGED, COARSE = 0, 1, -1, -2, -3, -4
#: increments of Newton's method count in these units: rad/s (or m/s) and Pa
RATE_UNIT, PRESSURE_UNIT = 1.0, 1e7
#: Newton stops when the error left is below this fraction of the units above: 1e-9 rad/s, 0.01 Pa
TOLERANCE = 1e-9
#: finite differences of forces and flows: m/s, rad/s and Pa
_DV, _DP = 1e-7, 20.0
GAIN, AMOUNT, DRAW, SLOPE, SPEED, N_BALANCES = hyd.GAIN, hyd.AMOUNT, hyd.DRAW, hyd.SLOPE, hyd.SPEED, hyd.N_BALANCES


@part
def widths(topology, swinging):
    """Return how many redundant coordinates and how many independent velocities a machine has."""
    extra = 1 if swinging else 0
    return 3 * topology[0, BODIES] + 2 * extra, topology[0, CYLINDERS] + extra


@njit
def new_lines(topology):
    """Return an empty table of the cylinders as lines."""
    return np.empty((topology[0, CYLINDERS], geo.N_LINE))


@njit
def start(topology, P, E, t, inertia, x, w, push, arms, lines, N, q, v, a, p, dp, held, udd):
    """Fill q, v, a, p, dp of one machine from its state x (nx,): joints closed, accelerations and rates consistent.

    Args:
        push: (nq,) forces of somebody's own objects.
        held: (N_BALANCES, chambers), filled with `hydraulics.chamber_balances`; udd: (nu,), with the independent
            accelerations.

    Returns:
        ITERATING, or UNREACHABLE or SINGULAR.
    """
    width, nu, n = q.size, N.shape[0], topology[0, CYLINDERS]
    if not red.place(topology, P, E, inertia, x, arms, N, q, v):
        return UNREACHABLE
    p[:] = x[2 * n : 4 * n]
    f, work, M = np.empty(width), np.empty(width), np.empty((nu, nu))
    if not red.accelerations(topology, P, E, t, w, inertia, N, arms, lines, q, v, p, push, work, f, M, udd, a):
        return SINGULAR
    hyd.chamber_balances(topology, P, E, w, lines, p, held)
    hyd.pressure_rates(held, dp)
    return ITERATING


@njit
def _refer(topology, P, E, before, inertia, x, udd, arms, N, q, v, a):
    """Refer q, v, a of one machine to the centres of mass that it has at the end of a step, if they move within it.

    A payload that is taken up moves the centre of its body, but not the body.
    """
    if np.array_equal(before, inertia):
        return
    red.place(topology, P, E, inertia, x, arms, N, q, v)
    red.centripetal(topology, arms, v, a)
    for j in range(a.size):
        for i in range(udd.size):
            a[j] += N[i, j] * udd[i]


@njit
def forces_at(topology, P, E, t, inertia, x, w, q, v, p, f):
    """Fill q, v, p and f, the applied forces that the machines themselves have, of states x (m, nx) at t; (m, .)
    each.
    """
    n = topology[0, CYLINDERS]
    arms, lines, N = (
        red.new_arms(topology),
        new_lines(topology),
        np.zeros((widths(topology, red.swings(topology, q[0]))[1], q.shape[1])),
    )
    for k in range(x.shape[0]):
        red.place(topology, P[k], E[k], inertia[k], x[k], arms, N, q[k], v[k])
        p[k] = x[k, 2 * n : 4 * n]
        red.applied_forces(topology, P[k], E[k], t, w[k], inertia[k], arms, lines, q[k], v[k], p[k], f[k])


@njit
def predict(topology, P, E, t, h, start_inertia, inertia, x, w, push, udd, q, v, a, p, dp, held, status, last):
    """Fill the (m, .) arrays of the end of the step with a first guess: a1 = a0 and dp1 = dp0.

    Args:
        t, h: start and length of the step in s.
        P, E: (m, .) parameters.
        start_inertia, inertia: (m, bodies + 1, 4) masses at the start and the end of the step.
        x, w: states (m, nx) and inputs (m, .) at the start of the step;  push: (m, nq) forces of somebody's own objects
            there.
        held: (m, N_BALANCES, chambers) filled with the chambers' balances at the start;  udd: (m, nu) with the
            accelerations there.
        status, last: (m,), set for the first iteration.

    Returns:
        False if a machine's status tells that it has no start.
    """
    width, chambers = q.shape[1], p.shape[1]
    arms, N, lines = red.new_arms(topology), np.zeros((udd.shape[1], width)), new_lines(topology)
    balances, good = np.empty((N_BALANCES, chambers)), True
    for k in range(x.shape[0]):
        ends = (q[k], v[k], a[k], p[k], dp[k], held[k], udd[k])
        status[k] = start(topology, P[k], E[k], t, start_inertia[k], x[k], w[k], push[k], arms, lines, N, *ends)
        last[k] = math.inf
        good = good and status[k] == ITERATING
        _refer(topology, P[k], E[k], start_inertia[k], inertia[k], x[k], udd[k], arms, N, q[k], v[k], a[k])
        for j in range(width):
            v1 = v[k, j] + h * a[k, j]
            q[k, j] += 0.5 * h * (v[k, j] + v1)
            v[k, j] = v1
        red.arms_of(topology, P[k], inertia[k], q[k], arms)
        for j in range(chambers):
            p[k, j] += h * dp[k, j]
        geo.fill_lines(topology, arms, q[k], v[k], lines)
        _required_rates(topology, P[k], E[k], w[k], h, lines, p[k], held[k], balances, dp[k])
    return good


@part
def _required_rates(topology, P, E, w, h, lines, p, held, balances, dp):
    """Fill dp (chambers,) with the pressure rates at the end of a step with which the rule holds for the amounts of
    oil.
    """
    hyd.chamber_balances(topology, P, E, w, lines, p, balances)
    for j in range(dp.size):
        wanted = 2.0 / h * (balances[AMOUNT, j] - held[AMOUNT, j]) - held[GAIN, j]
        dp[j] = (wanted - balances[DRAW, j] * balances[SPEED, j]) / balances[SLOPE, j]


@njit
def _tangents(topology, P, E, w, h, lines, p, base, Fv, Fp, Rv, Rp):
    """Fill the derivatives of cylinder forces and chambers' defects after cylinder speeds and pressures.

    The defect of a chamber is (dN/dt - 2/h N)/(dN/dy). A speed at the end of the step moves the length by h/2 of it,
    which belongs to the derivative after the speed; flows do not depend on it. The rest is by differences.

    base (N_BALANCES, chambers): filled with the balances here. Fv (cylinders,): dF_c/dv_c. Fp (chambers,): of the
    chamber's own cylinder; Rv (chambers,) likewise; Rp (chambers, chambers). Chambers of different cylinders are moved
    together, except where an effect ties the cylinders to the supply.
    """
    n = Fv.size
    F, G, moved, shifted = np.empty(n), np.empty(n), np.empty((N_BALANCES, 2 * n)), lines.copy()
    hyd.cylinder_forces(topology, P, E, w, lines, p, F)
    tied = hyd.chamber_balances(topology, P, E, w, lines, p, base)
    for c in range(n):
        shifted[c, LENGTH] += 0.5 * h * _DV
        shifted[c, RATE] += _DV
    hyd.cylinder_forces(topology, P, E, w, shifted, p, G)
    for c in range(n):
        Fv[c] = (G[c] - F[c]) / _DV
    for i in range(2 * n):
        Rv[i] = -base[DRAW, i] / base[SLOPE, i]
    Rp[:] = 0.0
    saved = p.copy()
    for side in (0, 1):  # piston side, rod side
        for c in range(n):
            p[2 * c + side] += _DP
        hyd.cylinder_forces(topology, P, E, w, lines, p, G)
        if not tied:
            hyd.chamber_balances(topology, P, E, w, lines, p, moved)
        for c in range(n):
            j = 2 * c + side
            Fp[j] = (G[c] - F[c]) / _DP
            if not tied:
                Rp[2 * c, j] = _defect_by_pressure(base, moved, h, 2 * c)
                Rp[2 * c + 1, j] = _defect_by_pressure(base, moved, h, 2 * c + 1)
        p[:] = saved
    if tied:
        for j in range(2 * n):
            p[j] += _DP
            hyd.chamber_balances(topology, P, E, w, lines, p, moved)
            p[j] = saved[j]
            for i in range(2 * n):
                Rp[i, j] = _defect_by_pressure(base, moved, h, i)


@part
def _defect_by_pressure(base, moved, h, i):
    """Return the derivative of the defect of chamber i, from the balances before and after a change by _DP."""
    change = moved[GAIN, i] - base[GAIN, i] - 2.0 / h * (moved[AMOUNT, i] - base[AMOUNT, i])
    return change / (_DP * base[SLOPE, i])


@njit
def correct(topology, P, E, h, scale, inertia, w, residual, q, v, a, p, dp, held, status, last):
    """Improve the end of the step by one Newton iteration for every machine that needs it, given Exudyn's residual
    there.

    A machine that has converged is left alone, so that its result does not depend on its neighbours.

    Args:
        P, E, inertia: (m, .), (m, .), (m, bodies + 1, 4) parameters and masses at the end of the step.
        h: step in s.
        scale: factor that Exudyn's solver has put on the ODE2 rows.
        residual: Exudyn's [M a - f, rates - dp, G v] of all machines, joint forces left out.
        q, v, a, p, dp: (m, .) end of the step, improved in place;  held: (m, N_BALANCES, chambers) the chambers'
            balances at its start.
        status: (m,) updated;  last: (m,) size of each machine's last increment in RATE_UNIT and PRESSURE_UNIT.

    Returns:
        how many machines need a further iteration.
    """
    (n, width), chambers = q.shape, p.shape[1]
    swinging = red.swings(topology, q[0])
    _, nu = widths(topology, swinging)
    rows, size, cylinders = red.joint_equations(topology, swinging), nu + chambers, chambers // 2
    arms, N, lines, D = red.new_arms(topology), np.zeros((nu, width)), new_lines(topology), np.zeros((cylinders, nu))
    d, work, g = np.zeros(width), np.zeros(width), np.zeros(rows)
    A, b, Fv, Rv, balances = (
        np.zeros((size, size)),
        np.zeros(size),
        np.zeros(cylinders),
        np.zeros(chambers),
        np.empty((N_BALANCES, chambers)),
    )
    ds, none = np.zeros(cylinders), np.empty(0)
    active = 0
    for k in range(n):
        if status[k] != ITERATING:
            continue
        Pk, Ek, mk, qk, vk, pk = P[k], E[k], inertia[k], q[k], v[k], p[k]
        red.arms_of(topology, Pk, mk, qk, arms)
        _linearised(topology, Pk, Ek, h, mk, w[k], qk, vk, pk, arms, lines, N, D, Fv, Rv, balances, work, A)
        start_g = n * (width + chambers) + rows * k
        for i in range(rows):
            g[i] = -residual[start_g + i]
        red.chain(topology, arms, -1, none, g, d)  # the change of velocity that closes the joints
        red.mass_times(mk, d, work)
        for j in range(width):
            work[j] = residual[width * k + j] / scale + 2.0 / h * work[j]
        for c in range(cylinders):
            ds[c] = geo.line_rate(topology, arms, d, lines, c)
        first = n * width + chambers * k
        _fill_right_side(N, D, Fv, Rv, ds, work, residual[first : first + chambers], b)
        if not red.solve(A, b):
            status[k] = SINGULAR
            continue
        change = _apply(topology, Pk, Ek, w[k], h, mk, N, d, b, arms, lines, balances, qk, vk, a[k], pk, dp[k], held[k])
        status[k], last[k] = _judge(change, last[k]), change
        active += status[k] == ITERATING
    return active


@njit
def _linearised(topology, P, E, h, inertia, w, q, v, p, arms, lines, N, D, Fv, Rv, balances, work, A):
    """Fill lines, null space N, cylinder rates D, derivatives Fv, Rv, the chambers' balances and the system A of a
    machine.
    """
    red.null_space(topology, arms, N)
    geo.fill_lines(topology, arms, q, v, lines)
    for c in range(D.shape[0]):
        for i in range(N.shape[0]):
            D[c, i] = geo.line_rate(topology, arms, N[i], lines, c)
    Fp, Rp = np.empty(p.size), np.empty((p.size, p.size))
    _tangents(topology, P, E, w, h, lines, p, balances, Fv, Fp, Rv, Rp)
    _fill_system(topology, E, h, inertia, arms, N, D, v, Fv, Fp, Rv, Rp, work, A)


@part
def _fill_right_side(N, D, Fv, Rv, ds, force, rate, b):
    """Fill b for residuals `force` (nq,) and `rate` (chambers,), and cylinder speeds ds that closing the joints
    adds.
    """
    nu = N.shape[0]
    for i in range(nu):
        b[i] = -red.dot(N[i], force)
        for c in range(ds.size):
            b[i] += D[c, i] * Fv[c] * ds[c]
    for j in range(rate.size):
        b[nu + j] = -rate[j] - Rv[j] * ds[j // 2]


@part
def _judge(size, last):
    """Return the status after an increment: the error left is about its size times the last contraction."""
    if not size < math.inf:
        return DIVERGED
    contracted = size < last < math.inf and size * size / last <= TOLERANCE
    return DONE if size <= TOLERANCE or contracted else ITERATING


@part
def _fill_system(topology, E, h, inertia, arms, N, D, v, Fv, Fp, Rv, Rp, work, A):
    """Fill A: reduced balance (2/h M - dF/dv) and pressure equations, unknowns (du, dp)."""
    nu, n = N.shape[0], D.shape[0]
    for i in range(nu):
        red.mass_times(inertia, N[i], work)
        for m in range(nu):
            A[m, i] = 2.0 / h * red.dot(N[m], work)
            for c in range(n):
                A[m, i] -= D[c, m] * Fv[c] * D[c, i]
        for j in range(2 * n):
            A[i, nu + j] = -D[j // 2, i] * Fp[j]
            A[nu + j, i] = Rv[j] * D[j // 2, i]
    for b in range(topology[0, BODIES]):
        i = topology[1 + b, red.COORDINATE]
        if i >= 0:
            rate, at = red.coordinate_rate(topology, arms, v, b), red.coordinate(topology, arms, b)
            A[i, i] -= (hooks.joint_torque(E, i, rate + _DV, at) - hooks.joint_torque(E, i, rate, at)) / _DV
    if nu > n:
        A[n, n] += hooks.pendulum(E)[1]
    for i in range(2 * n):
        for j in range(2 * n):
            A[nu + i, nu + j] = Rp[i, j]


@njit
def _apply(topology, P, E, w, h, inertia, N, d, change, arms, lines, balances, q, v, a, p, dp, held):
    """Add one Newton increment; return its size. `balances` are those before it, and scratch; so are `lines`.

    The amounts of oil take the linear change, the pressures follow from them: so the iteration meets no kink where a
    void closes or gas is pressed together.
    """
    nu, n, size = N.shape[0], lines.shape[0], 0.0
    before = lines[:, LENGTH].copy()
    for j in range(q.size):
        dv = d[j]
        for i in range(nu):
            dv += N[i, j] * change[i]
        v[j] += dv
        q[j] += 0.5 * h * dv
        a[j] += 2.0 / h * dv
        size = max(size, abs(dv) / RATE_UNIT) if not math.isnan(dv) else math.nan
    for j in range(p.size):
        step = abs(change[nu + j]) / PRESSURE_UNIT
        size = max(size, step) if not math.isnan(step + size) else math.nan
    red.arms_of(topology, P, inertia, q, arms)
    geo.fill_lines(topology, arms, q, v, lines)
    for c in range(n):
        i, j, s = 2 * c, 2 * c + 1, lines[c, LENGTH]
        ya, yb = change[nu + i], change[nu + j]
        Na, Nb = hyd.changed_amounts(P, E, c, balances, p[i], p[j], s - before[c], ya, yb)
        p[i], p[j] = hyd.settled_pressures(P, E, c, s, Na, Nb, p[i], p[j])
    _required_rates(topology, P, E, w, h, lines, p, held, balances, dp)
    return size


@njit
def finish(topology, P, E, t, h, allowed, inertia, x, w0, w1, push, q, v, p, held, udd, status, errors, out):
    """Fill out (m, nx) with the independent states at the end of the step, of the machines that are DONE.

    `errors` (m,) get the local errors of their steps. A machine whose error is too large becomes COARSE.

    Args:
        t, h: start and length of the step in s;  x, w0, push: (m, .) states, inputs and forces of somebody's own
            objects at its start;
        w1: inputs at its end.
        allowed: local error in units of `step_control.*_ERROR`.
        inertia: (m, bodies + 1, 4) masses at the end of the step.

    Returns:
        the first machine that is beyond its stroke, or -1.
    """
    width, n = q.shape[1], topology[0, CYLINDERS]
    arms, N, lines = red.new_arms(topology), np.zeros((udd.shape[1], width)), new_lines(topology)
    balances, beyond = np.empty((N_BALANCES, 2 * n)), -1
    for k in range(q.shape[0]):
        if status[k] != DONE:
            continue
        red.arms_of(topology, P[k], inertia[k], q[k], arms)
        red.read_motion(topology, arms, x[k], q[k], v[k], out[k])
        _settle(topology, P[k], E[k], h, inertia[k], w1[k], arms, lines, q[k], v[k], p[k], held[k], balances, out[k])
        if beyond < 0 and stroke_end(P[k], E[k], lines, out[k, 2 * n : 4 * n]) > 0:
            beyond = k
        what = (
            inertia[k],
            x[k],
            out[k],
            w0[k],
            w1[k],
            push[k],
            arms,
            lines,
            N,
            q[k],
            v[k],
            held[k],
            balances[GAIN],
            udd[k],
        )
        errors[k] = _local_error(topology, P[k], E[k], t, h, allowed, *what)
        if not errors[k] <= allowed:
            status[k] = COARSE
    return beyond


@part
def _settle(topology, P, E, h, inertia, w, arms, lines, q, v, p, held, balances, out):
    """Write the pressures that belong to the amounts of oil at the end of a step to out (nx,), at its pose with all
    joints closed.

    `lines` and `balances` (N_BALANCES, chambers) are filled.
    """
    n = topology[0, CYLINDERS]
    theta = out[4 * n] if red.swings(topology, q) else 0.0
    red.close_position(topology, P, E, inertia, out, theta, arms, q)
    geo.fill_lines(topology, arms, q, v, lines)
    hyd.chamber_balances(topology, P, E, w, lines, p, balances)
    for j in range(2 * n):
        balances[AMOUNT, j] = held[AMOUNT, j] + 0.5 * h * (held[GAIN, j] + balances[GAIN, j])
    hyd.settle(P, E, lines, balances[AMOUNT], p, out[2 * n : 4 * n])


@njit
def _local_error(topology, P, E, t, h, allowed, inertia, x, out, w0, w1, push, arms, lines, N, q, v, held, gain, udd):
    """Return the local error of one machine's step in units of `step_control.*_ERROR`; arms, lines, N, q, v are
    scratch.

    First by the change of the rates over the step, which bounds the defect of rates that change one way; then by the
    rates in the middle; then after what the system's stiffness makes of it.
    """
    nu, n, chambers = udd.size, topology[0, CYLINDERS], gain.size
    after, defect = np.empty(nu), np.empty(nu + chambers)
    for i in range(nu):
        rate = red.rate_place(n, i)
        after[i] = 2.0 / h * (out[rate] - x[rate]) - udd[i]
        defect[i] = h / 3.0 * (after[i] - udd[i])
    for j in range(chambers):
        defect[nu + j] = h / 3.0 * (gain[j] - held[GAIN, j])
    positions = 0.25 * h * np.abs(defect[:nu])
    error = _size(P, held, defect, positions)
    if error <= allowed:
        return error
    middle, w, width = np.empty(x.size), np.empty(w0.size), q.size
    for i in range(w.size):
        w[i] = 0.5 * (w0[i] + w1[i])
    amount, between, dp = np.empty(chambers), np.empty((N_BALANCES, chambers)), np.empty(chambers)
    for i in range(nu):
        place, rate = red.position_place(n, i), red.rate_place(n, i)
        middle[place] = 0.5 * (x[place] + out[place]) + 0.125 * h * (x[rate] - out[rate])
        middle[rate] = 0.5 * (x[rate] + out[rate]) + 0.125 * h * (udd[i] - after[i])
    theta = middle[4 * n] if nu > n else 0.0
    if not red.close_position(topology, P, E, inertia, middle, theta, arms, q):
        return math.inf
    geo.fill_lines(topology, arms, q, v, lines)
    for j in range(chambers):
        amount[j] = (
            held[AMOUNT, j] + 0.5 * h * (0.5 * (held[GAIN, j] + gain[j])) + 0.125 * h * (held[GAIN, j] - gain[j])
        )
    hyd.settle(P, E, lines, amount, x[2 * n : 4 * n], middle[2 * n : 4 * n])
    a, p, there = np.empty(width), np.empty(chambers), np.empty(nu)
    what = (middle, w, push, arms, lines, N, q, v, a, p, dp, between, there)
    if start(topology, P, E, t + 0.5 * h, inertia, *what) != ITERATING:
        return math.inf
    for i in range(nu):
        defect[i] = h / 3.0 * (udd[i] + after[i] - 2.0 * there[i])
    for j in range(chambers):
        defect[nu + j] = h / 3.0 * (held[GAIN, j] + gain[j] - 2.0 * between[GAIN, j])
    error = _size(P, held, defect, positions)
    if error <= allowed:
        return error
    return _stiff_error(topology, P, E, h, inertia, w, arms, lines, N, q, v, p, held, between, defect, positions)


@njit
def _size(P, held, defect, positions):
    """Return the largest of the defects (nu + chambers,) of rates and amounts, and of the positions' (nu,), in units of
    `step_control.*_ERROR`.
    """
    nu, error = positions.size, 0.0
    for i in range(nu):
        error = max(error, abs(defect[i]) / RATE_ERROR, positions[i] / POSITION_ERROR)
    for j in range(defect.size - nu):
        error = max(error, abs(defect[nu + j]) * P[FLUID + hyd.OIL] / (held[AMOUNT, j] * PRESSURE_ERROR))
    return error if error == error else math.inf


@njit
def _stiff_error(topology, P, E, h, inertia, w, arms, lines, N, q, v, p, held, balances, defect, positions):
    """Return the error left of a defect by one iteration of Newton's method towards Simpson's rule, around the middle
    of the step.
    """
    nu, width, chambers = positions.size, q.size, p.size
    D, Fv, Rv, work = np.zeros((chambers // 2, nu)), np.zeros(chambers // 2), np.zeros(chambers), np.zeros(width)
    A, b, M = np.zeros((nu + chambers, nu + chambers)), np.empty(nu + chambers), np.zeros((nu, nu))
    _linearised(topology, P, E, h, inertia, w, q, v, p, arms, lines, N, D, Fv, Rv, balances, work, A)
    red.reduced_mass(inertia, N, work, M)
    for i in range(nu):
        b[i] = 2.0 / h * red.dot(M[i], defect[:nu])
    for j in range(chambers):
        b[nu + j] = -2.0 / h * defect[nu + j] / balances[SLOPE, j]
    if not red.solve(A, b):
        return math.inf
    left = np.empty(nu + chambers)
    left[:nu] = b[:nu]
    for j in range(chambers):
        left[nu + j] = b[nu + j] * balances[SLOPE, j]
    return _size(P, held, left, positions)


@part
def stroke_end(P, E, lines, p):
    """Return 0, or 1 + number of the first chamber that is shorter than nothing and has no end stop.

    A cylinder that pushes back harder beyond its end than at it has an end stop.
    """
    for c in range(lines.shape[0]):
        pa, pb = p[2 * c], p[2 * c + 1]
        la, lb, va, vb, _, _ = hyd.chambers(P, E, c, lines[c, LENGTH], pa, pb)
        pa, pb = max(pa, hyd.vapour_pressure(P)), max(pb, hyd.vapour_pressure(P))
        push = hooks.cylinder_force(E, c, 0.0, pa, pb, la, lb)
        if la < 0.0 and (va <= 0.0 or push <= hooks.cylinder_force(E, c, 0.0, pa, pb, 0.0, la + lb)):
            return 1 + 2 * c
        if lb < 0.0 and (vb <= 0.0 or push >= hooks.cylinder_force(E, c, 0.0, pa, pb, la + lb, 0.0)):
            return 2 + 2 * c
    return 0
