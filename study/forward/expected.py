"""Unknowns and memory of a problem from its sizes alone, before anything is meshed.

A mesh size with a wrong unit would fill the machine while it is meshed. Here the density of
elements is integrated, so that a mesh of any number of cells is judged in milliseconds.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from study.errors import Fault
from study.forward.graded import UNDER_CONE, sizes_of
from study.forward.mesh import mesh_size
from study.forward.problem import Block, Cone, Flat, Problem, Specimen, Surface
from study.forward.punched import BULGE, CORE, around, has_room, inward
from study.forward.sizes import SizeField
from study.forward.structured import CORNER_FRACTION, GROWTH, equivalent_radius

Array = NDArray[np.float64]

#: part of the machine's memory that one solution may take
_SHARE = 0.8
#: memory of a process before it has a mesh: numba, gmsh, scikit-fem, MKL
_LIBRARIES_MB = 190.0
#: cells of gmsh in a square or a cube of one size
_PER_SQUARE, _PER_CUBE = 2.4, 5.3
#: unknowns per cell of a large mesh: (shape, order) by dimension; the second without pressures
_UNKNOWNS = {
    (2, "simplex", "quadratic"): (4.5, 4.0), (2, "simplex", "linear"): (3.5, 1.0),
    (2, "tensor", "quadratic"): (11.0, 8.0), (2, "tensor", "linear"): (3.0, 2.0),
    (3, "simplex", "quadratic"): (4.3, 4.1), (3, "simplex", "linear"): (3.7, 0.55),
    (3, "tensor", "quadratic"): (28.0, 24.0), (3, "tensor", "linear"): (4.0, 3.0),
}  # fmt: skip
#: places at which sizes are looked at, on each side of a feature
_SAMPLES = 80


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


def size_faults(problem: Problem) -> Iterator[Fault]:
    """Say where a mesh would need more memory than there is, and which size would fit."""
    there, solid = machine_MB(), problem.model.space == "3d"
    rule = too_large(expected_unknowns(problem), there, solid=solid)
    if not rule:
        return
    size = mesh_size(problem)
    low, high = size, problem.specimen.height_mm
    while high / low > 1.02:
        middle = (low * high) ** 0.5
        finer = replace(problem, model=replace(problem.model, mesh_size_mm=middle))
        fits = not too_large(expected_unknowns(finer), there, solid=solid)
        low, high = (low, middle) if fits else (middle, high)
    mend = f'write mesh_size = "{1.05 * high:.2g} mm" or more'
    if isinstance(problem.specimen, Surface):
        mend += ", or check specimen.unit"
    yield Fault("model.mesh_size", f"{size:.3g} mm gives {rule}", mend)


def expected_unknowns(problem: Problem) -> float:
    """Unknowns that a mesh will have; within a factor of 1.5 where there are many."""
    if isinstance(problem.specimen, Surface):
        from study.forward.surface_mesh import expected_unknowns as inside

        return inside(problem)
    model = problem.model
    compressed = problem.test.kind == "compression"
    cells = _between_plates(problem) if compressed else _under_indenter(problem)
    dim = 2 if model.space == "axisymmetric" else 3
    pair = _UNKNOWNS[(dim, model.element_shape, model.element_order)]
    return cells * pair[0 if model.formulation == "mixed" else 1]


def _between_plates(problem: Problem) -> float:
    """Cells of a structured mesh: see :func:`study.forward.mesh.compressed_mesh`."""
    test, specimen, h = problem.test, problem.specimen, mesh_size(problem)
    bonded = [plate == "bonded" for plate in (test.interface, test.base)]
    half = specimen.height_mm / 2
    high = sum(_line(half, h, graded=plate) for plate in bonded)
    if bonded[0] == bonded[1]:
        high /= 2  # the half above the middle plane
    simplex, rim = problem.model.element_shape == "simplex", any(bonded)
    radius = equivalent_radius(specimen)
    if problem.model.space == "axisymmetric":
        return high * _line(radius, h, graded=rim) * (2 if simplex else 1)
    if isinstance(specimen, Block):
        plane = _line(specimen.width_mm / 2, h, graded=rim)
        plane *= _line(specimen.depth_mm / 2, h, graded=rim)
        return high * plane * (6 if simplex else 1)
    if not simplex:
        return high * _disc(_line(radius / 2, h, graded=False), _line(radius, h, graded=rim))
    # ring k of triangles carries segments of the size h, see quarter_disc
    inner = np.pi * radius**2 / (2 * h**2)
    extra = _line(radius, h, graded=rim) - radius / h
    return high * 3 * (inner + np.pi * radius / h * extra)


def _line(length: float, h: float, *, graded: bool) -> float:
    """Count the steps of :func:`study.forward.structured.graded_line`."""
    if not graded:
        return max(1.0, length / h)
    coarse = min((1 - CORNER_FRACTION) * h / GROWTH, length)
    return float(np.log1p(GROWTH * coarse / (CORNER_FRACTION * h)) / GROWTH + (length - coarse) / h)


def _disc(inner: float, line: float) -> float:
    """Quadrilaterals of a quarter disc: a square of half the radius, two blocks around it."""
    return inner**2 + 2 * inner * max(line - inner, 1.0)


def _under_indenter(problem: Problem) -> float:
    """Cells of a graded mesh: see :func:`study.forward.graded.indentation_mesh`."""
    specimen, field = problem.specimen, sizes_of(problem)
    radius, flat = equivalent_radius(specimen), problem.model.space == "axisymmetric"
    if problem.model.element_shape == "tensor":
        return _grid(problem, field, radius)
    rho = _places(radius, field.ring_mm, field)
    z = specimen.height_mm - _places(specimen.height_mm, 0.0, field)
    h = field.at(*(a.ravel() for a in np.meshgrid(rho, z))).reshape(z.size, rho.size)
    density = np.asarray(1 / h**2 if flat else np.pi / 2 * rho / h**3)
    total = abs(float(np.trapezoid(np.trapezoid(density, rho, axis=1), z)))
    return (_PER_SQUARE if flat else _PER_CUBE) * total


def _grid(problem: Problem, field: SizeField, radius: float) -> float:
    """Quadrilaterals or hexahedra between lines."""
    specimen, pressed = problem.specimen, problem.test.indenter
    wide, tall = UNDER_CONE[problem.model.element_order] if isinstance(pressed, Cone) else (1, 1)
    top = np.array([field.top_mm])

    def along_top(length: float) -> float:
        return _steps(length, field.ring_mm, field, lambda rho: wide * field.at(rho, top))

    def along_axis(depth: Array) -> Array:
        return tall * field.at(np.full(depth.shape, field.ring_mm), field.top_mm - depth)

    high = _steps(specimen.height_mm, 0.0, field, along_axis)
    solid = problem.model.space == "3d"
    if solid and isinstance(pressed, Flat) and has_room(specimen, field.ring_mm):
        return high * _rings(specimen, field)
    if problem.model.space == "axisymmetric":
        return high * along_top(radius)
    if isinstance(specimen, Block):
        return high * along_top(specimen.width_mm / 2) * along_top(specimen.depth_mm / 2)
    return high * _disc(along_top(radius / 2), along_top(radius))


def _rings(specimen: Specimen, field: SizeField) -> float:
    """Quadrilaterals of :func:`study.forward.punched.punched` over a cross-section."""
    n, ring = around(field), field.ring_mm
    half = equivalent_radius(specimen)
    if isinstance(specimen, Block):  # the mean of where rays meet a square
        half = 0.56 * min(specimen.width_mm, specimen.depth_mm)
    core = 0.5 * (1 + BULGE) * CORE * ring

    def steps(own: SizeField, start: float, end: float) -> float:
        places = np.unique(np.clip(_places(end, ring, own), start, end))
        return float(np.trapezoid(1 / own.at(places, own.top_mm), places))

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
    kept = [at + away, at - away, np.array([0.0, at, length])]
    kept += [edge + away * sign for edge in _edges(field, at) for sign in (1, -1)]
    every = np.unique(np.concatenate(kept))
    return np.asarray(every[(every >= 0) & (every <= length)])


def _edges(field: SizeField, at: float) -> tuple[float, ...]:
    """Distances where a zone of one size ends."""
    return (at + field.feature_mm, field.contact_mm)
