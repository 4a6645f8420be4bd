"""Layout: the places of a made-up machine, what the PATU's compiled code assumes of them, and that nothing else slices a state."""

import ast
import math
import re
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn import Crane, hydraulics
from crane_exudyn.layout import Layout
from crane_exudyn.sensors import of

ROOT = Path(__file__).resolve().parent.parent
#: boom, arm and bucket; the arm's absolute angle is that of the boom and its own
DIGGER = Layout(
    coordinates=("boom", "arm", "bucket"), joints=("J1", "J2", "J3"), bodies=("main_boom", "arm", "bucket"), parents=("", "boom", "arm"),
    cylinders=("left", "middle", "right"), sides=(("a1", "b1"), ("a2", "b2"), ("a3", "b3")), loaded=("a1", "b2", "a3"),
    lengths=("x1", "x2", "x3"), commands=("c1", "c2", "c3"), voltages=("V1", "V2", "V3"), driven=("boom", "bucket", "arm"), added=("swing",),
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
    sensors = {s.name: s for s in of(DIGGER)}
    assert list(sensors)[:5] == ["boom", "arm", "arm_abs", "bucket", "bucket_abs"] and "boom_abs" not in sensors
    assert sensors["dbucket_abs"].shows == ("dboom", "darm", "dbucket") and not sensors["dbucket_abs"].place
    assert sensors["arm_abs"].place == "arm" and sensors["arm"].cylinder == 2 and sensors["x3"].cylinder == 2


def test_compiled_code_has_the_order_of_the_layout():
    layout = Crane.load("patu655").layout
    assert layout.disturbances == hydraulics.DISTURBANCES and len(layout.all_inputs) == hydraulics.N_W
    at = [layout.all_inputs.index(names[0]) for names in (layout.torques, ("force.x",), layout.flows)]
    assert at == [hydraulics.TORQUE, hydraulics.FORCE, hydraulics.FLOW]


#: what slices a state or the inputs, or counts their parts
SLICE = re.compile(
    r"[:.], ?(:[248]|2:4?|4:8?|8:)\]|\b(x|x0|state|mean|deviation|w|lower|upper|out|held|p)\[(:[248]|2:4?|4:8?|8:?|9)\]"
    r"|(range|slice)\((0, 2|2, 4|4, 8)\)|> 8\b|4 <= \w+(\[\w\])? < 8\b|== (8|10)\b|for (?!_)\w+ in range\([24]\)"
)
LAYOUT = Crane.load("patu655").layout
NAMES = {
    *LAYOUT.states, *LAYOUT.joints, *LAYOUT.bodies, *LAYOUT.cylinders, *LAYOUT.lengths, *LAYOUT.commands, *LAYOUT.voltages,
    *LAYOUT.torques, *LAYOUT.flows, *(s.name for s in of(LAYOUT)),
}  # fmt: skip
#: the compiled engines, which know one linkage
COMPILED = {
    "crane_exudyn/geometry.py", "crane_exudyn/hydraulics.py", "crane_exudyn/mechanism.py", "crane_exudyn/reduction.py",
    "crane_exudyn/trapezoidal.py", "validation/semi_recursive/equations.py", "validation/semi_recursive/kernel.py",
    "validation/semi_recursive/sensitivity.py", "validation/semi_recursive/terms.py",
}  # fmt: skip
#: what is the PATU's own: its names, the paper, recordings drawn for it
OWN = {
    "crane_exudyn/parameters.py", "patu/paper.py", "validation/paper.py", "validation/paper_figures.py", "validation/hidden.py",
    "validation/hidden_plant.py",
}  # fmt: skip
#: what still knows one machine: poses given as z1 and z4, how the linkage is drawn, manoeuvres in words
LATER = {
    "crane_exudyn/crane.py", "crane_exudyn/crane_toml.py", "crane_exudyn/engine.py", "crane_exudyn/render.py", "crane_exudyn/render_shapes.py",
    "crane_exudyn/statics.py", "validation/crosscheck.py", "validation/search/manoeuvre.py",
    "validation/semi_recursive/engine.py",
}  # fmt: skip


def _words_of(node: ast.AST) -> set[object]:
    """Return what a node of a syntax tree calls by name: a constant, a variable, an attribute, an argument."""
    names = {getattr(node, field, None) for field in ("id", "attr", "arg")} - set(LAYOUT.joints)
    return names | {node.value} if isinstance(node, ast.Constant) else names


def _knows_one_machine(text: str) -> bool:
    """Return whether a source slices a state by numbers, or calls one of the PATU's channels, cylinders or bodies by its name."""
    return bool(SLICE.search(text)) or any(_words_of(node) & NAMES for node in ast.walk(ast.parse(text)))


def test_only_listed_files_know_where_things_stand():
    files = [f for folder in ("crane_exudyn", "ukf", "validation", "patu") for f in (ROOT / folder).rglob("*.py")]
    found = {str(f.relative_to(ROOT)) for f in files if _knows_one_machine(f.read_text(encoding="utf-8"))}
    assert found == COMPILED | OWN | LATER


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
