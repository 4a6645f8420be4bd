"""The hooks of all effects at all places, composed into one compiled function a hook.

Engines call these at fixed places of their equations (docs/architecture.md lists them). Every effect always takes part,
switched off by its neutral parameters, so that adding one to a crane compiles nothing. The text of each composed
function is written from the registry; `source()` shows it.
"""

from __future__ import annotations

import functools
import linecache
from collections.abc import Callable, Sequence
from typing import Any

from ..compiled import njit
from .base import CHAMBERS, SENSORS, Effect
from .curve import with_compiled_value
from .registry import known, starts

# hook: (arguments after E, what it starts from, how a term `call` enters, what is returned)
_FORM = {
    "command": ("c, u", "", "u = {call}", "u"),
    "delay": ("c", "T = 0.0", "T += {call}", "T"),
    "backlash": ("c", "b = 0.0", "b += {call}", "b"),
    "creep": (
        "c",
        "k, tau = 0.0, 0.0",
        "x, y = {call}; k, tau = (k + x, (k * tau + x * y) / (k + x) if k > 0.0 else y) if x > 0.0 else (k, tau)",
        "k, tau",
    ),
    "opening": ("c, U", "", "U = {call}", "U"),
    "supply_drop": ("c, dp", "", "dp = {call}", "dp"),
    "supply_gain": ("c, dp", "g = 1.0", "g *= {call}", "g"),
    "return_gain": ("c, p_own, p_other, load_side, drop", "g = 1.0", "g *= {call}", "g"),
    "supply_pressure": ("pp, q", "", "pp = {call}", "pp"),
    "tank_pressure": ("pt, q", "", "pt = {call}", "pt"),
    "free_gas": (
        "p",
        "share, compliance = 0.0, 0.0",
        "x, y = {call}; share += x; compliance += y",
        "share, compliance",
    ),
    "cylinder_force": ("c, v, pa, pb, la, lb", "F = 0.0", "F += {call}", "F"),
    "series_compliance": ("c", "k = 0.0", "k += {call}", "k"),
    "joint_torque": ("c, omega, angle", "T = 0.0", "T += {call}", "T"),
    "payload_mass": ("t, m", "", "m = {call}", "m"),
    "tip_force": ("t", "F = 0.0", "F += {call}", "F"),
    "gravity": ("gx, gy", "", "gx, gy = {call}", "gx, gy"),
    "pendulum": ("", "L, d = 0.0, 0.0", "x, y = {call}; L += x; d += y", "L, d"),
    "measurement": ("c, y", "", "y = {call}", "y"),
    "lag": ("c", "tau = 0.0", "tau += {call}", "tau"),
    "leakage": ("c, pa, pb", "qa, qb = 0.0, 0.0", "x, y = {call}; qa += x; qb += y", "qa, qb"),
}


@functools.cache
def _compiled_value(value: Any) -> Any:
    return njit(value, cache=False)


def _call(effect: type[Effect], place: str, hook: str, arguments: Sequence[str]) -> str:
    """Return the text of a call of an effect's hook at the place whose number the text `place` gives."""
    start, count = starts()[effect.name], len(effect.parameters)
    at = f" + {count} * ({place})" if place else ""
    if effect.curve is not None:
        return f"{effect.name}_{hook}({', '.join(['E', f'{start}{at}', *arguments])})"
    parameters = [f"E[{start + i}{at}]" for i in range(count)]
    return f"{effect.name}_{hook}({', '.join([*parameters, *arguments])})"


def _term_lines(effect: type[Effect], hook: str) -> list[str]:
    if effect.places == CHAMBERS:  # a leakage of each chamber of a cylinder
        return [f"    q{s} += {_call(effect, f'2 * c + {k}', hook, [f'p{s}'])}" for k, s in enumerate("ab")]
    _, _, enter, _ = _FORM[hook]
    known = "if c >= 0: " if effect.places == SENSORS else ""  # not every sensor has a place
    return [f"    {known}{enter.format(call=_call(effect, 'c' if effect.places else '', hook, effect.given(hook)))}"]


def source(hook: str) -> str:
    """Return the text of one composed hook as it is compiled."""
    arguments, start, _, result = _FORM[hook]
    lines = [f"def {hook}({', '.join(filter(None, ['E', arguments]))}):"]
    if start:
        lines.append(f"    {start}")
    for effect in known():
        if hook in effect.hooks():
            lines += _term_lines(effect, hook)
    return "\n".join([*lines, f"    return {result}", ""])


def _compiled(function: Any) -> Any:
    """Return a hook compiled; the value of a curve, where it asks for one, is compiled too."""
    return njit(with_compiled_value(function, _compiled_value), cache=False)


def _composed(hook: str, prepare: Callable[[Any], Any]) -> Any:
    """Return a hook of all effects; `prepare` makes of an effect's hook what the composed one calls."""
    names: dict[str, Any] = {f"{e.name}_{hook}": prepare(e.hooks()[hook]) for e in known() if hook in e.hooks()}
    text, file = source(hook), f"<composed hook {hook}>"
    linecache.cache[file] = (len(text), None, text.splitlines(True), file)  # so that tracebacks show it
    exec(compile(text, file, "exec"), names)
    return names[hook]


@functools.cache
def plain(hook: str) -> Any:
    """Return a hook as Python runs it, for what asks for it a few times: nothing is compiled."""
    return _composed(hook, lambda function: function)


def swings(E: Any) -> bool:
    """Whether the payload hangs from a pendulum, which adds two states."""
    return bool(plain("pendulum")(E)[0] > 0.0)


def _compose(hook: str) -> Any:
    return njit(_composed(hook, _compiled), cache=False)


command = _compose("command")
delay = _compose("delay")
backlash = _compose("backlash")
creep = _compose("creep")
opening = _compose("opening")
supply_drop = _compose("supply_drop")
supply_gain = _compose("supply_gain")
return_gain = _compose("return_gain")
leakage = _compose("leakage")
supply_pressure = _compose("supply_pressure")
tank_pressure = _compose("tank_pressure")
free_gas = _compose("free_gas")
cylinder_force = _compose("cylinder_force")
series_compliance = _compose("series_compliance")
joint_torque = _compose("joint_torque")
payload_mass = _compose("payload_mass")
tip_force = _compose("tip_force")
gravity = _compose("gravity")
pendulum = _compose("pendulum")
measurement = _compose("measurement")
lag = _compose("lag")
