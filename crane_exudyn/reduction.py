"""From redundant to independent coordinates and back: the null space of the joint equations, and the balance reduced by it.

Redundant coordinates q of one crane are x, y of the centre of mass and the angle of lift boom, bracket 1, bracket 2 and outer
boom (with the payload that is fixed to it): 12 numbers; a payload on a pendulum adds x, y of its point mass. Independent
velocities are u = [dz1 dz4] or [dz1 dz4 dtheta], theta the pendulum's angle against straight down.

The joints are a tree O-A plus the loop B-C-D, so `chain` solves G x = g for the redundant x by recursion, where G is the
Jacobian of Exudyn's joint equations: with unit independent velocities it gives a column of the null space N, with g = -residual
the correction of violated joints, with the squares of the rates the centripetal part of the accelerations.
"""

from __future__ import annotations

import math

import numpy as np

from . import geometry as geo
from . import hydraulics as hyd
from .compiled import njit
from .effects import hooks
from .parameters import BODY, GRAVITY, N_BODY, PAYLOAD

# rows of the array of arms: vectors from a body's centre of mass to its points, in the fixed frame
O1, A1, B1, G1, H1, B2, C2, C3, D3, A4, D4, E4, ROD, N_ARMS = range(14)
#: joint equations in the order in which mechanism.py adds them, two rows each; ROD is the pendulum's distance equation
JOINT_O, JOINT_B, JOINT_C, JOINT_A, JOINT_D = 0, 2, 4, 6, 8
N_JOINT_ROWS = 10
#: columns of the inertia table of `inertias`
MASS, COM_X, COM_Y, INERTIA = range(4)


@njit
def inertias(P, E, t, out):
    """Fill out (5, 4) with mass, centre of mass and inertia of the four bodies and the swinging payload at time t.

    A fixed payload is part of the outer boom: common mass, centre and inertia about it. A swinging one is row 4.
    """
    for b in range(4):
        for i in range(4):
            out[b, i] = P[BODY + N_BODY * b + i]
    mass = hooks.payload_mass(E, t, P[PAYLOAD])
    length, _ = hooks.pendulum(E)
    out[4, :] = 0.0
    if length > 0.0:
        out[4, MASS] = mass
        return
    boom_mass, total = out[3, MASS], out[3, MASS] + mass
    dx, dy = P[geo.E] - out[3, COM_X], P[geo.E + 1] - out[3, COM_Y]
    share = mass / total
    own = mass * (P[PAYLOAD + 1] ** 2 + P[PAYLOAD + 2] ** 2) / 12.0
    out[3, MASS] = total
    out[3, COM_X] += share * dx
    out[3, COM_Y] += share * dy
    out[3, INERTIA] += own + boom_mass * share * (dx * dx + dy * dy)


@njit
def all_inertias(P, E, t, out):
    """Fill out (n, 5, 4) with the `inertias` of n cranes of parameters P (n, .), E (n, .)."""
    for k in range(out.shape[0]):
        inertias(P[k], E[k], t, out[k])


@njit
def _arm(P, point, c, s, dx, dy, arms, k):
    x, y = P[point] - dx, P[point + 1] - dy
    arms[k, 0] = c * x - s * y
    arms[k, 1] = s * x + c * y


@njit
def fill_arms(P, inertia, a1, a2, a3, a4, arms):
    """Fill arms (N_ARMS, 2) for the four body angles."""
    c, s, dx, dy = math.cos(a1), math.sin(a1), inertia[0, COM_X], inertia[0, COM_Y]
    arms[O1, 0], arms[O1, 1] = -c * dx + s * dy, -s * dx - c * dy
    _arm(P, geo.A, c, s, dx, dy, arms, A1)
    _arm(P, geo.B, c, s, dx, dy, arms, B1)
    _arm(P, geo.G, c, s, dx, dy, arms, G1)
    _arm(P, geo.H, c, s, dx, dy, arms, H1)
    c, s, dx, dy = math.cos(a2), math.sin(a2), inertia[1, COM_X], inertia[1, COM_Y]
    arms[B2, 0], arms[B2, 1] = -c * dx + s * dy, -s * dx - c * dy
    _arm(P, geo.C, c, s, dx, dy, arms, C2)
    c, s, dx, dy = math.cos(a3), math.sin(a3), inertia[2, COM_X], inertia[2, COM_Y]
    arms[C3, 0], arms[C3, 1] = -c * dx + s * dy, -s * dx - c * dy
    _arm(P, geo.D_BRACKET, c, s, dx, dy, arms, D3)
    c, s, dx, dy = math.cos(a4), math.sin(a4), inertia[3, COM_X], inertia[3, COM_Y]
    arms[A4, 0], arms[A4, 1] = -c * dx + s * dy, -s * dx - c * dy
    _arm(P, geo.D, c, s, dx, dy, arms, D4)
    _arm(P, geo.E, c, s, dx, dy, arms, E4)


@njit
def close_position(P, E, inertia, z1, z4, theta, arms, q):
    """Fill arms and q (12 or 14,) for independent coordinates; return whether the loop can be closed."""
    (a1, a2, a3, a4), reachable = geo.frame_angles(P, z1, z4)
    if not reachable:
        return False
    fill_arms(P, inertia, a1, a2, a3, a4, arms)
    q[0], q[1], q[2] = P[geo.O] - arms[O1, 0], P[geo.O + 1] - arms[O1, 1], a1
    q[3], q[4], q[5] = q[0] + arms[B1, 0] - arms[B2, 0], q[1] + arms[B1, 1] - arms[B2, 1], a2
    q[6], q[7], q[8] = q[3] + arms[C2, 0] - arms[C3, 0], q[4] + arms[C2, 1] - arms[C3, 1], a3
    q[9], q[10], q[11] = q[0] + arms[A1, 0] - arms[A4, 0], q[1] + arms[A1, 1] - arms[A4, 1], a4
    if q.size > 12:
        length, _ = hooks.pendulum(E)
        arms[ROD, 0], arms[ROD, 1] = length * math.sin(theta), -length * math.cos(theta)
        q[12], q[13] = q[9] + arms[E4, 0] + arms[ROD, 0], q[10] + arms[E4, 1] + arms[ROD, 1]
    return True


@njit
def arms_of(P, inertia, q, arms):
    """Fill arms for redundant coordinates that may violate the joints a little."""
    fill_arms(P, inertia, q[2], q[5], q[8], q[11], arms)
    if q.size > 12:
        arms[ROD, 0], arms[ROD, 1] = q[12] - q[9] - arms[E4, 0], q[13] - q[10] - arms[E4, 1]


@njit
def chain(arms, a1, a4, at, w1, w2, w3, w4, wt, g, x):
    """Fill x (12 or 14,) with the solution of G x = g for given independent parts.

    Args:
        arms: (N_ARMS, 2) of `fill_arms`.
        a1, a4, at: angular rates (or accelerations) of lift boom, outer boom (both absolute) and pendulum.
        w1, w2, w3, w4, wt: squares of the angular rates for the centripetal part of accelerations; 0 for velocities.
        g: (11,) right-hand side of the joint equations.
    """
    x[2], x[11] = a1, a4
    x[0] = g[0] + a1 * arms[O1, 1] + w1 * arms[O1, 0]
    x[1] = g[1] - a1 * arms[O1, 0] + w1 * arms[O1, 1]
    x[9] = x[0] - a1 * arms[A1, 1] - w1 * arms[A1, 0] + g[6] + a4 * arms[A4, 1] + w4 * arms[A4, 0]
    x[10] = x[1] + a1 * arms[A1, 0] - w1 * arms[A1, 1] + g[7] - a4 * arms[A4, 0] + w4 * arms[A4, 1]
    # point B of bracket 1, arms B-C and C-D of the brackets
    bx = x[0] - a1 * arms[B1, 1] - w1 * arms[B1, 0] + g[2]
    by = x[1] + a1 * arms[B1, 0] - w1 * arms[B1, 1] + g[3]
    c2x, c2y = arms[C2, 0] - arms[B2, 0], arms[C2, 1] - arms[B2, 1]
    c3x, c3y = arms[D3, 0] - arms[C3, 0], arms[D3, 1] - arms[C3, 1]
    # what the brackets' turning has to give: D of the outer boom as seen from B
    rx = x[9] - a4 * arms[D4, 1] - w4 * arms[D4, 0] - g[8] - bx - g[4] + w2 * c2x + w3 * c3x
    ry = x[10] + a4 * arms[D4, 0] - w4 * arms[D4, 1] - g[9] - by - g[5] + w2 * c2y + w3 * c3y
    det = c2x * c3y - c2y * c3x
    a2 = (rx * c3x + ry * c3y) / det
    a3 = -(rx * c2x + ry * c2y) / det
    x[5], x[8] = a2, a3
    x[3] = bx + a2 * arms[B2, 1] + w2 * arms[B2, 0]
    x[4] = by - a2 * arms[B2, 0] + w2 * arms[B2, 1]
    cx = bx - a2 * c2y - w2 * c2x + g[4]
    cy = by + a2 * c2x - w2 * c2y + g[5]
    x[6] = cx + a3 * arms[C3, 1] + w3 * arms[C3, 0]
    x[7] = cy - a3 * arms[C3, 0] + w3 * arms[C3, 1]
    if x.size > 12:
        length = math.hypot(arms[ROD, 0], arms[ROD, 1])
        x[12] = x[9] - a4 * arms[E4, 1] - w4 * arms[E4, 0] - at * arms[ROD, 1] - wt * arms[ROD, 0]
        x[13] = x[10] + a4 * arms[E4, 0] - w4 * arms[E4, 1] + at * arms[ROD, 0] - wt * arms[ROD, 1]
        x[12] += g[10] * arms[ROD, 0] / length
        x[13] += g[10] * arms[ROD, 1] / length


@njit
def null_space(arms, N):
    """Fill N (2 or 3, 12 or 14), one row per independent velocity: dq = N^T u, G N^T = 0."""
    g = np.zeros(N_JOINT_ROWS + 1)
    chain(arms, 1.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, g, N[0])
    chain(arms, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, g, N[1])
    if N.shape[0] > 2:
        chain(arms, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, g, N[2])


@njit
def velocities(N, u, v):
    """Fill v (12 or 14,) with N^T u."""
    for j in range(v.size):
        v[j] = 0.0
        for i in range(N.shape[0]):
            v[j] += N[i, j] * u[i]


@njit
def place(P, E, inertia, x, arms, N, q, v):
    """Fill arms, null space N, q and v (12 or 14,) of a state x (8 or 10,), all joints closed; return whether the loop can be closed."""
    theta, dtheta = (x[8], x[9]) if q.size > 12 else (0.0, 0.0)
    if not close_position(P, E, inertia, x[0], x[1], theta, arms, q):
        return False
    null_space(arms, N)
    velocities(N, np.array([x[2], x[3], dtheta]), v)
    return True


@njit
def centripetal(arms, v, out):
    """Fill out (12 or 14,) with the part of the accelerations that comes from the velocities alone."""
    g = np.zeros(N_JOINT_ROWS + 1)
    wt = 0.0
    if v.size > 12:
        wt = pendulum_rate(arms, v) ** 2
    chain(arms, 0.0, 0.0, 0.0, v[2] ** 2, v[5] ** 2, v[8] ** 2, v[11] ** 2, wt, g, out)


@njit
def pendulum_rate(arms, v):
    """Return dtheta: the rate at which the pendulum's rod turns, absolute, in rad/s."""
    vx = v[12] - v[9] + v[11] * arms[E4, 1]
    vy = v[13] - v[10] - v[11] * arms[E4, 0]
    rx, ry = arms[ROD, 0], arms[ROD, 1]
    return (rx * vy - ry * vx) / (rx * rx + ry * ry)


@njit
def cylinder_kinematics(P, arms, q, v):
    """Return (s1, s2, ds1, ds2, e1x, e1y, e2x, e2y): lengths, rates and unit vectors of the cylinders, base to rod end."""
    x1, y1 = q[0] + arms[G1, 0] - P[geo.F], q[1] + arms[G1, 1] - P[geo.F + 1]
    x2, y2 = q[3] + arms[C2, 0] - q[0] - arms[H1, 0], q[4] + arms[C2, 1] - q[1] - arms[H1, 1]
    s1, s2 = math.hypot(x1, y1), math.hypot(x2, y2)
    x1, y1, x2, y2 = x1 / s1, y1 / s1, x2 / s2, y2 / s2
    ds1, ds2 = cylinder_rates(arms, v, x1, y1, x2, y2)
    return s1, s2, ds1, ds2, x1, y1, x2, y2


@njit
def cylinder_rates(arms, v, e1x, e1y, e2x, e2y):
    """Return (ds1, ds2) of body velocities v for cylinders along the unit vectors e1, e2."""
    gx, gy = v[0] - v[2] * arms[G1, 1], v[1] + v[2] * arms[G1, 0]
    cx, cy = v[3] - v[5] * arms[C2, 1], v[4] + v[5] * arms[C2, 0]
    hx, hy = v[0] - v[2] * arms[H1, 1], v[1] + v[2] * arms[H1, 0]
    return e1x * gx + e1y * gy, e2x * (cx - hx) + e2y * (cy - hy)


@njit
def add_point_force(arms, k, body, fx, fy, f):
    """Add a force at the end of arm k of a body to f."""
    f[3 * body] += fx
    f[3 * body + 1] += fy
    f[3 * body + 2] += arms[k, 0] * fy - arms[k, 1] * fx


@njit
def add_cylinder_forces(arms, F1, F2, e1x, e1y, e2x, e2y, f):
    """Add the forces of both cylinders, pushing their pins apart, to f."""
    add_point_force(arms, G1, 0, F1 * e1x, F1 * e1y, f)
    add_point_force(arms, C2, 1, F2 * e2x, F2 * e2y, f)
    add_point_force(arms, H1, 0, -F2 * e2x, -F2 * e2y, f)


@njit
def add_gravity(P, E, inertia, f):
    """Add the weights to f."""
    gx, gy = hooks.gravity(E, 0.0, -P[GRAVITY])
    for b in range(4):
        f[3 * b] += inertia[b, MASS] * gx
        f[3 * b + 1] += inertia[b, MASS] * gy
    if f.size > 12:
        f[12] += inertia[4, MASS] * gx
        f[13] += inertia[4, MASS] * gy


@njit
def add_joint_forces(E, t, w, arms, v, f):
    """Add joint torques on the relative coordinates, the forces on E, the pendulum's damping and disturbances to f."""
    at_o = hooks.joint_torque(E, 0, v[2]) + w[hyd.TORQUE]
    at_a = hooks.joint_torque(E, 1, v[11] - v[2]) + w[hyd.TORQUE + 1]
    f[2] += at_o - at_a
    f[11] += at_a
    add_point_force(arms, E4, 3, w[hyd.FORCE], hooks.tip_force(E, t) + w[hyd.FORCE + 1], f)
    if f.size > 12:
        length, damping = hooks.pendulum(E)
        # a torque -d*dtheta on a massless rod is a force at its end, across it; the boom feels only the rod's pull
        across = -damping * pendulum_rate(arms, v) / (length * length)
        f[12] -= across * arms[ROD, 1]
        f[13] += across * arms[ROD, 0]


@njit
def extra_forces(P, E, t, w, inertia, q, v, p, arms, f):
    """Fill f (12 or 14,) with all applied forces except weights and the cylinders' pressure forces; arms is overwritten.

    Friction (19) and the effects' forces of the cylinders, joint torques, forces on E, pendulum damping, disturbances.
    """
    arms_of(P, inertia, q, arms)
    f[:] = 0.0
    s1, s2, ds1, ds2, e1x, e1y, e2x, e2y = cylinder_kinematics(P, arms, q, v)
    F1, F2 = hyd.extra_forces(P, E, w, s1, s2, ds1, ds2, p)
    add_cylinder_forces(arms, F1, F2, e1x, e1y, e2x, e2y, f)
    add_joint_forces(E, t, w, arms, v, f)


@njit
def dot(a, b):
    """Return the scalar product, summed in order: the result must not depend on where the arrays lie in memory."""
    total = 0.0
    for j in range(a.size):
        total += a[j] * b[j]
    return total


@njit
def mass_times(inertia, a, out):
    """Fill out with M a for the diagonal mass matrix of centre-of-mass coordinates."""
    for b in range(4):
        out[3 * b] = inertia[b, MASS] * a[3 * b]
        out[3 * b + 1] = inertia[b, MASS] * a[3 * b + 1]
        out[3 * b + 2] = inertia[b, INERTIA] * a[3 * b + 2]
    for j in range(12, a.size):
        out[j] = inertia[4, MASS] * a[j]


@njit
def reduced_mass(inertia, N, work, M):
    """Fill M (2 or 3 square) with N M N^T."""
    n = N.shape[0]
    for i in range(n):
        mass_times(inertia, N[i], work)
        for k in range(n):
            M[i, k] = dot(N[k], work)


@njit
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
def accelerations(P, E, t, w, inertia, N, arms, q, v, p, work, f, M, udd, a):
    """Fill udd and a with the accelerations that are consistent with the joints: M udd = N (f - M a_centripetal).

    f gets all applied forces, a the accelerations of the redundant coordinates. `arms` must belong to q.
    """
    f[:] = 0.0
    s1, s2, ds1, ds2, e1x, e1y, e2x, e2y = cylinder_kinematics(P, arms, q, v)
    F1, F2 = hyd.cylinder_forces(P, E, w, s1, s2, ds1, ds2, p)
    add_cylinder_forces(arms, F1, F2, e1x, e1y, e2x, e2y, f)
    add_joint_forces(E, t, w, arms, v, f)
    add_gravity(P, E, inertia, f)
    centripetal(arms, v, a)
    reduced_mass(inertia, N, work, M)
    mass_times(inertia, a, work)
    for i in range(N.shape[0]):
        udd[i] = dot(N[i], f) - dot(N[i], work)
    regular = solve(M, udd)
    for j in range(a.size):
        for i in range(N.shape[0]):
            a[j] += N[i, j] * udd[i]
    return regular
