"""Commands that run the crane: simulate, demo and benchmark, as a user would type them."""

from __future__ import annotations

import contextlib
import io
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from crane_exudyn import Crane, Recording, simulate
from crane_exudyn.simulation import inner_grid
from patu import main
from validation import benchmark, paper
from validation.semi_recursive import SemiRecursiveEngine

FAST = ("--engine", "semi-recursive")


@pytest.fixture
def printed(patu: Callable[..., SimpleNamespace]) -> Callable[..., str]:
    """Run one command line that must succeed, and return what it printed."""

    def call(*words: str) -> str:
        done = patu(*words)
        assert done.status == 0, done.err
        return str(done.out)

    return call


@pytest.fixture(scope="module")
def lift(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A recording of two seconds: at rest at z1 = 15°, z4 = -50°, then lifting; 200 Hz, two angles, p1 and p4."""
    crane = Crane.load("patu655")
    engine = SemiRecursiveEngine(crane)
    time = np.arange(401) * 0.005
    u1 = np.where(time >= 0.5, 0.4, 0.0)
    start = engine.static_start(np.radians(15.0), np.radians(-50.0), 12e5)
    inputs = Recording.from_arrays("lift", time, {"u1": u1, "u2": 0 * time})
    run = simulate(crane, inputs, start=start, engine=engine)
    file = tmp_path_factory.mktemp("lift") / "lift.csv"
    run.recording().select(["u1", "u2", "z1", "z4", "p1", "p4"]).save(file)
    return file


# -- simulate --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("engine", ["exudyn", "semi-recursive"])
def test_simulate_follows_a_recording_on_either_engine(
    printed: Callable[..., str], lift: Path, tmp_path: Path, engine: str
) -> None:
    out = printed(
        "simulate", "--inputs", str(lift), "--start-from-recording", "--engine", engine, "-o", str(tmp_path / "run.csv")
    )
    assert "driven by lift" in out and str(tmp_path / "run.csv") in out
    measured, run = Recording.load(lift), Recording.load(tmp_path / "run.csv")
    np.testing.assert_array_equal(run["z1"].time, measured["z1"].time)
    for name, size in (("z1", 1.0), ("z4", 1.0), ("p1", 1e6), ("p4", 1e6)):
        # same model, same start, same commands: what is left is the difference of two engines' solvers
        np.testing.assert_allclose(run[name].values, measured[name].values, atol=1e-4 * size)
    assert run.has("p2", "p3", "s1", "s2", "z4_abs", "dz1", "u1")
    assert np.ptp(run["z1"].values) > np.radians(5.0)


def test_unmeasured_pressures_follow_from_the_balance(printed: Callable[..., str], lift: Path, tmp_path: Path) -> None:
    """The recording has p1 and p4 only; the less loaded chambers were at 12 bar, not at the crane file's 20 bar."""
    printed("simulate", "--inputs", str(lift), "--start-from-recording", *FAST, "-o", str(tmp_path / "run.csv"))
    run = Recording.load(tmp_path / "run.csv")
    assert run["p2"].values[0] == pytest.approx(12e5, rel=1e-3)
    assert run["p3"].values[0] == pytest.approx(12e5, rel=1e-3)


def test_simulate_starts_as_the_crane_file_says(printed: Callable[..., str], lift: Path) -> None:
    document = json.loads(printed("simulate", "--inputs", str(lift), *FAST, "--json", "-"))
    assert document["channels"]["z1"]["first"] == pytest.approx(np.radians(10.0))
    assert document["channels"]["z4"]["first"] == pytest.approx(np.radians(-40.0))
    assert document["channels"]["p2"]["first"] == pytest.approx(20e5)
    assert document["engine"] == "semi-recursive" and document["instants"] == 401


def test_simulate_fills_what_lies_between_corners_of_commands(printed: Callable[..., str], tmp_path: Path) -> None:
    corners, result = tmp_path / "corners.csv", tmp_path / "run.csv"
    corners.write_text("time[s],u1,u2\n0,0,0\n0.05,0,0\n0.5,0.1,0\n2,0.1,0\n", encoding="utf-8")
    told = printed("simulate", "--inputs", str(corners), *FAST, "-o", str(result))
    run = Recording.load(result)["z1"]
    assert len(run) == 2 + 45 + 150 and np.diff(run.time)[1:] == pytest.approx(0.01)
    assert run.values[-1] > run.values[60] > run.values[0] and "depend on the step" not in told


def test_simulate_without_inputs_is_the_papers_cycle(printed: Callable[..., str], tmp_path: Path) -> None:
    printed("simulate", *FAST, "-o", str(tmp_path / "cycle.parquet"))
    run = Recording.load(tmp_path / "cycle.parquet")
    time, commands = run.commands()
    assert (time[0], time[-1]) == (0.0, 25.0)
    for at, expected in ((1.0, (0, 0)), (3.0, (0.5, 0)), (8.0, (0, 0.35)), (13.0, (0, -0.35)), (20.0, (-0.5, 0))):
        np.testing.assert_array_equal(commands[round(at * 1000)], expected)


def test_measured_supply_pressure_drives_the_model(lift: Path) -> None:
    """Half the pump pressure: the boom lifts more slowly, and the pressure is among the channels of the run."""
    crane = Crane.load("patu655")
    engine = SemiRecursiveEngine(crane)
    inputs = Recording.load(lift).select(["u1", "u2"])
    time = inputs["u1"].time
    supply = Recording.from_arrays("pp", time, {"pp": np.full(len(time), 70e5)})
    weak = simulate(crane, Recording("weak", {**inputs.channels, **supply.channels}), engine=engine)
    strong = simulate(crane, inputs, engine=engine)
    assert weak["z1"][-1] < strong["z1"][-1]
    assert weak["pp"].tolist() == [70e5] * len(time)
    assert "pp" not in strong.channels()


def test_the_inner_grid_keeps_every_instant() -> None:
    time = np.array([0.0, 0.0025, 0.003, 0.01])
    grid, rows = inner_grid(time, 1e-3)
    np.testing.assert_allclose(grid[rows], time, atol=1e-15)
    assert np.diff(grid).max() <= 1e-3 * (1 + 1e-9)
    assert len(grid) == 1 + 3 + 1 + 7


@pytest.mark.parametrize(
    ("words", "part"),
    [(("--start-from-recording",), "--inputs"), (("--step", "0"), "--step 0"), (("--engine", "other"), "other")],
)
def test_options_that_make_no_sense_are_refused(
    capsys: pytest.CaptureFixture[str], words: tuple[str, ...], part: str
) -> None:
    with pytest.raises(SystemExit) as leaving:
        main.run(["simulate", *words])
    assert leaving.value.code == 2
    assert part in capsys.readouterr().err


# -- estimate --------------------------------------------------------------------------------------------------------


def test_estimate_leaves_states_picture_and_report(printed: Callable[..., str], lift: Path, tmp_path: Path) -> None:
    paths = {"-o": tmp_path / "states.parquet", "--plot": tmp_path / "states.png", "--report": tmp_path / "report"}
    words = [part for option, path in paths.items() for part in (option, str(path))]
    out = printed("estimate", str(lift), *FAST, *words, "--json", str(tmp_path / "estimate.json"))
    document = json.loads((tmp_path / "estimate.json").read_text())
    assert set(document["filter"]) >= {"nis_mean", "nis_bounds", "whiteness", "consistent"}
    estimated, measured = Recording.load(paths["-o"], {"u1": "U_lift", "u2": "U_tilt"}), Recording.load(lift)
    assert np.ptp(measured["z1"].values - estimated["z1"].values) < np.radians(0.1)
    assert paths["--plot"].read_bytes().startswith(b"\x89PNG")
    page = (paths["--report"] / "report.html").read_text()
    assert "Estimate of lift" in page and "whiteness" in page
    assert "NIS" in out and str(paths["--report"] / "report.html") in out


@pytest.mark.parametrize(
    ("words", "part"),
    [
        (("-o", "{folder}/x.xlsx"), ".parquet"),
        (("--plot", "{folder}/x.bmp"), ".png"),
        (("-o", "{folder}/no/x.csv"), "folder"),
    ],
)
def test_estimate_refuses_results_that_it_could_not_write_before_it_works(
    capsys: pytest.CaptureFixture[str], lift: Path, tmp_path: Path, words: tuple[str, str], part: str
) -> None:
    with pytest.raises(SystemExit) as leaving:
        main.run(["estimate", str(lift), words[0], words[1].format(folder=tmp_path)])
    assert leaving.value.code == 2
    assert part in capsys.readouterr().err


def test_steps_without_number_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        main.run(["simulate", *FAST, "--step", "1e-9"])
    assert leaving.value.code == 2
    assert "2.5e+10 steps" in capsys.readouterr().err


# -- demo ------------------------------------------------------------------------------------------------------------


class Shown(NamedTuple):
    """What `patu demo` leaves: its text, its JSON, its folder, and the filter's cases by tuning."""

    out: str
    document: dict[str, Any]
    folder: Path
    cases: dict[str, paper.Case]


@pytest.fixture(scope="module")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    """Run `patu demo` once."""
    folder, usual, cases = tmp_path_factory.mktemp("a") / "demo", paper.run_case, {}

    def kept(*given: Any, tuning: str, **more: Any) -> paper.Case:
        cases[tuning] = usual(*given, tuning=tuning, **more)
        return cases[tuning]

    with (
        pytest.MonkeyPatch.context() as patch,
        contextlib.redirect_stdout(io.StringIO()) as out,
        pytest.raises(SystemExit) as leaving,
    ):
        patch.setattr(paper, "run_case", kept)
        main.run(["demo", "-o", str(folder), *FAST, "--json", str(folder.parent / "demo.json")])
    assert leaving.value.code in (None, 0), out.getvalue()
    return Shown(out.getvalue(), json.loads((folder.parent / "demo.json").read_text()), folder, cases)


def test_demo_follows_finds_improves_and_draws_on_one_page(shown: Shown) -> None:
    own, papers = shown.document["cases"]
    assert (own["model_error"], own["inputs"], own["tuning"], papers["tuning"]) == (0.15, 1, "own", "paper")
    for state, published in own["published"].items():
        assert own["pn_rmse"][state] <= published
        assert papers["pn_rmse"][state] < papers["pn_rmse_open_loop"][state]  # a filter is worth having, state by state
    found = shown.document["diagnose"]
    assert (found["verdict"], found["effects"]) == ("effect", ["internal_leakage@lift"])
    assert found["check_error_before"] > 5.0 and found["check_error_after"] < 1.1
    given, better = shown.document["improve"]["steps"]
    assert (given["added"], better["added"]) == (None, "internal_leakage@lift")
    assert better["error"] < 1.1 < 5.0 < given["error"] and better["check_error"] < 1.1  # on the Exudyn engine
    files = {p.name: p for p in shown.folder.iterdir()}
    pictures = {"filter.png", "before_after.png", "error.png", "crane.png"}
    assert set(files) == pictures | {"improved.toml", "report.html"}
    assert all(files[name].read_bytes().startswith(b"\x89PNG") for name in pictures)
    assert all(f'href="{name}"' in files["report.html"].read_text() for name in pictures)
    assert Crane.load(files["improved.toml"]).effect("internal_leakage@lift") is not None
    assert "+ internal_leakage@lift: error 0." in shown.out or "+ internal_leakage@lift: error 1." in shown.out
    assert "— only noise is left." in shown.out
    last = shown.out.splitlines()[-2:]
    assert "Internal leakage (lift), 2.4" in last[0] and "is missing (`internal_leakage@lift`)" in last[0]
    assert last[1] == f"Report: {files['report.html']}"


def test_published_goal_is_reached_by_the_estimators_own_means(shown: Shown) -> None:
    """Every state at or below the published error and inside its 95 % interval at least 90 % of the time; payload to 5
    %.
    """
    case = shown.cases["own"]
    assert case.published == paper.PUBLISHED
    for state, published in paper.PUBLISHED.items():
        assert case.pn_rmse[state] <= published, state
        assert case.coverage[state] >= 0.9, state
        assert case.pn_rmse[state] < 0.2 * case.pn_rmse_open_loop[state]
    assert case.estimate["payload.mass"][-1] == pytest.approx(25.0, rel=0.05)
    assert case.estimate["supply.pump_pressure"][-1] == pytest.approx(100e5, rel=0.002)
    assert case.estimate.consistent
    assert 2.0 < case.nees_mean < 16.0  # about half and twice the 8 expected; instants of one run are not independent


# -- benchmark -------------------------------------------------------------------------------------------------------


def test_benchmark_json_has_ratios_of_one_run(printed: Callable[..., str]) -> None:
    document = json.loads(printed("benchmark", "--only", "open_loop", "--only", "memory", "--json", "-"))
    assert document["real_time"] == {"value": 25.0, "unit": "s", "ratio_to": None, "ratio": None}
    for entry in document.values():
        if entry["ratio_to"]:
            assert entry["ratio"] == pytest.approx(entry["value"] / document[entry["ratio_to"]]["value"])
    assert document["open_loop.semi_recursive"]["ratio_to"] == "open_loop.exudyn"
    assert document["memory.process"]["value"] > 10.0


@pytest.mark.parametrize("machine", ["patu655", "excavator"])
def test_the_split_of_a_step_adds_up_and_leaves_no_clock_behind(machine: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from crane_exudyn import engine as module

    monkeypatch.setattr(benchmark, "STRETCH", 0.05)
    monkeypatch.setattr(benchmark, "NAIVE_STRETCH", 0.003)
    before = (module.trapezoidal.predict, module.System.residual)
    results = benchmark.run(["filters"], Crane.load(machine))
    assert (module.trapezoidal.predict, module.System.residual) == before
    exudyn, quick = ("restore", "exudyn_residual", "newton", "filter_algebra"), ("engine", "filter_algebra")
    for step, names in (("filter.exudyn.step", exudyn), ("filter.semi_recursive.step", quick)):
        parts = [results.measures[f"{step}.{p}"].value for p in names]
        assert min(parts) > 0.0
        assert sum(parts) == pytest.approx(results.measures[step].value)
    assert results.measures["filter.naive.realtime_factor"].value > 0.0


def test_an_unknown_benchmark_is_refused(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as leaving:
        main.run(["benchmark", "--only", "open_lop"])
    assert leaving.value.code == 2
    assert '"open_loop"' in capsys.readouterr().err
