"""What is kept of one factorization equals what factoring again would give."""

from __future__ import annotations

import numpy as np
import pytest

from study.statistics.analysis.comparisons import ASYMPTOTIC_BLOCKS
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import (
    model_matrix,
)
from study.statistics.analysis.sums_of_squares import factor, two_way
from tests.analysis.test_simple_effects import of_blocks


def test_two_factors_without_a_common_row_lose_a_degree_of_freedom() -> None:
    a, b = np.array([0, 0, 1, 1, 2, 2, 3, 3]), np.array([0, 1, 0, 1, 2, 3, 2, 3])
    y = np.arange(8.0) ** 2
    dense = factor(
        model_matrix(Layout({"a": tuple("0123"), "b": tuple("0123")}, {"a": a, "b": b}),
                     [("a",), ("b",)]), y,
    )  # fmt: skip
    fit = two_way(a, b, y)
    assert fit.rank == dense.rank == 6
    assert fit.residual == pytest.approx(dense.residual, abs=1e-12)


def test_the_multiplier_of_many_blocks_holds_its_level() -> None:
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
