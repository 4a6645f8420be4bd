"""The crane once more, by the double-step semi-recursive method of the paper: an engine that shares no equation with
Exudyn's.

`equations` holds the model, `kernel` the time integration, `sensitivity` its derivatives, `terms` every term by name,
and `engine` the class that the rest of the project uses.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .engine import SemiRecursiveEngine as SemiRecursiveEngine

__all__ = ["SemiRecursiveEngine"]


def __getattr__(name: str) -> Any:
    if name != "SemiRecursiveEngine":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from .engine import SemiRecursiveEngine

    return SemiRecursiveEngine
