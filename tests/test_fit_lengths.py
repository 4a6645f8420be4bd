"""A measured cylinder length depends on the pins, not on the angle alone: the fit's derivatives say so."""

from dataclasses import replace

import numpy as np
import pytest

from crane_exudyn import Crane, Recording
from validation.fit.columns import columns_of, model_at
from validation.fit.data import FitData
from validation.fit.linear import normal_equations
from validation.fit.solve import fit
from validation.fit.staged import first_knots
from validation.fit.start import knots_of
from validation.fit.variables import NominalDirection
from validation.fit.windows import cut
from validation.semi_recursive.engine import SemiRecursiveEngine

PINS = ("cylinders.lift.rod_end.x", "cylinders.tilt.base.x")
NOISE = {"z1": 1e-3, "z4": 1e-3, "s1": 3e-4, "s2": 3e-4, "p1": 3e4, "p4": 3e4}


def lifted(crane: Crane) -> Recording:
    """Return 3 s of a slow lift with the lengths of both cylinders measured."""
    time = np.arange(0.0, 3.0, 0.01)
    u = np.column_stack([np.interp(time, [0.3, 0.5], [0.0, 0.3]), np.zeros_like(time)])
    engine = SemiRecursiveEngine(crane)
    w = np.column_stack([u, np.full((len(time), 2), np.nan)])
    X = engine.simulate(engine.static_start(0.2, -0.8), time, w)
    from crane_exudyn.geometry import pose

    lengths = pose(crane, X[:, 0], X[:, 1]).lengths
    rng = np.random.default_rng(5)
    true = {"z1": X[:, 0], "z4": X[:, 1], "s1": lengths[:, 0], "s2": lengths[:, 1], "p1": X[:, 4], "p4": X[:, 7]}
    seen = {n: v + NOISE[n] * rng.standard_normal(len(time)) for n, v in true.items()}
    return Recording.from_arrays("lengths", time, {"u1": u[:, 0], "u2": u[:, 1], **seen})


@pytest.fixture(scope="module")
def moved_pins():
    crane = Crane.load("patu655")
    truth = crane.with_parameters({PINS[0]: crane[PINS[0]] + 0.012, PINS[1]: crane[PINS[1]] - 0.008})
    data = FitData.of(lifted(truth), crane)
    return crane, truth, data, [NominalDirection(n, {n: 0.01}) for n in PINS]


def test_the_gradient_by_a_pin_is_the_slope_of_the_cost(moved_pins):
    crane, _, data, variables = moved_pins
    windows = cut(data, 0.5)
    knots = first_knots(crane, data, 0.5)

    def linear(u):
        base = model_at(crane, variables, u, data)
        return normal_equations(windows, knots, base, columns_of(crane, variables, u, base, data), 1.0)

    at = np.array([0.5, -0.3])
    for j in (0, 1):
        h = 1e-3 * np.eye(2)[j]
        slope = 0.5 * (linear(at + h).cost - linear(at - h).cost) / 2e-3
        assert slope == pytest.approx(linear(at).gu[j], rel=2e-2)


def test_windows_begin_where_lengths_alone_say():
    """They began in the pose of the crane file, with the machine half a radian from there."""
    crane = Crane.load("patu655")
    whole = lifted(crane)
    told = {n: whole[n].values for n in ("u1", "u2", "s1", "s2", "p1", "p4")}
    data = FitData.of(Recording.from_arrays("lengths", whole["s1"].time, told), crane)
    elsewhere = replace(crane, initial=replace(crane.initial, pose=(0.6, -0.3)))
    windows = cut(data, 0.25)
    knots = knots_of(elsewhere, data, windows)
    at = [int(np.searchsorted(whole["z1"].time, data.time[w.start])) for w in windows]
    for i, name in enumerate(("z1", "z4")):
        assert np.abs(knots[:, i] - whole[name].values[at]).max() < 5e-3
    moving = whole["z1"].values[at[8]] - whole["z1"].values[at[7]]
    assert knots[7, 2] == pytest.approx(moving / 0.25, rel=0.3)


def test_pins_are_found_from_measured_lengths(moved_pins):
    crane, truth, data, variables = moved_pins
    windows = cut(data, 0.25)
    found = fit(crane, data, windows, first_knots(crane, data), variables, np.zeros(2), stiffness=10.0)
    for name in PINS:
        assert found.crane[name] == pytest.approx(truth[name], abs=1e-3)
