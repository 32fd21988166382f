"""Requests over HTTP: answered from this machine alone, read only, from two folders alone.

Whoever sent a results folder decides what it holds: a study that cannot be read is left out, and
one page reads no more than some thousand records. A page of another site can make a browser ask
127.0.0.1, under its own name too (DNS rebinding): what is asked of another host than the loopback
is refused, and no answer may be framed, sniffed or read by another origin.
"""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import quote, unquote, urlsplit

from study.ground.declaration import parse_toml
from study.ground.errors import Fault, InputError, StoreError
from study.ground.files import holder, read_existing, read_regular
from study.harness.design.load import REPORTS, RESULTS
from study.record.record import CONVERGED, ManifestDocument, fault_of, unseal
from study.record.store import CURRENT, FileStamp
from study.reporting.content.text import clean, slug
from study.reporting.output.page import (
    StudyProgress,
    StudyState,
    policy_hash,
    render_overview,
    table_script,
)

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
        self._studies: dict[Path, tuple[FileStamp, tuple[str, dict[str, str]] | None]] = {}
        self._records: dict[str, tuple[FileStamp, str, str]] = {}

    def states(self) -> list[StudyState]:
        """Every study of the results, by name; one whose manifest cannot be read is left out."""
        states: list[StudyState] = []
        self._left = MOST_RECORDS
        for folder in self._folders():
            stamp = FileStamp.of(folder / "study.json")
            if stamp is None:
                continue
            if folder not in self._studies or self._studies[folder][0] != stamp:
                self._studies[folder] = stamp, _read_study(folder / "study.json")
            if (study := self._studies[folder][1]) is not None:
                question, cases = study
                page = self.reports / folder.name / f"{slug(folder.name)}.html"
                address = "/".join(quote(os.fsencode(part)) for part in (folder.name, page.name))
                link = f"/reports/{address}" if os.path.isfile(page) else ""
                counted = self._counted(folder / "cases", cases)
                states.append(StudyState(folder.name, question, counted, progress_of(folder), link))
        return states

    def running(self) -> dict[str, dict[str, object]]:
        """Progress of the studies at work, by their names."""
        progress = {folder.name: progress_of(folder) for folder in self._folders()}
        return {name: vars(state) for name, state in progress.items() if state is not None}

    def _folders(self) -> list[Path]:
        """Folders with a manifest, by name."""
        folders = (self.results / name for name in sorted(_names(self.results)))
        studies = [folder for folder in folders if os.path.exists(folder / "study.json")]
        return studies[:MOST_STUDIES]

    def _counted(self, home: Path, cases: dict[str, str]) -> str:
        """Cases in words; of their records a page reads no more than are left to it."""
        counts = Counter(self._state(f"{home}{os.sep}{name}{os.sep}{CURRENT}", cases[name])
                         for name in cases.keys() & _names(home))  # fmt: skip
        counts["missing"] = len(cases) - counts["done"] - counts["failed"] - counts["unread"]
        parts = [f"{counts['done']:,} of {len(cases):,} done"]
        parts += [f"{counts[name]:,} {name}" for name in ("failed", "missing") if counts[name]]
        unread = counts["unread"]
        return ", ".join(parts + [f"{unread:,} not read yet: reload the page"] * bool(unread))

    def _state(self, path: str, made_of: str) -> str:
        """Whether the record at a path is that of its case, and how it ended."""
        stamp = FileStamp.of(path)
        if stamp is None:
            return "missing"
        if path not in self._records or self._records[path][0] != stamp:
            if self._left <= 0:
                return "unread"
            self._left -= 1
            content = _sealed(path)
            fields = content if isinstance(content, dict) else {}
            self._records[path] = (
                stamp, str(fields.get("status", "")), str(fields.get("input_hash", "")),
            )  # fmt: skip
        _, status, of_inputs = self._records[path]
        if of_inputs != made_of or not status:
            return "missing"
        return "done" if status == CONVERGED else "failed"


def _names(folder: Path) -> set[str]:
    """Names in a folder; none where it cannot be read."""
    try:
        return set(os.listdir(folder))
    except OSError:
        return set()


def progress_of(folder: Path) -> StudyProgress | None:
    """Read what the runner in a results folder said last; None where none is at work."""
    note = holder(folder)
    if note is None:
        return None
    done, total = note.get("done"), note.get("total")
    if not isinstance(done, int) or not isinstance(total, int):
        return StudyProgress(0, 0, "started")
    return StudyProgress(done, total, clean(note.get("counted", "at work"), _LONGEST))


def _read_study(path: Path) -> tuple[str, dict[str, str]] | None:
    content = _sealed(path)
    if fault_of(content, ManifestDocument):
        return None
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
#: headers of every answer, refusals included
_LOCKED = {
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cache-Control": "no-store",
    "Allow": "GET, HEAD",
}


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
    error_content_type = "text/plain; charset=utf-8"
    error_message_format = "%(explain)s\n"
    policy = _NOTHING  #: what the page that is sent may load

    def do_GET(self) -> None:  # noqa: N802 - named by http.server
        """Answer with a page, or with why there is none."""
        self.policy = _NOTHING  # a connection carries several requests
        try:
            self._answer()
        except StoreError as error:
            self.send_error(HTTPStatus.NOT_FOUND, explain=str(error))
        except (BrokenPipeError, ConnectionResetError, TimeoutError):
            self.close_connection = True  # the reader has gone

    do_HEAD = do_GET  # noqa: N815

    def _refuse(self) -> None:
        """Refuse whatever would change something, unread."""
        self.send_error(HTTPStatus.METHOD_NOT_ALLOWED, explain="pages are read only")

    do_POST = do_PUT = do_PATCH = do_DELETE = _refuse  # noqa: N815
    do_OPTIONS = do_TRACE = do_CONNECT = _refuse  # noqa: N815

    def log_message(self, format: str, *args: object) -> None:  # noqa: A002
        """Keep the terminal quiet."""

    def end_headers(self) -> None:
        """End the head of an answer with what holds for every one."""
        for name, value in {"Content-Security-Policy": self.policy, **_LOCKED}.items():
            self.send_header(name, value)
        super().end_headers()

    def _answer(self) -> None:
        port, folders = self.server.server_port, self.server.folders
        hosts = self.headers.get_all("Host") or []
        if hosts not in ([f"{LOOPBACK}:{port}"], [f"localhost:{port}"]):
            why = f"only {LOOPBACK}:{port} is answered"
            self.send_error(HTTPStatus.MISDIRECTED_REQUEST, explain=why)
        elif len(self.path) > MOST_ADDRESS or not self.path.startswith("/"):
            self.send_error(HTTPStatus.BAD_REQUEST, explain="this is no address of a page")
        elif (address := urlsplit(self.path).path) == "/":
            text, self.policy = render_overview(folders.states())
            self._send(text.encode("utf-8", "replace"), ".html")
        elif address == "/favicon.ico":  # a browser asks for it of its own accord
            self.send_response(HTTPStatus.NO_CONTENT)
            self.end_headers()
        elif address == "/progress.json":
            self._send(json.dumps(folders.running()).encode(), ".json")
        elif (path := report_file(folders.reports, address)) is None:
            self.send_error(HTTPStatus.NOT_FOUND, explain="there is no such page")
        else:
            self.policy = f"{_NOTHING}; frame-ancestors 'none'"
            if path.suffix == ".html":
                self.policy += f"; script-src '{policy_hash(table_script())}'; img-src 'self' data:"
            self._send(read_existing(path), path.suffix)

    def _send(self, body: bytes, ending: str) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", TYPES[ending])
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)


def report_file(reports: Path, address: str) -> Path | None:
    """File of a report that an address names, links followed; None if hidden or outside."""
    try:
        parts = unquote(address.removeprefix("/reports/"), errors="strict").split("/")
        path = reports.joinpath(*parts).resolve(strict=True)
        is_inside = path.is_relative_to(reports.resolve(strict=True))
    except (OSError, RuntimeError, ValueError):  # an address that is no UTF-8 is a ValueError
        return None
    is_plain = all(part[:1] not in ("", ".") and not set(part) & set("\\\0:") for part in parts)
    is_file = is_inside and is_plain and path.is_file() and path.suffix in TYPES
    return path if address.startswith("/reports/") and is_file else None


def serve(
    *,
    results: str | Path = RESULTS,
    reports: str | Path = REPORTS,
    port: int = 8765,
    ready: Callable[[str], None] | None = None,
) -> None:
    """Show results and reports in a browser until Ctrl-C; ``ready`` gets the address."""
    try:
        server = StudyServer(Folders(Path(results), Path(reports)), port)
    except OSError as error:
        rule = f"{port} cannot be listened on ({error.strerror or error})"
        raise InputError(Fault("--port", rule, "name another one; 0 takes a free one")) from None
    with server:
        if ready is not None:
            ready(server.address)
        server.serve_forever(poll_interval=0.2)
