"""Pictures and films of the crane, made by Exudyn's own renderers.

A `Scene` is an Exudyn system whose bodies have the crane's shapes and follow given trajectories: nothing is integrated, the
closed geometry places every part. Several cranes may stand in one scene - measured, simulated, estimated. ::

    scene = Scene(crane, [Trajectory.from_recording(recording)])
    scene.save("lift.png", time=5.0)

Two renderers of Exudyn can draw it. Its ray tracer needs no screen and gives the smoother pictures. Its OpenGL window
renderer needs a screen, or the program Xvfb, which makes one in memory and is started and ended here.
"""

from __future__ import annotations

import contextlib
import math
import os
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np

from . import render_shapes as shapes
from .crane import Crane
from .errors import CraneError
from .files import replacing
from .geometry import pose
from .mechanism import exu, items
from .parameters import LAYOUT, POINT_NAMES

if TYPE_CHECKING:
    from .recording import Recording

Colour = Literal["pressure", "residual"]
Renderer = Literal["raytracer", "opengl"]
View = Literal["side", "oblique"]

#: what a crane of each kind looks like beside others; light, middle and dark, so that they differ without colour
GHOSTS = {"measured": (0.90, 0.90, 0.88), "simulated": (0.95, 0.55, 0.20), "estimated": (0.05, 0.38, 0.68)}
_PLAIN_GHOST = (0.80, 0.82, 0.85)  # beside a crane whose colours mean something
_OTHER_GHOSTS = ((0.0, 0.50, 0.36), (0.55, 0.35, 0.65))
#: m by which each ghost stands behind the one before; from the side that is not seen, but what is nearer is never hidden
_BEHIND = {"side": 2.5, "oblique": 0.02}
_SUPERSAMPLING = 2
_VIEWS = {"side": (0.0, 0.0), "oblique": (math.radians(-24.0), math.radians(14.0))}
_SECONDS_TO_START = 20.0


@dataclass(frozen=True)
class Trajectory:
    """One crane's motion: angles in rad and pressures in Pa over time.

    Attributes:
        label: "measured", "simulated", "estimated" or another word; it is written into the picture.
        time: (n,) s, increasing.
        z1, z4: (n,) rad.
        pressures: channel -> (n,) Pa, for those of p1 … p4 that are known.
        theta: (n,) rad, angle of the payload's pendulum against straight down; None where it is not known.
    """

    label: str
    time: np.ndarray
    z1: np.ndarray
    z4: np.ndarray
    pressures: dict[str, np.ndarray] = field(default_factory=dict)
    theta: np.ndarray | None = None

    @classmethod
    def from_states(cls, label: str, time: np.ndarray, states: np.ndarray) -> Trajectory:
        """Return the trajectory of states (n, nx) as engines give them, at `time` (n,)."""
        pressures = dict(zip(LAYOUT.chambers, states[:, LAYOUT.pressures].T, strict=True))
        theta = next(iter(states[:, LAYOUT.extra].T), None)
        z1, z4 = states[:, LAYOUT.positions].T
        return cls(label, np.asarray(time, dtype=float), z1, z4, pressures, theta)

    @classmethod
    def from_recording(cls, recording: Recording, label: str = "measured") -> Trajectory:
        """Return the motion that a recording (or the written result of a run) holds, on the clock of z1.

        Raises:
            CraneError: it holds no z1, or neither z4 nor z4_abs.
        """
        other = "z4" if recording.has("z4") else "z4_abs"
        if not recording.has("z1", other):
            raise CraneError(
                f"{recording.source or recording.name}: a picture needs the angles z1 and z4 (or z4_abs); found only "
                f"{', '.join(recording.channels)}. Estimate them first: patu estimate REC -o states.csv."
            )
        time, z1 = recording["z1"].time, recording["z1"].values
        z4 = recording[other].held(time) - (z1 if other == "z4_abs" else 0.0)
        known = [p for p in LAYOUT.chambers if recording.has(p)]
        theta = recording["theta"].held(time) if recording.has("theta") else None
        return cls(label, time, z1, z4, {p: recording[p].held(time) for p in known}, theta)

    @classmethod
    def at_rest(cls, crane: Crane) -> Trajectory:
        """Return the crane standing still at the start that its file gives, for one second."""
        z1, z4 = (np.full(2, angle) for angle in crane.initial.pose)
        return cls("start", np.array([0.0, 1.0]), z1, z4)

    def at(self, time: float) -> tuple[float, float]:
        """Return (z1, z4) in rad at a time, linear between samples, held outside."""
        return float(np.interp(time, self.time, self.z1)), float(np.interp(time, self.time, self.z4))

    def swing_at(self, time: float) -> float:
        """Return the pendulum's angle in rad at a time; 0, hanging at rest, where it is not known."""
        return 0.0 if self.theta is None else float(np.interp(time, self.time, self.theta))

    def pose_at(self, time: float) -> tuple[float, float, float]:
        """Return (z1, z4, theta) in rad at a time: what `coordinates` needs."""
        return *self.at(time), self.swing_at(time)

    def pressure_at(self, name: str, time: float) -> float:
        """Return a pressure in Pa at a time; NaN where it is not known."""
        values = self.pressures.get(name)
        return math.nan if values is None else float(np.interp(time, self.time, values))


def coordinates(
    crane: Crane, z1: np.ndarray | float, z4: np.ndarray | float, theta: np.ndarray | float = 0.0
) -> np.ndarray:
    """Return x, y, angle of every part of `render_shapes.PARTS` at n poses, shape (n, 3 * parts), in m and rad.

    theta is the angle of the payload's pendulum, where the crane has one (hook `pendulum`).
    """
    closed = pose(crane, z1, z4)
    at = {name: closed.points[:, i] for i, name in enumerate(POINT_NAMES)}
    z1, z4 = np.broadcast_to(z1, closed.z2.shape), np.broadcast_to(z4, closed.z2.shape)
    lift, tilt = _direction(at["F"], at["G"]), _direction(at["H"], at["C"])
    theta, length = np.broadcast_to(theta, closed.z2.shape), shapes.pendulum_length(crane)
    log = at["E"] + length * np.column_stack([np.sin(theta), -np.cos(theta)])
    placed = {
        "lift_boom": (at["O"], z1),
        "bracket_1": (at["B"], z1 + closed.z2),
        "bracket_2": (at["C"], z1 + closed.z2 + closed.z3),
        "outer_boom": (at["A"], z1 + z4),
        "lift_barrel": (at["F"], lift),
        "lift_rod": (at["G"], lift),
        "tilt_barrel": (at["H"], tilt),
        "tilt_rod": (at["C"], tilt),
        "rope": (at["E"], theta),
        "log": (log, theta if length > 0.0 else z1 + z4),
    }
    return np.column_stack([np.column_stack(placed[part]) for part in shapes.PARTS])


def _direction(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    return np.asarray(np.arctan2(end[:, 1] - start[:, 1], end[:, 0] - start[:, 0]))


class Scene:
    """Cranes that follow trajectories, in one Exudyn system.

    Attributes:
        crane: the description that gives shapes and geometry.
        trajectories: what the cranes do; the first is the main one, the others are its ghosts.
        system: the Exudyn system container; mbs: its main system. Add own objects through `own` before anything is drawn.
    """

    def __init__(
        self,
        crane: Crane,
        trajectories: Sequence[Trajectory],
        *,
        colour: Colour | None = None,
        marks: Sequence[str] = (),
        title: str = "",
        size: tuple[int, int] = (1280, 720),
        view: View | None = None,
        own: Callable[[Any], None] | None = None,
    ) -> None:
        """Build the scene.

        Args:
            crane: gives shapes and geometry.
            trajectories: at least one.
            colour: "pressure" shows the oil in both cylinders by its pressure; "residual" colours booms and oil by the
                difference between the first and the second trajectory.
            marks: cylinders, chambers or joints to point at with an arrow, such as "lift", "p4", "A".
            title: written at the top.
            size: width and height in pixels.
            view: "side" or "oblique"; by default oblique, but from the side where cranes are compared.
            own: called with the Exudyn main system before it is assembled, to add objects of your own.

        Raises:
            CraneError: no trajectory, nothing to compare, a pressure or a place that is not there.
        """
        _check(colour, trajectories, marks)
        self.crane, self.trajectories, self.title, self.size = crane, tuple(trajectories), title, size
        self.colour, self.marks = colour, tuple(marks)
        self.view: View = view or ("side" if len(trajectories) > 1 else "oblique")
        self.scales = _scales(self.trajectories, colour)
        self.center, self.height = self._frame()
        self.system = exu.SystemContainer()
        self.mbs = self.system.AddSystem()
        self._problem: Exception | None = None
        self._fill(own)
        self._set_up_look()

    @property
    def start(self) -> float:
        """Earliest time of the main trajectory, s."""
        return float(self.trajectories[0].time[0])

    @property
    def end(self) -> float:
        """Latest time of the main trajectory, s."""
        return float(self.trajectories[0].time[-1])

    # -- building ------------------------------------------------------------------------------------------------------

    def _fill(self, own: Callable[[Any], None] | None) -> None:
        """Add ground, pillar and cranes; moving parts are rigid bodies, what changes its colour is drawn by a function."""
        paints = self._paints()
        fixed = [*shapes.ground(), *shapes.pillar(self.crane, paints[0])]
        self.mbs.AddObject(items.ObjectGround(visualization=items.VObjectGround(graphicsData=fixed)))
        for i, paint in enumerate(paints):
            self._add_crane(paint, hidden=self._recoloured() if i == 0 else (), depth=-_BEHIND[self.view] * i)
        drawn = items.VObjectGround(graphicsDataUserFunction=cast(Any, self._draw_changing))
        self.mbs.AddObject(items.ObjectGround(visualization=drawn))
        if own is not None:
            own(self.mbs)
        self.mbs.Assemble()

    def _paints(self) -> list[shapes.Paint]:
        if len(self.trajectories) == 1 or self.colour is not None:
            main = shapes.Paint(barrels=self.colour is None)
        else:
            main = shapes.Paint.single(self.ghost_color(0))
        return [main, *(shapes.Paint.single(self.ghost_color(i)) for i in range(1, len(self.trajectories)))]

    def ghost_color(self, position: int) -> tuple[float, float, float]:
        """Return the colour of the n-th crane where cranes are told apart by colour."""
        if self.colour is not None:
            return _PLAIN_GHOST
        return GHOSTS.get(self.trajectories[position].label, _OTHER_GHOSTS[position % len(_OTHER_GHOSTS)])

    def _recoloured(self) -> tuple[str, ...]:
        return ("lift_boom", "outer_boom") if self.colour == "residual" else ()

    def _add_crane(self, paint: shapes.Paint, hidden: Sequence[str], depth: float) -> None:
        graphics = {
            part: [_moved(g, (0.0, 0.0, depth)) for g in made] for part, made in shapes.parts(self.crane, paint).items()
        }
        for part in shapes.PARTS:
            node = self.mbs.AddNode(items.NodeRigidBody2D(referenceCoordinates=[0.0, 0.0, 0.0]))
            look = items.VObjectRigidBody2D(graphicsData=[] if part in hidden else graphics[part])
            self.mbs.AddObject(items.ObjectRigidBody2D(mass=1.0, inertia=1.0, nodeNumber=node, visualization=look))

    def _set_up_look(self) -> None:
        """Set light, background and camera; no text of the renderer's own."""
        settings: Any = self.system.visualizationSettings  # its stub wants tuples where Exudyn takes lists
        general, window, light = settings.general, settings.view0.window, settings.openGL.light0
        general.showSolutionInformation = general.showSolverInformation = general.showSolverTime = False
        general.showHelpOnStartup, general.autoFitScene, general.rendererStartupTimeout = 0, False, 10000
        general.useGradientBackground = True
        general.backgroundColor, general.backgroundColorBottom = [0.97, 0.98, 1.0, 1.0], [0.80, 0.86, 0.92, 1.0]
        window.showComputationInfo, window.renderWindowSize = False, list(self.size)
        settings.view0.scene.drawCoordinateSystem = 0
        settings.openGL.multiSampling, settings.openGL.lineWidth = 4, 1.2
        general.useMultiThreadedRendering = False  # with it, pictures are taken before they are whole
        settings.exportImages.saveImageTimeOut = 20000
        settings.openGL.lightModelAmbient = [0.62, 0.62, 0.64, 1.0]
        light.position, light.diffuse, light.specular, light.shadow = [-2.0, 9.0, 7.0, 0.0], 0.62, 0.25, 0.3
        if (
            self.view == "side"
        ):  # the ground is a line, and shadows would only fall on ghosts; none at all spoils the depth
            light.shadow = 0.001
        settings.openGL.light1.enable = False
        settings.raytracer.numberOfThreads, settings.raytracer.multiSampling = os.cpu_count() or 1, _SUPERSAMPLING
        settings.raytracer.lightRadiusVariations = 1

    def _aim(self) -> None:
        """Put the camera; orthographic, so that lengths in the picture can be compared."""
        rotation = self._rotation()
        self.system.renderer.SetState(
            {
                "centerPoint": (rotation @ self.center).tolist(),  # Exudyn turns about the origin, then moves
                "rotationCenterPoint": [0.0, 0.0, 0.0],
                "maxSceneSize": 10.0,
                "zoom": self.height / 2.0,
                "modelRotation": rotation.T,
            }
        )

    def _rotation(self) -> np.ndarray:
        """Return the rotation (3, 3) from world axes to those of the picture: right, up, towards the viewer."""
        yaw, pitch = _VIEWS[self.view]
        c, s = math.cos(yaw), math.sin(yaw)
        turn = np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])
        c, s = math.cos(pitch), math.sin(pitch)
        return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]]) @ turn

    def _frame(self) -> tuple[tuple[float, float, float], float]:
        """Return the middle of the picture and its height in m, so that every crane stays in it all the time."""
        reached = [np.array([[-0.55, 0.0], [0.6, 0.0]])]
        for t in self.trajectories:
            step = max(1, len(t.time) // 200)
            theta = 0.0 if t.theta is None else t.theta[::step]
            reached.append(pose(self.crane, t.z1[::step], t.z4[::step]).points.reshape(-1, 2))
            placed = coordinates(self.crane, t.z1[::step], t.z4[::step], theta)
            reached.append(placed.reshape(len(placed), -1, 3)[:, shapes.PARTS.index("log"), :2])
        low, high = np.min(np.vstack(reached), axis=0) - 0.45, np.max(np.vstack(reached), axis=0) + 0.45
        wide, tall = high - low
        above, below = 0.14, 0.06 if self.colour is None else 0.20  # shares of the height for heading and colour scales
        height = max(tall / (1.0 - above - below), 1.06 * wide * self.size[1] / self.size[0])
        x, y = (low + high) / 2.0
        return (float(x), float(y + 0.5 * (above - below) * height), 0.0), float(height)

    # -- what changes with time ----------------------------------------------------------------------------------------

    def show(self, time: float) -> None:
        """Move every crane to where it is at `time` in s."""
        rows = [
            coordinates(self.crane, *trajectory.pose_at(time))[0] for trajectory in self.trajectories
        ]  # interpolating angles keeps the loop closed, interpolating coordinates would not
        for configuration in (exu.ConfigurationType.Current, exu.ConfigurationType.Visualization):
            self.mbs.systemData.SetODE2Coordinates(np.concatenate(rows).tolist(), configuration)
            self.mbs.systemData.SetTime(time, configuration)

    def _draw_changing(self, mbs: Any, _item: int) -> list[shapes.Graphics]:
        """Return what `_changing` draws; the renderer, which calls this, would swallow an error, so it is kept."""
        try:
            return self._changing(mbs)
        except Exception as problem:
            self._problem = problem
            return []

    def _changing(self, mbs: Any) -> list[shapes.Graphics]:
        """Return what is drawn anew in every frame: oil, booms by residual, arrows."""
        time = mbs.systemData.GetTime(exu.ConfigurationType.Visualization)
        placed = coordinates(self.crane, *self.trajectories[0].pose_at(time))[0].reshape(-1, 3)
        frames = dict(zip(shapes.PARTS, placed, strict=True))
        drawn: list[shapes.Graphics] = []
        if self.colour is not None:
            drawn += self._oil(time, frames)
        if self.colour == "residual":
            drawn += self._booms(time, frames)
        return [*drawn, *(self._arrow(mark, time) for mark in self.marks)]

    def _oil(self, time: float, frames: dict[str, np.ndarray]) -> list[shapes.Graphics]:
        drawn = []
        for c, name in enumerate(LAYOUT.cylinders):
            length = float(pose(self.crane, *self.trajectories[0].at(time)).lengths[0, c])
            colors = (self._chamber_color(2 * c, time), self._chamber_color(2 * c + 1, time))
            drawn += [_placed(g, frames[f"{name}_barrel"]) for g in shapes.oil(self.crane, name, length, colors)]
        return drawn

    def _chamber_color(self, chamber: int, time: float) -> shapes.Color:
        value = self.value(LAYOUT.chambers[chamber], time)
        return _NO_VALUE if math.isnan(value) else _map_color(self.colour, value / self.scales["pressure"])

    def _booms(self, time: float, frames: dict[str, np.ndarray]) -> list[shapes.Graphics]:
        paint = shapes.Paint()
        drawn = []
        for part, channel, build in (
            ("lift_boom", "z1", shapes.lift_boom),
            ("outer_boom", "z4", shapes.outer_boom),
        ):
            color = _map_color(self.colour, self.value(channel, time) / self.scales["angle"])
            drawn += [_placed(g, frames[part]) for g in build(self.crane, paint, color)]
        return drawn

    def value(self, channel: str, time: float) -> float:
        """Return what a channel is coloured by at a time: its pressure, or the size of its residual, in SI."""
        main = self.trajectories[0]
        if self.colour == "pressure":
            return main.pressure_at(channel, time)
        other = self.trajectories[1]
        if channel in LAYOUT.chambers:
            return abs(main.pressure_at(channel, time) - other.pressure_at(channel, time))
        return abs(main.at(time)[LAYOUT.index(channel)] - other.at(time)[LAYOUT.index(channel)])

    def _arrow(self, mark: str, time: float) -> shapes.Graphics:
        tip, direction = self.mark_at(mark, time)
        return shapes.arrow((tip[0], tip[1]), direction, 0.55, _MARK)

    def mark_at(self, mark: str, time: float) -> tuple[np.ndarray, tuple[float, float]]:
        """Return where the arrow for a place ends (2,) in m, and the direction in which it comes."""
        points = dict(zip(POINT_NAMES, pose(self.crane, *self.trajectories[0].at(time)).points[0], strict=True))
        place = _PLACES.get(mark, mark)
        if place == "lift":
            return 0.5 * (points["F"] + points["G"]) + np.array([0.09, -0.02]), (-1.0, 0.25)
        if place == "tilt":
            return 0.5 * (points["H"] + points["C"]) + np.array([-0.04, 0.08]), (0.5, -1.0)
        return points[place] + np.array([0.0, 0.1]), (0.0, -1.0)

    # -- pictures ------------------------------------------------------------------------------------------------------

    def frames(self, times: Sequence[float], renderer: Renderer = "raytracer") -> Iterator[np.ndarray]:
        """Yield a picture (height, width, 3) uint8 for every time in s, with legend and time written into it.

        Raises:
            CraneError: OpenGL was asked for, and there is neither a screen nor Xvfb.
        """
        from .render_text import write_on

        with self._renderer(renderer) as ray_traced:
            for time in times:
                self.show(float(time))
                picture = self.system.renderer.RedrawAndGetImage(useRaytracer=ray_traced)
                if self._problem is not None:
                    raise self._problem
                yield write_on(picture, self, float(time))

    @contextlib.contextmanager
    def _renderer(self, wanted: Renderer) -> Iterator[bool]:
        """Prepare a renderer, yield whether it is the ray tracer, and put everything away again."""
        if wanted == "raytracer":
            self._aim()
            yield True
            return
        with screen((self.size[0] + 64, self.size[1] + 64)):
            self.show(self.start)
            self.system.renderer.Attach()  # another scene may have been made since
            if not self.system.renderer.Start():
                raise CraneError(
                    "Exudyn could not open its OpenGL window. Leave --renderer opengl out: the ray tracer needs none."
                )
            try:
                self._aim()
                yield False
            finally:
                self.system.renderer.Stop()

    def project(self, points: np.ndarray) -> np.ndarray:
        """Return the pixels (n, 2), from the top left, at which points (n, 3) in m are seen."""
        width, height = self.size
        seen = (np.asarray(points, dtype=float) - self.center) @ self._rotation().T
        return np.array([width / 2.0, height / 2.0]) + seen[:, :2] * (height / self.height) * [1.0, -1.0]

    def save(
        self,
        path: str | Path,
        *,
        time: float | None = None,
        start: float | None = None,
        end: float | None = None,
        fps: float = 15.0,
        speed: float = 1.0,
        renderer: Renderer = "raytracer",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Write a picture (.png, .jpg) or a film (.gif, .mp4), whole or not at all.

        Args:
            path: the file; its ending tells what it is.
            time: of the picture in s; by default the last.
            start, end: of the film, in s of the run.
            fps: pictures a second of film.
            speed: seconds of the run in a second of film.
            renderer: "raytracer" or "opengl".
            progress: called with the fraction done.

        Raises:
            CraneError: an ending that is not known, a time outside the run, a missing program or package.
        """
        from . import film

        kind = film.kind_of(path)
        if kind == "picture":
            times = np.array([self.end if time is None else time])
        else:
            times = film.times(self.start if start is None else start, self.end if end is None else end, fps, speed)
        self._check_times(times)
        with replacing(path) as temporary:
            film.write(temporary, kind, self.frames(list(times), renderer), len(times), fps, progress)

    def _check_times(self, times: np.ndarray) -> None:
        outside = [t for t in times if not self.start - 1e-9 <= t <= self.end + 1e-9]
        if outside:
            raise CraneError(
                f"There is no picture at {outside[0]:g} s: the run goes from {self.start:g} s to {self.end:g} s. "
                "Give a time within."
            )

    # -- Exudyn's own viewer and file ----------------------------------------------------------------------------------

    def save_solution(self, path: str | Path, rate: float = 50.0) -> None:
        """Write the run as an Exudyn solution file, which `LoadSolutionFile` reads and SolutionViewer plays.

        Args:
            path: of the text file.
            rate: rows a second.
        """
        count = max(2, 1 + round((self.end - self.start) * rate))
        times = np.linspace(self.start, self.end, count)
        rows = []
        for trajectory in self.trajectories:
            poses = np.array([trajectory.pose_at(t) for t in times])
            rows.append(coordinates(self.crane, *poses.T))
        table = np.column_stack([times, *rows])
        with replacing(path) as temporary:
            np.savetxt(temporary, table, fmt="%.9g", delimiter=",", header=_solution_header(table.shape), comments="")

    def view_solution(self, path: str | Path) -> None:
        """Open Exudyn's SolutionViewer with a file of `save_solution`; returns when its windows are closed.

        Raises:
            CraneError: there is no screen, or the file belongs to another scene.
        """
        need_screen("SolutionViewer")
        try:
            from exudyn.interactive import SolutionViewer
        except ImportError as problem:
            raise CraneError(
                f"SolutionViewer needs tkinter ({problem}). Install the Debian package python3-tk."
            ) from None

        solution = self.load_solution(path)
        self.show(self.start)
        self.system.renderer.Attach()
        self.system.renderer.Start()
        self._aim()
        try:
            SolutionViewer(self.mbs, solution, runMode=0, title=self.title or self.crane.name)
        finally:
            self.system.renderer.Stop()

    def load_solution(self, path: str | Path) -> dict[str, Any]:
        """Return the contents of a solution file as Exudyn's viewer takes it.

        Raises:
            CraneError: no solution file, or one of another scene.
        """
        from exudyn.utilities import LoadSolutionFile

        try:
            solution: dict[str, Any] = LoadSolutionFile(str(path), verbose=False)
        except (OSError, ValueError, IndexError) as problem:
            raise CraneError(
                f"{path}: not an Exudyn solution file ({problem}). Write one with --save-solution."
            ) from None
        expected = 3 * len(shapes.PARTS) * len(self.trajectories)
        if solution["columnsExported"][0] != expected:
            raise CraneError(
                f"{path}: found {solution['columnsExported'][0]} coordinates, expected {expected} of a scene with "
                f"{len(self.trajectories)} crane(s). Open it with the same recordings it was written with."
            )
        return solution


def _solution_header(shape: tuple[int, ...]) -> str:
    count = shape[1] - 1
    lines = [
        "#Exudyn generic solver solution file",
        "#simulation started=0",
        "#columns contain: time, ODE2 displacements",
        f"#number of system coordinates [nODE2, nODE1, nAlgebraic, nData] = [{count},0,0,0]",
        f"#number of written coordinates [nODE2, nVel2, nAcc2, nODE1, nVel1, nAlgebraic, nData] = [{count},0,0,0,0,0,0]",
        f"#total columns exported  (excl. time) = {count}",
        f"#number of time steps (planned) = {shape[0] - 1}",
        "#",
    ]
    return "\n".join(lines)


# -- checks ----------------------------------------------------------------------------------------------------------

_PLACES = {p: c for c, sides in zip(LAYOUT.cylinders, LAYOUT.sides, strict=True) for p in sides} | {
    c: c for c in LAYOUT.cylinders
}
_JOINTS = ("O", "A", "B", "C", "D", "E")


def _check(colour: Colour | None, trajectories: Sequence[Trajectory], marks: Sequence[str]) -> None:
    if not trajectories:
        raise CraneError("A scene needs at least one trajectory.")
    if colour == "residual" and len(trajectories) < 2:
        raise CraneError("--colour residual shows a difference: give a second run with --ghost FILE.")
    if colour == "pressure" and not trajectories[0].pressures:
        raise CraneError(f"--colour pressure needs pressures, and this run has none of {', '.join(LAYOUT.chambers)}.")
    for mark in marks:
        if mark not in (*_PLACES, *_JOINTS):
            raise CraneError(f"There is no place {mark!r} to mark. Known: {', '.join((*_PLACES, *_JOINTS))}.")


def _scales(trajectories: Sequence[Trajectory], colour: Colour | None) -> dict[str, float]:
    """Return the values in SI at which the colours end: round numbers at or above the greatest."""
    if colour is None:
        return {}
    main = trajectories[0]
    if colour == "pressure":
        return {"pressure": _round_up(max(float(np.max(v)) for v in main.pressures.values()) / 1e5) * 1e5}
    other = trajectories[1]
    angles = [float(np.max(np.abs(a - np.interp(main.time, other.time, b))))
              for a, b in ((main.z1, other.z1), (main.z4, other.z4))]  # fmt: skip
    both = [p for p in LAYOUT.chambers if p in main.pressures and p in other.pressures]
    drops = [
        float(np.max(np.abs(main.pressures[p] - np.interp(main.time, other.time, other.pressures[p])))) for p in both
    ]
    return {
        "angle": math.radians(_round_up(math.degrees(max(angles)))),
        "pressure": _round_up(max(drops, default=1e5) / 1e5) * 1e5,
    }


def _round_up(value: float) -> float:
    """Return the next round number: 1, 1.5, 2, 3, 4, 5, 6, 8 or 10 times a power of ten."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-6)))
    steps = (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 6.0, 8.0, 10.0)
    return next(step * power for step in steps if step * power >= value * (1.0 - 1e-12))


# -- colours ---------------------------------------------------------------------------------------------------------

_NO_VALUE: shapes.Color = (0.75, 0.75, 0.75, 1.0)
_MARK: shapes.Color = (0.80, 0.0, 0.45, 1.0)
#: colour maps whose lightness rises or falls steadily, so that they read in greyscale
MAPS = {"pressure": "viridis", "residual": "YlOrRd"}


def _map_color(colour: Colour | None, fraction: float) -> shapes.Color:
    from matplotlib import colormaps

    r, g, b, _ = colormaps[MAPS[colour or "pressure"]](min(max(fraction, 0.0), 1.0))
    return (float(r), float(g), float(b), 1.0)


def _placed(graphics: shapes.Graphics, frame: np.ndarray) -> shapes.Graphics:
    """Return graphics of a part's frame in world coordinates; frame is x, y, angle."""
    return _moved(graphics, (frame[0], frame[1], 0.0), frame[2])


def _moved(graphics: shapes.Graphics, by: tuple[float, float, float], angle: float = 0.0) -> shapes.Graphics:
    """Return graphics turned about the z axis and then moved."""
    from exudyn.graphics import Move

    c, s = math.cos(angle), math.sin(angle)
    moved: shapes.Graphics = Move(graphics, list(by), np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    return moved


# -- screens ---------------------------------------------------------------------------------------------------------

_MISSING = (
    "There is no screen (DISPLAY is not set), and the program Xvfb, which makes one in memory, was not found. "
    "Install the Debian package xvfb, or leave --renderer opengl out: the ray tracer needs no screen."
)


def has_screen() -> bool:
    """Return whether a window could be opened."""
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY") or os.name == "nt")


def need_screen(what: str) -> None:
    """Raise CraneError if there is no screen for an interactive window."""
    if not has_screen():
        raise CraneError(f"{what} needs a screen, and DISPLAY is not set. Write a picture instead: -o FILE.png.")


@contextlib.contextmanager
def screen(size: tuple[int, int]) -> Iterator[None]:
    """Make sure that a window can be opened: uses the screen there is, or starts Xvfb and ends it again."""
    if has_screen():
        yield
        return
    process, display = _start_xvfb(size)
    os.environ["DISPLAY"] = display
    try:
        yield
    finally:
        os.environ.pop("DISPLAY", None)
        process.terminate()
        process.wait()


def _start_xvfb(size: tuple[int, int]) -> tuple[subprocess.Popen[bytes], str]:
    """Start Xvfb on a free display number, which it chooses and tells through a pipe."""
    program = shutil.which("Xvfb")
    if program is None:
        raise CraneError(_MISSING)
    reading, writing = os.pipe()
    command = [program, "-displayfd", str(writing), "-screen", "0", f"{size[0]}x{size[1]}x24", "-nolisten", "tcp"]
    process = subprocess.Popen(command, pass_fds=[writing], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    os.close(writing)
    with open(reading, encoding="ascii") as pipe:
        number = _first_line(pipe)
    if not number:
        process.kill()
        process.wait()
        raise CraneError(f"{program} did not start. See what `{program} :99` says, or leave --renderer opengl out.")
    return process, f":{number}"


def _first_line(pipe: Any) -> str:
    import select

    ready, _, _ = select.select([pipe], [], [], _SECONDS_TO_START)
    return pipe.readline().strip() if ready else ""
