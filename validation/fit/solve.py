"""Gauss-Newton on the windows of a recording: knots eliminated, variables within bounds, unexplained stretches weighted
down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from threadpoolctl import threadpool_limits

from crane_exudyn.crane import Crane

from .data import Data, FitData, Joint
from .linear import Linear, Window, cost_at, follows, linearised, model_at
from .model import Model
from .variables import Variable, acts, alone, lateness, with_variables

#: lowest pressure of a state, Pa: a void of a few per cent of its chamber is remembered as that
EMPTIEST = -1e8


@dataclass(frozen=True)
class Reduced:
    """Normal equations of the variables alone, knots eliminated: H (m, m), g (m,); and how the knots follow."""

    H: np.ndarray
    g: np.ndarray
    knots_by_u: np.ndarray  # (K, nx, m)
    knots_step: np.ndarray  # (K, nx)


@dataclass(frozen=True)
class Fit:
    """A fitted crane.

    Attributes:
        crane: nominal parameters and effects as fitted.
        u: values of the variables; cov: their covariance given the data, (m, m).
        knots: first states of the windows (K, nx), SI.
        errors: RMS residual by channel in noise units; error: over all samples.
        prior_cost: half the sum of squares of what the prior says about u.
    """

    crane: Crane
    variables: tuple[Variable, ...]
    u: np.ndarray
    cov: np.ndarray
    knots: np.ndarray
    errors: dict[str, float]
    error: float
    prior_cost: float
    converged: bool
    windows: tuple[Window, ...] = field(repr=False)
    linear: Linear = field(repr=False)
    origin: Crane = field(repr=False)
    data: Data = field(repr=False)

    def of(self, recording: int) -> Fit:
        """Return the fit as one of its recordings sees it: its own parameters, clock and knots; errors stay those of
        all.
        """
        if isinstance(self.data, FitData):
            return self
        mine = [k for k, w in enumerate(self.windows) if w.recording == recording]
        kept = [i for i, v in enumerate(self.variables) if acts(v, recording)]
        return replace(
            self, crane=with_variables(self.origin, self.variables, self.u, recording), u=self.u[kept],
            variables=tuple(alone(self.variables[i]) for i in kept), cov=self.cov[np.ix_(kept, kept)],
            knots=self.knots[mine],
            windows=tuple(replace(self.windows[k], recording=0) for k in mine), data=self.data.parts[recording],
        )  # fmt: skip

    def begun(self, origin: Crane, variables: Sequence[Variable], u: np.ndarray) -> Fit:
        """Return where a fit of a crane by other variables begins: at these knots, with values u, nothing known of
        their spread yet.
        """
        cov = np.full((len(u), len(u)), math.nan)
        return replace(self, origin=origin, variables=tuple(variables), u=u, cov=cov)

    @property
    def late(self) -> float:
        """Seconds by which the commands were found to come after their stamps."""
        return lateness(self.variables, self.u)

    @property
    def starts(self) -> np.ndarray:
        """First states (S, nx) of the recording's stretches with known commands; one, where they always are."""
        joined = [False, *(follows(a, b) for a, b in pairwise(self.windows))]
        return self.knots[~np.array(joined)]

    def std(self, name: str) -> float:
        """Return the standard deviation of the variable `name` in units of u."""
        i = [v.name for v in self.variables].index(name)
        return float(math.sqrt(max(self.cov[i, i], 0.0)))


def reduce(linear: Linear, guess: np.ndarray, knots: np.ndarray) -> Reduced:
    """Eliminate the knots of the normal equations by block elimination along time."""
    with threadpool_limits(1):  # small matrices: threads of the linear algebra's own would only be in the way
        return _eliminated(linear, guess, knots)


def _eliminated(linear: Linear, guess: np.ndarray, knots: np.ndarray) -> Reduced:
    K, nx, m = linear.Hxu.shape
    H = linear.Hxx + np.diag(linear.weak)
    g = linear.gx + linear.weak * (knots - guess) / linear.jump
    right = np.concatenate([linear.Hxu, g[:, :, None]], axis=2)
    factors: list[Any] = []
    off = linear.Hxo
    for k in range(K):
        if k:
            link = cho_solve(factors[k - 1], off[k - 1])
            H[k] -= off[k - 1].T @ link
            right[k] -= link.T @ right[k - 1]
        H[k] += 1e-9 * np.eye(nx)
        factors.append(cho_factor(H[k]))
    solution = np.empty_like(right)
    for k in reversed(range(K)):
        after = off[k] @ solution[k + 1] if k + 1 < K else 0.0
        solution[k] = cho_solve(factors[k], right[k] - after)
    HB = linear.Hxu.reshape(K * nx, m).T @ solution.reshape(K * nx, m + 1)
    return Reduced(linear.Huu - HB[:, :m], linear.gu - HB[:, m], -solution[:, :, :m], -solution[:, :, m])


def with_prior(reduced: Reduced, variables: Sequence[Variable], u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and gradient with the Gaussian priors of the variables added."""
    weight = np.array([0.0 if math.isinf(v.prior) else v.prior**-2 for v in variables])
    return reduced.H + np.diag(weight), reduced.g + weight * u


def bounded_step(
    H: np.ndarray, g: np.ndarray, u: np.ndarray, lower: np.ndarray, upper: np.ndarray, damping: float
) -> np.ndarray:
    """Return the step of least quadratic cost with u + step within bounds (active-set on the damped system)."""
    m = len(u)
    A = H + np.diag(damping * np.maximum(np.diag(H), 1e-12) + 1e-10)
    step, fixed = np.zeros(m), np.zeros(m, dtype=bool)
    for _ in range(3 * m + 1):
        free = ~fixed
        step[free] = (
            np.linalg.lstsq(A[np.ix_(free, free)], -(g + A @ (step * fixed))[free], rcond=None)[0]
            if free.any()
            else 0.0
        )
        low, high = u + step < lower - 1e-15, u + step > upper + 1e-15
        out = (low | high) & free
        if not out.any():
            return step
        worst = int(np.argmax(np.where(out, np.maximum(lower - u - step, u + step - upper), -np.inf)))
        step[worst] = (lower if low[worst] else upper)[worst] - u[worst]
        fixed[worst] = True
    return step


@dataclass
class _Point:
    """Where an iteration stands; tries: how many steps were tried to come here."""

    u: np.ndarray
    knots: np.ndarray
    linear: Linear
    tries: int = 1


def fit(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable] = (),
    u: np.ndarray | None = None,
    *,
    stiffness: float = 1.0,
    iterations: int = 8,
    tolerance: float = 0.05,
) -> Fit:
    """Return the crane fitted to the windows, from knots (K, nx) and variable values u.

    The cost is that of the residuals of every window and of the jumps between them (`linear.robust`), plus priors.
    """
    lower = np.array([v.lower for v in variables])
    upper = np.array([v.upper for v in variables])
    u = np.clip(np.zeros(len(variables)) if u is None else np.asarray(u, dtype=float), lower, upper)
    point = _evaluate(crane, data, windows, knots, variables, u, stiffness)
    guess = point.knots.copy()
    converged = False
    for _ in range(iterations):
        if point.linear.failed:
            break
        guess = _widened(guess, point.knots)
        reduced = _reduced(point, guess)
        if reduced is None:
            break
        H, g = with_prior(reduced, variables, point.u)
        moved = _step(crane, data, windows, variables, point, reduced, H, g, (lower, upper), stiffness, guess)
        if moved is None:
            converged = True
            break
        gain = _cost(point, variables, guess) - _cost(moved, variables, guess)
        point = moved
        if gain < max(tolerance, 1e-4 * point.linear.cost):
            converged = True
            break
    return _finish(crane, data, variables, windows, point, guess, converged)


def _evaluate(
    crane: Crane,
    data: Data,
    windows: Sequence[Window],
    knots: np.ndarray,
    variables: Sequence[Variable],
    u: np.ndarray,
    stiffness: float,
) -> _Point:
    linear, knots = linearised(crane, data, windows, knots, variables, u, stiffness)
    return _Point(u, knots, linear)


def _reduced(point: _Point, guess: np.ndarray) -> Reduced | None:
    """Return the variables' normal equations; a model that runs away (a negative payload, say) has none: beyond all
    digits.
    """
    try:
        return reduce(point.linear, guess, point.knots)
    except LinAlgError:
        point.linear.failed = True
        return None


def _widened(guess: np.ndarray, knots: np.ndarray) -> np.ndarray:
    """Return guessed knots with as many states as `knots`: a fit may give the payload a pendulum on its way, or take it
    away.
    """
    if guess.shape == knots.shape:
        return guess
    wide = knots.copy()
    n = min(guess.shape[1], knots.shape[1])
    wide[:, :n] = guess[:, :n]
    return wide


def _cost(point: _Point, variables: Sequence[Variable], guess: np.ndarray) -> float:
    if point.linear.failed:
        return math.inf
    return 0.5 * point.linear.cost + _priors(point.u, point.knots, point.linear, variables, guess)


def _priors(
    u: np.ndarray, knots: np.ndarray, linear: Linear, variables: Sequence[Variable], guess: np.ndarray
) -> float:
    """Return what the priors of variables and first states add to the cost."""
    prior = sum((x / v.prior) ** 2 for x, v in zip(u, variables, strict=True) if math.isfinite(v.prior))
    n = knots.shape[1]
    away = (knots - _widened(guess, knots)) / linear.jump[:n]
    return 0.5 * (float((linear.weak[:n] * away**2).sum()) + prior)


def _step(crane, data, windows, variables, point, reduced, H, g, bounds, stiffness, guess):  # type: ignore[no-untyped-def]
    """Return the next point with a lower cost, or None if there is none.

    Derivatives are worked out where the step is likely to be taken: at once where the last one was, else once a run
    without them has shown the lower cost.
    """
    before = _cost(point, variables, guess)
    damping, at_once = 0.0, point.tries == 1
    for tries in range(1, 7):
        du = bounded_step(H, g, point.u, *bounds, damping) if len(point.u) else np.zeros(0)
        dx = reduced.knots_step + reduced.knots_by_u @ du
        share = 1.0 / (1.0 + damping)
        knots = point.knots + share * dx * point.linear.jump
        p = crane.layout.pressures
        knots[:, p] = np.maximum(knots[:, p], EMPTIEST)
        u = point.u + share * du
        here = crane, data, windows, knots, variables, u, stiffness
        if at_once or 0.5 * cost_at(*here) + _priors(u, knots, point.linear, variables, guess) < before:
            trial = replace(_evaluate(*here), tries=tries)
            if _cost(trial, variables, guess) < before:
                return trial
        at_once = False
        damping = 4.0 * damping if damping else 0.3
    return None


def _finish(
    crane: Crane,
    data: Data,
    variables: Sequence[Variable],
    windows: Sequence[Window],
    point: _Point,
    guess: np.ndarray,
    converged: bool,
) -> Fit:
    linear, m = point.linear, len(point.u)
    cov = np.full((m, m), math.nan)
    reduced = None if linear.failed else _reduced(point, _widened(guess, point.knots))
    if m and reduced is not None:
        H, _ = with_prior(reduced, variables, point.u)
        cov = covariance(H)
    errors = {c: math.sqrt(linear.squares[c] / max(1, linear.counts[c])) for c in linear.squares}
    prior = 0.5 * sum((x / v.prior) ** 2 for x, v in zip(point.u, variables, strict=True) if math.isfinite(v.prior))
    return Fit(
        with_variables(crane, variables, point.u), tuple(variables), point.u, cov, point.knots, errors,
        linear.error if not linear.failed else math.inf, prior, converged, tuple(windows), linear, crane, data,
    )  # fmt: skip


def covariance(H: np.ndarray) -> np.ndarray:
    """Return the inverse of a Hessian (m, m); what the data do not determine gets a huge variance, where a
    pseudo-inverse gives none.
    """
    size = np.sqrt(np.maximum(np.diag(H), 1e-12))
    values, vectors = np.linalg.eigh(H / np.outer(size, size))
    return (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(size, size)


def reknot(fit: Fit, windows: Sequence[Window]) -> np.ndarray:
    """Return first states (K, nx) of other windows: those of the fit's own, and where they begin within one of these
    its run's.
    """
    if isinstance(fit.data, Joint):
        each = range(len(fit.data.parts))
        own = [[replace(w, recording=0) for w in windows if w.recording == i] for i in each]
        return np.concatenate([reknot(fit.of(i), own[i]) for i in each])
    begins = np.array([w.data.time[0] for w in fit.windows])
    wanted = np.array([w.data.time[0] for w in windows])
    knots = fit.knots[[int(np.argmin(np.abs(begins - t))) for t in wanted]]
    within = np.searchsorted(begins, wanted + 0.5 * fit.data.step, side="right") - 1
    away = np.abs(begins[:, None] - wanted).min(axis=0) > 0.5 * fit.data.step
    model = model_at(fit.origin, fit.variables, fit.u, fit.data) if away.any() else None
    for k in sorted(set(within[away])):
        if k >= 0 and model is not None:
            rows = away & (within == k)
            states = _states(fit.windows[k], fit.knots[k], model, wanted[rows])
            knots[rows] = np.where(np.isnan(states), knots[rows], states)
    return knots


def _states(window: Window, x0: np.ndarray, model: Model, times: np.ndarray) -> np.ndarray:
    """Return states (n, nx) at times in a window that begins with x0; NaN where the run does not reach."""
    data = window.data
    W = model.W[window.start : window.start + len(data.time)]
    X, _, _ = model.run(x0, W, data.time, data.step)
    index = np.round((times - data.time[0]) / data.step).astype(int)
    inside = index < len(X)
    found = np.full((len(times), len(x0)), math.nan)
    found[inside] = X[index[inside]]
    return found
