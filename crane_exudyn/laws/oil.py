"""Equation of state of a chamber: which amount of oil stands at which pressure in which volume.

The amount N is the volume that the oil would fill at the pressure 0; only flows change it. With the softness of oil and
wall 1/B = 1/Bo + 1/Bc, gas as a share x of the oil, and what the hose gives beyond that, 1/Bw = 1/Bh - 1/Bc, the
pressure equation (34) with (14) and (41) is the total derivative of

    N(p, V) = V exp(p/B - x(p)) + Vh (exp(p/B) - 1) B/Bw,     dN/dt = exp(p/B - x) Q.

Oil cannot be stretched: below vapour pressure a void opens. The state remembers it as the pressure y < p_vapour that
the oil would have if it could be stretched (linearly, without gas); the chamber itself stays at vapour pressure until
the void has filled.
"""

import math

from ..compiled import njit
from ..effects import hooks


@njit
def filling(E, y, chamber_volume, hose_volume, softness, hose_softness, vapour, zero):
    """Return (N, dN/dy, dN/dV, density): amount in m^3, its derivatives, and density over that at the pressure 0.

    Args:
        E: parameters of effects; y: pressure of the state in Pa.
        chamber_volume, hose_volume: volumes A l and Vh in m^3.
        softness, hose_softness: 1/B and 1/Bw in 1/Pa.
        vapour: vapour pressure; zero: what is to be added to y for an absolute pressure, Pa.
    """
    p, volume = max(y, vapour), chamber_volume + hose_volume
    share, compliance = hooks.free_gas(E, p + zero)
    pressed, hose = math.expm1(softness * p), hose_volume * hose_softness
    if share == 0.0:  # summed up so that pressure and amount follow from each other to the last digit
        density = 1.0 + pressed
        amount = volume + (volume + hose / softness) * pressed
    else:
        density = (1.0 + pressed) * math.exp(-share)
        amount = volume * density + hose / softness * pressed
    if y >= vapour:
        return amount, volume * density * (softness + compliance) + hose * (1.0 + pressed), density, density
    slope = density * (volume * softness + hose)
    return amount + slope * (y - vapour), slope, density * (1.0 + softness * (y - vapour)), density


@njit
def pressure_of(E, amount, chamber_volume, hose_volume, softness, hose_softness, vapour, zero, guess):
    """Return the state's pressure y at which a chamber holds an amount (m^3); arguments as in `filling`, guess in Pa.

    Without gas in closed form. With gas N is concave in y, so that Newton's method climbs from below; from above one
    step may lead below the root, but not below vapour pressure while there is no void.
    """
    if hooks.free_gas(E, vapour + zero)[0] == 0.0:
        volume = chamber_volume + hose_volume
        y = math.log1p((amount - volume) / (volume + hose_volume * hose_softness / softness)) / softness
        if y >= vapour:
            return y
    empty, _, _, density = filling(E, vapour, chamber_volume, hose_volume, softness, hose_softness, vapour, zero)
    if not amount > empty:
        slope = density * ((chamber_volume + hose_volume) * softness + hose_volume * hose_softness)
        return vapour + (amount - empty) / slope
    y = max(guess, vapour)
    for _ in range(100):
        held, slope, _, _ = filling(E, y, chamber_volume, hose_volume, softness, hose_softness, vapour, zero)
        before, y = y, max(y + (amount - held) / slope, vapour)
        if abs(y - before) <= 1e-6 + 1e-10 * abs(y):
            break
    return y
