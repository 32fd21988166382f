"""The verbs about studies on a real one: plan, run, status, report, analyze, why."""

from __future__ import annotations

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from study import api
from study.harness.record.document import FitDocument
from study.harness.record.record import Record
from study.harness.record.store import Store
from tests.cli.small import TRUTH, Answer, Finished, incompressible_force, study

STUDY_KEYS = {"study", "cases", "predicted_seconds", "report", "verdicts", "warnings"}
COUNTS = {"total", "done", "failed", "missing"}
VERDICT_KEYS = {"response", "factor", "verdict", "effect", "ci95", "practical", "u_num", "p"}


def good(answer: Answer) -> Answer:
    assert answer.code == 0, answer.err
    return answer


def stamps(folder: Path) -> dict[str, int]:
    """When each file of the records was last written."""
    files = [p for p in (folder / "results" / "small" / "cases").rglob("*") if p.is_file()]
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in files}


def test_plan_counts_cases_and_writes_nothing(home: Path) -> None:
    asked = ("plan", "small.toml", "--data", "data")
    found = good(study(*asked, "--json")).json
    assert set(found) >= STUDY_KEYS
    # 2 energies x 2 ranges x 3 mixes
    assert found["cases"] == {"total": 12, "done": 0, "failed": 0, "missing": 12}
    assert found["blocks"] == ["M1", "M2", "M3"]
    assert found["predicted_seconds"] > 0
    assert found["warnings"] == []
    words = good(study(*asked)).out
    for said in ("Does the energy or the range matter?", "mooney-rivlin / large", "predicted:",
                 "12 cases: 0 done, 0 failed, 12 missing", "3 blocks: M1, M2, M3"):  # fmt: skip
        assert said in words
    assert sorted(p.name for p in home.iterdir()) == [
        "calibration.toml", "data", "problem.toml", "small.toml",
    ]  # fmt: skip


def test_plan_without_the_measurements_counts_cells_and_says_so(home: Path) -> None:
    answer = good(study("plan", "small.toml", "--json"))
    assert answer.json["cases"]["total"] == 4
    assert answer.json["predicted_seconds"] is None
    assert "no file 'tests.csv'" in answer.err
    assert "--data DIR" in answer.err


def test_run_gives_the_document_of_the_contract(finished: Finished) -> None:
    found = good(finished.answer).json
    assert set(found) >= STUDY_KEYS
    assert set(found["cases"]) == COUNTS
    assert found["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert (finished.folder / found["report"]).is_file()
    assert {row["factor"] for row in found["verdicts"]} >= {"material", "range"}
    assert all(set(row) >= VERDICT_KEYS for row in found["verdicts"])
    assert "12/12 cases, 12/12 calibrations" in finished.answer.err


def test_run_scores_what_was_measured(finished: Finished) -> None:
    table = api.load(finished.folder / "results" / "small").table
    d = np.linspace(0.3, 6.0, 30)
    for mix in ("M1", "M2", "M3"):
        a, b = (incompressible_force(*TRUTH[mix, s], d) for s in "AB")
        expected = 100 * np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2))
        rows = table[(table.material == "mooney-rivlin") & (table.range == "large")]
        got = rows.set_index("block").relative_rms_force_error[mix]
        # the samples every 0.1 mm are joined by straight lines: some 1e-4 of the force
        assert got == pytest.approx(expected, rel=5e-3)


def test_running_again_computes_only_what_is_missing(done: Path) -> None:
    before = stamps(done)
    gone = sorted((done / "results" / "small" / "cases").iterdir())[:3]
    for case in gone:
        shutil.rmtree(case)
    plan = study("plan", "small.toml", "--data", "data", "--json").json
    assert plan["cases"] == {"total": 12, "done": 9, "failed": 0, "missing": 3}
    assert plan["fits"] == 0
    answer = good(study("run", "small.toml", "--data", "data", "--jobs", 1, "--json"))
    assert answer.json["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert "3/3 cases" in answer.err
    after = stamps(done)
    assert after.keys() == before.keys()
    changed = {Path(name).parts[3] for name in after if after[name] != before[name]}
    assert changed == {case.name for case in gone}


@pytest.mark.parametrize("path", ["small", "results/small", "small.toml"])
def test_status_by_name_folder_and_design(done: Path, path: str) -> None:
    found = good(study("status", path, "--json")).json
    assert set(found) >= STUDY_KEYS
    assert found["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert found["running"] is None
    assert "12 cases: 12 done" in good(study("status", path)).out


def test_report_again_without_computing(done: Path) -> None:
    before = stamps(done)
    shutil.rmtree(done / "reports")
    answer = good(study("report", "small", "--format", "csv", "--json"))
    assert (done / answer.json["report"]).is_file()
    assert stamps(done) == before


def test_analyze_a_study(done: Path) -> None:
    found = good(study("analyze", "small", "--json")).json
    terms = [row["term"] for row in found["anova"]["rows"]]
    assert {"material", "range", "material:range"} <= set(terms)
    other = study("analyze", "small", "--response", "work_eror")
    assert other.code == 2
    assert "did you mean 'work_error'?" in other.err


def test_why_explains_a_case(done: Path) -> None:
    case = sorted((done / "results" / "small" / "cases").iterdir())[0].name
    words = good(study("why", case[:8])).out
    assert f"case {case} of small: converged" in words
    for name in ("material = ", "range = ", "block = M", "relative_rms_force_error", "calibration"):
        assert name in words
    record = good(study("why", case, "--json")).json
    assert record["case_id"] == case
    assert record["status"] == "converged"


def test_why_explains_a_fit_to_resampled_residuals(home: Path) -> None:
    fit: FitDocument = {
        "key": "f1",
        "message": "converged in 3 steps",
        "values": {"C10": 0.005},
        "identifiable": True,
    }
    store = Store(home / "results" / "small")
    store.write(Record("a1b2", "small", fit={"A": fit}, extra={"noise_seed": 3}))
    store.path.joinpath("study.json").touch()
    words = good(study("why", "a1b2", "--study", "small")).out
    assert "calibration on A: converged in 3 steps; identifiable" in words


def test_why_of_an_unknown_case_lists_the_known_ones(done: Path) -> None:
    answer = study("why", "zzz")
    assert answer.code == 2
    assert "no case has an id that begins with" in answer.err
    assert sorted((done / "results" / "small" / "cases").iterdir())[0].name in answer.err


@pytest.mark.parametrize("verb", ["status", "report", "analyze"])
def test_no_results_say_where_they_were_looked_for(home: Path, verb: str) -> None:
    answer = study(verb, "small")
    assert answer.code == 2
    assert "looked in small, results/small" in answer.err
    assert "run the design first" in answer.err


def test_cases_stopped_by_the_clock_are_failures_with_a_reason(home: Path) -> None:
    path = home / "data" / "tests.csv"
    lines = path.read_text().splitlines()
    path.write_text("\n".join(x for x in lines if x.startswith(("mix", "M1"))))
    answer = study("run", "small.toml", "--data", "data", "--jobs", 1, "--timeout", 1e-4, "--json")
    assert answer.code == 1, answer.err
    assert answer.json["cases"] == {"total": 4, "done": 0, "failed": 4, "missing": 0}
    state = study("status", "small", "--json").json
    assert sum(state["failures"].values()) == 4
    case = sorted((home / "results" / "small" / "cases").iterdir())[0].name
    assert "timeout" in study("why", case).out


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        (["--timeout", "nan"], "positive number of seconds"),
        (["--timeout", "0"], "positive number of seconds"),
        (["--timeout", "-1"], "positive number of seconds"),
        (["-s", 'report.format = ["docx"]'], "docx"),
        (["-s", "specimen.radius = 1e200 mm"], "too large for any test"),
        (["-s", "specimen.radius = 1e-200 mm"], "too small for any test"),
    ],
)
def test_what_cannot_be_run_is_refused_before_anything_is_written(
    home: Path, flags: list[str], said: str
) -> None:
    answer = study("run", "small.toml", "--data", "data", "--jobs", 1, *flags)
    assert answer.code == 2
    assert said in answer.err
    assert not (home / "results").exists()


def test_a_report_that_cannot_be_written_is_no_success(done: Path) -> None:
    (done / "blocked").write_text("a file where a folder is asked for")
    answer = study("report", "small", "--reports", "blocked")
    assert answer.code == 1
    assert "the report could not be written" in answer.err


@pytest.mark.parametrize("below", ["small", "small/small-data"])
def test_a_link_does_not_lead_a_report_out_of_its_folder(done: Path, below: str) -> None:
    other = done / "other"
    other.mkdir()
    (other / "made-from.json").write_text("not of this report")
    link = done / "linked" / below
    link.parent.mkdir(parents=True)
    link.symlink_to(other)
    answer = study("report", "small", "--reports", "linked")
    assert answer.code == 1
    assert "a link leads outside" in answer.err
    assert [path.name for path in other.iterdir()] == ["made-from.json"]


def test_a_link_does_not_lead_results_out_of_their_folder(home: Path) -> None:
    (home / "other").mkdir()
    (home / "results").mkdir()
    (home / "results" / "small").symlink_to(home / "other")
    answer = study("run", "small.toml", "--data", "data", "--jobs", 1)
    assert answer.code == 2
    assert "a link leads outside results" in answer.err
    assert list((home / "other").iterdir()) == []


def test_the_folder_that_the_user_names_may_be_a_link(done: Path) -> None:
    (done / "disk").mkdir()
    (done / "linked").symlink_to(done / "disk")
    good(study("report", "small", "--reports", "linked"))
    assert (done / "disk" / "small" / "small-data" / "numbers.json").is_file()


def test_what_an_interrupted_report_left_is_not_written_through(done: Path) -> None:
    good(study("report", "small", "--reports", "again"))
    note = done / "note.txt"
    note.write_text("mine")
    data = done / "again" / "small" / "small-data"
    (data / f".numbers.json.{os.getpid()}.part").symlink_to(note)
    (data / "numbers.json").unlink()
    good(study("report", "small", "--reports", "again"))
    assert note.read_text() == "mine"
    assert (data / "numbers.json").is_file()


def test_sorted_rows_are_a_warning_not_a_secret(home: Path) -> None:
    path = home / "data" / "tests.csv"
    lines = path.read_text().splitlines()
    lines[10], lines[11] = lines[11], lines[10]
    path.write_text("\n".join(lines) + "\n")
    answer = good(study("plan", "small.toml", "--data", "data", "--json"))
    assert "out of order sorted by displacement (in 1 of 12 tests)" in answer.err
