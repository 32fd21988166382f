"""The study file: every table with fixed keys, declared once; values in mm, N, MPa and deg."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from study import units
from study.design.reader import (
    Bad,
    Read,
    choice,
    flag,
    integer,
    number,
    quantity,
    relative_path,
    shown,
    unit_of_length,
)
from study.design.table import Reads, Table, one_of

#: responses that compare with measured curves
SCORED = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")

#: keys that may differ between cells
FACTOR_KEYS = ("file", "files", "range", "points", "zero", "toe", "sign")
CONSTANT = re.compile(r"C\d{2,3}|youngs_modulus|mu|alpha")

#: keys of which a table may have one; laying one over a table takes the others away
ALTERNATIVES: Mapping[str, tuple[str, ...]] = {
    "material": ("poisson_ratio", "bulk_modulus", "incompressible"),
    "model": ("mesh", "mesh_size"),
    "measurements": ("file", "files"),
}
MATERIAL_KEYS = ("model", "order", *ALTERNATIVES["material"])
MESHES = ("coarse", "medium", "fine")
METHODS = ("auto", "analytic", "inverse-fem", "none")

#: unit of every response; constants are reported in kPa, exponents plain
RESPONSES = {
    "relative_rms_force_error": "%",
    "rms_force_error": "N",
    "peak_force_error": "N",
    "work_error": "%",
    "mu0": "kPa",
    "seconds": "s",
}
QUANTITIES = ("peak_force", "work", "curve_rms", *RESPONSES)
FORMATS = ("html", "pdf", "tex", "csv")

#: least and most meshes of a cell (below five their scatter is not known well enough), and
#: resamples of a fit (the scatter of 20 is known to 16 %, of 200 to 5 %)
SEEDS = (5, 1000)
RESAMPLES = (20, 10_000)


def share(value: Any) -> float:
    """Read a share: a plain number, or percent."""
    if isinstance(value, str):
        percent = units.parse_percent(value)
        if not 0 < percent < 100:
            raise Bad(f"must be between 0 % and 100 %, got {shown(value)}")
        return percent / 100
    return float(number(0, 1, mend='for example "1 %"')(value))


def count(low: int, high: int, why: str) -> Read:
    """Reader of a number of repeats; below ``low`` the reason is told."""
    whole = integer(0, high)

    def read(value: Any) -> int:
        count: int = whole(value)
        if count < low:
            raise Bad(f"must be at least {low}, got {shown(value)}: with fewer {why}")
        return count

    return read


def formats(value: Any) -> tuple[str, ...]:
    """Read one format or several."""
    items = value if isinstance(value, list) else [value]
    return tuple(dict.fromkeys(choice(*FORMATS)(item) for item in items)) or ("html",)


Length = Annotated[float, Reads(quantity("length"), "length")]
LengthOrZero = Annotated[float, Reads(quantity("length", closed=True), "length")]
Place = Annotated[float | None, Reads(quantity("length", -math.inf), "length")]
INTERFACE = choice("frictionless", "bonded", synonyms={"lubricated": "frictionless"})
ELEMENT_SHAPE = choice(
    "simplex",
    "tensor",
    synonyms={
        "triangle": "simplex",
        "tetrahedron": "simplex",
        "quadrilateral": "tensor",
        "hexahedron": "tensor",
    },
)


def said(what: str, dimension: str = "length", **limits: Any) -> Any:
    """Quantity of a shape; ``what`` tells which others the shape takes."""
    return Reads(quantity(dimension, **limits), dimension, what)


class Cylinder(Table):
    """A cylinder that stands on its base."""

    radius_mm: Annotated[float, said("cylinder takes radius, height")] = Field(alias="radius")
    height_mm: Annotated[float, said("cylinder takes radius, height")] = Field(alias="height")


class Block(Table):
    """A rectangular block."""

    width_mm: Annotated[float, said("block takes width, depth, height")] = Field(alias="width")
    depth_mm: Annotated[float, said("block takes width, depth, height")] = Field(alias="depth")
    height_mm: Annotated[float, said("block takes width, depth, height")] = Field(alias="height")


_SURFACE = "surface takes file, unit, axis, clamp_below, press_x, press_y, plate_tolerance"


class Surface(Table):
    """A body given by the file of its closed surface."""

    file: Annotated[str, Reads(relative_path, mend=_SURFACE)]
    unit: Annotated[str, Reads(unit_of_length, mend=_SURFACE)]
    axis: Annotated[str, Reads(choice("z", "-z", "x", "-x", "y", "-y"))] = "z"
    clamp_below_mm: Place = Field(None, alias="clamp_below")
    press_x_mm: Place = Field(None, alias="press_x")
    press_y_mm: Place = Field(None, alias="press_y")
    plate_tolerance_mm: Annotated[float | None, said(_SURFACE)] = Field(
        None, alias="plate_tolerance"
    )


class Flat(Table):
    """A flat punch; its edge may be rounded."""

    radius_mm: Annotated[float, said("flat takes radius, edge_radius")] = Field(alias="radius")
    edge_radius_mm: LengthOrZero = Field(0.0, alias="edge_radius")


_CONE = "cone takes half_angle, tip_radius, shaft_radius"


class Cone(Table):
    """A cone; its tip may be rounded, its shaft end it."""

    half_angle_deg: Annotated[float, said(_CONE, "angle", low=0, high=90)] = Field(
        alias="half_angle"
    )
    tip_radius_mm: LengthOrZero = Field(0.0, alias="tip_radius")
    shaft_radius_mm: Annotated[float | None, said(_CONE)] = Field(None, alias="shaft_radius")


class Sphere(Table):
    """A sphere."""

    radius_mm: Annotated[float, said("sphere takes radius")] = Field(alias="radius")


SPECIMENS: dict[str, type[Table]] = {"cylinder": Cylinder, "block": Block, "surface": Surface}
INDENTERS: dict[str, type[Table]] = {"flat": Flat, "cone": Cone, "sphere": Sphere}


class SpecimenShape(Table):
    """Which specimen it is."""

    shape: Annotated[str, Reads(one_of(SPECIMENS), mend=f"one of {', '.join(SPECIMENS)}")]


class IndenterShape(Table):
    """Which indenter it is."""

    shape: Annotated[str, Reads(one_of(INDENTERS), mend=f"one of {', '.join(INDENTERS)}")]


class Test(Table):
    """How the specimen is loaded; the end of the measured range may give the displacement."""

    kind: Annotated[str, Reads(choice("compression", "indentation"), mend="compression, ...")]
    interface: Annotated[str, Reads(INTERFACE, mend="frictionless or bonded")]
    base: Annotated[str | None, Reads(INTERFACE)] = None
    displacement_mm: Annotated[float | None, Reads(quantity("length"), "length")] = Field(
        None, alias="displacement"
    )
    steps: Annotated[int, Reads(integer(1, 10_000))] = 10
    indenter: Annotated[Any, Reads(lambda value: value)] = None


class Model(Table):
    """Discretization; a cylinder is axisymmetric unless the file says 3d."""

    space: Annotated[str | None, Reads(choice("axisymmetric", "3d"))] = None
    element_order: Annotated[str, Reads(choice("linear", "quadratic"))] = "quadratic"
    element_shape: Annotated[str, Reads(ELEMENT_SHAPE)] = "simplex"
    formulation: Annotated[str, Reads(choice("mixed", "displacement"))] = "mixed"
    mesh_size_mm: Annotated[float | None, Reads(quantity("length"), "length")] = Field(
        None, alias="mesh_size"
    )
    mesh: Annotated[str, Reads(choice(*MESHES))] = "medium"


def _poisson_ratio(value: Any) -> float:
    if value == 0.5 and not isinstance(value, bool):
        raise Bad("must be below 0.5, got 0.5", "write incompressible = true")
    return float(number(-1.0, 0.5)(value))


class Compressibility(Table):
    """How a material resists a change of volume; one of the three."""

    poisson_ratio: Annotated[float | None, Reads(_poisson_ratio, "number")] = None
    bulk_modulus_MPa: Annotated[float | None, Reads(quantity("pressure"), "pressure")] = Field(
        None, alias="bulk_modulus"
    )
    incompressible: Annotated[bool, Reads(flag)] = False


class Calibration(Table):
    """How the constants of a design are found."""

    method: Annotated[str | None, Reads(choice(*METHODS))] = None
    leave_out: Annotated[str | None, Reads(choice("specimen", "test"))] = None
    problem: Annotated[Any, Reads(lambda value: value)] = None


class CalibrationProblem(Table):
    """Tables that replace the design's own where constants are fitted."""

    specimen: Annotated[Any, Reads(lambda value: value)] = None
    test: Annotated[Any, Reads(lambda value: value)] = None
    measurements: Annotated[Any, Reads(lambda value: value)] = None


class Converge(Table):
    """Mesh refinement: ratio, meshes, watched quantity, tolerance (a fraction), time budget."""

    ratio: Annotated[float, Reads(number(1, 10))] = 1.5
    levels: Annotated[int, Reads(integer(2, 10))] = 3
    qoi: Annotated[str, Reads(choice(*QUANTITIES))] = "peak_force"
    tolerance: Annotated[float | None, Reads(share)] = None
    budget_s: Annotated[float | None, Reads(quantity("time"), "time")] = Field(None, alias="budget")


class Replicates(Table):
    """What is computed several times for an error term; at most one of the two."""

    mesh_seeds: Annotated[int, Reads(count(*SEEDS, "the scatter of the mesh is not known"))] = 0
    noise: Annotated[int, Reads(count(*RESAMPLES, "the scatter of the fits is not known"))] = 0


class Report(Table):
    """Formats of the report."""

    format: Annotated[tuple[str, ...], Reads(formats)] = ("html",)


class Analysis(Table):
    """How the table is analyzed; the terms of the model are read where the factors are known."""

    model: Annotated[Any, Reads(lambda value: value)] = "full"
    type: Annotated[str, Reads(choice("I", "II", "III"))] = "II"
    error: Annotated[str, Reads(choice("auto", "pooled", "own", "replicates"))] = "auto"
    alpha: Annotated[float, Reads(number(0, 1))] = 0.05


class Fitting(Table):
    """Table ``[calibration]`` of a calibration file."""

    specimens: Annotated[str, Reads(choice("pooled", "each"))] = "pooled"
    leave_out: Annotated[str | None, Reads(choice("specimen", "test"))] = None
    bounds: Annotated[Any, Reads(lambda value: value)] = None
