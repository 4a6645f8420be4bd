"""Dry friction in a boom joint."""

import math

from .base import JOINTS, Effect, Parameter


class JointCoulombFriction(Effect):
    """Torque T tanh(omega / 2 mrad/s) against the relative rate omega of the joint.

    Signature: the cylinder force jumps at a change of direction, as with seal friction, but by an amount that follows
    the cylinder's lever arm; vibrations stop early.
    """

    name = "joint_coulomb_friction"
    places = JOINTS
    parameters = (Parameter("T", "N*m", 0.0, 0.0, 20e3, 500.0, "friction torque"),)
    probes = ({"T": 200.0}, {"T": 1500.0})

    @staticmethod
    def joint_torque(T, omega):
        return -T * math.tanh(omega / 2e-3) if T != 0.0 else 0.0
