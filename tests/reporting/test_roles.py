"""Answers by the role of a factor: conditions, unknowns, and recommendations among choices."""

import re
from dataclasses import replace
from itertools import product

import numpy as np
import pandas as pd
import pytest

from study.reporting.content import effect_words, sentences
from study.reporting.content.report_facts import facts
from study.reporting.results.study_result import ReportData, ResponseAnalysis
from study.statistics.analysis.anova import anova

FACTORS = {"material": ("soft", "stiff"), "range": ("20 %", "60 %"), "plates": ("dry", "glued")}


def study(declared=None, glue=3.0):
    """The material matters at 60 % (soft is 5 better) and not at 20 %; glue adds ``glue``."""
    random = np.random.default_rng(1)
    rows = []
    for material, span, held, block in product(*FACTORS.values(), "abcdef"):
        gain = (5.0 if span == "60 %" else 0.1) * (material == "stiff")
        y = 10 + gain + glue * (held == "glued") + ord(block) / 50 + random.normal(0, 0.01)
        seconds = 1.0 if material == "soft" else 2.0
        rows.append((material, span, held, block, y, seconds))
    table = pd.DataFrame(rows, columns=[*FACTORS, "block", "error", "seconds"])
    result = anova(table, "error", list(FACTORS), block="block", practical=1.0, exact=False)
    response = ResponseAnalysis("error", "%", result, practical=1.0, better="lower")
    answered = {"roles": declared or {}, "analyses": (response,)}
    return ReportData("ranges", "", FACTORS, table, "phantom", tuple("abcdef"), **answered)


DECLARED = {"range": "condition", "plates": "unknown"}


def test_a_choice_is_answered_at_each_level_of_a_condition():
    data = study(DECLARED)
    (line,) = effect_words.by_condition(data, facts(data))
    assert line.startswith("Material by range, for the error: no practical difference at 20 % (")
    means = data.table.groupby(["range", "plates", "material"])["error"].mean()
    for span, sizes in zip(FACTORS["range"], re.findall(r"\(([\d.]+)", line), strict=True):
        apart = [means[span, p, "stiff"] - means[span, p, "soft"] for p in FACTORS["plates"]]
        assert float(sizes) == pytest.approx(max(apart), abs=0.005)
    assert "; it matters at 60 %" in line


@pytest.mark.parametrize(("glue", "words"), [(3.0, "Measure it."), (0.0, "need not be measured")])
def test_an_unknown_says_whether_measuring_it_pays(glue, words):
    data = study(DECLARED, glue)
    (line,) = effect_words.unknowns(data, facts(data))
    assert line.startswith("The level of plates was assumed")
    assert words in line


def test_only_choices_are_recommended():
    data = study(DECLARED)
    found = facts(data)
    use = sentences.recommendation(data, found[0])
    assert [word in use for word in ("soft", "dry", "glued")] == [True, False, False]
    first = sentences.answer(data, found)[0]
    words = ("choice of material", "plates", "range")
    assert [word in first for word in words] == [True, False, False]


def test_all_factors_are_choices_unless_said_otherwise():
    data = study()
    assert effect_words.factors_of(data, effect_words.CHOICE) == list(FACTORS)
    assert "dry" in sentences.recommendation(data, facts(data)[0])


def test_the_best_cell_is_not_called_cheapest_where_another_is_cheaper():
    """The best cell takes 2.0 s; one within reach takes 1.7 s, a gain too small to give it up."""
    data = study()
    dry = data.table["plates"] == "dry"
    table = data.table.assign(seconds=np.where(dry, 2.0, 1.7), error=np.where(dry, 9.5, 10.0))
    said = sentences.recommendation(replace(data, table=table), facts(data)[0])
    assert "dry" in said
    assert "the cheapest of those as good in practice takes 85" in said


def test_an_unknown_that_matters_at_some_settings_is_said_with_its_difference_there():
    """Of the material 5 at 60 % and .1 at 20 %, on average 2.5, which is less than the 3 asked."""
    data = study({"material": "unknown"})
    result = anova(data.table, "error", list(FACTORS), block="block", practical=3.0, exact=False)
    response = replace(data.analyses[0], result=result, practical=3.0)
    (line,) = effect_words.unknowns(data, facts(replace(data, analyses=(response,))))
    assert re.search(r"changes the error by (4\.9\d|5\.0\d)\spp \(at range 60 %", line)
    assert line.endswith("Measure it.")
