"""The diagnosis on recordings of an independent simulation, whose answers are open; and its refusals."""

import json
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, Recording, simulate
from crane_exudyn.channels import Channel
from validation import compare, hidden
from validation.criteria import CRITERIA
from validation.diagnosis import Diagnosis, diagnose, held_to_runs, looked_at, sentence
from validation.fit.data import FitData
from validation.fit.staged import STIFF, WHOLE
from validation.fitness import check_check
from validation.hidden_machines import recorded
from validation.reports import Examined, after_diagnosis
from validation.selection.moves import Start, around, starts
from validation.selection.screen import Score, likely, tops
from validation.selection.search import Round, silent
from validation.selection.verdict import verdict_of, within_clocks
from validation.selection.white import WHITE, WhitePath
from validation.semi_recursive import SemiRecursiveEngine

DATA = Path(__file__).parent / "data"
ANSWERS = json.loads((DATA / "open_answers.json").read_text(encoding="utf-8"))


#: the case that is also held against the other recording, of which nothing is learned
WITH_CHECK = "open_leak_lift"
#: what is learned from: the suite has no time for whole recordings, and the less is seen, the harder it is to tell one
#: effect from the others. Some machines show later what they lack
SECONDS, LATER = 4.5, dict.fromkeys(("open_leak_lift", "open_bias_p4"), 6.0)


#: standard deviations of sensors that are made up, SI
NOISE = {"z1": 8e-4, "z4": 8e-4, **dict.fromkeys(("p1", "p2", "p3", "p4"), 3e4)}


def noisy(shown, seed):
    """Return what sensors show, with noise."""
    rng = np.random.default_rng(seed)
    return {n: values + NOISE[n] * rng.standard_normal(len(values)) for n, values in shown.items()}


def pulses(time, *spans):
    """Return commands that are zero but for ramped spans (from, to, value)."""
    return sum(np.interp(time, [a, a + 0.1, b - 0.1, b], [0.0, value, value, 0.0]) for a, b, value in spans)


@pytest.mark.parametrize("name", sorted(ANSWERS))
def test_an_open_case_is_diagnosed(name):
    learn = Recording.load(DATA / f"{name}_learn.csv.gz")
    check = Recording.load(DATA / f"{name}_check.csv.gz") if name == WITH_CHECK else None
    found = diagnose(Crane.load("patu655"), learn.window(0.0, LATER.get(name, SECONDS)), check, jobs=1)
    answer = ANSWERS[name]
    assert found.verdict == answer["verdict"]
    assert list(found.effects) == answer.get("effects", [])
    for parameter, value in answer.get("parameters", {}).items():
        assert found.crane[parameter] == pytest.approx(value, rel=0.1)
    if check is not None:
        assert found.check_error_after < 1.2  # 1 is the noise alone
    document = json.loads(json.dumps(found.to_dict(), default=float))
    assert set(document) >= {"verdict", "parameters", "candidates", "effects", "tied_with", "next_manoeuvre", "seconds"}


def test_a_stretch_that_nothing_explains_spoils_one_run_but_not_what_lies_beside_it():
    # after 2.6 s the leaky crane is pushed: its boom stands 0.6 deg lower from one sample to the next
    crane, time, hit = Crane.load("patu655"), np.arange(0.0, 5.005, 0.01), 2.6
    leaky = crane.with_effect("internal_leakage@lift", {"k": 1e-11})
    u1 = pulses(time, (0.4, 1.2, 0.4), (2.4, 3.2, -0.3), (4.0, 5.0, 0.3))
    u2 = pulses(time, (1.4, 2.1, -0.3), (3.4, 3.9, 0.3))

    def run(inside, start):
        given = Recording.from_arrays("commands", time[inside], {"u1": u1[inside], "u2": u2[inside]})
        return simulate(leaky, given, start=start)

    before = run(time < hit + 0.005, SemiRecursiveEngine(crane).static_start(0.2, -0.8))
    after = run(time > hit - 0.005, before.states[-1] - np.eye(8)[0] * 0.01)
    shown = {n: np.concatenate([before[n][:-1], after[n]]) for n in NOISE}
    learn = Recording.from_arrays("pushed", time, {"u1": u1, "u2": u2, **noisy(shown, 8)})
    found = diagnose(crane, learn, jobs=1)
    assert found.verdict == "effect" and found.effects == ("internal_leakage@lift",)
    assert found.error_after > 2.0 and found.between < 1.1
    assert "except 2.5-2.8 s" in found.notes[0]


def test_commands_that_a_controller_held_between_samples_are_found_out():
    crane, time = Crane.load("patu655"), np.arange(0.0, 5.0, 0.04)
    u1 = np.interp(time, [0.5, 1.1, 2.5, 3.0], [0.0, 0.4, 0.4, 0.0])
    u2 = np.interp(time, [2.6, 3.2, 4.0, 4.5], [0.0, -0.3, -0.3, 0.0])
    driven = Recording.from_arrays("held", time, {"u1": u1, "u2": u2})
    run = simulate(crane, replace(driven, held=True), start=SemiRecursiveEngine(crane).static_start(0.2, -0.8))
    shown = noisy({n: np.interp(time, run.time, run[n]) for n in NOISE}, 5)
    found = diagnose(crane, Recording.from_arrays("held", time, {"u1": u1, "u2": u2, **shown}), jobs=1)
    assert found.verdict == "adequate" and any("held = true" in note for note in found.notes)


def test_noise_that_neighbouring_samples_share_hides_no_effect():
    """Differences of neighbours show only 0.66 of it, means of five samples 1.5 times what white noise leaves."""
    crane, time, rng = Crane.load("patu655"), np.arange(0.0, 7.5, 0.001), np.random.default_rng(11)
    leaky = crane.with_effect("internal_leakage@lift", {"k": 2e-12})
    u1 = np.interp(time, [0.5, 0.7, 1.5, 1.7, 2.6, 2.8, 3.6, 3.8], [0.0, 0.3, 0.3, 0.0, 0.0, -0.2, -0.2, 0.0])
    u2 = np.interp(time, [4.2, 4.4, 5.2, 5.4, 5.8, 6.0, 6.8, 7.0], [0.0, 0.3, 0.3, 0.0, 0.0, -0.3, -0.3, 0.0])
    driven = Recording.from_arrays("smoothed", time, {"u1": u1, "u2": u2})
    run = simulate(leaky, driven, start=SemiRecursiveEngine(crane).static_start(0.2, -0.8))
    shown = {
        n: np.interp(time, run.time, run[n]) + std * hidden.unit_noise(rng, len(time), shared=0.45)
        for n, std in NOISE.items()
    }
    found = diagnose(crane, Recording.from_arrays("smoothed", time, {"u1": u1, "u2": u2, **shown}), jobs=1)
    assert found.verdict == "effect" and found.effects == ("internal_leakage@lift",)
    assert found.error_after == pytest.approx(1.0, abs=0.05)
    assert any("noisier than neighbouring samples differ" in note for note in found.notes)


def test_a_recording_without_motion_is_refused():
    time = np.arange(0.0, 5.0, 0.01)
    rng = np.random.default_rng(1)
    values = {"z1": 0.2 + 1e-3 * rng.standard_normal(500), "p1": 5e6 + 3e4 * rng.standard_normal(500)}
    still = Recording.from_arrays("still", time, {"u1": 0.0 * time, "u2": 0.0 * time, **values})
    with pytest.raises(CraneError, match="still"):
        diagnose(Crane.load("patu655"), still)


#: a machine of the next size: by how much each kind of number in the crane file grows
LARGER = {
    ("joints", "com", "base", "rod_end", "empty_length", "chamber_range"): 1.25, ("bore", "rod"): 1.2, ("mass",): 2.0,
    ("inertia",): 3.0,
}  # fmt: skip


def larger(crane: Crane) -> Crane:
    """Return another machine altogether: a quarter longer, twice as heavy."""
    values = {}
    for name, value in crane.values.items():
        for kinds, factor in LARGER.items():
            if not name.startswith("payload") and set(kinds) & set(name.split(".")):
                values[name] = factor * value
    return crane.with_parameters(values)


def test_a_recording_of_another_machine_is_unknown_and_no_name_is_forced_on_it():
    crane = Crane.load("patu655")
    case = hidden.make_case(3, kind="none", crane=larger(crane), noise=0, sensors=0, rate=100)
    # only load and oil are uncertain, so that the fits are short
    known = {n: u for n, u in crane.uncertainty.items() if n.startswith(("payload", "fluid"))}
    crane = replace(crane, uncertainty=known)
    found = diagnose(crane, case.learn.window(0.0, 3.0), jobs=1)
    assert found.verdict == "unknown" and not found.effects and found.crane == crane
    assert found.where
    # what is left is told beside the parameters that bring the model nearest, the load among them
    (nearest,), (alone,) = found.nearest, [c for c in found.candidates if not c.effects]
    assert alone.error_after < 0.7 * found.error_before == 0.7 * found.error_after
    assert found.parameters and all(nearest[n] == p["value"] != crane[n] for n, p in found.parameters.items())
    assert f"{alone.error_after:.3g} with the parameters fitted" in sentence(found)
    assert compare(nearest, case.learn.window(0.0, 3.0)).where[0].text == found.where[0]["text"]


def test_moments_around_the_best_one_are_looked_at_more_closely():
    start = Start("payload_change", {"dm": 50.0, "T": 0.1}, two_sided=True)
    moments = [s.values["T"] for s in around(start)]
    assert min(moments) >= 0.0 and max(moments) == pytest.approx(0.345)
    assert np.diff(sorted([*moments, 0.1])) == pytest.approx(0.035)  # closer than a ring's period, without gaps
    assert all(s.values["dm"] == 50.0 and s.two_sided for s in around(start))
    assert around(Start("internal_leakage@lift", {"k": 1e-12})) == []


def test_a_moment_is_begun_at_a_second_one_well_away_from_the_best_and_not_beside_it():
    """Seed 197226: 4.465 s beside 4.5 s came to the same fit, and that at 6.5 s was never made. Seed 197450: of a
    machine at rest the moments beside the best promise nearly as much.
    """

    def begun(*promised: tuple[float, float]) -> list[float]:
        found = [Score(Start("tip_contact_force", {"F": 500.0, "T": t}, two_sided=True), g, -1.7) for t, g in promised]
        return [s.start.values["T"] for s in likely(tops(found), CRITERIA.singles, CRITERIA.promise)]

    assert begun((4.5, 2345.0), (4.465, 2344.0), (6.5, 2289.0), (6.0, 2286.0), (9.0, 900.0)) == [4.5, 6.5]
    rest = (9.5, 1544.0), (10.0, 1543.0), (10.5, 1537.0), (7.0, 1519.0), (7.5, 1518.0), (9.0, 1498.0)
    assert begun(*rest) == [9.5, 7.0]
    leaks = [Score(Start("internal_leakage@lift", {"k": k}), 100.0, 1.0) for k in (1e-12, 2e-12, 4e-12)]
    assert likely(leaks, CRITERIA.singles, CRITERIA.promise) == leaks[:2]


# -- what a path means -----------------------------------------------------------------------------------------------


def model(keys: str = "", evidence: float = 0.0, good: bool = True, **more: object) -> SimpleNamespace:
    """Return what the verdict asks of a fitted model; `keys` are its effects, separated by blanks."""
    asked = {
        "plausible": True,
        "beyond_uncertainty": False,
        "level": 1.0,
        "bad": np.zeros(100, dtype=bool),
        "inactive": set(),
        "far": {},
        "near": good,
        "fit": SimpleNamespace(variables=(), u=()),
    }
    effects = tuple(keys.split())
    return SimpleNamespace(keys=effects, names=effects, evidence=evidence, good=good, **asked | more)


def path(
    given: SimpleNamespace, parameters: SimpleNamespace, *weighed: SimpleNamespace, **more: object
) -> SimpleNamespace:
    """Return a path that weighed these models, best first."""
    asked = {
        "fewest": parameters,
        "left_out": {},
        "problem": None,
        "bare": max(given.evidence, parameters.evidence),
        "adequate": given.good and parameters.evidence < given.evidence + CRITERIA.proof,
    }
    return SimpleNamespace(
        given=given,
        parameters=parameters,
        weighed=weighed,
        done=weighed,
        best=weighed[0] if weighed else None,
        **asked | more,
    )


ALL = np.ones(100, dtype=bool)
WRONG = {"good": False, "level": 9.0, "bad": ALL}
LEAK, BIAS = "internal_leakage@lift", "sensor_bias@z1"


@pytest.mark.parametrize(
    ("given", "parameters", "weighed", "kind", "effects"),
    [
        (model(), model(evidence=5.0), [model(LEAK, 11.0)], "adequate", ()),
        (model(), model(evidence=20.0), [model(LEAK, 30.0)], "parameters", ()),
        (model(**WRONG), model(evidence=500.0), [], "parameters", ()),
        (model(**WRONG), model(evidence=100.0, **WRONG), [model(LEAK, 500.0), model(BIAS, 480.0)], "effect", (LEAK,)),
        (model(**WRONG), model(evidence=100.0, **WRONG), [model(LEAK, 500.0), model(BIAS, 495.0)], "tied", (LEAK,)),
        (
            model(**WRONG),
            model(evidence=100.0, **WRONG),
            [model(LEAK, 500.0), model(f"{BIAS} {LEAK}", 495.0)],
            "effect",
            (LEAK,),
        ),
        (model(**WRONG), model(evidence=100.0, **WRONG), [model(LEAK, 108.0)], "unknown", ()),
        (model(**WRONG), model(evidence=100.0, **WRONG), [model(LEAK, 500.0, plausible=False)], "unknown", ()),
        (
            model(**WRONG),
            model(evidence=100.0, **WRONG),
            [model(LEAK, 500.0, False, level=1.5, bad=ALL)],
            "unknown",
            (),
        ),
        (
            model(**WRONG),
            model(evidence=100.0, **WRONG),
            [model(LEAK, 500.0, False, level=1.2, bad=np.arange(100) < 10)],
            "effect",
            (LEAK,),
        ),
    ],
)
def test_the_verdict_is_a_function_of_the_path(given, parameters, weighed, kind, effects):
    found = verdict_of(path(given, parameters, *weighed))
    assert (found.kind, found.chosen.keys) == (kind, effects)


def test_what_predicts_the_blocks_that_were_left_out_explains_although_it_leaves_something():
    best = model(LEAK, 500.0, False, level=1.5, bad=ALL)
    for errors, kind in (((6.4, 1.1), "effect"), ((6.4, 1.9), "unknown"), ((1.5, 1.2), "unknown")):
        assert verdict_of(path(model(**WRONG), model(**WRONG), best, left_out={frozenset([LEAK]): errors})).kind == kind


def test_parameters_moved_far_are_tied_with_one_effect_that_explains_at_once():
    far = model(evidence=100.0, beyond_uncertainty=True, far=dict.fromkeys("abc", 3.0))
    for bias, kind in (
        (model(BIAS, 108.0), "tied"),
        (model(BIAS, 90.0), "parameters"),
        (model(BIAS, 108.0, far=dict.fromkeys("ab", 3.0)), "parameters"),
    ):
        found = verdict_of(path(model(**WRONG), far, bias))
        assert found.kind == kind
        assert [t.keys for t in found.ties] == ([()] if kind == "tied" else [])
        assert ("would need 3 nominal parameters at more than twice" in " ".join(found.notes)) == (kind == "tied")


def test_it_is_said_why_an_explanation_is_not_believed_that_leaves_hardly_more_than_noise():
    moved = {"payload.mass": 7.62, "fluid.density": 3.0, "supply.pump_pressure": 2.7, "supply.tank_pressure": 2.1}
    nothing = model(evidence=-900.0, **WRONG, near=False)
    leak = model(LEAK, -100.0, False, near=True, plausible=False, far=moved)
    found = verdict_of(path(nothing, nothing, leak))
    assert found.kind == "unknown"
    assert f"{LEAK} would leave hardly more than noise, but only" in found.notes[0]
    assert "payload.mass by 7.6 standard uncertainties" in found.notes[0] and "tank" not in found.notes[0]


def test_several_weak_effects_are_justified_together_where_none_of_them_is_alone():
    """A recording with 12 000 samples; each of three further effects takes away a third of what the first one
    leaves.
    """
    effects, rounds = (LEAK, BIAS, "entrained_air", "pump_droop"), list[Round]()
    nothing = model(evidence=-9000.0, **WRONG, near=False)
    for n in range(1, 5):
        level = 1.03 - 0.01 * (n - 1)
        w = model(" ".join(effects[:n]), -6000.0 * level**2, level=level, near=True)
        rounds.append(Round((w,), (w,), {frozenset(effects[:n]): level}))
        grown = WhitePath(SimpleNamespace(), nothing, tuple(rounds), given=nothing, fewest=nothing)
        assert grown.ahead is w
        assert [len(v.keys) for v in grown.weighed] == {1: [1], 2: [1], 3: [3, 1], 4: [4, 3, 1]}[n]


def test_the_search_goes_on_from_two_effects_that_leave_little_though_the_second_is_not_justified_yet():
    """Seed 187109: of a leak, a dead band and a spool's play none takes away half of what the others leave."""
    nothing = model(evidence=-4929.0, good=False, level=1.16, near=False)
    one = model(LEAK, -4504.0, False, level=1.11, near=False)
    for level, keys in ((1.084, 2), (1.31, 1)):
        two = model(f"{LEAK} {BIAS}", -4293.0, False, level=level, near=False)
        rounds = Round((one,), (one,)), Round((two,), (two,))
        grown = WhitePath(SimpleNamespace(), nothing, rounds, given=nothing, fewest=nothing)
        assert [len(w.keys) for w in grown.weighed] == [1]
        assert len(grown.ahead.keys) == keys


def test_a_round_that_brings_nothing_ends_the_search():
    """The first of them only where something explains the recordings already: seed 197253 lacks two effects, of which
    neither does better than all parameters moved.
    """
    wrong = model(evidence=-9000.0, **WRONG, near=False)
    enough = model(evidence=-9000.0, near=True)
    for nothing, rounds, brought, goes_on in (
        (enough, 1, 11.0, False),
        (enough, 1, 13.0, True),
        (wrong, 1, -2000.0, True),
        (wrong, 2, 11.0, False),
        (wrong, 2, 13.0, True),
    ):
        path = WhitePath(SimpleNamespace(), nothing, given=nothing, fewest=nothing)
        for n, gain in enumerate([0.0, brought][-rounds:]):
            keys = " ".join((LEAK, BIAS)[: n + 1])
            w = model(keys, nothing.evidence + gain, False, level=8.9 - 8.0 * n, near=False)
            path = replace(path, rounds=(*path.rounds, Round((w,), (w,))))
        assert WHITE.gained(path) is goes_on


def test_what_leaves_little_is_fitted_anew_as_one_run_before_a_further_effect_is_believed():
    """Seed 197198: a fit had ended in a valley, and what a second effect brought was the way out of it."""
    known = {"near": True, "move_cost": 0.0, "fit": SimpleNamespace(converged=True)}
    nothing, again = model(evidence=-7798.0, level=1.013, **known), model(evidence=-7545.0, **known)
    asked = list[object]()

    def fits(tasks):
        asked.extend(tasks)
        return [again] if tasks else []

    for brought, anew in ((11.0, False), (232.0, True)):
        w = model(LEAK, nothing.evidence + brought, **known)
        for one in (nothing, w):
            one.model = SimpleNamespace(variables=())
        problem = SimpleNamespace(errors=lambda fits: [], recordings=(), shared=None, fits=fits)
        problem.tasks = lambda moves, stages: [(m.model, m.before, stages) for m in moves]
        grown = WhitePath(problem, nothing, given=nothing, fewest=nothing)
        grown.__dict__["whole"] = 1.1
        asked.clear()
        found = WHITE.judged(grown, [nothing], [w])
        assert found.bare is (again if anew else None) and found.done[0] is w
        assert asked == ([(nothing.model, nothing.fit, (WHOLE, STIFF))] if anew else [])


def test_what_a_shift_of_the_clock_does_is_no_effect():
    """Where in a sampling interval a command came is not recorded."""
    crane = Crane.load("patu655")
    data = FitData.of(Recording.load(DATA / "open_leak_lift_learn.csv.gz").window(0.0, 8.0), crane)
    problem = SimpleNamespace(data=SimpleNamespace(parts=(data,)))
    for key, values, within in (
        ("command_delay@lift", {"T": 0.004}, True), ("command_delay@lift", {"T": 0.03}, False),
        ("dead_band@lift", {"lower": 0.02, "upper": 0.02}, False), ("internal_leakage@lift", {"k": 1e-13}, False),
    ):  # fmt: skip
        fit = SimpleNamespace(crane=crane.with_effect(key, values), late=0.0)
        fit.of = lambda recording, fit=fit: fit
        assert within_clocks(problem, SimpleNamespace(keys=(key,), fit=fit)) is within, key


def test_what_acts_on_a_pressure_that_was_recorded_is_not_offered():
    crane = Crane.load("patu655")
    case = Recording.load(DATA / "open_leak_lift_learn.csv.gz").window(0.0, 3.0)
    pump = Channel(case["p1"].time, 2e7 + 1e4 * np.random.default_rng(1).standard_normal(len(case["p1"])))
    for recording, offered in ((case, True), (Recording("pump", {**case.channels, "pp": pump}), False)):
        keys = {s.key for s in starts(crane, FitData.of(recording, crane))}
        assert ("pump_droop" in keys) is offered and "return_back_pressure" in keys


def test_places_of_a_stroke_that_pins_moved_far_leave_out_of_range_are_not_tried():
    """The first fit of a measured lift put the cylinder's pins so that no length of its chamber was left."""
    recording = Recording.load(DATA / "open_leak_lift_learn.csv.gz").window(0.0, 3.0)
    for crane, offered in ((Crane.load("patu655"), True), (far_pins(), False)):
        found = [s for s in starts(crane, FitData.of(recording, crane)) if s.key == "stuck_seal@lift"]
        assert bool(found) is offered
        for start in found:
            crane.with_effect(start.key, start.values)


def far_pins() -> Crane:
    """Return the crane with a lift cylinder that is a metre too long for where its pins are."""
    crane = Crane.load("patu655")
    longer = crane["cylinders.lift.empty_length"] + 1.0
    return crane.with_parameters({"cylinders.lift.empty_length": longer})


# -- the check recording ---------------------------------------------------------------------------------------------


def concluded(verdict: str, before: float, after: float) -> Diagnosis:
    """Return a diagnosis with these errors on the check recording."""
    crane = Crane.load("patu655")
    effects = ("internal_leakage@lift",) if verdict == "effect" else ()
    return Diagnosis(
        "r", verdict, crane.with_effect("internal_leakage@lift", {"k": 5e-12}), crane, {}, (), effects,
        notes=("a note",),
        error_before=6.0, error_after=1.0, check_error_before=before, check_error_after=after,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("verdict", "before", "after", "plain"),
    [
        ("effect", 6.6e6, 6.6e6, False),
        ("effect", 30.0, 28.0, False),
        ("parameters", 4.0, 3.9, False),
        ("adequate", 9.0, 9.0, False),
        ("effect", 30.0, 2.5, True),
        ("effect", 1.5, 1.4, True),
        ("adequate", 1.0, 1.0, True),
        ("effect", np.nan, np.nan, True),
    ],
)
def test_what_does_not_predict_the_check_recording_is_said_first_and_is_no_plain_verdict(verdict, before, after, plain):
    given = concluded(verdict, before, after)
    found = held_to_runs(given)
    if plain:
        assert found is given
        return
    assert found.verdict == "unknown" and not found.effects and found.crane is given.given
    assert "does not predict the check recording" in found.notes[0] and found.notes[1:] == ("a note",)
    assert "does not predict the check recording" in sentence(found)


@pytest.mark.parametrize("verdict", ["effect", "parameters", "adequate"])
def test_what_leaves_much_in_one_run_is_no_explanation_though_short_windows_forgive_it(verdict):
    given = replace(concluded(verdict, 60.0, 6.0), error_before=50.0, error_after=2.7)
    entry = {"recording": "a", "error_before": 50.0, "error_after": 2.7, "parameters": {"payload.mass": {}}}
    found = held_to_runs(replace(given, recordings=(entry,)))
    assert found.recordings == ({"recording": "a", "error_before": 50.0, "error_after": 50.0},)
    assert found.verdict == "unknown" and not found.effects and not found.parameters and not found.misses_check
    assert found.error_after == 50.0 and "leaves 2.7 times the noise in one run" in found.notes[0]
    assert held_to_runs(replace(given, error_after=1.3)).verdict == verdict
    between = replace(given, between=1.1)  # it goes astray in a stretch that is told
    assert held_to_runs(between) is between and "1.1 outside" in sentence(replace(between, verdict="effect"))


UP, DOWN = (0.5, 1.4, 0.25), (1.8, 2.6, -0.2)


@pytest.mark.parametrize(
    ("learned", "name", "value"),
    [
        ((UP,), "lower", 0.04),  # the other side of the valve is never opened
        (((0.5, 1.4, 0.04), DOWN), "upper", 0.07),  # the command stays within the dead band, which may be any wider
    ],
)
def test_what_the_recording_leaves_open_is_no_contradiction_to_the_check_recording(learned, name, value):
    crane, time = Crane.load("loader"), np.arange(0.0, 3.0, 1e-3)
    banded, rng = crane.with_effect("dead_band@lift", {"lower": 0.04, "upper": 0.07}), np.random.default_rng(1)
    commands = (pulses(time, *spans)[:, None] for spans in (learned, (UP, DOWN)))
    learn, check = (recorded(n, banded, u, rng) for n, u in zip(("learn", "both"), commands, strict=True))
    found = diagnose(crane, learn, check, jobs=1)
    assert found.verdict == "effect" and found.effects == ("dead_band@lift",)
    assert found.check_error_after > 2.0  # what is predicted is told as it is
    assert found.left_open == found.notes[0] and f"does not determine dead_band@lift:{name};" in found.left_open
    other, left = re.search(rf"{name} = ([\d.]+)\), that leaves ([\d.]+) instead", found.left_open).groups()
    assert float(other) == pytest.approx(value, rel=0.1) and float(left) < 1.1
    _, advice = after_diagnosis(found, Examined([learn], check))
    assert f"improve {learn.name} {check.name}" in advice


def test_what_the_recording_leaves_open_is_named_without_a_check_recording_too():
    crane, time = Crane.load("loader"), np.arange(0.0, 3.0, 1e-3)
    banded = crane.with_effect("dead_band@lift", {"lower": 0.04, "upper": 0.07})
    found = diagnose(crane, recorded("up", banded, pulses(time, UP)[:, None], np.random.default_rng(1)), jobs=1)
    assert not found.left_open and "the recording does not determine dead_band@lift:lower" in found.notes


def test_a_check_recording_is_looked_at_before_the_search_begins(monkeypatch):
    crane = Crane.load("patu655")
    learn = Recording.load(DATA / "open_leak_lift_learn.csv.gz").window(0.0, 3.0)
    monkeypatch.setattr("validation.diagnosis.search", lambda *_: pytest.fail("the search has begun"))
    bar_as_pascal = Channel(learn["p1"].time, learn["p1"].values / 1e5)
    for check, words in (
        (learn.window(0.0, 0.5), "at least 1 s is needed"),
        (Recording("bad", {**learn.channels, "p1": bar_as_pascal}), "p1 never exceeds"),
        (learn.select(["u1", "u2", "p4"]), "none of the sensors of"),
    ):
        with pytest.raises(CraneError, match=words):
            diagnose(crane, learn.select(["u1", "u2", "z1", "z4", "p1"]), check)


def test_a_recording_that_was_looked_at_is_held_against_a_fitted_crane_that_could_not_have_shown_it():
    crane, learn = Crane.load("patu655"), Recording.load(DATA / "open_leak_lift_learn.csv.gz").window(0.0, 2.0)
    run = simulate(crane, learn, engine="semi-recursive")
    given = Recording("lengths", {**learn.channels, "s1": Channel(run.time, run["s1"])})
    problem, _ = looked_at(crane, given, None, (), 1, silent)
    fitted = crane.with_parameters({"cylinders.lift.empty_length": float(run["s1"].min()) + 0.09})
    with pytest.raises(CraneError, match="s1 goes from"):
        compare(fitted, given)
    with pytest.raises(CraneError, match="cannot follow"):
        compare(fitted, problem.recordings[0])


def test_the_same_recording_twice_is_told():
    learn = Recording.load(DATA / "open_leak_lift_learn.csv.gz").window(0.0, 3.0)
    copy = Recording("copy", learn.channels, "copy.csv")
    assert "copy.csv is the recording that is learned from" in check_check(copy, [learn], Crane.load("patu655"))[0]
    assert not any(
        "no independent check" in n for n in check_check(learn.window(0.0, 2.9), [learn], Crane.load("patu655"))
    )
