"""From commands to spool positions: delay, backlash, the spool's lag (16) and creep; and the paper's working cycle.

Spool positions depend on the commands alone, so they are computed once per time grid. ::

    command -> command hooks -> delay T -> play of width b -> 1 - kappa: lag tau (16)      -> sum: spool position U
                                                           -> kappa:     creep, lag tau_c
"""

from __future__ import annotations

from collections import deque
from typing import NamedTuple

import numpy as np

from . import faulty_laws
from .compiled import njit
from .crane import Crane
from .effects import hooks
from .errors import CraneError
from .hydraulics import LAG
from .laws.spool import spool_step
from .parameters import N_VALVE, VALVE


class Valve(NamedTuple):
    """What a valve does to its command: delay in s, width of its play, time constant in s, the share of the travel that
    creeps and its time constant.
    """

    delay: float
    width: float
    tau: float
    share: float
    creep: float


@njit
def _apply_command_hooks(E, commands, out):
    """Fill out (n, valves) with the commands after the effects that act on them."""
    for k in range(commands.shape[0]):
        for c in range(commands.shape[1]):
            out[k, c] = hooks.command(E, c, commands[k, c])


def _commands_after(E: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return the commands (n, valves) after the effects E that act on them."""
    changed = np.empty_like(commands)
    _apply_command_hooks(E, np.ascontiguousarray(commands), changed)
    return changed


@njit
def play(follower: float, leader: float, width: float) -> float:
    """Return where a follower with play stands: pushed along when the leader is more than width/2 away."""
    half = 0.5 * width
    return min(max(follower, leader - half), leader + half)


@njit
def _follow(quick: float, slow: float, start: float, end: float, dt: float, valve: Valve) -> tuple:
    """Return both parts of a spool after dt, behind a leader that is linear from start to end."""
    after = spool_step(slow, start, end, dt, valve.creep) if valve.share > 0.0 else slow
    return spool_step(quick, start, end, dt, valve.tau), after


@njit
def _play_step(state: tuple, start: float, end: float, dt: float, valve: Valve) -> tuple:
    """Return the state after dt for a leader that is linear from start to end, behind a play and the spool's lags.

    Within the step the play holds until the leader has crossed it, then follows; both parts are linear.

    Args:
        state: where the quick and the slow part of the spool stand, and what the play holds.
    """
    quick, slow, held = state
    width = valve.width
    after = play(held, end, width)
    if dt <= 0.0 or after == held or width <= 0.0:
        begin, reached = (held, after) if width > 0.0 else (start, end)
        quick, slow = _follow(quick, slow, begin, reached, dt, valve)
        return quick, slow, after
    first = play(held, start, width)  # differs from held only if the leader jumped
    waiting = 1.0 - abs(after - first) / abs(end - start) if end != start else 0.0
    quick, slow = _follow(quick, slow, first, first, waiting * dt, valve)
    quick, slow = _follow(quick, slow, first, after, (1.0 - waiting) * dt, valve)
    return quick, slow, after


@njit
def _position(state: tuple, valve: Valve) -> float:
    """Return where the spool stands: both parts of it by their shares."""
    quick, slow, _ = state
    return quick if valve.share == 0.0 else (1.0 - valve.share) * quick + valve.share * slow


@njit
def _delayed(time, values, t):
    """Return the commands at t, linear between samples; before the first sample they are the first."""
    return np.interp(t, time, values)


class SpoolPath:
    """Spool positions that follow commands, exact for commands that are linear between samples.

    Args:
        crane: gives the spools' time constants and the effects command_delay, spool_hysteresis and spool_creep.

    The spools start at rest where the first command (after delay and backlash) holds them.
    """

    def __init__(self, crane: Crane) -> None:
        P, self._E = crane.parameter_vector(), crane.effect_vector()
        self._crane, self._names = crane, crane.layout.cylinders
        self._valves = [valve_of(P, self._E, c) for c in range(len(self._names))]
        for c, valve in enumerate(self._valves):
            if not np.isfinite(valve).all():
                finite = lambda tried, c=c: bool(np.isfinite(valve_of(P, tried.effect_vector(), c)).all())  # noqa: E731
                faulty_laws.check_law(crane, finite, f"the {self._names[c]} valve")
        self._past: deque[tuple[float, np.ndarray]] = deque()
        self._states: list[tuple[float, float, float]] = []

    def __repr__(self) -> str:
        lags = ", ".join(f"{name} lag {valve.tau:g} s" for name, valve in zip(self._names, self._valves, strict=True))
        live = f"live, at t = {self._past[-1][0]:g} s" if self._past else "not live"
        return f"<SpoolPath of {self._crane.name}: {lags}; {live}>"

    def run(self, time: np.ndarray, commands: np.ndarray, valve: int | None = None) -> np.ndarray:
        """Return spool positions (n, valves) at `time` for a whole record; leaves the live state of `step` alone.

        Args:
            time: (n,) increasing, in s.
            commands: (n, valves) in [-1, 1], linear between samples.
            valve: the only one to be computed (the others stay at 0); all by default.

        Raises:
            CraneError: wrong shapes, commands outside [-1, 1] or missing, or time that does not increase.
        """
        t, u = np.asarray(time, dtype=float), np.asarray(commands, dtype=float)
        if t.ndim != 1 or u.shape != (t.size, len(self._valves)):
            raise CraneError(
                f"spool path: time {t.shape} and commands {u.shape} do not match; expected (n,) and (n, "
                f"{len(self._valves)})."
            )
        self._check(t, u)
        changed = self._changed(u)
        out = np.zeros_like(changed)
        for c in range(len(self._valves)) if valve is None else (valve,):
            out[:, c] = _run_one(t, np.ascontiguousarray(changed[:, c]), self._valves[c])
        return out

    def step(self, time: float, command: np.ndarray) -> np.ndarray:
        """Return the spool positions (valves,) at `time` when the command there is `command`; for live use, sample by
        sample.

        The first call sets the spools to rest at that command.
        """
        u = np.asarray(command, dtype=float).reshape(1, len(self._valves))
        times = np.array([*([self._past[-1][0]] if self._past else []), time], dtype=float)
        self._check(times, np.broadcast_to(u, (times.size, u.shape[1])))
        changed = self._changed(u)
        self._past.append((time, changed[0]))
        if not self._states:
            self._states = [(u0, u0, u0) for u0 in changed[0].tolist()]
        else:
            t, v = np.array([p[0] for p in self._past]), np.array([p[1] for p in self._past])
            self._states = [
                _advance(t, np.ascontiguousarray(v[:, c]), times[0], time, state, valve)
                for c, (state, valve) in enumerate(zip(self._states, self._valves, strict=True))
            ]
            self._forget(time)
        return np.array([_position(s, v) for s, v in zip(self._states, self._valves, strict=True)])

    def _changed(self, commands: np.ndarray) -> np.ndarray:
        """Return the commands (n, valves) after the effects that act on them."""
        changed = _commands_after(self._E, commands)
        bad = np.argwhere(~np.isfinite(changed))
        if bad.size:
            k, c = bad[0]
            finite = lambda tried: bool(np.isfinite(_commands_after(tried.effect_vector(), commands[k, None])).all())  # noqa: E731
            faulty_laws.check_law(self._crane, finite, f"the {self._names[c]} command {commands[k, c]:g}")
        return changed

    def _forget(self, time: float) -> None:
        oldest = time - max(valve.delay for valve in self._valves)
        while len(self._past) > 2 and self._past[1][0] <= oldest:
            self._past.popleft()

    def _check(self, t: np.ndarray, u: np.ndarray) -> None:
        bad = np.argwhere(~(np.abs(u) <= 1.0 + 1e-9))
        if bad.size:
            k, c = bad[0]
            raise CraneError(
                f"{self._crane.name}: the {self._names[c]} command at t = {t[k]:g} s is {u[k, c]:g}, expected a number "
                "from -1 to "
                "1. Scale the commands, or calibrate the valve voltages (valves.*.voltage in the crane file)."
            )
        back = np.flatnonzero(~(np.diff(t) > 0.0))
        if back.size:
            k = int(back[0])
            raise CraneError(
                f"{self._crane.name}: command times do not increase at {t[k + 1]:g} s (before: {t[k]:g} s). Sort them "
                "and remove "
                "repeated ones."
            )


def valve_of(P: np.ndarray, E: np.ndarray, c: int) -> Valve:
    """Return what valve c does to its command."""
    share, creep = hooks.plain("creep")(E, c)
    delay, width, tau = hooks.plain("delay")(E, c), hooks.plain("backlash")(E, c), P[VALVE + N_VALVE * c + LAG]
    return Valve(float(delay), float(width), float(tau), float(share), float(creep))


@njit
def _run_one(time, command, valve):
    """Return the spool positions (n,) of one valve at `time`; the samples that arrive are walked through once."""
    out = np.empty(time.size)
    delay, start = valve.delay, command[0]
    state = (start, start, start)
    out[0], begin, arriving = start, time[0] - delay, 0
    for k in range(1, time.size):
        end = time[k] - delay
        while arriving < time.size and time[arriving] <= end:
            if time[arriving] > begin:
                state = _play_step(state, start, command[arriving], time[arriving] - begin, valve)
                begin, start = time[arriving], command[arriving]
            arriving += 1
        if end > begin:
            after = _between(time, command, arriving, end)
            state = _play_step(state, start, after, end - begin, valve)
            begin, start = end, after
        out[k] = _position(state, valve)
    return out


@njit
def _between(time, command, after, t):
    """Return the command at t, which lies before sample `after` and not before the one that precedes it."""
    if after == 0:
        return command[0]
    slope = (command[after] - command[after - 1]) / (time[after] - time[after - 1])
    return command[after - 1] + slope * (t - time[after - 1])


@njit
def _advance(time, command, begin, end, state, valve):
    """Return the state at `end`; the delayed command has a corner wherever a sample arrives between begin and end."""
    t0, t1 = begin - valve.delay, end - valve.delay
    u0 = _delayed(time, command, t0)
    k = np.searchsorted(time, t0, side="right")
    while k < time.size and time[k] < t1:
        if time[k] > t0:
            state = _play_step(state, u0, command[k], time[k] - t0, valve)
            t0, u0 = time[k], command[k]
        k += 1
    return _play_step(state, u0, _delayed(time, command, t1), t1 - t0, valve)


#: (valve, begin, end, command) of the paper's cycle, and of valves beyond its two, which open while those rest; s
_CYCLE = ((0, 2, 5, 0.5), (0, 18, 21, -0.5), (1, 7, 10, 0.35), (1, 12, 14, -0.35))
_BEYOND = ((14.5, 15.5, 0.2), (16.0, 17.0, -0.2))


def paper_cycle(time: np.ndarray, valves: int = 2) -> np.ndarray:
    """Return the commands (n, valves) of the paper's working cycle at `time` (s): 25 s, lift then tilt, up and down.

    U1 = +0.5 for 2-5 s and -0.5 for 18-21 s; U2 = +0.35 for 7-10 s and -0.35 for 12-14 s; times are the paper's.
    Further valves open a little between, all at once.
    """
    t = np.asarray(time, dtype=float)
    out = np.zeros((*t.shape, valves))
    for valve, begin, end, value in (*_CYCLE, *((v, *pulse) for v in range(2, valves) for pulse in _BEYOND)):
        if valve < valves:
            out[(t >= begin) & (t < end), valve] = value
    return out
