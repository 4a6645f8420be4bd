"""A valve that holds the pressure drop over its pump edge."""

import math

from .base import CYLINDERS, Effect, Parameter


class PressureCompensation(Effect):
    """The pump edge sees min(pp - p, dpc).

    Signature: speed follows the command whatever the load; where the nominal model runs faster because of a large
    pressure difference, the machine does not.
    """

    name = "pressure_compensation"
    places = CYLINDERS
    parameters = (
        Parameter("dpc", "Pa", math.inf, 0.5e5, math.inf, 10e5, "pressure drop that is held over the pump edge"),
    )
    probes = ({"dpc": 60e5}, {"dpc": 30e5}, {"dpc": 12e5}, {"dpc": 6e5})

    @staticmethod
    def supply_drop(dpc, dp):
        return min(dp, dpc)
