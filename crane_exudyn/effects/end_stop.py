"""The cylinder's ends of stroke."""

from .base import CYLINDERS, Effect, Parameter


class EndStop(Effect):
    """A stiff stop with damping at both ends of the stroke; it acts where the length of a chamber falls below zero.

    Signature: motion ends abruptly at one length while the valve is still open, and the driving pressure rises to that
    of the pump.
    """

    name = "end_stop"
    places = CYLINDERS
    beyond_stroke = True
    parameters = (
        Parameter("stiffness", "N/m", 0.0, 0.0, 1e10, 1e8, "stiffness of the stop; 0: no stop"),
        Parameter("damping", "N*s/m", 0.0, 0.0, 1e8, 1e5, "damping of the stop"),
    )
    probes = ({"stiffness": 1e8, "damping": 1e5}, {"stiffness": 1e7, "damping": 1e5})

    @staticmethod
    def cylinder_force(stiffness, damping, v, pa, pb, la, lb):
        if la < 0.0:
            return max(-stiffness * la - damping * v, 0.0)
        if lb < 0.0:
            return min(stiffness * lb - damping * v, 0.0)
        return 0.0
