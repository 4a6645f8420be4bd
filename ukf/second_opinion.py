"""Who is right, the filter or the sensor that it rejects? A second filter that believes the sensor, beside the first,
tells.

A leap between two samples says that a sensor was wrong before it or is wrong after it, not which. The filter stays with
what it believed first. When the sensor then agrees with itself for long (`monitor`), a second filter is set up from
what all sensors read now, the rejected one included, and both go on side by side. The *other* sensors, which both
believe, decide: the log of the ratio of their likelihoods under the two filters is summed over at most half a second.
Without another sensor there is nothing that speaks against the rejected one, and it is believed.

A belief that no sensor fits for long is heard in the same way: the second filter is set up from what the believed
sensors read now, all of them decide, and only clear evidence is enough, because a wrong model fits a little better with
every new beginning.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from .consistency import log_likelihood

#: log of the likelihood ratio at which the hearing ends before its time
_CLEAR = 50.0
#: longest hearing, s, and the fewest samples of it
_LONGEST, _FEWEST = 0.5, 5
#: a second filter starts with wide pressures and rates, which costs it likelihood until they have settled, s
_SETTLING = 0.1


@dataclass
class SecondOpinion:
    """A belief under which the sensor in row `row` is right, weighed against the one under which it is not.

    Attributes:
        row: of the sensor among the channels; None where no sensor is in question, but the first belief.
        belief: what the second filter believes.
        begun: when it was set up, s; `since`: since when the sensor has agreed with itself, or none has fitted the
            first belief.
        evidence: log of the likelihood ratio of the (other) sensors so far, positive for the second filter.
        steps: samples weighed; `others`: readings of other sensors among them.
    """

    row: int | None
    belief: Any
    begun: float
    since: float
    evidence: float = 0.0
    steps: int = 0
    others: int = 0

    def weigh(
        self, time: float, first: tuple[np.ndarray, np.ndarray], second: tuple[np.ndarray, np.ndarray], used: np.ndarray
    ) -> None:
        """Add a sample: innovations and their variances (k,) of both filters, and which sensors (k,) both believe."""
        if time - self.begun < _SETTLING:
            return
        self.steps += 1
        rows = used & np.isfinite(first[0]) & np.isfinite(second[0])
        if self.row is not None:
            rows[self.row] = False
        self.others += int(rows.sum())
        for sign, (innovation, variance) in ((1.0, second), (-1.0, first)):
            self.evidence += sign * log_likelihood(innovation[rows], variance[rows])

    def right(self, time: float) -> bool | None:
        """Return whether the second filter is right and the first one wrong; None while that is open."""
        if self.steps < _FEWEST:
            return None
        if abs(self.evidence) < _CLEAR and time - self.begun < _LONGEST:
            return None
        if self.row is None:
            return self.evidence > _CLEAR
        return self.evidence > 0.0 or self.others == 0
