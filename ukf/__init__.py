"""Unscented Kalman filtering of the crane, for any engine.

    from ukf import Estimator

Names are imported when they are first asked for, so that `import ukf` costs nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from crane_exudyn.lazily import lazily

if TYPE_CHECKING:
    from .estimate import Estimate as Estimate
    from .estimator import Estimator as Estimator

_WHERE = {"Estimate": ".estimate", "Estimator": ".estimator"}
__all__ = ["Estimate", "Estimator"]
__getattr__ = lazily(__name__, _WHERE)
