"""Adding effects to a crane file and taking them away again, with the file keeping account of it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from crane_exudyn.crane import Crane
from crane_exudyn.crane_toml import as_given
from crane_exudyn.description import GaussMarkov
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import Effect
from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.frozen import frozen
from crane_exudyn.parameters import unit_of

from .criteria import CRITERIA
from .report import amount


def added(before: Crane, after: Crane, **evidence: Any) -> Crane:
    """Return `after` with a history entry that tells what changed since `before`, enough to undo it exactly."""
    keys = [e.key for e in after.effects if before.effect(e.key) is None]
    moved = {n: {"from": before.values[n], "to": v} for n, v in after.values.items() if v != before.values[n]}
    adjusted = {
        e.key: dict(e.parameters)
        for e in before.effects
        if (now := after.effect(e.key)) is None or dict(now.parameters) != dict(e.parameters)
    }
    entry: dict[str, Any] = {"added": keys or ["parameters"], **evidence, "parameters": moved}
    entry |= {"effects_before": adjusted} if adjusted else {}
    kept = {n: as_given(e) for n, e in before.model_error.items()}
    return after.with_history(entry | ({"model_error_before": kept} if kept else {}))


def with_errors(crane: Crane, before: tuple[float, float], after: tuple[float, float]) -> Crane:
    """Return the crane with what the last step of its history did to the errors, in noise units: on what was learned
    from and on the check recording, NaN where there is none.
    """
    pairs = zip(("error", "check_error"), zip(before, after, strict=True), strict=True)
    errors = {f"{name}_{when}": e for name, both in pairs for when, e in zip(("before", "after"), both, strict=True)}
    entry = {**crane.history[-1], **{name: error for name, error in errors.items() if math.isfinite(error)}}
    return replace(crane, history=(*crane.history[:-1], frozen(entry)))


def removed(crane: Crane, key: str) -> Crane:
    """Return the crane without an effect; exactly as it was before the last step of its history, if that added nothing
    else that is still there.

    What else the last step added stays, and the parameters as they were fitted with it. An effect from further back is
    taken out alone.

    Raises:
        CraneError: the crane has no such effect.
    """
    keys = [e.key for e in crane.effects]
    last = crane.history[-1] if crane.history else {}
    if key in (added := last.get("added", [])):
        if not set(added) & set(keys) - {key}:
            return _undone(crane, last)
        entry = {**last, "added": [k for k in added if k != key], "removed": [*last.get("removed", []), key]}
        return replace(crane.without_effect(key), model_error={}, history=(*crane.history[:-1], frozen(entry)))
    if key not in keys:
        known = nearest(key, keys) if keys else " It has none at all."
        raise CraneError(f"{crane.label} has no effect {key!r}.{known}")
    return replace(crane.without_effect(key), model_error={})


def _undone(crane: Crane, entry: Mapping[str, Any]) -> Crane:
    result = crane.with_parameters({n: change["from"] for n, change in entry.get("parameters", {}).items()})
    for key in entry["added"]:
        if result.effect(key) is not None:
            result = result.without_effect(key)
    for key, values in entry.get("effects_before", {}).items():
        result = result.with_effect(key, values)
    before = {n: GaussMarkov(**e) for n, e in entry.get("model_error_before", {}).items()}
    return replace(result, model_error=before, history=crane.history[:-1])


def learned(crane: Crane) -> tuple[str, ...]:
    """Return the laws of a crane that were learned, as its history says."""
    keys = {key for entry in crane.history for key in entry.get("learned", ())}
    return tuple(e.key for e in crane.effects if e.key in keys)


def without_learned(crane: Crane) -> Crane:
    """Return the crane without the laws that were learned; what came and moved with the last of them as it was
    before.
    """
    while keys := learned(crane):
        last = crane.history[-1]
        crane = _undone(crane, last) if keys[-1] in last.get("added", ()) else removed(crane, keys[-1])
    return crane


#: so many parameters that moved are listed one by one
_LISTED = 8


def moved_in_words(before: Crane, after: Crane) -> str:
    """Return in words which nominal parameters differ between two cranes, by more than a little of their uncertainty,
    those first that moved furthest, of many not all; "" where none does.
    """
    moves = dict[str, float]()
    for name, value in after.values.items():
        known, moved = before.uncertainty.get(name), abs(value - before.values[name])
        size = known.std if known and math.isfinite(known.std) else 0.0
        if moved > CRITERIA.moved * size:
            moves[name] = moved / size if size else math.inf
    names = sorted(moves, key=lambda n: -moves[n])
    texts = [f"{n} {amount(before[n], unit_of(n))} -> {amount(after[n], unit_of(n))}" for n in names[:_LISTED]]
    return ", ".join(texts) + f", and {len(names) - _LISTED} more by smaller amounts" * (len(names) > _LISTED)


def addable(crane: Crane, key: str) -> tuple[type[Effect], str]:
    """Return an effect that can be added to a crane, and its place.

    Raises:
        CraneError: there is no such effect, the crane has it, or it is no set of numbers that could be given or fitted.
    """
    effect, place = registry.split_key(key, crane.layout)
    if effect.curve is not None:
        raise CraneError(
            f"{key!r} is a curve: `patu learn` finds it. To give one, write its table (over, x, y) into the crane file."
        )
    if crane.effect(key) is not None:
        raise CraneError(f"{crane.label} has {key!r} already. Remove it first, or fit it again with `patu improve`.")
    return effect, place


def with_typical(crane: Crane, key: str, values: Mapping[str, float]) -> Crane:
    """Return the crane with an effect at the given values, or where none are given at values that are met in
    practice.
    """
    effect, _ = addable(crane, key)
    typical = dict(effect.probes[0]) if effect.probes else {effect.parameters[0].name: effect.parameters[0].typical}
    return crane.with_effect(key, dict(values) or typical)
