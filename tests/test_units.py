import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.ground import units
from study.ground.errors import UnitError


@pytest.mark.parametrize(
    ("text", "dimension", "value"),
    [
        ("50 mm", "length", 50.0),
        ("50mm", "length", 50.0),
        ("5 cm", "length", 50.0),
        ("1 in", "length", 25.4),
        ("0.02 N", "force", 0.02),
        ("5 kPa", "pressure", 0.005),
        ("0.005 MPa", "pressure", 0.005),
        ("1.1 kPa", "pressure", 0.0011),
        ("2 N/mm^2", "pressure", 2.0),
        ("30 deg", "angle", 30.0),
        ("10 min", "time", 600.0),
        ("2 kN/m", "stiffness", 2.0),
        ("-1.5e1 mm", "length", -15.0),
    ],
)
def test_common_units_are_exact(text, dimension, value):
    # exact decimals, one rounding: no tolerance is needed
    assert units.parse(text, dimension) == value


def test_radians_and_units_only_pint_knows():
    assert units.parse("1 rad", "angle") == pytest.approx(57.29577951308232, rel=1e-15)
    # 1 psi = 6894.757 Pa (NIST SP 811)
    assert units.parse("1 psi", "pressure") == pytest.approx(6.894757e-3, rel=1e-6)
    assert units.parse("1 foot", "length") == pytest.approx(304.8, rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "", "mm", "50", "nan mm", "inf mm", "-inf mm", "1e400 mm", "1e9999 mm", "1_0 mm",
        "١٠ mm", "１０ mm", "50 kPa", "50 parsnips", "50 mm mm", "0x10 mm", "1,5 mm",  # noqa: RUF001
        "5 m**9**9**9**9", "5 (mm)", "5 __import__('os')", "5 mm\x00", "5 mm\n", "1" * 500 + " mm",
    ],
)  # fmt: skip
def test_what_is_no_length_is_refused(text):
    with pytest.raises(UnitError):
        units.parse(text, "length")


@pytest.mark.parametrize("value", [50, 50.0, True, None, [1]])
def test_bare_values_are_refused_and_told_how_to_mend(value):
    with pytest.raises(UnitError, match="needs a unit"):
        units.parse(value, "length")


def test_the_error_says_how_to_mend():
    with pytest.raises(UnitError) as caught:
        units.parse("50", "length")
    assert '"50 mm"' in caught.value.faults[0].mend
    with pytest.raises(UnitError, match="must be a length, 'kPa' is a pressure"):
        units.parse("50 kPa", "length")


@pytest.mark.parametrize("text", ["30 %", "1 dimensionless", "1 count", "30"])
def test_an_angle_is_not_a_plain_number(text):
    with pytest.raises(UnitError):
        units.parse(text, "angle")


def test_percentages():
    assert units.parse_percent("1 %") == 1.0
    assert units.split("2 pp") == (2.0, "pp")
    assert units.split("5  %  of mean") == (5.0, "% of mean")
    with pytest.raises(UnitError):
        units.parse_percent("1 mm")
    with pytest.raises(UnitError):
        units.split("mean")


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_number_in_the_internal_unit_is_read_exactly(value):
    assert units.parse(f"{value!r} MPa", "pressure") == value


@given(st.text(max_size=90), st.sampled_from(sorted(units.INTERNAL)))
def test_any_text_gives_a_finite_number_or_a_unit_error(text, dimension):
    try:
        value = units.parse(text, dimension)
    except UnitError:
        return
    assert abs(value) < float("inf")


@pytest.mark.parametrize("text", ["nan", "inf", "1e400", "1_0", "١", " 1", "", "1 mm"])  # noqa: RUF001
def test_strict_plain_numbers(text):
    with pytest.raises(UnitError):
        units.parse_number(text)


def test_factors_of_units():
    assert units.unit_factor("cm", "length") == 10.0


def test_common_units_do_not_load_pint():
    code = "import sys; from study.ground import units; units.parse('5 kPa', 'pressure')"
    done = subprocess.run(
        [sys.executable, "-c", code + "; sys.exit('pint' in sys.modules)"], check=False
    )
    assert done.returncode == 0


def test_a_ratio_has_no_exponent_below_a_million():
    assert [units.times(ratio) for ratio in (0.4564, 12.0, 999.6, 1234.0)] == [
        "0.456 times", "12 times", "1,000 times", "1,230 times",
    ]  # fmt: skip
