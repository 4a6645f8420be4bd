"""The crane's equations by the double-step semi-recursive method and lumped fluids, compiled.

Written from the paper, (1)-(20) and (34)-(41), for planar bodies. A point or a force in the plane is one complex number x + iy,
so that turning a vector by an angle is a product with exp(i angle). Products needed below, for vectors a and b:

    dot(a, b) = a.b        cross(a, b) = a x b (its component along the axis of rotation)

Coordinates z = [z1 z2 z3 z4] of the open-loop tree, the loop A-B-C-D being cut at D:

    pillar --O, z1-- lift boom (1) --B, z2-- bracket 1 (2) --C, z3-- bracket 2 (3)
                              \\--A, z4-- outer boom with payload (4)

Path matrix T (row j: the joints between the ground and body j), which `down` and `up` below apply without storing it:

        | 1 0 0 0 |
    T = | 1 1 0 0 |     times 3 x 3 identity matrices
        | 1 1 1 0 |
        | 1 0 0 1 |

The reference point of every body is the point that at this instant coincides with the origin, so its velocity is
Z_j = (s', Omega): two translations (one complex number) and a rotation. Signs: angles counter-clockwise positive, cylinder
forces and rates positive in extension, flows Q1, Q3 into and Q2, Q4 out of their chamber.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from crane_exudyn import compiled
from crane_exudyn import parameters as par
from crane_exudyn.effects import hooks


def njit(function=None, **options):
    """Compile a part of `rhs`: it is cached within what calls it, not on its own."""
    return compiled.njit(function, cache=False, **options) if function else lambda f: njit(f, **options)


# Places in P. They stand here as plain integers because compiled code reads globals as constants.
BODY, N_BODY = par.BODY, par.N_BODY
PAYLOAD, POINT, CYLINDER, N_CYLINDER = par.PAYLOAD, par.POINT, par.CYLINDER, par.N_CYLINDER
VALVE, N_VALVE, FLUID, SUPPLY, GRAVITY = par.VALVE, par.N_VALVE, par.FLUID, par.SUPPLY, par.GRAVITY
P_O, P_F, P_G, P_H, P_B, P_A, P_C, P_D_BRACKET, P_D, P_E = range(POINT, POINT + 2 * len(par.POINT_NAMES), 2)
BORE, ROD, EMPTY, RANGE, HOSE_A, HOSE_B, COULOMB, STATIC, STRIBECK, VISCOUS = range(N_CYLINDER)
OIL, STEEL, HOSE, VAPOUR, LAMINAR = range(FLUID, FLUID + 5)
AIR, REFERENCE = SUPPLY + 2, SUPPLY + 3
TANH4 = math.tanh(4.0)


class Pose(NamedTuple):
    """Positions of the joints and the orientations e_j = exp(i angle) of the four bodies."""

    O: complex
    F: complex
    G: complex
    H: complex
    B: complex
    A: complex
    C: complex
    D_bracket: complex
    D: complex
    E: complex
    e1: complex
    e2: complex
    e3: complex
    e4: complex


class Motion(NamedTuple):
    """Joint rates, loop Jacobian and velocity products of the tree."""

    R2: float  # R_z: dz2/dz4
    R3: float  # dz3/dz4
    dz2: float
    dz3: float
    v1: complex  # Z_j = (v_j, w_j)
    w1: float
    v2: complex
    w2: float
    v3: complex
    w3: float
    v4: complex
    w4: float
    d1: complex  # (T R_d)' z', its translations (its rotations vanish in the plane)
    d2: complex
    d3: complex
    d4: complex
    a2: float  # R_z' z_i': accelerations of z2 and z3 while z1 and z4 have none
    a3: float


class Inertia(NamedTuple):
    """M of a planar body about the origin (7): mass, first moment m g, second moment J + m |g|^2."""

    m: float
    mg: complex
    J: float


class Line(NamedTuple):
    """A cylinder as a line between two pins: length, rate, direction."""

    s: float
    v: float
    u: complex


class Fluid(NamedTuple):
    """Numbers of the crane that all chambers share."""

    soft: float  # 1/B = 1/Bo + 1/Bc
    wall: float  # 1/Bh - 1/Bc
    least: float  # vapour pressure, and
    zero: float  # what is to be added for an absolute pressure, as the crane's gauges read them


class Oil(NamedTuple):
    """The oil of a chamber at one state."""

    y: float  # the state's pressure
    pressure: float  # in the chamber: y, or vapour pressure where y is below it
    amount: float  # volume of the oil at the pressure 0, m^3
    by_pressure: float  # derivative of the amount by y at constant volume
    by_volume: float  # and by the volume Al at constant pressure
    density: float  # density over that at the pressure 0


class Chambers(NamedTuple):
    """Both chambers of a cylinder: length of the one on the piston side, and their oil."""

    la: float
    a: Oil
    b: Oil


class Cylinder(NamedTuple):
    """Everything hydraulic about one cylinder. a: piston side, b: rod side."""

    la: float
    lb: float
    Qa: float
    Qb: float
    leak_a: float
    leak_b: float
    Fmu: float
    F: float
    a: Oil
    b: Oil
    Ga: float  # rates of the amounts of oil
    Gb: float
    v: float


@njit(inline="always")
def dot(a, b):
    return a.real * b.real + a.imag * b.imag


@njit(inline="always")
def cross(a, b):
    return a.real * b.imag - a.imag * b.real


@njit(inline="always")
def square(a):
    return a.real * a.real + a.imag * a.imag


@njit(inline="always")
def point(P, k):
    return complex(P[k], P[k + 1])


@njit(inline="always")
def turn(angle):
    return complex(math.cos(angle), math.sin(angle))


# ---------------------------------------------------------------------------------------------- positions


@njit
def third_corner(B, D, BC, CD):
    """Return C left of the line from B to D, at the distances BC and CD from them; NaN if the loop cannot be closed."""
    along = D - B
    d2 = square(along)
    share = 0.5 * (square(BC) - square(CD) + d2) / d2
    height2 = square(BC) / d2 - share * share
    return B + along * complex(share, math.sqrt(height2) if height2 >= 0.0 else math.nan)


@njit
def positions(z1, z4, P):
    """Return the Pose at the independent coordinates z1, z4 (rad), the loop A-B-C-D being closed."""
    e1 = turn(z1)
    e4 = e1 * turn(z4)
    O = point(P, P_O)
    A = O + e1 * point(P, P_A)
    B = O + e1 * point(P, P_B)
    D = A + e4 * point(P, P_D)
    BC, CD = point(P, P_C), point(P, P_D_BRACKET)
    C = third_corner(B, D, BC, CD)
    e2 = (C - B) * BC.conjugate() / square(BC)
    e3 = (D - C) * CD.conjugate() / square(CD)
    G, H, E = O + e1 * point(P, P_G), O + e1 * point(P, P_H), A + e4 * point(P, P_E)
    return Pose(O, point(P, P_F), G, H, B, A, C, C + e3 * CD, D, E, e1, e2, e3, e4)


# --------------------------------------------------------------------------------------------- velocities


@njit(inline="always")
def b_of(r):
    """Translation of b_j (2) of a revolute joint at r; its rotation is 1."""
    return complex(r.imag, -r.real)


@njit(inline="always")
def point_velocity(v, w, r):
    """Velocity of the point at r on a body with Z = (v, w)."""
    return v + complex(-w * r.imag, w * r.real)


@njit(inline="always")
def solve_joints(first, second, r):
    """Return x, y with x (i first) + y (i second) = i r, for the columns i first, i second of Phi_z^d."""
    determinant = cross(first, second)
    return cross(r, second) / determinant, cross(first, r) / determinant


@njit
def motion(z, dz1, dz4):
    """Return rates, Z_j (2), velocity products (3) and the partition of Phi_z (10) at a Pose and the independent rates.

    Phi(z) is D reached over the brackets minus D reached over the outer boom, so the columns of Phi_z are
    i (D - B) for z2, i (D - C) for z3 (together Phi_z^d), and 0 for z1, -i (D - A) for z4 (together Phi_z^i).
    """
    R2, R3 = solve_joints(z.D - z.B, z.D - z.C, z.D - z.A)
    dz2, dz3 = R2 * dz4, R3 * dz4
    w1, w2, w3, w4 = dz1, dz1 + dz2, dz1 + dz2 + dz3, dz1 + dz4
    v1 = b_of(z.O) * dz1
    v2 = v1 + b_of(z.B) * dz2
    v3 = v2 + b_of(z.C) * dz3
    v4 = v1 + b_of(z.A) * dz4
    dB, dA = point_velocity(v1, w1, z.B), point_velocity(v1, w1, z.A)
    dC, dD = point_velocity(v2, w2, z.C), point_velocity(v4, w4, z.D)
    # d_j of (3) for a joint at r: both bodies give r the same acceleration, d - w^2 r
    d1 = w1 * w1 * z.O
    d2 = d1 + (w2 * w2 - w1 * w1) * z.B
    d3 = d2 + (w3 * w3 - w2 * w2) * z.C
    d4 = d1 + (w4 * w4 - w1 * w1) * z.A
    # Phi_z' z' = i [(D-B)' z2' + (D-C)' z3' - (D-A)' z4'], and Phi_z^d a = -Phi_z' z'
    a2, a3 = solve_joints(z.D - z.B, z.D - z.C, -((dD - dB) * dz2 + (dD - dC) * dz3 - (dD - dA) * dz4))
    return Motion(R2, R3, dz2, dz3, v1, w1, v2, w2, v3, w3, v4, w4, d1, d2, d3, d4, a2, a3)


@njit
def line(base, base_velocity, end, end_velocity):
    """Return length, rate and direction of the line from base to end, (35) and (36)."""
    along = end - base
    s = math.sqrt(square(along))
    u = along / s
    return Line(s, dot(end_velocity - base_velocity, u), u)


@njit
def lines(z, m):
    """Return the Lines of the lift and the tilt cylinder."""
    lift = line(z.F, complex(0.0, 0.0), z.G, point_velocity(m.v1, m.w1, z.G))
    tilt = line(z.H, point_velocity(m.v1, m.w1, z.H), z.C, point_velocity(m.v2, m.w2, z.C))
    return lift, tilt


# -------------------------------------------------------------------------------------- the tree's dynamics


@njit(inline="always")
def body_inertia(P, k, r, e):
    """M of body k (0..3) whose joint is at r, oriented along e (7)."""
    i = BODY + N_BODY * k
    g = r + e * point(P, i + 1)
    return Inertia(P[i], P[i] * g, P[i + 3] + P[i] * square(g))


@njit(inline="always")
def joined(M, N):
    """M of two bodies that move as one."""
    return Inertia(M.m + N.m, M.mg + N.mg, M.J + N.J)


@njit(inline="always")
def velocity_force(M, w, d):
    """Q - M d of one body: the centrifugal force w^2 m g of (8) less the inertia of the velocity products (9).

    The centrifugal force passes through the origin, so it has no moment there.
    """
    return w * w * M.mg - M.m * d, -cross(M.mg, d)


@njit(inline="always")
def joint_force(r, f, n):
    """R_d^T: generalised force on a revolute joint at r of a force f with moment n about the origin."""
    return n - cross(r, f)


@njit(inline="always")
def joint_inertia(r, M, q):
    """b(r)^T M b(q): entry of the tree's mass matrix for joints at r and q that both carry the bodies in M."""
    v = b_of(q)
    momentum = M.m * v + complex(-M.mg.imag, M.mg.real)
    return joint_force(r, momentum, M.J + cross(M.mg, v))


class Tree(NamedTuple):
    """M of the composite bodies that each joint carries (T^T M T), and the tree's mass matrix, upper triangle."""

    M1: Inertia
    M2: Inertia
    M3: Inertia
    M4: Inertia
    m22: float
    m23: float
    m33: float
    reduced11: float
    reduced14: float
    reduced44: float
    m12: float
    m13: float


@njit
def payload_inertia(P, m, E):
    """M of a payload of mass m that is fixed at E: a block of the crane file's width and height."""
    J = m * (P[PAYLOAD + 1] * P[PAYLOAD + 1] + P[PAYLOAD + 2] * P[PAYLOAD + 2]) / 12.0
    return Inertia(m, m * E, J + m * square(E))


@njit
def tree(z, m, P, payload):
    """Return R_d^T T^T M T R_d (9), and after it R_z^T (.) R_z (12) for [z1 z4].

    First step: the bodies as Cartesian ones, then collected along the paths. Second step: z2 and z3 follow z4.
    """
    M4 = joined(body_inertia(P, 3, z.A, z.e4), payload)
    M3 = body_inertia(P, 2, z.C, z.e3)
    M2 = body_inertia(P, 1, z.B, z.e2)
    C2 = joined(M2, M3)
    M1 = body_inertia(P, 0, z.O, z.e1)
    C1 = joined(joined(M1, C2), M4)
    m11, m12, m13, m14 = (
        joint_inertia(z.O, C1, z.O), joint_inertia(z.O, C2, z.B), joint_inertia(z.O, M3, z.C), joint_inertia(z.O, M4, z.A)
    )  # fmt: skip
    m22, m23, m33 = joint_inertia(z.B, C2, z.B), joint_inertia(z.B, M3, z.C), joint_inertia(z.C, M3, z.C)
    m44 = joint_inertia(z.A, M4, z.A)
    r14 = m14 + m12 * m.R2 + m13 * m.R3
    r44 = m44 + m22 * m.R2 * m.R2 + 2.0 * m23 * m.R2 * m.R3 + m33 * m.R3 * m.R3
    return Tree(M1, M2, M3, M4, m22, m23, m33, m11, r14, r44, m12, m13)


@njit(inline="always")
def up(z, m, f1, n1, f2, n2, f3, n3, f4, n4):
    """R_z^T R_d^T T^T: generalised forces on [z1 z4] of one force and moment about the origin for each body."""
    Q1 = joint_force(z.O, f1 + f2 + f3 + f4, n1 + n2 + n3 + n4)
    Q2 = joint_force(z.B, f2 + f3, n2 + n3)
    Q3 = joint_force(z.C, f3, n3)
    Q4 = joint_force(z.A, f4, n4)
    return Q1, Q4 + m.R2 * Q2 + m.R3 * Q3


@njit
def weight_forces(z, m, t, g):
    """Generalised gravity Qg on [z1 z4]; g is the gravity vector."""
    return up(
        z, m,
        t.M1.m * g, cross(t.M1.mg, g), t.M2.m * g, cross(t.M2.mg, g),
        t.M3.m * g, cross(t.M3.mg, g), t.M4.m * g, cross(t.M4.mg, g),
    )  # fmt: skip


@njit
def velocity_forces(z, m, t):
    """Generalised velocity-dependent forces Qv on [z1 z4]: the last terms of (9) and (12)."""
    f1, n1 = velocity_force(t.M1, m.w1, m.d1)
    f2, n2 = velocity_force(t.M2, m.w2, m.d2)
    f3, n3 = velocity_force(t.M3, m.w3, m.d3)
    f4, n4 = velocity_force(t.M4, m.w4, m.d4)
    Q1, Q4 = up(z, m, f1, n1, f2, n2, f3, n3, f4, n4)
    dependent2, dependent3 = t.m22 * m.a2 + t.m23 * m.a3, t.m23 * m.a2 + t.m33 * m.a3
    return Q1 - t.m12 * m.a2 - t.m13 * m.a3, Q4 - m.R2 * dependent2 - m.R3 * dependent3


@njit
def cylinder_forces(z, m, lift, tilt, F1, F2):
    """Generalised hydraulic forces Qh on [z1 z4] of the cylinder forces (39), which push their pins apart."""
    f, h, o = F1 * lift.u, F2 * tilt.u, complex(0.0, 0.0)
    return up(z, m, f - h, cross(z.G, f) - cross(z.H, h), h, cross(z.C, h), o, 0.0, o, 0.0)


@njit
def point_forces(z, m, E_force):
    """Generalised forces on [z1 z4] of a force on the outer boom at E."""
    o = complex(0.0, 0.0)
    return up(z, m, o, 0.0, o, 0.0, o, 0.0, E_force, cross(z.E, E_force))


# --------------------------------------------------------------------------------------------- hydraulics


@njit(inline="always")
def root_flow(dp, laminar):
    """q(dp) of (15): sgn(dp) sqrt|dp|, and linear below the laminar pressure."""
    if dp > laminar:
        return math.sqrt(dp)
    if dp < -laminar:
        return -math.sqrt(-dp)
    return dp / math.sqrt(laminar)


@njit
def pump_edge(c, u, pa, pb, pp, P, E):
    """Flow from the pump through valve c at the opening u: into the piston side (u > 0) or the rod side."""
    own = pa if u > 0.0 else pb
    return P[VALVE + N_VALVE * c] * abs(u) * root_flow(hooks.supply_drop(E, c, pp - own), P[LAMINAR])


@njit
def tank_edge(c, u, pa, pb, pt, P, E):
    """Flow to the tank through valve c at the opening u: out of the rod side (u > 0) or the piston side."""
    own, other, load = (pb, pa, 1.0 * c) if u > 0.0 else (pa, pb, 1.0 - c)
    gain = hooks.return_gain(E, c, own, other, load)
    return gain * P[VALVE + N_VALVE * c] * abs(u) * root_flow(own - pt, P[LAMINAR])


@njit
def drawn(u1, u2, p1, p2, p3, p4, pp, P, E):
    return pump_edge(0, u1, p1, p2, pp, P, E) + pump_edge(1, u2, p3, p4, pp, P, E)


@njit
def returned(u1, u2, p1, p2, p3, p4, pt, P, E):
    return tank_edge(0, u1, p1, p2, pt, P, E) + tank_edge(1, u2, p3, p4, pt, P, E)


@njit
def pump_gap(p, pp, u1, u2, p1, p2, p3, p4, P, E):
    """How far the pressure p is above what the supply gives at the flow that p drives."""
    return p - hooks.supply_pressure(E, pp, drawn(u1, u2, p1, p2, p3, p4, p, P, E))


@njit
def tank_gap(p, pt, u1, u2, p1, p2, p3, p4, P, E):
    return p - hooks.tank_pressure(E, pt, returned(u1, u2, p1, p2, p3, p4, p, P, E))


def _balanced(gap, doc):
    """Return a solver of gap(p) = 0 by regula falsi (Illinois), begun at the pressure without any flow."""

    @njit
    def solve(nominal, u1, u2, p1, p2, p3, p4, P, E):
        a, fa = nominal, gap(nominal, nominal, u1, u2, p1, p2, p3, p4, P, E)
        if fa == 0.0:
            return nominal
        # The flow weakens with the drop it causes, so the root lies between the nominal pressure and one full drop.
        b = a - fa
        fb = gap(b, nominal, u1, u2, p1, p2, p3, p4, P, E)
        tolerance = 4e-16 * max(abs(nominal), 1e5)
        for _ in range(100):
            if abs(fb) <= tolerance or abs(b - a) <= tolerance:
                return b
            p = b - fb * (b - a) / (fb - fa)
            f = gap(p, nominal, u1, u2, p1, p2, p3, p4, P, E)
            if f * fb < 0.0:
                a, fa = b, fb
            else:
                fa *= 0.5
            b, fb = p, f
        return b

    solve.__doc__ = doc
    return solve


pump_pressure = _balanced(pump_gap, "Return the pressure at the valves' pump ports, in balance with the flow drawn.")
tank_pressure = _balanced(tank_gap, "Return the pressure at the valves' tank ports, in balance with the flow returned.")


@njit(inline="always")
def fluid(P):
    """Return the Fluid of a crane."""
    zero = P[REFERENCE] * P[AIR]
    return Fluid(1.0 / P[OIL] + 1.0 / P[STEEL], 1.0 / P[HOSE] - 1.0 / P[STEEL], P[VAPOUR] - zero, zero)


@njit(inline="always")
def pressed_oil(y, pressed, share, gas, Al, Vh, f):
    """Return the Oil at a pressure y that is not below vapour pressure; pressed = exp(y/B) - 1, share and gas: see `oil_at`.

    Without gas N - V is summed up apart, so that pressure and amount follow from each other to the last digit.
    """
    V, wall = Al + Vh, Vh * f.wall
    if share == 0.0:
        k = 1.0 + pressed
        return Oil(y, y, V + (V + wall / f.soft) * pressed, V * k * f.soft + wall * k, k, k)
    k = (1.0 + pressed) * math.exp(-share)
    return Oil(y, y, V * k + wall / f.soft * pressed, V * k * (f.soft + gas) + wall * (1.0 + pressed), k, k)


@njit(inline="always")
def pulled_oil(y, empty, Al, Vh, f):
    """Return the Oil at a state y below vapour pressure, `empty` being the Oil there."""
    k, soft = empty.density, (Al + Vh) * f.soft + Vh * f.wall
    pull = k * (y - f.least)
    return Oil(y, f.least, empty.amount + pull * soft, k * soft, k + pull * f.soft, k)


@njit
def oil_at(y, Al, Vh, f, E):
    """Return the Oil of a chamber of volume Al with a hose of volume Vh, where the state says y for its pressure.

    (34) with (14) and (41) is an exact differential up to the factor k: dN = k Q dt = N_p dp + N_V dV with

        N = V k + Vh (1/Bh - 1/Bc) (exp(p/B) - 1) B,      k = exp(p/B - x),   1/B = 1/Bo + 1/Bc,   V = Al + Vh,

    x the free gas as a share of the oil. N is the volume that the oil had at the pressure 0, so it changes by flows alone.
    Below vapour pressure the oil gives way no further: y goes on falling as if oil could be pulled, while a void opens.
    """
    p = max(y, f.least)
    share, gas = hooks.free_gas(E, p + f.zero)
    there = pressed_oil(p, math.expm1(p * f.soft), share, gas, Al, Vh, f)
    return there if y >= f.least else pulled_oil(y, there, Al, Vh, f)


@njit
def oil_of(N, Al, Vh, guess, f, E):
    """Return the Oil of a chamber that holds the amount N: the inverse of `oil_at`, in closed form where there is no gas.

    With gas N(p) is concave, so that Newton's method climbs to the root from below without a bracket.
    """
    share, gas = hooks.free_gas(E, f.least + f.zero)
    if share == 0.0:
        pressed = (N - (Al + Vh)) / (Al + Vh + Vh * f.wall / f.soft)
        y = math.log1p(pressed) / f.soft
        if y >= f.least:
            return pressed_oil(y, pressed, 0.0, 0.0, Al, Vh, f)
    empty = pressed_oil(f.least, math.expm1(f.least * f.soft), share, gas, Al, Vh, f)
    if not N > empty.amount:
        pull = (N - empty.amount) / (empty.density * ((Al + Vh) * f.soft + Vh * f.wall))
        return pulled_oil(f.least + pull, empty, Al, Vh, f)
    there = oil_at(max(guess, f.least), Al, Vh, f, E)
    for _ in range(100):
        change = (N - there.amount) / there.by_pressure
        there = oil_at(max(there.y + change, f.least), Al, Vh, f, E)
        if abs(change) <= 1e-6 + 1e-10 * abs(there.y):
            break
    return there


@njit
def chambers_at(c, s, ya, yb, f, P, E):
    """Return the Chambers of cylinder c at pin-to-pin length s and the state's pressures ya, yb.

    With a spring of compliance k' in series the hydraulic length is s + k' F, F the force of the pressures.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    la = s - P[i + EMPTY]
    compliance = hooks.series_compliance(E, c)
    if compliance != 0.0:
        la += compliance * (max(ya, f.least) * Aa - max(yb, f.least) * Ab)
    return Chambers(
        la, oil_at(ya, Aa * la, P[i + HOSE_A], f, E), oil_at(yb, Ab * (P[i + RANGE] - la), P[i + HOSE_B], f, E)
    )


@njit
def chambers_of(c, s, Na, Nb, ya, yb, f, P, E):
    """Return the Chambers that hold the amounts Na, Nb; ya, yb: a guess of their pressures.

    With a spring in series F(la(F)) = F is solved by Newton's method: more force means more length and so less force.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    compliance, L, Va, Vb = hooks.series_compliance(E, c), P[i + RANGE], P[i + HOSE_A], P[i + HOSE_B]
    la = s - P[i + EMPTY]
    if compliance == 0.0:
        return Chambers(la, oil_of(Na, Aa * la, Va, ya, f, E), oil_of(Nb, Ab * (L - la), Vb, yb, f, E))
    F, rest = max(ya, f.least) * Aa - max(yb, f.least) * Ab, la
    for _ in range(60):
        la = rest + compliance * F
        a, b = oil_of(Na, Aa * la, Va, ya, f, E), oil_of(Nb, Ab * (L - la), Vb, yb, f, E)
        ya, yb, slope = a.y, b.y, 1.0
        if ya > f.least:
            slope += compliance * Aa * Aa * a.by_volume / a.by_pressure
        if yb > f.least:
            slope += compliance * Ab * Ab * b.by_volume / b.by_pressure
        change = (a.pressure * Aa - b.pressure * Ab - F) / slope
        F += change
        if abs(change) <= 1e-9 + 1e-13 * abs(F):
            break
    return Chambers(la, a, b)


@njit(inline="always")
def piston_areas(i, P):
    """Return the areas of piston side and rod side of the cylinder whose block begins at i."""
    Aa = 0.25 * math.pi * P[i + BORE] * P[i + BORE]
    return Aa, Aa - 0.25 * math.pi * P[i + ROD] * P[i + ROD]


@njit
def friction(P, i, v):
    """Friction force (19) of the cylinder whose block begins at i, with the sign of v."""
    x = v / P[i + STRIBECK]
    hump = 0.25 * x * x + 0.75
    stribeck = (P[i + STATIC] - P[i + COULOMB]) * x / (hump * hump)
    return P[i + COULOMB] * math.tanh(4.0 * x) + stribeck + P[i + VISCOUS] * v * TANH4


@njit
def cylinder(c, v, chambers, f, u, pp, pt, P, E, flow_a, flow_b):
    """Return all hydraulic quantities of cylinder c at the rate v of its pin-to-pin length, (17)-(19), (34), (37), (38).

    flow_a, flow_b: flows into the chambers that no law explains (disturbances). Air presses on the rod's cross-section.

    With a spring of compliance k' in series the rate of the hydraulic length follows from both chambers' pressure rates, which
    depend on it linearly, so it is found without iteration. A chamber that holds a void has a constant pressure.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    compliance = hooks.series_compliance(E, c)
    la, a, b = chambers
    pa, pb, lb = a.pressure, b.pressure, P[i + RANGE] - la
    pump, tank = pump_edge(c, u, pa, pb, pp, P, E), tank_edge(c, u, pa, pb, pt, P, E)
    Qa, Qb = (pump, tank) if u > 0.0 else (-tank, -pump)
    leak_a, leak_b = hooks.leakage(E, c, pa, pb)
    leak_a, leak_b = leak_a + flow_a, leak_b + flow_b
    Ga, Gb = a.density * (Qa + leak_a), b.density * (leak_b - Qb)
    if compliance != 0.0:
        ka, kb = (1.0 / a.by_pressure if a.y > f.least else 0.0), (1.0 / b.by_pressure if b.y > f.least else 0.0)
        v += compliance * (Aa * ka * Ga - Ab * kb * Gb)
        v /= 1.0 + compliance * (Aa * Aa * ka * a.by_volume + Ab * Ab * kb * b.by_volume)
    Fmu = friction(P, i, v)
    air = (1.0 - P[REFERENCE]) * P[AIR] * (Aa - Ab)
    F = pa * Aa - pb * Ab - air - Fmu + hooks.cylinder_force(E, c, v, pa, pb, la, lb)
    return Cylinder(la, lb, Qa, Qb, leak_a, leak_b, Fmu, F, a, b, Ga, Gb, v)


# -------------------------------------------------------------------------------------------- all together


@njit(inline="always")
def supply(w, k, P):
    """Measured pump (k = 0) or tank (k = 1) pressure, or the crane's own where it is not measured."""
    return P[SUPPLY + k] if math.isnan(w[2 + k]) else w[2 + k]


@njit(inline="always")
def disturbance(w, k):
    """Unknown input k of [torque O, torque A, force x, force y at E, flows into p1 p2 p3 p4]; 0 where w has but four entries."""
    return w[4 + k] if w.shape[0] > 4 else 0.0


class Swing(NamedTuple):
    """What a payload on a pendulum adds to the balance of [z1 z4], and its own balance.

    The payload is a point mass on a massless rod that hangs from E. Its angle (absolute, 0 = straight down) has the inertia
    m L^2 and is eliminated from the 3 x 3 system. The rod can only pull or push along itself, so what E feels is the mass along
    the rod; the damping is a drag on the mass, -d theta' / L across the rod, whose moment about E is -d theta'.
    """

    M11: float
    M14: float
    M44: float
    g1: float
    g4: float
    v1: float
    v4: float
    across1: float
    across4: float
    own: float


@njit
def swing(z, m, mass, length, damping, g, theta, dtheta):
    """Return the Swing of a pendulum at angle theta (rad) and rate dtheta; L theta'' = own - across . [z1'' z4'']."""
    across, down = turn(theta), complex(math.sin(theta), -math.cos(theta))
    velocity_product = m.d4 - m.w4 * m.w4 * z.E - length * dtheta * dtheta * down  # of the mass
    J1, J4 = (z.E - z.O) * 1j, (z.E - z.A) * 1j
    across1, across4, down1, down4 = dot(J1, across), dot(J4, across), dot(J1, down), dot(J4, down)
    weight, pull = mass * dot(g, down), -mass * dot(velocity_product, down)
    drag = damping * dtheta / length
    own = dot(g - velocity_product, across) - (drag / mass if mass > 0.0 else 0.0)
    return Swing(
        mass * down1 * down1, mass * down1 * down4, mass * down4 * down4, down1 * weight, down4 * weight,
        down1 * pull, down4 * pull, across1, across4, own,
    )  # fmt: skip


@njit(inline="always")
def solve2(a, b, c, x, y):
    """Solve [[a, b], [b, c]] q = [x, y]."""
    determinant = a * c - b * b
    return (c * x - b * y) / determinant, (a * y - b * x) / determinant


class Balance(NamedTuple):
    """Every term of the equations at one state."""

    z: Pose
    m: Motion
    lift: Line
    tilt: Line
    c1: Cylinder
    c2: Cylinder
    pp: float
    pt: float
    M11: float
    M14: float
    M44: float
    Qg1: float
    Qg4: float
    Qv1: float
    Qv4: float
    Qh1: float
    Qh4: float
    Qj1: float
    Qj4: float
    ddz1: float
    ddz4: float
    ddtheta: float


@njit(inline="always")
def balance(x, w, t, P, E):
    """Return all terms of M z'' = Qg + Qv + Qh + Qj (12) and of (34), coupled as in (20), at a state x (nx,)."""
    z = positions(x[0], x[1], P)
    m = motion(z, x[2], x[3])
    lift, tilt = lines(z, m)
    f = fluid(P)
    first, second = chambers_at(0, lift.s, x[4], x[5], f, P, E), chambers_at(1, tilt.s, x[6], x[7], f, P, E)
    return balance_at(z, m, lift, tilt, first, second, f, x, w, t, P, E)


@njit(inline="always")
def balance_of_amounts(x, N, w, t, P, E):
    """Return the same for amounts of oil N (4,) instead of the pressures in x, which are replaced by what follows from N."""
    z = positions(x[0], x[1], P)
    m = motion(z, x[2], x[3])
    lift, tilt = lines(z, m)
    f = fluid(P)
    first, second = fill_pressures(lift.s, tilt.s, x, N, f, P, E)
    return balance_at(z, m, lift, tilt, first, second, f, x, w, t, P, E)


@njit
def fill_pressures(s1, s2, x, N, f, P, E):
    """Write the pressures that follow from the amounts of oil N (4,) at pin-to-pin lengths s1, s2 to x; return both Chambers."""
    first = chambers_of(0, s1, N[0], N[1], x[4], x[5], f, P, E)
    second = chambers_of(1, s2, N[2], N[3], x[6], x[7], f, P, E)
    x[4], x[5], x[6], x[7] = first.a.y, first.b.y, second.a.y, second.b.y
    return first, second


@njit
def settle_pressures(x, N, P, E):
    """Write the pressures that follow from the amounts of oil N (4,) at the pose in x to x."""
    z = positions(x[0], x[1], P)
    fill_pressures(math.sqrt(square(z.G - z.F)), math.sqrt(square(z.C - z.H)), x, N, fluid(P), P, E)


@njit
def balance_at(z, m, lift, tilt, first, second, f, x, w, t, P, E):
    """Return all terms at a Pose, Motion, Lines and Chambers."""
    u1, u2 = hooks.opening(E, 0, w[0]), hooks.opening(E, 1, w[1])
    p1, p2, p3, p4 = first.a.pressure, first.b.pressure, second.a.pressure, second.b.pressure
    pp = pump_pressure(supply(w, 0, P), u1, u2, p1, p2, p3, p4, P, E)
    pt = tank_pressure(supply(w, 1, P), u1, u2, p1, p2, p3, p4, P, E)
    c1 = cylinder(0, lift.v, first, f, u1, pp, pt, P, E, disturbance(w, 4), disturbance(w, 5))
    c2 = cylinder(1, tilt.v, second, f, u2, pp, pt, P, E, disturbance(w, 6), disturbance(w, 7))
    mass = hooks.payload_mass(E, t, P[PAYLOAD])
    length, damping = hooks.pendulum(E)
    swings = length > 0.0 and x.shape[0] > 8
    tr = tree(z, m, P, payload_inertia(P, 0.0 if swings else mass, z.E))
    gx, gy = hooks.gravity(E, 0.0, -P[GRAVITY])
    g = complex(gx, gy)
    g1, g4 = weight_forces(z, m, tr, g)
    v1, v4 = velocity_forces(z, m, tr)
    h1, h4 = cylinder_forces(z, m, lift, tilt, c1.F, c2.F)
    j1, j4 = point_forces(z, m, complex(disturbance(w, 2), hooks.tip_force(E, t) + disturbance(w, 3)))
    j1 += hooks.joint_torque(E, 0, x[2]) + disturbance(w, 0)
    j4 += hooks.joint_torque(E, 1, x[3]) + disturbance(w, 1)
    M11, M14, M44, ddtheta = tr.reduced11, tr.reduced14, tr.reduced44, 0.0
    if swings:
        p = swing(z, m, mass, length, damping, g, x[8], x[9])
        M11, M14, M44 = M11 + p.M11, M14 + p.M14, M44 + p.M44
        g1, g4, v1, v4 = g1 + p.g1, g4 + p.g4, v1 + p.v1, v4 + p.v4
    dd1, dd4 = solve2(M11, M14, M44, g1 + v1 + h1 + j1, g4 + v4 + h4 + j4)
    if swings:
        ddtheta = (p.own - p.across1 * dd1 - p.across4 * dd4) / length
    return Balance(
        z, m, lift, tilt, c1, c2, pp, pt, M11, M14, M44, g1, g4, v1, v4, h1, h4, j1, j4, dd1, dd4, ddtheta
    )  # fmt: skip


@njit(inline="always")
def rates(b, x, E, out):
    """Write the rates of [z1 z4 z1' z4' N1 N2 N3 N4 (theta theta')] to out: amounts of oil in the place of pressures."""
    out[0], out[1], out[2], out[3] = x[2], x[3], b.ddz1, b.ddz4
    out[4], out[5], out[6], out[7] = b.c1.Ga, b.c1.Gb, b.c2.Ga, b.c2.Gb
    if x.shape[0] > 8:
        out[8], out[9] = (x[9], b.ddtheta) if hooks.pendulum(E)[0] > 0.0 else (0.0, 0.0)


@njit(inline="always")
def amounts(b, N):
    """Write the amounts of oil in the four chambers to N."""
    N[0], N[1], N[2], N[3] = b.c1.a.amount, b.c1.b.amount, b.c2.a.amount, b.c2.b.amount


@njit
def pressure_rate(o, G, area, v):
    """Return the rate of a state's pressure, (34): N_p y' = G - N_V A v, A v being the growth of the volume."""
    return (G - o.by_volume * area * v) / o.by_pressure


@njit
def static_forces(z1, z4, P, E):
    """Return cylinder forces F1, F2 (N) that hold the crane at rest at z1, z4 at time 0, and their hydraulic lengths' s."""
    z = positions(z1, z4, P)
    m = motion(z, 0.0, 0.0)
    lift, tilt = lines(z, m)
    tr = tree(z, m, P, payload_inertia(P, hooks.payload_mass(E, 0.0, P[PAYLOAD]), z.E))
    gx, gy = hooks.gravity(E, 0.0, -P[GRAVITY])
    g1, g4 = weight_forces(z, m, tr, complex(gx, gy))
    j1, j4 = point_forces(z, m, complex(0.0, hooks.tip_force(E, 0.0)))
    # columns: generalised forces of a unit force in the lift and in the tilt cylinder
    a11, a41 = cylinder_forces(z, m, lift, tilt, 1.0, 0.0)
    a14, a44 = cylinder_forces(z, m, lift, tilt, 0.0, 1.0)
    determinant = a11 * a44 - a14 * a41
    Q1, Q4 = -(g1 + j1), -(g4 + j4)
    return (a44 * Q1 - a14 * Q4) / determinant, (a11 * Q4 - a41 * Q1) / determinant, lift.s, tilt.s


@njit
def held_pressures(c, s, F, less_loaded, P, E):
    """Return pa, pb of cylinder c that give the force F at rest, the lower of the two being `less_loaded`.

    Forces that act on the piston at rest (an end stop) depend on the pressures only through a spring in series: repeated
    until nothing changes.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    F += (1.0 - P[REFERENCE]) * P[AIR] * (Aa - Ab)
    own, pa, pb = 0.0, less_loaded, less_loaded
    for _ in range(50):
        rest = F - own
        if rest >= less_loaded * (Aa - Ab):
            pa, pb = (rest + less_loaded * Ab) / Aa, less_loaded
        else:
            pa, pb = less_loaded, (less_loaded * Aa - rest) / Ab
        la = s + hooks.series_compliance(E, c) * (pa * Aa - pb * Ab) - P[i + EMPTY]
        new = hooks.cylinder_force(E, c, 0.0, pa, pb, la, P[i + RANGE] - la)
        if abs(new - own) <= 1e-9 * max(1.0, abs(F)):
            break
        own = new
    return pa, pb


@njit
def pin_to_pin(cylinder, angle, P):
    """Return the length of the lift cylinder (0) at z1 or of the tilt cylinder (1) at z4; each depends on its angle alone."""
    z = positions(angle, 0.0, P) if cylinder == 0 else positions(0.0, angle, P)
    along = z.G - z.F if cylinder == 0 else z.C - z.H
    return math.sqrt(square(along))


@njit
def chamber_lengths(x, P, E, out):
    """Write the chamber lengths la, lb of the lift and the tilt cylinder (4,) to out; negative: beyond the stroke's end."""
    z = positions(x[0], x[1], P)
    f = fluid(P)
    out[0] = chambers_at(0, math.sqrt(square(z.G - z.F)), x[4], x[5], f, P, E).la
    out[2] = chambers_at(1, math.sqrt(square(z.C - z.H)), x[6], x[7], f, P, E).la
    out[1], out[3] = P[CYLINDER + RANGE] - out[0], P[CYLINDER + N_CYLINDER + RANGE] - out[2]
