"""Slopes of a cubic Hermite interpolant that is monotone where its data are.

A cubic with the right values and slopes at both ends may still overshoot between them. Fritsch and
Carlson (1980, SIAM J. Numer. Anal. 17, 238-246) say when it does not: with a and b the slopes at
the ends over that of the chord, when a + b <= 2, or 2a + b <= 3, or a + 2b <= 3, or
a - (2a + b - 3)^2 / (3 (a + b - 2)) >= 0.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from study.arrays import Array

#: Slopes up to this multiple of that of the chord make a monotone cubic, whatever the other one is
#: below it (Fritsch and Carlson 1980, section 4).
STEEPEST = 3.0


def monotone_slopes(knots: Array, values: Array, slopes: Array) -> Array:
    """Slopes limited only in intervals where the interpolant would leave its monotone data.

    Data count as monotone in an interval where the slopes at both its ends have the sign of the
    chord: there the simulation rises, or falls, all the way as far as anybody knows.

    Parameters
    ----------
    knots, values, slopes : ndarray, shape (n,)
        Increasing places, the values there, and the derivatives there.

    Returns
    -------
    ndarray, shape (n,)
        The slopes, smaller in size where they had to be.

    Examples
    --------
    >>> d = np.array([0.0, 1.0, 2.0])
    >>> monotone_slopes(d, d**2, 2 * d)
    array([0., 2., 4.])
    >>> monotone_slopes(d, np.array([0.0, 1.0, 1.1]), np.array([1.0, 4.0, 0.1]))
    array([1. , 0.3, 0.1])
    """
    found = slopes.astype(float)
    chords = np.diff(values) / np.diff(knots)
    rising = _is_monotone_data(chords, found)
    # an interval that is limited may take its neighbor's slope away; each is limited once at most
    for _ in range(chords.size):
        outside = np.flatnonzero(rising & ~is_monotone(chords, found))
        if not outside.size:
            break
        for k in outside:
            found[k : k + 2] = _limited(chords[k], found[k : k + 2])
    return found


def is_monotone(chords: Array, slopes: Array) -> NDArray[np.bool_]:
    """Whether the cubic of every interval is monotone.

    Parameters
    ----------
    chords : ndarray, shape (n - 1,)
        Slope of the chord of every interval.
    slopes : ndarray, shape (n,)
        Derivatives at the knots.

    Returns
    -------
    ndarray of bool, shape (n - 1,)
        The exact condition, not only one that suffices.
    """
    flat = chords == 0
    safe = np.where(flat, 1.0, chords)
    a, b = slopes[:-1] / safe, slopes[1:] / safe
    sums = a + b - 2
    # the minimum of the derivative inside the interval, where it has one
    lowest = a - (2 * a + b - 3) ** 2 / (3 * np.where(sums > 0, sums, 1.0))
    inside = (sums <= 0) | (2 * a + b <= 3) | (a + 2 * b <= 3) | (lowest >= 0)
    still = (slopes[:-1] == 0) & (slopes[1:] == 0)
    return np.asarray(np.where(flat, still, (a >= 0) & (b >= 0) & inside))


def _is_monotone_data(chords: Array, slopes: Array) -> NDArray[np.bool_]:
    """Whether values and slopes of every interval have one direction."""
    sign = np.sign(chords)
    return np.asarray((sign * slopes[:-1] >= 0) & (sign * slopes[1:] >= 0))


def _limited(chord: float, pair: Array) -> Array:
    """Slopes at both ends of an interval, none steeper than a multiple of the chord's."""
    return np.asarray(np.sign(chord) * np.minimum(np.abs(pair), STEEPEST * abs(chord)))
