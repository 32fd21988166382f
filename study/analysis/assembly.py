"""What an analysis found becomes its result, with every check beside it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.anova_table import (
    Effect,
)
from study.analysis.assumption.diagnostics import diagnose, is_representative
from study.analysis.assumption.tests import assumptions_of
from study.analysis.effects.numerical_bound import OneBound
from study.analysis.effects.power.detection import PowerRow, planned
from study.analysis.effects.sizes import holm
from study.analysis.linear_model.design_matrix import terms_of
from study.analysis.linear_model.influence import influence
from study.analysis.outcome import _NO_ERROR, Outcome
from study.analysis.result import AnalysisResult, DataSummary, Detection, Variation
from study.analysis.unreplicated import functional_shares

if TYPE_CHECKING:
    import pandas as pd

    from study.arrays import Array


def assemble(out: Outcome) -> AnalysisResult:
    """Check assumptions and freeze the result.

    Parameters
    ----------
    out : Outcome
        With its error term, table and effects found.

    Returns
    -------
    AnalysisResult
        With Holm's p beside the raw ones, and every warning once.
    """
    found = diagnose(out)
    out = out.warn(*found.warnings, *_inestimable(out.effects))
    fit = out.fit if out.fit is not None and out.fit.df_residual > 0 else None
    groups_of = out.copies.groups
    if len(groups_of) < sum(len(g) for g in groups_of) and out.error is not _NO_ERROR:
        out = out.warn(_copies_sentence(out))
    return AnalysisResult(
        out.request,
        out.error,
        out.anova,
        _variation(out),
        holm(out.effects),
        Detection(
            _back(out, out.scale.practical),
            out.u_raw,
            out.scale.bound is not None and not isinstance(out.scale.bound, OneBound),
            _power(out),
        ),
        assumptions_of(out, found),
        _summary_of_data(out, None if fit is None else fit.columns),
        tuple(dict.fromkeys(out.warnings)),
    )


def _variation(out: Outcome) -> Variation:
    return Variation(_shares(out), out.lenth, out.summary)


def _summary_of_data(out: Outcome, model_matrix: Array | None) -> DataSummary:
    names = out.data.cell_names()
    return DataSummary(
        int(out.data.y.size),
        out.data.block,
        _grand_mean(out),
        _cell_means(out),
        _residual_frame(out),
        tuple(names[c] for c in out.copies.representatives),
        len(out.copies.groups),
        tuple(tuple(names[c] for c in g) for g in out.copies.groups if len(g) > 1),
        model_matrix,
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
    blocks = None if out.crossed is None else len(out.crossed.blocks)
    replicated = out.error.source in ("E0", "E3") and bool(cells.min() >= 2)
    if blocks is None and not replicated:
        return {}
    n = round(float(cells.mean())) if blocks is None else blocks
    names = [f for f in out.data.factors if (f,) in out.terms]
    terms = {f: (out.anova.row(f), len(out.data.layout.levels[f])) for f in names}
    asked, blocked = out.request, blocks is not None
    ratio = asked.scale.is_log
    return planned(terms, n, cells.size, blocked=blocked, alpha=asked.alpha, ratio=ratio)


def _copies_sentence(out: Outcome) -> str:
    total = sum(len(group) for group in out.copies.groups)
    return (
        f"{total} cells hold {len(out.copies.groups)} distinct computations (the others agree "
        "in every block); checks of the residuals use one of each"
    )


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
    order = np.argsort(data.cell, kind="stable")
    cells, start = np.unique(data.cell[order], return_index=True)
    for cell, here in zip(cells, np.split(order, start[1:]), strict=True):
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
