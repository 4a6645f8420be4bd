"""A spool that covers its ports around the middle."""

from .base import CYLINDERS, Effect, Parameter


class DeadBand(Effect):
    """The valve stays closed for -lower < U < upper (U: spool position); beyond, it opens linearly, fully at U = ±1.

    Signature: small commands move nothing, motions start late and stop early, and the speed is too low, most at small
    openings.
    """

    name = "dead_band"
    places = CYLINDERS
    parameters = (
        Parameter("lower", "", 0.0, 0.0, 0.8, 0.05, "width on the retracting side"),
        Parameter("upper", "", 0.0, 0.0, 0.8, 0.05, "width on the extending side"),
    )
    probes = ({"lower": 0.03, "upper": 0.0}, {"lower": 0.0, "upper": 0.03}, {"lower": 0.1, "upper": 0.1})

    @staticmethod
    def opening(lower, upper, U):
        if U > upper:
            return (U - upper) / (1.0 - upper)
        if U < -lower:
            return (U + lower) / (1.0 - lower)
        return 0.0
