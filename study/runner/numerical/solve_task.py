"""One solution of a refinement series: what a worker gets, does and answers."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from study.canonical import digest
from study.curve import Curve
from study.execution.task import Received
from study.forward import finite_element
from study.forward.external import External
from study.forward.finite_element import load_compiled
from study.runner.provenance import code_version
from study.runner.tables import PROBLEM, on_mesh
from study.setup.section import with_table
from study.setup.setup import Setup, Tables, problem_of

if TYPE_CHECKING:  # it loads compiled kernels
    from study.fem.solver.options import Options


@dataclass(frozen=True)
class SolveTask:
    """A solution as it goes to a worker, complete in itself.

    Parameters
    ----------
    tables : mapping
        The problem, with its element size and number of load steps.
    looser : float
        How much the solver's tolerance is multiplied by.
    more_steps : int
        By how much what sticks divides the steps that it takes whatever is asked for.
    """

    tables: Tables
    looser: float = 1.0
    more_steps: int = 1

    @classmethod
    def of(
        cls, tables: Tables, size_mm: float, *, more_steps: int = 1, looser: float = 1.0
    ) -> SolveTask:
        """Make the task of a problem.

        Parameters
        ----------
        tables : mapping
            Resolved tables of the problem.
        size_mm : float
            Element size.
        more_steps : int
            How many load steps replace one of the problem.
        looser : float
            How much the solver's tolerance is multiplied by.
        """
        problem = {name: tables[name] for name in PROBLEM if name in tables}
        problem = with_table(problem, "test", steps=Setup.of(tables).test.steps * more_steps)
        return cls(on_mesh(problem, mesh=None, mesh_size_mm=size_mm), looser, more_steps)

    @property
    def key(self) -> str:
        """Name of the solution: a hash of the problem and of the code."""
        return digest([self.tables, self.looser, self.more_steps, code_version()], 32)

    def to_json(self) -> dict[str, object]:
        """Plain data for a worker."""
        return {
            "kind": "solve",
            "tables": dict(self.tables),
            "looser": self.looser,
            "more_steps": self.more_steps,
        }

    @classmethod
    def from_json(cls, document: Received) -> SolveTask:
        """Inverse of :meth:`to_json`."""
        return cls(document["tables"], float(document["looser"]), int(document["more_steps"]))


def _no_curve() -> Curve:
    return Curve(np.zeros(0), np.zeros(0))


@dataclass(frozen=True)
class SolveResult:
    """What became of a solution.

    Parameters
    ----------
    status, message : str
        ``"converged"``, or the reason why not.
    curve : Curve
        As far as it came.
    elements, dofs : int
        Of its mesh.
    mesh_hash : str
        Name of the mesh by its content.
    seconds : float
        Of the solution, compilation excluded.
    memory_MB, base_MB : float
        Peak memory of the process, and what it took before.
    """

    status: str
    message: str = ""
    curve: Curve = field(default_factory=_no_curve)
    elements: int = 0
    dofs: int = 0
    mesh_hash: str = ""
    seconds: float = 0.0
    memory_MB: float = 0.0  # noqa: N815
    base_MB: float = 0.0  # noqa: N815

    @property
    def converged(self) -> bool:
        """Whether it has an answer."""
        return self.status == "converged"

    def to_json(self) -> dict[str, object]:
        """Plain data, for the store."""
        return {**vars(self), "curve": self.curve.as_dict()}

    @classmethod
    def from_json(cls, document: Received) -> SolveResult:
        """Inverse of :meth:`to_json`; of a task that had no answer a status and a message stay."""
        known = {k: v for k, v in document.items() if k in cls.__dataclass_fields__}
        if "curve" in known:
            known["curve"] = Curve.from_dict(known["curve"])
        return cls(**known)


#: Solves some tasks and gives each result with the key of its task as soon as it is there.
Solver = Callable[[Sequence[SolveTask]], Iterable[tuple[str, SolveResult]]]


def solutions(solve: Solver, tasks: Sequence[SolveTask]) -> list[SolveResult]:
    """Results of some tasks in their order; equal ones are solved once.

    Parameters
    ----------
    solve : Solver
        Gives a result for every task, in any order.
    tasks : sequence of SolveTask
        Those with the same key are equal.
    """
    found = dict(solve(list({task.key: task for task in tasks}.values())))
    return [found[task.key] for task in tasks]


def perform(document: Received) -> dict[str, object]:
    """Solve: a task for a worker.

    Parameters
    ----------
    document : mapping
        Of :meth:`SolveTask.to_json`.

    Returns
    -------
    dict
        Of :meth:`SolveResult.to_json`.
    """
    return solved(SolveTask.from_json(document)).to_json()


def solved(task: SolveTask) -> SolveResult:
    """Solve; what did not converge is a status.

    Parameters
    ----------
    task : SolveTask
        Its material has all its constants. A problem that another program predicts is not solved:
        its status is ``"failed"``.

    Returns
    -------
    SolveResult
        Its curve has no derivatives by the constants.
    """
    if External.of(task.tables) is not None:
        return SolveResult("failed", "another program predicts here; this solves with ours alone")
    problem = problem_of(task.tables)
    load_compiled(problem)
    reset_peak()
    before = peak_MB()
    found = finite_element.solve(problem, gradients=False, options=_options(task))
    return SolveResult(
        status=str(found.status),
        message=str(found.message),
        curve=found.curve,
        elements=int(found.elements),
        dofs=int(found.dofs),
        mesh_hash=str(found.mesh_hash),
        seconds=float(found.seconds.get("total", 0.0)),
        memory_MB=peak_MB(),
        base_MB=before,
    )


def _options(task: SolveTask) -> Options | None:
    """Solver settings of a looser tolerance or smaller steps; None for the usual ones."""
    if task.looser == 1.0 and task.more_steps == 1:
        return None
    from study.fem.solver.options import Options

    usual = Options()
    newton = replace(usual.newton, tolerance=usual.newton.tolerance * task.looser)
    steps = replace(usual.steps, sticking=usual.steps.sticking / task.more_steps)
    return replace(usual, newton=newton, steps=steps)


def reset_peak() -> None:
    """Forget the peak memory of what this process did before; only Linux can."""
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")


def peak_MB() -> float:  # noqa: N802
    """Peak memory of this process in MB since :func:`reset_peak`."""
    with contextlib.suppress(OSError), open("/proc/self/status") as stream:
        for line in stream:
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
