"""Intervals of a payload that the crane file calls unknown, where the machine is not as the file says in all else too.

python -m validation.payloads results.jsonl --seeds 0-11    a line a run, then the table; what is there is kept

A seed draws a payload between 50 and 300 kg, every other uncertain parameter by its standard uncertainty, a manoeuvre,
the noise of the sensors and, where it is odd, a hidden effect.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.measurement import Measurement
from crane_exudyn.statics import visible
from ukf.estimator import Estimator
from ukf.model_error import estimate
from ukf.signals import Signals
from ukf.tuning import scale

from . import hidden
from .json_lines import read_lines
from .seeds import series_parser
from .semi_recursive import SemiRecursiveEngine
from .study import markdown, run
from .wrong_models import judged

#: sensors of the runs, with the noise that usual ones have; samples a second; longest step of the filter, s
CHANNELS, RATE, STEP = ("z1", "z4_abs", "p1", "p4"), 200, 5e-3
#: payloads that are drawn, kg
PAYLOADS = (50.0, 300.0)
#: draws of machine and manoeuvre after which a seed is given up
_DRAWS = 200


def drawn(seed: int) -> tuple[Crane, Signals, np.ndarray]:
    """Return a machine, what its sensors show, and its true states (N, nx) at their instants."""
    rng, nominal = np.random.default_rng([seed, 41]), Crane.load("patu655")
    problem: CraneError | None = None
    for _ in range(_DRAWS):
        off = {
            n: float(np.clip(nominal[n] + known.std * rng.standard_normal(), known.lower, known.upper))
            for n, known in nominal.uncertainty.items()
            if math.isfinite(known.std)
        }
        off["payload.mass"] = float(rng.uniform(*PAYLOADS))
        try:
            return _recorded(nominal.with_parameters(off), seed, rng)
        except CraneError as found:
            problem = found
    raise CraneError(f"Seed {seed}: {_DRAWS} draws failed, the last: {problem}")


def _recorded(machine: Crane, seed: int, rng: np.random.Generator) -> tuple[Crane, Signals, np.ndarray]:
    """Return what a machine shows in a manoeuvre that is drawn, with an effect that is drawn where the seed is odd."""
    manoeuvre = hidden.draw_manoeuvre(rng)
    if seed % 2:
        names = [k for k in hidden.hideable(CHANNELS) if not k.startswith(("end_stop", "payload_", "sensor_"))]
        key = str(rng.choice(names))
        machine = machine.with_effect(key, hidden.severity(key, machine, manoeuvre.start, rng))
    states = hidden.run_machine(machine, SemiRecursiveEngine(machine), manoeuvre)
    every = slice(None, None, 1000 // RATE)
    time = np.arange(len(states)) * 1e-3
    noise = {n: machine.layout.sensors[n].sizes.noise for n in CHANNELS}
    shown = Measurement.of(machine, CHANNELS).shown(states[every], time[every], settled=True)
    noisy = shown + rng.normal(size=shown.shape) * list(noise.values())
    sensors = {n: (time[every], y) for n, y in zip(CHANNELS, noisy.T, strict=True)}
    truth = visible(machine, states[every])[:, machine.layout.basic]
    return machine, Signals(time, manoeuvre.commands(time), sensors, name=f"seed {seed}"), truth


def one_run(name: str, seed: int) -> dict[str, Any]:
    """Return what `patu estimate` tells of the payload by default, and how the states lie in their intervals."""
    machine, signals, truth = drawn(seed)
    crane = Crane.load("patu655")
    std = {n: crane.layout.sensors[n].sizes.noise for n in CHANNELS}
    noise = scale(crane, signals, std, max_step=STEP).noise
    found = estimate(Estimator(crane, "semi-recursive", std, noise, max_step=STEP), signals)
    account = found.model_error
    assert account is not None
    payload = account.found.get("payload.mass", {})
    line = {"name": name, "seed": seed, "effects": [e.key for e in machine.effects], "used": account.used}
    line |= {"true": machine["payload.mass"], "value": payload.get("value"), "std": payload.get("std")}
    line["why"] = account.why
    return line | {"states": judged(found, truth)}


def score(line: Mapping[str, Any]) -> float:
    """Return the error of the payload in its standard deviations; NaN where it was not estimated."""
    return math.nan if line["std"] is None else (line["value"] - line["true"]) / line["std"]


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return one row a run, and how many hold, as Markdown."""
    lines = sorted(lines, key=lambda line: line["seed"])
    head = ("seed", "hidden", "payload / kg", "estimate / kg", "error in standard deviations")
    scores = np.array([score(line) for line in lines])
    known = np.isfinite(scores)
    words = f"Inside 95 %: {int((np.abs(scores[known]) <= 1.96).sum())} of {int(known.sum())} that were estimated."
    return f"{markdown(head, map(_row, lines))}\n\n{words}\n"


def _row(line: Mapping[str, Any]) -> list[str]:
    estimated = "-" if line["std"] is None else f"{line['value']:.1f} ± {1.96 * line['std']:.1f}"
    return [str(line["seed"]), " ".join(line["effects"]) or "-", f"{line['true']:.1f}", estimated, f"{score(line):.1f}"]


def said(line: Mapping[str, Any]) -> str:
    """Return a run in one line of text."""
    return ", ".join(_row(line))


def main(arguments: Sequence[str] | None = None) -> None:
    """Estimate payloads of wrong machines, and show how they lie in their intervals."""
    given = series_parser("payloads", main.__doc__, "0-11").parse_args(arguments)
    run(given.results, [(f"{s}", one_run, (f"{s}", s)) for s in given.seeds], jobs=given.jobs, say=said)
    print(table(read_lines(given.results)))


if __name__ == "__main__":
    main()
