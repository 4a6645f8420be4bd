"""A pump whose pressure gives way under flow."""

from .base import Effect, Parameter


class PumpDroop(Effect):
    """The supply pressure is pp - R * (flow that all valves draw from the pump).

    Signature: motions against a load become slower with the speed, more so if several cylinders move at once, because
    each is affected by the flow of the others.
    """

    name = "pump_droop"
    parameters = (Parameter("R", "Pa*s/m^3", 0.0, 0.0, 1e12, 5e9, "source resistance"),)
    probes = ({"R": 2e9}, {"R": 2e10})

    @staticmethod
    def supply_pressure(R, pp, q_drawn):
        return pp - R * q_drawn
