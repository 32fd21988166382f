"""Costs are predicted from what will really be solved."""

from __future__ import annotations

import pytest

from study.forward.estimate import estimate
from study.forward.mesh import build_mesh
from study.forward.problem import Block, Cone, Cylinder, Model, Problem, Test
from study.forward.system import System
from tests.forward.problems import GEL

COMPRESSED = (Cylinder(25, 30), Test("compression", 3, "bonded", "bonded", 5))
INDENTED = (Block(60, 60, 40), Test("indentation", 2, "frictionless", "bonded", 5, Cone(30, 1, 3)))


@pytest.mark.parametrize("specimen_and_test", [COMPRESSED, INDENTED], ids=["plates", "needle"])
@pytest.mark.parametrize("space", ["axisymmetric", "3d"])
@pytest.mark.parametrize("order", ["linear", "quadratic"])
@pytest.mark.parametrize("shape", ["simplex", "tensor"])
@pytest.mark.parametrize("formulation", ["mixed", "displacement"])
def test_unknowns_are_counted(specimen_and_test, space, order, shape, formulation):
    specimen, test = specimen_and_test
    problem = Problem(specimen, test, GEL, Model(space, order, shape, formulation, "coarse"))
    real = System.build(problem, build_mesh(problem), solver="superlu").dofs
    assert estimate(problem).dofs == pytest.approx(real, rel=0.12)


def test_finer_and_deeper_cost_more():
    specimen, test = COMPRESSED
    coarse, fine = (
        estimate(Problem(specimen, test, GEL, Model("3d", mesh=level)))
        for level in ("coarse", "fine")
    )
    assert fine.seconds > 5 * coarse.seconds
    assert fine.memory_MB > coarse.memory_MB
