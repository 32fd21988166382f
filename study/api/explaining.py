"""Why a case is as it is: its record, and what has changed since it was made."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from study.api.folders import RESULTS, design_root, results_folder
from study.api.manifest import manifest_of, run_changes
from study.ground.errors import Fault, InputError, MissingDataError, nearest
from study.harness.design.load import load
from study.harness.record.document import ManifestDocument
from study.harness.record.index import differences
from study.harness.record.record import Record
from study.harness.record.store import Store
from study.harness.runner.expansion import expand
from study.harness.runner.provenance import versions
from study.reporting.results.study_answers import Change


@dataclass(frozen=True)
class CaseState:
    """A case, whether its result counts, and what changed since it was made."""

    record: Record
    #: A sentence: whether the study as it is now uses the result, and why not.
    use: str
    #: What differs between the run that made it and the study as it is now: keys of the design,
    #: measured files, code.
    changes: tuple[Change, ...] = ()
    #: Libraries that had another version then than they have here now.
    libraries: tuple[Change, ...] = ()

    def to_json(self) -> dict[str, object]:
        """Plain data beside the record: what changed, each with both values."""
        return {
            "use": self.use,
            "changes": [_plain(change) for change in self.changes],
            "libraries": [_plain(library) for library in self.libraries],
        }


def _plain(change: Change) -> dict[str, object]:
    return {"kind": change.kind, "key": change.key, "values": list(change.values)}


def why(case: str, *, study: str | Path | None = None, results: str | Path = RESULTS) -> Record:
    """Record of one case, found by the beginning of its id in one study or in all of them.

    Parameters
    ----------
    case : str
        Id of the case, or its beginning.
    study : str or Path, optional
        Results folder, design file or name of the study to look in; all by default.
    results : str or Path
        Folder of all results.

    Returns
    -------
    Record
        The only one whose id begins so.

    Raises
    ------
    InputError
        If no case, or more than one, has an id that begins so.
    """
    return explain(case, study=study, results=results).record


def explain(
    case: str,
    *,
    study: str | Path | None = None,
    results: str | Path = RESULTS,
    data: str | Path | None = None,
) -> CaseState:
    """Record of a case, and what changed since it was made.

    Parameters
    ----------
    case : str
        Id of the case, or its beginning.
    study : str or Path, optional
        Study to look in; all by default. A design file is compared as it stands now, edited or
        not, whatever was run.
    results : Path
        Folder of the results.
    data : str or Path, optional
        Folder of the measurements, where a design file is given.

    Raises
    ------
    InputError
        If no case, or more than one, has an id that begins so.
    """
    folders = [results_folder(study, results)] if study is not None else _all_studies(results)
    store, name = _found(case, folders, results)
    runs = _runs(store)
    now = _design_now(study, data) or (runs[0] if runs else None)
    record = store.read(name, None if now is None else now["cases"].get(name))
    if record is None:
        raise InputError(Fault("case", f"the record of {name} is damaged; run the study again"))
    libraries = differences(record.versions, versions())
    others = tuple(Change("library", key, pair) for key, pair in libraries.items())
    if now is None or record.extra.get("purpose") is not None:
        return CaseState(record, "it serves the numerical uncertainty of the study", (), others)
    if now["cases"].get(name) == record.input_hash:
        use = "the study uses it" + (", though other libraries made it" if others else "")
        return CaseState(record, use, (), others)
    made = next((run for run in runs if run["cases"].get(name) == record.input_hash), None)
    if made is None:
        use = "the study does not use it; the run that made it left no manifest"
        return CaseState(record, use, _code_alone(record), others)
    changes = run_changes(made, now)
    what = "has this case no more" if name not in now["cases"] else "makes it of other inputs now"
    return CaseState(record, f"the study {what}", changes, others)


def _code_alone(record: Record) -> tuple[Change, ...]:
    """Compare the version of the code with today's, where nothing else is known."""
    then, now = record.versions.get("study"), versions()["study"]
    return () if then == now else (Change("code", "version of study", (then, now)),)


def _runs(store: Store) -> list[ManifestDocument]:
    """Every run that is known, the latest first."""
    manifests = [store.read_unfinished(), store.read_manifest(), *store.read_runs()]
    return [run for run in manifests if run is not None and "cases" in run]


def _design_now(study: str | Path | None, data: str | Path | None) -> ManifestDocument | None:
    """Say what a run of a design file would be now; None where no file is given."""
    path = None if study is None else Path(study)
    if path is None or path.suffix != ".toml" or not path.is_file():
        return None
    try:
        design = load(path)
        return manifest_of(expand(design, design_root(design, data)))
    except MissingDataError:
        return None  # it is compared with what was run


def _found(case: str, folders: Sequence[Path], results: str | Path) -> tuple[Store, str]:
    """Store and id of the only case whose id begins so."""
    matches: list[tuple[Store, str]] = []
    names: list[str] = []
    for folder in folders:
        store = Store(folder)
        ids = [path.name for path in sorted((folder / "cases").glob("*")) if os.path.isdir(path)]
        names += ids
        matches += [(store, name) for name in ids if name.startswith(case)]
    if not matches or not case:
        mend = nearest(case, names[:20]) if names else f"there are no records below {results}"
        raise InputError(Fault("case", f"no case has an id that begins with {case!r}", mend))
    if len(matches) > 1:
        listed = ", ".join(name for _, name in matches[:6])
        raise InputError(Fault("case", f"{case!r} begins several ids: {listed}"))
    return matches[0]


def _all_studies(results: str | Path) -> list[Path]:
    return sorted(path.parent for path in Path(results).glob("*/study.json"))
