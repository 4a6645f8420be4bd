"""Recordings with a hidden effect, for testing the diagnosis: random machines, manoeuvres, sensors and severities.

`make_case(seed)` draws one machine and two manoeuvres, runs them on the Exudyn engine (the diagnosis searches on the
other one) and returns what sensors would have recorded, with the answer. `python -m validation.hidden -o DIR` writes
many as files. The semi-recursive engine only serves to try drafts: whether a manoeuvre stays within reach, whether an
effect can be seen.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.signal import lfilter

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import pose
from crane_exudyn.layout import Layout
from crane_exudyn.machine_toml import usual_layout
from crane_exudyn.measurement import Measurement
from crane_exudyn.recording import Recording

from .seeds import log_uniform, seed_range

if TYPE_CHECKING:
    from .hidden_plant import Dialect, Law

DURATION = 25.0
_STEP = 1e-3
#: how many effects a kind hides
HIDES = {"effect": 1, "two": 2, "three": 3, "four": 4}
KINDS = (*HIDES, "none", "parameters", "unknown")
RATES = (100, 200, 500, 1000)
#: standard deviations of angles (rad) and pressures (Pa): a good rig's, and the paper's
NOISES = ((math.radians(0.05), 0.3e5), (math.radians(1.0), 1.5e5))
SENSOR_SETS = (("z1", "z4", "p1", "p2", "p3", "p4"), ("z1", "z4", "p1", "p4"))

#: angles in degrees that manoeuvres keep to, and those that a run may reach before it is drawn again
_PLANNED = ((-8.0, 58.0), (-112.0, -12.0))
#: the same for a machine whose end stop is to be hit: lift at 92 deg, tilt at -191 deg
_PAST_THE_STOP = ((50.0, 125.0), (-225.0, -120.0))
_ALLOWED = ((-20.0, 75.0), (-140.0, 8.0))
#: rough speeds in deg/s at fully open spools, extending and retracting; plans need no more
_SPEED = ((25.0, 31.0), (-55.0, -53.0))
_MOST_DRAWS = 60
#: between which the correlation of neighbouring samples lies where they share noise
_SHARED = (0.2, 0.5)
#: after so many draws without success other effects are drawn, where none were asked for
_OTHER_EFFECTS = 20

Draw = Callable[[np.random.Generator, Mapping[str, Any]], dict[str, float]]


@dataclass(frozen=True)
class HiddenCase:
    """A machine with a secret.

    Attributes:
        learn, check: two recordings of the machine.
        answer: "verdict" and "effects" as a right diagnosis gives them; "parameters" of each effect; "machine"
            parameters that are not nominal; "visibility": by how many noise standard deviations (RMS, best channel)
            each of these moves the learn recording; and what else was drawn.
        nominal: what its crane file says.
    """

    seed: int
    learn: Recording
    check: Recording
    answer: dict[str, Any]
    nominal: Crane


# -- severities ------------------------------------------------------------------------------------------------------


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.random() < 0.5 else -1.0


def _seal(rng: np.random.Generator, _: Any) -> dict[str, float]:
    coulomb = log_uniform(rng, 150.0, 6000.0)
    return {"dFc": coulomb, "dFs": coulomb * rng.uniform(1.0, 1.6), "vs": log_uniform(rng, 2e-3, 2e-2)}


def _counterbalance(rng: np.random.Generator, _: Any) -> dict[str, float]:
    """A setting that some 50 bar of load and 40 to 85 bar of pilot pressure overcome: lower ones are never felt."""
    ratio = rng.uniform(1.0, 4.0)
    setting = 50e5 + ratio * rng.uniform(40e5, 85e5)
    return {"setting": setting, "ratio": ratio, "range": log_uniform(rng, 10e5, 50e5)}


def _payload(rng: np.random.Generator, about: Mapping[str, Any]) -> dict[str, float]:
    dm = _sign(rng) * log_uniform(rng, 3.0, 200.0)
    return {"dm": dm if dm > -0.8 * about["payload"] else -dm, "T": rng.uniform(3.0, 20.0)}


def _stuck(rng: np.random.Generator, about: Mapping[str, Any]) -> dict[str, float]:
    """A seal that stands, when the recording to learn from begins, within twice its deformation of holding nothing."""
    delta = log_uniform(rng, 1e-4, 2e-3)
    return {"Fc": log_uniform(rng, 300.0, 1e4), "l0": about["length"] + rng.uniform(-2.0, 2.0) * delta, "delta": delta}


def _bias(rng: np.random.Generator, about: Mapping[str, Any]) -> dict[str, float]:
    size = log_uniform(rng, 0.3e5, 20e5) if about["unit"] == "Pa" else math.radians(log_uniform(rng, 0.05, 5.0))
    return {"b": _sign(rng) * size}


#: how the parameters of each effect are drawn (SI), from hardly visible to plainly broken
SEVERITIES: Mapping[str, Draw] = {
    "internal_leakage": lambda r, _: {"k": log_uniform(r, 1e-13, 2e-11)},
    "external_leakage": lambda r, _: {"k": log_uniform(r, 1e-13, 1e-11)},
    "dead_band": lambda r, _: {"lower": log_uniform(r, 0.003, 0.15), "upper": log_uniform(r, 0.003, 0.15)},
    "meter_out_restriction": lambda r, _: {"r": r.uniform(0.02, 0.8)},
    "pressure_compensation": lambda r, _: {"dpc": log_uniform(r, 3e5, 60e5)},
    "command_delay": lambda r, _: {"T": log_uniform(r, 0.005, 0.3)},
    "spool_hysteresis": lambda r, _: {"b": log_uniform(r, 0.002, 0.12)},
    "spool_creep": lambda r, _: {"kappa": log_uniform(r, 0.01, 0.4), "tau": log_uniform(r, 0.2, 4.0)},
    "counterbalance_valve": _counterbalance,
    "entrained_air": lambda r, _: {"alpha": log_uniform(r, 3e-4, 0.1)},
    "released_air": lambda r, _: {"alpha": log_uniform(r, 3e-3, 0.3), "ps": r.uniform(2e5, 10e5)},
    "pump_droop": lambda r, _: {"R": log_uniform(r, 2e8, 3e10)},
    "return_back_pressure": lambda r, _: {"R": log_uniform(r, 2e8, 3e10)},
    "seal_friction": _seal,
    "stuck_seal": _stuck,
    "pressure_dependent_friction": lambda r, _: {"mu": log_uniform(r, 2e-5, 2e-3)},
    "joint_coulomb_friction": lambda r, _: {"T": log_uniform(r, 30.0, 2500.0)},
    "joint_viscous_friction": lambda r, _: {"c": log_uniform(r, 100.0, 2e4)},
    "structural_compliance": lambda r, _: {"stiffness": log_uniform(r, 1e6, 1e8)},
    "payload_change": _payload,
    "payload_swing": lambda r, _: {"length": log_uniform(r, 0.3, 3.0), "damping": log_uniform(r, 0.5, 30.0)},
    "tip_contact_force": lambda r, _: {"F": _sign(r) * log_uniform(r, 30.0, 2000.0), "T": r.uniform(3.0, 20.0)},
    "base_tilt": lambda r, _: {"gamma": _sign(r) * log_uniform(r, 2e-3, 0.2)},
    "end_stop": lambda r, _: {"stiffness": log_uniform(r, 1e7, 3e8), "damping": log_uniform(r, 1e4, 3e5)},
    "sensor_bias": _bias,
    "sensor_scale": lambda r, _: {"a": 1.0 + _sign(r) * log_uniform(r, 0.005, 0.25)},
    "sensor_lag": lambda r, _: {"tau": log_uniform(r, 0.005, 0.5)},
}


def hideable(sensors: Sequence[str], layout: Layout | None = None) -> list[str]:
    """Return "name@place" of every effect that can be drawn for a machine (by default the PATU 655), faults of sensors
    that are not recorded left out.
    """
    keys = [k for k in registry.all_keys(layout or usual_layout()) if k.partition("@")[0] in SEVERITIES]
    return [k for k in keys if not k.startswith("sensor_") or k.partition("@")[2] in sensors]


def grouped(keys: Sequence[str]) -> dict[str, list[str]]:
    """Return effects "name@place" by their names."""
    found: dict[str, list[str]] = {}
    for key in keys:
        found.setdefault(key.partition("@")[0], []).append(key)
    return found


def severity(key: str, crane: Crane, start: Sequence[float], rng: np.random.Generator) -> dict[str, float]:
    """Return parameters (SI) of an effect as drawn for a machine; what is learned from begins at the coordinates
    `start`.
    """
    name, _, place = key.partition("@")
    about: dict[str, Any] = {"payload": crane["payload.mass"]}
    if place in crane.layout.cylinders:
        pin_to_pin = pose(crane, *start).lengths[0, crane.layout.cylinders.index(place)]
        about["length"] = float(pin_to_pin) - crane[f"cylinders.{place}.empty_length"]
    if place in crane.layout.sensors:
        about["unit"] = crane.layout.sensors[place].unit
    return SEVERITIES[name](rng, about)


# -- manoeuvres ------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Manoeuvre:
    """A start and commands: corner times (s) and values of each spool's command, linear between.

    Attributes:
        z1, z4: start angles in rad.
        less_loaded: pressures in Pa of the less loaded chambers at the start.
        corners: per cylinder (times, commands).
    """

    z1: float
    z4: float
    less_loaded: tuple[float, float]
    corners: tuple[tuple[np.ndarray, np.ndarray], ...]

    @property
    def start(self) -> tuple[float, float]:
        """The coordinates at the start."""
        return self.z1, self.z4

    def driven(self) -> tuple[np.ndarray, np.ndarray]:
        """Return all corner times (n,) and the commands (n, 2) there, linear between."""
        stamps = np.union1d(*(t for t, _ in self.corners))
        return stamps, self.commands(stamps)

    def commands(self, time: np.ndarray) -> np.ndarray:
        """Return the commands (n, 2) at `time` (n,)."""
        return np.column_stack([np.interp(time, t, u) for t, u in self.corners])


Range = tuple[float, float]


def draw_manoeuvre(
    rng: np.random.Generator, *, cycle: float | None = 0.01, plan: Sequence[Range] = _PLANNED
) -> Manoeuvre:
    """Return a random manoeuvre: rests, ramped motions and reversals of both cylinders, roughly within reach.

    Args:
        rng: source of the draws.
        cycle: s, corners of the commands are multiples of it, as those of a controller are; None for no such grid.
        plan: angles in deg of lift and outer boom to keep to.
    """
    z = [_start_angle(rng, c, plan[c]) for c in range(2)]
    corners = tuple(_corners(rng, c, z[c], cycle, plan[c]) for c in range(2))
    low = (float(rng.uniform(10e5, 30e5)), float(rng.uniform(10e5, 30e5)))
    return Manoeuvre(math.radians(z[0]), math.radians(z[1]), low, corners)


def _start_angle(rng: np.random.Generator, c: int, plan: Range) -> float:
    """Return an angle (deg) inside the plan, on this side of the stop where the plan goes past it."""
    low, high = plan
    if plan == _PAST_THE_STOP[c]:
        low, high = (low, 85.0) if c == 0 else (-180.0, high)
    return float(rng.uniform(low + 8.0, high - 8.0))


def _corners(
    rng: np.random.Generator, c: int, angle: float, cycle: float | None, plan: Range
) -> tuple[np.ndarray, np.ndarray]:
    """Return corner times and commands of one cylinder that starts at an angle (deg)."""
    times, values, t = [0.0], [0.0], float(rng.uniform(0.4, 4.0))
    while t < DURATION - 1.5:
        u = _opening(rng, c, angle, plan)
        hold = float(rng.uniform(0.1, 0.3) if rng.random() < 0.15 else rng.uniform(0.5, 3.0))
        hold = min(hold, _time_left(c, angle, u, plan), DURATION - 0.8 - t)
        if hold > 0.08:
            up, down = (_ramp(rng, hold) for _ in range(2))
            times += [t, t + up, t + up + hold, t + up + hold + down]
            values += [0.0, u, u, 0.0]
            angle += _SPEED[c][int(u < 0.0)] * abs(u) * (1 if u > 0 else -1) * (hold + 0.5 * (up + down))
            t = times[-1]
        t += float(rng.uniform(0.0, 0.05) if rng.random() < 0.25 else rng.uniform(0.2, 4.0))
    return commands_on_grid(np.array([*times, DURATION + 1.0]), np.array([*values, 0.0]), cycle)


def _ramp(rng: np.random.Generator, hold: float) -> float:
    """Return how long a command takes to its value, s: one in five steps, the others show in several samples at 100
    Hz.
    """
    return 0.0 if rng.random() < 0.2 else float(rng.uniform(0.03, min(max(hold, 0.05), 0.4)))


def _opening(rng: np.random.Generator, c: int, angle: float, plan: Range) -> float:
    """Return a command, more likely towards the middle of the range than away from it."""
    low, high = plan
    share = (angle - low) / (high - low)
    size = float(rng.uniform(0.06, 0.6 if c == 0 else 0.4))
    rising = rng.random() > min(max(share, 0.1), 0.9)
    return size if rising == (_SPEED[c][0] > 0.0) else -size


def _time_left(c: int, angle: float, u: float, plan: Range) -> float:
    """Return for how many s a cylinder may move before its angle leaves the planned range."""
    rate = (_SPEED[c][0] if u > 0.0 else -_SPEED[c][1]) * abs(u)
    end = plan[1] if rate > 0.0 else plan[0]
    return max(0.0, (end - angle) / rate)


def commands_on_grid(times: np.ndarray, values: np.ndarray, cycle: float | None) -> tuple[np.ndarray, np.ndarray]:
    """Return corners at multiples of the controller's cycle; a step takes the microsecond before its corner."""
    if cycle is not None:
        times = np.round(times / cycle) * cycle
    step = np.append(np.diff(times) < 1e-6, False)
    times = times - 1e-6 * step
    kept = np.append(True, np.diff(times) > 1e-7)
    return times[kept], values[kept]


# -- running a machine -----------------------------------------------------------------------------------------------

_GRID = np.arange(round(DURATION / _STEP) + 1) * _STEP


def run_machine(crane: Crane, engine: Any, manoeuvre: Manoeuvre) -> np.ndarray:
    """Return the states (N, nx) of a machine through a manoeuvre every ms, from its own static start."""
    from .hidden_plant import inputs

    start = engine.static_start(manoeuvre.z1, manoeuvre.z4, less_loaded=manoeuvre.less_loaded)
    w = inputs(crane, _GRID, *manoeuvre.driven())
    states = np.asarray(engine.simulate(start, _GRID, w, step=_STEP))
    _check_reach(crane, states)
    return states


def _check_reach(crane: Crane, states: np.ndarray) -> None:
    """Raise CraneError if a run leaves the allowed angles; machines with ends of stroke may go as far as these let
    them.
    """
    if any(registry.find(e.name).beyond_stroke for e in crane.effects):
        return
    for name, angles, (low, high) in zip(("z1", "z4"), np.degrees(states[:, :2]).T, _ALLOWED, strict=True):
        if not (low < angles.min() and angles.max() < high):
            raise CraneError(
                f"{name} runs from {angles.min():.1f} to {angles.max():.1f} deg, beyond {low:g} … {high:g}."
            )


def _draft(crane: Crane, manoeuvre: Manoeuvre) -> dict[str, np.ndarray]:
    """Return what the machine's sensors show without noise, by the faster engine."""
    from validation.semi_recursive import SemiRecursiveEngine

    return readings(crane, run_machine(crane, SemiRecursiveEngine(crane), manoeuvre))


def readings(crane: Crane, states: np.ndarray) -> dict[str, np.ndarray]:
    """Return what the sensors of a machine show without noise, every ms, as its effects say; those that lag begin
    settled.
    """
    shown = Measurement.of(crane).shown(states, _GRID[: len(states)], settled=True)
    return dict(zip(crane.layout.sensors, shown.T, strict=True))


def visibility(
    with_it: Mapping[str, np.ndarray], without: Mapping[str, np.ndarray], noise: Mapping[str, float]
) -> float:
    """Return the largest RMS difference of a recorded channel in units of its noise."""
    return max(float(np.sqrt(np.mean((with_it[n] - without[n]) ** 2))) / std for n, std in noise.items())


# -- drawing a machine -----------------------------------------------------------------------------------------------


def draw_machine(crane: Crane, rng: np.random.Generator, *, errors: bool, payload: bool) -> Crane:
    """Return a machine whose parameters are a little off: some by half their standard uncertainty (times a normal
    draw), and, if asked, with another payload between 0 and 200 kg.
    """
    moved = {}
    for name, known in crane.uncertainty.items():
        if math.isfinite(known.std) and errors and rng.random() < 0.3:
            moved[name] = crane[name] + 0.5 * known.std * float(rng.standard_normal())
    if payload:
        moved["payload.mass"] = float(rng.uniform(0.0, 200.0))
    return crane.with_parameters({n: _inside(crane, n, v) for n, v in moved.items()})


def _inside(crane: Crane, name: str, value: float) -> float:
    known = crane.uncertainty[name]
    return min(max(value, known.lower), known.upper)


def _pick(rng: np.random.Generator, kind: str, sensors: Sequence[str]) -> list[str]:
    """Return the effects to hide: names are equally likely, then places; several are of different names."""
    by_name = grouped(hideable(sensors))
    names = [n for n in by_name if kind == "effect" or not registry.find(n).beyond_stroke]
    chosen = rng.choice(names, HIDES[kind], replace=False)
    return [str(rng.choice(by_name[n])) for n in chosen]


@dataclass(frozen=True)
class _Setting:
    """What was drawn before any simulation."""

    rng: np.random.Generator
    kind: str
    keys: Sequence[str]
    noise: Mapping[str, float]
    rate: int
    machine: Crane
    nominal: Crane
    visible: tuple[float, float]
    learned: float
    foreign: bool
    picked: bool  # the effects were drawn, not asked for
    swapped: bool
    smoothed: bool


def make_case(
    seed: int,
    *,
    kind: str | None = None,
    keys: Sequence[str] | None = None,
    visible: tuple[float, float] = (3.0, math.inf),
    noise: int | None = None,
    rate: int | None = None,
    sensors: int | None = None,
    errors: bool | None = None,
    learned: float = DURATION,
    foreign: bool = False,
    swapped: bool = False,
    smoothed: bool = False,
    crane: Crane | None = None,
) -> HiddenCase:
    """Return the hidden case of a seed; what is not given is drawn.

    Args:
        seed: makes everything; the same seed and arguments give the same case.
        kind: of KINDS: one effect to four, none at all, parameter errors only, or a law that the library does not have.
        keys: "name@place" of the effects (for "unknown": the name of a law of hidden_plant.LAWS).
        visible: least and largest visibility of every effect; severities are drawn until it is met.
        noise: 0 for the good rig's, 1 for the paper's.
        rate: of RATES, Hz.
        sensors: 0 for all pressures, 1 for z1 z4 p1 p4.
        errors: whether the machine's parameters are a little off.
        learned: seconds of the recording that is learned from; what is hidden is as visible in them as is asked.
        foreign: laws in a dialect of their own, a little different from the library's (hidden_plant.DIALECTS).
        swapped: the machine runs on the engine that the diagnosis uses too; for effects of the library.
        smoothed: neighbouring samples share a part of their noise, as where a logger smooths.
        crane: nominal crane; by default patu655.

    Raises:
        CraneError: no draw of severity and manoeuvre met the conditions.
    """
    rng = np.random.default_rng(seed)
    kind = kind or str(rng.choice(KINDS, p=(0.6, 0.14, 0.0, 0.0, 0.08, 0.08, 0.1)))
    drawn = (int(rng.integers(2)), int(rng.choice(RATES)), int(rng.random() < 0.35), int(rng.random() < 0.5))
    given = (noise, rate, sensors, errors)
    level, rate, chosen, off = (int(d if g is None else g) for d, g in zip(drawn, given, strict=True))
    stds = {n: NOISES[level][0 if n.startswith("z") else 1] for n in SENSOR_SETS[chosen]}
    nominal = crane or Crane.load("patu655")
    machine = _machine(nominal, rng, kind, off == 1)
    picked = keys is None and kind in HIDES
    keys = _pick(rng, kind, list(stds)) if picked else keys or []
    setting = _Setting(
        rng, kind, keys, stds, rate, machine, nominal, visible, learned, foreign, picked, swapped, smoothed
    )
    return _until_it_does(seed, setting)


def _machine(nominal: Crane, rng: np.random.Generator, kind: str, off: bool) -> Crane:
    """Return the machine before anything is hidden in it."""
    if kind == "none" or not (off or kind == "parameters"):
        return nominal
    return draw_machine(nominal, rng, errors=True, payload=rng.random() < (0.6 if kind == "parameters" else 0.3))


def _until_it_does(seed: int, s: _Setting) -> HiddenCase:
    """Return a case; manoeuvres and severities (and errors of parameters, where they are the secret) are drawn until
    they do.
    """
    problem: CraneError | None = None
    for attempt in range(_MOST_DRAWS):
        if attempt and s.kind == "parameters":
            s = replace(s, machine=_machine(s.nominal, s.rng, s.kind, True))
        if s.picked and attempt and attempt % _OTHER_EFFECTS == 0:
            s = replace(s, keys=_pick(s.rng, s.kind, list(s.noise)))
        try:
            return _try_case(seed, s)
        except CraneError as found:
            problem = found
    raise CraneError(f"Case {seed} ({s.kind}: {', '.join(s.keys)}): {_MOST_DRAWS} draws failed, the last: {problem}")


def _try_case(seed: int, s: _Setting) -> HiddenCase:
    """Return a case of new manoeuvres and severities, or raise CraneError where they do not do."""
    cylinders, effects = s.machine.layout.cylinders, s.keys if s.kind in HIDES else ()
    ends = {place for effect, place in map(registry.split_key, effects) if effect.beyond_stroke}
    plan = [_PAST_THE_STOP[c] if name in ends else _PLANNED[c] for c, name in enumerate(cylinders)]
    manoeuvres = [draw_manoeuvre(s.rng, cycle=None if s.foreign else 0.01, plan=plan) for _ in range(2)]
    if s.kind == "unknown":
        return _unknown_case(seed, s, manoeuvres)
    machine = s.machine
    for key in s.keys:
        machine = machine.with_effect(key, severity(key, machine, manoeuvres[0].start, s.rng))
    seen = _seen(s, machine, manoeuvres[0])
    _draft(machine, manoeuvres[1])
    runs = [_exact(machine, s, m) for m in manoeuvres]
    answer = _answer(s, machine, seen)
    return _recorded(seed, s, manoeuvres, runs, answer)


def _exact(machine: Crane, s: _Setting, manoeuvre: Manoeuvre, laws: Sequence[Law] = ()) -> dict[str, np.ndarray]:
    """Return what the machine's sensors show without noise, by the Exudyn engine unless swapped; laws act beside its
    effects.
    """
    from crane_exudyn.engine import ExudynEngine
    from crane_exudyn.static_start import static_start

    from .hidden_plant import inputs, simulate

    plain, dialects = _in_dialect(machine) if s.foreign else (machine, [])
    acting = [*laws, *(law for d in dialects for law in d.laws)]
    if not acting and not dialects:
        if s.swapped:
            return _draft(machine, manoeuvre)
        return readings(machine, run_machine(machine, ExudynEngine(machine), manoeuvre))
    w = inputs(plain, _GRID, *manoeuvre.driven(), dialects)
    states = simulate(
        plain, static_start(plain, manoeuvre.z1, manoeuvre.z4, less_loaded=manoeuvre.less_loaded), _GRID, w, acting
    )
    _check_reach(machine, states)
    return readings(machine, states)


def _in_dialect(machine: Crane) -> tuple[Crane, list[Dialect]]:
    """Return the machine without the effects that have a dialect, and those dialects."""
    from .hidden_plant import DIALECTS, dialect

    spoken = [e for e in machine.effects if e.name in DIALECTS]
    plain = machine
    for effect in spoken:
        plain = plain.without_effect(effect.key)
    found = [dialect(e.key, e.parameters, plain) for e in spoken]
    return plain, [d for d in found if d is not None]


def _seen(s: _Setting, machine: Crane, manoeuvre: Manoeuvre) -> dict[str, float]:
    """Return the visibility of each effect and of the parameter errors; CraneError where an effect is not as visible as
    asked.
    """
    whole = _learned(s, _draft(machine, manoeuvre))
    seen = {}
    for key in s.keys:
        effect, place = registry.split_key(key)
        if effect.beyond_stroke:
            _check_hit(machine, whole, machine.layout.cylinders.index(place))
            continue  # without it there is no run to compare with
        seen[key] = visibility(whole, _learned(s, _draft(machine.without_effect(key), manoeuvre)), s.noise)
        if not s.visible[0] <= seen[key] <= s.visible[1]:
            raise CraneError(f"{key} moves the channels by {seen[key]:.2g} noise units, asked for {s.visible}.")
    if dict(s.machine.values) != dict(s.nominal.values):
        plain = _learned(s, _draft(machine.with_parameters(s.nominal.values), manoeuvre))
        seen["parameters"] = visibility(whole, plain, s.noise)
        if s.kind == "parameters" and seen["parameters"] < s.visible[0]:
            raise CraneError("the parameter errors cannot be seen.")
    return seen


def _learned(s: _Setting, run: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return what a run shows in the part that is learned from."""
    return {name: shown[: round(s.learned / _STEP) + 1] for name, shown in run.items()}


def _check_hit(machine: Crane, shown: Mapping[str, np.ndarray], cylinder: int) -> None:
    """Raise CraneError unless a cylinder stands at its extended end for 0.3 s or more."""
    lengths = pose(machine, shown["z1"], shown["z4"]).lengths[:, cylinder]
    name = machine.layout.cylinders[cylinder]
    names = [f"cylinders.{name}.{part}" for part in ("empty_length", "chamber_range")]
    if np.sum(lengths > sum(machine[n] for n in names)) * _STEP < 0.3:
        raise CraneError(f"the {name} cylinder does not come to its end.")


def _unknown_case(seed: int, s: _Setting, manoeuvres: Sequence[Manoeuvre]) -> HiddenCase:
    """Return a case with a law that is in no effect file."""
    from .hidden_plant import LAWS, draw_law

    name = str(s.keys[0]) if s.keys else str(s.rng.choice(LAWS))
    plain = _draft(s.machine, manoeuvres[0])
    lengths = pose(s.machine, plain["z1"], plain["z4"]).lengths
    hidden = draw_law(name, s.machine, s.rng, plain | {"s1": lengths[:, 0], "s2": lengths[:, 1]})
    runs = [_exact(s.machine, s, manoeuvres[0], [hidden.law])]
    seen = visibility(_learned(s, runs[0]), _learned(s, plain), s.noise)
    if not s.visible[0] <= seen <= s.visible[1]:
        raise CraneError(f"{name} moves the channels by {seen:.2g} noise units, asked for {s.visible}.")
    runs.append(_exact(s.machine, s, manoeuvres[1], [hidden.law]))
    answer = _answer(s, s.machine, {name: seen})
    return _recorded(seed, s, manoeuvres, runs, answer | {"law": {"name": name, **hidden.numbers, **hidden.answer()}})


def _answer(s: _Setting, machine: Crane, seen: Mapping[str, float]) -> dict[str, Any]:
    verdict = "effect" if s.kind in HIDES else {"none": "adequate"}.get(s.kind, s.kind)
    moved = {n: v for n, v in machine.values.items() if v != s.nominal[n]}
    return {
        "verdict": verdict,
        "effects": [e.key for e in machine.effects],
        "kind": s.kind,
        "parameters": {e.key: dict(e.parameters) for e in machine.effects},
        "machine": moved,
        "visibility": dict(seen),
        "noise": dict(s.noise),
        "rate": s.rate,
        "foreign": s.foreign,
        "smoothed": s.smoothed,
    }


def unit_noise(rng: np.random.Generator, number: int, shared: float) -> np.ndarray:
    """Return samples (number,) of unit noise whose correlation from one to the next is `shared`."""
    own = rng.standard_normal(number)
    return np.asarray(lfilter([math.sqrt(1.0 - shared**2)], [1.0, -shared], own)) if shared else own


def _recorded(
    seed: int,
    s: _Setting,
    manoeuvres: Sequence[Manoeuvre],
    runs: Sequence[Mapping[str, np.ndarray]],
    answer: dict[str, Any],
) -> HiddenCase:
    every = round(1.0 / (s.rate * _STEP))
    time = _GRID[::every]
    recordings, shared = [], float(s.rng.uniform(*_SHARED)) if s.smoothed else 0.0
    for part, manoeuvre, run in zip(("learn", "check"), manoeuvres, runs, strict=True):
        channels = dict(zip(("u1", "u2"), manoeuvre.commands(time).T, strict=True))
        for name, std in s.noise.items():
            channels[name] = run[name][::every] + std * unit_noise(s.rng, time.size, shared)
        recordings.append(Recording.from_arrays(f"case_{seed}_{part}", time, channels))
        answer |= {
            f"{part}_start": {"z1": manoeuvre.z1, "z4": manoeuvre.z4, "less_loaded": list(manoeuvre.less_loaded)}
        }
    return HiddenCase(seed, recordings[0].window(0.0, s.learned), recordings[1], answer, s.nominal)


# -- many, as files --------------------------------------------------------------------------------------------------


def write_cases(folder: Path, cases: Sequence[tuple[int, Mapping[str, Any]]]) -> None:
    """Write cases as case_SEED_learn.csv, case_SEED_check.csv and answers.json; answers already there are kept.

    Args:
        folder: made if it is not there.
        cases: (seed, keyword arguments of `make_case`).
    """
    from crane_exudyn.files import write_text

    folder.mkdir(parents=True, exist_ok=True)
    file = folder / "answers.json"
    answers = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for seed, arguments in cases:
        case = make_case(seed, **arguments)
        case.learn.save(folder / f"case_{seed}_learn.csv")
        case.check.save(folder / f"case_{seed}_check.csv")
        answers[f"case_{seed}"] = case.answer
        write_text(file, json.dumps(answers, indent=1) + "\n")
        print(f"{seed}: {case.answer['verdict']} {case.answer['effects']} {case.answer['visibility']}", file=sys.stderr)


def main(arguments: Sequence[str] | None = None) -> None:
    """Write hidden cases of some seeds to a folder."""
    parser = argparse.ArgumentParser(prog="python -m validation.hidden", description=main.__doc__)
    parser.add_argument("-o", "--output", type=Path, required=True, help="folder for the recordings and answers.json")
    parser.add_argument("--seeds", type=seed_range, default="1000-1011", help="FIRST-LAST (default %(default)s)")
    parser.add_argument("--kind", choices=KINDS)
    parser.add_argument("--effect", action="append", metavar="NAME[@PLACE]")
    parser.add_argument("--foreign", action="store_true", help="laws that differ a little from the library's")
    given = parser.parse_args(arguments)
    chosen: dict[str, Any] = {"kind": given.kind, "keys": given.effect, "foreign": given.foreign}
    write_cases(given.output, [(seed, chosen) for seed in given.seeds])


if __name__ == "__main__":
    main()
