"""Compression by a plate that also shifts and turns, and on which the face may spread.

A press is rarely true: its plate shifts across the axis and tilts, and a face that is not glued
slips outwards. All of it is prescribed here, as a rigid motion with small rotations and one
in-plane stretch of the loaded face, so that markers inside a specimen can tell how the plate
really moved.
"""

from __future__ import annotations

from dataclasses import dataclass

from study.setup.compression import Compression
from study.setup.geometry import FaceMotion
from study.setup.test_kind import (
    ClampedCorner,
    FaceCondition,
    Interface,
    PlateContact,
    Test,
    TowardsPlates,
)


@dataclass(frozen=True)
class PlateMotion(Compression):
    """The plate above has all six rigid motions, in proportion to the axial displacement.

    The force is the one that does the work of the whole motion, per unit of the displacement:
    sideways forces and moments stand in it with their share of the motion.
    """

    compresses: bool = False

    def usual_base(self, interface: Interface) -> Interface:
        """Specimens are fixed to what they stand on."""
        return "bonded"

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Prescribe every component above; the face below is held, or slides."""
        share = 1.0 / test.displacement_mm if test.displacement_mm else 0.0  # open for now
        besides = test.motion or FaceMotion()
        return (
            FaceCondition("top", self.sense, True, besides=besides, share_per_mm=share),
            FaceCondition("base", 0.0, test.base == "bonded"),
        )

    def contacts(self, test: Test) -> tuple[PlateContact, ...]:
        """Bulging sides may fold onto a plate; the loaded face is held in either case."""
        return (PlateContact("top", True), PlateContact("base", test.base == "bonded"))

    def has_middle_plane(self, test: Test) -> bool:
        """Tell that only the plate above moves sideways."""
        return False

    def grading(self, test: Test) -> TowardsPlates:
        """Small at the rims of faces that are held."""
        return TowardsPlates(True, test.base == "bonded")

    def is_homogeneous(self, test: Test) -> bool:
        """Never."""
        return False

    def singularities(self, test: Test) -> tuple[ClampedCorner, ...]:
        """Rim of the loaded face."""
        return (ClampedCorner(),)


PLATE_MOTION = PlateMotion()
