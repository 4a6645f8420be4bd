"""Friction of the cylinder seals beyond the nominal one."""

import math

from .base import CYLINDERS, Effect, Parameter


class SealFriction(Effect):
    """Coulomb friction dFc and static friction dFs, with a Stribeck speed vs of their own, are added to the cylinder's
    friction, equation (19) of the paper.

    Signature: at every change of direction the driving pressure jumps by the same step, whatever the load; slow motions
    stick.
    """

    name = "seal_friction"
    places = CYLINDERS
    parameters = (
        Parameter("dFc", "N", 0.0, 0.0, 50e3, 2000.0, "added Coulomb friction"),
        Parameter("dFs", "N", 0.0, 0.0, 50e3, 2000.0, "added static friction"),
        Parameter("vs", "m/s", 5e-3, 5e-4, 0.1, 5e-3, "Stribeck speed", shape=True),
    )
    probes = (
        {"dFc": 1000.0, "dFs": 1000.0, "vs": 5e-3},
        {"dFc": 0.0, "dFs": 1000.0, "vs": 5e-3},
        {"dFc": 3000.0, "dFs": 4000.0, "vs": 2e-2},
    )

    @staticmethod
    def cylinder_force(dFc, dFs, vs, v, pa, pb, la, lb):
        if dFc == 0.0 and dFs == 0.0:
            return 0.0
        r = abs(v) / vs
        hump = r / (0.25 * r * r + 0.75) ** 2
        return -math.copysign(dFc * math.tanh(4.0 * r) + (dFs - dFc) * hump, v)
