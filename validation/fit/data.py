"""What a recording offers to a fit: samples on a uniform simulation grid, in units of their noise."""

from __future__ import annotations

import math
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError, nearest
from crane_exudyn.recording import Channel, Recording
from crane_exudyn.signals import NO_SENSOR, noise_std, noise_uncertainty, of_mean

_STEPS = (1e-3, 2e-3, 2.5e-3, 5e-3)
#: longest step of runs that are held against the recording closely, s. A ring of 7 Hz loses a thousandth of its
#: frequency to a step of 2.5 ms: nothing in a quarter of a second, but not in 25 s
FINE = 1e-3
#: longest step of all other runs, s, and of those that derivatives are taken of: that of a recording at 200 Hz. What is
#: left is computed by a run in the data's own steps, so that the minimum is theirs; derivatives but for some hundredths
#: lead to it as well
COARSE = 5e-3
#: local error of a step, in units of the engine's; beyond it a step is halved. In short windows 0.06 bar and 2e-7 rad,
#: a fifth of what good sensors show; in long ones, where it adds up, the engine's own: in 25 s a valve that swings is
#: off by ten noise units with the other
ACCURACY, ACCURATE = 20.0, 1.0
#: seconds after a gap in the commands until the spools have forgotten it, and the shortest stretch between two gaps
#: that is worth a start of its own
_FORGOTTEN, _SHORTEST = 0.25, 0.5


@dataclass(frozen=True)
class Samples:
    """One channel's samples: where they lie on the grid (index and fraction of a step), values in SI, noise std in
    SI, and its relative standard error where it is estimated.

    around: of each that is a mean of several, when these were taken, in steps from where it lies (n, block).
    """

    channel: str
    index: np.ndarray
    fraction: np.ndarray
    values: np.ndarray
    noise: float
    unsure: float = 0.0
    around: np.ndarray | None = None

    @property
    def averaged(self) -> int:
        """How many samples of the recording each of these is the mean of."""
        return 1 if self.around is None else self.around.shape[1]

    def taken(self, grid: np.ndarray) -> np.ndarray:
        """Return what `grid` (N, …) on the grid is at the samples (n, …), linear between grid points."""
        before = grid[self.index]
        share = self.fraction.reshape(-1, *[1] * (grid.ndim - 1))
        return np.asarray(before + share * (grid[self.index + 1] - before))

    def residuals(self, grid: np.ndarray) -> np.ndarray:
        """Return measured minus shown (n,), in noise units, where `grid` (N,) is shown on the grid.

        What was averaged of the recording is averaged of the run: in a corner (a chamber that begins to boil) the mean
        of some milliseconds lies many noise units from what is shown in their middle.
        """
        return np.asarray((self.values - self._averaged(grid)) / self.noise)

    def picked(self, rows: np.ndarray | slice, start: int = 0) -> Samples:
        """Return some of the samples, on a grid that begins at grid point `start` of this one."""
        return replace(
            self, index=self.index[rows] - start, fraction=self.fraction[rows], values=self.values[rows],
            around=None if self.around is None else self.around[rows],
        )  # fmt: skip

    def _averaged(self, grid: np.ndarray) -> np.ndarray:
        if self.around is None:
            return self.taken(grid)
        place = (self.index + self.fraction)[:, None] + self.around
        before = np.clip(place.astype(np.int64), 0, len(grid) - 2)
        return np.asarray((grid[before] + (place - before) * (grid[before + 1] - grid[before])).mean(axis=1))


@dataclass(frozen=True)
class FitData:
    """A recording prepared for simulation with a fixed step.

    Attributes:
        time: (N,) uniform grid in s, from the first to the last sample.
        step: its step in s.
        command_time, commands: (n,) s and (n, valves), linear between, on their own clock.
        supply: (N, 2) measured pump and tank pressure in Pa, NaN where not recorded.
        samples: one entry a measured channel; none where the commands are not known.
        accuracy: local error of a step of its runs, in units of the engine's.
        moments: (N, coordinates) in N m (N where a joint slides), what objects of one's own put on the joints; None
            without any.
        own: names of parameters that are this recording's own, other than the machine's elsewhere.
        blind: spans (from, to) in s in which a command was not recorded, or is still felt; the model is not run through
            them.
    """

    name: str
    time: np.ndarray
    step: float
    command_time: np.ndarray
    commands: np.ndarray
    supply: np.ndarray
    samples: tuple[Samples, ...]
    blind: tuple[tuple[float, float], ...] = ()
    moments: np.ndarray | None = None
    accuracy: float = ACCURACY
    own: tuple[str, ...] = ()

    @cached_property
    def stretches(self) -> list[tuple[int, int]]:
        """Return first and last grid point of each stretch in which the commands are known; one, where they always
        are.
        """
        start, end = float(self.time[0]), float(self.time[-1])
        bounds = [start, *(min(max(t, start), end) for span in self.blind for t in span), end]
        known = [(a, b) for a, b in zip(bounds[::2], bounds[1::2], strict=True) if b - a > 1e-3 * self.step]
        return [
            (int(np.floor((a - start) / self.step + 1e-6)), int(np.ceil((b - start) / self.step - 1e-6)))
            for a, b in known
        ]

    @property
    def parts(self) -> tuple[FitData, ...]:
        """The recordings: this one."""
        return (self,)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the measured channels."""
        return tuple(s.channel for s in self.samples)

    @cached_property
    def count(self) -> int:
        """Number of samples over all channels."""
        return sum(len(s.values) for s in self.samples)

    @property
    def interval(self) -> float:
        """The longest usual time between two samples of a channel, s."""
        gaps = [float(np.median(np.diff(s.index + s.fraction))) for s in self.samples if len(s.values) > 1]
        return self.step * max(gaps, default=1.0)

    @classmethod
    def of(cls, recording: Recording, crane: Crane, *, step: float | None = None, rate: float = 200.0) -> FitData:
        """Return the data of a recording, averaged down to at most `rate` samples a second and channel.

        The commands are those that the crane's valve calibration makes of the recording. Noise standard deviations are
        the crane file's or, where it names none, estimated from the data; a channel free of noise, as of a simulation,
        is given some. A sensor that shows one value throughout, of which no noise is stated, is left out.

        Raises:
            CraneError: commands or sensors are missing, or no stretch with known commands is long enough.
        """
        recording = usable(recording, crane.sensors).with_noise(crane.sensors)
        times, commands = recording.commands(crane)
        sensors = list(recording.sensors)
        if not sensors:
            raise CraneError(
                f"{recording.name}: no sensor channel. At least one of {', '.join(crane.layout.sensors)} is needed."
            )
        start = min(recording.channels[c].time[0] for c in sensors)
        end = max(recording.channels[c].time[-1] for c in sensors)
        step = step or grid_step(np.median(np.diff(recording.channels[sensors[0]].time)))
        grid = start + step * np.arange(int(np.floor((end - start) / step + 1e-6)) + 2)
        blind = _blind(recording, float(start), float(end))
        each = (_samples(c, recording, crane.sensors.get(c), grid, rate) for c in sensors)
        samples = _sharing(_without(blind, s, grid) for s in each)
        return cls(recording.name, grid, step, times, commands, recording.supply(grid), samples, blind)

    @classmethod
    def whole(cls, recording: Recording, crane: Crane) -> FitData:
        """Return the data of a recording with every sample, for accurate runs from its beginning to its end.

        Raises:
            CraneError: as `of`.
        """
        return replace(cls.of(recording, crane, rate=math.inf, step=FINE), accuracy=ACCURATE)

    def shifted(self, late: float) -> FitData:
        """Return the same data with commands that come `late` seconds after their stamps."""
        if late == 0.0:
            return self
        return replace(self, command_time=self.command_time + late)  # the blind spans are wider than any lateness

    def with_step(self, step: float) -> FitData:
        """Return the same data on a grid of another step (s)."""
        if step == self.step:
            return self
        end = self.time[-1] - 1e-9
        grid = self.time[0] + step * np.arange(int(np.ceil((end - self.time[0]) / step)) + 1)
        samples = _sharing(_placed(s, *self._taken(s), grid) for s in self.samples)
        supply = np.column_stack([np.interp(grid, self.time, c) for c in self.supply.T])
        moments = self.moments
        if moments is not None:
            moments = np.column_stack([np.interp(grid, self.time, m) for m in moments.T])
        return replace(self, time=grid, step=step, supply=supply, samples=samples, moments=moments)

    def times(self, samples: Samples) -> np.ndarray:
        """Return when the samples of one of its channels were taken, s."""
        return np.asarray(self.time[samples.index] + samples.fraction * self.step)

    def _taken(self, samples: Samples) -> tuple[np.ndarray, np.ndarray | None]:
        """Return the same, and when each of those was whose mean they are, in s from there."""
        return self.times(samples), None if samples.around is None else samples.around * self.step

    def stepped(self, longest: float, accuracy: float = ACCURACY) -> FitData:
        """Return the same data on a grid with a step (s) of at most `longest` that suits its sampling."""
        found = self.with_step(grid_step(self.interval, longest))
        return found if found.accuracy == accuracy else replace(found, accuracy=accuracy)

    def part(self, start: int, end: int) -> FitData:
        """Return the stretch of grid points start … end (inclusive)."""
        kept = []
        for s in self.samples:
            inside = slice(*np.searchsorted(s.index, [start, end]))  # views: windows of ten minutes are thousands
            own = s.picked(inside, start)
            if own.around is not None:
                own = replace(own, around=_within(own.around, own.index + own.fraction, end - start))
            kept.append(own)
        cut = slice(start, end + 1)
        moments = None if self.moments is None else self.moments[cut]
        return replace(self, time=self.time[cut], supply=self.supply[cut], samples=tuple(kept), moments=moments)


@dataclass(frozen=True)
class Joint:
    """Several recordings of one machine that are fitted together: start and clocks are each one's own, and what `own`
    names.
    """

    parts: tuple[FitData, ...]
    own: tuple[str, ...] = ()

    @property
    def name(self) -> str:
        """All names."""
        return ", ".join(p.name for p in self.parts)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of what any of them measured."""
        return tuple(dict.fromkeys(c for p in self.parts for c in p.channels))

    @property
    def time(self) -> np.ndarray:
        """From the first to the last instant of any of them, s."""
        return np.array([min(p.time[0] for p in self.parts), max(p.time[-1] for p in self.parts)])

    def stepped(self, longest: float, accuracy: float = ACCURACY) -> Joint:
        """Return the same recordings, each on a grid that suits its sampling."""
        return replace(self, parts=tuple(p.stepped(longest, accuracy) for p in self.parts))


Data = FitData | Joint


def usable(recording: Recording, stated: Container[str] = ()) -> Recording:
    """Return the recording without sensors that show one value throughout: they have no noise to be measured against,
    unless theirs is `stated`.
    """
    dead = constant_sensors(recording, stated)
    alive = [n for n in recording.channels if n not in dead]
    return recording if len(alive) == len(recording.channels) else recording.select(alive)


def constant_sensors(recording: Recording, stated: Container[str] = ()) -> list[str]:
    """Return the sensors that show one value throughout, without those whose noise is `stated`."""
    return [name for name in recording.sensors if name not in stated and is_constant(recording[name])]


def is_constant(channel: Channel) -> bool:
    """Whether a channel shows one value throughout."""
    return bool(np.ptp(channel.values) <= 1e-9 * max(float(np.max(np.abs(channel.values))), 1e-9))


def noise_of(recording: Recording, crane: Crane) -> dict[str, float]:
    """Return the noise (SI) of each sensor that `FitData.of` finds in a recording, or the crane file states."""
    noisy = usable(recording, crane.sensors).with_noise(crane.sensors)
    return {c: crane.sensors.get(c) or float(noise_std(noisy[c].values)) for c in noisy.sensors}


def data_of(recordings: Sequence[Recording], crane: Crane, own: Sequence[str] = ()) -> Data:
    """Return the data of one recording, or of several that are fitted together, of which parameters `own` differ from
    one to another.

    Raises:
        CraneError: as `FitData.of`, or one of `own` is no parameter of the crane that is uncertain.
    """
    own = known_parameters(crane, own)
    parts = tuple(FitData.of(r, crane) for r in recordings)
    return replace(parts[0], own=own) if len(parts) == 1 else Joint(parts, own)


def known_parameters(crane: Crane, names: Sequence[str]) -> tuple[str, ...]:
    """Return names of nominal parameters whose uncertainty the crane states.

    Raises:
        CraneError: one of them is none.
    """
    known = [n for n in crane.values if n in crane.uncertainty]
    for name in names:
        if name not in known:
            raise CraneError(
                f"--per-recording {name!r}: {crane.name} states no uncertainty of it.{nearest(name, known)}"
            )
    return tuple(names)


def _blind(recording: Recording, start: float, end: float) -> tuple[tuple[float, float], ...]:
    """Return the spans from `start` to `end` in which a command is unknown or still felt, in order, none touching
    another.
    """
    spans = sorted((float(a), float(b) + _FORGOTTEN) for g in recording.unknown_commands().values() for a, b in g)
    found: list[tuple[float, float]] = []
    for a, b in spans:
        before = found[-1][1] if found else start
        if a - before < _SHORTEST:
            a = found.pop()[0] if found else start
        found.append((a, max(b, before)))
    if found and end - found[-1][1] < _SHORTEST:
        found[-1] = (found[-1][0], end)
    if found and found[0] == (start, end):
        raise CraneError(
            f"{recording.source or recording.name}: nowhere are the commands known for {_SHORTEST:g} s on end. Record "
            "the commands with the sensors."
        )
    return tuple(found)


def _without(blind: tuple[tuple[float, float], ...], samples: Samples, grid: np.ndarray) -> Samples:
    """Return the samples that do not lie in blind spans."""
    if not blind:
        return samples
    time = grid[samples.index] + samples.fraction * (grid[1] - grid[0])
    seen = ~np.any([(time >= a - 1e-9) & (time <= b + 1e-9) for a, b in blind], axis=0)
    if not seen.any():
        raise CraneError(f"Channel {samples.channel}: no sample where the commands are known. Leave it out.")
    return samples.picked(seen)


def grid_step(interval: float, longest: float = COARSE) -> float:
    """Return a simulation step (s) of at most `longest` that divides the sampling interval where it can."""
    for step in sorted(_STEPS, reverse=True):
        if step <= longest and abs(interval / step - round(interval / step)) < 1e-6:
            return step
    return longest if interval > longest else min(_STEPS)


def _samples(name: str, recording: Recording, stated: float | None, grid: np.ndarray, rate: float) -> Samples:
    time, values = recording[name].time, recording[name].values
    noise, unsure = (stated, 0.0) if stated else (noise_std(values), noise_uncertainty(values))
    if not noise or not np.isfinite(noise):
        raise CraneError(
            f"Channel {name}: its noise cannot be estimated from the data. Give sensors.{name} in the crane file."
        )
    noise = max(noise, NO_SENSOR * float(np.ptp(values)))  # with less, equations lose all their digits
    interval = float(np.median(np.diff(time))) if len(time) > 1 else math.inf
    block = max(1, int(np.floor(1.0 / (rate * interval) + 1e-6)))
    around = None
    if block > 1:
        gaps = np.flatnonzero(np.diff(time) > block * interval) + 1  # a mean over one is of neither side
        runs = np.split(np.arange(len(time)), gaps)
        rows = np.concatenate([run[: len(run) // block * block] for run in runs]).reshape(-1, block)
        each, values = time[rows], values[rows].mean(axis=1)
        time = each.mean(axis=1)
        around = each - time[:, None]
        noise *= of_mean(math.exp(-interval / recording.memory.get(name, 1e-9)), block)
    return _placed(Samples(name, np.empty(0, int), np.empty(0), values, float(noise), unsure), time, around, grid)


def _sharing(samples: Iterable[Samples]) -> tuple[Samples, ...]:
    """Return the samples, those that lie at the same places with the same arrays of places: ten minutes of them are 10
    MB a channel.
    """
    found: list[Samples] = []
    for s in samples:
        like = next((f for f in found if _alike(f, s)), s)
        found.append(replace(s, index=like.index, fraction=like.fraction, around=like.around))
    return tuple(found)


def _alike(a: Samples, b: Samples) -> bool:
    """Whether two channels were sampled at the same instants."""
    if (a.around is None) != (b.around is None):
        return False
    pairs = [(a.index, b.index), (a.fraction, b.fraction)]
    if a.around is not None and b.around is not None:
        pairs.append((a.around, b.around))
    return all(np.array_equal(one, other) for one, other in pairs)


def _placed(samples: Samples, time: np.ndarray, around: np.ndarray | None, grid: np.ndarray) -> Samples:
    """Return the samples, taken at `time` (n,) and s `around` it, with their places on a grid."""
    step = grid[1] - grid[0]
    place = (time - grid[0]) / step
    index = np.minimum(np.floor(place + 1e-6).astype(np.int64), len(grid) - 2)
    if around is not None:
        around = _within(around / step, place, len(grid) - 1)
    return replace(samples, index=index, fraction=np.clip(place - index, 0.0, 1.0), around=around)


def _within(around: np.ndarray, place: np.ndarray, last: int) -> np.ndarray:
    """Return when blocks (n, block) were taken around their places (n,), those that reach beyond the grid's first or
    last point drawn together until they do not.
    """
    room = np.minimum(place + 1e-9, last - place + 1e-9) / np.maximum(np.abs(around).max(axis=1), 1e-12)
    return around if (room >= 1.0).all() else around * np.clip(room, 0.0, 1.0)[:, None]
