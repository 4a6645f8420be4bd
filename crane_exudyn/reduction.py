"""From redundant to independent coordinates and back: the null space of the joint equations, and the balance reduced by
it.

Redundant coordinates q of one machine are x, y of the centre of mass and the angle of each body (the payload that is
fixed to a body belongs to it); a payload on a pendulum adds x, y of its point mass. Independent velocities are u = dz,
or [dz dtheta] with theta the pendulum's angle against straight down.

The joints are a tree plus loops, so `geometry.chain` solves G x = g for the redundant x by recursion and one small
solve a loop, where G is the Jacobian of Exudyn's joint equations: with unit independent velocities it gives a column of
the null space N, with g = -residual the correction of violated joints, with the squares of the rates the centripetal
part of the accelerations.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from . import geometry as geo
from . import hydraulics as hyd
from .compiled import lean, njit
from .effects import hooks
from .geometry import COM_X, COM_Y, E_X, E_Y, FIRST_END, INERTIA, MASS, SECOND_END
from .machine import (
    BASE_BODY,
    BODIES,
    CARRIER,
    COORDINATE,
    CYLINDERS,
    KIND,
    LOOPS,
    NUMBERS,
    ROD_BODY,
    SLIDES,
    TIP_BODY,
    TIP_POINT,
)
from .parameters import GRAVITY, PAYLOAD


class Machine(NamedTuple):
    """The numbers of a machine: its topology, nominal parameters P, parameters E of effects, masses (bodies + 1, 4); of
    several machines a row each.
    """

    topology: np.ndarray
    P: np.ndarray
    E: np.ndarray
    inertia: np.ndarray


class Scratch(NamedTuple):
    """Tables that are filled anew for each machine: arms, the cylinders as lines, null space N (nu, nq)."""

    arms: np.ndarray
    lines: np.ndarray
    N: np.ndarray


class Motion(NamedTuple):
    """A machine at an instant: redundant coordinates and their rates q, v, a (nq,), pressures and their rates p, dp
    (chambers,), the balances of the chambers (N_BALANCES, chambers) and the independent accelerations udd (nu,) at the
    start of the step; of several machines a row each.
    """

    q: np.ndarray
    v: np.ndarray
    a: np.ndarray
    p: np.ndarray
    dp: np.ndarray
    held: np.ndarray
    udd: np.ndarray


@lean
def inertias(topology, P, E, t, out):
    """Fill out (bodies + 1, 4) with mass, centre of mass and inertia of the bodies and, last, of the swinging payload
    at time t.

    A fixed payload is part of its body: common mass, centre and inertia about it.
    """
    n = topology[0, BODIES]
    for b in range(n):
        for i in range(out.shape[1]):
            out[b, i] = P[topology[1 + b, NUMBERS] + i]
    out[n, :] = 0.0
    b, point = topology[0, TIP_BODY], topology[0, TIP_POINT]
    if b < 0:
        return
    mass = hooks.payload_mass(E, t, P[PAYLOAD])
    length, _ = hooks.pendulum(E)
    if length > 0.0:
        out[n, MASS] = mass
        return
    body_mass, total = out[b, MASS], out[b, MASS] + mass
    dx, dy = P[point] - out[b, COM_X], P[point + 1] - out[b, COM_Y]
    share = mass / total
    own = mass * (P[PAYLOAD + 1] ** 2 + P[PAYLOAD + 2] ** 2) / 12.0
    out[b, MASS] = total
    out[b, COM_X] += share * dx
    out[b, COM_Y] += share * dy
    out[b, INERTIA] += own + body_mass * share * (dx * dx + dy * dy)


@lean
def all_inertias(topology, P, E, t, out):
    """Fill out (m, bodies + 1, 4) with the `inertias` of m machines of parameters P (m, .), E (m, .)."""
    for k in range(out.shape[0]):
        inertias(topology, P[k], E[k], t, out[k])


@lean
def swings(topology, q):
    """Whether redundant coordinates q (or velocities) hold a payload on a pendulum, behind those of the bodies."""
    return q.size > 3 * topology[0, BODIES]


@njit
def new_arms(topology):
    """Return an empty table of arms: the last row holds the payload's arm, and the pendulum's rod."""
    return np.zeros((geo.arm_rows(topology), geo.N_ARM))


@lean
def _tip(topology):
    """Return the row of arms that holds the payload's arm and the pendulum's rod."""
    return topology[0, BODIES] + topology[0, LOOPS] + topology[0, CYLINDERS]


@lean
def close_position(topology, P, E, inertia, z, theta, arms, q):
    """Fill arms and q for independent coordinates; return whether all loops can be closed."""
    if geo.close_position(topology, P, inertia, z, arms, q) >= 0:
        return False
    if swings(topology, q):
        j, b, row = 3 * topology[0, BODIES], topology[0, TIP_BODY], _tip(topology)
        length, _ = hooks.pendulum(E)
        arms[row, SECOND_END], arms[row, SECOND_END + 1] = length * math.sin(theta), -length * math.cos(theta)
        q[j] = q[3 * b] + arms[row, FIRST_END] + arms[row, SECOND_END]
        q[j + 1] = q[3 * b + 1] + arms[row, FIRST_END + 1] + arms[row, SECOND_END + 1]
    return True


@lean
def arms_of(topology, P, inertia, q, arms):
    """Fill arms for redundant coordinates that may violate the joints a little."""
    geo.turn_frames(topology, q, arms)
    geo.fill_arms(topology, P, inertia, q, arms)
    if swings(topology, q):
        j, b, row = 3 * topology[0, BODIES], topology[0, TIP_BODY], _tip(topology)
        arms[row, SECOND_END] = q[j] - q[3 * b] - arms[row, FIRST_END]
        arms[row, SECOND_END + 1] = q[j + 1] - q[3 * b + 1] - arms[row, FIRST_END + 1]


@lean
def chain(topology, arms, unit, v, g, x):
    """Fill x with the solution of G x = g, as `geometry.chain`, and behind the bodies the pendulum's mass.

    The pendulum's (absolute) rate is the last independent one, its equation the last of g.
    """
    geo.chain(topology, arms, unit, v, g, x)
    if not swings(topology, x):
        return
    j, row = 3 * topology[0, BODIES], _tip(topology)
    px, py = geo.carried(x, v, topology[0, TIP_BODY], arms, row, FIRST_END)
    rx, ry = arms[row, SECOND_END], arms[row, SECOND_END + 1]
    stretch = g[g.size - 1] / math.hypot(rx, ry) if g.size else 0.0
    rate = 1.0 if unit == topology[0, CYLINDERS] else 0.0
    squared = pendulum_rate(topology, arms, v) ** 2 if v.size else 0.0
    x[j], x[j + 1] = px - rate * ry - squared * rx + stretch * rx, py + rate * rx - squared * ry + stretch * ry


@lean
def joint_equations(topology, swinging):
    """Return how many joint equations a machine has, with or without a payload on a pendulum."""
    return geo.joint_rows(topology) + (1 if swinging else 0)


@lean
def null_space(topology, arms, N):
    """Fill N (nu, nq), one row per independent velocity: dq = N^T u, G N^T = 0."""
    none = N[0, :0]
    for i in range(N.shape[0]):
        chain(topology, arms, i, none, none, N[i])


@lean
def place(topology, P, E, inertia, x, arms, N, q, v):
    """Fill arms, null space N, q and v (nq,) of a state x (nx,), all joints closed; return whether the loops can be
    closed.
    """
    n, nu = topology[0, CYLINDERS], N.shape[0]
    theta = x[4 * n] if nu > n else 0.0
    if not close_position(topology, P, E, inertia, x, theta, arms, q):
        return False
    null_space(topology, arms, N)
    v[:] = 0.0
    for i in range(nu):
        rate = x[rate_place(n, i)]
        for j in range(v.size):
            v[j] += N[i, j] * rate
    return True


@lean
def rate_place(n, i):
    """Return where the rate of independent coordinate i of n stands in a state; the pendulum's for i = n."""
    return n + i if i < n else 4 * n + 1


@lean
def position_place(n, i):
    """Return where independent coordinate i of n stands in a state; the pendulum's for i = n."""
    return i if i < n else 4 * n


@lean
def centripetal(topology, arms, v, out):
    """Fill out (nq,) with the part of the accelerations that comes from the velocities alone."""
    chain(topology, arms, -1, v, v[:0], out)


@lean
def pendulum_rate(topology, arms, v):
    """Return dtheta: the rate at which the pendulum's rod turns, absolute, in rad/s."""
    j, row = 3 * topology[0, BODIES], _tip(topology)
    px, py = geo.point_velocity(v, topology[0, TIP_BODY], arms, row, FIRST_END)
    rx, ry = arms[row, SECOND_END], arms[row, SECOND_END + 1]
    return (rx * (v[j + 1] - py) - ry * (v[j] - px)) / (rx * rx + ry * ry)


@lean
def read_motion(topology, arms, x, q, v, out):
    """Write the independent coordinates and rates of redundant ones to out (nx,); a pendulum's angle stays near that in
    x.
    """
    n = topology[0, CYLINDERS]
    for b in range(topology[0, BODIES]):
        i, k = topology[1 + b, COORDINATE], topology[1 + b, CARRIER]
        if i < 0:
            continue
        if topology[1 + b, KIND] == SLIDES:
            out[i], out[n + i] = arms[b, geo.WAY], geo.sliding_rate(topology, arms, v, b)
        else:
            out[i], out[n + i] = q[3 * b + 2], v[3 * b + 2]
            if k >= 0:
                out[i], out[n + i] = out[i] - q[3 * k + 2], out[n + i] - v[3 * k + 2]
    if swings(topology, q):
        row = _tip(topology)
        theta = math.atan2(arms[row, SECOND_END], -arms[row, SECOND_END + 1])
        out[4 * n] = theta + 2.0 * math.pi * round((x[4 * n] - theta) / (2.0 * math.pi))
        out[4 * n + 1] = pendulum_rate(topology, arms, v)


@lean
def add_point_force(arms, row, column, body, fx, fy, f):
    """Add a force at the end of an arm of a body (-1: the ground, which takes any) to f."""
    if body < 0:
        return
    f[3 * body] += fx
    f[3 * body + 1] += fy
    f[3 * body + 2] += arms[row, column] * fy - arms[row, column + 1] * fx


@lean
def add_cylinder_forces(topology, arms, lines, F, f):
    """Add the forces F (cylinders,), pushing their pins apart, to f."""
    first = topology[0, BODIES] + topology[0, LOOPS]
    for c in range(F.size):
        fx, fy, row = F[c] * lines[c, E_X], F[c] * lines[c, E_Y], first + c
        add_point_force(arms, row, SECOND_END, topology[1 + row, ROD_BODY], fx, fy, f)
        add_point_force(arms, row, FIRST_END, topology[1 + row, BASE_BODY], -fx, -fy, f)


@lean
def add_gravity(topology, P, E, inertia, f):
    """Add the weights to f."""
    gx, gy = hooks.gravity(E, 0.0, -P[GRAVITY])
    n = topology[0, BODIES]
    for b in range(n):
        f[3 * b] += inertia[b, MASS] * gx
        f[3 * b + 1] += inertia[b, MASS] * gy
    if swings(topology, f):
        f[3 * n] += inertia[n, MASS] * gx
        f[3 * n + 1] += inertia[n, MASS] * gy


@lean
def add_on_coordinate(topology, arms, b, amount, f):
    """Add a moment (a force, where it slides) that turns body b against its carrier to f."""
    k = topology[1 + b, CARRIER]
    if topology[1 + b, KIND] != SLIDES:
        f[3 * b + 2] += amount
        if k >= 0:
            f[3 * k + 2] -= amount
        return
    ux, uy = arms[b, geo.ALONG], arms[b, geo.ALONG + 1]
    add_point_force(arms, b, geo.OWN, b, amount * ux, amount * uy, f)
    add_point_force(arms, b, geo.CARRIED, k, -amount * ux, -amount * uy, f)  # in the same line


@lean
def coordinate_rate(topology, arms, v, b):
    """Return the rate of the coordinate of body b."""
    if topology[1 + b, KIND] == SLIDES:
        return geo.sliding_rate(topology, arms, v, b)
    k = topology[1 + b, CARRIER]
    return v[3 * b + 2] - (v[3 * k + 2] if k >= 0 else 0.0)


@lean
def coordinate(topology, arms, b):
    """Return the coordinate of body b."""
    if topology[1 + b, KIND] == SLIDES:
        return arms[b, geo.WAY]
    k = topology[1 + b, CARRIER]
    return arms[b, geo.ANGLE] - (arms[k, geo.ANGLE] if k >= 0 else 0.0)


@lean
def add_joint_forces(topology, E, t, w, arms, v, f):
    """Add moments on the coordinates, the forces on the payload's point, the pendulum's damping and disturbances to
    f.
    """
    n = topology[0, CYLINDERS]
    for b in range(topology[0, BODIES]):
        i = topology[1 + b, COORDINATE]
        if i >= 0:
            rate, at = coordinate_rate(topology, arms, v, b), coordinate(topology, arms, b)
            add_on_coordinate(topology, arms, b, hooks.joint_torque(E, i, rate, at) + w[n + 2 + i], f)
    if topology[0, TIP_BODY] < 0:
        return
    row, first = _tip(topology), 2 * n + 2
    add_point_force(arms, row, FIRST_END, topology[0, TIP_BODY], w[first], hooks.tip_force(E, t) + w[first + 1], f)
    if swings(topology, f):
        j = 3 * topology[0, BODIES]
        length, damping = hooks.pendulum(E)
        # a torque -d*dtheta on a massless rod is a force at its end, across it; the body feels only the rod's pull
        across = -damping * pendulum_rate(topology, arms, v) / (length * length)
        f[j] -= across * arms[row, SECOND_END + 1]
        f[j + 1] += across * arms[row, SECOND_END]


@njit
def extra_forces(machine, t, w, q, v, p, arms, lines, f):
    """Fill f (nq,) with all applied forces except weights and the cylinders' pressure forces; arms and lines are
    overwritten.

    Friction (19) and the effects' forces of the cylinders, joint moments, forces on the payload's point, pendulum
    damping, disturbances.
    """
    topology, P, E, inertia = machine
    arms_of(topology, P, inertia, q, arms)
    geo.fill_lines(topology, arms, q, v, lines)
    f[:] = 0.0
    F = np.empty(lines.shape[0])
    hyd.extra_forces(topology, P, E, w, lines, p, F)
    add_cylinder_forces(topology, arms, lines, F, f)
    add_joint_forces(topology, E, t, w, arms, v, f)


@lean
def dot(a, b):
    """Return the scalar product, summed in order: the result must not depend on where the arrays lie in memory."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@lean
def mass_times(inertia, a, out):
    """Fill out with M a for the diagonal mass matrix of centre-of-mass coordinates."""
    n = inertia.shape[0] - 1
    for b in range(n):
        out[3 * b] = inertia[b, MASS] * a[3 * b]
        out[3 * b + 1] = inertia[b, MASS] * a[3 * b + 1]
        out[3 * b + 2] = inertia[b, INERTIA] * a[3 * b + 2]
    for j in range(3 * n, a.size):
        out[j] = inertia[n, MASS] * a[j]


@lean
def reduced_mass(inertia, N, work, M):
    """Fill M (nu, nu) with N M N^T."""
    n = N.shape[0]
    for i in range(n):
        mass_times(inertia, N[i], work)
        for k in range(n):
            M[i, k] = dot(N[k], work)


@lean
def solve(A, b):
    """Solve A x = b in place by Gaussian elimination with row pivoting; x replaces b. Return False if A is singular."""
    n = b.size
    for k in range(n):
        pivot = k
        for i in range(k + 1, n):
            if abs(A[i, k]) > abs(A[pivot, k]):
                pivot = i
        if A[pivot, k] == 0.0 or math.isnan(A[pivot, k]):
            return False
        if pivot != k:
            for j in range(k, n):
                A[k, j], A[pivot, j] = A[pivot, j], A[k, j]
            b[k], b[pivot] = b[pivot], b[k]
        for i in range(k + 1, n):
            factor = A[i, k] / A[k, k]
            if factor != 0.0:
                for j in range(k + 1, n):
                    A[i, j] -= factor * A[k, j]
                b[i] -= factor * b[k]
    for k in range(n - 1, -1, -1):
        for j in range(k + 1, n):
            b[k] -= A[k, j] * b[j]
        b[k] /= A[k, k]
    return True


@njit
def applied_forces(machine, t, w, arms, lines, q, v, p, f):
    """Fill f (nq,) with all applied forces that the machine itself has; `lines` is filled. `arms` must belong to q."""
    topology, P, E, inertia = machine
    f[:] = 0.0
    geo.fill_lines(topology, arms, q, v, lines)
    F = np.empty(lines.shape[0])
    hyd.cylinder_forces(topology, P, E, w, lines, p, F)
    add_cylinder_forces(topology, arms, lines, F, f)
    add_joint_forces(topology, E, t, w, arms, v, f)
    add_gravity(topology, P, E, inertia, f)


@njit
def accelerations(machine, t, w, push, scratch, now):
    """Fill udd and a of `now` with the accelerations that are consistent with the joints: M udd = N (f - M a_c).

    f are all applied forces, among them push (nq,), those of somebody's own objects, a_c the centripetal accelerations.
    The lines of `scratch` are filled; its arms and its null space must belong to q.
    """
    topology, inertia, N, nu = machine.topology, machine.inertia, scratch.N, scratch.N.shape[0]
    f, work, M = np.empty(push.size), np.empty(push.size), np.empty((nu, nu))
    applied_forces(machine, t, w, scratch.arms, scratch.lines, now.q, now.v, now.p, f)
    for j in range(f.size):
        f[j] += push[j]
    centripetal(topology, scratch.arms, now.v, now.a)
    reduced_mass(inertia, N, work, M)
    mass_times(inertia, now.a, work)
    for i in range(nu):
        now.udd[i] = dot(N[i], f) - dot(N[i], work)
    regular = solve(M, now.udd)
    for j in range(now.a.size):
        for i in range(nu):
            now.a[j] += N[i, j] * now.udd[i]
    return regular
