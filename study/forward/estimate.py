"""Unknowns, seconds and memory of a problem before it is solved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.forward.boundary import constraints
from study.forward.expected import expected_unknowns, memory_MB
from study.forward.mesh import Mesh, build_mesh
from study.forward.problem import Problem
from study.forward.steps import StepRule, StepSettings

#: Newton iterations of a load step: between plates, and where contact has to be found
_ITERATIONS, _CONTACT_ITERATIONS = 4, 4
#: an iteration with linear elements over one with quadratic ones of as many unknowns, in a mesh
#: that is graded around an indenter: their matrices hold a third of the entries
_LINEAR = 0.5
#: larger meshes are not made to count their unknowns
_COUNTED = 1e6
#: edges and faces of a cell by its number of corners, as pairs and fours of its corners
_EDGES = {
    (2, 3): [(0, 1), (1, 2), (0, 2)],
    (2, 4): [(0, 1), (1, 2), (2, 3), (0, 3)],
    (3, 4): [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)],
    (3, 8): [(0, 1), (1, 2), (2, 3), (0, 3), (4, 5), (5, 6), (6, 7), (4, 7),
             (0, 4), (1, 5), (2, 6), (3, 7)],
}  # fmt: skip
_FACES = [(0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 3, 7, 4)]


@dataclass(frozen=True)
class Estimate:
    """Predicted cost of one forward solve.

    Parameters
    ----------
    dofs : int
        Unknowns.
    seconds : float
        Wall time on one thread, kernels compiled.
    memory_MB : float
        Peak memory of the factorization and the element arrays.
    """

    dofs: int
    seconds: float
    memory_MB: float


def estimate(problem: Problem) -> Estimate:
    """Predict the cost of a problem from its mesh and the measured cost of an iteration.

    The seconds are those of one of two workers that are both busy.
    """
    dofs = expected_unknowns(problem)
    if dofs < _COUNTED:
        dofs = unknowns(problem, build_mesh(problem))
    seconds = _load_steps(problem, problem.specimen.height_mm) * _iteration(problem, dofs)
    memory = memory_MB(dofs, solid=problem.model.space == "3d")
    return Estimate(int(dofs), float(seconds), memory)


def _iteration(problem: Problem, dofs: float) -> float:
    """Seconds of a Newton iteration.

    Between plates 0.06 s at 21k axisymmetric and 0.5 s at 28k solid unknowns, by the powers
    1.2 and 1.95. Under an indenter, where meshes are graded and contact is looked for, 9 ms at
    2.9k axisymmetric, and 0.06 s at 5.5k, 0.15 s at 11k, 0.53 s at 27k quadratic solid unknowns.
    """
    solid, indented = problem.model.space == "3d", problem.test.kind == "indentation"
    if not solid:
        return float(3e-4 + 3.1e-6 * dofs if indented else 1e-3 + 0.06 * (dofs / 21e3) ** 1.2)
    if not indented:
        return float(0.5 * (dofs / 28e3) ** 1.95)
    share = 1.0 if problem.model.element_order == "quadratic" else _LINEAR
    return float(0.103 * share * (dofs / 8.2e3) ** 1.38)


def unknowns(problem: Problem, mesh: Mesh) -> int:
    """Free displacements and pressures of a problem on a mesh, without discretizing it."""
    model, dim, cells = problem.model, mesh.points.shape[1], mesh.cells
    vertices, n = len(mesh.points), len(cells)
    tensor, quadratic = model.element_shape == "tensor", model.element_order == "quadratic"
    mixed = model.formulation == "mixed"
    nodes = vertices
    if quadratic:
        nodes += _distinct(cells, _EDGES[(dim, cells.shape[1])]) + (n if tensor else 0)
        nodes += _distinct(cells, _FACES) if tensor and dim == 3 else 0
    elif mixed and not tensor:
        nodes += n  # bubbles
    pressures = (dim + 1 if quadratic else 1) * n if tensor else vertices
    # a held plane has about twice as many nodes in each direction as vertices
    held = constraints(problem, _Vertices(mesh.points), mesh).dofs.size
    held *= 2 ** (dim - 1) if quadratic else 1
    return int(dim * nodes + (pressures if mixed else 0) - held)


@dataclass(frozen=True)
class _Vertices:
    """Vertices of a mesh, as boundary conditions see the nodes of a discretization."""

    nodes: NDArray[np.float64]

    @property
    def dim(self) -> int:
        return int(self.nodes.shape[1])


def _distinct(cells: NDArray[np.int64], parts: Sequence[tuple[int, ...]]) -> int:
    groups = np.sort(np.vstack([cells[:, list(part)] for part in parts]), axis=1)
    return len(np.unique(groups, axis=0))


def _load_steps(problem: Problem, height_mm: float) -> float:
    """Newton iterations of a run: requested steps, each cut to what the step rule allows."""
    test = problem.test
    rule = StepRule.of(problem, height_mm, StepSettings())
    targets = test.displacement_mm * np.arange(1, test.steps + 1) / test.steps
    length = test.displacement_mm / test.steps
    pieces = sum(np.ceil(length / rule.largest_mm(depth) - 1e-9) for depth in targets)
    touching = test.kind == "indentation" and not test.holds_face
    return float(pieces * (_CONTACT_ITERATIONS if touching else _ITERATIONS))
