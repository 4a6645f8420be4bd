"""The estimator on the crane: against filterpy, live against batch, and with everything that goes wrong in
recordings.
"""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import cylinder_lengths
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.recording import Recording
from crane_exudyn.statics import visible
from patu.estimate import sensor_noise
from ukf.augment import Augment
from ukf.bounds import Bounds, crane_bounds
from ukf.estimator import Estimator
from ukf.filter import Belief
from ukf.monitor import FROZEN, OUTLIER
from ukf.noise import PaperNoise, ProcessNoise, paper_start_covariance
from ukf.revisit import Revisit
from ukf.sigma_points import merwe
from ukf.signals import Signals
from ukf.tuning import busiest, cut, scale, tune
from validation.semi_recursive import SemiRecursiveEngine

CRANE = Crane.load("patu655")
STD = {"z1": np.radians(0.05), "z4": np.radians(0.05), "p1": 3e4, "p2": 3e4, "p3": 3e4, "p4": 3e4}
ROWS = {"z1": 0, "z4": 1, "dz1": 2, "dz4": 3, "p1": 4, "p2": 5, "p3": 6, "p4": 7}
FOUR = ("z1", "z4", "p1", "p4")


def pulses(time):
    """A lift and a tilt, both there and back, within three seconds."""
    u = np.zeros((time.size, 2))
    u[(time > 0.3) & (time < 1.2), 0] = 0.4
    u[(time > 1.6) & (time < 2.4), 0] = -0.4
    u[(time > 0.6) & (time < 1.5), 1] = 0.3
    u[(time > 1.9) & (time < 2.6), 1] = -0.3
    return u


def run_of(crane: Crane = CRANE, duration: float = 3.0, dt: float = 1e-3):
    """Time, commands, inputs and states of a run of the semi-recursive engine."""
    engine = SemiRecursiveEngine(crane)
    time = np.arange(round(duration / dt) + 1) * dt
    commands = pulses(time)
    inputs = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    states = engine.simulate(engine.static_start(0.2, -0.75), time, inputs)
    return time, commands, inputs, states


TIME, COMMANDS, INPUTS, TRUTH = run_of()


def readings(names, rng, std=STD, states=TRUTH):
    states = visible(CRANE, states)
    out = {n: states[:, ROWS[n]].copy() for n in names if n in ROWS}
    if "z4_abs" in names:
        out["z4_abs"] = states[:, 0] + states[:, 1]
    lengths = cylinder_lengths(CRANE, states[:, :2])
    out |= {n: lengths[:, i] for i, n in enumerate(("s1", "s2")) if n in names}
    return {n: v + std.get(n, 0.0) * rng.normal(size=v.size) for n, v in out.items()}


def recording(names=FOUR, seed=1, every=1, std=STD, time=TIME, commands=COMMANDS, states=TRUTH):
    values = readings(names, np.random.default_rng(seed), std, states)
    return Signals(time, commands, {n: (time[::every], v[::every]) for n, v in values.items()})


def estimator(names=FOUR, **options):
    std = {n: STD.get(n, 1e-3) for n in names}
    return Estimator(options.pop("crane", CRANE), options.pop("engine", "semi-recursive"), std, **options)


def error(estimate, states=TRUTH, time=TIME, after=0.5):
    """RMS error in degrees, degrees per second and bar, once the start is over."""
    at = np.searchsorted(time, estimate.time + 1e-9) - 1
    late = estimate.time >= after
    unit = np.array([*[np.degrees(1.0)] * 4, *[1e-5] * 4])
    return np.sqrt(np.mean(((estimate.mean[:, :8] - visible(CRANE, states[at]))[late] * unit) ** 2, axis=0))


@pytest.mark.parametrize("make", [SemiRecursiveEngine, lambda crane, **more: ExudynEngine(crane, 17, **more)])
def test_equals_filterpy_on_the_crane(make):
    """filterpy gets one sigma point at a time, we all 17 at once: the engines are pure, so only rounding is left.

    No step is halved here: whether one is may depend on the Newton matrix, which the points of a batch share.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from filterpy.kalman import MerweScaledSigmaPoints, UnscentedKalmanFilter
    engine, single = make(CRANE, accuracy=np.inf), make(CRANE, accuracy=np.inf)
    names, steps, noise = list(FOUR), 40, PaperNoise(pressure=2e8)  # all sigma points stay above the vapour floor
    start = Belief(TRUTH[300] + np.array([0.01, -0.01, 0, 0, 3e5, 3e5, 3e5, 3e5]), 1e-4 * paper_start_covariance())
    part = slice(300, 300 + steps + 1)
    data = readings(names, np.random.default_rng(3))
    y = np.column_stack([data[n] for n in names])[part]
    signals = Signals(TIME[part], COMMANDS[part], {n: (TIME[part], y[:, i]) for i, n in enumerate(names)})
    ours = Estimator(CRANE, engine, {n: STD[n] for n in names}, noise, start=start, gate=None).run(signals)
    spool = SpoolPath(CRANE).run(TIME[part], COMMANDS[part])
    w = np.column_stack([spool, np.full((steps + 1, 2), np.nan)])
    theirs = UnscentedKalmanFilter(
        8, 4, 1e-3,
        fx=lambda x, dt, k: single.propagate(x[None], w[k - 1 : k + 1], dt, TIME[part][k - 1])[0],
        hx=lambda x: x[[0, 1, 4, 7]],
        points=MerweScaledSigmaPoints(8, 0.99, 0.0, 0.0),
    )  # fmt: skip
    theirs.x, theirs.P = start.mean.copy(), start.covariance.copy()
    theirs.Q, theirs.R = PaperNoise(pressure=2e8).covariance(1e-3), np.diag([STD[n] ** 2 for n in names])
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1e7, 1e7, 1e7, 1e7])
    for k in range(1, steps + 1):
        theirs.predict(dt=TIME[part][k] - TIME[part][k - 1], k=k)
        theirs.update(y[k])
        np.testing.assert_allclose(ours.mean[k] / scale, theirs.x / scale, atol=1e-8)  # of rad, rad/s and 0.1 Pa
        np.testing.assert_allclose(ours.std[k] / scale, np.sqrt(np.diag(theirs.P)) / scale, atol=1e-8)


def test_live_equals_batch():
    start = Belief(TRUTH[0], np.diag([0.01, 0.01, 0.05, 0.05, *[5e5] * 4]) ** 2)
    signals = recording(every=5)
    live, batch = estimator(start=start), estimator(start=start)
    expected = batch.run(signals)
    scale = np.array([1.0, 1.0, 1.0, 1.0, 1e7, 1e7, 1e7, 1e7])
    # between its samples the live estimator takes the commands as linear, so it is given those of its own instants
    batch = batch.run(Signals(TIME[::5], COMMANDS[::5], signals.sensors))
    for k, t in enumerate(expected.time[:200]):
        now = live.step(COMMANDS[5 * k], {n: v[k] for n, (_, v) in signals.sensors.items()}, t)
        np.testing.assert_allclose(now.mean / scale, batch.mean[k] / scale, atol=1e-9)
        np.testing.assert_allclose(now.std / scale, batch.std[k] / scale, atol=1e-9)
    assert now["z1"] == now.mean[0] and "p4" in repr(now)
    with pytest.raises(CraneError, match="no sensor"):
        live.step((0, 0), {"z9": 1.0})
    with pytest.raises(CraneError, match="u2"):
        live.step({"u1": 0.0}, {})


def test_live_refuses_no_time_and_says_so():
    live = estimator()
    live.step((0.0, 0.0), {"z1": 0.2, "z4": -0.75, "p1": 50e5, "p4": 38e5}, 1.0)
    mean = live.belief.mean
    live.step((0.0, 0.0), {"z1": 0.2}, 1.0)
    live.step((0.0, 0.0), {"z1": 0.2}, 0.5)
    assert live.belief.mean is mean and [e[1] for e in live.events] == ["time"]
    now = live.step((0.0, 0.0), {}, 1.01)
    assert now.time == 1.01 and now.innovation == {}


def test_live_survives_bad_commands_and_says_so():
    live = estimator()
    first = {"z1": 0.2, "z4": -0.75, "p1": 50e5, "p4": 38e5}
    live.step((0.0, 0.0), first, 0.0)
    live.step((float("nan"), 1.4), first, 0.01)
    now = live.step((0.0, 0.0), first, 0.02)
    assert np.isfinite(now.mean).all()
    assert [e[1] for e in live.events] == ["commands", "commands"]


def test_live_says_in_one_line_what_was_given():
    live = estimator()
    for commands, measurements in ((np.zeros((9, 9)), {}), ((0.0, 0.0), np.zeros((9, 9)))):
        with pytest.raises(CraneError, match="found array") as refusal:
            live.step(commands, measurements)
        assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize("method", ["ukf", "sr-ukf", "ckf", "ekf"])
def test_all_filters_follow_the_crane(method):
    estimate = estimator(method=method).run(recording())
    e = error(estimate)
    assert (e[:2] < 0.03).all() and (e[2:4] < 0.5).all() and (e[4:] < 1.0).all()
    assert not estimate.events


def test_sensors_of_other_kinds():
    """Cylinder lengths, absolute angle and rates in place of the angles; s is not linear in the state."""
    std = STD | {"s1": 2e-4, "s2": 2e-4, "z4_abs": STD["z4"], "dz1": 0.01}
    for names in (("s1", "s2", "p1", "p4"), ("z1", "z4_abs", "dz1", "p2", "p3")):
        values = recording(names, std=std)
        estimate = Estimator(CRANE, "semi-recursive", {n: std[n] for n in names}).run(values)
        assert (error(estimate)[:2] < 0.1).all()
        assert estimate.nis_mean == pytest.approx(len(names), rel=0.1)


def test_sensors_with_clocks_of_their_own():
    values = readings(FOUR, np.random.default_rng(2))
    sensors = {"z1": (TIME[::10], values["z1"][::10]), "z4": (TIME[3::25] + 4e-4, values["z4"][3::25])}
    sensors |= {"p1": (TIME[::2], values["p1"][::2]), "p4": (TIME[1::7], values["p4"][1::7])}
    estimate = estimator().run(Signals(TIME, COMMANDS, sensors))
    assert (np.isfinite(estimate.measured).sum(axis=0) == [v[0].size for v in sensors.values()]).all()
    assert (error(estimate)[:2] < 0.1).all()
    assert not estimate.events


def test_hundred_hertz_is_followed_with_inner_steps():
    estimate = estimator().run(recording(every=10))
    assert estimate.time.size == 301
    assert (error(estimate)[:2] < 0.05).all() and (error(estimate)[4:] < 2.0).all()


def test_gap_and_missing_samples():
    signals = recording()
    keep = (TIME < 1.0) | (TIME > 1.8)
    sensors = {n: (t[keep], v[keep]) for n, (t, v) in signals.sensors.items()}
    sensors["p1"][1][50:90] = np.nan
    estimate = estimator().run(Signals(TIME, COMMANDS, sensors))
    assert [e.where for e in estimate.events] == ["time"] and "gap" in estimate.events[0].text
    assert estimate.events[0].start == pytest.approx(1.0, abs=2e-3)
    assert (error(estimate, after=2.0)[:2] < 0.1).all()
    growth = (
        estimate.std[np.searchsorted(estimate.time, 1.79), 0] / estimate.std[np.searchsorted(estimate.time, 0.99), 0]
    )
    assert growth > 2.0


def test_repeated_and_backward_stamps_are_told_and_left_out():
    signals = recording(every=5)
    t = signals.sensors["z1"][0].copy()
    t[100], t[200] = t[99], t[198]
    sensors = dict(signals.sensors) | {"z1": (t, signals.sensors["z1"][1])}
    estimate = estimator().run(Signals(TIME, COMMANDS, sensors))
    told = [e for e in estimate.events if e.where == "z1"]
    assert len(told) == 1 and told[0].count == 2
    assert (error(estimate)[:2] < 0.05).all()


def test_frozen_sensor_is_recognised_and_left_out():
    signals = recording()
    values = signals.sensors["z4"][1].copy()
    values[700:1500] = values[700]
    sensors = dict(signals.sensors) | {"z4": (TIME, values)}
    estimate = estimator().run(Signals(TIME, COMMANDS, sensors))
    frozen = [e for e in estimate.events if "frozen" in e.text]
    assert len(frozen) == 1 and frozen[0].where == "z4"
    assert frozen[0].start == pytest.approx(0.725, abs=0.01) and frozen[0].end == pytest.approx(1.499, abs=0.01)
    assert (estimate.flags[800:1500, 1] == FROZEN).all() and (estimate.flags[1600:, 1] != FROZEN).all()
    assert (error(estimate, after=1.6)[:2] < 0.1).all()


@pytest.mark.parametrize("back", [True, False])
def test_jump_of_fifty_bar_is_rejected(back):
    signals = recording(std=STD | {"p4": 1.5e5})
    values = signals.sensors["p4"][1].copy()
    values[1000 : 2000 if back else None] += 50e5
    sensors = {n: STD[n] for n in FOUR} | {"p4": 1.5e5}
    shown = Signals(TIME, COMMANDS, dict(signals.sensors) | {"p4": (TIME, values)})
    estimate = Estimator(CRANE, "semi-recursive", sensors).run(shown)
    rejected = estimate.flags[:, 3] == OUTLIER
    assert rejected[1000:2000].all() and not rejected[:1000].any()
    if back:
        assert not rejected[2010:].any()
    jump = [e for e in estimate.events if e.where == "p4"]
    assert len(jump) == 1 and jump[0].start == pytest.approx(1.0, abs=2e-3)
    assert (error(estimate)[4:] < 2.0).all()


def test_single_spikes_are_rejected():
    signals = recording()
    values = signals.sensors["p1"][1].copy()
    values[[600, 1100, 1101]] += 30e5
    estimate = estimator().run(Signals(TIME, COMMANDS, dict(signals.sensors) | {"p1": (TIME, values)}))
    assert (estimate.flags[:, 2] == OUTLIER).nonzero()[0].tolist() == [600, 1100, 1101]


def test_a_wrong_model_is_not_taken_for_wrong_sensors():
    """A pump 40 bar too high and a valve 30 % too large: innovations grow, no sample is rejected, inconsistency is
    said.
    """
    wrong = CRANE.with_parameters(
        {"supply.pump_pressure": 140e5, "valves.lift.flow_coefficient": 1.3 * CRANE["valves.lift.flow_coefficient"]}
    )
    estimate = estimator(crane=wrong, noise=ProcessNoise((1e-3, 1e-3), (1e10,) * 4)).run(recording())
    assert not [e for e in estimate.events if "rejected" in e.text]
    assert not estimate.consistent and "narrow" in estimate.verdict
    assert (error(estimate)[:2] < 1.0).all()


def test_right_model_is_called_consistent():
    """With process noise as it is in the truth (none but the little that the filter assumes)."""
    estimate = estimator(noise=ProcessNoise((1e-7, 1e-7), (1e4,) * 4)).run(recording())
    assert estimate.consistent, repr(estimate)


OPEN = Path(__file__).parent / "data"


@pytest.mark.parametrize(("case", "right"), [("none_learn", True), ("none_check", True), ("friction_O_check", False)])
def test_verdict_on_recordings_that_others_made(case, right):
    """Scaled noise: a right model is called consistent, with its noise far below the default, a wrong one is not."""
    measured = Recording.load(OPEN / f"open_{case}.csv.gz")
    std = sensor_noise(CRANE, measured, None)
    signals = cut(Signals.of(measured, CRANE), 0.0, 10.0)
    noise = scale(CRANE, signals, std, seconds=3.0).noise
    estimate = Estimator(CRANE, "semi-recursive", std, noise, max_step=5e-3).run(signals)
    assert estimate.consistent == right, repr(estimate)
    assert (noise.pressure[0] < ProcessNoise.of(CRANE.layout).pressure[0]) == right
    assert right or (estimate.persistent and "lacks something" in estimate.verdict)


def test_a_recording_may_begin_in_motion():
    """Cut out of the middle of a movement: rates and pressures change over the first samples, and nothing is
    rejected.
    """
    moving = cut(recording(every=5), 1.95, 1.0)
    estimate = estimator(noise=ProcessNoise((1e-7, 1e-7), (1e5,) * 4)).run(moving)
    assert abs(TRUTH[1950, 2]) > 0.1 and not estimate.events
    assert estimate.consistent, repr(estimate)


@pytest.mark.parametrize(
    ("changes", "name", "tolerance"),
    [
        ({"payload.mass": 120.0}, "payload.mass", 5.0),
        ({"supply.pump_pressure": 115e5}, "supply.pump_pressure", 1e5),
    ],
)
def test_unknown_parameters_are_found(changes, name, tolerance):
    crane = CRANE.with_parameters(changes)
    time, commands, _, states = run_of(crane)
    signals = recording(tuple(STD), time=time, commands=commands, states=states)
    estimate = estimator(tuple(STD), augment=(name,)).run(signals)
    assert estimate[name][-1] == pytest.approx(changes[name], abs=tolerance)
    assert estimate.units[name] in ("kg", "Pa")


@pytest.mark.parametrize("gap", [False, True])
def test_a_payload_is_found_by_going_through_the_beginning_again(gap):
    """The truth is in the interval all along; a long gap, after which the commands are others, ends the beginning, and
    what was noted is told by nobody.
    """
    crane = CRANE.with_parameters({"payload.mass": 10.0})
    signals = recording(every=2)
    if gap:
        signals = Signals(
            TIME, COMMANDS, {n: (np.where(t > 0.2, t + 11.0, t), y) for n, (t, y) in signals.sensors.items()}
        )
    noise = ProcessNoise((1e-5, 1e-5), (1e7, 1e7, 1e7, 1e7))
    load = Augment("payload.mass", 115.0, drift=0.1)
    filter_ = estimator(
        crane=crane, noise=noise, method="ekf", augment=[load], max_step=2e-3, revisit=Revisit(1.5), gate=None
    )
    found = filter_.run(signals, smooth=True)
    mass, std = found["payload.mass"], found.std[:, found.state_names.index("payload.mass")]
    known = found.time <= (0.2 if gap else TIME[-1])
    assert (np.abs(mass - 25.0) < 3.0 * std + 1e-6)[known].mean() > 0.95
    if gap:
        assert any("restarted from the sensors" in e.text for e in found.events)
        return
    assert mass[-1] == pytest.approx(25.0, abs=1.0) and std[-1] < 1.0


def test_unknown_inputs_are_found():
    """A moment on the lift boom, a force on the outer boom, a leak into nowhere: each is found while the others are
    free.
    """
    engine = SemiRecursiveEngine(CRANE)
    disturbances = {"torque.O": 400.0, "force.y": -300.0, "flow.p2": -1e-5}
    states = [engine.static_start(0.2, -0.75)]
    for k in range(TIME.size - 1):
        parameters = {n: np.array([v]) for n, v in disturbances.items()}
        states.append(engine.propagate(states[-1][None], INPUTS[k : k + 2], 1e-3, TIME[k], parameters)[0])
    augment = (Augment("torque.O", 500.0), Augment("force.y", 500.0), Augment("flow.p2", 2e-5))
    signals = recording(tuple(STD), states=np.array(states))
    estimate = estimator(tuple(STD), augment=augment).run(signals)
    for name, value in disturbances.items():
        assert estimate[name][-1] == pytest.approx(value, abs=0.15 * abs(value))


def test_both_engines_carry_extra_states_alike():
    """Parameters, a moment and a flow that differ from sigma point to sigma point: the engines share no equation."""
    names = ("payload.mass", "torque.O", "flow.p2", "joints.A.x", "bodies.lift_boom.mass")
    sensors = {n: (t[300:340], v[300:340]) for n, (t, v) in recording().sensors.items()}
    part = Signals(TIME[300:340], COMMANDS[300:340], sensors)
    engines = ExudynEngine(CRANE, accuracy=0.01), SemiRecursiveEngine(CRANE, accuracy=0.01)
    one, other = (estimator(engine=e, augment=names).run(part) for e in engines)
    difference = np.abs(one.mean - other.mean).max(axis=0) / other.std.max(axis=0)
    assert (difference < 1e-4).all()  # the engines' solvers stop at 1e-11 and 1e-12, the filter adds 40 steps


def test_swinging_payload_is_followed():
    crane = CRANE.with_effect("payload_swing", {"length": 1.0, "damping": 5.0}).with_parameters({"payload.mass": 100.0})
    _, _, _, states = run_of(crane)
    estimate = estimator(tuple(STD), crane=crane).run(recording(tuple(STD), states=states))
    assert estimate.state_names[8:] == ("theta", "dtheta")
    late = estimate.time > 1.5
    swing = np.abs(states[late, 8]).max()
    assert swing > 0.05 and np.abs(estimate.mean[late, 8] - states[late, 8]).max() < 0.15 * swing


def test_measured_supply_pressures_drive_the_model():
    """The pump falls to 70 bar: with its pressure as an input the filter is consistent, without it is not."""
    engine, pump = SemiRecursiveEngine(CRANE), np.where(TIME < 0.4, 100e5, 70e5)
    inputs = np.column_stack([INPUTS[:, :2], pump, np.full(TIME.size, 1e5)])
    states = engine.simulate(engine.static_start(0.2, -0.75), TIME, inputs)
    blind = recording(states=states)
    seeing = Signals(TIME, COMMANDS, blind.sensors, {"pp": (TIME, pump), "pt": (TIME, np.full(TIME.size, 1e5))})
    quiet = ProcessNoise((1e-6, 1e-6), (1e6,) * 4)
    with_pump, without = (estimator(noise=quiet).run(s) for s in (seeing, blind))
    np.testing.assert_allclose(with_pump.inputs[:, 2], pump)
    assert with_pump.nis_mean == pytest.approx(4.0, rel=0.1) and without.nis_mean > 10.0


def test_sensor_bias_is_found():
    signals = recording(tuple(STD))
    sensors = dict(signals.sensors) | {"p3": (TIME, signals.sensors["p3"][1] + 4e5)}
    found = estimator(tuple(STD), augment=("bias.p3",)).run(Signals(TIME, COMMANDS, sensors))
    assert found["bias.p3"][-1] == pytest.approx(4e5, abs=0.5e5)
    with pytest.raises(CraneError, match="no sensor"):
        estimator(("z1", "p1"), augment=("bias.p3",))


def test_a_gauge_that_shows_pressure_fills_a_void_of_the_model_and_is_not_taken_to_be_off():
    names = (*FOUR, "p2", "p3")
    live = estimator(names, augment=(Augment("bias.p2", 15e5, memory=10.0),))
    live.reset(fills=True)  # as over a recording
    columns = [ROWS[n] for n in names]
    rest = {n: float(TRUTH[0, c]) for n, c in zip(names, columns, strict=True)}
    live.step((0.0, 0.0), rest, 0.0)
    p2 = ROWS["p2"]
    live.belief.mean[p2] = -3e7  # the model has lost oil there that the machine has not
    live.belief.covariance[p2, p2] = 1e12
    for k in range(1, 40):
        now = live.step((0.0, 0.0), rest, 0.005 * k)
    assert now["p2"] == pytest.approx(rest["p2"], abs=2e5)
    assert abs(now["bias.p2"]) < 2e5


def test_sensor_effects_of_the_crane_are_in_the_measurement_function():
    crane = CRANE.with_effect("sensor_bias@p1", {"b": 5e5}).with_effect("sensor_lag@z1", {"tau": 0.05})
    signals = recording()
    shown = TRUTH[:, 0].copy()
    decay = np.exp(-1e-3 / 0.05)
    for k in range(1, shown.size):  # the exact follower of a piecewise linear signal
        slope = (TRUTH[k, 0] - TRUTH[k - 1, 0]) / 1e-3
        shown[k] = TRUTH[k, 0] - slope * 0.05 + (shown[k - 1] - TRUTH[k - 1, 0] + slope * 0.05) * decay
    noise = np.random.default_rng(8).normal(size=shown.size) * STD["z1"]
    sensors = dict(signals.sensors) | {"p1": (TIME, signals.sensors["p1"][1] + 5e5), "z1": (TIME, shown + noise)}
    estimate = estimator(crane=crane).run(Signals(TIME, COMMANDS, sensors))
    assert estimate.state_names[8] == "reading.z1"
    assert (error(estimate)[:2] < 0.05).all() and error(estimate)[4] < 0.5


def test_smoother_is_better_than_the_filter():
    off = TRUTH[0] + np.array([0.0, 0.0, 0.0, 0.0, 8e5, 8e5, -8e5, -8e5])
    start = Belief(off, np.diag([0.01, 0.01, 0.05, 0.05, *[1e6] * 4]) ** 2)
    truth, filtered, smoothed = visible(CRANE, TRUTH[::10]), np.zeros(8), np.zeros(8)
    for seed in range(5):
        signals = recording(("z1", "z4"), every=10, seed=seed)
        estimate = estimator(("z1", "z4"), start=start).run(signals, smooth=True)
        assert estimate.smoothed is not None
        variances = (np.einsum("nii->ni", e.covariance) for e in (estimate.smoothed, estimate))
        assert np.less_equal(next(variances), next(variances) * (1 + 1e-9)).all()
        early = (estimate.time > 0.05) & (estimate.time < 1.5)
        filtered += np.mean((estimate.mean[early] - truth[early]) ** 2, axis=0)
        smoothed += np.mean((estimate.smoothed.mean[early] - truth[early]) ** 2, axis=0)
    # dz4 is known three times better than its interval says, so there is nothing to gain from later samples
    assert (np.delete(smoothed, 3) < np.delete(filtered, 3)).all()


def test_tuning_raises_the_likelihood():
    """A truth that is shaken by known noise: the search finds its size to half an order of magnitude."""
    engine, rng = SemiRecursiveEngine(CRANE), np.random.default_rng(6)
    true = ProcessNoise((1e-2, 1e-2), (3e10, 3e10, 1e9, 1e9))
    root = np.linalg.cholesky(true.covariance(5e-3) + 1e-30 * np.eye(8))
    states = [engine.static_start(0.2, -0.75)]
    for k in range(0, 1500, 5):
        step = engine.propagate(states[-1][None], INPUTS[[k, k + 5]], 5e-3)[0]
        states.append(step + root @ rng.normal(size=8))
    time = TIME[:1501:5]
    signals = recording(tuple(STD), time=time, commands=COMMANDS[:1501:5], states=np.array(states))
    found = tune(CRANE, signals, STD, start=ProcessNoise((1e-5, 1e-5), (1e7,) * 4), evaluations=35)
    assert found.after > found.before
    assert np.log10(found.noise.acceleration) == pytest.approx([-2, -2], abs=0.7)
    assert np.log10(found.noise.pressure) == pytest.approx([10.5, 10.5, 9.0, 9.0], abs=0.7)


def test_busiest_stretch():
    part = busiest(recording(), 1.0)
    assert part.command_time[-1] - part.command_time[0] == pytest.approx(1.0, abs=0.01)
    assert all(t.size for t, _ in part.sensors.values())


def test_two_minutes_of_rest_leave_intervals_as_they_are():
    """At 5 Hz with long inner steps; the crane swings about for the first three seconds and then rests.

    What has settled after 20 s does not drift, so it stays as it is however long a recording is.
    """
    time = np.arange(0, 120.01, 0.2)
    commands = pulses(time)
    engine = SemiRecursiveEngine(CRANE, step=2e-2)
    inputs = np.column_stack([SpoolPath(CRANE).run(time, commands), np.full((time.size, 2), np.nan)])
    states = engine.simulate(engine.static_start(0.2, -0.75), time, inputs, step=2e-2)
    signals = recording(time=time, commands=commands, states=states)
    estimate = estimator(engine=engine, max_step=2e-2).run(signals)
    assert np.isfinite(estimate.mean).all()
    settled = estimate.std[estimate.time > 20.0]
    assert (settled.max(axis=0) < 1.1 * settled.min(axis=0)).all()  # they go by the noise
    np.testing.assert_allclose(*(half.mean(axis=0) for half in np.array_split(settled, 2)), rtol=0.01)
    assert (error(estimate, states, time, after=20.0)[:2] < 0.05).all()


class Failing(SemiRecursiveEngine):
    """An engine that fails once in a while."""

    count = 0

    def propagate(self, states, inputs, dt, time=0.0, parameters=None):
        """Fail at every 400th call."""
        self.count += 1
        if self.count % 400 == 0:
            raise CraneError("the step did not converge")
        return super().propagate(states, inputs, dt, time, parameters)


def test_a_failing_engine_restarts_the_filter_and_is_told():
    estimate = estimator(engine=Failing(CRANE)).run(recording(every=5))
    restarts = [e for e in estimate.events if e.where == "filter"]
    assert restarts and restarts[0].count == 7 and "did not converge" in restarts[0].text
    assert np.isfinite(estimate.mean).all() and (error(estimate)[:2] < 1.0).all()


def test_unphysical_sigma_points_keep_mean_and_covariance():
    """Carrying the excess through leaves the statistics of a state at the vapour floor as they are; clipping would
    not.
    """
    bounds = Bounds(np.array([0.0, -np.inf]), np.array([np.inf, np.inf]))
    belief, weights = Belief(np.array([0.5, 1.0]), np.array([[4.0, 1.0], [1.0, 2.0]])), merwe(2)
    from ukf import filter as kf

    seen = []

    def carried(points):
        inside, excess = bounds.split(points)
        seen.append(inside)
        return inside + (0.0 if excess is None else excess)

    after = kf.predict(belief, carried, np.zeros((2, 2)), weights)
    np.testing.assert_allclose(after.mean, belief.mean, atol=1e-14)
    np.testing.assert_allclose(after.covariance, belief.covariance, atol=1e-14)
    assert (seen[0][:, 0] >= 0.0).all()
    clipped = kf.predict(belief, lambda p: bounds.split(p)[0], np.zeros((2, 2)), weights)
    assert clipped.mean[0] > 0.6 and clipped.covariance[0, 0] < 3.5


def test_mean_is_projected_along_the_covariance():
    bounds = Bounds(np.array([0.0, -np.inf]), np.array([np.inf, np.inf]))
    covariance = np.array([[4.0, 2.0], [2.0, 9.0]])
    np.testing.assert_allclose(bounds.project(np.array([-1.0, 5.0]), covariance), [0.0, 5.5])
    inside = np.array([1.0, 5.0])
    assert bounds.project(inside, covariance) is inside


def test_bounds_are_the_ends_of_the_strokes():
    bounds = crane_bounds(CRANE, lambda z: cylinder_lengths(CRANE, z), 8)
    assert (bounds.lower[4:] == -0.5 * CRANE["fluid.oil_bulk_modulus"]).all()  # a chamber that is half empty
    finite = 0
    for i, cylinder in enumerate(("lift", "tilt")):
        empty = CRANE[f"cylinders.{cylinder}.empty_length"]
        full = empty + CRANE[f"cylinders.{cylinder}.chamber_range"]
        for limit, beyond in ((bounds.lower[i], -np.radians(1.0)), (bounds.upper[i], np.radians(1.0))):
            if not np.isfinite(limit):
                continue
            finite += 1
            z = np.tile(CRANE.initial.pose, (2, 1))
            z[:, i] = limit, limit + beyond
            inside, outside = cylinder_lengths(CRANE, z)[:, i]
            assert empty < inside < full and not empty + 5e-3 < outside < full - 5e-3
    assert finite >= 2
    assert bounds.lower[0] < TRUTH[:, 0].min() and bounds.upper[0] > TRUTH[:, 0].max()


def test_a_wrong_stroke_in_the_crane_file_does_not_hold_the_filter_back():
    """The real boom goes 3° further than the file's lift cylinder is long: the filter goes along."""
    longest = cylinder_lengths(CRANE, TRUTH[:, :2])[:, 0].max()
    short = longest - 0.02 - CRANE["cylinders.lift.empty_length"]
    estimate = estimator(crane=CRANE.with_parameters({"cylinders.lift.chamber_range": short})).run(recording())
    assert (error(estimate)[:2] < 0.2).all()


def test_engine_without_parameters_refuses_augmented_states():
    class Plain:
        state_names = ("z1", "z4", "dz1", "dz4", "p1", "p2", "p3", "p4")

        def propagate(self, states, inputs, dt, time=0.0):
            return states

    with pytest.raises(CraneError, match="semi-recursive"):
        estimator(engine=Plain(), augment=("payload.mass",))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"sensors": {}}, "no sensor"),
        ({"sensors": {"z2": 0.1}}, "z2"),
        ({"sensors": {"z1": -1.0}}, "'z1': the noise is -1.0. Give a positive deviation in rad"),
        ({"sensors": {"z1": "0.1"}}, "'z1': the noise is '0.1'. Give one number"),
        ({"sensors": {"z1": True}}, "'z1': the noise is True. Give one number"),
        ({"method": "kalman"}, "no filter"),
        ({"engine": "matlab"}, "no engine"),
        ({"augment": ("payload.mas",)}, "payload.mass"),
        ({"augment": ("bias.z1", "bias.z1")}, "twice"),
        ({"augment": (300,)}, "augmented state 300 is neither a name nor an Augment. Give a name"),
        ({"augment": ("internal_leakage@lift.q",)}, "no such parameter"),
        ({"revisit": Revisit(1.0)}, "needs the filter"),
    ],
)
def test_bad_arguments_are_refused(options, message):
    options = {"engine": "semi-recursive", "sensors": {"z1": 1e-3}} | options
    with pytest.raises(CraneError, match=message):
        Estimator(CRANE, **options)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"std": 0.0}, "std is 0.0. Give a positive"), ({"std": "300"}, "std is '300'. Give one number"),
        ({"memory": 0.0}, "memory is 0.0. Give a positive time"), ({"memory": -1.0}, "memory is -1.0"),
        ({"drift": np.nan}, "drift is nan"), ({"drift": -1.0}, "drift is -1.0. Give a positive number"),
    ],
)  # fmt: skip
def test_an_augmented_state_that_cannot_be_is_refused(options, message):
    with pytest.raises(CraneError, match=rf"augmented state 'torque\.O': its {message}"):
        Augment("torque.O", **options)


def test_thinned_signals_are_known_samples_on_a_growing_clock():
    time = np.arange(2000) * 1e-3
    values = np.where(np.arange(2000) % 10 == 5, 0.2, np.nan)
    twice = np.repeat(time, 3)
    signals = Signals(TIME, COMMANDS, {"z1": (time, values), "z4": (twice, np.full(6000, 0.3))})
    thin = {n: t for n, (t, _) in signals.thinned(100.0, CRANE.layout).sensors.items()}
    np.testing.assert_allclose(thin["z1"], time[5::10])
    np.testing.assert_allclose(thin["z4"], time[::10])


def test_recording_without_the_sensors_is_refused():
    with pytest.raises(CraneError, match="none of the estimator's sensors"):
        estimator(("z1",)).run(recording(("p1",)))


def test_csv_plot_and_document(tmp_path):
    estimate = estimator(augment=("payload.mass",)).run(recording(every=10))
    estimate.save(tmp_path / "out.csv")
    table = np.genfromtxt(tmp_path / "out.csv", delimiter=",", names=True, deletechars="")
    assert table.size == estimate.time.size
    np.testing.assert_allclose(table["z1[rad]"], estimate["z1"], rtol=1e-8)
    assert (table["payload.mass_low95[kg]"] < table["payload.mass_high95[kg]"]).all()
    figure = estimate.plot(TRUTH[::10])
    assert len(figure.axes) == 9 + 5
    figure.draw_without_rendering()
    for column in (figure.axes[:9], figure.axes[9:]):
        steps = np.diff([axes.get_position().y0 for axes in column])
        np.testing.assert_allclose(steps, steps.mean(), rtol=0.05)  # no gap in either
    document = estimate.document()
    assert document["filter"]["consistent"] == estimate.consistent and document["final"]["p1"]["unit"] == "Pa"
