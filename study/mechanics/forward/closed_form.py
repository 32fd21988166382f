"""Closed form of homogeneous tests, such as compression between frictionless plates, and starts.

Force = area x nominal stress at the stretch 1 - d/H, or at that of the kind of test, positive in
the sense of the displacement, with the lateral stretch of the nearly incompressible material
where K is finite. The gradient with
respect to the constants is analytic, so a fit costs microseconds.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import Fault, InputError
from study.mechanics.forward.contact_law import Layer, force_law, gauss_points
from study.mechanics.material.energy import Compressibility
from study.mechanics.material.homogeneous import LOADINGS, loading_in
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Enclosed, Indenter, Specimen
from study.mechanics.setup.setup import Problem, Setup
from study.mechanics.setup.test_kind import course_of

if TYPE_CHECKING:
    from study.mechanics.solver.solution import Solution


def indentation(
    indenter: Indenter,
    depth_mm: Array,
    *,
    height_mm: float,
    poisson_ratio: float = 0.5,
    bonded: bool = True,
) -> Array:
    """Force over Young's modulus of an indented layer, mm^2, shape (n,).

    Examples
    --------
    A sphere on a high specimen follows Hertz, 16/9 sqrt(R) d^1.5:

    >>> from study.mechanics.setup.geometry import Sphere
    >>> force = indentation(Sphere(8.0), np.array([0.01]), height_mm=1e6)
    >>> float(force[0] / (16 / 9 * 8**0.5 * 0.01**1.5))
    1.000
    """
    deepest = float(depth_mm.max(initial=0.0))
    if not deepest > 0:
        return np.zeros(depth_mm.shape)
    law = force_law(indenter, Layer(height_mm, poisson_ratio, bonded), deepest)
    return law.force(depth_mm) / (1 - poisson_ratio**2)


def height_and_area(specimen: Specimen) -> tuple[float, float]:
    """Height in mm and cross-section in mm^2 of a specimen, the mean one of a surface."""
    if not isinstance(specimen, Enclosed):
        return specimen.height_mm, specimen.area_mm2
    from study.mechanics.surface.closed_surface import body

    solid = body(specimen)
    return solid.height_mm, solid.volume_mm3 / solid.height_mm


def homogeneous(
    specimen: Specimen,
    material: Material,
    displacement_mm: Array,
    mode: str = "uniaxial",
    sense: float = -1.0,
    prestretch: float | None = None,
) -> Curve:
    """Force of a specimen that deforms the same everywhere; displacement_mm (n,); returns MPa."""
    height, area = height_and_area(specimen)
    d = np.asarray(displacement_mm, dtype=float)
    _check_height(height, d, sense)
    loading = loading_in(mode, prestretch)
    state = loading.nominal(material, loading.measure(sense * d / height))
    gradient = {name: sense * area * slope for name, slope in state.gradient.items()}
    return Curve(d, sense * area * state.stress, force_gradient=gradient)


def over_time(setup: Setup, material: Material, displacement_mm: Array, time_s: Array) -> Curve:
    """Force of a specimen that deforms the same everywhere and relaxes."""
    # Shapes: displacement_mm, time_s (n,); returns N, MPa.
    # it loads compiled kernels
    from study.mechanics.material.viscoelasticity import relaxing

    height, area = height_and_area(setup.specimen)
    d, kind = np.asarray(displacement_mm, dtype=float), setup.kind
    _check_height(height, d, kind.sense)
    measure = LOADINGS[kind.mode].measure(kind.sense * d / height)
    state = relaxing(material, kind.mode, np.asarray(time_s, float), measure)
    factor = kind.sense * area
    gradient = {name: factor * slope for name, slope in state.gradient.items()}
    return Curve(d, factor * state.stress, force_gradient=gradient, time_s=time_s)


def at_rows(setup: Setup, material: Material, rows: Curve) -> Curve:
    """Force at the rows of another curve: over their times, at the test's speed, or elastic."""
    d = rows.displacement_mm
    if not material.relaxation:
        return replace(_elastic(setup, material, d), time_s=rows.time_s)
    if rows.time_s is not None:
        return over_time(setup, material, d, rows.time_s)
    if setup.test.speed_mm_per_s is None:
        raise InputError(_no_speed())
    begins = d.size > 0 and d[0] > 0
    ramp_mm = np.append(0.0, d) if begins else d
    course = over_time(setup, material, ramp_mm, ramp_mm / setup.test.speed_mm_per_s)
    return replace(course.at_points(np.arange(int(begins), ramp_mm.size)), time_s=None)


#: distance, in shares of the whole test, over which a tangent is taken: it is then exact to 1e-9
_TANGENT = 3e-5
#: places of each interval at which the force is integrated (Gauss and Legendre): exact to rounding
_PLACES = 8


def between_rows(setup: Setup, material: Material, displacement_mm: Array) -> Curve:
    """Force at increasing displacements, with what makes the curve right between them too.

    A curve of forces alone is drawn as chords: ten of them are a fifth of a percent off.

    Shapes: displacement_mm (n,).
    """
    d = np.asarray(displacement_mm, dtype=float)
    h = _TANGENT * d.max(initial=0.0)
    first, second = np.where(d > h, d - h, d + 2 * h), d + h
    node, weight = gauss_points(_PLACES)
    begin, width = np.append(0.0, d)[:-1], np.diff(d, prepend=0.0)
    inside = begin[:, None] + width[:, None] * (1 + node) / 2
    places = np.concatenate([d, first, second, inside.ravel()])
    rows_needed, inverse = np.unique(places, return_inverse=True)
    every = at_rows(setup, material, Curve(rows_needed, np.empty(0)))
    force, first_force, two, along = np.split(every.force_N[inverse], d.size * np.arange(1, 4))
    # at the unloaded end a parabola through two places ahead, else both neighbors
    tangent = np.where(d > h, two - first_force, 4 * two - first_force - 3 * force) / (2 * h)
    work = np.cumsum(along.reshape(inside.shape) @ weight * width / 2)
    return replace(every.at_points(inverse[: d.size]), stiffness_N_per_mm=tangent, work_Nmm=work)


def _elastic(setup: Setup, material: Material, d: Array) -> Curve:
    """Curve of a homogeneous test in which time does not matter."""
    kind, stretched = setup.kind, setup.test.prestretch
    return homogeneous(setup.specimen, material, d, kind.mode, kind.sense, stretched)


def _no_speed() -> Fault:
    rule = "is missing: a material that relaxes resists a fast test more than a slow one"
    return Fault("test.speed", rule, 'write speed = "10 mm/min", or name a column of time')


def _check_height(height: float, d: Array, sense: float) -> None:
    if sense < 0 and d.max(initial=0.0) >= height:
        rule = f"must stay below the height of the specimen ({height} mm), got {d.max():g} mm"
        raise InputError(Fault("test.displacement", rule, "measure or press less deep"))


def neo_hookean_start(
    setup: Setup, volume: Compressibility, displacement_mm: Array, force_N: Array
) -> dict[str, float]:
    """C10 (MPa) of the closed form that fits a measured curve best.

    The force is linear in C10 where Poisson's ratio is given, so one linear least squares
    step is the answer between frictionless plates; elsewhere it is close enough for a start.

    Shapes: displacement_mm, force_N (n,).
    """
    model = _force_per_C10(setup, volume, np.asarray(displacement_mm, dtype=float))
    c10 = float(model @ force_N / (model @ model))
    if not np.isfinite(c10) or c10 <= 0:
        rule = "the measured force does not resist (wrong sign?)"
        mend = "check measurements.sign and the force column"
        raise InputError(Fault("measurements", rule, mend))
    return {"C10": c10}


def _force_per_C10(setup: Setup, volume: Compressibility, d: Array) -> Array:  # noqa: N802
    """Force over C10 of a neo-Hookean specimen, mm^2, shape (n,): nearly, or exactly."""
    # a neo-Hookean solid of nearly the same Poisson's ratio, for the size of the modulus
    unit = Material("neo-hookean", {"C10": 1.0}, incompressible=True)
    if LOADINGS[setup.kind.mode].is_volumetric:  # the volume is all that changes
        unit = Material("neo-hookean", {"C10": 1.0}, volume.bulk_modulus_MPa, volume.poisson_ratio)
    pressed = setup.test.indenter
    if pressed is None:
        return _elastic(setup, unit, d).force_N
    nu, height, bonded = volume.poisson_ratio or 0.5, setup.height_mm, setup.test.base == "bonded"
    high, depth = np.inf if height is None else height, np.maximum(d, 0.0)
    per_modulus = indentation(pressed, depth, height_mm=high, poisson_ratio=nu, bonded=bonded)
    # E = 4 (1 + nu) C10
    force = 4 * (1 + nu) * per_modulus
    if height is None or d.max(initial=0.0) >= height:
        return force
    # an indenter as wide as the specimen is a plate, and none needs more force than that
    return np.minimum(force, homogeneous(setup.specimen, unit, d).force_N)


def solution(problem: Problem) -> Solution:
    """Answer of a gauge section: its curve at the steps of the test."""
    # it loads compiled kernels
    from study.mechanics.solver.solution import without_answer

    began = time.perf_counter()
    curve = _prescribed(problem)
    d, reached = curve.displacement_mm, np.isfinite(curve.force_N)
    if curve.stiffness_N_per_mm is not None:  # known a little further than the last row
        reached &= np.isfinite(curve.stiffness_N_per_mm)
    count = int(d.size if reached.all() else np.argmin(reached))
    rows_done = curve.at_points(np.arange(count))
    status, message = "converged", "closed form of a homogeneous deformation"
    if count < d.size:
        end = d[count - 1] if count else 0.0
        status, message = "unstable", f"the material has no equilibrium state beyond {end:.4g} mm"
    empty = without_answer(problem, status, message, time.perf_counter() - began)
    reached_mm = float(rows_done.displacement_mm[-1]) if count else 0.0
    return replace(empty, curve=rows_done, reached_mm=reached_mm, solver="closed form")


def _prescribed(problem: Problem) -> Curve:
    """Curve at the steps of a test, over the course that it prescribes where that matters."""
    setup, material, test = problem.setup, problem.material, problem.test
    course = course_of(test)
    if setup.kind.mode == "biaxial":
        rule = "biaxial is a test of measured stretches, which no displacement prescribes"
        raise InputError(Fault("test.kind", rule, 'calibrate it, or solve kind = "equibiaxial"'))
    if material.relaxation and course is None:
        raise InputError(_no_speed())
    if course is None:
        return between_rows(setup, material, np.linspace(0.0, test.depth_mm, test.steps + 1)[1:])
    displacement_mm, time_s = course
    if test.hold_s is None and test.cycles is None:  # a curve over displacement
        return between_rows(setup, material, displacement_mm)
    begun = Curve(np.append(0.0, displacement_mm), np.empty(0), time_s=np.append(0.0, time_s))
    path = at_rows(setup, material, begun)
    return path.at_points(np.arange(1, len(path)))
