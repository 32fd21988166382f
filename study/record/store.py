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
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Self, TypeVar, cast

from study.ground.canonical import json_text, plain
from study.ground.curve import Curve
from study.ground.errors import NewerSchemaError, StoreError
from study.ground.files import (
    ID,
    MAX_JSON_BYTES,
    OUTSIDE,
    Batch,
    FileSystem,
    NotRegularError,
    exclusive,
    holder,
    inside,
    is_leftover,
    read_regular,
    sign,
    write_atomic,
    write_error,
)
from study.record.record import (
    CONVERGED,
    WITH_CONSTANTS,
    CurveKey,
    ManifestDocument,
    Record,
    SolutionDocument,
    StoredFitDocument,
    fault_of,
    fault_of_curves,
    fault_of_fits,
    seal,
    unseal,
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


# Versions of the libraries that made a result: no part of its key, compared when it is used
# again.

#: entries of a record's versions that are no library: the package's own code is part of every
#: key, and the interpreter computes no number by itself
_OTHERS = ("study", "python")
#: digits of a name
_DIGITS = 16


def libraries_of(versions: Mapping[str, str]) -> dict[str, str]:
    """Leave the versions of libraries alone."""
    return {name: version for name, version in versions.items() if name not in _OTHERS}


def name_of(versions: Mapping[str, str]) -> str:
    """Short name of a set of libraries; empty where none is known."""
    libraries = libraries_of(versions)
    return hashlib.sha256(json_text(libraries).encode()).hexdigest()[:_DIGITS] if libraries else ""


def differences(then: Mapping[str, str], now: Mapping[str, str]) -> dict[str, tuple[str, str]]:
    """List the libraries that differ, each with both versions."""
    old, new = libraries_of(then), libraries_of(now)
    names = dict.fromkeys([*old, *new])
    pairs = {name: (old.get(name, "none"), new.get(name, "none")) for name in names}
    return {name: pair for name, pair in pairs.items() if pair[0] != pair[1]}


#: name of the file of a case's record
CURRENT = "record.json"


class FileStamp(tuple[int, int, int]):
    """Size and times of a file as it lies on the disk; whoever alters it alters one of these."""

    @classmethod
    def of(cls, path: str | Path) -> FileStamp | None:
        """Stamp of a file; None if there is none."""
        try:
            status = os.stat(path)
        except (OSError, ValueError):
            return None
        return cls((status.st_size, status.st_mtime_ns, status.st_ctime_ns))


@dataclass(frozen=True)
class Entry:
    """What a record says of itself, so that it is read once to be counted."""

    status: str
    input_hash: str
    #: Name of the libraries that made it, by :func:`name_of`.
    libraries: str = ""
    #: Hash of its mesh; empty without one.
    mesh: str = ""

    @classmethod
    def of(cls, record: Record) -> Entry:
        """Entry of a record."""
        made_with, mesh = name_of(record.versions), record.mesh.get("hash", "")
        return cls(record.status, record.input_hash, made_with, mesh)


@dataclass(frozen=True)
class Survey:
    """What a results folder holds of the cases that a study wants."""

    #: What the valid records say, by their cases.
    entries: Mapping[str, Entry]
    #: Case ids without a usable record.
    missing: tuple[str, ...]
    #: Those of ``missing`` that have a record of another configuration, data or version.
    foreign: tuple[str, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Cases: all, and those that are done, failed and missing."""
        counted = {
            "done": len(self.done), "failed": len(self.statuses), "missing": len(self.missing),
        }  # fmt: skip
        return {"total": sum(counted.values()), **counted}

    @property
    def done(self) -> tuple[str, ...]:
        """Case ids whose record is valid and converged."""
        return tuple(case for case, entry in self.entries.items() if entry.status == CONVERGED)

    @property
    def statuses(self) -> dict[str, str]:
        """Status of every case whose record is valid and says why there is no answer."""
        entries = self.entries.items()
        return {case: entry.status for case, entry in entries if entry.status != CONVERGED}


# What each run of a study was: a manifest of its own, and the last finished one to read from.
#     study.json            the last finished run; the first one while none is finished
#     unfinished.json       a run of another design that began later and is not finished
#     unfinished-NAME.json  rows that this run found, beside those of the finished one
#     runs/run-N.json       every run that finished and differs from the one before it

Kept = TypeVar("Kept")
Row = TypeVar("Row")

_STUDY = "study"
_UNFINISHED = "unfinished"
#: what a run may find besides its records
ROWS = frozenset({"numerical", "spaces", "validation"})
#: parts of a manifest that say how a run went, not what it was
_OUTCOME = ("timings", "finished")


class Store:
    """Results folder of one study, in which one process at a time may write.

    Its files are sealed, under names; records, shared fits and solutions say which libraries made
    them, and its last finished run stays readable while an edited one is computed.
    """

    #: name of the libraries that make what is written now, and whether nothing else counts
    _libraries = ""
    _strict = False

    def __init__(
        self,
        path: Path | str,
        warn: Callable[[str], None] | None = None,
        system: FileSystem | None = None,
    ) -> None:
        self.path = Path(path)
        self.warnings: list[str] = []
        self._warn = warn
        self._system = system or FileSystem()
        self._locked = False
        #: files that wait for the file written after them
        self._batch = Batch(self._system)
        self._forget()

    def _forget(self) -> None:
        """Forget what was read: another runner may have written since."""
        self._entries: dict[str, Entry] = {}
        self._finished_cases: Mapping[str, str] | None = None

    @contextlib.contextmanager
    def lock(self) -> Iterator[Self]:
        """Hold the folder for this process and clear what an interrupted run left behind."""
        if self._locked:  # the whole of a run holds it, and its parts as well
            yield self
            return
        try:
            self._system.make_folder(self.path)
        except OSError as error:
            raise write_error(self.path, error) from error
        with exclusive(self.path):
            self._locked = True
            try:
                self._forget()
                self._clear_leftovers()
                yield self
            except (Exception, KeyboardInterrupt):
                with contextlib.suppress(StoreError):  # what went wrong matters more
                    self._batch.finish()
                raise
            else:
                self._batch.finish()
            finally:
                self._locked = False

    def note(self, progress: Mapping[str, object]) -> None:
        """Say to other processes how far the runner is, while this one holds the folder."""
        if self._locked:
            sign(self.path, progress)

    def running(self) -> dict[str, object] | None:
        """Pid, host, start and progress of the runner in this folder; None if there is none."""
        return holder(self.path)

    def write_json(self, name: str, content: object, *, followed: bool = False) -> None:
        """Store any JSON content under a name such as ``"study"``, sealed and atomically."""
        lost: dict[str, str] = {}
        clean = plain(content, name, lost)
        if lost and isinstance(clean, dict):
            clean["not_finite"] = plain(lost)
        self._write(self._json(name), seal(clean).encode(), followed)

    def _write(
        self,
        path: Path,
        data: bytes,
        followed: bool = False,
        then: Callable[[], None] | None = None,
    ) -> None:
        """Write a file and those that wait for it; one ``followed`` by another waits."""
        self._batch.add(path, data, then)
        if not followed:
            self._batch.finish()

    def read_json(self, name: str) -> object:
        """Content stored under a name; None if there is none or it is damaged (set aside)."""
        path = self._json(name)
        data = self._bytes(path)
        if data is None:
            return None
        try:
            content = unseal(data, str(path))
            if content is None:
                raise StoreError(f"{path}: holds nothing")
        except NewerSchemaError:
            raise
        except StoreError as error:
            self._set_aside(path, str(error))
            return None
        return content

    def read_document(
        self, name: str, kind: type[Kept], fault: Callable[[Kept], str] = lambda content: ""
    ) -> Kept | None:
        """Content stored under a name, as its class says; None as for :meth:`read_json`."""
        content = self.read_json(name)
        if content is None:
            return None
        why = fault_of(content, kind) or fault(cast(Kept, content))
        if not why:
            return cast(Kept, content)
        path = self._json(name)
        self._set_aside(path, f"{path}: is not what a study writes there, {why}")
        return None

    def _json(self, name: str) -> Path:
        if not all(ID.fullmatch(part) for part in name.split("/")):
            raise StoreError(f"{name!r} is no name of a stored file (a-z, 0-9, hyphens)")
        return inside(self.path, f"{name}.json".split("/"), OUTSIDE)

    def _bytes(self, path: Path) -> bytes | None:
        try:
            return read_regular(path, MAX_JSON_BYTES)
        except NotRegularError as error:
            self._set_aside(path, str(error))
            return None

    def _set_aside(self, path: Path, why: str) -> None:
        """Rename a damaged file; a reader without the lock leaves it to the next runner."""
        # Without the lock, a runner could replace the file by a good one between our reading and
        # our renaming.
        if not self._locked:
            self._say(f"{why}; it is not used, and the next run replaces it")
            return
        number = 1
        while (target := path.with_name(f"{path.name}.corrupt-{number}")).exists():
            number += 1
        try:
            self._system.replace(path, target)
        except OSError as error:
            self._say(f"{why}; it is not used, but could not be renamed ({error})")
            return
        self._say(f"{why}; it was renamed to {target.name} and will be computed again")

    def _clear_leftovers(self) -> None:
        cases = [os.path.join("cases", name) for name in self._case_ids()]
        for folder in ("", "fits", "runs", *cases):
            with contextlib.suppress(OSError):  # ignored by every reader anyway
                for name in filter(is_leftover, os.listdir(self.path / folder)):
                    self._system.unlink(self.path / folder / name)

    def _say(self, message: str) -> None:
        if message in self.warnings:
            return
        self.warnings.append(message)
        if self._warn is not None:
            self._warn(message)

    # Its runs.

    def write_manifest(self, meta: ManifestDocument) -> None:
        """Store what the study is: name, question, seed, design text, versions."""
        self.write_json(_STUDY, dict(meta))

    def read_manifest(self) -> ManifestDocument | None:
        """Read the last finished run, or the first one; None if it is missing or was damaged."""
        return self._manifest(_STUDY)

    def read_unfinished(self) -> ManifestDocument | None:
        """Read the run that began after the last finished one; None if there is none."""
        later = self._manifest(_UNFINISHED)
        return None if later is None or is_same(self.read_manifest(), later) else later

    def read_runs(self) -> list[ManifestDocument]:
        """Every run that finished, the latest first."""
        manifests = (self._manifest(f"runs/run-{number}") for number in reversed(self._numbers()))
        return [manifest for manifest in manifests if manifest is not None]

    def begin_run(self, meta: ManifestDocument) -> None:
        """Note what is going to be computed; a finished study of another design stays as it is."""
        manifest = self.read_manifest()
        if manifest is None or not manifest.get("finished", True):
            self.write_manifest({**meta, "finished": False})
        elif not is_same(manifest, meta):
            self.write_json(_UNFINISHED, {**meta, "finished": False})
        self._finished_cases = None

    def finish_run(self, meta: ManifestDocument) -> None:
        """Publish a run to all readers, with its results besides the records."""
        before = dict(self._finished)
        # A crash anywhere leaves one of the two readable, and running again finishes.
        done: ManifestDocument = {**meta, "finished": True}
        runs = self.read_runs()
        if not runs or _essence(runs[0]) != _essence(done):
            number = self._numbers()[-1] + 1 if runs else 1
            self.write_json(f"runs/run-{number}", dict(done))
        for name in sorted(ROWS):
            rows = self.read_json(f"{_UNFINISHED}-{name}")
            if rows is not None:
                self.write_json(name, rows)
        self.write_manifest(done)
        for name in (_UNFINISHED, *(f"{_UNFINISHED}-{rows_name}" for rows_name in sorted(ROWS))):
            with contextlib.suppress(OSError):  # it says the same as the finished one
                self._system.unlink(self._json(name))
        self._finished_cases = None
        for case_id, finished_hash in before.items():  # what was laid by for the one before
            if meta["cases"].get(case_id) != finished_hash:
                with contextlib.suppress(OSError):  # only space is lost
                    self._system.unlink(self._case(case_id) / laid_by(finished_hash))

    def write_rows(self, name: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Store a table of :data:`ROWS` that belongs to the run which is being computed."""
        later = self.read_unfinished() is not None
        self.write_json(f"{_UNFINISHED}-{name}" if later else name, list(rows))

    def read_rows(
        self, name: str, kind: type[Row], fault: Callable[[list[Row]], str] = lambda rows: ""
    ) -> list[Row]:
        """Rows of a table of the finished run; empty without one, or where it is damaged."""
        return self.read_document(name, list[kind], fault) or []  # type: ignore[valid-type]

    def _manifest(self, name: str) -> ManifestDocument | None:
        return self.read_document(name, ManifestDocument)

    def _numbers(self) -> list[int]:
        names = (path.stem.partition("run-")[2] for path in (self.path / "runs").glob("run-*.json"))
        return sorted(int(name) for name in names if name.isascii() and name.isdigit())

    # Its records, fits and solutions.

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
        there = frozenset(self._case_ids()).intersection(input_hashes)
        stored = {c: e for c, h in input_hashes.items() if c in there and (e := self._said(c, h))}
        counted = {c: e for c, e in stored.items() if self._counts(e, input_hashes[c])}
        foreign = tuple(case_id for case_id in stored if case_id not in counted)
        if foreign:
            self._say(
                f"{self.path}: {len(foreign)} records come from another version of the program, "
                "its settings or the data; they are not used and will be computed again"
            )
        return Survey(counted, tuple(c for c in input_hashes if c not in counted), foreign)

    def done_ids(
        self, input_hashes: Mapping[str, str], retry: Collection[str] = ()
    ) -> frozenset[str]:
        """Cases that need no run: a valid record of this input, whatever its status."""
        entries = self.survey(input_hashes).entries
        return frozenset(case for case, entry in entries.items() if entry.status not in retry)

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

    def other_libraries(
        self, input_hashes: Mapping[str, str], versions: Mapping[str, str]
    ) -> list[str]:
        """Say which results other libraries made than those of today, by what differs."""
        cases: dict[str, list[str]] = defaultdict(list)
        for case_id, entry in self.survey(input_hashes).entries.items():
            if entry.libraries not in ("", name_of(versions)):
                cases[entry.libraries].append(case_id)
        sentences = []
        for ids in cases.values():
            record = self.read(ids[0], input_hashes[ids[0]])
            if record is None:
                continue
            changes = differences(record.versions, versions)
            what = ", ".join(f"{name} {old}, now {new}" for name, (old, new) in changes.items())
            count = "1 result was" if len(ids) == 1 else f"{len(ids)} results were"
            sentences.append(f"{count} made with other libraries: {what}")
        return sentences

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

    @property
    def _finished(self) -> Mapping[str, str]:
        """Cases of the finished study that is to stay readable."""
        if self._finished_cases is None:
            manifest = self.read_manifest() if self._locked else None
            is_done = manifest is not None and manifest.get("finished", True)
            self._finished_cases = manifest["cases"] if is_done and manifest is not None else {}
        return self._finished_cases

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


def _essence(meta: ManifestDocument) -> dict[str, object]:
    return {key: value for key, value in meta.items() if key not in _OUTCOME}


def is_same(first: ManifestDocument | None, second: ManifestDocument) -> bool:
    """Whether two runs compute and ask the same."""
    if first is None:
        return False
    return all(first.get(key) == second.get(key) for key in ("cases", "design"))
