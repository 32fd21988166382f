"""The study file: every table with fixed keys, declared once; values in mm, N, MPa and deg."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

from pydantic import Field

from study import units
from study.setup.quantity import Duration, integer, number, shown
from study.setup.section import Bad, Read, Reads, section
from study.setup.text import choice

#: responses that compare with measured curves
SCORED = ("relative_rms_force_error", "rms_force_error", "peak_force_error", "work_error")

#: keys that may differ between cells
FACTOR_KEYS = ("file", "files", "range", "points", "zero", "toe", "sign")

#: keys of which a table may have one; laying one over a table takes the others away
ALTERNATIVES: Mapping[str, tuple[str, ...]] = {
    "material": ("poisson_ratio", "bulk_modulus", "incompressible"),
    "model": ("mesh", "mesh_size"),
    "measurements": ("file", "files"),
}
MATERIAL_KEYS = ("model", "order", *ALTERNATIVES["material"])
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

#: what a factor is to the question: decided by the analyst; a part of it, which is answered at
#: each level; a fact that nobody measured, of which no level is recommended
ROLES = ("choice", "condition", "unknown")

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


@section
class Calibration:
    """How the constants of a design are found."""

    method: Annotated[str | None, Reads(choice(*METHODS))] = None
    leave_out: Annotated[str | None, Reads(choice("specimen", "test"))] = None
    problem: Annotated[Any, Reads(lambda value: value)] = None


@section
class CalibrationProblem:
    """Tables that replace the design's own where constants are fitted."""

    specimen: Annotated[Any, Reads(lambda value: value)] = None
    test: Annotated[Any, Reads(lambda value: value)] = None
    measurements: Annotated[Any, Reads(lambda value: value)] = None


@section
class Converge:
    """Mesh refinement: ratio, meshes, watched quantity, tolerance (a fraction), time budget."""

    ratio: Annotated[float, Reads(number(1, 10))] = 1.5
    levels: Annotated[int, Reads(integer(2, 10))] = 3
    qoi: Annotated[str, Reads(choice(*QUANTITIES))] = "peak_force"
    tolerance: Annotated[float | None, Reads(share)] = None
    budget_s: Duration | None = Field(default=None, validation_alias="budget")


@section
class Replicates:
    """What is computed several times for an error term; at most one of the two."""

    mesh_seeds: Annotated[int, Reads(count(*SEEDS, "the scatter of the mesh is not known"))] = 0
    noise: Annotated[int, Reads(count(*RESAMPLES, "the scatter of the fits is not known"))] = 0


@section
class Report:
    """Formats of the report."""

    format: Annotated[tuple[str, ...], Reads(formats)] = ("html",)


def read_roles(value: object) -> tuple[tuple[str, str], ...]:
    """Read ``[analysis] roles``: factor to role."""
    if not isinstance(value, Mapping):
        mend = 'for example { plates = "unknown", range = "condition" }'
        raise Bad(f"must be a table of factors, got {shown(value)}", mend)
    found: list[tuple[str, str]] = []
    for name, role in value.items():
        if isinstance(role, Mapping):  # a dotted key that was not quoted
            found += [(f"{name}.{rest}", one) for rest, one in read_roles(role)]
        else:
            found.append((str(name), choice(*ROLES)(role)))
    return tuple(found)


@section
class Analysis:
    """How the table is analyzed; the terms of the model are read where the factors are known."""

    model: Annotated[Any, Reads(lambda value: value)] = "full"
    type: Annotated[str, Reads(choice("I", "II", "III"))] = "II"
    error: Annotated[str, Reads(choice("auto", "pooled", "own", "replicates"))] = "auto"
    alpha: Annotated[float, Reads(number(0, 1))] = 0.05
    roles: Annotated[tuple[tuple[str, str], ...], Reads(read_roles)] = ()


@section
class Fitting:
    """Table ``[calibration]`` of a calibration file."""

    specimens: Annotated[str, Reads(choice("pooled", "each"))] = "pooled"
    leave_out: Annotated[str | None, Reads(choice("specimen", "test"))] = None
    bounds: Annotated[Any, Reads(lambda value: value)] = None
