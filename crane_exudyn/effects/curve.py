"""Laws that are curves through knots: what they may run over, their table, and their value in compiled code."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ..errors import CraneError, nearest
from .parameter import Parameter

#: the most knots of a curve; in E stand their number, what the curve runs over, whether it acts against motion, all x,
#: all y
KNOTS = 20
NUMBER, OVER, AGAINST, X, Y = 0, 1, 2, 3, 3 + KNOTS


@dataclass(frozen=True)
class Argument:
    """What a curve may run over.

    Attributes:
        name, unit: in crane files and JSON; SI.
        low, high: a range that is met in practice; size: what the curve adds to a neutral one at `high`, SI.
        magnitude: the curve runs over the magnitude: it is the same for both signs, and begins at 0 or above.
        from_zero: its first knot is (0, 0).
        against: whether it acts against motion; both where it may do either, the usual one first.
        slope: of the neutral curve: 1 for an opening, which is the spool's position.
        level: of the neutral curve: 1 for a factor.
        origin: last part of the name of the cylinder's parameter that is taken off x before it is compared with what
            hooks are given.
    """

    name: str
    unit: str
    low: float
    high: float
    size: float
    magnitude: bool = False
    from_zero: bool = False
    against: tuple[bool, ...] = (False,)
    slope: float = 0.0
    level: float = 0.0
    origin: str = ""

    def neutral(self, x: float) -> float:
        """Return the neutral curve at x."""
        return self.level + self.slope * x


@dataclass(frozen=True)
class Table:
    """A curve: what it runs over, its knots (SI), and whether it acts against motion."""

    over: Argument
    x: tuple[float, ...]
    y: tuple[float, ...]
    against_motion: bool = False


@dataclass(frozen=True)
class Curve:
    """The curves that an effect may have: the SI unit of their values, and what they may run over."""

    unit: str
    over: tuple[Argument, ...]

    def parameters(self) -> tuple[Parameter, ...]:
        """Return the parameters that the effect has in E."""
        first, most = self.over[0], len(self.over) - 1.0
        x = [first.low + (first.high - first.low) * k / (KNOTS - 1) for k in range(KNOTS)]
        y = [first.neutral(v) + first.size * (k / (KNOTS - 1)) ** 2 for k, v in enumerate(x)]
        far = math.inf
        return (
            Parameter("knots", "", 0.0, 0.0, float(KNOTS), float(KNOTS), "number of knots; 0 means absent"),
            Parameter("over", "", 0.0, 0.0, most, 0.0, "number of what the curve runs over", shape=True),
            Parameter("against", "", 0.0, 0.0, 1.0, float(first.against[0]), "1: acts against motion", shape=True),
            *(Parameter(f"x{k + 1}", "", 0.0, -far, far, v, "place of a knot", shape=True) for k, v in enumerate(x)),
            *(Parameter(f"y{k + 1}", self.unit, 0.0, -far, far, v, "value there", shape=True) for k, v in enumerate(y)),
        )

    def argument(self, name: str, where: str) -> Argument:
        """Return what a curve runs over by its name; the error, which begins with `where`, names the nearest."""
        names = [a.name for a in self.over]
        if name not in names:
            raise CraneError(
                f"{where}: over = {name!r} is not known.{nearest(str(name), names)} Give one of {', '.join(names)}."
            )
        return self.over[names.index(name)]

    def values(
        self, over: str, x: Sequence[float], y: Sequence[float], against_motion: bool | None = None
    ) -> dict[str, float]:
        """Return the effect's parameters of a curve over the argument of that name through knots x, y in SI."""
        argument = self.argument(over, "a curve")
        against = argument.against[0] if against_motion is None else against_motion
        return {
            "knots": float(len(x)), "over": float(self.over.index(argument)), "against": float(against),
            **{f"x{k + 1}": float(v) for k, v in enumerate(x)}, **{f"y{k + 1}": float(v) for k, v in enumerate(y)},
        }  # fmt: skip

    def origin_of(self, parameters: Mapping[str, float], place: str) -> str:
        """Return the name of the crane's parameter at which the effect's x begins in E, or ""."""
        origin = self.over[round(parameters["over"])].origin
        return f"cylinders.{place}.{origin}" if origin else ""

    def table(self, parameters: Mapping[str, float]) -> Table:
        """Return the table of the effect's parameters."""
        count = range(1, round(parameters["knots"]) + 1)
        x, y = (tuple(parameters[f"{axis}{k}"] for k in count) for axis in "xy")
        return Table(self.over[round(parameters["over"])], x, y, parameters["against"] > 0.0)

    def check(self, where: str, parameters: Mapping[str, float]) -> None:
        """Raise CraneError, whose message begins with `where`, for a table that is no curve."""
        t = self.table(parameters)
        if not t.x:
            return
        if len(t.x) < 2:
            raise CraneError(f"{where}: found one knot, expected 2 to {KNOTS}.")
        if not all(map(math.isfinite, (*t.x, *t.y))):
            raise CraneError(f"{where}: x and y must be finite numbers.")
        for a, b in zip(t.x, t.x[1:], strict=False):
            if not a < b:
                raise CraneError(f"{where}: x must ascend, found {a:g} before {b:g}. Sort the knots by x.")
        if t.over.magnitude and t.x[0] < 0.0:
            raise CraneError(
                f"{where}: x = {t.x[0]:g} is below 0, but the curve runs over the magnitude of the {t.over.name}. "
                "Begin at 0."
            )
        if t.over.from_zero and (t.x[0] != 0.0 or t.y[0] != 0.0):
            raise CraneError(
                f"{where}: the first knot is ({t.x[0]:g}, {t.y[0]:g}), expected (0, 0): without {t.over.name} nothing "
                "acts."
            )
        if t.against_motion not in t.over.against:
            raise CraneError(
                f"{where}: a curve over {t.over.name} must have against_motion = {str(t.over.against[0]).lower()}."
            )


def value(E: Any, at: int, x: float) -> float:
    """Return the curve whose parameters begin at E[at]: a cubic a stretch, with a continuous derivative, linear in all
    y.

    The derivative in a knot is that of the parabola through it and its neighbours, at the ends that of the last
    stretch. Beyond them the curve goes on straight, as one does of whose bends nothing is known: one that has levelled
    out stays level. What acts against motion stays above 0.
    """
    n = int(E[at])
    a, b = at + X, at + Y
    k = 0
    while k < n - 2 and x > E[a + k + 1]:
        k += 1
    h = E[a + k + 1] - E[a + k]
    d = (E[b + k + 1] - E[b + k]) / h
    left = right = d
    before = after = 0.0
    if k > 0:
        before = E[a + k] - E[a + k - 1]
        left = (h * (E[b + k] - E[b + k - 1]) / before + before * d) / (h + before)
    if k < n - 2:
        after = E[a + k + 2] - E[a + k + 1]
        right = (h * (E[b + k + 2] - E[b + k + 1]) / after + after * d) / (h + after)
    if E[a] <= x <= E[a + k + 1]:
        t = (x - E[a + k]) / h
        c2, c3 = 3.0 * d - 2.0 * left - right, left + right - 2.0 * d
        return E[b + k] + h * t * (left + t * (c2 + t * c3))
    y = E[b] + left * (x - E[a]) if x < E[a] else E[b + k + 1] + right * (x - E[a + k + 1])
    return max(y, 0.0) if E[at + AGAINST] > 0.0 else y
