"""A valve that holds the pressure drop over its pump edge."""

import math

from .base import CYLINDERS, Effect, Parameter


class PressureCompensation(Effect):
    """A compensator limits the pressure drop over the pump edge to dpc: the drop is min(pp - p, dpc), from the pump
    pressure pp to the chamber pressure p.

    Signature: the speed follows the command, whatever the load. Where the nominal model runs faster because of a large
    pressure difference, the machine does not.
    """

    name = "pressure_compensation"
    places = CYLINDERS
    parameters = (
        Parameter("dpc", "Pa", math.inf, 0.5e5, math.inf, 10e5, "pressure drop that is kept over the pump edge"),
    )
    probes = ({"dpc": 60e5}, {"dpc": 30e5}, {"dpc": 12e5}, {"dpc": 6e5})

    @staticmethod
    def supply_drop(dpc, dp):
        return min(dp, dpc)
