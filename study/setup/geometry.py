"""What the solver needs and nothing else: specimen, test, material with numbers, model."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Space = Literal["axisymmetric", "3d"]
Order = Literal["linear", "quadratic"]
Shape = Literal["simplex", "tensor"]
Formulation = Literal["mixed", "displacement"]
Interface = Literal["frictionless", "bonded"]


@dataclass(frozen=True)
class Cylinder:
    """Circular cylinder standing on its base (mm)."""

    radius_mm: float
    height_mm: float


@dataclass(frozen=True)
class Block:
    """Rectangular block standing on its base (mm)."""

    width_mm: float
    depth_mm: float
    height_mm: float


@dataclass(frozen=True)
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

    file: str
    unit: str = "mm"
    axis: str = "z"
    clamp_below_mm: float | None = None
    press_x_mm: float | None = None
    press_y_mm: float | None = None
    plate_tolerance_mm: float | None = None

    @property
    def height_mm(self) -> float:
        """Height of the specimen, read from the file."""
        from study.surface.surface import body

        return body(self).height_mm

    @property
    def notes(self) -> tuple[str, ...]:
        """What was mended when the file was read, and what looks strange."""
        from study.surface.surface import body

        return body(self).notes


@dataclass(frozen=True)
class Flat:
    """Flat-ended cylindrical indenter with a rounded edge (mm)."""

    radius_mm: float
    edge_radius_mm: float = 0.0


@dataclass(frozen=True)
class Cone:
    """Cone with a spherical tip; the half-angle is measured from the axis (deg, mm)."""

    half_angle_deg: float
    tip_radius_mm: float = 0.0
    shaft_radius_mm: float | None = None


@dataclass(frozen=True)
class Sphere:
    """Spherical indenter (mm)."""

    radius_mm: float


Specimen = Cylinder | Block | Surface
Indenter = Flat | Cone | Sphere
