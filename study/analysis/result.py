"""The result of an analysis, assembled with every check beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis.anova_table import (
    Anova,
    Effect,
    ErrorTerm,
    FailureBound,
    Influential,
    ModelSummary,
)
from study.analysis.assumption.diagnostics import diagnose, is_representative
from study.analysis.assumption.normality import anderson_darling, shapiro_wilk
from study.analysis.effects.numerical_bound import OneBound
from study.analysis.effects.power import PowerRow, planned
from study.analysis.effects.sizes import holm
from study.analysis.linear_model.design_matrix import terms_of
from study.analysis.linear_model.influence import influence, influential
from study.analysis.outcome import _NO_ERROR, Outcome
from study.analysis.unreplicated import functional_shares, non_additivity
from study.canonical import plain

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.anova_table import BoxCoxResult, NestedUnits, Sensitivity
    from study.analysis.assumption.normality import NormalityResult, RyanJoinerResult
    from study.analysis.assumption.row_normality import RowTest
    from study.analysis.assumption.variance import BartlettResult, LeveneResult
    from study.analysis.sphericity import SphericityResult
    from study.analysis.unreplicated import LenthResult, NonAdditivityResult
    from study.arrays import Array


def assemble(out: Outcome) -> AnalysisResult:
    """Check assumptions and freeze the result."""
    names = out.data.cell_names()
    found = diagnose(out)
    out = out.warn(*found.warnings, *_inestimable(out.effects))
    fit = out.fit if out.fit is not None and out.fit.df_residual > 0 else None
    residual = None if fit is None else fit.residual
    groups_of = out.copies.groups
    if len(groups_of) < sum(len(g) for g in groups_of) and out.error is not _NO_ERROR:
        out = out.warn(_copies_sentence(out))
    return AnalysisResult(
        out.request.response,
        out.data.factors,
        out.data.block,
        out.request.scale.transform,
        out.request.alpha,
        out.request.seed,
        out.error,
        out.anova,
        found.normality,
        found.bartlett,
        found.levene,
        holm(out.effects),
        tuple(dict.fromkeys(out.warnings)),
        _cell_means(out),
        _residual_frame(out),
        _shares(out),
        tuple(names[c] for c in out.copies.representatives),
        len(groups_of),
        tuple(tuple(names[c] for c in g) for g in groups_of if len(g) > 1),
        _grand_mean(out),
        _back(out, out.scale.practical),
        out.u_raw,
        out.lenth,
        out.sphericity,
        None if fit is None else non_additivity(fit),
        None if residual is None else anderson_darling(residual),
        None if residual is None else shapiro_wilk(residual),
        None if fit is None else fit.matrix.columns,
        int(out.data.y.size),
        out.summary,
        None if fit is None else influential(fit),
        out.robustness,
        out.box_cox,
        power=_power(out),
        normality_rows=found.rows,
        u_num_by_term=out.scale.bound is not None and not isinstance(out.scale.bound, OneBound),
    )


def _inestimable(effects: Sequence[Effect]) -> list[str]:
    """One sentence for every term some of whose means cannot be estimated."""
    found = []
    for effect in effects:
        lost = [
            level for level, mean in zip(effect.levels, effect.mean, strict=True) if mean is None
        ]
        if lost:
            more = f" and {len(lost) - 5} more" if len(lost) > 5 else ""
            found.append(f"{effect.term}: the mean is not estimable at {', '.join(lost[:5])}{more}")
    return found


def _power(out: Outcome) -> dict[str, tuple[PowerRow, ...]]:
    """Tell what other numbers of blocks or replicates would find, by factor."""
    counts = np.bincount(out.data.cell)
    cells = counts[counts > 0]
    if out.replicates == "noise":
        return {}  # more resamples show no smaller effect: the noise of the curve is what it is
    blocked = out.crossed is not None
    replicated = out.error.source in ("E0", "E3") and bool(cells.min() >= 2)
    if not blocked and not replicated:
        return {}
    n = len(out.crossed.blocks) if blocked else round(float(cells.mean()))
    names = [f for f in out.data.factors if (f,) in out.terms]
    terms = {f: (out.anova.row(f), len(out.data.layout.levels[f])) for f in names}
    ratio = out.request.scale.is_log
    return planned(terms, n, cells.size, blocked=blocked, alpha=out.request.alpha, ratio=ratio)


def _copies_sentence(out: Outcome) -> str:
    total = sum(len(group) for group in out.copies.groups)
    return (
        f"{total} cells hold {len(out.copies.groups)} distinct computations (the others agree "
        "in every block); checks of the residuals use one of each"
    )


def _representative(out: Outcome) -> Any:
    return np.isin(out.data.cell, out.copies.representatives)


def _back(out: Outcome, value: float | None) -> float | None:
    if value is None or not out.request.scale.is_log:
        return value
    return float(np.exp(value))


def _grand_mean(out: Outcome) -> float:
    mean = out.y[0] + float(np.mean(out.y - out.y[0]))
    return float(np.exp(mean)) if out.request.scale.is_log else float(mean)


def _shares(out: Outcome) -> dict[str, float]:
    """Functional-ANOVA shares of the cell means, where every cell exists."""
    data = out.data
    if out.error is _NO_ERROR:
        return {}
    size = int(np.prod([len(data.layout.levels[f]) for f in data.factors]))
    counts = np.bincount(data.cell, minlength=size)
    if counts.min() == 0:
        return {}
    shift = out.y[0]
    means = np.bincount(data.cell, weights=out.y - shift, minlength=size) / counts + shift
    return functional_shares(data.layout, data.factors, means, terms_of(data.factors))


def _cell_means(out: Outcome) -> pd.DataFrame:
    """One row a cell: levels, n, mean and sd of the response."""
    import pandas as pd

    data = out.data
    rows = []
    groups = {c: g for g in out.copies.groups for c in g}
    for cell in np.unique(data.cell):
        here = np.flatnonzero(data.cell == cell)
        values = data.y[here]
        levels = {f: data.layout.levels[f][data.layout.codes[f][here[0]]] for f in data.factors}
        mean = values[0] + float(np.mean(values - values[0]))
        if out.request.scale.is_log:
            mean = float(np.exp(np.mean(np.log(values))))
        sd = float(np.std(values - values[0], ddof=1)) if values.size > 1 else None
        same = groups.get(int(cell), (int(cell),))
        rows.append(
            {
                **levels,
                "n": values.size,
                "mean": mean,
                "sd": sd,
                "representative": same[0] == int(cell),
            }
        )
    return pd.DataFrame(rows)


def _residual_frame(out: Outcome) -> pd.DataFrame:
    """One row a run: fitted, residual, cell, block, and whether it represents its copies."""
    import pandas as pd

    data = out.data
    names = data.cell_names()
    frame = {
        "row": data.rows,
        "cell": [names[c] for c in data.cell],
        "representative": is_representative(out),
        "response": data.y,
    }
    if data.block is not None:
        labels = data.layout.levels[data.block]
        frame["block"] = [labels[c] for c in data.layout.codes[data.block]]
    if out.fit is not None:
        frame["fitted"], frame["residual"] = out.fit.fitted, out.fit.residual
        found = influence(out.fit)
        frame["leverage"], frame["cook"] = found.leverage, found.cook
    for f in data.factors:
        if f not in frame:
            frame[f] = [data.layout.levels[f][c] for c in data.layout.codes[f]]
    return pd.DataFrame(frame)


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
    normality_rows: tuple[RowTest, ...] = ()

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
            "normality_rows": plain(self.normality_rows),
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
                "U": plain(effect.u_num),
                "U_needed": plain(effect.u_needed),
                "p_holm": plain(effect.p_holm),
                "simple_effects": plain(effect.simple_effects),
            }
            for effect in self.effects
        ]
