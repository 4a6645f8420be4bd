"""The machine as an Exudyn system: planar rigid bodies in redundant coordinates, joints, hydraulic cylinders, user
functions.

`build` adds one or more machines to a main system, also to one of your own: add your own objects to it, assemble and
call `mbs.SolveDynamic` as with any Exudyn model. Per machine it adds

- rigid bodies with nodes at their centres of mass (3 coordinates each), with the machine's outline for Exudyn's own
  viewer; a payload that
  is fixed is part of its body's inertia; one on a pendulum is a mass point at a constant distance from its point;
- revolute and prismatic joints, two equations each, those that close loops among them;
- weights as mass-proportional loads;
- hydraulic actuators on nodes with two pressures each, which give the force of the pressures. Their own valve and
  compression equations are switched off, since those know neither laminar flow nor four edges nor effects;
- one generic ODE1 object for the pressures of all machines, whose user function is (34) in `hydraulics.py`;
- one generic ODE2 object for all other forces of all machines: friction (19), effects at cylinders and joints.

Coordinates are absolute: the reference coordinates of the nodes are zero.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from . import trapezoidal
from .channels import FULLY_OPEN
from .compiled import njit
from .crane import Crane, checked_crane
from .effects import hooks
from .errors import CraneError, nearest
from .exudyn_quietly import exu, items
from .machine import (
    CARRIER,
    CUT_PIN,
    DIRECTION,
    GROUND,
    KIND,
    LAST,
    LAST_PIN,
    OWN_PIN,
    PIN,
    SLIDES,
    TIP_BODY,
    TIP_POINT,
    Machine,
)
from .parameters import CYLINDER, GRAVITY, N_CYLINDER, PAYLOAD
from .statics import size_of_state, weightless

#: bulk modulus in Pa that removes the actuators' own compression flow; it cannot be zero
_NO_STIFFNESS = 1e-200
#: the name of a payload on a pendulum among the bodies, and of its connector among the joints
SWINGING, PENDULUM = "payload", "pendulum"


@dataclass(repr=False)
class Plant:
    """Machines in an Exudyn system, with the item numbers to reach them.

    Attributes:
        crane: the description that all of them share.
        size: how many machines there are; per machine the lists below have one entry.
        P, E: (size, .) nominal and effect parameters, one row a machine; see `item_values`.
        inertia: (size, bodies + 1, 4) masses, centres and inertias that the bodies have now.
        payload_mass: (size,) in kg, the part of `inertia` that may change with time.
        inputs: (size, .) rows of `Layout.all_inputs`, which the user functions read; NaN in pp or pt means the
            machine's own supply.
        input_function: if given, called with the time in s, returns what the columns of `inputs` without disturbances
            are to hold.
        bodies: object numbers by name of the body (and "payload" on a pendulum).
        nodes: node numbers likewise.
        joints: object numbers by joint name.
        actuators: object numbers of the cylinders.
        pressure_nodes: node numbers of the cylinders' pressures.
        markers: (marker number, body or -1 for the ground, point in P or -1 for the body's origin).
        loads: load numbers by name of the body.
        outlines: shapes by name of the body, and of the ground; empty without graphics.
        guarded: whether a cylinder beyond its stroke ends a run; not where each step is judged as a whole.
    """

    crane: Crane
    size: int
    P: np.ndarray
    E: np.ndarray
    inertia: np.ndarray
    payload_mass: np.ndarray
    inputs: np.ndarray
    mbs: Any = None
    ground: int = 0
    input_function: Callable[[float], np.ndarray] | None = None
    bodies: list[dict[str, int]] = field(default_factory=list)
    nodes: list[dict[str, int]] = field(default_factory=list)
    joints: list[dict[str, int]] = field(default_factory=list)
    actuators: list[list[int]] = field(default_factory=list)
    pressure_nodes: list[list[int]] = field(default_factory=list)
    markers: list[list[tuple[int, int, int]]] = field(default_factory=list)
    loads: list[dict[str, int]] = field(default_factory=list)
    outlines: dict[str, list[dict[str, Any]]] = field(default_factory=dict)
    guarded: bool = True

    def __repr__(self) -> str:
        return f"<Plant of {self.size} x {self.crane!r}, bodies {' '.join(self.crane.machine.bodies)}>"

    @property
    def topology(self) -> np.ndarray:
        """The machine's table of integers, see `machine.py`."""
        return self.crane.machine.topology

    @property
    def swings(self) -> bool:
        """Whether the payload hangs on a pendulum."""
        return bool(self.inertia[0, -1, red.MASS] > 0.0)

    @property
    def coordinates(self) -> int:
        """Number of redundant coordinates per machine: three a body, two more with a payload on a pendulum."""
        return 3 * len(self.crane.machine.bodies) + 2 * self.swings

    @property
    def velocities(self) -> int:
        """Number of independent velocities per machine."""
        return len(self.crane.layout.coordinates) + self.swings

    @property
    def joint_rows(self) -> int:
        """Number of joint equations per machine."""
        return int(red.joint_equations(self.topology, self.swings))

    def inputs_at(self, time: float) -> np.ndarray:
        """Return the inputs (size, .) at a time in s."""
        if self.input_function is not None:
            self.inputs[:, self.crane.layout.driving] = driving(self.crane, self.input_function(time), time)
        return self.inputs

    def marker(self, point: str, number: int = 0) -> int:
        """Return the number of a new marker at a named point, such as "E", of one of the machines; before
        `mbs.Assemble()`.

        Raises:
            CraneError: the machine has no such point, or there is no such machine.
        """
        machine = self.crane.machine
        if number not in range(self.size):
            raise CraneError(f"There is no machine {number!r} of {self!r}. They count from 0 to {self.size - 1}.")
        if point not in machine.point_names:
            raise CraneError(f"{self.crane.name} has no point {point!r}.{nearest(point, list(machine.point_names))}")
        name = list(machine.points)[machine.point_names.index(point)]
        body = _number_of(machine, machine.points[name])
        return _point(self.mbs, self, number, body, machine.index[f"{name}.x"], rigid=True)


def _number_of(machine: Machine, body: str) -> int:
    return -1 if body == GROUND else machine.bodies.index(body)


def axes_of(direction: float) -> tuple[list[float], list[float]]:
    """Return the axis along which a prismatic joint slides, and its normal."""
    c, s = math.cos(direction), math.sin(direction)
    return [c, s, 0.0], [-s, c, 0.0]


def _local_place(plant: Plant, k: int, body: int, point: int) -> np.ndarray:
    """Return a point of P (-1: origin) on a body as seen from its centre of mass, or in the ground's frame (body
    -1).
    """
    local = np.zeros(2) if point < 0 else plant.P[k, point : point + 2].copy()
    return local if body < 0 else local - plant.inertia[k, body, red.COM_X : red.COM_X + 2]


def _load_vector(plant: Plant, k: int, name: str) -> list[float]:
    """Return a body's load: gravity for mass-proportional loads, the weight for the payload on its pendulum."""
    gx, gy = hooks.plain("gravity")(plant.E[k], 0.0, -plant.P[k, GRAVITY])
    factor = plant.inertia[k, -1, red.MASS] if name == SWINGING else 1.0
    return [factor * gx, factor * gy, 0.0]


def payload_at(crane: Crane, time: float) -> float:
    """Return the mass of the payload in kg at a time in s."""
    return float(hooks.plain("payload_mass")(crane.effect_vector(), time, crane["payload.mass"]))


def build(
    mbs: Any,
    crane: Crane,
    *,
    states: np.ndarray | None = None,
    inputs: np.ndarray | Callable[[float], np.ndarray] | None = None,
    time: float = 0.0,
    graphics: bool = True,
) -> Plant:
    """Add machines to an Exudyn main system (before `mbs.Assemble()`) and return where they are.

    Args:
        mbs: exudyn.MainSystem.
        crane: what to build.
        states: (nx,) or (n, nx) initial states, one machine each; default: the crane's start at 20 bar everywhere.
        inputs: w = `Layout.inputs`, one row or n, or a function of time that returns one; default: valves closed.
        time: the payload has the mass of this time.
        graphics: whether bodies, ground and cylinders get the machine's shapes, which Exudyn's viewer shows.

    Raises:
        CraneError: states or inputs of another length, spools that are not in [-1, 1], a pose that cannot be reached,
            or a payload on a pendulum without mass.
    """
    first = start_pose(checked_crane(crane, "build"))
    rows = np.atleast_2d(first if states is None else np.asarray(states, dtype=float))
    if rows.ndim != 2 or rows.shape[1] != first.size or not len(rows):
        raise CraneError(
            f"build: states have shape {rows.shape}, expected (n, {first.size}) or ({first.size},) for {crane.name}."
        )
    plant = _plant(crane, len(rows), inputs, time)
    plant.outlines = _outlines(plant) if graphics else {}
    look = items.VObjectGround(graphicsData=plant.outlines.get(GROUND, []))
    plant.mbs, plant.ground = mbs, int(mbs.AddObject(items.ObjectGround(visualization=look)))
    for k, row in enumerate(rows):
        _add_machine(mbs, plant, k, row)
    _add_user_functions(mbs, plant)
    for k in range(plant.size):
        for add in crane.objects:
            add(mbs, plant, k)
    return plant


def _outlines(plant: Plant) -> dict[str, list[dict[str, Any]]]:
    """Return the shapes of ground and bodies, each about its centre of mass."""
    from .render_shapes import outlines  # only where somebody may look

    return outlines(
        plant.crane, dict(zip(plant.crane.machine.bodies, plant.inertia[0, :, [red.COM_X, red.COM_Y]].T, strict=False))
    )


def start_pose(crane: Crane) -> np.ndarray:
    """Return a state (nx,) in the crane's pose at the start, all chambers at 20 bar."""
    lay, state = crane.layout, np.zeros(size_of_state(crane))
    state[lay.positions], state[lay.pressures] = crane.initial.pose, 20e5
    return state


def _plant(crane: Crane, size: int, inputs: Any, time: float) -> Plant:
    P, E = np.tile(crane.parameter_vector(), (size, 1)), np.tile(crane.effect_vector(), (size, 1))
    inertia, mass = np.zeros((size, len(crane.machine.bodies) + 1, 4)), payload_at(crane, time)
    if mass < 0.0 or (mass == 0.0 and hooks.swings(E[0])):
        raise weightless(crane, mass, time)
    red.all_inertias(crane.machine.topology, P, E, time, inertia)
    lay = crane.layout
    held = np.zeros((size, len(lay.all_inputs)))
    held[:, lay.supplies] = np.nan
    function = inputs if callable(inputs) else None
    if inputs is not None:
        held[:, lay.driving] = driving(crane, inputs if function is None else function(time), time)
    return Plant(crane, size, P, E, inertia, np.full(size, mass), held, input_function=function)


def driving(crane: Crane, given: Any, time: float) -> np.ndarray:
    """Return inputs w = `Layout.inputs` (m,) or (n, m) as they are given for a time in s.

    Raises:
        CraneError: not as many numbers, or spools that are not in [-1, 1].
    """
    names, n = crane.layout.inputs, len(crane.layout.commands)
    try:
        w = np.asarray(given, dtype=float)
    except (TypeError, ValueError):
        w = np.empty(0)
    if w.shape[-1:] != (len(names),) or not (np.abs(w[..., :n]) <= FULLY_OPEN).all():
        raise CraneError(
            f"{crane.name}: inputs = {np.array2string(np.asarray(given), threshold=12)} at t = {time:g} s; expected "
            f"[{' '.join(names)}], spools from -1 to 1, and supply pressures in Pa, NaN for the machine's own."
        )
    return w


def _add_machine(mbs: Any, plant: Plant, k: int, state: np.ndarray) -> None:
    q, v = redundant(plant, state)
    plant.nodes.append({})
    plant.bodies.append({})
    plant.markers.append([])
    for b, name in enumerate(plant.crane.machine.bodies):
        _add_body(mbs, plant, b, name, q[3 * b : 3 * b + 3], v[3 * b : 3 * b + 3])
    if plant.swings:
        _add_swinging_payload(mbs, plant, q, v)
    _add_weights(mbs, plant)
    _add_joints(mbs, plant, k)
    _add_cylinders(mbs, plant, k, state)


def _add_body(mbs: Any, plant: Plant, b: int, name: str, q: np.ndarray, v: np.ndarray) -> None:
    node = mbs.AddNode(
        items.NodeRigidBody2D(referenceCoordinates=[0, 0, 0], initialCoordinates=list(q), initialVelocities=list(v))
    )
    mass, inertia = plant.inertia[len(plant.bodies) - 1, b, [red.MASS, red.INERTIA]]
    look = items.VObjectRigidBody2D(graphicsData=plant.outlines.get(name, []))
    body = mbs.AddObject(items.ObjectRigidBody2D(mass=mass, inertia=inertia, nodeNumber=node, visualization=look))
    plant.nodes[-1][name], plant.bodies[-1][name] = int(node), int(body)


def _point(mbs: Any, plant: Plant, k: int, body: int, point: int, *, rigid: bool = False) -> int:
    """Add a marker at a point of P on a body of machine k (-1: ground); -1 is the origin of the body's frame.

    Only a rigid one knows the body's angle; the others cost less.
    """
    place = _local_place(plant, k, body, point)
    number = plant.ground if body < 0 else plant.bodies[k][plant.crane.machine.bodies[body]]
    kind = items.MarkerBodyRigid if rigid else items.MarkerBodyPosition
    marker = mbs.AddMarker(kind(bodyNumber=number, localPosition=[place[0], place[1], 0.0]))
    plant.markers[k].append((int(marker), body, point))
    return int(marker)


def _add_swinging_payload(mbs: Any, plant: Plant, q: np.ndarray, v: np.ndarray) -> None:
    node = mbs.AddNode(
        items.NodePoint2D(referenceCoordinates=[0, 0], initialCoordinates=list(q[-2:]), initialVelocities=list(v[-2:]))
    )
    mass = plant.inertia[len(plant.bodies) - 1, -1, red.MASS]
    look = items.VObjectMassPoint2D(graphicsData=plant.outlines.get(SWINGING, []))
    body = mbs.AddObject(items.ObjectMassPoint2D(mass=mass, nodeNumber=node, visualization=look))
    plant.nodes[-1][SWINGING], plant.bodies[-1][SWINGING] = int(node), int(body)


def _add_weights(mbs: Any, plant: Plant) -> None:
    loads = {}
    for name, body in plant.bodies[-1].items():
        vector = _load_vector(plant, len(plant.bodies) - 1, name)
        if name == SWINGING:
            marker = mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=body))
            loads[name] = int(mbs.AddLoad(items.Force(markerNumber=marker, loadVector=vector)))
        else:
            marker = mbs.AddMarker(items.MarkerBodyMass(bodyNumber=body))
            loads[name] = int(mbs.AddLoad(items.LoadMassProportional(markerNumber=marker, loadVector=vector)))
    plant.loads.append(loads)


def _add_joints(mbs: Any, plant: Plant, k: int) -> None:
    """Add the joints in the order of the joint equations: one a body, one a loop, the pendulum's rod."""
    machine, joints = plant.crane.machine, {}
    for b, joint in enumerate(machine.joints):
        row = plant.topology[1 + b]
        if joint.closes:
            second = machine.bodies.index(joint.carrier)
            ends = ((second, row[CUT_PIN]), (row[LAST], row[LAST_PIN]))
        else:
            ends = ((row[CARRIER], row[PIN]), (b, row[OWN_PIN]))
        slides = not joint.closes and row[KIND] == SLIDES
        markers = [_point(mbs, plant, k, int(body), int(point), rigid=slides) for body, point in ends]
        if slides:
            axis, normal = axes_of(plant.P[k, row[DIRECTION]])
            item: Any = items.ObjectJointPrismatic2D(markerNumbers=markers, axisMarker0=axis, normalMarker1=normal)
        else:
            item = items.ObjectJointRevolute2D(markerNumbers=markers)
        joints[joint.name] = int(mbs.AddObject(item))
    if plant.swings:
        markers = [
            _point(mbs, plant, k, int(plant.topology[0, TIP_BODY]), int(plant.topology[0, TIP_POINT])),
            mbs.AddMarker(items.MarkerBodyPosition(bodyNumber=plant.bodies[k][SWINGING])),
        ]
        length = hooks.plain("pendulum")(plant.E[k])[0]
        joints[PENDULUM] = int(mbs.AddObject(items.ObjectConnectorDistance(markerNumbers=markers, distance=length)))
    plant.joints.append(joints)


def _add_cylinders(mbs: Any, plant: Plant, k: int, state: np.ndarray) -> None:
    machine, lay = plant.crane.machine, plant.crane.layout
    actuators, nodes, P = [], [], plant.P[k]
    for c, cylinder in enumerate(machine.cylinders):
        node = mbs.AddNode(
            items.NodeGenericODE1(
                referenceCoordinates=[0, 0],
                initialCoordinates=list(state[lay.pressures_of(c)]),
                numberOfODE1Coordinates=2,
            )
        )
        block = CYLINDER + N_CYLINDER * c
        area_a, area_b = hyd.areas(P, c)
        ends = [
            (_number_of(machine, b), machine.index[f"{p}.x"])
            for b, p in zip(cylinder.bodies, cylinder.points, strict=True)
        ]
        actuators.append(
            int(
                mbs.AddObject(
                    items.HydraulicActuatorSimple(
                        markerNumbers=[_point(mbs, plant, k, body, point) for body, point in ends],
                        nodeNumbers=[node],
                        offsetLength=P[block + hyd.EMPTY],
                        strokeLength=P[block + hyd.RANGE],
                        chamberCrossSection0=area_a,
                        chamberCrossSection1=area_b,
                        hoseVolume0=P[block + hyd.HOSE_A],
                        hoseVolume1=P[block + hyd.HOSE_B],
                        oilBulkModulus=_NO_STIFFNESS,
                        cylinderBulkModulus=_NO_STIFFNESS,
                        hoseBulkModulus=_NO_STIFFNESS,
                        nominalFlow=1.0,  # must not be zero; the valve openings are
                        useChamberVolumeChange=False,
                        visualization=items.VHydraulicActuatorSimple(
                            cylinderRadius=0.55 * P[block + hyd.BORE],
                            pistonRadius=0.5 * P[block + hyd.BORE],
                            rodRadius=0.5 * P[block + hyd.ROD],
                            colorCylinder=[0.17, 0.19, 0.22, 1.0],
                        ),
                    )
                )
            )
        )
        nodes.append(int(node))
    plant.actuators.append(actuators)
    plant.pressure_nodes.append(nodes)


def _add_user_functions(mbs: Any, plant: Plant) -> None:
    nodes = [node for per_crane in plant.nodes for node in per_crane.values()]
    pressure_nodes = [node for pair in plant.pressure_nodes for node in pair]
    forces, rates = user_functions(plant, nodes[0], pressure_nodes[0])
    mbs.AddObject(items.ObjectGenericODE2(nodeNumbers=nodes, forceUserFunction=forces))
    mbs.AddObject(items.ObjectGenericODE1(nodeNumbers=pressure_nodes, rhsUserFunction=rates))


def user_functions(plant: Plant, first_node: int, first_pressure_node: int) -> tuple[Callable, Callable]:
    """Return (forceUserFunction, rhsUserFunction) for the generic objects that hold all machines of a plant."""
    n, width, chambers, topology = plant.size, plant.coordinates, len(plant.crane.layout.chambers), plant.topology
    force, rate = np.zeros((n, width)), np.zeros((n, chambers))
    machines = (topology, plant.P, plant.E, plant.inertia)  # changed in place by `item_values`, as the payload's mass

    starts: list[int] = []

    def first_coordinates(mbs: Any) -> list[int]:
        starts[:] = [mbs.GetNodeODE2Index(first_node), mbs.GetNodeODE1Index(first_pressure_node)]
        return starts

    def force_function(mbs: Any, t: float, number: int, q: Any, v: Any) -> np.ndarray:
        start = (starts or first_coordinates(mbs))[1]
        p = np.asarray(mbs.systemData.GetODE1Coordinates())[start : start + chambers * n]
        motion = (np.asarray(q), np.asarray(v), p)
        if not _all_forces(machines, plant.payload_mass, t, plant.inputs_at(t), motion, force):
            raise CraneError(
                f"{plant.crane.name}: the payload's mass changes at t = {t:g} s, but an Exudyn system has fixed "
                "masses. "
                "Use ExudynEngine.simulate, which changes them, or remove the effect payload_change."
            )
        return force.ravel()

    def rate_function(mbs: Any, t: float, number: int, p: Any) -> np.ndarray:
        start, data = (starts or first_coordinates(mbs))[0], mbs.systemData
        q = np.asarray(data.GetODE2Coordinates())[start : start + width * n]
        v = np.asarray(data.GetODE2Coordinates_t())[start : start + width * n]
        beyond = _all_rates(machines, plant.inputs_at(t), (q, v, np.asarray(p)), plant.guarded, rate)
        if beyond >= 0:
            raise CraneError(
                f"{plant.crane.name}: a cylinder is at the end of its stroke at t = {t:.6g} s (machine {beyond}). Add "
                "the effect end_stop to it, shorten the command, or correct the cylinder's lengths."
            )
        return rate.ravel()

    return force_function, rate_function


@njit
def _all_forces(machines, mass, t, w, motion, out):
    """Fill out (n, nq) with the extra forces of all machines; return False if a payload's mass is another one now.

    machines: as `reduction.Machine`; motion: q, v and p of all machines behind each other, as Exudyn has them.
    """
    (topology, P, E, inertia), (q, v, p) = machines, motion
    n, width = out.shape
    chambers = p.size // n
    arms, lines, same = red.new_arms(topology), np.empty((chambers // 2, geo.N_LINE)), True
    for k in range(n):
        i, j = width * k, chambers * k
        qk, vk, pk = q[i : i + width], v[i : i + width], p[j : j + chambers]
        machine = red.Machine(topology, P[k], E[k], inertia[k])
        red.extra_forces(machine, t, w[k], qk, vk, pk, arms, lines, out[k])
        same = same and hooks.payload_mass(E[k], t, P[k, PAYLOAD]) == mass[k]
    return same


@njit
def _all_rates(machines, w, motion, guarded, out):
    """Fill out (n, chambers) with the pressure rates of all machines; arguments as of `_all_forces`.

    Returns:
        the first machine that is beyond its stroke, or -1; always -1 where that is not to be looked at.
    """
    beyond = -1
    (topology, P, E, inertia), (q, v, p) = machines, motion
    n, chambers = out.shape
    width = q.size // n
    arms, lines = red.new_arms(topology), np.empty((chambers // 2, geo.N_LINE))
    for k in range(n):
        i, j = width * k, chambers * k
        qk, vk = q[i : i + width], v[i : i + width]
        red.arms_of(topology, P[k], inertia[k], qk, arms)
        geo.fill_lines(topology, arms, qk, vk, lines)
        hyd.all_pressure_rates(topology, P[k], E[k], w[k], lines, p[j : j + chambers], out[k])
        if guarded and beyond < 0 and trapezoidal.stroke_end(P[k], E[k], lines, p[j : j + chambers]) > 0:
            beyond = k
    return beyond


def redundant(plant: Plant, state: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return (q, v) of one state: redundant coordinates and velocities with all joints closed.

    Raises:
        CraneError: the pose cannot be reached.
    """
    width, x = plant.coordinates, np.asarray(state, dtype=float)
    q, v = np.zeros(width), np.zeros(width)
    arms, N = red.new_arms(plant.topology), np.zeros((plant.velocities, width))
    if not red.place(plant.topology, plant.P[0], plant.E[0], plant.inertia[0], x, arms, N, q, v):
        raise geo.unreachable(plant.crane, x)
    return q, v


def consistent(plant: Plant, state: np.ndarray, w: np.ndarray, time: float) -> tuple[np.ndarray, ...]:
    """Return (q, v, a, p, dp) of one state of the first machine: joints closed, accelerations and pressure rates
    consistent.

    Args:
        w: inputs, with or without disturbances behind;  time: in s.

    Raises:
        CraneError: the pose cannot be reached.
    """
    width, topology, wide = plant.coordinates, plant.topology, np.zeros(plant.inputs.shape[1])
    wide[: w.size] = w
    q, v, a = np.zeros(width), np.zeros(width), np.zeros(width)
    chambers, nu = len(plant.crane.layout.chambers), plant.velocities
    p, dp, held = np.zeros(chambers), np.zeros(chambers), np.zeros((hyd.N_BALANCES, chambers))
    arms, lines, N = red.new_arms(topology), trapezoidal.new_lines(topology), np.zeros((nu, width))
    x, machine = np.asarray(state, dtype=float), red.Machine(topology, plant.P[0], plant.E[0], plant.inertia[0])
    scratch, now = red.Scratch(arms, lines, N), red.Motion(q, v, a, p, dp, held, np.zeros(nu))
    if trapezoidal.start(machine, time, x, wide, np.zeros(width), scratch, now) != trapezoidal.ITERATING:
        raise geo.unreachable(plant.crane, x)
    return q, v, a, p, dp


def main_system() -> tuple[Any, Any]:
    """Return (system container, main system), both new and empty."""
    container = exu.SystemContainer()
    return container, container.AddSystem()


def set_initial_rates(mbs: Any, plant: Plant, time: float = 0.0) -> None:
    """Give Exudyn the pressure rates that its initial state has; call it after `mbs.Assemble()`, before `SolveDynamic`.

    Exudyn finds initial accelerations itself, but starts with pressure rates of zero, which spoils the first step of
    the trapezoidal rule where a valve is open or a cylinder moves at the start.

    Raises:
        CraneError: the system is not assembled.
    """
    data, initial = mbs.systemData, exu.ConfigurationType.Initial
    n, width, chambers = plant.size, plant.coordinates, len(plant.crane.layout.chambers)
    if not len(data.GetODE2Coordinates(initial)):
        raise CraneError("set_initial_rates: the system is not assembled. Call mbs.Assemble() before.")
    first = mbs.GetNodeODE2Index(next(iter(plant.nodes[0].values())))
    start = mbs.GetNodeODE1Index(plant.pressure_nodes[0][0])
    q = np.array(data.GetODE2Coordinates(initial))[first : first + n * width]
    v = np.array(data.GetODE2Coordinates_t(initial))[first : first + n * width]
    p = np.array(data.GetODE1Coordinates(initial))[start : start + chambers * n]
    rates, all_rates = np.zeros((n, chambers)), np.array(data.GetODE1Coordinates_t(initial))
    machines = (plant.topology, plant.P, plant.E, plant.inertia)
    _all_rates(machines, plant.inputs_at(time), (q, v, p), False, rates)
    all_rates[start : start + chambers * n] = rates.ravel()
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

    Raises:
        CraneError: a step or duration that is not positive.
    """
    if not (0.0 < step < math.inf and 0.0 < duration < math.inf):
        raise CraneError(f"settings: step = {step:g} s and duration = {duration:g} s. Give positive times.")
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
