"""Tetrahedra inside a closed surface, by gmsh.

The triangles are split into faces at sharp edges, each face is parametrized and meshed
again in the size that the model asks for (Remacle et al. 2010, Int. J. Numer. Meth. Eng. 83,
403); the volume is filled with tetrahedra. Nodes lie on the triangles of the file.
"""

from __future__ import annotations

import functools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array, Ints
from study.ground.errors import Fault, InputError, MeshError
from study.mechanics.mesh.graded import generated, gmsh_session, snapped, turned
from study.mechanics.mesh.size_field import (
    LARGEST,
    SizeField,
    SizeTable,
    expected_cubes,
    graded_table,
    size_at_plates,
    size_callback,
    size_field,
    table_callback,
)
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.geometry import Enclosed, Surface
from study.mechanics.setup.setup import Model, Setup, mesh_level
from study.mechanics.setup.test_kind import AroundContact
from study.mechanics.surface.closed_surface import Body, body

# Coordinates in which gmsh meshes a body: turned about the loading axis to an orientation that
# its shape gives, rounded to a power of two and ordered, for the last digits turn gmsh's
# comparisons (1.3 % of a force).

#: binary digits of the rounded coordinates: 2e-7 of the extent, below the digits of a scan and far
#: above rounding; more where corners would fall together
_DIGITS = (22, 32, 42)
#: factor on the extent: an extent of a power of two would lie at a border of rounding
_LARGER = 1.37
#: share of its sum of weights from which an angular moment gives the orientation, and the highest
_CLEAR = 0.01
_HIGHEST = 400
#: moments beyond it that tell equal parts of a turn apart
_FURTHER = 8
#: difference over the largest value below which two orientations count as equal
_EQUAL = 1e-7
#: equal orientations of a symmetric body that are told apart by their triangles
_COMPARED = 16


@dataclass(frozen=True)
class StandardFrame:
    """A body as gmsh is given it, and the way back.

    ``cosine`` and ``sine`` of an angle turn the body to its standard orientation; ``stretch`` is
    the rounded height over the height of the body.
    """

    body: Body
    cosine: float
    sine: float
    stretch: float

    def back(self, points: Array) -> Array:
        """Points of the standard frame in the body's coordinates, shape (n, 3)."""
        x, y, z = points.T
        c, s = self.cosine, self.sine
        turned = np.column_stack([c * x - s * y, s * x + c * y]) / (c**2 + s**2)
        return np.column_stack([turned, z / self.stretch])


@functools.lru_cache(maxsize=8)
def standard_frame(body: Body, seed: int | None = None) -> StandardFrame:
    """Turn, round and sort a body; a seed turns it further by an angle drawn at random."""
    # The meshes of two seeds are equally good, and differ as those of two generators would.
    further = 0.0 if seed is None else np.random.default_rng(seed).uniform(0.0, 2 * np.pi)
    frames = [_turned(body, angle + further) for angle in _orientations(body)[:_COMPARED]]
    return min(frames, key=lambda frame: frame.body.triangles.tolist())


def _turned(body: Body, angle: float) -> StandardFrame:
    """Frame of a body that is turned back by an angle (rad)."""
    # rounded, so that the angle has no last digits either
    c, s = (float(np.round(f(angle), 12)) for f in (np.cos, np.sin))
    x, y, z = body.points.T
    points = _rounded(np.column_stack([c * x + s * y, c * y - s * x, z]))
    order = np.lexsort(points.T[::-1])
    number = np.empty_like(order)
    number[order] = np.arange(order.size)
    triangles = number[body.triangles]
    first = triangles.argmin(axis=1)
    triangles = triangles[np.arange(len(first))[:, None], (first[:, None] + np.arange(3)) % 3]
    rows = np.lexsort(triangles.T[::-1])
    standard = replace(
        body, points=points[order], triangles=triangles[rows],
        top=body.top[rows], base=body.base[rows],
    )  # fmt: skip
    return StandardFrame(standard, c, s, standard.height_mm / body.height_mm)


def _rounded(points: Array) -> Array:
    """Coordinates that are multiples of a power of two, no two points at the same place."""
    exponent = np.ceil(np.log2(_LARGER * np.ptp(points, axis=0).max()))
    for digits in _DIGITS:
        step = 2.0 ** (exponent - digits)
        rounded = np.round(points / step) * step + 0.0  # no negative zeros
        if len(np.unique(rounded, axis=0)) == len(points):
            return np.asarray(rounded)
    return points


def _orientations(body: Body) -> Array:
    """Angles of the body about its loading axis (rad): several where its shape is symmetric."""
    # The first angular moment that is not small gives the angle up to a part of a turn. Which part,
    # the place of the loading axis and the other moments tell.
    middle = body.points[:, :2].mean(axis=0)
    away = (body.points[:, :2] - middle) @ np.array([1.0, 1.0j])
    size, weight = float(np.abs(away).max()), np.abs(away) * (1 + body.points[:, 2])
    unit = away / np.maximum(np.abs(away), 1e-300)
    powers, moments = weight.astype(complex), list[complex]()
    while len(moments) < _HIGHEST and (not moments or abs(moments[-1]) < _CLEAR):
        powers = powers * unit
        moments.append(complex(powers.sum()) / float(weight.sum()))
    fold = len(moments)
    if abs(moments[-1]) < _CLEAR:
        return np.zeros(1)
    # half a part further from three on, so that the sides of a square lie along the axes
    angles = (np.angle(moments[-1]) + np.pi * (fold > 2) + 2 * np.pi * np.arange(fold)) / fold
    for _ in range(_FURTHER):
        powers = powers * unit
        moments.append(complex(powers.sum()) / float(weight.sum()))
    for m, moment in [(1, complex(*-middle) / size), *enumerate(moments, 1)]:
        turned = moment * np.exp(-1j * m * angles)
        angles = angles[turned.real > turned.real.max() - _EQUAL]
        turned = moment * np.exp(-1j * m * angles)
        angles = angles[turned.imag > turned.imag.max() - _EQUAL]
    return np.asarray(angles)


#: angle between triangles at which an edge counts as sharp (rad)
FEATURE = np.radians(35.0)
#: the same for rough scans, on which some edges are so bent though they bound no face
ROUGH = np.radians(60.0)
#: reference sizes in one cube root of the volume; coarser than for half or quarter models
CELLS_PER_LENGTH = 12.0
#: the same where elements get smaller towards bonded plates: as many in all on a medium mesh
GRADED_PER_LENGTH = 6.5
#: largest part of the volume that straight-sided elements may cut off
_LOST = 0.05
#: what straight sides of the coarse mesh of an indented body may cut off, over that part
_SHARE = 0.6
#: a triangle with sides h on a sphere of radius R lies h^2 / 8 R below it, on average
_SAGITTA = 8.0
#: tetrahedra of size h in a volume of h^3, and unknowns (displacements, pressures) of each
_PER_CUBE = 6.0
#: the same where they grow away from an indenter, and as many more as gmsh makes because it cannot
#: follow sizes that grow within an element, by the two-thirds power of the number of cubes
_GROWING_PER_CUBE = 3.4
_GROWING_BESIDE = 10.9
#: tetrahedra beside a face over the squares of their size that cover it, in a body that is thinner
#: than they are: plates of 60 x 60 and 200 x 200 mm, 0.1 to 1 mm thick, have 3.8 to 4.4 at 3 mm
_PER_SQUARE = 4.0
#: triangles of a surface over which sizes are integrated, at least; and the most that are taken
#: one by one, with the lines of the raster in which more of them are gathered
_SAMPLED = 4000
_GATHERED = 20_000
_RASTER = 400
_UNKNOWNS = {"quadratic": 5.0, "linear": 4.0}


def surface_mesh(setup: Setup) -> Mesh:
    """Tetrahedra in a specimen given as a surface; a ``mesh_seed`` gives others of that size."""
    solid = _body_of(setup)
    frame = standard_frame(solid, setup.model.mesh_seed)
    field = _field(setup, standard_frame(solid).body)
    plates = _bonded(setup, frame.body)
    sizes = graded_table(frame.body, field.size_mm, plates) if plates else field
    points, cells = _tetrahedra(frame.body, sizes)
    points = snapped(frame.back(points), [(2, 0.0), (2, solid.height_mm)])
    # both plates are reached: where the ends are round, no node may lie on their poles
    points[points[:, 2].argmin(), 2], points[points[:, 2].argmax(), 2] = 0.0, solid.height_mm
    volume = _volume(points, cells)
    lost = abs(volume / solid.volume_mm3 - 1)
    if lost > _LOST:
        enclosed = f"{solid.volume_mm3:.4g} mm^3"
        rule = f"the mesh has {volume:.4g} mm^3 where the surface encloses {enclosed}"
        finer = field.size_mm * float(np.sqrt(_LOST / lost))
        raise MeshError(f"{rule}: a mesh_size of {finer:.2g} mm or less follows the shape")
    wider = float(np.sqrt(solid.volume_mm3 / _volume(points, cells)))
    points, cells = np.asarray(points * np.array([wider, wider, 1.0])), turned(points, cells)
    return Mesh(points, cells, False, field.size_mm, sizes.finest_mm)


def surface_mesh_size(setup: Setup) -> float:
    """Element size in mm: everywhere in compression, under the indenter in indentation."""
    return _field(setup, standard_frame(_body_of(setup)).body).size_mm


def expected_unknowns(setup: Setup) -> float:
    """Unknowns that the mesh of a problem will have, from volume, surface and sizes alone."""
    # Right within a factor of 1.5, of 1.3 under an indenter; of 3 in a body thinner than elements.
    solid = standard_frame(_body_of(setup)).body
    field = _field(setup, solid)
    plates, finest = _bonded(setup, solid), field.size_mm
    if isinstance(setup.grading, AroundContact):
        # where the axis misses the body little may be left of the sum, but no element is larger
        cubes = max(_cubes(solid, field), solid.volume_mm3 / field.largest_mm**3)
        cells = _GROWING_PER_CUBE * cubes + _GROWING_BESIDE * float(cubes ** (2 / 3))
        finest = field.largest_mm
    elif plates:
        cells = _PER_CUBE * expected_cubes(solid, field.size_mm, plates)
        finest = size_at_plates(solid, field.size_mm)
    else:
        cells = _PER_CUBE * solid.volume_mm3 / field.size_mm**3
    thin = _PER_SQUARE * solid.area_mm2 / finest**2
    return _UNKNOWNS[setup.model.element_order] * max(cells, thin)


def _cubes(solid: Body, field: SizeField) -> float:
    """Integral of 1 / h^3 over the body: over pyramids from the point of contact to each triangle.

    Those of triangles that face the contact count as negative, as in Gauss' theorem.
    """
    corners = solid.points[solid.triangles] - [0.0, 0.0, solid.axis_height_mm]
    while len(corners) < _SAMPLED:
        a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
    volumes, middle = np.linalg.det(corners) / 6, corners.mean(axis=1)
    places = np.column_stack([np.hypot(middle[:, 0], middle[:, 1]), middle[:, 2]])
    if len(corners) > _GATHERED:  # sizes depend on radius and height alone: near ones are one
        step = float(np.ptp(places, axis=0).max()) / _RASTER
        columns = np.round((places - places.min(axis=0)) / step).astype(np.int64)
        _, group, count = np.unique(
            columns[:, 0] * (_RASTER + 1) + columns[:, 1], return_inverse=True, return_counts=True
        )
        places = np.column_stack([np.bincount(group, weights=c) / count for c in places.T])
        volumes = np.bincount(group, weights=volumes).astype(float)
    t = np.concatenate([[0.0], np.geomspace(1e-3, 1.0, 80)])
    h = field.at(places[:, :1] * t, solid.axis_height_mm + places[:, 1:] * t)
    return float((3 * volumes * np.trapezoid(t**2 / h**3, t, axis=1)).sum())


def _body_of(setup: Setup) -> Body:
    if not isinstance(setup.specimen, Enclosed):
        raise MeshError("a mesh inside a surface needs a surface")
    return body(setup.specimen)


def _field(setup: Setup, solid: Body) -> SizeField:
    """Sizes of an indented surface; of a compressed one before bonded plates are looked at."""
    grading, model = setup.grading, setup.model
    if isinstance(grading, AroundContact):
        extent = min(solid.height_mm, solid.half_width_mm, _followed(solid) / LARGEST)
        if extent <= 0:
            mend = "choose press_x and press_y inside its outline"
            raise InputError(Fault("specimen.press_x", "is on the edge of the specimen", mend))
        # where the indenter comes down on a round body is lower than its highest point
        return size_field(model, grading, solid.axis_height_mm, extent)
    per_length = GRADED_PER_LENGTH if _bonded(setup, solid) else CELLS_PER_LENGTH
    usual = solid.volume_mm3 ** (1 / 3) / per_length
    return SizeField.uniform(model.mesh_size_mm or usual * mesh_level(model))


@functools.lru_cache(maxsize=8)
def _followed(solid: Body) -> float:
    """Largest reference size whose straight sides follow the round parts on a coarse mesh too."""
    rounding = solid.rounding_mm(FEATURE)
    if not rounding:
        return float("inf")
    coarse = np.sqrt(_SHARE * _LOST * _SAGITTA * solid.volume_mm3 / rounding)
    return float(coarse / mesh_level(Model(mesh="coarse")))


def _bonded(setup: Setup, solid: Body) -> tuple[float, ...]:
    """Heights of the bonded faces of a compressed surface."""
    grading, plates = setup.grading, []
    if isinstance(grading, AroundContact):
        return ()
    if grading.base and solid.touches("base"):
        plates.append(0.0)
    if grading.top and solid.touches("top"):
        plates.append(solid.height_mm)
    return tuple(plates)


def _tetrahedra(solid: Body, field: SizeField | SizeTable) -> tuple[Array, Ints]:
    try:
        return _between(solid, field, FEATURE)
    except MeshError as first:
        try:
            return _between(solid, field, ROUGH)
        except MeshError:
            # a unit that was mistaken is told with what came of it
            raise MeshError("; ".join([str(first), *solid.notes])) from None


def _between(solid: Body, field: SizeField | SizeTable, sharp: float) -> tuple[Array, Ints]:
    """Tetrahedra between faces that end at edges sharper than ``sharp`` (rad)."""
    size = size_callback(3) if isinstance(field, SizeField) else table_callback()
    # without their last digits: sums over a surface end in others on each processor
    numbers = np.array(field.numbers(), np.float32).astype(float)
    with gmsh_session(size, numbers) as gmsh:
        try:
            mesh, n = gmsh.model.mesh, len(solid.points)
            tag = gmsh.model.addDiscreteEntity(2)
            mesh.addNodes(2, tag, np.arange(1, n + 1), solid.points.ravel())
            mesh.addElementsByType(tag, 2, [], (solid.triangles + 1).ravel())
            mesh.classifySurfaces(sharp, True, True, sharp)
            mesh.createGeometry()
            faces = [face for _, face in gmsh.model.getEntities(2)]
            gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(faces)])
        except Exception as error:  # gmsh raises nothing more specific
            raise MeshError(f"gmsh cannot use the surface: {error}") from error
        return generated(gmsh, 3)


def _volume(points: Array, cells: Ints) -> float:
    edges = points[cells[:, 1:]] - points[cells[:, :1]]
    return float(np.abs(np.linalg.det(edges)).sum() / 6)


def surface_faults(setup: Setup) -> Iterator[Fault]:
    """Everything that speaks against a test of a specimen given as a surface."""
    specimen, model, pressed = setup.specimen, setup.model, setup.test.indenter
    if not isinstance(specimen, Enclosed):
        return
    if model.space == "axisymmetric":
        what = "a surface from a file" if isinstance(specimen, Surface) else "a brain"
        rule = f"{what} has no axis of symmetry that could be relied on"
        yield Fault("model.space", rule, 'write space = "3d"')
    if model.element_shape == "tensor":
        rule = "the inside of a surface is meshed with tetrahedra"
        yield Fault("model.element_shape", rule, 'write element_shape = "tetrahedron"')
    if model.space == "axisymmetric" or model.element_shape == "tensor":
        return
    solid = body(specimen)
    if specimen.clamp_below_mm is None and not solid.touches("base"):
        rule = "no face of the specimen lies in the plane of its lowest point: nothing holds it"
        mend = "hold it with clamp_below, turn it with axis, or raise plate_tolerance"
        yield Fault("test.base", rule, mend)
    bonded = any(f.face == "top" and f.is_held and f.within_mm is None for f in setup.faces)
    if bonded and not solid.touches("top"):
        rule = "no face of the specimen lies in the plane of its highest point: nothing to bond"
        mend = 'use interface = "frictionless", turn it with axis, or raise plate_tolerance'
        yield Fault("test.interface", rule, mend)
    if pressed is None or not pressed.has_face:
        return
    why = "a mesh of a surface has no line of nodes along the edge of a flat punch"
    if any(face.within_mm is not None for face in setup.faces):
        yield Fault("test.interface", why, 'use interface = "frictionless" and an edge_radius')
    elif pressed.is_sharp_edged:
        yield Fault("test.indenter.edge_radius", why, "round the edge, or use a block or cylinder")
