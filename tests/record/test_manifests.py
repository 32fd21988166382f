"""A finished study stays readable while an edited one is computed, whatever happens meanwhile."""

import contextlib
import os

import pytest

from study.ground.errors import NewerSchemaError, StoreError
from study.record.record import NumericalRow, seal, table
from study.record.store import Store
from tests.record.disk import FailingDisk, PowerLoss
from tests.record.samples import CASES, FIT, NUMERICAL, manifest, record

OLD = {name: "old-" + name for name in CASES}
#: the edited study drops a case, makes two of other inputs, and adds one
NEW = {"b2": "new-b2", "c3": "new-c3", "d4": "new-d4"}


def compute(path, design, cases, disk=None):
    """Run a study: what is missing is computed, with rows beside it."""
    store = Store(path, system=disk)
    with store.lock():
        store.begin_run(manifest(design=design, cases=cases))
        for name in [n for n in cases if n not in store.done_ids(cases)]:
            found = {"value": float(len(design)), "unit": "%"}
            store.write(record(name, input_hash=cases[name], responses={"error": found}))
        store.write_rows("numerical", [{**NUMERICAL, "note": design}])
        store.finish_run(manifest(design=design, cases=cases))


def seen(path):
    """Everything that a reader gets of the last finished run."""
    store = Store(path)
    known = store.read_manifest()
    assert known is not None
    records = store.records(known["cases"])
    counted = store.survey(known["cases"])
    assert counted.missing == ()
    assert store.warnings == []
    return known["design"], table(records).to_csv(), store.read_rows("numerical", NumericalRow)


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """Finished study, edited study, and the operations of the disk that lie between."""
    path = tmp_path_factory.mktemp("clean")
    compute(path, "old", OLD)
    old, disk = seen(path), FailingDisk()
    compute(path, "newer", NEW, disk)
    return old, seen(path), disk.count


@pytest.mark.parametrize("power_loss", [False, True], ids=["disk full", "power loss"])
def test_one_of_the_two_is_whole_after_a_failure_at_every_operation(tmp_path, expected, power_loss):
    old, new, operations = expected
    assert operations > 45
    readable = set()
    for k in range(1, operations + 1):
        path = tmp_path / str(k)
        compute(path, "old", OLD)
        with contextlib.suppress(StoreError, PowerLoss):
            compute(path, "newer", NEW, FailingDisk(k, power_loss))
        found = seen(path)
        if found[2] == old[2]:
            assert found == old, k
        else:  # rows go first, and the manifest that they belong to at once after them
            assert found in (new, (*old[:2], new[2])), k
        readable.add(found[0])
        compute(path, "newer", NEW)
        assert seen(path) == new, k
    assert readable == {"old", "newer"}


def test_each_run_has_a_manifest_and_the_latest_comes_first(tmp_path):
    compute(tmp_path, "old", OLD)
    compute(tmp_path, "old", OLD)  # resumed with nothing to do: it is the same run
    compute(tmp_path, "newer", NEW)
    store = Store(tmp_path)
    assert [run["design"] for run in store.read_runs()] == ["newer", "old"]
    assert store.read_unfinished() is None
    assert not list((tmp_path / "cases").glob("*/record-*.json"))
    assert not list(tmp_path.glob("unfinished*"))


def test_an_edit_that_is_taken_back_finds_what_was_there(tmp_path):
    compute(tmp_path, "old", OLD)
    store = Store(tmp_path)
    with store.lock():
        store.begin_run(manifest(design="newer", cases=NEW))
        store.write(record("b2", input_hash="new-b2"))
    later = Store(tmp_path).read_unfinished()
    assert later is not None
    assert Store(tmp_path).survey(later["cases"]).done == ("b2",)
    assert Store(tmp_path).survey(OLD).done == CASES
    before = [r.to_json() for r in Store(tmp_path).records(OLD)]
    compute(tmp_path, "old", OLD)
    assert [r.to_json() for r in Store(tmp_path).records(OLD)] == before
    assert Store(tmp_path).read_unfinished() is None


def test_results_of_other_libraries_are_found_and_count_only_if_they_may(tmp_path):
    then, now = {"numpy": "1.26.4", "gmsh": "4.13"}, {"numpy": "2.2.1", "gmsh": "4.13"}
    store = Store(tmp_path)
    with store.lock():
        store.made_with(then)
        for name in CASES:
            versions = {"study": "1", "python": "3.11", **(then if name != "c3" else now)}
            store.write(record(name, input_hash=OLD[name], versions=versions))
        store.write_fit("f1", FIT)
    found = Store(tmp_path).other_libraries(OLD, {"python": "3.13", **now})
    assert found == ["2 results were made with other libraries: numpy 1.26.4, now 2.2.1"]
    strict = Store(tmp_path)
    strict.made_with(now, strict=True)
    assert strict.done_ids(OLD) == {"c3"}
    assert [r.case_id for r in strict.records(OLD)] == ["c3"]
    assert strict.read_fit("f1") is None
    assert Store(tmp_path).read_fit("f1") == FIT
    assert Store(tmp_path).done_ids(OLD) == set(CASES)


@pytest.mark.parametrize("victim", ["study.json", "cases/b2/record.json"])
def test_what_a_newer_version_wrote_is_refused_and_left_alone(tmp_path, victim):
    compute(tmp_path, "old", OLD)
    path = tmp_path / victim
    text = seal({"a": 1}).replace('"schema":1', '"schema":3').replace('"checksum"', '"sum"')
    path.write_text(text)
    looker = Store(tmp_path)
    look = looker.read_manifest if victim == "study.json" else lambda: looker.survey(OLD)
    with pytest.raises(NewerSchemaError, match=r"newer study \(schema 3, this version reads 1\)"):
        look()
    with pytest.raises(NewerSchemaError, match="pip install --upgrade"):
        compute(tmp_path, "old", OLD)
    assert path.read_text() == text
    assert not list(tmp_path.rglob("*.corrupt-*"))


def test_what_is_no_file_is_not_read(tmp_path):
    """A pipe has no end, and a device may have none."""
    said = []
    os.mkfifo(tmp_path / "study.json")
    store = Store(tmp_path, warn=said.append)
    assert store.read_manifest() is None
    assert "is no file" in said[0]
