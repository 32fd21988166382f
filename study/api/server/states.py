"""State of every study, read from its folders without changing a byte of them.

Whoever sent a results folder decides what it holds: a study that cannot be read is left out, and
one page reads no more than some thousand records.
"""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
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


@dataclass(frozen=True)
class _Study:
    """What a manifest says: the question, and the input of every case."""

    question: str
    cases: dict[str, str]


class Folders:
    """Results and reports that are shown; what was read of a file is kept while it stands.

    Parameters
    ----------
    results, reports : Path
        Folders that ``study run`` writes.
    """

    def __init__(self, results: Path, reports: Path) -> None:
        self.results, self.reports = results, reports
        self._studies: dict[Path, tuple[FileStamp, _Study | None]] = {}
        self._records: dict[str, tuple[FileStamp, str, str]] = {}

    def states(self) -> list[StudyState]:
        """Every study of the results, by name; one whose manifest cannot be read is left out."""
        states = []
        left = MOST_RECORDS
        for folder in self._folders():
            study = self._study(folder)
            if study is not None:
                state, left = self._state(folder, study, left)
                states.append(state)
        return states

    def running(self) -> dict[str, dict[str, object]]:
        """Progress of the studies at work, by their names."""
        progress = {folder.name: progress_of(folder) for folder in self._folders()}
        return {name: one.to_json() for name, one in progress.items() if one is not None}

    def _folders(self) -> list[Path]:
        """Folders with a manifest, by name."""
        folders = (self.results / name for name in sorted(_names(self.results)))
        studies = (folder for folder in folders if os.path.exists(folder / "study.json"))
        return list(itertools.islice(studies, MOST_STUDIES))

    def _study(self, folder: Path) -> _Study | None:
        stamp = FileStamp.of(folder / "study.json")
        known = self._studies.get(folder)
        if stamp is not None and (known is None or known[0] != stamp):
            known = self._studies[folder] = stamp, _read_study(folder / "study.json")
        return None if stamp is None or known is None else known[1]

    def _state(self, folder: Path, study: _Study, left: int) -> tuple[StudyState, int]:
        """State of a study, of which so many records may be read; how many more may be."""
        home = folder / "cases"
        statuses = []
        unread = 0
        for name in study.cases.keys() & _names(home):
            path = f"{home}{os.sep}{name}{os.sep}{CURRENT}"
            stamp = FileStamp.of(path)
            if stamp is None:
                continue
            known = self._records.get(path)
            if known is None or known[0] != stamp:
                if not left:
                    unread += 1
                    continue
                left -= 1
                known = self._records[path] = stamp, *_read_record(path)
            if known[2] == study.cases[name]:
                statuses.append(known[1])
        done = statuses.count(CONVERGED)
        failed = len(statuses) - done - statuses.count("")
        stem = slug(folder.name)
        page = self.reports / folder.name / f"{stem}.html"
        address = "/".join(quote(os.fsencode(part)) for part in (folder.name, f"{stem}.html"))
        state = StudyState(
            folder.name, study.question, len(study.cases), done, failed, unread,
            progress_of(folder), f"/reports/{address}" if os.path.isfile(page) else "",
        )  # fmt: skip
        return state, left


def _names(folder: Path) -> set[str]:
    """Names in a folder; none where it cannot be read."""
    try:
        return set(os.listdir(folder))
    except OSError:
        return set()


def progress_of(folder: Path) -> Progress | None:
    """Read what the runner in a folder said last; None where none is at work.

    Parameters
    ----------
    folder : Path
        Results of one study.

    Returns
    -------
    Progress or None
        0 of 0 and ``"started"`` where the runner has said nothing yet.
    """
    if not lock.is_locked(folder):
        return None
    note = lock.holder(folder)
    done, total = note.get("done"), note.get("total")
    if not isinstance(done, int) or not isinstance(total, int):
        return Progress(0, 0, "started")
    return Progress(done, total, clean(note.get("counted", "at work"), _LONGEST))


def _read_study(path: Path) -> _Study | None:
    content = _sealed(path)
    if fault_of(content, ManifestDocument):
        return None
    manifest: ManifestDocument = content  # type: ignore[assignment]
    try:
        section = parse_toml(manifest["design"], "study.json").get("study")
    except InputError:
        section = None
    question = section.get("question", "") if isinstance(section, dict) else ""
    return _Study(clean(question, _LONGEST), manifest["cases"])


def _read_record(path: str) -> tuple[str, str]:
    """Status and input of a record; empty where it is damaged."""
    content = _sealed(path)
    if not isinstance(content, dict):
        return "", ""
    return str(content.get("status", "")), str(content.get("input_hash", ""))


def _sealed(path: str | Path) -> object:
    """Content of a sealed file; None where it is damaged, too long or not there."""
    try:
        data = read_regular(path, MOST_BYTES)
        return None if data is None else unseal(data, str(path))
    except StoreError:
        return None
