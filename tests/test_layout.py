"""Layout: the places of a made-up machine, what the PATU's compiled code assumes of them, and that nothing else slices a state."""

import math

import numpy as np
import pytest

from crane_exudyn import Crane, hydraulics
from crane_exudyn.layout import Layout
from crane_exudyn.sensors import of

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
