"""The language of a report: plain order, no riddles, and numbers that are those of the data."""

import re
from dataclasses import replace
from importlib import resources

import numpy as np
import pytest

from study.record.record import Record
from study.reporting.content import methods
from study.reporting.content.report_facts import facts
from tests.reporting.example import undrawn, unreplicated, words_of

#: what no sentence of a report says, and what it says instead
NOT_USED = {
    r"\bwhether [\w× -]+ matters (these|neither)": "These data cannot show whether X matters",
    r"\bof them can tell\b": "neither study can show",
    r"\bfor want of\b": "because there is no ...",
    r"\bin lieu of\b": "instead of",
    r"\bheretofore|thereof|wherein|whereby|hitherto\b": "a sentence of its own",
    r"\bsignificant(ly)?\b": "the difference, its interval and what matters",
    r"\butili[sz]e": "use",
    r"\bobviously|clearly|of course\b": "nothing",
    r"\b(is|are|data) normal\b|normally distributed": "not rejected by a test",
    r"\bproves?\b": "shows",
    r"\b(at most|at least|below|above|within|under) [<>]": "less than 0.1 %, and no second bound",
    r"(?<!\w)# (mm|N|%|kPa)|stretch #": "dots where a number was left out",
    r"better than their number alone": "that no level or combination can be named",
    r"\d\.\d{7,}": "three significant digits",
    r"\brms\b|\banova\b": "the name as it is written: RMS, analysis of variance",
    r"\bnan\b|\bNone\b(?!: )|\binf\b": "a dash, or what is missing",
}


def breaches(text):
    return [f"{rule}: write {better}" for rule, better in NOT_USED.items() if re.search(rule, text)]


def test_no_sentence_has_a_word_that_is_not_used(html):
    assert breaches(words_of(html)) == []
    assert breaches(words_of(undrawn(unreplicated()))) == []


@pytest.mark.parametrize("text", [
    "whether material matters these data cannot tell", "a significant effect",
    "The residuals are normal.", "the two differ by at most < 0.1 % of it",
    "unstable below stretch #", "stopped at # mm of # mm", "a force of 0.028937628 N",
])  # fmt: skip
def test_the_list_of_words_finds_a_breach(text):
    assert breaches(text)


def all_failed(data):
    gone = {one.name: np.nan for one in data.analyses}
    table = data.table.assign(status="diverged", **gone)
    failed = tuple(
        Record(str(case), "s", {}, "b", "not-converged", "no equilibrium beyond 0.4 mm")
        for case in table["case_id"]
    )
    refused = tuple(replace(r, result=None, refused="every case failed") for r in data.analyses)
    return replace(data, table=table, analyses=refused, failures=failed, curves=(), fits=())


def test_a_study_of_which_every_case_failed_has_a_page(data):
    page = words_of(undrawn(all_failed(data)))
    assert "All 288 cases failed, so there is nothing to compare." in page
    assert "288 cases of 288" in page
    assert "What 288 of 288 reported: no equilibrium beyond 0.4 mm" in page
    assert "Nothing can be recommended" in page
    assert f"study why {data.table['case_id'].iloc[0]}" in page
    assert breaches(page) == []


@pytest.mark.parametrize(("rows", "failed"), [(288, 0), (288, 3), (100, 2)])
def test_the_methods_count_the_cases(data, rows, failed):
    some = tuple(Record(str(k), "s", {}, "b", "not-converged") for k in range(failed))
    text = methods.paragraph(replace(data, table=data.table.iloc[:rows], failures=some), ())
    counts = [
        int(number) for number in re.findall(r"\b(288|100|3|2)\b (?=cases|were|failed)", text)
    ]
    expected = ([288] if rows == 288 else [288, 100]) + ([failed] if failed else [])
    assert counts == expected
    assert ("none failed" in text) == (failed == 0)


def test_the_methods_say_level_and_fit(data):
    text = methods.paragraph(data, facts(data)).replace("\N{NO-BREAK SPACE}", " ")
    assert "95 %" in text
    assert "90 %" in methods.paragraph(replace(data, alpha=0.1), facts(data)).replace("\xa0", " ")


def test_no_letter_of_a_name_or_a_unit_is_made_a_capital():
    """A heading has names of the user: in capitals mN would be MN, and a-1 another level."""
    style = resources.files("study.reporting").joinpath("templates", "style.css").read_text("utf-8")
    rules = re.findall(r"([^{}]+)\{[^{}]*text-transform: uppercase", style)
    assert [rule.strip() for rule in rules] == [".kicker"]
