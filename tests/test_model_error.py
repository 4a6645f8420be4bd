"""Intervals that hold when the model is wrong: coverage of what no sensor measures, no loss where the model is right,
bookkeeping.
"""

from __future__ import annotations

import json
from functools import cache

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.statics import visible
from ukf import model_error
from ukf.augment import Augment
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.noise import ProcessNoise
from ukf.replay import Replay
from ukf.signals import Signals
from validation.semi_recursive import SemiRecursiveEngine

NOMINAL = Crane.load("patu655")
LAYOUT = NOMINAL.layout
MACHINES = {
    "nominal": NOMINAL,
    "payload": NOMINAL.with_parameters({"payload.mass": 140.0}),
    "leak": NOMINAL.with_effect("internal_leakage@lift", {"k": 5e-12}),
}
STD = {"z1": np.radians(0.05), "z4": np.radians(0.05), "p1": 0.3e5, "p4": 0.3e5}
STEP, RATE, DURATION = 5e-3, 100, 5.0


@cache
def recorded(name: str) -> tuple[Signals, np.ndarray]:
    """Return the signals of a machine in which both booms move, and its true states at their instants."""
    crane, engine = MACHINES[name], SemiRecursiveEngine(MACHINES[name])
    time = np.arange(round(DURATION * 1000) + 1) * 1e-3
    commands = np.zeros((time.size, 2))
    commands[500:1500, 0], commands[2000:3000, 1], commands[3500:4200, 0] = 0.4, 0.35, -0.4
    inputs = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    states = engine.simulate(engine.static_start(*crane.initial.pose), time, inputs, step=1e-3)
    every, rng = slice(None, None, 1000 // RATE), np.random.default_rng(7)
    truth = visible(crane, states)[every]
    sensors = {
        n: (time[every], truth[:, LAYOUT.index(n)] + std * rng.normal(size=len(truth))) for n, std in STD.items()
    }
    return Signals(time, commands, sensors, name=name), truth


def plain() -> Estimator:
    """Return the filter with the nominal model and little noise."""
    return Estimator(NOMINAL, "semi-recursive", STD, ProcessNoise((1e-7,) * 2, (1e6,) * 4), max_step=STEP)


@cache
def estimated(name: str, mode: str = "auto") -> Estimate:
    return model_error.estimate(plain(), recorded(name)[0], mode=mode)


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
    unknowns = (*(Augment(n, 500.0, memory=3.0) for n in LAYOUT.torques), Augment("flow.p1", 1e-5, memory=1.0))
    noise, sizes = ProcessNoise((1e-4,) * 2, (1e8,) * 4), [500.0, 500.0, 1e-5]
    estimator = plain().varied(noise=noise, augment=unknowns)
    replay = Replay(estimator, signals, estimator.extras)
    constants = -replay.used * (0.5 * np.log(2 * np.pi) + np.mean(np.log(list(STD.values()))))
    ran = estimator.run(signals).log_likelihood
    assert replay.log_likelihood(noise, sizes) + constants == pytest.approx(ran, abs=5e-3 * replay.used)
    other, wider = ProcessNoise((1e-3,) * 2, (1e9,) * 4), [200.0, 800.0, 3e-5]
    augment = tuple(Augment(a.name, size, memory=a.memory) for a, size in zip(unknowns, wider, strict=True))
    ran = estimator.varied(noise=other, augment=augment).run(signals).log_likelihood
    assert replay.log_likelihood(other, wider) + constants == pytest.approx(ran, abs=5e-3 * replay.used)


def test_a_fading_state_returns_to_its_nominal_value():
    signals, _ = recorded("nominal")
    known = {n: s for n, s in signals.sensors.items() if n == "z1"}
    fading = (Augment("supply.pump_pressure", 5e5, memory=0.5),)
    estimator = Estimator(NOMINAL, "semi-recursive", {"z1": STD["z1"]}, augment=fading, max_step=STEP)
    rest = Signals(signals.command_time, 0.0 * signals.commands, known)
    estimate = estimator.run(rest)
    np.testing.assert_allclose(estimate.std[:, -1], 5e5, rtol=1e-3)  # at rest no sensor tells of it: it keeps its size
    np.testing.assert_allclose(estimate["supply.pump_pressure"], NOMINAL["supply.pump_pressure"], atol=1e4)
