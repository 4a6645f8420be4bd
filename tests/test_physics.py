"""Checks of the engine against things that nobody here chose: conservation laws, closed forms, eigenvalues, order of
convergence.
"""

import math

import numpy as np
import pytest
from scipy.optimize import brentq

from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError

CRANE = Crane.load("patu655")
SMOOTH = CRANE.with_parameters(
    {
        f"cylinders.{c}.{p}": 0.0
        for c in ("lift", "tilt")
        for p in ("coulomb_friction", "static_friction", "viscous_friction")
    }
)
AREAS = (math.pi / 4 * 0.1**2, math.pi / 4 * (0.1**2 - 0.056**2)) * 2
POSE = (0.35, -0.8)


def closed(n):
    """Return inputs (n, 4) with both valves closed."""
    return np.tile([0.0, 0.0, np.nan, np.nan], (n, 1))


def ringing_start(crane, push=15e5):
    """Return a static start with the lift's pressure raised, so that everything rings."""
    start = ExudynEngine(crane).static_start(*POSE)
    start[4] += push
    start[7] -= push
    return start


class Chamber:
    """A closed chamber by closed form: B/V = 1/(a + b l), so p + A/b ln(a + b l) is constant, whatever moves.

    (41) times V: V/B = (Vh + A l)/Bo + A l/Bc + Vh/Bh = a + b l.
    """

    def __init__(self, crane, number):
        cylinder = ("lift", "tilt")[number // 2]
        hose = crane[f"cylinders.{cylinder}.hose_volume_{('piston', 'rod')[number % 2]}"]
        oil, wall, soft = (crane[f"fluid.{p}_bulk_modulus"] for p in ("oil", "cylinder", "hose"))
        self.area, self.a = AREAS[number], hose * (1 / oil + 1 / soft)
        self.b = self.area * (1 / oil + 1 / wall)
        empty, reach = crane[f"cylinders.{cylinder}.empty_length"], crane[f"cylinders.{cylinder}.chamber_range"]
        self.length = (lambda s: s - empty) if number % 2 == 0 else (lambda s: empty + reach - s)

    def oil(self, s, p):
        """Return what stays the same while no oil passes: the logarithm of the chamber's mass in Pa."""
        return p + self.area / self.b * np.log(self.a + self.b * self.length(s))

    def energy(self, s, p):
        """Return the energy stored by compression in J: minus the integral of p A dl along the closed chamber's
        path.
        """
        x, l = self.a + self.b * self.length(s), self.length(s)
        return -self.area * (self.oil(s, p) * l - self.area / self.b**2 * x * (np.log(x) - 1.0))


def total_energy(crane, engine, run):
    """Return kinetic + potential + oil energy (N,) of a run with closed valves, and without swinging payload."""
    bodies = ("lift_boom", "bracket_1", "bracket_2", "outer_boom")
    energy = []
    for x in run:
        t = engine.terms(x, closed(1)[0])
        kinetic = 0.5 * (t["M_z1_z1"] * x[2] ** 2 + 2 * t["M_z1_z4"] * x[2] * x[3] + t["M_z4_z4"] * x[3] ** 2)
        origin = {"lift_boom": "O", "bracket_1": "B", "bracket_2": "C", "outer_boom": "A"}
        angle = dict(zip(bodies, (x[0], t["phi_bracket_1"], t["phi_bracket_2"], x[0] + x[1]), strict=True))
        height = sum(
            crane[f"bodies.{b}.mass"]
            * (
                t[f"y_{origin[b]}"]
                + math.sin(angle[b]) * crane[f"bodies.{b}.com.x"]
                + math.cos(angle[b]) * crane[f"bodies.{b}.com.y"]
            )
            for b in bodies
        )
        potential = crane["gravity"] * (height + crane["payload.mass"] * t["y_E"])
        oil = sum(Chamber(crane, i).energy(t["s1"] if i < 2 else t["s2"], x[4 + i]) for i in range(4))
        energy.append(kinetic + potential + oil)
    return np.array(energy)


def ring(crane, step, duration=0.4):
    engine, n = ExudynEngine(crane, accuracy=np.inf), round(duration / step) + 1
    return engine, engine.simulate(ringing_start(crane), np.linspace(0.0, duration, n), closed(n), step=step * 1.001)


def test_energy_is_constant_without_losses():
    """The trapezoidal rule keeps energy to second order: halving the step leaves a quarter of the wobble."""
    wobble = {}
    for step in (2e-3, 1e-3):
        engine, run = ring(SMOOTH, step)
        energy = total_energy(SMOOTH, engine, run[:: round(4e-3 / step)])
        kinetic = 0.5 * 2500.0 * np.max(run[:, 2] ** 2)
        assert kinetic > 1.0
        wobble[step] = np.ptp(energy) / kinetic
    assert wobble[1e-3] < 5e-3  # the faster mode has 187 rad/s: (omega h)^2 / 12 = 3e-3
    assert wobble[2e-3] / wobble[1e-3] == pytest.approx(4.0, rel=0.15)


def test_energy_falls_with_friction():
    engine, run = ring(CRANE, 1e-3)
    energy = total_energy(CRANE, engine, run[::4])
    lost = energy[0] - energy
    assert lost[-1] > 1.0
    assert np.all(np.diff(energy) < 1e-3 * lost[-1])


def test_loss_of_energy_is_the_work_of_friction():
    """Both by second-order rules; friction changes its sign within a few steps, hence 0.5 %."""
    engine, run = ring(CRANE, 5e-4)
    terms = [engine.terms(x, closed(1)[0]) for x in run]
    power = np.array([t["Fmu1"] * t["ds1"] + t["Fmu2"] * t["ds2"] for t in terms])
    work = np.trapezoid(power, dx=5e-4)
    energy = total_energy(CRANE, engine, run[[0, -1]])
    assert energy[0] - energy[1] == pytest.approx(work, rel=5e-3)


@pytest.mark.parametrize("length", [0.6, 2.0])
def test_pendulum_swings_at_its_frequency(length):
    """With the pump's oil locked in and a light payload the boom hardly moves: T = 2 pi sqrt(L/g) for small angles."""
    crane = CRANE.with_parameters({"payload.mass": 0.01}).with_effect("payload_swing", {"length": length})
    engine, time = ExudynEngine(crane), np.arange(0.0, 6.0, 2e-3)
    start = engine.static_start(*POSE)
    start[8] = 0.02
    theta = engine.simulate(start, time, closed(time.size), step=2e-3)[:, 8]
    up = np.flatnonzero((theta[:-1] < 0.0) & (theta[1:] >= 0.0))
    crossings = time[up] - theta[up] * 2e-3 / (theta[up + 1] - theta[up])
    assert np.diff(crossings).mean() == pytest.approx(2 * math.pi * math.sqrt(length / 9.81), rel=2e-4)
    assert np.max(theta[-2000:]) == pytest.approx(0.02, rel=5e-3)


def test_pendulum_damping_is_its_torque():
    """m L^2 theta'' + d theta' + m g L theta = 0 decays with d / (2 m L^2)."""
    mass, length, damping = 5.0, 1.0, 2.0
    crane = CRANE.with_parameters(
        {"payload.mass": mass, "fluid.oil_bulk_modulus": 1e13, "fluid.hose_bulk_modulus": 1e13}
    )
    crane = crane.with_effect("payload_swing", {"length": length, "damping": damping})
    engine, time = ExudynEngine(crane), np.arange(0.0, 5.0, 2e-3)
    start = engine.static_start(*POSE)
    start[8] = 0.02
    theta = engine.simulate(start, time, closed(time.size), step=2e-3)[:, 8]
    peaks = np.flatnonzero((theta[1:-1] > theta[:-2]) & (theta[1:-1] >= theta[2:])) + 1
    rate = -np.polyfit(time[peaks], np.log(theta[peaks]), 1)[0]
    assert rate == pytest.approx(damping / (2 * mass * length**2), rel=0.01)


def test_oil_of_closed_chambers_is_constant():
    """Whatever the step; the pressures themselves move by tens of bar."""
    for step in (2e-3, 1e-3):
        engine, run = ring(CRANE, step)
        s = np.array([[t["s1"], t["s2"]] for t in (engine.terms(x, closed(1)[0]) for x in run[:: round(8e-3 / step)])])
        p = run[:: round(8e-3 / step), 4:8]
        assert np.ptp(p[:, 0]) > 10e5
        oil = np.column_stack([Chamber(CRANE, i).oil(s[:, i // 2], p[:, i]) for i in range(4)])
        assert np.max(np.abs(oil - oil[0])) < 0.1  # Pa, of a million


@pytest.mark.parametrize("pose", [(0.0, -0.5), (0.17, -0.7), (0.8, -1.7)])
@pytest.mark.parametrize("low", [20e5, (10e5, 35e5)])
def test_crane_with_closed_valves_stays(pose, low):
    engine = ExudynEngine(CRANE)
    start = engine.static_start(*pose, less_loaded=low)
    lows = np.broadcast_to(low, 2)
    assert min(start[4], start[5]) == lows[0]
    assert min(start[6], start[7]) == lows[1]
    terms = engine.terms(start, closed(1)[0])
    assert terms["ddz1"] == pytest.approx(0.0, abs=1e-12)
    assert terms["ddz4"] == pytest.approx(0.0, abs=1e-12)
    time = np.arange(0.0, 1.0, 1e-3)
    end = engine.simulate(start, time, closed(time.size))[-1]
    assert end[:4] == pytest.approx(start[:4], abs=1e-10)
    assert end[4:] == pytest.approx(start[4:], abs=0.1)


def test_static_start_is_refused_where_it_cannot_be():
    engine = ExudynEngine(CRANE)
    with pytest.raises(CraneError, match="below vapour pressure"):
        engine.static_start(*POSE, less_loaded=-1e5)
    dead_point = brentq(lambda z4: engine.terms(np.array([0, z4, 0, 1.0, *[1e6] * 4]), closed(1)[0])["ds2"], 0.3, 0.5)
    with pytest.raises(CraneError, match="tilt cylinder has no leverage"):
        engine.static_start(0.2, dead_point)


def test_steady_lift_speed_is_flow_over_area():
    """Where pressures have settled, A1 v = Cv U sqrt(pp - p1), A2 v = Cv U q(p2 - pt), and the forces balance: solved
    here.

    The load changes slowly with the pose, so that the oil's own rate of change is left: under 1 % of the flow.
    """
    engine, opening = ExudynEngine(CRANE), 0.5
    time = np.arange(0.0, 1.5, 1e-3)
    inputs = np.tile([opening, 0.0, np.nan, np.nan], (time.size, 1))
    end = engine.simulate(engine.static_start(0.1, -0.7), time, inputs)[-1]
    terms = engine.terms(end, inputs[0])
    cv = 24e-3 / 60 / math.sqrt(7e5) * opening

    def p2_of(v):
        turbulent = (AREAS[1] * v / cv) ** 2
        return 1e5 + (turbulent if turbulent > 2e5 else AREAS[1] * v / cv * math.sqrt(2e5))

    def imbalance(v):
        p1 = 100e5 - (AREAS[0] * v / cv) ** 2
        friction = 210.0 + 90.0 * (r := v / 5e-3) / (r * r / 4 + 0.75) ** 2 + 330.0 * v * math.tanh(4.0)
        return p1 * AREAS[0] - p2_of(v) * AREAS[1] - friction - terms["F1"]

    speed = brentq(imbalance, 1e-3, 1.0)
    assert terms["ds1"] == pytest.approx(speed, rel=0.01)
    assert terms["ds1"] == pytest.approx(terms["Q1"] / AREAS[0], rel=0.01)
    assert terms["ds1"] == pytest.approx(terms["Q2"] / AREAS[1], rel=0.01)


def hydraulic_stiffness(terms):
    """Return the closed cylinders' stiffness A^2 B/V of both chambers, (2,) in N/m."""
    per_chamber = [AREAS[i] ** 2 * terms[f"Be{i + 1}"] / terms[f"V{i + 1}"] for i in range(4)]
    return np.array([per_chamber[0] + per_chamber[1], per_chamber[2] + per_chamber[3]])


def state_matrix(engine, state):
    """Return d(dz, ddz, dp)/dx (8, 8) by central differences of what Exudyn assembles, reduced by its own G.

    Accelerations come from the saddle point system [M G^T; G 0] [a; lambda] = [f; -dG/dt v] at rest (v = 0 to first
    order).
    """

    def rates(x):
        exu = engine.residual(x, closed(1)[0])
        rows = exu["joint_jacobian"]
        saddle = np.block([[exu["mass"], rows.T], [rows, np.zeros((len(rows), len(rows)))]])
        a = np.linalg.solve(saddle, np.concatenate([exu["force"], np.zeros(len(rows))]))
        return np.array([x[2], x[3], a[2], a[5] - a[2], *exu["pressure_rates"]])

    steps = np.array([1e-6, 1e-6, 1e-5, 1e-5, *[1e2] * 4])
    return np.column_stack(
        [(rates(state + d) - rates(state - d)) / (2 * h) for h, d in zip(steps, np.diag(steps), strict=True)]
    )


def test_natural_frequencies():
    """Two pairs of eigenvalues of the assembled system, against M, D^T k D and the geometric stiffness by hand, and
    against a run.
    """
    engine = ExudynEngine(SMOOTH)
    start = engine.static_start(*POSE)
    eigenvalues = np.linalg.eigvals(state_matrix(engine, start))
    frequencies = np.sort(eigenvalues.imag[eigenvalues.imag > 1.0])
    assert frequencies.size == 2

    t = engine.terms(start, closed(1)[0])
    mass = np.array([[t["M_z1_z1"], t["M_z1_z4"]], [t["M_z1_z4"], t["M_z4_z4"]]])
    leverage = [
        engine.terms(start + d, closed(1)[0])[name] for name, d in (("ds1", np.eye(8)[2]), ("ds2", np.eye(8)[3]))
    ]
    oil = np.diag(hydraulic_stiffness(t) * np.square(leverage))

    def load(z):  # generalised forces with the pressures held
        u = engine.terms(np.array([*z, *start[2:]]), closed(1)[0])
        return np.array([u["Qg_z1"] + u["Qh_z1"], u["Qg_z4"] + u["Qh_z4"]])

    d = 1e-6
    geometric = -np.column_stack([(load(start[:2] + e) - load(start[:2] - e)) / (2 * d) for e in d * np.eye(2)])
    by_hand = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(mass, oil + geometric)).real))
    assert frequencies == pytest.approx(by_hand, rel=1e-5)

    time = np.arange(0.0, 3.0, 1e-3)
    kicked = start.copy()
    kicked[4] += 1e4  # small: the ringing stays linear
    z1 = engine.simulate(kicked, time, closed(time.size))[:, 0]
    spectrum = np.abs(np.fft.rfft((z1 - z1.mean()) * np.hanning(z1.size), 16 * z1.size))
    peak = 2 * np.pi * np.fft.rfftfreq(16 * z1.size, 1e-3)[np.argmax(spectrum)]
    assert peak == pytest.approx(frequencies[0], rel=0.01)


def test_convergence_is_of_second_order():
    """Halving the step quarters the error, in the middle of a motion with both valves open."""
    engine = ExudynEngine(CRANE, accuracy=np.inf)
    w = np.array([0.4, 0.3, np.nan, np.nan])
    start = engine.simulate(engine.static_start(0.1, -0.5), np.array([0.0, 0.5]), np.array([w, w]))[-1]
    steps = (2e-3, 1e-3, 5e-4, 2.5e-4)
    ends = {h: engine.simulate(start, np.array([0.0, 0.24]), np.array([w, w]), step=h)[-1] for h in steps}
    scale = np.array([1, 1, 1, 1, 1e7, 1e7, 1e7, 1e7])
    changes = [np.linalg.norm((ends[h] - ends[h / 2]) / scale) for h in steps[:-1]]
    orders = np.log2(np.array(changes[:-1]) / changes[1:])
    assert orders == pytest.approx(2.0, abs=0.25)


def test_spring_in_series_sags_and_softens():
    """A spring of stiffness k in series with the closed cylinder: 1/(stiffness seen at the pins) = 1/oil + 1/k."""
    k = 2e7
    soft = SMOOTH.with_effect("structural_compliance@lift", {"stiffness": k})
    start = ExudynEngine(SMOOTH).static_start(*POSE)
    stiff_rates = ExudynEngine(SMOOTH).terms(start + 0.1 * np.eye(8)[2], closed(1)[0])
    soft_rates = ExudynEngine(soft).terms(start + 0.1 * np.eye(8)[2], closed(1)[0])
    oil = hydraulic_stiffness(soft_rates)[0]
    force_rate = soft_rates["dp1"] * AREAS[0] - soft_rates["dp2"] * AREAS[1]
    assert -force_rate / soft_rates["ds1"] == pytest.approx(1.0 / (1.0 / oil + 1.0 / k), rel=1e-12)
    assert abs(soft_rates["dp1"]) < 0.8 * abs(stiff_rates["dp1"])
    # the hydraulic length is the pins' length plus F/k
    sag = (soft_rates["V1"] - stiff_rates["V1"]) / AREAS[0]
    assert sag == pytest.approx((start[4] * AREAS[0] - start[5] * AREAS[1]) / k, rel=1e-9)
