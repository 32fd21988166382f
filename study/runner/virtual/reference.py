"""Reference curve of virtual specimens: a finer model than any cell of the design."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from study.curve import Curve
from study.design.sections.virtual import Virtual
from study.errors import Fault, InputError
from study.execution.loky import Loky
from study.execution.task import Received, Task
from study.forward import finite_element
from study.runner.numerical.solve_task import SolveResult
from study.runner.virtual.truth import Truth
from study.setup.geometry import Block, Enclosed
from study.setup.section import table_of
from study.setup.setup import Setup, Tables, problem_of

#: plates of a reference curve for a design of a single test
_BONDED = {"interface": "bonded", "base": "bonded"}


def reference_curve(
    tables: Tables,
    material: Truth,
    poisson_ratio: float,
    *,
    as_designed: bool = False,
    virtual: Virtual | None = None,
) -> Curve:
    """Solve for the reference force and its gradient, in a worker of one thread.

    Parameters
    ----------
    tables : mapping
        Document of a cell.
    material : Truth
        What the specimens are made of.
    poisson_ratio : float
        Of that material.
    as_designed : bool
        Whether the test is that of the tables; otherwise the plates are bonded.
    virtual : Virtual, optional
        How it is solved; as without a table ``[virtual]`` by default.

    Raises
    ------
    InputError
        If the solver stops.
    """
    task = _task(tables, material, poisson_ratio, as_designed, virtual)
    return _solved(task, "the reference curve")


def reference_error(
    tables: Tables,
    material: Truth,
    poisson_ratio: float,
    curve: Curve,
    *,
    as_designed: bool,
    virtual: Virtual | None = None,
) -> float:
    """Largest change of the reference force on the next coarser mesh, over the largest force.

    The error of the reference itself is less wherever a finer mesh is a better one.

    Parameters
    ----------
    tables, material, poisson_ratio, as_designed, virtual
        Of :func:`reference_curve`.
    curve : Curve
        What it found.

    Raises
    ------
    InputError
        If the solver stops.
    """
    task = _task(tables, material, poisson_ratio, as_designed, virtual)
    coarser = replace(task, refined=task.refined - 1, gradients=False)
    other = _solved(coarser, "the reference curve on the next coarser mesh")
    change = other.force_at(curve.displacement_mm) - curve.force_N
    return float(np.abs(change).max() / np.abs(curve.force_N).max())


def _task(
    tables: Tables, material: Truth, poisson_ratio: float, as_designed: bool, asked: Virtual | None
) -> ReferenceTask:
    virtual, setup = asked or Virtual(), Setup.of(tables)
    # the grid runs a little past the range, as a real test does
    changes = {"steps": virtual.steps, "displacement_mm": 1.03 * setup.test.depth_mm}
    test = {**table_of(tables, "test"), **({} if as_designed else _BONDED), **changes}
    finer = as_designed and not virtual.chooses_mesh and not setup.is_homogeneous
    return ReferenceTask(
        {
            "specimen": tables["specimen"],
            "test": test,
            "material": {"model": material.model, "constants": dict(material.constants),
                         "poisson_ratio": poisson_ratio},
            "model": _reference_model(setup, virtual, as_designed),
        },
        int(finer),
    )  # fmt: skip


def _solved(task: ReferenceTask, what: str) -> Curve:
    (outcome,) = Loky(perform, 1).run([Task("reference", lambda _: task.to_json())])
    found = SolveResult.from_json(outcome.result)
    if not found.converged:
        rule = f"{what} failed: {found.message}"
        raise InputError(Fault("virtual specimens", rule))
    return found.curve


def _reference_model(setup: Setup, virtual: Virtual, as_designed: bool) -> dict[str, object]:
    """3D where the specimen is no body of revolution and that matters; the mesh of ``[virtual]``.

    Without one, and where every test is as the design has it, the mesh is the finest that the
    design uses, to be made finer still.
    """
    specimen, own = setup.specimen, setup.model
    corners = isinstance(specimen, Block) and setup.kind.takes_indenter
    solid = isinstance(specimen, Enclosed) or corners
    order = virtual.element_order
    found: dict[str, object] = {"space": "3d" if solid else "axisymmetric", "element_order": order}
    ratio = {"mesh_ratio": own.mesh_ratio}
    if virtual.mesh_size_mm is not None:
        return found | ratio | {"mesh_size_mm": virtual.mesh_size_mm}
    if virtual.mesh is not None:
        return found | ratio | {"mesh": virtual.mesh}
    if not as_designed:
        return {**found, "mesh": "fine"}
    return found | ratio | {"mesh": own.mesh, "mesh_size_mm": own.mesh_size_mm}


@dataclass(frozen=True)
class ReferenceTask:
    """The reference problem as it goes to a worker.

    Parameters
    ----------
    tables : mapping
        The problem.
    refined : int
        How often its mesh is made finer by one step, so that no cell of the design generates its
        own data; coarser where negative.
    gradients : bool
        Whether the derivatives by the constants are wanted.
    """

    tables: Tables
    refined: int
    gradients: bool = True

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return {"kind": "reference", **vars(self), "tables": dict(self.tables)}

    @classmethod
    def from_json(cls, document: Received) -> ReferenceTask:
        """Inverse of :meth:`to_json`."""
        return cls(document["tables"], int(document["refined"]), bool(document["gradients"]))


def perform(document: Received) -> dict[str, object]:
    """Solve the reference problem: a task for a worker.

    Parameters
    ----------
    document : mapping
        Of :meth:`ReferenceTask.to_json`.

    Returns
    -------
    dict
        Of :meth:`study.runner.numerical.solve_task.SolveResult.to_json`.
    """
    task = ReferenceTask.from_json(document)
    problem = problem_of(task.tables)
    if task.refined:
        from study.fem.mesh.mesher import mesh_size

        size = mesh_size(problem.setup) / problem.model.mesh_ratio**task.refined
        problem = replace(problem, model=replace(problem.model, mesh_size_mm=size))
    solution = finite_element.solve(problem, gradients=task.gradients)
    return SolveResult(solution.status, solution.message, solution.curve).to_json()
