"""E2 with noise that cells have in common: right size, and no power from more resamples."""

import numpy as np
import pandas as pd
import pytest

import study
from study.statistics.analysis import gate
from study.statistics.analysis.anova import anova
from study.statistics.analysis.post_hoc import coefficient_table

#: noise of the fits of four cells to one curve: pairs are nearly the same fit
CORRELATED = np.kron([[1.0, 0.3], [0.3, 1.0]], [[1.0, 0.95], [0.95, 1.0]])


def resampled(random, resamples, effect=0.0, block="noise_seed"):
    """Fits to one noisy curve, and their refits to resampled noise, of a 2 x 2 factorial."""
    root = np.linalg.cholesky(CORRELATED)
    truth = 10 + effect * np.array([0.0, 0.0, 1.0, 1.0])
    fitted = truth + root @ random.standard_normal(4)
    again = fitted + random.standard_normal((resamples, 4)) @ root.T
    again += fitted - again.mean(
        axis=0
    )  # the mean of refits is the fit; its error is not the point
    rows = [
        {"energy": "ab"[cell // 2], "space": "xy"[cell % 2], "noise_seed": k, "mu0": again[k, cell]}
        for k in range(resamples)
        for cell in range(4)
    ]
    return anova(
        pd.DataFrame(rows), "mu0", ["energy", "space"], block=block, replicates="noise",
        records=True, exact=False, practical=100.0, specimens=1,
    )  # fmt: skip


@pytest.mark.slow
def test_the_test_has_its_size_whatever_cells_have_in_common():
    random = np.random.default_rng(3)
    terms = ("energy", "space", "energy:space")
    rejected = dict.fromkeys(terms, 0)
    trials = 300
    for _ in range(trials):
        rows = {row.term: row for row in resampled(random, 30).anova.rows}
        for term in terms:
            rejected[term] += rows[term].p_deciding < 0.05
    # binomial: 5 % of 300 +- 3 sd of 1.26 %. With cells taken for independent the energy, a
    # mean over two fits that are nearly one, was rejected in 13 % of 150, the space in none
    for term in terms:
        assert 0.012 < rejected[term] / trials < 0.088, term


@pytest.mark.parametrize("resamples", [25, 400])
def test_more_resamples_narrow_no_interval(resamples):
    result = resampled(np.random.default_rng(5), resamples, effect=2.0)
    assert result.error_term.source == "E2"
    effect = next(e for e in result.effects if e.term == "energy")
    half = (effect.ci95[1] - effect.ci95[0]) / 2
    # variance of a difference of two pair means: 2 (0.975 - 0.3) = 1.35; sd of 25: 14 %
    assert half == pytest.approx(2.0 * np.sqrt(1.35), rel=0.3)
    (own,) = [c for c in coefficient_table(result) if c.term == "energy[a]"]
    assert own.t**2 == pytest.approx(result.anova.row("energy").f)  # nor a coefficient's error
    assert not result.power  # nor does a plan promise that they would


@pytest.mark.parametrize("block", ["noise_seed", None])
@pytest.mark.parametrize("resamples", [25, 400])
def test_a_named_difference_has_the_interval_of_the_effect(block, resamples):
    """It took the refits for specimens once, and was narrower by the root of their number."""
    result = resampled(np.random.default_rng(5), resamples, effect=2.0, block=block)
    (one,) = study.contrasts(result, "energy=b - energy=a")
    effect = next(e for e in result.effects if e.term == "energy")
    assert one.ci == pytest.approx(effect.ci95, rel=1e-9)
    assert (one.verdict, one.why) == ("cannot tell", "one specimen: another may differ")
    assert (effect.verdict, effect.why) == (one.verdict, one.why)


def test_sums_of_many_values_are_drawn_from_their_moments(monkeypatch):
    """As resampling finds them: 2,000 draws of 100,000 rows took two minutes for a table."""
    rng = np.random.default_rng(3)
    n, draws = 1500, range(6)
    value = rng.gamma(4.0, size=3 * n) / n
    value[n : 2 * n] *= -1
    value[2 * n :] = 0.0  # a cell outside the contrast
    groups = list(np.arange(3 * n).reshape(3, n))
    quick = np.array([gate._bootstrap_t(value, groups, 0.05, 6, seed) for seed in draws])
    monkeypatch.setattr(gate, "_MANY", 10**9)
    whole = np.array([gate._bootstrap_t(value, groups, 0.05, 6, seed) for seed in draws])
    error = np.sqrt(sum(value[group].var() * n for group in groups))
    off = (quick.mean(axis=0) - whole.mean(axis=0)) / error
    # standard errors of quantiles of 6 times 2,000 draws: .03 of the two ends, .07 of the last
    assert np.abs(off[:2]).max() < 0.12
    assert abs(off[2]) < 0.28
