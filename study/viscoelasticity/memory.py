"""Memory of a homogeneous test: its course in parts, and what each term keeps of the stress.

Stresses are interpolated quadratically in every part and convolved exactly with each exponential
function (a product integration, which Taylor, Pister and Goudreau 1970, Int. J. Numer. Methods
Eng. 2, 45, do with straight lines).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array
from study.material.material import Material
from study.material.relaxation import long_term_share, share_name, shares, time_name, times
from study.viscoelasticity.convolution import accumulated

#: largest change of the logarithm of a stretch, or of an amount of shear, within a part
LARGEST_STEP = 0.02

#: first part of an interval over the shortest time, where a free side creeps, and their growth
_FIRST_PART = 0.1
_GROWTH = 1.25

#: argument below which the functions of the exponential are summed as power series
_SMALL = 1.0
_POWERS = 22


@dataclass(frozen=True)
class Memory:
    """A test in parts that are short enough, three nodes to each, and the memory of each term.

    Parameters
    ----------
    material : Material
        Whose terms it has.
    length_s : ndarray, shape (intervals,)
        Duration of every part.
    measure : ndarray, shape (2 intervals + 1,)
        At the nodes.
    rows : ndarray, shape (n,)
        Nodes that are rows of the test.
    """

    material: Material
    length_s: Array
    measure: Array
    rows: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        material: Material,
        time: Array,
        measure: Array,
        *,
        is_shear: bool = False,
        creeps: bool = False,
    ) -> Memory:
        """Divide the intervals between rows."""
        moved = np.abs(np.diff(measure if is_shear else np.log(measure)))
        count = np.maximum(np.ceil(moved / LARGEST_STEP), 1).astype(int)
        whole = np.diff(time)
        parts = [np.linspace(0.0, 1.0, k + 1)[1:] for k in count]
        if creeps:
            first = _FIRST_PART * float(times(material.relaxation).min())
            parts = [
                np.union1d(even, _growing(first / span))
                for even, span in zip(parts, whole, strict=True)
            ]
        sizes = np.array([part.size for part in parts], int)
        ends = np.concatenate([np.zeros(1), *(n + p for n, p in enumerate(parts))])
        nodes = np.empty(2 * ends.size - 1)
        nodes[::2], nodes[1::2] = ends, 0.5 * (ends[1:] + ends[:-1])
        length = np.repeat(whole, sizes) * np.diff(ends)
        rows = 2 * np.concatenate([np.zeros(1, int), np.cumsum(sizes)]).astype(np.int64)
        return cls(material, length, np.interp(nodes, np.arange(time.size), measure), rows)

    @cached_property
    def shares(self) -> Array:
        """Shape (terms,)."""
        return shares(self.material.relaxation)

    @property
    def stays(self) -> float:
        """Share that does not fade."""
        return long_term_share(self.material.relaxation)

    @cached_property
    def reduced(self) -> Array:
        """Duration of every part over the time of every term, shape (terms, intervals)."""
        return np.asarray(self.length_s / times(self.material.relaxation)[:, None])

    @cached_property
    def decay(self) -> Array:
        """Shape (terms, intervals, 2), at the middle and the end."""
        return np.asarray(np.exp(-self.reduced[..., None] * np.array([0.5, 1.0])))

    @cached_property
    def weight(self) -> Array:
        """Shape (terms, intervals, 2, 3)."""
        return self._weights_and_slopes[0]

    @cached_property
    def _weights_and_slopes(self) -> tuple[Array, Array]:
        """Weights, and their derivatives by the reduced duration."""
        return _weights(self.reduced)

    def memories(self, values: Array) -> Array:
        """Every term's memory of stresses, (parts, nodes) to (terms, parts, nodes)."""
        source = np.einsum("tnjk,pnk->tpnj", self.weight, _by_interval(values))
        first = np.broadcast_to(values[:, 0], (self.shares.size, values.shape[0]))
        return np.asarray(accumulated(self.decay, source, np.ascontiguousarray(first)))

    def convolved(self, values: Array, memories: Array | None = None) -> Array:
        """Stress that is left of values, shape (parts, nodes)."""
        known = self.memories(values) if memories is None else memories
        return np.asarray(self.stays * values + np.einsum("t,tpn->pn", self.shares, known))

    def memory_rate(self, term: int, values: Array, memory: Array) -> Array:
        """Differentiate one memory (parts, nodes) by its time, MPa/s."""
        x, time = self.reduced[term], self.material.relaxation[term].time_s
        by_x = np.einsum("njk,pnk->pnj", self._weights_and_slopes[1][term], _by_interval(values))
        by_x -= (np.array([0.5, 1.0]) * self.decay[term]) * memory[:, :-1:2, None]
        source = (-x / time)[:, None] * by_x
        first = np.zeros((1, values.shape[0]))
        return np.asarray(accumulated(self.decay[term : term + 1], source[None], first)[0])

    def by_relaxation(self, values: Array, memories: Array) -> dict[str, Array]:
        """Differentiate what is left of values by every share and time, (parts, nodes) each."""
        found = {}
        for k, term in enumerate(self.material.relaxation):
            found[share_name(k + 1)] = memories[k] - values
            found[time_name(k + 1)] = term.share * self.memory_rate(k, values, memories[k])
        return found


def _growing(first: float) -> Array:
    """Shares of an interval that begin with ``first`` and grow, the last one being 1."""
    if first >= 1:
        return np.ones(1)
    count = math.ceil(math.log1p((_GROWTH - 1) / first) / math.log(_GROWTH))
    ends = first * (_GROWTH ** np.arange(1, count + 1) - 1) / (_GROWTH - 1)
    return np.append(ends[ends < 1 - 1e-9], 1.0)


def _by_interval(values: Array) -> Array:
    """Values (parts, nodes) at the three nodes of every interval, (parts, intervals, 3)."""
    return np.stack([values[:, :-1:2], values[:, 1::2], values[:, 2::2]], axis=-1)


def _weights(x: Array) -> tuple[Array, Array]:
    """Integrals of exp(-(c - s) x) L_k'(s) from 0 to c, for c = 1/2 and 1, and their slopes by x.

    ``L_k`` are Lagrange's polynomials of the nodes 0, 1/2 and 1, with the derivatives 4 s - 3,
    4 - 8 s and 4 s - 1. Shapes (..., 2, 3).
    """
    c = np.array([0.5, 1.0])
    first, second, first_rate, second_rate = _exponential_functions(x[..., None] * c)
    slope, at_zero = np.array([4.0, -8.0, 4.0]), np.array([-3.0, 4.0, -1.0])

    def joined(one: Array, s: Array) -> Array:
        return np.asarray(one[..., None] * at_zero + s[..., None] * slope)

    return joined(c * first, c**2 * second), joined(c**2 * first_rate, c**3 * second_rate)


def _exponential_functions(y: Array) -> tuple[Array, Array, Array, Array]:
    """(1 - e^-y) / y and (y - 1 + e^-y) / y^2, and their derivatives."""
    near = y < _SMALL
    far = np.where(near, 1.0, y)
    first = -np.expm1(-far) / far
    second = (1 - first) / far
    first_rate = (np.exp(-far) - first) / far
    second_rate = -(first_rate + second) / far
    small, powers = np.where(near, y, 0.0)[..., None], np.arange(_POWERS)
    factorial = np.array([math.factorial(k) for k in range(_POWERS + 4)], float)
    terms = (-small) ** powers
    series = (
        (terms / factorial[1 : _POWERS + 1]).sum(-1),
        (terms / factorial[2 : _POWERS + 2]).sum(-1),
        -(terms * (powers + 1) / factorial[2 : _POWERS + 2]).sum(-1),
        -(terms * (powers + 1) / factorial[3 : _POWERS + 3]).sum(-1),
    )
    apart = (first, second, first_rate, second_rate)
    a, b, c, d = (np.where(near, s, f) for s, f in zip(series, apart, strict=True))
    return a, b, c, d
