"""The section of a report that sets another study beside it."""

from dataclasses import replace

import pytest

from study.reporting.content import comparison_content
from study.reporting.figures.axes import data_alone
from study.reporting.output.study_page import prepare
from study.reporting.results.study_answers import (
    DIFFERS,
    MATTERS,
    NO_DIFFERENCE,
    ONE_CANNOT_TELL,
    Beside,
    Change,
    Conclusion,
    OnlyInOne,
)
from study.statistics.analysis.anova_table import Effect, SimpleEffect
from tests.reporting.example import words_of

EVIL = '<script>alert("x")</script>'


def found(verdict, effect):
    return Effect(
        "t", (), (), (effect - 0.1, effect + 0.1), effect, verdict, practical=0.5, p=0.003,
        u_num=0.02, effect_over_u_num=effect / 0.02,
    )  # fmt: skip


def conclusion(term, kind, holds, *both, **more):
    return Conclusion("work_error", term, "%", kind, holds, (both[0], both[1]), **more)


def example(name="second"):
    yes, no, open_ = "matters", "no practical difference", "cannot tell"
    lead = {"end": "lowest"}
    rows = (
        conclusion("material", MATTERS, True, found(yes, 1.9), found(yes, 2.1),
                   same_best=True, best=("mr", "mr"), **lead),
        conclusion("model.space", NO_DIFFERENCE, True, found(no, 0.1), found(no, 0.2)),
        conclusion("plates", f"{DIFFERS}: how", False, found(yes, 1.0), found(no, 0.2)),
        conclusion("range", ONE_CANNOT_TELL, None, found(yes, 1.0), found(open_, 0.6)),
        conclusion("material:plates", NO_DIFFERENCE, True, found(no, 0.1), found(no, 0.1)),
        conclusion("plates:range", MATTERS, True, found(yes, 0.9), found(yes, 0.8)),
    )  # fmt: skip
    changed = (Change("design", "specimen.height", ("30 mm", "31 mm")),
               Change("design", "test.steps", (None, "5")))  # fmt: skip
    only = (OnlyInOne("response", "mu0", "first", "not analyzed in the other: too few"),)
    return Beside(("first", name), changed, rows, only, ("a warning",))


@pytest.fixture(scope="module")
def page(data):
    """Second page of the example with another study."""
    return with_beside(data, example())


def with_beside(data, other):
    with data_alone():
        return prepare(replace(data, beside=other)).html()[1]


def section(page):
    return page[page.index('<section id="beside">') : page.index('<section id="assumptions">')]


def test_summary_says_what_holds_what_differs_and_what_is_open():
    count, differs, unsure = (
        s.replace("\N{NO-BREAK SPACE}", " ") for s in comparison_content.summary(example())
    )
    assert count == (
        "Of 4 conclusions about single factors, 2 hold under both first and second; 1 differs; "
        "1 cannot be told in one or both."
    )
    assert differs == (
        "Plates, for the work error: matters under first (1.00 pp), no practical difference under "
        "second (0.200 pp)."
    )
    assert unsure.startswith("Range, for the work error: matters under first (1.00 pp), cannot")


def test_a_factor_that_matters_at_one_setting_is_told_with_its_difference_there():
    """An average of .3 pp is less than the .5 pp that matter: 1.4 pp at one setting is not."""
    simple = [
        SimpleEffect("a", "b", (("model.space", level),), size, None, None, 0.0, verdict)
        for level, size, verdict in (("3d", 1.4, "matters"), ("axisymmetric", -0.8, "cannot tell"))
    ]
    some = replace(found("matters", 0.3), simple_effects=tuple(simple))
    row = conclusion("plates", f"{DIFFERS}: how", False, some, found("no practical difference", 0))
    both = Beside(("first", "second"), (), (row,), (), ())
    differs = comparison_content.summary(both)[1].replace("\N{NO-BREAK SPACE}", " ")
    assert "matters under first (1.40 pp at space 3d), no practical difference under" in differs
    assert comparison_content.table(both).rows[0][4] == "matters at some settings"


def test_answer_box_says_which_conclusions_hold(page):
    box = words_of(page[page.index('id="answer"') : page.index('id="study"')])
    assert "Of 4 conclusions about single factors, 2 hold under both first and second" in box


def test_section_holds_every_number_between_responses_and_assumptions(page):
    assert page.index('id="r-mu0"') < page.index('<section id="beside">')
    assert '<a href="#beside">Compared with second</a>' in page
    said = words_of(section(page)).replace("\N{NO-BREAK SPACE}", " ")
    for part in ("1.90 pp", "1.80 to 2.00 pp", "0.020 pp", "95", ".003", "mr (lowest)", "30 mm",
                 "31 mm", "not set", "A warning.", "Only in first: response initial shear modulus",
                 "too few"):  # fmt: skip
        assert part in said, part
    # five terms are named in the first of two rows (the sixth is in a note)
    table = page.partition('aria-label="beside"')[2].partition("</table>")[0]
    assert table.count('<th scope="row">') == 5
    assert table.count("<tr><td></td><td></td><td>second</td>") == 5
    quiet = "Holds in both, no practical difference: material \N{MULTIPLICATION SIGN} plates."
    assert quiet in said


def test_names_of_users_are_escaped(data):
    other = example(EVIL)
    other = replace(
        other,
        changes=(Change("design", EVIL, (EVIL, None)),),
        only=(OnlyInOne("factor", EVIL, EVIL, EVIL),),
        warnings=(EVIL,),
        conclusions=(
            replace(other.conclusions[0], term=EVIL, response=EVIL, unit=EVIL,
                    effects=(found("matters", 1.0), found("matters", 1.0)), best=(EVIL, EVIL)),
        ),
    )  # fmt: skip
    page = with_beside(data, other)
    # the one that sorts tables
    assert page.count("<script") == 1
    assert "<script>alert" not in page
    assert "&lt;script&gt;" in section(page)
