"""Contents that cannot be true of a crane are told with their likely mend, within a second; sound recordings are left
alone.
"""

from __future__ import annotations

import dataclasses
import time as clock
import tomllib
from collections.abc import Mapping
from importlib import resources
from pathlib import Path

import numpy as np
import pytest

from crane_exudyn.channels import Channel
from crane_exudyn.channels import of as of_layout
from crane_exudyn.crane import Crane
from crane_exudyn.description import Uncertainty
from crane_exudyn.errors import CraneError
from crane_exudyn.geometry import cylinder_lengths
from crane_exudyn.recording import Recording
from crane_exudyn.simulation import simulate
from crane_exudyn.vetting import contents, vet, vetted
from validation.comparison import compare

BAR, DEG = 1e5, np.pi / 180


def recorded(n: int = 2000, step: float = 0.005, **changed: np.ndarray | float) -> Recording:
    """Return a quiet recording in which everything is plausible but for the channels that are given."""
    time = step * np.arange(n)
    wave = -np.cos(time) + 1e-3 * np.random.default_rng(1).standard_normal(n)
    values: dict[str, np.ndarray] = {
        "u1": 0.0 * time, "u2": 0.0 * time, "z1": (20 + 10 * wave) * DEG, "z4": (-60 + 10 * wave) * DEG,
        "dz1": 0.1 * wave,
        "p1": (60 + 10 * wave) * BAR, "p3": (20 + 5 * wave) * BAR, "pp": (100 + wave) * BAR,
        "pt": (1 + 0.1 * wave) * BAR,
    }  # fmt: skip
    made, units = Recording.from_arrays("r", time, values), of_layout(Crane.load("patu655").layout)
    other = {k: Channel(time, np.broadcast_to(v, n), units[k]) for k, v in changed.items()}
    return dataclasses.replace(
        made, channels={**made.channels, **other}
    )  # as a file has them; from_arrays refuses some at once


def of(wave: float, middle: float, n: int = 2000) -> np.ndarray:
    return middle - wave * np.cos(0.005 * np.arange(n))


def test_a_sound_recording_has_no_findings() -> None:
    assert contents(recorded(), Crane.load("patu655")) == []


@pytest.mark.parametrize(
    ("changed", "kind", "channels", "text", "mend"),
    [
        ({"p1": of(10, 60)}, "scale", ("p1",), "never exceeds 0.0007 bar", "p1[bar]"),
        ({"p1": of(10e10, 60e10)}, "scale", ("p1",), "reaches", "look like Pa recorded as bar"),
        ({"p3": of(5 * BAR, -20 * BAR)}, "offset", ("p3",), "never negative", "sign"),
        ({"pp": of(0.1 * BAR, BAR), "pt": of(BAR, 100 * BAR)}, "swapped", ("pp", "pt"), "bar) is below the tank "
                                                                                        "(100 bar)", "Swap"),
        ({"z1": of(100 * DEG, 900 * DEG)}, "scale", ("z1",), "1e+03 deg", "z1[deg]"),
        ({"z1": of(5 * DEG, 122 * DEG)}, "pose", ("z1",), "reach of the lift cylinder's stroke", "opposite sign"),
        ({"z4": of(5 * DEG, 118 * DEG)}, "pose", ("z4",), "the tilt cylinder's stroke", "opposite sign"),
        ({"dz1": of(30.0, 0.0)}, "scale", ("dz1",), "30 rad/s", "dz1[deg/s]"),
        ({"s1": of(100.0, 900.0)}, "scale", ("s1",), "expected 0.535 to 1.355 m", "s1[mm]"),
        ({"s1": of(0.1, 0.3)}, "scale", ("s1",), "from pin to pin", "stroke"),
    ],
)  # fmt: skip
def test_what_cannot_be_true_is_found_with_its_mend(
    changed: Mapping[str, np.ndarray], kind: str, channels: tuple[str, ...], text: str, mend: str
) -> None:
    findings = contents(recorded(**changed), Crane.load("patu655"))
    assert [f.kind for f in findings] == [kind]
    assert findings[0].channels == channels and findings[0].severity == "error"
    assert text in findings[0].text and mend in findings[0].mend


def test_a_cylinder_that_spans_two_joints_is_judged_by_both_angles() -> None:
    """The other one was taken from the crane file's start, and a correct recording refused."""
    text = resources.files("crane_exudyn.data").joinpath("patu655.toml").read_text(encoding="utf-8")
    file = tomllib.loads(text)
    file["cylinders"]["tilt"] |= {"bodies": ["ground", "outer_boom"], "base": [0.5, 0.3], "rod_end": [0.6, 0.3]}
    recording, crane = (
        recorded(z1=of(15 * DEG, 45 * DEG), z4=of(-10 * DEG, -60 * DEG)),
        Crane.from_document(file, "own"),
    )
    z = np.column_stack([recording[n].values for n in crane.layout.coordinates])
    lengths = cylinder_lengths(crane, z)[:, 1]
    stroke = {"empty_length": lengths.min() - 0.01, "chamber_range": np.ptp(lengths) + 0.02}
    crane = crane.with_parameters({f"cylinders.tilt.{n}": x for n, x in stroke.items()})
    assert contents(recording, crane) == []
    (found,) = contents(recorded(z1=of(15 * DEG, 45 * DEG), z4=of(10 * DEG, 60 * DEG)), crane)
    assert found.channels == ("z4",) and "It would fit with the opposite sign" in found.mend


def test_a_unit_is_told_as_the_file_has_it(tmp_path: Path) -> None:
    """All pressures of it alike, also the one that its noise would bring below a vacuum."""
    recording = recorded(p3=of(6 * BAR, 6 * BAR) + 0.3 * BAR * np.random.default_rng(2).standard_normal(2000))
    recording.save(tmp_path / "r.csv")
    text = (tmp_path / "r.csv").read_text().replace("p1[Pa]", "p1[kPa]").replace("p3[Pa]", "p3[kPa]")
    (tmp_path / "r.csv").write_text(text)
    found = contents(Recording.load(tmp_path / "r.csv"), Crane.load("patu655"))
    assert [(f.kind, f.severity, f.mend) for f in found] == [
        ("scale", "error", f"The values look like Pa recorded as kPa: write the unit as {n}[Pa].") for n in ("p1", "p3")
    ]


@pytest.mark.parametrize("rate", [50.0, 100.0, 200.0])
def test_a_machine_that_rings_has_no_coloured_noise(rate: float) -> None:
    """Its ring stands in all of the recording, and a short mean does not take it out."""
    time, random = np.arange(0.0, 40.0, 1.0 / rate), np.random.default_rng(5)
    ring = sum(np.exp(-0.1 * (time - t)) * np.sin(2 * np.pi * 5.0 * (time - t)) * (time >= t) for t in range(0, 40, 4))
    noise = 0.4 * random.standard_normal(len(time))
    rung = recorded(len(time), 1.0 / rate, p1=BAR * (60 + 10 * np.sin(0.5 * time) + 4.0 * ring + noise))
    assert [f for f in contents(rung, Crane.load("patu655")) if f.kind == "noise"] == []
    if rate > 100.0:
        smoothed = np.convolve(noise, np.full(5, 0.2), "same") + 0.02 * ring
        slow = recorded(len(time), 1.0 / rate, p1=BAR * (60 + 10 * np.sin(0.5 * time) + smoothed))
        [found] = [f for f in contents(slow, Crane.load("patu655")) if f.kind == "noise"]
        assert "the noise of p1 is not white" in found.text


@pytest.mark.parametrize(("step", "mend"), [(5.0, r"time\[ms\]"), (5e-6, r"time\[s\]")])
def test_a_clock_in_another_unit_is_found(step: float, mend: str) -> None:
    with pytest.raises(CraneError, match=f"times a second.*{mend}"):
        vetted(recorded(step=step), Crane.load("patu655"))


def test_gauge_pressures_of_a_crane_that_has_them_may_be_below_zero() -> None:
    gauge = Crane.load("patu655").with_parameters({"supply.pressure_reference": 1.0, "supply.air_pressure": 101325.0})
    assert contents(recorded(p3=of(0.1 * BAR, -0.7 * BAR), pt=of(0.01 * BAR, 0.0)), gauge) == []
    (found,) = contents(recorded(p3=of(0.5 * BAR, -3.0 * BAR)), gauge)
    assert found.severity == "error" and "at least -1.01 bar" in found.text


def test_a_simulated_machine_that_stands_still_is_vetted() -> None:
    """Channels that never change ended in an error of numpy."""
    still = {n: 0.0 * np.arange(2000) for n in ("u1", "u2")} | {"z1": 0.2, "z4": -0.7, "p1": 50 * BAR, "p4": 40 * BAR}
    recording = Recording.from_arrays(
        "r", 0.005 * np.arange(2000), {n: np.broadcast_to(v, 2000) for n, v in still.items()}
    )
    assert not [f for f in vet(recording, Crane.load("patu655")) if f.severity == "error"]
    leapt = recorded(p1=np.where(np.arange(2000) < 1, 60 * BAR, 61 * BAR))
    assert "saturation" in [f.kind for f in contents(leapt, Crane.load("patu655"))]


def test_spikes_are_no_units() -> None:
    z1 = of(5 * DEG, 20 * DEG)
    z1[::300] = 1e4
    (found,) = contents(recorded(z1=z1), Crane.load("patu655"))
    assert (found.kind, found.channels, found.severity) == ("noise", ("z1",), "error")
    assert "7 samples of z1 are exactly 10000 rad" in found.text and found.mend == "Leave these fields empty."


# -- samples that were not measured ----------------------------------------------------------------------------------


def noisy(middle: float, std: float = 0.3 * BAR, n: int = 2000) -> np.ndarray:
    return of(10 * BAR, middle, n) + std * np.random.default_rng(3).standard_normal(n)


@pytest.mark.parametrize("value", [9999 * BAR, 0.0, -999 * BAR])
def test_one_sample_that_no_machine_can_show_is_told_with_its_time(value: float) -> None:
    p1 = noisy(60 * BAR)
    p1[500] = value
    (found,) = contents(recorded(p1=p1), Crane.load("patu655"))
    assert (found.kind, found.channels, found.severity) == ("noise", ("p1",), "error")
    assert "p1 has 1 outlier at t = 2.5 s" in found.text and found.mend == "Leave the field empty."


def test_many_outliers_are_one_finding() -> None:
    p1 = noisy(60 * BAR)
    p1[100::200] += np.linspace(20, 90, 10) * BAR
    (found,) = contents(recorded(p1=p1), Crane.load("patu655"))
    assert "p1 has 10 outliers at t = 0.5, 1.5, 2.5, 3.5, 4.5 s and 5 more" in found.text
    assert "Leave these fields empty." in found.mend


@pytest.mark.parametrize(("value", "severity"), [(-999 * BAR, "error"), (9999 * BAR, "error"), (0.0, "warning")])
def test_a_value_that_stands_for_none_is_told_with_how_often(value: float, severity: str) -> None:
    """Zero may also be a gauge that is cut off above an empty chamber."""
    p1 = noisy(60 * BAR)
    p1[800:1101] = p1[1500:1520] = value
    (found,) = contents(recorded(p1=p1), Crane.load("patu655"))
    assert (found.kind, found.channels, found.severity) == ("noise", ("p1",), severity)
    assert f"321 samples of p1 are exactly {value:.6g} Pa" in found.text and "fill value" in found.text


def test_a_loose_contact_is_told_though_its_dropouts_stand_close() -> None:
    p1 = noisy(60 * BAR)
    p1[800:830:2] = 0.0
    (found,) = contents(recorded(p1=p1), Crane.load("patu655"))
    assert "15 samples of p1 are exactly 0 Pa" in found.text


def test_an_angle_that_begins_with_zeros_leaps_faster_than_any_boom() -> None:
    z1 = of(5 * DEG, 30 * DEG) + 1e-3 * np.random.default_rng(2).standard_normal(2000)
    z1[:40] = 0.0
    (found,) = contents(recorded(z1=z1), Crane.load("patu655"))
    assert found.severity == "error" and "40 samples of z1 are exactly 0 rad" in found.text


def _after(instant: float) -> np.ndarray:
    return np.maximum(0.005 * np.arange(2000) - instant, 0.0)


@pytest.mark.parametrize(
    "event",
    [
        np.where(_after(2.0) > 0, 60.0, 0.0),  # a valve that opens at once
        np.where((_after(2.0) > 0) & (_after(2.0) < 0.02), 60.0, 0.0),  # a peak of four samples
        60.0 * np.exp(-_after(2.0) / 0.01) * (_after(2.0) > 0),  # a shock that dies out
        60.0 * np.exp(-_after(2.0)) * np.sin(500 * _after(2.0)),  # a ring that the samples hardly follow
        np.where((_after(2.0) > 0) & (_after(2.0) <= 0.005), 90.0, np.where(_after(2.0) > 0, 60.0, 0.0)),  # an end stop
    ],
    ids=["step", "peak", "shock", "ring", "stop"],
)
@pytest.mark.parametrize("std", [0.3 * BAR, 0.0])
def test_fast_events_are_no_outliers(event: np.ndarray, std: float) -> None:
    found = contents(recorded(p1=noisy(60 * BAR, std) + event * BAR), Crane.load("patu655"))
    assert not any("outlier" in f.text or "fill value" in f.text for f in found), found


def test_a_recording_of_ten_samples_a_second_may_leap() -> None:
    p1 = noisy(60 * BAR)
    p1[500] += 60 * BAR
    assert contents(recorded(step=0.1, p1=p1), Crane.load("patu655")) == []


def test_ten_minutes_are_vetted_in_seconds() -> None:
    crane, recording = Crane.load("patu655"), recorded(600_000, 0.001)
    vet(recorded(), crane)  # compiles
    begin = clock.process_time()
    vet(recording, crane)
    assert clock.process_time() - begin < 10.0


def test_a_comparison_refuses_what_cannot_be_true() -> None:
    with pytest.raises(CraneError, match=r"r: p1 never exceeds 0.0007 bar.*Write|write the unit as p1\[bar\]"):
        compare("patu655", recorded(p1=of(10, 60)))


@pytest.mark.parametrize("known", [{}, {"payload.mass": Uncertainty(10.0)}])
def test_a_crane_file_need_not_say_how_sure_it_is_of_its_payload(known: dict[str, Uncertainty]) -> None:
    """A machine at rest, looked at with a payload of no or of a one-figure uncertainty: no failure, no finding."""
    crane = dataclasses.replace(Crane.load("loader"), uncertainty=known)
    assert vet(simulate(crane).recording(), crane) == []
