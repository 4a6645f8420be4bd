"""Seal friction that grows with the pressure difference over the piston."""

import math

from .base import CYLINDERS, Effect, Parameter


class PressureDependentFriction(Effect):
    """Friction force mu |pa - pb| tanh(v / 2 mm/s) in the cylinder, with the pressures pa and pb of its two sides and
    its speed v.

    Signature: like seal friction, but the step at a change of direction grows with the load that the cylinder carries.
    """

    name = "pressure_dependent_friction"
    places = CYLINDERS
    parameters = (Parameter("mu", "m^2", 0.0, 0.0, 5e-3, 3e-4, "friction force per pressure difference"),)
    probes = ({"mu": 2e-4},)

    @staticmethod
    def cylinder_force(mu, v, pa, pb, la, lb):
        return -mu * abs(pa - pb) * math.tanh(v / 2e-3) if mu != 0.0 else 0.0
