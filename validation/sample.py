"""Recordings to play with: of a sound machine, of one with a hidden effect, and of loggers with their own names, units
and mistakes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np

from crane_exudyn.crane import Crane
from crane_exudyn.files import write_text
from crane_exudyn.formats import write_table
from crane_exudyn.mapping import Column, map_text
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import simulate
from crane_exudyn.units import factor_to_si

from .report import Options, next_command

#: s, step of the recordings, and of the ramps with which valves open
_STEP, _RAMP = 0.005, 0.15


@dataclass(frozen=True)
class Manoeuvre:
    """What an operator does: a duration in s, and pulses of the first valve (when it opens, for how long, by how much).

    The next valve does the same `later` seconds after.
    """

    duration: float
    pulses: tuple[tuple[float, float, float], ...]
    later: float

    def commands(self, time: np.ndarray, valve: int) -> np.ndarray:
        """Return the command (n,) of a valve, which opens and closes by ramps."""
        corners = [
            (t, u)
            for begin, lasts, size in self.pulses
            for t, u in ((begin, 0.0), (begin + _RAMP, size), (begin + lasts, size), (begin + lasts + _RAMP, 0.0))
        ]
        return np.interp(time - valve * self.later, *np.array(corners).T)


_MANOEUVRES = {
    "learn": Manoeuvre(20.0, ((1.5, 2.0, 0.3), (6.5, 1.5, -0.2), (11.0, 1.5, 0.2), (15.0, 1.5, -0.3)), later=2.2),
    "check": Manoeuvre(20.0, ((1.0, 1.2, 0.4), (5.5, 2.0, -0.25), (10.0, 2.2, 0.15), (14.5, 1.0, -0.2)), later=2.2),
}
#: the effect that is hidden, at the first cylinder: a third of a litre a minute at 50 bar
_EFFECT, _VALUES = "internal_leakage", {"k": 1e-12}
#: how the logger writes each quantity: name, unit, sign
_LOGGED = {
    "": ("Valve", "%", 1.0),
    "rad": ("Angle", "deg", -1.0),
    "m": ("Stroke", "mm", 1.0),
    "Pa": ("Pressure", "psi", 1.0),
}


@dataclass(frozen=True)
class Sample:
    """A file to play with: what it is, what writes it, and the command to try, on which recording, with which other
    files.
    """

    file: str
    text: str
    save: Callable[[Path], object]
    command: str
    recording: str
    others: Mapping[str, str] = field(default_factory=dict)

    def command_line(self, folder: Path, given: Options | None = None) -> str:
        """Return what to type for the files in a folder; `given` are options of the run that wrote them."""
        others = {flag: folder / name for flag, name in self.others.items()}
        return next_command(self.command, [folder / self.recording], {**(given or {}), **others})


def samples(crane: Crane) -> list[Sample]:
    """Return all files to play with, of a crane."""
    lay = crane.layout
    key = f"{_EFFECT}@{lay.cylinders[0]}"
    sound = recorded(crane, "learn", _MANOEUVRES["learn"], seed=0)
    leaky = crane.with_effect(key, _VALUES)
    learn, check = (recorded(leaky, name, how, seed) for seed, (name, how) in enumerate(_MANOEUVRES.items(), 1))
    table, mapping = _logged(sound)
    a, b = lay.sides[0]
    last = lay.commands[-1]
    exchanged = {a: sound[b], b: sound[a], last: replace(sound[last], values=-sound[last].values)}
    wrong = replace(sound, channels={**sound.channels, **exchanged})
    checked, mapped = {"--check": "hidden_check.csv"}, {"--map-file": "logger.toml"}

    def write_map(path: Path) -> None:
        write_text(path, map_text(mapping, lay))

    return [
        Sample("clean.csv", "a sound machine as the crane file describes it", sound.save, "compare", "clean.csv"),
        Sample("hidden_learn.csv", "a machine with a hidden effect",
               learn.save, "diagnose", "hidden_learn.csv", checked),
        Sample("hidden_check.csv", "the same machine, another manoeuvre", check.save, "compare", "hidden_check.csv"),
        Sample("logger.csv", "the sound machine, recorded by a logger with its own names and units",
               partial(write_table, columns=table), "check", "logger.csv", mapped),
        Sample("logger.toml", "the map file for that logger's columns", write_map, "compare", "logger.csv", mapped),
        Sample("mistaken.csv", "the sound machine, with wrong column names", wrong.save, "check", "mistaken.csv"),
    ]  # fmt: skip


def recorded(crane: Crane, name: str, manoeuvre: Manoeuvre, seed: int) -> Recording:
    """Return what usual sensors of a crane show while its valves open one after the other."""
    from .semi_recursive import SemiRecursiveEngine

    lay = crane.layout
    time = np.arange(round(manoeuvre.duration / _STEP) + 1) * _STEP
    commands = {n: manoeuvre.commands(time, c) for c, n in enumerate(lay.commands)}
    run = simulate(crane, Recording.from_arrays(name, time, commands, layout=lay), engine=SemiRecursiveEngine(crane))
    rng = np.random.default_rng(seed)
    shown = {
        n: run[n] + lay.sensors[n].sizes.noise * rng.standard_normal(len(time))
        for n in (*lay.coordinates, *lay.chambers)
    }
    return Recording.from_arrays(name, time, commands | shown, layout=lay)


def with_the_package() -> tuple[Recording, Recording]:
    """Return the two recordings that come with the package, of one crane that is not as its file says."""
    folder = Path(__file__).parent / "data"
    learn, check = (Recording.load(folder / f"demo_{part}.csv.gz") for part in ("learn", "check"))
    return learn, check


def _logged(recording: Recording) -> tuple[dict[str, np.ndarray], dict[str, Column]]:
    """Return a recording as a logger's table, and what its columns are."""
    first = recording[recording.sensors[0]]
    table, mapping = {"Clock": first.time}, {"time": Column("Clock", "s")}
    for name, channel in recording.channels.items():
        word, unit, sign = _LOGGED[channel.unit]
        header = f"{word}{1 + sum(c.header.startswith(word) for c in mapping.values())}"
        table[header] = sign * channel.values / factor_to_si(unit, channel.unit)
        mapping[name] = Column(header, unit, sign)
    return table, mapping
