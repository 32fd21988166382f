"""What a table is, before anything is fitted: copies, resolution, nesting, empty cells."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from study.analysis.data import Data
from study.analysis.linear_model.design_matrix import Term
from study.arrays import Array, Ints
from study.errors import RefusedError

#: decimals beyond which a response is a computed number, not a reading
_MOST_DECIMALS = 9
#: chance of the ties that are seen below which rows are taken for copies
_CHANCE = 1e-4
#: share of repeated rows from which they are taken for copies
_LEAST_SHARE = 0.2
#: distinct rows from which equal numbers of copies of each are no chance
_DISTINCT_ROWS = 8
#: pairs of blocks that are compared value by value
_MOST_BLOCKS = 200


@dataclass(frozen=True)
class Structure:
    """What a table is, before a model is fitted.

    Parameters
    ----------
    resolution : float
        Step of the readings in the unit of the response; 0 where none shows.
    nested : tuple of (str, str)
        Factors whose levels each lie in one level of another factor: (inner, outer).
    empty_cells : int
        Combinations of levels without a row.
    undecided : str
        Which terms were left out because the runs cannot tell them from others; empty if none.
    asked : tuple of Term
        Terms of the model with those; empty where none was left out.
    """

    resolution: float = 0.0
    nested: tuple[tuple[str, str], ...] = ()
    empty_cells: int = 0
    undecided: str = ""
    asked: tuple[Term, ...] = ()


def structure_of(data: Data) -> Structure:
    """Look at checked rows.

    Parameters
    ----------
    data : Data
        Before repeats are averaged: averages have no resolution.
    """
    size = math.prod(len(data.layout.levels[f]) for f in data.factors)
    empty = size - np.unique(data.cell).size
    return Structure(resolution(data.y), _nested(data) if empty else (), empty)


def resolution(y: Array) -> float:
    """Largest step of which all values are multiples; 0 for values with ten decimals or more.

    Parameters
    ----------
    y : ndarray
        Readings.

    Examples
    --------
    >>> resolution(np.array([1.25, 2.0, 7.75])), resolution(np.array([math.pi, 1.0]))
    (0.25, 0.0)
    """
    scale = float(np.abs(y).max(initial=0.0))
    for decimals in range(_MOST_DECIMALS + 1):
        units = y * 10.0**decimals
        if scale * 10.0**decimals > 1e15:
            return 0.0
        whole = np.round(units)
        if np.abs(units - whole).max(initial=0.0) <= 1e-6 + 4e-16 * scale * 10.0**decimals:
            step = int(np.gcd.reduce(whole.astype(np.int64)))
            return step * 10.0**-decimals
    return 0.0


def _nested(data: Data) -> tuple[tuple[str, str], ...]:
    """Pairs of factors of which the first is nested in the second, with names of its own."""
    found = []
    for inner, outer in permutations(data.factors, 2):
        code, parent = data.layout.codes[inner], data.layout.codes[outer]
        levels, parents = len(data.layout.levels[inner]), len(data.layout.levels[outer])
        pairs = np.unique(code * parents + parent).size
        if pairs == levels > parents:
            found.append((inner, outer))
    return tuple(found)


def refuse_copied_rows(data: Data) -> None:
    """Refuse rows that repeat others in every digit, more often than their resolution explains.

    Parameters
    ----------
    data : Data
        Measured rows.

    Raises
    ------
    RefusedError
        With what was seen and the option that says that the copies are real.
    """
    mend = "; where every one of them was measured, say --copies independent"
    if data.block is None:
        said = _copied_rows(data)
        if said:
            raise RefusedError(
                f"copied rows: {said}. Copies tell nothing new: leave them out{mend}"
            )
    elif not data.also:
        twins = _copied_blocks(data, data.layout.codes[data.block])
        if twins:
            names = data.layout.levels[data.block]
            listed = ", ".join(f"{names[j]} repeats {names[i]}" for i, j in twins[:5])
            raise RefusedError(
                f"copied rows: in every digit {data.block} {listed}. Copies tell nothing new: "
                f"leave them out{mend}"
            )


def _copied_rows(data: Data) -> str:
    """Describe the copies; empty where ties are no more than the resolution makes."""
    pairs = np.column_stack([data.cell.astype(float), data.y])
    keys, counts = np.unique(pairs, axis=0, return_counts=True)
    index = np.unique(keys[:, 0], return_inverse=True)[1]
    varies = np.bincount(index)[index] > 1  # a cell without spread is told as such
    index, counts, values = index[varies], counts[varies], keys[varies, 1]
    n, distinct = int(counts.sum()), counts.size
    if n - distinct < _LEAST_SHARE * n or n == distinct:
        return ""
    times = int(np.gcd.reduce(counts))
    every = f"each row stands {times} times ({distinct} distinct rows of {n})"
    if times > 1 and distinct >= _DISTINCT_ROWS:
        return every
    index = np.unique(index, return_inverse=True)[1]
    members, rows = np.bincount(index), np.bincount(index, counts)
    free = distinct - members.size
    mean = np.bincount(index, values) / members
    sd = math.sqrt(float(np.sum((values - mean[index]) ** 2)) / free)
    within = float(np.sum(rows * (rows - 1)) / 2)
    between = n * (n - 1) / 2 - within
    everywhere = np.unique(values, return_inverse=True)[1]
    total = np.bincount(everywhere, counts)
    ties = int(np.sum(counts * (counts - 1)) // 2)
    # readings that were coarse before they were computed with tie between cells as well
    elsewhere = float(np.sum(total * (total - 1)) / 2) - ties
    chance = max(_tie(data.y, sd), 2 * elsewhere / between if between else 0.0)
    if not _too_many(ties, within * chance):
        return ""
    return every if times > 1 else f"{n - distinct} of {n} rows repeat another of their cell"


def _tie(y: Array, sd: float) -> float:
    """Chance that two normal readings agree: step times the integral of the squared density."""
    step = resolution(y) or 16 * float(np.spacing(np.abs(y).max()))
    return min(1.0, step / (2 * math.sqrt(math.pi) * sd)) if sd > 0 else 1.0


def _too_many(ties: int, expected: float) -> bool:
    """Whether so many ties are no chance, where readings cluster threefold."""
    from scipy.special import pdtrc

    return ties > 0 and float(pdtrc(ties - 1, 3 * expected)) < _CHANCE


def _copied_blocks(data: Data, block: Ints) -> list[tuple[int, int]]:
    """Pairs of blocks whose values agree in every cell that both have."""
    cells, index = np.unique(data.cell, return_inverse=True)
    blocks = int(block.max()) + 1
    if not 2 <= blocks <= _MOST_BLOCKS or cells.size < 2:
        return []
    table = np.full((blocks, cells.size), np.nan)
    table[block, index] = data.y
    with np.errstate(invalid="ignore"):
        centred = table - np.nanmean(table, axis=0)
    sd = float(np.sqrt(np.nanmean(centred**2)))
    chance = blocks * (blocks - 1) / 2
    found = []
    for i, j in combinations(range(blocks), 2):
        both = np.isfinite(table[i]) & np.isfinite(table[j])
        rare = chance * (3 * _tie(data.y, sd)) ** int(both.sum()) < _CHANCE
        if rare and both.sum() >= 2 and np.array_equal(table[i][both], table[j][both]):
            found.append((i, j))
    return found
