"""A force in a cylinder that is a measured curve."""

import math

from .base import CYLINDERS, Effect
from .curve import Argument, Curve, value


class LearnedForce(Effect):
    """A cylinder force as a curve: against motion, over the speed, the stroke (pin-to-pin length) or the pressure
    difference; or like a spring, over the stroke.

    Signature: the driving pressure differs by an amount that depends on the speed, the position of the piston or the
    load.
    """

    name = "learned_force"
    places = CYLINDERS
    curve = Curve(
        "N",
        (
            Argument("speed", "m/s", 0.0, 0.3, 2000.0, magnitude=True, against=(True,)),
            Argument("stroke", "m", 0.6, 1.6, 2000.0, against=(True, False), origin="empty_length"),
            Argument("pressure_drop", "Pa", 0.0, 100e5, 2000.0, magnitude=True, against=(True,)),
        ),
    )
    parameters = curve.parameters()

    @staticmethod
    def cylinder_force(E, at, v, pa, pb, la, lb):
        if E[at] == 0.0:
            return 0.0
        over = E[at + 1]
        force = value(E, at, abs(v) if over == 0.0 else (la if over == 1.0 else abs(pa - pb)))
        return -force * math.tanh(v / 2e-3) if E[at + 2] > 0.0 else force
