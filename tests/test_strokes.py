"""Runs that a stroke's end cuts short, and levers that are let go before it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, Recording, simulate
from crane_exudyn.drive import inputs_on, with_steps
from crane_exudyn.geometry import loop_bends
from crane_exudyn.inputs import paper_cycle
from crane_exudyn.simulation import initial_state, simulate_while_possible
from crane_exudyn.strokes import positions_in_strokes, run_while_possible, within_strokes
from patu import main
from validation.semi_recursive import SemiRecursiveEngine

CRANE = Crane.load("patu655")


def with_stroke(cylinder: str, share: float) -> Crane:
    """Return the crane with a cylinder that has less stroke, and the same pose at its start."""
    stroke = f"cylinders.{cylinder}.chamber_range"
    return CRANE.with_parameters({stroke: share * CRANE[stroke]})


SHORT = with_stroke("lift", 0.7)
TIME = np.arange(5001) * 1e-3
TIME_OF_CYCLE = np.arange(25001) * 1e-3


@pytest.fixture
def to_the_end(tmp_path: Path) -> Path:
    """A recording whose commands drive the short crane's lift cylinder to its end."""
    path = tmp_path / "hard.csv"
    u1 = 0.8 * (TIME > 0.5)
    lines = ["time[s],u1,u2", *(f"{t:.3f},{u},0" for t, u in zip(TIME[::5], u1[::5], strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_the_cycle_is_the_papers_where_no_end_is_reached() -> None:
    run = simulate(CRANE, engine="semi-recursive")
    assert np.array_equal(run.commands, paper_cycle(run.time))


@pytest.mark.parametrize("start", [None, "near its end"])
def test_the_cycle_lets_go_of_the_lever_before_the_end(start: str | None) -> None:
    crane = with_stroke("lift", 0.6) if start else SHORT
    runs = [simulate(crane, engine=name) for name in ("semi-recursive", "exudyn")]
    assert np.array_equal(runs[0].commands, runs[1].commands)  # whichever engine runs it
    given, driven = paper_cycle(runs[0].time), runs[0].commands
    let_go = np.flatnonzero((given != driven).any(axis=1))
    assert not driven[let_go, 0].any() and np.array_equal(given[:, 1], driven[:, 1])
    assert (driven[:, 0] > 0.0).any() and (driven[:, 0] < 0.0).any()
    for run in runs:
        assert len(run.time) == 25001 and positions_in_strokes(crane, run.states).max() < 1.0


def test_levers_of_any_commands_are_let_go_on_both_ways_again_and_again() -> None:
    crane = with_stroke("tilt", 0.8)
    time = np.arange(12001) * 1e-3
    given = np.column_stack([0.0 * time, 0.9 * np.sign(np.sin(time * 2.0 * np.pi / 6.0))])
    engine = SemiRecursiveEngine(crane)
    fitted = within_strokes(crane, time, given, initial_state(crane, engine))
    assert fitted is not None
    run = engine.simulate(initial_state(crane, engine), time, inputs_on(crane, time, *with_steps(time, fitted)))
    place = positions_in_strokes(crane, run)[:, 1]
    assert 0.0 < place.min() < 0.25 and 0.75 < place.max() < 1.0
    assert set(np.unique(fitted[:, 1])) == {-0.9, 0.0, 0.9}


def test_levers_are_let_go_before_a_loop_locks() -> None:
    loader = Crane.load(Path(__file__).parent / "machines" / "z_loader.toml")
    engine = SemiRecursiveEngine(loader)
    cycle, start = paper_cycle(TIME_OF_CYCLE), initial_state(loader, engine)
    w = inputs_on(loader, TIME_OF_CYCLE, *with_steps(TIME_OF_CYCLE, cycle))
    states, ended = run_while_possible(engine, start, TIME_OF_CYCLE, w, 1e-3)
    assert "The loop E-R-S-T is at its limit: rocker and link are in line" in str(ended)
    assert np.degrees(loop_bends(loader, states[-1:, loader.layout.positions])) < 3.0
    run = simulate(loader, engine="semi-recursive")
    assert len(run.time) == 25001
    assert np.degrees(loop_bends(loader, run.states[:, loader.layout.positions])).min() > 3.0


def test_no_commands_help_where_the_run_ends_for_another_reason(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(self: SemiRecursiveEngine, *_: object, **__: object) -> None:
        raise CraneError("too stiff")

    monkeypatch.setattr(SemiRecursiveEngine, "simulate", refuse)
    start = initial_state(CRANE, SemiRecursiveEngine(CRANE))
    assert within_strokes(CRANE, TIME, paper_cycle(TIME), start) is None
    with pytest.raises(CraneError, match="too stiff"):
        simulate(CRANE, engine="semi-recursive")


def test_a_run_goes_on_to_the_last_sample_before_its_end() -> None:
    engine = SemiRecursiveEngine(SHORT)
    x0, w = (
        initial_state(SHORT, engine),
        inputs_on(SHORT, TIME, *with_steps(TIME, np.column_stack([0.8 * (TIME > 0.5), 0.0 * TIME]))),
    )
    states, ended = run_while_possible(engine, x0, TIME, w, 1e-3)
    assert ended is not None and "end of its stroke" in str(ended)
    k = len(states)
    assert 512 < k < len(TIME) and 0.99 < positions_in_strokes(SHORT, states)[-1, 0] <= 1.0
    with pytest.raises(CraneError):
        engine.simulate(x0, TIME[: k + 1], w[: k + 1])
    whole = engine.simulate(x0, TIME[:k], w[:k])
    assert np.abs(states - whole)[:, :2].max() < 1e-8
    assert np.array_equal(run_while_possible(engine, x0, TIME[:k], w[:k], 1e-3)[0], whole)


def test_a_run_that_cannot_begin_is_no_run(to_the_end: Path) -> None:
    recording = Recording.load(to_the_end, layout=SHORT.layout)
    run, ended = simulate_while_possible(SHORT, recording, engine="semi-recursive")
    assert ended is not None and run.time[-1] < 4.0
    beyond = run.states[-1].copy()
    beyond[SHORT.layout.positions] += 0.3
    with pytest.raises(CraneError):
        simulate_while_possible(SHORT, recording, start=beyond, engine="semi-recursive")


def patu(*words: object) -> int:
    with pytest.raises(SystemExit) as leaving:
        main.run([str(w) for w in words])
    assert isinstance(leaving.value.code, int)
    return leaving.value.code


@pytest.mark.parametrize("engine", ["semi-recursive", "exudyn"])
def test_the_command_writes_a_run_as_far_as_it_went(
    engine: str, to_the_end: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    SHORT.save(tmp_path / "short.toml")
    result, document = tmp_path / "run.csv", tmp_path / "run.json"
    words = ["simulate", "--crane", tmp_path / "short.toml", "--engine", engine, "--inputs", to_the_end]
    assert patu(*words, "-o", result, "--json", document) == 2
    said = capsys.readouterr().err
    run = Recording.load(result, layout=SHORT.layout)
    assert "stroke" in said and f"went to t = {run.end:g} s; {result} contains it" in said
    assert run.end > 1.0 and set(run.sensors) == set(SHORT.layout.sensors)
    assert json.loads(document.read_text(encoding="utf-8"))["ended"]
    assert patu(*words) == 2
    assert "-o FILE writes it" in capsys.readouterr().err


def test_the_command_tells_which_lever_was_let_go(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    SHORT.save(tmp_path / "short.toml")
    words = ["--engine", "semi-recursive", "--json", tmp_path / "run.json"]
    assert patu("simulate", "--crane", tmp_path / "short.toml", *words) == 0
    assert "working cycle, lift released before the end of travel" in capsys.readouterr().out
    assert json.loads((tmp_path / "run.json").read_text(encoding="utf-8"))["ended"] is None
