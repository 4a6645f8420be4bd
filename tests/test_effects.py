"""Effects: neutral means off, bit for bit; laws as the formulas; a user's own effect takes part."""

import math
import subprocess
import sys

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import HOOKS


def test_every_effect_says_what_it_is():
    for effect in registry.known():
        assert effect.__doc__ and "Signature" in effect.__doc__
        assert all(
            p.text and p.lower <= p.neutral <= p.upper and p.lower <= p.typical <= p.upper for p in effect.parameters
        )
        assert set(effect.hooks()) <= set(HOOKS)


@pytest.mark.parametrize("key", registry.all_keys())
def test_neutral_parameters_leave_the_run_bit_identical(key):
    from validation.semi_recursive.engine import SemiRecursiveEngine

    crane = Crane.load("patu655")
    effect, _ = registry.split_key(key)
    neutral = crane.with_effect(key, {p.name: p.typical for p in effect.parameters if p.shape})
    time = np.linspace(0.0, 1.0, 401)
    w = np.column_stack([0.3 * np.sin(3 * time), 0.2 * np.cos(2 * time), *2 * [np.full(401, np.nan)]])
    runs = []
    for c in (crane, neutral):
        engine = SemiRecursiveEngine(c)
        runs.append(engine.simulate(engine.static_start(0.2, -0.8), time, w, step=2.5e-3))
    assert np.array_equal(runs[0], runs[1])


def test_laws_are_the_formulas():
    find = registry.find
    assert find("internal_leakage").leakage(2e-12, 50e5, 20e5) == pytest.approx((-6e-6, 6e-6))
    band = find("dead_band").opening
    assert [band(0.1, 0.2, u) for u in (-1.0, -0.05, 0.15, 0.6, 1.0)] == pytest.approx([-1.0, 0.0, 0.0, 0.5, 1.0])
    assert find("pressure_compensation").supply_drop(7e5, 30e5) == 7e5
    assert find("entrained_air").free_gas(0.01, 1e4)[1] == pytest.approx(0.01 * 1e5 / (0.2e5) ** 2)
    assert find("entrained_air").free_gas(0.01, 1e6) == pytest.approx((1e-3, 1e-9))
    assert find("pump_droop").supply_pressure(1e10, 1e7, 1e-4) == pytest.approx(1e7 - 1e6)
    assert find("base_tilt").gravity(0.1, 0.0, -9.81) == pytest.approx((9.81 * math.sin(0.1), -9.81 * math.cos(0.1)))
    assert find("joint_coulomb_friction").joint_torque(500.0, -1.0) == pytest.approx(500.0)
    assert find("end_stop").cylinder_force(1e8, 0.0, 0.0, 1e5, 1e5, -1e-3, 0.5) == pytest.approx(1e5)
    assert find("counterbalance_valve").return_gain(0.0, 3.0, 0.0, 0.0, 1.0) == 1.0


def test_a_value_outside_its_range_is_refused_with_the_range():
    with pytest.raises(CraneError, match=r"meter_out_restriction.*1\.5"):
        Crane.load("patu655").with_effect("meter_out_restriction@lift", {"r": 1.5})


USER_EFFECT = '''
from crane_exudyn.effects.base import CYLINDERS, Effect, Parameter

class QuadraticFriction(Effect):
    """Force c v |v| against the piston.

    Signature: fast motions need more pressure than slow ones, with the square of the speed.
    """

    name = "quadratic_friction"
    places = CYLINDERS
    parameters = (Parameter("c", "N*s^2/m^2", 0.0, 0.0, 1e7, 1e5, "drag"),)

    @staticmethod
    def cylinder_force(c, v, pa, pb, la, lb):
        return -c * v * abs(v)
'''
USE = """
import sys, numpy as np
from crane_exudyn.effects import registry
registry.load_file(sys.argv[1])
from crane_exudyn import Crane
from crane_exudyn.effects import hooks
crane = Crane.load("patu655").with_effect("quadratic_friction@tilt", {"c": 1e5})
E = crane.effect_vector()
print(hooks.cylinder_force(E, 1, 0.2, 1e5, 1e5, 0.1, 0.1), hooks.cylinder_force(E, 0, 0.2, 1e5, 1e5, 0.1, 0.1))
"""


def test_a_users_own_effect_is_compiled_in_at_its_place(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(USER_EFFECT, encoding="utf-8")
    run = subprocess.run([sys.executable, "-c", USE, str(file)], capture_output=True, text=True, check=True)
    assert [float(x) for x in run.stdout.split()] == pytest.approx([-4000.0, 0.0])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (USER_EFFECT.replace("def cylinder_force", "def cylinder_forse"), ["cylinder_forse", "cylinder_force"]),
        (USER_EFFECT.replace('"quadratic_friction"', '"quadratic friction"'), ["name"]),
        (USER_EFFECT.replace("places = CYLINDERS", 'places = ("boom",)'), ["boom"]),
        ("x = 1", ["defines no effect"]),
        ("x = ", ["cannot be imported"]),
    ],
)
def test_a_bad_effect_file_is_refused(tmp_path, text, words):
    file = tmp_path / "bad_effect.py"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(CraneError) as refusal:
        registry.load_file(file)
    assert all(word in str(refusal.value) for word in [*words, "bad_effect"])
