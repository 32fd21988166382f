"""Problems and meshes that several tests of the solver share."""

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.structured import Mesh, extrude, rectangle
from study.mechanics.setup.geometry import Cone, Cylinder, Flat
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve

NEO_HOOKEAN = Material("neo-hookean", {"C10": 0.5}, bulk_modulus=1000.0)
MOONEY = Material("mooney-rivlin", {"C10": 0.4, "C01": 0.1}, bulk_modulus=1000.0)
RP2 = Material("reduced-polynomial", {"C10": 0.5, "C20": 0.1}, bulk_modulus=1000.0)
YEOH = Material("reduced-polynomial", {"C10": 0.5, "C20": -0.05, "C30": 0.02}, bulk_modulus=1000.0)
#: forces of bonded layers by series solutions
LAYERS = Path(__file__).resolve().parents[2] / "validation" / "layers.csv"
#: marks of what the long verification alone solves
LONG = (pytest.mark.slow, pytest.mark.verify)
SPECIMEN = Cylinder(25, 50)
NEEDLE, PUNCH = Cone(30, 1), Flat(3, 0.3)
#: material of the hard-contact forces: C10 = 5 kPa, C20 = 1 kPa, K = 10 MPa
RUBBER = Material("reduced-polynomial", {"C10": 5e-3, "C20": 1e-3}, bulk_modulus=10.0)
#: gel of the reference figures: C10 = 5 kPa, K = 10 MPa
GEL = Material("neo-hookean", {"C10": 5e-3}, bulk_modulus=10.0)


def long_verification(test):
    """Leave a test out of the suite."""
    return pytest.mark.slow(pytest.mark.verify(test))


def compression(
    specimen, depth, interface="bonded", *, base="", material=NEO_HOOKEAN, steps=1, **model
):
    """Compression between two plates, alike where the lower one is not given."""
    test = Test("compression", depth, interface, base or interface, steps=steps)
    return Problem(specimen, test, material, replace(Model(), **model))


def indentation(
    indenter, depth, specimen=SPECIMEN, *, material=RUBBER, steps=10, base="bonded",
    interface="frictionless", **model
):  # fmt: skip
    test = Test("indentation", depth, interface, base, steps, indenter)
    return Problem(specimen, test, material, replace(Model(), **model))


def reached(problem, **given):
    """Solution without gradients, every step of which converged."""
    found = solve(problem, gradients=False, **given)
    assert found.converged, found.message
    return found


def forces(problem, **given):
    """Forces of a test every step of which converged, N."""
    return reached(problem, **given).curve.force_N


def taylor_slopes(problem, base, direction, lengths):
    """Slopes in h of the largest |F(p + h dp) - F(p) - h g.dp|; exact gradients give 2."""
    names = problem.material.names
    rate = sum(base.curve.force_gradient[n] * d for n, d in zip(names, direction, strict=True))
    errors = []
    for h in lengths:
        moved = problem.material.with_constants(problem.material.values + h * direction)
        force = solve(replace(problem, material=moved), gradients=False, warm=base).curve.force_N
        errors.append(np.abs(force - base.curve.force_N - h * rate).max())
    return np.log2(np.array(errors[:-1]) / np.array(errors[1:]))


def grid(radius, height, nr, nz, shape="simplex"):
    """Square-grid mesh of the whole height; triangles are halves of its squares."""
    r, z = np.linspace(0, radius, nr + 1), np.linspace(0, height, nz + 1)
    points, cells = rectangle(r, z, shape)
    return Mesh(points, cells, False, radius / nr)


def irregular(mesh, seed=0):
    """Move the points inside by up to a quarter of the element size."""
    points = mesh.points.copy()
    low, high = points.min(axis=0), points.max(axis=0)
    inside = ((points > low + 1e-9) & (points < high - 1e-9)).all(axis=1)
    shift = np.random.default_rng(seed).uniform(-0.25, 0.25, points.shape)
    points[inside] += mesh.size_mm * shift[inside]
    return replace(mesh, points=points)


def cube(n, shape="simplex"):
    """Unit cube of distorted elements."""
    line = np.linspace(0, 1, n + 1)
    plane, faces = rectangle(line, line, shape)
    points, cells = extrude(plane, faces, line)
    return irregular(Mesh(points, cells, False, 1 / n))


def hooke(nu):
    """Small-strain solid of shear modulus 1."""
    modulus = {"youngs_modulus": 2 * (1 + nu)}
    if nu == 0.5:
        return Material("linear-elastic", modulus, incompressible=True)
    return Material("linear-elastic", modulus, poisson_ratio=nu)


def layers(problem):
    """Ratio, Poisson's ratio, value and relative uncertainty of each entry of a table."""
    with LAYERS.open(newline="", encoding="utf-8") as stream:
        for row in csv.DictReader(stream):
            if row["problem"] == problem:
                names = ("ratio", "poisson_ratio", "value", "digits")
                ratio, nu, value, digits = (float(row[name]) for name in names)
                yield ratio, nu, value, digits
