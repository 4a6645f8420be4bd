"""Recordings with a hidden effect of the other machines that come with the package: an excavator, a loader, and cranes
with other valves or a telescope.

python -m validation.hidden_machines results.jsonl --seeds 0-29     a line a case, then the table; what is there is kept

What is hidden and how severe it is are drawn as in `validation.hidden`, and results are judged as in its study. The
manoeuvres know nothing of a machine but its strokes: each cylinder goes to and fro from the pose to start with.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.effects import registry
from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import simulate

from .hidden import HiddenCase, draw_machine, grouped, hideable, severity, visibility
from .json_lines import read_lines
from .seeds import series_parser
from .study import PROMISED, drawn_line, markdown, run, run_one, share, summary

MACHINES = ("excavator", "loader", "patu655-lab", "patu655-telescope")
#: what is hidden, and how often
_KINDS = {"effect": 0.75, "none": 0.1, "parameters": 0.15}
#: length of a recording, s, and samples a second
DURATION, RATE = 12.0, 100
_EVERY = slice(None, None, 1000 // RATE)
#: standard deviation of the noise of a pressure and of anything else, SI, where the crane file states none
_PRESSURE, _OTHER = 0.3e5, 5e-4
#: largest opening of a valve
OPENING = 0.35
_MOST_DRAWS = 60


def noise_of(crane: Crane) -> dict[str, float]:
    """Return the standard deviation (SI) of the noise of what is recorded: coordinates, and pressures of all
    chambers.
    """
    lay = crane.layout
    usual = {n: _PRESSURE if lay.sensors[n].unit == "Pa" else _OTHER for n in (*lay.coordinates, *lay.chambers)}
    return {n: crane.sensors.get(n) or std for n, std in usual.items()}


def to_and_fro(rng: np.random.Generator, cylinders: int, seconds: float, opening: float = OPENING) -> np.ndarray:
    """Return commands (n, cylinders) every ms, `opening` at most: each cylinder goes to and fro at its own times, with
    corners on the clock of the recording.
    """
    time = np.arange(round(1e3 * seconds) + 1) * 1e-3
    commands = np.zeros((time.size, cylinders))
    for column in commands.T:
        at, sign = 0.4 + round(rng.uniform(0.0, 1.0), 2), rng.choice([-1.0, 1.0])
        while at < seconds - 1.5:
            lasts, height = round(rng.uniform(0.5, 1.2), 2), sign * rng.uniform(0.3, 1.0) * opening
            column += np.interp(time, at + np.array([0.0, 0.15, lasts, lasts + 0.15]), [0.0, height, height, 0.0])
            at, sign = at + lasts + 0.15 + round(rng.uniform(0.2, 1.2), 2), -sign
    return commands


def shown_by(crane: Crane, commands: np.ndarray, engine: str) -> dict[str, np.ndarray]:
    """Return what sensors show without noise while a machine follows commands (n, cylinders) given every ms.

    Raises:
        CraneError: the machine cannot do that, for example because a cylinder comes to the end of its stroke.
    """
    given = dict(zip(crane.layout.commands, commands.T, strict=True))
    time = np.arange(len(commands)) * 1e-3
    driven = simulate(crane, Recording.from_arrays("commands", time, given, layout=crane.layout), engine=engine)
    return {n: driven[n][_EVERY] for n in noise_of(crane)}


def recorded(name: str, crane: Crane, commands: np.ndarray, rng: np.random.Generator) -> Recording:
    """Return the recording of a machine that follows commands (n, cylinders) given every ms, by the Exudyn engine."""
    channels = dict(zip(crane.layout.commands, commands[_EVERY].T, strict=True))
    noise = noise_of(crane)
    for channel, values in shown_by(crane, commands, "exudyn").items():
        channels[channel] = values + noise[channel] * rng.standard_normal(values.size)
    return Recording.from_arrays(name, np.arange(len(commands))[_EVERY] * 1e-3, channels, layout=crane.layout)


def make_case(seed: int) -> HiddenCase:
    """Return the hidden case of a seed.

    Raises:
        CraneError: no draw of severity and commands met the conditions.
    """
    rng = np.random.default_rng([seed, 77])
    nominal = Crane.load(str(rng.choice(MACHINES)))
    kind = str(rng.choice(list(_KINDS), p=list(_KINDS.values())))
    key = _picked(nominal, rng) if kind == "effect" else None
    problem = CraneError("nothing was drawn")
    for _ in range(_MOST_DRAWS):
        try:
            return _drawn(seed, nominal, kind, key, rng)
        except CraneError as found:
            problem = found
    raise CraneError(f"Case {seed} ({nominal.name}, {key or kind}): {_MOST_DRAWS} draws failed, the last: {problem}")


def _picked(crane: Crane, rng: np.random.Generator) -> str:
    """Return an effect to hide that the crane file does not have: names are equally likely, then places."""
    keys = hideable(list(noise_of(crane)), crane.layout)
    new = [k for k in keys if crane.effect(k) is None and not registry.split_key(k)[0].beyond_stroke]
    by_name = grouped(new)
    return str(rng.choice(by_name[str(rng.choice(list(by_name)))]))


def _drawn(seed: int, nominal: Crane, kind: str, key: str | None, rng: np.random.Generator) -> HiddenCase:
    machine, cylinders, noise = _machine(nominal, kind, rng), len(nominal.layout.cylinders), noise_of(nominal)
    hidden = {} if key is None else {key: severity(key, machine, nominal.initial.pose, rng)}
    secret = machine.changed({}, hidden)
    driven, seen = [to_and_fro(rng, cylinders, DURATION) for _ in range(2)], dict[str, float]()
    if key is not None:
        with_it, without = (shown_by(c, driven[0], "semi-recursive") for c in (secret, machine))
        seen[key] = visibility(with_it, without, noise)
        if seen[key] < PROMISED:
            raise CraneError(f"{key} moves the channels by {seen[key]:.2g} noise units only.")
    learn, check = (recorded(f"case {seed} {k}", secret, commands, rng) for k, commands in enumerate(driven))
    answer = {
        "crane": nominal.name, "kind": kind, "verdict": {"none": "adequate"}.get(kind, kind), "effects": list(hidden),
        "parameters": hidden, "visibility": seen, "noise": noise,
        "machine": {n: v for n, v in machine.values.items() if v != nominal.values[n]},
    }  # fmt: skip
    return HiddenCase(seed, learn, check, answer, nominal)


def _machine(nominal: Crane, kind: str, rng: np.random.Generator) -> Crane:
    """Return the machine before anything is hidden in it: often a little off, sometimes with another payload."""
    if kind == "none" or (kind == "effect" and rng.random() < 0.5):
        return nominal
    machine = draw_machine(nominal, rng, errors=True, payload=False)
    ranges = {n: known for n, known in nominal.uncertainty.items() if not math.isfinite(known.std)}
    if kind == "parameters" or rng.random() < 0.3:
        machine = machine.with_parameters({n: rng.uniform(known.lower, known.upper) for n, known in ranges.items()})
    return machine


def _line(seed: int) -> dict[str, Any]:
    return drawn_line(f"case_{seed}", partial(make_case, seed), run_one, {"verdict": "", "effects": []})


def said(line: Mapping[str, Any]) -> str:
    """Return a result in one line of text."""
    return f"{line['answer'].get('crane', '')} {summary(line)}"


def table(lines: Sequence[Mapping[str, Any]]) -> str:
    """Return how each machine's cases came out, as Markdown."""
    good, rows = [line for line in lines if "judged" in line], []
    for machine in MACHINES:
        own = [g for g in good if g["answer"]["crane"] == machine]
        named = [g for g in own if g["answer"]["effects"] and g["judged"]["right"]]
        near = [max(g["judged"]["relative_errors"].values(), default=0.0) <= 0.1 for g in named]
        kinds = (share(g["judged"]["right"] for g in own if g["answer"]["kind"] == kind) for kind in _KINDS)
        checks = share(g["diagnosis"]["check_error_after"] <= 1.2 for g in named)
        rows.append((machine, *kinds, checks, share(near)))
    head = ("machine", "one effect", "nothing", "parameters", "error on check <= 1.2", "parameters within 10 %")
    return f"{markdown(head, rows)}\n"


def main(arguments: Sequence[str] | None = None) -> None:
    """Diagnose hidden effects of the other machines, and show how that came out."""
    given = series_parser("hidden_machines", main.__doc__, "0-29").parse_args(arguments)
    run(given.results, [(f"case_{s}", _line, (s,)) for s in given.seeds], jobs=given.jobs, say=said)
    print(table(read_lines(given.results)))


if __name__ == "__main__":
    main()
