"""Repeats of every cell for an error term: other meshes, or fits to resampled noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from study.canonical import digest
from study.design.cases import MAX_CASES
from study.design.sections.content import plain
from study.design.spec import Case, Design
from study.errors import Fault, InputError
from study.runner.case_task import Origin
from study.runner.job import CaseJob, ScorePair, repeated
from study.runner.tables import on_mesh


def mesh_seeded(found: Sequence[Case], design: Design) -> tuple[tuple[Case, Origin], ...]:
    """Every case on each of its meshes, with the number of the mesh; once where none are asked.

    Seeds are made of the study's seed and the cell: the meshes of one cell are the same in
    every block, and those of two cells have nothing to do with each other.

    Parameters
    ----------
    found : sequence of Case
        Cases whose names differ.
    design : Design
        Gives the seed of the study and the number of meshes, ``replicates.mesh_seeds``.

    Raises
    ------
    InputError
        If there are too many cases.
    """
    seeds = design.replicates.mesh_seeds
    if not seeds:
        return tuple((case, Origin()) for case in found)
    _check_count(len(found) * seeds)
    return tuple(
        (_on_mesh(case, _seed(design, case, number)), Origin(mesh_seed=number))
        for case in found
        for number in range(1, seeds + 1)
    )


def _check_count(count: int) -> None:
    if count > MAX_CASES:
        rule = f"{count} cases with their replicates are more than {MAX_CASES}"
        raise InputError(Fault("replicates", rule, "ask for fewer, or use fewer levels"))


def _seed(design: Design, case: Case, number: int) -> int:
    return int(digest([design.seed, plain(case.config), number], 8), 16)


def _on_mesh(case: Case, seed: int) -> Case:
    """Copy a case with the seed of its mesh in its tables, and so in its name."""
    return repeated(case, ["mesh seed", seed], on_mesh(case.config, mesh_seed=seed))


def resampled(jobs: Sequence[CaseJob], design: Design) -> tuple[CaseJob, ...]:
    """Cases whose fits see resampled noise.

    The fit itself stays a case of its own: it is what the study is about, and replicates
    tell how far to trust it.

    Parameters
    ----------
    jobs : sequence of CaseJob
        Cases whose fits see the curves as measured.
    design : Design
        Gives the seed of the study and the number of copies of each case, ``replicates.noise``.

    Raises
    ------
    InputError
        If there are too many cases.
    """
    _check_count(len(jobs) * (1 + design.replicates.noise))
    numbers = range(1, design.replicates.noise + 1)
    return tuple(_again(job, design.seed, number) for job in jobs for number in numbers)


def refitted(case: Case, number: int) -> Case:
    """Copy a case whose fits see resampled noise.

    Parameters
    ----------
    case : Case
        The case whose fits see the curves as measured.
    number : int
        Which of its copies this is, from 1; it enters the name.
    """
    return repeated(case, ["noise", number])


def _again(job: CaseJob, seed: int, number: int) -> CaseJob:
    directions = tuple(_refitted(pair, seed, number) for pair in job.directions)
    keys = {pair.fit_key for pair in directions} - {None}
    return replace(
        job,
        case=refitted(job.case, number),
        directions=directions,
        input_hash=digest([job.input_hash, "noise", seed, number, sorted(map(str, keys))]),
        origin=replace(job.origin, noise_seed=number),
        group="",
        anchor=None,
    )


def _refitted(pair: ScorePair, seed: int, number: int) -> ScorePair:
    """Copy a pair with the fit to resampled residuals; one whose constants are given stays."""
    return pair if pair.fit is None else replace(pair, fit=pair.fit.resampled(seed, number))
