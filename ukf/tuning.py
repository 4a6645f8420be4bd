"""Noise covariances from the data: those under which the innovations are most likely.

The filter's innovations are independent normal variables if its covariances are right, so their log-likelihood,
-½ Σ (νᵀ S⁻¹ ν + log det S), measures how right they are. It is maximised over the logarithms of a few densities by a
pattern search: first all together by powers of ten, then one by one by half and quarter powers. Averaging over many
samples makes the measure sharp, and it charges for boasting (small S) as well as for shyness.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane

from .estimator import Estimator, sensor_std
from .noise import ProcessNoise
from .side_by_side import SideBySide
from .signals import Signals

#: ranges in which the logarithms (base 10) of accelerations and pressures are searched
_ACCELERATIONS, _PRESSURES = (-8.0, 3.0), (2.0, 14.0)
_FINEST = 0.25
#: `scale` goes so many powers of ten up and down at most; below that the noise does no longer matter on a right model
_UP, _DOWN = 6, 3


@dataclass(frozen=True)
class Tuned:
    """The most likely noise: `noise`, the sensors' `std`, the log-likelihood per sample before and after, and the
    cylinders' names.
    """

    noise: ProcessNoise
    std: dict[str, float]
    before: float
    after: float
    evaluations: int
    cylinders: tuple[str, ...]

    def __repr__(self) -> str:
        accelerations = ", ".join(f"{a:.2g}" for a in self.noise.acceleration)
        pressures = ", ".join(f"{n} {p:.2g}" for n, p in zip(self.cylinders, self.noise.pressure[::2], strict=True))
        return (
            f"<Tuned: acceleration {accelerations} SI; pressure {pressures} Pa²/s; "
            f"log-likelihood per sample {self.before:.4g} -> {self.after:.4g} in {self.evaluations} runs>"
        )


def tune(
    crane: Crane | Sequence[Crane],
    recording: Any,
    sensors: Mapping[str, float],
    *,
    engine: Any = "semi-recursive",
    start: ProcessNoise | None = None,
    augment: tuple[Any, ...] = (),
    seconds: float = 10.0,
    max_step: float = 1e-3,
    evaluations: int = 60,
    progress: Callable[[float], None] | None = None,
) -> Tuned:
    """Return the noise under which the innovations of a recording are most likely.

    Args:
        crane: the model, or several that run side by side.
        recording: a Recording or Signals.
        sensors: channels with noise standard deviations (SI), kept as they are.
        start: noise to begin with.
        augment: quantities that are estimated along with the state.
        seconds: how much of the recording is used, around its busiest part.
        max_step: longest step of the engine, s, as in the filter that the noise is for: noise covers its error too.
        evaluations: most runs of the filter.
        progress: called with the fraction done.
    """
    cranes = _listed(crane)
    lay, std = cranes[0].layout, sensor_std(cranes[0], sensors)
    cost, count = _cost(cranes, recording, std, engine, augment, seconds, max_step, evaluations, progress)
    first = logs_of(start or ProcessNoise.of(lay))
    before = cost(first)
    logs, best = _climb(cost, first, before)
    logs, best = descend(
        cost, logs, best, limits_of(logs), finest=_FINEST, gain=1e-4, enough=lambda: count[0] >= evaluations
    )
    return Tuned(noise_of(logs), std, -before, -best, count[0], lay.cylinders)


def descend(
    cost: Callable[[np.ndarray], float],
    logs: np.ndarray,
    best: float,
    limits: Sequence[tuple[float, float]],
    *,
    finest: float,
    gain: float,
    step: float = 1.0,
    enough: Callable[[], bool] = lambda: False,
) -> tuple[np.ndarray, float]:
    """Return the logarithms that lower a cost, one after the other, and that cost; steps are halved down to `finest`.

    Args:
        cost: of logarithms (n,).
        logs, best: where to begin, and the cost there.
        limits: range of each logarithm.
        gain: what a round must gain for another one with the same step.
        step: the first one.
        enough: whether to end before the time.
    """
    while step >= finest and not enough():
        old = best
        for i in range(logs.size):
            logs, best = _along(cost, logs, best, i, step, limits[i])
            if enough():
                break
        if best >= old - gain:
            step *= 0.5
    return logs, best


def _along(
    cost: Callable[[np.ndarray], float],
    logs: np.ndarray,
    best: float,
    i: int,
    step: float,
    limits: tuple[float, float],
) -> tuple[np.ndarray, float]:
    """Return the better of two neighbours along one logarithm, gone on with while it helps, or the point itself."""
    for direction in (step, -step):
        moved = False
        while True:
            trial = logs.copy()
            trial[i] = np.clip(trial[i] + direction, *limits)
            value = cost(trial) if trial[i] != logs[i] else best
            if value >= best:
                break
            logs, best, moved = trial, value, True
        if moved:
            break
    return logs, best


def _climb(cost: Callable[[np.ndarray], float], first: np.ndarray, before: float) -> tuple[np.ndarray, float]:
    """Return all logarithms moved together by whole powers of ten, up or down, for as long as that helps, and the
    cost.
    """
    best, chosen = before, first
    for rungs in (range(1, _UP + 1), range(-1, -_DOWN - 1, -1)):
        for rung in rungs:
            value = cost(first + rung)
            if value >= best:
                break
            best, chosen = value, first + rung
        if chosen is not first:
            break
    return chosen, best


def scale(
    crane: Crane | Sequence[Crane],
    recording: Any,
    sensors: Mapping[str, float],
    *,
    engine: Any = "semi-recursive",
    augment: tuple[Any, ...] = (),
    seconds: float = 10.0,
    max_step: float = 1e-3,
    progress: Callable[[float], None] | None = None,
) -> Tuned:
    """Return the default noise times the power of ten that makes the innovations most likely, from 10⁻³ to 10⁶.

    A few short runs: enough that a filter with a wrong model follows its sensors, and that one with a right model does
    not expect more of its innovations than there is. `tune` searches further.
    """
    cranes = _listed(crane)
    lay, std = cranes[0].layout, sensor_std(cranes[0], sensors)
    cost, count = _cost(cranes, recording, std, engine, augment, seconds, max_step, _UP, progress)
    first = logs_of(ProcessNoise.of(lay))
    before = cost(first)
    chosen, best = _climb(cost, first, before)
    return Tuned(noise_of(chosen), std, -before, -best, count[0], lay.cylinders)


def _listed(crane: Crane | Sequence[Crane]) -> list[Crane]:
    return [crane] if isinstance(crane, Crane) else list(crane)


def _cost(
    cranes: Sequence[Crane],
    recording: Any,
    std: dict[str, float],
    engine: Any,
    augment: tuple[Any, ...],
    seconds: float,
    max_step: float,
    evaluations: int,
    progress: Callable[[float], None] | None,
) -> tuple[Callable[[np.ndarray], float], list[int]]:
    """Return minus the log-likelihood a sample as a function of the noise's logarithms, and the count of its calls."""
    signals = recording if isinstance(recording, Signals) else Signals.of(recording, cranes[0])
    piece = busiest(signals, seconds)
    count = [0]

    def cost(logs: np.ndarray) -> float:
        count[0] += 1
        if progress is not None:
            progress(min(1.0, count[0] / evaluations))
        filters = [
            Estimator(crane, engine, std, noise_of(logs), augment=augment, max_step=max_step) for crane in cranes
        ]
        estimate = (SideBySide({str(k): f for k, f in enumerate(filters)}) if filters[1:] else filters[0]).run(piece)
        read = float(np.isfinite(estimate.measured[1:]).sum())
        return -estimate.log_likelihood / max(read, 1.0) + 10.0 * estimate.failures

    return cost, count


def noise_of(logs: np.ndarray) -> ProcessNoise:
    """Return the noise of [log10 acceleration of each coordinate, log10 pressure of each cylinder]: as many of one as
    of the other.
    """
    densities, m = 10.0 ** np.asarray(logs, float), len(logs) // 2
    return ProcessNoise(tuple(densities[:m].tolist()), tuple(np.repeat(densities[m:], 2).tolist()))


def logs_of(noise: ProcessNoise) -> np.ndarray:
    """Return [log10 acceleration of each coordinate, log10 pressure of each cylinder] of a noise."""
    return np.log10([*noise.acceleration, *noise.pressure[::2]])


def limits_of(logs: np.ndarray) -> list[tuple[float, float]]:
    """Return the range in which each logarithm of a noise is searched."""
    return [*[_ACCELERATIONS] * (len(logs) // 2), *[_PRESSURES] * (len(logs) // 2)]


def busiest(signals: Signals, seconds: float) -> Signals:
    """Return the stretch of this length in which the commands change most; all of it if it is not longer."""
    time = signals.command_time
    if time[-1] - time[0] <= seconds:
        return signals
    change = np.concatenate([[0.0], np.abs(np.diff(signals.commands, axis=0)).sum(axis=1)])
    total = np.cumsum(change)
    ends = np.searchsorted(time, time + seconds, side="right") - 1
    whole = time + seconds <= time[-1]
    gained = np.where(whole, total[ends] - total, -1.0)
    begin = float(time[int(np.argmax(gained))]) - 0.1 * seconds
    return cut(signals, max(begin, float(time[0])), seconds)


def cut(signals: Signals, begin: float, seconds: float) -> Signals:
    """Return the signals between `begin` and `begin + seconds`; one command sample more on either side."""
    time = signals.command_time
    i = max(int(np.searchsorted(time, begin, side="right")) - 1, 0)
    j = min(int(np.searchsorted(time, begin + seconds)) + 1, time.size)

    def part(series: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
        t, y = series
        inside = (t >= begin) & (t <= begin + seconds)
        return t[inside], y[inside]

    sensors = {n: part(s) for n, s in signals.sensors.items()}
    sensors = {n: s for n, s in sensors.items() if s[0].size}
    return Signals(time[i:j], signals.commands[i:j], sensors, dict(signals.supply), signals.name, signals.notes)
