"""Cylinder lengths from angles, NaN where the loop cannot close: what sensors on cylinders read, and where strokes end."""

from __future__ import annotations

import math

import numpy as np

from crane_exudyn.compiled import njit
from crane_exudyn.crane import Crane
from crane_exudyn.geometry import B, C, F, G, H, O, loop_angles


@njit
def _lengths(P, z, out):  # type: ignore[no-untyped-def]
    for k in range(z.shape[0]):
        c, s = math.cos(z[k, 0]), math.sin(z[k, 0])
        gx = P[O] + c * P[G] - s * P[G + 1]
        gy = P[O + 1] + s * P[G] + c * P[G + 1]
        out[k, 0] = math.hypot(gx - P[F], gy - P[F + 1])
        z2, _, _ = loop_angles(P, z[k, 1])  # NaN where the loop cannot close
        c, s = math.cos(z2), math.sin(z2)
        cx = P[B] + c * P[C] - s * P[C + 1]
        cy = P[B + 1] + s * P[C] + c * P[C + 1]
        out[k, 1] = math.hypot(cx - P[H], cy - P[H + 1])


def cylinder_lengths(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return pin-to-pin lengths s1, s2 in m (m, 2) at angles z1, z4 in rad (m, 2)."""
    out = np.empty((len(z), 2))
    _lengths(crane.parameter_vector(), np.ascontiguousarray(z, float), out)
    return out
