"""Differences of two settings that an analyst names, of a finished analysis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pandas as pd

from study.analysis.effects import linear_contrast
from study.analysis.effects.linear_contrast import Cells, Contrast
from study.analysis.effects.scale import Scale
from study.analysis.error.incomplete_blocks import mixed_cells
from study.analysis.linear_model.design_matrix import Layout
from study.analysis.result import AnalysisResult


def contrasts(found: AnalysisResult, asked: str | Sequence[str]) -> tuple[Contrast, ...]:
    """Estimate differences of sets of cells that the analyst names.

    Parameters
    ----------
    found : AnalysisResult
        Of :func:`analyze` or :func:`study.anova`.
    asked : str or sequence of str
        Such as ``"material=stiff, range=60 % - material=soft, range=60 %"``; a factor that a
        side leaves out is averaged over.

    Returns
    -------
    tuple of Contrast
        Difference, its interval alone and with all others together, p, Holm's p, U, verdict.

    Raises
    ------
    InputError
        For a factor or level that does not exist, or a setting without a row.
    """
    asked = [asked] if isinstance(asked, str) else list(asked)
    return linear_contrast.contrasts(_cells(found), asked)


def _cells(found: AnalysisResult) -> Cells:
    """Rows of an analysis on its scale, with what matters."""
    request, rows = found.request, found.data.residuals
    values = rows["response"].to_numpy(dtype=float)
    log, mean = request.scale.is_log, found.data.grand_mean
    limit, unit = request.scale.practical, 1 / mean if log else 1.0
    practical = None if limit is None else limit.on_scale(mean, request.scale.transform)
    bound = request.scale.bound([e.term for e in found.effects], unit)
    # blocks are specimens where they are no seeds of a mesh and no refits to resampled noise
    resampled = found.error_term.source == "E2"
    specimens = request.specimens
    if specimens is None and "block" in rows and found.error_term.source not in ("E2", "E3"):
        specimens = rows["block"].nunique()
    scale = Scale(request.scale.transform, practical, bound, False, unit, specimens)
    levels = {e.term: e.levels for e in found.effects if e.is_main}
    table = rows.assign(y=np.log(values) if log else values)
    cells = Cells(table, levels, scale, request.alpha, request.seed, resampled)
    if all(row.error != "REML" for row in found.anova.rows):
        return cells
    of_all = {**levels, "block": tuple(dict.fromkeys(table["block"]))}
    codes = {name: pd.Categorical(table[name], of_all[name]).codes.astype(np.int64)
             for name in of_all}  # fmt: skip
    terms = [tuple(e.term.split(":")) for e in found.effects]
    model, _ = mixed_cells(
        Layout(of_all, codes), terms, "block", table["y"].to_numpy(), request.alpha, request.seed
    )
    return cells if model is None else replace(cells, estimate=model.between)


def with_contrasts(found: AnalysisResult, asked: Sequence[str]) -> AnalysisResult:
    """Give a result the differences that its design declares.

    Parameters
    ----------
    found : AnalysisResult
        Of one response.
    asked : sequence of str
        As for :func:`contrasts`.

    Returns
    -------
    AnalysisResult
        With those that can be estimated; a note says why another one cannot.
    """
    if not asked:
        return found
    together, faults = linear_contrast.possible_contrasts(_cells(found), asked)
    notes = [f"{fault.where}: {fault.rule}" for fault in faults]
    return replace(found, contrasts=together).noted(*notes)
