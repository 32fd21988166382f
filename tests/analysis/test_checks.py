"""Guards and true sizes of the checks: Ryan-Joiner, Bartlett, Levene, Lenth, sphericity."""

import itertools

import numpy as np
import pytest
from scipy.stats import studentized_range
from statsmodels.stats.diagnostic import normal_ad

from study.statistics.analysis.comparisons import studentized_range_quantile
from study.statistics.analysis.equal_variance import bartlett, levene
from study.statistics.analysis.linear_model import CellLayout as Layout
from study.statistics.analysis.linear_model import terms_of
from study.statistics.analysis.normality import anderson_darling, ryan_joiner, shapiro_wilk
from study.statistics.analysis.sums_of_squares import epsilon_gg, sphericity
from study.statistics.analysis.unreplicated import lenth, orthonormal_contrasts


@pytest.mark.parametrize(
    ("values", "model", "reason"),
    [
        ([1.0, 2, 3], None, "needs n >= 4"),
        ([2.0] * 6, None, "all equal"),
        ([1, 2, 3, np.nan], None, "missing"),
        ([1.0, 2, 3, 5], np.eye(4), "no residual degrees of freedom"),
    ],
)
def test_ryan_joiner_guards(values, model, reason):
    result = ryan_joiner(values, model_matrix=model)
    assert not result.applicable
    assert reason in result.reason
    assert result.to_json() is None


@pytest.mark.parametrize("m", [3, 7, 15])
def test_lenth_limits_hold_their_size(m):
    """Individual and simultaneous error of 20,000 null studies (Monte-Carlo sd 0.15 %)."""
    from study.statistics.analysis.unreplicated import pseudo_standard_error

    z = np.random.default_rng(5).standard_normal((20_000, m))
    ratio = np.abs(z) / pseudo_standard_error(z)[:, None]
    limits = lenth(z[0])
    assert np.mean(ratio > limits.me / limits.pse) == pytest.approx(0.05, abs=0.004)
    assert np.mean(ratio.max(axis=1) > limits.sme / limits.pse) == pytest.approx(0.05, abs=0.007)


def test_orthonormal_contrasts_of_mixed_levels():
    cells = np.array(list(itertools.product(range(2), range(3), range(4))))
    layout = Layout(
        {"a": ("x", "y"), "b": ("1", "2", "4"), "c": tuple("pqrs")},
        {n: cells[:, i] for i, n in enumerate("abc")},
    )
    names, contrasts = orthonormal_contrasts(layout, terms_of("abc"))
    assert len(names) == 23
    assert contrasts.T @ contrasts == pytest.approx(np.eye(23), abs=1e-12)
    assert contrasts.sum(axis=0) == pytest.approx(np.zeros(23), abs=1e-12)
    # numeric levels give polynomial contrasts: the first is linear in 1, 2, 4
    linear = contrasts[: 4 * 3 : 4, names.index("b[1]")]
    assert np.ptp(np.diff(linear) / [1, 2]) == pytest.approx(0, abs=1e-12)


def test_half_normal_scores_are_of_the_absolute_values():
    scores = lenth([-3.0, 1.0, 2.0]).half_normal
    assert scores[0] > scores[2] > scores[1] > 0


@pytest.mark.parametrize(
    ("groups", "reason"),
    [
        ([[1, 2, 3], [5, 5, 5]], "group 2 has zero variance"),
        ([[1, 2, 3], [5]], "group 2 has one value"),
        ([[1, 2, 3]], "fewer than two groups"),
        ([[1, 2, 3], [1, 2, float("nan")]], "missing value"),
    ],
)
def test_variance_guards(groups, reason):
    for test in (bartlett, levene):
        result = test(groups)
        assert not result.applicable
        assert result.p is None
        if test is bartlett or "one" not in reason:
            assert reason in result.reason


def test_levene_is_chosen_by_group_size():
    rng = np.random.default_rng(3)
    two = levene(rng.normal(size=(4, 2)))
    assert not two.applicable
    three = levene(rng.normal(size=(4, 3)))
    assert three.center == "median"
    assert three.p_monte_carlo is not None
    assert levene(rng.normal(size=(4, 6))).p_monte_carlo is not None
    # the F distribution has converged there
    assert levene(rng.normal(size=(4, 100))).p_monte_carlo is None


def test_shapiro_and_anderson_guards():
    assert shapiro_wilk([3.0] * 8).p is None
    assert anderson_darling([3.0] * 9).p is None
    x = np.random.default_rng(1).normal(size=50)
    ours = anderson_darling(x)
    assert (ours.statistic, ours.p) == pytest.approx(normal_ad(x), rel=1e-8)


def test_shapiro_wilk_does_not_depend_on_the_unit():
    x = np.random.default_rng(3).normal(size=20)
    one, other = shapiro_wilk(x), shapiro_wilk(1e-21 * x)
    assert (other.statistic, other.p) == pytest.approx((one.statistic, one.p), rel=1e-6)


def test_epsilon_of_spherical_and_of_one_direction():
    assert epsilon_gg(np.eye(4)) == pytest.approx(1)
    assert epsilon_gg(np.diag([1.0, 0, 0, 0])) == pytest.approx(0.25)
    assert sphericity(np.random.default_rng(0).normal(size=(1, 9)), 8).epsilon_gg == 1
    assert sphericity(np.random.default_rng(0).normal(size=(6, 4)), 3).p is None


@pytest.mark.parametrize(("k", "df"), [(3, 2), (4, 24), (9, 180)])
def test_studentized_range_against_scipy(k, df):
    theirs = studentized_range.ppf(0.95, k, df)
    assert studentized_range_quantile(0.95, k, df) == pytest.approx(theirs, rel=1e-9)


def test_residuals_that_rounding_alone_tells_apart_are_ties():
    """Readings of whole numbers leave equal residuals, whatever the last digits of a fit are."""
    readings = np.round(np.random.default_rng(1).normal(0, 2, 20))
    noise = np.random.default_rng(2).normal(0, 1e-15, 20)
    assert ryan_joiner(readings + noise, exact=False).rj == pytest.approx(
        ryan_joiner(readings, exact=False).rj, rel=1e-12
    )
