"""One law that was learned: its curve with what is known of it, and what it resembles."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .laws import Law
from .resembles import Resemblance, read_in


@dataclass(frozen=True)
class LearnedLaw:
    """One law that was learned.

    Attributes:
        effect: "learned_force@lift"; over, unit_over, unit: what the curve runs over, in SI.
        x, y, std: (K,) knots within the visited range, the curve there and its standard deviation.
        against_motion: whether it acts against motion.
        resembles: in words, "" if it resembles nothing simple; tied_with: what this recording cannot tell from it.
        evidence: log evidence that it brings.
        knots: (K,) places and values through which the crane has the curve; where it resembles a simple form they go on
            along that beyond what is known.
        law, form: what it is a curve of, with the values that were visited; the simple form that it resembles.
    """

    effect: str
    over: str
    unit_over: str
    unit: str
    x: np.ndarray
    y: np.ndarray
    std: np.ndarray
    against_motion: bool
    resembles: str
    tied_with: tuple[str, ...]
    evidence: float
    knots: tuple[np.ndarray, np.ndarray] = field(repr=False)
    law: Law = field(repr=False)
    form: Resemblance = field(repr=False)

    def table(self) -> tuple[tuple[str, str, str], list[tuple[float, float, float]]]:
        """Return columns and rows of the knots and their 95 % intervals, in the units in which people read them."""
        (x_unit, fx), (y_unit, fy) = read_in(self.unit_over), read_in(self.unit)
        greatest = np.abs(self.y / fy).max()
        # less than a thousandth of the greatest says nothing
        digits = 3 - math.floor(math.log10(greatest)) if greatest > 0.0 else 0
        knots = zip(self.x / fx, np.round(self.y / fy, digits), np.round(1.96 * self.std / fy, digits), strict=True)
        columns = (f"{self.over} [{x_unit or '-'}]", f"value [{y_unit or '-'}]", "± (95 %)")
        return columns, [(float(x), float(y), float(half)) for x, y, half in knots]

    def to_dict(self) -> dict[str, Any]:
        """Return the entry of the JSON of learn."""
        keys = ("effect", "over", "unit_over", "unit", "resembles", "against_motion", "evidence")
        lists = {k: getattr(self, k).tolist() for k in ("x", "y", "std")}
        return {k: getattr(self, k) for k in keys} | lists | {"tied_with": list(self.tied_with)}
