"""Course of a test in time: a ramp at one speed, and what follows it, a hold or cycles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.setup.test_kind import Test

#: first row of a hold over its duration: rows are even on a logarithmic scale, as relaxation is
_FIRST_OF_HOLD = 1e-3


@dataclass(frozen=True)
class Course:
    """Displacements at the times of rows; linear in between, at rest before.

    Parameters
    ----------
    displacement_mm, time_s : ndarray, shape (n,)
        The unloaded begin at 0 s is left out.
    """

    displacement_mm: Array
    time_s: Array


def course_of(test: Test) -> Course | None:
    """Course that a test prescribes; None without a speed.

    Parameters
    ----------
    test : Test
        ``steps`` rows for the ramp, as many for a hold, and for every way of a cycle.

    Examples
    --------
    >>> ramp = Test("tension", 4.0, steps=2, speed_mm_per_s=0.5, cycles=1)
    >>> found = course_of(ramp)
    >>> found.displacement_mm, found.time_s
    (array([2., 4., 2., 0.]), array([ 4.,  8., 12., 16.]))
    """
    speed = test.speed_mm_per_s
    if speed is None:
        return None
    share = np.arange(1, test.steps + 1) / test.steps
    ramp = test.depth_mm / speed
    if test.cycles is not None:
        once = np.concatenate([share, 1 - share])
        time = (np.arange(2 * test.cycles)[:, None] + share).ravel() * ramp
        return Course(test.depth_mm * np.tile(once, test.cycles), time)
    displacement, time = test.depth_mm * share, ramp * share
    if test.hold_s is not None:
        held = test.hold_s * np.geomspace(_FIRST_OF_HOLD, 1.0, test.steps)
        displacement = np.append(displacement, np.full(test.steps, test.depth_mm))
        time = np.append(time, ramp + held)
    return Course(displacement, time)
