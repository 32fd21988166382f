"""Sizes that a mesh generator asks for, place by place, in machine code."""

from __future__ import annotations

import ctypes

import numpy as np
import pytest

from study.mechanics.mesh.size_field import SizeField, size_callback, size_field
from study.mechanics.setup.geometry import Cone, Flat
from study.mechanics.setup.setup import Model
from study.mechanics.setup.test_kind import AroundContact

CONE = size_field(Model("3d", "quadratic"), AroundContact(Cone(30.0, 1.0), 3.0), 40.0, 25.0)
PUNCH = size_field(
    Model("axisymmetric", "quadratic"), AroundContact(Flat(3.0, 0.0), 0.1), 40.0, 25.0
)


@pytest.mark.parametrize("field", [CONE, PUNCH, SizeField.uniform(2.5)])
@pytest.mark.parametrize("dim", [2, 3])
def test_the_generator_is_told_the_size_of_the_field(field: SizeField, dim: int) -> None:
    x, y, z = np.random.default_rng(5).uniform(0, 40, size=(3, 200))
    expected = field.at(x, y) if dim == 2 else field.at(np.hypot(x, y), z)
    numbers, ask = np.array(field.numbers()), size_callback(dim).ctypes
    address = numbers.ctypes.data_as(ctypes.c_void_p)
    told = [ask(dim, 1, *place, 1e22, address) for place in zip(x, y, z, strict=True)]
    assert told == pytest.approx(expected, rel=1e-14)


def test_a_uniform_field_has_one_size() -> None:
    rho, z = np.meshgrid(np.linspace(0, 30, 7), np.linspace(0, 40, 9))
    assert (SizeField.uniform(2.5).at(rho, z) == 2.5).all()
