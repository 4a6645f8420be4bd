"""What a model is worth: how well it predicts, where it fails, what it lacks, and what mends it.

    from validation import compare, diagnose, improve, learn

Names are imported when they are first asked for, so that `import validation` costs nothing.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .compare import compare as compare
    from .diagnosis import diagnose as diagnose
    from .improvement import improve as improve
    from .learning import learn as learn
    from .report import write_report as write_report

_WHERE = {
    "compare": ".compare",
    "diagnose": ".diagnosis",
    "improve": ".improvement",
    "learn": ".learning",
    "write_report": ".report",
}
__all__ = ["compare", "diagnose", "improve", "learn", "write_report"]


class _Package(ModuleType):
    """This package: `validation.compare` stays the function, also after the module of that name has been imported."""

    def __setattr__(self, name: str, value: Any) -> None:
        if not (name in _WHERE and isinstance(value, ModuleType)):
            super().__setattr__(name, value)


sys.modules[__name__].__class__ = _Package


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'validation' has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name], __name__), name)
