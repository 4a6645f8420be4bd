"""Unscented Kalman filtering of the crane, for any engine.

    from ukf import Estimator

Names are imported when they are first asked for, so that `import ukf` costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .estimate import Estimate as Estimate
    from .estimator import Estimator as Estimator

_WHERE = {"Estimate": ".estimate", "Estimator": ".estimator"}
__all__ = ["Estimate", "Estimator"]


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'ukf' has no attribute {name!r}")
    return getattr(importlib.import_module(_WHERE[name], __name__), name)
