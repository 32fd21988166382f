"""Meshes that a process makes once, however many materials are solved on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from study.mechanics.mesh.mesher import _KEPT, build_mesh, regular_mesh
from study.mechanics.setup.geometry import Cone, Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from tests.fem.problems import GEL, YEOH

NEEDLE = Problem(
    Cylinder(25.0, 50.0), Test("indentation", 1.0, indenter=Cone(30.0, 1.0)), GEL,
    Model("axisymmetric", "quadratic", mesh="coarse"),
)  # fmt: skip


def test_a_material_or_the_number_of_steps_asks_for_no_new_mesh() -> None:
    made = build_mesh(NEEDLE.setup)
    assert build_mesh(replace(NEEDLE, material=YEOH).setup) is made
    assert build_mesh(replace(NEEDLE, test=replace(NEEDLE.test, steps=3)).setup) is made


def test_whatever_shapes_a_mesh_asks_for_another() -> None:
    made = build_mesh(NEEDLE.setup)
    deeper = replace(NEEDLE, test=replace(NEEDLE.test, displacement_mm=2.0))
    finer = replace(NEEDLE, model=replace(NEEDLE.model, mesh="medium"))
    seeded = replace(NEEDLE, model=replace(NEEDLE.model, mesh_seed=3))
    names = {build_mesh(one.setup).digest() for one in (NEEDLE, deeper, finer, seeded)}
    assert len(names) == 4
    assert build_mesh(NEEDLE.setup).digest() == made.digest()


def test_only_a_few_are_kept_and_none_can_be_changed() -> None:
    made = build_mesh(NEEDLE.setup)
    with pytest.raises(ValueError, match="read-only"):
        made.points += 1.0
    for depth in np.linspace(0.5, 0.9, 2 * _KEPT):
        build_mesh(replace(NEEDLE, test=replace(NEEDLE.test, displacement_mm=float(depth))).setup)
    assert regular_mesh.cache_info().currsize == _KEPT
    again = build_mesh(NEEDLE.setup)
    assert again is not made
    assert again.digest() == made.digest()
