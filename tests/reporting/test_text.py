"""Numbers as text: pinned by hand."""

import math
import re

import pytest

from study.reporting.content.effect_words import together
from study.reporting.content.report_facts import grouped_inputs
from study.reporting.content.text import (
    MINUS,
    MISSING,
    capital,
    case_counts,
    clean,
    decimals_that_count,
    duration,
    f_value,
    inside,
    interval,
    level,
    listing,
    name_of,
    p_value,
    percent,
    plural_of,
    rounded,
    sentence,
    share,
    significant,
    slug,
    slugs,
    span,
    trimmed,
)
from study.reporting.results.study_answers import Change


def change(then, now):
    return Change("design", "k", (then, now)).sentence


@pytest.mark.parametrize(
    ("write", "arguments", "text"),
    [
        # three significant digits, whatever the size
        (significant, (1.23456,), "1.23"),
        (significant, (0.00123456,), "0.00123"),
        (significant, (123456.0,), "123,000"),
        (significant, (9.999,), "10.0"),
        (significant, (0.9996,), "1.00"),
        (significant, (-4.567,), MINUS + "4.57"),
        (significant, (0.0,), "0"),
        (significant, (math.nan,), MISSING),
        (significant, (math.inf,), MISSING),
        (significant, (None,), MISSING),
        (significant, (1.5e-7,), f"1.50e{MINUS}7"),
        (significant, (2.5e9,), "2.50e9"),
        (significant, (100.0,), "100"),
        (significant, (99.95,), "100"),
        # a p has no leading zero
        (p_value, (0.0321,), ".032"),
        (p_value, (0.5,), ".500"),
        (p_value, (0.0004999,), "< .001"),
        (p_value, (0.0005,), ".001"),
        (p_value, (1e-300,), "< .001"),
        (p_value, (0.9995,), "> .999"),
        (p_value, (1.0,), "> .999"),
        (p_value, (0.99949,), ".999"),
        (p_value, (None,), MISSING),
        (p_value, (math.nan,), MISSING),
        (p_value, (0.0,), "< .001"),
        # an interval has the decimals of its larger end, more where its ends would look alike
        (interval, (-0.0612, 0.4311, "pp"), f"{MINUS}0.061 to 0.431 pp"),
        (interval, (-0.0001, 12.3), "0.0 to 12.3"),
        (interval, (9.96, 9.999), "9.960 to 9.999"),
        (interval, (1.43362, 1.43374), "1.4336 to 1.4337"),
        (interval, (None, 1.0), MISSING),
        # what is finer than matters is not printed
        (rounded, (0.000267, 3), "< 0.001"),
        (rounded, (-0.000267, 3), f"{MINUS}< 0.001"),
        (rounded, (0.0912, 3), "0.091"),
        (rounded, (0.155, 3), "0.155"),
        (rounded, (0.0, 3), "0"),
        (rounded, (12.345, 3), "12.3"),
        (rounded, (0.000267, None), "0.000267"),
        # both ends share their decimals and differ where they can
        (span, (-3.91e-5, 0.000574, 3), "0.000 to 0.001"),
        (span, (1.43362, 1.43374, 4), "1.4336 to 1.4337"),
        (span, (0.0249, 0.2854, 3), "0.025 to 0.285"),
        (span, (None, 1.0, 3), MISSING),
        # an estimate that would stand outside of its interval is written as finely
        (inside, (1.42716, 1.4271, 1.4272, "1.43", "1.4271 to 1.4272"), "1.4272"),
        (inside, (0.156, 0.026, 0.286, "0.156", "0.026 to 0.286"), "0.156"),
        (f_value, (17.94,), "17.9"),
        (f_value, (9999.0,), "10,000"),
        (f_value, (10001.0,), "> 10,000"),
        (f_value, (None,), MISSING),
        (share, (0.912,), "91.2 %"),
        (share, (0.00332,), "0.3 %"),
        (share, (1e-5,), "< 0.1 %"),
        (share, (0.0,), "0.0 %"),
        (percent, (0.12345,), "12.3 %"),
        (percent, (1e-9,), "< 0.1 %"),
        (level, (0.05,), "95 %"),
        (level, (0.2,), "80 %"),
        (duration, (0.02,), "20 ms"),
        (duration, (5.1,), "5.1 s"),
        (duration, (59.9,), "60 s"),
        (duration, (130.0,), "2.2 min"),
        (duration, (7200.0,), "2 h"),
        (
            case_counts,
            ({"total": 4, "done": 3, "failed": 1, "missing": 0},),
            "4 cases: 3 done, 1 failed, 0 missing",
        ),
        (listing, (["a"],), "a"),
        (listing, (["a", "b"],), "a and b"),
        (listing, (["a", "b", "c"],), "a, b and c"),
        (plural_of, ("batch",), "batches"),
        (plural_of, ("assembly",), "assemblies"),
        (plural_of, ("day",), "days"),
        (plural_of, ("A",), "levels of A"),
        (sentence, ("ends here",), "Ends here."),
        # a symbol is no word, at the head of a sentence or a heading either
        (sentence, ("y at kind a: level",), "y at kind a: level."),
        (capital, ("mu0 at kind a",), "mu0 at kind a"),
        (capital, ("a peak",), "A peak"),
        (name_of, ("model.element_order",), "element order"),
        (name_of, ("mu0",), "initial shear modulus"),
        (name_of, ("force_at_2.5_mm",), "force at 2.5 mm"),
        (name_of, ("x", {"x": "better"}), "better"),
        (change, ("25 mm", "26 mm"), "k: from 25 mm to 26 mm"),
        (change, (None, "20"), "k: 20, not set before"),
        (change, ("20", None), "k: 20 before, not set now"),
        (together, (["no practical difference", "matters"],), "matters"),
        (together, (["no practical difference", "cannot tell"],), "cannot tell"),
        (clean, ("a\x00b\u202ec",), "a\ufffdb\ufffdc"),
        (clean, ("x" * 50, 10), "x" * 9 + "\N{HORIZONTAL ELLIPSIS}"),
    ],
)
def test_numbers_and_words(write, arguments, text):
    assert write(*arguments).replace("\N{NO-BREAK SPACE}", " ") == text


def test_decimals_are_those_of_a_thousandth_of_what_matters():
    steps = (0.5, 5, 0.05, 0.1, None, 3e-14)
    assert [decimals_that_count(step) for step in steps] == [3, 2, 4, 4, None, None]


def test_inputs_are_joined_by_their_first_part():
    inputs = {"specimen.shape": "cylinder", "specimen.radius": "25 mm", "mesh": "fine"}
    assert grouped_inputs(inputs) == {"specimen": "cylinder, radius 25 mm", "mesh": "fine"}


def test_a_name_of_a_file_is_that_of_one_text():
    assert slug("Force [mN]") == "force-mn"
    assert slug("") == "response"
    texts = ("F", "f", "+1", "-1", "\N{GREEK SMALL LETTER SIGMA}", "\N{CYRILLIC SMALL LETTER YA}",
             *("response" * 20 + end for end in "ab"))  # fmt: skip
    names = slugs(texts)
    assert len(set(names.values())) == len(texts)
    assert all(re.fullmatch("[a-z0-9-]{1,90}", name) for name in names.values())
    assert slugs(["mu0", "work_error"]) == {"mu0": "mu0", "work_error": "work-error"}


def test_of_a_huge_number_no_more_digits_are_written_than_of_others():
    assert rounded(401_413_483.0, 0) == "4.01e8"
    assert rounded(-1_234_567.0, 0) == f"{MINUS}1,230,000"
    assert rounded(123_456.0, 0) == "123,456"
    assert span(389_327_633.0, 413_499_334.0, 0) == "3.89e8 to 4.13e8"
    assert inside(401_413_483.0, 389_327_633.0, 413_499_334.0, "4.01e8", "3.89e8 to 4.13e8") == (
        "4.01e8"
    )


def test_a_declared_difference_is_written_without_zeros_and_exponents():
    assert [trimmed(value) for value in (0.5, 20, 1e6, 0.05)] == ["0.5", "20", "1,000,000", "0.05"]
    assert trimmed(5e-10) == "5e\N{MINUS SIGN}10"
