"""Engines by name. A package announces its engine as an entry point, so that what uses an engine need not import it:

[project.entry-points."crane_exudyn.engines"]
mine = "my_package:MyEngine"
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from .crane import Crane
from .errors import CraneError, shortened


@cache
def engine_class(name: str) -> Callable[..., Any]:
    """Return the class of an engine by its name, such as "exudyn"; it is called with a crane.

    Raises:
        CraneError: no installed package has an engine of that name.
    """
    known = {found.name: found for found in entry_points(group="crane_exudyn.engines")}
    if name not in known:
        names = " or ".join(f'"{n}"' for n in sorted(known)) or "an engine object, and install the package again"
        raise CraneError(f"There is no engine {name!r}. Use {names}.")
    made: Callable[..., Any] = known[name].load()
    return made


def of_this_crane(engine: Any, crane: Crane) -> Any:
    """Return an engine object, which must compute with this crane: what it computes would pass for this one's.

    Cranes are told apart by what an engine takes from them: machine, parameters, effects and objects of one's own.

    Raises:
        CraneError: something else, or an engine of another crane.
    """
    if isinstance(engine, type) or not (hasattr(engine, "propagate") or hasattr(engine, "simulate")):
        raise CraneError(
            f'engine is {shortened(engine)}. Give a name, such as "exudyn", or an engine object, ExudynEngine(crane).'
        )
    own = getattr(engine, "crane", crane)
    if own is not crane and isinstance(own, Crane) and (apart := _apart(own, crane)):
        kind = type(engine).__name__
        raise CraneError(
            f"The {kind} contains another crane than the given {crane.name}: {apart}. Make one of this crane, "
            f"{kind}(crane), or give the engine's name."
        )
    return engine


def _apart(own: Crane, crane: Crane) -> str:
    """Return in words what an engine's own crane computes otherwise than a crane; "" where nothing does."""
    if own.machine != crane.machine:
        return "it is of another machine"
    values = [n for n in crane.machine.names if own[n] != crane[n]]
    if values:
        more = f" (and {len(values) - 1} more)" if len(values) > 1 else ""
        return f"its {values[0]} is {own[values[0]]:g}, not {crane[values[0]]:g}{more}"
    mine, asked = ({e.key: e.parameters for e in c.effects} for c in (own, crane))
    effects = sorted(key for key in mine.keys() | asked.keys() if mine.get(key) != asked.get(key))
    if effects:
        return f"the effect {effects[0]} is not the same"
    if own.objects != crane.objects:
        return f"it has {len(own.objects)} user-defined objects, this one {len(crane.objects)}"
    return ""
