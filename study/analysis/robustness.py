"""Whether the conclusion changes over the defensible analyses of the same data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from study.analysis.blocks import OwnTerm, cell_fit, own_terms
from study.analysis.copies import ulp_floor
from study.analysis.matrix import Array, Layout, Term, model_matrix, term_name
from study.analysis.outcome import Outcome
from study.analysis.remedies import Sensitivity, box_cox, sensitivity_of, side_by_side
from study.analysis.sums import factor, term_sums

# Welch-James inverts matrices of the number of cells; beyond this it is no small table
_MOST_CELLS = 600


def add_robustness(out: Outcome) -> Outcome:
    """Outcome with Box-Cox and the table of defensible analyses, where there is an error."""
    if out.fit is None or out.plots is not None or out.data.also:
        return out
    if out.crossed is not None:
        return replace(out, robustness=_blocked(out))
    if out.data.block is not None or out.replicates != "runs" or out.error.source != "E0":
        return out
    if np.unique(out.data.cell).size > _MOST_CELLS or out.fit.rss <= 0:
        return out
    fit = out.fit if out.transform == "none" else factor(out.fit.matrix, out.data.y)
    table = sensitivity_of(out.data, out.terms, fit, out.alpha)
    if out.data.y.min() <= 0:
        return replace(out, robustness=table)
    return replace(out, robustness=table, box_cox=box_cox(out.data.y, out.fit.matrix.columns))


def _blocked(out: Outcome) -> Sensitivity | None:
    """Own interactions (three corrections), interactions pooled, and the log of the response."""
    table, kind = out.crossed, out.anova.type
    tests = _tests(out, table.y, kind)
    found: dict[str, Mapping[str, float | None]] = {
        "own interaction, Greenhouse-Geisser": _p(tests, "gg"),
        "own interaction, Huynh-Feldt": _p(tests, "hf"),
        "interactions pooled": _additive(table.layout, out.terms, table.y, kind),
    }
    if out.transform == "none" and table.y.min() > 0:
        logged = _tests(out, np.log(table.y), kind)
        found["own interaction of the log"] = _p(logged, "gg")
    return side_by_side([term_name(t) for t in out.terms], found, out.alpha)


def _tests(out: Outcome, y: Array, kind: str) -> list[OwnTerm]:
    table = replace(out.crossed, y=y)
    floor = max(out.working_tolerance(), ulp_floor(y))
    total = float(np.sum((y - y[0, 0] - (y - y[0, 0]).mean()) ** 2))
    return own_terms(table, cell_fit(table, out.terms), kind, str(out.data.block), floor, total)


def _p(tests: Sequence[OwnTerm], how: str) -> dict[str, float | None]:
    from scipy.special import fdtrc

    found: dict[str, float | None] = {}
    for test in tests:
        row = test.row
        found[row.term] = row.p_gg
        if how == "hf" and row.f is not None and row.df_error is not None:
            epsilon = max(test.sphericity.epsilon_hf, test.sphericity.epsilon_gg)
            found[row.term] = float(fdtrc(row.df * epsilon, row.df_error * epsilon, row.f))
    return found


def _additive(
    layout: Layout, terms: Sequence[Term], y: Array, kind: str
) -> dict[str, float | None]:
    """P of every term against all interactions with the blocks pooled."""
    from scipy.special import fdtrc

    cells, blocks = y.shape
    y = y - y[0, 0]
    fit = factor(model_matrix(layout, terms), y.mean(axis=1))
    centered = y - y.mean(axis=1, keepdims=True) - y.mean(axis=0) + y.mean()
    df = (cells - 1) * (blocks - 1)
    mse = float(np.sum(centered**2)) / df
    found: dict[str, float | None] = {}
    for s in term_sums(fit, kind):
        usable = s.df > 0 and mse > 0
        f = blocks * s.ss / s.df / mse if usable else 0.0
        found[term_name(s.term)] = float(fdtrc(s.df, df, f)) if usable else None
    return found
