"""What a forward simulation gives back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.curve import Curve
from study.forward.energy_balance import EnergyBalance
from study.forward.gradients import Rate
from study.forward.problem import Problem
from study.forward.system import State, System

Array = NDArray[np.float64]


@dataclass(frozen=True)
class WarmStep:
    """A converged step of an earlier solve and how it moves with the constants."""

    state: State
    constants: dict[str, Rate]


@dataclass(frozen=True)
class Warm:
    """What a later solve of the same problem with other constants can start from."""

    system: System
    values: dict[str, float]
    steps: tuple[WarmStep, ...]


@dataclass(frozen=True)
class Solution:
    """Result of one forward simulation.

    Parameters
    ----------
    status : str
        ``converged``, ``not-converged``, ``mesh-failed``, ``unstable`` or ``out-of-memory``.
    message : str
        One sentence that says why it ended.
    curve : Curve
        Requested steps up to the last converged one, with stiffness, gradients and work; and, if
        :class:`~study.forward.options.Options` ask for it, steps added where the curve bends.
    reached_mm : float
        Displacement of the last converged step, sub-steps of a cut-back included.
    min_j : float
        Smallest J of the last converged step.
    base_reaction_N : ndarray, shape (n_steps,)
        Reaction of the base, to be compared with the force.
    energy : EnergyBalance
        Stored energy and the work of the test, point by point of the curve.
    newton_iterations : tuple of int
        Iterations of each point of the curve (its sub-steps added up).
    points, displacement : ndarray, shape (n_points, dim)
        Vertices of the mesh in mm and their displacements at the last converged step.
    cells : ndarray of int
        Vertex numbers of each cell.
    """

    status: str
    message: str
    curve: Curve
    reached_mm: float
    min_j: float
    base_reaction_N: Array
    energy: EnergyBalance
    newton_iterations: tuple[int, ...]
    dofs: int
    elements: int
    mesh_hash: str
    mesh_size_mm: float
    solver: str
    seconds: dict[str, float]
    points: Array
    cells: NDArray[np.int64]
    displacement: Array
    warm: Warm | None = None

    @property
    def converged(self) -> bool:
        """Whether every requested step was reached."""
        return self.status == "converged"


def without_answer(problem: Problem, status: str, message: str, seconds: float) -> Solution:
    """Solution of a problem that never came to its first step."""
    empty, none = np.zeros(0), np.zeros((0, 3))
    return Solution(
        status=status,
        message=message,
        curve=Curve(empty, empty, empty),
        reached_mm=0.0,
        min_j=1.0,
        base_reaction_N=empty,
        energy=EnergyBalance(empty, empty, empty),
        newton_iterations=(),
        dofs=0,
        elements=0,
        mesh_hash="",
        mesh_size_mm=problem.model.mesh_size_mm or 0.0,
        solver="none",
        seconds={"total": seconds},
        points=none,
        cells=np.zeros((0, 4), dtype=np.int64),
        displacement=none,
    )
