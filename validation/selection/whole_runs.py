"""What models do to whole runs, where errors drift: over what they learned from and over the rest."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from crane_exudyn.crane import Crane

from ..criteria import CRITERIA
from ..fit.data import Data, FitData
from ..fit.knots import reknot
from ..fit.solve import Fit, fit
from ..fit.staged import LONG, SHORT, Stage, first_knots, residuals
from ..fit.variables import Timing
from ..fit.windows import cut
from .levels import Errors, Levels, each_part, falls, left_over
from .model import Fitted
from .moves import of_typical_size
from .search import Problem

Judged = tuple[Errors, Errors]


def loose(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of short windows that follow the machine."""
    return (Stage(SHORT, 1.0, iterations),)


def joined(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of windows that are all but joined."""
    return (Stage(CRITERIA.window, CRITERIA.joined, iterations),)


def run(iterations: int) -> tuple[Stage, ...]:
    """Return the stage of one open-loop run."""
    return (Stage(LONG, 1.0, iterations),)


@dataclass(frozen=True)
class Taken:
    """One effect that was taken in: the log evidence that it brought, and what else was fitted in its round would have
    brought.
    """

    key: str
    evidence: float
    rivals: Mapping[str, float]


@dataclass(frozen=True)
class Standing(Fitted):
    """A fitted model, to the first part of each recording or to all of it.

    Attributes:
        levels: the error levels of its round.
        taken: how its effects were taken in, one a round.
        errors: of open-loop runs, over what was learned from and over the rest.
        asked: effects that were demanded but not taken, with their values: a linear look from a model without them may
            not show them a second time.
        unseen: where it learned from all of each recording, the errors over the rest of the model that it grew from.
    """

    levels: Levels
    taken: tuple[Taken, ...] = ()
    errors: Judged = ({}, {})
    asked: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    unseen: Errors | None = None

    @property
    def predicted(self) -> Errors:
        """Errors over what it had not learned from."""
        return self.errors[1] if self.unseen is None else self.unseen

    @property
    def left(self) -> tuple[float, float]:
        """The log by which its errors could still fall, over what was learned from and over the rest."""
        first, rest = (left_over(e) for e in self.errors)
        return first, rest

    def fall(self, before: Standing) -> float:
        """Return the log by which open-loop errors fall against those of another model, on both stretches together."""
        return sum(falls(a, b) for a, b in zip(before.errors, self.errors, strict=True))

    @property
    def worth(self) -> float:
        """The log by which errors must fall against its own: a tenth, or the share of what is left that the best of
        several effects takes away at least.
        """
        return min(CRITERIA.gained, CRITERIA.part * sum(self.left))

    def serves(self, before: Standing) -> bool:
        """Whether errors of open-loop runs fall, and not at the cost of what was not learned from."""
        return self.fall(before) > before.worth and falls(before.errors[1], self.errors[1]) > -CRITERIA.tolerated

    def learned(self, problem: Problem) -> Data:
        """Return what it learned from, with the sensors' noise."""
        return first_part(problem.data) if self.unseen is None else problem.data

    def extended(self, problem: Problem) -> Fit:
        """Return its crane in windows over the whole recordings, of which the fit has seen only the first part."""
        data = self.levels.raised(problem.data)
        windows = cut(data, CRITERIA.window)
        guess = first_knots(self.fit.crane, data, CRITERIA.window)
        near = reknot(self.fit, windows)
        ends = [end_of_learned(part) - CRITERIA.window for part in problem.data.parts]
        known = np.array([w.data.time[0] <= ends[w.recording] for w in windows])
        if near.shape == guess.shape:
            guess[known] = near[known]
        kept = [i for i, v in enumerate(self.fit.variables) if isinstance(v, Timing) or v.recording is not None]
        variables = [self.fit.variables[i] for i in kept]
        return fit(
            self.fit.crane, data, windows, guess, variables, self.fit.u[kept], stiffness=CRITERIA.joined
        )  # fmt: skip


def first_part(whole: Data) -> Data:
    """Return the part of each recording that is learned from."""
    return each_part(whole, lambda part: part.part(0, int(np.searchsorted(part.time, end_of_learned(part)))))


def end_of_learned(data: FitData) -> float:
    """Return the time (s) up to which a recording is learned from, where a choice is judged on the rest."""
    return float(data.time[0] + CRITERIA.learned * (data.time[-1] - data.time[0]))


def typical(crane: Crane, effects: Mapping[str, Mapping[str, float]]) -> Crane:
    """Return the crane with effects of the size that is met in practice."""
    return crane.changed({}, {key: of_typical_size(key, values) for key, values in effects.items()})


def judged(problem: Problem, found: Fit) -> Judged:
    """Return open-loop errors by channel over what was learned from, and over the rest, into which the same runs go
    on.
    """
    runs = []
    for i, learned in enumerate(found.data.parts):
        own = found.of(i)
        windows = cut(learned, LONG)
        run = fit(own.crane, learned.shifted(own.late), windows, reknot(own, windows), (), np.zeros(0), iterations=5)
        runs.append(replace(own, knots=run.knots, windows=run.windows))
    return errors_of(problem, runs, rest=False), errors_of(problem, runs, rest=True)


def errors_of(problem: Problem, runs: Sequence[Fit], rest: bool | None = None) -> dict[str, float]:
    """Return by channel the errors of open-loop runs, one a recording, over all of it, or without or with nothing but
    the rest (not learned from).
    """
    left: dict[str, list[np.ndarray]] = {}
    for data, run in zip(problem.data.parts, runs, strict=True):
        for c, (time, r) in residuals(run.crane, data, run.starts, run.late).items():
            left.setdefault(c, []).append(r if rest is None else r[(time >= end_of_learned(data)) == rest])
    every = {c: np.concatenate(own) for c, own in left.items()}
    return {c: float(np.sqrt(np.mean(r**2))) for c, r in every.items() if len(r)}
