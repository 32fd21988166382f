"""Damaged files and full disks: an answer or a refusal in words, and nothing half written."""

import errno
import json
import os
import re
import shutil
from pathlib import Path

import pytest

from study import api
from study.ground.errors import DiskFullError, StoreError
from study.ground.files import FileSystem, replaced, write_new
from study.record.record import Record, seal
from tests.cli.small import refusal, study, success
from validation.damage import damages, sealed
from validation.fuzz import BUG, obey

#: one damage of so many is looked at where it need not be all
FEW = 600

READERS = (
    ("status", "small"),
    ("plan", "small.toml", "--data", "data"),
    ("analyze", "results/small"),
    ("report", "small", "--format", "csv"),
)
RUN = ("run", "small.toml", "--data", "data", "--jobs", "1")
SMALL = Path("results/small")


def records():
    """Records of the study, by name."""
    return sorted(SMALL.glob("cases/*/record.json"))


def fault(words):
    """Say what is wrong with the answer to a verb; empty if nothing is."""
    answer = study(*words)
    said = answer.out + answer.err
    found = BUG.search(said)
    if found is not None:
        return f"{words[0]}: {said[max(found.start() - 100, 0) : found.end() + 100]}"
    if answer.code not in (0, 1, 2, 3) or (answer.code and len(said.split()) < 3):
        return f"{words[0]}: exit code {answer.code}, {said!r}"
    return ""


def accepted(content):
    """Damages that make no record invalid; the others are one and the same to every verb."""
    for damage in damages(content):
        try:
            Record.from_json(sealed(damage.content).encode())
        except StoreError:
            continue
        yield damage


def look(path, found, verbs):
    """Damage a file in some ways, and list what is wrong with the answers."""
    whole = {one: one.read_bytes() for one in SMALL.rglob("*") if one.is_file()}
    wrong = []
    for damage in found:
        path.write_text(sealed(damage.content))
        wrong += [f"{path.name}: {damage}: {said}" for verb in verbs if (said := fault(verb))]
        for one in [one for one in SMALL.rglob("*") if one.is_file() and one not in whole]:
            one.unlink()
        for one, data in whole.items():
            one.write_bytes(data)
    return wrong


def content_of(path):
    """Content of a sealed file."""
    return json.loads(path.read_bytes())["content"]


@pytest.mark.parametrize(
    "step", [FEW, pytest.param(1, marks=[pytest.mark.slow, pytest.mark.verify])]
)
def test_damages_of_a_record(done, step):
    path = records()[0]
    found = list(accepted(content_of(path)))
    why = ("why", path.parent.name[:8])
    assert not look(path, found[::step], [*READERS, why])


NAMES = ["study", "numerical", "runs/run-1", "fits/*"]


@pytest.mark.parametrize("name", NAMES)
def test_some_damages_of_other_files(done, name):
    path = sorted(SMALL.glob(f"{name}.json"))[0]
    found = list(damages(content_of(path)))
    verbs = READERS[:2] if name == "study" else ()
    assert not look(path, found[1 :: len(found) // 2], verbs)
    records()[0].unlink()  # a case that is missing has its fit read
    assert not look(path, found[2 :: len(found) // 2], [RUN])


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_all_damages_of_other_files(done, name):
    path = sorted(SMALL.glob(f"{name}.json"))[0]
    for record in records():
        record.unlink()
    assert not look(path, list(damages(content_of(path))), [*READERS, RUN])


ROWS = (None, 1, [1], [{}], {"a": 1}, [[]], ["x"])


def test_rows_that_are_none_are_set_aside_and_named(done):
    names = ("numerical", "spaces", "validation", "adaptive", "confirmed")
    for content in ROWS:
        for name in names:
            (SMALL / f"{name}.json").write_text(seal(content))
        warnings = api.load(SMALL).warnings
        for name in names:
            (said,) = [one for one in warnings if f"{name}.json: " in one]
            assert said.endswith("it is not used, and the next run replaces it"), content
    assert study("report", "small", "--format", "csv").code == 0


def test_an_unfinished_manifest_that_is_none_is_as_none(done):
    for content in ([1], {}, "x", {"a": 1}):
        (SMALL / "unfinished.json").write_text(seal(content))
        assert study("status", "small", "--json").json["unfinished"] is None
    for verb in (*READERS, ("why", records()[0].parent.name)):
        assert not fault(verb)


def mended(path, answer):
    """Check that a damaged file was named, kept beside, and written once more."""
    assert answer.code == 0, answer.err
    assert re.search(rf"{path.name}: .*renamed to {path.name}\.corrupt-1", answer.err)
    assert path.with_name(f"{path.name}.corrupt-1").is_file()
    assert path.is_file()


@pytest.mark.parametrize("key", ["key", "correlation", "n"])
def test_a_record_of_a_wrong_fit_is_named_kept_and_computed_again(done, key):
    path = records()[0]
    before, content = path.read_bytes(), json.loads(path.read_bytes())["content"]
    content["fit"]["A"][key] = -1
    path.write_text(seal(content))
    assert study("status", "small", "--json").json["cases"]["missing"] == 1
    mended(path, study(*RUN))
    again, first = (json.loads(data)["content"] for data in (path.read_bytes(), before))
    assert again["fit"]["A"]["values"] == first["fit"]["A"]["values"]


def test_a_fit_of_wrong_content_is_named_kept_and_computed_again(done):
    content = json.loads(records()[0].read_bytes())["content"]
    path = SMALL / "fits" / f"{content['fit']['A']['key']}.json"
    records()[0].unlink()
    path.write_text(seal({}))
    mended(path, study(*RUN))


def test_a_manifest_of_wrong_content_is_named_kept_and_written_again(done):
    path = SMALL / "study.json"
    content = json.loads(path.read_bytes())["content"]
    del content["blocks"]
    path.write_text(seal(content))
    for words in (("status", "small"), ("report", "small"), ("analyze", "results/small")):
        answer = refusal(*words)
        assert "its manifest is damaged; run the design again" in answer.err
    mended(path, study(*RUN))


def test_a_pipe_in_the_place_of_the_lock_is_refused(done):
    (SMALL / ".lock").unlink()
    os.mkfifo(SMALL / ".lock")
    assert study("status", "small").code == 0
    answer = refusal(*RUN)
    assert ".lock: cannot be written (it is no file; remove it)" in answer.err


@pytest.fixture(scope="module")
def drawn(finished, tmp_path_factory):
    """A study with its page: it draws its figures, which takes seconds."""
    folder = tmp_path_factory.mktemp("drawn") / "copy"
    shutil.copytree(finished.folder, folder)
    success("report small --format csv,html", folder=folder)
    return folder


@pytest.mark.parametrize(
    ("place", "mode", "report"),
    [
        ("reports/small/small-data", 0o000, "small"),
        ("reports", 0o000, ""),
        ("results/small/cases", 0o444, ""),
    ],
)
def test_what_may_not_be_read_is_told(drawn, inside, place, mode, report):
    """Rights are obeyed by root, too, for as long as it asks."""
    shutil.copytree(drawn, inside, dirs_exist_ok=True)
    verbs = [READERS[0], RUN, *([("verify", report)] if report else [])]
    os.chmod(place, mode)
    obey(True)
    try:
        wrong = [said for verb in verbs if (said := fault(verb))]
    finally:
        obey(False)
        os.chmod(place, 0o755)
    assert not wrong


@pytest.fixture
def fill(monkeypatch):
    """Let writes fail in the middle that a condition of path and number picks."""
    whole, written = FileSystem.write, [0]

    def fill_up(is_full, error=errno.ENOSPC):
        def write(system, path, data):
            written[0] += 1
            if not is_full(path, written[0]):
                return whole(system, path, data)
            path.write_bytes(data[: len(data) // 2])
            raise OSError(error, os.strerror(error))

        monkeypatch.setattr(FileSystem, "write", write)

    return fill_up


def halves(folder):
    """Files that an unfinished write would leave."""
    return sorted(folder.rglob("*.part"))


@pytest.mark.parametrize(
    ("error", "first"), [(errno.ENOSPC, 130), (errno.EACCES, 2)], ids=["full", "forbidden"]
)
def test_a_run_that_may_write_no_longer_is_stopped_and_resumes(home, fill, error, first):
    """Exit 2 says that nothing was written, which is true of the first file alone."""
    written = []

    def after_three_records(path, number):
        written.extend([path] * ("record.json" in path.name))
        return len(written) > 3

    fill(after_three_records, error)
    answer = study(*RUN)
    assert answer.code == 130
    assert os.strerror(error) in answer.err
    assert f"To resume:\n  study {' '.join(RUN)}\n" in answer.err
    assert "Traceback" not in answer.err
    assert not halves(home)
    assert len(records()) == 3
    fill(lambda path, number: True, error)
    answer = study("run small.toml --data data --results other")
    assert (answer.code, answer.out) == (first, "")
    fill(lambda path, number: False)
    success(*RUN)
    assert not halves(home)


@pytest.mark.parametrize(
    ("name", "command"),
    [
        ("numbers.json", "report small --format csv --reports pages"),
        ("small.html", "report small --format html --reports pages"),
        ("numbers.json", "analyze t.csv --response y --factors a,b --report page --format csv"),
    ],
)
def test_a_report_on_a_full_disk_leaves_no_part_of_a_file(done, fill, name, command):
    rows = "".join(f"{a},{b},{k}\n" for k, (a, b) in enumerate(("xu", "xv", "yu", "yv") * 3))
    (done / "t.csv").write_text("a,b,y\n" + rows)
    fill(lambda path, number: name in path.name)
    answer = study(command)
    assert answer.code == 1
    assert "could not be written (No space left on device)" in answer.err
    assert not halves(done)


def half_written(path):
    with replaced(path) as part:
        part.write_text("half")
        raise OSError(errno.EDQUOT, "Disk quota exceeded")


def test_a_new_file_is_there_whole_or_not_at_all(tmp_path, fill):
    fill(lambda path, number: True)
    with pytest.raises(DiskFullError):
        write_new(tmp_path / "new.toml", "schema = 1\n")
    with pytest.raises(DiskFullError):
        half_written(tmp_path / "out.vtu")
    assert not list(tmp_path.iterdir())
