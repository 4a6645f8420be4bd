"""A machine that nobody built: a boom that turns, an arm that slides in it, a bucket at its end; three cylinders, names
of its own.
"""

import tomllib

from crane_exudyn import Crane

_CYLINDER = """
bore = 0.1
rod = 0.05
hose_volume_piston = 2e-4
hose_volume_rod = 2e-4
coulomb_friction = 200.0
static_friction = 300.0
stribeck_speed = 5e-3
viscous_friction = 300.0
"""
_TEXT = f"""
name = "made up"
gravity = 9.81

[bodies]
boom = {{ mass = 150.0, com = [1.0, 0.0], inertia = 60.0 }}
arm = {{ mass = 80.0, com = [1.0, 0.0], inertia = 20.0 }}
bucket = {{ mass = 40.0, com = [0.3, 0.0], inertia = 3.0 }}

[payload]
body = "bucket"
at = "T"
mass = 50.0
width = 0.2
height = 0.2

[[joint]]
name = "foot"
bodies = ["ground", "boom"]
coordinate = "boom"

[[joint]]
name = "slot"
kind = "prismatic"
bodies = ["boom", "arm"]
direction = 0.0
coordinate = "reach"

[[joint]]
name = "wrist"
bodies = ["arm", "bucket"]
coordinate = "bucket"

[joints]
foot = [0.0, 1.0]
slot = [0.5, 0.0]
wrist = [2.0, 0.0]
T = [0.6, 0.0]

[cylinders.hoist]
bodies = ["ground", "boom"]
base = [0.6, 0.2]
rod_end = [1.2, 0.0]
chambers = ["a1", "b1"]
length = "x1"
command = "c1"
voltage = "V1"
empty_length = 0.5
chamber_range = 1.4
{_CYLINDER}
[cylinders.slide]
bodies = ["boom", "arm"]
base = [0.3, 0.2]
rod_end = [0.4, 0.2]
chambers = ["a2", "b2"]
length = "x2"
command = "c2"
voltage = "V2"
empty_length = 0.6
chamber_range = 0.9
{_CYLINDER}
[cylinders.curl]
bodies = ["arm", "bucket"]
base = [1.2, 0.3]
rod_end = [0.1, 0.3]
chambers = ["a3", "b3"]
loaded = "b3"
length = "x3"
command = "c3"
voltage = "V3"
empty_length = 0.5
chamber_range = 0.8
{_CYLINDER}
[valves]
hoist = {{ flow_coefficient = 5e-7, time_constant = 0.03 }}
slide = {{ flow_coefficient = 5e-7, time_constant = 0.03 }}
curl = {{ flow_coefficient = 5e-7, time_constant = 0.03 }}

[fluid]
oil_bulk_modulus = 1.65e9
cylinder_bulk_modulus = 2.1e11
hose_bulk_modulus = 7e8
vapour_pressure = 0.0
laminar_pressure = 2e5

[supply]
pump_pressure = 1e7
tank_pressure = 1e5

[initial]
boom = "20 deg"
reach = 0.5
bucket = "-30 deg"
"""


def made_up() -> Crane:
    """Return the made-up machine as a crane."""
    return Crane.from_document(tomllib.loads(_TEXT), "made up")
