"""Slabs of elements, of which every second one may be worked on at once.

What is worked on at once shares no unknown, so that threads add up their tangents without
waiting for each other, and an entry is the same sum in the same order however many they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.elements import Discretization
from study.forward.handed import Elements

Slabs = tuple[Elements, ...]
Places = NDArray[np.float64]

#: quadrature points of a slab that are worth a thread's while, and numbers of slabs: two, four or
#: eight threads have the same work
_WORTH, _COUNTS = 5_000, (16, 8, 4)


def slabs(space: Discretization) -> tuple[Slabs, ...]:
    """Elements in phases, each of them slabs across the body that share no unknown.

    Of the ways across the body that one is taken along which elements are numbered, as far as
    they are: memory is then read in a row. Where a mesh is too coarse somewhere for slabs, two
    halves come first and the elements between them afterwards.
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


def _cut(place: Places, count: int) -> Slabs:
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
