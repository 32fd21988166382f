"""Simple effects, simultaneous intervals and families of tests: by hand and by simulation."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import t as student

from study.ground.errors import InputError
from study.reporting.content.effect_words import told
from study.statistics.analysis import simple_effects as simple_effects_module
from study.statistics.analysis.anova import anova
from study.statistics.analysis.comparisons import block_multiplier, holm_family
from study.statistics.analysis.effects import over_groups
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import grid, model_matrix, terms_of
from study.statistics.analysis.post_hoc import dunnett_over_groups
from study.statistics.analysis.simple_effects import (
    MATTERS,
    NO_DIFFERENCE,
    Confidence,
    simple_effects,
)
from study.statistics.analysis.sums_of_squares import factor as fitted

FULL = ("A", "B", "C")


def factorial(levels):
    names = FULL[: len(levels)]
    labels = {f: tuple(f"{f}{i}" for i in range(k)) for f, k in zip(names, levels, strict=True)}
    return grid(Layout(labels, {f: np.zeros(1, dtype=np.int64) for f in names}), names)


def two_cubed(names):
    """Cells of a 2^3 whose named effects are 0.9 each."""
    layout = factorial((2, 2, 2))
    sign = {f: 1 - 2.0 * layout.codes[f] for f in FULL}
    y = sum(0.45 * np.prod([sign[f] for f in name], axis=0) for name in names)
    return layout, np.asarray(y)


def with_blocks(cells, blocks, se, seed=1):
    """Cells in blocks with levels of their own, differences with standard error ``se``."""
    rng = np.random.default_rng(seed)
    sd = se * np.sqrt(blocks / 2)
    noise = sd * rng.standard_normal((cells.size, blocks))
    return cells[:, None] + rng.standard_normal(blocks) + noise


def judged(layout, y, factor, practical):
    """Simple effects of a factor as a study with blocks judges them."""
    fit = fitted(model_matrix(layout, terms_of(tuple(layout.levels))), y.mean(axis=1))
    added = np.linalg.pinv(fit.matrix.columns) @ (y - y[0, 0]) / y.shape[1]
    sample = over_groups(fit, added, [np.arange(y.shape[1])], Confidence(0.05, 1))
    found = simple_effects(factor, fit.matrix, sample, practical, None)
    assert found is not None
    return found


def test_effects_that_average_out_do_not_let_a_factor_be_chosen():
    """Bar 4: A, A:B, A:C and A:B:C of 0.9 each make one simple effect of 3.6."""
    layout, cells = two_cubed(("A", "AB", "AC", "ABC"))
    found = judged(layout, with_blocks(cells, 6, 0.02), "A", 1.0)
    assert max(abs(e.difference) for e in found.effects) == pytest.approx(3.6, abs=0.1)
    assert found.verdict == MATTERS
    assert [e.at for e in found.effects if e.verdict == MATTERS] == [(("B", "B0"), ("C", "C0"))]


def test_without_interactions_every_factor_may_be_chosen():
    layout, cells = two_cubed(FULL)
    y = with_blocks(cells, 6, 0.02)
    for factor in FULL:
        assert judged(layout, y, factor, 1.0).verdict == NO_DIFFERENCE


def of_blocks(contrasts):
    """Multiplier of contrasts over blocks of one group; shape (m, b)."""
    m, b = contrasts.shape
    return float(
        block_multiplier(contrasts, [np.arange(b)], np.full(m, b - 1.0), Confidence(0.05, 1))[0]
    )


@given(st.integers(0, 1000), st.integers(2, 6), st.integers(5, 9))
def test_the_multiplier_lies_between_one_interval_and_all(seed, k, b):
    rows = np.random.default_rng(seed).standard_normal((k, b))
    found = of_blocks(rows)
    assert student.isf(0.025, b - 1) * 0.97 <= found <= student.isf(0.025 / k, b - 1) + 1e-9


def test_the_multiplier_is_that_of_blocks_drawn_one_by_one():
    rng = np.random.default_rng(3)
    contrasts = rng.standard_normal((5, 7)) * np.array([[1], [2], [3], [0.1], [1]])
    contrasts[4] = contrasts[0] + 1e-3 * contrasts[4]
    z = (contrasts - contrasts.mean(axis=1, keepdims=True)) / np.sqrt(6)
    x = z @ rng.standard_normal((40_000, 7, 7))
    t = np.abs(x.mean(axis=2)) / (x.std(axis=2, ddof=1) / np.sqrt(7))
    expected = np.quantile(t.max(axis=1), 0.96)
    assert of_blocks(contrasts) == pytest.approx(expected, rel=0.05)


def test_few_blocks_take_bonferroni():
    rows = np.random.default_rng(5).standard_normal((3, 4))
    assert of_blocks(rows) == pytest.approx(student.ppf(1 - 0.05 / 6, 3))


def test_levels_against_a_reference_in_blocks():
    rng = np.random.default_rng(6)
    block = rng.standard_normal(8)
    levels = {
        name: (mean + block + 0.1 * rng.standard_normal(8)) / 8
        for name, mean in {"none": 0.0, "same": 0.0, "far": 1.0}.items()
    }
    found = dunnett_over_groups(levels, "none", [np.arange(8)], "", Confidence(0.05, 2011))
    same, far = found.pairs
    assert same.lower < 0 < same.upper
    assert far.lower > 0
    assert far.p < 0.05 < same.p
    for pair in found.pairs:  # interval and p agree
        assert (pair.p < 0.05) == (pair.lower > 0 or pair.upper < 0)


def test_primary_terms_form_the_family():
    p = {"A": 0.01, "B": 0.04, "C": 0.03}
    found = {t.term: (t.p_holm, t.family) for t in holm_family({"force": p}, ["A"])}
    assert found == {"A": (0.01, 1), "B": (None, 1), "C": (None, 1)}
    with pytest.raises(InputError, match="at most 3"):
        holm_family({"force": p}, ["A", "B", "C", "A"])
    with pytest.raises(InputError, match="no term"):
        holm_family({"force": p}, ["X"])
    with pytest.raises(InputError, match=r"\[0, 1\]"):
        holm_family({"force": {"A": 1.2}})


def test_a_study_is_one_family():
    found = holm_family({"force": {"A": 0.01}, "work": {"A": 0.02}})
    tests = [(t.response, t.p_holm, t.family) for t in found]
    assert tests == [("force", 0.02, 2), ("work", 0.02, 2)]


@dataclass(frozen=True)
class Case:
    """Errors of the cells over blocks; sd 1 of one cell unless graded."""

    levels: int
    blocks: int
    errors: str

    def data(self, rng, n):
        cells = self.levels * 4
        shape = (n, cells, self.blocks)
        if self.errors == "t4":
            return rng.standard_t(4, shape) / np.sqrt(2)
        z = rng.standard_normal(shape)
        if self.errors == "graded":
            return z * np.geomspace(0.1, 2, cells)[:, None]
        if self.errors == "near copies":  # levels of A differ by 1 % of what they share
            return np.asarray(np.tile(z[:, :4], (1, self.levels, 1)) + 0.01 * z)
        return z


def outcomes(case, n, seed):
    """False "all inside" at one shift of exactly practical, coverage, claims at 0."""
    layout = factorial((case.levels, 2, 2))
    # sd of single cells is 1: unadjusted intervals claim about 0.8 at this practical difference
    practical = 3.4 * (0.01 if case.errors == "near copies" else 1.0)
    counts = dict.fromkeys(("claimed at 0", "coverage", "false inside"), 0)
    for y in case.data(np.random.default_rng(seed), n):
        found = judged(layout, y, "A", practical)
        counts["claimed at 0"] += found.verdict == NO_DIFFERENCE
        wide = [e.ci_simultaneous for e in found.effects]
        counts["coverage"] += all(ci is not None and ci[0] <= 0 <= ci[1] for ci in wide)
        y[0] += practical
        counts["false inside"] += judged(layout, y, "A", practical).verdict == NO_DIFFERENCE
    return {name: count / n for name, count in counts.items()}


ERRORS = ("spherical", "graded", "near copies", "t4")
FEW = [(2, 5, "spherical"), (4, 9, "near copies")]
ALL = [(k, b, e) for k in (2, 4) for b in (5, 6, 9) for e in ERRORS]


@pytest.mark.parametrize(
    ("case", "n", "error"),
    [
        # 3 standard errors of a rate of .95 or .03
        *((Case(*case), 40, 0.1) for case in FEW),
        *(pytest.param(Case(*case), 1000, 0.0, marks=[pytest.mark.slow, pytest.mark.verify])
          for case in ALL),
    ],
)  # fmt: skip
def test_simple_effects_hold_their_rates(case, n, error):
    """Bar 5 at 1,000 data sets, with ``error`` for fewer."""
    found = outcomes(case, n, 31)
    print(case, found)
    assert found["false inside"] <= 0.04 + error
    most = 0.99 if case.errors == "near copies" else 0.985
    assert 0.935 - error <= found["coverage"] <= most + error
    if case == Case(2, 5, "spherical"):
        assert found["claimed at 0"] >= 0.70 - error


def test_a_table_says_that_only_single_settings_matter():
    """An average below what matters beside *matters* would be a contradiction."""
    rng = np.random.default_rng(3)
    rows = [
        (block, a, b, base + (3.0 if (a, b) == ("y", "q") else 0.0) + rng.normal(0, 0.05))
        for block, base in enumerate(rng.normal(8, 0.5, 6))
        for a in "xy"
        for b in "pq"
    ]
    table = pd.DataFrame(rows, columns=["block", "a", "b", "response"])
    some, every = (
        anova(table, "response", ["a", "b"], block="block", practical=limit, exact=False).effects[0]
        for limit in (2.0, 1.0)
    )
    assert (some.term, some.verdict, told(some)) == ("a", MATTERS, "matters at some settings")
    assert some.range == pytest.approx(1.5, abs=0.1)  # half of 3: one of two settings
    assert (every.verdict, told(every)) == (MATTERS, MATTERS)


@pytest.mark.parametrize("k", [3, 40])
def test_differences_in_pieces_are_those_of_all_rows(monkeypatch, k):
    """Many pairs of settings never stand in memory at once; the answers are the same."""
    random = np.random.default_rng(k)
    settings = random.normal(size=(k, 6))
    settings[1] = settings[0] + 1e-9 * settings[1]  # so near that products of settings cancel
    first, second = np.triu_indices(k, 1)
    pairs, by = simple_effects_module.Differences(settings, first, second), random.normal(size=6)
    at_once = pairs.rows @ by, pairs.lengths(), pairs.rows**2
    monkeypatch.setattr(simple_effects_module, "AT_ONCE", 13)
    in_pieces = pairs.times(by), pairs.lengths(), pairs.each(np.square)
    for whole, pieced in zip(at_once, in_pieces, strict=True):
        np.testing.assert_allclose(pieced, whole, rtol=2e-13, atol=2e-15)


def test_an_analysis_in_pieces_says_what_one_at_once_says(monkeypatch):
    """Three factors with replicates: pooled and unequal scatter, with and without pieces."""
    random = np.random.default_rng(5)
    table = pd.DataFrame([*product(range(3), range(2), range(2))] * 3, columns=["a", "b", "c"])
    table["y"] = 3.0 * table.a + table.b * table.c + random.normal(size=len(table))
    for error in ("auto", "welch"):
        asked = {"practical": 1.0, "error": error, "exact": False}
        whole = anova(table, "y", ["a", "b", "c"], **asked)
        with monkeypatch.context() as patch:
            patch.setattr(simple_effects_module, "AT_ONCE", 20)
            pieced = anova(table, "y", ["a", "b", "c"], **asked)
        for one, other in zip(whole.effects, pieced.effects, strict=True):
            assert (one.term, one.verdict, one.why) == (other.term, other.verdict, other.why)
            np.testing.assert_allclose(one.ci95, other.ci95, rtol=1e-12)
