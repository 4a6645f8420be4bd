"""Map files: what a logger's columns are, and one message for what is wrong in one."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.errors import CraneError
from crane_exudyn.mapping import Column, keys_of, load_map, map_text
from crane_exudyn.recording import Recording

LAYOUT = Crane.load("patu655").layout
LOGGED = "Zeit;Boom;Arm[rad];V1\n0,0;1;2;10\n0,1;2;3;20\n0,2;4;3;20\n"
MAP = """[time]
column = "Zeit"
unit = "s"
[z1]
column = "Boom"
unit = "deg"
sign = -1
offset = "2 deg"
[z4]
column = "Arm"
unit = "deg"
scale = 0.5
[u1]
column = "V1"
unit = "%"
late = "0.05 s"
drift = 0.5e-3
"""


@pytest.fixture
def logged(tmp_path: Path) -> Path:
    (tmp_path / "log.csv").write_text(LOGGED)
    (tmp_path / "map.toml").write_text(MAP)
    return tmp_path


def test_columns_are_read_as_the_map_file_says(logged: Path) -> None:
    recording = Recording.load(logged / "log.csv", load_map(logged / "map.toml", LAYOUT))
    assert np.degrees(recording["z1"].values) == pytest.approx([1.0, 0.0, -2.0])
    assert np.degrees(recording["z4"].values) == pytest.approx([1.0, 1.5, 1.5])
    assert recording["u1"].values == pytest.approx([0.1, 0.2, 0.2])
    assert recording["u1"].time == pytest.approx([-0.05, 0.04995, 0.1499])
    assert not recording.held


def test_a_map_file_says_that_commands_are_held_and_says_it_of_commands_only(logged: Path) -> None:
    (logged / "map.toml").write_text(MAP + "held = true\n")
    mapping = load_map(logged / "map.toml", LAYOUT)
    assert Recording.load(logged / "log.csv", mapping).held
    assert "held = true" in map_text(mapping, LAYOUT)
    (logged / "map.toml").write_text(MAP.replace("scale = 0.5", "held = true"))
    with pytest.raises(CraneError, match=r"\[z4\]: held = True, expected true or false, of a command"):
        load_map(logged / "map.toml", LAYOUT)


def test_a_recordings_columns_are_a_map_file_of_it(logged: Path) -> None:
    recording = Recording.load(logged / "log.csv", load_map(logged / "map.toml", LAYOUT))
    (logged / "again.toml").write_text(map_text(recording.columns, LAYOUT))
    again = Recording.load(logged / "log.csv", load_map(logged / "again.toml", LAYOUT))
    for name, channel in recording.channels.items():
        assert again[name].values == pytest.approx(channel.values, abs=1e-9)
        assert again[name].time == pytest.approx(channel.time)


def test_offsets_are_written_in_the_units_that_people_use() -> None:
    columns = {"z1": Column("Boom", "deg", -1.0, math.pi / 2), "p1": Column("P", "psi", offset=101325.0)}
    text = map_text(columns, LAYOUT)
    assert text.splitlines()[:4] == ["[z1]", 'column = "Boom"', 'unit = "deg"', "sign = -1"]
    assert 'offset = "90 deg"' in text and 'offset = "1.01325 bar"' in text
    assert keys_of(Column("S1", offset=0.034), "m")["offset"] == '"34 mm"'
    assert keys_of(Column("V1", "%", 0.1, late=0.05), "") == {
        "column": '"V1"', "unit": '"%"', "scale": "0.1", "late": '"0.05 s"',
    }  # fmt: skip


def test_a_minus_turns_the_sign(logged: Path) -> None:
    turned = Recording.load(logged / "log.csv", {"time": "Zeit[s]", "z1": "-Boom[deg]"})
    assert np.degrees(turned["z1"].values) == pytest.approx([-1.0, -2.0, -4.0])
    assert turned.columns["z1"] == Column("Boom", "deg", -1.0)


@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ('[z9]\ncolumn = "Boom"', ["[z9]", "no channel 'z9'", '"z4"']),
        ('[z1]\ncolum = "Boom"', ["[z1]", "unknown key 'colum'", '"column"']),
        ('z1 = "Boom"', ["expected a table", "[z1]"]),
        ("[z1", ["not a TOML file"]),
        ("[z1]\ncolumn = 3", ["column = 3", "expected a text"]),
        ('[z1]\nunit = "bar"', ["[z1]", "[bar] has the wrong dimension", "rad"]),
        ("[z1]\nsign = 2", ["sign = 2", "1 or -1"]),
        ("[z1]\nscale = 0", ["scale = 0"]),
        ("[z1]\ndrift = 2", ["drift = 2"]),
        ('[z1]\noffset = "2 bar"', ["offset = '2 bar'", "wrong unit"]),
        ("[time]\nsign = -1", ["[time]", "only the name and unit of a time"]),
        ('[z1]\ncolumn = "Boom"\n[z4]\ncolumn = "Boom"', ["'Boom'", "z1 and z4"]),
        ('[time]\ncolumn = "Zeit"\n[z1]\ncolumn = "Bom"', ["no column 'Bom'", "map.toml, [z1]", '"Boom"']),
    ],
)
def test_what_is_wrong_in_a_map_file_is_told_with_its_place(logged: Path, text: str, parts: list[str]) -> None:
    (logged / "map.toml").write_text(text)
    with pytest.raises(CraneError) as refused:
        Recording.load(logged / "log.csv", load_map(logged / "map.toml", LAYOUT))
    for part in ("map.toml", *parts):
        assert part in str(refused.value)
