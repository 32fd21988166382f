"""The error-term ledger E0 to E7: which source is taken, what it asks, and that it is right."""

import itertools

import numpy as np
import pandas as pd
import pytest

from study.ground.errors import InputError
from study.statistics.analysis.anova import anova
from study.statistics.analysis.error_ledger import REMEDIES
from study.statistics.analysis.simple_effects import CANNOT_TELL
from tests.analysis.test_faults import factorial

LEDGER = [
    ("E0", {"a": 2, "b": 2}, 3, {}, "run-to-run scatter"),
    ("E1", {"a": 2, "b": 2}, 3, {"block": "rep"}, "another rep"),
    ("E1", {"a": 2, "b": 2}, 3, {"block": "rep", "records": True}, "own interaction"),
    ("E1", {"a": 2, "b": 2}, 3, {"block": "rep", "error": "own"}, "own interaction"),
    ("E2", {"a": 2, "b": 2}, 9, {"records": True, "replicates": "noise"}, "noise in the measured"),
    ("E3", {"a": 2, "b": 2}, 5, {"records": True, "replicates": "mesh-seeds"}, "mesh noise"),
    ("E4", {"a": 2, "b": 2, "c": 2}, 1, {"records": True, "u_num": 0.1}, "resolved by the"),
    ("E5", {"a": 3, "b": 3}, 1, {"model": 1}, "declared negligible"),
    ("E6", {"a": 2, "b": 2, "c": 2}, 1, {}, "outlier among the effects"),
    ("E7", {"a": 2, "b": 2}, 1, {}, "no p"),
]


@pytest.mark.parametrize(("source", "shape", "repeats", "options", "question"), LEDGER)
def test_every_source_is_taken_and_says_what_its_p_answers(
    source, shape, repeats, options, question
):
    result = anova(factorial(shape, repeats), "y", list(shape), exact=False, **options)
    assert result.error_term.source == source
    assert question in result.error_term.question
    assert result.error_term.reason
    tested = [row.p is not None for row in result.anova.rows if row.term in ("a", "b", "a:b")]
    # Lenth's method is no F, but has its p; E4 and E7 have none
    assert any(tested) == (source not in ("E4", "E7"))
    without_error = any(note.startswith(REMEDIES.split("{")[0]) for note in result.notes)
    assert without_error == (source in ("E4", "E6", "E7"))


def test_the_override_is_obeyed_and_reported():
    table = factorial({"a": 3, "b": 2}, 6, 1)
    pooled = anova(table, "y", ["a", "b"], block="rep", records=True, error="pooled", exact=False)
    own = anova(table, "y", ["a", "b"], block="rep", error="own", exact=False)
    assert pooled.anova.row("a").error == "residual"
    assert pooled.error_term.reason == "asked for instead of own interactions"
    assert any("p is far too small" in w for w in pooled.notes)
    assert own.anova.row("a").error == "rep:a"
    assert own.error_term.reason == "asked for"
    with pytest.raises(InputError, match="several that cross are pooled"):
        anova(table.assign(s=table["rep"]), "y", ["a"], block=["rep", "s"], error="own")
    with pytest.raises(InputError, match="no block is named"):
        anova(table, "y", ["a"], error="own")
    plots = factorial({"a": 2, "b": 3, "s": 4}, 1, 2).assign(s=lambda t: t["a"] + t["s"])
    one = anova(plots, "y", ["a", "b"], block="s", whole_plot="a", exact=False)
    two = anova(plots, "y", ["a", "b"], block="s", error="pooled", exact=False)
    assert [row.term for row in one.anova.rows] == ["a", "s", "b", "a:b", "residual"]
    assert one.anova.row("a").f == pytest.approx(two.anova.row("a").f)
    with pytest.raises(InputError, match="needs the block in which the plots lie"):
        anova(table, "y", ["a"], whole_plot="a")
    with pytest.raises(InputError, match="'aa' is no factor"):
        anova(table, "y", ["a", "b"], block="rep", whole_plot="aa")


def test_resampled_noise_is_not_averaged_by_more_resamples():
    """E2: with cell values t and noise sd s, F of two cells is t^2 / (2 s^2), whatever B is."""
    rng = np.random.default_rng(4)
    f = []
    for resamples in (50, 800):
        noise = rng.normal(size=(2, resamples))
        noise -= noise.mean(axis=1, keepdims=True)
        y = np.array([[0.0], [3.0]]) + noise / noise.std(axis=1, keepdims=True, ddof=1)
        table = pd.DataFrame({"a": np.repeat(["x", "z"], resamples), "y": y.ravel()})
        result = anova(table, "y", ["a"], records=True, replicates="noise", exact=False)
        f.append(result.anova.row("a").f)
        # the interval of the difference: 3 +- t sqrt(2) s
        assert result.effect("a").ci95 == pytest.approx((0.228, 5.772), abs=0.05)
    # the standard errors are those of single values, so F = 9 / 2 exactly
    assert f == pytest.approx([4.5, 4.5], rel=1e-9)


def test_seed_columns_declare_the_repeats():
    table = factorial({"a": 3, "b": 2}, 3, 5)
    seeds = anova(table.assign(mesh_seed=table["rep"]), "y", ["a", "b"], records=True)
    assert seeds.error_term.source == "E3"
    assert any("3 mesh seeds a cell" in w for w in seeds.notes)
    assert any("bias of this mesh size is common to all seeds" in w for w in seeds.notes)
    noise = anova(table.assign(noise_seed=table["rep"]), "y", ["a", "b"], exact=False)
    assert noise.error_term.source == "E2"


def test_numerical_uncertainty_is_a_ratio_and_no_p():
    table = factorial({"a": 2, "b": 2, "c": 2}, 1, 3)
    table["y"] += 4 * (table["a"] == "L1")
    result = anova(table, "y", ["a", "b", "c"], records=True, u_num=0.002, practical=1.0)
    effect = result.effect("a")
    assert effect.p is None
    assert effect.effect_over_u_num == pytest.approx((effect.range or 0) / 0.002)
    assert effect.resolved == "resolved"
    assert effect.verdict == "matters"
    # the half-normal plot keeps its contrasts
    assert result.lenth is not None


def test_blocked_spread_tests_have_a_p_of_their_own_design():
    result = anova(factorial({"a": 3}, 8, 6), "y", ["a"], block="rep", error="pooled")
    assert result.assumptions.bartlett.approximate
    for test in (result.assumptions.bartlett, result.assumptions.levene):
        assert 0 < test.p_monte_carlo <= 1


@pytest.mark.parametrize("studies", [150, pytest.param(600, marks=pytest.mark.slow)])
def test_blocked_monte_carlo_p_holds_its_size(studies):
    """Bartlett on residuals of 4 cells x 5 blocks, null studies: 5 % and half within 4 sd.

    The chi-squared p, which takes residuals for independent, is off in the same studies.
    """
    from study.statistics.analysis.data import prepare
    from study.statistics.analysis.equal_variance import ResidualDesign, bartlett
    from study.statistics.analysis.error_ledger import additive_fit

    table = factorial({"a": 4}, 5, 1)
    rng = np.random.default_rng(21)
    p, plain = [], []
    for _ in range(studies):
        data = prepare(table.assign(y=rng.normal(size=20)), "y", ["a"], "rep")
        fit = additive_fit(data, data.y)
        groups = [fit.residual[data.cell == c] for c in range(4)]
        found = bartlett(groups, simulations=400, design=ResidualDesign(fit.q, data.cell))
        p.append(found.p_monte_carlo)
        plain.append(found.p)
    for level in (0.05, 0.5):
        near = 4 * np.sqrt(level * (1 - level) / studies)
        assert np.mean(np.array(p) <= level) == pytest.approx(level, abs=near)


def test_influence_and_robustness_are_part_of_the_result():
    table = factorial({"a": 3, "b": 2}, 4, 8)
    table.loc[7, "y"] += 60.0
    result = anova(table, "y", ["a", "b"], exact=False)
    influence, cook = result.assumptions.influence, result.residuals["cook"]
    assert influence.max_leverage == pytest.approx(0.25, rel=1e-9)
    assert influence.max_cook == pytest.approx(max(cook))
    assert int(np.argmax(cook)) == 7
    analyses = {"ordinary F", "HC3 Wald", "Welch-James", "F of the log"}
    assert set(result.assumptions.robustness.p["a"]) == analyses
    assert result.assumptions.box_cox is not None
    document = result.to_json()
    assert document["robustness"]["agreement"]["a"].endswith("of 4 analyses")
    assert document["box_cox"]["ci95"][0] < document["box_cox"]["exponent"]
    own = anova(factorial({"a": 3, "b": 2}, 6, 8), "y", ["a", "b"], block="rep", error="own")
    row = own.assumptions.robustness.p["a"]
    assert row["own interaction, Greenhouse-Geisser"] == own.anova.row("a").p_gg
    table = factorial({"a": 3, "b": 2}, 6, 8)
    pooled = anova(table, "y", ["a", "b"], block="rep", error="pooled", exact=False)
    assert row["interactions pooled"] == pytest.approx(pooled.anova.row("a").p, rel=1e-9)
    assert len(row) == 4


def test_repeats_within_a_block_are_never_independent():
    """Five rows on each of four specimens in every cell: 3 x 4 - 3 - 4 + 1 = 6 residual df."""
    table = factorial({"a": 3, "s": 4}, 5, 11)
    result = anova(table, "y", ["a"], block="s", error="pooled", exact=False)
    assert result.anova.row("residual").df == 6
    assert any("repeats of a cell within a block are averaged" in w for w in result.notes)
    means = table.groupby(["a", "s"])["y"].mean().reset_index()
    by_hand = anova(means, "y", ["a"], block="s", error="pooled", exact=False)
    assert result.anova.row("a").f == pytest.approx(by_hand.anova.row("a").f, rel=1e-9)
    table.loc[3, "y"] = np.nan
    lost = anova(table, "y", ["a"], block="s", exact=False)
    assert any("y is missing in 1 of 60 rows" in w for w in lost.notes)
    assert lost.failure_bounds


def test_a_saturated_fraction_is_judged_by_its_own_contrasts():
    """2^(7-4), seven factors in eight runs: the classical effects, one of them large."""
    signs = np.array(list(itertools.product((-1, 1), repeat=3)))
    a, b, c = signs.T
    columns = dict(zip("ABCDEFG", (a, b, c, a * b, a * c, b * c, a * b * c), strict=True))
    y = 50 + 4 * columns["D"] + np.random.default_rng(1).normal(size=8) * 0.3
    result = anova(pd.DataFrame(columns).assign(y=y), "y", list("ABCDEFG"), model=1)
    assert result.error_term.source == "E6"
    assert result.lenth.names == tuple("ABCDEFG")
    assert result.lenth.active == ("D",)
    at = result.lenth.names.index("D")
    by_hand = y[columns["D"] == 1].mean() - y[columns["D"] == -1].mean()
    assert result.lenth.values[at] == pytest.approx(by_hand, rel=1e-9)
    assert result.anova.row("D").p == result.lenth.p[at]
    # with all interactions asked for, those that are other terms are left out, and nothing is
    # claimed; one sentence says so
    table = pd.DataFrame(columns).assign(y=y)
    full = anova(table, "y", list("ABCDEFG"), model=2, practical=1.0)
    assert [row.term for row in full.anova.rows] == [*"ABCDEFG", "residual"]
    assert full.anova.row("D").p == result.anova.row("D").p
    assert sum("A:B (= D)" in note for note in full.notes) == 1
    assert {e.verdict for e in full.effects} == {CANNOT_TELL}


def test_lenth_carries_a_verdict_where_a_term_is_one_contrast():
    """Unreplicated 2^4: the interval of an effect is effect +- the simultaneous margin."""
    table = factorial({"a": 2, "b": 2, "c": 2, "d": 2}, 1, 5)
    table["y"] += 9.0 * (table["a"] == "L1")
    result = anova(table, "y", list("abcd"), practical=2.0)
    effect = result.effect("a")
    margin = result.lenth.sme
    assert effect.ci95 == pytest.approx((effect.range - margin, effect.range + margin), rel=1e-9)
    assert effect.verdict == "matters"
    pair = result.effect("a:b")
    assert pair.ci95 == pytest.approx(((pair.range or 0) - margin, (pair.range or 0) + margin))
    mixed = anova(factorial({"a": 2, "b": 5}, 1, 5), "y", ["a", "b"], practical=0.1)
    assert mixed.error_term.source == "E6"
    assert mixed.effect("a").ci95 is None
    assert mixed.effect("a").verdict == "cannot tell"


@pytest.mark.parametrize("options", [{}, {"error": "own"}, {"records": True}])
def test_a_block_that_lies_in_one_cell_is_a_replicate_of_it(options):
    table = factorial({"a": 3, "s": 4}, 5, 11)
    table["specimen"] = table["a"] + table["s"]
    result = anova(table, "y", ["a"], block="specimen", exact=False, **options)
    unit = anova(table, "y", ["a"], unit="specimen", exact=False)
    assert result.anova.row("a").f == unit.anova.row("a").f
    assert result.anova.row("residual").df == 9
    assert "other levels of specimen" in result.error_term.question
    assert result.nested is not None
    means = table.groupby(["a", "specimen"])["y"].mean().reset_index()
    single = anova(means, "y", ["a"], block="specimen", exact=False, **options)
    assert single.anova.row("a").f == pytest.approx(result.anova.row("a").f, rel=1e-9)
    assert single.nested is None
    assert single.assumptions.normality is not None


def test_spread_of_two_cells_in_blocks_is_not_tested():
    table = factorial({"a": 2}, 6, 9)
    result = anova(table, "y", ["a"], block="rep", error="pooled")
    for test in (result.assumptions.bartlett, result.assumptions.levene):
        assert not test.applicable
        assert "mirror" in test.reason
