"""Normality of contrasts over blocks, shares of blocks, Levene by Monte Carlo."""

import tracemalloc

import numpy as np
import pytest
import scipy.stats

from study.ground.errors import InputError
from study.statistics.analysis.equal_variance import _levene, _normal_draws
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import grid, terms_of
from study.statistics.analysis.normality import (
    block_share,
    helmert_contrasts,
    row_normality,
    ryan_joiner,
    statistic,
)

NAMES = ("A", "B", "C")
LAYOUT = grid(
    Layout(
        {"A": tuple("1234"), "B": tuple("12"), "C": tuple("12")},
        {f: np.zeros(1, dtype=np.int64) for f in NAMES},
    ),
    NAMES,
)
TERMS = terms_of(NAMES)


def draw(kind, rng, n, blocks):
    """Responses of 16 cells, shape (n, 16, blocks)."""
    z = rng.standard_normal((n, 16, blocks))
    if kind == "non-spherical":
        return z * np.geomspace(0.1, 3, 16)[:, None]
    if kind == "block-wide t3":
        return np.asarray(z / np.sqrt(rng.chisquare(3, (n, 1, blocks)) / 3))
    return z


def rejections(kind, blocks, n, seed):
    rng = np.random.default_rng(seed)
    found = [
        row_normality(helmert_contrasts(LAYOUT, TERMS, y)).rejected
        for y in draw(kind, rng, n, blocks)
    ]
    return float(np.mean(found))


def test_contrasts_of_all_terms_are_one_rotation():
    y = draw("spherical", np.random.default_rng(1), 1, 5)[0]
    rows = np.vstack(list(helmert_contrasts(LAYOUT, TERMS, y).values()))
    centred = y - y.mean(axis=0)
    assert rows.shape == (15, 5)
    assert np.sum(rows**2) == pytest.approx(np.sum(centred**2))


def test_an_incomplete_table_is_refused():
    with pytest.raises(InputError, match="every combination"):
        helmert_contrasts(LAYOUT.take(np.arange(15)), TERMS, np.zeros((15, 4)))


def test_a_row_has_the_statistic_and_p_of_its_values():
    rows = np.random.default_rng(2).standard_exponential((2, 12)) ** 2
    found = row_normality({"A": rows})
    for test, row in zip(found.rows, rows, strict=True):
        assert test.rj == pytest.approx(statistic(row))
        # two simulations of 100,000: four standard errors of their difference
        alone = ryan_joiner(row, seed=7).p_exact
        assert test.p == pytest.approx(alone, abs=6 * np.sqrt(alone / 1e5) + 2e-5)
    assert found.p == pytest.approx(1 - (1 - min(t.p for t in found.rows)) ** 2)
    assert found.rejected
    assert found.warning == ""


def test_p_of_all_contrasts_is_the_share_of_normal_studies_that_look_worse():
    rng = np.random.default_rng(8)
    p = [row_normality({"A": rows}).p for rows in rng.standard_normal((400, 8, 6))]
    assert scipy.stats.kstest(p, "uniform").pvalue > 0.01


def test_rows_that_say_nothing_are_left_out():
    row = np.random.default_rng(4).standard_normal(9)
    found = row_normality(
        {"A": np.array([row, -2 * row + 3]), "B": np.array([1e-9 * row, np.ones(9)])},
        tolerance=1e-8,
    )
    assert [(t.term, t.contrast) for t in found.rows] == [("A", 0)]
    none = row_normality({"B": np.ones((1, 9))})
    assert none.p is None
    assert "no contrast" in none.warning


def test_few_blocks_are_said():
    rows = np.random.default_rng(5).standard_normal((2, 5))
    assert "power is small" in row_normality({"A": rows}).warning
    assert "more blocks" in row_normality({"A": rows[:, :3]}).warning


def test_the_block_that_carries_the_interaction_is_named():
    y = draw("spherical", np.random.default_rng(6), 1, 9)[0]
    y[:, 6] *= 12
    found = block_share(helmert_contrasts(LAYOUT, TERMS, y))
    assert found.block == 6
    assert found.share > 0.5
    assert found.p < 0.01
    assert block_share({"A": np.ones((1, 9))}) is None


def test_the_share_of_a_block_among_thousands_takes_little_memory():
    """With the rows themselves as root 2,500 blocks would take 6 million normals a study."""
    rows = {"A": np.random.default_rng(6).standard_normal((2, 2500))}
    rows["A"][0, 17] = 40.0
    tracemalloc.start()
    found = block_share(rows)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert (found.block, found.p) == (17, pytest.approx(1 / 2001))
    assert peak < 50e6


LONG = [
    pytest.param(b, 2000, 0.0, marks=[pytest.mark.slow, pytest.mark.verify]) for b in (5, 6, 9, 15)
]


@pytest.mark.parametrize(("blocks", "n", "error"), [(6, 200, 0.02), *LONG])
def test_row_normality_holds_its_size_and_has_power(blocks, n, error):
    """Bar 7 at 2,000 data sets."""
    size = {k: rejections(k, blocks, n, 73) for k in ("spherical", "non-spherical")}
    assert max(size.values()) <= 0.07 + error
    if blocks == 9:
        assert rejections("block-wide t3", blocks, n, 75) >= 0.30


@pytest.mark.parametrize("each", [3, 5, 6, 10])
def test_levene_by_monte_carlo_has_the_size_it_claims(each):
    """Bar 7: 20,000 data sets of four normal groups, by the test of the median."""
    simulated = [_levene(g, "median")[0] for g in _normal_draws(np.full(4, each), 20_000, 2011)]
    null = np.sort(np.concatenate(simulated))
    rng = np.random.default_rng(81)
    w = _levene([rng.standard_normal((20_000, each)) for _ in range(4)], "median")[0]
    beyond = null.size - np.searchsorted(null, w, side="left")
    size = float(np.mean((1 + beyond) / (null.size + 1) < 0.05))
    assert 0.043 <= size <= 0.057


def test_the_smaller_root_draws_studies_of_the_same_kind(monkeypatch):
    rng = np.random.default_rng(7)
    rows = {"A": rng.standard_normal((3, 3)) @ rng.standard_normal((3, 40))}
    usual = block_share(rows)
    monkeypatch.setattr("study.statistics.analysis.normality._MOST_NORMALS", 0)
    # two simulated p of 2,000 studies each
    four_errors = 4 * (0.5 * usual.p * (1 - usual.p) / 500) ** 0.5
    assert block_share(rows).p == pytest.approx(usual.p, abs=four_errors)
