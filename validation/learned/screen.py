"""All laws looked at at once: linear in the knots' values around a fit, smoothness found by marginal likelihood.

A fit's normal equations get one column a knot of every law. With everything else projected out, a law is a Gaussian
linear model of its values y: the cost falls by b'y - y'Hy/2. Its prior (`fit.variables.prior_root`) has a size and a
length, and those are taken that make the recording likeliest.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..fit.columns import Columns, pack
from ..fit.data import FitData
from ..fit.model import Model, model_of
from ..fit.solve import Fit
from ..fit.variables import EffectVariable, curve_variables, prior_root
from ..selection.screen import projected
from .laws import Law

#: what sizes and lengths of a prior are tried: in units of the argument's own size, and as shares of the range
SIZES = tuple(10.0 ** (0.5 * k) for k in range(-4, 5))
LENGTHS = (0.1, 0.2, 0.4, 0.8, math.inf)


@dataclass(frozen=True)
class Found:
    """A law with the prior that suits it: log marginal likelihood gained, and the most likely curve.

    Attributes:
        gain: log evidence against a model without this law, linearly.
        size, length: of the prior, see `prior_root`.
        root: (K, m) of the prior, y = about + root u.
        u: (m,) most likely, where fits begin.
        about: (K,) the neutral curve, or the form along which alone the law moves.
    """

    law: Law
    gain: float
    root: np.ndarray
    u: np.ndarray
    about: np.ndarray
    size: float = 0.0
    length: float = 0.0

    @property
    def name(self) -> str:
        """Of the law."""
        return self.law.name

    @property
    def y(self) -> np.ndarray:
        """The most likely curve, (K,)."""
        return self.about + self.root @ self.u

    @property
    def variables(self) -> list[EffectVariable]:
        """What its values move along, and where these begin."""
        moves = curve_variables(self.law.key, self.law.values(self.about), self.root)
        return [replace(v, begin=float(x)) for v, x in zip(moves, self.u, strict=True)]

    def beginning(self, u: np.ndarray) -> Found:
        """Return the same with its variables beginning at u (m,)."""
        return replace(self, u=u)

    def reknotted(self, law: Law, y: np.ndarray) -> Found:
        """Return the same law and prior with other knots, beginning at the curve that is y (K,) at its own."""
        root = prior_root(law.table(law.neutral), self.size, self.length)
        u = np.linalg.lstsq(root, law.curve(self.law.x, y) - law.neutral, rcond=None)[0]
        return replace(self, law=law, root=root, u=u, about=law.neutral)

    def along(self, law: Law, y: np.ndarray, root: np.ndarray) -> Found:
        """Return a law that moves from the curve y (K,) along the columns of root (K, m) alone."""
        return replace(self, law=law, root=root, u=np.zeros(root.shape[1]), about=y)


def screened(fit: Fit, laws: Sequence[Law], stiffness: float) -> list[Found]:
    """Return all laws at a fit, the likeliest first."""
    H, b = equations(fit, laws, stiffness)
    found, first = [], 0
    for law in laws:
        own = slice(first, first + len(law.x))
        first = own.stop
        found.append(best_prior(law, H[own, own], b[own]))
    return sorted(found, key=lambda f: -f.gain)


def equations(fit: Fit, laws: Sequence[Law], stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """Return H (n, n), b (n,) of the departures of all laws from neutral at their knots, SI, one law after the other.

    Everything else that the fit moves is projected out.
    """
    moves, sizes = [], np.array([law.over.size for law in laws for _ in law.x])
    for law in laws:
        for k in range(len(law.x)):
            moved = law.over.size * (np.arange(len(law.x)) == k)
            still = law.over.from_zero and k == 0  # stays in (0, 0)
            moves.append((law.key, law.values(law.neutral if still else law.neutral + moved)))

    def probes(base: Model, data: FitData, recording: int) -> Columns:
        models = [model_of(base.crane.with_effect(key, values), data, base.late, base) for key, values in moves]
        return pack(base, models, sizes)

    found, n = projected(fit, fit.knots, probes, stiffness), len(sizes)
    return (np.zeros((n, n)), np.zeros(n)) if found is None else (found.H, -found.g)


def best_prior(law: Law, H: np.ndarray, b: np.ndarray) -> Found:
    """Return a law with the prior of the greatest marginal likelihood under the cost y'Hy/2 - b'y of departures y
    (K,).
    """
    best: Found | None = None
    for length in LENGTHS:
        root = prior_root(law.table(law.neutral), abs(law.over.size), length)
        A, c = root.T @ H @ root, root.T @ b
        values, vectors = np.linalg.eigh(0.5 * (A + A.T))
        values, c = np.maximum(values, 0.0), vectors.T @ c
        for size in SIZES:
            stretched = 1.0 + size**2 * values
            gain = 0.5 * float((size**2 * c**2 / stretched).sum() - np.log(stretched).sum())
            if best is None or gain > best.gain:
                u = vectors @ (size * c / stretched)
                best = Found(law, gain, size * root, u, law.neutral, size * abs(law.over.size), length)
    assert best is not None
    return best


def allowed(found: Found) -> bool:
    """Whether the curve has the sign that physics asks of it, on the whole."""
    return not found.law.one_sided or float(np.mean(found.y - found.law.neutral)) > 0.0
