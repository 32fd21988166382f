"""Groups of blocks with variances of their own, through the public analysis."""

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t as student
from scipy.stats import ttest_ind

from study.statistics.analysis.anova import anova

FULL = [pytest.mark.slow, pytest.mark.verify]


def two_mixes(sizes=(4, 7), seed=3):
    """Two models scored on specimens of mixes that scatter differently."""
    rng = np.random.default_rng(seed)
    rows = []
    for g, n in enumerate(sizes):
        for k in range(n):
            base = rng.normal(0, 1 + g)
            values = base + np.array([0.0, 0.5 * (g + 1)]) + rng.normal(0, 0.3 + 1.7 * g, 2)
            rows += [(f"mix {g}", f"{g}-{k}", m, v) for m, v in zip("xy", values, strict=True)]
    return pd.DataFrame(rows, columns=["mix", "specimen", "model", "y"])


def analyzed(table):
    return anova(table, "y", ["mix", "model"], block="specimen", practical=1.0, exact=False)


def test_two_groups_are_compared_by_welchs_t():
    table = two_mixes()
    found = analyzed(table)
    wide = table.set_index(["mix", "specimen", "model"])["y"].unstack()  # noqa: PD010
    mean, difference = wide.mean(axis=1), wide["x"] - wide["y"]
    for term, values in (("mix", mean), ("mix:model", difference)):
        expected = ttest_ind(values["mix 0"], values["mix 1"], equal_var=False)
        row = found.anova.row(term)
        assert (row.f, row.df_error, row.p_deciding) == pytest.approx(
            (expected.statistic**2, expected.df, expected.pvalue)
        )
    limits = ttest_ind(mean["mix 0"], mean["mix 1"], equal_var=False).confidence_interval()
    assert found.effect("mix").ci95 == pytest.approx((-limits.high, -limits.low))


def test_a_difference_within_one_group_takes_the_scatter_of_that_group_alone():
    table = two_mixes()
    for effect in analyzed(table).effect("model").simple_effects:
        here = table[table.mix == dict(effect.at)["mix"]]
        wide = here.set_index(["specimen", "model"])["y"].unstack()  # noqa: PD010
        d = (wide["x"] - wide["y"]).to_numpy()
        half = student.ppf(0.975, d.size - 1) * d.std(ddof=1) / np.sqrt(d.size)
        assert effect.ci == pytest.approx((d.mean() - half, d.mean() + half))


def test_an_incomplete_block_is_left_out_of_test_and_interval_alike():
    table = two_mixes()
    kept = table[table.specimen != "1-6"]
    cut = table.drop(table.index[-1])
    assert analyzed(cut).effects == analyzed(kept).effects


def test_groups_of_two_share_one_covariance_and_say_so():
    found = analyzed(two_mixes((2, 6)))
    assert "one covariance serves all groups" in found.error_term.reason
    assert "Welch-Box" in analyzed(two_mixes((3, 6))).error_term.reason


@pytest.mark.parametrize("tables", [10, pytest.param(2000, marks=FULL)], ids=["quick", "full"])
@pytest.mark.parametrize("sizes", [(5, 5, 5), (3, 4, 8)])
def test_size_and_coverage_with_unequal_spread(sizes, tables):
    """The true effects are zero; limits are those of the specification with 3 standard errors."""
    rejected, covered = [], []
    for seed in range(tables):
        table = two_mixes(sizes, seed)
        table.loc[table.model == "y", "y"] -= 0.5 * (table.mix.str[-1].astype(int) + 1)
        found = analyzed(table)
        rejected.append([(found.anova.row(t).p_deciding or 1) < 0.05 for t in ("model", "mix")])
        intervals = [e.ci for e in found.effect("model").simple_effects]
        covered += [ci[0] <= 0 <= ci[1] for ci in intervals if ci is not None]
    assert np.mean(rejected, axis=0).max() <= 0.07 + 3 * np.sqrt(0.05 * 0.95 / tables)
    assert abs(np.mean(covered) - 0.95) <= 0.02 + 3 * np.sqrt(0.05 * 0.95 / len(covered))
