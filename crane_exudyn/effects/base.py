"""What an effect is: a law with named parameters, a neutral value, places and hooks."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

CYLINDERS = ("lift", "tilt")
CHAMBERS = ("p1", "p2", "p3", "p4")
JOINTS = ("O", "A")
SENSORS = ("z1", "z4", "p1", "p2", "p3", "p4")
#: an effect without a place acts on the whole machine
EVERYWHERE = ("",)

#: hook -> number of arguments after the effect's own parameters (docs/architecture.md tells what they mean)
HOOKS: Mapping[str, int] = {
    "command": 1, "delay": 0, "backlash": 0, "creep": 0, "opening": 1,
    "supply_drop": 1, "return_gain": 3, "leakage": -1, "supply_pressure": 2, "tank_pressure": 2, "free_gas": 1,
    "cylinder_force": 5, "series_compliance": 0, "joint_torque": 1,
    "payload_mass": 2, "tip_force": 1, "gravity": 2, "pendulum": 0,
    "measurement": 1, "lag": 0,
}  # fmt: skip


@dataclass(frozen=True)
class Parameter:
    """One parameter of an effect.

    Attributes:
        name: the key in crane files and JSON.
        unit: SI, as pint writes it; "" for a pure number; "channel" for the unit of the sensor it acts on.
        neutral: the value that switches the effect off (all parameters neutral: the model is exactly as it was).
        lower, upper: the range that is accepted and searched.
        typical: a value of the size that is met in practice; sets the scale of searches and pictures.
        text: what it is, in words.
        shape: True for a parameter that only shapes the law (a time, a Stribeck speed): it has a value, but no neutral one.
    """

    name: str
    unit: str
    neutral: float
    lower: float
    upper: float
    typical: float
    text: str
    shape: bool = False


class Effect:
    """A physical effect. Subclasses fill in the class variables and define their hooks as static functions."""

    name: ClassVar[str] = ""
    places: ClassVar[tuple[str, ...]] = EVERYWHERE
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    #: parameter values at which a search starts; one line a start
    probes: ClassVar[tuple[Mapping[str, float], ...]] = ()

    @classmethod
    def hooks(cls) -> dict[str, Callable[..., object]]:
        """Return the hooks that this effect defines, by name."""
        return {hook: getattr(cls, hook) for hook in HOOKS if hook in cls.__dict__}

    @classmethod
    def keys(cls) -> list[str]:
        """Return "name@place" for every place, or "name" for an effect of the whole machine."""
        return [f"{cls.name}@{place}" if place else cls.name for place in cls.places]


@dataclass(frozen=True)
class Acting:
    """One effect at one place of one crane, with the values of its parameters in SI."""

    name: str
    place: str = ""
    parameters: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> str:
        """ "name@place", as users write it."""
        return f"{self.name}@{self.place}" if self.place else self.name
