"""Levels of a factor compared with one of them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from study.analysis.effects.blocked_dunnett import blocked_dunnett
from study.analysis.effects.comparisons import Comparisons, dunnett
from study.analysis.post_hoc.dunnett import dunnett_of_model
from study.errors import Fault, InputError, nearest

if TYPE_CHECKING:
    from study.analysis.result import AnalysisResult


def against_reference(found: AnalysisResult, level: str) -> tuple[str, Comparisons]:
    """Compare all levels of a factor with one of them (Dunnett 1955).

    Parameters
    ----------
    found : AnalysisResult
        One pooled error is that of the fitted model; else the rows give the means of each block.
    level : str
        Reference, ``"level"`` or ``"factor=level"`` where several factors have it.

    Returns
    -------
    factor : str
    comparisons : Comparisons
        Differences from the reference with simultaneous intervals; ratios of a log response.

    Raises
    ------
    InputError
        If no factor, or more than one, has this level.
    """
    named, _, wanted = level.rpartition("=")
    levels = {e.term: e.levels for e in found.effects if e.term in found.request.factors}
    holding = [f for f, own in levels.items() if wanted in own and named in ("", f)]
    if len(holding) != 1:
        every = [name for own in levels.values() for name in own]
        rule = "is a level of several factors" if holding else "is no level of a factor"
        mend = f"write {holding[0]}={wanted}" if holding else nearest(wanted, every)
        raise InputError(Fault("--reference", f"{wanted!r} {rule}", mend))
    factor = holding[0]
    effect, row = found.effect(factor), found.anova.row(factor)
    alpha, seed = found.request.alpha, found.request.seed
    if row.error == "residual" and row.df_error and effect.pairs:
        return factor, dunnett_of_model(effect, wanted, row.df_error, alpha, seed)
    compared = _of_rows(found, factor, wanted)
    return factor, compared.as_ratios() if found.request.scale.is_log else compared


def _of_rows(found: AnalysisResult, factor: str, reference: str) -> Comparisons:
    """Compare levels by their rows, or by their means in each block, on the analyzed scale."""
    alpha, seed = found.request.alpha, found.request.seed
    rows = found.data.residuals
    if found.request.scale.is_log:
        rows = rows.assign(response=np.log(rows["response"]))
    if found.data.block is None:
        groups = {str(k): g["response"].to_numpy() for k, g in rows.groupby(factor, sort=False)}
        return dunnett(groups, reference, alpha=alpha, seed=seed)
    means = rows.pivot_table("response", "block", factor, sort=False).dropna()
    by_level = {str(name): means[name].to_numpy() for name in means.columns}
    return blocked_dunnett(by_level, reference, alpha=alpha, seed=seed)
