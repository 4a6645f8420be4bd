"""Friction of a cylinder, equation (19)."""

import math

from ..compiled import njit

_TANH_4 = math.tanh(4.0)


@njit(inline="always")
def cylinder_friction(speed: float, coulomb: float, static: float, stribeck_speed: float, viscous: float) -> float:
    """Return the friction force F_mu of (19) in N; it has the sign of the speed and is taken off the cylinder's force.

    F_mu = sgn(v) [Fc tanh(4 r) + (Fs - Fc) r / (r^2/4 + 3/4)^2] + sigma2 v tanh(4), r = |v| / vs.

    Args:
        speed: piston speed v in m/s, positive when the cylinder extends.
        coulomb, static: Fc, Fs in N.
        stribeck_speed: vs in m/s.
        viscous: sigma2 in N s/m.
    """
    r = abs(speed) / stribeck_speed
    dry = coulomb * math.tanh(4.0 * r) + (static - coulomb) * r / (0.25 * r * r + 0.75) ** 2
    return math.copysign(dry, speed) + viscous * speed * _TANH_4
