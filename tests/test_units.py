"""Text with units: commas are decimal commas or refused, nothing is read as something that nobody means, nothing takes
long.
"""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from crane_exudyn.errors import CraneError
from crane_exudyn.recording import Recording
from crane_exudyn.units import factor_to_si, reference_of, to_si, unit_of


@pytest.mark.parametrize(
    ("text", "unit", "value"),
    [
        ("25,5 kg", "kg", 25.5),
        ("0,535 m", "m", 0.535),
        ("-2,5 deg", "rad", math.radians(-2.5)),
        ("2,5e-12", "", 2.5e-12),
        ("24,5 l/min/(7,5 bar)**0.5", "m**3/s/Pa**0.5", 24.5e-3 / 60 / math.sqrt(7.5e5)),
        ("7 bar²", "Pa**2", 7e10),
        ("2.5*10**-12 m", "m", 2.5e-12),
        ("−5 m", "m", -5.0),
        ("2.5×10**−12 m⁻¹", "1/m", 2.5e-12),
        ("3 N⋅m", "N*m", 3.0),
    ],
)
def test_a_decimal_comma_is_read_as_one_and_powers_of_units_are_read(text: str, unit: str, value: float) -> None:
    assert to_si(text, unit, "x") == pytest.approx(value, rel=1e-12)


@pytest.mark.parametrize(
    ("text", "unit", "words"),
    [
        ("1,250 kg", "kg", "thousands"),
        ("1,250.5 kg", "kg", "thousands"),
        ("1.250,5 kg", "kg", "thousands"),
        ("1,250,000 Pa", "Pa", "thousands"),
        ("1 000 kg", "kg", "thousands"),
        ("1'000 kg", "kg", "thousands"),
        ("2_5 kg", "kg", "thousands"),
        ("bar, 5", "Pa", "outside a number"),
        ("2e1,5 kg", "kg", "outside a number"),
        ("25;5 kg", "kg", "';'"),
        ("5 ± 0.1 m", "m", "'±'"),
        ("5 m # 3", "m", "'#'"),
        ("5 = 3 m", "m", "'='"),
        ('5 " ', "", "cannot occur"),
        ("∞ m", "m", "'∞'"),
        ("5 m'", "m", '"\'"'),
        ("½ m", "m", ""),
        ("90 Grad", "rad", "gigaradian"),
        ("9**9**9 m", "m", "power"),
        ("((9**9)**9)**9 m", "m", "power"),
        ("9**999999999 m", "m", "power"),
        ("9⁹⁹⁹⁹⁹⁹⁹⁹ m", "m", "power"),
        ("(3 m) squared squared squared squared squared", "m", ""),
        ("9" * 1000 + " m", "m", "characters"),
        ("899", "s", "has no unit. Write one, such as '899 s'"),
    ],
)
def test_what_may_mean_something_else_is_refused_at_once(text: str, unit: str, words: str) -> None:
    with pytest.raises(CraneError, match=r"^x = ") as caught:
        to_si(text, unit, "x")
    assert words in str(caught.value)


@pytest.mark.parametrize(
    ("unit", "si"),
    [
        ("Grad", "rad"),
        ("kdeg", "rad"),
        ("Grad/s", "rad/s"),
        ("bar,abs", "Pa"),
        ("bar!", "Pa"),
        ("bar; 2", "Pa"),
        ("10**10**10 Pa", "Pa"),
    ],
)
def test_units_of_columns_are_as_careful(unit: str, si: str) -> None:
    with pytest.raises(CraneError, match="unit"):
        factor_to_si(unit, si)


def test_a_column_in_grad_is_no_giga_radian(tmp_path: Path) -> None:
    file = tmp_path / "lift.csv"
    file.write_text("time[s],z1[Grad]\n0,1\n1,2\n", encoding="utf-8")
    with pytest.raises(CraneError, match=r"lift.csv, column z1\[Grad\].*deg"):
        Recording.load(file)


@pytest.mark.parametrize(
    ("unit", "plain", "reference"),
    [
        ("barg", "bar", "gauge"),
        ("bar(g)", "bar", "gauge"),
        ("bar_g", "bar", "gauge"),
        ("barü", "bar", "gauge"),
        ("psig", "psi", "gauge"),
        ("MPa gauge", "MPa", "gauge"),
        ("bara", "bar", "absolute"),
        ("kPa(abs)", "kPa", "absolute"),
        ("psia", "psi", "absolute"),
    ],
)
def test_units_of_gauge_and_of_absolute_pressures_are_told_from_the_plain_one(
    unit: str, plain: str, reference: str
) -> None:
    assert reference_of(unit) == (plain, reference)
    with pytest.raises(CraneError, match=rf'unit = "{plain}".*offset = "-?[\d.]+ {plain}"'):
        factor_to_si(unit, "Pa")


@pytest.mark.parametrize(
    "unit", ["Pa", "kPa", "hPa", "bar", "mbar", "psi", "mmHg", "inHg", "atm", "torr", "g", "a", "P"]
)
def test_units_that_only_end_so_are_none_of_those(unit: str) -> None:
    assert reference_of(unit) is None


def test_a_factor_that_is_that_of_a_usual_unit() -> None:
    assert unit_of(math.pi / 180, "rad") == "deg" and unit_of(0.0689475729 * 1e5, "Pa") == "psi"
    assert unit_of(0.01, "") == "%" and unit_of(1e4, "Pa") is None


@pytest.mark.parametrize("value", [math.inf, -math.inf, "-1e400 m", 10**400])
def test_what_is_infinite_is_refused_but_as_a_limit(value: object) -> None:
    with pytest.raises(CraneError, match=r"x = .* is not finite"):
        to_si(value, "m", "x")
    assert math.isinf(to_si(value, "m", "x", infinite=True))
