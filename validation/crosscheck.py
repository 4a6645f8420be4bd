"""Cross-check of the two engines: every intermediate quantity first, then the static start, then trajectories.

The engines share the crane file and the effects' definitions, and no equation. What one gets wrong the other must get
wrong in the same way to hide it. Quantities are compared in the order in which one follows from another, so that the
first that differs names the fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane, checked_crane
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError, names_of, nearest
from crane_exudyn.inputs import paper_cycle
from crane_exudyn.layout import Layout
from crane_exudyn.simulation import initial_state
from crane_exudyn.statics import visible

from . import crosscheck_cases as cases
from .crosscheck_quantities import (
    Engine,
    Quantity,
    acts,
    compare_static_starts,
    compare_terms,
    split_by_pendulum,
    worst_of,
)
from .crosscheck_runs import ALONG, Progress, Run, compare_runs

Make = Callable[[Crane], Engine]
#: gives time (n,) in s and commands (n, valves) of a manoeuvre
Given = Callable[[], tuple[np.ndarray, np.ndarray]]

#: inner step at which trajectories are judged
FINE_STEP = 1e-4
#: work of an effect, and of a second of both manoeuvres, in seconds of run with steps of 1 ms
_EFFECT, _MANOEUVRE = 12.0, 48.0
#: shortest run that is compared, s: some steps of the coarsest
_SHORTEST = 0.1


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
