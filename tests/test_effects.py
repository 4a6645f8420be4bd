"""Effects: neutral means off, bit for bit; laws as the formulas; a user's own effect takes part."""

import math
import os
import subprocess
import sys
import threading

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, ExudynEngine
from crane_exudyn.effects import checks, curve, registry
from crane_exudyn.effects.base import HOOKS


def test_every_effect_says_what_it_is():
    for effect in registry.known():
        assert effect.__doc__ and "Signature" in effect.__doc__
        assert all(
            p.text and p.lower <= p.neutral <= p.upper and p.lower <= p.typical <= p.upper for p in effect.parameters
        )
        assert set(effect.hooks()) <= set(HOOKS)


@pytest.mark.parametrize("key", registry.all_keys(Crane.load("patu655").layout))
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
    valve = find("counterbalance_valve").return_gain
    assert valve(0.0, 3.0, 20e5, 0.0, 0.0, 1.0, 1e5) == 1.0
    assert valve(120e5, 3.0, 20e5, 60e5, 25e5, 1.0, 59e5) == pytest.approx(0.75)
    assert valve(120e5, 3.0, 50e5, 60e5, 25e5, 1.0, 59e5) == pytest.approx(0.3)
    assert valve(120e5, 3.0, 20e5, 0.2e5, 0.0, 1.0, -4.8e5) == 1.0, "oil comes back from the tank through the check"
    leak = find("external_leakage").leakage
    assert (leak(2e-12, 50e5), leak(2e-12, -1e5)) == (pytest.approx(-1e-5), 0.0)


def test_nothing_leaks_where_the_pressure_is_that_of_the_air_outside():
    """A gauge reads 0 there, and an absolute one the pressure of the air; both lose the same elsewhere."""
    from validation.semi_recursive.engine import SemiRecursiveEngine

    k, w = 5e-12, np.array([0.0, 0.0, 0.0, np.nan, np.nan])
    crane = Crane.load("excavator")
    leaking = crane.with_effect(f"external_leakage@{crane.layout.chambers[0]}", {"k": k})
    air = crane["supply.air_pressure"]
    gauge = leaking.with_parameters({"supply.pressure_reference": 1.0})
    for engine in (ExudynEngine, SemiRecursiveEngine):
        for over, lost in ((0.0, 0.0), (50e5, k * 50e5)):
            for machine, zero in ((leaking, air), (gauge, 0.0)):
                x = engine(machine).static_start(*crane.initial.pose)
                x[crane.layout.pressures] = over + zero
                assert engine(machine).terms(x, w)["leak1"] == pytest.approx(-lost, abs=1e-18)


def test_a_learned_factor_on_the_flow_is_one_at_any_pressure_drop():
    """Below 2 bar the flow is laminar, and goes with the drop instead of its root."""
    x_y = [0.0, 100e5], [0.5, 0.5]
    crane = Crane.load("patu655")
    half = crane.with_effect(
        "learned_opening@lift", registry.find("learned_opening").curve.values("pressure_drop", *x_y)
    )
    x, w = np.array([0.3, -0.9, 0.0, 0.0, 99.5e5, 1.5e5, 20e5, 20e5]), np.array([0.3, 0.0, 100e5, 1e5])
    flows, whole = (ExudynEngine(c).terms(x, w) for c in (half, crane))
    for name in ("Q1", "Q2"):
        assert flows[name] == pytest.approx(0.5 * whole[name], rel=1e-12)


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
registry.load_effects(sys.argv[1])
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


CREEP = """
from crane_exudyn.effects.base import CYLINDERS, Effect, Parameter

class SlowSpool(Effect):
    \"\"\"A share of the travel creeps.

    Signature: as of spool_creep.
    \"\"\"

    name = "slow_spool"
    places = CYLINDERS
    parameters = (Parameter("share", "", 0.0, 0.0, 0.5, 0.1, "share"), Parameter("T", "s", 3.0, 0.2, 5.0, 1.0, "time"))

    @staticmethod
    def creep(share, T):
        return share, T
"""
USE_CREEP = """
import sys
from crane_exudyn.effects import registry
registry.load_effects(sys.argv[1])
from crane_exudyn import Crane
from crane_exudyn.effects import hooks
crane = Crane.load("patu655").with_effect("spool_creep@lift", {"kappa": 0.3, "tau": 1.0})
both = crane.with_effect("slow_spool@lift", {"share": 0.1, "T": 3.0})
print(*hooks.plain("creep")(crane.effect_vector(), 0), *hooks.plain("creep")(both.effect_vector(), 0))
"""


def test_an_effect_at_its_neutral_values_leaves_another_of_the_same_hook_alone(tmp_path):
    """One more effect with the hook switched the library's creep off, whether or not it acted."""
    file = tmp_path / "mine.py"
    file.write_text(CREEP, encoding="utf-8")
    run = subprocess.run([sys.executable, "-c", USE_CREEP, str(file)], capture_output=True, text=True, check=True)
    assert [float(x) for x in run.stdout.split()] == pytest.approx([0.3, 1.0, 0.4, 1.5])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (USER_EFFECT.replace("def cylinder_force", "def cylinder_forse"), ["cylinder_forse", "cylinder_force"]),
        (USER_EFFECT.replace('"quadratic_friction"', '"quadratic friction"'), ["name"]),
        (USER_EFFECT.replace("places = CYLINDERS", 'places = "booms"'), ["booms"]),
        ("x = 1", ["defines no effect"]),
        ("x = ", ["cannot be imported"]),
    ],
)
def test_a_bad_effect_file_is_refused(tmp_path, text, words):
    file = tmp_path / "bad_effect.py"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(CraneError) as refusal:
        registry.load_effects(file)
    assert all(word in str(refusal.value) for word in [*words, "bad_effect"])


def _spoilt(old, new, text=USER_EFFECT):
    assert old in text
    return text.replace(old, new)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (
            _spoilt("(c, v, pa, pb, la, lb)", "(c, v)"),
            ["cylinder_force(c, v)", "cylinder_force(c, v, pa, pb, la, lb) -> F"],
        ),
        (_spoilt("(c, v, pa, pb, la, lb)", "(c, v, *rest)"), ["cylinder_force(c, v, *rest)", "line 14"]),
        (
            _spoilt("return -c", "return -drag"),
            ["cylinder_force", "drag", "Expected cylinder_force(c, v, pa, pb, la, lb) -> F"],
        ),
        (_spoilt("return -c * v * abs(v)", "return 'much'"), ["cylinder_force", "'much'"]),
        (_spoilt("return -c * v * abs(v)", "return -c * v, 0.0"), ["cylinder_force", "-> F"]),
        (_spoilt("return -c * v * abs(v)", "return -c * v + {}['a']"), ["cylinder_force cannot be compiled"]),
        (
            _spoilt("return -c * v * abs(v)", "return -c * v - 5.0"),
            ["cylinder_force returns -5", "at the neutral values"],
        ),
        (_spoilt("return -c * v * abs(v)", "return -c * v ** 0.5"), ["cylinder_force returns nan at c = ", "v = -0.5"]),
        (_spoilt("places = CYLINDERS", 'places = "joints"'), ["cylinder_force cannot act at joints", "cylinders"]),
        (_spoilt("places = CYLINDERS", 'places = "lift"'), ["places is 'lift'"]),
        (_spoilt("0.0, 0.0, 1e7, 1e5", "0.0, '0', 1e7, 1e5"), ["parameter 'c': lower is '0'"]),
        (_spoilt("0.0, 0.0, 1e7, 1e5", "0.0, 0.0, 1e3, 1e5"), ["parameter 'c': typical is 100000", "upper = 1000"]),
        (_spoilt('(Parameter("c", "N*s^2/m^2", 0.0, 0.0, 1e7, 1e5, "drag"),)', '("c",)'), ["Expected a Parameter"]),
        (_spoilt("N*s^2/m^2", "furlongs/xyz"), ["parameter 'c': unit [furlongs/xyz] is not known"]),
        (
            _spoilt("return -c", "if v > 0.2:\n            raise ValueError('no')\n        return -c"),
            ["cylinder_force fails at c = ", "v = 0.5", "no"],
        ),
        ("import sys\nsys.exit(3)\n", ["cannot be imported", "SystemExit"]),
    ],
)
def test_a_law_that_does_not_fit_is_refused_in_one_line(tmp_path, text, words):
    file = tmp_path / "bad_effect.py"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(CraneError) as refusal:
        registry.load_effects(file)
    said = str(refusal.value)
    assert all(word in said for word in [*words, str(file)]) and "\n" not in said
    assert not registry.user_files()


def test_a_law_that_does_not_return_is_refused_in_time(tmp_path, monkeypatch):
    file = tmp_path / "slow.py"
    law = "k = 0.0\n        while k < 5e8:\n            k += 1.0\n        return -c * v * abs(v) * k / 5e8"
    file.write_text(_spoilt("return -c * v * abs(v)", law), encoding="utf-8")
    monkeypatch.setattr(checks, "_LONGEST", 0.1)
    running = set(threading.enumerate())
    with pytest.raises(CraneError, match=r"slow\.py.*cylinder_force has not returned after 0.1 s, at c = .*loop"):
        registry.load_effects(file)
    for left in set(threading.enumerate()) - running:  # it goes on to no other values, which took a core for minutes
        left.join(20.0)
        assert not left.is_alive()


@pytest.mark.parametrize(
    "name",
    [
        *("internal_leakage", "external_leakage", "entrained_air", "spool_creep", "pressure_compensation"),
        *("learned_opening", "learned_torque", "learned_leakage"),
    ],
)
def test_effects_of_the_package_pass_the_checks_of_a_users_own(name):
    checks.checked(registry.find(name), name)


@pytest.mark.parametrize(
    ("law", "words"),
    [
        ("return pa - pb, pb - pa", "expected 0, 0: at the neutral values"),
        ("return 0.0 if E[at] == 0.0 else value(E, at, abs(pa - pb))", "Expected leakage\\(E, at, pa, pb\\) -> qa, qb"),
    ],
)
def test_a_curve_of_ones_own_is_tried_as_it_will_be_called(law, words):
    class Mine(registry.find("learned_leakage")):
        name = "mine"

    scope = {"value": curve.value}
    exec(f"def leakage(E, at, pa, pb):\n    {law}", scope)
    Mine.leakage = staticmethod(scope["leakage"])
    with pytest.raises(CraneError, match=words):
        checks.checked(Mine, "mine.py")


def test_without_a_cache_folder_effects_still_act_and_leave_nothing_for_later_runs(tmp_path):
    """A file where the folder should be: neither ignored nor kept where another set of effects would find it."""
    file, nowhere = tmp_path / "mine.py", tmp_path / "file"
    file.write_text(USER_EFFECT, encoding="utf-8")
    nowhere.touch()
    environment = os.environ | {"CRANE_EXUDYN_CACHE": str(nowhere), "TMPDIR": str(tmp_path)}
    run = subprocess.run(
        [sys.executable, "-c", USE, str(file)], capture_output=True, text=True, check=True, env=environment
    )
    assert [float(x) for x in run.stdout.split()] == pytest.approx([-4000.0, 0.0])
    assert "CRANE_EXUDYN_CACHE" in run.stderr and str(nowhere) in run.stderr
    assert {p.name for p in tmp_path.iterdir()} == {"mine.py", "file"}


def test_the_same_law_from_another_file_does_not_find_code_that_refers_to_the_first(tmp_path):
    for name in ("one.py", "two.py"):
        (tmp_path / name).write_text(USER_EFFECT, encoding="utf-8")
    code = (
        "import sys\nfrom crane_exudyn.effects import registry\nregistry.load_effects(sys.argv[1])\n"
        "from crane_exudyn.compiled import cache_folder\nprint(cache_folder())"
    )
    folders = {
        subprocess.run(
            [sys.executable, "-c", code, str(tmp_path / n)], capture_output=True, text=True, check=True
        ).stdout
        for n in ("one.py", "two.py")
    }
    assert len(folders) == 2


def test_an_effect_that_stands_in_no_file_is_refused():
    """Compiled code, which is kept by the text of effects, could not be told from that of other ones."""
    code = f"from crane_exudyn.effects import registry\n{CREEP}\nregistry.register(SlowSpool)\n"
    told = subprocess.run([sys.executable, "-"], input=code, capture_output=True, text=True, check=False).stderr
    assert "CraneError: Effect 'slow_spool' is not defined in a file" in told and "load_effects(FILE)" in told
