"""Intervals when the model is wrong: machines that are not as the crane file says, followed by the filter that believes
the file.

python -m validation.wrong_models results.jsonl --seeds 0-2    a line a run, then the table; what is there is kept

A seed draws the sensors' noise and chooses the input set: the paper's cycle or one of our own, at twice the pace. With
`--known-from SEED` the crane file knows how far it is off: from that seed's run, in which all pressures were measured.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.measurement import Measurement
from crane_exudyn.statics import visible
from ukf.consistency import coverage
from ukf.estimate import Estimate
from ukf.estimator import Estimator
from ukf.model_error import estimate, lasting
from ukf.signals import Signals
from ukf.tuning import scale

from . import metrics
from .json_lines import read_lines
from .paper import INPUT_SETS
from .seeds import series_parser
from .semi_recursive import SemiRecursiveEngine
from .study import markdown, run

#: what the filter gets: channels with their noise, SI
SENSORS = {"z1": np.radians(0.05), "z4": np.radians(0.05), "p1": 0.3e5, "p4": 0.3e5}
#: sensors of the run from which the model error is known
ALL = SENSORS | {"p2": 0.3e5, "p3": 0.3e5}
#: length of a run, s; samples a second; longest step of the filter, s; from when on it is judged, s
DURATION, RATE, STEP, SETTLED = 12.5, 200, 5e-3, 0.5
#: least share of time inside the 95 % interval, and the widest interval in RMS errors
INSIDE, WIDEST = 0.85, 4.0


def _with(key: str, **values: float) -> Callable[[Crane, np.random.Generator], Crane]:
    return lambda crane, rng: crane.with_effect(key, values)


def _set(**values: float) -> Callable[[Crane, np.random.Generator], Crane]:
    return lambda crane, rng: crane.with_parameters({n.replace("__", "."): v for n, v in values.items()})


def _dead_bands(crane: Crane, rng: np.random.Generator) -> Crane:
    for cylinder in crane.layout.cylinders:
        crane = crane.with_effect(f"dead_band@{cylinder}", {"lower": 0.05, "upper": 0.05})
    return crane


def _everything(crane: Crane, rng: np.random.Generator) -> Crane:
    """Return a crane whose every uncertain parameter is off: lengths of joints by 5 mm, of centres of mass by 20 mm,
    the rest by 15 %.
    """
    off = {}
    for name in crane.uncertainty:
        sign = rng.choice([-1.0, 1.0])
        length = 0.02 if ".com." in name else 0.005 if name.endswith((".x", ".y")) else 0.0
        off[name] = crane[name] + sign * length if length else crane[name] * (1.0 + 0.15 * sign)
    return crane.with_parameters(off)


_FRICTION = {"dFc": 2000.0, "dFs": 2600.0, "vs": 5e-3}
#: the machine by what it has that the file does not say
MACHINES: dict[str, Callable[[Crane, np.random.Generator], Crane]] = {
    "nothing": _set(),
    "payload 140 kg instead of 25": _set(payload__mass=140.0),
    "leak of 5e-12 m³/(s Pa) in the lift cylinder": _with("internal_leakage@lift", k=5e-12),
    "leak of 5e-12 m³/(s Pa) in the tilt cylinder": _with("internal_leakage@tilt", k=5e-12),
    "leak of 2e-12 m³/(s Pa) out of p1": _with("external_leakage@p1", k=2e-12),
    "leak of 2e-12 m³/(s Pa) out of p2": _with("external_leakage@p2", k=2e-12),
    "friction of 2 kN more, lift": _with("seal_friction@lift", **_FRICTION),
    "friction of 2 kN more, tilt": _with("seal_friction@tilt", **_FRICTION),
    "dead band of 5 % of both valves": _dead_bands,
    "1 % of air in the oil": _with("entrained_air", alpha=0.01),
    "pump gives way by 5e9 Pa s/m³": _with("pump_droop", R=5e9),
    "every parameter: 15 %, joints 5 mm, centres of mass 20 mm": _everything,
    "p1 shows 6 bar too much": _with("sensor_bias@p1", b=6e5),
    "p4 shows 6 bar too much": _with("sensor_bias@p4", b=6e5),
}


def recorded(machine: str, seed: int, noise: Mapping[str, float] = SENSORS) -> tuple[Signals, np.ndarray]:
    """Return what the sensors of a machine show, by the noise of each, and its true states at their instants."""
    rng = np.random.default_rng([seed, 17])
    crane = MACHINES[machine](Crane.load("patu655"), rng)
    time = np.arange(round(DURATION * 1000) + 1) * 1e-3
    commands = INPUT_SETS[1 + seed % len(INPUT_SETS)](2.0 * time)
    inputs = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    engine, every = SemiRecursiveEngine(crane), slice(None, None, 1000 // RATE)
    states = engine.simulate(engine.static_start(*crane.initial.pose), time, inputs, step=1e-3)[every]
    shown = Measurement.of(crane, tuple(noise)).shown(states, time[every], settled=True)
    noisy = shown + rng.normal(size=shown.shape) * list(noise.values())
    sensors = {n: (time[every], y) for n, y in zip(noise, noisy.T, strict=True)}
    return Signals(time, commands, sensors, name=machine), visible(crane, states)[:, crane.layout.basic]


def one_run(name: str, machine: str, seed: int, known_from: int | None = None) -> dict[str, Any]:
    """Return how the filter with the crane file follows a machine, as `patu estimate` does it by default and without
    model error; `known_from`: the seed of the run that told how far the file is off.
    """
    signals, truth = recorded(machine, seed)
    crane = Crane.load("patu655")
    if known_from is not None:
        crane = replace(crane, model_error=lasting(crane, [(recorded(machine, known_from, ALL)[0], ALL)]))
    noise = scale(crane, signals, SENSORS, max_step=STEP).noise
    plain = Estimator(crane, "semi-recursive", SENSORS, noise, max_step=STEP)
    found = {mode: estimate(plain, signals, mode=mode) for mode in ("off", "auto")}
    account = found["auto"].model_error
    assert account is not None
    line = {"name": name, "machine": machine, "seed": seed, "used": account.used, "why": account.why}
    return line | {mode: judged(e, truth) for mode, e in found.items()}


def judged(found: Estimate, truth: np.ndarray) -> dict[str, Any]:
    """Return by state the share of time inside the 95 % interval, the RMS error, and half the mean interval over it."""
    on, n = found.time >= SETTLED, truth.shape[1]
    mean, std = found.mean[on, :n], found.std[on, :n]
    rmse = metrics.rmse(mean, truth[on])
    scores = {"inside": coverage(mean - truth[on], std), "rmse": rmse, "width": 1.96 * std.mean(axis=0) / rmse}
    names = found.state_names
    return {k: dict(zip(names, v.tolist(), strict=False)) for k, v in scores.items()} | {"verdict": found.verdict}


def unmeasured(line: Mapping[str, Any]) -> list[str]:
    """Return the states that no sensor measures."""
    return [state for state in line["auto"]["inside"] if state not in SENSORS]


def held(line: Mapping[str, Any]) -> bool:
    """Whether what no sensor measures is inside its interval for `INSIDE` of the time, and that no wider than
    `WIDEST`.
    """
    now = line["auto"]
    return all(now["inside"][s] >= INSIDE and now["width"][s] <= WIDEST for s in unmeasured(line))


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return one row a run, and how many hold, as Markdown."""
    order = {m: k for k, m in enumerate(MACHINES)}
    lines = sorted(lines, key=lambda line: (order[line["machine"]], line["seed"]))
    states = unmeasured(lines[0])
    head = ("the machine has", "seed", *(f"off: {s}" for s in states[2:]), *states, "RMS error of p2, p3, bar, off, on")
    wrong = [line for line in lines if line["machine"] != "nothing"]
    words = (
        f"Every unmeasured state inside >= {100 * INSIDE:g} % of the time, intervals no wider than {WIDEST:g} RMS "
        f"errors: {sum(map(held, wrong))} of {len(wrong)}."
    )
    return f"{markdown(head, map(partial(_row, states), lines))}\n\n{words}\n"


def _row(states: Sequence[str], line: Mapping[str, Any]) -> list[str]:
    off, now = line["off"], line["auto"]
    bars = (f"{mode['rmse'][s] / 1e5:.1f}" for mode in (off, now) for s in states[2:])
    before = (f"{100 * off['inside'][s]:.0f}" for s in states[2:])
    after = (f"{100 * now['inside'][s]:.0f} ({now['width'][s]:.1f})" for s in states)
    return [line["machine"], str(line["seed"]), *before, *after, ", ".join(bars)]


def said(line: Mapping[str, Any]) -> str:
    """Return a run in one line of text."""
    return f"{'held' if held(line) else 'NOT HELD'}: " + ", ".join(_row(unmeasured(line), line)) + f"; {line['why']}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Follow wrong machines, and show how their unmeasured states lie in their intervals."""
    parser = series_parser("wrong_models", main.__doc__, "0-2")
    parser.add_argument("--known-from", type=int, metavar="SEED", help="run with all pressures to learn from first")
    given = parser.parse_args(arguments)
    known = "" if given.known_from is None else f", known from {given.known_from}"
    names = [(f"{m}, {s}{known}", m, s) for s in given.seeds for m in MACHINES]
    tasks = [(name, one_run, (name, m, s, given.known_from)) for name, m, s in names]
    run(given.results, tasks, jobs=given.jobs, say=said)
    print(table(read_lines(given.results)))


if __name__ == "__main__":
    main()
