"""The tip of the crane touches something."""

from .base import Effect, Parameter


class TipContactForce(Effect):
    """A vertical force F on E from time T on (up positive).

    Signature: like a change of payload, without the inertia: a step in the load-bearing pressures that stays the same
    however the booms are accelerated.
    """

    name = "tip_contact_force"
    parameters = (
        Parameter("F", "N", 0.0, -20e3, 20e3, 500.0, "vertical force on the tip, up positive"),
        Parameter(
            "T", "s", 0.0, 0.0, 1e4, 5.0, "when it begins, from the start of the recording", shape=True, moment=True
        ),
    )

    @staticmethod
    def tip_force(F, T, t):
        if t >= T:
            return F
        return 0.0
