"""The store loses no finished case and uses no damaged one, whatever happens in between."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.ground.errors import StoreError
from study.ground.files import TEMPORARY, own_folder
from study.record.record import table
from study.record.store import Store
from tests.record.disk import FailingDisk, PowerLoss
from tests.record.samples import CASES, FIT, manifest, record

WANTED = {name: "h-" + name for name in CASES}


def run(path, disk=None, followed=False):
    """A study of three cases that share a fit: what is missing is computed and stored."""
    store = Store(path, system=disk)
    with store.lock():
        store.write_manifest(manifest())
        if store.read_fit("f1") is None:
            store.write_fit("f1", FIT, followed=followed)
        done = store.done_ids(WANTED)
        for name in CASES:
            if name not in done:
                store.write(record(name), followed=followed and name != CASES[-1])
    return store


def state(path):
    store = Store(path)
    records = store.records(WANTED)
    return (
        table(records).to_csv(),
        [r.to_json() for r in records],
        store.read_fit("f1"),
        store.read_manifest(),
        store.warnings,
    )


@pytest.fixture(scope="module")
def clean(tmp_path_factory):
    path = tmp_path_factory.mktemp("clean")
    disk = FailingDisk()
    run(path, disk)
    return state(path), disk.count


@pytest.mark.parametrize("followed", [False, True], ids=["one by one", "together"])
@pytest.mark.parametrize("power_loss", [False, True], ids=["disk full", "power loss"])
def test_failure_at_every_operation_then_resume(tmp_path, clean, power_loss, followed):
    expected, operations = clean
    assert operations > 25
    if followed:
        whole = FailingDisk()
        run(tmp_path / "whole", whole, followed)
        assert whole.count <= operations
        operations = whole.count
    for k in range(1, operations + 1):
        path = tmp_path / str(k)
        disk = FailingDisk(k, power_loss)
        with pytest.raises(PowerLoss if power_loss else StoreError):
            run(path, disk, followed)
        # nothing in between: what can be read now is exactly what a clean run has
        seen = Store(path)
        for found in seen.records(WANTED):
            assert found.to_json() in expected[1], k
        assert seen.warnings == [], k
        run(path, followed=followed)
        assert state(path) == expected, k
        left = [p for p in path.rglob("*") if p.name.endswith(TEMPORARY)]
        assert left == [], k


@pytest.mark.skipif(sys.platform != "linux", reason="syncfs(2) is a call of Linux")
def test_records_that_come_together_are_flushed_together(tmp_path, monkeypatch):
    flushed = []
    monkeypatch.setattr(os, "fsync", flushed.append)
    names = [f"c{number}" for number in range(30)]
    with Store(tmp_path).lock() as store:
        begun = len(flushed)
        for name in names:
            store.write(record(name), followed=name != names[-1])
        assert len(flushed) == begun
        assert len(store.records({name: "h-" + name for name in names})) == len(names)


def test_a_disk_that_is_full_costs_what_it_cannot_take_alone(tmp_path):
    class Full(FailingDisk):
        def write(self, path, data):
            if path.parent.name == CASES[-1]:
                raise OSError(28, "No space left on device")
            super().write(path, data)

    with pytest.raises(StoreError, match="No space left.*unharmed.*run again"):
        run(tmp_path, Full(), followed=True)
    assert {one.case_id for one in Store(tmp_path).records(WANTED)} == set(CASES[:-1])


@pytest.mark.parametrize("damage", [b"", b"{", b"\0" * 50, b"\xff", b'{"schema":1}'])
def test_a_damaged_record_is_set_aside_and_queued_again(tmp_path, clean, damage):
    run(tmp_path)
    victim = tmp_path / "cases" / "b2" / "record.json"
    victim.write_bytes(damage or victim.read_bytes()[:100])
    (tmp_path / "fits" / "f1.json").write_text("{}")
    looker = Store(tmp_path)
    assert looker.survey(WANTED).missing == ("b2",)
    assert victim.exists()  # a reader without the lock moves nothing
    store = run(tmp_path)
    assert any("renamed to record.json.corrupt-1" in said for said in store.warnings)
    assert (victim.parent / "record.json.corrupt-1").exists()
    assert state(tmp_path) == clean[0]


def test_a_record_in_the_wrong_folder_is_not_used(tmp_path):
    run(tmp_path)
    text = (tmp_path / "cases" / "a1" / "record.json").read_text()
    (tmp_path / "cases" / "b2" / "record.json").write_text(text)
    assert [r.case_id for r in Store(tmp_path).records(WANTED)] == ["a1", "c3"]


def test_failed_cases_are_done_unless_tried_again(tmp_path):
    store = run(tmp_path)
    store.write(record("a1", status="crashed", message="signal 9"))
    assert store.survey(WANTED).statuses == {"a1": "crashed"}
    assert "a1" in store.done_ids(WANTED)
    assert "a1" not in store.done_ids(WANTED, retry=("crashed", "timeout"))
    assert "a1" in store.done_ids(WANTED, retry=("timeout",))


def test_warnings_are_handed_on_once(tmp_path):
    run(tmp_path)
    (tmp_path / "cases" / "a1" / "record.json").write_text("x")
    heard = []
    store = Store(tmp_path, heard.append)
    store.read("a1")
    store.read("a1")
    assert len(heard) == 1
    assert heard == store.warnings


def test_what_a_runner_notes_is_read_by_others_while_it_runs(tmp_path):
    ours, theirs = Store(tmp_path), Store(tmp_path)
    with ours.lock():
        ours.note({"done": 1000, "seconds_left": 3.5})
        ours.note({"done": 7})
        with ours.lock():  # a part of the run
            pass
        found = theirs.running() or {}
        assert (found["pid"], found["done"]) == (os.getpid(), 7)
        assert set(found) == {"pid", "host", "since", "done"}
        # the first byte is the one that Windows locks for readers, too
        assert json.loads((tmp_path / ".lock").read_bytes()[1:]) == found
    assert theirs.running() is None
    ours.note({"done": 9})
    with theirs.lock():
        assert "done" not in (ours.running() or {})


HOLD = """
import sys, time
from study.record.store import Store
with Store(sys.argv[1]).lock():
    print("held", flush=True)
    time.sleep(600)
"""


def test_second_runner_is_refused_and_a_dead_one_forgotten(tmp_path):
    root = Path(__file__).resolve().parents[2]
    child = subprocess.Popen(
        [sys.executable, "-c", HOLD, str(tmp_path)], cwd=root, stdout=subprocess.PIPE, text=True
    )
    try:
        assert child.stdout is not None
        assert child.stdout.readline() == "held\n"
        with (
            pytest.raises(StoreError, match=f"locked by pid {child.pid} on host .* since 20"),
            Store(tmp_path).lock(),
        ):
            pass
        assert (Store(tmp_path).running() or {})["pid"] == child.pid
    finally:
        child.send_signal(signal.SIGKILL)
        child.wait()
        child.stdout.close()
    with Store(tmp_path).lock():
        pass  # the lock of a killed runner dies with it
    assert Store(tmp_path).running() is None


@pytest.mark.parametrize("name", ["../x", "A", "", "a/b", "a.b", "x" * 81, "a\0", "-a"])
def test_ids_are_no_paths(tmp_path, name):
    store = Store(tmp_path)
    with pytest.raises(StoreError, match="no case id"):
        store.read(name)
    with pytest.raises(StoreError, match="no case id"):
        store.write(record(name))
    with pytest.raises(StoreError, match="no name"):
        store.write_fit(name + "/..", {})


def test_places_that_cannot_hold_results_are_refused(tmp_path):
    outside, cases = tmp_path / "outside", tmp_path / "r" / "cases"
    outside.mkdir()
    cases.mkdir(parents=True)
    (cases / "a1").symlink_to(outside)
    with pytest.raises(StoreError, match="leads outside"):
        Store(tmp_path / "r").write(record("a1"))
    assert list(outside.iterdir()) == []
    (tmp_path / "small").symlink_to(tmp_path / "small")
    with pytest.raises(StoreError, match="cannot be used"):
        own_folder(tmp_path, "small")
    (tmp_path / "file").write_text("")
    with pytest.raises(StoreError, match="Not a directory"), Store(tmp_path / "file" / "r").lock():
        pass
    with pytest.raises(StoreError), Store(tmp_path / ("x" * 300)).lock():
        pass
    run(tmp_path / "a b \u00fc \u6f22")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_read_only_folder_is_refused_before_any_work(tmp_path):
    tmp_path.chmod(0o500)
    with (
        pytest.raises(StoreError, match="cannot be made|cannot be written"),
        Store(tmp_path / "r").lock(),
    ):
        pass


def test_json_names_what_was_not_finite(tmp_path):
    store = Store(tmp_path)
    store.write_json("study", {"a": float("nan"), "b": [1.5]})
    assert store.read_json("study") == {"a": None, "b": [1.5], "not_finite": {"study.a": "nan"}}
    assert "NaN" not in (tmp_path / "study.json").read_text()
    json.loads((tmp_path / "study.json").read_text())


@given(st.binary(max_size=200))
def test_any_bytes_as_a_stored_file(tmp_path_factory, data):
    path = tmp_path_factory.mktemp("fuzz")
    (path / "cases" / "a1").mkdir(parents=True)
    (path / "cases" / "a1" / "record.json").write_bytes(data)
    (path / "study.json").write_bytes(data)
    with Store(path).lock() as store:
        assert store.read("a1") is None
        assert store.read_manifest() is None
