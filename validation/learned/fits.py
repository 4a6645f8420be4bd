"""Models with learned laws, as they were fitted: their curves, and whether these predict what was left out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import cast

import numpy as np

from ..fit.knots import reknot
from ..fit.solve import Fit, fit
from ..fit.staged import LOOSE, STIFF
from ..fit.windows import Window, cut
from ..selection.model import Fitted, curve_of, fitted, unmoving
from ..selection.search import Problem
from .laws import Law
from .screen import Found


def laws_of(w: Fitted) -> dict[str, Found]:
    """Return the laws of a model by their effects."""
    return {key: cast(Found, curve) for key, curve in w.model.curves.items()}


def curve(w: Fitted, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the fitted values (K,) of a law at its knots and their covariance (K, K), SI."""
    return curve_of(w.fit, key)[1:]


def spread(w: Fitted, key: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the fitted values (K,) of a law at its knots and their standard deviations (K,), SI."""
    y, cov = curve(w, key)
    return y, np.sqrt(np.maximum(np.diag(cov), 0.0))


def tabulated(w: Fitted, key: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the knots (J,) at which a law is reported, its values there and their covariance (J, J), SI."""
    law, (y, cov) = laws_of(w)[key].law, curve(w, key)
    M = law.at_reported()
    return law.x if law.reported is None else law.reported, M @ y, M @ cov @ M.T


def kept(windows: Sequence[Window], block: float, out: int, number: int) -> np.ndarray:
    """Return (K,) whether a window lies in none of the blocks of time (s) that are left out, every `number`-th from
    `out` on.
    """
    begin = windows[0].data.time[0]
    return np.array([int((w.data.time[0] - begin) / block) % number != out for w in windows])


def left_out_gain(before: Fitted, after: Fitted, block: float, number: int = 3) -> tuple[float, float]:
    """Return what a further part gains where it was not fitted, in log-likelihood: on blocks of time left out in turn,
    and on all others.

    Both models are fitted again without each set of blocks, from where they ended, and then run through them, the
    first states of windows alone free.
    """
    inside = outside = 0.0
    for out in range(number):
        costs = [_split(w.fit, block, out, number) for w in (before, after)]
        inside += 0.5 * (costs[0][0] - costs[1][0]) / (number - 1)
        outside += 0.5 * (costs[0][1] - costs[1][1])
    return outside, inside


def _split(whole: Fit, block: float, out: int, number: int) -> tuple[float, float]:
    """Return the costs of a fit on the windows that it was fitted to again, and on those left out."""
    data = whole.data.stepped(LOOSE.step)
    windows = cut(data, LOOSE.seconds)
    stay = kept(windows, block, out, number)
    knots = reknot(whole, windows)
    chosen = [w for w, k in zip(windows, stay, strict=True) if k]
    learned = fit(whole.origin, data, chosen, knots[stay], whole.variables, whole.u, iterations=2)
    held = 0.0
    for i, part in enumerate(data.parts):
        mine = [k for k, w in enumerate(windows) if w.recording == i and not stay[k]]
        own, others = learned.of(i), [replace(windows[k], recording=0) for k in mine]
        if others:
            held += fit(unmoving(own.crane), part.shifted(own.late), others, knots[mine], iterations=2).linear.cost
    return learned.linear.cost, held


def refined(problem: Problem, best: Fitted) -> Fitted:
    """Return the model with curves that end where they are known, and with more knots where they bend if that is better
    supported.
    """
    narrow = {key: f.law.narrowed(*spread(best, key)) for key, f in laws_of(best).items()}
    if any(narrow[key] is not f.law for key, f in laws_of(best).items()):
        best = _reknotted(problem, best, narrow)
    closer = {key: f.law.refined(curve(best, key)[0]) for key, f in laws_of(best).items()}
    found = _reknotted(problem, best, closer)
    return found if found.evidence > best.evidence else best


def _reknotted(problem: Problem, best: Fitted, laws: Mapping[str, Law]) -> Fitted:
    """Return the model fitted again with its laws at other knots."""
    return with_curves(problem, best, {k: f.reknotted(laws[k], curve(best, k)[0]) for k, f in laws_of(best).items()})


def with_curves(problem: Problem, best: Fitted, curves: Mapping[str, Found]) -> Fitted:
    """Return the model fitted again with other curves for its laws."""
    kept = [i for i, v in enumerate(best.fit.variables) if getattr(v, "key", "") not in curves]
    before = replace(best.fit, variables=tuple(best.fit.variables[i] for i in kept), u=best.fit.u[kept])
    model = replace(best.model, curves=curves)
    found = fitted(problem.crane, problem.data, model, before, (STIFF,))
    return found if found.fit.converged else fitted(problem.crane, problem.data, model, found.fit, (STIFF, STIFF))
