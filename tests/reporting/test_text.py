"""Numbers as text: pinned by hand."""

from __future__ import annotations

import math

import pytest

from study.reporting.text import (
    MINUS,
    MISSING,
    clean,
    duration,
    interval,
    listing,
    name_of,
    p_phrase,
    p_value,
    percent,
    quantity,
    ratio,
    sentence,
    significant,
)


def flat(text: str) -> str:
    return text.replace("\N{NO-BREAK SPACE}", " ")


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (1.23456, "1.23"),
        (0.00123456, "0.00123"),
        (123456.0, "123,000"),
        (9.999, "10.0"),
        (0.9996, "1.00"),
        (-4.567, MINUS + "4.57"),
        (0.0, "0"),
        (math.nan, MISSING),
        (math.inf, MISSING),
        (None, MISSING),
        (1.5e-7, f"1.50e{MINUS}7"),
        (2.5e9, "2.50e9"),
        (100.0, "100"),
        (99.95, "100"),
    ],
)
def test_three_significant_digits(value, text):
    assert significant(value) == text


@pytest.mark.parametrize(
    ("p", "text"),
    [
        (0.0321, ".032"),
        (0.5, ".500"),
        (0.0004999, "< .001"),
        (0.0005, ".001"),
        (1e-300, "< .001"),
        (0.9995, "> .999"),
        (1.0, "> .999"),
        (0.99949, ".999"),
        (None, MISSING),
        (math.nan, MISSING),
        (0.0, "< .001"),
    ],
)
def test_p_has_no_leading_zero(p, text):
    assert p_value(p) == text


def test_p_in_a_sentence():
    assert p_phrase(0.0321) == "p = .032"
    assert p_phrase(1e-9) == "p < .001"
    assert p_phrase(None) == "no p"


def test_interval_has_the_decimals_of_its_larger_end():
    assert flat(interval(-0.0612, 0.4311, "pp")) == f"{MINUS}0.061 to 0.431 pp"
    assert interval(-0.0001, 12.3) == "0.0 to 12.3"
    assert interval(9.96, 9.999) == "10.0 to 10.0"
    assert interval(None, 1.0) == MISSING


def test_units_never_leave_their_number():
    assert quantity(5.0, "kPa") == "5.00\N{NO-BREAK SPACE}kPa"
    assert quantity(None, "kPa") == MISSING


def test_ratio_near_one_shows_what_differs():
    assert flat(ratio(1.3731)) == "\N{MULTIPLICATION SIGN} 1.37"
    assert flat(ratio(1.00034)) == "\N{MULTIPLICATION SIGN} 1.0003"


def test_small_words():
    assert flat(percent(0.12345)) == "12.3 %"
    assert flat(percent(1e-9)) == "< 0.1 %"
    assert [flat(duration(s)) for s in (0.1, 59.9, 130.0, 7200.0)] == [
        "100 ms",
        "60 s",
        "2.2 min",
        "2 h",
    ]
    assert listing(["a", "b", "c"]) == "a, b and c"
    assert sentence("ends here") == "Ends here."
    assert name_of("model.element_order") == "element order"
    assert name_of("x", {"x": "better"}) == "better"


def test_clean_keeps_everything_visible():
    assert clean("a\x00b\u202ec") == "a\ufffdb\ufffdc"
    assert clean("x" * 50, 10) == "x" * 9 + "\N{HORIZONTAL ELLIPSIS}"
