"""Balances at one state: the static start, and every term of the equations of motion and of the pressures by name."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import faulty_laws, trapezoidal
from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from .crane import Crane
from .effects import hooks
from .errors import CraneError
from .geometry import LENGTH, RATE
from .machine import BODIES


def _reduce(crane: Crane, state: np.ndarray, time: float) -> dict[str, Any]:
    """Return the arrays of the reduction at one state: inertia, arms, lines, N, q, v, a_centripetal, M and the
    cylinders' rates D.
    """
    P, E, topology = crane.parameter_vector(), crane.effect_vector(), crane.machine.topology
    width, nu = trapezoidal.widths(topology, hooks.pendulum(E)[0] > 0.0)
    x = np.asarray(state, dtype=float)
    if x.shape != (size_of_state(crane),):
        raise CraneError(f"{crane.name}: a state has {size_of_state(crane)} numbers, found shape {x.shape}.")
    inertia, N = np.zeros((topology[0, BODIES] + 1, 4)), np.zeros((nu, width))
    arms, lines = red.new_arms(topology), trapezoidal.new_lines(topology)
    q, v, bias, work, M = np.zeros(width), np.zeros(width), np.zeros(width), np.zeros(width), np.zeros((nu, nu))
    red.inertias(topology, P, E, time, inertia)
    if not red.place(topology, P, E, inertia, x, arms, N, q, v):
        raise geo.unreachable(crane, x)
    red.centripetal(topology, arms, v, bias)
    red.reduced_mass(inertia, N, work, M)
    geo.fill_lines(topology, arms, q, v, lines)
    D = np.array(
        [[geo.line_rate(topology, arms, row, lines, c) for row in N] for c in range(len(lines))]
    )  # ds_c / du_i
    return locals()


def size_of_state(crane: Crane) -> int:
    """Return how many numbers a state of the crane has: two more where its payload hangs on a pendulum."""
    swings = hooks.pendulum(crane.effect_vector())[0] > 0.0
    return len(crane.layout.all_states if swings else crane.layout.states)


def static_start(crane: Crane, *pose: float | np.ndarray, less_loaded: Any = 20e5) -> np.ndarray:
    """Return the state (nx,) at rest with valves closed and forces in balance.

    In each cylinder the less loaded chamber has the given pressure, the other follows from the balance of forces. A
    payload on a pendulum hangs straight down (along gravity where that is turned).

    Args:
        pose: independent coordinates, rad or m.
        less_loaded: pressure in Pa, one number or one per cylinder; may stand behind the coordinates.

    Raises:
        CraneError: the pose cannot be reached, a pressure below vapour pressure, or cylinders without leverage there.
    """
    lay = crane.layout
    n = len(lay.coordinates)
    if len(pose) == n + 1:
        *pose, less_loaded = pose  # type: ignore[assignment]
    if len(pose) != n:
        raise CraneError(f"{crane.name}: a pose has {n} coordinates ({', '.join(lay.coordinates)}), found {len(pose)}.")
    P, E = crane.parameter_vector(), crane.effect_vector()
    gx, gy = hooks.gravity(E, 0.0, -1.0)
    state = np.zeros(size_of_state(crane))
    state[lay.positions] = pose
    state[lay.extra][:1] = math.atan2(gx, -gy)
    low = np.broadcast_to(np.asarray(less_loaded, dtype=float), len(lay.cylinders))
    floor = vapour_pressure(crane)
    if not np.all(low >= floor):
        raise CraneError(
            f"{crane.name}: the less loaded chamber cannot be at {low.min():g} Pa, below vapour pressure ({floor:g} "
            "Pa)."
        )
    r = _reduce(crane, state, 0.0)
    forces = _holding_forces(crane, r, state)
    for c, force in enumerate(forces):
        state[lay.pressures_of(c)] = _pressures(P, E, c, r["lines"][c, LENGTH], force, low[c])
    if not np.isfinite(state).all():
        raise faulty_laws.where_start_failed(crane, state) or CraneError(
            f"{crane.name}: there is no static start at {geo.told(lay, state)}: "
            "the forces there are not finite. Look for numbers of the crane that are out of proportion."
        )
    return state


def _holding_forces(crane: Crane, r: dict[str, Any], state: np.ndarray) -> np.ndarray:
    """Return the cylinder forces (cylinders,) in N that hold weights and tip force at rest."""
    lay, f = crane.layout, np.zeros(r["width"])
    red.add_gravity(r["topology"], r["P"], r["E"], r["inertia"], f)
    rest, w = np.zeros(r["width"]), np.zeros(len(lay.all_inputs))
    red.add_joint_forces(r["topology"], r["E"], 0.0, w, r["arms"], rest, f)
    leverage = r["D"][:, lay.positions]
    if np.abs(leverage).max(axis=1).min() < 1e-6 or abs(np.linalg.det(leverage)) < 1e-9:
        name = lay.cylinders[int(np.abs(leverage).max(axis=1).argmin())]
        raise CraneError(
            f"{crane.name}: the {name} cylinder has no leverage at {geo.told(lay, state)}, so no pressure balances the "
            "load. Start at another pose."
        )
    return np.linalg.solve(leverage.T, -(r["N"] @ f)[lay.positions])


def _pressures(P: np.ndarray, E: np.ndarray, c: int, s: float, force: float, low: float) -> tuple[float, float]:
    """Return (p_piston, p_rod) that give a force at rest, with the less loaded chamber at `low`.

    Effects may hold a part of it (a seal that sticks, an end stop): by the cylinder's length, which a spring in series
    lets depend on the pressures. So the pressures are found again with what the effects hold at them.
    """
    area_a, area_b = hyd.areas(P, c)
    found = low, low
    for _ in range(50):
        rest, before = force - hyd.extra_force(P, E, c, s, 0.0, found[0], found[1]), found
        found = (
            ((rest + low * area_b) / area_a, low)
            if rest >= low * (area_a - area_b)
            else (low, (low * area_a - rest) / area_b)
        )
        if abs(found[0] - before[0]) + abs(found[1] - before[1]) <= 1e-6:
            break
    return found


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


def stroke_message(crane: Crane, state: np.ndarray) -> str:
    """Return which cylinder is at which end of its stroke at a state."""
    r = _reduce(crane, state, 0.0)
    code = trapezoidal.stroke_end(r["P"], r["E"], r["lines"], state[crane.layout.pressures]) - 1
    if code < 0:
        return "the end of a stroke is reached"
    end = "retracted" if code % 2 == 0 else "extended"
    return (
        f"the {crane.layout.cylinders[code // 2]} cylinder is fully {end} (length {r['lines'][code // 2, LENGTH]:.4f} "
        "m)"
    )


def terms(crane: Crane, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
    """Return every term of the balances at one state by name, in SI.

    Args:
        state: (nx,);  w: `Layout.inputs`, or with disturbances behind;  time in s.

    Returns:
        Pin-to-pin lengths and their rates by the layout ("s1", "ds1"); dependent coordinates and their derivatives by
            independent ones
        ("z2", "dz2_dz4"), the bodies' angles ("phi_bracket_1"); chamber by chamber port flows "Q1" with the signs of
            (34), "leak1"
        into the chamber (disturbances included), "Be1", "V1", lengths "l1", amounts "N1", rates "dp1"; cylinder by
            cylinder piston speeds
        "v_h1", forces with friction "F1", "Fmu1"; reduced mass "M_z1_z4", generalised forces "Qg_z1" (weights), "Qv"
            (inertia
        by velocity), "Qh" (cylinders), "Qj" (joints, forces on the payload's point, pendulum's damping); "ddz1",
            "ddtheta"; supply "pp",
        "pt"; "x_O", "y_O" of all points. A pendulum's own equation is eliminated from M and the Q; without one ddtheta
            is 0.
    """
    x, lay = np.ascontiguousarray(state, dtype=float), crane.layout
    wide = np.zeros(len(lay.all_inputs))
    wide[: np.size(w)] = w
    r = _reduce(crane, x, time)
    p = x[lay.pressures].copy()
    return _geometry_terms(crane, x, r) | _pressure_terms(r, p, wide) | _motion_terms(r, p, wide, time)


def _geometry_terms(crane: Crane, x: np.ndarray, r: dict[str, Any]) -> dict[str, float]:
    lay, machine = crane.layout, crane.machine
    pose, number = geo.pose(crane, *x[lay.positions]), {b: i for i, b in enumerate(machine.bodies)}
    out = dict(zip(lay.lengths, r["lines"][:, LENGTH], strict=True))
    out |= {f"d{n}": rate for n, rate in zip(lay.lengths, r["lines"][:, RATE], strict=True)}
    turning = r["N"][:, 2 : 3 * len(number) : 3]  # of bodies by independent velocities
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


def _pressure_terms(r: dict[str, Any], p: np.ndarray, w: np.ndarray) -> dict[str, float]:
    P, E, topology, lines, lay = r["P"], r["E"], r["topology"], r["lines"], r["crane"].layout
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
        leak = hooks.leakage(E, c, pa, pb)
        out[f"leak{a}"], out[f"leak{b}"] = leak[0] + w[first + a - 1], leak[1] + w[first + b - 1]
        names = (f"l{a}", f"l{b}", f"V{a}", f"V{b}", f"Be{a}", f"Be{b}")
        out |= dict(zip(names, hyd.chambers(P, E, c, s, p[2 * c], p[2 * c + 1]), strict=True))
        speed = balances[hyd.SPEED, 2 * c]
        out |= {f"Fmu{c + 1}": hyd.friction_force(P, c, speed), f"F{c + 1}": forces[c], f"v_h{c + 1}": speed}
    return {k: float(v) for k, v in out.items()}


def _motion_terms(r: dict[str, Any], p: np.ndarray, w: np.ndarray, time: float) -> dict[str, float]:
    P, E, N, M, lay, topology = r["P"], r["E"], r["N"], r["M"], r["crane"].layout, r["topology"]
    forces = np.zeros(len(r["lines"]))
    hyd.cylinder_forces(topology, P, E, w, r["lines"], p, forces)
    weight, joint, inertial = (np.zeros(r["width"]) for _ in range(3))
    red.add_gravity(topology, P, E, r["inertia"], weight)
    red.add_joint_forces(topology, E, time, w, r["arms"], r["v"], joint)
    red.mass_times(r["inertia"], r["bias"], inertial)
    parts = {"Qg": N @ weight, "Qv": -N @ inertial, "Qh": r["D"].T @ forces, "Qj": N @ joint}
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
