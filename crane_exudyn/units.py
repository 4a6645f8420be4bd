"""Units at the edge: text with a unit in, SI numbers out."""

from __future__ import annotations

import ast
import functools
import math
import re
from typing import Any, TypeGuard

from .errors import CraneError, shortened


@functools.cache
def registry() -> Any:
    """Return the one pint registry of the process; made on first use, since pint takes a third of a second."""
    import pint

    return pint.UnitRegistry()


def to_si(value: object, unit: str, where: str, *, infinite: bool = False) -> float:
    """Return `value` in the SI unit `unit`.

    Args:
        value: a number, already in SI, or text with a unit such as "100 bar" or "24 l/min/(7 bar)**0.5".
        unit: the SI unit that is expected, as pint writes it ("" for a pure number).
        where: what the value belongs to, for the error message.
        infinite: whether it may be infinite, as a limit that there is not.

    Raises:
        CraneError: not a number, not finite unless it may be, or a unit of another dimension.
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
    if math.isinf(number) and not infinite:
        raise CraneError(f"{where} = {shortened(value)} is not finite. Give a number in {unit or 'plain numbers'}.")
    return number


def _from_text(text: str, unit: str, where: str) -> float:
    try:
        quantity = _quantity(text)
    except CraneError as problem:
        raise CraneError(f"{where} = {text!r}: {problem}.") from None
    except Exception as problem:  # pint raises many kinds for text that it cannot read
        raise CraneError(f"{where} = {text!r} cannot be read as a number with a unit of {unit or '1'}.") from problem
    try:
        return float(quantity.to(unit or "dimensionless").magnitude)
    except Exception as problem:
        if unit and quantity.unitless:
            raise CraneError(f"{where} = {text!r} has no unit. Write one, such as '{text} {unit}'.") from problem
        raise CraneError(
            f"{where} = {text!r} has the wrong unit: expected something like {unit or 'a plain number'}."
        ) from problem


# -- what pint would read, but not as it was meant ---------------------------------------------------------------------

#: a run of digits with everything that people put between them, and what of that is one number
_DIGITS = re.compile(r"[\d.,_'’]*\d[\d.,_'’]*(?:\s+[\d.,_'’]*\d[\d.,_'’]*)*")
_NUMBER, _DECIMAL_COMMA = re.compile(r"\d+\.?\d*|\.\d+"), re.compile(r"\d*,\d+")
_THOUSANDS = re.compile(r"[1-9]\d{0,2}(,\d{3})+")
_BROKEN_EXPONENT = re.compile(r"\d\.?[eE][+-]?\d+[.,]")
#: signs of other alphabets that people and word processors write for those of a formula
_OTHER_SIGNS = str.maketrans({"−": "-", "‐": "-", "‑": "-", "–": "-", "×": "*", "⋅": "*"})
#: what stands in a value or unit beside letters, digits and superscripts; pint drops other signs without a word
_SIGNS = frozenset(".+-⁻*/^()_%°·")
#: characters of a value, and exponents, that no value of a crane exceeds
_LONGEST, _GREATEST_POWER = 200, 30.0


def _quantity(text: str) -> Any:
    """Return the pint quantity of a text; what pint would silently take for something else is refused before it
    computes.

    Pint drops commas and all signs that it does not know ("5 ± 0.1 m" is 0.5 m to it), multiplies numbers that stand
    side by side, computes powers of powers, and takes Grad for a giga-radian.

    Raises:
        CraneError: the reason, without the place; and whatever pint raises for text that it cannot read.
    """
    from pint.util import string_preprocessor

    if len(text) > _LONGEST:
        raise CraneError(f"the text is {len(text)} characters long, expected a number and a unit")
    plain = _known_signs(_with_points(text.translate(_OTHER_SIGNS)))
    _refuse_towers(string_preprocessor(plain))
    quantity = registry().Quantity(plain)
    _refuse_great_angles(quantity)
    return quantity


def _known_signs(text: str) -> str:
    """Return the text itself; a sign that is none of a number or unit is refused."""
    for sign in text:
        if not (sign.isalnum() or sign.isspace() or sign in _SIGNS):
            raise CraneError(f"{sign!r} cannot occur in a number or unit. Write one number and one unit")
    return text


def _with_points(text: str) -> str:
    """Return the text with decimal commas as points; a comma or a space that may group thousands is refused."""

    def mended(found: re.Match[str]) -> str:
        number = found.group()
        if _NUMBER.fullmatch(number):
            return number
        if _DECIMAL_COMMA.fullmatch(number) and not _THOUSANDS.fullmatch(number):
            return number.replace(",", ".")
        raise CraneError(f"{number!r} is not one plain number. Write a decimal point and no thousands separator")

    plain = _DIGITS.sub(mended, text)
    if "," in plain or _BROKEN_EXPONENT.search(text):
        raise CraneError("a comma or point is outside a number. Write one number and one unit")
    return plain


def _refuse_towers(text: str) -> None:
    """Refuse powers of powers and exponents beyond those of units: computing 9**9**9 takes for ever."""
    if "**" not in text:
        return
    try:
        powers = [n for n in ast.walk(ast.parse(text, mode="eval")) if _is_power(n)]
    except SyntaxError:
        raise CraneError("it cannot be read. Write one number and one unit") from None
    if any(_is_power(inner) for p in powers for inner in ast.walk(p.left)) or not all(map(_is_modest, powers)):
        raise CraneError("a power of a power, or an exponent too large for a unit. Write the number itself")


def _is_power(node: ast.AST) -> TypeGuard[ast.BinOp]:
    return isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow)


def _is_modest(power: ast.BinOp) -> bool:
    """Return whether all numbers of an exponent are small, and nothing but signs and fractions joins them."""
    allowed = (ast.Constant, ast.UnaryOp, ast.USub, ast.UAdd, ast.BinOp, ast.Div)
    nodes = list(ast.walk(power.right))
    numbers = [n.value for n in nodes if isinstance(n, ast.Constant)]
    small = all(isinstance(x, int | float) and abs(x) <= _GREATEST_POWER for x in numbers)
    return small and all(isinstance(n, allowed) for n in nodes)


def _refuse_great_angles(quantity: Any) -> None:
    """Refuse angles in thousands and more: somebody wrote Grad for degrees."""
    known = registry()
    for name, _ in quantity.unit_items():
        for prefix, base, _ in known.parse_unit_name(name):
            great = prefix and known.Quantity(1.0, f"{prefix}meter").to("meter").magnitude > 1.0
            if great and known.Quantity(1.0, base).is_compatible_with("radian"):
                raise CraneError(f"the unit is read as {prefix}{base}. Write deg for degrees")


#: units that files usually carry, with what one of them is in SI; only other ones need pint, which takes long to load
_USUAL: dict[tuple[str, str], float] = {
    **{("s", u): f for u, f in {"s": 1.0, "sec": 1.0, "ms": 1e-3, "us": 1e-6, "µs": 1e-6, "min": 60.0}.items()},
    **{("rad", u): f for u, f in {"rad": 1.0, "mrad": 1e-3, "deg": math.pi / 180, "°": math.pi / 180}.items()},
    **{("rad/s", u): f for u, f in {"rad/s": 1.0, "deg/s": math.pi / 180, "°/s": math.pi / 180}.items()},
    **{
        ("Pa", u): f
        for u, f in {"Pa": 1.0, "kPa": 1e3, "MPa": 1e6, "bar": 1e5, "mbar": 1e2, "psi": 6894.757293168361}.items()
    },
    **{("m", u): f for u, f in {"m": 1.0, "cm": 1e-2, "mm": 1e-3}.items()},
    **{("m/s", u): f for u, f in {"m/s": 1.0, "mm/s": 1e-3}.items()},
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
    if si_unit == "Pa" and reference_of(unit):
        raise CraneError(
            f"unit [{unit}]: the crane file states the reference of pressures, not the unit. {reference_mend(unit)}"
        )
    try:
        quantity = 1.0 * _quantity(unit)
        base, wanted = quantity.to_base_units().units, registry().Quantity(1.0, si_unit or "dimensionless")
    except CraneError as problem:
        raise CraneError(f"unit [{unit}]: {problem}") from None
    except Exception as problem:  # pint raises many kinds for text that it cannot read
        raise CraneError(f"unit [{unit}] is not known, expected one like [{si_unit or '-'}]") from problem
    if base != wanted.to_base_units().units:
        raise CraneError(f"unit [{unit}] has the wrong dimension, expected {expected}")
    return float(quantity.to(wanted.units).magnitude)


#: units in which people read and write, by SI unit
PEOPLE = {"rad": "deg", "rad/s": "deg/s", "Pa": "bar", "m": "mm", "m/s": "mm/s"}


def people_of(si_unit: str) -> tuple[str, float]:
    """Return the unit in which people read a quantity of an SI unit, and what one of it is in SI."""
    unit = PEOPLE.get(si_unit, si_unit)
    return unit, factor_to_si(unit, si_unit) if si_unit in PEOPLE else 1.0


def unit_of(size: float, si_unit: str) -> str | None:
    """Return the usual unit of which one is `size` in `si_unit`, None where there is none."""
    return next((u for (si, u), f in _USUAL.items() if si == si_unit and math.isclose(f, size, rel_tol=_SAME)), None)


#: relative difference of a factor within which it is that of a unit
_SAME = 1e-6
#: a unit of pressure with what it counts from, as in barg, bar(g), psi abs, barü
_REFERENCED = re.compile(r"(\w+?)[\s_]*\(?(?:(g|gauge|rel|ü)|(a|abs))\)?", re.IGNORECASE)
#: Pa of air on the ground, from which gauge pressures count
_AIR = 101325.0


@functools.cache
def reference_of(unit: str) -> tuple[str, str] | None:
    """Return the plain unit of "barg", "psi(a)" and the like, and whether it is of "gauge" or "absolute" pressures;
    None for any other unit.
    """
    found = _REFERENCED.fullmatch(unit.strip())
    if found is None or ("Pa", unit) in _USUAL:
        return None
    try:
        factor_to_si(found[1], "Pa")
    except CraneError:  # what stands before the letter is no pressure, as in Pa itself or mmHg
        return None
    return found[1], "gauge" if found[2] else "absolute"


def reference_mend(unit: str) -> str:
    """Return what to write of pressures in a unit that says what they count from, which the crane file says of all."""
    plain, reference = reference_of(unit) or (unit, "gauge")
    air = _AIR / factor_to_si(plain, "Pa")
    offset, other = (f"{air:.6g}", "absolute") if reference == "gauge" else (f"{-air:.6g}", "gauge")
    return (
        f'Write unit = "{plain}" into a map file (--map-file), and offset = "{offset} {plain}" if the crane file\'s '
        f"pressures are {other} (supply.pressure_reference)"
    )
