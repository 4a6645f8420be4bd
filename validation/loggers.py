"""Mistakes that loggers make, and how well `crane_exudyn.vetting` finds them.

python -m validation.loggers lift_learn.csv lower_learn.csv      # what is found in each recording, made wrong in each
way python -m validation.loggers --seeds 5000-5009                   # in recordings of hidden cases
"""

from __future__ import annotations

import argparse
import math
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations
from pathlib import Path

import numpy as np

from crane_exudyn.channels import OPEN, Channel
from crane_exudyn.crane import Crane
from crane_exudyn.recording import Recording
from crane_exudyn.vetting import vet
from crane_exudyn.vetting.findings import Finding, Kind

from .seeds import seed_range

_PSI = 14.503774
#: s of a moving mean that smooths, steps in which a channel's range comes
_SMOOTHED, _STEPS = 0.05, 50


@dataclass(frozen=True)
class Mistake:
    """A recording made wrong.

    Attributes:
        name: what was done; kind, channels: of the finding that tells it; recording: the result.
    """

    name: str
    kind: Kind
    channels: frozenset[str]
    recording: Recording

    def found_by(self, findings: Sequence[Finding]) -> bool:
        """Whether it is told first, with its channels."""
        return bool(findings) and findings[0].kind == self.kind and set(findings[0].channels) == self.channels


def mistakes(recording: Recording, crane: Crane) -> Iterator[Mistake]:
    """Yield a recording with each of the mistakes that it can have."""
    lay = crane.layout
    pressures = tuple(n for n in lay.chambers if recording.has(n))
    there = [n for n in lay.coordinates if recording.has(n)]
    angles = [n for n in there if lay.unit_of(n) == "rad"]
    for n in (*lay.commands, *there):
        yield _changed(f"sign of {_what(crane, n)}", "sign", recording, {n: lambda v: -v})
    for kind, names in (("commands", lay.commands), ("angles", angles), ("pressures", pressures)):
        for a, b in combinations(names, 2):
            together = "of a cylinder" if kind == "pressures" and lay.cylinder_of(a) == lay.cylinder_of(b) else ""
            channels = {**recording.channels, a: recording[b], b: recording[a]}
            yield Mistake(
                f"{kind} {together} exchanged".replace("  ", " "),
                "swapped",
                frozenset((a, b)),
                replace(recording, channels=channels),
            )
    for n in (n for n in angles if len(lay.absolute(n)) > 1):
        *carriers, _ = lay.absolute(n)
        base = sum(recording[c].held(recording[n].time) for c in carriers)
        yield _changed(
            "an angle against the ground as one against its parent",
            "absolute",
            recording,
            {n: partial(np.add, base)},
        )
        channels = {k: c for k, c in recording.channels.items() if k != n} | {f"{n}_abs": recording[n]}
        yield Mistake(
            "an angle against its parent as one against the ground",
            "absolute",
            frozenset((f"{n}_abs",)),
            replace(recording, channels=channels),
        )
    for n in pressures:
        yield _changed("psi as bar, one pressure", "scale", recording, {n: lambda v: _PSI * v})
    yield _changed("psi as bar, all pressures", "scale", recording, dict.fromkeys(pressures, lambda v: _PSI * v))
    yield _changed("MPa as bar, all pressures", "scale", recording, dict.fromkeys(pressures, lambda v: 0.1 * v))
    yield _changed("% as share, all commands", "scale", recording, dict.fromkeys(lay.commands, lambda v: 0.01 * v))
    angle = angles[0]
    yield _changed("rad as deg", "scale", recording, {angle: lambda v: math.radians(1.0) * v})
    yield _changed("angle against the vertical", "offset", recording, {angle: lambda v: 0.5 * math.pi - v})
    for late in (-1.0, -0.3, 0.3, 1.0):
        word = "before" if late > 0.0 else "after"
        yield _stamped(
            f"commands stamped {abs(late):g} s {'late' if late > 0 else 'early'}: motion {word} them",
            recording,
            lay.commands,
            late,
            0.0,
        )
    yield _stamped("commands' clock drifts by 1 %", recording, lay.commands, 0.0, 0.01)
    yield _changed(
        "pressure cut off", "saturation", recording, {pressures[0]: lambda v: np.minimum(v, np.quantile(v, 0.9))}
    )
    yield _changed("angle smoothed by the logger", "noise", recording, {angle: _smoother(recording, angle)})
    yield _changed("angle in coarse steps", "noise", recording, {angle: _stepped})
    yield from _begun_in_motion(recording, crane)


def _what(crane: Crane, name: str) -> str:
    units = {"rad": "an angle", "m": "an extension"}
    return "a command" if name in crane.layout.commands else units[crane.layout.unit_of(name)]


def _changed(
    name: str, kind: Kind, recording: Recording, changes: dict[str, Callable[[np.ndarray], np.ndarray]]
) -> Mistake:
    channels = dict(recording.channels)
    channels |= {n: replace(channels[n], values=change(channels[n].values)) for n, change in changes.items()}
    return Mistake(name, kind, frozenset(changes), replace(recording, channels=channels))


def _stamped(name: str, recording: Recording, names: Sequence[str], late: float, drift: float) -> Mistake:
    channels = dict(recording.channels)
    for n in names:
        time = recording[n].time
        channels[n] = Channel(time + late + drift * (time - time[0]), recording[n].values, recording[n].unit)
    return Mistake(name, "clock", frozenset(names), replace(recording, channels=channels))


def _smoother(recording: Recording, name: str) -> Callable[[np.ndarray], np.ndarray]:
    wide = 1 + 2 * round(0.5 * _SMOOTHED * recording.sampling_rate)
    return lambda v: np.convolve(np.pad(v, wide // 2, "edge"), np.full(wide, 1.0 / wide), "valid")


def _stepped(values: np.ndarray) -> np.ndarray:
    step = float(np.ptp(values)) / _STEPS
    return np.round(values / step) * step


def _begun_in_motion(recording: Recording, crane: Crane) -> Iterator[Mistake]:
    for n in crane.layout.commands:
        opened = np.flatnonzero(np.abs(recording[n].values) > 2.0 * OPEN)
        if len(opened):
            start = float(recording[n].time[opened[0]]) + 0.5
            cut = recording.window(start, recording.end)
            names = frozenset(c for c in crane.layout.commands if abs(cut[c].values[0]) > OPEN)
            if names:
                yield Mistake("begins in motion", "motion", names, cut)
                return


# -- how well they are found -----------------------------------------------------------------------------------------


def main(arguments: Sequence[str] | None = None) -> None:
    """Print how often each mistake is told first, with the right kind and channels, and as an error; and what is told
    of sound recordings.
    """
    parser = argparse.ArgumentParser(prog="python -m validation.loggers", description=main.__doc__)
    parser.add_argument("recordings", nargs="*", type=Path)
    parser.add_argument("--seeds", type=seed_range, default=range(0), metavar="FIRST-LAST", help="hidden cases to make")
    parser.add_argument("--without", nargs="*", default=[], metavar="CHANNEL", help="sensors to leave out")
    parser.add_argument("--crane", default="patu655", metavar="NAME-or-FILE", help="built-in crane or TOML file")
    given = parser.parse_args(arguments)
    crane = Crane.load(given.crane)
    counts: dict[str, list[tuple[bool, bool]]] = defaultdict(list)
    for recording in _recordings(crane, given.recordings, given.seeds):
        whole = recording.select([n for n in recording.channels if n not in given.without])
        alarms = [f for f in vet(whole, crane) if f.severity != "note"]
        print(f"{whole.name} ({len(whole.sensors)} sensors)", file=sys.stderr, flush=True)
        counts["nothing"].append((not alarms, not any(f.severity == "error" for f in alarms)))
        for finding in alarms:
            print(f"{whole.name}: {finding.severity}: {finding.text}", file=sys.stderr)
        for mistake in _one_of_each(mistakes(whole, crane), len(counts["nothing"])):
            findings = vet(mistake.recording, crane)
            right = mistake.found_by(findings)
            counts[mistake.name].append((right, right and findings[0].severity == "error"))
            said = "; ".join(f"{f.severity} {f.kind} {' '.join(f.channels)}" for f in findings[:3]) or "nothing"
            print(
                f"  {'right' if right else 'WRONG'}: {mistake.name} ({' '.join(sorted(mistake.channels))}): {said}",
                file=sys.stderr,
                flush=True,
            )
    print("| mistake | recordings | told first | as an error |\n|---|---|---|---|")
    for name, told in counts.items():
        print(f"| {name} | {len(told)} | {sum(t for t, _ in told)} | {sum(e for _, e in told)} |")


def _one_of_each(made: Iterator[Mistake], turn: int) -> list[Mistake]:
    """Return one mistake of each name, of other channels in each turn."""
    by_name: dict[str, list[Mistake]] = defaultdict(list)
    for mistake in made:
        by_name[mistake.name].append(mistake)
    return [same[turn % len(same)] for same in by_name.values()]


def _recordings(crane: Crane, files: Sequence[Path], seeds: range) -> Iterator[Recording]:
    yield from (Recording.load(file, layout=crane.layout) for file in files)
    for seed in seeds:
        from .hidden import make_case

        case = make_case(seed, rate=200, sensors=0)
        yield from (case.learn, case.check)


if __name__ == "__main__":
    main()
