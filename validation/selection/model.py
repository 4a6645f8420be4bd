"""Models of a machine, how they are fitted to recordings, and what they are worth.

A model is the crane as given with effects added and with variables that may move. Its score is the log evidence
(`fit.evidence`) under the error model of the round: the data's noise levels, the same for all models of a round.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np
from scipy.stats import chi2

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError
from crane_exudyn.layout import Layout
from crane_exudyn.recording import Recording

from ..criteria import CRITERIA
from ..fit.data import Data, FitData
from ..fit.evidence import log_evidence
from ..fit.solve import Fit, fit
from ..fit.staged import (
    STIFF,
    WHOLE,
    Stage,
    each_stage,
    informed_directions,
    residuals,
    rms,
    run_fitted,
    staged,
    timing_of,
)
from ..fit.variables import (
    CurveDirection,
    EffectParameter,
    EffectVariable,
    NominalDirection,
    Variable,
    effect_variables,
    expected_std,
    stated_effects,
    uncertain_parameters,
)
from .levels import noise_level


class Curve(Protocol):
    """An effect whose law is learned, with a prior of its own."""

    @property
    def name(self) -> str:
        """The effect with its place, and over what it runs."""

    @property
    def variables(self) -> Sequence[EffectVariable]:
        """What its values move along, and where these begin."""

    def beginning(self, u: np.ndarray) -> Curve:
        """Return the same with its variables beginning at u (m,)."""


@dataclass(frozen=True)
class Model:
    """What might be: effects with parameter values (SI) to start from, beside variables that all models of a search
    share; those of its effects that are learned have curves.
    """

    variables: tuple[Variable, ...]
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    curves: Mapping[str, Curve] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """The effects' names with their places."""
        return tuple(self.effects)

    @property
    def names(self) -> tuple[str, ...]:
        """The same, with what each curve runs over."""
        return tuple(self.curves[k].name if k in self.curves else k for k in self.effects)

    def own(self, layout: Layout) -> list[EffectVariable]:
        """Return the variables of its effects."""
        return [
            v
            for key, values in self.effects.items()
            for v in (self.curves[key].variables if key in self.curves else effect_variables(key, values, layout))
        ]


@dataclass(frozen=True)
class Fitted:
    """A model fitted to recordings.

    Attributes:
        fit: the last stage of the fit; loose: the first one, from which further effects are looked for where much is
            left.
    """

    model: Model
    fit: Fit
    loose: Fit = field(repr=False)

    @property
    def keys(self) -> tuple[str, ...]:
        """Its effects."""
        return self.model.keys

    @property
    def names(self) -> tuple[str, ...]:
        """Its effects, with what their curves run over."""
        return self.model.names

    @property
    def effects(self) -> dict[str, dict[str, float]]:
        """Its effects with their fitted parameters (SI)."""
        return effects_of(self.fit.crane, self.keys)

    @property
    def as_found(self) -> Model:
        """Its model, to start from where it ended."""
        pairs = [(v, u) for v, u in zip(self.fit.variables, self.fit.u, strict=True) if isinstance(v, CurveDirection)]
        curves = {k: c.beginning(np.array([u for v, u in pairs if v.key == k])) for k, c in self.model.curves.items()}
        return replace(self.model, effects=self.effects, curves=curves)

    @cached_property
    def evidence(self) -> float:
        """Log marginal likelihood, up to a constant of the recordings and the stage."""
        return log_evidence(self.fit)

    @cached_property
    def level(self) -> float:
        """RMS error in noise units in which unexplained stretches count by their logarithm only."""
        linear = self.fit.linear
        return math.inf if linear.failed else math.sqrt(linear.cost / max(1, sum(linear.counts.values())))

    @cached_property
    def bad(self) -> np.ndarray:
        """Which windows stay unexplained, (K,) bool."""
        return unexplained(self.fit)

    @property
    def move_cost(self) -> float:
        """Half the sum of squares of the moves of nominal parameters, in standard uncertainties: their log prior, up to
        a sign.
        """
        return 0.5 * float(np.square(_moves(self.fit)).sum())

    @property
    def plausible(self) -> bool:
        """Whether the moved parameters, taken together, are what their stated uncertainties allow."""
        return plausible(self.fit)

    @property
    def near(self) -> bool:
        """Whether it leaves hardly more than noise, wherever its parameters may have moved."""
        return self.level < noise_level(self.fit.data) and float(self.bad.mean()) <= CRITERIA.share

    @property
    def good(self) -> bool:
        """Whether it leaves hardly more than noise, its parameters within their uncertainty."""
        return self.near and self.plausible

    @property
    def far(self) -> Mapping[str, float]:
        """Nominal parameters that moved by more than `Criteria.far` standard uncertainties, and by how many of them;
        the furthest first.
        """
        given, found = self.fit.origin, self.fit.crane
        known = ((n, u.std) for n, u in given.uncertainty.items() if n in given.values and math.isfinite(u.std))
        moves = ((n, abs(found.values[n] - given.values[n]), std) for n, std in known)
        far = {n: move / std for n, move, std in moves if move > CRITERIA.far * std}
        return dict(sorted(far.items(), key=lambda each: -each[1]))

    @property
    def beyond_uncertainty(self) -> bool:
        """Whether parameters have moved further than they may, together or several of them."""
        return not self.plausible or len(self.far) >= CRITERIA.several

    @cached_property
    def parameters(self) -> list[EffectParameter]:
        """The parameters of its effects, as variables that begin where they stand."""
        own = [v for v in self.fit.variables if isinstance(v, EffectParameter) and v.key in self.keys]
        return [replace(v, start=self.values(v.key)[v.parameter.name]) for v in own]

    @property
    def undetermined(self) -> list[EffectParameter]:
        """Those of them of which the recordings say next to nothing."""
        variables = self.fit.variables
        left = np.diag(self.fit.cov) / expected_std(variables) ** 2 >= 1.0 - CRITERIA.informed
        names = {v.name for v, open_ in zip(variables, left, strict=True) if open_}
        return [v for v in self.parameters if v.name in names]

    @property
    def inactive(self) -> set[str]:
        """Effects whose parameters cannot be told from their neutral values."""
        return {key for key in self.keys if self._at_neutral(key)}

    def _at_neutral(self, key: str) -> bool:
        values, spread = self.values(key), self.deviations(key)
        acting = [p for p in registry.split_key(key)[0].parameters if not p.shape]
        return all(
            math.isinf(values[p.name])
            or (
                math.isinf(spread[p.name])
                if math.isinf(p.neutral)
                else abs(values[p.name] - p.neutral) < CRITERIA.told_apart * spread[p.name]
            )
            for p in acting
        )

    def values(self, key: str) -> dict[str, float]:
        """Return the fitted parameters (SI) of one effect."""
        return parameters_of(self.fit.crane, key)

    def deviations(self, key: str) -> dict[str, float]:
        """Return the standard deviation (SI) of each fitted parameter of an effect; infinite where the data do not
        determine it.
        """
        found = {
            v.parameter.name: deviation(v, float(u), math.sqrt(max(float(spread), 0.0)))
            for v, u, spread in zip(self.fit.variables, self.fit.u, np.diag(self.fit.cov), strict=True)
            if isinstance(v, EffectParameter) and v.key == key
        }
        names, _, cov = curve_of(self.fit, key)
        spread = np.sqrt(np.maximum(np.diag(cov), 0.0))
        return found | {n: float(s) for n, s in zip(names, spread, strict=True)}


F = TypeVar("F", bound=Fitted)


def _moves(fit: Fit) -> np.ndarray:
    pairs = zip(fit.variables, fit.u, strict=True)
    return np.array([u / v.prior for v, u in pairs if math.isfinite(v.prior) and not isinstance(v, EffectVariable)])


def plausible(fit: Fit) -> bool:
    """Whether the parameters that a fit moved, taken together, are what their stated uncertainties allow."""
    moves = _moves(fit)
    return not len(moves) or float(np.square(moves).sum()) < float(chi2.isf(CRITERIA.implausible, len(moves)))


def at_bound(fit: Fit, key: str) -> list[str]:
    """Return the parameters of an effect that a fit has driven to an end of their range (the neutral end, and what only
    shapes a law, excepted).
    """
    hit = []
    for v, u in zip(fit.variables, fit.u, strict=True):
        if isinstance(v, EffectParameter) and v.key == key and not v.parameter.shape:
            ends = [e for e in (v.lower, v.upper) if math.isfinite(e) and abs(e - v.neutral) > 1e-12]
            if any(abs(u - e) < CRITERIA.at_end * max(1.0, abs(e)) for e in ends):
                hit.append(v.parameter.name)
    return hit


def parameters_of(crane: Crane, key: str) -> dict[str, float]:
    """Return the parameters (SI) of an effect that a crane has."""
    acting = crane.effect(key)
    if acting is None:
        raise CraneError(f"{crane.name} has no effect {key!r}.")
    return dict(acting.parameters)


def effects_of(crane: Crane, keys: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return effects that a crane has with their parameters (SI)."""
    return {key: parameters_of(crane, key) for key in keys}


def curve_of(fit: Fit, key: str) -> tuple[list[str], np.ndarray, np.ndarray]:
    """Return the names of the values of a curve (K; 0 for another effect), their values (K,) and covariance (K, K),
    SI.
    """
    moved = [(i, v) for i, v in enumerate(fit.variables) if isinstance(v, CurveDirection) and v.key == key]
    names = list(moved[0][1].weights) if moved else []
    at = [i for i, _ in moved]
    root = np.array([[v.weights[n] for _, v in moved] for n in names]).reshape(len(names), len(moved))
    start = np.array([moved[0][1].start[n] for n in names])
    return names, start + root @ fit.u[at], root @ fit.cov[np.ix_(at, at)] @ root.T


def deviation(variable: EffectParameter, u: float, spread: float) -> float:
    """Return the standard deviation (SI) of an effect's parameter whose u has that one; infinite where the data do not
    determine it.
    """
    if variable.inverse:
        return variable.parameter.typical / u**2 * spread if u > 2.0 * spread else math.inf
    return variable.scale * spread if spread < CRITERIA.undetermined else math.inf


def unexplained(fit: Fit) -> np.ndarray:
    """Return (K,) whether a window's error is above what noise makes, also where samples are few."""
    counts = np.array([sum(len(s.values) for s in w.data.samples) for w in fit.windows])
    spread = 1.0 / np.sqrt(2.0 * np.maximum(counts, 1))
    return fit.linear.window_error > np.maximum(CRITERIA.explained, 1.0 + CRITERIA.explained_errors * spread)


def values_of(fit: Fit) -> dict[str, float]:
    """Return u by the names of a fit's variables."""
    return {v.name: float(x) for v, x in zip(fit.variables, fit.u, strict=True)}


def fitted(crane: Crane, data: Data, model: Model, before: Fit | np.ndarray, stages: Sequence[Stage]) -> Fitted:
    """Return a model fitted through the stages, from the knots (and where it has them the values) of an earlier fit, or
    from knots (K, nx) of the first stage's windows.
    """
    own = model.own(crane.layout)
    known = values_of(before) if isinstance(before, Fit) else {}
    u = [known.get(v.name, begin(v, before, {} if own else known)) for v in (*model.variables, *own)]
    fits = each_stage(crane, data, [*model.variables, *own], np.array(u), before, stages)
    return Fitted(model, fits[-1], fits[0])


def begin(variable: Variable, before: Fit | np.ndarray, known: Mapping[str, float]) -> float:
    """Return where a variable begins that an earlier fit did not have: a joint direction of parameters where that fit
    moved them one by one.

    Beside a new effect parameters begin unmoved (nothing is known of them): they may have moved to do its work.
    """
    if isinstance(variable, EffectVariable):
        return variable.begin
    if (
        not isinstance(variable, NominalDirection)
        or isinstance(before, np.ndarray)
        or not set(variable.weights) <= set(known)
    ):
        return 0.0
    scale = {
        v.name: v.weights[v.name] for v in before.variables if isinstance(v, NominalDirection) and v.name in v.weights
    }
    return sum(weight / scale[name] * known[name] for name, weight in variable.weights.items())


def retold(w: F) -> F:
    """Return a model fitted on stiffly by the combinations of nominal parameters that the data speak about where it
    stands, or as it is where that is better supported.

    Which they are depends on where the machine goes: chosen at a crane without an effect, they would hold what one with
    it tells, and leave what a second effect explains.
    """
    crane, data = w.fit.origin, w.fit.data
    given = {v.name for v in stated_effects(crane)}
    looked = every_parameter(w.fit)
    effects = [v for v in looked.variables if isinstance(v, EffectVariable)]
    variables, known = [*informed_directions(looked), *effects], values_of(looked)
    u = [known.get(v.name, begin(v, looked, known)) for v in variables]
    shared = tuple(v for v in variables if not isinstance(v, EffectVariable) or v.name in given)
    again = staged(crane, data, variables, np.array(u), looked, (STIFF,))
    return max(w, replace(w, model=replace(w.model, variables=shared), fit=again), key=lambda one: one.evidence)


def every_parameter(found: Fit) -> Fit:
    """Return a fit as it stands, with every uncertain nominal parameter free by itself: its covariance is what the data
    and the crane file tell of each, whatever the others are.
    """
    variables, u = each_parameter(found)
    return fit(
        found.origin, found.data, found.windows, found.knots, variables, u, stiffness=STIFF.stiffness, iterations=0
    )


def each_parameter(found: Fit) -> tuple[list[Variable], np.ndarray]:
    """Return the variables of a fit with every uncertain nominal parameter by itself, and their values where it
    stands.
    """
    crane, data = found.origin, found.data
    nominal = uncertain_parameters(crane, data.own, len(data.parts))
    others = [(v, u) for v, u in zip(found.variables, found.u, strict=True) if not isinstance(v, NominalDirection)]
    moved = [moved_to(v, crane, found.crane, found) for v in nominal]
    return [*nominal, *(v for v, _ in others)], np.array([*moved, *(u for _, u in others)])


def moved_to(v: NominalDirection, given: Crane, crane: Crane, found: Fit) -> float:
    """Return the value of a variable of one nominal parameter, beginning at a given crane, that makes it as a crane has
    it; one that differs by recording as a fit found it.
    """
    ((name, weight),) = v.weights.items()
    has = crane if v.recording is None else found.of(v.recording).crane
    return float((has[name] - given[name]) / weight)


def best_of_each(found: Sequence[F]) -> list[F]:
    """Return the fits, best first, only the best of those with the same effects and curves over the same."""
    seen: dict[frozenset[str], F] = {}
    for w in sorted(found, key=lambda w: -w.evidence):
        seen.setdefault(frozenset(w.names), w)
    return list(seen.values())


def open_loop_error(
    crane: Crane, recording: Recording, knots: Fit | None = None, own: Sequence[str] = (), free: Sequence[Variable] = ()
) -> tuple[float, Fit]:
    """Return the RMS error over all samples, in noise units, of an open-loop run of which only the start is fitted, and
    that fit.

    The start is the first state, and by how little the recorded commands come late; parameters `own` are each
    recording's.

    Args:
        crane: the crane as it is.
        recording: what it is held against.
        knots: a fit of this crane to this recording, from which to start; guessed from the measurements if there is
            none.
        own, free: nominal parameters, and variables, that are fitted with the start, where no fit is given.
    """
    data = FitData.of(recording, crane)
    variables: list[Variable] = [timing_of(data)]
    if knots is None:
        variables += [*(v for v in uncertain_parameters(crane) if v.name in own), *free]
        fit = run_fitted(crane, data, variables)
    else:
        fit = staged(crane, data, variables, np.array([knots.late / timing_of(data).scale]), knots, (WHOLE,))
    every = FitData.whole(recording, crane)
    return rms(residuals(fit.crane, every, fit.starts, fit.late)), fit


def run_error(crane: Crane, recording: Recording, knots: Fit | None, own: Sequence[str] = ()) -> float:
    """Return the open-loop error; where a run from the knots of a fit that left little is far worse than the fit, its
    start is looked for anew as well.
    """
    error = open_loop_error(crane, recording, knots, own)[0]
    if knots is None or knots.error > CRITERIA.left_level or error < CRITERIA.lost * knots.error:
        return error
    return min(error, open_loop_error(crane, recording)[0])


def together(recordings: Sequence[Recording], errors: Sequence[float]) -> float:
    """Return the RMS over all samples of recordings whose own RMS is given."""
    counts = [sum(len(r[c]) for c in r.sensors) for r in recordings]
    return math.sqrt(sum(n * e**2 for n, e in zip(counts, errors, strict=True)) / sum(counts))


def excess(error: float) -> float:
    """Return by how much a squared error exceeds what noise makes."""
    return max(error**2 - 1.0, 0.0)


def misled(before: float, after: float) -> bool:
    """Whether the check recording was not predicted, its error without and with what was found given: most of it is
    left.
    """
    return after > CRITERIA.misled and excess(after) > CRITERIA.left * excess(before)


def unmoving(crane: Crane) -> Crane:
    """Return the crane with all its parameters known exactly."""
    return replace(crane, uncertainty={})
