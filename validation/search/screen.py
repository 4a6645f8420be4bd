"""A quick look at every effect: how much of the misfit would it explain, if it acted in proportion to its term?

Along the trajectory of a fitted model, each effect at each place (with typical parameters) adds a known term to one balance.
The response of all outputs to that term is linear in its amplitude, so one sweep and some linear algebra tell, for all
of them at once, how much the cost would fall, with the nominal parameters and the states free to move as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..fit.linear import Columns, columns_of, model_at, normal_equations, pack
from ..fit.model import model_of
from ..fit.solve import Fit, reduce, with_prior
from .candidates import Start

#: amplitudes are sought between these, in units of the start's own values
_SMALLEST, _LARGEST = 0.02, 20.0


@dataclass(frozen=True)
class Score:
    """What a start promises: the fall of the cost (log-likelihood, tempered) and the amplitude at which it is reached."""

    start: Start
    gain: float
    amplitude: float


def screen(fit: Fit, starts: Sequence[Start], stiffness: float) -> list[Score]:
    """Return the score of every start at a fit, best first; a start that changes nothing scores 0."""
    base = model_of(fit.crane, fit.data, fit.late)
    usable, models = [], []
    for start in starts:
        model = model_of(fit.crane.with_effect(start.key, start.values), fit.data, fit.late)
        usable.append(start)
        models.append(model)
    own = columns_of_fit(fit)
    probes = pack(base, models, np.ones(len(models)))
    room = len(fit.crane.layout.all_states) - fit.knots.shape[1]  # for a pendulum
    knots = np.pad(fit.knots, ((0, 0), (0, room)))
    linear = normal_equations(fit.windows, knots, base, join(own, probes), stiffness)
    if linear.failed:
        return [Score(s, 0.0, 1.0) for s in usable]
    reduced = reduce(linear, knots, knots)
    m = len(fit.u)
    H, g = reduced.H, reduced.g
    H[:m, :m], g[:m] = with_prior_block(fit, H[:m, :m], g[:m])
    return sorted(_scores(usable, H, g, m), key=lambda s: -s.gain)


def columns_of_fit(fit: Fit) -> Columns:
    """Return the columns of the fit's own variables around its values."""
    base = model_at(fit.origin, fit.variables, fit.u, fit.data)
    return columns_of(fit.origin, fit.variables, fit.u, base, fit.data)


def with_prior_block(fit: Fit, H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return Hessian and gradient of the fit's own variables with their priors."""
    from ..fit.solve import Reduced

    return with_prior(Reduced(H, g, np.empty(0), np.empty(0)), fit.variables, fit.u)


def join(a: Columns, b: Columns) -> Columns:
    """Return the columns of both, one after the other (both around the same base)."""
    return Columns(
        np.concatenate([a.P, b.P]), np.concatenate([a.E, b.E]), np.concatenate([a.W, b.W[1:]]),
        np.concatenate([a.W_index, np.where(b.W_index > 0, b.W_index + len(a.W) - 1, 0)]),
        np.concatenate([a.size, b.size]), np.concatenate([a.dynamic, b.dynamic]),
        np.concatenate([a.own, b.own]),
    )  # fmt: skip


def _scores(starts: Sequence[Start], H: np.ndarray, g: np.ndarray, m: int) -> list[Score]:
    """Project the fit's own variables out of the probes' normal equations and score each probe alone."""
    cross = (
        np.linalg.lstsq(H[:m, :m], np.column_stack([H[:m, m:], g[:m]]), rcond=None)[0]
        if m
        else np.zeros((0, len(g) + 1))
    )
    gradient = g[m:] - H[m:, :m] @ cross[:, -1]
    curvature = np.diag(H)[m:] - np.einsum("ij,ji->i", H[m:, :m], cross[:, :-1])
    found = []
    for start, slope, bend, own in zip(starts, gradient, curvature, np.diag(H)[m:], strict=True):
        if not bend > 1e-9 * max(own, 1e-12) or not np.isfinite(slope):
            found.append(Score(start, 0.0, 0.0))
            continue
        amplitude = -slope / bend
        limited = np.clip(abs(amplitude), _SMALLEST, _LARGEST) * np.sign(amplitude)
        if limited < 0.0 and not start.two_sided:
            found.append(Score(start, 0.0, _SMALLEST))
            continue
        gain = -(slope * limited + 0.5 * bend * limited**2)
        found.append(Score(start, float(max(gain, 0.0)), float(limited)))
    return found
