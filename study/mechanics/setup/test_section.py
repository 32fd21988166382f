"""Section ``[test]`` of a study file, and the kinds of test that it may name."""

from __future__ import annotations

from typing import Annotated

import numpy as np

from study.ground.arrays import Array
from study.mechanics.setup.declaration import (
    Duration,
    Length,
    Reads,
    as_written,
    integer,
    measured,
    number,
    section,
    values_of,
    word,
)
from study.mechanics.setup.geometry import FaceMotion, Gravity, Indenter
from study.mechanics.setup.test_kind import Interface, Test
from study.mechanics.setup.test_kinds import TEST_KINDS

_CONDITIONS = "frictionless", "bonded"
_SYNONYMS = {"lubricated": "frictionless"}


@section
class TestSection:
    """How a specimen is loaded, as far as the file says it."""

    __test__ = False  # not a pytest class

    #: One of :data:`TEST_KINDS`.
    kind: Annotated[str, word(*TEST_KINDS, mend="compression, ...")]
    #: What holds the specimen where it is loaded.
    interface: Annotated[
        Interface, word(*_CONDITIONS, synonyms=_SYNONYMS, mend="frictionless or bonded")
    ] = "frictionless"
    #: What holds it below: as above in compression, bonded in
    #: indentation, unless given.
    base: Annotated[Interface, word(*_CONDITIONS, synonyms=_SYNONYMS)] | None = None
    #: Final displacement; the end of the measured range may give it.
    displacement_mm: Length | None = None
    #: Displacements at which the force is asked for.
    steps: Annotated[int, Reads(integer(1, 10_000))] = 10
    #: Of an indentation.
    indenter: Annotated[Indenter | None, as_written()] = None
    #: Of the displacement; a material that relaxes resists a fast test more.
    speed_mm_per_s: Annotated[float, measured("speed")] | None = None
    #: How long the final displacement is held.
    hold_s: Duration | None = None
    #: How often it is reached and left again, at the same speed.
    cycles: Annotated[int | None, Reads(integer(1, 1000))] = None
    #: Final motion of the plate above besides the displacement, of a plate motion.
    motion: FaceMotion | None = None
    #: Weight of the specimen.
    gravity: Gravity | None = None
    #: Of a simple shear: stretch along the normal of the sheared faces before the test.
    prestretch: Annotated[float, Reads(number(0.2, 5.0))] | None = None

    @property
    def held_below(self) -> Interface:
        """Condition of the base, also where the file leaves it to the kind of the test."""
        if self.base is not None:
            return self.base
        kind = TEST_KINDS.get(self.kind)  # a faulty file may leave it out
        return self.interface if kind is None else kind.usual_base(self.interface)

    def loading(self) -> Test:
        """Test that the section describes; its displacement may still be open."""
        pressed = self.indenter if TEST_KINDS[self.kind].takes_indenter else None
        return Test(**{**values_of(self), "base": self.held_below, "indenter": pressed})  # type: ignore[arg-type]


# Course of a test in time: a ramp at one speed, and what follows it, a hold or cycles.

#: first row of a hold over its duration: rows are even on a logarithmic scale, as relaxation is
_FIRST_OF_HOLD = 1e-3


def course_of(test: Test) -> tuple[Array, Array] | None:
    """Displacements and times that a test prescribes; None without a speed.

    Displacement is linear between the rows; the unloaded begin at 0 s is left out.
    Shapes: returns (n,), mm and s.

    Examples
    --------
    >>> ramp = Test("tension", 4.0, steps=2, speed_mm_per_s=0.5, cycles=1)
    >>> course_of(ramp)
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
        return test.depth_mm * np.tile(once, test.cycles), time
    displacement, time = test.depth_mm * share, ramp * share
    if test.hold_s is not None:
        held = test.hold_s * np.geomspace(_FIRST_OF_HOLD, 1.0, test.steps)
        displacement = np.append(displacement, np.full(test.steps, test.depth_mm))
        time = np.append(time, ramp + held)
    return displacement, time
