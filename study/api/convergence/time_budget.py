"""Refinement of a study's cells within a time budget, mesh by mesh, cheapest cells first.

Before anything is solved a cost is a prediction, which may be off by several times for a shape that
the predictions were never fitted to. From the first mesh on, a cell costs what its last mesh took,
times the predicted ratio of the two.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from itertools import accumulate

from study.record.record import Record
from study.runner.cost import Costs
from study.runner.job import CaseJob, fits_of
from study.runner.numerical.case_series import CaseSeries

Compute = Callable[[Sequence[CaseJob]], Sequence[Record | None]]


def refine_within(
    seconds: float, workers: int, series: Sequence[CaseSeries], compute: Compute
) -> list[CaseSeries]:
    """Refine cells as far as a time budget allows.

    Parameters
    ----------
    seconds : float
        The budget, wall time.
    workers : int
        Cases that run side by side.
    series : sequence of CaseSeries
        They take what is computed.
    compute : callable
        Records of some cases, in their order; None where there is none.

    Returns
    -------
    list of CaseSeries
        Those that have all of their meshes.
    """
    until, costs, ongoing = time.monotonic() + seconds, Costs(), list(series)
    predicted = {
        job.case.case_id: costs.total_seconds(fits_of([job]).values(), [job], 1)
        for one in series
        for job in one.jobs
    }
    for level in range(max((len(one.jobs) for one in series), default=0)):
        left = (until - time.monotonic()) * workers
        ongoing = _affordable(ongoing, [_price(one, level, predicted) for one in ongoing], left)
        steps = [one.jobs[level] for one in ongoing]
        for one, step, found in zip(ongoing, steps, compute(steps) if steps else (), strict=True):
            one.add(step, found)
    return ongoing


def _affordable(
    series: Sequence[CaseSeries], prices: Sequence[float], seconds: float
) -> list[CaseSeries]:
    """Cheapest series that fit into some worker seconds together."""
    order = sorted(range(len(series)), key=lambda i: prices[i])
    spent = accumulate(prices[i] for i in order)
    return [series[i] for i, sum_so_far in zip(order, spent, strict=True) if sum_so_far <= seconds]


def _price(one: CaseSeries, level: int, predicted: Mapping[str, float]) -> float:
    """Worker seconds of a cell's next mesh, its calibrations too."""
    names = [job.case.case_id for job in one.jobs]
    last = one.records.get(names[level - 1]) if level else None
    taken = None if last is None else last.timings.get("total")
    if taken is None:
        return predicted[names[level]]
    return taken * predicted[names[level]] / predicted[names[level - 1]]
