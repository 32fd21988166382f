"""One solution of a refinement series: what a worker gets, does and answers."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, cast

import numpy as np

from study.execution.local import Executor, Results, Task
from study.external.command import External
from study.ground.canonical import digest
from study.ground.curve import Curve
from study.ground.files import own_folder
from study.mechanics.forward import closed_form, finite_element
from study.mechanics.forward.finite_element import load_compiled
from study.record.store import Store
from study.simulation.cell import CellProblem, folder_name
from study.simulation.provenance import code_version

if TYPE_CHECKING:
    from study.mechanics.solver.newton import Options


@dataclass(frozen=True)
class SolveTask:
    """A solution as it goes to a worker, complete in itself."""

    #: With its element size and number of load steps.
    problem: CellProblem
    #: How much the solver's tolerance is multiplied by.
    looser: float = 1.0
    #: By how much what sticks divides the steps that it takes whatever is asked for.
    more_steps: int = 1
    #: Whether the derivatives of the force by the constants are wanted.
    gradients: bool = False

    @classmethod
    def of(
        cls, problem: CellProblem, size_mm: float, *, more_steps: int = 1, looser: float = 1.0
    ) -> SolveTask:
        """Make the task of a problem."""
        stepped = problem.alone().loaded(steps=problem.test.steps * more_steps)
        return cls(stepped.on_mesh(mesh_size_mm=size_mm), looser, more_steps)

    @property
    def key(self) -> str:
        """Name of the solution: a hash of the problem and of the code."""
        more = ["gradients"] if self.gradients else []
        document = self.problem.document()
        return digest([document, self.looser, self.more_steps, code_version(), *more], 32)


@dataclass(frozen=True)
class SolveResult:
    """What became of a solution."""

    #: ``"converged"``, or the reason why not.
    status: str
    message: str = ""
    curve: Curve = field(default_factory=lambda: Curve(np.zeros(0), np.zeros(0)))
    elements: int = 0
    dofs: int = 0
    #: Name of the mesh by its content.
    mesh_hash: str = ""
    seconds: float = 0.0
    #: Peak memory of the process, and what it took before.
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
    def from_json(cls, document: Mapping[str, object]) -> SolveResult:
        """Inverse of :meth:`to_json`; of a task that had no answer a status and a message stay."""
        fields = {k: v for k, v in document.items() if k in cls.__dataclass_fields__}
        if "curve" in fields:
            fields["curve"] = Curve.from_dict(cast("Mapping[str, object]", fields["curve"]))
        return cls(**fields)  # type: ignore[arg-type]


#: Solves some tasks and gives each result with the key of its task as soon as it is there.
Solver = Callable[[Sequence[SolveTask]], Iterable[tuple[str, SolveResult]]]


def solutions(solve: Solver, tasks: Sequence[SolveTask]) -> list[SolveResult]:
    """Results of some tasks in their order; equal ones are solved once."""
    by_key = dict(solve(list({task.key: task for task in tasks}.values())))
    return [by_key[task.key] for task in tasks]


def perform(task: SolveTask) -> dict[str, object]:
    """Solve: a task for a worker."""
    return solved(task).to_json()


def solved(task: SolveTask) -> SolveResult:
    """Solve; what did not converge is a status."""
    if External.of(task.problem) is not None:
        return SolveResult("failed", "another program predicts here; this solves with ours alone")
    problem = task.problem.at()
    load_compiled(problem)
    with contextlib.suppress(OSError), open("/proc/self/clear_refs", "w") as stream:
        stream.write("5")
    before = peak_MB()
    solution = finite_element.solve(problem, gradients=task.gradients, options=_options(task))
    return SolveResult(
        status=str(solution.status),
        message=str(solution.message),
        curve=solution.curve,
        elements=int(solution.elements),
        dofs=int(solution.dofs),
        mesh_hash=str(solution.mesh_hash),
        seconds=float(solution.seconds.get("total", 0.0)),
        memory_MB=peak_MB(),
        base_MB=before,
    )


def known_compression() -> tuple[str, str]:
    """Compress a cylinder and compare with the closed form."""
    config = {
        "specimen": {"shape": "cylinder", "radius_mm": 10.0, "height_mm": 10.0},
        "test": {"kind": "compression", "interface": "frictionless", "displacement_mm": 1.0,
                 "steps": 2},
        "material": {"model": "neo-hookean", "constants": {"C10": 0.01}, "poisson_ratio": 0.499},
        "model": {"space": "axisymmetric", "mesh_size_mm": 5.0},
    }  # fmt: skip
    problem = CellProblem.of(config).at()
    solution = finite_element.solve(problem)
    exact = closed_form.homogeneous(problem.specimen, problem.material, np.array([1.0]))
    error = abs(solution.curve.force_N[-1] / exact.force_N[0] - 1)
    finding = f"force within {error:.1e} of the closed form, by {solution.solver}"
    return ("pass" if error < 1e-6 else "fail"), finding


def _options(task: SolveTask) -> Options | None:
    """Solver settings of a looser tolerance or smaller steps; None for the usual ones."""
    if task.looser == 1.0 and task.more_steps == 1:
        return None
    from study.mechanics.solver.newton import Options

    usual = Options()
    newton = replace(usual.newton, tolerance=usual.newton.tolerance * task.looser)
    steps = replace(usual.steps, sticking=usual.steps.sticking / task.more_steps)
    return replace(usual, newton=newton, steps=steps)


def peak_MB() -> float:  # noqa: N802
    """Peak memory of this process in MB since it was reset."""
    with contextlib.suppress(OSError), open("/proc/self/status") as stream:
        for line in stream:
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) / 1024
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


# Where solutions of refinement series come from: this process, workers, or the store.

#: results that the same input gives again; memory and time may be better another day
LASTING = ("converged", "not-converged", "unstable", "lost-contact", "mesh-failed")


def in_process(tasks: Sequence[SolveTask]) -> Iterator[tuple[str, SolveResult]]:
    """Solve one after another in this process."""
    for task in tasks:
        yield task.key, solved(task)


def by_workers(executor: Executor) -> Solver:
    """Solve on several worker processes; a worker that dies costs its own solution only."""

    def payload(task: SolveTask) -> Callable[[Results], SolveTask]:
        return lambda results: task

    def solve(tasks: Sequence[SolveTask]) -> Iterator[tuple[str, SolveResult]]:
        work = [Task(task.key, payload(task)) for task in tasks]
        for outcome in executor.run(work):
            yield outcome.key, SolveResult.from_json(outcome.result)

    return solve


def kept(solve: Solver, store: Store) -> Solver:
    """Read what is stored, solve the rest, and store each result as it comes."""

    def looked_up(tasks: Sequence[SolveTask]) -> Iterator[tuple[str, SolveResult]]:
        missing = []
        for task in tasks:
            stored = store.read_solution(task.key)
            if stored is not None:
                yield task.key, SolveResult.from_json(stored)
            else:
                missing.append(task)
        for key, result in solve(missing) if missing else ():
            if result.status in LASTING:
                with store.lock():
                    store.write_solution(key, result.to_json())
            yield key, result

    return looked_up


def store_of(results: Path, name: str) -> Store:
    """Store of a problem or a design by its name."""
    return Store(own_folder(results, folder_name(name, "problem")))
