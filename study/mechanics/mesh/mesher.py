"""The mesh of a setup, whatever its specimen and its test.

Points are (r, z) in axisymmetric space and (x, y, z) in 3D, where the quarter with
x, y >= 0 is meshed (of a specimen given as a surface the whole). The same setup gives the
same mesh everywhere, and a refinement series has the ratio that was asked for.
"""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.mechanics.mesh.graded import indentation_mesh, sizes_of
from study.mechanics.mesh.perturbation import jittered
from study.mechanics.mesh.solid import surface_mesh, surface_mesh_size
from study.mechanics.mesh.structured import (
    Mesh,
    cross_section,
    equivalent_radius,
    extrude,
    graded_line,
    layers,
    rectangle,
)
from study.mechanics.setup.geometry import Enclosed, Specimen
from study.mechanics.setup.setup import Model, Setup, mesh_level
from study.mechanics.setup.test_kind import AroundContact, MeshGrading, Test, TowardsPlates
from study.mechanics.surface.closed_surface import height_of

#: reference sizes in one cube root of the volume; the finest named mesh has this size
CELLS_PER_LENGTH = 20.0
#: the same of a whole block, which has four times the cells of its quarter
CELLS_OF_WHOLE = 6.5
#: meshes of this process that are kept
_KEPT = 4


def mesh_size(setup: Setup) -> float:
    """Element size in mm: the given one, or that of the named level."""
    model = setup.model
    if isinstance(setup.specimen, Enclosed):
        return surface_mesh_size(setup)
    if isinstance(setup.grading, AroundContact):
        return sizes_of(setup).size_mm
    if model.mesh_size_mm is not None:
        return model.mesh_size_mm
    cells = CELLS_OF_WHOLE if setup.is_whole else CELLS_PER_LENGTH
    reference = setup.specimen.volume_mm3 ** (1 / 3) / cells
    return float(reference * mesh_level(model))


def build_mesh(setup: Setup) -> Mesh:
    """Mesh of a setup; with a ``mesh_seed`` another of the same size."""
    # A seed moves nodes at random, and has a specimen given as a surface meshed anew: with the
    # topology of one mesh, forces on a round body scatter by 1.5 %, over all meshes by 5 %.
    if isinstance(setup.specimen, Enclosed):  # not kept: its file may have changed
        return surface_mesh(setup)
    seed, test = setup.model.mesh_seed, replace(setup.test, steps=1)
    mesh = regular_mesh(setup.specimen, test, replace(setup.model, mesh_seed=None))
    if seed is None:
        return mesh
    return jittered(mesh, seed, _at_edge(setup.grading, mesh))


def _at_edge(grading: MeshGrading, mesh: Mesh) -> NDArray[np.bool_] | None:
    """Nodes that follow the edge of a flat end: they are part of what is modelled."""
    if not isinstance(grading, AroundContact) or not grading.indenter.has_face:
        return None
    ring = grading.indenter.face_radius_mm
    rho = np.linalg.norm(mesh.points[:, :-1], axis=1)
    on_top = mesh.points[:, -1] >= mesh.height_mm * (1 - 1e-9)
    # in 3D the nodes lie on chords as long as the elements there
    sagitta = mesh.size_mm**2 / (8 * ring) if mesh.points.shape[1] == 3 and ring > 0 else 0.0
    return np.asarray(on_top & (np.abs(rho - ring) <= 1.2 * sagitta + 1e-9 * mesh.height_mm))


@functools.lru_cache(maxsize=_KEPT)
def regular_mesh(specimen: Specimen, test: Test, model: Model) -> Mesh:
    """Mesh before nodes are moved: the last few are kept."""
    setup = Setup(specimen, test, model)
    if isinstance(setup.grading, AroundContact):
        mesh = indentation_mesh(setup)
    else:
        mesh = compressed_mesh(setup, setup.grading)
    mesh.points.flags.writeable = mesh.cells.flags.writeable = False  # many will use them
    return mesh


def compressed_mesh(setup: Setup, bonded: TowardsPlates) -> Mesh:
    """Mesh of a specimen between plates; the upper half where the middle plane is a symmetry."""
    h, half = mesh_size(setup), setup.has_middle_plane
    height = height_of(setup.specimen)
    z = layers(height, h, half=half, top=bonded.top, base=bonded.base)
    graded = bonded.top or bonded.base
    if setup.model.space == "axisymmetric":
        radius = equivalent_radius(setup.specimen)
        r = graded_line(radius, h, towards_end=graded)
        points, cells = rectangle(r, z, setup.model.element_shape)
    else:
        plane, faces = cross_section(
            setup.specimen, h, graded, setup.model.element_shape, whole=setup.is_whole
        )
        points, cells = extrude(plane, faces, z)
    return Mesh(points, cells, half, h)
