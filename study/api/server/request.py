"""Requests over HTTP: answered from this machine alone, read only, from two folders alone.

A page of another site can make a browser ask 127.0.0.1, under its own name too (DNS rebinding):
what is asked of another host than the loopback is refused, and no answer may be framed, sniffed
or read by another origin.
"""

from __future__ import annotations

import json
import os
import shutil
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import unquote, urlsplit

from study.api.server.states import Folders
from study.bounded_file import open_regular
from study.errors import StoreError
from study.reporting.output.overview_page import render_overview
from study.reporting.output.page import policy_hash, table_script

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
        asked = urlsplit(self.path)
        if asked.path == "/":
            text, policy = render_overview(self.server.folders.states())
            self._send(HTTPStatus.OK, text.encode("utf-8", "replace"), TYPES[".html"], policy)
        elif asked.path == "/favicon.ico":  # a browser asks for it of its own accord
            self._send(HTTPStatus.NO_CONTENT, b"", "image/x-icon")
        elif asked.path == "/progress.json":
            body = json.dumps(self.server.folders.running()).encode()
            self._send(HTTPStatus.OK, body, TYPES[".json"])
        elif asked.path.startswith("/reports/"):
            self._file(asked.path.removeprefix("/reports/"))
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
        found = reports.joinpath(*parts).resolve(strict=True)
        inside = found.is_relative_to(reports.resolve(strict=True))
    except (OSError, RuntimeError, ValueError):
        raise absent from None
    if not inside or not found.is_file() or found.suffix not in TYPES:
        raise absent
    return found
