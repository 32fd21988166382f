"""Refinement under a study: what is refined, and how the uncertainty is made."""

from pathlib import Path

import pytest

from study.harness.design.load import load
from study.harness.runner import study_refinement
from study.harness.runner.batch import expand
from study.simulation.tasks import Costs

DESIGNS = Path(__file__).resolve().parents[2] / "designs"


def test_the_bonded_cells_of_the_first_block_are_refined(design, data, monkeypatch):
    """All of them where that is cheap; else those of fewest and of most constants."""
    work = expand(design, data)
    chosen = study_refinement.chosen(work)
    bonded = [job for job in work.jobs
              if job.case.block == "M1" and job.case.levels["plates"] == "bonded"]  # fmt: skip
    assert {job.case.case_id for job in chosen} == {job.case.case_id for job in bonded}
    finer = study_refinement.refinement_work(work)
    sizes = [job.case.tested.model.mesh_size_mm for job in finer.jobs]
    base = chosen[0].mesh_size_mm
    assert sizes == pytest.approx([base / 1.5, base / 1.5**2] * len(chosen))
    monkeypatch.setattr(study_refinement, "ALL_CELLS_S", 0.0)
    few = study_refinement.chosen(work)
    constants = [len(job.case.problem.calibrated_names) for job in bonded]
    found = [len(job.case.problem.calibrated_names) for job in few]
    assert found == [min(constants), max(constants)]
    assert not set(finer.input_hashes) & set(work.input_hashes)


def test_the_price_of_all_cells_is_not_that_of_the_first(tmp_path):
    """Where the indenter sticks in every second case, a solution takes ten times as long."""
    work = expand(load(DESIGNS / "needle-geometry.toml"), tmp_path)
    cells, costs = study_refinement.meshed_cells(work), Costs()
    finest = [study_refinement.refined_series(work, cell, 2).jobs[-1] for cell in cells]
    seconds = [costs.solve_seconds(job.case.tested) for job in finest]
    assert len(cells) * seconds[0] < study_refinement.ALL_CELLS_S < 0.5 * sum(seconds)
    assert len(study_refinement.chosen(work)) == study_refinement.FEW_CELLS
