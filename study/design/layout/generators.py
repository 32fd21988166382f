"""Coded runs of designs other than the full factorial, from kept-up libraries.

Two-level designs are coded -1 and 1, response-surface designs -1 to 1 with the outermost
runs at the ends of the ranges, space-filling designs 0 to 1. pyDOE3 is not used: its
fractional designs are wrong; those of pydoe are verified by :mod:`study.design.layout.aliases`.
"""

from __future__ import annotations

import itertools
import string
from collections.abc import Mapping, Sequence

import numpy as np

from study.arrays import Array

#: letters that pydoe takes for factors
LETTERS = string.ascii_lowercase


def fractional(
    factors: Sequence[str], generators: Mapping[str, tuple[int, Sequence[str]]]
) -> Array:
    """Two-level fractional factorial with given generators.

    Parameters
    ----------
    factors : sequence of str
        Names, in order.
    generators : mapping of str to (sign, names)
        Each generated factor is the sign times the product of these basic factors.

    Returns
    -------
    ndarray, shape (runs, factors)
        -1 and 1.

    Examples
    --------
    >>> fractional(["A", "B", "C"], {"C": (-1, ["A", "B"])}).astype(int).tolist()
    [[-1, -1, -1], [-1, 1, 1], [1, -1, 1], [1, 1, -1]]
    """
    from pydoe import fracfact

    basic = [name for name in factors if name not in generators]
    letter = dict(zip(basic, LETTERS, strict=False))
    words = []
    for factor in factors:
        sign, parts = generators.get(factor, (1, [factor]))
        words.append(("-" if sign < 0 else "") + "".join(sorted(letter[p] for p in parts)))
    return _ordered(np.asarray(fracfact(" ".join(words)), dtype=float))


def by_resolution(count: int, resolution: int) -> Array:
    """Smallest two-level fraction of a number of factors with at least a resolution.

    Parameters
    ----------
    count : int
        Number of factors.
    resolution : int
        Least one; III is 3.

    Returns
    -------
    ndarray, shape (runs, count)
        -1 and 1.

    Raises
    ------
    ValueError
        If there is none.
    """
    from pydoe import fracfact_by_res

    return _ordered(np.asarray(fracfact_by_res(count, resolution), dtype=float))


def plackett_burman(count: int) -> Array:
    """Plackett-Burman screening design (Plackett and Burman 1946, Biometrika 33, 305).

    Parameters
    ----------
    count : int
        Number of factors.

    Returns
    -------
    ndarray, shape (runs, count)
        -1 and 1; the number of runs is the next multiple of 4 above ``count``.
    """
    from pydoe import pbdesign

    return np.asarray(pbdesign(count), dtype=float)


def central_composite(count: int, star: str = "inscribed") -> Array:
    """Rotatable central composite design, or the face-centered one (Box and Wilson 1951).

    The center stands once: a simulation repeated is the same simulation. The runs are scaled
    so that none leaves -1 to 1, for the ends of a range are its true limits.

    Parameters
    ----------
    count : int
        Number of factors, at least 2.
    star : {"inscribed", "faced"}
        Whether the star points or the corners and stars lie at the ends of the ranges.
    """
    from pydoe import ccdesign

    runs = ccdesign(count, center=(0, 1), alpha="rotatable", face=star)
    return np.asarray(runs, dtype=float)


#: blocks of factors that vary together (Box and Behnken 1960); the paper's design of nine
#: factors has three of its blocks twice, and a simulation repeated is the same simulation
_BLOCKS: Mapping[int, Sequence[tuple[int, ...]]] = {
    6: ((1, 2, 4), (2, 3, 5), (3, 4, 6), (1, 4, 5), (2, 5, 6), (1, 3, 6)),
    7: ((4, 5, 6), (1, 6, 7), (2, 5, 7), (1, 2, 4), (3, 4, 7), (1, 3, 5), (2, 3, 6)),
    9: (
        *((1, 4, 7), (2, 5, 8), (3, 6, 9), (1, 2, 3), (4, 5, 6), (7, 8, 9)),
        *((1, 5, 9), (3, 4, 8), (2, 6, 7), (1, 6, 8), (2, 4, 9), (3, 5, 7)),
    ),
    10: (
        *((2, 6, 7, 10), (1, 2, 5, 10), (2, 3, 7, 8), (2, 4, 6, 9), (1, 8, 9, 10)),
        *((3, 4, 5, 10), (1, 4, 7, 8), (3, 5, 7, 9), (1, 3, 6, 9), (4, 5, 6, 8)),
    ),
}


def box_behnken(count: int) -> Array:
    """Box-Behnken design with one center run (Box and Behnken 1960, Technometrics 2, 455).

    Within a block of an incomplete block design its factors take all combinations of -1 and 1,
    and all others are 0. Up to five factors, and for eight, which the paper leaves out, the
    blocks are all pairs.

    Parameters
    ----------
    count : int
        Number of factors, at least 3.

    Returns
    -------
    ndarray, shape (runs, count)
        -1, 0 and 1.

    Examples
    --------
    >>> [len(box_behnken(count)) for count in range(3, 11)]
    [13, 25, 41, 49, 57, 113, 97, 161]
    """
    pairs = tuple(itertools.combinations(range(1, count + 1), 2))
    runs = [
        [signs[block.index(k)] if k in block else 0.0 for k in range(1, count + 1)]
        for block in _BLOCKS.get(count, pairs)
        for signs in itertools.product((-1.0, 1.0), repeat=len(block))
    ]
    return np.array([*runs, [0.0] * count])


def latin_hypercube(count: int, runs: int, seed: int) -> Array:
    """Latin hypercube sample in 0 to 1: every factor has one run in each of ``runs`` slices.

    Parameters
    ----------
    count, runs : int
        Number of factors and of runs.
    seed : int
        Of the random generator; the same seed gives the same sample.

    Returns
    -------
    ndarray, shape (runs, count)
        Shares of the ranges of the factors.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    return np.asarray(qmc.LatinHypercube(count, rng=rng).random(runs), dtype=float)


def sobol(count: int, runs: int, seed: int) -> Array:
    """Scrambled Sobol sequence in 0 to 1.

    Parameters
    ----------
    count : int
        Number of factors.
    runs : int
        A power of two, which keeps the balance of the sequence; others are rounded down to one.
    seed : int
        Of the scrambling; the same seed gives the same sample.

    Returns
    -------
    ndarray, shape (runs, count)
        Shares of the ranges of the factors.
    """
    from scipy.stats import qmc

    rng = np.random.default_rng(seed)
    sampler = qmc.Sobol(count, scramble=True, rng=rng)
    return np.asarray(sampler.random_base2(int(runs).bit_length() - 1), dtype=float)


def _ordered(runs: Array) -> Array:
    """Sort the runs as a table: the last basic factor varies fastest."""
    return runs[np.lexsort(runs.T[::-1])]
