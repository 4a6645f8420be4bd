"""What commands read: the crane of `--crane`, and recordings after `patu check` has looked at them."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from crane_exudyn.errors import CraneError, doing

from .compiling import Part, compile_for

if TYPE_CHECKING:
    from crane_exudyn.crane import Crane
    from crane_exudyn.mapping import Column
    from crane_exudyn.recording import Recording


def load_crane(crane: str, effects: Sequence[Path] | None = None) -> Crane:
    """Return the crane of `--crane`, after the user's own effects of `--effects` have been registered.

    Raises:
        CraneError: no such crane, a bad crane file or effects file.
    """
    from crane_exudyn.effects import registry

    for file in effects or ():
        registry.load_effects(file)
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
    paths: Sequence[Path],
    crane: Crane,
    entries: Sequence[str] | None,
    map_file: Path | None,
    *,
    anyway: bool,
    needs: Sequence[Part],
) -> list[Recording]:
    """Return the recordings at `paths` after `patu check` has looked at them; what is hardly plausible about them is
    told on standard error.

    What the command needs is compiled once all files have been read, and before their contents are looked at, which
    is the first that calls it. Recordings whose files have the same name are told apart by their folders.

    Raises:
        CraneError: something in one is surely wrong, and it is not to be used anyway; every such finding with its mend.
    """
    found = [load_recording(path, crane, entries, map_file) for path in paths]
    compile_for("check", *needs)
    names = [r.name for r in found]
    accepted = [_accepted(path, r, crane, anyway=anyway) for path, r in zip(paths, found, strict=True)]
    return [replace(r, name=str(p)) if names.count(r.name) > 1 else r for r, p in zip(accepted, paths, strict=True)]


def _accepted(path: Path, recording: Recording, crane: Crane, *, anyway: bool) -> Recording:
    from crane_exudyn.vetting import vet  # imports compiled code, of which the effects must be part
    from crane_exudyn.vetting.findings import accepted

    findings = vet(recording, crane)
    for finding in (f for f in findings if f.severity == "warning" or anyway):
        print(f"{path}: {finding.severity}: {finding.sentences}", file=sys.stderr)
    try:
        return accepted(recording, findings, anyway=anyway)
    except CraneError as problem:
        raise CraneError(f"{problem} To use it anyway, give --anyway.") from None


def load_with_check(
    recordings: Sequence[Path],
    check: Path | None,
    crane: Crane,
    entries: Sequence[str] | None,
    map_file: Path | None,
    *,
    anyway: bool,
    needs: Sequence[Part],
) -> tuple[list[Recording], Recording | None]:
    """Return the recordings that are learned from, and the one that is only predicted, as `load_checked` does."""
    paths = [*recordings, *([] if check is None else [check])]
    found = load_checked(paths, crane, entries, map_file, anyway=anyway, needs=needs)
    return (found, None) if check is None else (found[:-1], found[-1])


def listed(paths: Sequence[Path] | None) -> str:
    """Return the names of files as one text."""
    return ", ".join(map(str, paths or ()))


def load_mapping(crane: Crane, entries: Sequence[str] | None, map_file: Path | None) -> dict[str, Column]:
    """Return {channel: column} of a crane's recording, of `--map-file`, and of `--map`, which goes before it."""
    from crane_exudyn.mapping import load_map, parse_map

    return (load_map(map_file, crane.layout) if map_file is not None else {}) | parse_map(entries)
