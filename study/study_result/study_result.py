"""A study opened: design, records, analyses and what stands beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from study.analysis.assumption.failed_cases import FailurePattern, failure_pattern
from study.canonical import plain
from study.design.spec import Design
from study.record.record import Record
from study.record.table import is_repeat, table
from study.study_result.comparison import document
from study.study_result.failed_cases import fates
from study.study_result.report_data import ResponseAnalysis
from study.study_result.response_surface import FittedSurface

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.convergence.grid_convergence import NumericalUncertainty
    from study.study_result.comparison import Beside


@dataclass(frozen=True)
class StudyResult:
    """A study with everything that its records tell.

    Parameters
    ----------
    design : Design
        As it was run.
    records : tuple of Record
        One a case, in the order of the design; cases not computed yet are absent.
    total : int
        Number of cases of the design.
    analyses : tuple of ResponseAnalysis
        One for every response of the design.
    numerical : tuple of Numerical
        Numerical uncertainty of every response for every discretization.
    manifest : mapping
        What else is stored of the run: blocks, notes, timings, versions.
    report : Path or None
        The report, once written.
    validation : tuple of mapping
        E and u_val of every case along its curve, where inputs are uncertain.
    spaces : tuple of mapping
        How far 3D and axisymmetric space differ on a cylinder.
    beside : Beside, optional
        Which of its conclusions hold in another study too.
    surfaces : tuple of FittedSurface
        What responses do over the factors that are ranges; empty where there are none.
    adaptive : tuple of mapping
        What was known with so many cells, where cells were added while it ran.
    """

    design: Design
    folder: Path
    records: tuple[Record, ...]
    total: int
    analyses: tuple[ResponseAnalysis, ...]
    numerical: tuple[NumericalUncertainty, ...]
    manifest: Mapping[str, Any]
    warnings: tuple[str, ...] = ()
    report: Path | None = None
    predicted_seconds: float = 0.0
    validation: tuple[Mapping[str, Any], ...] = ()
    spaces: tuple[Mapping[str, Any], ...] = ()
    beside: Beside | None = None
    surfaces: tuple[FittedSurface, ...] = ()
    adaptive: tuple[Mapping[str, Any], ...] = ()

    @property
    def table(self) -> pd.DataFrame:
        """One tidy row a case, failed ones included."""
        return table(list(self.records))

    @property
    def plain(self) -> tuple[Record, ...]:
        """Records without replicates: one mesh a cell, the curve as measured."""
        return tuple(record for record in self.records if not is_repeat(record.extra))

    @property
    def failed(self) -> int:
        """Number of cases without an answer."""
        return sum(not record.converged for record in self.records)

    @cached_property
    def failure_pattern(self) -> FailurePattern:
        """What the failed cases share."""
        spec = self.design.measurements
        block = spec.block if spec is not None and spec.block else "block"
        return failure_pattern(fates(self.design, self.records), block, self.design.seed)

    @property
    def cases(self) -> dict[str, int]:
        """Number of cases: in all, done, failed and missing."""
        return {
            "total": self.total,
            "done": len(self.records) - self.failed,
            "failed": self.failed,
            "missing": self.total - len(self.records),
        }

    @property
    def verdicts(self) -> list[dict[str, object]]:
        """One verdict for every response and term."""
        return [
            row | {"scored_on": analysis.scored_on or None}
            for analysis in self.analyses
            if analysis.result is not None
            for row in analysis.result.verdicts()
        ] + [row for one in self.surfaces for row in one.verdicts]

    def to_json(self) -> dict[str, object]:
        """Document of ``study run --json``."""
        found: dict[str, object] = {
            "study": self.design.name,
            "cases": self.cases,
            "predicted_seconds": self.predicted_seconds,
            "report": None if self.report is None else str(self.report),
            "verdicts": self.verdicts,
            "warnings": list(self.warnings),
        }
        asked = [
            {"response": one.name, **plain(contrast)}
            for one in self.analyses
            if one.result is not None
            for contrast in one.result.contrasts
        ]
        if asked:
            found["contrasts"] = asked
        if self.failed:
            found["failures"] = self.failure_pattern.to_json()
        if self.surfaces:
            found["surfaces"] = [one.to_json() for one in self.surfaces]
        if self.adaptive:
            found["adaptive"] = [dict(step) for step in self.adaptive]
        if self.beside is not None:
            found["beside"] = document(self.beside)
        return found
