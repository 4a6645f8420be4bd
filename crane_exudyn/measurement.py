"""What the sensors of a crane show: one function y = h(x) for simulations, filters, fits and comparisons.

A sensor reads a sum of states (a pressure as a gauge does, which shows vapour pressure of a void) or a cylinder's
length. What it makes of that is the crane's `measurement` hooks at its place: y = law(reading). Where the `lag` hooks
there give a time constant, it shows a first-order follower of y, tau y_shown' + y_shown = y.
"""

from __future__ import annotations

import copy
from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from .compiled import njit
from .crane import Crane
from .effects import hooks
from .effects.base import SENSING, SENSORS
from .effects.registry import neutral_vector, slots_of
from .errors import CraneError, names_of
from .faulty_laws import check_law
from .geometry import fill_lengths
from .hydraulics import vapour_pressure
from .machine import CYLINDERS, Machine
from .sensors import sensor

#: step of the difference quotient of a law: shares of a usual sensor's noise and of the reading
_OF_NOISE, _OF_READING = 1e-3, 1e-6


class _Reads(NamedTuple):
    """What m sensors read, as compiled code takes it, which gets it as a tuple in this order.

    Attributes:
        summed: (m, most) states whose sum each shows, -1 for no more; is_pressure: (m,), not below vapour pressure.
        cylinder: (m,) of which each shows the length, -1 for none.
        place: (m,) number of the effects' place, -1 for none.
        step: (m,) for the derivative of an effect's law.
    """

    summed: np.ndarray
    is_pressure: np.ndarray
    cylinder: np.ndarray
    place: np.ndarray
    step: np.ndarray


class Measurement:
    """The measurement function of some sensors on a crane with parameters P and effects E.

    States are (n, nx), or have more columns behind, as those of filters. What has another shape is a CraneError:
    compiled code would read beyond it.

    Attributes:
        names: (m,) of the sensors.
        lags: (number among the sensors, time constant in s) of those that lag.
        has_laws: whether effects may make something else of a reading.
    """

    def __init__(self, names: Sequence[str], machine: Machine, P: np.ndarray, E: np.ndarray) -> None:
        """Raises CraneError for a sensor that the machine does not have."""
        self._machine, lay, self._least = machine, machine.layout, len(machine.layout.states)
        self.names, chosen = tuple(names), [sensor(n, lay.sensors) for n in names]
        most = max([1, *(len(c.shows) for c in chosen)])
        summed = [[lay.index(s) for s in c.shows] + [-1] * (most - len(c.shows)) for c in chosen]
        self._reads = _Reads(
            np.array(summed, np.int64).reshape(-1, most),
            np.array([c.unit == "Pa" for c in chosen], bool),
            np.array([-1 if c.shows else c.cylinder for c in chosen], np.int64),
            np.array([lay.place_number(SENSORS, c.place) if c.place else -1 for c in chosen], np.int64),
            np.array([_OF_NOISE * c.sizes.noise for c in chosen]),
        )
        self.use(P, E)

    @classmethod
    def of(cls, crane: Crane, names: Sequence[str] | None = None) -> Measurement:
        """Return the measurement function of a crane's sensors, of all that it may have by default."""
        chosen = tuple(crane.layout.sensors) if names is None else names_of(names, "Measurement.of: names")
        return cls(chosen, crane.machine, crane.parameter_vector(), crane.effect_vector())

    def __repr__(self) -> str:
        lags = "".join(f"; {self.names[j]} lags by {tau:g} s" for j, tau in self.lags)
        return f"<Measurement of {', '.join(self.names)}{lags}{'; with effects on readings' * self.has_laws}>"

    def _checked(self, X: np.ndarray, time: np.ndarray | None = None) -> np.ndarray:
        """Return states as an array (n, nx or more), with a time for each. Raises CraneError for another shape."""
        X, least = np.asarray(X, dtype=float), self._least
        if X.ndim != 2 or X.shape[1] < least:
            names = " ".join(self._machine.layout.states)
            raise CraneError(
                f"measurement: states have shape {X.shape}, expected (n, {least}) for {names}. A single state is "
                "state[None]."
            )
        if time is not None and np.shape(time) != X.shape[:1]:
            raise CraneError(
                f"measurement: time has shape {np.shape(time)}, expected ({len(X)},). Give one instant for each state."
            )
        return X

    def _check_cranes(self, P: np.ndarray, E: np.ndarray) -> None:
        if np.ndim(P) != 2 or np.shape(P)[1:] != self.P.shape or np.shape(E) != (len(P), self.E.size):
            raise CraneError(
                f"measurement: P and E have shapes {np.shape(P)} and {np.shape(E)}, expected (k, {self.P.size}) and "
                f"(k, {self.E.size}). Give one row for each crane."
            )

    def use(self, P: np.ndarray, E: np.ndarray) -> None:
        """Take the parameters P and the effects E of another crane with this machine."""
        self.P, self.E = P, E
        self._floor = np.where(self._reads.is_pressure, vapour_pressure(P), -np.inf)
        slots = slots_of(SENSING)
        self.has_laws = bool((E[slots] != np.array(neutral_vector())[slots]).any())
        self._is_plain = not self.has_laws and not (self._reads.cylinder >= 0).any()
        taus = [float(hooks.plain("lag")(E, place)) for place in self._reads.place]
        self.lags = tuple((j, tau) for j, tau in enumerate(taus) if tau > 0.0)

    def beside(self, P: np.ndarray, E: np.ndarray) -> Measurement:
        """Return the same sensors on a crane with other parameters and effects."""
        other = copy.copy(self)
        other.use(P, E)
        return other

    def differs(self, X: np.ndarray, P: np.ndarray, E: np.ndarray) -> np.ndarray:
        """Return whether (k,) the sensors may show something else along states X (n, nx) on cranes with other
        parameters P (k, …) and effects E (k, …).
        """
        X = self._checked(X)
        self._check_cranes(P, E)
        moved = (P != self.P).any(axis=1)
        lengths = self._reads.cylinder >= 0
        differ = np.array([vapour_pressure(p) != vapour_pressure(self.P) for p in P[moved]], bool)
        if lengths.any():  # a parameter that changes a length does so almost everywhere
            ends = X[[0, -1]]
            other, _ = self._read_on(ends, P[moved], np.tile(self.E, (len(differ), 1)))
            differ |= (other != self.read(ends)[:, :, None])[:, lengths].any(axis=(0, 1))
        moved[moved] = differ
        slots = slots_of(SENSING)
        return np.asarray(moved | (E[:, slots] != self.E[slots]).any(axis=1))

    def read(self, X: np.ndarray, full: np.ndarray | None = None) -> np.ndarray:
        """Return what the sensors would show (n, m) of states X (n, nx) without lag.

        full: (m,) which of them show the state itself, below vapour pressure too.
        """
        X = self._checked(X)
        floor = self._floor if full is None else np.where(full, -np.inf, self._floor)
        Y: np.ndarray = _sums(X, self._reads.summed, floor)
        if not self._is_plain:
            _read(self._machine.topology, tuple(self._reads), X, self.P, self.E, Y)
        return Y

    def rows(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return what the sensors would show without lag (n, m), and its derivative (n, m, nx), at states X (n, nx)."""
        X = self._checked(X)
        Y, C = _sums(X, self._reads.summed, self._floor), np.zeros((len(X), len(self.names), X.shape[1]))
        _rows(self._machine.topology, tuple(self._reads), self._floor, X, self.P, self.E, Y, C)
        return Y, C

    def shown(
        self, X: np.ndarray, time: np.ndarray, *, settled: bool = False, first: np.ndarray | None = None
    ) -> np.ndarray:
        """Return what the sensors show (n, m) along states X (n, nx) at `time` (n,) in s; `settled` and `first` (m,) as
        in `lagged`.
        """
        X = self._checked(X, time)
        Y = self.read(X)
        for j, tau in self.lags:
            Y[:, j] = lagged(Y[:, j], time, tau, settled=settled, first=None if first is None else first[j])
        return Y

    def shown_on(
        self, X: np.ndarray, time: np.ndarray, P: np.ndarray, E: np.ndarray, first: np.ndarray | None = None
    ) -> np.ndarray:
        """Return what the sensors show (n, m, k) along states X (n, nx) on cranes with parameters P (k, …) and effects
        E (k, …); lags begin at `first` (m, k), as in `lagged`.
        """
        X = self._checked(X, time)
        self._check_cranes(P, E)
        Y, taus = self._read_on(X, P, E)
        for k, j in np.argwhere(taus > 0.0):
            Y[:, j, k] = lagged(Y[:, j, k], time, taus[k, j], first=None if first is None else first[j, k])
        return Y

    def _read_on(self, X: np.ndarray, P: np.ndarray, E: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        Y, taus = np.empty((len(X), len(self.names), len(P))), np.empty((len(P), len(self.names)))
        _read_on(self._machine.topology, tuple(self._reads), X, P, E, Y, taus)
        return Y, taus

    def shown_rows(
        self, X: np.ndarray, S: np.ndarray, time: np.ndarray, first: tuple[np.ndarray, np.ndarray] | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return what the sensors show (n, m), and its derivative (n, m, k), along states X (n, nx) with derivative S
        (n, nx, k); lags begin at `first` ((m,), (m, k)), as in `lagged`.
        """
        X = self._checked(X, time)
        if np.ndim(S) != 3 or np.shape(S)[:2] != X.shape:
            raise CraneError(
                f"measurement: the derivative of states {X.shape} has shape {np.shape(S)}, expected ({len(X)}, "
                f"{X.shape[1]}, k). Give one column for each of k quantities."
            )
        Y, C = self.rows(X)
        G = C @ S
        for j, tau in self.lags:
            y, g = (None, None) if first is None else (first[0][j], first[1][j])
            Y[:, j], G[:, j] = lagged(Y[:, j], time, tau, first=y), lagged(G[:, j], time, tau, first=g)
        return Y, G

    def check(self, crane: Crane, Y: np.ndarray, X: np.ndarray) -> None:
        """Raise CraneError that names the crane's effect of which a law gives no number, where `read` gives Y (n, m) of
        X (n, nx).
        """
        X = self._checked(X)
        for k, j in np.argwhere(~np.isfinite(Y)):
            true = float(self.beside(self.P, crane.nominal().effect_vector()).read(X[k : k + 1])[0, j])
            if np.isfinite(true):
                check_law(crane, partial(_is_number, self._reads.place[j], true), f"{self.names[j]} = {true:g}")


def _is_number(place: int, true: float, crane: Crane) -> bool:
    return bool(np.isfinite(hooks.measurement(crane.effect_vector(), place, true)))


def lagged(
    y: np.ndarray, time: np.ndarray, tau: float, *, settled: bool = False, first: np.ndarray | None = None
) -> np.ndarray:
    """Return y (n, …) at `time` (n,) behind a first-order lag of tau s: exact where y is linear between instants.

    It begins at `first` (…), or `settled` at y[0], or else as if it had followed the first slope for ever.

    Raises:
        CraneError: not one instant for each y.
    """
    if np.shape(time) != np.shape(y)[:1]:
        raise CraneError(f"lagged: time has shape {np.shape(time)}, y {np.shape(y)}. Give one instant for each y.")
    if first is None:
        slope = (y[1] - y[0]) / (time[1] - time[0]) if len(y) > 1 and not settled else 0.0 * y[0]
        first = y[0] - tau * slope
    columns = np.ascontiguousarray(y, float).reshape(len(y), -1)
    return np.asarray(_followed(columns, time, tau, np.ravel(first))).reshape(np.shape(y))


@njit
def _followed(y, time, tau, first):  # type: ignore[no-untyped-def]
    out = np.empty_like(y)
    out[0] = first
    for k in range(1, len(y)):
        dt = time[k] - time[k - 1]
        decay = np.exp(-dt / tau)
        for i in range(y.shape[1]):
            behind = tau / dt * (y[k, i] - y[k - 1, i])
            out[k, i] = y[k, i] - behind + (out[k - 1, i] - y[k - 1, i] + behind) * decay
    return out


@njit
def _sums(X, summed, floor):  # type: ignore[no-untyped-def]
    """Return the sums (n, m) of the states `summed` (m, most; -1 for no more), none of them below `floor` (m,)."""
    Y = np.zeros((X.shape[0], summed.shape[0]))
    for j in range(summed.shape[0]):
        for i in summed[j]:
            if i >= 0:
                for k in range(X.shape[0]):
                    Y[k, j] += floor[j] if X[k, i] < floor[j] else X[k, i]
    return Y


@njit
def _lengths(topology, cylinder, P, X, by_z):  # type: ignore[no-untyped-def]
    """Return the lengths (n, cylinders) of all cylinders at states X (n, nx), and fill by_z as `fill_lengths` does;
    nothing where the sensors, which show `cylinder`, show none.
    """
    out = np.empty((X.shape[0], topology[0, CYLINDERS]))
    for c in cylinder:
        if c >= 0:
            fill_lengths(topology, P, X, out, by_z)
            break
    return out


@njit
def _read(topology, reads, X, P, E, Y):  # type: ignore[no-untyped-def]
    """Write lengths into Y (n, m), which holds the sums, and make of all that what the laws make of it."""
    _, _, cylinder, place, _ = reads
    n = topology[0, CYLINDERS]
    lengths = _lengths(topology, cylinder, P, X, np.empty((0, n, n)))
    for j in range(place.size):
        for k in range(X.shape[0]):
            y = lengths[k, cylinder[j]] if cylinder[j] >= 0 else Y[k, j]
            Y[k, j] = hooks.measurement(E, place[j], y)


@njit
def _read_on(topology, reads, X, P, E, Y, taus):  # type: ignore[no-untyped-def]
    """Write what sensors read on cranes with P and E (k, …) into Y (n, m, k), and their lags into taus (k, m)."""
    summed, is_pressure, _, place, _ = reads
    floor = np.full(is_pressure.size, -np.inf)
    for k in range(P.shape[0]):
        for j in range(floor.size):  # np.where would take seconds to compile
            if is_pressure[j]:
                floor[j] = vapour_pressure(P[k])
        own = _sums(X, summed, floor)
        _read(topology, reads, X, P[k], E[k], own)
        Y[:, :, k] = own
        for j in range(place.size):
            taus[k, j] = hooks.lag(E[k], place[j])


@njit
def _rows(topology, reads, floor, X, P, E, Y, C):  # type: ignore[no-untyped-def]
    """Do as `_read`, and add the derivatives to C (n, m, nx); floor as of `_sums`."""
    summed, _, cylinder, place, step = reads
    n = topology[0, CYLINDERS]
    by_z = np.empty((X.shape[0], n, n))
    lengths = _lengths(topology, cylinder, P, X, by_z)
    for j in range(place.size):
        for k in range(X.shape[0]):
            y = Y[k, j]
            if cylinder[j] >= 0:
                y = lengths[k, cylinder[j]]
                C[k, j, :n] = by_z[k, cylinder[j]]
            for i in summed[j]:
                if i >= 0 and X[k, i] >= floor[j]:
                    C[k, j, i] += 1.0
            Y[k, j] = hooks.measurement(E, place[j], y)
            h = step[j] + _OF_READING * abs(y)
            low, high = y - h, y + h
            C[k, j] *= (hooks.measurement(E, place[j], high) - hooks.measurement(E, place[j], low)) / (high - low)
