"""Laws that are curves: their value and derivative, their table in a crane file, and both engines alike."""

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError
from crane_exudyn.effects import registry
from crane_exudyn.effects.curve import AGAINST, KNOTS, NUMBER, X, Y, value
from crane_exudyn.engine import ExudynEngine
from validation.semi_recursive.engine import SemiRecursiveEngine

CRANE = Crane.load("patu655")
#: curves that act plainly in the run below: effect, over, x, y, against motion
CURVES = [
    ("learned_opening@tilt", "spool", [-1.0, -0.3, 0.0, 0.3, 1.0], [-1.0, -0.2, 0.0, 0.2, 1.0], None),
    ("learned_opening@lift", "pressure_drop", [0.0, 30e5, 100e5], [1.0, 0.9, 0.7], None),
    ("learned_force@lift", "speed", [0.0, 0.1, 0.3], [1000.0, 3000.0, 3500.0], None),
    ("learned_force@lift", "stroke", [0.74, 0.94, 1.14], [0.0, 5000.0, 0.0], True),
    ("learned_force@tilt", "stroke", [0.98, 1.18, 1.38], [0.0, 5000.0, 0.0], False),
    ("learned_force@tilt", "pressure_drop", [0.0, 30e5, 60e5], [0.0, 2000.0, 3000.0], None),
    ("learned_leakage@lift", "pressure_drop", [0.0, 10e5, 60e5], [0.0, 2e-5, 4e-5], None),
    ("learned_flow@p1", "pressure", [0.0, 20e5, 60e5], [0.0, 0.0, 5e-5], None),
    ("learned_torque@O", "angle", [-0.5, 0.3, 0.9], [2000.0, 0.0, -2000.0], False),
    ("learned_torque@A", "angle", [-1.5, -0.8, 0.0], [0.0, 1500.0, 0.0], True),
    ("learned_torque@A", "rate", [0.0, 0.2, 1.0], [500.0, 1500.0, 2000.0], None),
    ("learned_supply", "flow", [0.0, 3e-4, 1e-3], [0.0, 20e5, 50e5], None),
    ("learned_return", "flow", [0.0, 3e-4, 1e-3], [0.0, 5e5, 20e5], None),
]


def _with(key, over, x, y, against=None):
    curve = registry.split_key(key)[0].curve
    return CRANE.with_effect(key, curve.values(over, x, y, against))


def test_a_curve_goes_through_its_knots_with_a_continuous_derivative_and_straight_on_beyond_them():
    E, x = np.zeros(3 + 2 * KNOTS), np.array([0.0, 0.2, 0.5, 0.7, 1.0])
    E[NUMBER], E[X : X + 5], E[Y : Y + 5] = 5, x, np.sin(3.0 * x)
    assert [value(E, 0, v) for v in x] == pytest.approx(np.sin(3.0 * x))
    slope = [(value(E, 0, v + 1e-7) - value(E, 0, v - 1e-7)) / 2e-7 for v in np.linspace(-0.5, 1.5, 20001)]
    assert np.abs(np.diff(slope)).max() < 2e-3  # 1e-4 apart; a kink would show as a step
    E[Y : Y + 5] = 1.0 + 2.0 * x
    assert [value(E, 0, -3.0), value(E, 0, 4.0)] == pytest.approx([-5.0, 9.0])
    E[AGAINST] = 1.0
    assert value(E, 0, -3.0) == 0.0, "what acts against motion drives nothing, however far it falls"
    E[Y : Y + 5] = [0.0, 0.0, 1.0, 0.0, 0.0]
    assert [value(E, 0, -3.0), value(E, 0, 4.0)] == [0.0, 0.0], "one that has levelled out stays level"


@pytest.mark.parametrize(("key", "over", "x", "y", "against"), CURVES)
def test_both_engines_run_alike_with_every_curve(key, over, x, y, against):
    crane = _with(key, over, x, y, against)
    time = np.linspace(0.0, 0.6, 601)
    w = np.column_stack([0.3 * np.sin(9.0 * time), -0.25 * np.sin(7.0 * time), *2 * [np.full(601, np.nan)]])
    start = SemiRecursiveEngine(CRANE).static_start(0.2, -0.8)
    one, other = (np.asarray(e.simulate(start, time, w)) for e in (ExudynEngine(crane), SemiRecursiveEngine(crane)))
    plain = np.asarray(SemiRecursiveEngine(CRANE).simulate(start, time, w))
    acts = np.sqrt(np.mean((other - plain) ** 2, axis=0))
    assert acts[4:].max() > 1e4, "the curve does nothing here"
    assert (
        np.sqrt(np.mean((one - other) ** 2, axis=0)) < 1e-3 * np.maximum(acts, [1e-3] * 2 + [1e-2] * 2 + [1e5] * 4)
    ).all()


@pytest.mark.parametrize(("key", "over", "x", "y", "against"), CURVES)
def test_a_curve_is_read_back_from_its_crane_file(tmp_path, key, over, x, y, against):
    crane = _with(key, over, x, y, against)
    crane.save(tmp_path / "c.toml")
    assert Crane.load(tmp_path / "c.toml") == crane
    other = crane.with_parameters({"payload.mass": 50.0})
    other.save(tmp_path / "d.toml")
    assert Crane.load(tmp_path / "d.toml").effects == crane.effects


def test_a_table_can_be_given_in_python_as_it_stands_in_a_file():
    key, over, x, y, _ = CURVES[3]
    given = CRANE.with_effect(key, {"over": over, "x": np.array(x), "y": (0, "5 kN", 0.0)})
    assert given == _with(key, over, x, y)
    with pytest.raises(CraneError, match=r"effect 'learned_force': over = 'strok' is not known\. Did you mean"):
        CRANE.with_effect(key, {"over": "strok", "x": x, "y": y})


TABLE = """
[[effect]] # from the workshop
name = "learned_force"
place = "lift"
[effect.parameters]
over = "stroke"
unit_over = "mm"
x = [300, 400, "0.5 m"] # scored
unit = "kN"
y = [0, 5, 0]
"""


def test_a_table_may_state_units_and_keeps_its_comments(tmp_path):
    file = tmp_path / "c.toml"
    file.write_text(CRANE.to_toml() + TABLE, encoding="utf-8")
    crane = Crane.load(file)
    table = registry.find("learned_force").curve.table(crane.effects[0].parameters)
    assert table.x == pytest.approx((0.3, 0.4, 0.5)) and table.y == pytest.approx((0.0, 5e3, 0.0))
    assert table.against_motion
    text = crane.with_effect("pump_droop", {"R": 1e9}).to_toml()
    assert "# scored" in text and 'unit_over = "mm"' in text


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("[300, 400,", "[300, 200,", ["learned_force@lift", "x must ascend", "0.3 before 0.2"]),
        ("[0, 5, 0]", "[0, 5]", ["learned_force", "found 3 x and 2 y"]),
        ('unit = "kN"', 'unit = "bar"', ["learned_force", "y", "[bar]"]),
        ('over = "stroke"', 'over = "strok"', ["over = 'strok'", "stroke"]),
        ('over = "stroke"', 'over = "speed"', ["unit [mm]"]),
        ('over = "stroke"', 'over = "stroke"\nagainst_motion = 1', ["against_motion = 1", "true or false"]),
        ("[0, 5, 0]", '[0, "5 m", 0]', ["y, entry 2", "wrong unit"]),
        ("[300, 400,", '["a", 400,', ["x, entry 1"]),
    ],
)
def test_a_bad_table_is_refused_with_what_was_expected(tmp_path, old, new, words):
    assert old in TABLE
    file = tmp_path / "c.toml"
    file.write_text(CRANE.to_toml() + TABLE.replace(old, new), encoding="utf-8")
    with pytest.raises(CraneError) as refusal:
        Crane.load(file)
    assert all(word in str(refusal.value) for word in [*words, str(file)])
