"""The mechanism: positions, velocities and the dynamics of the tree, (2)-(12), and the cylinders' lines, (35), (36);
how they are written down says `equations`.
"""

from __future__ import annotations

import math

from crane_exudyn.compiled import lean
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

from .sheet import (
    ACCELERATION,
    ACROSS,
    ALONG,
    AXIS,
    BASE_AT,
    BY,
    COUPLE,
    CUT,
    DOWN,
    FOLLOWED,
    FORCE,
    FRAME,
    GRAVITY,
    INERTIA,
    LENGTH,
    MASS,
    MATRIX,
    MOMENT,
    NESTED,
    OMEGA,
    OWN,
    PAYLOAD,
    PENDULUM,
    PIVOT,
    PRODUCT,
    ROD_AT,
    SPEED,
    SPEED_S,
    TIP_AT,
    TURN,
    VELOCITY,
    WEIGHT,
    inline,
)

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


@lean
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


@lean
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
