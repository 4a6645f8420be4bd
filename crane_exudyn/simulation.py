"""Open-loop runs: a crane, commands, and what the crane does."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from . import channels
from .channels import refuse_beyond
from .crane import Crane, given_crane
from .description import number
from .engines import engine_class, of_this_crane
from .errors import CraneError, nearest, shortened
from .recording import Recording, given_recording
from .strokes import run_while_possible, within_strokes

if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: length of the paper's working cycle, s
CYCLE = 25.0
#: most time steps of a run: their inputs alone are half a gigabyte
MOST_STEPS = 1e7

#: s between instants that are far apart, and between those of a result that is filled there
_SPARSE, _FILLED = 0.1, 0.01


@dataclass(frozen=True)
class Simulation:
    """An open-loop run; SI.

    Attributes:
        crane: what was simulated.
        time: (N,) s.
        state_names: names of the nx states.
        states: (N, nx), what is true; a pressure below vapour pressure stands for a void, see `laws.oil`.
        commands: (N, valves) spool commands.
        inputs: (N, valves + 2) spool positions and supply pressures pp, pt (NaN: the crane's own).
        readings: (N, m) what the sensors of `crane.layout.sensors` show of the states, without noise.
    """

    crane: Crane
    time: np.ndarray
    state_names: tuple[str, ...]
    states: np.ndarray
    commands: np.ndarray
    inputs: np.ndarray
    readings: np.ndarray

    def __getitem__(self, name: str) -> np.ndarray:
        """Return a channel (N,) by name: a command, what a sensor shows, a supply pressure, or a state that no sensor
        shows. Raises CraneError, which tells what there is, for another name.
        """
        if not isinstance(name, str) or name not in self._channels:
            raise CraneError(f"Simulation of {self.crane.name}: no channel {name!r}.{nearest(name, [*self._channels])}")
        return self._channels[name]

    def __contains__(self, name: object) -> bool:
        return name in self._channels

    def channels(self) -> dict[str, np.ndarray]:
        """Return every channel (N,) that a recording may hold, as the crane's sensors show it, without noise."""
        return dict(self._channels)

    @cached_property
    def _channels(self) -> dict[str, np.ndarray]:
        lay = self.crane.layout
        found = dict(zip(lay.commands, self.commands.T, strict=True))
        found |= dict(zip(self.state_names, self.states.T, strict=True))
        found |= dict(zip(lay.sensors, self.readings.T, strict=True))
        supply = dict(zip(lay.supply, self.inputs[:, lay.supplies].T, strict=True))
        return found | {name: values for name, values in supply.items() if not np.isnan(values).all()}

    def recording(self) -> Recording:
        """Return the run as a recording: every channel as the crane's sensors show it, without noise."""
        name = f"simulation of {self.crane.name}"
        return replace(Recording.from_arrays(name, self.time, self.channels(), layout=self.crane.layout), exact=True)

    def save(self, path: str | Path) -> None:
        """Write all channels in SI to .csv, .csv.gz, .parquet or .mat; `patu` reads them back as a recording."""
        from .formats import write_table

        units = channels.of(self.crane.layout)
        columns = {f"{n}[{units[n] or '-'}]": values for n, values in self.channels().items()}
        write_table(path, {"time[s]": self.time} | columns)

    def to_dataframe(self) -> Any:
        """Return all channels as a pandas DataFrame over time in s: rad, rad/s, Pa, m and pure numbers, the unit of
        each column in `attrs["units"]`. A file is written by `save`: pandas' `to_csv` leaves the units out, without
        which no file is read.
        """
        from .formats import data_frame

        return data_frame(self.time, self.channels(), channels.of(self.crane.layout))

    def plot(self) -> Figure:
        """Return a matplotlib figure of commands, coordinates and pressures."""
        from . import plots

        lay = self.crane.layout
        names = [n for n in (*lay.commands, *lay.coordinates, *lay.added[:1], *lay.chambers) if n in self.channels()]
        made = plots.figure(len(names), height=1.2)
        for axes, name in zip(made.axes, names, strict=True):
            plots.draw_lines(axes, self.time, {"": self[name]}, channel=name, layout=lay)
        plots.entitle(made, f"Simulation of {self.crane.name}")
        return made

    def __repr__(self) -> str:
        from .plots import shown

        parts = []
        for name in self.crane.layout.coordinates:
            what = shown(name, layout=self.crane.layout)
            z = self[name] * what.factor
            parts.append(f"{name} {z.min():.1f} … {z.max():.1f} {what.unit}")
        ranges = ", ".join(parts)
        return (
            f"<Simulation of {self.crane.name}: {self.time[-1] - self.time[0]:g} s at {len(self.time)} instants; "
            f"{ranges}>"
        )

    def _repr_html_(self) -> str:
        from .display import table_html
        from .plots import shown

        rows = []
        for name, values in self.channels().items():
            what = shown(name, layout=self.crane.layout)
            ends = (values[0], values[-1], values.min(), values.max())
            rows.append((name, what.unit or "–", *(float(v) * what.factor for v in ends)))
        title = f"{self.crane.name}, open loop: {self.time[-1] - self.time[0]:g} s at {len(self.time)} instants"
        return table_html(("channel", "unit", "first", "last", "min", "max"), rows, title=title)


def simulate(
    crane: Crane | str | Path = "patu655",
    inputs: Recording | str | Path | None = None,
    *,
    start: np.ndarray | None = None,
    engine: Any = None,
    step: float = 1e-3,
    filled: bool = False,
) -> Simulation:
    """Return an open-loop run of a crane.

    Args:
        crane: the crane, or the name of a built-in one, or a file.
        inputs: a recording, its file, or a run, whose commands (and supply pressures, if measured) drive the crane;
            the result has its instants. Without one, the crane goes through the paper's 25 s working cycle
            (`inputs.paper_cycle`), with a result every 1 ms; a lever that would drive its cylinder to the end of its
            stroke is let go in time.
        start: (nx,) state at the first instant; by default the crane file's initial rule. What the pump cannot lift
            there is told by the logger "crane_exudyn".
        engine: "exudyn", "semi-recursive", or an engine object with this crane; by default a new ExudynEngine.
        step: largest time step in s.
        filled: whether the result has an instant every 10 ms where those of `inputs` are more than 0.1 s apart, as the
            corners of commands are.

    Raises:
        CraneError: a recording without commands, an engine of another crane, a step that is not positive, a payload of
            negative mass, or a run that leaves what the crane can do.
    """
    return simulate_while_possible(crane, inputs, start=start, engine=engine, step=step, filled=filled, whole=True)[0]


def simulate_while_possible(
    crane: Crane | str | Path = "patu655",
    inputs: Recording | str | Path | None = None,
    *,
    start: np.ndarray | None = None,
    engine: Any = None,
    step: float = 1e-3,
    filled: bool = False,
    whole: bool = False,
) -> tuple[Simulation, CraneError | None]:
    """Return a run as `simulate` does, as far as it goes, and why it ended early: None where it did not.

    Args:
        crane, inputs, start, engine, step, filled: as in `simulate`.
        whole: whether a run that ends early is of no use; why it did is raised then.

    Raises:
        CraneError: what `simulate` raises before it runs, or where not even two instants can be had.
    """
    from .statics import check_payload  # compiled code, of which the effects must be part

    crane = given_crane(crane, "simulate")
    if engine is None:
        from .engine import ExudynEngine

        engine = ExudynEngine(crane)
    engine = engine_class(engine)(crane) if isinstance(engine, str) else of_this_crane(engine, crane)
    inputs = None if inputs is None else given_recording(inputs, crane.layout, "simulate")
    time = paper_time() if inputs is None else inputs.require(sensors=0).aligned()[0]
    grid, rows = inner_grid(time, step)
    if filled:
        rows = _filled(grid, rows)
    commands, w = _driven(crane, inputs, grid)
    check_payload(crane, grid)
    x0 = _start_of_file(crane, engine) if start is None else _given_start(crane, start)
    halved = getattr(engine, "halved", 0)
    states, ended = _run(engine, x0, grid, w, step, whole=whole or inputs is None)
    if ended is not None and inputs is None:
        from .drive import with_steps  # imports compiled code, of which the effects must be part
        from .inputs import paper_cycle

        fitted = within_strokes(crane, time, paper_cycle(time, len(crane.layout.cylinders)), x0)
        if fitted is not None:
            commands, w = _on_grid(crane, grid, *with_steps(time, fitted))
        if fitted is not None or not whole:
            engine.halved = halved  # those of the run that is given count, not those of the one that failed
            states, ended = _run(engine, x0, grid, w, step, whole=whole)
    rows = rows[rows < len(states)]
    if ended is not None and (whole or len(rows) < 2):
        raise ended
    grid = grid[: len(states)]
    readings = sensed(crane, states, grid)[rows]
    names = tuple(engine.state_names)
    return Simulation(crane, grid[rows], names, states[rows], commands[rows], w[rows], readings), ended


def _run(
    engine: Any, x0: np.ndarray, grid: np.ndarray, w: np.ndarray, step: float, *, whole: bool
) -> tuple[np.ndarray, CraneError | None]:
    """Return the states (k, nx) of a run, and why it ended early; where only a `whole` one is of use, no more than the
    start of one that did.
    """
    if not whole:
        return run_while_possible(engine, x0, grid, w, step)
    try:
        return engine.simulate(x0, grid, w, step=step), None
    except CraneError as problem:
        return x0[None], problem


def sensed(crane: Crane, states: np.ndarray, time: np.ndarray) -> np.ndarray:
    """Return what the sensors of a crane show (n, m) of states (n, nx) at `time` (n,) in s; those that lag begin
    settled.

    Raises:
        CraneError: the law of a sensor's effect gives no number.
    """
    from .measurement import Measurement

    measurement = Measurement.of(crane)
    readings = measurement.shown(states, time, settled=True)
    measurement.check(crane, readings, states)
    return readings


def paper_time() -> np.ndarray:
    """Return the instants of the paper's working cycle: 25 s at 1 kHz."""
    return np.linspace(0.0, CYCLE, round(CYCLE * 1000) + 1)


def initial_state(crane: Crane, engine: Any) -> np.ndarray:
    """Return the crane file's start (nx,): its pose, at rest, valves closed.

    Raises:
        CraneError: there is none: a loop does not close, a cylinder would be shorter or longer than it can be.
    """
    from .statics import check_start

    rule = crane.initial
    check_start(crane)
    return np.asarray(engine.static_start(*rule.pose, less_loaded=rule.less_loaded_pressure))


def _given_start(crane: Crane, start: Any) -> np.ndarray:
    """Return a start (nx,) that was given. Raises CraneError where it is none, or its coordinates are not in SI."""
    from .statics import checked_state

    try:
        numbers = np.asarray(start, dtype=float)
    except (TypeError, ValueError):
        raise CraneError(
            f"simulate: start is {shortened(start)}. Give a state in SI, such as engine.static_start(…)."
        ) from None
    state, lay = checked_state(crane, numbers), crane.layout
    for name, z in zip(lay.coordinates, state[lay.positions], strict=True):
        refuse_beyond("simulate: start", name, float(z), lay.unit_of(name))
    return state


def _start_of_file(crane: Crane, engine: Any) -> np.ndarray:
    """Return the crane file's start (nx,); what its pump cannot lift there is told by the logger of this package."""
    from .static_start import beyond_pump

    state = initial_state(crane, engine)
    if remark := beyond_pump(crane, state):
        logging.getLogger(__package__).warning("%s: %s", crane.name, remark)
    return state


def inner_grid(time: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Return a grid with even steps of at most `step` between the instants of `time`, and where those stand in it.

    Raises:
        CraneError: a step that is not positive, or more of them than a computer could hold.
    """
    step = number(step, "simulate: step", "s")
    if not step > 0.0:
        raise CraneError(f"A step of {step:g} s is not positive. Give the largest time step in seconds, such as 1e-3.")
    spans = np.diff(time)
    if spans.sum() > MOST_STEPS * step:
        raise CraneError(
            f"{spans.sum():g} s in steps of {step:g} s are {spans.sum() / step:.2g} steps, more than {MOST_STEPS:g}. "
            "Give a larger step, or a shorter recording."
        )
    parts = np.maximum(1, np.ceil(spans / step - 1e-6)).astype(int)
    rows = np.concatenate([[0], np.cumsum(parts)])
    share = np.arange(rows[-1]) - np.repeat(rows[:-1], parts)
    inner = np.repeat(time[:-1], parts) + share * np.repeat(spans / parts, parts)
    return np.append(inner, time[-1]), rows


def _filled(grid: np.ndarray, rows: np.ndarray) -> np.ndarray:
    """Return rows of a grid with more between those that are far apart."""
    between = [
        np.linspace(a, b, int(np.ceil((grid[b] - grid[a]) / _FILLED - 1e-6)) + 1).round().astype(int)
        for a, b in pairwise(rows)
        if grid[b] - grid[a] > _SPARSE
    ]
    return np.unique(np.concatenate([rows, *between]))


def _driven(crane: Crane, inputs: Recording | None, grid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return commands (n, valves) and w (n, valves + 2) on the grid: spool positions behind the lag (16), supply
    pressures.
    """
    from .drive import with_steps
    from .inputs import paper_cycle

    if inputs is None:  # its steps are steps here as they are to whoever reads the run back
        return _on_grid(crane, grid, *with_steps(grid, paper_cycle(grid, len(crane.layout.cylinders))))
    return _on_grid(crane, grid, *inputs.commands(crane), inputs.supply(grid))


def _on_grid(
    crane: Crane, grid: np.ndarray, time: np.ndarray, given: np.ndarray, supply: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Return commands (n, valves) and w (n, valves + 2) on the grid; the rest as `drive.inputs_on` takes it."""
    from .drive import inputs_on

    return np.column_stack([np.interp(grid, time, u) for u in given.T]), inputs_on(crane, grid, time, given, supply)
