"""Cross-check of the two engines: every intermediate quantity first, then the static start, then trajectories.

The engines share the crane file and the effects' definitions, and no equation. What one gets wrong the other must get
wrong in the same way to hide it. Quantities are compared in the order in which one follows from another, so that the
first that differs names the fault.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np

from crane_exudyn.crane import Crane, checked_crane
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError, names_of, nearest
from crane_exudyn.geometry import pose_text
from crane_exudyn.hydraulics import vapour_pressure
from crane_exudyn.inputs import paper_cycle
from crane_exudyn.layout import Layout
from crane_exudyn.simulation import initial_state
from crane_exudyn.statics import visible

from . import crosscheck_cases as cases

if TYPE_CHECKING:
    from matplotlib.figure import Figure


class Engine(Protocol):
    """What a cross-check needs of an engine."""

    crane: Crane
    accuracy: float

    @property
    def state_names(self) -> tuple[str, ...]: ...

    def static_start(self, *pose: Any, less_loaded: Any = 20e5) -> np.ndarray: ...

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, *, step: float = 1e-3) -> np.ndarray: ...

    def terms(self, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]: ...


Make = Callable[[Crane], Engine]
#: gives time (n,) in s and commands (n, valves) of a manoeuvre
Given = Callable[[], tuple[np.ndarray, np.ndarray]]
#: takes the fraction done, and what is being done
Progress = Callable[[float, str], None]

#: inner step at which trajectories are judged, and the falling steps (of inputs sampled at the first) for the order
FINE_STEP = 1e-4
ORDER_STEPS = (4e-3, 2e-3, 1e-3)
#: what moves by less than this, rad and Pa, stands still
NOISE = (1e-9, 1.0)
#: what Newton's methods leave of a pressure in a step, Pa (`trapezoidal.TOLERANCE`; the other engine leaves less). Over
#: n steps it adds up as a random walk does, to √n times as much, and does not fall with the step. A difference is that
#: of the rules where it is so many times larger
LEFT, CLEARLY = 0.01, 4.0
#: rad (or m): a larger difference of positions is none that Newton's methods leave
MOST_LEFT = 1e-7
#: work of an effect, and of a second of both manoeuvres, in seconds of run with steps of 1 ms
_EFFECT, _MANOEUVRE = 12.0, 48.0
#: largest accepted differences at the finest step: rad (or m), and share of a pressure's range, which is taken to be at
#: least so many Pa
FINE, _LEAST = (1e-6, 1e-4), 1e4
#: largest accepted RMS differences of the engines along a run at their default accuracy, rad and Pa: what each promises
#: of itself
ALONG = (1e-5, 0.1e5)
#: shortest run that is compared, s: some steps of the coarsest
_SHORTEST = 0.1


@dataclass(frozen=True)
class Group:
    """Quantities that are judged alike.

    Attributes:
        text, unit: what they are.
        names: of the terms.
        tolerance: largest accepted difference relative to the quantity's largest value over the states.
        reason: why that much.
        floor: smallest value that the difference is taken relative to, in SI: rounding of what the quantity is a sum
            of.
        angle: whether values that differ by full turns are equal.
    """

    text: str
    unit: str
    names: tuple[str, ...]
    tolerance: float
    reason: str
    floor: float = 0.0
    angle: bool = False


ROUNDING = "rounding of closed forms"


def groups_of(crane: Crane) -> tuple[Group, ...]:
    """Return what is compared of a machine, in the order in which one quantity follows from another."""
    lay, machine = crane.layout, crane.machine
    z, dependent = lay.coordinates, [machine.carriers[body].coordinate for body in machine.dependent]

    def chamber(prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}{i + 1}" for i in range(len(lay.chambers)))

    def cylinder(prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}{i + 1}" for i in range(len(lay.cylinders)))

    def each(prefix: str) -> tuple[str, ...]:
        return tuple(f"{prefix}_{name}" for name in z)

    mass = tuple(f"M_{z[i]}_{z[j]}" for i in range(len(z)) for j in range(i, len(z)))
    angles = (*(f"phi_{body}" for body in machine.bodies), *dependent)
    loop = tuple(f"d{a}_d{b}" for a in dependent for b in z)
    return (
        Group("joints", "m", tuple(f"{a}_{p}" for p in machine.point_names for a in "xy"), 1e-9, ROUNDING, 1.0),
        Group("angles of bodies", "rad", angles, 1e-9, ROUNDING, 1.0, angle=True),
        Group("loop Jacobian", "-", loop, 1e-9, ROUNDING, 1.0),
        Group("cylinder lengths", "m", lay.lengths, 1e-9, ROUNDING),
        Group("cylinder rates", "m/s", tuple(f"d{s}" for s in lay.lengths), 1e-9, ROUNDING, 1e-2),
        Group("chamber volumes", "m^3", chamber("V"), 1e-9, ROUNDING),
        Group("amounts of oil", "m^3", chamber("N"), 1e-9, ROUNDING),
        Group("bulk moduli", "Pa", chamber("Be"), 1e-9, ROUNDING),
        Group("supply pressures", "Pa", lay.supply, 1e-9, "iterated to rounding", 1e5),
        Group("port flows", "m^3/s", chamber("Q"), 1e-9, "root of an iterated drop", 1e-5),
        Group("leakages", "m^3/s", chamber("leak"), 1e-9, ROUNDING, 1e-7),
        Group("friction forces", "N", cylinder("Fmu"), 1e-9, ROUNDING, 10.0),
        Group("cylinder forces", "N", cylinder("F"), 1e-9, ROUNDING, 1e3),
        Group("pressure rates", "Pa/s", tuple(f"d{p}" for p in lay.chambers), 1e-9, ROUNDING, 1e6),
        Group("mass matrix", "kg m^2", mass, 1e-9, ROUNDING, 1.0),
        Group("gravity forces", "N m", each("Qg"), 1e-9, ROUNDING, 10.0),
        Group("velocity forces", "N m", each("Qv"), 1e-9, ROUNDING, 10.0),
        Group("hydraulic forces", "N m", each("Qh"), 1e-9, ROUNDING, 100.0),
        Group("joint and tip forces", "N m", each("Qj"), 1e-9, ROUNDING, 10.0),
        Group("accelerations", "rad/s^2", tuple(f"dd{n}" for n in z), 1e-8, "rounding times a condition", 0.1),
    )


def split_by_pendulum(crane: Crane) -> tuple[str, ...]:
    """Return terms of a payload on a pendulum that each engine may split differently between M and Q; their sum, ddz,
    is compared.
    """
    names = ("mass matrix", "gravity forces", "velocity forces", "joint and tip forces")
    return tuple(n for group in groups_of(crane) if group.text in names for n in group.names)


@dataclass(frozen=True)
class Quantity:
    """One line of the result.

    Attributes:
        name: of the quantity; of another crane or an effect with that name before a colon.
        max_abs: largest difference, SI.
        relative: the same, relative to the quantity's size; this is what the tolerance is for unless `absolute`.
        tolerance, reason: how much is accepted, and why.
        place: where the difference is largest, in words.
        absolute: whether the tolerance is for max_abs.
        refused: why it could not be run, so that nothing was compared; "" where it was.
    """

    name: str
    unit: str
    max_abs: float
    relative: float
    tolerance: float
    reason: str
    place: str = ""
    absolute: bool = False
    refused: str = ""

    @classmethod
    def not_run(cls, name: str, problem: CraneError) -> Quantity:
        """Return the line of what could not be run."""
        return cls(name, "-", math.nan, math.nan, math.nan, f"could not be run: {problem}", refused=str(problem))

    @property
    def ok(self) -> bool:
        """Whether the difference is within tolerance; what is not a number never is."""
        return bool((self.max_abs if self.absolute else self.relative) <= self.tolerance)


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


@dataclass
class CrossCheck:
    """The whole result; `quantities` in the order of comparison."""

    crane: str
    layout: Layout
    quantities: list[Quantity] = field(default_factory=list)
    runs: list[Run] = field(default_factory=list)

    @property
    def ok(self) -> bool:
        """Whether everything could be run and is within its tolerance."""
        return all(q.ok for q in self.quantities)

    @property
    def failures(self) -> list[Quantity]:
        """What is out of tolerance; the first is nearest to the cause."""
        return [q for q in self.quantities if not q.ok and not q.refused]

    @property
    def not_run(self) -> list[Quantity]:
        """What could not be run; of it nothing is known."""
        return [q for q in self.quantities if q.refused]

    def to_dict(self) -> dict[str, Any]:
        """Return the machine-readable result."""
        return {
            "crane": self.crane,
            "quantities": {
                q.name: {"max_abs": q.max_abs, "relative": q.relative, "tolerance": q.tolerance, "ok": q.ok,
                         "unit": q.unit, "reason": q.reason, "run": not q.refused}
                for q in self.quantities
            },
            "ok": self.ok,
        }  # fmt: skip

    def __repr__(self) -> str:
        verdict = "differ first in " + self.failures[0].name if self.failures else "agree"
        unknown = f"; {len(self.not_run)} could not be run" if self.not_run else ""
        return f"<CrossCheck of {self.crane}: {len(self.quantities)} quantities, the engines {verdict}{unknown}>"


# -- quantities ------------------------------------------------------------------------------------------------------


def compare_terms(first: Engine, second: Engine, states: cases.States, *, skip: Sequence[str] = ()) -> list[Quantity]:
    """Return one Quantity a term, over all states, in the order of `groups_of`."""
    rows = [
        (first.terms(x, w, t), second.terms(x, w, t)) for x, w, t in zip(states.x, states.w, states.time, strict=True)
    ]
    out = []
    for group in groups_of(first.crane):
        for name in group.names:
            if name not in skip:
                values = np.array([(a.get(name, math.nan), b.get(name, math.nan)) for a, b in rows])
                out.append(_judge(first.crane.layout, group, name, values, states))
    return out


def _judge(layout: Layout, group: Group, name: str, values: np.ndarray, states: cases.States) -> Quantity:
    difference = values[:, 0] - values[:, 1]
    if group.angle:
        difference = np.remainder(difference + math.pi, math.tau) - math.pi
    size = np.abs(difference)
    worst = int(np.argmax(np.where(np.isnan(size), np.inf, size)))
    scale = max(float(np.nanmax(np.abs(values), initial=0.0)), group.floor, 1e-300)
    place = pose_text(layout, states.x[worst])
    worst_size = float(size[worst])
    return Quantity(name, group.unit, worst_size, worst_size / scale, group.tolerance, group.reason, place)


def worst_of(name: str, quantities: Sequence[Quantity]) -> Quantity:
    """Return one line for many: the first that is out of tolerance, or else the one that uses most of its own."""
    failing = [q for q in quantities if not q.ok]
    worst = failing[0] if failing else max(quantities, key=lambda q: q.relative / q.tolerance)
    return replace(worst, name=name, place=f"{worst.name}, {worst.place}")


def compare_static_starts(first: Engine, second: Engine, states: cases.States) -> list[Quantity]:
    """Return the pressures of the static start, compared over the poses of the states."""
    lay, pressures = first.crane.layout, []
    for x in states.x:
        pose = x[lay.positions].tolist()
        pressures.append([e.static_start(*pose)[lay.pressures] for e in (first, second)])
    values = np.array(pressures)
    reason = ROUNDING
    group = Group("static start", "Pa", (), 1e-9, reason, 1e5)
    out = []
    for i, name in enumerate(lay.chambers):
        q = _judge(lay, group, f"static start: {name}", values[:, :, i], states)
        out.append(q)
    return out


def acts(engine: Engine, states: cases.States) -> bool:
    """Whether the effects of an engine's crane change any term at any of the states."""
    from .semi_recursive import SemiRecursiveEngine

    neutral = SemiRecursiveEngine(engine.crane.nominal())
    for x, w, t in zip(states.x, states.w, states.time, strict=True):
        with_it, without = engine.terms(x, w, t), neutral.terms(x[engine.crane.layout.basic], w, t)
        if any(with_it[n] != without[n] for n in with_it.keys() & without.keys()):
            return True
    return False


# -- trajectories ----------------------------------------------------------------------------------------------------


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


# -- all of it -------------------------------------------------------------------------------------------------------


def crosscheck(
    crane: Crane,
    *,
    states: int = 200,
    seconds: float = 25.0,
    step: float = FINE_STEP,
    seed: int = 1,
    make_first: Make | None = None,
    make_second: Make | None = None,
    effects: Collection[str] | None = None,
    without: Collection[str] = (),
    progress: Progress = lambda fraction, part: None,
) -> CrossCheck:
    """Return the comparison of the Exudyn engine (first) with the semi-recursive one (second) on a crane and its kin.

    Args:
        crane: with its effects.
        states: random states for the crane itself; a fifth of that for each effect and each other crane.
        seconds: length of the runs.
        step: inner step at which trajectories are judged.
        seed: of everything random.
        make_first, make_second: other engines.
        effects: those ("name@place") that are put into the crane one at a time and run in both engines, which takes
            most of the time; by default all that act inside an engine.
        without: those of them that are left out, at one place ("name@place") or at all ("name").
        progress: is called with the fraction done and with what is being compared.

    What cannot be run, such as a machine too stiff with an effect, is a line of the result that tells why.

    Raises:
        CraneError: no states or no time to compare in, or an effect that the crane cannot have, or that acts in no
            engine.
    """
    crane = checked_crane(crane, "crosscheck")
    _check_extent(states, seconds, step)
    make_first, make_second = make_first or _exudyn, make_second or _semi_recursive
    probes = _probes(crane.nominal(), effects, without)
    rng = np.random.default_rng(seed)
    result = CrossCheck(crane.name, crane.layout)
    first, second = make_first(crane), make_second(crane)
    progress(0.0, "quantities at random states")
    drawn = cases.random_states(crane, states, rng)
    skip = split_by_pendulum(crane) if len(second.state_names) > len(crane.layout.states) else ()
    result.quantities += compare_terms(first, second, drawn, skip=skip)
    result.quantities += _each("static start", lambda: compare_static_starts(first, second, drawn))
    fewer = max(40, states // 5)  # enough that every probe acts in some
    progress(0.03, "other cranes")
    result.quantities += _each(
        "other cranes", lambda: _others(cases.other_cranes(crane.nominal(), rng), make_first, make_second, fewer, rng)
    )
    work = _EFFECT * len(probes), _MANOEUVRE * seconds
    until = 0.05 + 0.95 * work[0] / sum(work)
    for k, (key, probe) in enumerate(probes.items()):
        progress(0.05 + (until - 0.05) * k / len(probes), key)
        result.quantities += _effect(key, probe, make_first, make_second, fewer, rng)
    known = manoeuvres(crane, second, seconds, rng)
    _run_manoeuvres(result, known, first, second, step, partial(_within, progress, until, 1.0 - until))
    progress(1.0, "")
    return result


def _run_manoeuvres(
    result: CrossCheck, known: Mapping[str, Given], first: Engine, second: Engine, step: float, progress: Progress
) -> None:
    """Add to a result what manoeuvres bring, by name, and their runs."""
    share = 1.0 / len(known)
    for k, (name, given) in enumerate(known.items()):
        progress(share * k, name)
        found, runs = _manoeuvre(name, given, first, second, step, partial(_within, progress, share * k, share))
        result.quantities += found
        result.runs += runs


def _check_extent(states: int, seconds: float, step: float) -> None:
    """Raise CraneError where there is nothing to compare."""
    if not (states >= 1 and states == int(states)):
        raise CraneError(
            f"crosscheck: states = {states} compares nothing. Give a whole number of random states, such as 200."
        )
    if not (seconds >= _SHORTEST and step > 0.0):
        raise CraneError(
            f"crosscheck: runs of {seconds:g} s with steps of {step:g} s cannot be compared. Give at least "
            f"{_SHORTEST:g} s, and a positive step."
        )


def _within(progress: Progress, begin: float, share: float, fraction: float, part: str) -> None:
    """Tell the progress of a part of the work."""
    progress(begin + share * fraction, part)


def _each(name: str, compare: Callable[[], list[Quantity]]) -> list[Quantity]:
    """Return what a comparison finds, or the one line that it could not be run, and why."""
    try:
        return compare()
    except CraneError as problem:
        return [Quantity.not_run(name, problem)]


def _exudyn(crane: Crane) -> Engine:
    from crane_exudyn.engine import ExudynEngine

    return ExudynEngine(crane)


def _semi_recursive(crane: Crane) -> Engine:
    from .semi_recursive import SemiRecursiveEngine

    return SemiRecursiveEngine(crane)


def _others(
    others: Mapping[str, Crane], make_first: Make, make_second: Make, count: int, rng: np.random.Generator
) -> list[Quantity]:
    """Return the worst quantity of each of other cranes."""

    def worst(name: str, other: Crane) -> list[Quantity]:
        first, second = make_first(other), make_second(other)
        drawn = cases.random_states(other, count, rng)
        return [worst_of(name, [*compare_terms(first, second, drawn), *compare_static_starts(first, second, drawn)])]

    return [quantity for name, other in others.items() for quantity in _each(name, partial(worst, name, other))]


def _probes(crane: Crane, effects: Collection[str] | None, without: Collection[str] = ()) -> dict[str, Crane]:
    """Return the cranes with the effects that were asked for, all of them for None, without those left out."""
    known = cases.effect_probes(crane)
    effects, without = effects if effects is None else names_of(effects, "effects"), names_of(without, "without")
    for key in effects or ():
        if key not in known:
            raise CraneError(f"There is no effect {key!r} to run in the engines.{nearest(key, list(known))}")
    names = dict.fromkeys(key.partition("@")[0] for key in known)
    for key in without:
        if key not in known and key not in names:
            raise CraneError(f"There is no effect {key!r} to leave out.{nearest(key, [*names, *known])}")
    wanted = known if effects is None else effects
    return {k: known[k] for k in known if k in wanted and k not in without and k.partition("@")[0] not in without}


def _effect(
    key: str, probe: Crane, make_first: Make, make_second: Make, count: int, rng: np.random.Generator
) -> list[Quantity]:
    """Return the worst quantity of a crane with an effect, and how far a run comes apart; an effect that changes
    nothing is a failure.
    """
    try:
        engines = make_first(probe), make_second(probe)
    except CraneError as problem:
        return [Quantity.not_run(key, problem)]
    return [
        *_each(key, lambda: [check_effect(key, *engines, count, rng)]),
        *_each(_along(key), lambda: [run_effect(key, probe, make_first, make_second)]),
    ]


def _along(key: str) -> str:
    return f"{key}, along 5 s"


def check_effect(key: str, first: Engine, second: Engine, count: int, rng: np.random.Generator) -> Quantity:
    """Return the worst quantity of two engines whose crane has an effect, over `count` states drawn for the crane
    without it.

    Static starts are among the quantities: what an effect holds at rest is not in the pressures.

    An effect that changes no quantity at any of these states would prove nothing, so it is out of tolerance.
    """
    nominal, effect = second.crane.nominal(), registry.split_key(key)[0]
    drawn = cases.random_states(cases.without_short_strokes(nominal) if effect.beyond_stroke else nominal, count, rng)
    added = len(second.state_names) - len(nominal.layout.states)
    if added:
        drawn = cases.States(np.column_stack([drawn.x, rng.normal(0.0, 0.4, (count, added))]), drawn.w, drawn.time)
    quantities = compare_terms(first, second, drawn, skip=split_by_pendulum(nominal) if added else ())
    if not effect.beyond_stroke:  # whose poses are beyond the ends
        quantities += compare_static_starts(first, second, drawn)
    worst = worst_of(key, quantities)
    if worst.ok and not acts(second, drawn):
        reason = "the effect changed no quantity at any state, so nothing was compared"
        return Quantity(key, "-", math.nan, math.nan, worst.tolerance, reason)
    return worst


def run_effect(key: str, probe: Crane, make_first: Make, make_second: Make) -> Quantity:
    """Return how far two engines come apart along 5 s that excite the effect of a crane.

    A machine for which the usual commands are too much, so that a cylinder comes to its end or strikes a stop too hard
    to be computed, is driven gently.

    Raises:
        CraneError: an engine cannot run it even so.
    """
    effect, place = registry.split_key(key)
    crane = cases.without_short_strokes(probe) if effect.beyond_stroke else probe
    first, second = make_first(crane), make_second(crane)
    x0 = initial_state(crane, second)

    def apart(*, gently: bool) -> np.ndarray:
        time, w = cases.exciting(crane, place if effect.beyond_stroke else "", gently=gently)
        return visible(crane, first.simulate(x0, time, w)) - visible(crane, second.simulate(x0, time, w))

    try:
        difference, how = apart(gently=False), ""
    except CraneError:
        difference, how = apart(gently=True), ", driven gently"
    angles, pressures = (
        float(np.sqrt(np.mean(difference[:, c] ** 2))) for c in (crane.layout.positions, crane.layout.pressures)
    )
    share = max(angles / ALONG[0], pressures / ALONG[1])
    reason = f"{angles:.1e} rad and {pressures / 1e5:.1e} bar (RMS) of {ALONG[0]:g} rad and {ALONG[1] / 1e5:g} bar"
    return Quantity(_along(key), "-", share, share, 1.0, reason + how)


def manoeuvres(crane: Crane, engine: Engine, seconds: float, rng: np.random.Generator) -> dict[str, Given]:
    """Return what gives time and commands of the paper's cycle, kept off the ends of the strokes, and of random
    joystick inputs, by name.
    """

    def cycle() -> tuple[np.ndarray, np.ndarray]:
        time = np.arange(round(seconds / cases.SAMPLE) + 1) * cases.SAMPLE
        return time, cases.kept_off_ends(crane, time, paper_cycle(time, len(crane.layout.cylinders)))

    def joystick() -> tuple[np.ndarray, np.ndarray]:
        return cases.joystick(crane, initial_state(crane, engine), seconds, rng)

    return {"paper's cycle": cycle, "random joystick": joystick}


def _manoeuvre(
    name: str, given: Given, first: Engine, second: Engine, step: float, progress: Progress
) -> tuple[list[Quantity], list[Run]]:
    """Return quantities and runs of a manoeuvre, or the one line that it could not be run."""
    try:
        time, commands = given()
        w = cases.spool_inputs(first.crane, time, commands)
        return compare_runs(name, first, second, time, w, step, progress)
    except CraneError as problem:
        return [Quantity.not_run(name, problem)], []


# -- pictures --------------------------------------------------------------------------------------------------------


def figure_of(layout: Layout, runs: Sequence[Run]) -> Figure:
    """Return a figure of one manoeuvre: both engines on top of each other, and below each their difference at every
    step.
    """
    from . import plots

    columns = {name: layout.index(name) for name in (*layout.coordinates, *layout.chambers)}
    last = runs[-1]
    made = plots.figure(2 * len(columns), height=1.0)
    for row, (name, i) in enumerate(columns.items()):
        above, below = made.axes[2 * row], made.axes[2 * row + 1]
        lines = {"Exudyn": last.first[:, i], "semi-recursive": last.second[:, i]}
        plots.draw_lines(above, last.time, lines, channel=name, layout=layout)
        what = plots.shown(name, layout=layout)
        for k, run in enumerate(runs):
            t, y = plots.thin(run.time, np.abs(run.first - run.second)[:, i] * what.factor)
            below.semilogy(t, np.maximum(y, 1e-16), label=f"difference, {1e3 * run.step:g} ms", **plots.look("", k))
        plots.plain_powers(below.yaxis)
        plots.name_axes(below, what._replace(words=f"{what.words}: difference", symbol=f"|Δ{what.symbol}|"))
    if last.boils < len(last.time):
        for axes in made.axes:
            label = "vapour reached" if axes is made.axes[1] else ""
            axes.axvline(last.time[last.boils], color="0.6", linewidth=1.0, label=label)
    plots.over_time(made)
    return made


def save_figures(result: CrossCheck, directory: Path) -> list[Path]:
    """Write one picture a manoeuvre to `directory` and return their paths."""
    from . import plots

    directory.mkdir(parents=True, exist_ok=True)
    paths = []
    for name, runs in by_name(result.runs).items():
        path = directory / f"crosscheck-{name.replace(' ', '-').replace(chr(39), '')}.png"
        plots.save(figure_of(result.layout, runs), path)
        paths.append(path)
    return paths


def by_name(runs: Sequence[Run]) -> Mapping[str, list[Run]]:
    """Return the runs of each manoeuvre."""
    found: dict[str, list[Run]] = {}
    for run in runs:
        found.setdefault(run.name, []).append(run)
    return found
