"""Laws that are curves through knots: what they may run over, their table, and their value in compiled code."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import FunctionType
from typing import Any

import numpy as np

from ..errors import CraneError, nearest, refuse_unknown
from ..units import factor_to_si, to_si
from .parameter import Parameter

#: the most knots of a curve; in E stand their number, what the curve runs over, whether it acts against motion, all x,
#: all y
KNOTS = 20
NUMBER, OVER, AGAINST, X, Y = 0, 1, 2, 3, 3 + KNOTS
#: what the table of a curve holds
_TABLE = ("over", "against_motion", "unit_over", "x", "unit", "y")


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

    def read(self, table: object, where: str) -> dict[str, float]:
        """Return the effect's parameters of the table that a curve is in a crane file, its numbers in the units that it
        states, or SI. Raises CraneError, whose message begins with `where`, for one that is none.
        """
        if not isinstance(table, Mapping) or "over" not in table:
            names = ", ".join(a.name for a in self.over)
            raise CraneError(f"{where} need a table with over (one of {names}), x = [...] and y = [...].")
        refuse_unknown(where, table, _TABLE)
        over, against = self.argument(table["over"], where), table.get("against_motion")
        if not (against is None or isinstance(against, bool)):
            raise CraneError(f"{where}: against_motion = {against!r} should be true or false.")
        x = _knots(table.get("x"), table.get("unit_over", over.unit), over.unit, f"{where}: x")
        y = _knots(table.get("y"), table.get("unit", self.unit), self.unit, f"{where}: y")
        if len(x) != len(y):
            raise CraneError(f"{where}: found {len(x)} x and {len(y)} y. Give one y for each x.")
        return self.values(over.name, x, y, against)

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


def _knots(numbers: object, unit: object, si_unit: str, where: str) -> list[float]:
    """Return numbers (or texts with a unit of their own) that have a unit, in SI."""
    numbers = numbers.tolist() if isinstance(numbers, np.ndarray) else numbers
    if not isinstance(numbers, list | tuple) or not 2 <= len(numbers) <= KNOTS:
        raise CraneError(f"{where} = {str(numbers)[:60]} should be a list of 2 to {KNOTS} numbers.")
    try:
        factor = factor_to_si(str(unit), si_unit)
    except CraneError as problem:
        raise CraneError(f"{where}: {problem}.") from None
    each = enumerate(numbers, 1)
    return [to_si(v, si_unit, f"{where}, entry {k}") * (1.0 if isinstance(v, str) else factor) for k, v in each]


def with_compiled_value(law: Any, compiled: Callable[[Any], Any]) -> Any:
    """Return an effect's hook as compiled code must have it: where it asks for the value of a curve, for one that is
    `compiled`.
    """
    if law.__globals__.get("value") is not value:
        return law
    return FunctionType(law.__code__, law.__globals__ | {"value": compiled(value)}, law.__name__)


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
