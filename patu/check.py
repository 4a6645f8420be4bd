"""`patu check`: is a recording what it says it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from crane_exudyn.errors import CraneError

from .options import DEFAULT_CRANE, CraneOption, EffectsOption, JsonOption, MapFileOption, MapOption
from .output import Printer
from .outputs import Reads, Writes, saving
from .reading import load_crane, load_recording

if TYPE_CHECKING:
    from crane_exudyn.mapping import Column
    from crane_exudyn.recording import Recording
    from crane_exudyn.vetting.findings import Finding


def command(
    recordings: Annotated[list[Path], typer.Argument(metavar="REC…", help="Recordings to check."), Reads()],
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    write_map: Annotated[
        Path | None,
        typer.Option("--write-map", metavar="FILE.toml", help="Write a map file that corrects what can be corrected."),
        Writes(),
    ] = None,
    json: JsonOption = None,
) -> None:
    """Check recordings for wrong signs, exchanged channels, wrong units, angle references, clocks, poses and noise.

    A channel is reported if the crane's balances close far better when it is read in another way. Leaks, friction or
    another payload do not cause this. The command also reports what `patu compare` would refuse and what was left out
    while reading. The exit status is 1 if a finding is an error.
    """
    chosen = load_crane(crane, effects)
    from crane_exudyn.files import write_text
    from crane_exudyn.mapping import map_text
    from crane_exudyn.vetting.corrections import mended_columns
    from validation.fitness import examine

    printer, found, notes = Printer(json), list[dict[str, Any]](), list[dict[str, str]]()
    columns: list[tuple[Recording, dict[str, Column]]] = []
    read = [load_recording(path, chosen, mapping, map_file) for path in recordings]
    printer.line(f"Checked against the crane {chosen.name}:")
    for path, recording in zip(recordings, read, strict=True):
        findings = examine(recording, chosen)
        tell(printer, path, findings, recording)
        notes += [{"recording": str(path), "text": note} for note in recording.notes]
        found += [document(path, f) for f in findings]
        columns.append((recording, mended_columns(recording, findings)))
    with saving(printer) as save:
        save.json(json, {"findings": found, "notes": notes, "crane": chosen.name})
        if write_map is not None:
            text = map_text(_together(columns), chosen.layout)
            save(write_map, lambda path: write_text(path, text), text)
    if any(finding["severity"] == "error" for finding in found):
        raise typer.Exit(1)


def _together(columns: Sequence[tuple[Recording, Mapping[str, Column]]]) -> dict[str, Column]:
    """Return the one map for several recordings; a channel that they have under different headers, and that needs no
    mend, is left out.

    Raises:
        CraneError: a mend in one recording would spoil another one.
    """
    found: dict[str, Column] = {}
    for name in dict.fromkeys(n for _, wanted in columns for n in wanted):
        having = [(r, replace(w[name], said=""), r.columns.get(name)) for r, w in columns if name in w]
        (first, column, _), *others = having
        other = next((r for r, c, _ in others if c != column), None)
        if other is None:
            found[name] = column
        elif any(read is None or replace(read, said="") != c for _, c, read in having):
            raise CraneError(
                f"--write-map: {first.source or first.name} and {other.source or other.name} need different maps for "
                f"{name}. Check them one at a time."
            )
    return found


def document(path: Path, finding: Finding) -> dict[str, Any]:
    """Return a finding as the JSON result tells it."""
    return {
        "kind": finding.kind, "channels": list(finding.channels), "severity": finding.severity, "text": finding.text,
        "mend": finding.mend, "recording": str(path),
    }  # fmt: skip


def tell(printer: Printer, path: Path, findings: list[Finding], recording: Recording) -> None:
    """Print the findings of a recording, worst first, and what was left out of its file."""
    for finding in findings:
        printer.line(f"{path}: {finding.severity}: {finding.text}.")
        printer.line(f"  {finding.mend}")
    for note in (n for n in recording.notes if not any(n in f.mend for f in findings)):
        printer.line(f"{path}: note: {note}{'' if note.endswith('?') else '.'}")
    if not findings:
        printer.line(
            f"{path}: nothing wrong was found in the channels that were read: {', '.join(recording.channels)}."
        )
