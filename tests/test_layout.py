"""Layout: the places of a made-up machine, what the PATU's compiled code assumes of them, and that nothing else slices
a state.
"""

import ast
import dataclasses
import math
import re
from graphlib import TopologicalSorter
from pathlib import Path

import numpy as np
import pytest
from made_up import made_up

from crane_exudyn import Crane, CraneError, Recording, channels, hydraulics, plots, reduction
from crane_exudyn.layout import Layout, sensors_of
from validation import phases
from validation.phases import Phase

ROOT = Path(__file__).resolve().parent.parent
#: boom, arm and bucket; the arm's absolute angle is that of the boom and its own
DIGGER = Layout(
    coordinates=("boom", "arm", "bucket"), joints=("J1", "J2", "J3"), bodies=("main_boom", "arm", "bucket"),
    parents=("", "boom", "arm"),
    cylinders=("left", "middle", "right"), sides=(("a1", "b1"), ("a2", "b2"), ("a3", "b3")), loaded=("a1", "b2", "a3"),
    lengths=("x1", "x2", "x3"), commands=("c1", "c2", "c3"), voltages=("V1", "V2", "V3"),
    driven=("boom", "bucket", "arm"), added=("swing",),
)  # fmt: skip


def test_places_in_a_state_of_another_machine():
    x = np.array(DIGGER.all_states)
    assert list(x[DIGGER.positions]) == ["boom", "arm", "bucket"] and list(x[DIGGER.velocities]) == [
        "dboom",
        "darm",
        "dbucket",
    ]
    assert list(x[DIGGER.motion]) == [*x[:6]] and list(x[DIGGER.extra]) == ["swing"]
    assert tuple(x[DIGGER.pressures]) == DIGGER.chambers == ("a1", "b1", "a2", "b2", "a3", "b3")
    assert tuple(x[DIGGER.basic]) == DIGGER.states and [DIGGER.index(n) for n in x] == list(range(13))
    assert [tuple(x[DIGGER.pressures_of(c)]) for c in range(3)] == list(DIGGER.sides)
    assert DIGGER.chambers[DIGGER.chambers_of(1)] == ("a2", "b2")
    with pytest.raises(ValueError, match="not in tuple"):
        DIGGER.index("z1")


def test_places_in_the_inputs_of_another_machine():
    w = np.array(DIGGER.all_inputs)
    assert list(w[DIGGER.spools]) == ["V1", "V2", "V3"] and list(w[DIGGER.supplies]) == ["pp", "pt"]
    assert tuple(w[DIGGER.driving]) == DIGGER.inputs and len(DIGGER.closed) == 5 and math.isnan(DIGGER.closed[3])
    assert tuple(w[5:]) == DIGGER.disturbances
    assert DIGGER.disturbances[:5] == ("torque.J1", "torque.J2", "torque.J3", "force.x", "force.y")
    assert DIGGER.disturbances[5:] == tuple(f"flow.{n}" for n in DIGGER.chambers)


def test_cylinders_and_sensors_of_another_machine():
    assert DIGGER.side_of("b2") == "middle, rod side" and DIGGER.cylinder_of("b2") == 1
    assert DIGGER.cylinder_of("bucket") == 1 and DIGGER.absolute("bucket") == ("boom", "arm", "bucket")
    sensors = {s.name: s for s in sensors_of(DIGGER)}
    assert list(sensors)[:5] == ["boom", "arm", "arm_abs", "bucket", "bucket_abs"] and "boom_abs" not in sensors
    assert sensors["dbucket_abs"].shows == ("dboom", "darm", "dbucket") and not sensors["dbucket_abs"].place
    assert sensors["arm_abs"].place == "arm" and sensors["arm"].cylinder == 2 and sensors["x3"].cylinder == 2


def test_units_and_sizes_of_another_machine():
    lay = made_up().layout
    assert [lay.unit_of(n) for n in (*lay.coordinates, *lay.rates)] == ["rad", "m", "rad", "rad/s", "m/s", "rad/s"]
    assert lay.sized(lay.equations, {"N*m": 1.0, "N": 2.0, "m^3/s": 3.0}) == (1.0, 2.0, 1.0, *[3.0] * 6)
    assert lay.carriers("bucket") == ("boom",) == lay.carriers("reach") and lay.absolute("reach") == ("boom",)
    assert list(channels.of(lay))[:8] == ["c1", "c2", "c3", "V1", "V2", "V3", "boom", "reach"]
    words = plots.shown("reach", layout=lay)
    assert (words.words, words.unit) == ("arm against boom", "mm")


@pytest.mark.parametrize("ending", [".csv", ".csv.gz", ".parquet", ".mat"])
def test_a_recording_of_another_machine_comes_back_as_it_was(tmp_path, ending):
    lay, time = made_up().layout, np.linspace(0.0, 1.0, 50)
    names = [n for n in channels.of(lay) if n not in lay.voltages]
    values = {n: np.sin(time + i) for i, n in enumerate(names)}
    recording = Recording.from_arrays("run", time, values, layout=lay)
    recording.save(tmp_path / f"run{ending}")
    again = Recording.load(tmp_path / f"run{ending}", layout=lay)
    assert tuple(again.channels) == tuple(recording.channels) == tuple(names) and again.sensors == tuple(lay.sensors)
    for name, channel in recording.channels.items():
        assert np.array_equal(again[name].values, channel.values) and again[name].unit == channel.unit
    assert again.commands(made_up())[1].shape == (50, 3)
    assert np.array_equal(again.noise_free(), recording.noise_free())


def test_a_recording_read_with_another_machines_names_is_refused(tmp_path):
    time = np.linspace(0.0, 1.0, 50)
    recording = Recording.from_arrays("run", time, dict.fromkeys(("u1", "u2", "z1"), 0.1 * time))
    with pytest.raises(CraneError, match=r"layout=crane\.layout"):
        recording.commands(made_up())
    recording.save(tmp_path / "run.csv")
    with pytest.raises(CraneError, match=r"found no known channel .* c1, c2, c3, .*--map boom=BoomAngle\[deg\]"):
        Recording.load(tmp_path / "run.csv", layout=made_up().layout)


def test_phases_of_machines_with_one_cylinder_and_with_three():
    three = made_up()
    one = dataclasses.replace(DIGGER, cylinders=("left",), sides=(("a1", "b1"),), commands=("c1",), voltages=("V1",))
    assert phases.kinds(one) == (
        "rest",
        "left extending",
        "left retracting",
        "reversal",
        "low pressure",
        "end of stroke",
    )
    assert Phase("rest", 0, 1, 0.0, 1.0, (0,), one).words.endswith("while the valve is closed")
    lay = three.layout
    assert "several moving" in phases.kinds(lay)
    words = Phase("several moving", 0, 1, 0.0, 1.0, (1, 0, -1), lay).words
    assert words.endswith("while the hoist cylinder extends and the curl cylinder retracts")
    assert Phase("curl extending", 0, 1, 0.0, 1.0, (0, 0, 1), lay).words.endswith("while the curl cylinder extends")


def test_compiled_code_has_the_order_of_the_layout():
    layout = Crane.load("patu655").layout
    n = len(layout.cylinders)
    assert layout.all_inputs[hydraulics.flow_disturbances(n) :] == layout.flows
    assert layout.all_inputs[n + 2 :][:n] == layout.torques and layout.all_inputs[2 * n + 2] == "force.x"
    assert [reduction.position_place(n, i) for i in range(n)] == [layout.index(z) for z in layout.coordinates]
    assert [layout.all_states[reduction.rate_place(n, i)] for i in range(n + 1)] == [*layout.rates, "dtheta"]


#: what slices a state or the inputs, or counts their parts
SLICE = re.compile(
    r"[:.], ?(:[248]|2:4?|4:8?|8:)\]|\b(x|x0|state|mean|deviation|w|lower|upper|out|held|p)\[(:[248]|2:4?|4:8?|8:?|9)\]"
    r"|(range|slice)\((0, 2|2, 4|4, 8)\)|> 8\b|4 <= \w+(\[\w\])? < 8\b|== (8|10)\b|for (?!_|side\b|axis\b)\w+ in "
    r"range\([24]\)"
)
LAYOUT = Crane.load("patu655").layout
NAMES = {
    *LAYOUT.states, *LAYOUT.joints, *LAYOUT.bodies, *LAYOUT.cylinders, *LAYOUT.lengths, *LAYOUT.commands,
    *LAYOUT.voltages,
    *LAYOUT.torques, *LAYOUT.flows, *(s.name for s in sensors_of(LAYOUT)),
}  # fmt: skip
#: what is the PATU's own: the paper, recordings drawn for it
OWN = {
    "patu/paper.py", "validation/paper.py", "validation/paper_figures.py", "validation/wrong_models.py",
    "validation/hidden.py", "validation/hidden_plant.py", "validation/payloads.py",
}  # fmt: skip
#: what may fall back on the layout of patu655: where a user names no crane, and the PATU's own studies
DEFAULTS = {
    "crane_exudyn/machine_toml.py",
    "crane_exudyn/recording.py",
    "crane_exudyn/plots.py",
    "ukf/estimate.py",
    "validation/hidden.py",
    "validation/study.py",
}


def sources() -> dict[str, str]:
    """Return the package's sources by path."""
    files = [f for folder in ("crane_exudyn", "ukf", "validation", "patu") for f in (ROOT / folder).rglob("*.py")]
    return {str(f.relative_to(ROOT)): f.read_text(encoding="utf-8") for f in files}


def _words_of(node: ast.AST) -> set[object]:
    """Return what a node of a syntax tree calls by name: a constant, a variable, an attribute, an argument."""
    names = {getattr(node, field, None) for field in ("id", "attr", "arg")} - set(LAYOUT.joints)
    return names | {node.value} if isinstance(node, ast.Constant) else names


def _knows_one_machine(text: str) -> bool:
    """Return whether a source slices a state by numbers, or calls one of the PATU's channels, cylinders or bodies by
    its name.
    """
    return bool(SLICE.search(text)) or any(_words_of(node) & NAMES for node in ast.walk(ast.parse(text)))


def test_only_listed_files_know_where_things_stand():
    found = {path for path, text in sources().items() if _knows_one_machine(text)}
    assert found == OWN


def test_only_listed_files_fall_back_on_one_machine():
    assert {path for path, text in sources().items() if "usual_layout" in text} == DEFAULTS


def _imports(path: str, text: str, known: set[str]) -> set[str]:
    """Return which known files a source takes something from, at whatever place in it, or for its types alone."""
    found = set()
    for node in (n for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom)):
        base = (Path(path).parents[node.level - 1] if node.level else Path()) / (node.module or "").replace(".", "/")
        for name in node.names:
            files = (f"{base}/{name.name}.py", f"{base}.py", f"{base}/__init__.py")
            found |= {next((f for f in files if f in known), path)}
    return found - {path}


def test_files_import_each_other_one_way() -> None:
    files = sources()
    used = {path: _imports(path, text, set(files)) for path, text in files.items()}
    assert sum(map(len, used.values())) > 500
    TopologicalSorter(used).prepare()  # raises where there is a circle


def test_packages_import_each_other_one_way() -> None:
    order = ("crane_exudyn", "ukf", "validation", "patu")
    for path, text in sources().items():
        above = order[order.index(path.partition("/")[0]) + 1 :]
        names = {node.value for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Constant)}
        names |= {n.module for n in ast.walk(ast.parse(text)) if isinstance(n, ast.ImportFrom) and not n.level}
        assert not [n for n in names if isinstance(n, str) and n.partition(".")[0] in above and "." in n], path


@pytest.mark.parametrize(
    "line",
    [
        "y = x[4:8]",
        "y = states[:, :2]",
        "y = x[..., 4:8]",
        "y = w[2:]",
        'y = run["z4_abs"]',
        "n = nx == 10",
        "def f(z1): pass",
    ],
)
def test_what_is_looked_for_is_found(line):
    assert _knows_one_machine(line) and not _knows_one_machine(
        '"""Give z1 and z4."""\ny = found[:2], names[:, layout.pressures]'
    )
