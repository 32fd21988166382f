"""Comparisons, power and robust tests against other codes."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import boxcox, f_oneway, ttest_ind, tukey_hsd
from scipy.stats import dunnett as scipy_dunnett
from scipy.stats import t as student

from study.ground.errors import InputError
from study.statistics.analysis.anova import anova
from study.statistics.analysis.assumptions import box_cox, hc3
from study.statistics.analysis.comparisons import GroupMoments, letters
from study.statistics.analysis.data import prepare
from study.statistics.analysis.equal_variance import fligner as fligner_killeen
from study.statistics.analysis.linear_model import model_matrix, terms_of
from study.statistics.analysis.post_hoc import against_reference, coefficient_table
from study.statistics.analysis.sums_of_squares import factor, influence
from tests.cli.small import study

RNG = np.random.default_rng(4)
GROUPS = {"a": RNG.normal(0, 1, 6), "b": RNG.normal(1.5, 1, 8), "c": RNG.normal(4, 1, 7)}


@pytest.fixture
def table():
    rng = np.random.default_rng(6)
    rows = [(a, b) for a in "xyz" for b in "pq" for _ in range(4)]
    frame = pd.DataFrame(rows, columns=["a", "b"])
    return frame.assign(y=np.exp(rng.normal(1, 0.4, len(frame)) + (frame["a"] == "z") * 0.8))


def fitted(table):
    data = prepare(table, "y", ["a", "b"])
    return data, factor(model_matrix(data.layout, terms_of(["a", "b"])), data.y)


def test_dunnett_as_scipy():
    """Both p are integrals by random numbers: scipy's to some 1e-3 of them, ours of 200,000."""
    table = pd.DataFrame([(name, v) for name, values in GROUPS.items() for v in values])
    _, found = against_reference(anova(table.set_axis(["t", "y"], axis=1), "y", ["t"]), "a")
    theirs = scipy_dunnett(GROUPS["b"], GROUPS["c"], control=GROUPS["a"], random_state=1)
    interval = theirs.confidence_interval(0.95)
    assert [p.p for p in found.pairs] == pytest.approx(theirs.pvalue, abs=0.003)
    assert [p.lower for p in found.pairs] == pytest.approx(interval.low, abs=0.02)
    assert [p.upper for p in found.pairs] == pytest.approx(interval.high, abs=0.02)


@pytest.mark.parametrize("count", [20, 22])
def test_many_levels_are_compared_beside_the_other_factors(count, tmp_path):
    """Beyond 20 levels, whose pairs nobody reads, the scatter within cells stays the error."""
    rng = np.random.default_rng(8)
    rows = pd.DataFrame(
        [(f"t{a}", f"b{b}", 50.0 * b + a % 5 + rng.normal(0, 0.5))
         for a in range(count) for b in range(2) for _ in range(2 + b)],
        columns=["t", "b", "y"],
    )  # fmt: skip
    rows.to_csv(tmp_path / "t.csv", index=False)
    answer = study("analyze", tmp_path / "t.csv", "--response", "y", "--factors", "t,b",
                   "--reference", "t0", "--json")  # fmt: skip
    mean = rows.groupby(["t", "b"])["y"].mean().groupby("t").mean()
    left = rows["y"] - rows.groupby(["t", "b"])["y"].transform("mean")
    df = len(rows) - 2 * count
    error = np.sqrt(left @ left / df * 2 * (1 / 2 + 1 / 3) / 4)
    pairs = answer.json["reference"]["pairs"]
    multiplier = [(pair["upper"] - pair["lower"]) / 2 / error for pair in pairs]
    assert len(pairs) == count - 1
    # R: mvtnorm::qmvt(.95, tail = "both.tails", df = 3 * count, corr = .5 between all)
    exact = {20: 2.9908, 22: 3.0092}[count]
    assert multiplier == pytest.approx([exact] * len(pairs), rel=0.006)
    for pair in pairs:
        assert pair["difference"] == pytest.approx(mean[pair["first"]] - mean["t0"])


def test_letters_tell_apart_exactly_the_different_pairs():
    names = list("abcde")
    different = {frozenset(p) for p in ("ac", "ad", "ae", "be", "ce")}
    found = letters(names, different)
    for i, x in enumerate(names):
        for y in names[:i]:
            share = bool(set(found[x]) & set(found[y]))
            assert share == (frozenset((x, y)) not in different)


def test_a_row_that_is_fitted_exactly_has_no_distance(table):
    """Leverage one leaves 0 / 0, of which rounding made distances of .03, 1.09 and more."""
    _, fit = fitted(table.drop(index=range(3)))
    of_rows = influence(fit)
    assert of_rows.leverage[0] == pytest.approx(1.0)
    assert np.flatnonzero(np.isnan(of_rows.cook)).tolist() == [0]


def test_within_whole_plots_a_reference_is_that_of_their_stratum():
    """It rests on the plots that have both levels; differences of all rows mix the plots in."""
    rng = np.random.default_rng(3)
    rows = [(f"{a}{s}", a, b) for a in "xyz" for s in range(6) for b in "pq"]
    frame = pd.DataFrame(rows, columns=["plot", "a", "b"]).drop(index=[5, 9, 20])
    frame["y"] = rng.normal(size=len(frame)) + 5 * frame["plot"].str[1].astype(float)
    made = anova(frame, "y", ["a", "b"], block="plot", model=1, error="pooled", exact=False)
    (pair,) = against_reference(made, "b=p")[1].pairs
    both = frame[frame.groupby("plot")["b"].transform("size") == 2]
    by_plot = both.pivot_table("y", "plot", "b")
    assert pair.difference == pytest.approx((by_plot["q"] - by_plot["p"]).mean())


def test_hc3_says_so_when_cells_have_no_spread(table):
    """Deterministic runs repeat exactly: the covariance of a contrast between them is zero."""
    still = table["a"] != "z"
    table.loc[still, "y"] = table[still].groupby(["a", "b"])["y"].transform("first")
    _, fit = fitted(table)
    assert hc3(fit)["a:b"] is None
    robustness = anova(table, "y", ["a", "b"], exact=False).assumptions.robustness
    assert robustness.p["a:b"]["HC3 Wald"] is None


def test_a_cell_without_rows_moves_no_exponent(table):
    """Its column of the interaction is zero, and says nothing."""
    data, fit = fitted(table)
    columns = fit.matrix.columns
    known = box_cox(data.y, columns)
    empty = box_cox(data.y, np.column_stack([columns, np.zeros(len(columns))]))
    assert empty.exponent == pytest.approx(known.exponent, abs=1e-9)
    assert empty.ci95 == pytest.approx(known.ci95, abs=1e-9)


def test_box_cox_finds_the_log(table):
    data, fit = fitted(table)
    result = box_cox(data.y, fit.matrix.columns)
    # the true exponent is zero; 20 fresh samples at 95 % miss it at most 4 times (p < .003)
    held = 0
    for seed in range(20):
        y = np.exp(np.random.default_rng(seed).normal(1, 0.4, 40))
        ci = box_cox(y, np.ones((40, 1))).ci95
        held += ci[0] < 0 < ci[1]
    assert held >= 16
    assert result.ci95[0] < result.exponent < result.ci95[1]
    plain = box_cox(data.y, np.ones((data.y.size, 1)))
    assert plain.exponent == pytest.approx(boxcox(data.y)[1], abs=1e-5)
    with pytest.raises(InputError, match="positive"):
        box_cox(-data.y, fit.matrix.columns)


def test_an_interval_of_the_exponent_without_an_end_is_open():
    """Readings that vary by .1 % of their mean are as straight at any power of them."""
    noise = np.random.default_rng(4).normal(0, 0.001, 12)
    table = pd.DataFrame({"a": np.repeat(["p", "q", "r"], 4), "y": 1 + noise})
    found = anova(table, "y", ["a"], exact=False)
    assert found.assumptions.box_cox.ci95 == (-np.inf, np.inf)
    assert any("Box-Cox: the interval of the exponent is open" in note for note in found.notes)


def test_groups_of_which_only_moments_are_known_compare_as_their_rows():
    values = [np.asarray(v, dtype=float) for v in GROUPS.values()]
    n, mean, variance = (np.array([f(v) for v in values]) for f in (
        np.size, np.mean, lambda v: v.var(ddof=1)))  # fmt: skip
    moments = GroupMoments(tuple(GROUPS), n, mean, variance)
    theirs = f_oneway(*values)
    pooled, welch = moments.one_way(equal=True), moments.one_way(equal=False)
    assert (pooled["f"], pooled["p"]) == pytest.approx((theirs.statistic, theirs.pvalue), rel=1e-10)
    table = pd.DataFrame({"a": np.repeat(list(GROUPS), [v.size for v in values]),
                          "y": np.concatenate(values)})  # fmt: skip
    asked = anova(table, "y", ["a"], error="welch", exact=False)
    row = asked.anova.row("a")
    assert (row.f, row.df, row.df_error, row.p) == pytest.approx(tuple(welch.values()), rel=1e-8)
    # the intervals of the analysis are those of Games and Howell
    by_levels = {(x.first, x.second): x for x in moments.pairs(0.05, equal=False).pairs}
    for pair in asked.effect("a").pairs:
        other = by_levels[pair.first, pair.second]
        assert (pair.lower, pair.upper) == pytest.approx((other.lower, other.upper), rel=1e-8)
    for equal in (True, False):
        own = tukey_hsd(*values, equal_var=equal)
        ends = own.confidence_interval(0.95)
        for x in moments.pairs(0.05, equal=equal).pairs:
            i, j = (list(GROUPS).index(name) for name in (x.first, x.second))
            assert x.p == pytest.approx(own.pvalue[i, j], abs=1e-9)
            assert x.lower == pytest.approx(ends.low[i, j], abs=1e-6)


def test_fligner_and_killeen_need_deviations_that_differ():
    assert fligner_killeen([[1, 1], [2, 2]]) is None


def test_welch_needs_rows_in_every_cell(table):
    one = table.groupby("a", as_index=False).first()
    with pytest.raises(InputError, match="two rows or more in every cell"):
        anova(pd.concat([one, one.iloc[1:].assign(y=3.0)]), "y", ["a"], error="welch")


def test_levels_against_a_reference_by_welch_have_their_own_errors(tmp_path):
    """The reference scatters little, one level widely: each difference has Welch's error and df.

    Standard deviations .3, .3, 1 and 12, 12 and 6 rows without a difference: of 400 such tables the
    pooled variance found one in .17, this in .04; with 5 rows each in .07 and .05.
    """
    rng = np.random.default_rng(12)
    groups = {n: sd * rng.normal(size=k) for n, sd, k in
              (("std", 0.3, 4), ("soft", 0.3, 4), ("hard", 1.0, 4))}  # fmt: skip
    rows = "".join(f"{name},{y}\n" for name, values in groups.items() for y in values)
    (tmp_path / "t.csv").write_text(f"t,y\n{rows}")
    answer = study("analyze", tmp_path / "t.csv", "--response", "y", "--factors", "t", "--welch",
                   "--reference", "std", "--json")  # fmt: skip
    for pair in answer.json["reference"]["pairs"]:
        a, b = groups[pair["first"]], groups["std"]
        theirs = ttest_ind(a, b, equal_var=False)
        error = np.sqrt(a.var(ddof=1) / 4 + b.var(ddof=1) / 4)
        # of so few rows the multiplier is Bonferroni's over the two differences
        half = student.ppf(1 - 0.05 / 4, theirs.df) * error
        assert pair["difference"] == pytest.approx(a.mean() - b.mean())
        assert (pair["upper"] - pair["lower"]) / 2 == pytest.approx(half, rel=1e-9)
        assert pair["p"] == pytest.approx(min(1.0, 2 * theirs.pvalue), rel=1e-3)
    assert answer.json["reference"]["method"] == "Dunnett by Welch"


def test_welch_says_what_the_rows_of_a_cell_are():
    rng = np.random.default_rng(3)
    rows = pd.DataFrame({"a": np.repeat(["p", "q", "r"], 6), "y": rng.normal(size=18)})
    seeds = anova(rows, "y", ["a"], error="welch", replicates="mesh-seeds", exact=False)
    pooled = anova(rows, "y", ["a"], replicates="mesh-seeds", exact=False)
    assert seeds.error_term.source == "E3"
    assert seeds.error_term.question == pooled.error_term.question
    assert set(pooled.notes) & set(seeds.notes)
    with pytest.raises(InputError, match="resamples of one curve"):
        anova(rows, "y", ["a"], error="welch", replicates="noise")


def test_a_nested_factor_leaves_the_comparison_to_its_means():
    """As scipy's Dunnett of the means of the batches, and no coefficients of two errors."""
    rng = np.random.default_rng(5)
    rows = [
        (f"l{i}", f"l{i}b{j}", rng.normal() + i) for i in range(3) for j in range(4) for _ in "ab"
    ]
    frame = pd.DataFrame(rows, columns=["lab", "batch", "y"])
    made = anova(frame, "y", ["lab", "batch"], exact=False)
    means = frame.groupby(["lab", "batch"])["y"].mean().groupby("lab")
    groups = [group.to_numpy() for _, group in means]
    theirs = scipy_dunnett(*groups[1:], control=groups[0], random_state=1)
    found = against_reference(made, "lab=l0")[1]
    assert [p.p for p in found.pairs] == pytest.approx(theirs.pvalue, abs=0.003)
    assert coefficient_table(made) == "the strata of the table have different errors"
