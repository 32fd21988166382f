"""NGSolve: an energy whose derivatives the code takes itself, its sparse Cholesky (LDL^T)."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from benchmarks.exchange import Answer, NoAnswerError, NotInstalledError, Task

try:
    import netgen.meshing as ngm
    import ngsolve as ng
except ImportError as error:
    raise NotInstalledError from error

MAX_ITERATIONS = 25


def rim(cells: np.ndarray) -> np.ndarray:
    """Faces (edges in the plane) that belong to one cell."""
    corners = cells.shape[1]
    faces = np.vstack([np.delete(cells, k, axis=1) for k in range(corners)])
    _, first, count = np.unique(
        np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True
    )
    return np.asarray(faces[first[count == 1]])


def sides(task: Task) -> list[tuple[str, np.ndarray]]:
    """Name of every plane that carries a condition, and its faces; the free side last."""
    faces = rim(task.cells)
    planes = [("plate", -1, task.top_mm), ("middle", -1, task.middle_mm), ("x", 0, 0.0)]
    if not task.axisymmetric:
        planes.append(("y", 1, 0.0))
    left, found = np.ones(len(faces), dtype=bool), []
    for name, axis, at in planes:
        on = (np.abs(task.points[faces][:, :, axis] - at) < 1e-9).all(axis=1)
        found.append((name, faces[on]))
        left &= ~on
    return [*found, ("free", faces[left])]


def mesh_of(task: Task) -> Any:
    """NGSolve's mesh from arrays."""
    dim = task.points.shape[1]
    mesh = ngm.Mesh(dim=dim)
    points = np.zeros((len(task.points), 3))
    points[:, :dim] = task.points
    mesh.AddPoints(points)
    gel = mesh.AddRegion("gel", dim=dim)
    mesh.AddElements(dim=dim, index=gel, data=task.cells.astype(np.int32), base=0)
    for name, faces in sides(task):
        number = mesh.AddRegion(name, dim=dim - 1)
        mesh.AddElements(dim=dim - 1, index=number, data=faces.astype(np.int32), base=0)
    return ng.Mesh(mesh)


def spaces(task: Task, mesh: Any) -> Any:
    """Taylor-Hood with the conditions of every component."""
    keys = {"dirichletx": "x|plate", "dirichlety": "y|plate", "dirichletz": "middle|plate"}
    if task.axisymmetric:
        keys = {"dirichletx": "x|plate", "dirichlety": "middle|plate"}
    return ng.VectorH1(mesh, order=2, **keys) * ng.H1(mesh, order=1)


def energy(task: Task, space: Any) -> Any:
    """Form of the two-field energy."""
    u, p = space.TrialFunction()
    if task.axisymmetric:
        g = ng.Grad(u)
        entries = (1 + g[0, 0], g[0, 1], 0, g[1, 0], 1 + g[1, 1], 0, 0, 0, 1 + u[0] / ng.x)
        F, weight = ng.CoefficientFunction(entries, dims=(3, 3)), 2 * np.pi * ng.x
        dx = ng.dx(intrules={ng.TRIG: ng.IntegrationRule(ng.TRIG, 4)})
    else:
        F, weight = ng.Id(3) + ng.Grad(u), 1.0
        dx = ng.dx(intrules={ng.TET: ng.IntegrationRule(ng.TET, 2)})
    J = ng.Det(F)
    density = task.c10 * (J ** (-2 / 3) * ng.InnerProduct(F, F) - 3) + p * (J - 1)
    density -= p * p / (2 * task.bulk)
    form = ng.BilinearForm(space, symmetric=True, condense=False)
    form += ng.Variation((weight * density).Compile() * dx)
    return form


class Newton:
    """Newton's method by hand: the first solve of a step carries the plate's motion."""

    def __init__(self, task: Task) -> None:
        self.task, self.mesh = task, mesh_of(task)
        self.space = spaces(task, self.mesh)
        self.form, self.state = energy(task, self.space), ng.GridFunction(self.space)
        self.free = self.space.FreeDofs()
        self.held = ~np.array(list(self.free), dtype=bool)
        self.residual = self.state.vec.CreateVector()
        self.inverse: Any = None
        up = ng.CoefficientFunction((0, 1) if task.axisymmetric else (0, 0, 1))
        plate = ng.GridFunction(self.space)
        plate.components[0].Set(up, definedon=self.mesh.Boundaries("plate"))
        self.plate = plate.vec

    def unsolved(self) -> float:
        """Residual that all codes stop by."""
        self.form.Apply(self.state.vec, self.residual)
        values = self.residual.FV().NumPy()
        reaction = np.linalg.norm(values[self.held])
        free, first = np.where(self.held, 0.0, values), self.space.components[0].ndof
        force, volume = np.linalg.norm(free[:first]), np.linalg.norm(free[first:])
        return self.task.unsolved(force, reaction, volume)

    def correct(self, lift: Any | None) -> None:
        """One factorization and solve."""
        self.form.AssembleLinearization(self.state.vec)
        right = self.residual
        if lift is not None:
            right.data += self.form.mat * lift
            self.state.vec.data += lift
        if self.inverse is None:
            self.inverse = self.form.mat.Inverse(self.free, inverse="sparsecholesky")
        else:
            self.inverse.Update()
        self.state.vec.data -= self.inverse * right

    def step(self, number: int) -> int:
        """Return the iterations of one load step."""
        lift = self.plate.CreateVector()
        lift.data = (self.task.plate_mm(number) - self.task.plate_mm(number - 1)) * self.plate
        for iteration in range(MAX_ITERATIONS + 1):
            if self.unsolved() < self.task.tolerance and iteration:
                return iteration
            self.correct(None if iteration else lift)
        raise NoAnswerError(f"step {number}: no equilibrium after {MAX_ITERATIONS} iterations")


def solve(task: Task) -> Answer:
    """Step by step."""
    ng.SetNumThreads(int(os.environ.get("OMP_NUM_THREADS", "2")))
    with ng.TaskManager():
        newton = Newton(task)
        iterations = sum(newton.step(number) for number in range(1, task.steps + 1))
        force = ng.InnerProduct(newton.residual, newton.plate)
    unknowns = int((~newton.held).sum())
    return Answer(-task.scale * float(force), iterations, unknowns, "sparse Cholesky")
