"""Effects taken in one by one, on synthetic recordings whose sensors drift, ring on, round off, and start anywhere."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from crane_exudyn import Crane, Recording
from crane_exudyn.effects.base import Parameter
from crane_exudyn.inputs import SpoolPath
from validation.criteria import CRITERIA
from validation.fit.data import FitData, data_of
from validation.fit.knots import reknot
from validation.fit.solve import fit
from validation.fit.staged import residuals, run_fitted
from validation.fit.variables import EffectParameter, uncertain_parameters
from validation.fit.windows import cut
from validation.improvement import explained
from validation.selection.drifting import DRIFTING, DriftingPath
from validation.selection.levels import Levels, falls, independent, likelihoods, noise_level, window_errors
from validation.selection.proven import Proven, believable, proven
from validation.selection.search import Problem, search
from validation.selection.whole_runs import Taken
from validation.semi_recursive.engine import SemiRecursiveEngine

NOISE = {"z1": 1e-3, "z4": 1e-3, "p1": 3e4, "p2": 2e4, "p3": 2e4, "p4": 2e4}
#: few parameters are uncertain here, so that the fits are short
KNOWN = ("payload.mass", "valves.lift.flow_coefficient", "fluid.oil_bulk_modulus")


def coloured(rng: np.random.Generator, n: int, rho: float) -> np.ndarray:
    """Return n samples of unit variance whose neighbours are correlated by rho."""
    from scipy.signal import lfilter

    return np.asarray(lfilter([math.sqrt(1.0 - rho**2)], [1.0, -rho], rng.standard_normal(n + 500))[500:])


def recorded(crane: Crane, seconds: float = 4.5, less_loaded: float | None = None) -> Recording:
    """Return a lift with correlated, rounded sensors that drift, from a start that the crane file does not tell."""
    time = np.arange(0.0, seconds, 0.01)
    u = np.column_stack([np.interp(time, [0.5, 0.8, 3.0, 3.3], [0.0, 0.25, 0.25, 0.0]), np.zeros_like(time)])
    engine = SemiRecursiveEngine(crane)
    w = np.column_stack([SpoolPath(crane).run(time, u), np.full((len(time), 2), np.nan)])
    start = engine.static_start(0.13, -0.7, less_loaded=less_loaded)
    start[4] += 3e5  # not at rest: it rings from the first sample on
    X = engine.simulate(start, time, w)
    rng = np.random.default_rng(11)
    values = {}
    for name, column in zip(NOISE, (0, 1, 4, 5, 6, 7), strict=True):
        error = coloured(rng, len(time), 0.9) + 1.0 * (time / seconds - 0.5)
        step = 0.5 * NOISE[name]
        values[name] = step * np.round((X[:, column] + NOISE[name] * error) / step)
    return Recording.from_arrays("real sensors", time, {"u1": u[:, 0], "u2": u[:, 1], **values})


@pytest.fixture(scope="module")
def crane():
    given = Crane.load("patu655")
    return replace(given, uncertainty={n: given.uncertainty[n] for n in KNOWN}, sensors=NOISE)


def test_independent_samples_of_white_correlated_and_drifting_errors():
    rng = np.random.default_rng(2)
    n = 20000
    assert independent(rng.standard_normal(n)) == pytest.approx(n, rel=0.1)
    rho = 0.9
    assert independent(coloured(rng, n, rho)) == pytest.approx(n * (1 - rho) / (1 + rho), rel=0.25)
    assert independent(np.linspace(-1.0, 1.0, n)) < 5.0


def test_an_error_below_the_sensors_noise_counts_no_further():
    before = {"z1": 10.0, "p1": 2.0}
    assert falls(before, {"z1": 5.0, "p1": 2.0}) == pytest.approx(0.5 * math.log(2.0))
    assert falls({"z1": 1.0, "p1": 2.0}, {"z1": 0.1, "p1": 2.0}) == 0.0


def test_priors_hold_an_effect_near_what_the_file_says_or_near_what_is_met_in_practice():
    band = Parameter("upper", "", 0.0, 0.0, 0.8, 0.05, "width")
    stated, free = (
        EffectParameter("dead_band@lift", band, 0.2, stated=True),
        EffectParameter("dead_band@lift", band, 0.0),
    )
    assert (stated.to_u(0.2), stated.to_value(1.0), stated.prior) == (0.0, pytest.approx(0.2 * 4 / 3), 1.0)
    assert (free.to_u(0.05), free.prior) == (1.0, CRITERIA.plausible)
    assert free.to_value(free.to_u(0.3)) == pytest.approx(0.3)


def searched(crane: Crane, recording: Recording, most: int) -> DriftingPath:
    return search(DRIFTING, Problem.of(crane, [recording], (), 1), most)


def many(crane: Crane, recording: Recording, most: int) -> Proven | None:
    return searched(crane, recording, most).proven


def test_real_sensors_alone_ask_for_no_effect(crane):
    assert many(crane, recorded(crane), most=1) is None


@pytest.fixture
def rubbing(crane, monkeypatch):
    """A recording of a compensated valve and rubbing seals; half as many effects are tried, for half of the time."""
    for place in ("drifting", "proven"):
        monkeypatch.setattr(f"validation.selection.{place}.CRITERIA", replace(CRITERIA, tried=4))
    friction = {"dFc": 5000.0, "dFs": 5000.0, "vs": 5e-3}
    return recorded(
        crane.with_effect("pressure_compensation@lift", {"dpc": 7e5}).with_effect("seal_friction@lift", friction)
    )


def test_two_effects_are_taken_in_one_by_one_with_what_each_brought(crane, rubbing):
    found = many(crane, rubbing, most=2)
    assert found is not None
    assert "pressure_compensation@lift" in found.needed
    assert any("friction" in key for key in found.needed)
    assert min(found.needed.values()) > 5.0
    assert found.after["p1"] < 0.3 * found.nominal["p1"]
    assert found.predicted["p1"] < found.nominal["p1"]
    texts = explained(found)
    assert sum(t.startswith("Needed: ") for t in texts) == len(found.needed)
    assert any(t.startswith("Remaining error, %") for t in texts)


def test_what_no_round_took_in_is_where_everything_is_fitted_together(crane, rubbing):
    path = searched(crane, rubbing, most=1)
    _, last = path.served
    found = proven(path.problem, last, path.parameters.errors[1], most=2)
    assert len(path.rounds) == len(path.proven.needed) == 1
    metering, friction = found.needed
    assert metering == "pressure_compensation@lift" and "friction" in friction
    assert found.after["p1"] < 0.5 * path.proven.after["p1"]
    assert found.taken[1].evidence > CRITERIA.proof


def test_two_are_taken_in_at_once_where_neither_alone_lowers_the_errors_by_enough(crane, rubbing, monkeypatch):
    path = searched(crane, rubbing, most=0)
    enough = replace(CRITERIA, gained=99.0, part=0.8)  # of what is left one takes 62 %, two take 93
    monkeypatch.setattr("validation.selection.whole_runs.CRITERIA", enough)
    found = proven(path.problem, [path.parameters], path.parameters.errors[1], most=2)
    assert len(found.needed) == 2 and "pressure_compensation@lift" in found.needed


def test_what_no_look_shows_is_fitted_where_everything_is_fitted_together(crane, monkeypatch):
    """Air begun at each pressure up to which it may be free, of which no look along a run promises anything."""
    truth = crane.with_effect("released_air", {"alpha": 0.1, "ps": 10e5})
    path = searched(crane, recorded(truth, less_loaded=2e5), most=0)
    monkeypatch.setattr("validation.selection.proven.screen", lambda fit, starts, stiffness: [])
    found = proven(path.problem, [path.parameters], path.parameters.errors[1], most=1)
    (air,) = found.crane.effects
    assert air.key == "released_air" and air.parameters == pytest.approx(truth.effects[0].parameters, rel=0.15)
    assert found.after["p2"] < 0.1 * path.parameters.errors[0]["p2"]


def test_what_shows_in_the_last_part_alone_is_learned_from_all_of_the_recording(crane):
    """Only noise is left in the first five eighths, from which a search begins to learn."""
    truth = crane.with_effect("payload_change", {"dm": 60.0, "T": 3.6})
    found = many(crane, recorded(truth), most=1)
    assert found is not None and list(found.needed) == ["payload_change"]
    assert {e.key: e.parameters["dm"] for e in found.crane.effects} == {"payload_change": pytest.approx(60.0, rel=0.05)}


def test_the_level_of_noise_is_higher_where_few_samples_tell_the_noise(crane):
    short = recorded(crane)
    estimated = noise_level(FitData.of(short, replace(crane, sensors={})))
    assert CRITERIA.level < estimated < 1.2  # 450 samples of six channels: 4 * 2.6 %
    assert noise_level(FitData.of(short, crane)) == CRITERIA.level


def grown(crane: Crane, predicted: float) -> Proven:
    """Return a search that took in one effect and leaves that error where the model before leaves 20 times the noise;
    the range is 100.
    """
    with_effect = crane.with_effect("dead_band@lift", {"upper": 0.1})
    errors = {"p1": predicted}
    return Proven(
        with_effect, (Taken("dead_band@lift", 30.0, {"command_delay@lift": 28.0, "sensor_lag@p1": 6.0}),), errors,
        {"dead_band@lift": 40.0}, {"dead_band@lift": {"p1": 25.0}}, {"p1": 20.0}, errors,
        {"dead_band@lift:upper": 0.01, "fluid.oil_bulk_modulus": 5e6},
        {("dead_band@lift:upper", "valves.lift.time_constant"): -0.95},
        {"fluid.oil_bulk_modulus": 3.6, "payload.mass": 0.4}, {"p1": 100.0}, 1.04,
    )  # fmt: skip


def test_effects_are_kept_only_if_what_was_not_fitted_is_predicted_better_by_a_tenth(crane):
    assert grown(crane, 17.0).predicts_better
    assert not grown(crane, 19.0).predicts_better


def test_plain_words_say_what_is_demanded_what_is_not_separated_and_what_is_left(crane):
    text = "\n".join(explained(grown(crane, 5.0)))
    assert "Needed: dead_band@lift" in text
    assert "upper = 0.1 ± 0.01" in text
    assert "p1 25 -> 5 %" in text
    assert "command_delay@lift would have gained half" in text and "sensor_lag@p1" not in text
    assert "dead_band@lift:upper and valves.lift.time_constant (correlation -0.95)" in text
    assert "fluid.oil_bulk_modulus = 1.65e+09 ± 5e+06 Pa" in text and "payload" not in text
    assert "Hardly plausible" in text and "fluid.oil_bulk_modulus by 3.6" in text
    assert "Remaining error, % of each channel's range, open loop over the whole recording: p1 5" in text


def test_the_last_fit_keeps_parameters_within_what_can_be_believed():
    free = {v.name: v for v in uncertain_parameters(Crane.load("patu655-lab"))}
    boom = believable(free["bodies.lift_boom.mass"])
    assert (boom.lower, boom.upper) == (-3.0, 3.0)
    payload = believable(free["payload.mass"])
    assert (payload.lower, payload.upper) == (
        free["payload.mass"].lower,
        free["payload.mass"].upper,
    )  # a range is a range


def test_errors_in_windows_are_those_of_the_run_where_a_slow_spool_is_on_its_way(crane):
    slow = crane.with_parameters({"valves.lift.time_constant": 0.6})
    data = data_of([recorded(slow)], slow)
    run = run_fitted(slow, data.parts[0])
    data = data.stepped(run.data.step)
    windows = cut(data, 1.0)
    found = fit(slow, data, windows, reknot(run, windows), iterations=0)
    open_loop = residuals(slow, run.data, run.starts, run.late)
    for channel, (r,) in window_errors(found, data).items():
        assert np.sqrt(np.mean(r**2)) == pytest.approx(np.sqrt(np.mean(open_loop[channel][1] ** 2)), rel=0.02)


def test_a_channel_that_is_given_up_costs_more_than_it_saves_elsewhere(monkeypatch):
    def fitted(levels: dict[str, float], prior_cost: float = 0.0) -> SimpleNamespace:
        return SimpleNamespace(levels=levels, prior_cost=prior_cost)

    monkeypatch.setattr("validation.selection.levels.levels_of", lambda found, *_, **__: Levels(found.levels, 4.0))
    monkeypatch.setattr(
        "validation.selection.levels.window_errors", lambda found, _: {c: [np.zeros(1600)] for c in found.levels}
    )
    even, uneven = fitted({"p1": 3.0, "p2": 3.0}), fitted({"p1": 2.5, "p2": 12.0})
    moved = fitted({"p1": 3.0, "p2": 3.0}, prior_cost=1e3)
    found = likelihoods((even, uneven, moved), None)
    assert found[0] > found[1] > found[2]
    assert found[0] - found[1] == pytest.approx(100.0 * math.log(2.5 * 12.0 / 9.0))
