"""Compiles what a command is about to need, once after an installation or a change of the sources.

Without it everything is compiled by whoever calls it first. Here it is done before the work begins, in processes of
their own: beside each other, and their memory, of which a process that compiles keeps 0.7 GB, is given back.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Literal

import numpy as np

from .options import DEFAULT_CRANE, EngineName, make_engine
from .output import progress

if TYPE_CHECKING:
    from crane_exudyn.recording import Recording

Part = Literal["exudyn", "semi-recursive", "check", "filter", "fit"]
#: s of a recording on which every part runs once
_SHORT = 1.1


def compile_for(*parts: Part) -> None:
    """Compile what these parts of the program need, unless that has been done for these sources and effects.

    Args:
        parts: the engines, what checks recordings, the filter (on the first engine that is named), and what fits and
            compares.
    """
    from crane_exudyn.compiled import cache_folder
    from validation.workers import WorkerEnded, own_processes

    marks = {part: cache_folder("validation") / f"{part}.compiled" for part in parts}
    tasks = [(run_parts, *side) for side in _sides(parts) if not all(marks[part].exists() for part in side)]
    if not tasks:
        return
    try:
        with progress("Compiling the equations, once after an installation or a change") as done:
            for k, _ in enumerate(own_processes(tasks)):
                done((k + 1) / len(tasks))
    except WorkerEnded:
        return  # what is left is compiled, and announced, where it is needed
    for mark in marks.values():
        mark.parent.mkdir(parents=True, exist_ok=True)
        mark.touch()


def _sides(parts: tuple[Part, ...]) -> list[tuple[Part, ...]]:
    """Return the parts in groups that share little: one process each.

    What fits is built on the semi-recursive engine; the filter works on either.
    """
    fitted: tuple[Part, ...] = ("semi-recursive", "fit") if "exudyn" in parts else ("semi-recursive", "filter", "fit")
    rest = tuple(p for p in fitted if p in parts)
    other = tuple(p for p in ("check", "exudyn", "filter") if p in parts and p not in fitted)
    return [side for side in (rest, other) if side]


def run_parts(*parts: Part) -> None:
    """Run every part once, in an order in which each finds what the one before it compiled."""
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
    engine: EngineName = "exudyn" if "exudyn" in parts else "semi-recursive"
    for part in parts:
        if part == "check":
            vet(whole, Crane.load(DEFAULT_CRANE))
        elif part == "filter":
            _estimate(engine, recording)
        elif part == "fit":
            _compare(recording)
        else:
            _simulate(part, recording)


def _simulate(engine: EngineName, recording: Recording) -> None:
    from crane_exudyn.crane import Crane
    from crane_exudyn.simulation import simulate

    crane = Crane.load(DEFAULT_CRANE)
    holder = make_engine(engine, crane)
    run = simulate(crane, recording, engine=holder)
    run.channels()
    holder.propagate(run.states[:2], np.tile(crane.layout.closed, (2, 1)), 1e-3)


def _estimate(engine: EngineName, recording: Recording) -> None:
    from crane_exudyn.crane import Crane
    from ukf.estimator import Estimator

    Estimator(Crane.load(DEFAULT_CRANE), engine).run(recording)


def _compare(recording: Recording) -> None:
    from crane_exudyn.crane import Crane
    from validation.comparison import compare

    compare(Crane.load(DEFAULT_CRANE), recording)
