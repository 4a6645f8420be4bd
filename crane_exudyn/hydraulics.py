"""Hydraulics of one machine: port flows, chambers, pressure rates (34) and cylinder forces (18), with the effects'
hooks.

Compiled functions of numbers; the piston side of cylinder c is chamber 2c, its rod side 2c + 1. `topology` says which
chamber carries the load; P and E are the flat vectors of nominal and of effect parameters; w is [spools, pp, pt] and
behind it the disturbances in the order of `Layout.disturbances`; `lines` is the table of the cylinders' lengths and
rates of `geometry`. `mechanism.py` puts these functions into Exudyn as user functions.
"""

from __future__ import annotations

import math

import numpy as np

from .compiled import lean, njit
from .effects import hooks
from .geometry import LENGTH, RATE
from .laws.friction import cylinder_friction
from .laws.oil import filling, pressure_of
from .laws.orifice import edge_flow
from .laws.volume import chamber_lengths, chamber_volume
from .machine import BODIES, LOADED, LOOPS
from .parameters import CYLINDER, FLUID, N_CYLINDER, N_VALVE, SUPPLY, VALVE

# places inside a cylinder's block, a valve's block and inside the fluid's block of P
BORE, ROD, EMPTY, RANGE, HOSE_A, HOSE_B, FC, FS, VS, VISCOUS = range(10)
COEFFICIENT, LAG, PUMP_A, PUMP_B, A_TANK, B_TANK = range(6)
OIL, WALL, HOSE, VAPOUR, LAMINAR = range(5)
AIR, REFERENCE = SUPPLY + 2, SUPPLY + 3

#: rows of a table (N_BALANCES, chambers): dN/dt in m^3/s, the amounts of oil N in m^3, by the cylinder's length dN/ds
#: in m^2 and by pressure dN/dy in m^3/Pa; and behind them the flows into the chambers (m^3/s), the pressures (Pa) and
#: the pistons' speeds (m/s)
GAIN, AMOUNT, DRAW, SLOPE, INTO, REAL, SPEED, N_BALANCES = range(8)

#: the loop between supply pressure and flow is solved to this fraction of the pressure
_LOOP_TOLERANCE = 1e-13


@lean
def areas(P, c):
    """Return (piston-side area, rod-side area) of cylinder c in m^2."""
    k = CYLINDER + N_CYLINDER * c
    bore2, rod2 = P[k + BORE] ** 2, P[k + ROD] ** 2
    return 0.25 * math.pi * bore2, 0.25 * math.pi * (bore2 - rod2)


@lean
def pressure_force(P, c, pa, pb):
    """Return p_piston A_piston - p_rod A_rod of cylinder c in N, pushing the pins apart."""
    area_a, area_b = areas(P, c)
    return pa * area_a - pb * area_b


@lean
def supplies(P, w, n):
    """Return (pp, pt) in Pa for n cylinders: those of w, or the machine's own where w has NaN."""
    pp = P[SUPPLY] if math.isnan(w[n]) else w[n]
    pt = P[SUPPLY + 1] if math.isnan(w[n + 1]) else w[n + 1]
    return pp, pt


@lean
def flow_disturbances(n):
    """Return where unknown flows into the chambers begin in w, for n cylinders: behind n moments and two forces."""
    return 2 * n + 4


@lean
def port_flows(topology, P, E, c, spool, pp, pt, pa, pb):
    """Return (Q_a, Q_b, drawn, returned) of one valve in m^3/s, (15) at its two open edges.

    Q_a counts into the piston side, Q_b out of the rod side, as in (34); drawn comes from the pump, returned goes to
    tank.
    """
    opening = hooks.opening(E, c, spool)
    v, laminar = VALVE + N_VALVE * c, P[FLUID + LAMINAR]
    cv = P[v + COEFFICIENT]
    load_b = float(topology[1 + topology[0, BODIES] + topology[0, LOOPS] + c, LOADED])
    if opening >= 0.0:
        drop = hooks.supply_drop(E, c, pp - pa)
        drawn = edge_flow(cv * P[v + PUMP_A], opening, drop, laminar) * hooks.supply_gain(E, c, drop)
        returned = edge_flow(cv * P[v + B_TANK], opening, pb - pt, laminar) * hooks.return_gain(
            E, c, pb, pa, load_b, pb - pt
        )
        return drawn, returned, drawn, returned
    drop = hooks.supply_drop(E, c, pp - pb)
    drawn = edge_flow(cv * P[v + PUMP_B], -opening, drop, laminar) * hooks.supply_gain(E, c, drop)
    returned = edge_flow(cv * P[v + A_TANK], -opening, pa - pt, laminar) * hooks.return_gain(
        E, c, pa, pb, 1.0 - load_b, pa - pt
    )
    return -returned, -drawn, drawn, returned


@lean
def _mismatch(topology, P, E, w, p, of_tank, start, other, trial):
    """Return how far a trial pump (or tank) pressure is below what the supply has at the flow that it causes."""
    pp, pt = (other, trial) if of_tank else (trial, other)
    drawn, returned = 0.0, 0.0
    for c in range(p.size // 2):
        _, _, more, back = port_flows(topology, P, E, c, w[c], pp, pt, p[2 * c], p[2 * c + 1])
        drawn, returned = drawn + more, returned + back
    return (hooks.tank_pressure(E, start, returned) if of_tank else hooks.supply_pressure(E, start, drawn)) - trial


@lean
def _solve_supply(topology, P, E, w, p, of_tank, start, other):
    """Return the pressure without mismatch, by the Illinois method; `start` itself where no effect acts on it.

    More pump pressure means more flow drawn (more tank pressure less flow returned), so the mismatch falls with the
    trial pressure and its root lies between the first two trials.
    """
    a, fa = start, _mismatch(topology, P, E, w, p, of_tank, start, other, start)
    if fa == 0.0:
        return start
    b = start + fa
    fb = _mismatch(topology, P, E, w, p, of_tank, start, other, b)
    for _ in range(200):
        if abs(fb) <= _LOOP_TOLERANCE * max(abs(start), abs(b)) or fa == fb:
            break
        x = b - fb * (b - a) / (fb - fa)
        fx = _mismatch(topology, P, E, w, p, of_tank, start, other, x)
        if (fx > 0.0) != (fb > 0.0):
            a, fa = b, fb
        else:
            fa *= 0.5
        b, fb = x, fx
    return b


@lean
def supply_loop(topology, P, E, w, p):
    """Return (pp, pt) in Pa that agree with the flows that they cause; the set pressures where no effect acts on
    them.
    """
    pp, pt = supplies(P, w, p.size // 2)
    return _solve_supply(topology, P, E, w, p, False, pp, pt), _solve_supply(topology, P, E, w, p, True, pt, pp)


@lean
def fluid(P):
    """Return (1/B, 1/Bw, vapour pressure, zero) of `laws.oil`; pressures as the crane's gauges read them."""
    zero = P[REFERENCE] * P[AIR]
    softness = 1.0 / P[FLUID + OIL] + 1.0 / P[FLUID + WALL]
    return softness, 1.0 / P[FLUID + HOSE] - 1.0 / P[FLUID + WALL], vapour_pressure(P), zero


@lean
def vapour_pressure(P):
    """Return the pressure in Pa below which no chamber falls, as the crane's gauges read it."""
    return P[FLUID + VAPOUR] - P[REFERENCE] * P[AIR]


@lean
def outside_pressure(P):
    """Return the pressure in Pa of the air around the machine, as the crane's gauges read it."""
    return (1.0 - P[REFERENCE]) * P[AIR]


@lean
def real_pressures(P, y, p):
    """Fill p (chambers,) with the pressures in the chambers: those of the state, y, or vapour pressure where there is a
    void.
    """
    for j in range(y.size):
        p[j] = max(y[j], vapour_pressure(P))


@lean
def lengths(P, E, c, s, ya, yb):
    """Return the chambers' lengths (l_a, l_b) in m; with a spring in series at the hydraulic length s + F/k."""
    k = CYLINDER + N_CYLINDER * c
    least = vapour_pressure(P)
    hydraulic = s + hooks.series_compliance(E, c) * pressure_force(P, c, max(ya, least), max(yb, least))
    return chamber_lengths(hydraulic, P[k + EMPTY], P[k + RANGE])


@lean
def fillings(P, E, c, s, ya, yb):
    """Return the `filling` (N, dN/dy, dN/dV, density) of both chambers of cylinder c at pin-to-pin length s in m."""
    k = CYLINDER + N_CYLINDER * c
    area_a, area_b = areas(P, c)
    la, lb = lengths(P, E, c, s, ya, yb)
    softness, hose, vapour, zero = fluid(P)
    return (
        filling(E, ya, area_a * la, P[k + HOSE_A], softness, hose, vapour, zero),
        filling(E, yb, area_b * lb, P[k + HOSE_B], softness, hose, vapour, zero),
    )


@lean
def chambers(P, E, c, s, ya, yb):
    """Return (l_a, l_b, V_a, V_b, B_a, B_b) of cylinder c at pin-to-pin length s, (14) and (41): V dp = B dN /
    density.
    """
    k = CYLINDER + N_CYLINDER * c
    area_a, area_b = areas(P, c)
    la, lb = lengths(P, E, c, s, ya, yb)
    va, vb = chamber_volume(P[k + HOSE_A], area_a, la), chamber_volume(P[k + HOSE_B], area_b, lb)
    (_, slope_a, _, density_a), (_, slope_b, _, density_b) = fillings(P, E, c, s, ya, yb)
    return la, lb, va, vb, density_a * va / slope_a, density_b * vb / slope_b


@lean
def changed_amounts(P, E, c, balances, ya, yb, ds, dya, dyb):
    """Return the amounts (m^3) in both chambers of cylinder c after small changes of length (m) and pressures (Pa),
    linearly.

    `balances` is the table of `chamber_balances` before the changes, at the state's pressures ya, yb.
    """
    a, b, moved = 2 * c, 2 * c + 1, ds
    inv_k = hooks.series_compliance(E, c)
    if inv_k != 0.0:
        least = vapour_pressure(P)
        moved += inv_k * pressure_force(P, c, dya if ya > least else 0.0, dyb if yb > least else 0.0)
    return (
        balances[AMOUNT, a] + balances[SLOPE, a] * dya + balances[DRAW, a] * moved,
        balances[AMOUNT, b] + balances[SLOPE, b] * dyb + balances[DRAW, b] * moved,
    )


@lean
def settled_pressures(P, E, c, s, amount_a, amount_b, ya, yb):
    """Return (ya, yb) at which the chambers of cylinder c hold given amounts (m^3) at pin-to-pin length s; ya, yb: a
    guess.

    With a spring in series the lengths depend on the force of the pressures. That force is found by Newton's method:
    more of it makes more length and so less pressure.
    """
    k = CYLINDER + N_CYLINDER * c
    area_a, area_b = areas(P, c)
    softness, hose, vapour, zero = fluid(P)
    inv_k = hooks.series_compliance(E, c)
    force = pressure_force(P, c, max(ya, vapour), max(yb, vapour))
    for _ in range(60):
        la, lb = chamber_lengths(s + inv_k * force, P[k + EMPTY], P[k + RANGE])
        ya = pressure_of(E, amount_a, area_a * la, P[k + HOSE_A], softness, hose, vapour, zero, ya)
        yb = pressure_of(E, amount_b, area_b * lb, P[k + HOSE_B], softness, hose, vapour, zero, yb)
        if inv_k == 0.0:
            break
        stiffness = 0.0
        if ya > vapour:
            _, slope, by_volume, _ = filling(E, ya, area_a * la, P[k + HOSE_A], softness, hose, vapour, zero)
            stiffness += area_a**2 * by_volume / slope
        if yb > vapour:
            _, slope, by_volume, _ = filling(E, yb, area_b * lb, P[k + HOSE_B], softness, hose, vapour, zero)
            stiffness += area_b**2 * by_volume / slope
        gap = pressure_force(P, c, max(ya, vapour), max(yb, vapour)) - force
        force += gap / (1.0 + inv_k * stiffness)
        if abs(gap) <= 1e-9 + 1e-13 * abs(force):
            break
    return ya, yb


@lean
def leakage(P, E, c, pa, pb):
    """Return the leakages into both chambers of cylinder c in m^3/s; pressures count from the air outside there."""
    outside = outside_pressure(P)
    return hooks.leakage(E, c, pa - outside, pb - outside)


@lean
def flows_in(topology, P, E, w, p, into):
    """Fill into (chambers,) with all flows into the chambers in m^3/s: ports, leakage and disturbances.

    Returns:
        whether an effect ties the cylinders to the supply.
    """
    n = p.size // 2
    pp, pt = supplies(P, w, n)
    drawn, returned = _ports(topology, P, E, w, p, pp, pt, into)
    tied = hooks.supply_pressure(E, pp, drawn) != pp or hooks.tank_pressure(E, pt, returned) != pt
    if tied:
        pp, pt = supply_loop(topology, P, E, w, p)
        _ports(topology, P, E, w, p, pp, pt, into)
    first = flow_disturbances(n)
    for c in range(n):
        leak_a, leak_b = leakage(P, E, c, p[2 * c], p[2 * c + 1])
        into[2 * c] += leak_a + w[first + 2 * c]
        into[2 * c + 1] += leak_b + w[first + 2 * c + 1]
    return tied


@lean
def _ports(topology, P, E, w, p, pp, pt, into):
    """Fill into (chambers,) with the flows of the valves; return what they draw from the pump and return to tank,
    m^3/s.
    """
    drawn, returned = 0.0, 0.0
    for c in range(p.size // 2):
        qa, qb, more, back = port_flows(topology, P, E, c, w[c], pp, pt, p[2 * c], p[2 * c + 1])
        into[2 * c], into[2 * c + 1] = qa, -qb
        drawn, returned = drawn + more, returned + back
    return drawn, returned


@lean
def _piston_speed(P, E, c, ds, ya, yb, fill_a, fill_b, into_a, into_b):
    """Return the piston's speed v = ds + dF/dt / k behind a spring, with dF/dt by (34), solved for v.

    The pressure of a chamber with a void does not change.
    """
    inv_k = hooks.series_compliance(E, c)
    if inv_k == 0.0:
        return ds
    area_a, area_b = areas(P, c)
    (_, slope_a, volume_a, density_a), (_, slope_b, volume_b, density_b) = fill_a, fill_b
    stiff_a = area_a / slope_a if ya > vapour_pressure(P) else 0.0
    stiff_b = area_b / slope_b if yb > vapour_pressure(P) else 0.0
    from_flow = stiff_a * density_a * into_a - stiff_b * density_b * into_b
    return (ds + inv_k * from_flow) / (1.0 + inv_k * (stiff_a * volume_a * area_a + stiff_b * volume_b * area_b))


@lean
def chamber_balances(topology, P, E, w, lines, y, balances):
    """Fill the table (N_BALANCES, chambers) of all chambers at a state's pressures y (chambers,).

    (34) is dN/dy dy/dt = dN/dt - dN/ds v, with dN/dt = density (flow in) and the piston's speed v.

    Returns:
        whether an effect ties the cylinders to the supply.
    """
    real_pressures(P, y, balances[REAL])
    tied = flows_in(topology, P, E, w, balances[REAL], balances[INTO])
    for c in range(lines.shape[0]):
        _cylinder_balances(P, E, c, lines[c, LENGTH], lines[c, RATE], y, balances)
    return tied


@lean
def _cylinder_balances(P, E, c, s, ds, y, balances):
    a, b = 2 * c, 2 * c + 1
    area_a, area_b = areas(P, c)
    into_a, into_b = balances[INTO, a], balances[INTO, b]
    fill_a, fill_b = fillings(P, E, c, s, y[a], y[b])
    v = _piston_speed(P, E, c, ds, y[a], y[b], fill_a, fill_b, into_a, into_b)
    balances[AMOUNT, a], balances[SLOPE, a], volume_a, density_a = fill_a
    balances[AMOUNT, b], balances[SLOPE, b], volume_b, density_b = fill_b
    balances[GAIN, a], balances[GAIN, b] = density_a * into_a, density_b * into_b
    balances[DRAW, a], balances[DRAW, b] = volume_a * area_a, -volume_b * area_b
    balances[SPEED, a] = balances[SPEED, b] = v


@lean
def pressure_rates(balances, out):
    """Fill out (chambers,) with the rates of the state's pressures in Pa/s, (34), from the table of balances."""
    for j in range(out.size):
        out[j] = (balances[GAIN, j] - balances[DRAW, j] * balances[SPEED, j]) / balances[SLOPE, j]


@njit
def valve_flows(topology, P, E, c, spools, pp, pt, pa, pb):
    """Return the flows (n,) into the piston side and into the rod side in m^3/s that valve c lets through at spools
    (n,), supply pressures and pressures of the chambers (n,).
    """
    into_a, into_b = np.empty(spools.size), np.empty(spools.size)
    for i in range(spools.size):
        q_a, q_b, _, _ = port_flows(topology, P, E, c, spools[i], pp[i], pt[i], pa[i], pb[i])
        into_a[i], into_b[i] = q_a, -q_b
    return into_a, into_b


@njit
def held_amounts(P, E, c, rod_side, s, p):
    """Return (amounts of oil in m^3, their derivatives by pressure in m^3/Pa), (n,) each, that a chamber of cylinder c
    holds at pin-to-pin lengths s (n,) in m and pressures p (n,); a spring in series is taken for stiff.
    """
    k, (area_a, area_b), (softness, hose, vapour, zero) = CYLINDER + N_CYLINDER * c, areas(P, c), fluid(P)
    held, slopes = np.empty(s.size), np.empty(s.size)
    for i in range(s.size):
        la, lb = chamber_lengths(s[i], P[k + EMPTY], P[k + RANGE])
        volume, own = (area_b * lb, P[k + HOSE_B]) if rod_side else (area_a * la, P[k + HOSE_A])
        held[i], slopes[i], _, _ = filling(E, p[i], volume, own, softness, hose, vapour, zero)
    return held, slopes


@njit
def all_pressure_rates(topology, P, E, w, lines, y, out):
    """Fill out (chambers,) with the rates of the state's pressures in Pa/s, (34)."""
    balances = np.empty((N_BALANCES, y.size))
    chamber_balances(topology, P, E, w, lines, y, balances)
    pressure_rates(balances, out)


@lean
def settle(P, E, lines, amounts, guess, y):
    """Fill y (chambers,) with the state's pressures at which the chambers hold given amounts (m^3); guess (chambers,)
    in Pa.
    """
    for c in range(lines.shape[0]):
        a, b = 2 * c, 2 * c + 1
        y[a], y[b] = settled_pressures(P, E, c, lines[c, LENGTH], amounts[a], amounts[b], guess[a], guess[b])


@lean
def friction_force(P, c, speed):
    """Return the friction F_mu of cylinder c by (19) in N, to be taken off its force."""
    k = CYLINDER + N_CYLINDER * c
    return cylinder_friction(speed, P[k + FC], P[k + FS], P[k + VS], P[k + VISCOUS])


@lean
def extra_force(P, E, c, s, v, ya, yb):
    """Return what the cylinder's force has beyond that of the state's pressures ya, yb, in N.

    Minus friction (19), plus the effects' forces; air on the rod's cross-section; and where a chamber has a void, its
    vapour pressure instead of the state's.

    Args:
        s: pin-to-pin length in m.
        v: piston speed in m/s.
    """
    area_a, area_b = areas(P, c)
    least = vapour_pressure(P)
    pa, pb = max(ya, least), max(yb, least)
    la, lb = lengths(P, E, c, s, ya, yb)
    void = (pa - ya) * area_a - (pb - yb) * area_b
    air = outside_pressure(P) * (area_a - area_b)
    return hooks.cylinder_force(E, c, v, pa, pb, la, lb) - friction_force(P, c, v) - air + void


@njit
def extra_forces(topology, P, E, w, lines, y, out):
    """Fill out (cylinders,) with the `extra_force` of each cylinder in N."""
    balances = np.empty((0, 0))
    for c in range(out.size):
        if hooks.series_compliance(E, c) != 0.0:
            if balances.size == 0:
                balances = np.empty((N_BALANCES, y.size))
                chamber_balances(topology, P, E, w, lines, y, balances)
            v = balances[SPEED, 2 * c]
        else:
            v = lines[c, RATE]
        out[c] = extra_force(P, E, c, lines[c, LENGTH], v, y[2 * c], y[2 * c + 1])


@njit
def cylinder_forces(topology, P, E, w, lines, y, out):
    """Fill out (cylinders,) with the forces (18) in N with all that effects add, pushing the pins apart."""
    extra_forces(topology, P, E, w, lines, y, out)
    for c in range(out.size):
        out[c] += pressure_force(P, c, y[2 * c], y[2 * c + 1])
