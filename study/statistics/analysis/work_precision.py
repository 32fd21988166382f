"""Accuracy against cost: which discretization reaches a wanted error with the least work."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from study.ground.arrays import Array, Flags
from study.statistics.analysis.data import crossed, prepare
from study.statistics.analysis.effects import term_rows
from study.statistics.analysis.linear_model import (
    CellLayout,
    Model,
    Term,
    model_matrix,
    term_name,
    terms_of,
)
from study.statistics.analysis.sums_of_squares import Factored, factor

if TYPE_CHECKING:
    import pandas as pd


@dataclass(frozen=True)
class CostPoint:
    """One mesh of one discretization: relative error and seconds."""

    mesh_size: float
    error: float
    seconds: float


@dataclass(frozen=True)
class CostToAccuracy:
    """Seconds that a discretization (a cell of a study) needs for a wanted relative error."""

    cell: str
    #: None where its meshes are too few or do not get better.
    seconds: float | None
    mesh_size: float | None
    #: ``"between meshes"``, ``"coarsest mesh"`` (it is better than wanted), or ``"extrapolated"``
    #: (finer than any that was solved).
    how: str


def cost_to_accuracy(
    fronts: Mapping[str, Sequence[CostPoint]], accuracy: float
) -> list[CostToAccuracy]:
    """Rank discretizations by the seconds that an accuracy takes, cheapest first.

    Error against seconds is a straight line in logarithms, piece by piece.

    Examples
    --------
    >>> line = [CostPoint(1.0, 0.04, 1.0), CostPoint(0.5, 0.01, 4.0)]
    >>> found = cost_to_accuracy({"P2": line}, 0.02)[0]
    >>> round(found.seconds, 6), round(found.mesh_size, 6), found.how
    (2.0, 0.707107, 'between meshes')
    """
    found = [_one(name, points, accuracy) for name, points in fronts.items()]
    return sorted(found, key=lambda row: math.inf if row.seconds is None else row.seconds)


def _one(name: str, points: Sequence[CostPoint], accuracy: float) -> CostToAccuracy:
    ordered = sorted(points, key=lambda p: -p.mesh_size)
    good = [p for p in ordered if p.error > 0 and p.seconds > 0]
    if not good:
        return CostToAccuracy(name, None, None, "no mesh gave an answer")
    # from here on every finer mesh is at least as good
    first = len(good) - 1
    while first > 0 and good[first - 1].error <= accuracy:
        first -= 1
    if good[first].error <= accuracy:
        if first == 0:
            return CostToAccuracy(name, good[0].seconds, good[0].mesh_size, "coarsest mesh")
        return _between(name, good[first - 1], good[first], accuracy, "between meshes")
    if len(good) < 2 or good[-1].error >= good[-2].error:
        return CostToAccuracy(name, None, None, "its meshes do not get better")
    return _between(name, good[-2], good[-1], accuracy, "extrapolated")


def _between(
    name: str, coarse: CostPoint, fine: CostPoint, accuracy: float, how: str
) -> CostToAccuracy:
    share = math.log(accuracy / coarse.error) / math.log(fine.error / coarse.error)
    seconds = coarse.seconds * (fine.seconds / coarse.seconds) ** share
    size = coarse.mesh_size * (fine.mesh_size / coarse.mesh_size) ** share
    return CostToAccuracy(name, float(seconds), float(size), how)


def reference_value(
    candidates: Sequence[tuple[float | None, float | None]],
) -> tuple[float | None, float | None]:
    """Best limit of several series of one quantity: that with the smallest uncertainty."""
    known = [(u, limit) for limit, u in candidates if limit is not None and u is not None]
    if not known:
        return None, None
    u, limit = min(known)
    return float(limit), float(u)


#: a term with more levels is followed by its pairs with the two extremes alone
_MOST_LEVELS = 12

#: two pairs of levels whose series agree to this share of the largest value are one
_SAME = 1e-9


@dataclass(frozen=True)
class MeshSeries:
    """Pure effects of one term, as analyzed and on each mesh alone."""

    term: str
    #: shape (k,); effect of each level (or combination) over all meshes, on the working scale.
    analyzed: Array
    #: shape (meshes, k); the same on every mesh, from the coarsest to the finest.
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
    model: Model = "full",
    transform: str = "none",
) -> dict[str, MeshSeries]:
    """Follow every effect but those of the mesh from mesh to mesh.

    Cells that lack a mesh (in some block that is analyzed) are left out of the series, though
    not of the effect as analyzed. A term is missing where they leave one of its levels empty.
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
) -> tuple[CellLayout, Array]:
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


def _complete(layout: CellLayout, others: Sequence[str], mesh: str, codes: Sequence[int]) -> Flags:
    """Whether the column of each cell has all meshes."""
    column = layout.cell(others)
    full = set(column.tolist())
    for code in codes:
        full &= set(column[layout.codes[mesh] == code].tolist())
    return np.isin(column, list(full))


def _effects(layout: CellLayout, fit: Factored, term: Term) -> Array:
    """Pure effect of each level of a term, NaN where it is not estimable."""
    _, rows, _ = term_rows(layout, fit, term)
    if not fit.estimable(rows).all():
        return np.full(rows.shape[0], np.nan)
    return np.asarray(rows @ fit.coefficients())
