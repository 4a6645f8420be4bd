"""Recordings: what is read, in which unit and on which clock, and how a bad file is refused."""

from __future__ import annotations

import gzip
import math
import random
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from crane_exudyn import tables
from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.signals import noise_between, noise_std, noise_uncertainty, of_mean, shared_part, shown_of

GOOD = "time[s],u1,u2[-],z1[deg],p1[bar]\n0.000,0,0,10,38.5\n0.005,0.5,0,10.5,39\n0.010,0.5,0,11,40\n"


def read(folder: Path, text: str | bytes, name: str = "lift.csv", **mapping: str) -> Recording:
    file = folder / name
    file.write_bytes(text.encode() if isinstance(text, str) else text)
    return Recording.load(file, mapping=mapping)


def refusal(folder: Path, text: str | bytes, name: str = "lift.csv", **mapping: str) -> str:
    """Return the message with which a file is refused: one line, with the file in it."""
    with pytest.raises(CraneError) as caught:
        read(folder, text, name, **mapping)
    message = str(caught.value)
    assert "\n" not in message
    assert "--map" in message or name in message
    return message


def test_units_become_si_and_names_are_kept(tmp_path: Path) -> None:
    recording = read(tmp_path, GOOD)
    assert tuple(recording.channels) == ("u1", "u2", "z1", "p1")
    np.testing.assert_allclose(recording["z1"].values, np.radians([10, 10.5, 11]), rtol=1e-15)
    np.testing.assert_allclose(recording["p1"].values, [38.5e5, 39e5, 40e5], rtol=1e-15)
    assert recording.sensors == ("z1", "p1")
    assert recording.name == "lift"
    assert recording.sampling_rate == pytest.approx(200.0)
    assert recording.notes == ()


@pytest.mark.parametrize(
    ("header", "factor"),
    [
        ("z1[deg]", math.pi / 180),
        ("z1[°]", math.pi / 180),
        ("z1[mrad]", 1e-3),
        ("z1[arcmin]", math.pi / 180 / 60),
        ("dz1[rpm]", 2 * math.pi / 60),
        ("dz1[deg/s]", math.pi / 180),
        ("p1[MPa]", 1e6),
        ("p1[psi]", 6894.757293168361),
        ("p1[N/mm**2]", 1e6),
        ("s1[mm]", 1e-3),
        ("s1[inch]", 0.0254),
        ("u1[%]", 1e-2),
        ("U1[mV]", 1e-3),
    ],
)
def test_any_unit_of_the_right_dimension(tmp_path: Path, header: str, factor: float) -> None:
    recording = read(tmp_path, f"time[ms],{header}\n0,1\n5,2\n".encode())
    channel = recording[header.partition("[")[0]]
    np.testing.assert_allclose(channel.values, [factor, 2 * factor], rtol=1e-12)
    np.testing.assert_allclose(channel.time, [0.0, 0.005], rtol=1e-15)


@pytest.mark.parametrize("bad", ["p1[deg]", "z1[bar]", "z1[%]", "dz1[Hz]", "u1[bar]", "U1[-]", "s1[s]", "p1[degC]"])
def test_wrong_dimension_names_found_and_expected_unit(tmp_path: Path, bad: str) -> None:
    message = refusal(tmp_path, f"time[s],{bad}\n0,1\n1,2\n")
    unit = bad.partition("[")[2].rstrip("]")
    assert f"column {bad}" in message and f"[{unit}]" in message and "expected" in message and "Correct" in message


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("", ["empty"]),
        ("\n\n", ["empty"]),
        ("# a logger's comment\n", ["no header line"]),
        ("time[s],z1[deg]\n", ["ends after its header"]),
        ("time[s],z1[deg]\n0,1\n", ["fewer than two samples"]),
        ("0,1\n1,2\n", ["line 1", "found numbers", "header"]),
        ("time[s] z1[deg]\n0 1\n", ["single column", "commas"]),
        ("time[s],z1\n0,1\n1,2\n", ["column z1", "no unit", "z1[deg]"]),
        ("time,z1[deg]\n0,1\n1,2\n", ["column time", "no unit", "time[s]"]),
        ("z1[deg],p1[bar]\n0,1\n1,2\n", ["no column time[s]", "--map time="]),
        ("time[s],boom[deg]\n0,1\n1,2\n", ["no known channel", "boom[deg]", "--map"]),
        ("time[s],z1[deg],z1[rad]\n0,1,1\n1,2,2\n", ["z1 occurs twice", "z1[deg]", "z1[rad]"]),
        ("time[s],z1[deg],z1[deg]\n0,1,1\n1,2,2\n", ["z1 occurs twice"]),
        ("time[s],z1[furlongz]\n0,1\n1,2\n", ["[furlongz] is not known"]),
        ("time[s],z1[deg]\n0,1\n0.1,abc\n", ["line 3", "column z1[deg]", "'abc'", "expected a number"]),
        ("time[s],z1[deg]\ns,deg\n0,1\n", ["line 2", "'s'", "units"]),
        ("time[s],z1[deg]\n0,1\n0.1,1_000\n", ["line 3", "'1_000'"]),
        ("time[s],z1[deg]\n0,1\n0.1,1 2\n", ["line 3", "'1 2'"]),
        ("time[s],z1[deg]\n0,1\n0.1,inf\n", ["line 3", "infinite"]),
        ("time[s],z1[deg]\n0,1\n0.2,2\n0.1,3\n", ["line 4", "goes back from 0.2 s", "0.1 s"]),
        ("time[s],z1[deg]\n0,1\n0.2,2\n0.2,3\n", ["line 4", "0.2 s is repeated"]),
        ("time[s],z1[deg]\n0,1\n,2\n0.2,3\n", ["line 3", "time is missing"]),
        ("time[s],z1[deg],p1[bar]\n0,1,2\n0.1,1,\n0.2,1\n", ["line 4", "2 fields, expected 3", "cut off"]),
        ("time[s],z1[deg],p1[bar]\n0,1,2\n0.1,1\n0.2,1,2\n", ["line 3", "2 fields, expected 3", "empty field"]),
        ("time[s],z1[deg]\n0,0,1,5\n0,1,1,6\n", ["line 2", "4 fields, expected 2", "semicolons"]),
        ("time[s],u1,u2\n0,0,0\n1,50,0\n", ["line 3", "column u1", "command 50", "-1 to 1", "u1[%]"]),
        (b"PK\x03\x04 something", ["Excel"]),
        (b"time[s],z1[deg]\n0,1\n\x00\x00\x00", ["zero bytes"]),
        (b"\x7fELF\x02\x01\n\x03,\x04\n", ["binary file", "Export it as CSV"]),
        (gzip.compress(GOOD.encode(), mtime=0)[:-12], ["gzip", "cut off"]),
    ],
)
def test_bad_files_are_refused_in_one_message(tmp_path: Path, text: str | bytes, parts: list[str]) -> None:
    message = refusal(tmp_path, text)
    for part in parts:
        assert part in message


def test_a_fault_is_found_at_its_line_below_comments_and_blank_lines(tmp_path: Path) -> None:
    text = "# logger 7\n# rig 2\ntime[s],z1[deg]\n0,1\n\n0.1,2\n0.05,3\n"
    assert "line 7" in refusal(tmp_path, text)
    assert "line 7" in refusal(tmp_path, text.replace("0.05,3", "0.2,x"))


def test_missing_file_and_folder(tmp_path: Path) -> None:
    with pytest.raises(CraneError, match="no such file"):
        Recording.load(tmp_path / "nowhere.csv")
    with pytest.raises(CraneError, match="is a folder"):
        Recording.load(tmp_path)


def test_missing_samples_are_dropped_per_channel(tmp_path: Path) -> None:
    recording = read(tmp_path, "time[s],z1[rad],p1[Pa]\n0,1,\n0.1,NaN,5\n0.2,3,nan\n0.3,,7\n")
    np.testing.assert_array_equal(recording["z1"].time, [0.0, 0.2])
    np.testing.assert_array_equal(recording["p1"].time, [0.1, 0.3])
    np.testing.assert_array_equal(recording["p1"].values, [5.0, 7.0])


def test_a_channel_without_any_sample_is_absent_and_noted(tmp_path: Path) -> None:
    recording = read(tmp_path, "time[s],z1[rad],p1[Pa]\n0,1,\n0.1,2,\n")
    assert not recording.has("p1")
    assert recording.notes == ("channel p1 has no sample",)


GERMAN = "time[s];z1[deg];p1[bar]\n0,000;10,25;-1,5e1\n0,005;;40,0\n"


@pytest.mark.parametrize(
    "data",
    [
        GERMAN.encode(),
        b"\xef\xbb\xbf" + GERMAN.encode(),
        GERMAN.encode("utf-16"),
        GERMAN.replace("deg", "°").encode("cp1252"),
        GERMAN.replace("deg", "°").encode("utf-8"),
        GERMAN.replace("\n", "\r\n").encode(),
        GERMAN.replace("\n", "\r").encode(),
        GERMAN.replace(";", "\t").encode(),
        GERMAN.replace(",", ".").encode(),
        GERMAN.replace(",", ".").replace(";", ",").encode(),
        GERMAN.replace(",", ".").replace(";", " , ").encode(),
        GERMAN.replace("\n", ";\n").encode(),
        GERMAN.rstrip("\n").encode(),
        '"time[s]","z1[deg]","p1[bar]"\n"0,000","10,25","-15"\n"0.005","","40"\n'.replace("0,000", "0")
        .replace(",25", ".25")
        .encode(),
        gzip.compress(GERMAN.encode(), mtime=0),
    ],
    ids=[
        "semicolons",
        "bom",
        "utf16",
        "cp1252",
        "degree-sign",
        "crlf",
        "cr",
        "tabs",
        "points",
        "commas",
        "spaces",
        "trailing",
        "no-last-newline",
        "quoted",
        "gzip",
    ],
)
def test_dialects_of_csv_read_the_same(tmp_path: Path, data: bytes) -> None:
    recording = read(tmp_path, data)
    np.testing.assert_allclose(recording["z1"].values, [math.radians(10.25)], rtol=1e-15)
    np.testing.assert_allclose(recording["p1"].values, [-15e5, 40e5], rtol=1e-15)
    np.testing.assert_allclose(recording["p1"].time, [0.0, 0.005], rtol=1e-15)


def test_columns_are_mapped_by_name_unit_or_both(tmp_path: Path) -> None:
    text = "Zeit,BoomAngle,Druck[bar]\n0,10,30\n0.1,11,31\n"
    recording = read(tmp_path, text, time="Zeit[s]", z1="BoomAngle[deg]", p1="Druck")
    np.testing.assert_allclose(recording["z1"].values, np.radians([10, 11]))
    np.testing.assert_allclose(recording["p1"].values, [30e5, 31e5])


def test_a_mapping_takes_the_place_of_a_column_of_that_name(tmp_path: Path) -> None:
    text = "time[s],z1[deg],z1_filtered[deg]\n0,10,30\n0.1,11,31\n"
    recording = read(tmp_path, text, z1="z1_filtered")
    np.testing.assert_allclose(recording["z1"].values, np.radians([30, 31]))
    assert "was replaced by column" in recording.notes[0]
    swapped = read(tmp_path, "time[s],p1[bar],p2[bar]\n0,1,2\n1,1,2\n", p1="p2", p2="p1")
    np.testing.assert_allclose(swapped["p1"].values, [2e5, 2e5])


@pytest.mark.parametrize(
    ("mapping", "parts"),
    [
        ({"z9": "BoomAngle[deg]"}, ["no channel 'z9'", "z1"]),
        ({"z1": "BomAngle[deg]"}, ["no column 'BomAngle'", "BoomAngle"]),
        ({"z1": "BoomAngle[rad]"}, ["says [deg]", "[rad]"]),
        ({"z1": "BoomAngle", "z4": "BoomAngle"}, ["two channels"]),
    ],
)
def test_bad_mappings(tmp_path: Path, mapping: dict[str, str], parts: list[str]) -> None:
    message = refusal(tmp_path, "time[s],BoomAngle[deg]\n0,10\n0.1,11\n", **mapping)
    for part in parts:
        assert part in message


@pytest.mark.parametrize(
    ("header", "told"),
    [
        ("P1[bar]", ", did you mean p1? Then give --map p1=P1[bar]"),
        ("z_4", ", did you mean z4? Then give --map z4=z_4[deg]"),
        ("Pressure 2[kPa]", ", did you mean p2? Then give --map 'p2=Pressure 2[kPa]'"),
        ("Tilt[deg]", ", it may be z4 or z4_abs: if it is z4, give --map z4=Tilt[deg]"),
        ("Z1[deg]", ""),  # z1 is there
        ("operator", ""),
    ],
)
def test_unknown_columns_are_ignored_with_a_note_and_what_reads_them(tmp_path: Path, header: str, told: str) -> None:
    text = f"time[s],{header},z1[deg]\n0,1,2\n1,1,2\n"
    recording = read(tmp_path, text)
    assert recording.notes == (f"column {header!r} was ignored{told}",)
    if told:
        channel, column = told.rpartition("--map ")[2].strip("'").split("=")
        assert channel in read(tmp_path, text, **{channel: column})


@pytest.mark.parametrize("unit", ["[-]", "[dimensionless]", "[1]", ""])
def test_pure_numbers_are_read_however_their_unit_is_written(tmp_path: Path, unit: str) -> None:
    assert list(read(tmp_path, f"time[s],u1{unit}\n0,0.5\n1,0.5\n")["u1"].values) == [0.5, 0.5]


def test_two_columns_of_one_channel_are_refused_with_the_choice_that_there_is(tmp_path: Path) -> None:
    text = "time[s],z1[deg],z1[{}]\n0,1,2\n1,1,2\n"
    assert refusal(tmp_path, text.format("deg")).endswith("Delete or rename one.")
    assert refusal(tmp_path, text.format("rad")).endswith("Delete or rename one, or choose, as with --map z1=z1[deg].")
    assert "was replaced by column" in read(tmp_path, text.format("rad"), z1="z1[deg]").notes[0]


def test_a_message_names_only_the_first_unused_columns(tmp_path: Path) -> None:
    others = [f"other{k}" for k in range(40)]
    text = f"time[s],z1[deg],{','.join(others)}\n" + "".join(f"{t},1{',7' * 40}\n" for t in range(3))
    with pytest.raises(CraneError, match=r"40 columns such as 'other0', 'other1', 'other2': each was ignored\.\)$"):
        read(tmp_path, text).require()


def test_requirements_of_an_estimate(tmp_path: Path) -> None:
    assert read(tmp_path, GOOD).require() is not None
    with pytest.raises(CraneError, match=r"lift.csv: u2 missing.*column of zeros"):
        read(tmp_path, "time[s],u1,z1[deg]\n0,0,1\n1,0,1\n").require()
    with pytest.raises(CraneError, match=r"U2 missing"):
        read(tmp_path, "time[s],U1[V],z1[deg]\n0,0,1\n1,0,1\n").require()
    with pytest.raises(CraneError, match=r"0 sensor channels.*--map z1="):
        read(tmp_path, "time[s],u1,u2\n0,0,0\n1,0,0\n").require()
    with pytest.raises(CraneError, match=r"no channel 'z4', only u1, u2, z1, p1"):
        read(tmp_path, GOOD)["z4"]


def test_commands_on_their_own_clocks_are_joined(tmp_path: Path) -> None:
    recording = read(tmp_path, "time[s],u1,u2\n0,0,0\n1,1,\n2,,1\n3,0,0\n")
    time, commands = recording.commands()
    np.testing.assert_array_equal(time, [0, 1, 2, 3])
    np.testing.assert_allclose(commands, [[0, 0], [1, 0.5], [0.5, 1], [0, 0]])


def test_voltages_become_commands_through_the_crane(tmp_path: Path) -> None:
    recording = read(tmp_path, "time[s],U1[V],U2[V],z1[deg]\n0,5.8,5.8,1\n1,5.0,5.8,2\n")
    with pytest.raises(CraneError, match=r"no calibration.*valves.lift.voltage"):
        recording.commands(Crane.load("patu655"))
    with pytest.raises(CraneError, match="contains valve voltages"):
        recording.commands()


def test_small_overshoot_of_a_command_is_clipped(tmp_path: Path) -> None:
    _, commands = read(tmp_path, "time[s],u1,u2\n0,1.02,0\n1,-1.04,0\n").commands()
    np.testing.assert_array_equal(commands[[0, -1], 0], [1.0, -1.0])  # between them stands the end of the step


def test_aligned_interpolates_nothing_and_joins_rounded_stamps() -> None:
    slow = Recording.from_arrays("slow", np.array([0.0, 0.1, 0.2]) + 1e-12, {"p1": np.array([1.0, 2.0, 3.0])})
    fast = Recording.from_arrays("fast", np.arange(5) * 0.05, {"z1": np.arange(5.0)})
    both = Recording("both", {**slow.channels, **fast.channels})
    time, values = both.aligned(("z1", "p1"))
    np.testing.assert_allclose(time, np.arange(5) * 0.05, atol=1e-11)
    np.testing.assert_array_equal(values[:, 0], np.arange(5.0))
    np.testing.assert_array_equal(values[:, 1], [1.0, np.nan, 2.0, np.nan, 3.0])


def test_supply_is_nan_where_it_was_not_measured() -> None:
    recording = Recording.from_arrays("r", np.array([0.0, 1.0]), {"pp": np.array([9e6, 10e6])})
    np.testing.assert_array_equal(recording.supply(np.array([0.5, 5.0])), [[9.5e6, np.nan], [10e6, np.nan]])


def test_window_and_select() -> None:
    time = np.linspace(0.0, 1.0, 11)
    recording = Recording.from_arrays("r", time, {"z1": time, "z4": np.where(time > 0.5, time, np.nan)})
    part = recording.window(0.15, 0.45)
    np.testing.assert_allclose(part["z1"].time, [0.2, 0.3, 0.4])
    assert not part.has("z4")
    assert tuple(recording.select(["z4"]).channels) == ("z4",)
    with pytest.raises(CraneError, match="goes from 0 s to 1 s"):
        recording.window(2.0, 3.0)


def test_channels_cannot_be_changed() -> None:
    recording = Recording.from_arrays("r", np.array([0.0, 1.0]), {"z1": np.array([0.0, 1.0])})
    with pytest.raises(ValueError, match="read-only"):
        recording["z1"].values[0] = 5.0
    with pytest.raises(TypeError):
        recording.channels["z1"] = recording["z1"]  # type: ignore[index]


def test_first_values_stop_at_the_first_command() -> None:
    time = np.arange(100) * 0.01
    command = np.where(time > 0.045, 0.5, 0.0)
    values = np.where(time > 0.045, 2.0, 1.0)
    recording = Recording.from_arrays("r", time, {"u1": command, "u2": 0 * time, "z1": values})
    assert recording.first_values(span=0.5) == {"z1": 1.0}


def test_a_sensor_that_is_first_read_later_has_no_first_value() -> None:
    time = np.arange(100) * 0.01
    slow = np.where(np.arange(100) % 20 == 10, 3.0, np.nan)  # first at 0.1 s, every 0.2 s
    values = {"z1": np.full(100, 1.0), "z4": np.where(time > 0.5, 2.0, np.nan), "p1": slow}
    assert Recording.from_arrays("r", time, values).first_values() == {"z1": 1.0, "p1": 3.0}


# -- noise: the estimate against signals whose noise is known ---------------------------------------------------------


@pytest.mark.parametrize("std", [1e-3, 1.0, 3e4])
def test_noise_under_motion_ringing_and_a_jump(std: float) -> None:
    rng = np.random.default_rng(11)
    time = np.arange(5000) / 200.0
    signal = 300 * std * np.sin(0.4 * time) + 40 * std * np.sin(2 * np.pi * 2.2 * time) * np.exp(-time / 3)
    signal += np.where(time > 12.0, 500 * std, 0.0)
    # 5000 samples: the estimate's own standard error is near 2 %, so 8 % is four of them
    assert noise_std(signal + rng.normal(0, std, time.size)) == pytest.approx(std, rel=0.08)


@pytest.mark.parametrize("count", [250, 1000])
def test_noise_is_uncertain_by_what_is_told_of_it(count: int) -> None:
    rng = np.random.default_rng(14)
    found = [noise_std(rng.standard_normal(count)) for _ in range(400)]
    # the spread of 400 estimates is itself known to 3.5 %: 15 % is four times that
    assert np.std(found) == pytest.approx(noise_uncertainty(rng.standard_normal(count)), rel=0.15)


@pytest.mark.parametrize("shared", [0.0, 0.3, 0.8])
def test_noise_that_neighbours_share_is_told_from_means(shared):
    noise = lfilter([np.sqrt(1.0 - shared**2)], [1.0, -shared], np.random.default_rng(4).standard_normal(100_000))
    shown, mean = noise_between(noise), noise.reshape(-1, 5).mean(axis=1).std()
    assert shown == pytest.approx(shown_of(shared), rel=0.02)
    assert mean == pytest.approx(of_mean(shared, 5), rel=0.02)
    assert shared_part(mean * np.sqrt(5.0) / shown, 5) == pytest.approx(shared, abs=0.02)


def test_noise_of_a_quantised_channel_is_not_below_rounding() -> None:
    rng = np.random.default_rng(12)
    slow = np.sin(np.arange(4000) / 800.0)
    step = 0.1
    assert noise_std(np.round(slow / step) * step) >= step / math.sqrt(12) * 0.999
    noisy = np.round((slow + rng.normal(0, step, slow.size)) / step) * step
    assert noise_std(noisy) == pytest.approx(step * math.sqrt(1 + 1 / 12), rel=0.08)


def test_noise_of_an_interpolated_channel_is_that_of_its_own_samples() -> None:
    rng = np.random.default_rng(13)
    coarse = np.arange(1000) * 0.01
    measured = np.sin(coarse) + rng.normal(0, 0.01, coarse.size)
    fine = np.arange(9991) * 0.001
    assert noise_std(np.interp(fine, coarse, measured)) == pytest.approx(0.01, rel=0.15)


def test_noise_of_a_constant_channel_is_zero() -> None:
    assert noise_std(np.full(100, 7.0)) == 0.0


# -- showing ---------------------------------------------------------------------------------------------------------


def test_only_what_no_sensor_shows_is_free_of_noise() -> None:
    time = np.arange(2000) * 0.005
    smooth = np.sin(np.clip(time - 2.0, 0.0, 5.0))
    noisy = smooth + 1e-4 * np.random.default_rng(1).standard_normal(2000)
    frozen = np.where((time > 4.0) & (time < 6.0), 0.5, noisy)
    channels = {"z1": smooth, "z4": noisy, "z4_abs": np.round(smooth, 4), "s1": frozen, "s2": 0.0 * time}
    recording = Recording.from_arrays("r", time, channels)
    assert recording.noise_free() == ("z1",)
    ring = 1e-7 * time**3 + np.where(time > 2.0, 0.3 * np.exp(1.0 - 0.5 * time) * np.sin(35.0 * time), 0.0)
    slow = {"z1": smooth[::4], "p1": 5e5 * (smooth + ring)[::4]}
    assert Recording.from_arrays("r", time[::4], {"p1": slow["p1"]}).noise_free() == ()
    assert Recording.from_arrays("r", time[::4], slow).noise_free() == ("z1", "p1")  # its ringing alone looks noisy
    given = recording.with_noise()
    assert given.noise()["z1"] == pytest.approx(2e-3 * np.ptp(smooth), rel=0.1)
    assert given["z4"] is recording["z4"]
    assert recording.with_noise({"z1": 1e-3}).noise()["z1"] == pytest.approx(1e-3, rel=0.1)


def test_a_simulation_is_given_the_noise_that_is_stated_however_it_looks() -> None:
    """Sampled slowly, ringing oil looks like noise; a recording whose samples scatter keeps its own, and says so."""
    time = np.arange(500) * 0.02
    rings = {"z1": np.sin(3.0 * time), "p1": 50e5 + 5e5 * np.sin(35.0 * time)}
    seen, stated = Recording.from_arrays("r", time, rings), {"z1": 1e-3, "p1": 3e4}
    assert "p1" not in seen.noise_free()
    given = replace(seen, exact=True).with_noise(stated)
    for name, std in stated.items():
        assert np.std(given[name].values - rings[name]) == pytest.approx(std, rel=0.1)
    assert not given.exact and given.with_noise(stated)["p1"] is given["p1"]
    kept = seen.with_noise(stated)
    assert kept["p1"] is seen["p1"] and "p1: no noise was added" in kept.notes[-1]


def test_times_of_pandas_are_seconds_from_the_first() -> None:
    pandas = pytest.importorskip("pandas")
    values, start = {"z1": np.arange(5.0)}, pandas.Timestamp("2024-05-01 10:00")
    dates = pandas.date_range(start, periods=5, freq="10ms")
    for clock in (dates, dates.tz_localize("Europe/Helsinki"), dates - start, dates.to_pydatetime(), dates.to_numpy()):
        recording = Recording.from_arrays("r", clock, values)
        np.testing.assert_allclose(recording["z1"].time, 0.01 * np.arange(5), atol=1e-12)
    frame = recording.to_dataframe()
    again = Recording.from_arrays("again", frame.index, frame)
    np.testing.assert_array_equal(again["z1"].values, values["z1"])


def test_repr_and_plot_tell_the_channels(tmp_path: Path) -> None:
    recording = read(tmp_path, GOOD)
    assert repr(recording) == "<Recording lift: u1, u2, z1, p1; 0.01 s at 200 Hz>"
    told = re.sub(r"<[^>]*>", " ", recording._repr_html_())
    assert re.search(r"p1 +bar +3 +38.5 +40", told)
    figure = recording.plot()
    assert [axis.get_ylabel() for axis in figure.axes] == ["u1", "u2", "z1 / °", "p1 / bar"]
    np.testing.assert_allclose(figure.axes[3].lines[0].get_ydata(), [38.5, 39, 40])


# -- the quick reader of plain files against the careful one ---------------------------------------------------------


@pytest.mark.parametrize("delimiter", [",", ";", "\t"])
def test_the_quick_reader_reads_what_the_careful_one_reads(delimiter: str) -> None:
    rng = random.Random(5)
    form = tables.Form(Path("f.csv"), ["a", "b", "c"], delimiter, 0)
    quick = 0
    for _ in range(3000):
        fields = [_odd_field(rng) if rng.random() < 0.2 else repr(rng.random()) for _ in range(6)]
        body = (delimiter.join(fields[:3]) + "\n" + delimiter.join(fields[3:]) + "\n").encode()
        numbers = tables.read_fast(body, form)
        if numbers is not None:  # what the quick reader leaves alone, the careful one reads or refuses
            quick += 1
            np.testing.assert_array_equal(numbers, tables.read_carefully(body, form, 2, True)[0], err_msg=repr(body))
    assert quick > 300


def _odd_field(rng: random.Random) -> str:
    return "".join(rng.choice("0123456789+-.eEnaifx_ \t,;") for _ in range(rng.randint(0, 4)))


def test_a_repeated_time_now_and_then_is_left_out_and_told(tmp_path):
    rows = [f"{0.01 * k:.2f},0,0,{k}" for k in range(40)]
    rows.insert(21, rows[20].replace(",20", ",99"))
    file = tmp_path / "stutter.csv"
    file.write_text("\n".join(["time[s],u1[-],u2[-],z1[deg]", *rows]) + "\n")
    recording = Recording.load(file)
    assert len(recording["z1"]) == 40 and np.degrees(recording["z1"].values[20]) == pytest.approx(20.0)
    assert (np.diff(recording["z1"].time) > 0).all()
    assert any("z1: 1 samples" in note for note in recording.notes)
