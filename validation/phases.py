"""Phases of work: what the crane was doing when, in the words of those who drive it."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.parameters import LAYOUT

REST = "rest"
#: what a cylinder does by the way its valve is open
_WAYS = {1: "extends", -1: "retracts"}
BOTH, REVERSAL, LOW_PRESSURE, STROKE_END = "both moving", "reversal", "low pressure", "end of stroke"
#: the kinds of work of one cylinder: (cylinder, way its valve is open) -> kind
MOVING = {
    (c, side): f"{name} {way}"
    for c, name in enumerate(LAYOUT.cylinders)
    for side, way in ((1, "extending"), (-1, "retracting"))
}
KINDS = (REST, *MOVING.values(), BOTH, REVERSAL, LOW_PRESSURE, STROKE_END)
#: what is going on, for a sentence: "while …"
WORDS = {
    REST: "while both valves are closed",
    **{kind: f"while the {LAYOUT.cylinders[c]} cylinder {_WAYS[side]}" for (c, side), kind in MOVING.items()},
    BOTH: "while both cylinders are driven",
    REVERSAL: "while a cylinder reverses",
    LOW_PRESSURE: "while a chamber is below the pressure of the tank",
    STROKE_END: "while a cylinder is at the end of its stroke",
}

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
    """A stretch of one kind of work: instants first … last (exclusive), its times in s, which way each valve is open (-1, 0, 1)."""

    kind: str
    first: int
    last: int
    start: float
    end: float
    sides: tuple[int, ...] = ()

    @property
    def words(self) -> str:
        """Where and when, as a sentence begins: "between 7.6 and 8.5 s, while the tilt cylinder extends"."""
        doing = WORDS[self.kind]
        if self.kind == BOTH and self.sides and all(self.sides):
            ways = [_WAYS[side] for side in self.sides]
            each = [f"the {name} cylinder {way}" for name, way in zip(LAYOUT.cylinders, ways, strict=True)]
            doing = "while " + ("both cylinders " + ways[0].rstrip("s") if len(set(ways)) == 1 else " and ".join(each))
        return f"between {self.start:.1f} and {self.end:.1f} s, {doing}"


def phases_of(crane: Crane, time: np.ndarray, spool: np.ndarray, states: np.ndarray) -> list[Phase]:
    """Return the phases of a run in order, without gaps.

    Args:
        crane: for its strokes.
        time: (N,) s, even.
        spool: (N, 2) spool positions.
        states: (N, nx) estimated states.
    """
    side = _sides(spool)
    kinds = labels(crane, time, spool, states)
    # driving both counts as another piece of work when one of them turns
    ways = 3 ** np.arange(side.shape[1])[::-1]
    way = np.where(kinds == KINDS.index(BOTH), side @ ways, 0).astype(int)
    code = _smooth(3 * ways[0] * kinds + way, time)
    edges = np.concatenate([[0], np.flatnonzero(np.diff(code)) + 1, [len(code)]])
    found = []
    for a, b in itertools.pairwise(edges):
        pieces = max(1, int(np.ceil((time[b - 1] - time[a]) / LONGEST - 1e-9)))
        cuts = np.round(np.linspace(a, b, pieces + 1)).astype(int)
        for i, j in itertools.pairwise(cuts):
            end = time[min(j, len(time) - 1)]
            middle = side[(i + j) // 2]
            kind = KINDS[round(code[a] / (3 * ways[0]))]
            found.append(Phase(kind, int(i), int(j), float(time[i]), float(end), tuple(map(int, middle))))
    return found


def _sides(spool: np.ndarray) -> np.ndarray:
    """Return which way each valve is open (N, 2): 1 extending, -1 retracting, 0 closed."""
    return np.asarray(np.sign(np.where(np.abs(spool) > DRIVEN, spool, 0.0)))


def labels(crane: Crane, time: np.ndarray, spool: np.ndarray, states: np.ndarray) -> np.ndarray:
    """Return the kind of work at every instant as an index into KINDS (N,); special states come before plain motion."""
    side = _sides(spool)
    kind = np.full(len(time), KINDS.index(REST))
    empty = states[:, crane.layout.pressures] < LOW * crane["supply.tank_pressure"]
    for chosen, name in (
        *((side[:, c] == way, name) for (c, way), name in MOVING.items()),
        ((side != 0).sum(axis=1) > 1, BOTH), (np.any([_reverses(time, one) for one in side.T], axis=0), REVERSAL),
        (empty.any(axis=1), LOW_PRESSURE), (_at_end(crane, states), STROKE_END),
    ):  # fmt: skip
        kind[chosen] = KINDS.index(name)
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
    from crane_exudyn.geometry import cylinder_lengths

    lengths = cylinder_lengths(crane, states[:, crane.layout.positions])
    empty = np.array([crane[f"cylinders.{c}.empty_length"] for c in crane.layout.cylinders])
    span = np.array([crane[f"cylinders.{c}.chamber_range"] for c in crane.layout.cylinders])
    piston = lengths - empty
    return np.asarray(((piston < NEAR_END) | (piston > span - NEAR_END)).any(axis=1))


def _smooth(code: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return codes of work (0 is rest) with the pieces shorter than SHORTEST joined to the longer neighbour, shortest first.

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
