"""What a cross-check is run on: random feasible states, other cranes, probes of every effect, random joystick inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.effects.base import CYLINDERS
from crane_exudyn.errors import CraneError
from crane_exudyn.hydraulics import vapour_pressure
from crane_exudyn.inputs import SpoolPath

from .semi_recursive import SemiRecursiveEngine

#: hooks that act before or after an engine (on commands, on sensors), in code that both engines are fed by
OUTSIDE_ENGINES = {"command", "delay", "backlash", "creep", "measurement", "lag"}
#: smallest chamber length of a random state, m
MARGIN = 0.03
SAMPLE = 1e-3
#: what a crane that is drawn at random has of the given one: two constants of nature, and what its gauges count from
_KEPT = ("gravity", "fluid.vapour_pressure", "supply.pressure_reference")
#: when probes of effects begin that begin at a time, s: within the run that excites them, and between samples
BEGIN = 2.5003
#: changes (m) that bring both ends of both strokes into the range of random poses, for end stops
_SHORT_STROKES = {
    f"cylinders.{c}.{n}": by for c in CYLINDERS for n, by in (("empty_length", 0.3), ("chamber_range", -0.5))
}


@dataclass(frozen=True)
class States:
    """Random states with inputs and times: x (n, nx), w (n, 4), time (n,)."""

    x: np.ndarray
    w: np.ndarray
    time: np.ndarray

    def __len__(self) -> int:
        return len(self.x)


def random_states(crane: Crane, count: int, rng: np.random.Generator) -> States:
    """Return `count` states at which the loop closes well and both cylinders are inside their strokes.

    Angles are uniform over what is feasible, rates normal with 0.3 rad/s, pressures uniform up to 1.5 times the pump's (in a third
    of the states up to a tenth of that, one in twenty at vapour pressure), spool positions uniform; half of the inputs carry measured supply pressures.

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
            f"{crane.name}: only {len(found)} of {800 * count} random poses are feasible. Mend joints or strokes."
        )
    lay = crane.layout
    w = np.tile(lay.closed, (count, 1))
    w[:, lay.spools] = rng.uniform(-1, 1, (count, len(lay.commands)))
    measured = rng.random(count) < 0.5
    pump, tank = crane["supply.pump_pressure"], crane["supply.tank_pressure"]
    w[measured, lay.supplies] = np.array([pump, tank]) * rng.uniform(0.8, 1.2, (np.count_nonzero(measured), 2))
    return States(np.array(found[:count]), w, rng.uniform(0.0, 10.0, count))


def _drawn(crane: Crane, nx: int, count: int, rng: np.random.Generator) -> np.ndarray:
    x = np.zeros((count, nx))
    x[:, 0], x[:, 1] = rng.uniform(-0.4, 1.3, count), rng.uniform(-2.8, 0.3, count)
    lay = crane.layout
    dz, p, added = x[:, lay.velocities], x[:, lay.pressures], x[:, lay.extra]
    dz[:] = rng.normal(0.0, 0.3, dz.shape)
    p[:] = rng.uniform(0.2e5, 1.5 * crane["supply.pump_pressure"], p.shape)
    p[rng.random(count) < 1.0 / 3.0] *= 0.1
    p[rng.random(p.shape) < 0.05] = vapour_pressure(crane.parameter_vector())
    added[:] = rng.normal(0.0, 0.4, added.shape)
    return x


def _feasible(engine: SemiRecursiveEngine, x: np.ndarray) -> np.ndarray:
    t = engine.terms_along(x, np.zeros((len(x), len(engine.crane.layout.inputs))), np.zeros(len(x)))
    chambers = np.min([t[f"l{i}"] for i in range(1, 5)], axis=0)
    with np.errstate(invalid="ignore"):
        return (chambers > MARGIN) & (np.abs(t["dz2_dz4"]) < 5.0) & (np.abs(t["dz3_dz4"]) < 5.0)


def other_cranes(crane: Crane, rng: np.random.Generator) -> dict[str, Crane]:
    """Return cranes of other numbers: a longer boom with a heavier payload, and one drawn at random within feasibility."""
    longer = crane.with_parameters(
        {
            "joints.E.x": crane["joints.E.x"] + 1.2,
            "bodies.outer_boom.mass": 1.5 * crane["bodies.outer_boom.mass"],
            "bodies.outer_boom.com.x": crane["bodies.outer_boom.com.x"] + 0.5,
            "bodies.outer_boom.inertia": 3.0 * crane["bodies.outer_boom.inertia"],
            "payload.mass": 6.0 * crane["payload.mass"],
        }
    )
    return {"longer boom, heavier payload": longer, "drawn at random": _drawn_crane(crane, rng)}


def _drawn_crane(crane: Crane, rng: np.random.Generator) -> Crane:
    """Return a crane with points moved by up to 60 mm and every quantity but gravity changed by up to 40 %."""
    for _ in range(100):
        changes = {}
        for name, value in crane.values.items():
            if name.endswith((".x", ".y")):
                changes[name] = value + rng.uniform(-0.06, 0.06)
            elif name not in _KEPT and not name.endswith(("empty_length", "chamber_range")):
                changes[name] = value * rng.uniform(0.6, 1.4)
        for c in CYLINDERS:
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
    """Return {"name@place": crane with that effect} for every effect that acts inside an engine, its parameters typical."""
    probes = {}
    for key in registry.all_keys():
        effect, _ = registry.split_key(key)
        if set(effect.hooks()) <= OUTSIDE_ENGINES:
            continue
        base = crane
        if "pendulum" in effect.hooks() and crane["payload.mass"] <= 0.0:  # nothing would swing
            base = crane.with_parameters({"payload.mass": 100.0})
        if effect.name == "end_stop":  # bring both ends into the range of random states
            base = crane.with_parameters({n: crane[n] + by for n, by in _SHORT_STROKES.items()})
        begins = {p.name: BEGIN for p in effect.parameters if p.name == "T" and p.shape}
        probes[key] = base.with_effect(key, {p.name: p.typical for p in effect.parameters} | begins)
    return probes


def without_short_strokes(crane: Crane) -> Crane:
    """Return a crane of `effect_probes` with the strokes that it had before they were shortened."""
    return crane.with_parameters({n: crane[n] - by for n, by in _SHORT_STROKES.items()})


def exciting(crane: Crane, to_its_end: str = "") -> tuple[np.ndarray, np.ndarray]:
    """Return time (n,) s and inputs w (n, 4) of 5 s in which both cylinders go both ways, or one goes against the end of its stroke."""
    time = np.arange(round(5.0 / SAMPLE) + 1) * SAMPLE
    commands = np.column_stack([0.4 * np.sin(2.5 * time), -0.35 * np.sin(1.7 * time) * (time > 0.5)])
    if to_its_end:
        commands = np.column_stack([(time > 0.2) * float(c == to_its_end) for c in CYLINDERS])
    return time, spool_inputs(crane, time, commands)


def joystick(crane: Crane, x0: np.ndarray, seconds: float, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return time (n,) s and commands (n, 2) of a random driver who keeps the cylinders off their ends.

    Each valve is ramped within 0.2 s to a new random position (one in four is rest), which is held up to 1.5 s. The driver
    only does what he can still stop in time.
    """
    engine, n = SemiRecursiveEngine(crane), round(seconds / SAMPLE) + 1
    stop = round(0.6 / SAMPLE)
    time, commands = np.arange(n + stop) * SAMPLE, np.zeros((n + stop, len(CYLINDERS)))
    at, x, level = round(0.2 / SAMPLE), np.asarray(x0), np.zeros(len(CYLINDERS))
    while at < n - 1:
        end = min(n - 1, at + int(rng.uniform(0.5, 1.7) / SAMPLE))
        for wanted in _tries(rng):
            commands[at : end + 1] = _ramp(level, wanted, end + 1 - at)
            commands[end : end + stop] = _ramp(wanted, np.zeros_like(wanted), stop)
            spools = spool_inputs(crane, time[: end + stop], commands[: end + stop])[at:]
            after = _safe_state(engine, x, time[at : end + stop], spools, end - at)
            if after is not None:
                break
        else:
            raise CraneError(f"{crane.name}: whatever the driver does, a cylinder comes to its end. Start elsewhere.")
        at, x, level = end, after, wanted
    return time[:n], commands[:n]


def _ramp(start: np.ndarray, end: np.ndarray, count: int) -> np.ndarray:
    """Return commands (count, 2) that go from start to end in 0.2 s and stay there."""
    return start + np.minimum(np.arange(count) * SAMPLE / 0.2, 1.0)[:, None] * (end - start)


def spool_inputs(crane: Crane, time: np.ndarray, commands: np.ndarray) -> np.ndarray:
    """Return engine inputs w (n, 4) of commands (n, 2), with the crane's own supply pressures."""
    return np.column_stack([SpoolPath(crane).run(time, commands), np.full((len(time), 2), np.nan)])


def _tries(rng: np.random.Generator) -> list[np.ndarray]:
    """Return positions of both levers in the order in which the driver thinks of them; stopping is the last."""
    drawn = rng.uniform(-0.7, 0.7, (30, len(CYLINDERS)))
    drawn[rng.random(drawn.shape) < 0.25] = 0.0
    return [*drawn, np.zeros(len(CYLINDERS))]


def _safe_state(
    engine: SemiRecursiveEngine, x: np.ndarray, time: np.ndarray, w: np.ndarray, k: int
) -> np.ndarray | None:
    """Return the state at sample k of a stretch, or None if a chamber gets short anywhere on it."""
    try:
        X = engine.simulate(x, time, w)
    except CraneError:
        return None
    t = engine.terms_along(X[::20], w[::20], time[::20])
    return X[k] if min(t[f"l{i}"].min() for i in range(1, 5)) > MARGIN else None
