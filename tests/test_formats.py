"""Recordings in other formats, each written by the format's own library, and results leaving again."""

from __future__ import annotations

import datetime
import importlib
import re
import sys
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from scipy.io import loadmat, savemat

from crane_exudyn import tables
from crane_exudyn.errors import CraneError
from crane_exudyn.formats import write_table
from crane_exudyn.mapping import Column
from crane_exudyn.recording import Recording

SLOW, FAST = np.arange(6) * 0.05, np.arange(21) * 0.0125
Z1, P1 = np.linspace(10.0, 12.0, 6), np.linspace(30.0, 50.0, 21)


def check(recording: Recording) -> None:
    """The same two channels in every format: z1 in deg on the slow clock, p1 in bar on the fast one, unresampled."""
    assert recording.sensors == ("z1", "p1")
    np.testing.assert_allclose(recording["z1"].values, np.radians(Z1), rtol=1e-14)
    np.testing.assert_allclose(recording["p1"].values, P1 * 1e5, rtol=1e-14)
    np.testing.assert_allclose(recording["z1"].time, SLOW, rtol=1e-14)
    np.testing.assert_allclose(recording["p1"].time, FAST, rtol=1e-14)
    time, values = recording.aligned(("z1", "p1"))
    assert len(time) == 21 + 0 * len(SLOW)  # every slow stamp coincides with a fast one
    assert np.isfinite(values).sum(axis=0).tolist() == [6, 21]


def _refused(file: Path) -> str:
    with pytest.raises(CraneError) as caught:
        Recording.load(file)
    assert str(file) in str(caught.value)
    return str(caught.value)


# -- MATLAB v5 -------------------------------------------------------------------------------------------------------


def test_mat5_vectors_with_clocks_of_their_own(tmp_path: Path) -> None:
    savemat(
        tmp_path / "lift.mat",
        {"z1": Z1[:, None], "z1_time": SLOW, "z1_time_unit": "s", "z1_unit": "deg", "p1": P1, "time": FAST * 1e3}
        | {"units": {"time": "ms", "p1": "bar"}, "operator": "Q. K.", "magic": np.eye(3)},
    )  # fmt: skip
    recording = Recording.load(tmp_path / "lift.mat")
    check(recording)
    assert any("magic" in note for note in recording.notes)


def test_mat5_structs_inside_one_struct(tmp_path: Path) -> None:
    channels = {
        "z1": {"values": Z1, "time": SLOW, "unit": "deg"},
        "p1": {"data": P1, "time": FAST, "units": "bar"},
    }
    savemat(tmp_path / "lift.mat", {"log": channels})
    check(Recording.load(tmp_path / "lift.mat"))


def test_mat5_mapping(tmp_path: Path) -> None:
    savemat(tmp_path / "lift.mat", {"t": SLOW, "BoomAngle": Z1})
    recording = Recording.load(tmp_path / "lift.mat", {"time": "t[s]", "z1": "BoomAngle[deg]"})
    np.testing.assert_allclose(recording["z1"].values, np.radians(Z1))


@pytest.mark.parametrize(
    ("variables", "part"),
    [
        ({"time": SLOW, "z1": Z1}, "no unit"),
        ({"time": SLOW, "units": {"time": "s", "z1": "bar"}, "z1": Z1}, "wrong dimension"),
        ({"time": FAST, "units": {"time": "s", "z1": "deg"}, "z1": Z1}, "found 6 samples, expected 21"),
        ({"time": SLOW[::-1], "units": {"time": "s", "z1": "deg"}, "z1": Z1}, "sample 2"),
        ({"text": "nothing"}, "no vector of numbers"),
    ],
)
def test_mat5_refusals(tmp_path: Path, variables: dict[str, Any], part: str) -> None:
    savemat(tmp_path / "lift.mat", variables)
    assert part in _refused(tmp_path / "lift.mat")


# -- MATLAB v7.3 -----------------------------------------------------------------------------------------------------


def _matlab_text(group: h5py.Group, name: str, text: str) -> None:
    """Store text as MATLAB v7.3 does: a column of UTF-16 numbers with the class beside it."""
    item = group.create_dataset(name, data=np.array([[ord(c)] for c in text], dtype=np.uint16))
    item.attrs["MATLAB_class"] = np.bytes_("char")


def _mat73(path: Path, own_structs: bool) -> None:
    with h5py.File(path, "w", userblock_size=512) as file:
        if own_structs:
            for name, values, time, unit in (("z1", Z1, SLOW, "deg"), ("p1", P1, FAST, "bar")):
                group = file.create_group(name)
                group.attrs["MATLAB_class"] = np.bytes_("struct")
                group["values"], group["time"] = values[None, :], time[None, :]
                _matlab_text(group, "unit", unit)
        else:
            file["z1"], file["z1_time"], file["p1"], file["time"] = Z1[None], SLOW[None], P1[None], FAST[None]
            for name, unit in (("z1", "deg"), ("z1_time", "s"), ("p1", "bar"), ("time", "s")):
                _matlab_text(file, f"{name}_unit", unit)
        file.create_group("#refs#")
    with path.open("r+b") as raw:
        raw.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")


@pytest.mark.parametrize("own_structs", [True, False])
def test_mat73(tmp_path: Path, own_structs: bool) -> None:
    _mat73(tmp_path / "lift.mat", own_structs)
    check(Recording.load(tmp_path / "lift.mat"))


# -- Parquet ---------------------------------------------------------------------------------------------------------


def _on_fast_clock() -> dict[str, Any]:
    z1: list[float | None] = [None] * 21
    for value, stamp in zip(Z1, SLOW, strict=True):
        z1[round(stamp / 0.0125)] = float(value)
    return {"z1": pa.array(z1), "p1": pa.array(P1)}


def test_parquet_units_in_names(tmp_path: Path) -> None:
    columns = _on_fast_clock()
    table = pa.table({"time[s]": FAST, "z1[deg]": columns["z1"], "p1[bar]": columns["p1"], "who": ["x"] * 21})
    pq.write_table(table, tmp_path / "lift.parquet")
    recording = Recording.load(tmp_path / "lift.parquet")
    check(recording)
    assert "who" in recording.notes[0]


@pytest.mark.parametrize("pieces", [False, True])
def test_text_in_a_column_that_nothing_asks_for_is_ignored_in_csv_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, pieces: bool
) -> None:
    file = tmp_path / "log.csv"
    file.write_text("time[s],z1[deg],who,oil\n0,1,,40\n0.1,2,Q. K.,41\n0.2,3,7,n/a\n0.3,4,,\n")
    if pieces:
        monkeypatch.setattr(tables, "_PIECE", 20)
    recording = Recording.load(file)
    assert list(recording) == ["z1"] and len(recording["z1"]) == 4
    assert recording.notes == tuple(f"column {n!r} contains text, not numbers, and was ignored" for n in ("who", "oil"))
    with pytest.raises(CraneError, match=r"line 4, column oil: found 'n/a', expected a number"):
        Recording.load(file, {"p1": "oil[bar]"})


def test_a_line_of_units_is_no_text_to_ignore(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,boom\ns,deg\n0,1\n1,2\n")
    assert "line 2, column t: found 's'" in _refused(tmp_path / "log.csv")


def test_parquet_units_in_metadata_and_time_stamps(tmp_path: Path) -> None:
    start = datetime.datetime(2024, 5, 17, 8, 0, tzinfo=datetime.UTC)
    stamps = pa.array([start + datetime.timedelta(seconds=float(t)) for t in FAST], pa.timestamp("us", "UTC"))
    fields = [
        pa.field("time", stamps.type),
        *(pa.field(n, pa.float64(), metadata={"unit": u}) for n, u in (("z1", "deg"), ("p1", "bar"))),
    ]
    columns = _on_fast_clock()
    pq.write_table(pa.table([stamps, columns["z1"], columns["p1"]], pa.schema(fields)), tmp_path / "lift.parquet")
    check(Recording.load(tmp_path / "lift.parquet"))


def test_parquet_refusal_names_the_row(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time[s]": [0.0, 0.2, 0.1], "z1[deg]": [1, 2, 3]}), tmp_path / "lift.parquet")
    assert "row 3" in _refused(tmp_path / "lift.parquet")


# -- MDF4 ------------------------------------------------------------------------------------------------------------


def _mdf(path: Path, twice: bool = False) -> None:
    asammdf = importlib.import_module("asammdf")
    signals = [
        asammdf.Signal(Z1, SLOW, unit="deg", name="z1"),
        asammdf.Signal(P1, FAST, unit="bar", name="p1"),
        asammdf.Signal(P1, FAST, unit="degC", name="oil"),
    ]
    with asammdf.MDF(version="4.10") as file:
        for signal in [*signals, signals[0]] if twice else signals:
            file.append([signal])  # one group each: each with a clock of its own
        file.save(path, overwrite=True)


def test_mdf4_channels_keep_their_clocks(tmp_path: Path) -> None:
    _mdf(tmp_path / "lift.mf4")
    recording = Recording.load(tmp_path / "lift.mf4")
    check(recording)
    assert recording.notes == ("1 other channels were ignored",)


def test_mdf4_channel_in_two_groups_is_refused(tmp_path: Path) -> None:
    _mdf(tmp_path / "lift.mf4", twice=True)
    assert "z1 occurs twice" in _refused(tmp_path / "lift.mf4")


def test_mdf4_without_asammdf_names_the_command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    _mdf(tmp_path / "lift.mf4")
    monkeypatch.setitem(sys.modules, "asammdf", None)
    assert "pip install asammdf" in _refused(tmp_path / "lift.mf4")


# -- damaged files, and leaving again --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["mat", "mat73", "parquet", "mf4"])
def test_a_file_cut_in_half_is_refused(tmp_path: Path, kind: str) -> None:
    file = tmp_path / f"lift.{kind.removesuffix('73')}"
    if kind == "mat":
        savemat(file, {"z1": np.arange(5000.0)})
    elif kind == "mat73":
        _mat73(file, own_structs=True)
    elif kind == "parquet":
        pq.write_table(pa.table({"time[s]": FAST}), file)
    else:
        _mdf(file)
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    assert "cut" in _refused(file)


@pytest.mark.parametrize("ending", ["mat", "parquet", "mf4"])
def test_an_empty_file_is_refused(tmp_path: Path, ending: str) -> None:
    file = tmp_path / f"lift.{ending}"
    file.touch()
    assert "empty" in _refused(file)


@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".parquet", ".mat"])
def test_every_format_written_reads_back_bit_for_bit(tmp_path: Path, ending: str) -> None:
    rng = np.random.default_rng(3)
    time = np.cumsum(rng.uniform(0.001, 0.02, 50))
    values = {name: rng.normal(size=50) * scale for name, scale in (("z1", 1.0), ("p4", 1e7), ("s2", 1e-9))}
    values["u1"], values["u2"] = rng.uniform(-1, 1, 50), np.zeros(50)
    values["p4"][rng.integers(0, 50, 20)] = np.nan
    recording = Recording.from_arrays("run", time, values)
    recording.save(tmp_path / f"run{ending}")
    again = Recording.load(tmp_path / f"run{ending}")
    assert again.name == "run"
    assert set(again.channels) == set(recording.channels)
    for name in recording.channels:
        np.testing.assert_array_equal(again[name].time, recording[name].time)
        np.testing.assert_array_equal(again[name].values, recording[name].values)
    assert [p.name for p in tmp_path.iterdir()] == [f"run{ending}"]  # no temporary file stays


def test_written_csv_has_si_units_and_empty_fields(tmp_path: Path) -> None:
    Recording.from_arrays("r", [0.0, 0.5], {"z1": [0.1, np.nan], "u1": [0.0, 1.0]}).save(tmp_path / "r.csv")
    assert (tmp_path / "r.csv").read_text() == "time[s],u1[-],z1[rad]\n0.0,0.0,0.1\n0.5,1.0,\n"


def test_digits_and_names_that_matlab_does_not_take(tmp_path: Path) -> None:
    columns = {"time[s]": np.arange(2.0), "payload.mass_high95[kg]": np.array([1 / 3, 2 / 3])}
    write_table(tmp_path / "r.csv", columns, digits=4)
    assert (tmp_path / "r.csv").read_text().splitlines()[1:] == ["0,0.3333", "1,0.6667"]
    write_table(tmp_path / "r.mat", columns)
    content = loadmat(tmp_path / "r.mat", squeeze_me=True)
    np.testing.assert_array_equal(content["payload_mass_high95"], columns["payload.mass_high95[kg]"])
    assert content["units"]["payload_mass_high95"].item() == "kg"


def test_unknown_ending_and_missing_folder_are_refused(tmp_path: Path) -> None:
    with pytest.raises(CraneError, match=r"run\.xlsx.*Known: \.csv"):
        write_table(tmp_path / "run.xlsx", {"a[s]": np.zeros(2)})
    with pytest.raises(CraneError, match="does not exist"):
        write_table(tmp_path / "nowhere" / "run.csv", {"a[s]": np.zeros(2)})


def test_a_failed_write_leaves_what_was_there(tmp_path: Path) -> None:
    (tmp_path / "run.csv").write_text("old")
    with pytest.raises(ValueError, match="zip"):
        write_table(tmp_path / "run.csv", {"a[s]": np.zeros(2), "b[s]": np.zeros(3)})
    assert (tmp_path / "run.csv").read_text() == "old"
    assert [p.name for p in tmp_path.iterdir()] == ["run.csv"]


# -- what is no channel ----------------------------------------------------------------------------------------------


def _odd73(path: Path, **odd: Any) -> None:
    """Write a v7.3 file with a sound z1 and what else is given: arrays, links, or functions of the file."""
    with h5py.File(path, "w") as file:
        file["z1"], file["z1_time"] = Z1, SLOW
        for name, unit in (("z1", "deg"), ("z1_time", "s")):
            _matlab_text(file, f"{name}_unit", unit)
        for name, value in odd.items():
            if callable(value):
                value(file, name)
            else:
                file[name] = value


def _cell(file: h5py.File, name: str) -> None:
    item = file.create_dataset(name, data=np.array([file["z1"].ref], dtype=h5py.ref_dtype))
    item.attrs["MATLAB_class"] = np.bytes_("cell")


def _huge(file: h5py.File, name: str) -> None:
    file.create_dataset(name, shape=(10**12,), dtype=float, chunks=(1000,))


def _round(file: h5py.File, name: str) -> None:
    file.create_group(name)["again"] = h5py.SoftLink("/" + name)


@pytest.mark.parametrize(
    ("odd", "words"),
    [
        (np.array(["a", "b"], dtype=h5py.string_dtype()), "variable 'p1' is text and was ignored"),
        (_cell, "variable 'p1' is a cell array"),
        (np.zeros(6, dtype=[("t", float), ("y", float)]), "variable 'p1' is compound"),
        (h5py.SoftLink("/nowhere"), "variable 'p1' is a link that leads nowhere"),
        (h5py.ExternalLink("other.mat", "/p1"), "variable 'p1' is a link to another file"),
        (_huge, "variable 'p1' has 1e+12 numbers"),
        (_round, "variable 'p1' is neither a vector nor a struct"),
        (np.zeros((3, 4)), "variable 'p1' is neither a vector nor a struct"),
    ],
    ids=["text", "cell", "compound", "broken-link", "external-link", "huge", "round", "matrix"],
)
def test_mat73_says_what_it_leaves_out(tmp_path: Path, odd: Any, words: str) -> None:
    _odd73(tmp_path / "lift.mat", p1=odd)
    recording = Recording.load(tmp_path / "lift.mat")
    assert recording.sensors == ("z1",)
    assert any(words in note for note in recording.notes), recording.notes
    with pytest.raises(CraneError, match=f"no column 'p1'.*{re.escape(words)}"):
        Recording.load(tmp_path / "lift.mat", {"p1": "p1[bar]"})


def test_mat5_says_what_it_leaves_out(tmp_path: Path) -> None:
    cell = np.empty(2, dtype=object)
    cell[:] = ["a", np.arange(3.0)]
    units = {"time": "s", "z1": "deg"}
    savemat(tmp_path / "lift.mat", {"time": SLOW, "z1": Z1, "units": units, "p1": cell, "p2": "text"})
    notes = Recording.load(tmp_path / "lift.mat").notes
    assert any("'p1' is a cell array" in n for n in notes) and any("'p2' is text" in n for n in notes)


@pytest.mark.parametrize("in_struct", [True, False])
def test_a_clock_of_text_is_refused(tmp_path: Path, in_struct: bool) -> None:
    text = np.array(["10:00", "10:01"], dtype=h5py.string_dtype())

    def struct(file: h5py.File, name: str) -> None:
        file.create_group(name)["values"] = P1[:2]
        file[name]["time"] = text

    _odd73(tmp_path / "lift.mat", **({"p1": struct} if in_struct else {"p1": P1[:2], "p1_time": text}))
    assert "is text, expected a vector of times" in _refused(tmp_path / "lift.mat")


def test_parquet_with_bad_metadata_text_and_columns_of_one_name(tmp_path: Path) -> None:
    fields = [
        pa.field("time", pa.float64(), metadata={"unit": "s"}),
        pa.field("z1", pa.float64(), metadata={b"unit": b"\xff\xfe"}),
    ]
    table = pa.table([pa.array(SLOW), pa.array(Z1)], schema=pa.schema(fields))
    pq.write_table(table, tmp_path / "bad.parquet")
    assert "cannot occur in a number or unit" in _refused(tmp_path / "bad.parquet")
    twice = pa.table([pa.array(SLOW), pa.array(Z1), pa.array(Z1)], names=["time[s]", "z1[deg]", "z1[deg]"])
    pq.write_table(twice, tmp_path / "twice.parquet")
    assert "z1 occurs twice" in _refused(tmp_path / "twice.parquet")
    clock = pa.table([pa.array(["10:00"] * 6), pa.array(Z1)], names=["time", "z1[deg]"])
    pq.write_table(clock, tmp_path / "clock.parquet")
    assert "there is no column time" in _refused(tmp_path / "clock.parquet")


def test_thousands_of_other_columns_are_one_remark(tmp_path: Path) -> None:
    names = [f"other{k}" for k in range(20_000)]
    rows = [f"{t},{t}" + ",7" * len(names) for t in range(3)]
    (tmp_path / "wide.csv").write_text("\n".join([f"time[s],z1[deg],{','.join(names)}", *rows]), encoding="utf-8")
    notes = Recording.load(tmp_path / "wide.csv").notes
    assert len(notes) == 1 and notes[0].startswith("20000 columns such as 'other0'")


def test_a_text_file_is_the_same_in_pieces(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    time = np.arange(500) * 0.01
    recording = Recording.from_arrays("r", time, {"z1": np.sin(time), "p1": np.where(time < 1, np.nan, 1e5 * time)})
    for name in ("run.csv", "run.csv.gz"):
        recording.save(tmp_path / name)
        monkeypatch.setattr("crane_exudyn.tables._PIECE", 1000)
        monkeypatch.setattr("crane_exudyn.formats._LINES", 7)
        recording.save(tmp_path / f"again-{name}")
        assert Recording.load(tmp_path / f"again-{name}")["p1"].values.tolist() == recording["p1"].values.tolist()
        monkeypatch.undo()
        assert Recording.load(tmp_path / f"again-{name}")["z1"].values.tolist() == recording["z1"].values.tolist()
    (tmp_path / "bad.csv").write_text((tmp_path / "run.csv").read_text().replace("\n4.5,", "\nfour,"), encoding="utf-8")
    monkeypatch.setattr("crane_exudyn.tables._PIECE", 1000)
    assert "line 452" in _refused(tmp_path / "bad.csv")


# -- dates and times of day in text files ----------------------------------------------------------------------------

ISO = [f"2024-03-01 23:59:59.{k:03d}" for k in range(995, 1000)] + ["2024-03-02 00:00:00", "2024-03-02 00:00:00.001"]


def logged(folder: Path, stamps: list[str], header: str = "time", separator: str = ",") -> Path:
    rows = [separator.join([header, "z1[deg]"]), *(f"{s}{separator}{k}" for k, s in enumerate(stamps))]
    (folder / "log.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    return folder / "log.csv"


@pytest.mark.parametrize(
    ("stamps", "steps"),
    [
        (ISO, 0.001),
        ([s.replace(" ", "T") + "+01:00" for s in ISO], 0.001),
        (["10:59:59.9", "11:00:00.0", "11:00:00.1", "11:00:00.2"], 0.1),
        (["23:59:59", "24:00:00", "24:00:01"], 1.0),
    ],
)
@pytest.mark.parametrize("header", ["time", "time[s]", "time[hh:mm:ss]"])
def test_dates_and_times_of_day_are_seconds_from_the_first(
    tmp_path: Path, stamps: list[str], steps: float, header: str
) -> None:
    recording = Recording.load(logged(tmp_path, stamps, header))
    np.testing.assert_allclose(recording["z1"].time, steps * np.arange(len(stamps)), rtol=0, atol=1e-9)
    assert f"column 'time' counts from {stamps[0]}" in recording.notes


def test_times_of_day_with_decimal_commas_and_another_name(tmp_path: Path) -> None:
    file = logged(tmp_path, ["10:00:00,000", "10:00:00,005", "10:00:00,010"], "Uhrzeit", ";")
    np.testing.assert_allclose(Recording.load(file, {"time": "Uhrzeit"})["z1"].time, [0.0, 0.005, 0.01], atol=1e-9)
    np.testing.assert_allclose(Recording.load(file, {"time": "Uhrzeit[s]"})["z1"].time, [0.0, 0.005, 0.01], atol=1e-9)


def test_a_column_of_dates_that_is_none_of_the_channels_is_ignored(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("date,time[s],z1[deg]\n2024-03-01,0,1\n2024-03-01,1,2\n", encoding="utf-8")
    recording = Recording.load(tmp_path / "log.csv")
    assert len(recording["z1"]) == 2 and "column 'date' was ignored" in recording.notes


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        (
            ["01.03.2024 10:00:00", "01.03.2024 10:00:01"],
            "line 2, column time: found '01.03.2024 10:00:00'.*export sec",
        ),
        (["10:00", "10:01"], "looks like a date or a time: export seconds"),
        (["10:00:00", "10:00:01", "11.5"], "line 4, column time: found '11.5', expected a time such as 10:00:00"),
        (["2024-03-01 10:00:00", "2024-03-01 10:00:00+01:00"], "line 3.*expected a time such as 2024-03-01 10:00:00"),
        (["2024-03-01 10:00:00", "2024-13-01 10:00:00"], "line 3.*'2024-13-01 10:00:00'"),
        (["10:00:01", "10:00:00"], "line 3.*goes back"),
    ],
)
def test_other_dates_are_refused_with_what_would_be_read(tmp_path: Path, stamps: list[str], words: str) -> None:
    assert re.search(words, _refused(logged(tmp_path, stamps)))


# -- units of a file's columns ---------------------------------------------------------------------------------------


def test_all_columns_without_a_unit_are_told_at_once(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time,u1,z1,p1[bar],p2\n0,0,1,2,3\n1,0,1,2,3\n", encoding="utf-8")
    said = _refused(tmp_path / "log.csv")
    assert "columns time, z1, p2: no unit is given" in said
    assert "time[s], z1[deg], p2[bar], or give --map time=time[s] --map z1=z1[deg] --map p2=p2[bar]. " in said


def test_gauge_pressures_are_told_with_what_a_map_file_says_of_them(tmp_path: Path) -> None:
    text = "time[s],z1[deg],p1[barg],p2[barg]\n0,1,9,2\n1,1,9,3\n"
    (tmp_path / "log.csv").write_text(text, encoding="utf-8")
    said = _refused(tmp_path / "log.csv")
    assert "p1, p2 in [barg]" in said and "below [p1] and again below [p2]" in said
    assert 'unit = "bar"' in said and 'offset = "1.01325 bar" if the crane file\'s pressures are absolute' in said
    with pytest.raises(CraneError, match=r'says \[barg\], --map says \[bar\]. Write unit = "bar".*offset'):
        Recording.load(tmp_path / "log.csv", {"p1": "p1[bar]", "p2": "p2[bar]"})
    mended = {n: Column(n, "bar", offset=101325.0) for n in ("p1", "p2")}
    np.testing.assert_allclose(Recording.load(tmp_path / "log.csv", mended)["p1"].values, 9e5 + 101325.0)


def test_a_unit_that_contradicts_the_files_is_told_with_what_overrules_it(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("time[s],z1[rad]\n0,10\n1,20\n", encoding="utf-8")
    with pytest.raises(CraneError, match=r'the file says \[rad\], --map says \[deg\].*unit = "deg" into a map file'):
        Recording.load(tmp_path / "log.csv", {"z1": "z1[deg]"})
    overruled = Recording.load(tmp_path / "log.csv", {"z1": Column("z1", "deg")})
    np.testing.assert_allclose(overruled["z1"].values, np.radians([10, 20]))


@pytest.mark.parametrize("count", [9, 30])
def test_a_list_of_columns_says_where_it_goes_on(tmp_path: Path, count: int) -> None:
    names = [f"c{k}[bar]" for k in range(count)]
    (tmp_path / "log.csv").write_text(",".join(names) + "\n" + (",".join("1" * count) + "\n") * 2, encoding="utf-8")
    said = _refused(tmp_path / "log.csv")
    assert ("c8[bar]. Expected" if count == 9 else "c11[bar], …. Expected") in said


def test_a_clock_that_stands_still_is_one_note(tmp_path: Path) -> None:
    rows = [f"{min(k, 50) if k < 55 else k},{k},{k}" for k in range(100)]
    (tmp_path / "log.csv").write_text("\n".join(["time[s],z1[deg],z4[deg]", *rows]) + "\n", encoding="utf-8")
    assert Recording.load(tmp_path / "log.csv").notes == (
        "channels z1, z4: 4 samples with a repeated time are left out, where the time stays at 50 s",
    )
