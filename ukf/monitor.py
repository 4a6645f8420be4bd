"""Which samples the filter may believe: spikes, jumps and frozen sensors are told from a wrong model.

A wrong model makes innovations grow gradually; rejecting them would cut the filter off from the truth. So a sample is
rejected only when its innovation *leaps* from one sample to the next by more than noise and physics allow; it stays
rejected until the innovation is back inside the gate. When most sensors leap together it is the machine (or a gap in the
recording) and not the sensors, and all are believed. A sensor is frozen when it repeats one value although its
noise should make that impossible.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from crane_exudyn.compiled import njit

USED, ABSENT, OUTLIER, FROZEN = 0, 1, 2, 3
#: fastest change that physics allows, by the first letter of the channel: rad/s, rad/s², Pa/s, m/s
FASTEST = {"z": 3.0, "d": 100.0, "p": 2e8, "s": 1.0}
_FROZEN_AFTER = 25
_MEMORY = 0.5  # s, of the running means


@dataclass
class Monitor:
    """Memory of the checks, one entry a channel. `gate` is in standard deviations; infinite switches the gate off."""

    names: tuple[str, ...]
    std: np.ndarray
    gate: float = 6.0
    memory: np.ndarray = field(init=False)
    fastest: np.ndarray = field(init=False)

    def __post_init__(self) -> None:
        self.std = np.asarray(self.std, float)
        self.fastest = np.array([FASTEST[n[0]] for n in self.names])
        # columns: last value, last innovation, last time, repeats, longest run, mean |change|, off since, mean ν²/S
        self.memory = np.zeros((len(self.names), 8))
        self.memory[:, [0, 1, 2, 6]] = np.nan
        self.memory[:, 7] = 1.0

    def judge(
        self, time: float, values: np.ndarray, innovation: np.ndarray, variance: np.ndarray
    ) -> tuple[np.ndarray, int]:
        """Return a flag (k,) for each channel, USED, ABSENT (NaN), OUTLIER or FROZEN, and how many are not believed.

        `variance` (k,) is the diagonal of the innovation covariance.
        """
        flags, bad = _judge(self.memory, time, values, innovation, variance, self.std, self.fastest, self.gate)
        return flags, int(bad)


@njit()
def _judge(memory, time, values, innovation, variance, std, fastest, gate):  # type: ignore[no-untyped-def]
    count = values.size
    flags = np.zeros(count, np.uint8)
    present, repeating, leaping, bad = 0, 0, 0, 0
    for k in range(count):
        if np.isnan(values[k]):
            flags[k] = ABSENT
            continue
        present += 1
        _note_change(memory[k], values[k])
        if memory[k, 3] > 0:
            repeating += 1
        frozen = _is_frozen(memory[k], std[k])
        if (
            not frozen
            and np.isnan(memory[k, 6])
            and _leaps(memory[k], time, innovation[k], variance[k], fastest[k], gate)
        ):
            leaping += 1
            memory[k, 6] = time
    together = leaping > 1 and 2 * leaping > present
    for k in range(count):
        if flags[k] == ABSENT:
            continue
        if together or abs(innovation[k]) <= gate * np.sqrt(variance[k]) or _lost(memory, k, time):
            memory[k, 6] = np.nan
        if _is_frozen(memory[k], std[k]) and repeating < present:
            flags[k] = FROZEN
            memory[k, 1] = np.nan  # what it shows when it thaws is no leap
        elif not np.isnan(memory[k, 6]):
            flags[k] = OUTLIER
        else:
            _note_used(memory[k], time, innovation[k], variance[k])
        memory[k, 2] = time
        bad += flags[k] != USED
    return flags, bad


@njit()
def _note_change(row, value):  # type: ignore[no-untyped-def]
    change = abs(value - row[0])
    row[0] = value
    if change == 0.0:
        row[3] += 1.0
    elif change > 0.0:  # not NaN: there was a value before
        if row[3] < _FROZEN_AFTER:  # a run that was called frozen says nothing about the sensor's resolution
            row[4] = max(row[4], row[3])
        row[3] = 0.0
        row[5] = change if row[5] == 0.0 else 0.95 * row[5] + 0.05 * change


@njit()
def _leaps(row, time, innovation, variance, fastest, gate):  # type: ignore[no-untyped-def]
    apart = time - row[2]
    if not apart <= 0.1:  # the first sample, or the first after a gap
        return False
    return abs(innovation - row[1]) > gate * np.sqrt(2.0 * variance) + fastest * apart


@njit()
def _lost(memory, k, time):  # type: ignore[no-untyped-def]
    """Whether a channel has been off for a second while the believed ones do not fit either: then it is the filter."""
    if not time - memory[k, 6] > 1.0:
        return False
    worst = 0.0
    for j in range(memory.shape[0]):
        if j != k and np.isnan(memory[j, 6]):
            worst = max(worst, memory[j, 7])
    return worst > 9.0


@njit()
def _is_frozen(row, std):  # type: ignore[no-untyped-def]
    noisy = row[5] > 0.25 * std  # its changes show the noise, so equal values are no accident
    return noisy and row[3] >= max(_FROZEN_AFTER, 4.0 * row[4])


@njit()
def _note_used(row, time, innovation, variance):  # type: ignore[no-untyped-def]
    apart = time - row[2]
    share = 1.0 - np.exp(-apart / _MEMORY) if apart > 0.0 else 0.0
    row[1] = innovation
    row[7] += share * (innovation * innovation / variance - row[7])
