"""A kind of test that the package does not have: fem solves it without knowing its name."""

import ast
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from study.ground.errors import Fault, InputError
from study.mechanics.material.homogeneous import response
from study.mechanics.setup import test_kind
from study.mechanics.setup.geometry import Block, Cone, Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Compression, FaceCondition, Test
from study.mechanics.solver.finite_element_solution import solve
from tests.fem.problems import GEL, reached

ROOT = Path(__file__).resolve().parents[2]


class Tension(Compression):
    """Bonded plates go apart: faces, contacts and faults differ from those of a compression."""

    def faces(self, test):
        return FaceCondition("top", self.sense, True), FaceCondition("base", 0.0, True)

    def contacts(self, test):
        return ()

    def stretches(self, test, height_mm):
        return np.linspace(1.0, 1 + test.depth_mm / height_mm, 41)

    def faults(self, test, height_mm, half_width_mm):
        if "frictionless" in (test.interface, test.base):
            yield Fault("test.interface", "a plate pulls only what it is bonded to", "bond it")


@pytest.fixture(autouse=True)
def tension(monkeypatch):
    monkeypatch.setitem(test_kind.TEST_KINDS, "tension", Tension(sense=1.0))


def pulled(specimen, depth, steps=1, **model):
    test = Test("tension", depth, "bonded", "bonded", steps=steps)
    return Problem(specimen, test, GEL, replace(Model(), **model))


@pytest.mark.parametrize(
    ("specimen", "model"),
    [
        (Cylinder(10, 10), {}),
        (Cylinder(10, 10), {"space": "3d", "element_order": "linear", "mesh": "coarse"}),
        (Block(20, 20, 10), {"space": "3d", "element_shape": "tensor", "mesh": "coarse"}),
    ],
)
def test_first_stiffness_is_that_of_compression(specimen, model):
    problem = pulled(specimen, 1e-3, **model)
    squeezed = replace(problem, test=replace(problem.test, kind="compression"))
    pulled_N, pressed_N = (solve(p, gradients=False).curve.force_N[-1] for p in (problem, squeezed))
    # of a smooth energy they differ by the strain of 1e-4 times a number of order 1
    assert pulled_N == pytest.approx(pressed_N, rel=5e-4)
    assert pulled_N < pressed_N  # flattened between bonded plates a specimen gets stiffer


def test_long_cylinder_is_in_uniaxial_stress():
    found = reached(pulled(Cylinder(2, 60), 90.0, 3))
    stretch = 1 + found.curve.displacement_mm / 60
    free = np.pi * 2**2 * response(GEL, "uniaxial", stretch).stress
    # bonded ends stiffen a length of about a radius each: by 1.0 % at a stretch of 1.25 and 0.76 %
    # at 2.5 on this mesh
    np.testing.assert_allclose(found.curve.force_N, free, rtol=0.012)
    np.testing.assert_allclose(found.base_reaction_N, found.curve.force_N, rtol=1e-6)


def test_a_kind_refuses_what_it_cannot_do():
    problem = pulled(Cylinder(10, 10), 3.0)
    loose = replace(problem, test=replace(problem.test, base="frictionless"))
    with pytest.raises(InputError, match="pulls only what it is bonded to"):
        solve(loose)


@pytest.mark.parametrize(
    "loading",
    [
        Test("compression", 5.0, "frictionless", "frictionless"),
        Test("indentation", 1.5, "frictionless", "frictionless", indenter=Cone(30.0, 1.0)),
    ],
)
def test_every_kind_of_test_holds_the_specimen(loading):
    # symmetry holds it across the axis; along the axis a face has to
    faces = test_kind.TEST_KINDS[loading.kind].faces(loading)
    assert any(face.face == "base" and face.axial == 0 for face in faces)


def named_kinds(folder):
    """Places that ask a test or a section for the name of its kind."""
    return [
        f"{path.name}:{node.lineno}"
        for path in sorted(folder.rglob("*.py"))
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
        if isinstance(node, ast.Compare)
        and any(isinstance(n, ast.Attribute) and n.attr == "kind" for n in ast.walk(node))
    ]


def test_no_room_of_finite_elements_asks_for_the_kind(tmp_path):
    (tmp_path / "planted.py").write_text('def f(p):\n    return p.test.kind == "compression"\n')
    assert named_kinds(tmp_path) == ["planted.py:2"]
    for room in ("surface", "mesh", "element", "contact", "solver"):
        folder = ROOT / "study" / "mechanics" / room
        assert list(folder.glob("*.py"))
        assert not named_kinds(folder)
