"""Machines as data: both engines agree on built-in and random ones, and what is impossible is refused with its mend."""

import re
import tomllib
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest
from random_machine import random_machine

from crane_exudyn.crane import Crane, built_in
from crane_exudyn.effects import registry
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.machine import Cylinder, Joint, Machine
from crane_exudyn.pose import shown_pose
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import initial_state, simulate
from crane_exudyn.static_start import beyond_pump, static_start
from crane_exudyn.trajectory import Trajectory
from validation import crosscheck_cases as cases
from validation.crosscheck_quantities import compare_static_starts, compare_terms
from validation.semi_recursive import SemiRecursiveEngine

SEEDS = range(1, 21)


def assert_agree(crane, count, seed=0):
    """Every quantity and the static starts agree at random states, and a short run from the start does."""
    first, second = ExudynEngine(crane), SemiRecursiveEngine(crane)
    states = cases.random_states(crane, count, np.random.default_rng(seed))
    quantities = [*compare_terms(first, second, states), *compare_static_starts(first, second, states)]
    assert [(q.name, q.max_abs, q.relative) for q in quantities if not q.ok] == []
    time, w = (a[:201] for a in cases.exciting(crane))
    w[:, crane.layout.spools] += 0.2
    x0 = second.static_start(*crane.initial.pose)
    apart = np.abs(first.simulate(x0, time, w) - second.simulate(x0, time, w)).max(axis=0)
    assert apart[crane.layout.positions].max() < 1e-6 and apart[crane.layout.pressures].max() < 1e4


@pytest.mark.parametrize("name", built_in())
def test_engines_agree_on_a_built_in_machine(name):
    assert_agree(Crane.load(name), 20)


@pytest.mark.parametrize("seed", SEEDS)
def test_engines_agree_on_a_machine_drawn_at_random(seed):
    assert_agree(random_machine(seed), 6, seed)


def test_random_machines_have_what_machines_may_have():
    machines = [random_machine(seed).machine for seed in SEEDS]
    assert {len(m.cylinders) for m in machines} == {1, 2, 3, 4} and {len(m.loops) for m in machines} == {0, 1, 2}
    slides = [any(j.kind == "prismatic" for j in m.joints) for m in machines]
    assert any(slides) and not all(slides) and any(m.payload == ("", "") for m in machines)


def test_a_machine_of_an_earlier_file_is_the_patu():
    file = tomllib.loads((resources.files("crane_exudyn.data") / "patu655.toml").read_text(encoding="utf-8"))
    for key in ("joint", "independent"):
        del file[key]
    for table, keys in (("payload", ("body", "at")),):
        for key in keys:
            del file[table][key]
    for cylinder in file["cylinders"].values():
        for key in ("bodies", "rod_end" if cylinder["rod_end"] == "C" else "", "loaded"):
            cylinder.pop(key, None)
    assert Crane.from_document(file, "earlier.toml") == Crane.load("patu655")


def file_of(name):
    return tomllib.loads((resources.files("crane_exudyn.data") / f"{name}.toml").read_text(encoding="utf-8"))


def _drop(name):
    return lambda f: f["joint"].remove(next(j for j in f["joint"] if j["name"] == name))


def _change(name, **keys):
    return lambda f: next(j for j in f["joint"] if j["name"] == name).update(keys)


def _side_by_side(f):
    """Hang rocker and link each on a body of its own, joined by H."""
    H, K = (next(j for j in f["joint"] if j["name"] == name) for name in "HK")
    del H["coordinate"], K["bend"]
    H.update(on="H_link")
    K.update(bodies=["bucket", "link"], at="K", on="K_link", coordinate="link")


REFUSED = {
    "dependents side by side": (
        _side_by_side,
        r"joint 'H' closes a loop.*Close it at joint 'J' instead: bodies = \['link', 'rocker'\]",
    ),
    "hangs on nothing": (_drop("L"), "body 'bucket' hangs on nothing"),
    "carried twice": (_change("K", coordinate="k"), "carried by two joints, 'L' and 'K'.*closes a loop"),
    "carried by itself": (_change("A", bodies=["bucket", "arm"]), "is carried by itself"),
    "unknown body": (_change("A", bodies=["boom", "amr"]), "joint 'A': bodies = 'amr' is not known.*arm"),
    "unknown key": (_change("A", coordinates="x"), "joint 'A': unknown key 'coordinates'.*coordinate"),
    "loop without pins": (
        lambda f: next(j for j in f["joint"] if j["name"] == "K").pop("on"),
        "closes a loop.*at and on",
    ),
    "too many independent": (lambda f: f["independent"].append("link"), "should be 3 of the coordinates"),
    "wrong dependents": (lambda f: f.update(independent=["boom", "arm", "rocker"]), "dependent bodies are not two"),
    "two drives": (
        lambda f: f["cylinders"]["bucket"].update(bodies=["boom", "arm"], rod_end=[0.1, 0.2]),
        "two drives for one freedom",
    ),
    "drives nothing": (lambda f: f["cylinders"]["arm"].update(bodies=["boom", "boom"]), "a cylinder joins two bodies"),
    "nothing drives": (lambda f: f["cylinders"].pop("bucket"), "nothing drives the coordinate 'bucket'"),
    "no such pin": (
        lambda f: f["cylinders"]["bucket"].update(rod_end="K"),
        "cylinders.bucket.rod_end = 'K' is no point of rocker",
    ),
    "payload nowhere": (lambda f: f["payload"].update(body="bukcet"), "payload.body = 'bukcet' is not known.*bucket"),
    "a body like the ground": (lambda f: f["bodies"].update(ground=f["bodies"]["boom"]), "a body is named 'ground'"),
    "no joint": (lambda f: f.pop("joint"), r"there is no \[\[joint\]\], so the structure of the machine"),
    "loop not closed": (
        _drop("K"),
        "rocker and link form an open chain: rocker, link are not independent .*no joint closes a loop",
    ),
    "too few independent": (lambda f: f["independent"].remove("bucket"), "bucket hangs freely: bucket is not indep"),
    "loop without at": (
        lambda f: next(j for j in f["joint"] if j["name"] == "K").pop("at"),
        "joint 'K' closes a loop.* on = 'K' is that on bucket. Give at, too, a point of its own on link",
    ),
    "point of a typo": (
        lambda f: f["payload"].update(at="siol"),
        r"payload\.at = 'siol', but \[joints\] has no point 'siol'\. Did you mean \"soil\"",
    ),
    "pin of a typo": (_change("K", on="K_"), r"joint 'K' names 'K_', but \[joints\] has no point 'K_'"),
    "pin left out": (
        lambda f: f["joints"].pop("A"),
        r"joint 'A' has its pin at the point of its name, but \[joints\] has no point 'A'\. Give it",
    ),
    "point of nothing": (
        lambda f: f["joints"].update(tooth=[0.1, 0.2]),
        r"joints\.tooth is not used by anything.*end of a cylinder or the payload's at",
    ),
    "a direction to turn": (_change("A", direction="30 deg"), "joint 'A': direction .* Add kind = \"prismatic\""),
    "a comma in a heading": (
        lambda f: f["cylinders"]["arm"].update(chambers=["p3,a", "p4"]),
        "'p3,a' cannot name a channel",
    ),
    "a key behind a table": (
        lambda f: f["supply"].update(independent=f.pop("independent")),
        "independent stands in a table, as supply.independent. Move it above the first table",
    ),
    "degrees without unit": (lambda f: f["initial"].update(boom=-17), 'initial.boom = -17 .* write "-17 deg"'),
    "same channel twice": (lambda f: f["cylinders"]["arm"].update(length="s1"), "two things are named channel 's1'"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_an_impossible_machine_is_refused(case):
    change, message = REFUSED[case]
    file = file_of("excavator")
    change(file)
    with pytest.raises(CraneError, match=message):
        Crane.from_document(file, "mine.toml")


@pytest.mark.parametrize("ends", [("outer_boom", "bracket_1"), ("outer_boom", "bracket_2"), ("bracket_2", "lift_boom")])
def test_a_cylinder_inside_a_loop_drives_what_turns_the_loop(ends):
    file = file_of("patu655")
    file["cylinders"]["tilt"] = {"bodies": [*ends], "base": [0.5, 0.4], "rod_end": [-0.2, 0.3]} | {
        k: v for k, v in file["cylinders"]["tilt"].items() if k not in ("bodies", "base", "rod_end")
    }
    crane = Crane.from_document(file, "inside.toml")
    assert crane.layout.driven == ("z1", "z4")
    assert np.isfinite(static_start(crane, *crane.initial.pose)).all()


def chain(*ends):
    """Return a chain of revolute bodies 0, 1, … with cylinders between bodies by number, -1 for the ground."""
    names = dict(enumerate("abcd")) | {-1: "ground"}
    bodies = range(max(map(max, ends)) + 1)
    joints = (Joint(f"J{k}", "revolute", names[k - 1], names[k], f"joints.J{k}", coordinate=f"q{k}") for k in bodies)
    cylinders = (
        Cylinder(f"c{i}", (names[a], names[b]), ("", ""), (f"p{i}", f"r{i}"), f"p{i}", f"s{i}", f"u{i}", f"U{i}")
        for i, (a, b) in enumerate(ends)
    )
    names_of_all = tuple(names[k] for k in bodies), tuple(joints), tuple(f"q{k}" for k in bodies), tuple(cylinders)
    return Machine(*names_of_all, payload=("", ""), points={})


@pytest.mark.parametrize(
    ("ends", "driven"),
    [
        (((-1, 0), (0, 1), (1, 2)), ("q0", "q1", "q2")),
        (((-1, 1), (0, 2), (1, 2)), ("q0", "q1", "q2")),  # the second takes the only one that the first can do without
        (((-1, 1), (0, 2), (1, 3), (2, 3)), ("q0", "q1", "q2", "q3")),
        (((-1, 0), (-1, 0), (1, 2)), ("q0", "", "q2")),
    ],
)
def test_each_cylinder_drives_a_coordinate_of_its_own_where_that_is_possible(ends, driven):
    assert chain(*ends).driven == driven


def test_joints_may_be_listed_outer_first():
    file = file_of("patu655")
    file["joint"].reverse()
    crane, given = Crane.from_document(file, "reversed.toml"), Crane.load("patu655")
    assert crane.layout == given.layout and crane.initial == given.initial
    shown = {"z1": 0.3, "z4_abs": -0.1}
    assert shown_pose(crane, shown) == pytest.approx([0.3, -0.4])
    recorded = Recording.from_arrays(
        "r", np.arange(2.0), {n: np.full(2, v) for n, v in shown.items()}, layout=crane.layout
    )
    assert Trajectory.from_recording(recorded).positions[0] == pytest.approx([0.3, -0.4])


def without_payload():
    file = file_of("loader")
    for key in ("body", "at"):
        del file["payload"][key]
    del file["joints"]["bucket"]
    return file


def test_a_payload_that_nothing_carries_is_refused():
    file = without_payload()
    with pytest.raises(CraneError, match=r"payload.mass = 400 kg, but nothing carries a payload: give body and at"):
        Crane.from_document(file, "mine.toml")
    file["payload"] = dict.fromkeys(("mass", "width", "height"), 0.0)  # as a machine without one is written
    crane = Crane.from_document(file, "mine.toml")
    assert Crane.from_document(tomllib.loads(replace(crane, text="").to_toml()), "mine.toml") == crane
    with pytest.raises(CraneError, match="nothing carries a payload"):
        crane.with_parameters({"payload.mass": 50.0})


@pytest.mark.parametrize("name", ["tip_contact_force", "payload_change", "payload_swing"])
def test_an_effect_on_a_payload_acts_on_no_machine_without_one(name):
    crane = Crane.from_document(without_payload() | {"payload": {}}, "mine.toml")
    assert name in registry.all_keys(Crane.load("loader").layout) and name not in registry.all_keys(crane.layout)
    with pytest.raises(CraneError, match=f"{name}.* acts on a payload, and the machine has none"):
        crane.with_effect(name, {})


def test_a_pose_that_cannot_be_is_refused_by_name():
    crane = Crane.load("excavator").with_parameters({"joints.H.x": 0.05, "joints.K_link.x": 0.05})
    with pytest.raises(
        CraneError, match="rocker and link are too short or too long to close the loop over the joints J-H-K"
    ):
        ExudynEngine(crane).static_start(0.4, -1.3, -0.9)


@pytest.mark.parametrize("make", [ExudynEngine, SemiRecursiveEngine])
@pytest.mark.parametrize(("name", "value"), [("chamber_range", 0.1), ("empty_length", 2.72)])
def test_a_start_in_which_a_cylinder_cannot_be_that_long_is_refused_with_its_limits(make, name, value):
    crane = Crane.load("loader").with_parameters({f"cylinders.lift.{name}": value})
    with pytest.raises(
        CraneError, match=r"\[initial\] boom = -5\.00 deg: the lift cylinder would be 0\.8531 m"
    ) as found:
        initial_state(crane, make(crane))
    assert f"cylinders.lift.empty_length and chamber_range let it be {crane['cylinders.lift.empty_length']:.4f}" in str(
        found.value
    )


@pytest.mark.parametrize("make", [ExudynEngine, SemiRecursiveEngine])
def test_a_start_below_vapour_pressure_names_key_and_cylinder(make):
    loader = Crane.load("loader")
    crane = replace(loader, initial=replace(loader.initial, less_loaded_pressure=(-12e5,)))
    with pytest.raises(CraneError, match=r"initial\.less_loaded_pressure of -12 bar for the lift cylinder.*here 0 bar"):
        initial_state(crane, make(crane))


STILL = {"u1": np.zeros(3)}


@pytest.mark.parametrize(
    ("changes", "needed"),
    [
        ({"supply.pump_pressure": 20e5}, r"lift needs \d+\.?\d* bar in p1 .* the pump gives 20 bar"),
        ({"payload.mass": 8000.0}, "bar in p1 to lift the load, and the pump gives 180 bar: look at masses"),
        ({"bodies.boom.com.x": 40.0}, "boom = -5.00 deg: lift needs"),
        ({}, ""),
    ],
)
def test_a_load_that_the_pump_cannot_lift_is_told_before_the_run(changes, needed, caplog):
    crane = Crane.load("loader").with_parameters(changes)
    still = Recording.from_arrays("still", np.array([0.0, 0.01, 0.02]), STILL, layout=crane.layout)
    simulate(crane, still, engine="semi-recursive")
    assert len(caplog.records) == bool(needed)
    assert not needed or re.search(needed, caplog.messages[0])


def test_what_a_pump_can_lift_does_not_hang_on_the_pressure_behind_the_piston():
    """The less loaded chamber empties into the tank first."""
    crane = Crane.load("loader")
    for low in (1e5, 150e5):
        start = static_start(crane, *crane.initial.pose, less_loaded=low)
        assert beyond_pump(crane, start) == ""
    assert start[crane.layout.pressures].max() > crane["supply.pump_pressure"]


@pytest.mark.parametrize("make", [ExudynEngine, SemiRecursiveEngine])
@pytest.mark.parametrize("name", ["loader", "excavator", "patu655-lab"])
def test_the_less_loaded_chambers_begin_at_the_crane_files_pressure(make, name):
    crane = Crane.load(name)
    start = make(crane).static_start(*crane.initial.pose)
    assert np.array_equal(start, initial_state(crane, make(crane)))
    lowest = start[crane.layout.pressures].reshape(-1, 2).min(axis=1)
    assert lowest == pytest.approx(np.broadcast_to(crane.initial.less_loaded_pressure, lowest.shape))


@pytest.mark.parametrize("make", [ExudynEngine, SemiRecursiveEngine])
def test_voids_are_told_as_a_gauge_shows_them(make):
    """What a state remembers of a void is no pressure."""
    crane = Crane.load("loader").with_parameters({"bodies.boom.mass": 24e3})
    commands = {"u1": np.array([0.0, -1.0, -1.0])}
    retracting = Recording.from_arrays("r", np.array([0.0, 0.5, 6.0]), commands, layout=crane.layout)
    with pytest.raises(CraneError, match="stroke") as ended:
        simulate(crane, retracting, engine=make(crane), step=4e-3)
    assert not re.search(r"p[12] = -\d", str(ended.value))
