"""What an analysis has found so far, and how it becomes the frozen result."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis import checks
from study.analysis.copies import CopyGroups
from study.analysis.effects import Scale
from study.analysis.matrix import Array, Codes, Term, terms_of
from study.analysis.normality import anderson_darling, ryan_joiner, shapiro_wilk
from study.analysis.power import PowerRow, planned
from study.analysis.remedies import BoxCoxResult, Sensitivity, influence, influential
from study.analysis.results import AnalysisResult, Anova, Effect, ErrorTerm, ModelSummary
from study.analysis.sphericity import SphericityResult
from study.analysis.sums import Factored
from study.analysis.tidy import Data
from study.analysis.unreplicated import LenthResult, functional_shares, non_additivity
from study.analysis.variance import (
    BartlettResult,
    LeveneResult,
    ResidualDesign,
    bartlett,
    levene,
)

if TYPE_CHECKING:
    import pandas as pd

_NO_ERROR = ErrorTerm("E7", "no p: nothing varies", 0.0, "constant response")
_MONTE_CARLO = 10_000


@dataclass(frozen=True)
class Outcome:
    """Inputs and findings of one analysis; grows by ``replace``.

    ``u_raw`` is the largest numerical uncertainty of an effect, ``u_cells`` that within which
    two cells are one computation, both in the unit of the response.
    """

    data: Data
    response: str
    terms: tuple[Term, ...]
    transform: str
    alpha: float
    seed: int
    exact: bool
    tolerance: float
    u_raw: float | None
    records: bool
    u_cells: float | None = None
    y: Array = field(default_factory=lambda: np.zeros(0))
    scale: Scale = field(default_factory=lambda: Scale("none", None, None, None, False))
    warnings: tuple[str, ...] = ()
    copies: CopyGroups = field(default_factory=lambda: CopyGroups(()))
    error: ErrorTerm = _NO_ERROR
    anova: Anova = field(default_factory=lambda: Anova("II", ()))
    effects: tuple[Effect, ...] = ()
    sphericity: dict[str, SphericityResult] = field(default_factory=dict)
    fit: Factored | None = None
    lenth: LenthResult | None = None
    crossed: Any = None
    plots: Codes | None = None
    replicates: str = "runs"
    summary: ModelSummary | None = None
    robustness: Sensitivity | None = None
    box_cox: BoxCoxResult | None = None

    def warn(self, *messages: str) -> Outcome:
        """Copy with more warnings."""
        return replace(self, warnings=(*self.warnings, *messages))

    def working_tolerance(self) -> float:
        """Ten solver tolerances on the working scale."""
        if self.transform == "log":
            return 10 * self.tolerance / float(np.abs(self.data.y).min())
        return 10 * self.tolerance

    def constant(self) -> Outcome:
        """Outcome of a response that does not vary."""
        message = (
            f"{self.response} is constant ({self.data.y[0]:.6g} in all {self.data.y.size} rows, "
            "to rounding or solver tolerance): no ANOVA"
        )
        cells = tuple(int(c) for c in np.unique(self.data.cell))
        return replace(
            self,
            y=self.data.y,
            copies=CopyGroups((cells,)),
            warnings=(*self.data.warnings, message),
        )


def assemble(out: Outcome) -> AnalysisResult:
    """Check assumptions and freeze the result."""
    names = out.data.cell_names()
    out, normality, groups = _checks(out)
    equal, spread = _spread_tests(out, groups)
    out = out.warn(*_inapplicable(bartlett=equal, levene=spread), *_inestimable(out.effects))
    fit = out.fit if out.fit is not None and out.fit.df_residual > 0 else None
    residual = None if fit is None else fit.residual
    groups_of = out.copies.groups
    if len(groups_of) < sum(len(g) for g in groups_of) and out.error is not _NO_ERROR:
        out = out.warn(_copies_sentence(out))
    return AnalysisResult(
        out.response,
        out.data.factors,
        out.data.block,
        out.transform,
        out.alpha,
        out.seed,
        out.error,
        out.anova,
        normality,
        equal,
        spread,
        out.effects,
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
        u_num_by_term=out.scale.by_term is not None,
    )


def _inapplicable(**tests: BartlettResult | LeveneResult | None) -> list[str]:
    return [
        f"{name}: not applicable: {test.reason}"
        for name, test in tests.items()
        if test is not None and test.reason
    ]


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


def _spread_tests(
    out: Outcome, groups: checks.CellGroups | None
) -> tuple[BartlettResult | None, LeveneResult | None]:
    if groups is None:
        return None, None
    # residuals of a blocked fit are correlated: their own design is simulated
    design = None if groups.basis is None else ResidualDesign(groups.basis, groups.index)
    count = _MONTE_CARLO if out.exact else 0
    options: dict[str, Any] = {
        "approximate": groups.approximate,
        "seed": out.seed,
        "design": design,
    }
    return (
        bartlett(groups.groups, simulations=count, **options),
        levene(groups.groups, simulations=count if design else 0, **options),
    )


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
    ratio = out.transform == "log"
    return planned(terms, n, cells.size, blocked=blocked, alpha=out.alpha, ratio=ratio)


def _copies_sentence(out: Outcome) -> str:
    total = sum(len(group) for group in out.copies.groups)
    return (
        f"{total} cells hold {len(out.copies.groups)} distinct computations (the others agree "
        "in every block); checks of the residuals use one of each"
    )


def _representative(out: Outcome) -> Any:
    return np.isin(out.data.cell, out.copies.representatives)


def _checks(out: Outcome) -> tuple[Outcome, Any, checks.CellGroups | None]:
    """Ryan-Joiner on one representative of each computation, and the groups for Bartlett."""
    rows = np.flatnonzero(_representative(out))
    if out.fit is None or out.fit.df_residual == 0:
        reason = "there are no residuals"
        return (
            out.warn(f"normality: not applicable: {reason}", f"variance: not applicable: {reason}"),
            None,
            None,
        )
    if out.data.block is not None:
        fit = checks.additive_fit(out.data, out.y, rows, plots=out.plots)
    elif rows.size == out.y.size:
        fit = out.fit
    else:
        fit = checks.reduced_fit(out.data, out.y, out.terms, rows)
    result = ryan_joiner(
        fit.residual,
        model_matrix=fit.matrix.columns,
        seed=out.seed,
        exact=out.exact,
        alpha=out.alpha,
    )
    if not result.applicable:
        out = out.warn(f"normality: not applicable: {result.reason}")
    if result.warning:
        out = out.warn(result.warning)
    values = out.y[rows] if out.data.block is None else fit.residual
    cells, names = out.data.cell[rows], out.data.cell_names()
    present, index = np.unique(cells, return_inverse=True)
    groups = {names[c]: values[index == i] for i, c in enumerate(present)}
    basis = None if out.data.block is None else fit.q
    return out, result, checks.CellGroups(groups, basis is not None, basis, index)


def _back(out: Outcome, value: float | None) -> float | None:
    if value is None or out.transform == "none":
        return value
    return float(np.exp(value))


def _grand_mean(out: Outcome) -> float:
    mean = out.y[0] + float(np.mean(out.y - out.y[0]))
    return float(np.exp(mean)) if out.transform == "log" else float(mean)


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
        if out.transform == "log":
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
        "representative": _representative(out),
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
