"""The noncentral F where scipy gives no number, against the mixture that defines it."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.special import ncfdtr
from scipy.stats import beta, poisson

from study.ground import noncentral_f
from study.ground.noncentral_f import noncentral_f_cdf
from study.statistics.analysis.power import detectable, power_of

#: degrees of freedom and noncentralities at which scipy 1.17 gives NaN, and the critical F
NOT_A_NUMBER = [
    (1, 9, 1791.2844546220022, 5.117355029199227),
    (4, 8246790, 4983.900474288909, 504.71420776710215),
    (53, 9281, 2749.5976375497007, 11.033582476021024),
]


@pytest.mark.parametrize(("df1", "df2", "noncentrality", "f"), NOT_A_NUMBER)
def test_where_the_series_fails_the_mixture_answers(
    df1: int, df2: int, noncentrality: float, f: float
) -> None:
    j = np.arange(10_000)
    terms = beta.cdf(df1 * f / (df1 * f + df2), df1 / 2 + j, df2 / 2)
    expected = float(poisson.pmf(j, noncentrality / 2) @ terms)
    assert noncentral_f_cdf(df1, df2, noncentrality, f) == pytest.approx(expected, rel=1e-9)


def test_both_ways_agree_where_both_have_an_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, pairs = np.random.default_rng(4), []
    monkeypatch.setattr(noncentral_f, "_SERIES", -1.0)
    for _ in range(200):
        df1, df2 = int(rng.integers(1, 60)), int(10 ** rng.uniform(0, 7))
        noncentrality = 10 ** rng.uniform(2.5, 4)
        f = abs(rng.normal(1, 1)) * (1 + noncentrality / df1)
        pairs.append((ncfdtr(df1, df2, noncentrality, f), (df1, df2, noncentrality, f)))
    known = [(value, where) for value, where in pairs if np.isfinite(value)]
    assert len(known) > 190
    for value, where in known:
        assert noncentral_f_cdf(*where) == pytest.approx(value, abs=2e-11)


@pytest.mark.parametrize("noncentrality", [1e7, 1e12, 1e20])
def test_a_huge_noncentrality_leaves_the_denominator_alone(noncentrality: float) -> None:
    """With two degrees of freedom the denominator is exponential: P(F <= f) = exp(-lambda/f)."""
    for ratio in (0.1, 1.0, 3.0):
        p = noncentral_f_cdf(1, 2, noncentrality, noncentrality / ratio)
        assert p == pytest.approx(np.exp(-ratio), abs=10 / noncentrality + 1e-6)


@pytest.mark.parametrize("n", [10, 2500, 1_000_000])
def test_every_difference_has_a_power(n: int) -> None:
    powers = [power_of(n * d**2 / 2, (1, n - 1), 0.05) for d in np.geomspace(1e-6, 1e3, 400)]
    assert np.isfinite(powers).all()
    assert (np.diff(powers) > -1e-9).all()
    size = detectable(1.0, n, (1, n - 1), 0.05, 0.8)
    assert power_of(n * size**2 / 2, (1, n - 1), 0.05) == pytest.approx(0.8, abs=1e-9)
