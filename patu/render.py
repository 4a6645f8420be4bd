"""`patu render`: pictures and films of a run, through Exudyn's renderers."""

from __future__ import annotations

import shlex
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from crane_exudyn.errors import CraneError

from .calls import refuse_idle
from .drawn_runs import drawn_runs, ghost_of, read_runs
from .options import DEFAULT_CRANE, CraneOption, EffectsOption, JsonOption, MapFileOption, MapOption
from .output import Printer, progress
from .outputs import Reads, Writes, saving
from .reading import load_crane

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from crane_exudyn.crane import Crane
    from crane_exudyn.render import Scene

_FILM = ("--from", "--to", "--fps", "--speed")
_LOOK = ("--colour", "--mark", "--view", "--size", "--title")


def picture_or_film(path: Path) -> str:
    """Return what a file is to become; refuse an ending that neither a picture nor a film can be written with."""
    from crane_exudyn.film import kind_of

    return kind_of(path)


RunArgument = Annotated[
    Path | None,
    typer.Argument(
        metavar="REC", help="Recording or result with the coordinates; if left out, the crane at its start."
    ),
    Reads(),
]
DrawnOption = Annotated[
    Path | None,
    typer.Option("-o", "--output", metavar="FILE", help=".png, .jpg, .gif or .mp4"),
    Writes(picture_or_film),
]
FramesOption = Annotated[
    bool, typer.Option("--frames", help="Draw a sketch of the crane file instead: every body's frame with its points.")
]
GhostOption = Annotated[
    list[str] | None,
    typer.Option("--ghost", metavar="[NAME=]FILE", help="Another run in the same scene; repeatable."),
    Reads(lambda entry: ghost_of(entry)[1]),
]
LabelOption = Annotated[
    str | None, typer.Option(help="Name of the run; measured by default, or simulated if it has no noise.")
]
TimeOption = Annotated[
    float | None, typer.Option(help="Time of the picture in s; if left out, the last that REC and --ghost cover.")
]
FromOption = Annotated[float | None, typer.Option("--from", help="Start of the film in s.")]
ToOption = Annotated[float | None, typer.Option("--to", help="End of the film in s.")]
FpsOption = Annotated[float | None, typer.Option(help="Pictures per second of film; 12 if left out.")]
SpeedOption = Annotated[float | None, typer.Option(help="Seconds of the run per second of film; 1 if left out.")]
ColourOption = Annotated[
    Literal["pressure", "residual"] | None, typer.Option(help="Colour by pressure, or by the difference from --ghost.")
]
MarkOption = Annotated[
    list[str] | None,
    typer.Option(metavar="PLACE", help="Arrow at a cylinder, chamber, joint, point or body by its name; repeatable."),
]
ViewOption = Annotated[Literal["side", "oblique"] | None, typer.Option(help="Direction of view.")]
SizeOption = Annotated[str | None, typer.Option(metavar="WxH", help="Size in pixels; 1280x720 if left out.")]
TitleOption = Annotated[str | None, typer.Option(help="Title of the picture; the recording's name if left out.")]
RendererOption = Annotated[
    Literal["raytracer", "opengl"] | None,
    typer.Option(help="Exudyn's ray tracer (default) or its OpenGL window (on Xvfb if there is no screen)."),
]
SolutionOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write an Exudyn solution file for its SolutionViewer."),
    Writes(),
]
OpenOption = Annotated[bool, typer.Option("--open", help="Open Exudyn's SolutionViewer (needs a screen).")]


def command(
    context: typer.Context,
    recording: RunArgument = None,
    output: DrawnOption = None,
    frames: FramesOption = False,
    ghost: GhostOption = None,
    crane: CraneOption = DEFAULT_CRANE,
    effects: EffectsOption = None,
    mapping: MapOption = None,
    map_file: MapFileOption = None,
    label: LabelOption = None,
    time: TimeOption = None,
    start: FromOption = None,
    end: ToOption = None,
    fps: FpsOption = None,
    speed: SpeedOption = None,
    colour: ColourOption = None,
    mark: MarkOption = None,
    view: ViewOption = None,
    size: SizeOption = None,
    title: TitleOption = None,
    renderer: RendererOption = None,
    save_solution: SolutionOption = None,
    open_viewer: OpenOption = False,
    json: JsonOption = None,
) -> None:
    """Draw the crane of a run: one picture, a film, or Exudyn's live viewer.

    Runs given with --ghost appear in the same scene, so that differences between model and measurement can be seen.
    --map and --map-file apply to the files without the crane's own channel names, or to REC if all files have them.
    """
    if output is None and save_solution is None and not open_viewer:
        raise CraneError("Nothing to do: give -o FILE.png (or .gif, .mp4), --save-solution FILE or --open.")
    kind = None if output is None else picture_or_film(output)
    refuse_idle(context, *_rules(kind, frames=frames, alone=recording is None, open_viewer=open_viewer))
    described = load_crane(crane, effects)
    if frames:
        _sketch(described, output, json)
        return
    from crane_exudyn.render import Scene  # imports compiled code, of which the effects must be part
    from crane_exudyn.screen import need_screen

    if open_viewer:
        need_screen("--open")
    read = partial(read_runs, crane=described, entries=mapping, map_file=map_file)
    runs = drawn_runs(described, recording, label, ghost or (), read)
    name = title if title is not None else recording.name if recording else described.name
    scene = Scene(
        described, runs, colour=colour, marks=mark or (), size=_size(size or "1280x720"), view=view, title=name
    )
    film = partial(scene.save, time=time, start=start, end=end, fps=fps, speed=speed, renderer=renderer or "raytracer")
    printer = Printer(json)
    _save(printer, scene, [run.label for run in runs], film, output, save_solution, json)
    if open_viewer:
        _view(scene)
        return
    again = {
        "--crane": None if crane == DEFAULT_CRANE else [crane], "--ghost": ghost, "--mark": mark, "--map": mapping,
        "--map-file": [map_file] if map_file else None, "--effects": effects, "--colour": colour and [colour],
    }  # fmt: skip
    printer.line(f"To turn it and zoom: {_opening(recording, again)} (needs a screen).")


def _rules(
    kind: str | None, *, frames: bool, alone: bool, open_viewer: bool
) -> tuple[tuple[bool, Sequence[str], str], ...]:
    """Return which options are idle when, and why.

    Args:
        kind: what -o asks for, "picture", "gif" or "mp4"; None for nothing.
        frames, open_viewer: whether --frames and --open are given; alone: whether there is no recording.
    """
    every = (*_LOOK, *_FILM, "--time", "--renderer", "--label", "--ghost", "--map", "--map-file", "REC", "--open")
    return (
        (frames, (*every, "--save-solution"), "--frames draws the crane file alone"),
        (alone, ("--ghost", "--label", "--map", "--map-file", "--time"), "no recording REC is given"),
        (kind is None, ("--time", *_FILM, "--renderer"), "no picture or film is asked for with -o FILE"),
        (kind is None and not open_viewer, _LOOK, "no picture or film is asked for with -o FILE"),
        (kind == "picture", _FILM, "a picture shows one time, --time"),
        (kind != "picture", ("--time",), "a film shows the time --from … --to"),
    )


def _save(
    printer: Printer,
    scene: Scene,
    labels: Sequence[str],
    film: Callable[..., None],
    output: Path | None,
    solution: Path | None,
    json: str | None,
) -> None:
    """Write the picture or film, the solution file and the JSON, as far as they are asked for."""
    with saving(printer) as save:
        save(output, partial(_draw, film))
        save(solution, scene.save_solution)
        written = [str(p) for p in (output, solution) if p is not None]
        save.json(json, {"written": written, "runs": labels, "from": scene.start, "to": scene.end})


def _opening(recording: Path | None, options: Mapping[str, Sequence[object] | None]) -> str:
    """Return the command line that opens the same scene in Exudyn's viewer."""
    words = [word for option, values in options.items() for value in values or () for word in (option, str(value))]
    return shlex.join(["patu", "render", *([] if recording is None else [str(recording)]), *words, "--open"])


def _draw(film: Callable[..., None], path: Path) -> None:
    with progress(f"drawing {path.name}") as done:
        film(path, progress=done)


def _sketch(crane: Crane, output: Path | None, json: str | None) -> None:
    """Write the sketch of the frames as a picture."""
    if output is None or picture_or_film(output) != "picture":
        raise CraneError("--frames draws one picture: give -o FILE.png.")
    from crane_exudyn.plots import save as save_figure
    from crane_exudyn.render_frames import sketch

    printer = Printer(json)
    with saving(printer) as save:
        save(output, partial(save_figure, sketch(crane)))
        save.json(json, {"written": [str(output)], "bodies": list(crane.machine.bodies)})


def _size(text: str) -> tuple[int, int]:
    """Return (width, height) in pixels of "1280x720"."""
    width, _, height = text.lower().partition("x")
    if not (width.isdigit() and height.isdigit() and 160 <= int(width) <= 4096 and 120 <= int(height) <= 4096):
        raise CraneError(f"--size {text!r} is not WIDTHxHEIGHT between 160x120 and 4096x4096, such as 1280x720.")
    return int(width), int(height)


def _view(scene: Scene) -> None:
    """Open Exudyn's viewer with the run."""
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "run.txt"
        scene.save_solution(path)
        scene.view_solution(path)
