"""Reference curve of virtual specimens: a finer model than any cell of the design."""

from __future__ import annotations

from dataclasses import dataclass, replace

from study.curve import Curve
from study.errors import Fault, InputError
from study.execution.loky import Loky
from study.execution.task import Received, Task
from study.forward import finite_element
from study.runner.numerical.solve_task import SolveResult
from study.runner.tables import Tables
from study.runner.virtual.truth import Truth
from study.setup.setup import Setup, problem_of

#: steps of a reference curve; between them it is interpolated with its tangent
_STEPS = 12

#: plates of a reference curve for a design of a single test
_BONDED = {"interface": "bonded", "base": "bonded"}


def reference_curve(
    tables: Tables, material: Truth, poisson_ratio: float, *, as_designed: bool = False
) -> Curve:
    """Solve for the reference force and its gradient, in a worker of one thread.

    Parameters
    ----------
    tables : mapping
        Resolved tables of a cell.
    material : Truth
        What the specimens are made of.
    poisson_ratio : float
        Of that material.
    as_designed : bool
        Whether the test is that of the tables; otherwise the plates are bonded.

    Raises
    ------
    InputError
        If the solver stops.
    """
    test = {**tables["test"], **({} if as_designed else _BONDED), "steps": _STEPS}
    # the grid runs a little past the range, as a real test does
    test["displacement_mm"] = 1.03 * float(tables["test"]["displacement_mm"])
    task = ReferenceTask(
        {
            "specimen": tables["specimen"],
            "test": test,
            "material": {"model": material.model, "constants": dict(material.constants),
                         "poisson_ratio": poisson_ratio},
            "model": _reference_model(tables, as_designed),
        },
        as_designed and not Setup.of(tables).is_homogeneous,
    )  # fmt: skip
    (outcome,) = Loky(perform, 1).run([Task("reference", lambda _: task.to_json())])
    found = SolveResult.from_json(outcome.result)
    if not found.converged:
        rule = f"the reference curve failed: {found.message}"
        raise InputError(Fault("virtual specimens", rule))
    return found.curve


def _reference_model(tables: Tables, as_designed: bool) -> dict[str, object]:
    """Quadratic elements; 3D where the specimen is no body of revolution and that matters.

    Where every test is as the design has it, the mesh is the finest that the design uses,
    to be made finer still.
    """
    shape, is_indented = tables["specimen"]["shape"], tables["test"]["kind"] == "indentation"
    solid = shape in ("surface", "brain") or (shape == "block" and is_indented)
    found = {"space": "3d" if solid else "axisymmetric", "element_order": "quadratic"}
    if not as_designed:
        return {**found, "mesh": "fine"}
    return found | {k: tables["model"].get(k) for k in ("mesh", "mesh_size_mm", "mesh_ratio")}


@dataclass(frozen=True)
class ReferenceTask:
    """The reference problem as it goes to a worker.

    Parameters
    ----------
    tables : mapping
        The problem.
    finer : bool
        Whether its mesh is made finer by one step, so that no cell of the design generates its
        own data.
    """

    tables: Tables
    finer: bool

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return {"kind": "reference", "tables": dict(self.tables), "finer": self.finer}

    @classmethod
    def from_json(cls, document: Received) -> ReferenceTask:
        """Inverse of :meth:`to_json`."""
        return cls(document["tables"], document["finer"])


def perform(document: Received) -> dict[str, object]:
    """Solve the reference problem: a task for a worker.

    Returns
    -------
    dict
        Of :meth:`study.runner.numerical.solve_task.SolveResult.to_json`.
    """
    task = ReferenceTask.from_json(document)
    problem = problem_of(task.tables)
    if task.finer:
        from study.fem.mesh.mesher import mesh_size

        size = mesh_size(problem.setup) / problem.model.mesh_ratio
        problem = replace(problem, model=replace(problem.model, mesh_size_mm=size))
    solution = finite_element.solve(problem, gradients=True)
    return SolveResult(solution.status, solution.message, solution.curve).to_json()
