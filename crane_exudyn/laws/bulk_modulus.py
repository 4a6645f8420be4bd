"""Effective bulk modulus of a chamber with its cylinder wall and hose, equations (14) and (41)."""

from ..compiled import njit


@njit(inline="always")
def effective_bulk_modulus(
    inv_oil: float, cylinder: float, hose: float, chamber_volume: float, hose_volume: float
) -> float:
    """Return Be in Pa from 1/Be = 1/Bo + A l / (V Bc) + Vh / (V Bh), V = A l + Vh, (41).

    Args:
        inv_oil: 1/Bo in 1/Pa, with whatever effects add to the oil's own compliance.
        cylinder, hose: bulk moduli Bc, Bh of cylinder and hose in Pa.
        chamber_volume: volume A l inside the cylinder in m^3.
        hose_volume: volume Vh of the hose in m^3.
    """
    volume = chamber_volume + hose_volume
    return 1.0 / (inv_oil + chamber_volume / (volume * cylinder) + hose_volume / (volume * hose))
