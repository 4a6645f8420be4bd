"""The Exudyn engine: same answers as Exudyn's own solver, pure steps, isolation, reduction, errors."""

import numpy as np
import pytest

from crane_exudyn import mechanism, trapezoidal
from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine, System
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import pose
from crane_exudyn.linearised import linearise
from crane_exudyn.naive import SolveDynamicEngine
from crane_exudyn.simulation import simulate
from crane_exudyn.statics import visible
from validation.semi_recursive.engine import SemiRecursiveEngine

CRANE = Crane.load("patu655")
SWINGING = CRANE.with_effect("payload_swing", {"length": 1.2, "damping": 8.0})
RUBBING = (
    CRANE.with_effect("seal_friction@lift", {"dFc": 800.0, "dFs": 1200.0, "vs": 5e-3})
    .with_effect("pump_droop", {"R": 4e9})
    .with_effect("return_back_pressure", {"R": 2e9})
    .with_effect("internal_leakage@tilt", {"k": 5e-12})
    .with_effect("entrained_air", {"alpha": 0.005})
    .with_effect("structural_compliance@lift", {"stiffness": 1e7})
    .with_effect("counterbalance_valve@tilt", {"setting": 150e5, "ratio": 4.0})
    .with_effect("joint_coulomb_friction@A", {"T": 80.0})
    .with_effect("tip_contact_force", {"F": 300.0, "T": 0.0})
    .with_effect("base_tilt", {"gamma": 0.04})
)
INPUTS = np.array([[0.3, -0.2, np.nan, np.nan], [0.31, -0.21, 95e5, 2e5]])


def moving_states(n, seed=0, nx=8):
    """Return n states (n, nx) of a moving crane, all different."""
    rng = np.random.default_rng(seed)
    mean = np.array([0.3, -0.8, 0.1, -0.1, 55e5, 30e5, 25e5, 45e5, 0.1, 0.2])[:nx]
    spread = np.array([0.1, 0.2, 0.1, 0.1, 5e5, 5e5, 5e5, 5e5, 0.1, 0.1])[:nx]
    return mean + spread * rng.uniform(-1, 1, (n, nx))


ENGINE = ExudynEngine(CRANE)


@pytest.mark.parametrize("crane", [CRANE, SWINGING, RUBBING], ids=["nominal", "swinging", "many effects"])
def test_equals_exudyns_own_solver(crane):
    """One step for a batch, against one SolveDynamic a state.

    Exudyn's rule is the trapezoidal one of the pressures, ours that of the amounts of oil: they differ by the third
    power of the step or more.
    """
    engine, naive = ExudynEngine(crane, accuracy=np.inf), SolveDynamicEngine(crane)
    states = moving_states(5, nx=len(engine.state_names))
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1e8, 1e8, 1e8, 1e8, 1.0, 1.0])[: states.shape[1]]
    apart = {}
    for h in (2e-3, 1e-3):
        ours, theirs = engine.propagate(states, INPUTS, h, 0.5), naive.propagate(states, INPUTS, h, 0.5)
        assert np.all(np.abs(theirs - states)[:, :8].max(axis=0) > 1e-5)
        apart[h] = np.abs((ours - theirs) / scale).max()
    assert apart[1e-3] < 2e-5
    assert apart[2e-3] / apart[1e-3] > 4.0  # the smallest are within ten times of what Newton's method leaves


def test_step_repeats_bit_for_bit_whatever_came_between():
    states = moving_states(4)
    first = ENGINE.propagate(states, INPUTS, 1e-3)
    ENGINE.propagate(moving_states(4, seed=9), -INPUTS, 2e-3, 7.0)
    ENGINE.propagate(moving_states(1, seed=8), INPUTS, 1e-3)
    assert np.array_equal(ENGINE.propagate(states, INPUTS, 1e-3), first)
    assert np.array_equal(ExudynEngine(CRANE, size=4).propagate(states, INPUTS, 1e-3), first)


@pytest.mark.parametrize("crane", [CRANE, SWINGING, RUBBING], ids=["nominal", "swinging", "many effects"])
def test_a_rougher_step_asks_exudyn_less_often_and_is_solved_as_well_as_it_says(crane, monkeypatch):
    """A filter's steps may err by 2 bar; Newton's method stops at a three thousandth of that."""
    fine, rough = ExudynEngine(crane, accuracy=np.inf), ExudynEngine(crane, accuracy=600.0)  # neither halves its steps
    called, residual = [], System.residual
    monkeypatch.setattr(System, "residual", lambda self: called.append(self) or residual(self))
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1e7, 1e7, 1e7, 1e7, 1.0, 1.0])[: len(fine.state_names)]
    run, asked, found = simulate(crane, step=2e-3), [], []
    for engine in (fine, rough):
        states, before = [run.states[5000]], len(called)
        for k in range(5000, 5100):
            states.append(engine.propagate(states[-1][None], run.inputs[k : k + 2], 1e-3, run.time[k])[0])
        asked.append(len(called) - before)
        found.append(states)
    assert asked[1] < 0.7 * asked[0]
    assert np.abs(np.subtract(*found) / scale).max() < 100 * 600 * trapezoidal.ROUGHLY


def test_restored_state_continues_bit_for_bit():
    time = np.arange(0.0, 0.0605, 1e-3)
    inputs = np.column_stack([0.3 * np.sin(20 * time), 0.2 * np.cos(9 * time), time * np.nan, time * np.nan])
    whole = ENGINE.simulate(moving_states(1)[0], time, inputs)
    again = ENGINE.simulate(whole[30], time[30:], inputs[30:])
    assert np.array_equal(again, whole[30:])


def test_simulation_is_a_chain_of_steps():
    time = np.array([0.0, 1e-3, 2e-3])
    inputs = np.array([[0.1, 0.2, np.nan, np.nan], [0.2, 0.1, np.nan, np.nan], [0.3, 0.0, np.nan, np.nan]])
    start = moving_states(1)
    whole = ENGINE.simulate(start[0], time, inputs)
    one = ENGINE.propagate(start, inputs[:2], time[1] - time[0])
    two = ENGINE.propagate(one, inputs[1:], time[2] - time[1], time[1])
    assert np.array_equal(whole[2], two[0])


@pytest.mark.parametrize("crane", [CRANE, RUBBING], ids=["nominal", "many effects"])
def test_cranes_of_a_batch_do_not_touch_each_other(crane):
    """Every row has the bits that it has alone, whoever the neighbours are."""
    engine = ExudynEngine(crane, size=7)
    states = moving_states(7)
    inputs = INPUTS[:, None, :] * np.linspace(0.2, 1.0, 7)[None, :, None]
    batch = engine.propagate(states, inputs, 1e-3)
    alone = np.array([engine.propagate(states[k : k + 1], inputs[:, k], 1e-3)[0] for k in range(7)])
    assert np.array_equal(batch, alone)
    states[3] = moving_states(1, seed=5)
    changed = engine.propagate(states, inputs, 1e-3)
    assert np.array_equal(np.delete(changed, 3, axis=0), np.delete(batch, 3, axis=0))


def test_two_engines_share_nothing():
    heavy = ExudynEngine(CRANE.with_parameters({"payload.mass": 300.0}))
    states = moving_states(2)
    before = ENGINE.propagate(states, INPUTS, 1e-3)
    other = heavy.propagate(states, INPUTS, 1e-3)
    assert np.abs(other - before)[:, 2].max() > 1e-4
    assert np.array_equal(ENGINE.propagate(states, INPUTS, 1e-3), before)


def test_arguments_are_not_changed():
    states, inputs = moving_states(2), INPUTS.copy()
    kept = states.copy()
    ENGINE.propagate(states, inputs, 1e-3)
    assert np.array_equal(states, kept)
    assert np.array_equal(inputs, INPUTS, equal_nan=True)


def test_inner_step_of_simulate():
    time, inputs = np.array([0.0, 0.004]), INPUTS[[0, 0]]
    coarse = ENGINE.simulate(moving_states(1)[0], time, inputs, step=1e-3)
    fine_grid = np.linspace(0.0, 0.004, 5)
    fine = ENGINE.simulate(moving_states(1)[0], fine_grid, INPUTS[[0] * 5])
    assert coarse[-1] == pytest.approx(fine[-1], rel=1e-12)


@pytest.mark.parametrize("crane", [CRANE, SWINGING, RUBBING], ids=["nominal", "swinging", "many effects"])
def test_reduction_agrees_with_what_exudyn_assembles(crane):
    """Null space, reduced mass, forces and rates against Exudyn's joint Jacobian, mass matrix and right-hand sides."""
    engine = ExudynEngine(crane)
    for state in moving_states(4, seed=2, nx=len(engine.state_names)):
        w = np.array([0.4, -0.3, 90e5, 1e5])
        exu, ours = engine.residual(state, w, 0.7), engine.terms(state, w, 0.7)
        basis = null_space_of_rates(exu, ours)
        assert exu["joint"] == pytest.approx(0.0, abs=1e-13)
        reduced = basis.T @ exu["mass"] @ basis
        applied = basis.T @ exu["force"]
        if len(state) > 8:  # the terms have the pendulum's own equation eliminated
            applied = applied[:2] - reduced[:2, 2] / reduced[2, 2] * applied[2]
            reduced = reduced[:2, :2] - np.outer(reduced[:2, 2], reduced[2, :2]) / reduced[2, 2]
        assert ours["M_z1_z1"] == pytest.approx(reduced[0, 0], rel=1e-10)
        assert ours["M_z1_z4"] == pytest.approx(reduced[0, 1], rel=1e-10)
        assert ours["M_z4_z4"] == pytest.approx(reduced[1, 1], rel=1e-10)
        assert ours["Qg_z1"] + ours["Qh_z1"] + ours["Qj_z1"] == pytest.approx(applied[0], rel=1e-9)
        assert ours["Qg_z4"] + ours["Qh_z4"] + ours["Qj_z4"] == pytest.approx(applied[1], rel=1e-9)
        # what is left of the balance when the accelerations are put in lies in the space of the joint forces
        rest = exu["mass"] @ exu["a"] - exu["force"]
        assert basis.T @ rest == pytest.approx(0.0, abs=1e-8 * np.abs(exu["force"]).max())
        rates = [ours[f"dp{i}"] for i in (1, 2, 3, 4)]
        assert exu["pressure_rates"] == pytest.approx(rates, rel=1e-9)


def null_space_of_rates(exu, ours):
    """Return the basis (nq, 2 or 3) of the null space of Exudyn's G whose columns are dz1, dz4 (and dtheta) of one."""
    _, s, vt = np.linalg.svd(exu["joint_jacobian"])
    raw, q = vt[len(s) :].T, exu["q"]
    rates = [raw[2], raw[5] - raw[2]]
    if len(q) > 12:  # rate of the rod from E to the payload
        tip = np.array([ours["x_E"], ours["y_E"]])
        rod, arm = q[12:] - tip, tip - q[3:5]
        relative = raw[12:] - raw[3:5] - np.outer([-arm[1], arm[0]], raw[5])
        rates.append((rod[0] * relative[1] - rod[1] * relative[0]) / (rod @ rod))
    return raw @ np.linalg.inv(np.array(rates))


@pytest.mark.parametrize("crane", [CRANE, SWINGING], ids=["nominal", "swinging"])
def test_accelerations_are_the_derivatives_of_the_velocities(crane):
    """All redundant accelerations, centripetal parts included, against central differences along the motion."""
    engine, dt = ExudynEngine(crane), 1e-5
    for state in moving_states(4, seed=6, nx=len(engine.state_names)):
        fast = state * np.array([1, 1, 8, 8, 1, 1, 1, 1, 1, 8])[: len(state)]
        t = engine.terms(fast, INPUTS[0])
        rates = np.array([fast[2], fast[3], t["ddz1"], t["ddz4"], 0, 0, 0, 0, fast[-1], t["ddtheta"]])[: len(state)]
        after, before = (engine.residual(fast + s * dt * rates, INPUTS[0])["v"] for s in (1, -1))
        assert engine.residual(fast, INPUTS[0])["a"] == pytest.approx((after - before) / (2 * dt), rel=1e-6, abs=1e-6)


def test_balance_of_the_terms():
    """M zdd = Qg + Qh + Qv + Qj and (34), put together from the named terms."""
    t = ExudynEngine(RUBBING).terms(moving_states(1)[0], np.array([0.4, -0.3, np.nan, np.nan]), 0.5)
    left = t["M_z1_z1"] * t["ddz1"] + t["M_z1_z4"] * t["ddz4"], t["M_z1_z4"] * t["ddz1"] + t["M_z4_z4"] * t["ddz4"]
    for axis, value in zip(("z1", "z4"), left, strict=True):
        assert value == pytest.approx(sum(t[f"Q{part}_{axis}"] for part in "ghvj"), rel=1e-9)
    area_a, area_b = np.pi / 4 * 0.1**2, np.pi / 4 * (0.1**2 - 0.056**2)
    rate = t["Be3"] / t["V3"] * (t["Q3"] + t["leak3"] - area_a * t["ds2"])
    assert t["dp3"] == pytest.approx(rate, rel=1e-9)
    rate = t["Be4"] / t["V4"] * (area_b * t["ds2"] - t["Q4"] + t["leak4"])
    assert t["dp4"] == pytest.approx(rate, rel=1e-9)
    assert t["pp"] == pytest.approx(100e5 - 4e9 * (t["Q1"] - t["Q4"]), rel=1e-9)  # extending lift, retracting tilt
    assert t["pt"] == pytest.approx(1e5 + 2e9 * (t["Q2"] - t["Q3"]), rel=1e-9)


def test_joint_torques_act_on_their_own_angle_only():
    state = moving_states(1)[0]
    at_o = ExudynEngine(CRANE.with_effect("joint_viscous_friction@O", {"c": 700.0})).terms(state, INPUTS[0])
    at_a = ExudynEngine(CRANE.with_effect("joint_viscous_friction@A", {"c": 400.0})).terms(state, INPUTS[0])
    assert (at_o["Qj_z1"], at_o["Qj_z4"]) == pytest.approx((-700.0 * state[2], 0.0), abs=1e-10)
    assert (at_a["Qj_z1"], at_a["Qj_z4"]) == pytest.approx((0.0, -400.0 * state[3]), abs=1e-10)


def test_tip_force_does_the_work_of_its_point():
    """Virtual work: Q = F dy_E/dz."""
    state, d = moving_states(1)[0], 1e-6
    terms = ExudynEngine(CRANE.with_effect("tip_contact_force", {"F": 500.0, "T": 0.0})).terms(state, INPUTS[0])
    z1, z4 = state[0] + d * np.array([1, -1, 0, 0]), state[1] + d * np.array([0, 0, 1, -1])
    height = pose(CRANE, z1, z4).points["E"][:, 1]
    assert terms["Qj_z1"] == pytest.approx(500.0 * (height[0] - height[1]) / (2 * d), rel=1e-7)
    assert terms["Qj_z4"] == pytest.approx(500.0 * (height[2] - height[3]) / (2 * d), rel=1e-7)


def test_every_effect_is_off_at_its_neutral_values():
    from crane_exudyn.effects import registry

    states = moving_states(3)
    plain = ENGINE.propagate(states, INPUTS, 1e-3, 1.0)
    crane = CRANE
    for key in registry.all_keys(CRANE.layout):
        effect, _ = registry.split_key(key)
        crane = crane.with_effect(key, {p.name: p.neutral for p in effect.parameters})
    assert np.array_equal(ExudynEngine(crane).propagate(states, INPUTS, 1e-3, 1.0), plain)


def test_each_row_may_have_parameters_of_its_own():
    """Row k with parameters has the bits of an engine whose crane has them; nothing stays behind."""
    names = ["payload.mass", "joints.E.y", "cylinders.lift.bore", "bodies.lift_boom.com.x", "joints.A.x", "gravity"]
    names += ["fluid.oil_bulk_modulus", "supply.pump_pressure", "valves.tilt.flow_coefficient"]
    states = moving_states(3)
    plain = ENGINE.propagate(states, INPUTS, 1e-3)
    for name in names:
        values = CRANE[name] * np.array([1.0, 1.02, 0.97])
        together = ENGINE.propagate(states, INPUTS, 1e-3, parameters={name: values})
        apart = [
            ExudynEngine(CRANE.with_parameters({name: v})).propagate(states[k : k + 1], INPUTS, 1e-3)[0]
            for k, v in enumerate(values)
        ]
        assert np.array_equal(together, apart), name
        assert np.array_equal(together[0], plain[0]), name
        assert np.abs(together - plain)[1:].max() > 1e-9, name
    assert np.array_equal(ENGINE.propagate(states, INPUTS, 1e-3), plain)


def test_rows_with_effects_of_their_own():
    states = moving_states(2)
    leak = ENGINE.propagate(states, INPUTS, 1e-3, parameters={"internal_leakage@lift.k": np.array([0.0, 5e-12])})
    leaking = ExudynEngine(CRANE.with_effect("internal_leakage@lift", {"k": 5e-12}))
    assert np.array_equal(leak[1], leaking.propagate(states[1:], INPUTS, 1e-3)[0])
    assert np.array_equal(leak[0], ENGINE.propagate(states[:1], INPUTS, 1e-3)[0])
    rods = ExudynEngine(SWINGING)
    states = moving_states(2, nx=10)
    longer = rods.propagate(states, INPUTS, 1e-3, parameters={"payload_swing.length": np.array([1.2, 1.5])})
    other = ExudynEngine(CRANE.with_effect("payload_swing", {"length": 1.5, "damping": 8.0}))
    assert np.array_equal(longer[1], other.propagate(states[1:], INPUTS, 1e-3)[0])


def test_rows_of_rough_steps_differ_by_hardly_less_than_asked():
    """Their parameters are rounded by less than a hundredth of what they differ by, alike in every call."""
    names = ["bodies.lift_boom.com.x", "cylinders.lift.bore", "joints.E.y"]
    rough = ExudynEngine(CRANE, accuracy=600.0)
    states, sizes = np.repeat(moving_states(1), 5, axis=0), np.array([-1.0, -0.5, 0.0, 0.5, 1.0])
    plain = rough.propagate(states, INPUTS, 1e-3)
    solved = np.abs(plain - ENGINE.propagate(states, INPUTS, 1e-3)).max(axis=0)
    for name in names:
        rows = {name: CRANE[name] * (1.0 + 0.02 * sizes)}
        found = rough.propagate(states, INPUTS, 1e-3, parameters=rows)
        due = ENGINE.propagate(states, INPUTS, 1e-3, parameters=rows)
        assert (np.abs(found - due) <= 0.01 * np.ptp(due, axis=0) + 3.0 * solved).all(), name
        assert np.array_equal(rough.propagate(states, INPUTS, 1e-3, parameters=rows), found), name


@pytest.mark.parametrize(
    ("name", "value", "effect"),
    [
        ("force.y", 300.0, ("tip_contact_force", {"F": 300.0, "T": 0.0})),
        ("flow.p1", -5e-5, None),
        ("torque.A", -40.0, None),
    ],
)
def test_disturbances(name, value, effect):
    """A force on E is what the effect of that name is; a flow and a moment stand in the terms where they belong."""
    states = moving_states(1)
    pushed = ENGINE.propagate(states, INPUTS, 1e-3, parameters={name: np.array([value])})
    if effect is not None:
        assert np.array_equal(pushed, ExudynEngine(CRANE.with_effect(*effect)).propagate(states, INPUTS, 1e-3))
        return
    w = np.concatenate([INPUTS[0], np.zeros(8)])
    w[CRANE.layout.all_inputs.index(name)] = value
    with_it, without = ENGINE.terms(states[0], w), ENGINE.terms(states[0], INPUTS[0])
    term = {"flow.p1": "leak1", "torque.A": "Qj_z4"}[name]
    assert with_it[term] - without[term] == pytest.approx(value, rel=1e-12)
    moved = {"flow.p1": 4, "torque.A": 3}[name]
    gain = {"flow.p1": "dp1", "torque.A": "ddz4"}[name]
    change = (pushed - ENGINE.propagate(states, INPUTS, 1e-3))[0, moved]
    assert change == pytest.approx(1e-3 * (with_it[gain] - without[gain]), rel=0.1)


def test_unknown_parameter_of_a_row_is_refused():
    with pytest.raises(CraneError, match=r"there is no 'payload\.mas'.*payload\.mass"):
        ENGINE.propagate(moving_states(1), INPUTS, 1e-3, parameters={"payload.mas": np.ones(1)})
    with pytest.raises(CraneError, match=r"effect 'internal_leakage@lift' has no parameter 'q'"):
        ENGINE.propagate(moving_states(1), INPUTS, 1e-3, parameters={"internal_leakage@lift.q": np.ones(1)})


def test_a_payload_cannot_lose_more_than_it_weighs():
    crane = CRANE.with_effect("payload_change", {"dm": -CRANE["payload.mass"] - 1.0, "T": 5.0})
    with pytest.raises(CraneError, match="mass of -1 kg at t = 5 s"):
        simulate(crane)


def test_an_engine_carries_no_payload_of_less_than_nothing():
    """A sigma point may, beside an effect."""
    engine = ExudynEngine(CRANE.with_effect("payload_change", {"dm": -CRANE["payload.mass"] - 5.0, "T": 0.01}))
    start = engine.static_start(0.2, -0.7)[None]
    engine.propagate(start, INPUTS, 1e-3)
    for _ in range(2):
        with pytest.raises(CraneError, match=r"mass of -5 kg at t = 0\.01 s"):
            engine.propagate(start, INPUTS, 1e-3, time=0.009)
    row = {"payload.mass": np.array([24.0])}
    assert np.isfinite(engine.propagate(start, INPUTS, 1e-3, time=0.02, parameters=row)).all()


def test_payload_change_takes_place_at_its_time():
    crane = CRANE.with_effect("payload_change", {"dm": 60.0, "T": 0.0205})
    heavy = ExudynEngine(CRANE.with_parameters({"payload.mass": CRANE["payload.mass"] + 60.0}))
    engine = ExudynEngine(crane)
    start, time = engine.static_start(0.2, -0.7), np.arange(0.0, 0.0505, 1e-3)
    inputs = np.tile([0.0, 0.0, np.nan, np.nan], (time.size, 1))
    run = engine.simulate(start, time, inputs)
    assert run[20] == pytest.approx(start, rel=1e-9, abs=1e-9)
    assert run[50, 2] < -1e-3
    assert np.array_equal(run[22:], heavy.simulate(run[22], time[22:], inputs[22:]))


def test_own_exudyn_script_with_inputs_of_time():
    """`mechanism.build` in a user's own system beside a user's own body, solved by SolveDynamic, follows the engine."""
    engine = ExudynEngine(CRANE)
    start, time = engine.static_start(0.2, -0.7), np.arange(0.0, 0.2005, 1e-3)

    def inputs(t):
        return np.array([0.2 * np.sin(10.0 * t), 0.05, np.nan, np.nan])

    def solved(step):
        _container, mbs = mechanism.main_system()
        node = mbs.AddNode(mechanism.items.NodePoint2D(referenceCoordinates=[3.0, 0.0]))
        mbs.AddObject(mechanism.items.ObjectMassPoint2D(mass=1.0, nodeNumber=node))
        plant = mechanism.build(mbs, CRANE, states=start, inputs=inputs)
        mbs.Assemble()
        mechanism.set_initial_rates(mbs, plant)
        assert mbs.SolveDynamic(mechanism.settings(step, 0.2))
        return mbs.GetNodeOutput(plant.nodes[0]["lift_boom"], mechanism.exu.OutputVariableType.Coordinates)[2]

    ours = engine.simulate(start, time, np.array([inputs(t) for t in time]), step=2.5e-4)
    assert abs(ours[-1, 0] - start[0]) > 0.01
    apart = [abs(solved(h) - ours[-1, 0]) for h in (2e-3, 1e-3)]
    assert apart[1] < 2e-6  # two rules of second order
    assert apart[0] / apart[1] > 3.0


def test_a_cylinder_does_not_leave_its_barrel_in_an_own_exudyn_script():
    """It went on beyond 1.355 m, with -4940 bar on its rod side, and nothing was said."""
    mbs = mechanism.main_system()[1]
    start = ExudynEngine(CRANE).static_start(0.9, -0.7)
    plant = mechanism.build(mbs, CRANE, states=start, inputs=np.array([1.0, 0.0, np.nan, np.nan]))
    mbs.Assemble()
    mechanism.set_initial_rates(mbs, plant)
    with pytest.raises(CraneError, match="end of its stroke at t = "):
        mbs.SolveDynamic(mechanism.settings(2e-3, 3.0))
    assert repr(plant).startswith("<Plant of 1 x <Crane patu655")


def test_states_of_another_length_are_refused():
    """Numbers behind the end of the array were taken for the payload's."""
    start = ExudynEngine(CRANE).static_start(0.2, -0.7)
    for crane, states in ((SWINGING, start), (CRANE, start[:3]), (CRANE, np.ones((2, 9)))):
        with pytest.raises(CraneError, match="states have shape"):
            mechanism.build(mechanism.main_system()[1], crane, states=states)


def test_changing_payload_is_refused_where_masses_are_fixed():
    _container, mbs = mechanism.main_system()
    mechanism.build(mbs, CRANE.with_effect("payload_change", {"dm": 10.0, "T": 0.005}))
    mbs.Assemble()
    with pytest.raises(Exception, match="fixed masses"):
        mbs.SolveDynamic(mechanism.settings(1e-3, 0.02))


def test_wrong_shapes_are_refused():
    with pytest.raises(CraneError, match=r"states have shape \(8,\), expected \(n, 8\)"):
        ENGINE.propagate(moving_states(1)[0], INPUTS, 1e-3)
    with pytest.raises(CraneError, match=r"inputs have shape \(4,\), expected \(2, 4\)"):
        ENGINE.propagate(moving_states(1), INPUTS[0], 1e-3)
    with pytest.raises(CraneError, match="dt = 0 s"):
        ENGINE.propagate(moving_states(1), INPUTS, 0.0)
    with pytest.raises(CraneError, match="time does not increase from sample 1"):
        ENGINE.simulate(moving_states(1)[0], np.array([0.0, 1.0, 1.0]), np.zeros((3, 4)))
    with pytest.raises(CraneError, match="a state has 8 numbers"):
        ENGINE.terms(np.zeros(10), np.zeros(4))


def test_unreachable_pose_in_a_step_is_named_with_its_time():
    short = ExudynEngine(CRANE.with_parameters({"joints.D_bracket.x": -0.3}))
    state = moving_states(1)
    state[0, 1] = 1.1
    with pytest.raises(CraneError, match=r"t = 1\.5 s: the pose z1 = .* z4 = 63\.03 deg cannot be reached"):
        short.propagate(state, INPUTS, 1e-3, 1.5)


def test_end_of_stroke_is_named():
    time = np.arange(0.0, 4.0, 2e-3)
    inputs = np.tile([1.0, 0.0, np.nan, np.nan], (time.size, 1))
    with pytest.raises(CraneError, match=r"lift cylinder is fully extended \(length 1\.35.* at t = .* end_stop"):
        ENGINE.simulate(ENGINE.static_start(0.9, -0.7), time, inputs, step=2e-3)


def test_parts_of_a_step_grow_again_after_a_stop_was_hit(monkeypatch):
    """Steps are halved thirteen times where the stop begins to act, and only there: 12 000 parts, where it had taken
    670 000.
    """
    from crane_exudyn import trapezoidal
    from crane_exudyn.inputs import SpoolPath

    crane = CRANE.with_effect("end_stop@tilt", {"stiffness": 1.2e8, "damping": 1e5})
    engine, time, parts = ExudynEngine(crane), np.arange(0.0, 2.5, 5e-3), []
    commands = np.column_stack([np.zeros(len(time)), np.interp(time, [0.0, 0.3, 0.5, 2.0, 2.2], [0, 0, 0.6, 0.6, 0])])
    inputs = np.column_stack([SpoolPath(crane).run(time, commands), np.full((len(time), 2), np.nan)])
    finish = trapezoidal.finish
    monkeypatch.setattr(trapezoidal, "finish", lambda *given: (parts.append(1), finish(*given))[1])
    start = engine.static_start(0.2, -2.5)
    states = engine.simulate(start, time, inputs)
    assert engine.halved > 10 and len(parts) < 20000
    apart = np.abs(states - SemiRecursiveEngine(crane).simulate(start, time, inputs)).max(axis=0)
    assert apart[:2].max() < 1e-5 and apart[4:].max() < 1e4


def test_end_stop_holds_the_cylinder():
    """The stop of 1e8 N/m takes the pump's 78 kN and the boom's momentum within centimetres."""
    engine = ExudynEngine(CRANE.with_effect("end_stop@lift", {"stiffness": 1e8, "damping": 1e5}))
    time = np.arange(0.0, 3.0, 2e-3)
    inputs = np.tile([1.0, 0.0, np.nan, np.nan], (time.size, 1))
    run = engine.simulate(engine.static_start(0.9, -0.7), time, inputs, step=2e-3)
    lengths = pose(CRANE, run[:, 0], run[:, 1]).lengths[:, 0]
    assert 1.355 < lengths.max() < 1.375
    assert run[:, 4].max() > 100e5


@pytest.mark.parametrize(
    "place, value, said",
    [
        (2, 1e9, r"does not converge at t = 0\.2 s, z1 = 18\.76 deg.*halvings"),
        (2, 1e5, r"is not accurate at t = 0\.2 s.*halvings"),
        (4, np.nan, r"is not finite at t = 0\.2 s: z1 = 18\.76 deg"),
    ],
)
def test_hopeless_states_are_told(place, value, said):
    """NaN in a state must not pass for an answer."""
    state = moving_states(1)
    state[0, place] = value
    with pytest.raises(CraneError, match=said):
        ENGINE.propagate(state, INPUTS, 1e-3, 0.2)


def test_pressures_do_not_fall_below_vapour_pressure():
    """A load that runs away faster than the pump fills: the rod side cavitates, and the step still converges."""
    engine = ExudynEngine(CRANE.with_effect("tip_contact_force", {"F": -20e3, "T": 0.0}))
    time = np.arange(0.0, 1.0, 1e-3)
    start = ENGINE.static_start(0.5, -0.7)
    run = engine.simulate(start, time, np.tile([-1.0, 0.0, np.nan, np.nan], (time.size, 1)))
    shown = visible(CRANE, run)
    assert shown[:, 4:].min() == 0.0
    held = np.flatnonzero((shown[:, 5] == 0.0) | (shown[:, 6] == 0.0) | (shown[:, 7] == 0.0))
    assert held.size > 3
    assert np.all(np.isfinite(run))


def lift_tip(mbs, plant, number):
    """A force of 300 N upwards on E, as an object of one's own."""
    mbs.AddLoad(mechanism.items.Force(markerNumber=plant.marker("E", number), loadVector=[0.0, 300.0, 0.0]))


def hold_tip(mbs, plant, number):
    """A spring with a damper from E to a point above it."""
    ground = mbs.AddMarker(mechanism.items.MarkerBodyPosition(bodyNumber=plant.ground, localPosition=[4.5, 4.0, 0.0]))
    markers = [ground, plant.marker("E", number)]
    mbs.AddObject(
        mechanism.items.SpringDamper(markerNumbers=markers, referenceLength=2.0, stiffness=3e3, damping=200.0)
    )


def test_objects_of_ones_own_are_part_of_every_step():
    """A load does what the effect does; a spring is followed as with finer steps; each machine of a batch has its
    own.
    """
    states = moving_states(3)
    pushed = ExudynEngine(CRANE.with_objects(lift_tip)).propagate(states, INPUTS, 1e-3)
    effect = ExudynEngine(CRANE.with_effect("tip_contact_force", {"F": 300.0, "T": 0.0})).propagate(
        states, INPUTS, 1e-3
    )
    assert pushed == pytest.approx(effect, rel=1e-11)
    held = CRANE.with_objects(hold_tip)
    together = ExudynEngine(held).propagate(states, INPUTS, 1e-3)
    apart = [ExudynEngine(held).propagate(states[k : k + 1], INPUTS, 1e-3)[0] for k in range(3)]
    assert together == pytest.approx(np.array(apart), rel=1e-12) and np.abs(together - pushed).max() > 1e-9
    coarse, fine = (
        ExudynEngine(held).simulate(states[0], np.array([0.0, 0.2]), INPUTS[[0, 0]], step=h) for h in (1e-3, 5e-5)
    )
    assert coarse[-1] == pytest.approx(fine[-1], rel=1e-4, abs=1e-6)


def loose(mbs, plant, number):
    mbs.AddObject(mechanism.items.MassPoint2D(mass=1.0, nodeNumber=mbs.AddNode(mechanism.items.NodePoint2D())))


def rope(mbs, plant, number):
    above = mbs.AddMarker(mechanism.items.MarkerBodyPosition(bodyNumber=plant.ground, localPosition=[4.5, 4.0, 0.0]))
    mbs.AddObject(mechanism.items.DistanceConstraint(markerNumbers=[above, plant.marker("E", number)], distance=2.0))


def stop(mbs, plant, number):
    """A contact that keeps a body above the ground; simulated as if it were not there, without a word."""
    node = mbs.AddNode(mechanism.items.NodeGenericData(initialCoordinates=[1.0], numberOfDataCoordinates=1))
    ground = mbs.AddNode(mechanism.items.NodePointGround())
    markers = [
        mbs.AddMarker(mechanism.items.MarkerNodeCoordinate(nodeNumber=n, coordinate=c))
        for n, c in ((ground, 0), (plant.nodes[number]["outer_boom"], 1))
    ]
    mbs.AddObject(mechanism.items.ObjectContactCoordinate(markerNumbers=markers, nodeNumber=node, offset=1.0))


def wrong(mbs, plant, number):
    mbs.AddObject(mechanism.items.SpringDamper(markerNumbers=[10_000, 0], stiffness=1.0))


def failing(mbs, plant, number):
    node = mbs.AddNode(mechanism.items.NodePointGround())
    markers = [
        mbs.AddMarker(mechanism.items.MarkerNodeCoordinate(nodeNumber=n, coordinate=c))
        for n, c in ((node, 0), (plant.nodes[number]["outer_boom"], 1))
    ]
    spring = mechanism.items.CoordinateSpringDamper(markerNumbers=markers, springForceUserFunction=lambda *given: 1 / 0)
    mbs.AddObject(spring)


@pytest.mark.parametrize(
    "objects, said",
    [
        (loose, "add 2 coordinates of motion"),
        (rope, "add 1 algebraic coordinates"),
        (stop, "add 1 data coordinates"),
        (failing, "Exudyn refuses the user-defined objects: .*division by zero"),
    ],
)
def test_objects_that_are_more_than_forces_are_refused(objects, said):
    with pytest.raises(CraneError, match=said):
        ExudynEngine(CRANE.with_objects(objects)).propagate(moving_states(1), INPUTS, 1e-3)


@pytest.mark.parametrize("inputs", [0.3, [0.3, 0.0], [30.0, 0.0, np.nan, np.nan], [np.nan] * 4, lambda t: None])
def test_inputs_of_an_own_exudyn_script_are_refused(inputs):
    """They were spread over the supply as well, taken for closed valves, or for thirty times full opening."""
    with pytest.raises(CraneError, match=r"inputs = .*; expected \[U1 U2 pp pt\]"):
        mechanism.build(mechanism.main_system()[1], CRANE, inputs=inputs)


def test_poses_and_states_that_cannot_be_are_told():
    engine = ExudynEngine(CRANE)
    for z in ((0.1,), (0.1, -0.7, 0.0), (np.zeros((2, 2)), 0.1)):
        with pytest.raises(CraneError, match=r"a pose has 2 coordinates \(z1, z4\)"):
            pose(CRANE, *z)
    state = engine.static_start(0.2, -0.7)
    with pytest.raises(CraneError, match="a state has 8 numbers"):
        engine.simulate(state[None], [0.0, 0.1], INPUTS[[0, 0]])
    state[4] = np.nan
    with pytest.raises(CraneError, match="is not finite"):
        engine.simulate(state, [0.0, 0.1], INPUTS[[0, 0]])


@pytest.mark.parametrize("crane", [CRANE, SWINGING, Crane.load("loader")], ids=["nominal", "swinging", "loader"])
def test_linearised_as_the_engine_moves(crane):
    """One trapezoidal step from a neighbouring state, and the frequency of a closed cylinder by hand."""
    engine = ExudynEngine(crane)
    x, h = engine.static_start(*crane.initial.pose), 2e-4
    found, w = linearise(crane, x), np.array([crane.layout.closed] * 2)
    assert np.abs(found.rate).max() < 1e-9 and found.B.shape == (x.size, w.shape[1])
    step = np.linalg.solve(np.eye(x.size) - 0.5 * h * found.A, np.eye(x.size) + 0.5 * h * found.A)
    sizes = np.array(
        crane.layout.sized(engine.state_names, {"rad": 1e-5, "m": 1e-5, "rad/s": 1e-5, "m/s": 1e-5, "Pa": 1e4})
    )
    moved = engine.propagate(x + np.diag(sizes), w, h) - engine.propagate(x[None], w, h)
    assert moved / sizes == pytest.approx((step @ np.diag(sizes)).T / sizes, abs=1e-4)
    if crane.name == "loader":
        t, (area_a, area_b) = engine.terms(x, w[0]), crane.areas("lift")
        arm = pose(crane, *crane.initial.pose).length_rates[0, 0, 0]
        stiffness = area_a**2 * t["Be1"] / t["V1"] + area_b**2 * t["Be2"] / t["V2"]
        hertz = np.sqrt(stiffness * arm**2 / t["M_boom_boom"]) / (2.0 * np.pi)
        assert [f for f, _ in found.modes] == pytest.approx([hertz], rel=0.02)
        assert repr(found).startswith("<Linearised loader: rings with 17 Hz")


def test_what_an_own_exudyn_script_asks_wrongly_is_told():
    mbs = mechanism.main_system()[1]
    plant = mechanism.build(mbs, CRANE)
    for ask, said in (
        (lambda: mechanism.build(mbs, "loader"), r"build: found 'loader' instead of a crane"),
        (lambda: mechanism.build(mbs, CRANE, states=np.zeros((0, 8))), "states have shape"),
        (lambda: plant.marker("E", 3), "There is no machine 3"),
        (lambda: mechanism.set_initial_rates(mbs, plant), "is not assembled"),
        (lambda: mechanism.settings(0.0, 1.0), "step = 0 s"),
        (lambda: ExudynEngine(CRANE, 0), "ExudynEngine: size is 0"),
    ):
        with pytest.raises(CraneError, match=said):
            ask()
