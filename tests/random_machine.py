"""Machines drawn at random, as crane files: 1 to 4 driven joints, 0 to 2 loops, revolute and prismatic."""

import math

import numpy as np

from crane_exudyn import Crane, CraneError
from validation.crosscheck_cases import random_states


def _turned(angle, v):
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * v[0] - s * v[1], s * v[0] + c * v[1]])


def _vector(rng, low, high):
    return _turned(rng.uniform(-math.pi, math.pi), (rng.uniform(low, high), 0.0))


class Draw:
    """A crane file that grows body by body; frames hold where each body's frame stands at the start."""

    def __init__(self, rng):
        self.rng, self.frames, self.loops = rng, {"ground": (np.zeros(2), 0.0)}, 0
        self.file = {
            "joint": [],
            "joints": {},
            "bodies": {},
            "cylinders": {},
            "valves": {},
            "initial": {},
            "independent": [],
        }

    def place(self, body, local):
        origin, angle = self.frames[body]
        return origin + _turned(angle, local)

    def local(self, body, place):
        origin, angle = self.frames[body]
        return _turned(-angle, place - origin)

    def add_body(self, name):
        rng = self.rng
        com = [rng.uniform(0.2, 0.8), rng.uniform(-0.2, 0.2)]
        self.file["bodies"][name] = {"mass": rng.uniform(20, 200), "com": com, "inertia": rng.uniform(2, 60)}

    def add_joint(self, i, carrier):
        """Add a body on a carrier; return whether it slides."""
        rng, name = self.rng, f"body_{i}"
        slides, pin = rng.random() < 0.25, np.array([rng.uniform(0.6, 1.5), rng.uniform(-0.3, 0.3)])
        angle = self.frames[carrier][1]
        joint = {"name": f"J{i}", "bodies": [carrier, name], "coordinate": f"q{i}"}
        z, direction = (rng.uniform(0.2, 0.5), rng.uniform(-0.5, 0.5)) if slides else (rng.uniform(-0.8, 0.8), 0.0)
        place = self.place(carrier, pin)
        if slides:
            joint |= {"kind": "prismatic", "direction": direction}
            place = place + z * _turned(angle + direction, (1.0, 0.0))
        turned = angle if slides else angle + z
        own = np.array([0.0, 0.0])
        if rng.random() < 0.5:  # its frame begins elsewhere
            own = rng.uniform(-0.2, 0.2, 2)
            joint["on"], self.file["joints"][f"K{i}"] = f"K{i}", own.tolist()
        self.frames[name] = (place - _turned(turned, own), turned)
        self.file["joints"][f"J{i}"] = pin.tolist()
        self.file["joint"].append(joint)
        self.file["initial"][f"q{i}"] = z
        self.file["independent"].append(f"q{i}")
        self.add_body(name)
        return slides, direction

    def add_loop(self, i, carrier):
        """Add a rocker on the carrier and a link from it to body i; return the rocker and its far pin."""
        rng, k = self.rng, self.loops
        self.loops += 1
        rocker, link, body = f"rocker_{k}", f"link_{k}", f"body_{i}"
        at = self.place(carrier, self.file["joints"][f"J{i}"])
        first, last = at + _vector(rng, 0.2, 0.4), at + _vector(rng, 0.2, 0.4)
        along = last - first
        r1, r2 = np.hypot(*along) * rng.uniform(0.75, 1.1, 2) + 0.1
        share = 0.5 * (r1**2 - r2**2 + along @ along) / (along @ along)
        height = math.sqrt(r1**2 / (along @ along) - share**2)
        side = 1.0 if rng.random() < 0.5 else -1.0
        corner = first + share * along + side * height * np.array([-along[1], along[0]])
        for name, start, end in ((rocker, first, corner), (link, corner, last)):
            self.frames[name] = (start, math.atan2(*(end - start)[::-1]))
            self.add_body(name)
        points = {f"B{k}": (carrier, first), f"C{k}": (rocker, corner), f"D{k}": (link, last), f"E{k}": (body, last)}
        self.file["joints"] |= {name: self.local(on, place).tolist() for name, (on, place) in points.items()}
        self.file["joint"] += [
            {"name": f"B{k}", "bodies": [carrier, rocker], "coordinate": f"r{k}"},
            {"name": f"C{k}", "bodies": [rocker, link], "coordinate": f"l{k}"},
            {"name": f"D{k}", "bodies": [link, body], "on": f"E{k}", "bend": "left" if side > 0 else "right"},
        ]
        return rocker, corner

    def add_cylinder(self, i, carrier, end_body, end, base):
        rng, name = self.rng, f"cylinder_{i}"
        length = float(np.hypot(*(end - base)))
        self.file["cylinders"][name] = {
            "bodies": [carrier, end_body], "base": self.local(carrier, base).tolist(),
            "rod_end": self.local(end_body, end).tolist(),
            "bore": rng.uniform(0.05, 0.1), "rod": rng.uniform(0.02, 0.045), "empty_length": length - 0.25,
            "chamber_range": 0.55,
            "hose_volume_piston": 2e-4, "hose_volume_rod": 2e-4, "coulomb_friction": 200.0, "static_friction": 280.0,
            "stribeck_speed": 5e-3, "viscous_friction": 300.0,
        }  # fmt: skip
        if rng.random() < 0.5:
            self.file["cylinders"][name]["loaded"] = f"p{2 * i + 2}"
        edges = dict(
            zip(
                ("pump_to_piston", "pump_to_rod", "piston_to_tank", "rod_to_tank"),
                rng.uniform(0.5, 1.5, 4).tolist(),
                strict=True,
            )
        )
        self.file["valves"][name] = {"flow_coefficient": 6e-7, "time_constant": 0.03, "edges": edges}


def random_machine(seed):
    """Return a Crane whose machine is drawn at random, anew until it can move."""
    rng = np.random.default_rng(seed)
    while True:
        try:
            crane = _drawn(f"random machine {seed}", rng)
            random_states(crane, 2, rng)
        except CraneError:
            continue
        return crane


def _drawn(name, rng):
    draw = Draw(rng)
    carriers = ["ground"]
    for i in range(rng.integers(1, 5)):
        carrier = carriers[-1] if rng.random() < 0.8 or i == 0 else carriers[rng.integers(1, len(carriers))]
        slides, direction = draw.add_joint(i, carrier)
        body = f"body_{i}"
        pin = draw.place(carrier, draw.file["joints"][f"J{i}"])
        angle = draw.frames[carrier][1]
        if slides:
            u = _turned(angle + direction, (1.0, 0.0))
            base, end, on = pin - 0.5 * u, pin + (draw.file["initial"][f"q{i}"] + 0.3) * u, body
        else:
            arm = _vector(rng, 0.3, 0.6)
            end, on = pin + arm, body
            base = pin + _turned(rng.choice((-1.0, 1.0)) * rng.uniform(0.8, 2.0), arm) * rng.uniform(1.0, 2.0)
            if draw.loops < 2 and rng.random() < 0.5:
                rocker, corner = draw.add_loop(i, carrier)
                if rng.random() < 0.5:
                    first = draw.frames[rocker][0]
                    end, on = corner, rocker
                    base = first + _turned(
                        rng.choice((-1.0, 1.0)) * rng.uniform(0.8, 2.0), corner - first
                    ) * rng.uniform(1.0, 2.0)
        draw.add_cylinder(i, carrier, on, end, base)
        carriers.append(body)
    if rng.random() < 0.8:
        draw.file["payload"] = {"body": carriers[-1], "at": "tip", "mass": 80.0, "width": 0.3, "height": 0.3}
        draw.file["joints"]["tip"] = [1.0, 0.1]
    document = draw.file | {
        "name": name,
        "gravity": 9.81,
        "fluid": {
            "oil_bulk_modulus": 1.5e9,
            "cylinder_bulk_modulus": 2.1e11,
            "hose_bulk_modulus": 7e8,
            "vapour_pressure": 0.0,
            "laminar_pressure": 2e5,
        },
        "supply": {
            "pump_pressure": 200e5,
            "tank_pressure": 1e5,
            "air_pressure": 1.013e5,
            "pressure_reference": "absolute",
        },
    }
    return Crane.from_document(document, document["name"])
