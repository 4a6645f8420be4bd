"""Gauss-Newton on the windows of a recording: knots eliminated, variables within bounds, unexplained stretches weighted
down.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import count, pairwise
from typing import Any

import numpy as np
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.optimize import lsq_linear

from crane_exudyn.crane import Crane

from ..workers import single_threaded
from .data import Data, FitData
from .linear import Linear, linearised, near
from .variables import Variable, acts, alone, lateness, with_variables
from .windows import Window, alike, follows

#: lowest pressure of a state, Pa: a void of more than half of its chamber is remembered as that
EMPTIEST = -1e9
#: how often a step is shortened at most, by which damping first (in shares of the Hessian's diagonal), and by how much
#: more each time: in a bent valley a step along it must become shorter, and one across it hardly
_TRIES, _DAMPED, _MORE = 8, 1e-4, 10.0
#: the same derivatives serve on while a step promises at most this share of what the one before it brought
_SERVES = 0.3
#: how near to what it promised a step must fall for the cost to be the parabola that its derivatives tell: then the
#: next step leads to the end, and derivatives are not needed there
_AS_PROMISED = 0.1
#: what is added to the diagonal of each first state's normal equations, as a share of it: a hundred times what rounding
#: leaves open there, so that a window that multiplies its first state a billion times leaves them positive definite
_ROUNDING = 1e-13


@dataclass(frozen=True)
class Reduced:
    """Normal equations of the variables alone, knots eliminated: H (m, m), g (m,); how the knots follow, and by how
    much the cost falls where they alone move.
    """

    H: np.ndarray
    g: np.ndarray
    knots_by_u: np.ndarray  # (K, nx, m)
    knots_step: np.ndarray  # (K, nx)
    knots_gain: float = 0.0


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


def reduce(linear: Linear, guess: np.ndarray, knots: np.ndarray) -> Reduced | None:
    """Return the normal equations of the variables, the knots eliminated one after the other along time.

    None where the model failed, or runs away (a negative payload, say): then it counts as failed from now on.
    """
    if not linear.failed:
        try:
            return _eliminated(linear, guess, knots)
        except LinAlgError:
            linear.failed = True
    return None


def _eliminated(linear: Linear, guess: np.ndarray, knots: np.ndarray) -> Reduced:
    K, nx, m = linear.Hxu.shape
    H = linear.Hxx + np.diag(linear.weak)
    H += _ROUNDING * np.einsum("kii->ki", H)[:, :, None] * np.eye(nx)
    g = linear.gx + linear.weak * (knots - guess) / linear.jump
    right = np.concatenate([linear.Hxu, g[:, :, None]], axis=2)
    factors: list[Any] = []
    off = linear.Hxo
    for k in range(K):
        if k:
            link = cho_solve(factors[k - 1], off[k - 1])
            H[k] -= off[k - 1].T @ link
            right[k] -= link.T @ right[k - 1]
        factors.append(cho_factor(H[k]))
    solution = np.empty_like(right)
    for k in reversed(range(K)):
        after = off[k] @ solution[k + 1] if k + 1 < K else 0.0
        solution[k] = cho_solve(factors[k], right[k] - after)
    HB = linear.Hxu.reshape(K * nx, m).T @ solution.reshape(K * nx, m + 1)
    gain = 0.5 * float((g * solution[:, :, m]).sum())
    return Reduced(linear.Huu - HB[:, :m], linear.gu - HB[:, m], -solution[:, :, :m], -solution[:, :, m], gain)


def with_prior(reduced: Reduced, variables: Sequence[Variable], u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and gradient with the Gaussian priors of the variables added."""
    weight = np.array([0.0 if math.isinf(v.prior) else v.prior**-2 for v in variables])
    return reduced.H + np.diag(weight), reduced.g + weight * u


def bounded_step(
    H: np.ndarray, g: np.ndarray, u: np.ndarray, lower: np.ndarray, upper: np.ndarray, damping: float
) -> np.ndarray:
    """Return the step (m,) of least cost step' A step / 2 + g' step with u + step within bounds, A being H with more on
    its diagonal; the shortest of several.
    """
    A = H + np.diag(damping * np.maximum(np.diag(H), 1e-12) + 1e-10)
    free = np.linalg.lstsq(A, -g, rcond=None)[0]
    if (u + free >= lower).all() and (u + free <= upper).all():
        return free
    values, vectors = np.linalg.eigh(A)
    told = values > len(u) * np.finfo(float).eps * values[-1]
    root = np.sqrt(values[told])
    rows, right = root[:, None] * vectors[:, told].T, -(vectors[:, told].T @ g) / root
    return np.asarray(lsq_linear(rows, right, (lower - u, upper - u), method="bvls", tol=1e-12).x)


@single_threaded()
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
    before: Fit | None = None,
    keep: bool = False,
) -> Fit:
    """Return the crane fitted to the windows, from knots (K, nx) and variable values u.

    The cost is that of the residuals of every window and of the jumps between them (`linear.robust`), plus priors.
    Derivatives are taken anew up to so many times, and serve for further steps while these lead on to the end.

    Args:
        before: a fit by the same variables that ended here, whose derivatives serve if they were kept and the windows
            are the same.
        keep: whether the result is to hold the derivatives of its windows, which are large, for the next fit.
    """
    task = _Task(crane, data, tuple(windows), tuple(variables), stiffness, tolerance)
    u = np.clip(np.zeros(len(variables)) if u is None else np.asarray(u, dtype=float), task.lower, task.upper)
    serves = before is not None and before.linear.swept and alike(before.windows, windows)
    here = serves and before is not None and np.array_equal(before.knots, knots)
    point = task.at(u, knots, knots, before.linear if before is not None and here else None)
    converged = False
    for left in reversed(range(iterations + 1)):
        step = task.step(point) if left else None
        if step is None:
            break
        moved = task.lowered(point, step)
        gain = 0.0 if moved is None else point.cost - moved.cost
        point = moved or point
        if converged := min(gain, step.promise) < task.enough(point):
            break
        point, steps = task.followed(point, gain)
        if converged := steps == 1 and abs(gain / step.promise - 1.0) < _AS_PROMISED:
            break
        fresh = task.at(point.u, point.knots, point.guess)
        if fresh.linear.failed:
            break
        point = fresh
    if not keep:
        point.linear.swept = ()
    return _finish(task, point, converged)


@dataclass(frozen=True)
class _Point:
    """Values of the variables and first states at which the fit is linear, and their cost; guess: of the first
    states.
    """

    u: np.ndarray
    knots: np.ndarray
    guess: np.ndarray
    linear: Linear
    cost: float


@dataclass(frozen=True)
class _Step:
    """Normal equations at a point, the step that they ask for, and by how much the cost is to fall."""

    reduced: Reduced
    H: np.ndarray
    g: np.ndarray
    du: np.ndarray
    promise: float


@dataclass(frozen=True)
class _Task:
    """What is to be fitted, and its steps."""

    crane: Crane
    data: Data
    windows: tuple[Window, ...]
    variables: tuple[Variable, ...]
    stiffness: float
    tolerance: float

    @cached_property
    def lower(self) -> np.ndarray:
        """Bounds of the variables from below, (m,)."""
        return np.array([v.lower for v in self.variables])

    @cached_property
    def upper(self) -> np.ndarray:
        """And from above."""
        return np.array([v.upper for v in self.variables])

    def at(self, u: np.ndarray, knots: np.ndarray, guess: np.ndarray, before: Linear | None = None) -> _Point:
        """Return a point with its derivatives; with those of another point, where these have as many states."""
        where = self.crane, self.data, self.windows, knots, self.variables, u, self.stiffness
        linear = None if before is None else near(*where, before)
        if linear is None:
            linear, knots = linearised(*where)
        return self._point(u, knots, linear, guess)

    def _point(self, u: np.ndarray, knots: np.ndarray, linear: Linear, guess: np.ndarray) -> _Point:
        guess = _widened(guess, knots)
        cost = math.inf if linear.failed else 0.5 * linear.cost + self._priors(u, knots, linear, guess)
        return _Point(u, knots, guess, linear, cost)

    def _priors(self, u: np.ndarray, knots: np.ndarray, linear: Linear, guess: np.ndarray) -> float:
        """Return what the priors of variables and first states add to the cost."""
        away = (knots - guess) / linear.jump
        return prior_cost(self.variables, u) + 0.5 * float((linear.weak * away**2).sum())

    def enough(self, point: _Point) -> float:
        """Return the fall of the cost below which a fit is at its end."""
        return max(self.tolerance, 1e-4 * point.linear.cost)

    def step(self, point: _Point) -> _Step | None:
        """Return the step from a point; None where there is none: the model runs away (a negative payload, say)."""
        reduced = reduce(point.linear, point.guess, point.knots)
        if reduced is None:
            return None
        H, g = with_prior(reduced, self.variables, point.u)
        du = bounded_step(H, g, point.u, self.lower, self.upper, 0.0) if len(point.u) else np.zeros(0)
        return _Step(reduced, H, g, du, reduced.knots_gain - float(g @ du + 0.5 * du @ H @ du))

    def taken(self, point: _Point, step: _Step, share: float = 1.0) -> _Point:
        """Return the point after a share of a step, with the derivatives of the point before."""
        dx = step.reduced.knots_step + step.reduced.knots_by_u @ step.du
        knots = point.knots + share * dx * point.linear.jump
        p = self.crane.layout.pressures
        knots[:, p] = np.maximum(knots[:, p], EMPTIEST)
        return self.at(point.u + share * step.du, knots, point.guess, point.linear)

    def lowered(self, point: _Point, step: _Step) -> _Point | None:
        """Return the next point with a lower cost, by steps that are damped more and more; None if there is none."""
        damping = 0.0
        for _ in range(_TRIES):
            moved = self.taken(point, step, 1.0 / (1.0 + damping))
            if moved.cost < point.cost:
                return moved if moved.linear.swept else self.at(moved.u, moved.knots, moved.guess)
            damping = _MORE * damping if damping else _DAMPED
            du = bounded_step(step.H, step.g, point.u, self.lower, self.upper, damping)
            step = replace(step, du=du)
        return None

    def followed(self, point: _Point, gain: float) -> tuple[_Point, int]:
        """Return where further steps lead with the derivatives of an earlier point, whose own step brought `gain`,
        while each promises far less than the one before brought; and how many of them lead to the end, 0 if they do
        not.
        """
        for steps in count(1):
            step = self.step(point) if point.linear.swept else None
            if step is None or step.promise > _SERVES * gain:
                break
            moved = self.taken(point, step)
            gain = point.cost - moved.cost
            point = moved if gain > 0.0 else point
            if step.promise < self.enough(point):
                return point, steps
        return point, 0


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


def prior_cost(variables: Sequence[Variable], u: np.ndarray) -> float:
    """Return half the sum of squares of what the priors say about values u of variables."""
    return 0.5 * sum((float(x) / v.prior) ** 2 for x, v in zip(u, variables, strict=True) if math.isfinite(v.prior))


def _finish(task: _Task, point: _Point, converged: bool) -> Fit:
    linear, m = point.linear, len(point.u)
    reduced = reduce(point.linear, point.guess, point.knots) if m else None
    cov = np.full((m, m), math.nan) if reduced is None else covariance(with_prior(reduced, task.variables, point.u)[0])
    errors = {c: math.sqrt(linear.squares[c] / max(1, linear.counts[c])) for c in linear.squares}
    return Fit(
        with_variables(task.crane, task.variables, point.u), task.variables, point.u, cov, point.knots, errors,
        linear.error if not linear.failed else math.inf, prior_cost(task.variables, point.u), converged, task.windows,
        linear, task.crane, task.data,
    )  # fmt: skip


def covariance(H: np.ndarray) -> np.ndarray:
    """Return the inverse of a Hessian (m, m); what the data do not determine gets a huge variance, where a
    pseudo-inverse gives none.
    """
    size = np.sqrt(np.maximum(np.diag(H), 1e-12))
    values, vectors = np.linalg.eigh(H / np.outer(size, size))
    return (vectors / np.maximum(values, 1e-14)) @ vectors.T / np.outer(size, size)
