"""Which manoeuvre would tell two explanations apart: tried by simulation, within the crane's limits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.layout import Layout
from crane_exudyn.plots import shown

from ..fit.data import FitData
from ..fit.model import model_of
from ..semi_recursive.engine import SemiRecursiveEngine

_STEP = 2.5e-3
_DURATION = 20.0


@dataclass(frozen=True)
class Manoeuvre:
    """A manoeuvre in words and as breakpoints (time s, command) of the valves that are opened."""

    text: str
    moved: Mapping[int, Sequence[tuple[float, float]]]

    def commands(self, time: np.ndarray, valves: int) -> np.ndarray:
        """Return commands (n, valves), linear between the breakpoints."""
        out = np.zeros((len(time), valves))
        for valve, breakpoints in self.moved.items():
            out[:, valve] = np.interp(time, *np.array(list(breakpoints)).T)
        return out


def _pulses(height: float, *moments: float, length: float = 2.0) -> list[tuple[float, float]]:
    """Breakpoints of pulses of alternating sign that begin at the given moments."""
    points = [(0.0, 0.0)]
    for i, t in enumerate(moments):
        sign = 1.0 if i % 2 == 0 else -1.0
        points += [(t, 0.0), (t + 0.1, sign * height), (t + length, sign * height), (t + length + 0.1, 0.0)]
    return points


def manoeuvres(layout: Layout) -> Iterator[Manoeuvre]:
    """Yield the manoeuvres of a machine that are tried: each cylinder alone, all at once, and holding the load of the
    first.
    """
    names, four = layout.cylinders, (2.0, 6.0, 10.0, 14.0)
    for c, name in enumerate(names):
        for speed, height, length in (("slowly", 0.08, 2.0), ("quickly", 0.4, 1.2)):
            text = f"extend and retract the {name} cylinder {speed} twice with rests between (command {height:g})"
            yield Manoeuvre(text, {c: _pulses(height, *four, length=length)})
    if len(names) > 1:
        moments = [(2.0, 8.0 + (_DURATION - 10.0) * c / len(names)) for c in range(len(names))]
        pulses = {c: _pulses(0.3, *each, length=1.5) for c, each in enumerate(moments)}
        several = "both cylinders" if len(names) == 2 else "all cylinders"
        yield Manoeuvre(f"move {several} at the same time, then each alone (command 0.3)", pulses)
    held = f"hold still under load for {_DURATION:g} s after extending the {names[0]} cylinder once"
    yield Manoeuvre(held, {0: _pulses(0.3, 1.0, length=0.8)})


#: by the unit of a coordinate, by how much poses that are tried lie to either side of the crane file's start
_BESIDE: Mapping[str, float] = {"rad": np.radians(10.0), "m": 0.05}


def best_manoeuvre(first: Crane, second: Crane, noise: Mapping[str, float], channels: tuple[str, ...]) -> str:
    """Return in words the manoeuvre on which two cranes differ most, and by how much; it stays within both cranes'
    strokes.
    """
    best, text, lay = 0.0, "", first.layout
    beside = np.array(lay.sized(lay.coordinates, _BESIDE))
    for manoeuvre in manoeuvres(lay):
        for pose in (np.array(first.initial.pose) + side * beside for side in (-1.0, 1.0)):
            found = _difference(first, second, manoeuvre, pose, noise, channels)
            if found is not None and found[0] > best:
                best = found[0]
                parts = [shown(n, layout=lay) for n in lay.coordinates]
                at = (
                    f"{n} = {z * p.factor:.3g} {p.unit}" for n, z, p in zip(lay.coordinates, pose, parts, strict=True)
                )
                text = (
                    f"{manoeuvre.text}, starting at {', '.join(at)}: the explanations then differ by {found[0]:.1f} "
                    f"times the noise in {found[1]}"
                )
    return text or "none of the simulated manoeuvres separates them; another sensor would be needed"


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
        commands = manoeuvre.commands(time, len(crane.layout.cylinders))
        data = FitData("", time, _STEP, time, commands, np.full((len(time), 2), np.nan), ())
        try:
            engine, model = SemiRecursiveEngine(crane), model_of(crane, data)
            X = engine.simulate(engine.static_start(*pose), time, model.W, step=_STEP)
        except CraneError:
            return None  # the manoeuvre leaves the crane's limits
        outputs.append(model.measurement(channels).shown(X, time))
    apart = np.sqrt(np.mean((outputs[0] - outputs[1]) ** 2, axis=0)) / np.array([noise[c] for c in channels])
    worst = int(np.argmax(apart))
    return float(apart[worst]), channels[worst]
