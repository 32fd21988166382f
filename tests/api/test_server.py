"""Pages over HTTP: what is shown, who is answered, and that nothing outside two folders leaves."""

import contextlib
import http.client
import json
import os
import shutil
import socket
import threading

import pytest

from study import api
from study.api import serving
from study.api.serving import Folders
from study.ground.errors import InputError
from study.record.record import seal
from study.record.store import FileStamp, Store
from tests.cli.small import DESIGN, write_files
from tests.pages import served
from tests.waiting import CAP_S


@pytest.fixture(scope="module")
def home(tmp_path_factory):
    """Two finished studies, one with its report, and a secret beside them."""
    folder = tmp_path_factory.mktemp("served")
    write_files(folder)
    coarse = DESIGN.replace('"small"', '"coarse"', 1).replace("points = 30", "points = 20")
    coarse = coarse.replace("Does the energy", "<script>document.title=1</script> Does the energy")
    (folder / "coarse.toml").write_text(coarse)
    with contextlib.chdir(folder):
        api.run("small.toml", data="data", jobs=1, formats=("html",))
        api.run("coarse.toml", data="data", jobs=1, reports=None)
    (folder / "secret.html").write_text("secret")
    return folder


@pytest.fixture(scope="module")
def server(home):
    with served(home) as made:
        yield made


def ask(server, path, method="GET", host="", body=""):
    """Send one request as it stands, without the tidying of a client."""
    port = server.server_port
    lines = [f"{method} {path} HTTP/1.1", "Connection: close"]
    if host is not None:
        lines.append(f"Host: {host or f'127.0.0.1:{port}'}")
    if body:
        lines.append(f"Content-Length: {len(body)}")
    with socket.create_connection(("127.0.0.1", port), timeout=CAP_S) as sock:
        sock.sendall(("\r\n".join(lines) + "\r\n\r\n" + body).encode("latin-1"))
        reply = http.client.HTTPResponse(sock, method=method)
        reply.begin()
        text = reply.read().decode("utf-8", "replace")
        return reply.status, {k.lower(): v for k, v in reply.getheaders()}, text


def test_studies_are_listed_with_what_was_found(server):
    status, headers, text = ask(server, "/")
    assert status == 200
    assert headers["content-type"] == "text/html; charset=utf-8"
    assert text.count("12 of 12 done") == 2
    assert 'href="/reports/small/small.html"' in text
    assert "Does the energy" in text
    assert "<script>document.title" not in text
    assert "&lt;script&gt;document.title=1&lt;/script&gt;" in text


def test_a_report_is_the_file_itself(server, home):
    status, headers, text = ask(server, "/reports/small/small.html")
    assert status == 200
    assert text == (home / "reports/small/small.html").read_text("utf-8")
    assert "script-src 'sha256-" in headers["content-security-policy"]
    status, headers, text = ask(server, "/reports/small/small-data/cases.csv")
    assert headers["content-type"].startswith("text/csv")
    assert text == (home / "reports/small/small-data/cases.csv").read_text("utf-8")


def test_head_has_no_body(server):
    for path in ("/", "/reports/small/small.html", "/progress.json"):
        status, headers, text = ask(server, path, "HEAD")
        assert (status, text) == (200, "")
        assert int(headers["content-length"]) > 0


OUTSIDE = [
    "/reports/../secret.html",
    "/reports/..%2fsecret.html",
    "/reports/%2e%2e/secret.html",
    "/reports/%2e%2e%2fsecret.html",
    "/reports/small/../../secret.html",
    "/reports/small/..\\..\\secret.html",
    "/reports//secret.html",
    "/reports/link.html",
    "/reports/linked/secret.html",
    "/reports/small/.hidden.html",
    "/reports/small/small.html%00.csv",
    "/reports/small/small.html/",
    "/reports/small/",
    "/reports/small",
    "/reports/",
    "/reports",
    "/reports/%ff.html",
    "/reports/small/notes.py",
    "/results/small/study.json",
    "/secret.html",
    "/../secret.html",
    "//etc/passwd",
    "/etc/passwd",
    "/reports/" + "a" * 5000,
    "http://127.0.0.1/secret.html",
]


@pytest.mark.parametrize("path", OUTSIDE)
def test_nothing_outside_the_reports_leaves(server, home, path):
    reports = home / "reports"
    with contextlib.suppress(FileExistsError):
        (reports / "link.html").symlink_to(home / "secret.html")
        (reports / "linked").symlink_to(home)
        (reports / "small" / ".hidden.html").write_text("secret")
        (reports / "small" / "notes.py").write_text("secret")
    status, _, text = ask(server, path)
    assert status in (400, 404)
    assert "secret" not in text


@pytest.mark.parametrize(
    "host",
    ["evil.example", "127.0.0.1", "127.0.0.1:1", "evil.example:{port}", None, "[::1]:{port}"],
)
def test_other_hosts_are_not_answered(server, host):
    named = None if host is None else host.format(port=server.server_port)
    status, _, text = ask(server, "/", host=named)
    assert status == 421
    assert "small" not in text
    assert ask(server, "/", host=f"localhost:{server.server_port}")[0] == 200


@pytest.mark.parametrize("method", ["POST", "PUT", "PATCH", "DELETE", "OPTIONS", "TRACE"])
def test_nothing_can_be_changed(server, home, method):
    before = {p: p.stat().st_mtime_ns for p in home.rglob("*") if p.is_file()}
    status, headers, _ = ask(server, "/reports/small/small.html", method, body="x" * 10)
    assert (status, headers["allow"]) == (405, "GET, HEAD")
    assert {p: p.stat().st_mtime_ns for p in home.rglob("*") if p.is_file()} == before


def test_reading_changes_nothing(server, home):
    """A damaged record is not counted; a store would set it aside."""
    record = next((home / "results" / "coarse" / "cases").glob("*/record.json"))
    sound = record.read_bytes()
    record.write_bytes(sound[:-20])
    before = {p: p.stat().st_mtime_ns for p in home.rglob("*") if p.is_file()}
    try:
        assert "11 of 12 done, 1 missing" in ask(server, "/")[2]
        assert {p: p.stat().st_mtime_ns for p in home.rglob("*") if p.is_file()} == before
    finally:
        record.write_bytes(sound)
    assert ask(server, "/")[2].count("12 of 12 done") == 2


@pytest.mark.parametrize("path", ["/", "/progress.json", "/reports/small/small.html", "/nothing"])
def test_every_answer_is_locked_down(server, path):
    _, headers, _ = ask(server, path)
    policy = headers["content-security-policy"]
    assert policy.startswith("default-src 'none'")
    assert "frame-ancestors 'none'" in policy or path in ("/progress.json", "/nothing")
    assert headers["x-content-type-options"] == "nosniff"
    assert headers["x-frame-options"] == "DENY"
    assert headers["cross-origin-resource-policy"] == "same-origin"
    assert headers["cache-control"] == "no-store"
    assert "access-control-allow-origin" not in headers
    assert "Python" not in headers["server"]


def test_a_study_at_work_shows_how_far_it_is(server, home):
    assert json.loads(ask(server, "/progress.json")[2]) == {}
    store = Store(home / "results" / "small")
    with store.lock():
        store.note({"done": 5, "total": 24, "counted": "2/12 cases, 3/12 calibrations"})
        running = json.loads(ask(server, "/progress.json")[2])
        assert running == {
            "small": {"done": 5, "total": 24, "said": "2/12 cases, 3/12 calibrations"}
        }
        text = ask(server, "/")[2]
        assert '<progress data-study="small" max="24" value="5"' in text
        assert "2/12 cases, 3/12 calibrations" in text
    assert "No study is running" in ask(server, "/")[2]


def test_only_the_loopback_listens(server):
    assert server.server_address[0] == "127.0.0.1"
    other = socket.gethostbyname(socket.gethostname())
    if other.startswith("127."):
        pytest.skip("this machine has no other address")
    with (
        pytest.raises(OSError, match=r".+"),
        socket.create_connection((other, server.server_port), 2),
    ):
        pass


def test_folders_that_are_not_there_yet(tmp_path):
    assert Folders(tmp_path / "results", tmp_path / "reports").states() == []


def manifest(cases, **more):
    empty = {"design": "", "text": "", "source": "", "blocks": [], "notes": [], "virtual": False}
    return seal({"name": "hostile", **empty, "cases": cases, **more})


def planted(study, kind):
    """Put a hostile manifest, or what is none, into the folder of a study."""
    study.mkdir(parents=True)
    path = study / "study.json"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "endless":
        path.symlink_to("/dev/zero")
    elif kind == "deep":
        path.write_text("[" * 100_000)
    elif kind == "deep design":
        path.write_text(manifest({}, design="a = " + "[" * 5000))
    elif kind == "NUL":
        path.write_text(manifest({"a\0b": "0" * 64, "../../../secret": "1"}))
    elif kind == "pipes":
        path.write_text(manifest({"a": "0" * 64}))
        (study / "cases" / "a").mkdir(parents=True)
        os.mkfifo(study / "cases" / "a" / "record.json")
        os.mkfifo(study / ".lock")
    else:
        path.write_text(manifest({f"case-{k}": "0" * 64 for k in range(200_000)}))


HOSTILE = {
    "pipe": False, "endless": False, "deep": False, "deep design": True, "NUL": True,
    "pipes": True, "many": True,
}  # fmt: skip


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_study_is_answered_and_hides_no_other(server, home, kind):
    name = os.fsdecode(b"hostile-\xff")  # no text in UTF-8
    study = home / "results" / name
    planted(study, kind)
    try:
        status, _, text = ask(server, "/")
        assert (status, text.count("12 of 12 done")) == (200, 2)
        assert ("hostile-" in text) == HOSTILE[kind]
        assert ask(server, "/progress.json")[0] == 200
    finally:
        shutil.rmtree(study)


def test_a_page_looks_only_at_cases_that_are_there_and_reads_a_manifest_once(tmp_path, monkeypatch):
    planted(tmp_path / "results" / "many", "many")
    looked, read = [], []
    stamp, whole = FileStamp.of, serving._read_study
    monkeypatch.setattr(FileStamp, "of", lambda path: looked.append(path) or stamp(path))
    monkeypatch.setattr(serving, "_read_study", lambda path: read.append(path) or whole(path))
    folders = Folders(tmp_path / "results", tmp_path / "reports")
    for _ in range(3):
        (state,) = folders.states()
        assert state.cases == "0 of 200,000 done, 200,000 missing"
    assert (len(looked), len(read)) == (3, 1)


def test_records_are_read_some_at_a_time(home, monkeypatch):
    monkeypatch.setattr(serving, "MOST_RECORDS", 8)
    folders = Folders(home / "results", home / "reports")
    pages = [[state.cases for state in folders.states()] for _ in range(4)]
    assert pages == [
        ["8 of 12 done, 4 not read yet: reload the page",
         "0 of 12 done, 12 not read yet: reload the page"],
        ["12 of 12 done", "4 of 12 done, 8 not read yet: reload the page"],
        ["12 of 12 done", "12 of 12 done"],
        ["12 of 12 done", "12 of 12 done"],
    ]  # fmt: skip


def test_a_report_that_is_a_pipe_is_no_file(server, home):
    for name in ("pipe.html", "small/pipe.csv"):
        os.mkfifo(home / "reports" / name)
        assert ask(server, f"/reports/{name}")[0] == 404


def test_a_port_that_is_taken_is_refused(server):
    with pytest.raises(InputError, match="0 takes a free one"):
        api.serve(port=server.server_port)


def test_a_runner_is_not_turned_away_by_who_looks(home):
    """Looking whether a folder is locked takes the lock for a moment."""
    import fcntl

    folder = home / "results" / "small"
    handle = os.open(folder / ".lock", os.O_RDONLY)
    fcntl.flock(handle, fcntl.LOCK_SH)
    timer = threading.Timer(0.02, os.close, [handle])
    timer.start()
    with Store(folder).lock():
        pass
    timer.join()
