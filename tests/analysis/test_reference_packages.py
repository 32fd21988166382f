"""Simple effects, named contrasts, variance components and a surface against packages of R.

Other code: emmeans 1.8.4, lme4 1.1.31 and lm of R 4.2.2; figures of
validation/statistics/reference_packages.R. What is solved directly is compared at 1e-8; variance
components come from two optimizers, at 1e-5.
"""

from functools import partial

import pytest
from scipy import stats

import study
from tests.analysis.test_reference_r import FOLDER, data
from tests.analysis.test_reference_r import reference as figures_of

SAME = 1e-8
reference = partial(figures_of, "reference_packages")


def crossed(design):
    return data("crossed", whole=not design.endswith("unbalanced"))


@pytest.mark.parametrize("design", ["crossed", "crossed-unbalanced"])
def test_simple_effects_are_those_of_emmeans(design):
    found = study.anova(crossed(design), "y", ["a", "b", "c"], practical=1.0, exact=False)
    effects = found.effect("a").simple_effects
    assert len(effects) == 3 * 4  # three pairs at four settings
    for one in effects:
        at = dict(one.at)
        term = f"{one.first}-{one.second}|{at['b']}|{at['c']}"
        r = {q: reference()[design, "simple", term, q] for q in ("difference", "error", "df")}
        assert one.difference == pytest.approx(r["difference"], rel=SAME)
        half = stats.t.ppf(0.975, r["df"]) * r["error"]
        assert (one.ci[1] - one.ci[0]) / 2 == pytest.approx(half, rel=SAME)


@pytest.mark.parametrize("design", ["crossed", "crossed-unbalanced"])
def test_a_named_contrast_is_that_of_emmeans(design):
    found = study.anova(crossed(design), "y", ["a", "b", "c"], practical=1.0, exact=False)
    (one,) = study.contrasts(found, "a=a1, b=b1 - a=a1, b=b2")
    r = {q: reference()[design, "contrast", "a1|b1-a1|b2", q] for q in ("estimate", "p.value")}
    assert one.difference == pytest.approx(r["estimate"], rel=SAME)
    assert one.p == pytest.approx(r["p.value"], rel=SAME)


def test_variance_components_of_incomplete_blocks_are_those_of_lme4():
    blocks, within = study.mixed_model(data("incomplete"), "y", ["t"], block="k").components
    assert blocks.sd == pytest.approx(reference()["incomplete", "reml", "k", "sd"], rel=1e-5)
    assert within.sd == pytest.approx(reference()["incomplete", "reml", "within", "sd"], rel=1e-5)


#: ranges of the coded variables of textbook designs, with their names in R
SURFACES = {
    "chemical_process": ("yield", {"x": "time_min=80..90", "z": "temperature_F=170..180"}),
    "paper_helicopter": (
        "flight_time_cs",
        {
            "a": "wing_area_in2=11.8..13",
            "r": "wing_ratio=2.26..2.78",
            "w": "body_width_in=1..1.5",
            "l": "body_length_in=1.5..2.5",
        },
    ),
}


@pytest.mark.parametrize("design", SURFACES)
def test_a_second_order_surface_is_that_of_lm(design):
    response, ranges = SURFACES[design]
    surface = study.fit_surface(FOLDER / f"{design}.csv", response, [*ranges.values()]).to_json()
    found = surface["surface"]
    short = {text.partition("=")[0]: name for name, text in ranges.items()}
    told = {_short(t["term"], short): t["coefficient"] for t in found["terms"]}

    def of_r(quantity):
        keys = [key for key in reference() if key[:2] == (design, "surface") and key[3] == quantity]
        return {key[2].replace("*", ":"): reference()[key] for key in keys}

    assert told == pytest.approx(of_r("coefficient"), rel=SAME)
    point = found["stationary"]
    at = dict(zip(ranges, point["coded"], strict=True))
    assert at == pytest.approx(of_r("stationary"), rel=SAME)
    assert sorted(point["eigenvalues"]) == pytest.approx([*of_r("eigenvalue").values()], rel=SAME)
    assert found["lack_of_fit"]["F"] == pytest.approx(of_r("lack_of_fit_F")[""], rel=SAME)
    assert found["lack_of_fit"]["p"] == pytest.approx(of_r("lack_of_fit_p")[""], rel=SAME)


def _short(term, names):
    for name, own in names.items():
        term = term.replace(name, own)
    return term


def test_linear_terms_and_products_of_paper_helicopters_are_those_printed():
    """As Lenth (2009), J. Stat. Softw. 32(7), has them beside the two blocks of the design."""
    response, ranges = SURFACES["paper_helicopter"]
    found = study.fit_surface(FOLDER / "paper_helicopter.csv", response, [*ranges.values()])
    terms = {t["term"]: t["coefficient"] for t in found.to_json()["surface"]["terms"]}
    printed = [-0.08, 5.08, 0.25, -6.08, -2.88, -3.75, 4.38, 4.63, -1.50, -2.13]
    told = [value for term, value in terms.items() if term != "1" and "^2" not in term]
    assert told == pytest.approx(printed, abs=0.0051)
