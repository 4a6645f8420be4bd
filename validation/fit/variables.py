"""What may move in a fit: nominal parameters within their uncertainty, and parameters of effects.

Every variable is a number u of order one: 0 is the starting value, the step of 1 is one standard uncertainty (nominal
parameters) or one typical size (effects). A vector of such numbers turns the crane as given into another crane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.crane_toml import unit_at
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import Parameter
from crane_exudyn.effects.curve import Table
from crane_exudyn.layout import Layout

from ..criteria import CRITERIA

#: scale of a parameter of which only a range is known: this share of the range
_RANGE_SHARE = 0.15
SUPPLY = ("supply.pump_pressure", "supply.tank_pressure")
#: share of the pump's pressure that the tank's is kept below
_TANK_SHARE = 0.9
#: by how many seconds a moment is shifted to see what that does: something that happens within a simulation step has no
#: derivative
_MOMENT = 0.01


@dataclass(frozen=True)
class NominalDirection:
    """A joint move of nominal parameters: parameter i moves by weights[i] (SI) per unit of u.

    `prior` is the standard deviation of u before the data (infinite: only the bounds of the parameters speak).
    """

    name: str
    weights: Mapping[str, float]
    prior: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf
    difference: float = 1e-4
    recording: int | None = None  # the one that it belongs to, of several; None: all of them

    def moved(self, values: dict[str, float], u: float) -> None:
        """Add the move to `values` (SI by name), in place."""
        for name, weight in self.weights.items():
            values[name] += weight * u


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect at a place. Where the neutral value is infinite, u is typical / value.

    Attributes:
        stated: the crane file has the effect: u = 0 is the file's value, known to a third like a rough nominal
            parameter.
    """

    key: str
    parameter: Parameter
    start: float
    difference: float = 1e-4
    stated: bool = False
    recording: ClassVar[None] = None

    @property
    def name(self) -> str:
        """ "name@place:parameter"."""
        return f"{self.key}:{self.parameter.name}"

    @property
    def prior(self) -> float:
        """Standard deviation of u: what needs many times the size that is met in practice explains nothing; none for
        what only shapes a law.
        """
        if self._about_start:
            return 1.0
        return math.inf if self.parameter.shape or self.stated else CRITERIA.plausible

    @property
    def inverse(self) -> bool:
        """Whether u runs with the inverse of the value (neutral at infinity)."""
        return math.isinf(self.parameter.neutral)

    @property
    def scale(self) -> float:
        """Size of the value at which u has moved by one."""
        return abs(self.start) / 3.0 if self._about_start else abs(self.parameter.typical - self._origin)

    @property
    def _about_start(self) -> bool:
        return self.stated and not self.inverse and self.start != 0.0

    @property
    def _origin(self) -> float:
        if self._about_start:
            return self.start
        return 0.0 if self.inverse or self.parameter.shape else self.parameter.neutral

    def to_u(self, value: float) -> float:
        """Return u of a value in SI."""
        return self.parameter.typical / value if self.inverse else (value - self._origin) / self.scale

    def to_value(self, u: float) -> float:
        """Return the value in SI of u, within the range."""
        if self.inverse:
            value = self.parameter.typical / u if u > 1e-12 else math.inf
        else:
            value = self._origin + self.scale * u
        return min(max(value, self.parameter.lower), self.parameter.upper)

    @property
    def lower(self) -> float:
        """Smallest u."""
        return 0.0 if self.inverse else self.to_u(self.parameter.lower)

    @property
    def upper(self) -> float:
        """Largest u."""
        return self.to_u(self.parameter.lower if self.inverse else self.parameter.upper)

    @property
    def neutral(self) -> float:
        """u at which the effect is off."""
        return self.to_u(self.parameter.neutral) if self._about_start else 0.0

    @property
    def begin(self) -> float:
        """u of the starting value."""
        return self.to_u(self.start)


@dataclass(frozen=True)
class CurveDirection:
    """A joint move of the values of a curve (`Effect.curve`): value k moves by weights[k] (SI) per unit of u, whose
    prior deviation is 1.

    `start` are the effect's parameters at u = 0.
    """

    key: str
    number: int
    start: Mapping[str, float]
    weights: Mapping[str, float]
    prior: float = 1.0
    lower: float = -math.inf
    upper: float = math.inf
    difference: float = 1e-3
    begin: float = 0.0
    recording: ClassVar[None] = None

    @property
    def name(self) -> str:
        """ "name@place:curve number"."""
        return f"{self.key}:curve {self.number}"

    def moved(self, values: dict[str, float], u: float) -> None:
        """Add the move to the effect's parameters, in place."""
        for name, weight in self.weights.items():
            values[name] += weight * u


@dataclass(frozen=True)
class Timing:
    """Lateness of the recorded commands against the sensors, common to all valves; one is `scale` seconds.

    A recorder's clocks agree no better than its sampling, and a command is held for a part of a control step: this is
    no property of the crane.
    """

    scale: float
    prior: float = 1.0
    name: str = "timing"
    lower: float = -3.0
    upper: float = 3.0
    difference: float = 0.5
    recording: int | None = None


EffectVariable = EffectParameter | CurveDirection
Variable = NominalDirection | EffectVariable | Timing


def acts(variable: Variable, recording: int | None) -> bool:
    """Whether a variable belongs to one of several recordings (None: to what they share)."""
    return variable.recording in (None, recording)


def expected_std(variables: Sequence[Variable]) -> np.ndarray:
    """Return the standard deviations of u (m,) that are expected before the data, of those without a prior too."""
    return np.array([CRITERIA.broad if math.isinf(v.prior) else v.prior for v in variables])


def alone(variable: Variable) -> Variable:
    """Return the variable as one of the only recording that there is."""
    return replace(variable, recording=None) if isinstance(variable, NominalDirection | Timing) else variable


def lateness(variables: Sequence[Variable], u: np.ndarray, recording: int | None = None) -> float:
    """Return by how many seconds the variables shift the commands of a recording."""
    pairs = zip(variables, u, strict=True)
    return sum(v.scale * float(x) for v, x in pairs if isinstance(v, Timing) and acts(v, recording))


def at_place(parameter: Parameter, place: str, layout: Layout) -> Parameter:
    """Return a parameter of an effect at a place: what has the unit of the sensor there gets it, and that sensor's
    telling size.
    """
    if parameter.unit != "channel":
        return parameter
    telling = layout.sensors[place].sizes.telling
    return replace(parameter, unit=unit_at(parameter.unit, place, layout), typical=parameter.neutral + telling)


def stated_effects(crane: Crane) -> list[EffectVariable]:
    """Return the variables of the effects that a crane file has, held near its values (those of curves have a prior of
    their own).
    """
    found = [v for e in crane.effects for v in effect_variables(e.key, e.parameters, crane.layout)]
    return [replace(v, stated=True) if isinstance(v, EffectParameter) else v for v in found]


def effect_variables(key: str, start: Mapping[str, float], layout: Layout) -> list[EffectVariable]:
    """Return the variables of the effect "name@place" of a machine with starting values (SI); others start neutral.

    Those of a curve are joint moves of its values, smooth ones more than others.
    """
    effect, place = registry.split_key(key, layout)
    if effect.curve is not None:
        return list(curve_variables(key, start, prior_root(effect.curve.table(start))))
    parameters = [at_place(p, place, layout) for p in effect.parameters]
    return [
        EffectParameter(key, p, float(start.get(p.name, p.neutral)), _MOMENT / abs(p.typical) if p.moment else 1e-4)
        for p in parameters
    ]


def curve_variables(key: str, start: Mapping[str, float], root: np.ndarray) -> list[CurveDirection]:
    """Return the variables of a curve: column k of `root` (knots, m) is what variable k moves, SI."""
    return [
        CurveDirection(key, k, dict(start), {f"y{i + 1}": float(w) for i, w in enumerate(column)})
        for k, column in enumerate(root.T)
    ]


def prior_root(table: Table, size: float | None = None, length: float = 0.2) -> np.ndarray:
    """Return B (knots, m) of a curve's prior y = neutral + B u, u standard normal: a line and a smooth departure from
    it (Matérn 5/2).

    Args:
        table: knots; a curve that begins in (0, 0) keeps that.
        size: standard deviation (SI) of either; by default the greatest departure of the curve from the neutral one.
        length: over which share of the range the departure changes; infinite for the line alone.
    """
    x = np.array(table.x)
    departure = np.abs(np.array(table.y) - [table.over.neutral(v) for v in x]).max()
    size = size or max(float(departure), abs(table.over.size))
    t = (x - x[0]) / (x[-1] - x[0])
    K = np.outer(t, t) if table.over.from_zero else 0.5 * (1.0 + np.outer(2.0 * t - 1.0, 2.0 * t - 1.0))
    if math.isfinite(length):
        r = math.sqrt(5.0) * np.abs(np.subtract.outer(t, t)) / length
        smooth = (1.0 + r + r * r / 3.0) * np.exp(-r)
        K = K + (smooth - np.outer(smooth[:, 0], smooth[0]) if table.over.from_zero else smooth)
    values, vectors = np.linalg.eigh(K)
    kept = values > 1e-9 * values[-1]
    return size * vectors[:, kept] * np.sqrt(values[kept])


def with_variables(crane: Crane, variables: Sequence[Variable], u: np.ndarray, recording: int | None = None) -> Crane:
    """Return the crane that the values u (one each variable) describe, as it was in a recording (None: what all
    share).
    """
    values = dict(crane.values)
    effects: dict[str, dict[str, float]] = {}
    for variable, number in zip(variables, u, strict=True):
        if not acts(variable, recording):
            continue
        if isinstance(variable, NominalDirection):
            variable.moved(values, float(number))
        elif isinstance(variable, CurveDirection):
            variable.moved(effects.setdefault(variable.key, dict(variable.start)), float(number))
        elif isinstance(variable, EffectParameter):
            effects.setdefault(variable.key, {})[variable.parameter.name] = variable.to_value(float(number))
    acting = {e.key: e.parameters for e in crane.effects}
    return crane.changed(physical(crane, values), {key: {**acting.get(key, {}), **own} for key, own in effects.items()})


def physical(crane: Crane, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values that differ from the crane's, kept within hard limits and what is
    possible."""
    kept = {}
    for name, value in values.items():
        nominal = crane.values[name]
        if value == nominal:
            continue
        known = crane.uncertainty[name]
        value = min(max(value, known.lower), known.upper)
        if nominal > 0.0 and not name.endswith((".x", ".y")):
            value = max(value, 0.05 * nominal) if name != "payload.mass" else max(value, 0.0)
        kept[name] = value
    pump, tank = (kept.get(name, crane.values[name]) for name in SUPPLY)
    # with a pump below its tank nothing would move, and no crane can be made
    if kept.keys() & set(SUPPLY) and tank > _TANK_SHARE * pump:
        kept[SUPPLY[1]] = _TANK_SHARE * pump
    return kept


def uncertain_parameters(crane: Crane, own: Sequence[str] = (), recordings: int = 1) -> list[NominalDirection]:
    """Return one variable a nominal parameter that is not exactly known, in the order of P; of `own`, one a
    recording.
    """
    found = []
    for name in (n for n in crane.values if n in crane.uncertainty):
        known, value = crane.uncertainty[name], crane.values[name]
        if math.isfinite(known.std):
            found.append(NominalDirection(name, {name: known.std}))
        else:
            scale = _RANGE_SHARE * (known.upper - known.lower)
            low, high = (known.lower - value) / scale, (known.upper - value) / scale
            found.append(NominalDirection(name, {name: scale}, math.inf, low, high))
    if recordings == 1:
        return found
    each = [
        replace(v, name=f"{v.name} {i + 1}", recording=i) for v in found if v.name in own for i in range(recordings)
    ]
    return [*(v for v in found if v.name not in own), *each]


def principal(directions: Sequence[NominalDirection], basis: np.ndarray) -> list[NominalDirection]:
    """Return combinations of nominal directions: column k of `basis` (orthonormal) becomes variable k."""
    combined = []
    for k in range(basis.shape[1]):
        weights: dict[str, float] = {}
        for direction, share in zip(directions, basis[:, k], strict=True):
            for name, weight in direction.weights.items():
                weights[name] = weights.get(name, 0.0) + share * weight
        combined.append(NominalDirection(f"direction {k + 1}", weights))
    return combined
