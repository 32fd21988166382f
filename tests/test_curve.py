"""Interpolation of curves: exact where it should be, and honest about the rest."""

import numpy as np
import pytest

from study.ground.curve import Curve


def sampled(n, power, *, work=True):
    """F = d^power on n steps from the unloaded state, with its slope and work."""
    d = np.linspace(0.0, 2.0, n + 1)[1:]
    done = d ** (power + 1) / (power + 1) if work else None
    return Curve(d, d**power, power * d ** (power - 1), work_Nmm=done)


def test_a_quartic_is_exact_where_the_work_is_known():
    d = np.linspace(0.5, 2.0, 50)
    np.testing.assert_allclose(sampled(4, 4).force_at(d), d**4, atol=1e-12)
    assert np.abs(sampled(4, 4, work=False).force_at(d) - d**4).max() > 1e-3


def test_the_slope_at_the_origin_follows_from_the_work():
    """A cubic has the slope 0 there, a parabola through its first point has not."""
    d = np.linspace(0.0, 0.5, 20)
    np.testing.assert_allclose(sampled(4, 3).force_at(d), d**3, atol=1e-12)


def test_the_error_is_estimated_from_the_work():
    """That of the cubic, which is larger than that of the quartic; none of a cubic itself."""
    curve, d = sampled(5, 6), np.linspace(0.0, 2.0, 400)
    off = np.sqrt(np.mean((curve.force_at(d) - d**6) ** 2)) / np.sqrt(np.mean(d**12))
    assert 0 < off < curve.relative_interpolation_error() < 0.02
    # of the first interval nothing is left over to judge its cubic by: it counts as a parabola
    np.testing.assert_allclose(sampled(5, 3).interpolation_error_N()[1:], 0.0, atol=1e-12)
    assert 0 < sampled(5, 3).relative_interpolation_error() < 1e-3
    assert sampled(5, 3, work=False).relative_interpolation_error() == 0.0


def test_intervals_that_bend_are_named_worst_first():
    curve = sampled(5, 6)
    assert curve.coarse_intervals(1.0) == []
    assert curve.coarse_intervals(1e-3)[0] == pytest.approx(1.8)
    assert len(curve.coarse_intervals(1e-6)) > len(curve.coarse_intervals(1e-3))


def test_every_other_point_keeps_the_last():
    for n in (2, 5, 6):
        curve = sampled(n, 2)
        half = curve.every_other_point()
        assert half.displacement_mm[-1] == curve.displacement_mm[-1]
        assert len(half) == (n + 1) // 2


def test_a_curve_survives_its_plain_form():
    curve = sampled(3, 3)
    again = Curve.from_dict(curve.as_dict())
    assert again.as_dict() == curve.as_dict()
    assert curve.without_gradients().work_Nmm is curve.work_Nmm
