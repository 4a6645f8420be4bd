"""What the Python interface says to arguments that cannot be right: one message, and no result of another machine."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn import Crane, Recording, load_effects, simulate
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import SpoolPath
from crane_exudyn.measurement import Measurement, lagged
from crane_exudyn.render import Scene
from crane_exudyn.static_start import static_start
from crane_exudyn.trajectory import Trajectory
from ukf.augment import Augment
from ukf.estimator import Estimator
from ukf.filter import Belief
from ukf.noise import PaperNoise, ProcessNoise
from ukf.revisit import Revisit
from ukf.side_by_side import SideBySide
from validation import crosscheck as cc
from validation import diagnosis, report
from validation.improvement import improve
from validation.learning import learn
from validation.semi_recursive import SemiRecursiveEngine

CRANE = Crane.load("patu655")
HEAVY = CRANE.with_parameters({"payload.mass": 300.0})
LEAKING = CRANE.with_effect("internal_leakage@lift", {"k": 1e-11})
KINDS = [ExudynEngine, SemiRecursiveEngine]
CLOSED = np.array([0.0, 0.0, math.nan, math.nan])
TIME = np.arange(0.0, 0.2, 0.01)
STILL = Recording.from_arrays("still", TIME, {"u1": 0.0 * TIME, "u2": 0.0 * TIME})


def push(mbs, plant, number):
    """An object of one's own that is never built here."""


@pytest.fixture(scope="module")
def engines():
    return {kind: kind(CRANE) for kind in KINDS}


@pytest.fixture(scope="module")
def start(engines):
    return engines[SemiRecursiveEngine].static_start(np.radians(10), np.radians(-40))


@pytest.fixture(scope="module")
def run(engines):
    return simulate(CRANE, STILL, engine=engines[SemiRecursiveEngine])


def step(spool, rows=0):
    """Return the inputs of one step whose first spool ends at a position; a row for each of a batch, if so many."""
    w = np.array([CLOSED, [spool, 0.0, math.nan, math.nan]])
    return np.repeat(w[:, None], rows, axis=1) if rows else w


# -- an engine of another crane ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_an_engine_of_another_crane_is_refused(kind):
    with pytest.raises(CraneError, match=r"payload\.mass is 300, not 25.*Make one of this crane"):
        simulate(CRANE, STILL, engine=kind(HEAVY))
    with pytest.raises(CraneError, match=r"payload\.mass is 300"):
        Estimator(CRANE, kind(HEAVY), ("z1",))
    with pytest.raises(CraneError, match=r"payload\.mass is 300"):
        Estimator(CRANE, "semi-recursive", ("z1",), method="ekf", revisit=Revisit(1.0, kind(HEAVY)))


def test_effects_machine_and_objects_tell_engines_apart(engines):
    ours = engines[SemiRecursiveEngine]
    for crane, message in (
        (LEAKING, "effect internal_leakage@lift is not the same"),
        (CRANE.with_objects(push), "0 user-defined objects, this one 1"),
        (Crane.load("loader"), "of another machine"),
    ):
        with pytest.raises(CraneError, match=message):
            simulate(crane, STILL, engine=ours)


def test_an_engine_of_an_equal_crane_is_taken(engines):
    """What no engine computes with may differ: a name, the noise of sensors, a history."""
    alike = replace(Crane.load("patu655"), name="mine", sensors={"z1": 1e-3}).with_history({"n": 1})
    assert simulate(alike, STILL, engine=engines[SemiRecursiveEngine]).crane.name == "mine"
    assert Estimator(alike, engines[SemiRecursiveEngine]).crane is alike


@pytest.mark.parametrize("engine", [SemiRecursiveEngine, 5, {"name": "exudyn"}])
def test_what_is_no_engine_is_refused(engine):
    with pytest.raises(CraneError, match="an engine object"):
        simulate(CRANE, STILL, engine=engine)


def test_engines_are_known_by_name_everywhere(run):
    named = simulate(CRANE, STILL, engine="semi-recursive")
    assert np.array_equal(named.states, run.states)
    with pytest.raises(CraneError, match="no engine 'semirecursive'"):
        simulate(CRANE, STILL, engine="semirecursive")


@pytest.mark.parametrize("kind", [*KINDS, Estimator, cc.crosscheck])
def test_a_name_is_no_crane(kind):
    with pytest.raises(CraneError, match=r"found 'patu655' instead of a crane\. Crane\.load\('patu655'\) gives one"):
        kind("patu655")


# -- shapes ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("X", [np.ones((1, 2)), np.ones(8), np.ones((1, 7))])
def test_sensors_do_not_read_beyond_a_state(X):
    sensors, time = Measurement.of(CRANE, ("z1", "p1")), np.zeros(len(X))
    P, E = sensors.P[None], sensors.E[None]
    asked = [
        lambda: sensors.read(X),
        lambda: sensors.rows(X),
        lambda: sensors.shown(X, time),
        lambda: sensors.shown_on(X, time, P, E),
        lambda: sensors.shown_rows(X, np.zeros((*X.shape, 1)), time),
        lambda: sensors.differs(X, P, E),
        lambda: sensors.check(CRANE, np.ones((1, 2)), X),
    ]
    for ask in asked:
        with pytest.raises(CraneError, match=r"states have shape .*, expected \(n, 8\) for z1 z4"):
            ask()


def test_sensors_want_a_time_for_each_state_and_whole_cranes():
    sensors, X = Measurement.of(LEAKING.with_effect("sensor_lag@z1", {"tau": 0.1}), ("z1", "p1")), np.ones((3, 8))
    P, E = sensors.P[None], sensors.E[None]
    for ask in (
        lambda: sensors.shown(X, TIME[:2]),
        lambda: sensors.shown_on(X, TIME[:2], P, E),
        lambda: sensors.shown_rows(X, np.ones((3, 8, 1)), TIME[:2]),
    ):
        with pytest.raises(CraneError, match=r"time has shape \(2,\), expected \(3,\)"):
            ask()
    with pytest.raises(CraneError, match=r"time has shape \(2,\), y \(3,\)"):
        lagged(np.ones(3), TIME[:2], 0.1)
    with pytest.raises(CraneError, match=r"P and E have shapes \(1, 5\)"):
        sensors.shown_on(X, TIME[:3], P[:, :5], E)
    with pytest.raises(CraneError, match=r"derivative of states \(3, 8\) has shape \(3, 7, 1\)"):
        sensors.shown_rows(X, np.ones((3, 7, 1)), TIME[:3])
    wider = np.column_stack([X, 9.0 * X])  # a filter's points have more behind
    assert np.array_equal(sensors.read(wider), sensors.read(X))


@pytest.mark.parametrize("kind", KINDS)
def test_terms_want_all_inputs(kind, engines, start):
    engine, lay = engines[kind], CRANE.layout
    for w in (CLOSED[:2], CLOSED[:3], np.zeros(5), np.float64(0.0), CLOSED[None]):
        with pytest.raises(CraneError, match=r"w have shape .*, expected \(4,\) with \[U1 U2 pp pt\], or \(12,\)"):
            engine.terms(start, w)
    with pytest.raises(CraneError, match=r"a state has 8 numbers, found shape \(7,\)"):
        engine.terms(start[:7], CLOSED)
    wide = np.concatenate([CLOSED, np.zeros(len(lay.disturbances))])
    assert engine.terms(start, wide) == engine.terms(start, CLOSED)


def test_the_residual_and_many_terms_want_all_inputs(engines, start):
    with pytest.raises(CraneError, match=r"w have shape \(2,\)"):
        engines[ExudynEngine].residual(start, CLOSED[:2])
    with pytest.raises(CraneError, match=r"found shape \(4,\)"):
        engines[ExudynEngine].residual(start[:4], CLOSED)
    along = engines[SemiRecursiveEngine].terms_along
    with pytest.raises(CraneError, match=r"inputs have the shape \(1, 2\)"):
        along(start[None], CLOSED[None, :2], np.zeros(1))
    with pytest.raises(CraneError, match=r"states have the shape \(1, 7\)"):
        along(start[None, :7], CLOSED[None], np.zeros(1))
    with pytest.raises(CraneError, match=r"time \(2,\)"):
        along(start[None], CLOSED[None], np.zeros(2))


# -- spool positions ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("spool", [math.nan, math.inf, 1.2, -50.0])
@pytest.mark.parametrize("kind", KINDS)
def test_no_spool_stands_there(kind, spool, engines, start):
    engine = engines[kind]
    with pytest.raises(CraneError, match=r"spool position at the end of the step is U1 = .*from -1 to 1"):
        engine.propagate(start[None], step(spool), 1e-3)
    with pytest.raises(CraneError, match=r"spool position at the end of the step of row 0 is U1 = "):
        engine.propagate(start[None].repeat(2, 0), step(spool, rows=2), 1e-3)
    with pytest.raises(CraneError, match=r"spool position at sample 1 is U1 = "):
        engine.simulate(start, np.array([0.0, 0.1]), step(spool))


@pytest.mark.parametrize("kind", KINDS)
def test_a_spool_may_read_a_little_beyond_its_end(kind, engines, start):
    assert np.isfinite(engines[kind].propagate(start[None], step(1.05), 1e-3)).all()


# -- what differs from row to row --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"payload.mass": [-100.0, 2.0]}, r"row 0: payload\.mass = -100 kg is impossible: it must be >= 0"),
        ({"payload.mass": [0.0, math.nan]}, r"row 1: payload\.mass = nan is not finite"),
        ({"payload.mass": [0.0, math.inf]}, r"row 1: payload\.mass = inf is not finite"),
        ({"payload.mass": [1.0, 2.0], "bodies.lift_boom.mass": [0.0, 90.0]}, r"row 0: bodies\.lift_boom\.mass = 0 kg"),
        ({"cylinders.lift.bore": [0.1, 0.02]}, r"row 1: cylinders\.lift\.rod = 0\.056 m is not thinner .* 0\.02 m"),
        ({"cylinders.tilt.rod": [0.2, 0.05]}, r"row 0: cylinders\.tilt\.rod = 0\.2 m is not thinner"),
        ({"fluid.oil_bulk_modulus": [1e9, -1e9]}, r"row 1: fluid\.oil_bulk_modulus = -1e\+09 Pa .* must be > 0"),
        ({"internal_leakage@lift.k": [1e-12, -1e-12]}, r"row 1: internal_leakage@lift\.k = -1e-12 is impossible"),
        ({"supply.pressure_reference": [1.0, 0.5]}, r"row 1: supply\.pressure_reference = 0\.5 is impossible"),
        ({"payload.mass": [1.0, 2.0, 3.0]}, r"'payload\.mass' has the shape \(3,\), expected \(2,\)"),
        ({"flow.p1": [[1.0], [2.0]]}, r"'flow\.p1' has the shape \(2, 1\), expected \(2,\)"),
        ({"payload.mass": "heavy"}, r"'payload\.mass' has the shape \(\), expected \(2,\) numbers in SI"),
        ({"payload.mas": [1.0, 2.0]}, r"there is no 'payload\.mas'.*payload\.mass"),
    ],
)
@pytest.mark.parametrize("kind", KINDS)
def test_rows_that_no_crane_can_have_are_refused(kind, parameters, message, engines, start):
    engine, states = engines[kind], start[None].repeat(2, 0)
    given = {n: v if isinstance(v, str) else np.array(v) for n, v in parameters.items()}
    before = engine.propagate(states, step(0.1), 1e-3)
    with pytest.raises(CraneError, match=message):
        engine.propagate(states, step(0.1), 1e-3, parameters=given)
    assert np.array_equal(engine.propagate(states, step(0.1), 1e-3), before)


@pytest.mark.parametrize("kind", KINDS)
def test_rows_at_their_limits_are_taken(kind, engines, start):
    """As sigma points are: a payload of nothing, an effect that does nothing, one that is more than usual."""
    states = start[None].repeat(2, 0)
    rows = {"payload.mass": np.array([0.0, 25.0]), "internal_leakage@lift.k": np.array([0.0, 1e-9])}
    together = engines[kind].propagate(states, step(0.1), 1e-3, parameters=rows | {"supply.pressure_reference": 0.0})
    alone = kind(CRANE.with_parameters({"payload.mass": 0.0})).propagate(start[None], step(0.1), 1e-3)
    assert together[0] == pytest.approx(alone[0], rel=1e-9) and np.isfinite(together).all()


def test_what_exudyn_refuses_is_told_in_the_cranes_terms(start):
    """Each number is possible, both together are no mass; what was set of it before that was found is forgotten."""
    refused, fresh = (ExudynEngine(CRANE, 2, accuracy=math.inf) for _ in range(2))  # no step goes to another system
    given, name = (start[None].repeat(2, 0), step(0.1), 1e-3, 0.5), "payload_change@.dm"
    with pytest.raises(CraneError, match=r"a body or a cylinder impossible at t = 0\.501 s .*Correct payload\.mass"):
        refused.propagate(*given, {name: np.array([-300.0, 50.0])})
    after, expected = (engine.propagate(*given, {name: np.array([0.0, 50.0])}) for engine in (refused, fresh))
    assert np.array_equal(after, expected) and not np.array_equal(after[0], after[1])


# -- the estimator -----------------------------------------------------------------------------------------------------


class Flat:
    """A noise of one's own, of the diagonal only."""

    def covariance(self, dt):
        """Return variances (8,) of dt s."""
        return np.full(8, dt)


BELIEF = Belief(np.zeros(8), np.eye(8))


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"noise": ProcessNoise((1e-4,), (1e8,))}, r"shape \(3, 3\), expected \(8, 8\).*z1 z4.*ProcessNoise\.of"),
        ({"noise": np.eye(8)}, r"type ndarray, which has no method covariance"),
        ({"noise": Flat()}, r"shape \(8,\), expected \(8, 8\)"),
        ({"noise": PaperNoise(math.nan)}, "and finite"),
        ({"start": replace(BELIEF, covariance=np.ones(8))}, r"shapes \(8,\) and \(8,\), expected .*np\.diag"),
        ({"start": replace(BELIEF, mean=np.ones(7))}, r"shapes \(7,\) and \(8, 8\)"),
        ({"start": replace(BELIEF, mean=np.full(8, np.nan))}, "not finite"),
        ({"start": np.zeros(8)}, r"expected \(8,\) and \(8, 8\)"),
        (
            {"start": replace(BELIEF, covariance=np.diag([1, 1, 0, 1, 1, 1, 1, 1]))},
            r"dz1 has variance 0\. Give",
        ),
        ({"start": replace(BELIEF, covariance=np.diag([1, 1, 1, 1, 1, 1, 1, -4]))}, r"p4 has variance -4\. Give"),
        (
            {"start": replace(BELIEF, covariance=np.eye(8) + np.eye(8, k=1))},
            "of z1 and z4 differs from that of z4 and z1",
        ),
        ({"start": replace(BELIEF, covariance=np.ones((8, 8)))}, "not positive definite: z4 follows"),
    ],
)
def test_noise_and_start_must_fit_the_machine(options, message, engines):
    with pytest.raises(CraneError, match=message):
        Estimator(CRANE, engines[SemiRecursiveEngine], ("z1",), **options)


@pytest.mark.parametrize(
    ("densities", "message"),
    [
        ((1e-4, 1e8), "acceleration is 0.0001"),
        (((1e-4, -1e-4), (1e8,) * 4), "acceleration is"),
        (((1e-4, 1e-4), (1e8, math.nan, 1e8, 1e8)), "pressure is"),
        (((1e-4, 1e-4), (1e8,) * 4, (1e-9,)), "1 densities of creep and 2 of acceleration"),
    ],
)
def test_densities_are_one_a_coordinate_and_not_below_zero(densities, message):
    with pytest.raises(CraneError, match=message):
        ProcessNoise(*densities)


def test_a_noise_may_leave_out_what_effects_add():
    swinging = CRANE.with_effect("payload_swing", {"length": 1.0, "damping": 1.0})
    assert Estimator(swinging, "semi-recursive", ("z1",)).process_noise(1e-3).shape == (10, 10)


def test_a_lone_name_is_one_name(engines):
    one = Estimator(CRANE, engines[SemiRecursiveEngine], "z1", augment="payload.mass")
    assert one.channel_names == ("z1",) and one.state_names[-1] == "payload.mass"
    assert Estimator(CRANE, engines[SemiRecursiveEngine], augment=Augment("payload.mass", 1.0)).size == 9
    assert Measurement.of(CRANE, "p1").names == ("p1",)


class Cutting(SemiRecursiveEngine):
    """An engine that forgets a state."""

    def propagate(self, *arguments, **keywords):
        """Return (n, 7)."""
        return super().propagate(*arguments, **keywords)[:, :7]


@pytest.mark.parametrize("method", ["ukf", "sr-ukf", "ekf"])
def test_an_engine_that_returns_no_states_is_told_and_not_a_failure_of_the_filter(method):
    estimator = Estimator(CRANE, Cutting(CRANE), ("z1", "z4"), method=method)
    estimator.step((0.0, 0.0), {"z1": 0.2, "z4": -0.7})
    with pytest.raises(
        CraneError, match=r"engine Cutting returned the shape \(\d+, 7\) for states of shape \(\d+, 8\)"
    ):
        estimator.step((0.0, 0.0), {"z1": 0.2, "z4": -0.7})


def test_names_and_probabilities_of_an_estimate(engines, run):
    recording = Recording.from_arrays("seen", TIME, {n: run[n] for n in ("u1", "u2", "z1", "z4", "p1", "p4")})
    estimator = Estimator(CRANE, engines[SemiRecursiveEngine], max_step=1e-2)
    now, estimate = estimator.step((0.0, 0.0), {"z1": 0.2}), estimator.run(recording)
    for known in (now, estimate):
        with pytest.raises(CraneError, match=r"no (estimated )?quantity 'z2'\. Did you mean .*\"z1\""):
            known["z2"]
        with pytest.raises(CraneError, match="quantity 3"):
            known[3]
    for probability in (95, 0.0, 1.0, -0.5, math.nan):
        with pytest.raises(CraneError, match=r"no probability between 0 and 1\. Give 0\.95"):
            estimate.interval(probability)
    low, high = estimate.interval(0.5)
    assert (low < high).all()


# -- numbers, names and files ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("value", ["150 kg", "150", True, None, np.array([1.0, 2.0]), [150.0], 1j, np.True_])
def test_a_parameter_is_one_number(value):
    with pytest.raises(CraneError, match=r"patu655: payload\.mass = .* is not a number\. Give one number in SI, in kg"):
        CRANE.with_parameters({"payload.mass": value})
    with pytest.raises(CraneError, match=r"effect 'internal_leakage': k = .* is not a number"):
        CRANE.with_effect("internal_leakage@lift", {"k": value})


@pytest.mark.parametrize("value", [150, np.float32(150.0), np.int64(150), np.array(150.0)])
def test_any_kind_of_number_is_one(value):
    changed = CRANE.with_parameters({"payload.mass": value})["payload.mass"]
    assert changed == 150.0 and type(changed) is float


@pytest.mark.parametrize("step", [-1.0, 0.0, math.nan])
def test_a_step_is_positive(step):
    with pytest.raises(CraneError, match=r"A step of .* s is not positive"):
        simulate(CRANE, STILL, step=step)


def test_names_of_a_run(run):
    with pytest.raises(CraneError, match=r"no channel 'z5'\. Did you mean .*z4"):
        run["z5"]
    with pytest.raises(CraneError, match="no channel 0"):
        run[0]
    assert "z1" in run and "q" not in run


MOVING = Recording.from_arrays("moving", TIME, {"u1": 0.0 * TIME, "u2": 0.0 * TIME, "z1": np.sin(TIME)})


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: Crane.load(None), "found None, expected the name of a file"),
        (lambda: CRANE.save(None), "found None, expected the name of a file"),
        (lambda: Recording.load(None), "found None, expected the name of a file"),
        (lambda: MOVING.save(None), "found None, expected the name of a file"),
        (lambda: Recording.load("r.csv", layout="patu655"), r"found 'patu655'.*crane\.layout"),
        (lambda: Recording.load("r.csv", "z1=Boom"), "found 'z1=Boom', expected values by name"),
        (lambda: CRANE.with_parameters(None), "parameters: found None, expected values by name"),
        (lambda: CRANE.with_effect("internal_leakage@lift", None), "internal_leakage@lift.*found None"),
        (lambda: CRANE.with_effect(5, {}), "no effect '5'"),
        (lambda: CRANE.without_effect("internal_leakage@lift"), r"no effect 'internal_leakage@lift'\. There are none"),
        (lambda: CRANE[3], "no parameter 3"),
        (lambda: MOVING[0], "no channel 0"),
        (lambda: MOVING[["z1"]], r"no channel \['z1'\]"),
        (lambda: MOVING.select([]), "no channel is named. Give some of u1, u2, z1"),
        (lambda: MOVING.aligned([]), "no channel is named"),
        (lambda: MOVING.select(5), "found 5, expected names"),
        (lambda: MOVING.with_noise(1e-3), "found 0.001, expected values by name"),
        (lambda: MOVING.with_noise({"z11": 1e-3}), "unknown sensor 'z11'"),
        (lambda: MOVING.with_noise({"z1": math.nan}), "z1 = nan is not a standard deviation"),
        (
            lambda: Recording.from_arrays("r", TIME[None], {"z1": TIME}),
            r"time has the shape \(1, 20\), expected \(n,\)",
        ),
        (lambda: Recording.from_arrays("r", TIME, {"z1": TIME[:, None]}), r"z1 has the shape \(20, 1\)"),
        (lambda: Recording.from_arrays("r", TIME, {"z1": ["a"] * 20}), "r: z1 is .*Give an array"),
        (lambda: Recording.from_arrays("r", TIME, None), "found None, expected values by name"),
        (lambda: cc.crosscheck(CRANE, effects="internal_leakag@lift"), "no effect 'internal_leakag@lift'"),
        (lambda: cc.crosscheck(CRANE, without=5), "without: found 5, expected names"),
        (
            lambda: static_start(CRANE, 0.1, -0.7, less_loaded=[1e5, 1e5, 1e5]),
            "has 3 pressures.* one each for lift, til",
        ),
        (lambda: static_start(CRANE, 0.1, -0.7, less_loaded="20 bar"), "less_loaded = '20 bar' is not a number.*in Pa"),
        (lambda: static_start(CRANE, np.zeros(2), -0.7), "z1 = .* is not a number.*in rad"),
        (lambda: load_effects(5), "load_effects: found 5, expected the name of a file"),
        (lambda: ExudynEngine(CRANE, accuracy="x"), "accuracy = 'x' is not a number"),
        (lambda: ExudynEngine(CRANE, accuracy=-1.0), "accuracy = -1 is not positive"),
        (lambda: report.render("T", "V", [], mood="happy"), "unknown mood 'happy'"),
        (lambda: report.Table(("a", "b"), [(1, 2), (1,)]), r"found the row \(1,\), expected 2 cells"),
        (lambda: report.Table(("a", "b"), [1]), "found the row 1, expected 2 cells"),
        (
            lambda: report.render("T", "V", [("S", [report.Picture("r1.png", "r")])]),
            "r1.png: the picture.*cannot be read",
        ),
        (lambda: report.render("T", "V", [("S", [5])]), "A part of the report is 5"),
    ],
)
def test_what_cannot_be_meant_is_told(ask, message):
    with pytest.raises(CraneError, match=message):
        ask()


def test_a_crane_stands_for_its_layout_and_a_lone_name_for_a_list(tmp_path):
    MOVING.save(tmp_path / "r.csv")
    assert Recording.load(tmp_path / "r.csv", layout=CRANE).layout is CRANE.layout
    assert list(MOVING.select("z1")) == ["z1"] and MOVING.aligned("z1")[1].shape == (20, 1)


def test_an_estimate_is_of_a_recording_its_file_or_a_simulation(engines, run, tmp_path):
    run.save(tmp_path / "run.csv")
    estimator = Estimator(CRANE, engines[SemiRecursiveEngine], max_step=1e-2)
    means = [
        estimator.run(given).mean for given in (run.recording(), run, tmp_path / "run.csv", str(tmp_path / "run.csv"))
    ]
    assert all(np.array_equal(mean, means[0]) for mean in means) and run.recording().exact
    for wrong in (None, 5, CRANE):
        with pytest.raises(CraneError, match="instead of a recording"):
            estimator.run(wrong)


ASKED = [diagnosis.diagnose, improve, learn]


@pytest.mark.parametrize("ask", ASKED)
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"jobs": 0}, "jobs is 0. Give a whole number"),
        ({"jobs": "a"}, "jobs is 'a'"),
        ({"per_recording": 5}, "per_recording: found 5"),
    ],
)
def test_processes_and_what_differs_are_numbers_and_names(ask, options, message):
    with pytest.raises(CraneError, match=message):
        ask(CRANE, MOVING, **options)


@pytest.mark.parametrize("most", [0, -1, 1.5, "a"])
def test_a_search_is_for_one_effect_at_least(most):
    with pytest.raises(CraneError, match=r"most is .*Give a whole number of at least 1"):
        improve(CRANE, MOVING, most=most)


@pytest.mark.parametrize("ask", ASKED)
def test_recordings_may_be_files(ask, tmp_path):
    """All three read them and go on to look at them: this one has no sensor."""
    STILL.save(tmp_path / "still.csv")
    for recording in (tmp_path / "still.csv", str(tmp_path / "still.csv"), [tmp_path / "still.csv"]):
        with pytest.raises(CraneError, match=r"still\.csv: found 0 sensor channels"):
            ask("patu655", recording, check=tmp_path / "still.csv")


@pytest.mark.parametrize("ask", ASKED)
@pytest.mark.parametrize(
    ("given", "message"),
    [
        (("patu655", "nowhere.csv"), "no such file"),
        (("patu656", STILL), "no crane 'patu656'"),
        ((5, STILL), "found 5 instead of a crane"),
        ((CRANE, 5), "found 5 instead of a recording"),
        ((CRANE, [STILL, None]), "found None instead of a recording"),
        ((CRANE, []), "at least one"),
        ((CRANE, STILL, 5), "found 5 instead of a recording"),
    ],
)
def test_what_is_no_recording_is_told(ask, given, message):
    with pytest.raises(CraneError, match=message):
        ask(*given)


def test_recordings_are_loaded_with_the_cranes_names(run, tmp_path):
    run.save(tmp_path / "run.csv")
    crane, recordings, check = diagnosis.loaded("patu655", (tmp_path / "run.csv", STILL), None)
    assert crane == CRANE and recordings[1] is STILL and check is None
    assert np.array_equal(recordings[0]["z1"].values, run["z1"])


def test_scenes_tell_their_colours_in_pythons_terms_too(run):
    trajectory = Trajectory.from_states("simulated", run.time, run.states, CRANE.layout)
    with pytest.raises(CraneError, match=r"unknown colour 'presure'\. Did you mean \"pressure\""):
        Scene(CRANE, [trajectory], colour="presure")
    with pytest.raises(CraneError, match=r"Give a second trajectory, in the command --ghost FILE"):
        Scene(CRANE, [trajectory], colour="residual")
    with pytest.raises(CraneError, match=r"Two runs are called 'simulated'.*--ghost NAME=FILE"):
        Scene(CRANE, [trajectory, trajectory])
    with pytest.raises(CraneError, match=r"Leave colour \(--colour\) out"):
        Scene(CRANE, [replace(trajectory, pressures={})], colour="pressure")


# -- a cross-check that moves nothing ----------------------------------------------------------------------------------


def test_what_stands_still_has_no_order(engines):
    """The paper's cycle begins after two seconds."""
    time = np.arange(0.0, 0.2001, 1e-3)
    w = cc.cases.spool_inputs(CRANE, time, np.zeros((time.size, 2)))
    quantities, runs = cc.compare_runs("still", *engines.values(), time, w, 1e-3, lambda fraction, part: None)
    assert not [q.name for q in quantities if "order" in q.name] and len(runs) == 4
    assert {q.name for q in quantities} == {f"still: {n}" for n in ("z1", "z4", "p1", "p2", "p3", "p4")}
    assert all(q.ok for q in quantities)
    w[50:, 0] = 0.5
    moving, _ = cc.compare_runs("lift", *engines.values(), time, w, 1e-3, lambda fraction, part: None)
    assert [q.name for q in moving[:2]] == ["lift: order of positions", "lift: order of pressures"]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"states": 0}, "states = 0 compares nothing"),
        ({"states": 2.5}, "states = 2.5"),
        ({"states": math.nan}, "states = nan"),
        ({"seconds": 0.0}, "runs of 0 s"),
        ({"step": 0.0}, "steps of 0 s"),
    ],
)
def test_a_cross_check_of_nothing_is_refused(options, message):
    with pytest.raises(CraneError, match=message):
        cc.crosscheck(CRANE, **options)


# -- at the prompt -----------------------------------------------------------------------------------------------------


def test_objects_of_ones_own_are_shown_and_not_lost(tmp_path):
    own = CRANE.with_objects(push)
    assert "1 user-defined object;" in repr(own) and "2 user-defined objects" in repr(own.with_objects(push))
    assert "user-defined" not in repr(CRANE)
    with pytest.raises(CraneError, match=r"has 1 user-defined object,.*crane\.without_objects\(\)"):
        own.save(tmp_path / "crane.toml")
    assert not list(tmp_path.iterdir())
    own.without_objects().save(tmp_path / "crane.toml")
    assert Crane.load(tmp_path / "crane.toml") == CRANE == own.without_objects()


def clumsy(mbs, plant, number):
    """An object of one's own whose function has a mistake."""
    plant.marker("bucket", {}["length"])


def test_what_fails_in_a_function_of_ones_own_is_told_as_its():
    with pytest.raises(CraneError, match=r"patu655: the function clumsy of with_objects.*KeyError: 'length'") as told:
        ExudynEngine(CRANE.with_objects(clumsy))
    assert isinstance(told.value.__cause__, KeyError)
    assert CRANE.with_objects(clumsy) == CRANE.with_objects(clumsy) != CRANE.with_objects(push)


def test_commands_of_a_run_may_be_a_file(engines, run, tmp_path):
    STILL.save(tmp_path / "still.csv")
    for commands in (tmp_path / "still.csv", str(tmp_path / "still.csv")):
        again = simulate(CRANE, commands, engine=engines[SemiRecursiveEngine])
        assert np.array_equal(again.states, run.states)
    for wrong in (5, np.zeros((3, 2)), CRANE):
        with pytest.raises(
            CraneError, match=r"simulate: found .* instead of a recording\. Give a Recording, or the name"
        ):
            simulate(CRANE, wrong)


def test_a_recording_of_another_machine_says_whose_names_it_was_read_with(tmp_path):
    loader = Crane.load("loader")
    time = np.arange(3.0)
    Recording.from_arrays("r", time, {"boom": 0.1 * time}, layout=loader.layout).save(tmp_path / "r.csv")
    with pytest.raises(CraneError, match=r"no known channel among the columns .*boom.*in Python: layout=crane\.layout"):
        Recording.load(tmp_path / "r.csv")
    assert Recording.load(tmp_path / "r.csv", layout=loader.layout).sensors == ("boom",)


def test_a_void_is_told_as_a_gauge_shows_it(engines, start):
    """A state of -60 bar is a void: no pressure is that low."""
    length = engines[ExudynEngine].terms(start, CLOSED)["s1"]
    short = CRANE.with_parameters(
        {"cylinders.lift.chamber_range": length - CRANE["cylinders.lift.empty_length"] + 1e-4}
    )
    state = start.copy()
    state[2], state[5] = 0.5, -60e5
    with pytest.raises(CraneError, match=r"the lift cylinder is fully extended.* p2 = 0\.00 bar, p3 = "):
        ExudynEngine(short).propagate(state[None], step(0.0), 1e-2)


def test_names_can_be_looked_for():
    assert "payload.mass" in CRANE and "payload.mas" not in CRANE and 0 not in CRANE
    assert list(CRANE) == list(CRANE.machine.names) and {n: CRANE[n] for n in CRANE} == dict(CRANE.values)
    assert "u1" in STILL and "z1" not in STILL and list(STILL) == ["u1", "u2"]


def test_what_is_shown_is_short_and_says_what_it_is(engines, run):
    estimator = Estimator(CRANE, engines[SemiRecursiveEngine], {"z1": 1e-3}, augment="payload.mass")
    spools, live = SpoolPath(CRANE), SpoolPath(CRANE)
    live.step(0.5, np.zeros(2))
    trajectory = Trajectory.from_states("simulated", run.time, run.states, CRANE.layout)
    lagging = CRANE.with_effect("sensor_lag@z1", {"tau": 0.1})
    for thing, words in (
        (estimator, ("<Estimator of patu655 by ukf on SemiRecursiveEngine", "payload.mass", "z1 ± 0.001")),
        (engines[SemiRecursiveEngine], ("<SemiRecursiveEngine of <Crane patu655", "states z1 z4")),
        (SideBySide({"sound": estimator, "leaky": estimator.varied()}), ("<SideBySide of sound, leaky", "sensors z1")),
        (Scene(CRANE, [trajectory], colour="pressure"), ("<Scene of patu655: simulated; 0 … 0.19 s", "by pressure")),
        (spools, ("<SpoolPath of patu655: lift lag", "not live")),
        (live, ("t = 0.5 s",)),
        (Measurement.of(CRANE, ("z1", "p1")), ("<Measurement of z1, p1>",)),
        (Measurement.of(lagging, ("z1",)), ("z1 lags by 0.1 s",)),
    ):
        assert all(word in repr(thing) for word in words), repr(thing)
        assert len(repr(thing)) < 250 and "\n" not in repr(thing)


# -- the example that looks into a prediction --------------------------------------------------------------------------


def test_the_example_begins_where_the_recording_does(tmp_path):
    """A sound machine far from the crane file's pose: nothing leaves the measurement."""
    engine, random = SemiRecursiveEngine(CRANE), np.random.default_rng(1)
    time = np.arange(0.0, 1.2, 0.01)
    given = Recording.from_arrays("c", time, {"u1": 0.3 * ((time > 0.4) & (time < 0.9)), "u2": 0.0 * time})
    run = simulate(CRANE, given, start=engine.static_start(0.6, -1.2), engine=engine)
    noise = {"z1": 2e-3, "z4": 2e-3, "p1": 5e4, "p2": 5e4, "p3": 5e4, "p4": 5e4}
    seen = {n: run[n] + random.normal(0.0, std, time.size) for n, std in noise.items()}
    Recording.from_arrays("r", time, {n: run[n] for n in ("u1", "u2")} | seen).save(tmp_path / "r.csv")
    example, folder = Path(__file__).parent.parent / "examples" / "debug_prediction.py", tmp_path / "new" / "folder"
    words = [sys.executable, str(example), str(tmp_path / "r.csv"), str(folder)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == 6 and all(line.endswith("stays within 10 times") for line in lines)
    assert {p.name for p in folder.iterdir()} == {"channels.png", "scene.png", "film.gif"}


# -- degrees and millimetres where SI is wanted ------------------------------------------------------------------------


def test_degrees_given_for_radians_are_refused_with_the_mend(start):
    degrees = start.copy()
    degrees[:2] = 20.0, -50.0
    for asked in (
        lambda: static_start(CRANE, 20.0, -50.0),
        lambda: simulate(CRANE, STILL, start=degrees, engine="semi-recursive"),
    ):
        with pytest.raises(CraneError, match=r"z1 = 20 is in radians.*write np\.deg2rad\(20\)"):
            asked()
    shown = {"u1": 0.0 * TIME, "u2": 0.0 * TIME, "z1": 10.0 + TIME}
    with pytest.raises(CraneError, match=r"still: z1 = .* is in radians.*write np\.deg2rad\(z1\)"):
        Recording.from_arrays("still", TIME, shown)
    with pytest.raises(CraneError, match=r"s1 = 900 is in metres.*write 1e-3 \* s1"):
        Recording.from_arrays("still", TIME, {"u1": 0.0 * TIME, "u2": 0.0 * TIME, "s1": 900.0 + 0.0 * TIME})


def test_a_spike_is_no_other_unit():
    z1 = np.where(np.arange(TIME.size) == 5, 99.0, 0.2)
    assert "z1" in Recording.from_arrays("spike", TIME, {"u1": 0.0 * TIME, "u2": 0.0 * TIME, "z1": z1})


def test_a_start_at_which_a_cylinder_would_be_far_beyond_its_stroke_is_refused():
    telescope = Crane.load("patu655-telescope")
    with pytest.raises(CraneError, match=r"the extension cylinder would be 31\.3 m long, and it can be 1\.25 to 2\.15"):
        static_start(telescope, 0.2, -0.5, 30.0)
    assert np.isfinite(static_start(telescope, 0.2, -0.5, 0.95)).all()  # a little beyond, as a measured one may be


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        (lambda: simulate(CRANE, STILL, step="a"), "simulate: step = 'a' is not a number"),
        (lambda: simulate(CRANE, STILL, start="a"), "simulate: start is 'a'"),
        (lambda: simulate(CRANE, STILL, start=[1.0]), "a state has 8 numbers"),
        (lambda: CRANE.with_effect("x@lift"), "no effect 'x'"),
        (lambda: CRANE.with_effect("dead_band@lift"), r"Give a dict such as \{'lower': 0.0.*, 'upper': 0.0.*\}"),
        (lambda: CRANE.with_effect("learned_force@lift"), r"Give a dict such as \{'over': "),
        (lambda: CRANE.with_parameters(), r"such as \{'payload.mass': 150.0\}"),
        (lambda: STILL.window("a", 1.0), "window: start = 'a' is not a number"),
        (lambda: STILL.first_values("a"), "span = 'a' is not a number"),
        (lambda: CRANE.voltage["lift"], r"add \[valves.lift.voltage\]"),
        (lambda: pickle.loads(pickle.dumps(CRANE)).voltage["lift"], r"add \[valves.lift.voltage\]"),
    ],
)
def test_what_is_left_out_or_of_another_kind_is_told_in_one_message(asked, message):
    with pytest.raises(CraneError, match=message):
        asked()
