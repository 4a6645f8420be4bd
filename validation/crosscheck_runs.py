"""Trajectories of both engines from the same start: how far they come apart, and how that falls with the step."""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from crane_exudyn.hydraulics import vapour_pressure
from crane_exudyn.layout import Layout
from crane_exudyn.simulation import initial_state
from crane_exudyn.statics import visible

from .crosscheck_quantities import Engine, Quantity

#: takes the fraction done, and what is being done
Progress = Callable[[float, str], None]

#: falling inner steps (of inputs sampled at the first) for the order
ORDER_STEPS = (4e-3, 2e-3, 1e-3)
#: what moves by less than this, rad and Pa, stands still
NOISE = (1e-9, 1.0)
#: what Newton's methods leave of a pressure in a step, Pa (`trapezoidal.TOLERANCE`; the other engine leaves less). Over
#: n steps it adds up as a random walk does, to √n times as much, and does not fall with the step. A difference is that
#: of the rules where it is so many times larger
LEFT, CLEARLY = 0.01, 4.0
#: rad (or m): a larger difference of positions is none that Newton's methods leave
MOST_LEFT = 1e-7
#: largest accepted differences at the finest step: rad (or m), and share of a pressure's range, which is taken to be at
#: least so many Pa
FINE, _LEAST = (1e-6, 1e-4), 1e4
#: largest accepted RMS differences of the engines along a run at their default accuracy, rad and Pa: what each promises
#: of itself
ALONG = (1e-5, 0.1e5)


@dataclass(frozen=True)
class Run:
    """A trajectory of both engines: states (n, nx) at time (n,) with one inner step.

    Pressures are those in the chambers; `boils` is the index of the first sample with a chamber at vapour pressure, n
    where there is none.
    """

    name: str
    step: float
    time: np.ndarray
    first: np.ndarray
    second: np.ndarray
    boils: int


def compare_runs(
    name: str, first: Engine, second: Engine, time: np.ndarray, w: np.ndarray, step: float, progress: Progress
) -> tuple[list[Quantity], list[Run]]:
    """Return quantities and runs of both engines from the static start of the crane file.

    The difference must fall with the square of the step, and at `step` be below 1e-6 rad and 1e-4 of the pressures'
    ranges, or below what the rule itself errs by at that step: two forms of it need not be closer. What does not move
    has no order.
    """
    crane = first.crane
    x0 = initial_state(crane, second)

    first, second = _as_asked(first), _as_asked(second)

    def run(t: np.ndarray, inputs: np.ndarray, h: float) -> Run:
        one, other = (visible(crane, e.simulate(x0, t, inputs, step=h)) for e in (first, second))
        boiling = np.flatnonzero(
            (other[:, crane.layout.pressures] <= vapour_pressure(crane.parameter_vector())).any(axis=1)
        )
        return Run(name, h, t, one, other, int(boiling[0]) if boiling.size else len(t))

    coarse = round(ORDER_STEPS[0] / (time[1] - time[0]))
    runs = [run(time[::coarse], w[::coarse], h) for h in ORDER_STEPS]
    progress(0.15, name)
    fine = run(time, w, step)
    progress(1.0, name)
    moving = _moving(fine, crane.layout)
    orders = [q for q, moves in zip(convergence_orders(crane.layout, runs), moving, strict=True) if moves]
    found = _final_differences(fine, crane.layout)
    if not all(q.ok for q in found):  # a lively machine: the rule itself errs by more
        twice = visible(crane, second.simulate(x0, time, w, step=2.0 * step))
        found = _final_differences(fine, crane.layout, np.abs(twice - fine.second) / 3.0)  # of order two
    return [*orders, *found], [*runs, fine]


def _moving(run: Run, layout: Layout) -> list[bool]:
    """Return whether positions, and pressures, move along a run by more than what Newton's methods leave."""
    reach = np.maximum(np.ptp(run.first, axis=0), np.ptp(run.second, axis=0))
    parts = zip((layout.positions, layout.pressures), NOISE, strict=True)
    return [not (reach[columns] <= noise).all() for columns, noise in parts]


def _as_asked(engine: Engine) -> Engine:
    """Return the engine with steps as they are asked for, however large their local error."""
    taken = copy.copy(engine)
    taken.accuracy = math.inf
    return taken


def convergence_orders(layout: Layout, runs: Sequence[Run]) -> list[Quantity]:
    """Return how far the order of the difference in the step is below 2, for positions and pressures: two forms of one
    rule.

    The order is that between the coarsest and the finest step at which the difference is clearly more than what
    Newton's methods leave; where there are no two such steps, none can be told. A difference that is nothing at all is
    not that of two engines.
    """
    parts = (("positions", layout.positions), ("pressures", layout.pressures))
    sizes = {
        text: np.array([math.sqrt(np.mean((r.first - r.second)[:, columns] ** 2)) for r in runs])
        for text, columns in parts
    }
    steps, spans = np.array([r.step for r in runs]), np.array([r.time[-1] - r.time[0] for r in runs])
    left = CLEARLY * LEFT * np.sqrt(spans / steps)
    with np.errstate(divide="ignore", invalid="ignore"):
        moved = left * sizes["positions"] / sizes["pressures"]  # positions drift with the pressures, in this motion
    floors = {"positions": np.fmin(moved, MOST_LEFT), "pressures": left}
    return [
        Quantity(f"{runs[0].name}: order of {text}", "-", off, off / 2.0, 0.2, reason, absolute=True)
        for text, _ in parts
        for off, reason in [_order_below_two(steps, sizes[text], floors[text])]
    ]


def _order_below_two(steps: np.ndarray, sizes: np.ndarray, floors: np.ndarray) -> tuple[float, str]:
    """Return how far the order of differences (n,) at falling steps (n,) is below 2, and what there is to say of it;
    what is no more than its floor (n,) says nothing.
    """
    if not (sizes > 0.0).all():
        return math.nan, "there is no difference, as if both were the same engine"
    clear = np.flatnonzero(~(sizes <= floors))
    if clear.size < 2:
        return 0.0, f"{sizes[0]:.1e} to {sizes[-1]:.1e} is about the remaining error of Newton's methods"
    first, last = clear[0], clear[-1]
    order = math.log(sizes[first] / sizes[last]) / math.log(steps[first] / steps[last])
    between = f"from {1e3 * steps[first]:g} to {1e3 * steps[last]:g} ms"
    return max(2.0 - order, 0.0), f"found {order:.2f} {between}; kinks of the laws leave some room"


def _final_differences(run: Run, layout: Layout, own: np.ndarray | None = None) -> list[Quantity]:
    """Return the largest differences of positions (absolute) and pressures (relative to their range) along a run; of a
    pressure that hardly moves, as much is accepted as Newton's methods leave.

    Args:
        run: at the finest step.
        layout: of the machine.
        own: (n, nx) errors of the rule itself at that step, where they are known: the largest of a state is accepted,
            up to what an engine promises of itself.
    """
    out = []
    difference = np.abs(run.first - run.second)
    reach = np.ptp(run.second, axis=0)
    for i, name in enumerate(layout.all_states[: difference.shape[1]]):
        unit = layout.unit_of(name)
        if unit.endswith("/s"):
            continue
        worst = int(np.argmax(np.where(np.isnan(difference[:, i]), np.inf, difference[:, i])))
        size, range_ = float(difference[worst, i]), max(float(reach[i]), _LEAST if unit == "Pa" else 1e-12)
        reason = f"two forms of one rule, steps of {1e3 * run.step:g} ms"
        usual = FINE[1] * range_ if unit == "Pa" else FINE[0]
        errs = 0.0 if own is None else min(float(np.max(own[:, i])), ALONG[unit == "Pa"])
        if errs > usual:
            reason += f", with which it errs by {errs:.1e} {unit} itself"
        tolerance, place = max(usual, errs), f"t = {run.time[worst]:.2f} s"
        if unit == "Pa":
            tolerance, reason = tolerance / range_, reason + ", of the range"
        name = f"{run.name}: {name}"
        out.append(Quantity(name, unit, size, size / range_, tolerance, reason, place, absolute=unit != "Pa"))
    return out
