"""What an effect is: a law with named parameters, a neutral value, places and hooks."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import ClassVar

from ..layout import Layout
from .curve import Curve
from .parameter import Parameter

#: kinds of places; an effect without a place acts on the whole machine
CYLINDERS, CHAMBERS, JOINTS, SENSORS, EVERYWHERE = "cylinders", "chambers", "joints", "sensors", ""


@dataclass(frozen=True)
class Hook:
    """What a hook is given after the effect's own parameters, and what it returns (docs/architecture.md says what they
    mean).

    `neutral` are the first results of an effect that is switched off; without, it returns what it is given.

    A function that takes one argument more is given `more` behind that.
    """

    given: str
    returns: str
    neutral: tuple[float, ...] = ()
    more: str = ""

    @property
    def arguments(self) -> tuple[str, ...]:
        """Names of what it is given."""
        return tuple(filter(None, self.given.split(", ")))

    def off(self, given: tuple[float, ...]) -> tuple[float, ...]:
        """Return what an effect that is switched off must return, of the first results."""
        return self.neutral or tuple(given[self.arguments.index(r)] for r in self.results)

    @property
    def results(self) -> tuple[str, ...]:
        """Names of what it returns."""
        return tuple(self.returns.split(", "))


_NOTHING = (0.0,)
HOOKS: Mapping[str, Hook] = {
    "command": Hook("u", "u"), "delay": Hook("", "T", _NOTHING), "backlash": Hook("", "b", _NOTHING),
    "creep": Hook("", "share, tau", _NOTHING), "opening": Hook("U", "U"), "supply_drop": Hook("dp", "dp"),
    "supply_gain": Hook("dp", "factor", (1.0,)),
    "return_gain": Hook("p_own, p_other, load_side", "factor", (1.0,), "drop"),
    "leakage": Hook("pa, pb", "qa, qb", (0.0, 0.0)),
    "supply_pressure": Hook("pp, q", "pp"), "tank_pressure": Hook("pt, q", "pt"),
    "free_gas": Hook("p", "share, compliance", (0.0, 0.0)), "cylinder_force": Hook("v, pa, pb, la, lb", "F", _NOTHING),
    "series_compliance": Hook("", "1/k", _NOTHING), "joint_torque": Hook("omega", "torque", _NOTHING, "angle"),
    "payload_mass": Hook("t, m", "m"), "tip_force": Hook("t", "fy", _NOTHING), "gravity": Hook("gx, gy", "gx, gy"),
    "pendulum": Hook("", "length, damping", _NOTHING), "measurement": Hook("y", "y"), "lag": Hook("", "tau", _NOTHING),
}  # fmt: skip
#: hooks that act on a command before the spool follows it, and on what a sensor shows: outside of the equations
COMMANDING, SENSING = frozenset({"command", "delay", "backlash", "creep"}), frozenset({"measurement", "lag"})
#: the form of `leakage` at a chamber
CHAMBER_LEAKAGE = Hook("p", "q", _NOTHING)
#: kinds of places at which a hook may act; one that is not here acts on the whole machine
ACTS_AT: Mapping[str, tuple[str, ...]] = {
    "leakage": (CYLINDERS, CHAMBERS),
    "joint_torque": (JOINTS,),
    "measurement": (SENSORS,),
    "lag": (SENSORS,),
    **dict.fromkeys(
        (
            "command",
            "delay",
            "backlash",
            "creep",
            "opening",
            "supply_drop",
            "supply_gain",
            "return_gain",
            "cylinder_force",
            "series_compliance",
        ),
        (CYLINDERS,),
    ),
}
#: hooks that act on a payload, or at its point
ON_PAYLOAD = frozenset({"payload_mass", "tip_force", "pendulum"})


class Effect:
    """A physical effect. Subclasses fill in the class variables and define their hooks as static functions.

    `places` is the kind of places at which it acts: CYLINDERS, CHAMBERS, JOINTS, SENSORS, or EVERYWHERE for the whole
    machine; or a tuple of names of such places, which become `only` when the effect is registered.
    """

    name: ClassVar[str] = ""
    places: ClassVar[str] = EVERYWHERE
    only: ClassVar[tuple[str, ...]] = ()
    parameters: ClassVar[tuple[Parameter, ...]] = ()
    #: whether it acts only where a cylinder is beyond an end of its stroke, and a run without it ends there
    beyond_stroke: ClassVar[bool] = False
    #: parameter values at which a search starts; one line a start
    probes: ClassVar[tuple[Mapping[str, float], ...]] = ()
    #: of a law that is a curve through knots: its parameters are those of the curve, and its hooks are given (E, at,
    #: …), for `curve.value`
    curve: ClassVar[Curve | None] = None

    @classmethod
    def hooks(cls) -> dict[str, Callable[..., object]]:
        """Return the hooks that this effect defines, by name."""
        return {hook: getattr(cls, hook) for hook in HOOKS if hook in cls.__dict__}

    @classmethod
    def given(cls, hook: str) -> tuple[str, ...]:
        """Return the names of what a hook of this effect is given after the effect's own parameters."""
        form = cls.form(hook)
        own = len(cls.parameters) if cls.curve is None else len(("E", "at"))
        asks = len(inspect.signature(getattr(cls, hook)).parameters) > own + len(form.arguments)
        return (*form.arguments, form.more) if asks and form.more else form.arguments

    @classmethod
    def form(cls, hook: str) -> Hook:
        """Return the form that a hook must have at the places of this effect."""
        return CHAMBER_LEAKAGE if hook == "leakage" and cls.places == CHAMBERS else HOOKS[hook]

    @classmethod
    def law(cls) -> str:
        """Return the law in words and symbols: the first paragraph of the docstring."""
        return _paragraphs(cls)[0]

    @classmethod
    def signature(cls) -> str:
        """Return what a recording shows of the effect: the paragraph of the docstring that begins with "Signature:"; ""
        without.
        """
        return next((p.removeprefix("Signature: ") for p in _paragraphs(cls) if p.startswith("Signature: ")), "")

    @classmethod
    def keys(cls, layout: Layout) -> list[str]:
        """Return "name@place" for every place of a machine, or "name" for an effect of the whole machine."""
        return [f"{cls.name}@{place}" if place else cls.name for place in cls.on(layout)]

    @classmethod
    def on(cls, layout: Layout) -> tuple[str, ...]:
        """Return the places of a machine at which it may act: none without the payload that it acts on."""
        if not layout.has_payload and ON_PAYLOAD & cls.hooks().keys():
            return ()
        return tuple(place for place in layout.places(cls.places) if not cls.only or place in cls.only)


def _paragraphs(effect: type[Effect]) -> list[str]:
    text = inspect.cleandoc(effect.__doc__ or effect.name)
    return [" ".join(p.split()) for p in text.split("\n\n")]


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
