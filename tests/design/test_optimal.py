"""D-optimal designs against known bounds of the determinant."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from study.harness.design.generators import d_optimal, efficiency, model_columns


def main_effects(factors: int) -> list[tuple[int, ...]]:
    return [(k,) for k in range(factors)]


@pytest.mark.parametrize(
    ("sizes", "runs"),
    [((2,) * 4, 8), ((2,) * 7, 8), ((2,) * 11, 12), ((3,) * 4, 9), ((2, 2, 2, 3), 12)],
)
def test_orthogonal_arrays_are_found(sizes: tuple[int, ...], runs: int) -> None:
    # half fraction, Hadamard 8, Plackett and Burman 12, Taguchi's L9, L12 of mixed levels
    words = main_effects(len(sizes))
    found = d_optimal(sizes, words, runs, seed=1)
    assert len(set(found)) == runs
    assert efficiency(found, sizes, words) == pytest.approx(1.0, abs=1e-9)


@pytest.mark.parametrize(("factors", "runs"), [(3, 6), (5, 10)])
def test_the_bound_of_ehlich_is_met(factors: int, runs: int) -> None:
    """Ehlich 1964, Math. Z. 83, 123: det <= [(n - 2 + p) (n - 2)^(p/2 - 1)]^2 for n = 2 mod 4."""
    p = factors + 1
    bound = ((runs - 2 + p) * (runs - 2) ** (p // 2 - 1)) ** 2
    found = d_optimal((2,) * factors, main_effects(factors), runs, seed=1)
    x = model_columns(np.array(found), (2,) * factors, main_effects(factors))
    assert np.linalg.det(x.T @ x) == pytest.approx(bound, rel=1e-9)


def test_given_cells_are_kept_and_not_chosen_again() -> None:
    sizes, words = (2, 2, 2), [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2)]
    given = [(0, 0, 1), (0, 1, 0), (1, 0, 0), (1, 1, 1)]
    found = d_optimal(sizes, words, 4, seed=3, given=given)
    assert sorted([*given, *found]) == sorted(itertools.product(range(2), repeat=3))


def test_the_best_of_all_subsets_is_found_where_they_can_be_counted() -> None:
    """C(12, 6) = 924 designs of 6 of the 12 cells of 2 x 2 x 3."""
    sizes, words = (2, 2, 3), main_effects(3)
    every = list(itertools.product(range(2), range(2), range(3)))
    best = max(efficiency(rows, sizes, words) for rows in itertools.combinations(every, 6))
    found = d_optimal(sizes, words, 6, seed=5)
    assert efficiency(found, sizes, words) == pytest.approx(best, rel=1e-9)
