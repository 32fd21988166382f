"""Seconds that a study still needs: its refinements, its controls, and what was noted."""

from __future__ import annotations

import datetime
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from study.record.store import Store
from study.runner.batch import missing, open_fits
from study.runner.cost import Costs
from study.runner.numerical.solver import is_kept
from study.runner.numerical.space_comparison import in_blocks, upcoming
from study.runner.numerical.study_refinement import own_series, refinement_work

if TYPE_CHECKING:
    from study.runner.batch import Progress
    from study.runner.job import CaseJob, Work

#: seconds between two notes for other shells: nobody reads them faster
NOTED_S = 0.2


def controls_of(work: Work, store: Store) -> list[CaseJob]:
    """Cells of the spaces' control that have no solution yet.

    Parameters
    ----------
    work : Work
        The study; its replicates are left out.
    store : Store
        Its results.

    Returns
    -------
    list of CaseJob
        One for each cylinder to be solved; empty for a study without both spaces and a block.
    """
    plain = work.plain()
    hashes = {job.case.case_id: job.input_hash for job in in_blocks(plain)}
    return upcoming(plain, store.on_demand(hashes), lambda task: is_kept(task, store))


def control_seconds(controls: Sequence[CaseJob], workers: int) -> float:
    """Wall time of the cells of the spaces' control.

    Parameters
    ----------
    controls : sequence of CaseJob
        Of :func:`controls_of`.
    workers : int
        Solutions at once.

    Returns
    -------
    float
        Predicted seconds; no less than the longest solution takes.
    """
    costs = Costs()
    own = [costs.solve_seconds(job.case.config, job.depth_mm) for job in controls]
    return costs.side_by_side(own, workers)


def refinement_seconds(work: Work, store: Store, workers: int) -> float:
    """Wall time of the refined cases; none where the cells themselves are a series of meshes.

    Parameters
    ----------
    work : Work
        The study; its replicates are left out.
    store : Store
        Its results: refined cases that it holds cost nothing.
    workers : int
        Cases at once.

    Returns
    -------
    float
        Predicted seconds.
    """
    plain = work.plain()
    if own_series(plain, {}):
        return 0.0
    finer = refinement_work(plain)
    todo = missing(finer, store)
    return Costs().total_seconds(open_fits(todo, store), todo, workers)


def with_time_left(
    store: Store, progress: Callable[[Progress], None] | None, later: float
) -> Callable[[Progress], None]:
    """Progress that also counts ``later`` seconds, and is left beside the lock for others.

    Parameters
    ----------
    store : Store
        Results of the study, whose lock is held.
    progress : callable or None
        Called with every state; None calls nothing.
    later : float
        Seconds of what is computed after the part whose progress is told.

    Returns
    -------
    callable
        Takes the progress of a part. Notes for other shells are at least 0.2 s apart.
    """
    noted = -math.inf

    def note(state: Progress) -> None:
        nonlocal noted
        whole, now = replace(state, seconds_left=state.seconds_left + later), time.monotonic()
        if now - noted > NOTED_S or whole.done == whole.total:
            noted = now
            store.note(
                {
                    "done": whole.done,
                    "total": whole.total,
                    "counted": whole.counted,
                    "failed": whole.failed,
                    "label": whole.label[:80],
                    "seconds_left": round(whole.seconds_left, 1),
                    "at": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
                }
            )
        if progress is not None:
            progress(whole)

    return note


def seconds_left(runner: Mapping[str, Any] | None) -> float | None:
    """Seconds that a runner still needs, from what it noted; None where it noted nothing.

    Parameters
    ----------
    runner : mapping or None
        What its lock file says: ``seconds_left``, and the time ``at`` which that was noted (ISO
        text with a zone); None where no runner is at work.
    """
    said = runner or {}
    try:
        noted_at = datetime.datetime.fromisoformat(str(said["at"]))
        left = float(said["seconds_left"])
        since = (datetime.datetime.now(datetime.UTC) - noted_at).total_seconds()
    except (KeyError, TypeError, ValueError):
        return None
    return max(0.0, left - max(0.0, since))
