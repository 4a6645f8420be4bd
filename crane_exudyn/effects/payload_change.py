"""A load that is taken up or dropped during the recording."""

from .base import Effect, Parameter


class PayloadChange(Effect):
    """The payload mass changes by dm at time T.

    Signature: a single step in the load-bearing pressures of both cylinders, and an oscillation after it; before the
    step the model is right.
    """

    name = "payload_change"
    parameters = (
        Parameter("dm", "kg", 0.0, -400.0, 1000.0, 50.0, "change of the payload mass"),
        Parameter(
            "T", "s", 0.0, 0.0, 1e4, 5.0, "time of the change, from the start of the recording", shape=True, moment=True
        ),
    )

    @staticmethod
    def payload_mass(dm, T, t, m):
        if t >= T:
            return m + dm
        return m
