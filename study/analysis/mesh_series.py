"""How an effect changes from mesh to mesh, where the meshes are a factor of the study.

What the discretization does to an effect is what it does to the same contrast of the cells:
errors that all levels of the factor share cancel in their difference, and those that they do
not share remain. The effect is therefore estimated again on every mesh alone, from the same
cells and blocks, and its values from the coarsest mesh to the finest are a refinement series.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis.blocks import crossed
from study.analysis.effects import term_rows
from study.analysis.matrix import Array, Layout, Term, model_matrix, term_name, terms_of
from study.analysis.sums import Factored, factor
from study.analysis.tidy import prepare

if TYPE_CHECKING:
    import pandas as pd

#: a term with more levels is followed by its pairs with the two extremes alone
_MOST_LEVELS = 12
#: two pairs of levels whose series agree to this share of the largest value are one
_SAME = 1e-9


@dataclass(frozen=True)
class MeshSeries:
    """Pure effects of one term, as analyzed and on each mesh alone.

    Parameters
    ----------
    term : str
        Printed name.
    analyzed : ndarray, shape (k,)
        Effect of each level (or combination) over all meshes, on the working scale.
    by_mesh : ndarray, shape (meshes, k)
        The same on every mesh, from the coarsest to the finest.
    """

    term: str
    analyzed: Array
    by_mesh: Array

    def pairs(self) -> Iterator[tuple[float, Array]]:
        """Difference of two levels as analyzed, and on every mesh: each distinct pair once."""
        k = self.analyzed.size
        ends = int(self.analyzed.argmax()), int(self.analyzed.argmin())
        seen: list[Array] = []
        floor = _SAME * float(np.abs(self.by_mesh).max(initial=0.0))
        for i, j in combinations(range(k), 2):
            if k > _MOST_LEVELS and i not in ends and j not in ends:
                continue
            both = np.append(
                self.by_mesh[:, i] - self.by_mesh[:, j], self.analyzed[i] - self.analyzed[j]
            )
            # interactions of two levels repeat their differences, with either sign
            if any(min(np.abs(both - s).max(), np.abs(both + s).max()) <= floor for s in seen):
                continue
            seen.append(both)
            yield float(both[-1]), both[:-1]


def mesh_series(
    table: pd.DataFrame,
    response: str,
    factors: Sequence[str],
    mesh: str,
    meshes: Sequence[str],
    *,
    block: str | None = None,
    model: Any = "full",
    transform: str = "none",
) -> dict[str, MeshSeries]:
    """Follow every effect but those of the mesh from mesh to mesh.

    Cells that lack a mesh (in some block that is analyzed) are left out of the series, though
    not of the effect as analyzed. A term is missing where they leave one of its levels empty.

    Parameters
    ----------
    table : DataFrame
        One row a run, as for :func:`study.analysis.analyze`.
    mesh : str
        Factor that holds the meshes.
    meshes : sequence of str
        Its levels from the coarsest to the finest.
    block : str, optional
        Column of the blocks; those that an analysis against blocks would leave out are left
        out here too.

    Returns
    -------
    dict
        By printed name of the term. Empty where no cell has all meshes.

    Raises
    ------
    InputError
        For columns or values that cannot be analyzed.
    """
    layout, y = _cells(table, response, factors, block, transform)
    terms = terms_of(factors, model)
    codes = [layout.levels[mesh].index(level) for level in meshes]
    kept = _complete(layout, [f for f in factors if f != mesh], mesh, codes)
    if not kept.any():
        return {}
    whole = factor(model_matrix(layout, terms), y)
    inner = [term for term in terms if mesh not in term]
    parts = []
    for code in codes:
        rows = np.flatnonzero(kept & (layout.codes[mesh] == code))
        own = layout.take(rows)
        parts.append((own, factor(model_matrix(own, inner), y[rows])))
    found = {}
    for term in inner:
        analyzed = _effects(layout, whole, term)
        by_mesh = np.array([_effects(own, fit, term) for own, fit in parts])
        if np.isfinite(by_mesh).all() and np.isfinite(analyzed).all():
            found[term_name(term)] = MeshSeries(term_name(term), analyzed, by_mesh)
    return found


def _cells(
    table: pd.DataFrame, response: str, factors: Sequence[str], block: str | None, transform: str
) -> tuple[Layout, Array]:
    """Levels and mean of every cell, over the blocks that are analyzed, on the working scale."""
    data = prepare(table, response, factors, block)
    y = np.log(data.y) if transform == "log" else data.y
    if block is not None:
        against = crossed(data, y)
        if against.y.size:
            return against.layout, against.y.mean(axis=1)
    cells, first, index = np.unique(data.cell, return_index=True, return_inverse=True)
    total = np.zeros(cells.size)
    np.add.at(total, index, y - y[0])
    return data.layout.take(first), y[0] + total / np.bincount(index)


def _complete(
    layout: Layout, others: Sequence[str], mesh: str, codes: Sequence[int]
) -> np.ndarray[Any, np.dtype[np.bool_]]:
    """Whether the column of each cell has all meshes."""
    column = layout.cell(others)
    full = set(column.tolist())
    for code in codes:
        full &= set(column[layout.codes[mesh] == code].tolist())
    return np.isin(column, list(full))


def _effects(layout: Layout, fit: Factored, term: Term) -> Array:
    """Pure effect of each level of a term, NaN where it is not estimable."""
    _, rows, _ = term_rows(layout, fit, term)
    if not fit.estimable(rows).all():
        return np.full(rows.shape[0], np.nan)
    return np.asarray(rows @ fit.coefficients())
