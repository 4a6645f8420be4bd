"""What may move in a fit: nominal parameters within their uncertainty, and parameters of effects.

Every variable is a number u of order one: 0 is the starting value, the step of 1 is one standard uncertainty (nominal
parameters) or one typical size (effects). A vector of such numbers turns the crane as given into another crane.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.crane_toml import unit_at
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import Parameter
from crane_exudyn.layout import Layout

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

    def moved(self, values: dict[str, float], u: float) -> None:
        """Add the move to `values` (SI by name), in place."""
        for name, weight in self.weights.items():
            values[name] += weight * u


@dataclass(frozen=True)
class EffectParameter:
    """One parameter of an effect at a place. Where the neutral value is infinite, u is typical / value."""

    key: str
    parameter: Parameter
    start: float
    difference: float = 1e-4

    @property
    def name(self) -> str:
        """ "name@place:parameter"."""
        return f"{self.key}:{self.parameter.name}"

    @property
    def prior(self) -> float:
        """No Gaussian prior; the range is in the bounds."""
        return math.inf

    @property
    def inverse(self) -> bool:
        """Whether u runs with the inverse of the value (neutral at infinity)."""
        return math.isinf(self.parameter.neutral)

    @property
    def scale(self) -> float:
        """Size of the value at which u has moved by one."""
        return abs(self.parameter.typical - self._origin)

    @property
    def _origin(self) -> float:
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
        return 0.0


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


Variable = NominalDirection | EffectParameter | Timing


def lateness(variables: Sequence[Variable], u: np.ndarray) -> float:
    """Return by how many seconds the variables shift the commands."""
    return sum(v.scale * float(x) for v, x in zip(variables, u, strict=True) if isinstance(v, Timing))


def at_place(parameter: Parameter, place: str, layout: Layout) -> Parameter:
    """Return a parameter of an effect at a place: what has the unit of the sensor there gets it, and that sensor's
    telling size.
    """
    if parameter.unit != "channel":
        return parameter
    telling = layout.sensors[place].sizes.telling
    return replace(parameter, unit=unit_at(parameter.unit, place, layout), typical=parameter.neutral + telling)


def effect_variables(key: str, start: Mapping[str, float], layout: Layout) -> list[EffectParameter]:
    """Return the variables of the effect "name@place" of a machine with starting values (SI); others start neutral."""
    effect, place = registry.split_key(key, layout)
    parameters = [at_place(p, place, layout) for p in effect.parameters]
    return [
        EffectParameter(key, p, float(start.get(p.name, p.neutral)), _MOMENT / abs(p.typical) if is_moment(p) else 1e-4)
        for p in parameters
    ]


def is_moment(parameter: Parameter) -> bool:
    """Whether a parameter is the time of an event, counted from the start of the recording."""
    return parameter.shape and parameter.unit == "s"


def with_variables(crane: Crane, variables: Sequence[Variable], u: np.ndarray) -> Crane:
    """Return the crane that the values u (one each variable) describe."""
    values = dict(crane.values)
    effects: dict[str, dict[str, float]] = {}
    for variable, number in zip(variables, u, strict=True):
        if isinstance(variable, NominalDirection):
            variable.moved(values, float(number))
        elif isinstance(variable, EffectParameter):
            effects.setdefault(variable.key, {})[variable.parameter.name] = variable.to_value(float(number))
    changed = crane.with_parameters(physical(crane, values))
    for key, parameters in effects.items():
        acting = changed.effect(key)
        changed = changed.with_effect(key, {**(acting.parameters if acting else {}), **parameters})
    return changed


def physical(crane: Crane, values: Mapping[str, float]) -> dict[str, float]:
    """Return the values that differ from the crane's, kept within hard limits and four standard uncertainties."""
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


def uncertain_parameters(crane: Crane) -> list[NominalDirection]:
    """Return one variable a nominal parameter that is not exactly known, in the order of P."""
    found = []
    for name in (n for n in crane.values if n in crane.uncertainty):
        known, value = crane.uncertainty[name], crane.values[name]
        if math.isfinite(known.std):
            found.append(NominalDirection(name, {name: known.std}))
        else:
            scale = _RANGE_SHARE * (known.upper - known.lower)
            low, high = (known.lower - value) / scale, (known.upper - value) / scale
            found.append(NominalDirection(name, {name: scale}, math.inf, low, high))
    return found


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
