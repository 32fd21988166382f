"""Fields of a solution for ParaView: the mesh with its mid-side nodes, displacement and stress."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from study.arrays import Array, Ints
from study.errors import Fault, InputError
from study.fem.element.function_space import Discretization, deformation_gradient
from study.fem.mesh.graded import turned
from study.fem.solver.solution import Solution
from study.fem.solver.state import State
from study.fem.solver.system import System
from study.material.stress import first_piola

#: VTK's cell types by (dimension, corners, nodes that are drawn)
_TYPES = {
    (2, 3, 3): "triangle", (2, 3, 6): "triangle6", (2, 4, 4): "quad", (2, 4, 9): "quad9",
    (3, 4, 4): "tetra", (3, 4, 10): "tetra10", (3, 8, 8): "hexahedron", (3, 8, 27): "hexahedron27",
}  # fmt: skip

#: corners whose middle each further node of a VTK cell is, in VTK's order
_TRIANGLE = [(0, 1), (1, 2), (2, 0)]
_QUAD = [(0, 1), (1, 2), (2, 3), (3, 0)]
_HEX_EDGES = [
    *_QUAD, (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7),
]  # fmt: skip
_HEX_FACES = [
    (0, 3, 4, 7), (1, 2, 5, 6), (0, 1, 4, 5), (2, 3, 6, 7), (0, 1, 2, 3), (4, 5, 6, 7),
]  # fmt: skip
_MIDDLES: dict[str, list[tuple[int, ...]]] = {
    "triangle6": [*_TRIANGLE],
    "quad9": [*_QUAD, (0, 1, 2, 3)],
    "tetra10": [*_TRIANGLE, (0, 3), (1, 3), (2, 3)],
    "hexahedron27": [*_HEX_EDGES, *_HEX_FACES, tuple(range(8))],
}


@dataclass(frozen=True)
class Fields:
    """Fields of one step on the modelled part of the specimen.

    Axisymmetric coordinates are (r, z, 0), so that the axes of a tensor are r, z and hoop.

    Parameters
    ----------
    displacement_mm : float
        Displacement of the test.
    points, displacement : ndarray, shape (n_nodes, 3)
        Nodes before the deformation and their displacements, mm.
    kind : str
        Type of the cells as meshio names it.
    cells : ndarray of int
        Nodes of each cell.
    stress : ndarray, shape (n_cells, 3, 3)
        Cauchy stress, the mean of each cell, MPa.
    volume_ratio : ndarray, shape (n_cells,)
        J, volume after over volume before.
    """

    displacement_mm: float
    points: Array
    displacement: Array
    kind: str
    cells: Ints
    stress: Array
    volume_ratio: Array


def fields(solution: Solution) -> Fields:
    """Fields of the last requested step that converged.

    Parameters
    ----------
    solution : Solution
        Of a run by finite elements: its system and last state stand in ``warm``.

    Raises
    ------
    InputError
        If there is none.
    """
    if solution.warm is None or not solution.warm.steps:
        raise InputError(Fault("fields", f"no step converged: {solution.message}"))
    system, state = solution.warm.system, solution.warm.steps[-1].state
    space = system.space
    kind, cells = _cells(space, _upright(system.mesh.points, system.mesh.cells))
    used = np.unique(cells)  # bubbles belong to no corner and no side
    F = deformation_gradient(space, system.displacements(state.x))
    means = space.weights / space.weights.sum(axis=1, keepdims=True)
    # the volume that a linear body sees
    J = np.trace(F) - 2 if system.small_strain else np.linalg.det(np.moveaxis(F, (0, 1), (-2, -1)))
    return Fields(
        displacement_mm=state.displacement_mm,
        points=_in_space(space.nodes[used]),
        displacement=_in_space(system.displacements(state.x)[used]),
        kind=kind,
        cells=np.searchsorted(used, cells),
        stress=np.einsum("ijeq,eq->eij", cauchy_stress(system, state, F, J), means),
        volume_ratio=np.einsum("eq,eq->e", J, means),
    )


def write_vtu(solution: Solution, path: str | Path) -> None:
    """Write the fields of a solution into a VTU file for ParaView.

    Points are those before the deformation; *Warp By Vector* with ``displacement_mm`` deforms
    them. Cells carry ``J``, ``mean_stress_MPa`` (negative in compression), ``cauchy_stress_MPa``
    and ``von_mises_MPa``.

    Parameters
    ----------
    solution : Solution
        As for :func:`fields`.
    path : str or Path
        File to write, overwritten where there is one.

    Raises
    ------
    InputError
        If no step converged.
    OSError
        If the file cannot be written.
    """
    import meshio

    found = fields(solution)
    mean = np.trace(found.stress, axis1=1, axis2=2) / 3
    deviator = found.stress - mean[:, None, None] * np.eye(3)
    cell_data = {
        "J": found.volume_ratio,
        "mean_stress_MPa": mean,
        "von_mises_MPa": np.sqrt(1.5 * (deviator**2).sum(axis=(1, 2))),
        "cauchy_stress_MPa": found.stress.reshape(-1, 9),
    }
    mesh = meshio.Mesh(
        found.points,
        [(found.kind, found.cells)],
        point_data={"displacement_mm": found.displacement},
        cell_data={name: [values] for name, values in cell_data.items()},
    )
    mesh.write(path, file_format="vtu")


def cauchy_stress(system: System, state: State, F: Array, J: Array) -> Array:
    """Cauchy stress at every quadrature point, the pressure as it was solved for, MPa.

    Parameters
    ----------
    system : System
        Its material gives the stress but for the mean.
    state : State
        Its pressures give the mean stress.
    F : ndarray, shape (3, 3, n_elements, n_quadrature)
        Deformation gradients of the state.
    J : ndarray, shape (n_elements, n_quadrature)
        Volume ratios of the state; 1 + tr(eps) at small strain.

    Returns
    -------
    ndarray, shape (3, 3, n_elements, n_quadrature)
    """
    nominal = first_piola(system.material, F)
    small = system.small_strain
    stress = nominal if small else np.einsum("ij...,kj...->ik...", nominal, F) / J
    eye = np.eye(3)[:, :, None, None]
    stress = stress - np.trace(stress) / 3 * eye
    return np.asarray(stress + _pressure(system, state, J) * eye)


def _pressure(system: System, state: State, J: Array) -> Array:
    """Mean stress at every quadrature point."""
    space = system.space
    pointwise = system.internal.pointwise_bulk(system.material)
    own = space.dofs[:, space.dim * space.element_nodes.shape[1] :]
    shape = np.broadcast_to(space.pressure_shape, (*space.weights.shape, own.shape[1]))
    held = np.einsum("eqk,ek->eq", shape, state.x[own])
    return np.asarray(held + pointwise * (J - 1))


def _upright(points: Array, cells: Ints) -> Ints:
    """Simplices with positive volume, as VTK expects them; grids have it already."""
    return turned(points, cells.copy()) if cells.shape[1] == points.shape[1] + 1 else cells


def _cells(space: Discretization, corners: Ints) -> tuple[str, Ints]:
    """Type and nodes of the cells, the further nodes found by where they lie."""
    dim, n = space.dim, corners.shape[1]
    local = int(space.element_nodes.shape[1])
    kind = _TYPES.get((dim, n, local), _TYPES[(dim, n, n)])  # bubbles are not drawn
    if kind not in _MIDDLES:
        return kind, corners
    own = space.element_nodes
    rest = own[~(own[:, :, None] == corners[:, None, :]).any(axis=2)].reshape(len(own), -1)
    places = space.nodes[rest]
    found = [corners]
    for middle in _MIDDLES[kind]:
        target = space.nodes[corners[:, list(middle)]].mean(axis=1)
        nearest = np.linalg.norm(places - target[:, None], axis=2).argmin(axis=1)
        found.append(np.take_along_axis(rest, nearest[:, None], axis=1))
    return kind, np.hstack(found)


def _in_space(plane: Array) -> Array:
    """Give vectors a third component where they have two."""
    return np.pad(plane, ((0, 0), (0, 3 - plane.shape[1])))
