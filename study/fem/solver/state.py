"""Values of the unknowns, and what is assembled and looked at there."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from study.arrays import Array, Flags
from study.fem.contact.contact import ContactState, Glue, Meeting
from study.fem.element.function_space import Discretization, nodal_volumes
from study.fem.mesh.mesh import Mesh
from study.setup.setup import Problem


@dataclass(frozen=True)
class State:
    """Unknowns at one displacement.

    Parameters
    ----------
    displacement_mm : float
        Displacement of the test.
    x : ndarray, shape (n,)
        Displacements node by node, then pressures.
    multipliers : tuple of ndarray
        Contact pressures, one array for each set of contact points.
    closed : tuple of ndarray of bool
        Imposed active sets; empty where every contact point decides for itself.
    glue : Glue, optional
        What a bonded indenter has taken hold of.
    """

    displacement_mm: float
    x: Array
    multipliers: tuple[Array, ...] = ()
    closed: tuple[Flags, ...] = ()
    glue: Glue | None = None


@dataclass(frozen=True)
class Drag:
    """Resistance to leaving a place: ``weights`` (n,) times the motion from ``place`` (n,)."""

    weights: Array
    place: Array


@dataclass(frozen=True)
class Weight:
    """Gravity, a force that neither turns nor changes with the deformation.

    Parameters
    ----------
    forces : ndarray, shape (n,)
        On every unknown, N.
    energy_at_rest : float
        Energy of all kinds where the specimen has sagged and nothing touches it, N mm.
    """

    forces: Array
    energy_at_rest: float = 0.0

    @classmethod
    def of(cls, problem: Problem, mesh: Mesh, space: Discretization) -> Weight | None:
        """Weight of the modelled part of a specimen; None without gravity."""
        if not problem.test.weight_N_mm3:
            return None
        forces, dim = np.zeros(space.n), space.dim
        axial = np.arange(len(space.nodes)) * dim + dim - 1
        forces[axial] = problem.test.weight_N_mm3 * nodal_volumes(mesh, problem.model)
        return cls(forces)

    def scaled(self, share: float) -> Weight:
        """Return a share of the weight."""
        return Weight(share * self.forces)


@dataclass
class Assembly:
    """Residual, tangent entries and contact at one state (arrays are the system's own)."""

    min_j: float
    internal: Array
    residual: Array
    contact: list[ContactState]


@dataclass
class Latest:
    """What was found at the last state, so that it is found once.

    Parameters
    ----------
    meetings : tuple, optional
        Unknowns and displacement, and where each set of contact points is there.
    ratios : tuple of ndarray, optional
        Unknowns and J there.
    touching : ndarray of bool
        Closed contact points of the last assembly, one set after the other.
    """

    meetings: tuple[Array, float, list[Meeting]] | None = None
    ratios: tuple[Array, Array] | None = None
    touching: Flags = field(default_factory=lambda: np.zeros(0, bool))
