"""A payload that hangs on a rope or rotator and swings."""

from .base import Effect, Parameter


class PayloadSwing(Effect):
    """The payload, a point mass, hangs from the tip (E of the log crane) on a massless pendulum of the given length; a
    damping torque acts against its rate. The inertia of a long log in the grapple is left out.

    Signature: after every motion the load pressures oscillate slowly, at the pendulum's own frequency, and the booms
    hardly move.
    """

    name = "payload_swing"
    parameters = (
        Parameter("length", "m", 0.0, 0.0, 10.0, 1.0, "length of the pendulum; 0: fixed to the boom"),
        Parameter("damping", "N*m*s", 0.0, 0.0, 1e4, 5.0, "damping torque per rate"),
    )
    probes = (
        {"length": 0.4, "damping": 2.0},
        {"length": 0.8, "damping": 5.0},
        {"length": 1.5, "damping": 10.0},
        {"length": 3.0, "damping": 20.0},
    )

    @staticmethod
    def pendulum(length, damping):
        return length, damping
