"""Behaviour, order and refusal of refinement series."""

from __future__ import annotations

import json

import numpy as np
import pytest

from study.ground.errors import InputError
from study.statistics.convergence.grid_convergence import grid_convergence
from validation.bounds import FAMILIES, coverage


@pytest.mark.parametrize(
    ("sizes", "values", "behaviour"),
    [
        ([1, 2, 4], [0.97050, 0.96854, 0.96178], "monotone"),
        # R = 1.67 is above 1 and converges: h = 1, 2, 2.6 at order 1
        ([1, 2, 2.6], [2.0, 3.0, 3.6], "monotone"),
        ([1, 2, 4], [1.0, 1.3, 1.2], "divergent"),
        ([1, 2, 4], [3.0, 2.0, 1.0], "divergent"),
        ([1, 2, 4], [1.0, 1.0, 1.0], "noise-floor"),
        ([1, 2, 4], [1.0, 1.0, 1.2], "inconclusive"),
        ([1, 2, 4], [1.0, 1.2, 1.2], "inconclusive"),
    ],
)
def test_behaviour(sizes, values, behaviour: str) -> None:
    result = grid_convergence(sizes, values)
    assert result.behaviour == behaviour
    if behaviour != "monotone":
        assert result.gci_fine is None
        assert result.observed_order is None
    json.dumps(result.to_json(), allow_nan=False)


def test_noise_floor_reports_the_tolerance_or_thrice_the_range() -> None:
    result = grid_convergence([1, 2, 4], [1.0, 1.0 + 3e-9, 1.0 - 4e-9], tolerance=1e-9)
    assert result.behaviour == "noise-floor"
    assert result.u_num == pytest.approx(2.1e-8)
    assert grid_convergence([1, 2, 4], [1.0, 1.0, 1.0], tolerance=1e-9).u_num == 1e-9


def test_an_oscillation_is_bounded_by_its_range_and_says_so() -> None:
    """Thrice that of the finest three meshes, or half that of all, whichever is larger."""
    four = grid_convergence([1, 2, 4, 8], [1.0, 1.1, 0.9, 1.2])
    assert four.u_num == pytest.approx(3 * 0.2)
    assert "another mesh" in four.verdict
    five = grid_convergence([1, 1.5, 2, 3, 4], [2.0, 2.003, 1.999, 2.04, 2.3])
    assert five.u_num == pytest.approx(0.301 / 2)
    assert "0.15" in five.verdict


def test_two_meshes_with_an_order_have_the_index_of_roache() -> None:
    """Roache (1994): factor 3 on e / (r^p - 1)."""
    result = grid_convergence([0.5, 1.0], [8.0, 7.0], formal_order=1)
    assert (result.behaviour, result.factor_of_safety, result.order_used) == ("two meshes", 3, 1)
    assert (result.gci_fine, result.extrapolated) == pytest.approx((3 / 8, 9.0))
    assert result.observed_order is None
    assert "order assumed" in result.verdict


@pytest.mark.parametrize("p", [2.06, 2.6, 8.3])
def test_an_order_above_the_formal_one_widens_the_bound(p: float) -> None:
    """The change between the coarser meshes counts too, and the factor is that of no trust."""
    h = np.array([1.0, 2, 4])
    f = 5 + 0.01 * h**p
    result = grid_convergence(h, f, formal_order=2)
    error = max(f[1] - f[0], (f[2] - f[1]) / 4) / 3
    assert result.u_num >= 1.999 * error
    if p > 2.5:
        assert result.u_num == pytest.approx(max(3 * error, f[2] - f[0]))


def test_growing_changes_below_a_hundredth_of_the_value_are_noise() -> None:
    result = grid_convergence([1, 2, 4], [10.0, 10.015, 10.02], formal_order=2)
    assert (result.behaviour, result.u_num) == ("noise-floor", pytest.approx(0.06))
    assert "0.06" in result.verdict
    equal = grid_convergence([1, 2, 4, 8], [4.0, 3.0, 2.0, 1.0])
    assert "do not shrink" in equal.verdict
    assert equal.u_num == pytest.approx(6.0)


def test_the_bound_holds_the_error_of_random_series() -> None:
    """The simulation of ``validation/bounds.py``: 40 series of each of its families."""
    u, error = (np.concatenate(part) for part in zip(*(coverage(d, 40) for d in FAMILIES),
                                                     strict=True))  # fmt: skip
    assert np.isfinite(u).all()
    assert np.mean(error <= u) >= 0.95
    assert np.median(u / error) <= 8


@pytest.mark.parametrize(
    ("meshes", "p", "formal", "factor", "used", "verdict"),
    [
        (3, 2, 2, 1.25, 2, "in the asymptotic range"),
        (3, 1, 2, 3, 1, "far from the formal order"),
        (3, 4, 2, 3, 2, "indicative"),
        (3, 0.2, 2, 3, 0.5, "indicative"),
        (3, 7.09, None, 3, 1, "order limited"),
        (3, 1.5, None, 3, 1, "no formal order given: the order cannot be judged"),
        (4, 1.5, 2, 1.25, 1.5, "in the asymptotic range"),
        # triples that agree far from the formal order are not asymptotic
        (4, 1.2, 2, None, None, ""),
    ],
)
def test_factor_of_safety_and_limits(meshes, p, formal, factor, used, verdict) -> None:
    h = 2.0 ** np.arange(meshes)
    result = grid_convergence(h, 3 + 0.01 * h**p, formal_order=formal)
    if factor is not None:
        assert (result.factor_of_safety, result.order_used) == pytest.approx((factor, used))
    assert verdict in result.verdict
    # an order that is neither the observed nor the formal one is said
    assert (f"by order {used}" in result.verdict) == (used not in (None, p, formal))
    assert ("asymptotic" in result.verdict) == ("asymptotic" in verdict)


def test_four_meshes_need_agreeing_triples() -> None:
    h = np.array([1.0, 2, 4, 8])
    assert grid_convergence(h, 1 + 0.01 * h + 0.0005 * h**3).factor_of_safety == 3


def test_order_of_input_means_nothing() -> None:
    one = grid_convergence([1, 2, 4], [0.97050, 0.96854, 0.96178])
    two = grid_convergence([4, 1, 2], [0.96178, 0.97050, 0.96854])
    assert one == two


@pytest.mark.parametrize(
    ("sizes", "values", "match"),
    [
        ([1, 2], [1, 2], "at least three meshes"),
        ([1, 2, 2], [1, 2, 3], "must be distinct"),
        ([1, 2, -4], [1, 2, 3], "positive"),
        ([1, 2, 4], [1, 2], "3 sizes for 2 values"),
        ([1, 2, 4], [1, np.nan, 3], "finite numbers"),
    ],
)
def test_bad_input(sizes, values, match: str) -> None:
    with pytest.raises(InputError, match=match):
        grid_convergence(sizes, values)
