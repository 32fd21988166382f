"""What a study's numbers owe to its discretization: meshes refined, spaces compared."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

from study.analysis.convergence.grid_convergence import NumericalUncertainty
from study.reporting.numbers import percent
from study.reporting.text import listing
from study.runner.batch import Progress, computing
from study.runner.cost import Costs
from study.runner.numerical import refinement, space_comparison, study_refinement
from study.runner.numerical.case_series import COSTS, CaseSeries
from study.runner.numerical.solve_task import SolveResult, SolveTask
from study.runner.numerical.solver import by_workers, is_kept, kept
from study.runner.tasks import default_jobs
from study.study_result.report_data import Check

if TYPE_CHECKING:
    from study.execution.task import Executor
    from study.record.store import Store
    from study.runner.job import Work


#: 3D and axisymmetric space on one cylinder may differ by so much
SPACES_TOLERANCE = 0.005


def refine(
    work: Work,
    store: Store,
    jobs: int | None,
    progress: Callable[[Progress], None] | None,
    timeout_s: float | None,
    executor: Executor | None = None,
) -> None:
    """Compute the refined cases and store what they say of every response.

    Parameters
    ----------
    work : Work
        The study without its replicates, whose cases are computed.
    store : Store
        Its results; the rows go into it as ``numerical``.
    jobs : int or None
        Worker processes; None for one a core.
    progress : callable or None
        Called after every computation.
    timeout_s : float or None
        Wall-clock limit of one computation in seconds; None for none.
    executor : Executor, optional
        Where cases are computed; by default ``jobs`` processes of this machine.
    """
    series = study_refinement.study_series(work, store.on_demand(work.input_hashes))
    compute = computing(
        work, store, jobs=jobs, progress=progress, timeout_s=timeout_s, executor=executor
    )
    refinement.refine(series, compute)
    with store.lock():
        store.write_rows("numerical", [asdict(row) for row in uncertainties(work, series)])


def uncertainties(work: Work, series: Sequence[CaseSeries]) -> list[NumericalUncertainty]:
    """Numerical uncertainty of every response that a study asks for, by series.

    Parameters
    ----------
    work : Work
        Says responses and their units; ``seconds`` and ``dofs`` are left out.
    series : sequence of CaseSeries
        With the records of their meshes.
    """
    names = [one.name for one in work.design.responses if one.name not in COSTS]
    return [one.uncertainty(name, work.responses[name]) for one in series for name in names]


def compare_spaces(
    work: Work,
    store: Store,
    jobs: int | None,
    progress: Callable[[Progress], None] | None = None,
    executor: Executor | None = None,
) -> None:
    """Solve the equivalent cylinder of a block in both spaces, where a study holds both.

    Parameters
    ----------
    work : Work
        The study without its replicates, whose cases are computed.
    store : Store
        Its results; the solutions are kept in it, and the rows as ``spaces``.
    jobs : int or None
        Worker processes; None for one a core.
    progress : callable, optional
        Called before the first solution, and after every one that was not stored already.
    executor : Executor, optional
        Where solutions are made; by default ``jobs`` processes of this machine.
    """
    pairs = space_comparison.pairs(work, store.on_demand(work.input_hashes))
    if not pairs:
        return
    workers = jobs or default_jobs()
    # the solids take longest: all of them first
    tasks = [pair.tasks[k] for k in (1, 0) for pair in pairs]
    todo = [task for task in tasks if not is_kept(task, store)]
    watch = _Watch(todo, workers, progress or (lambda state: None))
    found: dict[str, SolveResult] = {}
    for key, result in kept(by_workers(workers, executor), store)(tasks):
        found[key] = result
        watch.finished(key)
    rows = [
        space_comparison.compared(pair, *(found[task.key] for task in pair.tasks)) for pair in pairs
    ]
    with store.lock():
        store.write_rows("spaces", [asdict(row) for row in rows])


class _Watch:
    """Progress of solutions whose time is predicted, the first line before any is there."""

    def __init__(
        self,
        tasks: Sequence[SolveTask],
        workers: int,
        progress: Callable[[Progress], None],
    ) -> None:
        costs = Costs()
        self._side_by_side = costs.side_by_side
        self._left = {task.key: costs.solve_seconds(task.tables) for task in tasks}
        self._total, self._workers, self._progress = len(self._left), workers, progress
        self._began = time.monotonic()
        if tasks:
            self._say()

    def finished(self, key: str) -> None:
        """Say what is left after one more; what was stored already was not waited for."""
        if self._left.pop(key, None) is not None:
            self._say()

    def _say(self) -> None:
        left = self._side_by_side(list(self._left.values()), self._workers)
        done, seconds = self._total - len(self._left), time.monotonic() - self._began
        label = "one cylinder in both spaces, a control"
        self._progress(Progress(done, self._total, 0, seconds, left, label))


def checks_of_spaces(rows: tuple[Mapping[str, Any], ...]) -> Iterator[Check]:
    """One check for every kind of element: 3D equals axisymmetric space on a cylinder.

    Parameters
    ----------
    rows : tuple of mapping
        Stored rows of :func:`compare_spaces`. One passes where the forces differ by at most 0.5 %
        beyond half the depth, its end included.
    """
    for row in rows:
        kind = listing(list(row["levels"].values())) or "the study's elements"
        name = f"3D equals axisymmetric space on a cylinder ({kind})"
        if row["at_end"] is None or row["largest"] is None:
            yield Check(name, "caution", f"it could not be looked at: {row['message']}")
            continue
        flat, solid = row["unknowns"]
        worst = max(abs(row["at_end"]), abs(row["largest"]))
        good = worst <= SPACES_TOLERANCE
        told = (
            f"the forces on the cylinder of the same cross-section differ by "
            f"{percent(row['at_end'], 2)} at {row['depth_mm']:g} mm and by at most "
            f"{percent(abs(row['largest']), 2)} beyond half the depth "
            f"({solid:,} against {flat:,} unknowns)"
        )
        mend = "" if good else "so much of the effect of the space is that of the discretization"
        yield Check(name, "pass" if good else "caution", told, mend)
