"""Constitutive laws against the formulas they stand for."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from crane_exudyn.crane import Crane
from crane_exudyn.laws.friction import cylinder_friction
from crane_exudyn.laws.oil import filling, pressure_of
from crane_exudyn.laws.orifice import edge_flow, root_drop
from crane_exudyn.laws.spool import spool_step
from crane_exudyn.laws.volume import chamber_lengths, chamber_volume

LAMINAR = 2e5


@pytest.mark.parametrize("dp", [2e5, 7e5, 1e7, -7e5, -1e7])
def test_turbulent_flow_is_the_signed_root(dp):
    assert root_drop(dp, LAMINAR) == math.copysign(math.sqrt(abs(dp)), dp)


@pytest.mark.parametrize("dp", [0.0, 1.0, 1.9e5, -5e4])
def test_flow_below_two_bar_is_linear(dp):
    assert root_drop(dp, LAMINAR) == pytest.approx(dp / math.sqrt(LAMINAR), rel=1e-15)


def test_flow_has_no_jump_at_two_bar():
    assert root_drop(LAMINAR * (1 - 1e-12), LAMINAR) == pytest.approx(root_drop(LAMINAR, LAMINAR), rel=1e-11)


def test_nominal_flow_of_a_valve():
    """Cv = 24 l/min at 7 bar over a fully open edge, and half of it at half the opening."""
    nominal = 24e-3 / 60.0
    assert edge_flow(nominal / math.sqrt(7e5), 1.0, 7e5, LAMINAR) == pytest.approx(nominal, rel=1e-15)
    assert edge_flow(nominal / math.sqrt(7e5), 0.5, -7e5, LAMINAR) == pytest.approx(-nominal / 2, rel=1e-15)


def test_spool_follows_a_step_like_an_exponential():
    assert spool_step(0.0, 1.0, 1.0, 0.03, 0.03) == pytest.approx(1.0 - math.exp(-1.0), rel=1e-15)


def test_spool_solves_its_equation_for_a_ramp():
    tau, dt, a, b, start = 0.03, 0.02, -0.2, 0.7, 0.4
    exact = solve_ivp(lambda t, u: (a + (b - a) * t / dt - u) / tau, (0, dt), [start], rtol=1e-12, atol=1e-14).y[0, -1]
    assert spool_step(start, a, b, dt, tau) == pytest.approx(exact, rel=1e-11)


def test_spool_without_lag_and_without_time():
    assert spool_step(0.3, 0.0, 0.8, 0.01, 0.0) == 0.8
    assert spool_step(0.3, 0.0, 0.8, 0.0, 0.03) == 0.3


OIL, WALL, HOSE, CHAMBER, HOSE_VOLUME = 1.65e9, 2.1e11, 7e8, 3.5e-3, 1.9e-4
SOFT, HOSE_SOFT = 1 / OIL + 1 / WALL, 1 / HOSE - 1 / WALL
PLAIN = Crane.load("patu655").effect_vector()
GASSY = {
    "none": PLAIN,
    "entrained": Crane.load("patu655").with_effect("entrained_air", {"alpha": 0.05}).effect_vector(),
    "released": Crane.load("patu655").with_effect("released_air", {"alpha": 0.1, "ps": 3e5}).effect_vector(),
}


def filled(E, y, chamber=CHAMBER, vapour=0.0):
    return filling(E, y, chamber, HOSE_VOLUME, SOFT, HOSE_SOFT, vapour, 0.0)


def test_the_amount_of_oil_gives_the_bulk_modulus_of_the_paper():
    """(41): the volume given up by oil, cylinder wall and hose per pressure adds up; V dp = Be Q without motion."""
    _, slope, _, density = filled(PLAIN, 80e5)
    given_up = (CHAMBER + HOSE_VOLUME) / OIL + CHAMBER / WALL + HOSE_VOLUME / HOSE
    assert slope / density == pytest.approx(given_up, rel=1e-12)


@pytest.mark.parametrize("gas", GASSY)
@pytest.mark.parametrize("y", [90e5, 2.7e5, 0.6e5, 1e4, -3e5])
def test_derivatives_of_the_amount_are_differences(gas, y):
    amount, slope, by_volume, _ = filled(GASSY[gas], y)
    difference = (filled(GASSY[gas], y + 1.0)[0] - filled(GASSY[gas], y - 1.0)[0]) / 2.0
    assert slope == pytest.approx(difference, rel=1e-6)
    assert by_volume == pytest.approx((filled(GASSY[gas], y, CHAMBER + 1e-6)[0] - amount) / 1e-6, rel=1e-7)


@pytest.mark.parametrize("gas", GASSY)
@pytest.mark.parametrize("y", [150e5, 5e5, 1e5, 0.0, -40e5])
@pytest.mark.parametrize("guess", [200e5, 0.1e5, -1e7])
def test_the_pressure_follows_from_the_amount(gas, y, guess):
    E = GASSY[gas]
    amount = filled(E, y)[0]
    found = pressure_of(E, amount, CHAMBER, HOSE_VOLUME, SOFT, HOSE_SOFT, 0.0, 0.0, guess)
    assert filled(E, found)[0] == pytest.approx(amount, rel=1e-15)
    assert found == pytest.approx(y, abs=1e-3)


def test_a_void_has_the_volume_that_the_oil_lacks():
    """At vapour pressure the oil fills what it filled there, however far the chamber is pulled open."""
    full = filled(PLAIN, 0.0)[0]
    pulled = pressure_of(PLAIN, full, CHAMBER + 1e-4, HOSE_VOLUME, SOFT, HOSE_SOFT, 0.0, 0.0, 0.0)
    softness = (CHAMBER + 1e-4 + HOSE_VOLUME) * SOFT + HOSE_VOLUME * HOSE_SOFT
    assert -pulled * softness == pytest.approx(1e-4, rel=1e-9)


def test_chambers_share_the_range_and_the_piston_side_grows():
    la, lb = chamber_lengths(0.99, 0.535, 0.82)
    assert (la, lb) == pytest.approx((0.455, 0.365), rel=1e-12)
    longer, _ = chamber_lengths(1.0, 0.535, 0.82)
    assert longer > la
    assert chamber_volume(1e-4, 7.854e-3, 0.455) == pytest.approx(1e-4 + 7.854e-3 * 0.455, rel=1e-15)


@pytest.mark.parametrize("v", [1e-4, 5e-3, 0.2])
def test_friction_is_the_formula_and_odd(v):
    fc, fs, vs, s2 = 210.0, 300.0, 5e-3, 330.0
    r = v / vs
    expected = fc * math.tanh(4 * r) + (fs - fc) * r / (r * r / 4 + 0.75) ** 2 + s2 * v * math.tanh(4)
    assert cylinder_friction(v, fc, fs, vs, s2) == pytest.approx(expected, rel=1e-15)
    assert cylinder_friction(-v, fc, fs, vs, s2) == -cylinder_friction(v, fc, fs, vs, s2)


def test_friction_peaks_at_the_static_value_and_is_zero_at_rest():
    assert cylinder_friction(0.0, 210.0, 300.0, 5e-3, 330.0) == 0.0
    v = np.linspace(1e-5, 2e-2, 4000)
    dry = [cylinder_friction(x, 210.0, 300.0, 5e-3, 0.0) for x in v]
    assert max(dry) == pytest.approx(300.0, abs=1.0)
    assert v[int(np.argmax(dry))] == pytest.approx(5e-3, rel=0.1)
