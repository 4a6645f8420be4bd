"""What a channel may really be: other readings of one or several channels, and whether the balances of a recording
close far better under them.

A reading is what a column with a wrong name really holds: another sign, unit or line of reference, or another channel.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Literal, NamedTuple

import numpy as np

from ..channels import FULLY_OPEN
from ..units import factor_to_si
from .balances import CLOSES, WORN, Channels, Figures, Grid, Misfit, Misfits, loads, misfits, motions, reach

Kind = Literal["sign", "swapped", "absolute", "scale", "offset"]


class Source(NamedTuple):
    """A channel as another one, times a factor, and an offset in SI."""

    channel: str
    factor: float = 1.0
    offset: float = 0.0


@dataclass(frozen=True)
class Reading:
    """One other reading: the channels that it changes, and what each channel is `made` of; `gone`: the channels that it
    leaves none of.
    """

    kind: Kind
    channels: tuple[str, ...]
    words: str
    made: Mapping[str, Source]
    gone: tuple[str, ...] = ()

    def of(self, grid: Grid) -> Grid:
        """Return the channels as this reading has them."""
        channels = {n: v for n, v in grid.channels.items() if n not in self.gone}
        noise = {n: v for n, v in grid.noise.items() if n not in self.gone}
        channels |= {n: s.factor * grid.channels[s.channel] + s.offset for n, s in self.made.items()}
        noise |= {n: abs(s.factor) * grid.noise[s.channel] for n, s in self.made.items() if s.channel in grid.noise}
        return replace(grid, channels=channels, noise=noise)


@dataclass(frozen=True)
class Weighed:
    """A reading, and how well the balances of a recording close without and with it.

    Attributes:
        gain: sum over the balances of the logarithm of their misfits' ratio, less what a far-fetched reading must be
            better by.
        before, after: the misfits without and with it.
    """

    reading: Reading
    gain: float
    before: Misfits
    after: Misfits

    @property
    def closes(self) -> bool:
        """Whether the balances that are better under it close, as they do on a worn machine; more than one of them for
        values made smaller.
        """
        kind = self.reading.kind
        better = [k for k, m in self.before.items() if k in self.after and _counted(kind, k, m, self.after[k]) > _MOVED]
        enough = 2 if any(abs(s.factor) < 1.0 for s in self.reading.made.values()) else 1
        return len(better) >= enough and all(self.after[k].off <= CLOSES[k[0]] for k in better)

    @property
    def best(self) -> tuple[tuple[str, str], float, float]:
        """Return the balance that gains most, its misfit before and after."""
        kind, both = self.reading.kind, set(self.before) & set(self.after)
        key = max(both, key=lambda k: _counted(kind, k, self.before[k], self.after[k]))
        return key, self.before[key].off, self.after[key].off


#: log by which a reading must be better that is far-fetched beside the others
FAR_FETCHED: Mapping[Kind, float] = {"sign": 0.0, "swapped": 0.0, "absolute": 0.0, "scale": 0.1, "offset": 0.3}
#: log from which on a balance counts as better
_MOVED = 0.3
#: log within which readings are rivals
_TIED = 0.3
#: readings that a recording may ask for, one after the other
_MOST = 6
#: Pa below vapour pressure above which the smallest pressures of a machine lie
_BELOW = 1e5
#: Pa above vapour pressure that its largest pressures exceed
_ABOVE = 1e5
#: pump pressures below which they lie
_PUMPS = 4.0
#: rad that no angle of a machine exceeds
_TURNED = 1.5 * math.pi


def readings(machine: Figures, ch: Channels) -> Iterator[Reading]:
    """Yield the other readings of the channels that are there."""
    yield from _signs(machine, ch)
    yield from _exchanged(machine, ch)
    yield from _other_lines(machine, ch)
    yield from _other_units(machine, ch)


def _signs(machine: Figures, ch: Channels) -> Iterator[Reading]:
    lay = machine.layout
    signed = [n for n in ch if n in (*lay.commands, *lay.coordinates) or _unit(machine, n) in ("rad", "rad/s", "m/s")]
    for n in (*signed, *(n for n in ch if _unit(machine, n) == "Pa")):
        yield Reading("sign", (n,), "with the opposite sign", {n: Source(n, -1.0)})


def _exchanged(machine: Figures, ch: Channels) -> Iterator[Reading]:
    units = [
        machine.layout.commands,
        *([n for n in ch if _unit(machine, n) == unit] for unit in ("rad", "rad/s", "m/s", "Pa", "m")),
    ]
    for a, b in (pair for names in units for pair in combinations([n for n in names if n in ch], 2)):
        yield Reading("swapped", (a, b), f"with {a} and {b} exchanged", {a: Source(b), b: Source(a)})


def _other_lines(machine: Figures, ch: Channels) -> Iterator[Reading]:
    """Angles against the ground taken for those against the parent, the other way round, and against the vertical."""
    sums = {n: sensor.shows for n, sensor in machine.layout.sensors.items() if len(sensor.shows) > 1}
    for n in (n for n in ch if n in sums):
        own = sums[n][-1]
        if own not in ch:
            yield Reading("absolute", (n,), "as an angle relative to its parent", {own: Source(n)}, (n,))
    for name, (*carriers, own) in sums.items():
        if own in ch and name not in ch and all(c in ch for c in carriers):
            yield Reading("absolute", (own,), "as an angle relative to the horizontal", {name: Source(own)}, (own,))
    for n in (n for n in ch if _unit(machine, n) == "rad"):
        for sign, turn in (
            (1.0, 90),
            (1.0, -90),
            (-1.0, 90),
            (-1.0, -90),
            (1.0, 180),
            (-1.0, 180),
            (1.0, -180),
            (-1.0, -180),
        ):
            words = f"as {turn} deg {'plus' if sign > 0 else 'minus'} the recorded value"
            yield Reading("offset", (n,), words, {n: Source(n, sign, math.radians(turn))})


#: units that are taken for the usual one of a quantity, and the other way round: what one of them is in that
_MISTAKEN = {
    "Pa": ("bar", {"psi": factor_to_si("psi", "Pa") / 1e5, "MPa": 10.0, "kPa": 0.01, "Pa": 1e-5}),
    "rad": ("rad", {"deg": math.pi / 180}),
    "rad/s": ("rad/s", {"deg/s": math.pi / 180}), "m": ("m", {"mm": 1e-3, "cm": 1e-2}), "m/s": ("m/s", {"mm/s": 1e-3}),
    "": ("a share", {"%": 1e-2, "a tenth": 0.1}),
}  # fmt: skip


def _other_units(machine: Figures, ch: Channels) -> Iterator[Reading]:
    for unit, (usual, others) in _MISTAKEN.items():
        names = tuple(n for n in ch if (n in machine.layout.commands if unit == "" else _unit(machine, n) == unit))
        for channels in dict.fromkeys([names, *((n,) for n in names)]) if names else ():
            for other, size in others.items():
                for factor, was, given in ((size, other, usual), (1.0 / size, usual, other)):
                    made = {n: Source(n, factor) for n in channels}
                    yield Reading("scale", channels, f"as {was} recorded as {given}", made)


def _unit(machine: Figures, name: str) -> str | None:
    sensors = machine.layout.sensors
    return sensors[name].unit if name in sensors else None


# -- weighing them ---------------------------------------------------------------------------------------------------


def _ratio(key: tuple[str, str], before: Misfit, after: Misfit) -> float:
    """Return the logarithm of the ratio of two misfits, neither taken for less than a worn machine's."""
    return math.log((before.off + WORN[key[0]]) / (after.off + WORN[key[0]]))


def closer(before: Misfits, after: Misfits) -> float:
    """Return the logarithm by which balances close better, over all that hold in both."""
    return sum(_ratio(key, before[key], after[key]) for key in before.keys() & after.keys())


def plausible(machine: Figures, grid: Grid, names: Iterable[str]) -> bool:
    """Whether values are of a size that a machine has."""
    pump = machine.crane["supply.pump_pressure"]
    for n in names:
        low, high = np.quantile(grid.channels[n], [0.05, 0.95])
        if _unit(machine, n) == "Pa" and not (
            low > machine.floor - _BELOW and machine.floor + _ABOVE < high < _PUMPS * pump
        ):
            return False
        if _unit(machine, n) == "rad" and max(abs(low), abs(high)) > _TURNED:
            return False
        if n in machine.layout.commands and np.abs(grid.channels[n]).max() > FULLY_OPEN:
            return False
    return True


def weigh(machine: Figures, grid: Grid, least: float) -> list[Weighed]:
    """Return the other readings of a recording's channels that are of a plausible size and better by `least`, best
    first.
    """
    before = misfits(machine, grid)
    hope = sum(_ratio(k, m, Misfit(0.0)) for k, m in before.items() if k[0] in ("moment", "held"))
    found = []
    for reading in readings(machine, grid.channels):
        other = reading.of(grid)
        if not (plausible(machine, other, reading.made) and _within(reach(machine, other), before)):
            continue
        after = motions(machine, other)
        if _gain(reading.kind, before, after) + hope < least:
            continue
        after |= loads(machine, other)
        found.append(Weighed(reading, _gain(reading.kind, before, after), before, after))
    return sorted((w for w in found if w.gain > least and w.closes), key=lambda w: -w.gain)


def _within(poses: Misfits, before: Misfits) -> bool:
    """Whether poses are not out of reach more often than they were."""
    return all(m.off <= CLOSES[k[0]] or m.off <= before[k].off for k, m in poses.items() if k in before)


def _gain(kind: Kind, before: Misfits, after: Misfits) -> float:
    """Return by how much better balances close."""
    return sum(_counted(kind, k, m, after[k]) for k, m in before.items() if k in after) - FAR_FETCHED[kind]


def _counted(kind: Kind, key: tuple[str, str], before: Misfit, after: Misfit) -> float:
    """Return by how much better a balance closes. One that holds nowhere any more (a chamber said to be empty has no
    oil shut in), and values that another unit makes small enough to vanish in the noise, close nothing.
    """
    ratio = _ratio(key, before, after)
    return ratio if after.seen and (after.clear or kind != "scale") else min(ratio, 0.0)


def mistaken(machine: Figures, grid: Grid, least: float) -> list[list[Weighed]]:
    """Return the readings that a recording asks for, one after the other, each with its rivals behind it."""
    found: list[list[Weighed]] = []
    for _ in range(_MOST):
        ranked = weigh(machine, grid, least)
        if not ranked:
            break
        found.append([w for w in ranked if w.gain > ranked[0].gain - _TIED])
        grid = ranked[0].reading.of(grid)
    return found
