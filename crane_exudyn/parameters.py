"""The flat vector P of nominal parameters that compiled code reads, and the names behind its places.

Every number of a crane file that a fit may move has one name, such as `payload.mass`, used alike in crane files,
on the command line, in JSON results and in error messages. The vector is laid out in regular blocks, so that compiled
code finds, say, the mass of body k at ``BODY + 4*k``.
"""

from __future__ import annotations

from .layout import Layout

BODIES = ("lift_boom", "bracket_1", "bracket_2", "outer_boom")
#: the PATU's own names
LAYOUT = Layout(
    coordinates=("z1", "z4"), joints=("O", "A"), bodies=("lift_boom", "outer_boom"), parents=("", "z1"),
    cylinders=("lift", "tilt"), sides=(("p1", "p2"), ("p3", "p4")), loaded=("p1", "p4"), lengths=("s1", "s2"),
    commands=("u1", "u2"), voltages=("U1", "U2"), driven=("z1", "z4"), added=("theta", "dtheta"),
)  # fmt: skip
CYLINDERS = LAYOUT.cylinders
#: points in the frame of the body named beside them; the order is that of the block POINT
POINTS = {
    "joints.O": "pillar",
    "cylinders.lift.base": "pillar",  # F
    "cylinders.lift.rod_end": "lift_boom",  # G
    "cylinders.tilt.base": "lift_boom",  # H
    "joints.B": "lift_boom",
    "joints.A": "lift_boom",
    "joints.C": "bracket_1",  # also the rod end of the tilt cylinder
    "joints.D_bracket": "bracket_2",
    "joints.D": "outer_boom",
    "joints.E": "outer_boom",
}
POINT_NAMES = ("O", "F", "G", "H", "B", "A", "C", "D_bracket", "D", "E")

_BODY = ("mass", "com.x", "com.y", "inertia")
_PAYLOAD = ("mass", "width", "height")
_CYLINDER = (
    "bore", "rod", "empty_length", "chamber_range", "hose_volume_piston", "hose_volume_rod",
    "coulomb_friction", "static_friction", "stribeck_speed", "viscous_friction",
)  # fmt: skip
_VALVE = ("flow_coefficient", "time_constant")
_FLUID = ("oil_bulk_modulus", "cylinder_bulk_modulus", "hose_bulk_modulus", "vapour_pressure", "laminar_pressure")
_SUPPLY = ("pump_pressure", "tank_pressure", "air_pressure", "pressure_reference")

#: names of all nominal parameters, in the order of the vector P
NAMES: tuple[str, ...] = (
    *(f"bodies.{b}.{p}" for b in BODIES for p in _BODY),
    *(f"payload.{p}" for p in _PAYLOAD),
    *(f"{p}.{axis}" for p in POINTS for axis in "xy"),
    *(f"cylinders.{c}.{p}" for c in CYLINDERS for p in _CYLINDER),
    *(f"valves.{c}.{p}" for c in CYLINDERS for p in _VALVE),
    *(f"fluid.{p}" for p in _FLUID),
    *(f"supply.{p}" for p in _SUPPLY),
    "gravity",
)
INDEX: dict[str, int] = {name: i for i, name in enumerate(NAMES)}

# Where each block begins, and its length per item, as plain integers: compiled code takes them as constants.
BODY, N_BODY = INDEX["bodies.lift_boom.mass"], len(_BODY)
PAYLOAD = INDEX["payload.mass"]
POINT = INDEX["joints.O.x"]  # point k of POINT_NAMES stands at POINT + 2*k
CYLINDER, N_CYLINDER = INDEX["cylinders.lift.bore"], len(_CYLINDER)
VALVE, N_VALVE = INDEX["valves.lift.flow_coefficient"], len(_VALVE)
FLUID = INDEX["fluid.oil_bulk_modulus"]
SUPPLY = INDEX["supply.pump_pressure"]
GRAVITY = INDEX["gravity"]

#: pint units by the last part of a name; everything else is dimensionless
_UNITS = {
    "mass": "kg", "inertia": "kg*m^2", "x": "m", "y": "m", "width": "m", "height": "m", "bore": "m", "rod": "m",
    "empty_length": "m", "chamber_range": "m", "hose_volume_piston": "m^3", "hose_volume_rod": "m^3",
    "coulomb_friction": "N", "static_friction": "N", "stribeck_speed": "m/s", "viscous_friction": "N*s/m",
    "flow_coefficient": "m^3/s/Pa^0.5", "time_constant": "s", "oil_bulk_modulus": "Pa", "cylinder_bulk_modulus": "Pa",
    "hose_bulk_modulus": "Pa", "vapour_pressure": "Pa", "laminar_pressure": "Pa", "pump_pressure": "Pa",
    "tank_pressure": "Pa", "air_pressure": "Pa", "pressure_reference": "", "gravity": "m/s^2",
}  # fmt: skip


def unit_of(name: str) -> str:
    """Return the SI unit of a nominal parameter as pint writes it, such as "Pa"."""
    return _UNITS[name.rsplit(".", 1)[-1]]
