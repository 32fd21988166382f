"""Where meshes are a factor, the study's own cases are its refinement series."""

import numpy as np
import pytest

from study.api.analyzing import analyze
from study.api.opened_study import load as open_study
from study.api.study import report
from study.harness.design.load import loads
from study.harness.runner.batch import expand, manifest_of
from study.harness.runner.study_refinement import own_series, refine
from study.record.store import Store
from study.simulation.tasks import processes
from study.simulation.virtual_specimens import usual_generator, write_virtual
from study.statistics.convergence.contrast_bound import response_bounds
from tests.forward.test_finite_element import DESIGN, finished
from tests.pages import both_pages

MESHES = 'material = ["neo-hookean", "reduced-polynomial-2"]\nmodel.mesh = ["fine", "coarse"{}]'
RESPONSE = ("relative_rms_force_error", "%")


def design_with(meshes):
    return loads(DESIGN.replace(MESHES.split("\n")[0], MESHES.format(meshes)), "cone.toml")


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    design, home = design_with(', "medium"'), tmp_path_factory.mktemp("data")
    write_virtual(design, home, usual_generator(design, blocks=2))
    return expand(design, home)


@pytest.fixture(scope="module")
def results(work):
    return work.data.root / "results"


@pytest.fixture(scope="module")
def records(work, results):
    return {record.case_id: record for record in finished(work, results)}


def test_columns_go_from_coarse_to_fine_under_one_block(work):
    series = own_series(work)
    assert [len(one.jobs) for one in series] == [3, 3]
    for jobs in (one.jobs for one in series):
        assert {job.case.block for job in jobs} == {work.blocks[0]}
        assert len({job.case.levels["material"] for job in jobs}) == 1
        sizes = [job.mesh_size_mm for job in jobs]
        assert sizes == sorted(sizes, reverse=True)


def test_uncertainty_is_that_of_the_finest_mesh_of_the_column(work, records):
    series = [one.taking(records) for one in own_series(work)]
    assert len(series) == 2
    for one in series:
        row, jobs = one.uncertainty(*RESPONSE), one.jobs
        own = [records[j.case.case_id].response(row.response) for j in jobs]
        assert row.series == tuple(own)
        assert row.value == own[-1]
        assert row.levels == {"material": jobs[0].case.levels["material"]}
        assert row.u_num is not None
        assert row.u_num > 0


def test_a_column_without_all_its_meshes_has_no_uncertainty(work, records):
    gone = own_series(work)[0].jobs[1].case.case_id
    kept = {k: r for k, r in records.items() if k != gone}
    first, second = (
        one.uncertainty(*RESPONSE) for one in [one.taking(kept) for one in own_series(work)]
    )
    assert (first.u_num, first.note) == (None, "2 of 3 meshes gave an answer")
    assert second.u_num is not None


def test_each_effect_of_the_study_is_held_against_its_own_contrast(
    work, records, results, tmp_path
):
    store = Store(results)
    refine(work, store, processes(1), lambda _: None)
    store.write_manifest(manifest_of(work))
    study = open_study(results)
    (response,) = study.analyses
    material, mesh, both = response.result.effects
    assert [e.term for e in (material, mesh, both)] == [
        "material", "model.mesh", "material:model.mesh",
    ]  # fmt: skip
    # a difference between meshes is itself an error of the discretization
    assert (mesh.u_num, both.u_num) == (0.0, 0.0)

    # by hand: the materials' difference of the means over both blocks, from coarse to fine
    def mean(name, level):
        found = [
            r.response(response.name)
            for r in records.values()
            if (r.levels["material"], r.levels["model.mesh"]) == (name, level)
        ]
        assert len(found) == 2
        return sum(found) / 2

    first, second = (level.label for level in work.design.factors[0].levels)
    meshes = ("coarse", "medium", "fine")
    apart = [mean(first, level) - mean(second, level) for level in meshes]
    jobs = [one.taking(records) for one in own_series(work)][0].jobs
    row = next(r for r in study.numerical if r.levels == {"material": first})
    sizes = row.mesh_size[::-1]

    def finest_first(values):
        return np.array(values[::-1])

    def bound(name):
        values = finest_first([mean(name, level) for level in meshes])
        noise = 0.01 * abs(float(values[0]))
        return float(response_bounds(values, sizes, row.formal_order, noise))

    # on meshes this coarse the changes of one cell grow with refinement: nothing bounds its limit,
    # so nothing is claimed of the difference, however small its own changes are
    assert np.isinf(bound(first))
    assert bound(second) > abs(apart[0] - apart[-1])
    assert abs(apart[-1] - apart[0]) < 0.02
    assert (material.u_num, material.verdict) == (None, "not resolved by the mesh")
    assert len(jobs) == 3
    assert material.range == pytest.approx(abs(sum(apart) / 3))
    rows = {v["factor"]: v["u_num"] for v in study.to_json()["verdicts"]}
    assert rows["material"] == material.u_num
    page = both_pages(report(study, reports=tmp_path).report or tmp_path)
    assert "U bounds the mesh error of the difference" in page
    again = analyze(results)
    assert [e.u_num for e in again.effects] == [e.u_num for e in response.result.effects]


def test_two_meshes_are_no_column(work):
    assert own_series(expand(design_with(""), work.data.root)) == []
