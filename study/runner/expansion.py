"""A design and its data -> every computation that is needed, each once, with its name."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from study.canonical import digest
from study.curve import Curve
from study.design.cases import case_id, cases, plain, treatments
from study.design.spec import Case, Design
from study.errors import Fault, InputError
from study.measurement.measured_test import MeasuredTest, Measurements
from study.runner import provenance
from study.runner.calibration.model_selection import LeftOut, distinct_tests, left_out
from study.runner.fitting.fit_task import FitProblem, fit_key, fit_problem, start_problem
from study.runner.job import CaseJob, DataCache, Direction, FitJob, Work
from study.runner.provenance import code_version
from study.runner.replicates import mesh_seeded, resampled
from study.runner.response import UNITS, is_plain
from study.setup.setup import Setup

Config = Mapping[str, Any]


def expand(design: Design, data_root: Path) -> Work:
    """List every case and every fit of a design.

    Raises
    ------
    InputError
        If data are missing or malformed, or the blocks differ between treatments.
    """
    data = DataCache(data_root, distinct_tests([t.config for t in treatments(design)]))
    found = _blocks(design, data)
    all_cases = mesh_seeded(_distinct(cases(design, found)), design)
    places = provenance.folders(design.source, data_root)
    all_cases = [(_located(case, places), extra) for case, extra in all_cases]
    fits: dict[str, FitJob] = {}
    responses = _responses(design)
    jobs = anchored([case_job(case, data, fits, responses, extra) for case, extra in all_cases])
    jobs += resampled(jobs, design, fits)
    return Work(design, jobs, fits, responses, found, data)


def _located(case: Case, places: Sequence[Path]) -> Case:
    return replace(case, config=provenance.located(case.config, places))


def _distinct(found: Sequence[Case]) -> list[Case]:
    """Give cells of equal content names of their own, so that none hides the other's record."""
    seen: set[str] = set()
    out = []
    for case in found:
        if case.case_id in seen:
            case = replace(case, case_id=case_id([case.case_id, case.levels]))
        seen.add(case.case_id)
        out.append(case)
    return out


def case_job(
    case: Case,
    data: DataCache,
    fits: dict[str, FitJob],
    responses: Mapping[str, str],
    extra: Mapping[str, Any] | None = None,
) -> CaseJob:
    """Directions of one case; its fits are added to ``fits``."""
    problem = fit_problem(case.config)
    directions = tuple(_directions(case, problem, data, fits))
    identity = [
        case.case_id,
        sorted(responses),
        [
            [d.label, d.fit_label, d.fit_key, d.measured.displacement_mm.tolist(),
             d.measured.force_N.tolist()]
            for d in directions
        ],
        code_version(),
        *provenance.fingerprints(case.config),
    ]  # fmt: skip
    return CaseJob(case, directions, digest(identity), dict(extra or {}))


def _directions(
    case: Case, problem: FitProblem, data: DataCache, fits: dict[str, FitJob]
) -> list[Direction]:
    scored = data.scored(case.config)
    if scored is None:
        rule = "the responses of a study compare with measured curves: there is no [measurements]"
        raise InputError(Fault("measurements", rule, "add it, or use `study solve`"))
    if problem.method == "none":
        _, test = scored.pairs(case.block)[0]
        return [_direction(test, scored.score, None, None)]
    if case.config["calibration"].get("leave_out"):
        return [_left_out(one, fits, case) for one in left_out(case, scored, data)]
    own = data.calibrated(case.config)
    if own is not None:
        fitted = own.curve(_block_in(own, case.block), **dict(own.fit or {}))
        key = _add_fit(problem, (fitted.curve,), fits, case)
        _, test = scored.pairs(case.block)[0]
        return [_direction(test, scored.score, key, None)]
    out = []
    sides = [(scored.fit, scored.score or scored.fit)]
    if scored.swap:
        sides.append((sides[0][1], sides[0][0]))
    for (fit, score), (fit_where, score_where) in zip(scored.pairs(case.block), sides, strict=True):
        key = _add_fit(problem, (fit.curve,), fits, case)
        role = "fit" if fit_where == score_where else "score"
        out.append(_direction(score, score_where, key, fit_where, role))
    return out


def _left_out(one: LeftOut, fits: dict[str, FitJob], case: Case) -> Direction:
    key = _add_fit(one.problem, one.measured, fits, case)
    return replace(_direction(one.test, one.score_where, key, None), fit_label=one.label)


def _direction(
    test: MeasuredTest,
    score_where: Mapping[str, Any] | None,
    key: str | None,
    fit_where: Mapping[str, Any] | None,
    role: str = "score",
) -> Direction:
    scatter = None if test.scatter_N is None else [float(v) for v in test.scatter_N]
    return Direction(_label(score_where), test.curve, key, role, _label(fit_where), scatter)


def _label(where: Mapping[str, Any] | None) -> str:
    if not where:
        return "all"
    values = [v if isinstance(v, (list, tuple)) else [v] for v in where.values()]
    return " ".join("+".join(str(item) for item in group) for group in values)


def _add_fit(
    problem: FitProblem, measured: tuple[Curve, ...], fits: dict[str, FitJob], case: Case
) -> str:
    key = fit_key(problem, measured)
    if key not in fits:
        before = start_problem(problem)
        start = None if before is None else _add_fit(before, measured, fits, case)
        fits[key] = FitJob(key, problem, measured, start, case.label)
    return key


def _block_in(found: Measurements, block: str | None) -> str | None:
    return block if found.block is not None else None


def _blocks(design: Design, data: DataCache) -> tuple[str, ...]:
    found: tuple[str, ...] | None = None
    for treatment in treatments(design):
        measured = data.scored(treatment.config)
        own = () if measured is None else measured.blocks
        if found is not None and own != found:
            rule = f"treatments have different blocks: {', '.join(found)} and {', '.join(own)}"
            raise InputError(Fault("measurements.block", rule))
        found = own
    return found or ()


def _responses(design: Design) -> dict[str, str]:
    """Responses of every record: those of a curve, mu0, and what the design asks besides."""
    asked = [response.name for response in design.responses]
    constants = [name for name in asked if name not in UNITS and name not in ("mu0", "seconds")]
    units = {**UNITS, "mu0": "kPa"}
    units |= {name: "" if is_plain(name) else "kPa" for name in constants}
    return units | ({"seconds": "s"} if "seconds" in asked else {})


def for_workers(config: Config) -> dict[str, Any]:
    """Make a configuration plain JSON."""
    made: dict[str, Any] = plain(config)
    return made


def anchored(jobs: Sequence[CaseJob]) -> tuple[CaseJob, ...]:
    """Give the cases of each cell their anchor: the fit of the first case's first direction.

    The anchor decides the last digits of a prediction and is therefore part of its identity.
    """
    groups = [_group(job) if _may_share_a_start(job) else "" for job in jobs]
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


def _may_share_a_start(job: CaseJob) -> bool:
    """Whether a prediction may start from the load steps of another specimen's."""
    return _is_simulated(job) and not Setup.of(job.case.config).has_close_equilibria


def _is_simulated(job: CaseJob) -> bool:
    """Whether every prediction of a case is a solution of its own, all of one depth."""
    config = job.case.config
    depths = {float(d.measured.displacement_mm.max()) for d in job.directions}
    problem = fit_problem(config)
    asked = (config.get("calibration") or {}).get("method") or "auto"
    closed = asked == "analytic" and Setup.of(config).is_homogeneous
    solved = problem.method == "inverse-fem" and problem.shares_scored_problem
    return len(depths) == 1 and not closed and not solved
