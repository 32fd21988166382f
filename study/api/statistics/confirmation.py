"""Runs of the true model at settings that a surface has named; they join the study's surfaces."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from study.api.folders import design_root
from study.canonical import digest
from study.design.factors import levels_at
from study.design.spec import Design, Factor, Level
from study.errors import Fault, RefusedError
from study.record.document import ConfirmedRow
from study.record.folder import ID
from study.record.store import Store
from study.response_surface.factors import NumericFactor
from study.runner.batch import Progress, run_batch
from study.runner.expansion import expand
from study.runner.fitting.external_model import NOTHING, Allowed
from study.runner.provenance import code_version

if TYPE_CHECKING:
    from study.record.record import Record
    from study.study_result.study_result import StudyResult

#: name of the list of these runs in a results folder
CONFIRMED = "confirmed"


@dataclass(frozen=True)
class Joined:
    """Runs that were added to those of a design.

    Parameters
    ----------
    design : Design
        The design, whose ranges know the settings of these runs, too; its cells are its own.
    records : tuple of Record
        Of the runs.
    """

    design: Design
    records: tuple[Record, ...]


@dataclass(frozen=True)
class Permission:
    """What a run of the true model may use.

    Parameters
    ----------
    data : str or Path, optional
        Folder of the measurements.
    allowed : Allowed
        Programs and functions that it may run.
    progress : callable, optional
        Called after the run.
    """

    data: str | Path | None = None
    allowed: Allowed = NOTHING
    progress: Callable[[Progress], None] | None = None


def joined(design: Design, store: Store, manifest: Mapping[str, object]) -> Joined:
    """Find the runs that joined a study's surfaces: those of this design and this code.

    Parameters
    ----------
    design : Design
        As the manifest has it.
    store : Store
        Of its results.
    manifest : mapping
        Of the finished run.
    """
    rows = store.read_rows(CONFIRMED, ConfirmedRow)
    own = [row for row in rows if row["of"] == _identity(manifest)]
    found = store.records({row["case"]: row["input"] for row in own if ID.fullmatch(row["case"])})
    records = tuple(record for record in found if _is_of(record, design))
    return Joined(_knowing(design, [record.levels for record in records]), records)


def _is_of(record: Record, design: Design) -> bool:
    """Whether a record is of a setting of a design: numbers in its ranges, else its levels."""
    known = {factor.name: factor for factor in design.factors}
    return known.keys() == record.levels.keys() and all(
        label in known[name].labels or known[name].span is not None
        for name, label in record.levels.items()
    )


def _identity(manifest: Mapping[str, object]) -> str:
    return digest([manifest["design"], code_of(manifest)])


def code_of(manifest: Mapping[str, object]) -> str:
    """Version of this program that a run was made with.

    Parameters
    ----------
    manifest : mapping
        Of the run; the text is empty where it names no versions.
    """
    versions = manifest.get("versions")
    return str(versions.get("study")) if isinstance(versions, Mapping) else ""


def _knowing(design: Design, cells: Sequence[Mapping[str, str]]) -> Design:
    """Copy whose ranges have the levels of some cells."""
    factors = tuple(_with_levels(f, [one[f.name] for one in cells]) for f in design.factors)
    return replace(design, factors=factors) if cells else design


def _with_levels(factor: Factor, labels: Sequence[str]) -> Factor:
    known = {level.label for level in factor.levels}
    span = factor.span
    if span is None:
        return factor
    new = [one for one in dict.fromkeys(labels) if one not in known]
    more = [Level(one, {factor.name: one if span.unit else float(one)}) for one in new]
    return replace(factor, levels=(*factor.levels, *more))


def place(design: Design, settings: Mapping[str, float], labels: Mapping[str, str]) -> Design:
    """Make a design of one cell.

    Parameters
    ----------
    design : Design
        The whole one.
    settings : mapping of str to float
        Of the ranges, in their units.
    labels : mapping of str to str
        Levels of the other factors.
    """
    factors = tuple(_single(factor, settings, labels) for factor in design.factors)
    scheme = replace(design.scheme, rows=((0,) * len(factors),), sequential=None)
    return replace(design, factors=factors, exclusions=(), scheme=scheme)


def _single(factor: Factor, settings: Mapping[str, float], labels: Mapping[str, str]) -> Factor:
    span = factor.span
    if span is None:
        own = [level for level in factor.levels if level.label == labels[factor.name]]
        return replace(factor, levels=tuple(own))
    numeric = NumericFactor(factor.name, span.low, span.high, span.log)
    share = 0.5 * (float(numeric.coded(np.array(settings[factor.name]))) + 1.0)
    return replace(factor, levels=levels_at(factor.name, span, [min(max(share, 0.0), 1.0)]))


def confirm(
    study: StudyResult,
    settings: Mapping[str, float],
    labels: Mapping[str, str],
    permission: Permission,
) -> tuple[Record, ...]:
    """Run the true model at a setting, and let the run join the study's surfaces.

    Parameters
    ----------
    study : StudyResult
        A finished study.
    settings : mapping of str to float
        Of the ranges, in their units; they are rounded as those of a design.
    labels : mapping of str to str
        Levels of the other factors.
    permission : Permission
        What the run may use.

    Returns
    -------
    tuple of Record
        One for every block.

    Raises
    ------
    RefusedError
        If the study was computed by another version of this program.
    """
    manifest = study.manifest
    if code_of(manifest) != code_version():
        rule = "was computed by another version of this program: a new run does not belong to it"
        raise RefusedError(str(Fault(study.design.name, rule, "run the study again first")))
    design = place(study.design, settings, labels)
    work = expand(design, design_root(study.design, permission.data), permission.allowed)
    store = Store(study.folder)
    run_batch(work, store, jobs=1, progress=permission.progress)
    found = store.records(work.input_hashes)
    own = {*study.manifest["cases"]}
    kept = store.read_rows(CONFIRMED, ConfirmedRow)
    rows = [row for row in kept if row["case"] not in work.input_hashes]
    rows += [{"case": one.case_id, "input": work.input_hashes[one.case_id],
              "of": _identity(manifest)} for one in found if one.case_id not in own]  # fmt: skip
    with store.lock():
        store.write_json(CONFIRMED, rows)
    return tuple(found)
