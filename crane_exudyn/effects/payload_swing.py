"""A payload that hangs on a rope or rotator and swings."""

from .base import Effect, Parameter


class PayloadSwing(Effect):
    """The payload, as a point mass, hangs from E on a massless pendulum of the given length; damping is a torque
    against its rate. A grapple with a long log has an inertia of its own, which this leaves out.

    Signature: a slow oscillation of the load pressures after every motion, at the pendulum's own frequency, that
    hardly moves the booms.
    """

    name = "payload_swing"
    parameters = (
        Parameter("length", "m", 0.0, 0.0, 10.0, 1.0, "length of the pendulum; 0 means fixed to the boom"),
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
