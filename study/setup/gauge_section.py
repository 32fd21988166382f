"""Tests of material on a gauge section that deforms the same everywhere.

Tension, equibiaxial and planar tension (pure shear), simple shear, volumetric and confined
compression. They have a closed form for every energy and need no elements.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault
from study.material.loading import sheared_stretches
from study.setup.load_steps import StepRule, StepSettings
from study.setup.test_kind import (
    Contact,
    FaceCondition,
    Interface,
    Singularity,
    Test,
    TowardsPlates,
)

#: points of a range of stretches at which stability is looked at
STRETCHES = 41


@dataclass(frozen=True)
class GaugeSection:
    """A test of material.

    Parameters
    ----------
    mode : str
        Deformation, one of :data:`study.material.loading.LOADINGS`.
    sense : float
        Elongation per displacement: -1 shortens, 1 lengthens or shears.
    """

    mode: str
    sense: float = 1.0
    takes_indenter: bool = False
    compresses: bool = False
    strains_locally: bool = False
    needs_homogeneous: bool = True

    @property
    def shears(self) -> bool:
        """Whether it is a simple shear."""
        return self.mode == "simple-shear"

    def usual_base(self, interface: Interface) -> Interface:
        """Without meaning: nothing holds a gauge section but its own material."""
        return interface

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Return none: no elements."""
        return ()

    def contacts(self, test: Test) -> tuple[Contact, ...]:
        """Return none."""
        return ()

    def has_middle_plane(self, test: Test) -> bool:
        """Every plane is one."""
        return True

    def grading(self, test: Test) -> TowardsPlates:
        """Even."""
        return TowardsPlates(False, False)

    def steps(self, test: Test, height_mm: float, settings: StepSettings) -> StepRule:
        """Shares of the length."""
        largest = settings.largest * height_mm
        return StepRule(settings, largest, largest)

    def is_homogeneous(self, test: Test) -> bool:
        """By definition."""
        return True

    def stretches(self, test: Test, height_mm: float) -> Array:
        """Stretches of the loaded direction, for a shear those of its longest line."""
        share = self.sense * test.depth_mm / height_mm
        if self.shears:
            longest = sheared_stretches(np.array([share]), test.prestretch or 1.0)[0]
            return np.linspace(1.0, longest[0], STRETCHES)
        return np.linspace(1.0, 1.0 + share, STRETCHES)

    def singularities(self, test: Test) -> tuple[Singularity, ...]:
        """Return none."""
        return ()

    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Elements were asked for."""
        rule = "is a test of a gauge section and has a closed form, which finite elements are not"
        yield Fault("test.kind", rule, 'write specimen.shape = "homogeneous"')


#: every test of material by its name in a file
GAUGE_SECTIONS = {
    "tension": GaugeSection("uniaxial"),
    "equibiaxial": GaugeSection("equibiaxial"),
    "planar": GaugeSection("planar"),
    "simple-shear": GaugeSection("simple-shear"),
    "volumetric": GaugeSection("volumetric", -1.0),
    "confined-compression": GaugeSection("confined", -1.0),
}
