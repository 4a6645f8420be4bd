"""Flow through a metering edge, equation (15)."""

import math

from ..compiled import njit


@njit(inline="always")
def root_drop(dp: float, laminar: float) -> float:
    """Return q(dp) of (15) in sqrt(Pa): sgn(dp) sqrt|dp|, linear dp / sqrt(laminar) below the laminar limit.

    Args:
        dp: pressure drop over the edge in Pa, either sign.
        laminar: |dp| in Pa below which the flow is laminar (model sheet: 2 bar).
    """
    if abs(dp) < laminar:
        return dp / math.sqrt(laminar)
    return math.copysign(math.sqrt(abs(dp)), dp)


@njit(inline="always")
def edge_flow(coefficient: float, opening: float, dp: float, laminar: float) -> float:
    """Return the flow Cv U q(dp) of (15) in m^3/s, from the side from which dp is counted.

    Args:
        coefficient: flow coefficient Cv of the edge in m^3/s/sqrt(Pa).
        opening: how far the edge is open, 0 to 1.
        dp: pressure drop over the edge in Pa.
        laminar: |dp| in Pa below which the flow is laminar.
    """
    return coefficient * opening * root_drop(dp, laminar)
