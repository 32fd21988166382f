"""Unknowns and memory of a problem from its sizes alone, before anything is meshed.

A mesh size with a wrong unit would fill the machine while it is meshed. Here the density of
elements is integrated, so that a mesh of any number of cells is judged in milliseconds. Only a
mesh that is made at once is made to count its unknowns.
"""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault
from study.mechanics.contact.contact import constraints
from study.mechanics.element.function_space import Nodes, basis_of, pressure_of
from study.mechanics.mesh.graded import (
    BULGE,
    CORE,
    around,
    grid_sizes,
    has_room,
    inward,
    sizes_of,
)
from study.mechanics.mesh.mesher import build_mesh, mesh_size
from study.mechanics.mesh.size_field import SizeField
from study.mechanics.mesh.solid import expected_unknowns as inside
from study.mechanics.mesh.structured import CORNER_FRACTION, GROWTH, Mesh, equivalent_radius
from study.mechanics.setup.geometry import Block, Enclosed, Indenter, Specimen
from study.mechanics.setup.setup import Model, Setup
from study.mechanics.setup.test_kind import (
    AroundContact,
    IndenterContact,
    StepSettings,
    Test,
    TowardsPlates,
)
from study.mechanics.surface.closed_surface import height_of

# -------------------------------------------------------------------------------------------------
# Cells of the mesh of a cylinder or a block from its sizes alone, before it is made.

#: cells of gmsh in a square or a cube of one size
_PER_SQUARE = 2.4
_PER_CUBE = 5.3

#: the same on a line or a square of one size on the surface
_PER_LINE = 1.0
_PER_FACE = 2.3

#: places at which sizes are looked at, on each side of a feature
_SAMPLES = 80


def _between_plates(setup: Setup, grading: TowardsPlates) -> float:
    """Cells of a structured mesh: see :func:`study.mechanics.mesh.mesher.compressed_mesh`."""
    specimen, h, bonded = setup.specimen, mesh_size(setup), (grading.top, grading.base)
    half = height_of(specimen) / 2
    high = sum(_line(half, h, graded=plate) for plate in bonded)
    if setup.has_middle_plane:
        high /= 2  # the half above the middle plane
    simplex, rim = setup.model.element_shape == "simplex", any(bonded)
    radius = equivalent_radius(specimen)
    if setup.model.space == "axisymmetric":
        return high * _line(radius, h, graded=rim) * (2 if simplex else 1)
    if isinstance(specimen, Block):
        plane = _line(specimen.width_mm / 2, h, graded=rim)
        plane *= _line(specimen.depth_mm / 2, h, graded=rim) * (4 if setup.is_whole else 1)
        return high * plane * (6 if simplex else 1)
    if not simplex:
        return high * _disc(_line(radius / 2, h, graded=False), _line(radius, h, graded=rim))
    # ring k of triangles carries segments of the size h, see quarter_disc
    inner = np.pi * radius**2 / (2 * h**2)
    extra = _line(radius, h, graded=rim) - radius / h
    return high * 3 * (inner + np.pi * radius / h * extra)


def _line(length: float, h: float, *, graded: bool) -> float:
    """Count the steps of :func:`study.mechanics.mesh.structured.graded_line`."""
    if not graded:
        return max(1.0, length / h)
    coarse = min((1 - CORNER_FRACTION) * h / GROWTH, length)
    return float(np.log1p(GROWTH * coarse / (CORNER_FRACTION * h)) / GROWTH + (length - coarse) / h)


def _disc(inner: float, line: float) -> float:
    """Quadrilaterals of a quarter disc: a square of half the radius, two blocks around it."""
    return inner**2 + 2 * inner * max(line - inner, 1.0)


def _under_indenter(setup: Setup, indenter: Indenter) -> float:
    """Cells of a graded mesh: see :func:`study.mechanics.mesh.graded.indentation_mesh`."""
    specimen, field = setup.specimen, sizes_of(setup)
    radius, flat = equivalent_radius(specimen), setup.model.space == "axisymmetric"
    if setup.model.element_shape == "tensor":
        return _grid(setup, indenter, field, radius)
    rho = _places(radius, field.ring_mm, field)
    z = height_of(specimen) - _places(height_of(specimen), 0.0, field)
    h = field.at(*(a.ravel() for a in np.meshgrid(rho, z))).reshape(z.size, rho.size)
    density = np.asarray(1 / h**2 if flat else np.pi / 2 * rho / h**3)
    total = abs(float(np.trapezoid(np.trapezoid(density, rho, axis=1), z)))
    filled = (_PER_SQUARE if flat else _PER_CUBE) * total
    # a specimen thinner than its elements has as many as its upper and lower face ask for
    h = field.at(rho, np.array([field.top_mm]))
    thin = 2 * float(np.trapezoid(1 / h if flat else np.pi / 2 * rho / h**2, rho))
    return max(filled, (_PER_LINE if flat else _PER_FACE) * thin)


def _grid(setup: Setup, indenter: Indenter, field: SizeField, radius: float) -> float:
    """Quadrilaterals or hexahedra between lines."""
    specimen, (top, axis) = setup.specimen, grid_sizes(setup, field)

    def along_top(length: float) -> float:
        return _steps(length, field.ring_mm, field, top)

    high = _steps(height_of(specimen), 0.0, field, axis)
    solid = setup.model.space == "3d"
    if solid and indenter.has_face and has_room(specimen, field.ring_mm):
        return high * _rings(specimen, field)
    if setup.model.space == "axisymmetric":
        return high * along_top(radius)
    if isinstance(specimen, Block):
        return high * along_top(specimen.width_mm / 2) * along_top(specimen.depth_mm / 2)
    return high * _disc(along_top(radius / 2), along_top(radius))


def _rings(specimen: Specimen, field: SizeField) -> float:
    """Quadrilaterals of :func:`study.mechanics.mesh.graded.punched` over a cross-section."""
    n, ring = around(field), field.ring_mm
    half = equivalent_radius(specimen)
    if isinstance(specimen, Block):  # the mean of where rays meet a square
        half = 0.56 * min(specimen.width_mm, specimen.depth_mm)
    core = 0.5 * (1 + BULGE) * CORE * ring

    def steps(sizes: SizeField, start: float, end: float) -> float:
        places = np.unique(np.clip(_places(end, ring, sizes), start, end))
        return float(np.trapezoid(1 / sizes.at(places, sizes.top_mm), places))

    around_it = steps(inward(field), core, ring) + steps(field, ring, max(half, ring))
    beyond = 0.0
    if isinstance(specimen, Block):
        ends = sorted((specimen.width_mm / 2, specimen.depth_mm / 2))
        beyond = steps(field, *ends)
    return n**2 + 2 * n * around_it + n * beyond


def _steps(length: float, at: float, field: SizeField, size: Callable[[Array], Array]) -> float:
    """Count the steps of a line whose spacing follows ``size``."""
    places = _places(length, at, field)
    return max(2.0, float(np.trapezoid(1 / size(places), places)))


def _places(length: float, at: float, field: SizeField) -> Array:
    """Places from 0 to ``length``, closer around ``at``."""
    away = np.geomspace(0.1 * min(field.finest_mm, length), length, _SAMPLES)
    places = [at + away, at - away, np.array([0.0, at, length])]
    zones = (at + field.feature_mm, field.contact_mm)  # each of one size
    places += [end + away * sign for end in zones for sign in (1, -1)]
    every = np.unique(np.concatenate(places))
    return np.asarray(every[(every >= 0) & (every <= length)])


#: part of the machine's memory that one solution may take
_SHARE = 0.8

#: memory of a process before it has a mesh: numba, gmsh, scikit-fem, MKL
_LIBRARIES_MB = 190.0

#: unknowns per cell of a large mesh: (shape, order) by dimension; the second without pressures
_UNKNOWNS = {
    (2, "simplex", "quadratic"): (4.5, 4.0), (2, "simplex", "linear"): (3.5, 1.0),
    (2, "tensor", "quadratic"): (11.0, 8.0), (2, "tensor", "linear"): (3.0, 2.0),
    (3, "simplex", "quadratic"): (4.3, 4.1), (3, "simplex", "linear"): (3.7, 0.55),
    (3, "tensor", "quadratic"): (28.0, 24.0), (3, "tensor", "linear"): (4.0, 3.0),
}  # fmt: skip

#: elements over the height of a specimen between plates beyond which a unit is taken for mistaken
_MOST_ALONG = 20_000

#: largest mesh size tried, over the mesh size whose solution does not fit into memory
_LARGEST = 1e12


def memory_MB(unknowns: float, *, solid: bool) -> float:  # noqa: N802
    """Peak memory of a process that solves so many unknowns, its libraries included.

    Measured with quadratic elements and factors in single precision, linear ones take less: see
    ``test_memory_is_predicted``.
    """
    return float(_LIBRARIES_MB + (0.27e-3 * unknowns**1.3 if solid else 3e-3 * unknowns))


def too_large(unknowns: float, there_MB: float, *, solid: bool = True) -> str:  # noqa: N803
    """Say that a problem does not fit into memory; empty where it does.

    Examples
    --------
    >>> too_large(1e5, 16e3), too_large(5e6, 16e3)
    ('', 'about 5e+06 unknowns, which take 138 GB of 16 GB')
    """
    needed = memory_MB(unknowns, solid=solid)
    if needed <= _SHARE * there_MB:
        return ""
    needed_GB, there_GB = needed / 1e3, there_MB / 1e3  # noqa: N806
    return f"about {unknowns:.2g} unknowns, which take {needed_GB:.3g} GB of {there_GB:.3g} GB"


def machine_MB() -> float:  # noqa: N802
    """Memory of this machine; infinite where it is not told."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    except (AttributeError, ValueError, OSError):
        return float("inf")


def size_faults(setup: Setup) -> Iterator[Fault]:
    """Say where a mesh would need more memory than there is, and which size would fit."""
    height, size = height_of(setup.specimen), mesh_size(setup)
    there, solid = machine_MB(), setup.model.space == "3d"
    rule = too_large(expected_unknowns(setup), there, solid=solid)
    if not rule:
        if isinstance(setup.grading, TowardsPlates) and height > _MOST_ALONG * size:
            rule = f"{height:g} mm is {height / size:.3g} elements of {size:.3g} mm high"
            mend = f'write model.mesh_size = "{1.05 * height / _MOST_ALONG:.2g} mm" or more'
            yield Fault("specimen.height", rule, f"check the units, or {mend}")
        return

    def fits(middle: float) -> bool:
        sized = replace(setup, model=replace(setup.model, mesh_size_mm=middle))
        return not too_large(expected_unknowns(sized), there, solid=solid)

    low, high = size, max(size, height_of(setup.specimen))
    while not fits(high) and high < _LARGEST * size:  # of a thin specimen larger than its height
        high *= 2
    while high / low > 1.02:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if fits(middle) else (middle, high)
    mend = f'write mesh_size = "{1.05 * high:.2g} mm" or more'
    if isinstance(setup.specimen, Enclosed):
        mend += ", or check specimen.unit"
    yield Fault("model.mesh_size", f"{size:.3g} mm gives {rule}", mend)


def expected_unknowns(setup: Setup) -> float:
    """Unknowns that a mesh will have; within a factor of 1.5 where there are many."""
    if isinstance(setup.specimen, Enclosed):
        return inside(setup)
    model, grading = setup.model, setup.grading
    if isinstance(grading, AroundContact):
        cells = _under_indenter(setup, grading.indenter)
    else:
        cells = _between_plates(setup, grading)
    dim = 2 if model.space == "axisymmetric" else 3
    pair = _UNKNOWNS[(dim, model.element_shape, model.element_order)]
    return cells * pair[0 if model.formulation == "mixed" else 1]


#: Newton iterations of a load step, and of one of the many small ones of what sticks
_ITERATIONS = 4
_STICKING_ITERATIONS = 3

#: an iteration with linear elements over one with quadratic ones of as many unknowns, in a mesh
#: that is graded around an indenter: their matrices hold a third of the entries
_LINEAR = 0.5

#: an iteration in a body that a surface encloses over one in a quarter model of as many unknowns:
#: its top is curved, so that contact is found in more of them (2.1 to 3.1 measured under the flat
#: tip and the cone of designs/brain-phantom.toml)
_ENCLOSED = 2.6

#: seconds in which a mesh must be made and counted by a plan that looks at many
_PATIENCE_S = 0.5

#: seconds of that by who makes it: for any mesh, and for each unknown
_BY_LINES = (2e-3, 2.5e-6)
_BY_GMSH = {"axisymmetric": (6e-3, 6e-6), "3d": (4e-2, 2.6e-5)}

#: slenderness from which gmsh takes longer for each of them: 18 us at 2000, in a plane
_SLENDER = 50.0

#: counts that are kept
_COUNTS = 256


@dataclass(frozen=True)
class Estimate:
    """Predicted cost of one forward solve."""

    dofs: int
    #: Wall time on one thread, kernels compiled.
    seconds: float
    #: Peak memory of the factorization and the element arrays.
    memory_MB: float
    #: What counting the unknowns on their mesh was expected to take; 0 where it was not made.
    counting_s: float = 0.0


def estimate(setup: Setup, *, patience_s: float = _PATIENCE_S) -> Estimate:
    """Predict the cost of a problem from its unknowns and the measured cost of an iteration.

    The seconds are those of one of two workers that are both busy.
    """
    dofs = expected_unknowns(setup)
    counting_s = _counting_seconds(setup, dofs)
    if counting_s <= min(patience_s, _PATIENCE_S):
        test, model = replace(setup.test, steps=1), replace(setup.model, mesh_seed=None)
        dofs = _count(setup.specimen, test, model)
    else:
        counting_s = 0.0
    seconds = _load_steps(setup, height_of(setup.specimen)) * _iteration(setup, dofs)
    memory = memory_MB(dofs, solid=setup.model.space == "3d")
    return Estimate(int(dofs), float(seconds), memory, counting_s)


def _counting_seconds(setup: Setup, dofs: float) -> float:
    """Seconds that it takes to make a mesh and count its unknowns, whatever the machine does.

    That of a surface takes as long as its file asks for, and is known well enough without.
    """
    specimen = setup.specimen
    if isinstance(specimen, Enclosed):
        return float("inf")
    by_gmsh = isinstance(setup.grading, AroundContact) and setup.model.element_shape == "simplex"
    any_mesh, each = _BY_LINES
    if by_gmsh:
        any_mesh, each = _BY_GMSH[setup.model.space]
        height, half = specimen.height_mm, specimen.half_width_mm
        longest = max(height, equivalent_radius(specimen) ** 2 / half)
        each *= max(1.0, longest / min(height, half) / _SLENDER)
    return any_mesh + each * dofs


@functools.lru_cache(maxsize=_COUNTS)
def _count(specimen: Specimen, test: Test, model: Model) -> int:
    setup = Setup(specimen, test, model)
    return unknowns(setup, build_mesh(setup))


def _iteration(setup: Setup, dofs: float) -> float:
    """Seconds of a Newton iteration.

    Between plates 0.04 s at 21k axisymmetric and 0.5 s at 28k solid unknowns, by the powers
    1.2 and 1.95. Under an indenter, where meshes are graded and contact is looked for, 6 ms at
    2.9k axisymmetric, and 0.06 s at 5.5k, 0.15 s at 11k, 0.53 s at 27k quadratic solid unknowns.
    """
    solid, indented = setup.model.space == "3d", isinstance(setup.grading, AroundContact)
    if not solid:
        return float(2e-4 + 1.9e-6 * dofs if indented else 7e-4 + 0.04 * (dofs / 21e3) ** 1.2)
    if not indented:
        return float(0.5 * (dofs / 28e3) ** 1.95)
    share = 1.0 if setup.model.element_order == "quadratic" else _LINEAR
    if isinstance(setup.specimen, Enclosed):
        share *= _ENCLOSED
    return float(0.103 * share * (dofs / 8.2e3) ** 1.38)


def unknowns(setup: Setup, mesh: Mesh) -> int:
    """Free displacements and pressures of a problem on a mesh, without its element arrays."""
    basis = basis_of(mesh, setup.model, 1)
    held = constraints(setup, Nodes(basis.doflocs.T), mesh).dofs.size
    pressures = int(pressure_of(basis, setup.model)[1].max(initial=-1)) + 1
    return int(mesh.points.shape[1] * basis.N + pressures - held)


def _load_steps(setup: Setup, height_mm: float) -> float:
    """Newton iterations of a run: requested steps, each cut to what the step rule allows."""
    test = setup.test
    rule = setup.kind.steps(test, height_mm, StepSettings())
    targets = test.depth_mm * np.arange(1, test.steps + 1) / test.steps
    length = test.depth_mm / test.steps
    pieces = sum(np.ceil(length / rule.largest_mm(depth) - 1e-9) for depth in targets)
    pieces += test.weight_N_mm3 != 0  # the step in which the body sags
    sticking = any(isinstance(c, IndenterContact) and c.is_bonded for c in setup.contacts)
    return float(pieces * (_STICKING_ITERATIONS if sticking else _ITERATIONS))
