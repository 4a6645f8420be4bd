"""A law that gives no number while a crane runs is told by its effect's name, by either engine and by the filter."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from crane_exudyn import Crane, Recording, faulty_laws, statics
from crane_exudyn.effects import registry
from crane_exudyn.engine import ExudynEngine
from crane_exudyn.errors import CraneError
from crane_exudyn.simulation import simulate
from crane_exudyn.static_start import static_start
from ukf.channels import Channels
from validation.semi_recursive import SemiRecursiveEngine

CLOSED = np.array([0.0, 0.0, np.nan, np.nan])
SOUND = "internal_leakage@tilt"


@pytest.fixture
def spoil(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], Crane]:
    """Return a crane with two effects, of which the law of one gives NaN: so does every law whose parameter is NaN."""
    usual = Crane.effect_vector

    def spoilt(key: str) -> Crane:
        effect, place = registry.split_key(key)

        def vector(crane: Crane) -> np.ndarray:
            values = usual(crane)
            if crane.effect(key) is not None:
                values[registry.slot(effect.name, place, crane.layout)] = np.nan
            return values

        monkeypatch.setattr(Crane, "effect_vector", vector)
        crane = Crane.load("patu655").with_effect(SOUND, {"k": 1e-13})
        return crane.with_effect(key, {p.name: p.typical for p in effect.parameters})

    return spoilt


@pytest.mark.parametrize("engine", [ExudynEngine, SemiRecursiveEngine])
@pytest.mark.parametrize(
    "key",
    [
        "internal_leakage@lift", "external_leakage@p3", "seal_friction@tilt", "joint_viscous_friction@O", "base_tilt",
        "pump_droop",
        "meter_out_restriction@lift", "command_delay@tilt",
    ],
)  # fmt: skip
def test_a_run_names_the_effect_whose_law_gives_no_number(
    spoil: Callable[[str], Crane], key: str, engine: Callable[[Crane], Any]
) -> None:
    crane, time = spoil(key), 0.01 * np.arange(5)
    inputs = Recording.from_arrays("r", time, {"u1": 0.0 * time + 0.2, "u2": 0.0 * time + 0.1})
    with pytest.raises(CraneError, match=f"patu655: effect '{key}' gives no finite number") as refusal:
        simulate(crane, inputs, engine=engine(crane))
    assert SOUND not in str(refusal.value) and "\n" not in str(refusal.value)


def test_a_sensor_names_the_effect_whose_law_gives_no_number(spoil: Callable[[str], Crane]) -> None:
    channels = Channels(spoil("sensor_scale@p1"), ["z1", "p1"], 8)
    with pytest.raises(CraneError, match=r"effect .sensor_scale@p1. gives no finite number .* at p1 = 6e"):
        channels.observe(np.array([[0.2, -0.7, 0.0, 0.0, 60e5, 20e5, 20e5, 40e5]]))


def test_it_is_found_where_the_failing_step_leads(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last good state is one at which the law still gave a number."""
    crane = Crane.load("patu655").with_effect("seal_friction@lift", {"dFc": 100.0})
    state = static_start(crane, 0.2, -0.7)
    state[2] = 0.1
    usual = statics.terms

    def terms(tried: Crane, x: np.ndarray, w: np.ndarray, time: float = 0.0) -> dict[str, float]:
        beyond = bool(tried.effects) and x[0] > 0.2 + 0.5e-4
        return usual(tried, x, w, time) | ({"F1": np.nan} if beyond else {})

    monkeypatch.setattr(faulty_laws, "terms", terms)
    found = faulty_laws.where_run_failed(crane, state, CLOSED, 1.0, 1e-3)
    assert found is not None and "'seal_friction@lift'" in str(found) and "t = 1.001 s" in str(found)
    state[2] = 0.0
    assert faulty_laws.where_run_failed(crane, state, CLOSED, 1.0, 1e-3) is None
    assert faulty_laws.where_run_failed(crane.nominal(), state, CLOSED, 1.0, 1e-3) is None


def test_two_laws_that_fail_only_together_are_both_named() -> None:
    crane = Crane.load("patu655").with_effect(SOUND, {"k": 1e-13}).with_effect("seal_friction@lift", {"dFc": 100.0})
    assert faulty_laws.without_numbers(crane, lambda tried: len(tried.effects) < 2) == [SOUND, "seal_friction@lift"]


@pytest.mark.parametrize("engine", [ExudynEngine, SemiRecursiveEngine])
def test_a_run_that_fails_names_the_number_that_no_machine_has(engine: Callable[[Crane], Any]) -> None:
    """The state of the failure says nothing to who left a unit out."""
    crane, time = Crane.load("patu655").with_parameters({"fluid.oil_bulk_modulus": 1650.0}), 0.01 * np.arange(5)
    inputs = Recording.from_arrays("r", time, {"u1": 0.0 * time + 0.2, "u2": 0.0 * time + 0.1})
    with pytest.raises(CraneError, match=r"cannot go on at t = .*oil_bulk_modulus = 1650 Pa .*\"1650 MPa\"") as refusal:
        simulate(crane, inputs, engine=engine(crane))
    assert "p1" not in str(refusal.value)
