"""Checks of what is written against what can exist; all of them before anything is computed."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from functools import lru_cache

from study.external.forward_model import ForwardCell
from study.ground.declaration import Faults, is_known, values_of
from study.mechanics.material.homogeneous import LOADINGS
from study.mechanics.material.material import ENERGIES, Material
from study.mechanics.material.stability import PLAUSIBLE_MU0, stability, surface_warning
from study.mechanics.setup.geometry import (
    Cone,
    Enclosed,
    Flat,
    Homogeneous,
    Indenter,
    Specimen,
    Sphere,
)
from study.mechanics.setup.material_section import MaterialSection
from study.mechanics.setup.setup import Model, Setup
from study.mechanics.setup.test_kind import (
    NEVER_BUCKLES,
    TEST_KINDS,
    PlateMotion,
    beyond_height,
    buckling_strain,
    unresolved_contact,
)
from study.simulation.cell import CellProblem

#: place of a fault in the tables of a problem, such as ``"test.kind"``; rule and mend
Broken = Iterator[tuple[str, str, str]]


def check(problem: CellProblem, faults: Faults, places: Mapping[str, str]) -> None:
    """Check the sections of a problem against one another."""
    checks = (_moduli_broken, _displacement, _gauge_section, _course, _model, _motion, _markers,
              _indenter, _closed_form)  # fmt: skip
    for broken in checks:
        for where, rule, mend in broken(problem):
            table, dot, key = where.partition(".")
            faults.add(f"{places[table]}{dot}{key}", rule, mend)


def _motion(problem: CellProblem) -> Broken:
    moves = isinstance(TEST_KINDS.get(problem.test.kind), PlateMotion)
    if problem.test.motion is not None and not moves:
        rule = f"a {problem.test.kind} moves along its axis alone"
        yield "test.motion", rule, 'write kind = "plate-motion", or leave it out'
    if moves and problem.specimen.shape not in (None, "block"):
        rule = f"plate-motion is modelled on a block, not on a {problem.specimen.shape}"
        yield "test.kind", rule, 'write specimen.shape = "block"'
    if moves and problem.model.space == "axisymmetric":
        rule = "a plate that moves sideways leaves no axis of symmetry"
        yield "model.space", rule, 'write space = "3d"'


def initial_shear_modulus(material: MaterialSection) -> float | None:
    """mu0 of a material, the initial shear modulus, MPa."""
    constants = material.constants
    if not constants or any(math.isnan(v) for v in constants.values()):
        return None
    energy = ENERGIES[material.model]
    mu0 = energy.initial_shear_modulus(constants, material.compressibility)
    # a linear solid with E > 9 K is refused for its Poisson's ratio below -1
    return None if energy.small_strain and not 0 < mu0 < math.inf else mu0


def _moduli_broken(problem: CellProblem) -> Broken:
    material = problem.material
    mu0, bulk = initial_shear_modulus(material), material.compressibility.bulk_modulus_MPa
    if mu0 is not None and mu0 <= 0:
        formula = ENERGIES[material.model].shear_modulus_formula
        rule = f"the initial shear modulus {formula} must be positive, got {mu0 * 1e3:g} kPa"
        key = next(iter(material.constants), "")
        yield f"material.{key}", rule, "check the signs of the constants"
    elif mu0 is not None and bulk is not None and bulk < mu0:
        rule = f"{bulk * 1e3:g} kPa is below the initial shear modulus, {mu0 * 1e3:g} kPa"
        yield "material.bulk_modulus", rule, "check the units (MPa, kPa) of both"


def _displacement(problem: CellProblem) -> Broken:
    height, kind = problem.height_mm, TEST_KINDS.get(problem.test.kind)
    has_end = kind is None or kind.sense <= 0  # what is lengthened has none
    if has_end and problem.test.displacement_mm is not None and height is not None:
        for fault in beyond_height(problem.test, height):
            yield fault.where, fault.rule, fault.mend


def _gauge_section(problem: CellProblem) -> Broken:
    """Keep tests of material to specimens that deform the same everywhere."""
    test, is_gauge = problem.test, isinstance(problem.specimen, Homogeneous)
    kind = TEST_KINDS.get(test.kind)
    if kind is None or problem.specimen.shape is None:
        return
    if kind.needs_homogeneous and not is_gauge:
        rule = f"{test.kind} is a test of a gauge section, not of a {problem.specimen.shape}"
        yield "test.kind", rule, 'write specimen.shape = "homogeneous"'
    if is_gauge and problem.test.gravity is not None:
        rule = "acts on a specimen of elements; a gauge section deforms the same everywhere"
        yield "test.gravity", rule, "leave it out, or give the specimen's shape and size"
    if is_gauge and kind.takes_indenter:
        rule = f"{test.kind} does not deform a specimen the same everywhere"
        yield "test.kind", rule, "give the specimen's shape and size"
    if is_gauge and "bonded" in (test.interface, test.base) and not kind.takes_indenter:
        rule = "bonded faces do not let a specimen deform the same everywhere"
        yield "test.interface", rule, "leave it out, or give a cylinder or block"
    energy = ENERGIES.get(problem.material.model)
    if energy is not None and not energy.splits and not is_gauge:
        rule = f"{energy.name} has no isochoric part that finite elements could take for itself"
        mend = 'write specimen.shape = "homogeneous", with area and length, or another energy'
        yield "material.model", rule, mend
    if test.prestretch is not None:
        if not kind.shears:
            rule = f"belongs to a simple shear, not to {test.kind}"
            yield "test.prestretch", rule, "leave it out"
        elif problem.material.relaxation:
            rule = "would relax as well, and nobody knows since when"
            yield "test.prestretch", rule, "leave it out, or the relaxation"
    rigid = kind.needs_homogeneous and LOADINGS[kind.mode].is_volumetric
    if rigid and problem.material.compressibility.incompressible:
        rule = f"{test.kind} of an incompressible material has no displacement"
        yield "material.incompressible", rule, "give poisson_ratio instead"


def _course(problem: CellProblem) -> Broken:
    """Check what a course in time needs, and that something knows what to do with one."""
    test, relaxes = problem.test, bool(problem.material.relaxation)
    timed = problem.measurements is not None and problem.measurements.columns.time is not None
    course = {"speed": test.speed_mm_per_s, "hold": test.hold_s, "cycles": test.cycles}
    given = [f"test.{key}" for key, value in course.items() if value]
    courses = [*given, *["material.relaxation"] * relaxes, *["measurements.columns.time"] * timed]
    if courses and problem.specimen.shape not in (None, "homogeneous"):
        rule = "is of a test in closed form: finite elements know no time"
        mend = 'write specimen.shape = "homogeneous", with area and length, or leave it out'
        yield courses[0], rule, mend
        return
    if relaxes and problem.forward is not None and problem.forward.model != "closed-form":
        rule = f"is no part of what {problem.forward.model} is told of a material"
        yield "material.relaxation", rule, "give it in [parameters]"
    if timed and given:
        rule = "stands beside a column of time, which says how the test went"
        yield given[0], rule, "leave it out"
    elif (relaxes and not timed or given) and not test.speed_mm_per_s:
        rule = "is missing: a material that relaxes resists a fast test more than a slow one"
        if not relaxes:
            rule = "is missing: what is held or repeated has a speed"
        yield "test.speed", rule, 'write speed = "10 mm/min", or name a column of time'
    if test.hold_s and test.cycles:
        mend = "give one of the two, and the other in a test of its own"
        yield "test.cycles", "stands beside hold", mend


def _markers(problem: CellProblem) -> Broken:
    """Keep markers to the test whose plate can be fitted to them, by our own model."""
    if problem.markers is None:
        return
    if not isinstance(TEST_KINDS.get(problem.test.kind), PlateMotion):
        rule = "markers tell how a plate moved, which only a plate-motion lets be fitted"
        yield "markers", rule, 'write test.kind = "plate-motion"'
    if problem.measurements is not None or problem.forward is not None:
        rule = "stands beside measurements or forward, which it cannot be scored together with"
        yield "markers", rule, "give the curves, or the other model, a design of its own"
    if not problem.material.constants and problem.material.model:
        rule = "tells of displacements, which give no constants, and [material] has none"
        yield "markers", rule, 'give them, for example C10 = "2.5 kPa"'


def _model(problem: CellProblem) -> Broken:
    model, is_surface = problem.model, isinstance(problem.specimen, Enclosed)
    if problem.material.compressibility.incompressible and model.formulation == "displacement":
        rule = "the displacement formulation cannot hold the volume of an incompressible material"
        yield "model.formulation", rule, 'write formulation = "mixed"'
    if is_surface and model.space == "axisymmetric":
        rule = "a surface from a file has no axis of symmetry that could be relied on"
        yield "model.space", rule, 'write space = "3d"'
    if is_surface and model.element_shape == "tensor":
        rule = "the inside of a surface is meshed with tetrahedra"
        mend = 'write element_shape = "tetrahedron"'
        yield "model.element_shape", rule, mend


def _indenter(problem: CellProblem) -> Broken:
    indenter = problem.test.indenter
    if indenter is None or not is_known(
        *(v for k, v in values_of(indenter).items() if k != "shaft_radius_mm")
    ):
        return
    for fault in indenter.faults():
        yield fault.where, fault.rule, fault.mend
    half = half_width(problem.specimen)
    reach = footprint(indenter, problem.test.displacement_mm)
    if half is not None and reach is not None and reach >= half:
        key = "half_angle" if isinstance(indenter, Cone) else "radius"
        rule = f"the indenter is {reach:g} mm wide from its axis, the specimen {half:g} mm"
        yield f"test.indenter.{key}", rule, "it must stay inside the top face at full depth"


def _closed_form(problem: CellProblem) -> Broken:
    is_closed_form = problem.forward is not None and problem.forward.model == "closed-form"
    if is_closed_form and is_known(problem.test.kind) and not problem.is_homogeneous:
        rule = "closed-form needs a test that deforms the specimen the same everywhere"
        mend = 'write test.interface = "frictionless", or another forward.model'
        yield "forward.model", rule, mend


def check_stability(problem: CellProblem, faults: Faults) -> None:
    """Refuse given constants that Drucker's criterion refutes on the way to full compression."""
    # Only what is solved as it stands is judged: constants that start a fit may be worse.
    depth, height = problem.test.displacement_mm, problem.height_mm
    given = tuple(problem.material.constants.items())
    mu0 = initial_shear_modulus(problem.material)
    if faults or not given or mu0 is None or not TEST_KINDS[problem.test.kind].compresses:
        return
    if depth is None or height is None or depth >= height:
        return
    nu = problem.material.compressibility.poisson_ratio
    sentence = _unstable(problem.material.model, given, 1 - depth / height, nu)
    if sentence:
        faults.add("material", sentence, f"give constants stable to stretch {1 - depth / height:g}")


@lru_cache(maxsize=1024)
def _unstable(
    model: str, constants: tuple[tuple[str, float], ...], stretch: float, nu: float | None
) -> str:
    """Verdict on uniaxial loading down to a stretch; empty if it is stable."""
    # K enters where the volume change belongs to all of the energy, and nowhere else
    material = Material(model, dict(constants), poisson_ratio=0.4 if nu is None else nu)
    verdict = stability(material, [stretch, 1.0])
    return verdict.sentence if "uniaxial" in verdict.limits else ""


def half_width(specimen: Specimen) -> float | None:
    """Distance from the axis of a specimen to its nearest side, mm."""
    if isinstance(specimen, Enclosed) or not is_known(*values_of(specimen).values()):
        return None
    return specimen.half_width_mm


def footprint(indenter: Indenter, depth: float | None) -> float | None:
    """Radius of the indenter in the plane of the undeformed top face, at full depth, mm."""
    # A cone with a spherical tip of radius r touches the sphere at r (1 - sin a) above its lowest
    # point, where it is r cos a wide; above, its width grows with tan a up to the shaft.
    if isinstance(indenter, Flat):
        return indenter.radius_mm
    if depth is None:
        return None
    if isinstance(indenter, Sphere):
        radius = indenter.radius_mm
        return radius if depth >= radius else math.sqrt(depth * (2 * radius - depth))
    angle, tip = math.radians(indenter.half_angle_deg), indenter.tip_radius_mm
    join = tip * (1 - math.sin(angle))
    if depth < join:
        return math.sqrt(depth * (2 * tip - depth))
    wide = tip * math.cos(angle) + (depth - join) * math.tan(angle)
    shaft = indenter.shaft_radius_mm
    return wide if shaft is None else min(wide, shaft)


#: share of the compression by Euler's load above which a column is cautioned about
CLOSE_TO_BUCKLING = 0.9


def cautions_of(problem: ForwardCell) -> tuple[str, ...]:
    """Cautions of what a cell computes; of a stranger's program nothing is known to be unusual."""
    if not isinstance(problem, CellProblem):
        return ()
    setup, material = problem.setup, problem.material
    contact = unresolved_contact(setup.test, setup.model.mesh_size_mm)
    return (
        *_moduli(material),
        *_sizes(setup.specimen, setup.model),
        *([f"model.mesh_size: {contact}"] if contact else []),
        *_depth(setup, material),
    )


def _moduli(material: MaterialSection) -> Iterator[str]:
    """Moduli that no tissue or silicone has: a unit may be wrong."""
    mu0 = initial_shear_modulus(material)
    low, high = PLAUSIBLE_MU0
    if mu0 is not None and not low <= mu0 <= high:
        yield (
            f"material: an initial shear modulus of {mu0 * 1e3:.4g} kPa is outside {low * 1e3:g} "
            f"to {high * 1e3:g} kPa, the window of tissue and silicone: is the unit right?"
        )


def _depth(setup: Setup, material: MaterialSection) -> Iterator[str]:
    """Compression beyond which the free surface is no longer smooth."""
    height, depth = setup.height_mm, setup.test.displacement_mm
    if setup.kind.compresses and height is not None and depth is not None:
        energy = ENERGIES[material.model]
        if warning := surface_warning(energy, setup.kind.mode, 1 - depth / height):
            yield f"test.displacement: {warning}"
        critical = buckling_strain(setup.test, setup.specimen)
        if critical is not None and depth >= CLOSE_TO_BUCKLING * critical * height:
            hidden = "a model of its quarter is asked for the sway that it cannot make"
            if setup.model.space == "axisymmetric":
                hidden = "a model with an axis of symmetry cannot sway"
            hidden = f"{hidden}: study solve --follow goes on from there"
            if energy.small_strain:
                hidden = NEVER_BUCKLES
            yield (
                f"test.displacement: a column of this slenderness buckles at about "
                f"{critical * height:.3g} mm (Euler's load), and "
                f"{depth:.4g} mm are asked for; {hidden}"
            )


#: sizes of specimens that anybody tests, mm: 0.1 mm to 1 m
PLAUSIBLE_MM = (0.1, 1000.0)


def _sizes(specimen: Specimen, model: Model) -> Iterator[str]:
    """Sizes that no specimen has, and elements as large as it; a surface has its own check."""
    half, height = half_width(specimen), getattr(specimen, "height_mm", None)
    if half is None or height is None or isinstance(specimen, Homogeneous):
        return
    low, high = PLAUSIBLE_MM
    for size in (2 * half, height):
        if not low <= size <= high:
            yield (
                f"specimen: {size:g} mm is no usual size of a specimen ({low:g} to {high:g} mm): "
                "is the unit right?"
            )
    least = min(half, height)
    if model.mesh_size_mm is not None and model.mesh_size_mm > least:
        yield (
            f"model.mesh_size: {model.mesh_size_mm:g} mm is larger than the specimen "
            f"({least:g} mm from its axis or along it): a single element answers"
        )
