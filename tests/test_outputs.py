"""Outputs of commands: nothing is overwritten that is not the program's own, and no result is lost."""

from __future__ import annotations

import errno
import gzip
import json
import os
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import get_type_hints

import numpy as np
import pytest

from crane_exudyn import Crane, Recording, files, plots
from crane_exudyn.errors import CraneError
from patu import add, calls, main, outputs
from patu.output import Printer
from validation import diagnosis, sample
from validation.history import added
from validation.selection import fitted as fitting

GOOD = "time[s],u1,u2,z1[deg],z4[deg]\n" + "".join(f"{0.01 * k:.2f},0,0,10,-40\n" for k in range(21))


@pytest.fixture
def patu(
    patu: Callable[..., SimpleNamespace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> Callable[..., SimpleNamespace]:
    """Run one command line in an empty folder that holds the recording l.csv."""
    monkeypatch.chdir(tmp_path)
    Path("l.csv").write_text(GOOD)
    return patu


SIMULATE = ("simulate", "--inputs", "l.csv", "--engine", "semi-recursive")


# -- an input is never an output -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "words",
    [
        (*SIMULATE, "-o", "l.csv"),
        (*SIMULATE, "-o", "./x/../l.csv"),
        (*SIMULATE, "-o", "soft.csv"),
        (*SIMULATE, "-o", "hard.csv"),
        (*SIMULATE, "--json", "l.csv"),
        (*SIMULATE, "--crane", "own.toml", "--json", "own.toml"),
        ("estimate", "l.csv", "-o", "l.csv"),
        ("estimate", "l.csv", "--effects", "mine.py", "--json", "mine.py"),
        ("compare", "l.csv", "--json", "l.csv"),
        ("compare", "where.png", "-o", "."),
        ("diagnose", "other.csv", "--check", "l.csv", "--json", "l.csv"),
        ("improve", "l.csv", "-o", "l.csv"),
        ("add", "dead_band@tilt", "--fit", "l.csv", "-o", "l.csv"),
        ("add", "dead_band@tilt", "--crane", "own.toml", "-o", "own.toml"),
        ("render", "other.csv", "--ghost", "a=l.csv", "--save-solution", "l.csv"),
    ],
)
def test_an_input_is_never_an_output(patu: Callable[..., SimpleNamespace], words: tuple[str, ...]) -> None:
    os.symlink("l.csv", "soft.csv")
    os.link("l.csv", "hard.csv")
    Path("x").mkdir()
    for name in ("other.csv", "own.toml", "mine.py", "where.png"):
        Path(name).write_text(GOOD)
    done = patu(*words, "--force")
    assert done.status == 2 and "read by this command" in done.err and len(done.err.splitlines()) == 1
    assert all(Path(n).read_text() == GOOD for n in ("l.csv", "other.csv", "own.toml", "mine.py", "where.png"))


@pytest.mark.parametrize(
    "words",
    [
        (*SIMULATE, "-o", "run.csv", "--json", "./run.csv"),
        ("estimate", "l.csv", "--json", "new/report.html", "--report", "new"),
        ("estimate", "l.csv", "--json", "out", "--report", "out"),
        ("estimate", "l.csv", "-o", "x.csv", "--report", "x.csv/r"),
        ("compare", "l.csv", "--json", "new/where.png", "-o", "new"),
        ("estimate", "l.csv", "-o", "to-l.csv", "--json", "to-l-too.csv"),
    ],
)
def test_two_outputs_never_share_a_file(patu: Callable[..., SimpleNamespace], words: tuple[str, ...]) -> None:
    Path("new").mkdir()
    for name in ("to-l.csv", "to-l-too.csv"):
        os.symlink("new/one.csv", name)
    done = patu(*words, "--force")
    assert done.status == 2 and "the same file" in done.err and list(Path("new").iterdir()) == []


# -- files that stand there already ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["run.csv", "run.csv.gz", "run.mat", "run.parquet"])
def test_a_file_is_replaced_if_the_program_wrote_it_and_nobody_changed_it(
    patu: Callable[..., SimpleNamespace], name: str
) -> None:
    file = Path(name)
    assert patu(*SIMULATE, "-o", name).status == 0
    assert patu(*SIMULATE, "-o", name).status == 0
    file.rename(f"moved-{name}")
    assert patu(*SIMULATE, "-o", f"moved-{name}").status == 0
    file.write_bytes(Path(f"moved-{name}").read_bytes() + b"\n")
    edited = file.read_bytes()
    done = patu(*SIMULATE, "-o", name)
    assert done.status == 2 and name in done.err and "--force" in done.err
    assert file.read_bytes() == edited
    assert patu(*SIMULATE, "-o", name, "--force").status == 0
    assert file.read_bytes() != edited


@pytest.mark.parametrize(
    ("target", "words"),
    [
        ("e.json", ("effects", "--json", "e.json")),
        ("c.toml", ("add", "dead_band@tilt", "-o", "c.toml")),
        ("out/report.html", ("demo", "-o", "out")),
        ("out/improved.toml", ("demo", "-o", "out")),
        ("r/report.html", ("estimate", "l.csv", "--report", "r")),
        ("out/figure5_own.png", ("paper", "-o", "out")),
    ],
)
def test_what_somebody_else_wrote_is_not_replaced(
    patu: Callable[..., SimpleNamespace], target: str, words: tuple[str, ...]
) -> None:
    file = Path(target)
    file.parent.mkdir(exist_ok=True)
    file.write_text("# written by patu, or so it says\n")
    done = patu(*words)
    assert done.status == 2 and target in done.err and "--force" in done.err and done.out == ""
    assert file.read_text() == "# written by patu, or so it says\n"


def test_an_empty_file_holds_nothing_to_lose(patu: Callable[..., SimpleNamespace]) -> None:
    Path("e.json").touch()
    assert patu("effects", "--json", "e.json").status == 0


def test_where_the_list_cannot_be_kept_it_is_said(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(outputs, "written_list", lambda: Path("l.csv", "written"))
    done = patu("effects", "--json", "e.json")
    assert done.status == 0 and "--force" in done.err and json.loads(Path("e.json").read_text())
    assert patu("effects", "--json", "e.json").status == 2


@pytest.mark.parametrize("name", list(main.COMMANDS))
def test_every_file_of_every_command_is_read_or_written(name: str) -> None:
    """A new option that names a file must say what it does with it, or nothing would protect that file."""
    command = main.load(name)
    found = calls.options_of(command)
    for parameter, hint in get_type_hints(command).items():
        if "Path" in str(hint):
            assert found[parameter].role is not None, f"patu {name}: {found[parameter].flag}"
    assert found["json"].flag == "--json" and isinstance(found["json"].role, outputs.Writes)


# -- places are checked before the work ------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("estimate", "l.csv", "--plot", "nodir/x.png"), "nodir"),
        (("estimate", "l.csv", "--plot", "x.xyz"), ".png"),
        (("estimate", "l.csv", "-o", "folder"), "folder"),
        (("estimate", "l.csv", "--report", "l.csv"), "l.csv"),
        (("estimate", "l.csv", "--report", "/proc/report"), "/proc"),
        (("estimate", "l.csv", "--json", "x" * 300), "File name too long"),
        (("diagnose", "l.csv", "--plot", "x.xyz"), ".svg"),
        (("improve", "l.csv", "-o", "new.toml", "--plot", "nodir/x.png"), "nodir"),
        (("improve", "l.csv", "-o", "folder"), "folder"),
        (("add", "dead_band@tilt", "-o", "/dev/null"), "device"),
        (("render", "l.csv", "-o", "film.avi"), ".gif"),
        (("render", "l.csv", "--save-solution", "nodir/x.txt"), "nodir"),
        (("montecarlo", "-o", "nodir/runs.jsonl"), "nodir"),
        (("crosscheck", "--json", "/sys/x.json"), "/sys"),
    ],
)
def test_a_place_that_cannot_be_written_to_is_refused_before_the_work(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], part: str
) -> None:
    Path("folder").mkdir()
    monkeypatch.setattr(Recording, "load", lambda *a, **k: pytest.fail("work has begun"))
    done = patu(*words)
    assert done.status == 2 and part in done.err and len(done.err.splitlines()) == 1
    assert sorted(p.name for p in Path().iterdir()) == ["folder", "l.csv"]
    assert not Path("/dev/null").is_file()


def test_a_link_stays_a_link_and_long_names_are_written(tmp_path: Path) -> None:
    os.symlink("real.txt", tmp_path / "link.txt")
    files.write_text(tmp_path / "link.txt", "new")
    assert (tmp_path / "real.txt").read_text() == "new" and (tmp_path / "link.txt").is_symlink()
    files.write_text(tmp_path / ("x" * 250), "new")
    with files.replacing(tmp_path / "run.csv.gz") as temporary:
        assert temporary.name.endswith(".csv.gz")
        temporary.write_bytes(gzip.compress(b""))


# -- results that could not be saved ---------------------------------------------------------------------------------


@pytest.fixture
def full(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Let every write into the working folder end as on a disk that is full."""
    usual = files.temporary_beside

    def beside(target: Path) -> Path:
        if target.parent == tmp_path:
            raise OSError(errno.ENOSPC, "No space left on device")
        return usual(target)

    monkeypatch.setattr(files, "temporary_beside", beside)


def test_a_result_that_could_not_be_saved_is_printed_or_saved_elsewhere(
    patu: Callable[..., SimpleNamespace], full: None
) -> None:
    done = patu(*SIMULATE, "-o", "run.csv", "--json", "run.json")
    assert done.status == 2 and "Traceback" not in done.err
    first, second = done.err.splitlines()
    assert first.startswith("run.csv: cannot be written: No space left on device. The result is in /")
    assert second.startswith("run.json: cannot be written: No space left on device.")
    assert Recording.load(first.split()[-2]).has("z1")
    assert json.loads(done.out[done.out.index("{") :])["instants"] == 21


def test_a_crane_that_could_not_be_saved_is_printed(patu: Callable[..., SimpleNamespace], full: None) -> None:
    done = patu("add", "dead_band@tilt", "-o", "new.toml")
    assert done.status == 2 and "new.toml" in done.err
    Path("kept.toml").write_text(done.out)
    assert [e.key for e in Crane.load("kept.toml").effects] == ["dead_band@tilt"]


def test_a_name_with_any_signs_is_drawn_as_it_is() -> None:
    made = plots.figure()
    plots.entitle(made, r"a$\x{b.csv against a$\x{b.csv")
    plots.draw_lines(made.axes[0], np.arange(3.0), {r"$\x{$": np.arange(3.0)}, channel="z1")
    plots.legend_above(made)
    assert plots.png(made).startswith(b"\x89PNG")


def test_a_figure_that_cannot_be_drawn_does_not_lose_the_rest(tmp_path: Path) -> None:
    def fail(path: Path) -> None:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError), outputs.saving(Printer()) as save:
        save(tmp_path / "x.png", fail)
        save(tmp_path / "x.txt", lambda path: files.write_text(path, "kept"))
    assert (tmp_path / "x.txt").read_text() == "kept"


def test_a_failing_writer_names_the_file_that_it_was_to_write(tmp_path: Path) -> None:
    with (
        pytest.raises(CraneError, match=r"run\.csv: cannot be written: No space left"),
        files.replacing(tmp_path / "run.csv"),
    ):
        raise OSError(errno.ENOSPC, "No space left on device")
    assert list(tmp_path.iterdir()) == []


# -- a fit that did not help -----------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("evidence", "after", "without", "helped"),
    [
        (-np.inf, 1.5, -np.inf, False),
        (120.0, 2.5, 50.0, False),
        (np.nan, 1.0, 50.0, False),
        (120.0, 1.5, 115.0, False),  # parameters alone do it, as where the effect ends at its neutral value
        (120.0, 1.5, 100.0, True),
    ],
)
def test_a_fit_that_did_not_help_writes_a_crane_only_if_asked(
    patu: Callable[..., SimpleNamespace],
    monkeypatch: pytest.MonkeyPatch,
    evidence: float,
    after: float,
    without: float,
    helped: bool,
) -> None:
    errors = {"error_before": 2.0, "error_after": after, "error_without": 1.6, "evidence_without": without}
    found = {"parameters": {"lower": {"value": 0.1, "std": 0.02}}, "evidence": evidence}

    def fitted(crane: Crane, key: str, *_: object) -> tuple[Crane, dict[str, object]]:
        loaded = crane.with_parameters({"payload.mass": 61.0})
        return added(crane, loaded.with_effect(key, {"lower": 0.1})), found | errors

    monkeypatch.setattr(fitting, "fitted_effect", fitted)
    monkeypatch.setattr(add, "load_checked", lambda *_, **__: [None])
    words = ("add", "dead_band@tilt", "--fit", "l.csv", "-o", "new.toml", "--json", "new.json")
    done = patu(*words)
    assert done.status == (0 if helped else 1)
    assert Path("new.toml").exists() == helped
    assert json.loads(Path("new.json").read_text())["helped"] is helped
    if helped:
        printed = patu(*words[:4])
        assert printed.out == Path("new.toml").read_text() and "open-loop error" in printed.err
        printed = patu("remove", "dead_band@tilt", "--crane", "new.toml")
        Path("printed.toml").write_text(printed.out)
        assert Crane.load("printed.toml").effects == () and "Back to the old values" in printed.err
        assert "dead_band@tilt: lower = 0.10 ± 0.04; open-loop error 2 -> " in done.out
        assert "Changed with it: payload.mass 25 kg -> 61 kg" in done.out
        assert "Back to the old values: payload.mass 61 kg -> 25 kg" in patu(
            "remove", "dead_band@tilt", "--crane", "new.toml", "-o", "old.toml"
        ).out  # fmt: skip
    else:
        assert "did not help: error 2 before" in done.out and "--even-if-worse" in done.out
        assert patu(*words[:4]).out == ""
        assert patu(*words, "--even-if-worse").status == 1
        assert Crane.load("new.toml").effect("dead_band@tilt") is not None


@pytest.mark.parametrize("command", ["add", "remove"])
def test_json_and_a_crane_do_not_share_standard_output(patu: Callable[..., SimpleNamespace], command: str) -> None:
    done = patu(command, "dead_band@tilt", "--json", "-")
    assert (done.status, done.out) == (2, "") and "give -o NEW.toml" in done.err


@pytest.mark.parametrize(
    "words",
    [
        ("add", "dead_band@tilt", "--map", "z1=foo"),
        ("add", "dead_band@tilt", "--anyway"),
        ("simulate", "--map-file", "l.csv"),
        ("simulate", "--start-from-recording"),
    ],
)
def test_options_that_would_change_nothing_are_refused(patu: Callable[..., SimpleNamespace], words: list[str]) -> None:
    done = patu(*words)
    assert done.status == 2 and "would change nothing: no" in done.err


# -- what to go on with ----------------------------------------------------------------------------------------------


def test_a_hint_carries_the_options_of_the_run(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch
) -> None:
    Crane.load("patu655").save("own.toml")
    Path("map.toml").write_text('[z1]\ncolumn = "z1"\nunit = "deg"\n')

    def nothing_known(crane: Crane, recordings: list[Recording], *_: object, **__: object) -> diagnosis.Diagnosis:
        return diagnosis.Diagnosis("l", "unknown", crane, crane, {}, (), error_before=3.0)

    monkeypatch.setattr(diagnosis, "diagnose", nothing_known)
    options = "--per-recording payload.mass --map-file map.toml --crane own.toml"
    done = patu("diagnose", "l.csv", *options.split(), "--report", "r")
    assert f"Next step: patu learn l.csv {options}   looks for a law" in done.out, done.err
    page = Path("r/report.html").read_text()
    assert f"<code>patu improve l.csv {options} -o new.toml</code> adds effects one" in page


def test_samples_of_a_crane_are_tried_with_that_crane(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch
) -> None:
    Crane.load("loader").save("my.toml")

    def write(path: Path) -> None:
        path.write_text(GOOD)

    logger = sample.Sample("logger.csv", "a logger's", write, "check", "logger.csv", {"--map-file": "logger.toml"})
    monkeypatch.setattr(sample, "samples", lambda crane: [logger])
    done = patu("sample", "play", "--crane", "my.toml", "--json", "s.json")
    told = "patu check play/logger.csv --map-file play/logger.toml --crane my.toml"
    assert f"A logger's. Try: {told}\n" in done.out, done.err
    assert json.loads(Path("s.json").read_text())["files"]["logger.csv"]["try"] == told


def test_an_error_that_names_no_file_says_which_were_read(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object, **__: object) -> None:
        raise CraneError("patu655: no start is found.")

    monkeypatch.setattr(diagnosis, "diagnose", fail)
    done = patu("diagnose", "l.csv")
    assert (done.status, done.err) == (2, "patu655: no start is found. Files read: l.csv.\n")


@pytest.mark.parametrize(
    "words",
    [
        ("add", "internal_leakag@lift"),
        ("add", "internal_leakage@lift", "--set", "K=3"),
        ("remove", "dead_band@tilt"),
        ("estimate", "l.csv", "--method", "sorcery"),
        ("diagnose", "l.csv", "--per-recording", "payload.mas"),
    ],
)
def test_an_error_about_what_was_typed_names_no_files(patu: Callable[..., SimpleNamespace], words: list[str]) -> None:
    Crane.load("patu655").save("my.toml")
    done = patu(*words, "--crane", "my.toml")
    assert done.status == 2 and "Files read" not in done.err, done.err


def test_a_recording_or_a_map_file_that_is_not_there_is_all_that_is_told(patu: Callable[..., SimpleNamespace]) -> None:
    done = patu("check", "gone.csv")
    assert (done.status, done.out) == (2, "") and done.err.startswith("gone.csv: there is no such file.")
    done = patu("check", "l.csv", "--map-file", "gone.toml")
    assert (done.status, done.out) == (2, "") and done.err.startswith("gone.toml: there is no such map file.")
    assert done.err.count("\n") == 1 and "Files read" not in done.err


def test_an_effect_without_its_place_is_told_with_the_places_and_an_example(
    patu: Callable[..., SimpleNamespace],
) -> None:
    assert patu("add", "internal_leakage").err == (
        "Effect 'internal_leakage' needs a place. Places: lift, tilt. Write internal_leakage@lift.\n"
    )
    assert patu("add", "internal_leakage@til").err.endswith("Write internal_leakage@tilt.\n")
    assert patu("add", "pump_droop@lift").err.endswith("not at 'lift'. Write pump_droop.\n")
