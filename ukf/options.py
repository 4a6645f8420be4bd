"""The options of an estimator: how it filters, apart from the crane, the sensors and the noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crane_exudyn.errors import CraneError

from .filter import Belief
from .revisit import Revisit
from .samples import positive

#: what to give where a number is none that works, and whether it may be infinite
_POSITIVE = {
    "max_step": ("a positive time in seconds, such as 1e-3", False),
    "gate": ("a positive number of standard deviations, or None for no gate", True),
    "pressure_std": ("a positive deviation in Pa, such as 1e6", False),
    "adapt": ("a positive time in seconds, or numpy.inf for never", True),
}


@dataclass(frozen=True)
class Options:
    """What `Estimator` takes under the same names; an infinite `gate` is none.

    Raises:
        CraneError: a time, a deviation or a gate that is not positive, or a filter that cannot revisit.
    """

    method: str
    start: Belief | None
    gate: float
    max_step: float
    pressure_std: float
    adapt: float
    strokes: bool
    revisit: Revisit | None

    def __post_init__(self) -> None:
        for name, (mend, endless) in _POSITIVE.items():
            object.__setattr__(self, name, positive(getattr(self, name), name, mend, endless=endless))
        if self.revisit is not None and self.method != "ekf":
            raise CraneError(
                f'revisit needs the filter "ekf", found {self.method!r}. Use method="ekf", or leave revisit out.'
            )

    @property
    def unlikely(self) -> float:
        """Minus the log-likelihood of a reading that is not believed: it is as likely as one at the gate."""
        return 0.5 * self.gate**2 if self.gate < np.inf else 0.0
