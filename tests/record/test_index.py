"""The index of records spares reading them, and is believed only while it is right."""

from __future__ import annotations

import json
import os
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from study.ground.bounded_file import read_regular
from study.harness.record.record import Record, seal
from study.harness.record.store import Store
from tests.record.samples import record
from tests.record.test_store import CASES, WANTED, run
from tests.waiting import until


@pytest.fixture
def read(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Names of the records that were read from the disk since."""
    found: list[str] = []
    before = Store.read

    def noted(self: Store, case_id: str, input_hash: str | None = None) -> Record | None:
        found.append(case_id)
        return before(self, case_id, input_hash)

    monkeypatch.setattr(Store, "read", noted)
    return found


def later(path: Path) -> None:
    """Wait until the clock of the disk is past everything in a folder."""
    latest = max(one.stat().st_ctime_ns for one in path.rglob("*"))
    probe = path / "probe"

    def passed() -> bool:
        probe.write_bytes(b"")
        return probe.stat().st_ctime_ns > latest

    until(passed)
    probe.unlink()


def settled(path: Path) -> None:
    """Have the index written later than every record."""
    run(path)
    later(path)
    (path / "index.json").unlink(missing_ok=True)
    with Store(path).lock() as store:
        store.survey(WANTED)


def test_whatever_differs_is_read_again(tmp_path: Path, read: list[str]) -> None:
    settled(tmp_path)
    victim = tmp_path / "cases" / "b2" / "record.json"
    stamp = victim.stat()
    text = victim.read_text()
    # as long as before, and as old: only the time that nobody can set tells
    victim.write_text(text.replace('"converged"', '"convergee"'))
    os.utime(victim, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert victim.stat().st_size == stamp.st_size
    read.clear()
    store = Store(tmp_path)
    assert store.survey(WANTED).missing == ("b2",)
    assert read == ["b2"]
    assert "damaged" in store.warnings[0]


def test_a_record_written_by_hand_in_place_of_another_is_seen(tmp_path: Path) -> None:
    settled(tmp_path)
    failed = record("b2", status="crashed", message="signal 9").to_json()
    (tmp_path / "cases" / "b2" / "record.json").write_text(failed)
    found = Store(tmp_path).survey(WANTED)
    assert (found.failed, dict(found.statuses)) == (("b2",), {"b2": "crashed"})
    (tmp_path / "cases" / "c3" / "record.json").unlink()
    assert Store(tmp_path).survey(WANTED).missing == ("c3",)


@pytest.mark.parametrize(
    "damage", [None, b"", b"{", b"[]", b"\xff", b'{"schema":1,"checksum":"","content":{}}']
)
def test_a_lost_or_damaged_index_is_made_again(
    tmp_path: Path, read: list[str], damage: bytes | None
) -> None:
    settled(tmp_path)
    index = tmp_path / "index.json"
    whole = index.read_bytes()
    index.unlink() if damage is None else index.write_bytes(damage)
    read.clear()
    looker = Store(tmp_path)
    assert looker.survey(WANTED).done == CASES
    assert sorted(read) == list(CASES)
    assert looker.warnings == []
    assert (not index.exists()) if damage is None else index.read_bytes() == damage
    with Store(tmp_path).lock() as store:
        assert store.done_ids(WANTED) == set(CASES)
    assert json.loads(index.read_bytes())["content"] == json.loads(whole)["content"]


def test_an_index_that_vouches_for_a_damaged_record_is_thrown_away(tmp_path: Path) -> None:
    """A disk may lose bits and change no time: the reader finds it, the next run replaces it."""
    settled(tmp_path)
    victim = tmp_path / "cases" / "b2" / "record.json"
    victim.write_bytes(b"{}")
    stamp = victim.stat()
    index = tmp_path / "index.json"
    rows = json.loads(index.read_bytes())["content"]
    rows["b2"][:3] = stamp.st_size, stamp.st_mtime_ns, stamp.st_ctime_ns
    later(tmp_path)
    index.write_text(seal(rows))
    assert Store(tmp_path).survey(WANTED).done == CASES  # deceived
    assert Store(tmp_path).read("b2") is None
    assert not index.exists()
    assert Store(tmp_path).survey(WANTED).missing == ("b2",)
    assert run(tmp_path).survey(WANTED).done == CASES


def test_an_entry_as_young_as_the_index_is_not_believed(tmp_path: Path, read: list[str]) -> None:
    """Within one grain of the clock a file may change twice and look the same."""
    settled(tmp_path)
    stamp = (tmp_path / "cases" / "a1" / "record.json").stat()
    os.utime(tmp_path / "index.json", ns=(stamp.st_ctime_ns, stamp.st_ctime_ns))
    read.clear()
    Store(tmp_path).survey({"a1": WANTED["a1"]})
    assert read == ["a1"]


@given(
    st.binary(max_size=300)
    | st.recursive(
        st.none() | st.integers() | st.text(max_size=5),
        lambda inner: st.lists(inner, max_size=6) | st.dictionaries(st.sampled_from(CASES), inner),
    ).map(lambda content: seal(content).encode())
)
def test_any_bytes_as_an_index(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("index")
    run(path)
    (path / "index.json").write_bytes(data)
    store = Store(path)
    assert store.survey(WANTED).done == CASES
    assert store.warnings == []


def test_counting_cases_reads_the_index_and_no_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Reading each of 10,000 records took 1.3 s; how long it takes now stands in benchmarks."""
    names = [f"c{k}" for k in range(300)]
    for name in names:
        folder = tmp_path / "cases" / name
        folder.mkdir(parents=True)
        (folder / "record.json").write_text(record(name).to_json())
    wanted = {name: "h-" + name for name in names}
    later(tmp_path)
    read: list[str] = []

    def counted(path: Path, limit: int) -> bytes | None:
        read.append(path.name)
        return read_regular(path, limit)

    monkeypatch.setattr("study.harness.record.folder.read_regular", counted)
    with Store(tmp_path).lock() as store:
        assert len(store.survey(wanted).done) == len(names)
    assert read.count("record.json") == len(names)
    read.clear()
    assert len(Store(tmp_path).survey(wanted).done) == len(names)
    assert "record.json" not in read


def test_the_index_is_written_while_a_long_run_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Whoever looks while it runs, or after a kill, reads a share of the records at most."""
    monkeypatch.setattr("study.harness.record.index.FEWEST", 10)
    with Store(tmp_path).lock() as store:
        for k in range(100):
            store.write(record(f"c{k}"))
        content = json.loads((tmp_path / "index.json").read_bytes())["content"]
        assert 70 <= len(content) < 100
