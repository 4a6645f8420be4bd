"""The two engines against each other, and the proof that the comparison can fail."""

from __future__ import annotations

import json
import math
import re
import types
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import validation.semi_recursive.equations as equations_module
import validation.semi_recursive.hydraulics as hydraulics_module
import validation.semi_recursive.mechanics as mechanics_module
import validation.semi_recursive.sheet as sheet_module
import validation.semi_recursive.terms as terms_module
from crane_exudyn.crane import Crane
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.inputs import paper_cycle
from patu import main
from validation import crosscheck as cc
from validation import crosscheck_cases as cases
from validation.crosscheck_figures import by_name, figure_of, save_figures
from validation.crosscheck_quantities import Quantity, compare_static_starts, compare_terms, groups_of
from validation.crosscheck_runs import ORDER_STEPS, Run, compare_runs, convergence_orders
from validation.semi_recursive import SemiRecursiveEngine

SEED = 7


@pytest.fixture(scope="module")
def crane() -> Crane:
    return Crane.load("patu655")


@pytest.fixture(scope="module")
def exudyn(crane: Crane) -> ExudynEngine:
    return ExudynEngine(crane)


@pytest.fixture(scope="module")
def semi_recursive(crane: Crane) -> SemiRecursiveEngine:
    return SemiRecursiveEngine(crane)


@pytest.fixture(scope="module")
def states(crane: Crane) -> cases.States:
    return cases.random_states(crane, 100, np.random.default_rng(SEED))


def assert_ok(quantities: list[Quantity]) -> None:
    assert quantities
    failing = [
        f"{q.name}: {q.max_abs:.3g} {q.unit}, relative {q.relative:.2g} > {q.tolerance:.0e}"
        for q in quantities
        if not q.ok
    ]
    assert not failing, "\n".join(failing)


# -- agreement ---------------------------------------------------------------------------------------------------------


def test_every_quantity_agrees(
    crane: Crane, exudyn: ExudynEngine, semi_recursive: SemiRecursiveEngine, states: cases.States
) -> None:
    quantities = compare_terms(exudyn, semi_recursive, states)
    assert_ok(quantities)
    assert len(quantities) == sum(len(g.names) for g in groups_of(crane))


def test_static_starts_agree(exudyn: ExudynEngine, semi_recursive: SemiRecursiveEngine, states: cases.States) -> None:
    assert_ok(compare_static_starts(exudyn, semi_recursive, states))


PROBES = list(cases.effect_probes(Crane.load("patu655")))


#: where each effect is followed along a run too: terms that agree at every place agree along it
ALONG = {key.partition("@")[0]: key for key in reversed(PROBES)}.values()


@pytest.mark.parametrize("key", PROBES)
def test_every_effect_agrees_and_acts(key: str) -> None:
    probe = cases.effect_probes(Crane.load("patu655"))[key]
    engines = ExudynEngine(probe), SemiRecursiveEngine(probe)
    assert_ok([cc.check_effect(key, *engines, 40, np.random.default_rng(SEED))])
    if key in ALONG:
        assert_ok([cc.run_effect(key, probe, ExudynEngine, SemiRecursiveEngine)])


def test_other_cranes_agree(crane: Crane) -> None:
    others = cases.other_cranes(crane, np.random.default_rng(SEED))
    assert len(others) == 2
    for name, other in others.items():
        drawn = cases.random_states(other, 20, np.random.default_rng(SEED))
        first, second = ExudynEngine(other), SemiRecursiveEngine(other)
        assert_ok([*compare_terms(first, second, drawn), *compare_static_starts(first, second, drawn)])
        assert other.values != crane.values, name


@pytest.mark.parametrize("manoeuvre", [0, 1])
def test_trajectories_agree_with_order_two(
    crane: Crane, exudyn: ExudynEngine, semi_recursive: SemiRecursiveEngine, manoeuvre: int
) -> None:
    rng = np.random.default_rng(SEED)
    name, given = list(cc.manoeuvres(crane, semi_recursive, 3.2, rng).items())[manoeuvre]
    time, commands = given()
    w = cases.spool_inputs(crane, time, commands)
    quantities, runs = compare_runs(name, exudyn, semi_recursive, time, w, 1e-4, lambda fraction, part: None)
    assert_ok(quantities)
    assert np.ptp(runs[-1].second[:, 0]) > 0.05  # the boom did move


#: what a crane file may state at the ends of its ranges
ENDS = {
    "empty": {"payload.mass": 0.0},
    "spools without lag": {"valves.lift.time_constant": 0.0, "valves.tilt.time_constant": 0.0},
    "turbulent from 1 Pa": {"fluid.laminar_pressure": 1.0},
    "turbulent from 100 Pa": {"fluid.laminar_pressure": 100.0},
    "laminar throughout": {"fluid.laminar_pressure": 1e9},
}


@pytest.mark.parametrize("name", ENDS)
def test_cranes_at_the_ends_of_the_ranges_agree(crane: Crane, name: str) -> None:
    rng, odd = np.random.default_rng(SEED), crane.with_parameters(ENDS[name])
    first, second = ExudynEngine(odd), SemiRecursiveEngine(odd)
    drawn = cases.random_states(odd, 20, rng)
    assert_ok([*compare_terms(first, second, drawn), *compare_static_starts(first, second, drawn)])
    assert len(cases.other_cranes(odd, rng)) == 2
    time, commands = cc.manoeuvres(odd, second, 2.0, rng)["random joystick"]()
    w = cases.spool_inputs(odd, time, commands)
    assert_ok(compare_runs("joystick", first, second, time, w, 1e-3, lambda fraction, part: None)[0])


def test_only_what_is_left_by_newtons_methods_has_no_order(crane: Crane) -> None:
    def runs(sizes: list[float]) -> list[Run]:
        scale = np.array([1.0, 1.0, 1.0, 1.0, 1e9, 1e9, 1e9, 1e9])
        return [
            Run("run", h, np.arange(3.0), np.full((3, 8), size) * scale, np.zeros((3, 8)), 3)
            for h, size in zip(ORDER_STEPS, sizes, strict=True)
        ]

    assert_ok(convergence_orders(crane.layout, runs([3e-10, 1e-10, 2e-10])))
    assert_ok(convergence_orders(crane.layout, runs([7e-10, 9e-10, 1.2e-9])))  # above 1e-9 rad and 1 Pa, no order
    assert_ok(convergence_orders(crane.layout, runs([16e-9, 4e-9, 1.7e-9])))  # only the last is of Newton's methods
    assert_ok(convergence_orders(crane.layout, runs([16e-7, 4e-7, 1e-7])))
    for sizes in ([16e-7, 8e-7, 4e-7], [16e-9, 8e-9, 1e-9], [1e-7, 1e-7, 1e-7], [1e-9, 1e-8, 1e-7], [0.0, 0.0, 0.0]):
        assert not any(q.ok for q in convergence_orders(crane.layout, runs(sizes))), sizes
    assert not any(q.ok for q in convergence_orders(crane.layout, runs([1e-6, 1e-6, math.nan])))


def test_positions_that_drift_apart_alone_have_an_order_too(crane: Crane) -> None:
    """Pressures that agree excuse no positions that do not."""
    off = [np.array([size] * 4 + [1e-4] * 4) for size in (16e-7, 8e-7, 4e-7)]
    runs = [
        Run("run", h, np.arange(3.0), np.tile(d, (3, 1)), np.zeros((3, 8)), 3)
        for h, d in zip(ORDER_STEPS, off, strict=True)
    ]
    positions, pressures = convergence_orders(crane.layout, runs)
    assert not positions.ok and "found 1.00" in positions.reason and pressures.ok


def test_joystick_keeps_off_the_ends(crane: Crane, semi_recursive: SemiRecursiveEngine) -> None:
    x0 = semi_recursive.static_start(*crane.initial.pose)
    time, commands = cases.joystick(crane, x0, 12.0, np.random.default_rng(SEED))
    w = cases.spool_inputs(crane, time, commands)
    t = semi_recursive.terms_along(semi_recursive.simulate(x0, time, w), w, time)
    assert min(t[f"l{i}"].min() for i in range(1, 5)) > 0.5 * cases.MARGIN
    assert np.ptp(commands, axis=0).min() > 0.3


# -- the cross-check can fail ------------------------------------------------------------------------------------------


class Faulty(SemiRecursiveEngine):
    """The semi-recursive engine with its equations executed, uncompiled, from a text with faults."""

    def __init__(self, crane: Crane, *faults: tuple[str, str]):
        super().__init__(crane)
        self._terms = faulty_terms(faults)

    def terms_along(self, states: np.ndarray, inputs: np.ndarray, time: np.ndarray) -> dict[str, np.ndarray]:
        names, machine = terms_module.term_names(self.crane.machine), self.crane.machine
        out = self._terms(
            states, inputs, time, self._P, self._E, machine.topology, terms_module.point_rows(machine), len(names)
        )
        return dict(zip(names, out.T, strict=True))


def plain(module: types.ModuleType, text: str, **given: object) -> dict[str, object]:
    """Return what a text defines that compiles nothing, in the place of a module."""
    text = re.sub(r" *@(inline|lean|njit)\n(?= *def )", "", text)
    found = {"__name__": module.__name__, "__package__": module.__package__, **given}
    exec(compile(text, "faulty", "exec"), found)
    return found


def faulty_terms(faults: tuple[tuple[str, str], ...]) -> Callable[..., np.ndarray]:
    """Return `terms` as plain Python, after each fault (found text, put in its place) was put into the equations."""
    modules = sheet_module, mechanics_module, hydraulics_module, equations_module, terms_module
    texts = [Path(str(module.__file__)).read_text(encoding="utf-8") for module in modules]
    for right, wrong in faults:
        count = sum(text.count(right) for text in texts[:-1])
        assert count == 1, f"{right!r} stands {count} times in the equations"
        texts = [text.replace(right, wrong) for text in texts]
    names = dict[str, object]()
    for module, text in zip(modules, texts, strict=True):
        names |= plain(module, re.sub(r"from \.\w+ import (\([^)]*\)|.*)", "", text), **names)
    return names["terms"]  # type: ignore[return-value]


def test_without_a_fault_the_plain_equations_agree(crane: Crane, exudyn: ExudynEngine, states: cases.States) -> None:
    assert_ok(compare_terms(exudyn, Faulty(crane), first(states, 10)))


def first(states: cases.States, count: int) -> cases.States:
    return cases.States(states.x[:count], states.w[:count], states.time[:count])


FAULTS = {
    "sign of friction": (("- air - Fmu", "- air + Fmu"), {"F1", "F2"}),
    "sign of a rate": (("cross(first, r) / determinant", "-cross(first, r) / determinant"), {"dz3_dz4"}),
    "sign of the rod side's flow": (("Qa, Qb = (pump, tank)", "Qa, Qb = (pump, -tank)"), {"Q2", "Q4"}),
    "areas swapped in the force": (("= pa * Aa - pb * Ab - air", "= pa * Ab - pb * Aa - air"), {"F1", "F2"}),
    "areas swapped in the volumes": (
        (
            "oil_at(ya, Aa * la, P[i + HOSE_A], f, E), oil_at(yb, Ab * (P",
            "oil_at(ya, Ab * la, P[i + HOSE_A], f, E), oil_at(yb, Aa * (P",
        ),
        {"N1", "N2", "N3", "N4"},
    ),
    "centrifugal force lost": (("w * w * mg - m * d", "-m * d"), {"Qv_z1", "Qv_z4"}),
    "velocity products of the loop lost": (("turned(apart)", "turned(0.0 * apart)"), {"Qv_z1", "Qv_z4"}),
    "volume frozen": (
        ("    V, wall = Al + Vh, Vh * f.wall", "    V, wall = 4e-3, Vh * f.wall"),
        {"N1", "N2", "N3", "N4"},
    ),
    "hose forgotten in the bulk modulus": (
        ("V * k * f.soft + wall * k, k, k)", "V * k * f.soft, k, k)"),
        {"Be1", "Be2", "Be3", "Be4"},
    ),
    "oil that comes in weighs too much": (
        ("s.numbers[k, OIL_A + DENSITY] * (Qa + leak_a)", "(Qa + leak_a)"),
        {"dp1", "dp3"},
    ),
    "payload's inertia forgotten": (
        ("/ 12.0 + mass * square(E)", "* 0.0 + mass * square(E)"),
        {"M_z1_z1", "M_z1_z4", "M_z4_z4"},
    ),
    "half of gravity": (("s.numbers[j, MASS] * g, cross", "0.5 * s.numbers[j, MASS] * g, cross"), {"Qg_z1", "Qg_z4"}),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_is_caught_and_named(crane: Crane, exudyn: ExudynEngine, states: cases.States, fault: str) -> None:
    """The first quantities out of tolerance are those that the fault touches, and nothing before them is."""
    change, named = FAULTS[fault]
    quantities = compare_terms(exudyn, Faulty(crane, change), first(states, 10))
    failing = [q.name for q in quantities if not q.ok]
    assert failing and failing[0] in named
    group = next(g for g in groups_of(crane) if failing[0] in g.names)
    assert {n for n in failing if n in group.names} <= named
    result = cc.CrossCheck("patu655", crane.layout, quantities)
    assert not result.ok and result.failures[0].name == failing[0] and failing[0] in repr(result)


def test_a_faulty_trajectory_is_caught(crane: Crane, exudyn: ExudynEngine) -> None:
    """A valve 1 % off, on one side only, shows in angles and pressures."""
    off = SemiRecursiveEngine(
        crane.with_parameters({"valves.lift.flow_coefficient": 1.01 * crane["valves.lift.flow_coefficient"]})
    )
    time = np.arange(2401) * 1e-3
    w = cases.spool_inputs(crane, time, np.column_stack([0.3 * (time > 0.2), 0.0 * time]))
    quantities, _ = compare_runs("lift", exudyn, off, time, w, 1e-3, lambda fraction, part: None)
    assert {"lift: z1", "lift: p1", "lift: order of positions"} <= {q.name for q in quantities if not q.ok}


class Coarse(SemiRecursiveEngine):
    """An engine whose rule errs by so many rad (or 1e9 times as many Pa) at 1 ms, as the square of the step."""

    size = 0.0

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, **options: float) -> np.ndarray:
        scale = self.size * (options["step"] / 1e-3) ** 2 * np.where(np.arange(len(x0)) < 4, 1.0, 1e9)
        return super().simulate(x0, time, inputs, step=1e-3) + scale * (time[:, None] > 0.5)


def test_two_forms_of_a_rule_need_not_be_closer_than_its_own_error(crane: Crane) -> None:
    time = np.arange(1001) * 1e-3
    w = cases.spool_inputs(crane, time, np.column_stack([0.3 * (time > 0.2), 0.0 * time]))

    def failing(first: float, second: float, step: float = 1e-3) -> set[str]:
        engines = Coarse(crane), Coarse(crane)
        engines[0].size, engines[1].size = first, second
        quantities, _ = compare_runs("run", *engines, time, w, step, lambda fraction, part: None)
        return {q.name for q in quantities if not q.ok}

    assert not failing(8e-6, 5e-6)  # apart by 3e-6 rad, of 5e-6 rad
    assert {"run: z1", "run: z4"} <= failing(8e-6, 1e-6)  # apart by more
    assert {"run: z1", "run: z4"} <= failing(2e-4, 1.5e-4)  # more than an engine promises


def test_what_is_not_a_number_is_never_ok() -> None:
    assert not Quantity("F1", "N", math.nan, math.nan, 1e-9, "").ok


def test_an_effect_without_influence_is_not_called_a_success(crane: Crane) -> None:
    inactive = crane.with_effect("internal_leakage@lift", {"k": 0.0})
    engines = SemiRecursiveEngine(inactive), SemiRecursiveEngine(inactive)
    quantity = cc.check_effect("internal_leakage@lift", *engines, 5, np.random.default_rng(SEED))
    assert not quantity.ok and "changed no quantity" in quantity.reason


def test_an_effect_that_cannot_be_run_is_refused(crane: Crane) -> None:
    with pytest.raises(CraneError, match="internal_leakage@lift"):
        cc.crosscheck(crane, effects=["internal_leakage@lit"])


# -- machines that the usual commands are too much for -----------------------------------------------------------------


@pytest.fixture(scope="module")
def short(crane: Crane) -> Crane:
    """A crane whose lift cylinder the paper's cycle would drive to its end at 3.9 s."""
    return crane.with_parameters({"cylinders.lift.chamber_range": 0.6 * crane["cylinders.lift.chamber_range"]})


def test_the_cycle_keeps_off_the_ends_of_any_machine(short: Crane) -> None:
    engine, rng = SemiRecursiveEngine(short), np.random.default_rng(SEED)
    time, commands = cc.manoeuvres(short, engine, 6.0, rng)["paper's cycle"]()
    x0 = engine.static_start(*short.initial.pose)
    with pytest.raises(CraneError, match="end of its stroke"):
        engine.simulate(x0, time, cases.spool_inputs(short, time, paper_cycle(time)))
    run = engine.simulate(x0, time, cases.spool_inputs(short, time, commands))
    assert np.ptp(run[:, 0]) > 0.03  # it moves all the same
    assert np.flatnonzero(commands[:, 0])[0] == np.flatnonzero(paper_cycle(time)[:, 0])[0]


class Weak(SemiRecursiveEngine):
    """An engine that does not get over a hard strike."""

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, **options: float) -> np.ndarray:
        if inputs[-1, 0] > 0.5:
            raise CraneError("the step is not accurate")
        return super().simulate(x0, time, inputs, **options)


def test_a_stop_that_is_struck_too_hard_is_struck_gently(crane: Crane) -> None:
    probe = cases.effect_probes(crane)["end_stop@lift"]
    assert "gently" not in cc.run_effect("end_stop@lift", probe, SemiRecursiveEngine, SemiRecursiveEngine).reason
    quantity = cc.run_effect("end_stop@lift", probe, Weak, SemiRecursiveEngine)
    assert quantity.ok and quantity.reason.endswith("driven gently")
    whole = cases.without_short_strokes(probe)
    engine = SemiRecursiveEngine(whole)
    time, w = cases.exciting(whole, "lift", gently=True)
    run = engine.simulate(engine.static_start(*whole.initial.pose), time, w)
    assert cases.positions_in_strokes(whole, run)[:, 0].max() > 1.0  # the stop is struck


class Stuck(SemiRecursiveEngine):
    """An engine that cannot run a crane with one effect, nor the paper's cycle."""

    def simulate(self, x0: np.ndarray, time: np.ndarray, inputs: np.ndarray, **options: float) -> np.ndarray:
        if self.crane.effect("internal_leakage@lift") or (len(self.crane.effects) == 0 and inputs[:, 0].max() > 0.499):
            raise CraneError(f"{self.crane.name}: too stiff")
        return super().simulate(x0, time, inputs, **options)


def test_what_cannot_be_run_is_a_line_of_its_own(crane: Crane) -> None:
    told: list[str] = []
    wanted = ["internal_leakage@lift", "internal_leakage@tilt"]
    result = cc.crosscheck(
        crane, states=10, seconds=2.4, step=1e-3, make_first=Stuck, effects=wanted,
        progress=lambda fraction, part: told.append(part),
    )  # fmt: skip
    assert [q.name for q in result.not_run] == ["internal_leakage@lift, along 5 s", "paper's cycle"]
    assert not result.ok and all("too stiff" in q.reason for q in result.not_run)
    names = [q.name for q in result.quantities]
    assert {"internal_leakage@lift", "internal_leakage@tilt, along 5 s", "random joystick: z1"} <= set(names)
    assert not {"internal_leakage@lift, along 5 s"} & {q.name for q in result.failures}
    assert result.to_dict()["quantities"]["paper's cycle"]["run"] is False and "2 could not be run" in repr(result)
    assert told.index("other cranes") < told.index("internal_leakage@tilt") < told.index("paper's cycle")


def test_effects_can_be_left_out(crane: Crane) -> None:
    wanted = ["internal_leakage@tilt", "internal_leakage@lift", "end_stop@lift"]
    left_out = ["end_stop", "internal_leakage@lift"]
    result = cc.crosscheck(crane, states=10, seconds=0.5, step=1e-3, effects=wanted, without=left_out)
    names = {q.name.partition(",")[0] for q in result.quantities}
    assert names & set(wanted) == {"internal_leakage@tilt"}
    with pytest.raises(CraneError, match=r'leave out. Did you mean "end_stop'):
        cc.crosscheck(crane, without=["end_stopp"])


# -- the whole, and what it leaves behind ------------------------------------------------------------------------------


def test_the_whole_check_writes_what_it_promises(crane: Crane, tmp_path: Path) -> None:
    """Both sides the same engine, so that only the machinery is tested: all agrees, except that there is no order to
    see.
    """
    seen: list[float] = []

    def make(c: Crane) -> SemiRecursiveEngine:
        return SemiRecursiveEngine(c)

    result = cc.crosscheck(
        crane,
        states=20,
        seconds=2.4,
        step=1e-3,
        make_first=make,
        make_second=make,
        effects=["payload_swing"],
        progress=lambda fraction, part: seen.append(fraction),
    )
    assert {q.name for q in result.failures} == {
        f"{m}: order of {o}" for m in by_name(result.runs) for o in ("positions", "pressures")
    }
    document = json.loads(json.dumps(result.to_dict(), allow_nan=True))
    assert {"F1", "dz2_dz4", "static start: p1", "payload_swing", "drawn at random", "paper's cycle: p1"} <= set(
        document["quantities"]
    )
    assert {"max_abs", "relative", "tolerance", "ok"} <= set(document["quantities"]["F1"])
    assert document["ok"] is False
    assert seen == sorted(seen) and seen[-1] == pytest.approx(1.0)
    pictures = save_figures(result, tmp_path / "pictures")
    assert [p.name for p in pictures] == ["crosscheck-papers-cycle.png", "crosscheck-random-joystick.png"]
    assert all(p.stat().st_size > 10_000 for p in pictures)
    figure = figure_of(crane.layout, by_name(result.runs)["paper's cycle"])
    below = [label.get_text() for axes in figure.axes[1::2] for label in axes.get_yticklabels()]
    assert "10⁻¹⁵" in below and not any("$" in text or "\\" in text for text in below)


def test_the_command_tells_what_could_not_be_run(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = [
        Quantity("s1", "m", 0.0, 0.0, 1e-9, "why"),
        Quantity.not_run("end_stop@lift, along 5 s", CraneError("too stiff")),
    ]
    given: dict[str, object] = {}

    def crosscheck(crane: Crane, **options: object) -> cc.CrossCheck:
        given.update(options)
        return cc.CrossCheck(crane.name, crane.layout, lines)

    monkeypatch.setattr(cc, "crosscheck", crosscheck)
    with pytest.raises(SystemExit) as leaving:
        main.run(["crosscheck", "--quick", "--without", "end_stop", "--without", "dead_band@lift"])
    said = " ".join(capsys.readouterr().out.split())
    assert leaving.value.code == 1 and given["without"] == ["end_stop", "dead_band@lift"]
    assert "not run" in said and "too stiff" in said and "agree in all 1 quantities that could be compared" in said
    assert "1 could not be run: end_stop@lift, along 5 s" in said


@pytest.mark.parametrize(("size", "status"), [(1e-12, 0), (1e-3, 1)])
def test_the_command_answers_with_table_json_and_status(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path, size: float, status: int
) -> None:
    lines = [Quantity("s1", "m", 0.0, 0.0, 1e-9, "why"), Quantity("F1", "N", size, size, 1e-9, "why", "z1 = 3°")]
    monkeypatch.setattr(cc, "crosscheck", lambda crane, **options: cc.CrossCheck(crane.name, crane.layout, lines))
    with pytest.raises(SystemExit) as leaving:
        main.run(["crosscheck", "--quick", "--json", str(tmp_path / "x.json"), "--report", str(tmp_path / "report")])
    assert leaving.value.code == status
    said = capsys.readouterr().out
    assert "F1" in said and "z1 = 3°" in said
    assert ("differ in 1 of 2 quantities, first in F1" in said) == bool(status)
    document = json.loads((tmp_path / "x.json").read_text(encoding="utf-8"))
    assert document["ok"] is (status == 0) and document["quantities"]["F1"]["max_abs"] == size
    assert "F1" in (tmp_path / "report" / "report.html").read_text(encoding="utf-8")
