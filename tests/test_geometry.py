"""Geometry of the closed crane against the model sheet's check values, its own derivatives and elementary distances."""

import math

import numpy as np
import pytest

from crane_exudyn import geometry
from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.parameters import POINT_NAMES

CRANE = Crane.load("patu655")
RNG = np.random.default_rng(1)
Z1, Z4 = RNG.uniform(-0.3, 1.2, 50), RNG.uniform(-2.2, 0.2, 50)


def _point(pose, name):
    return pose.points[:, POINT_NAMES.index(name)]


def test_check_values_of_the_model_sheet():
    z1, z4 = math.radians(0.4), math.radians(-45.57)
    pose = geometry.pose(CRANE, z1, z4)
    assert pose.lengths[0] == pytest.approx([0.9381, 1.2991], abs=1e-4)
    assert math.degrees(z1 + pose.z2[0]) == pytest.approx(-65.62, abs=0.005)
    assert math.degrees(z1 + pose.z2[0] + pose.z3[0]) == pytest.approx(-200.66, abs=0.005)
    assert pose.length_rates[0] == pytest.approx([0.308, -0.332], abs=5e-4)


def test_loop_is_closed_and_brackets_keep_their_lengths():
    pose = geometry.pose(CRANE, Z1, Z4)
    assert _point(pose, "D") == pytest.approx(_point(pose, "D_bracket"), abs=1e-14)
    bracket_1 = np.linalg.norm(_point(pose, "C") - _point(pose, "B"), axis=1)
    assert bracket_1 == pytest.approx(math.hypot(CRANE["joints.C.x"], CRANE["joints.C.y"]), abs=1e-14)


def test_c_lies_above_the_line_from_b_to_d():
    pose = geometry.pose(CRANE, Z1, Z4)
    b, c, d = (_point(pose, n) for n in "BCD")
    left = (d - b)[:, 0] * (c - b)[:, 1] - (d - b)[:, 1] * (c - b)[:, 0]
    assert np.all(left > 0.0)


def test_lengths_are_distances_between_the_pins():
    pose = geometry.pose(CRANE, Z1, Z4)
    lift = np.linalg.norm(_point(pose, "G") - _point(pose, "F"), axis=1)
    tilt = np.linalg.norm(_point(pose, "C") - _point(pose, "H"), axis=1)
    assert pose.lengths == pytest.approx(np.column_stack([lift, tilt]), abs=1e-15)


def test_rates_are_the_derivatives():
    """Central differences with step d are wrong by O(d^2) = 1e-10 and by rounding 1e-16/d = 1e-11."""
    d = 1e-5
    pose = geometry.pose(CRANE, Z1, Z4)
    up, down = geometry.pose(CRANE, Z1, Z4 + d), geometry.pose(CRANE, Z1, Z4 - d)
    assert pose.dz2_dz4 == pytest.approx((up.z2 - down.z2) / (2 * d), abs=1e-8)
    assert pose.dz3_dz4 == pytest.approx((up.z3 - down.z3) / (2 * d), abs=1e-8)
    assert pose.length_rates[:, 1] == pytest.approx((up.lengths - down.lengths)[:, 1] / (2 * d), abs=1e-8)
    assert np.all(up.lengths[:, 0] == down.lengths[:, 0])
    up, down = geometry.pose(CRANE, Z1 + d, Z4), geometry.pose(CRANE, Z1 - d, Z4)
    assert pose.length_rates[:, 0] == pytest.approx((up.lengths - down.lengths)[:, 0] / (2 * d), abs=1e-8)
    assert (up.lengths - down.lengths)[:, 1] == pytest.approx(0.0, abs=1e-14)


def test_turning_the_boom_turns_everything_on_it():
    pose, turned = geometry.pose(CRANE, Z1, Z4), geometry.pose(CRANE, Z1 + 0.3, Z4)
    c, s = math.cos(0.3), math.sin(0.3)
    arm = _point(pose, "E") - _point(pose, "O")
    expected = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1]])
    assert _point(turned, "E") - _point(turned, "O") == pytest.approx(expected, abs=1e-14)


def test_unreachable_pose_is_named():
    short = CRANE.with_parameters({"joints.D_bracket.x": -0.02})
    with pytest.raises(CraneError, match=r"z1 = 5\.73 deg, z4 = -171\.89 deg cannot be reached.*A-B-C-D"):
        geometry.pose(short, np.array([0.1, 0.1]), np.array([-3.0, -3.0]))
