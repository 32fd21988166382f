"""Refinement under a study: what is refined, and how the uncertainty is made."""

from __future__ import annotations

from functools import partial
from pathlib import Path

import pytest

from study.harness.design.load import load
from study.harness.design.spec import Design
from study.harness.record.store import Store
from study.harness.runner import case_series, refinement, study_refinement
from study.harness.runner.batch import computed, run_batch
from study.harness.runner.case_series import refine_cases
from study.harness.runner.cost import Costs
from study.harness.runner.expansion import expand

from .conftest import fake

DESIGNS = Path(__file__).resolve().parents[2] / "designs"


def test_the_bonded_cells_of_the_first_block_are_refined(
    design: Design, data: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """All of them where that is cheap; else those of fewest and of most constants."""
    work = expand(design, data)
    chosen = study_refinement.chosen(work)
    bonded = [job for job in work.jobs
              if job.case.block == "M1" and job.case.levels["plates"] == "bonded"]  # fmt: skip
    assert {job.case.case_id for job in chosen} == {job.case.case_id for job in bonded}
    finer = study_refinement.refinement_work(work)
    sizes = [job.case.tested.model.mesh_size_mm for job in finer.jobs]
    base = refinement.base_size_mm(chosen[0])
    assert sizes == pytest.approx([base / 1.5, base / 1.5**2] * len(chosen))
    monkeypatch.setattr(study_refinement, "ALL_CELLS_S", 0.0)
    few = study_refinement.chosen(work)
    constants = [len(job.case.problem.calibrated_names) for job in bonded]
    found = [len(job.case.problem.calibrated_names) for job in few]
    assert found == [min(constants), max(constants)]
    assert not set(finer.input_hashes) & set(work.input_hashes)


def test_the_price_of_all_cells_is_not_that_of_the_first(tmp_path: Path) -> None:
    """Where the indenter sticks in every second case, a solution takes ten times as long."""
    work = expand(load(DESIGNS / "needle-geometry.toml"), tmp_path)
    cells, costs = study_refinement.meshed_cells(work), Costs()
    finest = [study_refinement.refined_series(work, cell, 2, {}).jobs[-1] for cell in cells]
    seconds = [costs.solve_seconds(job.case.tested) for job in finest]
    assert len(cells) * seconds[0] < study_refinement.ALL_CELLS_S < 0.5 * sum(seconds)
    assert len(study_refinement.chosen(work)) == study_refinement.FEW_CELLS


def test_numerical_uncertainty_covers_the_error_of_the_fake_solver(
    design: Design, one_mix: Path, tmp_path: Path
) -> None:
    work, store = expand(design, one_mix), Store(tmp_path / "results")
    run_batch(work, store, fake(2))
    series = study_refinement.study_series(work, store.by_case(work.input_hashes))
    refine_cases(series, partial(computed, work, store, fake(2), lambda _: None))
    row = series[-1].uncertainty("mu0", "kPa")
    # the fake solver is too stiff by 1e-3 of the mesh size: mu0 too low by that share
    size = row.mesh_size[0]
    true_error = row.value * 1e-3 * size if row.value is not None else 0.0
    assert row.behaviour == "monotone"
    assert row.u_num is not None
    assert true_error < row.u_num < 4 * true_error
    assert len(row.series) == 3


def test_two_meshes_give_a_cautious_bound() -> None:
    # f = 1 + 0.1 h at h = 1, 1/1.5: the error of the coarse one is 0.1
    _, u = case_series.half_width([1.1, 1 + 0.1 / 1.5], [1.5, 1.0], 2.0)
    # as of a contrast an order of 0.7 is assumed: thrice the distance to the limit
    assert u == pytest.approx(3 * (0.1 / 3) * (1 + 1 / (1.5**0.7 - 1)))


def test_a_series_without_an_order_takes_three_times_its_range() -> None:
    sizes = [1.0, 1 / 1.5, 1 / 1.5**2]
    behaviour, u = case_series.half_width([1.0, 1.2, 1.1], sizes, 1.0)
    assert behaviour == "oscillatory"
    assert u == pytest.approx(3 * 0.2)
    assert case_series.half_width([1.0, 1.2, 1.1], sizes, 1.0, "finest")[1] == pytest.approx(0.6)
    # order 0.1: not in the asymptotic range, so thrice the distance to a limit of order 0.5
    slow = [1.0, 1.1, 1.1 + 0.1 / 1.5**0.1]
    limit = slow[2] + (slow[2] - slow[1]) / (1.5**0.5 - 1)
    assert case_series.half_width(slow, sizes, 1.0)[1] == pytest.approx(3 * (limit - slow[0]))


def test_an_order_above_the_formal_one_is_not_believed_for_the_interval() -> None:
    # observed order 2.3 of 2: the error of the coarsest mesh by the formal one, twice
    values, sizes = [0.27074, 0.25925, 0.25352], [1.0, 1 / 1.35, 1 / 1.35**2]
    behaviour, u = case_series.half_width(values, sizes, 2.0)
    limit = values[2] - (values[1] - values[2]) / (1.35**2 - 1)
    assert behaviour == "monotone"
    assert u == pytest.approx(2 * (values[0] - limit), rel=1e-9)
