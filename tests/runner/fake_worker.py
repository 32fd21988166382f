"""A worker whose solver is a formula: the closed form, stiffer between bonded plates.

The study around it is the real one. A file named in the environment makes it misbehave.
"""

import os
from pathlib import Path

import numpy as np
import pytest

from study.ground.curve import Curve
from study.mechanics.forward import closed_form, finite_element
from study.mechanics.mesh.mesher import mesh_size
from study.mechanics.setup.geometry import Cylinder
from study.mechanics.solver.equilibrium import Equilibria
from study.mechanics.solver.solution import EnergyBalance, Solution
from study.simulation import tasks

BONDED = 1.4


class Killed(BaseException):
    """The machine ended the process: nothing in it catches that."""


def solve(problem, **options):
    """Closed form times a factor for bonded plates and an error that falls with the mesh."""
    wish = Path(os.environ.get("FAKE_WISH", "/nonexistent"))
    if wish.exists() and problem.material.model in wish.read_text():
        if "die" in wish.read_text() and problem.test.interface == "bonded":
            raise Killed
        if "bug" in wish.read_text():
            raise ZeroDivisionError("a bug in the solver")
        if "needs 40 steps" in wish.read_text() and problem.test.steps >= 40:
            return outcome(problem, "converged", "every step converged")
        if "needs 6 mm" in wish.read_text() and mesh_size(problem.setup) <= 6.0:
            return outcome(problem, "converged", "every step converged")
        if "needs memory" in wish.read_text():
            with wish.with_suffix(".deaths").open("a+") as deaths:
                deaths.seek(0)
                if len(deaths.read()) >= 4:
                    return outcome(problem, "converged", "every step converged")
                deaths.write("x")
            raise Killed
        return outcome(problem, "not-converged", "stopped at 1 mm of 6 mm: no step was found")
    return outcome(problem, "converged", "every step converged")


def outcome(problem, status, message):
    assert isinstance(problem.specimen, Cylinder)
    size, test = mesh_size(problem.setup), problem.test
    d = test.displacement_mm * np.arange(1, test.steps + 1) / test.steps
    exact = closed_form.homogeneous(problem.specimen, problem.material, d)
    factor = BONDED * (1 + 1e-3 * size) if test.interface == "bonded" else 1.0
    gradient = {n: factor * g for n, g in exact.force_gradient.items()}
    above, below = (
        closed_form.homogeneous(problem.specimen, problem.material, d + h).force_N
        for h in (1e-4, -1e-4)
    )
    curve = Curve(d, factor * exact.force_N, factor * (above - below) / 2e-4, gradient)
    return Solution(
        status=status, message=message, curve=curve, newton_iterations=(3,) * test.steps,
        dofs=100, elements=10, mesh_hash="fake", mesh_size_mm=size, solver="fake", min_j=0.9,
        reached_mm=float(d[-1]), seconds={}, energy=EnergyBalance(curve.force_N, 0 * d, 0 * d),
        equilibria=Equilibria(),
    )  # fmt: skip


def perform(task):
    """Do a task of a study with the fake solver."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(finite_element, "solve", solve)
        return tasks.perform(task)
