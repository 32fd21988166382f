"""Indentation of a specimen on a rigid support by a rigid body of revolution."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from study.arrays import Array
from study.errors import Fault, InputError
from study.setup.compression import beyond_height
from study.setup.geometry import Indenter
from study.setup.load_steps import StepRule, StepSettings
from study.setup.test_kind import (
    AroundContact,
    ContactRim,
    FaceCondition,
    IndenterContact,
    Interface,
    RoundedEdge,
    SharpEdge,
    Singularity,
    Test,
)

#: stretches around an indenter in which a material must at least be stable
LOWEST_STRETCH = 0.8
HIGHEST_STRETCH = 1.2
STRETCHES = 41


@dataclass(frozen=True)
class Indentation:
    """An indenter comes down by the displacement; it may keep hold of what it touches."""

    takes_indenter: bool = True
    compresses: bool = False
    shears: bool = False
    strains_locally: bool = True
    sense: float = -1.0
    mode: str = "uniaxial"
    needs_homogeneous: bool = False

    def usual_base(self, interface: Interface) -> Interface:
        """Specimens are fixed to what they lie on."""
        return "bonded"

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

    def has_middle_plane(self, test: Test) -> bool:
        """Tell that it is loaded from above alone."""
        return False

    def grading(self, test: Test) -> AroundContact:
        """Small under the indenter."""
        return AroundContact(indenter_of_test(test), test.depth_mm)

    def steps(self, test: Test, height_mm: float, settings: StepSettings) -> StepRule:
        """Shares of the indenter's own length; those of what sticks are small and even."""
        length = test.depth_mm if test.indenter is None else _length(test)
        if test.interface == "bonded":
            share = settings.held_face if holds_face(test) else settings.sticking
            largest = min(settings.largest * height_mm, share * length)
            return StepRule(settings, largest, largest)
        first, largest = settings.first_touch * length, settings.largest_touch * length
        return StepRule(settings, first, largest, settings.deeper)

    def is_homogeneous(self, test: Test) -> bool:
        """Never."""
        return False

    def stretches(self, test: Test, height_mm: float) -> Array:
        """About none: larger ones are reached at single places only."""
        return np.linspace(LOWEST_STRETCH, HIGHEST_STRETCH, STRETCHES)

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
        pressed = test.indenter
        if pressed is None:
            mend = "give shape and radius"
            yield Fault("test.indenter", "an indentation needs an indenter", mend)
            return
        yield from pressed.faults()
        reach = pressed.reach_mm(test.depth_mm)
        if reach > half_width_mm:
            rule = f"the indenter touches up to {reach:g} mm from the axis, beyond"
            mend = "use a smaller indenter or a wider specimen"
            yield Fault("test.indenter", f"{rule} {half_width_mm:g} mm", mend)


def _length(test: Test) -> float:
    return indenter_of_test(test).step_length_mm(test.depth_mm)


def holds_face(test: Test) -> bool:
    """Whether a flat indenter sticks: it has hold of all that it will hold at once.

    Parameters
    ----------
    test : Test
        An indentation; false where its interface is frictionless or its indenter has no flat face.
    """
    return test.interface == "bonded" and test.indenter is not None and test.indenter.has_face


def indenter_of_test(test: Test) -> Indenter:
    """Indenter of a test.

    Parameters
    ----------
    test : Test
        An indentation.

    Raises
    ------
    InputError
        If there is none.
    """
    if test.indenter is None:
        mend = "give shape and radius"
        raise InputError(Fault("test.indenter", "an indentation needs an indenter", mend))
    return test.indenter


INDENTATION = Indentation()
