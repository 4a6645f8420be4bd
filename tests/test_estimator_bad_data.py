"""The filter under bad data: wrong first samples, sensors that leap for good, clocks and calls that cannot be right."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.recording import Recording
from ukf.estimator import Estimator
from ukf.monitor import USED
from ukf.noise import ProcessNoise
from ukf.signals import Signals
from ukf.tuning import cut

CRANE = Crane.load("patu655")
STD = {"z1": 9e-4, "z4": 9e-4, "p1": 3e4, "p2": 3e4, "p3": 3e4, "p4": 3e4}
SOUND = Signals.of(Recording.load(Path(__file__).parent / "data" / "open_none_learn.csv.gz"), CRANE)
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


def test_a_sensor_that_leaps_early_and_for_good_is_not_taken_for_the_start():
    """The other sensors side with what it showed before."""
    estimate = estimator().run(spoilt(3.0, p4=(slice(60, None), 50e5, True)))
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
    assert rejected < 120 and not now.rejected
    believed = [e for e in running.events if "believed again" in e[2]]
    assert [e[1] for e in believed] == [name]
    assert abs(now[name] - SOUND.sensors[name][1][199]) < 5 * STD[name]


def test_a_sensor_that_leaps_for_good_is_heard_and_not_believed():
    running, now, rejected = live(500, {"z4": (slice(100, None), 0.3, True)})
    assert now.rejected == ("z4",) and rejected == 400
    assert not [e for e in running.events if "believed again" in e[2]]


def test_the_only_sensor_is_believed_again():
    """With no other sensor to contradict it, a filter that stays alone with its opinion gives it up."""
    running, now, rejected = live(450, {"z1": (slice(100, None), 0.3, True)}, {"z1": STD["z1"]})
    assert not now.rejected and 200 < rejected < 340
    assert "believed again" in running.events[-1][2]
