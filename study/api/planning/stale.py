"""Results of other libraries, other code or another mesh: used, refused or computed again."""

from __future__ import annotations

from collections import defaultdict
from typing import TYPE_CHECKING

from study.canonical import digest
from study.design.sections.content import plain
from study.errors import Fault, InputError, RefusedError, nearest
from study.record.store import Store
from study.runner.provenance import versions

if TYPE_CHECKING:
    from study.runner.job import CaseJob, Work

REFUSE = "refuse"
WARN = "warn"
RERUN = "rerun"
CHOICES = (REFUSE, WARN, RERUN)

_MEND = (
    "    --stale warn goes on with what still counts, --stale rerun computes again what does not"
)


def check_choice(stale: str) -> None:
    """Refuse a word that is none of :data:`CHOICES`.

    Parameters
    ----------
    stale : str
        What the user wants of stale results.

    Raises
    ------
    InputError
        If it is none of them.
    """
    if stale not in CHOICES:
        raise InputError(Fault("stale", f"there is no choice {stale!r}", nearest(stale, CHOICES)))


def check_stale(work: Work, store: Store, stale: str) -> list[str]:
    """Decide what becomes of results that would come out of other code or libraries today.

    Those of another design, other data or other code of this package have another key and never
    count; those of other libraries count unless they are to be computed again.

    Parameters
    ----------
    work : Work
        The study as it is now.
    store : Store
        Its results; it is told here whether those of other libraries count.
    stale : str
        ``"refuse"`` stops for either, ``"warn"`` says which libraries differ and uses the
        results, ``"rerun"`` computes them again.

    Returns
    -------
    list of str
        Warnings.

    Raises
    ------
    RefusedError
        If results are stale and that is to be refused; nothing is written then.
    """
    now = versions()
    others = [one.sentence for one in store.other_libraries(work.input_hashes, now)]
    store.made_with(now, strict=stale == RERUN)
    if stale == REFUSE:
        foreign = len(store.survey(work.input_hashes).foreign)
        if foreign:
            others.append(f"{foreign} results have another input: study why CASE names it")
        if others:
            listed = "\n".join(f"    {one}" for one in others)
            raise RefusedError(
                f"{store.path}: its results are not those of today:\n{listed}\n{_MEND}"
            )
    if stale == RERUN:
        return []
    return [f"{one}; they are used, and study run --stale rerun makes them again" for one in others]


def mixed_meshes(work: Work, store: Store) -> list[str]:
    """Warn of cells whose cases were computed on meshes that should be one and are not.

    The same problem gives the same mesh; another one is the work of another gmsh or machine.

    Parameters
    ----------
    work : Work
        The study as it is now.
    store : Store
        Its results.

    Returns
    -------
    list of str
        One warning, which names the first such cell; empty where there is none.
    """
    meshes = store.meshes(work.input_hashes)
    found: dict[str, set[str]] = defaultdict(set)
    labels: dict[str, str] = {}
    for job in work.jobs:
        mesh = meshes.get(job.case.case_id)
        if mesh is not None:
            name = _same_mesh(job)
            found[name].add(mesh)
            labels.setdefault(name, job.case.label)
    mixed = [labels[name] for name, several in found.items() if len(several) > 1]
    if not mixed:
        return []
    more = f" and {len(mixed) - 1} more" if len(mixed) > 1 else ""
    return [
        f"{mixed[0]}{more}: the cases of this cell were computed on different meshes, by another "
        "gmsh or on another machine; study run --stale rerun makes them again on one"
    ]


def _same_mesh(job: CaseJob) -> str:
    """Name of all cases that have one mesh."""
    fits = [() if pair.fit is None else pair.fit.measured for pair in job.directions]
    fitted = [[float(curve.displacement_mm.max()) for curve in curves] for curves in fits]
    scored = [pair.depth_mm for pair in job.directions]
    return digest([plain(job.case.config), job.forward, scored, fitted], 32)
