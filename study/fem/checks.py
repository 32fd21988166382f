"""What a problem must satisfy before it is meshed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from study.errors import Fault, InputError
from study.fem.cost import size_faults
from study.fem.mesh.solid import surface_faults
from study.material.homogeneous import UNIAXIAL
from study.material.stability import stability, stable_in
from study.setup.geometry import Block, Cone, Cylinder, Flat, Sphere, Surface
from study.setup.setup import Problem
from study.surface.surface import body, height_of

#: range of stretches under an indenter in which a material must at least be stable
_UNDER_INDENTER = np.linspace(0.8, 1.2, 41)


def check(problem: Problem) -> None:
    """Refuse a problem that has no answer.

    Raises
    ------
    InputError
        All faults at once.
    """
    if isinstance(problem.specimen, Surface):
        faults = surface_faults(problem)
        if faults:
            raise InputError(faults)
    faults = [*_material(problem), *_depth(problem)]
    if problem.test.kind == "indentation":
        faults += [*_indenter(problem)]
    if not faults:
        faults = [*size_faults(problem)]
    if faults:
        raise InputError(faults)


def _material(problem: Problem) -> Iterator[Fault]:
    if problem.material.incompressible and problem.model.formulation == "displacement":
        mend = "use formulation = mixed, or a finite bulk_modulus or poisson_ratio"
        yield Fault("model.formulation", "needs a finite bulk modulus", mend)


def _depth(problem: Problem) -> Iterator[Fault]:
    depth, specimen = problem.test.displacement_mm, problem.specimen
    if depth >= height_of(specimen):
        rule = f"{depth:g} mm is not smaller than the specimen's height, {height_of(specimen):g} mm"
        yield Fault("test.displacement", rule, "press less deep")


def _indenter(problem: Problem) -> Iterator[Fault]:
    pressed, specimen = problem.test.indenter, problem.specimen
    if pressed is None:
        yield Fault("test.indenter", "an indentation needs an indenter", "give shape and radius")
        return
    if isinstance(pressed, Cone) and not 0 < pressed.half_angle_deg < 90:
        rule = f"{pressed.half_angle_deg:g} deg is not between 0 and 90 deg"
        yield Fault("test.indenter.half_angle", rule, "it is measured from the axis")
    if isinstance(pressed, Flat) and not 0 <= pressed.edge_radius_mm <= pressed.radius_mm:
        rule = f"{pressed.edge_radius_mm:g} mm is not between 0 and the radius"
        yield Fault("test.indenter.edge_radius", rule, "")
    reach, half = _reach(problem), _half_width(specimen)
    if reach > half:
        rule = f"the indenter touches up to {reach:g} mm from the axis, beyond {half:g} mm"
        yield Fault("test.indenter", rule, "use a smaller indenter or a wider specimen")


def _reach(problem: Problem) -> float:
    """Largest radius that the indenter can touch."""
    pressed, depth = problem.test.indenter, problem.test.displacement_mm
    if isinstance(pressed, Flat):
        return pressed.radius_mm
    if isinstance(pressed, Sphere):
        return float(np.sqrt(max(min(depth, pressed.radius_mm) * pressed.radius_mm, 0.0)))
    if isinstance(pressed, Cone):
        cone = depth * np.tan(np.radians(pressed.half_angle_deg)) + pressed.tip_radius_mm
        return float(min(cone, pressed.shaft_radius_mm or np.inf))
    return 0.0


def _half_width(specimen: Cylinder | Block | Surface) -> float:
    if isinstance(specimen, Cylinder):
        return specimen.radius_mm
    if isinstance(specimen, Block):
        return min(specimen.width_mm, specimen.depth_mm) / 2

    return body(specimen).half_width_mm


def instability(problem: Problem) -> str:
    """Sentence about constants that are unstable within the test; empty where they are not.

    Only failure in uniaxial loading counts: the other modes are reached locally at most.
    """
    material, specimen = problem.material, problem.specimen
    if material.small_strain:
        return ""
    stretches = _UNDER_INDENTER
    if problem.test.kind == "compression":
        stretches = np.linspace(1 - problem.test.displacement_mm / height_of(specimen), 1.0, 41)
    if stable_in(UNIAXIAL, material, stretches):
        return ""
    return stability(material, stretches).sentence
