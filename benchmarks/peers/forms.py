"""The same problem as a user of scikit-fem would write it: weak forms, scipy matrices.

Mixed P2/P1 in 3D and in axisymmetric space. It shares the mesh, the element, the tolerance
and, where installed, the linear solver with `study`; only the assembly and the handling of
the matrix differ.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np
import scipy.sparse as sp

from benchmarks.exchange import Answer, NoAnswerError, NotInstalledError, Task

try:
    import skfem
    from skfem.helpers import grad
except ImportError as error:
    raise NotInstalledError from error

MAX_ITERATIONS = 25


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


def strain(v: Any, r: Any | None) -> Any:
    """Displacement gradient, 3 x 3; with the hoop strain v_r / r where a radius is given."""
    if r is None:
        return grad(v)
    g, out = grad(v), np.zeros((3, 3, *np.broadcast_shapes(np.shape(v)[1:], r.shape)))
    out[:2, :2] = g
    out[2, 2] = np.asarray(v)[0] / r
    return out


class Forms:
    """Bases, boundary and the forms of one task."""

    def __init__(self, task: Task) -> None:
        points = np.ascontiguousarray(task.points.T), np.ascontiguousarray(task.cells.T)
        if task.axisymmetric:
            mesh, quadratic, linear = skfem.MeshTri, skfem.ElementTriP2, skfem.ElementTriP1
        else:
            mesh, quadratic, linear = skfem.MeshTet, skfem.ElementTetP2, skfem.ElementTetP1
        order = 4 if task.axisymmetric else 2
        element = skfem.ElementVector(quadratic())
        self.task, self.ub = task, skfem.Basis(mesh(*points), element, intorder=order)
        self.pb = self.ub.with_element(linear())
        self.radius = np.asarray(self.ub.global_coordinates())[0] if task.axisymmetric else None
        self.weight = 1.0 if self.radius is None else 2 * np.pi * self.radius
        self.held, self.rate, self.plate = boundary(self.ub, task)
        self.n_u = int(self.ub.N)
        self.n = self.n_u + int(self.pb.N)
        self.free = np.setdiff1d(np.arange(self.n), self.held)

    def assemble(self, x: Any) -> tuple[Any, Any]:
        """Tangent and residual by scikit-fem forms."""
        ub, pb, r, w, bulk = self.ub, self.pb, self.radius, self.weight, self.task.bulk
        identity = np.eye(3)[:, :, None, None]
        F = np.asarray(strain(ub.interpolate(x[: self.n_u]), r)) + identity
        pressure = np.asarray(pb.interpolate(x[self.n_u :]))
        P, A, J, cofactor = stress_and_tangent(F, pressure, self.task.c10)

        @skfem.BilinearForm
        def kuu(u: Any, v: Any, _: Any) -> Any:
            return w * np.einsum("ijkl...,ij...,kl...->...", A, strain(v, r), strain(u, r))

        @skfem.BilinearForm
        def kup(q: Any, v: Any, _: Any) -> Any:
            return w * np.einsum("ij...,ij...->...", cofactor, strain(v, r)) * q

        @skfem.BilinearForm
        def kpp(p: Any, q: Any, _: Any) -> Any:
            return -w * p * q / bulk

        @skfem.LinearForm
        def ru(v: Any, _: Any) -> Any:
            return w * np.einsum("ij...,ij...->...", P, strain(v, r))

        @skfem.LinearForm
        def rp(q: Any, _: Any) -> Any:
            return w * (J - 1 - pressure / bulk) * q

        coupling = kup.assemble(pb, ub)
        blocks = [[kuu.assemble(ub), coupling], [coupling.T, kpp.assemble(pb)]]
        return sp.bmat(blocks, format="csr"), np.concatenate([ru.assemble(ub), rp.assemble(pb)])

    def step(self, x: Any, number: int) -> tuple[int, Any]:
        """Move ``x`` to the end of a load step; return iterations and residual."""
        lift = (self.task.plate_mm(number) - self.task.plate_mm(number - 1)) * self.rate
        for iteration in range(MAX_ITERATIONS + 1):
            K, R = self.assemble(x)
            if iteration and self.unsolved(R) < self.task.tolerance:
                return iteration, R
            right = -R[self.free]
            if not iteration:
                right -= K[self.free][:, self.held] @ lift
                x[self.held] += lift
            x[self.free] += linear_solve(K[self.free][:, self.free], right)
        raise NoAnswerError(f"step {number}: no equilibrium after {MAX_ITERATIONS} iterations")

    def unsolved(self, R: Any) -> float:
        """Residual that all codes stop by."""
        left = R.copy()
        left[self.held] = 0.0
        parts = left[: self.n_u], R[self.held], left[self.n_u :]
        return self.task.unsolved(*(float(np.linalg.norm(part)) for part in parts))


def solve(task: Task) -> Answer:
    """Step by step."""
    forms, iterations, R = Forms(task), 0, np.zeros(0)
    x = np.zeros(forms.n)
    for number in range(1, task.steps + 1):
        spent, R = forms.step(x, number)
        iterations += spent
    force = -task.scale * float(R[forms.plate].sum())
    return Answer(force, iterations, int(forms.free.size), "PARDISO" if pardiso() else "SuperLU")


def boundary(ub: Any, task: Task) -> tuple[Any, Any, Any]:
    """Find the fixed unknowns, how fast they move, and the axial ones under the plate."""
    dim = task.points.shape[1]
    names = [f"u^{axis + 1}" for axis in range(dim)]

    def plane(axis: int, at: float) -> Any:
        return ub.get_dofs(lambda x: np.abs(x[axis] - at) < 1e-9)

    top = plane(dim - 1, task.top_mm)
    rate, axial = np.zeros(ub.N), top.all([names[-1]])
    rate[axial] = 1.0
    held = [top.all(), plane(dim - 1, task.middle_mm).all([names[-1]])]
    held += [plane(axis, 0.0).all([names[axis]]) for axis in range(dim - 1)]
    dofs = np.unique(np.concatenate(held))
    return dofs, rate[dofs], axial


@functools.cache
def pardiso() -> Any | None:
    """PARDISO for symmetric indefinite matrices, or None; it takes a while to find its library."""
    try:
        import pypardiso
    except ImportError:
        return None
    return pypardiso.PyPardisoSolver(mtype=-2)


def linear_solve(K: Any, right: Any) -> Any:
    """PARDISO on the upper triangle where installed, SciPy elsewhere."""
    solver = pardiso()
    if solver is None:
        from scipy.sparse.linalg import spsolve

        return spsolve(K.tocsc(), right)
    solution = solver.solve(sp.triu(K, format="csr"), right)
    solver.free_memory(everything=True)
    return solution
