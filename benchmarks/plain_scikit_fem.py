"""The same problem as a user of scikit-fem would write it: weak forms, scipy matrices.

Neo-Hookean, mixed P2/P1, bonded compression in one step. It shares the mesh, the element,
the tolerance and, where installed, the linear solver with `study`; only the assembly and
the handling of the matrix differ.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy.sparse as sp
from skfem import (
    Basis,
    BilinearForm,
    ElementTetP1,
    ElementTetP2,
    ElementVector,
    LinearForm,
    MeshTet,
)
from skfem.helpers import grad

from study.forward.mesh import Mesh

IDENTITY = np.eye(3)[:, :, None, None]


def stress_and_tangent(F: Any, p: Any, c10: float) -> tuple[Any, Any, Any, Any]:
    """Nominal stress, tangent, J and cofactor at all quadrature points."""
    J = np.linalg.det(F.transpose(2, 3, 0, 1))
    G = np.linalg.inv(F.transpose(2, 3, 0, 1)).transpose(3, 2, 0, 1)
    i1, s = np.einsum("ij...,ij...->...", F, F), J ** (-2 / 3)
    D = s * (2 * F - 2 / 3 * i1 * G)
    GG = np.einsum("ij...,kl...->ijkl...", G, G)
    GX = np.einsum("il...,kj...->ijkl...", G, G)
    unit = np.einsum("ik,jl->ijkl", np.eye(3), np.eye(3))[..., None, None]
    FG = np.einsum("ij...,kl...->ijkl...", F, G)
    GF = np.einsum("ij...,kl...->ijkl...", G, F)
    A = c10 * s * (2 * unit - 4 / 3 * (FG + GF) + i1 * (4 / 9 * GG + 2 / 3 * GX))
    return c10 * D + p * J * G, A + p * J * (GG - GX), J, J * G


def solve(mesh: Mesh, displacement_mm: float, c10: float, bulk: float) -> tuple[float, int]:
    """Force (N) of the quarter model's whole specimen and the number of Newton iterations."""
    fem = MeshTet(np.ascontiguousarray(mesh.points.T), np.ascontiguousarray(mesh.cells.T))
    ub = Basis(fem, ElementVector(ElementTetP2()), intorder=2)
    pb = ub.with_element(ElementTetP1())
    n_u, n = ub.N, ub.N + pb.N
    fixed, value, top = boundary(ub, mesh, displacement_mm)
    x, free = np.zeros(n), np.setdiff1d(np.arange(n), fixed)
    for iteration in range(25):
        K, R = assemble(ub, pb, x[:n_u], x[n_u:], c10, bulk)
        right = -R[free]
        if iteration == 0:
            right -= K[free][:, fixed] @ value
        elif np.linalg.norm(R[free]) < 1e-8 * np.linalg.norm(R[fixed]):
            break
        x[free] += linear_solve(K[free][:, free], right)
        if iteration == 0:
            x[fixed] = value
    sector = 4.0
    return -sector * float(R[top].sum()), iteration


def assemble(ub: Any, pb: Any, u: Any, p: Any, c10: float, bulk: float) -> tuple[Any, Any]:
    """Tangent and residual by scikit-fem forms."""
    F = np.asarray(grad(ub.interpolate(u))) + IDENTITY
    pressure = np.asarray(pb.interpolate(p))
    P, A, J, cofactor = stress_and_tangent(F, pressure, c10)

    @BilinearForm
    def kuu(u: Any, v: Any, _: Any) -> Any:
        return np.einsum("ijkl...,ij...,kl...->...", A, grad(v), grad(u))

    @BilinearForm
    def kup(q: Any, v: Any, _: Any) -> Any:
        return np.einsum("ij...,ij...->...", cofactor, grad(v)) * q

    @BilinearForm
    def kpp(p: Any, q: Any, _: Any) -> Any:
        return -p * q / bulk

    @LinearForm
    def ru(v: Any, _: Any) -> Any:
        return np.einsum("ij...,ij...->...", P, grad(v))

    @LinearForm
    def rp(q: Any, _: Any) -> Any:
        return (J - 1 - pressure / bulk) * q

    coupling = kup.assemble(pb, ub)
    K = sp.bmat([[kuu.assemble(ub), coupling], [coupling.T, kpp.assemble(pb)]], format="csr")
    return K, np.concatenate([ru.assemble(ub), rp.assemble(pb)])


def boundary(ub: Any, mesh: Mesh, displacement_mm: float) -> tuple[Any, Any, Any]:
    """Find the fixed unknowns, their values, and the axial unknowns under the plate."""
    height, low = mesh.points[:, 2].max(), mesh.points[:, 2].min()
    top = ub.get_dofs(lambda x: np.abs(x[2] - height) < 1e-9)
    base = ub.get_dofs(lambda x: np.abs(x[2] - low) < 1e-9)
    value = np.zeros(ub.N)
    axial = top.all(["u^3"])
    value[axial] = -displacement_mm / 2
    fixed = [top.all(), base.all(["u^3"])]
    for axis, name in enumerate(("u^1", "u^2")):
        fixed.append(ub.get_dofs(lambda x, axis=axis: np.abs(x[axis]) < 1e-9).all([name]))
    dofs = np.unique(np.concatenate(fixed))
    return dofs, value[dofs], axial


def linear_solve(K: Any, right: Any) -> Any:
    """PARDISO on the upper triangle where installed, SciPy elsewhere."""
    try:
        import pypardiso
    except ImportError:
        from scipy.sparse.linalg import spsolve

        return spsolve(K.tocsc(), right)
    solver = pypardiso.PyPardisoSolver(mtype=-2)
    solution = solver.solve(sp.triu(K, format="csr"), right)
    solver.free_memory(everything=True)
    return solution
