"""Hydraulics of one crane: port flows, chambers, pressure rates (34) and cylinder forces (18), with the effects' hooks.

Compiled functions of numbers; cylinder c is 0 (lift) or 1 (tilt), its piston side is chamber 2c, its rod side 2c + 1.
P and E are the flat vectors of nominal and of effect parameters; w is [U1 U2 pp pt] and behind it the eight disturbances of
`DISTURBANCES`. `mechanism.py` puts these functions into Exudyn as user functions.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import njit
from .effects import hooks
from .laws.bulk_modulus import effective_bulk_modulus
from .laws.friction import cylinder_friction
from .laws.orifice import edge_flow
from .laws.volume import chamber_lengths, chamber_volume
from .parameters import CYLINDER, FLUID, N_CYLINDER, N_VALVE, SUPPLY, VALVE

# places inside a cylinder's block and inside the fluid's block of P
BORE, ROD, EMPTY, RANGE, HOSE_A, HOSE_B, FC, FS, VS, VISCOUS = range(10)
OIL, WALL, HOSE, VAPOUR, LAMINAR = range(5)

#: what may act without a law that explains it: moments on z1 and z4 in N m, forces on E in N, flows into chambers in m^3/s
DISTURBANCES = ("torque.O", "torque.A", "force.x", "force.y", "flow.p1", "flow.p2", "flow.p3", "flow.p4")
#: length of w, and where moments, forces and flows begin in it
N_W, TORQUE, FORCE, FLOW = 12, 4, 6, 8

#: the loop between supply pressure and flow is solved to this fraction of the pressure
_LOOP_TOLERANCE = 1e-13


@njit
def areas(P, c):
    """Return (piston-side area, rod-side area) of cylinder c in m^2."""
    k = CYLINDER + N_CYLINDER * c
    bore2, rod2 = P[k + BORE] ** 2, P[k + ROD] ** 2
    return 0.25 * math.pi * bore2, 0.25 * math.pi * (bore2 - rod2)


@njit
def pressure_force(P, c, pa, pb):
    """Return p_piston A_piston - p_rod A_rod of cylinder c in N, pushing the pins apart."""
    area_a, area_b = areas(P, c)
    return pa * area_a - pb * area_b


@njit
def supplies(P, w):
    """Return (pp, pt) in Pa: those of w, or the crane's own where w has NaN."""
    pp = P[SUPPLY] if math.isnan(w[2]) else w[2]
    pt = P[SUPPLY + 1] if math.isnan(w[3]) else w[3]
    return pp, pt


@njit
def port_flows(P, E, c, spool, pp, pt, pa, pb):
    """Return (Q_a, Q_b, drawn, returned) of one valve in m^3/s, (15) at its two open edges.

    Q_a counts into the piston side, Q_b out of the rod side, as in (34); drawn comes from the pump, returned goes to tank.
    """
    opening = hooks.opening(E, c, spool)
    cv, laminar = P[VALVE + N_VALVE * c], P[FLUID + LAMINAR]
    load_a = 1.0 if c == 0 else 0.0  # p1 carries the load of the lift cylinder, p4 that of the tilt cylinder
    if opening >= 0.0:
        drawn = edge_flow(cv, opening, hooks.supply_drop(E, c, pp - pa), laminar)
        returned = edge_flow(cv, opening, pb - pt, laminar) * hooks.return_gain(E, c, pb, pa, 1.0 - load_a)
        return drawn, returned, drawn, returned
    drawn = edge_flow(cv, -opening, hooks.supply_drop(E, c, pp - pb), laminar)
    returned = edge_flow(cv, -opening, pa - pt, laminar) * hooks.return_gain(E, c, pa, pb, load_a)
    return -returned, -drawn, drawn, returned


@njit
def _mismatch(P, E, w, p, of_tank, start, other, trial):
    """Return how far a trial pump (or tank) pressure is below what the supply has at the flow that it causes."""
    pp, pt = (other, trial) if of_tank else (trial, other)
    _, _, drawn_1, returned_1 = port_flows(P, E, 0, w[0], pp, pt, p[0], p[1])
    _, _, drawn_2, returned_2 = port_flows(P, E, 1, w[1], pp, pt, p[2], p[3])
    if of_tank:
        return hooks.tank_pressure(E, start, returned_1 + returned_2) - trial
    return hooks.supply_pressure(E, start, drawn_1 + drawn_2) - trial


@njit
def _solve_supply(P, E, w, p, of_tank, start, other):
    """Return the pressure without mismatch, by the Illinois method; `start` itself where no effect acts on it.

    More pump pressure means more flow drawn (more tank pressure less flow returned), so the mismatch falls with the trial
    pressure and its root lies between the first two trials.
    """
    a, fa = start, _mismatch(P, E, w, p, of_tank, start, other, start)
    if fa == 0.0:
        return start
    b = start + fa
    fb = _mismatch(P, E, w, p, of_tank, start, other, b)
    for _ in range(200):
        if abs(fb) <= _LOOP_TOLERANCE * abs(start) or fa == fb:
            break
        x = b - fb * (b - a) / (fb - fa)
        fx = _mismatch(P, E, w, p, of_tank, start, other, x)
        if (fx > 0.0) != (fb > 0.0):
            a, fa = b, fb
        else:
            fa *= 0.5
        b, fb = x, fx
    return b


@njit
def supply_loop(P, E, w, p):
    """Return (pp, pt) in Pa that agree with the flows that they cause; the set pressures where no effect acts on them."""
    pp, pt = supplies(P, w)
    return _solve_supply(P, E, w, p, False, pp, pt), _solve_supply(P, E, w, p, True, pt, pp)


@njit
def chambers(P, E, c, s, pa, pb):
    """Return (l_a, l_b, V_a, V_b, B_a, B_b) of cylinder c at pin-to-pin length s, (14) and (41).

    With a spring in series the hydraulic length is s + F/k, F the force of the pressures.
    """
    k = CYLINDER + N_CYLINDER * c
    area_a, area_b = areas(P, c)
    hydraulic = s + hooks.series_compliance(E, c) * (pa * area_a - pb * area_b)
    la, lb = chamber_lengths(hydraulic, P[k + EMPTY], P[k + RANGE])
    inv_oil = 1.0 / P[FLUID + OIL]
    wall, hose = P[FLUID + WALL], P[FLUID + HOSE]
    ba = effective_bulk_modulus(hooks.oil_compliance(E, inv_oil, pa), wall, hose, area_a * la, P[k + HOSE_A])
    bb = effective_bulk_modulus(hooks.oil_compliance(E, inv_oil, pb), wall, hose, area_b * lb, P[k + HOSE_B])
    return la, lb, chamber_volume(P[k + HOSE_A], area_a, la), chamber_volume(P[k + HOSE_B], area_b, lb), ba, bb


@njit
def flows_in(P, E, w, p, into):
    """Fill into (4,) with all flows into the chambers in m^3/s: ports, leakage and disturbances.

    Returns:
        whether an effect ties both cylinders to the supply.
    """
    pp, pt = supplies(P, w)
    qa1, qb1, drawn_1, returned_1 = port_flows(P, E, 0, w[0], pp, pt, p[0], p[1])
    qa2, qb2, drawn_2, returned_2 = port_flows(P, E, 1, w[1], pp, pt, p[2], p[3])
    tied = (
        hooks.supply_pressure(E, pp, drawn_1 + drawn_2) != pp
        or hooks.tank_pressure(E, pt, returned_1 + returned_2) != pt
    )
    if tied:
        pp, pt = supply_loop(P, E, w, p)
        qa1, qb1, _, _ = port_flows(P, E, 0, w[0], pp, pt, p[0], p[1])
        qa2, qb2, _, _ = port_flows(P, E, 1, w[1], pp, pt, p[2], p[3])
    leak_1, leak_2 = hooks.leakage(E, 0, p[0], p[1])
    leak_3, leak_4 = hooks.leakage(E, 1, p[2], p[3])
    into[0], into[1] = qa1 + leak_1 + w[FLOW], leak_2 - qb1 + w[FLOW + 1]
    into[2], into[3] = qa2 + leak_3 + w[FLOW + 2], leak_4 - qb2 + w[FLOW + 3]
    return tied


@njit
def _piston_speed(area_a, area_b, stiff_a, stiff_b, inv_k, ds, into_a, into_b):
    """Return the piston's speed v = ds + dF/dt / k behind a spring, with dF/dt = A_a dp_a - A_b dp_b by (34), solved for v."""
    from_flow = area_a * stiff_a * into_a - area_b * stiff_b * into_b
    return (ds + inv_k * from_flow) / (1.0 + inv_k * (area_a**2 * stiff_a + area_b**2 * stiff_b))


@njit
def pressure_rates(P, E, c, s, ds, pa, pb, into_a, into_b):
    """Return (dp_a, dp_b, v) of cylinder c in Pa/s and m/s, (34) before the vapour-pressure floor.

    dp_a = B_a/V_a (flow in - A_a v), dp_b = B_b/V_b (flow in + A_b v); v = ds without a spring in series.

    Args:
        s, ds: pin-to-pin length and its rate, m and m/s.
        into_a, into_b: flows into the chambers, m^3/s.
    """
    area_a, area_b = areas(P, c)
    _, _, va, vb, ba, bb = chambers(P, E, c, s, pa, pb)
    stiff_a, stiff_b = ba / va, bb / vb
    v = _piston_speed(area_a, area_b, stiff_a, stiff_b, hooks.series_compliance(E, c), ds, into_a, into_b)
    return stiff_a * (into_a - area_a * v), stiff_b * (into_b + area_b * v), v


@njit
def all_pressure_rates(P, E, w, s1, s2, ds1, ds2, p, out):
    """Fill out (4,) with the raw pressure rates in Pa/s; return whether an effect ties both cylinders to the supply."""
    into = np.empty(4)
    tied = flows_in(P, E, w, p, into)
    out[0], out[1], _ = pressure_rates(P, E, 0, s1, ds1, p[0], p[1], into[0], into[1])
    out[2], out[3], _ = pressure_rates(P, E, 1, s2, ds2, p[2], p[3], into[2], into[3])
    return tied


@njit
def piston_speeds(P, E, w, s1, s2, ds1, ds2, p):
    """Return (v1, v2) in m/s: the cylinders' rates, less what springs in series take up."""
    if hooks.series_compliance(E, 0) == 0.0 and hooks.series_compliance(E, 1) == 0.0:
        return ds1, ds2
    into = np.empty(4)
    flows_in(P, E, w, p, into)
    _, _, v1 = pressure_rates(P, E, 0, s1, ds1, p[0], p[1], into[0], into[1])
    _, _, v2 = pressure_rates(P, E, 1, s2, ds2, p[2], p[3], into[2], into[3])
    return v1, v2


@njit
def hold_at_vapour_pressure(P, p, rates):
    """Set negative rates to zero where a chamber is at or below vapour pressure: it cannot fall further."""
    floor = P[FLUID + VAPOUR]
    for i in range(4):
        if p[i] <= floor and rates[i] < 0.0:
            rates[i] = 0.0


@njit
def friction_force(P, c, speed):
    """Return the friction F_mu of cylinder c by (19) in N, to be taken off its force."""
    k = CYLINDER + N_CYLINDER * c
    return cylinder_friction(speed, P[k + FC], P[k + FS], P[k + VS], P[k + VISCOUS])


@njit
def extra_force(P, E, c, s, v, pa, pb):
    """Return what the cylinder's force has beyond that of the pressures, in N: minus (19), plus the effects' forces.

    Args:
        s: pin-to-pin length in m.
        v: piston speed in m/s.
    """
    k = CYLINDER + N_CYLINDER * c
    hydraulic = s + hooks.series_compliance(E, c) * pressure_force(P, c, pa, pb)
    la, lb = chamber_lengths(hydraulic, P[k + EMPTY], P[k + RANGE])
    return hooks.cylinder_force(E, c, v, pa, pb, la, lb) - friction_force(P, c, v)


@njit
def extra_forces(P, E, w, s1, s2, ds1, ds2, p):
    """Return the `extra_force` of both cylinders in N."""
    v1, v2 = piston_speeds(P, E, w, s1, s2, ds1, ds2, p)
    return extra_force(P, E, 0, s1, v1, p[0], p[1]), extra_force(P, E, 1, s2, v2, p[2], p[3])


@njit
def cylinder_forces(P, E, w, s1, s2, ds1, ds2, p):
    """Return the forces (18) of both cylinders in N with all that effects add, pushing the pins apart."""
    F1, F2 = extra_forces(P, E, w, s1, s2, ds1, ds2, p)
    return F1 + pressure_force(P, 0, p[0], p[1]), F2 + pressure_force(P, 1, p[2], p[3])
