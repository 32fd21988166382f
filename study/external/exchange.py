"""Files between this package and another program: the problem in JSON, the curve in CSV.

``problem.json`` holds the resolved problem of one solution in mm, N and MPa. The program writes
``curve.csv`` (``displacement_mm``, ``force_N``, and ``dforce_C10`` in N per MPa for a constant
whose gradient it knows) and, if it likes, ``facts.json`` (``dofs``, ``elements``).
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np

from study.external.answers import (
    NoAnswer,
    check_columns,
    column_of,
    read_text,
    table_rows,
)
from study.ground.arrays import Array
from study.ground.bounded_file import UnreadableError, parse_json
from study.ground.curve import Curve, spline_from_origin
from study.record.document import MarkerDocument, MeshDocument, SolverDocument

PROBLEM_FILE = "problem.json"
CASE_FILE = "case.json"
CURVE_FILE = "curve.csv"
FACTS_FILE = "facts.json"
DISPLACEMENT = "displacement_mm"
FORCE = "force_N"
GRADIENT = "dforce_"
#: unknowns and elements that no mesh has, beyond which a double is not exact
MOST_ELEMENTS = 2**53
#: share of the displacement asked for that a curve may end before: digits of a text file
_SHORT = 1e-6


@dataclass(frozen=True)
class PredictedCurve:
    """A prediction, and how it was found: by our solver, a program or a function."""

    #: Forces at the displacements that were asked for; of parameters alone as they are given,
    #: without a point where none is.
    curve: Curve = field(default_factory=lambda: Curve(np.zeros(0), np.zeros(0)))
    #: How it was found; a closed form has no mesh.
    mesh: MeshDocument = field(default_factory=MeshDocument)
    solver: SolverDocument = field(default_factory=SolverDocument)
    #: What it cost beside the fit that gave the constants.
    seconds: float = 0.0
    #: What markers inside the specimen say of it.
    markers: MarkerDocument | None = None
    #: Further numbers of another program, in the units of the study file.
    values: Mapping[str, float] = field(default_factory=dict)
    #: Zip of its folder, where that is kept.
    folder: bytes = b""
    #: Files that were rendered for it.
    rendered: Mapping[str, str] = field(default_factory=dict)

    def to_json(self) -> dict[str, object]:
        """Plain data, for the store and for workers."""
        values = {"named_values": dict(self.values)} if self.values else {}
        return {"curve": self.curve.as_dict(), "mesh": self.mesh, "solver": self.solver, **values}

    @classmethod
    def from_json(cls, document: Mapping[str, object]) -> PredictedCurve:
        """Inverse of :meth:`to_json`."""
        return cls(
            Curve.from_dict(cast("Mapping[str, object]", document["curve"])),
            cast(MeshDocument, document.get("mesh", {})),
            cast(SolverDocument, document["solver"]),
            values=cast("Mapping[str, float]", document.get("named_values", {})),
        )


def curve_answered(folder: Path, displacement_mm: Array, reaches: bool = True) -> PredictedCurve:
    """Read the curve that a program wrote. Shapes: displacement_mm (n,)."""
    header, rows = table_rows(read_text(folder, CURVE_FILE), CURVE_FILE)
    names = (DISPLACEMENT, FORCE, *(name for name in header if name.startswith(GRADIENT)))
    columns = {name: column_of(header, rows, name, CURVE_FILE) for name in names}
    facts = _facts(read_text(folder, FACTS_FILE)) if os.path.lexists(folder / FACTS_FILE) else {}
    predicted = at_points(columns, displacement_mm, reaches)
    if not any(facts.values()):
        return predicted
    mesh: MeshDocument = {"dofs": facts.get("dofs", 0), "elements": facts.get("elements", 0)}
    return replace(predicted, mesh=mesh)


def at_points(
    columns: Mapping[str, Array], displacement_mm: Array, reaches: bool = True
) -> PredictedCurve:
    """Curve of some columns at the displacements asked for."""
    # Shapes: columns (m,), MPa; displacement_mm (n,).
    if not reaches and columns[DISPLACEMENT].size:
        inside = displacement_mm <= columns[DISPLACEMENT][-1] * (1 + _SHORT)
        displacement_mm = displacement_mm[inside] if inside.any() else displacement_mm
    check_columns(columns, DISPLACEMENT, "the curve")
    reached, force, end_mm = columns[DISPLACEMENT], columns[FORCE], float(displacement_mm[-1])
    if reached[-1] < end_mm * (1 - _SHORT):
        raise NoAnswer("not-converged", f"the curve ends at {reached[-1]:g} mm of {end_mm:g} mm")
    gradients = {k.removeprefix(GRADIENT): v for k, v in columns.items() if k.startswith(GRADIENT)}
    try:
        with np.errstate(all="ignore"):
            places = np.minimum(displacement_mm, reached[-1])
            gradient = {k: spline_from_origin(reached, v, places) for k, v in gradients.items()}
            forces = spline_from_origin(reached, force, places)
        return PredictedCurve(Curve(displacement_mm, forces, force_gradient=gradient))
    except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
        raise NoAnswer("failed", f"no spline goes through the curve: {error}") from error


def _facts(text: str) -> dict[str, int]:
    try:
        facts = parse_json(text, FACTS_FILE)
    except UnreadableError as error:
        raise NoAnswer("failed", str(error)) from error
    if not isinstance(facts, dict):
        raise NoAnswer("failed", f"{FACTS_FILE} must be an object")
    counts = {name: facts[name] for name in ("dofs", "elements") if facts.get(name) is not None}
    for name, count in counts.items():
        is_number = isinstance(count, int | float) and not isinstance(count, bool)
        if not is_number or not 0 <= count <= MOST_ELEMENTS or count != int(count):
            rule = f"must be a whole number that is not negative, got {str(count)[:80]}"
            raise NoAnswer("failed", f"{FACTS_FILE}: {name} {rule}")
    return {name: int(count) for name, count in counts.items()}
