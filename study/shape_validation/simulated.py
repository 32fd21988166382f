"""A simulated body: its surface before and after the deformation, and what moves inside."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array
from study.bounded_file import open_regular
from study.errors import Fault, InputError
from study.registration.closest_point import TriangleSurface
from study.shape_validation.boundary import (
    KINDS,
    BodySurface,
    DeformedMesh,
    Symmetry,
    surface_of,
    symmetry_of,
)
from study.units import unit_factor

if TYPE_CHECKING:
    from scipy.interpolate import LinearNDInterpolator

#: Name of the displacements in a VTU file.
DISPLACEMENT = "displacement_mm"


@dataclass(frozen=True)
class SimulatedBody:
    """Simulated body in its own frame.

    Parameters
    ----------
    body : BodySurface
        Surface at rest with its displacements; none where only the deformed surface is known.
    mesh : DeformedMesh or None
        Mesh that it comes from; None for a surface file.
    symmetry : Symmetry or None
        What part of the body the mesh is.
    notes : tuple of str
        What was mended in reading.
    """

    body: BodySurface
    mesh: DeformedMesh | None = None
    symmetry: Symmetry | None = None
    notes: tuple[str, ...] = ()

    def at(self, share: float) -> TriangleSurface:
        """Surface at a share of the displacement: 0 at rest, 1 deformed."""
        points = self.body.points + share * self.body.displacement
        return TriangleSurface(points, self.body.triangles)

    @cached_property
    def deformed(self) -> TriangleSurface:
        """Deformed surface."""
        return self.at(1.0)

    @property
    def largest_displacement_mm(self) -> float:
        """Largest displacement of a point of the surface."""
        return float(np.linalg.norm(self.body.displacement, axis=1).max())

    @cached_property
    def _interpolator(self) -> LinearNDInterpolator:
        from scipy.interpolate import LinearNDInterpolator

        if self.mesh is None:
            raise InputError(Fault("--markers", "a surface file says nothing of points inside it",
                                   "give the problem or its VTU file"))  # fmt: skip
        size = 2 if self.mesh.is_section else 3
        used = np.unique(self.mesh.cells)
        return LinearNDInterpolator(
            self.mesh.points[used, :size], self.mesh.displacement[used, :size]
        )

    def displacement_at(self, points: Array) -> Array:
        """Displacement of material points, shape (n, 3), mm; nan outside the body.

        Between nodes it is linear on tetrahedra of Delaunay, whose error is of the second order
        in the element size, as that of linear elements.

        Parameters
        ----------
        points : ndarray, shape (n, 3)
            Places at rest, mm.
        """
        interpolate, symmetry = (
            self._interpolator,
            self.symmetry or Symmetry(False, (False,) * 3, 0),
        )
        signs = np.ones_like(points)
        places = points.copy()
        for k, mirrored in enumerate(symmetry.mirrored):
            plane = symmetry.lowest if k == 2 else 0.0
            flipped = mirrored & (points[:, k] < plane)
            places[flipped, k] = 2 * plane - places[flipped, k]
            signs[flipped, k] = -1.0
        if not symmetry.section:
            return np.asarray(interpolate(places) * signs)
        radius = np.hypot(points[:, 0], points[:, 1])
        moved = interpolate(np.column_stack([radius, places[:, 2]]))
        outward = points[:, :2] / np.maximum(radius, 1e-300)[:, None]
        return np.column_stack([moved[:, [0]] * outward, moved[:, 1] * signs[:, 2]])


def body_of_mesh(mesh: DeformedMesh) -> SimulatedBody:
    """Body that a mesh is a part of.

    Parameters
    ----------
    mesh : DeformedMesh

    Returns
    -------
    SimulatedBody

    Raises
    ------
    InputError
        For cells of an unknown type, or a surface that does not close.
    """
    return SimulatedBody(surface_of(mesh), mesh, symmetry_of(mesh))


def read_body(path: Path, unit: str) -> SimulatedBody:
    """Read a simulated body from a file.

    Parameters
    ----------
    path : Path
        VTU with the point data ``displacement_mm``; or the deformed surface as STL, PLY or OBJ.
    unit : str
        Unit of a surface file; a VTU file is in mm.

    Returns
    -------
    SimulatedBody

    Raises
    ------
    InputError
        For a faulty file, or a surface with holes: it has no inside.
    """
    if path.suffix.lower() == ".vtu":
        return body_of_mesh(_read_vtu(path))
    from study.surface.integrity import inspect
    from study.surface.surface import read_mesh

    where = f"simulation: {path.name}"
    points, triangles = read_mesh(path, where)
    if not len(triangles):
        raise InputError(Fault(where, "holds no triangles", "the cloud is given by --scan"))
    try:
        found = inspect(points, triangles, path.name, unit)
    except InputError as error:
        raise InputError(
            [Fault(f.where.replace("specimen.file", "simulation"), f.rule, f.mend)
             for f in error.faults]
        ) from None  # fmt: skip
    scaled = unit_factor(unit, "length") * found.points
    notes = tuple(note.replace("specimen.file", "simulation") for note in found.notes)
    body = BodySurface(scaled, np.zeros_like(scaled), found.triangles)
    return SimulatedBody(body, notes=notes)


def _read_vtu(path: Path) -> DeformedMesh:
    """Read cells, points and displacements of a VTU file."""
    from meshio import vtu

    where = f"simulation: {path.name}"
    try:
        stream = open_regular(path)
        if stream is not None:
            stream.close()
        mesh = vtu.read(str(path))
    except Exception as error:  # meshio's parsers raise whatever they stumble over
        reason = str(error).split("\n")[0][:120] or type(error).__name__
        raise InputError(Fault(where, f"cannot be read: {reason}", "write it again")) from error
    data: Mapping[str, Array] = mesh.point_data
    if DISPLACEMENT not in data:
        mend = f"study solve FILE --vtu OUT.vtu writes it; it holds {', '.join(data) or 'none'}"
        raise InputError(Fault(where, f"has no point data {DISPLACEMENT!r}", mend))
    blocks = [(block.type, block.data) for block in mesh.cells if block.type in KINDS]
    kinds = {kind for kind, _ in blocks}
    if len(kinds) != 1:
        rule = f"has cells of types {', '.join(sorted(block.type for block in mesh.cells))}"
        raise InputError(Fault(where, rule, f"one of {', '.join(KINDS)} is read"))
    cells = np.concatenate([np.asarray(cells, dtype=np.int64) for _, cells in blocks])
    points = np.array(mesh.points, dtype=float)
    return DeformedMesh(points, np.array(data[DISPLACEMENT], dtype=float), kinds.pop(), cells)
