"""One simulation: a problem becomes a curve."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from study.ground.canonical import Keyed
from study.ground.errors import Fault, InputError
from study.ground.files import is_special, replaced, write_atomic
from study.harness.design.load import load_problem, loaded_problem
from study.mechanics.forward.finite_element import at_steps
from study.mechanics.material.stability import check
from study.mechanics.setup.setup import Problem, Tables
from study.mechanics.solver.solution import Solution
from study.reporting.content.blocks import Block, Table, Verbatim
from study.reporting.figures.axes import shown
from study.reporting.output.page import Shown
from study.simulation import plausibility

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.figures.axes import Drawing


# A simulation as a notebook shows it: a frame, a table in HTML, a figure.


@dataclass(frozen=True, repr=False)
class SolvedProblem(Shown, Keyed, Solution):
    """What :func:`study.solve` returns: a :class:`Solution` that can be shown."""

    KEYS = "dofs elements newton_iterations seconds solver reached_mm min_j base_reaction_N"

    def to_frame(self) -> pd.DataFrame:
        """Curve with one row a load step, stresses in MPa."""
        import pandas as pd

        curve = self.curve
        gradients = {f"force_gradient_{n}": g for n, g in curve.force_gradient.items()}
        columns = {"displacement_mm": curve.displacement_mm, "force_N": curve.force_N}
        if curve.stiffness_N_per_mm is not None:
            columns["stiffness_N_per_mm"] = curve.stiffness_N_per_mm
        return pd.DataFrame(columns | gradients)

    def plot(self) -> Drawing:
        """Draw force against displacement."""
        from study.reporting.figures.curve_figures import draw_curve

        if not len(self.curve):
            raise ValueError(f"there is nothing to draw: {self.message}")
        return shown(lambda: draw_curve(self.curve), "solution", "force against displacement")

    def blocks(self) -> Iterator[Block]:
        """Curve, outcome, contact at the last step, and what the solution took."""
        curve = self.curve
        every = {
            "time [s]": curve.time_s,
            "displacement [mm]": curve.displacement_mm,
            "force [N]": curve.force_N,
            "stiffness [N/mm]": curve.stiffness_N_per_mm,
        }
        columns = {head: values for head, values in every.items() if values is not None}
        rows = zip(*columns.values(), strict=True)
        yield Table("", tuple(columns), tuple(tuple(f"{v:.6g}" for v in row) for row in rows), 0)
        yield Verbatim(f"{self.status}: {self.message}")
        if figures := self.equilibria.contact:
            last, above = figures[-1], self.equilibria.plate[-1]
            yield Verbatim(
                f"at the last step: contact {last.area_mm2:.4g} mm^2, peak pressure "
                f"{1e3 * last.peak_pressure_MPa:.4g} kPa, nodes up to {last.penetration_mm:.2g} mm "
                f"inside and {last.gap_mm:.2g} mm off the surface; side force "
                f"{math.hypot(*above.side):.4g} N"
            )
        total = self.seconds["total"]
        yield Verbatim(f"{self.dofs} unknowns, {total:.2f} s, {self.solver}")

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key."""
        curve, energy = replace(self.curve, quantities={}), self.energy
        return {
            "status": self.status,
            "message": self.message,
            **curve.as_dict(),
            "force_gradient": curve.force_gradient,
            "parameters": {} if self.warm is None else self.warm.system.material.constants,
            **super().keyed(),
            "energy": {
                "stored_Nmm": energy.stored_Nmm,
                "stabilization_Nmm": energy.stabilization_Nmm,
                "mismatch": energy.mismatch,
                "snaps_mm": energy.jumps_mm,
            },
            **self.equilibria.keyed(),
            "mesh_hash": self.mesh_hash,
            "mesh_size_mm": self.mesh_size_mm,
        }


def solve(
    problem: Problem | Tables | str | Path,
    *,
    overrides: Sequence[str] = (),
    gradients: bool = True,
    follow: bool = False,
    progress: Callable[[float], None] | None = None,
) -> SolvedProblem:
    """Simulate one test.

    Parameters
    ----------
    problem : Problem, mapping, str or Path
        A problem, its file, or the tables of one: the keys of the file, with texts that have a
        unit or numbers in mm, N, MPa and deg. Resolved tables (``radius_mm``) are taken too.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.
    gradients : bool
        Whether dF/d(constant) is computed too.
    follow : bool
        Whether to go on behind an instability, on the whole body bent a little into its mode;
        without it the status is ``unstable`` there and the curve ends.
    progress : callable, optional
        Called with the fraction that is done.

    Returns
    -------
    Solution
        Curve in mm and N, with gradients, energy balance, mesh and status; ``to_frame()``,
        ``plot()``, and a table in a notebook.

    Raises
    ------
    InputError
        For a faulty problem, or constants that make an unstable material.

    Examples
    --------
    Between frictionless plates the deformation is the same everywhere: with lambda = 0.9 and
    W = C10 (I1 - 3) the force is 2 C10 (1/lambda^2 - lambda) pi R^2.

    >>> import study
    >>> found = study.solve({
    ...     "specimen": {"shape": "cylinder", "radius": 10, "height": "1 cm"},
    ...     "test": {"kind": "compression", "interface": "frictionless",
    ...              "displacement": "1 mm", "steps": 2},
    ...     "material": {"model": "neo-hookean", "C10": "10 kPa", "incompressible": True},
    ...     "model": {"mesh_size": 5},
    ... })
    >>> found.status
    'converged'
    >>> [round(float(force), 4) for force in found.curve.force_N]
    [0.993, 2.1022]
    """
    resolved_problem = _problem(problem, overrides)
    if follow and not resolved_problem.setup.has_no_elements:
        from study.mechanics.solver.finite_element_solution import follow as behind_instability

        solution = behind_instability(resolved_problem, gradients=gradients, progress=progress)
        return SolvedProblem.of(solution)
    return SolvedProblem.of(at_steps(resolved_problem, gradients=gradients, progress=progress))


def cautions(problem: str | Path, overrides: Sequence[str] = ()) -> tuple[str, ...]:
    """Sentences about moduli and sizes in a file that no soft material or specimen has."""
    return plausibility.cautions_of(load_problem(problem, overrides).problem)


def _problem(problem: Problem | Tables | str | Path, overrides: Sequence[str]) -> Problem:
    if not isinstance(problem, Problem):
        problem = loaded_problem(problem, overrides).problem.at()
    import numpy as np

    height = float(getattr(problem.specimen, "height_mm", 0.0))
    depth = problem.test.depth_mm
    compressed = problem.setup.kind.compresses and depth < height
    check(problem.material, np.linspace(1 - depth / height, 1, 41) if compressed else None)
    return problem


# Files of one simulation: fields for ParaView, a picture of the mesh.


def writable(*paths: Path | None) -> None:
    """Refuse files that could not be written, before anything is computed."""
    faults = []
    for path in paths:
        if path is not None and not path.parent.is_dir():
            faults.append(Fault(str(path), f"there is no folder {path.parent}", "make it first"))
        elif path is not None and path.is_dir():
            faults.append(Fault(str(path), "is a folder", "name a file"))
        elif path is not None and is_special(path):
            faults.append(Fault(str(path), "is a device or a pipe", "name a file"))
    if faults:
        raise InputError(faults)


def write_vtu(solution: Solution, path: str | Path, *, whole: bool = False) -> None:
    """Write the fields for ParaView: of the last step (.vtu), or of every one (.pvd)."""
    from study.mechanics.solver import finite_element_solution

    if Path(path).suffix.lower() == ".pvd":
        finite_element_solution.write_series(solution, path, whole=whole)
        return
    with replaced(Path(path)) as part:
        finite_element_solution.write_vtu(solution, part, whole=whole)


def write_picture(solution: Solution, path: str | Path) -> None:
    """Draw both meshes of a solution; a buckling column whole, moved by a tenth of its height."""
    from study.reporting.figures.mesh_figures import picture

    points, cells, moved = solution.points, solution.cells, solution.displacement
    bent, warm = solution.instability, solution.warm
    if bent is not None and warm is not None and not solution.converged:
        from study.mechanics.solver.equilibrium import mirrored

        mesh, height = warm.system.mesh, warm.system.mesh.height_mm
        mode = bent.mode[: len(points)]
        if points.shape[1] == 3 and warm.system.force_scale > 1:
            whole, moved = mirrored(mesh, moved, (1, 1, 1), height)
            _, mode = mirrored(mesh, mode, bent.parity, height)
            points, cells = whole.points, whole.cells
        moved = moved + 0.1 * height * mode
    try:
        svg, _ = picture(points, cells, moved)
    except ValueError as error:
        raise InputError(Fault(str(path), f"no picture: {error}")) from None
    write_atomic(Path(path), f"{svg}\n".encode())
