"""Specimens and indenters: sections of a study file and values of the solver in one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated, ClassVar, Literal, get_args

import numpy as np

from study.ground.arrays import Array
from study.ground.declaration import (
    Coordinate,
    Field,
    Length,
    LengthOrZero,
    Reads,
    measured,
    number,
    relative_path,
    section,
    unit_of_length,
    word,
)
from study.ground.errors import Fault

_CYLINDER = measured("length", mend="cylinder takes radius, height")
_BLOCK = measured("length", mend="block takes width, depth, height")
_SURFACE = "surface takes file, unit, axis, clamp_below, press_x, press_y, plate_tolerance"
_BRAIN = measured("length", mend="brain takes length, width, height, fissure, clamp_below")
_CONE = "cone takes half_angle, tip_radius, shaft_radius"


@section
class Cylinder:
    """Circular cylinder standing on its base (mm)."""

    radius_mm: Annotated[float, _CYLINDER]
    height_mm: Annotated[float, _CYLINDER]
    shape: Literal["cylinder"] = "cylinder"

    @property
    def area_mm2(self) -> float:
        """Cross-section."""
        return math.pi * self.radius_mm**2

    @property
    def volume_mm3(self) -> float:
        """Volume."""
        return float(np.pi * self.radius_mm**2 * self.height_mm)

    @property
    def half_width_mm(self) -> float:
        """Distance from the axis to the side."""
        return self.radius_mm


@section
class Block:
    """Rectangular block standing on its base (mm)."""

    width_mm: Annotated[float, _BLOCK]
    depth_mm: Annotated[float, _BLOCK]
    height_mm: Annotated[float, _BLOCK]
    shape: Literal["block"] = "block"

    @property
    def area_mm2(self) -> float:
        """Cross-section."""
        return self.width_mm * self.depth_mm

    @property
    def volume_mm3(self) -> float:
        """Volume."""
        return self.width_mm * self.depth_mm * self.height_mm

    @property
    def half_width_mm(self) -> float:
        """Distance from the axis to the nearest side."""
        return min(self.width_mm, self.depth_mm) / 2


@section
class Surface:
    """Closed surface read from a file, standing on its lowest points."""

    #: STL, PLY or OBJ file.
    file: Annotated[str, Reads(relative_path, mend=_SURFACE)]
    unit: Annotated[str, Reads(unit_of_length, mend=_SURFACE)] = "mm"
    #: Axis of the file that points up, against the loading.
    axis: Annotated[str, word("z", "-z", "x", "-x", "y", "-y")] = "z"
    #: Every point below is held; in the file's coordinate along ``axis``.
    clamp_below_mm: Coordinate | None = None
    #: Where the loading axis is in the file's coordinates, once turned; the middle of the bounding
    #: box by default.
    press_x_mm: Coordinate | None = None
    press_y_mm: Coordinate | None = None
    #: Faces so near to the highest and lowest point lie in the plates; 1e-4 of the height by
    #: default.
    plate_tolerance_mm: Annotated[float, measured("length")] | None = None
    shape: Literal["surface"] = "surface"


@section
class Brain:
    """Brain-shaped phantom that is made from five numbers, lying on its base (mm)."""

    #: Extents from back to front (x), from side to side (y) and from base to top (z).
    length_mm: Annotated[float, _BRAIN]
    width_mm: Annotated[float, _BRAIN]
    height_mm: Annotated[float, _BRAIN]
    #: Depth of the groove between its halves at the top; 0 for none.
    fissure_mm: LengthOrZero = 0.0
    #: Every point below this height above the lowest one is held.
    clamp_below_mm: Length | None = None
    #: Where the loading axis is, from the middle.
    press_x_mm: Coordinate | None = None
    press_y_mm: Coordinate | None = None
    #: Faces so near to the highest and lowest point lie in the plates.
    plate_tolerance_mm: Length | None = None
    shape: Literal["brain"] = "brain"


@section
class Flat:
    """Flat-ended cylindrical indenter; its edge may be rounded (mm)."""

    radius_mm: Annotated[float, measured("length", mend="flat takes radius, edge_radius")]
    edge_radius_mm: LengthOrZero = 0.0
    shape: Literal["flat"] = "flat"
    has_face: ClassVar[bool] = True
    is_pointed: ClassVar[bool] = False

    @property
    def face_radius_mm(self) -> float:
        """Radius of the plane face, up to where an edge begins to be round."""
        return self.radius_mm - self.edge_radius_mm

    @property
    def is_sharp_edged(self) -> bool:
        """Whether the face ends in a sharp edge."""
        return self.edge_radius_mm == 0

    @property
    def rounding_mm(self) -> float:
        """Radius of the rounded edge of the face."""
        return self.edge_radius_mm

    def contact_radius_mm(self, depth_mm: float) -> float:
        """Contact radius on a half-space: that of the punch."""
        return self.radius_mm

    def reach_mm(self, depth_mm: float) -> float:
        """Largest radius that can be touched at a depth."""
        return self.radius_mm

    def edge_width_mm(self, depth_mm: float) -> float:
        """Width of the rounded edge that touches a half-space at a depth.

        Its end, at the radius a, follows from a (sqrt(a^2 - b^2) - b arccos(b / a)) = d e around a
        face of radius b (Popov, Hess and Willert 2019, Handbook of Contact Mechanics, 2.5.6).
        """
        b, e = self.face_radius_mm, self.edge_radius_mm
        low, high = 0.0, e
        for _ in range(60 if e > 0 else 0):  # bisection of a rising function
            width = (low + high) / 2
            a = b + width
            reached = a * (math.sqrt(a * a - b * b) - b * math.acos(b / a)) / e
            low, high = (low, width) if reached > depth_mm else (width, high)
        return high

    def step_length_mm(self, depth_mm: float) -> float:
        """Length that load steps are measured by."""
        # The rounded edge takes part within the first fractions of its radius.
        return max(self.edge_radius_mm, 0.1 * self.radius_mm)

    def faults(self) -> Iterator[Fault]:
        """Dimensions that make no such body."""
        edge, radius = self.edge_radius_mm, self.radius_mm
        if not 0 <= edge <= radius:
            beyond = f"larger than the radius, {radius:g} mm" if edge > 0 else "below 0"
            yield Fault("test.indenter.edge_radius", f"{edge:g} mm is {beyond}", "round less")


@section
class Cone:
    """Cone with a spherical tip; the half-angle is measured from the axis (deg, mm)."""

    half_angle_deg: Annotated[float, measured("angle", 0, 90, mend=_CONE)]
    tip_radius_mm: LengthOrZero = 0.0
    shaft_radius_mm: Annotated[float, measured("length")] | None = None
    shape: Literal["cone"] = "cone"
    has_face: ClassVar[bool] = False
    is_pointed: ClassVar[bool] = True
    face_radius_mm: ClassVar[float] = 0.0
    is_sharp_edged: ClassVar[bool] = False

    @property
    def rounding_mm(self) -> float:
        """Radius of the tip."""
        return self.tip_radius_mm

    def contact_radius_mm(self, depth_mm: float) -> float:
        """Contact radius on a half-space (Sneddon 1965); that of the tip's sphere at first."""
        sharp = 2 / np.pi * depth_mm * np.tan(np.radians(self.half_angle_deg))
        wide = max(sharp, np.sqrt(self.tip_radius_mm * depth_mm) if self.tip_radius_mm > 0 else 0.0)
        return float(min(wide, self.shaft_radius_mm or np.inf))

    def reach_mm(self, depth_mm: float) -> float:
        """Largest radius that can be touched at a depth, at most a tip's radius too large."""
        cone = depth_mm * np.tan(np.radians(self.half_angle_deg)) + self.tip_radius_mm
        return float(min(cone, self.shaft_radius_mm or np.inf))

    def step_length_mm(self, depth_mm: float) -> float:
        """Length that load steps are measured by."""
        return max(self.tip_radius_mm, 0.05 * depth_mm)

    def faults(self) -> Iterator[Fault]:
        """Dimensions that make no such body."""
        if not 0 < self.half_angle_deg < 90:
            rule = f"{self.half_angle_deg:g} deg is not between 0 and 90 deg"
            yield Fault("test.indenter.half_angle", rule, "it is measured from the axis")
        shaft = self.shaft_radius_mm
        if shaft is not None and self.tip_radius_mm > shaft:
            rule = f"{self.tip_radius_mm:g} mm is larger than the shaft radius, {shaft:g} mm"
            yield Fault("test.indenter.tip_radius", rule, "a tip is inside its shaft")


@section
class Sphere:
    """Spherical indenter (mm)."""

    radius_mm: Annotated[float, measured("length", mend="sphere takes radius")]
    shape: Literal["sphere"] = "sphere"
    has_face: ClassVar[bool] = False
    is_pointed: ClassVar[bool] = False
    face_radius_mm: ClassVar[float] = 0.0
    is_sharp_edged: ClassVar[bool] = False
    rounding_mm: ClassVar[float] = 0.0

    def contact_radius_mm(self, depth_mm: float) -> float:
        """Contact radius on a half-space (Hertz)."""
        return float(min(np.sqrt(self.radius_mm * depth_mm), self.radius_mm))

    def reach_mm(self, depth_mm: float) -> float:
        """Radius that is touched at a depth on a half-space."""
        return float(np.sqrt(max(min(depth_mm, self.radius_mm) * self.radius_mm, 0.0)))

    def step_length_mm(self, depth_mm: float) -> float:
        """Length that load steps are measured by."""
        return max(0.1 * self.radius_mm, 0.2 * depth_mm)

    def faults(self) -> Iterator[Fault]:
        """No sphere has any."""
        return iter(())


#: largest rotation of a plate, deg: rotations are taken to be small, which at 5 deg makes errors
#: of half a percent of the motion
MOST_TURNED = 5.0

_TURN = measured("angle", -MOST_TURNED, MOST_TURNED)


@section
class FaceMotion:
    """Motion of a loaded plate besides that along the axis: small rotations, and slip."""

    x_mm: Coordinate = 0.0
    y_mm: Coordinate = 0.0
    #: Rotations about x, y and the axis through the middle of the face.
    tilt_x_deg: Annotated[float, _TURN] = 0.0
    tilt_y_deg: Annotated[float, _TURN] = 0.0
    twist_deg: Annotated[float, _TURN] = 0.0
    #: In-plane stretch less 1 of the face, which slips on its plate.
    spread: Annotated[float, Reads(number(-0.5, 2.0), "number")] = 0.0

    def components(self) -> Array:
        """X and y in mm, rotations in rad, spread; shape (6,)."""
        turned = np.radians([self.tilt_x_deg, self.tilt_y_deg, self.twist_deg])
        return np.concatenate([[self.x_mm, self.y_mm], turned, [self.spread]])


#: acceleration of free fall that is standard, m/s^2 (CGPM 1901)
STANDARD_GRAVITY = 9.80665


@section
class Gravity:
    """Weight of the specimen, which sags (or hangs from its base) before it is touched."""

    density_kg_m3: Annotated[float, measured("density", mend='for example density = "980 kg/m^3"')]
    #: Down towards the base; up if the specimen hangs from it; none to leave it out.
    direction: Annotated[Literal["down", "up", "none"], word("down", "up", "none")] = "down"

    @property
    def upward_N_mm3(self) -> float:  # noqa: N802
        """Force on a unit of volume along the axis, upwards."""
        sense = {"down": -1.0, "up": 1.0, "none": 0.0}[self.direction]
        return sense * STANDARD_GRAVITY * self.density_kg_m3 * 1e-9


@section
class Homogeneous:
    """Gauge section that deforms the same everywhere, as the middle of a dumbbell does (mm).

    Where stretch and stress were measured, neither size enters: they are then 1 mm^2 and 1 mm.
    """

    area_mm2: Annotated[float, measured("area")] = 1.0
    height_mm: Annotated[float, measured("length")] = Field(default=1.0, validation_alias="length")
    shape: Literal["homogeneous"] = "homogeneous"

    @property
    def volume_mm3(self) -> float:
        """Volume."""
        return self.area_mm2 * self.height_mm

    @property
    def half_width_mm(self) -> float:
        """Half the side of a square of this area."""
        return math.sqrt(self.area_mm2) / 2


#: Bodies that triangles enclose: the whole of them is meshed, in 3D with tetrahedra.
Enclosed = Surface | Brain
Specimen = Cylinder | Block | Surface | Brain | Homogeneous
Indenter = Flat | Cone | Sphere
#: every shape by its name in a file
SPECIMENS: dict[str, type[Specimen]] = {kind.shape: kind for kind in get_args(Specimen)}
INDENTERS: dict[str, type[Indenter]] = {kind.shape: kind for kind in get_args(Indenter)}
