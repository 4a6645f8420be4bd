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
from functools import partial
from typing import Any

import numpy as np

from crane_exudyn import geometry
from crane_exudyn import hydraulics as hyd
from crane_exudyn.crane import Crane
from crane_exudyn.drive import spool_on
from crane_exudyn.effects import registry
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath, play
from crane_exudyn.statics import visible

from .seeds import log_uniform


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


#: those that the study of the diagnosis draws from
LAWS = ("scored_bore", "hunting_pump")


def _each_step(name: str, value: Callable[[Now], float]) -> Law:
    return lambda now: {name: value(now)}


def _progressive_spool(crane: Crane, c: int, place: str, exponent: float) -> Law:
    """Return a law: the opening is U^exponent instead of U."""
    name = f"valves.{place}.flow_coefficient"
    return _each_step(name, lambda now: crane[name] * max(abs(float(now.inputs[c])), 1e-3) ** (exponent - 1.0))


def _choked_valve(crane: Crane, c: int, place: str, share: float, drop: float) -> Law:
    """Return a law: each edge passes less the greater its own pressure drop, 1 - share dp²/(dp² + drop²)."""
    pp, pt = crane["supply.pump_pressure"], crane["supply.tank_pressure"]

    def law(now: Now) -> Mapping[str, float]:
        (piston, rod), name = now.pressures(c), f"valves.{place}.edges."
        drops = {
            "pump_to_piston": pp - piston,
            "pump_to_rod": pp - rod,
            "piston_to_tank": piston - pt,
            "rod_to_tank": rod - pt,
        }
        return {name + e: crane[name + e] * (1.0 - share * d * d / (d * d + drop * drop)) for e, d in drops.items()}

    return law


def _quadratic_drag(crane: Crane, c: int, place: str, drag: float) -> Law:
    """Return a law: the force against the piston has a part drag·v²."""
    name, last = f"cylinders.{place}.viscous_friction", [0.0, 0.0]

    def law(now: Now) -> Mapping[str, float]:
        passed = now.time - last[0]
        speed = abs(now.lengths[c] - last[1]) / passed if 0.0 < passed < 0.01 else 0.0
        last[:] = [now.time, now.lengths[c]]
        return {name: crane[name] + drag * speed}

    return law


def _root_friction(crane: Crane, c: int, place: str, force: float) -> Law:
    """Return a law: friction grows with the root of the pressure difference, force at 50 bar."""
    names = [f"cylinders.{place}.{kind}_friction" for kind in ("coulomb", "static")]

    def law(now: Now) -> Mapping[str, float]:
        piston, rod = now.pressures(c)
        return {n: crane[n] + force * math.sqrt(abs(piston - rod) / 50e5) for n in names}

    return law


def _orifice_leak(crane: Crane, c: int, flow: float) -> Law:
    """Return a law: the piston's seal leaks through an orifice, flow at 50 bar."""

    def law(now: Now) -> Mapping[str, float]:
        piston, rod = now.pressures(c)
        q = flow * math.copysign(math.sqrt(abs(piston - rod) / 50e5), piston - rod)
        return {f"flow.p{2 * c + 1}": -q, f"flow.p{2 * c + 2}": q}

    return law


def _early_relief(crane: Crane, chamber: str, opens: float, flow: float) -> Law:
    """Return a law: a relief valve of a chamber opens at a pressure, and passes that flow 20 bar above it."""
    at = crane.layout.index(chamber)
    return _each_step(f"flow.{chamber}", lambda now: -flow * max(float(now.visible[at]) - opens, 0.0) / 20e5)


def _hose_spring(crane: Crane, i: int, joint: str, torque: float, middle: float) -> Law:
    """Return a law: bent hoses turn a joint back to an angle, with the torque at 0.5 rad and its cube."""

    def value(now: Now) -> float:
        x = (float(now.state[i]) - middle) / 0.5
        return -0.5 * torque * (x + x**3)

    return _each_step(f"torque.{joint}", value)


def _churning_joint(crane: Crane, i: int, joint: str, torque: float) -> Law:
    """Return a law: grease in a joint resists with the square of its rate, torque at 0.3 rad/s."""
    n = len(crane.layout.coordinates)
    return _each_step(
        f"torque.{joint}", lambda now: -torque * float(now.state[n + i]) * abs(float(now.state[n + i])) / 0.09
    )


def _quadratic_line(crane: Crane, name: str, sign: float, which: int, drop: float) -> Law:
    """Return a law: a line loses pressure with the square of its flow, drop at 40 l/min; `which`: 2 drawn, 3
    returned.
    """
    P, E, topology, at = crane.parameter_vector(), crane.effect_vector(), crane.machine.topology, {"drop": 0.0}

    def law(now: Now) -> Mapping[str, float]:
        pressures = [crane["supply.pump_pressure"], crane["supply.tank_pressure"]]
        pressures[which - 2] += sign * at["drop"]
        flows = (
            hyd.port_flows(topology, P, E, c, now.inputs[c], *pressures, *now.pressures(c))[which] for c in range(2)
        )
        at["drop"] += 0.3 * (drop * (sum(flows) / (40.0 / 60e3)) ** 2 - at["drop"])
        return {name: crane[name] + sign * at["drop"]}

    return law


@dataclass(frozen=True)
class Hidden:
    """A law for the study of learning: what acts, and what is to be found: effect with place, argument, and the curve
    (SI).
    """

    law: Law
    effect: str
    over: str
    curve: Callable[[np.ndarray], np.ndarray] | None
    numbers: Mapping[str, Any]

    def answer(self) -> dict[str, Any]:
        """Return effect, argument and the curve over the whole range of the argument, for the answer of a case."""
        if self.curve is None:
            return {"effect": "", "over": ""}
        over = registry.split_key(self.effect)[0].curve.argument(self.over, self.effect)  # type: ignore[union-attr]
        x = np.linspace(min(over.low, 0.0), 2.0 * over.high, 401)
        return {"effect": self.effect, "over": self.over, "x": x.tolist(), "y": self.curve(x).tolist()}


@dataclass(frozen=True)
class _Draw:
    """Where a law is hidden, and what its numbers are drawn with: a cylinder and the joint that it moves; `visited`
    are "s1", "s2", "z1", "z4" along the manoeuvre.
    """

    crane: Crane
    rng: np.random.Generator
    visited: Mapping[str, np.ndarray]
    cylinder: int

    @property
    def place(self) -> str:
        """The cylinder's name."""
        return self.crane.layout.cylinders[self.cylinder]

    @property
    def joint(self) -> str:
        """The joint's name."""
        return self.crane.layout.joints[self.cylinder]


def _draw_scored_bore(d: _Draw) -> Hidden:
    seen = d.visited[f"s{d.cylinder + 1}"]
    low, high = np.quantile(seen, [0.15, 0.85])
    numbers: dict[str, Any] = {"cylinder": d.cylinder, "force": log_uniform(d.rng, 3000.0, 20000.0)}
    numbers |= {"middle": float(d.rng.uniform(low, high))}
    numbers |= {"width": float(d.rng.uniform(0.08, 0.25) * max(high - low, 0.05))}
    bump = lambda x: numbers["force"] * np.exp(-(((x - numbers["middle"]) / numbers["width"]) ** 2))  # noqa: E731
    return Hidden(scored_bore(d.crane, **numbers), f"learned_force@{d.place}", "stroke", bump, numbers)


def _draw_hunting_pump(d: _Draw) -> Hidden:
    numbers = {
        "share": d.rng.uniform(0.04, 0.2),
        "frequency": d.rng.uniform(0.25, 2.0),
        "phase": d.rng.uniform(0.0, 2.0 * math.pi),
    }
    return Hidden(hunting_pump(d.crane, **numbers), "", "", None, numbers)


def _draw_progressive_spool(d: _Draw) -> Hidden:
    n = float(d.rng.uniform(1.2, 1.8))
    law = _progressive_spool(d.crane, d.cylinder, d.place, n)
    power = lambda x: np.sign(x) * np.abs(x) ** n  # noqa: E731
    return Hidden(law, f"learned_opening@{d.place}", "spool", power, {"exponent": n})


def _draw_choked_valve(d: _Draw) -> Hidden:
    share, drop = float(d.rng.uniform(0.3, 0.7)), float(d.rng.uniform(20e5, 60e5))
    law = _choked_valve(d.crane, d.cylinder, d.place, share, drop)
    factor = lambda x: 1.0 - share * x * x / (x * x + drop * drop)  # noqa: E731
    return Hidden(law, f"learned_opening@{d.place}", "pressure_drop", factor, {"share": share, "drop": drop})


def _draw_quadratic_drag(d: _Draw) -> Hidden:
    drag = log_uniform(d.rng, 3e4, 3e5)
    law = _quadratic_drag(d.crane, d.cylinder, d.place, drag)
    return Hidden(law, f"learned_force@{d.place}", "speed", lambda x: drag * x * x, {"drag": drag})


def _draw_root_friction(d: _Draw) -> Hidden:
    force = log_uniform(d.rng, 1500.0, 8000.0)
    law = _root_friction(d.crane, d.cylinder, d.place, force)
    return Hidden(
        law, f"learned_force@{d.place}", "pressure_drop", lambda x: force * np.sqrt(x / 50e5), {"force": force}
    )


def _draw_orifice_leak(d: _Draw) -> Hidden:
    flow = log_uniform(d.rng, 1e-5, 1e-4)
    law = _orifice_leak(d.crane, d.cylinder, flow)
    return Hidden(
        law, f"learned_leakage@{d.place}", "pressure_drop", lambda x: flow * np.sqrt(x / 50e5), {"flow": flow}
    )


def _draw_early_relief(d: _Draw) -> Hidden:
    chamber = d.crane.layout.loaded[d.cylinder]
    flow, opens = log_uniform(d.rng, 1e-5, 1e-4), float(d.rng.uniform(25e5, 45e5))
    ramp = lambda x: flow * np.maximum(x - opens, 0.0) / 20e5  # noqa: E731
    numbers = {"opens": opens, "flow": flow}
    return Hidden(_early_relief(d.crane, chamber, opens, flow), f"learned_flow@{chamber}", "pressure", ramp, numbers)


def _draw_hose_spring(d: _Draw) -> Hidden:
    middle = float(np.median(d.visited[d.crane.layout.coordinates[d.cylinder]]))
    torque = log_uniform(d.rng, 300.0, 3000.0)
    law = _hose_spring(d.crane, d.cylinder, d.joint, torque, middle)
    spring = lambda x: -0.5 * torque * ((x - middle) / 0.5 + ((x - middle) / 0.5) ** 3)  # noqa: E731
    return Hidden(law, f"learned_torque@{d.joint}", "angle", spring, {"torque": torque})


def _draw_churning_joint(d: _Draw) -> Hidden:
    torque = log_uniform(d.rng, 300.0, 3000.0)
    law = _churning_joint(d.crane, d.cylinder, d.joint, torque)
    return Hidden(law, f"learned_torque@{d.joint}", "rate", lambda x: torque * x * x / 0.09, {"torque": torque})


def _draw_thin_line(d: _Draw, pump: bool) -> Hidden:
    drop = log_uniform(d.rng, 3e5, 30e5)
    supply, sign, which = ("supply.pump_pressure", -1.0, 2) if pump else ("supply.tank_pressure", 1.0, 3)
    law = _quadratic_line(d.crane, supply, sign, which, drop)
    effect = "learned_supply" if pump else "learned_return"
    return Hidden(law, effect, "flow", lambda x: drop * (x / (40.0 / 60e3)) ** 2, {"drop": drop})


#: the laws of the study of learning, each with how it is drawn; none of them is in an effect file
LEARNABLE: Mapping[str, Callable[[_Draw], Hidden]] = {
    "scored_bore": _draw_scored_bore,
    "hunting_pump": _draw_hunting_pump,
    "progressive_spool": _draw_progressive_spool,
    "choked_valve": _draw_choked_valve,
    "quadratic_drag": _draw_quadratic_drag,
    "root_friction": _draw_root_friction,
    "orifice_leak": _draw_orifice_leak,
    "early_relief": _draw_early_relief,
    "hose_spring": _draw_hose_spring,
    "churning_joint": _draw_churning_joint,
    "thin_supply_line": partial(_draw_thin_line, pump=True),
    "thin_return_line": partial(_draw_thin_line, pump=False),
}


def draw_law(name: str, crane: Crane, rng: np.random.Generator, visited: Mapping[str, np.ndarray]) -> Hidden:
    """Return a law of LEARNABLE with random severity at a random place; `visited` are "s1", "s2", "z1", "z4" along the
    manoeuvre.
    """
    if name not in LEARNABLE:
        raise CraneError(f"There is no law {name!r} to hide. There are {', '.join(LEARNABLE)}.")
    cylinder = int(rng.integers(2)) if name != "hunting_pump" else 0  # the pump has no place
    return LEARNABLE[name](_Draw(crane, rng, visited, cylinder))


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
    topology = crane.machine.topology

    def law(now: Now) -> Mapping[str, float]:
        pressure = crane[name] + sign * values["R"] * follower.value
        pp, pt = (pressure, P[hyd.SUPPLY + 1]) if which == 2 else (P[hyd.SUPPLY], pressure)
        flows = (hyd.port_flows(topology, P, E, c, now.inputs[c], pp, pt, *now.pressures(c))[which] for c in range(2))
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


def _notched_counterbalance(values: Mapping[str, float], place: str, crane: Crane) -> Dialect:
    """Return a load-holding valve with notches, which opens slowly at first (power of 1.3), and never closes quite (1
    %).
    """
    c = crane.layout.cylinders.index(place)

    def law(now: Now) -> Mapping[str, float]:
        piston, rod = now.pressures(c)
        own, other = (piston, rod) if c == 0 else (rod, piston)
        drains = now.inputs[c] < 0.0 if c == 0 else now.inputs[c] > 0.0
        lift = min(max((own + values["ratio"] * other - values["setting"]) / values["range"], 0.0), 1.0)
        return {f"meter_out_restriction@{place}.r": 1.0 - max(lift**1.3, 0.01) if drains else 0.0}

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
    "counterbalance_valve": _notched_counterbalance,
    "pump_droop": lambda v, _, crane: _supply_behind_a_line(v, crane, "supply.pump_pressure", -1.0, 2),
    "return_back_pressure": lambda v, _, crane: _supply_behind_a_line(v, crane, "supply.tank_pressure", 1.0, 3),
    "pressure_dependent_friction": _friction_as_in_19,
    "payload_change": _slow_load,
    "tip_contact_force": _slow_contact,
}
