"""[execution] retry: what is tried of a failed case, its record, and that nothing is silent."""

from functools import partial

import numpy as np
import pytest

from study import api
from study.execution.local import Inline, Loky, stopped_late
from study.harness.design.load import loads
from study.harness.runner.batch import computed, expand, run_batch
from study.harness.runner.study_refinement import refine_cases, study_series
from study.record.store import Store
from tests.pages import both_pages

from .conftest import DESIGN, fake, make_data


def design(policy):
    return f"{DESIGN}\n[execution]\nretry = {{ {policy} }}\n"


@pytest.fixture
def ran(one_mix, tmp_path, monkeypatch):
    """Run a study whose solver misbehaves; how many cases were computed, and the records."""

    def run(wish, text, results="results"):
        (tmp_path / "wish").write_text(wish)
        monkeypatch.setenv("FAKE_WISH", str(tmp_path / "wish"))
        work, store = expand(loads(text, "small.toml"), one_mix), Store(tmp_path / results)
        count = run_batch(work, store, fake())
        return work, count, {r.case_id: r for r in store.records(work.input_hashes)}

    return run


def failed(records):
    return sum(not record.converged for record in records.values())


def bonded_mooney(records):
    (found,) = [
        r for r in records.values() if r.levels == {"material": "mooney-rivlin", "plates": "bonded"}
    ]
    return found


def test_smaller_steps_mend_a_case_and_its_record_says_so(ran):
    wish = "mooney-rivlin needs 40 steps"
    text = design('not-converged = ["smaller-steps", "finer-mesh"]')
    _, count, records = ran(wish, text)
    assert (count, failed(records)) == (4, 0)
    found = bonded_mooney(records)
    (note,) = found.retries
    assert note["cause"] == "not-converged"
    assert "no step was found" in note["message"]
    assert note["change"] == "smaller-steps"
    assert note["what"] == "40 load steps instead of 10"
    # it is a record of the planned case: nothing is computed again
    assert ran(wish, text)[1] == 0
    # every case of the other material is as it was designed
    assert [len(r.retries) for r in records.values()].count(0) == 2
    # the numbers are those of a study that asked for 40 steps at once
    expected = bonded_mooney(ran(wish, DESIGN.replace("steps = 10", "steps = 40"), "directly")[2])
    for name in ("mu0", "relative_rms_force_error"):
        assert found.response(name) == expected.response(name)


def test_changes_are_tried_one_after_the_other_and_add_up(ran):
    text = design('not-converged = ["smaller-steps", "finer-mesh"]')
    sized = text.replace('mesh = "coarse"', 'mesh_size = "8 mm"')
    _, _, records = ran("mooney-rivlin needs 6 mm", sized)
    assert failed(records) == 0
    found = bonded_mooney(records)
    assert [note["change"] for note in found.retries] == ["smaller-steps", "finer-mesh"]
    assert found.retries[1]["what"] == "elements of 5.333 mm instead of 8 mm"
    assert found.mesh["mesh_size_mm"] == pytest.approx(8 / 1.5)


def test_a_case_on_a_finer_mesh_says_nothing_of_the_error_of_its_own(ran, tmp_path):
    """Taken for the coarse mesh, it would hide the error that refinement has to show."""
    text = design('not-converged = "finer-mesh"').replace('mesh = "coarse"', 'mesh_size = "8 mm"')
    work, store = ran("mooney-rivlin needs 6 mm", text)[0], Store(tmp_path / "results")
    known = store.by_case(work.input_hashes)
    series = [one.taking(known) for one in study_series(work.plain())]
    compute = partial(computed, work.plain(), store, fake(), lambda _: None)
    refine_cases(series, compute)
    found = {one.base.case.levels["material"]: one for one in series}
    assert found["neo-hookean"].uncertainty("mu0", "kPa").u_num is not None
    lacking = found["mooney-rivlin"].uncertainty("mu0", "kPa")
    assert lacking.u_num is None
    judged = found["mooney-rivlin"].judge(work.design.converge, work.responses)
    assert "only a finer one did" in str(judged)


def test_a_case_that_nothing_mends_has_failed_with_all_that_was_tried(ran):
    text = design('not-converged = "smaller-steps"')
    _, _, records = ran("mooney-rivlin", text)
    assert failed(records) == 2
    found = bonded_mooney(records)
    assert (found.status, len(found.retries)) == ("not-converged", 1)
    # and it is not tried for ever
    assert ran("mooney-rivlin", text)[1] == 0


def test_without_a_policy_nothing_is_tried(ran):
    work, _, records = ran("mooney-rivlin needs 40 steps", DESIGN)
    assert failed(records) == 2
    assert all(not record.retries for record in records.values())
    # a policy that comes later changes no key: what failed is tried, nothing else is computed
    policy = design('not-converged = "smaller-steps"')
    later, count, records = ran("mooney-rivlin needs 40 steps", policy)
    assert later.input_hashes == work.input_hashes
    assert count == 0
    assert all(record.converged for record in records.values())


def test_a_task_that_lacked_memory_is_computed_alone(ran):
    """A fit and a case that the machine killed twice each, then with nothing else beside them."""
    text = design('crashed = "more-memory"').replace("swap = true", "")
    _, _, records = ran("mooney-rivlin needs memory", text)
    assert failed(records) == 0
    (note,) = bonded_mooney(records).retries
    assert note["cause"] == "crashed"
    assert note["what"] == "computed with nothing else beside it"


def late_between_bonded_plates(place, tasks, finished=None):
    """Do tasks here, of which those between bonded plates take more than 15 s."""

    def perform(task):
        late = place.limit_s == 15.0 and "bonded" in task.case.levels.values()
        return stopped_late(15.0) if late else place.perform(task)

    return Inline(perform).run(tasks, finished)


def doubled(problem):
    return 2.0 * np.asarray(problem["displacement_mm"])


def test_a_longer_limit_from_the_design_to_the_report(tmp_path, monkeypatch):
    monkeypatch.setattr(Loky, "run", late_between_bonded_plates)
    text = design('timeout = "longer-limit"').replace(
        'model = "mooney-rivlin"', 'model = "mooney-rivlin"\nC10 = "4 kPa"\nC01 = "1 kPa"'
    ).replace('model = "neo-hookean"', 'model = "neo-hookean"\nC10 = "5 kPa"')  # fmt: skip
    text = text.split('[[response]]\nname = "mu0"')[0] + text[text.index("[execution]") :]
    text += '[calibration]\nmethod = "none"\n[forward]\nmodel = "python"\n'
    (tmp_path / "small.toml").write_text(text)
    found = api.run(
        tmp_path / "small.toml", data=make_data(tmp_path, ("M1",)), results=tmp_path / "results",
        reports=tmp_path / "reports", forward=doubled, version="1", jobs=2,
        refine=False, timeout_s=15.0,
    )  # fmt: skip
    assert found.cases == {"total": 4, "done": 4, "failed": 0, "missing": 0}
    assert found.report is not None
    page = both_pages(found.report)
    assert "2 cases failed as designed and were computed with other settings" in page.replace(
        "\N{NO-BREAK SPACE}", " "
    )
    assert "a limit 4 times as long" in page
    assert "stopped after 15 s" in page
    csv = (found.report.parent / "small-data" / "table-retried.csv").read_text()
    assert csv.count("\n") == 3
