"""The tip of the crane touches something."""

from .base import Effect, Parameter


class TipContactForce(Effect):
    """A vertical force F, up positive, acts on the tip (E of the log crane) from time T on.

    Signature: like a change of payload, but without inertia: a step in the load-bearing pressures that stays the same
    however the booms accelerate.
    """

    name = "tip_contact_force"
    parameters = (
        Parameter("F", "N", 0.0, -20e3, 20e3, 500.0, "vertical force on the tip, up positive"),
        Parameter(
            "T", "s", 0.0, 0.0, 1e4, 5.0, "start of the force, from the start of the recording", shape=True, moment=True
        ),
    )

    @staticmethod
    def tip_force(F, T, t):
        if t >= T:
            return F
        return 0.0
