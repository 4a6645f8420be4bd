"""How far the channels of a recording agree with each other on a crane: balances of oil, of moments, of lengths and of
rates.

Only what every machine has is asked, and only roughly: which way and about how far a piston moves while its valve is
open, how oil that is shut in gives way, what the weights ask of the cylinders. So a machine that leaks, sticks or
carries another load still agrees with itself; channels that are exchanged, turned round or in another unit do not.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ..crane import Crane
from ..description import Uncertainty
from ..errors import CraneError
from ..geometry import cylinder_lengths
from ..hydraulics import held_amounts, valve_flows
from ..inputs import SpoolPath
from ..pose import relative
from ..recording import Recording
from ..signals import noise_std, sampling_rate, usual_range
from ..static_start import static_start
from ..statics import vapour_pressure

#: s, step of the common grid
STEP = 0.02
#: s of a recording that are looked at
LONGEST = 60.0
#: s, width of the smoothing
SMOOTH = 0.16
#: s that a window spans
SPAN = 0.4
#: s over which a load's change is looked at
LOAD_SPAN = 1.2
#: steps of the grid from the beginning of a window to that of the next
_EVERY = 5
#: poses at which the statics are solved
_POSES = 40
#: rad (or m) within which the statics are those of one pose
_NEAR = 0.01
#: by this factor wear, another valve or an effect may change a flow or a stiffness
_GAIN = 2.5
#: and by this one a piston may move more than the oil that is shut in gives way: a structure that bends is in series
_SOFTER = 25.0
#: Pa above the lowest pressure below which a chamber may hold a void, so that its oil is not shut in
_VOID = 2e5
#: a spool that is open by less is closed
_CLOSED = 0.01
#: a command that is never larger opens no valve
_UNCOMMANDED = 0.02
#: m/s up to which a piston may sink while its valve is closed: a leak of some l/min
_LEAKING = 0.015
#: share of windows in which a pose must be within reach
_MOST = 0.8
#: windows that a balance must hold on: of fewer, which overlap, one moment decides
_FEWEST = 8
#: standard deviations of the noise beyond which something moves
_CLEAR = 4.0
#: m by which a cylinder may seem longer or shorter than it can be: pins and zero points are known to that
PLAY = 0.03
#: a value so many times the usual range away from it is a spike
_SPIKE = 3.0
#: misfit of each kind of balance that a worn machine may have, and that still counts as closed: effects act on some
#: more than on others
WORN: Mapping[str, float] = {
    "flow": 0.06,
    "trapped": 0.2,
    "held": 0.3,
    "moment": 0.15,
    "length": 0.1,
    "rate": 0.1,
    "sum": 0.05,
    "reach": 0.05,
}
CLOSES: Mapping[str, float] = {
    "flow": 0.6,
    "trapped": 0.6,
    "held": 1.0,
    "moment": 0.5,
    "length": 0.5,
    "rate": 0.3,
    "sum": 0.3,
    "reach": 0.2,
}

Channels = Mapping[str, np.ndarray]


class Misfit(NamedTuple):
    """How far a balance is off.

    Attributes:
        off: 0 where both sides agree or nothing is to be seen, 1 where one side knows nothing of the other, up to 2.
        clear: whether its sides are well above their noise; seen: whether there is any stretch on which it holds.
    """

    off: float
    clear: bool = True
    seen: bool = True


#: by (kind, what it is of)
Misfits = dict[tuple[str, str], Misfit]


@dataclass(frozen=True)
class Grid:
    """Channels of a recording at common instants.

    Attributes:
        time: (N,) s, a step apart.
        channels: name -> (N,) in SI; commands in [-1, 1]. Commands are missing where they were not recorded.
        noise: of each sensor after smoothing, SI.
    """

    time: np.ndarray
    channels: Channels
    noise: Mapping[str, float]

    @classmethod
    def of(cls, recording: Recording, crane: Crane) -> Grid | None:
        """Return the first minute of a recording that all its channels share; None if they share next to nothing."""
        names = [n for n in (*recording.sensors, *crane.layout.supply) if recording.has(n)]
        clocks = [recording[n].time for n in names]
        try:
            clocks.append((driven := recording.commands(crane))[0])
        except CraneError:  # no commands, or voltages without a calibration
            driven = None
        start = max((float(t[0]) for t in clocks), default=0.0)
        end = min([start + LONGEST, *(float(t[-1]) for t in clocks)])
        if end - start < 2.0 * LOAD_SPAN:
            return None
        time = np.arange(start, end, STEP)
        found = {n: _averaged(recording, n, time) for n in names}
        noise = {n: _left(recording, n) for n in names}
        if driven is not None:
            found |= {n: np.interp(time, driven[0], u) for n, u in zip(crane.layout.commands, driven[1].T, strict=True)}
        return cls(time, found, noise)


def _averaged(recording: Recording, name: str, time: np.ndarray) -> np.ndarray:
    """Return a channel without spikes at `time` (N,), averaged over a step."""
    channel = recording[name]
    low, high = usual_range(channel.values)
    reach = _SPIKE * max(high - low, 1e-300)
    sound = (channel.values >= low - reach) & (channel.values <= high + reach)  # a channel may stand still
    wide = max(1, round(STEP * sampling_rate(channel.time)))
    padded = np.pad(channel.values[sound], (wide // 2, wide - 1 - wide // 2), "edge")
    means = np.convolve(padded, np.full(wide, 1.0 / wide), "valid")
    return np.interp(time, channel.time[sound], means)


def _left(recording: Recording, name: str) -> float:
    channel = recording[name]
    return noise_std(channel.values) / np.sqrt(max(SMOOTH * sampling_rate(channel.time), 1.0))


class Figures:
    """What is known of a crane without a recording of it; lengths and forces of poses are computed once."""

    def __init__(self, crane: Crane) -> None:
        self.crane, self.layout = crane, crane.layout
        self.parameters, self.effects = crane.parameter_vector(), crane.effect_vector()
        self.shortest, self.longest = np.transpose([crane.stroke(c) for c in crane.layout.cylinders])
        self.floor = vapour_pressure(crane)
        self._loads = [crane.with_parameters({"payload.mass": m}) for m in _payloads(crane)]
        self._lengths: dict[bytes, np.ndarray] = {}
        self._forces: dict[bytes, np.ndarray] = {}
        self._flows: dict[tuple[object, ...], Misfits] = {}

    def areas(self, c: int) -> tuple[float, float]:
        """Return the areas (m²) of a cylinder's piston side and rod side."""
        return self.crane.areas(self.layout.cylinders[c])

    def held(self, c: int, side: int, length: np.ndarray, pressure: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return how much oil (m³) a cylinder's chamber holds at its lengths (N,) and pressures (N,), and how much a
        pressure presses into it (m³/Pa).

        NaN where no number is large enough: pressures in a wrong unit press any oil in.
        """
        held, slopes = held_amounts(self.parameters, self.effects, c, bool(side), length, pressure)
        return np.where(np.isfinite(held), held, np.nan), np.asarray(slopes)

    def lengths(self, z: np.ndarray) -> np.ndarray:
        """Return pin-to-pin lengths (N, cylinders) in m at coordinates z (N, n); NaN out of reach."""
        key = z.tobytes()
        if key not in self._lengths:
            self._lengths[key] = cylinder_lengths(self.crane, z)
        return self._lengths[key]

    def reaches(self, lengths: np.ndarray) -> np.ndarray:
        """Return whether each cylinder can have its lengths (N, cylinders)."""
        return np.asarray((lengths > self.shortest - PLAY) & (lengths < self.longest + PLAY))

    def holding(self, z: np.ndarray) -> np.ndarray:
        """Return the forces (2, K, cylinders) in N that hold the machine near z (K, n), with the least and the greatest
        payload; NaN where none do.
        """
        near = np.round(z / _NEAR) * _NEAR
        for pose in near:
            if pose.tobytes() not in self._forces:
                self._forces[pose.tobytes()] = np.array([self._held(crane, pose) for crane in self._loads])
        return np.stack([self._forces[pose.tobytes()] for pose in near], axis=1)

    def flows(self, grid: Grid, c: int, length: np.ndarray, spool: np.ndarray) -> Misfits:
        """Return how far the flows of a cylinder are off (`_flows`), which most other readings leave as they were."""
        lay, ch = self.layout, grid.channels
        parts = [length, spool, *(ch[n] for n in (lay.lengths[c], *lay.sides[c], *lay.supply) if n in ch)]
        key = (c, *(part.tobytes() for part in parts))
        if key not in self._flows:
            self._flows[key] = _flows(self, grid, ch, c, length, spool)
        return self._flows[key]

    def _held(self, crane: Crane, pose: np.ndarray) -> list[float]:
        count = len(self.layout.cylinders)
        try:
            state = static_start(crane, *pose)
        except CraneError:
            return [np.nan] * count
        pressures = [state[self.layout.pressures_of(c)] for c in range(count)]
        return [
            float(p @ np.array([a, -b])) for p, (a, b) in zip(pressures, map(self.areas, range(count)), strict=True)
        ]


def _payloads(crane: Crane) -> tuple[float, float]:
    """Return the least and the greatest payload in kg that the crane file allows for; its own where it gives no
    uncertainty.
    """
    mass, known = crane["payload.mass"], crane.uncertainty.get("payload.mass", Uncertainty(0.0))
    low, high = max(known.lower, mass - 3.0 * known.std, 0.0), min(known.upper, mass + 3.0 * known.std)
    return low, high if math.isfinite(high) else mass


# -- the balances ----------------------------------------------------------------------------------------------------


def misfits(machine: Figures, grid: Grid) -> Misfits:
    """Return how far each balance is off that the channels of a recording can tell."""
    return motions(machine, grid) | loads(machine, grid)


def motions(machine: Figures, grid: Grid) -> Misfits:
    """Return how far all balances are off but those of loads, which take longest."""
    ch, z = grid.channels, positions(machine, grid)
    lengths = machine.lengths(z)
    out = _sums(machine, ch) | _rates(machine, grid, ch) | _lengths(machine, ch, lengths) | reach(machine, grid)
    spools = _spools(machine, grid, ch)
    if spools is not None:
        for c in range(len(machine.layout.cylinders)):
            out |= machine.flows(grid, c, lengths[:, c], spools[:, c])
    return out


def positions(machine: Figures, grid: Grid) -> np.ndarray:
    """Return coordinates (N, n) from those that were measured, angles each against its parent or against the ground;
    NaN without.
    """
    nowhere = np.full(len(grid.time), np.nan)
    return _columns(relative(machine.layout, grid.channels, dict.fromkeys(machine.layout.coordinates, nowhere)))


def _columns(z: Mapping[str, np.ndarray]) -> np.ndarray:
    return np.column_stack(list(z.values()))


def _spools(machine: Figures, grid: Grid, ch: Channels) -> np.ndarray | None:
    names = machine.layout.commands
    if not all(n in ch for n in names):
        return None
    commands = np.clip(np.column_stack([ch[n] for n in names]), -1.0, 1.0)
    return np.asarray(SpoolPath(machine.crane).run(grid.time, commands))


def _sums(machine: Figures, ch: Channels) -> Misfits:
    """An angle against the ground is the sum of those that carry it."""
    out, sensors = {}, machine.layout.sensors
    for name in (n for n in ch if n in sensors and len(sensors[n].shows) > 1):
        parts = [ch.get(n) for n in sensors[name].shows]
        if all(p is not None for p in parts):
            tolerance = np.radians(5.0) if sensors[name].unit == "rad" else np.radians(5.0) / SPAN
            out["sum", name] = _apart(sum(parts), ch[name], tolerance)  # type: ignore[arg-type]
    return out


def _rates(machine: Figures, grid: Grid, ch: Channels) -> Misfits:
    out, sensors = {}, machine.layout.sensors
    for name in (n for n in ch if n in sensors and sensors[n].unit in ("rad/s", "m/s")):
        angle = name.removeprefix("d")
        if angle in ch:
            turned, noise = mean(smooth(ch[name])) * SPAN, np.hypot(grid.noise[angle] * 1.5, grid.noise[name] * SPAN)
            out["rate", name] = _proportional(change(smooth(ch[angle])), turned, float(noise))
    return out


def _lengths(machine: Figures, ch: Channels, lengths: np.ndarray) -> Misfits:
    names = machine.layout.lengths
    return {
        ("length", n): _apart(lengths[:, c], ch[n], PLAY)
        for c, n in enumerate(names)
        if n in ch and np.isfinite(lengths[:, c]).any()
    }


def reach(machine: Figures, grid: Grid) -> Misfits:
    """Return for which share of the time each cylinder does not reach the pose, or the linkage cannot have it; of those
    cylinders of which all that moves them was measured.
    """
    lay, measured = machine.layout, relative(machine.layout, grid.channels)
    filed = zip(lay.coordinates, machine.crane.initial.pose, strict=True)
    z = {name: np.full(len(grid.time), value) for name, value in filed} | measured
    good = machine.reaches(machine.lengths(_columns(z)))
    return {
        ("reach", c.name): Misfit(1.0 - float(good[:, i].mean()))
        for i, c in enumerate(machine.crane.machine.cylinders)
        if machine.crane.machine.moved_by(c) <= measured.keys()
    }


def _flows(machine: Figures, grid: Grid, ch: Channels, c: int, length: np.ndarray, spool: np.ndarray) -> Misfits:
    """What flows into a chamber is what it holds more, in metres of its piston; with the valve closed its motion
    presses the oil.

    Where it may hold a void or gas it tells nothing. Slow motion with the valve closed is leakage, so that only its
    changes from one span to the next count there.
    """
    lay, out = machine.layout, {}
    if np.isnan(length).all():
        if lay.lengths[c] not in ch:
            return {}
        length, noise = ch[lay.lengths[c]], grid.noise[lay.lengths[c]]
    else:
        noise = _noise_of_length(machine, grid, c)
    moved = change(smooth(length))
    still = _nowhere(np.abs(spool) > _CLOSED)
    flows = _valve(machine, ch, c, spool)
    for side, name in enumerate(lay.sides[c]):
        area, sign = machine.areas(c)[side], 1.0 - 2.0 * side
        if name not in ch:
            continue
        held, soft = machine.held(c, side, length, ch[name])
        gained = sign / area * change(smooth(held))
        pressed = gained - moved
        flowed = sign / area * SPAN * mean(smooth(flows[side]))
        blurred = 1.5 * float(np.hypot(noise, np.nanmean(soft) / area * grid.noise[name]))
        stiff = machine.held(c, side, length, np.full(len(length), machine.crane["supply.pump_pressure"]))[1]
        whole = _nowhere((ch[name] < machine.floor + _VOID) | (soft > _GAIN * stiff))
        out["flow", name] = _proportional(gained[whole], flowed[whole], blurred)
        shut = still & whole
        out["trapped", name] = _proportional(_bend(moved, shut), -_bend(pressed, shut), 1.7 * blurred, _SOFTER)
    if not out:
        flow = (
            machine.crane[f"valves.{lay.cylinders[c]}.flow_coefficient"]
            * spool
            * np.sqrt(0.5 * machine.crane["supply.pump_pressure"])
        )
        flowed = SPAN / machine.areas(c)[0] * mean(smooth(flow))
        out["flow", lay.cylinders[c]] = _proportional(moved, flowed, 1.5 * noise)
    return out


def _valve(machine: Figures, ch: Channels, c: int, spool: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the flows (N,) in m³/s that a valve lets into the piston side and the rod side; a chamber that was not
    measured counts as empty.
    """
    crane, lay = machine.crane, machine.layout
    pump, tank = (
        ch.get(n, np.full(len(spool), crane[f"supply.{w}_pressure"]))
        for n, w in zip(lay.supply, ("pump", "tank"), strict=True)
    )
    pa, pb = (ch.get(n, tank) for n in lay.sides[c])
    P, E = machine.parameters, machine.effects
    into_a, into_b = valve_flows(crane.machine.topology, P, E, c, spool, pump, tank, pa, pb)
    return np.asarray(into_a), np.asarray(into_b)


def _noise_of_length(machine: Figures, grid: Grid, c: int) -> float:
    """Return the noise in m of a length that follows from coordinates: an angle's lever arm of a metre would be much, a
    third is usual.
    """
    driven = machine.layout.driven[c]
    arm = 0.3 if machine.layout.unit_of(driven) == "rad" else 1.0
    return arm * max((grid.noise[n] for n in (driven, f"{driven}_abs") if n in grid.noise), default=0.0)


def loads(machine: Figures, grid: Grid) -> Misfits:
    """Return how far what the cylinders hold is from what the weights ask for, with some payload; and its changes while
    the valve is closed.
    """
    lay, out, ch, z = machine.layout, Misfits(), grid.channels, positions(machine, grid)
    spools = _spools(machine, grid, ch)
    if not np.isfinite(z).all():
        return {}
    at = np.linspace(0, len(grid.time) - 1, min(_POSES, len(grid.time))).astype(int)
    light, heavy = machine.holding(np.ascontiguousarray(np.column_stack([smooth(column) for column in z.T])[at]))
    limits = [_held_between(machine, ch, c, at) for c in range(len(lay.cylinders))]
    asked = [light + share * (heavy - light) for share in np.linspace(0.0, 1.0, 11)]
    tried = [[_between(f[:, c], *limits[c]) for c in range(len(limits))] for f in asked]
    best = int(np.argmin([sum(m * m for m in row) for row in tried]))
    for c, name in enumerate(lay.cylinders):
        if any(n in ch for n in lay.sides[c]):
            out["moment", name] = Misfit(tried[best][c])
            if spools is not None:
                out["held", name] = _load_changes(machine, grid, ch, c, asked[best][:, c], at, spools[:, c])
    return out


def _held_between(machine: Figures, ch: Channels, c: int, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return between which forces (K,) a cylinder's pressures hold at some instants; one that was not measured lies
    between nothing and the pump's.
    """
    pump, (a, b) = machine.crane["supply.pump_pressure"], machine.areas(c)
    low, high = np.zeros(len(at)), np.zeros(len(at))
    for name, area in zip(machine.layout.sides[c], (a, -b), strict=True):
        known = smooth(ch[name])[at] * area if name in ch else None
        low += known if known is not None else min(0.0, area * pump)
        high += known if known is not None else max(0.0, area * pump)
    return low, high


def _between(force: np.ndarray, low: np.ndarray, high: np.ndarray) -> float:
    """Return how far forces (K,) are outside their limits, as a share of them."""
    if np.isfinite(force).mean() < 0.5:
        return 1.0
    near = np.clip(force, low, high)
    return float(np.nansum(np.abs(force - near)) / max(np.nansum(np.abs(force) + np.abs(near)), 1e-300))


def _load_changes(
    machine: Figures, grid: Grid, ch: Channels, c: int, asked: np.ndarray, at: np.ndarray, spool: np.ndarray
) -> Misfit:
    """Return how far a closed cylinder's force fails to follow its load; a chamber that was not measured gives way with
    the other.
    """
    a, b = machine.areas(c)
    names = machine.layout.sides[c]
    measured = [smooth(ch[n]) if n in ch else None for n in names]
    force = np.zeros(len(grid.time))
    for side, (p, area) in enumerate(zip(measured, (a, -b), strict=True)):
        if p is not None:
            force += area * p * (1.0 if measured[1 - side] is not None else 1.5)
    still = _nowhere(np.abs(spool) > _CLOSED, LOAD_SPAN)
    load = change(np.interp(grid.time, grid.time[at], np.nan_to_num(asked)), LOAD_SPAN)
    noise = 1.5 * max(grid.noise[n] for n in names if n in ch) * a
    return _proportional(change(force, LOAD_SPAN)[still], load[still], float(noise))


def travels(machine: Figures, grid: Grid) -> dict[str, float]:
    """Return how far (m) each piston moves whose valve is never commanded, so fast that no leak explains it; without
    those that do not.
    """
    lay, ch, found = machine.layout, grid.channels, {}
    lengths = machine.lengths(positions(machine, grid))
    for c, (cylinder, command) in enumerate(zip(lay.cylinders, lay.commands, strict=True)):
        if command not in ch or np.abs(ch[command]).max() > _UNCOMMANDED:
            continue
        known = np.isfinite(lengths[:, c]).mean() > _MOST
        length = lengths[:, c] if known else ch.get(lay.lengths[c])
        if length is not None:
            noise = _noise_of_length(machine, grid, c) if known else grid.noise[lay.lengths[c]]
            speed = np.nan_to_num(change(smooth(length)) / SPAN)
            speed[np.abs(speed) < max(_LEAKING, _CLEAR * 1.5 * noise / SPAN)] = 0.0
            way = float(np.ptp(np.concatenate([[0.0], np.cumsum(speed) * STEP * _EVERY])))
            if way > 2.0 * PLAY:
                found[cylinder] = way
    return found


def flow_misfits(machine: Figures, grid: Grid, lateness: np.ndarray) -> np.ndarray | None:
    """Return how far each cylinder's flows are off (L, cylinders) if the commands acted at `grid.time - lateness` (L,
    N); None without commands.

    NaN for a cylinder of which nothing moves or is measured.
    """
    ch, lay = grid.channels, machine.layout
    spools = _spools(machine, grid, ch)
    if spools is None:
        return None
    lengths = machine.lengths(positions(machine, grid))
    found = np.full((len(lateness), len(lay.cylinders)), np.nan)
    for c in range(len(lay.cylinders)):
        if np.abs(spools[:, c]).max() > _CLOSED:
            for k, late in enumerate(lateness):
                flows = _flows(
                    machine, grid, ch, c, lengths[:, c], np.interp(grid.time - late, grid.time, spools[:, c])
                )
                found[k, c] = np.mean([m.off for (kind, _), m in flows.items() if kind == "flow"]) if flows else np.nan
    return found


# -- windows ---------------------------------------------------------------------------------------------------------


def smooth(y: np.ndarray) -> np.ndarray:
    """Return a signal (N,) on the grid, averaged twice over half the width of the smoothing."""
    half = max(1, round(SMOOTH / STEP / 2))
    kernel = np.convolve(np.full(half, 1.0 / half), np.full(half, 1.0 / half))
    around = (len(kernel) // 2, len(kernel) - 1 - len(kernel) // 2)
    return np.convolve(np.pad(y, around, "edge"), kernel, "valid")


def change(y: np.ndarray, span: float = SPAN) -> np.ndarray:
    """Return by how much a signal (N,) changes over each window."""
    k = round(span / STEP)
    return np.asarray((y[k:] - y[:-k])[::_EVERY])


def mean(y: np.ndarray, span: float = SPAN) -> np.ndarray:
    """Return the mean of a signal (N,) over each window."""
    k = round(span / STEP)
    total = np.concatenate([[0.0], np.cumsum(y)])
    return np.asarray(((total[k + 1 :] - total[: -k - 1]) / (k + 1))[::_EVERY])


def _nowhere(there: np.ndarray, span: float = SPAN) -> np.ndarray:
    """Return whether something (N,) is nowhere the case in each window."""
    return mean(there.astype(float), span) == 0.0


def _bend(y: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    """Return by how much a window differs from the one before it, where both are chosen."""
    k = round(SPAN / STEP) // _EVERY
    return np.asarray((y[k:] - y[:-k])[chosen[k:] & chosen[:-k]])


def _proportional(left: np.ndarray, right: np.ndarray, noise: float, most: float = _GAIN) -> Misfit:
    """Return how far one side of a balance is from the other times a gain that a machine may have, up to `most`."""
    there = np.isfinite(left) & np.isfinite(right)
    if len(there) and there.mean() < _MOST:
        return Misfit(1.0)
    left, right = left[there], right[there]
    if len(left) < _FEWEST:
        return Misfit(0.0, False, False)
    across, own, other = float(left @ right), float(left @ left), float(right @ right)
    gain = float(np.clip(across / other, 1.0 / _GAIN, most)) if other > 0.0 else 1.0
    size, blur = own + gain**2 * other, len(left) * noise**2
    if size <= 0.0:
        return Misfit(0.0, False)
    off = max(own - 2.0 * gain * across + gain**2 * other - blur, 0.0) / size
    clear = size / (size + _CLEAR**2 * blur)
    return Misfit(off * clear, clear > 0.5)


def _apart(one: np.ndarray, other: np.ndarray, tolerance: float) -> Misfit:
    """Return how far two readings of the same thing are apart, as a share of how much they change."""
    scale = float(np.nanstd(one) + np.nanstd(other)) + tolerance
    return Misfit(min(float(np.sqrt(np.nanmean((one - other) ** 2))) / scale, 2.0))
