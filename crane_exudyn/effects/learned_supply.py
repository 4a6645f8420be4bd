"""A pump whose pressure gives way by a measured curve."""

from .base import Effect
from .curve import Argument, Curve, value


class LearnedSupply(Effect):
    """The supply pressure is pp minus a curve over the flow that all valves draw from the pump.

    Signature: motions against a load become slower with the flow, of all cylinders alike, but not in proportion to it.
    """

    name = "learned_supply"
    curve = Curve("Pa", (Argument("flow", "m^3/s", 0.0, 1e-3, 10e5, from_zero=True, magnitude=True),))
    parameters = curve.parameters()

    @staticmethod
    def supply_pressure(E, at, pp, q):
        return pp - value(E, at, q) if E[at] > 0.0 and q > 0.0 else pp
