"""What becomes of a finished study and its report when design, data, code or libraries change."""

import datetime
import shutil
from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import pytest

from study import api
from study.api import planning
from study.ground.errors import InputError, RefusedError
from study.record.store import Store
from study.reporting.output import write
from tests.cli.small import DESIGN, study, write_files


@pytest.fixture(scope="module")
def finished(tmp_path_factory):
    """A folder with a study that was run and reported, for all tests to copy."""
    folder = tmp_path_factory.mktemp("edited")
    write_files(folder)
    with chdir(folder):
        again()
    return folder


@pytest.fixture
def home(finished, tmp_path, monkeypatch):
    """A folder with the study to change."""
    monkeypatch.chdir(shutil.copytree(finished, tmp_path / "copy"))
    return tmp_path / "copy"


def edited(home):
    """Another range, which four cells have, and an answer at another level."""
    text = DESIGN.replace('["1 %", "20 %"]', '["1 %", "15 %"]')
    (home / "small.toml").write_text(text + "[analysis]\nalpha = 0.01\n")


class Enough(Exception):
    """The run is stopped here."""


def interrupted(home, after):
    """Run the study, and stop it as soon as so many computations are finished."""

    def stop(state):
        if state.done == after:
            raise Enough

    with pytest.raises(Enough):
        api.run("small.toml", data="data", jobs=1, reports=None, progress=stop)


def test_the_finished_study_is_read_until_the_edited_one_is_finished(home):
    before = study("analyze", "results/small", "--json").json
    table = api.load("results/small").table
    edited(home)
    interrupted(home, 8)
    found = study("status", "small", "--json").json
    assert found["cases"] == {"total": 12, "done": 12, "failed": 0, "missing": 0}
    assert found["finished"]
    later = found["unfinished"]
    assert later["cases"]["total"] == 12
    assert 6 <= later["cases"]["done"] < 12  # the six of the other range are shared
    assert set(later["changed"]) == {
        "presets.range.large.measurements.range: from 1 %, 20 % to 1 %, 15 %",
        "analysis.alpha: 0.01, not set before",
    }
    words = study("status", "small").out
    assert "12 cases: 12 done" in words
    assert "that is its last finished run; a later one has 12 cases" in words
    assert "presets.range.large.measurements.range: from 1 %, 20 % to 1 %, 15 %" in words
    # every number is still that of the finished run, and the report says which run it is
    assert study("analyze", "results/small", "--json").json == before
    assert api.load("results/small").table.equals(table)
    reported = study("report", "small", "--json")
    assert "this is the last finished run; one of an edited design" in reported.err
    assert "run small.toml again to finish it" in reported.err
    # once it is finished, it is the one that is read
    api.run("small.toml", data="data", jobs=1, reports=None)
    assert study("status", "small", "--json").json["unfinished"] is None
    assert api.load("results/small").design.analysis.alpha == 0.01
    assert len(Store(home / "results/small").read_runs()) == 2


def test_why_names_the_input_that_changed(home):
    cases = {r.levels["range"]: r.case_id for r in api.load("results/small").records}
    used = study("why", cases["large"])
    assert "the study uses it" in used.out
    edited(home)
    # before anything ran: the file as it is now
    gone = study("why", cases["large"], "--study", "small.toml", "--data", "data")
    assert "the study has this case no more" in gone.out
    assert "presets.range.large.measurements.range: from 1 %, 20 % to 1 %, 15 %" in gone.out
    api.run("small.toml", data="data", jobs=1, reports=None)
    found = study("why", cases["large"], "--json").json["state"]
    assert found["use"] == "the study has this case no more"
    assert {
        "kind": "design",
        "key": "presets.range.large.measurements.range",
        "values": ["1 %, 20 %", "1 %, 15 %"],
    } in found["changes"]
    assert "the study uses it" in study("why", cases["small"]).out


def test_why_names_the_file_that_changed(home):
    cases = {r.block: r.case_id for r in api.load("results/small").records}
    data = home / "data" / "tests.csv"
    text = data.read_text()
    assert "M1,A,1,2.0000," in text
    data.write_text(text.replace("M1,A,1,2.0000,", "M1,A,1,2.0010,"))
    said = {
        block: study("why", case, "--study", "small.toml", "--data", "data").out
        for block, case in cases.items()
    }
    assert "makes it of other inputs now" in said["M1"]
    assert "sha256 of tests.csv: from " in said["M1"]
    assert "the study uses it" in said["M2"]  # its own rows are as they were


def test_other_code_keeps_the_finished_study(home, monkeypatch):
    """All cases keep their names and none its input: each record is laid by for the old study."""
    before = study("analyze", "results/small", "--json").json
    for module in ("harness.runner.batch", "simulation.job"):
        monkeypatch.setattr(f"study.{module}.code_version", lambda: "1+other")
    monkeypatch.setattr("study.simulation.provenance.code_version", lambda: "1+other")
    with pytest.raises(RefusedError, match="12 results have another input"):
        api.run("small.toml", data="data", jobs=1, reports=None, stale="refuse")
    interrupted(home, 20)
    found = study("status", "small", "--json").json
    assert found["cases"]["done"] == 12
    assert 0 < found["unfinished"]["cases"]["done"] < 12
    assert any("version of study: from" in line for line in found["unfinished"]["changed"])
    assert study("analyze", "results/small", "--json").json == before


def stored(store):
    """Records of every case that has one."""
    names = sorted(path.name for path in (store.path / "cases").iterdir())
    return [record for name in names if (record := store.read(name)) is not None]


def test_other_libraries_are_told_refused_or_made_again(home):
    store = Store(home / "results" / "small")
    records = stored(store)
    now = records[0].versions["numpy"]
    for record in records[:5]:
        store.write(replace(record, versions={**record.versions, "numpy": "1.0.0"}))
    with pytest.raises(RefusedError, match=rf"5 results .* libraries: numpy 1\.0\.0, now {now}"):
        api.run("small.toml", data="data", jobs=1, reports=None, stale="refuse")
    warned = api.run("small.toml", data="data", jobs=1, reports=None)
    assert any(f"numpy 1.0.0, now {now}; they are used" in text for text in warned.warnings)
    assert sum(r.versions["numpy"] == "1.0.0" for r in stored(store)) == 5
    told = study("why", records[0].case_id).out
    assert "though other libraries made it" in told
    assert f"numpy: from 1.0.0 to {now}" in told
    again = api.run("small.toml", data="data", jobs=1, reports=None, stale="rerun")
    assert not any("numpy" in text for text in again.warnings)
    assert {r.versions["numpy"] for r in stored(store)} == {now}
    # the digits are those of the first time: nothing else changed
    values = {r.case_id: r.value("relative_rms_force_error") for r in records}
    assert {r.case_id: r.value("relative_rms_force_error") for r in again.records} == values
    with pytest.raises(InputError, match="did you mean 'warn'"):
        api.run("small.toml", data="data", stale="worn", reports=None)


def test_cases_of_one_cell_on_two_meshes_are_told(home):
    store = Store(home / "results" / "small")
    records = stored(store)
    for number, record in enumerate(records):
        store.write(replace(record, mesh={**record.mesh, "hash": f"m{number % 2}"}))
    found = api.run("small.toml", data="data", jobs=1, reports=None)
    assert any("were computed on different meshes" in text for text in found.warnings)
    for record in records:
        store.write(replace(record, mesh={**record.mesh, "hash": "m0"}))
    found = api.run("small.toml", data="data", jobs=1, reports=None)
    assert not any("different meshes" in text for text in found.warnings)


def test_a_newer_manifest_is_refused_politely(home):
    path = home / "results" / "small" / "study.json"
    text = path.read_text().replace('{"schema":1,', '{"schema":3,', 1)
    path.write_text(text)
    for verb in (("status", "small"), ("report", "small"), ("run", "small.toml", "--data", "data")):
        answer = study(*verb)
        assert answer.code == 2
        assert "written by a newer study (schema 3, this version reads 1)" in answer.err
        assert "Traceback" not in answer.err
    assert path.read_text() == text


def test_memory_is_an_amount_with_its_unit(home):
    """A run in room for nothing does one thing after the other, and comes to the same digits."""
    before = api.load("results/small").table
    found = api.run(
        "small.toml", data="data", jobs=2, reports=None, memory="1 MB", results=home / "again"
    )
    columns = ["case_id", "relative_rms_force_error"]
    assert found.table[columns].equals(before[columns])
    for text in ("20", "20 mm", "-1 GB", "0 MB"):
        answer = study("run", "small.toml", "--data", "data", f"--memory={text}")
        assert answer.code == 2
        assert "memory" in answer.err


# A report that would be the same again is not made again.


def again():
    """Run the study; everything is there but the first time."""
    found = api.run("small.toml", data="data", jobs=1)
    assert found.report is not None
    assert not [said for said in found.warnings if "could not be written" in said]
    return Path(found.report)


def state():
    """Inode and bytes of every file of the report; files are replaced whole."""
    files = [path for path in Path("reports").rglob("*") if path.is_file()]
    return {path.name: (path.stat().st_ino, path.read_bytes()) for path in files}


def content():
    """Bytes of the files that a reader opens."""
    return {name: kept for name, (_, kept) in state().items() if name != write.NAME}


@pytest.mark.usefixtures("home")
def test_a_run_with_nothing_to_do_leaves_the_report_as_it_is():
    before = state()
    assert again() == Path("reports/small/small-data/cases.csv")
    assert state() == before
    assert api.report("small").report == Path("reports/small/small-data/cases.csv")
    assert state() == before


@pytest.mark.parametrize(
    ("name", "spoil"),
    [
        ("numbers.json", Path.unlink),
        ("cases.csv", lambda path: path.write_text(path.read_text().replace("neo-h", "neo-H", 1))),
        (write.NAME, lambda path: path.write_text("[")),
    ],
)
@pytest.mark.usefixtures("home")
def test_a_report_that_was_touched_is_made_again(name, spoil):
    before = content()
    spoil(Path("reports/small/small-data", name))
    again()
    assert content() == before


def test_a_changed_record_changed_code_and_another_format_make_it_again(home, monkeypatch):
    """One record is lost and solved again: its seconds differ, so the table does."""
    kept = [state()]
    case = next((home / "results/small/cases").iterdir())
    (case / "record.json").write_text("{}")
    again()
    kept.append(state())
    with monkeypatch.context() as other:
        other.setattr("study.api.study.versions", lambda: {"study": "another"})
        again()
    kept.append(state())
    assert len({files["cases.csv"][0] for files in kept}) == 3
    assert content().keys() == {name for name in kept[0] if name != write.NAME}
    page = api.report("small", formats=["html"]).report
    assert page == Path("reports/small/small.html")
    written = page.stat().st_ino
    assert api.report("small", formats=["html"]).report == page
    assert page.stat().st_ino == written


# What a run says of the time that it still needs.

NOW = datetime.datetime(2026, 3, 1, 12, 0, tzinfo=datetime.UTC)
AGO = (NOW - datetime.timedelta(seconds=50)).isoformat()


class Stopped(datetime.datetime):
    @classmethod
    def now(cls, tz=None):
        return NOW


@pytest.mark.parametrize(
    ("noted", "left"),
    [
        ({"seconds_left": 60.0, "at": AGO}, 10.0),
        ({"seconds_left": 20.0, "at": AGO}, 0.0),
        *((note, None) for note in (None, {}, {"pid": 1}, {"at": "now", "seconds_left": 1})),
        ({"at": None}, None),
    ],
)
def test_time_passes_after_a_note_and_without_one_nothing_is_said(monkeypatch, noted, left):
    monkeypatch.setattr(datetime, "datetime", Stopped)
    assert planning.seconds_left(noted) == left
