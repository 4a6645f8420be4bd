"""`patu simulate`: an open-loop run of the crane."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crane_exudyn.errors import CraneError

from .calls import refuse_idle
from .compiling import compile_for
from .options import (
    DEFAULT_CRANE,
    CraneOption,
    EffectsOption,
    EngineOption,
    JsonOption,
    MapFileOption,
    MapOption,
    OutputOption,
    StepOption,
)
from .output import Printer
from .outputs import Reads, saving
from .reading import load_crane, load_recording

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from crane_exudyn.recording import Recording
    from crane_exudyn.simulation import Simulation


def command(
    context: typer.Context,
    inputs: Annotated[
        Path | None, typer.Option("--inputs", metavar="REC", help="Recording whose commands drive the crane."), Reads()
    ] = None,
    output: OutputOption = None,
    engine: EngineOption = "exudyn",
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    start_from_recording: Annotated[
        bool, typer.Option("--start-from-recording", help="Start at the recording's first samples.")
    ] = False,
    step: StepOption = 1e-3,
    json: JsonOption = None,
) -> None:
    """Run the crane open loop.

    The commands come from a recording, or are the paper's 25 s working cycle. In the cycle a lever is released before
    its cylinder reaches the end of its stroke. The crane starts at rest with closed valves, at the angles of its file.
    The result has the instants of the recording (1 ms for the cycle; every 10 ms between corners of commands that are
    more than 0.1 s apart) and SI units. It is a recording without noise.

    If the run cannot continue, for example at the end of a stroke, it is written up to that time and the exit status
    is 2.
    """
    idle = ("--start-from-recording", "--map", "--map-file")
    refuse_idle(context, (inputs is None, idle, "no recording is given with --inputs REC"))
    chosen = load_crane(crane, effects)
    recording = None if inputs is None else load_recording(inputs, chosen, mapping, map_file).require(sensors=0)
    from crane_exudyn.engines import engine_class
    from crane_exudyn.simulation import simulate_while_possible

    compile_for("check", engine, "semi-recursive")
    holder = engine_class(engine)(chosen)
    start = None
    if recording is not None and start_from_recording:
        from validation.measured_start import measured_start

        start = measured_start(chosen, holder, recording)
    _compile(chosen, holder)
    holder.halved = 0
    begin = perf_counter()
    run, ended = simulate_while_possible(chosen, recording, start=start, engine=holder, step=step, filled=True)
    seconds = perf_counter() - begin
    printer = Printer(json)
    tell(printer, run, recording, engine, seconds)
    found = summary(run, engine, seconds) | {"halved": holder.halved, "ended": None if ended is None else str(ended)}
    if ended is None:
        found |= tell_accuracy(printer, run, recording, step, holder.halved)
    with saving(printer) as save:
        save(output, run.save)
        save.json(json, found)
    if ended is not None:
        raise CraneError(f"{ended} {_so_far(run, output)}")


def _so_far(run: Simulation, output: Path | None) -> str:
    """Return what there is of a run that ended early."""
    went = f"The run went to t = {run.time[-1]:g} s"
    return f"{went}; {output} contains it." if output is not None else f"{went}; -o FILE writes it."


def _compile(crane: Crane, engine: Any) -> None:
    """Take one step, so that the time that is told is that of the run, not of compiling."""
    import numpy as np

    from crane_exudyn.simulation import initial_state, sensed

    closed, time = np.tile(crane.layout.closed, (2, 1)), np.array([0.0, 1e-3])
    sensed(crane, engine.simulate(initial_state(crane, engine), time, closed), time)


def summary(run: Simulation, engine: str, seconds: float) -> dict[str, Any]:
    """Return what the JSON result tells: final state, range of each channel, speed."""
    channels = run.channels()
    return {
        "crane": run.crane.name,
        "engine": engine,
        "duration": run.time[-1] - run.time[0],
        "instants": len(run.time),
        "channels": {n: {"first": v[0], "last": v[-1], "min": v.min(), "max": v.max()} for n, v in channels.items()},
        "seconds": seconds,
        "realtime_factor": (run.time[-1] - run.time[0]) / seconds,
    }


def tell(printer: Printer, run: Simulation, recording: Recording | None, engine: str, seconds: float) -> None:
    """Print the range of each shown channel."""
    from crane_exudyn.plots import shown

    driven = _cycle_text(run) if recording is None else recording.name
    printer.line(
        f"{run.crane.name} on {engine}, driven by {driven}: {run.time[-1] - run.time[0]:g} s in {seconds:.2f} s"
    )
    for note in recording.notes if recording is not None else ():
        printer.line(f"note: {note}")
    channels, lay = run.channels(), run.crane.layout
    rows = []
    for name in (*lay.coordinates, *lay.chambers):
        what = shown(name, layout=lay)
        unit = {"°": "deg"}.get(what.unit, what.unit)
        rows.append((f"{name} / {unit}", *(float(f(channels[name]) * what.factor) for f in _RANGE)))
    printer.table("", ("channel", "first", "last", "min", "max"), rows)


def tell_accuracy(
    printer: Printer, run: Simulation, recording: Recording | None, step: float, halved: int
) -> dict[str, Any]:
    """Print how many steps were halved and how far the run depends on its steps; return the latter as JSON tells it."""
    from validation.step_error import step_error

    if halved:
        printer.line(f"{halved} steps were halved because their local error was too large.")
    try:
        found = step_error(run, recording, step, filled=True)
    except CraneError as problem:
        printer.line(
            "The dependence of these numbers on the step size is not known, because a run with finer steps fails: "
            f"{problem}"
        )
        return {"step_error": None}
    size = f"{found.pressure / 1e5:.2g} bar and {found.position:.1g} rad (RMS)"
    if found.since is None:
        printer.line(f"A run with steps ten times as accurate differs by {size}.")
    else:
        printer.line(
            f"CAUTION: from t = {found.since:.3f} s on, these numbers depend on the step size. A run with steps ten "
            f"times as accurate differs by {size}. The machine amplifies small differences there, as a boom does that "
            "bounces between voids or on an undamped end stop."
        )
    return {"step_error": {"position": found.position, "pressure": found.pressure, "since": found.since}}


def _cycle_text(run: Simulation) -> str:
    """Return in words what the working cycle was: the paper's, or with levers that were let go earlier."""
    from crane_exudyn.inputs import paper_cycle
    from crane_exudyn.strokes import levers_let_go

    early = levers_let_go(run.crane, paper_cycle(run.time, len(run.crane.layout.cylinders)), run.commands)
    if not early:
        return "the paper's working cycle"
    return f"the paper's working cycle, {' and '.join(early)} released before the end of travel"


_RANGE = (lambda v: v[0], lambda v: v[-1], lambda v: v.min(), lambda v: v.max())
