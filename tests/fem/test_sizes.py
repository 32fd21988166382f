"""Sizes that a mesh generator asks for, place by place, in machine code."""

import ctypes

import numpy as np
import pytest

from study.mechanics.material.material import Material
from study.mechanics.mesh.size_field import SizeField, size_callback, size_field
from study.mechanics.setup.geometry import Cone, Cylinder, Flat
from study.mechanics.setup.setup import Model
from study.mechanics.setup.test_kind import AroundContact
from study.mechanics.solver.finite_element_solution import solve
from tests.fem.problems import indentation

CONE = size_field(Model("3d", "quadratic"), AroundContact(Cone(30.0, 1.0), 3.0), 40.0, 25.0)
PUNCH = size_field(
    Model("axisymmetric", "quadratic"), AroundContact(Flat(3.0, 0.0), 0.1), 40.0, 25.0
)


@pytest.mark.parametrize("field", [CONE, PUNCH, SizeField.uniform(2.5)])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_generator_is_told_the_size_of_the_field(field, dim):
    x, y, z = np.random.default_rng(5).uniform(0, 40, size=(3, 200))
    expected = field.at(x, y) if dim == 2 else field.at(np.hypot(x, y), z)
    numbers, ask = np.array(field.numbers()), size_callback(dim).ctypes
    address = numbers.ctypes.data_as(ctypes.c_void_p)
    told = [ask(dim, 1, *place, 1e22, address) for place in zip(x, y, z, strict=True)]
    assert told == pytest.approx(expected, rel=1e-14)


def test_width_of_a_rounded_edge_in_contact():
    """Hertz where there is no face; of a wide face b^2 t^3 / 3 e = d at s = b t^2 / 2 (to 2e-5)."""
    assert Flat(2.0, 2.0).edge_width_mm(0.01) == pytest.approx(np.sqrt(0.01 * 2.0), rel=1e-12)
    b, e, s = 50.0, 1.0, 1e-3
    assert Flat(b + e, e).edge_width_mm((2 * s / b) ** 1.5 * b**2 / (3 * e)) == pytest.approx(
        s, rel=1e-4
    )
    assert Flat(3.0, 0.3).edge_width_mm(1.0) == 0.3
    assert Flat(3.0).edge_width_mm(1.0) == 0.0


@pytest.mark.parametrize(
    ("punch", "depth", "force"),
    # on meshes with a fourth of the fine one's size, 14,000 to 20,000 unknowns
    [(Flat(3.0, 0.3), 0.006, 0.0017297), (Flat(3.0, 1.5), 0.03, 0.0044393),
     (Flat(3.0, 1.5), 0.15, 0.024377), (Flat(3.0, 1.5), 0.45, 0.082834)],
)  # fmt: skip
def test_a_rounded_punch_is_meshed_for_the_edge_that_touches(punch, depth, force):
    """Meshed for the whole edge, medium is 1.5 % off at these depths and coarse 8.3 %."""
    material = Material("neo-hookean", {"C10": 0.005}, poisson_ratio=0.4999)
    for mesh, allowed in (("coarse", 0.008), ("medium", 0.003)):
        problem = indentation(
            punch, depth, material=material, specimen=Cylinder(12.0, 10.0), steps=1, mesh=mesh
        )
        found = solve(problem, gradients=False)
        assert found.curve.force_N[-1] == pytest.approx(force, rel=allowed)
