"""DOLFINx: compiled forms of the two-field problem, MUMPS' symmetric factorization.

Runs under mpirun with any number of processes.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.exchange import Answer, NoAnswerError, NotInstalledError, Task

try:
    import dolfinx
    import ufl
    from dolfinx import fem
    from dolfinx.fem import petsc as assembling
    from mpi4py import MPI
    from petsc4py import PETSc
except ImportError as error:
    raise NotInstalledError from error

COMM = MPI.COMM_WORLD
RANK = COMM.rank
MAX_ITERATIONS = 25


def mesh_of(task: Task) -> Any:
    """DOLFINx's own mesh; the first process hands the cells out."""
    shape = "triangle" if task.axisymmetric else "tetrahedron"
    dim = task.points.shape[1]
    element = ufl.VectorElement("Lagrange", ufl.Cell(shape, geometric_dimension=dim), 1)
    mine = slice(None) if COMM.rank == 0 else slice(0)
    cells = np.ascontiguousarray(task.cells[mine], dtype=np.int64)
    return dolfinx.mesh.create_mesh(COMM, cells, task.points[mine], ufl.Mesh(element))


def forms(task: Task, mesh: Any, x: Any, space: Any) -> tuple[Any, Any]:
    """Residual and tangent of the energy, derived and compiled by the code."""
    u, p = ufl.split(x)
    degree = 4 if task.axisymmetric else 2
    dx = ufl.dx(metadata={"quadrature_degree": degree})
    if task.axisymmetric:
        r = ufl.SpatialCoordinate(mesh)[0]
        g = ufl.grad(u)
        F = ufl.as_tensor(
            [[1 + g[0, 0], g[0, 1], 0], [g[1, 0], 1 + g[1, 1], 0], [0, 0, 1 + u[0] / r]]
        )
        weight = 2 * np.pi * r
    else:
        F, weight = ufl.Identity(3) + ufl.grad(u), 1.0
    J = ufl.det(F)
    energy = task.c10 * (J ** (-2 / 3) * ufl.inner(F, F) - 3) + p * (J - 1)
    energy -= p**2 / (2 * task.bulk)
    residual = ufl.derivative(energy * weight * dx, x, ufl.TestFunction(space))
    return fem.form(residual), fem.form(ufl.derivative(residual, x, ufl.TrialFunction(space)))


class Boundary:
    """Dirichlet conditions, and the axial unknowns under the plate."""

    def __init__(self, task: Task, mesh: Any, space: Any) -> None:
        dim, self.space = mesh.geometry.dim, space
        self.conditions: list[Any] = []
        mesh.topology.create_connectivity(dim - 1, dim)
        self.moving = fem.Function(space.sub(0).sub(dim - 1).collapse()[0])
        still = fem.Function(self.moving.function_space)
        for axis in range(dim - 1):
            self.hold(mesh, axis, axis, 0.0, still)
            self.hold(mesh, dim - 1, axis, task.top_mm, still)
        self.hold(mesh, dim - 1, dim - 1, task.middle_mm, still)
        self.plate = self.hold(mesh, dim - 1, dim - 1, task.top_mm, self.moving)

    def hold(self, mesh: Any, along: int, axis: int, at: float, value: Any) -> np.ndarray:
        """Prescribe one component on a plane."""
        edge = mesh.geometry.dim - 1
        faces = dolfinx.mesh.locate_entities_boundary(
            mesh, edge, lambda x: np.isclose(x[along], at, atol=1e-9)
        )
        part = self.space.sub(0).sub(axis)
        dofs = fem.locate_dofs_topological((part, value.function_space), edge, faces)
        self.conditions.append(fem.dirichletbc(value, dofs, part))
        return np.asarray(dofs[0])


def linear_solver(matrix: Any) -> Any:
    """MUMPS' LDL^T for symmetric indefinite matrices."""
    matrix.setOption(PETSc.Mat.Option.SYMMETRIC, True)
    ksp = PETSc.KSP().create(COMM)
    ksp.setOperators(matrix)
    ksp.setType("preonly")
    ksp.getPC().setType("cholesky")
    ksp.getPC().setFactorSolverType("mumps")
    return ksp


class Newton:
    """Newton's method by hand: the first solve of a step carries the plate's motion."""

    def __init__(self, task: Task) -> None:
        mesh = mesh_of(task)
        shape = mesh.ufl_cell()
        pair = ufl.VectorElement("Lagrange", shape, 2) * ufl.FiniteElement("Lagrange", shape, 1)
        self.space = fem.FunctionSpace(mesh, pair)
        self.x = fem.Function(self.space)
        self.residual, self.tangent = forms(task, mesh, self.x, self.space)
        self.boundary, self.task = Boundary(task, mesh, self.space), task
        self.matrix = assembling.create_matrix(self.tangent)
        self.ksp = linear_solver(self.matrix)
        held = [c.dof_indices()[0] for c in self.boundary.conditions]
        owned = self.space.dofmap.index_map.size_local
        self.held = np.unique(np.concatenate(held))
        self.held = self.held[self.held < owned]
        moving = np.unique(self.space.sub(0).dofmap.list.array)
        self.displacements = moving[moving < owned]
        self.plate = self.boundary.plate[self.boundary.plate < owned]

    def raw(self) -> Any:
        """Residual with the reactions in it."""
        b = assembling.assemble_vector(self.residual)
        b.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        return b

    def force(self, b: Any) -> float:
        """Return the axial force on the plate."""
        return float(COMM.allreduce(b.array[self.plate].sum()))

    def unsolved(self, b: Any) -> float:
        """Residual that all codes stop by."""
        values = b.array.copy()
        reaction, values[self.held] = values[self.held], 0.0
        parts = values[self.displacements], reaction, np.delete(values, self.displacements)
        sums = [COMM.allreduce(float((part**2).sum())) for part in parts]
        return self.task.unsolved(*np.sqrt(sums))

    def correct(self, b: Any) -> None:
        """One factorization and solve."""
        conditions = self.boundary.conditions
        self.matrix.zeroEntries()
        assembling.assemble_matrix(self.matrix, self.tangent, bcs=conditions)
        self.matrix.assemble()
        right = assembling.assemble_vector(self.residual)
        assembling.apply_lifting(
            right, [self.tangent], [conditions], x0=[self.x.vector], scale=-1.0
        )
        right.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        assembling.set_bc(right, conditions, self.x.vector, -1.0)
        increment = right.duplicate()
        self.ksp.solve(right, increment)
        self.x.vector.axpy(-1.0, increment)
        self.x.x.scatter_forward()

    def step(self, number: int) -> tuple[int, float]:
        """Return the iterations and the force of one load step."""
        self.boundary.moving.x.array[:] = self.task.plate_mm(number)
        for iteration in range(MAX_ITERATIONS + 1):
            b = self.raw()
            if iteration and self.unsolved(b) < self.task.tolerance:
                return iteration, self.force(b)
            self.correct(b)
        raise NoAnswerError(f"step {number}: no equilibrium after {MAX_ITERATIONS} iterations")


def solve(task: Task) -> Answer:
    """Step by step."""
    how = f"MUMPS, {COMM.size} process" + ("es" if COMM.size > 1 else "")
    return answered(Newton(task), how)


def answered(newton: Newton, how: str) -> Answer:
    """Take every step, and collect what is told of it."""
    task, iterations, force = newton.task, 0, 0.0
    for number in range(1, task.steps + 1):
        spent, force = newton.step(number)
        iterations += spent
    unknowns = newton.space.dofmap.index_map.size_global - COMM.allreduce(newton.held.size)
    return Answer(-task.scale * force, iterations, int(unknowns), how)


def everywhere(mine: float) -> float:
    """Sum of a figure over all processes."""
    return float(COMM.allreduce(mine))
