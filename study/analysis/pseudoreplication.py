"""Copies that pose as replicates (refused) and cells that are one computation (grouped)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from study.arrays import Array, Ints
from study.errors import RefusedError

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.data import Data

_ULPS = 16
_INSTEAD = (
    "A deterministic run repeated is the same run: it has no pure error, and a test against it "
    "would call everything significant. Instead: keep one run a cell and read the shares and "
    "effects (error source E7); or name measured specimens as blocks (--block, E1); or repeat "
    "with new meshes or new measured noise (E3, E2); or give the numerical uncertainty (E4)."
)

_LIKE_BLOCKS = (
    "in each cell every level of {!r} gives the same value, so nothing tells how much results "
    "vary from one to the next. Measurements that are copies or multiples of one another do that: "
    "keep one of them, and read the differences between cells beside their numerical uncertainty."
)


@dataclass(frozen=True)
class CopyGroups:
    """Cells that agree in every block, one representative first."""

    groups: tuple[tuple[int, ...], ...]

    @property
    def representatives(self) -> tuple[int, ...]:
        """First cell of each group."""
        return tuple(group[0] for group in self.groups)


def ulp_floor(y: Array) -> float:
    """Spread below which doubles of this size are equal: 16 units in the last place.

    Parameters
    ----------
    y : ndarray
        Values of any shape; the largest in size counts, and the spread is in their unit.
    """
    return _ULPS * float(np.spacing(np.abs(y).max()))


def refuse_fake_replicates(
    data: Data, table: pd.DataFrame, *, records: bool, tolerance: float
) -> list[str]:
    """Refuse copies that pose as replicates; ties in some cells are only noted.

    Parameters
    ----------
    data : Data
        Checked rows.
    table : DataFrame
        The table they came from; a column ``input_hash`` identifies runs of a study.
    records : bool
        Whether the rows are a study's records.
    tolerance : float
        Solver tolerance in the unit of the response.

    Raises
    ------
    RefusedError
        If the replicates are copies.
    """
    unit = data.cell if data.block is None else data.layout.cell([*data.factors, data.block])
    floor = max(10 * tolerance if records else 0.0, ulp_floor(data.y))
    if records and "input_hash" in table.columns:
        hashes = table["input_hash"].to_numpy(dtype=object)[data.rows]
        _refuse_equal_hashes(unit, hashes)
    notes = _refuse_copies(
        unit,
        data.y,
        floor,
        "every run of a cell with two or more rows repeats the same value. " + _INSTEAD,
    )
    if data.block is not None:
        _refuse_copies(data.cell, data.y, floor, _LIKE_BLOCKS.format(data.block))
    return notes


def _refuse_equal_hashes(unit: Ints, hashes: Iterable[object]) -> None:
    seen: set[tuple[int, str]] = set()
    for key in zip(unit.tolist(), map(str, hashes), strict=True):
        if key in seen:
            raise RefusedError(f"fake replicates: two runs of a cell have equal input. {_INSTEAD}")
        seen.add(key)


def _refuse_copies(unit: Ints, y: Array, floor: float, rule: str) -> list[str]:
    _, index, counts = np.unique(unit, return_inverse=True, return_counts=True)
    repeated = counts >= 2
    if not repeated.any():
        return []
    high, low = np.full(counts.size, -np.inf), np.full(counts.size, np.inf)
    np.maximum.at(high, index, y)
    np.minimum.at(low, index, y)
    still = (high - low)[repeated] <= floor
    if still.all():
        raise RefusedError(f"fake replicates: {rule}")
    if still.any():
        return [f"{int(still.sum())} of {still.size} replicated cells have zero spread (ties)"]
    return []


def group_cells(y: Array, within: float) -> CopyGroups:
    """Group cells that agree with the group's first cell in every block.

    Parameters
    ----------
    y : ndarray, shape (cells, blocks)
        Response; NaN where a run is missing, which agrees with nothing.
    within : float
        Largest difference of copies.
    """
    groups: list[list[int]] = []
    heads = np.empty_like(y)
    for cell, values in enumerate(y):
        # NaN compares false, so a missing run never makes a copy
        near = np.flatnonzero(np.abs(heads[: len(groups), 0] - values[0]) <= within)
        for block in range(1, y.shape[1]):
            if not near.size:
                break
            near = near[np.abs(heads[near, block] - values[block]) <= within]
        if near.size:
            groups[near[0]].append(cell)
        else:
            heads[len(groups)] = values
            groups.append([cell])
    return CopyGroups(tuple(tuple(group) for group in groups))


def copies_of(data: Data, within: float, *, computed: bool) -> CopyGroups:
    """Cells that are one computation, judged on the raw response.

    Parameters
    ----------
    data : Data
        Checked rows.
    within : float
        Largest difference of copies, in the unit of the response; that of rounding at least.
    computed : bool
        Whether the rows come from a solver. Values of a measurement may tie by chance, so that
        their cells are copies only where they agree in three blocks or more.
    """
    cells = np.unique(data.cell)
    blocks = 1 if data.block is None else len(data.layout.levels[data.block])
    if not computed and (data.block is None or blocks < 3):
        return CopyGroups(tuple((int(c),) for c in cells))
    table = np.full((cells.size, blocks), np.nan)
    column = 0 if data.block is None else data.layout.codes[data.block]
    table[np.searchsorted(cells, data.cell), column] = data.y
    found = group_cells(table, max(within, ulp_floor(data.y)))
    return CopyGroups(tuple(tuple(int(cells[i]) for i in g) for g in found.groups))
