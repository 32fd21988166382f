"""Contrasts that the analyst names, against the t-tests of scipy."""

from itertools import product

import numpy as np
import pandas as pd
import pytest
from scipy import stats
from statsmodels.formula.api import ols
from statsmodels.stats.multitest import multipletests

import study
from study.ground.errors import InputError
from study.statistics.analysis.post_hoc import with_contrasts
from tests.analysis.test_block_groups import two_mixes


def blocked(log=False):
    random = np.random.default_rng(2)
    cells = list(product("xyz", ("20 %", "60 %"), range(7)))
    table = pd.DataFrame(cells, columns=["material", "range", "specimen"])
    y = 10 + table["specimen"] + table["material"].map("xyz".index) * (table["range"] == "60 %")
    y += random.normal(0, 0.3, len(table))
    return table.assign(y=np.exp(y / 10) if log else y)


def ask(table, *asked, **options):
    given = {"block": "specimen", "practical": 0.5, "exact": False} | options
    found = study.anova(table, "y", ["material", "range"], **given)
    return study.contrasts(found, list(asked))


@pytest.mark.parametrize("ranges", [["60 %"], ["20 %", "60 %"]])
def test_a_contrast_within_blocks_is_the_paired_t_and_a_factor_left_out_is_averaged_over(ranges):
    table = blocked()
    at = ", range=60 %" if len(ranges) == 1 else ""
    (one,) = ask(table, f"material=z{at} - material=x{at}")
    means = table[table["range"].isin(ranges)].groupby(["specimen", "material"])["y"].mean()
    paired = stats.ttest_rel(means[:, "z"], means[:, "x"])
    limits = paired.confidence_interval()
    assert one.ci == pytest.approx((limits.low, limits.high))
    difference = means[:, "z"].mean() - means[:, "x"].mean()
    assert (one.difference, one.p, one.df) == pytest.approx((difference, paired.pvalue, 6))
    assert one.verdict == "matters"


def test_a_ratio_is_reported_where_the_log_was_analyzed():
    table = blocked(log=True)
    (one,) = ask(table, "z,60 % - x,60 %", transform="log", practical="5 % of mean")
    logs = np.log(table[table["range"] == "60 %"].pivot_table("y", "specimen", "material"))
    limits = stats.ttest_rel(logs["z"], logs["x"]).confidence_interval()
    assert one.ci == pytest.approx(tuple(np.exp([limits.low, limits.high])))


def test_sides_in_different_blocks_are_compared_by_welch():
    table = two_mixes((4, 6)).rename(columns={"mix": "range", "model": "material"})
    (one,) = ask(table, "range=mix 0 - range=mix 1")
    means = table.groupby(["range", "specimen"])["y"].mean()
    welch = stats.ttest_ind(means["mix 0"], means["mix 1"], equal_var=False)
    assert (one.p, one.df) == pytest.approx((welch.pvalue, welch.df))


@pytest.mark.parametrize(
    ("asked", "weight"),
    [
        ("material=z - material=x", lambda m, r: ((m == "z") - (m == "x")) / 2),
        # a cell on both sides counts by the difference of its weights
        ("material=z - range=60 %", lambda m, r: (m == "z") / 2 - (r == "60 %") / 3),
    ],
)
def test_without_blocks_the_scatter_within_cells_is_the_error(asked, weight):
    """Against the t-test of statsmodels' least squares with a mean for each cell."""
    table = blocked().drop(columns="specimen")
    (one,) = ask(table, asked, block=None)
    fit = ols("y ~ 0 + C(material):C(range)", table).fit()
    test = fit.t_test([weight(m, r) for r in ("20 %", "60 %") for m in "xyz"])
    assert one.difference == pytest.approx(float(test.effect[0]))
    assert one.ci == pytest.approx(tuple(test.conf_int()[0]))
    assert one.p == pytest.approx(float(test.pvalue))


def test_p_of_several_contrasts_is_adjusted_as_statsmodels_does():
    """To 1e-12, in the order asked, which is not that of their p."""
    table = blocked()
    found = ask(table, "x,20 % - y,20 %", "z,60 % - x,60 %", "y,60 % - x,60 %", "z - y")
    p = [one.p for one in found]
    assert p != sorted(p)
    adjusted = [one.p_holm for one in found]
    assert adjusted == pytest.approx(multipletests(p, method="holm")[1], rel=1e-12)
    (alone,) = ask(table, "z - y")
    assert alone.p_holm == alone.p


def test_those_that_can_be_estimated_are_adjusted_among_themselves():
    table = blocked()
    found = study.anova(table, "y", ["material", "range"], block="specimen", exact=False)
    asked = ["z - y", "z - w", "x - y"]
    some = with_contrasts(found, asked)
    assert some.contrasts == study.contrasts(found, ["z - y", "x - y"])
    assert any("no level 'w'" in note for note in some.notes)
    with pytest.raises(InputError, match="no level 'w'"):
        study.contrasts(found, asked)
    # a level of another factor
    with pytest.raises(InputError, match="no level '60 %'"):
        study.contrasts(found, ["material=60 % - x"])


def test_a_named_difference_passes_the_gate_as_the_factor_does():
    """Readings in whole units that differ by two in all blocks: rounding hides their scatter."""
    table = pd.DataFrame(list(product("xyz", range(3))), columns=["material", "specimen"])
    table["y"] = 10.0 + table["specimen"] + 2.0 * (table["material"] == "x")
    table.loc[4, "y"] += 1.0
    analysis = study.anova(table, "y", ["material"], block="specimen", practical=1.5, exact=False)
    (one,) = study.contrasts(analysis, "material=x - material=z")
    assert one.difference == pytest.approx(2.0)
    assert (one.verdict, one.why) == ("cannot tell", analysis.effects[0].withdrawn[0])


def test_beside_an_empty_cell_both_sides_are_averaged_over_the_same_settings():
    """The effect of b is 10 a level: x and z differ by 0.5 where both were measured."""
    rows = [(a, b, 0.5 * (a == "z") + 10 * b + e) for a in "xyz" for b in range(4)
            for e in (-0.02, 0.0, 0.03)]  # fmt: skip
    table = pd.DataFrame(rows, columns=["a", "b", "y"])
    lost = ((table["a"] == "x") & (table["b"] == 0)) | ((table["a"] == "z") & (table["b"] == 3))
    analysis = study.anova(table[~lost], "y", ["a", "b"], practical=2.0, exact=False)
    (one,) = study.contrasts(analysis, "a=z - a=x")
    assert one.difference == pytest.approx(0.5)
    assert "2 of 4 settings of b" in one.why


def test_in_a_latin_square_a_difference_is_free_of_rows_and_columns():
    """Against the t-test of statsmodels' least squares."""
    random, k = np.random.default_rng(5), 5
    table = pd.DataFrame(list(product(range(k), range(k))), columns=["r", "c"])
    table["a"] = [f"t{(r + c) % k}" for r, c in zip(table["r"], table["c"], strict=True)]
    table["y"] = 7.0 * table["c"] + 3.0 * table["r"] + random.normal(0, 0.3, k * k)
    analysis = study.anova(table, "y", ["a"], block=["r", "c"], practical=1.0, exact=False)
    (one,) = study.contrasts(analysis, "a=t1 - a=t0")
    fit = ols("y ~ C(a) + C(r) + C(c)", table).fit()
    test = fit.t_test("C(a)[T.t1] = 0")
    assert one.ci == pytest.approx(tuple(test.conf_int()[0]))
    assert one.p == pytest.approx(float(test.pvalue))
    assert one.df == pytest.approx(12)
