"""Probabilities of verdicts before a study: published distributions, simulation, the rules."""

import math

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import chi2, nct, norm
from scipy.stats import t as student

from study.ground.errors import InputError
from study.statistics.analysis.comparisons import scale_rule
from study.statistics.analysis.power import (
    fewest_blocks,
    planned_verdicts,
    verdict_probabilities,
)
from study.statistics.analysis.simple_effects import CANNOT_TELL, judge_all


def claims(low, high):
    """1 matters, -1 no practical difference, 0 neither; practical 1."""
    return ((low > 1) | (high < -1)) * 1 - ((low > -1) & (high < 1))


def simulated(blocks, sd, truth, u, n, seed):
    """Rates of matters, no practical difference, not resolved, cannot tell; practical 1."""
    rng = np.random.default_rng(seed)
    d = truth + sd / math.sqrt(blocks) * rng.standard_normal(n)
    s = sd * np.sqrt(rng.chisquare(blocks - 1, n) / (blocks - 1))
    half = student.ppf(0.975, blocks - 1) * s / math.sqrt(blocks)
    claim = claims(d - half - u, d + half + u)
    able = claims(d - half, d + half)
    lost = (claim == 0) & (able != 0)
    return np.array([np.mean(claim == 1), np.mean(claim == -1), np.mean(lost), np.mean(able == 0)])


@pytest.mark.parametrize("df", [1.0, 5.5, 49.0, 51.0, 1e3, 1e5, 1e7, 1e10, 1e13, 1e15, 1e300])
def test_a_scale_has_its_moments_whatever_its_freedom(df):
    """E 1 = E chi2_df / df = 1, its variance 2 / df, by a density of any number of rows."""
    s, weights = scale_rule(df)
    assert weights.sum() == pytest.approx(1.0, abs=1e-9)
    assert weights @ s**2 == pytest.approx(1.0, abs=1e-9)
    assert weights @ (s**2 - 1) ** 2 == pytest.approx(2 / df, rel=1e-6, abs=2e-14)


@pytest.mark.parametrize("blocks", [2, 5, 9])
@pytest.mark.parametrize("truth", [0.0, 1.0, 1.6])
def test_matters_is_the_noncentral_t(blocks, truth):
    root = math.sqrt(blocks) / 0.3
    t = student.ppf(0.975, blocks - 1)
    upper = nct.sf(t, blocks - 1, (truth - 1.2) * root)
    lower = nct.sf(t, blocks - 1, (-truth - 1.2) * root)
    found = verdict_probabilities(blocks, 0.3, 1.0, truth, u=0.2)
    assert found.matters == pytest.approx(upper + lower, abs=1e-8)


@pytest.mark.parametrize(
    ("blocks", "sd", "truth", "u"),
    [(2, 0.1, 0.0, 0.0), (3, 0.3, 0.0, 0.2), (5, 0.3, 2.0, 0.5), (9, 0.5, 0.5, 0.1)],
)
def test_probabilities_are_those_of_simulated_studies(blocks, sd, truth, u):
    found = verdict_probabilities(blocks, sd, 1.0, truth, u=u)
    p = np.array(
        [found.matters, found.no_practical_difference, found.not_resolved, found.cannot_tell]
    )
    assert p.sum() == pytest.approx(1, abs=1e-9)
    assert simulated(blocks, sd, truth, u, 200_000, 91) == pytest.approx(p, abs=0.005)


@pytest.mark.parametrize("value", [0.0, 0.3, 5.0])
def test_one_specimen_never_claims(value):
    """Bar 12: there is no interval, whatever the number."""
    none = np.array([math.nan])
    assert judge_all(none, none, 1.0, np.array([0.05])).verdict == CANNOT_TELL
    assert verdict_probabilities(1, 0.3, 1.0, value).cannot_tell == 1


def test_the_fewest_blocks_reach_what_was_wanted_and_one_less_does_not():
    for sd in (0.2, 0.5, 1.0):
        for level, blocks in zip((0.8, 0.9), fewest_blocks(sd, 1.0), strict=True):
            assert blocks is not None
            assert planned_verdicts([blocks], sd, 1.0)[0].right >= level
            assert planned_verdicts([blocks - 1], sd, 1.0)[0].right < level
    assert fewest_blocks(0.2, 1.0, u=1.0) == (None, None)


def test_cost_counts_every_solve():
    plan = planned_verdicts([3, 5], 0.3, 1.0, cells=6, seconds=10.0)
    assert [(row.cases, row.seconds) for row in plan] == [(18, 180.0), (30, 300.0)]
    assert plan[1].equal == verdict_probabilities(5, 0.3, 1.0, 0.0)


@pytest.mark.parametrize(
    ("blocks", "sd", "practical", "u"),
    [(0, 1, 1, 0), (3, 0, 1, 0), (3, 1, -1, 0), (3, 1, 1, math.inf)],
)
def test_bad_plans(blocks, sd, practical, u):
    with pytest.raises(InputError):
        verdict_probabilities(blocks, sd, practical, 0.0, u=u)


@pytest.mark.parametrize("blocks", [2, 3, 9])
@pytest.mark.parametrize("u", [0.0, 0.4])
def test_no_difference_is_integrated_up_to_its_kink(blocks, u):
    """Beyond it the interval is wider than the band; a rule across it erred by 1e-3."""
    sd, df = 0.8, blocks - 1
    error = sd / blocks**0.5
    t = float(student.ppf(0.975, df)) * error

    def density(s):
        inside = 2 * norm.cdf((1 - u - t * s) / error) - 1
        return float(max(0.0, inside) * 2 * df * s * chi2.pdf(df * s * s, df))

    theirs = quad(density, 0, (1 - u) / t, epsabs=1e-12)[0]
    found = verdict_probabilities(blocks, sd, 1.0, 0.0, u=u)
    assert found.no_practical_difference == pytest.approx(theirs, abs=1e-9)
