"""Geometry of the closed crane against the model sheet's check values, its own derivatives and elementary distances."""

import math

import numpy as np
import pytest

from crane_exudyn import geometry
from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.statics import terms

CRANE = Crane.load("patu655")
RNG = np.random.default_rng(1)
Z1, Z4 = RNG.uniform(-0.3, 1.2, 50), RNG.uniform(-2.2, 0.2, 50)


def _dependent(pose):
    """Return z2 and z3: bracket 1 against the lift boom, bracket 2 against bracket 1."""
    boom, first, second = (pose.angles[n] for n in ("lift_boom", "bracket_1", "bracket_2"))
    return np.array([first - boom, second - first])


def test_check_values_of_the_model_sheet():
    z1, z4 = math.radians(0.4), math.radians(-45.57)
    pose = geometry.pose(CRANE, z1, z4)
    assert pose.lengths[0] == pytest.approx([0.9381, 1.2991], abs=1e-4)
    assert math.degrees(pose.angles["bracket_1"][0]) == pytest.approx(-65.62, abs=0.005)
    assert math.degrees(pose.angles["bracket_2"][0]) == pytest.approx(-200.66, abs=0.005)
    assert np.diag(pose.length_rates[0]) == pytest.approx([0.308, -0.332], abs=5e-4)


def test_loop_is_closed_and_brackets_keep_their_lengths():
    pose = geometry.pose(CRANE, Z1, Z4)
    assert pose.points["D"] == pytest.approx(pose.points["D_bracket"], abs=1e-14)
    bracket_1 = np.linalg.norm(pose.points["C"] - pose.points["B"], axis=1)
    assert bracket_1 == pytest.approx(math.hypot(CRANE["joints.C.x"], CRANE["joints.C.y"]), abs=1e-14)


def test_c_lies_above_the_line_from_b_to_d():
    pose = geometry.pose(CRANE, Z1, Z4)
    b, c, d = (pose.points[n] for n in "BCD")
    left = (d - b)[:, 0] * (c - b)[:, 1] - (d - b)[:, 1] * (c - b)[:, 0]
    assert np.all(left > 0.0)


def test_lengths_are_distances_between_the_pins():
    pose = geometry.pose(CRANE, Z1, Z4)
    lift = np.linalg.norm(pose.points["lift_rod_end"] - pose.points["lift_base"], axis=1)
    tilt = np.linalg.norm(pose.points["C"] - pose.points["tilt_base"], axis=1)
    assert pose.lengths == pytest.approx(np.column_stack([lift, tilt]), abs=1e-15)


def test_rates_are_the_derivatives():
    """Central differences with step d are wrong by O(d^2) = 1e-10 and by rounding 1e-16/d = 1e-11."""
    d = 1e-5
    pose = geometry.pose(CRANE, Z1, Z4)
    up, down = geometry.pose(CRANE, Z1, Z4 + d), geometry.pose(CRANE, Z1, Z4 - d)
    rates = [terms(CRANE, np.array([a, b, *[0.0] * 6]), np.zeros(4)) for a, b in zip(Z1, Z4, strict=True)]
    loop = np.array([[t["dz2_dz4"], t["dz3_dz4"]] for t in rates]).T
    assert loop == pytest.approx((_dependent(up) - _dependent(down)) / (2 * d), abs=1e-8)
    assert pose.length_rates[:, 1, 1] == pytest.approx((up.lengths - down.lengths)[:, 1] / (2 * d), abs=1e-8)
    assert np.all(up.lengths[:, 0] == down.lengths[:, 0])
    up, down = geometry.pose(CRANE, Z1 + d, Z4), geometry.pose(CRANE, Z1 - d, Z4)
    assert pose.length_rates[:, 0, 0] == pytest.approx((up.lengths - down.lengths)[:, 0] / (2 * d), abs=1e-8)
    assert (up.lengths - down.lengths)[:, 1] == pytest.approx(0.0, abs=1e-14)


def test_turning_the_boom_turns_everything_on_it():
    pose, turned = geometry.pose(CRANE, Z1, Z4), geometry.pose(CRANE, Z1 + 0.3, Z4)
    c, s = math.cos(0.3), math.sin(0.3)
    arm = pose.points["E"] - pose.points["O"]
    expected = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
    assert turned.points["E"] - turned.points["O"] == pytest.approx(expected, abs=1e-14)


def test_unreachable_pose_is_named():
    short = CRANE.with_parameters({"joints.D_bracket.x": -0.02})
    with pytest.raises(
        CraneError, match=r"z1 = 5\.73 deg, z4 = -171\.89 deg cannot be reached: bracket_1 and bracket_2 .*B-C-D"
    ):
        geometry.pose(short, np.array([0.1, 0.1]), np.array([-3.0, -3.0]))
