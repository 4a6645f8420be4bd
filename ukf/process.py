"""The crane as the filter sees it: sigma points in, sigma points out, extra states and physical limits included."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.engines import engine_class
from crane_exudyn.errors import CraneError

from .augment import Extra
from .bounds import Bounds
from .channels import Channels
from .linear_algebra import all_finite

#: share of a point's way from the mean that must be possible for the rest to be told from it
_LEAST_SHARE = 0.05


class EngineMisfit(CraneError):
    """An engine that does not do what engines do: no failure of one step, after which a filter could go on."""


class Process:
    """The transition of [engine states, lagged readings, extra states] over one sampling interval."""

    def __init__(self, engine: Any, channels: Channels, extras: Sequence[Extra], bounds: Bounds) -> None:
        """Raises CraneError where the engine cannot vary what the extra states ask for."""
        self.engine = engine
        self.nx = len(engine.state_names)
        self._channels = channels
        self._lags = len(channels.lags)
        self._bounds = bounds
        first = self.nx + self._lags
        self._columns = {e.name: first + k for k, e in enumerate(extras) if e.kind == "parameter"}
        if self._columns and not accepts_parameters(engine):
            raise CraneError(
                f"augmented state {next(iter(self._columns))!r}: the engine {type(engine).__name__} has one set of "
                'parameters for all sigma points. Use the engine "semi-recursive", or leave the quantity out.'
            )
        self._fading = [(first + k, e) for k, e in enumerate(extras) if e.memory < np.inf]
        self._plain = not extras and not self._lags

    def over(self, inputs: np.ndarray, times: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
        """Return the function points (m, n) -> points (m, n) from times[0] to times[-1] (s,) with inputs (s, valves +
        2).
        """
        return lambda points: self.run(points, inputs, times)

    def run(self, points: np.ndarray, inputs: np.ndarray, times: np.ndarray) -> np.ndarray:
        """Return the points (m, n), which lie about their mean, carried along the inner steps `times` (s,) with inputs
        (s, valves + 2).

        A point whose parameters no machine has, such as a payload of less than nothing, is carried as the line through
        the mean and the farthest possible point between, or on the other side of it, goes on: with its parameter cut
        off the mean of all would be shifted, although the machine does nothing.
        """
        inside, excess = self._bounds.split(points)
        if excess is None or not excess[:, list(self._columns.values())].any():
            return self.carried(inside, excess, inputs, times)
        middle = points.mean(axis=0)
        share = self._possible(points, middle)
        near = np.vstack([middle + share[:, None] * (points - middle), middle])
        out, cut = self.carried(*self._bounds.split(near), inputs, times), share != 1.0
        out[:-1][cut] = out[-1] + (out[:-1][cut] - out[-1]) / share[cut, None]
        return out[:-1]

    def _possible(self, points: np.ndarray, middle: np.ndarray) -> np.ndarray:
        """Return the share of each point's way from the middle at which its parameters are possible (m,); negative on
        the other side, 1 where hardly any is.
        """
        columns = list(self._columns.values())
        away, room = points[:, columns] - middle[columns], np.maximum(middle - self._bounds.lower, 0.0)[columns]
        ways = room / np.maximum(np.abs(away), 1e-200)
        ahead = np.where(away < 0.0, ways, 1.0).min(axis=1).clip(0.0, 1.0)
        behind = np.where(away > 0.0, ways, 1.0).min(axis=1).clip(0.0, 1.0)
        share = np.where(ahead >= behind, ahead, -behind)
        return np.where(np.abs(share) < _LEAST_SHARE, 1.0, share)

    def carried(
        self,
        inside: np.ndarray,
        excess: np.ndarray | None,
        inputs: np.ndarray,
        times: np.ndarray,
        others: Mapping[str, np.ndarray] | None = None,
    ) -> np.ndarray:
        """Return points (m, n) carried along from inside the limits, what was beyond them carried through as it is;
        `others` are parameters (m,) that are no states.
        """
        states = np.ascontiguousarray(inside[:, : self.nx])
        varied = {**(others or {}), **{n: inside[:, c] for n, c in self._columns.items()}}
        keyword = {"parameters": varied} if varied else {}
        shape = states.shape
        for k in range(len(times) - 1):
            states = self.engine.propagate(
                states, inputs[k : k + 2], times[k + 1] - times[k], float(times[k]), **keyword
            )
            if np.shape(states) != shape:  # it would be taken apart in silence
                raise EngineMisfit(
                    f"The engine {type(self.engine).__name__} returned the shape {np.shape(states)} for states of "
                    f"shape {shape}. Correct its method propagate: it must return a state for each state."
                )
        if not all_finite(states):
            raise ArithmeticError("the engine returned states that are not finite")
        return self._assemble(inside, states, excess, float(times[-1] - times[0]))

    def _assemble(self, inside: np.ndarray, states: np.ndarray, excess: np.ndarray | None, dt: float) -> np.ndarray:
        if self._plain:
            return states if excess is None else states + excess
        out = inside.copy()
        out[:, : self.nx] = states
        if self._lags:
            out[:, self.nx : self.nx + self._lags] = self._channels.follow(inside, out, dt)
        for column, extra in self._fading:
            out[:, column] = extra.value + extra.kept(dt) * (inside[:, column] - extra.value)
        return out if excess is None else out + excess


#: local error of a filter's step, in units of the engines': 2 bar and 6e-6 rad. Finer steps of single sigma points move
#: the estimate by less than a hundredth of its standard deviation (sensors of 1.5 bar) at three times the cost; this
#: keeps out steps that are wrong
ACCURACY = 600.0


def accepts_parameters(engine: Any) -> bool:
    """Whether an engine takes parameters that differ from sigma point to sigma point."""
    return "parameters" in inspect.signature(engine.propagate).parameters


def engine_of(engine: Any, crane: Crane) -> Any:
    """Return an engine by name (such as "exudyn", "semi-recursive"), or the object itself where one is given."""
    return engine_class(engine)(crane, accuracy=ACCURACY) if isinstance(engine, str) else engine
