"""Explanations fitted exactly: effects of the library and laws beside each other, together with nominal parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from crane_exudyn.crane import Crane

from ..fit.data import Data
from ..fit.linear import Window, cut
from ..fit.solve import Fit, fit, reknot
from ..fit.staged import LOOSE, Stage, staged
from ..fit.variables import EffectVariable, Variable, curve_variables
from ..selection.model import Fitted, Model, begin, curve_of, unmoving, values_of
from .laws import Law
from .screen import Found


@dataclass(frozen=True)
class Part:
    """One effect of an explanation: its variables, and where they begin. `found` is None for an effect of the
    library.
    """

    key: str
    variables: tuple[EffectVariable, ...]
    u: np.ndarray
    found: Found | None = None

    @property
    def law(self) -> Law | None:
        """The law, None for an effect of the library."""
        return None if self.found is None else self.found.law

    @classmethod
    def of(cls, found: Found) -> Part:
        """Return the part of a law that was found by a screen; its prior is about the neutral curve."""
        law = found.law
        variables = tuple(curve_variables(law.key, law.values(law.neutral), found.root))
        return cls(law.key, variables, found.u, found)

    @classmethod
    def along(cls, found: Found, law: Law, y: np.ndarray, root: np.ndarray) -> Part:
        """Return the part of a law that moves from the curve y (K,) along the columns of root (K, m) alone."""
        variables = tuple(curve_variables(law.key, law.values(y), root))
        u = np.zeros(root.shape[1])
        return cls(law.key, variables, u, replace(found, law=law, root=root, u=u, y=y))


@dataclass(frozen=True)
class Explained:
    """Parts fitted together."""

    parts: tuple[Part, ...]
    weighed: Fitted

    @property
    def fit(self) -> Fit:
        """The last stage of the fit."""
        return self.weighed.fit

    @property
    def evidence(self) -> float:
        """Log marginal likelihood, up to a constant of the recording and the stage."""
        return self.weighed.evidence

    @property
    def laws(self) -> tuple[Part, ...]:
        """The parts that are curves."""
        return tuple(part for part in self.parts if part.law is not None)

    def curve(self, part: Part) -> tuple[np.ndarray, np.ndarray]:
        """Return the fitted values (K,) of a law at its knots and their covariance (K, K), SI."""
        return curve_of(self.fit, part.key)[1:]

    def told(self, part: Part) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return the knots (J,) at which a law is told, its values there and their covariance (J, J), SI."""
        assert part.law is not None
        (y, cov), M = self.curve(part), part.law.telling()
        return part.law.x if part.law.told is None else part.law.told, M @ y, M @ cov @ M.T

    def spread(self, part: Part) -> tuple[np.ndarray, np.ndarray]:
        """Return the fitted values (K,) of a law at its knots and their standard deviations (K,), SI."""
        y, cov = self.curve(part)
        return y, np.sqrt(np.maximum(np.diag(cov), 0.0))


def explain(
    crane: Crane, data: Data, shared: Sequence[Variable], before: Fit, parts: Sequence[Part], stages: Sequence[Stage]
) -> Explained:
    """Return parts fitted through the stages with the shared variables, from the knots (and where it has them the
    values) of an earlier fit.
    """
    known = values_of(before)
    u = [known.get(v.name, begin(v, before, {} if parts else known)) for v in shared]
    for part in parts:
        u += [known.get(v.name, float(x)) for v, x in zip(part.variables, part.u, strict=True)]
    variables = [*shared, *(v for part in parts for v in part.variables)]
    model, found = (
        Model(tuple(shared), {part.key: {} for part in parts}),
        staged(crane, data, variables, np.array(u), before, stages),
    )
    return Explained(tuple(parts), Fitted(model, found, found))


def kept(windows: Sequence[Window], block: float, out: int, number: int) -> np.ndarray:
    """Return (K,) whether a window lies in none of the blocks of time (s) that are left out, every `number`-th from
    `out` on.
    """
    begin = windows[0].data.time[0]
    return np.array([int((w.data.time[0] - begin) / block) % number != out for w in windows])


def left_out_gain(
    crane: Crane, shared: Sequence[Variable], before: Explained, after: Explained, block: float, number: int = 3
) -> tuple[float, float]:
    """Return what a further part gains where it was not fitted, in log-likelihood: on blocks of time left out in turn,
    and on all others.

    Both explanations are fitted again without each set of blocks, from where they ended, and then run through them, the
    first states of windows alone free.
    """
    inside = outside = 0.0
    for out in range(number):
        costs = [_split(crane, shared, e, block, out, number) for e in (before, after)]
        inside += 0.5 * (costs[0][0] - costs[1][0]) / (number - 1)
        outside += 0.5 * (costs[0][1] - costs[1][1])
    return outside, inside


def _split(
    crane: Crane, shared: Sequence[Variable], explained: Explained, block: float, out: int, number: int
) -> tuple[float, float]:
    """Return the costs of an explanation on the windows that it was fitted to, and on those left out."""
    whole = explained.fit
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
