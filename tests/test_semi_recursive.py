"""The semi-recursive engine against closed forms, invariants and the order of its rule."""

from __future__ import annotations

import math
import resource
from itertools import pairwise

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.statics import visible
from validation.semi_recursive import SemiRecursiveEngine, kernel

DEGREE = math.pi / 180.0
CLOSED = np.array([0.0, 0.0, np.nan, np.nan])
BODIES = ("lift_boom", "bracket_1", "bracket_2", "outer_boom")
FRICTIONLESS = {
    f"cylinders.{c}.{n}": 0.0
    for c in ("lift", "tilt")
    for n in ("coulomb_friction", "static_friction", "viscous_friction")
}


@pytest.fixture(scope="module")
def crane() -> Crane:
    return Crane.load("patu655")


@pytest.fixture(scope="module")
def engine(crane: Crane) -> SemiRecursiveEngine:
    return SemiRecursiveEngine(crane)


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


def test_rates_are_the_derivatives_of_positions(engine: SemiRecursiveEngine) -> None:
    eps = 1e-6
    for x in random_states(20):
        ahead, behind, there = x.copy(), x.copy(), engine.terms(x, CLOSED)
        ahead[:2] += eps * x[2:4]
        behind[:2] -= eps * x[2:4]
        a, b = engine.terms(ahead, CLOSED), engine.terms(behind, CLOSED)
        for length, rate in (("s1", there["ds1"]), ("s2", there["ds2"])):
            assert (a[length] - b[length]) / (2 * eps) == pytest.approx(rate, abs=1e-9)
        for angle in ("z2", "z3"):
            difference = math.remainder(a[angle] - b[angle], math.tau) / (2 * eps)
            assert difference == pytest.approx(there[f"d{angle}_dz4"] * x[3], abs=1e-8)


def test_lengths_of_many_angles_are_those_of_the_states(engine: SemiRecursiveEngine, crane: Crane) -> None:
    x = random_states(20)
    rows = [engine.terms(row, CLOSED) for row in x]
    P = crane.parameter_vector()
    for cylinder in (0, 1):
        expected = [t[f"s{cylinder + 1}"] for t in rows]
        np.testing.assert_allclose(kernel.cylinder_lengths(cylinder, x[:, cylinder].copy(), P), expected, rtol=1e-14)


# -- dynamics ----------------------------------------------------------------------------------------------------------


def body_centres(
    t: dict[str, float], crane: Crane, z1: float, z4: float
) -> list[tuple[float, np.ndarray, float, float]]:
    """(mass, centre, angle, inertia) of every body, the payload last, from points and angles."""
    angles = (z1, t["phi_bracket_1"], t["phi_bracket_2"], z1 + z4)
    out = []
    for body, joint, angle in zip(BODIES, ("O", "B", "C", "A"), angles, strict=True):
        cx, cy = crane[f"bodies.{body}.com.x"], crane[f"bodies.{body}.com.y"]
        c, s = math.cos(angle), math.sin(angle)
        centre = np.array([t[f"x_{joint}"] + c * cx - s * cy, t[f"y_{joint}"] + s * cx + c * cy])
        out.append((crane[f"bodies.{body}.mass"], centre, angle, crane[f"bodies.{body}.inertia"]))
    m = crane["payload.mass"]
    J = m * (crane["payload.width"] ** 2 + crane["payload.height"] ** 2) / 12.0
    return [*out, (m, np.array([t["x_E"], t["y_E"]]), z1 + z4, J)]


def test_mass_matrix_and_gravity_are_those_of_the_bodies(engine: SemiRecursiveEngine, crane: Crane) -> None:
    """M_ij = sum m dc/dz_i . dc/dz_j + J dphi/dz_i dphi/dz_j and Qg_i = -sum m g dy/dz_i, by central differences."""
    eps = 1e-6
    for x in random_states(10):
        columns = []
        for i in range(2):
            sides = []
            for sign in (1.0, -1.0):
                y = x.copy()
                y[i] += sign * eps
                sides.append(body_centres(engine.terms(y, CLOSED), crane, y[0], y[1]))
            columns.append(
                [
                    (a[0], (a[1] - b[1]) / (2 * eps), math.remainder(a[2] - b[2], math.tau) / (2 * eps), a[3])
                    for a, b in zip(*sides, strict=True)
                ]
            )
        t = engine.terms(x, CLOSED)
        for name, i, j in (("M11", 0, 0), ("M12", 0, 1), ("M22", 1, 1)):
            terms = zip(columns[i], columns[j], strict=True)
            assert t[name] == pytest.approx(sum(a[0] * a[1] @ b[1] + a[3] * a[2] * b[2] for a, b in terms), rel=1e-7)
        for name, i in (("Qg1", 0), ("Qg4", 1)):
            assert t[name] == pytest.approx(-sum(a[0] * 9.81 * a[1][1] for a in columns[i]), rel=1e-7)


def test_velocity_forces_follow_from_the_mass_matrix(engine: SemiRecursiveEngine) -> None:
    """Qv = 1/2 d(z'^T M z')/dz - M' z' (Lagrange)."""
    eps = 1e-5

    def mass(x: np.ndarray) -> np.ndarray:
        t = engine.terms(x, CLOSED)
        return np.array([[t["M11"], t["M12"]], [t["M12"], t["M22"]]])

    for x in random_states(10):
        v = x[2:4]
        derivative = []
        for i in range(2):
            step = np.zeros(8)
            step[i] = eps
            derivative.append((mass(x + step) - mass(x - step)) / (2 * eps))
        expected = [0.5 * v @ d @ v for d in derivative] - (derivative[0] * v[0] + derivative[1] * v[1]) @ v
        t = engine.terms(x, CLOSED)
        assert [t["Qv1"], t["Qv4"]] == pytest.approx(list(expected), rel=1e-6, abs=1e-4)


@pytest.mark.parametrize("length", [0.0, 0.8])
def test_power_of_the_cylinders_is_the_rate_of_mechanical_energy(crane: Crane, length: float) -> None:
    """d/dt (kinetic + potential) = F1 s1' + F2 s2' + drag . v, with and without a pendulum.

    The drag on the hanging mass is -damping theta' / L across the rod.
    """
    damping = 7.0
    changed = crane.with_effect("payload_swing", {"length": length, "damping": damping}) if length else crane
    engine = SemiRecursiveEngine(changed)
    eps = 1e-6

    def energy(x: np.ndarray, rates: np.ndarray) -> float:
        """Energy from positions of the bodies a moment before and after."""
        sides, pendulum = [], []
        for sign in (1.0, -1.0):
            y = x.copy()
            y[:2] += sign * eps * rates[:2]
            t = engine.terms(y, CLOSED)
            centres = body_centres(t, crane, y[0], y[1])
            if length:
                theta = x[8] + sign * eps * rates[2]
                mass, E, _, _ = centres.pop()
                pendulum.append((mass, E + length * np.array([math.sin(theta), -math.cos(theta)]), 0.0, 0.0))
            sides.append([*centres, *pendulum[-1:]])
        total = 0.0
        for a, b in zip(*sides, strict=True):
            v, w = (a[1] - b[1]) / (2 * eps), math.remainder(a[2] - b[2], math.tau) / (2 * eps)
            total += 0.5 * a[0] * v @ v + 0.5 * a[3] * w * w + a[0] * 9.81 * 0.5 * (a[1][1] + b[1][1])
        return total

    for x in random_states(6, 10 if length else 8):
        t = engine.terms(x, CLOSED)
        dt = 1e-5
        rates, accelerations = np.array([*x[2:4], *x[9:]]), np.array([t["ddz1"], t["ddz4"], t["ddtheta"]])
        energies = []
        for sign in (1.0, -1.0):
            y = x.copy()
            y[:2] += sign * dt * rates[:2]
            y[8:9] += sign * dt * rates[2:]
            energies.append(energy(y, rates + sign * dt * accelerations[: len(rates)]))
        power = t["F1"] * t["ds1"] + t["F2"] * t["ds2"]
        if length:
            across = np.array([math.cos(x[8]), math.sin(x[8])])
            arms = [np.array([t["x_E"] - t[f"x_{r}"], t["y_E"] - t[f"y_{r}"]]) for r in ("O", "A")]
            v = sum(rate * np.array([-r[1], r[0]]) for rate, r in zip(x[2:4], arms, strict=True))
            power -= damping * x[9] / length * (v @ across + length * x[9])
        assert (energies[0] - energies[1]) / (2 * dt) == pytest.approx(power, rel=1e-4, abs=0.05)


def test_terms_sum_to_the_accelerations(engine: SemiRecursiveEngine) -> None:
    for x in random_states(20):
        t = engine.terms(x, np.array([0.4, -0.3, np.nan, np.nan]))
        force = [sum(t[f"{q}{i}"] for q in ("Qg", "Qv", "Qh", "Qj")) for i in (1, 4)]
        inertia = [t["M11"] * t["ddz1"] + t["M12"] * t["ddz4"], t["M12"] * t["ddz1"] + t["M22"] * t["ddz4"]]
        assert inertia == pytest.approx(force, rel=1e-9, abs=1e-6)


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
    """-integral of the cylinder forces over their lengths from x0 on, closed chambers: p' = -Be(V)/V V' by RK4 on a grid."""
    engine_areas = [math.pi / 4 * 0.1**2, math.pi / 4 * (0.1**2 - 0.056**2)]
    total = np.zeros_like(T["s1"])
    for c, name in enumerate(("lift", "tilt")):
        s = T[f"s{c + 1}"]
        grid = np.linspace(s.min(), s.max(), 20001)
        energy = np.zeros_like(grid)
        for side, area in enumerate(engine_areas):
            l = grid - crane[f"cylinders.{name}.empty_length"]
            l = l if side == 0 else crane[f"cylinders.{name}.chamber_range"] - l
            Vh = crane[f"cylinders.{name}.hose_volume_{('piston', 'rod')[side]}"]
            V = Vh + area * l
            # Be(V)/V = 1 / (V/Bo + A l/Bc + Vh/Bh) is linear in the denominator, so p is a logarithm
            slope = 1.0 / 1.65e9 + 1.0 / 2.1e11
            denominator = V / 1.65e9 + area * l / 2.1e11 + Vh / 7.0e8
            p = -np.log(denominator) / slope
            p += x0[4 + 2 * c + side] - np.interp(s[0], grid, p)
            force = (1, -1)[side] * area * p
            energy -= np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(grid))])
        total += np.interp(s, grid, energy)
    return total


def test_energy_stays_without_losses(crane: Crane) -> None:
    """Closed valves and no friction: kinetic and potential energy and that of the oil's springs sum to a constant.

    What is left falls with the square of the step, so it is the rule's and not the equations'.
    """
    engine = SemiRecursiveEngine(crane.with_parameters(FRICTIONLESS), accuracy=math.inf)  # steps as they are asked for
    x0 = engine.static_start(0.3, -0.8, 80e5)  # far from vapour, which would take energy
    x0[2] = 0.1
    time = np.linspace(0.0, 1.6, 101)

    def drift(step: float) -> float:
        X = engine.simulate(x0, time, np.tile(CLOSED, (101, 1)), step=step)
        T = engine.terms_along(X, np.tile(CLOSED, (101, 1)), time)
        kinetic = 0.5 * (T["M11"] * X[:, 2] ** 2 + 2 * T["M12"] * X[:, 2] * X[:, 3] + T["M22"] * X[:, 3] ** 2)
        rows = [{n: float(v[k]) for n, v in T.items()} for k in range(len(X))]
        centres = [body_centres(t, crane, x[0], x[1]) for t, x in zip(rows, X, strict=True)]
        potential = np.array([sum(m * 9.81 * r[1] for m, r, _, _ in bodies) for bodies in centres])
        total = kinetic + potential + oil_energy(crane, x0, T)
        return float(np.ptp(total) / kinetic.max())

    coarse, fine = drift(8e-3), drift(4e-3)
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


def test_own_effects_at_their_neutral_values_change_no_bit(engine: SemiRecursiveEngine, crane: Crane) -> None:
    from crane_exudyn.effects import registry

    neutral = crane
    for key in registry.all_keys():
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
    with pytest.raises(CraneError, match=r"cannot be closed at z1 = 10\.00 deg, z4 = 120\.00 deg"):
        short.static_start(10 * DEGREE, 120 * DEGREE)


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
