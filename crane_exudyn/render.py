"""Pictures and films of a machine, made by Exudyn's own renderers.

A `Scene` is an Exudyn system whose bodies have the machine's shapes and follow given trajectories: nothing is
integrated, the closed geometry places every part. Several of them may stand in one scene - measured, simulated,
estimated. ::

    scene = Scene(crane, [Trajectory.from_recording(recording)])
    scene.save("lift.png", time=5.0)

Two renderers of Exudyn can draw it. Its ray tracer needs no screen and gives the smoother pictures. Its OpenGL window
renderer needs a screen, or the program Xvfb, which makes one in memory and is started and ended here.
"""

from __future__ import annotations

import contextlib
import math
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal, cast, get_args

import numpy as np

from . import render_shapes as shapes
from .crane import Crane, checked_crane
from .errors import CraneError, names_of, refuse_unknown
from .exudyn_quietly import exu, items
from .files import replacing
from .geometry import Pose, pose
from .recording import Recording
from .render_checks import check_scene, checked_size, trajectories_of
from .render_colours import GHOSTS, MARK, NO_VALUE, OTHER_GHOSTS, PLAIN_GHOSTS, map_color, scale_ends
from .render_placement import box_corners, coordinates, in_world
from .render_text import Colour, Entry, Mark, Scale, Texts, margins, write_on
from .screen import need_screen, screen
from .solution_file import read_solution, write_solution
from .trajectory import Trajectory

Renderer = Literal["raytracer", "opengl"]
View = Literal["side", "oblique"]

#: m by which each ghost stands behind the one before; from the side that is not seen, but what is nearer is never
#: hidden
_BEHIND = {"side": 2.5, "oblique": 0.02}
_SUPERSAMPLING = 2
#: pictures a second of film
_FPS = 12.0
_VIEWS = {"side": (0.0, 0.0), "oblique": (math.radians(-24.0), math.radians(14.0))}


class Scene:
    """Machines of one kind that follow trajectories, in one Exudyn system.

    Attributes:
        crane: the description that gives shapes and geometry.
        trajectories: what each of them does; the first is the main one, the others are its ghosts.
        system: the Exudyn system container; mbs: its main system. Add own objects through `own` before anything is
            drawn.
    """

    def __init__(
        self,
        crane: Crane,
        trajectories: Sequence[Trajectory | Recording] | Trajectory | Recording,
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
            trajectories: at least one; a recording is drawn under its own name.
            colour: "pressure" shows the oil in the cylinders by its pressure; "residual" colours bodies and oil by the
                difference between the first and the second trajectory, at times that both cover.
            marks: cylinders, chambers, joints, points or bodies to point at with an arrow, by the machine's names.
            title: written at the top.
            size: width and height in pixels; a small picture has less written on it.
            view: "side" or "oblique"; by default oblique, but from the side where cranes are compared.
            own: called with the Exudyn main system before it is assembled, to add objects of your own.

        Raises:
            CraneError: no trajectory, nothing to compare, a pressure or a place that is not there, a size or a view
                that there is not, a failure of `own`.
        """
        self.crane, self.trajectories, self.title = checked_crane(crane, "Scene"), trajectories_of(trajectories), title
        self.colour, self.marks, self.size = colour, names_of(marks, "Scene: marks"), checked_size(size)
        check_scene(crane, colour, self.trajectories, self.marks)
        self.view: View = view or ("side" if len(self.trajectories) > 1 else "oblique")
        refuse_unknown("Scene", [self.view], _VIEWS, "view")
        self.scales = scale_ends(crane.layout, self.trajectories, colour)
        self._problem: Exception | None = None
        box = self._box()
        self.floor, self.middle = min(0.0, float(box[:, 1].min())), 0.5 * float(box[:, 0].min() + box[:, 0].max())
        # a far point: shadows of a direction end in the ray tracer a few metres behind what throws them
        self.sun = np.array([self.middle, 0.0, 0.0]) + np.ptp(box, axis=0).max() * np.array([-2.0, 9.0, 7.0])
        self.center, self.height = self._frame(box)
        self.system = exu.SystemContainer()
        self.mbs = self.system.AddSystem()
        self._fill(own)
        self._set_up_look()

    def __repr__(self) -> str:
        labels, (width, height) = ", ".join(t.label for t in self.trajectories), self.size
        coloured = f", coloured by {self.colour}" if self.colour else ""
        return (
            f"<Scene of {self.crane.name}: {labels}; {self.start:g} … {self.end:g} s from the {self.view}{coloured}, "
            f"{width} × {height} pixels>"
        )

    @property
    def width(self) -> float:
        """What the picture shows from left to right, m."""
        return self.height * self.size[0] / self.size[1]

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
        """Add ground, pillar and cranes; moving parts are rigid bodies, what changes its colour is drawn by a
        function.
        """
        paints = self._paints()
        thick = self.height if self.view == "side" else 0.06  # from the side, earth down to the lower edge
        fixed = shapes.ground(self.middle, self.width, self.floor, thick)
        fixed += shapes.pillar(self.crane, paints[0], self.floor)
        self.mbs.AddObject(items.ObjectGround(visualization=items.VObjectGround(graphicsData=fixed)))
        for i, paint in enumerate(paints):
            self._add_crane(paint, hidden=self._recoloured() if i == 0 else (), depth=-_BEHIND[self.view] * i)
        drawn = items.VObjectGround(graphicsDataUserFunction=cast(Any, self._draw_changing))
        self.mbs.AddObject(items.ObjectGround(visualization=drawn))
        if own is not None:
            try:
                own(self.mbs)
            except Exception as problem:
                raise CraneError(
                    f"Scene: the function `own` failed: {type(problem).__name__}: {problem}. It is called with the "
                    "Exudyn main system; correct the function."
                ) from problem
        self.mbs.Assemble()

    def _paints(self) -> list[shapes.Paint]:
        if len(self.trajectories) == 1 or self.colour is not None:
            usual = shapes.Paint()
            # what has no residual of its own is grey: among residuals, a beam's orange would be one
            main = replace(usual, barrels=self.colour is None, beam=usual.link if self._recoloured() else usual.beam)
        else:
            main = shapes.Paint.single(self.ghost_color(0))
        return [main, *(shapes.Paint.single(self.ghost_color(i)) for i in range(1, len(self.trajectories)))]

    def ghost_color(self, position: int) -> tuple[float, float, float]:
        """Return the colour of the n-th crane where cranes are told apart by colour."""
        if self.colour is not None:
            return PLAIN_GHOSTS[(position - 1) % len(PLAIN_GHOSTS)]
        return GHOSTS.get(self.trajectories[position].label, OTHER_GHOSTS[position % len(OTHER_GHOSTS)])

    def _recoloured(self) -> tuple[str, ...]:
        return tuple(f"bodies.{b}" for b in self.crane.layout.bodies) if self.colour == "residual" else ()

    def _add_crane(self, paint: shapes.Paint, hidden: Sequence[str], depth: float) -> None:
        graphics = {
            part: [shapes.moved(g, (0.0, 0.0, depth)) for g in made]
            for part, made in shapes.parts(self.crane, paint).items()
        }
        for part in shapes.part_names(self.crane):
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
        light.position, light.diffuse, light.specular, light.shadow = [*self.sun, 1.0], 0.62, 0.25, 0.3
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
                "centerPoint": self.center.tolist(),  # Exudyn turns about the origin, then moves
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

    def _box(self, times: np.ndarray | None = None) -> np.ndarray:
        """Return points (n, 3) between which every machine stays at the times (n,) in s, by default all the time."""
        machine, thick = self.crane.machine, 0.2 * shapes.size(self.crane)
        boxes = []
        for t in self.trajectories:
            at = t.time[:: max(1, len(t.time) // 200)] if times is None else times
            positions = np.array([t.at(x) for x in at])
            closed = pose(self.crane, *positions.T)
            boxes.append(box_corners(np.vstack(list(closed.points.values())), thick, thick))
            if machine.payload[0]:
                placed = coordinates(self.crane, positions, np.array([t.swing_at(x) for x in at]))
                payload = placed.reshape(len(placed), -1, 3)[:, shapes.part_names(self.crane).index("payload")]
                boxes.append(box_corners(np.delete(payload, 2, axis=1), *shapes.payload_extent(self.crane)))
        pins = shapes.ground_pins(self.crane)
        if pins:
            left, right = shapes.feet(pins, shapes.size(self.crane))
            boxes.append(box_corners(np.array([[left, 0.0], [right, 0.0]]), 0.0, 2.0 * thick))
        return np.vstack(boxes)

    def _frame(self, box: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the picture's middle (3,), as it sees it, and height in m: with points (n, 3) and their shadows."""
        share = (box[:, 1:2] - self.floor) / (self.sun[1] - box[:, 1:2])
        shadows = box + share * (box - self.sun) if self.view == "oblique" else box * [1, 0, 1] + [0, self.floor, 0]
        seen = np.vstack([box, shadows]) @ self._rotation().T
        low, high = seen.min(axis=0)[:2], seen.max(axis=0)[:2]
        top, bottom = (written / self.size[1] for written in margins(self._texts(self.start), self.size))
        above, below = max(top, 0.15), max(bottom, 0.08)  # shares of the height for heading, bar and colours
        height = max((high - low)[1] / (1.0 - above - below), 1.05 * (high - low)[0] * self.size[1] / self.size[0])
        x, y = (low + high) / 2.0
        return np.array([x, y + 0.5 * (above - below) * height, 0.0]), float(height)

    # -- what changes with time ----------------------------------------------------------------------------------------

    def show(self, time: float) -> None:
        """Move every crane to where it is at `time` in s."""
        rows = [
            coordinates(self.crane, trajectory.at(time), trajectory.swing_at(time))[0]
            for trajectory in self.trajectories
        ]  # interpolating independent coordinates keeps loops closed, interpolating bodies would not
        for configuration in (exu.ConfigurationType.Current, exu.ConfigurationType.Visualization):
            self.mbs.systemData.SetODE2Coordinates(np.concatenate(rows).tolist(), configuration)
            self.mbs.systemData.SetTime(time, configuration)

    def _draw_changing(self, mbs: Any, _item: int) -> list[shapes.Graphics]:
        """Return what `moving_shapes` draws; the renderer, which calls this, would swallow an error, so it is kept."""
        try:
            return self.moving_shapes(mbs)
        except Exception as problem:
            self._problem = problem
            return []

    def moving_shapes(self, mbs: Any) -> list[shapes.Graphics]:
        """Return what is drawn anew in every frame: oil, bodies by residual, arrows."""
        time = mbs.systemData.GetTime(exu.ConfigurationType.Visualization)
        main = self.trajectories[0]
        placed = coordinates(self.crane, main.at(time), main.swing_at(time))[0].reshape(-1, 3)
        frames = dict(zip(shapes.part_names(self.crane), placed, strict=True))
        drawn: list[shapes.Graphics] = []
        if self.colour is not None:
            drawn += self._oil(time, frames)
        if self.colour == "residual":
            drawn += self._bodies(time, frames)
        return [*drawn, *(self._arrow(mark, time) for mark in self.marks)]

    def _oil(self, time: float, frames: dict[str, np.ndarray]) -> list[shapes.Graphics]:
        drawn, lengths = [], self._pose(time).lengths[0]
        for cylinder, length in zip(self.crane.machine.cylinders, lengths, strict=True):
            colors = [self._color(chamber, time, "Pa") for chamber in cylinder.chambers]
            made = shapes.oil(self.crane, cylinder.name, float(length), (colors[0], colors[1]))
            drawn += [in_world(g, frames[f"cylinders.{cylinder.name}.barrel"]) for g in made]
        return drawn

    def _pose(self, time: float) -> Pose:
        return pose(self.crane, *self.trajectories[0].at(time))

    def _color(self, channel: str, time: float, unit: str) -> shapes.Color:
        value = self.value(channel, time)
        return NO_VALUE if math.isnan(value) else map_color(self.colour, value / self.scales[unit])

    def _bodies(self, time: float, frames: dict[str, np.ndarray]) -> list[shapes.Graphics]:
        """Return the bodies that have a coordinate of their own, coloured by its residual."""
        layout, paint, drawn = self.crane.layout, shapes.Paint(), []
        for name, body in zip(layout.coordinates, layout.bodies, strict=True):
            color = self._color(name, time, layout.unit_of(name))
            made = shapes.body_shape(self.crane, body, paint, color)
            drawn += [in_world(g, frames[f"bodies.{body}"]) for g in made]
        return drawn

    def value(self, channel: str, time: float) -> float:
        """Return what a channel is coloured by at a time: its pressure, or the size of its residual, in SI; NaN where
        it is not known, as residuals are at times that only one run covers.
        """
        main, layout = self.trajectories[0], self.crane.layout
        if self.colour == "pressure":
            return main.pressure_at(channel, time)
        other = self.trajectories[1]
        if not (main.covers(time) and other.covers(time)):
            return math.nan
        if channel in layout.chambers:
            return abs(main.pressure_at(channel, time) - other.pressure_at(channel, time))
        return float(abs(main.at(time) - other.at(time))[layout.index(channel)])

    @property
    def arrow_length(self) -> float:
        """Length of the arrows of marks, m."""
        return 0.1 * self.height

    def _arrow(self, mark: str, time: float) -> shapes.Graphics:
        tip, direction = self.mark_at(mark, time)
        return shapes.arrow(self._in_front(tip), direction, self.arrow_length, MARK)

    def _in_front(self, at: np.ndarray) -> np.ndarray:
        """Return a point (3,) that is seen where a point (2,) in the plane of the machine is, nearer than any part."""
        toward = self._rotation()[2]
        across = max(shapes.FRONT * shapes.size(self.crane), shapes.payload_extent(self.crane)[1] + shapes.FRONT)
        return np.array([*at, 0.0]) + across / toward[2] * toward

    def mark_at(self, mark: str, time: float) -> tuple[np.ndarray, tuple[float, float]]:
        """Return where the arrow for a place ends (2,) in m, and the direction in which it comes: from where there is
        most room beside the machine and the arrows of the marks before it.
        """
        closed = self._pose(time)
        points, arrows = np.vstack(list(closed.points.values())), np.empty((0, 2))
        for name in dict.fromkeys([*self.marks[: self.marks.index(mark) if mark in self.marks else 0], mark]):
            at, ways = self._place_of(name, closed)
            aside = len(ways) == 2  # of a cylinder; any other place is one of the machine's points, or among them
            near, enough = (np.vstack([points, arrows]), math.inf) if aside else (arrows, self.arrow_length)
            tails = [at + self.arrow_length * way for way in ways]
            room = [np.linalg.norm(near - tail, axis=1).min(initial=enough) for tail in tails]
            away = ways[int(np.argmax(room))]
            tip = at + (0.08 if aside else 0.1) * shapes.size(self.crane) * away
            arrows = np.vstack([arrows, tip + np.outer([0.0, 0.5, 1.0], self.arrow_length * away)])
        return tip, (-away[0], -away[1])

    def _place_of(self, mark: str, closed: Pose) -> tuple[np.ndarray, list[np.ndarray]]:
        """Return a place (2,) in m, and the directions (2,) in which an arrow for it may stand: from the middle of a
        cylinder or chamber to either side, else upwards.
        """
        machine = self.crane.machine
        points = {name: at[0] for name, at in closed.points.items()}
        short = dict(zip(machine.points, machine.point_names, strict=True))
        for cylinder, length in zip(machine.cylinders, closed.lengths[0], strict=True):
            if mark in (cylinder.name, *cylinder.chambers):
                base, end = (points[short[p]] for p in cylinder.points)
                along = (end - base) / math.dist(base, end)
                spans = dict(zip(cylinder.chambers, shapes.chambers(self.crane, cylinder.name, length), strict=True))
                across = np.array([-along[1], along[0]])
                return base + np.mean(spans.get(mark, (0.0, length))) * along, [across, -across]
        on_body = [points[short[p]] for p, body in machine.points.items() if body == mark]
        pins = {joint.name: short[joint.pin] for joint in machine.joints}
        at = np.mean(on_body, axis=0) if on_body else points[pins.get(mark, mark)]
        return at, [np.array(way) for way in ((0.0, 1.0), (0.7, 0.7), (-0.7, 0.7))]

    # -- what is written -----------------------------------------------------------------------------------------------

    def texts(self, time: float) -> Texts:
        """Return what is written into the picture at `time` in s."""
        marks = [self._mark(mark, time) for mark in self.marks]
        covered = self._covered(time) if marks else np.empty((0, 3, 2))
        return replace(self._texts(time), width=self.width, marks=marks, covered=covered)

    def _texts(self, time: float) -> Texts:
        """Return what is written at a time, whatever the picture shows and marks."""
        layout = self.crane.layout
        legend = [Entry(self._label(i), self.ghost_color(i)) for i in range(len(self.trajectories))]
        if self.colour is not None:
            legend[0] = Entry(f"{legend[0].label} (coloured)", (1.0, 1.0, 1.0))
        shown = layout.chambers if self.colour == "pressure" else (*layout.chambers, *layout.coordinates)
        return Texts(
            title=self.title or self.crane.name,
            time=time if self.trajectories[0].timed else None,
            pose={
                name: (float(value), layout.unit_of(name))
                for name, value in zip(layout.coordinates, self.trajectories[0].at(time), strict=True)
            },
            width=1.0,
            legend=legend if len(legend) > 1 else (),
            colour=self.colour,
            scales=[
                Scale(unit, end, {c: self.value(c, time) for c in shown if layout.unit_of(c) == unit})
                for unit, end in self.scales.items()
            ],
        )

    def _label(self, position: int) -> str:
        """Return what the n-th crane is called, with its time where that is less than the whole: beyond, it stands."""
        run = self.trajectories[position]
        whole = run.covers(self.start) and run.covers(self.end)
        return run.label if whole else f"{run.label} ({run.time[0]:.4g} to {run.time[-1]:.4g} s)"

    def _covered(self, time: float) -> np.ndarray:
        """Return the triangles (n, 3, 2) in pixels in which machines are seen."""
        made = shapes.pillar(self.crane, shapes.Paint(), self.floor)
        parts = list(shapes.parts(self.crane, shapes.Paint()).values())
        for trajectory in self.trajectories:
            frames = coordinates(self.crane, trajectory.at(time), trajectory.swing_at(time)).reshape(-1, 3)
            made += [in_world(g, frame) for part, frame in zip(parts, frames, strict=True) for g in part]
        corners = np.vstack([shapes.triangles(g) for g in made])
        return self.project(corners.reshape(-1, 3)).reshape(-1, 3, 2)

    def _mark(self, mark: str, time: float) -> Mark:
        tip, direction = self.mark_at(mark, time)
        tail = tip - 1.04 * self.arrow_length * np.asarray(direction) / math.hypot(*direction)
        words = f"{mark} cylinder" if mark in self.crane.layout.cylinders else mark
        return Mark(words, *self.project(np.array([[*tail, 0.0], [*tip, 0.0]])))

    # -- pictures ------------------------------------------------------------------------------------------------------

    def frames(self, times: Sequence[float], renderer: Renderer = "raytracer") -> Iterator[np.ndarray]:
        """Yield a picture (height, width, 3) uint8 for every time in s, with legend and time written into it.

        Raises:
            CraneError: OpenGL was asked for, and there is neither a screen nor Xvfb.
        """
        with self._renderer(renderer) as ray_traced:
            for time in times:
                self.show(float(time))
                picture = self.system.renderer.RedrawAndGetImage(useRaytracer=ray_traced)
                if self._problem is not None:
                    raise self._problem
                yield write_on(picture, self.texts(float(time)))

    @contextlib.contextmanager
    def _renderer(self, wanted: Renderer) -> Iterator[bool]:
        """Prepare a renderer, yield whether it is the ray tracer, and put everything away again."""
        refuse_unknown("Scene", [wanted], get_args(Renderer), "renderer")
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
        seen = np.asarray(points, dtype=float) @ self._rotation().T - self.center
        return np.array([width / 2.0, height / 2.0]) + np.delete(seen, 2, axis=1) * (height / self.height) * [1.0, -1.0]

    def save(
        self,
        path: str | Path,
        *,
        time: float | None = None,
        start: float | None = None,
        end: float | None = None,
        fps: float | None = None,
        speed: float | None = None,
        renderer: Renderer = "raytracer",
        progress: Callable[[float], None] | None = None,
    ) -> None:
        """Write a picture (.png, .jpg) or a film (.gif, .mp4), whole or not at all.

        Args:
            path: the file; its ending tells what it is.
            time: of the picture in s; by default the last, of residuals the last that both runs cover.
            start, end: of the film, in s of the run; by default all of it.
            fps: pictures a second of film, by default 12.
            speed: seconds of the run in a second of film, by default 1.
            renderer: "raytracer" or "opengl".
            progress: called with the fraction done.

        Raises:
            CraneError: an ending or a renderer that is not known, a time outside the run, what a picture, or a film,
                has no use for, a missing program or package.
        """
        from . import film

        kind, picture, rate = film.kind_of(path), {"time": time}, _FPS if fps is None else fps
        whole = {"start": start, "end": end, "fps": fps, "speed": speed}
        idle = [name for name, given in (whole if kind == "picture" else picture).items() if given is not None]
        if idle:
            used = f"one time: give {', '.join(picture)}" if kind == "picture" else f"many: give {', '.join(whole)}"
            raise CraneError(f"{path}: {', '.join(idle)} would change nothing in a {kind}, which shows {used} instead.")
        if kind == "picture":
            times = np.array([self._last if time is None else time])
        else:
            first, last = self.start if start is None else start, self.end if end is None else end
            times = film.times(first, last, rate, 1.0 if speed is None else speed)
        self._check_times(times)
        self.center, self.height = self._frame(self._box(times))
        with replacing(path) as temporary:
            film.write(temporary, kind, self.frames(list(times), renderer), len(times), rate, progress)

    @property
    def _last(self) -> float:
        """The last time that has something to show, s."""
        return min(self.end, float(self.trajectories[1].time[-1])) if self.colour == "residual" else self.end

    def _check_times(self, times: np.ndarray) -> None:
        outside = [t for t in times if not self.trajectories[0].covers(t)]
        if outside:
            raise CraneError(
                f"There is no picture at {outside[0]:g} s: the run goes from {self.start:g} s to {self.end:g} s. "
                "Give a time in this range."
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
            positions = np.array([trajectory.at(t) for t in times])
            rows.append(coordinates(self.crane, positions, np.array([trajectory.swing_at(t) for t in times])))
        table = np.column_stack([times, *rows])
        write_solution(path, table)

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
        solution = read_solution(path)
        expected = 3 * len(shapes.part_names(self.crane)) * len(self.trajectories)
        if solution["columnsExported"][0] != expected:
            raise CraneError(
                f"{path}: found {solution['columnsExported'][0]} coordinates, expected {expected} of a scene with "
                f"{len(self.trajectories)} crane(s). Open it with the same recordings it was written with."
            )
        return solution
