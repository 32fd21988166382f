"""The mesh as a value: nodes, cells and the element they carry."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass

import numpy as np

from study.arrays import Array, Ints


@dataclass(frozen=True)
class Mesh:
    """Points and cells of the modelled part of a specimen.

    Parameters
    ----------
    points : ndarray, shape (n_points, dim)
        Coordinates in mm.
    cells : ndarray, shape (n_cells, vertices)
        Triangles or quadrilaterals (axisymmetric), tetrahedra or hexahedra (3D).
    half_height : bool
        Whether only the half above the middle plane is meshed.
    size_mm : float
        Element size inside, or under the indenter.
    finest_mm : float, optional
        Size at the sharpest feature of an indenter, where that is finer.
    """

    points: Array
    cells: Ints
    half_height: bool
    size_mm: float
    finest_mm: float | None = None

    @property
    def contact_size_mm(self) -> float:
        """Size of the smallest elements in contact."""
        return self.finest_mm or self.size_mm

    @property
    def height_mm(self) -> float:
        """Height of the loaded surface; of the whole specimen where it stands on z = 0."""
        return float(self.points[:, -1].max())

    def digest(self) -> str:
        """Hash that tells whether two meshes are the same."""
        h = hashlib.sha256(np.round(self.points, 9).tobytes())
        h.update(self.cells.tobytes())
        return h.hexdigest()[:16]
