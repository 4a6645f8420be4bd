"""Planar geometry of the crane: loop closure, points, cylinder lengths and rates, vectorised over states.

Frames and signs are those of the model sheet: x forward, y up, origin at the foot of the pillar, angles
counter-clockwise. z1 is the lift boom against the horizontal, z4 the outer boom against the lift boom; z2 (bracket 1
against the lift boom) and z3 (bracket 2 against bracket 1) follow from the loop A-B-C-D. ::

            F'                      C
            |        bracket 1    o   o   bracket 2          C lies above the line B-D
      O o===G=========H==========o B    o D
        |  /                      A o====================o E  payload
      F o                            outer boom

Two levels of functions: scalar ones compiled for use in other compiled code, and array ones that check what they are given.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from .compiled import njit
from .crane import Crane
from .errors import CraneError
from .parameters import POINT, POINT_NAMES

# places of the points in P, as compile-time constants
O, F, G, H, B, A, C, D_BRACKET, D, E = (POINT + 2 * k for k in range(len(POINT_NAMES)))
#: body whose frame a point of POINT_NAMES is given in: -1 pillar, then the order of parameters.BODIES
_FRAME = (-1, -1, 0, 0, 0, 0, 1, 2, 3, 3)


@njit
def loop_angles(P, z4):
    """Return (z2, z3, reachable) in rad for the branch with C above the line B-D.

    Seen from the lift boom, D turns about A with z4; C closes the triangle B-C-D with the lengths of the two brackets.
    """
    dx = P[A] + math.cos(z4) * P[D] - math.sin(z4) * P[D + 1] - P[B]
    dy = P[A + 1] + math.sin(z4) * P[D] + math.cos(z4) * P[D + 1] - P[B + 1]
    span2 = dx * dx + dy * dy
    r2 = math.hypot(P[C], P[C + 1])
    r3 = math.hypot(P[D_BRACKET], P[D_BRACKET + 1])
    # cosine of the turn from B->C to C->D; C on the left of B->D makes it a turn to the right
    cos_turn = (span2 - r2 * r2 - r3 * r3) / (2.0 * r2 * r3)
    if not abs(cos_turn) < 1.0:
        return math.nan, math.nan, False
    turn = -math.acos(cos_turn)
    at_b = math.atan2(-r3 * math.sin(turn), r2 + r3 * cos_turn)
    in_1 = math.atan2(P[C + 1], P[C])
    in_2 = math.atan2(P[D_BRACKET + 1], P[D_BRACKET])
    z2 = math.atan2(dy, dx) + at_b - in_1
    return z2, turn + in_1 - in_2, True


@njit
def loop_rates(P, z2, z3, z4):
    """Return (dz2/dz4, dz3/dz4): the loop at velocity level; z2 and z3 do not depend on z1."""
    c2, s2, c23, s23 = math.cos(z2), math.sin(z2), math.cos(z2 + z3), math.sin(z2 + z3)
    bx, by = c2 * P[C] - s2 * P[C + 1], s2 * P[C] + c2 * P[C + 1]
    cx, cy = c23 * P[D_BRACKET] - s23 * P[D_BRACKET + 1], s23 * P[D_BRACKET] + c23 * P[D_BRACKET + 1]
    ax = math.cos(z4) * P[D] - math.sin(z4) * P[D + 1]
    ay = math.sin(z4) * P[D] + math.cos(z4) * P[D + 1]
    # w2 x b + w3 x c = dz4 x a, with w2 = dz2, w3 = dz2 + dz3
    det = bx * cy - by * cx
    w2 = (ax * cy - ay * cx) / det
    w3 = (bx * ay - by * ax) / det
    return w2, w3 - w2


@njit
def frame_angles(P, z1, z4):
    """Return (angles of the four body frames in rad, reachable); order of parameters.BODIES."""
    z2, z3, reachable = loop_angles(P, z4)
    return (z1, z1 + z2, z1 + z2 + z3, z1 + z4), reachable


@njit
def _turned(P, point, angle, x, y):
    c, s = math.cos(angle), math.sin(angle)
    return x + c * P[point] - s * P[point + 1], y + s * P[point] + c * P[point + 1]


@njit
def _points(P, z1, z4, out):
    """Fill out (10, 2) with the points in the order of POINT_NAMES; return whether the pose can be reached."""
    (a1, a2, a3, a4), reachable = frame_angles(P, z1, z4)
    ox, oy = P[O], P[O + 1]
    out[0], out[1] = (ox, oy), (P[F], P[F + 1])
    out[2], out[3] = _turned(P, G, a1, ox, oy), _turned(P, H, a1, ox, oy)
    out[4], out[5] = _turned(P, B, a1, ox, oy), _turned(P, A, a1, ox, oy)
    out[6] = _turned(P, C, a2, out[4, 0], out[4, 1])
    out[7] = _turned(P, D_BRACKET, a3, out[6, 0], out[6, 1])
    out[8], out[9] = _turned(P, D, a4, out[5, 0], out[5, 1]), _turned(P, E, a4, out[5, 0], out[5, 1])
    return reachable


@njit
def cylinder_length(P, z, c, row):
    """Return the pin-to-pin length (m) of cylinder c at angles z = [z1 z4 …], and fill its derivative by z_c (m/rad) into row[c].

    Lift: from F to G, which turns with z1. Tilt: from H to C, which turns with z2 of z4, seen from the lift boom; NaN where the
    loop cannot close.
    """
    pin, base, pivot, angle, rate = G, F, O, z[0], 1.0
    if c == 1:
        z2, z3, _ = loop_angles(P, z[1])
        pin, base, pivot, angle, rate = C, H, B, z2, loop_rates(P, z2, z3, z[1])[0]
    x, y = _turned(P, pin, angle, P[pivot], P[pivot + 1])
    along, across = x - P[base], y - P[base + 1]
    length = math.hypot(along, across)
    row[c] = rate * ((x - P[pivot]) * across - (y - P[pivot + 1]) * along) / length
    return length


@njit
def _lengths(P, z, out):
    row = np.empty(2)
    for k in range(len(z)):
        for c in range(2):
            out[k, c] = cylinder_length(P, z[k], c, row)


def cylinder_lengths(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return pin-to-pin lengths s1, s2 in m (m, 2) at angles z1, z4 in rad (m, 2), NaN where the loop cannot close."""
    out = np.empty((len(z), 2))
    _lengths(crane.parameter_vector(), np.ascontiguousarray(z, float), out)
    return out


@njit
def _pose_arrays(P, z1, z4, points, angles, rates, lengths, length_rates):
    """Fill the arrays for every state; return the index of the first unreachable one, or -1."""
    for k in range(z1.size):
        if not _points(P, z1[k], z4[k], points[k]):
            return k
        z2, z3, _ = loop_angles(P, z4[k])
        angles[k] = (z2, z3)
        rates[k] = loop_rates(P, z2, z3, z4[k])
        for c in range(2):
            lengths[k, c] = cylinder_length(P, (z1[k], z4[k]), c, length_rates[k])
    return -1


@dataclass(frozen=True)
class Pose:
    """Everything that follows from z1, z4 of n states; lengths in m, angles in rad.

    Attributes:
        points: (n, 10, 2) positions in the order of parameters.POINT_NAMES.
        z2, z3: (n,) dependent angles.
        dz2_dz4, dz3_dz4: (n,) their rates per rate of z4.
        lengths: (n, 2) pin-to-pin lengths s1, s2 of lift and tilt cylinder.
        length_rates: (n, 2) ds1/dz1 and ds2/dz4 in m/rad; the other two derivatives are zero.
    """

    points: np.ndarray
    z2: np.ndarray
    z3: np.ndarray
    dz2_dz4: np.ndarray
    dz3_dz4: np.ndarray
    lengths: np.ndarray
    length_rates: np.ndarray


def pose(crane: Crane, z1: np.ndarray | float, z4: np.ndarray | float) -> Pose:
    """Return the closed geometry of n states.

    Args:
        z1, z4: angles in rad, scalars or (n,).

    Raises:
        CraneError: the loop A-B-C-D cannot be closed at one of the states.
    """
    z1, z4 = np.atleast_1d(np.asarray(z1, dtype=float)), np.atleast_1d(np.asarray(z4, dtype=float))
    z1, z4 = (np.ascontiguousarray(a) for a in np.broadcast_arrays(z1, z4))
    n = z1.size
    points, angles, rates, lengths, length_rates = (
        np.empty((n, 10, 2)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)), np.empty((n, 2)),
    )  # fmt: skip
    bad = _pose_arrays(crane.parameter_vector(), z1, z4, points, angles, rates, lengths, length_rates)
    if bad >= 0:
        raise unreachable(crane.name, z1[bad], z4[bad])
    return Pose(points, angles[:, 0], angles[:, 1], rates[:, 0], rates[:, 1], lengths, length_rates)


def unreachable(name: str, z1: float, z4: float) -> CraneError:
    """Return the error that says that the loop cannot be closed at these angles (rad)."""
    return CraneError(
        f"{name}: the pose z1 = {math.degrees(z1):.2f} deg, z4 = {math.degrees(z4):.2f} deg cannot be reached: the two "
        "brackets are too short or too long to close the loop A-B-C-D. Choose z4 nearer to the middle of its range, or "
        "correct the points A, B, C, D of the crane file."
    )
