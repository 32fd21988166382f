"""Compare `study` with plain scikit-fem forms on the same mesh, element and tolerance.

Imports and the first compilation are left out, set-up is counted. Run by ``make bench``.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable

from benchmarks import fitting, plain_scikit_fem
from study.forward.mesh import build_mesh
from study.forward.problem import Cylinder, Model, Problem, Test
from study.forward.solve import Options, solve
from study.material import Material

GEL = Material("neo-hookean", {"C10": 5e-3}, bulk_modulus=10.0)
SPECIMEN, DISPLACEMENT_MM = Cylinder(25.0, 50.0), 2.5


def timed(run: Callable[[], float], repeats: int = 3) -> tuple[float, float]:
    """Median of the seconds, and the force."""
    seconds, force = [], 0.0
    for _ in range(repeats):
        began = time.perf_counter()
        force = run()
        seconds.append(time.perf_counter() - began)
    return statistics.median(seconds), force


def compare(mesh_size_mm: float, repeats: int) -> None:
    """Print one row: unknowns, seconds of both, ratio and how far the forces agree."""
    test = Test("compression", DISPLACEMENT_MM, "bonded", "bonded", steps=1)
    model = Model("3d", "quadratic", mesh_size_mm=mesh_size_mm)
    problem = Problem(SPECIMEN, test, GEL, model)
    # one lifted step without side contact, as the forms do it
    options = Options(side_contact=False)
    mesh = build_mesh(problem)
    unknowns = solve(problem, gradients=False, options=options, mesh=mesh).dofs

    def ours() -> float:
        solution = solve(problem, gradients=False, options=options, mesh=mesh)
        return float(solution.curve.force_N[-1])

    def forms() -> float:
        return plain_scikit_fem.solve(mesh, DISPLACEMENT_MM, 5e-3, 10.0)[0]

    mine, force = timed(ours, repeats)
    theirs, other = timed(forms, repeats)
    print(
        f"{unknowns:>9}{mine:>10.2f}{theirs:>15.2f}{theirs / mine:>8.1f}"
        f"{abs(force / other - 1):>15.1e}"
    )


def main() -> None:
    """Print the table."""
    print("3D bonded compression, one step of 5 %, neo-Hookean, P2/P1, K/mu = 1000 (median of 3)")
    print(f"{'unknowns':>9}{'study s':>10}{'plain forms s':>15}{'ratio':>8}{'force differs':>15}")
    compare(5.0, 3)
    compare(3.2, 3)
    fitting.main()


if __name__ == "__main__":
    main()
