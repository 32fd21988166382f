"""The mesh of a problem, whatever its specimen and its test.

Points are (r, z) in axisymmetric space and (x, y, z) in 3D, where the quarter with
x, y >= 0 is meshed (of a specimen given as a surface the whole). The same problem gives the
same mesh everywhere, and a refinement series has the ratio that was asked for.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.fem.mesh.graded import graded_size, indentation_mesh
from study.fem.mesh.mesh import Mesh
from study.fem.mesh.perturbation import jittered
from study.fem.mesh.solid import surface_mesh, surface_mesh_size
from study.fem.mesh.structured import (
    cross_section,
    equivalent_radius,
    extrude,
    graded_line,
    layers,
    rectangle,
    volume_mm3,
)
from study.setup.geometry import Flat, Surface
from study.setup.setup import Problem, mesh_level
from study.surface.surface import height_of

#: reference sizes in one cube root of the volume; the finest named mesh has this size
CELLS_PER_LENGTH = 20.0

#: meshes of this process that are kept, and they
_KEPT = 4
_MADE: dict[tuple[object, ...], Mesh] = {}


def mesh_size(problem: Problem) -> float:
    """Element size in mm: the given one, or that of the named level."""
    model = problem.model
    if isinstance(problem.specimen, Surface):
        return surface_mesh_size(problem)
    if problem.test.kind == "indentation":
        return graded_size(problem)
    if model.mesh_size_mm is not None:
        return model.mesh_size_mm
    reference = volume_mm3(problem.specimen) ** (1 / 3) / CELLS_PER_LENGTH
    return float(reference * mesh_level(model))


def build_mesh(problem: Problem) -> Mesh:
    """Mesh of a problem, its nodes moved at random where the model has a ``mesh_seed``.

    Raises
    ------
    MeshError
        If no usable mesh could be made.
    """
    mesh, seed = _regular_mesh(problem), problem.model.mesh_seed
    if seed is None:
        return mesh

    return jittered(mesh, seed, _at_edge(problem, mesh))


def _at_edge(problem: Problem, mesh: Mesh) -> NDArray[np.bool_] | None:
    """Nodes that follow the edge of a flat end: they are part of what is modelled."""
    pressed = problem.test.indenter
    if problem.test.kind != "indentation" or not isinstance(pressed, Flat):
        return None
    ring = pressed.radius_mm - pressed.edge_radius_mm
    rho = np.linalg.norm(mesh.points[:, :-1], axis=1)
    on_top = mesh.points[:, -1] >= mesh.height_mm * (1 - 1e-9)
    # in 3D the nodes lie on chords as long as the elements there
    sagitta = mesh.size_mm**2 / (8 * ring) if mesh.points.shape[1] == 3 and ring > 0 else 0.0
    return np.asarray(on_top & (np.abs(rho - ring) <= 1.2 * sagitta + 1e-9 * mesh.height_mm))


def _regular_mesh(problem: Problem) -> Mesh:
    """Mesh before nodes are moved: the last few are kept, as materials do not change them."""
    if isinstance(problem.specimen, Surface):  # the file may have changed
        return surface_mesh(problem)
    asked = problem.specimen, replace(problem.test, steps=1), replace(problem.model, mesh_seed=None)
    if asked not in _MADE:
        mesh = _made(problem)
        mesh.points.flags.writeable = mesh.cells.flags.writeable = False  # many will use them
        for oldest in list(_MADE)[: 1 - _KEPT]:
            del _MADE[oldest]
        _MADE[asked] = mesh
    return _MADE[asked]


def forget_meshes() -> None:
    """Let the next meshes be made anew: where the time that it takes is asked for."""
    _MADE.clear()


def _made(problem: Problem) -> Mesh:
    if problem.test.kind == "indentation":
        return indentation_mesh(problem)
    return compressed_mesh(problem)


def compressed_mesh(problem: Problem) -> Mesh:
    """Mesh of a compressed specimen; the half above the middle plane where that is a symmetry."""
    h = mesh_size(problem)
    half = problem.test.interface == problem.test.base
    height = height_of(problem.specimen)
    bonded_top = problem.test.interface == "bonded"
    bonded_base = problem.test.base == "bonded"
    z = layers(height, h, half=half, top=bonded_top, base=bonded_base)
    graded = bonded_top or bonded_base
    if problem.model.space == "axisymmetric":
        radius = equivalent_radius(problem.specimen)
        r = graded_line(radius, h, towards_end=graded)
        points, cells = rectangle(r, z, problem.model.element_shape)
    else:
        plane, faces = cross_section(problem.specimen, h, graded, problem.model.element_shape)
        points, cells = extrude(plane, faces, z)
    return Mesh(points, cells, half, h)
