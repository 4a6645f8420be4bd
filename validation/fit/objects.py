"""Objects of one's own beside a recording: what they put on the joints along the measured motion.

Only the Exudyn engine knows them. Fit and balances run on the other one, to which their moments are given as known
inputs.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from crane_exudyn.crane import Crane

from .data import FitData
from .start import knots_of
from .windows import cut

#: s between the instants at which the objects' moments are measured
_EVERY = 0.05


def with_objects(crane: Crane, data: FitData) -> FitData:
    """Return data that know what the crane's objects put on its joints; the same where it has none.

    Raises:
        CraneError: objects that an engine does not take, or a measured pose that cannot be reached.
    """
    if not crane.objects:
        return data
    from crane_exudyn.engine import ExudynEngine

    windows = cut(data, _EVERY)
    time = data.time[[w.start for w in windows]]
    states = knots_of(replace(crane, objects=()), data, windows)
    moments = ExudynEngine(crane.nominal()).object_moments(states, time)
    return replace(data, moments=np.column_stack([np.interp(data.time, time, m) for m in moments.T]))
