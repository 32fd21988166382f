"""Which rows of a study answer for one response, where its cells are computed several times."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from study.design.replicates import is_constant

if TYPE_CHECKING:
    import pandas as pd

#: spread over the meshes of a cell, over the response, below which the mesh does not enter
_SAME = 1e-12
_NOISE, _MESH = "noise_seed", "mesh_seed"


@dataclass(frozen=True)
class Rows:
    """Rows to analyze, and what they are.

    Parameters
    ----------
    table : DataFrame
        One row a run.
    block : str or None
        Column of the blocks.
    options : dict
        Options of the analysis that follow from the replicates.
    notes : tuple of str
        What was left out and why.
    """

    table: pd.DataFrame
    block: str | None
    options: dict[str, Any] = field(default_factory=dict)
    notes: tuple[str, ...] = ()


def rows_for(
    table: pd.DataFrame, response: str, factors: Sequence[str], error: str, block: str | None
) -> Rows:
    """Rows of a study's table for one response.

    Parameters
    ----------
    table : DataFrame
        Of :func:`study.record.table`.
    factors : sequence of str
        All factors of the study.
    error : str
        As the design asks; with ``"replicates"`` they are taken even where there are blocks,
        over which the response is then averaged.
    block : str or None
        Column of the blocks; None where there are none.
    """
    asked = error == "replicates"
    options = {"error": "auto" if asked else error}
    if _NOISE in table:
        return _noise_rows(table, response, factors, asked, block, options)
    if _MESH not in table:
        return Rows(table, block, options)
    cells = [*factors, *([block] if block else [])]
    if not _spread(table, response, cells):
        first = table[table[_MESH] == table[_MESH].min()].drop(columns=_MESH)
        note = f"the mesh does not enter {response}: it is the same on every mesh, no E3"
        return Rows(first, block, options, (note,))
    if block and asked:
        return Rows(_over(table, response, [*factors, _MESH]), None, options)
    return Rows(table, block, options)


def _noise_rows(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    asked: bool,
    block: str | None,
    options: dict[str, Any],
) -> Rows:
    fits = table[table[_NOISE] == 0].drop(columns=_NOISE)
    if not is_constant(response):
        note = f"resampled noise is fitted, not predicted with: no E2 for {response}"
        return Rows(fits, block, options, (note,))
    if block and not asked:
        note = (
            "several blocks are a better error term than resampled noise (E1 before E2): the fits "
            'to the measured curves are analyzed; [analysis] error = "replicates" asks for E2'
        )
        return Rows(fits, block, options, (note,))
    again = table[table[_NOISE] > 0]
    if block:
        again = _over(again, response, [*factors, _NOISE])
    # pooled takes cells for independent, and has no resample in common
    common = None if options["error"] == "pooled" else _NOISE
    return Rows(again, common, {**options, "replicates": "noise"})


def _spread(table: pd.DataFrame, response: str, cells: list[str]) -> bool:
    """Whether the response differs between the rows of some cell."""
    groups = table.groupby(cells, sort=False, dropna=False)[response]
    widest = (groups.max() - groups.min()).max()
    return bool(widest > _SAME * table[response].abs().max())


def _over(table: pd.DataFrame, response: str, keys: list[str]) -> pd.DataFrame:
    """Mean of the response over the blocks; missing where one of them is."""
    groups = table.groupby(keys, sort=False)[response]
    return groups.agg(lambda values: values.mean(skipna=False)).reset_index()
