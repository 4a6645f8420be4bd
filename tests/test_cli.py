"""The command line: help, exit statuses, messages, JSON, and that nothing heavy is imported before it is needed."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from made_up import made_up
from numba.core import event

from crane_exudyn import compiled, errors
from crane_exudyn.errors import CraneError
from crane_exudyn.mapping import Column, parse_map
from patu import main, output

#: what takes long to import, and what a mere help text must not need
HEAVY = ("numpy", "numba", "scipy", "exudyn", "matplotlib", "pint", "pydantic", "pyarrow", "h5py", "rich", "typer")


def as_process(*words: str, code: str | None = None) -> subprocess.CompletedProcess[str]:
    start = ["-c", code] if code else ["-m", "patu"]
    return subprocess.run([sys.executable, *start, *words], capture_output=True, text=True, timeout=120)


# -- help ------------------------------------------------------------------------------------------------------------


def test_help_names_every_command_and_imports_nothing_heavy() -> None:
    code = (
        f"import sys; from patu.main import help_text; print(help_text()); print([m for m in {HEAVY} if m in "
        "sys.modules])"
    )
    done = as_process(code=code)
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1] == "[]"
    for name in main.COMMANDS:
        assert re.search(rf"^  {name} +\w", done.stdout, re.MULTILINE)


@pytest.mark.parametrize("words", [("--help",), ("-h",), ("help",)])
def test_help_is_an_answer(patu: Callable[..., SimpleNamespace], words: tuple[str, ...]) -> None:
    assert (patu(*words).status, patu(*words).err) == (0, "")


def test_no_command_is_bad_input(patu: Callable[..., SimpleNamespace]) -> None:
    assert patu().status == 2


def test_version(patu: Callable[..., SimpleNamespace]) -> None:
    from crane_exudyn import __version__

    assert patu("--version").out == f"patu {__version__}\n"


@pytest.mark.parametrize("name", list(main.COMMANDS))
def test_every_command_has_help_with_an_example_and_json(patu: Callable[..., SimpleNamespace], name: str) -> None:
    done = patu(name, "--help")
    assert done.status == 0
    assert f"Example: patu {name}" in done.out
    assert main.COMMANDS[name].example.startswith(f"patu {name}")
    assert "--json" in done.out


@pytest.mark.parametrize("name", list(main.COMMANDS))
def test_options_mean_the_same_everywhere(patu: Callable[..., SimpleNamespace], name: str) -> None:
    out = patu(name, "--help").out
    assert "--effects" in out
    assert "--crane" in out
    if name in ("estimate", "compare", "diagnose", "improve", "crosscheck", "paper"):
        assert "--report" in out
    if "REC" in out and name != "benchmark":
        assert "--map" in out


def test_loading_a_command_imports_no_engine() -> None:
    """Help of any command comes before numba, Exudyn or matplotlib are imported."""
    for name in main.COMMANDS:
        code = (
            f"import sys; from patu.main import load; load({name!r}); print([m for m in {HEAVY[1:8]} if m in "
            "sys.modules])"
        )
        done = as_process(code=code)
        assert (done.stdout, done.returncode) == ("[]\n", 0), (name, done.stdout, done.stderr)


# -- bad input -------------------------------------------------------------------------------------------------------


def test_effects_are_listed_with_the_places_of_the_crane(tmp_path: Path, patu: Callable[..., SimpleNamespace]) -> None:
    made_up().save(tmp_path / "made_up.toml")
    done = patu("effects", "internal_leakage", "--crane", str(tmp_path / "made_up.toml"))
    assert "Places: hoist slide curl" in done.out and "internal_leakage@hoist" in done.out
    refused = patu("add", "internal_leakage@lift", "--crane", str(tmp_path / "made_up.toml"))
    assert refused.status == 2 and "hoist, slide, curl" in refused.err


@pytest.mark.parametrize(
    ("words", "parts"),
    [
        (("simulte",), ["'simulte'", '"simulate"']),
        (("effects", "dead_bnd"), ["'dead_bnd'", '"dead_band"']),
        (("effects", "--effects", "nowhere.py"), ["nowhere.py", "no such file"]),
        (("effects", "--effects", "{good}"), ["good.csv", "not a Python file"]),
        (("simulate", "--crane", "patu66"), ["'patu66'", "patu655"]),
        (("simulate", "--inputs", "nowhere.csv"), ["nowhere.csv", "no such file"]),
        (("simulate", "--inputs", "{folder}"), ["is a folder"]),
        (("simulate", "--inputs", "{half}"), ["half.csv, line 4", "3 fields, expected 4"]),
        (("simulate", "--inputs", "{good}", "--map", "z1"), ["--map 'z1'", "NAME=COLUMN[UNIT]"]),
        (("simulate", "--inputs", "{good}", "--map", "z1=a", "--map", "z1=b"), ["'z1' twice"]),
        (("simulate", "--inputs", "{good}", "-o", "{folder}/nowhere/run.csv"), ["nowhere", "does not exist"]),
        (("simulate", "--inputs", "{good}", "-o", "{folder}/run.xlsx"), ["run.xlsx", ".csv"]),
        (("effects", "--json", "{folder}/nowhere/e.json"), ["nowhere", "does not exist"]),
        (("effects", "--json", "{folder}"), ["is a folder"]),
    ],
)
def test_bad_input_is_one_message_and_status_2(
    patu: Callable[..., SimpleNamespace], tmp_path: Path, words: tuple[str, ...], parts: list[str]
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


def test_an_unknown_option_is_bad_input(patu: Callable[..., SimpleNamespace]) -> None:
    done = patu("effects", "--nonsense")
    assert (done.status, done.out) == (2, "")
    assert "--nonsense" in done.err


def test_an_unreadable_file_is_bad_input(
    patu: Callable[..., SimpleNamespace], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
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


def a_command(monkeypatch: pytest.MonkeyPatch, does: Callable[[], object]) -> None:
    """Let `patu demo` do something else."""

    def command() -> None:
        does()

    monkeypatch.setattr(main, "load", lambda name: command)


def test_a_fault_of_the_program_is_one_message_that_names_the_file_with_its_traceback(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))

    def fail() -> None:
        with errors.doing("reading lift.csv"), output.progress("Filter"):
            raise ZeroDivisionError("by nothing")

    a_command(monkeypatch, fail)
    done = patu("demo")
    assert done.status == 2 and len(done.err.splitlines()) == 1
    for part in ("patu demo failed (Filter, reading lift.csv)", "ZeroDivisionError: by nothing"):
        assert part in done.err
    (file,) = tmp_path.iterdir()
    assert str(file) in done.err
    assert "Traceback" in file.read_text() and "patu demo" in file.read_text()


@pytest.mark.parametrize(
    ("problem", "said"),
    [
        (OSError(28, "No space left on device", "run.csv"), "run.csv: No space left on device.\n"),
        (OSError(12, "Cannot allocate memory"), "patu demo: Cannot allocate memory.\n"),
        (MemoryError("Unable to allocate 7 TiB"), "patu demo: there is not enough memory. Unable to allocate 7 TiB\n"),
    ],
)
def test_what_the_machine_refuses_is_one_message(
    patu: Callable[..., SimpleNamespace], monkeypatch: pytest.MonkeyPatch, problem: Exception, said: str
) -> None:
    def fail() -> None:
        raise problem

    a_command(monkeypatch, fail)
    assert (patu("demo").status, patu("demo").err) == (2, said)


@pytest.mark.parametrize(
    "words", [("--duration", "inf"), ("--error", "nan"), ("--jobs", "0"), ("--step", "inf"), ("--step", "1e-9")]
)
def test_numbers_that_are_none_are_refused(patu: Callable[..., SimpleNamespace], words: tuple[str, str]) -> None:
    done = patu("montecarlo", *words)
    assert done.status == 2 and words[0] in done.err and "Traceback" not in done.err


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


STUCK = {
    # numba turns an exception that a signal's handler raised while compiled code is called into a SystemError
    "changed": "    try: time.sleep(60)\n    except BaseException as problem: raise SystemError('result with an "
    "exception set') from problem\n",
    "swallowed": "    try: time.sleep(60)\n    except BaseException: pass\n    time.sleep(60)\n",
    "waiting": "    with ThreadPoolExecutor(1) as pool: pool.submit(time.sleep, 60)\n",
}


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("how", list(STUCK))
def test_a_signal_ends_the_program_whatever_becomes_of_its_exception(how: str, number: signal.Signals) -> None:
    code = (
        "import patu.main as m, time, signal\n"
        "from concurrent.futures import ThreadPoolExecutor\n"
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "def command():\n    print('ready', flush=True)\n"
        + STUCK[how]
        + "m.load = lambda name: command\nm.run(['demo'])"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None and process.stdout.readline() == "ready\n"
    process.send_signal(number)
    _, err = process.communicate(timeout=15)
    assert (process.returncode, len(err.splitlines())) == (128 + number, 1), err


def test_an_ignored_interrupt_stays_ignored() -> None:
    """As a shell asks for what it starts in the background."""
    code = (
        "import patu.main as m, os, signal\n"
        "signal.signal(signal.SIGINT, signal.SIG_IGN)\n"
        "m.load = lambda name: lambda: os.kill(os.getpid(), signal.SIGINT)\nm.run(['demo'])"
    )
    assert as_process(code=code).returncode == 0


@pytest.mark.parametrize("encoding", ["ascii", "latin-1"])
def test_a_terminal_without_all_signs_gets_others(encoding: str, tmp_path: Path) -> None:
    environment = os.environ | {"PYTHONIOENCODING": encoding}
    done = subprocess.run(
        [sys.executable, "-m", "patu", "effects", "sensor_lag", "--json", "-"],
        capture_output=True, timeout=60, env=environment,
    )  # fmt: skip
    assert (done.returncode, done.stderr) == (0, b"")
    json.loads(done.stdout.decode("utf-8"))
    code = "import patu.main as m\nm.load = lambda name: lambda: print('ż1 ± 2° → … \\udcff 漢')\nm.run(['demo'])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60, env=environment)
    wanted = "dz1 +- 2deg -> ... ? ?" if encoding == "ascii" else "dz1 ± 2° -> ... ? ?"
    assert (done.stderr, done.stdout.decode(encoding)) == (b"", wanted + "\n")


def test_a_full_standard_output_is_one_message() -> None:
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [sys.executable, "-m", "patu", "effects"], stdout=full, stderr=subprocess.PIPE, timeout=60
        )
    assert (done.returncode, done.stderr) == (2, b"standard output: No space left on device.\n")


def test_a_reader_that_has_seen_enough_is_no_error() -> None:
    read, write = os.pipe()
    os.close(read)
    done = subprocess.run([sys.executable, "-m", "patu", "effects"], stdout=write, stderr=subprocess.PIPE, timeout=60)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")


def test_what_was_asked_for_is_written_though_the_reader_has_seen_enough(tmp_path: Path) -> None:
    read, write = os.pipe()
    os.close(read)
    words = ["effects", "dead_band", "--json", str(tmp_path / "e.json")]
    done = subprocess.run([sys.executable, "-m", "patu", *words], stdout=write, stderr=subprocess.PIPE, timeout=60)
    os.close(write)
    assert (done.returncode, done.stderr) == (0, b"")
    assert json.loads((tmp_path / "e.json").read_text())[0]["name"] == "dead_band"


# -- JSON and printing -----------------------------------------------------------------------------------------------


def test_json_on_standard_output_stands_there_alone(patu: Callable[..., SimpleNamespace], tmp_path: Path) -> None:
    done = patu("effects", "dead_band", "--json", "-")
    document = json.loads(done.out)
    assert [p["name"] for p in document[0]["parameters"]] == ["lower", "upper"]
    patu("effects", "dead_band", "--json", str(tmp_path / "e.json"))
    assert json.loads((tmp_path / "e.json").read_text()) == document


def test_effects_lists_all_of_them(patu: Callable[..., SimpleNamespace]) -> None:
    from crane_exudyn.effects import registry

    out = patu("effects").out
    for effect in registry.known():
        assert effect.name in out
    assert "seal_friction" in patu("effects", "seal_friction@tilt").out


def test_jsonable_takes_numpy_and_turns_nan_into_null() -> None:
    value = {"a": np.float64(np.nan), "b": np.array([1.0, np.inf]), 3: (np.int32(4), True), "p": Path("x")}
    assert output.jsonable(value) == {"a": None, "b": [1.0, None], "3": [4, True], "p": "x"}
    json.loads(output.json_text(value))


def test_piped_progress_is_a_line_every_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with output.progress("Working") as done:  # nothing in the first ten seconds
        done(0.5)
    assert capsys.readouterr() == ("", "")
    monkeypatch.setattr(output, "PAUSE", 0.05)
    with output.progress("Working") as done:
        done(0.5, "on it")
        time.sleep(0.3)
    said = capsys.readouterr()
    assert said.out == "" and "Working: on it, 50%, 0 s" in said.err.splitlines()


def test_a_compilation_is_announced_once(caplog: pytest.LogCaptureFixture) -> None:
    event.unregister("numba:compile", compiled.ANNOUNCEMENT)  # it has spoken, or not, for other tests
    try:
        with event.install_listener("numba:compile", compiled.Announcement(after=0.0)):
            for _ in range(2):
                inner = compiled.njit(lambda x: x + 1.0, cache=False)
                assert compiled.njit(lambda x, inner=inner: inner(x) + 1.0, cache=False)(1.0) == 3.0
    finally:
        event.register("numba:compile", compiled.ANNOUNCEMENT)
    assert ["Compiling the equations" in r.message for r in caplog.records] == [True]


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


@pytest.mark.parametrize(
    "words", [("estimate", "{good}"), ("compare", "{good}"), ("simulate",), ("render", "-o", "{folder}/x.png")]
)
def test_a_users_effects_are_known_before_anything_is_compiled(tmp_path: Path, words: tuple[str, ...]) -> None:
    good, own = tmp_path / "good.csv", Path(__file__).parent / "own_sensors.py"
    good.write_text("time,u1,u2,z1\n0,0,0,0\n1,0,0,0\n")
    words = tuple(w.format(good=good, folder=tmp_path) for w in words)
    done = as_process(*words, "--effects", str(own), "--crane", "nothing.toml")
    assert done.returncode == 2 and done.stderr.startswith("There is no crane 'nothing.toml'")


def test_map_options() -> None:
    given = parse_map(["z1=BoomAngle[deg]", " p1 = a=b ", "z4=-Arm"])
    assert given == {"z1": Column("BoomAngle[deg]"), "p1": Column("a=b"), "z4": Column("Arm", factor=-1.0)}
    assert parse_map(None) == {}
    for entry in ("=x", "z1=-"):
        with pytest.raises(CraneError, match="NAME=COLUMN"):
            parse_map([entry])
