"""Learning laws: the screen finds smoothness and place, curves are read as simple forms, and a law becomes a user's own effect."""

import numpy as np
import pytest

from crane_exudyn.effects import registry
from validation.learned.laws import Law, knots
from validation.learned.resembles import resembles
from validation.learned.screen import best_prior


def _law(key, over, low, high, against=None):
    argument = next(a for a in registry.split_key(key)[0].curve.over if a.name == over)
    seen = np.linspace(low, high, 500)
    return Law(key, argument, argument.against[0] if against is None else against, knots(seen, argument), seen)


FORCE = _law("learned_force@lift", "stroke", 0.2, 0.7)


def _read(law, y, share=0.01):
    unit = registry.split_key(law.key)[0].curve.unit
    cov = (share * np.abs(y).max()) ** 2 * np.eye(len(y))
    return resembles(law.x, y, cov, law.over, unit, law.key, law.against)


@pytest.mark.parametrize(
    ("law", "of", "name", "words", "library"),
    [
        (
            FORCE,
            lambda x: 5e3 * np.exp(-(((x - 0.42) / 0.1) ** 2)),
            "bump",
            "5 kN within 0.42 ± 0.1 m of the stroke",
            "",
        ),
        (FORCE, lambda x: 2e3 + 0 * x, "constant", "2 kN", "seal_friction@lift"),
        (
            _law("learned_opening@tilt", "spool", -0.6, 0.6),
            lambda u: np.sign(u) * np.abs(u) ** 1.5,
            "power",
            "opening = U^1.5",
            "",
        ),
        (
            _law("learned_leakage@lift", "pressure_drop", 0.0, 80e5),
            lambda p: 2e-12 * p,
            "linear",
            "0.012 l/min/bar",
            "internal_leakage@lift",
        ),
        (
            _law("learned_leakage@lift", "pressure_drop", 0.0, 80e5),
            lambda p: 1e-8 * np.sqrt(p),
            "square root",
            "0.19 l/min/√bar",
            "",
        ),
        (
            _law("learned_flow@p1", "pressure", 0.0, 80e5),
            lambda p: 1e-11 * np.maximum(p - 50e5, 0.0),
            "dead zone",
            "nothing up to 50 bar",
            "",
        ),
        (_law("learned_supply", "flow", 0.0, 1e-3), lambda q: 3e12 * q**2, "power", "the power 2", ""),
    ],
)
def test_a_curve_is_named_by_the_simple_form_that_it_resembles(law, of, name, words, library):
    found = _read(law, of(law.x))
    assert (found.name, found.library) == (name, library)
    assert words in found.text


def test_a_curve_that_resembles_nothing_is_not_named():
    assert _read(FORCE, 3e3 * np.sin(40.0 * FORCE.x), share=1e-3).name == ""


def test_the_smoothness_of_a_curve_is_found_from_the_data():
    rng = np.random.default_rng(1)
    H = np.eye(len(FORCE.x)) / 100.0**2  # each value seen to 100 N
    line, bump = 4e3 * (FORCE.x - 0.2), 4e3 * np.exp(-(((FORCE.x - 0.42) / 0.08) ** 2))
    found = {}
    for name, y in (("nothing", 0.0 * line), ("line", line), ("bump", bump)):
        seen = y + 100.0 * rng.standard_normal(len(y))
        found[name] = best_prior(FORCE, H, H @ seen)
        assert np.sqrt(np.mean((found[name].y - y) ** 2)) < 150.0
    assert found["nothing"].gain < 3.0 < 50.0 < found["line"].gain
    assert np.sqrt(np.mean((found["line"].y - line) ** 2)) < 70.0  # neighbours help
