"""What pictures show of a machine: where it is, and its pressures, over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from .crane import Crane
from .errors import CraneError
from .layout import Layout

if TYPE_CHECKING:
    from .recording import Recording


@dataclass(frozen=True)
class Trajectory:
    """One machine's motion: coordinates and pressures over time.

    Attributes:
        label: "measured", "simulated", "estimated" or another word; it is written into the picture.
        time: (n,) s, increasing.
        positions: (n, coordinates) independent coordinates in the order of the layout, rad or m.
        pressures: channel -> (n,) Pa, for those chambers where they are known.
        theta: (n,) rad, angle of the payload's pendulum against straight down; None where it is not known.
        timed: whether its time is that of a run, and not of a machine that just stands.
    """

    label: str
    time: np.ndarray
    positions: np.ndarray
    pressures: dict[str, np.ndarray] = field(default_factory=dict)
    theta: np.ndarray | None = None
    timed: bool = True

    @classmethod
    def from_states(cls, label: str, time: np.ndarray, states: np.ndarray, layout: Layout) -> Trajectory:
        """Return the trajectory of states (n, nx) as engines give them, at `time` (n,); layout: the machine's,
        `crane.layout`.
        """
        pressures = dict(zip(layout.chambers, states[:, layout.pressures].T, strict=True))
        theta = next(iter(states[:, layout.extra].T), None)
        return cls(label, np.asarray(time, dtype=float), states[:, layout.positions], pressures, theta)

    @classmethod
    def from_recording(cls, recording: Recording, label: str = "measured") -> Trajectory:
        """Return the motion that a recording (or the written result of a run) holds, on the clock of the first
        coordinate.

        Raises:
            CraneError: it lacks a coordinate, relative or absolute.
        """
        layout = recording.layout
        shown = [next((n for n in (name, f"{name}_abs") if recording.has(n)), "") for name in layout.coordinates]
        if not all(shown):
            lacking = [name for name, found in zip(layout.coordinates, shown, strict=True) if not found]
            raise CraneError(
                f"{recording.source or recording.name}: a picture needs {' and '.join(layout.coordinates)} (or one of "
                f"them with _abs, against the ground); {' and '.join(lacking)} {'are' if len(lacking) > 1 else 'is'} "
                f"missing, found only {', '.join(recording.channels)}. "
                "Estimate them first: patu estimate REC -o states.csv."
            )
        time = recording[shown[0]].time
        held: dict[str, np.ndarray] = {}
        for name, channel in zip(layout.coordinates, shown, strict=True):
            carried = sum((held[c] for c in layout.carriers(name)), np.zeros(len(time)))
            held[name] = recording[channel].held(time) - (0.0 if channel == name else carried)
        known = [p for p in layout.chambers if recording.has(p)]
        theta = recording["theta"].held(time) if recording.has("theta") else None
        positions = np.column_stack(list(held.values()))
        return cls(label, time, positions, {p: recording[p].held(time) for p in known}, theta)

    @classmethod
    def at_rest(cls, crane: Crane) -> Trajectory:
        """Return the crane standing still at the start that its file gives, for one second."""
        return cls("start", np.array([0.0, 1.0]), np.tile(crane.initial.pose, (2, 1)), timed=False)

    def at(self, time: float) -> np.ndarray:
        """Return the coordinates at a time, linear between samples, held outside."""
        return np.array([np.interp(time, self.time, column) for column in self.positions.T])

    def swing_at(self, time: float) -> float:
        """Return the pendulum's angle in rad at a time; 0, hanging at rest, where it is not known."""
        return 0.0 if self.theta is None else float(np.interp(time, self.time, self.theta))

    def pressure_at(self, name: str, time: float) -> float:
        """Return a pressure in Pa at a time; NaN where it is not known."""
        values = self.pressures.get(name)
        return math.nan if values is None else float(np.interp(time, self.time, values))
