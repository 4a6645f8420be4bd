"""The static start: a state at rest, with valves closed and forces in balance."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from . import faulty_laws
from . import geometry as geo
from . import hydraulics as hyd
from . import reduction as red
from .channels import refuse_beyond
from .crane import Crane
from .description import number
from .effects import hooks
from .errors import CraneError
from .geometry import LENGTH
from .statics import Reduction, check_less_loaded, reduced, size_of_state, visible


def static_start(crane: Crane, *pose: float | np.ndarray, less_loaded: Any = None) -> np.ndarray:
    """Return the state (nx,) at rest with valves closed and forces in balance.

    In each cylinder the less loaded chamber has the given pressure, the other follows from the balance of forces. A
    payload on a pendulum hangs straight down (along gravity where that is turned). A measured pose may lie a little
    beyond the file's stroke: only a run from there is refused.

    Args:
        pose: independent coordinates, rad or m.
        less_loaded: pressure in Pa, one number or one per cylinder, the crane file's by default; may stand behind the
            coordinates.

    Raises:
        CraneError: the pose cannot be reached or is in other units than rad and m, a pressure is below vapour pressure,
            or cylinders have no leverage there.
    """
    lay = crane.layout
    n = len(lay.coordinates)
    if len(pose) == n + 1:
        *pose, less_loaded = pose  # type: ignore[assignment]
    if len(pose) != n:
        raise CraneError(f"{crane.name}: a pose has {n} coordinates ({', '.join(lay.coordinates)}), found {len(pose)}.")
    P, E = crane.parameter_vector(), crane.effect_vector()
    gx, gy = hooks.plain("gravity")(E, 0.0, -1.0)
    state = np.zeros(size_of_state(crane))
    units = map(lay.unit_of, lay.coordinates)
    named = zip(lay.coordinates, pose, units, strict=True)
    state[lay.positions] = [number(z, f"{crane.name}: static_start: {name}", unit) for name, z, unit in named]
    for name, z in zip(lay.coordinates, state[lay.positions], strict=True):
        refuse_beyond(f"{crane.name}: static_start", name, z, lay.unit_of(name))
    state[lay.extra][:1] = math.atan2(gx, -gy)
    less_loaded = crane.initial.less_loaded_pressure if less_loaded is None else less_loaded
    each = [less_loaded] if np.ndim(less_loaded) == 0 else [*less_loaded]
    if len(each) not in (1, len(lay.cylinders)):
        raise CraneError(
            f"{crane.name}: static_start: less_loaded has {len(each)} pressures. Give one for all, or one each for "
            f"{', '.join(lay.cylinders)}."
        )
    low = np.broadcast_to([number(p, f"{crane.name}: less_loaded", "Pa") for p in each], len(lay.cylinders))
    check_less_loaded(crane, low, "the pressure")
    r = reduced(crane, state, 0.0)
    _check_lengths(crane, state, r.lines[:, LENGTH])
    forces = _holding_forces(crane, r, state)
    for c, force in enumerate(forces):
        state[lay.pressures_of(c)] = _pressures(P, E, c, r.lines[c, LENGTH], force, low[c])
    if not np.isfinite(state).all():
        raise faulty_laws.where_start_failed(crane, state) or CraneError(
            f"{crane.name}: there is no static start at {geo.pose_text(lay, state)}: "
            "the forces there are not finite. Look for numbers of the crane that are out of proportion."
        )
    return state


def _check_lengths(crane: Crane, state: np.ndarray, lengths: np.ndarray) -> None:
    """Raise CraneError where a cylinder would be longer or shorter than it can be by more than its whole stroke, which
    no measurement errs by.
    """
    for cylinder, length in zip(crane.layout.cylinders, lengths, strict=True):
        shortest, longest = crane.stroke(cylinder)
        if not 2.0 * shortest - longest <= length <= 2.0 * longest - shortest:
            raise CraneError(
                f"{crane.name}: static_start: at {geo.pose_text(crane.layout, state)} the {cylinder} cylinder would be "
                f"{length:.4g} m long, and it can be {shortest:.4g} to {longest:.4g} m. Coordinates are in rad and m."
            )


def beyond_pump(crane: Crane, state: np.ndarray) -> str:
    """Return which cylinders the pump cannot move against what they hold in a static start (nx,), and what to look at;
    "" where there is none.

    To lift, the pump presses on the loaded chamber while the other one empties into the tank.
    """
    lay, found = crane.layout, []
    pump, tank = crane["supply.pump_pressure"], crane["supply.tank_pressure"]
    for c, cylinder in enumerate(lay.cylinders):
        pressures, areas = visible(crane, state)[lay.pressures_of(c)], crane.areas(cylinder)
        needed = pressures + (tank - pressures[::-1]) * np.divide(areas[::-1], areas)
        loaded = int(np.argmax(needed))
        if needed[loaded] > pump:
            found.append(f"{cylinder} needs {needed[loaded] / 1e5:.4g} bar in {lay.sides[c][loaded]}")
    if not found:
        return ""
    return (
        f"at {geo.pose_text(lay, state)}: {' and '.join(found)} to lift the load, and the pump gives {pump / 1e5:.4g} "
        "bar: look at masses, com, payload, bore and pump_pressure, and at the lever arm that the pins leave there."
    )


def _holding_forces(crane: Crane, r: Reduction, state: np.ndarray) -> np.ndarray:
    """Return the cylinder forces (cylinders,) in N that hold weights and tip force at rest."""
    lay, f = crane.layout, np.zeros_like(r.v)
    red.add_gravity(r.topology, r.P, r.E, r.inertia, f)
    rest, w = np.zeros_like(r.v), np.zeros(len(lay.all_inputs))
    red.add_joint_forces(r.topology, r.E, 0.0, w, r.arms, rest, f)
    leverage = r.D[:, lay.positions]
    if np.abs(leverage).max(axis=1).min() < 1e-6 or abs(np.linalg.det(leverage)) < 1e-9:
        name = lay.cylinders[int(np.abs(leverage).max(axis=1).argmin())]
        raise CraneError(
            f"{crane.name}: the {name} cylinder has no leverage at {geo.pose_text(lay, state)}, so no pressure "
            "balances the load. Start at another pose."
        )
    return np.linalg.solve(leverage.T, -(r.N @ f)[lay.positions])


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
