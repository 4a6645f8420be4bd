"""`patu compare`: phases of work, residual balances against known ones, errors, findings, refusals, and what users
get.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.signal import lfilter

from crane_exudyn.crane import Crane
from crane_exudyn.display import rounded
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.exudyn_quietly import items
from crane_exudyn.geometry import pose
from crane_exudyn.recording import Recording
from crane_exudyn.signals import noise_std
from crane_exudyn.simulation import Simulation, simulate
from validation import balances, phases
from validation.balances import Balances, Steps, spread_of
from validation.comparison import Comparison, compare
from validation.findings import scores_of, violation
from validation.fit.data import FitData, usable
from validation.fitness import check_recording, examine, noise_at_rest
from validation.improvement import Judge
from validation.phases import phases_of
from validation.semi_recursive import SemiRecursiveEngine

NOISE = {"z1": np.radians(0.05), "z4": np.radians(0.05), "p1": 0.3e5, "p2": 0.3e5, "p3": 0.3e5, "p4": 0.3e5}
TIME = np.arange(0.0, 8.0001, 0.005)
CRANE = Crane.load("patu655")


def ramps(time: np.ndarray, *pieces: tuple[float, float, float]) -> np.ndarray:
    """Return a command with ramps of 0.1 s: pieces (from, to, size)."""
    return sum((size * np.clip(np.minimum(time - a, b - time) / 0.1, 0.0, 1.0) for a, b, size in pieces), 0.0 * time)


def driven(crane: Crane, time: np.ndarray = TIME) -> Simulation:
    """A manoeuvre of 8 s with every kind of motion, on the semi-recursive engine."""
    u1 = ramps(time, (0.8, 2.4, 0.3), (6.0, 7.2, -0.2))
    u2 = ramps(time, (1.8, 3.4, 0.25), (3.4, 5.2, -0.25))
    engine = SemiRecursiveEngine(crane)
    start = engine.static_start(np.radians(12.0), np.radians(-50.0))
    inputs = Recording.from_arrays("manoeuvre", time, {"u1": u1, "u2": u2})
    return simulate(crane, inputs, start=start, engine=engine, step=2.5e-3)


def measured(run: Simulation, seed: int, sensors: dict[str, float] = NOISE) -> Recording:
    """What noisy sensors show of a run."""
    rng = np.random.default_rng(seed)
    shown = {"u1": run["u1"], "u2": run["u2"]}
    shown |= {name: run[name] + std * rng.standard_normal(len(run.time)) for name, std in sensors.items()}
    return Recording.from_arrays("test", run.time, shown)


@pytest.fixture(scope="module")
def clean() -> Comparison:
    return compare(CRANE, measured(driven(CRANE), seed=11))


def test_balances_that_have_not_settled_are_said(clean, monkeypatch):
    assert clean.balances.unsettled == () and clean.notes == ()
    monkeypatch.setattr(balances, "_ROUNDS", 1)
    leaking = CRANE.with_effect("internal_leakage@lift", {"k": 1e-11})
    comparison = compare(CRANE, measured(driven(leaking, TIME[:600]), seed=12))
    assert comparison.balances.unsettled
    assert "had not converged" in comparison.notes[-1]


def test_balances_that_have_not_settled_accuse_nobody_where_every_channel_is_predicted(clean, leaking):
    for comparison, accuses in ((clean, False), (leaking[1], True)):
        edges = float(comparison.balances.time[0]), float(comparison.balances.time[-1])
        moving = replace(comparison.balances, unsettled=(edges,))
        scores = scores_of(comparison.estimate, moving, comparison.phases)
        assert scores.badly_predicted.any() == accuses
        assert np.isfinite(scores.stds).any() == accuses
        assert any(f.kind == "equation" for f in scores.findings()) == accuses


def test_a_chamber_at_the_pressure_floor_takes_any_flow(clean):
    states = clean.balances.states.copy()
    states[100:120, 5] = clean.balances.floor  # the lift's rod side boils for a tenth of a second
    boiling = replace(clean.balances, states=states)
    phase = next(i for i, p in enumerate(clean.phases) if p.first <= 100 < p.last)
    scores = scores_of(clean.estimate, boiling, clean.phases)
    assert np.isinf(scores.stds[phase, CRANE.layout.equations.index("flow.p2")]) and np.isfinite(scores.stds[phase, 0])
    assert all(np.isfinite(std[0]) for _, _, std in scores.by_kind())


LEAK = 4e-12


@pytest.fixture(scope="module")
def leaking() -> tuple[Simulation, Comparison]:
    run = driven(CRANE.with_effect("internal_leakage@lift", {"k": LEAK}))
    return run, compare(CRANE, measured(run, seed=12))


# -- phases of work --------------------------------------------------------------------------------------------------


def kinds_of(spool: np.ndarray, states: np.ndarray | None = None) -> list[tuple[str, float, float]]:
    time = 0.01 * np.arange(len(spool))
    if states is None:
        states = np.tile(SemiRecursiveEngine(CRANE).static_start(0.2, -0.8), (len(spool), 1))
    return [(p.kind, round(p.start, 2), round(p.end, 2)) for p in phases_of(CRANE, time, spool, states)]


def pieces(*parts: tuple[int, float, float]) -> np.ndarray:
    """Spool positions: (samples, lift, tilt) one after the other."""
    return np.concatenate([np.tile([lift, tilt], (n, 1)) for n, lift, tilt in parts])


def test_phases_name_every_motion_of_every_cylinder() -> None:
    spool = pieces(
        (100, 0, 0), (100, 0.3, 0), (100, 0, 0), (100, -0.3, 0), (50, 0, 0), (100, 0, 0.2), (50, 0, 0), (100, 0, -0.2)
    )
    assert kinds_of(spool) == [
        ("rest", 0.0, 1.0), ("lift extending", 1.0, 2.0), ("rest", 2.0, 3.0), ("lift retracting", 3.0, 4.0),
        ("rest", 4.0, 4.5),
        ("tilt extending", 4.5, 5.5), ("rest", 5.5, 6.0), ("tilt retracting", 6.0, 6.99),
    ]  # fmt: skip


def test_both_cylinders_are_one_phase_until_one_turns() -> None:
    spool = pieces((100, 0.3, 0.2), (100, 0.3, -0.2))
    found = phases_of(
        CRANE, 0.01 * np.arange(200), spool, np.tile(SemiRecursiveEngine(CRANE).static_start(0.2, -0.8), (200, 1))
    )
    assert [p.kind for p in found] == ["both moving", "reversal", "both moving"]
    assert found[0].words == "between 0.0 and 1.0 s, while both cylinders extend"
    assert found[2].words.endswith("while the lift cylinder extends and the tilt cylinder retracts")


def test_a_reversal_needs_a_quick_change_of_sides() -> None:
    quick, slow = pieces((100, 0.3, 0), (20, 0, 0), (100, -0.3, 0)), pieces((100, 0.3, 0), (60, 0, 0), (100, -0.3, 0))
    assert ("reversal", 0.99, 1.5) in kinds_of(quick)
    assert [k for k, _, _ in kinds_of(slow)] == ["lift extending", "rest", "lift retracting"]


def test_low_pressure_and_end_of_stroke_come_before_plain_motion() -> None:
    spool = pieces((300, 0.3, 0))
    states = np.tile(SemiRecursiveEngine(CRANE).static_start(0.2, -0.8), (300, 1))
    states[100:150, 5] = 0.4e5  # the tank has 1 bar
    states[200:, 0] = np.radians(90.0)  # s1 = 1.351 m of 1.355 m
    assert [k for k, _, _ in kinds_of(spool, states)] == [
        "lift extending",
        "low pressure",
        "lift extending",
        "end of stroke",
    ]


def test_short_motions_are_not_lost_in_rest_and_long_phases_are_cut() -> None:
    spool = pieces((700, 0, 0), (8, 0, -0.3), (100, 0.3, -0.3))
    found = kinds_of(spool)
    assert [k for k, _, _ in found] == ["rest", "rest", "rest", "both moving"]
    assert found[-1][1] == 7.0
    assert all(end - start <= phases.LONGEST for _, start, end in found)


# -- balances --------------------------------------------------------------------------------------------------------


def random_steps(rng: np.random.Generator, K: int = 7, nx: int = 3, m: int = 2) -> Steps:
    A = np.eye(nx) + 0.2 * rng.standard_normal((K - 1, nx, nx))
    residual = rng.standard_normal((K, m))
    residual[2, 0] = residual[4] = np.nan
    return Steps(
        states=np.zeros((K, nx)), inputs=0.3 * rng.standard_normal((K, 6)), A=A, B=rng.standard_normal((K - 1, nx, 6)),
        jump=0.1 * rng.standard_normal((K - 1, nx)), C=rng.standard_normal((K, m, nx)), residual=residual,
        spread=rng.uniform(0.5, 1.0, (K, m)), forget=0.8,
    )  # fmt: skip


def dense(steps: Steps) -> tuple[np.ndarray, np.ndarray]:
    """Return mean (K n,) and covariance of all deviations at once, by conditioning one large normal distribution."""
    (K, nx), n = steps.states.shape, steps.states.shape[1] + 6
    F, constant, Q = balances.augmented(steps)
    L, drift = np.eye(K * n), np.zeros(K * n)  # x = L (start and noises) + drift
    first = np.concatenate([np.zeros(nx), -steps.inputs[0]])
    drift[:n] = first
    for k in range(1, K):
        rows, before = slice(k * n, k * n + n), slice(k * n - n, k * n)
        L[rows] = F[k - 1] @ L[before]
        L[rows, rows] = np.eye(n)
        drift[rows] = F[k - 1] @ drift[before] + constant[k - 1]
    start = np.diag(np.r_[np.full(nx, balances.START_STD**2), np.ones(6)])
    P = (
        L
        @ np.block([[start if i == j == 0 else Q if i == j else np.zeros((n, n)) for j in range(K)] for i in range(K)])
        @ L.T
    )
    seen = [(k, j) for k, j in np.argwhere(np.isfinite(steps.residual))]
    H = np.zeros((len(seen), K * n))
    for i, (k, j) in enumerate(seen):
        H[i, k * n : k * n + nx] = steps.C[k, j]
    R = np.diag([steps.spread[k, j] ** 2 for k, j in seen])
    y = np.array([steps.residual[k, j] for k, j in seen])
    gain = P @ H.T @ np.linalg.inv(H @ P @ H.T + R)
    return drift + gain @ (y - H @ drift), P - gain @ H @ P


def test_smoother_and_mean_over_a_phase_equal_the_dense_normal_distribution() -> None:
    steps = random_steps(np.random.default_rng(3))
    smoothed = balances.smooth(steps)
    mean, covariance = dense(steps)
    K, n = smoothed.mean.shape
    assert smoothed.mean == pytest.approx(mean.reshape(K, n), abs=1e-8)
    blocks = np.array([covariance[k * n : k * n + n, k * n : k * n + n] for k in range(K)])
    assert smoothed.covariance == pytest.approx(blocks, abs=1e-8)
    spread = spread_of(CRANE.layout)
    values = (steps.inputs + smoothed.mean[:, -6:]) * spread
    found = Balances(
        np.arange(K), steps.states, CRANE.layout, values, values, 0.0, smoothed.covariance[:, :, -6:], smoothed.gains
    )
    got, std = found.mean(2, 6)
    pick = np.zeros((6, K * n))
    for k in range(2, 6):
        pick[:, k * n + n - 6 : k * n + n] = np.eye(6) / 4
    assert std / spread == pytest.approx(np.sqrt(np.diag(pick @ covariance @ pick.T)), rel=1e-8)
    assert got == pytest.approx(values[2:6].mean(axis=0))


def test_balances_of_a_right_model_are_zero_within_their_uncertainty(clean: Comparison) -> None:
    z = clean.scores.equations
    assert np.abs(z).max() < 4.5  # 6 equations x about 12 phases
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.3
    assert (clean.scores.stds[:, 2:] > 0).all()


def test_a_leak_shows_as_the_flow_that_it_is(leaking: tuple[Simulation, Comparison]) -> None:
    run, found = leaking
    pa, pb = (np.interp(found.balances.time, run.time, run[p]) for p in ("p1", "p2"))
    for i, phase in enumerate(found.phases):
        flow = LEAK * np.mean((pa - pb)[phase.first : phase.last])
        truth = np.array([0.0, 0.0, -flow, flow, 0.0, 0.0])
        off = (found.scores.means[i] - truth) / found.scores.stds[i]
        assert np.abs(off).max() < 5.0, (phase, off)
    assert {f.name for f in found.where if f.kind == "equation"} == {"flow.p1", "flow.p2"}


def test_a_moment_shows_at_its_joint_against_the_motion() -> None:
    friction = 600.0
    run = driven(CRANE.with_effect("joint_coulomb_friction@O", {"T": friction}))
    found = compare(CRANE, measured(run, seed=13))
    first = next(f for f in found.where if f.kind == "equation")
    assert first.name == "torque.O" and first.text.endswith("against its motion")
    moment = np.interp(found.balances.time, run.time, -friction * np.tanh(run["dz1"] / 2e-3))
    for i, phase in enumerate(found.phases):
        truth = moment[phase.first : phase.last].mean()
        assert found.scores.means[i, 0] == pytest.approx(truth, abs=5.0 * found.scores.stds[i, 0] + 0.02 * friction)
    assert "flow.p3" not in {f.name for f in found.where}


def test_what_the_sensors_cannot_tell_apart_is_uncertain(clean: Comparison) -> None:
    few = {name: NOISE[name] for name in ("z1", "z4", "p1", "p4")}
    found = compare(CRANE, measured(driven(CRANE), seed=11, sensors=few))
    assert (found.scores.stds[:, :2] > 3.0 * clean.scores.stds[:, :2]).all()
    assert not [f for f in found.where if f.kind == "equation"]


# -- errors ----------------------------------------------------------------------------------------------------------


def test_a_right_model_leaves_nothing_but_noise(clean: Comparison) -> None:
    assert 0.95 < clean.error < 1.06  # 9600 samples: ± 4 standard errors are ± 0.03, and the start takes a little
    for name, error in clean.channels.items():
        si = {"deg": np.radians(1.0), "bar": 1e5}[error.unit]
        assert error.noise_std * si == pytest.approx(NOISE[name], rel=0.12)
        assert error.rmse / error.noise_std == pytest.approx(error.error_over_noise)
    assert clean.where == []
    assert clean.consistent


def test_a_simulation_without_noise_and_with_channels_that_follow_from_each_other_is_explained() -> None:
    run = driven(CRANE, np.arange(0.0, 3.0, 0.002)).recording()
    assert set(run.noise_free()) == set(run.sensors) and len(run.sensors) == 12
    result = compare(CRANE, run)
    assert result.error == pytest.approx(1.0, abs=0.05) and result.consistent and not result.where
    assert any("show no noise" in note for note in result.notes)
    stated = replace(CRANE, sensors={"z1": 1e-12, "p1": 1e4})
    assert np.isfinite(compare(stated, run.select(["u1", "u2", "z1", "z4", "z4_abs", "p1"])).error)


def test_errors_are_those_of_the_numbers(leaking: tuple[Simulation, Comparison]) -> None:
    _, found = leaking
    for name, error in found.channels.items():
        si = {"deg": np.radians(1.0), "bar": 1e5}[error.unit]
        y, model = found.measured[name][1] / si, found.simulated[name][1] / si
        assert error.rmse == pytest.approx(np.sqrt(np.mean((y - model) ** 2)))
        assert error.pn_rmse == pytest.approx(100 * error.rmse / np.ptp(y))
        assert error.bias == pytest.approx(np.mean(y - model))
        assert error.r2 == pytest.approx(1 - np.var(y - model) / np.var(y) - error.bias**2 / np.var(y))
    assert found.error > 5.0 and not found.consistent


def test_where_is_sorted_and_tells_place_time_and_work(leaking: tuple[Simulation, Comparison]) -> None:
    _, found = leaking
    scores = [f.score for f in found.where]
    assert scores == sorted(scores, reverse=True) and len(scores) > 3
    for f in found.where:
        assert TIME[0] <= f.start < f.end <= TIME[-1] and f.phase in phases.kinds(CRANE.layout)
        assert f.name in (CRANE.layout.equations if f.kind == "equation" else NOISE)
        assert f"between {f.start:.1f} and {f.end:.1f} s" in f.text


def test_both_engines_say_the_same(leaking: tuple[Simulation, Comparison]) -> None:
    run, _ = leaking
    short = measured(run, seed=12).window(0.0, 3.0)
    one, other = compare(CRANE, short), compare(CRANE, short, engine="exudyn")
    for name in NOISE:
        assert other.channels[name].rmse == pytest.approx(one.channels[name].rmse, rel=0.02, abs=1e-3)
    assert other.estimate.nis_mean == pytest.approx(one.estimate.nis_mean, rel=0.02)
    assert other.where[0].name == one.where[0].name


def test_an_improvement_tells_the_numbers_of_a_comparison() -> None:
    run = driven(CRANE.with_effect("internal_leakage@lift", {"k": LEAK}), TIME[:600])
    full = measured(run, seed=13)
    coarse = replace(full["z4"], time=full["z4"].time[::2], values=full["z4"].values[::2])
    recording = replace(full, channels={**full.channels, "z4": coarse})
    found = compare(CRANE, recording)
    told = Judge((recording,), None, (), CRANE.sensors, jobs=1, level=1.04).step(None, CRANE, "unknown")
    assert found.error == pytest.approx(told.search_error, rel=0.01)
    assert told.error == pytest.approx(told.search_error, rel=0.01)
    assert told.nis_mean == pytest.approx(found.estimate.nis_mean, rel=0.01)
    assert np.isnan(told.check_error)


def test_json_is_the_contract(leaking: tuple[Simulation, Comparison]) -> None:
    document = json.loads(json.dumps(leaking[1].to_dict()))
    assert set(document) == {"recording", "crane", "channels", "filter", "where"}
    for channel in document["channels"].values():
        assert set(channel) == {"unit", "rmse", "pn_rmse", "noise_std", "error_over_noise", "bias", "r2"}
    assert set(document["filter"]) == {"nis_mean", "nis_bounds", "whiteness", "consistent"}
    for place in document["where"]:
        assert set(place) - {"channel", "equation"} == {"from", "to", "phase", "score", "text"}
        assert len(set(place) & {"channel", "equation"}) == 1


def test_words_for_engineers() -> None:
    assert (
        violation("flow.p3", -2.1e-3 / 60, 0.153e-3 / 60, CRANE.layout)
        == "chamber p3 (tilt, piston side) receives 2.1 ± 0.3 l/min less than the model predicts"
    )
    assert violation("torque.O", 310.0, 10.2, CRANE.layout, rate=-0.1).endswith(
        "upwards with 310 ± 20 N m more than the model predicts, against its motion"
    )
    assert (
        rounded(2.14, 0.31) == "2.1 ± 0.3"
        and rounded(2.14, 0.123) == "2.14 ± 0.12"
        and rounded(1234.0, 45.0) == "1230 ± 40"
    )


def test_comparison_shows_itself(leaking: tuple[Simulation, Comparison]) -> None:
    _, found = leaking
    assert "NOT consistent" in repr(found)
    assert "Where the model fails" in found._repr_html_() and "error / noise" in found._repr_html_()
    assert found.plot().axes
    assert set(found.figures()) == {"where", "open_loop", "balances", "balances_by_work"}


# -- refusals --------------------------------------------------------------------------------------------------------


def recording_of(**changes: np.ndarray | None) -> Recording:
    rng = np.random.default_rng(1)
    time = np.arange(0.0, 4.0, 0.01)
    values: dict[str, np.ndarray] = {
        "u1": ramps(time, (1.0, 3.0, 0.3)), "u2": 0.0 * time,
        "z1": 0.2 + 0.05 * np.clip(time - 1.0, 0.0, 2.0) + 1e-3 * rng.standard_normal(len(time)),
        "p1": 50e5 + 3e4 * rng.standard_normal(len(time)),
    }  # fmt: skip
    kept = {k: v for k, v in {**values, **changes}.items() if v is not None}
    return Recording.from_arrays("odd", time, kept)


def constant(value: float) -> np.ndarray:
    return np.full(400, value)


def clipped() -> np.ndarray:
    values = np.asarray(recording_of()["p1"].values) + 20e5 * np.sin(np.arange(400) / 30)
    return np.minimum(values, 45e5)


@pytest.mark.parametrize(
    ("recording", "words"),
    [
        (recording_of(u2=None), "u2 missing"),
        (recording_of(z1=None, p1=None), "found 0 sensor channels"),
        (recording_of().window(0.0, 0.8), "at least 1 s is needed"),
        (recording_of(z1=constant(0.2), p1=constant(5e6)), "every sensor"),
        (recording_of(p1=clipped()), "sensor p1 is exactly at its largest value"),
        (recording_of(z1=constant(0.2)), "saturated, frozen or not connected"),
    ],
)
def test_recordings_that_cannot_be_compared_are_refused(recording: Recording, words: str) -> None:
    with pytest.raises(CraneError, match=words):
        check_recording(recording, CRANE)
    with pytest.raises(CraneError, match=words):
        compare(CRANE, recording)


def test_a_chamber_that_boils_most_of_the_time_is_not_cut_off() -> None:
    void = np.where(np.arange(400) > 120, CRANE["fluid.vapour_pressure"], 8e5 + 3e4 * np.sin(np.arange(400)))
    assert not [f for f in examine(recording_of(p2=void), CRANE) if f.kind == "saturation"]
    assert [f for f in examine(recording_of(p2=void + 5e5), CRANE) if f.kind == "saturation"]


def test_diagnosis_asks_for_more() -> None:
    still = recording_of(u1=constant(0.0), z1=0.2 + 1e-3 * np.random.default_rng(2).standard_normal(400))
    assert any("does not move" in note for note in check_recording(still, CRANE))
    with pytest.raises(CraneError, match="nothing moves"):
        check_recording(still, CRANE, purpose="diagnose")
    with pytest.raises(CraneError, match="at least 2"):
        check_recording(recording_of(p1=None), CRANE, purpose="diagnose")
    assert check_recording(recording_of(), CRANE, purpose="diagnose")


def test_a_dead_channel_of_a_closed_valve_is_left_out_and_told() -> None:
    recording = recording_of(p4=constant(4e6))
    assert any("p4 has a constant value" in note for note in check_recording(recording, CRANE))
    assert usable(recording).sensors == ("z1", "p1")


def test_a_channel_of_one_value_whose_noise_the_crane_states_is_used_and_not_said_to_be_left_out() -> None:
    recording, stated = recording_of(p4=constant(4e6)), replace(CRANE, sensors={"p4": 0.3e5})
    assert not any("p4 has a constant value" in note for note in check_recording(recording, stated))
    assert not any("p4 has a constant value" in f.text for f in examine(recording, stated))
    assert "p4" in FitData.of(recording, stated).channels


def test_unknown_engine_is_refused() -> None:
    with pytest.raises(CraneError, match=r"There is no engine .abacus."):
        compare(CRANE, recording_of(), engine="abacus")  # type: ignore[arg-type]


# -- the command -----------------------------------------------------------------------------------------------------


def test_command_prints_writes_and_reports(
    patu: Callable[..., SimpleNamespace], leaking: tuple[Simulation, Comparison], tmp_path: Path
) -> None:
    file = tmp_path / "leak.csv"
    measured(leaking[0], seed=12).window(0.0, 4.0).save(file)
    done = patu(
        "compare",
        str(file),
        "-o",
        str(tmp_path / "out"),
        "--report",
        str(tmp_path / "report"),
        "--json",
        str(tmp_path / "c.json"),
    )
    assert done.status == 0, done.err
    assert "receives" in done.out and "NOT consistent" in done.out
    assert sorted(p.name for p in (tmp_path / "out").iterdir()) == [
        "balances.png", "balances_by_work.png", "open_loop.png", "where.png",
    ]  # fmt: skip
    assert "Where the model fails" in (tmp_path / "report" / "report.html").read_text()
    assert json.loads((tmp_path / "c.json").read_text())["where"]


def test_what_was_fitted_to_each_recording_is_told(patu: Callable[..., SimpleNamespace], tmp_path: Path) -> None:
    files = []
    for name, mass in (("light", 10.0), ("heavy", 140.0)):
        run = driven(CRANE.with_parameters({"payload.mass": mass}), TIME[:500])
        files.append(str(tmp_path / f"{name}.csv"))
        measured(run, seed=5).save(files[-1])
    more = ("--per-recording", "payload.mass", "--report", str(tmp_path / "r"), "--json", str(tmp_path / "c.json"))
    done = patu("compare", *files, *more)
    assert done.status == 0, done.err
    found = json.loads((tmp_path / "c.json").read_text())["recordings"]
    page = (tmp_path / "r" / "report.html").read_text()
    for entry, mass in zip(found, (10.0, 140.0), strict=True):
        own = entry["parameters"]["payload.mass"]
        assert own["value"] == pytest.approx(mass, abs=3.0) and (own["nominal"], own["unit"]) == (25.0, "kg")
        told = f"payload.mass = {own['value']:.4g} kg, fitted (file: 25 kg)"
        assert told in done.out and told in page
    assert "<h2>By recording</h2>" in page


def test_a_model_that_fails_is_not_taken_for_clocks_that_differ(leaking: tuple[Simulation, Comparison]) -> None:
    assert not [note for note in leaking[1].notes if "stamps" in note]
    recording = measured(driven(CRANE, TIME[:600]), seed=11)
    late = {n: replace(recording[n], time=recording[n].time - 2.5e-3) for n in ("u1", "u2")}
    found = compare(CRANE, replace(recording, channels={**recording.channels, **late}))
    assert found.error < 1.05
    (note,) = (note for note in found.notes if "stamps" in note)
    assert re.search(r"assumed to act 2\.\d ms after their time stamps: .* or the valves are slower", note)


def test_command_refuses_with_one_message(patu: Callable[..., SimpleNamespace], tmp_path: Path) -> None:
    file = tmp_path / "short.csv"
    recording_of().window(0.0, 0.5).save(file)
    done = patu("compare", str(file), "--json", "-")
    assert done.status == 2 and done.out == ""
    assert "short.csv" in done.err and "at least 1 s" in done.err and "Traceback" not in done.err


def at_rest(colour: float) -> Recording:
    """Return 2 s of rest, 1 s of motion and 2 s of a ring that dies out; p1 with noise of 0.3 bar of a correlation time
    in s.
    """
    time = np.arange(0.0, 5.0, 0.005)
    white = np.random.default_rng(7).standard_normal(time.size)
    q = math.exp(-0.005 / colour) if colour else 0.0
    noise = 3e4 * lfilter([math.sqrt(1.0 - q * q)], [1.0, -q], white)
    ring = 5e5 * np.exp(-np.maximum(time - 3.0, 0.0)) * np.sin(2 * np.pi * 3.0 * time) * (time > 2.0)
    u1 = np.where((time > 2.0) & (time < 3.0), 0.3, 0.0)
    z1 = 0.2 + 0.05 * np.clip(time - 2.0, 0.0, 1.0) + 1e-3 * np.random.default_rng(8).standard_normal(time.size)
    columns = {"u1": u1, "u2": 0 * time, "z1": z1, "p1": 5e6 + ring + noise}
    return Recording.from_arrays("rest", time, columns)


def test_slow_noise_at_rest_is_told_and_a_ring_that_dies_out_is_not() -> None:
    waver = lambda colour: [n for n in check_recording(at_rest(colour), CRANE) if "at rest sensors vary" in n]  # noqa: E731
    assert waver(0.0) == []
    assert len(waver(0.03)) == 1 and "p1 by" in waver(0.03)[0] and "z1" not in waver(0.03)[0]
    recording = at_rest(0.03)
    explained = check_recording(recording, CRANE, explained=True)  # a model that leaves only noise swings as it does
    assert explained == [n for n in check_recording(recording, CRANE) if n not in waver(0.03)]
    time, commands = recording.commands(CRANE)
    # parabolas through a quarter of a second take some of it away; the white estimate sees a fifth
    assert 1.5e4 < noise_at_rest(recording["p1"], time, commands) < 3.3e4
    assert noise_std(recording["p1"].values) < 1.2e4


# -- objects of one's own ----------------------------------------------------------------------------------------------


ABOVE, STIFFNESS, REST = np.array([4.5, 4.0]), 500.0, 1.5


def hold_tip(mbs, plant, number):
    """A spring from E to a point above it."""
    above = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=plant.ground, localPosition=[*ABOVE, 0.0]))
    markers = [above, plant.marker("E", number)]
    mbs.AddObject(items.SpringDamper(markerNumbers=markers, referenceLength=REST, stiffness=STIFFNESS))


def test_objects_of_ones_own_are_part_of_a_comparison() -> None:
    """A spring that holds the tip explains the recording; without it, both joints lack its moment."""
    time = np.arange(0.0, 2.5, 0.01)
    commands = {"u1": ramps(time, (0.4, 1.2, 0.3)), "u2": ramps(time, (1.4, 2.1, 0.25))}
    held = CRANE.with_objects(hold_tip)
    start = ExudynEngine(held).static_start(np.radians(12.0), np.radians(-50.0))
    run = simulate(held, Recording.from_arrays("held", time, commands), start=start, step=2.5e-3)
    recording = measured(run, seed=3)
    with pytest.raises(CraneError, match="only the Exudyn engine"):
        compare(held, recording)
    found = compare(held, recording, "exudyn")
    assert found.error < 1.1 and not found.violated
    assert compare(CRANE, recording, "exudyn").violated == ("torque.O", "torque.A")


def test_the_moments_of_objects_do_the_work_of_their_forces() -> None:
    angles = np.radians([12.0, -50.0])
    engine = ExudynEngine(CRANE.with_objects(hold_tip))
    found = engine.object_moments(engine.static_start(*angles)[None], np.zeros(1))[0]

    def energy(z: np.ndarray) -> float:
        away = float(np.linalg.norm(ABOVE - pose(CRANE, *z).points["E"][0]))
        return 0.5 * STIFFNESS * (away - REST) ** 2

    h = 1e-5
    by_energy = [-(energy(angles + h * v) - energy(angles - h * v)) / (2.0 * h) for v in np.eye(2)]
    assert found == pytest.approx(by_energy, rel=1e-7)
