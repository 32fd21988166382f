"""Unknowns, seconds and memory of a problem before it is solved."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.forward.mesh import build_mesh
from study.forward.problem import Problem

#: unknowns a vertex carries, fitted on graded cylinders: (space, order) -> factor
_UNKNOWNS = {
    ("axisymmetric", "linear"): 6.6,
    ("axisymmetric", "quadratic"): 8.6,
    ("3d", "linear"): 17.5,
    ("3d", "quadratic"): 23.0,
}


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

    An iteration costs about 0.05 s at 21k axisymmetric, 0.35 s at 28k and 5 s at 108k 3D
    unknowns: a power law of 1.2 and 1.95 between them; four iterations make a step.
    """
    mesh = build_mesh(problem)
    per_vertex = _UNKNOWNS[(problem.model.space, problem.model.element_order)]
    dofs = per_vertex * len(mesh.points)
    steps = max(problem.test.steps, int(np.ceil(problem.test.displacement_mm)) // 3)
    if problem.model.space == "axisymmetric":
        iteration, memory = 0.05 * (dofs / 21e3) ** 1.2, 110 + 3e-3 * dofs
    else:
        iteration, memory = 0.5 * (dofs / 28e3) ** 1.95, 110 + 0.25e-3 * dofs**1.35
    return Estimate(int(dofs), float(4 * steps * iteration), float(memory))
