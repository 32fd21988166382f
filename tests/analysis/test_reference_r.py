"""Every design family against R (aov, lm, car): figures of validation/statistics/reference.R.

Other code: R 4.2.2 and car 3.1, sum-to-zero contrasts. The bar is 1e-8; p far in a tail is
allowed 1e-7 because its logarithm is what is as accurate as F.
"""

from functools import cache
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy.special import chdtrc

from study.statistics.analysis.anova import anova
from study.statistics.analysis.assumptions import box_cox, hc3
from study.statistics.analysis.data import prepare
from study.statistics.analysis.equal_variance import bartlett, levene
from study.statistics.analysis.linear_model import model_matrix, terms_of
from study.statistics.analysis.normality import shapiro_wilk
from study.statistics.analysis.sums_of_squares import factor, influence, summary_of

pytestmark = pytest.mark.verify
FOLDER = Path(__file__).resolve().parents[2] / "validation" / "statistics"


@cache
def reference(name="reference_r"):
    table = pd.read_csv(FOLDER / f"{name}.csv", comment="#", keep_default_na=False)
    keys = table[["design", "analysis", "term", "quantity"]].itertuples(index=False, name=None)
    return dict(zip(keys, table["value"].astype(float), strict=True))


def terms(design, analysis):
    found = {}
    for (d, a, term, quantity), value in reference().items():
        if (d, a) == (design, analysis):
            found.setdefault(term, {})[quantity] = value
    assert found, f"no reference for {design} {analysis}"
    return found


def mauchly_of_r(sphere, n, figures, cells):
    """P of R with the slip of its second term mended.

    R 4.2.2 and car write 3 p with p the number of cells where Anderson's expansion has the
    number d of contrasts; R's own figure is reproduced first, so that nothing else differs.
    """
    d = int((np.sqrt(9 + 8 * sphere.df) - 1) / 2)
    rho = 1 - (2 * d * d + d + 2) / (6 * d * n)

    def p(last):
        top = (d + 2) * (d - 1) * (d - 2) * (2 * d**3 + 6 * d**2 + 3 * last + 2)
        second = top / (288 * (n * d * rho) ** 2)
        first, higher = chdtrc(sphere.df, sphere.chi2), chdtrc(sphere.df + 4, sphere.chi2)
        return float(first + second * (higher - first))

    assert p(cells) == pytest.approx(figures["mauchly_p"], rel=1e-8)
    return p(d)


def data(name, *, whole=True):
    table = pd.read_csv(FOLDER / f"{name}.csv")
    return table if whole else table[table["keep"] == 1]


def same_row(row, expected):
    for quantity, value in expected.items():
        if quantity.startswith("mauchly") or quantity == "ss_error":
            continue
        got = getattr(row, quantity)
        error = (got - value) / value
        print(f"{row.term} {quantity}: expected {value:.12g}, got {got:.12g}, error {error:.1e}")
        assert got == pytest.approx(value, rel=1e-7 if quantity == "p" else 1e-8), quantity


def same_table(result, expected):
    compared = 0
    for term, figures in expected.items():
        name = "residual" if term == "Residuals" else term
        # R lists the blocks as a term like the others
        if name in {row.term for row in result.anova.rows}:
            same_row(result.anova.row(name), figures)
            compared += 1
    return compared


LINEAR = {
    "crossed": ("crossed", True, {}, ["a", "b", "c"]),
    "crossed-unbalanced": ("crossed", False, {}, ["a", "b", "c"]),
    "blocked": ("blocked", True, {"block": "s", "error": "pooled"}, ["a", "b"]),
    "blocked-unbalanced": ("blocked", False, {"block": "s", "error": "pooled"}, ["a", "b"]),
    "incomplete": ("incomplete", True, {"block": "k", "error": "pooled"}, ["t"]),
    "latin": ("latin", True, {"block": ["r", "c"]}, ["t"]),
    "fraction": ("fraction", True, {"model": [*"ABCD", "A:B", "A:C", "B:C"]}, list("ABCD")),
}


@pytest.mark.parametrize("kind", ["I", "II", "III"])
@pytest.mark.parametrize("design", LINEAR)
def test_linear_models_of_all_types(design, kind):
    name, whole, options, factors = LINEAR[design]
    print(f"\n{design}, type {kind}")
    result = anova(data(name, whole=whole), "y", factors, type=kind, exact=False, **options)
    # every term of ours and the residual; the blocks are no rows of a pooled table
    assert same_table(result, terms(design, kind)) == len(result.anova.rows)


@pytest.mark.parametrize("whole", [True, False])
def test_nested_labels_may_start_again_or_be_unique(whole):
    table = data("nested", whole=whole)
    unique = table.assign(specimen=table["mix"] + "-" + table["specimen"].astype(str))
    expected = terms("nested" if whole else "nested-unbalanced", "I")
    options = {"model": ["mix", "mix:specimen"], "practical": 1.0, "exact": False}
    first = anova(table, "y", ["mix", "specimen"], type="I", **options)
    assert same_table(first, expected) == 3
    for rows in (table, unique):
        result = anova(rows, "y", ["mix", "specimen"], **options)
        assert result.anova.type == "II"
        for term in ("mix", "mix:specimen"):
            assert result.anova.row(term).df == expected[term]["df"]
        ss = expected["mix:specimen"]["ss"]
        assert result.anova.row("mix:specimen").ss == pytest.approx(ss, rel=1e-8)
        # means of the specimens' means, whatever their labels
        by_hand = rows.groupby(["mix", "specimen"])["y"].mean().groupby("mix").mean()
        assert result.effect("mix").mean == pytest.approx(by_hand.tolist(), rel=1e-10)
        assert any("use --unit specimen" in w for w in result.notes)


def test_units_nested_in_cells_give_the_error_of_the_upper_stratum():
    table = data("nested").assign(unit=lambda t: t["mix"] + t["specimen"].astype(str))
    expected = terms("nested", "strata|mix:specimen")
    averaged = anova(table, "y", ["mix"], unit="specimen", exact=False).anova.row("mix")
    blocked = anova(table, "y", ["mix"], block="unit", exact=False).anova.row("mix")
    for row in (averaged, blocked):
        assert row.f == pytest.approx(expected["mix"]["f"], rel=1e-8)
        assert row.p == pytest.approx(expected["mix"]["p"], rel=1e-8)
        assert row.df_error == expected["Residuals"]["df"]


@pytest.mark.parametrize("design", ["splitplot", "splitplot-unbalanced"])
def test_split_plot_where_the_block_is_the_whole_plot(design):
    table = data("splitplot", whole=design == "splitplot")
    result = anova(
        table, "y", ["mix", "speed"], block="specimen", type="I", error="pooled", exact=False
    )
    between, within = terms(design, "strata|specimen"), terms(design, "strata|Within")
    same_row(result.anova.row("mix"), between["mix"])
    same_row(result.anova.row("specimen"), between["Residuals"])
    for term in ("speed", "mix:speed"):
        same_row(result.anova.row(term), within[term])
    same_row(result.anova.row("residual"), within["Residuals"])
    assert result.error_term.source == "E1"
    of_speed = dict.fromkeys(("speed", "mix:speed"), within["Residuals"]["df"])
    assert result.error_term.df == {"mix": between["Residuals"]["df"], **of_speed}
    assert result.anova.row("mix").error == "specimen"


def test_split_plot_in_blocks():
    table = data("splitblocks")
    result = anova(table, "y", ["v", "n"], block="k", whole_plot="v", exact=False)
    whole, within = terms("splitblocks", "strata|k:v"), terms("splitblocks", "strata|Within")
    same_row(result.anova.row("k"), terms("splitblocks", "strata|k")["Residuals"])
    same_row(result.anova.row("v"), whole["v"])
    same_row(result.anova.row("k:v"), whole["Residuals"])
    for term in ("n", "v:n"):
        same_row(result.anova.row(term), within[term])
    # differences of subplot levels in one whole plot have the smaller error
    assert result.effect("n").ci95 is not None
    naive = anova(table, "y", ["v", "n"], block="k", error="pooled", exact=False)
    assert naive.anova.row("v").df_error == 55
    assert naive.anova.row("v").p < result.anova.row("v").p


@pytest.mark.parametrize(
    ("design", "kind"),
    [*product(("splitplot", "splitplot-uneven"), ("II", "III")), ("repeated", "III")],
)
def test_own_interactions_with_greenhouse_geisser_and_mauchly(design, kind, monkeypatch):
    """R's car has one covariance for all groups, which is here that of groups of two blocks."""
    monkeypatch.setattr("study.statistics.analysis.strata.LEAST_OWN", 99)
    if design == "repeated":
        table, factors, block, groups, cells = data("repeated"), ["a", "b"], "s", 1, 9
    else:
        table, factors, block, groups, cells = data("splitplot"), ["mix", "speed"], "specimen", 3, 4
    if design == "splitplot-uneven":
        table = table[table["specimen"] != "s12"]
    asked = {"block": block, "type": kind, "exact": False}
    result = anova(table, "y", factors, error="own", **asked)
    for term, figures in terms(design, f"own-{kind}").items():
        row = result.anova.row(term)
        same_row(row, figures)
        assert result.anova.row(row.error or "").ss == pytest.approx(figures["ss_error"], rel=1e-8)
        # of a table with groups of blocks, one term of a stratum has the test
        if "mauchly_w" in figures and term != "mix:speed":
            sphere, n = result.assumptions.sphericity[term], table[block].nunique() - groups
            assert sphere.w == pytest.approx(figures["mauchly_w"], rel=1e-8)
            assert sphere.p == pytest.approx(mauchly_of_r(sphere, n, figures, cells), rel=1e-8)
    if (design, kind) != ("splitplot-uneven", "II"):  # unbalanced records take Type III
        # a study's records take the same route by themselves
        study = anova(table, "y", factors, records=True, **asked)
        term = factors[1]
        assert study.anova.row(term).p_gg == result.anova.row(term).p_gg


def test_means_with_intervals_of_unbalanced_data():
    result = anova(data("crossed", whole=False), "y", ["a", "b"], exact=False)
    effect = result.effect("a")
    for level, mean, ci in zip(effect.levels, effect.mean, effect.mean_ci95, strict=True):
        expected = terms("crossed-unbalanced", "mean")[level]
        assert mean == pytest.approx(expected["mean"], rel=1e-10)
        assert ci == pytest.approx((expected["low"], expected["high"]), rel=1e-8)


def test_spread_tests_to_ten_digits():
    table = data("crossed", whole=False)
    groups = {str(k): g["y"].to_numpy() for k, g in table.groupby(["a", "b"])}
    expected = terms("crossed-unbalanced", "bartlett")[""]
    assert bartlett(groups).statistic == pytest.approx(expected["statistic"], rel=1e-10)
    assert bartlett(groups).p == pytest.approx(expected["p"], rel=1e-10)
    for center in ("median", "mean"):
        expected = terms("crossed-unbalanced", f"levene-{center}")[""]
        found = levene(groups, center=center)
        assert found.statistic == pytest.approx(expected["statistic"], rel=1e-10)
        assert found.p == pytest.approx(expected["p"], rel=1e-10)


def test_remedies_and_summary():
    table = data("crossed", whole=False)
    checked = prepare(table, "y", ["a", "b"])
    fit = factor(model_matrix(checked.layout, terms_of(["a", "b"])), checked.y)
    for term, figures in terms("crossed-unbalanced", "HC3").items():
        if term != "Residuals":
            assert hc3(fit)[term].f == pytest.approx(figures["f"], rel=1e-8)
            assert hc3(fit)[term].p == pytest.approx(figures["p"], rel=1e-8)
    welch = terms("crossed-unbalanced", "welch")["a"]
    row = anova(table, "y", ["a"], error="welch", exact=False).anova.row("a")
    assert (row.f, row.p) == pytest.approx((welch["f"], welch["p"]), rel=1e-8)
    two = terms("crossed-unbalanced", "two-way")[""]
    assert influence(fit).leverage.max() == pytest.approx(two["max_leverage"], rel=1e-10)
    assert influence(fit).cook.max() == pytest.approx(two["max_cook"], rel=1e-8)
    summary = summary_of(fit)
    assert summary.r_sq_pred == pytest.approx(two["r_sq_pred"], rel=1e-8)
    whole = anova(table, "y", ["a", "b", "c"], exact=False).summary
    expected = terms("crossed-unbalanced", "fit")[""]
    assert whole.s == pytest.approx(expected["s"], rel=1e-10)
    assert whole.r_sq == pytest.approx(expected["r_sq"], rel=1e-10)
    assert whole.r_sq_adj == pytest.approx(expected["r_sq_adj"], rel=1e-10)
    ci = terms("crossed-unbalanced", "boxcox")[""]
    # both are roots of one profile, found to 1e-8 or so
    found = box_cox(checked.y, fit.matrix.columns).ci95
    assert found == pytest.approx((ci["low"], ci["high"]), rel=1e-6)
    shapiro = terms("crossed-unbalanced", "shapiro")[""]["statistic"]
    assert shapiro_wilk(fit.residual).statistic == pytest.approx(shapiro, rel=1e-6)
