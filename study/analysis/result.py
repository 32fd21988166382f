"""The result of an analysis: typed groups of values, and their JSON."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from study.analysis.anova_table import (
    Anova,
    Effect,
    ErrorTerm,
    FailureBound,
    ModelSummary,
)
from study.analysis.assumption.tests import Assumptions
from study.analysis.effects.power.detection import PowerRow
from study.canonical import plain

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.anova_table import NestedUnits
    from study.analysis.effects.linear_contrast import Contrast
    from study.analysis.request import AnalysisRequest
    from study.analysis.unreplicated import LenthResult
    from study.arrays import Array


@dataclass(frozen=True)
class Variation:
    """How the variation of the response divides.

    Parameters
    ----------
    shares : dict of str to float
        Functional-ANOVA share of every term, where every cell exists.
    lenth : LenthResult or None
        Lenth's analysis of an unreplicated design.
    summary : ModelSummary or None
        Residual standard deviation and coefficients of determination.
    """

    shares: dict[str, float]
    lenth: LenthResult | None
    summary: ModelSummary | None


@dataclass(frozen=True)
class Detection:
    """What differences are held against, and which could be found.

    Parameters
    ----------
    practical : float or None
        Smallest difference that matters, in the unit of the response or as a ratio.
    u_num : float or None
        Largest numerical uncertainty of an effect, in the unit of the response.
    u_num_by_term : bool
        Whether each effect has its own.
    power : dict of str to tuple of PowerRow
        Detectable difference of each factor with other numbers of blocks or replicates.
    """

    practical: float | None
    u_num: float | None
    u_num_by_term: bool
    power: dict[str, tuple[PowerRow, ...]]


@dataclass(frozen=True)
class DataSummary:
    """The rows that were analyzed.

    Parameters
    ----------
    n : int
        Number of rows.
    block : str or None
        Column of the blocks.
    grand_mean : float
        Mean of the response, the geometric one of a log response.
    cell_means : DataFrame
        One row a cell: levels, ``n``, ``mean``, ``sd``, ``representative``.
    residuals : DataFrame
        One row a run: levels, ``response``, ``fitted``, ``residual``, ``leverage``, ``cook``.
    representatives : tuple of str
        One cell of each distinct computation.
    distinct : int
        Number of distinct computations.
    copies : tuple of tuple of str
        Cells that agree in every block.
    model_matrix : ndarray, shape (n, p), or None
        Columns of the fit.
    bounds : tuple of FailureBound
        What missing responses could do to the conclusion.
    nested : NestedUnits or None
        What taking rows on one unit as independent would have claimed.
    """

    n: int
    block: str | None
    grand_mean: float
    cell_means: pd.DataFrame
    residuals: pd.DataFrame
    representatives: tuple[str, ...]
    distinct: int
    copies: tuple[tuple[str, ...], ...]
    model_matrix: Array | None = None
    bounds: tuple[FailureBound, ...] = ()
    nested: NestedUnits | None = None


@dataclass(frozen=True)
class AnalysisResult:
    """Everything that one response of a factorial can tell.

    Parameters
    ----------
    request : AnalysisRequest
        What was asked.
    error_term : ErrorTerm
        What effects are compared with, and which question p answers.
    anova : Anova
        Table of the sums of squares.
    variation : Variation
        Shares, Lenth's analysis, coefficients of determination.
    effects : tuple of Effect
        Size of every term with its interval and verdict.
    detection : Detection
        Practical difference, numerical uncertainty, detectable differences.
    assumptions : Assumptions
        Tests of what the analysis assumes.
    data : DataSummary
        The rows that were analyzed.
    notes : tuple of str
        What to beware of, in sentences.
    contrasts : tuple of Contrast
        Differences of two settings that were asked for by name.
    """

    request: AnalysisRequest
    error_term: ErrorTerm
    anova: Anova
    variation: Variation
    effects: tuple[Effect, ...]
    detection: Detection
    assumptions: Assumptions
    data: DataSummary
    notes: tuple[str, ...]
    contrasts: tuple[Contrast, ...] = ()

    def noted(self, *notes: str) -> AnalysisResult:
        """Copy with more notes."""
        return replace(self, notes=(*self.notes, *notes))

    def effect(self, term: str) -> Effect:
        """Effect of a term."""
        return next(item for item in self.effects if item.term == term)

    def effects_frame(self) -> pd.DataFrame:
        """Effects as a frame, one row a level or combination: mean, interval, letters."""
        import pandas as pd

        rows = []
        for effect in self.effects:
            for i, (level, mean) in enumerate(zip(effect.levels, effect.mean, strict=True)):
                low, high = (None, None) if effect.mean_ci95 is None else effect.mean_ci95[i]
                letters = effect.letters[i] if effect.letters else None
                values = (effect.term, level, mean, low, high, letters, effect.verdict)
                rows.append(values)
        columns = ["term", "level", "mean", "low", "high", "letters", "verdict"]
        return pd.DataFrame(rows, columns=columns)

    def to_json(self) -> dict[str, object]:
        """Document of ``study analyze --json``: JSON types only, never a bare NaN."""
        lenth = self.variation.lenth
        return {
            "response": self.request.response,
            "transform": self.request.scale.transform,
            "error_term": plain(self.error_term),
            "anova": plain(self.anova),
            **self.assumptions.to_json(),
            "effects": [plain(effect) for effect in self.effects],
            "shares": plain(self.variation.shares),
            "distinct_computations": self.data.distinct,
            "copies": plain(self.data.copies),
            "lenth": None if lenth is None else lenth.to_json(),
            "summary": plain(self.variation.summary),
            "failure_bounds": plain(self.data.bounds),
            "nested": plain(self.data.nested),
            "power": plain(self.detection.power),
            "contrasts": plain(self.contrasts),
            "warnings": list(self.notes),
        }

    def verdicts(self) -> list[dict[str, object]]:
        """One line a factor or interaction, as ``study run --json`` lists them."""
        return [
            {
                "response": self.request.response,
                "factor": effect.term,
                "verdict": effect.verdict,
                "effect": plain(effect.range),
                "ci95": plain(effect.ci95),
                "practical": plain(effect.practical),
                "u_num": plain(effect.u_num),
                "p": plain(effect.p),
                "effect_over_u_num": plain(effect.effect_over_u_num),
                "resolved": effect.resolved,
                "why": effect.why,
                "U": plain(effect.u_num),
                "U_needed": plain(effect.u_needed),
                "p_holm": plain(effect.p_holm),
                "lost_without": plain(effect.lost_without),
                "of_components": effect.of_components or None,
                "simple_effects": plain(effect.simple_effects),
            }
            for effect in self.effects
        ]
