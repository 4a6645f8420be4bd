"""The command line: help, exit statuses, messages, JSON, and that nothing heavy is imported before it is needed."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from crane_exudyn.errors import CraneError
from patu import main, options, output

#: what takes long to import, and what a mere help text must not need
HEAVY = ("numpy", "numba", "scipy", "exudyn", "matplotlib", "pint", "pydantic", "pyarrow", "h5py", "rich", "typer")


class Ended(SimpleNamespace):
    """A finished run: status, out, err."""


@pytest.fixture
def patu(capsys: pytest.CaptureFixture[str]) -> Callable[..., Ended]:
    """Run one command line in this process."""

    def call(*words: str) -> Ended:
        with pytest.raises(SystemExit) as leaving:
            main.run(words)
        captured = capsys.readouterr()
        return Ended(status=leaving.value.code, out=captured.out, err=captured.err)

    return call


def as_process(*words: str, code: str | None = None) -> subprocess.CompletedProcess[str]:
    start = ["-c", code] if code else ["-m", "patu"]
    return subprocess.run([sys.executable, *start, *words], capture_output=True, text=True, timeout=120)


# -- help ------------------------------------------------------------------------------------------------------------


def test_help_names_every_command_and_imports_nothing_heavy() -> None:
    code = f"import sys; from patu.main import help_text; print(help_text()); print([m for m in {HEAVY} if m in sys.modules])"
    done = as_process(code=code)
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1] == "[]"
    for name in main.COMMANDS:
        assert re.search(rf"^  {name} +\w", done.stdout, re.MULTILINE)


@pytest.mark.parametrize("words", [("--help",), ("-h",), ("help",)])
def test_help_is_an_answer(patu: Callable[..., Ended], words: tuple[str, ...]) -> None:
    assert (patu(*words).status, patu(*words).err) == (0, "")


def test_no_command_is_bad_input(patu: Callable[..., Ended]) -> None:
    assert patu().status == 2


def test_version(patu: Callable[..., Ended]) -> None:
    from crane_exudyn import __version__

    assert patu("--version").out == f"patu {__version__}\n"


@pytest.mark.parametrize("name", list(main.COMMANDS))
def test_every_command_has_help_with_an_example_and_json(patu: Callable[..., Ended], name: str) -> None:
    done = patu(name, "--help")
    assert done.status == 0
    assert f"Example: patu {name}" in done.out
    assert main.COMMANDS[name].example.startswith(f"patu {name}")
    assert "--json" in done.out


@pytest.mark.parametrize("name", list(main.COMMANDS))
def test_options_mean_the_same_everywhere(patu: Callable[..., Ended], name: str) -> None:
    out = patu(name, "--help").out
    assert "--effects" in out
    assert ("--crane" in out) == (name != "effects")
    if name in ("estimate", "compare", "diagnose", "improve", "crosscheck", "paper"):
        assert "--report" in out
    if "REC" in out and name != "benchmark":
        assert "--map" in out


def test_loading_a_command_imports_no_engine() -> None:
    """Help of any command comes before numba, Exudyn or matplotlib are imported."""
    for name in main.COMMANDS:
        code = f"import sys; from patu.main import load; load({name!r}); print([m for m in {HEAVY[1:8]} if m in sys.modules])"
        done = as_process(code=code)
        assert (done.stdout, done.returncode) == ("[]\n", 0), (name, done.stdout, done.stderr)


# -- bad input -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("simulte",), ["'simulte'", '"simulate"']),
        (("effects", "dead_bnd"), ["'dead_bnd'", '"dead_band"']),
        (("effects", "--effects", "nowhere.py"), ["nowhere.py", "no such file"]),
        (("effects", "--effects", "{good}"), ["good.csv", "no Python file"]),
        (("simulate", "--crane", "patu66"), ["'patu66'", "patu655"]),
        (("simulate", "--inputs", "nowhere.csv"), ["nowhere.csv", "no such file"]),
        (("simulate", "--inputs", "{folder}"), ["is a folder"]),
        (("simulate", "--inputs", "{half}"), ["half.csv, line 4", "3 fields, expected 4"]),
        (("simulate", "--inputs", "{good}", "--map", "z1"), ["--map 'z1'", "NAME=COLUMN[UNIT]"]),
        (("simulate", "--inputs", "{good}", "--map", "z1=a", "--map", "z1=b"), ["'z1' twice"]),
        (("simulate", "--inputs", "{good}", "-o", "{folder}/nowhere/run.csv"), ["nowhere", "does not exist"]),
        (("simulate", "--inputs", "{good}", "-o", "{folder}/run.xlsx"), ["run.xlsx", ".csv"]),
        (("effects", "--json", "{folder}/nowhere/e.json"), ["nowhere", "does not exist"]),
        (("effects", "--json", "{folder}"), ["irectory"]),
    ],
)
def test_bad_input_is_one_message_and_status_2(
    patu: Callable[..., Ended], tmp_path: Path, words: tuple[str, ...], parts: list[str]
) -> None:
    good = "time[s],u1,u2,z1[deg]\n0,0,0,10\n0.1,0,0,10\n0.2,0,0,10\n"
    (tmp_path / "good.csv").write_text(good)
    (tmp_path / "half.csv").write_text(good[: good.rindex(",0,10") + 2])
    places = {"folder": tmp_path, "good": tmp_path / "good.csv", "half": tmp_path / "half.csv"}
    done = patu(*(word.format(**places) for word in words))
    assert done.status == 2
    assert done.out == ""
    assert len(done.err.strip().splitlines()) == 1
    for part in parts:
        assert part in done.err
    assert "Traceback" not in done.err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["good.csv", "half.csv"]


def test_an_unknown_option_is_bad_input(patu: Callable[..., Ended]) -> None:
    done = patu("effects", "--nonsense")
    assert (done.status, done.out) == (2, "")
    assert "--nonsense" in done.err


def test_an_unreadable_file_is_bad_input(
    patu: Callable[..., Ended], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    usual = Path.open

    def refuse(path: Path, *arguments: Any, **options: Any) -> Any:
        if path.name == "locked.csv":
            raise PermissionError(13, "Permission denied", str(path))
        return usual(path, *arguments, **options)

    (tmp_path / "locked.csv").touch()
    monkeypatch.setattr(Path, "open", refuse)
    done = patu("simulate", "--inputs", str(tmp_path / "locked.csv"))
    assert (done.status, done.err) == (2, f"{tmp_path / 'locked.csv'}: Permission denied.\n")


def test_an_error_of_the_program_is_not_hidden(monkeypatch: pytest.MonkeyPatch) -> None:
    """Only bad input becomes a message; a bug keeps its traceback."""

    def broken(name: str) -> Callable[..., None]:
        def command() -> None:
            raise ZeroDivisionError

        return command

    monkeypatch.setattr(main, "load", broken)
    with pytest.raises(ZeroDivisionError):
        main.run(["demo"])


# -- interruption ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_an_interrupted_command_leaves_nothing_and_no_traceback(tmp_path: Path, number: int, status: int) -> None:
    code = (
        "import patu.main as m, time\n"
        "from crane_exudyn.files import replacing\n"
        "def command():\n"
        "    with replacing('run.csv') as temporary:\n"
        "        temporary.write_text('half'); print('ready', flush=True); time.sleep(60)\n"
        "m.load = lambda name: command\nm.run(['demo'])"
    )

    def heard() -> None:  # a suite that a shell runs in the background hands down that Ctrl-C is ignored
        signal.signal(signal.SIGINT, signal.default_int_handler)

    process = subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=tmp_path,
        preexec_fn=heard,
    )  # fmt: skip
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, err = process.communicate(timeout=30)
    assert process.returncode == status
    assert "Traceback" not in err and "half-written" in err
    assert list(tmp_path.iterdir()) == []


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-m", "patu", "effects"], stdout=write, stderr=subprocess.PIPE, timeout=60)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


# -- JSON and printing -----------------------------------------------------------------------------------------------


def test_json_on_standard_output_stands_there_alone(patu: Callable[..., Ended], tmp_path: Path) -> None:
    done = patu("effects", "dead_band", "--json", "-")
    document = json.loads(done.out)
    assert [p["name"] for p in document[0]["parameters"]] == ["lower", "upper"]
    patu("effects", "dead_band", "--json", str(tmp_path / "e.json"))
    assert json.loads((tmp_path / "e.json").read_text()) == document


def test_effects_lists_all_of_them(patu: Callable[..., Ended]) -> None:
    from crane_exudyn.effects import registry

    out = patu("effects").out
    for effect in registry.known():
        assert effect.name in out
    assert "seal_friction" in patu("effects", "seal_friction@tilt").out


def test_jsonable_takes_numpy_and_turns_nan_into_null() -> None:
    value = {"a": np.float64(np.nan), "b": np.array([1.0, np.inf]), 3: (np.int32(4), True), "p": Path("x")}
    assert output.jsonable(value) == {"a": None, "b": [1.0, None], "3": [4, True], "p": "x"}
    json.loads(output.json_text(value))


def test_progress_says_nothing_where_nobody_watches(capsys: pytest.CaptureFixture[str]) -> None:
    with output.progress("Working") as done:
        done(0.5)
    assert capsys.readouterr() == ("", "")


def test_a_users_effect_takes_part(tmp_path: Path) -> None:
    """In a process of its own: effects of a file stay registered for as long as the process lives."""
    (tmp_path / "mine.py").write_text(
        "from crane_exudyn.effects.base import Effect, Parameter\n"
        "class MyFriction(Effect):\n"
        '    """Friction of my own."""\n'
        "    name = 'my_friction'\n"
        "    places = ('lift', 'tilt')\n"
        "    parameters = (Parameter('c', 'N*s/m', 0.0, 0.0, 1e5, 1e3, 'damping'),)\n"
        "    @staticmethod\n"
        "    def cylinder_force(c, v, pa, pb, la, lb):\n"
        "        return -c * v\n"
    )
    done = as_process("effects", "my_friction", "--effects", str(tmp_path / "mine.py"))
    assert done.returncode == 0
    assert "Friction of my own" in done.stdout and "damping" in done.stdout


def test_map_options() -> None:
    assert options.parse_map(["z1=BoomAngle[deg]", " p1 = a=b "]) == {"z1": "BoomAngle[deg]", "p1": "a=b"}
    assert options.parse_map(None) == {}
    with pytest.raises(CraneError, match="NAME=COLUMN"):
        options.parse_map(["=x"])
