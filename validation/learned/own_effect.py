"""A learned law written as a user's own effect: a Python file, ready to edit."""

from __future__ import annotations

import inspect
import textwrap
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry

if TYPE_CHECKING:
    from .learned_law import LearnedLaw

_RUBS = "-share * max(y, 0.0) * math.tanh({} / 2e-3)"
_FORCE, _FACTOR = "v, pa, pb, la, lb", "1.0 + share * (max(y, 0.0) - 1.0)"
#: by effect and argument: hooks, each with what it is given, where the curve is looked up, and what it returns of its
#: value y
_HOOKS: Mapping[tuple[str, str], tuple[tuple[str, str, str, str], ...]] = {
    ("learned_opening", "spool"): (("opening", "U", "U", "U + share * (y - U)"),),
    ("learned_opening", "pressure_drop"): (
        ("supply_gain", "dp", "dp", _FACTOR),
        ("return_gain", "p_own, p_other, load_side, drop", "drop", _FACTOR),
    ),
    ("learned_force", "speed"): (("cylinder_force", _FORCE, "abs(v)", _RUBS.format("v")),),
    ("learned_force", "stroke"): (("cylinder_force", _FORCE, "la", _RUBS.format("v")),),
    ("learned_force", "pressure_drop"): (("cylinder_force", _FORCE, "abs(pa - pb)", _RUBS.format("v")),),
    ("learned_leakage", "pressure_drop"): (
        ("leakage", "pa, pb", "abs(pa - pb)",
         "-share * math.copysign(y, pa - pb), share * math.copysign(y, pa - pb)"),
    ),
    ("learned_flow", "pressure"): (("leakage", "p", "p", "-share * y"),),
    ("learned_torque", "angle"): (("joint_torque", "omega, angle", "angle", _RUBS.format("omega")),),
    ("learned_torque", "rate"): (("joint_torque", "omega", "abs(omega)", _RUBS.format("omega")),),
    ("learned_supply", "flow"): (("supply_pressure", "pp, q", "q", "pp - share * y if q > 0.0 else pp"),),
    ("learned_return", "flow"): (("tank_pressure", "pt, q", "q", "pt + share * y if q > 0.0 else pt"),),
}  # fmt: skip
#: what a law that is no friction returns where one could be
_SPRING = "share * y"

_TEXT = '''"""{title}."""

import math

from numba.extending import register_jitable

from crane_exudyn.effects.base import Effect, Parameter

#: {over} in {unit_over}, and the curve there in {unit}; learned from {recording}
X = ({x})
Y = ({y})


@register_jitable
def curve(x):
    """Return the curve at x: a cubic a stretch, straight on beyond the ends."""
    n, k = len(X), 0
    while k < n - 2 and x > X[k + 1]:
        k += 1
    h = X[k + 1] - X[k]
    d = (Y[k + 1] - Y[k]) / h
    left = right = d
    if k > 0:
        before = X[k] - X[k - 1]
        left = (h * (Y[k] - Y[k - 1]) / before + before * d) / (h + before)
    if k < n - 2:
        after = X[k + 2] - X[k + 1]
        right = (h * (Y[k + 2] - Y[k + 1]) / after + after * d) / (h + after)
    if x < X[0]:
        return Y[0] + left * (x - X[0])
    if x > X[n - 1]:
        return Y[n - 1] + right * (x - X[n - 1])
    t = (x - X[k]) / h
    return Y[k] + h * t * (left + t * (3.0 * d - 2.0 * left - right + t * (left + right - 2.0 * d)))


class {cls}(Effect):
    """{title}, a curve over the {over}.

    Signature: {signature}
    """

    name = "{name}"
    places = ("{place}",)
    parameters = (Parameter("share", "", 0.0, 0.0, 10.0, 1.0, "1: the curve as it was learned"),)
{hooks}'''

_HOOK = """
    @staticmethod
    def {hook}(share, {given}):
        y = curve({at})
        return {result}
"""


def own_effect(law: LearnedLaw, crane: Crane, recording: str, name: str) -> str:
    """Return the text of a Python file that defines a law as an effect of that name, of which `share` = 1 is the curve
    as learned.
    """
    effect, place = registry.split_key(law.effect)
    origin = law.law.over.origin
    begin = f" + {crane[f'cylinders.{place}.{origin}']:.6g}" if origin else ""
    spring = True in law.law.over.against and not law.against_motion
    hooks = "".join(
        _HOOK.format(hook=hook, given=given, at=at + begin, result=_SPRING if spring else result)
        for hook, given, at, result in _HOOKS[effect.name, law.over]
    )
    (x, y), signature = law.knots, inspect.cleandoc(effect.__doc__ or "").partition("Signature: ")[2]
    return _TEXT.format(
        title=f"A {effect.name.replace('_', ' ')} at {place or 'the whole machine'}: "
              f"{law.resembles or 'a curve'}", over=law.over.replace("_", " "),
        unit_over=law.unit_over or "1", unit=law.unit or "1", recording=recording, x=_numbers(x), y=_numbers(y),
        cls=name.title().replace("_", ""),
        signature=textwrap.fill(signature, 110, subsequent_indent="    "), name=name, place=place, hooks=hooks,
    )  # fmt: skip


def _numbers(values: np.ndarray) -> str:
    return ", ".join(repr(float(f"{v:.6g}")) for v in values)  # whole numbers too: compiled tuples hold one type
