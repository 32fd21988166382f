"""The upper tail of the noncentral F, against the mixture that defines it."""

import numpy as np
import pytest
from scipy.stats import beta, poisson

from study.ground.noncentral_f import noncentral_f_sf
from study.statistics.analysis.power import detectable, power_of

#: degrees of freedom, noncentralities and F; of the last three scipy 1.17 has no distribution
#: function
NUMBERS = [
    (3, 20, 2000.0, 600.0),
    (2, 6, 30.0, 9.0),
    (1, 9, 1791.2844546220022, 5.117355029199227),
    (4, 8246790, 4983.900474288909, 504.71420776710215),
    (53, 9281, 2749.5976375497007, 11.033582476021024),
]


@pytest.mark.parametrize(("df1", "df2", "noncentrality", "f"), NUMBERS)
def test_the_upper_tail_is_that_of_the_mixture(df1, df2, noncentrality, f):
    j = np.arange(10_000)
    terms = beta.sf(df1 * f / (df1 * f + df2), df1 / 2 + j, df2 / 2)
    expected = float(poisson.pmf(j, noncentrality / 2) @ terms)
    assert noncentral_f_sf(df1, df2, noncentrality, f) == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("noncentrality", [1e7, 9.9e8, 1.1e9, 1e12, 1e20])
def test_a_huge_noncentrality_leaves_the_denominator_alone(noncentrality):
    """With two degrees of freedom the denominator is exponential: P(F > f) = 1 - exp(-lambda/f)."""
    for ratio in (0.1, 1.0, 3.0):
        p = noncentral_f_sf(1, 2, noncentrality, noncentrality / ratio)
        assert p == pytest.approx(1 - np.exp(-ratio), abs=10 / noncentrality + 1e-6)


@pytest.mark.parametrize("n", [10, 2500, 1_000_000])
def test_every_difference_has_a_power(n):
    powers = [power_of(n * d**2 / 2, (1, n - 1), 0.05) for d in np.geomspace(1e-6, 1e3, 400)]
    assert np.isfinite(powers).all()
    assert (np.diff(powers) > -1e-9).all()
    size = detectable(1.0, n, (1, n - 1), 0.05, 0.8)
    assert power_of(n * size**2 / 2, (1, n - 1), 0.05) == pytest.approx(0.8, abs=1e-9)


def test_the_ends_of_the_upper_tail_are_one_and_none():
    tails = [noncentral_f_sf(3, 20, 5.0, f) for f in (-1.0, 0.0, float("inf"))]
    assert tails == [1.0, 1.0, 0.0]
