"""Balances at one state: every term of the equations of motion and of the pressures by name."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from . import trapezoidal
from .channels import FULLY_OPEN
from .crane import Crane
from .effects import hooks
from .errors import CraneError, listed
from .geometry import LENGTH, RATE
from .machine import BODIES


class Reduction(NamedTuple):
    """A machine reduced to its independent coordinates at one state.

    Attributes:
        crane, P, E, topology: what it is of.
        inertia, arms, lines: of bodies, joints and cylinders, as `reduction` and `trapezoidal` lay them out.
        v, centripetal: velocities of the bodies, and their accelerations that the coordinates' rates alone make,
            (3 bodies + …,).
        N: velocities of the bodies by independent rates, (nu, 3 bodies + …). M: mass matrix (nu, nu).
        D: rates of the cylinders' lengths by independent rates, (cylinders, nu).
    """

    crane: Crane
    P: np.ndarray
    E: np.ndarray
    topology: np.ndarray
    inertia: np.ndarray
    arms: np.ndarray
    lines: np.ndarray
    v: np.ndarray
    centripetal: np.ndarray
    N: np.ndarray
    M: np.ndarray
    D: np.ndarray


def reduced(crane: Crane, state: np.ndarray, time: float) -> Reduction:
    """Return the reduction at one state.

    Raises:
        CraneError: the state has another length, or the machine cannot stand like that.
    """
    P, E, topology = crane.parameter_vector(), crane.effect_vector(), crane.machine.topology
    width, nu = trapezoidal.widths(topology, hooks.swings(E))
    x = checked_state(crane, state)
    inertia, N = np.zeros((topology[0, BODIES] + 1, 4)), np.zeros((nu, width))
    arms, lines = red.new_arms(topology), trapezoidal.new_lines(topology)
    q, v, bias, work, M = np.zeros(width), np.zeros(width), np.zeros(width), np.zeros(width), np.zeros((nu, nu))
    red.inertias(topology, P, E, time, inertia)
    if not red.place(topology, P, E, inertia, x, arms, N, q, v):
        raise geo.unreachable(crane, x)
    red.centripetal(topology, arms, v, bias)
    red.reduced_mass(inertia, N, work, M)
    geo.fill_lines(topology, arms, q, v, lines)
    D = np.array([[geo.line_rate(topology, arms, row, lines, c) for row in N] for c in range(len(lines))])
    return Reduction(crane, P, E, topology, inertia, arms, lines, v, bias, N, M, D)


def checked_state(crane: Crane, state: np.ndarray) -> np.ndarray:
    """Return one state (nx,) as an array. Raises CraneError where it has another shape."""
    x = np.ascontiguousarray(state, dtype=float)
    if x.shape != (size_of_state(crane),):
        names = state_names(crane)
        raise CraneError(
            f"{crane.name}: a state has {len(names)} numbers, found shape {x.shape}. Give {' '.join(names)}."
        )
    return x


def check_spools(valves: Sequence[str], w: np.ndarray, *, step: bool) -> None:
    """Raise CraneError for a spool position in w, whose first columns are the `valves`, that is missing or beyond
    ±`channels.FULLY_OPEN`; w is (2, m) or (2, n, m) at the start and the end of a step, or of a run (N, m).
    """
    n = len(valves)
    if step and w.ndim == 2:  # a filter's step, a thousand times a second: on so few, plain Python is faster
        start, end = w.tolist()
        if not [u for u in start[:n] + end[:n] if not -FULLY_OPEN <= u <= FULLY_OPEN]:
            return
    spools = w[..., :n]
    bad = np.argwhere(~(np.abs(spools) <= FULLY_OPEN))
    if bad.size:
        at, *row, valve = bad[0].tolist()
        of_row = f" of row {row[0]}" if row else ""
        place = f"the {('start', 'end')[at]} of the step{of_row}" if step else f"sample {at}"
        raise CraneError(
            f"{'propagate' if step else 'simulate'}: the spool position at {place} is {valves[valve]} = "
            f"{spools[tuple(bad[0])]:g}, expected a number from -1 to 1; only pp and pt may be NaN. Scale the commands "
            "(50 % is 0.5), or fill in what is missing."
        )


def checked_inputs(crane: Crane, w: np.ndarray) -> np.ndarray:
    """Return the inputs at one instant (m,) as an array.

    Raises:
        CraneError: they are as many as neither `Layout.inputs` nor, with disturbances, `all_inputs`.
    """
    given, lay = np.ascontiguousarray(w, dtype=float), crane.layout
    if given.shape not in ((len(lay.inputs),), (len(lay.all_inputs),)):
        raise CraneError(
            f"{crane.name}: the inputs w have shape {given.shape}, expected ({len(lay.inputs)},) with "
            f"[{' '.join(lay.inputs)}], or ({len(lay.all_inputs)},) with the disturbances behind. NaN for pp or pt is "
            "the crane's own supply."
        )
    return given


def state_names(crane: Crane) -> tuple[str, ...]:
    """Return the names of the crane's states: two more where its payload hangs on a pendulum."""
    return crane.layout.all_states if hooks.swings(crane.effect_vector()) else crane.layout.states


def size_of_state(crane: Crane) -> int:
    """Return how many numbers a state of the crane has."""
    return len(state_names(crane))


def weightless(crane: Crane, mass: float, time: float) -> CraneError:
    """Return the error that refuses a payload of a mass in kg, at a time in s."""
    return CraneError(
        f"{crane.name}: the payload has a mass of {mass:g} kg at t = {time:g} s. A mass cannot be negative, and one "
        "that swings cannot be zero: correct payload.mass or the effect payload_change, or remove payload_swing."
    )


def check_payload(crane: Crane, time: np.ndarray) -> None:
    """Raise CraneError where effects make the payload's mass negative at an instant of `time` (n,) in s, or leave none
    to swing.
    """
    effects, nominal, mass = crane.effect_vector(), crane["payload.mass"], hooks.plain("payload_mass")
    masses = np.array([mass(effects, t, nominal) for t in time] if crane.effects else [nominal])
    worst = int(np.argmin(masses))
    if masses[worst] < 0.0 or (masses[worst] == 0.0 and hooks.swings(effects)):
        raise weightless(crane, float(masses[worst]), float(time[worst]))


def vapour_pressure(crane: Crane) -> float:
    """Return the pressure in Pa, absolute or gauge as the crane's are, at which its oil boils: the lowest that a gauge
    shows.
    """
    return float(hyd.vapour_pressure(crane.parameter_vector()))


def visible(crane: Crane, states: np.ndarray) -> np.ndarray:
    """Return states (…, nx) with the pressures that a gauge would show: vapour pressure where the state remembers a
    void.
    """
    shown, p = np.array(states, dtype=float), crane.layout.pressures
    shown[..., p] = np.maximum(shown[..., p], vapour_pressure(crane))
    return shown


def state_text(crane: Crane, state: np.ndarray) -> str:
    """Return a state (nx,) as people say it: coordinates in deg or m, their rates, what effects add, pressures in
    bar.
    """
    lay, shown = crane.layout, visible(crane, state)
    others = [*zip(lay.rates, shown[lay.velocities], strict=True), *zip(lay.added, shown[lay.extra], strict=False)]
    told = [f"{name} = {value:.4g} {lay.unit_of(name)}" for name, value in others]
    pressures = listed(lay.chambers, shown[lay.pressures] / 1e5, "{:.2f} bar")
    return ", ".join([geo.pose_text(lay, shown[lay.positions]), *told, pressures])


def stroke_end(crane: Crane, state: np.ndarray) -> tuple[str, str, float]:
    """Return the cylinder that is at an end of its stroke at a state, at which, and its length in m; "" if none is."""
    r = reduced(crane, state, 0.0)
    code = trapezoidal.stroke_end(r.P, r.E, r.lines, state[crane.layout.pressures]) - 1
    if code < 0:
        return "", "", math.nan
    end = "retracted" if code % 2 == 0 else "extended"
    return crane.layout.cylinders[code // 2], end, float(r.lines[code // 2, LENGTH])


def stroke_message(crane: Crane, state: np.ndarray) -> str:
    """Return in words which cylinder is at which end of its stroke at a state."""
    cylinder, end, length = stroke_end(crane, state)
    return (
        f"the {cylinder} cylinder is fully {end} (length {length:.4f} m, the end of its stroke)"
        if cylinder
        else "the end of a stroke is reached"
    )


def check_less_loaded(crane: Crane, pressures: np.ndarray, where: str) -> None:
    """Raise CraneError where the pressure of a cylinder's less loaded chamber (cylinders,), which `where` gives, is one
    that no chamber can have.
    """
    floor = vapour_pressure(crane)
    for cylinder, p in zip(crane.layout.cylinders, pressures, strict=True):
        if not p >= floor:
            raise CraneError(
                f"{crane.name}: {where} of {p / 1e5:g} bar for the {cylinder} cylinder's less loaded chamber is below "
                f"vapour pressure, here {floor / 1e5:g} bar. No chamber can be at that; give a higher one."
            )


def check_start(crane: Crane) -> None:
    """Raise CraneError where a cylinder cannot be as long as the crane file's start has it, or a chamber not at its
    pressure.
    """
    check_less_loaded(crane, np.array(crane.initial.less_loaded_pressure), "initial.less_loaded_pressure")
    state = np.zeros(size_of_state(crane))
    state[crane.layout.positions] = crane.initial.pose
    cylinder, _, length = stroke_end(crane, state)
    if cylinder:
        shortest, longest = crane.stroke(cylinder)
        raise CraneError(
            f"{crane.name}: [initial] {geo.pose_text(crane.layout, state)}: the {cylinder} cylinder would be "
            f"{length:.4f} m long; cylinders.{cylinder}.empty_length and chamber_range let it be "
            f"{shortest:.4f} to {longest:.4f} m. Choose another pose in [initial], or correct these lengths or the "
            "cylinder's pins."
        )


def terms(crane: Crane, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
    """Return every term of the balances at one state by name, in SI.

    Args:
        state: (nx,);  w: (m,), as `Layout.inputs` or, with disturbances behind, `all_inputs`;  time in s.

    Returns:
        Pin-to-pin lengths and their rates by the layout ("s1", "ds1"); dependent coordinates and their derivatives by
            independent ones ("z2", "dz2_dz4"), the bodies' angles ("phi_bracket_1").
        Chamber by chamber port flows "Q1" with the signs of (34), "leak1" into the chamber (disturbances included),
            "Be1", "V1", lengths "l1", amounts "N1", rates "dp1"; cylinder by cylinder piston speeds "v_h1", forces with
            friction "F1", "Fmu1".
        Reduced mass "M_z1_z4", generalised forces "Qg_z1" (weights), "Qv" (inertia by velocity), "Qh" (cylinders), "Qj"
            (joints, forces on the payload's point, pendulum's damping); "ddz1", "ddtheta". A pendulum's own equation is
            eliminated from M and the Q; without one ddtheta is 0.
        Supply "pp", "pt"; "x_O", "y_O" of all points.

    Raises:
        CraneError: a state or inputs of another length, or a machine that cannot stand like that.
    """
    x, given, lay = checked_state(crane, state), checked_inputs(crane, w), crane.layout
    wide = np.zeros(len(lay.all_inputs))
    wide[: given.size] = given
    r = reduced(crane, x, time)
    p = x[lay.pressures].copy()
    return _geometry_terms(crane, x, r) | _pressure_terms(r, p, wide) | _motion_terms(r, p, wide, time)


def _geometry_terms(crane: Crane, x: np.ndarray, r: Reduction) -> dict[str, float]:
    lay, machine = crane.layout, crane.machine
    pose, number = geo.pose(crane, *x[lay.positions]), {b: i for i, b in enumerate(machine.bodies)}
    out = dict(zip(lay.lengths, r.lines[:, LENGTH], strict=True))
    out |= {f"d{n}": rate for n, rate in zip(lay.lengths, r.lines[:, RATE], strict=True)}
    turning = r.N[:, 2 : 3 * len(number) : 3]  # of bodies by independent velocities
    for body in machine.dependent:
        joint = machine.carriers[body]
        carried = joint.carrier in number
        angle = pose.angles[body][0] - (pose.angles[joint.carrier][0] if carried else 0.0)
        rates = turning[:, number[body]] - (turning[:, number[joint.carrier]] if carried else 0.0)
        out[joint.coordinate] = math.remainder(angle, 2.0 * math.pi)
        out |= {f"d{joint.coordinate}_d{n}": rates[i] for i, n in enumerate(lay.coordinates)}
    out |= {f"phi_{body}": math.remainder(angle[0], 2.0 * math.pi) for body, angle in pose.angles.items()}
    for name, place in pose.points.items():
        out |= {f"x_{name}": place[0, 0], f"y_{name}": place[0, 1]}
    return {k: float(v) for k, v in out.items()}


def _pressure_terms(r: Reduction, p: np.ndarray, w: np.ndarray) -> dict[str, float]:
    P, E, topology, lines, lay = r.P, r.E, r.topology, r.lines, r.crane.layout
    balances, rates, forces = np.zeros((hyd.N_BALANCES, p.size)), np.zeros(p.size), np.zeros(len(lines))
    hyd.chamber_balances(topology, P, E, w, lines, p, balances)
    hyd.pressure_rates(balances, rates)
    amounts, real = balances[hyd.AMOUNT], balances[hyd.REAL]
    hyd.cylinder_forces(topology, P, E, w, lines, p, forces)
    pp, pt = hyd.supply_loop(topology, P, E, w, real)
    out = {"pp": pp, "pt": pt} | {f"N{i + 1}": n for i, n in enumerate(amounts)}
    out |= {f"d{name}": rate for name, rate in zip(lay.chambers, rates, strict=True)}
    first = hyd.flow_disturbances(len(lines))
    for c, s in enumerate(lines[:, LENGTH]):
        a, b = 2 * c + 1, 2 * c + 2
        pa, pb = real[2 * c], real[2 * c + 1]
        out[f"Q{a}"], out[f"Q{b}"], _, _ = hyd.port_flows(topology, P, E, c, w[c], pp, pt, pa, pb)
        leak = hyd.leakage(P, E, c, pa, pb)
        out[f"leak{a}"], out[f"leak{b}"] = leak[0] + w[first + a - 1], leak[1] + w[first + b - 1]
        names = (f"l{a}", f"l{b}", f"V{a}", f"V{b}", f"Be{a}", f"Be{b}")
        out |= dict(zip(names, hyd.chambers(P, E, c, s, p[2 * c], p[2 * c + 1]), strict=True))
        speed = balances[hyd.SPEED, 2 * c]
        out |= {f"Fmu{c + 1}": hyd.friction_force(P, c, speed), f"F{c + 1}": forces[c], f"v_h{c + 1}": speed}
    return {k: float(v) for k, v in out.items()}


def _motion_terms(r: Reduction, p: np.ndarray, w: np.ndarray, time: float) -> dict[str, float]:
    P, E, N, M, lay, topology = r.P, r.E, r.N, r.M, r.crane.layout, r.topology
    forces = np.zeros(len(r.lines))
    hyd.cylinder_forces(topology, P, E, w, r.lines, p, forces)
    weight, joint, inertial = (np.zeros_like(r.v) for _ in range(3))
    red.add_gravity(topology, P, E, r.inertia, weight)
    red.add_joint_forces(topology, E, time, w, r.arms, r.v, joint)
    red.mass_times(r.inertia, r.centripetal, inertial)
    parts = {"Qg": N @ weight, "Qv": -N @ inertial, "Qh": r.D.T @ forces, "Qj": N @ joint}
    acceleration = np.linalg.solve(M, sum(parts.values()))
    z, swings = lay.positions, len(lay.coordinates)
    if len(N) > swings:  # the pendulum's own row, solved for its acceleration and put into the others
        share = M[z, swings] / M[swings, swings]
        M = M[z, z] - np.outer(share, M[swings, z])
        parts = {name: q[z] - share * q[swings] for name, q in parts.items()}
    out = {f"{name}_{axis}": q[i] for name, q in parts.items() for i, axis in enumerate(lay.coordinates)}
    names = lay.coordinates
    out |= {f"M_{names[i]}_{names[j]}": M[i, j] for i in range(len(names)) for j in range(i, len(names))}
    out["ddtheta"] = 0.0
    out |= {f"dd{name}": a for name, a in zip((*names, *lay.added), acceleration, strict=False)}
    return {k: float(v) for k, v in out.items()}
