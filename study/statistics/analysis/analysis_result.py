"""The result of an analysis: typed groups of values, and their JSON."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from study.ground.canonical import Keyed
from study.statistics.analysis.anova_table import (
    Anova,
    Effect,
    ErrorTerm,
    FailureBound,
    ModelSummary,
)
from study.statistics.analysis.assumptions import Assumptions
from study.statistics.analysis.data import Crossed, Structure
from study.statistics.analysis.effects import Scale
from study.statistics.analysis.power import PowerRow
from study.statistics.analysis.sums_of_squares import Factored

if TYPE_CHECKING:
    import pandas as pd

    from study.statistics.analysis.analysis_request import AnalysisRequest
    from study.statistics.analysis.anova_table import NestedUnits
    from study.statistics.analysis.linear_contrast import Contrast
    from study.statistics.analysis.unreplicated import LenthResult


@dataclass(frozen=True)
class Variation:
    """How the variation of the response divides."""

    #: Functional-ANOVA share of every term, where every cell exists.
    shares: dict[str, float]
    #: Lenth's analysis of an unreplicated design.
    lenth: LenthResult | None
    #: Residual standard deviation and coefficients of determination.
    summary: ModelSummary | None


@dataclass(frozen=True)
class Detection:
    """What differences are held against, and which could be found."""

    #: Smallest difference that matters, in the unit of the response or as a ratio.
    practical: float | None
    #: Largest numerical uncertainty of an effect, in the unit of the response.
    u_num: float | None
    #: Whether each effect has its own.
    u_num_by_term: bool
    #: Detectable difference of each factor with other numbers of blocks or replicates.
    power: dict[str, tuple[PowerRow, ...]]
    #: What turns differences into verdicts.
    scale: Scale = field(default_factory=lambda: Scale("none", None, None, False))


@dataclass(frozen=True)
class DataSummary:
    """The rows that were analyzed."""

    n: int
    block: str | None
    #: Mean of the response, the geometric one of a log response.
    grand_mean: float
    #: One row a cell: levels, ``n``, ``mean``, ``sd``, ``representative``.
    cell_means: pd.DataFrame
    #: One row a run: levels, ``response``, ``fitted``, ``residual``, ``leverage``, ``cook``.
    residuals: pd.DataFrame
    #: One cell of each distinct computation.
    representatives: tuple[str, ...]
    #: Cells that agree in every block.
    copies: tuple[tuple[str, ...], ...]
    #: Fit of the terms by least squares: to all rows, or to what they are within whole plots.
    model: Factored | None = None
    #: What missing responses could do to the conclusion.
    bounds: tuple[FailureBound, ...] = ()
    #: What taking rows on one unit as independent would have claimed.
    nested: NestedUnits | None = None
    #: Cells against blocks, where effects are tested against their own interactions.
    crossed: Crossed | None = None
    #: What the table is: step of the readings, nesting, empty cells, terms that are not told apart.
    structure: Structure = field(default_factory=Structure)

    @property
    def distinct(self) -> int:
        """Number of distinct computations."""
        return len(self.representatives)


@dataclass(frozen=True)
class AnalysisResult(Keyed):
    """Everything that one response of a factorial can tell."""

    KEYS = (
        "response=request.response transform=request.scale.transform error_term anova effects "
        "structure=data.structure shares=variation.shares distinct_computations=data.distinct "
        "copies=data.copies lenth=variation.lenth summary=variation.summary "
        "failure_bounds=data.bounds nested=data.nested power=detection.power contrasts "
        "warnings=notes"
    )

    request: AnalysisRequest
    #: What effects are compared with, and which question p answers.
    error_term: ErrorTerm
    #: Table of the sums of squares.
    anova: Anova
    #: Shares, Lenth's analysis, coefficients of determination.
    variation: Variation
    #: Size of every term with its interval and verdict.
    effects: tuple[Effect, ...]
    #: Practical difference, numerical uncertainty, detectable differences.
    detection: Detection
    #: Tests of what the analysis assumes.
    assumptions: Assumptions
    data: DataSummary
    #: What to beware of, in sentences.
    notes: tuple[str, ...]
    #: Differences of two settings that were asked for by name.
    contrasts: tuple[Contrast, ...] = ()

    def noted(self, *notes: str) -> AnalysisResult:
        """Copy with more notes."""
        return replace(self, notes=(*self.notes, *notes))

    def effect(self, term: str) -> Effect:
        """Effect of a term."""
        return next(item for item in self.effects if item.term == term)

    def keyed(self) -> dict[str, object]:
        """Give what stands under every key, the tests of what is assumed among them."""
        effects = [effect.to_json() for effect in self.effects]
        return super().keyed() | {"effects": effects, **self.assumptions.to_json()}

    def verdicts(self) -> list[dict[str, object]]:
        """One line a factor or interaction, as ``study run --json`` lists them."""
        lines = []
        for effect in self.effects:
            document = effect.to_json() | {"of_components": effect.of_components or None}
            pairs = (key.partition("=") for key in _VERDICT_KEYS.split())
            line = {key: document[name or key] for key, _, name in pairs}
            lines.append({"response": self.request.response, **line})
        return lines


#: keys of the line of a factor, with the field of its effect where it has another name
_VERDICT_KEYS = (
    "factor=term verdict effect=range ci95 practical u_num p effect_over_u_num resolved why "
    "U=u_num U_needed=u_needed p_holm lost_without of_components simple_effects withdrawn"
)
