"""Sentences say what the numbers say: wording pinned."""

from dataclasses import replace

import pandas as pd
import pytest

from study.record.record import Record
from study.reporting.content import (
    analysis_content,
    effect_words,
    methods,
    sentences,
    surface_content,
)
from study.reporting.content.report_facts import Facts, facts
from study.reporting.content.sentences import cheaper, recommendation, recommendations, would_change
from study.reporting.results.study_result import ReportData
from study.statistics.analysis.analysis_request import AnalysisRequest
from study.statistics.analysis.analysis_result import AnalysisResult, Assumptions
from study.statistics.analysis.anova_table import Effect, ErrorTerm, SimpleEffect
from study.statistics.analysis.data import prepare
from study.statistics.analysis.effects import Scale
from study.statistics.analysis.equal_variance import SpreadTest
from study.statistics.analysis.normality import RyanJoinerResult
from study.statistics.analysis.simple_effects import (
    CANNOT_TELL,
    MATTERS,
    NO_DIFFERENCE,
    NOT_RESOLVED,
    ONE_SPECIMEN,
)
from study.statistics.convergence.contrast_bound import TermBounds
from study.statistics.surfaces.surface_result import FittedSurface, LevelDifference
from tests.reporting.example import undrawn

EMPTY = ReportData("none", "", {}, pd.DataFrame())


def flat(text):
    return text.replace("\N{NO-BREAK SPACE}", " ")


def effect(verdict, **changes):
    levels = ("frictionless", "bonded")
    known = {"largest": levels[::-1], "practical": 0.5, "p": 0.001}
    return replace(
        Effect("plates", levels, (5.0, 6.2), (0.9, 1.5), 1.2, verdict, **known), **changes
    )


def error():
    title = "relative RMS force error"
    return Facts("relative_rms_force_error", "%", better="lower", title=title)


def modulus():
    return Facts("mu0", "kPa", transform="log", title="initial shear modulus")


def with_result(facts, assumptions, *, u_num_by_term=False):
    """Facts of a response whose analysis holds these tests and nothing else."""
    rows = pd.DataFrame({"plates": ["bonded", "free"] * 2, facts.name: [1.0, 2.0, 1.5, 2.5]})
    result = AnalysisResult(
        AnalysisRequest(facts.name, ("plates",)),
        prepare(rows, facts.name, ["plates"]),
        (("plates",),),
        0.0,
        error_term=ErrorTerm("E1", "", 1.0),
        assumptions=assumptions,
        scale=Scale("none", None, TermBounds({"plates": 0.04}) if u_num_by_term else None, False),
    )
    return replace(facts, result=result)


def test_an_open_verdict_names_the_difference_its_interval_and_why():
    # a small p does not decide
    one = effect(CANNOT_TELL, ci95=(0.1, 2.3), p=0.0001, why="the interval crosses")
    assert flat(effect_words.open_verdict(one, error())) == (
        "Plates: these data cannot show whether it matters for the relative RMS force error; the "
        "largest difference is 1.20 pp (95 % interval 0.10 to 2.30 pp) against 0.5 pp that "
        "matters (the interval crosses)."
    )


@pytest.mark.parametrize(
    ("exact", "printed", "rejected"),
    [
        (0.061, "0.048", False),  # the simulated p decides
        (0.02, "> 0.100", True),
        (None, "0.048", True),
        (None, "> 0.100", False),
        (None, "< 0.010", True),
    ],
)
def test_normality_is_rejected_or_not_rejected(exact, printed, rejected):
    found = RyanJoinerResult(0.9871, 30, printed, exact, 10_000, 1, "", "")
    tested = with_result(error(), Assumptions(normality=found))
    text = effect_words.normality_phrase(tested, 0.05)
    assert ("is rejected" in text) is rejected
    assert ("not rejected" in text) is not rejected
    assert tested.result is not None
    table = analysis_content.checks(tested.result)
    assert table is not None
    assert table.rows[0][:3] == ("normality", "Ryan-Joiner (n = 30)", "0.9871")


NORMAL, SPREAD = "Residuals as from a normal distribution", "Equal spread of the cells"
MISSING = SpreadTest(None, None, None, "group a has zero variance")
LEVENE = SpreadTest(9.0, (3, 20), 0.03, p_monte_carlo=0.2)


@pytest.mark.parametrize(
    ("tests", "name", "outcome", "finding"),
    [
        (Assumptions(bartlett=MISSING), NORMAL, "not applicable",
         "Ryan-Joiner: there are no residuals to test"),
        (Assumptions(bartlett=MISSING), SPREAD, "not applicable",
         "neither Bartlett's nor Levene's test applies: group a has zero variance"),
        # the simulated p decides
        (Assumptions(levene=LEVENE), SPREAD, "pass", "not rejected (Levene p = .200)"),
    ],
)  # fmt: skip
def test_a_check_says_why(tests, name, outcome, finding):
    tested = replace(with_result(error(), tests), terms=(effect(MATTERS),))
    (check,) = [c for c in analysis_content.all_checks(EMPTY, (tested,)) if c.name == name]
    assert (check.outcome, check.finding) == (outcome, finding)
    assert tested.result is not None
    shown = analysis_content.checks(tested.result)
    assert (shown is None) is (tests.levene is None)


def test_methods_name_the_tests_that_ran_and_no_other():
    tests = Assumptions(bartlett=MISSING, levene=LEVENE)
    one = replace(with_result(error(), tests), terms=(effect(MATTERS),))
    none = replace(with_result(modulus(), Assumptions()), terms=(effect(MATTERS),))
    assert methods.residual_tests((none,), EMPTY) == ""
    text = "Residuals were examined by Levene's test of equal spread"
    assert methods.residual_tests((one,), EMPTY) == f"{text}."
    both = methods.residual_tests((one, none), EMPTY)
    assert both == f"{text} (of the relative RMS force error)."


def test_failures_are_said_plainly():
    assert sentences.failures((), 144) == "None: all 144 cases gave a response."
    items = [Record("a", "s", {}, "b", "timeout"), Record("c", "s", {}, "d", "timeout")]
    text = flat(sentences.failures(items, 100))
    assert text.startswith("2 cases of 100 (2.00 %) failed: 2 timeout.")
    assert "not missing at random" in text


def test_answer_is_three_sentences_of_the_example(data):
    found = facts(data)
    which, contrast, best = (flat(line) for line in sentences.answer(data, found))
    assert "material (1.76 pp between extremes) matters" in which
    assert "plates (\N{MULTIPLICATION SIGN} 1.37)" in which
    # on average plates make .18 pp, yet one simple effect reaches to .81 pp and .5 pp matter
    assert contrast == (
        "The choice of material changes the relative RMS force error by 1.76 pp; these data cannot "
        "show whether it changes the initial shear modulus."
    )
    assert best.startswith("Use mooney-rivlin")


def test_the_answer_names_levels_that_no_effect_covers(data):
    found = facts(data)
    assert "Left out" not in " ".join(sentences.answer(data, found))
    name, levels = next(iter(data.factors.items()))
    more = replace(data, factors={**data.factors, name: (*levels, "ogden-9")})
    why = "more than half of their cases failed, or every one on the finest mesh"
    assert f"Left out, because {why}: ogden-9." in sentences.answer(more, found)[0]
    numbered = replace(data, factors={**data.factors, name: (*levels, "9")})
    assert f": {name} 9." in sentences.answer(numbered, found)[0]


def test_one_factor_alone_has_no_interaction_to_speak_of(data):
    one = replace(data, factors={"material": data.factors["material"]})
    assert sentences.interactions(one, ()) == ""
    assert "Interactions are no part" in sentences.interactions(data, ())


def test_virtual_specimens_are_said_to_be_virtual(data):
    virtual = replace(data, virtual=True)
    few = replace(virtual, analyses=data.analyses[:1], curves=(), fits=())
    assert "scatter of their generator" in undrawn(few)
    assert "real measurements" in would_change(virtual, facts(virtual))


def test_error_term_is_said_once_for_responses_that_share_it(data):
    said = sentences.error_terms(data, facts(data))
    assert [who for who, text in said if text.startswith("The error term")] == [""]
    assert all(text.endswith((".", "?")) for _, text in said)


def test_an_effect_is_no_finer_than_a_thousandth_of_what_matters():
    tiny = effect(NO_DIFFERENCE, range=0.000267, ci95=(-3.91e-5, 0.000574))
    assert flat(effect_words.size(tiny, error())) == "< 0.001 pp"
    same = effect(MATTERS, range=1.43363, ci95=(1.43362, 1.43364), practical=1.1, scale="ratio")
    apart = replace(same, ci95=(1.4334, 1.4338))
    each = ((tiny, error()), (same, modulus()), (apart, modulus()))
    assert [flat(effect_words.size_interval(*of)) for of in each] == [
        "0.000 to 0.001 pp", "narrower than 0.0001", "1.433 to 1.434",
    ]  # fmt: skip
    # ln 1.43363 = 0.3602; over 7.4 is 0.04867, a factor of 1.0499
    one = replace(same, u_num=0.85, effect_over_u_num=7.4)
    assert flat(effect_words.numerical(one, modulus())) == "\N{MULTIPLICATION SIGN} 1.05"


def test_the_cheaper_level_of_the_model_is_named_and_no_other_factor(data):
    text = flat(cheaper(data, facts(data)[0]))
    assert text.startswith("Space: axisymmetric is enough")
    assert "plates" not in text.lower()


def test_replicates_are_not_advised_where_one_specimen_is_the_reason(data):
    doubt = replace(effect(CANNOT_TELL), why=ONE_SPECIMEN)
    text = would_change(data, (replace(facts(data)[0], terms=(doubt,)),))
    assert "easurements of more specimens, for one tells nothing of" in text
    assert "would narrow" not in text


def test_recommendation_takes_the_cheapest_within_what_matters(data):
    table = data.table.copy()
    slow = (table["material"] == "mooney-rivlin") & (table["plates"] == "frictionless")
    table.loc[slow, "seconds"] = 500.0
    text = flat(recommendation(replace(data, table=table), facts(data)[0]))
    assert text.startswith("Use reduced-polynomial-3, frictionless")
    assert "less than the 0.5 pp that matters" in text
    assert "8.3 min" in text


def test_the_fastest_cell_is_not_recommended_against_the_one_within_what_matters(data):
    error = facts(data)[0]
    time = replace(error, name="seconds")
    assert recommendations(data, [time, error]) == (recommendation(data, error),)
    assert len(recommendations(data, [time])) == 1


def test_without_computing_times_the_best_cell_is_recommended(data):
    text = flat(recommendation(replace(data, table=data.table.drop(columns="seconds")),
                               facts(data)[0]))  # fmt: skip
    assert text.startswith("Use mooney-rivlin, frictionless")
    assert "4.83 %; " in text
    assert text.endswith("within 0.5 pp of it.")


def test_the_number_beside_an_effect_is_explained():
    known = replace(error(), terms=(effect(MATTERS, u_num=0.04),))
    own = with_result(known, Assumptions(), u_num_by_term=True)
    assert "is the same for every factor" in sentences.numerical([known])
    assert sentences.numerical([own, own]).endswith('"Numerical error").')
    assert "mesh error of the difference" in sentences.numerical([own, own])
    assert "time step error of the difference" in sentences.numerical([own], "time step")
    # of meshes where one is a factor, and of no other factor
    named = replace(own, terms=(replace(own.terms[0], term="model.mesh", u_num=None), *own.terms))
    assert "For mesh density" in sentences.numerical([named])
    assert "no bound is known" not in sentences.numerical([named])
    mixed = sentences.numerical([own, known])
    assert mixed.startswith("For the relative RMS force error, U bounds")
    assert "Elsewhere U, the bound" in mixed
    assert sentences.numerical([replace(error(), terms=(effect(MATTERS),))]) == ""


def test_a_factor_that_the_mesh_leaves_open_names_the_setting_and_the_bound_there():
    # U of the average difference is small enough: the setting with the larger U decides
    at = (("plates", "bonded"), ("material", "yeoh"))
    settings = (
        SimpleEffect("2", "1", (("plates", "free"),), 1.0, (1.0, 1.0), None, 0.0, NO_DIFFERENCE),
        SimpleEffect("2", "1", at, 1.02, (1.019, 1.021), None, 2.0, NOT_RESOLVED),
    )
    order = effect(
        NOT_RESOLVED, term="order", scale="ratio", range=1.01, ci95=(1.009, 1.011), practical=1.1,
        u_num=0.3, u_needed=1.4, u_unit=0.05, simple_effects=settings,
    )  # fmt: skip
    said = flat(effect_words.open_verdict(order, modulus()))
    # exp(0.05 * 2.0) = 1.105, exp(0.05 * 1.4) = 1.073: the average's exp(0.05 * 0.3) is not named
    assert said == (
        "Order: not resolved by the mesh; on average the largest difference in the initial shear "
        "modulus is \u00d7 1.010 (95 % interval 1.009 to 1.011); at plates bonded, material yeoh "
        "it is \u00d7 1.020, and the numerical uncertainty there, \u00d7 1.11, would have to be "
        "below \u00d7 1.07."
    )
    pair = SimpleEffect("b", "c", (), 1.03, (1.02, 1.04), None, 2.0, NOT_RESOLVED)
    unknown = (*settings, replace(settings[1], difference=1.03, u=None))
    for other, words in (
        (replace(order, largest=("a", "c"), simple_effects=(pair,)),
         "; between b and c it is \u00d7 1.030, and the numerical uncertainty there"),
        (replace(order, simple_effects=unknown),
         "at plates bonded, material yeoh it is \u00d7 1.030, and the numerical uncertainty "
         "there, which these meshes do not bound, would have to be below \u00d7 1.07."),
        (replace(order, simple_effects=()),
         "and its numerical uncertainty \u00d7 1.02 would have to be below"),
    ):  # fmt: skip
        assert words in flat(effect_words.open_verdict(other, modulus()))


def test_what_would_change_an_effect_that_the_mesh_leaves_open(data):
    why = "the numerical uncertainty would have to be below 0.2"
    few = replace(error(), terms=(effect(CANNOT_TELL, why="the interval crosses the threshold"),))
    coarse = replace(error(), terms=(effect(NOT_RESOLVED, term="order", why=why),))
    text = would_change(data, [few, coarse])
    assert "would narrow the interval of plates; finer meshes could resolve order" in flat(text)
    assert "narrow" not in would_change(data, [coarse])
    # runs that were read from a table have no mesh, and no program that could refine one
    notes = ("29 runs were made elsewhere and read from runs.csv",)
    text = would_change(replace(data, is_measured=False, data_notes=notes), [few])
    assert "More phantoms would narrow the interval of plates" in flat(text)
    assert "mesh" not in text


@pytest.mark.parametrize(
    ("title", "noun"),
    [
        ("C10", "C10"),
        ("overshoot", "the overshoot"),
        ("stiffness at 4 mm", "the stiffness at 4 mm"),
    ],
)
def test_a_symbol_has_no_article(title, noun):
    assert Facts("any", "", title=title).noun == noun


def test_an_assumed_factor_tells_the_setting_of_each_response_apart():
    there, elsewhere = (
        SimpleEffect("bonded", "frictionless", (("material", level),), size, None, None, 0.0, word)
        for level, size, word in (("soft", 1.3, MATTERS), ("stiff", -0.7, CANNOT_TELL))
    )
    some = effect(MATTERS, range=0.3, ci95=(0.2, 0.4), simple_effects=(there, elsewhere))
    every = effect(MATTERS, range=9.0, practical=1.0)
    named = {"plates": ("frictionless", "bonded"), "material": ("soft", "stiff")}
    data = replace(EMPTY, factors=named, roles={"plates": "unknown"})
    both = [replace(f, terms=(e,)) for f, e in ((error(), some), (modulus(), every))]
    assert [flat(line) for line in effect_words.unknowns(data, both)] == [
        "The level of plates was assumed, and it changes the relative RMS force error by 1.30 pp "
        "(at material soft) and the initial shear modulus by 9.00 kPa. Measure it."
    ]


@pytest.mark.parametrize(
    ("ends", "words"),
    [
        ((2.0, 4.0), "this matters at 95 % of the settings"),
        # less than .5 +- .1 at some of the 95 %
        ((0.55, 4.0), "this matters at some settings"),
        ((-4.0, -2.0), "this matters at 95 % of the settings"),
        ((-4.0, 1.0), "this matters at some settings"),
    ],
)
def test_a_difference_between_surfaces_says_at_how_many_settings_it_matters(ends, words):
    mean = sum(ends) / 2
    difference = LevelDifference("plates", "bonded", "free", mean, *ends, 0.1, MATTERS)
    fitted = FittedSurface("force", "N", None, practical=0.5, differences=(difference,))
    (line,) = surface_content.differences(fitted, EMPTY)
    assert flat(line).endswith(f"; with 0.5 N as what matters, {words}.")
