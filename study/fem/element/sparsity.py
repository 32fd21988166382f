"""Fixed sparsity pattern of the free unknowns and the map that scatters element tangents into it.

Built once per mesh in one compiled pass; every Newton iteration then only adds numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array, Elements, Unknowns
from study.compilation import kernel
from study.fem.element.function_space import Discretization

_Filled = tuple[Unknowns, Unknowns, Unknowns]


@dataclass(frozen=True)
class Pattern:
    """Upper triangle, in compressed rows, of the matrix of the free unknowns.

    Parameters
    ----------
    free : ndarray of int, shape (n_free,)
        Unknowns that are solved for, ascending.
    number : ndarray of int32, shape (n,)
        Row of each unknown among the free ones, -1 where constrained.
    indptr, indices : ndarray of int32
        Compressed rows with sorted columns and an entry on every diagonal.
    positions : ndarray of int32, shape (n_elements, m (m + 1) / 2)
        Where each packed element entry goes; -1 where a constrained unknown takes part.
    """

    free: NDArray[np.int64]
    number: NDArray[np.int32]
    indptr: NDArray[np.int32]
    indices: NDArray[np.int32]
    positions: NDArray[np.int32]

    @classmethod
    def build(cls, dofs: NDArray[np.int32], n: int, constrained: NDArray[np.int64]) -> Pattern:
        """Pattern of the elements' unknowns ``dofs`` (n_elements, m) without the constrained."""
        mask = np.ones(n, dtype=bool)
        mask[constrained] = False
        free = np.flatnonzero(mask)
        number = np.full(n, -1, dtype=np.int32)
        number[free] = np.arange(free.size, dtype=np.int32)
        rows = number[dofs]
        indptr, indices, positions = _fill(rows, *_elements_around(rows, free.size))
        return cls(free, number, indptr, indices, positions)

    def locate(self, dofs: NDArray[np.int64]) -> NDArray[np.int32]:
        """Positions of the packed upper entries of small blocks, shape (n_blocks, m(m+1)/2).

        Every pair must already share an element, as the nodes of a face do.
        """
        m = dofs.shape[1]
        rows, columns = np.triu_indices(m)
        a, b = self.number[dofs[:, rows]], self.number[dofs[:, columns]]
        low, high = np.minimum(a, b).ravel(), np.maximum(a, b).ravel()
        return np.asarray(_find(self.indptr, self.indices, low, high).reshape(a.shape))


@kernel()
def _elements_around(rows: Unknowns, n_rows: int) -> tuple[Unknowns, Unknowns, Unknowns]:
    """Elements around each row, and which of the element's unknowns it is.

    ``rows`` (n_elements, m) are negative for constrained unknowns.
    """
    ne, m = rows.shape
    start = np.zeros(n_rows + 1, np.int32)
    for e in range(ne):
        for i in range(m):
            if rows[e, i] >= 0:
                start[rows[e, i] + 1] += 1
    for i in range(n_rows):
        start[i + 1] += start[i]
    fill = start[:-1].copy()
    element, local = np.empty(start[n_rows], np.int32), np.empty(start[n_rows], np.int32)
    for e in range(ne):
        for i in range(m):
            r = rows[e, i]
            if r >= 0:
                element[fill[r]], local[fill[r]] = e, i
                fill[r] += 1
    return start, element, local


@kernel()
def _fill(rows: Unknowns, start: Unknowns, element: Unknowns, local: Unknowns) -> _Filled:
    """Row pointers, columns and the positions of packed entries, row by row."""
    ne, m = rows.shape
    n_rows = start.size - 1
    indptr, seen = np.zeros(n_rows + 1, np.int32), np.full(n_rows, -1, np.int32)
    for r in range(n_rows):
        count = 0
        for s in range(start[r], start[r + 1]):
            e = element[s]
            for j in range(m):
                c = rows[e, j]
                if c >= r and seen[c] != r:
                    seen[c] = r
                    count += 1
        indptr[r + 1] = indptr[r] + count
    indices, where = np.empty(indptr[n_rows], np.int32), np.empty(n_rows, np.int32)
    positions = np.full((ne, m * (m + 1) // 2), -1, np.int32)
    seen[:] = -1
    for r in range(n_rows):
        k = indptr[r]
        for s in range(start[r], start[r + 1]):
            e = element[s]
            for j in range(m):
                c = rows[e, j]
                if c >= r and seen[c] != r:
                    seen[c] = r
                    indices[k] = c
                    k += 1
        indices[indptr[r] : k].sort()
        for k in range(indptr[r], indptr[r + 1]):
            where[indices[k]] = k
        for s in range(start[r], start[r + 1]):
            e, i = element[s], local[s]
            for j in range(m):
                c = rows[e, j]
                if c >= r:
                    a, b = min(i, j), max(i, j)
                    positions[e, a * m - a * (a + 1) // 2 + b] = where[c]
    return indptr, indices, positions


@kernel()
def _find(indptr: Unknowns, indices: Unknowns, low: Unknowns, high: Unknowns) -> Unknowns:
    out = np.full(low.size, -1, np.int32)
    for i in range(low.size):
        if low[i] >= 0:
            a, b = indptr[low[i]], indptr[low[i] + 1]
            k = a + np.searchsorted(indices[a:b], high[i])
            if k < b and indices[k] == high[i]:
                out[i] = k
    return out


@kernel()
def symmetric_product(indptr: Unknowns, indices: Unknowns, data: Array, v: Array) -> Array:
    """Multiply the symmetric matrix of an upper triangle in compressed rows by a vector.

    Parameters
    ----------
    indptr, indices : ndarray of int32
        As in :class:`Pattern`: every row begins with its diagonal.
    data : ndarray, shape (n_entries,)
        Entries of the upper triangle.
    v : ndarray, shape (n,)
        As long as the matrix has rows.
    """
    out = np.zeros(v.size)
    for i in range(v.size):
        k = indptr[i]
        total = data[k] * v[i]  # rows begin with their diagonal
        for k in range(indptr[i] + 1, indptr[i + 1]):
            j = indices[k]
            total += data[k] * v[j]
            out[j] += data[k] * v[i]
        out[i] += total
    return out


Slabs = tuple[Elements, ...]

#: quadrature points of a slab that are worth a thread's while, and numbers of slabs: two, four or
#: eight threads have the same work
_WORTH = 5_000
_COUNTS = (16, 8, 4)


def slabs(space: Discretization) -> tuple[Slabs, ...]:
    """Elements in phases, each of them slabs across the body that share no unknown.

    Of the ways across the body that one is taken along which elements are numbered, as far as
    they are: memory is then read in a row. Where a mesh is too coarse somewhere for slabs, two
    halves come first and the elements between them afterwards.

    Parameters
    ----------
    space : Discretization
        Its elements are cut where their nodes' middles lie.

    Returns
    -------
    tuple of tuple of ndarray of uint32
        Phases in turn; the arrays of a phase are elements that may be worked on at once.
    """
    places = space.nodes[space.element_nodes].mean(axis=1).T
    for count in _COUNTS:
        if space.weights.size >= count * _WORTH:
            cuts = [_every_second(_cut(place, count)) for place in places]
            found = [cut for cut in cuts if all(_apart(phase, space) for phase in cut)]
            if found:
                return min(found, key=_gaps)
    if space.weights.size >= 2 * _WORTH:
        halves = [_halves(_cut(place, 2), space) for place in places]
        return min(halves, key=lambda phases: phases[1][0].size)
    return ((np.arange(space.n_elements, dtype=np.uint32),),)


def _cut(place: Array, count: int) -> Slabs:
    """Slabs of as many elements along ``place``, shape (n_elements,)."""
    slab = np.empty(place.size, dtype=np.int64)
    slab[np.argsort(place, kind="stable")] = count * np.arange(place.size) // place.size
    return tuple(np.flatnonzero(slab == i).astype(np.uint32) for i in range(count))


def _every_second(cut: Slabs) -> tuple[Slabs, ...]:
    return cut[::2], cut[1::2]


def _halves(cut: Slabs, space: Discretization) -> tuple[Slabs, ...]:
    """Two slabs, the second without what it shares unknowns with the first, which comes after."""
    first, second = cut
    met = np.zeros(space.n, dtype=bool)
    met[space.dofs[first].ravel()] = True
    between = met[space.dofs[second]].any(axis=1)
    return (first, second[~between]), (second[between],)


def _gaps(phases: tuple[Slabs, ...]) -> int:
    """Where the elements of a slab are not numbered in a row."""
    steps = (np.diff(slab.astype(np.int64)) for phase in phases for slab in phase)
    return sum(int(np.count_nonzero(step != 1)) for step in steps)


def _apart(phase: Slabs, space: Discretization) -> bool:
    """Whether no two slabs share an unknown."""
    met = np.zeros(space.n, dtype=bool)
    for elements in phase:
        dofs = space.dofs[elements].ravel()
        if met[dofs].any():
            return False
        met[dofs] = True
    return True
