"""Units at the edge: text with a unit in, SI numbers out."""

from __future__ import annotations

import functools
import math
from typing import Any

from .errors import CraneError


@functools.cache
def registry() -> Any:
    """Return the one pint registry of the process; made on first use, since pint takes a third of a second."""
    import pint

    return pint.UnitRegistry()


def to_si(value: object, unit: str, where: str) -> float:
    """Return `value` in the SI unit `unit`.

    Args:
        value: a number, already in SI, or text with a unit such as "100 bar" or "24 l/min/(7 bar)**0.5".
        unit: the SI unit that is expected, as pint writes it ("" for a pure number).
        where: what the value belongs to, for the error message.

    Raises:
        CraneError: not a number, not finite, or a unit of another dimension.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise CraneError(
            f"{where} = {value!r} is not a number. Write a number in SI, or text with a unit ({unit or '-'})."
        )
    number = _from_text(value, unit, where) if isinstance(value, str) else float(value)
    if math.isnan(number):
        raise CraneError(f"{where} = {value!r} is not a number. Give a value in {unit or 'plain numbers'}.")
    return number


def _from_text(text: str, unit: str, where: str) -> float:
    try:
        quantity = registry().Quantity(text)
    except Exception as problem:  # pint raises many kinds for text that it cannot read
        raise CraneError(f"{where} = {text!r} cannot be read as a number with a unit of {unit or '1'}.") from problem
    try:
        return float(quantity.to(unit or "dimensionless").magnitude)
    except Exception as problem:
        raise CraneError(
            f"{where} = {text!r} has the wrong unit: expected something like {unit or 'a plain number'}."
        ) from problem
