"""What is kept of one factorization equals what factoring again would give."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from study.statistics.analysis import linear_model
from study.statistics.analysis.comparisons import ASYMPTOTIC_BLOCKS
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import model_matrix, terms_of
from study.statistics.analysis.sums_of_squares import factor, influence, term_sums, two_way
from tests.analysis.test_simple_effects import of_blocks


def layout(sizes, rows, seed):
    """Complete factorial; with ``rows``, as many rows of it drawn with repeats besides."""
    cells = np.array(list(product(*map(range, sizes))))
    if rows is not None:
        drawn = np.random.default_rng(seed).integers(0, len(cells), rows)
        cells = np.vstack([cells, cells[drawn]])
    names = "abcd"[: len(sizes)]
    levels = {n: tuple(map(str, range(k))) for n, k in zip(names, sizes, strict=True)}
    return Layout(levels, {n: cells[:, i] for i, n in enumerate(names)})


@pytest.mark.parametrize("drop", [0.0, 0.3])
def test_two_factors_are_fitted_as_with_all_columns(drop):
    rng = np.random.default_rng(8)
    here = layout((7, 5), 60, 1)
    kept = np.flatnonzero(rng.random(here.n) >= drop)
    here = here.take(kept)
    y = 1e6 + rng.normal(size=here.n)
    dense = factor(model_matrix(here, [("a",), ("b",)]), y)
    for first, second in (("a", "b"), ("b", "a")):
        fit = two_way(here.codes[first], here.codes[second], y)
        assert fit.rank == dense.rank
        assert fit.residual == pytest.approx(dense.residual, abs=1e-9)
        assert fit.leverage == pytest.approx(dense.leverage, abs=1e-12)
        assert influence(fit).cook == pytest.approx(influence(dense).cook, rel=1e-7, abs=1e-12)
        other = rng.normal(size=here.n)
        assert fit.projected(other) == pytest.approx(dense.projected(other), abs=1e-12)


@pytest.mark.parametrize(("sizes", "terms"), [((4, 3, 3), "full"), ((5, 4, 3), 2)])
def test_many_columns_of_a_complete_layout_are_products_of_small_factors(monkeypatch, sizes, terms):
    monkeypatch.setattr(linear_model, "_MANY_COLUMNS", 30)
    here = layout(sizes, None, 1)
    matrix = model_matrix(here, terms_of(list("abc"), terms))
    assert matrix.columns.shape[1] >= 30
    assert linear_model._factored_products(matrix) is not None
    y = 1e3 + np.random.default_rng(2).normal(size=here.n)
    fit, dense = factor(matrix, y), factor(replace(matrix, layout=Layout({}, {})), y)
    assert fit.q @ fit.r * fit.scale == pytest.approx(matrix.columns, abs=1e-13)
    assert fit.q.T @ fit.q == pytest.approx(np.eye(fit.rank), abs=1e-13)
    assert fit.coefficients() == pytest.approx(dense.coefficients(), abs=1e-11)
    for kind in ("I", "II", "III"):
        sums = [term.ss for term in term_sums(fit, kind)]
        assert sums == pytest.approx([term.ss for term in term_sums(dense, kind)], rel=1e-10)


def test_two_factors_without_a_common_row_lose_a_degree_of_freedom():
    a, b = np.array([0, 0, 1, 1, 2, 2, 3, 3]), np.array([0, 1, 0, 1, 2, 3, 2, 3])
    y = np.arange(8.0) ** 2
    dense = factor(
        model_matrix(Layout({"a": tuple("0123"), "b": tuple("0123")}, {"a": a, "b": b}),
                     [("a",), ("b",)]), y,
    )  # fmt: skip
    fit = two_way(a, b, y)
    assert fit.rank == dense.rank == 6
    assert fit.residual == pytest.approx(dense.residual, abs=1e-12)


def test_the_multiplier_of_many_blocks_holds_its_level():
    """Of 30,000 draws of 60 blocks themselves: .96 to three standard errors, and .004 besides."""
    b, rng = 60, np.random.default_rng(12)
    assert b >= ASYMPTOTIC_BLOCKS
    contrasts = rng.normal(size=(30, b)) * np.exp(-np.arange(30) / 10)[:, None]
    contrasts[10:] += 2 * contrasts[0]
    found = of_blocks(contrasts)
    z = contrasts - contrasts.mean(axis=1, keepdims=True)
    z = np.linalg.qr((z / np.linalg.norm(z, axis=1)[:, None]).T, mode="r").T
    inside = 0
    for _ in range(60):
        x = z @ rng.standard_normal((500, z.shape[1], b))
        t = np.abs(x.mean(axis=2)) / x.std(axis=2, ddof=1) * np.sqrt(b)
        inside += int(np.count_nonzero(t.max(axis=1) <= found))
    assert inside / 30_000 == pytest.approx(0.96, abs=0.004 + 3 * (0.96 * 0.04 / 4000) ** 0.5)
