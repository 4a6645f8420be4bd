"""A crane on the Exudyn engine whose laws may differ from step to step, and laws that are in no effect file.

The library's effects are functions of the state, compiled into the engine. The laws here act from outside: before each step of
1 ms they look at the state and change parameters or inputs for that step. So they can hold what the library cannot say
(`LAWS`), and the library's effects in another dialect (`DIALECTS`), as a machine in the field would.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from crane_exudyn import geometry
from crane_exudyn import hydraulics as hyd
from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.parameters import CYLINDER, CYLINDERS, N_CYLINDER

_DEGREES = np.radians(np.arange(-180.0, 90.0, 0.5))


@dataclass
class Now:
    """What a law sees and may change before a step: SI.

    Attributes:
        time: start of the step, s.
        state: (nx,) state there; not to be changed.
        P, E: flat vectors of nominal and effect parameters for this step.
        w0, w1: (12,) inputs [U1 U2 pp pt] and disturbances at the start and the end of the step.
        lengths: pin-to-pin lengths (s1, s2) in m.
    """

    time: float
    state: np.ndarray
    P: np.ndarray
    E: np.ndarray
    w0: np.ndarray
    w1: np.ndarray
    lengths: tuple[float, float]


Law = Callable[[Now], None]


class LawfulEngine(ExudynEngine):
    """An Exudyn engine for one crane that lets laws change parameters and inputs before every step.

    Args:
        crane: the crane, with the library's effects that it has.
        laws: applied in order, each step anew from the crane's own parameters.
    """

    def __init__(self, crane: Crane, laws: Sequence[Law] = ()) -> None:
        super().__init__(crane)
        self._laws = tuple(laws)
        self._own = (crane.parameter_vector(), crane.effect_vector())
        self._table = _length_tables(crane)

    def _step(
        self,
        x: np.ndarray,
        w0: np.ndarray,
        w1: np.ndarray,
        h: float,
        time: float,
        halved: int = 0,
        P: np.ndarray | None = None,
        E: np.ndarray | None = None,
    ) -> np.ndarray:
        if halved or not self._laws:
            return super()._step(x, w0, w1, h, time, halved, P, E)
        now = self._now(x[0], w0[0].copy(), w1[0].copy(), time)
        for law in self._laws:
            law(now)
        return super()._step(x, now.w0[None], now.w1[None], h, time, halved, now.P[None], now.E[None])

    def _now(self, state: np.ndarray, w0: np.ndarray, w1: np.ndarray, time: float) -> Now:
        z1, z4, s1, s2 = self._table
        lengths = float(np.interp(state[0], z1, s1)), float(np.interp(state[1], z4, s2))
        return Now(time, state, self._own[0].copy(), self._own[1].copy(), w0, w1, lengths)


def _length_tables(crane: Crane) -> tuple[np.ndarray, ...]:
    """Return (z1, z4, s1 at z1, s2 at z4): each cylinder's length depends on one angle only."""
    angles = _DEGREES[_DEGREES < math.radians(20.0)]
    s1 = geometry.pose(crane, _DEGREES, np.full_like(_DEGREES, math.radians(-45.0))).lengths[:, 0]
    s2 = geometry.pose(crane, np.zeros_like(angles), angles).lengths[:, 1]
    return _DEGREES, angles, s1, s2


# -- laws that no effect file has -------------------------------------------------------------------------------------


def scored_bore(cylinder: int, force: float, middle: float, width: float) -> Law:
    """Return a law: the bore is scored over part of the stroke, where the seal rubs harder.

    Adds `force` N times exp(-((s - middle)/width)²) to Coulomb and static friction of the cylinder; lengths in m.
    """

    def law(now: Now) -> None:
        added = force * math.exp(-(((now.lengths[cylinder] - middle) / width) ** 2))
        k = CYLINDER + N_CYLINDER * cylinder
        now.P[k + hyd.FC] += added
        now.P[k + hyd.FS] += added

    return law


def hunting_pump(pressure: float, share: float, frequency: float, phase: float) -> Law:
    """Return a law: the pump's pressure controller hunts, pp = pressure (1 + share sin(2π f t + phase)) whatever flows."""

    def law(now: Now) -> None:
        now.w0[2] = now.w1[2] = pressure * (1.0 + share * math.sin(2.0 * math.pi * frequency * now.time + phase))

    return law


LAWS = ("scored_bore", "hunting_pump")


def draw_law(
    name: str, crane: Crane, rng: np.random.Generator, visited: Mapping[str, np.ndarray]
) -> tuple[Law, dict[str, Any]]:
    """Return a law of LAWS with random severity and what describes it.

    Args:
        name: of the law.
        crane: the plant.
        rng: source of the draws.
        visited: "s1" and "s2" along the manoeuvre, m; a scored place is worthless where the cylinder never comes by.
    """
    if name == "hunting_pump":
        share, frequency, phase = rng.uniform(0.04, 0.2), rng.uniform(0.25, 2.0), rng.uniform(0.0, 2.0 * math.pi)
        told: dict[str, Any] = {"share": share, "frequency": frequency, "phase": phase}
        return hunting_pump(crane["supply.pump_pressure"], share, frequency, phase), told
    cylinder = int(rng.integers(2))
    low, high = np.quantile(visited[f"s{cylinder + 1}"], [0.15, 0.85])
    force, middle = float(np.exp(rng.uniform(*np.log([1500.0, 9000.0])))), float(rng.uniform(low, high))
    width = float(rng.uniform(0.08, 0.25) * max(high - low, 0.05))
    told = {"cylinder": CYLINDERS[cylinder], "force": force, "middle": middle, "width": width}
    return scored_bore(cylinder, force, middle, width), told
