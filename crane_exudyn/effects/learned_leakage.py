"""Oil that passes the piston seal by a measured curve."""

import math

from .base import CYLINDERS, Effect
from .curve import Argument, Curve, value


class LearnedLeakage(Effect):
    """A leakage flow from the side of higher pressure to the other side of one cylinder, as a curve over the pressure
    difference.

    Signature: with its valve closed, a loaded cylinder creeps, but not in proportion to its load.
    """

    name = "learned_leakage"
    places = CYLINDERS
    curve = Curve("m^3/s", (Argument("pressure_drop", "Pa", 0.0, 100e5, 2e-5, magnitude=True, from_zero=True),))
    parameters = curve.parameters()

    @staticmethod
    def leakage(E, at, pa, pb):
        if E[at] == 0.0:
            return 0.0, 0.0
        q = math.copysign(value(E, at, abs(pa - pb)), pa - pb) if pa != pb else 0.0
        return -q, q
