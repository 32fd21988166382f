"""Whether a surface, a test and a model go together, before anything is meshed."""

from __future__ import annotations

import os
from collections.abc import Iterator

from study.errors import Fault
from study.forward.problem import Flat, Problem, Surface
from study.forward.surface import Body, body

#: part of the machine's memory that one solution may take
_SHARE = 0.8


def surface_faults(problem: Problem) -> list[Fault]:
    """Everything that speaks against a test of a specimen given as a surface.

    Raises
    ------
    InputError
        If the surface itself has faults.
    """
    if not isinstance(problem.specimen, Surface):
        return []
    wrong = list(_model(problem))
    if wrong:
        return wrong
    found = body(problem.specimen)
    wrong = [*_plates(problem, found), *_punch(problem)]
    return wrong or [*_size(problem)]


def _model(problem: Problem) -> Iterator[Fault]:
    model = problem.model
    if model.space == "axisymmetric":
        rule = "a surface from a file has no axis of symmetry that could be relied on"
        yield Fault("model.space", rule, 'write space = "3d"')
    if model.element_shape == "tensor":
        rule = "the inside of a surface is meshed with tetrahedra"
        yield Fault("model.element_shape", rule, 'write element_shape = "tetrahedron"')


def _plates(problem: Problem, found: Body) -> Iterator[Fault]:
    test, specimen = problem.test, problem.specimen
    clamped = isinstance(specimen, Surface) and specimen.clamp_below_mm is not None
    if not clamped and not found.touches("base"):
        rule = "no face of the specimen lies in the plane of its lowest point: nothing holds it"
        mend = "hold it with clamp_below, turn it with axis, or raise plate_tolerance"
        yield Fault("test.base", rule, mend)
    if test.kind == "compression" and test.interface == "bonded" and not found.touches("top"):
        rule = "no face of the specimen lies in the plane of its highest point: nothing to bond"
        mend = 'use interface = "frictionless", turn it with axis, or raise plate_tolerance'
        yield Fault("test.interface", rule, mend)


def _punch(problem: Problem) -> Iterator[Fault]:
    pressed = problem.test.indenter
    if problem.test.kind != "indentation" or not isinstance(pressed, Flat):
        return
    why = "a mesh of a surface has no line of nodes along the edge of a flat punch"
    if problem.test.interface == "bonded":
        yield Fault("test.interface", why, 'use interface = "frictionless" and an edge_radius')
    elif not pressed.edge_radius_mm:
        yield Fault("test.indenter.edge_radius", why, "round the edge, or use a block or cylinder")


def _size(problem: Problem) -> Iterator[Fault]:
    from study.forward.surface_mesh import expected_unknowns, surface_mesh_size

    size = surface_mesh_size(problem)
    unknowns = expected_unknowns(problem)
    rule = too_large(unknowns, machine_MB())
    if not rule:
        return
    coarser = size * (unknowns / _fitting(machine_MB())) ** (1 / 3)
    mend = f'write mesh_size = "{coarser:.2g} mm" or more, or check specimen.unit'
    yield Fault("model.mesh_size", f"{size:.3g} mm gives {rule}", mend)


def too_large(unknowns: float, memory_MB: float) -> str:  # noqa: N803
    """Say that a problem does not fit into memory; empty where it does.

    Examples
    --------
    >>> too_large(1e5, 16e3), too_large(5e6, 16e3)
    ('', 'about 5e+06 unknowns, which take 277 GB of 16 GB')
    """
    from study.forward.estimate import memory_3d_MB

    needed = memory_3d_MB(unknowns)
    if needed <= _SHARE * memory_MB:
        return ""
    needed_GB, there_GB = needed / 1e3, memory_MB / 1e3  # noqa: N806
    return f"about {unknowns:.2g} unknowns, which take {needed_GB:.3g} GB of {there_GB:.3g} GB"


def _fitting(memory_MB: float) -> float:  # noqa: N803
    """Most unknowns that fit into memory, by halving."""
    low, high = 1e3, 1e12
    while high / low > 1.01:
        middle = (low * high) ** 0.5
        low, high = (low, middle) if too_large(middle, memory_MB) else (middle, high)
    return low


def machine_MB() -> float:  # noqa: N802
    """Memory of this machine; infinite where it is not told."""
    try:
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e6
    except (AttributeError, ValueError, OSError):
        return float("inf")
