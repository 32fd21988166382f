"""Specimens and indenters: sections of a study file and values of the solver in one."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from study.setup.quantity import Coordinate, LengthOrZero, measured, unit_of_length
from study.setup.section import Reads, section
from study.setup.text import relative_path, word

_CYLINDER = measured("length", mend="cylinder takes radius, height")
_BLOCK = measured("length", mend="block takes width, depth, height")
_SURFACE = "surface takes file, unit, axis, clamp_below, press_x, press_y, plate_tolerance"
_CONE = "cone takes half_angle, tip_radius, shaft_radius"


@section
class Cylinder:
    """Circular cylinder standing on its base (mm)."""

    radius_mm: Annotated[float, _CYLINDER] = Field(validation_alias="radius")
    height_mm: Annotated[float, _CYLINDER] = Field(validation_alias="height")
    shape: Literal["cylinder"] = "cylinder"


@section
class Block:
    """Rectangular block standing on its base (mm)."""

    width_mm: Annotated[float, _BLOCK] = Field(validation_alias="width")
    depth_mm: Annotated[float, _BLOCK] = Field(validation_alias="depth")
    height_mm: Annotated[float, _BLOCK] = Field(validation_alias="height")
    shape: Literal["block"] = "block"


@section
class Surface:
    """Closed surface read from a file, standing on its lowest points.

    Parameters
    ----------
    file : str
        STL, PLY or OBJ file.
    unit : str
        Unit of its coordinates.
    axis : {"z", "-z", "x", "-x", "y", "-y"}
        Axis of the file that points up, against the loading.
    clamp_below_mm : float, optional
        Every point below is held; in the file's coordinate along ``axis``.
    press_x_mm, press_y_mm : float, optional
        Where the loading axis is in the file's coordinates, once turned; the middle of the
        bounding box by default.
    plate_tolerance_mm : float, optional
        Faces so near to the highest and lowest point lie in the plates; 1e-4 of the height
        by default.
    """

    file: Annotated[str, Reads(relative_path, mend=_SURFACE)]
    unit: Annotated[str, Reads(unit_of_length, mend=_SURFACE)] = "mm"
    axis: Annotated[str, word("z", "-z", "x", "-x", "y", "-y")] = "z"
    clamp_below_mm: Coordinate | None = Field(default=None, validation_alias="clamp_below")
    press_x_mm: Coordinate | None = Field(default=None, validation_alias="press_x")
    press_y_mm: Coordinate | None = Field(default=None, validation_alias="press_y")
    plate_tolerance_mm: Annotated[float, measured("length")] | None = Field(
        default=None, validation_alias="plate_tolerance"
    )
    shape: Literal["surface"] = "surface"


@section
class Flat:
    """Flat-ended cylindrical indenter; its edge may be rounded (mm)."""

    radius_mm: Annotated[float, measured("length", mend="flat takes radius, edge_radius")] = Field(
        validation_alias="radius"
    )
    edge_radius_mm: LengthOrZero = Field(default=0.0, validation_alias="edge_radius")
    shape: Literal["flat"] = "flat"


@section
class Cone:
    """Cone with a spherical tip; the half-angle is measured from the axis (deg, mm)."""

    half_angle_deg: Annotated[float, measured("angle", 0, 90, mend=_CONE)] = Field(
        validation_alias="half_angle"
    )
    tip_radius_mm: LengthOrZero = Field(default=0.0, validation_alias="tip_radius")
    shaft_radius_mm: Annotated[float, measured("length")] | None = Field(
        default=None, validation_alias="shaft_radius"
    )
    shape: Literal["cone"] = "cone"


@section
class Sphere:
    """Spherical indenter (mm)."""

    radius_mm: Annotated[float, measured("length", mend="sphere takes radius")] = Field(
        validation_alias="radius"
    )
    shape: Literal["sphere"] = "sphere"


Specimen = Cylinder | Block | Surface
Indenter = Flat | Cone | Sphere

#: every shape by its name in a file
SPECIMENS: dict[str, type[Specimen]] = {"cylinder": Cylinder, "block": Block, "surface": Surface}
INDENTERS: dict[str, type[Indenter]] = {"flat": Flat, "cone": Cone, "sphere": Sphere}
