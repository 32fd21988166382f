"""Whether a surface, a test and a model go together, before anything is meshed."""

from __future__ import annotations

from collections.abc import Iterator

from study.errors import Fault
from study.forward.problem import Flat, Problem, Surface
from study.forward.surface import Body, body


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
    return [*_plates(problem, found), *_punch(problem)]


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
