"""Statistics: the error term first, then tables, effects, assumptions and convergence."""

from __future__ import annotations

from study.analysis.anova import analyze
from study.analysis.comparisons import dunnett, games_howell, holm, tukey_kramer
from study.analysis.convergence import ConvergenceResult, grid_convergence
from study.analysis.normality import RyanJoinerResult, anderson_darling, ryan_joiner, shapiro_wilk
from study.analysis.power import detectable
from study.analysis.practical import Threshold, threshold
from study.analysis.remedies import sensitivity
from study.analysis.results import AnalysisResult, Anova, Effect, ErrorTerm, Row
from study.analysis.tidy import read_csv
from study.analysis.unreplicated import LenthResult, lenth
from study.analysis.variance import BartlettResult, LeveneResult, bartlett, levene

__all__ = [
    "AnalysisResult",
    "Anova",
    "BartlettResult",
    "ConvergenceResult",
    "Effect",
    "ErrorTerm",
    "LenthResult",
    "LeveneResult",
    "Row",
    "RyanJoinerResult",
    "Threshold",
    "analyze",
    "anderson_darling",
    "bartlett",
    "grid_convergence",
    "lenth",
    "levene",
    "read_csv",
    "ryan_joiner",
    "shapiro_wilk",
    "threshold",
    "tukey_kramer",
    "sensitivity",
    "holm",
    "games_howell",
    "dunnett",
    "detectable",
]
