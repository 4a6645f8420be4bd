"""Engines by name. A package announces its engine as an entry point, so that what uses an engine need not import it:

[project.entry-points."crane_exudyn.engines"]
mine = "my_package:MyEngine"
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from importlib.metadata import entry_points
from typing import Any

from .errors import CraneError


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
