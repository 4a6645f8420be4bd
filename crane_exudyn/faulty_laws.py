"""Why a run has failed, where the crane itself says so: an effect's law that gives no number, or a number that no
machine has.

A law is tried when its file is loaded, but not at every state that a crane may come to. Steps do not look for NaN in
each of its results; only when a run has failed are the effects tried one by one at the state of the failure.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from .crane import Crane
from .effects import registry
from .errors import CraneError, listed
from .geometry import pose_text
from .plausible import implausible
from .statics import size_of_state, terms

#: parts of the failing step at which to look: an engine has halved it so often, or its iterates went beyond its end
_FRACTIONS = (0.0, *(2.0**k for k in range(-14, 3)))


def where_run_failed(crane: Crane, state: np.ndarray, w: np.ndarray, time: float, h: float) -> CraneError | None:
    """Return the error that names the effects of which a law gives no number, or the numbers of the crane that are
    implausible; None where there is neither.

    Args:
        state: (nx,) the last good state;  w: [U1 U2 pp pt, …] there;  time in s;  h: the step that failed, in s.
    """
    law = _law(crane, state, w, time, h)
    if law is None and (remarks := implausible(crane)):
        return CraneError(f"{crane.name}: the run cannot go on at t = {time:.6g} s. {' '.join(remarks)}")
    return law


def _law(crane: Crane, state: np.ndarray, w: np.ndarray, time: float, h: float) -> CraneError | None:
    if not crane.effects:
        return None
    for x, t in _onwards(crane, np.asarray(state, dtype=float), w, time, h):
        if not _terms_are_finite(crane.nominal(), x, w, t):
            return None  # the crane itself cannot come there
        found = without_numbers(crane, lambda tried, x=x, t=t: _terms_are_finite(tried, x, w, t))  # type: ignore[misc]
        if found:
            lay = crane.layout
            pressures = listed(lay.chambers, x[lay.pressures] / 1e5, "{:.4g} bar")
            return refusal(crane, found, f"t = {t:.6g} s, {pose_text(lay, x)}, {pressures}")
    return None


def where_start_failed(crane: Crane, state: np.ndarray) -> CraneError | None:
    """Return the same for a static start (nx,) that is not finite; valves are closed there."""
    known = np.where(np.isfinite(state), state, 0.0)
    return where_run_failed(crane, known, np.array(crane.layout.closed), 0.0, 0.0)


def without_numbers(crane: Crane, finite: Callable[[Crane], bool]) -> list[str]:
    """Return the effects "name@place" without which `finite` would hold, or with which alone it does not; none where it
    holds.
    """
    if finite(crane):
        return []
    alone = [e.key for e in crane.effects if not finite(replace(crane, effects=(e,)))]
    return alone or [e.key for e in crane.effects if finite(crane.without_effect(e.key))]


def check_law(crane: Crane, finite: Callable[[Crane], bool], where: str) -> None:
    """Raise the error that names the effects without which `finite` would hold; return where it holds.

    Raises:
        CraneError: a law gives no number; `where` says at which arguments.
    """
    found = without_numbers(crane, finite)
    if found:
        raise refusal(crane, found, where)


def refusal(crane: Crane, keys: list[str], where: str) -> CraneError:
    """Return the error that says of which effects a law gives no number, and where."""
    named = " and ".join(f"{key!r}{_file_of(key)}" for key in keys)
    return CraneError(
        f"{crane.name}: effect {named} gives no finite number (NaN or infinite) at {where}. "
        "Correct its law so that it gives a number at every state, or its parameters in the crane file."
    )


def _file_of(key: str) -> str:
    """Return " of FILE" for an effect of a user's own file."""
    effect, _ = registry.split_key(key)
    source = inspect.getsourcefile(effect)
    return f" of {source}" if source and Path(source) in registry.user_files() else ""


def _onwards(
    crane: Crane, state: np.ndarray, w: np.ndarray, time: float, h: float
) -> Iterator[tuple[np.ndarray, float]]:
    """Yield states with their times: the given one, and where it goes at its rates there."""
    lay = crane.layout
    yield state, time
    rates = terms(crane.nominal(), state[lay.basic], w[lay.driving], time)
    names = [f"d{n}" for n in (*lay.rates, *lay.chambers)]
    swings = state[lay.extra][1:]
    slope = np.concatenate([state[lay.velocities], [rates[n] for n in names], swings, np.zeros(len(swings))])
    for share in _FRACTIONS[1:]:
        yield state + share * h * slope, time + share * h


def _terms_are_finite(crane: Crane, state: np.ndarray, w: np.ndarray, time: float) -> bool:
    """Return whether every term of the balances of a crane is a number at a state, which may be one with a pendulum."""
    x = state[: size_of_state(crane)]
    try:
        return bool(np.isfinite(list(terms(crane, x, w, time).values())).all())
    except (CraneError, ArithmeticError, np.linalg.LinAlgError):
        return False
