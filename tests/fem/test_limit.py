"""A run that ends at a limit point says so: the specimen gives way, not the iteration."""

from __future__ import annotations

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Cone, Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.load_path import gives_way, smallest_stiffness
from study.mechanics.solver.newton import Options
from study.mechanics.solver.system import System
from tests.fem.problems import GEL, compression

#: softens without losing its ellipticity
VARGA = Material("ogden", {"mu1": 1e-2, "alpha1": 1.0}, bulk_modulus=10.0)


def needle(material: Material, depth: float) -> Problem:
    test = Test("indentation", depth, "frictionless", "bonded", steps=6, indenter=Cone(30.0, 1.0))
    return Problem(
        Cylinder(25.0, 50.0), test, material, Model("axisymmetric", "quadratic", mesh="coarse")
    )


def test_the_smallest_stiffness_is_an_eigenvalue() -> None:
    """Of the displacements' block, with the pressures as they follow."""
    problem = compression(Cylinder(25, 30), 3.0, material=GEL, mesh="coarse")
    system = System.build(problem, build_mesh(problem.setup))
    state = system.start()
    found = smallest_stiffness(system, state)
    system.assemble(state)
    n, free = system.space.n, system.pattern.free
    K = np.column_stack([system.tangent_product(row)[free] for row in np.eye(n)[free]])
    u = free < system.space.n_displacement
    own = K[np.ix_(u, u)] - K[np.ix_(u, ~u)] @ np.linalg.solve(K[np.ix_(~u, ~u)], K[np.ix_(~u, u)])
    exact = float(np.linalg.eigvalsh(own).min())
    assert exact <= found * (1 + 1e-9)
    assert found == pytest.approx(exact, rel=0.1)


def test_a_needle_in_a_softening_body_stops_at_a_limit_point() -> None:
    """At 2.79, 2.86 and 2.89 mm on the coarse, medium and fine mesh."""
    solution = solve(needle(VARGA, 5.0), gradients=False, options=Options(snaps=False))
    assert solution.status == "not-converged"
    assert 2.6 < solution.reached_mm < 3.0
    assert "(a limit point)" in solution.message
    assert "press less deep" in solution.message


def test_a_body_that_stiffens_does_not_give_way() -> None:
    solution = solve(needle(GEL, 3.0), gradients=False)
    assert solution.converged
    assert solution.warm is not None
    steps = [step.state for step in solution.warm.steps]
    assert all(gives_way(solution.warm.system, steps[0], later) == "" for later in steps)
