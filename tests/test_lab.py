"""The crane file of the measured rig, and the two laws that its recording asked for."""

import math
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn import Crane
from crane_exudyn.effects import hooks
from crane_exudyn.effects.registry import slot
from crane_exudyn.geometry import pose
from validation.semi_recursive import SemiRecursiveEngine


@pytest.fixture(scope="module")
def lab():
    return Crane.load("patu655-lab")


def test_every_number_has_a_source(lab):
    assert [n for n in lab.machine.names if not any(fnmatchcase(n, pattern) for pattern in lab.sources)] == []


def test_five_volts_lift_and_neutral_does_nothing(lab):
    volts = np.array([[5.8, 5.8], [5.0, 5.8], [6.4, 5.8], [2.9, 8.7]])
    u1, u2 = lab.commands_from_voltages(volts).T
    assert u1 == pytest.approx([0.0, 0.8 / 2.9, -0.6 / 2.9, 1.0])
    assert u2 == pytest.approx([0.0, 0.0, 0.0, -1.0])


def test_dead_band_in_volts(lab):
    volts = np.array([5.25, 5.15, 6.15, 6.25])
    commands = lab.commands_from_voltages(np.column_stack([volts, volts]))[:, 0]
    opening = [hooks.opening(lab.effect_vector(), 0, u) for u in commands]
    assert opening[0] == 0.0 < opening[1]
    assert opening[2] == 0.0 > opening[3]


def test_cylinder_lengths_are_the_public_models(lab):
    """Read off that model's curves: z1 = 0.779 deg with s1 = 943.2 mm, z4 = -46.19 deg with s2 = 1281 mm."""
    found = pose(lab, math.radians(0.779), math.radians(-46.19)).lengths
    assert np.ravel(found) == pytest.approx([0.9432, 1.281], abs=1e-3)  # the curves are read to half a millimetre


def test_crane_file_survives_writing(lab, tmp_path):
    lab.save(tmp_path / "lab.toml")
    again = Crane.load(tmp_path / "lab.toml")
    assert (again.values, again.effects, again.voltage) == (lab.values, lab.effects, lab.voltage)


def test_released_air_has_the_volume_of_the_gas_law(lab):
    alpha, ps = 0.1, 5e5
    E = lab.with_effect("released_air", {"alpha": alpha, "ps": ps}).effect_vector()
    p = np.linspace(0.5e5, 0.8 * ps, 20001)
    share, compliance = np.array([hooks.free_gas(E, x) for x in p]).T
    volume = alpha * 1e5 * (1.0 / p[0] - 1.0 / p[-1])
    assert np.trapezoid(compliance, p) == pytest.approx(volume, rel=1e-6)  # rule's error, second order in the step
    assert share[0] - share[-1] == pytest.approx(volume, rel=1e-12)
    assert hooks.free_gas(E, ps) == (0.0, 0.0)


def test_released_air_leaves_loaded_chambers_alone_where_entrained_air_softens_them(lab):
    released = lab.with_effect("released_air", {"alpha": 0.1}).effect_vector()
    entrained = lab.with_effect("entrained_air", {"alpha": 0.1}).effect_vector()
    assert hooks.free_gas(released, 10e5) == (0.0, 0.0) < hooks.free_gas(entrained, 10e5)


def test_stuck_seal_is_bounded_and_pulls_back(lab):
    E = lab.with_effect("stuck_seal@tilt", {"Fc": 3000.0, "l0": 0.5, "delta": 5e-4}).effect_vector()
    force = lambda la: hooks.cylinder_force(E, 1, 0.0, 1e6, 3e6, la, 0.5)  # noqa: E731
    assert force(0.5) == 0.0
    assert force(0.5005) == pytest.approx(-3000.0 * math.tanh(1.0))
    assert force(0.45) == pytest.approx(3000.0)
    assert hooks.cylinder_force(E, 0, 0.0, 1e6, 3e6, 0.6, 0.5) == 0.0


def pressures_after(crane, added, seconds=0.5):
    """Return p4 before and after a wait with closed valves, started with p4 3 bar below what balances the load."""
    engine = SemiRecursiveEngine(crane)
    start = engine.static_start(math.radians(0.5), math.radians(-46.0), (7e4, 1e6))
    start[7] -= added
    time = np.arange(0.0, seconds, 0.01)
    inputs = np.tile([0.0, 0.0, np.nan, np.nan], (time.size, 1))
    return start[7], float(engine.simulate(start, time, inputs, step=1e-3)[-20:, 7].mean())


def test_a_stuck_seal_holds_what_friction_by_speed_lets_go(lab):
    """3 bar on the rod side are 1617 N: less than a seal of 3 kN holds, more than 10 % of it."""
    bare = lab.nominal()
    force = 3e5 * math.pi / 4 * (0.1**2 - 0.056**2)
    length = float(np.ravel(pose(bare, math.radians(0.5), math.radians(-46.0)).lengths)[1])
    chamber = length - bare["cylinders.tilt.empty_length"]
    delta = 1e-4  # stiffer than the oil by far: 3e7 N/m
    l0 = chamber - delta * math.atanh(force / 3000.0)
    seal = bare.with_effect("stuck_seal@tilt", {"Fc": 3000.0, "l0": l0, "delta": delta})
    by_speed = bare.with_effect("seal_friction@tilt", {"dFc": 3000.0, "dFs": 3000.0, "vs": 5e-3})
    before, held = pressures_after(seal, 3e5)
    _, let_go = pressures_after(by_speed, 3e5)
    assert abs(held - before) < 1.0e5  # the seal yields by a share of what is added: it is a spring beside the oil's
    assert let_go - before > 2.0 * abs(held - before)


def test_effect_vector_has_room_for_the_new_effects(lab):
    acting = [("sensor_lag", "p4"), ("released_air", ""), ("stuck_seal", "tilt"), ("spool_creep", "tilt")]
    slots = [slot(*at, lab.layout) for at in acting]
    assert slots == sorted(slots)


def test_identified_crane_is_the_lab_crane_with_what_the_page_names(lab):
    found = Crane.load(Path(__file__).parents[1] / "docs" / "real-crane.toml")
    assert found.voltage == lab.voltage
    named = {"pressure_compensation@lift", "released_air", "seal_friction@lift", "stuck_seal@tilt", "sensor_bias@z4"}
    assert named <= {e.key for e in found.effects}
