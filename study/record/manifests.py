"""What each run of a study was: a manifest of its own, and the last finished one to read from.

::

    study.json            the last finished run; the first one while none is finished
    unfinished.json       a run of another design that began later and is not finished
    unfinished-NAME.json  rows that this run found, beside those of the finished one
    runs/run-N.json       every run that finished and differs from the one before it
"""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from typing import Any, cast

from study.record.document import ManifestDocument
from study.record.folder import SealedFolder

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

    def read_rows(self, name: str) -> list[dict[str, Any]]:
        """Rows of a table of the finished run, to be read by who wrote them; empty without one."""
        found = self.read_json(name)
        return found if isinstance(found, list) else []

    def _manifest(self, name: str) -> ManifestDocument | None:
        found = self.read_json(name)
        if found is None:
            return None
        if not _is_manifest(found):
            self._say(f"{self.path / name}.json: is no manifest of a study; it is not used")
            return None
        return cast(ManifestDocument, found)

    def _numbers(self) -> list[int]:
        names = (path.stem.partition("run-")[2] for path in (self.path / "runs").glob("run-*.json"))
        return sorted(int(name) for name in names if name.isdigit())


#: mappings and lists of a manifest with the types of what they hold
_MAPPINGS: Mapping[str, type | tuple[type, ...]] = {
    "cases": str,
    "files": str,
    "versions": (str, type(None)),
    "timings": (int, float),
}
_LISTS: Mapping[str, type] = {"blocks": str, "notes": str}


def _is_manifest(found: object) -> bool:
    """Whether a sealed content has the shape of a manifest; parts that are missing may be."""
    if not isinstance(found, dict):
        return False
    texts = ("name", "design", "text", "source")
    return (
        all(isinstance(found.get(key, ""), str) for key in texts)
        and isinstance(found.get("truths", {}), dict)
        and all(_holds(found.get(key, {}), dict, kind) for key, kind in _MAPPINGS.items())
        and all(_holds(found.get(key, []), list, kind) for key, kind in _LISTS.items())
    )


def _holds(part: object, outer: type, kind: type | tuple[type, ...]) -> bool:
    if not isinstance(part, outer):
        return False
    values = part.values() if isinstance(part, dict) else cast("list[object]", part)
    return all(isinstance(value, kind) for value in values)


def is_same(first: ManifestDocument | None, second: ManifestDocument) -> bool:
    """Whether two runs compute and ask the same."""
    if first is None:
        return False
    return all(first.get(key) == second.get(key) for key in ("cases", "design"))


def _essence(meta: ManifestDocument) -> dict[str, object]:
    return {key: value for key, value in meta.items() if key not in _OUTCOME}
