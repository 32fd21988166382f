"""The first loading of a test that was also unloaded, once or in cycles.

A soft material gives less force on the way back (hysteresis), and less again in a second cycle
(Mullins 1969, Rubber Chem. Technol. 42, 339). Rows of several branches, sorted by displacement,
would be a curve that nobody measured.
"""

from __future__ import annotations

import numpy as np

from study.arrays import Array

#: share of the travel by which a machine must go back to have turned; less is jitter
TURN = 0.1
#: rows that a branch has at least: fewer are rows out of order, not a way that a machine went
BRANCH_ROWS = 3


def last_of_loading(displacement_mm: Array) -> int:
    """Row at which the first loading ends: the last one of a test that was only loaded.

    Rows that stand in no order, or begin far from where the test begins, have no loading branch
    and are all kept.

    Parameters
    ----------
    displacement_mm : ndarray, shape (rows,)
        In the order of the recording, in either direction.

    Returns
    -------
    int
        Index of the row.

    Examples
    --------
    >>> last_of_loading(np.array([0.0, 1, 2, 3, 4, 3, 2, 1, 0]))
    4
    >>> last_of_loading(np.array([0.0, 3, 1, 4, 2]))
    4
    """
    d = np.abs(displacement_mm)
    everything = d.size - 1
    turns = _turns(d, TURN * float(np.ptp(d)))
    ends = [0, *turns, everything]
    if not turns or min(np.diff(ends)) < BRANCH_ROWS:
        return everything
    begins_low = d[0] <= d.min() + TURN * float(np.ptp(d))
    return turns[0] if begins_low else everything


def _turns(d: Array, least: float) -> list[int]:
    """Rows at which the displacement turns, by at least so much."""
    turns: list[int] = []
    start, sense = 0, 1.0
    while True:
        way = sense * d[start:]
        furthest = np.maximum.accumulate(way)
        back = np.flatnonzero(furthest - way > least)
        if not back.size:
            return turns
        row = int(back[0])
        turns.append(start + int(np.flatnonzero(way[:row] == furthest[row])[-1]))
        start, sense = start + row, -sense
