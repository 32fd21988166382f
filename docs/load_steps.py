"""How far a curve between its load steps can be trusted: the table of load-steps.md.

    python docs/load_steps.py    solve, print the table (a minute)

Every problem is neo-Hookean, axisymmetric, with quadratic triangles on the medium mesh.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from study.ground.curve import Curve
from study.mechanics.forward.finite_element import CURVE_ERROR
from study.mechanics.material.material import Material
from study.mechanics.mesh.mesher import build_mesh
from study.mechanics.setup.geometry import Block, Cone, Cylinder, Flat, Indenter, Sphere
from study.mechanics.setup.setup import Model, Problem
from study.mechanics.setup.test_kind import Test
from study.mechanics.solver.finite_element_solution import solve
from study.mechanics.solver.newton import Options
from study.simulation.response import relative_rms_force_error

GEL = Material("neo-hookean", {"C10": 6e-3}, poisson_ratio=0.4995)
#: another energy, which stands for a measured curve some per cent away
MEASURED = Material(
    "ogden", {"mu1": 5e-3, "alpha1": 3.0, "mu2": 5e-3, "alpha2": 1.5}, poisson_ratio=0.4995
)
BLOCK, MODEL = Block(60.0, 60.0, 40.0), Model()
STEPS, EXACT = (5, 10, 20, 40), 160


def problems() -> dict[str, Problem]:
    """Three indenters and a disc between bonded plates."""
    pressed: dict[str, tuple[Indenter, float]] = {
        "needle, 4 mm": (Cone(30.0, 1.0, 3.0), 4.0),
        "sphere of 5 mm, 3 mm": (Sphere(5.0), 3.0),
        "rounded punch, 2 mm": (Flat(3.0, 0.3), 2.0),
    }
    found = {
        name: Problem(
            BLOCK, Test("indentation", depth, "frictionless", "bonded", indenter=tool), GEL, MODEL
        )
        for name, (tool, depth) in pressed.items()
    }
    disc = Test("compression", 6.0, "bonded", "bonded")
    return found | {"bonded disc, 20 %": Problem(Cylinder(25.0, 30.0), disc, GEL, MODEL)}


def rows(problem: Problem) -> Iterator[tuple[object, ...]]:
    """Solve with every number of load steps; what is printed, one row a curve."""
    mesh = build_mesh(problem.setup)

    def curve(steps: int, options: Options, material: Material = GEL) -> tuple[Curve, float]:
        test = replace(problem.test, steps=steps)
        found = solve(
            replace(problem, test=test, material=material), gradients=False, mesh=mesh,
            options=options,
        )  # fmt: skip
        return found.curve, found.energy.largest_mismatch

    depth = problem.test.depth_mm
    d = np.linspace(depth / 16, depth, 100)
    exact = curve(EXACT, Options())[0].force_at(d)
    other = curve(EXACT, Options(), MEASURED)[0].force_at(d)
    measured = Curve(d, other)

    def off(found: Curve) -> float:
        return float(np.sqrt(np.mean((found.force_at(d) - exact) ** 2) / np.mean(exact**2)))

    for steps in STEPS:
        for options in (Options(), Options(curve_error=CURVE_ERROR)):
            found, mismatch = curve(steps, options)
            cubic = replace(found, work_Nmm=None)
            yield (
                steps, len(found), 100 * off(cubic), 100 * off(found),
                100 * found.relative_interpolation_error(),
                relative_rms_force_error(found, measured), 100 * mismatch,
            )  # fmt: skip


def main() -> None:
    """Print the table."""
    print("| problem | load steps | points | cubic | with the work | estimate | score | energy |")
    print("|---|---|---|---|---|---|---|---|")
    for name, problem in problems().items():
        seen = set()
        for steps, points, *numbers, mismatch in rows(problem):
            if (steps, points) not in seen:
                *errors, score = numbers
                told = " | ".join(f"{error:.3f} %" for error in errors)
                print(
                    f"| {name} | {steps} | {points} | {told} | {score:.3f} % | {mismatch:.3f} % |"
                )
            seen.add((steps, points))


if __name__ == "__main__":
    main()
