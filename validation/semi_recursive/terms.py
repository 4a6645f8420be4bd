"""Every term of the balances by name, for cross-checks and for laying beside residuals."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.machine import BODIES, CARRIER, COORDINATE, CYLINDERS, GROUND, Machine

from .equations import at_pressures
from .hydraulics import piston_areas
from .mechanics import placed
from .sheet import (
    ACCELERATION,
    AMOUNT,
    BY,
    BY_PRESSURE,
    BY_VOLUME,
    CYLINDER,
    DENSITY,
    FMU,
    GA,
    HOSE_A,
    HYDRAULIC,
    JOINTS,
    LA,
    LEAK_A,
    LENGTH,
    MATRIX,
    N_CYLINDER,
    OIL_A,
    OIL_B,
    PUMP,
    QA,
    RANGE,
    SPEED_LA,
    SPEED_S,
    SWINGING,
    TANK,
    TURN,
    VELOCITY,
    WEIGHT,
    F,
    first_cylinder,
    sheet,
)


def term_names(machine: Machine) -> tuple[str, ...]:
    """Return the names of the columns of `terms`."""
    z, n = machine.independent, len(machine.cylinders)
    numbered = [f"{what}{{}}" for what in ("Q", "leak", "V", "Be", "l", "N")]
    return (
        *(f"{axis}_{point}" for point in machine.point_names for axis in "xy"),
        *(f"phi_{body}" for body in machine.bodies),
        *_dependent(machine),
        *(f"{d}{c.length}" for c in machine.cylinders for d in ("", "d")),
        *("pp", "pt"),
        *(f"{what}{c + 1}" for c in range(n) for what in ("Fmu", "F", "v_h")),
        *(name.format(k + 1) for k in range(2 * n) for name in numbered),
        *(f"d{chamber}" for c in machine.cylinders for chamber in c.chambers),
        *(f"M_{a}_{b}" for i, a in enumerate(z) for b in z[i:]),
        *(f"{what}{name}" for name in z for what in ("Qg_", "Qv_", "Qh_", "Qj_", "dd")),
        "ddtheta",
    )


def _dependent(machine: Machine) -> Iterator[str]:
    for body in machine.bodies:
        if body in machine.dependent:
            name = machine.carriers[body].coordinate
            yield name
            yield from (f"d{name}_d{z}" for z in machine.independent)


def point_rows(machine: Machine) -> np.ndarray:
    """Return the body (row of the topology) and the place in P of each point (points, 2)."""
    row = {name: k for k, name in enumerate((GROUND, *machine.bodies))}
    return np.array([(row[body], machine.index[f"{p}.x"]) for p, body in machine.points.items()], dtype=np.int64)


@njit
def _angle(e):
    return math.atan2(e.imag, e.real)


@njit
def _fill_motion(P, points, s, out, k):
    """Write points, angles and dependent coordinates to out from place k on; return the place behind them."""
    for i in range(points.shape[0]):
        r = placed(points[i, 0], points[i, 1], P, s)
        out[k], out[k + 1], k = r.real, r.imag, k + 2
    for j in range(1, 1 + s.topology[0, BODIES]):
        out[k], k = _angle(s.vectors[j, TURN]), k + 1
    for j in range(1, 1 + s.topology[0, BODIES]):
        if s.topology[j, COORDINATE] < 0:
            carrier = s.topology[j, CARRIER] + 1
            out[k], k = _angle(s.vectors[j, TURN] * s.vectors[carrier, TURN].conjugate()), k + 1
            for i in range(s.topology[0, CYLINDERS]):
                out[k], k = s.numbers[j, BY + i], k + 1
    return k


@njit
def _fill_cylinders(P, s, out, k):
    first, n = first_cylinder(s), s.topology[0, CYLINDERS]
    for row in range(first, first + n):
        out[k], out[k + 1], k = s.numbers[row, LENGTH], s.numbers[row, SPEED_S], k + 2
    out[k], out[k + 1], k = s.numbers[0, PUMP], s.numbers[0, TANK], k + 2
    for row in range(first, first + n):
        for what in (FMU, F, SPEED_LA):
            out[k], k = s.numbers[row, what], k + 1
    for c in range(n):
        for side in (0, 1):
            k = _fill_chamber(c, side, P, s, out, k)
    for c in range(n):
        for side in (0, 1):
            out[k], k = pressure_rate(c, side, P, s), k + 1
    return k


@njit
def _fill_chamber(c, side, P, s, out, k):
    row, i, oil = first_cylinder(s) + c, CYLINDER + N_CYLINDER * c, OIL_A if side == 0 else OIL_B
    length = s.numbers[row, LA] if side == 0 else P[i + RANGE] - s.numbers[row, LA]
    V = P[i + HOSE_A + side] + piston_areas(i, P)[side] * length
    out[k], out[k + 1], out[k + 2] = s.numbers[row, QA + side], s.numbers[row, LEAK_A + side], V
    out[k + 3] = s.numbers[row, oil + DENSITY] * V / s.numbers[row, oil + BY_PRESSURE]  # (14), (41): V dp = Be dN / k
    out[k + 4], out[k + 5] = length, s.numbers[row, oil + AMOUNT]
    return k + 6


@njit
def pressure_rate(c, side, P, s):
    """Return the rate of a state's pressure, (34): N_p y' = G - N_V A v, A v being the growth of the volume."""
    row, oil = first_cylinder(s) + c, OIL_A if side == 0 else OIL_B
    growth = piston_areas(CYLINDER + N_CYLINDER * c, P)[side] * s.numbers[row, SPEED_LA] * (1.0 - 2.0 * side)
    return (s.numbers[row, GA + side] - s.numbers[row, oil + BY_VOLUME] * growth) / s.numbers[row, oil + BY_PRESSURE]


@njit
def _fill_balance(s, out, k):
    n = s.topology[0, CYLINDERS]
    for i in range(n):
        for j in range(i, n):
            out[k], k = s.general[MATRIX + j, i], k + 1
    for i in range(n):
        for what in (WEIGHT, VELOCITY, HYDRAULIC, JOINTS, ACCELERATION):
            out[k], k = s.general[what, i], k + 1
    out[k] = s.numbers[0, SWINGING]


@njit
def terms(X, W, time, P, E, topology, points, count):
    """Return all terms (N, count) at states X (N, nx), inputs W (N, n + 2) and times (N,); points: those of
    `point_rows`.

    Forces on the joints: M zdd = Qg + Qv + Qh + Qj, where Qh holds the cylinder forces with their friction and
    Qj the joints' own torques and the force on the payload's point. Be are effective bulk moduli, v_h hydraulic
    cylinder rates. N are amounts of oil; pressures and their rates are those of the state, which go on below vapour
    pressure where a void opens.
    """
    out, s = np.empty((X.shape[0], count)), sheet(topology)
    for i in range(X.shape[0]):
        at_pressures(X[i], W[i], time[i], P, E, s)
        k = _fill_motion(P, points, s, out[i], 0)
        k = _fill_cylinders(P, s, out[i], k)
        _fill_balance(s, out[i], k)
    return out
