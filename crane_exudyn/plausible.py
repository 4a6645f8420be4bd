"""Numbers that a machine could have, but hardly any has: mostly those of which the unit was left out.

What no machine can have is refused (`description`). Here are wider bounds for each quantity, beyond which a number is
told with the unit that it was probably meant in.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple

from .channels import BEYOND
from .description import Description
from .parameters import unit_of
from .units import factor_to_si


class Quantity(NamedTuple):
    """One kind of number of a crane file.

    Attributes:
        least, most: between which its size lies, in SI; nothing at all is always plausible.
        usual: that of a common machine; units: in which people give it.
    """

    least: float
    most: float
    usual: float
    units: tuple[str, ...]


_LENGTH, _DIAMETER = Quantity(0.0, 50.0, 1.0, ("mm", "cm")), Quantity(1e-3, 2.0, 0.06, ("mm", "cm"))
_ANGLE = Quantity(0.0, BEYOND["rad"], 0.5, ("deg",))
_HOSE = Quantity(1e-8, 0.1, 3e-4, ("l", "cm^3", "mm^3"))
_PRESSURE = Quantity(100.0, 2e8, 1e7, ("bar", "MPa", "kPa", "psi"))
_LOW_PRESSURE = _PRESSURE._replace(most=1e7, usual=1e5)
_STIFFNESS = Quantity(1e6, 1e15, 1.5e9, ("MPa", "GPa", "bar", "kPa"))
_FRICTION = Quantity(0.0, 1e6, 300.0, ())
#: by the last part of a parameter's name
_QUANTITIES = {
    **dict.fromkeys(("x", "y", "width", "height", "empty_length", "chamber_range"), _LENGTH),
    **dict.fromkeys(("bore", "rod"), _DIAMETER),
    **dict.fromkeys(("hose_volume_piston", "hose_volume_rod"), _HOSE),
    "direction": _ANGLE,
    "mass": Quantity(0.0, 1e6, 100.0, ("g", "lb")),
    "inertia": Quantity(0.0, 1e9, 30.0, ("kg*cm^2", "kg*mm^2")),
    "gravity": Quantity(0.0, 100.0, 9.81, ("mm/s^2",)),
    "oil_bulk_modulus": _STIFFNESS,
    "hose_bulk_modulus": _STIFFNESS._replace(usual=7e8),
    "cylinder_bulk_modulus": _STIFFNESS._replace(usual=2e11),
    "pump_pressure": _PRESSURE._replace(least=1e4, usual=2e7),
    "tank_pressure": _LOW_PRESSURE,
    "air_pressure": _LOW_PRESSURE._replace(most=1e6),
    "laminar_pressure": _LOW_PRESSURE,
    "vapour_pressure": _LOW_PRESSURE._replace(least=0.0),
    **dict.fromkeys(("coulomb_friction", "static_friction"), _FRICTION),
    "viscous_friction": Quantity(0.0, 1e8, 500.0, ()),
    "stribeck_speed": Quantity(0.0, 1.0, 5e-3, ("mm/s",)),
    "flow_coefficient": Quantity(1e-11, 1e-3, 4e-7, ("l/min/(7 bar)**0.5",)),
    "time_constant": Quantity(0.0, 5.0, 0.03, ("ms",)),
}  # fmt: skip
#: remarks that are told of one machine: one mistake may be in every line
_MOST_REMARKS = 3


def implausible(crane: Description) -> list[str]:
    """Return a sentence on each number that hardly any machine has, with the mend; of many the first ones, and how many
    more there are.
    """
    found = [
        _remark(name, value, unit, quantity)
        for name, value, unit, quantity in _numbers(crane)
        if value and not quantity.least <= abs(value) <= quantity.most
    ]
    more = len(found) - _MOST_REMARKS
    return [*found[:_MOST_REMARKS], f"{more} more numbers are as implausible."] if more > 1 else found


def _numbers(crane: Description) -> Iterator[tuple[str, float, str, Quantity]]:
    """Yield name, value, SI unit and quantity of each number that has plausible bounds."""
    for name, value in crane.values.items():
        quantity = _QUANTITIES.get(name.rsplit(".", 1)[-1])
        if quantity is not None:
            yield name, value, unit_of(name), quantity
    lay, start = crane.layout, crane.initial
    for name, value in zip(lay.coordinates, start.pose, strict=True):
        if lay.unit_of(name) == "m":  # angles without unit are refused
            yield f"initial.{name}", value, "m", _LENGTH
    each = start.less_loaded_pressure
    for value in set(each) if isinstance(each, tuple) else {each}:
        yield "initial.less_loaded_pressure", value, "Pa", _PRESSURE._replace(usual=1e6)


def _remark(name: str, value: float, unit: str, quantity: Quantity) -> str:
    least = f"{quantity.least:.3g} to" if quantity.least else "at most"
    units = {u: abs(value) * factor_to_si(u, unit) for u in quantity.units}
    fitting = [u for u, size in units.items() if quantity.least <= size <= quantity.most]
    mend = "Correct the value or its unit."
    if fitting:
        meant = min(fitting, key=lambda u: abs(math.log(units[u] / quantity.usual)))
        mend = f'Give it with its unit, such as "{value:.6g} {meant}".'
    return f"{name} = {value:g} {unit} is implausible: expected {least} {quantity.most:.3g} {unit}. {mend}"
