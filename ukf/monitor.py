"""Which samples the filter may believe: spikes, jumps and frozen sensors are told from a wrong model.

A wrong model makes innovations grow gradually; rejecting them would cut the filter off from the truth. So a sample is
rejected only when its innovation *leaps* from one sample to the next by more than noise and physics allow; it stays
rejected until the innovation is back inside the gate. When most sensors leap together it is the machine (or a gap in
the recording) and not the sensors, and all are believed. A sensor is frozen when it repeats one value although its
noise should make that impossible.

A sensor that leapt may have been wrong before it and be right since. Once it has agreed with itself for as long as it
had been believed before (a second at most), it is *disputed*: the estimator then asks for a second opinion
(`second_opinion`). Where the belief rests on a few readings of the sensor only, because it has just been opened, or the
sensor had paused or leapt, twice as many that agree with each other need no second opinion: the sensor has *outvoted*
itself.

Innovations that are far too large for long, without a leap, may come from a wrong model, which is no reason to reject
anything, or from a state that has lost its way: then it is the *belief* that is in doubt (`Doubt`).
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from crane_exudyn.compiled import njit

USED, ABSENT, OUTLIER, FROZEN = 0, 1, 2, 3
#: fastest change that physics allows, by unit: rad/s, rad/s², Pa/s, m/s, m/s²
FASTEST = {"rad": 3.0, "rad/s": 100.0, "Pa": 2e8, "m": 1.0, "m/s": 30.0}
_FROZEN_AFTER = 25
#: two samples further apart than this, s, may differ by anything
_APART = 0.1
#: a rejected sensor is disputed after so many samples and so many seconds at the latest in which it agreed with itself
_AGREEING, _PATIENCE = 10, 1.0
#: readings up to which a belief is outvoted by its own sensor, and the fewest that can outvote it
_FEW, _VOTES = 4, 3
#: a belief is in doubt after so many seconds in which the sensors did not fit, and after so many at most once it has
#: often been
_LOST, _SELDOM = 0.1, 10.0
# columns of the memory
_VALUE, _CHANGE, _NOISE, _REPEATS, _LONGEST, _INNOVATION, _TIME, _SINCE, _BELIEVED, _PATIENT, _COUNT, _TAKEN = range(12)


@dataclass
class Monitor:
    """Memory of the checks, one entry a channel.

    `gate` is in standard deviations; infinite switches the gate off. A pressure at `floor` (Pa) or below is in vapour,
    and may repeat itself.
    """

    names: tuple[str, ...]
    units: tuple[str, ...]
    std: np.ndarray
    gate: float = 6.0
    floor: float = -np.inf
    memory: np.ndarray = field(init=False)
    fastest: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.std = np.asarray(self.std, float)
        self.fastest = np.array([FASTEST[unit] for unit in self.units])
        self._least = np.array([self.floor if unit == "Pa" else -np.inf for unit in self.units])
        # last value and change; mean size of what changes from change to change; repeats and their longest run; last
        # innovation and time; off and in agreement with itself since; believed since; seconds until it is disputed; how
        # many readings were off; how many the belief is taken from
        self.memory = np.full((len(self.names), 12), np.nan)
        self.memory[:, [_NOISE, _REPEATS, _LONGEST, _COUNT, _TAKEN]] = 0.0

    def begin(self, time: float, taken: Collection[str]) -> None:
        """Note that the belief was set at `time` from these channels: their next samples may not leap away from it."""
        for row, name in enumerate(self.names):
            self.memory[row, _BELIEVED] = time
            self.memory[row, _SINCE] = np.nan
            self.memory[row, _INNOVATION] = 0.0 if name in taken else np.nan
            self.memory[row, _TAKEN] = name in taken
            self.memory[row, _TIME] = time

    def disputed(self, time: float, flags: np.ndarray) -> int:
        """Return the row of the rejected channel that has agreed with itself long enough, the first to have leapt; else
        -1.
        """
        off = time - self.memory[:, _SINCE]
        ripe = (flags == OUTLIER) & (off >= self.memory[:, _PATIENT]) & (self.memory[:, _COUNT] >= _AGREEING)
        return int(np.argmax(np.where(ripe, off, -1.0))) if ripe.any() else -1

    def outvoted(self, flags: np.ndarray) -> int:
        """Return the row of a rejected channel that is at odds with the few readings of its own that were believed;
        else -1.
        """
        taken, against = self.memory[:, _TAKEN], self.memory[:, _COUNT]
        won = (flags == OUTLIER) & (taken <= _FEW) & (against >= np.maximum(2.0 * taken + 1.0, _VOTES))
        return int(np.argmax(won)) if won.any() else -1

    def since(self, row: int) -> float:
        """Return the time since which a rejected channel has agreed with itself."""
        return float(self.memory[row, _SINCE])

    def dismiss(self, time: float, row: int) -> None:
        """Note that a channel was heard in vain: it is disputed again when it has agreed with itself for twice as
        long.
        """
        self.memory[row, _PATIENT] = 2.0 * (time - self.memory[row, _SINCE])

    def believe(self, time: float, row: int | None, innovation: np.ndarray) -> None:
        """Note that a channel was right (None: no single one) and the belief wrong.

        The belief is replaced by one with these innovations (k,), NaN: none.
        """
        self.memory[:, _INNOVATION] = innovation
        if row is not None:
            self.memory[row, _SINCE], self.memory[row, _BELIEVED] = np.nan, time
            self.memory[row, _TAKEN] = self.memory[row, _COUNT]

    def judge(
        self, time: float, values: np.ndarray, innovation: np.ndarray, variance: np.ndarray
    ) -> tuple[np.ndarray, int]:
        """Return a flag (k,) for each channel, USED, ABSENT (NaN), OUTLIER or FROZEN, and how many are not believed.

        `variance` (k,) is the diagonal of the innovation covariance.
        """
        flags, bad = _judge(
            self.memory, time, values, innovation, variance, self.std, self.fastest, self._least, self.gate
        )
        return flags, int(bad)


@dataclass
class Doubt:
    """How long the sensors, all together, have been further from what the filter expects than `gate` allows one of them
    to be.

    A belief that was in doubt is so again only after twice as long, until the sensors have fitted for a while: a wrong
    model is not mended by beginning anew.
    """

    gate: float
    patience: float = _LOST
    since: float = np.nan
    fits_since: float = np.nan
    samples: int = 0

    def ripe(self, time: float, nis: float) -> bool:
        """Add a sample's normalised innovation squared, NaN for none; return whether the belief is in doubt now."""
        if nis > self.gate**2:
            self.since, self.fits_since = (self.since if self.samples else time), np.nan
            self.samples += 1
        elif not np.isnan(nis):
            self.fits_since, self.samples = (time if np.isnan(self.fits_since) else self.fits_since), 0
            if time - self.fits_since > _PATIENCE:
                self.patience = _LOST
        return self.samples >= _AGREEING and time - self.since >= self.patience

    def heard(self) -> None:
        """Note that the belief was weighed, with whatever result."""
        self.samples, self.patience = 0, min(2.0 * self.patience, _SELDOM)


def leaps(time: np.ndarray, values: np.ndarray, std: float, fastest: float, gate: float) -> np.ndarray:
    """Return the indices at which a series (n,) begins anew: the sample leaps from the one before by more than is
    possible.
    """
    apart = np.diff(time)
    possible = gate * np.sqrt(2.0) * std + fastest * apart
    return np.flatnonzero((np.abs(np.diff(values)) > possible) & (apart <= _APART)) + 1


@njit()
def _judge(memory, time, values, innovation, variance, std, fastest, least, gate):  # type: ignore[no-untyped-def]
    count = values.size
    flags, agrees = np.zeros(count, np.uint8), np.zeros(count, np.bool_)
    present, repeating, frozen, leaping, bad = 0, 0, 0, 0, 0
    for k in range(count):
        if np.isnan(values[k]):
            flags[k] = ABSENT
            continue
        row = memory[k]
        present += 1
        agrees[k] = _agrees(row, time, values[k], std[k], fastest[k], gate)
        if not np.isnan(row[_SINCE]) and not agrees[k]:
            row[_SINCE], row[_COUNT] = time, 0.0
        _note_change(row, values[k])
        repeating += row[_REPEATS] > 0
        stuck = _is_frozen(row, std[k], least[k])
        frozen += stuck
        if not stuck and np.isnan(row[_SINCE]) and _leaps(row, time, innovation[k], variance[k], fastest[k], gate):
            leaping += 1
            row[_PATIENT], row[_SINCE], row[_COUNT] = min(time - row[_BELIEVED], _PATIENCE), time, 0.0
    together = leaping > 1 and 2 * leaping > present
    for k in range(count):
        if flags[k] == ABSENT:
            continue
        row = memory[k]
        if not np.isnan(row[_SINCE]) and (together or abs(innovation[k]) <= gate * np.sqrt(variance[k])):
            row[_SINCE], row[_BELIEVED] = np.nan, time
        # where all repeat it may be a machine at rest, unless all have noise that forbids it
        if _is_frozen(row, std[k], least[k]) and (repeating < present or frozen == present):
            flags[k] = FROZEN
            row[_INNOVATION] = np.nan  # what it shows when it thaws is no leap
        elif not np.isnan(row[_SINCE]):
            flags[k] = OUTLIER
            row[_COUNT] += 1.0
        else:
            row[_INNOVATION] = innovation[k]
            row[_TAKEN] = row[_TAKEN] + 1.0 if agrees[k] and time - row[_TIME] <= _APART else 1.0
        row[_TIME] = time
        bad += flags[k] != USED
    return flags, bad


@njit()
def _agrees(row, time, value, std, fastest, gate):  # type: ignore[no-untyped-def]
    """Return whether a sensor may read this after what it read last."""
    return abs(value - row[_VALUE]) <= gate * np.sqrt(2.0) * std + fastest * (time - row[_TIME])


@njit()
def _note_change(row, value):  # type: ignore[no-untyped-def]
    change = value - row[_VALUE]
    row[_VALUE] = value
    if change == 0.0:
        row[_REPEATS] += 1.0
    elif change == change:  # not NaN: there was a value before
        if row[_REPEATS] < _FROZEN_AFTER:  # a run that was called frozen says nothing about the sensor's resolution
            row[_LONGEST] = max(row[_LONGEST], row[_REPEATS])
        row[_REPEATS] = 0.0
        bend = abs(change - row[_CHANGE]) if row[_CHANGE] == row[_CHANGE] else 0.0
        row[_NOISE] = bend if row[_NOISE] == 0.0 else 0.95 * row[_NOISE] + 0.05 * bend
        row[_CHANGE] = change


@njit()
def _leaps(row, time, innovation, variance, fastest, gate):  # type: ignore[no-untyped-def]
    apart = time - row[_TIME]
    if not apart <= _APART:  # the first sample, or the first after a gap
        return False
    return abs(innovation - row[_INNOVATION]) > gate * np.sqrt(2.0 * variance) + fastest * apart


@njit()
def _is_frozen(row, std, least):  # type: ignore[no-untyped-def]
    noisy = row[_NOISE] > 0.25 * std  # what changes from change to change is noise, so equal values are no accident
    return noisy and row[_VALUE] > least and row[_REPEATS] >= max(_FROZEN_AFTER, 4.0 * row[_LONGEST])
