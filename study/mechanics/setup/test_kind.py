"""Tests as data: what moves, what touches, where elements are small, which corners are singular.

A test (:class:`Test`) says what one specimen goes through. Its kind (:class:`TestKind`) turns that
into conditions, contacts and sizes, and is all that the finite-element model knows of it. A kind
is added as a class and an entry of :data:`TEST_KINDS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from study.ground.arrays import Array
from study.ground.declaration import (
    Duration,
    Length,
    Reads,
    as_written,
    choice,
    integer,
    measured,
    number,
    section,
    word,
)
from study.ground.errors import Fault, InputError
from study.mechanics.material.homogeneous import sheared_stretches
from study.mechanics.setup.geometry import Block, Cylinder, FaceMotion, Gravity, Indenter, Specimen

# The load steps of a test, and the settings of the iteration that go with its size.


@dataclass(frozen=True)
class StepSettings:
    """Load steps as fractions of a length of the test.

    A step grows after few Newton iterations, shrinks after many and is halved on failure;
    the run ends as ``not-converged`` when a step falls below ``smallest``.
    """

    #: Largest step between plates over the specimen's height.
    largest: float = 0.06
    #: First and largest step of an indentation over the indenter's own length.
    first_touch: float = 0.15
    largest_touch: float = 0.25
    #: Largest step of an indenter that holds what it touches: where a point is held depends on the
    #: step in which it was met. Forces of cones were 0.2 to 0.9 % low at 0.125, in proportion to
    #: the step.
    sticking: float = 0.015
    #: The same of a flat indenter, which holds its face from the start.
    held_face: float = 0.125
    #: Largest step over the depth reached, where that is more: a cone looks the same at every
    #: depth.
    deeper: float = 0.08
    #: Smallest step over the largest one.
    smallest: float = 0.03
    growth: float = 1.6
    easy: int = 4
    hard: int = 14


@dataclass(frozen=True)
class StepRule:
    """Step settings with the lengths of one test (mm)."""

    #: As fractions.
    settings: StepSettings
    #: First step, and the largest one at no depth.
    first_mm: float
    base_mm: float
    #: Largest step over the depth reached, where that is more.
    deeper: float = 0.0

    def largest_mm(self, depth_mm: float) -> float:
        """Largest step at a depth."""
        return max(self.base_mm, self.deeper * depth_mm)

    def smallest_mm(self) -> float:
        """Step below which the run gives up."""
        return self.settings.smallest * self.base_mm

    def next_mm(self, step_mm: float, last_mm: float, iterations: int, depth_mm: float) -> float:
        """Step after one of ``last_mm`` that took ``iterations``."""
        rule = self.settings
        if iterations <= rule.easy:
            return min(self.largest_mm(depth_mm), max(step_mm, last_mm * rule.growth))
        return 0.7 * last_mm if iterations > rule.hard else step_mm


Interface = Literal["frictionless", "bonded"]
Face = Literal["top", "base"]
_CONDITIONS = "frictionless", "bonded"
_SYNONYMS = {"lubricated": "frictionless"}


def _kind(value: object) -> str:
    return choice(*TEST_KINDS)(value)


@section
class Test:
    """How a specimen is loaded, of which a file leaves a part to the kind of the test.

    Its displacement is None where the measurements have yet to say it.
    """

    __test__ = False  # not a pytest class

    #: One of :data:`TEST_KINDS`.
    kind: Annotated[str, Reads(_kind, mend="compression, ...", given=_kind)]
    #: Final displacement; the end of the measured range may give it.
    displacement_mm: Length | None = None
    #: What holds the specimen where it is loaded.
    interface: Annotated[
        Interface, word(*_CONDITIONS, synonyms=_SYNONYMS, mend="frictionless or bonded")
    ] = "frictionless"
    #: What holds it below: as above in compression, bonded in
    #: indentation, unless given.
    base: Annotated[Interface, word(*_CONDITIONS, synonyms=_SYNONYMS)] | None = None
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

    def __post_init__(self) -> None:
        if self.base is None:
            object.__setattr__(self, "base", TEST_KINDS[self.kind].usual_base(self.interface))

    @property
    def weight_N_mm3(self) -> float:  # noqa: N802
        """Upward force on a unit of the specimen's volume; 0 without gravity."""
        return 0.0 if self.gravity is None else self.gravity.upward_N_mm3

    @property
    def depth_mm(self) -> float:
        """Final displacement, which must be known by now."""
        if self.displacement_mm is None:
            mend = "give it, or a measurements.range that ends where the test should"
            raise InputError(Fault("test.displacement", "the test needs a displacement", mend))
        return float(self.displacement_mm)

    def to_depth(self, displacement_mm: float | None = None) -> Test:
        """Return the test with a displacement where it has none; one of the two must give it."""
        depth = displacement_mm if self.displacement_mm is None else self.displacement_mm
        deeper = replace(self, displacement_mm=depth)
        return replace(deeper, displacement_mm=deeper.depth_mm)


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


@dataclass(frozen=True)
class FaceCondition:
    """Motion that a test prescribes for the nodes of a face."""

    #: {"top", "base"}: highest or lowest plane of the specimen.
    face: Face
    #: Motion along the axis, upwards, per unit of the test's displacement.
    axial: float
    #: Whether nodes keep their place across the axis; they slide otherwise.
    is_held: bool
    #: Only nodes within this radius of the axis.
    within_mm: float | None = None
    #: Final motion, besides that along the axis, of nodes that are held. A face that has one, be
    #: it zero, follows no symmetry: the whole specimen is meshed.
    besides: FaceMotion | None = None
    #: Part of that motion per unit of the test's displacement.
    share_per_mm: float = 0.0


@dataclass(frozen=True)
class PlateContact:
    """Free surface that may fold onto, or come to lie in, the plane of a plate."""

    #: {"top", "base"}: where the plate is.
    face: Face
    #: Whether the plate holds the face that lies in it from the start.
    is_bonded: bool


@dataclass(frozen=True)
class IndenterContact:
    """Loaded surface that a rigid body of revolution may meet."""

    #: Comes down along the axis by the test's displacement.
    indenter: Indenter
    #: Whether it keeps hold of every point that it has touched.
    is_bonded: bool


Contact = PlateContact | IndenterContact


@dataclass(frozen=True)
class TowardsPlates:
    """Elements of one size, smaller towards the rims of bonded faces."""

    #: Whether the face is bonded.
    top: bool
    base: bool


@dataclass(frozen=True)
class AroundContact:
    """Elements that grow from the contact with an indenter outwards."""

    #: At whose contact elements are smallest.
    indenter: Indenter
    #: Depth that the sizes are made for.
    depth_mm: float


MeshGrading = TowardsPlates | AroundContact


@dataclass(frozen=True)
class Singularity:
    """Place of the surface that limits the order of the force."""

    #: Right angle between a bonded and a free face, edge of a rigid face where the pressure goes as
    #: the inverse root of the distance, or rim of a smooth contact.
    kind: Literal["clamped corner", "edge", "rim"]
    #: Of a sharp edge, as a sentence calls it; radius of a rounded one, which looks sharp to
    #: elements as large.
    name: str = ""
    rounding_mm: float = 0.0


@dataclass(frozen=True, kw_only=True)
class TestKind(ABC):
    """A kind of test: everything that sets it apart from others, as data.

    Parameters
    ----------
    takes_indenter : bool
        Whether a test of this kind needs an indenter.
    compresses : bool
        Whether two plates shorten the specimen along its axis, and do nothing else.
    strains_locally : bool
        Whether single places are stretched several times: elements are stabilized there.
    sense : float
        Elongation of a homogeneous specimen per displacement: -1 shortens, 1 lengthens or shears.
    mode : str
        Deformation of a homogeneous specimen, one of ``LOADINGS``.
    needs_homogeneous : bool
        Whether the test is one of a gauge section, which no finite elements simulate.
    """

    __test__ = False  # not a pytest class

    takes_indenter: bool = False
    compresses: bool = False
    strains_locally: bool = False
    sense: float = -1.0
    mode: str = "uniaxial"
    needs_homogeneous: bool = False

    @property
    def shears(self) -> bool:
        """Whether it is a simple shear, which may be preceded by a stretch."""
        return self.mode == "simple-shear"

    def usual_base(self, interface: Interface) -> Interface:
        """Condition of the base where a file leaves it out: fixed to what it lies on."""
        return "bonded"

    @abstractmethod
    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Prescribed motions."""

    def contacts(self, test: Test) -> tuple[Contact, ...]:
        """Rigid bodies that the surface may meet."""
        return ()

    def has_middle_plane(self, test: Test) -> bool:
        """Whether the lower half is the mirror image of the upper one."""
        return False

    def steps(self, test: Test, height_mm: float, settings: StepSettings) -> StepRule:
        """Load steps of a specimen of some height: shares of it."""
        largest = settings.largest * height_mm
        return StepRule(settings, largest, largest)

    def is_homogeneous(self, test: Test) -> bool:
        """Whether a cylinder or block deforms the same everywhere, in uniaxial stress."""
        return False

    @abstractmethod
    def stretches(self, test: Test, height_mm: float) -> Array:
        """Axial stretches in which the material must be stable, shape (n,)."""

    def singularities(self, test: Test) -> tuple[Singularity, ...]:
        """Corners and edges that limit the order of the force: usually rims of held faces."""
        is_held = any(face.is_held for face in self.faces(test))
        return (Singularity("clamped corner"),) if is_held else ()

    @abstractmethod
    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Say why a specimen of this height and half-width cannot go through the test."""


# Compression between two rigid plates.

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
        rule = f"{depth:g} mm reaches the height of the specimen, {height_mm:g} mm"
        yield Fault("test.displacement", rule, "make it smaller than specimen.height")


#: what is said of a column of a linear-elastic material beyond Euler's load
NEVER_BUCKLES = (
    "a linear-elastic material, made for small strains, never buckles: its force is that of a "
    "column that is held straight; use neo-hookean for one that is not"
)


def weight_strain(test: Test, height_mm: float, shear_modulus_MPa: float) -> float:  # noqa: N803
    """Largest compression by the weight of a specimen whose plates hold both faces, about."""
    return abs(test.weight_N_mm3) * height_mm / 2 / (3 * shear_modulus_MPa)


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
            return (Singularity("edge", "sharp edge"),)
        if holds_face(test):
            return (Singularity("edge", "rim of the bonded face"),)
        rounded = Singularity("edge", rounding_mm=pressed.rounding_mm)
        return (rounded if pressed.has_face else Singularity("rim"),)

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


#: elements over the contact radius (or the radius of a face) that still resolve what is touched:
#: with more the force under a sphere, a cone and a rounded punch was 1 to 900 % too high
_CONTACT_SHARE = 0.5
_FACE_SHARE = 0.25
#: up to so many times larger ones quadratic elements were 1 to 6 % off, linear ones 54 to 68 %
_NEARLY = 2.0


def unresolved_contact(test: Test, mesh_size_mm: float | None) -> str:
    """Say that elements are too large for what an indenter touches at the end; empty if not.

    A rounded face is followed by elements of its rounding; a sharp one is met by an edge of them.
    """
    pressed, depth_mm = test.indenter, test.displacement_mm
    if pressed is None or depth_mm is None or mesh_size_mm is None or holds_face(test):
        return ""
    radius_mm = pressed.contact_radius_mm(depth_mm)
    most_mm = _CONTACT_SHARE * radius_mm
    if pressed.has_face:
        most_mm = max(pressed.rounding_mm, _FACE_SHARE * radius_mm)
        most_mm = radius_mm if pressed.is_sharp_edged else most_mm
    if mesh_size_mm <= most_mm * (1 + 1e-9):
        return ""
    error = "6 % (quadratic elements) to 70 % (linear)"
    if mesh_size_mm > _NEARLY * most_mm:
        error = "several times"
    return (
        f"elements of {mesh_size_mm:.3g} mm are too large for the contact, whose radius is about "
        f"{radius_mm:.3g} mm at the end: the force may be {error} too high; use a mesh_size "
        f'of {most_mm:.2g} mm at most, or mesh = "medium"'
    )


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

    The force is the reaction along the axis; side forces and moments stand beside it.
    """

    compresses: bool = False

    usual_base = TestKind.usual_base
    has_middle_plane = TestKind.has_middle_plane
    is_homogeneous = TestKind.is_homogeneous

    def faces(self, test: Test) -> tuple[FaceCondition, ...]:
        """Prescribe every component above; the face below is held, or slides."""
        share = 1.0 / test.displacement_mm if test.displacement_mm else 0.0  # open for now
        motion, (_, base) = test.motion or FaceMotion(), super().faces(test)
        return FaceCondition("top", self.sense, True, besides=motion, share_per_mm=share), base


#: every kind of test by its name in a file
TEST_KINDS: dict[str, TestKind] = {
    "compression": Compression(),
    "indentation": Indentation(),
    "plate-motion": PlateMotion(),
    "tension": GaugeSection(),
    "equibiaxial": GaugeSection(mode="equibiaxial"),
    "planar": GaugeSection(mode="planar"),
    "biaxial": GaugeSection(mode="biaxial"),
    "simple-shear": GaugeSection(mode="simple-shear"),
    "volumetric": GaugeSection(mode="volumetric", sense=-1.0),
    "confined-compression": GaugeSection(mode="confined", sense=-1.0),
}
