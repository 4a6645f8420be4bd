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
from .errors import CraneError, listed
from .parameters import POINT_NAMES


def _reduce(crane: Crane, state: np.ndarray, time: float) -> dict[str, Any]:
    """Return the arrays of the reduction at one state: inertia, arms, N, q, v, a_centripetal, M and the cylinders' rates."""
    P, E = crane.parameter_vector(), crane.effect_vector()
    width = 14 if hooks.pendulum(E)[0] > 0.0 else 12
    nu = width // 2 - 4
    x = np.asarray(state, dtype=float)
    if x.shape != (size_of_state(crane),):
        raise CraneError(f"{crane.name}: a state has {size_of_state(crane)} numbers, found shape {x.shape}.")
    inertia, arms, N = np.zeros((5, 4)), np.zeros((red.N_ARMS, 2)), np.zeros((nu, width))
    q, v, bias, work, M = np.zeros(width), np.zeros(width), np.zeros(width), np.zeros(width), np.zeros((nu, nu))
    red.inertias(P, E, time, inertia)
    if not red.place(P, E, inertia, x, arms, N, q, v):
        raise geo.unreachable(crane.name, x[0], x[1])
    red.centripetal(arms, v, bias)
    red.reduced_mass(inertia, N, work, M)
    kinematics = red.cylinder_kinematics(P, arms, q, v)
    D = np.array([red.cylinder_rates(arms, row, *kinematics[4:]) for row in N])  # ds_c / du_i
    return locals()


def size_of_state(crane: Crane) -> int:
    """Return how many numbers a state of the crane has: two more where its payload hangs on a pendulum."""
    swings = hooks.pendulum(crane.effect_vector())[0] > 0.0
    return len(crane.layout.all_states if swings else crane.layout.states)


def static_start(crane: Crane, z1: float, z4: float, less_loaded: Any = 20e5) -> np.ndarray:
    """Return the state (nx,) at rest with valves closed and forces in balance.

    In each cylinder the less loaded chamber has the given pressure, the other follows from the balance of moments. A
    payload on a pendulum hangs straight down (along gravity where that is turned).

    Args:
        z1, z4: angles in rad.
        less_loaded: pressure in Pa, one number or one per cylinder.

    Raises:
        CraneError: the pose cannot be reached, a pressure below vapour pressure, or a cylinder without leverage there.
    """
    P, E = crane.parameter_vector(), crane.effect_vector()
    gx, gy = hooks.gravity(E, 0.0, -1.0)
    lay = crane.layout
    state = np.zeros(size_of_state(crane))
    state[lay.positions] = z1, z4
    state[lay.extra][:1] = math.atan2(gx, -gy)
    pose = listed(lay.coordinates, np.degrees(state[lay.positions]), "{:.2f} deg")
    low = np.broadcast_to(np.asarray(less_loaded, dtype=float), len(lay.cylinders))
    floor = vapour_pressure(crane)
    if not np.all(low >= floor):
        raise CraneError(
            f"{crane.name}: the less loaded chamber cannot be at {low.min():g} Pa, below vapour pressure ({floor:g} Pa)."
        )
    r = _reduce(crane, state, 0.0)
    needed = -_at_rest(crane, r)
    for c, name in enumerate(lay.cylinders):
        leverage = r["D"][c, c]
        if abs(leverage) < 1e-6:
            raise CraneError(
                f"{crane.name}: the {name} cylinder has no leverage at {pose}, so no pressure balances the load. Start at another pose."
            )
        state[lay.pressures_of(c)] = _pressures(P, E, c, r["kinematics"][c], needed[c] / leverage, low[c])
    if not np.isfinite(state).all():
        raise faulty_laws.where_start_failed(crane, state) or CraneError(
            f"{crane.name}: there is no static start at {pose}: "
            "the forces there are not finite. Look for numbers of the crane that are out of proportion."
        )
    return state


def _at_rest(crane: Crane, r: dict[str, Any]) -> np.ndarray:
    """Return the generalised forces (nu,) of weights and tip force."""
    f = np.zeros(r["width"])
    red.add_gravity(r["P"], r["E"], r["inertia"], f)
    red.add_joint_forces(r["E"], 0.0, np.zeros(hyd.N_W), r["arms"], np.zeros(r["width"]), f)
    return r["N"] @ f


def _pressures(P: np.ndarray, E: np.ndarray, c: int, s: float, force: float, low: float) -> tuple[float, float]:
    """Return (p_piston, p_rod) that give a force at rest, with the less loaded chamber at `low`.

    Effects may hold a part of it (a seal that sticks, an end stop): by the cylinder's length, which a spring in series lets depend
    on the pressures. So the pressures are found again with what the effects hold at them.
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
    """Return the pressure in Pa, absolute or gauge as the crane's are, at which its oil boils: the lowest that a gauge shows."""
    return float(hyd.vapour_pressure(crane.parameter_vector()))


def visible(crane: Crane, states: np.ndarray) -> np.ndarray:
    """Return states (…, nx) with the pressures that a gauge would show: vapour pressure where the state remembers a void."""
    shown, p = np.array(states, dtype=float), crane.layout.pressures
    shown[..., p] = np.maximum(shown[..., p], vapour_pressure(crane))
    return shown


def stroke_message(crane: Crane, state: np.ndarray) -> str:
    """Return which cylinder is at which end of its stroke at a state."""
    r = _reduce(crane, state, 0.0)
    s1, s2 = r["kinematics"][:2]
    code = trapezoidal.stroke_end(r["P"], r["E"], s1, s2, state[crane.layout.pressures]) - 1
    if code < 0:
        return "the end of a stroke is reached"
    end = "retracted" if code % 2 == 0 else "extended"
    return f"the {crane.layout.cylinders[code // 2]} cylinder is fully {end} (length {(s1, s2)[code // 2]:.4f} m)"


def terms(crane: Crane, state: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
    """Return every term of the balances at one state by name, in SI.

    Args:
        state: (nx,);  w: (4,) [U1 U2 pp pt], or (12,) with disturbances behind;  time in s.

    Returns:
        Pin-to-pin lengths "s1", "s2", "ds1", "ds2"; loop "z2", "z3", "dz2_dz4", "dz3_dz4", "phi_bracket_1", "phi_bracket_2";
        port flows "Q1".."Q4" with the signs of (34); "leak1".."leak4" into the chambers (disturbances included); "Be1".."Be4",
        "V1".."V4", lengths "l1".."l4", "dp1".."dp4"; piston speeds "v_h1", "v_h2"; forces "F1", "F2" with friction, "Fmu1",
        "Fmu2"; reduced mass "M11", "M12", "M22"; generalised forces "Qg" (weights), "Qv" (inertia by velocity), "Qh"
        (cylinders), "Qj" (joints, forces on E, pendulum's damping) of z1 and z4; "ddz1", "ddz4", "ddtheta"; supply "pp", "pt";
        "x_O", "y_O", ... of all points. A pendulum's own equation is eliminated from M and the Q; without one ddtheta is 0.
    """
    x = np.ascontiguousarray(state, dtype=float)
    wide = np.zeros(hyd.N_W)
    wide[: np.size(w)] = w
    r = _reduce(crane, x, time)
    p = x[crane.layout.pressures].copy()
    return _geometry_terms(crane, x, r) | _pressure_terms(r, p, wide) | _motion_terms(r, p, wide, time)


def _geometry_terms(crane: Crane, x: np.ndarray, r: dict[str, Any]) -> dict[str, float]:
    pose = geo.pose(crane, x[0], x[1])
    lengths = crane.layout.lengths
    out = dict(zip((*lengths, *(f"d{n}" for n in lengths)), r["kinematics"], strict=False))
    out |= {"z2": pose.z2[0], "z3": pose.z3[0], "dz2_dz4": pose.dz2_dz4[0], "dz3_dz4": pose.dz3_dz4[0]}
    out |= {"phi_bracket_1": x[0] + pose.z2[0], "phi_bracket_2": x[0] + pose.z2[0] + pose.z3[0]}
    for name, (px, py) in zip(POINT_NAMES, pose.points[0], strict=True):
        out |= {f"x_{name}": px, f"y_{name}": py}
    return {k: float(v) for k, v in out.items()}


def _pressure_terms(r: dict[str, Any], p: np.ndarray, w: np.ndarray) -> dict[str, float]:
    P, E = r["P"], r["E"]
    s1, s2, ds1, ds2 = r["kinematics"][:4]
    balances, rates = np.zeros((hyd.N_BALANCES, 4)), np.zeros(4)
    *speeds, _ = hyd.chamber_balances(P, E, w, s1, s2, ds1, ds2, p, balances)
    hyd.pressure_rates(balances, *speeds, rates)
    amounts, real = balances[hyd.AMOUNT], balances[hyd.REAL]
    forces = hyd.cylinder_forces(P, E, w, s1, s2, ds1, ds2, p)
    pp, pt = hyd.supply_loop(P, E, w, real)
    out = {"pp": pp, "pt": pt} | {f"N{i + 1}": n for i, n in enumerate(amounts)}
    out |= {f"d{name}": rate for name, rate in zip(r["crane"].layout.chambers, rates, strict=True)}
    for c, s in enumerate((s1, s2)):
        a, b = 2 * c + 1, 2 * c + 2
        pa, pb = real[2 * c], real[2 * c + 1]
        out[f"Q{a}"], out[f"Q{b}"], _, _ = hyd.port_flows(P, E, c, w[c], pp, pt, pa, pb)
        leak = hooks.leakage(E, c, pa, pb)
        out[f"leak{a}"], out[f"leak{b}"] = leak[0] + w[hyd.FLOW + a - 1], leak[1] + w[hyd.FLOW + b - 1]
        names = (f"l{a}", f"l{b}", f"V{a}", f"V{b}", f"Be{a}", f"Be{b}")
        out |= dict(zip(names, hyd.chambers(P, E, c, s, p[2 * c], p[2 * c + 1]), strict=True))
        out |= {f"Fmu{c + 1}": hyd.friction_force(P, c, speeds[c]), f"F{c + 1}": forces[c], f"v_h{c + 1}": speeds[c]}
    return {k: float(v) for k, v in out.items()}


def _motion_terms(r: dict[str, Any], p: np.ndarray, w: np.ndarray, time: float) -> dict[str, float]:
    P, E, N, M, lay = r["P"], r["E"], r["N"], r["M"], r["crane"].layout
    forces = np.array(hyd.cylinder_forces(P, E, w, *r["kinematics"][:4], p))
    weight, joint, inertial = (np.zeros(r["width"]) for _ in range(3))
    red.add_gravity(P, E, r["inertia"], weight)
    red.add_joint_forces(E, time, w, r["arms"], r["v"], joint)
    red.mass_times(r["inertia"], r["bias"], inertial)
    parts = {"Qg": N @ weight, "Qv": -N @ inertial, "Qh": r["D"] @ forces, "Qj": N @ joint}
    acceleration = np.linalg.solve(M, sum(parts.values()))
    z, swings = lay.positions, len(lay.coordinates)
    if len(N) > swings:  # the pendulum's own row, solved for its acceleration and put into the others
        share = M[z, swings] / M[swings, swings]
        M = M[z, z] - np.outer(share, M[swings, z])
        parts = {name: q[z] - share * q[swings] for name, q in parts.items()}
    out = {f"{name}{axis}": q[i] for name, q in parts.items() for i, axis in enumerate("14")}
    out |= {"M11": M[0, 0], "M12": M[0, 1], "M22": M[1, 1], "ddtheta": 0.0}
    out |= {f"dd{name}": a for name, a in zip((*lay.coordinates, *lay.added), acceleration, strict=False)}
    return {k: float(v) for k, v in out.items()}
