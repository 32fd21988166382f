"""`study` itself, told to take the load steps as they are asked for."""

from __future__ import annotations

from typing import Literal

from benchmarks.exchange import Answer, NoAnswerError, Task
from study.mechanics.material.material import Material
from study.mechanics.mesh.structured import Mesh
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import StepSettings, Test
from study.mechanics.solver.finite_element_solution import solve as simulate
from study.mechanics.solver.newton import Options

#: no step is cut in two, and the free side passes through the plates: as in the other codes
OPTIONS = Options(side_contact=False, steps=StepSettings(largest=0.06))


def problem(task: Task) -> tuple[Problem, Mesh]:
    """Problem and mesh of a task."""
    radius, height = float(task.points[:, 0].max()), 2 * task.middle_mm
    test = Test("compression", task.displacement_mm, "bonded", "bonded", steps=task.steps)
    gel = Material("neo-hookean", {"C10": task.c10}, bulk_modulus=task.bulk)
    space: Literal["axisymmetric", "3d"] = "axisymmetric" if task.axisymmetric else "3d"
    model = Model(space, "quadratic", mesh_size_mm=1.0)
    mesh = Mesh(task.points, task.cells, half_height=True, size_mm=1.0)
    return Problem(Cylinder(radius, height), test, gel, model), mesh


def solve(task: Task) -> Answer:
    """Simulate without gradients, as nobody else has them."""
    asked, mesh = problem(task)
    found = simulate(asked, gradients=False, options=OPTIONS, mesh=mesh)
    if found.status != "converged":
        raise NoAnswerError(found.message)
    spent = sum(found.newton_iterations)
    return Answer(
        float(found.curve.force_N[-1]), spent, found.dofs, found.solver, dict(found.seconds)
    )
