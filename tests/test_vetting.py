"""Contents that cannot be true of a crane are told with their likely mend, within a second; sound recordings are left
alone.
"""

from __future__ import annotations

import dataclasses
import time as clock
from collections.abc import Mapping

import numpy as np
import pytest

from crane_exudyn.crane import Crane
from crane_exudyn.description import Uncertainty
from crane_exudyn.errors import CraneError
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
    return Recording.from_arrays("r", time, values | {k: np.broadcast_to(v, n) for k, v in changed.items()})


def of(wave: float, middle: float, n: int = 2000) -> np.ndarray:
    return middle - wave * np.cos(0.005 * np.arange(n))


def test_a_sound_recording_has_no_findings() -> None:
    assert contents(recorded(), Crane.load("patu655")) == []


@pytest.mark.parametrize(
    ("changed", "kind", "channels", "text", "mend"),
    [
        ({"p1": of(10, 60)}, "scale", ("p1",), "never exceeds 0.0007 bar", "p1[bar]"),
        ({"p1": of(10e10, 60e10)}, "scale", ("p1",), "reaches", "look like Pa given as bar"),
        ({"p3": of(5 * BAR, -20 * BAR)}, "offset", ("p3",), "never negative", "sign"),
        ({"pp": of(0.1 * BAR, BAR), "pt": of(BAR, 100 * BAR)}, "swapped", ("pp", "pt"), "bar) stands below the tank "
                                                                                        "(100 bar)", "Swap"),
        ({"z1": of(100 * DEG, 900 * DEG)}, "scale", ("z1",), "1e+03 deg", "z1[deg]"),
        ({"z1": of(5 * DEG, 122 * DEG)}, "pose", ("z1",), "beyond what the lift cylinder's stroke", "other sign"),
        ({"z4": of(5 * DEG, 118 * DEG)}, "pose", ("z4",), "the tilt cylinder's stroke", "other sign"),
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


@pytest.mark.parametrize(("step", "mend"), [(5.0, r"time\[ms\]"), (5e-6, r"time\[s\]")])
def test_a_clock_in_another_unit_is_found(step: float, mend: str) -> None:
    with pytest.raises(CraneError, match=f"times a second.*{mend}"):
        vetted(recorded(step=step), Crane.load("patu655"))


def test_gauge_pressures_of_a_crane_that_has_them_may_be_below_zero() -> None:
    gauge = Crane.load("patu655").with_parameters({"supply.pressure_reference": 1.0, "supply.air_pressure": 101325.0})
    assert contents(recorded(p3=of(0.1 * BAR, -0.7 * BAR), pt=of(0.01 * BAR, 0.0)), gauge) == []
    (found,) = contents(recorded(p3=of(0.5 * BAR, -3.0 * BAR)), gauge)
    assert found.severity == "error" and "at least -1.01 bar" in found.text


def test_spikes_are_no_units() -> None:
    z1 = of(5 * DEG, 20 * DEG)
    z1[::300] = 1e4
    assert contents(recorded(z1=z1), Crane.load("patu655")) == []


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
