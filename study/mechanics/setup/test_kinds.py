"""Compression between two rigid plates."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.mechanics.material.homogeneous import sheared_stretches
from study.mechanics.setup.geometry import Block, Cylinder, FaceMotion, Indenter, Specimen
from study.mechanics.setup.test_kind import (
    ContactRim,
    FaceCondition,
    IndenterContact,
    Interface,
    PlateContact,
    RoundedEdge,
    SharpEdge,
    Singularity,
    StepRule,
    StepSettings,
    Test,
    TestKind,
)

#: points of a range of stretches at which stability is looked at
_STRETCHES = 41

#: stretch of a cube whose surface folds under its own compression (Biot 1963): no column is
#: pressed further before something else gives way
LEAST_STRETCH = 0.544


@dataclass(frozen=True)
class Compression(TestKind):
    """Plates approach each other by the displacement; each may be bonded."""

    compresses: bool = True

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
        return tuple(PlateContact(face.face, face.is_held) for face in self.faces(test))

    def has_middle_plane(self, test: Test) -> bool:
        """Between plates of one kind."""
        return test.interface == test.base

    def is_homogeneous(self, test: Test) -> bool:
        """Between frictionless plates."""
        return test.interface == test.base == "frictionless"

    def stretches(self, test: Test, height_mm: float) -> Array:
        """From the end of the test to none."""
        return np.linspace(1 - test.depth_mm / height_mm, 1.0, _STRETCHES)

    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Plates cannot meet."""
        return beyond_height(test, height_mm)


def beyond_height(test: Test, height_mm: float) -> Iterator[Fault]:
    """Refuse a displacement into a specimen that reaches its height."""
    depth = test.depth_mm
    if depth >= height_mm:
        rule = f"{depth:g} mm is not smaller than the specimen's height, {height_mm:g} mm"
        yield Fault("test.displacement", rule, "press less deep")


def buckling_strain(test: Test, specimen: Specimen) -> float | None:
    """Compression per height at which a column sways; None where it is none, or never does.

    Euler's load pi^2 E I / (k H)^2 of an incompressible neo-Hookean column, where k is 1/2 between
    bonded plates, and 1 where one lets it slide. Shear, which lowers it, and the thickness gained
    by compression, which raises it, make up for one another: within 2 % of elements at 10 mm over
    100, 5 % at 10 mm over 40.
    """
    if not isinstance(specimen, Cylinder | Block) or test.motion is not None:
        return None
    thin = specimen.half_width_mm / specimen.height_mm
    if test.kind != "compression" or not thin > 0:
        return None
    square = thin**2 / (4.0 if isinstance(specimen, Cylinder) else 3.0)  # I / (A H^2)
    free = 0.5 if test.interface == test.base == "bonded" else 1.0
    stress = np.pi**2 * square / free**2  # over E = 3 G
    stretches = np.linspace(1.0, LEAST_STRETCH, 2001)
    beyond = (1 / stretches**2 - stretches) / 3 >= stress
    return float(1 - stretches[beyond.argmax()]) if beyond.any() else None


# Indentation of a specimen on a rigid support by a rigid body of revolution.

#: stretches around an indenter in which a material must at least be stable
LOWEST_STRETCH = 0.8
HIGHEST_STRETCH = 1.2


@dataclass(frozen=True)
class Indentation(TestKind):
    """An indenter comes down by the displacement; it may keep hold of what it touches."""

    takes_indenter: bool = True
    strains_locally: bool = True

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Support, and the disc that a bonded flat face moves."""
        support = FaceCondition("base", 0.0, test.base == "bonded")
        if not holds_face(test):
            return (support,)
        radius = indenter_of_test(test).face_radius_mm
        return (support, FaceCondition("top", self.sense, True, within_mm=radius))

    def contacts(self, test: Test) -> tuple[IndenterContact, ...]:
        """Indenter, unless it holds from the start all that it will ever hold."""
        if test.indenter is None or holds_face(test):
            return ()
        return (IndenterContact(test.indenter, test.interface == "bonded"),)

    def steps(self, test: Test, height_mm: float, settings: StepSettings) -> StepRule:
        """Shares of the indenter's own length; those of what sticks are small and even."""
        length = test.depth_mm
        if test.indenter is not None:
            length = test.indenter.step_length_mm(length)
        if test.interface == "bonded":
            share = settings.held_face if holds_face(test) else settings.sticking
            largest = min(settings.largest * height_mm, share * length)
            return StepRule(settings, largest, largest)
        first, largest = settings.first_touch * length, settings.largest_touch * length
        return StepRule(settings, first, largest, settings.deeper)

    def stretches(self, test: Test, height_mm: float) -> Array:
        """About none: larger ones are reached at single places only."""
        return np.linspace(LOWEST_STRETCH, HIGHEST_STRETCH, _STRETCHES)

    def singularities(self, test: Test) -> tuple[Singularity, ...]:
        """Edge of a flat face, or the rim of a smooth contact."""
        pressed = indenter_of_test(test)
        if pressed.is_sharp_edged:
            return (SharpEdge("sharp edge"),)
        if holds_face(test):
            return (SharpEdge("rim of the bonded face"),)
        return (RoundedEdge(pressed.rounding_mm) if pressed.has_face else ContactRim(),)

    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Depth, shape of the indenter, and what it could touch."""
        yield from beyond_height(test, height_mm)
        pressed = indenter_of_test(test)
        yield from pressed.faults()
        reach = pressed.reach_mm(test.depth_mm)
        if reach > half_width_mm:
            rule = f"the indenter touches up to {reach:g} mm from the axis, beyond"
            mend = "use a smaller indenter or a wider specimen"
            yield Fault("test.indenter", f"{rule} {half_width_mm:g} mm", mend)


def holds_face(test: Test) -> bool:
    """Whether a flat indenter sticks: it has hold of all that it will hold at once."""
    return test.interface == "bonded" and test.indenter is not None and test.indenter.has_face


def indenter_of_test(test: Test) -> Indenter:
    """Indenter of a test."""
    if test.indenter is None:
        mend = "give shape and radius"
        raise InputError(Fault("test.indenter", "an indentation needs an indenter", mend))
    return test.indenter


# Tests of material on a gauge section that deforms the same everywhere: a closed form for every
# energy, no elements.


@dataclass(frozen=True)
class GaugeSection(TestKind):
    """A test of material; no elements."""

    sense: float = 1.0
    needs_homogeneous: bool = True

    def usual_base(self, interface: Interface) -> Interface:
        """Without meaning: nothing holds a gauge section but its own material."""
        return interface

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Return none: no elements."""
        return ()

    def has_middle_plane(self, test: Test) -> bool:
        """Every plane is one."""
        return True

    def is_homogeneous(self, test: Test) -> bool:
        """By definition."""
        return True

    def stretches(self, test: Test, height_mm: float) -> Array:
        """Stretches of the loaded direction, for a shear those of its longest line."""
        share = self.sense * test.depth_mm / height_mm
        if self.shears:
            longest = sheared_stretches(np.array([share]), test.prestretch or 1.0)[0]
            return np.linspace(1.0, longest[0], _STRETCHES)
        return np.linspace(1.0, 1.0 + share, _STRETCHES)

    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Elements were asked for."""
        rule = "is a test of a gauge section and has a closed form, which finite elements are not"
        yield Fault("test.kind", rule, 'write specimen.shape = "homogeneous"')


# Compression by a plate that also shifts and turns, and on which the face may spread: a rigid
# motion with small rotations and one in-plane stretch of the loaded face.


@dataclass(frozen=True)
class PlateMotion(Compression):
    """The plate above has all six rigid motions, in proportion to the axial displacement.

    The force is the one that does the work of the whole motion, per unit of the displacement:
    sideways forces and moments stand in it with their share of the motion.
    """

    compresses: bool = False

    usual_base = TestKind.usual_base
    has_middle_plane = TestKind.has_middle_plane
    is_homogeneous = TestKind.is_homogeneous

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Prescribe every component above; the face below is held, or slides."""
        share = 1.0 / test.displacement_mm if test.displacement_mm else 0.0  # open for now
        besides = test.motion or FaceMotion()
        return (
            FaceCondition("top", self.sense, True, besides=besides, share_per_mm=share),
            FaceCondition("base", 0.0, test.base == "bonded"),
        )


#: every kind of test by its name in a file
TEST_KINDS: dict[str, TestKind] = {
    "compression": Compression(),
    "indentation": Indentation(),
    "plate-motion": PlateMotion(),
    "tension": GaugeSection(),
    "equibiaxial": GaugeSection(mode="equibiaxial"),
    "planar": GaugeSection(mode="planar"),
    "biaxial": GaugeSection(mode="biaxial"),
    "simple-shear": GaugeSection(mode="simple-shear", shears=True),
    "volumetric": GaugeSection(mode="volumetric", sense=-1.0),
    "confined-compression": GaugeSection(mode="confined", sense=-1.0),
}
