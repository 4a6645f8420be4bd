"""A return line that dams up."""

from .base import Effect, Parameter


class ReturnBackPressure(Effect):
    """Tank pressure pt + R * (flow returned to tank by all valves).

    Signature: the chamber that drains stands higher while oil flows, for either cylinder's motion, by an amount
    proportional to the flow.
    """

    name = "return_back_pressure"
    parameters = (Parameter("R", "Pa*s/m^3", 0.0, 0.0, 1e12, 5e9, "resistance of the return line"),)
    probes = ({"R": 2e9}, {"R": 2e10})

    @staticmethod
    def tank_pressure(R, pt, q_returned):
        return pt + R * q_returned
