"""Groups of blocks, seeds as blocks, and the own-interaction test with Holm over a table."""

from itertools import product

import numpy as np
import pytest
from scipy.linalg import helmert
from scipy.special import fdtrc

from study.ground.errors import InputError
from study.statistics.analysis.comparisons import holm_family
from study.statistics.analysis.normality import helmert_contrasts
from study.statistics.analysis.repeats import common_seeds
from study.statistics.analysis.sums_of_squares import welch_box
from tests.analysis.test_row_normality import LAYOUT, TERMS

DIFFERENCE = np.array([1.0, -1.0])
FULL = [pytest.mark.slow, pytest.mark.verify]


def p_of_one_group(rows):
    """P of one group of blocks."""
    f, df1, df2 = welch_box([rows], np.ones(1))
    return float(fdtrc(df1, df2, f))


def test_several_weight_vectors_by_their_definition():
    """Three groups, two orthonormal differences; M written out block by block."""
    rng = np.random.default_rng(3)
    groups = [rng.standard_normal((2, n)) * s for n, s in ((4, 1.0), (5, 2.0), (6, 0.5))]
    w = helmert(3)
    m = np.zeros((4, 4))
    for i, j in product(range(2), repeat=2):
        block = sum(w[i, g] * w[j, g] * np.cov(z) / z.shape[1] for g, z in enumerate(groups))
        m[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block
    below = sum(
        ((w[:, g] ** 2).sum() * np.trace(np.cov(z)) / z.shape[1]) ** 2 / (z.shape[1] - 1)
        for g, z in enumerate(groups)
    )
    df1 = np.trace(m) ** 2 / np.trace(m @ m)
    found = welch_box(groups, w)
    assert found[1:] == pytest.approx((df1, df1 * np.trace(m) ** 2 / below))
    theta = w @ np.array([z.mean(axis=1) for z in groups])
    assert found[0] == pytest.approx(np.sum(theta**2) / np.trace(m))


def test_nothing_varies():
    assert welch_box([np.ones((2, 4))], np.ones(1)) is None


@pytest.mark.parametrize(
    ("cells", "seeds", "common", "left"),
    [
        ("aaabbb", "123123", "123", ""),
        ("aaabb", "12312", "12", "3"),
        ("aaabbb", "123456", "", ""),
        ("aaabbb", "123345", "", ""),
        ("ab", "11", "", ""),
    ],
)
def test_seeds_that_all_cells_share_are_blocks(cells, seeds, common, left):
    found, reason = common_seeds(cells, seeds)
    assert "".join(found) == common
    assert left in reason


def test_every_row_has_a_seed():
    with pytest.raises(InputError, match="one seed for each"):
        common_seeds("ab", "1")


def group_rates(sizes, ratio, n, seed):
    """Worst size of average and difference."""
    rng = np.random.default_rng(seed)
    sd = np.array([3.0, 1.0, 0.3, 0.1])[:, None]
    basis = helmert(4)
    rejected = np.zeros(2)
    for _ in range(n):
        cells = [
            s * sd * rng.standard_normal((4, m)) for s, m in zip((1.0, ratio), sizes, strict=True)
        ]
        rows = [basis @ y for y in cells]
        for i, weights in enumerate((abs(DIFFERENCE) / 2, DIFFERENCE)):
            f, df1, df2 = welch_box(rows, weights)
            rejected[i] += fdtrc(df1, df2, f) < 0.05
    return float(rejected.max() / n)


def seed_rates(rho, effect, n, seed, seeds=5):
    """Rejections of a factor whose third level differs by the effect, crossed with two levels."""
    rng = np.random.default_rng(seed)
    factor = np.kron(helmert(3).T, np.full((2, 1), 2**-0.5)).T
    mean = np.repeat([0.0, 0.0, effect], 2)[:, None]
    count = 0
    for _ in range(n):
        shared, own = rng.standard_normal((1, seeds)), rng.standard_normal((6, seeds))
        y = mean + np.sqrt(rho) * shared + np.sqrt(1 - rho) * own
        count += p_of_one_group(factor @ y) < 0.05
    return count / n


def test_seeds_as_blocks_find_what_they_should():
    """Bar 8: 3 x 2 cells, 5 seeds, correlation .8, effect .6."""
    assert seed_rates(0.8, 0.6, 2000, 51) >= 0.55
    for rho in (0.0, 0.5, 0.8, 0.95):
        assert seed_rates(rho, 0.0, 2000, 53) <= 0.06


def table_rates(spherical, n, seed):
    """Worst size of a term, and chance that Holm rejects anything, 4 x 2 x 2 cells, 6 blocks."""
    rng = np.random.default_rng(seed)
    sd = np.ones((16, 1)) if spherical else np.geomspace(0.1, 3, 16)[:, None]
    raw, familywise = np.zeros(len(TERMS)), 0
    for _ in range(n):
        contrasts = helmert_contrasts(LAYOUT, TERMS, sd * rng.standard_normal((16, 6)))
        p = {term: p_of_one_group(rows) for term, rows in contrasts.items()}
        raw += np.array([value < 0.05 for value in p.values()])
        family = holm_family({"y": p})
        familywise += any(t.p_holm is not None and t.p_holm < 0.05 for t in family)
    return float(raw.max() / n), familywise / n


@pytest.mark.parametrize(
    ("ratio", "n", "sizes"),
    [
        (3.0, 800, [(3, 3), (6, 12)]),
        (1.0, 800, [(4, 5)]),
        *(pytest.param(r, 10_000, [(3, 3), (4, 5), (3, 6), (6, 12)], marks=FULL)
          for r in (1.0, 3.0, 1 / 3)),
    ],
)  # fmt: skip
def test_groups_with_their_own_covariance_hold_the_size(ratio, n, sizes):
    """Bar 9 at 10,000 data sets; with fewer 3 standard errors more."""
    rates = [group_rates(pair, ratio, n, 43) for pair in sizes]
    print(f"groups {sizes}, sd ratio {ratio:.2g}: sizes {rates}")
    assert max(rates) <= 0.07 + (0.025 if n < 10_000 else 0.0)


@pytest.mark.parametrize(
    ("spherical", "n", "more"),
    [(False, 200, 0.05), *(pytest.param(s, 10_000, 0.0, marks=FULL) for s in (True, False))],
)
def test_a_table_holds_its_familywise_error(spherical, n, more):
    """Bar 6, the test of own interactions and Holm; with fewer data sets 3 standard errors more."""
    size, familywise = table_rates(spherical, n, 65)
    print(f"spherical {spherical}: worst size {size:.4f}, familywise {familywise:.4f}")
    assert size <= 0.065 + more
    assert familywise <= 0.057 + more
