"""Pictures: every part stands where the geometry puts it, colours mean what the legend says, files are whole."""

from __future__ import annotations

import json
import re
import shlex
import shutil
import subprocess

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, Recording, channels, film, mechanism, render, screen, simulate
from crane_exudyn import render_shapes as shapes
from crane_exudyn import render_text as text
from crane_exudyn.geometry import pose
from crane_exudyn.machine import GROUND
from crane_exudyn.render import Scene
from crane_exudyn.render_placement import coordinates
from crane_exudyn.trajectory import Trajectory
from patu.main import run

CRANE = Crane.load("patu655")
MACHINES = {name: Crane.load(name) for name in ("patu655", "patu655-telescope", "excavator", "loader")}
TIME = np.linspace(0.0, 4.0, 81)
SMALL = (320, 180)


def motion(label="measured", off=0.0, crane=CRANE):
    """Return a motion that lifts the first body, lowers the last one and slides out what slides, off by so many degrees
    (or cm).
    """
    layout = crane.layout
    rates = np.where(layout.slides, 1.5, np.linspace(8.0, -6.0, len(layout.coordinates)))
    differences = off * np.linspace(1.0, -2.0, len(layout.coordinates))
    units = np.where(layout.slides, 0.01, np.radians(1.0))
    positions = np.array(crane.initial.pose) + (np.outer(TIME, rates) + differences) * units
    pressures = {p: np.full(81, (20.0 + 30 * i) * 1e5) for i, p in enumerate(layout.chambers)}
    return Trajectory(label, TIME, positions, pressures)


def draw(scene, time=2.0, renderer="raytracer"):
    return next(iter(scene.frames([time], renderer))).astype(int)


@pytest.fixture
def recording(tmp_path):
    m = motion()
    path = tmp_path / "run.csv"
    z1, z4 = m.positions.T
    Recording.from_arrays("run", TIME, {"z1": z1, "z4": z4, "u1": 0 * TIME, "u2": 0 * TIME} | m.pressures).save(path)
    return path


def patu(*words):
    with pytest.raises(SystemExit) as leaving:
        run([str(w) for w in words])
    return leaving.value.code


# -- where things are --------------------------------------------------------------------------------------------------


def placed_at(crane, positions, theta=0.0):
    """Return {part: (n, 3)}: x, y, angle of every part."""
    frames = coordinates(crane, positions, theta)
    return dict(zip(shapes.part_names(crane), frames.reshape(len(frames), -1, 3).transpose(1, 0, 2), strict=True))


@pytest.mark.parametrize("name", MACHINES)
def test_parts_meet_in_the_pins(name):
    """Points that the file gives in a body's frame land, through that body's coordinates, on the closed geometry."""
    crane = MACHINES[name]
    machine, positions = crane.machine, motion(crane=crane).positions
    placed, closed = placed_at(crane, positions), pose(crane, *positions.T)
    for (point, body), short in zip(machine.points.items(), machine.point_names, strict=True):
        if body != GROUND:
            (px, py), (x, y, angle) = shapes.place(crane, point), placed[f"bodies.{body}"].T
            found = [x + np.cos(angle) * px - np.sin(angle) * py, y + np.sin(angle) * px + np.cos(angle) * py]
            assert np.column_stack(found) == pytest.approx(closed.points[short], abs=1e-12), point


@pytest.mark.parametrize("name", MACHINES)
def test_rod_stays_in_line_with_its_barrel(name):
    crane = MACHINES[name]
    positions = motion(crane=crane).positions
    placed, lengths = placed_at(crane, positions), pose(crane, *positions.T).lengths
    for c, cylinder in enumerate(crane.layout.cylinders):
        barrel, rod = (placed[f"cylinders.{cylinder}.{part}"] for part in ("barrel", "rod"))
        along = np.column_stack([np.cos(barrel[:, 2]), np.sin(barrel[:, 2])])
        assert barrel[:, :2] + lengths[:, [c]] * along == pytest.approx(rod[:, :2], abs=1e-12)


def covered(graphics, at):
    """Return whether a place in the plane lies within the side view of some graphics."""
    for g in (g for g in graphics if "triangles" in g or "triangles6" in g):
        corners = np.reshape(g["points"], (-1, 3))[:, :2]
        for a, b, c in corners[np.array(g["triangles"] if "triangles" in g else g["triangles6"])[:, :3]]:
            ends = np.array([b - a, c - a]).T
            if abs(np.linalg.det(ends)) > 1e-12:
                u, v = np.linalg.solve(ends, at - a)
                if u >= 0 and v >= 0 and u + v <= 1:
                    return True
    return False


@pytest.mark.parametrize("name", MACHINES)
def test_every_pin_lies_in_steel_and_every_body_is_one_piece(name):
    crane = MACHINES[name]
    for point, body in crane.machine.points.items():
        if crane.machine.carriers.get(body, None) is not None and crane.machine.payload[1] != point:
            prismatic = any(j.pin == point and j.kind == "prismatic" for j in crane.machine.joints)
            made = shapes.body_shape(crane, body, shapes.Paint())
            plates = [g for g in made if "triangles" in g]
            assert prismatic or covered(plates, shapes.place(crane, point)), point


def test_a_body_of_two_pins_is_a_link_of_two_plates():
    paint = shapes.Paint()
    for name, links in (("patu655", {"bracket_1", "bracket_2"}), ("excavator", {"rocker", "link"}), ("loader", set())):
        crane, dark = MACHINES[name], list(paint.link)
        plates = {
            b: [g["colors"][0] for g in shapes.body_shape(crane, b, paint) if "triangles" in g]
            for b in crane.machine.bodies
        }
        assert {b for b, colors in plates.items() if len(colors) == 2 and np.allclose(colors, dark)} == links


def test_any_body_has_a_shape():
    """Also one whose centre of mass lies in its pin or far away from all points, or whose pins lie in one place."""
    random = np.random.default_rng(1)
    for crane in (MACHINES["excavator"], MACHINES["patu655-telescope"]):
        names = [
            n
            for n in crane.machine.names
            if n.startswith(("bodies.", "joints.", "cylinders.")) and n.endswith((".x", ".y"))
        ]
        for size in (0.0, 0.3, 3.0):
            other = crane.with_parameters({n: size * random.normal() for n in names})
            for body in crane.machine.bodies:
                made = shapes.body_shape(other, body, shapes.Paint())
                assert made and all(np.isfinite(g["points"]).all() for g in made)


def test_a_sliding_body_is_drawn_inside_its_carrier():
    crane = MACHINES["patu655-telescope"]
    sheath, inner = (shapes.body_shape(crane, b, shapes.Paint())[0] for b in ("outer_boom", "extension"))
    (outer, slim) = (np.reshape(g["points"], (-1, 3)) for g in (sheath, inner))
    assert np.ptp(slim[:, 1]) < np.ptp(outer[:, 1]) and np.ptp(slim[:, 2]) < np.ptp(outer[:, 2])
    assert outer[:, 1].min() < slim[:, 1].min() and slim[:, 1].max() < outer[:, 1].max()


def test_a_machine_that_reaches_below_its_ground_stands_on_a_lower_floor():
    crane = MACHINES["excavator"]
    dug = Trajectory("start", TIME, np.tile(np.array(crane.initial.pose) - [0.9, 0.0, 0.0], (81, 1)))
    assert Scene(crane, [dug], size=SMALL).floor < -0.3 and Scene(crane, [motion(crane=crane)], size=SMALL).floor == 0.0


def test_a_payload_on_a_pendulum_swings(tmp_path):
    """It hangs from its point at theta against straight down; simulations keep the angle, also through a file."""
    crane = CRANE.with_effect("payload_swing", {"length": 0.7, "damping": 5.0})
    theta = 0.4 * np.sin(2.0 * TIME)
    states = np.column_stack([motion().positions, np.zeros((81, 6)), theta, 0 * theta])
    run = Trajectory.from_states("simulated", TIME, states, crane.layout)
    z1, z4 = run.positions.T
    Recording.from_arrays("r", TIME, {"z1": z1, "z4": z4, "theta": theta}).save(tmp_path / "r.csv")
    read = Trajectory.from_recording(Recording.load(tmp_path / "r.csv"))
    for trajectory, angle in ((run, theta[20]), (read, theta[20]), (motion(), 0.0)):
        load = placed_at(crane, trajectory.at(1.0), trajectory.swing_at(1.0))["payload"][0]
        tip = pose(crane, *trajectory.at(1.0)).points["E"][0]
        assert load[:2] - tip == pytest.approx([0.7 * np.sin(angle), -0.7 * np.cos(angle)], abs=1e-9)
    apart = draw(Scene(crane, [run], size=SMALL), 1.0) != draw(Scene(CRANE, [run], size=SMALL), 1.0)
    assert apart.any(axis=2).sum() > 200


def test_bodies_built_for_exudyn_carry_their_shapes_about_their_masses():
    crane = MACHINES["excavator"]
    for graphics in (True, False):
        _, mbs = mechanism.main_system()
        plant = mechanism.build(mbs, crane, graphics=graphics)
        for b, (name, number) in enumerate(plant.bodies[0].items()):
            made = mbs.GetObject(number, addGraphicsData=True)["VgraphicsData"]
            assert bool(made) == graphics, name
            if made:
                point = next(p for p, body in crane.machine.points.items() if body == name)
                assert covered(made, shapes.place(crane, point) - plant.inertia[0, b, 1:3])
        assert bool(mbs.GetObject(plant.ground, addGraphicsData=True)["VgraphicsData"]) == graphics


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


@pytest.mark.parametrize("view", ["side", "oblique"])
@pytest.mark.parametrize("name", MACHINES)
def test_every_machine_stays_in_the_picture_and_fills_it(name, view):
    crane = MACHINES[name]
    scene = Scene(crane, [motion(crane=crane), motion("simulated", 5.0, crane)], size=(640, 360), view=view)
    reached = np.vstack([p for t in scene.trajectories for p in pose(crane, *t.positions.T).points.values()])
    pixels = scene.project(np.column_stack([reached, np.zeros(len(reached))]))
    assert (pixels > 5).all() and (pixels < np.array((640, 360)) - 5).all()
    assert (np.ptp(pixels, axis=0) / (640, 360)).max() > 0.35


def test_the_floor_is_larger_than_the_picture_and_shadows_are_whole():
    """Below a level boom its shadow is one piece: every column of pixels between its ends has some of it."""
    level = Trajectory("run", TIME, np.tile([0.3, -0.3], (81, 1)))
    picture = draw(Scene(CRANE, [level], size=(640, 360)))
    assert (picture[-1].std(axis=1) < 12).all()  # floor, no background, along the lower edge
    assert picture[-1].mean() < 235
    dark = (np.abs(picture - 130) < 14).all(axis=2)
    ends = np.flatnonzero(dark[200:, 110:].any(axis=0))  # right of the foot
    assert np.ptp(ends) > 200 and len(ends) > 0.95 * np.ptp(ends) and ends.max() < 525


def test_from_the_side_the_machine_stands_on_earth_down_to_the_lower_edge_with_its_feet_in_the_picture():
    scene = Scene(CRANE, [Trajectory.at_rest(CRANE)], size=(640, 360), view="side")
    picture = draw(scene).astype(int)
    floor = round(float(scene.project(np.zeros((1, 3)))[0, 1]))
    assert (picture[floor + 3 :, 400:, 2] < picture[floor + 3 :, 400:, 0] + 5).all()  # no blue of the sky
    feet = shapes.feet(shapes.ground_pins(CRANE), shapes.size(CRANE))
    ends = scene.project(np.array([[x, 0.0, 0.0] for x in feet]))[:, 0]
    assert (ends > 5).all() and (ends < 635).all()


# -- what colours mean -------------------------------------------------------------------------------------------------


def test_oil_has_the_colour_of_its_pressure():
    from matplotlib import colormaps

    scene = Scene(CRANE, [motion()], colour="pressure", size=SMALL)
    assert scene.scales["Pa"] == pytest.approx(150e5)  # the next round number above 110 bar
    scene.show(1.0)
    drawn = scene.moving_shapes(scene.mbs)
    found = [np.asarray(g["colors"]).reshape(-1, 4)[0] for g in drawn]
    for i, chamber in enumerate((0, 2, 3, 5)):  # each cylinder: piston side, piston, rod side
        expected = colormaps["viridis"]((20.0 + 30 * i) / 150.0)
        assert found[chamber] == pytest.approx(expected, abs=1e-6)


def test_residual_is_the_difference_between_the_runs():
    scene = Scene(CRANE, [motion(), motion("simulated", 3.0)], colour="residual", size=SMALL)
    assert np.degrees(scene.value("z1", 2.0)) == pytest.approx(3.0)
    assert np.degrees(scene.value("z4", 2.0)) == pytest.approx(6.0)
    assert scene.value("p3", 2.0) == 0.0
    assert np.degrees(scene.scales["rad"]) == pytest.approx(6.0)


def until(run_, end):
    """Return the run up to a time in s."""
    n = int((run_.time <= end).sum())
    return Trajectory(run_.label, run_.time[:n], run_.positions[:n], {p: v[:n] for p, v in run_.pressures.items()})


def test_there_is_no_residual_beyond_a_ghosts_end():
    """A run against its own beginning: it goes on, and nothing differs."""
    from matplotlib import colormaps

    ghost = until(motion("short"), 1.5)
    scene = Scene(CRANE, [motion(), ghost], colour="residual", size=SMALL)
    assert np.degrees(scene.scales["rad"]) == pytest.approx(0.1) and scene.scales["Pa"] == pytest.approx(1e5)
    for channel in ("z1", "p1"):
        assert scene.value(channel, 1.5) == 0.0 and np.isnan(scene.value(channel, 1.6))
    scene.show(3.0)
    drawn = [np.reshape(g["colors"], (-1, 4))[0] for g in scene.moving_shapes(scene.mbs)]
    assert not any(np.allclose(c, colormaps["YlOrRd"](0.0)) for c in drawn)
    texts = scene.texts(3.0)
    assert texts.legend[1].label == "short (0 to 1.5 s)"
    assert all(np.isnan(value) for scale in texts.scales for value in scale.values.values())
    late = Trajectory("late", TIME + 9.0, ghost.positions[[0] * 81])
    with pytest.raises(CraneError, match="a time that both runs cover, but 'measured' goes from 0 to 4 s"):
        Scene(CRANE, [motion(), late], colour="residual", size=SMALL)


def test_a_channel_is_not_known_beyond_its_own_end():
    z1, z4 = motion().positions.T
    p1 = np.where(TIME < 2.0, 50e5, np.nan)
    made = Trajectory.from_recording(Recording.from_arrays("r", TIME, {"z1": z1, "z4": z4, "p1": p1}))
    assert made.pressure_at("p1", 1.9) == 50e5 and np.isnan(made.pressure_at("p1", 3.0))


@pytest.mark.parametrize("colour", [None, "pressure", "residual"])
def test_ghosts_are_told_apart(colour):
    runs = [motion(), motion("a", 2.0), motion("b", 4.0), motion("c", 6.0)]
    scene = Scene(CRANE, runs, colour=colour, size=SMALL)
    colors = [entry.color for entry in scene.texts(1.0).legend]
    assert min(np.hypot.reduce(np.subtract(a, b)) for i, a in enumerate(colors) for b in colors[:i]) > 0.2
    assert all(scene.ghost_color(i) == colors[i] for i in (1, 2, 3))


@pytest.mark.parametrize("name", MACHINES)
def test_a_body_is_coloured_whole(name):
    """Beams, lugs, links and buckets; only pins are bare."""
    crane, paint, green = MACHINES[name], shapes.Paint(), (0.1, 0.9, 0.2, 1.0)
    for body in crane.machine.bodies:
        made = shapes.body_shape(crane, body, paint, green)
        seen = {tuple(np.round(np.reshape(g["colors"], (-1, 4))[0], 6)) for g in made if "colors" in g}
        assert seen == {green, paint.pin}, body


def test_what_has_no_residual_of_its_own_is_grey():
    """A beam's orange would be a residual."""
    for name, crane in MACHINES.items():
        scene = Scene(crane, [motion(crane=crane), motion("simulated", 3.0, crane)], colour="residual", size=SMALL)
        beam = shapes.Paint().beam
        for number in range(scene.mbs.systemData.NumberOfObjects()):
            made = scene.mbs.GetObject(number, addGraphicsData=True).get("VgraphicsData") or []
            seen = [tuple(np.round(np.reshape(g["colors"], (-1, 4))[0], 6)) for g in made if "colors" in g]
            assert beam not in seen, name


def test_a_bucket_is_seen_to_differ():
    from matplotlib import colormaps

    crane, apart = MACHINES["excavator"], 0.2
    ghost = motion("simulated", crane=crane)
    ghost.positions[:, crane.layout.index("bucket")] += apart
    scene = Scene(crane, [motion(crane=crane), ghost], colour="residual", size=SMALL, view="side")
    scene.show(2.0)
    red = colormaps["YlOrRd"](apart / scene.scales["rad"])
    drawn = [g for g in scene.moving_shapes(scene.mbs) if "points" in g]
    load = pose(crane, *scene.trajectories[0].at(2.0)).points["soil"][0]
    cheeks = [g for g in drawn if np.allclose(np.reshape(g["colors"], (-1, 4))[0], red) and covered([g], load)]
    assert cheeks


def test_residuals_of_ways_have_a_scale_of_their_own():
    crane = MACHINES["patu655-telescope"]
    scene = Scene(crane, [motion(crane=crane), motion("simulated", 3.0, crane)], colour="residual", size=SMALL)
    assert scene.value("z5", 2.0) == pytest.approx(0.06) and scene.scales["m"] == pytest.approx(0.06)
    draw(scene)


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


@pytest.mark.parametrize("mark", ["lift", "p4", "A", "E", "D_bracket", "outer_boom"])
def test_marks_are_seen(mark):
    picture = draw(Scene(CRANE, [motion()], marks=[mark], size=(640, 360)))
    purple = (picture[..., 0] > 120) & (picture[..., 1] < 40) & (picture[..., 2] > 50) & (picture[..., 2] < 160)
    assert purple.sum() > 100


def test_an_error_while_drawing_is_not_swallowed():
    scene = Scene(CRANE, [motion()], size=SMALL)
    scene.moving_shapes = lambda mbs: 1 / 0
    with pytest.raises(ZeroDivisionError):
        draw(scene)


def apart(a, b):
    return a[0] >= b[2] or a[2] <= b[0] or a[1] >= b[3] or a[3] <= b[1]


def test_a_name_is_clear_of_what_else_is_written():
    """Under the heading, inside the picture, and not on another name, an arrow, or a machine while there is room."""
    from PIL import Image, ImageDraw

    draw_on, size = ImageDraw.Draw(Image.new("RGB", (700, 500))), (700, 500)
    heading = (20.0, 15.0, 310.0, 55.0)
    for tail, tip in (((283.0, 75.0), (283.0, 120.0)), ((5.0, 300.0), (60.0, 300.0)), ((400.0, 3.0), (400.0, 60.0))):
        mark = text.Mark("a long name", np.array(tail), np.array(tip))
        space = text.Space(size, np.array([[tail, (tail[0] + 20, tail[1]), (tail[0], tail[1] + 20)]]))
        space.take(heading)
        space.take_line(mark.tip, mark.tip, 1.0)
        one, other = (text.write_mark(draw_on, mark, 0.7, space) for _ in range(2))
        for left, top, right, bottom in (one, other):
            assert left >= 0.0 and top >= 0.0 and right <= 700.0 and bottom <= 500.0
            assert apart((left, top, right, bottom), heading)
            assert not (left < tip[0] < right and top < tip[1] < bottom)
            assert not (left < tail[0] + 3 < right and top < tail[1] + 3 < bottom)  # on the machine
        assert apart(one, other)
    free = text.Mark("J", np.array([350.0, 200.0]), np.array([350.0, 260.0]))
    left, top, right, bottom = text.write_mark(draw_on, free, 0.7, text.Space(size, np.empty((0, 3, 2))))
    assert (left + right) / 2.0 == pytest.approx(350.0, abs=1.0) and 165.0 < bottom <= 200.0  # at its arrow's tail


@pytest.mark.parametrize("size", [(1280, 720), (640, 360), (320, 200), (160, 120)])
@pytest.mark.parametrize("name", MACHINES)
def test_what_is_written_is_inside_the_picture_and_clear_of_the_machine(name, size, monkeypatch):
    """Every word is drawn inside the picture, and no machine reaches to where they stand; little pictures have few."""
    from PIL import ImageDraw

    crane = MACHINES[name]
    runs = [motion(crane=crane), motion("simulated", 3.0, crane)]
    scene = Scene(crane, runs, colour="residual", size=size, title="a title " * 12)
    written, usual = [], ImageDraw.ImageDraw.text

    def noting(self, xy, words, **look):
        written.append(self.textbbox(xy, words, font=look["font"], anchor=look.get("anchor")))
        usual(self, xy, words, **look)

    monkeypatch.setattr(ImageDraw.ImageDraw, "text", noting)
    text.write_on(np.zeros((size[1], size[0], 3), dtype=np.uint8), scene.texts(2.0))
    assert all(b[0] >= 0 and b[1] >= 0 and b[2] <= size[0] and b[3] <= size[1] for b in written)
    assert all(apart(a, b) for i, a in enumerate(written) for b in written[:i])
    reached = np.vstack([p for t in runs for p in pose(crane, *t.positions.T).points.values()])
    covered = scene.project(np.column_stack([reached, np.zeros(len(reached))]))[:, 1]
    top, bottom = text.margins(scene.texts(2.0), size)
    assert covered.min() > top and covered.max() < size[1] - bottom
    assert len(written) > 12 if size[0] > 320 else len(written) < 16


def test_arrows_of_several_marks_stand_apart_and_in_front_of_the_payload():
    crane = MACHINES["loader"]
    scene = Scene(crane, [motion(crane=crane)], marks=["bucket", "lift", "p2", "p1"], size=(640, 360))
    lines = [(m.tail, m.tip) for m in scene.texts(2.0).marks]
    for i, (tail, tip) in enumerate(lines):
        for other_tail, other_tip in lines[:i]:
            assert np.hypot(*(tail - other_tail)) > 10 and np.hypot(*(tip - other_tip)) > 3
    picture = draw(scene)
    (x, y), (x_tip, y_tip) = lines[0]
    for share in (0.3, 0.5, 0.8):  # along the arrow, over the soil
        r, g, b = picture[round(y + share * (y_tip - y)), round(x + share * (x_tip - x))]
        assert r > 100 and g < 60 and b > 40


def test_a_machine_at_its_start_has_no_time():
    still, run_ = (Scene(CRANE, [t], size=SMALL) for t in (Trajectory.at_rest(CRANE), motion()))
    assert still.texts(1.0).time is None and run_.texts(1.0).time == 1.0
    draw(still, 1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Scene("loader", [motion()]), r"Scene: found 'loader' instead of a crane.*Crane.load\('loader'\)"),
        (lambda: Scene(CRANE, ["run.csv"]), "found 'run.csv', expected trajectories"),
        (lambda: Scene(CRANE, [motion()], view="top"), "unknown view 'top'. Known: side, oblique"),
        (lambda: Scene(CRANE, [motion()], size=(0, 0)), r"size is \(0, 0\), expected width and height"),
        (lambda: Scene(CRANE, [motion()], size="320x200"), "size is '320x200', expected width and height"),
        (lambda: Scene(CRANE, [motion()], own=lambda mbs: mbs.nothing), "`own` failed: AttributeError"),
        (lambda: Trajectory.from_recording("f.csv"), r"found 'f.csv', expected a Recording.*Recording.load"),
        (lambda: Trajectory.at_rest("loader"), "at_rest: found 'loader' instead of a crane"),
        (lambda: Trajectory("a", [0.0, 1.0], [[0.1, np.nan], [0.1, 0.2]]), "not finite in positions, sample 0"),
        (lambda: Trajectory("a", [0.0, 1.0], np.zeros((3, 2))), r"time has the shape \(2,\) and positions"),
        (lambda: Trajectory("a", [0.0, 1.0], np.zeros((2, 2)), {"p1": np.zeros(3)}), r"p1 has the shape \(3,\)"),
        (lambda: Trajectory("a", [1.0, 0.0], np.zeros((2, 2))), "time does not increase"),
    ],
)
def test_what_cannot_be_drawn_is_told(make, message):
    with pytest.raises(CraneError, match=message):
        make()


def test_a_recording_and_a_single_mark_are_taken_as_they_are():
    z1, z4 = motion().positions.T
    recording = Recording.from_arrays("lift", TIME, {"z1": z1, "z4": z4})
    scene = Scene(CRANE, [recording], marks="lift", size=SMALL)
    assert scene.marks == ("lift",) and [t.label for t in scene.trajectories] == ["lift"]


@pytest.mark.parametrize(
    ("name", "words", "message"),
    [
        ("a.png", {"start": 0.1, "end": 0.2}, "start, end would change nothing in a picture"),
        ("a.gif", {"time": 1.0}, "time would change nothing in a gif"),
        ("a.png", {"renderer": "foo"}, "unknown renderer 'foo'"),
    ],
)
def test_nothing_asked_for_is_ignored(name, words, message, tmp_path):
    with pytest.raises(CraneError, match=message):
        Scene(CRANE, [motion()], size=SMALL).save(tmp_path / name, **words)
    assert not list(tmp_path.iterdir())


# -- renderers ---------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(
    not (shutil.which("Xvfb") or screen.has_screen()), reason="neither a screen nor Xvfb; CI installs xvfb"
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
        screen.need_screen("--open")


# -- files -------------------------------------------------------------------------------------------------------------


def test_gif_shows_the_run_at_its_own_speed(tmp_path):
    from PIL import Image

    Scene(CRANE, [motion()], size=SMALL).save(tmp_path / "run.gif", start=1.0, end=3.0, fps=10.0, speed=4.0)
    with Image.open(tmp_path / "run.gif") as gif:
        assert gif.n_frames == 6 and gif.info["duration"] == 100 and gif.info["loop"] == 0
        first = np.asarray(gif.convert("RGB")).astype(int)
        gif.seek(5)
        assert np.abs(np.asarray(gif.convert("RGB")) - first).max() > 100


@pytest.mark.parametrize("fps", [12.0, 30.0, 7.0])
def test_a_gif_lasts_as_long_as_its_frames_say(fps, tmp_path):
    """GIF counts in hundredths of a second, so that frames of 12 a second are not all of one length."""
    from PIL import Image

    n = round(2.0 * fps)
    frames = (np.full((4, 4, 3), 3 * k, np.uint8) for k in range(n))
    film.write(tmp_path / "two.gif", "gif", frames, n, fps)
    with Image.open(tmp_path / "two.gif") as gif:
        shown = []
        for k in range(gif.n_frames):
            gif.seek(k)
            shown.append(gif.info["duration"])
    assert sum(shown) == 2000 and max(shown) - min(shown) <= 10


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
    scene.moving_shapes = lambda mbs: 1 / 0
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


def test_a_run_is_called_what_it_is(tmp_path, capsys):
    """A simulation is one by holding everything without contradiction; its pressures may ring as noise does."""
    time = np.arange(0.0, 2.0, 0.01)
    given = Recording.from_arrays("given", time, {"u1": 0.5 * np.sign(np.sin(9 * time)) * (time > 0.2), "u2": 0 * time})
    made = simulate(CRANE, given, engine="semi-recursive")
    made.save(tmp_path / "run.csv")
    run_ = Recording.load(tmp_path / "run.csv")
    assert set(run_.noise_free()) != set(run_.sensors)  # the oil rings
    noise = np.random.default_rng(1).standard_normal
    values = {n: v + 1e-3 * np.ptp(v) * noise(len(v)) * (n[0] != "u") for n, v in made.channels().items()}
    header = ",".join(["time[s]", *(f"{n}[{channels.of(CRANE.layout)[n] or '-'}]" for n in values)])
    table = np.column_stack([made.time, *values.values()])
    np.savetxt(tmp_path / "noisy.csv", table, delimiter=",", header=header, comments="")
    runs = {"run": ["simulated", "run"], "noisy": ["measured", "simulated"]}
    for name, expected in runs.items():
        words = ["--ghost", tmp_path / "run.csv", "-o", tmp_path / "a.png", "--size", "320x180", "--json", "-"]
        assert patu("render", tmp_path / f"{name}.csv", *words) == 0
        assert json.loads(capsys.readouterr().out)["runs"] == expected


def test_the_line_for_the_viewer_opens_the_same_scene(recording, tmp_path, capsys):
    same = ["--ghost", f"model={recording}", "--mark", "tilt", "--mark", "p2", "--map", "z1=z1"]
    assert patu("render", recording, *same, "-o", tmp_path / "a.png", "--size", "320x180") == 0
    told = next(line for line in capsys.readouterr().out.splitlines() if "To turn it" in line)
    assert f"{shlex.join(['patu', 'render', str(recording), *same, '--open'])} (needs a screen)" in told


def test_command_draws_the_crane_at_its_start_without_a_recording(tmp_path, capsys):
    assert patu("render", "-o", tmp_path / "crane.png", "--crane", "loader", "--size", "320x180") == 0
    assert "patu render --crane loader --open" in capsys.readouterr().out


def test_without_a_run_there_are_no_ghosts(recording, tmp_path, capsys):
    assert patu("render", "--ghost", recording, "-o", tmp_path / "a.png") == 2
    assert "--ghost would change nothing: no recording REC is given" in capsys.readouterr().err


def test_a_map_is_for_the_files_that_need_it(recording, tmp_path):
    """Runs with the crane's own names beside a logger's recording, whichever comes first; else it is for REC."""
    from patu.drawn_runs import read_runs

    z1, z4 = motion().positions.T
    logger, signs = tmp_path / "logger.csv", tmp_path / "map.toml"
    table = np.column_stack([TIME, -np.degrees(z1), np.degrees(z4)])
    np.savetxt(logger, table, delimiter=",", header="Clock[s],Boom[deg],Arm[deg]", comments="")
    signs.write_text('[time]\ncolumn="Clock"\n[z1]\ncolumn="Boom"\nsign=-1\n[z4]\ncolumn="Arm"\n')
    for paths in ([logger, recording], [recording, logger], [logger, logger]):
        for found in read_runs(paths, CRANE, None, signs):
            assert found["z1"].values == pytest.approx(z1, abs=1e-9)
    turned, same = read_runs([recording, recording], CRANE, ["z1=-z1"], None)
    assert turned["z1"].values == pytest.approx(-z1) and same["z1"].values == pytest.approx(z1)
    with pytest.raises(CraneError, match="no column 'Clock'"):
        read_runs([recording], CRANE, None, signs)


@pytest.mark.parametrize("name", MACHINES)
def test_sketch_names_every_frame_point_joint_and_cylinder(name):
    from crane_exudyn.render_frames import sketch

    machine, figure = MACHINES[name].machine, sketch(MACHINES[name])
    whole, *frames = figure.axes
    said = "\n".join(text.get_text() for text in whole.texts)
    assert all(f"{c.name} cylinder" in said for c in machine.cylinders) and all(j.name in said for j in machine.joints)
    assert all(f": {coordinate}" in said for coordinate in machine.independent)
    for body, axes in zip((GROUND, *machine.bodies), frames, strict=True):
        assert axes.get_title(loc="left").startswith(body)
        texts = " ".join(text.get_text() for text in axes.texts)
        points = [n for n, b in zip(machine.point_names, machine.points.values(), strict=True) if b == body]
        assert all(f"{point} (" in texts for point in points) and ("c (" in texts) == (body != GROUND)


@pytest.mark.parametrize("name", MACHINES)
def test_labels_of_a_sketch_do_not_overlap(name):
    from crane_exudyn.render_frames import sketch

    figure = sketch(MACHINES[name])
    figure.canvas.draw()
    for axes in figure.axes:
        boxes = [text.get_window_extent() for text in axes.texts if text.get_text()]
        assert all(axes.bbox.containsx(b.x0) and axes.bbox.containsx(b.x1) for b in boxes)
        over = [(a, b) for i, a in enumerate(boxes) for b in boxes[:i] if a.padded(-1.0).overlaps(b.padded(-1.0))]
        assert not over, axes.get_title(loc="left")


def test_command_draws_the_frames(tmp_path, capsys):
    assert patu("render", "--crane", "loader", "--frames", "-o", tmp_path / "frames.png") == 0
    assert (tmp_path / "frames.png").read_bytes().startswith(b"\x89PNG")
    assert patu("render", "--crane", "loader", "--frames", "-o", tmp_path / "frames.gif") == 2
    assert "--frames draws one picture" in capsys.readouterr().err


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
        (["-o", "a.gif", "--time", "1"], "--time would change nothing: a film"),
        (["-o", "a.png", "--from", "0", "--fps", "3"], "--from, --fps would change nothing: a picture"),
        (["-o", "a.png", "--frames", "--mark", "lift"], "--mark, REC would change nothing: --frames"),
        (["--save-solution", "a.txt", "--size", "320x180"], "--size would change nothing: no picture"),
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
    assert "a picture needs z1 and z4" in capsys.readouterr().err


def test_absolute_outer_angle_is_made_relative():
    channels = {"z1": np.array([0.1, 0.2]), "z4_abs": np.array([-0.5, -0.6]), "u1": np.zeros(2), "u2": np.zeros(2)}
    made = Trajectory.from_recording(Recording.from_arrays("r", np.array([0.0, 1.0]), channels))
    assert made.positions[:, 1] == pytest.approx([-0.6, -0.8])


def test_film_times_keep_pace():
    assert film.times(1.0, 3.0, fps=10.0, speed=5.0) == pytest.approx([1.0, 1.5, 2.0, 2.5, 3.0])
