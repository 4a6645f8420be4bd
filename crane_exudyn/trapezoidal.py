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
from typing import NamedTuple

import numpy as np

from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from .compiled import lean, njit
from .effects import hooks
from .geometry import LENGTH, RATE
from .machine import BODIES, CYLINDERS
from .parameters import FLUID
from .reduction import Machine, Motion, Scratch
from .step_control import POSITION_ERROR, PRESSURE_ERROR, RATE_ERROR

# status of a machine in a step
DONE, ITERATING, UNREACHABLE, SINGULAR, DIVERGED, COARSE = 0, 1, -1, -2, -3, -4
#: increments of Newton's method count in these units: rad/s (or m/s) and Pa
RATE_UNIT, PRESSURE_UNIT = 1.0, 1e7
#: Newton stops when the error left is below this fraction of the units above: 1e-9 rad/s, 0.01 Pa; where a step may
#: have a larger local error, when it is below so much by unit of that (a filter: 6e-6 rad/s, 60 Pa, of 2e-3 and 2 bar)
TOLERANCE, ROUGHLY = 1e-9, 1e-8
#: what the first iteration is taken to leave by the square of its increment; four to fifteen times that was the most
#: along the cycles of three machines, from states up to 6 bar off
_LEFT_BY_SQUARE = 20.0
#: finite differences of forces and flows: m/s, rad/s and Pa
_DV, _DP = 1e-7, 20.0
GAIN, AMOUNT, DRAW, SLOPE, SPEED, N_BALANCES = hyd.GAIN, hyd.AMOUNT, hyd.DRAW, hyd.SLOPE, hyd.SPEED, hyd.N_BALANCES


@lean
def widths(topology, swinging):
    """Return how many redundant coordinates and how many independent velocities a machine has."""
    extra = 1 if swinging else 0
    return 3 * topology[0, BODIES] + 2 * extra, topology[0, CYLINDERS] + extra


@njit
def new_lines(topology):
    """Return an empty table of the cylinders as lines."""
    return np.empty((topology[0, CYLINDERS], geo.N_LINE))


class Step(NamedTuple):
    """A step of several machines, a row each: start t and length h in s, states x and inputs w0 at its start, inputs w1
    at its end, forces push (m, nq) of somebody's own objects at its start.
    """

    t: float
    h: float
    x: np.ndarray
    w0: np.ndarray
    w1: np.ndarray
    push: np.ndarray


class Slopes(NamedTuple):
    """Derivatives after cylinder speeds and pressures: of the cylinders' forces, Fv (cylinders,) and, of the chamber's
    own cylinder, Fp (chambers,); of the chambers' defects, Rv (chambers,) and Rp (chambers, chambers).
    """

    Fv: np.ndarray
    Fp: np.ndarray
    Rv: np.ndarray
    Rp: np.ndarray


class Linear(NamedTuple):
    """One machine's equations of a Newton iteration: cylinder rates D (cylinders, nu), slopes, balances of the
    chambers, matrix A of the unknowns (du, dp), and room to work.
    """

    D: np.ndarray
    slopes: Slopes
    balances: np.ndarray
    A: np.ndarray
    work: np.ndarray


@njit
def _scratch(topology, nu, width):
    """Return empty tables of a machine."""
    return Scratch(red.new_arms(topology), new_lines(topology), np.zeros((nu, width)))


@njit
def _linear(nu, width, chambers):
    """Return empty equations of a machine."""
    n, size = chambers // 2, nu + chambers
    slopes = Slopes(np.zeros(n), np.zeros(chambers), np.zeros(chambers), np.zeros((chambers, chambers)))
    balances = np.empty((N_BALANCES, chambers))
    return Linear(np.zeros((n, nu)), slopes, balances, np.zeros((size, size)), np.zeros(width))


@njit
def _one(machines, k):
    """Return one of several machines."""
    return Machine(machines.topology, machines.P[k], machines.E[k], machines.inertia[k])


@njit
def _motion_of(ends, k):
    """Return the motion of one of several machines."""
    return Motion(ends.q[k], ends.v[k], ends.a[k], ends.p[k], ends.dp[k], ends.held[k], ends.udd[k])


@njit
def start(machine, t, x, w, push, scratch, now):
    """Fill `now`, the motion of one machine, from its state x (nx,): joints closed, accelerations and rates consistent.

    push: (nq,) forces of somebody's own objects.

    Returns:
        ITERATING, or UNREACHABLE or SINGULAR.
    """
    topology, P, E, inertia = machine
    n = topology[0, CYLINDERS]
    if not red.place(topology, P, E, inertia, x, scratch.arms, scratch.N, now.q, now.v):
        return UNREACHABLE
    now.p[:] = x[2 * n : 4 * n]
    if not red.accelerations(machine, t, w, push, scratch, now):
        return SINGULAR
    hyd.chamber_balances(topology, P, E, w, scratch.lines, now.p, now.held)
    hyd.pressure_rates(now.held, now.dp)
    return ITERATING


@njit
def _refer(machine, before, x, scratch, end):
    """Refer the motion of one machine to the centres of mass that it has at the end of a step, if they move within it.

    A payload that is taken up moves the centre of its body, but not the body. `before`: the masses at the start.
    """
    if np.array_equal(before, machine.inertia):
        return
    topology, P, E, inertia = machine
    red.place(topology, P, E, inertia, x, scratch.arms, scratch.N, end.q, end.v)
    red.centripetal(topology, scratch.arms, end.v, end.a)
    for j in range(end.a.size):
        for i in range(end.udd.size):
            end.a[j] += scratch.N[i, j] * end.udd[i]


@njit
def forces_at(machines, t, x, w, q, v, p, f):
    """Fill q, v, p and f, the applied forces that the machines themselves have, of states x (m, nx) at t; (m, .)
    each.
    """
    machines = Machine(*machines)
    topology = machines.topology
    n, nu = topology[0, CYLINDERS], widths(topology, red.swings(topology, q[0]))[1]
    arms, lines, N = _scratch(topology, nu, q.shape[1])
    for k in range(x.shape[0]):
        machine = _one(machines, k)
        red.place(topology, machine.P, machine.E, machine.inertia, x[k], arms, N, q[k], v[k])
        p[k] = x[k, 2 * n : 4 * n]
        red.applied_forces(machine, t, w[k], arms, lines, q[k], v[k], p[k], f[k])


@njit
def predict(machines, start_inertia, step, ends, status, last):
    """Fill `ends`, the motions at the end of the step, with a first guess: a1 = a0 and dp1 = dp0.

    What is called from Python gets tuples in the order of `Machine`, `Step` and `Motion`; numba reads these faster.

    Args:
        machines: with the masses at the end of the step;  start_inertia: (m, bodies + 1, 4), those at its start.
        status, last: (m,), set for the first iteration.

    Returns:
        False if a machine's status tells that it has no start.
    """
    machines, step, ends = Machine(*machines), Step(*step), Motion(*ends)
    topology, h, good = machines.topology, step.h, True
    scratch = _scratch(topology, ends.udd.shape[1], ends.q.shape[1])
    balances = np.empty((N_BALANCES, ends.p.shape[1]))
    for k in range(step.x.shape[0]):
        machine, end, x, w = _one(machines, k), _motion_of(ends, k), step.x[k], step.w0[k]
        at_start = Machine(topology, machine.P, machine.E, start_inertia[k])
        status[k], last[k] = start(at_start, step.t, x, w, step.push[k], scratch, end), math.inf
        good = good and status[k] == ITERATING
        _refer(machine, start_inertia[k], x, scratch, end)
        for j in range(end.q.size):
            v1 = end.v[j] + h * end.a[j]
            end.q[j] += 0.5 * h * (end.v[j] + v1)
            end.v[j] = v1
        red.arms_of(topology, machine.P, machine.inertia, end.q, scratch.arms)
        for j in range(end.p.size):
            end.p[j] += h * end.dp[j]
        geo.fill_lines(topology, scratch.arms, end.q, end.v, scratch.lines)
        _required_rates(machine, w, h, scratch.lines, end, balances)
    return good


@lean
def _required_rates(machine, w, h, lines, end, balances):
    """Fill the pressure rates at the end of a step with which the rule holds for the amounts of oil."""
    hyd.chamber_balances(machine.topology, machine.P, machine.E, w, lines, end.p, balances)
    for j in range(end.dp.size):
        wanted = 2.0 / h * (balances[AMOUNT, j] - end.held[AMOUNT, j]) - end.held[GAIN, j]
        end.dp[j] = (wanted - balances[DRAW, j] * balances[SPEED, j]) / balances[SLOPE, j]


@njit
def _tangents(machine, w, h, lines, p, base, slopes):
    """Fill the derivatives of cylinder forces and chambers' defects after cylinder speeds and pressures.

    The defect of a chamber is (dN/dt - 2/h N)/(dN/dy). A speed at the end of the step moves the length by h/2 of it,
    which belongs to the derivative after the speed; flows do not depend on it. The rest is by differences.

    base (N_BALANCES, chambers): filled with the balances here. Chambers of different cylinders are moved together,
    except where an effect ties the cylinders to the supply.
    """
    topology, P, E, _ = machine
    Fv, Fp, Rv, Rp = slopes
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


@lean
def _defect_by_pressure(base, moved, h, i):
    """Return the derivative of the defect of chamber i, from the balances before and after a change by _DP."""
    change = moved[GAIN, i] - base[GAIN, i] - 2.0 / h * (moved[AMOUNT, i] - base[AMOUNT, i])
    return change / (_DP * base[SLOPE, i])


@njit
def correct(machines, h, scale, w, residual, ends, status, last, tolerance):
    """Improve the end of the step by one Newton iteration for every machine that needs it, given Exudyn's residual
    there.

    A machine that has converged is left alone, so that its result does not depend on its neighbours.

    Args:
        machines: with parameters and masses at the end of the step.
        h: step in s.
        scale: factor that Exudyn's solver has put on the ODE2 rows.
        w: (m, .) inputs at the end of the step.
        residual: Exudyn's [M a - f, rates - dp, G v] of all machines, joint forces left out.
        ends: the motions at the end of the step, improved in place.
        status: (m,) updated;  last: (m,) size of each machine's last increment in RATE_UNIT and PRESSURE_UNIT.
        tolerance: error that may be left, in the same units.

    Returns:
        how many machines need a further iteration.
    """
    machines, ends = Machine(*machines), Motion(*ends)
    topology, (n, width), chambers = machines.topology, ends.q.shape, ends.p.shape[1]
    swinging = red.swings(topology, ends.q[0])
    rows, nu, cylinders = red.joint_equations(topology, swinging), widths(topology, swinging)[1], chambers // 2
    scratch, linear = _scratch(topology, nu, width), _linear(nu, width, chambers)
    d, work, g, b = np.zeros(width), linear.work, np.zeros(rows), np.zeros(nu + chambers)
    ds, none, active = np.zeros(cylinders), np.empty(0), 0
    for k in range(n):
        if status[k] != ITERATING:
            continue
        machine, end = _one(machines, k), _motion_of(ends, k)
        red.arms_of(topology, machine.P, machine.inertia, end.q, scratch.arms)
        _linearise(machine, h, w[k], end, scratch, linear)
        start_g = n * (width + chambers) + rows * k
        for i in range(rows):
            g[i] = -residual[start_g + i]
        red.chain(topology, scratch.arms, -1, none, g, d)  # the change of velocity that closes the joints
        red.mass_times(machine.inertia, d, work)
        for j in range(width):
            work[j] = residual[width * k + j] / scale + 2.0 / h * work[j]
        for c in range(cylinders):
            ds[c] = geo.line_rate(topology, scratch.arms, d, scratch.lines, c)
        first = n * width + chambers * k
        _fill_right_side(scratch.N, linear, ds, residual[first : first + chambers], b)
        if not red.solve(linear.A, b):
            status[k] = SINGULAR
            continue
        change = _apply(machine, w[k], h, d, b, scratch, linear.balances, end)
        status[k], last[k] = _judge(change, last[k], tolerance), change
        active += status[k] == ITERATING
    return active


@njit
def _linearise(machine, h, w, now, scratch, linear):
    """Fill `linear` and `scratch` for a machine at a motion; the arms must belong to it."""
    topology, lines, N = machine.topology, scratch.lines, scratch.N
    red.null_space(topology, scratch.arms, N)
    geo.fill_lines(topology, scratch.arms, now.q, now.v, lines)
    for c in range(linear.D.shape[0]):
        for i in range(N.shape[0]):
            linear.D[c, i] = geo.line_rate(topology, scratch.arms, N[i], lines, c)
    _tangents(machine, w, h, lines, now.p, linear.balances, linear.slopes)
    _fill_system(machine, h, now.v, scratch, linear)


@lean
def _fill_right_side(N, linear, ds, rate, b):
    """Fill b for residuals of the forces, in `linear.work`, and `rate` (chambers,), and cylinder speeds ds that closing
    the joints adds.
    """
    nu, slopes = N.shape[0], linear.slopes
    for i in range(nu):
        b[i] = -red.dot(N[i], linear.work)
        for c in range(ds.size):
            b[i] += linear.D[c, i] * slopes.Fv[c] * ds[c]
    for j in range(rate.size):
        b[nu + j] = -rate[j] - slopes.Rv[j] * ds[j // 2]


@lean
def _judge(size, last, tolerance):
    """Return the status after an increment: the error left is about its size times the last contraction."""
    if not size < math.inf:
        return DIVERGED
    left = size * min(_LEFT_BY_SQUARE * size if last == math.inf else size / last, 1.0)
    return DONE if left <= tolerance else ITERATING


@lean
def _fill_system(machine, h, v, scratch, linear):
    """Fill A: reduced balance (2/h M - dF/dv) and pressure equations, unknowns (du, dp)."""
    topology, _, E, inertia = machine
    arms, _, N = scratch
    D, (Fv, Fp, Rv, Rp), _, A, work = linear
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
def _apply(machine, w, h, d, change, scratch, balances, end):
    """Add one Newton increment; return its size. `balances` are those before it, and scratch; so are `lines`.

    The amounts of oil take the linear change, the pressures follow from them: so the iteration meets no kink where a
    void closes or gas is pressed together.
    """
    topology, P, E, inertia = machine
    arms, lines, N = scratch
    q, v, a, p = end.q, end.v, end.a, end.p
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
    _required_rates(machine, w, h, lines, end, balances)
    return size


@njit
def finish(machines, step, allowed, enough, ends, status, errors, out):
    """Fill out (m, nx) with the independent states at the end of the step, of the machines that are DONE.

    `errors` (m,) get the local errors of their steps. A machine whose error is too large becomes COARSE.

    Args:
        machines: with the masses at the end of the step.
        allowed: local error in units of `step_control.*_ERROR`; enough: below which no better estimate is needed.

    Returns:
        the first machine that is beyond its stroke, or -1.
    """
    machines, step, ends = Machine(*machines), Step(*step), Motion(*ends)
    topology, width = machines.topology, ends.q.shape[1]
    n, beyond = topology[0, CYLINDERS], -1
    scratch, balances = _scratch(topology, ends.udd.shape[1], width), np.empty((N_BALANCES, 2 * n))
    for k in range(ends.q.shape[0]):
        if status[k] != DONE:
            continue
        machine, end = _one(machines, k), _motion_of(ends, k)
        own = Step(step.t, step.h, step.x[k], step.w0[k], step.w1[k], step.push[k])
        red.arms_of(topology, machine.P, machine.inertia, end.q, scratch.arms)
        red.read_motion(topology, scratch.arms, own.x, end.q, end.v, out[k])
        _settle(machine, own, scratch, end, balances, out[k])
        if beyond < 0 and stroke_end(machine.P, machine.E, scratch.lines, out[k, 2 * n : 4 * n]) > 0:
            beyond = k
        errors[k] = _local_error(machine, own, allowed, enough, scratch, end, balances[GAIN], out[k])
        if not errors[k] <= allowed:
            status[k] = COARSE
    return beyond


@lean
def _settle(machine, step, scratch, end, balances, out):
    """Write the pressures that belong to the amounts of oil at the end of a step to out (nx,), at its pose with all
    joints closed.

    The lines and `balances` (N_BALANCES, chambers) are filled.
    """
    topology, P, E, inertia = machine
    n, lines, held = topology[0, CYLINDERS], scratch.lines, end.held
    theta = out[4 * n] if red.swings(topology, end.q) else 0.0
    red.close_position(topology, P, E, inertia, out, theta, scratch.arms, end.q)
    geo.fill_lines(topology, scratch.arms, end.q, end.v, lines)
    hyd.chamber_balances(topology, P, E, step.w1, lines, end.p, balances)
    for j in range(2 * n):
        balances[AMOUNT, j] = held[AMOUNT, j] + 0.5 * step.h * (held[GAIN, j] + balances[GAIN, j])
    hyd.settle(P, E, lines, balances[AMOUNT], end.p, out[2 * n : 4 * n])


@njit
def _local_error(machine, step, allowed, enough, scratch, end, gain, out):
    """Return the local error of one machine's step in units of `step_control.*_ERROR`; `scratch` and the motion q, v of
    `end` are overwritten. `gain` (chambers,): rates of the amounts of oil at the end.

    First by the change of the rates over the step, which bounds the defect of rates that change one way, but falls with
    the square of h only (so where a step was halved it must also tell that parts may grow again); then by the rates in
    the middle; then after what the system's stiffness makes of it.
    """
    topology, P, E, inertia = machine
    h, x, held, udd = step.h, step.x, end.held, end.udd
    nu, n, chambers = udd.size, topology[0, CYLINDERS], gain.size
    after, defect = np.empty(nu), np.empty(nu + chambers)
    for i in range(nu):
        rate = red.rate_place(n, i)
        after[i] = 2.0 / h * (out[rate] - x[rate]) - udd[i]
        defect[i] = h / 3.0 * (after[i] - udd[i])
    for j in range(chambers):
        defect[nu + j] = h / 3.0 * (gain[j] - held[GAIN, j])
    positions = 0.25 * h * np.abs(defect[:nu])
    bound = _size(P, held, defect, positions)
    if bound <= enough:
        return bound
    unknown = bound if bound <= allowed else math.inf
    middle, w, amount = np.empty(x.size), np.empty(step.w0.size), np.empty(chambers)
    for i in range(w.size):
        w[i] = 0.5 * (step.w0[i] + step.w1[i])
    for i in range(nu):
        place, rate = red.position_place(n, i), red.rate_place(n, i)
        middle[place] = 0.5 * (x[place] + out[place]) + 0.125 * h * (x[rate] - out[rate])
        middle[rate] = 0.5 * (x[rate] + out[rate]) + 0.125 * h * (udd[i] - after[i])
    theta = middle[4 * n] if nu > n else 0.0
    if not red.close_position(topology, P, E, inertia, middle, theta, scratch.arms, end.q):
        return unknown
    geo.fill_lines(topology, scratch.arms, end.q, end.v, scratch.lines)
    for j in range(chambers):
        amount[j] = (
            held[AMOUNT, j] + 0.5 * h * (0.5 * (held[GAIN, j] + gain[j])) + 0.125 * h * (held[GAIN, j] - gain[j])
        )
    hyd.settle(P, E, scratch.lines, amount, x[2 * n : 4 * n], middle[2 * n : 4 * n])
    between = np.empty((N_BALANCES, chambers))
    there = Motion(end.q, end.v, np.empty(end.a.size), np.empty(chambers), np.empty(chambers), between, np.empty(nu))
    if start(machine, step.t + 0.5 * h, middle, w, step.push, scratch, there) != ITERATING:
        return unknown
    for i in range(nu):
        defect[i] = h / 3.0 * (udd[i] + after[i] - 2.0 * there.udd[i])
    for j in range(chambers):
        defect[nu + j] = h / 3.0 * (held[GAIN, j] + gain[j] - 2.0 * between[GAIN, j])
    error = _size(P, held, defect, positions)
    if min(error, bound) <= allowed:
        return min(error, bound)
    return _stiff_error(machine, h, w, held, scratch, there, defect, positions)


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
def _stiff_error(machine, h, w, held, scratch, middle, defect, positions):
    """Return the error left of a defect by one iteration of Newton's method towards Simpson's rule, around the motion
    in the middle of the step; `held`: the chambers' balances at its start.
    """
    nu, chambers = positions.size, middle.p.size
    linear, b, M = _linear(nu, middle.q.size, chambers), np.empty(nu + chambers), np.zeros((nu, nu))
    _linearise(machine, h, w, middle, scratch, linear)
    red.reduced_mass(machine.inertia, scratch.N, linear.work, M)
    for i in range(nu):
        b[i] = 2.0 / h * red.dot(M[i], defect[:nu])
    for j in range(chambers):
        b[nu + j] = -2.0 / h * defect[nu + j] / linear.balances[SLOPE, j]
    if not red.solve(linear.A, b):
        return math.inf
    left = np.empty(nu + chambers)
    left[:nu] = b[:nu]
    for j in range(chambers):
        left[nu + j] = b[nu + j] * linear.balances[SLOPE, j]
    return _size(machine.P, held, left, positions)


@lean
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
