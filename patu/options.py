"""Options that several commands share, and what they turn into."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from crane_exudyn.errors import CraneError, doing

from .outputs import Reads, Writes

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from crane_exudyn.mapping import Column
    from crane_exudyn.recording import Recording

DEFAULT_CRANE = "patu655"


def table(path: Path) -> None:
    """Refuse a file with an ending that no table can be written with."""
    from crane_exudyn.formats import writer_of

    writer_of(path)


def picture(path: Path) -> None:
    """Refuse a file with an ending that no figure can be written with."""
    if path.suffix not in PICTURES:
        raise CraneError(f"{path}: unknown ending. Use one of {', '.join(PICTURES)}.")


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
    typer.Option("--effects", metavar="FILE.py", help="Python file with effects of your own; may be repeated."),
    Reads(),
]
MapOption = Annotated[
    list[str] | None,
    typer.Option(
        "--map",
        metavar="NAME=COLUMN[UNIT]",
        help="Other column name, such as z1=BoomAngle[deg], or sign, z1=-z1; repeatable.",
    ),
]
MapFileOption = Annotated[
    Path | None,
    typer.Option("--map-file", metavar="FILE.toml", help="Names, units, signs and offsets of the recording's columns."),
    Reads(),
]
AnywayOption = Annotated[
    bool, typer.Option("--anyway", help="Use a recording in which `patu check` finds errors all the same.")
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
    typer.Option("--report", metavar="DIR", help="Write one self-contained HTML report there."),
    Writes(files=("report.html",)),
]
JobsOption = Annotated[int, typer.Option("--jobs", "-j", metavar="N", help="Processes to use.", min=1)]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Dask scheduler of a cluster; local for one made here."),
]
EngineName = Literal["exudyn", "semi-recursive"]
EngineOption = Annotated[EngineName, typer.Option("--engine", help="Which implementation of the crane runs.")]
CheckOption = Annotated[
    Path | None,
    typer.Option("--check", metavar="REC2", help="A recording that is only predicted, never fitted."),
    Reads(),
]


def load_crane(crane: str, effects: Sequence[Path] | None = None) -> Crane:
    """Return the crane of `--crane`, after the user's own effects of `--effects` have been registered.

    Raises:
        CraneError: no such crane, a bad crane file or effects file.
    """
    from crane_exudyn.effects import registry

    for file in effects or ():
        registry.load_file(file)
    from crane_exudyn.crane import Crane

    with doing(f"reading {crane}"):
        return Crane.load(crane)


def load_recording(
    path: Path, crane: Crane, entries: Sequence[str] | None = None, map_file: Path | None = None
) -> Recording:
    """Return the recording of a crane at `path`, its columns mapped as `--map-file` says, and `--map`, which goes
    before it.
    """
    from crane_exudyn.recording import Recording

    with doing(f"reading {path}"):
        return Recording.load(path, load_mapping(crane, entries, map_file), layout=crane.layout)


def load_checked(
    path: Path, crane: Crane, entries: Sequence[str] | None, map_file: Path | None, *, anyway: bool
) -> Recording:
    """Return the recording at `path` after `patu check` has looked at it; what is hardly plausible about it is told on
    standard error.

    Raises:
        CraneError: something in it is surely wrong, and it is not to be used anyway; every such finding with its mend.
    """
    from crane_exudyn.vetting import accepted, vet  # imports compiled code, of which the effects must be part

    recording = load_recording(path, crane, entries, map_file)
    findings = vet(recording, crane)
    for finding in (f for f in findings if f.severity == "warning" or anyway):
        print(f"{path}: {finding.severity}: {finding.text}. {finding.mend}", file=sys.stderr)
    try:
        return accepted(recording, findings, anyway=anyway)
    except CraneError as problem:
        raise CraneError(f"{problem} To use it all the same, give --anyway.") from None


def load_several(
    paths: Sequence[Path], crane: Crane, entries: Sequence[str] | None, map_file: Path | None, *, anyway: bool
) -> list[Recording]:
    """Return the recordings as `load_checked` does; those whose files have the same name are told apart by their
    folders.
    """
    found = [load_checked(p, crane, entries, map_file, anyway=anyway) for p in paths]
    names = [r.name for r in found]
    return [replace(r, name=str(path)) if names.count(r.name) > 1 else r for r, path in zip(found, paths, strict=True)]


def load_all(
    recordings: Sequence[Path],
    check: Path | None,
    crane: Crane,
    entries: Sequence[str] | None,
    map_file: Path | None,
    *,
    anyway: bool,
) -> tuple[list[Recording], Recording | None]:
    """Return the recordings that are learned from, and the one that is only predicted, as `load_checked` does."""
    measured = load_several(recordings, crane, entries, map_file, anyway=anyway)
    return measured, None if check is None else load_checked(check, crane, entries, map_file, anyway=anyway)


def listed(paths: Sequence[Path] | None) -> str:
    """Return the names of files as one text."""
    return ", ".join(map(str, paths or ()))


def load_mapping(crane: Crane, entries: Sequence[str] | None, map_file: Path | None) -> dict[str, Column]:
    """Return {channel: column} of a crane's recording, of `--map-file`, and of `--map`, which goes before it."""
    from crane_exudyn.mapping import load_map, parse_map

    return (load_map(map_file, crane.layout) if map_file is not None else {}) | parse_map(entries)


def make_engine(name: EngineName, crane: Crane) -> Any:
    """Return the engine that `--engine` names, holding `crane`."""
    if name == "exudyn":
        from crane_exudyn.engine import ExudynEngine

        return ExudynEngine(crane)
    from validation.semi_recursive import SemiRecursiveEngine

    return SemiRecursiveEngine(crane)
