"""Fitting one hypothesis to a recording and weighing it: the nominal model, its parameters, or effects added to it."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording

from ..fit.data import Data, FitData
from ..fit.evidence import log_evidence
from ..fit.solve import Fit
from ..fit.staged import FINE, START, Stage, first_knots, residuals, rms, staged, timing_of
from ..fit.variables import (
    CurveDirection,
    EffectParameter,
    EffectVariable,
    NominalDirection,
    Variable,
    effect_variables,
    uncertain_parameters,
)

#: a window counts as explained up to this error, in noise units
EXPLAINED = 1.3
#: a standard deviation of that many typical sizes means that the data say nothing
UNDETERMINED = 1e3


@dataclass(frozen=True)
class Hypothesis:
    """What might be: effects with parameter values (SI) to start from; none: the nominal parameters alone."""

    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)

    @property
    def keys(self) -> tuple[str, ...]:
        """The effects' names with their places."""
        return tuple(self.effects)


@dataclass(frozen=True)
class Weighed:
    """A hypothesis fitted to a recording.

    Attributes:
        fit: the last stage of the fit.
        evidence: log marginal likelihood, up to a constant of the recording and the stage.
        level: RMS error in noise units in which unexplained stretches count by their logarithm only.
        bad: windows that stay unexplained, (K,) bool.
    """

    hypothesis: Hypothesis
    fit: Fit
    evidence: float
    level: float
    bad: np.ndarray


def weigh(
    crane: Crane,
    data: Data,
    variables: Sequence[Variable],
    before: Fit,
    hypothesis: Hypothesis,
    stages: Sequence[Stage],
) -> Weighed:
    """Return a hypothesis fitted through the stages, from the knots (and where it has them the values) of an earlier fit."""
    own: list[EffectVariable] = [
        v for key, values in hypothesis.effects.items() for v in effect_variables(key, values, crane.layout)
    ]
    known = {v.name: x for v, x in zip(before.variables, before.u, strict=True)}
    shared = np.array([known.get(v.name, 0.0 if own else projected(v, before, known)) for v in variables])
    u = np.concatenate([shared, [known.get(v.name, v.begin) for v in own]])
    return judged(hypothesis, staged(crane, data, [*variables, *own], u, before, stages))


def projected(variable: Variable, before: Fit, known: Mapping[str, float]) -> float:
    """Return the value of a joint direction of parameters that a fit has moved one by one; 0 if it did not move them."""
    if not isinstance(variable, NominalDirection) or not set(variable.weights) <= set(known):
        return 0.0
    scale = {
        v.name: v.weights[v.name] for v in before.variables if isinstance(v, NominalDirection) and v.name in v.weights
    }
    return sum(weight / scale[name] * known[name] for name, weight in variable.weights.items())


def judged(hypothesis: Hypothesis, fit: Fit) -> Weighed:
    """Return a fit with its evidence and what it leaves unexplained."""
    count = max(1, sum(fit.linear.counts.values()))
    level = math.sqrt(fit.linear.cost / count) if not fit.linear.failed else math.inf
    bad = fit.linear.window_error > threshold(fit)
    return Weighed(hypothesis, fit, log_evidence(fit), level, bad)


def threshold(fit: Fit) -> np.ndarray:
    """Return (K,) the error above which a window is unexplained: 1.3, or four standard errors where samples are few."""
    counts = np.array([sum(len(s.values) for s in w.data.samples) for w in fit.windows])
    return np.maximum(EXPLAINED, 1.0 + 4.0 / np.sqrt(2.0 * np.maximum(counts, 1)))


def open_loop_error(
    crane: Crane, recording: Recording, knots: Fit | None = None, own: Sequence[str] = ()
) -> tuple[float, Fit]:
    """Return the RMS error over all samples, in noise units, of an open-loop run of which only the start is fitted, and that fit.

    The start is the first state, and by how little the recorded commands come late; parameters `own` are each recording's.

    Args:
        crane: the crane as it is.
        recording: what it is held against.
        knots: a fit of this crane to this recording, from which to start; guessed from the measurements if there is none.
    """
    data = FitData.of(recording, crane)
    variables: list[Variable] = [timing_of(data)]
    if knots is None:
        variables += [v for v in uncertain_parameters(crane) if v.name in own]
        fit = staged(crane, data, variables, np.zeros(len(variables)), first_knots(crane, data), START)
    else:
        fit = staged(crane, data, variables, np.array([knots.late / timing_of(data).scale]), knots, START[-1:])
    every = FitData.of(recording, crane, rate=math.inf, step=FINE)
    return rms(residuals(fit.crane, every, fit.starts, fit.late)), fit


def fitted_values(weighed: Weighed, key: str) -> dict[str, float]:
    """Return the fitted parameters (SI) of one effect."""
    acting = weighed.fit.crane.effect(key)
    if acting is None:
        raise CraneError(f"The fitted crane has no effect {key!r}.")
    return dict(acting.parameters)


def deviations(weighed: Weighed, key: str) -> dict[str, float]:
    """Return the standard deviation (SI) of each fitted parameter of an effect; infinite where the data do not determine it."""
    found = {}
    for i, v in enumerate(weighed.fit.variables):
        if isinstance(v, EffectParameter) and v.key == key:
            u, spread = float(weighed.fit.u[i]), math.sqrt(max(float(weighed.fit.cov[i, i]), 0.0))
            found[v.parameter.name] = deviation(v, u, spread)
    return found | _curve_deviations(weighed.fit, key)


def _curve_deviations(fit: Fit, key: str) -> dict[str, float]:
    """Return the standard deviation (SI) of each value of a curve; none for another effect."""
    at = [i for i, v in enumerate(fit.variables) if isinstance(v, CurveDirection) and v.key == key]
    names = sorted({n for i in at for n in fit.variables[i].weights}, key=lambda n: int(n[1:]))  # type: ignore[union-attr]
    root = np.array([[fit.variables[i].weights[n] for i in at] for n in names])  # type: ignore[union-attr]
    spread = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", root, fit.cov[np.ix_(at, at)], root), 0.0)) if names else []
    return {n: float(s) for n, s in zip(names, spread, strict=True)}


def deviation(variable: EffectParameter, u: float, spread: float) -> float:
    """Return the standard deviation (SI) of an effect's parameter whose u has that one; infinite where the data do not determine it."""
    if variable.inverse:
        return variable.parameter.typical / u**2 * spread if u > 2.0 * spread else math.inf
    return variable.scale * spread if spread < UNDETERMINED else math.inf


def at_bound(weighed: Weighed, key: str) -> list[str]:
    """Return the parameters of an effect that a fit has driven to an end of their range (the neutral end excepted)."""
    hit = []
    for v, u in zip(weighed.fit.variables, weighed.fit.u, strict=True):
        if isinstance(v, EffectParameter) and v.key == key:
            ends = [e for e in (v.lower, v.upper) if math.isfinite(e) and abs(e - v.neutral) > 1e-12]
            if any(abs(u - e) < 1e-9 * max(1.0, abs(e)) for e in ends):
                hit.append(v.parameter.name)
    return hit
