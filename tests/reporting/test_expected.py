"""What was expected stands beside what was found."""

from dataclasses import replace

import pytest

from study.ground.contrast import Expected
from study.reporting.content import effect_words
from study.reporting.content.report_facts import facts
from tests.reporting.example import undrawn

SCORE, MODULUS = "relative_rms_force_error", "mu0"
BEST = {"material": "reduced-polynomial-3", "plates": "bonded"}


def judged(data, *items):
    whole = replace(data, expected=items)
    return list(effect_words.table(whole, facts(whole)).rows)


def test_an_effect_is_larger_where_intervals_do_not_overlap(data):
    pair = ("plates", "model.space")
    there, back = judged(
        data,
        Expected("larger", pair, (), MODULUS, "me"),
        Expected("larger", pair[::-1], (), MODULUS),
    )
    assert there[:2] == ("plates has a larger effect than space", "me")
    assert there[3] == "holds"
    assert back[3] == "does not hold"
    (same,) = judged(data, Expected("larger", ("plates", "plates"), (), MODULUS))
    assert same[3] == "cannot tell"


def test_a_factor_matters_as_its_verdict_says(data):
    for facts_of in facts(data):
        for effect in facts_of.effects:
            (row,) = judged(data, Expected("matters", (effect.term,), (), facts_of.name))
            words = {"matters": "holds", "no practical difference": "does not hold"}
            assert row[3] == words.get(effect.verdict, "cannot tell")


def test_cells_are_compared_by_their_means_with_what_matters(data):
    known = data.table.dropna(subset=[SCORE])
    means = known.groupby(list(BEST))[SCORE].mean()
    top = dict(zip(BEST, means.idxmin(), strict=True))
    last = dict(zip(BEST, means.idxmax(), strict=True))
    assert means.max() - means.min() > 0.5
    rows = judged(
        data,
        Expected("best", (), (top,), SCORE),
        Expected("best", (), (last,), SCORE),
        Expected("close", (), (top, last), SCORE),
        Expected("close", (), (top, top), SCORE),
    )
    assert [row[3] for row in rows] == ["holds", "does not hold", "does not hold", "holds"]
    assert f"{means.min():.3g}" in rows[0][2]
    assert "0.5" in rows[2][2]


def test_what_the_study_cannot_answer_is_said(data):
    gone = {"material": "ogden-1", "plates": "bonded"}
    (row,) = judged(data, Expected("best", (), (gone,), SCORE))
    assert row[2:] == ("The study has no answer.", "cannot tell")


@pytest.mark.parametrize("stated", [True, False])
def test_the_page_shows_them_where_there_are_any(data, stated):
    item = Expected("matters", ("plates",), (), MODULUS, "<b>me</b>")
    page = undrawn(replace(data, expected=(item,) if stated else ()))
    assert ('id="expected"' in page) is stated
    assert "<b>me</b>" not in page


def effect_of(data, response, factor):
    of = next(item for item in facts(data) if item.name == response)
    return next(effect for effect in of.effects if effect.term == factor)


def test_a_direction_holds_on_one_side_alone(data):
    effect = effect_of(data, MODULUS, "plates")
    top, low = effect.highest, effect.lowest
    assert effect.pairs[0].different
    rows = judged(
        data,
        Expected("fewer", (), ({"plates": low},), MODULUS),
        Expected("fewer", (), ({"plates": top}, {"plates": low}), MODULUS),
        Expected("better", (), ({"plates": top},), MODULUS),
    )
    # a modulus is neither good nor bad
    assert [row[3] for row in rows] == ["holds", "does not hold", "cannot tell"]
    assert rows[0][0] == f"{low} needs less than the others"


def test_an_error_is_better_where_it_is_smaller(data):
    best = {"material": effect_of(data, SCORE, "material").lowest}
    better, fewer = judged(
        data, Expected("better", (), (best,), SCORE), Expected("fewer", (), (best,), SCORE)
    )
    assert better[3] == fewer[3] != "does not hold"
