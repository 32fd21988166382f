"""A block's space effect beside that of a cylinder, which is the discretization's alone."""

import shutil

import numpy as np
import pytest

from study.api.assemble import checks_of_spaces
from study.api.planning import plan
from study.ground.curve import Curve
from study.harness.design.load import loads
from study.harness.runner.batch import Progress, expand
from study.harness.runner.study_refinement import (
    compare_spaces,
    compared_spaces,
    pairs,
    refinement_work,
    upcoming,
)
from study.record.store import Store
from study.simulation.solve_task import SolveResult, in_process, kept, solutions
from study.simulation.tasks import Costs, processes
from study.simulation.virtual_specimens import usual_generator, write_virtual
from tests.forward.test_finite_element import finished

DESIGN = """
schema = 1
study = { name = "slab" }
[specimen]
shape = "block"
width = "24 mm"
depth = "24 mm"
height = "10 mm"
[test]
kind = "compression"
interface = "bonded"
steps = 2
[material]
poisson_ratio = 0.4995
[presets.material]
neo-hookean = { model = "neo-hookean" }
mooney-rivlin = { model = "mooney-rivlin" }
[measurements]
files = "slab-{specimen}.csv"
columns = { displacement = "displacement_mm", force = "force_N" }
units = { displacement = "mm", force = "N" }
block = "specimen"
range = ["1 %", "10 %"]
[calibration]
method = "analytic"
problem.test = { kind = "compression", interface = "frictionless" }
[model]
element_order = "linear"
mesh = "coarse"
[factors]
material = ["neo-hookean", "mooney-rivlin"]
model.space = ["axisymmetric", "3d"]
[[response]]
name = "relative_rms_force_error"
"""


def work_of(text, home):
    design = loads(text, "slab.toml")
    write_virtual(design, home, usual_generator(design, blocks=2))
    return expand(design, home)


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Folder of the data, and below it that of the results."""
    return tmp_path_factory.mktemp("data")


@pytest.fixture(scope="module")
def work(home):
    return work_of(DESIGN, home)


@pytest.fixture(scope="module")
def results(home):
    return home / "results"


@pytest.fixture(scope="module")
def records(work, results):
    return {record.case_id: record for record in finished(work, results / "slab")}


def test_the_cylinder_has_the_blocks_section_and_the_cells_constants(work, records):
    (pair,) = pairs(work, records)
    assert pair[0] == {}
    for task, space in zip(pair[1], ("axisymmetric", "3d"), strict=True):
        config = task.problem.document()
        assert config["model"]["space"] == space
        assert config["specimen"]["radius_mm"] == pytest.approx(24 / 3.141592653589793**0.5)
        assert config["test"]["displacement_mm"] == pytest.approx(1.0, rel=0.05)
        assert set(config["material"]["constants"]) == {"C10"}


def test_the_control_says_how_far_it_is_and_is_solved_once(work, records, results, tmp_path):
    assert records
    shutil.copytree(results / "slab", tmp_path / "slab", ignore=lambda *_: {"solves"})
    store, said = Store(tmp_path / "slab"), list[Progress]()
    with store.lock():  # a run holds it from beginning to end
        compare_spaces(work, store, processes(1), said.append)
    assert [state.done for state in said] == [1, 2]
    assert all(state.total == 2 and "both spaces" in state.label for state in said)
    left = [state.seconds_left for state in said]
    assert left[0] > left[1] == 0
    assert store.read_json("spaces")
    again = []
    compare_spaces(work, store, processes(1), again.append)
    assert not again


def test_both_spaces_are_solved_and_compared(work, records):
    (pair,) = pairs(work, records)
    row = compared_spaces(pair, *solutions(in_process, pair[1]))
    assert row["unknowns"][1] > row["unknowns"][0]
    assert row["at_end"] is not None
    assert row["largest"] is not None
    assert abs(row["at_end"]) <= abs(row["largest"]) < 0.05
    (check,) = checks_of_spaces((row,))
    assert "1 mm" in check.finding
    assert check.outcome in ("pass", "caution")


def test_each_space_may_have_load_steps_of_its_own_or_fail(work, records):
    """Steps are added where a curve bends, and two spaces bend at different places."""
    (pair,) = pairs(work, records)

    def solution(d, stiffer):
        return SolveResult("converged", curve=Curve(np.array(d), stiffer * np.array(d)), dofs=9)

    row = compared_spaces(pair, solution([0.5, 1.0], 1.0), solution([0.5, 0.75, 1.0], 1.02))
    assert row["at_end"] == pytest.approx(0.02)
    assert row["largest"] == pytest.approx(0.02)
    bad = SolveResult("not-converged", "stopped at 0.4 mm", dofs=7)
    (check,) = checks_of_spaces((compared_spaces(pair, bad, bad),))
    assert check.outcome == "caution"
    assert "stopped at 0.4 mm" in check.finding


def test_the_outcome_follows_the_tolerance():
    row = {"levels": {}, "unknowns": [10, 99], "depth_mm": 4.0, "message": ""}
    near, far = checks_of_spaces(
        (row | {"at_end": 0.004, "largest": 0.004}, row | {"at_end": 0.004, "largest": -0.006})
    )
    assert (near.outcome, far.outcome) == ("pass", "caution")


def test_a_plan_counts_what_is_still_to_be_solved(work, home, records, results, tmp_path):
    before = plan(work.design, data=home, results=tmp_path, jobs=2)
    assert (before.controls, before.to_json()["controls"]) == (2, 2)
    # the longer of the two, the solid, runs beside the other
    both = upcoming(work, {}, Store(tmp_path))
    assert [job.case.tested.model.space for job in both] == ["axisymmetric", "3d"]
    costs = Costs()
    seconds = [costs.solve_seconds(job.case.tested, job.depth_mm) for job in both]
    assert seconds[1] > seconds[0]
    cases = Costs().total_seconds(work.fits.values(), work.jobs, 2)
    finer = refinement_work(work.plain())
    cases += Costs().total_seconds(finer.fits.values(), finer.jobs, 2)
    assert before.predicted_seconds == pytest.approx(cases + max(seconds[1], sum(seconds) / 2))

    assert plan(work.design, data=home, results=results).controls == 2
    (pair,) = pairs(work, records)
    list(kept(in_process, Store(results / "slab"))(pair[1][:1]))
    assert plan(work.design, data=home, results=results).controls == 1


def test_a_cylinder_needs_no_such_look(tmp_path, records):
    text = DESIGN.replace('width = "24 mm"\ndepth = "24 mm"', 'radius = "12 mm"')
    work = work_of(text.replace('"block"', '"cylinder"', 1), tmp_path)
    assert pairs(work, records) == []
    assert upcoming(work, {}, Store(tmp_path)) == []
