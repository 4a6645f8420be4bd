"""The lumped fluids: valve edges, supply, the oil of the chambers, and the cylinders' forces and flows; (14), (15),
(17)-(19), (34), (37), (38), (41).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from crane_exudyn.compiled import lean
from crane_exudyn.effects import hooks
from crane_exudyn.machine import CYLINDERS, LOADED

from .sheet import (
    A_TO_TANK,
    AIR,
    AMOUNT,
    B_TO_TANK,
    BORE,
    BY_PRESSURE,
    BY_VOLUME,
    COULOMB,
    CYLINDER,
    DENSITY,
    DRAWN,
    EMPTY,
    FMU,
    GA,
    GB,
    HOSE,
    HOSE_A,
    HOSE_B,
    LA,
    LAMINAR,
    LEAK_A,
    LEAK_B,
    LENGTH,
    N_CYLINDER,
    N_VALVE,
    OIL,
    OIL_A,
    OIL_B,
    OPENING,
    PRESSURE,
    PUMP_TO_A,
    PUMP_TO_B,
    QA,
    QB,
    RANGE,
    REFERENCE,
    RETURNED,
    ROD,
    SPEED_LA,
    SPEED_S,
    STATIC,
    STEEL,
    STRIBECK,
    TANH4,
    VALVE,
    VAPOUR,
    VISCOUS,
    F,
    first_cylinder,
    inline,
)


class Fluid(NamedTuple):
    """Numbers of the machine that all chambers share."""

    soft: float  # 1/B = 1/Bo + 1/Bc
    wall: float  # 1/Bh - 1/Bc
    least: float  # vapour pressure, and
    zero: float  # what is to be added for an absolute pressure, as the machine's gauges read them
    share: float  # free gas at vapour pressure, and
    gas: float  # its compliance


class Oil(NamedTuple):
    """The oil of a chamber at one state."""

    y: float  # the state's pressure
    pressure: float  # in the chamber: y, or vapour pressure where y is below it
    amount: float  # volume of the oil at the pressure 0, m^3
    by_pressure: float  # derivative of the amount by y at constant volume
    by_volume: float  # and by the volume Al at constant pressure
    density: float  # density over that at the pressure 0


class Chambers(NamedTuple):
    """Both chambers of a cylinder: length of the one on the piston side, and their oil."""

    la: float
    a: Oil
    b: Oil


@inline
def root_flow(dp, laminar):
    """q(dp) of (15): sgn(dp) sqrt|dp|, and linear below the laminar pressure."""
    if dp > laminar:
        return math.sqrt(dp)
    if dp < -laminar:
        return -math.sqrt(-dp)
    return dp / math.sqrt(laminar)


@lean
def pump_edge(c, pp, P, E, s):
    """Flow from the pump through valve c: into the piston side where it is open that way (u > 0), or into the rod
    side.
    """
    k, i = first_cylinder(s) + c, VALVE + N_VALVE * c
    u = s.numbers[k, OPENING]
    own, edge = (
        (s.numbers[k, OIL_A + PRESSURE], P[i + PUMP_TO_A])
        if u > 0.0
        else (s.numbers[k, OIL_B + PRESSURE], P[i + PUMP_TO_B])
    )
    drop = hooks.supply_drop(E, c, pp - own)
    return hooks.supply_gain(E, c, drop) * P[i] * edge * abs(u) * root_flow(drop, P[LAMINAR])


@lean
def tank_edge(c, pt, P, E, s):
    """Flow to the tank through valve c: out of the rod side where it is open that way (u > 0), or out of the piston
    side.
    """
    k, i = first_cylinder(s) + c, VALVE + N_VALVE * c
    u, pa, pb = s.numbers[k, OPENING], s.numbers[k, OIL_A + PRESSURE], s.numbers[k, OIL_B + PRESSURE]
    own, other, edge, side = (pb, pa, P[i + B_TO_TANK], 1) if u > 0.0 else (pa, pb, P[i + A_TO_TANK], 0)
    gain = hooks.return_gain(E, c, own, other, 1.0 if s.topology[k, LOADED] == side else 0.0, own - pt)
    return gain * P[i] * edge * abs(u) * root_flow(own - pt, P[LAMINAR])


@lean
def pump_gap(p, nominal, P, E, s):
    """How far the pressure p is above what the supply gives at the flow that p drives; the flows remain in the
    sheet.
    """
    first, total = first_cylinder(s), 0.0
    for c in range(s.topology[0, CYLINDERS]):
        s.numbers[first + c, DRAWN] = pump_edge(c, p, P, E, s)
        total += s.numbers[first + c, DRAWN]
    return p - hooks.supply_pressure(E, nominal, total)


@lean
def tank_gap(p, nominal, P, E, s):
    first, total = first_cylinder(s), 0.0
    for c in range(s.topology[0, CYLINDERS]):
        s.numbers[first + c, RETURNED] = tank_edge(c, p, P, E, s)
        total += s.numbers[first + c, RETURNED]
    return p - hooks.tank_pressure(E, nominal, total)


def _balanced(gap, doc):
    """Return a solver of gap(p) = 0 by regula falsi (Illinois), begun at the pressure without any flow; what it returns
    it tried last.
    """

    @lean
    def balanced(nominal, P, E, s):
        a, fa = nominal, gap(nominal, nominal, P, E, s)
        if fa == 0.0:
            return nominal
        # The flow weakens with the drop it causes, so the root lies between the nominal pressure and one full drop.
        b = a - fa
        fb = gap(b, nominal, P, E, s)
        tolerance = 4e-16 * max(abs(nominal), 1e5)
        for _ in range(100):
            if abs(fb) <= tolerance or abs(b - a) <= tolerance:
                return b
            p = b - fb * (b - a) / (fb - fa)
            f = gap(p, nominal, P, E, s)
            if f * fb < 0.0:
                a, fa = b, fb
            else:
                fa *= 0.5
            b, fb = p, f
        return b

    balanced.__doc__ = doc
    return balanced


pump_pressure = _balanced(pump_gap, "Return the pressure at the valves' pump ports, in balance with the flow drawn.")
tank_pressure = _balanced(tank_gap, "Return the pressure at the valves' tank ports, in balance with the flow returned.")


@inline
def fluid(P, E):
    """Return the Fluid of a machine."""
    zero = P[REFERENCE] * P[AIR]
    share, gas = hooks.free_gas(E, P[VAPOUR])
    return Fluid(
        1.0 / P[OIL] + 1.0 / P[STEEL], 1.0 / P[HOSE] - 1.0 / P[STEEL], P[VAPOUR] - zero, zero, share, gas
    )  # fmt: skip


@inline
def pressed_oil(y, pressed, share, gas, Al, Vh, f):
    """Return the Oil at a pressure y that is not below vapour pressure; pressed = exp(y/B) - 1, share and gas: see
    `oil_at`.

    Without gas N - V is summed up apart, so that pressure and amount follow from each other to the last digit.
    """
    V, wall = Al + Vh, Vh * f.wall
    if share == 0.0:
        k = 1.0 + pressed
        return Oil(y, y, V + (V + wall / f.soft) * pressed, V * k * f.soft + wall * k, k, k)
    k = (1.0 + pressed) * math.exp(-share)
    return Oil(y, y, V * k + wall / f.soft * pressed, V * k * (f.soft + gas) + wall * (1.0 + pressed), k, k)


@inline
def pulled_oil(y, empty, Al, Vh, f):
    """Return the Oil at a state y below vapour pressure, `empty` being the Oil there."""
    k, soft = empty.density, (Al + Vh) * f.soft + Vh * f.wall
    pull = k * (y - f.least)
    return Oil(y, f.least, empty.amount + pull * soft, k * soft, k + pull * f.soft, k)


@lean
def oil_at(y, Al, Vh, f, E):
    """Return the Oil of a chamber of volume Al with a hose of volume Vh, where the state says y for its pressure.

    (34) with (14) and (41) is an exact differential up to the factor k: dN = k Q dt = N_p dp + N_V dV with

        N = V k + Vh (1/Bh - 1/Bc) (exp(p/B) - 1) B,      k = exp(p/B - x),   1/B = 1/Bo + 1/Bc,   V = Al + Vh,

    x the free gas as a share of the oil. N is the volume that the oil had at the pressure 0, so it changes by flows
    alone. Below vapour pressure the oil gives way no further: y goes on falling as if oil could be pulled, while a void
    opens.
    """
    p = max(y, f.least)
    share, gas = hooks.free_gas(E, p + f.zero)
    there = pressed_oil(p, math.expm1(p * f.soft), share, gas, Al, Vh, f)
    return there if y >= f.least else pulled_oil(y, there, Al, Vh, f)


@lean
def oil_of(N, Al, Vh, guess, f, E):
    """Return the Oil of a chamber that holds the amount N: the inverse of `oil_at`, in closed form where there is no
    gas.

    With gas N(p) is concave, so that Newton's method climbs to the root from below without a bracket.
    """
    if f.share == 0.0:
        pressed = (N - (Al + Vh)) / (Al + Vh + Vh * f.wall / f.soft)
        y = math.log1p(pressed) / f.soft
        if y >= f.least:
            return pressed_oil(y, pressed, 0.0, 0.0, Al, Vh, f)
    empty = pressed_oil(f.least, math.expm1(f.least * f.soft), f.share, f.gas, Al, Vh, f)
    if not N > empty.amount:
        pull = (N - empty.amount) / (empty.density * ((Al + Vh) * f.soft + Vh * f.wall))
        return pulled_oil(f.least + pull, empty, Al, Vh, f)
    there = oil_at(max(guess, f.least), Al, Vh, f, E)
    for _ in range(100):
        change = (N - there.amount) / there.by_pressure
        there = oil_at(max(there.y + change, f.least), Al, Vh, f, E)
        if abs(change) <= 1e-6 + 1e-10 * abs(there.y):
            break
    return there


@lean
def chambers_at(c, s, ya, yb, f, P, E):
    """Return the Chambers of cylinder c at pin-to-pin length s and the state's pressures ya, yb.

    With a spring of compliance k' in series the hydraulic length is s + k' F, F the force of the pressures.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    la = s - P[i + EMPTY]
    compliance = hooks.series_compliance(E, c)
    if compliance != 0.0:
        la += compliance * (max(ya, f.least) * Aa - max(yb, f.least) * Ab)
    return Chambers(
        la, oil_at(ya, Aa * la, P[i + HOSE_A], f, E), oil_at(yb, Ab * (P[i + RANGE] - la), P[i + HOSE_B], f, E)
    )


@lean
def chambers_of(c, s, Na, Nb, ya, yb, f, P, E):
    """Return the Chambers that hold the amounts Na, Nb; ya, yb: a guess of their pressures.

    With a spring in series F(la(F)) = F is solved by Newton's method: more force means more length and so less force.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    compliance, L, Va, Vb = hooks.series_compliance(E, c), P[i + RANGE], P[i + HOSE_A], P[i + HOSE_B]
    la = s - P[i + EMPTY]
    if compliance == 0.0:
        return Chambers(la, oil_of(Na, Aa * la, Va, ya, f, E), oil_of(Nb, Ab * (L - la), Vb, yb, f, E))
    F, rest = max(ya, f.least) * Aa - max(yb, f.least) * Ab, la
    for _ in range(60):
        la = rest + compliance * F
        a, b = oil_of(Na, Aa * la, Va, ya, f, E), oil_of(Nb, Ab * (L - la), Vb, yb, f, E)
        ya, yb, slope = a.y, b.y, 1.0
        if ya > f.least:
            slope += compliance * Aa * Aa * a.by_volume / a.by_pressure
        if yb > f.least:
            slope += compliance * Ab * Ab * b.by_volume / b.by_pressure
        change = (a.pressure * Aa - b.pressure * Ab - F) / slope
        F += change
        if abs(change) <= 1e-9 + 1e-13 * abs(F):
            break
    return Chambers(la, a, b)


@inline
def piston_areas(i, P):
    """Return the areas of piston side and rod side of the cylinder whose block begins at i."""
    Aa = 0.25 * math.pi * P[i + BORE] * P[i + BORE]
    return Aa, Aa - 0.25 * math.pi * P[i + ROD] * P[i + ROD]


@lean
def friction(P, i, v):
    """Friction force (19) of the cylinder whose block begins at i, with the sign of v."""
    x = v / P[i + STRIBECK]
    hump = 0.25 * x * x + 0.75
    stribeck = (P[i + STATIC] - P[i + COULOMB]) * x / (hump * hump)
    return P[i + COULOMB] * math.tanh(4.0 * x) + stribeck + P[i + VISCOUS] * v * TANH4


@inline
def keep(k, first, o, s):
    """Write the Oil of a chamber to its place in row k."""
    s.numbers[k, first], s.numbers[k, first + PRESSURE], s.numbers[k, first + AMOUNT] = o.y, o.pressure, o.amount
    s.numbers[k, first + BY_PRESSURE], s.numbers[k, first + BY_VOLUME] = o.by_pressure, o.by_volume
    s.numbers[k, first + DENSITY] = o.density


@lean
def read_pressures(x, P, E, s):
    """Write the oil of all chambers at the pressures of a state x that is placed."""
    first, n, f = first_cylinder(s), s.topology[0, CYLINDERS], fluid(P, E)
    for c in range(n):
        ya, yb = x[2 * n + 2 * c], x[2 * n + 2 * c + 1]
        s.numbers[first + c, LA], a, b = chambers_at(c, s.numbers[first + c, LENGTH], ya, yb, f, P, E)
        keep(first + c, OIL_A, a, s)
        keep(first + c, OIL_B, b, s)


@lean
def read_amounts(x, N, P, E, s):
    """Write the oil of all chambers that hold the amounts N (2n,) at a state x that is placed, and its pressures to
    x.
    """
    first, n, f = first_cylinder(s), s.topology[0, CYLINDERS], fluid(P, E)
    for c in range(n):
        i = 2 * n + 2 * c
        la, a, b = chambers_of(c, s.numbers[first + c, LENGTH], N[2 * c], N[2 * c + 1], x[i], x[i + 1], f, P, E)
        s.numbers[first + c, LA] = la
        keep(first + c, OIL_A, a, s)
        keep(first + c, OIL_B, b, s)
        x[i], x[i + 1] = a.y, b.y


@inline
def cylinder(c, flow_a, flow_b, P, E, s):
    """Write all hydraulic quantities of cylinder c, (17)-(19), (34), (37), (38).

    flow_a, flow_b: flows into the chambers that no law explains (disturbances). Air presses on the rod's cross-section.

    With a spring of compliance k' in series the rate of the hydraulic length follows from both chambers' pressure
    rates, which depend on it linearly, so it is found without iteration. A chamber that holds a void has a constant
    pressure.
    """
    k, i = first_cylinder(s) + c, CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    v, pa, pb = s.numbers[k, SPEED_S], s.numbers[k, OIL_A + PRESSURE], s.numbers[k, OIL_B + PRESSURE]
    pump, tank = s.numbers[k, DRAWN], s.numbers[k, RETURNED]
    Qa, Qb = (pump, tank) if s.numbers[k, OPENING] > 0.0 else (-tank, -pump)
    outside = (1.0 - P[REFERENCE]) * P[AIR]
    leak_a, leak_b = hooks.leakage(E, c, pa - outside, pb - outside)
    leak_a, leak_b = leak_a + flow_a, leak_b + flow_b
    Ga, Gb = s.numbers[k, OIL_A + DENSITY] * (Qa + leak_a), s.numbers[k, OIL_B + DENSITY] * (leak_b - Qb)
    compliance = hooks.series_compliance(E, c)
    if compliance != 0.0:
        least = P[VAPOUR] - P[REFERENCE] * P[AIR]
        ka = 1.0 / s.numbers[k, OIL_A + BY_PRESSURE] if s.numbers[k, OIL_A] > least else 0.0
        kb = 1.0 / s.numbers[k, OIL_B + BY_PRESSURE] if s.numbers[k, OIL_B] > least else 0.0
        v += compliance * (Aa * ka * Ga - Ab * kb * Gb)
        v /= 1.0 + compliance * (
            Aa * Aa * ka * s.numbers[k, OIL_A + BY_VOLUME] + Ab * Ab * kb * s.numbers[k, OIL_B + BY_VOLUME]
        )
    la = s.numbers[k, LA]
    Fmu, air = friction(P, i, v), outside * (Aa - Ab)
    s.numbers[k, F] = pa * Aa - pb * Ab - air - Fmu + hooks.cylinder_force(E, c, v, pa, pb, la, P[i + RANGE] - la)
    s.numbers[k, QA], s.numbers[k, QB], s.numbers[k, LEAK_A], s.numbers[k, LEAK_B] = Qa, Qb, leak_a, leak_b
    s.numbers[k, FMU], s.numbers[k, SPEED_LA], s.numbers[k, GA], s.numbers[k, GB] = Fmu, v, Ga, Gb


@lean
def held_pressures(c, s, F, less_loaded, P, E):
    """Return pa, pb of cylinder c that give the force F at rest, the lower of the two being `less_loaded`.

    Forces that act on the piston at rest (an end stop) depend on the pressures only through a spring in series:
    repeated until nothing changes.
    """
    i = CYLINDER + N_CYLINDER * c
    Aa, Ab = piston_areas(i, P)
    F += (1.0 - P[REFERENCE]) * P[AIR] * (Aa - Ab)
    own, pa, pb = 0.0, less_loaded, less_loaded
    for _ in range(50):
        rest = F - own
        if rest >= less_loaded * (Aa - Ab):
            pa, pb = (rest + less_loaded * Ab) / Aa, less_loaded
        else:
            pa, pb = less_loaded, (less_loaded * Aa - rest) / Ab
        la = s + hooks.series_compliance(E, c) * (pa * Aa - pb * Ab) - P[i + EMPTY]
        new = hooks.cylinder_force(E, c, 0.0, pa, pb, la, P[i + RANGE] - la)
        if abs(new - own) <= 1e-9 * max(1.0, abs(F)):
            break
        own = new
    return pa, pb
