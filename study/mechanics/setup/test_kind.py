"""Tests as data: what moves, what touches, where elements are small, which corners are singular.

A test (:class:`Test`) says what one specimen goes through. Its kind (:class:`TestKind`) turns that
into conditions, contacts and sizes, and is all that the finite-element model knows of it. A kind
is added as a module beside :mod:`study.mechanics.setup.test_kinds` and an entry of
:data:`study.mechanics.setup.test_kinds.TEST_KINDS`.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np

from study.ground.arrays import Array
from study.ground.errors import Fault, InputError
from study.mechanics.setup.declaration import (
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
from study.mechanics.setup.geometry import FaceMotion, Gravity, Indenter

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
    from study.mechanics.setup.test_kinds import TEST_KINDS

    return choice(*TEST_KINDS)(value)


@section
class Test:
    """How a specimen is loaded, of which a file leaves a part to the kind of the test.

    Its displacement is None where the measurements have yet to say it.
    """

    __test__ = False  # not a pytest class

    #: One of :data:`study.mechanics.setup.test_kinds.TEST_KINDS`.
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
        from study.mechanics.setup.test_kinds import TEST_KINDS

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
class ClampedCorner:
    """Right angle between a bonded and a free face."""


@dataclass(frozen=True)
class SharpEdge:
    """Edge of a rigid face, where the pressure goes as the inverse root of the distance."""

    #: As a sentence calls it.
    name: str


@dataclass(frozen=True)
class RoundedEdge:
    """Edge of a rigid face that looks sharp to elements as large as its radius."""

    #: Of the rounding.
    radius_mm: float


@dataclass(frozen=True)
class ContactRim:
    """Rim of a smooth contact, which a mesh places to within an element."""


Singularity = ClampedCorner | SharpEdge | RoundedEdge | ContactRim


@dataclass(frozen=True, kw_only=True)
class TestKind(ABC):
    """A kind of test: everything that sets it apart from others, as data.

    Parameters
    ----------
    takes_indenter : bool
        Whether a test of this kind needs an indenter.
    compresses : bool
        Whether two plates shorten the specimen along its axis, and do nothing else.
    shears : bool
        Whether it is a simple shear, which may be preceded by a stretch.
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
    shears: bool = False
    strains_locally: bool = False
    sense: float = -1.0
    mode: str = "uniaxial"
    needs_homogeneous: bool = False

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
        return (ClampedCorner(),) if any(face.is_held for face in self.faces(test)) else ()

    @abstractmethod
    def faults(self, test: Test, height_mm: float, half_width_mm: float) -> Iterator[Fault]:
        """Say why a specimen of this height and half-width cannot go through the test."""
