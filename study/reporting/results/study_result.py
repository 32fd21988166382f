"""A study opened: design, records, analyses and what stands beside them."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from study.ground.contrast import Expected
from study.ground.curve import Curve
from study.record.record import MADE_ELSEWHERE, Record
from study.statistics.analysis.anova_table import DepthEffect
from study.statistics.analysis.failures import FailurePattern
from study.statistics.convergence.grid_convergence import NumericalUncertainty
from study.statistics.surfaces.surface_result import FittedSurface

if TYPE_CHECKING:
    import pandas as pd

    from study.reporting.results.study_answers import Beside
    from study.statistics.analysis.analysis_result import AnalysisResult


# What a report is made of: plain values that whoever holds the records fills in.
#
# The report formats and draws; it computes nothing that belongs to the analysis. Every
# field is a string, a number, a mapping, a data frame, a :class:`~study.ground.curve.Curve` or the
# result of ``analyze``, so that a report can be built in a test,
# in a notebook or from stored records without running anything.

#: level of a factor that a fit does not depend on
ANY = "any"
#: what a score was taken on
FITTED_CURVE = "the curve fitted"
OTHER_TEST = "same specimen, other test"
OTHER_SPECIMEN = "other specimen"


@dataclass(frozen=True)
class ResponseAnalysis:
    """One response and its analysis."""

    #: Column of ``ReportData.table``, for example ``"relative_rms_force_error"``.
    name: str
    #: Unit of that column, for example ``"%"`` or ``"kPa"``.
    unit: str
    result: AnalysisResult | None = None
    #: Smallest difference that matters: in ``unit``, or, with ``relative``, a fraction of the grand
    #: mean (0.1 is ten percent).
    practical: float | None = None
    relative: bool = False
    #: ``"none"`` or ``"log"``; with ``"log"`` every effect is a ratio.
    transform: str = "none"
    #: ``"lower"`` (an error), ``"higher"`` or ``""`` (an identified constant: no best cell).
    better: str = ""
    #: Name in sentences; made from ``name`` when empty.
    title: str = ""
    refused: str = ""
    #: ``"the curve fitted"``, ``"same specimen, other test"``, ``"other specimen"``; empty for what
    #: is no score of a calibrated model.
    scored_on: str = ""
    cross_validated: bool = False


@dataclass(frozen=True)
class CurvePair:
    """A measured curve and the prediction of one cell for it."""

    levels: Mapping[str, str]
    #: Block of the measurement (empty without blocks).
    block: str
    #: In mm and N.
    measured: Curve
    predicted: Curve
    #: Which of the block's curves, for example the specimen ``"B"``.
    label: str = ""
    #: ``"score"`` (a prediction) or ``"fit"`` (the constants come from this curve).
    role: str = "score"
    #: shape (n,); standard deviation of the averaged repeats at each measured point.
    scatter_N: NDArray[np.float64] | None = None
    #: Case of the table that the pair belongs to.
    case_id: str = ""


@dataclass(frozen=True)
class FittedConstant:
    """One fitted constant of one fit."""

    #: Levels of the factors that enter the fit; ``ANY`` where one fit serves all of them.
    levels: Mapping[str, str]
    block: str
    constant: str
    #: Estimate, standard error and 95 % interval in ``unit``; None where not available.
    value: float | None
    unit: str = "kPa"
    standard_error: float | None = None
    low: float | None = None
    high: float | None = None
    identifiable: bool = True
    #: Why not, or with what else it is correlated.
    reason: str = ""
    specimen: str = ""
    #: Correlation with the other constants of the same fit.
    correlated: Mapping[str, float] = field(default_factory=dict)
    residual_N: float | None = None  # noqa: N815
    r_squared: float | None = None


# Checks that are made where something is amiss alone; the answer speaks of them too.
FITS_DESCRIBE = "fits describe their data"
PLAUSIBLE = "forces are those of soft materials"
ANSWERED = (PLAUSIBLE, FITS_DESCRIBE)


@dataclass(frozen=True)
class Check:
    """One check: pass, caution, fail or not applicable; the consequence says what follows.

    ``of`` names the response where the same check is made for several of them.
    """

    name: str
    outcome: str
    finding: str
    consequence: str = ""
    of: str = ""


@dataclass(frozen=True)
class RefinedSize:
    """What was refined, the mesh or a parameter of a program, its size with the unit, and how."""

    name: str = "mesh"
    size: str = "mesh size (mm)"
    #: Series of three meshes or more, as ``study converge --json`` gives them.
    series: tuple[Mapping[str, Any], ...] = ()


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What was computed of a study or of a table, and what stands beside it."""

    #: One a response.
    analyses: tuple[ResponseAnalysis, ...] = ()
    #: What responses do over the factors that are ranges; empty where there are none.
    surfaces: tuple[FittedSurface, ...] = ()
    #: Numerical uncertainty of every response for every discretization.
    numerical: tuple[NumericalUncertainty, ...] = ()
    #: E and u_val of every case along its curve, where inputs are uncertain.
    validation: tuple[Mapping[str, Any], ...] = ()
    warnings: tuple[str, ...] = ()
    #: A second study that it is compared with.
    beside: Beside | None = None


@dataclass(frozen=True)
class ReportData(Findings):
    """Everything a report shows."""

    name: str
    question: str
    #: Factor name (a dotted key or a preset set) to its level labels, in order.
    factors: Mapping[str, tuple[str, ...]]
    #: One row per case: ``case_id``, ``block``, the factor columns (labels), ``status``, one column
    #: per response, and ``seconds``, ``dofs`` where known. Failed rows stay, with missing
    #: responses.
    table: pd.DataFrame
    #: What the block is (``"phantom"``); empty without blocks.
    block: str = ""
    blocks: tuple[str, ...] = ()
    #: Fixed inputs, as text with units, in the order to be shown.
    inputs: Mapping[str, str] = field(default_factory=dict)
    #: Inputs nobody measured, key to value; labelled so.
    assumed: Mapping[str, str] = field(default_factory=dict)
    citation: str = ""
    exclusions: tuple[tuple[str, str], ...] = ()
    curves: tuple[CurvePair, ...] = ()
    fits: tuple[FittedConstant, ...] = ()
    markers: tuple[Record, ...] = ()
    failures: tuple[Record, ...] = ()
    failure_pattern: FailurePattern | None = None
    #: Cases whose settings are not those of the design.
    retried: tuple[Record, ...] = ()
    #: Checks that the runner made (store, stability, ...); those of the analysis are added by the
    #: report.
    checks: tuple[Check, ...] = ()
    refinement: RefinedSize = RefinedSize()
    #: Main effects with the test scored to less of its depth.
    depths: tuple[DepthEffect, ...] = ()
    controls: tuple[Check, ...] = ()
    #: Measurements were generated, so p describes the scatter of the generator.
    virtual: bool = False
    seed: int = 2011
    alpha: float = 0.05
    timings: Mapping[str, float] = field(default_factory=dict)
    #: Versions, hashes, thread counts, machine; shown as given.
    provenance: Mapping[str, str] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    #: What was done to the measurements (rows dropped, sorted, averaged).
    data_notes: tuple[str, ...] = ()
    design_text: str = ""
    #: What part of the full factorial was run; empty for all of it.
    scheme: str = ""
    cells: int | None = None
    #: Better names for factors or responses; made from the key when absent.
    labels: Mapping[str, str] = field(default_factory=dict)
    #: ``"choice"``, ``"condition"`` or ``"unknown"`` by factor; a choice where it is absent.
    roles: Mapping[str, str] = field(default_factory=dict)
    expected: tuple[Expected, ...] = ()
    #: Ends of the factors of surfaces with their unit, in place of a list of levels.
    ranges: Mapping[str, str] = field(default_factory=dict)
    #: Whether the rows are those of a table: nothing was simulated.
    is_table: bool = False
    is_measured: bool = True

    @property
    def imported(self) -> tuple[str, ...]:
        """Notes on runs that were read from a table: no program here can run them again."""
        return tuple(note for note in self.data_notes if MADE_ELSEWHERE in note)

    @property
    def planned(self) -> int:
        """Number of cells of the design, without the excluded ones."""
        if self.cells is not None:
            return self.cells
        return math.prod(len(levels) for levels in self.factors.values()) - len(self.exclusions)
