"""State of every study, read from its folders without changing a byte of them.

A store sets damaged records aside; here they are only not counted.
"""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Mapping
from pathlib import Path
from urllib.parse import quote

from study.api.planning.remaining_time import seconds_left
from study.design.load import loads
from study.errors import InputError, StoreError
from study.record import lock
from study.record.record import unseal
from study.reporting.figure.registry import slug
from study.reporting.output.overview_page import Conclusion, Progress, StudyState
from study.runner.expansion import units_asked

#: bytes of a manifest, a record or a table beyond which it is not read
MOST_BYTES = 50_000_000
#: studies beyond which only the first are shown
MOST_STUDIES = 500


class Folders:
    """Results and reports that are shown; what was read of a record is kept while it stands.

    Parameters
    ----------
    results, reports : Path
        Folders that ``study run`` writes.
    """

    def __init__(self, results: Path, reports: Path) -> None:
        self.results, self.reports = results, reports
        self._statuses: dict[Path, tuple[int, int, tuple[str, str]]] = {}

    def states(self) -> list[StudyState]:
        """Every study of the results, by name; one whose manifest cannot be read is left out."""
        manifests = sorted(self.results.glob("*/study.json"))[:MOST_STUDIES]
        found = (self._state(path.parent) for path in manifests)
        return [one for one in found if one is not None]

    def running(self) -> dict[str, dict[str, object]]:
        """Progress of the studies at work, by their names."""
        found = {path.parent.name: progress_of(path.parent)
                 for path in sorted(self.results.glob("*/study.json"))[:MOST_STUDIES]}  # fmt: skip
        return {name: one.to_json() for name, one in found.items() if one is not None}

    def _state(self, folder: Path) -> StudyState | None:
        manifest = _sealed(folder / "study.json")
        if not isinstance(manifest, dict) or not isinstance(manifest.get("cases"), dict):
            return None
        question, factors, units = _asked(str(manifest.get("design", "")))
        statuses = [
            self._status(folder / "cases" / str(name) / "record.json", str(wanted))
            for name, wanted in manifest["cases"].items()
        ]
        stem = slug(folder.name)
        page = self.reports / folder.name / f"{stem}.html"
        address = f"/reports/{quote(folder.name)}/{quote(stem)}.html" if page.is_file() else ""
        table = self.reports / folder.name / f"{stem}-data" / "table-verdicts.csv"
        return StudyState(
            folder.name, question, factors, len(statuses), statuses.count("converged"),
            sum(status not in ("", "converged") for status in statuses), progress_of(folder),
            address, conclusions_of(table, units),
        )  # fmt: skip

    def _status(self, path: Path, wanted: str) -> str:
        """Status of a record of this very input; empty where there is none."""
        try:
            stat = path.stat()
        except OSError:
            return ""
        known = self._statuses.get(path)
        if known is None or known[:2] != (stat.st_mtime_ns, stat.st_size):
            content = _sealed(path)
            fields = content if isinstance(content, dict) else {}
            said = (str(fields.get("status", "")), str(fields.get("input_hash", "")))
            known = (stat.st_mtime_ns, stat.st_size, said)
            self._statuses[path] = known
        status, made_of = known[2]
        return status if made_of == wanted else ""


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
    said = lock.holder(folder)
    done, total = said.get("done"), said.get("total")
    if not isinstance(done, int) or not isinstance(total, int):
        return Progress(0, 0, "started")
    return Progress(done, total, str(said.get("counted", "at work")), seconds_left(said))


def conclusions_of(table: Path, units: Mapping[str, str]) -> tuple[Conclusion, ...]:
    """Rows of the verdict table of a report; none where it is not there.

    Parameters
    ----------
    table : Path
        The CSV beside the page.
    units : mapping of str to str
        Unit of every response.
    """
    try:
        if table.stat().st_size > MOST_BYTES:
            return ()
        rows = list(csv.DictReader(io.StringIO(table.read_text(encoding="utf-8"))))
    except (OSError, UnicodeDecodeError, csv.Error):
        return ()
    return tuple(
        Conclusion(
            row["response"], row["factor"], row.get("verdict") or "", _number(row, "effect"),
            _number(row, "low"), _number(row, "high"), _number(row, "practical"),
            _number(row, "p"), row.get("scale") == "ratio", units.get(row["response"], ""),
        )
        for row in rows
        if row.get("response") and row.get("factor")
    )  # fmt: skip


def _number(row: Mapping[str, str | None], name: str) -> float | None:
    try:
        value = float(row.get(name) or "")
    except ValueError:
        return None
    return value if math.isfinite(value) else None


def _sealed(path: Path) -> object:
    """Content of a sealed file; None where it is damaged, too long or not there."""
    try:
        if path.stat().st_size > MOST_BYTES:
            return None
        return unseal(path.read_bytes(), str(path))
    except (OSError, StoreError, json.JSONDecodeError):
        return None


def _asked(text: str) -> tuple[str, tuple[str, ...], dict[str, str]]:
    """Question and factors of a design, and the unit of every response."""
    try:
        design = loads(text, "study.json")
    except InputError:
        return "", (), {}
    units = {
        one.name: "pp" if unit == "%" else unit
        for one in design.responses
        for unit in (units_asked(design).get(one.name, ""),)
    }
    return design.question, tuple(factor.name for factor in design.factors), units
