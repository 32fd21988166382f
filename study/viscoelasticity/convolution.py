"""Compiled recursions over the time of a test: fading memories, and the free stretch with them.

Times come in intervals of three nodes, begin, middle and end; node 0 begins the first of them.
"""

from __future__ import annotations

import numpy as np

from study.arrays import Array
from study.compilation import kernel


@kernel()
def accumulated(decay: Array, source: Array, first: Array) -> Array:
    """Sum up memories: m_j = decay_j m_begin + source_j.

    Parameters
    ----------
    decay : ndarray, shape (terms, intervals, 2)
        What is left of the memory at the begin of an interval, at its middle and end.
    source : ndarray, shape (terms, parts, intervals, 2)
        What the interval adds.
    first : ndarray, shape (terms, parts)
        Memory at node 0.

    Returns
    -------
    ndarray, shape (terms, parts, 2 intervals + 1)
    """
    terms, parts, intervals, _ = source.shape
    out = np.empty((terms, parts, 2 * intervals + 1))
    for term in range(terms):
        for part in range(parts):
            before = first[term, part]
            out[term, part, 0] = before
            for n in range(intervals):
                middle = decay[term, n, 0] * before + source[term, part, n, 0]
                before = decay[term, n, 1] * before + source[term, part, n, 1]
                out[term, part, 2 * n + 1] = middle
                out[term, part, 2 * n + 2] = before
    return out


@kernel()
def free_steps(
    decay: Array, weight: Array, share: Array, stays: float,
    pull: Array, rate: Array, own: Array, residual: Array,
) -> Array:  # fmt: skip
    """Solve the linearized condition of a stress-free side at every node, memories included.

    Parameters
    ----------
    decay : ndarray, shape (terms, intervals, 2)
        As of :func:`accumulated`.
    weight : ndarray, shape (terms, intervals, 2, 3)
        Of the values at the three nodes in what an interval adds.
    share : ndarray, shape (terms,)
        Of the memories.
    stays : float
        Share that has no memory.
    pull : ndarray, shape (3, nodes)
        Derivative of the condition by the remembered stress of each direction.
    rate : ndarray, shape (3, nodes)
        Derivative of the stress that enters the memory by the logarithm of the free stretch.
    own : ndarray, shape (nodes,)
        Derivative of the condition by the same at unchanged memory.
    residual : ndarray, shape (nodes,)
        The condition itself.

    Returns
    -------
    ndarray, shape (nodes,)
        Changes of the logarithm of the free stretch that make the condition zero.
    """
    terms, intervals, _ = decay.shape
    step = np.empty(2 * intervals + 1)
    total = own[0]
    for k in range(3):
        total += pull[k, 0] * rate[k, 0]
    step[0] = -residual[0] / total
    memory = np.empty((terms, 3))
    for term in range(terms):
        for k in range(3):
            memory[term, k] = rate[k, 0] * step[0]
    left = np.empty((2, 2))
    right = np.empty(2)
    for n in range(intervals):
        begin = 2 * n
        for j in range(2):
            node = begin + 1 + j
            right[j] = -residual[node]
            left[j, 0] = 0.0
            left[j, 1] = 0.0
            left[j, j] = own[node]
            for k in range(3):
                left[j, j] += pull[k, node] * stays * rate[k, node]
                for term in range(terms):
                    w = pull[k, node] * share[term]
                    known = decay[term, n, j] * memory[term, k]
                    known += weight[term, n, j, 0] * rate[k, begin] * step[begin]
                    right[j] -= w * known
                    left[j, 0] += w * weight[term, n, j, 1] * rate[k, begin + 1]
                    left[j, 1] += w * weight[term, n, j, 2] * rate[k, begin + 2]
        determinant = left[0, 0] * left[1, 1] - left[0, 1] * left[1, 0]
        step[begin + 1] = (right[0] * left[1, 1] - right[1] * left[0, 1]) / determinant
        step[begin + 2] = (right[1] * left[0, 0] - right[0] * left[1, 0]) / determinant
        for term in range(terms):
            for k in range(3):
                added = 0.0
                for i in range(3):
                    node = begin + i
                    added += weight[term, n, 1, i] * rate[k, node] * step[node]
                memory[term, k] = decay[term, n, 1] * memory[term, k] + added
    return step
