"""A return line that dams up."""

from .base import Effect, Parameter


class ReturnBackPressure(Effect):
    """The tank pressure is pt + R * (flow that all valves return to tank).

    Signature: while oil flows, the pressure of the chamber that drains is higher, in proportion to the flow, whichever
    cylinder moves.
    """

    name = "return_back_pressure"
    parameters = (Parameter("R", "Pa*s/m^3", 0.0, 0.0, 1e12, 5e9, "resistance of the return line"),)
    probes = ({"R": 2e9}, {"R": 2e10})

    @staticmethod
    def tank_pressure(R, pt, q_returned):
        return pt + R * q_returned
