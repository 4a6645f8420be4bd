"""Hidden cases: manoeuvres, plants with laws of their own, sensors, the judge and the tables of the study."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.signals import noise_std
from crane_exudyn.statics import visible
from validation import hidden, hidden_machines, hidden_plant, study
from validation.json_lines import read_lines

CRANE = Crane.load("patu655")
#: seconds of the cases that are made whole here
SHORT = 6.0


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let manoeuvres and runs of hidden cases end after 6 s in place of 25 s."""
    monkeypatch.setattr(hidden, "DURATION", SHORT)
    monkeypatch.setattr(hidden, "_GRID", np.arange(round(SHORT / 1e-3) + 1) * 1e-3)


# -- manoeuvres and sensors ------------------------------------------------------------------------------------------


def test_manoeuvres_rest_move_and_reverse_within_limits() -> None:
    rng = np.random.default_rng(1)
    time = np.arange(0.0, hidden.DURATION, 0.01)
    reversals = 0
    for _ in range(40):
        u = hidden.draw_manoeuvre(rng).commands(time)
        assert np.abs(u).max() <= 0.6
        assert not u[time < 0.4].any(), "starts at rest"
        assert np.all(np.ptp(u, axis=0) > 0.06), "both cylinders move"
        signs = [np.sign(c[c != 0.0]) for c in u.T]
        reversals += sum(int(np.sum(np.diff(s) != 0)) for s in signs)
    assert reversals > 100


def test_commands_of_a_controller_have_corners_on_its_cycle() -> None:
    """A step is held until a microsecond before its corner, so corners stand on the cycle to within that."""
    on = hidden.draw_manoeuvre(np.random.default_rng(2)).corners[0][0]
    off = hidden.draw_manoeuvre(np.random.default_rng(2), cycle=None).corners[0][0]
    assert np.allclose(on / 0.01, np.round(on / 0.01), atol=2e-4)
    assert not np.allclose(off / 0.01, np.round(off / 0.01), atol=0.1)


def test_every_motion_reaches_its_command_by_a_ramp_or_a_step() -> None:
    times, values = np.array([0.0, 1.0, 1.0, 1.5, 1.53, 3.0]), np.array([0, 0, 0.4, 0.4, 0, 0])
    times, values = hidden.commands_on_grid(times, values, 0.01)
    assert np.allclose(times, [0.0, 1.0 - 1e-6, 1.0, 1.5, 1.53, 3.0], atol=1e-9)
    assert np.allclose(values, [0, 0, 0.4, 0.4, 0, 0])


def test_sensor_effects_act_in_the_order_of_the_library() -> None:
    crane = CRANE.with_effect("sensor_scale@p1", {"a": 1.1}).with_effect("sensor_bias@p1", {"b": 2e5})
    states = np.tile(np.arange(8.0), (5, 1))
    shown = hidden.readings(crane, states)
    assert np.allclose(shown["p1"], (4.0 + 2e5) * 1.1)
    assert np.allclose(shown["p2"], 5.0)


def test_visibility_is_the_largest_rms_in_noise_units() -> None:
    zero, ones = np.zeros(50), np.ones(50)
    seen = hidden.visibility({"z1": 3.0 * ones, "p1": ones}, {"z1": zero, "p1": zero}, {"z1": 2.0, "p1": 0.1})
    assert seen == pytest.approx(10.0)


def test_every_effect_has_severities_inside_its_range() -> None:
    rng = np.random.default_rng(3)
    manoeuvre = hidden.draw_manoeuvre(rng)
    for key in hidden.hideable(hidden.SENSOR_SETS[0]):
        for _ in range(20):
            CRANE.with_effect(key, hidden.severity(key, CRANE, manoeuvre.start, rng))  # refuses values out of range
    assert {k.partition("@")[0] for k in hidden.hideable(hidden.SENSOR_SETS[0])} == set(hidden.SEVERITIES)
    assert "sensor_bias@p2" not in hidden.hideable(hidden.SENSOR_SETS[1])


def test_small_errors_stay_within_what_is_known_about_the_parameters() -> None:
    machine = hidden.draw_machine(CRANE, np.random.default_rng(4), errors=True, payload=True)
    moved = [n for n, v in machine.values.items() if v != CRANE[n]]
    assert 5 < len(moved) < len(CRANE.uncertainty)
    assert 0.0 <= machine["payload.mass"] <= 200.0
    for name in set(moved) - {"payload.mass"}:
        assert abs(machine[name] - CRANE[name]) < 2.5 * CRANE.uncertainty[name].std  # 5 sigma of the draw


# -- whole cases -----------------------------------------------------------------------------------------------------


def test_a_clean_case_is_the_nominal_crane_and_noise_of_the_size_said(short: None) -> None:
    """The other engine, started where the answer says and driven by the recorded commands, leaves white noise."""
    from crane_exudyn.simulation import simulate
    from validation.semi_recursive import SemiRecursiveEngine

    case = hidden.make_case(1201, kind="none", noise=0, rate=500, sensors=0)
    assert case.answer["verdict"] == "adequate"
    engine, start = SemiRecursiveEngine(CRANE), case.answer["learn_start"]
    x0 = engine.static_start(start["z1"], start["z4"], start["less_loaded"])
    states = visible(CRANE, simulate(CRANE, case.learn, start=x0, engine=engine).states)
    for name, column in zip(("z1", "z4", "p1", "p2", "p3", "p4"), (0, 1, 4, 5, 6, 7), strict=True):
        residual = (case.learn[name].values - states[:, column]) / case.answer["noise"][name]
        n = residual.size
        assert np.mean(residual**2) == pytest.approx(1.0, abs=5.0 * math.sqrt(2.0 / n)), name  # 5 sigma of chi-square
        assert abs(np.mean(residual[1:] * residual[:-1])) < 5.0 / math.sqrt(n), name


def test_the_same_seed_gives_the_same_case_and_effects_are_as_visible_as_asked(short: None) -> None:
    wanted: dict[str, Any] = {"kind": "effect", "keys": ["sensor_bias@p1"], "rate": 100, "visible": (5.0, 40.0)}
    a, b = (hidden.make_case(1202, **wanted) for _ in range(2))
    assert a.answer == b.answer
    assert np.array_equal(a.check["z4"].values, b.check["z4"].values)
    assert a.answer["effects"] == ["sensor_bias@p1"]
    shift = abs(a.answer["parameters"]["sensor_bias@p1"]["b"]) / a.answer["noise"]["p1"]
    assert a.answer["visibility"]["sensor_bias@p1"] == pytest.approx(shift)
    assert 5.0 <= shift <= 40.0


def test_what_is_hidden_shows_in_the_part_that_is_learned_from(short: None) -> None:
    case = hidden.make_case(1205, kind="effect", keys=["payload_change"], rate=100, learned=4.0)
    assert case.learn.end == pytest.approx(4.0)
    assert case.answer["parameters"]["payload_change"]["T"] < 4.0
    assert case.answer["visibility"]["payload_change"] >= 3.0
    assert case.check.end > 5.0


def test_a_swapped_machine_runs_on_the_other_engine_and_agrees_far_below_the_noise(short: None) -> None:
    a, b = (hidden.make_case(1203, kind="none", rate=100, sensors=0, swapped=swapped) for swapped in (False, True))
    for name, std in a.answer["noise"].items():
        apart = np.abs(a.learn[name].values - b.learn[name].values).max()
        assert 0.0 < apart < 0.5 * std, name


@pytest.mark.parametrize(("kind", "key"), [("effect", "sensor_bias@z1"), ("unknown", "orifice_leak")])
def test_conditions_that_cannot_be_met_are_told(
    monkeypatch: pytest.MonkeyPatch, short: None, kind: str, key: str
) -> None:
    monkeypatch.setattr(hidden, "_MOST_DRAWS", 1)
    with pytest.raises(CraneError, match=rf"{key}.*1 draws failed.*noise units"):
        hidden.make_case(1203, kind=kind, keys=[key], visible=(1e9, math.inf))


# -- laws of their own -----------------------------------------------------------------------------------------------


def _short_run(crane: Crane, laws: list[hidden_plant.Law]) -> np.ndarray:
    """Return the states of 0.3 s with the lift valve opening."""
    time = np.arange(301) * 1e-3
    u = np.column_stack([np.clip(4.0 * time, 0.0, 0.5), np.zeros(301)])
    start = ExudynEngine(CRANE).static_start(0.2, -0.8)
    return hidden_plant.simulate(crane, start, time, hidden_plant.inputs(crane, time, time, u), laws)


def test_without_laws_the_plant_is_the_engine() -> None:
    time = np.arange(301) * 1e-3
    u = np.column_stack([np.clip(4.0 * time, 0.0, 0.5), np.zeros(301)])
    engine = ExudynEngine(CRANE)
    w = hidden_plant.inputs(CRANE, time, time, u)
    assert np.array_equal(_short_run(CRANE, []), engine.simulate(engine.static_start(0.2, -0.8), time, w))


def test_a_law_of_flows_is_the_librarys_leakage_to_the_order_of_the_step() -> None:
    """The law sees the pressures at the start of the step, so it is off by a flow that changes within 1 ms."""
    k = 2e-11

    def law(now: hidden_plant.Now) -> dict[str, float]:
        piston, rod = now.pressures(0)
        return {"flow.p1": -k * (piston - rod), "flow.p2": k * (piston - rod)}

    plain, effect = _short_run(CRANE, []), _short_run(CRANE.with_effect("internal_leakage@lift", {"k": k}), [])
    by_law = _short_run(CRANE, [law])
    moved = np.abs(effect - plain)[:, 4:6].max()
    assert moved > 1e5
    assert np.abs(by_law - effect)[:, 4:6].max() < 0.03 * moved


def test_laws_that_the_library_lacks() -> None:
    bore = hidden_plant.scored_bore(CRANE, 0, 5000.0, 1.0, 0.05)
    nominal = CRANE["cylinders.lift.coulomb_friction"]
    at, off = (bore(hidden_plant.Now(0.0, np.zeros(8), np.zeros(8), np.zeros(4), (s1, 1.3))) for s1 in (1.0, 1.3))
    assert at["cylinders.lift.coulomb_friction"] == pytest.approx(nominal + 5000.0)
    assert off["cylinders.lift.coulomb_friction"] == pytest.approx(nominal)
    pump = hidden_plant.hunting_pump(CRANE, 0.1, 0.5, 0.0)
    peak = pump(hidden_plant.Now(0.5, np.zeros(8), np.zeros(8), np.zeros(4), (1.0, 1.3)))["supply.pump_pressure"]
    assert peak == pytest.approx(1.1 * CRANE["supply.pump_pressure"])


def test_dialects_are_near_the_librarys_laws_but_not_the_same() -> None:
    time = np.arange(2001) * 1e-3
    u = np.column_stack([0.5 * np.sin(2.0 * np.pi * 0.5 * time), np.zeros_like(time)])
    for key, values in (
        ("dead_band@lift", {"lower": 0.05, "upper": 0.08}),
        ("spool_hysteresis@lift", {"b": 0.05}),
        ("command_delay@lift", {"T": 0.05}),
    ):
        library = hidden_plant.inputs(CRANE.with_effect(key, values), time, time, u)[:, 0]
        if key == "dead_band@lift":
            library = np.where(
                library > 0.08, (library - 0.08) / 0.92, np.where(library < -0.05, (library + 0.05) / 0.95, 0)
            )
        spoken = hidden_plant.dialect(key, values, CRANE)
        assert spoken is not None
        other = hidden_plant.inputs(CRANE, time, time, u, [spoken])[:, 0]
        difference = np.abs(other - library).max()
        assert 1e-4 < difference < 0.015, key  # a hundredth of the stroke


def test_effects_without_a_dialect_keep_the_librarys_law() -> None:
    assert hidden_plant.dialect("base_tilt", {"gamma": 0.1}, CRANE) is None


# -- the study -------------------------------------------------------------------------------------------------------


def _found(verdict: str, effects: list[str], tied: list[str] = [], value: float = 1e-12) -> dict[str, Any]:  # noqa: B006
    named = {"effect": " + ".join(effects), "parameters": {"k": {"value": value, "std": 1e-14, "unit": "m^3/s/Pa"}}}
    errors = dict.fromkeys(("error_before", "error_after", "check_error_before", "check_error_after"), 1.0)
    return {"verdict": verdict, "effects": effects, "tied_with": tied, "candidates": [named], **errors}


def _answer(kind: str, effects: list[str], verdict: str) -> dict[str, Any]:
    return {
        "kind": kind, "verdict": verdict, "effects": effects,
        "parameters": {e: {"k": 2e-12} for e in effects}, "visibility": dict.fromkeys(effects, 7.0),
        "noise": dict.fromkeys(("z1", "z4", "p1", "p4"), 0.3e5),
    }  # fmt: skip


LEAK, OTHER = "internal_leakage@lift", "internal_leakage@tilt"


def test_judge_single_effects() -> None:
    answer = _answer("effect", [LEAK], "effect")
    good = study.judge(answer, _found("effect", [LEAK]))
    assert good["right"] and good["first"] and good["visibility"] == 7.0
    assert good["relative_errors"] == {f"{LEAK}.k": pytest.approx(0.5)}
    tied = study.judge(answer, _found("tied", [OTHER], [LEAK]))
    assert tied["right"] and not tied["first"]
    wrong = study.judge(answer, _found("effect", [OTHER]))
    assert not wrong["right"] and wrong["said"] == OTHER
    assert not study.judge(answer, _found("unknown", []))["right"]
    assert not study.judge(answer, _found("effect", [LEAK, OTHER]))["right"], "one too many is not right"


def test_judge_pairs_and_nothing_and_unknown() -> None:
    two = _answer("two", [LEAK, OTHER], "effect")
    assert study.judge(two, _found("effect", [OTHER, LEAK]))["right"], "their order does not matter"
    half = study.judge(two, _found("effect", [LEAK]))
    assert half["partly"] and not half["right"]
    nothing = _answer("none", [], "adequate")
    assert study.judge(nothing, _found("adequate", []))["right"]
    assert study.judge(nothing, _found("effect", [LEAK]))["alarm"]
    assert not study.judge(nothing, _found("parameters", []))["alarm"]
    assert study.judge(_answer("unknown", [], "unknown"), _found("unknown", []))["right"]
    assert not study.judge(_answer("unknown", [], "unknown"), _found("unknown", []))["alarm"]


def test_plans_hide_every_effect_and_every_kind() -> None:
    plans = [study.planned(seed) for seed in range(5000, 5400)]
    assert {p["kind"] for p in plans} == set(hidden.KINDS) - {"three", "four"}, "those are for `improve`"
    keys = [p["keys"][0] for p in plans if "keys" in p]
    assert set(keys) == set(hidden.hideable(hidden.SENSOR_SETS[0]))
    first = {k.partition("@")[0] for k in keys[: len(hidden.SEVERITIES)]}
    assert first == set(hidden.SEVERITIES), "each effect once before any comes again"


def test_a_hidden_law_that_the_library_lacks_is_not_given_a_name(short: None) -> None:
    """The plant runs on the Exudyn engine, the diagnosis searches on the other; the seed was fixed before looking.

    Effects that the library has, and none, are found in the open cases of tests/test_diagnosis.py, and on an Exudyn
    plant in tests/test_commands_on_machines.py.
    """
    seed, plain = 7007, {"noise": 0, "sensors": 0, "rate": 100, "visible": (10.0, math.inf)}
    case = hidden.make_case(seed, **(study.planned(seed) | plain))
    line = study.run_one(replace(case, learn=case.learn.window(0.0, 4.0)), f"case_{seed}")
    assert "judged" in line, line.get("trace")
    assert case.answer["verdict"] == "unknown" and line["judged"]["right"], study.summary(line)


def _line(name: str, kind: str, effects: list[str], found: dict[str, Any]) -> dict[str, Any]:
    verdict = "effect" if kind in hidden.HIDES else {"none": "adequate"}.get(kind, kind)
    answer = _answer(kind, effects, verdict)
    return {"name": name, "answer": answer, "diagnosis": found, "judged": study.judge(answer, found), "seconds": 1.0}


def test_tables_count_what_the_lines_say() -> None:
    lines = [
        _line("a", "effect", [LEAK], _found("effect", [LEAK], value=2e-12)),
        _line("b", "effect", [LEAK], _found("effect", [OTHER])),
        _line("c", "none", [], _found("unknown", [])),
        {"name": "d", "answer": _answer("none", [], "adequate"), "failed": "RuntimeError()"},
    ]
    text = study.tables(lines)
    assert "| one effect, visibility >= 5: right (first or tied) | 1 of 2 (50 %) |" in text
    assert "| nothing hidden: false alarms | 1 of 1 (100 %) |" in text
    assert "| right ones: all parameters within 10 % | 1 of 1 (100 %) |" in text
    assert "| failed with an error | 1 |" in text
    assert "| z1 z4 p1 p4 | 0.05° and 0.3 bar | 1 of 2 (50 %) | 0 of 1 (0 %) |" in text
    assert f"| internal_leakage | 1 of 2 (50 %) | 1 of 2 (50 %) | {OTHER} |" in text


def test_a_study_goes_on_where_it_was_interrupted(tmp_path: Any) -> None:
    results = tmp_path / "results.jsonl"
    done = _line("a", "none", [], _found("adequate", []))
    results.write_text(json.dumps(done) + "\n", encoding="utf-8")
    called: list[str] = []

    def task(name: str) -> dict[str, Any]:
        called.append(name)
        return _line(name, "none", [], _found("adequate", []))

    study.run(results, [(n, task, (n,)) for n in ("a", "b")])
    assert called == ["b"]
    assert [line["name"] for line in read_lines(results)] == ["a", "b"]


# -- other machines --------------------------------------------------------------------------------------------------


def test_a_case_of_another_machine_is_drawn_from_its_seed_and_as_visible_as_promised() -> None:
    case = hidden_machines.make_case(7)
    (key,), nominal = case.answer["effects"], case.nominal
    assert nominal.name == case.answer["crane"] in hidden_machines.MACHINES and nominal.effect(key) is None
    assert case.answer["visibility"][key] >= study.PROMISED
    again = hidden_machines.make_case(7)
    for name, std in hidden_machines.noise_of(nominal).items():
        assert np.array_equal(case.check[name].values, again.check[name].values)
        assert noise_std(case.learn[name].values) == pytest.approx(std, rel=0.2), name


def test_results_of_other_machines_are_counted_by_machine() -> None:
    lines = [
        _line("a", "effect", [LEAK], _found("effect", [LEAK], value=2e-12)),
        _line("b", "none", [], _found("effect", [LEAK])),
    ]
    for line, machine in zip(lines, ("loader", "excavator"), strict=True):
        line["answer"]["crane"] = machine
    rows = hidden_machines.table(lines).splitlines()
    assert next(r for r in rows if "loader" in r).split("|")[2:5] == [" 1 of 1 (100 %) ", " - ", " - "]
    assert next(r for r in rows if "excavator" in r).split("|")[2:5] == [" - ", " 0 of 1 (0 %) ", " - "]
