"""Pictures: every part stands where the geometry puts it, colours mean what the legend says, files are whole."""

from __future__ import annotations

import json
import re
import shutil
import subprocess

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, Recording, film, render
from crane_exudyn import render_shapes as shapes
from crane_exudyn.geometry import pose
from crane_exudyn.parameters import POINT_NAMES
from crane_exudyn.render import Scene, Trajectory
from patu.main import run

CRANE = Crane.load("patu655")
TIME = np.linspace(0.0, 4.0, 81)
SMALL = (320, 180)


def motion(label="measured", off=0.0):
    z1, z4 = np.radians(10 + 8 * TIME + off), np.radians(-40 - 6 * TIME - 2 * off)
    return Trajectory(
        label, TIME, z1, z4, {p: np.full(81, (20.0 + 30 * i) * 1e5) for i, p in enumerate(CRANE.layout.chambers)}
    )


def draw(scene, time=2.0, renderer="raytracer"):
    return next(iter(scene.frames([time], renderer))).astype(int)


@pytest.fixture
def recording(tmp_path):
    m = motion()
    path = tmp_path / "run.csv"
    Recording.from_arrays("run", TIME, {"z1": m.z1, "z4": m.z4, "u1": 0 * TIME, "u2": 0 * TIME} | m.pressures).save(
        path
    )
    return path


def patu(*words):
    with pytest.raises(SystemExit) as leaving:
        run([str(w) for w in words])
    return leaving.value.code


# -- where things are --------------------------------------------------------------------------------------------------


def test_parts_meet_in_the_pins():
    """Points that the crane file gives in a body's frame land, through that body's coordinates, on the closed geometry."""
    z1, z4 = np.radians([10.0, 35.0]), np.radians([-40.0, -75.0])
    frames = render.coordinates(CRANE, z1, z4).reshape(2, -1, 3)
    closed = pose(CRANE, z1, z4).points
    for part, point, name in (
        ("lift_boom", "joints.A", "A"), ("bracket_1", "joints.C", "C"), ("bracket_2", "joints.D_bracket", "D"),
        ("outer_boom", "joints.D", "D"), ("outer_boom", "joints.E", "E"), ("lift_boom", "cylinders.tilt.base", "H"),
    ):  # fmt: skip
        x, y, angle = frames[:, shapes.PARTS.index(part)].T
        px, py = CRANE[f"{point}.x"], CRANE[f"{point}.y"]
        found = np.column_stack(
            [x + np.cos(angle) * px - np.sin(angle) * py, y + np.sin(angle) * px + np.cos(angle) * py]
        )
        assert found == pytest.approx(closed[:, POINT_NAMES.index(name)], abs=1e-12)


def test_rod_stays_in_line_with_its_barrel():
    frames = render.coordinates(CRANE, motion().z1, motion().z4).reshape(81, -1, 3)
    lengths = pose(CRANE, motion().z1, motion().z4).lengths
    for c, name in enumerate(("lift", "tilt")):
        barrel, rod = (frames[:, shapes.PARTS.index(f"{name}_{part}")] for part in ("barrel", "rod"))
        along = np.column_stack([np.cos(barrel[:, 2]), np.sin(barrel[:, 2])])
        assert barrel[:, :2] + lengths[:, [c]] * along == pytest.approx(rod[:, :2], abs=1e-12)


def test_a_payload_on_a_pendulum_swings(tmp_path):
    """It hangs from E at theta against straight down; simulations keep the angle, also through a file."""
    crane = CRANE.with_effect("payload_swing", {"length": 0.7, "damping": 5.0})
    theta = 0.4 * np.sin(2.0 * TIME)
    states = np.column_stack([motion().z1, motion().z4, np.zeros((81, 6)), theta, 0 * theta])
    run = Trajectory.from_states("simulated", TIME, states)
    Recording.from_arrays("r", TIME, {"z1": run.z1, "z4": run.z4, "theta": theta}).save(tmp_path / "r.csv")
    read = Trajectory.from_recording(Recording.load(tmp_path / "r.csv"))
    for trajectory, angle in ((run, theta[20]), (read, theta[20]), (motion(), 0.0)):
        placed = render.coordinates(crane, *trajectory.pose_at(1.0))[0].reshape(-1, 3)
        log, tip = placed[shapes.PARTS.index("log")], pose(crane, *trajectory.at(1.0)).points[0, -1]
        assert log[:2] - tip == pytest.approx([0.7 * np.sin(angle), -0.7 * np.cos(angle)], abs=1e-9)
    apart = draw(Scene(crane, [run], size=SMALL), 1.0) != draw(Scene(CRANE, [run], size=SMALL), 1.0)
    assert apart.any(axis=2).sum() > 200


def test_hull_of_discs_has_their_area():
    outline = shapes.hull([(0.0, 0.0, 1.0), (3.0, 0.0, 1.0)], segments=400)
    x, y = outline.T
    area = 0.5 * abs(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))
    assert area == pytest.approx(np.pi + 6.0, rel=1e-3)


@pytest.mark.parametrize("view", ["side", "oblique"])
def test_camera_shows_points_where_the_legend_thinks_they_are(view):
    from exudyn.graphics import Sphere

    points = np.array([[0.0, 0.5, 0.9], [4.0, 0.5, 0.9], [2.0, 2.0, 0.9]])

    def own(mbs):
        balls = [Sphere(p.tolist(), 0.06, color=[1, 0, 1, 1], nTiles=16) for p in points]
        mbs.AddObject(render.items.ObjectGround(visualization=render.items.VObjectGround(graphicsData=balls)))

    scene = Scene(CRANE, [motion()], view=view, own=own, size=(640, 360))
    picture = draw(scene)
    purple = (picture[..., 0] > 120) & (picture[..., 1] < 60) & (picture[..., 2] > 120)
    rows, columns = np.nonzero(purple)
    for x, y in scene.project(points):
        near = np.hypot(columns - x, rows - y) < 12
        assert near.sum() > 20
        assert (columns[near].mean(), rows[near].mean()) == pytest.approx((x, y), abs=1.5)


def test_every_pose_stays_in_the_picture():
    scene = Scene(CRANE, [motion(), motion("simulated", 5.0)], size=SMALL)
    for trajectory in scene.trajectories:
        reached = pose(CRANE, trajectory.z1, trajectory.z4).points.reshape(-1, 2)
        pixels = scene.project(np.column_stack([reached, np.zeros(len(reached))]))
        assert (pixels > 5).all() and (pixels < np.array(SMALL) - 5).all()


# -- what colours mean -------------------------------------------------------------------------------------------------


def test_oil_has_the_colour_of_its_pressure():
    from matplotlib import colormaps

    scene = Scene(CRANE, [motion()], colour="pressure", size=SMALL)
    assert scene.scales["pressure"] == pytest.approx(150e5)  # the next round number above 110 bar
    scene.show(1.0)
    drawn = scene._changing(scene.mbs)
    found = [np.asarray(g["colors"]).reshape(-1, 4)[0] for g in drawn]
    for i, chamber in enumerate((0, 2, 3, 5)):  # each cylinder: piston side, piston, rod side
        expected = colormaps["viridis"]((20.0 + 30 * i) / 150.0)
        assert found[chamber] == pytest.approx(expected, abs=1e-6)


def test_residual_is_the_difference_between_the_runs():
    scene = Scene(CRANE, [motion(), motion("simulated", 3.0)], colour="residual", size=SMALL)
    assert np.degrees(scene.value("z1", 2.0)) == pytest.approx(3.0)
    assert np.degrees(scene.value("z4", 2.0)) == pytest.approx(6.0)
    assert scene.value("p3", 2.0) == 0.0
    assert np.degrees(scene.scales["angle"]) == pytest.approx(6.0)


def test_pictures_of_other_times_and_colours_differ():
    plain, coloured = Scene(CRANE, [motion()], size=SMALL), Scene(CRANE, [motion()], colour="pressure", size=SMALL)
    first = draw(plain, 0.0)
    assert first.shape == (180, 320, 3)
    assert np.abs(draw(plain, 4.0) - first).max() > 100
    assert np.abs(draw(coloured, 0.0) - first).max() > 60
    assert np.array_equal(draw(plain, 0.0), first)


def test_ghosts_stand_behind_and_show_where_they_differ():
    alone = draw(Scene(CRANE, [motion(), motion("estimated")], size=SMALL))
    apart = draw(Scene(CRANE, [motion(), motion("estimated", 6.0)], size=SMALL))
    blue = [((p[..., 2] - p[..., 0]) > 90).sum() for p in (alone[60:], apart[60:])]  # below the legend
    assert blue[1] > blue[0] + 100


@pytest.mark.parametrize("mark", ["lift", "p4", "A", "E"])
def test_marks_are_seen(mark):
    picture = draw(Scene(CRANE, [motion()], marks=[mark], size=(640, 360)))
    purple = (picture[..., 0] > 120) & (picture[..., 1] < 40) & (picture[..., 2] > 50) & (picture[..., 2] < 160)
    assert purple.sum() > 100


def test_an_error_while_drawing_is_not_swallowed():
    scene = Scene(CRANE, [motion()], size=SMALL)
    scene._changing = lambda mbs: 1 / 0
    with pytest.raises(ZeroDivisionError):
        draw(scene)


# -- renderers ---------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(
    not (shutil.which("Xvfb") or render.has_screen()), reason="neither a screen nor Xvfb; CI installs xvfb"
)
def test_opengl_draws_what_the_ray_tracer_draws():
    scenes = [Scene(CRANE, [motion()], size=(640, 360), view="side") for _ in range(2)]
    one, other = draw(scenes[0], 2.0, "opengl"), draw(scenes[1], 2.0, "raytracer")
    orange = [(p[..., 0] - p[..., 2]) > 90 for p in (one, other)]
    assert (orange[0] & orange[1]).sum() > 0.8 * max(o.sum() for o in orange) > 1000  # outlines are aliased differently


def test_opengl_without_screen_names_the_missing_package(monkeypatch, tmp_path):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(CraneError, match="Debian package xvfb"):
        draw(Scene(CRANE, [motion()], size=SMALL), renderer="opengl")
    with pytest.raises(CraneError, match="needs a screen"):
        render.need_screen("--open")


# -- files -------------------------------------------------------------------------------------------------------------


def test_gif_shows_the_run_at_its_own_speed(tmp_path):
    from PIL import Image

    Scene(CRANE, [motion()], size=SMALL).save(tmp_path / "run.gif", start=1.0, end=3.0, fps=10.0, speed=4.0)
    with Image.open(tmp_path / "run.gif") as gif:
        assert gif.n_frames == 6 and gif.info["duration"] == 100 and gif.info["loop"] == 0
        first = np.asarray(gif.convert("RGB")).astype(int)
        gif.seek(5)
        assert np.abs(np.asarray(gif.convert("RGB")) - first).max() > 100


def test_mp4_can_be_read_again(tmp_path):
    imageio_ffmpeg = pytest.importorskip("imageio_ffmpeg", reason="optional extra: film")
    Scene(CRANE, [motion()], size=(321, 181)).save(tmp_path / "run.mp4", fps=5.0, speed=4.0)
    program = imageio_ffmpeg.get_ffmpeg_exe()
    read = subprocess.run(
        [program, "-i", tmp_path / "run.mp4", "-f", "null", "-"], capture_output=True, text=True, check=True
    )
    assert "320x180" in read.stderr and "5 fps" in read.stderr and re.search(r"frame= *6 ", read.stderr)


def test_a_failing_film_leaves_the_old_file(tmp_path):
    path = tmp_path / "run.gif"
    path.write_bytes(b"old")
    scene = Scene(CRANE, [motion()], size=SMALL)
    scene._changing = lambda mbs: 1 / 0
    with pytest.raises(ZeroDivisionError):
        scene.save(path, fps=1.0)
    assert path.read_bytes() == b"old" and len(list(tmp_path.iterdir())) == 1


def test_solution_file_opens_in_exudyn_with_the_same_picture(tmp_path):
    from exudyn.utilities import SetSolutionState

    path = tmp_path / "run.txt"
    scene = Scene(CRANE, [motion(), motion("simulated", 4.0)], size=SMALL)
    scene.save_solution(path, rate=10.0)
    solution = scene.load_solution(path)
    assert solution["nRows"] == 41 and solution["data"][20, 0] == pytest.approx(2.0)
    scene.show(2.0)
    shown = scene.mbs.systemData.GetODE2Coordinates()
    scene.show(0.0)
    SetSolutionState(scene.mbs, solution, 20)
    assert scene.mbs.systemData.GetODE2Coordinates() == pytest.approx(shown, abs=1e-8)


def test_a_solution_of_another_scene_is_refused(tmp_path):
    Scene(CRANE, [motion()], size=SMALL).save_solution(tmp_path / "one.txt")
    two = Scene(CRANE, [motion(), motion("simulated")], size=SMALL)
    with pytest.raises(CraneError, match="found 30 coordinates, expected 60"):
        two.load_solution(tmp_path / "one.txt")
    (tmp_path / "no.txt").write_text("hello\n" * 6)
    with pytest.raises(CraneError, match="not an Exudyn solution file"):
        two.load_solution(tmp_path / "no.txt")


# -- the command -------------------------------------------------------------------------------------------------------


def test_command_writes_picture_solution_and_json(recording, tmp_path, capsys):
    picture, solution = tmp_path / "a.png", tmp_path / "a.txt"
    words = ["-o", picture, "--save-solution", solution, "--size", "320x180", "--time", "2", "--colour", "residual"]
    assert patu("render", recording, "--ghost", f"model={recording}", "--mark", "tilt", *words, "--json", "-") == 0
    said = json.loads(capsys.readouterr().out)
    assert said["written"] == [str(picture), str(solution)] and said["runs"] == ["measured", "model"]
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_command_draws_the_crane_at_its_start_without_a_recording(tmp_path):
    assert patu("render", "-o", tmp_path / "crane.png", "--size", "320x180") == 0


@pytest.mark.parametrize(
    ("words", "message"),
    [
        ([], "Nothing to do"),
        (["-o", "a.txt"], "expected .png"),
        (["-o", "a.png", "--time", "9"], "goes from 0 s to 4 s"),
        (["-o", "a.png", "--mark", "knee"], "no place 'knee'"),
        (["-o", "a.png", "--size", "big"], "not WIDTHxHEIGHT"),
        (["-o", "a.png", "--colour", "residual"], "--ghost FILE"),
        (["-o", "a.gif", "--fps", "0"], "--fps 0 is not positive"),
        (["-o", "a.gif", "--from", "3", "--to", "2"], "Give a later end"),
        (["-o", "missing/a.png"], "does not exist"),
    ],
)
def test_bad_input_is_told_in_one_message(words, message, recording, capsys, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.iterdir())
    assert patu("render", recording, *words) == 2
    assert message in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_a_recording_without_angles_is_told(tmp_path, capsys):
    path = tmp_path / "p.csv"
    path.write_text("time[s],u1[-],u2[-],p1[bar]\n0,0,0,20\n1,0,0,21\n")
    assert patu("render", path, "-o", tmp_path / "a.png") == 2
    assert "needs the angles z1 and z4" in capsys.readouterr().err


def test_absolute_outer_angle_is_made_relative():
    channels = {"z1": np.array([0.1, 0.2]), "z4_abs": np.array([-0.5, -0.6]), "u1": np.zeros(2), "u2": np.zeros(2)}
    made = Trajectory.from_recording(Recording.from_arrays("r", np.array([0.0, 1.0]), channels))
    assert made.z4 == pytest.approx([-0.6, -0.8])


def test_film_times_keep_pace():
    assert film.times(1.0, 3.0, fps=10.0, speed=5.0) == pytest.approx([1.0, 1.5, 2.0, 2.5, 3.0])
