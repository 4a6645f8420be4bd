"""`patu check`: mistakes of loggers are told first, with their channels and a mend that works; sound recordings are
left alone, worn machines too.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from crane_exudyn.channels import Channel
from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.formats import write_table
from crane_exudyn.mapping import Column, load_map
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import simulate
from crane_exudyn.vetting import vet
from crane_exudyn.vetting.balances import Figures, Grid, Misfit, motions
from crane_exudyn.vetting.corrections import mended_columns
from crane_exudyn.vetting.findings import Finding
from crane_exudyn.vetting.readings import Reading, Source, Weighed
from patu.reading import load_checked
from validation.fitness import check_recording, examine
from validation.hidden_machines import recorded
from validation.loggers import Mistake, mistakes
from validation.sample import with_the_package

DATA = Path(__file__).parent / "data"
CRANE = Crane.load("patu655")
FOUR = ("u1", "u2", "z1", "z4", "p1", "p4")


def sound(name: str = "open_none_learn") -> Recording:
    return Recording.load(DATA / f"{name}.csv.gz")


def one_of_each(recording: Recording) -> dict[str, Mistake]:
    """Return the last mistake of each name."""
    return {m.name: m for m in mistakes(recording, CRANE)}


ALL, LESS = one_of_each(sound()), one_of_each(sound().select(FOUR))


@pytest.mark.parametrize(
    "name", ["open_none_learn", "open_leak_lift_learn", "open_bias_p4_learn", "open_air_check", "open_friction_O_learn"]
)
@pytest.mark.parametrize("sensors", [4, 6])
def test_sound_recordings_of_worn_machines_have_no_findings(name: str, sensors: int) -> None:
    recording = sound(name)
    assert vet(recording if sensors == 6 else recording.select(FOUR), CRANE) == []


#: mistakes whose mend is a line of a map file
MENDED = [n for n, m in ALL.items() if m.kind in ("sign", "swapped", "absolute", "scale", "offset", "clock")]


def assert_told_first(mistake: Mistake, findings: list[Finding]) -> None:
    assert mistake.found_by(findings), findings
    assert len({f.channels for f in findings if f.severity == "error"}) <= 1  # and nothing else is blamed for it


@pytest.mark.parametrize("name", [n for n in ALL if n not in MENDED])
def test_a_mistake_is_told_first(name: str) -> None:
    assert_told_first(ALL[name], vet(ALL[name].recording, CRANE))


@pytest.mark.parametrize(
    "name",
    ["sign of a command", "sign of an angle", "commands exchanged", "pressures exchanged", "psi as bar, all pressures"],
)
def test_a_mistake_is_told_with_four_sensors(name: str) -> None:
    assert LESS[name].found_by(vet(LESS[name].recording, CRANE))


def test_two_mistakes_are_told_and_mended_together(tmp_path: Path) -> None:
    recording = sound()
    turned = {n: replace(recording[n], values=-recording[n].values) for n in ("u1", "z4")}
    findings = vet(replace(recording, channels={**recording.channels, **turned}), CRANE)
    assert {(f.kind, f.channels, f.severity) for f in findings} == {
        ("sign", ("u1",), "error"),
        ("sign", ("z4",), "error"),
    }


@pytest.mark.parametrize("name", MENDED)
def test_a_mistake_is_told_first_and_its_mend_mends(name: str, tmp_path: Path) -> None:
    from crane_exudyn.mapping import map_text

    file, table = tmp_path / "wrong.csv", tmp_path / "map.toml"
    ALL[name].recording.save(file)
    wrong = Recording.load(file)
    findings = vet(wrong, CRANE)
    assert_told_first(ALL[name], findings)
    table.write_text(map_text(mended_columns(wrong, findings), CRANE.layout))
    right = Recording.load(file, load_map(table, CRANE.layout))
    assert [f for f in vet(right, CRANE) if f.severity == "error"] == []
    for channel in sound().channels:
        if channel in right.channels and ALL[name].kind != "clock":
            assert right[channel].values == pytest.approx(sound()[channel].values, rel=1e-3, abs=1e-3)


def test_a_short_delay_of_one_valve_is_none_of_a_clock() -> None:
    recording = sound()
    late = Channel(recording["u2"].time - 0.25, recording["u2"].values)
    assert vet(replace(recording, channels={**recording.channels, "u2": late}), CRANE) == []


def test_a_machine_that_nobody_can_explain_is_not_explained() -> None:
    recording, rng = sound(), np.random.default_rng(1)
    walk = {
        n: replace(
            recording[n],
            values=recording[n].values[rng.permutation(20).repeat(len(recording[n]) // 20 + 1)[: len(recording[n])]],
        )
        for n in recording.sensors
    }
    assert [
        f for f in vet(replace(recording, channels={**recording.channels, **walk}), CRANE) if f.kind == "swapped"
    ] == []


def changed(recording: Recording, **changes: np.ndarray) -> Recording:
    """Return the recording with other values in some channels."""
    other = {n: replace(recording[n], values=v) for n, v in changes.items()}
    return replace(recording, channels={**recording.channels, **other})


def test_the_clock_is_judged_with_the_commands_that_are_meant(tmp_path: Path) -> None:
    """Pistons seem to move seconds before the commands of the other valve."""
    clean, _ = with_the_package()
    changed(clean, u1=clean["u2"].values, u2=clean["u1"].values).save(tmp_path / "wrong.csv")
    findings = vet(wrong := Recording.load(tmp_path / "wrong.csv"), CRANE)
    assert [(f.kind, f.mend) for f in findings] == [("swapped", "Type --map u1=u2 --map u2=u1.")]
    assert vet(Recording.load(tmp_path / "wrong.csv", mended_columns(wrong, findings)), CRANE) == []


def test_commands_that_are_exchanged_and_late_are_both_told(tmp_path: Path) -> None:
    clean, _ = with_the_package()
    late = {n: replace(clean[m], time=clean[m].time + 0.3) for n, m in (("u1", "u2"), ("u2", "u1"))}
    replace(clean, channels={**clean.channels, **late}).save(tmp_path / "wrong.csv")
    findings = vet(wrong := Recording.load(tmp_path / "wrong.csv"), CRANE)
    assert {f.kind for f in findings} == {"swapped", "clock"}
    assert any('late = "0.3 s" for [u1], [u2]' in f.mend for f in findings)
    assert vet(Recording.load(tmp_path / "wrong.csv", mended_columns(wrong, findings)), CRANE) == []


def test_a_clock_that_a_map_file_mends_in_part_is_mended_by_the_rest(tmp_path: Path) -> None:
    clean, _ = with_the_package()
    late = {n: replace(clean[n], time=clean[n].time + 0.3) for n in ("u1", "u2")}
    replace(clean, channels={**clean.channels, **late}).save(tmp_path / "late.csv")
    partly = Recording.load(tmp_path / "late.csv", {n: Column(n, late=0.1) for n in late})
    (found,) = vet(partly, CRANE)
    assert found.columns["u1"].late == pytest.approx(0.3, abs=0.02)


def test_a_mend_that_is_found_as_well_is_no_alternative() -> None:
    clean, _ = with_the_package()
    findings = vet(changed(clean, u1=-clean["u1"].values, u2=-clean["u2"].values), CRANE)
    assert {f.mend.split("=")[0] for f in findings} == {"Type --map u1", "Type --map u2"}
    assert not any(" Or: " in f.mend or "almost as likely" in f.text for f in findings)


def test_commands_that_are_dead_while_the_machine_moves_are_told() -> None:
    both = vet(changed(sound(), u1=0.0 * sound()["u1"].values, u2=0.0 * sound()["u2"].values), CRANE)
    assert [(f.kind, f.channels, f.severity) for f in both] == [("motion", ("u1", "u2"), "error")]
    assert "never commanded: u1 and u2 are dead" in both[0].text
    one = vet(changed(sound(), u1=0.0 * sound()["u1"].values), CRANE)
    assert ("motion", ("u1",), "error") in [(f.kind, f.channels, f.severity) for f in one]


def test_a_boom_that_sinks_behind_a_closed_valve_is_no_dead_command() -> None:
    worn = CRANE.with_effect("internal_leakage@lift", {"k": 3e-12}).with_effect("external_leakage@p1", {"k": 2e-12})
    sunk = driven(worn, np.zeros(2000), pulse(2.0, 6.0, 0.2, 20.0), "z1", "z4", "p1", "p2", "p3", "p4")
    assert np.ptp(sunk["z1"].values) > np.radians(3.0)
    assert [f for f in vet(sunk, CRANE) if f.kind == "motion"] == []


@pytest.mark.parametrize(
    ("values", "factor", "mend"),
    [
        ("z1[rad]", np.degrees(1.0), 'unit = "deg" for [z1]'),
        ("z4[rad]", np.degrees(1.0), 'unit = "deg" for [z4]'),
        ("p1[bar]", 1.45037738e-4, 'unit = "psi" for [p1]'),
        ("p1[bar]", 1e-4, "scale = 0.1 for [p1]"),
    ],
)
def test_a_mend_is_written_as_a_map_file_has_it(values: str, factor: float, mend: str, tmp_path: Path) -> None:
    clean, _ = with_the_package()
    time, columns = clean.aligned()
    name = values.partition("[")[0]
    table = {"time[s]": time}
    for n, column in zip(clean.channels, columns.T, strict=True):
        table[values if n == name else f"{n}[{clean[n].unit or '-'}]"] = factor * column if n == name else column
    write_table(tmp_path / "wrong.csv", table)
    first, *more = vet(Recording.load(tmp_path / "wrong.csv"), CRANE)
    assert mend in first.mend and "--write-map" in first.mend and more == []


# -- what no comparison takes, told beforehand -----------------------------------------------------------------------


def unusable() -> dict[str, Recording]:
    clean, _ = with_the_package()
    return {
        "u1 and u2 missing": clean.select(clean.sensors),
        "found 0 sensor channels": clean.select(["u1", "u2"]),
        "at least 1 s is needed": clean.window(0.0, 0.5),
        "sensor p4 is exactly at its largest value": changed(clean, p4=0.0 * clean["p4"].values),
        "every sensor": changed(clean, **{n: 0.0 * clean[n].values for n in clean.sensors}),
    }


@pytest.mark.parametrize("words", unusable())
def test_check_says_what_a_comparison_would(words: str) -> None:
    recording = unusable()[words]
    told = [f"{f.text}. {f.mend}" for f in examine(recording, CRANE) if f.severity == "error"]
    assert sum(words in text for text in told) == 1
    with pytest.raises(CraneError) as refused:
        check_recording(recording, CRANE)
    assert any(text in str(refused.value) for text in told)


def test_what_only_a_diagnosis_refuses_is_a_note() -> None:
    clean, _ = with_the_package()
    (found,) = examine(clean.select(["u1", "u2", "p1"]), CRANE)
    assert found.severity == "note" and "`patu diagnose` will refuse it: found 1 sensor channels (p1)" in found.text


# -- the command -----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def wrong(tmp_path_factory: pytest.TempPathFactory) -> Path:
    file = tmp_path_factory.mktemp("wrong") / "wrong.csv"
    ALL["pressures of a cylinder exchanged"].recording.save(file)
    return file


def test_check_tells_writes_a_map_and_is_content_with_it(
    patu: Callable[..., SimpleNamespace], wrong: Path, tmp_path: Path
) -> None:
    table = tmp_path / "map.toml"
    done = patu("check", str(wrong), "--json", "-", "--write-map", str(table))
    assert done.status == 1
    finding = json.loads(done.out)["findings"][0]
    assert (finding["kind"], finding["channels"], finding["severity"]) == ("swapped", ["p3", "p4"], "error")
    assert finding["mend"] == "Type --map p3=p4 --map p4=p3."
    again = patu("check", str(wrong), "--map-file", str(table), "--json", "-")
    assert (again.status, json.loads(again.out)["findings"]) == (0, [])
    assert patu("check", str(wrong), "--map", "p3=p4", "--map", "p4=p3").status == 0


def test_one_map_is_not_written_for_recordings_that_need_two(
    patu: Callable[..., SimpleNamespace], wrong: Path, tmp_path: Path
) -> None:
    """The first recording's map was written, in silence."""
    clean, table, sound = with_the_package()[0], tmp_path / "map.toml", tmp_path / "sound.csv"
    clean.save(sound)
    done = patu("check", str(sound), str(wrong), "--write-map", str(table))
    assert done.status == 2 and not table.exists()
    assert f"{sound} and {wrong} need different maps for p3. Check them one at a time." in done.err
    twin = tmp_path / "twin.csv"
    twin.write_bytes(wrong.read_bytes())
    assert patu("check", str(twin), str(wrong), "--write-map", str(table)).status == 1
    assert patu("check", str(twin), str(wrong), "--map-file", str(table)).status == 0


@pytest.mark.parametrize("command", [("compare",), ("diagnose",), ("estimate",), ("improve", "-o", "new.toml")])
def test_errors_stop_what_would_explain_them(
    patu: Callable[..., SimpleNamespace],
    wrong: Path,
    command: tuple[str, ...],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    done = patu(command[0], str(wrong), *command[1:])
    assert done.status == 2
    for part in ("wrong.csv", "p3 and p4", "--map p3=p4", "--anyway"):
        assert part in done.err


def test_anyway_goes_on_and_tells(wrong: Path, capsys: pytest.CaptureFixture[str]) -> None:
    [measured] = load_checked([wrong], CRANE, None, None, anyway=True, needs=())
    told = capsys.readouterr().err
    assert measured.vouched and "p3 and p4" in told and "Type --map p3=p4" in told
    assert any("p3 and p4" in note for note in measured.notes)


def test_check_notes_what_was_left_out_of_the_file(patu: Callable[..., SimpleNamespace], tmp_path: Path) -> None:
    clean, _ = with_the_package()
    time, columns = clean.aligned()
    time = np.where(np.arange(len(time)) // 100 == 10, time[1000], time)
    table = {"time[s]": time} | {
        f"{n}[{clean[n].unit or '-'}]": c for n, c in zip(clean.channels, columns.T, strict=True)
    }
    write_table(tmp_path / "log.csv", table | {"p2[Pa]": np.full(len(time), np.nan), "temp": np.full(len(time), 40.0)})
    done = patu("check", str(tmp_path / "log.csv"), "--json", "-")
    assert done.status == 0 and json.loads(done.out)["findings"] == []
    notes = [note["text"] for note in json.loads(done.out)["notes"]]
    assert [n for n in notes if "u1 is missing" not in n and "u2 is missing" not in n] == [
        "column 'temp' was ignored",
        "channel p2 has no sample",
        "channels u1, u2, z1, z4, p1, p3, p4: 99 samples with a repeated time are left out, where the time "
        "stays at 5 s",
    ]
    said = patu("check", str(tmp_path / "log.csv")).out
    assert (
        "log.csv: note: column 'temp' was ignored.\n" in said
        and "nothing wrong was found in the channels that were read: u1, u2, z1" in said
    )


@pytest.mark.filterwarnings("error::RuntimeWarning")
def test_pressures_that_press_in_more_oil_than_there_is_are_told_without_a_warning() -> None:
    """No number is large enough for what a chamber would hold at values of Pa given as MPa."""
    clean, _ = with_the_package()
    first, *_ = vet(changed(clean, p1=1e6 * clean["p1"].values), CRANE)
    assert first.channels == ("p1",) and first.severity == "error"


def digger() -> Recording:
    """Return a recording of an excavator, some of whose channels have the names of a log crane's."""
    time = 0.01 * np.arange(400)
    values = dict.fromkeys(("u1", "u2", "u3"), 0.0 * time) | dict.fromkeys(("boom", "arm", "bucket"), 0.1 + 0.0 * time)
    values |= {n: 60e5 + 1e4 * np.random.default_rng(1).standard_normal(400) for n in ("p1", "p3", "p5")}
    return Recording.from_arrays("dig", time, values, layout=Crane.load("excavator").layout)


def test_check_says_which_crane_and_asks_whether_it_is_that(
    patu: Callable[..., SimpleNamespace], tmp_path: Path
) -> None:
    file = tmp_path / "dig.csv"
    digger().save(file)
    done = patu("check", str(file))
    assert done.out.startswith("Checked against the crane patu655:\n") and "warning: 5 of 9 columns" in done.out
    assert "are not channels of patu655, and none of z1, z4 is there" in done.out and "with --crane." in done.out
    right = patu("check", str(file), "--crane", "excavator")
    assert right.out.startswith("Checked against the crane excavator:\n") and "not channels" not in right.out
    assert digger().ignored == ()


def test_columns_of_a_loggers_own_make_no_other_crane(tmp_path: Path) -> None:
    """Its pose is there: the many others are the logger's."""
    clean, _ = with_the_package()
    time, columns = clean.aligned()
    table = {"time[s]": time} | {
        f"{n}[{clean[n].unit or '-'}]": c for n, c in zip(clean.channels, columns.T, strict=True)
    }
    write_table(tmp_path / "log.csv", table | {f"temp{k}": 40.0 + 0.0 * time for k in range(20)})
    logged = Recording.load(tmp_path / "log.csv")
    assert len(logged.ignored) == 20 and not [f for f in vet(logged, CRANE) if f.kind == "pose"]


def test_samples_are_what_they_say(patu: Callable[..., SimpleNamespace], tmp_path: Path) -> None:
    assert patu("sample", str(tmp_path)).status == 0
    files = {f.name for f in tmp_path.iterdir()}
    assert files == {"clean.csv", "hidden_learn.csv", "hidden_check.csv", "logger.csv", "logger.toml", "mistaken.csv"}
    for name in ("clean.csv", "hidden_learn.csv", "hidden_check.csv"):
        assert vet(Recording.load(tmp_path / name), CRANE) == []
    logged = Recording.load(tmp_path / "logger.csv", load_map(tmp_path / "logger.toml", CRANE.layout))
    assert logged["p1"].values == pytest.approx(Recording.load(tmp_path / "clean.csv")["p1"].values)
    found: list[Finding] = vet(Recording.load(tmp_path / "mistaken.csv"), CRANE)
    assert {f.kind for f in found if f.severity == "error"} == {"sign", "swapped"}


def test_a_balance_that_holds_nowhere_any_more_does_not_close():
    """A pressure that is read from a nearly empty chamber shuts no oil in: nothing speaks against that, nor for it."""
    reading = Reading("swapped", ("p2", "p3"), "exchanged", {"p2": Source("p3"), "p3": Source("p2")})
    before = {("trapped", "p3"): Misfit(0.97)}
    for after, closes in ((Misfit(0.0, clear=False, seen=False), False), (Misfit(0.0, clear=False), True)):
        assert Weighed(reading, 1.0, before, {("trapped", "p3"): after}).closes == closes


def driven(crane: Crane, lift: np.ndarray, tilt: np.ndarray, *sensors: str) -> Recording:
    """Return what sensors show of a crane whose spools were commanded every 10 ms."""
    time = 0.01 * np.arange(len(lift))
    commands = Recording("driven", {"u1": Channel(time, lift), "u2": Channel(time, tilt)})
    return simulate(crane, commands).recording().select(("u1", "u2", *sensors))


def pulse(begin: float, end: float, opening: float, length: float) -> np.ndarray:
    time = np.arange(0.0, length, 0.01)
    return np.where((time > begin) & (time < end), opening, 0.0)


@pytest.mark.parametrize(
    ("effect", "values", "wider"), [("pressure_compensation", {"dpc": 2e5}, 6.0), ("dead_band", {"upper": 0.22}, 1.0)]
)
def test_flows_are_those_of_the_valve_that_the_crane_file_describes(
    effect: str, values: dict[str, float], wider: float
) -> None:
    """Behind a compensator of 2 bar an orifice six times as large lets through what a usual one does; a spool that
    opens from 0.22 on lets through a sixth.
    """
    crane = Crane.load("patu655")
    wide = crane.with_parameters({"valves.lift.flow_coefficient": wider * crane["valves.lift.flow_coefficient"]})
    held = wide.with_effect(f"{effect}@lift", values)
    shown = driven(held, pulse(1.0, 4.0, 0.25, 6.0), np.zeros(600), "z1", "z4", "p1", "p2", "p3", "p4")
    off = [motions(Figures(c), Grid.of(shown, c))["flow", "p1"].off for c in (held, wide)]
    assert off[0] < 0.01 < 0.2 < off[1]


@pytest.mark.parametrize(("less_loaded", "air"), [(1e5, 0.3), (3e5, 0.3), (6e5, 0.02)])
def test_balances_close_on_a_machine_whose_oil_gives_off_air(less_loaded: float, air: float) -> None:
    """A chamber holds oil and the gas that its file describes; nearly empty, or for a moment, it tells nothing."""
    crane = Crane.load("patu655")
    low = replace(crane, initial=replace(crane.initial, less_loaded_pressure=less_loaded))
    airy = low.with_effect("released_air", {"alpha": air, "ps": 8e5})
    lift = pulse(1.0, 3.0, 0.25, 10.0) - pulse(4.0, 6.0, 0.25, 10.0)
    shown = driven(airy, lift, pulse(7.0, 9.0, 0.3, 10.0), "z1", "z4", "p1", "p2", "p3", "p4")
    found = motions(Figures(airy), Grid.of(shown, airy))
    assert {k: m for k, m in found.items() if m.off > (0.002 if k[0] == "flow" else 0.15)} == {}


def test_a_command_of_the_wrong_sign_is_not_taken_for_one_of_another_time_where_a_machine_goes_to_and_fro():
    """Half a period late, the commands of the other sign lead about the same way; shut-in oil tells the difference."""
    loader, time = Crane.load("loader"), np.arange(0.0, 12.0, 1e-3)
    ramp = np.array([0.0, 0.15, 0.9, 1.05])
    u = sum(np.interp(time, 0.7 + 1.8 * k + ramp, [0.0, 0.35, 0.35, 0.0]) * (-1) ** k for k in range(6))
    good = recorded("to and fro", loader, u[:, None], np.random.default_rng(3))
    assert not vet(good, loader)
    first, *more = vet(changed(good, u1=-good["u1"].values), loader)
    assert first.kind == "sign" and not more
    assert {*first.channels} < {"u1", "boom"}
    assert "almost as likely" in first.text  # with one cylinder nothing tells which of the two it is


@pytest.mark.parametrize("stiffness", [1.3e6, 5e6])
def test_a_structure_that_gives_way_is_no_angle_in_another_unit(stiffness: float) -> None:
    """Behind a soft structure the piston's oil hardly gives way to what the angle does while its valve is closed."""
    crane = Crane.load("patu655")
    soft = crane.with_effect("structural_compliance@lift", {"stiffness": stiffness})
    lift = pulse(1.0, 3.0, 0.25, 10.0) - pulse(4.0, 6.0, 0.25, 10.0)
    shown = driven(soft, lift, pulse(7.0, 8.0, 0.3, 10.0), "z1", "z4", "p1", "p2", "p3", "p4")
    assert [f.text for f in vet(shown, crane) if f.severity == "error"] == []
