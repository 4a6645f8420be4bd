"""A machine's equations by the double-step semi-recursive method and lumped fluids, compiled.

Written from the paper, (1)-(20) and (34)-(41), for planar bodies: a tree of turning and sliding joints, loops cut at a
joint. A point or a force in the plane is one complex number x + iy, so that turning a vector by an angle is a product
with exp(i angle). Products, for vectors a and b:

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
`Sheet`. `mechanics` writes what the bodies do to it, `hydraulics` what the oil does; here both come together.
"""

from __future__ import annotations

import math

import numpy as np

from crane_exudyn.compiled import lean, njit
from crane_exudyn.effects import hooks
from crane_exudyn.machine import CYLINDERS, TIP_BODY

from .hydraulics import cylinder, pump_pressure, read_amounts, read_pressures, tank_pressure
from .mechanics import dot, mechanics, place, solve
from .sheet import (
    ACCELERATION,
    ACROSS,
    AMOUNT,
    BY,
    CYLINDER,
    GA,
    GB,
    HYDRAULIC,
    JOINTS,
    LA,
    N_CYLINDER,
    OIL_A,
    OIL_B,
    OPENING,
    OWN,
    PENDULUM,
    PUMP,
    RANGE,
    SUPPLY,
    SWINGING,
    TANK,
    VELOCITY,
    WEIGHT,
    F,
    first_cylinder,
    inline,
)


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


@lean
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


@lean
def at_pressures(x, w, t, P, E, s):
    """Write all terms at a state x (nx,)."""
    place(x, P, s)
    mechanics(x, t, P, E, s)
    read_pressures(x, P, E, s)
    balance(x, w, t, P, E, s)


@lean
def at_amounts(x, N, w, t, P, E, s):
    """Write the same for amounts of oil N (2n,) instead of the pressures in x, which are replaced by what follows from
    N.
    """
    place(x, P, s)
    mechanics(x, t, P, E, s)
    read_amounts(x, N, P, E, s)
    balance(x, w, t, P, E, s)


@lean
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


@njit
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


@lean
def chamber_lengths(x, P, E, s, out):
    """Write the lengths of all chambers (2n,) at a state x to out; negative: beyond the stroke's end."""
    place(x, P, s)
    read_pressures(x, P, E, s)
    first = first_cylinder(s)
    for c in range(s.topology[0, CYLINDERS]):
        la = s.numbers[first + c, LA]
        out[2 * c], out[2 * c + 1] = la, P[CYLINDER + N_CYLINDER * c + RANGE] - la
