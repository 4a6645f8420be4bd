"""Where everything stands: the places in P, and the sheet that holds all terms of one state of a machine."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from crane_exudyn import parameters as par
from crane_exudyn.compiled import lean, njit
from crane_exudyn.machine import BODIES, CYLINDERS, LOOPS

#: a part that becomes one with what calls it
inline = lean(forceinline=True)

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


@njit
def sheet(topology):
    """Return an empty Sheet of a machine."""
    rows, n = topology.shape[0], topology[0, CYLINDERS]
    return Sheet(
        topology, np.zeros((rows, 7), np.complex128), np.zeros((rows + 2, BY + 2 * n)), np.zeros((MATRIX + n, n))
    )  # fmt: skip


@inline
def first_cylinder(s):
    return 1 + s.topology[0, BODIES] + s.topology[0, LOOPS]
