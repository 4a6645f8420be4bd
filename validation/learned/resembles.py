"""What a curve resembles: simple forms fitted to its knots with their covariance, told in engineering units."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.optimize import least_squares

from crane_exudyn.effects import registry
from crane_exudyn.effects.curve import Argument
from crane_exudyn.units import factor_to_si

from ..criteria import CRITERIA

#: SI unit -> the one in which a curve is read, where that is another one
_READ = {"Pa": "bar", "N": "kN", "m^3/s": "l/min", "rad": "deg", "rad/s": "deg/s"}


def read_in(unit: str) -> tuple[str, float]:
    """Return the unit in which a curve of an SI unit is read, and what one of it is in SI."""
    read = _READ.get(unit, unit)
    return read, factor_to_si(read, unit)


@dataclass(frozen=True)
class Form:
    """A simple form f(x; p): its name, the law, starting values from (x, y), and its words from parameters in read
    units.
    """

    name: str
    law: Callable[[np.ndarray, np.ndarray], np.ndarray]
    starts: Callable[[np.ndarray, np.ndarray], Sequence[Sequence[float]]]
    words: Callable[[np.ndarray, str, str], str]


@dataclass(frozen=True)
class Resemblance:
    """The form that a curve resembles, in words; values of its parameters in read units; the effect of the library that
    is this law, or ""; law(x, parameters) with x and the curve in SI.
    """

    name: str
    text: str
    parameters: tuple[float, ...] = ()
    library: str = ""
    law: Callable[[np.ndarray, Sequence[float]], np.ndarray] | None = field(default=None, repr=False)

    def at(self, x: np.ndarray) -> np.ndarray:
        """Return the form at x, SI."""
        assert self.law is not None
        return self.law(x, self.parameters)

    def moves(self, x: np.ndarray) -> np.ndarray:
        """Return (n, parameters) by how much the form at x moves, SI, while a parameter doubles."""
        assert self.law is not None
        columns = []
        for k, p in enumerate(self.parameters):
            more = [*self.parameters]
            more[k] += (step := 1e-4 * max(abs(p), 1e-9))
            columns.append((self.law(x, more) - self.at(x)) / step * abs(p))
        return np.column_stack(columns)


def _greatest(y: np.ndarray) -> float:
    return float(y[np.argmax(np.abs(y))])


def _line(x: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Return slope and zero of the straight line through points."""
    slope, level = np.polyfit(x, y, 1)
    return float(slope), float(-level / slope) if slope else 0.0


def _softplus(x: np.ndarray) -> np.ndarray:
    return np.maximum(x, 0.0)


FORMS = (
    Form(
        "constant",
        lambda x, p: np.full_like(x, p[0]),
        lambda x, y: [[float(np.mean(y))]],
        lambda p, u, v: f"{p[0]:.3g} {u} throughout",
    ),
    Form(
        "linear",
        lambda x, p: p[0] * x,
        lambda x, y: [[float(x @ y / (x @ x))]],
        lambda p, u, v: f"{p[0]:.3g} {_per(u, v)}",
    ),
    Form(
        "spring",
        lambda x, p: p[0] * (x - p[1]),
        lambda x, y: [list(_line(x, y))],
        lambda p, u, v: f"{p[0]:.3g} {_per(u, v)} about {p[1]:.3g} {v}",
    ),
    Form(
        "square root",
        lambda x, p: p[0] * np.sign(x) * np.sqrt(np.abs(x)),
        lambda x, y: [[_greatest(y) / math.sqrt(float(np.abs(x).max()))]],
        lambda p, u, v: f"{p[0]:.3g} {_per(u, f'√{v}' if v else '')}",
    ),
    Form(
        "power",
        lambda x, p: p[0] * np.sign(x) * np.abs(x) ** abs(p[1]),
        lambda x, y: [[_greatest(y) / float(np.abs(x).max()) ** n, n] for n in (0.5, 1.5, 2.0)],
        lambda p, u, v: f"{p[0]:.3g} {u} times the power {abs(p[1]):.3g}{_of(v)}",
    ),
    Form(
        "dead zone",
        lambda x, p: p[0] * (_softplus(x - abs(p[1])) - _softplus(-x - abs(p[1]))),
        lambda x, y: [
            [_greatest(y) / float(np.abs(x).max()) / (1.0 - a), a * float(np.abs(x).max())] for a in (0.1, 0.4, 0.7)
        ],
        lambda p, u, v: f"nothing up to {abs(p[1]):.3g} {v}, then {p[0]:.3g} {_per(u, v)}",
    ),
    Form(
        "saturation",
        lambda x, p: p[0] * np.tanh(x / p[1]),
        lambda x, y: [[_greatest(y), a * float(np.abs(x).max())] for a in (0.1, 0.4)],
        lambda p, u, v: f"rises to {p[0]:.3g} {u} within {abs(p[1]):.3g} {v}",
    ),
    Form(
        "bump",
        lambda x, p: p[0] * np.exp(-(((x - p[1]) / p[2]) ** 2)),
        lambda x, y: [[_greatest(y), float(x[np.argmax(np.abs(y))]), a * float(np.ptp(x))] for a in (0.1, 0.3)],
        lambda p, u, v: f"{p[0]:.3g} {u} within {p[1]:.3g} ± {abs(p[2]):.2g} {v}",
    ),
    Form(
        "Stribeck",
        lambda x, p: p[0] + p[1] * np.exp(-np.abs(x / p[2])),
        lambda x, y: [[float(y[-1]), float(y[0] - y[-1]), 0.15 * float(np.ptp(x))]],
        lambda p, u, v: f"from {p[0] + p[1]:.3g} {u} at 0 to {p[0]:.3g} {u} within {abs(p[2]):.3g} {v}",
    ),
)


def _per(unit: str, other: str) -> str:
    return f"{unit or '1'}/{other}" if other else unit


def _of(unit: str) -> str:
    return f" of {unit}" if unit else ""


def resembles(
    x: np.ndarray, y: np.ndarray, cov: np.ndarray, over: Argument, unit: str, key: str, against: bool
) -> Resemblance:
    """Return what a curve y (K,) with covariance (K, K) at knots x (K,) resembles, in SI; a Resemblance without name if
    nothing.

    The forms compete by BIC. A curve over the spool is described as a whole, one over the pressure drop of a valve by
    its factor.
    """
    (x_unit, fx), (y_unit, fy) = read_in(over.unit), read_in(unit)
    X, Y, spread = x / fx, y / fy, _whitener(cov / fy**2, y / fy)
    best: tuple[float, Form, np.ndarray, float] | None = None
    for form in FORMS:
        for start in form.starts(X, Y):
            solved = least_squares(
                lambda p, f=form: spread @ (f.law(X, p) - Y),
                start,
                x_scale=np.maximum(np.abs(start), 1e-3),
                max_nfev=200,
            )
            bic = 2.0 * solved.cost + len(start) * math.log(len(X))
            if np.isfinite(bic) and (best is None or bic < best[0]):
                best = bic, form, solved.x, 2.0 * solved.cost
    if best is None:
        return Resemblance("", "")
    _, form, p, squares = best
    left = np.abs(form.law(X, p) - Y).max()
    departure = np.abs(Y - [over.neutral(v * fx) / fy for v in X]).max()
    if math.sqrt(squares / len(X)) > CRITERIA.form_errors and left > CRITERIA.form_share * departure:
        return Resemblance("", "")
    words = form.words(p, y_unit, x_unit).replace("  ", " ").strip()
    text = _form_text(form, p, words, over)
    law = lambda s, q: form.law(np.asarray(s) / fx, q) * fy  # noqa: E731
    return Resemblance(form.name, text, tuple(p), _library(form, key, over, against), law)


def _whitener(cov: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return W with W cov W' = 1; what a curve cannot be trusted for (1 % of its size) is added."""
    values, vectors = np.linalg.eigh(cov + (0.01 * np.abs(y).max()) ** 2 * np.eye(len(y)))
    return vectors.T / np.sqrt(values)[:, None]


def _form_text(form: Form, p: np.ndarray, words: str, over: Argument) -> str:
    if over.name == "spool" and form.name == "power":
        factor = "" if abs(p[0] - 1.0) < 0.05 else f"{p[0]:.3g} "
        return f"opening = {factor}U^{abs(p[1]):.3g}"
    if form.name == "bump":
        return f"{words} of the {over.name.replace('_', ' ')}"
    name = "exponential" if form.name == "Stribeck" and over.name not in ("speed", "rate") else form.name
    return f"{name}: {words}"


def as_large(form: Resemblance, key: str, start: Mapping[str, float]) -> dict[str, float]:
    """Return the parameters of an effect of the library, as they are to start with, scaled to what a curve says: its
    first one is the constant or the slope of a form, and those of its unit go with it.
    """
    if form.name not in ("constant", "linear"):
        return dict(start)
    first, *others = registry.split_key(key)[0].parameters
    factor = float(form.at(np.ones(1))[0]) / start[first.name]
    alike = {first.name, *(p.name for p in others if p.unit == first.unit)}
    return {name: factor * value if name in alike else value for name, value in start.items()}


def _library(form: Form, key: str, over: Argument, against: bool) -> str:
    """Return the effect of the library whose law a form is, with its place; "" if there is none."""
    name, _, place = key.partition("@")
    known = {
        ("learned_leakage", "linear"): "internal_leakage",
        ("learned_flow", "linear"): "external_leakage",
        ("learned_supply", "linear"): "pump_droop",
        ("learned_return", "linear"): "return_back_pressure",
        ("learned_opening", "dead zone"): "dead_band",
    }
    if (name, over.name) == ("learned_torque", "rate"):
        known[name, "linear"] = "joint_viscous_friction"
    if name == "learned_torque" and (against or over.name == "rate"):
        known[name, "constant"] = "joint_coulomb_friction"
    if name == "learned_force" and against:
        known |= {
            "pressure_drop": {("learned_force", "linear"): "pressure_dependent_friction"},
            "speed": {("learned_force", "constant"): "seal_friction", ("learned_force", "Stribeck"): "seal_friction"},
        }.get(over.name, {("learned_force", "constant"): "seal_friction"})
    found = known.get((name, form.name), "")
    return f"{found}@{place}" if found and place else found
