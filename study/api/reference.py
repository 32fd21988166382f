"""Every level of a factor against a reference level, from the rows of an analysis."""

from __future__ import annotations

from study.analysis.effects.blocked_dunnett import blocked_dunnett
from study.analysis.effects.comparisons import Comparisons, dunnett
from study.analysis.result import AnalysisResult
from study.errors import Fault, InputError, nearest


def against_reference(found: AnalysisResult, level: str) -> tuple[str, Comparisons]:
    """Compare all levels of a factor with one of them (Dunnett 1955).

    Parameters
    ----------
    found : AnalysisResult
        Its rows give the means: those of each block where there are blocks.
    level : str
        Reference, ``"level"`` or ``"factor=level"`` where several factors have it.

    Returns
    -------
    factor : str
    comparisons : Comparisons
        Differences from the reference with simultaneous intervals.

    Raises
    ------
    InputError
        If no factor, or more than one, has this level.
    """
    named, _, wanted = level.rpartition("=")
    levels = {e.term: e.levels for e in found.effects if e.term in found.factors}
    holding = [f for f, own in levels.items() if wanted in own and named in ("", f)]
    if len(holding) != 1:
        every = [name for own in levels.values() for name in own]
        rule = "is a level of several factors" if holding else "is no level of a factor"
        mend = f"write {holding[0]}={wanted}" if holding else nearest(wanted, every)
        raise InputError(Fault("--reference", f"{wanted!r} {rule}", mend))
    factor = holding[0]
    rows = found.residuals
    if found.block is None:
        groups = {str(k): g["response"].to_numpy() for k, g in rows.groupby(factor, sort=False)}
        return factor, dunnett(groups, wanted, alpha=found.alpha, seed=found.seed)
    means = rows.groupby(["block", factor], sort=False)["response"].mean().unstack().dropna()
    by_level = {str(name): means[name].to_numpy() for name in means.columns}
    return factor, blocked_dunnett(by_level, wanted, alpha=found.alpha, seed=found.seed)
