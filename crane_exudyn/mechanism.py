"""The crane as an Exudyn system: planar rigid bodies in redundant coordinates, joints, hydraulic cylinders, user functions.

`build` adds one or more cranes to a main system, also to one of your own: add your own objects to it, assemble and call
`mbs.SolveDynamic` as with any Exudyn model. Per crane it adds

- four rigid bodies with nodes at their centres of mass (12 coordinates); a payload that is fixed to E is part of the outer
  boom's inertia; one on a pendulum is a mass point at a constant distance from E;
- revolute joints at O, B, C, A, D, which close the loop A-B-C-D (10 equations);
- weights as mass-proportional loads;
- two hydraulic actuators on nodes with two pressures each, which give the force of the pressures. Their own valve and
  compression equations are switched off, since those know neither laminar flow nor four edges nor effects;
- one generic ODE1 object for the pressures of all cranes, whose user function is (34) in `hydraulics.py`;
- one generic ODE2 object for all other forces of all cranes: friction (19), effects at cylinders and joints.

Coordinates are absolute: the reference coordinates of the nodes are zero.
"""

from __future__ import annotations

import contextlib
import io
import sys
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

if "exudyn" not in sys.modules and not hasattr(sys, "exudynFast"):
    sys.exudynFast = True  # type: ignore[attr-defined]  # the build without range checks; read when exudyn is imported
with contextlib.redirect_stdout(io.StringIO()):  # it announces itself, which would spoil a JSON on standard output
    import exudyn as exu
    import exudyn.itemInterface as items

from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from .compiled import njit
from .crane import Crane
from .effects import hooks
from .errors import CraneError
from .parameters import BODIES, CYLINDER, CYLINDERS, GRAVITY, N_CYLINDER, PAYLOAD

#: bulk modulus in Pa that removes the actuators' own compression flow; it cannot be zero
_NO_STIFFNESS = 1e-200
#: joints in the order of reduction.JOINT_*: body (or ground, -1) and point on either side
_JOINTS = (
    ("O", -1, geo.O, 0, None),
    ("B", 0, geo.B, 1, None),
    ("C", 1, geo.C, 2, None),
    ("A", 0, geo.A, 3, None),
    ("D", 2, geo.D_BRACKET, 3, geo.D),
)


@dataclass
class Plant:
    """Cranes in an Exudyn system, with the item numbers to reach them.

    Attributes:
        crane: the description that all of them share.
        size: how many cranes there are; per crane the lists below have one entry.
        bodies: object numbers by name of parameters.BODIES (and "payload" on a pendulum).
        nodes: node numbers likewise.
        joints: object numbers by joint name.
        actuators: object numbers of the lift and the tilt cylinder.
        pressure_nodes: node numbers of the lift's and the tilt's pressures.
        inputs: (size, 4) rows [U1 U2 pp pt] that the user functions read; NaN means the crane's own supply.
        input_function: if given, called with the time in s, returns what `inputs` is to hold.
        inertia: (5, 4) masses, centres and inertias that the system was built with.
    """

    crane: Crane
    size: int
    P: np.ndarray
    E: np.ndarray
    inertia: np.ndarray
    payload_mass: float
    inputs: np.ndarray
    input_function: Callable[[float], np.ndarray] | None = None
    bodies: list[dict[str, int]] = field(default_factory=list)
    nodes: list[dict[str, int]] = field(default_factory=list)
    joints: list[dict[str, int]] = field(default_factory=list)
    actuators: list[tuple[int, int]] = field(default_factory=list)
    pressure_nodes: list[tuple[int, int]] = field(default_factory=list)
    first_ode2: int = 0
    first_ode1: int = 0

    @property
    def coordinates(self) -> int:
        """Number of redundant coordinates per crane: 12, or 14 with a payload on a pendulum."""
        return 14 if self.inertia[4, red.MASS] > 0.0 else 12

    @property
    def joint_rows(self) -> int:
        """Number of joint equations per crane."""
        return self.coordinates - 2 if self.coordinates == 12 else 11

    def inputs_at(self, time: float) -> np.ndarray:
        """Return the inputs (size, 4) at a time in s."""
        if self.input_function is not None:
            self.inputs[...] = self.input_function(time)
        return self.inputs


def payload_at(crane: Crane, time: float) -> float:
    """Return the mass of the payload in kg at a time in s."""
    return float(hooks.payload_mass(crane.effect_vector(), time, crane["payload.mass"]))


def build(
    mbs: Any,
    crane: Crane,
    *,
    states: np.ndarray | None = None,
    inputs: np.ndarray | Callable[[float], np.ndarray] | None = None,
    time: float = 0.0,
) -> Plant:
    """Add cranes to an Exudyn main system (before `mbs.Assemble()`) and return where they are.

    Args:
        mbs: exudyn.MainSystem.
        crane: what to build.
        states: (nx,) or (n, nx) initial states, one crane each; default: the crane's start angles at 20 bar everywhere.
        inputs: w = [U1 U2 pp pt], (4,) or (n, 4), or a function of time that returns one; default: valves closed.
        time: the payload has the mass of this time.

    Raises:
        CraneError: a pose that cannot be reached, or a payload on a pendulum that has no mass.
    """
    rows = np.atleast_2d(start_pose(crane) if states is None else np.asarray(states, dtype=float))
    plant = _plant(crane, len(rows), inputs, time)
    ground = mbs.AddObject(items.ObjectGround())
    for row in rows:
        _add_crane(mbs, plant, ground, row)
    _add_user_functions(mbs, plant)
    return plant


def start_pose(crane: Crane) -> np.ndarray:
    swing = [0.0, 0.0] if hooks.pendulum(crane.effect_vector())[0] > 0.0 else []
    return np.array([crane.initial.z1, crane.initial.z4, 0.0, 0.0, *[20e5] * 4, *swing])


def _plant(crane: Crane, size: int, inputs: Any, time: float) -> Plant:
    P, E = crane.parameter_vector(), crane.effect_vector()
    inertia, mass = np.zeros((5, 4)), payload_at(crane, time)
    if mass < 0.0 or (mass == 0.0 and hooks.pendulum(E)[0] > 0.0):
        raise CraneError(
            f"{crane.name}: the payload has a mass of {mass:g} kg at t = {time:g} s. A mass cannot be negative, and one that "
            "swings cannot be zero: mend payload.mass or the effect payload_change, or remove payload_swing."
        )
    red.inertias(P, E, time, inertia)
    closed = np.array([0.0, 0.0, np.nan, np.nan])
    function = inputs if callable(inputs) else None
    first = function(time) if function else (closed if inputs is None else inputs)
    held = np.array(np.broadcast_to(np.asarray(first, dtype=float), (size, 4)), order="C")
    return Plant(crane, size, P, E, inertia, mass, held, function)


def _add_crane(mbs: Any, plant: Plant, ground: int, state: np.ndarray) -> None:
    q, v = redundant(plant, state)
    nodes, bodies = {}, {}
    for b, name in enumerate(BODIES):
        nodes[name] = int(
            mbs.AddNode(
                items.NodeRigidBody2D(
                    referenceCoordinates=[0, 0, 0],
                    initialCoordinates=list(q[3 * b : 3 * b + 3]),
                    initialVelocities=list(v[3 * b : 3 * b + 3]),
                )
            )
        )
        bodies[name] = int(
            mbs.AddObject(
                items.ObjectRigidBody2D(
                    mass=plant.inertia[b, red.MASS], inertia=plant.inertia[b, red.INERTIA], nodeNumber=nodes[name]
                )
            )
        )
    plant.nodes.append(nodes)
    plant.bodies.append(bodies)
    if plant.coordinates == 14:
        _add_swinging_payload(mbs, plant, q, v)
    _add_weights(mbs, plant)
    _add_joints(mbs, plant, ground)
    _add_cylinders(mbs, plant, ground, state)


def _point(mbs: Any, plant: Plant, body: int, ground: int, point: int | None) -> int:
    """Add a marker at a point of P on a body of the last crane (-1: ground); None is the origin of the body's frame."""
    local = np.zeros(2) if point is None else plant.P[point : point + 2].copy()
    number = ground if body < 0 else plant.bodies[-1][BODIES[body]]
    if body >= 0:
        local -= plant.inertia[body, red.COM_X : red.COM_X + 2]
    return int(mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=number, localPosition=[local[0], local[1], 0.0])))


def _add_swinging_payload(mbs: Any, plant: Plant, q: np.ndarray, v: np.ndarray) -> None:
    node = mbs.AddNode(
        items.NodePoint2D(
            referenceCoordinates=[0, 0], initialCoordinates=list(q[12:14]), initialVelocities=list(v[12:14])
        )
    )
    body = mbs.AddObject(items.ObjectMassPoint2D(mass=plant.inertia[4, red.MASS], nodeNumber=node))
    plant.nodes[-1]["payload"], plant.bodies[-1]["payload"] = int(node), int(body)


def _add_weights(mbs: Any, plant: Plant) -> None:
    gravity = hooks.gravity(plant.E, 0.0, -plant.P[GRAVITY])
    for name, body in plant.bodies[-1].items():
        kind = items.MarkerBodyPosition if name == "payload" else items.MarkerBodyMass
        marker = mbs.AddMarker(kind(bodyNumber=body))
        if name == "payload":
            weight = plant.inertia[4, red.MASS]
            mbs.AddLoad(items.Force(markerNumber=marker, loadVector=[weight * gravity[0], weight * gravity[1], 0.0]))
        else:
            mbs.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=[*gravity, 0.0]))


def _add_joints(mbs: Any, plant: Plant, ground: int) -> None:
    joints = {}
    for name, body0, point0, body1, point1 in _JOINTS:
        markers = [_point(mbs, plant, body0, ground, point0), _point(mbs, plant, body1, ground, point1)]
        joints[name] = int(mbs.AddObject(items.ObjectJointRevolute2D(markerNumbers=markers)))
    if plant.coordinates == 14:
        markers = [
            _point(mbs, plant, 3, ground, geo.E),
            mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=plant.bodies[-1]["payload"])),
        ]
        length = hooks.pendulum(plant.E)[0]
        joints["pendulum"] = int(mbs.AddObject(items.ObjectConnectorDistance(markerNumbers=markers, distance=length)))
    plant.joints.append(joints)


def _add_cylinders(mbs: Any, plant: Plant, ground: int, state: np.ndarray) -> None:
    ends = (((-1, geo.F), (0, geo.G)), ((0, geo.H), (1, geo.C)))
    actuators, nodes = [], []
    for c in range(len(CYLINDERS)):
        node = mbs.AddNode(
            items.NodeGenericODE1(
                referenceCoordinates=[0, 0],
                initialCoordinates=list(state[4 + 2 * c : 6 + 2 * c]),
                numberOfODE1Coordinates=2,
            )
        )
        k = CYLINDER + N_CYLINDER * c
        area_a, area_b = hyd.areas(plant.P, c)
        actuators.append(
            int(
                mbs.AddObject(
                    items.HydraulicActuatorSimple(
                        markerNumbers=[_point(mbs, plant, body, ground, point) for body, point in ends[c]],
                        nodeNumbers=[node],
                        offsetLength=plant.P[k + hyd.EMPTY],
                        strokeLength=plant.P[k + hyd.RANGE],
                        chamberCrossSection0=area_a,
                        chamberCrossSection1=area_b,
                        hoseVolume0=plant.P[k + hyd.HOSE_A],
                        hoseVolume1=plant.P[k + hyd.HOSE_B],
                        oilBulkModulus=_NO_STIFFNESS,
                        cylinderBulkModulus=_NO_STIFFNESS,
                        hoseBulkModulus=_NO_STIFFNESS,
                        nominalFlow=1.0,  # must not be zero; the valve openings are
                        useChamberVolumeChange=False,
                    )
                )
            )
        )
        nodes.append(int(node))
    plant.actuators.append((actuators[0], actuators[1]))
    plant.pressure_nodes.append((nodes[0], nodes[1]))


def _add_user_functions(mbs: Any, plant: Plant) -> None:
    nodes = [node for per_crane in plant.nodes for node in per_crane.values()]
    pressure_nodes = [node for pair in plant.pressure_nodes for node in pair]
    forces, rates = user_functions(plant, nodes[0], pressure_nodes[0])
    mbs.AddObject(items.ObjectGenericODE2(nodeNumbers=nodes, forceUserFunction=forces))
    mbs.AddObject(items.ObjectGenericODE1(nodeNumbers=pressure_nodes, rhsUserFunction=rates))


def user_functions(plant: Plant, first_node: int, first_pressure_node: int) -> tuple[Callable, Callable]:
    """Return (forceUserFunction, rhsUserFunction) for the generic objects that hold all cranes of a plant."""
    n, width = plant.size, plant.coordinates
    force, rate = np.zeros((n, width)), np.zeros((n, 4))
    P, E, inertia, mass = plant.P, plant.E, plant.inertia, plant.payload_mass

    def force_function(mbs: Any, t: float, number: int, q: Any, v: Any) -> np.ndarray:
        start = mbs.GetNodeODE1Index(first_pressure_node)
        p = np.asarray(mbs.systemData.GetODE1Coordinates())[start : start + 4 * n]
        if not _all_forces(P, E, t, mass, inertia, np.asarray(q), np.asarray(v), p, force):
            raise CraneError(
                f"{plant.crane.name}: the payload's mass changes at t = {t:g} s, but an Exudyn system has fixed masses. "
                "Use ExudynEngine.simulate, which builds the system anew, or remove the effect payload_change."
            )
        return force.ravel()

    def rate_function(mbs: Any, t: float, number: int, p: Any) -> np.ndarray:
        start = mbs.GetNodeODE2Index(first_node)
        q = np.asarray(mbs.systemData.GetODE2Coordinates())[start : start + width * n]
        v = np.asarray(mbs.systemData.GetODE2Coordinates_t())[start : start + width * n]
        _all_rates(P, E, plant.inputs_at(t), inertia, q, v, np.asarray(p), rate)
        return rate.ravel()

    return force_function, rate_function


@njit
def _all_forces(P, E, t, mass, inertia, q, v, p, out):
    """Fill out (n, 12 or 14) with the extra forces of all cranes; return False if the payload's mass is another one now."""
    n, width = out.shape
    arms = np.empty((red.N_ARMS, 2))
    for k in range(n):
        i, j = width * k, 4 * k
        red.extra_forces(P, E, t, inertia, q[i : i + width], v[i : i + width], p[j : j + 4], arms, out[k])
    return hooks.payload_mass(E, t, P[PAYLOAD]) == mass


@njit
def _all_rates(P, E, w, inertia, q, v, p, out):
    """Fill out (n, 4) with the pressure rates of all cranes."""
    n = out.shape[0]
    width = q.size // n
    arms = np.empty((red.N_ARMS, 2))
    for k in range(n):
        i, j = width * k, 4 * k
        qk, vk, pk = q[i : i + width], v[i : i + width], p[j : j + 4]
        red.arms_of(P, inertia, qk, arms)
        s1, s2, ds1, ds2, _, _, _, _ = red.cylinder_kinematics(P, arms, qk, vk)
        hyd.all_pressure_rates(P, E, w[k], s1, s2, ds1, ds2, pk, out[k])
        hyd.hold_at_vapour_pressure(P, pk, out[k])


@njit
def _redundant(P, E, inertia, x, arms, N, q, v):
    theta, dtheta = (x[8], x[9]) if q.size > 12 else (0.0, 0.0)
    if not red.close_position(P, E, inertia, x[0], x[1], theta, arms, q):
        return False
    red.null_space(arms, N)
    u = np.array([x[2], x[3], dtheta])
    red.velocities(N, u, v)
    return True


def redundant(plant: Plant, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (q, v) of one state: redundant coordinates and velocities with all joints closed.

    Raises:
        CraneError: the pose cannot be reached.
    """
    width = plant.coordinates
    q, v = np.zeros(width), np.zeros(width)
    arms, N = np.empty((red.N_ARMS, 2)), np.zeros((width // 2 - 4, width))
    if not _redundant(plant.P, plant.E, plant.inertia, np.asarray(state, dtype=float), arms, N, q, v):
        raise geo.unreachable(plant.crane.name, state[0], state[1])
    return q, v


def main_system() -> tuple[Any, Any]:
    """Return (system container, main system), both new and empty."""
    container = exu.SystemContainer()
    return container, container.AddSystem()


def new_solver() -> Any:
    """Return Exudyn's implicit second-order solver, to be stepped by hand (its type stub lacks `self`, hence Any)."""
    return exu.MainSolverImplicitSecondOrder()


def settings(step: float, duration: float, *, sparse: bool = False) -> Any:
    """Return Exudyn simulation settings for the implicit trapezoidal rule with index-2 constraints, as the engine uses.

    Args:
        step: step size in s.
        duration: end time in s.
        sparse: sparse linear algebra; worth it for more than a few cranes.
    """
    s = exu.SimulationSettings()
    t = s.timeIntegration
    t.numberOfSteps, t.endTime = max(1, round(duration / step)), duration
    t.generalizedAlpha.useNewmark = True
    t.generalizedAlpha.useIndex2Constraints = True
    t.newton.useModifiedNewton = False
    t.verboseMode = 0
    s.linearSolver.solverType = exu.LinearSolverType.EigenSparse if sparse else exu.LinearSolverType.EigenDense
    s.solution.file.write = False
    return s
