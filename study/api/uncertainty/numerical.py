"""Numerical uncertainty of the effects of a study: what the verdicts are held against."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from study.analysis.convergence.work_precision import mesh_series
from study.analysis.linear_model.design_matrix import term_name, terms_of
from study.canonical import digest
from study.runner.numerical.study_refinement import fine_uncertainty

if TYPE_CHECKING:
    import pandas as pd

    from study.analysis.convergence.grid_convergence import Numerical
    from study.analysis.convergence.work_precision import MeshSeries
    from study.design.spec import Design
    from study.record.record import Record
    from study.record.store import Store


def stored_cells(store: Store, cases: Mapping[str, str]) -> list[dict[str, Any]]:
    """Numerical uncertainty of every cell as ``study converge`` found it for these very cases."""
    found = store.read_json("numerical-cells")
    if not isinstance(found, dict) or found.get("of") != digest(cases):
        return []
    return list(found["rows"])


#: factors whose levels are meshes
MESH_FACTORS = ("model.mesh", "model.mesh_size")

#: factors whose levels discretize the same equations, and the level that does so best
_BEST_ELEMENTS = {"model.element_order": "quadratic", "model.formulation": "mixed"}

#: meshes that a series needs
_NEEDED = 3
Setting = tuple[tuple[float, ...], float | None]


def effect_u_num(
    design: Design,
    numerical: Sequence[Numerical],
    records: Sequence[Record],
    table: pd.DataFrame,
    response: str,
    transform: str,
    *,
    factors: Sequence[str],
    block: str | None,
    model: Any,
) -> float | dict[str, float] | None:
    """Numerical uncertainty of every effect of a response, in its unit.

    That of the mesh, see :func:`mesh_u_num`, and that of the load steps: the largest change of
    the response in any case where every other load step is left out.

    Returns
    -------
    float, dict or None
        One for all, or one a term (those of the mesh absent); None where nothing is known.
    """
    mesh = mesh_u_num(
        design, numerical, records, table, response, transform,
        factors=factors, block=block, model=model,
    )  # fmt: skip
    steps = u_of_steps(records, response, transform)
    if isinstance(mesh, dict):
        return {term: u + steps for term, u in mesh.items()}
    return None if mesh is None else mesh + steps


def u_of_steps(records: Sequence[Record], response: str, transform: str) -> float:
    """Largest uncertainty of a response from its load steps, in its unit; 0 where none is known.

    On the log scale it counts by its share of the value, as that of the mesh does.
    """
    found = [
        (float(entry["u_steps"]), entry["value"])
        for record in records
        if record.converged and "u_steps" in (entry := record.responses.get(response, {}))
    ]
    if transform != "log":
        return max((u for u, _ in found), default=0.0)
    shares = [u / abs(value) for u, value in found if value]
    return max(shares) * _geometric_mean(records, response) if any(shares) else 0.0


def mesh_u_num(
    design: Design,
    numerical: Sequence[Numerical],
    records: Sequence[Record],
    table: pd.DataFrame,
    response: str,
    transform: str,
    *,
    factors: Sequence[str],
    block: str | None,
    model: Any,
) -> float | dict[str, float] | None:
    """Uncertainty of every effect of a response from the mesh, in its unit.

    The uncertainty of an effect is that of the same contrast. Where the meshes are a factor and
    the study's own cases are the refinement series, each difference between two levels of a term
    is followed from mesh to mesh, over all blocks and all other factors; its uncertainty is that
    of the value on the finest mesh (grid convergence index, or thrice the range where there is
    no order) plus its distance to the difference as analyzed. The sum, since the analyzed one is
    an average over all meshes: it is off the finest mesh's by exactly that distance, and the
    finest mesh's is off the limit by its own uncertainty, to the same side where the series is
    monotone. The largest over all pairs of levels counts, and over the mesh sizes and formal
    orders of the columns where these differ, for which pair leads may itself be the mesh's doing.

    Linear and quadratic elements have the same limit, and so have mixed and displacement
    elements. An effect that is none of theirs is therefore followed to that limit by the better
    ones alone, chosen before any number is seen; the distance to the effect as analyzed still
    counts what the poorer ones do to it.

    The mesh itself and its interactions have none: their effects *are* errors of the
    discretization, differences between values of given meshes that no finer mesh could change.
    Held against the uncertainty of the finest mesh, a mesh that plainly matters could never be
    said to: a first-order series of ratio 2 spans but 2.4 times its index.

    Everywhere else it is the largest uncertainty of a refined column, which errs to the safe
    side as long as no error is larger in a column that was not refined.

    Returns
    -------
    float, dict or None
        One for all, or one a term (those of the mesh absent); None where nothing is known.
    """
    largest = largest_u_num(numerical, records, response, transform)
    mesh = mesh_factor(design)
    every = {f.name for f in design.factors if len(f.levels) > 1}
    if largest is None or mesh is None or set(factors) != every:
        return largest
    settings = _settings(design, numerical, response, mesh, {})
    meshes = _ordered(records, mesh)
    if not settings or meshes is None or any(len(s) != len(meshes) for s, _ in settings):
        return largest
    if not set(meshes) <= set(table[mesh].astype(str)):  # a mesh was left out, for want of answers
        return largest

    def followed(rows: pd.DataFrame, of: Sequence[str], terms: Any) -> dict[str, MeshSeries]:
        return mesh_series(
            rows, response, of, mesh, meshes, block=block, model=terms, transform=transform
        )

    terms = terms_of(factors, model)
    found = followed(table, factors, model)
    own = {term: u_of_series(series, settings) for term, series in found.items()}
    best = {f: level for f, level in _BEST_ELEMENTS.items() if f in factors}
    rows, theirs = _at(table, best), _settings(design, numerical, response, mesh, best)
    if best and theirs and len(rows):
        inner = [term for term in terms if not best.keys() & set(term)]
        for term, series in followed(rows, [f for f in factors if f not in best], inner).items():
            if term in found and series.by_mesh.shape == found[term].by_mesh.shape:
                own[term] = u_of_series(replace(series, analyzed=found[term].analyzed), theirs)
    scale = _geometric_mean(records, response) if transform == "log" else 1.0
    names = [term_name(term) for term in terms if mesh not in term]
    return {name: own[name] * scale if name in own else largest for name in names}


def _at(table: pd.DataFrame, levels: Mapping[str, str]) -> pd.DataFrame:
    """Rows at these levels."""
    kept = table
    for factor, level in levels.items():
        kept = kept[kept[factor].astype(str) == level]
    return kept


def mesh_factor(design: Design) -> str | None:
    """Name of the factor whose levels are meshes; None without, or with several."""
    found = [f.name for f in design.factors if f.name in MESH_FACTORS and len(f.levels) > 1]
    return found[0] if len(found) == 1 else None


def u_of_series(series: MeshSeries, settings: Sequence[Setting]) -> float:
    """Largest uncertainty over the pairs of levels of a term, on the working scale.

    Parameters
    ----------
    settings : sequence of (tuple of float, float or None)
        Mesh sizes from coarse to fine, and formal order, of every kind of column.
    """
    worst = 0.0
    for analyzed, values in series.pairs():
        numbers = [float(v) for v in values]
        u = max(fine_uncertainty(numbers, sizes, formal)[1] for sizes, formal in settings)
        worst = max(worst, u + abs(analyzed - numbers[-1]))
    return worst


def _settings(
    design: Design,
    numerical: Sequence[Numerical],
    response: str,
    mesh: str,
    only: Mapping[str, str],
) -> list[Setting]:
    """Mesh sizes and formal order of the study's own columns at some levels, equal ones once.

    Sizes count by their ratios alone, which three digits tell well enough.
    """
    others = {f.name for f in design.factors} - {mesh}
    found: dict[Setting, None] = {}
    for row in numerical:
        own = row.response == response and set(row.levels) == others
        own = own and only.items() <= dict(row.levels).items()
        if own and len(row.series) >= _NEEDED and min(row.mesh_size, default=0.0) > 0:
            ratios = tuple(float(f"{size / row.mesh_size[-1]:.3g}") for size in row.mesh_size)
            found[ratios, row.formal_order] = None
    return [setting for setting in found if len(set(setting[0])) == len(setting[0])]


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


def largest_u_num(
    numerical: Sequence[Numerical], records: Sequence[Record], response: str, transform: str
) -> float | None:
    """Largest numerical uncertainty of a response in any refined column, in its unit.

    On the log scale an uncertainty counts by its share of the value: that of the refined block
    is carried to the geometric mean of all, for a stiff block's in kPa would drown a soft one's.
    """
    rows = [r for r in numerical if r.response == response and r.u_num is not None]
    if transform != "log":
        return max((float(r.u_num) for r in rows if r.u_num is not None), default=None)
    shares = [abs(r.u_num / r.value) for r in rows if r.u_num is not None and r.value]
    if not shares or not any(r.response(response) > 0 for r in records):
        return None
    return max(shares) * _geometric_mean(records, response)


def _geometric_mean(records: Sequence[Record], response: str) -> float:
    values = [r.response(response) for r in records]
    known = [math.log(v) for v in values if math.isfinite(v) and v > 0]
    return math.exp(math.fsum(known) / len(known))
