"""Which manoeuvre would tell two explanations apart: tried by simulation, within the crane's limits."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError, listed
from crane_exudyn.parameters import LAYOUT

from ..fit.data import FitData
from ..fit.model import model_of
from ..semi_recursive.engine import SemiRecursiveEngine

_STEP = 2.5e-3
_DURATION = 20.0


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre in words and as breakpoints (time s, command) of each valve."""

    text: str
    lift: Sequence[tuple[float, float]] = ((0.0, 0.0),)
    tilt: Sequence[tuple[float, float]] = ((0.0, 0.0),)

    def commands(self, time: np.ndarray) -> np.ndarray:
        """Return commands (n, 2), linear between the breakpoints."""
        return np.column_stack([np.interp(time, *np.array(list(b)).T) for b in (self.lift, self.tilt)])


def _pulses(height: float, *moments: float, length: float = 2.0) -> list[tuple[float, float]]:
    """Breakpoints of pulses of alternating sign that begin at the given moments."""
    points = [(0.0, 0.0)]
    for i, t in enumerate(moments):
        sign = 1.0 if i % 2 == 0 else -1.0
        points += [(t, 0.0), (t + 0.1, sign * height), (t + length, sign * height), (t + length + 0.1, 0.0)]
    return points


MANOEUVRES = (
    Manoeuvre("lift slowly up and down twice with rests between (command 0.08)", lift=_pulses(0.08, 2.0, 6.0, 10.0, 14.0)),
    Manoeuvre("lift quickly up and down twice with rests between (command 0.4)", lift=_pulses(0.4, 2.0, 6.0, 10.0, 14.0, length=1.2)),
    Manoeuvre("tilt slowly out and in twice with rests between (command 0.08)", tilt=_pulses(0.08, 2.0, 6.0, 10.0, 14.0)),
    Manoeuvre("tilt quickly out and in twice with rests between (command 0.4)", tilt=_pulses(0.4, 2.0, 6.0, 10.0, 14.0, length=1.2)),
    Manoeuvre(
        "move both cylinders at the same time, then each alone (command 0.3)",
        lift=_pulses(0.3, 2.0, 8.0, length=1.5), tilt=_pulses(0.3, 2.0, 14.0, length=1.5),
    ),
    Manoeuvre("hold still under load for 20 s after one short lift", lift=_pulses(0.3, 1.0, length=0.8)),
)  # fmt: skip
#: poses (z1, z4) in degrees from which each is tried
_POSES = ((5.0, -50.0), (25.0, -70.0))


def best_manoeuvre(first: Crane, second: Crane, noise: Mapping[str, float], channels: tuple[str, ...]) -> str:
    """Return in words the manoeuvre on which two cranes differ most, and by how much; it stays within both cranes' strokes."""
    best, text = 0.0, ""
    for manoeuvre in MANOEUVRES:
        for pose in _POSES:
            found = _difference(first, second, manoeuvre, np.radians(pose), noise, channels)
            if found is not None and found[0] > best:
                best = found[0]
                text = (
                    f"{manoeuvre.text}, starting at {listed(LAYOUT.coordinates, pose, '{:g}°')}: "
                    f"the explanations then differ by {found[0]:.1f} times the noise in {found[1]}"
                )
    return text or "none of the manoeuvres that were simulated tells them apart; another sensor would be needed"


def _difference(
    first: Crane,
    second: Crane,
    manoeuvre: Manoeuvre,
    pose: np.ndarray,
    noise: Mapping[str, float],
    channels: tuple[str, ...],
) -> tuple[float, str] | None:
    time = np.arange(0.0, _DURATION, _STEP)
    outputs = []
    for crane in (first, second):
        data = FitData("", time, _STEP, time, manoeuvre.commands(time), np.full((len(time), 2), np.nan), ())
        try:
            engine, model = SemiRecursiveEngine(crane), model_of(crane, data)
            X = engine.simulate(engine.static_start(float(pose[0]), float(pose[1])), time, model.W, step=_STEP)
        except CraneError:
            return None  # the manoeuvre leaves the crane's limits
        outputs.append(model.measurement(channels).shown(X, time))
    apart = np.sqrt(np.mean((outputs[0] - outputs[1]) ** 2, axis=0)) / np.array([noise[c] for c in channels])
    worst = int(np.argmax(apart))
    return float(apart[worst]), channels[worst]
