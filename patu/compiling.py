"""Compiles what a command is about to need, once after an installation or a change of the sources.

Without it everything is compiled by whoever calls it first. Here it is done before the work begins, in processes of
their own: beside each other, and their memory, of which a process that compiles keeps 0.7 GB, is given back.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Literal

import numpy as np

from .options import DEFAULT_CRANE, EngineName
from .output import progress

if TYPE_CHECKING:
    from pathlib import Path

    from crane_exudyn.recording import Recording

Part = Literal["exudyn", "semi-recursive", "check", "filter", "fit"]
#: s of a recording on which every part runs once
_SHORT = 1.1
#: s of it in which another kind of filter runs
_STEPS = 0.05
#: s between two looks whether a part is done
_LOOK = 0.1


def compile_for(*parts: Part) -> None:
    """Compile what these parts of the program need, unless that has been done for these sources and effects.

    Args:
        parts: the engines, what checks recordings, the filter, and what fits and compares.
    """
    with compiling(*parts):
        pass


@contextmanager
def compiling(*parts: Part) -> Iterator[Callable[..., None]]:
    """Compile as `compile_for` does while the body runs; yield what waits until the parts given to it are done, as all
    are at the end.
    """
    from validation.workers import own_processes

    tasks = [(_attempt, *side) for side in _sides(parts) if not all(map(_done, side))]
    if not tasks:
        yield lambda *some: None
        return
    with own_processes(tasks) as running:

        def wait_for(*some: Part) -> None:
            if all(map(_done, some)) or not running():
                return  # what an ended process leaves is compiled, and announced, where it is needed
            with progress("Compiling the equations, once after an installation or a change") as done:
                while running() and not all(map(_done, some)):
                    done(sum(map(_done, parts)) / len(parts))
                    time.sleep(_LOOK)

        yield wait_for
        wait_for(*parts)


def _done(part: Part) -> bool:
    return _mark(part).exists()


def _mark(part: Part) -> Path:
    """Return the file that stands where a part has been compiled for these sources and effects."""
    from crane_exudyn.compiled import cache_folder

    return cache_folder("validation") / f"{part}.compiled"


def _sides(parts: tuple[Part, ...]) -> list[tuple[Part, ...]]:
    """Return the parts in groups that share little: one process each. Filter and fit are built on the semi-recursive
    engine.
    """
    groups: tuple[tuple[Part, ...], ...] = (("semi-recursive", "filter", "fit"), ("check", "exudyn"))
    sides = [tuple(p for p in group if p in parts) for group in groups]
    return [side for side in sides if side]


def _attempt(*parts: Part) -> None:
    """Run every part once; what fails will fail again, and be told, where it is needed."""
    with suppress(Exception):
        run_parts(*parts)


def run_parts(*parts: Part) -> None:
    """Run every part once, in an order in which each finds what the one before it compiled, and mark it as done."""
    logger = logging.getLogger("crane_exudyn")
    usual = logger.level
    logger.setLevel(logging.ERROR)  # the process that asked has told it
    try:
        _run_each(parts)
    finally:
        logger.setLevel(usual)


def _run_each(parts: tuple[Part, ...]) -> None:
    from crane_exudyn.crane import Crane
    from crane_exudyn.vetting import vet
    from validation.sample import with_the_package

    whole = with_the_package()[0]
    recording = whole.window(0.0, _SHORT)
    for part in parts:
        if part == "check":
            vet(whole, Crane.load(DEFAULT_CRANE))
        elif part == "filter":
            _estimate(recording)
        elif part == "fit":
            _compare(recording)
        else:
            _simulate(part, recording)
        _mark(part).parent.mkdir(parents=True, exist_ok=True)
        _mark(part).touch()


def _simulate(engine: EngineName, recording: Recording) -> None:
    from crane_exudyn.crane import Crane
    from crane_exudyn.engines import engine_class
    from crane_exudyn.geometry import pose
    from crane_exudyn.simulation import simulate

    crane = Crane.load(DEFAULT_CRANE)
    holder = engine_class(engine)(crane)
    run = simulate(crane, recording, engine=holder)
    run.channels()
    pose(crane, *run.states[:, crane.layout.positions].T)  # for pictures
    holder.propagate(run.states[:2], np.tile(crane.layout.closed, (2, 1)), 1e-3)


def _estimate(recording: Recording) -> None:
    from crane_exudyn.crane import Crane
    from ukf.estimator import Estimator

    crane = Crane.load(DEFAULT_CRANE)
    Estimator(crane, "semi-recursive").run(recording)
    Estimator(crane, "semi-recursive", method="ekf").run(recording.window(recording.start, recording.start + _STEPS))


def _compare(recording: Recording) -> None:
    from crane_exudyn.crane import Crane
    from validation.comparison import compare
    from validation.fit.data import FitData
    from validation.fit.staged import LOOSE, all_parameters
    from validation.selection.screen import screened

    crane = Crane.load(DEFAULT_CRANE)
    compare(crane, recording)
    screened(all_parameters(crane, FitData.of(recording, crane)), LOOSE.stiffness)
