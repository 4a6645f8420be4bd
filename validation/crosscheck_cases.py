"""What a cross-check is run on: random feasible states, other cranes, probes of every effect, random joystick
inputs.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import COMMANDING, SENSING
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import cylinder_lengths
from crane_exudyn.hydraulics import vapour_pressure
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.simulation import initial_state
from crane_exudyn.strokes import positions_in_strokes, run_while_possible, within_strokes

from .semi_recursive import SemiRecursiveEngine

#: hooks that act on a payload
OF_PAYLOAD = {"payload_mass", "pendulum", "tip_force"}
#: smallest chamber length of a random state, m
MARGIN = 0.03
SAMPLE = 1e-3
#: what a crane that is drawn at random has of the given one: two constants of nature, and what its gauges count from
_KEPT = ("gravity", "fluid.vapour_pressure", "supply.pressure_reference")
#: when probes of effects begin that begin at a time, s: within the run that excites them, and between samples
BEGIN = 2.5003
#: where end stops begin, and how far they are apart, as shares of the stroke: both in the range of random poses
_FIRST_STOP, _BETWEEN_STOPS = 0.35, 0.4
#: where a cylinder that is to strike gently slows down, as a share of the stroke before its end, and its command then
_NEAR, _GENTLY = 0.1, 0.3
#: how far from the start's coordinates random poses are looked for
_REACH = {"rad": 1.6, "m": 0.5}


def _short_strokes(crane: Crane) -> Crane:
    """Return the crane with strokes whose ends are in the range of random poses, for end stops."""
    changes: dict[str, float] = {}
    for c in crane.layout.cylinders:
        empty, stroke = f"cylinders.{c}.empty_length", f"cylinders.{c}.chamber_range"
        changes |= {empty: crane[empty] + _FIRST_STOP * crane[stroke], stroke: _BETWEEN_STOPS * crane[stroke]}
    return crane.with_parameters(changes)


def without_short_strokes(crane: Crane) -> Crane:
    """Return a crane of `effect_probes` with the strokes that it had before they were shortened."""
    changes: dict[str, float] = {}
    for c in crane.layout.cylinders:
        empty, stroke = f"cylinders.{c}.empty_length", f"cylinders.{c}.chamber_range"
        whole = crane[stroke] / _BETWEEN_STOPS
        changes |= {empty: crane[empty] - _FIRST_STOP * whole, stroke: whole}
    return crane.with_parameters(changes)


@dataclass(frozen=True)
class States:
    """Random states with inputs and times: x (n, nx), w (n, inputs), time (n,)."""

    x: np.ndarray
    w: np.ndarray
    time: np.ndarray

    def __len__(self) -> int:
        return len(self.x)


def random_states(crane: Crane, count: int, rng: np.random.Generator) -> States:
    """Return `count` states at which the loops close well and the cylinders are inside their strokes.

    Coordinates are uniform over what is feasible, rates normal with 0.3 rad/s, pressures uniform up to 1.5 times the
    pump's (in a third of the states up to a tenth of that, one in twenty at vapour pressure), spool positions uniform;
    half of the inputs carry measured supply pressures.

    Raises:
        CraneError: hardly any pose of this crane is feasible.
    """
    engine = SemiRecursiveEngine(crane)
    nx = len(engine.state_names)
    found: list[np.ndarray] = []
    for _ in range(200):
        x = _drawn(crane, nx, 4 * count, rng)
        found.extend(x[_feasible(engine, x)])
        if len(found) >= count:
            break
    else:
        raise CraneError(
            f"{crane.name}: only {len(found)} of {800 * count} random poses are feasible. Correct joints or strokes."
        )
    lay = crane.layout
    w = np.tile(lay.closed, (count, 1))
    w[:, lay.spools] = rng.uniform(-1, 1, (count, len(lay.commands)))
    measured = rng.random(count) < 0.5
    pump, tank = crane["supply.pump_pressure"], crane["supply.tank_pressure"]
    w[measured, lay.supplies] = np.array([pump, tank]) * rng.uniform(0.8, 1.2, (np.count_nonzero(measured), 2))
    return States(np.array(found[:count]), w, rng.uniform(0.0, 10.0, count))


def _drawn(crane: Crane, nx: int, count: int, rng: np.random.Generator) -> np.ndarray:
    lay, x = crane.layout, np.zeros((count, nx))
    z = x[:, lay.positions]
    reach = [_REACH[lay.unit_of(name)] for name in lay.coordinates]
    z[:] = np.array(crane.initial.pose) + reach * rng.uniform(-1.0, 1.0, z.shape)
    dz, p, added = x[:, lay.velocities], x[:, lay.pressures], x[:, lay.extra]
    dz[:] = rng.normal(0.0, 0.3, dz.shape)
    p[:] = rng.uniform(0.2e5, 1.5 * crane["supply.pump_pressure"], p.shape)
    p[rng.random(count) < 1.0 / 3.0] *= 0.1
    p[rng.random(p.shape) < 0.05] = vapour_pressure(crane.parameter_vector())
    added[:] = rng.normal(0.0, 0.4, added.shape)
    return x


def _feasible(engine: SemiRecursiveEngine, x: np.ndarray) -> np.ndarray:
    lay, machine = engine.crane.layout, engine.crane.machine
    good = _within_strokes(engine.crane, x[:, lay.positions])
    t = engine.terms_along(x[good], np.zeros((good.sum(), len(lay.inputs))), np.zeros(good.sum()))
    dependent = [f"d{machine.carriers[b].coordinate}_d{z}" for b in machine.dependent for z in lay.coordinates]
    with np.errstate(invalid="ignore"):
        loops = [np.abs(t[name]) < 5.0 for name in dependent]
        good[good] = np.all([_shortest_chamber(t) > MARGIN, *loops], axis=0)
    return good


def _within_strokes(crane: Crane, z: np.ndarray) -> np.ndarray:
    """Return which poses (m, n) all cylinders can have."""
    lengths = cylinder_lengths(crane, z)
    empty, range_ = (
        np.array([crane[f"cylinders.{c}.{n}"] for c in crane.layout.cylinders])
        for n in ("empty_length", "chamber_range")
    )
    with np.errstate(invalid="ignore"):
        return np.asarray(((lengths > empty) & (lengths < empty + range_)).all(axis=1))


def _shortest_chamber(terms: dict[str, np.ndarray]) -> np.ndarray:
    """Return the length of the shortest chamber (n,) of terms along states."""
    return np.min([values for name, values in terms.items() if name[0] == "l" and name[1:].isdigit()], axis=0)


def other_cranes(crane: Crane, rng: np.random.Generator) -> dict[str, Crane]:
    """Return cranes of other numbers: a longer boom with a heavier payload, and one drawn at random within
    feasibility.
    """
    body, point = crane.machine.payload
    kin = {"drawn at random": _drawn_crane(crane, rng)}
    if not body:
        return kin
    longer = crane.with_parameters(
        {
            f"{point}.x": crane[f"{point}.x"] + 0.4 * abs(crane[f"{point}.x"]),
            f"bodies.{body}.mass": 1.5 * crane[f"bodies.{body}.mass"],
            f"bodies.{body}.com.x": 1.7 * crane[f"bodies.{body}.com.x"],
            f"bodies.{body}.inertia": 3.0 * crane[f"bodies.{body}.inertia"],
            "payload.mass": 6.0 * crane["payload.mass"],
        }
    )
    return {"longer boom, heavier payload": longer} | kin


def _drawn_crane(crane: Crane, rng: np.random.Generator) -> Crane:
    """Return a crane with points moved by up to 40 mm and every quantity but gravity changed by up to 40 %."""
    for _ in range(100):
        changes = {}
        for name, value in crane.values.items():
            if name.endswith((".x", ".y")):
                changes[name] = value + rng.uniform(-0.04, 0.04)
            elif name not in _KEPT and not name.endswith(("empty_length", "chamber_range")):
                changes[name] = value * rng.uniform(0.6, 1.4)
        for c in crane.layout.cylinders:
            changes[f"cylinders.{c}.rod"] = changes[f"cylinders.{c}.bore"] * rng.uniform(0.3, 0.7)
        drawn = crane.with_parameters(changes)
        try:
            SemiRecursiveEngine(drawn).static_start(*drawn.initial.pose)
            random_states(drawn, 20, rng)
        except CraneError:
            continue
        return drawn
    raise CraneError(f"{crane.name}: no feasible crane was found near it in 100 draws. Give another crane or seed.")


def effect_probes(crane: Crane) -> dict[str, Crane]:
    """Return {"name@place": crane with that effect} for every effect that acts inside an engine, its parameters
    typical; curves at one place.
    """
    probes = {}
    for key in registry.all_keys(crane.layout):
        effect, _ = registry.split_key(key)
        if set(effect.hooks()) <= COMMANDING | SENSING or (effect.curve and key != effect.keys(crane.layout)[0]):
            continue  # a curve is one law wherever it acts
        base = crane
        if "pendulum" in effect.hooks() and crane["payload.mass"] <= 0.0:  # nothing would swing
            base = crane.with_parameters({"payload.mass": 100.0})
        if OF_PAYLOAD & set(effect.hooks()) and not crane.machine.payload[0]:
            continue
        if effect.beyond_stroke:  # bring both ends into the range of random states
            base = _short_strokes(crane)
        begins = {p.name: BEGIN for p in effect.parameters if p.moment}
        probes[key] = base.with_effect(key, {p.name: p.typical for p in effect.parameters} | begins)
    return probes


def exciting(crane: Crane, to_its_end: str = "", *, gently: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Return time (n,) s and inputs w (n, .) of 5 s in which all cylinders go both ways, or one goes against the end of
    its stroke.

    Args:
        crane: what is driven.
        to_its_end: the cylinder that goes there.
        gently: for machines that the usual commands are too much for: no cylinder comes to its end unasked, and the one
            that is to strikes slowly.

    Raises:
        CraneError: a machine that cannot be driven gently.
    """
    time, cylinders = np.arange(round(5.0 / SAMPLE) + 1) * SAMPLE, crane.layout.cylinders
    ways = [
        (1.0 if c % 2 == 0 else -1.0) * np.sin((2.5 - 0.8 * c) * time) * (time > 0.5 * c) for c in range(len(cylinders))
    ]
    commands = np.column_stack([(0.4 - 0.05 * c) * way for c, way in enumerate(ways)])
    if to_its_end:
        # fast, and slower before it strikes, as a driver would: at full speed it bounces for a second in steps of 1 µs
        slows = _near_its_end(crane, time, to_its_end) if gently else 1.7
        way = np.where(time < slows, 1.0, _GENTLY if gently else 0.6) * (time > 0.2)
        commands = np.column_stack([way * float(c == to_its_end) for c in cylinders])
    elif gently:
        commands = kept_off_ends(crane, time, commands)
    return time, spool_inputs(crane, time, commands)


def _near_its_end(crane: Crane, time: np.ndarray, cylinder: str) -> float:
    """Return when a cylinder that is driven out at full speed comes near the end of its stroke, s."""
    engine, c = SemiRecursiveEngine(crane), crane.layout.cylinders.index(cylinder)
    commands = np.column_stack([(time > 0.2) * float(n == cylinder) for n in crane.layout.cylinders])
    x0 = initial_state(crane, engine)
    states, _ = run_while_possible(engine, x0, time, spool_inputs(crane, time, commands), SAMPLE)
    near = np.flatnonzero(positions_in_strokes(crane, states)[:, c] > 1.0 - _NEAR)
    return float(time[near[0]]) if near.size else float(time[-1])


def kept_off_ends(crane: Crane, time: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return commands (n, valves) with which no cylinder comes to its end: those given, with levers let go in time.

    Raises:
        CraneError: there are none.
    """
    fitted = within_strokes(crane, time, commands, initial_state(crane, SemiRecursiveEngine(crane)))
    if fitted is None:
        raise CraneError(f"{crane.name}: the run ends early, whichever lever is released. Start elsewhere.")
    return fitted


def joystick(crane: Crane, x0: np.ndarray, seconds: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return time (n,) s and commands (n, levers) of a random driver who keeps the cylinders off their ends.

    Each valve is ramped within 0.2 s to a new random position (one in four is rest), which is held up to 1.5 s. The
    driver only does what he can still stop in time.
    """
    engine, n, levers = SemiRecursiveEngine(crane), round(seconds / SAMPLE) + 1, len(crane.layout.cylinders)
    stop = round(0.6 / SAMPLE)
    time, commands = np.arange(n + stop) * SAMPLE, np.zeros((n + stop, levers))
    at, x, level = round(0.2 / SAMPLE), np.asarray(x0), np.zeros(levers)
    while at < n - 1:
        end = min(n - 1, at + int(rng.uniform(0.5, 1.7) / SAMPLE))
        for wanted in _tries(levers, rng):
            commands[at : end + 1] = _ramp(level, wanted, end + 1 - at)
            commands[end : end + stop] = _ramp(wanted, np.zeros_like(wanted), stop)
            spools = spool_inputs(crane, time[: end + stop], commands[: end + stop])[at:]
            after = _safe_state(engine, x, time[at : end + stop], spools, end - at)
            if after is not None:
                break
        else:
            raise CraneError(f"{crane.name}: with any commands a cylinder reaches its end. Start elsewhere.")
        at, x, level = end, after, wanted
    return time[:n], commands[:n]


def _ramp(start: np.ndarray, end: np.ndarray, count: int) -> np.ndarray:
    """Return commands (count, 2) that go from start to end in 0.2 s and stay there."""
    return start + np.minimum(np.arange(count) * SAMPLE / 0.2, 1.0)[:, None] * (end - start)


def spool_inputs(crane: Crane, time: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return engine inputs w (n, .) of commands (n, levers), with the crane's own supply pressures."""
    return np.column_stack([SpoolPath(crane).run(time, commands), np.full((len(time), 2), np.nan)])


def _tries(levers: int, rng: np.random.Generator) -> list[np.ndarray]:
    """Return positions of the levers in the order in which the driver thinks of them; stopping is the last."""
    drawn = rng.uniform(-0.7, 0.7, (30, levers))
    drawn[rng.random(drawn.shape) < 0.25] = 0.0
    return [*drawn, np.zeros(levers)]


def _safe_state(
    engine: SemiRecursiveEngine, x: np.ndarray, time: np.ndarray, w: np.ndarray, k: int
) -> np.ndarray | None:
    """Return the state at sample k of a stretch, or None if a chamber gets short anywhere on it."""
    try:
        X = engine.simulate(x, time, w)
    except CraneError:
        return None
    t = engine.terms_along(X[::20], w[::20], time[::20])
    return X[k] if _shortest_chamber(t).min() > MARGIN else None
