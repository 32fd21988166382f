"""Section ``[test]`` of a study file, and the kinds of test that it may name."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated

from pydantic import Field

from study.setup.compression import COMPRESSION
from study.setup.gauge_section import GAUGE_SECTIONS
from study.setup.geometry import FaceMotion, Gravity, Indenter
from study.setup.indentation import INDENTATION
from study.setup.plate_motion import PLATE_MOTION
from study.setup.quantity import Duration, Length, integer, measured, number
from study.setup.section import Reads, as_written, section
from study.setup.test_kind import Interface, Test, TestKind
from study.setup.text import word

#: every kind of test by its name in a file
TEST_KINDS: Mapping[str, TestKind] = {
    "compression": COMPRESSION,
    "indentation": INDENTATION,
    "plate-motion": PLATE_MOTION,
    **GAUGE_SECTIONS,
}

_CONDITIONS = "frictionless", "bonded"
_SYNONYMS = {"lubricated": "frictionless"}


@section
class TestSection:
    """How a specimen is loaded, as far as the file says it.

    Parameters
    ----------
    kind : str
        One of :data:`TEST_KINDS`.
    interface : {"frictionless", "bonded"}
        What holds the specimen where it is loaded.
    base : {"frictionless", "bonded"}, optional
        What holds it below: as above in compression, bonded in indentation, unless given.
    displacement_mm : float, optional
        Final displacement; the end of the measured range may give it.
    steps : int
        Displacements at which the force is asked for.
    indenter : Flat, Cone or Sphere, optional
        Of an indentation.
    speed_mm_per_s : float, optional
        Of the displacement; a material that relaxes resists a fast test more.
    hold_s : float, optional
        How long the final displacement is held.
    cycles : int, optional
        How often it is reached and left again, at the same speed.
    motion : FaceMotion, optional
        Final motion of the plate above besides the displacement, of a plate motion.
    gravity : Gravity, optional
        Weight of the specimen.
    prestretch : float, optional
        Of a simple shear: stretch along the normal of the sheared faces before the test.
    """

    __test__ = False  # not a pytest class

    kind: Annotated[str, word(*TEST_KINDS, mend="compression, ...")]
    interface: Annotated[
        Interface, word(*_CONDITIONS, synonyms=_SYNONYMS, mend="frictionless or bonded")
    ] = "frictionless"
    base: Annotated[Interface, word(*_CONDITIONS, synonyms=_SYNONYMS)] | None = None
    displacement_mm: Length | None = Field(default=None, validation_alias="displacement")
    steps: Annotated[int, Reads(integer(1, 10_000))] = 10
    indenter: Annotated[Indenter | None, as_written()] = None
    speed_mm_per_s: Annotated[float, measured("speed")] | None = Field(
        default=None, validation_alias="speed"
    )
    hold_s: Duration | None = Field(default=None, validation_alias="hold")
    cycles: Annotated[int | None, Reads(integer(1, 1000))] = None
    motion: FaceMotion | None = None
    gravity: Gravity | None = None
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
        depth = self.displacement_mm
        return Test(
            self.kind,
            depth,
            self.interface,
            self.held_below,
            self.steps,
            pressed,
            self.speed_mm_per_s,
            self.hold_s,
            self.cycles,
            self.motion,
            self.gravity,
            self.prestretch,
        )
