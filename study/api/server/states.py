"""State of every study, read from its folders without changing a byte of them.

Whoever sent a results folder decides what it holds: a study that cannot be read is left out, and
one page reads no more than some thousand records.
"""

from __future__ import annotations

import itertools
import os
from pathlib import Path
from urllib.parse import quote

from study.bounded_file import read_regular
from study.design.toml_document import parse_toml
from study.errors import InputError, StoreError
from study.record import lock
from study.record.document import ManifestDocument
from study.record.document_checks import fault_of
from study.record.index import CURRENT, FileStamp
from study.record.record import CONVERGED, unseal
from study.reporting.figure.registry import slug
from study.reporting.output.overview_page import Progress, StudyState
from study.reporting.text import clean

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
        return {name: vars(one) for name, one in progress.items() if one is not None}

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
                self._records[path] = stamp, *_read_record(path)
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


def progress_of(folder: Path) -> Progress | None:
    """Read what the runner in a results folder said last; None where none is at work."""
    if not lock.is_locked(folder):
        return None
    note = lock.holder(folder)
    done, total = note.get("done"), note.get("total")
    if not isinstance(done, int) or not isinstance(total, int):
        return Progress(0, 0, "started")
    return Progress(done, total, clean(note.get("counted", "at work"), _LONGEST))


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


def _read_record(path: str) -> tuple[str, str]:
    """Status and input of a record; empty where it is damaged."""
    content = _sealed(path)
    fields = content if isinstance(content, dict) else {}
    return str(fields.get("status", "")), str(fields.get("input_hash", ""))


def _sealed(path: str | Path) -> object:
    """Content of a sealed file; None where it is damaged, too long or not there."""
    try:
        data = read_regular(path, MOST_BYTES)
        return None if data is None else unseal(data, str(path))
    except StoreError:
        return None
