"""The verbs about studies on a real one: plan, run, status, report, analyze, why, diff."""

import html
import json
import os
import shlex
import shutil
from contextlib import chdir
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from study import api
from study.api import study as verb
from study.api.study import report
from study.execution.local import Worker
from study.record.record import Record
from study.record.store import Store
from tests.cli.small import (
    DESIGN,
    TRUTH,
    incompressible_force,
    refusal,
    study,
    success,
    write_files,
)
from tests.pages import both_pages

STUDY_KEYS = {"study", "cases", "predicted_seconds", "report", "verdicts", "warnings"}
COUNTS = {"total", "done", "failed", "missing"}
VERDICT_KEYS = {"response", "factor", "verdict", "effect", "ci95", "practical", "u_num", "p"}


def stamps(folder):
    """When each file of the records was last written."""
    files = [p for p in (folder / "results" / "small" / "cases").rglob("*") if p.is_file()]
    return {str(p.relative_to(folder)): p.stat().st_mtime_ns for p in files}


def test_plan_counts_cases_and_writes_nothing(home):
    asked = ("plan", "small.toml", "--data", "data")
    found = success(*asked, "--json").json
    assert set(found) >= STUDY_KEYS
    # 2 energies x 2 ranges x 3 mixes
    assert found["cases"] == {"total": 12, "done": 0, "failed": 0, "missing": 12}
    assert found["blocks"] == ["M1", "M2", "M3"]
    assert found["predicted_seconds"] > 0
    assert found["warnings"] == []
    words = success(*asked).out
    for said in ("Does the energy or the range matter?", "mooney-rivlin / large", "predicted:",
                 "12 cases: 0 done, 0 failed, 12 missing", "3 blocks: M1, M2, M3"):  # fmt: skip
        assert said in words
    assert sorted(p.name for p in home.iterdir()) == [
        "calibration.toml", "data", "problem.toml", "small.toml",
    ]  # fmt: skip
    answer = success("plan small.toml --json")  # without the measurements
    assert answer.json["cases"]["total"] == 4
    assert answer.json["predicted_seconds"] is None
    assert "no file 'tests.csv'" in answer.err
    assert "--data DIR" in answer.err


def test_a_report_of_records_that_are_lost_says_what_is_missing(done):
    shutil.rmtree(done / "results" / "small" / "cases")
    answer = study("report", "results/small", "--format", "html")
    assert "12 cases: 0 done, 0 failed, 12 missing" in answer.out
    assert "could not be written" not in answer.err
    assert "<h1>" in (done / "reports/small/small.html").read_text(encoding="utf-8")


def test_run_gives_the_document_of_the_contract(finished):
    found = finished.answer.json
    assert set(found) >= STUDY_KEYS
    assert set(found["cases"]) == COUNTS
    assert found["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert (finished.folder / found["report"]).is_file()
    assert {row["factor"] for row in found["verdicts"]} >= {"material", "range"}
    assert all(set(row) >= VERDICT_KEYS for row in found["verdicts"])
    assert "12/12 cases, 12/12 calibrations" in finished.answer.err


def test_run_scores_what_was_measured(finished):
    table = api.load(finished.folder / "results" / "small").table
    d = np.linspace(0.3, 6.0, 30)
    for mix in ("M1", "M2", "M3"):
        a, b = (incompressible_force(*TRUTH[mix, s], d) for s in "AB")
        expected = 100 * np.sqrt(np.mean((a - b) ** 2) / np.mean(b**2))
        rows = table[(table.material == "mooney-rivlin") & (table.range == "large")]
        got = rows.set_index("block").relative_rms_force_error[mix]
        # the samples every 0.1 mm are joined by straight lines: some 1e-4 of the force
        assert got == pytest.approx(expected, rel=5e-3)


def test_running_again_computes_only_what_is_missing(done):
    before = stamps(done)
    gone = sorted((done / "results" / "small" / "cases").iterdir())[:3]
    for case in gone:
        shutil.rmtree(case)
    plan = study("plan", "small.toml", "--data", "data", "--json").json
    assert plan["cases"] == {"total": 12, "done": 9, "failed": 0, "missing": 3}
    assert plan["fits"] == 0
    answer = success("run", "small.toml", "--data", "data", "--jobs", 1, "--json")
    assert answer.json["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert "3/3 cases" in answer.err
    after = stamps(done)
    assert after.keys() == before.keys()
    changed = {Path(name).parts[3] for name in after if after[name] != before[name]}
    assert changed == {case.name for case in gone}


@pytest.mark.parametrize("path", ["small", "results/small", "small.toml"])
def test_status_by_name_folder_and_design(done, path):
    found = success("status", path, "--json").json
    assert set(found) >= STUDY_KEYS
    assert found["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert found["running"] is None
    assert "12 cases: 12 done" in success("status", path).out


def test_report_and_analyze_again_without_computing(done):
    before = stamps(done)
    shutil.rmtree(done / "reports")
    answer = success("report small --format csv --json")
    assert (done / answer.json["report"]).is_file()
    found = success("analyze small --json").json
    terms = [row["term"] for row in found["anova"]["rows"]]
    assert {"material", "range", "material:range"} <= set(terms)
    other = refusal("analyze small --response work_eror")
    assert "did you mean 'work_error'?" in other.err
    assert stamps(done) == before


def test_a_practical_difference_is_read_in_the_unit_of_its_response(finished):
    """500 Pa of a modulus in kPa were taken for 500 kPa, so that nothing could matter."""
    asked = ("analyze", "results/small", "--response", "mu0", "--json", "--practical")
    for size in ("500 Pa", "0.5 kPa", "0.5"):
        effects = success(*asked, size, folder=finished.folder).json["effects"]
        assert {effect["practical"] for effect in effects} - {None} == {0.5}
    with chdir(finished.folder):
        fault = refusal(*asked, "2 mm").err
    assert "practical: is in mm, which is not of the kind of kPa" in fault


def test_why_explains_a_case(done):
    case = sorted((done / "results" / "small" / "cases").iterdir())[0].name
    words = success("why", case[:8]).out
    assert f"case {case} of small: converged" in words
    for name in ("material = ", "range = ", "block = M", "relative_rms_force_error", "calibration"):
        assert name in words
    record = success("why", case, "--json").json
    assert record["case_id"] == case
    assert record["status"] == "converged"
    unknown = refusal("why zzz").err
    assert "no case has an id that begins with" in unknown
    assert case in unknown
    ids = [path.name for path in (done / "results" / "small" / "cases").iterdir()]
    first = next(a for a in "0123456789abcdef" if sum(i[0] == a for i in ids) > 1)
    assert "begins several ids" in refusal(f"why {first}").err
    # a fit to resampled residuals
    fit = {
        "key": "f1", "message": "converged in 3 steps", "values": {"C10": 0.005},
        "identifiable": True,
    }  # fmt: skip
    store = Store(done / "results" / "drawn")
    store.write(Record("a1b2", "drawn", fit={"A": fit}, extra={"noise_seed": 3}))
    store.path.joinpath("study.json").touch()
    words = success("why a1b2 --study drawn").out
    assert "calibration on A: converged in 3 steps; identifiable" in words


def test_cases_stopped_by_the_clock_are_failures_with_a_reason(home):
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


@pytest.mark.parametrize("below", ["small", "small/small-data"])
def test_a_link_does_not_lead_a_report_out_of_its_folder(done, below):
    other = done / "other"
    other.mkdir()
    (other / "made-from.json").write_text("not of this report")
    link = done / "linked" / below
    link.parent.mkdir(parents=True)
    link.symlink_to(other)
    answer = study("report small --reports linked")
    assert answer.code == 1
    assert "the report could not be written" in answer.err
    assert "a link leads outside" in answer.err
    (done / "blocked").write_text("a file where a folder is asked for")
    assert study("report small --reports blocked").code == 1
    assert [path.name for path in other.iterdir()] == ["made-from.json"]


def test_a_link_does_not_lead_results_out_of_their_folder(done):
    """The folder itself may be one."""
    shutil.rmtree("results")
    (done / "other").mkdir()
    (done / "results").mkdir()
    (done / "results" / "small").symlink_to(done / "other")
    answer = refusal("run small.toml --data data --jobs 1")
    assert "a link leads outside results" in answer.err
    assert list((done / "other").iterdir()) == []
    (done / "linked").symlink_to(done / "other")
    success("run small.toml --data data --jobs 1 --results linked --reports linked")
    assert (done / "other" / "small" / "small-data" / "numbers.json").is_file()


def test_what_an_interrupted_report_left_is_not_written_through(done):
    success("report", "small", "--reports", "again")
    note = done / "note.txt"
    note.write_text("mine")
    data = done / "again" / "small" / "small-data"
    (data / f".numbers.json.{os.getpid()}.part").symlink_to(note)
    (data / "numbers.json").unlink()
    success("report", "small", "--reports", "again")
    assert note.read_text() == "mine"
    assert (data / "numbers.json").is_file()


def test_sorted_rows_are_a_warning_not_a_secret(home):
    path = home / "data" / "tests.csv"
    lines = path.read_text().splitlines()
    lines[10], lines[11] = lines[11], lines[10]
    path.write_text("\n".join(lines) + "\n")
    answer = success("plan", "small.toml", "--data", "data", "--json")
    assert "out of order sorted by displacement (in 1 of 12 tests)" in answer.err


def means(home):
    """Mean score of every cell, by its labels."""
    table = api.load(home / "results" / "small").table
    found = table.groupby(["material", "range"])["relative_rms_force_error"].mean()
    return {(str(a), str(b)): float(mean) for (a, b), mean in found.items()}


def run_again(home, text):
    """Change the design and run it; what the run said."""
    (home / "small.toml").write_text(text)
    answer = success("run small.toml --data data --jobs 1")
    return answer.out + answer.err


@pytest.mark.parametrize(
    ("small", "large"),
    [("short", "large"), ("large", "small")],
    ids=["a new name", "names that change places"],
)
def test_labels_are_those_of_the_design_not_of_the_records(done, small, large):
    """Names are no content: records that name the former ones stay, and must not be believed."""
    before = means(done)
    records = {path: path.read_bytes() for path in done.rglob("record.json")}
    text = DESIGN.replace("[presets.range.small]", f"[presets.range.{small}-]")
    text = text.replace("[presets.range.large]", f"[presets.range.{large}]").replace("-]", "]")
    text = text.replace('range = ["small", "large"]', f'range = ["{small}", "{large}"]')
    said = run_again(done, text)
    assert "could not be written" not in said
    assert {path: path.read_bytes() for path in done.rglob("record.json")} == records
    new = {"small": small, "large": large}
    assert means(done) == {(a, new[b]): mean for (a, b), mean in before.items()}


def test_a_renamed_factor_is_shown_under_its_new_name(done):
    text = DESIGN.replace("presets.range.", "presets.depth.").replace('range = ["s', 'depth = ["s')
    run_again(done, text)
    table = api.load(done / "results" / "small").table
    assert set(table["depth"]) == {"small", "large"}
    assert "range" not in table


def files(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.drawings
def test_a_second_process_changes_no_byte(done, monkeypatch):
    begun = []

    class Watched(Worker):
        def __enter__(self):
            begun.append("worker")
            return super().__enter__()

        def begin(self, call, *arguments):
            begun.append(call.func.__name__)
            return super().begin(call, *arguments)

    monkeypatch.setattr(verb, "Worker", Watched)
    monkeypatch.setattr(verb, "default_jobs", lambda: 2)
    report("small", reports=done / "one", formats=["html"])
    assert not begun
    monkeypatch.setattr(verb, "MANY_CASES", 1)
    report("small", reports=done / "two", formats=["html"])
    assert begun == ["worker", "of_study"]
    one, two = files(done / "one"), files(done / "two")
    assert any(path.name == "figure-curves.svg" for path in one)
    assert one == two
    monkeypatch.setattr(verb, "default_jobs", lambda: 1)  # one core draws by itself
    monkeypatch.setattr(verb, "opened", lambda *_: 1 / 0)  # a worker would be there by now
    with pytest.raises(ZeroDivisionError):
        report("small", reports=done / "three")
    assert begun == ["worker", "of_study"]


#: the same study of a specimen that is 1 mm taller and over a shorter range
SECOND = (
    DESIGN.replace('"small"', '"other"', 1)
    .replace('"30 mm"', '"31 mm"')
    .replace('["1 %", "20 %"]', '["1 %", "12 %"]')
)


@pytest.fixture(scope="module")
def pair(finished, tmp_path_factory):
    """Folder with two finished studies and one that shares nothing with them."""
    folder = tmp_path_factory.mktemp("pair")
    write_files(folder)
    shutil.copytree(finished.folder / "results", folder / "results")
    (folder / "other.toml").write_text(SECOND)
    alone = SECOND.replace('"other"', '"alone"', 1).replace("relative_rms", "rms")
    (folder / "alone.toml").write_text(alone.replace('"0.5 pp"', '"0.1 N"'))
    for name in ("other", "alone"):
        success("run", f"{name}.toml", "--data", "data", "--jobs", 1, "--json", folder=folder)
    return folder


@pytest.fixture
def here(pair, monkeypatch):
    monkeypatch.chdir(pair)
    return pair


@pytest.mark.usefixtures("here")
def test_diff_as_json():
    found = success("diff", "small", "results/other", "--json").json
    assert [s["name"] for s in found["studies"]] == ["small", "other"]
    assert found["studies"][0]["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert {c["key"]: c["values"] for c in found["changes"]} == {
        "specimen.height": ["30 mm", "31 mm"],
        "presets.range.large.measurements.range": ["1 %, 20 %", "1 %, 12 %"],
    }
    verdicts = {
        name: {
            # an interaction has no verdict: studies are compared by what its components allow
            (row["response"], row["factor"]): row["of_components"] or row["verdict"]
            for row in study("report", name, "--json").json["verdicts"]
        }
        for name in ("small", "other")
    }
    assert len(found["conclusions"]) == 3  # two factors and their interaction
    for row in found["conclusions"]:
        key = row["response"], row["factor"]
        assert [one["verdict"] for one in row["found"]] == [
            verdicts["small"][key], verdicts["other"][key],
        ]  # fmt: skip

    words = success("diff small.toml other.toml").out
    places = ("specimen.height", "conclusions about single factors", "95 % interval")
    assert sorted(places, key=words.index) == list(places)
    assert "31 mm" in words


@pytest.mark.parametrize(
    ("command", "said"),
    [
        ("diff small alone --json", "no analyzed response with a factor in common"),
        ("diff small results/small --json", "is the same study as the other one"),
        ("diff small nowhere --json", "no results of a study there"),
        ("report small --beside alone --reports none", "share a [[response]] and a factor by name"),
    ],
)
def test_what_cannot_be_compared_is_bad_input(here, command, said):
    answer = refusal(command)
    assert said in answer.err
    assert answer.out == ""
    assert not (here / "none").exists()


def test_report_beside_another_study(here):
    answer = success("report small --beside other --format html --reports two --json")
    assert set(answer.json["beside"]) >= {"summary", "conclusions"}
    first = here / answer.json["report"]
    page = first.with_name(f"{first.stem}-details.html").read_text()
    assert '<section id="beside">' in page
    assert "Compared with other" in page
    table = (here / "two" / "small" / "small-data" / "table-beside.csv").read_text()
    assert table.count("\n") == 1 + 2 * 3


ASKED = (
    '[analysis]\ncontrasts = ["material=neo-hookean, range=large - '
    'material=mooney-rivlin, range=large", "small - large"]\n'
)


@pytest.fixture
def asked(edit, home):
    """Working folder of a design that names two differences."""
    edit("[report]", f"{ASKED}[report]")
    edit('format = ["csv"]', 'format = ["html", "csv"]')
    return home


def by_hand(cases, first, second):
    """Difference of two settings in every block, from the table of cases."""

    def mean(setting):
        kept = cases
        for name, level in setting.items():
            kept = kept[kept[name] == level]
        return kept.groupby("block")["relative_rms_force_error"].mean()

    return (mean(first) - mean(second)).to_numpy()


def test_a_study_answers_the_differences_that_it_names(asked):
    run = success("run", "small.toml", "--data", "data", "--jobs", 1, "--json")
    report = Path(run.json["report"])
    cases = pd.read_csv(report.with_name("small-data") / "cases.csv", dtype={"block": str})
    settings = [
        ({"material": "neo-hookean", "range": "large"},
         {"material": "mooney-rivlin", "range": "large"}),
        ({"range": "small"}, {"range": "large"}),
    ]  # fmt: skip
    found = run.json["contrasts"]
    assert len(found) == 2
    for one, (first, second) in zip(found, settings, strict=True):
        # three mixes: Student's t of the difference in each of them
        d = by_hand(cases, first, second)
        half = stats.t.ppf(0.975, 2) * d.std(ddof=1) / np.sqrt(3)
        assert one["response"] == "relative_rms_force_error"
        assert one["difference"] == pytest.approx(d.mean(), rel=1e-9)
        assert one["ci"] == pytest.approx([d.mean() - half, d.mean() + half], rel=1e-9)
        assert one["p"] == pytest.approx(stats.ttest_1samp(d, 0).pvalue, rel=1e-9)
        assert one["ci_simultaneous"][0] <= one["ci"][0]

    page = both_pages(report)
    assert "Differences that were asked for" in page
    raw = pd.read_csv(
        report.with_name("small-data") / "table-contrasts-relative-rms-force-error.csv"
    )
    assert raw["difference"].tolist() == [one["difference"] for one in found]
    said = study("report", "small").out
    assert "relative RMS force error: asked for" in said
    assert "Holm's p" in said
    assert "small - large" in said


def test_the_page_of_a_table_has_them_and_its_line_makes_it_again(tmp_path):
    rows = ["a,b,y", *(f"{a},{b},{x + 2 * y + e}" for x, a in enumerate("pq")
                       for y, b in enumerate("uv") for e in (-0.1, 0.1))]  # fmt: skip
    (tmp_path / "t.csv").write_text("\n".join(rows) + "\n")
    out = tmp_path / "out"
    asked = ("a=p, b=v - a=p, b=u", "q - p")
    flags = [word for text in asked for word in ("--contrast", text)]
    found = success("analyze", tmp_path / "t.csv", "--response", "y", "--factors", "a,b",
                    *flags, "--report", out)  # fmt: skip
    raw = pd.read_csv(next(out.rglob("table-contrasts-y.csv")))
    assert raw["contrast"].tolist() == list(asked)
    # by construction: two of b, one of a; four runs a side, pooled variance .02 on 4 df
    assert raw["difference"].tolist() == pytest.approx([2.0, 1.0])
    half = stats.t.ppf(1 - 0.025 / 2, 4) * np.sqrt(0.02 * (1 / 2 + 1 / 2))
    assert raw["high"][0] - raw["difference"][0] == pytest.approx(half, rel=1e-9)
    # Holm of two: the smaller p counts twice, and the larger one is never below that
    p = raw["p"].to_numpy()
    assert raw["p_holm"].tolist() == pytest.approx([2 * p[0], max(2 * p[0], p[1])], rel=1e-12)
    assert "Holm's p" in found.out
    page = both_pages(min(out.glob("*.html"), key=lambda path: len(path.name)))
    assert "Holm&#39;s p" in page or "Holm's p" in page
    assert "--contrast" in page
    assert "Differences that were asked for" in page


@pytest.mark.parametrize(
    "overrides", [(), pytest.param(("-s", "study.seed=7"), marks=pytest.mark.verify)]
)
def test_a_study_is_reproduced_in_an_empty_folder_by_what_its_page_says(
    finished, tmp_path, monkeypatch, overrides
):
    """The page says what to save, and one command, which gives the same records."""
    monkeypatch.chdir(finished.folder)
    results = tmp_path / "results" if overrides else Path("results")
    if overrides:
        success(
            "run", "small.toml", "--data", "data", "--jobs", 1, "--results", results, *overrides
        )
    success("report", results / "small", "--format", "html", "--reports", tmp_path / "first")
    text = html.unescape(next((tmp_path / "first").rglob("*-details.html")).read_text())
    save, copy, command = (
        text.split("To reproduce")[1].split("<pre>")[1].split("</pre>")[0].split("\n")
    )
    design = text.split("The design file")[1].split("<pre>")[1].split("</pre>")[0]
    empty = tmp_path / "empty"
    shutil.copytree(finished.folder / "data", empty / "measurements")
    (empty / save.split()[-1]).write_text(design)
    assert copy.endswith("to measurements/")
    success(*shlex.split(command)[1:], "--jobs", 1, folder=empty)
    first, again = (
        {path.parent.name: json.loads(path.read_text())["content"]["responses"]
         for path in Path(folder).glob("results/small/cases/*/record.json")}
        for folder in (tmp_path if overrides else finished.folder, empty)
    )  # fmt: skip
    assert first
    assert first == again
