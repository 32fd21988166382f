"""Blocks that lack cells: never more certain than complete ones, and nothing is pooled unasked."""

from collections import Counter
from itertools import combinations, product

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import study
from study.statistics.analysis.analysis_request import (
    AnalysisRequest,
    Blocking,
    ResponseScale,
    Threshold,
)
from study.statistics.analysis.anova import effects
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import model_matrix
from study.statistics.analysis.restricted_likelihood import Sandwich, fit_restricted
from study.statistics.analysis.sums_of_squares import factor


def gels(seed=3, blocks=7):
    """Two materials on four meshes: the material's effect differs between specimens."""
    random = np.random.default_rng(seed)
    own = random.normal(0, 0.5, (blocks, 2))
    rows = [
        (f"s{k}", f"m{a}", f"h{h}", 9 + k + 2.0 * a + own[k, a] + random.normal(0, 0.02))
        for k in range(blocks) for a in range(2) for h in range(4)
    ]  # fmt: skip
    return pd.DataFrame(rows, columns=["specimen", "material", "mesh", "y"])


def less_one_a_block(table):
    first = table.groupby("specimen", sort=False).cumcount()
    number = table["specimen"].str[1:].astype(int)
    return table[(first != (3 * number) % 8).to_numpy()]


def test_a_split_plot_without_a_row_keeps_its_means():
    """The mean of a level does not follow the block that lacks it; F as of the same mixed model."""
    table = gels().rename(columns={"specimen": "s"})
    lost = table.drop(index=[9])
    asked = {"block": "s", "practical": 1.0, "exact": False}
    full = study.anova(table, "y", ["material", "mesh"], whole_plot="material", **asked)
    less = study.anova(lost, "y", ["material", "mesh"], whole_plot="material", **asked)
    mixed = study.mixed_model(lost, "y", ["material", "mesh"], block="s", random=["material"])
    assert [less.anova.row(t.term).f for t in mixed.terms] == pytest.approx(
        [t.f for t in mixed.terms]
    )
    assert less.effect("mesh").mean == pytest.approx(full.effect("mesh").mean, abs=0.02)
    assert "s, s:material and the rest" in less.error_term.reason
    (contrast,) = study.contrasts(less, "mesh=h1 - mesh=h0")
    assert contrast.df == pytest.approx(less.anova.row("mesh").df_error, rel=0.01)


def test_an_effect_is_still_tested_against_its_own_interaction():
    options = {"block": "specimen", "practical": 1, "exact": False}
    full = study.anova(gels(), "y", ["material", "mesh"], **options)
    less = study.anova(less_one_a_block(gels()), "y", ["material", "mesh"], **options)
    row, part = full.anova.row("material"), less.anova.row("material")
    assert row.df_error == 6
    assert part.df_error == pytest.approx(6, abs=0.05)
    assert part.f == pytest.approx(row.f, rel=0.1)
    assert part.p_deciding > 0.5 * row.p_deciding
    whole, effect = full.effects[0], less.effects[0]
    assert np.ptp(effect.ci95) == pytest.approx(np.ptp(whole.ci95), rel=0.1)
    assert effect.verdict == whole.verdict
    assert "7 of 7 levels of specimen lack a cell" in less.error_term.reason
    assert "mixed model" in less.error_term.question


def test_the_sum_of_squares_of_a_term_between_blocks_is_that_of_its_contrast():
    """A 2 x 2 x 2 factorial in blocks of four that differ in a:b:c: its F is against the blocks."""
    random = np.random.default_rng(7)
    levels = [-1, 1]
    rows = [
        (f"b{k}", a, b, c, 10 + k + 2 * a + random.normal())
        for k in range(6) for a, b, c in product(levels, levels, levels)
        if a * b * c == (-1) ** k
    ]  # fmt: skip
    table = pd.DataFrame(rows, columns=["block", "a", "b", "c", "y"])
    row = study.anova(table, "y", ["a", "b", "c"], block="block", exact=False).anova.row("a:b:c")
    contrast = float((table["a"] * table["b"] * table["c"] * table["y"]).sum())
    assert row.ss == pytest.approx(contrast**2 / len(table))
    means = table.groupby("block")["y"].mean().to_numpy()
    between = stats.f_oneway(means[::2], means[1::2])
    assert (row.f, row.p) == pytest.approx((between.statistic, between.pvalue), rel=1e-6)
    assert row.ms == row.ss


def test_a_contrast_by_name_is_that_of_the_mixed_model():
    """Cells that a block lacks would else be taken for its mean over the others."""
    table = less_one_a_block(gels())
    found = study.anova(table, "y", ["material", "mesh"], block="specimen", exact=False)
    (contrast,) = study.contrasts(found, "m1 - m0")
    effect = found.effects[0]
    assert contrast.difference == pytest.approx(effect.range, rel=1e-9)
    assert contrast.ci == pytest.approx(effect.ci95, rel=1e-9)


def test_of_complete_blocks_the_sandwich_is_the_paired_difference():
    """One level scatters five times as much as the others; epsilon is Greenhouse and Geisser's."""
    random = np.random.default_rng(9)
    values = random.normal(0, 1, (8, 1)) + random.normal(0, 1, (8, 4)) * [0.3, 0.3, 0.3, 1.5]
    code, cell = np.divmod(np.arange(32), 4)
    layout = Layout({"a": tuple("wxyz")}, {"a": cell})
    fixed = factor(model_matrix(layout, [("a",)]), values.ravel())
    robust = Sandwich(fit_restricted(fixed.q, values.ravel(), [code]), code)
    pairs = list(combinations(range(4), 2))
    columns = model_matrix(Layout(layout.levels, {"a": np.arange(4)}), [("a",)]).columns
    rows = np.array([columns[i] - columns[j] for i, j in pairs]) @ fixed.inverse
    error, df = robust.errors(rows)
    paired = [stats.sem(values[:, i] - values[:, j]) for i, j in pairs]
    assert error == pytest.approx(paired, rel=1e-9)
    assert df == pytest.approx(np.full(6, 7.0), rel=1e-9)
    table = pd.DataFrame({"s": code, "a": cell, "y": values.ravel()})
    row = study.anova(table, "y", ["a"], block="s", exact=False).anova.row("a")
    epsilon, p = robust.test(fixed.space(1, "III").basis)
    assert (epsilon, p) == pytest.approx((row.epsilon_gg, row.p_gg), rel=1e-9)


def rates(scatter, blocks, practical, data_sets):
    """Share of each verdict where levels do not differ and each block lacks a cell."""
    random = np.random.default_rng(17)
    levels = len(scatter)
    scale = ResponseScale(practical=Threshold(practical))
    request = AnalysisRequest("y", ("a",), Blocking(("s",)), scale=scale)
    block, cell = np.divmod(np.arange(blocks * levels), levels)
    verdicts = []
    for _ in range(data_sets):
        y = random.normal(0, 2, blocks)[block]
        y += random.normal(size=block.size) * np.array(scatter)[cell]
        lost = random.integers(0, levels, blocks)[block] == cell
        table = pd.DataFrame({"s": block, "a": cell, "y": y})[~lost]
        verdicts += [effect.verdict for effect in effects(table, request)]
    return {verdict: n / data_sets for verdict, n in Counter(verdicts).items()}


@pytest.mark.parametrize("tables", [25, pytest.param(60, marks=pytest.mark.slow)])
def test_a_volatile_level_makes_no_more_false_claims_than_promised(tables):
    """With one pooled variance 18 % of such tables made a claim; 5 % and 2 standard errors."""
    claimed = rates([1.5, *[0.3] * 7], 6, 0.01, tables).get("matters", 0)
    assert claimed < 0.05 + 2 * np.sqrt(0.05 * 0.95 / tables)


def test_levels_that_agree_are_told_to():
    assert rates([0.1] * 4, 6, 1.0, 20)["no practical difference"] > 0.9


def test_two_blocks_that_lack_cells_make_no_claim_of_a_mixed_model():
    table = less_one_a_block(gels(blocks=2))
    found = study.anova(table, "y", ["material", "mesh"], block="specimen", exact=False)
    assert "mixed model" not in found.error_term.question
