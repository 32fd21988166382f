"""Solves by an older factorization: right to the tolerance, cheaper by counts, repeatable."""

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.element.function_space import Pattern
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver import newton
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.linear_solver import (
    KeptFactors,
    SingularMatrixError,
    SuperLU,
    fgmres,
    make_solver,
    pardiso_available,
)
from study.mechanics.solver.newton import Options
from study.mechanics.solver.system import System
from tests.fem.problems import GEL, compression

NOWHERE = np.zeros(0, bool)
SOLVERS = ["superlu", *(["pardiso"] if pardiso_available() else [])]


def solid(size=8.0, **test):
    return compression(
        Cylinder(25, 50), 3.0, material=GEL, space="3d", element_order="quadratic",
        mesh_size_mm=size, **test,
    )  # fmt: skip


def dense(pattern, data):
    n = pattern.free.size
    upper = np.zeros((n, n))
    rows = np.repeat(np.arange(n), np.diff(pattern.indptr))
    upper[rows, pattern.indices] = data
    return upper + np.triu(upper, 1).T


@pytest.fixture(scope="module")
def system():
    problem = solid(16.0)
    found = System.build(problem, build_mesh(problem.setup))
    found.assemble(found.start())
    return found


def factorized(system, worth, closed=NOWHERE, name="superlu"):
    """Factors of the system's tangent, worth so many back-substitutions."""
    solver = make_solver(system.pattern, name)
    kept = KeptFactors(solver, system.pattern)
    solver.factorize(system.data)
    kept.renewed(closed)
    solver.worth = lambda: worth
    return solver, kept


def test_a_singular_matrix_is_told():
    """Two nodes on a spring that nobody holds: their common motion costs nothing."""
    index, upper = np.arange(2), np.array([0, 1, 1], np.int32)
    rows = np.array([0, 2, 3], np.int32)
    pattern = Pattern(index, index.astype(np.int32), rows, upper, np.zeros((1, 3), np.int32))
    solver = SuperLU(pattern)
    with pytest.raises(SingularMatrixError):
        solver.factorize(np.array([1.0, -1.0, 1.0]))
    solver.factorize(np.array([1.0, -1.0, 2.0]))  # one of them held by a second spring
    assert solver.solve(np.array([0.0, 1.0])) == pytest.approx([1.0, 1.0])


def test_gmres_needs_one_iteration_for_each_distinct_eigenvalue():
    """Exact in as many steps as the preconditioned matrix has eigenvalues (Saad 2003, 6.11)."""
    diagonal = np.repeat([1.0, 2.0, 5.0, 3.0], 25)
    b = np.random.default_rng(2).normal(size=100)
    x, count, left = fgmres(lambda v: diagonal * v, lambda v: v, b, 1e-10, 99)
    assert count == 4
    assert left < 1e-10
    np.testing.assert_allclose(x, b / diagonal, rtol=1e-11)


@pytest.mark.parametrize("name", SOLVERS)
def test_an_older_factorization_solves_the_newer_matrix(system, name):
    _, kept = factorized(system, 30.0, name=name)
    n, rng = system.dofs, np.random.default_rng(3)
    right, scale = rng.normal(size=n), np.ones(n)
    newer = system.data * (1 + 0.02 * rng.normal(size=system.data.size))
    x = kept.solve(newer, right, scale, 1e-6, NOWHERE, 0.01)
    left = right - dense(system.pattern, newer) @ x
    assert np.linalg.norm(left) <= 1.01e-6 * np.linalg.norm(right)
    kept.forget()
    assert kept.solve(newer, right, scale, 1e-6, NOWHERE, 0.01) is None


def test_the_curve_does_not_depend_on_reuse(monkeypatch):
    """Same equilibrium, to the tolerance of Newton, with half of the factorizations."""
    problem = solid(8.0, steps=4)
    whole, made, curves = System.factorize, [], []

    def counted(self):
        made[-1] += 1
        whole(self)

    monkeypatch.setattr(System, "factorize", counted)
    for steady in (newton._STEADY, 0.0):
        monkeypatch.setattr(newton, "_STEADY", steady)
        made.append(0)
        curves.append(solve(problem, options=Options(linear_solver="superlu")).curve)
    np.testing.assert_allclose(curves[0].force_N, curves[1].force_N, rtol=1e-8)
    np.testing.assert_allclose(
        curves[0].stiffness_N_per_mm, curves[1].stiffness_N_per_mm, rtol=1e-7
    )
    assert made[0] < 0.75 * made[1]


def test_a_warm_run_does_not_depend_on_what_ran_before():
    """Bit for bit: a resumed study has other runs behind it than an uninterrupted one."""
    problem = solid(8.0, steps=2)
    base = solve(problem)
    near = replace(problem, material=problem.material.with_constants([5.05e-3]))
    far = replace(problem, material=problem.material.with_constants([8e-3]))
    first = solve(near, warm=base).curve.force_N
    solve(far, warm=base)
    np.testing.assert_array_equal(solve(near, warm=base).curve.force_N, first)
