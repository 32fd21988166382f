"""Every cell of a study refined, and its comparison with the data (fake solver)."""

from dataclasses import replace
from operator import attrgetter

import numpy as np
import pytest

from study.api.converging import measured_cells
from study.api.opened_study import load as open_study
from study.ground.errors import InputError
from study.harness.design.load import loads
from study.harness.runner import record_analysis, study_refinement
from study.harness.runner.batch import expand, manifest_of, run_batch
from study.harness.runner.study_refinement import refine_within
from study.record.record import Record
from study.record.store import Store
from study.simulation.cell import Cell, CellProblem
from study.statistics.convergence.grid_convergence import compare

from .conftest import DESIGN, fake

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
