"""The sum of the elements' tangents: entries among the free unknowns, and what is beside them.

The solver sees free unknowns alone. What prescribed unknowns do to them, and reactions, come from
the packed tangents of the few elements with constrained unknowns: all others are forgotten as
soon as they are added up.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from study.forward import kernels
from study.forward.handed import Sums
from study.forward.pattern import Pattern, symmetric_product

Array = NDArray[np.float64]
Narrow = NDArray[np.int32]
Ints = NDArray[np.int64]


@dataclass
class Tangent:
    """Tangent of a discretization, overwritten by each assembly.

    Parameters
    ----------
    pattern : Pattern
        Free unknowns, and where packed entries go.
    dofs : ndarray of int32, shape (n_elements, m)
        Unknowns of each element.
    edge : ndarray of int32, shape (n_kept,)
        Elements with constrained unknowns.
    sums : Sums
        Entries of the pattern, and what is kept of those elements.
    """

    pattern: Pattern
    dofs: Narrow
    edge: Narrow
    sums: Sums

    @classmethod
    def of(cls, pattern: Pattern, dofs: Narrow) -> Tangent:
        """Take the memory for the elements' unknowns ``dofs``."""
        # filled, since zeros alone are memory that is only promised until it is written to
        data = np.full(pattern.indices.size, 0.0)
        edge = np.flatnonzero((pattern.number[dofs] < 0).any(axis=1)).astype(np.int32)
        slots = np.full(len(dofs), -1, dtype=np.int32)
        slots[edge] = np.arange(edge.size, dtype=np.int32)
        kept = np.full((edge.size, pattern.positions.shape[1]), 0.0)
        return cls(pattern, dofs, edge, Sums(pattern.positions, data, slots, kept))

    @property
    def data(self) -> Array:
        """Entries of the pattern, shape (n_entries,); contact adds its own to them."""
        return self.sums.data

    def product(self, v: Array) -> Array:
        """Tangent times ``v``, shape (n,), constrained rows and columns included."""
        out = self.beside(v)
        free, pattern = self.pattern.free, self.pattern
        out[free] += symmetric_product(pattern.indptr, pattern.indices, self.data, v[free])
        return out

    def beside(self, v: Array) -> Array:
        """Product with the entries of constrained rows and columns alone, shape (n,)."""
        out = np.zeros(v.size)
        kernels.constrained_product(
            self.edge, self.dofs, self.pattern.positions, self.sums.kept, v, out
        )
        return out


@dataclass
class ContactBlocks:
    """Tangents of contact points: small blocks among the entries of the elements.

    Parameters
    ----------
    dofs : ndarray of int32, shape (n_points, m)
        Unknowns of each point.
    positions : ndarray of int32, shape (n_points, m (m + 1) / 2)
        Entry of the pattern of each packed one; negative where a constrained unknown takes part.
    packed : ndarray, shape (n_points, m (m + 1) / 2)
        Upper triangles.
    """

    dofs: Narrow
    positions: Narrow
    packed: Array
    _inside: NDArray[np.bool_]
    _entries: Narrow
    _edge: Narrow
    _before: Array = field(default_factory=lambda: np.zeros(0))

    @classmethod
    def at(cls, dofs: Ints, positions: Narrow) -> ContactBlocks:
        """Take the memory for contact points."""
        inside = positions >= 0
        entries = np.unique(positions[inside])
        edge = np.flatnonzero(~inside.all(axis=1)).astype(np.int32)
        return cls(
            dofs.astype(np.int32), positions, np.zeros(positions.shape), inside, entries, edge
        )

    def fill(self, packed: Array, data: Array) -> None:
        """Add blocks to the entries of a pattern."""
        self.packed[:] = packed
        self._before = data[self._entries]
        np.add.at(data, self.positions[self._inside], packed[self._inside])

    @contextmanager
    def taken_out(self, data: Array) -> Iterator[None]:
        """Context in which the entries are what they were: subtracting would cost digits."""
        filled = data[self._entries]
        data[self._entries] = self._before
        try:
            yield
        finally:
            data[self._entries] = filled

    def add_beside(self, v: Array, out: Array) -> None:
        """Add the product with the entries of constrained rows and columns alone."""
        kept = self.packed[self._edge]
        kernels.constrained_product(self._edge, self.dofs, self.positions, kept, v, out)
