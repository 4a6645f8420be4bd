"""Chamber lengths and volumes of a cylinder; the chamber grows as its side of the piston retreats (see erratum of
(38)).
"""

from ..compiled import njit


@njit(inline="always")
def chamber_lengths(length: float, empty_length: float, chamber_range: float) -> tuple[float, float]:
    """Return the lengths (m) of the piston-side and rod-side chambers at a pin-to-pin length (m).

    l1 = s - s0, l2 = s0 + range - s, with s0 the length at which the piston side is empty.
    """
    piston_side = length - empty_length
    return piston_side, chamber_range - piston_side


@njit(inline="always")
def chamber_volume(hose_volume: float, area: float, length: float) -> float:
    """Return the volume V = Vh + A l (m^3) of a chamber and its hose."""
    return hose_volume + area * length
