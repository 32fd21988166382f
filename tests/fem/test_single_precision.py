"""Factors in single precision: the same answers, and double precision where they cannot do it."""

import numpy as np
import pytest

from study.mechanics.element.function_space import symmetric_product
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Cone, Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test as Loading
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.linear_solver import KeptFactors, make_solver, pardiso_available
from study.mechanics.solver.system import System
from tests.fem.problems import GEL, LONG

pytestmark = pytest.mark.skipif(not pardiso_available(), reason="pypardiso is not installed")

NEEDLE = Loading("indentation", 1.5, "frictionless", "bonded", steps=3, indenter=Cone(30.0, 1.0))
PRESS = Loading("compression", 5.0, "bonded", "bonded", steps=2)
RUBBER = Material("mooney-rivlin", {"C10": 3e-3, "C01": 2e-3}, incompressible=True)
OGDEN = Material("ogden", {"mu1": 1e-2, "alpha1": 5.0}, bulk_modulus=10.0)
NOWHERE = np.zeros(0, bool)


def use(monkeypatch, *, single):
    """Have systems of every size in single precision, or none."""
    import study.mechanics.solver.linear_solver as module

    limit = 0 if single else 10**9
    monkeypatch.setattr(module, "_SINGLE", {True: limit, False: limit})


def problem(loading, space, material):
    model = Model(space, "quadratic", mesh="coarse")
    return Problem(Cylinder(25.0, 50.0), loading, material, model)


@pytest.mark.parametrize(
    ("loading", "space", "material"),
    [
        (NEEDLE, "axisymmetric", GEL),
        (NEEDLE, "axisymmetric", OGDEN),
        (NEEDLE, "axisymmetric", RUBBER),
        pytest.param(NEEDLE, "3d", GEL, marks=LONG),
        (PRESS, "axisymmetric", RUBBER),
        (PRESS, "3d", RUBBER),
        pytest.param(PRESS, "3d", OGDEN, marks=LONG),
    ],
)
def test_forces_and_their_derivatives_are_those_of_double_precision(
    loading, space, material, monkeypatch
):
    found = []
    for single in (True, False):
        use(monkeypatch, single=single)
        solution = solve(problem(loading, space, material))
        assert solution.status == "converged", solution.message
        found.append(solution)
    one, two = (solution.curve for solution in found)
    # both end where the residual is 1e-8 of the reaction, somewhere else each
    np.testing.assert_allclose(one.force_N, two.force_N, rtol=2e-8)
    np.testing.assert_allclose(one.stiffness_N_per_mm, two.stiffness_N_per_mm, rtol=1e-5)
    for name, slope in two.force_gradient.items():
        scale = np.abs(slope).max()
        np.testing.assert_allclose(one.force_gradient[name], slope, rtol=0, atol=1e-6 * scale)


@pytest.fixture(scope="module")
def tangent():
    """Pattern and entries of a small solid's tangent."""
    asked = problem(PRESS, "3d", GEL)
    system = System.build(asked, build_mesh(asked.setup))
    system.assemble(system.start())
    return system.pattern, system.data


def factorized(pattern, data, monkeypatch):
    """Solver and factors in single precision, which it may correct, and a load."""
    use(monkeypatch, single=True)
    solver = make_solver(pattern, "pardiso", corrected=True)
    kept = KeptFactors(solver, pattern)
    solver.factorize(data)
    kept.renewed(NOWHERE)
    assert not solver.exact
    return solver, kept, np.random.default_rng(3).normal(size=pattern.free.size)


def residual(pattern, data, x, b):
    left = b - symmetric_product(pattern.indptr, pattern.indices, data, x)
    return float(np.linalg.norm(left) / np.linalg.norm(b))


def test_single_precision_is_corrected_to_what_is_asked_for(tangent, monkeypatch):
    pattern, data = tangent
    solver, kept, b = factorized(pattern, data, monkeypatch)
    assert residual(pattern, data, solver.solve(b), b) > 1e-7
    for tolerance in (1e-3, 1e-6, 1e-10):
        x = kept.solve_afresh(data, b, np.ones(b.size), tolerance)
        assert residual(pattern, data, x, b) <= tolerance
    assert not solver.exact
    solver.close()


def test_what_single_precision_cannot_do_is_done_in_double(tangent, monkeypatch):
    """Pairs [[1, 1], [1, 1 + d]] whose d of some 1e-7 is gone in seven digits."""
    pattern, _ = tangent
    rng, size = np.random.default_rng(4), pattern.free.size
    data, row = np.zeros(pattern.indices.size), 0
    while row < size:
        k = pattern.indptr[row]
        data[k] = 1.0
        if k + 1 < pattern.indptr[row + 1] and pattern.indices[k + 1] == row + 1:
            data[k + 1] = 1.0
            data[pattern.indptr[row + 1]] = 1.0 + rng.uniform(1e-7, 1e-6)
            row += 1
        row += 1
    solver, kept, b = factorized(pattern, data, monkeypatch)
    x = kept.solve_afresh(data, b, np.ones(size), 1e-10)
    assert residual(pattern, data, x, b) < 1e-7  # 1e-16 over d
    assert solver.exact
    kept.forget()  # the next run begins as if there had been none
    assert not solver.exact
    solver.close()
