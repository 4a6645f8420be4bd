"""`patu montecarlo`: is the filter consistent, over many runs?"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .compiling import compile_for
from .options import (
    DEFAULT_CRANE,
    CraneOption,
    EffectsOption,
    EngineOption,
    JobsOption,
    JsonOption,
    MethodOption,
    SchedulerOption,
)
from .output import Printer, progress
from .outputs import Writes, saving
from .reading import load_crane

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from validation.montecarlo import Series

#: more would not fit into the memory of one process, nor end in a day
MOST_SAMPLES = 1e7


def command(
    runs: Annotated[int, typer.Option("--runs", "-n", metavar="N", help="Number of runs.")] = 20,
    jobs: JobsOption = 1,
    scheduler: SchedulerOption = None,
    file: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="FILE",
            help="File with one line for each finished run; an interrupted series continues from it.",
        ),
        Writes(continues=True),
    ] = None,
    model_error: Annotated[
        float,
        typer.Option("--error", metavar="SHARE", help="Relative error of the filter's model; 0 for a perfect model."),
    ] = 0.0,
    inputs: Annotated[
        int,
        typer.Option(
            "--inputs", metavar="1|2|3", help="Input set for the paper's machine; other machines get the paper's cycle."
        ),
    ] = 3,
    duration: Annotated[float, typer.Option("--duration", metavar="SECONDS", help="Length of a run.")] = 25.0,
    step: Annotated[float, typer.Option("--step", metavar="SECONDS", help="Time between two samples.")] = 1e-3,
    method: MethodOption = "ukf",
    seed: Annotated[int, typer.Option("--seed", help="Seed of the series.")] = 0,
    engine: EngineOption = "semi-recursive",
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    json: JsonOption = None,
) -> None:
    """Test over many runs whether the filter is consistent: NEES, NIS and coverage against their bounds.

    In every run the crane is disturbed by the noise that the filter assumes, and its start is drawn from the filter's
    initial distribution. With a perfect model the filter should be consistent; with --error it should not (exit
    status 1).
    """
    chosen = load_crane(crane, effects)
    _check(chosen, runs, inputs, duration, step, model_error, method)
    from validation.montecarlo import Settings, run_series

    settings = Settings(model_error, inputs, duration, step, engine, method, seed=seed)
    compile_for(engine, "semi-recursive", "filter")
    with progress(f"{runs} runs") as done:
        series = run_series(settings, runs, crane=chosen, jobs=jobs, scheduler=scheduler, file=file, progress=done)
    printer = Printer(json)
    tell(printer, series)
    with saving(printer) as save:
        save.json(json, series.document())
    raise typer.Exit(0 if series.consistent else 1)


def _check(crane: Crane, runs: int, inputs: int, duration: float, step: float, error: float, method: str) -> None:
    import numpy as np

    from crane_exudyn.errors import CraneError
    from ukf.methods import method_of
    from validation.paper import check_error, check_inputs, check_machine

    if runs < 1:
        raise CraneError(f"--runs {runs}: give at least 1.")
    check_inputs(inputs)
    if not (step > 0 and duration >= 10 * step):
        raise CraneError(f"--duration {duration:g} with --step {step:g}: a run needs at least ten samples.")
    if duration > MOST_SAMPLES * step:
        raise CraneError(
            f"--duration {duration:g} with --step {step:g}: a run may have at most {MOST_SAMPLES:g} samples."
        )
    check_error(error)
    if error:
        check_machine(crane)
    method_of(method, np.ones(1))


def tell(printer: Printer, series: Series) -> None:
    """Print NEES at its checkpoints, NIS, coverage and the answer."""
    d = series.document()
    low, high = d["nees_bounds"]
    expected = f"expected {d['nees_expected']}, bounds {low:.2f} to {high:.2f}"
    printer.line(f"NEES over {d['runs']} runs, at fractions of the run ({expected})")
    printer.table(
        "",
        ("at", *(f"{100 * float(share):g} %" for share in d["nees"])),
        [("NEES", *(round(v, 2) for v in d["nees"].values()))],
    )
    printer.table(
        "",
        ("", *d["coverage95"]),
        [
            ("inside 95 %, % of time", *(round(100 * v, 1) for v in d["coverage95"].values())),
            ("PN-RMSE %", *("–" if v is None else v for v in d["pn_rmse"].values())),
        ],
    )
    low, high = d["nis_bounds"]
    printer.line(f"NIS per measured value {d['nis_per_value']:.4f} (expected 1, bounds {low:.4f} to {high:.4f})")
    printer.line(
        "Consistent." if d["consistent"] else "Not consistent: the filter's covariance does not match its errors."
    )
