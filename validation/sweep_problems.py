"""Random forward problems: wide in shape, depth, indenter, material and element, yet affordable.

Problem ``number`` of a seed is always the same one, however many are asked for. Elements come
in turn, everything else is drawn; what would take too long, and what the program refuses by
itself, is drawn again.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from study.ground.errors import InputError
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import mesh_size
from study.mechanics.setup.geometry import Block, Cone, Cylinder, Flat, Indenter, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Interface, StepSettings, Test
from study.mechanics.solver.finite_element_solution import check, instability
from study.mechanics.solver.solution_cost import expected_unknowns

Generator = np.random.Generator

#: space, order and shape of every mixed element
ELEMENTS = tuple(
    Model(space, order, shape)
    for order in ("linear", "quadratic")
    for shape in ("simplex", "tensor")
    for space in ("axisymmetric", "3d")
)
#: load steps that are compared
STEPS = 6
#: unknowns of a problem and of its reference, by space
MOST_UNKNOWNS = {"axisymmetric": 4e3, "3d": 5e3}
REFERENCE_UNKNOWNS = {"axisymmetric": 2.5e4, "3d": 2.2e4}
#: unknowns up to which a reference is refined further, and the fine mesh's size over its own
ENOUGH_UNKNOWNS, FINEST = 8e3, 4.0
#: load steps that the step rule makes of them, by space
MOST_PIECES = {"axisymmetric": 90, "3d": 45}
#: sizes of a mesh over the coarse one, of those that are too large otherwise
_COARSER = (1.0, 1.25, 1.6, 2.0)
_TRIES = 10_000


def drawn(seed: int, number: int) -> Problem:
    """Draw problem ``number``, counted from 0.

    Raises
    ------
    RuntimeError
        If no affordable problem is found, which says that the limits fit no problem.
    """
    rng = np.random.default_rng([seed, number])
    model = ELEMENTS[number % len(ELEMENTS)]
    for _ in range(_TRIES):
        problem = affordable(_any(rng, model), rng)
        if problem is not None:
            return problem
    raise RuntimeError(f"no affordable problem in {_TRIES} tries")


def affordable(problem: Problem, rng: Generator) -> Problem | None:
    """Problem on its coarse or medium mesh, or a coarser one; None where none is affordable."""
    try:
        check(problem)
    except InputError:
        return None
    space = problem.model.space
    if instability(problem) or pieces(problem) > MOST_PIECES[space]:
        return None
    if rng.random() < 0.5:
        medium = with_mesh(problem, "medium")
        if expected_unknowns(medium.setup) < MOST_UNKNOWNS[space]:
            return medium
    coarse = with_mesh(problem, "coarse")
    size = mesh_size(coarse.setup)
    for factor in _COARSER:
        wider = coarse if factor == 1 else sized(coarse, factor * size)
        if expected_unknowns(wider.setup) < MOST_UNKNOWNS[space]:
            return wider
    return None


def with_mesh(problem: Problem, name: str) -> Problem:
    """Copy a problem with a named mesh."""
    model = replace(problem.model, mesh=name, mesh_size_mm=None)  # type: ignore[arg-type]
    return replace(problem, model=model)


def sized(problem: Problem, size_mm: float) -> Problem:
    """Copy a problem with a mesh of three digits' size."""
    model = replace(problem.model, mesh_size_mm=float(f"{size_mm:.3g}"))
    return replace(problem, model=model)


def pieces(problem: Problem) -> int:
    """Load steps that the step rule makes of those that are asked for.

    Those of what sticks are many and short; eight count as one, so that no such problem is left
    out for them.
    """
    test, usual = problem.test, StepSettings()
    settings = replace(usual, sticking=usual.held_face)
    specimen: Any = problem.specimen
    rule = problem.setup.kind.steps(problem.test, specimen.height_mm, settings)
    length = test.depth_mm / test.steps
    depths = length * np.arange(1, test.steps + 1)
    return int(sum(math.ceil(length / rule.largest_mm(float(d)) - 1e-9) for d in depths))


def references(problem: Problem) -> list[Problem]:
    """Finer problems with the same answer, the best one first.

    A cylinder is axisymmetric, so its reference is: quadratic elements of another shape than
    the problem's own where that is quadratic in the plane too. A block has quadratic
    solid elements, as fine as they are affordable.
    """
    flat = isinstance(problem.specimen, Cylinder)
    own = problem.model
    shapes = ["simplex", "tensor"]
    if flat and own.space == "axisymmetric" and own.element_order == "quadratic":
        shapes.sort(key=lambda shape: shape == own.element_shape)
    found = []
    for shape in shapes:
        model = Model("axisymmetric" if flat else "3d", "quadratic", shape, mesh="fine")  # type: ignore[arg-type]
        found.append(_finest(replace(problem, model=model)))
    return found


def _finest(problem: Problem) -> Problem:
    """Problem on two thirds of the fine mesh's size, or finer, or the finest that is affordable.

    At a sharp edge no finer than that: the smaller an element is there, the sooner it collapses.
    """
    fine, most = mesh_size(problem.setup), REFERENCE_UNKNOWNS[problem.model.space]
    size = fine / 1.5
    while expected_unknowns(sized(problem, size).setup) > most:
        size *= 1.1
    pressed = problem.test.indenter
    if pressed is not None and pressed.is_sharp_edged:
        return sized(problem, size)
    while (
        size > fine / FINEST
        and expected_unknowns(sized(problem, size / 1.1).setup) < ENOUGH_UNKNOWNS
    ):
        size /= 1.1
    return sized(problem, size)


# One draw


def _any(rng: Generator, model: Model) -> Problem:
    """Problem within the ranges, be it affordable or not."""
    ratio, length = _log(rng, 0.2, 5), _log(rng, 5, 30)
    radius, height = _digits(length * math.sqrt(ratio)), _digits(length / math.sqrt(ratio))
    specimen: Cylinder | Block = Cylinder(radius, height)
    if model.space == "3d" and rng.random() < 0.5:
        depth = _digits(2 * radius * rng.uniform(1, 1.7))
        specimen = Block(2 * radius, depth, height)
    compressed = rng.random() < 0.35
    test = _compression(rng, height) if compressed else _indentation(rng, radius, height)
    return Problem(specimen, test, _material(rng), model)


def _compression(rng: Generator, height: float) -> Test:
    interface = _interface(rng)
    base = interface if rng.random() < 0.75 else _interface(rng)
    depth = _digits(height * rng.uniform(0.05, 0.5))
    return Test("compression", depth, interface, base, STEPS)


def _indentation(rng: Generator, radius: float, height: float) -> Test:
    base: Interface = "bonded" if rng.random() < 0.7 else "frictionless"
    pressed = _indenter(rng, radius)
    depth = _digits(height * _log(rng, 0.05, 0.5))
    return Test("indentation", depth, _interface(rng), base, STEPS, pressed)


def _indenter(rng: Generator, radius: float) -> Indenter:
    kind = rng.choice(["cone", "needle", "sphere", "flat", "rounded"])
    if kind in ("cone", "needle"):
        tip = _digits(_log(rng, 0.2, 3))
        shaft = _digits(tip * rng.uniform(1.5, 4)) if kind == "needle" else None
        return Cone(_digits(rng.uniform(15, 60)), tip, shaft)
    if kind == "sphere":
        return Sphere(_digits(radius * _log(rng, 0.1, 1.5)))
    punch = _digits(radius * rng.uniform(0.15, 0.8))
    edge = 0.0 if kind == "flat" else _digits(punch * _log(rng, 0.05, 0.5))
    return Flat(punch, edge)


def _material(rng: Generator) -> Material:
    """Energy with positive constants; of Ogden's, every term stiffens (mu_i > 0)."""
    mu, kind = _log(rng, 1e-3, 1), rng.choice(["neo-hookean", "mooney-rivlin", "yeoh", "ogden"])
    ratio = _digits(0.5 - _log(rng, 1e-4, 0.05), 5)
    if kind == "neo-hookean":
        constants = {"C10": mu / 2}
    elif kind == "mooney-rivlin":
        share = rng.uniform(0.2, 0.9)
        constants = {"C10": share * mu / 2, "C01": (1 - share) * mu / 2}
    elif kind == "yeoh":
        second, third = _log(rng, 0.01, 0.5), _log(rng, 0.001, 0.1)
        constants = {"C10": mu / 2, "C20": second * mu / 2, "C30": third * mu / 2}
    else:
        share = rng.uniform(0.3, 1)
        constants = {"mu1": share * mu, "alpha1": rng.uniform(1.5, 8)}
        if rng.random() < 0.5:
            constants |= {"mu2": (1 - share) * mu, "alpha2": rng.uniform(-5, -1.5)}
    names = {"yeoh": "reduced-polynomial"}
    rounded = {name: _digits(value) for name, value in constants.items()}
    return Material(names.get(kind, str(kind)), rounded, poisson_ratio=ratio)


def _interface(rng: Generator) -> Interface:
    return "bonded" if rng.random() < 0.5 else "frictionless"


def _log(rng: Generator, low: float, high: float) -> float:
    """Draw a number whose logarithm is uniform."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _digits(value: float, digits: int = 3) -> float:
    """Round to so many digits, so that a problem can be written down."""
    return float(f"{value:.{digits}g}")
