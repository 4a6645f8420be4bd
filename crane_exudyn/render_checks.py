"""What a scene can be made of: trajectories of the crane, colours that mean something, places that are there."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from .crane import Crane
from .errors import CraneError, refuse_unknown, shortened
from .recording import Recording
from .render_text import MAPS, Colour
from .trajectory import Trajectory


def _places(crane: Crane) -> tuple[str, ...]:
    """Return every name that an arrow can point at."""
    machine, layout = crane.machine, crane.layout
    joints = [joint.name for joint in machine.joints]
    return tuple(dict.fromkeys([*layout.cylinders, *layout.chambers, *joints, *machine.point_names, *machine.bodies]))


def trajectories_of(given: Any) -> tuple[Trajectory, ...]:
    """Return what is drawn, also where one alone was given or a recording."""
    runs = [given] if not isinstance(given, list | tuple) else given
    for run in runs:
        if not isinstance(run, Trajectory | Recording):
            raise CraneError(
                f"Scene: found {shortened(run)}, expected trajectories. Give a list of them: "
                "Trajectory.from_recording of a Recording, Trajectory.from_states of states."
            )
    return tuple(r if isinstance(r, Trajectory) else Trajectory.from_recording(r, r.name) for r in runs)


def checked_size(size: Any) -> tuple[int, int]:
    """Return width and height in pixels."""
    numbers = tuple(size) if isinstance(size, Sequence | np.ndarray) and not isinstance(size, str) else ()
    if len(numbers) != 2 or not all(isinstance(n, int | np.integer) and 16 <= n <= 8192 for n in numbers):
        raise CraneError(
            f"Scene: size is {shortened(size)}, expected width and height in pixels, whole numbers from 16 to 8192. "
            "Give such as size=(1280, 720)."
        )
    return int(numbers[0]), int(numbers[1])


def check_scene(crane: Crane, colour: Colour | None, trajectories: Sequence[Trajectory], marks: Sequence[str]) -> None:
    """Raise CraneError where a scene cannot be drawn: no trajectory, one of another machine, two of one name, colours
    of nothing, an unknown place to mark.
    """
    if not trajectories:
        raise CraneError("A scene needs at least one trajectory.")
    if colour is not None:
        refuse_unknown("Scene", [colour], MAPS, "colour")
    wanted = len(crane.layout.coordinates)
    for trajectory in trajectories:
        if trajectory.positions.ndim != 2 or trajectory.positions.shape[1] != wanted:
            raise CraneError(
                f"The trajectory {trajectory.label!r} has positions of shape {trajectory.positions.shape}, but "
                f"{crane.name} has the coordinates "
                f"{', '.join(crane.layout.coordinates)}: expected ({len(trajectory.time)}, {wanted}). Give one column "
                "for each."
            )
    labels = [t.label for t in trajectories]
    twice = next((name for name in labels if labels.count(name) > 1), None)
    if twice is not None:
        raise CraneError(
            f"Two runs are called {twice!r}, so they cannot be told apart. Give one another name, in the command "
            "--label NAME or --ghost NAME=FILE."
        )
    if colour == "residual" and len(trajectories) < 2:
        raise CraneError(
            "Colours by residual show the difference of two runs, and only one was given. Give a second trajectory, in "
            "the command --ghost FILE."
        )
    if colour == "pressure" and not any(np.isfinite(p).any() for p in trajectories[0].pressures.values()):
        chambers = ", ".join(crane.layout.chambers)
        raise CraneError(
            f"Colours by pressure need pressures, and this run has none of {chambers}. Leave colour (--colour) out, or "
            "record one."
        )
    for mark in marks:
        if mark not in _places(crane):
            raise CraneError(f"There is no place {mark!r} to mark. Known: {', '.join(_places(crane))}.")
