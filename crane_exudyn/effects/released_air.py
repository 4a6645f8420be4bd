"""Air that comes out of solution below its saturation pressure."""

from .base import Effect, Parameter

#: below this pressure the gas law is not followed any further, as in entrained_air
_LEAST = 0.2e5
#: the compliance fades out over this share of the saturation pressure, so that the law stays smooth
_FADE = 0.2


class ReleasedAir(Effect):
    """1/Bo is raised by alpha * 1 bar / p^2 in chambers below the saturation pressure ps, and is as it was above it.

    By Henry's law the free share of the air falls linearly to nothing at ps, by the gas law its volume is
    alpha * 1 bar * (1/p - 1/ps); the derivative of that volume is the compliance. p is taken as not below 0.2 bar, and the
    compliance fades out between 0.8 ps and ps.

    Signature: a chamber that stands near tank pressure is filled for seconds before its pressure rises, and rises ever faster;
    all chambers above the saturation pressure are as stiff as without air (entrained air softens them too).
    """

    name = "released_air"
    parameters = (
        Parameter("alpha", "", 0.0, 0.0, 1.0, 0.1, "volume of air at 1 bar, as a share of the chamber"),
        Parameter("ps", "Pa", 5e5, 1e5, 20e5, 5e5, "saturation pressure", shape=True),
    )
    probes = ({"alpha": 0.02, "ps": 5e5}, {"alpha": 0.2, "ps": 5e5})

    @staticmethod
    def oil_compliance(alpha, ps, inv_bulk, p):
        p_air = max(p, _LEAST)
        free = min(max((ps - p_air) / (_FADE * ps), 0.0), 1.0)
        return inv_bulk + alpha * 1e5 / (p_air * p_air) * free
