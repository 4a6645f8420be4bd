"""One search: models grow by moves, round by round, until no move brings what it must.

A round goes on from a beam of models. All moves are screened linearly, the likeliest are fitted, these are judged, and
the best go on. How errors are taken is a *regime*: as white noise (`white`), or as those of a wrong model, which drift
(`drifting`). The path of a search holds all that was fitted; what it means is said by `verdict`, which changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Generic, TypeVar

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.recording import Recording

from ..fit.data import Data, data_of, noise_of
from ..fit.solve import Fit
from ..fit.staged import Stage, all_parameters, informed_directions
from ..fit.variables import Variable, stated_effects
from ..workers import in_parallel
from .manoeuvre import best_manoeuvre
from .model import F, Fitted, Model, fitted, run_error, unmoving, values_of
from .moves import scaled
from .screen import Score

Progress = Callable[[str, float], None]
Stages = Sequence[Stage]
P = TypeVar("P", bound="Path[Any]")


def silent(text: str, share: float) -> None:
    """Tell nobody of the progress."""


@dataclass(frozen=True)
class Move:
    """A model to be fitted, from the knots (and values) of an earlier fit, or from knots alone; promise: the fall of
    the cost that the screen expects.
    """

    model: Model
    before: Fit | np.ndarray
    promise: float = math.inf


def moves_of(model: Model, scores: Sequence[Score], before: Fit) -> list[Move]:
    """Return the models that add what was screened to a model, each once: a start of another size may have come to the
    same.
    """
    found = dict[tuple[object, ...], Move]()
    for s in scores:
        values = scaled(s.start, s.amplitude)
        alike = (s.start.key, *(f"{x:.2g}" for x in values.values()))
        found.setdefault(alike, Move(replace(model, effects={**model.effects, s.start.key: values}), before, s.gain))
    return list(found.values())


@dataclass(frozen=True)
class Round(Generic[F]):
    """What a round fitted, best first: as it was chosen from, and carried to the end; open-loop errors by effects where
    they decide; bare: without effects, where one that does nothing had led to another minimum.
    """

    tried: tuple[F, ...]
    done: tuple[F, ...]
    errors: Mapping[frozenset[str], float] = field(default_factory=dict)
    bare: Fitted | None = None


@dataclass(frozen=True)
class Path(Generic[F]):
    """All that a search fitted; parameters: the crane without effects, its uncertain parameters moved."""

    problem: Problem
    parameters: F
    rounds: tuple[Round[F], ...] = ()


@dataclass(frozen=True)
class Regime(Generic[F, P]):
    """How a search takes errors, as the steps of its rounds.

    Attributes:
        begun: the path before its first round.
        beam: the models that a round goes on from, of a path that goes to so many effects; none where it ends.
        moves: what is likely beside them, as the screen sees it.
        fitted: the moves as far as they are worth it, best first.
        judged: the round, the leading ones at their end.
        after: the path with a round.
        gained: whether a path's last round brought what it must, and leaves something to look for.
        finished: the path with what is known at its end only, of at most so many effects.
    """

    begun: Callable[[Problem], P]
    beam: Callable[[P, int], Sequence[F]]
    moves: Callable[[P, Sequence[F]], Sequence[Move]]
    fitted: Callable[[P, Sequence[F], Sequence[Move]], Sequence[F]]
    judged: Callable[[P, Sequence[F], Sequence[F]], Round[F]]
    after: Callable[[P, Round[F]], P]
    gained: Callable[[P], bool]
    finished: Callable[[P, int, Progress], P]


def search(regime: Regime[F, P], begin: Problem | P, most: int, progress: Progress = silent) -> P:
    """Return the path of a search to at most so many effects, of a problem or on from a path that has begun."""
    path = regime.begun(begin) if isinstance(begin, Problem) else begin
    while beam := regime.beam(path, most):
        progress("looking for effects", 0.2 + 0.5 * min(len(path.rounds) / most, 1.0))
        tried = regime.fitted(path, beam, regime.moves(path, beam))
        path = regime.after(path, regime.judged(path, beam, tried))
        if not regime.gained(path):
            break
    return regime.finished(path, most, progress)


@dataclass(frozen=True)
class Problem:
    """What is searched: a crane and its recordings.

    Attributes:
        told: the variables that all models share, where these are other than those that `base` tells.
    """

    crane: Crane
    recordings: tuple[Recording, ...]
    data: Data
    jobs: int
    told: tuple[Variable, ...] | None = None

    @classmethod
    def of(cls, crane: Crane, recordings: Sequence[Recording], own: Sequence[str], jobs: int) -> Problem:
        """Return the problem of recordings; of several, `own` parameters are each one's own."""
        return cls(crane, tuple(recordings), data_of(recordings, crane, own), jobs)

    @cached_property
    def base(self) -> Fit:
        """The crane in loosely joined windows, all its uncertain parameters free."""
        return all_parameters(self.crane, self.data)

    @cached_property
    def shared(self) -> tuple[Variable, ...]:
        """The variables that all models share."""
        if self.told is not None:
            return self.told
        return (*informed_directions(self.base), *stated_effects(self.crane))

    @cached_property
    def nominal(self) -> Fit:
        """The crane as it is, in loosely joined windows."""
        return self.with_effects({})

    def tasks(self, moves: Sequence[Move], stages: Stages) -> list[tuple[Any, ...]]:
        """Return what fits the moves, for `fits`."""
        return [(fitted, self.crane, self.data, m.model, m.before, stages) for m in moves]

    def run(self, moves: Sequence[Move], stages: Stages) -> list[Fitted]:
        """Return the moves fitted, on as many processes as may be used, best first."""
        return self.fits(self.tasks(moves, stages))

    def fits(self, tasks: Sequence[tuple[Any, ...]]) -> list[Fitted]:
        """Return what tasks (function, arguments…) fit, on as many processes as may be used, best first; without models
        that run away.
        """
        found: list[Fitted] = in_parallel(self.jobs, tasks)
        return sorted((w for w in found if math.isfinite(w.evidence)), key=lambda w: -w.evidence)

    def further(self, fits: Sequence[Fitted], stages: Stages) -> list[Fitted]:
        """Return fits taken further from where they stand, best first."""
        return self.run([Move(w.model, w.fit) for w in fits], stages)

    def errors(self, fits: Sequence[Fit], check: Recording | None = None) -> list[list[float]]:
        """Return by fit the open-loop errors of cranes as they were fitted, by recording and last on the check
        recording.
        """
        n, own = len(self.recordings), [fit.of(i) for fit in fits for i in range(len(self.recordings))]
        tasks: list[tuple[Any, ...]] = [(run_error, f.crane, self.recordings[k % n], f) for k, f in enumerate(own)]
        if check is not None:
            tasks += [(run_error, fit.crane, check, None, self.data.own) for fit in fits]
        found: list[float] = in_parallel(self.jobs, tasks)
        return [[*found[n * k : n * (k + 1)], *found[len(own) + k : len(own) + k + 1]] for k in range(len(fits))]

    def errors_over(
        self, parts: Sequence[tuple[Crane, int, tuple[float, float]]]
    ) -> tuple[list[Recording], list[float]]:
        """Return parts of recordings, each told by a crane, the recording's number and a span (from, to) in s, and the
        open-loop errors of the cranes on them; noise is that of the whole recording: a part of one would tell another.
        """
        noise = [noise_of(r, self.crane) for r in self.recordings]
        windows = [self.recordings[i].window(*span) for _, i, span in parts]
        pairs = zip(parts, windows, strict=True)
        tasks = [(run_error, replace(crane, sensors=noise[i]), r, None) for (crane, i, _), r in pairs]
        return windows, in_parallel(self.jobs, tasks)

    def with_effects(self, effects: Mapping[str, Mapping[str, float]], near: Fit | None = None) -> Fit:
        """Return the crane as given with effects as they were found, none of its parameters moved, in loosely joined
        windows, which begin as measured, or as those of a fit nearby.
        """
        return all_parameters(unmoving(self.crane.changed({}, effects)), self.data, near=near)

    def anew(self, model: Model, stages: Stages) -> Fitted:
        """Return a model fitted from the crane as given with its effects."""
        return fitted(self.crane, self.data, model, self.with_effects(model.effects), stages)

    def as_given(self, effects: Mapping[str, Mapping[str, float]], near: Fit | None = None) -> Fit:
        """Return the crane as `with_effects` does; all uncertain parameters may move from where the crane states
        them.
        """
        fit = self.with_effects(effects, near) if effects else self.nominal
        known, own = values_of(fit), Model(self.shared, effects).own(self.crane.layout)
        u = [known.get(v.name, 0.0) for v in self.base.variables] + [v.begin for v in own]
        return fit.begun(self.crane, (*self.base.variables, *own), np.array(u))

    def telling(self, first: Crane, second: Crane) -> str:
        """Return in words the manoeuvre on which two explanations differ most, as these sensors see them."""
        noise = {s.channel: s.noise for p in self.data.parts for s in p.samples}
        return best_manoeuvre(first, second, noise, self.data.channels)
