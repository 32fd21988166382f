"""FElupe: its own three-field (u, p, J) material on P2/P1/P1, PARDISO where installed.

J has the space of p, so that eliminating it gives the two-field solution: the forces agree.
"""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from benchmarks.exchange import Answer, NoAnswerError, NotInstalledError, Task

try:
    import felupe as fem
    import scipy.sparse as sp
except ImportError as error:
    raise NotInstalledError from error


@functools.cache
def solver() -> tuple[str, Any]:
    """Choose the fastest direct solver at hand: PARDISO, told that the matrix is symmetric."""
    try:
        import pypardiso
    except ImportError:
        from scipy.sparse.linalg import spsolve

        return "SuperLU", spsolve
    pardiso = pypardiso.PyPardisoSolver(mtype=-2)

    def symmetric(matrix: Any, right: np.ndarray) -> np.ndarray:
        rows = np.arange(matrix.shape[0])
        diagonal = sp.csr_matrix((np.zeros(rows.size), (rows, rows)))  # PARDISO wants all of it
        solution = pardiso.solve(sp.triu(matrix + diagonal, format="csr"), right)
        pardiso.free_memory(everything=True)
        return np.asarray(solution)

    return "PARDISO", symmetric


def six_points() -> Any:
    """Degree 4 on a triangle (Dunavant 1985), which the other codes take too."""
    points, weights = [], []
    for a, weight in (
        (0.445948490915965, 0.223381589678011),
        (0.091576213509771, 0.109951743655322),
    ):
        points += [[a, a], [a, 1 - 2 * a], [1 - 2 * a, a]]
        weights += [weight / 2] * 3
    return fem.quadrature.Scheme(np.array(points), np.array(weights))


def right_gradient(element: Any, rs: Any) -> np.ndarray:
    """Differentiate the quadratic triangle's functions.

    FElupe 11.3's own takes r for s at the last mid-side node, and the force comes out 1e-4 off.
    """
    r, s = rs
    t = 1 - r - s
    return np.array(
        [
            [1 - 4 * t, 1 - 4 * t], [4 * r - 1, 0.0], [0.0, 4 * s - 1],
            [4 * (t - r), -4 * r], [4 * s, 4 * r], [-4 * s, 4 * (t - s)],
        ]
    )  # fmt: skip


fem.element.QuadraticTriangle.gradient = right_gradient


def fields(task: Task) -> Any:
    """Displacement, pressure and volume ratio on the quadratic mesh."""
    kind = "triangle" if task.axisymmetric else "tetra"
    mesh = fem.Mesh(task.points, task.cells, kind).add_midpoints_edges()
    if not task.axisymmetric:
        region = fem.RegionQuadraticTetra(mesh, quadrature=fem.TetrahedronQuadrature(order=2))
        return fem.FieldsMixed(region, n=3)
    # FElupe's axis of symmetry is the first coordinate
    mesh.points[:] = mesh.points[:, ::-1]
    mesh.cells[:] = mesh.cells[:, [0, 2, 1, 5, 4, 3]]
    region = fem.RegionQuadraticTriangle(mesh, quadrature=six_points())
    return fem.FieldsMixed(region, n=3, axisymmetric=True)


def boundaries(task: Task, displacement: Any) -> dict[str, Any]:
    """Plate, middle plane and planes of symmetry."""
    axial = 0 if task.axisymmetric else 2
    others = [0, 1, 2][: 2 if task.axisymmetric else 3]
    others.remove(axial)
    names = "xyz"

    def plane(axis: int, at: float, held: list[int]) -> Any:
        skip = [number not in held for number in range(displacement.dim)]
        return fem.Boundary(displacement, **{f"f{names[axis]}": at}, skip=skip)

    found = {
        "middle": plane(axial, task.middle_mm, [axial]),
        "side": plane(axial, task.top_mm, others),
        "plate": plane(axial, task.top_mm, [axial]),
    }
    return found | {f"plane {a}": plane(a, 0.0, [a]) for a in others}


def stop_rule(task: Task, n_displacement: int) -> Any:
    """Newton's stop by the residual that all codes stop by."""

    def check(
        dx: Any, x: Any, f: Any, xtol: Any, ftol: Any, dof1: Any, dof0: Any, items: Any
    ) -> Any:
        values = np.asarray(f).ravel()
        free, held = values[dof1], np.linalg.norm(values[dof0])
        force, volume = free[dof1 < n_displacement], free[dof1 >= n_displacement]
        left = task.unsolved(np.linalg.norm(force), held, np.linalg.norm(volume))
        return np.linalg.norm(np.asarray(dx[0])), left, left < ftol

    return check


def solve(task: Task) -> Answer:
    """Step by step with FElupe's own Newton."""
    field = fields(task)
    held = boundaries(task, field[0])
    material = fem.NearlyIncompressible(fem.NeoHooke(mu=2 * task.c10), bulk=task.bulk)
    body, name = fem.SolidBody(material, field), solver()
    dof0, dof1 = fem.dof.partition(field, held)
    iterations = 0
    for step in range(1, task.steps + 1):
        held["plate"].value = task.plate_mm(step)
        ext0 = fem.dof.apply(field, held, dof0)
        try:
            found = fem.newtonraphson(
                items=[body], dof0=dof0, dof1=dof1, ext0=ext0, tol=task.tolerance,
                solver=name[1], verbose=0, check=stop_rule(task, field[0].values.size),
            )  # fmt: skip
        except fem.NewtonConvergenceError as error:
            raise NoAnswerError(f"step {step}: {error}") from error
        iterations += found.iterations
    force = np.asarray(found.fun).ravel()[held["plate"].dof].sum()
    return Answer(-task.scale * float(force), iterations, dof1.size, name[0])
