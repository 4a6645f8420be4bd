"""Elasticity of structure, pins and mounts, seen by one cylinder."""

import math

from .base import CYLINDERS, Effect, Parameter


class StructuralCompliance(Effect):
    """A spring in series with the cylinder: pin-to-pin length = hydraulic length - F / stiffness, with the cylinder
    force F.

    Signature: the machine rings more slowly than its oil alone explains, at every pressure alike, and the boom sags a
    little under the load without any flow.
    """

    name = "structural_compliance"
    places = CYLINDERS
    parameters = (Parameter("stiffness", "N/m", math.inf, 1e5, math.inf, 1e7, "stiffness of the spring"),)
    probes = ({"stiffness": 1e8}, {"stiffness": 1e7}, {"stiffness": 3e6})

    @staticmethod
    def series_compliance(stiffness):
        return 1.0 / stiffness
