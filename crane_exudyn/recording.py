"""Recording: measured channels in SI, each with its own clock."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import channels as channel_names
from . import signals
from .assembly import assemble, example, wanted
from .channels import Channel
from .description import number
from .errors import CraneError, by_name, named_file, names_of, nearest, refuse_unknown, shortened
from .frozen import frozen
from .layout import Layout
from .machine_toml import usual_layout
from .mapping import Column, columns_of
from .tables import RawColumn, RawTable

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from .crane import Crane
    from .drive import Step

#: samples of other channels in a pause of a command by which it is known that the recording went on
_RECORDED = 2
#: share of samples that are no larger than what is usual: a few may be spikes
_USUAL = 0.9


@dataclass(frozen=True, eq=False)
class Recording:
    """Measured (or simulated) channels of one run, immutable, in SI, each with its own clock.

    Attributes:
        name: of the file, without folder and ending.
        channels: name -> Channel; names as in `channels.of(layout)`.
        source: the file, for messages.
        notes: what was left out or changed while reading, in words.
        layout: of the machine that was recorded.
        columns: what each channel was read from, where that is known.
        ignored: columns of the file that are no channel of the layout.
        vouched: whether its contents have been looked at, or are to be used anyway (`vetting`).
        exact: whether it is a simulation's, whose sensors are known to be free of noise.
        held: whether commands keep their value until the next sample; else they are linear between samples, but for
            steps.
        early: by how many seconds steps of commands came before the samples that show them, where that is known.
        memory: by channel the time in s after which samples share 1/e of their noise, where that is known.
    """

    name: str
    channels: Mapping[str, Channel]
    source: str = ""
    notes: tuple[str, ...] = ()
    layout: Layout = field(default_factory=usual_layout, repr=False)
    columns: Mapping[str, Column] = field(default_factory=dict)
    ignored: tuple[str, ...] = field(default=(), repr=False)
    vouched: bool = False
    exact: bool = False
    held: bool = False
    early: Mapping[Step, float] = field(default_factory=dict, repr=False)
    memory: Mapping[str, float] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "channels", frozen(self.channels))
        object.__setattr__(self, "early", frozen(self.early))
        object.__setattr__(self, "memory", frozen(self.memory))

    # -- making one ----------------------------------------------------------------------------------------------

    @classmethod
    def load(
        cls,
        path: str | Path,
        mapping: Mapping[str, str | Column] | None = None,
        *,
        layout: Layout | Crane | None = None,
    ) -> Recording:
        """Return the recording in a file: CSV (also .csv.gz), MATLAB v5 and v7.3, Parquet, MDF4.

        Args:
            path: the file; its content, not its ending, tells the format.
            mapping: channel -> column of the file, such as {"z1": "BoomAngle[deg]"}; the unit may be left out where the
                file gives one. A minus before the column turns the sign; a `mapping.Column` says more.
            layout: of the machine that was recorded, `crane.layout`, or its crane; by default that of patu655.

        Raises:
            CraneError: names file, line or sample, column, what was found, what was expected and how to mend it.
        """
        from .formats import read

        path, layout = named_file(path, "Recording.load"), layout_of(layout)
        given = by_name(mapping or {}, "Recording.load: mapping", "{'z1': 'BoomAngle[deg]'}")
        columns = columns_of(given, layout)
        table = read(path, wanted=wanted(columns, layout))
        return cls(**assemble(path, table, columns, layout)).with_gaps_told()

    @classmethod
    def from_arrays(
        cls, name: str, time: np.ndarray, values: Mapping[str, np.ndarray], *, layout: Layout | Crane | None = None
    ) -> Recording:
        """Return a recording of channels in SI that share one clock; NaN is a missing sample.

        Args:
            name: of the recording.
            time: (n,) s, increasing; dates, as of a pandas index, count from the first.
            values: channel -> (n,) in SI; or a pandas DataFrame of them.
            layout: as in `load`.

        Raises:
            CraneError: an unknown channel, what is no recording over time, or degrees and millimetres instead of SI.
        """
        layout = layout_of(layout)
        units = channel_names.of(layout)
        values = by_name(values, f"{name}: values", "{'z1': an array}")
        for channel in values:
            if channel not in units:
                raise CraneError(f"{name}: there is no channel {channel!r}.{nearest(channel, list(units))}")
        columns = [RawColumn("time", _row(_seconds(time), f"{name}: time"), "s")]
        columns += [RawColumn(n, _row(v, f"{name}: {n}"), units[n]) for n, v in values.items()]
        made = cls(**assemble(Path(name), RawTable(columns), {}, layout) | {"name": name, "source": name})
        for channel in (n for n in made.channels if n in layout.sensors):
            most = float(np.quantile(np.abs(made[channel].values), _USUAL))
            channel_names.refuse_beyond(name, channel, most, units[channel], channel)
        return made.with_gaps_told()

    # -- asking --------------------------------------------------------------------------------------------------

    def has(self, *names: str) -> bool:
        """Return whether all these channels are there."""
        return all(name in self.channels for name in names)

    def __getitem__(self, name: str) -> Channel:
        """Return a channel by name; the error tells which there are."""
        if not isinstance(name, str) or name not in self.channels:
            known = ", ".join(self.channels)
            raise CraneError(f"{self.source or self.name}: there is no channel {name!r}, only {known}.{self._unused()}")
        return self.channels[name]

    def __contains__(self, name: object) -> bool:
        return name in self.channels

    def __iter__(self) -> Iterator[str]:
        """Iterate over the names of the channels."""
        return iter(self.channels)

    @property
    def sensors(self) -> tuple[str, ...]:
        """Names of the measured sensor channels, in the order of the layout."""
        return tuple(name for name in self.layout.sensors if name in self.channels)

    @property
    def start(self) -> float:
        """Time of the first sample of any channel, s."""
        return float(min(c.time[0] for c in self.channels.values()))

    @property
    def end(self) -> float:
        """Time of the last sample of any channel, s."""
        return float(max(c.time[-1] for c in self.channels.values()))

    @property
    def duration(self) -> float:
        """Time between first and last sample, s."""
        return self.end - self.start

    @property
    def sampling_rate(self) -> float:
        """Samples per second of the fastest sensor (of the fastest channel where there is no sensor)."""
        return max(signals.sampling_rate(self[name].time) for name in self.sensors or tuple(self.channels))

    def require(self, commands: bool = True, sensors: int = 1) -> Recording:
        """Return this recording, if it has commands and at least so many sensor channels.

        Raises:
            CraneError: names the file, what is there and what is missing.
        """
        where = self.source or self.name
        spools, volts = self.layout.commands, self.layout.voltages
        if commands and not (self.has(*spools) or self.has(*volts)):
            missing = [c for c in (volts if any(map(self.has, volts)) else spools) if not self.has(c)]
            raise CraneError(
                f"{where}: {' and '.join(missing)} missing, found only {', '.join(self.channels)}. Expected spool "
                "commands "
                f"{' and '.join(spools)} in [-1, 1], or valve voltages "
                f"{' and '.join(f'{u}[V]' for u in volts)}; a valve that stays closed is a column of "
                f"zeros.{self._unused()}"
            )
        if len(self.sensors) < sensors:
            raise CraneError(
                f"{where}: found {len(self.sensors)} sensor channels ({', '.join(self.sensors) or 'none'}), expected "
                "at least "
                f"{sensors} of {', '.join(self.layout.sensors)}. Record one, or map a column: --map "
                f"{example(self.layout)}.{self._unused()}"
            )
        return self

    def _unused(self) -> str:
        more = f"; and {len(self.notes) - 3} more" if len(self.notes) > 3 else ""
        return f" ({'; '.join(self.notes[:3])}{more}.)" if self.notes else ""

    # -- taking data out -----------------------------------------------------------------------------------------

    def commands(self, crane: Crane | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return time (n,) in s and spool commands (n, valves) in [-1, 1], linear between samples; steps stay steps.

        Where commands are `held` every change is a step.

        Valve voltages become commands through the calibration of `crane`. Where all commands have one clock it is
        returned as it is; otherwise the union of theirs. Where a command steps, one more instant just before the sample
        that shows the new value holds the old one (see `drive.with_steps`). In a gap the last value is held; see
        `unknown_commands`.
        """
        from .drive import with_steps

        return with_steps(*self._sampled_commands(crane), self.held, self.early)

    def steps(self, crane: Crane | None = None) -> dict[Step, float]:
        """Return the steps of commands whose moments the recording does not tell closer than between two samples, and
        how far these are apart, s; none where commands are `held`.
        """
        from .drive import steps_in

        return {} if self.held else steps_in(*self._sampled_commands(crane))

    def _sampled_commands(self, crane: Crane | None) -> tuple[np.ndarray, np.ndarray]:
        """Return time (n,) and spool commands (n, valves) as they were sampled."""
        self.require(sensors=0)
        if crane is not None and crane.layout.sensors != self.layout.sensors:
            raise CraneError(
                f"{self.source or self.name}: was read as a recording of another machine than {crane.name}. "
                "Read it with the crane's names: Recording.load(path, layout=crane.layout)."
            )
        names = self._command_names
        known = [self[name].held_until(self._gaps(name)[:, 1]) for name in names]
        time = _union([channel.time for channel in known])
        values = np.column_stack([channel.held(time) for channel in known])
        if names == self.layout.commands:
            return time, np.clip(values, -1.0, 1.0)
        if crane is None:
            raise CraneError(
                f"{self.source or self.name}: contains valve voltages; give the crane whose calibration converts them."
            )
        return time, crane.commands_from_voltages(values)

    def unknown_commands(self) -> dict[str, np.ndarray]:
        """Return {command: spans (g, 2) in s} in which a command was not recorded while the recording went on; empty if
        all are known.
        """
        found = {}
        for name in filter(self.has, self._command_names):
            channel = self[name]
            spans = [(self.start, channel.time[0]), *self._gaps(name), (channel.time[-1], self.end)]
            unknown = [(a, b) for a, b in spans if b - a > channel.longest_pause]
            if unknown:
                found[name] = np.array(unknown)
        return found

    def _gaps(self, name: str) -> np.ndarray:
        """Return the gaps (g, 2) of a command in s: pauses in which something was recorded; a few points written by
        hand have none.
        """
        gaps = self[name].gaps()
        return gaps if self.sensors else gaps[self._recorded_beside(name, gaps) > _RECORDED]

    def _recorded_beside(self, name: str, spans: np.ndarray) -> np.ndarray:
        """Return how many samples (g,) other channels have inside spans (g, 2) in s."""
        others = np.sort(np.concatenate([[], *(c.time for n, c in self.channels.items() if n != name)]))
        return np.searchsorted(others, spans[:, 1]) - np.searchsorted(others, spans[:, 0], side="right")

    def unread(self) -> dict[str, np.ndarray]:
        """Return {channel: spans (g, 2) in s} in which a sensor or a supply pressure has no sample for far longer than
        usual, while other channels have some; empty if there are none.
        """
        found = {}
        for name in filter(self.has, (*self.layout.sensors, *self.layout.supply)):
            channel = self[name]
            ends = [(self.start, channel.time[0]), (channel.time[-1], self.end)]
            spans = np.vstack([ends[:1], channel.gaps(), ends[1:]])
            spans = spans[np.diff(spans)[:, 0] > channel.longest_pause]
            spans = spans[self._recorded_beside(name, spans) > _RECORDED]
            if len(spans):
                found[name] = spans
        return found

    def with_gaps_told(self) -> Recording:
        """Return the recording with a note on each command that is not known all the time, and on sensors with gaps."""
        remarks = [
            f"command {name} is missing in {_spans_text(spans)}: the last value before is held there, and fits leave "
            "these times out"
            for name, spans in self.unknown_commands().items()
        ]
        alike: dict[str, list[str]] = {}
        for name, spans in self.unread().items():
            alike.setdefault(_spans_text(spans), []).append(name)
        remarks += [
            f"{', '.join(names)} {'have' if len(names) > 1 else 'has'} no sample in {where}, while others have"
            for where, names in alike.items()
        ]
        return replace(self, notes=(*self.notes, *remarks))

    @property
    def _command_names(self) -> tuple[str, ...]:
        return self.layout.commands if self.has(*self.layout.commands) else self.layout.voltages

    def supply(self, time: np.ndarray) -> np.ndarray:
        """Return pump and tank pressure (n, 2) in Pa at `time`; NaN where they were not measured."""
        unknown = np.full(len(time), np.nan)
        return np.column_stack([self[n].held(time) if self.has(n) else unknown for n in self.layout.supply])

    def aligned(self, names: Iterable[str] | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return all samples on the union of the clocks: time (n,), values (n, k), NaN where a channel has no sample.

        Nothing is interpolated. Stamps that differ by less than a millionth of the shortest step count as one.
        """
        chosen = self._chosen(names)
        time = _union([self[name].time for name in chosen])
        values = np.full((len(time), len(chosen)), np.nan)
        for k, name in enumerate(chosen):
            values[_rows_of(time, self[name].time), k] = self[name].values
        return time, values

    def window(self, start: float, end: float) -> Recording:
        """Return the samples with start <= time <= end; channels without any there are left out."""
        start, end = number(start, "window: start", "s"), number(end, "window: end", "s")
        kept = {}
        for name, channel in self.channels.items():
            chosen = (channel.time >= start) & (channel.time <= end)
            if chosen.any():
                kept[name] = Channel(channel.time[chosen], channel.values[chosen], channel.unit)
        if not kept:
            raise CraneError(
                f"{self.source or self.name}: no sample between {start:g} s and {end:g} s; "
                f"the recording goes from {self.start:g} s to {self.end:g} s."
            )
        return replace(self, channels=kept)

    def select(self, names: Iterable[str]) -> Recording:
        """Return a recording with only these channels."""
        return replace(self, channels={name: self[name] for name in self._chosen(names)})

    def _chosen(self, names: Iterable[str] | None) -> tuple[str, ...]:
        """Return names of channels, all of them for None. Raises CraneError where none is named."""
        chosen = tuple(self.channels) if names is None else names_of(names, "channels")
        if not chosen:
            raise CraneError(f"{self.source or self.name}: no channel is named. Give some of {', '.join(self)}.")
        return chosen

    def noise(self) -> dict[str, float]:
        """Return the standard deviation of each sensor's noise in SI, estimated from the data (`signals.noise_std`)."""
        return {name: signals.noise_std(self[name].values) for name in self.sensors}

    def noise_free(self) -> tuple[str, ...]:
        """Return the sensors that move and show less noise than any sensor has, as those of simulations do.

        Where one does, others are of the same simulation, though motion that is sampled slowly looks like noise.
        """
        any_free = any(signals.is_noise_free(self[name].values) for name in self.sensors)
        return tuple(n for n in self.sensors if any_free and signals.is_noise_free(self[n].values, beside=True))

    def with_noise(self, stated: Mapping[str, float] | None = None) -> Recording:
        """Return the recording with white noise added to its sensors that have none, always the same.

        These are the ones that show none (`noise_free`), and of a simulation all that are stated. Motion that is
        sampled slowly looks like noise: of a file, a sensor may pass for noisy that is not. A stated one that gets
        nothing is told in the notes.

        Args:
            stated: standard deviations in SI by channel; a usual sensor's where there is none.

        Raises:
            CraneError: an unknown sensor, or a standard deviation that is none.
        """
        given, sensors = by_name(stated or {}, "with_noise", "{'z1': 1e-3}, in SI"), self.layout.sensors
        refuse_unknown("with_noise", given, sensors, "sensor")
        stated = {n: _deviation(std, f"with_noise: {n}", sensors[n].unit) for n, std in given.items()}
        free = {*self.noise_free(), *(stated if self.exact else ())}
        changed = dict(self.channels)
        for k, name in enumerate(sensors):
            if name in free and name in changed:
                changed[name] = replace(self[name], values=signals.with_noise(self[name].values, stated.get(name), k))
        kept = [n for n in self.sensors if n in stated and n not in free]
        remarks = [f"{', '.join(kept)}: no noise was added, because the samples contain noise already"] if kept else []
        return replace(self, channels=changed, notes=(*self.notes, *remarks), exact=False)

    def first_values(self, span: float = 0.1) -> dict[str, float]:
        """Return the mean of each sensor, in SI, over the first `span` seconds in which any is read, but not beyond the
        first change of a command. A sensor that is first read later (`signals.early`) says nothing of the start and is
        left out.
        """
        span = number(span, "first_values: span", "s")
        moves = [_first_change(self[n]) for n in (*self.layout.commands, *self.layout.voltages) if self.has(n)]
        start = min((float(self[n].time[0]) for n in self.sensors), default=0.0)
        until = min([start + span, *moves])
        means = {}
        for name in self.sensors:
            channel = self[name]
            shown = channel.values[signals.early(channel.time, start, span)]
            if shown.size:
                means[name] = float(np.mean(shown[: max(1, np.searchsorted(channel.time, until, side="right"))]))
        return means

    # -- giving away ---------------------------------------------------------------------------------------------

    def save(self, path: str | Path) -> None:
        """Write all samples in SI units to .csv, .csv.gz, .parquet or .mat, whole or not at all; `load` reads them
        back.
        """
        from .formats import write_table

        (time, values), units = self.aligned(), channel_names.of(self.layout)
        columns = {"time[s]": time}
        for k, name in enumerate(self.channels):
            columns[f"{name}[{units[name] or '-'}]"] = values[:, k]
        write_table(path, columns)

    def to_dataframe(self) -> Any:
        """Return all channels as a pandas DataFrame over time in s, NaN where a channel has no sample: rad, rad/s, Pa,
        m, V and pure numbers, the unit of each column in `attrs["units"]`.

        `from_arrays(name, frame.index, frame)` makes a recording of it again. A file is written by `save`: pandas'
        `to_csv` leaves the units out, without which no file is read.
        """
        from .formats import data_frame

        time, values = self.aligned()
        return data_frame(time, dict(zip(self.channels, values.T, strict=True)), channel_names.of(self.layout))

    def plot(self, names: Iterable[str] | None = None) -> Figure:
        """Return a matplotlib figure with one panel a channel, each on its own clock, in degrees and bar."""
        from . import plots

        chosen = self._chosen(names)
        made = plots.figure(len(chosen), height=1.2)
        for axes, name in zip(made.axes, chosen, strict=True):
            channel = self[name]
            plots.draw_lines(axes, channel.time, {"": channel.values}, channel=name, layout=self.layout)
        plots.entitle(made, self.name)
        return made

    def __repr__(self) -> str:
        return f"<Recording {self.name}: {', '.join(self.channels)}; {self.duration:g} s at {self.sampling_rate:g} Hz>"

    def _repr_html_(self) -> str:
        from .display import table_html
        from .plots import shown

        rows = []
        for name, c in self.channels.items():
            what = shown(name, layout=self.layout)
            ends = (float(v) * what.factor for v in (np.nanmin(c.values), np.nanmax(c.values)))
            rows.append((name, what.unit or "–", len(c), *ends))
        title = f"{self.name}: {self.duration:g} s at {self.sampling_rate:g} Hz"
        return table_html(("channel", "unit", "samples", "min", "max"), rows, title=title, note="; ".join(self.notes))


# -- what is given ---------------------------------------------------------------------------------------------------


def given_recording(given: Any, layout: Layout, whom: str) -> Recording:
    """Return a recording that was given as such, by its file, or as a simulation, to `whom`. Raises CraneError for
    anything else.
    """
    if isinstance(given, str | Path):
        return Recording.load(given, layout=layout)
    of_itself = getattr(given, "recording", None)  # a simulation's
    if callable(of_itself):
        given = of_itself()
    if isinstance(given, Recording):
        return given
    raise CraneError(
        f"{whom}: found {shortened(given)} instead of a recording. Give a Recording, or the name of its file."
    )


def layout_of(given: Layout | Crane | None) -> Layout:
    """Return the layout that was given as such, or by its crane; that of patu655 for None. Raises CraneError for
    anything else.
    """
    found = usual_layout() if given is None else getattr(given, "layout", given)
    if isinstance(found, Layout):
        return found
    raise CraneError(f"layout: found {shortened(given)}. Give the layout of the machine, crane.layout.")


def _seconds(stamps: Any) -> Any:
    """Return times as seconds where they are dates, which count from the first, or durations; else as they are."""
    found = np.asarray(stamps)
    if found.dtype == object and found.size and all(isinstance(stamp, datetime) for stamp in found.flat):
        found = np.array([stamp - found.flat[0] for stamp in found.flat], dtype="timedelta64[ns]")
    if found.dtype.kind == "M":
        found = found - found[:1]
    return found / np.timedelta64(1, "s") if found.dtype.kind == "m" else stamps


def _row(given: Any, what: str) -> np.ndarray:
    """Return numbers (n,) that were given as `what`. Raises CraneError for anything else."""
    try:
        found = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        raise CraneError(f"{what} is {shortened(given)}. Give an array (n,) of numbers in SI, NaN for none.") from None
    if found.ndim != 1:
        raise CraneError(f"{what} has the shape {found.shape}, expected (n,). Give one number a sample, in SI.")
    return found


def _deviation(given: Any, what: str, unit: str) -> float:
    """Return a standard deviation that was given as `what`. Raises CraneError for one that is none."""
    found = number(given, what, unit)
    if not 0.0 <= found < np.inf:
        raise CraneError(f"{what} = {found:g} is not a standard deviation. Give a finite one of at least 0 in {unit}.")
    return found


def _spans_text(spans: np.ndarray) -> str:
    """Return how many spans (g, 2) in s there are, and where the first ones, in words."""
    where = ", ".join(f"{a:.6g} … {b:.6g} s" for a, b in spans[:3]) + (", …" if len(spans) > 3 else "")
    return f"{len(spans)} span{'s' * (len(spans) > 1)} ({where})"


# -- clocks ----------------------------------------------------------------------------------------------------------


def _union(clocks: list[np.ndarray]) -> np.ndarray:
    """Return all stamps of some clocks, sorted; stamps closer than a millionth of the shortest step are one."""
    if all(np.array_equal(clocks[0], clock) for clock in clocks[1:]):
        return clocks[0]
    steps = [float(np.min(np.diff(clock))) for clock in clocks if len(clock) > 1]
    stamps = np.unique(np.concatenate(clocks))
    return stamps[np.diff(stamps, prepend=-np.inf) > 1e-6 * min(steps, default=0.0)]


def _rows_of(union: np.ndarray, clock: np.ndarray) -> np.ndarray:
    """Return the rows of `union` at which the stamps of `clock` stand (the nearest stamp)."""
    right = np.clip(np.searchsorted(union, clock), 1, max(1, len(union) - 1))
    if len(union) == 1:
        return np.zeros(len(clock), dtype=int)
    return np.where(clock - union[right - 1] < union[right] - clock, right - 1, right)


def _first_change(channel: Channel) -> float:
    """Return the last time at which a command still has its first value; infinite if it always has."""
    changed = np.flatnonzero(channel.values != channel.values[0])
    return float(channel.time[max(0, changed[0] - 1)]) if len(changed) else np.inf
