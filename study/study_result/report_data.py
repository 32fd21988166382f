"""What a report is made of: plain values that whoever holds the records fills in.

The report formats and draws; it computes nothing that belongs to the analysis. Every
field is a string, a number, a mapping, a data frame, a :class:`~study.curve.Curve` or the
result of :func:`study.analysis.anova.analyze`, so that a report can be built in a test,
in a notebook or from stored records without running anything.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from study.curve import Curve

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.assumption.failed_cases import FailurePattern
    from study.analysis.convergence.grid_convergence import NumericalUncertainty
    from study.analysis.result import AnalysisResult
    from study.design.spec import Expected
    from study.record.document import PlateFitDocument
    from study.study_result.comparison import Beside
    from study.study_result.response_surface import FittedSurface


#: level of a factor that a fit does not depend on
ANY = "any"
#: what a score was taken on
FITTED_CURVE = "the curve fitted"
OTHER_TEST = "same specimen, other test"
OTHER_SPECIMEN = "other specimen"
OUTCOMES = ("pass", "caution", "fail", "not applicable")


@dataclass(frozen=True)
class ResponseAnalysis:
    """One response and its analysis.

    Parameters
    ----------
    name : str
        Column of ``ReportData.table``, for example ``"relative_rms_force_error"``.
    unit : str
        Unit of that column, for example ``"%"`` or ``"kPa"``.
    result : AnalysisResult or None
        None where the response could not be analyzed.
    practical : float, optional
        Smallest difference that matters: in ``unit``, or, with ``relative``, a fraction
        of the grand mean (0.1 is ten percent).
    relative : bool
        Whether ``practical`` is a fraction of the mean.
    transform : str
        ``"none"`` or ``"log"``; with ``"log"`` every effect is a ratio.
    u_num : float, optional
        Largest numerical standard uncertainty of an effect, in ``unit``.
    better : str
        ``"lower"`` (an error), ``"higher"`` or ``""`` (an identified constant: no best cell).
    title : str
        Name in sentences; made from ``name`` when empty.
    refused : str
        Why there is no ``result``.
    scored_on : str
        ``"the curve fitted"``, ``"same specimen, other test"``, ``"other specimen"``; empty for
        what is no score of a calibrated model.
    """

    name: str
    unit: str
    result: AnalysisResult | None = None
    practical: float | None = None
    relative: bool = False
    transform: str = "none"
    u_num: float | None = None
    better: str = ""
    title: str = ""
    refused: str = ""
    scored_on: str = ""
    cross_validated: bool = False


@dataclass(frozen=True)
class CurvePair:
    """A measured curve and the prediction of one cell for it.

    Parameters
    ----------
    levels : mapping of str to str
        Level of each factor.
    block : str
        Block of the measurement (empty without blocks).
    measured, predicted : Curve
        In mm and N.
    label : str
        Which of the block's curves, for example the specimen ``"B"``.
    role : str
        ``"score"`` (a prediction) or ``"fit"`` (the constants come from this curve).
    scatter_N : ndarray, shape (n,), optional
        Standard deviation of the averaged repeats at each measured point.
    case_id : str
        Case of the table that the pair belongs to.
    """

    levels: Mapping[str, str]
    block: str
    measured: Curve
    predicted: Curve
    label: str = ""
    role: str = "score"
    scatter_N: NDArray[np.float64] | None = None
    case_id: str = ""


@dataclass(frozen=True)
class FittedConstant:
    """One fitted constant of one fit.

    Parameters
    ----------
    levels : mapping of str to str
        Levels of the factors that enter the fit; ``ANY`` where one fit serves all of them.
    block, specimen : str
        What it was fitted to.
    constant : str
        Name, for example ``"C10"``.
    value, standard_error, low, high : float or None
        Estimate, standard error and 95 % interval in ``unit``; None where not available.
    unit : str
        Usually ``"kPa"``.
    identifiable : bool
        Whether the data determine it.
    reason : str
        Why not, or with what else it is correlated.
    correlated : mapping of str to float
        Correlation with the other constants of the same fit.
    residual_N : float, optional
        RMS of the residual that the fit left, in N.
    r_squared : float, optional
        Coefficient of determination of the fit.
    """

    levels: Mapping[str, str]
    block: str
    constant: str
    value: float | None
    unit: str = "kPa"
    standard_error: float | None = None
    low: float | None = None
    high: float | None = None
    identifiable: bool = True
    reason: str = ""
    specimen: str = ""
    correlated: Mapping[str, float] = field(default_factory=dict)
    residual_N: float | None = None  # noqa: N815
    r_squared: float | None = None


@dataclass(frozen=True)
class MarkedCase:
    """Markers inside the specimen of one case, by what its plate was taken to do.

    Parameters
    ----------
    levels : mapping of str to str
        Level of each factor.
    state : str
        Of the test: the block of the case.
    floor_mm : float or None
        Distance of the markers from any smooth field (RMS): no model comes below.
    fits : tuple of PlateFitDocument
        Errors, and the motion of the plate that leaves them.
    """

    levels: Mapping[str, str]
    state: str
    floor_mm: float | None
    fits: tuple[PlateFitDocument, ...]


@dataclass(frozen=True)
class Failure:
    """A case that gave no response: which, how, and what the solver said."""

    case_id: str
    levels: Mapping[str, str]
    block: str
    status: str
    message: str = ""


@dataclass(frozen=True)
class Retried:
    """A case that was computed with other settings than the design's, having failed with these.

    Parameters
    ----------
    case_id, block, status : str
        Which, and what became of it in the end.
    levels : mapping of str to str
        Level of each factor.
    notes : tuple of mapping of str to str
        Of every attempt the ``cause``, its ``message``, and ``what`` was changed for it.
    """

    case_id: str
    levels: Mapping[str, str]
    block: str
    status: str
    notes: tuple[Mapping[str, str], ...]


@dataclass(frozen=True)
class Check:
    """One check: ``outcome`` is one of ``OUTCOMES``; the consequence says what follows.

    ``of`` names the response where the same check is made for several of them.
    """

    name: str
    outcome: str
    finding: str
    consequence: str = ""
    of: str = ""

    def __post_init__(self) -> None:
        if self.outcome not in OUTCOMES:
            raise ValueError(f"outcome must be one of {', '.join(OUTCOMES)}, got {self.outcome!r}")


@dataclass(frozen=True)
class DepthEffect:
    """Largest difference of a factor with the test scored to a part of its depth.

    Parameters
    ----------
    response, term : str
        Response and factor.
    depth_mm : float
        Displacement in mm to which the curves are scored.
    difference, low, high : float or None
        With its simultaneous interval, in the unit of the response or as ratios.
    practical : float or None
        Smallest difference that matters, on the same scale.
    verdict : str
        Of the factor at this depth.
    highest : str
        Level with the largest mean.
    """

    response: str
    term: str
    depth_mm: float
    difference: float
    low: float | None
    high: float | None
    practical: float | None
    verdict: str
    highest: str


@dataclass(frozen=True)
class ReportData:
    """Everything a report shows.

    Parameters
    ----------
    name, question : str
        Of the study.
    factors : mapping of str to tuple of str
        Factor name (a dotted key or a preset set) to its level labels, in order.
    table : DataFrame
        One row per case: ``case_id``, ``block``, the factor columns (labels), ``status``,
        one column per response, and ``seconds``, ``dofs`` where known. Failed rows stay,
        with missing responses.
    responses : sequence of ResponseAnalysis
        One analysis each, in the order of the design.
    block : str
        What the block is (``"phantom"``); empty without blocks.
    blocks : tuple of str
        Labels of the blocks.
    inputs : mapping of str to str
        Fixed inputs, as text with units, in the order to be shown.
    assumed : mapping of str to str
        Inputs nobody measured, key to value; labelled so.
    citation : str
        Source of the measurements.
    exclusions : sequence of (str, str)
        Excluded cell and why.
    curves : sequence of CurvePair
    fits : sequence of FittedConstant
    markers : sequence of MarkedCase
    failures : sequence of Failure
    failure_pattern : FailurePattern, optional
        What the failed cases share.
    retried : sequence of Retried
        Cases whose settings are not those of the design.
    checks : sequence of Check
        Checks that the runner made (store, stability, ...); those of the analysis are
        added by the report.
    numerical : sequence of NumericalUncertainty
    convergence : sequence of mapping
        Series of three meshes or more, as ``study converge --json`` gives them.
    depths : sequence of DepthEffect
        Main effects with the test scored to less of its depth.
    validation : sequence of mapping
        E and u_val of every case along its curve, where inputs are uncertain.
    controls : sequence of Check
        Controls and identities, such as 3D against axisymmetric.
    virtual : bool
        Measurements were generated, so p describes the scatter of the generator.
    seed : int
    alpha : float
    timings : mapping of str to float
        Seconds of each part of the run.
    provenance : mapping of str to str
        Versions, hashes, thread counts, machine; shown as given.
    commands : tuple of str
        How to reproduce.
    data_notes : sequence of str
        What was done to the measurements (rows dropped, sorted, averaged).
    warnings : sequence of str
        Warnings of the run.
    design_text : str
        The design file.
    scheme : str
        What part of the full factorial was run; empty for all of it.
    cells : int, optional
        Cells of that part.
    labels : mapping of str to str
        Better names for factors or responses; made from the key when absent.
    roles : mapping of str to str
        ``"choice"``, ``"condition"`` or ``"unknown"`` by factor; a choice where it is absent.
    expected : tuple of Expected
        What was expected before the study ran.
    beside : Beside, optional
        What another study says of the same conclusions.
    surfaces : tuple of FittedSurface
        What responses do over the factors that are ranges.
    ranges : mapping of str to str
        Ends of those factors with their unit, in place of a list of levels.
    is_table : bool
        Whether the rows are those of a table: nothing was simulated.
    is_measured : bool
    """

    name: str
    question: str
    factors: Mapping[str, tuple[str, ...]]
    table: pd.DataFrame
    responses: tuple[ResponseAnalysis, ...] = ()
    block: str = ""
    blocks: tuple[str, ...] = ()
    inputs: Mapping[str, str] = field(default_factory=dict)
    assumed: Mapping[str, str] = field(default_factory=dict)
    citation: str = ""
    exclusions: tuple[tuple[str, str], ...] = ()
    curves: tuple[CurvePair, ...] = ()
    fits: tuple[FittedConstant, ...] = ()
    markers: tuple[MarkedCase, ...] = ()
    failures: tuple[Failure, ...] = ()
    failure_pattern: FailurePattern | None = None
    retried: tuple[Retried, ...] = ()
    checks: tuple[Check, ...] = ()
    numerical: tuple[NumericalUncertainty, ...] = ()
    convergence: tuple[Mapping[str, Any], ...] = ()
    depths: tuple[DepthEffect, ...] = ()
    validation: tuple[Mapping[str, Any], ...] = ()
    controls: tuple[Check, ...] = ()
    virtual: bool = False
    seed: int = 2011
    alpha: float = 0.05
    timings: Mapping[str, float] = field(default_factory=dict)
    provenance: Mapping[str, str] = field(default_factory=dict)
    commands: tuple[str, ...] = ()
    data_notes: tuple[str, ...] = ()
    warnings: tuple[str, ...] = ()
    design_text: str = ""
    scheme: str = ""
    cells: int | None = None
    labels: Mapping[str, str] = field(default_factory=dict)
    roles: Mapping[str, str] = field(default_factory=dict)
    expected: tuple[Expected, ...] = ()
    beside: Beside | None = None
    surfaces: tuple[FittedSurface, ...] = ()
    ranges: Mapping[str, str] = field(default_factory=dict)
    is_table: bool = False
    is_measured: bool = True

    @property
    def planned(self) -> int:
        """Number of cells of the design, without the excluded ones."""
        if self.cells is not None:
            return self.cells
        return math.prod(len(levels) for levels in self.factors.values()) - len(self.exclusions)
