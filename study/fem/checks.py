"""What a problem must satisfy before it is meshed."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from study.errors import Fault, InputError
from study.fem.cost import size_faults
from study.fem.mesh.solid import surface_faults
from study.material.homogeneous import UNIAXIAL
from study.material.stability import stability, stable_in
from study.setup.geometry import Enclosed, Surface
from study.setup.setup import Problem, Setup
from study.surface.surface import PLAUSIBLE_MM, body, height_of

#: no specimen of a testing machine is larger
LARGEST_MM = 1e4


def check(problem: Problem) -> None:
    """Refuse a problem that has no answer.

    Parameters
    ----------
    problem : Problem
        Everything in mm and MPa; a surface is read from its file.

    Raises
    ------
    InputError
        All faults at once.
    """
    faults = surface_faults(problem.setup)
    if faults:
        raise InputError(faults)
    faults = [*_material(problem), *_loading(problem.setup)] or [*size_faults(problem.setup)]
    doubts = [*_unit(problem.setup, doubted=bool(faults))]
    if faults or doubts:
        raise InputError([*doubts, *faults])


def _unit(setup: Setup, *, doubted: bool) -> Iterator[Fault]:
    """Say that a surface is in another unit: where it is absurdly large, or does not fit its test.

    A small one may be a spheroid of cells, and is believed while its test fits.
    """
    specimen = setup.specimen
    if not isinstance(specimen, Surface):
        return
    found = body(specimen)
    extent = float(np.ptp(found.points, axis=0).max())
    if extent > LARGEST_MM or (doubted and not PLAUSIBLE_MM[0] <= extent <= PLAUSIBLE_MM[1]):
        size, meant = f"{extent:.3g} mm large", "m" if extent < PLAUSIBLE_MM[0] else "mm"
        rule = f"the surface is {size} if its file is in {specimen.unit}"
        yield Fault("specimen.unit", rule, f'is the file in {meant}? Then write unit = "{meant}"')


def _material(problem: Problem) -> Iterator[Fault]:
    if problem.material.incompressible and problem.model.formulation == "displacement":
        mend = "use formulation = mixed, or a finite bulk_modulus or poisson_ratio"
        yield Fault("model.formulation", "needs a finite bulk modulus", mend)
    if problem.material.relaxation:
        rule = "is of a test in closed form: finite elements know no time"
        yield Fault("material.relaxation", rule, 'write specimen.shape = "homogeneous"')


def _loading(setup: Setup) -> Iterator[Fault]:
    """Say why the specimen cannot go through the test."""
    specimen = setup.specimen
    solid = body(specimen) if isinstance(specimen, Enclosed) else specimen
    return setup.kind.faults(setup.test, solid.height_mm, solid.half_width_mm)


def instability(problem: Problem) -> str:
    """Sentence about constants that are unstable within the test; empty where they are not.

    Only failure in uniaxial loading counts: the other modes are reached locally at most.

    Parameters
    ----------
    problem : Problem
        Its material is judged at the stretches of its test.
    """
    material, setup = problem.material, problem.setup
    if material.small_strain:
        return ""
    stretches = setup.kind.stretches(setup.test, height_of(setup.specimen))
    if stable_in(UNIAXIAL, material, stretches):
        return ""
    return stability(material, stretches).sentence
