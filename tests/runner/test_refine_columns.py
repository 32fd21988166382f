"""Where meshes are a factor, the study's own cases are its refinement series."""

from __future__ import annotations

from pathlib import Path

import pytest

from study.design import loads
from study.record import Record
from study.runner.expand import Work, expand
from study.runner.refine import base_size_mm
from study.runner.refine_columns import columns, fine_uncertainty, numerical_of_columns
from study.runner.virtual import usual_generator, write_virtual
from tests.runner.test_anchors import DESIGN, finished

MESHES = 'material = ["neo-hookean", "reduced-polynomial-2"]\nmodel.mesh = ["fine", "coarse"{}]'
UNITS = {"relative_rms_force_error": "%"}


def work_with(meshes: str, home: Path) -> Work:
    text = DESIGN.replace(MESHES.split("\n")[0], MESHES.format(meshes))
    design = loads(text, "cone.toml")
    write_virtual(design, home, usual_generator(design, blocks=2))
    return expand(design, home)


@pytest.fixture(scope="module")
def work(tmp_path_factory: pytest.TempPathFactory) -> Work:
    return work_with(', "medium"', tmp_path_factory.mktemp("data"))


@pytest.fixture(scope="module")
def records(work: Work, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Record]:
    found = finished(work, tmp_path_factory.mktemp("results"))
    return {record.case_id: record for record in found}


def test_columns_go_from_coarse_to_fine_under_one_block(work: Work) -> None:
    series = columns(work)
    assert [len(jobs) for jobs in series] == [3, 3]
    for jobs in series:
        assert {job.case.block for job in jobs} == {work.blocks[0]}
        assert len({job.case.levels["material"] for job in jobs}) == 1
        sizes = [base_size_mm(job.case) for job in jobs]
        assert sizes == sorted(sizes, reverse=True)


def test_uncertainty_is_that_of_the_finest_mesh_of_the_column(
    work: Work, records: dict[str, Record]
) -> None:
    rows = numerical_of_columns(columns(work), records, UNITS)
    assert len(rows) == 2
    for row, jobs in zip(rows, columns(work), strict=True):
        own = [records[j.case.case_id].response(row.response) for j in jobs]
        assert row.series == tuple(own)
        assert row.value == own[-1]
        assert row.levels == {"material": jobs[0].case.levels["material"]}
        assert row.u_num is not None
        assert row.u_num > 0


def test_a_column_without_all_its_meshes_has_no_uncertainty(
    work: Work, records: dict[str, Record]
) -> None:
    series = columns(work)
    kept = {k: r for k, r in records.items() if k != series[0][1].case.case_id}
    first, second = numerical_of_columns(series, kept, UNITS)
    assert (first.u_num, first.note) == (None, "2 of 3 meshes gave an answer")
    assert second.u_num is not None


def test_two_meshes_are_no_column(tmp_path: Path) -> None:
    assert columns(work_with("", tmp_path)) == []


def test_without_an_order_thrice_the_range_counts() -> None:
    behaviour, u = fine_uncertainty([1.0, 1.2, 1.1], [3.0, 2.0, 1.0])
    assert behaviour == "oscillatory"
    assert u == pytest.approx(0.6)
