"""The flat vector P of nominal parameters that compiled code reads: the blocks that every machine has, and units by
name.

Every number of a crane file that a fit may move has one name, such as `payload.mass`, used alike in crane files, on the
command line, in JSON results and in error messages. P begins with what all machines have and with a block a cylinder,
so that compiled code finds, say, the bore of cylinder c at ``CYLINDER + N_CYLINDER*c``; where bodies and points stand
behind them says `Machine.topology`.
"""

from __future__ import annotations

_FLUID = ("oil_bulk_modulus", "cylinder_bulk_modulus", "hose_bulk_modulus", "vapour_pressure", "laminar_pressure")
_SUPPLY = ("pump_pressure", "tank_pressure", "air_pressure", "pressure_reference")
_PAYLOAD = ("mass", "width", "height")
_CYLINDER = (
    "bore", "rod", "empty_length", "chamber_range", "hose_volume_piston", "hose_volume_rod",
    "coulomb_friction", "static_friction", "stribeck_speed", "viscous_friction",
)  # fmt: skip
#: edges of a valve: their flow coefficients are that of the valve times these
EDGES = ("pump_to_piston", "pump_to_rod", "piston_to_tank", "rod_to_tank")
_VALVE = ("flow_coefficient", "time_constant", *(f"edges.{edge}" for edge in EDGES))

#: names that every machine has, at the beginning of P
SHARED = (
    "gravity",
    *(f"fluid.{p}" for p in _FLUID),
    *(f"supply.{p}" for p in _SUPPLY),
    *(f"payload.{p}" for p in _PAYLOAD),
)
#: of each body
OF_BODY = ("mass", "com.x", "com.y", "inertia")


def of_cylinder(name: str) -> tuple[str, ...]:
    """Return the names of a cylinder and its valve, in the order of their block of P."""
    return (*(f"cylinders.{name}.{p}" for p in _CYLINDER), *(f"valves.{name}.{p}" for p in _VALVE))


# Where each block begins, and its length per item, as plain integers: compiled code takes them as constants.
GRAVITY, FLUID, SUPPLY, PAYLOAD = 0, 1, 1 + len(_FLUID), 1 + len(_FLUID) + len(_SUPPLY)
CYLINDER, N_CYLINDER = len(SHARED), len(_CYLINDER) + len(_VALVE)
VALVE, N_VALVE = CYLINDER + len(_CYLINDER), N_CYLINDER

#: pint units by the last part of a name; everything else is dimensionless
_UNITS = {
    "mass": "kg", "inertia": "kg*m^2", "x": "m", "y": "m", "width": "m", "height": "m", "bore": "m", "rod": "m",
    "empty_length": "m", "chamber_range": "m", "hose_volume_piston": "m^3", "hose_volume_rod": "m^3",
    "coulomb_friction": "N", "static_friction": "N", "stribeck_speed": "m/s", "viscous_friction": "N*s/m",
    "flow_coefficient": "m^3/s/Pa^0.5", "time_constant": "s", "oil_bulk_modulus": "Pa", "cylinder_bulk_modulus": "Pa",
    "hose_bulk_modulus": "Pa", "vapour_pressure": "Pa", "laminar_pressure": "Pa", "pump_pressure": "Pa",
    "tank_pressure": "Pa", "air_pressure": "Pa", "pressure_reference": "", "gravity": "m/s^2", "direction": "rad",
    **dict.fromkeys(EDGES, ""),
}  # fmt: skip


def unit_of(name: str) -> str:
    """Return the SI unit of a nominal parameter as pint writes it, such as "Pa"."""
    return _UNITS[name.rsplit(".", 1)[-1]]
