"""Moduli of curves: coverage of intervals, contact, limits, medians."""

import numpy as np
import pytest
from scipy.stats import binom

from study.mechanics.forward.contact_law import Layer, force_law, limits
from study.mechanics.indentation.indentation_modulus import fit_modulus, median_estimate
from study.mechanics.setup.geometry import Cone, Flat, Sphere
from tests.calibration.cylinder import autoregression

TRUTH_MPA = 0.02
LAYER = Layer(10.0, 0.5)
LAW = force_law(Sphere(5.0), LAYER, 1.2)


def curve(rng, n, correlation=0.0, contact=0.0):
    """Force by the law, 2 % of the last one as noise of a given correlation."""
    d = np.linspace(0.5 / n, 0.5 + contact, n)
    force = TRUTH_MPA / 0.75 * LAW.force(d - contact)
    return d, force + 0.02 * force[-1] * autoregression(correlation, rng, n)


def fitted(d, f, **options):
    asked = {"poisson_ratio": 0.5, "deepest_mm": 0.55, **options}
    return fit_modulus(d, f, LAW, **asked)


@pytest.mark.parametrize("find_contact", [False, True])
@pytest.mark.parametrize("correlation", [0.0, 0.5, 0.9])
def test_intervals_cover(correlation, find_contact):
    """95 % nominal, also of residuals of which ten in a row say the same; of 1000 0.95 to 0.97."""
    rng = np.random.default_rng(1)
    runs, hits = 400, 0
    for _ in range(runs):
        d, f = curve(rng, 60, correlation, 0.1 if find_contact else 0.0)
        found = fitted(d, f, find_contact=find_contact)
        hits += found.interval_MPa[0] <= TRUTH_MPA <= found.interval_MPa[1]
    assert 0.92 <= hits / runs <= 0.985


def test_rows_whose_contacts_go_round_end_with_the_fewest():
    """With 33 rows contact lies so early that one is too deep; with 32 it is not (one in ten)."""
    rounds = 0
    for seed in range(60):
        rng = np.random.default_rng(seed)
        d = np.linspace(0.0, 1.0, 40)
        force = LAW.force(d - 0.3) * (1 + 2 * rng.random() * d**2)
        force = force + 0.03 * force[-1] * rng.random() * rng.standard_normal(d.size)
        deepest = 0.1 + 0.4 * rng.random()
        found = fitted(d, force, find_contact=True, deepest_mm=deepest)
        if found.contact_mm is None:
            continue
        used = np.arange(d.size) < d.size - found.rows_outside
        within = d - found.contact_mm <= deepest
        # every row that was used lies within the limit of the contact that these rows give
        assert not (used & ~within).any()
        again = fitted(d[used], force[used], find_contact=True, deepest_mm=10.0)
        assert again.contact_mm == pytest.approx(found.contact_mm, abs=1e-12)
        rounds += int((within & ~used).any())
    assert rounds >= 3


def test_contact_is_found():
    """Without noise to 1e-4 mm, wherever it is; the modulus with it to 0.1 %."""
    for contact in (-0.05, 0.0, 0.2):
        d = np.linspace(0.0, 0.5, 80)
        found = fitted(d, TRUTH_MPA / 0.75 * LAW.force(d - contact), find_contact=True)
        assert found.contact_mm == pytest.approx(contact, abs=1e-4)
        assert found.modulus_MPa == pytest.approx(TRUTH_MPA, rel=1e-3)


def test_rows_beyond_the_limit_or_of_another_sign_tell_nothing():
    d = np.linspace(0.01, 1.0, 100)
    force = TRUTH_MPA / 0.75 * LAW.force(d)
    none = fitted(d, force, deepest_mm=0.03)
    assert (none.status, none.modulus_MPa) == ("outside", None)
    assert "3 of 100 rows" in none.message
    assert fitted(d, -force).status == "implausible"


def test_the_least_limit_comes_first():
    narrow, wide = (limits(Sphere(5.0), LAYER, LAW, area_mm2=a) for a in (np.pi * 64, np.pi * 3600))
    assert narrow[0].what.startswith("shortening of the whole specimen")
    assert wide[0].what == "d/R <= 0.1"
    assert wide[0].depth_mm == 0.5
    thin = Layer(2.0, 0.5)
    assert limits(Sphere(5.0), thin, LAW)[0].depth_mm == pytest.approx(0.2)
    shaft = Cone(45.0, shaft_radius_mm=1.0)
    law = force_law(shaft, Layer(np.inf, 0.5), 5.0)
    # a sharp cone of 45 degrees is touched up to a at the depth pi/2 a
    assert limits(shaft, Layer(np.inf, 0.5), law)[0].depth_mm == pytest.approx(np.pi / 2, rel=1e-6)
    flat = force_law(Flat(3.0), LAYER, 5.0)
    assert limits(Flat(3.0), LAYER, flat)[0].depth_mm == pytest.approx(0.45)


@pytest.mark.parametrize("n", [6, 7, 9, 20, 101, 1000])
def test_order_statistics_hold_the_median(n):
    """The least interval of order statistics whose binomial probability is 95 %."""
    found = median_estimate(np.arange(1.0, n + 1).tolist())
    low, high = (int(v) for v in found.interval_MPa)
    assert low + high == n + 1
    assert binom.cdf(high - 1, n, 0.5) - binom.cdf(low - 1, n, 0.5) >= 0.95
    assert binom.cdf(high - 2, n, 0.5) - binom.cdf(low, n, 0.5) < 0.95


def test_few_units():
    """Student's t of 1, 2, 3: 2 +- 4.3027 / sqrt(3)."""
    found = median_estimate([1.0, 2.0, 3.0])
    assert found.interval_MPa == pytest.approx((2 - 2.48414, 2 + 2.48414), abs=1e-5)
    assert median_estimate([1.0], (0.5, 1.5)).interval_MPa == (0.5, 1.5)
