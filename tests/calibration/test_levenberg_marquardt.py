"""Ends, bounds, failures, scaling (P21) and resuming of the optimizer."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.ground.errors import InputError
from study.mechanics.calibration.levenberg_marquardt import (
    Linearization,
    Status,
    damped_step,
    levenberg_marquardt,
)
from study.mechanics.calibration.residual_function import EvaluationFailed

T = np.linspace(0.1, 3, 25)
TRUE = np.array([2.0, 1.3])
NOISE = 0.01 * np.sin(17 * T)


def decay(x):
    model = x[0] * np.exp(-x[1] * T)
    jacobian = np.array([np.exp(-x[1] * T), -x[0] * T * np.exp(-x[1] * T)]).T
    return model - (TRUE[0] * np.exp(-TRUE[1] * T) + NOISE), jacobian


BEST = levenberg_marquardt(decay, [1.0, 1.0])


def test_damped_step_solves_the_augmented_problem():
    rng = np.random.default_rng(2011)
    jacobian, residual = rng.normal(size=(12, 3)), rng.normal(size=12)
    scale = np.array([1.0, 30.0, 0.1])
    linear = Linearization.of(jacobian, residual, scale)
    for radius in (1e-3, 0.1, 1e3):
        step, damping = damped_step(linear, radius)
        augmented = np.vstack([jacobian, np.sqrt(damping) * np.diag(scale)])
        target = np.r_[-residual, np.zeros(3)]
        expected = np.linalg.lstsq(augmented, target, rcond=None)[0]
        assert step == pytest.approx(expected, rel=1e-9)
        length = np.linalg.norm(scale * step)
        # on the edge of the region to 10 %, or the full step inside it
        assert length == pytest.approx(radius, rel=0.1) or (damping == 0 and length < radius)


@given(st.floats(1e-6, 1e6), st.floats(1e-6, 1e6), st.floats(1e-4, 1e4))
def test_units_do_not_matter(first, second, factor):
    """P21: scaling parameters or data leaves the physical optimum where it was."""
    units = np.array([first, second])

    def scaled(x):
        residual, jacobian = decay(x * units)
        return factor * residual, factor * jacobian * units

    result = levenberg_marquardt(scaled, np.array([1.0, 1.0]) / units)
    assert result.converged
    assert result.x * units == pytest.approx(BEST.x, rel=1e-8)


@pytest.mark.parametrize("raises", [True, False])
def test_failed_evaluations_are_rejected_steps(raises):
    """A residual that is not a number is a failure, too."""
    calls = {"failed": 0}

    def fragile(x):
        residual, jacobian = decay(x)
        if x[1] > 1.4:  # the first step from (1, 1) would go to 1.46
            calls["failed"] += 1
            if raises:
                raise EvaluationFailed("too soft")
            residual = residual * np.nan
        return residual, jacobian

    result = levenberg_marquardt(fragile, [1.0, 1.0])
    assert result.converged
    assert result.x == pytest.approx(BEST.x, rel=1e-8)
    assert calls["failed"] > 0


def test_named_ends():
    def never(x):
        raise EvaluationFailed

    assert levenberg_marquardt(never, [1.0]).status is Status.start_failed
    assert (
        levenberg_marquardt(decay, [9.0, 0.1], max_evaluations=3).status is Status.max_evaluations
    )
    stopped = levenberg_marquardt(decay, [9.0, 0.1], callback=lambda it: it.iteration == 1)
    assert stopped.status is Status.stopped
    assert len(stopped.history) == 2

    def only_start(x):
        if not np.array_equal(x, [1.0, 1.0]):
            raise EvaluationFailed
        return decay(x)

    surrounded = levenberg_marquardt(only_start, [1.0, 1.0])
    assert surrounded.status is Status.too_many_failures
    assert surrounded.x.tolist() == [1.0, 1.0]
    assert all(status.sentence and not status.sentence.endswith(".") for status in Status)


MAGNITUDES = [0.0, -0.0, 5e-324, 1e-300, 1e-160, 1e-12, 1.0, -3.0, 1e12, 1e100, 1e200, -1e300]
PLANE = np.array([[1.0, 2.0], [3.0, -1.0], [0.5, 1.0]])


def plane(x):
    return PLANE @ x - np.array([1.0, 2.0, 3.0]), PLANE


def nothing(x):
    return np.ones(3), np.zeros((3, 2))


@given(
    st.sampled_from([plane, decay, nothing]),
    st.lists(st.sampled_from(MAGNITUDES) | st.floats(allow_nan=False, allow_infinity=False),
             min_size=2, max_size=2),
    st.sampled_from(["answers", "beyond", "after the first", "everywhere"]),
    st.sampled_from([0.0, 1e-3]),
)  # fmt: skip
def test_any_start_ends_with_an_honest_status(function, start, fails, edge):
    """No start raises: with zeros in it, huge or tiny, whether the model answers later or not."""
    calls = {"all": 0}

    def model(x):
        calls["all"] += 1
        edge_of_answers = fails == "beyond" and abs(x[0]) > 0.7 * max(abs(start[0]), 1.0)
        if fails == "everywhere" or edge_of_answers or (
            fails == "after the first" and calls["all"] > 1
        ):  # fmt: skip
            raise EvaluationFailed
        return function(x)

    found = levenberg_marquardt(model, start, edge=edge)
    assert found.evaluations == calls["all"]
    if fails == "everywhere":
        assert found.status is Status.start_failed
    if found.status is Status.start_failed:
        return
    assert np.all(np.isfinite(found.x))
    if function is nothing:
        assert found.status is Status.no_influence
    if function is plane and fails == "after the first" and not found.converged:
        # 17 tenfold shorter steps are left of the first one when rounding swallows it
        assert found.status is Status.too_many_failures
        assert calls["all"] <= 20
    if function is plane and fails == "answers":
        assert found.converged
        influence = np.linalg.norm(PLANE, axis=0) @ np.abs(found.x)
        slope = PLANE.T @ found.residual
        assert np.abs(slope).max() <= 1e-7 * (influence + np.linalg.norm(found.residual))


def test_the_first_step_from_zero_has_no_unit():
    results = []
    for unit in (1e-9, 1.0, 1e9):
        found = levenberg_marquardt(
            lambda x, unit=unit: (unit * decay(x)[0], unit * decay(x)[1]), [0.0, 0.0]
        )
        assert found.converged
        results.append(found.evaluations)
    assert len(set(results)) == 1


def test_exact_data_ends_with_zero_residual():
    result = levenberg_marquardt(lambda x: (x - 3.0, np.eye(2)), [1.0, 1.0])
    assert result.status is Status.converged_zero
    assert result.x.tolist() == [3.0, 3.0]


@pytest.mark.parametrize(
    ("bounds", "held"),
    [([(0, 1.5), (0, 9)], [True, False]), ([(0, 9), (1.6, 9)], [False, True]),
     ([(0, 9), (0, 9)], [False, False]), ([(0, 1.5), (1.6, 9)], [True, True])],
)  # fmt: skip
def test_bounds(bounds, held):
    result = levenberg_marquardt(decay, [1.0, 2.0], bounds=bounds)
    assert result.converged
    assert result.at_bound.tolist() == held
    low, high = np.array(bounds).T
    assert np.all((result.x >= low) & (result.x <= high))
    from scipy.optimize import least_squares

    other = least_squares(
        lambda x: decay(x)[0], [1.0, 2.0], jac=lambda x: decay(x)[1], bounds=(low, high),
        xtol=1e-15, ftol=1e-15, gtol=1e-15,
    )  # fmt: skip
    # the peer keeps a barrier's distance from a bound, so only its cost is compared closely
    assert result.cost <= other.cost * (1 + 1e-9)
    assert result.x == pytest.approx(other.x, rel=1e-4)


@pytest.mark.parametrize(
    ("first", "low", "rule"),
    [(1, 2, "outside its bounds"), (1, 4, "low < high"), (np.nan, 0, "fin")],
)
def test_bad_starts_and_bounds(first, low, rule):
    with pytest.raises(InputError, match=rule):
        levenberg_marquardt(decay, [first, 2.0], bounds=[(low, 3), (0, 9)])


def test_the_scatter_of_a_simulation_is_no_failure():
    """A simulation repeats to 1e-8 of its residual: 4 of these 40 fits failed at their minimum."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        slopes = rng.standard_normal((60, 2)) * [1.0, 0.3] + [2.0, 0.5]
        misfit = 0.02 * rng.standard_normal(60)

        def simulated(x, slopes=slopes, misfit=misfit):
            scatter = np.random.default_rng(int(abs(x[0]) * 1e15) % 2**32).standard_normal(60)
            force = np.exp(0.3 * slopes @ x)
            return force - 1.5 - misfit + 1e-8 * scatter, 0.3 * slopes * force[:, None]

        found = levenberg_marquardt(
            simulated, [0.5, 0.2], ftol=1e-9, xtol=1e-9, gtol=1e-6, edge=1e-3
        )
        assert found.converged, found.message


@pytest.mark.parametrize("bend", [0.6, 0.9])
def test_a_large_residual_that_bends_costs_few_evaluations(bend):
    # x = u + v is least at 0 for every bend below 1, and each Gauss-Newton step leaves the share
    # ``bend`` of the way (Dennis and Schnabel 1983, example 10.2.4): 15 and 41 evaluations
    def function(values):
        u, v = values
        x = u + v
        residual = np.array([x + 1, bend * x**2 + x - 1, u - 2 * v - 3])
        return residual, np.array([[1, 1], [2 * bend * x + 1, 2 * bend * x + 1], [1, -2]])

    search = levenberg_marquardt(function, [1.3, -0.9], gtol=1e-4, edge=1e-3)
    assert search.converged
    assert search.x == pytest.approx([1.0, -1.0], abs=1e-3)
    assert search.evaluations <= 9
