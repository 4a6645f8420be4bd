"""A crane as the fit sees it: vectors for compiled code, and spool positions on the grid."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.drive import spool_on
from crane_exudyn.effects import hooks
from crane_exudyn.effects.registry import find
from crane_exudyn.inputs import Valve, valve_of
from crane_exudyn.measurement import Measurement

from ..semi_recursive import kernel
from .data import ACCURACY, FitData


@dataclass(frozen=True)
class Model:
    """Vectors of one crane for one recording: P, E, the inputs W (N, valves + 2) on the recording's grid, with
    disturbances behind where any are known; the commands' lateness, s; and the local error of a step of its runs, in
    units of the engine's.
    """

    crane: Crane
    P: np.ndarray
    E: np.ndarray
    W: np.ndarray
    late: float = 0.0
    accuracy: float = ACCURACY

    @property
    def topology(self) -> np.ndarray:
        """The machine's table of integers for compiled code."""
        return self.crane.machine.topology

    @property
    def nx(self) -> int:
        """Number of states: more with a pendulum."""
        lay = self.crane.layout
        return len(lay.all_states if hooks.swings(self.E) else lay.states)

    @cached_property
    def _measurements(self) -> dict[tuple[str, ...], Measurement]:
        return {}

    def measurement(self, channels: Sequence[str]) -> Measurement:
        """Return what the crane's sensors of some channels show, made once."""
        known, names = self._measurements, tuple(channels)
        if names not in known:
            known[names] = Measurement(names, self.crane.machine, self.P, self.E)
        return known[names]

    def run(self, x0: np.ndarray, W: np.ndarray, time: np.ndarray, step: float) -> tuple[np.ndarray, int, int]:
        """Return states (n, nx) from x0 at times (n,) with inputs W (n, …), a status, and the sample before the step
        that failed, as accurate as fits need; a machine that runs away fails.
        """
        x0, W, time = (np.ascontiguousarray(a) for a in (x0, W, time))  # another order in memory is compiled anew
        X, status, last, _ = kernel.simulate(x0, W, time, step, *self._with(step))
        return X, status, last

    def each(
        self, x0: np.ndarray, first: np.ndarray, W: np.ndarray, time: np.ndarray, step: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Return states (N, nx) of K runs from x0 (K, nx), one after the other, each from its first sample (K,) on, and
        by run (K,) what `run` returns.
        """
        x0, W, time = (np.ascontiguousarray(a) for a in (x0, W, time))
        X, status, last, _ = kernel.simulate_each(x0, first, W, time, step, *self._with(step))
        return X, status, last

    def _with(self, step: float) -> tuple[np.ndarray, np.ndarray, np.ndarray, float, float]:
        return self.P, self.E, self.topology, self.accuracy, kernel.most_parts(self.accuracy, step)

    def whole(self, x0: np.ndarray, W: np.ndarray, time: np.ndarray, step: float) -> tuple[np.ndarray, int]:
        """Return the states and the status of a run that stands still from where it leaves what the crane can do."""
        X, status, last = self.run(x0, W, time, step)
        if status != kernel.OK:
            X[last + 1 :] = X[last]
        return X, status


def model_of(crane: Crane, data: FitData, late: float = 0.0, near: Model | None = None) -> Model:
    """Return the model of a crane driven by the commands of a recording, `late` seconds after their stamps.

    Args:
        near: a model of hardly another crane with equal lateness, from which the spool positions are extrapolated where
            only time constants of the valves differ (many joint moves of parameters change them a little each).
    """
    P, E = crane.parameter_vector(), crane.effect_vector()
    W = None if near is None else _extrapolated(near, crane, P, E, data, late)
    if W is None:
        W = _inputs(crane, data, _paths(crane, P, E, data, late))
        if near is not None and np.array_equal(W, near.W, equal_nan=True):
            W = near.W  # of hundreds of models that are screened most have the same
    return Model(crane, P, E, W, late, data.accuracy)


def _inputs(crane: Crane, data: FitData, spool: np.ndarray) -> np.ndarray:
    """Return the inputs W (N, valves + 2); with disturbances behind, where objects of one's own make such."""
    W = np.column_stack([spool, data.supply])
    if data.moments is None:
        return W
    lay = crane.layout
    wide = np.zeros((len(W), len(lay.all_inputs)))
    wide[:, lay.driving] = W
    wide[:, [lay.all_inputs.index(name) for name in lay.torques]] = data.moments
    return wide


def spool_path(crane: Crane, data: FitData, late: float = 0.0) -> np.ndarray:
    """Return spool positions (N, valves) on the grid of a recording."""
    return _paths(crane, crane.parameter_vector(), crane.effect_vector(), data, late)


def _paths(crane: Crane, P: np.ndarray, E: np.ndarray, data: FitData, late: float) -> np.ndarray:
    return np.column_stack(
        [_valve_path(crane, data, c, valve_of(P, E, c), late) for c in range(len(crane.layout.cylinders))]
    )


#: share of a time constant by which it may differ for the spool's path to be extrapolated, and that of the difference
#: quotient
_NEAR, _QUOTIENT = 1e-2, 1e-4


def _extrapolated(
    near: Model, crane: Crane, P: np.ndarray, E: np.ndarray, data: FitData, late: float
) -> np.ndarray | None:
    """Return the inputs (N, …) from those of a model nearby, its own where its valves are the same; None if more than
    the time constants differ.
    """
    if late != near.late or _commanded(crane) != _commanded(near.crane):
        return None
    W = near.W
    for c, name in enumerate(crane.layout.cylinders):
        here, there = valve_of(P, E, c), valve_of(near.P, near.E, c)
        change = here.tau - there.tau
        if here._replace(tau=there.tau) != there or abs(change) > _NEAR * there.tau:
            return None
        if change != 0.0:
            step = _QUOTIENT * there.tau
            beside = near.crane.with_parameters({f"valves.{name}.time_constant": there.tau + step})
            path = _valve_path(beside, data, c, there._replace(tau=there.tau + step), late)
            W = W.copy() if W is near.W else W
            W[:, c] += change / step * (path - near.W[:, c])
    return W


def _commanded(crane: Crane) -> tuple[object, ...]:
    """Return the effects that change the command itself."""
    return tuple((e.key, *e.parameters.values()) for e in crane.effects if "command" in find(e.name).hooks())


def _valve_path(crane: Crane, data: FitData, c: int, valve: Valve, late: float) -> np.ndarray:
    """Return the positions (N,) of one spool on the grid; equal commands and valves are computed once."""
    key = (
        id(data.commands), float(data.command_time[0]), float(data.time[0]), len(data.time), _commanded(crane), c,
        valve, late,
    )  # fmt: skip
    path = _LAST.get(key)
    if path is None:
        path = spool_on(crane, data.time, data.command_time, data.commands, late, c)[:, c].copy()
        _LAST.put(key, path, data.commands)
    return path


class _Paths:
    """The spool paths that were asked for last, no more than `most` bytes of them: those of ten minutes are 5 MB
    each.
    """

    def __init__(self, most: int) -> None:
        self._most, self._bytes = most, 0
        self._held: OrderedDict[tuple[object, ...], tuple[np.ndarray, np.ndarray]] = OrderedDict()

    def get(self, key: tuple[object, ...]) -> np.ndarray | None:
        """Return the path of a key if it is still there."""
        if key not in self._held:
            return None
        self._held.move_to_end(key)
        return self._held[key][0]

    def put(self, key: tuple[object, ...], path: np.ndarray, commands: np.ndarray) -> None:
        """Keep a path, and the commands that the key knows by where they lie in memory."""
        self._held[key] = (path, commands)
        self._bytes += path.nbytes
        while self._bytes > self._most and len(self._held) > 2:
            self._bytes -= self._held.popitem(last=False)[1][0].nbytes


_LAST = _Paths(50_000_000)
