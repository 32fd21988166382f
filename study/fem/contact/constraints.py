"""What holds and what touches a specimen: prescribed unknowns and contact points of a test."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from study.arrays import Array, Ints
from study.fem.element.function_space import _SAME, Nodes, at_level
from study.fem.mesh.mesh import Mesh
from study.setup.geometry import Enclosed
from study.setup.setup import Setup
from study.setup.test_kind import FaceCondition
from study.surface.surface import body


@dataclass(frozen=True)
class Constraints:
    """Prescribed unknowns: ``x[dofs] = rate * displacement``.

    ``pins`` are those that only keep the specimen in its place and should carry nothing.
    """

    dofs: Ints
    rate: Array
    pins: Ints = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    @classmethod
    def of(cls, rate: Mapping[int, float], pins: Sequence[int] | Ints = ()) -> Constraints:
        """Prescribed unknowns with their rates, and the pins, which do not move."""
        every = {**rate, **{int(d): 0.0 for d in pins}}
        dofs = np.array(sorted(every), dtype=np.int64)
        rates = np.array([every[int(d)] for d in dofs])
        return cls(dofs, rates, np.array(pins, dtype=np.int64))


def constraints(setup: Setup, space: Nodes, mesh: Mesh) -> Constraints:
    """Held and driven unknowns of a test, the planes of symmetry (or the axis) included.

    Parameters
    ----------
    setup : Setup
        Its faces, its clamp and its symmetry say what is held.
    space : Nodes
        Nodes of a discretization, or the vertices alone.
    mesh : Mesh
        That the nodes belong to.
    """
    rate = prescribed_rates(setup, space, mesh)
    if setup.is_whole:  # what is left may move
        return Constraints.of(rate, pins(space.nodes, len(mesh.points), rate))
    tol = _SAME * mesh.height_mm
    for i in range(space.dim - 1):
        symmetric = np.flatnonzero(np.abs(space.nodes[:, i]) < tol)
        rate |= {int(n) * space.dim + i: 0.0 for n in symmetric}
    return Constraints.of(rate)


def prescribed_rates(setup: Setup, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Unknowns that the test's faces and the clamp of a surface prescribe.

    A face that a surface does not have, as it is round there, is left to contact.

    Parameters
    ----------
    setup, space, mesh
        As for :func:`constraints`.

    Returns
    -------
    dict of int to float
        Motion of each unknown per unit of the test's displacement; 0 where it is held.
    """
    specimen, dim, rate = setup.specimen, space.dim, dict[int, float]()
    for face in setup.faces:
        rate |= _face_rates(face, space, mesh)
    if not isinstance(specimen, Enclosed):
        return rate
    if not body(specimen).touches("top"):
        rate = _without_top(rate, space, mesh)
    if specimen.clamp_below_mm is None:
        return rate
    level = specimen.clamp_below_mm - body(specimen).lowest_mm
    below = np.flatnonzero(space.nodes[:, -1] < level)
    if setup.model.element_order == "linear":
        # a bubble is no point of the body: held, it would carry a force that no one applied
        below = below[below < len(mesh.points)]
    return rate | {int(n) * dim + i: 0.0 for n in below for i in range(dim)}


def _face_rates(face: FaceCondition, space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Unknowns of one face; in a half model the middle plane stands for the one below."""
    dim, half, is_top = space.dim, mesh.half_height, face.face == "top"
    level = mesh.height_mm if is_top else mesh.height_mm / 2 if half else 0.0
    nodes = at_level(space, mesh, level)
    if face.within_mm is not None:
        rho = np.linalg.norm(space.nodes[nodes][:, : dim - 1], axis=1)
        nodes = nodes[rho <= face.within_mm * (1 + _SAME)]
    axial = 0.5 * face.axial if half else face.axial
    rate = {int(n) * dim + dim - 1: axial for n in nodes}
    is_plane_of_symmetry = half and not is_top
    if not face.is_held or is_plane_of_symmetry:
        return rate
    moved = face_motions(space, nodes) @ _motion(face)
    held = {int(n) * dim + i: float(moved[k, i]) for k, n in enumerate(nodes) for i in range(dim)}
    return {dof: held[dof] + rate.get(dof, 0.0) for dof in held}


#: motions of a face besides that along the axis: two shifts, three small rotations, spread
BESIDES = 6


def _motion(face: FaceCondition) -> Array:
    """Components of the motion of a face per unit of displacement, shape (6,)."""
    if face.besides is None:
        return np.zeros(BESIDES)
    return face.share_per_mm * face.besides.components()


def face_motions(space: Nodes, nodes: Ints) -> Array:
    """Displacements of nodes of a face for a unit of each motion besides that along the axis.

    Parameters
    ----------
    space : Nodes
        Whose axis is the last coordinate, through the middle of the face.
    nodes : ndarray of int, shape (n,)
        Of the face.

    Returns
    -------
    ndarray, shape (n, dim, 6)
        For shifts along x and y (mm), rotations about x, y and the axis (rad, small), spread.
        In a plane nothing but the spread is left.
    """
    dim, places = space.dim, space.nodes[nodes]
    motions = np.zeros((len(nodes), dim, BESIDES))
    motions[:, : dim - 1, 5] = places[:, : dim - 1]
    if dim == 3:
        x, y = places[:, 0], places[:, 1]
        motions[:, 0, 0] = motions[:, 1, 1] = 1.0
        motions[:, 2, 2], motions[:, 2, 3] = y, -x
        motions[:, 0, 4], motions[:, 1, 4] = -y, x
    return motions


def _without_top(rate: dict[int, float], space: Nodes, mesh: Mesh) -> dict[int, float]:
    """Leave a round top to contact: it has no face that a plate could move as a whole."""
    top = {int(n) for n in at_level(space, mesh, mesh.height_mm)}
    return {dof: v for dof, v in rate.items() if dof // space.dim not in top}


#: motion, over that of the largest, below which a rigid motion counts as held
_HELD = 1e-6


def rigid_motions(places: Array) -> Array:
    """List translations and rotations about the middle of some points, shape (3 n, 6).

    Parameters
    ----------
    places : ndarray, shape (n, 3)
        Positions of nodes, mm.

    Returns
    -------
    ndarray, shape (3 n, 6)
        Columns are unit shifts along x, y and z, then small rotations about these axes, with lever
        arms in units of the largest extent.
    """
    middle = (places.min(axis=0) + places.max(axis=0)) / 2
    x, y, z = (places - middle).T / float(np.ptp(places, axis=0).max())
    zero = np.zeros(len(places))
    motions = np.zeros((len(places), 3, 6))
    motions[:, :, :3] = np.eye(3)
    motions[:, :, 3] = np.column_stack([zero, -z, y])
    motions[:, :, 4] = np.column_stack([z, zero, -x])
    motions[:, :, 5] = np.column_stack([-y, x, zero])
    return motions.reshape(-1, 6)


def pins(places: Array, n_free: int, held: Mapping[int, float]) -> Ints:
    """Unknowns that have to be held besides those that are.

    Parameters
    ----------
    places : ndarray, shape (n_nodes, 3)
        Nodes.
    n_free : int
        Only the first so many nodes may be pinned (vertices; a bubble moves nothing).
    held : mapping of int to float
        Unknowns that are prescribed already.

    Returns
    -------
    ndarray of int
        At most six unknowns, chosen where they move most in the motions that are left.
    """
    motions = rigid_motions(places)
    rows = motions[sorted(held)]
    values, directions = np.linalg.eigh(rows.T @ rows) if held else (np.zeros(6), np.eye(6))
    free = directions[:, values < _HELD**2 * max(float(values.max(initial=0.0)), 1.0)]
    chosen: list[int] = []
    while free.shape[1]:
        left = motions[: 3 * n_free] @ free
        # rounded, so that equal places do not change with the last digit
        dof = int(np.round(np.linalg.norm(left, axis=1), 9).argmax())
        chosen.append(dof)
        # the motions left are those that do not move this unknown
        free = free @ np.linalg.svd(left[dof : dof + 1])[2][1:].T
    return np.array(sorted(chosen), dtype=np.int64)
