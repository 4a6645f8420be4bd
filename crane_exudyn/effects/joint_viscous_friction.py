"""Viscous friction in a boom joint."""

from .base import JOINTS, Effect, Parameter


class JointViscousFriction(Effect):
    """Torque c omega against the relative rate omega of the joint.

    Signature: the cylinder force differs in proportion to the speed, and vibrations die out sooner.
    """

    name = "joint_viscous_friction"
    places = JOINTS
    parameters = (Parameter("c", "N*m*s", 0.0, 0.0, 1e5, 1500.0, "damping of the joint"),)
    probes = ({"c": 1000.0},)

    @staticmethod
    def joint_torque(c, omega):
        return -c * omega
