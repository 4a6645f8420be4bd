"""A return line that dams up by a measured curve."""

from .base import Effect
from .curve import Argument, Curve, value


class LearnedReturn(Effect):
    """The tank pressure is pt plus a curve over the flow that all valves return to tank.

    Signature: while oil flows, the pressure of the chamber that drains is higher, whichever cylinder moves, but not in
    proportion to the flow.
    """

    name = "learned_return"
    curve = Curve("Pa", (Argument("flow", "m^3/s", 0.0, 1e-3, 5e5, from_zero=True, magnitude=True),))
    parameters = curve.parameters()

    @staticmethod
    def tank_pressure(E, at, pt, q):
        return pt + value(E, at, q) if E[at] > 0.0 and q > 0.0 else pt
