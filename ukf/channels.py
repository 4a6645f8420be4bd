"""What the sensors should read in a state: y = h(x), with the crane's sensor effects and estimated biases.

All channels but s1, s2 are linear in the state z1, z4, ż1, ż4, p1 … p4; the cylinder lengths go through the crane's
geometry. A sensor with a lag shows a first-order follower of its reading, which is a state of its own.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.faulty_laws import check_law
from crane_exudyn.statics import vapour_pressure

from .augment import SENSORS, Extra

#: rows of H over [z1 z4 ż1 ż4 p1 p2 p3 p4] for the linear channels
_ROWS: dict[str, dict[int, float]] = {
    "z1": {0: 1.0},
    "z4": {1: 1.0},
    "z4_abs": {0: 1.0, 1: 1.0},
    "dz1": {2: 1.0},
    "dz4": {3: 1.0},
    "dz4_abs": {2: 1.0, 3: 1.0},
    "p1": {4: 1.0},
    "p2": {5: 1.0},
    "p3": {6: 1.0},
    "p4": {7: 1.0},
}


class Channels:
    """The measurement function of a set of sensors, for states of the engine with extra states after them."""

    def __init__(
        self,
        crane: Crane,
        names: Sequence[str],
        engine_states: int,
        extras: Sequence[Extra] = (),
        lengths: Callable[[np.ndarray], np.ndarray] | None = None,
    ) -> None:
        """`lengths` maps z (m, 2) to cylinder lengths (m, 2); it is needed for s1, s2 only."""
        for name in names:
            if name not in SENSORS:
                raise CraneError(f"sensor {name!r} is not known.{nearest(name, list(SENSORS))}")
            if name in ("s1", "s2") and lengths is None:
                raise CraneError(f"sensor {name!r} needs the crane's geometry, which this engine does not offer.")
        self.names, self._crane = tuple(names), crane
        self.lags = lags(crane, self.names)
        self._engine_states, self._least = engine_states, vapour_pressure(crane)
        self._lengths = lengths
        self._matrix = self._linear_part(engine_states, extras)
        self._distances = [(i, int(n[1]) - 1) for i, n in enumerate(self.names) if n in ("s1", "s2")]
        self._gains = _sensor_effects(crane, self.names)
        self._plain = not self._distances and not self.lags and not self._gains
        self._transposed = np.ascontiguousarray(self._matrix.T)

    def _linear_part(self, engine_states: int, extras: Sequence[Extra]) -> np.ndarray:
        width = engine_states + len(self.lags) + len(extras)
        matrix = np.zeros((len(self.names), width))
        for row, name in enumerate(self.names):
            for column, value in _ROWS.get(name, {}).items():
                matrix[row, column] = value
        for k, extra in enumerate(extras):
            if extra.kind != "bias":
                continue
            channel = extra.name.removeprefix("bias.")
            if channel not in self.names:
                raise CraneError(f"augmented state {extra.name!r}: there is no sensor {channel!r} to have a bias.")
            matrix[self.names.index(channel), engine_states + len(self.lags) + k] = 1.0
        return matrix

    def _visible(self, points: np.ndarray) -> np.ndarray:
        """Return points (m, n) with vapour pressure where a chamber holds a void."""
        if points[:, 4:8].min() >= self._least:
            return points
        shown = points.copy()
        shown[:, 4:8] = np.maximum(points[:, 4:8], self._least)
        return shown

    def read(self, points: np.ndarray) -> np.ndarray:
        """Return what the sensors would read without lag (m, k), from points (m, n)."""
        out = self._visible(points) @ self._transposed
        if self._distances and self._lengths is not None:
            lengths = self._lengths(points[:, :2])
            for row, cylinder in self._distances:
                out[:, row] += lengths[:, cylinder]
        for row, reading in self._gains:
            true, out[:, row] = out[:, row].copy(), reading(out[:, row])
            if not np.isfinite(out[:, row]).all():
                _refuse_reading(self._crane, self.names[row], true[~np.isfinite(out[:, row])][0])
        return out

    def observe(self, points: np.ndarray) -> np.ndarray:
        """Return the measurements (m, k) expected in points (m, n); a sensor with a lag shows its own state."""
        if self._plain:
            return self._visible(points) @ self._transposed
        out = self.read(points)
        for k, (row, _) in enumerate(self.lags):
            out[:, row] = points[:, self._engine_states + k]
        return out

    def follow(self, before: np.ndarray, after: np.ndarray, dt: float) -> np.ndarray:
        """Return the lag states (m, lags) after `dt`: first-order followers of readings that are linear between."""
        old, new = self.read(before), self.read(after)
        out = np.empty((len(before), len(self.lags)))
        for k, (row, tau) in enumerate(self.lags):
            decay = np.exp(-dt / tau)
            slope = (new[:, row] - old[:, row]) / dt
            out[:, k] = new[:, row] - slope * tau
            out[:, k] += (before[:, self._engine_states + k] - old[:, row] + slope * tau) * decay
        return out


def lags(crane: Crane, names: Sequence[str]) -> tuple[tuple[int, float], ...]:
    """Return (row, time constant) of the sensors that the crane says have a lag."""
    found = []
    for row, name in enumerate(names):
        acting = crane.effect(f"sensor_lag@{name}") if name in ("z1", "z4", "p1", "p2", "p3", "p4") else None
        if acting is not None and acting.parameters["tau"] > 0:
            found.append((row, float(acting.parameters["tau"])))
    return tuple(found)


def _refuse_reading(crane: Crane, name: str, true: float) -> None:
    """Say which effect makes no number of the true value (SI) of a sensor's quantity."""
    from crane_exudyn.effects import hooks
    from crane_exudyn.effects.base import SENSORS as PLACES

    place = PLACES.index(name)
    check_law(
        crane,
        lambda tried: bool(np.isfinite(hooks.measurement(tried.effect_vector(), place, true))),
        f"{name} = {true:g}",
    )


def _sensor_effects(crane: Crane, names: Sequence[str]) -> list[tuple[int, Callable[[np.ndarray], np.ndarray]]]:
    """Return (row, reading) of the sensors on which an effect of the crane acts, such as a bias or a scale."""
    from crane_exudyn.effects.base import SENSORS as PLACES

    touched = {e.place for e in crane.effects}
    rows = [(r, n) for r, n in enumerate(names) if n in PLACES and n in touched]
    if not rows:
        return []
    from crane_exudyn.effects import hooks

    effect_vector = crane.effect_vector()

    def reading(place: int) -> Callable[[np.ndarray], np.ndarray]:
        return lambda values: np.array([hooks.measurement(effect_vector, place, v) for v in values])

    return [(row, reading(PLACES.index(name))) for row, name in rows]
