"""What each run of a study was: a manifest of its own, and the last finished one to read from.

::

    study.json            the last finished run; the first one while none is finished
    unfinished.json       a run of another design that began later and is not finished
    unfinished-NAME.json  rows that this run found, beside those of the finished one
    runs/run-N.json       every run that finished and differs from the one before it
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Mapping, Sequence
from typing import TypeVar

from study.record.document import ManifestDocument
from study.record.folder import SealedFolder

Row = TypeVar("Row")

_STUDY = "study"
_UNFINISHED = "unfinished"

#: what a run may find besides its records
ROWS = frozenset({"numerical", "spaces", "validation"})

#: parts of a manifest that say how a run went, not what it was
_OUTCOME = ("timings", "finished")


class ManifestFolder(SealedFolder):
    """Results folder whose finished study stays readable while an edited one is computed."""

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
        found = (self._manifest(f"runs/run-{number}") for number in reversed(self._numbers()))
        return [one for one in found if one is not None]

    def begin_run(self, meta: ManifestDocument) -> None:
        """Note what is going to be computed; a finished study of another design stays as it is."""
        known = self.read_manifest()
        if known is None or not known.get("finished", True):
            self.write_manifest({**meta, "finished": False})
        elif not is_same(known, meta):
            self.write_json(_UNFINISHED, {**meta, "finished": False})

    def finish_run(self, meta: ManifestDocument) -> None:
        """Make a run the one that is read from, with what it found besides its records.

        A crash anywhere leaves one of the two readable, and running again finishes.
        """
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
        for name in (_UNFINISHED, *(f"{_UNFINISHED}-{one}" for one in sorted(ROWS))):
            with contextlib.suppress(OSError):  # it says the same as the finished one
                self._system.unlink(self._json(name))

    def write_rows(self, name: str, rows: Sequence[Mapping[str, object]]) -> None:
        """Store a table of :data:`ROWS` that belongs to the run which is being computed."""
        later = self.read_unfinished() is not None
        self.write_json(f"{_UNFINISHED}-{name}" if later else name, list(rows))

    def read_rows(
        self, name: str, kind: type[Row], fault: Callable[[list[Row]], str] = lambda rows: ""
    ) -> list[Row]:
        """Rows of a table of the finished run; empty without one, or where it is damaged.

        Parameters
        ----------
        kind : type
            Class of a row, in :mod:`study.record.document`.
        fault : callable, optional
            Says what is wrong with rows of the right keys and types; empty if nothing is.
        """
        return self.read_document(name, list[kind], fault) or []  # type: ignore[valid-type]

    def _manifest(self, name: str) -> ManifestDocument | None:
        return self.read_document(name, ManifestDocument)

    def _numbers(self) -> list[int]:
        names = (path.stem.partition("run-")[2] for path in (self.path / "runs").glob("run-*.json"))
        return sorted(int(name) for name in names if name.isascii() and name.isdigit())


def is_same(first: ManifestDocument | None, second: ManifestDocument) -> bool:
    """Whether two runs compute and ask the same.

    Parameters
    ----------
    first, second : ManifestDocument
        Their ``cases`` and ``design`` are compared; no ``first`` (None) is never the same.
    """
    if first is None:
        return False
    return all(first.get(key) == second.get(key) for key in ("cases", "design"))


def _essence(meta: ManifestDocument) -> dict[str, object]:
    return {key: value for key, value in meta.items() if key not in _OUTCOME}
