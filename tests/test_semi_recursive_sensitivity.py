"""The sensitivity sweep against differences of whole runs."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.parameters import of_cylinder
from validation.semi_recursive import SemiRecursiveEngine, kernel
from validation.semi_recursive.sensitivity import Sweep, moves_bodies, sweep

H, N = 5e-3, 401
SIZES = np.array([1e-6, 1e-6, 2e-6, 2e-6, 1e2, 1e2, 1e2, 1e2])


@pytest.fixture(scope="module")
def crane() -> Crane:
    return Crane.load("patu655")


@pytest.fixture(scope="module")
def start(crane: Crane) -> np.ndarray:
    x = SemiRecursiveEngine(crane).static_start(0.2, -0.7)
    x[2] = 0.02
    return x


@pytest.fixture(scope="module")
def inputs() -> np.ndarray:
    time = np.arange(N) * H
    nan = np.full(N, np.nan)
    return np.column_stack([0.4 * np.sin(2 * time) ** 2, -0.3 * np.sin(3 * time) ** 2, nan, nan])


def run(crane: Crane, x0: np.ndarray, W: np.ndarray) -> np.ndarray:
    X, status, _, _ = kernel.simulate(
        x0,
        W,
        np.arange(len(W)) * H,
        H,
        crane.parameter_vector(),
        crane.effect_vector(),
        crane.machine.topology,
        math.inf,
        math.inf,
    )
    assert status == kernel.OK
    return X


def swept(
    crane: Crane, x0: np.ndarray, W: np.ndarray, probes: list[Crane], delta: list[float], **more: object
) -> Sweep:
    m, P, E = len(probes), crane.parameter_vector(), crane.effect_vector()
    P_cols = np.array([c.parameter_vector() for c in probes]).reshape(m, len(P))
    E_cols = np.array([c.effect_vector() for c in probes]).reshape(m, len(E))
    arguments = {
        "x0": np.atleast_2d(x0),
        "first": np.array([0]),
        "W_all": W[None],
        "t0": 0.0,
        "allowed": math.inf,
        "topology": crane.machine.topology,
    } | more
    return sweep(h=H, P=P, E=E, P_cols=P_cols, E_cols=E_cols, delta=np.array(delta), **arguments)  # type: ignore[arg-type]


def assert_close(S: np.ndarray, difference: np.ndarray, share: float) -> None:
    """Each state's sensitivity agrees within `share` of its largest value along the run."""
    scale = np.abs(difference).max(axis=0)
    assert (np.abs(S - difference) <= share * scale + 1e-12).all(), (
        np.abs(S - difference).max(axis=0) / scale
    ).tolist()


def test_columns_of_the_start_are_differences_of_runs(crane: Crane, start: np.ndarray, inputs: np.ndarray) -> None:
    result = swept(crane, start, inputs, [], [])
    base = run(crane, start, inputs)
    np.testing.assert_allclose(result.X, base, rtol=1e-8, atol=1e-9)
    np.testing.assert_array_equal(result.S[0], np.eye(8))
    for j, size in enumerate(SIZES):
        moved = start.copy()
        moved[j] += size
        assert_close(result.S[:, :, j], (run(crane, moved, inputs) - base) / size, 1e-3)


def test_columns_of_another_machine() -> None:
    digger = Crane.load(Path(__file__).parent / "machines" / "digger.toml")
    start = SemiRecursiveEngine(digger).static_start(*digger.initial.pose, 40e5)
    time = np.arange(101) * H
    W = np.column_stack([*(0.3 * np.sin((2 + c) * time) for c in range(3)), np.full((101, 2), np.nan)])
    probe = digger.with_parameters({"joints.C_shovel.x": digger["joints.C_shovel.x"] + 1e-7})
    result, base = swept(digger, start, W, [probe], [1e-7]), run(digger, start, W)
    np.testing.assert_allclose(result.X, base, rtol=1e-8, atol=1e-9)
    assert_close(result.S[:, :, 12], (run(probe, start, W) - base) / 1e-7, 5e-3)
    for j, size in enumerate((*[1e-6] * 3, *[2e-6] * 3, *[1e2] * 6)):
        moved = start.copy()
        moved[j] += size
        assert_close(result.S[:, :, j], (run(digger, moved, W) - base) / size, 2e-3)


@pytest.mark.parametrize(
    ("name", "size"),
    [
        ("payload.mass", 1e-3),
        ("supply.pump_pressure", 1e2),
        ("joints.C.x", 1e-7),
        ("cylinders.tilt.viscous_friction", 1e-1),
        ("fluid.hose_bulk_modulus", 1e4),
        ("valves.lift.flow_coefficient", 1e-12),
    ],
)
def test_columns_of_parameters(crane: Crane, start: np.ndarray, inputs: np.ndarray, name: str, size: float) -> None:
    probe = crane.with_parameters({name: crane[name] + size})
    result = swept(crane, start, inputs, [probe], [size])
    assert_close(result.S[:, :, 8], (run(probe, start, inputs) - run(crane, start, inputs)) / size, 2e-3)


@pytest.mark.parametrize(
    ("key", "values"),
    [
        ("internal_leakage@lift", {"k": 1e-15}),
        ("dead_band@tilt", {"upper": 1e-5, "lower": 1e-5}),
        ("pump_droop", {"R": 1e6}),
        ("seal_friction@lift", {"dFc": 1.0, "dFs": 1.0}),
        ("tip_contact_force", {"F": 0.1, "T": 0.5}),
        ("structural_compliance@tilt", {"stiffness": 1e12}),
    ],
)
def test_columns_of_effects(
    crane: Crane, start: np.ndarray, inputs: np.ndarray, key: str, values: dict[str, float]
) -> None:
    probe = crane.with_effect(key, values)
    result = swept(crane, start, inputs, [probe], [1.0])
    assert_close(result.S[:, :, 8], run(probe, start, inputs) - run(crane, start, inputs), 5e-3)


def test_a_column_of_other_inputs(crane: Crane, start: np.ndarray, inputs: np.ndarray) -> None:
    late = inputs.copy()
    late[:, :2] += 1e-5 * np.cos(7.0 * np.arange(N) * H)[:, None]
    result = swept(crane, start, inputs, [crane], [1.0], W_all=np.array([inputs, late]), W_index=np.array([1]))
    assert_close(result.S[:, :, 8], run(crane, start, late) - run(crane, start, inputs), 2e-3)


def test_probes_that_leave_the_bodies_take_the_mechanics_of_the_base() -> None:
    """Every parameter and effect, told apart by what they change: all terms of a probe are those of its own machine."""
    crane = Crane.load("patu655")
    moved = {n: crane.with_parameters({n: crane[n] * 1.01 + (crane[n] == 0.0)}) for n in crane.machine.names}
    P, E = crane.parameter_vector(), crane.effect_vector()
    columns = [np.array([v(c) for c in moved.values()]) for v in (Crane.parameter_vector, Crane.effect_vector)]
    bodies = dict(zip(moved, moves_bodies(P, E, *columns, 2), strict=True))
    hydraulic = {n for c in crane.layout.cylinders for n in of_cylinder(c)}
    assert bodies == {n: not (n in hydraulic or n.startswith(("fluid.", "supply."))) for n in moved}
    keys = {
        "payload_change": {"dm": 5.0, "T": 0.0},
        "base_tilt": {"gamma": 0.1},
        "joint_coulomb_friction@O": {"T": 9.0},
    }
    effects = np.array([crane.with_effect(k, values).effect_vector() for k, values in keys.items()])
    assert moves_bodies(P, E, np.tile(P, (3, 1)), effects, 2).tolist() == [True, True, False]


def test_windows_do_not_know_of_each_other(crane: Crane, start: np.ndarray, inputs: np.ndarray) -> None:
    base, at = run(crane, start, inputs), np.array([*range(151), *range(150, 301), *range(300, N)])
    probe, first = crane.with_parameters({"payload.mass": 25.01}), np.array([0, 151, 302])
    x0, t0 = base[[0, 150, 300]], np.array([0, 150, 300]) * H
    result = swept(crane, x0, inputs[at], [probe], [0.01], first=first, t0=t0)
    np.testing.assert_allclose(result.X, base[at], rtol=1e-8, atol=1e-9)
    middle = swept(crane, base[150], inputs[150:301], [probe], [0.01])
    np.testing.assert_allclose(result.S[151:302], middle.S, rtol=1e-6, atol=1e-9)
    np.testing.assert_array_equal(result.S[302], np.eye(8, 9))


def test_transitions_multiply_to_the_sensitivity(crane: Crane, start: np.ndarray, inputs: np.ndarray) -> None:
    result = swept(crane, start, inputs, [], [], want_phi=True)
    product = np.eye(8)
    for k in range(1, 100):
        product = result.Phi[k] @ product
    np.testing.assert_allclose(product, result.S[99], rtol=1e-8, atol=1e-9 * np.abs(result.S[99]).max())


def test_substeps_refine_the_run(crane: Crane, start: np.ndarray, inputs: np.ndarray) -> None:
    engine = SemiRecursiveEngine(crane, step=1e-3, accuracy=math.inf)
    fine = engine.simulate(start, np.arange(N) * H, inputs)
    result = swept(crane, start, inputs, [], [], substeps=5)
    np.testing.assert_allclose(result.X, fine, rtol=1e-8, atol=1e-9)


def test_a_failing_window_is_flagged_and_the_others_go_on(crane: Crane, start: np.ndarray, inputs: np.ndarray) -> None:
    first = np.array([0, 100, 200])
    wild = start.copy()
    wild[2:4] = 1e9, -1e9
    result = swept(crane, np.array([start, wild, start]), inputs, [], [], first=first)
    assert result.status.tolist() == [kernel.OK, kernel.NOT_CONVERGED, kernel.OK]
    assert result.failed.tolist() == [-1, 100, -1]
    assert np.isfinite(result.X[:101]).all() and np.isfinite(result.X[200:]).all()
    assert np.isnan(result.X[101:200]).all()


def test_a_machine_that_runs_away_ends_a_run_of_a_fit_but_no_other(crane: Crane) -> None:
    """A boom that spins at 360 rad/s in oil under tension needs thousands of parts in every step; no sample is like
    it.
    """
    away, W = np.array([1.05, -126.2, 15.6, -363.4, -6e7, 1.9e8, 2.6e8, -1.2e9]), np.full((101, 4), np.nan)
    W[:, :2] = 0.0
    result = swept(crane, away, W, [], [], allowed=10.0)
    assert result.status == kernel.TOO_COARSE and 0 <= result.failed[0] < 100
    assert np.isnan(result.X[result.failed[0] + 1 :]).all()
    machine = (crane.parameter_vector(), crane.effect_vector(), crane.machine.topology)
    fitting = kernel.simulate(away, W, np.arange(101) * H, H, *machine, 10.0, kernel.most_parts(10.0, H))
    assert fitting[1] == kernel.TOO_COARSE and fitting[2] < 100
    short = kernel.simulate(away, W[:2], np.arange(2) * H, H, *machine, 10.0, math.inf)
    assert short[1] == kernel.OK
