"""Every command on every built-in machine: two recordings with a hidden effect are made, and a user finds it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

from crane_exudyn import Crane, Recording
from validation.hidden_machines import OPENING, noise_of, recorded, to_and_fro


class Hidden(NamedTuple):
    """A machine's secret: the effect with its parameters (SI); the largest command; for how many s it is recorded."""

    effect: str
    parameters: Mapping[str, float]
    opening: float = OPENING
    seconds: float = 3.9


SECRETS = {
    "loader": Hidden("external_leakage@p1", {"k": 4e-12}),
    "patu655-lab": Hidden("internal_leakage@tilt", {"k": 4e-12}, 0.2, 6.0),
    "patu655-telescope": Hidden("internal_leakage@extension", {"k": 4e-12}),
    "excavator": Hidden("dead_band@bucket", {"lower": 0.04, "upper": 0.07}, seconds=4.4),
}


class Case(NamedTuple):
    """A machine's name, its secret, its true crane file, and recordings to learn from and to check with."""

    machine: str
    secret: Hidden
    true: str
    learn: str
    check: str


@pytest.fixture(scope="module", params=SECRETS)
def case(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Two recordings of a machine with an effect that its crane file lacks."""
    machine: str = request.param
    secret, folder = SECRETS[machine], tmp_path_factory.mktemp(machine)
    crane = Crane.load(machine).with_effect(secret.effect, secret.parameters)
    true, *files = (str(folder / name) for name in ("true.toml", "learn.csv", "check.csv"))
    crane.save(true)
    for seed, file in enumerate(files):
        rng = np.random.default_rng(20261123 + seed)
        commands = to_and_fro(rng, len(crane.layout.cylinders), secret.seconds, secret.opening)
        recorded(f"seed {seed}", crane, commands, rng).save(file)
    return Case(machine, secret, true, *files)


@pytest.fixture
def answered(patu: Callable[..., SimpleNamespace], tmp_path: Path) -> Callable[..., dict]:
    """Run one command line and return its JSON."""

    def call(*words: str) -> dict:
        file = tmp_path / "answer.json"
        done = patu(*words, "--json", str(file))
        assert done.status == 0, done.err
        return json.loads(file.read_text())

    return call


def test_a_recording_of_a_machine_passes_the_check(case: Case, answered: Callable[..., dict]) -> None:
    found = answered("check", case.learn, "--crane", case.machine)["findings"]
    assert not [f for f in found if f["severity"] == "error"]


def test_the_true_machine_shows_what_was_recorded(case: Case, answered: Callable[..., dict], tmp_path: Path) -> None:
    file = tmp_path / "run.csv"
    answered("simulate", "--inputs", case.learn, "--crane", case.true, "--engine", "semi-recursive", "-o", str(file))
    crane = Crane.load(case.machine)
    layout = crane.layout
    run, measured = (Recording.load(f, layout=layout) for f in (file, case.learn))
    for name in (*layout.coordinates, *layout.chambers):
        left = run[name].values - measured[name].values
        assert np.sqrt(np.mean(left**2)) < 1.2 * noise_of(crane)[name], name


def test_the_filter_of_a_machine_finds_pressures_that_it_is_not_shown(
    case: Case, answered: Callable[..., dict], tmp_path: Path
) -> None:
    crane, file = Crane.load(case.machine), tmp_path / "states.csv"
    layout = crane.layout
    words = ["--sensors", *layout.coordinates, *layout.chambers[::2]]
    answered("estimate", case.learn, "--crane", case.true, "--engine", "semi-recursive", *words, "-o", str(file))
    header = file.read_text().partition("\n")[0].split(",")
    states = dict(zip(header, np.genfromtxt(file, delimiter=",", skip_header=1).T, strict=True))
    measured = Recording.load(case.learn, layout=layout)
    for name in layout.chambers[1::2]:
        found = np.interp(measured[name].time, states["time[s]"], states[f"{name}[Pa]"])
        left = found - measured[name].values
        assert np.sqrt(np.mean(left[measured[name].time > 1.0] ** 2)) < 1.2 * noise_of(crane)[name], name


def test_a_comparison_sees_that_the_model_fails(case: Case, answered: Callable[..., dict]) -> None:
    found = answered("compare", case.learn, "--crane", case.machine)
    errors = [c["error_over_noise"] for c in found["channels"].values()]
    assert np.sqrt(np.mean(np.square(errors))) > 2.0
    assert found["where"]


@pytest.mark.parametrize("case", ["excavator"], indirect=True)
def test_what_is_missing_is_found_and_added_and_the_error_falls(
    case: Case, answered: Callable[..., dict], tmp_path: Path
) -> None:
    file = tmp_path / "new.toml"
    answer = answered("improve", case.learn, "--check", case.check, "--crane", case.machine, "-j", "1", "-o", str(file))
    given, better = answer["steps"]
    assert (given["added"], given["verdict"], better["added"]) == (None, "effect", case.secret.effect)
    assert better["error"] < 1.1 < 2.0 < given["error"]
    assert better["check_error"] < 1.3 < given["check_error"]
    found = Crane.load(file).effect(case.secret.effect)
    assert found is not None
    for name, value in case.secret.parameters.items():
        assert found.parameters[name] == pytest.approx(value, rel=0.1)


@pytest.mark.parametrize("case", ["loader", "patu655-lab", "patu655-telescope"], indirect=True)
def test_a_diagnosis_names_what_is_missing(case: Case, answered: Callable[..., dict]) -> None:
    """The excavator's diagnosis is what `improve` begins with, above."""
    answer = answered("diagnose", case.learn, "--check", case.check, "--crane", case.machine, "-j", "1")
    assert (answer["verdict"], answer["effects"]) == ("effect", [case.secret.effect])
    assert answer["error_after"] < 1.1 < 2.0 < answer["error_before"]
    assert answer["check_error_after"] < 1.3 < answer["check_error_before"]
    for name, value in case.secret.parameters.items():
        assert answer["candidates"][0]["parameters"][name]["value"] == pytest.approx(value, rel=0.1)
