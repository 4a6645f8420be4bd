"""Which balance is violated: the residual flow of each chamber and the residual moment of each joint, with uncertainty.

The model gets unknown inputs: a moment on each joint and a flow into each chamber,

    M z'' = … + torque,        p' = Be/V (… + flow),

each a random process that forgets within `MEMORY`. State and inputs together are estimated by an extended Kalman filter
and a Rauch-Tung-Striebel smoother around the machine's own trajectory. An input that stays away from zero is a term
that the equation lacks. What the sensors cannot tell apart (moment and pressure, where a pressure is not measured)
comes with wide uncertainty.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import pairwise
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.hydraulics import vapour_pressure
from crane_exudyn.layout import Layout
from ukf.filter import Belief, FilterError, update_linear
from ukf.smoother import smooth as smoothed

from .fit.data import FitData
from .fit.model import Model, model_of
from .fit.start import knots_of
from .fit.windows import cut, jump_of
from .semi_recursive import sensitivity

#: standard deviation of an unknown input before anything was measured, by unit
_SPREAD: Mapping[str, float] = {"N*m": 300.0, "N": 300.0, "m^3/s": 5e-5}
#: time in s after which an unknown input may be another
MEMORY = 0.3
#: the smoother is run again around what it found, until states and inputs move by less than this (RMS, in units of
#: `jump_of` and `spread_of`), or so often
_SETTLED_STATE, _SETTLED_INPUT, _ROUNDS = 0.5, 0.03, 6
#: length of the stretches in which long recordings are treated, s: what the smoother needs for one is some 100 MB
_CHUNK = 30.0
#: time between the knots of the first trajectory, s
_KNOTS = 0.1
#: Pa above the floor up to which a smoothed pressure counts as standing on it
_AT_FLOOR = 0.5e5
#: spread of the first state around its guess, and growth of what the model does not say a step, in units of `jump_of`
START_STD, GROWTH = 30.0, 1e-4


@cache
def spread_of(layout: Layout) -> np.ndarray:
    """Return the standard deviation of each unknown input of `layout.equations` before anything was measured, SI."""
    return np.array(layout.sized(layout.equations, _SPREAD))


@dataclass(frozen=True)
class Balances:
    """Residuals of all balances along a recording.

    Attributes:
        time: (K,) s, the instants of the smoother.
        states: (K, nx) smoothed states.
        layout: of the machine; values, std: (K, b) residual of each of its `equations` and its standard deviation, SI.
        log_likelihood: of all samples under this model with unknown inputs.
        covariance: (K, n, b) of [state, inputs] with the inputs; gains: (K, n, n) of the smoother.
        unsettled: stretches (from, to) in s in which the smoother still moved after its last round.
        floor: pressure in Pa below which the model's oil does not go.
    """

    time: np.ndarray
    states: np.ndarray
    layout: Layout
    values: np.ndarray
    std: np.ndarray
    log_likelihood: float
    covariance: np.ndarray = field(repr=False)
    gains: np.ndarray = field(repr=False)
    unsettled: tuple[tuple[float, float], ...] = ()
    floor: float = 0.0

    @property
    def at_floor(self) -> np.ndarray:
        """Return (K, chambers) whether a chamber stands at the pressure floor, where the model takes any flow out of
        it.
        """
        return self.states[:, self.layout.pressures] <= self.floor + _AT_FLOOR

    def mean(self, first: int, last: int) -> tuple[np.ndarray, np.ndarray]:
        """Return the mean residuals (b,) over instants first … last - 1, and their standard deviations (b,).

        Errors of neighbouring instants are not independent: cov(x_k, x_i) = G_k cov(x_k+1, x_i) with the smoother's
        gains G, which is summed up from the end.
        """
        _, n, b = self.covariance.shape
        inputs = slice(n - b, n)  # the covariance has their columns only
        with_sum = np.zeros((n, b))  # cov(x_k, sum of the inputs from k on)
        total = np.zeros(b)
        for k in range(last - 1, first - 1, -1):
            later = self.gains[k] @ with_sum if k + 1 < last else with_sum
            own = self.covariance[k]
            total += np.diag(own[inputs]) + 2.0 * np.diag(later[inputs])
            with_sum = own + later
        mean = self.values[first:last].mean(axis=0)
        return mean, np.sqrt(np.maximum(total, 0.0)) * spread_of(self.layout) / (last - first)


def balances_of(crane: Crane, data: FitData) -> Balances:
    """Return the residuals of all balances of a crane along a recording.

    The first trajectory starts anew at every knot, `_KNOTS` apart, from what the sensors show there, so that it is near
    the machine however wrong the model is.

    Raises:
        CraneError: the model cannot be run along the recording.
    """
    model = model_of(crane, data)
    windows = cut(data, _KNOTS)
    starts = np.array([w.start for w in windows])
    knots = _wide(knots_of(crane, data, windows), model.nx)
    parts = []
    for first, last in _chunks(data, starts):
        chosen = (starts >= first) & (starts < last)
        part = replace(model, W=model.W[first : last + 1])
        parts.append(_balances(part, data.part(first, last), starts[chosen] - first, knots[chosen]))
    return _joined(parts)


def _chunks(data: FitData, starts: np.ndarray) -> list[tuple[int, int]]:
    """Return first and last grid point of pieces that are short enough to be held in memory, each from start to start
    of a window.
    """
    found = []
    for first, last in data.stretches:
        edges = [*starts[(starts >= first) & (starts < last)].tolist(), last]
        pieces = max(1, round((last - first) * data.step / _CHUNK))
        chosen = [edges[i] for i in np.linspace(0, len(edges) - 1, pieces + 1).round().astype(int)]
        found += list(pairwise(chosen))
    return found


def _wide(knots: np.ndarray, nx: int) -> np.ndarray:
    """Return knots (K, nx): a pendulum that they lack hangs at rest."""
    return np.pad(knots, ((0, 0), (0, nx - knots.shape[1])))


def _left_behind(data: FitData, time: float) -> CraneError:
    """Return what is said of a model that cannot be run along a recording."""
    return CraneError(
        f"{data.name}: the model cannot follow this recording at t = {time:.3f} s (a pose or pressure out of its "
        "reach). It may be another machine, or a channel with a wrong sign or unit."
    )


def _balances(model: Model, data: FitData, starts: np.ndarray, knots: np.ndarray) -> Balances:
    """Return the residuals along a stretch that is short enough to be held in memory at once."""
    lay, nx, stride = model.crane.layout, model.nx, _stride(data)
    spread, jump = spread_of(lay), jump_of(lay)[:nx]
    inputs = np.zeros((len(data.time), len(spread)))
    for _ in range(_ROUNDS):
        steps = linearised(model, data, starts, knots, inputs, stride)
        try:
            smoothed = smooth(steps)
        except FilterError as problem:  # derivatives so large that no digit of the covariances is left
            raise _left_behind(data, float(data.time[stride * (problem.step or 0)])) from problem
        states = steps.states + smoothed.mean[:, :nx] * jump
        found = steps.inputs + smoothed.mean[:, nx:]
        at = data.time[::stride][: len(found)]
        knots = np.column_stack([np.interp(data.time[starts], at, x) for x in states.T])
        inputs = np.column_stack([np.interp(data.time, at, d) for d in found.T])
        moved = np.sqrt(np.mean(smoothed.mean**2, axis=0))
        settled = moved[:nx].max() < _SETTLED_STATE and moved[nx:].max() < _SETTLED_INPUT
        if settled:
            break
    unsettled = () if settled else ((float(at[0]), float(at[-1])),)
    std = np.sqrt(np.maximum(np.einsum("kii->ki", smoothed.covariance), 0.0))[:, nx:] * spread
    return Balances(
        at, states, lay, found * spread, std, smoothed.log_likelihood,
        smoothed.covariance[:, :, nx:].astype(np.float32),
        smoothed.gains.astype(np.float32), unsettled, float(vapour_pressure(model.P)),
    )  # fmt: skip


def _joined(parts: list[Balances]) -> Balances:
    """Return stretches, which are used up, one after the other; the last instant of one is the first of the next, and
    errors across are independent.
    """
    ends = [slice(None, -1)] * (len(parts) - 1) + [slice(None)]
    for part in parts[:-1]:
        part.gains[-2] = 0.0

    whole: dict[str, Any] = {
        "log_likelihood": sum(part.log_likelihood for part in parts),
        "unsettled": _touching([stretch for part in parts for stretch in part.unsettled]),
        "floor": parts[0].floor,
        "layout": parts[0].layout,
    }
    names = ("time", "states", "values", "std", "covariance", "gains")
    pieces = {n: [getattr(part, n)[end] for part, end in zip(parts, ends, strict=True)] for n in names}
    parts.clear()  # of ten minutes they are 150 MB: each column is let go once it is joined
    return Balances(**whole | {n: np.concatenate(pieces.pop(n)) for n in names})


def _touching(spans: Sequence[tuple[float, float]]) -> tuple[tuple[float, float], ...]:
    """Return spans, those joined to one between which no unknown input could become another."""
    found: list[tuple[float, float]] = []
    for begin, end in spans:
        if found and begin <= found[-1][1] + MEMORY:
            begin = found.pop()[0]
        found.append((begin, end))
    return tuple(found)


def _stride(data: FitData) -> int:
    """Return how many grid steps lie between two samples of the fastest channel."""
    return max(
        1, min(round(float(np.median(np.diff(s.index + s.fraction)))) for s in data.samples if len(s.values) > 1)
    )


@dataclass(frozen=True)
class Steps:
    """The model made linear around a trajectory, from one instant of the smoother to the next; scaled by `jump_of` and
    `spread_of`.

    Deviations x (nx,) and inputs d (b,): x_k+1 = A_k x_k + B_k d_k + jump_k, y_k = C_k x_k.

    Attributes:
        states: (K, nx) the trajectory, SI; inputs: (K, b) those it was run with, scaled.
        A (K-1, nx, nx), B (K-1, nx, b), jump (K-1, nx).
        C (K, m, nx), residual (K, m): measured minus shown in noise units, NaN without sample; spread (K, m).
        forget: how much of an input is left after one step.
    """

    states: np.ndarray
    inputs: np.ndarray
    A: np.ndarray
    B: np.ndarray
    jump: np.ndarray
    C: np.ndarray
    residual: np.ndarray
    spread: np.ndarray
    forget: float


def linearised(
    model: Model, data: FitData, starts: np.ndarray, knots: np.ndarray, inputs: np.ndarray, stride: int
) -> Steps:
    """Return the model made linear around the trajectory that starts anew at each knot, with inputs (N, b) on the
    grid.
    """
    X, A, B, jump = _transitions(model, data, starts, knots, inputs)
    scale = jump_of(model.crane.layout)[: model.nx]
    A, B, jump = A * (scale / scale[:, None]), B * (spread_of(model.crane.layout) / scale[:, None]), jump / scale
    A, B, jump = _compounded(A, B, jump, stride)
    C, residual, spread = _observed(model, data, X, scale, stride, len(A) + 1)
    K = len(A) + 1
    return Steps(
        X[::stride][:K],
        inputs[::stride][:K],
        A,
        B,
        jump,
        C,
        residual,
        spread,
        float(np.exp(-stride * data.step / MEMORY)),
    )


def _transitions(
    model: Model, data: FitData, starts: np.ndarray, knots: np.ndarray, inputs: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return states (N, nx), and A (N-1, nx, nx), B (N-1, nx, b), jump (N-1, nx) of every grid step, SI."""
    lay = model.crane.layout
    nx, spread, columns = model.nx, spread_of(lay), [lay.all_inputs.index(e) for e in lay.equations]
    W = np.zeros((1 + len(columns), len(data.time), len(lay.all_inputs)))
    W[:, :, : model.W.shape[1]] = model.W
    W[:, :, columns] += inputs * spread
    for j, column in enumerate(columns):
        W[1 + j, :, column] += spread[j]
    m = len(columns)
    P, E = np.tile(model.P, (m, 1)), np.tile(model.E, (m, 1))
    at = np.sort(np.concatenate([np.arange(len(data.time)), starts[1:]]))  # a window ends where the next one begins
    run = sensitivity.sweep(
        knots,
        starts + np.arange(len(starts)),
        W[:, at],
        data.step,
        data.time[starts],
        model.P,
        model.E,
        P,
        E,
        spread,
        np.arange(1, 1 + m),
        topology=model.topology,
        want_phi=True,
        allowed=model.accuracy,
    )
    if run.status.any() or not np.isfinite(run.X).all():
        raise _left_behind(data, float(data.time[at[run.failed.max()]]))
    before = np.flatnonzero(np.diff(at))  # of each step
    A, response = run.Phi[before + 1], run.S[before + 1, :, nx:]
    B = response - A @ run.S[before, :, nx:]
    X = run.X[[*before, len(at) - 1]]
    return X, A, B, run.X[before + 1] - X[1:]


def _compounded(
    A: np.ndarray, B: np.ndarray, jump: np.ndarray, stride: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the transitions over `stride` steps each, inputs held constant within."""
    whole = len(A) // stride * stride
    A0, B0, j0 = A[0:whole:stride], B[0:whole:stride], jump[0:whole:stride]
    for i in range(1, stride):
        Ai = A[i:whole:stride]
        A0, B0 = Ai @ A0, Ai @ B0 + B[i:whole:stride]
        j0 = np.einsum("kij,kj->ki", Ai, j0) + jump[i:whole:stride]
    return A0, B0, j0


def _observed(
    model: Model, data: FitData, X: np.ndarray, scale: np.ndarray, stride: int, count: int
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return C (K, m, nx), residuals (K, m) and their spread (K, m), in noise units, at every stride-th grid point."""
    channels = data.channels
    measurement = model.measurement(channels)
    Z, (_, C) = measurement.shown(X, data.time), measurement.rows(X)
    residual, spread = np.full((count, len(channels)), np.nan), np.ones((count, len(channels)))
    C = C[::stride][:count] * scale
    for j, s in enumerate(data.samples):
        at = np.minimum(np.round((s.index + s.fraction) / stride).astype(int), count - 1)
        number = np.bincount(at, minlength=count)
        total = np.bincount(at, s.residuals(Z[:, j]), minlength=count)
        there = number > 0
        residual[there, j], spread[there, j] = total[there] / number[there], 1.0 / np.sqrt(number[there])
        C[:, j] /= s.noise
    return C, residual, spread


@dataclass(frozen=True)
class _Smoothed:
    mean: np.ndarray
    covariance: np.ndarray
    gains: np.ndarray
    log_likelihood: float


def smooth(steps: Steps) -> _Smoothed:
    """Return smoothed deviations (K, n) of state and inputs, covariances (K, n, n) and gains (K, n, n)."""
    K, nx = steps.states.shape
    n = nx + steps.inputs.shape[1]
    F, constant, Q = augmented(steps)
    start = np.zeros(n)
    start[nx:] = -steps.inputs[0]
    belief = Belief(start, np.diag(np.r_[np.full(nx, START_STD**2), np.ones(n - nx)]))
    means, predicted = np.empty((K, n)), np.empty((K, n))
    covariances, spread, crosses, gains = (np.zeros((K, n, n)) for _ in range(4))
    likelihood = 0.0
    for k in range(K):
        if k:
            crosses[k] = belief.covariance @ F[k - 1].T
            belief = Belief(F[k - 1] @ belief.mean + constant[k - 1], F[k - 1] @ crosses[k] + Q)
        predicted[k], spread[k] = belief.mean, belief.covariance
        belief, gained = _corrected(belief, steps.C[k], steps.residual[k], steps.spread[k], k)
        likelihood += gained
        means[k], covariances[k] = belief.mean, belief.covariance
    mean, covariance = smoothed(means, covariances, predicted, spread, crosses, gains=gains)
    return _Smoothed(mean, covariance, gains, likelihood)


def augmented(steps: Steps) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return F (K-1, n, n), constant (K-1, n) and Q (n, n) of [x d]: d_k+1 = forget · d_k + noise, about the inputs
    found before.
    """
    K, nx = steps.states.shape
    n = nx + steps.inputs.shape[1]
    F = np.zeros((K - 1, n, n))
    F[:, :nx, :nx], F[:, :nx, nx:] = steps.A, steps.B
    F[:, nx:, nx:] = steps.forget * np.eye(n - nx)
    constant = np.column_stack([steps.jump, steps.forget * steps.inputs[:-1] - steps.inputs[1:]])
    Q = np.diag(np.r_[np.full(nx, GROWTH**2), np.full(n - nx, 1.0 - steps.forget**2)])
    return F, constant, Q


def _corrected(
    belief: Belief, C: np.ndarray, residual: np.ndarray, spread: np.ndarray, step: int
) -> tuple[Belief, float]:
    """Return the belief and the log-likelihood after the samples of one instant."""
    seen = np.isfinite(residual)
    if not seen.any():
        return belief, 0.0
    H = np.zeros((int(seen.sum()), len(belief.mean)))
    H[:, : C.shape[1]] = C[seen]
    found = update_linear(belief, H, residual[seen] - H @ belief.mean, np.diag(spread[seen] ** 2), step=step)
    return found, found.log_likelihood
