"""`patu estimate`, `patu paper` and `patu montecarlo` as they are typed."""

from __future__ import annotations

import json
import re
from pathlib import Path
from types import SimpleNamespace
from typing import get_args

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.inputs import SpoolPath
from patu.main import run
from ukf import estimate, tuning
from validation.semi_recursive import SemiRecursiveEngine


def call(capsys, *words):
    """Return exit status, standard output and standard error of a command."""
    with pytest.raises(SystemExit) as leaving:
        run(list(words))
    said = capsys.readouterr()
    return leaving.value.code or 0, said.out, said.err


@pytest.fixture(scope="module")
def lift(tmp_path_factory):
    """A recording at 100 Hz whose p4 jumps by 50 bar for a while, and which repeats a stamp."""
    crane = Crane.load("patu655")
    time = np.arange(0, 2.001, 0.01)
    commands = np.zeros((time.size, 2))
    commands[50:120, 0] = 0.4
    engine = SemiRecursiveEngine(crane)
    w = np.column_stack([SpoolPath(crane).run(time, commands), np.full((time.size, 2), np.nan)])
    states = engine.simulate(engine.static_start(0.2, -0.75), time, w)
    rng = np.random.default_rng(4)
    columns = [time, commands[:, 0], commands[:, 1]]
    columns += [np.degrees(states[:, i]) + 0.05 * rng.normal(size=time.size) for i in (0, 1)]
    columns += [states[:, i] / 1e5 + 0.3 * rng.normal(size=time.size) for i in (4, 7)]
    columns[-1][100:150] += 50.0
    rows = [",".join(f"{v:.6f}" for v in row) for row in np.column_stack(columns)]
    rows.insert(31, rows[30])
    file = tmp_path_factory.mktemp("recording") / "lift.csv"
    file.write_text("\n".join(["time[s],u1[-],u2[-],z1[deg],z4[deg],p1[bar],p4[bar]", *rows]) + "\n")
    return file


def test_estimate_writes_table_picture_and_json(lift, tmp_path, capsys):
    out, picture, document = tmp_path / "out.csv", tmp_path / "out.png", tmp_path / "out.json"
    status, said, _ = call(
        capsys, "estimate", str(lift), "-o", str(out), "--plot", str(picture), "--json", str(document), "--smooth",
        "--engine", "semi-recursive", "--augment", "payload.mass", "--model-error", "off",
    )  # fmt: skip
    assert status == 0
    assert "payload.mass / kg" in said and "p4: jumped" in said and "with a repeated time" in said
    table = np.genfromtxt(out, delimiter=",", names=True, deletechars="")
    assert table.size == 201 and {"p2[Pa]", "p2_low95[Pa]", "innovation_z1[rad]"} <= set(table.dtype.names)
    assert {"U_lift[-]", "nis[-]"} <= set(table.dtype.names)  # as recordings and runs write pure numbers
    assert picture.read_bytes().startswith(b"\x89PNG")
    result = json.loads(document.read_text())
    assert result["used"]["p4"] < result["used"]["p1"] == 200
    assert set(result["filter"]) >= {"nis_mean", "nis_bounds", "whiteness", "consistent"}


def test_estimate_with_some_sensors_on_standard_output(lift, capsys):
    status, said, _ = call(
        capsys, "estimate", str(lift), "--sensors", "z1", "z4", "--engine", "semi-recursive", "--json", "-"
    )
    assert status == 0
    assert list(json.loads(said)["used"]) == ["z1", "z4"]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--sensors", "p2"), "no such sensor"),
        (("--method", "kalman"), "no filter"),
        (("--augment", "payload.mas"), "payload.mass"),
        (("--plot", "picture.gif"), "unknown ending"),
        (("-o", "no/folder/out.csv"), "no/folder"),
        (("--step", "0"), "not a positive time"),
        (("--model-error", "onn"), "model error 'onn'"),
        (("--smooth", "--models", "patu655", "patu655-lab"), "exclude each other"),
        (("--models", "patu655"), "Only one model"),
    ],
)
def test_estimate_refuses_what_cannot_work_before_the_search_for_a_noise(lift, capsys, monkeypatch, words, message):
    monkeypatch.setattr(tuning, "scale", lambda *a, **k: pytest.fail("the noise was searched for"))
    status, _, said = call(capsys, "estimate", str(lift), "--engine", "semi-recursive", *words)
    assert status == 2 and message in said


def test_estimate_refuses_a_typing_error_before_the_recording_is_read(capsys):
    for words, message in ((("--method", "kalman"), "no filter"), (("--augment", "payload.mas"), "payload.mass")):
        status, _, said = call(capsys, "estimate", "nowhere.csv", *words)
        assert status == 2 and message in said


def test_every_judgement_has_a_sentence():
    from patu.estimate import VERDICTS

    assert tuple(VERDICTS) == get_args(estimate.Consistency)
    page = (Path(__file__).parent.parent / "docs" / "estimator.md").read_text()
    assert [s for s in VERDICTS.values() if re.split(r"[,{]|\. ", s)[0] not in page] == []


def test_paper_says_of_every_gauge_what_its_own_noise_leaves():
    from patu.paper import _why
    from validation import paper

    def said(**sensors):
        experiment = SimpleNamespace(sensors=sensors, truth=np.linspace([0.0] * 8, [20e5] * 8, 5))
        return _why(SimpleNamespace(experiment=experiment))

    [line] = said(z1=0.01, p1=1.5e5, p3=0.15e5)
    low, high = (paper.pressure_floor(std) / 1e5 for std in (0.15e5, 1.5e5))
    assert f"{high:.2f} bar in p1 ({5 * high:.2f} % of its range), {low:.2f} bar in p3" in line
    assert said(z1=0.01, s1=1e-3) == []


def test_paper_expects_as_much_of_nis_as_there_are_sensors():
    from patu.paper import Found, _seen

    seen, shown = _seen(["z1", "z4", "p1"], ["p1=0.15[bar]"], Crane.load("patu655"))
    assert seen == {"sensors": ("z1", "z4", "p1"), "noise": {"p1": 15000.0}} and "p1 ± 0.15 bar" in shown["p1"]
    case = {"model_error": 0.15, "inputs": 1, "tuning": "paper", "coverage95": {}, "nees_mean": 8.0, "nis_mean": 3.0}
    cases = SimpleNamespace(documents=[case | {"published": None, "pn_rmse": {}, "rmse": {}, "pn_rmse_open_loop": {}}])
    titles = [title for title, _, _ in Found(cases, [], [], shown).tables()]
    assert "NIS (3 expected)" in titles[1]


def test_paper_writes_figures_and_the_json_of_the_contract(tmp_path, capsys, monkeypatch):
    from validation import paper

    monkeypatch.setattr(paper, "likeliest_width", lambda *given: 1.0)  # how it is chosen: tests/test_paper.py
    monkeypatch.setattr(paper, "DURATION", 1.5)
    original = paper.real_system
    monkeypatch.setattr(paper, "real_system", lambda *a, **k: original(*a, **(k | {"duration": 1.5})))
    document = tmp_path / "paper.json"
    status, said, _ = call(
        capsys, "paper", "--error", "0.15", "--inputs", "1", "--engine", "semi-recursive", "-o", str(tmp_path),
        "--json",
        str(document),
    )  # fmt: skip
    assert status == 0 and "published" in said and "own tuning" in said
    assert {p.name for p in tmp_path.glob("*.png")} == {f"figure{n}_{t}.png" for n in (5, 6, 7) for t in paper.ROWS}
    cases = json.loads(document.read_text())["cases"]
    assert [c["tuning"] for c in cases] == list(paper.ROWS)
    assert cases[0]["published"]["z1"] == 0.33 and set(cases[0]["coverage95"]) == set(paper.STATES)


@pytest.mark.parametrize("words", [("--error", "15"), ("--inputs", "4"), ("--tuning", "mine")])
def test_paper_refuses_cases_that_do_not_exist(tmp_path, capsys, words):
    status, _, said = call(capsys, "paper", "-o", str(tmp_path), *words)
    assert status == 2 and words[1] in said


def test_montecarlo_says_yes_and_no_by_its_exit_status(tmp_path, capsys):
    short = ("--runs", "3", "--duration", "0.8", "--step", "0.008", "--inputs", "2")
    status, said, _ = call(capsys, "montecarlo", *short, "-o", str(tmp_path / "runs.jsonl"))
    assert status == 0 and "Consistent." in said
    assert len((tmp_path / "runs.jsonl").read_text().splitlines()) == 4
    status, said, _ = call(capsys, "montecarlo", *short, "--error", "0.25", "--json", "-")
    assert status == 1 and json.loads(said)["consistent"] is False


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--runs", "0"), "--runs 0"),
        (("--inputs", "9"), "no input set 9"),
        (("--step", "0"), "--step 0"),
        (("--error", "2"), "A model error of 2"),
        (("--method", "kf"), "no filter 'kf'"),
    ],
)
def test_montecarlo_refuses_what_cannot_work(capsys, words, message):
    status, _, said = call(capsys, "montecarlo", *words)
    assert status == 2 and message in said
