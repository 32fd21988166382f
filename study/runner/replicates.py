"""Repeats of every cell for an error term: other meshes, or fits to resampled noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from study.canonical import digest
from study.design.cases import MAX_CASES, case_id, plain
from study.design.spec import Case, Design
from study.errors import Fault, InputError

if TYPE_CHECKING:
    from study.runner.job import CaseJob, FitJob


def mesh_seeded(found: Sequence[Case], design: Design) -> list[tuple[Case, dict[str, Any]]]:
    """Every case on each of its meshes, with the number of the mesh; once where none are asked.

    Seeds are made of the study's seed and the cell: the meshes of one cell are the same in
    every block, and those of two cells have nothing to do with each other.

    Raises
    ------
    InputError
        If there are too many cases.
    """
    seeds = design.replicates.mesh_seeds
    if not seeds:
        return [(case, {}) for case in found]
    _check_count(len(found) * seeds)
    return [
        (_on_mesh(case, _seed(design, case, number)), {"mesh_seed": number})
        for case in found
        for number in range(1, seeds + 1)
    ]


def _check_count(count: int) -> None:
    if count > MAX_CASES:
        rule = f"{count} cases with their replicates are more than {MAX_CASES}"
        raise InputError(Fault("replicates", rule, "ask for fewer, or use fewer levels"))


def _seed(design: Design, case: Case, number: int) -> int:
    return int(digest([design.seed, plain(case.config), number], 8), 16)


def _on_mesh(case: Case, seed: int) -> Case:
    """Copy a case with the seed of its mesh in its configuration, and so in its name."""
    config = {**case.config, "model": {**case.config["model"], "mesh_seed": seed}}
    own = (config.get("calibration") or {}).get("problem")
    if own:
        changed = {**own, "model": {**own["model"], "mesh_seed": seed}}
        config["calibration"] = {**config["calibration"], "problem": changed}
    return replace(case, config=config, case_id=case_id([case.case_id, "mesh seed", seed]))


def resampled(
    jobs: Sequence[CaseJob], design: Design, fits: dict[str, FitJob]
) -> tuple[CaseJob, ...]:
    """Cases whose fits see resampled noise; their fits are added to ``fits``.

    The fit itself stays a case of its own: it is what the study is about, and replicates
    tell how far to trust it.

    Raises
    ------
    InputError
        If there are too many cases.
    """
    _check_count(len(jobs) * (1 + design.replicates.noise))
    numbers = range(1, design.replicates.noise + 1)
    return tuple(_again(job, design.seed, number, fits) for job in jobs for number in numbers)


def _again(job: CaseJob, seed: int, number: int, fits: dict[str, FitJob]) -> CaseJob:
    keys: dict[str, str] = {}
    for direction in job.directions:
        if direction.fit_key is not None:
            keys[direction.fit_key] = _add_refit(direction.fit_key, seed, number, fits)
    directions = tuple(
        replace(d, fit_key=None if d.fit_key is None else keys[d.fit_key]) for d in job.directions
    )
    identity = ["noise", seed, number]
    return replace(
        job,
        case=replace(job.case, case_id=case_id([job.case.case_id, "noise", number])),
        directions=directions,
        input_hash=digest([job.input_hash, *identity, sorted(keys.values())]),
        extra={**job.extra, "noise_seed": number},
        group="",
        anchor=None,
    )


def _add_refit(base: str, seed: int, number: int, fits: dict[str, FitJob]) -> str:
    key = digest([base, "noise", seed, number], 32)
    if key not in fits:
        fits[key] = replace(fits[base], key=key, start=base, noise=(seed, number))
    return key
