"""Numbers as text: pinned by hand."""

from __future__ import annotations

import math

import pytest

from study.reporting.content.numbers import (
    MINUS,
    MISSING,
    decimals_that_count,
    duration,
    f_value,
    interval,
    p_value,
    percent,
    rounded,
    share,
    significant,
    span,
)
from study.reporting.content.text import clean, listing, name_of, sentence


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


def test_interval_has_the_decimals_of_its_larger_end():
    assert flat(interval(-0.0612, 0.4311, "pp")) == f"{MINUS}0.061 to 0.431 pp"
    assert interval(-0.0001, 12.3) == "0.0 to 12.3"
    assert interval(9.96, 9.999) == "9.960 to 9.999"
    assert interval(1.43362, 1.43374) == "1.4336 to 1.4337"
    assert interval(None, 1.0) == MISSING


def test_what_is_finer_than_matters_is_not_printed():
    assert decimals_that_count(0.5) == 3
    assert decimals_that_count(0.05) == 4
    assert decimals_that_count(0.1) == 4
    assert decimals_that_count(None) is None
    assert rounded(0.000267, 3) == "< 0.001"
    assert rounded(-0.000267, 3) == f"{MINUS}< 0.001"
    assert rounded(0.0912, 3) == "0.091"
    assert rounded(12.345, 3) == "12.3"
    assert rounded(0.000267, None) == "0.000267"


def test_both_ends_share_their_decimals_and_differ_where_they_can():
    assert span(-3.91e-5, 0.000574, 3) == "0.000 to 0.001"
    assert span(1.43362, 1.43374, 4) == "1.4336 to 1.4337"
    assert span(None, 1.0, 3) == MISSING


def test_f_and_share():
    assert [f_value(v) for v in (17.94, 9999.0, 10001.0, None)] == [
        "17.9",
        "10,000",
        "> 10,000",
        MISSING,
    ]
    assert [flat(share(v)) for v in (0.912, 0.00332, 1e-5, 0.0)] == [
        "91.2 %",
        "0.3 %",
        "< 0.1 %",
        "0.0 %",
    ]


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
