"""A torque on a joint that is a measured curve."""

import math

from .base import JOINTS, Effect
from .curve import Argument, Curve, value


class LearnedTorque(Effect):
    """A joint torque as a curve: over the angle of the joint, like a spring or against motion; or over its rate,
    against motion. On a sliding joint it is a force.

    Signature: the cylinder force differs by an amount that depends on the angle or the rate of the joint, whatever the
    friction of the cylinder.
    """

    name = "learned_torque"
    places = JOINTS
    curve = Curve(
        "N*m",
        (
            Argument("angle", "rad", -1.5, 1.5, 1000.0, against=(False, True)),
            Argument("rate", "rad/s", 0.0, 0.5, 1000.0, magnitude=True, against=(True,)),
        ),
    )
    parameters = curve.parameters()

    @staticmethod
    def joint_torque(E, at, omega, angle):
        if E[at] == 0.0:
            return 0.0
        torque = value(E, at, angle if E[at + 1] == 0.0 else abs(omega))
        return -torque * math.tanh(omega / 2e-3) if E[at + 2] > 0.0 else torque
