"""How far a run depends on the size of its steps: a second run, by the independent engine with a tenth of the local
error, says it.

A local error that each step keeps small is small at the end too, as long as the machine forgets it. Where a machine
makes it larger (a boom that bounces between voids, or on a stop that does not damp), no local estimate can tell; two
runs that come apart do.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from crane_exudyn.simulation import Simulation, simulate
from crane_exudyn.statics import visible

from .semi_recursive import SemiRecursiveEngine

if TYPE_CHECKING:
    from crane_exudyn.recording import Recording

#: what a run at default settings promises, RMS: rad and Pa
POSITION, PRESSURE = 1e-5, 0.1e5
#: local error of the second run, in units of that of the first
_FINER = 0.1


@dataclass(frozen=True)
class StepError:
    """How far two runs come apart.

    Attributes:
        position, pressure: largest RMS difference of a coordinate (rad) and of a visible pressure (Pa).
        since: instant in s from which on one of them is larger than a run promises; None where the promise is kept.
    """

    position: float
    pressure: float
    since: float | None


def step_error(run: Simulation, recording: Recording | None, step: float, *, filled: bool = False) -> StepError:
    """Return how far a run depends on its steps.

    Args:
        run: of a crane driven by `recording` (None: the paper's cycle) with steps of at most `step` s, `filled` where
            it has more instants than the recording.

    Raises:
        CraneError: the second run fails.
    """
    finer = SemiRecursiveEngine(run.crane, accuracy=_FINER)
    second = simulate(run.crane, recording, start=run.states[0], engine=finer, step=step, filled=filled)
    layout = run.crane.layout
    apart = (visible(run.crane, run.states) - visible(run.crane, second.states))[:, layout.basic]
    promised = np.full(apart.shape[1], np.inf)
    promised[layout.positions], promised[layout.pressures] = POSITION, PRESSURE
    summed = np.cumsum((apart / promised) ** 2, axis=0).max(axis=1) / len(apart)
    rms = np.sqrt(np.mean(apart**2, axis=0))
    late = np.flatnonzero(~(summed <= 1.0))
    since = float(run.time[late[0]]) if late.size else None
    return StepError(float(rms[layout.positions].max()), float(rms[layout.pressures].max()), since)
