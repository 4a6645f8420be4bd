"""Whether an effect that somebody wrote can take part: refused with its file, its hook and the signature that was
expected.

Compiled code holds every effect, so one that does not fit would end every command in pages of the compiler's own words.
Each hook is compiled alone first and tried over what a crane may give it: at the neutral values it must change nothing,
to the last bit, and at typical values it must return numbers.
"""

from __future__ import annotations

import inspect
import itertools
import math
import re
import threading
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from ..errors import CraneError, nearest
from ..layout import MOST
from ..units import factor_to_si
from .base import (
    ACTS_AT,
    CHAMBERS,
    EVERYWHERE,
    HOOKS,
    Effect,
    Hook,
    Parameter,
)
from .curve import with_compiled_value

_PRESSURES = (0.0, 1e5, 60e5, 200e5)
#: what the hooks are tried with: values that a crane may give them, by the name of the argument
_TRIED: Mapping[str, tuple[float, ...]] = {
    "u": (-1.0, -0.2, 0.0, 0.2, 1.0), "U": (-1.0, -0.2, 0.0, 0.2, 1.0), "dp": (-200e5, -1e5, 0.0, 1e5, 200e5),
    "p": _PRESSURES, "pa": _PRESSURES, "pb": _PRESSURES, "p_own": _PRESSURES, "p_other": _PRESSURES,
    "load_side": (0.0, 1.0),
    "pp": (1e5, 100e5), "pt": (1e5, 20e5), "q": (-1e-3, 0.0, 1e-3),
    "v": (-0.5, -1e-3, 0.0, 1e-3, 0.5), "la": (0.01, 0.3, 1.0), "lb": (0.01, 0.3, 1.0),
    "omega": (-1.0, -1e-3, 0.0, 1e-3, 1.0),
    "drop": (-1e5, 0.0, 1e5, 100e5), "angle": (-1.0, 0.0, 1.0),
    "t": (0.0, 7.0, 600.0), "m": (0.0, 100.0), "gx": (-1.0, 0.0), "gy": (-9.81,), "y": (-1.0, 0.0, 0.5, 60e5),
}  # fmt: skip
#: s that all trials of a hook may take together; they take some ms
_LONGEST = 10.0


def checked(effect: type[Effect], where: str) -> type[Effect]:
    """Return the effect itself.

    Raises:
        CraneError: it could not take part; the message begins with `where`, its file or module.
    """
    where = f"{where}: effect {effect.name or effect.__name__!r}"
    _check_description(effect, where)
    for name, function in effect.hooks().items():
        _check_hook(effect, f"{where}, line {_line(function)}", name, function)
    return effect


def _check_description(effect: type[Effect], where: str) -> None:
    """Refuse names, places, parameters and probes that are none."""
    if not (isinstance(effect.name, str) and effect.name.isidentifier()):
        raise CraneError(f"{where}: needs a name in letters, digits and underscores, found {effect.name!r}.")
    if isinstance(effect.places, tuple) and effect.places and all(isinstance(p, str) for p in effect.places):
        effect.only, effect.places = tuple(filter(None, effect.places)), _kind_of(effect)
    if effect.places not in tuple(MOST):
        raise CraneError(
            f"{where}: places is {effect.places!r}. Give CYLINDERS, CHAMBERS, JOINTS, SENSORS or EVERYWHERE."
        )
    for function in (n for n, v in vars(effect).items() if isinstance(v, staticmethod) and not n.startswith("_")):
        if function not in HOOKS:
            raise CraneError(f"{where}: no hook {function!r}.{nearest(function, list(HOOKS))}")
    if not effect.hooks():
        raise CraneError(f"{where} has no hook. Known hooks: {', '.join(HOOKS)}.")
    if not (isinstance(effect.parameters, tuple) and effect.parameters):
        raise CraneError(
            f"{where} has no parameter, so it could be neither fitted nor switched off. Give a tuple of them."
        )
    for parameter in effect.parameters:
        _check_parameter(parameter, where)
    for probe in effect.probes:
        unknown = set(probe) - {p.name for p in effect.parameters}
        if unknown:
            raise CraneError(f"{where}: a probe gives {sorted(unknown)[0]!r}, which is not one of its parameters.")


def _kind_of(effect: type[Effect]) -> str:
    """Return the kind of the places that an effect names one by one: that of its hooks; a leakage of one pressure is a
    chamber's.
    """
    for hook, function in effect.hooks().items() if any(effect.places) else ():
        kinds = ACTS_AT.get(hook, ())
        if hook == "leakage" and len(inspect.signature(function).parameters) == len(effect.parameters) + 1:
            return CHAMBERS
        if kinds:
            return kinds[0]
    return EVERYWHERE


def _check_parameter(parameter: Any, where: str) -> None:
    if not isinstance(parameter, Parameter):
        raise CraneError(
            f"{where}: found {parameter!r} among its parameters. Expected a Parameter(name, unit, neutral, …)."
        )
    where = f"{where}: parameter {parameter.name!r}"
    if not (isinstance(parameter.name, str) and parameter.name.isidentifier()):
        raise CraneError(f"{where} needs a name in letters, digits and underscores.")
    for key in ("unit", "text"):
        if not isinstance(getattr(parameter, key), str):
            raise CraneError(f"{where}: {key} is {getattr(parameter, key)!r}, expected a text.")
    if parameter.unit not in ("", "channel"):  # that of the sensor that it acts on
        try:
            factor_to_si(parameter.unit, parameter.unit)
        except CraneError as problem:
            raise CraneError(f"{where}: {problem}.") from None
    for key in ("neutral", "lower", "upper", "typical"):
        value = getattr(parameter, key)
        if isinstance(value, bool) or not isinstance(value, int | float) or math.isnan(value):
            raise CraneError(f"{where}: {key} is {value!r}, expected a number.")
    for key in ("neutral", "typical"):
        if not parameter.lower <= getattr(parameter, key) <= parameter.upper:
            raise CraneError(
                f"{where}: {key} is {getattr(parameter, key):g}, expected a value from lower = {parameter.lower:g} to "
                "upper = "
                f"{parameter.upper:g}. The order is name, unit, neutral, lower, upper, typical, text."
            )


def _check_hook(effect: type[Effect], where: str, name: str, function: Callable[..., Any]) -> None:
    """Refuse a hook of another signature, one that does not compile, is not neutral when it should be, or returns no
    numbers.
    """
    kinds = ACTS_AT.get(name, (EVERYWHERE,))
    if effect.places not in (*kinds, EVERYWHERE):
        known = " or ".join(kind or "the whole machine" for kind in kinds)
        raise CraneError(f"{where}: hook {name} cannot act at {effect.places}. Its places: {known}.")
    own = [p.name for p in effect.parameters] if effect.curve is None else ["E", "at"]
    hook, told = effect.form(name), effect.given(name)
    expected = f"{name}({', '.join([*own, *told])}) -> {hook.returns}"
    _check_signature(function, where, name, expected, len(own) + len(told))
    neutral = _given(effect, [p.typical if p.shape else p.neutral for p in effect.parameters])
    tried = [
        (values, given)
        for values in (neutral, *(_given(effect, v) for v in _values(effect)))
        for given in itertools.product(*(_TRIED[a] for a in told))
    ]
    results = _results(function, where, name, expected, hook, [(*v, *g) for v, g in tried])
    for (values, given), result in zip(tried, results, strict=True):
        wanted = hook.off(given)
        if not all(map(math.isfinite, result)):
            at = _at(function, (*values, *given))
            raise CraneError(f"{where}: hook {name} returns {_shown(result)} at {at}. Expected finite numbers there.")
        if values is neutral and result[: len(wanted)] != wanted:
            at = _at(function, (*values, *given))
            raise CraneError(
                f"{where}: hook {name} returns {_shown(result)} at {at}, expected {_shown(wanted)}: at the neutral "
                "values "
                "an effect must change nothing. Correct the law, or the parameters' neutral values."
            )


def _at(function: Callable[..., Any], values: tuple[Any, ...]) -> str:
    """Return "name = value, …" of what a hook was given, without the table of a curve."""
    given = zip(inspect.signature(function).parameters, values, strict=True)
    return ", ".join(f"{n} = {v:g}" for n, v in given if isinstance(v, float))


def _check_signature(function: Callable[..., Any], where: str, name: str, expected: str, count: int) -> None:
    """Refuse a hook that does not take the effect's own parameters and then what it is given, by position."""
    parameters = inspect.signature(function).parameters.values()
    plain = all(p.kind == p.POSITIONAL_OR_KEYWORD and p.default is p.empty for p in parameters)
    if not plain or len(parameters) != count:
        found = f"{name}({', '.join(map(str, parameters))})"
        raise CraneError(f"{where}: hook {found} has the wrong arguments. Expected {expected}.")


def _results(
    function: Callable[..., Any],
    where: str,
    name: str,
    expected: str,
    hook: Hook,
    tried: list[tuple[Any, ...]],
) -> list[tuple[Any, ...]]:
    """Return what the compiled hook gives for each set of numbers that it is tried with, as many numbers as it must.

    It is tried in a thread that can be left behind: compiled code that never ends hears no signal. A thread that was
    left ends with the call that it is in.
    """
    import numba

    found: list[Any] = []
    failed: list[Exception] = []
    left = threading.Event()

    def run() -> None:
        try:
            for given in tried:
                if left.is_set():
                    return
                found.append(compiled(*given))
        except Exception as problem:  # whatever the law says, it is the law that must be mended
            failed.append(problem)

    try:
        compile_ = numba.njit(error_model="numpy", nogil=True)
        compiled = compile_(with_compiled_value(function, compile_))
        compiled.compile(tuple(map(numba.typeof, tried[0])))
    except Exception as problem:  # whatever the compiler says, it is the law that must be mended
        raise CraneError(f"{where}: hook {name} cannot be compiled: {_reason(problem)}. Expected {expected}.") from None
    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    thread.join(_LONGEST)
    if thread.is_alive():
        left.set()
        at = _at(function, tried[len(found)])
        raise CraneError(f"{where}: hook {name} has not returned after {_LONGEST:g} s, at {at}. Correct its loop.")
    if failed:
        at = _at(function, tried[len(found)])
        raise CraneError(f"{where}: hook {name} fails at {at}: {_reason(failed[0])}. Expected {expected}.")
    count = len(hook.results)
    for result in found:
        if not (isinstance(result, tuple) == (count > 1) and len(_numbers(result)) == count):
            raise CraneError(f"{where}: hook {name} returns {result!r}. Expected {expected}.")
        if not all(isinstance(v, int | float) for v in _numbers(result)):
            raise CraneError(f"{where}: hook {name} returns {result!r}, which is not a number. Expected {expected}.")
    return [_numbers(result) for result in found]


def _given(effect: type[Effect], values: list[float]) -> tuple[Any, ...]:
    """Return what a hook is given for values of the effect's parameters: these, or of a curve the table that they are
    and where it begins.
    """
    return tuple(map(float, values)) if effect.curve is None else (np.array(values, dtype=float), 0)


def _values(effect: type[Effect]) -> Iterator[list[float]]:
    """Yield the parameter values that a hook is tried with: typical, and those at which searches start."""
    typical = {p.name: p.typical for p in effect.parameters}
    for probe in ({}, *effect.probes):
        yield list((typical | dict(probe)).values())


def _numbers(result: Any) -> tuple[Any, ...]:
    return result if isinstance(result, tuple) else (result,)


def _shown(values: tuple[float, ...]) -> str:
    return ", ".join(f"{v:g}" for v in values)


def _line(function: Callable[..., Any]) -> int:
    return function.__code__.co_firstlineno


def _reason(problem: Exception) -> str:
    """Return in one line what the compiler said of the law, without its own machinery."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(problem))
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not line.startswith(("Failed in", "- Resolution", "During:"))]
    return lines[0].rstrip(".:") if lines else type(problem).__name__
