"""Constitutive laws against the formulas they stand for."""

import math

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from crane_exudyn.laws.bulk_modulus import effective_bulk_modulus
from crane_exudyn.laws.friction import cylinder_friction
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


def test_effective_bulk_modulus_is_a_sum_of_compliances():
    """(41): the volume given up by oil, cylinder wall and hose per pressure adds up."""
    oil, wall, hose, chamber, hose_volume = 1.65e9, 2.1e11, 7e8, 3.5e-3, 1.9e-4
    given_up = (chamber + hose_volume) / oil + chamber / wall + hose_volume / hose
    expected = (chamber + hose_volume) / given_up
    assert effective_bulk_modulus(1 / oil, wall, hose, chamber, hose_volume) == pytest.approx(expected, rel=1e-15)
    assert effective_bulk_modulus(1 / oil, math.inf, math.inf, chamber, hose_volume) == pytest.approx(oil, rel=1e-15)


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
