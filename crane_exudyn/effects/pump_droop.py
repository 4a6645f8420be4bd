"""A pump whose pressure gives way under flow."""

from .base import Effect, Parameter


class PumpDroop(Effect):
    """Supply pressure pp - R * (flow drawn from the pump by all valves).

    Signature: motions against a load slow down with speed, more so when several cylinders move at once: each feels the
    others' flow.
    """

    name = "pump_droop"
    parameters = (Parameter("R", "Pa*s/m^3", 0.0, 0.0, 1e12, 5e9, "source resistance"),)
    probes = ({"R": 2e9}, {"R": 2e10})

    @staticmethod
    def supply_pressure(R, pp, q_drawn):
        return pp - R * q_drawn
