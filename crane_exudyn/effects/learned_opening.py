"""A valve whose opening is a measured curve."""

from .base import CYLINDERS, Effect
from .curve import Argument, Curve, value


class LearnedOpening(Effect):
    """The opening of the valve as a curve over the spool position; or a factor on the flow through both open edges, as
    a curve over their pressure drop.

    Signature: the speed differs from the expected one by a share that depends on the command alone, or on the load
    alone.
    """

    name = "learned_opening"
    places = CYLINDERS
    curve = Curve(
        "",
        (
            Argument("spool", "", -1.0, 1.0, 0.05, slope=1.0),
            Argument("pressure_drop", "Pa", 0.0, 100e5, 0.1, level=1.0),
        ),
    )
    parameters = curve.parameters()

    @staticmethod
    def opening(E, at, U):
        return value(E, at, U) if E[at] > 0.0 and E[at + 1] == 0.0 else U

    @staticmethod
    def supply_gain(E, at, dp):
        return max(value(E, at, dp), 0.0) if E[at] > 0.0 and E[at + 1] > 0.0 else 1.0

    @staticmethod
    def return_gain(E, at, p_own, p_other, load_side, drop):
        return max(value(E, at, drop), 0.0) if E[at] > 0.0 and E[at + 1] > 0.0 else 1.0
