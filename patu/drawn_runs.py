"""The runs of one picture: read, with the names that they are drawn under; which of them are simulations."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from crane_exudyn.errors import CraneError

from .reading import load_recording

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from crane_exudyn.crane import Crane
    from crane_exudyn.recording import Recording
    from crane_exudyn.trajectory import Trajectory

#: what a --ghost without a name is called, in order, where it is not seen to be a simulation
_GHOST_NAMES = ("simulated", "estimated", "third", "fourth")
#: how far readings that follow from each other are apart at most in a simulation, rad or m: what files are rounded to
_ROUNDED = 1e-6


def ghost_of(entry: str) -> tuple[str, str]:
    """Return name, if there is one, and file of "[NAME=]FILE"."""
    name, equals, path = entry.partition("=")
    return (name, path) if equals else ("", entry)


def drawn_runs(
    crane: Crane,
    recording: Path | None,
    label: str | None,
    ghosts: Sequence[str],
    read: Callable[[Sequence[Path]], list[Recording]],
) -> list[Trajectory]:
    """Return the trajectories of the run itself and of its ghosts."""
    from crane_exudyn.trajectory import Trajectory

    if recording is None:
        return [Trajectory.at_rest(crane)]
    if len(ghosts) >= len(_GHOST_NAMES):
        raise CraneError(f"{len(ghosts)} ghosts are too many to tell apart; give at most {len(_GHOST_NAMES) - 1}.")
    named = [ghost_of(entry) for entry in ghosts]
    main, *others = read([recording, *(Path(path) for _, path in named)])
    runs = [Trajectory.from_recording(main, label or ("simulated" if _is_simulated(main, crane) else "measured"))]
    for (name, _), ghost in zip(named, others, strict=True):
        taken = {run.label for run in runs}
        free = (n for n in _GHOST_NAMES if n not in taken)
        if not name and _is_simulated(ghost, crane):
            name = "simulated" if "simulated" not in taken else ghost.name
        runs.append(Trajectory.from_recording(ghost, name or next(free)))
    return runs


def read_runs(
    paths: Sequence[Path], crane: Crane, entries: Sequence[str] | None, map_file: Path | None
) -> list[Recording]:
    """Return the recordings at paths, of which the first is the run itself.

    What `--map` and `--map-file` say is of those files that lack a coordinate under its own name, as a logger's do, and
    those that this package writes do not; of the first one where none lacks any.
    """
    if not entries and map_file is None:
        return [load_recording(path, crane) for path in paths]
    plain = [_plain(path, crane) for path in paths]
    if None not in plain:
        plain[0] = None
    pairs = zip(plain, paths, strict=True)
    return [load_recording(path, crane, entries, map_file) if found is None else found for found, path in pairs]


def _plain(path: Path, crane: Crane) -> Recording | None:
    """Return the recording at `path` by the crane's own names, if it has a column of each coordinate."""
    from crane_exudyn.trajectory import coordinates_in

    try:
        found = load_recording(path, crane)
    except CraneError:  # told where it is read as mapped
        return None
    return found if all(coordinates_in(found)) else None


def _is_simulated(recording: Recording, crane: Crane) -> bool:
    """Whether a run is one that `patu simulate` writes: it holds every coordinate, rate, length and pressure, and what
    follows from the coordinates does so exactly, which no sensors do. Noise does not tell it, since oil rings.

    Any other run is simulated if none of its sensors has noise.
    """
    return _exact(recording, crane) or set(recording.sensors) == set(recording.noise_free())


def _exact(recording: Recording, crane: Crane) -> bool:
    """Whether a recording holds everything, and that without contradiction."""
    import numpy as np

    from crane_exudyn.geometry import cylinder_lengths

    layout = recording.layout
    if not recording.has(*layout.states, *layout.sensors):
        return False
    time = recording[layout.coordinates[0]].time
    shown = {name: recording[name].held(time) for name in (*layout.coordinates, *layout.sensors)}
    turned = [name for name in layout.coordinates if f"{name}_abs" in shown]
    apart = [shown[f"{name}_abs"] - sum(shown[n] for n in layout.absolute(name)) for name in turned]
    if not apart:  # its only coordinate is against the ground
        z, s = (np.column_stack([shown[n] for n in names]) for names in (layout.coordinates, layout.lengths))
        apart = [cylinder_lengths(crane, z) - s]
    return all(bool((np.abs(a) < _ROUNDED).all()) for a in apart)
