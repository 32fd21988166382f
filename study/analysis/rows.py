"""Rows of an ANOVA table: type of the sums, F, sizes, and what could not be estimated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from study.analysis.checks import eta_interval
from study.analysis.matrix import term_name
from study.analysis.outcome import Outcome
from study.analysis.remedies import influence
from study.analysis.results import ModelSummary, Row
from study.analysis.sums import Factored, TermSum

# a residual this small beside the total is rounding, no error term
_ROUNDING = 1e-28


def kind_of(out: Outcome, kind: str, even: bool, why: str = "unbalanced") -> tuple[str, Outcome]:
    """Type of the sums; unbalanced data take Type III with sum contrasts, and say so."""
    if even:
        return ("II" if kind == "auto" else kind), out
    if kind == "auto" or (out.records and kind == "II"):
        return "III", out.warn(f"{why}: Type III with sum-to-zero contrasts")
    return kind, out.warn(f"{why}: Type {kind} as asked")


def orthogonal(fit: Factored) -> bool:
    """Whether the terms span orthogonal spaces, so that all types of sums agree."""
    gram = fit.r.T @ fit.r
    for block in fit.matrix.blocks:
        gram[block, block] = 0.0
    return bool(np.abs(gram).max() < 1e-9)


def term_row(s: TermSum, df: int, rss: float, total: float, error: str = "residual") -> Row:
    """One line: a term against an error of ``df`` degrees of freedom and sum ``rss``."""
    from scipy.special import fdtrc

    name = term_name(s.term)
    if s.df == 0:
        return Row(name, 0, 0.0)
    ms = s.ss / s.df
    if df == 0 or rss <= _ROUNDING * max(total, s.ss):
        return Row(name, s.df, s.ss, ms)
    if s.df < s.nominal_df:
        return Row(name, s.df, s.ss, ms, error=error, df_error=df)
    mse = rss / df
    f = ms / mse
    return Row(
        name,
        s.df,
        s.ss,
        ms,
        f,
        float(fdtrc(s.df, df, f)),
        error,
        df,
        None,
        None,
        max(0.0, (s.ss - s.df * mse) / (total + mse)),
        s.ss / (s.ss + rss),
    )


def with_shares(rows: Sequence[Row], total: float) -> tuple[Row, ...]:
    """Rows with their share of the variation and the interval of partial eta squared."""
    done = []
    for row in rows:
        share = row.ss / total if total > 0 else None
        done.append(replace(row, share=share, partial_eta_sq_ci95=eta_interval(row)))
    return tuple(done)


def alias_warnings(sums: Sequence[TermSum]) -> list[str]:
    """One sentence for every term that lost degrees of freedom, with what it is aliased."""
    out = []
    for s in sums:
        if s.df < s.nominal_df:
            partly = f" (aliased with {', '.join(s.aliases)})" if s.aliases else ""
            out.append(
                f"{term_name(s.term)}: {s.nominal_df - s.df} of {s.nominal_df} degrees of "
                f"freedom are not estimable{partly}: empty cells or a confounded design; no test"
            )
    return out


def summary_of(fit: Factored) -> ModelSummary | None:
    """S, R-sq, R-sq(adj) and R-sq(pred) of a fit; None where nothing is left to judge by.

    R-sq(pred) is 1 - PRESS / total (Allen 1974); it needs every row to be predictable from
    the others.
    """
    df, n = fit.df_residual, fit.q.shape[0]
    if df == 0 or fit.tss <= 0:
        return None
    predictable = float(fit.leverage.max()) < 1 - 1e-10
    press = float(np.sum(influence(fit).press ** 2)) if predictable else None
    return ModelSummary(
        float(np.sqrt(fit.rss / df)),
        1 - fit.rss / fit.tss,
        1 - fit.rss / df / (fit.tss / (n - 1)),
        None if press is None else 1 - press / fit.tss,
    )
