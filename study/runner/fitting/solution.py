"""A predicted curve, and how it was found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, cast

from study.curve import Curve
from study.record.document import MarkerDocument, MeshDocument, SolverDocument

if TYPE_CHECKING:  # it loads compiled kernels
    from study.fem.solver.solution import Solution


@dataclass(frozen=True)
class Predicted:
    """A predicted curve.

    Parameters
    ----------
    curve : Curve
        Its forces.
    mesh, solver : MeshDocument, SolverDocument
        How it was found; a closed form has no mesh.
    seconds : float
        What it cost beside the fit that gave the constants.
    markers : MarkerDocument, optional
        What markers inside the specimen say of it.
    """

    curve: Curve
    mesh: MeshDocument = field(default_factory=MeshDocument)
    solver: SolverDocument = field(default_factory=SolverDocument)
    seconds: float = 0.0
    markers: MarkerDocument | None = None

    @classmethod
    def of(cls, solution: Solution, seconds: float = 0.0) -> Predicted:
        """Prediction of a solution, without the gradients that nobody reads from the store."""
        curve = solution.curve.without_gradients()
        return cls(curve, mesh_document(solution), solver_document(solution), seconds)

    def to_json(self) -> dict[str, object]:
        """Plain data, for the store and for workers."""
        return {"curve": self.curve.as_dict(), "mesh": self.mesh, "solver": self.solver}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> Predicted:
        """Inverse of :meth:`to_json`."""
        return cls(
            Curve.from_dict(cast("Mapping[str, object]", document["curve"])),
            cast(MeshDocument, document.get("mesh", {})),
            cast(SolverDocument, document["solver"]),
        )


def mesh_document(solution: Solution) -> MeshDocument:
    """Describe the mesh of a solution for the record.

    Parameters
    ----------
    solution : Solution
        Of a problem with elements; a closed form has 0 of them and an empty hash.
    """
    return {
        "dofs": int(solution.dofs),
        "elements": int(solution.elements),
        "hash": str(solution.mesh_hash),
        "mesh_size_mm": float(solution.mesh_size_mm),
    }


def solver_document(solution: Solution) -> SolverDocument:
    """Describe how a solution was found, and its energy balance, for the record.

    Parameters
    ----------
    solution : Solution
        Its largest energy mismatch and stabilization are shares, its jumps displacements in mm.
    """
    return {
        "name": str(solution.solver),
        "min_j": float(solution.min_j),
        "energy_mismatch": float(solution.energy.largest_mismatch),
        "stabilization_share": float(solution.energy.stabilization_share),
        "snaps_mm": [float(place) for place in solution.energy.jumps_mm],
    }
