"""Several recordings of one machine fitted together: other sensors, rates, starts and loads in each."""

from dataclasses import replace

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, Recording
from crane_exudyn.inputs import SpoolPath
from validation import plots, reports
from validation.comparison import from_one_start
from validation.diagnosis import Diagnosis, diagnose
from validation.fit.data import FitData, Joint, data_of
from validation.fit.linear import linearised
from validation.fit.staged import all_parameters, first_knots, timings
from validation.fit.variables import uncertain_parameters
from validation.fit.windows import cut
from validation.improvement import Improvement, Step
from validation.reports import Examined, cranes_of_improvement, improved_own, report_diagnosis
from validation.semi_recursive.engine import SemiRecursiveEngine

NOISE = {"z1": 1e-3, "z4": 1e-3, "p1": 3e4, "p2": 2e4, "p3": 2e4, "p4": 2e4}
#: few parameters are uncertain here, so that the fits are short
KNOWN = ("payload.mass", "valves.lift.flow_coefficient", "fluid.oil_bulk_modulus")
LEAK = {"k": 2e-11}


@pytest.fixture(scope="module")
def crane() -> Crane:
    given = Crane.load("patu655")
    return replace(given, uncertainty={n: given.uncertainty[n] for n in KNOWN}, sensors=NOISE)


def recorded(
    crane: Crane, name: str, sensors: tuple[str, ...], interval: float, size: float, seconds: float = 3.0
) -> Recording:
    """Return a lift with some of the sensors at some rate."""
    time = np.arange(0.0, seconds, interval)
    u = np.column_stack([np.interp(time, [0.3, 0.5, 2.0, 2.2], [0.0, size, size, 0.0]), np.zeros_like(time)])
    w = np.column_stack([SpoolPath(crane).run(time, u), np.full((len(time), 2), np.nan)])
    engine = SemiRecursiveEngine(crane)
    X = engine.simulate(engine.static_start(0.1 + size, -0.7), time, w)
    rng = np.random.default_rng(len(sensors))
    shown = {
        s: X[:, k] + NOISE[s] * rng.standard_normal(len(time)) for s, k in zip(NOISE, (0, 1, 4, 5, 6, 7), strict=True)
    }
    return Recording.from_arrays(name, time, {"u1": u[:, 0], "u2": u[:, 1], **{s: shown[s] for s in sensors}})


@pytest.fixture(scope="module")
def recordings(crane: Crane) -> list[Recording]:
    """A machine that leaks, without a load and with one, with six sensors at 100 Hz and with three at 200 Hz."""
    leaking = crane.with_effect("internal_leakage@lift", LEAK)
    loads = [leaking.with_parameters({"payload.mass": m}) for m in (0.0, 180.0)]
    return [
        recorded(loads[0], "bare", tuple(NOISE), 0.01, 0.25),
        recorded(loads[1], "loaded", ("z1", "p1", "p2"), 0.005, -0.15),
    ]


def test_the_normal_equations_of_several_recordings_are_those_of_each(crane, recordings):
    data = data_of(recordings, crane, ["payload.mass"])
    assert isinstance(data, Joint)
    variables = [*uncertain_parameters(crane, data.own, 2), *timings(data)]
    assert [v.name for v in variables][-4:] == ["payload.mass 1", "payload.mass 2", "timing 1", "timing 2"]
    u = np.linspace(-0.2, 0.3, len(variables))
    knots = first_knots(crane, data)
    both, _ = linearised(crane, data, cut(data, 0.25), knots, variables, u, 1.0)
    first, second = ([v.recording in (None, i) for v in variables] for i in (0, 1))
    for i, (own, part) in enumerate(zip((first, second), data.parts, strict=True)):
        mine = [replace(v, recording=None) if v.recording == i else v for v, k in zip(variables, own, strict=True) if k]
        its = first_knots(crane, part)
        rows = slice(0, len(its)) if i == 0 else slice(-len(its), None)
        assert np.allclose(knots[rows], its)
        alone, _ = linearised(crane, part, cut(part, 0.25), its, mine, u[own], 1.0)
        assert np.allclose(both.Hxu[rows][:, :, own], alone.Hxu) and not both.Hxu[rows][:, :, ~np.array(own)].any()
        columns = np.flatnonzero(own)
        private = [k for k, j in enumerate(columns) if variables[j].recording == i]
        assert private and np.allclose(both.gu[columns[private]], alone.gu[private])
    last = len(first_knots(crane, data.parts[0])) - 1
    assert not both.Hxo[last].any(), "nothing joins two recordings"


@pytest.fixture(scope="module")
def found(crane: Crane, recordings: list[Recording]) -> Diagnosis:
    """What the two recordings say that the crane file lacks."""
    return diagnose(crane, recordings, per_recording=["payload.mass"], jobs=1)


def left(lines: dict[str, dict[str, tuple[np.ndarray, np.ndarray]]], label: str) -> float:
    """Return the RMS error of a model that was drawn, in units of the noise."""
    errors = [(lines[label][c][1] - y) / NOISE[c] for c, (_, y) in lines["measured"].items()]
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


def test_a_leak_is_found_in_two_recordings_with_loads_of_their_own(crane, found):
    assert found.verdict == "effect" and found.effects == ("internal_leakage@lift",)
    assert found.candidates[0].parameters["k"]["value"] == pytest.approx(LEAK["k"], rel=0.1)
    document = found.to_dict()["recordings"]
    assert [r["recording"] for r in document] == ["bare", "loaded"]
    assert [r["parameters"]["payload.mass"]["value"] for r in document] == pytest.approx([0.0, 180.0], abs=8.0)
    for r in document:
        assert r["error_before"] > 2.0 and r["error_after"] == pytest.approx(1.0, abs=0.06)
    assert found.crane["payload.mass"] == crane["payload.mass"], "what differs stays as the crane file says"


def test_each_recording_is_drawn_and_told_with_its_own_load(found, recordings, tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(reports, "traces_figure", lambda lines, layout: drawn.append(lines) or plots.figure())
    text = report_diagnosis(found, tmp_path, examined=Examined(recordings)).read_text()
    for lines, entry in zip(drawn, found.recordings, strict=True):
        assert left(lines, "improved") == pytest.approx(entry["error_after"], rel=0.02)
        assert left(lines, "as given") > 2.0
        own = f"payload.mass = {entry['parameters']['payload.mass']['value']:.4g} kg"
        assert f">{own}</td>" in text and f"{entry['recording']} ({own}): Measured, and simulated" in text
    assert "<h2>By recording</h2>" in text


def test_an_improvement_is_drawn_and_told_with_the_loads_that_fit(found, recordings):
    steps = (Step(None, 9.0, np.nan, 60.0, "effect"), Step("internal_leakage@lift", 1.0, np.nan, 6.0, "effect"))
    result = Improvement(found.recording, steps, found.crane, "adequate", (found,))
    own = improved_own(result, recordings)
    assert [e["parameters"]["payload.mass"]["value"] for e in own] == pytest.approx([0.0, 180.0], abs=8.0)
    before, after = cranes_of_improvement(result, recordings, own)
    lines = from_one_start(recordings[1], {"as given": before[1], "improved": after[1]})
    assert left(lines, "improved") < 1.1 < 1.5 < left(lines, "as given")
    assert before[1]["payload.mass"] != found.given["payload.mass"], "the errors of the steps are with fitted loads"


def test_one_recording_stays_as_it_is(crane, recordings):
    assert isinstance(data_of(recordings[:1], crane, ["payload.mass"]), FitData)


def test_what_differs_must_be_uncertain(crane, recordings):
    with pytest.raises(CraneError, match="states no uncertainty of it"):
        data_of(recordings, crane, ["payload.mas"])
    with pytest.raises(CraneError, match="at least one"):
        diagnose(crane, [])


def test_a_load_far_from_the_crane_files_is_looked_for_over_its_whole_range(crane):
    heavy = recorded(crane.with_parameters({"payload.mass": 320.0}), "heavy", tuple(NOISE), 0.01, 0.25, 2.0)
    assert all_parameters(crane, FitData.of(heavy, crane)).crane["payload.mass"] == pytest.approx(320.0, abs=15.0)
