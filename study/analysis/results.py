"""Frozen results of the statistics, with the keys that scripts rely on."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.matrix import Array
    from study.analysis.nested import NestedUnits
    from study.analysis.normality import NormalityResult, RyanJoinerResult
    from study.analysis.power import PowerRow
    from study.analysis.remedies import BoxCoxResult, Sensitivity
    from study.analysis.sphericity import SphericityResult
    from study.analysis.unreplicated import LenthResult, NonAdditivityResult
    from study.analysis.variance import BartlettResult, LeveneResult


def plain(value: Any) -> Any:
    """Value made of JSON types alone; a number that is not finite becomes None."""
    if is_dataclass(value) and not isinstance(value, type):
        return {f.name: plain(getattr(value, f.name)) for f in fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray):
        return plain(value.tolist())
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


@dataclass(frozen=True)
class ErrorTerm:
    """Where the error of the table comes from and which question its p answers."""

    source: str
    question: str
    df: float | dict[str, float] | None
    reason: str = ""


@dataclass(frozen=True)
class Row:
    """One line of the ANOVA table; what does not apply is None."""

    term: str
    df: float
    ss: float
    ms: float | None = None
    f: float | None = None
    p: float | None = None
    error: str | None = None
    df_error: float | None = None
    epsilon_gg: float | None = None
    p_gg: float | None = None
    omega_sq: float | None = None
    partial_eta_sq: float | None = None
    partial_eta_sq_ci95: tuple[float, float] | None = None
    share: float | None = None

    @property
    def p_deciding(self) -> float | None:
        """Greenhouse-Geisser's p where there is one, else the plain p."""
        return self.p if self.p_gg is None else self.p_gg


@dataclass(frozen=True)
class Anova:
    """ANOVA table of one type, with the corrected total."""

    type: str
    rows: tuple[Row, ...]
    df_total: int | None = None
    ss_total: float | None = None

    def row(self, term: str) -> Row:
        """Row of a term."""
        return next(row for row in self.rows if row.term == term)

    def to_frame(self) -> pd.DataFrame:
        """Table as a frame, one row a term; what does not apply is missing."""
        import pandas as pd

        return pd.DataFrame([plain(row) for row in self.rows])


@dataclass(frozen=True)
class ModelSummary:
    """Residual standard deviation ``s`` and the coefficients of determination of a fit."""

    s: float
    r_sq: float
    r_sq_adj: float
    r_sq_pred: float | None


@dataclass(frozen=True)
class Influential:
    """Largest leverage and Cook's distance, and the rows (from 1) that the fit leans on."""

    max_leverage: float
    max_cook: float | None
    limit: float
    rows: tuple[int, ...]


@dataclass(frozen=True)
class FailureBound:
    """What missing responses could do to one term.

    Parameters
    ----------
    low, high : float or None
        Bounds of the largest difference over all values that the missing responses may take
        between the lowest and the highest observed one.
    verdicts : tuple of str
        Verdicts met: of the rows there are, then with the missing ones at the extremes.
    p : tuple of float or None
        Smallest and largest deciding p among them.
    holds : bool
        Whether the verdict is the same everywhere.
    """

    term: str
    low: float | None
    high: float | None
    verdicts: tuple[str, ...]
    p: tuple[float, float] | None
    holds: bool


@dataclass(frozen=True)
class PairDifference:
    """Difference (or ratio) of two level means with its simultaneous interval."""

    first: str
    second: str
    difference: float
    lower: float
    upper: float
    different: bool


@dataclass(frozen=True)
class Effect:
    """Size of one term in response units (or as a ratio, for a log response).

    ``range`` is the largest difference between level means of a factor, or between the pure
    interaction components of an interaction (in a two-level design both equal the classical
    effect); ``ci95`` is its simultaneous interval over all pairs. Levels of a factor that share
    one of the ``letters`` are not told apart.
    """

    term: str
    levels: tuple[str, ...]
    mean: tuple[float | None, ...]
    ci95: tuple[float, float] | None
    range: float | None
    verdict: str
    scale: str = "difference"
    largest: tuple[str, str] | None = None
    mean_ci95: tuple[tuple[float, float], ...] | None = None
    practical: float | None = None
    u_num: float | None = None
    effect_over_u_num: float | None = None
    resolved: str | None = None
    p: float | None = None
    why: str = ""
    pairs: tuple[PairDifference, ...] = ()
    letters: tuple[str, ...] = ()


@dataclass(frozen=True)
class AnalysisResult:
    """Everything that one response of a factorial can tell.

    Attributes carry the names of the JSON keys; tables are pandas frames. ``u_num`` is the
    largest numerical uncertainty of an effect, ``u_num_by_term`` whether each has its own.
    """

    response: str
    factors: tuple[str, ...]
    block: str | None
    transform: str
    alpha: float
    seed: int
    error_term: ErrorTerm
    anova: Anova
    normality: RyanJoinerResult | None
    bartlett: BartlettResult | None
    levene: LeveneResult | None
    effects: tuple[Effect, ...]
    warnings: tuple[str, ...]
    cell_means: pd.DataFrame
    residuals: pd.DataFrame
    shares: dict[str, float]
    representatives: tuple[str, ...]
    distinct: int
    copies: tuple[tuple[str, ...], ...] = ()
    grand_mean: float | None = None
    practical: float | None = None
    u_num: float | None = None
    lenth: LenthResult | None = None
    sphericity: dict[str, SphericityResult] = field(default_factory=dict)
    non_additivity: NonAdditivityResult | None = None
    anderson_darling: NormalityResult | None = None
    shapiro_wilk: NormalityResult | None = None
    model_matrix: Array | None = None
    n: int = 0
    summary: ModelSummary | None = None
    influence: Influential | None = None
    robustness: Sensitivity | None = None
    box_cox: BoxCoxResult | None = None
    bounds: tuple[FailureBound, ...] = ()
    nested: NestedUnits | None = None
    power: dict[str, tuple[PowerRow, ...]] = field(default_factory=dict)
    u_num_by_term: bool = False

    @property
    def variance(self) -> dict[str, Any]:
        """Tests of equal spread by name."""
        return {"bartlett": self.bartlett, "levene": self.levene}

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

    def to_json(self) -> dict[str, Any]:
        """Document of ``study analyze --json``: JSON types only, never a bare NaN."""
        normality = None if self.normality is None else self.normality.to_json()
        return {
            "response": self.response,
            "transform": self.transform,
            "error_term": plain(self.error_term),
            "anova": plain(self.anova),
            "normality": normality,
            "variance": {
                "bartlett": None if self.bartlett is None else self.bartlett.to_json(),
                "levene": None if self.levene is None else self.levene.to_json(),
            },
            "effects": [plain(effect) for effect in self.effects],
            "shares": plain(self.shares),
            "distinct_computations": self.distinct,
            "copies": plain(self.copies),
            "lenth": None if self.lenth is None else self.lenth.to_json(),
            "sphericity": plain(self.sphericity),
            "non_additivity": plain(self.non_additivity),
            "summary": plain(self.summary),
            "influence": plain(self.influence),
            "robustness": plain(self.robustness),
            "box_cox": plain(self.box_cox),
            "failure_bounds": plain(self.bounds),
            "nested": plain(self.nested),
            "power": plain(self.power),
            "warnings": list(self.warnings),
        }

    def verdicts(self) -> list[dict[str, Any]]:
        """One line a factor or interaction, as ``study run --json`` lists them."""
        return [
            {
                "response": self.response,
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
            }
            for effect in self.effects
        ]
