"""What ``study converge`` found of a problem, or of the cells of a design."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

from study.runner.job import CaseJob
from study.runner.numerical.judgement import SeriesJudgement


@dataclass(frozen=True)
class FrontPoint:
    """Error and cost of one mesh of one cell; the error is a share of the reference."""

    cell: str
    mesh_size: float
    unknowns: int
    seconds: float
    memory_MB: float  # noqa: N815
    value: float
    error: float


@dataclass(frozen=True)
class RankedCell:
    """Seconds and mesh size with which a cell reaches the accuracy; None where it does not."""

    cell: str
    seconds: float | None
    mesh_size: float | None
    how: str


@dataclass(frozen=True)
class CostFront:
    """Cells that differ in nothing but their discretization: error against cost.

    Parameters
    ----------
    reference, reference_u : float
        The limit with the smallest uncertainty among the cells, and that uncertainty.
    accuracy : float
        Wanted error, as a share of the reference.
    points : tuple of FrontPoint
        Every mesh.
    ranking : tuple of RankedCell
        Which cell reaches the accuracy, the cheapest first.
    answer : str
        The same in a sentence.
    """

    reference: float
    reference_u: float | None
    accuracy: float
    points: tuple[FrontPoint, ...]
    ranking: tuple[RankedCell, ...]
    answer: str


@dataclass(frozen=True)
class ProblemConvergence:
    """Series of one problem, and its page where one was asked for."""

    judgement: SeriesJudgement
    report: Path | None = None

    @property
    def cells(self) -> tuple[SeriesJudgement, ...]:
        """The one series."""
        return (self.judgement,)

    def to_json(self) -> dict[str, object]:
        """Document of ``study converge PROBLEM --json``."""
        return self.judgement.to_json() | _page(self.report)


@dataclass(frozen=True)
class DesignConvergence:
    """Series of the cells of a design.

    Parameters
    ----------
    cells : tuple of SeriesJudgement
        What is said of each.
    fronts : tuple of CostFront, optional
        What an accuracy costs, for cells without measurements.
    left_out : tuple of CaseJob, optional
        Cells of a study that the time budget did not allow.
    report : Path, optional
        The page.
    """

    cells: tuple[SeriesJudgement, ...]
    fronts: tuple[CostFront, ...] | None = None
    left_out: tuple[CaseJob, ...] | None = None
    report: Path | None = None

    def to_json(self) -> dict[str, object]:
        """Document of ``study converge DESIGN --json``."""
        found: dict[str, object] = {"cells": [one.to_json() for one in self.cells]}
        if self.fronts is not None:
            found["fronts"] = [asdict(front) for front in self.fronts]
        if self.left_out is not None:
            found["left_out"] = [
                {"levels": dict(job.case.levels), "verdict": "left out: the time budget"}
                for job in self.left_out
            ]
        return found | _page(self.report)


def _page(report: Path | None) -> dict[str, object]:
    return {} if report is None else {"report": str(report)}
