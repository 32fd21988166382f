"""Tasks on a Dask cluster that exists.

Tasks and results travel as text, so that workers share no disk with the study. A worker hands
its task to a process of its own (:mod:`study.execution.cluster.isolation`), where it dies, hangs
and is limited as on this machine. A slot stays with its worker, so that a task meets what the
last one of its group left there; where a worker is gone, its tasks are done once more elsewhere.
"""

from __future__ import annotations

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.execution.cluster.connection import Client, connected
from study.execution.cluster.versions import Identity
from study.execution.cluster.worker import Crew
from study.execution.queue import ReadyQueue
from study.execution.supervisor import Supervisor
from study.execution.task import Outcome, Perform, Results, Task, check_limit


@dataclass(frozen=True)
class Cluster:
    """Executor on the workers of a Dask cluster.

    Parameters
    ----------
    perform : callable
        Does one task; a function of a module that the workers can import.
    scheduler : str, Path or distributed.Client
        Address (``tls://host:8786``), scheduler file, or a client that is connected.
    identity : callable
        Versions of what decides a number; a worker with others is refused.
    jobs : int, optional
        Tasks at once; by default one a thread of the workers, of those that come later too.
    limit_s : float, optional
        Wall-clock limit of one task in seconds, which waiting for a worker does not use up.
    files : sequence of Path
        Files that tasks name by their whole path: every worker gets a copy, and tasks its name.
    """

    perform: Perform
    scheduler: str | Path | Client
    identity: Identity = dict
    jobs: int | None = None
    limit_s: float | None = None
    files: Sequence[Path] = ()

    def run(
        self, tasks: Sequence[Task], finished: Results | None = None
    ) -> Generator[Outcome, None, None]:
        """Yield the outcome of every task as it comes; ``close()`` stops this run's alone.

        Raises
        ------
        InputError
            If the limit is not a positive number, or the scheduler cannot be reached.
        RefusedError
            If versions of a worker differ from those of this machine.
        SchedulerLostError
            If the scheduler is lost; what was yielded stays good.
        """
        limit = check_limit(self.limit_s)
        with connected(self.scheduler) as client:
            crew = Crew(client, self.perform, self.identity, self.jobs, limit, self.files)
            try:
                crew.gather()
                ready = ReadyQueue(tasks, finished or {})
                yield from Supervisor(ready, [], arrivals=crew.arrivals).outcomes()
            finally:
                crew.dismiss()

    def slots(self) -> int:
        """Count the tasks that run at once, having waited for a worker and compared versions.

        Raises
        ------
        InputError
            If the scheduler cannot be reached.
        RefusedError
            If versions of a worker differ from those of this machine.
        """
        with connected(self.scheduler) as client:
            crew = Crew(client, self.perform, self.identity, self.jobs, None)
            crew.gather()
            return crew.wanted
