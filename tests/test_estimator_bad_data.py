"""The filter under bad data: wrong first samples, sensors that leap for good, clocks and calls that cannot be right."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.drive import spool_on
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import simulate
from patu.estimate import sensor_noise, verdict
from patu.main import run as command_line
from ukf.estimator import Estimator
from ukf.monitor import OUTLIER, USED
from ukf.noise import ProcessNoise
from ukf.signals import Signals
from ukf.tuning import cut
from ukf.visible import show
from validation.semi_recursive import SemiRecursiveEngine

CRANE = Crane.load("patu655")
STD = {"z1": 9e-4, "z4": 9e-4, "p1": 3e4, "p2": 3e4, "p3": 3e4, "p4": 3e4}
SOUND = Signals.of(Recording.load(Path(__file__).parent / "data" / "open_none_learn.csv.gz"), CRANE)
FOUR = {n: STD[n] for n in ("z1", "z4", "p1", "p4")}
QUIET = ProcessNoise((1e-6, 1e-6), (1e6,) * 4)


def estimator(sensors=STD, **options):
    return Estimator(CRANE, "semi-recursive", sensors, QUIET, max_step=5e-3, **options)


def spoilt(seconds, begin=0.0, **changes):
    """The sound recording's first seconds with samples changed: channel=(slice, values, whether they are added)."""
    part = cut(SOUND, begin, seconds)
    sensors = {n: (t, y.copy()) for n, (t, y) in part.sensors.items()}
    for name, (where, value, added) in changes.items():
        values = sensors[name][1]
        values[where] = value + (values[where] if added else 0.0)
    return Signals(part.command_time, part.commands, sensors)


@pytest.mark.parametrize(
    ("changes", "left_out"),
    [
        ({"z4": (slice(3), 0.0, False)}, 3),
        ({"z1": (slice(20), 0.5, True)}, 20),
        ({"p1": (slice(60), 0.0, False)}, 60),
        (dict.fromkeys(STD, (slice(3), 0.0, False)), 3),
    ],
)
def test_a_start_is_agreed_upon_by_all_first_samples(changes, left_out):
    """Wrong first samples are left out and told; what follows is as if they had never been there."""
    sound, estimate = estimator().run(spoilt(2.0)), estimator().run(spoilt(2.0, **changes))
    assert {e.where for e in estimate.events} == set(changes) and all("left out" in e.text for e in estimate.events)
    for name in changes:
        column = list(STD).index(name)
        assert (estimate.flags[1:, column] == USED).sum() == sound.time.size - left_out
    late = sound.time > 0.5
    assert (np.abs(estimate.mean - sound.mean)[late] < 0.5 * sound.std[late]).all()
    assert estimate.nis_mean == pytest.approx(sound.nis_mean, rel=0.05)


def test_a_sensor_that_starts_late_does_not_set_the_start():
    """Where it stands two seconds on is not where it stood."""
    part = spoilt(3.0, begin=2.0)
    time, z1 = part.sensors["z1"]
    late = replace(part, sensors=part.sensors | {"z1": (time[400:], z1[400:])})
    estimate = estimator().run(late)
    off = np.abs(estimate["z1"][:400] - z1[:400])
    assert abs(z1[400] - z1[0]) > 0.15 and estimate.std[0, 0] > 0.05
    assert np.mean(off < 1.96 * estimate.std[:400, 0]) > 0.9
    assert not estimate.events and abs(estimate["z1"][-1] - z1[-1]) < 5 * STD["z1"]


def test_a_sensor_that_leaps_early_and_for_good_is_not_taken_for_the_start():
    """The other sensors side with what it showed before. What is rejected makes no run more likely."""
    sound, estimate = estimator().run(spoilt(3.0)), estimator().run(spoilt(3.0, p4=(slice(60, None), 50e5, True)))
    rejected = (estimate.flags[1:] == OUTLIER).sum()
    assert estimate.log_likelihood == pytest.approx(sound.log_likelihood - 0.5 * 6.0**2 * rejected, abs=2.0 * rejected)
    column = list(STD).index("p4")
    assert (estimate.flags[1:60, column] == USED).all() and not (estimate.flags[60:, column] == USED).any()
    assert [e.where for e in estimate.events] == ["p4"]


def live(samples, changes, sensors=STD, begin=0.0):
    """The estimator after so many live samples of the recording, some spoilt, and how often it rejected something."""
    part = spoilt(1.0 + samples * 5e-3, begin, **changes)
    time = part.sensors["z1"][0]
    commands = np.column_stack([np.interp(time, part.command_time, u) for u in part.commands.T])
    running, rejected = estimator(sensors), 0
    for k in range(samples):
        now = running.step(commands[k], {n: part.sensors[n][1][k] for n in sensors}, time[k])
        rejected += bool(now.rejected)
    return running, now, rejected


@pytest.mark.parametrize("name", ["z1", "z4"])
def test_one_wrong_first_sample_does_not_lock_a_live_filter(name):
    running, now, rejected = live(200, {name: (slice(1), 0.6, True)})
    assert rejected == 3 and not now.rejected
    believed = [e for e in running.events if "accepted again" in e[2]]
    assert [e[1] for e in believed] == [name]
    assert abs(now[name] - SOUND.sensors[name][1][199]) < 5 * STD[name]


def test_a_state_that_no_sensor_fits_is_given_up():
    """Without p2 a void in it is not seen; the sensors of the other chambers speak against it, but none of them
    leaps.
    """
    running, _, _ = live(20, {}, FOUR)
    lost = running.belief.mean.copy()
    lost[[4, 5]] -= (7e5, 200e5)
    running.belief = replace(running.belief, mean=lost)
    for k in range(20, 120):
        sample = {n: SOUND.sensors[n][1][k] for n in FOUR}
        now = running.step((0.0, 0.0), sample, running.time + 5e-3)
        if k == 20:
            assert now["p2"] >= 0.0 and running.belief.mean[5] < 0.0
    assert [e[1] for e in running.events] == ["state"] and "replaced" in running.events[0][2]
    assert running.belief.mean[5] > 0.0 and abs(now["p1"] - sample["p1"]) < 5e5


def test_pressures_are_told_as_gauges_would_show_them():
    """Means and variances of max(p, floor) against a million draws; far above the floor nothing is touched."""
    mean = np.r_[np.zeros(4), -90e5, -1e5, 1e5, 60e5]
    std = np.r_[np.ones(4), 2e5, 2e5, 2e5, 2e5]
    drawn = np.maximum(mean[4:] + std[4:] * np.random.default_rng(0).standard_normal((1_000_000, 4)), 0.0)
    shown, variance = mean.copy(), std**2
    show(shown, variance, CRANE.layout.pressures, 0.0)
    assert shown[4:] == pytest.approx(drawn.mean(axis=0), abs=1e3)
    assert np.sqrt(variance[4:]) == pytest.approx(drawn.std(axis=0), abs=1e3)
    assert (shown[[0, 1, 2, 3, 7]] == mean[[0, 1, 2, 3, 7]]).all() and variance[7] == std[7] ** 2


@pytest.mark.parametrize("call", [((True, 0.0), {}), ((0.0, 0.0), {"z1": True}), ((0.0, 0.0), {"z1": np.bool_(True)})])
def test_a_truth_value_is_no_number(call):
    running = estimator()
    with pytest.raises(CraneError, match="True"):
        running.step(call[0], SAMPLE | call[1], 0.0)


def test_a_sensor_that_leaps_for_good_is_heard_and_not_believed():
    running, now, rejected = live(500, {"z4": (slice(100, None), 0.3, True)})
    assert now.rejected == ("z4",) and rejected == 400
    assert not [e for e in running.events if "accepted again" in e[2]]


def test_the_only_sensor_is_believed_again():
    """With no other sensor to contradict it, a filter that stays alone with its opinion gives it up."""
    running, now, rejected = live(450, {"z1": (slice(100, None), 0.3, True)}, {"z1": STD["z1"]})
    assert not now.rejected and 200 < rejected < 340
    assert "accepted again" in running.events[-1][2]


SAMPLE = {"z1": 0.2, "z4": -0.75, "p1": 50e5, "p2": 20e5, "p3": 20e5, "p4": 38e5}


@pytest.mark.parametrize("stamp", [float("nan"), float("inf"), "soon", (0.0, 1.0)])
def test_a_first_time_that_is_none_is_refused_and_forgotten(stamp):
    running = estimator()
    with pytest.raises(CraneError, match="time"):
        running.step((0.0, 0.0), SAMPLE, stamp)
    assert running.step((0.0, 0.0), SAMPLE, 0.0).time == 0.0


@pytest.mark.parametrize("stamp", [float("nan"), float("inf"), -float("inf")])
def test_a_later_time_that_is_none_is_left_out_and_told(stamp):
    running = estimator()
    running.step((0.0, 0.0), SAMPLE, 0.0)
    running.step((0.0, 0.0), SAMPLE, stamp)
    assert [e[1] for e in running.events] == ["time"]
    assert running.step((0.0, 0.0), SAMPLE, 0.01).time == 0.01


def test_a_long_pause_is_not_predicted_through():
    """Ten minutes would be 120,000 steps; the estimator goes on from what the sensors show, and keeps what it found
    out.
    """
    engine = SemiRecursiveEngine(CRANE)
    running = Estimator(CRANE, engine, STD, QUIET, max_step=5e-3, augment=("payload.mass",))
    running.step((0.0, 0.0), SAMPLE, 0.0)
    mass = running.step((0.0, 0.0), SAMPLE, 0.01)["payload.mass"]
    engine.propagate = None  # not asked again
    now = running.step((0.0, 0.0), SAMPLE | {"z1": 0.5}, 600.0)
    assert now.time == 600.0 and now["z1"] == pytest.approx(0.5) and now["payload.mass"] == mass
    assert [e[1] for e in running.events] == ["time"] and "600 s" in running.events[0][2]


def test_a_clock_that_went_ahead_for_one_sample_does_not_end_the_estimate():
    running = estimator()
    for stamp in (0.0, 0.005, 1e9):
        running.step((0.0, 0.0), SAMPLE, stamp)
    for k in range(30):
        now = running.step((0.0, 0.0), SAMPLE, 0.01 + 0.005 * k)
    assert now.time == pytest.approx(0.155) and now.innovation


def test_a_recording_with_a_long_gap_is_not_predicted_through_it():
    part, later = spoilt(1.0), spoilt(1.0)
    sensors = {n: (np.append(t, t + 3600.0), np.append(y, y)) for n, (t, y) in part.sensors.items()}
    time = np.append(part.command_time, later.command_time + 3600.0)
    estimate = estimator().run(Signals(time, np.vstack([part.commands, later.commands]), sensors))
    assert [e.where for e in estimate.events] == ["time"] and estimate.inputs.shape[0] == estimate.time.size
    assert (estimate.flags == USED).sum() == 6 * (estimate.time.size - 2)
    assert np.abs(estimate["z1"][-1] - part.sensors["z1"][1][-1]) < 5 * STD["z1"]


def test_sensors_that_all_freeze_are_told_and_not_believed():
    """Over three seconds in which the crane moves; noise forbids that all repeat one value."""
    frozen = {n: (slice(100, 500), SOUND.sensors[n][1][500], False) for n in STD}
    running, now, _ = live(480, frozen, begin=2.0)
    assert set(now.rejected) == set(STD)
    assert {e[1] for e in running.events if "frozen" in e[2]} == set(STD)


@pytest.mark.parametrize(
    ("commands", "measurements", "words"),
    [
        (0.5, SAMPLE, "commands: found 0.5"),
        ((0.5,), SAMPLE, "commands"),
        ((0.1, 0.2, 0.3), SAMPLE, "2 numbers"),
        (("left", 0.0), SAMPLE, "commands"),
        ({"u1": 0.0, "u3": 0.0}, SAMPLE, "u3"),
        ((1.5, 0.0), {"nope": 1.0}, "'nope' is no sensor"),
        ((0.0, 0.0), {"z1": [0.1, 0.2]}, "measurements: z1"),
        ((0.0, 0.0), {"z1": "0.1"}, "measurements: z1"),
        ((0.0, 0.0), [0.1, 0.2], "mapping"),
    ],
)
def test_calls_of_a_wrong_shape_are_refused_by_name_and_change_nothing(commands, measurements, words):
    running = estimator()
    running.step((0.0, 0.0), SAMPLE, 0.0)
    mean = running.belief.mean
    with pytest.raises(CraneError, match=words):
        running.step(commands, measurements, 0.01)
    assert running.time == 0.0 and running.belief.mean is mean and not running.events


def test_what_is_odd_about_samples_is_told_when_it_begins():
    running = estimator()
    for k, command in enumerate((0.0, 1.0001, 1.0001, 1.0001, 0.0, 1.0001)):
        running.step((command, 0.0), SAMPLE | {"p2": 1e9}, 0.005 * k)
    with pytest.raises(CraneError, match="time"):
        running.step((2.0, math.nan), SAMPLE, "soon")
    assert [(t, where) for t, where, _ in running.events] == [(0.0, "p2"), (0.005, "commands"), (0.025, "commands")]


def test_a_clock_that_goes_back_is_told_so():
    running = estimator()
    for k in range(12):
        running.step((0.0, 0.0), SAMPLE, 1.5 if k == 0 else 0.005 * k)
    assert [text.partition(":")[0] for _, _, text in running.events] == [
        "time stamp not later than the last one", "clock went back by 1.45 s",
    ]  # fmt: skip


def test_a_supply_pressure_that_is_missing_stays_as_it_was():
    means = []
    for supplies in ([60e5] * 4, [60e5, None, math.nan, 60e5], [None] * 4):
        running = estimator(FOUR)
        for k, pp in enumerate(supplies):
            now = running.step((0.8, 0.0), {n: SAMPLE[n] for n in FOUR} | {"pp": pp}, 0.02 * k)
        means.append(now.mean)
    np.testing.assert_array_equal(means[0], means[1])
    assert abs(means[2] - means[0])[4] > 1e4


@pytest.mark.parametrize(("name", "value"), [("z1", float("inf")), ("z1", -1e3), ("p1", 1e308), ("p4", -1e9)])
def test_readings_that_no_crane_shows_are_missing_ones(name, value):
    running = estimator()
    running.step((0.0, 0.0), SAMPLE, 0.0)
    now = running.step((0.0, 0.0), SAMPLE | {name: value}, 0.01)
    assert name not in now.innovation and np.isfinite(now.mean).all()
    assert [e[1] for e in running.events] == [name] and f"{value:g}, treated as missing" in running.events[0][2]
    estimate = estimator().run(spoilt(0.5, **{name: (slice(10, 12), value, False)}))
    assert [(e.where, e.count) for e in estimate.events] == [(name, 1)] and "2 such samples" in estimate.events[0].text
    assert not np.isfinite(estimate.innovation[10:12, list(STD).index(name)]).any()


@pytest.mark.parametrize(
    "options",
    [
        {"max_step": 0.0}, {"max_step": float("nan")}, {"max_step": None}, {"gate": -1.0}, {"gate": "6"},
        {"pressure_std": -1.0}, {"pressure_std": float("nan")}, {"pressure_std": float("inf")},
        {"adapt": -1.0}, {"adapt": float("nan")},
    ],
)  # fmt: skip
def test_options_that_cannot_work_are_refused(options):
    with pytest.raises(CraneError, match=next(iter(options))):
        Estimator(CRANE, "semi-recursive", STD, **options)


def test_live_samples_may_follow_a_recording():
    running = estimator(FOUR)
    estimate = running.run(spoilt(0.3))
    now = running.step((0.0, 0.0), {n: float(estimate[n][-1]) for n in FOUR}, estimate.time[-1] + 0.01)
    assert now.time > estimate.time[-1] and now["z1"] == pytest.approx(estimate["z1"][-1], abs=1e-2)


def test_a_simulation_of_the_model_is_explained_by_it():
    """Free of noise and with channels that follow from each other; the same with another payload is not explained."""
    for crane, explained in (
        (CRANE, True),
        (CRANE.with_parameters({"payload.mass": CRANE["payload.mass"] + 20.0}), False),
    ):
        commands = spoilt(3.0, begin=2.0)
        given = Recording.from_arrays(
            "c", commands.command_time[::2], dict(zip(("u1", "u2"), commands.commands[::2].T, strict=True))
        )
        run = simulate(crane, given, engine=SemiRecursiveEngine(crane)).recording()
        std = sensor_noise(CRANE, run, None)
        estimate = Estimator(CRANE, "semi-recursive", std, QUIET).run(run)
        assert len(std) == 12 and estimate.noiseless == estimate.consistent == explained, repr(estimate)
        assert explained == ("no noise" in verdict(estimate)) and not [e for e in estimate.events if "frozen" in e.text]


def test_the_working_cycle_is_read_back_with_the_steps_that_were_simulated():
    """The spool positions of a run are those that its own commands give when it is read as a recording."""
    run = simulate(CRANE, engine=Still(CRANE))
    time, commands = run.recording().commands()
    np.testing.assert_allclose(spool_on(CRANE, run.time, time, commands), run.inputs[:, :2], atol=1e-12)


class Still(SemiRecursiveEngine):
    """An engine that stays where it is."""

    def simulate(self, x0, time, inputs, *, step=1e-3):
        return np.tile(x0, (len(time), 1))


@pytest.mark.parametrize("samples", [2, 30])
def test_a_few_samples_are_not_called_consistent(samples):
    estimate = estimator().run(spoilt(5e-3 * (samples - 1)))
    assert estimate.time.size == samples and min(estimate.nis_bounds) >= 0.0
    assert not estimate.consistent and "too few samples" in estimate.verdict
    assert "too few samples" in verdict(replace(estimate, noise_slack=2.0))


def test_a_filter_that_fails_at_every_step_says_so_and_is_no_answer(monkeypatch, tmp_path, capsys):
    def fails(*args, **options):
        raise CraneError("the step did not converge")

    monkeypatch.setattr(SemiRecursiveEngine, "propagate", fails)
    rows = np.column_stack([0.01 * np.arange(60), np.zeros((60, 2)), np.tile([0.2, -0.75], (60, 1))])
    file = tmp_path / "short.csv"
    np.savetxt(file, rows, delimiter=",", header="time[s],u1[-],u2[-],z1[rad],z4[rad]", comments="")
    with pytest.raises(SystemExit) as leaving:
        command_line(["estimate", str(file), "--engine", "semi-recursive"])
    said = capsys.readouterr().out
    assert leaving.value.code == 1 and "restarted at 59 of 59 steps" in said and "did not converge" in said
