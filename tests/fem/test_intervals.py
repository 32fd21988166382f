"""Do the intervals of mesh convergence hold the truth? On problems whose answer is known.

The bar: of the finest three meshes' intervals at least 95 % hold the truth, at most 10 % are
refused, and the median of half-width over true error is at most 10.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

from study.mechanics.setup.setup import Model
from study.statistics.convergence.grid_convergence import ConvergenceResult, grid_convergence
from tests.fem.answers import Known, every_problem, punch, thick_walls

MODELS = (
    Model("axisymmetric", "quadratic", "simplex"),
    Model("axisymmetric", "linear", "simplex"),
)


@dataclass(frozen=True)
class Outcome:
    problem: Known
    found: ConvergenceResult
    error: float

    @property
    def refused(self) -> bool:
        return self.found.u_num is None

    @property
    def holds(self) -> bool:
        u = self.found.u_num
        return u is not None and self.error <= u + self.problem.digits * abs(self.problem.truth)

    @property
    def ratio(self) -> float:
        return float(self.found.u_num or np.nan) / max(self.error, 1e-300)


def judged(problem: Known) -> Outcome:
    values = [problem.value(n) for n in problem.fineness]
    sizes = [1 / n for n in problem.fineness]
    found = grid_convergence(sizes, values, formal_order=problem.formal)
    return Outcome(problem, found, abs(found.value[0] - problem.truth))


def summary(outcomes: list[Outcome]) -> tuple[float, float, float]:
    """Share that holds the truth, share refused, median of half-width over error."""
    given = [o for o in outcomes if not o.refused]
    holding = sum(o.holds for o in given) / len(given)
    return holding, 1 - len(given) / len(outcomes), float(np.median([o.ratio for o in given]))


@pytest.mark.slow
@pytest.mark.verify
def test_intervals_hold_the_truth() -> None:
    outcomes = [judged(problem) for problem in every_problem(MODELS)]
    for group in dict.fromkeys(o.problem.group for o in outcomes):
        for model in MODELS:
            part = [
                o for o in outcomes
                if (o.problem.group, o.problem.model.element_order) == (group, model.element_order)
            ]  # fmt: skip
            print(report(f"{group} {model.element_order}", part))
    print(report("all", outcomes))
    assert len(outcomes) == 2 * (15 + 15 + 12 + 18)
    holding, refused, ratio = summary(outcomes)
    assert holding >= 0.95
    assert refused <= 0.10
    assert ratio <= 10


def report(what: str, outcomes: list[Outcome]) -> str:
    holding, refused, ratio = summary(outcomes)
    return (
        f"{what}: {len(outcomes)} intervals, {100 * holding:.1f} % hold the truth, "
        f"{100 * refused:.1f} % refused, median half-width over true error {ratio:.2f}"
    )


def test_intervals_of_thick_walls() -> None:
    """The part of the table that takes a second: closed forms (V18, V19), both elements."""
    outcomes = [judged(p) for model in MODELS for p in thick_walls(model) if "=1.1" in p.name]
    assert len(outcomes) == 8
    assert all(o.holds for o in outcomes)
    # V18, V19: a mesh of 9 by 18, of 8 by 2
    assert max(o.error / abs(o.problem.truth) for o in outcomes) < 5e-3


@pytest.mark.parametrize("nu", [0.3, 0.5])
def test_the_force_of_a_flat_punch_is_of_first_order(nu: float) -> None:
    """The stress is singular as s^(-1/2) at the edge, whatever the element (Table D)."""
    meshes = (24, 36, 54)
    values = [punch(1.0, nu, MODELS[0], n) for n in meshes]
    found = grid_convergence([1 / n for n in meshes], values, formal_order=1.0)
    print(f"\npunch a/h=1 nu={nu}: order {found.observed_order:.3f}, {found.verdict}")
    assert found.observed_order == pytest.approx(1.0, abs=0.15)
    assert found.value[0] < found.value[1] < found.value[2]  # from above, as a stiff punch must
