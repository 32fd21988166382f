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

from study.arrays import Array
from study.curve import Curve
from study.errors import Fault, InputError
from study.forward import halfspace
from study.material.loading import LOADINGS
from study.material.material import Material
from study.setup.geometry import Specimen, Surface
from study.setup.material_section import MaterialSection
from study.setup.setup import Problem, ResolvedTables, Setup

if TYPE_CHECKING:  # it loads compiled kernels
    from study.fem.solver.solution import Solution

#: modes in which an incompressible material cannot move
_VOLUMETRIC = ("confined", "volumetric")


def height_and_area(specimen: Specimen) -> tuple[float, float]:
    """Height in mm and cross-section in mm^2 of a specimen, the mean one of a surface."""
    if not isinstance(specimen, Surface):
        return specimen.height_mm, specimen.area_mm2
    from study.surface.surface import body

    found = body(specimen)
    return found.height_mm, found.volume_mm3 / found.height_mm


def homogeneous(
    specimen: Specimen,
    material: Material,
    displacement_mm: Array,
    mode: str = "uniaxial",
    sense: float = -1.0,
) -> Curve:
    """Force of a specimen that deforms the same everywhere.

    Parameters
    ----------
    specimen : Specimen
        Its height and cross-section count.
    material : Material
        Of the specimen.
    displacement_mm : ndarray, shape (n,)
        Displacements from 0; below the height where they shorten the specimen.
    mode : str
        Deformation, one of :data:`study.material.loading.LOADINGS`: that of the kind of test.
    sense : {-1, 1}
        Whether a displacement shortens or lengthens the specimen: that of the kind of test.

    Returns
    -------
    Curve
        Force in the sense of the displacement, with ``force_gradient`` in N per MPa for every
        constant.

    Raises
    ------
    InputError
        If a displacement reaches the height of a specimen that is shortened.
    """
    height, area = height_and_area(specimen)
    d = np.asarray(displacement_mm, dtype=float)
    if sense < 0 and d.max(initial=0.0) >= height:
        rule = f"must stay below the height of the specimen ({height} mm), got {d.max():g} mm"
        raise InputError(Fault("test.displacement", rule, "measure or press less deep"))
    loading = LOADINGS[mode]
    state = loading.nominal(material, loading.measure(sense * d / height))
    gradient = {name: sense * area * slope for name, slope in state.gradient.items()}
    return Curve(d, sense * area * state.stress, force_gradient=gradient)


def compression(specimen: Specimen, material: Material, displacement_mm: Array) -> Curve:
    """Force of a cylinder or block compressed between frictionless plates."""
    return homogeneous(specimen, material, displacement_mm)


def neo_hookean_start(
    config: ResolvedTables, displacement_mm: Array, force_N: Array
) -> dict[str, float]:
    """C10 (MPa) of the closed form that fits a measured curve best.

    The force is linear in C10 where Poisson's ratio is given, so one linear least squares
    step is the answer between frictionless plates; elsewhere it is close enough for a start.
    """
    model = _force_per_C10(config, np.asarray(displacement_mm, dtype=float))
    c10 = float(model @ force_N / (model @ model))
    if not np.isfinite(c10) or c10 <= 0:
        raise InputError(
            Fault(
                "measurements",
                "the measured force does not resist (wrong sign?)",
                "check measurements.sign and the force column",
            )
        )
    return {"C10": c10}


def _force_per_C10(config: ResolvedTables, d: Array) -> Array:  # noqa: N802
    """Force over C10 of a neo-Hookean specimen, mm^2, shape (n,): nearly, or exactly."""
    # a neo-Hookean solid of nearly the same Poisson's ratio, for the size of the modulus
    unit = Material("neo-hookean", {"C10": 1.0}, incompressible=True)
    setup = Setup.of(config)
    mode = setup.kind.mode
    if mode in _VOLUMETRIC:  # the volume is all that changes
        volume = MaterialSection.of(config["material"]).compressibility
        unit = Material("neo-hookean", {"C10": 1.0}, volume.bulk_modulus_MPa, volume.poisson_ratio)
    pressed = setup.test.indenter
    if pressed is None:
        return homogeneous(setup.specimen, unit, d, mode, setup.kind.sense).force_N
    nu = MaterialSection.of(config["material"]).compressibility.poisson_ratio or 0.5
    height = setup.height_mm
    per_modulus = halfspace.indentation(
        pressed,
        np.maximum(d, 0.0),
        height_mm=np.inf if height is None else height,
        poisson_ratio=nu,
        bonded=setup.test.base == "bonded",
    )
    # E = 4 (1 + nu) C10
    force = 4 * (1 + nu) * per_modulus
    if height is None or d.max(initial=0.0) >= height:
        return force
    # an indenter as wide as the specimen is a plate, and none needs more force than that
    return np.minimum(force, compression(setup.specimen, unit, d).force_N)


def solution(problem: Problem) -> Solution:
    """Answer of a gauge section: its curve at the steps of the test.

    Parameters
    ----------
    problem : Problem
        With a homogeneous specimen.

    Returns
    -------
    Solution
        Converged, with gradients and no mesh; ``unstable`` where the material has no state.
    """
    # it loads compiled kernels
    from study.fem.solver.solution import without_answer

    began, test = time.perf_counter(), problem.test
    kind = problem.setup.kind
    d = np.linspace(0.0, test.depth_mm, test.steps + 1)[1:]
    curve = homogeneous(problem.specimen, problem.material, d, kind.mode, kind.sense)
    reached = np.isfinite(curve.force_N)
    count = int(d.size if reached.all() else np.argmin(reached))
    kept = Curve(
        d[:count],
        curve.force_N[:count],
        force_gradient={n: g[:count] for n, g in curve.force_gradient.items()},
    )
    status, message = "converged", "closed form of a homogeneous deformation"
    if count < d.size:
        end = d[count - 1] if count else 0.0
        status, message = "unstable", f"the material has no equilibrium state beyond {end:.4g} mm"
    empty = without_answer(problem, status, message, time.perf_counter() - began)
    reached_mm = float(kept.displacement_mm[-1]) if count else 0.0
    return replace(empty, curve=kept, reached_mm=reached_mm, solver="closed form")
