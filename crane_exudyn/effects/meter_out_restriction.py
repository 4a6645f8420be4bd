"""Edges to tank that are tighter than the edges from the pump."""

from .base import CYLINDERS, Effect, Parameter


class MeterOutRestriction(Effect):
    """The two edges to tank have the flow coefficient Cv (1 - r), Cv being that of the valve.

    Signature: while a cylinder moves, the pressures of both its chambers are higher than expected, the more the faster
    it moves; at rest nothing differs.
    """

    name = "meter_out_restriction"
    places = CYLINDERS
    parameters = (Parameter("r", "", 0.0, -1.0, 0.95, 0.3, "share of the flow coefficient that is missing"),)
    probes = ({"r": 0.1}, {"r": 0.5})

    @staticmethod
    def return_gain(r, p_own, p_other, load_side):
        return 1.0 - r
