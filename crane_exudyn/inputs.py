"""From commands to spool positions: delay, backlash and the spool's lag (16); and the paper's working cycle.

Spool positions depend on the commands alone, so they are computed once per time grid. ::

    command -> command hooks -> delay T -> play of width b -> lag tau (16) -> spool position U
"""

from __future__ import annotations

from collections import deque

import numpy as np

from .compiled import njit
from .crane import Crane
from .effects import hooks
from .errors import CraneError
from .laws.spool import spool_step
from .parameters import CYLINDERS, N_VALVE, VALVE


@njit
def _apply_command_hooks(E, commands, out):
    """Fill out (n, 2) with the commands after the effects that act on them."""
    for k in range(commands.shape[0]):
        for c in range(2):
            out[k, c] = hooks.command(E, c, commands[k, c])


@njit
def play(follower: float, leader: float, width: float) -> float:
    """Return where a follower with play stands: pushed along when the leader is more than width/2 away."""
    half = 0.5 * width
    return min(max(follower, leader - half), leader + half)


@njit
def _play_step(spool: float, held: float, start: float, end: float, width: float, dt: float, tau: float) -> tuple:
    """Return (spool, held) after dt for a leader that is linear from start to end, behind a play and the lag (16).

    Within the step the play holds until the leader has crossed it, then follows; both parts are linear.
    """
    after = play(held, end, width)
    if dt <= 0.0 or after == held or width <= 0.0:
        return spool_step(spool, held if width > 0.0 else start, after if width > 0.0 else end, dt, tau), after
    first = play(held, start, width)  # differs from held only if the leader jumped
    waiting = 1.0 - abs(after - first) / abs(end - start) if end != start else 0.0
    spool = spool_step(spool, first, first, waiting * dt, tau)
    return spool_step(spool, first, after, (1.0 - waiting) * dt, tau), after


@njit
def _delayed(time, values, t):
    """Return the commands at t, linear between samples; before the first sample they are the first."""
    return np.interp(t, time, values)


class SpoolPath:
    """Spool positions that follow commands, exact for commands that are linear between samples.

    Args:
        crane: gives the spools' time constants and the effects command_delay and spool_hysteresis.

    The spools start at rest where the first command (after delay and backlash) holds them.
    """

    def __init__(self, crane: Crane) -> None:
        P, self._E = crane.parameter_vector(), crane.effect_vector()
        self._name = crane.name
        self._tau = [float(P[VALVE + N_VALVE * c + 1]) for c in range(len(CYLINDERS))]
        self._delay = [float(hooks.delay(self._E, c)) for c in range(len(CYLINDERS))]
        self._play = [float(hooks.backlash(self._E, c)) for c in range(len(CYLINDERS))]
        self._past: deque[tuple[float, np.ndarray]] = deque()
        self._spool = np.zeros(2)
        self._held = np.zeros(2)
        self._last = np.zeros(2)

    def run(self, time: np.ndarray, commands: np.ndarray, valve: int | None = None) -> np.ndarray:
        """Return spool positions (n, 2) at `time` for a whole record; leaves the live state of `step` alone.

        Args:
            time: (n,) increasing, in s.
            commands: (n, 2) in [-1, 1], linear between samples.
            valve: the only one to be computed (the other stays at 0); both by default.

        Raises:
            CraneError: wrong shapes, commands outside [-1, 1] or missing, or time that does not increase.
        """
        t, u = np.asarray(time, dtype=float), np.asarray(commands, dtype=float)
        if t.ndim != 1 or u.shape != (t.size, 2):
            raise CraneError(
                f"spool path: time {t.shape} and commands {u.shape} do not match; expected (n,) and (n, 2)."
            )
        self._check(t, u)
        changed = np.empty_like(u)
        _apply_command_hooks(self._E, np.ascontiguousarray(u), changed)
        out = np.zeros_like(changed)
        for c in range(2) if valve is None else (valve,):
            out[:, c] = _run_one(t, np.ascontiguousarray(changed[:, c]), self._delay[c], self._play[c], self._tau[c])
        return out

    def step(self, time: float, command: np.ndarray) -> np.ndarray:
        """Return the spool positions (2,) at `time` when the command there is `command`; for live use, sample by sample.

        The first call sets the spools to rest at that command.
        """
        u = np.asarray(command, dtype=float).reshape(1, 2)
        times = np.array([*([self._past[-1][0]] if self._past else []), time], dtype=float)
        self._check(times, np.broadcast_to(u, (times.size, 2)))
        changed = np.empty((1, 2))
        _apply_command_hooks(self._E, u, changed)
        if not self._past:
            self._past.append((time, changed[0]))
            self._spool, self._held = changed[0].copy(), changed[0].copy()
            return self._spool.copy()
        self._past.append((time, changed[0]))
        t, v = np.array([p[0] for p in self._past]), np.array([p[1] for p in self._past])
        for c in range(2):
            self._spool[c], self._held[c] = _advance(
                t, np.ascontiguousarray(v[:, c]), times[0], time, self._spool[c], self._held[c],
                self._delay[c], self._play[c], self._tau[c],
            )  # fmt: skip
        self._forget(time)
        return self._spool.copy()

    def _forget(self, time: float) -> None:
        oldest = time - max(self._delay)
        while len(self._past) > 2 and self._past[1][0] <= oldest:
            self._past.popleft()

    def _check(self, t: np.ndarray, u: np.ndarray) -> None:
        bad = np.argwhere(~(np.abs(u) <= 1.0 + 1e-9))
        if bad.size:
            k, c = bad[0]
            raise CraneError(
                f"{self._name}: the {CYLINDERS[c]} command at t = {t[k]:g} s is {u[k, c]:g}, expected a number from -1 to "
                "1. Scale the commands, or calibrate the valve voltages (valves.*.voltage in the crane file)."
            )
        back = np.flatnonzero(~(np.diff(t) > 0.0))
        if back.size:
            k = int(back[0])
            raise CraneError(
                f"{self._name}: command times do not increase at {t[k + 1]:g} s (before: {t[k]:g} s). Sort them and remove "
                "repeated ones."
            )


@njit
def _run_one(time, command, delay, width, tau):
    """Return the spool positions (n,) of one valve at `time`; the samples that arrive are walked through once."""
    out = np.empty(time.size)
    spool = held = start = command[0]
    out[0], begin, arriving = spool, time[0] - delay, 0
    for k in range(1, time.size):
        end = time[k] - delay
        while arriving < time.size and time[arriving] <= end:
            if time[arriving] > begin:
                spool, held = _play_step(spool, held, start, command[arriving], width, time[arriving] - begin, tau)
                begin, start = time[arriving], command[arriving]
            arriving += 1
        if end > begin:
            after = _between(time, command, arriving, end)
            spool, held = _play_step(spool, held, start, after, width, end - begin, tau)
            begin, start = end, after
        out[k] = spool
    return out


@njit
def _between(time, command, after, t):
    """Return the command at t, which lies before sample `after` and not before the one that precedes it."""
    if after == 0:
        return command[0]
    slope = (command[after] - command[after - 1]) / (time[after] - time[after - 1])
    return command[after - 1] + slope * (t - time[after - 1])


@njit
def _advance(time, command, begin, end, spool, held, delay, width, tau):
    """Return (spool, held) at `end`; the delayed command has a corner wherever a sample arrives between begin and end."""
    t0, t1 = begin - delay, end - delay
    u0 = _delayed(time, command, t0)
    k = np.searchsorted(time, t0, side="right")
    while k < time.size and time[k] < t1:
        if time[k] > t0:
            spool, held = _play_step(spool, held, u0, command[k], width, time[k] - t0, tau)
            t0, u0 = time[k], command[k]
        k += 1
    return _play_step(spool, held, u0, _delayed(time, command, t1), width, t1 - t0, tau)


def paper_cycle(time: np.ndarray) -> np.ndarray:
    """Return the commands (n, 2) of the paper's working cycle at `time` (s): 25 s, lift then tilt, up and down.

    U1 = +0.5 for 2-5 s and -0.5 for 18-21 s; U2 = +0.35 for 7-10 s and -0.35 for 12-14 s; times are the paper's.
    """
    t = np.asarray(time, dtype=float)
    out = np.zeros((*t.shape, 2))
    for valve, begin, end, value in ((0, 2, 5, 0.5), (0, 18, 21, -0.5), (1, 7, 10, 0.35), (1, 12, 14, -0.35)):
        out[(t >= begin) & (t < end), valve] = value
    return out
