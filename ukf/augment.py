"""Unknown quantities that the filter estimates along with the state, each as a slow random walk or as noise with a
memory: "Unknown quantities as states" in docs/estimator.md says which there are.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crane_exudyn import channels, parameters
from crane_exudyn.crane import Crane
from crane_exudyn.crane_toml import unit_at
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.layout import Layout

from .samples import number, positive

#: standard deviations of disturbances that are worth a search, by unit
_DISTURBED: Mapping[str, float] = {"N*m": 300.0, "N": 200.0, "m^3/s": 1e-5}


@dataclass(frozen=True)
class Augment:
    """One quantity to be estimated.

    Attributes:
        name: a parameter of the crane or of an effect, "bias.p4", "torque.O", "force.x" or "flow.p1".
        std: standard deviation at the start, SI; None takes the crane file's uncertainty of it.
        drift: growth of the standard deviation of its random walk, SI per √s; 0 for a constant.
        memory: time constant, s, with which it returns to its nominal value while noise keeps it at `std` around that
            (first-order Gauss-Markov); infinite for a constant.
        shared: quantities with the same word here have one size where sizes are adapted; "" for one of its own.
        begins: mean at the start, SI; None for the nominal value.

    Raises:
        CraneError: a standard deviation or a memory that is not positive, or a drift below zero.
    """

    name: str
    std: float | None = None
    drift: float = 0.0
    memory: float = np.inf
    shared: str = ""
    begins: float | None = None

    def __post_init__(self) -> None:
        what = f"augmented state {self.name!r}: its"
        if self.std is not None:
            positive(self.std, f"{what} std", "a positive standard deviation at the start, SI")
        positive(self.memory, f"{what} memory", "a positive time in seconds, or numpy.inf for a constant", endless=True)
        if not 0.0 <= number(self.drift, f"{what} drift") < np.inf:
            raise CraneError(f"{what} drift is {self.drift}. Give a positive number in SI per √s, or 0 for a constant.")


@dataclass(frozen=True)
class Extra:
    """An `Augment` with its numbers filled in: nominal `value`, mean `begins` and `std` at the start, SI, and what kind
    of quantity it is.
    """

    name: str
    kind: str  # "parameter" (the engine's business) or "bias" (the sensors')
    value: float
    std: float
    drift: float
    lower: float
    memory: float = np.inf
    shared: str = ""
    begins: float = 0.0

    def kept(self, dt: float) -> float:
        """Return the share of its deviation from `value` that is left after `dt` s."""
        return math.exp(-dt / self.memory)

    def renewed(self, dt: float) -> float:
        """Return the share of its variance that noise renews in `dt` s."""
        return -math.expm1(-2.0 * dt / self.memory)

    def variance(self, dt: float) -> float:
        """Return the variance that `dt` s add."""
        return self.drift**2 * dt + self.std**2 * self.renewed(dt)


class Sizes:
    """Sizes of the extra states that fade, which follow what the filter finds, for live use.

    Of a state d about its nominal value the filter knows mean m and variance P, so that E d² = m² + P. Its size s obeys
    ds²/dt = (E d² - s²)/T, expectation maximisation with a memory T: a size grows while the state is found further out
    than it says, falls while it is found to be nearer, and stays while no sensor tells.
    """

    def __init__(self, extras: Sequence[Extra], first: int, memory: float) -> None:
        """`first` is the place of the first extra state; `memory` is T, s, infinite for sizes that stay."""
        fading = [(first + k, e) for k, e in enumerate(extras) if e.memory < np.inf]
        self.rows = np.array([row for row, _ in fading], int)
        self._extras, self._memory = [e for _, e in fading], memory
        self._nominal = np.array([e.value for e in self._extras])
        words = [e.shared or e.name for e in self._extras]
        self._groups = [[k for k, word in enumerate(words) if word == name] for name in dict.fromkeys(words)]
        self.variance = np.array([e.std**2 for e in self._extras])

    @property
    def adapted(self) -> bool:
        """Whether there are sizes that change."""
        return self._memory < np.inf and self.rows.size > 0

    def follow(self, mean: np.ndarray, variance: np.ndarray, dt: float) -> None:
        """Let the sizes follow what is known, by mean (n,) and variance (n,), after `dt` s."""
        found = (mean[self.rows] - self._nominal) ** 2 + variance[self.rows]
        self.variance = self.variance - math.expm1(-dt / self._memory) * (found - self.variance)
        for group in self._groups:
            self.variance[group] = self.variance[group].mean()

    def added(self, dt: float) -> np.ndarray:
        """Return the variance that `dt` s add to each of the states."""
        return self.variance * [e.renewed(dt) for e in self._extras]


def resolve(crane: Crane, augment: Iterable[Augment | str]) -> tuple[Extra, ...]:
    """Return the extra states for a crane.

    Raises:
        CraneError: an unknown name, one that is given twice, or one whose uncertainty nobody states.
    """
    wanted = [Augment(a) if isinstance(a, str) else a for a in augment]
    if wrong := [a for a in wanted if not isinstance(a, Augment)]:
        raise CraneError(
            f"augmented state {wrong[0]!r} is neither a name nor an Augment. Give a name, or Augment(name, std)."
        )
    names = [a.name for a in wanted]
    for name in names:
        if names.count(name) > 1:
            raise CraneError(f"augmented states: {name!r} is given twice. Give it once.")
    return tuple(_resolve_one(crane, a) for a in wanted)


def _resolve_one(crane: Crane, wanted: Augment) -> Extra:
    kind, value, std, lower = _nominal(crane, wanted.name)
    std = wanted.std if wanted.std is not None else std
    if not (std > 0 and np.isfinite(std)):
        raise CraneError(
            f"augmented state {wanted.name!r}: a standard deviation of {std:g} at the start cannot be used. "
            f'Give a positive one: Augment("{wanted.name}", std=…).'
        )
    begins = value if wanted.begins is None else wanted.begins
    return Extra(wanted.name, kind, value, std, wanted.drift, lower, wanted.memory, wanted.shared, begins)


def _nominal(crane: Crane, name: str) -> tuple[str, float, float, float]:
    """Return kind, value, standard deviation and lower limit of a quantity as the crane file knows it."""
    head, _, tail = name.partition(".")
    lay = crane.layout
    if head == "bias" and tail in lay.sensors:
        return "bias", 0.0, lay.sensors[tail].sizes.bias, -np.inf
    if name in lay.disturbances:
        return "parameter", 0.0, _DISTURBED[lay.unit_of(name)], -np.inf
    if name in crane.machine.index:
        known = crane.uncertainty.get(name)
        std = known.std if known is not None else np.nan
        if not np.isfinite(std):
            std = 100.0 if name == "payload.mass" else 0.1 * abs(crane[name])
        return "parameter", crane[name], std, _least(name, crane[name])
    if "@" in name or "." in name:
        return _effect_parameter(crane, name)
    raise _unknown(crane, name)


def _unknown(crane: Crane, name: str) -> CraneError:
    lay = crane.layout
    known = [*crane.machine.names, *lay.disturbances, *(f"bias.{s}" for s in lay.sensors)]
    return CraneError(f"augmented state {name!r} is not known.{nearest(name, known)}")


def _least(name: str, value: float) -> float:
    """Return the lower limit of a nominal parameter: coordinates have none, a payload may be zero, other things may
    not.
    """
    if name.rpartition(".")[2] in ("x", "y"):
        return -np.inf
    return 0.0 if name == "payload.mass" else 0.05 * value


def _effect_parameter(crane: Crane, name: str) -> tuple[str, float, float, float]:
    key, _, last = name.rpartition(".")
    try:
        effect, _place = registry.split_key(key, crane.layout)
    except CraneError:
        raise _unknown(crane, name) from None
    for p in effect.parameters:
        if p.name == last:
            acting = crane.effect(key)
            value = p.neutral if acting is None else acting.parameters[last]
            return "parameter", value, abs(p.typical), p.lower
    raise CraneError(
        f"augmented state {name!r}: no such parameter.{nearest(last, [p.name for p in effect.parameters])}"
    )


def unit_of(name: str, layout: Layout) -> str:
    """Return the SI unit, as pint writes it, of an estimated quantity or a sensor."""
    head, _, tail = name.partition(".")
    if head in ("bias", "reading"):
        return unit_of(tail, layout)
    if name in (*layout.all_states, *layout.disturbances):
        return layout.unit_of(name)
    if name in channels.of(layout):
        return channels.of(layout)[name]
    key, _, last = name.rpartition(".")
    if key.partition("@")[0] in [e.name for e in registry.known()]:
        effect, place = registry.split_key(key, layout)
        return next((unit_at(p.unit, place, layout) for p in effect.parameters if p.name == last), "")
    return parameters.unit_of(name)
