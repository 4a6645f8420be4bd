"""What pictures show of a machine: where it is, and its pressures, over time."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from .crane import Crane, checked_crane
from .errors import CraneError, shortened
from .layout import Layout
from .pose import relative, sources
from .recording import Recording

#: s by which times that mean the same may differ, rounded or summed up
_ROUNDED = 1e-9


@dataclass(frozen=True)
class Trajectory:
    """One machine's motion: coordinates and pressures over time.

    Attributes:
        label: "measured", "simulated", "estimated" or another word; it is written into the picture.
        time: (n,) s, increasing.
        positions: (n, coordinates) independent coordinates in the order of the layout, rad or m.
        pressures: channel -> (n,) Pa, for those chambers where they are known; NaN where one is not known.
        theta: (n,) rad, angle of the payload's pendulum against straight down; None where it is not known.
        timed: whether its time is that of a run, and not of a machine that just stands.

    Raises:
        CraneError: shapes that do not fit each other, a time that does not increase, a number that is not finite.
    """

    label: str
    time: np.ndarray
    positions: np.ndarray
    pressures: dict[str, np.ndarray] = field(default_factory=dict)
    theta: np.ndarray | None = None
    timed: bool = True

    def __post_init__(self) -> None:
        for name in ("time", "positions"):
            object.__setattr__(self, name, np.asarray(getattr(self, name), dtype=float))
        count, where = self.time.size, f"The trajectory {self.label!r}"
        if self.time.shape != (count,) or not count or self.positions.shape[:1] != (count,):
            raise CraneError(
                f"{where}: time has the shape {self.time.shape} and positions have {self.positions.shape}; expected "
                "(n,) and (n, coordinates). Give a row of positions for each time."
            )
        others = self.pressures if self.theta is None else {**self.pressures, "theta": self.theta}
        for name, values in others.items():
            if np.shape(values) != (count,):
                raise CraneError(
                    f"{where}: {name} has the shape {np.shape(values)}, expected ({count},). Give one for each time."
                )
        for name in ("time", "positions"):
            bad = ~np.isfinite(getattr(self, name)).reshape(count, -1).all(axis=1)
            if bad.any():
                raise CraneError(
                    f"{where}: found a number that is not finite in {name}, sample {bad.argmax()}; every time "
                    "needs a position. Leave such samples out."
                )
        if not (np.diff(self.time) > 0.0).all():
            raise CraneError(f"{where}: its time does not increase. Sort the samples, and keep one of each time.")

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
        coordinate, while all are known.

        Raises:
            CraneError: no recording, one that lacks a coordinate, relative or absolute, or has them at no common time.
        """
        if not isinstance(recording, Recording):
            raise CraneError(
                f"Trajectory.from_recording: found {shortened(recording)}, expected a Recording. Read a file with "
                "Recording.load(FILE, layout=crane.layout)."
            )
        layout, shown = recording.layout, coordinates_in(recording)
        if not all(shown):
            lacking = [name for name, found in zip(layout.coordinates, shown, strict=True) if not found]
            raise CraneError(
                f"{recording.source or recording.name}: a picture needs {' and '.join(layout.coordinates)} (or one of "
                f"them with _abs, against the ground); {' and '.join(lacking)} {'are' if len(lacking) > 1 else 'is'} "
                f"missing, found only {', '.join(recording.channels)}. "
                "Estimate them first: patu estimate REC -o states.csv."
            )
        time = recording[shown[0]].time
        time = time[np.isfinite([recording[channel].at(time) for channel in shown]).all(axis=0)]
        if not time.size:
            raise CraneError(
                f"{recording.source or recording.name}: {' and '.join(shown)} have no time in common, and a picture "
                "needs all of them at once. Give a recording that contains them together."
            )
        held = relative(layout, {channel: recording[channel].held(time) for channel in shown})
        known = [p for p in layout.chambers if recording.has(p)]
        theta = recording["theta"].held(time) if recording.has("theta") else None
        positions = np.column_stack(list(held.values()))
        return cls(label, time, positions, {p: recording[p].at(time) for p in known}, theta)

    @classmethod
    def at_rest(cls, crane: Crane) -> Trajectory:
        """Return the crane standing still at the start that its file gives, for one second.

        Raises:
            CraneError: no crane.
        """
        checked_crane(crane, "Trajectory.at_rest")
        return cls("start", np.array([0.0, 1.0]), np.tile(crane.initial.pose, (2, 1)), timed=False)

    def at(self, time: float) -> np.ndarray:
        """Return the coordinates at a time, linear between samples, held outside."""
        return np.array([np.interp(time, self.time, column) for column in self.positions.T])

    def covers(self, time: float) -> bool:
        """Return whether a time in s lies between the first and the last sample."""
        return bool(self.time[0] - _ROUNDED <= time <= self.time[-1] + _ROUNDED)

    def swing_at(self, time: float) -> float:
        """Return the pendulum's angle in rad at a time; 0, hanging at rest, where it is not known."""
        return 0.0 if self.theta is None else float(np.interp(time, self.time, self.theta))

    def pressure_at(self, name: str, time: float) -> float:
        """Return a pressure in Pa at a time; NaN where it is not known."""
        values = self.pressures.get(name)
        return math.nan if values is None or not self.covers(time) else float(np.interp(time, self.time, values))


def coordinates_in(recording: Recording) -> list[str]:
    """Return the channel of a recording that shows each coordinate, relative or absolute; "" where there is none."""
    lay = recording.layout
    return list(sources(lay, [name for name in recording.channels if name not in lay.lengths]))
