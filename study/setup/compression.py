"""Compression between two rigid plates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault
from study.setup.load_steps import StepRule, StepSettings
from study.setup.test_kind import (
    ClampedCorner,
    FaceCondition,
    Interface,
    PlateContact,
    Test,
    TowardsPlates,
)

#: points of a range of stretches at which stability is looked at
STRETCHES = 41


@dataclass(frozen=True)
class Compression:
    """Plates approach each other by the displacement; each may be bonded."""

    takes_indenter: bool = False
    compresses: bool = True
    shears: bool = False
    strains_locally: bool = False
    sense: float = -1.0
    mode: str = "uniaxial"
    needs_homogeneous: bool = False

    def usual_base(self, interface: Interface) -> Interface:
        """Both plates are alike."""
        return interface

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Let the plate above move and the one below stand."""
        return (
            FaceCondition("top", self.sense, test.interface == "bonded"),
            FaceCondition("base", 0.0, test.base == "bonded"),
        )

    def contacts(self, test: Test) -> tuple[PlateContact, ...]:
        """Bulging sides may fold onto a plate, a round end comes to lie in it."""
        return (
            PlateContact("top", test.interface == "bonded"),
            PlateContact("base", test.base == "bonded"),
        )

    def has_middle_plane(self, test: Test) -> bool:
        """Between plates of one kind."""
        return test.interface == test.base

    def grading(self, test: Test) -> TowardsPlates:
        """Small at the rims of bonded faces."""
        return TowardsPlates(test.interface == "bonded", test.base == "bonded")

    def steps(self, test: Test, height_mm: float, settings: StepSettings) -> StepRule:
        """Shares of the height."""
        largest = settings.largest * height_mm
        return StepRule(settings, largest, largest)

    def is_homogeneous(self, test: Test) -> bool:
        """Between frictionless plates."""
        return test.interface == test.base == "frictionless"

    def stretches(self, test: Test, height_mm: float) -> Array:
        """From the end of the test to none."""
        return np.linspace(1 - test.depth_mm / height_mm, 1.0, STRETCHES)

    def singularities(self, test: Test) -> tuple[ClampedCorner, ...]:
        """Rim of a bonded face."""
        return (ClampedCorner(),) if "bonded" in (test.interface, test.base) else ()

    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Plates cannot meet."""
        return beyond_height(test, height_mm)


def beyond_height(test: Test, height_mm: float) -> Iterator[Fault]:
    """Refuse a displacement into a specimen that reaches its height.

    Parameters
    ----------
    test : Test
        With a known displacement.
    height_mm : float
        Height of the specimen, mm.

    Yields
    ------
    Fault
        Only where the displacement is not smaller than the height.
    """
    depth = test.depth_mm
    if depth >= height_mm:
        rule = f"{depth:g} mm is not smaller than the specimen's height, {height_mm:g} mm"
        yield Fault("test.displacement", rule, "press less deep")


COMPRESSION = Compression()
