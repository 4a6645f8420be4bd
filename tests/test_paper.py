"""The paper's experiment; the Monte Carlo series around it. The published goals are in tests/test_cli_runs.py, where
`patu demo` runs what reaches them.
"""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from ukf.estimator import Estimator
from ukf.filter import Belief, predict_linearised, update_linearised
from ukf.methods import INCREMENT
from validation import filters, montecarlo, paper, paper_seeds, workers, wrong_models
from validation.metrics import pn_rmse, r2

CRANE = Crane.load("patu655")
FAST = "semi-recursive"


def test_errors_of_the_model_are_the_papers():
    wrong = paper.wrong_crane(CRANE, 0.15)
    assert wrong["bodies.lift_boom.mass"] == pytest.approx(1.15 * CRANE["bodies.lift_boom.mass"])
    assert wrong["bodies.outer_boom.inertia"] == pytest.approx(1.15 * CRANE["bodies.outer_boom.inertia"])
    assert wrong["bodies.bracket_2.mass"] == pytest.approx(1.05 * CRANE["bodies.bracket_2.mass"])
    assert wrong["payload.mass"] == 10.0
    assert wrong["supply.pump_pressure"] - CRANE["supply.pump_pressure"] == pytest.approx(20e5)
    for joint in "ABCD":
        assert wrong[f"joints.{joint}.x"] - CRANE[f"joints.{joint}.x"] == pytest.approx(5e-3)
        assert wrong[f"joints.{joint}.y"] - CRANE[f"joints.{joint}.y"] == pytest.approx(-5e-3)
    changed = {n for n in CRANE.values if wrong[n] != CRANE[n]}
    assert len(changed) == 2 + 8 + 8  # payload and pump, four bodies' mass and inertia, four joints' coordinates


def test_the_papers_cycle():
    time = np.array([0.0, 2.0, 4.999, 5.0, 7.0, 9.9, 12.0, 13.9, 14.0, 18.0, 20.9, 21.0])
    expected = [0, 0.5, 0.5, 0, 0, 0, 0, 0, 0, -0.5, -0.5, 0], [0, 0, 0, 0, 0.35, 0.35, -0.35, -0.35, 0, 0, 0, 0]
    np.testing.assert_allclose(paper.INPUT_SETS[1](time).T, expected)


@pytest.mark.parametrize("inputs", paper.INPUT_SETS)
def test_input_sets_move_both_booms_within_their_strokes(inputs):
    truth = paper.real_system(CRANE, inputs, FAST, 0).truth
    span = np.degrees(np.ptp(truth[:, :2], axis=0))
    assert (span > 20.0).all()
    assert (truth[:, 4:] <= 200e5).all()  # `simulate` itself refuses what leaves the stroke


def test_the_papers_tuning_leaves_the_sensor_noise_that_the_formula_says():
    case = paper.run_case(0.15, 1, FAST, 0, duration=4.0)
    assert np.isnan(case.pn_rmse["z4"])  # which has not moved yet
    error = case.estimate.mean[1000:, [4, 7]] - case.experiment.truth[1000:, [4, 7]]
    assert np.sqrt(np.mean(error**2)) == pytest.approx(paper.pressure_floor(), rel=0.1)
    document = case.document()
    assert set(document) >= {"model_error", "inputs", "pn_rmse", "published", "coverage95", "width95", "nees_mean"}
    assert not document["consistent"]  # NIS is far too small: the covariances are not those of this crane
    json.dumps(document, allow_nan=False)


def test_pressure_floor_is_the_stationary_kalman_error():
    """Against the recursion itself, for a constant pressure."""
    q, r, rng = 259.8e8, (1.5e5) ** 2, np.random.default_rng(0)
    estimate, variance, errors = 0.0, q, []
    for _ in range(20000):
        variance += q
        gain = variance / (variance + r)
        estimate += gain * (rng.normal() * np.sqrt(r) - estimate)
        variance *= 1 - gain
        errors.append(estimate)
    assert np.std(errors) == pytest.approx(paper.pressure_floor(), rel=0.03)


def test_reproduce_in_order_and_with_the_contract_keys():
    def short(error, inputs, engine, seed, tunings, crane, seen):
        return [{"model_error": error, "inputs": inputs, "tuning": t, "realtime_factor": 2.0} for t in tunings], {}

    original = paper.all_tunings
    paper.all_tunings = short
    try:
        result = paper.reproduce((0.05, 0.15), (1, 2), FAST)
    finally:
        paper.all_tunings = original
    order = [(d["tuning"], d["inputs"], d["model_error"]) for d in result.documents]
    assert order == [(t, i, e) for t in paper.ROWS for i in (1, 2) for e in (0.05, 0.15)]
    assert result.document()["realtime_factor"] == 2.0


def test_sensors_noise_and_filter_may_be_ones_own():
    """Gauges of 0.15 bar by name of the tuning or by number are the same case; a filter of one's own gets what was
    seen.
    """
    quiet = paper.run_case(0.15, 1, FAST, 0, tuning="paper-0.15-bar", duration=0.5)
    same = paper.run_case(0.15, 1, FAST, 0, noise={"p1": 0.15e5, "p4": 0.15e5}, duration=0.5)
    assert same.rmse == quiet.rmse and quiet.experiment.sensors["p1"] == 0.15e5

    def made(wrong, experiment, engine):
        return Estimator(wrong, engine, experiment.sensors, method="ckf", max_step=2.5e-3)

    case = paper.run_case(0.15, 1, FAST, 0, sensors=("z1", "z4", "p3"), filter=made, duration=0.5)
    assert case.estimate.channel_names == ("z1", "z4", "p3") and case.estimate.method == "ckf"
    with pytest.raises(CraneError, match="a noise for p3, but no such sensor among"):
        paper.run_case(0.15, 1, FAST, 0, noise={"p3": 1e5}, duration=0.1)


def test_filters_are_compared_with_the_same_priors_which_are_chosen_once(monkeypatch):
    chosen = []
    monkeypatch.setattr(paper, "likeliest_width", lambda wrong, experiment, tuning: chosen.append(tuning) or 2.0)
    rows = filters.compare_filters(FAST, tunings=("own",), methods=("ekf", "simplex"), duration=0.03)
    assert chosen == ["own"] and [r.method for r in rows] == ["ekf", "simplex"]
    assert all(np.isfinite(r.nis_mean) and r.states_per_step > 8 for r in rows)


def test_one_width_is_not_weighed_and_the_likeliest_of_several_is():
    experiment = paper.real_system(CRANE, 1, FAST, 0, duration=0.1)
    wrong = paper.wrong_crane(CRANE, 0.15)
    assert [paper.likeliest_width(wrong, experiment, t) for t in ("paper", "own-half")] == [1.0, 0.5]
    width = paper.likeliest_width(wrong, experiment, "own")
    runs = {
        w: paper.estimator(wrong, experiment, FAST, "own", width=w).run(experiment.signals).log_likelihood
        for w in paper.TUNINGS["own"].widths
    }
    assert width == max(runs, key=runs.__getitem__)


def test_own_means_know_as_much_as_slopes_along_the_true_trajectory_tell():
    """The payload's standard deviation where the first estimates are furthest off and cut off at no payload at all.
    Along the smoothed trajectory, which no crane can go, it was less than half of that.
    """
    experiment = paper.real_system(CRANE, 3, FAST, 901, duration=2.8)
    wrong = paper.wrong_crane(CRANE, 0.25)
    filter_ = paper.estimator(wrong, experiment, FAST, "own", width=4.0)
    found = filter_.run(experiment.signals)
    assert not any("settle" in event.text for event in found.events)
    plan, belief = filter_.set_out(experiment.signals), filter_.belief
    increments = INCREMENT * np.sqrt(belief.covariance.diagonal())
    constants = [CRANE[name] for name in filter_.state_names[8:]]
    variance = np.diag(filter_.sensor_variance)
    for k in range(1, plan.time.size):

        def over(points, k=k):
            return filter_.carried(points, plan, k, {})

        def shown(points, k=k):
            return filter_.observe(points, plan.values[k])

        true = np.r_[experiment.truth[k - 1], constants], np.r_[experiment.truth[k], constants]
        prior = predict_linearised(replace(belief, at=true[0]), over, filter_.process_noise(1e-3), increments)
        belief = Belief(prior.mean, prior.covariance, at=true[1])
        belief = update_linearised(belief, shown, plan.values[k], variance, increments)
        belief = Belief(belief.mean, belief.covariance)
    payload = filter_.state_names.index("payload.mass")
    assert found.std[-1, payload] == pytest.approx(np.sqrt(belief.covariance[payload, payload]), rel=0.2)


def test_seeds_count_what_is_below_the_published_errors_and_inside():
    good = {"pn_rmse": paper.PUBLISHED, "coverage95": dict.fromkeys(paper.STATES, 0.9), "nees_mean": 8.0, "found": {}}
    lines = [
        good | {"name": "a", "seed": 2, "width": 2.0},
        good | {"name": "b", "seed": 1, "pn_rmse": paper.PUBLISHED | {"p2": 2.0}},
        good | {"name": "c", "seed": 3, "coverage95": good["coverage95"] | {"z1": 0.5}},
    ]
    table = paper_seeds.table(lines).splitlines()
    assert [row.split(" | ")[0] for row in table[2:5]] == ["| 1", "| 2", "| 3"] and "z1 50 %" in table[4]
    assert "published error: 2 of 3;" in table[-1] and "both: 1." in table[-1]


def test_cases_are_told_over_their_seeds():
    def line(error, inputs, inside):
        told = {"coverage95": inside, "width95": 2.0, "pn_rmse": 0.5}
        return {"model_error": error, "inputs": inputs} | {k: dict.fromkeys(paper.STATES, v) for k, v in told.items()}

    lines = [line(0.25, 3, 0.8), line(0.15, 3, 1.0), line(0.25, 3, 1.0), line(0.25, 1, 0.95)]
    rows = [row.strip("| ").split(" | ") for row in paper_seeds.cases_table(lines).splitlines()[2:]]
    assert [row[:3] for row in rows] == [
        ["25 %", "1", "95 (95), 2.0, 0.50"],
        ["15 %", "3", "100 (100), 2.0, 0.50"],
        ["25 %", "3", "90 (80), 2.0, 0.50"],
    ]


def test_wrong_models_are_judged_by_what_no_sensor_measures():
    def line(p2, width, machine="1 % of air in the oil"):
        states = {"inside": 1.0, "rmse": 1e5, "width": 2.0}
        now = {k: dict.fromkeys(paper.STATES, v) for k, v in states.items()}
        now["inside"] |= {"p2": p2, "p1": 0.1}  # p1 is measured
        now["width"] |= {"p3": width}
        return {"machine": machine, "seed": 0, "why": "", "off": now, "auto": now}

    lines = [line(0.85, 4.0), line(0.84, 4.0), line(0.85, 4.1), line(0.0, 1.0, "nothing")]
    assert [wrong_models.held(entry) for entry in lines] == [True, False, False, False]
    assert wrong_models.table(lines).strip().endswith("1 of 3.")


@pytest.mark.parametrize("machine", wrong_models.MACHINES)
def test_every_wrong_machine_moves_and_is_no_other(machine, monkeypatch):
    monkeypatch.setattr(wrong_models, "DURATION", 2.5)
    signals, truth = wrong_models.recorded(machine, 0)
    right, _ = wrong_models.recorded("nothing", 0)
    assert truth.shape[1] == 8 and np.isfinite(truth).all() and np.ptp(truth[:, 0]) > 0.05
    same = all(np.array_equal(signals.sensors[n][1], right.sensors[n][1]) for n in signals.sensors)
    assert same == (machine == "nothing")


def test_unknown_names_are_refused():
    with pytest.raises(CraneError, match="input set 7"):
        paper.real_system(CRANE, 7, FAST, 0)
    with pytest.raises(CraneError, match="tuning"):
        paper.run_case(0.15, 1, FAST, 0, tuning="mine", duration=0.1)


def test_metrics():
    truth = np.array([[0.0, 1.0], [4.0, 1.0]])
    estimate = truth + np.array([[0.3, 0.1], [-0.3, 0.1]])
    np.testing.assert_allclose(pn_rmse(estimate, truth)[0], 100 * 0.3 / 4.0)
    assert np.isnan(pn_rmse(estimate, truth)[1])
    assert r2(estimate, truth)[0] == pytest.approx(1 - 0.18 / 8.0)


# -- Monte Carlo ---------------------------------------------------------------------------------------------------

SHORT = montecarlo.Settings(duration=1.6, step=8e-3, inputs=2)


def test_perfect_model_is_consistent_and_a_wrong_one_is_not():
    assert montecarlo.run_series(SHORT, 24).consistent
    wrong = montecarlo.Settings(**{**SHORT.__dict__, "model_error": 0.25})
    series = montecarlo.run_series(wrong, 6)
    assert not series.consistent and series.nees[-1] > series.nees_bounds[1]


@pytest.mark.parametrize("crane", ["loader", "excavator", "swinging"])
def test_any_machine_can_be_shaken(crane):
    chosen = CRANE.with_effect("payload_swing", {"length": 1.0}) if crane == "swinging" else Crane.load(crane)
    series = montecarlo.run_series(montecarlo.Settings(duration=0.4, step=8e-3), 2, crane=chosen)
    told = series.document()
    assert told["nees_expected"] == len(told["coverage95"]) == {"loader": 4, "excavator": 12, "swinging": 10}[crane]
    assert series.nees_bounds[0] < told["nees_expected"] < series.nees_bounds[1]
    json.dumps(told, allow_nan=False)


@pytest.mark.parametrize("crane", [Crane.load("excavator"), CRANE.with_effect("payload_swing", {"length": 1.0})])
def test_the_experiment_is_refused_on_another_machine(crane):
    for ask in (
        lambda: paper.run_case(crane=crane, duration=0.1),
        lambda: paper.reproduce(crane=crane),
        lambda: montecarlo.run_series(montecarlo.Settings(model_error=0.1, duration=0.1), 1, crane=crane),
    ):
        with pytest.raises(CraneError, match="experiment is that of a PATU 655"):
            ask()


def test_series_is_the_same_by_processes_and_goes_on_where_it_stopped(tmp_path):
    file = tmp_path / "runs.jsonl"
    whole = montecarlo.run_series(SHORT, 4)
    montecarlo.run_series(SHORT, 2, file=file)
    with file.open("a") as stream:
        stream.write('{"run": 2, "nees": [1.0')  # killed while it wrote
    before = file.read_text().splitlines()[:3]
    seen: list[float] = []
    again = montecarlo.run_series(SHORT, 4, jobs=2, file=file, progress=seen.append)
    assert [r["nees"] for r in again.runs] == [r["nees"] for r in whole.runs]
    assert seen == [0.75, 1.0]  # only the two missing runs were made
    lines = file.read_text().splitlines()
    assert lines[:3] == before and len(lines) == 5 and all(json.loads(line) for line in lines)


def test_file_of_another_series_is_refused(tmp_path):
    file = tmp_path / "runs.jsonl"
    montecarlo.finished(file, SHORT, CRANE)
    with pytest.raises(CraneError, match="another series"):
        montecarlo.finished(file, montecarlo.Settings(seed=9), CRANE)
    with pytest.raises(CraneError, match="does not exist"):
        montecarlo.finished(tmp_path / "no" / "runs.jsonl", SHORT, CRANE)


def test_missing_dask_is_told(monkeypatch):
    import sys

    monkeypatch.setitem(sys.modules, "dask.distributed", None)
    with pytest.raises(CraneError, match="cluster"), workers.scheduled("tcp://nowhere:1"):
        pass
