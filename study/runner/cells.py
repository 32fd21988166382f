"""Which cases are one cell on several specimens, and whose constants its solution starts from."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from study.design import plain
from study.runner import build
from study.runner.fits import fit_problem
from study.runner.identity import digest

if TYPE_CHECKING:
    from study.runner.expand import CaseJob


def anchored(jobs: Sequence[CaseJob]) -> tuple[CaseJob, ...]:
    """Give the cases of each cell their anchor: the fit of the first case's first direction.

    The anchor decides the last digits of a prediction and is therefore part of its identity.
    """
    groups = [_group(job) if _is_simulated(job) else "" for job in jobs]
    solutions: Counter[str] = Counter()
    first: dict[str, CaseJob] = {}
    for job, group in zip(jobs, groups, strict=True):
        solutions[group] += len(job.directions)
        first.setdefault(group, job)
    return tuple(
        _with_anchor(job, group, first[group]) if group and solutions[group] > 1 else job
        for job, group in zip(jobs, groups, strict=True)
    )


def _with_anchor(job: CaseJob, group: str, leader: CaseJob) -> CaseJob:
    key = leader.directions[0].fit_key
    return replace(job, group=group, anchor=key, input_hash=digest([job.input_hash, key]))


def _group(job: CaseJob) -> str:
    return digest([plain(job.case.config), job.depth_mm], 32)


def _is_simulated(job: CaseJob) -> bool:
    """Whether every prediction of a case is a solution of its own, all of one depth."""
    config = job.case.config
    depths = {float(d.measured.displacement_mm.max()) for d in job.directions}
    problem = fit_problem(config)
    asked = (config.get("calibration") or {}).get("method") or "auto"
    closed = asked == "analytic" and build.is_homogeneous(config)
    solved = problem.method == "inverse-fem" and problem.shares_scored_problem
    return len(depths) == 1 and not closed and not solved
