"""A crane on the Exudyn engine whose laws are changed from outside: laws that are in no effect file, and laws in a
dialect.

The library's effects are compiled into the engine. The laws here are asked before each step of 1 ms and change
parameters, flows or forces for that step. So they can hold what the library cannot say (`LAWS`), and the library's
effects as another maker's machine would have them (`DIALECTS`): a soft edge, a lag, another order of the same elements.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from crane_exudyn import geometry
from crane_exudyn import hydraulics as hyd
from crane_exudyn.crane import Crane
from crane_exudyn.drive import spool_on
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.inputs import SpoolPath, play
from crane_exudyn.statics import visible


@dataclass(frozen=True)
class Now:
    """What a law may look at: the start of a step, in SI.

    Attributes:
        time: s.
        state: (nx,); visible: the same with vapour pressure where a chamber holds a void.
        inputs: (4,) [U1 U2 pp pt].
        lengths: pin-to-pin lengths (s1, s2), m.
    """

    time: float
    state: np.ndarray
    visible: np.ndarray
    inputs: np.ndarray
    lengths: tuple[float, float]

    def pressures(self, cylinder: int) -> tuple[float, float]:
        """Return (piston side, rod side) in Pa."""
        return float(self.visible[4 + 2 * cylinder]), float(self.visible[5 + 2 * cylinder])


#: a law returns what differs in the next step: names as in ExudynEngine.propagate's `parameters`, values in SI
Law = Callable[[Now], Mapping[str, float]]


def simulate(crane: Crane, start: np.ndarray, time: np.ndarray, inputs: np.ndarray, laws: Sequence[Law]) -> np.ndarray:
    """Return the states (N, nx) of a crane at the even instants `time`, under laws that act from step to step.

    Args:
        crane: with the effects of the library that it has.
        start: (nx,) state at time[0].
        time: (N,) s;  inputs: (N, 4) [U1 U2 pp pt] there.
        laws: none of them may change what another one changes.
    """
    engine, table = ExudynEngine(crane), _length_tables(crane)
    states = np.empty((time.size, start.size))
    states[0] = start
    for k in range(time.size - 1):
        x = states[k]
        lengths = float(np.interp(x[0], table[0], table[1])), float(np.interp(x[1], table[2], table[3]))
        now = Now(float(time[k]), x, visible(crane, x), inputs[k], lengths)
        changes = {name: np.array([value]) for law in laws for name, value in law(now).items()}
        states[k + 1] = engine.propagate(x[None], inputs[k : k + 2], time[k + 1] - time[k], now.time, changes or None)[
            0
        ]
    return states


def _length_tables(crane: Crane) -> tuple[np.ndarray, ...]:
    """Return (z1, s1 there, z4, s2 there): each cylinder's length depends on one angle only."""
    z1, z4 = np.radians(np.arange(-90.0, 120.0, 0.25)), np.radians(np.arange(-170.0, 20.0, 0.25))
    s1 = geometry.pose(crane, z1, math.radians(-45.0)).lengths[:, 0]
    s2 = geometry.pose(crane, 0.0, z4).lengths[:, 1]
    return z1, s1, z4, s2


# -- laws that no effect file has ------------------------------------------------------------------------------------


def scored_bore(crane: Crane, cylinder: int, force: float, middle: float, width: float) -> Law:
    """Return a law: the bore is scored over part of the stroke, where the seal rubs harder.

    Adds force·exp(-((s - middle)/width)²) in N to Coulomb and static friction of a cylinder; lengths in m.
    """
    names = [f"cylinders.{crane.layout.cylinders[cylinder]}.{kind}_friction" for kind in ("coulomb", "static")]

    def law(now: Now) -> Mapping[str, float]:
        added = force * math.exp(-(((now.lengths[cylinder] - middle) / width) ** 2))
        return {name: crane[name] + added for name in names}

    return law


def hunting_pump(crane: Crane, share: float, frequency: float, phase: float) -> Law:
    """Return a law: the pump's pressure controller hunts, pp (1 + share sin(2π f t + phase)), whatever flows."""

    def law(now: Now) -> Mapping[str, float]:
        swing = share * math.sin(2.0 * math.pi * frequency * now.time + phase)
        return {"supply.pump_pressure": crane["supply.pump_pressure"] * (1.0 + swing)}

    return law


LAWS = ("scored_bore", "hunting_pump")


def draw_law(
    name: str, crane: Crane, rng: np.random.Generator, visited: Mapping[str, np.ndarray]
) -> tuple[Law, dict[str, Any]]:
    """Return a law of LAWS with random severity, and what describes it.

    Args:
        name: of the law.
        crane: the plant.
        rng: source of the draws.
        visited: "s1" and "s2" along the manoeuvre, m; a scored place counts only where the cylinder comes by.
    """
    told: dict[str, Any]
    if name == "hunting_pump":
        told = {
            "share": rng.uniform(0.04, 0.2),
            "frequency": rng.uniform(0.25, 2.0),
            "phase": rng.uniform(0.0, 2.0 * math.pi),
        }
        return hunting_pump(crane, **told), told
    cylinder = int(rng.integers(2))
    low, high = np.quantile(visited[f"s{cylinder + 1}"], [0.15, 0.85])
    told = {
        "cylinder": cylinder,
        "force": float(np.exp(rng.uniform(*np.log([3000.0, 20000.0])))),
        "middle": float(rng.uniform(low, high)),
        "width": float(rng.uniform(0.08, 0.25) * max(high - low, 0.05)),
    }
    return scored_bore(crane, **told), told


# -- the library's effects in a dialect ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Dialect:
    """An effect as another maker's machine has it.

    Attributes:
        laws: act from step to step.
        spool: changes the spool positions (N,) of one cylinder, given (time, command, spool), beforehand; or None.
        cylinder: whose spool that is.
    """

    laws: tuple[Law, ...] = ()
    spool: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray] | None = None
    cylinder: int = 0


def dialect(key: str, values: Mapping[str, float], crane: Crane) -> Dialect | None:
    """Return the effect "name@place" of a crane in its dialect; None where it has none and the library's law holds.

    Args:
        values: its parameters as the library has them, SI.
        crane: the machine without this effect.
    """
    name, _, place = key.partition("@")
    maker = DIALECTS.get(name)
    return maker(values, place, crane) if maker is not None else None


def inputs(
    crane: Crane, time: np.ndarray, stamps: np.ndarray, commands: np.ndarray, dialects: Sequence[Dialect] = ()
) -> np.ndarray:
    """Return [U1 U2 pp pt] (N, 4) of a machine at `time`: spools behind the lag (16) and what the dialects make of
    them.

    Args:
        time: (N,) s.
        stamps, commands: (n,) s and (n, 2), linear between, on their own clock.
    """
    spools = spool_on(crane, time, stamps, commands)
    for d in dialects:
        if d.spool is not None:
            command = np.interp(time, stamps, commands[:, d.cylinder])
            spools[:, d.cylinder] = d.spool(time, command, spools[:, d.cylinder])
    return np.ascontiguousarray(np.column_stack([spools, np.full((time.size, 2), math.nan)]))


def _soft_dead_band(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a dead band whose edges are notched: the opening sets in softly, over about 1 % of the stroke."""
    soft = 0.006

    def opening(u: np.ndarray, width: float) -> np.ndarray:
        rise = np.logaddexp(0.0, (u - width) / soft) - np.logaddexp(0.0, -width / soft)
        return soft * np.maximum(rise, 0.0) / (1.0 - width)

    def spool(_: np.ndarray, __: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.where(u >= 0.0, opening(u, values["upper"]), -opening(-u, values["lower"]))

    return Dialect(spool=spool, cylinder=crane.layout.cylinders.index(place))


def _play_behind_the_spool(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return the play between spool and valve, behind the lag instead of before it."""

    def spool(_: np.ndarray, __: np.ndarray, u: np.ndarray) -> np.ndarray:
        out, held = np.empty_like(u), float(u[0])
        for k, leader in enumerate(u):
            held = out[k] = play(held, leader, values["b"])
        return out

    return Dialect(spool=spool, cylinder=crane.layout.cylinders.index(place))


def _delay_by_cycles(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a delay of a controller that reads its command every 5 ms and holds it."""
    cylinder = crane.layout.cylinders.index(place)

    def spool(time: np.ndarray, command: np.ndarray, _: np.ndarray) -> np.ndarray:
        read = np.floor((time - values["T"]) / 5e-3 + 1e-9) * 5e-3
        held = np.zeros((time.size, 2))
        held[:, cylinder] = np.interp(read, time, command)
        return np.asarray(SpoolPath(crane).run(time, held)[:, cylinder])

    return Dialect(spool=spool, cylinder=cylinder)


def _supply_behind_a_line(values: Mapping[str, float], crane: Crane, name: str, sign: float, which: int) -> Dialect:
    """Return a supply whose pressure follows the flow with a lag of 10 ms, as behind a line with oil in it.

    Args:
        name: of the supply pressure;  sign: of its change with the flow;  which: 2 for drawn, 3 for returned flow.
    """
    P, E, follower = crane.parameter_vector(), crane.effect_vector(), _Follower(0.01)

    def law(now: Now) -> Mapping[str, float]:
        pressure = crane[name] + sign * values["R"] * follower.value
        pp, pt = (pressure, P[hyd.SUPPLY + 1]) if which == 2 else (P[hyd.SUPPLY], pressure)
        flows = (hyd.port_flows(P, E, c, now.inputs[c], pp, pt, *now.pressures(c))[which] for c in range(2))
        follower.follow(now.time, sum(flows))
        return {name: crane[name] + sign * values["R"] * follower.value}

    return Dialect((law,))


@dataclass
class _Follower:
    """A first-order follower; starts anew when time goes back."""

    tau: float
    value: float = 0.0
    time: float = field(default=math.inf)

    def follow(self, time: float, target: float) -> None:
        if time < self.time:
            self.value = 0.0
        else:
            self.value += (target - self.value) * (1.0 - math.exp(-(time - self.time) / self.tau))
        self.time = time


def _steep_counterbalance(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a load-holding valve that opens fully over 35 bar instead of 20, and never closes quite (1 %)."""
    c = crane.layout.cylinders.index(place)

    def law(now: Now) -> Mapping[str, float]:
        piston, rod = now.pressures(c)
        own, other = (piston, rod) if c == 0 else (rod, piston)
        drains = now.inputs[c] < 0.0 if c == 0 else now.inputs[c] > 0.0
        opening = min(max((own + values["ratio"] * other - values["setting"]) / 35e5, 0.01), 1.0)
        return {f"meter_out_restriction@{place}.r": 1.0 - opening if drains else 0.0}

    return Dialect((law,))


def _friction_as_in_19(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return pressure-dependent friction that enters the friction law (19) of the cylinder, with its smoothing."""
    c, names = (
        crane.layout.cylinders.index(place),
        [f"cylinders.{place}.{kind}_friction" for kind in ("coulomb", "static")],
    )

    def law(now: Now) -> Mapping[str, float]:
        piston, rod = now.pressures(c)
        return {name: crane[name] + values["mu"] * abs(piston - rod) for name in names}

    return Dialect((law,))


def _slow_load(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a payload that is taken up (or let go) over 0.25 s."""

    def law(now: Now) -> Mapping[str, float]:
        share = min(max((now.time - values["T"]) / 0.25, 0.0), 1.0)
        return {"payload.mass": crane["payload.mass"] + share * values["dm"]}

    return Dialect((law,))


def _slow_contact(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a contact that builds up over 0.15 s and leans by a tenth of its force."""

    def law(now: Now) -> Mapping[str, float]:
        force = values["F"] * min(max((now.time - values["T"]) / 0.15, 0.0), 1.0)
        return {"force.y": force, "force.x": 0.1 * force}

    return Dialect((law,))


def _curved_leak(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a leak, internal or external, that grows a little faster than the pressure: 10 % more at 50 bar."""

    def flow(dp: float) -> float:
        return values["k"] * dp * (1.0 + 0.1 * abs(dp) / 50e5)

    def out(now: Now) -> Mapping[str, float]:
        return {f"flow.{place}": -flow(float(now.visible[crane.layout.index(place)]))}

    def across(now: Now) -> Mapping[str, float]:
        c = crane.layout.cylinders.index(place)
        piston, rod = now.pressures(c)
        return {f"flow.p{2 * c + 1}": -flow(piston - rod), f"flow.p{2 * c + 2}": flow(piston - rod)}

    return Dialect((out if place in crane.layout.chambers else across,))


def _soft_compensator(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a compensator that lets a twentieth of the surplus pressure through."""
    c, P = crane.layout.cylinders.index(place), crane.parameter_vector()

    def law(now: Now) -> Mapping[str, float]:
        filled = now.pressures(c)[0 if now.inputs[c] >= 0.0 else 1]
        surplus = max(P[hyd.SUPPLY] - filled - values["dpc"], 0.0)
        return {f"pressure_compensation@{place}.dpc": values["dpc"] + 0.05 * surplus}

    return Dialect((law,))


def _lopsided_meter_out(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a restriction that is a tenth stronger one way and a tenth weaker the other."""
    c = crane.layout.cylinders.index(place)

    def law(now: Now) -> Mapping[str, float]:
        return {f"meter_out_restriction@{place}.r": values["r"] * (1.1 if now.inputs[c] > 0.0 else 0.9)}

    return Dialect((law,))


DIALECTS: Mapping[str, Callable[[Mapping[str, float], str, Crane], Dialect]] = {
    "internal_leakage": _curved_leak,
    "external_leakage": _curved_leak,
    "dead_band": _soft_dead_band,
    "meter_out_restriction": _lopsided_meter_out,
    "pressure_compensation": _soft_compensator,
    "command_delay": _delay_by_cycles,
    "spool_hysteresis": _play_behind_the_spool,
    "counterbalance_valve": _steep_counterbalance,
    "pump_droop": lambda v, _, crane: _supply_behind_a_line(v, crane, "supply.pump_pressure", -1.0, 2),
    "return_back_pressure": lambda v, _, crane: _supply_behind_a_line(v, crane, "supply.tank_pressure", 1.0, 3),
    "pressure_dependent_friction": _friction_as_in_19,
    "payload_change": _slow_load,
    "tip_contact_force": _slow_contact,
}
