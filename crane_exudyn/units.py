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
    try:
        number = _from_text(value, unit, where) if isinstance(value, str) else float(value)
    except OverflowError:  # a whole number of more than 308 digits
        number = math.inf
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


#: units that files usually carry, with what one of them is in SI; only other ones need pint, which takes long to load
_USUAL: dict[tuple[str, str], float] = {
    **{("s", u): f for u, f in {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0}.items()},
    **{("rad", u): f for u, f in {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180}.items()},
    **{("rad/s", u): f for u, f in {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180}.items()},
    **{("Pa", u): f for u, f in {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 1e2}.items()},
    **{("m", u): f for u, f in {"m": 1.0, "cm": 1e-2, "mm": 1e-3}.items()},
    **{("V", u): f for u, f in {"V": 1.0, "mV": 1e-3}.items()},
    **{("", u): f for u, f in {"": 1.0, "-": 1.0, "1": 1.0, "%": 1e-2}.items()},
}


@functools.cache
def factor_to_si(unit: str, si_unit: str) -> float:
    """Return what one `unit` is in `si_unit`; angles are no pure numbers here, so "%" or "1" is not taken for "rad".

    Raises:
        CraneError: a unit that pint does not know, of another dimension, or with an offset such as degC.
    """
    usual = _USUAL.get((si_unit, unit))
    if usual is not None:
        return usual
    expected = si_unit or "a pure number"
    try:
        quantity = registry().Quantity(1.0, unit.replace("°", "deg"))
        base, wanted = quantity.to_base_units().units, registry().Quantity(1.0, si_unit or "dimensionless")
    except Exception as problem:  # pint raises many kinds for text that it cannot read
        raise CraneError(f"unit [{unit}] is not known, expected one like [{si_unit or '-'}]") from problem
    if base != wanted.to_base_units().units:
        raise CraneError(f"unit [{unit}] has the wrong dimension, expected {expected}")
    return float(quantity.to(wanted.units).magnitude)
