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
#: joints in the order of reduction.JOINT_*: body (or ground, -1) and point (or origin, -1) on either side
_JOINTS = (
    ("O", -1, geo.O, 0, -1),
    ("B", 0, geo.B, 1, -1),
    ("C", 1, geo.C, 2, -1),
    ("A", 0, geo.A, 3, -1),
    ("D", 2, geo.D_BRACKET, 3, geo.D),
)


@dataclass
class Plant:
    """Cranes in an Exudyn system, with the item numbers to reach them.

    Attributes:
        crane: the description that all of them share.
        size: how many cranes there are; per crane the lists below have one entry.
        P, E: (size, .) nominal and effect parameters, one row a crane; see `set_parameters`.
        inertia: (size, 5, 4) masses, centres and inertias that the bodies have now.
        payload_mass: (size,) in kg, the part of `inertia` that may change with time.
        inputs: (size, 12) rows [U1 U2 pp pt] and the disturbances of hydraulics.DISTURBANCES, which the user functions read;
            NaN in pp or pt means the crane's own supply.
        input_function: if given, called with the time in s, returns what the first four columns of `inputs` are to hold.
        bodies: object numbers by name of parameters.BODIES (and "payload" on a pendulum).
        nodes: node numbers likewise.
        joints: object numbers by joint name.
        actuators: object numbers of the lift and the tilt cylinder.
        pressure_nodes: node numbers of the lift's and the tilt's pressures.
        markers: (marker number, body or -1 for the ground, point in P or -1 for the body's origin).
        loads: load numbers by name of the body.
    """

    crane: Crane
    size: int
    P: np.ndarray
    E: np.ndarray
    inertia: np.ndarray
    payload_mass: np.ndarray
    inputs: np.ndarray
    input_function: Callable[[float], np.ndarray] | None = None
    bodies: list[dict[str, int]] = field(default_factory=list)
    nodes: list[dict[str, int]] = field(default_factory=list)
    joints: list[dict[str, int]] = field(default_factory=list)
    actuators: list[tuple[int, int]] = field(default_factory=list)
    pressure_nodes: list[tuple[int, int]] = field(default_factory=list)
    markers: list[list[tuple[int, int, int]]] = field(default_factory=list)
    loads: list[dict[str, int]] = field(default_factory=list)

    @property
    def coordinates(self) -> int:
        """Number of redundant coordinates per crane: 12, or 14 with a payload on a pendulum."""
        return 14 if self.inertia[0, 4, red.MASS] > 0.0 else 12

    @property
    def joint_rows(self) -> int:
        """Number of joint equations per crane."""
        return 10 if self.coordinates == 12 else 11

    def inputs_at(self, time: float) -> np.ndarray:
        """Return the inputs (size, 12) at a time in s."""
        if self.input_function is not None:
            self.inputs[:, :4] = self.input_function(time)
        return self.inputs

    def set_parameters(self, mbs: Any, P: np.ndarray, E: np.ndarray, time: float) -> bool:
        """Give every crane parameters of its own, P (size, .) and E (size, .), and the payload that it has at a time (s).

        Only Exudyn items whose numbers change are touched.

        Returns:
            whether a mass has changed, so that a kept mass matrix is to be computed anew.
        """
        before = self._item_values()
        self.P[...], self.E[...] = P, E
        red.all_inertias(self.P, self.E, time, self.inertia)
        _payload_masses(self.P, self.E, time, self.payload_mass)
        now = self._item_values()
        changed = now != before
        for k in np.flatnonzero(changed.any(axis=1)):
            _update_items(mbs, self, int(k), now[k], changed[k])
        return bool(changed[:, _MASSES].any())

    def _item_values(self) -> np.ndarray:
        """Return all numbers (size, .) that Exudyn's items hold, in the order of `_fill_item_values`."""
        places = np.array([(body, point) for _, body, point in self.markers[0]])
        out = np.empty((self.size, _PLACES + 2 * len(places)))
        _fill_item_values(self.P, self.E, self.inertia, places, out)
        return out


# columns of the table of numbers that Exudyn's items hold
_MASSES, _GRAVITY, _LENGTH, _AREAS, _PLACES = slice(0, 9), slice(9, 11), 11, slice(12, 16), 16


@njit
def _payload_masses(P, E, time, out):
    for k in range(out.size):
        out[k] = hooks.payload_mass(E[k], time, P[k, PAYLOAD])


@njit
def _fill_item_values(P, E, inertia, places, out):
    """Fill out (n, .): mass and inertia of four bodies, mass, gravity, length of the pendulum, four areas, markers' places.

    places (m, 2): body (-1: ground) and point in P (-1: origin) of every marker.
    """
    for k in range(out.shape[0]):
        for b in range(4):
            out[k, 2 * b], out[k, 2 * b + 1] = inertia[k, b, red.MASS], inertia[k, b, red.INERTIA]
        out[k, 8] = inertia[k, 4, red.MASS]
        out[k, 9], out[k, 10] = hooks.gravity(E[k], 0.0, -P[k, GRAVITY])
        out[k, 11], _ = hooks.pendulum(E[k])
        out[k, 12], out[k, 13] = hyd.areas(P[k], 0)
        out[k, 14], out[k, 15] = hyd.areas(P[k], 1)
        for m in range(places.shape[0]):
            body, point = places[m]
            for axis in range(2):
                local = 0.0 if point < 0 else P[k, point + axis]
                out[k, 16 + 2 * m + axis] = local if body < 0 else local - inertia[k, body, red.COM_X + axis]


def _update_items(mbs: Any, plant: Plant, k: int, now: np.ndarray, changed: np.ndarray) -> None:
    """Bring the Exudyn items of crane k up to date: `now` is its row of numbers, `changed` says which differ."""
    for b, name in enumerate(BODIES):
        if changed[2 * b : 2 * b + 2].any():
            mbs.SetObjectParameter(plant.bodies[k][name], "mass", now[2 * b])
            mbs.SetObjectParameter(plant.bodies[k][name], "inertia", now[2 * b + 1])
    for m in np.unique(np.flatnonzero(changed[_PLACES:]) // 2):
        place = now[_PLACES + 2 * m : _PLACES + 2 * m + 2]
        mbs.SetMarkerParameter(plant.markers[k][m][0], "localPosition", [place[0], place[1], 0.0])
    if changed[_GRAVITY].any() or changed[8]:
        for name, load in plant.loads[k].items():
            mbs.SetLoadParameter(load, "loadVector", _load_vector(plant, k, name))
    if changed[_AREAS].any():
        for c, actuator in enumerate(plant.actuators[k]):
            mbs.SetObjectParameter(actuator, "chamberCrossSection0", now[12 + 2 * c])
            mbs.SetObjectParameter(actuator, "chamberCrossSection1", now[13 + 2 * c])
    if "pendulum" in plant.joints[k] and (changed[8] or changed[_LENGTH]):
        mbs.SetObjectParameter(plant.bodies[k]["payload"], "mass", now[8])
        mbs.SetObjectParameter(plant.joints[k]["pendulum"], "distance", now[_LENGTH])


def _local_place(plant: Plant, k: int, body: int, point: int) -> np.ndarray:
    """Return a point of P (-1: origin) on a body as seen from its centre of mass, or in the ground's frame (body -1)."""
    local = np.zeros(2) if point < 0 else plant.P[k, point : point + 2].copy()
    return local if body < 0 else local - plant.inertia[k, body, red.COM_X : red.COM_X + 2]


def _load_vector(plant: Plant, k: int, name: str) -> list[float]:
    """Return a body's load: gravity for mass-proportional loads, the weight for the payload on its pendulum."""
    gx, gy = hooks.gravity(plant.E[k], 0.0, -plant.P[k, GRAVITY])
    factor = plant.inertia[k, 4, red.MASS] if name == "payload" else 1.0
    return [factor * gx, factor * gy, 0.0]


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
    P, E = np.tile(crane.parameter_vector(), (size, 1)), np.tile(crane.effect_vector(), (size, 1))
    inertia, mass = np.zeros((size, 5, 4)), payload_at(crane, time)
    if mass < 0.0 or (mass == 0.0 and hooks.pendulum(E[0])[0] > 0.0):
        raise CraneError(
            f"{crane.name}: the payload has a mass of {mass:g} kg at t = {time:g} s. A mass cannot be negative, and one that "
            "swings cannot be zero: mend payload.mass or the effect payload_change, or remove payload_swing."
        )
    red.all_inertias(P, E, time, inertia)
    held = np.zeros((size, hyd.N_W))
    held[:, 2:4] = np.nan
    function = inputs if callable(inputs) else None
    if function is not None:
        held[:, :4] = function(time)
    elif inputs is not None:
        held[:, :4] = inputs
    return Plant(crane, size, P, E, inertia, np.full(size, mass), held, function)


def _add_crane(mbs: Any, plant: Plant, ground: int, state: np.ndarray) -> None:
    q, v = redundant(plant, state)
    plant.nodes.append({})
    plant.bodies.append({})
    plant.markers.append([])
    for b, name in enumerate(BODIES):
        _add_body(mbs, plant, b, name, q[3 * b : 3 * b + 3], v[3 * b : 3 * b + 3])
    if plant.coordinates == 14:
        _add_swinging_payload(mbs, plant, q, v)
    _add_weights(mbs, plant)
    _add_joints(mbs, plant, ground)
    _add_cylinders(mbs, plant, ground, state)


def _add_body(mbs: Any, plant: Plant, b: int, name: str, q: np.ndarray, v: np.ndarray) -> None:
    node = mbs.AddNode(
        items.NodeRigidBody2D(referenceCoordinates=[0, 0, 0], initialCoordinates=list(q), initialVelocities=list(v))
    )
    mass, inertia = plant.inertia[len(plant.bodies) - 1, b, [red.MASS, red.INERTIA]]
    body = mbs.AddObject(items.ObjectRigidBody2D(mass=mass, inertia=inertia, nodeNumber=node))
    plant.nodes[-1][name], plant.bodies[-1][name] = int(node), int(body)


def _point(mbs: Any, plant: Plant, body: int, ground: int, point: int) -> int:
    """Add a marker at a point of P on a body of the last crane (-1: ground); -1 is the origin of the body's frame."""
    place = _local_place(plant, len(plant.bodies) - 1, body, point)
    number = ground if body < 0 else plant.bodies[-1][BODIES[body]]
    marker = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=number, localPosition=[place[0], place[1], 0.0]))
    plant.markers[-1].append((int(marker), body, point))
    return int(marker)


def _add_swinging_payload(mbs: Any, plant: Plant, q: np.ndarray, v: np.ndarray) -> None:
    node = mbs.AddNode(
        items.NodePoint2D(
            referenceCoordinates=[0, 0], initialCoordinates=list(q[12:14]), initialVelocities=list(v[12:14])
        )
    )
    mass = plant.inertia[len(plant.bodies) - 1, 4, red.MASS]
    body = mbs.AddObject(items.ObjectMassPoint2D(mass=mass, nodeNumber=node))
    plant.nodes[-1]["payload"], plant.bodies[-1]["payload"] = int(node), int(body)


def _add_weights(mbs: Any, plant: Plant) -> None:
    loads = {}
    for name, body in plant.bodies[-1].items():
        vector = _load_vector(plant, len(plant.bodies) - 1, name)
        if name == "payload":
            marker = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body))
            loads[name] = int(mbs.AddLoad(items.Force(markerNumber=marker, loadVector=vector)))
        else:
            marker = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
            loads[name] = int(mbs.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=vector)))
    plant.loads.append(loads)


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
        length = hooks.pendulum(plant.E[len(plant.bodies) - 1])[0]
        joints["pendulum"] = int(mbs.AddObject(items.ObjectConnectorDistance(markerNumbers=markers, distance=length)))
    plant.joints.append(joints)


def _add_cylinders(mbs: Any, plant: Plant, ground: int, state: np.ndarray) -> None:
    ends = (((-1, geo.F), (0, geo.G)), ((0, geo.H), (1, geo.C)))
    actuators, nodes, P = [], [], plant.P[len(plant.bodies) - 1]
    for c in range(len(CYLINDERS)):
        node = mbs.AddNode(
            items.NodeGenericODE1(
                referenceCoordinates=[0, 0],
                initialCoordinates=list(state[4 + 2 * c : 6 + 2 * c]),
                numberOfODE1Coordinates=2,
            )
        )
        k = CYLINDER + N_CYLINDER * c
        area_a, area_b = hyd.areas(P, c)
        actuators.append(
            int(
                mbs.AddObject(
                    items.HydraulicActuatorSimple(
                        markerNumbers=[_point(mbs, plant, body, ground, point) for body, point in ends[c]],
                        nodeNumbers=[node],
                        offsetLength=P[k + hyd.EMPTY],
                        strokeLength=P[k + hyd.RANGE],
                        chamberCrossSection0=area_a,
                        chamberCrossSection1=area_b,
                        hoseVolume0=P[k + hyd.HOSE_A],
                        hoseVolume1=P[k + hyd.HOSE_B],
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
    P, E, inertia, mass = plant.P, plant.E, plant.inertia, plant.payload_mass  # changed in place by set_parameters

    starts: list[int] = []

    def first_coordinates(mbs: Any) -> list[int]:
        starts[:] = [mbs.GetNodeODE2Index(first_node), mbs.GetNodeODE1Index(first_pressure_node)]
        return starts

    def force_function(mbs: Any, t: float, number: int, q: Any, v: Any) -> np.ndarray:
        start = (starts or first_coordinates(mbs))[1]
        p = np.asarray(mbs.systemData.GetODE1Coordinates())[start : start + 4 * n]
        if not _all_forces(P, E, t, mass, plant.inputs_at(t), inertia, np.asarray(q), np.asarray(v), p, force):
            raise CraneError(
                f"{plant.crane.name}: the payload's mass changes at t = {t:g} s, but an Exudyn system has fixed masses. "
                "Use ExudynEngine.simulate, which changes them, or remove the effect payload_change."
            )
        return force.ravel()

    def rate_function(mbs: Any, t: float, number: int, p: Any) -> np.ndarray:
        start, data = (starts or first_coordinates(mbs))[0], mbs.systemData
        q = np.asarray(data.GetODE2Coordinates())[start : start + width * n]
        v = np.asarray(data.GetODE2Coordinates_t())[start : start + width * n]
        _all_rates(P, E, plant.inputs_at(t), inertia, q, v, np.asarray(p), rate)
        return rate.ravel()

    return force_function, rate_function


@njit
def _all_forces(P, E, t, mass, w, inertia, q, v, p, out):
    """Fill out (n, 12 or 14) with the extra forces of all cranes; return False if a payload's mass is another one now."""
    n, width = out.shape
    arms = np.empty((red.N_ARMS, 2))
    same = True
    for k in range(n):
        i, j = width * k, 4 * k
        qk, vk, pk = q[i : i + width], v[i : i + width], p[j : j + 4]
        red.extra_forces(P[k], E[k], t, w[k], inertia[k], qk, vk, pk, arms, out[k])
        same = same and hooks.payload_mass(E[k], t, P[k, PAYLOAD]) == mass[k]
    return same


@njit
def _all_rates(P, E, w, inertia, q, v, p, out):
    """Fill out (n, 4) with the pressure rates of all cranes."""
    n = out.shape[0]
    width = q.size // n
    arms = np.empty((red.N_ARMS, 2))
    for k in range(n):
        i, j = width * k, 4 * k
        qk, vk, pk = q[i : i + width], v[i : i + width], p[j : j + 4]
        red.arms_of(P[k], inertia[k], qk, arms)
        s1, s2, ds1, ds2, _, _, _, _ = red.cylinder_kinematics(P[k], arms, qk, vk)
        hyd.all_pressure_rates(P[k], E[k], w[k], s1, s2, ds1, ds2, pk, out[k])


def redundant(plant: Plant, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (q, v) of one state: redundant coordinates and velocities with all joints closed.

    Raises:
        CraneError: the pose cannot be reached.
    """
    width = plant.coordinates
    q, v = np.zeros(width), np.zeros(width)
    arms, N = np.empty((red.N_ARMS, 2)), np.zeros((width // 2 - 4, width))
    if not red.place(plant.P[0], plant.E[0], plant.inertia[0], np.asarray(state, dtype=float), arms, N, q, v):
        raise geo.unreachable(plant.crane.name, state[0], state[1])
    return q, v


def main_system() -> tuple[Any, Any]:
    """Return (system container, main system), both new and empty."""
    container = exu.SystemContainer()
    return container, container.AddSystem()


def set_initial_rates(mbs: Any, plant: Plant, time: float = 0.0) -> None:
    """Give Exudyn the pressure rates that its initial state has; call it after `mbs.Assemble()`, before `SolveDynamic`.

    Exudyn finds initial accelerations itself, but starts with pressure rates of zero, which spoils the first step of the
    trapezoidal rule where a valve is open or a cylinder moves at the start.
    """
    data, initial = mbs.systemData, exu.ConfigurationType.Initial
    n, width = plant.size, plant.coordinates
    first = mbs.GetNodeODE2Index(next(iter(plant.nodes[0].values())))
    start = mbs.GetNodeODE1Index(plant.pressure_nodes[0][0])
    q = np.array(data.GetODE2Coordinates(initial))[first : first + n * width]
    v = np.array(data.GetODE2Coordinates_t(initial))[first : first + n * width]
    p = np.array(data.GetODE1Coordinates(initial))[start : start + 4 * n]
    rates, all_rates = np.zeros((n, 4)), np.array(data.GetODE1Coordinates_t(initial))
    _all_rates(plant.P, plant.E, plant.inputs_at(time), plant.inertia, q, v, p, rates)
    all_rates[start : start + 4 * n] = rates.ravel()
    data.SetODE1Coordinates_t(all_rates, initial)


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
    t.newton.useModifiedNewton = True  # the user functions are differentiated numerically: keep that for many steps
    t.verboseMode = 0
    s.linearSolver.solverType = exu.LinearSolverType.EigenSparse if sparse else exu.LinearSolverType.EigenDense
    s.solution.file.write = False
    return s
