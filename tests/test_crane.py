"""The crane file: round trips, refusals that say the mend, a source for every number."""

from fnmatch import fnmatchcase

import numpy as np
import pytest

from crane_exudyn import Crane, CraneError, parameters
from crane_exudyn.crane import built_in


@pytest.fixture(scope="module")
def crane() -> Crane:
    return Crane.load("patu655")


@pytest.mark.parametrize("name", built_in())
def test_a_written_crane_reads_back_equal_and_the_same_text(name, tmp_path):
    crane = (
        Crane.load(name)
        .with_effect("pressure_compensation@tilt", {"dpc": 7e5})
        .with_history({"added": ["x"], "n": {"a": 1.5}})
    )
    crane.save(tmp_path / "crane.toml")
    again = Crane.load(tmp_path / "crane.toml")
    assert again == crane
    assert again.to_toml() == crane.to_toml()


@pytest.mark.parametrize("name", built_in())
def test_every_number_of_a_built_in_crane_names_its_source(name):
    sources = Crane.load(name).sources
    nameless = [n for n in parameters.NAMES if not any(fnmatchcase(n, pattern) for pattern in sources)]
    assert nameless == []


def test_numbers_are_those_of_the_model_sheet(crane):
    assert crane["valves.lift.flow_coefficient"] == pytest.approx(24e-3 / 60 / np.sqrt(7e5), rel=1e-12)
    assert crane["cylinders.tilt.hose_volume_rod"] == pytest.approx(np.pi / 4 * 0.0127**2 * 2.0, rel=1e-12)
    assert crane.initial.z4 == pytest.approx(np.radians(-40.0), rel=1e-15)
    assert crane.uncertainty["payload.mass"].upper == 400.0
    assert crane.uncertainty["bodies.lift_boom.mass"].std == pytest.approx(0.05 * 143.66)


def test_a_crane_cannot_be_changed_in_place(crane):
    with pytest.raises(TypeError):
        crane.values["payload.mass"] = 3.0
    with pytest.raises(AttributeError):
        crane.name = "other"
    assert crane.with_parameters({"payload.mass": 80.0})["payload.mass"] == 80.0
    assert crane["payload.mass"] == 25.0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"payload.mas": 3.0}, ["payload.mas", "payload.mass"]),
        ({"payload.mass": -3.0}, ["payload.mass", "-3", ">= 0"]),
        ({"cylinders.lift.rod": 0.2}, ["cylinders.lift.rod", "0.2", "bore"]),
        ({"cylinders.tilt.chamber_range": 0.0}, ["chamber_range", "> 0"]),
        ({"supply.pump_pressure": 0.5e5}, ["pump_pressure", "tank"]),
        ({"fluid.oil_bulk_modulus": float("nan")}, ["oil_bulk_modulus", "finite"]),
    ],
)
def test_impossible_values_are_refused_with_field_value_and_limit(crane, change, words):
    with pytest.raises(CraneError) as refusal:
        crane.with_parameters(change)
    assert all(word in str(refusal.value) for word in words)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('mass = "25 kg"', 'mass = "25 m"', ["payload.mass", "25 m", "unit"]),
        ('mass = "25 kg"', 'mas = "25 kg"', ["payload.mas", "payload.mass"]),
        ("[supply]", "[suply]", ["suply", "supply"]),
        ('z1 = "10 deg"', "", ["initial.z1", "missing"]),
        ('"payload.mass" = { lower', '"payload.mas" = { lower', ["payload.mas", "payload.mass"]),
        ('bore = "100 mm"', 'bore = "wide"', ["bore", "wide"]),
        ("[supply]", "[[effect]]\nname = 'dead_bend'\nplace = 'lift'\n[supply]", ["dead_bend", "dead_band"]),
        ("[supply]", "[[effect]]\nname = 'dead_band'\nplace = 'left'\n[supply]", ["left", "lift"]),
        ("[supply]", "[supply", ["TOML"]),
    ],
)
def test_bad_files_get_one_message_with_the_mend(tmp_path, old, new, words):
    from importlib import resources

    text = resources.files("crane_exudyn.data").joinpath("patu655.toml").read_text(encoding="utf-8")
    assert old in text
    path = tmp_path / "bad.toml"
    path.write_text(text.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CraneError) as refusal:
        Crane.load(path)
    assert all(word in str(refusal.value) for word in [*words, "bad.toml"])


def test_an_unknown_crane_is_answered_with_the_nearest():
    with pytest.raises(CraneError, match="patu655"):
        Crane.load("patu65")


def test_an_effect_twice_is_refused(crane):
    from dataclasses import replace

    once = crane.with_effect("pump_droop", {"R": 1e9})
    with pytest.raises(CraneError, match="twice"):
        replace(once, effects=once.effects * 2)


def test_adding_and_removing_is_exact(crane):
    from validation.history import added, removed

    after = crane.with_parameters({"payload.mass": 61.0}).with_effect("dead_band@lift", {"lower": 0.03, "upper": 0.04})
    file = added(crane, after, recording="lift.csv", evidence=12.0)
    assert file.history[-1]["recording"] == "lift.csv"
    assert removed(file, "dead_band@lift") == crane
    assert removed(file, "dead_band@lift").to_toml() == crane.to_toml()
    with pytest.raises(CraneError, match="no effect"):
        removed(crane, "dead_band@lift")
