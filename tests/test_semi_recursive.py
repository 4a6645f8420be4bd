"""The semi-recursive engine against closed forms, invariants and the order of its rule."""

from __future__ import annotations

import cmath
import math
import resource
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.statics import visible
from validation.semi_recursive import SemiRecursiveEngine

DEGREE = math.pi / 180.0
CLOSED = np.array([0.0, 0.0, np.nan, np.nan])
#: machines with slides, spanning cylinders, one loop and two, beside the built-in crane
MACHINES = ("patu655", "mast", "slider", "digger", "linkage")
SWINGING = {"length": 0.8, "damping": 7.0}


def load(name: str) -> Crane:
    file = Path(__file__).parent / "machines" / f"{name}.toml"
    return Crane.load(file if file.exists() else name)


@pytest.fixture(scope="module")
def crane() -> Crane:
    return load("patu655")


@pytest.fixture(scope="module")
def engine(crane: Crane) -> SemiRecursiveEngine:
    return SemiRecursiveEngine(crane)


@pytest.fixture(scope="module", params=MACHINES)
def any_engine(request: pytest.FixtureRequest) -> SemiRecursiveEngine:
    return SemiRecursiveEngine(load(request.param))


def frictionless(crane: Crane) -> Crane:
    laws = ("coulomb_friction", "static_friction", "viscous_friction")
    return crane.with_parameters({f"cylinders.{c}.{law}": 0.0 for c in crane.layout.cylinders for law in laws})


def states_of(engine: SemiRecursiveEngine, count: int, seed: int = 1) -> np.ndarray:
    """States (count, nx) of any machine around its start."""
    rng, lay, pose = np.random.default_rng(seed), engine.crane.layout, engine.crane.initial.pose
    x = np.zeros((count, len(engine.state_names)))
    x[:, lay.positions] = pose + rng.uniform(-0.15, 0.15, (count, len(pose)))
    x[:, lay.velocities] = rng.normal(0.0, 0.4, (count, len(pose)))
    x[:, lay.pressures] = rng.uniform(5e5, 150e5, (count, len(lay.chambers)))
    x[:, 2 * len(lay.chambers) :] = rng.normal(0.0, 0.4, (count, x.shape[1] - 2 * len(lay.chambers)))
    return x


def closed(engine: SemiRecursiveEngine) -> np.ndarray:
    return np.array(engine.crane.layout.closed)


def random_states(count: int, nx: int = 8, seed: int = 1) -> np.ndarray:
    """States (count, nx) well inside the reach of the built-in crane."""
    rng = np.random.default_rng(seed)
    x = np.zeros((count, nx))
    x[:, 0], x[:, 1] = rng.uniform(-0.2, 0.9, count), rng.uniform(-1.9, -0.3, count)
    x[:, 2:4] = rng.normal(0.0, 0.4, (count, 2))
    x[:, 4:8] = rng.uniform(5e5, 150e5, (count, 4))
    x[:, 8:] = rng.normal(0.0, 0.4, (count, nx - 8))
    return x


def lagged_pulses(time: np.ndarray, pulses: list[tuple[float, float, float]], lag: float = 0.03) -> np.ndarray:
    """Sum of pulses (from, to, height) behind a first-order lag, exactly."""
    total = np.zeros_like(time)
    for start, end, height in pulses:
        for at, sign in ((start, 1.0), (end, -1.0)):
            total += sign * height * np.where(time > at, -np.expm1(-np.maximum(time - at, 0.0) / lag), 0.0)
    return total


def spools(
    time: np.ndarray, lift: list[tuple[float, float, float]], tilt: list[tuple[float, float, float]]
) -> np.ndarray:
    nan = np.full_like(time, np.nan)
    return np.column_stack([lagged_pulses(time, lift), lagged_pulses(time, tilt), nan, nan])


# -- kinematics --------------------------------------------------------------------------------------------------------


def test_the_check_pose_of_the_model_sheet(engine: SemiRecursiveEngine) -> None:
    x = np.array([0.4 * DEGREE, -45.57 * DEGREE, 1.0, 1.0, 1e6, 1e6, 1e6, 1e6])
    t = engine.terms(x, CLOSED)
    assert t["s1"] == pytest.approx(0.9381, abs=1e-4)
    assert t["s2"] == pytest.approx(1.2991, abs=1e-4)
    assert t["phi_bracket_1"] / DEGREE == pytest.approx(-65.62, abs=0.01)
    assert t["phi_bracket_2"] / DEGREE % 360.0 == pytest.approx(-200.66 % 360.0, abs=0.01)
    assert t["ds1"] == pytest.approx(0.308, abs=5e-4)
    assert t["ds2"] == pytest.approx(-0.332, abs=5e-4)


def test_the_loop_is_closed_and_its_brackets_keep_their_lengths(engine: SemiRecursiveEngine, crane: Crane) -> None:
    for x in random_states(50):
        t = engine.terms(x, CLOSED)
        assert (t["x_D_bracket"], t["y_D_bracket"]) == pytest.approx((t["x_D"], t["y_D"]), abs=1e-14)
        for first, last, joint in (("B", "C", "C"), ("C", "D", "D_bracket")):
            length = math.hypot(t[f"x_{last}"] - t[f"x_{first}"], t[f"y_{last}"] - t[f"y_{first}"])
            assert length == pytest.approx(
                math.hypot(crane[f"joints.{joint}.x"], crane[f"joints.{joint}.y"]), abs=1e-14
            )
        to_D = np.array([t["x_D"] - t["x_B"], t["y_D"] - t["y_B"]])
        to_C = np.array([t["x_C"] - t["x_B"], t["y_C"] - t["y_B"]])
        assert to_D[0] * to_C[1] - to_D[1] * to_C[0] > 0.0  # C is above the line B-D


def test_loops_are_closed_on_any_machine(any_engine: SemiRecursiveEngine) -> None:
    machine = any_engine.crane.machine
    for x in states_of(any_engine, 10):
        t = any_engine.terms(x, closed(any_engine))
        for joint in machine.loops:
            ends = [p.removeprefix("joints.") for p in (joint.pin, joint.own_pin)]
            for axis in "xy":
                assert t[f"{axis}_{ends[0]}"] == pytest.approx(t[f"{axis}_{ends[1]}"], abs=1e-13)


def test_rates_are_the_derivatives_of_positions(any_engine: SemiRecursiveEngine) -> None:
    eps, lay, machine = 1e-6, any_engine.crane.layout, any_engine.crane.machine
    dependent = [machine.carriers[body].coordinate for body in machine.dependent]
    for x in states_of(any_engine, 10):
        there = any_engine.terms(x, closed(any_engine))
        ahead, behind = x.copy(), x.copy()
        ahead[lay.positions] += eps * x[lay.velocities]
        behind[lay.positions] -= eps * x[lay.velocities]
        a, b = any_engine.terms(ahead, closed(any_engine)), any_engine.terms(behind, closed(any_engine))
        for length in lay.lengths:
            assert (a[length] - b[length]) / (2 * eps) == pytest.approx(there[f"d{length}"], abs=1e-8)
        for angle in dependent:
            difference = math.remainder(a[angle] - b[angle], math.tau) / (2 * eps)
            rate = sum(there[f"d{angle}_d{z}"] * x[lay.index(f"d{z}")] for z in lay.coordinates)
            assert difference == pytest.approx(rate, abs=1e-7)


# -- dynamics ----------------------------------------------------------------------------------------------------------


def body_centres(
    t: dict[str, float], crane: Crane, *, payload: bool = True
) -> list[tuple[float, np.ndarray, float, float]]:
    """(mass, centre, angle, inertia) of every body, the payload last, from points and angles."""
    machine, out = crane.machine, []
    for body in machine.bodies:
        point, name = next(
            (p, n) for (p, b), n in zip(machine.points.items(), machine.point_names, strict=True) if b == body
        )
        e = cmath.exp(1j * t[f"phi_{body}"])
        own = complex(crane[f"{point}.x"], crane[f"{point}.y"])
        com = complex(crane[f"bodies.{body}.com.x"], crane[f"bodies.{body}.com.y"])
        centre = complex(t[f"x_{name}"], t[f"y_{name}"]) + e * (com - own)
        mass, inertia = crane[f"bodies.{body}.mass"], crane[f"bodies.{body}.inertia"]
        out.append((mass, np.array([centre.real, centre.imag]), t[f"phi_{body}"], inertia))
    body, point = machine.payload
    if body and payload:
        m, name = crane["payload.mass"], point.removeprefix("joints.")
        J = m * (crane["payload.width"] ** 2 + crane["payload.height"] ** 2) / 12.0
        out.append((m, np.array([t[f"x_{name}"], t[f"y_{name}"]]), t[f"phi_{body}"], J))
    return out


def test_mass_matrix_and_gravity_are_those_of_the_bodies(any_engine: SemiRecursiveEngine) -> None:
    """M_ij = sum m dc/dz_i . dc/dz_j + J dphi/dz_i dphi/dz_j and Qg_i = -sum m g dy/dz_i, by central differences."""
    eps, crane, z = 1e-6, any_engine.crane, any_engine.crane.layout.coordinates
    for x in states_of(any_engine, 5):
        columns = []
        for i in range(len(z)):
            sides = []
            for sign in (1.0, -1.0):
                y = x.copy()
                y[i] += sign * eps
                sides.append(body_centres(any_engine.terms(y, closed(any_engine)), crane))
            columns.append(
                [
                    (a[0], (a[1] - b[1]) / (2 * eps), math.remainder(a[2] - b[2], math.tau) / (2 * eps), a[3])
                    for a, b in zip(*sides, strict=True)
                ]
            )
        t = any_engine.terms(x, closed(any_engine))
        for i, name in enumerate(z):
            for j in range(i, len(z)):
                both = zip(columns[i], columns[j], strict=True)
                expected = sum(a[0] * a[1] @ b[1] + a[3] * a[2] * b[2] for a, b in both)
                assert t[f"M_{name}_{z[j]}"] == pytest.approx(expected, rel=1e-6, abs=1e-5)
            assert t[f"Qg_{name}"] == pytest.approx(-sum(a[0] * 9.81 * a[1][1] for a in columns[i]), rel=1e-6, abs=1e-5)


def mass_matrix(t: dict[str, float], z: tuple[str, ...]) -> np.ndarray:
    n = range(len(z))
    return np.array([[t[f"M_{z[min(i, j)]}_{z[max(i, j)]}"] for j in n] for i in n])


def test_velocity_forces_follow_from_the_mass_matrix(any_engine: SemiRecursiveEngine) -> None:
    """Qv = 1/2 d(z'^T M z')/dz - M' z' (Lagrange)."""
    eps, z = 1e-5, any_engine.crane.layout.coordinates

    def mass(x: np.ndarray) -> np.ndarray:
        return mass_matrix(any_engine.terms(x, closed(any_engine)), z)

    for x in states_of(any_engine, 5):
        v = x[any_engine.crane.layout.velocities]
        derivative = []
        for i in range(len(z)):
            step = np.zeros(len(x))
            step[i] = eps
            derivative.append((mass(x + step) - mass(x - step)) / (2 * eps))
        expected = [0.5 * v @ d @ v for d in derivative] - sum(d * r for d, r in zip(derivative, v, strict=True)) @ v
        t = any_engine.terms(x, closed(any_engine))
        assert [t[f"Qv_{name}"] for name in z] == pytest.approx(list(expected), rel=1e-5, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "swings"), [(n, s) for n in MACHINES for s in (False, True) if not s or load(n).machine.payload[0]]
)
def test_power_of_the_cylinders_is_the_rate_of_mechanical_energy(name: str, swings: bool) -> None:
    """d/dt (kinetic + potential) = sum F s' + drag . v, with and without a pendulum.

    The drag on the hanging mass is -damping theta' / L across the rod.
    """
    crane = load(name)
    engine = SemiRecursiveEngine(crane.with_effect("payload_swing", SWINGING) if swings else crane)
    eps, lay, w, length = 1e-6, crane.layout, closed(engine), SWINGING["length"]
    end = 2 * len(lay.chambers)

    def masses(x: np.ndarray) -> list[tuple[float, np.ndarray, float, float]]:
        bodies = body_centres(engine.terms(x, w), crane)
        if swings:
            mass, E, _, _ = bodies.pop()
            bodies.append((mass, E + length * np.array([math.sin(x[end]), -math.cos(x[end])]), 0.0, 0.0))
        return bodies

    def moved(x: np.ndarray, rates: np.ndarray, dt: float) -> np.ndarray:
        y = x.copy()
        y[lay.positions] += dt * rates[: len(lay.coordinates)]
        y[end : end + 1] += dt * rates[len(lay.coordinates) :]
        return y

    def energy(x: np.ndarray, rates: np.ndarray) -> float:
        """Energy from positions of the bodies a moment before and after."""
        total = 0.0
        for a, b in zip(masses(moved(x, rates, eps)), masses(moved(x, rates, -eps)), strict=True):
            v, omega = (a[1] - b[1]) / (2 * eps), math.remainder(a[2] - b[2], math.tau) / (2 * eps)
            total += 0.5 * a[0] * v @ v + 0.5 * a[3] * omega * omega + a[0] * 9.81 * 0.5 * (a[1][1] + b[1][1])
        return total

    for x in states_of(engine, 4):
        t, dt = engine.terms(x, w), 1e-5
        rates = np.array([*x[lay.velocities], *x[end + 1 :]])
        accelerations = np.array([*(t[f"dd{z}"] for z in lay.coordinates), t["ddtheta"]])[: len(rates)]
        sides = [energy(moved(x, rates, s * dt), rates + s * dt * accelerations) for s in (1.0, -1.0)]
        power = sum(t[f"F{c + 1}"] * t[f"d{s}"] for c, s in enumerate(lay.lengths))
        if swings:
            v = (masses(moved(x, rates, eps))[-1][1] - masses(moved(x, rates, -eps))[-1][1]) / (2 * eps)
            power -= SWINGING["damping"] * x[end + 1] / length * v @ np.array([math.cos(x[end]), math.sin(x[end])])
        assert (sides[0] - sides[1]) / (2 * dt) == pytest.approx(power, rel=1e-4, abs=0.2)


def test_terms_sum_to_the_accelerations(any_engine: SemiRecursiveEngine) -> None:
    lay = any_engine.crane.layout
    w = closed(any_engine)
    w[lay.spools] = 0.3
    for x in states_of(any_engine, 10):
        t = any_engine.terms(x, w)
        force = [sum(t[f"{q}_{z}"] for q in ("Qg", "Qv", "Qh", "Qj")) for z in lay.coordinates]
        inertia = mass_matrix(t, lay.coordinates) @ [t[f"dd{z}"] for z in lay.coordinates]
        assert inertia == pytest.approx(force, rel=1e-9, abs=1e-6)


def test_disturbances_act_on_joints_payload_and_chambers() -> None:
    """A force on a slide is one along it; a force on the payload does the work of its point's velocity."""
    engine = SemiRecursiveEngine(load("slider"))
    lay, x = engine.crane.layout, states_of(engine, 1)[0]
    w = np.zeros(len(lay.all_inputs))
    w[lay.supplies] = 160e5, 1e5
    w[[lay.all_inputs.index(n) for n in ("torque.S", "force.x", "force.y", "flow.p3")]] = 10.0, 70.0, -50.0, 1e-6
    t = engine.terms(x, w)
    eps, sides = 1e-6, []
    for sign in (1.0, -1.0):
        y = x.copy()
        y[lay.positions] += sign * eps * x[lay.velocities]
        there = engine.terms(y, w)
        sides.append(np.array([there["x_T"], there["y_T"]]))
    power = np.array([70.0, -50.0]) @ (sides[0] - sides[1]) / (2 * eps) + 10.0 * x[lay.index("dreach")]
    assert sum(t[f"Qj_{z}"] * x[lay.index(f"d{z}")] for z in lay.coordinates) == pytest.approx(power, rel=1e-7)
    assert (t["leak3"], t["leak4"]) == (1e-6, 0.0)


# -- hydraulics --------------------------------------------------------------------------------------------------------


def test_edge_flows_by_the_formula(engine: SemiRecursiveEngine, crane: Crane) -> None:
    """(15) and its laminar part, for both directions, into the piston side and out of the rod side."""

    def q(dp: float) -> float:
        return math.copysign(math.sqrt(abs(dp)), dp) if abs(dp) >= 2e5 else dp / math.sqrt(2e5)

    Cv = crane["valves.lift.flow_coefficient"]
    for p1, p2 in ((40e5, 20e5), (99.5e5, 1.5e5), (120e5, 0.5e5)):
        x = np.array([0.2, -0.7, 0.0, 0.0, p1, p2, 20e5, 30e5])
        up, down = (engine.terms(x, np.array([u, 0.0, 100e5, 1e5])) for u in (0.6, -0.6))
        assert up["Q1"] == pytest.approx(0.6 * Cv * q(100e5 - p1), rel=1e-13)
        assert up["Q2"] == pytest.approx(0.6 * Cv * q(p2 - 1e5), rel=1e-13)
        assert down["Q1"] == pytest.approx(-0.6 * Cv * q(p1 - 1e5), rel=1e-13)
        assert down["Q2"] == pytest.approx(-0.6 * Cv * q(100e5 - p2), rel=1e-13)


def test_edges_of_a_valve_have_factors_of_their_own() -> None:
    engine = SemiRecursiveEngine(load("mast"))
    same = SemiRecursiveEngine(
        engine.crane.with_parameters({n: 1.0 for n in engine.crane.machine.names if ".edges." in n})
    )
    x = np.array([0.2, 0.0, 60e5, 30e5])
    for u, factors in ((0.5, {"Q1": 1.0, "Q2": 1.2}), (-0.5, {"Q1": 0.5, "Q2": 0.8})):
        own, plain = (e.terms(x, np.array([u, 160e5, 1e5])) for e in (engine, same))
        for flow, factor in factors.items():
            assert own[flow] == pytest.approx(factor * plain[flow], rel=1e-14) and own[flow] != 0.0


def test_closed_valves_keep_the_oil(engine: SemiRecursiveEngine, crane: Crane) -> None:
    """Without flow each chamber obeys p' = -Be V' / V, and V1'/A1 + V2'/A2 = 0."""
    x = random_states(1)[0]
    t = engine.terms(x, CLOSED)
    A1 = math.pi / 4 * 0.1**2
    A2 = A1 - math.pi / 4 * 0.056**2
    for i, (area, rate, sign) in enumerate(
        ((A1, t["ds1"], 1), (A2, t["ds1"], -1), (A1, t["ds2"], 1), (A2, t["ds2"], -1)), start=1
    ):
        assert t[f"dp{i}"] == pytest.approx(-t[f"Be{i}"] / t[f"V{i}"] * sign * area * rate, rel=1e-12)


def test_static_start_stays_where_it_is(engine: SemiRecursiveEngine) -> None:
    for z1, z4 in ((10.0, -40.0), (40.0, -90.0), (0.0, -20.0)):
        x0 = engine.static_start(z1 * DEGREE, z4 * DEGREE)
        assert min(x0[4:6]) == 20e5 and min(x0[6:8]) == 20e5
        time = np.linspace(0.0, 1.0, 101)
        X = engine.simulate(x0, time, np.tile(CLOSED, (101, 1)))
        np.testing.assert_allclose(X[-1], x0, rtol=1e-12, atol=1e-12)


def test_the_start_of_any_machine_is_at_rest(any_engine: SemiRecursiveEngine) -> None:
    rule, lay = any_engine.crane.initial, any_engine.crane.layout
    x = any_engine.static_start(*rule.pose, rule.less_loaded_pressure)
    np.testing.assert_array_equal(x, any_engine.static_start(*rule.pose, less_loaded=rule.less_loaded_pressure))
    low = x[lay.pressures].reshape(-1, 2).min(axis=1)
    np.testing.assert_array_equal(low, np.broadcast_to(rule.less_loaded_pressure, low.shape))
    t = any_engine.terms(x, closed(any_engine))
    assert [t[f"dd{z}"] for z in lay.coordinates] == pytest.approx([0.0] * len(lay.coordinates), abs=1e-9)


def test_a_start_wants_a_number_for_each_coordinate(engine: SemiRecursiveEngine) -> None:
    for pose in ((0.2,), (0.2, -0.7, 20e5, 20e5)):
        with pytest.raises(CraneError, match="wants 2 numbers, z1, z4"):
            engine.static_start(*pose)


def test_steady_lifting_speed_is_flow_over_area(engine: SemiRecursiveEngine) -> None:
    time = np.linspace(0.0, 2.5, 2501)
    W = spools(time, [(0.1, 9.0, 0.4)], [])
    X = engine.simulate(engine.static_start(0.0, -0.7), time, W)
    t = engine.terms(X[-1], W[-1], time[-1])
    assert t["ds1"] == pytest.approx(t["Q1"] / (math.pi / 4 * 0.1**2), rel=2e-3)  # oil still compresses a little
    assert t["ds1"] > 0.02


def test_pressures_stop_at_the_vapour_floor(crane: Crane) -> None:
    """The boom falls into an opened lift cylinder faster than oil follows on the rod side."""
    engine = SemiRecursiveEngine(crane.with_parameters({"supply.pump_pressure": 3e5, "payload.mass": 300.0}))
    time = np.linspace(0.0, 1.0, 1001)
    X = engine.simulate(engine.static_start(0.7, -0.7), time, spools(time, [(0.05, 9.0, -1.0)], []))
    shown = visible(engine.crane, X)
    assert shown[:, 4:].min() == 0.0
    assert np.count_nonzero(shown[:, 5] == 0.0) > 50
    t = engine.terms_along(X, spools(time, [(0.05, 9.0, -1.0)], []), time)
    void = t["V2"] - t["N2"]  # at vapour pressure, here 0, the oil has the volume N
    assert -X[-1, 5] * (t["V2"][-1] / t["Be2"][-1]) == pytest.approx(void[-1], rel=1e-9) and void[-1] > 1e-4


def test_pump_droop_balances_pressure_and_flow(crane: Crane) -> None:
    R = 1e10
    engine = SemiRecursiveEngine(
        crane.with_effect("pump_droop", {"R": R}).with_effect("return_back_pressure", {"R": R})
    )
    for x in random_states(20):
        t = engine.terms(x, np.array([0.7, -0.8, np.nan, np.nan]))
        assert t["pp"] == pytest.approx(100e5 - R * (t["Q1"] - t["Q4"]), rel=1e-12)
        assert t["pt"] == pytest.approx(1e5 + R * (t["Q2"] - t["Q3"]), rel=1e-11)


def test_series_spring_shares_the_motion(crane: Crane) -> None:
    """Hydraulic rate = pin rate + F'/k with F' from the pressure rates."""
    k = 1e7
    engine = SemiRecursiveEngine(crane.with_effect("structural_compliance@tilt", {"stiffness": k}))
    A3 = math.pi / 4 * 0.1**2
    A4 = A3 - math.pi / 4 * 0.056**2
    for x in random_states(10):
        t = engine.terms(x, np.array([0.0, 0.5, np.nan, np.nan]))
        assert t["v_h2"] == pytest.approx(t["ds2"] + (A3 * t["dp3"] - A4 * t["dp4"]) / k, rel=1e-9, abs=1e-12)
        assert t["l3"] == pytest.approx(t["s2"] + (A3 * x[6] - A4 * x[7]) / k - 0.78, abs=1e-12)


# -- integration -------------------------------------------------------------------------------------------------------


def test_second_order_in_the_step(engine: SemiRecursiveEngine) -> None:
    time = np.linspace(0.0, 0.4, 41)
    W = np.column_stack([0.4 * np.sin(4 * time) ** 2, -0.3 * np.sin(5 * time) ** 2, *np.full((2, 41), np.nan)])
    x0 = engine.static_start(0.2, -0.7)
    fine = engine.simulate(x0, time, W, step=2.5e-5)[-1]
    steps = (1.25e-3, 6.25e-4, 3.125e-4)
    errors = [np.abs(engine.simulate(x0, time, W, step=h)[-1] - fine) / np.abs(fine) for h in steps]
    for coarse, half in pairwise(errors):
        order = math.log2(np.linalg.norm(coarse) / np.linalg.norm(half))
        assert 1.8 < order < 2.2


def oil_energy(crane: Crane, x0: np.ndarray, T: dict[str, np.ndarray]) -> np.ndarray:
    """-integral of the cylinder forces over their lengths from x0 on, closed chambers: p' = -Be(V)/V V' by RK4 on a
    grid.
    """
    total, fluid = 0.0, {n: crane[f"fluid.{n}_bulk_modulus"] for n in ("oil", "cylinder", "hose")}
    for c, name in enumerate(crane.layout.cylinders):
        bore, rod = crane[f"cylinders.{name}.bore"], crane[f"cylinders.{name}.rod"]
        s = T[crane.layout.lengths[c]]
        grid = np.linspace(s.min(), s.max(), 20001)
        energy = np.zeros_like(grid)
        for side, area in enumerate((math.pi / 4 * bore**2, math.pi / 4 * (bore**2 - rod**2))):
            l = grid - crane[f"cylinders.{name}.empty_length"]
            l = l if side == 0 else crane[f"cylinders.{name}.chamber_range"] - l
            Vh = crane[f"cylinders.{name}.hose_volume_{('piston', 'rod')[side]}"]
            # Be(V)/V = 1 / (V/Bo + A l/Bc + Vh/Bh) is linear in the denominator, so p is a logarithm
            slope = 1.0 / fluid["oil"] + 1.0 / fluid["cylinder"]
            denominator = (Vh + area * l) / fluid["oil"] + area * l / fluid["cylinder"] + Vh / fluid["hose"]
            p = -np.log(denominator) / slope
            p += x0[crane.layout.pressures_of(c)][side] - np.interp(s[0], grid, p)
            force = (1, -1)[side] * area * p
            energy -= np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(grid))])
        total = total + np.interp(s, grid, energy)
    return np.asarray(total)


@pytest.mark.parametrize("name", MACHINES)
def test_energy_stays_without_losses(name: str) -> None:
    """Closed valves and no friction: kinetic and potential energy and that of the oil's springs sum to a constant.

    What is left falls with the square of the step, so it is the rule's and not the equations'.
    """
    crane = frictionless(load(name))
    engine, lay = SemiRecursiveEngine(crane, accuracy=math.inf), crane.layout  # steps as they are asked for
    x0 = engine.static_start(*crane.initial.pose, 80e5)  # far from vapour, which would take energy
    x0[lay.velocities] = 0.1 if len(lay.coordinates) == 1 else [0.1, *np.zeros(len(lay.coordinates) - 1)]
    step = 8e-3 if name == "patu655" else 2e-3  # the others ring faster
    time = np.arange(201) * step
    W = np.tile(closed(engine), (201, 1))

    def drift(step: float) -> float:
        X = engine.simulate(x0, time, W, step=step)
        T = engine.terms_along(X, W, time)
        rows = [{n: float(v[k]) for n, v in T.items()} for k in range(len(X))]
        v = X[:, lay.velocities]
        kinetic = np.array([0.5 * r @ mass_matrix(t, lay.coordinates) @ r for r, t in zip(v, rows, strict=True)])
        potential = np.array([sum(m * 9.81 * r[1] for m, r, _, _ in body_centres(t, crane)) for t in rows])
        total = kinetic + potential + oil_energy(crane, x0, T)
        return float(np.ptp(total) / kinetic.max())

    coarse, fine = drift(step), drift(0.5 * step)
    assert fine < 1e-3
    assert 3.5 < coarse / fine < 4.5


def test_propagate_is_pure_and_rows_are_independent(engine: SemiRecursiveEngine) -> None:
    states = random_states(17, seed=4)
    w = np.array([[0.3, -0.2, np.nan, np.nan], [0.32, -0.2, np.nan, np.nan]])
    first = engine.propagate(states, w, 1e-3, time=2.0)
    np.testing.assert_array_equal(first, engine.propagate(states, w, 1e-3, time=2.0))
    alone = np.vstack([engine.propagate(row[None], w, 1e-3, time=2.0) for row in states])
    np.testing.assert_allclose(first, alone, rtol=1e-9, atol=1e-9)  # Newton ends at 1e-13 rad, 2e-10 rad/s
    run = engine.simulate(states[3], np.array([2.0, 2.001]), w)
    np.testing.assert_allclose(run[-1], first[3], rtol=1e-9, atol=1e-9)
    each = engine.propagate(states, np.repeat(w[:, None], 17, axis=1), 1e-3, time=2.0)
    np.testing.assert_array_equal(first, each)


def test_a_rough_batch_is_solved_to_a_small_share_of_what_it_may_err(crane: Crane) -> None:
    """A filter's step may be off by bars; solved as well as a run's it would take a fifth longer."""
    rough, lay = SemiRecursiveEngine(crane, accuracy=600.0), crane.layout
    as_asked = SemiRecursiveEngine(crane, accuracy=math.inf)  # no step is halved here, and all are solved to the end
    states = random_states(17, seed=4)
    w = np.array([[0.3, -0.2, np.nan, np.nan], [0.32, -0.2, np.nan, np.nan]])
    apart = np.abs(rough.propagate(states, w, 1e-3) - as_asked.propagate(states, w, 1e-3))
    assert rough.halved == 0
    assert apart[:, lay.positions].max() < 1e-9 and apart[:, lay.velocities].max() < 2e-6
    assert 0.0 < apart[:, lay.pressures].max() < 2.0


def test_own_effects_at_their_neutral_values_change_no_bit(engine: SemiRecursiveEngine, crane: Crane) -> None:
    from crane_exudyn.effects import registry

    neutral = crane
    for key in registry.all_keys(crane.layout):
        effect, _ = registry.split_key(key)
        neutral = neutral.with_effect(key, {p.name: p.neutral for p in effect.parameters})
    other = SemiRecursiveEngine(neutral)
    time = np.linspace(0.0, 1.0, 201)
    W = spools(time, [(0.1, 0.6, 0.6)], [(0.2, 0.7, -0.5)])
    x0 = engine.static_start(0.2, -0.7)
    np.testing.assert_array_equal(engine.simulate(x0, time, W), other.simulate(x0, time, W))


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_an_unreachable_pose_is_named(crane: Crane) -> None:
    short = SemiRecursiveEngine(crane.with_parameters({"joints.D_bracket.x": -0.15}))
    with pytest.raises(
        CraneError, match=r"loop A-B-C-D of .* cannot be closed at z1 = 10\.00 deg, z4 = 120\.00 deg: D is out of reach"
    ):
        short.static_start(10 * DEGREE, 120 * DEGREE)
    digger = SemiRecursiveEngine(load("digger").with_parameters({"joints.C.x": 0.05}))
    with pytest.raises(CraneError, match=r"loop J3-R-L-C of digger .* C is out of reach of rocker and link"):
        digger.static_start(*digger.crane.initial.pose)


def test_poses_are_told_in_the_units_of_their_coordinates() -> None:
    engine = SemiRecursiveEngine(load("slider"))
    with pytest.raises(CraneError, match=r"State: lift = 20\.00 deg, reach = 3\.0000 m, tilt = .*dreach = 0 m/s"):
        engine.simulate(engine.static_start(20 * DEGREE, 3.0, -0.5), np.arange(0.0, 0.02, 0.01), np.zeros((2, 5)))


def test_a_start_below_vapour_pressure_is_refused_by_both(engine: SemiRecursiveEngine, crane: Crane) -> None:
    for one in (engine, ExudynEngine(crane)):
        with pytest.raises(CraneError, match="below vapour pressure"):
            one.static_start(0.2, -0.7, less_loaded=-1e5)


def test_both_start_beyond_a_stroke_and_neither_runs_from_there(engine: SemiRecursiveEngine, crane: Crane) -> None:
    """A measured pose may lie a little beyond the stroke that a crane file says."""
    time, w = np.array([0.0, 0.01]), np.array([[0.0, 0.0, np.nan, np.nan]] * 2)
    short = crane.with_parameters({"cylinders.lift.chamber_range": 0.5})
    for kind in (SemiRecursiveEngine, ExudynEngine):
        one = kind(short)
        start = one.static_start(0.6, -0.7)  # 0.09 m beyond it
        assert np.isfinite(start).all()
        with pytest.raises(CraneError, match="stroke"):
            one.simulate(start, time, w)


def test_a_step_must_be_positive(engine: SemiRecursiveEngine, crane: Crane) -> None:
    start, w = engine.static_start(0.2, -0.7)[None], np.array([[0.0, 0.0, np.nan, np.nan]] * 2)
    for one in (engine, ExudynEngine(crane)):
        for dt in (0.0, -1e-3, math.nan):
            with pytest.raises(CraneError, match="is not positive"):
                one.propagate(start, w, dt)


def test_cylinders_without_leverage_are_refused() -> None:
    """The rod's pin of the mast's cylinder on the line from its base through the joint."""
    engine = SemiRecursiveEngine(
        load("mast").with_parameters({"cylinders.lift.rod_end.x": 0.0, "cylinders.lift.rod_end.y": 0.0})
    )
    with pytest.raises(CraneError, match=r"no leverage at z = 15\.00 deg"):
        engine.static_start(15 * DEGREE)


def test_the_end_of_a_stroke_is_named_with_time_and_state(engine: SemiRecursiveEngine) -> None:
    time = np.linspace(0.0, 25.0, 2501)
    with pytest.raises(CraneError, match=r"end of its stroke at t = \d+\.\d+ s \(lift, rod side empty.*State: z1 = "):
        engine.simulate(engine.static_start(0.2, -0.7), time, spools(time, [(0.0, 30.0, 1.0)], []))


def test_a_step_that_does_not_converge_is_named(engine: SemiRecursiveEngine) -> None:
    x0 = engine.static_start(0.2, -0.7)
    x0[2:4] = 1e9, -1e9
    with pytest.raises(CraneError, match=r"after t = 3\.0000 s \(sample 0\) did not converge.*halved.*State: z1 = "):
        engine.simulate(x0, np.array([3.0, 3.1]), np.tile(CLOSED, (2, 1)))
    with pytest.raises(CraneError, match="row 1 of the batch"):
        engine.propagate(np.vstack([engine.static_start(0.2, -0.7), x0]), np.tile(CLOSED, (2, 1)), 0.1)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"x0": np.zeros(7)}, "x0 have the shape"),
        ({"time": np.array([0.0, 1.0, 1.0])}, "does not increase from sample 1"),
        ({"inputs": np.zeros((2, 4))}, r"inputs \(2, 4\)"),
        ({"inputs": np.full((3, 4), np.nan)}, "spool position at sample 0"),
    ],
)
def test_bad_arguments_are_told(engine: SemiRecursiveEngine, change: dict[str, np.ndarray], message: str) -> None:
    arguments = {"x0": engine.static_start(0.2, -0.7), "time": np.arange(3.0), "inputs": np.tile(CLOSED, (3, 1))}
    with pytest.raises(CraneError, match=message):
        engine.simulate(**(arguments | change))


def test_a_long_run_needs_no_more_memory_than_it_stores(engine: SemiRecursiveEngine) -> None:
    """200 000 steps of which two samples are kept: the largest memory of the process stays where it was."""
    x0 = engine.static_start(0.2, -0.7)
    W = np.tile(CLOSED, (2, 1))
    engine.simulate(x0, np.array([0.0, 1.0]), W)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    engine.simulate(x0, np.array([0.0, 200.0]), W)
    grown_kb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown_kb < 2000  # all states would be 12 500
