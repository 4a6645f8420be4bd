"""Models side by side: which of them a machine follows, and when it goes over from one to the other."""

from __future__ import annotations

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.measurement import Measurement
from patu.estimate import model_cranes
from patu.main import one_each
from ukf.estimator import Estimator
from ukf.filter import Belief
from ukf.revisit import Revisit
from ukf.side_by_side import SideBySide, followed, mixture
from ukf.signals import Signals
from ukf.tuning import cut
from validation.semi_recursive import SemiRecursiveEngine

SOUND = Crane.load("patu655")
LEAKY = SOUND.with_effect("internal_leakage@lift", {"k": 1e-11})
MODELS = {"sound": SOUND, "leaky": LEAKY}
NOISE = {"z1": 9e-4, "z4": 9e-4, "p1": 3e4, "p4": 3e4}
FAST = "semi-recursive"


def side_by_side(**models: Crane) -> SideBySide:
    return SideBySide({name: Estimator(crane, FAST, NOISE, max_step=5e-3) for name, crane in models.items()})


@pytest.fixture(scope="module")
def opened() -> tuple[Signals, np.ndarray]:
    """Return 5 s of a machine whose lift cylinder leaks from 2.5 s on, at 200 Hz, and its true states."""
    time = np.arange(0.0, 5.0, 1e-3)
    commands = 0.3 * np.column_stack([np.sin(2.0 * time), np.sin(3.0 * time + 1.0)])
    inputs = np.column_stack([SpoolPath(SOUND).run(time, commands), np.full((time.size, 2), np.nan)])
    engine, k = SemiRecursiveEngine(SOUND), 2500
    before = engine.simulate(engine.static_start(0.5, -0.7), time[: k + 1], inputs[: k + 1])
    states = np.vstack([before[:-1], SemiRecursiveEngine(LEAKY).simulate(before[-1], time[k:], inputs[k:])])[::5]
    random = np.random.default_rng(4)
    shown = Measurement.of(SOUND, tuple(NOISE)).shown(states, time[::5], settled=True)
    noisy = {
        n: (time[::5], y + random.normal(0.0, s, y.size)) for (n, s), y in zip(NOISE.items(), shown.T, strict=True)
    }
    return Signals(time, commands, noisy), states


def test_a_leak_that_opens_is_seen_within_a_second_and_the_mixture_holds_the_truth(opened):
    signals, truth = opened
    estimate = side_by_side(sound=SOUND, leaky=LEAKY).run(signals)
    leaky = estimate.models["leaky"]
    assert np.allclose(leaky + estimate.models["sound"], 1.0)
    assert (leaky[(estimate.time > 0.5) & (estimate.time < 2.5)] < 0.9).all() and (
        leaky[estimate.time > 3.5] > 0.9
    ).all()
    assert min(estimate.coverage(truth).values()) > 0.85
    told = estimate.document()["models"]["leaky"]
    assert told["final"] > 0.9 and any(a < 3.5 and b == pytest.approx(4.995) for a, b in told["leads"])


def test_one_model_twice_is_that_model(opened):
    signals, _ = opened
    twice = side_by_side(one=SOUND, other=SOUND).run(signals)
    alone = Estimator(SOUND, FAST, NOISE, max_step=5e-3).run(signals)
    np.testing.assert_allclose(twice.models["one"], 0.5, atol=1e-9)
    np.testing.assert_allclose(twice.mean, alone.mean, rtol=1e-6, atol=1e-6)
    assert twice.log_likelihood == pytest.approx(alone.log_likelihood, rel=1e-9)


def test_a_model_with_more_states_takes_part(opened):
    signals, _ = opened
    estimate = side_by_side(sound=SOUND, lagging=SOUND.with_effect("sensor_lag@p1", {"tau": 0.2})).run(signals)
    assert estimate.models["sound"][-1] > 0.9 and estimate.state_names == SOUND.layout.states


def test_what_models_do_not_share_follows_what_they_share():
    """Against the conditional of a normal distribution: what is mixed in moves the rest by its regression, and its own
    spread stays.
    """
    random = np.random.default_rng(0)
    root = random.normal(size=(5, 5))
    own = Belief(random.normal(size=5), root @ root.T)
    same = followed(own, Belief(own.mean[:3], own.covariance[:3, :3]))
    np.testing.assert_allclose(same.mean, own.mean)
    np.testing.assert_allclose(same.covariance, own.covariance, rtol=1e-10)
    moved = followed(own, Belief(own.mean[:3] + 1.0, 2.0 * own.covariance[:3, :3]))
    slope = own.covariance[3:, :3] @ np.linalg.inv(own.covariance[:3, :3])
    np.testing.assert_allclose(moved.mean[3:] - own.mean[3:], slope @ np.ones(3))
    assert np.linalg.eigvalsh(moved.covariance).min() > 0.0


def test_a_mixture_spreads_by_what_its_parts_differ_by():
    parts = [Belief(np.array([0.0]), np.array([[1.0]])), Belief(np.array([4.0]), np.array([[1.0]]))]
    mixed = mixture(np.array([0.5, 0.5]), parts)
    assert mixed.mean[0] == 2.0 and mixed.covariance[0, 0] == 5.0


def test_models_of_other_machines_or_none_beside_are_refused():
    with pytest.raises(CraneError, match="Only one model"):
        side_by_side(sound=SOUND)
    loader = Crane.load("loader")
    patu = Estimator(SOUND, FAST, NOISE)
    with pytest.raises(CraneError, match="loader is not a model of the same machine"):
        SideBySide({"patu": patu, "loader": Estimator(loader, FAST)})
    with pytest.raises(CraneError, match="a, b: two names share one estimator"):
        SideBySide({"a": patu, "b": patu})
    for none in ({"a": SOUND, "b": SOUND}, [patu, patu.varied()]):
        with pytest.raises(CraneError, match="found no estimators by name"):
            SideBySide(none)
    with pytest.raises(CraneError, match="b: models side by side cannot repeat the beginning"):
        SideBySide({"a": patu, "b": patu.varied(method="ekf", revisit=Revisit(1.0))})
    for stays in (0.0, "20"):
        with pytest.raises(CraneError, match="stays is"):
            SideBySide({"a": patu, "b": patu.varied()}, stays)


def test_events_name_the_model_and_the_worst_one_counts(opened):
    """Two filters that fail at every fourth step fail at a quarter of them, not at half."""
    signals, _ = opened
    both = SideBySide({n: Estimator(c, Failing(c), NOISE, max_step=5e-3) for n, c in MODELS.items()})
    found = both.run(cut(signals, 0.0, 0.5))
    counts = {e.where: e.count for e in found.events}
    assert counts == {"filter of sound": 25, "filter of leaky": 25} and found.failures == 25


class Failing(SemiRecursiveEngine):
    """An engine that fails at every fourth step."""

    steps = 0

    def propagate(self, *arguments, **keywords):
        """Raise CraneError now and then."""
        self.steps += 1
        if self.steps % 4 == 0:
            raise CraneError("the step did not converge")
        return super().propagate(*arguments, **keywords)


def test_one_spike_says_nothing_of_the_models(opened):
    """One sample 20 bar off, which both filters reject, took the probability of the leak from 0.001 to 0.9999987."""
    signals, _ = opened
    time, values = signals.sensors["p1"]
    spoilt = values.copy()
    spoilt[400] += 20e5  # at 2 s, before it leaks
    probabilities, logs = [], []
    for y in (values, spoilt):
        both = side_by_side(sound=SOUND, leaky=LEAKY)
        found = both.run(Signals(signals.command_time, signals.commands, signals.sensors | {"p1": (time, y)}))
        probabilities.append(found.models["leaky"])
        logs.append(found.log_likelihood)
    assert np.abs(probabilities[1] - probabilities[0])[:480].max() < 0.05
    assert logs[1] > logs[0] - 0.5 * 6.0**2 - 5.0, "a noise that fits is not looked for by it either"
    assert any("rejected" in e.text for e in found.events)


def test_files_of_one_name_in_two_folders_keep_their_cranes(tmp_path):
    """The second took the first one's place, and the third was run by its name."""
    for folder, mass in (("a", 100.0), ("b", 200.0)):
        (tmp_path / folder).mkdir()
        SOUND.with_parameters({"payload.mass": mass}).save(tmp_path / folder / "crane.toml")
    files = [str(tmp_path / folder / "crane.toml") for folder in "ab"]
    loaded = model_cranes([*files, "patu655"], "patu655", None)
    assert [(n, c["payload.mass"]) for n, c in loaded.items()] == [
        (files[0], 100.0), (files[1], 200.0), ("patu655", SOUND["payload.mass"]),
    ]  # fmt: skip
    assert list(model_cranes([files[0], "patu655"], "patu655", None)) == ["crane", "patu655"]
    with pytest.raises(CraneError, match="twice"):
        model_cranes([files[0], files[0]], "patu655", None)


def test_a_recording_behind_the_models_is_told(patu):
    done = patu("estimate", "--models", "A.toml", "B.toml", "lift.csv", "--json", "-")
    assert done.status == 2 and "lift.csv was read as a value of --models; put REC first." in done.err
    assert "was taken" not in patu("estimate", "a.csv", "--models", "A.toml", "B.toml", "--wrong").err


def test_models_are_listed_behind_one_option():
    words = ["a.csv", "--models", "A.toml", "B.toml", "C.toml", "--json", "-"]
    assert one_each(words) == [
        "a.csv",
        "--models",
        "A.toml",
        "--models",
        "B.toml",
        "--models",
        "C.toml",
        "--json",
        "-",
    ]
