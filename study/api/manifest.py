"""What a run of a study is, before anything of it is computed."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from study.ground.bounded_file import read_json
from study.ground.canonical import digest
from study.ground.errors import Fault, InputError, RefusedError, nearest
from study.harness.design.load import dump, loads
from study.harness.record.document import ManifestDocument
from study.harness.record.store import Store
from study.harness.runner.job import TRUTH_SUFFIX, Work
from study.harness.runner.provenance import versions
from study.reporting.results.study_answers import Change

if TYPE_CHECKING:
    from study.reporting.results.study_result import StudyResult


# What two studies do not share: keys of their designs, measurements, truths, code.

#: keys that change no number
_WORDS = ("study.name", "study.question", "report.format")

#: digits of a hash that tell two files apart
_DIGITS = 12
_NOT_RECORDED = "not recorded"


def changes(first: StudyResult, second: StudyResult) -> tuple[Change, ...]:
    """Every input that differs, the design's keys first."""
    studies = (first, second)
    return (
        *_differing("design", *(_named_keys(study.design.config) for study in studies)),
        *_differing("extent", *(
            {"cases": str(study.total), "blocks": f"{len(blocks)} ({', '.join(map(str, blocks))})"}
            for study in studies for blocks in [study.manifest["blocks"]]
        )),
        *_differing("measurements", *(
            _sums(study.manifest.get("files", {}))
            | {"kind": "virtual specimens" if study.manifest["virtual"] else "measured"}
            for study in studies
        )),
        *_truths(first, second),
        *_differing("code", *(_code(study.manifest.get("versions", {})) for study in studies)),
    )  # fmt: skip


def run_changes(first: ManifestDocument, second: ManifestDocument) -> tuple[Change, ...]:
    """Every input that differs between two runs of a study, by their manifests."""
    runs = (first, second)
    designs = [loads(run["design"], run["source"]).config for run in runs]
    return (
        *_differing("design", *(_named_keys(design) for design in designs)),
        *_differing("measurements", *(_sums(run.get("files", {})) for run in runs)),
        *_differing("truth", *(dict(_leaves(run.get("truths", {}), "truth")) for run in runs)),
        *_differing("code", *(_code(run.get("versions", {})) for run in runs)),
    )


def _differing(kind: str, first: Mapping[str, str], second: Mapping[str, str]) -> Iterator[Change]:
    for key in dict.fromkeys([*first, *second]):
        values = first.get(key), second.get(key)
        if values[0] != values[1]:
            yield Change(kind, key, values)


def _named_keys(config: Mapping[str, object]) -> dict[str, str]:
    return {k: v for k, v in _leaves(config, "") if k not in _WORDS}


def _leaves(value: Any, key: str) -> Iterator[tuple[str, str]]:
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from _leaves(item, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list) and value and all(isinstance(v, Mapping) for v in value):
        for number, item in enumerate(value, 1):
            name = item.get("name")
            rest = {k: v for k, v in item.items() if k != "name"} if name else item
            yield from _leaves(rest or "present", f"{key}.{name or number}")
    else:
        yield key, _text(value)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ", ".join(_text(item) for item in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} = {_text(v)}" for k, v in value.items())
    return str(value).lower() if isinstance(value, bool) else str(value)


def _sums(files: Mapping[str, str]) -> dict[str, str]:
    return {f"sha256 of {name}": str(sha)[:_DIGITS] for name, sha in files.items()}


def _code(versions: Mapping[str, str]) -> dict[str, str]:
    return {f"version of {name}": str(value) for name, value in versions.items()}


def _truths(first: StudyResult, second: StudyResult) -> Iterator[Change]:
    """Compare how virtual specimens were made; a single file may have any name."""
    if not (first.manifest["virtual"] or second.manifest["virtual"]):
        return
    truths = [_truth(study) for study in (first, second)]
    if all(truths):
        yield from _differing("truth", truths[0], truths[1])
        return
    states = [
        "of virtual specimens" if keys
        else _NOT_RECORDED if study.manifest["virtual"] else "measured, not generated"
        for study, keys in zip((first, second), truths, strict=True)
    ]  # fmt: skip
    if states[0] != states[1] or _NOT_RECORDED in states:
        yield Change("truth", "truth of the specimens", (states[0], states[1]))


def _truth(study: StudyResult) -> dict[str, str]:
    """Keys of the truth of a study's specimens; empty where it is measured or unknown."""
    recorded = study.manifest.get("truths")
    if recorded is None:
        recorded = read_truths(study.folder / "measurements", study.manifest.get("files", {}))
    sources = dict(recorded)
    first = next(iter(sources.values()), None)
    if first is not None and all(truth == first for truth in sources.values()):
        return dict(_leaves(first, "truth"))
    return {k: v for name, truth in sources.items() for k, v in _leaves(truth, f"truth of {name}")}


def read_truths(root: Path, files: Mapping[str, str]) -> dict[str, Any]:
    """How the virtual specimens of measurement files were made, by name of the file."""
    notes = {name: root / f"{name}{TRUTH_SUFFIX}" for name in files}
    return {
        name: cast("dict[str, Any]", read_json(path))
        for name, path in notes.items()
        if path.is_file()
    }


def manifest_of(work: Work) -> ManifestDocument:
    """Say what a study is, before anything of it is computed."""
    return {
        "name": work.design.name,
        "design": dump(work.design),
        "text": work.design.text,
        "source": Path(work.design.source).name,
        "cases": work.input_hashes,
        "blocks": list(work.blocks),
        "notes": list(work.data.notes()),
        "files": work.data.files(),
        "virtual": work.virtual,
        "truths": read_truths(work.data.root, work.data.files()),
        "versions": versions(),
        "timings": {},
    }


# Results of other libraries, other code or another mesh: used, refused or computed again.

REFUSE = "refuse"
WARN = "warn"
RERUN = "rerun"
CHOICES = (REFUSE, WARN, RERUN)

_MEND = (
    "    --stale warn goes on with what still counts, --stale rerun computes again what does not"
)


def check_choice(stale: str) -> None:
    """Refuse a word that is none of :data:`CHOICES`."""
    if stale not in CHOICES:
        raise InputError(Fault("stale", f"there is no choice {stale!r}", nearest(stale, CHOICES)))


def check_stale(work: Work, store: Store, stale: str) -> list[str]:
    """Decide what becomes of results that would come out of other code or libraries today.

    Those of another design, other data or other code of this package have another key and never
    count; those of other libraries count unless they are to be computed again.
    """
    now = versions()
    others = [change.sentence for change in store.other_libraries(work.input_hashes, now)]
    store.made_with(now, strict=stale == RERUN)
    if stale == REFUSE:
        foreign = len(store.survey(work.input_hashes).foreign)
        if foreign:
            others.append(f"{foreign} results have another input: study why CASE names it")
        if others:
            listed = "\n".join(f"    {change}" for change in others)
            raise RefusedError(
                f"{store.path}: its results are not those of today:\n{listed}\n{_MEND}"
            )
    if stale == RERUN:
        return []
    return [
        f"{change}; they are used, and study run --stale rerun makes them again"
        for change in others
    ]


def mixed_meshes(work: Work, store: Store) -> list[str]:
    """Warn of cells whose meshes should be one and are not: the work of another gmsh or machine."""
    meshes = store.meshes(work.input_hashes)
    meshes_of: dict[str, set[str]] = defaultdict(set)
    labels: dict[str, str] = {}
    for job in work.jobs:
        mesh = meshes.get(job.case.case_id)
        if mesh is not None:
            fits = [() if pair.fit is None else pair.fit.measured for pair in job.directions]
            fitted = [[float(curve.displacement_mm.max()) for curve in curves] for curves in fits]
            scored = [pair.depth_mm for pair in job.directions]
            name = digest([job.case.cell.content_key, job.forward, scored, fitted], 32)
            meshes_of[name].add(mesh)
            labels.setdefault(name, job.case.label)
    mixed = [labels[name] for name, several in meshes_of.items() if len(several) > 1]
    if not mixed:
        return []
    more = f" and {len(mixed) - 1} more" if len(mixed) > 1 else ""
    return [
        f"{mixed[0]}{more}: the cases of this cell were computed on different meshes, by another "
        "gmsh or on another machine; study run --stale rerun makes them again on one"
    ]
