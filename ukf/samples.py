"""One live sample as the estimator needs it: commands, readings and time as numbers, or one message that says what was
wrong.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crane_exudyn.channels import BEYOND
from crane_exudyn.errors import CraneError, nearest, shortened


def command_of(commands: Sequence[float] | Mapping[str, float], names: Sequence[str]) -> np.ndarray:
    """Return the spool commands (valves,) of the channels `names`, NaN for a missing one.

    Raises:
        CraneError: not one number a valve, or other names.
    """
    if isinstance(commands, Mapping):
        if set(commands) != set(names):
            raise CraneError(
                f"commands: found {', '.join(map(str, commands)) or 'nothing'}. Give {' and '.join(names)} in [-1, 1]."
            )
        commands = [commands[name] for name in names]
    found = np.asarray(commands, object)
    if found.shape != (len(names),):
        raise CraneError(
            f"commands: found {shortened(commands, 80)}. Give {len(names)} numbers in [-1, 1], one for each valve: "
            f"({', '.join(names)})."
        )
    return np.array([number(value, f"commands: {name}") for name, value in zip(names, found, strict=True)])


def readings_of(measurements: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
    """Return the readings (k,) of the channels `names` in SI, NaN for missing.

    Raises:
        CraneError: an unknown name, or a reading that is not one number.
    """
    if not isinstance(measurements, Mapping):
        raise CraneError(
            f"measurements: found {shortened(measurements, 80)}. Give a mapping such as {{{names[0]!r}: 0.17}}, SI."
        )
    for name in measurements:
        if name not in names:
            raise CraneError(f"measurements: {name!r} is no sensor of this estimator.{nearest(str(name), list(names))}")
    return np.array([number(measurements.get(n), f"measurements: {n}") for n in names])


def impossible(unit: str, readings: np.ndarray) -> np.ndarray:
    """Return which readings (n,) in a SI unit no crane can show, infinite ones among them; NaN is missing and not among
    them.
    """
    return np.asarray(np.abs(readings) > BEYOND[unit])


def first_stamp(time: Any) -> float:
    """Return the time of the first sample, s. Raises CraneError if it is no finite number."""
    first = number(time, "time")
    if not np.isfinite(first):
        raise CraneError(f"time of the first sample is {first}. Give a finite number of seconds.")
    return first


def positive(given: Any, what: str, mend: str, *, endless: bool = False) -> float:
    """Return a positive number, which may be infinite only where it may be `endless`. Raises CraneError, which tells
    the mend, for anything else.
    """
    found = number(given, what)
    if not 0.0 < found < np.inf and not (endless and found == np.inf):
        raise CraneError(f"{what} is {given}. Give {mend}.")
    return found


def number(value: Any, what: str) -> float:
    """Return a number, NaN for None.

    Raises:
        CraneError: anything but one number; `what` names it.
    """
    if value is None:
        return float("nan")
    try:
        if np.ndim(value) == 0 and not isinstance(value, (str, bool, np.bool_)):
            return float(value)
    except (TypeError, ValueError):
        pass
    raise CraneError(f"{what} is {shortened(value, 80)}. Give one number in SI, or leave it out.")
