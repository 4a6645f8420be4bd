"""The examples run as a user runs them, stay short, and give what they promise."""

from __future__ import annotations

import csv
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn import Crane, Recording, simulate
from validation.semi_recursive import SemiRecursiveEngine

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))
NOISE = {"z1": 2e-3, "z4": 2e-3, "p1": 5e4, "p2": 5e4, "p3": 5e4, "p4": 5e4}


def example(name: str, *words: object) -> str:
    """Return what an example prints; warnings about what is deprecated count as errors."""
    path = next(p for p in EXAMPLES if p.name == name)
    command = [sys.executable, "-W", "error::DeprecationWarning", str(path), *map(str, words)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.fixture(scope="module")
def leaking(tmp_path_factory):
    """Return a folder with two short recordings of a crane whose lift cylinder leaks."""
    folder = tmp_path_factory.mktemp("recordings")
    crane = Crane.load("patu655").with_effect("internal_leakage@lift", {"k": 2e-11})
    time = np.arange(0.0, 2.6, 0.01)
    for name, level, seed in (("one", 0.4, 1), ("two", 0.3, 2)):
        commands = {"u1": level * ((time > 0.5) & (time < 1.4)), "u2": -level * ((time > 1.6) & (time < 2.3))}
        run = simulate(crane, Recording.from_arrays("c", time, commands), engine=SemiRecursiveEngine(crane), step=2e-3)
        random = np.random.default_rng(seed)
        seen = {c: run[c] + random.normal(0.0, std, time.size) for c, std in NOISE.items()}
        Recording.from_arrays(name, time, commands | seen).save(folder / f"{name}.csv")
    return folder


@pytest.mark.parametrize("path", EXAMPLES, ids=lambda p: p.name)
def test_an_example_is_short(path):
    assert len(path.read_text().splitlines()) <= 45


def test_samples_come_from_a_socket_and_odd_ones_are_left_out():
    said = example("from_a_socket.py")
    assert "648 lines, 12 no sample, 48 samples left out; latency" in said and "p2 2.5" in said.splitlines()[-2]


def test_a_leak_that_opens_is_found():
    said = example("models_side_by_side.py", 1)
    late = float(said.partition("found ")[2].partition(" s later")[0])
    assert 0.0 < late < 1.0 and "1 of 1 found, false alarms: 0\n" in said
    assert said.splitlines()[-1] == f"  100 % of the leaks were found within {late:6.3f} s"


def test_own_objects_act_on_the_crane(tmp_path):
    said = example("own_model.py", tmp_path)
    force, before, after = (
        float(w) for w in said.replace(".\n", "\n").split() if w.replace(".", "").isdigit() and w != "1.5"
    )
    assert force > 1000.0 and before == 20.0 and 20.5 < after < 25.0  # without the rope it would be 28.9 deg
    assert (tmp_path / "rope.png").read_bytes().startswith(b"\x89PNG")


def test_debugging_names_the_cylinder_that_leaks(leaking, tmp_path):
    said = example("debug_prediction.py", leaking / "one.csv", tmp_path)
    errors = {line.split()[0]: float(line.split()[2]) for line in said.splitlines()}
    assert max(errors, key=errors.__getitem__) in ("p1", "p2") and errors["p1"] > 10.0 > errors["z4"]
    assert {p.name for p in tmp_path.iterdir()} == {"channels.png", "scene.png", "film.gif"}


@pytest.mark.parametrize("name", ["debug_prediction.py", "cross_validate.py"])
def test_an_example_without_its_argument_says_what_it_wants(name):
    path = next(p for p in EXAMPLES if p.name == name)
    done = subprocess.run([sys.executable, str(path)], capture_output=True, text=True, check=False)
    assert done.returncode == 1 and f"python examples/{name}" in done.stderr and "Traceback" not in done.stderr


def test_cross_validation_prefers_the_effect_that_is_there(leaking):
    example("cross_validate.py", leaking, "internal_leakage@lift")
    with open(leaking / "cross_validation.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [r["model"] for r in rows] == ["internal_leakage@lift"] * 2 + ["nominal model"] * 2
    held_out = [float(r["error on the others"]) for r in rows]
    assert max(held_out[:2]) < 1.3 and min(held_out[2:]) > 3.0
