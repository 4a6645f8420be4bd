"""A machine's equations by the double-step semi-recursive method and lumped fluids, compiled.

Written from the paper, (1)-(20) and (34)-(41), for planar bodies: a tree of turning and sliding joints, loops cut at a
joint. A point or a force in the plane is one complex number x + iy, so that turning a vector by an angle is a product
with exp(i angle). Products needed below, for vectors a and b:

    dot(a, b) = a.b        cross(a, b) = a x b (its component along the axis of rotation)

Every body has one joint, to its carrier. The path matrix T (row j: the joints between the ground and body j) is applied
without storing it: from the ground up the tree (positions, Z_j, d_j), or down to the ground (forces, inertias). For the
PATU, whose loop A-B-C-D is cut at D,

    pillar --O, z1-- lift boom (1) --B, z2-- bracket 1 (2) --C, z3-- bracket 2 (3)
                              \\--A, z4-- outer boom with payload (4)

        | 1 0 0 0 |
    T = | 1 1 0 0 |     times 3 x 3 identity matrices
        | 1 1 1 0 |
        | 1 0 0 1 |

The reference point of every body is the point that at this instant coincides with the origin, so its velocity is
Z_j = (s', Omega): two translations (one complex number) and a rotation. Signs: angles counter-clockwise positive,
cylinder forces and rates positive in extension, flows Qa into the piston side, Qb out of the rod side.

One code is for all machines: `Machine.topology` says what is joined to what, and all terms of one state stand in a
`Sheet`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crane_exudyn import parameters as par
from crane_exudyn.compiled import inner, part
from crane_exudyn.effects import hooks
from crane_exudyn.machine import (
    BASE,
    BASE_BODY,
    BODIES,
    CARRIER,
    COORDINATE,
    CUT_PIN,
    CYLINDERS,
    DEPENDENT,
    DIRECTION,
    FIRST_OF_LOOP,
    KIND,
    LAST,
    LAST_PIN,
    LOADED,
    LOOPS,
    NUMBERS,
    OWN_PIN,
    PIN,
    ROD_BODY,
    ROD_END,
    SECOND_OF_LOOP,
    SIDE,
    SLIDES,
    TIP_BODY,
    TIP_POINT,
)

#: a part that becomes one with what calls it
inline = part(forceinline=True)

# Places in P. They stand here as plain integers because compiled code reads globals as constants.
PAYLOAD, FLUID, SUPPLY, GRAVITY = par.PAYLOAD, par.FLUID, par.SUPPLY, par.GRAVITY
CYLINDER, N_CYLINDER, VALVE, N_VALVE = par.CYLINDER, par.N_CYLINDER, par.VALVE, par.N_VALVE
BORE, ROD, EMPTY, RANGE, HOSE_A, HOSE_B, COULOMB, STATIC, STRIBECK, VISCOUS = range(VALVE - CYLINDER)
PUMP_TO_A, PUMP_TO_B, A_TO_TANK, B_TO_TANK = range(N_VALVE - (VALVE - CYLINDER) - 4, N_VALVE - (VALVE - CYLINDER))
OIL, STEEL, HOSE, VAPOUR, LAMINAR = range(FLUID, FLUID + 5)
AIR, REFERENCE = SUPPLY + 2, SUPPLY + 3
TANH4 = math.tanh(4.0)

# -- the sheet: row k of `vectors` and `numbers` belongs to row k of the topology. Row 0 is the ground, and what is not
# a body's. a body: its orientation exp(i angle), the origin of its frame, its joint's pin (or direction, where it
# slides), v and d of Z_j and (3), m g of the bodies that its joint carries, and the force on them
TURN, FRAME, AXIS, SPEED, PRODUCT, MOMENT, FORCE = range(7)
# row 0: ground, with the payload's point
TIP_AT = 2
# a loop: where it is cut, and Phi_z' z' of dependent joints on its paths
CUT, NESTED = range(2)
# a cylinder: its pins and its direction
BASE_AT, ROD_AT, ALONG = range(3)
# a body: w of Z_j, mass and moment of inertia that its joint carries, moment of the force, and R_z' z_i'
OMEGA, MASS, INERTIA, COUPLE, FOLLOWED = range(5)
# a cylinder: length and rate of the line between its pins, opening of its valve, flows over the edges to pump and tank,
# length and rate of the piston-side chamber, flows of valve and leakages, friction, force, rates of the amounts, and
# the Oil of both sides
LENGTH, SPEED_S, OPENING, DRAWN, RETURNED, LA, SPEED_LA, QA, QB, LEAK_A, LEAK_B, FMU, F, GA, GB = range(15)
OIL_A, OIL_B = 15, 21
PRESSURE, AMOUNT, BY_PRESSURE, BY_VOLUME, DENSITY = range(1, 6)
# row 0: pressures at the valves' ports, length of a pendulum, what accelerates it without the coordinates'
# accelerations, and its angle's acceleration
PUMP, TANK, PENDULUM, OWN, SWINGING = range(5, 10)
# every row, from here on: what it is by each independent coordinate. A body: its row of R_z, and behind it of M R_z; a
# cylinder: generalised force of a unit force; two rows behind all others: the velocity of the payload's point
BY = 27
# rows of `general`, numbers by independent coordinate
WEIGHT, VELOCITY, HYDRAULIC, JOINTS, ACCELERATION, PIVOT, ACROSS, DOWN = range(8)
MATRIX = 8


class Sheet(NamedTuple):
    """A machine, and room for all terms of one state of it.

    Attributes:
        topology: of the machine.
        vectors, numbers: terms of the ground, the bodies, loops and cylinders, a row each.
        general: generalised forces and accelerations, and below them the mass matrix M, its factors above the diagonal.
    """

    topology: np.ndarray
    vectors: np.ndarray
    numbers: np.ndarray
    general: np.ndarray


class Fluid(NamedTuple):
    """Numbers of the machine that all chambers share."""

    soft: float  # 1/B = 1/Bo + 1/Bc
    wall: float  # 1/Bh - 1/Bc
    least: float  # vapour pressure, and
    zero: float  # what is to be added for an absolute pressure, as the machine's gauges read them
    share: float  # free gas at vapour pressure, and
    gas: float  # its compliance


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


@inner
def sheet(topology):
    """Return an empty Sheet of a machine."""
    rows, n = topology.shape[0], topology[0, CYLINDERS]
    return Sheet(
        topology, np.zeros((rows, 7), np.complex128), np.zeros((rows + 2, BY + 2 * n)), np.zeros((MATRIX + n, n))
    )  # fmt: skip


# ------------------------------------------------------------------------------------------------ vectors


@inline
def dot(a, b):
    return a.real * b.real + a.imag * b.imag


@inline
def cross(a, b):
    return a.real * b.imag - a.imag * b.real


@inline
def square(a):
    return a.real * a.real + a.imag * a.imag


@inline
def turned(a):
    """i a, without a product."""
    return complex(-a.imag, a.real)


@inline
def point(P, k):
    """Return the point at k in P; the origin of its frame where k is -1."""
    return complex(P[k], P[k + 1]) if k >= 0 else complex(0.0, 0.0)


@inline
def turn(angle):
    return complex(math.cos(angle), math.sin(angle))


@inline
def placed(body, k, P, s):
    """Return where the point at k in P of a body is."""
    return s.vectors[body, FRAME] + s.vectors[body, TURN] * point(P, k)


@inline
def moved(body, r, s):
    """Return the velocity of the point at r of a body with Z = (v, w)."""
    return s.vectors[body, SPEED] + s.numbers[body, OMEGA] * turned(r)


# ------------------------------------------------------------------------------------------------- joints


@inline
def carrier(j, s):
    return s.topology[j, CARRIER] + 1


@inline
def lever(j, r, s):
    """Return the velocity of a point at r per rate of joint j; at the origin it is the translation of b_j (2)."""
    axis = s.vectors[j, AXIS]
    return axis if s.topology[j, KIND] == SLIDES else turned(r - axis)


@inline
def joint_force(j, f, n, s):
    """R_d^T: generalised force on joint j of a force f with moment n about the origin."""
    axis = s.vectors[j, AXIS]
    return dot(axis, f) if s.topology[j, KIND] == SLIDES else n - cross(axis, f)


@inline
def add_rate(row, column, j, amount, s):
    """Add an amount per rate of joint j to the numbers of a row by independent coordinate: R_z (11)."""
    i = s.topology[j, COORDINATE]
    if i >= 0:
        s.numbers[row, column + i] += amount
    else:
        for i in range(s.topology[0, CYLINDERS]):
            s.numbers[row, column + i] += amount * s.numbers[j, BY + i]


@inline
def clear(row, s):
    for i in range(s.topology[0, CYLINDERS]):
        s.numbers[row, BY + i] = 0.0


# ---------------------------------------------------------------------------------------------- positions


@inline
def third_corner(B, D, BC, CD, side):
    """Return C left (side 1) or right (-1) of the line from B to D, at the distances of BC and CD; NaN if the loop
    cannot be closed.
    """
    along = D - B
    d2 = square(along)
    share = 0.5 * (square(BC) - square(CD) + d2) / d2
    height2 = square(BC) / d2 - share * share
    return B + along * complex(share, side * math.sqrt(height2) if height2 >= 0.0 else math.nan)


@inline
def loop_of(first, s):
    """Return the row of the loop whose first dependent body is in a row."""
    k = 1 + s.topology[0, BODIES]
    while s.topology[k, DEPENDENT] + 1 != first:
        k += 1
    return k


@inline
def close_loop(a, P, s):
    """Place the two dependent bodies of a loop, a and the next, between its first pin and where it is cut."""
    b, k = a + 1, loop_of(a, s)
    own_a, own_b = point(P, s.topology[a, OWN_PIN]), point(P, s.topology[b, OWN_PIN])
    B = placed(carrier(a, s), s.topology[a, PIN], P, s)
    D = placed(s.topology[k, LAST] + 1, s.topology[k, LAST_PIN], P, s)
    BC, CD = point(P, s.topology[b, PIN]) - own_a, point(P, s.topology[k, CUT_PIN]) - own_b
    C = third_corner(B, D, BC, CD, s.topology[k, SIDE])
    s.vectors[k, CUT], s.vectors[a, AXIS], s.vectors[b, AXIS] = D, B, C
    s.vectors[a, TURN] = (C - B) * BC.conjugate() / square(BC)
    s.vectors[b, TURN] = (D - C) * CD.conjugate() / square(CD)
    s.vectors[a, FRAME] = B - s.vectors[a, TURN] * own_a
    s.vectors[b, FRAME] = C - s.vectors[b, TURN] * own_b


@inline
def place_joint(j, q, P, s):
    """Place a body whose joint has the coordinate q."""
    c = carrier(j, s)
    e, r = s.vectors[c, TURN], placed(c, s.topology[j, PIN], P, s)
    if s.topology[j, KIND] == SLIDES:
        s.vectors[j, AXIS] = e * turn(P[s.topology[j, DIRECTION]])
        r += q * s.vectors[j, AXIS]
    else:
        s.vectors[j, AXIS] = r
        e *= turn(q)
    s.vectors[j, TURN], s.vectors[j, FRAME] = e, r - e * point(P, s.topology[j, OWN_PIN])


@inline
def place_lines(P, s):
    """Write pins, directions and lengths of the cylinders (35)."""
    first = 1 + s.topology[0, BODIES] + s.topology[0, LOOPS]
    for k in range(first, first + s.topology[0, CYLINDERS]):
        base = placed(s.topology[k, BASE_BODY] + 1, s.topology[k, BASE], P, s)
        end = placed(s.topology[k, ROD_BODY] + 1, s.topology[k, ROD_END], P, s)
        length = math.sqrt(square(end - base))
        s.vectors[k, BASE_AT], s.vectors[k, ROD_AT], s.vectors[k, ALONG] = base, end, (end - base) / length
        s.numbers[k, LENGTH] = length


@part
def place(x, P, s):
    """Write the positions of all bodies and cylinders at a state x, loops being closed."""
    s.vectors[0, TURN], s.vectors[0, FRAME] = 1.0, 0.0
    for j in range(1, 1 + s.topology[0, BODIES]):
        kind = s.topology[j, KIND]
        if kind == FIRST_OF_LOOP:
            close_loop(j, P, s)
        elif kind != SECOND_OF_LOOP:
            place_joint(j, x[s.topology[j, COORDINATE]], P, s)
    place_lines(P, s)


# --------------------------------------------------------------------------------------------- velocities


@inline
def solve_joints(first, second, r):
    """Return x, y with x (i first) + y (i second) = i r, for the columns i first, i second of Phi_z^d."""
    determinant = cross(first, second)
    return cross(r, second) / determinant, cross(first, r) / determinant


@inline
def add_column(a, k, j, sign, s):
    """Add what joint j, on a path of the loop in row k, contributes to R_z of the dependent bodies a and the next, and
    to Phi_z' z'.
    """
    D = s.vectors[k, CUT]
    column = sign * lever(j, D, s)
    x, y = solve_joints(D - s.vectors[a, AXIS], D - s.vectors[a + 1, AXIS], turned(column))  # i r = -column
    add_rate(a, BY, j, x, s)
    add_rate(a + 1, BY, j, y, s)
    if s.topology[j, COORDINATE] < 0:
        s.vectors[k, NESTED] += s.numbers[j, FOLLOWED] * column


@inline
def partition(a, s):
    """Write the rows of R_z of the dependent bodies a and the next by the partition of Phi_z (10), -Phi_z^d \\ Phi_z^i.

    Phi(z) is the cut pin reached over the dependent bodies minus the same reached over the body that the loop ends on.
    Its columns are i (D - B), i (D - C) for the dependent joints at B and C (together Phi_z^d), and the levers of D for
    the other joints (Phi_z^i): positive on the path to B, negative on the other path; those on both cancel out.
    """
    k = loop_of(a, s)
    clear(a, s)
    clear(a + 1, s)
    s.vectors[k, NESTED] = 0.0
    p, q = carrier(a, s), s.topology[k, LAST] + 1
    while p != q:
        if p > q:
            add_column(a, k, p, 1.0, s)
            p = carrier(p, s)
        else:
            add_column(a, k, q, -1.0, s)
            q = carrier(q, s)


@inline
def follow(b, s):
    """Write R_z' z_i' of the dependent bodies b and the one before: their accelerations while independent coordinates
    have none.

    Phi_z^d a = -Phi_z' z', and Phi_z' z' is by how much the velocity products let the pin run apart.
    """
    a, k = b - 1, loop_of(b - 1, s)
    last, D = s.topology[k, LAST] + 1, s.vectors[k, CUT]
    w, w_last = s.numbers[b, OMEGA], s.numbers[last, OMEGA]
    apart = s.vectors[b, PRODUCT] - s.vectors[last, PRODUCT] - (w * w - w_last * w_last) * D + s.vectors[k, NESTED]
    s.numbers[a, FOLLOWED], s.numbers[b, FOLLOWED] = solve_joints(
        D - s.vectors[a, AXIS], D - s.vectors[b, AXIS], turned(apart)
    )


@inline
def joint_rate(j, x, s):
    """Return the rate of joint j: R_z z_i'."""
    n, i = s.topology[0, CYLINDERS], s.topology[j, COORDINATE]
    if i >= 0:
        return x[n + i]
    rate = 0.0
    for i in range(n):
        rate += s.numbers[j, BY + i] * x[n + i]
    return rate


@inline
def move_joint(j, rate, s):
    """Write Z_j (2) and the velocity product d_j (3), (T R_d)' z', of a body whose joint has a rate.

    A pin has the same acceleration d - w^2 r on both its bodies; along a slide there is Coriolis' instead. Its rotation
    vanishes.
    """
    c = carrier(j, s)
    w, axis = s.numbers[c, OMEGA], s.vectors[j, AXIS]
    s.vectors[j, SPEED] = s.vectors[c, SPEED] + rate * lever(j, 0j, s)
    if s.topology[j, KIND] == SLIDES:
        s.numbers[j, OMEGA] = w
        s.vectors[j, PRODUCT] = s.vectors[c, PRODUCT] + 2.0 * w * rate * turned(axis)
    else:
        turning = w + rate
        s.numbers[j, OMEGA] = turning
        s.vectors[j, PRODUCT] = s.vectors[c, PRODUCT] + (turning * turning - w * w) * axis


@inline
def move(x, s):
    """Write the motions of all bodies at a state x that is placed."""
    for j in range(1, 1 + s.topology[0, BODIES]):
        kind = s.topology[j, KIND]
        if kind == FIRST_OF_LOOP:
            partition(j, s)
        move_joint(j, joint_rate(j, x, s), s)
        if kind == SECOND_OF_LOOP:
            follow(j, s)


@inline
def add_unit_force(k, j, sign, n, s):
    add_rate(k, BY, j, sign * joint_force(j, s.vectors[k, ALONG], n, s), s)


@inline
def move_lines(s):
    """Write the rates of the cylinders (36), and R_z^T R_d^T T^T of unit forces that push their pins apart."""
    first = 1 + s.topology[0, BODIES] + s.topology[0, LOOPS]
    for k in range(first, first + s.topology[0, CYLINDERS]):
        p, q = s.topology[k, ROD_BODY] + 1, s.topology[k, BASE_BODY] + 1
        base, end, u = s.vectors[k, BASE_AT], s.vectors[k, ROD_AT], s.vectors[k, ALONG]
        s.numbers[k, SPEED_S] = dot(moved(p, end, s) - moved(q, base, s), u)
        clear(k, s)
        n = cross(base, u)
        while p != q:  # joints that carry both bodies feel nothing
            if p > q:
                add_unit_force(k, p, 1.0, n, s)
                p = carrier(p, s)
            else:
                add_unit_force(k, q, -1.0, n, s)
                q = carrier(q, s)


@inline
def move_tip(s):
    """Write the velocity of the payload's point by independent coordinate; return what accelerates it while these have
    no acceleration.
    """
    tip, row, E = s.topology[0, TIP_BODY] + 1, s.topology.shape[0], s.vectors[0, TIP_AT]
    clear(row, s)
    clear(row + 1, s)
    w = s.numbers[tip, OMEGA]
    product = s.vectors[tip, PRODUCT] - w * w * E
    j = tip
    while j > 0:
        arm = lever(j, E, s)
        add_rate(row, BY, j, arm.real, s)
        add_rate(row + 1, BY, j, arm.imag, s)
        if s.topology[j, COORDINATE] < 0:
            product += s.numbers[j, FOLLOWED] * arm
        j = carrier(j, s)
    return product


# -------------------------------------------------------------------------------------- the tree's dynamics


@inline
def weigh(j, mass, P, s):
    """Write M of a body about the origin (7), mass, first moment m g and second moment J + m |g|^2, and Q - M d of it.

    Q is the centrifugal force w^2 m g of (8), which passes through the origin, and M d the inertia of the velocity
    products (9). The payload, a block of the file's width and height, is a part of the body that carries it.
    """
    k = s.topology[j, NUMBERS]
    m, g = P[k], s.vectors[j, FRAME] + s.vectors[j, TURN] * point(P, k + 1)
    mg, J = m * g, P[k + 3] + m * square(g)
    if j == s.topology[0, TIP_BODY] + 1:
        E = s.vectors[0, TIP_AT]
        J += mass * (P[PAYLOAD + 1] * P[PAYLOAD + 1] + P[PAYLOAD + 2] * P[PAYLOAD + 2]) / 12.0 + mass * square(E)
        m, mg = m + mass, mg + mass * E
    w, d = s.numbers[j, OMEGA], s.vectors[j, PRODUCT]
    s.numbers[j, MASS], s.vectors[j, MOMENT], s.numbers[j, INERTIA] = m, mg, J
    s.vectors[j, FORCE], s.numbers[j, COUPLE] = w * w * mg - m * d, -cross(mg, d)


@inline
def collect(j, s):
    """Add what joint j carries to what the joint of its carrier carries: T^T."""
    c = carrier(j, s)
    if c > 0:
        s.numbers[c, MASS] += s.numbers[j, MASS]
        s.vectors[c, MOMENT] += s.vectors[j, MOMENT]
        s.numbers[c, INERTIA] += s.numbers[j, INERTIA]
        s.vectors[c, FORCE] += s.vectors[j, FORCE]
        s.numbers[c, COUPLE] += s.numbers[j, COUPLE]


@inline
def add_row(j, s):
    """Add row j of the tree's mass matrix R_d^T T^T M T R_d (9), on both sides of its diagonal, to the rows of its
    product with R_z.
    """
    n, m, mg = s.topology[0, CYLINDERS], s.numbers[j, MASS], s.vectors[j, MOMENT]
    b = lever(j, 0j, s)
    momentum, spin = m * b, cross(mg, b)
    if s.topology[j, KIND] != SLIDES:
        momentum, spin = momentum + turned(mg), spin + s.numbers[j, INERTIA]
    add_rate(j, BY + n, j, joint_force(j, momentum, spin, s), s)
    k = carrier(j, s)
    while k > 0:
        entry = joint_force(k, momentum, spin, s)
        add_rate(j, BY + n, k, entry, s)
        add_rate(k, BY + n, j, entry, s)
        k = carrier(k, s)


@inline
def reduce(j, g, s):
    """Add what joint j contributes to R_z^T (.) R_z and to the generalised forces of weights and velocities (12); g is
    gravity.
    """
    n, i = s.topology[0, CYLINDERS], s.topology[j, COORDINATE]
    weight = joint_force(j, s.numbers[j, MASS] * g, cross(s.vectors[j, MOMENT], g), s)
    velocity = joint_force(j, s.vectors[j, FORCE], s.numbers[j, COUPLE], s)
    if i >= 0:
        s.general[WEIGHT, i] += weight
        s.general[VELOCITY, i] += velocity
        for k in range(i + 1):
            s.general[MATRIX + i, k] += s.numbers[j, BY + n + k]
        return
    for i in range(n):
        by = s.numbers[j, BY + i]
        s.general[WEIGHT, i] += by * weight
        s.general[VELOCITY, i] += by * velocity - s.numbers[j, BY + n + i] * s.numbers[j, FOLLOWED]
        for k in range(i + 1):
            s.general[MATRIX + i, k] += by * s.numbers[j, BY + n + k]


@inline
def gather(mass, g, P, s):
    """Write the mass matrix M and the generalised forces of weights and velocities on the independent coordinates.

    First step: the bodies as Cartesian ones, then collected along the paths. Second step: dependent joints follow.
    """
    n = s.topology[0, CYLINDERS]
    for i in range(n):
        s.general[WEIGHT, i], s.general[VELOCITY, i] = 0.0, 0.0
        for k in range(i + 1):
            s.general[MATRIX + i, k] = 0.0
    for j in range(1, 1 + s.topology[0, BODIES]):
        weigh(j, mass, P, s)
        for i in range(n):
            s.numbers[j, BY + n + i] = 0.0
    for j in range(s.topology[0, BODIES], 0, -1):
        add_row(j, s)
        reduce(j, g, s)
        collect(j, s)


@inline
def add_swing(mass, damping, g, product, theta, dtheta, s):
    """Add what a payload on a pendulum does to the balance, and write its own balance, L theta'' = own - across . z''.

    The payload is a point mass on a massless rod that hangs from E. Its angle (absolute, 0 = straight down) has the
    inertia m L^2 and is eliminated from the system. The rod can only pull or push along itself, so what E feels is the
    mass along the rod; the damping is a drag on the mass, -d theta' / L across the rod, whose moment about E is -d
    theta'.

    product: what accelerates E while the coordinates have no acceleration.
    """
    n, tip, length = s.topology[0, CYLINDERS], s.topology.shape[0], s.numbers[0, PENDULUM]
    across, down = turn(theta), complex(math.sin(theta), -math.cos(theta))
    product -= length * dtheta * dtheta * down  # of the mass
    drag = damping * dtheta / length
    s.numbers[0, OWN] = dot(g - product, across) - (drag / mass if mass > 0.0 else 0.0)
    for i in range(n):
        J = complex(s.numbers[tip, BY + i], s.numbers[tip + 1, BY + i])
        s.general[ACROSS, i], s.general[DOWN, i] = dot(J, across), dot(J, down)
        s.general[WEIGHT, i] += s.general[DOWN, i] * mass * dot(g, down)
        s.general[VELOCITY, i] -= s.general[DOWN, i] * mass * dot(product, down)
        for k in range(i + 1):
            s.general[MATRIX + i, k] += mass * s.general[DOWN, i] * s.general[DOWN, k]


@inline
def factorise(s):
    """Write V above the diagonal of M, and 1 over its diagonal to PIVOT, with M = V^T diag(PIVOT) V."""
    for j in range(s.topology[0, CYLINDERS]):
        for i in range(j, s.topology[0, CYLINDERS]):
            entry = s.general[MATRIX + i, j]
            for k in range(j):
                entry -= s.general[MATRIX + k, i] * s.general[MATRIX + k, j] * s.general[PIVOT, k]
            if i == j:
                s.general[PIVOT, j] = 1.0 / entry
            else:
                s.general[MATRIX + j, i] = entry


@inline
def solve(s):
    """Replace what stands in ACCELERATION, the sum of all forces, by the accelerations."""
    n = s.topology[0, CYLINDERS]
    for i in range(n):
        force = s.general[ACCELERATION, i]
        for k in range(i):
            force -= s.general[MATRIX + k, i] * s.general[ACCELERATION, k]
        s.general[ACCELERATION, i] = force * s.general[PIVOT, i]
    for i in range(n - 2, -1, -1):
        force = 0.0
        for k in range(i + 1, n):
            force += s.general[MATRIX + i, k] * s.general[ACCELERATION, k]
        s.general[ACCELERATION, i] -= force * s.general[PIVOT, i]


@part
def mechanics(x, t, P, E, s):
    """Write everything that does not depend on pressures and inputs at a state x that is placed: motions, M, weights,
    velocities.
    """
    move(x, s)
    move_lines(s)
    first = 4 * s.topology[0, CYLINDERS]
    gx, gy = hooks.gravity(E, 0.0, -P[GRAVITY])
    g, mass, product = complex(gx, gy), 0.0, 0j
    s.numbers[0, PENDULUM] = 0.0
    if s.topology[0, TIP_BODY] < 0:
        gather(0.0, g, P, s)
    else:
        s.vectors[0, TIP_AT] = placed(s.topology[0, TIP_BODY] + 1, s.topology[0, TIP_POINT], P, s)
        product, mass = move_tip(s), hooks.payload_mass(E, t, P[PAYLOAD])
        length, damping = hooks.pendulum(E)
        if length > 0.0 and x.shape[0] > first:
            s.numbers[0, PENDULUM] = length
            gather(0.0, g, P, s)
            add_swing(mass, damping, g, product, x[first], x[first + 1], s)
        else:
            gather(mass, g, P, s)
    factorise(s)


# --------------------------------------------------------------------------------------------- hydraulics


@inline
def root_flow(dp, laminar):
    """q(dp) of (15): sgn(dp) sqrt|dp|, and linear below the laminar pressure."""
    if dp > laminar:
        return math.sqrt(dp)
    if dp < -laminar:
        return -math.sqrt(-dp)
    return dp / math.sqrt(laminar)


@inline
def first_cylinder(s):
    return 1 + s.topology[0, BODIES] + s.topology[0, LOOPS]


@part
def pump_edge(c, pp, P, E, s):
    """Flow from the pump through valve c: into the piston side where it is open that way (u > 0), or into the rod
    side.
    """
    k, i = first_cylinder(s) + c, VALVE + N_VALVE * c
    u = s.numbers[k, OPENING]
    own, edge = (
        (s.numbers[k, OIL_A + PRESSURE], P[i + PUMP_TO_A])
        if u > 0.0
        else (s.numbers[k, OIL_B + PRESSURE], P[i + PUMP_TO_B])
    )
    drop = hooks.supply_drop(E, c, pp - own)
    return hooks.supply_gain(E, c, drop) * P[i] * edge * abs(u) * root_flow(drop, P[LAMINAR])


@part
def tank_edge(c, pt, P, E, s):
    """Flow to the tank through valve c: out of the rod side where it is open that way (u > 0), or out of the piston
    side.
    """
    k, i = first_cylinder(s) + c, VALVE + N_VALVE * c
    u, pa, pb = s.numbers[k, OPENING], s.numbers[k, OIL_A + PRESSURE], s.numbers[k, OIL_B + PRESSURE]
    own, other, edge, side = (pb, pa, P[i + B_TO_TANK], 1) if u > 0.0 else (pa, pb, P[i + A_TO_TANK], 0)
    gain = hooks.return_gain(E, c, own, other, 1.0 if s.topology[k, LOADED] == side else 0.0, own - pt)
    return gain * P[i] * edge * abs(u) * root_flow(own - pt, P[LAMINAR])


@part
def pump_gap(p, nominal, P, E, s):
    """How far the pressure p is above what the supply gives at the flow that p drives; the flows remain in the
    sheet.
    """
    first, total = first_cylinder(s), 0.0
    for c in range(s.topology[0, CYLINDERS]):
        s.numbers[first + c, DRAWN] = pump_edge(c, p, P, E, s)
        total += s.numbers[first + c, DRAWN]
    return p - hooks.supply_pressure(E, nominal, total)


@part
def tank_gap(p, nominal, P, E, s):
    first, total = first_cylinder(s), 0.0
    for c in range(s.topology[0, CYLINDERS]):
        s.numbers[first + c, RETURNED] = tank_edge(c, p, P, E, s)
        total += s.numbers[first + c, RETURNED]
    return p - hooks.tank_pressure(E, nominal, total)


def _balanced(gap, doc):
    """Return a solver of gap(p) = 0 by regula falsi (Illinois), begun at the pressure without any flow; what it returns
    it tried last.
    """

    @part
    def balanced(nominal, P, E, s):
        a, fa = nominal, gap(nominal, nominal, P, E, s)
        if fa == 0.0:
            return nominal
        # The flow weakens with the drop it causes, so the root lies between the nominal pressure and one full drop.
        b = a - fa
        fb = gap(b, nominal, P, E, s)
        tolerance = 4e-16 * max(abs(nominal), 1e5)
        for _ in range(100):
            if abs(fb) <= tolerance or abs(b - a) <= tolerance:
                return b
            p = b - fb * (b - a) / (fb - fa)
            f = gap(p, nominal, P, E, s)
            if f * fb < 0.0:
                a, fa = b, fb
            else:
                fa *= 0.5
            b, fb = p, f
        return b

    balanced.__doc__ = doc
    return balanced


pump_pressure = _balanced(pump_gap, "Return the pressure at the valves' pump ports, in balance with the flow drawn.")
tank_pressure = _balanced(tank_gap, "Return the pressure at the valves' tank ports, in balance with the flow returned.")


@inline
def fluid(P, E):
    """Return the Fluid of a machine."""
    zero = P[REFERENCE] * P[AIR]
    share, gas = hooks.free_gas(E, P[VAPOUR])
    return Fluid(
        1.0 / P[OIL] + 1.0 / P[STEEL], 1.0 / P[HOSE] - 1.0 / P[STEEL], P[VAPOUR] - zero, zero, share, gas
    )  # fmt: skip


@inline
def pressed_oil(y, pressed, share, gas, Al, Vh, f):
    """Return the Oil at a pressure y that is not below vapour pressure; pressed = exp(y/B) - 1, share and gas: see
    `oil_at`.

    Without gas N - V is summed up apart, so that pressure and amount follow from each other to the last digit.
    """
    V, wall = Al + Vh, Vh * f.wall
    if share == 0.0:
        k = 1.0 + pressed
        return Oil(y, y, V + (V + wall / f.soft) * pressed, V * k * f.soft + wall * k, k, k)
    k = (1.0 + pressed) * math.exp(-share)
    return Oil(y, y, V * k + wall / f.soft * pressed, V * k * (f.soft + gas) + wall * (1.0 + pressed), k, k)


@inline
def pulled_oil(y, empty, Al, Vh, f):
    """Return the Oil at a state y below vapour pressure, `empty` being the Oil there."""
    k, soft = empty.density, (Al + Vh) * f.soft + Vh * f.wall
    pull = k * (y - f.least)
    return Oil(y, f.least, empty.amount + pull * soft, k * soft, k + pull * f.soft, k)


@part
def oil_at(y, Al, Vh, f, E):
    """Return the Oil of a chamber of volume Al with a hose of volume Vh, where the state says y for its pressure.

    (34) with (14) and (41) is an exact differential up to the factor k: dN = k Q dt = N_p dp + N_V dV with

        N = V k + Vh (1/Bh - 1/Bc) (exp(p/B) - 1) B,      k = exp(p/B - x),   1/B = 1/Bo + 1/Bc,   V = Al + Vh,

    x the free gas as a share of the oil. N is the volume that the oil had at the pressure 0, so it changes by flows
    alone. Below vapour pressure the oil gives way no further: y goes on falling as if oil could be pulled, while a void
    opens.
    """
    p = max(y, f.least)
    share, gas = hooks.free_gas(E, p + f.zero)
    there = pressed_oil(p, math.expm1(p * f.soft), share, gas, Al, Vh, f)
    return there if y >= f.least else pulled_oil(y, there, Al, Vh, f)


@part
def oil_of(N, Al, Vh, guess, f, E):
    """Return the Oil of a chamber that holds the amount N: the inverse of `oil_at`, in closed form where there is no
    gas.

    With gas N(p) is concave, so that Newton's method climbs to the root from below without a bracket.
    """
    if f.share == 0.0:
        pressed = (N - (Al + Vh)) / (Al + Vh + Vh * f.wall / f.soft)
        y = math.log1p(pressed) / f.soft
        if y >= f.least:
            return pressed_oil(y, pressed, 0.0, 0.0, Al, Vh, f)
    empty = pressed_oil(f.least, math.expm1(f.least * f.soft), f.share, f.gas, Al, Vh, f)
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


@part
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


@part
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


@inline
def piston_areas(i, P):
    """Return the areas of piston side and rod side of the cylinder whose block begins at i."""
    Aa = 0.25 * math.pi * P[i + BORE] * P[i + BORE]
    return Aa, Aa - 0.25 * math.pi * P[i + ROD] * P[i + ROD]


@part
def friction(P, i, v):
    """Friction force (19) of the cylinder whose block begins at i, with the sign of v."""
    x = v / P[i + STRIBECK]
    hump = 0.25 * x * x + 0.75
    stribeck = (P[i + STATIC] - P[i + COULOMB]) * x / (hump * hump)
    return P[i + COULOMB] * math.tanh(4.0 * x) + stribeck + P[i + VISCOUS] * v * TANH4


@inline
def keep(k, first, o, s):
    """Write the Oil of a chamber to its place in row k."""
    s.numbers[k, first], s.numbers[k, first + PRESSURE], s.numbers[k, first + AMOUNT] = o.y, o.pressure, o.amount
    s.numbers[k, first + BY_PRESSURE], s.numbers[k, first + BY_VOLUME] = o.by_pressure, o.by_volume
    s.numbers[k, first + DENSITY] = o.density


@part
def read_pressures(x, P, E, s):
    """Write the oil of all chambers at the pressures of a state x that is placed."""
    first, n, f = first_cylinder(s), s.topology[0, CYLINDERS], fluid(P, E)
    for c in range(n):
        ya, yb = x[2 * n + 2 * c], x[2 * n + 2 * c + 1]
        s.numbers[first + c, LA], a, b = chambers_at(c, s.numbers[first + c, LENGTH], ya, yb, f, P, E)
        keep(first + c, OIL_A, a, s)
        keep(first + c, OIL_B, b, s)


@part
def read_amounts(x, N, P, E, s):
    """Write the oil of all chambers that hold the amounts N (2n,) at a state x that is placed, and its pressures to
    x.
    """
    first, n, f = first_cylinder(s), s.topology[0, CYLINDERS], fluid(P, E)
    for c in range(n):
        i = 2 * n + 2 * c
        la, a, b = chambers_of(c, s.numbers[first + c, LENGTH], N[2 * c], N[2 * c + 1], x[i], x[i + 1], f, P, E)
        s.numbers[first + c, LA] = la
        keep(first + c, OIL_A, a, s)
        keep(first + c, OIL_B, b, s)
        x[i], x[i + 1] = a.y, b.y


@inline
def cylinder(c, flow_a, flow_b, P, E, s):
    """Write all hydraulic quantities of cylinder c, (17)-(19), (34), (37), (38).

    flow_a, flow_b: flows into the chambers that no law explains (disturbances). Air presses on the rod's cross-section.

    With a spring of compliance k' in series the rate of the hydraulic length follows from both chambers' pressure
    rates, which depend on it linearly, so it is found without iteration. A chamber that holds a void has a constant
    pressure.
    """
    k, i = first_cylinder(s) + c, CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    v, pa, pb = s.numbers[k, SPEED_S], s.numbers[k, OIL_A + PRESSURE], s.numbers[k, OIL_B + PRESSURE]
    pump, tank = s.numbers[k, DRAWN], s.numbers[k, RETURNED]
    Qa, Qb = (pump, tank) if s.numbers[k, OPENING] > 0.0 else (-tank, -pump)
    outside = (1.0 - P[REFERENCE]) * P[AIR]
    leak_a, leak_b = hooks.leakage(E, c, pa - outside, pb - outside)
    leak_a, leak_b = leak_a + flow_a, leak_b + flow_b
    Ga, Gb = s.numbers[k, OIL_A + DENSITY] * (Qa + leak_a), s.numbers[k, OIL_B + DENSITY] * (leak_b - Qb)
    compliance = hooks.series_compliance(E, c)
    if compliance != 0.0:
        least = P[VAPOUR] - P[REFERENCE] * P[AIR]
        ka = 1.0 / s.numbers[k, OIL_A + BY_PRESSURE] if s.numbers[k, OIL_A] > least else 0.0
        kb = 1.0 / s.numbers[k, OIL_B + BY_PRESSURE] if s.numbers[k, OIL_B] > least else 0.0
        v += compliance * (Aa * ka * Ga - Ab * kb * Gb)
        v /= 1.0 + compliance * (
            Aa * Aa * ka * s.numbers[k, OIL_A + BY_VOLUME] + Ab * Ab * kb * s.numbers[k, OIL_B + BY_VOLUME]
        )
    la = s.numbers[k, LA]
    Fmu, air = friction(P, i, v), outside * (Aa - Ab)
    s.numbers[k, F] = pa * Aa - pb * Ab - air - Fmu + hooks.cylinder_force(E, c, v, pa, pb, la, P[i + RANGE] - la)
    s.numbers[k, QA], s.numbers[k, QB], s.numbers[k, LEAK_A], s.numbers[k, LEAK_B] = Qa, Qb, leak_a, leak_b
    s.numbers[k, FMU], s.numbers[k, SPEED_LA], s.numbers[k, GA], s.numbers[k, GB] = Fmu, v, Ga, Gb


# -------------------------------------------------------------------------------------------- all together


@inline
def supply(w, k, P, s):
    """Measured pump (k = 0) or tank (k = 1) pressure, or the machine's own where it is not measured."""
    given = w[s.topology[0, CYLINDERS] + k]
    return P[SUPPLY + k] if math.isnan(given) else given


@inline
def disturbance(w, k, s):
    """Unknown input k of [torques (n), force x, force y at the payload, flows into the chambers (2n)]; 0 where w has
    but n + 2 entries.
    """
    n = s.topology[0, CYLINDERS]
    return w[n + 2 + k] if w.shape[0] > n + 2 else 0.0


@inline
def add_joint_forces(x, w, t, E, s):
    """Write the generalised forces Qj: on the joints themselves, and of the force on the payload's point."""
    n, tip, force = s.topology[0, CYLINDERS], s.topology.shape[0], 0j
    if s.topology[0, TIP_BODY] >= 0:
        force = complex(disturbance(w, n, s), hooks.tip_force(E, t) + disturbance(w, n + 1, s))
    for i in range(n):
        by = complex(s.numbers[tip, BY + i], s.numbers[tip + 1, BY + i])
        s.general[JOINTS, i] = dot(by, force) + hooks.joint_torque(E, i, x[n + i], x[i]) + disturbance(w, i, s)


@part
def balance(x, w, t, P, E, s):
    """Write the rest of M z'' = Qg + Qv + Qh + Qj (12) and of (34), coupled as in (20), where mechanics and oil are in
    the sheet.
    """
    first, n = first_cylinder(s), s.topology[0, CYLINDERS]
    for c in range(n):
        s.numbers[first + c, OPENING] = hooks.opening(E, c, w[c])
    s.numbers[0, PUMP] = pump_pressure(supply(w, 0, P, s), P, E, s)
    s.numbers[0, TANK] = tank_pressure(supply(w, 1, P, s), P, E, s)
    for c in range(n):
        cylinder(c, disturbance(w, n + 2 + 2 * c, s), disturbance(w, n + 3 + 2 * c, s), P, E, s)
    add_joint_forces(x, w, t, E, s)
    for i in range(n):
        force = 0.0
        for c in range(n):
            force += s.numbers[first + c, F] * s.numbers[first + c, BY + i]
        s.general[HYDRAULIC, i] = force
        s.general[ACCELERATION, i] = s.general[WEIGHT, i] + s.general[VELOCITY, i] + force + s.general[JOINTS, i]
    solve(s)
    s.numbers[0, SWINGING] = 0.0
    if s.numbers[0, PENDULUM] > 0.0:
        own = s.numbers[0, OWN]
        for i in range(n):
            own -= s.general[ACROSS, i] * s.general[ACCELERATION, i]
        s.numbers[0, SWINGING] = own / s.numbers[0, PENDULUM]


@part
def at_pressures(x, w, t, P, E, s):
    """Write all terms at a state x (nx,)."""
    place(x, P, s)
    mechanics(x, t, P, E, s)
    read_pressures(x, P, E, s)
    balance(x, w, t, P, E, s)


@part
def at_amounts(x, N, w, t, P, E, s):
    """Write the same for amounts of oil N (2n,) instead of the pressures in x, which are replaced by what follows from
    N.
    """
    place(x, P, s)
    mechanics(x, t, P, E, s)
    read_amounts(x, N, P, E, s)
    balance(x, w, t, P, E, s)


@part
def settle_pressures(x, N, P, E, s):
    """Write the pressures that follow from the amounts of oil N (2n,) at the pose in x to x."""
    place(x, P, s)
    read_amounts(x, N, P, E, s)


@inline
def rates(x, s, out):
    """Write the rates of [z z' N (theta theta')] to out: amounts of oil in the place of pressures."""
    first, n = first_cylinder(s), s.topology[0, CYLINDERS]
    for i in range(n):
        out[i], out[n + i] = x[n + i], s.general[ACCELERATION, i]
        out[2 * n + 2 * i], out[2 * n + 2 * i + 1] = s.numbers[first + i, GA], s.numbers[first + i, GB]
    if x.shape[0] > 4 * n:
        swings = s.numbers[0, PENDULUM] > 0.0
        out[4 * n], out[4 * n + 1] = (x[4 * n + 1], s.numbers[0, SWINGING]) if swings else (0.0, 0.0)


@inline
def amounts(s, N):
    """Write the amounts of oil in all chambers to N."""
    first = first_cylinder(s)
    for c in range(s.topology[0, CYLINDERS]):
        N[2 * c], N[2 * c + 1] = s.numbers[first + c, OIL_A + AMOUNT], s.numbers[first + c, OIL_B + AMOUNT]


@inner
def at_rest(x, P, E, s):
    """Write the terms at a state x of which only the coordinates count, without motion, at time 0: weights, the
    joints' torques, and the force on the payload's point.
    """
    n = s.topology[0, CYLINDERS]
    still = np.zeros(4 * n)
    still[:n] = x[:n]
    place(still, P, s)
    mechanics(still, 0.0, P, E, s)
    tip = s.topology.shape[0]
    for i in range(n):
        s.general[JOINTS, i] = hooks.tip_force(E, 0.0) * s.numbers[tip + 1, BY + i] + hooks.joint_torque(
            E, i, 0.0, x[i]
        )


@part
def held_pressures(c, s, F, less_loaded, P, E):
    """Return pa, pb of cylinder c that give the force F at rest, the lower of the two being `less_loaded`.

    Forces that act on the piston at rest (an end stop) depend on the pressures only through a spring in series:
    repeated until nothing changes.
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


@part
def chamber_lengths(x, P, E, s, out):
    """Write the lengths of all chambers (2n,) at a state x to out; negative: beyond the stroke's end."""
    place(x, P, s)
    read_pressures(x, P, E, s)
    first = first_cylinder(s)
    for c in range(s.topology[0, CYLINDERS]):
        la = s.numbers[first + c, LA]
        out[2 * c], out[2 * c + 1] = la, P[CYLINDER + N_CYLINDER * c + RANGE] - la
