"""The diagnosis on recordings of an independent simulation, whose answers are open; and its refusals."""

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, Recording
from validation import hidden
from validation.diagnosis import _between_samples, _predicts, diagnose
from validation.fit.variables import uncertain_parameters
from validation.search.candidates import Start, around
from validation.search.weigh import Hypothesis, Weighed

DATA = Path(__file__).parent / "data"
ANSWERS = json.loads((DATA / "open_answers.json").read_text(encoding="utf-8"))


#: the case that is learned from its whole recording and held against the other one; the suite has no time for more, so the others are
#: learned from 10 s (pump_droop from 7 s: after that its oil boils, and the search goes through all pairs)
WITH_CHECK = "open_leak_lift"
SECONDS = {"open_droop": 7.0}


@pytest.mark.parametrize("name", sorted(ANSWERS))
def test_an_open_case_is_diagnosed(name):
    learn, check = (Recording.load(DATA / f"{name}_{part}.csv.gz") for part in ("learn", "check"))
    whole = name == WITH_CHECK
    if not whole:
        learn = learn.window(0.0, SECONDS.get(name, 10.0))
    found = diagnose(Crane.load("patu655"), learn, check if whole else None, jobs=2)
    answer = ANSWERS[name]
    assert found.verdict == answer["verdict"]
    assert list(found.effects) == answer.get("effects", [])
    for parameter, value in answer.get("parameters", {}).items():
        assert found.crane[parameter] == pytest.approx(value, rel=0.1)
    if whole:
        assert found.check_error_after < 1.2  # 1 is the noise alone
    document = json.loads(json.dumps(found.to_dict(), default=float))
    assert set(document) >= {"verdict", "parameters", "candidates", "effects", "tied_with", "next_manoeuvre", "seconds"}


def test_a_recording_without_motion_is_refused():
    time = np.arange(0.0, 5.0, 0.01)
    rng = np.random.default_rng(1)
    values = {"z1": 0.2 + 1e-3 * rng.standard_normal(500), "p1": 5e6 + 3e4 * rng.standard_normal(500)}
    still = Recording.from_arrays("still", time, {"u1": 0.0 * time, "u2": 0.0 * time, **values})
    with pytest.raises(CraneError, match="still"):
        diagnose(Crane.load("patu655"), still)


#: a machine of the next size: by how much each kind of number in the crane file grows
LARGER = {
    ("joints", "com", "base", "rod_end", "empty_length", "chamber_range"): 1.25, ("bore", "rod"): 1.2, ("mass",): 2.0, ("inertia",): 3.0,
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
    found = diagnose(crane, case.learn.window(0.0, 4.0), jobs=2)
    assert found.verdict == "unknown" and not found.effects
    assert found.where


def test_moments_around_the_best_one_are_looked_at_more_closely():
    start = Start("payload_change", {"dm": 50.0, "T": 0.1}, two_sided=True)
    moments = [s.values["T"] for s in around(start)]
    assert min(moments) >= 0.0 and max(moments) == pytest.approx(0.345)
    assert np.diff(sorted([*moments, 0.1])) == pytest.approx(0.035)  # closer than a ring's period, without gaps
    assert all(s.values["dm"] == 50.0 and s.two_sided for s in around(start))
    assert around(Start("internal_leakage@lift", {"k": 1e-12})) == []


def weighed(key: str, values: dict[str, float], evidence: float, prior_cost: float = 0.0) -> Weighed:
    """Return a weighed hypothesis of which only the crane, the evidence and the cost of moved parameters matter."""
    crane = Crane.load("patu655").with_effect(key, values)
    fit = SimpleNamespace(crane=crane, variables=uncertain_parameters(crane)[:5], prior_cost=prior_cost)
    return Weighed(Hypothesis({key: values}), fit, evidence, 1.2, np.zeros(3, dtype=bool))


@pytest.mark.parametrize(
    ("evidence", "prior_cost", "errors", "named"),
    [(500.0, 0.0, (6.4, 1.1), True), (500.0, 0.0, (6.4, 1.9), False), (500.0, 0.0, (1.5, 1.2), False),
     (5.0, 0.0, (6.4, 1.1), False), (500.0, 200.0, (6.4, 1.1), False)],
)  # fmt: skip
def test_an_effect_that_leaves_something_is_named_only_if_it_predicts_the_check_recording(
    monkeypatch, evidence, prior_cost, errors, named
):
    best = weighed("internal_leakage@lift", {"k": 5e-12}, evidence, prior_cost)
    bare = weighed("internal_leakage@lift", {"k": 0.0}, 0.0)
    found = dict(zip((0, 1), errors, strict=True))
    monkeypatch.setattr("validation.diagnosis._error", lambda crane, recording, knots: found[len(crane.effects)])
    search = SimpleNamespace(crane=Crane.load("patu655"), jobs=1)
    assert _predicts(search, best, bare, None) is named


def test_a_delay_within_a_sampling_interval_is_no_effect():
    search = SimpleNamespace(data=SimpleNamespace(command_time=np.arange(0.0, 1.0, 0.01)))
    assert _between_samples(search, weighed("command_delay@lift", {"T": 0.006}, 100.0))
    assert not _between_samples(search, weighed("command_delay@lift", {"T": 0.012}, 100.0))
    assert not _between_samples(search, weighed("internal_leakage@lift", {"k": 5e-12}, 100.0))
