"""Requests over HTTP: answered from this machine alone, read only, from two folders alone.

A page of another site can make a browser ask 127.0.0.1, under its own name too (DNS rebinding):
what is asked of another host than the loopback is refused, and no answer may be framed, sniffed
or read by another origin.
"""

from __future__ import annotations

import itertools
import json
import os
import shutil
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from study.api.folders import REPORTS, RESULTS
from study.ground.bounded_file import open_regular, read_regular
from study.ground.errors import Fault, InputError, StoreError
from study.harness.design.diagnostics import parse_toml
from study.harness.record import atomic_files
from study.harness.record.document import ManifestDocument, fault_of
from study.harness.record.index import CURRENT, FileStamp
from study.harness.record.record import CONVERGED, unseal
from study.reporting.content.text import clean
from study.reporting.figures.registry import slug
from study.reporting.output.page import (
    StudyProgress,
    StudyState,
    policy_hash,
    render_overview,
    table_script,
)

# State of every study, read from its folders without changing a byte of them.
#
# Whoever sent a results folder decides what it holds: a study that cannot be read is left out, and
# one page reads no more than some thousand records.

#: bytes of a manifest or a record beyond which it is not read
MOST_BYTES = 30_000_000
#: studies beyond which only the first are shown
MOST_STUDIES = 500
#: records that are read for one page; those that were read before and still stand are not counted
MOST_RECORDS = 3000
#: characters of a question
_LONGEST = 300


class Folders:
    """Folders of results and reports; what was read of a file in them is kept while it stands."""

    def __init__(self, results: Path, reports: Path) -> None:
        self.results, self.reports = results, reports
        #: question and inputs of the cases of a manifest, and status and input of a record
        self._studies: dict[Path, tuple[FileStamp, str, dict[str, str] | None]] = {}
        self._records: dict[str, tuple[FileStamp, str, str]] = {}

    def states(self) -> list[StudyState]:
        """Every study of the results, by name; one whose manifest cannot be read is left out."""
        states: list[StudyState] = []
        left = MOST_RECORDS
        for folder in self._folders():
            question, cases = self._study(folder)
            if cases is not None:
                counted, left = self._counted(folder / "cases", cases, left)
                page = self.reports / folder.name / f"{slug(folder.name)}.html"
                address = "/".join(quote(os.fsencode(part)) for part in (folder.name, page.name))
                link = f"/reports/{address}" if os.path.isfile(page) else ""
                progress = progress_of(folder)
                states.append(StudyState(folder.name, question, counted, progress, link))
        return states

    def running(self) -> dict[str, dict[str, object]]:
        """Progress of the studies at work, by their names."""
        progress = {folder.name: progress_of(folder) for folder in self._folders()}
        return {
            name: vars(progress_of_study)
            for name, progress_of_study in progress.items()
            if progress_of_study is not None
        }

    def _folders(self) -> list[Path]:
        """Folders with a manifest, by name."""
        folders = (self.results / name for name in sorted(_names(self.results)))
        studies = (folder for folder in folders if os.path.exists(folder / "study.json"))
        return list(itertools.islice(studies, MOST_STUDIES))

    def _study(self, folder: Path) -> tuple[str, dict[str, str] | None]:
        """Question of a study and the input of every case; None where it cannot be read."""
        path = folder / "study.json"
        stamp = FileStamp.of(path)
        if stamp is None:
            return "", None
        if folder not in self._studies or self._studies[folder][0] != stamp:
            self._studies[folder] = stamp, *_read_study(path)
        return self._studies[folder][1:]

    def _counted(self, home: Path, cases: dict[str, str], left: int) -> tuple[str, int]:
        """Cases in words, of which so many records may be read; how many more may be."""
        done = failed = unread = 0
        for name in cases.keys() & _names(home):
            path = f"{home}{os.sep}{name}{os.sep}{CURRENT}"
            stamp = FileStamp.of(path)
            if stamp is None:
                continue
            if path not in self._records or self._records[path][0] != stamp:
                unread += not left
                if not left:
                    continue
                left -= 1
                # status and input of a record; empty where it is damaged
                content = _sealed(path)
                fields = content if isinstance(content, dict) else {}
                self._records[path] = (
                    stamp,
                    *(str(fields.get("status", "")), str(fields.get("input_hash", ""))),
                )
            _, status, made_of = self._records[path]
            done += made_of == cases[name] and status == CONVERGED
            failed += made_of == cases[name] and status not in ("", CONVERGED)
        missing = len(cases) - done - failed - unread
        parts = [f"{done:,} of {len(cases):,} done"]
        parts += [f"{failed:,} failed"] if failed else []
        parts += [f"{missing:,} missing"] if missing else []
        parts += [f"{unread:,} not read yet: reload the page"] if unread else []
        return ", ".join(parts), left


def _names(folder: Path) -> set[str]:
    """Names in a folder; none where it cannot be read."""
    try:
        return set(os.listdir(folder))
    except OSError:
        return set()


def progress_of(folder: Path) -> StudyProgress | None:
    """Read what the runner in a results folder said last; None where none is at work."""
    if not atomic_files.is_locked(folder):
        return None
    note = atomic_files.holder(folder)
    done, total = note.get("done"), note.get("total")
    if not isinstance(done, int) or not isinstance(total, int):
        return StudyProgress(0, 0, "started")
    return StudyProgress(done, total, clean(note.get("counted", "at work"), _LONGEST))


def _read_study(path: Path) -> tuple[str, dict[str, str] | None]:
    content = _sealed(path)
    if fault_of(content, ManifestDocument):
        return "", None
    manifest: ManifestDocument = content  # type: ignore[assignment]
    try:
        section = parse_toml(manifest["design"], "study.json").get("study")
    except InputError:
        section = None
    question = section.get("question", "") if isinstance(section, dict) else ""
    return clean(question, _LONGEST), manifest["cases"]


def _sealed(path: str | Path) -> object:
    """Content of a sealed file; None where it is damaged, too long or not there."""
    try:
        data = read_regular(path, MOST_BYTES)
        return None if data is None else unseal(data, str(path))
    except StoreError:
        return None


LOOPBACK = "127.0.0.1"
MOST_ADDRESS = 4096
#: kinds of files of a report by the ends of their names
TYPES = {
    ".html": "text/html; charset=utf-8",
    ".svg": "image/svg+xml",
    ".csv": "text/csv; charset=utf-8",
    ".gz": "application/gzip",
    ".json": "application/json",
    ".tex": "text/plain; charset=utf-8",
    ".pdf": "application/pdf",
}
_NOTHING = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


class Refused(Exception):
    """A request that is not answered, and why."""

    def __init__(self, status: HTTPStatus, why: str) -> None:
        super().__init__(why)
        self.status, self.why = status, why


class StudyServer(ThreadingHTTPServer):
    """Server of some folders on the loopback interface; port 0 takes a free one."""

    daemon_threads = True

    def __init__(self, folders: Folders, port: int) -> None:
        super().__init__((LOOPBACK, port), Handler)
        self.folders = folders
        self.address = f"http://{LOOPBACK}:{self.server_port}/"


class Handler(BaseHTTPRequestHandler):
    """One request."""

    server: StudyServer
    server_version = "study"
    sys_version = ""
    protocol_version = "HTTP/1.1"
    timeout = 30

    def do_GET(self) -> None:  # noqa: N802 - named by http.server
        """Answer with a page, or with why there is none."""
        try:
            self._check_host()
            self._answer()
        except Refused as refused:
            self._send(refused.status, f"{refused.why}\n".encode(), "text/plain; charset=utf-8")
        except (BrokenPipeError, ConnectionResetError, TimeoutError):
            self.close_connection = True  # the reader has gone

    do_HEAD = do_GET  # noqa: N815

    def _refuse(self) -> None:
        """Refuse whatever would change something."""
        self.close_connection = True  # what it carries is not read
        body = b"pages are read only\n"
        self._send(HTTPStatus.METHOD_NOT_ALLOWED, body, "text/plain; charset=utf-8")

    do_POST = do_PUT = do_PATCH = do_DELETE = _refuse  # noqa: N815
    do_OPTIONS = do_TRACE = do_CONNECT = _refuse  # noqa: N815

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Keep the terminal quiet."""

    def _check_host(self) -> None:
        port = self.server.server_port
        hosts = self.headers.get_all("Host") or []
        if hosts not in ([f"{LOOPBACK}:{port}"], [f"localhost:{port}"]):
            why = f"only {LOOPBACK}:{port} is answered"
            raise Refused(HTTPStatus.MISDIRECTED_REQUEST, why)

    def _answer(self) -> None:
        if len(self.path) > MOST_ADDRESS or not self.path.startswith("/"):
            raise Refused(HTTPStatus.BAD_REQUEST, "this is no address of a page")
        url = urlsplit(self.path)
        if url.path == "/":
            text, policy = render_overview(self.server.folders.states())
            self._send(HTTPStatus.OK, text.encode("utf-8", "replace"), TYPES[".html"], policy)
        elif url.path == "/favicon.ico":  # a browser asks for it of its own accord
            self._send(HTTPStatus.NO_CONTENT, b"", "image/x-icon")
        elif url.path == "/progress.json":
            body = json.dumps(self.server.folders.running()).encode()
            self._send(HTTPStatus.OK, body, TYPES[".json"])
        elif url.path.startswith("/reports/"):
            self._file(url.path.removeprefix("/reports/"))
        else:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such page")

    def _file(self, address: str) -> None:
        path = report_file(self.server.folders.reports, address)
        policy = _NOTHING
        if path.suffix == ".html":
            policy += f"; script-src '{policy_hash(table_script())}'; img-src 'self' data:"
        try:
            stream = open_regular(path)
        except StoreError as error:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such file") from error
        if stream is None:
            raise Refused(HTTPStatus.NOT_FOUND, "there is no such file")
        with stream:
            size = os.fstat(stream.fileno()).st_size
            self._head(HTTPStatus.OK, size, TYPES[path.suffix], f"{policy}; frame-ancestors 'none'")
            if self.command != "HEAD":
                shutil.copyfileobj(stream, self.wfile)

    def _send(self, status: HTTPStatus, body: bytes, kind: str, policy: str = _NOTHING) -> None:
        self._head(status, len(body), kind, policy)
        if self.command != "HEAD":
            self.wfile.write(body)

    def _head(self, status: HTTPStatus, size: int, kind: str, policy: str) -> None:
        self.send_response(status)
        for name, value in (
            ("Content-Type", kind),
            ("Content-Length", str(size)),
            ("Content-Security-Policy", policy),
            ("X-Content-Type-Options", "nosniff"),
            ("X-Frame-Options", "DENY"),
            ("Referrer-Policy", "no-referrer"),
            ("Cross-Origin-Resource-Policy", "same-origin"),
            ("Cross-Origin-Opener-Policy", "same-origin"),
            ("Cache-Control", "no-store"),
        ):
            self.send_header(name, value)
        if status is HTTPStatus.METHOD_NOT_ALLOWED:
            self.send_header("Allow", "GET, HEAD")
        if self.close_connection:
            self.send_header("Connection", "close")
        self.end_headers()


def report_file(reports: Path, address: str) -> Path:
    """File of a report that an address names, links followed.

    Refused if it leaves the folder of the reports, is hidden, or is no file of a report.
    """
    absent = Refused(HTTPStatus.NOT_FOUND, "there is no such file")
    try:
        parts = unquote(address, errors="strict").split("/")
    except UnicodeDecodeError:
        raise absent from None
    if any(not part or part.startswith(".") or set(part) & set("\\\0:") for part in parts):
        raise absent
    try:
        path = reports.joinpath(*parts).resolve(strict=True)
        inside = path.is_relative_to(reports.resolve(strict=True))
    except (OSError, RuntimeError, ValueError):
        raise absent from None
    if not inside or not path.is_file() or path.suffix not in TYPES:
        raise absent
    return path


# Serve pages until the user stops it.


def serve(
    *,
    results: str | Path = RESULTS,
    reports: str | Path = REPORTS,
    port: int = 8765,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Show studies at work, finished ones and their reports in a browser, until Ctrl-C.

    Nobody but this machine is answered, and nothing is written.

    Parameters
    ----------
    results, reports : str or Path
        Folders that ``study run`` writes; they may be made later.
    port : int
        Port on 127.0.0.1; 0 takes a free one.
    ready : callable, optional
        Called with the address once it is answered.

    Raises
    ------
    InputError
        If the port is taken.
    KeyboardInterrupt
        On Ctrl-C.
    """
    try:
        server = StudyServer(Folders(Path(results), Path(reports)), port)
    except OSError as error:
        rule = f"{port} cannot be listened on ({error.strerror or error})"
        raise InputError(Fault("--port", rule, "name another one; 0 takes a free one")) from None
    with server:
        if ready is not None:
            ready(server.address)
        server.serve_forever(poll_interval=0.2)
