"""Cases of a cell start from one solution: same answer, whatever was computed before."""

from functools import partial

import numpy as np
import pytest

from study.harness.design.load import loads
from study.harness.runner.batch import expand, run_batch
from study.mechanics.forward.finite_element import Anchors
from study.record.record import CurveKey, table
from study.record.store import Store
from study.simulation.tasks import processes
from study.simulation.virtual_specimens import usual_generator, write_virtual

DESIGN = """
schema = 1
study = { name = "cone" }
specimen = { shape = "cylinder", radius = "10 mm", height = "10 mm" }
[test]
kind = "indentation"
interface = "frictionless"
base = "bonded"
displacement = "1 mm"
steps = 4
indenter = { shape = "sphere", radius = "3 mm" }
[material]
poisson_ratio = 0.4995
[presets.material]
neo-hookean = { model = "neo-hookean" }
reduced-polynomial-2 = { model = "reduced-polynomial", order = 2 }
[measurements]
files = "indentation-{specimen}.csv"
columns = { displacement = "displacement_mm", force = "force_N" }
units = { displacement = "mm", force = "N" }
block = "specimen"
range = ["0.25 mm", "1 mm"]
points = 20
[calibration]
method = "auto"
problem.test = { kind = "compression", interface = "frictionless" }
[calibration.problem.measurements]
files = "compression-{specimen}.csv"
columns = { displacement = "displacement_mm", force = "force_N" }
units = { displacement = "mm", force = "N" }
block = "specimen"
range = ["1 %", "20 %"]
[model]
space = "axisymmetric"
mesh = "coarse"
[factors]
material = ["neo-hookean", "reduced-polynomial-2"]
[[response]]
name = "relative_rms_force_error"
practical = "2 pp"
"""


@pytest.fixture(scope="module")
def work(tmp_path_factory):
    home = tmp_path_factory.mktemp("data")
    design = loads(DESIGN, "cone.toml")
    write_virtual(design, home, usual_generator(design, blocks=3))
    return expand(design, home)


@pytest.fixture(scope="module")
def whole(work, tmp_path_factory):
    """Records of one worker: two may both solve a cell, each in a time of its own."""
    return finished(work, tmp_path_factory.mktemp("whole"), jobs=1)


def finished(work, folder, jobs=2):
    store = Store(folder)
    run_batch(work, store, processes(jobs))
    return store.records(work.input_hashes)


def test_cases_of_a_cell_share_the_fit_of_its_first_specimen(work):
    groups = {job.group for job in work.jobs}
    assert len(work.jobs) == 6
    assert len(groups) == 2
    for group in groups:
        cell = [job for job in work.jobs if job.group == group]
        anchors = {job.anchor.key for job in cell if job.anchor is not None}
        assert anchors == {cell[0].directions[0].fit_key}
        assert all(anchors <= {fit.key for fit in job.fits} for job in cell)


@pytest.mark.parametrize(("order", "shared"), [("linear", False), ("quadratic", True)])
def test_linear_solids_under_an_indenter_follow_their_own_load_path(order, shared, work):
    """Another specimen's load steps lead them to a neighbouring equilibrium, 0.2 to 0.8 % away."""
    text = DESIGN.replace('space = "axisymmetric"', f'space = "3d"\nelement_order = "{order}"')
    design = loads(text, "cone.toml")
    jobs = expand(design, work.data.root).jobs
    assert len(jobs) == 6
    assert all((job.anchor is not None) is shared for job in jobs)


def test_predictions_are_those_of_cold_solutions(work, whole):
    for record in whole:
        assert record.status == "converged", record.message
        job = next(j for j in work.jobs if j.case.case_id == record.case_id)
        assert record.fit is not None
        (fit,) = record.fit.values()
        problem_at = partial(job.case.tested.at, depth_mm=1.0)
        cold = Anchors().predict(problem_at, fit["values"], None).solution
        predicted = record.curves[CurveKey("predicted", "all")].force_N
        np.testing.assert_allclose(predicted, cold.curve.force_N, rtol=1e-6)


def test_a_resumed_study_gives_the_same_digits(work, whole, tmp_path):
    """Only the last specimens are missing: their anchor is made again, not taken from nearby."""
    store = Store(tmp_path)
    kept = [r for r in whole if r.block == "2"]
    for record in kept:
        store.write(record)
    resumed = finished(work, tmp_path, jobs=1)
    keep = ["case_id", "relative_rms_force_error", "peak_force_error"]
    both = [table(r).sort_values("case_id")[keep].to_csv(index=False) for r in (whole, resumed)]
    assert both[0] == both[1]


def test_seconds_of_a_case_are_those_of_the_cell_alone(whole):
    for levels in {r.levels["material"] for r in whole}:
        cell = [r.timings["predict"] for r in whole if r.levels["material"] == levels]
        assert max(cell) > 0
        assert min(cell) == max(cell)
