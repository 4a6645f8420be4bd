"""Runs that end at the limit of a cylinder or of a loop, and commands that keep off it: a driver who lets go of a lever
in time.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from .crane import Crane
from .engines import engine_class
from .errors import CraneError

#: samples that are run at once where a run has ended early; so many times fewer, each time that they do not all go
_PIECE, _FINER = 512, 8
#: share of a stroke that a driver leaves at its end, and as much again each time that the cylinder still comes to its
#: end; where less is left before he begins he uses half of it
_LEFT = 0.1
#: share of a stroke, or of a loop's motion, within which a run that ends has come to the end of it
_AT_END = 0.02
#: share of a loop's motion from which on its bodies are nearly in line: cylinders hardly move it any more
_IN_LINE = 0.05
#: s: a driver lets go of a lever at whole multiples of it, so that what engines differ by makes no other commands
_BEAT = 0.05
#: at most so many times commands are changed; each of them has a few stretches
_MOST = 60


def run_while_possible(
    engine: Any, x0: np.ndarray, time: np.ndarray, w: np.ndarray, step: float
) -> tuple[np.ndarray, CraneError | None]:
    """Return the states (k, nx) of an engine at the first k of the instants `time` (n,), and why it went no further;
    None where it went to the end.

    Args:
        x0: (nx,) state at time[0].
        time, w: as `simulate` of the engine takes them.
        step: largest time step in s.
    """
    try:
        return engine.simulate(x0, time, w, step=step), None
    except CraneError as problem:
        ended = problem
    done, at, size = [np.asarray(x0, dtype=float)[None]], 0, _PIECE
    while size and at < len(time) - 1:
        part = slice(at, at + size + 1)
        try:
            piece = engine.simulate(done[-1][-1], time[part], w[part], step=step)
        except CraneError as problem:
            ended, size = problem, size // _FINER
            continue
        done.append(piece[1:])
        at += len(piece) - 1
    return np.concatenate(done), ended


def within_strokes(crane: Crane, time: np.ndarray, commands: np.ndarray, start: np.ndarray) -> np.ndarray | None:
    """Return commands (n, valves) with which no cylinder comes to an end of its stroke: as they are given, but a lever
    that drives its cylinder there is let go in time, until it is to go the other way.

    Args:
        crane: what is driven; objects of one's own count for nothing.
        time: (n,) s;  commands: (n, valves), linear between, steps staying steps.
        start: (nx,) state at time[0].

    Returns:
        None where no such commands are found: a closed valve does not hold the cylinder, or the run ends for another
        reason.
    """
    from .drive import inputs_on, with_steps  # compiled code, of which the effects must be part

    crane = crane.without_objects() if crane.objects else crane
    engine, given = engine_class("semi-recursive")(crane), np.array(commands, dtype=float)
    let_go: dict[tuple[int, int], int] = {}
    for _ in range(_MOST):
        w = inputs_on(crane, time, *with_steps(time, given))
        states, ended = run_while_possible(engine, start, time, w, float(np.min(np.diff(time))))
        if ended is None:
            return given
        cut = _letting_go(crane, time, commands, given, states, let_go)
        if cut is None:
            return None
        lever, first, after = cut
        given[first:after, lever] = 0.0
    return None


def _letting_go(
    crane: Crane,
    time: np.ndarray,
    commands: np.ndarray,
    given: np.ndarray,
    states: np.ndarray,
    let_go: dict[tuple[int, int], int],
) -> tuple[int, int, int] | None:
    """Return the lever that brought a cylinder or a loop to its end, and from which sample to before which it is let
    go; None where none did.

    Args:
        commands: as they were at first;  given: as they were in the run of `states`, which ended early.
        let_go: by lever and first sample of a stretch of one sign, how often it was shortened; one is added.
    """
    position = np.hstack(
        [positions_in_strokes(crane, states), _positions_in_loops(crane, states[:, crane.layout.positions])]
    )
    end = int(np.argmax(np.abs(position[-1] - 0.5)))
    if abs(position[-1, end] - 0.5) < 0.5 - _AT_END:
        return None
    way = np.sign(position[-1, end] - 0.5)
    room = 0.5 + way * (0.5 - position[:, end])  # share of the stroke that is left
    levers = commands.shape[1]
    lever, sign = (end, way) if end < levers else _closing_in(crane, states, position[:, end], end - levers, way)
    toward = np.flatnonzero(np.sign(commands[: len(states), lever]) == sign)
    if not toward.size:
        return None
    last = int(toward[-1])
    others = np.flatnonzero(np.sign(commands[:, lever]) != sign)
    before, behind = others[others < last], others[others > last]
    first = int(before[-1]) + 1 if before.size else 0
    after = int(behind[0]) if behind.size else len(time)
    if not given[first:after, lever].any():
        return None
    let_go[lever, first] = tries = let_go.get((lever, first), 0) + 1
    leaves = min(tries * _LEFT, room[first] * tries / (tries + 1.0))  # a cylinder may begin near its end
    near = np.flatnonzero(room[first:] < leaves)
    cut = first + int(near[0]) if near.size else len(states) - 1
    beat = time[0] + _BEAT * np.floor((time[cut] - time[0]) / _BEAT)
    return lever, max(first, int(np.searchsorted(time, beat - 1e-9))), after


def _closing_in(crane: Crane, states: np.ndarray, place: np.ndarray, loop: int, way: float) -> tuple[int, float]:
    """Return the lever whose cylinder brought a loop to the end of its motion, and the sign of that motion.

    Args:
        states: (n, nx) of a run that ends there;  place: (n,) where the loop stands at each;  loop: its number;
        way: 1 where it is stretched, -1 where folded.
    """
    from .geometry import pose

    z = states[:, crane.layout.positions]
    free = np.flatnonzero(np.abs(place - 0.5) < 0.5 - _IN_LINE)
    k = int(free[-1]) if free.size else 0
    tiny = 1e-6 * np.eye(z.shape[1])
    around = _positions_in_loops(crane, np.vstack([z[k] + tiny, z[k] - tiny]))[:, loop]
    by_z = around[: len(tiny)] - around[len(tiny) :]
    lengths = pose(crane, *z[k]).length_rates[0]
    rates = lengths @ states[k, crane.layout.velocities]
    closing = way * np.linalg.solve(lengths.T, by_z) * rates  # how fast each cylinder alone brings it there
    lever = int(np.argmax(closing))
    return lever, float(np.sign(rates[lever]))


def positions_in_strokes(crane: Crane, states: np.ndarray) -> np.ndarray:
    """Return where the cylinders stand at states (n, nx), from 0, fully retracted, to 1, fully extended: (n,
    cylinders).
    """
    from .geometry import cylinder_lengths

    lengths = cylinder_lengths(crane, states[:, crane.layout.positions])
    shortest, longest = np.transpose([crane.stroke(c) for c in crane.layout.cylinders])
    return np.asarray((lengths - shortest) / (longest - shortest))


def _positions_in_loops(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return where the loops stand at coordinates z (n, …): from 0, folded, to 1, stretched in one line (n, loops)."""
    from .geometry import loop_bends

    return 1.0 - loop_bends(crane, z) / np.pi


def levers_let_go(crane: Crane, given: np.ndarray, driven: np.ndarray) -> tuple[str, ...]:
    """Return the cylinders whose commands were `driven` (n, valves) and not as `given`."""
    return tuple(c for c, same in zip(crane.layout.cylinders, (given == driven).all(axis=0), strict=True) if not same)
