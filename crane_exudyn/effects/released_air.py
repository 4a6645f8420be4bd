"""Air that comes out of solution below its saturation pressure."""

import math

from .base import Effect, Parameter

#: below this pressure the gas law is not followed any further, as in entrained_air
_LEAST = 0.2e5
#: the compliance fades out over this share of the saturation pressure, so that the law stays smooth
_FADE = 0.2


class ReleasedAir(Effect):
    """Air that comes out of solution: in chambers below the saturation pressure ps, 1/Bo is raised by alpha * 1 bar /
    p^2 (Bo: bulk modulus of the oil); above ps it is unchanged.

    By Henry's law the free share of the air falls linearly to zero at ps. By the gas law its volume is alpha * 1 bar *
    (1/p - 1/ps); the derivative of that volume is the compliance. p is taken as not below 0.2 bar, and the compliance
    fades out between 0.8 ps and ps.

    Signature: a chamber near tank pressure is filled for seconds before its pressure rises, which it then does faster
    and faster. All chambers above the saturation pressure are as stiff as without air (entrained air softens them too).
    """

    name = "released_air"
    parameters = (
        Parameter("alpha", "", 0.0, 0.0, 1.0, 0.1, "volume of air at 1 bar, as a share of the chamber"),
        Parameter("ps", "Pa", 5e5, 1e5, 20e5, 5e5, "saturation pressure", shape=True),
    )
    probes = tuple({"alpha": alpha, "ps": ps} for ps in (2e5, 5e5, 12e5) for alpha in (0.02, 0.2))

    @staticmethod
    def free_gas(alpha, ps, p):
        if alpha == 0.0 or p >= ps:
            return 0.0, 0.0
        p_air, knee = max(p, _LEAST), (1.0 - _FADE) * ps
        fading = max(p_air, knee)
        # the integral of the compliance from p to ps: where it fades out, where it is whole, and below the least
        # pressure
        share = alpha * 1e5 / (_FADE * ps) * (ps / fading - 1.0 - math.log(ps / fading))
        share += alpha * 1e5 * max(1.0 / p_air - 1.0 / knee, 0.0)
        compliance = alpha * 1e5 / (p_air * p_air) * min((ps - p_air) / (_FADE * ps), 1.0)
        return share + compliance * (p_air - p), compliance
