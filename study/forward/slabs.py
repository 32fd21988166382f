"""Slabs of elements, of which every second one may be worked on at once.

Two slabs of the same phase share no unknown, so that threads add up their tangents without
waiting for each other, and an entry is the same sum in the same order however many they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.forward.elements import Discretization
from study.forward.handed import Elements

Slabs = tuple[Elements, ...]

#: quadrature points of a slab that are worth a thread's while, and the most slabs of a phase
_WORTH, _MOST = 5_000, 8


def slabs(space: Discretization) -> tuple[Slabs, ...]:
    """Elements in one or two phases of slabs, as many as pay.

    Of the ways across the body that one is taken along which elements are numbered, as far as
    they are: memory is then read in a row.
    """
    each = min(_MOST, space.weights.size // (2 * _WORTH))
    while each > 1:
        found = [cut for place in _places(space).T if _apart(cut := _cut(place, each), space)]
        if found:
            return min(found, key=_gaps)
        each //= 2
    return ((np.arange(space.n_elements, dtype=np.uint32),),)


def _places(space: Discretization) -> NDArray[np.float64]:
    return np.asarray(space.nodes[space.element_nodes].mean(axis=1))


def _cut(place: NDArray[np.float64], each: int) -> tuple[Slabs, ...]:
    """Twice ``each`` slabs of as many elements, every second one in the same phase."""
    slab = np.empty(place.size, dtype=np.int64)
    slab[np.argsort(place, kind="stable")] = 2 * each * np.arange(place.size) // place.size
    cut = tuple(np.flatnonzero(slab == i).astype(np.uint32) for i in range(2 * each))
    return cut[::2], cut[1::2]


def _gaps(cut: tuple[Slabs, ...]) -> int:
    """Where the elements of a slab are not numbered in a row."""
    steps = (np.diff(part.astype(np.int64)) for phase in cut for part in phase)
    return sum(int(np.count_nonzero(step != 1)) for step in steps)


def _apart(cut: tuple[Slabs, ...], space: Discretization) -> bool:
    """Whether no two slabs of a phase share an unknown."""
    for phase in cut:
        met = np.zeros(space.n, dtype=bool)
        for elements in phase:
            dofs = space.dofs[elements].ravel()
            if met[dofs].any():
                return False
            met[dofs] = True
    return True
