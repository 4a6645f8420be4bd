"""Oil lost from one chamber by a measured curve."""

from .base import CHAMBERS, Effect
from .curve import Argument, Curve, value


class LearnedFlow(Effect):
    """A flow out of one chamber, as a curve over its pressure above that of the air outside.

    Signature: the chamber does not hold, or does not reach, a certain pressure; the opposite chamber follows.
    """

    name = "learned_flow"
    places = CHAMBERS
    curve = Curve("m^3/s", (Argument("pressure", "Pa", 0.0, 200e5, 2e-5),))
    parameters = curve.parameters()

    @staticmethod
    def leakage(E, at, p):
        return -value(E, at, p) if E[at] > 0.0 else 0.0
