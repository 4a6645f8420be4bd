"""Compiling before a command begins: once, in processes of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numba
import numpy as np
import pytest

from crane_exudyn import compiled, vetting
from patu import compiling
from validation import workers
from validation.semi_recursive import sensitivity


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[str, ...]]:
    """What would have been compiled, each entry in one process, in a cache that is empty at first."""
    found: list[tuple[str, ...]] = []

    @contextmanager
    def record(tasks: Sequence[tuple[Any, ...]]) -> Iterator[Callable[[], bool]]:
        for _, *parts in tasks:
            found.append(tuple(parts))
            compiling.run_parts(*parts)
        yield lambda: False

    for part in ("_simulate", "_estimate", "_compare"):
        monkeypatch.setattr(compiling, part, lambda *given: None)
    monkeypatch.setattr(vetting, "vet", lambda *given: [])
    monkeypatch.setattr(workers, "own_processes", record)
    monkeypatch.setattr(compiled, "cache_folder", lambda package: tmp_path / package)
    return found


def test_each_part_is_compiled_once(asked: list[tuple[str, ...]]) -> None:
    compiling.compile_for("semi-recursive")
    compiling.compile_for("semi-recursive")
    assert asked == [("semi-recursive",)]
    compiling.compile_for("exudyn", "semi-recursive", "filter", "fit")
    compiling.compile_for("exudyn", "fit")
    assert asked[1:] == [("semi-recursive", "filter", "fit"), ("exudyn",)]


def test_what_shares_much_is_compiled_in_one_process(asked: list[tuple[str, ...]]) -> None:
    compiling.compile_for("check", "semi-recursive", "filter", "fit")
    assert asked == [("semi-recursive", "filter", "fit"), ("check",)]


def test_what_was_cut_off_is_not_called_compiled(
    asked: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def ended(*given: object) -> None:
        raise MemoryError

    monkeypatch.setattr(compiling, "_simulate", ended)
    with pytest.raises(MemoryError):
        compiling.compile_for("check", "exudyn")
    assert [m.name for m in tmp_path.rglob("*.compiled")] == ["check.compiled"]


def _written(file: Path) -> None:
    file.write_text(str(os.getpid()))


def _endless() -> None:
    time.sleep(1e3)


def test_work_in_processes_of_its_own_is_never_done_in_this_one(tmp_path: Path) -> None:
    files = [tmp_path / "a", tmp_path / "b"]
    with workers.own_processes([(_written, file) for file in files]):
        pass
    pids = {file.read_text() for file in files}
    assert len(pids) == 2 and str(os.getpid()) not in pids


def test_processes_of_its_own_end_with_a_body_that_fails() -> None:
    with pytest.raises(KeyboardInterrupt), workers.own_processes([(_endless,)]) as running:
        assert running()
        raise KeyboardInterrupt
    assert not running()


def test_a_part_is_waited_for_while_the_others_are_compiled(
    asked: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    left = [("exudyn",), ("fit",)]

    @contextmanager
    def slow(tasks: Sequence[tuple[Any, ...]]) -> Iterator[Callable[[], bool]]:
        yield lambda: bool(left)

    monkeypatch.setattr(workers, "own_processes", slow)
    monkeypatch.setattr(compiling.time, "sleep", lambda seconds: compiling.run_parts(*left.pop(0)))
    with compiling.compiling("exudyn", "fit") as wait_for:
        wait_for("exudyn")
        assert left == [("fit",)]
    assert not left


@pytest.mark.parametrize("parts", [("semi-recursive", "fit"), ("exudyn", "filter")])
def test_every_part_runs_in_one_go(parts: tuple[str, ...]) -> None:
    compiling.run_parts(*parts)


#: functions long enough to stay functions of their own where they are called
MADE_FUNCTIONS = """
import math

from crane_exudyn.compiled import njit


def times(factor):
    @njit(cache=False)
    def scaled(x):
        y = x
        LONG
        return y

    return scaled


twice, thrice = times(2.0), times(3.0)


@njit
def called_twice(x):
    return twice(x)


@njit
def called_thrice(x):
    return thrice(x)
""".replace("LONG", "\n        ".join(["y = (y + factor * math.sin(y)) if y < 99.0 else factor - y"] * 60))


def test_code_compiled_in_two_processes_is_not_mixed_up(tmp_path: Path) -> None:
    """Two functions that one function made, each compiled as the first of its process, would have one name."""
    (tmp_path / "made.py").write_text(MADE_FUNCTIONS, encoding="utf-8")
    given = os.environ | {"CRANE_EXUDYN_CACHE": str(tmp_path), "PYTHONPATH": str(tmp_path)}

    def said(*calls: str) -> list[str]:
        words = [sys.executable, "-c", f"import made; print({', '.join(calls)})"]
        return subprocess.run(words, env=given, capture_output=True, text=True, check=True).stdout.split()

    twice, thrice = "made.called_twice(1.0)", "made.called_thrice(1.0)"
    assert [*said(twice), *said(thrice)] == said(twice, thrice)


@compiled.njit(cache=False)
def _squared(x: float) -> float:
    return x * x


@compiled.njit(cache=False)
def _sum_of_squares(x: float, y: float) -> float:
    return _squared(x) + _squared(y)


def test_machine_code_is_made_only_of_what_python_calls() -> None:
    assert _sum_of_squares(2.0, 3.0) == 13.0
    assert _sum_of_squares.signatures
    assert not _squared.signatures
    assert _squared(4.0) == 16.0
    assert _squared.signatures


def test_compiled_functions_have_names_of_their_own() -> None:
    names: dict[tuple[str, str], object] = {}
    for module in [m for n, m in list(sys.modules.items()) if n.partition(".")[0] in ("crane_exudyn", "validation")]:
        for found in vars(module).values():
            function = getattr(found, "py_func", None)
            if function is not None:
                assert names.setdefault((function.__module__, function.__qualname__), function) is function
    assert len(names) > 100


def test_indices_of_others_count_from_the_end_as_before() -> None:
    """What this project does not ask of its own indices is still asked of those of everybody else's compiled code."""
    own = sensitivity.__name__

    def element(array: Any, k: int) -> Any:
        return array[k]

    asked = []
    for module in (__name__, own):
        element.__module__ = module
        element.__qualname__ = f"element_of_{module.rpartition('.')[2]}"
        found = numba.njit(element)
        assert found(np.arange(3.0), 1) == 1.0
        asked.append(" select i1 " in "".join(found.inspect_llvm().values()).partition("define")[2].partition("\n}")[0])
        if module == __name__:
            assert found(np.arange(3.0), -1) == 2.0
    assert asked == [True, False]
