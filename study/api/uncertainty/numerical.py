"""Numerical uncertainty of the effects of a study: what the verdicts are held against."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from study.analysis.convergence.grid_convergence import NumericalUncertainty
from study.analysis.effects.contrast_uncertainty import CellSeries
from study.analysis.effects.numerical_bound import NumericalBound, SeriesBounds
from study.canonical import digest
from study.record.document import NumericalCells, NumericalRow
from study.record.document_checks import fault_of_series

if TYPE_CHECKING:
    import pandas as pd

    from study.design.spec import Design, Treatment
    from study.record.record import Record
    from study.record.store import Store


def stored_numerical(store: Store, cases: Mapping[str, str]) -> tuple[NumericalUncertainty, ...]:
    """Numerical uncertainty of a study: as its run found it, and then ``study converge``.

    Parameters
    ----------
    store : Store
        Results of the study.
    cases : mapping of str to str
        Case ids and input hashes; what ``study converge`` found of others is left out.
    """
    found = store.read_document(
        "numerical-cells", NumericalCells, lambda cells: fault_of_series(cells["rows"])
    )
    rows = store.read_rows("numerical", NumericalRow, fault_of_series)
    if found is not None and found["of"] == digest(cases):
        rows = [*rows, *found["rows"]]
    return tuple(map(_of_row, rows))


def _of_row(row: NumericalRow) -> NumericalUncertainty:
    return NumericalUncertainty(
        row["levels"], row["response"], row["value"], row["u_num"], row["unit"],
        row["behaviour"], row["note"], tuple(row.get("mesh_size", ())),
        tuple(row.get("series", ())), row.get("formal_order"), row.get("formal_reason", ""),
    )  # fmt: skip


#: factors whose levels are meshes
MESH_FACTORS = ("model.mesh", "model.mesh_size")

#: meshes that a series needs
_NEEDED = 3
#: keys of a discretization whose errors share an order
_ELEMENT = ("space", "element_order", "element_shape", "formulation")
Cell = tuple[str, ...]


def numerical_bound(
    design: Design,
    numerical: Sequence[NumericalUncertainty],
    records: Sequence[Record],
    table: pd.DataFrame,
    response: str,
    transform: str,
) -> NumericalBound | None:
    """Bound of the numerical error of every difference of a response.

    Where the meshes are a factor, the study's own cells are the refinement series, averaged over
    its blocks; elsewhere the cells that were refined are, in the first block. A cell whose
    deformation is homogeneous has no mesh error. The load steps count by the largest change of
    the response in any case where every other load step is left out.

    Parameters
    ----------
    design : Design
        Its factors and cells.
    numerical : sequence of NumericalUncertainty
        What refinement found, of all responses.
    records : sequence of Record
        Of the study, for mesh sizes and load steps.
    table : DataFrame
        One row a run, as it is analyzed.
    response : str
        Name of the response, and its column in ``table``.
    transform : {"none", "log"}
        The bounds are those of differences on this scale.

    Returns
    -------
    NumericalBound or None
        None where no cell was refined: then nothing is known.
    """
    rows = [row for row in numerical if row.response == response]
    if not rows:
        return None
    cells = _cells(design)
    mesh = mesh_factor(design)
    meshes = None if mesh is None else _ordered(records, mesh)
    names = [f.name for f in design.factors]
    if mesh is not None and meshes is not None and set(meshes) <= set(table[mesh].astype(str)):
        names.remove(mesh)
        series = _own_series(rows, table, response, transform, names, mesh, meshes)
        finest = {mesh: meshes[-1]}
    else:
        series, finest = _refined_series(rows, names, transform, [c for c, _ in cells]), {}
    elements = {tuple(levels[n] for n in names): element for levels, element in cells}
    more = u_of_steps(records, response, transform)
    if transform == "log" and more:
        more /= _geometric_mean(records, response)
    known = tuple(dict.fromkeys(tuple(levels[n] for n in names) for levels, _ in cells))
    named = {
        cell: replace(s, discretization=elements[cell])
        for cell, s in series.items()
        if elements.get(cell)
    }
    return SeriesBounds(tuple(names), known, named, elements, more, mesh, finest)


def _cells(design: Design) -> list[tuple[dict[str, str], str]]:
    """Levels of every treatment, and the name of its discretization; none where it is exact."""
    return [
        (dict(one.levels), "" if one.cell.problem.is_homogeneous else _element(one))
        for one in design.treatments
    ]


def _element(treatment: Treatment) -> str:
    model = treatment.cell.problem.model
    return " ".join(str(getattr(model, key)) for key in _ELEMENT)


def _own_series(
    rows: Sequence[NumericalUncertainty],
    table: pd.DataFrame,
    response: str,
    transform: str,
    names: Sequence[str],
    mesh: str,
    meshes: Sequence[str],
) -> dict[Cell, CellSeries]:
    """Series of the columns of a study whose meshes are a factor, averaged over the blocks."""
    y = table[response]
    values = np.log(y.where(y > 0)) if transform == "log" else y
    labels = [table[name].astype(str) for name in (*names, mesh)]
    mean = values.groupby(labels, sort=False).mean()
    found = {}
    for row in rows:
        if set(row.levels) != set(names) or len(row.series) < _NEEDED:
            continue
        cell = tuple(row.levels[name] for name in names)
        by_mesh = [float(mean.get((*cell, level), math.nan)) for level in reversed(meshes)]
        if np.isfinite(by_mesh).all() and len(row.mesh_size) == len(by_mesh):
            found[cell] = CellSeries(
                tuple(reversed(row.mesh_size)),
                tuple(by_mesh),
                row.formal_order,
                studied=math.fsum(by_mesh) / len(by_mesh),
                reference=1.0 if transform == "log" else None,
            )
    return found


def _refined_series(
    rows: Sequence[NumericalUncertainty],
    names: Sequence[str],
    transform: str,
    cells: Sequence[Mapping[str, str]],
) -> dict[Cell, CellSeries]:
    """Series of the cells that were refined beside the study."""
    found = {}
    for row in rows:
        values = row.series
        if transform == "log":
            values = tuple(math.log(v) for v in values if v > 0)
        if len(values) < 2 or len(values) != len(row.mesh_size) or min(row.mesh_size) <= 0:
            continue
        own = {name: level for name, level in row.levels.items() if name in names}
        at = next((c for c in cells if own.items() <= c.items()), None)
        if at is None:
            continue
        finest = np.argsort(row.mesh_size)
        found[tuple(at[name] for name in names)] = CellSeries(
            tuple(row.mesh_size[i] for i in finest),
            tuple(values[i] for i in finest),
            row.formal_order,
            studied=values[0],
            reference=1.0 if transform == "log" else None,
        )
    return found


def u_of_steps(records: Sequence[Record], response: str, transform: str) -> float:
    """Largest uncertainty of a response from its load steps, in its unit; 0 where none is known.

    On the log scale it counts by its share of the value, as that of the mesh does.

    Parameters
    ----------
    records : sequence of Record
        Of the study; cases without an answer are passed over.
    response : str
        Name of the response.
    transform : {"none", "log"}
        With ``"log"`` the largest share is taken of the geometric mean of the response.
    """
    entries = [r.responses[response] for r in records if r.converged and response in r.responses]
    found = [(u, e["value"]) for e in entries if (u := e.get("u_steps")) is not None]
    if transform != "log":
        return max((u for u, _ in found), default=0.0)
    shares = [u / abs(value) for u, value in found if value]
    return max(shares) * _geometric_mean(records, response) if any(shares) else 0.0


def mesh_factor(design: Design) -> str | None:
    """Name of the factor whose levels are meshes; None without, or with several.

    Parameters
    ----------
    design : Design
        Factors with one level do not count.
    """
    found = [f.name for f in design.factors if f.name in MESH_FACTORS and len(f.levels) > 1]
    return found[0] if len(found) == 1 else None


def _ordered(records: Sequence[Record], mesh: str) -> list[str] | None:
    """Meshes from coarse to fine; None where that order differs between columns."""
    columns: dict[tuple[tuple[str, str], ...], dict[str, float]] = {}
    for record in records:
        size = record.mesh.get("mesh_size_mm")
        if record.converged and size:
            key = tuple(sorted((k, v) for k, v in record.levels.items() if k != mesh))
            columns.setdefault(key, {})[record.levels[mesh]] = float(size)
    longest = max((len(sizes) for sizes in columns.values()), default=0)
    orders = {
        tuple(sorted(sizes, key=lambda level: -sizes[level]))
        for sizes in columns.values()
        if len(sizes) == longest
    }
    return list(orders.pop()) if len(orders) == 1 and longest >= _NEEDED else None


def _geometric_mean(records: Sequence[Record], response: str) -> float:
    values = [r.response(response) for r in records]
    known = [math.log(v) for v in values if math.isfinite(v) and v > 0]
    return math.exp(math.fsum(known) / len(known))
