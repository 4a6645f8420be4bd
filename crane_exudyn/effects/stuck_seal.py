"""The seal of a cylinder that does not slide: it holds a force, like a spring about the place where it was relaxed."""

import math

from .base import CYLINDERS, Effect, Parameter


class StuckSeal(Effect):
    """Adds -Fc tanh((l - l0) / delta), l the length of the piston-side chamber: presliding friction without memory.

    Friction by speed alone cannot hold a load: it lets go within milliseconds. A seal at rest deforms by some tenths of
    a millimetre before it slides, and holds up to Fc either way for ever, as the last motion left it.

    Valid while the cylinder stays within the deformation, which is to say for a cylinder whose valve remains closed,
    and for one stroke in one direction out of rest; it forgets nothing and so is wrong after a reversal of a moving
    cylinder.

    Signature: at rest the pressures of a cylinder do not balance the load, always by the same force, and they answer a
    change of load by less than the whole of it.
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
            "length of the piston-side chamber at which it holds none",
            shape=True,
            along_stroke=True,
        ),
        Parameter("delta", "m", 5e-4, 2e-5, 1e-2, 5e-4, "deformation of the seal", shape=True),
    )

    @staticmethod
    def cylinder_force(Fc, l0, delta, v, pa, pb, la, lb):
        return -Fc * math.tanh((la - l0) / delta) if Fc > 0.0 else 0.0
