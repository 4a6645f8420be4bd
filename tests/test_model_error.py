"""Intervals that hold when the model is wrong: coverage of what no sensor measures, no loss where the model is right,
bookkeeping.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.description import GaussMarkov, Uncertainty
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.statics import visible
from ukf import model_error
from ukf.augment import Augment
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.methods import method_of
from ukf.model_error import Unknown
from ukf.noise import ProcessNoise
from ukf.replay import Replay
from ukf.signals import Signals
from ukf.start import start_belief
from ukf.tuning import cut
from validation.semi_recursive import SemiRecursiveEngine

NOMINAL = Crane.load("patu655")
LAYOUT = NOMINAL.layout
MACHINES = {
    "nominal": NOMINAL,
    "payload": NOMINAL.with_parameters({"payload.mass": 140.0}),
    "leak": NOMINAL.with_effect("internal_leakage@lift", {"k": 5e-12}),
    "as uncertain as the file says": NOMINAL.with_parameters(
        {"payload.mass": 220.0}
        | {n: NOMINAL[n] - NOMINAL.uncertainty[n].std for n in ("fluid.oil_bulk_modulus", "bodies.outer_boom.mass")}
    ),
}
STD = {"z1": np.radians(0.05), "z4": np.radians(0.05), "p1": 0.3e5, "p4": 0.3e5}
ALL = STD | {"p2": 0.3e5, "p3": 0.3e5}
STEP, RATE, DURATION = 5e-3, 100, 5.0


@cache
def recorded(name: str, seed: int = 7) -> tuple[Signals, np.ndarray]:
    """Return the signals of a machine in which both booms move, the pressures that the filter is not shown among them,
    and its true states at their instants.
    """
    crane, engine = MACHINES[name], SemiRecursiveEngine(MACHINES[name])
    time = np.arange(round(DURATION * 1000) + 1) * 1e-3
    commands = np.zeros((time.size, 2))
    commands[500:1500, 0], commands[2000:3000, 1], commands[3500:4200, 0] = 0.4, 0.35, -0.4
    inputs = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    states = engine.simulate(engine.static_start(*crane.initial.pose), time, inputs, step=1e-3)
    every, rng = slice(None, None, 1000 // RATE), np.random.default_rng(seed)
    truth = visible(crane, states)[every]
    sensors = {
        n: (time[every], truth[:, LAYOUT.index(n)] + std * rng.normal(size=len(truth))) for n, std in ALL.items()
    }
    return Signals(time, commands, sensors, name=name), truth


def plain(crane: Crane = NOMINAL, std: Mapping[str, float] = STD) -> Estimator:
    """Return the filter with the nominal model and little noise."""
    return Estimator(crane, "semi-recursive", std, ProcessNoise((1e-7,) * 2, (1e6,) * 4), max_step=STEP)


@cache
def estimated(name: str, mode: str = "auto") -> Estimate:
    return model_error.estimate(plain(), recorded(name)[0], mode=mode)


@cache
def told_by_all_sensors() -> tuple[Mapping[str, GaussMarkov], tuple[Unknown, ...]]:
    """Return what a recording of the leak with all sensors tells a crane file, and the unknowns that it was sought
    among.
    """
    seen, expected = [], model_error.expected
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_error, "expected", lambda *given: (seen.append(expected(*given)), seen[-1])[1])
        known = model_error.lasting(NOMINAL, [(recorded("leak", 8)[0], ALL)])
    return known, seen[0].unknowns


def errors(name: str, mode: str = "auto") -> np.ndarray:
    """Return error over standard deviation (N, m) of the states that no sensor measures, from the first motion on."""
    estimate, truth = estimated(name, mode), recorded(name)[1]
    free = [i for i, n in enumerate(LAYOUT.states) if n not in STD]
    moving = estimate.time > 0.6
    return ((estimate.mean - truth) / estimate.std)[np.ix_(moving, free)]


@pytest.mark.parametrize("name", ["payload", "leak"])
def test_what_no_sensor_measures_is_inside_its_interval_when_the_model_is_wrong(name):
    assert estimated(name).model_error.used
    assert (np.abs(errors(name)) <= 1.96).mean(axis=0).min() >= 0.85
    assert (np.abs(errors(name, "off")) <= 1.96).mean(axis=0).min() < 0.7
    assert np.sqrt((errors(name) ** 2).mean(axis=0)).min() > 0.2  # and the intervals are not simply wide


def test_what_all_sensors_once_told_of_a_wrong_model_narrows_intervals_that_hold_without_them():
    known, _ = told_by_all_sensors()
    assert {*LAYOUT.torques, "flow.p1", "flow.p3", "supply.pump_pressure"} <= set(known)
    assert not any(n in known for n in ("payload.mass", "flow.p2", "bias.p1"))
    assert all(e.std > 0.0 and e.memory <= 10.0 for e in known.values())
    result = model_error.estimate(plain(replace(NOMINAL, model_error=known)), recorded("leak")[0])
    before = estimated("leak")
    p3, moving = LAYOUT.index("p3"), result.time > 0.6
    error = (result.mean[:, p3] - recorded("leak")[1][:, p3])[moving]
    assert (np.abs(error) <= 1.96 * result.std[moving, p3]).mean() >= 0.85
    assert result.std[moving, p3].mean() < 0.8 * before.std[moving, p3].mean()


def test_a_live_filter_of_a_right_model_stays_at_the_truth():
    """A crane at rest, without noise: payloads below nothing were cut off at nothing, and p2 went to 37 bar with an
    interval that did not hold the 20 of the truth.
    """
    still, w = NOMINAL.initial.pose, np.zeros(2)
    state = visible(NOMINAL, SemiRecursiveEngine(NOMINAL).static_start(*still)[None])[0]
    live = model_error.live(Estimator(NOMINAL, "semi-recursive", STD, max_step=5e-3))
    for k in range(401):
        now = live.step(w, {n: state[LAYOUT.index(n)] for n in STD}, time=5e-3 * k)
    for name in ("p2", "p3"):
        assert now[name] == pytest.approx(state[LAYOUT.index(name)], abs=2e5)
    assert now["payload.mass"] == pytest.approx(NOMINAL["payload.mass"], abs=5.0)


def test_several_wrong_models_allow_for_it_together():
    """Of two models neither of which is the machine's; what was asked for by default was left out in silence."""
    models = {"nominal": plain(), "leak": plain(MACHINES["leak"])}
    signals, truth = recorded("payload")
    off, auto = (model_error.estimate_side_by_side(models, signals, mode=m) for m in ("off", "auto"))
    assert (off.model_error.used, auto.model_error.used) == (False, True)
    p2 = LAYOUT.index("p2")
    inside = [(np.abs(e.mean[:, p2] - truth[:, p2]) <= 1.96 * e.std[:, p2])[e.time > 0.6].mean() for e in (off, auto)]
    assert inside[0] < 0.7 and inside[1] >= 0.85


def test_noise_that_is_overstated_is_told_and_hides_no_model_that_is_wrong():
    """A recording with noise was called one without, and a model without its payload was said to have too much."""
    filter_ = plain(std={n: 5.0 * s for n, s in STD.items()})
    right, wrong = (filter_.run(recorded(n)[0]) for n in ("nominal", "payload"))
    assert not right.noiseless and not right.consistent and right.overstated == tuple(STD) and not right.persistent
    assert right.verdict == "not consistent: intervals too wide"
    assert wrong.persistent and not wrong.noiseless


def test_a_payload_is_estimated_along_only_where_the_innovations_ask_for_another_one():
    leaking, laden = (estimated(n).model_error for n in ("leak", "payload"))
    assert leaking.used and "payload.mass" not in leaking.found
    assert laden.used and "payload.mass" in laden.found


def test_the_interval_of_a_payload_holds_where_oil_and_masses_are_off_as_the_file_says_they_may_be():
    """The filter weighs a payload by how fast the boom rings, and believed in the softness of its oil."""
    found = estimated("as uncertain as the file says").model_error.found["payload.mass"]
    assert abs(found["value"] - 220.0) < 1.96 * found["std"] < 30.0
    assert found["nominal"] == NOMINAL["payload.mass"]


def test_a_payload_that_is_asked_for_is_known_no_better_than_the_masses_beside_it():
    """With a model that is right: 5 % of the outer boom's mass are as much as 3 kg of payload."""
    asked = plain().varied(augment=("payload.mass",))
    off, auto = (model_error.estimate(asked, recorded("nominal")[0], mode=m) for m in ("off", "auto"))
    sure = replace(asked.crane, uncertainty={n: u for n, u in NOMINAL.uncertainty.items() if n == "payload.mass"})
    alone = model_error.estimate(plain(sure).varied(augment=("payload.mass",)), recorded("nominal")[0])
    assert not auto.model_error.used
    np.testing.assert_array_equal(auto.mean, off.mean)
    np.testing.assert_array_equal(alone.std, off.std)
    assert auto.std[-1, -1] > 1.5 + off.std[-1, -1]
    np.testing.assert_array_equal(auto.std[:, :-1], off.std[:, :-1])


def test_what_a_crane_file_keeps_is_held_against_the_model_and_not_against_a_gauge():
    """In no recording a gauge that drifts by thirty times its noise differs from a moment that does."""
    _, unknowns = told_by_all_sensors()
    gauges = [u for u in unknowns if u.names[0].startswith("bias.p")]
    assert len(gauges) == 4 and all(u.most == pytest.approx(u.size) for u in gauges)


def test_what_the_file_calls_constant_has_no_memory_to_be_searched():
    still = replace(NOMINAL, model_error={"torque.A": GaussMarkov(50.0)})
    start = model_error.expected(still, STD)
    moment = next(u for u in start.unknowns if u.names == ("torque.A",))
    assert (moment.size, moment.memory, moment.stays) == (50.0, np.inf, 0.0)
    result = model_error.find(still, recorded("leak")[0], STD)
    assert [u.memory for u in result.unknowns if u.names == ("torque.A",)] == [np.inf]
    assert np.isfinite(result.sizes).all()


def test_a_right_model_is_left_alone():
    result = estimated("nominal")
    assert not result.model_error.used and result.model_error.why == "consistent"
    np.testing.assert_array_equal(result.mean, plain().run(recorded("nominal")[0]).mean)


def test_the_account_says_what_was_estimated_along():
    result = estimated("payload")
    assert result.state_names == LAYOUT.states and result.mean.shape[1] == result.std.shape[1] == len(LAYOUT.states)
    assert result.model_error.why.startswith("without it, not consistent")
    document = json.loads(json.dumps(result.document()))["model_error"]
    assert document["mode"] == "auto" and document["used"]
    payload = document["unknowns"]["payload.mass"]
    assert payload["unit"] == "kg" and payload["nominal"] == 25.0 and abs(payload["value"] - 140.0) < 2 * payload["std"]
    assert result.log_likelihood > estimated("payload", "off").log_likelihood


def test_an_unknown_mode_is_refused():
    with pytest.raises(CraneError, match="model error 'onn'"):
        model_error.estimate(plain(), recorded("nominal")[0], mode="onn")


def test_what_is_estimated_anyway_is_no_unknown():
    names = [n for u in model_error.unknowns(NOMINAL, STD, ["payload.mass", "flow.p2"]) for n in u.names]
    assert "payload.mass" not in names and "flow.p2" not in names and set(LAYOUT.torques) <= set(names)


def test_a_replay_has_the_likelihood_of_the_run():
    signals, _ = recorded("nominal")
    walk, fading = Augment("torque.O", 500.0, drift=99.0), Augment("torque.A", 500.0, memory=3.0)
    unknowns = (walk, fading, Augment("flow.p1", 1e-5, memory=1.0))
    noise = ProcessNoise((1e-4,) * 2, (1e8,) * 4)
    beside = Augment("bias.z1", 1e-3, memory=0.2)
    estimator = plain().varied(noise=noise, augment=(beside, *unknowns))
    replay = Replay(estimator, signals, estimator.extras[1:])
    ran = estimator.run(signals).log_likelihood
    assert replay.log_likelihood(noise, unknowns) == pytest.approx(ran, abs=5e-3 * replay.used)
    other, wider = ProcessNoise((1e-3,) * 2, (1e9,) * 4), [200.0, 800.0, 3e-5]
    augment = tuple(replace(a, std=size, drift=2.0 * a.drift) for a, size in zip(unknowns, wider, strict=True))
    ran = estimator.varied(noise=other, augment=(beside, *augment)).run(signals).log_likelihood
    assert replay.log_likelihood(other, augment) == pytest.approx(ran, abs=5e-3 * replay.used)
    quick = tuple(replace(a, memory=0.3 * a.memory) for a in unknowns)
    ran = estimator.varied(augment=(beside, *quick)).run(signals).log_likelihood
    assert replay.log_likelihood(noise, quick) == pytest.approx(ran, abs=5e-3 * replay.used)


def test_a_joint_whose_balance_the_file_knows_badly_has_a_constant_moment():
    arm = np.cos(NOMINAL.initial.pose[0]) * NOMINAL["bodies.lift_boom.com.x"]
    arm -= np.sin(NOMINAL.initial.pose[0]) * NOMINAL["bodies.lift_boom.com.y"]
    known = replace(NOMINAL, uncertainty={"bodies.lift_boom.mass": NOMINAL.uncertainty["bodies.lift_boom.mass"]})
    std = known.uncertainty["bodies.lift_boom.mass"].std
    np.testing.assert_allclose(model_error.filed_moments(known), [9.81 * arm * std, 0.0], rtol=2e-3, atol=1e-6)
    moments = {u.names[0]: u for u in model_error.unknowns(NOMINAL, STD) if u.names[0] in LAYOUT.torques}
    assert not any(u.stays for u in moments.values())
    heavy = replace(NOMINAL, uncertainty={"bodies.lift_boom.mass": Uncertainty(300.0)})
    first, second = model_error.unknowns(heavy, STD)[:2]
    (walk,), (fading,) = first.augments(50.0), second.augments(50.0)
    assert walk.memory == np.inf and walk.std > first.stays > first.size and fading.memory == second.memory
    assert walk.drift**2 == pytest.approx(50.0**2 * 2.0 / first.memory)  # what fading noise of that size adds at first


def test_a_machine_that_begins_as_its_file_says_has_the_pressures_that_it_says():
    engine, pose = SemiRecursiveEngine(NOMINAL), NOMINAL.initial.pose
    filed, p2 = NOMINAL.initial.less_loaded_pressure[0], LAYOUT.index("p2")

    def started(z1: float, begins: bool) -> tuple[float, float]:
        """Return p2 and its standard deviation where p1 shows 10 bar more than the file's machine would need."""
        p1 = engine.static_start(z1, pose[1], less_loaded=filed)[LAYOUT.index("p1")] + 10e5
        belief = start_belief(NOMINAL, engine.static_start, {"z1": z1, "z4": pose[1], "p1": p1}, STD, 30e5, begins)
        return float(belief.mean[p2]), float(np.sqrt(belief.covariance[p2, p2]))

    ratio = np.divide(*NOMINAL.areas("lift"))
    share = 30e5**2 / (30e5**2 + (0.2 * filed) ** 2)  # of the file's word, beside the balance of moments
    mean, std = started(pose[0], True)
    assert mean == pytest.approx(filed + (1.0 - share) * 10e5 * ratio, rel=1e-3)
    assert std == pytest.approx(0.2 * filed * np.sqrt(share), rel=1e-6)
    for elsewhere in (started(pose[0] + 0.2, True), started(pose[0], False)):
        assert elsewhere == pytest.approx((filed + 10e5 * ratio, 30e5), rel=1e-3)


def test_points_of_unknowns_are_near():
    far, near = (method_of("ukf", np.ones(22), near=near).weights[0].directions for near in (False, True))
    assert np.abs(near).max() == pytest.approx(np.sqrt(3.0)) and np.abs(far).max() == pytest.approx(0.99 * np.sqrt(22))


def test_sensors_of_angles_may_err_for_a_moment():
    memory = {u.names[0]: u.memory for u in model_error.unknowns(NOMINAL, STD) if u.names[0].startswith("bias.")}
    assert memory == {"bias.p1": 10.0, "bias.p4": 10.0, "bias.z1": 0.2, "bias.z4": 0.2}


def test_noise_that_covers_what_the_model_lacks_does_not_hide_it():
    run = estimated("leak", "off")
    swings = 0.7 * run.innovation_std * (-1.0) ** np.arange(len(run.time))[:, None]  # small, and they swing back
    covered = replace(run, innovation=swings, nis=np.full(len(run.time), 0.7**2 * len(STD)))
    assert covered.verdict.endswith("intervals too wide")
    assert not model_error.unasked(covered) and not model_error.lacking(covered)
    assert model_error.lacking(run) and model_error.unasked(estimated("nominal")) == "consistent"


def test_a_fading_state_returns_to_its_nominal_value():
    signals, _ = recorded("nominal")
    known = {n: s for n, s in signals.sensors.items() if n == "z1"}
    fading = (Augment("supply.pump_pressure", 5e5, memory=0.5),)
    estimator = Estimator(NOMINAL, "semi-recursive", {"z1": STD["z1"]}, augment=fading, max_step=STEP)
    rest = cut(Signals(signals.command_time, 0.0 * signals.commands, known), 0.0, 3.0 * fading[0].memory)
    estimate = estimator.run(rest)
    np.testing.assert_allclose(estimate.std[:, -1], 5e5, rtol=1e-3)  # at rest no sensor tells of it: it keeps its size
    np.testing.assert_allclose(estimate["supply.pump_pressure"], NOMINAL["supply.pump_pressure"], atol=1e4)
