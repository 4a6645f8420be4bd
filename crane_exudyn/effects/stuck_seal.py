"""The seal of a cylinder that does not slide: it holds a force, like a spring about the place where it was relaxed."""

import math

from .base import CYLINDERS, Effect, Parameter


class StuckSeal(Effect):
    """Force -Fc tanh((l - l0) / delta) of a seal that does not slide, with the length l of the piston-side chamber:
    presliding friction without memory.

    Friction that depends on the speed alone cannot hold a load; it lets go within milliseconds. A seal at rest deforms
    by some tenths of a millimetre before it slides. It holds up to Fc in either direction for any time, as the last
    motion left it.

    The law is valid while the cylinder stays within this deformation: for a cylinder whose valve remains closed, and
    for one stroke in one direction from rest. It is wrong after a moving cylinder has reversed, because l0 stays where
    it was.

    Signature: at rest the pressures of a cylinder do not balance the load, always by the same force, and they follow
    only a part of a change of load.
    """

    name = "stuck_seal"
    places = CYLINDERS
    parameters = (
        Parameter("Fc", "N", 0.0, 0.0, 20e3, 3000.0, "largest force that the seal holds"),
        Parameter(
            "l0",
            "m",
            0.5,
            0.0,
            2.0,
            0.5,
            "length of the piston-side chamber at which the force is zero",
            shape=True,
            along_stroke=True,
        ),
        Parameter("delta", "m", 5e-4, 2e-5, 1e-2, 5e-4, "deformation of the seal", shape=True),
    )

    @staticmethod
    def cylinder_force(Fc, l0, delta, v, pa, pb, la, lb):
        return -Fc * math.tanh((la - l0) / delta) if Fc > 0.0 else 0.0
