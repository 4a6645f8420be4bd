"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import typer

from crane_exudyn.errors import CraneError

from .outputs import Reads, Writes

DEFAULT_CRANE = "patu655"


def table(path: Path) -> None:
    """Refuse a file with an ending that no table can be written with."""
    from crane_exudyn.formats import writer_of

    writer_of(path)


def picture(path: Path) -> None:
    """Refuse a file with an ending that no figure can be written with."""
    if path.suffix not in PICTURES:
        raise CraneError(f"{path}: unknown ending. Use one of {', '.join(PICTURES)}.")


def _positive_time(step: float) -> float:
    """Return a --step that can be."""
    if not step > 0.0:
        raise CraneError(f"--step {step:g} is not a positive time in seconds.")
    return step


PICTURES = (".png", ".svg", ".pdf")
RecordingArgument = Annotated[
    Path, typer.Argument(metavar="REC", help="Recording: CSV, MAT, Parquet or MDF4."), Reads()
]
RecordingsArgument = Annotated[
    list[Path],
    typer.Argument(
        metavar="REC…", help="Recordings of one machine: CSV, MAT, Parquet or MDF4; sensors and rates may differ."
    ),
    Reads(),
]
PerRecordingOption = Annotated[
    list[str] | None,
    typer.Option(
        "--per-recording",
        metavar="NAME",
        help="Parameter that differs from recording to recording, such as payload.mass; repeatable.",
    ),
]
CraneOption = Annotated[
    str,
    typer.Option("--crane", metavar="NAME-or-FILE", help="Built-in crane or TOML file.", show_default=True),
    Reads(),
]
EffectsOption = Annotated[
    list[Path] | None,
    typer.Option("--effects", metavar="FILE.py", help="Python file with your own effects; repeatable."),
    Reads(),
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="NAME=COLUMN[UNIT]",
        help="Column name and unit, such as z1=BoomAngle[deg], or sign, z1=-z1; repeatable.",
    ),
]
MapFileOption = Annotated[
    Path | None,
    typer.Option("--map-file", metavar="FILE.toml", help="Names, units, signs and offsets of the recording's columns."),
    Reads(),
]
AnywayOption = Annotated[
    bool, typer.Option("--anyway", help="Use a recording even if `patu check` finds errors in it.")
]
JsonOption = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="Write the result as JSON; - for standard output."),
    Writes(),
]
OutputOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE", help="Result file: .csv, .csv.gz, .parquet or .mat."),
    Writes(table),
]
ReportOption = Annotated[
    Path | None,
    typer.Option("--report", metavar="DIR", help="Write a self-contained HTML report to this folder."),
    Writes(files=("report.html",)),
]
JobsOption = Annotated[int, typer.Option("--jobs", "-j", metavar="N", help="Number of processes.", min=1)]
SchedulerOption = Annotated[
    str | None,
    typer.Option(
        "--scheduler", metavar="ADDRESS", help="Address of a Dask scheduler; local starts one on this machine."
    ),
]
EngineName = Literal["exudyn", "semi-recursive"]
EngineOption = Annotated[EngineName, typer.Option("--engine", help="Which engine runs the crane.")]
MethodOption = Annotated[str, typer.Option("--method", metavar="ukf|sr-ukf|ckf|simplex|ekf", help="Which filter.")]
PlotOption = Annotated[
    Path | None,
    typer.Option("--plot", metavar="FILE", help="Picture of the result: .png, .svg or .pdf."),
    Writes(picture),
]
StepOption = Annotated[
    float,
    typer.Option("--step", metavar="SECONDS", help="Longest time step of the model.", callback=_positive_time),
]
CheckOption = Annotated[
    Path | None,
    typer.Option("--check", metavar="REC2", help="A second recording, which is predicted and never fitted."),
    Reads(),
]


def looked_at(
    crane: str,
    effects: Sequence[Path] | None = None,
    mapping: Sequence[str] | None = None,
    map_file: Path | None = None,
    *,
    check: Path | None = None,
    per_recording: Sequence[str] | None = None,
    anyway: bool = False,
) -> dict[str, str | Path | Sequence[str | Path] | bool | None]:
    """Return by flag what a run was given to look at, for `validation.report.next_command`; the usual crane is left
    out.
    """
    return {
        "--check": check, "--per-recording": per_recording, "--map-file": map_file, "--map": mapping,
        "--crane": None if crane == DEFAULT_CRANE else crane, "--effects": effects, "--anyway": anyway,
    }  # fmt: skip
