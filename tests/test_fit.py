"""The fitting machinery: algebra against dense solutions, laws against closed forms, a fit against what made the
data.
"""

import math
from dataclasses import replace
from unittest.mock import patch

import numpy as np
import pytest

from crane_exudyn import Crane, Recording
from crane_exudyn.channels import Channel
from crane_exudyn.drive import with_steps
from crane_exudyn.measurement import Measurement
from validation.criteria import CRITERIA
from validation.fit import linear, sweeps
from validation.fit.columns import columns_of, model_at, pack
from validation.fit.data import ACCURACY, ACCURATE, FitData, Samples, data_of
from validation.fit.knots import begun_anew, reknot
from validation.fit.linear import Linear, linearised, near, normal_equations, robust
from validation.fit.model import model_of
from validation.fit.solve import bounded_step, covariance, fit, reduce
from validation.fit.staged import (
    LOOSE,
    STIFF,
    TIGHT,
    all_parameters,
    first_knots,
    residuals,
    rms,
    run_fitted,
    staged,
    timings,
)
from validation.fit.sweeps import RATE, ROUGHLY, forgotten, sweep
from validation.fit.variables import effect_variables, uncertain_parameters, with_variables
from validation.fit.windows import Group, cut
from validation.selection.granted import alike, otherwise
from validation.selection.levels import levels_of
from validation.selection.model import Model, fitted, moved_to
from validation.selection.screen import likely, screened
from validation.selection.search import Problem
from validation.selection.white import WHITE, taken_otherwise
from validation.semi_recursive import kernel, sensitivity
from validation.semi_recursive.engine import SemiRecursiveEngine

NOISE = {"z1": math.radians(0.05), "z4": math.radians(0.05), "p1": 3e4, "p2": 3e4, "p3": 3e4, "p4": 3e4}


def recorded(crane: Crane, seconds: float = 6.0, seed: int = 7, rate: float = 200.0) -> Recording:
    """Return a noisy recording of a crane that lifts, lowers and tilts."""
    time = np.arange(0.0, seconds, 1.0 / rate)
    commands = np.column_stack(
        [
            np.interp(time, [0, 0.5, 0.7, 1.6, 1.8, 3.5, 3.7, 4.6, 4.8], [0, 0, 0.3, 0.3, 0, 0, -0.3, -0.3, 0]),
            np.interp(time, [0, 2.0, 2.2, 2.9, 3.1, 4.9, 5.1, 5.5], [0, 0, 0.3, 0.3, 0, 0, -0.25, 0]),
        ]
    )
    return driven(crane, time, commands, (0.2, -0.8), seed)


def driven(crane: Crane, time: np.ndarray, commands: np.ndarray, pose: tuple[float, float], seed: int = 7) -> Recording:
    """Return a noisy recording of a crane with commands (n, 2), from rest in a pose."""
    from crane_exudyn.inputs import SpoolPath

    engine = SemiRecursiveEngine(crane)
    w = np.column_stack([SpoolPath(crane).run(time, commands), np.full((len(time), 2), np.nan)])
    X = engine.simulate(engine.static_start(*pose), time, w)
    rng = np.random.default_rng(seed)
    seen = Measurement.of(crane, tuple(NOISE)).shown(X, time)
    values = {n: v + NOISE[n] * rng.standard_normal(len(time)) for n, v in zip(NOISE, seen.T, strict=True)}
    return Recording.from_arrays("made", time, {"u1": commands[:, 0], "u2": commands[:, 1], **values})


def test_the_robust_cost_is_the_sum_of_squares_until_noise_is_exceeded_and_logarithmic_beyond():
    assert robust(80.0, 100) == (80.0, 1.0)
    cost, weight = robust(100.0 * (1.0 + math.e - 1.0), 100)
    assert cost == pytest.approx(200.0)
    assert weight == pytest.approx(math.exp(-1.0))
    h = 1e-4  # the weight is the derivative of the cost by the sum of squares
    assert (robust(300.0 + h, 100)[0] - robust(300.0 - h, 100)[0]) / (2 * h) == pytest.approx(
        robust(300.0, 100)[1], rel=1e-6
    )


@pytest.mark.parametrize("seed", range(20))
def test_a_bounded_step_is_the_unbounded_one_inside_and_the_least_within_bounds(seed):
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((9, 9)) * 10.0 ** rng.uniform(-1, 1, 9)[:, None]
    H, g, u = A @ A.T + np.eye(9), 10.0 * rng.standard_normal(9), np.zeros(9)
    free = bounded_step(H, g, u, np.full(9, -np.inf), np.full(9, np.inf), 0.0)
    assert free == pytest.approx(-np.linalg.solve(H, g), rel=1e-7)
    held = bounded_step(H, g, u, np.full(9, -0.05), np.full(9, 0.05), 0.0)
    assert np.all(np.abs(held) <= 0.05 + 1e-12)
    slope, small = H @ held + g, 1e-6 * np.abs(g).max()
    assert np.all(slope[held < 0.05 - 1e-9] > -small)  # the cost falls nowhere: it rises into each bound,
    assert np.all(slope[held > -0.05 + 1e-9] < small)  # and is level where none holds


def test_normal_equations_keep_their_digits_beside_a_window_that_multiplies_its_first_state():
    rng, K, nx, stiffness = np.random.default_rng(0), 6, 4, 100.0
    J = rng.standard_normal((K - 1, nx, nx))
    J[2] += 1e10 * np.outer(rng.standard_normal(nx), rng.standard_normal(nx))
    H = np.tile(1e-3 * np.eye(nx), (K, 1, 1))
    H[:-1] += stiffness**2 * J.transpose(0, 2, 1) @ J
    H[1:] += stiffness**2 * np.eye(nx)
    linear = Linear(
        H, -(stiffness**2) * J.transpose(0, 2, 1), np.ones((K, nx, 1)), np.full((1, 1), 10.0), np.ones((K, nx)),
        np.ones(1), {}, {}, np.zeros(K), np.zeros(K), np.zeros(K - 1), np.ones(nx), np.full(nx, 1e-3),
    )  # fmt: skip
    reduced = reduce(linear, np.zeros((K, nx)), np.zeros((K, nx)))
    assert reduced is not None
    assert not linear.failed


@pytest.fixture(scope="module")
def nominal():
    crane = Crane.load("patu655")
    return crane, FitData.of(recorded(crane), crane)


def test_eliminating_knots_equals_the_dense_solution(nominal):
    crane, data = nominal
    variables = uncertain_parameters(crane)[:3]
    windows, knots, u = cut(data, 1.0), first_knots(crane, data, 1.0), np.zeros(3)
    base = model_at(crane, variables, u, data)
    linear = normal_equations(windows, knots, base, columns_of(crane, variables, u, base, data), 5.0)
    K, nx, m = linear.Hxu.shape
    H, g = np.zeros((K * nx + m,) * 2), np.concatenate([linear.gx.ravel(), linear.gu])
    for k in range(K):
        a = slice(k * nx, (k + 1) * nx)
        H[a, a] = linear.Hxx[k] + np.diag(linear.weak) + 1e-9 * np.eye(nx)
        H[a, K * nx :] = linear.Hxu[k]
        H[K * nx :, a] = linear.Hxu[k].T
        if k + 1 < K:
            b = slice((k + 1) * nx, (k + 2) * nx)
            H[a, b], H[b, a] = linear.Hxo[k], linear.Hxo[k].T
    H[K * nx :, K * nx :] = linear.Huu
    dense = np.linalg.solve(H, -g)
    reduced = reduce(linear, knots, knots)
    du = -np.linalg.solve(reduced.H, reduced.g)
    assert du == pytest.approx(dense[K * nx :], rel=1e-5)
    assert (reduced.knots_step + reduced.knots_by_u @ du).ravel() == pytest.approx(dense[: K * nx], rel=1e-4, abs=1e-6)


def test_the_gradient_is_the_slope_of_the_cost(nominal):
    crane, data = nominal
    variables, windows, knots = uncertain_parameters(crane)[-6:], cut(data, 2.0), first_knots(crane, data, 2.0)

    def cost(u):
        base = model_at(crane, variables, u, data)
        return normal_equations(windows, knots, base, columns_of(crane, variables, u, base, data), 1.0)

    linear = cost(np.zeros(6))
    for j in (1, 4):
        h = 1e-3 * np.eye(6)[j]
        slope = 0.5 * (cost(h).cost - cost(-h).cost) / 2e-3
        assert slope == pytest.approx(linear.gu[j], rel=2e-2, abs=1.0)  # robust weights and 2.5 ms steps bend a little


def test_a_clean_recording_is_explained_down_to_its_noise(nominal):
    crane, data = nominal
    result = staged(crane, data, (), np.zeros(0), first_knots(crane, data), (LOOSE, TIGHT, STIFF))
    n = data.count
    assert result.error == pytest.approx(1.0, abs=4.0 / math.sqrt(2.0 * n) + 0.01)  # 1 % for the estimated noise


def test_a_window_whose_run_fails_neither_ends_a_fit_nor_bends_it(nominal):
    crane, data = nominal
    windows, knots = cut(data, 0.25), first_knots(crane, data)
    usual = fit(crane, data, windows, knots, (), stiffness=10.0)
    astray = knots.copy()
    astray[5] = 1e6
    for given, failed in ((astray, False), (np.full_like(knots, 1e6), True)):
        assert fit(crane, data, windows, given, (), stiffness=10.0, iterations=0).linear.failed == failed
    found = fit(crane, data, windows, astray, (), stiffness=10.0)
    assert found.linear.window_error[6:] == pytest.approx(usual.linear.window_error[6:], rel=0.05)
    assert found.linear.window_error[:5] == pytest.approx(usual.linear.window_error[:5], rel=0.05)
    assert found.linear.window_error[5] > 100.0


def test_a_window_that_was_caught_in_a_false_minimum_begins_anew(nominal):
    crane, data = nominal
    windows, knots = cut(data, 0.25), first_knots(crane, data)
    usual = fit(crane, data, windows, knots, (), stiffness=10.0)
    caught = usual.knots.copy()
    caught[5:7, 0] += 0.5
    caught[9] = 1e6
    anew = begun_anew(crane, data, windows, caught, (), np.zeros(0), 10.0)
    others = np.setdiff1d(np.arange(len(windows)), (5, 6, 9))
    assert (anew[others] == caught[others]).all(), "those that are explained stay"
    found = staged(crane, data, (), np.zeros(0), caught, (TIGHT,))
    assert found.linear.window_error == pytest.approx(usual.linear.window_error, rel=0.02)


@pytest.mark.parametrize(
    ("key", "true", "start"),
    [
        ("internal_leakage@lift", {"k": 6e-12}, {"k": 1e-12}),
        ("dead_band@tilt", {"lower": 0.04, "upper": 0.06}, {"lower": 0.01, "upper": 0.01}),
        ("entrained_air", {"alpha": 0.01}, {"alpha": 0.003}),
        ("command_delay@lift", {"T": 0.05}, {"T": 0.02}),
        ("spool_creep@lift", {"kappa": 0.2, "tau": 0.6}, {"kappa": 0.05, "tau": 1.0}),
        ("sensor_lag@p1", {"tau": 0.05}, {"tau": 0.02}),
        ("structural_compliance@lift", {"stiffness": 8e6}, {"stiffness": 5e7}),
    ],
)
def test_an_effect_is_found_back_within_three_standard_deviations_or_three_percent(key, true, start):
    crane = Crane.load("patu655")
    data = FitData.of(recorded(crane.with_effect(key, true)), crane)
    variables = effect_variables(key, start, crane.layout)
    u = np.array([v.to_u(v.start) for v in variables])
    loose = staged(crane, data, variables, u, first_knots(crane, data), (LOOSE,))
    result = staged(crane, data, variables, loose.u, loose, (TIGHT, STIFF))
    found = result.crane.effect(key).parameters
    for v in variables:
        name = v.parameter.name
        assert found[name] == pytest.approx(true[name], rel=0.03, abs=3.0 * result.std(v.name) * v.scale)
    assert result.error < 1.05


def test_no_step_of_a_fit_makes_an_impossible_crane():
    """A leading fit once let the pump fall below the tank, which ended the diagnosis with an error."""
    crane = Crane.load("patu655")
    variables = uncertain_parameters(crane)
    for far in (-1e3, 1e3):
        moved = with_variables(crane, variables, np.full(len(variables), far))
        assert moved["supply.pump_pressure"] > moved["supply.tank_pressure"]
    crossed = np.array(
        [{"supply.pump_pressure": -1e3, "supply.tank_pressure": 1e3}.get(v.name, 0.0) for v in variables]
    )
    assert with_variables(crane, variables, crossed)["supply.pump_pressure"] > 0.0


def test_a_fit_says_whether_it_converged(nominal):
    crane, data = nominal
    windows = cut(data, 1.0)
    assert fit(crane, data, windows, first_knots(crane, data, 1.0), iterations=8).converged


def test_a_lagging_sensors_unknown_first_value_is_integrated_out():
    index = np.arange(0, 120, 4)
    sample = Samples("p1", index, np.full(len(index), 0.5), np.zeros(len(index)), 3e4)
    rng = np.random.default_rng(5)
    r = rng.standard_normal((len(index), 2))
    found, cost = forgotten(r, sample, 2.5e-3, 0.05, RATE["Pa"])
    shape = np.exp(-2.5e-3 * (index + 0.5) / 0.05) * 0.05 * RATE["Pa"] / 3e4
    C = np.eye(len(index)) + np.outer(shape, shape)
    assert found.T @ found == pytest.approx(r.T @ np.linalg.solve(C, r), rel=1e-9)
    assert cost == pytest.approx(np.linalg.slogdet(C)[1], rel=1e-9)


def test_the_derivative_by_a_lag_tells_what_is_forgotten_with_another():
    crane = Crane.load("patu655").with_effect("sensor_lag@p1", {"tau": 0.3})
    data = FitData.of(recorded(crane), crane)
    variables, windows = effect_variables("sensor_lag@p1", {"tau": 0.27}, crane.layout), cut(data, 0.25)
    u, group, x0 = np.array([v.begin for v in variables]), Group(tuple(windows)), first_knots(crane, data, 0.25)

    def left(u):
        base = model_at(crane, variables, u, data)
        return [np.concatenate(own) for own in group.split(sweeps.left_in(group, sweeps.ran(group, x0, base)[0], base))]

    h, base = 1e-3, model_at(crane, variables, u, data)
    quotients = [(a - b) / (2.0 * h) for a, b in zip(left(u - h), left(u + h), strict=True)]
    swept = sweep(group, x0, base, columns_of(crane, variables, u, base, data))
    pairs = [(s.J[:, -1], q) for s, q in zip(swept[1:], quotients[1:], strict=True)]
    assert sum((J - q) @ (J - q) for J, q in pairs) < 0.05 * sum(q @ q for _, q in pairs)


def test_what_was_averaged_of_a_recording_is_averaged_of_a_run():
    crane, time = Crane.load("patu655"), np.arange(0.0, 4.0, 1e-3)
    corner = np.maximum(50e5 - 1e8 * np.abs(np.sin(9.0 * time)), 0.0)  # as of a chamber that boils
    steady = {"u1": 0.0 * time, "u2": 0.0 * time, "z1": 0.2 + 0.0 * time}
    recording = Recording.from_arrays("corners", time, {**steady, "p2": corner})
    data = FitData.of(recording, replace(crane, sensors={"z1": 1e-3, "p2": 3e4}))
    grid = np.append(corner, corner[-1])
    (sample,) = (s for s in data.samples if s.channel == "p2")
    middle = (sample.values - sample.taken(grid)) / sample.noise
    assert np.abs(middle).max() > 20.0
    assert np.abs(sample.residuals(grid)).max() < 1e-6
    for w in cut(data, 0.25):  # windows begin between two blocks
        (own,) = (s for s in w.data.samples if s.channel == "p2")
        assert np.abs(own.residuals(grid[w.start : w.start + len(w.data.time)])).max() < 1e-6
    coarse = data.with_step(2.5e-3)
    (own,) = (s for s in coarse.samples if s.channel == "p2")
    ramp = 1e7 * coarse.time**2
    blocks = (1e7 * time**2).reshape(-1, 5).mean(axis=1)
    assert replace(own, values=blocks).residuals(ramp)[1:] == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("seconds", [0.25, 10.0])
def test_a_run_with_kept_derivatives_is_the_sweep_at_the_same_point(seconds):
    crane = Crane.load("patu655").with_effect("sensor_lag@p1", {"tau": 0.05})
    data = FitData.of(recorded(crane.with_effect("internal_leakage@lift", {"k": 3e-12})), crane)
    variables = effect_variables("sensor_lag@p1", {"tau": 0.03}, crane.layout)
    u, windows = np.array([v.to_u(v.start) for v in variables]), cut(data, seconds)
    knots = first_knots(crane, data, seconds)
    linear, _ = linearised(crane, data, windows, knots, variables, u, 10.0)
    assert linear.cost > 2.0 * sum(linear.counts.values()), "a point that is far from the best"
    again = near(crane, data, windows, knots, variables, u, 10.0, linear)
    assert again is not None and again.cost == pytest.approx(linear.cost, rel=1e-6)
    for name in ("gx", "gu", "Hxx", "Huu"):
        there, here = getattr(linear, name), getattr(again, name)
        assert here == pytest.approx(there, rel=1e-5, abs=1e-6 * abs(there).max())


def test_derivatives_of_another_point_give_its_cost_and_lead_to_the_same_minimum():
    crane = Crane.load("patu655")
    data = FitData.of(recorded(crane.with_effect("internal_leakage@lift", {"k": 3e-12})), crane)
    variables = effect_variables("internal_leakage@lift", {"k": 1e-12}, crane.layout)
    windows, knots = cut(data, 0.25), first_knots(crane, data)
    there, _ = linearised(crane, data, windows, knots, variables, np.array([0.1]), 10.0)
    here, _ = linearised(crane, data, windows, knots, variables, np.array([0.3]), 10.0)
    kept = near(crane, data, windows, knots, variables, np.array([0.3]), 10.0, there)
    assert kept is not None and kept.cost == pytest.approx(here.cost, rel=1e-6)
    assert kept.gu == pytest.approx(here.gu, rel=0.1), "nearly the gradient, for a step that lowers the cost"
    fits = [fit(crane, data, windows, knots, variables, np.array([begin])) for begin in (0.0, 1.0)]
    with patch.object(linear, "_KEPT", 0):
        fits.append(fit(crane, data, windows, knots, variables, np.array([0.0])))
    assert fits[2].u == pytest.approx(fits[0].u, abs=0.1 * fits[0].std(variables[0].name)), "where they are too large"
    assert fits[2].cov == pytest.approx(fits[0].cov, rel=0.1)
    assert fits[0].u == pytest.approx(fits[1].u, abs=0.1 * fits[0].std(variables[0].name))
    assert not fits[0].linear.swept, "derivatives of windows are large, and kept only where that is asked for"


def test_inputs_in_another_order_in_memory_are_not_compiled_anew():
    crane = Crane.load("patu655")
    data = FitData.of(recorded(crane, seconds=0.6), crane)
    model = model_of(crane, data)
    x0 = np.repeat(first_knots(crane, data, 1.0), 2, axis=1)[0, ::2]
    usual = model.run(np.ascontiguousarray(x0), model.W, data.time, data.step)[0]
    compiled = len(kernel.simulate_each.signatures)
    assert model.run(x0, np.asfortranarray(model.W), data.time, data.step)[0] == pytest.approx(usual, nan_ok=True)
    assert len(kernel.simulate_each.signatures) == compiled


def test_a_window_swept_in_pieces_is_the_window_swept_at_once(monkeypatch):
    crane = Crane.load("patu655").with_effect("sensor_lag@p1", {"tau": 0.4})
    crane = crane.with_effect("payload_swing", {"length": 0.8, "damping": 3.0})
    data = FitData.of(recorded(crane), crane)
    data = replace(data, accuracy=ACCURATE)  # a piece begins with whole steps: what they are off by is small
    monkeypatch.setattr(sweeps, "ROUGHLY", ACCURATE / ACCURACY)  # along the derivatives as well
    nominal = uncertain_parameters(crane)
    own = [
        *effect_variables("sensor_lag@p1", {"tau": 0.3}, crane.layout),
        *effect_variables("sensor_bias@z1", {"b": 0.01}, crane.layout),
        *effect_variables("internal_leakage@lift", {"k": 1e-12}, crane.layout),
    ]
    variables, u = [*nominal, *own], np.array([0.0] * len(nominal) + [v.to_u(v.start) for v in own])
    base = model_at(crane, variables, u, data)
    (window,), columns = cut(data, 10.0), columns_of(crane, variables, u, base, data)
    x0 = first_knots(crane, data, 10.0)[0]
    x0 = np.pad(x0, (0, base.nx - len(x0)))
    group = Group((window,))
    numbers = len(x0) * (len(x0) + len(columns.size))
    (whole,), (pieces,) = (sweep(group, x0[None], base, columns, n * numbers) for n in (10**6, 333))
    assert pieces.counts == whole.counts
    assert pieces.squares == pytest.approx(whole.squares, rel=1e-6)
    assert pieces.end == pytest.approx(whole.end, rel=1e-6, abs=1e-7)
    for name in ("JJ", "Jr", "end_jacobian"):
        ours, theirs = getattr(pieces, name), getattr(whole, name)
        assert ours == pytest.approx(theirs, rel=1e-4, abs=1e-6 * np.abs(theirs).max()), name


def test_what_the_data_do_not_determine_has_a_huge_variance():
    a = np.array([1.0, 2.0, 0.0])
    cov = covariance(np.outer(a, a) + np.diag([0.0, 0.0, 4.0]))
    assert math.sqrt(cov[2, 2]) == pytest.approx(0.5)
    assert min(cov[0, 0], cov[1, 1]) > CRITERIA.undetermined**2
    assert a[:2] @ cov[:2, :2] @ a[:2] == pytest.approx(1.0, rel=1e-2)  # their sum is known all the same
    assert math.sqrt(covariance(np.diag([0.0, 1.0]))[0, 0]) > CRITERIA.undetermined


def test_windows_that_begin_within_a_run_begin_on_it(nominal):
    crane, data = nominal
    whole = fit(crane, data, cut(data, 10.0), first_knots(crane, data, 10.0), iterations=0)
    windows = cut(data, 0.5)
    knots = reknot(whole, windows)
    W = model_at(crane, (), np.zeros(0), data).W
    X = SemiRecursiveEngine(crane, accuracy=ACCURACY).simulate(whole.knots[0], data.time, W, step=data.step)
    assert knots == pytest.approx(X[[w.start for w in windows]], rel=1e-6, abs=1e-6)
    assert np.ptp(knots[:, 0]) > 1e-3


def test_the_moment_of_an_event_is_found_between_the_moments_that_are_tried():
    true = {"F": 3000.0, "T": 1.237}
    crane = Crane.load("patu655")
    recording = recorded(crane.with_effect("tip_contact_force", true), seconds=2.5)
    data = FitData.of(recording, crane)
    variables = effect_variables("tip_contact_force", {"F": 2000.0, "T": 1.1}, crane.layout)
    u = np.array([v.to_u(v.start) for v in variables])
    found = staged(crane, data, variables, u, first_knots(crane, data), (LOOSE, STIFF))
    acting = found.crane.effect("tip_contact_force")
    assert acting is not None
    assert acting.parameters["T"] == pytest.approx(true["T"], abs=5e-3)
    assert acting.parameters["F"] == pytest.approx(true["F"], rel=0.03)


def test_events_in_other_windows_are_swept_once(nominal, monkeypatch):
    """A load that changed before a window has always been there, one that changes after it has not changed."""
    crane, data = nominal
    windows = cut(data, 0.25)
    window, x0 = windows[8], first_knots(crane, data, 0.25)[8]
    begin, end = float(window.data.time[0]), float(window.data.time[-1])
    base = model_of(crane, data)
    moments = [0.0, 0.5 * begin, 0.5 * (begin + end), end + 0.1]
    models = [model_of(crane.with_effect("payload_change", {"dm": 5.0, "T": t}), data) for t in moments]
    columns, swept = pack(base, models, np.ones(len(models))), []
    compiled = sensitivity.sweep
    monkeypatch.setattr(sensitivity, "sweep", lambda *a, **k: swept.append(len(a[9])) or compiled(*a, **k))
    (found,) = sweep(Group((window,)), x0[None], base, columns)
    assert swept == [2], "before and within"
    W = columns.W[:, window.start : window.start + len(window.data.time)]
    true = compiled(
        x0[None], np.zeros(1), W, data.step, begin, base.P, base.E, columns.P, columns.E, columns.size,
        topology=base.topology, allowed=ROUGHLY * ACCURACY,
    ).S[-1]  # fmt: skip
    assert found.end_jacobian == pytest.approx(true, rel=1e-9, abs=1e-12)
    assert not found.end_jacobian[:, -1].any()


def test_what_no_slope_tells_is_answered_by_a_run_of_the_changed_machine(nominal):
    """Gas hundreds of times softer than oil, and a pendulum that the base lacks, beside a leak by its slope."""
    crane, data = nominal
    window = cut(data, 1.0)[2]
    begin, own = window.start, data.time[window.start : window.start + len(window.data.time)]
    changed = [
        crane.with_effect("released_air", {"alpha": 0.2, "ps": 20e5}),
        crane.with_effect("internal_leakage@lift", {"k": 1e-12}),
        crane.with_effect("payload_swing", {"length": 0.8, "damping": 5.0}),
    ]
    base, models = model_of(crane, data), [model_of(c, data) for c in changed]
    columns = pack(base, models, np.ones(3))
    assert columns.by_run.tolist() == [False, False, True]
    columns = replace(columns, by_run=np.array([True, False, True]))
    x0 = np.pad(first_knots(crane, data, 1.0)[2], (0, 2))
    (found,) = sweep(Group((window,)), x0[None], base, columns)
    jacobian = found.end_jacobian[:, len(x0) :]
    W = base.W[begin : begin + len(own)]
    roughly = [replace(m, accuracy=ROUGHLY * ACCURACY) for m in (base, *models)]
    ends = [m.run(x0, W, own, data.step)[0][-1] for m in roughly]
    units = np.array([1.0] * 4 + [1e6] * 4 + [1.0] * 2)
    for j in (0, 2):
        assert jacobian[:, j] / units == pytest.approx((ends[1 + j] - ends[0]) / units, rel=1e-6, abs=1e-9)
    scale = np.abs(ends[2] - ends[0]).max()
    assert np.abs(jacobian[:, 1] - (ends[2] - ends[0])).max() < 0.1 * scale
    assert np.abs(ends[1] - ends[0])[4:8].max() > 1e4 and np.abs(ends[3] - ends[0])[8] > 1e-4


@pytest.mark.parametrize(
    "effect, values",
    [
        ("entrained_air", {"alpha": 0.02}),
        ("released_air", {"alpha": 0.1, "ps": 3e5}),
        ("internal_leakage@lift", {"k": 3e-12}),
    ],
)
def test_derivatives_on_a_coarser_grid_are_those_on_the_datas_own(monkeypatch, effect, values):
    """The drop within a second boils the rod side; derivatives are off by some hundredths, the cost by nothing."""
    crane = Crane.load("patu655").with_effect(effect, values)
    data = FitData.of(recorded(crane, 3.0), crane)
    nominal, own = uncertain_parameters(crane), effect_variables(effect, values, crane.layout)
    variables, u = [*nominal, *own], np.array([0.0] * len(nominal) + [v.begin for v in own])
    windows, knots = cut(data, 0.25), first_knots(crane, data, 0.25)
    coarse, _ = linearised(crane, data.stepped(1e-3), windows, knots, variables, u, 100.0)
    monkeypatch.setattr(sweeps, "COARSE", 1e-3)
    fine, _ = linearised(crane, data.stepped(1e-3), windows, knots, variables, u, 100.0)
    assert coarse.cost == pytest.approx(fine.cost, rel=1e-9)
    scale = np.maximum(np.sqrt(np.diag(fine.Huu)), 1e-9)
    assert np.abs((coarse.Huu - fine.Huu) / np.outer(scale, scale)).max() < 0.05


@pytest.fixture(scope="module")
def stopped():
    """A recording of a tilt cylinder that runs into the stop at the end of its stroke, and the crane with the stop."""
    crane, time = Crane.load("patu655"), np.arange(0.0, 2.5, 5e-3)
    commands = np.column_stack([np.zeros(len(time)), np.interp(time, [0.0, 0.3, 0.5, 2.0, 2.2], [0, 0, 0.6, 0.6, 0])])
    true = crane.with_effect("end_stop@tilt", {"stiffness": 1.2e8, "damping": 1e5})
    return true, driven(true, time, commands, (0.2, -2.5))


def test_a_stop_is_screened_by_runs_and_found_back_though_windows_had_gone_through_it(stopped):
    true, recording = stopped
    crane = true.nominal()
    data = FitData.of(recording, crane)
    without = all_parameters(crane, data)
    offered = [s.start for s in likely(screened(without, LOOSE.stiffness), CRITERIA.singles, CRITERIA.promise)]
    begins = [s.values for s in offered if s.key == "end_stop@tilt"]
    assert [v["stiffness"] for v in begins] == [1e7, 1e8], "every stop, since a run through it tells of none which"
    variables = effect_variables("end_stop@tilt", begins[1], crane.layout)
    u = np.array([v.to_u(v.start) for v in variables])
    found = staged(crane, data, variables, u, without, (LOOSE,))
    assert found.error < 1.1
    for name, value in true.effect("end_stop@tilt").parameters.items():
        assert found.crane.effect("end_stop@tilt").parameters[name] == pytest.approx(value, rel=0.03)


def test_a_valve_with_a_setting_is_begun_at_all_of_them_where_the_screen_asks_for_more_than_it_can_be():
    """A valve has no size that could be scaled: five times one that throttles a little is none, and others of which
    the linear look promises nothing may be near.
    """
    crane = Crane.load("patu655")
    true = crane.with_effect("counterbalance_valve@lift", {"setting": 140e5, "ratio": 2.2})
    time = np.arange(0.0, 5.0, 5e-3)
    lift = np.interp(time, [0, 0.5, 0.7, 1.6, 1.8, 2.4, 2.6, 3.8, 4.0], [0, 0, 0.3, 0.3, 0, 0, -0.3, -0.3, 0])
    recording = driven(true, time, np.column_stack([lift, np.zeros(len(time))]), (0.3, -1.5))
    scores = screened(all_parameters(crane, FitData.of(recording, crane)), LOOSE.stiffness)
    assert scores[0].start.key == "counterbalance_valve@lift" and scores[0].amplitude > 2.0
    offered = [s.start for s in likely(scores, CRITERIA.singles, CRITERIA.promise)]
    begins = [s.values for s in offered if s.key == "counterbalance_valve@lift"]
    assert {v["setting"] for v in begins} == {60e5, 110e5, 160e5, 170e5, 240e5, 350e5}
    little = [replace(s, amplitude=0.5) for s in scores]
    offered = [s.start.key for s in likely(little, CRITERIA.singles, CRITERIA.promise)]
    assert offered.count("counterbalance_valve@lift") == 1, "from a valve that holds too much a fit finds back"


def test_parts_of_a_step_grow_again_after_a_stop_was_hit(stopped):
    """In the first quarter of a second on the stop steps are halved twelve times, but only where it begins to act."""
    crane, recording = stopped
    data = FitData.of(recording, crane)
    window, knot = cut(data, 0.25)[4], first_knots(crane, data, 0.25)[4]
    model = model_of(crane, data)
    W = model.W[window.start : window.start + len(window.data.time)]
    machine = (model.P, model.E, model.topology)
    _, status, _, halved = kernel.simulate(knot, W, window.data.time, data.step, *machine, ACCURACY, 1.0)
    assert (status, halved > 10) == (kernel.OK, True), "no more than 1100 parts; it took twenty times as many"


def test_voids_are_taken_over_from_window_to_window():
    """A boom that sinks faster than its compensated valve fills the rod side leaves a void there for two seconds."""
    crane = Crane.load("patu655").with_effect("pressure_compensation@lift", {"dpc": 8e5})
    time = np.arange(0.0, 6.0, 5e-3)
    lift = np.interp(time, [0, 0.5, 0.6, 2.0, 2.1, 2.5, 2.6], [0, 0, -0.2, -0.2, 0, 0, 0.3])
    recording = driven(crane, time, np.column_stack([lift, 0.0 * time]), (0.5, -0.8))
    data = FitData.of(recording, crane)
    windows, knots = cut(data, 0.25), first_knots(crane, data, 0.25)
    engine, model = SemiRecursiveEngine(crane), model_of(crane, data)
    X = engine.simulate(engine.static_start(0.5, -0.8), data.time, model.W)
    true = X[[w.start for w in windows], 5]
    void = true < -20e5
    assert void.sum() > 6 and knots[void, 5].min() >= 0.0, "of the sensor that shows nothing, a guess makes no void"
    begun = begun_anew(crane, data, windows, knots, (), np.empty(0), 1.0)
    assert begun[void, 5] == pytest.approx(true[void], rel=0.1)
    other = effect_variables("pressure_compensation@lift", {"dpc": 10e5}, crane.layout)
    found = staged(crane, data, other, np.array([v.begin for v in other]), knots)
    assert found.error < 1.05
    assert found.crane.effect("pressure_compensation@lift").parameters["dpc"] == pytest.approx(8e5, rel=0.01)


def test_whole_runs_do_not_add_up_what_short_windows_may_be_off_by():
    """A load-holding valve swings as the arm comes down; within a step's error of a window it is noise units off."""
    crane = Crane.load("patu655").with_effect("counterbalance_valve@tilt", {"setting": 2.14e7, "ratio": 2.03})
    time = np.arange(0.0, 10.0, 5e-3)
    corners = [0, 1, 1.2, 3, 3.2, 6, 6.2, 7.5, 7.7], [0, 0.5, 0.7, 3, 3.2, 5, 5.2, 8]
    commands = [[0, 0, 0.2, 0.2, 0, 0, -0.2, -0.2, 0], [0, 0, 0.3, 0.3, 0, 0, -0.3, -0.3]]
    u = np.column_stack([np.interp(time, t, c) for t, c in zip(corners, commands, strict=True)])
    recording = driven(crane, time, u, (0.5, -0.8))
    start = SemiRecursiveEngine(crane).static_start(0.5, -0.8)
    loose = rms(residuals(crane, FitData.of(recording, crane), start))
    assert loose > 1.5 > 1.05 > rms(residuals(crane, FitData.whole(recording, crane), start))
    assert run_fitted(crane, FitData.of(recording, crane)).error < 1.05


def _slowed(recording: Recording, every: int, keep: slice = slice(None), only: str = "") -> Recording:
    """Return a recording with every so many samples of its sensors, and of one of them only a part."""
    channels = {}
    for name, c in recording.channels.items():
        rows = np.arange(len(c.time))[:: every if name in recording.sensors else 1]
        rows = rows[keep] if name == only else rows
        channels[name] = replace(c, time=c.time[rows], values=c.values[rows])
    return replace(recording, channels=channels)


def test_no_window_is_shorter_than_from_one_sample_to_the_next():
    crane = Crane.load("patu655")
    data = FitData.of(_slowed(recorded(crane), 80), replace(crane, sensors=NOISE))  # 2.5 Hz
    for seconds in (LOOSE.seconds, STIFF.seconds):
        windows = cut(data, seconds)
        assert min(len(w.data.time) for w in windows) > 1
        assert windows[0].data.time[0] == data.time[0] and windows[-1].data.time[-1] == data.time[-1]


def test_a_sensor_that_comes_late_tells_nothing_before():
    crane = replace(Crane.load("patu655"), sensors=NOISE)
    late = FitData.of(_slowed(recorded(crane), 1, slice(1000, None), "p2"), crane)
    early = late.part(0, round(4.0 / late.step))
    assert next(len(s.values) for s in early.samples if s.channel == "p2") == 0
    found = staged(crane, early, (), np.zeros(0), first_knots(crane, early), (LOOSE,))
    assert np.isfinite(found.knots).all() and found.error < 1.1
    assert levels_of(found, early).of["p2"] == 1.0


def test_a_sensor_that_shows_one_value_throughout_is_left_out():
    crane, recording = Crane.load("patu655"), recorded(Crane.load("patu655"))
    still = replace(recording.channels["z4"], values=np.full(len(recording["z4"]), -0.8))
    data = FitData.of(replace(recording, channels={**recording.channels, "z4": still}), crane)
    assert data.channels == ("z1", "p1", "p2", "p3", "p4")


def test_no_mean_of_several_samples_spans_a_gap():
    crane = replace(Crane.load("patu655"), sensors=NOISE)
    fast = recorded(crane, rate=1000.0)
    rows = np.concatenate([np.arange(2003), np.arange(3501, 6000)])
    channels = {n: replace(c, time=c.time[rows], values=c.values[rows]) if n in fast.sensors else c
                for n, c in fast.channels.items()}  # fmt: skip
    data = FitData.of(replace(fast, channels=channels), crane)
    around = next(s.around for s in data.samples if s.channel == "p1")
    assert around is not None and np.abs(around * data.step).max() < 3e-3


def test_a_parameter_that_differs_by_recording_is_the_recordings_own_if_it_is_the_only_one():
    crane = Crane.load("patu655")
    assert data_of([recorded(crane)], crane, ("payload.mass",)).own == ("payload.mass",)


def test_a_fit_begins_where_a_fitted_crane_has_its_parameters_whatever_that_fit_began_at():
    crane = replace(Crane.load("patu655"), sensors=NOISE)
    data = FitData.of(recorded(crane, 3.0), crane)
    moved = crane.with_parameters({"payload.mass": 60.0})
    nothing = staged(moved, data, (), np.zeros(0), first_knots(moved, data), (LOOSE,))  # began at the moved crane
    mass = next(v for v in uncertain_parameters(crane) if v.name == "payload.mass")
    u = np.array([moved_to(mass, crane, nothing.crane, nothing)])
    assert with_variables(crane, [mass], u)["payload.mass"] == pytest.approx(60.0)
    assert moved_to(mass, crane, crane, nothing) == 0.0


@pytest.mark.parametrize("held", [False, True])
def test_a_search_finds_out_whether_commands_keep_their_value_until_the_next_sample(held):
    crane = replace(Crane.load("patu655"), sensors=NOISE)
    time, fine = np.arange(0.0, 5.0, 0.02), np.arange(0.0, 4.98, 2e-3)
    ramps = np.column_stack([0.3 * np.sin(1.6 * time), 0.25 * np.sin(2.1 * time)])
    ramps[(time < 0.5) | (time > 4.0)] = 0.0  # a clock that is late makes no jump late
    t, u = with_steps(time, ramps, held)
    acting = np.column_stack([np.interp(fine, t, column) for column in u.T])
    driven_at = driven(crane, fine, acting, (0.2, -0.8))
    commands = {n: Channel(time, c, "") for n, c in zip(("u1", "u2"), ramps.T, strict=True)}
    recording = replace(driven_at, channels={**driven_at.channels, **commands})
    problem = Problem.of(crane, [recording], (), jobs=1)
    given = fitted(crane, problem.data, Model(tuple(timings(problem.data))), problem.nominal, (STIFF,))
    found = otherwise(problem, given)
    assert (found is not None and found.problem.recordings[0].held) == held
    assert not held or alike(found.problem, found.found, recording).held


def test_a_search_finds_out_when_commands_stepped_between_two_samples():
    crane = replace(Crane.load("patu655"), sensors=NOISE)
    time, fine = np.arange(0.0, 5.0, 0.02), np.arange(0.0, 4.98, 2e-3)
    corners = [[(0.613, 0.4), (1.508, 0.0), (2.931, -0.3), (3.702, 0.0)], [(1.117, -0.3), (1.907, 0.0)]]

    def stepping(grid):
        steps = [(np.array([t for t, _ in own]), np.array([0.0, *(u for _, u in own)])) for own in corners]
        return np.column_stack([values[np.searchsorted(at, grid, side="right")] for at, values in steps])

    driven_at = driven(crane, fine, stepping(fine), (0.2, -0.8))
    commands = {n: Channel(time, c, "") for n, c in zip(("u1", "u2"), stepping(time).T, strict=True)}
    recording = replace(driven_at, channels={**driven_at.channels, **commands})
    problem = Problem.of(crane, [recording], (), jobs=1)
    given = fitted(crane, problem.data, Model(tuple(timings(problem.data))), problem.nominal, (STIFF,))
    found = otherwise(problem, given)
    assert found is not None and "step between two samples" in found.notes[0] and found.found.level < given.level
    early = found.problem.recordings[0].early
    moments = sorted((shown - s, valve) for (shown, valve), s in early.items())
    true = sorted((t, valve) for valve, own in enumerate(corners) for t, _ in own)
    assert moments == [(pytest.approx(t, abs=3e-3), valve) for t, valve in true]
    # the models of a search are fitted again with them
    path = WHITE.begun(problem)
    again = taken_otherwise(path, found.problem)
    assert again.given.level < path.given.level and again.parameters.level < path.parameters.level
    assert again.given.level == pytest.approx(found.found.level, rel=1e-3)
    # those of another recording are fitted to it with the crane that was found
    check = alike(found.problem, found.found, recording)
    moments = sorted((shown - s, valve) for (shown, valve), s in check.early.items())
    assert moments == [(pytest.approx(t, abs=3e-3), valve) for t, valve in true]
    held = replace(found.problem, recordings=(replace(found.problem.recordings[0], held=True),))
    check = alike(held, found.found, recording)
    assert check.held and not check.early  # every change is a step there
