"""The results folder of one study: crash-safe, one runner at a time, nothing damaged is used.

::

    results/<study>/
        study.json                  manifest
        fits/<fit_id>.json          calibrations shared by cases
        cases/<case_id>/record.json
        cases/<case_id>/*.corrupt-1 what was damaged, set aside
"""

from __future__ import annotations

import contextlib
import hashlib
import os
from collections import defaultdict
from collections.abc import Collection, Mapping
from functools import cached_property, partial
from pathlib import Path
from typing import cast

from study.ground.curve import Curve
from study.ground.errors import NewerSchemaError, StoreError
from study.harness.record.atomic_files import write_atomic
from study.harness.record.document import (
    WITH_CONSTANTS,
    CurveKey,
    ManifestDocument,
    SolutionDocument,
    StoredFitDocument,
    fault_of_curves,
    fault_of_fits,
)
from study.harness.record.folder import ID, OUTSIDE, ManifestFolder, inside
from study.harness.record.record import CONVERGED, Record
from study.harness.record.survey import (
    CURRENT,
    Entry,
    OtherLibraries,
    StoredRecords,
    Survey,
    differences,
    name_of,
)

# Results that are no records: fits that cases share, solutions of refinement series.

#: key of a stored result: name of the libraries that made it
_MADE_WITH = "made_with"


def _fault_of_fit(fit: StoredFitDocument) -> str:
    """Say why cases cannot use a fit that they share; empty if they can."""
    if fit["status"] in WITH_CONSTANTS and not fit.get("values"):
        return "it has no values"
    if set(fit.get("names", ())) != fit.get("values", {}).keys():
        return "its names are not those of its values"
    if "curve" in fit and "solver" not in fit:
        return "it has no solver"
    fault = fault_of_fits({"fit": fit}, needed=())
    return fault or (_fault_of_curve(fit["curve"]) if "curve" in fit else "")


def _fault_of_solution(solution: SolutionDocument) -> str:
    """Say why a series cannot use a solution; empty if it can."""
    if solution["status"] != CONVERGED:
        return _fault_of_curve(solution["curve"]) if solution.get("curve") else ""
    lost = [key for key in ("curve", "elements", "dofs") if key not in solution]
    return f"it has no {lost[0]}" if lost else _fault_of_curve(solution["curve"])


def _fault_of_curve(written: Mapping[str, object]) -> str:
    try:
        curve = Curve.from_dict(written)
    except (TypeError, ValueError, LookupError, ArithmeticError) as error:
        return f"its curve cannot be read ({error})"
    return fault_of_curves({CurveKey("predicted", "force"): curve})


def laid_by(input_hash: str) -> str:
    """Name of the file of a record that another one took the place of."""
    return f"record-{hashlib.sha256(input_hash.encode()).hexdigest()[:16]}.json"


class Store(ManifestFolder):
    """Records, shared fits and manifests of one study, each with the libraries that made it."""

    #: name of the libraries that make what is written now, and whether nothing else counts
    _libraries = ""
    _strict = False

    def made_with(self, versions: Mapping[str, str], *, strict: bool = False) -> None:
        """Say which libraries compute from now on."""
        self._libraries, self._strict = name_of(versions), strict

    def write_fit(
        self, fit_id: str, content: Mapping[str, object], *, followed: bool = False
    ) -> None:
        """Store a calibration that several cases share; ``followed`` as for a record."""
        self._write_result(f"fits/{fit_id}", content, followed)

    def read_fit(self, fit_id: str) -> dict[str, object] | None:
        """Read a shared calibration; None if it is missing, was damaged, or does not count."""
        fit = self.read_document(f"fits/{fit_id}", StoredFitDocument, _fault_of_fit)
        return self._counting(fit)

    def write_solution(self, key: str, content: Mapping[str, object]) -> None:
        """Store a solution of a refinement series."""
        self._write_result(f"solves/{key}", content, False)

    def read_solution(self, key: str) -> dict[str, object] | None:
        """Read a solution; None as for a calibration."""
        solution = self.read_document(f"solves/{key}", SolutionDocument, _fault_of_solution)
        return self._counting(solution)

    def _write_result(self, name: str, content: Mapping[str, object], followed: bool) -> None:
        self.write_json(name, {**content, _MADE_WITH: self._libraries}, followed=followed)

    def _counting(
        self, document: StoredFitDocument | SolutionDocument | None
    ) -> dict[str, object] | None:
        """Leave out the name of the libraries; None where other ones are to be as missing."""
        if document is None:
            return None
        result = cast("dict[str, object]", document)
        made_with = result.pop(_MADE_WITH, "")
        return None if self._strict and made_with != self._libraries else result

    def write(self, record: Record, *, followed: bool = False) -> None:
        """Store a record, whole or not at all."""
        path = self._case(record.case_id) / CURRENT
        self._lay_by(record)
        self._write(path, record.to_json().encode(), followed, partial(self._note, record))

    def _note(self, record: Record) -> None:
        """Note what a record says that is in place, for as long as nobody else writes."""
        if self._locked:
            self._entries[record.case_id] = Entry.of(record)

    def write_folder(self, case_id: str, packed: bytes) -> None:
        """Keep the folder in which a program computed a case, as a zip beside the records."""
        write_atomic(self.path / "folders" / f"{case_id}.zip", packed, self._system)

    def read(self, case_id: str, input_hash: str | None = None) -> Record | None:
        """Record of a case; None if there is none or it is damaged (set aside, and warned)."""
        folder = self._case(case_id)
        record = self._read_file(case_id, folder / CURRENT)
        if record is not None:
            self._note(record)
        if input_hash is None or (record is not None and record.input_hash == input_hash):
            return record
        laid = self._read_file(case_id, folder / laid_by(input_hash))
        return laid if laid is not None and laid.input_hash == input_hash else record

    def _read_file(self, case_id: str, path: Path) -> Record | None:
        data = self._bytes(path)
        if data is None:
            return None
        try:
            record = Record.from_json(data, str(path))
            if record.case_id != case_id:
                raise StoreError(f"{path}: belongs to case {record.case_id!r}")
        except NewerSchemaError:
            raise
        except StoreError as error:
            self._set_aside(path, str(error))
            self._entries.pop(case_id, None)
            return None
        return record

    def survey(self, input_hashes: Mapping[str, str]) -> Survey:
        """Sort the wanted cases into done, failed and missing."""
        done: list[str] = []
        statuses: dict[str, str] = {}
        made_with: dict[str, str] = {}
        missing: list[str] = []
        foreign: list[str] = []
        there = frozenset(self._case_ids())
        for case_id, input_hash in input_hashes.items():
            entry = self._said(case_id, input_hash) if case_id in there else None
            if entry is None or not self._counts(entry, input_hash):
                missing.append(case_id)
                if entry is not None:
                    foreign.append(case_id)
                continue
            made_with[case_id] = entry.libraries
            if entry.status == CONVERGED:
                done.append(case_id)
            else:
                statuses[case_id] = entry.status
        if foreign:
            self._say(
                f"{self.path}: {len(foreign)} records come from another version of the program, "
                "its settings or the data; they are not used and will be computed again"
            )
        return Survey(
            tuple(done), tuple(statuses), tuple(missing), tuple(foreign), statuses, made_with
        )

    def done_ids(
        self, input_hashes: Mapping[str, str], retry: Collection[str] = ()
    ) -> frozenset[str]:
        """Cases that need no run: a valid record of this input, whatever its status."""
        survey = self.survey(input_hashes)
        again = {case_id for case_id, status in survey.statuses.items() if status in retry}
        return frozenset(survey.done + survey.failed) - again

    def records(self, input_hashes: Mapping[str, str]) -> list[Record]:
        """Read the records of this very input, in the order of ``input_hashes``."""
        saved = (self.read(case_id, input_hash) for case_id, input_hash in input_hashes.items())
        return [
            r for r in saved if r is not None and self._counts(Entry.of(r), input_hashes[r.case_id])
        ]

    def meshes(self, input_hashes: Mapping[str, str]) -> dict[str, str]:
        """Hash of the mesh of each case that has one."""
        entries = {case: self._said(case, input_hash) for case, input_hash in input_hashes.items()}
        return {case: e.mesh for case, e in entries.items() if e is not None and e.mesh}

    def by_case(self, input_hashes: Mapping[str, str]) -> dict[str, Record]:
        """Read the records of this very input, by the name of their case."""
        return {record.case_id: record for record in self.records(input_hashes)}

    def on_demand(self, input_hashes: Mapping[str, str]) -> Mapping[str, Record]:
        """Give the records of this very input by their case, each read when it is asked for."""
        return StoredRecords(
            input_hashes,
            lambda case_id: next(iter(self.records({case_id: input_hashes[case_id]})), None),
        )

    def other_libraries(
        self, input_hashes: Mapping[str, str], versions: Mapping[str, str]
    ) -> list[OtherLibraries]:
        """Results that other libraries made than those of today, by what differs."""
        cases: dict[str, list[str]] = defaultdict(list)
        for case_id, made_with in self.survey(input_hashes).made_with.items():
            if made_with not in ("", name_of(versions)):
                cases[made_with].append(case_id)
        others = []
        for ids in cases.values():
            record = self.read(ids[0], input_hashes[ids[0]])
            if record is not None:
                others.append(OtherLibraries(tuple(ids), differences(record.versions, versions)))
        return others

    @cached_property
    def _entries(self) -> dict[str, Entry]:
        return {}

    def _begin(self) -> None:
        for cached in ("_entries", "_finished"):  # another runner may have written since
            self.__dict__.pop(cached, None)
        names = [os.path.join(self.path, "cases", name) for name in self._case_ids()]
        folders = [os.path.join(self.path, name) for name in ("", "fits", "runs")]
        self._clear_leftovers([*folders, *names])

    def _end(self) -> None:
        self._batch.finish()

    def _said(self, case_id: str, input_hash: str) -> Entry | None:
        """Say what a record says: the one that is wanted, unread where that is noted."""
        entry = self._entries.get(case_id) if self._locked else None
        if entry is not None and entry.input_hash == input_hash:
            return entry
        record = self.read(case_id, input_hash)
        return None if record is None else Entry.of(record)

    def _counts(self, entry: Entry, input_hash: str) -> bool:
        """Whether a result is one of the input that is wanted."""
        made_now = not self._strict or entry.libraries == self._libraries
        return entry.input_hash == input_hash and made_now

    def _lay_by(self, record: Record) -> None:
        """Keep the record of a finished study that one of an edited design takes the place of."""
        last = self._finished.get(record.case_id)
        if last is None or last == record.input_hash:
            return
        path = self._case(record.case_id) / CURRENT
        before = self._read_file(record.case_id, path)
        if before is not None and before.input_hash == last:
            write_atomic(path.with_name(laid_by(last)), before.to_json().encode(), self._system)

    @cached_property
    def _finished(self) -> Mapping[str, str]:
        """Cases of the finished study that is to stay readable."""
        manifest = self.read_manifest() if self._locked else None
        if manifest is None or not manifest.get("finished", True):
            return {}
        return manifest["cases"]

    def begin_run(self, meta: ManifestDocument) -> None:
        """Note what is going to be computed; a finished study of another design stays as it is."""
        super().begin_run(meta)
        self.__dict__.pop("_finished", None)

    def finish_run(self, meta: ManifestDocument) -> None:
        """Make a run the one that is read from; what was laid by for the one before it may go."""
        before = dict(self._finished)
        super().finish_run(meta)
        self.__dict__.pop("_finished", None)
        for case_id, finished_hash in before.items():
            if meta["cases"].get(case_id) != finished_hash:
                with contextlib.suppress(OSError):  # only space is lost
                    self._system.unlink(self._case(case_id) / laid_by(finished_hash))

    def _case(self, case_id: str) -> Path:
        if not ID.fullmatch(case_id):
            raise StoreError(f"{case_id!r} is no case id (small letters, digits and hyphens)")
        return inside(self.path, ("cases", case_id), OUTSIDE)

    def _case_ids(self) -> list[str]:
        folder = self.path / "cases"
        try:
            return sorted(entry.name for entry in folder.iterdir() if ID.fullmatch(entry.name))
        except FileNotFoundError:
            return []
        except OSError as error:
            raise StoreError(f"{folder}: cannot be read ({error.strerror or error})") from error
