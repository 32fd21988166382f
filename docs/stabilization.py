"""What the two stabilizations do to a force: ``python docs/stabilization.py`` prints the tables.

A cone, a sphere and a flat end are pressed into a cylinder of a neo-Hookean gel, on the coarse
mesh of quadratic tetrahedra, with the constants as they are, ten times larger, and zero.
"""

from __future__ import annotations

import argparse
from unittest.mock import patch

import numpy as np

from study.mechanics.element.function_space import deformation_gradient
from study.mechanics.material.material import Material
from study.mechanics.setup.geometry import Cone, Cylinder, Flat, Indenter, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver import system
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.internal_force import EVENNESS_OF_SOLIDS, LOCAL_BULK
from study.mechanics.solver.solution import Solution

GEL = Material("neo-hookean", {"C10": 5e-3}, poisson_ratio=0.4995)
CASES: dict[str, tuple[Indenter, float]] = {
    "cone": (Cone(30, 1, 3), 2.0),
    "sphere": (Sphere(5.0), 2.0),
    "flat": (Flat(3, 0.3), 1.0),
}
#: multiples of the local bulk modulus and of kappa
CHANGES = {"as it is": (1, 1), "local x 10": (10, 1), "no local": (0, 1), "kappa x 10": (1, 10),
           "no kappa": (1, 0)}  # fmt: skip


def pressed(name: str, space: str, mesh: str) -> Problem:
    """One of the cases: a cylinder as wide as a block of 60 mm, 40 mm high."""
    indenter, depth = CASES[name]
    test = Test("indentation", depth, "frictionless", "bonded", 4, indenter)
    model = Model(space, mesh=mesh, mesh_ratio=1.3)  # type: ignore[arg-type]
    return Problem(Cylinder(33.85, 40), test, GEL, model)


def energies(found: Solution) -> tuple[float, float]:
    """Energies of both stabilizations over the isochoric energy, in the last state."""
    if found.warm is None:
        raise RuntimeError(found.message)
    whole, x = found.warm.system, found.warm.steps[-1].state.x
    w, F = whole.space.weights, deformation_gradient(whole.space, whole.displacements(x))
    J = whole.internal.volume_ratios(GEL, x)
    isochoric = GEL.mu0 / 2 * (J ** (-2 / 3) * np.einsum("ijeq,ijeq->eq", F, F) - 3)
    mean = (w * J).sum(axis=1, keepdims=True) / w.sum(axis=1, keepdims=True)
    local = whole.internal.split(GEL).local / 2 * (J - 1) ** 2
    uneven = whole.internal.evenness * GEL.mu0 / 4 * (J - mean) ** 4
    stored = float((w * isochoric).sum())
    return float((w * local).sum()) / stored, float((w * uneven).sum()) / stored


def row(name: str, mesh: str, change: str) -> str:
    """One line: force, and what each stabilization stores of the isochoric energy."""
    local, even = CHANGES[change]
    bound, kappa = local * LOCAL_BULK, even * EVENNESS_OF_SOLIDS
    # where a system of equations reads them
    with patch.multiple(system, LOCAL_BULK=bound, EVENNESS_OF_SOLIDS=kappa):
        found = solve(pressed(name, "3d", mesh), gradients=False)
    if found.warm and found.warm.system.internal.local_bulk != bound:
        raise RuntimeError("the change did not reach the equations")
    stored, uneven = (f"{100 * share:.4f} %" for share in energies(found))
    state = f"{found.curve.force_N[-1]:.6f} N" if found.converged else found.message
    return f"{name} | {mesh} | {change} | {state} | {stored} | {uneven}"


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--mesh", default="coarse")
    parser.add_argument("--cases", nargs="+", default=list(CASES))
    asked = parser.parse_args()
    for case in asked.cases:
        plane = solve(pressed(case, "axisymmetric", "fine"), gradients=False)
        print(f"{case} | axisymmetric, fine | {plane.curve.force_N[-1]:.6f} N", flush=True)
        for change in CHANGES:
            print(row(case, asked.mesh, change), flush=True)
