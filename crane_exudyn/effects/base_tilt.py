"""A machine that does not stand level."""

import math

from .base import Effect, Parameter


class BaseTilt(Effect):
    """Gravity is turned by gamma in the plane, counter-clockwise positive: (gx, gy) = g (sin gamma, -cos gamma).

    Signature: load pressures are off by an amount that depends on the pose, at rest and in motion.
    """

    name = "base_tilt"
    parameters = (Parameter("gamma", "rad", 0.0, -0.6, 0.6, 0.05, "angle of the tilt"),)
    probes = ({"gamma": 0.02}, {"gamma": 0.1}, {"gamma": -0.1})

    @staticmethod
    def gravity(gamma, gx, gy):
        return math.cos(gamma) * gx - math.sin(gamma) * gy, math.sin(gamma) * gx + math.cos(gamma) * gy
