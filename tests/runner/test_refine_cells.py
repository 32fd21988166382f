"""Refinement under a study: which cells, what their series say, meshes that are a factor."""

from __future__ import annotations

from dataclasses import replace
from operator import attrgetter
from pathlib import Path

import numpy as np
import pytest

from study.api.analyzing import analyze
from study.api.converging import measured_cells
from study.api.opened_study import load as open_study
from study.api.study import report
from study.ground.errors import InputError
from study.harness.design.load import load, loads
from study.harness.runner import record_analysis, study_refinement
from study.harness.runner.batch import expand, manifest_of, run_batch
from study.harness.runner.study_refinement import own_series, refine, refine_within
from study.record.record import Record
from study.record.store import Store
from study.simulation.cell import Cell, CellProblem
from study.simulation.tasks import Costs, processes
from study.simulation.virtual_specimens import usual_generator, write_virtual
from study.statistics.convergence.contrast_bound import response_bounds
from study.statistics.convergence.grid_convergence import compare
from tests.forward.test_finite_element import DESIGN as CONES
from tests.forward.test_finite_element import finished
from tests.pages import both_pages

from .conftest import DESIGN, fake

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


#: the fake solver is too stiff by this part of the mesh size between bonded plates
ERROR = 1e-3


def test_every_cell_gets_its_series(design, one_mix, tmp_path):
    results = tmp_path / "results"
    found = measured_cells(design, one_mix, 2, results, lambda _: None, executor=fake())
    cells = {tuple(c["levels"].values()): c for c in found["cells"]}
    assert len(cells) == 4
    bonded = cells["neo-hookean", "bonded"]
    # forces follow 1 + 1e-3 h: first order, undone by the calibration, which mu0 pays for
    mu0 = bonded["quantities"]["mu0"]
    assert (bonded["behaviour"], mu0["behaviour"]) == ("noise-floor", "monotone")
    assert mu0["observed_order"] == pytest.approx(1, abs=0.05)
    exact = mu0["value"][0] * (1 + ERROR * mu0["mesh_size"][0])
    assert mu0["extrapolated"] == pytest.approx(exact, rel=1e-5)
    assert {"peak_force", "work", "curve_rms", "C10"} <= set(bonded["quantities"])
    assert cells["neo-hookean", "frictionless"]["behaviour"] == "noise-floor"
    assert found["left_out"] == []

    # and the study reads it
    work, store = expand(design, one_mix), Store(results / design.name)
    store.write_manifest(manifest_of(work))
    rows = open_study(store.path).numerical
    assert {tuple(r.levels) for r in rows} == {("material", "plates")}
    assert len({tuple(r.levels.values()) for r in rows}) == 4
    # of other cases it knows nothing
    assert record_analysis.stored_numerical(store, {"other": "hash"}) == ()


def test_a_time_budget_leaves_cells_out(one_mix, tmp_path):
    design = loads(DESIGN + '[converge]\nbudget = "1 ms"\n', "small.toml")
    found = measured_cells(design, one_mix, 1, tmp_path, lambda _: None, executor=fake())
    assert (found["cells"], len(found["left_out"])) == ([], 4)


def test_a_time_budget_believes_what_a_mesh_took(design, one_mix):
    """A cell whose first mesh took an hour is not refined, whatever was predicted of it."""
    work = expand(design, one_mix)
    series = study_refinement.every_series(work)
    slow, computed = series[0].base.case.case_id, []

    def compute(cases):
        computed.extend(case.case.case_id for case in cases)
        names = [one.case.case_id for one in cases]
        seconds = {name: 3600.0 if name == slow else 0.01 for name in names}
        return [Record(name, "small", timings={"total": seconds[name]}) for name in names]

    complete = refine_within(600.0, 2, series, compute)
    assert [one is series[0] for one in series if one not in complete] == [True]
    assert computed.count(slow) == 1
    assert len(computed) == 1 + 3 * (len(series) - 1)
    assert [len(one.records) for one in series] == [1, 3, 3, 3]


CONE = replace(CellProblem.of({
    "specimen": {"shape": "cylinder", "radius_mm": 25.0, "height_mm": 30.0},
    "test": {"kind": "indentation", "indenter": {"shape": "cone", "half_angle_deg": 30.0}},
    "material": {"model": "neo-hookean", "constants": {"C10": 5e-3}, "bulk_modulus_MPa": 10.0},
}), parameters={"h": 1.0})  # fmt: skip


@pytest.mark.parametrize(
    ("key", "value", "place", "expected"),
    [
        ("specimen.height", 0.5, "specimen.height_mm", 30.5),
        ("specimen.radius", -1.0, "specimen.radius_mm", 24.0),
        ("material.C10", 1e-4, "material.constants", {"C10": pytest.approx(5.1e-3)}),
        (
            "material.bulk_modulus",
            1,
            "material.compressibility.bulk_modulus_MPa",
            pytest.approx(11),
        ),
        ("test.indenter.half_angle", 2, "test.indenter.half_angle_deg", 32),
        ("parameters.h", 0.5, "parameters", {"h": 1.5}),
    ],
)
def test_inputs_are_moved_by_the_names_of_the_file(key, value, place, expected):
    assert attrgetter(place)(study_refinement.shifted(CONE, key, value)) == expected
    assert CONE.height_mm == 30.0
    with pytest.raises(InputError, match="no value in the design"):
        study_refinement.shifted(CONE, "specimen.width", 1)


def test_an_indenter_is_moved_where_the_constants_come_from_a_compression():
    """It was refused: the test of the constants has no indenter that could be uncertain."""
    pressed = CONE.loaded(kind="compression", indenter=None)
    cell = Cell(CONE, "auto", fitted_elsewhere=pressed)
    moved = study_refinement.moved_cell(cell, "test.indenter.half_angle", 2)
    assert moved.problem.test.indenter.half_angle_deg == 32
    assert moved.fitted_elsewhere == pressed
    both = study_refinement.moved_cell(cell, "specimen.height", 0.5)
    assert (both.problem.height_mm, both.fitted_elsewhere.height_mm) == (30.5, 30.5)


#: constants are given, and the radius is uncertain
GIVEN = (
    DESIGN.partition('[[response]]\nname = "mu0"')[0]
    .replace('model = "neo-hookean"', 'model = "neo-hookean"\nC10 = "8 kPa"')
    .replace('model = "mooney-rivlin"', 'model = "mooney-rivlin"\nC10 = "8 kPa"\nC01 = "0.5 kPa"')
    + '[calibration]\nmethod = "none"\n[uncertainty]\n"specimen.radius" = "0.1 mm"\n'
)


def test_validation_adds_numerics_inputs_and_data(one_mix, tmp_path):
    """The radius enters the force of given constants as its square: u_input = 2 u(R) / R."""
    text = GIVEN + '"measurements.force" = "0.02 N"\n'
    work, store = expand(loads(text, "small.toml"), one_mix), Store(tmp_path / "results")
    run_batch(work, store, fake())
    run_batch(study_refinement.refinement_work(work), store, fake())
    moved = study_refinement.input_work(work)
    assert {job.origin.input for job in moved.jobs} == {"specimen.radius"}
    run_batch(moved, store, fake())
    rows = {tuple(r["levels"].values()): r for r in study_refinement.compared(work, moved, store)}
    assert len(rows) == 4
    row = rows["neo-hookean", "bonded"]
    force = np.array(row["simulated_N"])
    np.testing.assert_allclose(row["u_input_N"], force * 2 * 0.1 / 25, rtol=5e-3)
    # two equal repeats: no scatter, so the load cell's uncertainty alone
    np.testing.assert_allclose(row["u_data_N"], 0.02, rtol=1e-6)
    h = study_refinement.chosen(work)[0].mesh_size_mm
    share = np.array(row["u_num_N"]) / force
    assert (share > ERROR * h / (1 + ERROR * h)).all()
    squares = sum(np.square(row[k]) for k in ("u_num_N", "u_input_N", "u_data_N"))
    np.testing.assert_allclose(row["u_val_N"], np.sqrt(squares))
    np.testing.assert_allclose(row["error_N"], force - np.array(row["measured_N"]), atol=1e-12)
    assert rows["neo-hookean", "frictionless"]["u_num_N"][-1] == 0
    assert "the model is off by E" in row["verdict"]


def test_where_the_meshes_are_a_factor_its_columns_are_the_numerics(one_mix, tmp_path):
    """Forces of given constants are too large by 1 + 1e-3 h: the share of every mesh is known."""
    text = GIVEN.replace('mesh = "coarse"\n', "").replace(
        "[factors]\n", '[factors]\nmodel.mesh = ["medium", "fine", "coarse"]\n'
    )
    work, store = expand(loads(text, "small.toml"), one_mix), Store(tmp_path / "results")
    moved = study_refinement.input_work(work)
    for part in (work, moved):
        run_batch(part, store, fake())
    rows = study_refinement.compared(work, moved, store)
    assert len(rows) == len(work.jobs) == 12
    sizes = {j.case.case_id: j.mesh_size_mm for j in work.jobs}
    for row in rows:
        share = np.array(row["u_num_N"]) / np.array(row["simulated_N"])
        if row["levels"]["plates"] == "frictionless":
            assert not share.any()
            continue
        off = ERROR * sizes[row["case_id"]]
        error = off / (1 + off)
        # factor 1.25 or 3 of the error of the finest mesh, and the way there
        assert (share > error).all()
        assert (share < 4 * error).all()
    # a column that lacks a mesh has no share, and its comparison says so
    gone = next(j for j in work.jobs if j.case.levels["plates"] == "bonded")
    records = store.by_case(work.input_hashes)
    del records[gone.case.case_id]
    series = [one.taking(records) for one in study_refinement.own_series(work)]
    assert sum(len(one.shares()) for one in series) == 3 * (len(series) - 1)


def test_comparison_says_what_is_unknown():
    d, known = np.array([1.0, 2.0]), np.full(2, 0.05)
    unknown = dict.fromkeys(("numerics", "inputs", "data"))
    found = compare(d, d, np.array([1.0, 1.99]), {**unknown, "inputs": known})
    assert found["unknown"] == ["numerics", "data"]
    assert "within u_val" in str(found["verdict"])
    assert "numerics, data not known" in str(found["verdict"])
    assert str(compare(d, d, d, unknown)["verdict"]).startswith("no uncertainty")
    assert compare(d, d + [0, 0.5], d, {**unknown, "numerics": 2 * known})["outside"] == 0.5


MESHES = 'material = ["neo-hookean", "reduced-polynomial-2"]\nmodel.mesh = ["fine", "coarse"{}]'
RESPONSE = ("relative_rms_force_error", "%")


def design_with(meshes):
    return loads(CONES.replace(MESHES.split("\n")[0], MESHES.format(meshes)), "cone.toml")


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
