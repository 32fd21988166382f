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
    """Cells of the spaces' control that have no solution yet."""
    plain = work.plain()
    hashes = {job.case.case_id: job.input_hash for job in in_blocks(plain)}
    return upcoming(plain, store.on_demand(hashes), lambda task: is_kept(task, store))


def control_seconds(controls: Sequence[CaseJob], workers: int) -> float:
    """Wall time of the cells of the spaces' control."""
    costs = Costs()
    own = [costs.solve_seconds(job.case.config, job.depth_mm) for job in controls]
    return costs.side_by_side(own, workers)


def refinement_seconds(work: Work, store: Store, workers: int) -> float:
    """Wall time of the refined cases; none where the cells themselves are a series of meshes."""
    plain = work.plain()
    if own_series(plain, {}):
        return 0.0
    finer = refinement_work(plain)
    todo = missing(finer, store)
    return Costs().total_seconds(open_fits(todo, store), todo, workers)


def with_time_left(
    store: Store, progress: Callable[[Progress], None] | None, later: float
) -> Callable[[Progress], None]:
    """Progress that also counts ``later`` seconds, and is left beside the lock for others."""
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
    """Seconds that a runner still needs, from what it noted; None where it noted nothing."""
    said = runner or {}
    try:
        noted_at = datetime.datetime.fromisoformat(str(said["at"]))
        left = float(said["seconds_left"])
    except (KeyError, TypeError, ValueError):
        return None
    since = (datetime.datetime.now(datetime.UTC) - noted_at).total_seconds()
    return max(0.0, left - max(0.0, since))
