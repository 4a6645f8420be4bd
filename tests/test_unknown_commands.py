"""Commands that were not recorded for a while, clocks that leap, and pauses: held, marked, left out, split, and
said.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.drive import spool_on
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import initial_state
from crane_exudyn.statics import visible
from validation.comparison import compare
from validation.fit.data import FitData
from validation.fit.staged import run_fitted
from validation.fit.windows import cut, follows
from validation.selection.model import open_loop_error
from validation.semi_recursive import SemiRecursiveEngine

STD = {"z1": 1e-3, "z4": 1e-3, "p1": 1e5, "p2": 1e5, "p3": 1e5, "p4": 1e5}


def moved(hole: tuple[float, float] | None = None) -> Recording:
    """Return 4 s in which the lift cylinder extends from 1 s to 2 s and retracts from 2.5 s to 3 s; u1 is empty within
    the hole.
    """
    crane = Crane.load("patu655")
    engine = SemiRecursiveEngine(crane)
    time = np.arange(0.0, 4.0, 1e-3)
    u1 = np.where((time >= 1.0) & (time < 2.0), 0.4, 0.0) - np.where((time >= 2.5) & (time < 3.0), 0.3, 0.0)
    spool = spool_on(crane, time, time, np.column_stack([u1, 0.0 * time]))
    states = engine.simulate(
        initial_state(crane, engine), time, np.column_stack([spool, np.full((time.size, 2), np.nan)])
    )
    states, rng = visible(crane, states), np.random.default_rng(5)
    shown = {n: states[::5, engine.state_names.index(n)] for n in STD}
    values = {n: y + STD[n] * rng.standard_normal(y.size) for n, y in shown.items()}
    time, u1 = time[::5], u1[::5].copy()
    if hole:
        u1[(time > hole[0]) & (time < hole[1])] = np.nan
    return Recording.from_arrays("moved", time, values | {"u1": u1, "u2": 0.0 * time})


@pytest.fixture(scope="module")
def holed() -> Recording:
    """Return the recording without u1 from 1.8 s to 2.3 s, where the command returns to zero."""
    return moved((1.8, 2.3))


def test_a_gap_in_a_command_is_held_marked_and_told(holed: Recording) -> None:
    time, commands = holed.commands()
    assert np.all(commands[(time > 1.8) & (time < 2.299), 0] == 0.4)
    np.testing.assert_allclose(holed.unknown_commands()["u1"], [[1.8, 2.3]])
    assert any("command u1 is missing in 1 span (1.8 … 2.3 s)" in note for note in holed.notes)
    assert moved().notes == () and moved().unknown_commands() == {}


def test_every_other_row_empty_is_a_slower_clock_and_no_gap() -> None:
    time = np.arange(100) * 0.005
    slow = np.where(np.arange(100) % 2 == 0, 0.1, np.nan)
    recording = Recording.from_arrays("two rates", time, {"u1": slow, "u2": 0.0 * time, "z1": time})
    assert recording.unknown_commands() == {}


def test_commands_that_end_before_the_sensors_are_unknown_from_there_on() -> None:
    time = np.arange(400) * 0.005
    late = np.where(time < 1.5, 0.0, np.nan)
    recording = Recording.from_arrays("late", time, {"u1": late, "u2": 0.0 * time, "z1": time})
    np.testing.assert_allclose(recording.unknown_commands()["u1"], [[1.495, 1.995]])


def test_no_sample_and_no_window_of_a_fit_lies_where_a_command_is_unknown(holed: Recording) -> None:
    data = FitData.of(holed, Crane.load("patu655"))
    np.testing.assert_allclose(data.blind, [(1.8, 2.55)])
    for s in data.samples:
        times = data.time[s.index] + s.fraction * data.step
        assert not np.any((times > 1.8) & (times < 2.55))
    windows = cut(data, 0.25)
    joined = [follows(a, b) for a, b in pairwise(windows)]
    assert joined.count(False) == 1
    assert not any(1.81 < w.data.time[0] < 2.54 for w in windows)


def test_a_right_model_explains_what_is_left(holed: Recording) -> None:
    crane = Crane.load("patu655")
    error, fit = open_loop_error(crane, holed)
    assert error < 1.05
    assert fit.starts.shape == (2, 8)
    assert run_fitted(crane, FitData.of(holed, crane)).error < 1.05


def test_a_comparison_begins_anew_after_it(holed: Recording) -> None:
    result = compare("patu655", holed)
    assert result.error < 1.05 and result.consistent
    assert not [f for f in result.where if f.kind == "equation"]
    assert not any(p.start < 1.79 and p.end > 2.6 for p in result.phases)
    assert any("u1 is missing" in note for note in result.notes)


def test_commands_that_are_known_nowhere_long_enough_are_refused(holed: Recording) -> None:
    channel = holed["u1"]
    few = replace(channel, time=channel.time[:40], values=channel.values[:40])
    with pytest.raises(CraneError, match="nowhere are the commands known"):
        FitData.of(Recording("few", {**holed.channels, "u1": few}), Crane.load("patu655"))


# -- clocks ----------------------------------------------------------------------------------------------------------


def test_a_clock_that_leaps_is_refused_with_its_line(tmp_path: Path) -> None:
    file = tmp_path / "leap.csv"
    rows = [f"{t + (1e9 if k > 50 else 0.0):.3f},0,0,{t}" for k, t in enumerate(np.arange(100) * 0.01)]
    file.write_text("\n".join(["time[s],u1,u2,z1[deg]", *rows]), encoding="utf-8")
    with pytest.raises(CraneError, match=r"leap.csv, line 53, column time\[s\].*leaps from 0.5 s to 1e\+09 s"):
        Recording.load(file)


def test_a_long_pause_splits_a_recording_and_that_is_said() -> None:
    time = np.concatenate([np.arange(200) * 0.01, 3600.0 + np.arange(300) * 0.01])
    recording = Recording.from_arrays("paused", time, {"u1": 0.0 * time, "u2": 0.0 * time, "z1": 1e-3 * time})
    assert (recording.start, recording.end) == (3600.0, pytest.approx(3602.99))
    assert any("split the recording into 2 stretches" in note and "0 … 1.99 s" in note for note in recording.notes)


def test_commands_written_by_hand_are_no_pauses() -> None:
    time = np.array([0.0, 2.0, 2.001, 30.0, 30.001, 60.0])
    recording = Recording.from_arrays("by hand", time, {"u1": 0.0 * time, "u2": 0.0 * time})
    assert recording.end == 60.0 and recording.notes == ()


# -- sensors ---------------------------------------------------------------------------------------------------------


def test_gaps_of_sensors_are_told_with_channel_from_and_to() -> None:
    time = np.arange(400) * 0.01
    columns = {name: 0.0 * time for name in ("u1", "u2", "z1", "z4", "p1")}
    for name in ("z1", "p1"):
        columns[name] = np.where((time > 1.0) & (time < 2.0), np.nan, 0.1)
    columns["z4"] = np.where(time < 3.0, 0.1, np.nan)
    recording = Recording.from_arrays("gaps", time, columns)
    assert recording.notes == (
        "z1, p1 have no sample in 1 span (1 … 2 s), while others have",
        "z4 has no sample in 1 span (2.99 … 3.99 s), while others have",
    )
    np.testing.assert_allclose(recording.unread()["p1"], [[1.0, 2.0]])


def test_a_slow_sensor_beside_fast_ones_has_no_gap() -> None:
    time = np.arange(400) * 0.01
    slow = np.where(np.arange(400) % 20 == 0, 0.1, np.nan)
    recording = Recording.from_arrays("two rates", time, {"u1": 0.0 * time, "u2": 0.0 * time, "z1": slow})
    assert recording.unread() == {} and recording.notes == ()
