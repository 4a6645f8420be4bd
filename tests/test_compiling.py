"""Compiling before a command begins: once, in processes of their own."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import pytest

from crane_exudyn import compiled
from patu import compiling
from validation import workers


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> list[tuple[str, ...]]:
    """What would have been compiled, each entry in one process, in a cache that is empty at first."""
    found: list[tuple[str, ...]] = []

    def record(tasks: Sequence[tuple[Any, ...]]) -> Iterator[None]:
        for _, *parts in tasks:
            found.append(tuple(parts))
            yield None

    monkeypatch.setattr(workers, "own_processes", record)
    monkeypatch.setattr(compiled, "cache_folder", lambda package: tmp_path / package)
    return found


def test_each_part_is_compiled_once(asked: list[tuple[str, ...]]) -> None:
    compiling.compile_for("semi-recursive")
    compiling.compile_for("semi-recursive")
    assert asked == [("semi-recursive",)]
    compiling.compile_for("exudyn", "semi-recursive", "filter", "fit")
    compiling.compile_for("exudyn", "fit")
    assert asked[1:] == [("semi-recursive", "fit"), ("exudyn", "filter")]


def test_the_filter_is_compiled_on_the_engine_that_is_asked_for(asked: list[tuple[str, ...]]) -> None:
    compiling.compile_for("check", "semi-recursive", "filter", "fit")
    assert asked == [("semi-recursive", "filter", "fit"), ("check",)]


def test_what_was_cut_off_is_not_called_compiled(
    asked: list[tuple[str, ...]], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def ended(tasks: object) -> Iterator[None]:
        raise workers.WorkerEnded("no memory")
        yield

    monkeypatch.setattr(workers, "own_processes", ended)
    compiling.compile_for("exudyn")
    assert not list(tmp_path.rglob("*.compiled"))


def test_work_in_processes_of_its_own_is_never_done_in_this_one() -> None:
    for tasks in ([(os.getpid,)], [(os.getpid,), (os.getpid,)]):
        pids = list(workers.own_processes(tasks))
        assert len(pids) == len(tasks) and os.getpid() not in pids


@pytest.mark.parametrize("parts", [("semi-recursive", "fit"), ("exudyn", "filter")])
def test_every_part_runs_in_one_go(parts: tuple[str, ...]) -> None:
    compiling.run_parts(*parts)
