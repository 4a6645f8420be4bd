"""Phases of work: what the crane was doing when, in the words of those who drive it."""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.layout import Layout
from crane_exudyn.statics import vapour_pressure

REST = "rest"
#: what a cylinder does by the way its valve is open
_WAYS = {1: "extends", -1: "retracts"}
REVERSAL, LOW_PRESSURE, STROKE_END = "reversal", "low pressure", "end of stroke"
#: what is going on where it is not the work of single cylinders, for a sentence: "while …"
_WORDS = {
    REVERSAL: "a cylinder reverses",
    LOW_PRESSURE: "a chamber is below the pressure of the tank",
    STROKE_END: "a cylinder is at the end of its stroke",
}


def together(layout: Layout) -> str:
    """Return the kind of work in which more than one cylinder of a machine moves."""
    return "both moving" if len(layout.cylinders) == 2 else "several moving"


@cache
def moving(layout: Layout) -> Mapping[tuple[int, int], str]:
    """Return the kinds of work of one cylinder: {(cylinder, way its valve is open): kind}."""
    ways = ((1, "extending"), (-1, "retracting"))
    return {(c, side): f"{name} {way}" for c, name in enumerate(layout.cylinders) for side, way in ways}


@cache
def kinds(layout: Layout) -> tuple[str, ...]:
    """Return all kinds of work of a machine."""
    several = [together(layout)] * (len(layout.cylinders) > 1)
    return (REST, *moving(layout).values(), *several, REVERSAL, LOW_PRESSURE, STROKE_END)


def _doing(kind: str, sides: tuple[int, ...], layout: Layout) -> str:
    """Return what is going on, for a sentence that begins with "while"."""
    if kind == REST:
        return {1: "the valve is", 2: "both valves are"}.get(len(layout.cylinders), "all valves are") + " closed"
    if kind in _WORDS:
        return _WORDS[kind]
    if kind == together(layout):
        return _together(sides, layout)
    cylinder, side = next(at for at, name in moving(layout).items() if name == kind)
    return f"the {layout.cylinders[cylinder]} cylinder {_WAYS[side]}"


def _together(sides: tuple[int, ...], layout: Layout) -> str:
    """Return what the cylinders do that are driven at once; without sides, or where no two are, that they are
    driven.
    """
    driven = [(name, _WAYS[side]) for name, side in zip(layout.cylinders, sides, strict=False) if side]
    both = "both cylinders" if len(layout.cylinders) == 2 else "several cylinders"
    if len(driven) < 2:
        return f"{both} are driven"
    if len(driven) == 2 == len(layout.cylinders) and driven[0][1] == driven[1][1]:
        return f"{both} {driven[0][1].removesuffix('s')}"
    return " and ".join(f"the {name} cylinder {way}" for name, way in driven)


#: a spool position beyond this drives its cylinder
DRIVEN = 0.02
#: a valve that changes sides within this time reverses its cylinder, and the reversal is felt for as long, s
REVERSING = 0.3
#: share of the tank's pressure below which a chamber sucks: oil gives off its air, and laws change
LOW = 0.5
#: nearness of a piston to the end of its chamber, m
NEAR_END = 0.01
#: pieces shorter than this join their neighbour; longer ones than the second are cut, s
SHORTEST, LONGEST = 0.15, 3.0


@dataclass(frozen=True)
class Phase:
    """A stretch of one kind of work: instants first … last (exclusive), its times in s, which way each valve is open
    (-1, 0, 1).
    """

    kind: str
    first: int
    last: int
    start: float
    end: float
    sides: tuple[int, ...]
    layout: Layout = field(repr=False)

    @property
    def words(self) -> str:
        """Where and when, as a sentence begins: "between 7.6 and 8.5 s, while the tilt cylinder extends"."""
        doing = _doing(self.kind, self.sides, self.layout)
        return f"between {self.start:.1f} and {self.end:.1f} s, while {doing}"


def phases_of(crane: Crane, time: np.ndarray, spool: np.ndarray, states: np.ndarray) -> list[Phase]:
    """Return the phases of a run in order, without gaps.

    Args:
        crane: for its strokes.
        time: (N,) s, even.
        spool: (N, valves) spool positions.
        states: (N, nx) estimated states.
    """
    side, names = _sides(spool), kinds(crane.layout)
    found_kinds = labels(crane, time, spool, states)
    # driving several counts as another piece of work when one of them turns
    ways = 3 ** np.arange(side.shape[1])[::-1]
    several = together(crane.layout)
    way = np.where(found_kinds == names.index(several), side @ ways, 0).astype(int) if several in names else 0
    code = _smooth(3 * ways[0] * found_kinds + way, time)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1, [len(code)]])
    found = []
    for a, b in itertools.pairwise(edges):
        pieces = max(1, int(np.ceil((time[b - 1] - time[a]) / LONGEST - 1e-9)))
        cuts = np.round(np.linspace(a, b, pieces + 1)).astype(int)
        for i, j in itertools.pairwise(cuts):
            end = time[min(j, len(time) - 1)]
            middle = side[(i + j) // 2]
            kind, sides = names[round(code[a] / (3 * ways[0]))], tuple(map(int, middle))
            found.append(Phase(kind, int(i), int(j), float(time[i]), float(end), sides, crane.layout))
    return found


def _sides(spool: np.ndarray) -> np.ndarray:
    """Return which way each valve is open (N, valves): 1 extending, -1 retracting, 0 closed."""
    return np.asarray(np.sign(np.where(np.abs(spool) > DRIVEN, spool, 0.0)))


def labels(crane: Crane, time: np.ndarray, spool: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the kind of work at every instant as an index into `kinds` (N,); special states come before plain
    motion.
    """
    side, names = _sides(spool), kinds(crane.layout)
    kind = np.full(len(time), names.index(REST))
    vacuum = vapour_pressure(crane)
    empty = states[:, crane.layout.pressures] < vacuum + LOW * (crane["supply.tank_pressure"] - vacuum)
    for chosen, name in (
        *((side[:, c] == way, name) for (c, way), name in moving(crane.layout).items()),
        ((side != 0).sum(axis=1) > 1, together(crane.layout)),
        (np.any([_reverses(time, one) for one in side.T], axis=0), REVERSAL),
        (empty.any(axis=1), LOW_PRESSURE), (_at_end(crane, states), STROKE_END),
    ):  # fmt: skip
        if chosen.any():
            kind[chosen] = names.index(name)
    return kind


def _reverses(time: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Return whether a valve is changing sides (N,): from its closing until the new motion is established."""
    out = np.zeros(len(time), dtype=bool)
    driven = np.flatnonzero(side)
    flips = np.flatnonzero(side[driven[1:]] * side[driven[:-1]] < 0)
    for before, after in zip(driven[flips], driven[flips + 1], strict=True):
        if time[after] - time[before] <= REVERSING:
            out[before : np.searchsorted(time, time[after] + REVERSING)] = True
    return out


def _at_end(crane: Crane, states: np.ndarray) -> np.ndarray:
    """Return whether a piston is near an end of its stroke (N,)."""
    from crane_exudyn.geometry import chamber_lengths

    span = np.array([crane[f"cylinders.{c}.chamber_range"] for c in crane.layout.cylinders])
    piston = chamber_lengths(crane, states[:, crane.layout.positions])
    return np.asarray(((piston < NEAR_END) | (piston > span - NEAR_END)).any(axis=1))


def _smooth(code: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return codes of work (0 is rest) with the pieces shorter than SHORTEST joined to the longer neighbour, shortest
    first.

    A short motion is never joined to a rest: its errors would be read as errors at rest.
    """
    code, least = code.copy(), max(1, int(np.ceil(SHORTEST / (time[1] - time[0]))))
    starts = [0, *(np.flatnonzero(np.diff(code)) + 1).tolist()]
    while True:
        lengths = np.diff([*starts, len(code)])
        for i in np.argsort(lengths, kind="stable"):
            beside = [j for j in (i - 1, i + 1) if 0 <= j < len(starts)]
            fitting = [j for j in beside if code[starts[j]] != 0 or code[starts[i]] == 0]
            if lengths[i] < least and fitting:
                break
        else:
            return code
        chosen = max(fitting, key=lambda j: lengths[j])
        code[starts[i] : starts[i] + lengths[i]] = code[starts[chosen]]
        starts = [s for k, s in enumerate(starts) if k == 0 or code[s] != code[s - 1]]
