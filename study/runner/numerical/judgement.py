"""What a refinement series says of every quantity: the document of ``study converge``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from study.analysis.convergence.grid_convergence import grid_convergence
from study.curve import Curve
from study.record.record import Record
from study.runner.job import CaseJob, Work
from study.runner.numerical.curve_quantities import QUANTITIES, curve_values, quantity
from study.runner.numerical.formal_order import (
    FormalOrder,
    base_size_mm,
    edge_rules,
    formal_of_case,
)
from study.runner.numerical.refinement import Outlook

if TYPE_CHECKING:
    from study.analysis.convergence.grid_convergence import ConvergenceResult, Numerical
    from study.runner.numerical.refinement import Level, Outlook, Series

Values = Mapping[str, tuple[Sequence[float], str]]

#: relative error of a force at the solver's tolerance
SOLVER_TOLERANCE = 1e-7

#: the algebraic error should be this much smaller than that of the mesh
ALGEBRAIC = 100.0

#: a value of this part of the largest of its kind is nothing to be settled
_NOTHING = 1e-9


def usable(levels: Sequence[Level]) -> tuple[list[Level], list[str]]:
    """Meshes with an answer and with elements of their own, and what is wrong with the others."""
    kept: list[Level] = []
    said = [
        f"the mesh of {level.mesh_size_mm:.4g} mm gave no answer: {level.message}"
        for level in levels
        if not level.converged
    ]
    for level in levels:
        if not level.converged:
            continue
        same = [k for k in kept if k.elements == level.elements and level.elements > 0]
        if same:
            said.append(
                f"the meshes of {same[0].mesh_size_mm:.4g} mm and {level.mesh_size_mm:.4g} mm "
                f"have the same {level.elements} elements: the coarser is left out; a larger "
                "ratio or a smaller mesh_size would refine"
            )
            kept.remove(same[0])
        kept.append(level)
    return kept, said


def representative_sizes(levels: Sequence[Level], config: Mapping[str, Any]) -> list[float]:
    """Sizes of solved meshes, scaled to the finest mesh's own size."""
    sizes = [level.mesh_size_mm for level in levels]
    return series_sizes(sizes, [level.elements for level in levels], config)


def series_sizes(
    sizes: Sequence[float],
    elements: Sequence[int],
    config: Mapping[str, Any],
    *,
    anchor: int = -1,
) -> list[float]:
    """Sizes by which a series is judged: by its elements, or those at a sharp edge."""
    if edge_rules(config):
        return list(sizes)
    space = str(config["model"].get("space", "axisymmetric"))
    return by_elements(sizes, elements, space, anchor=anchor)


def by_elements(
    sizes: Sequence[float], elements: Sequence[int], space: str, *, anchor: int = -1
) -> list[float]:
    """Sizes h = (V / N)^(1/d) of meshes with N elements, scaled to the size of one of them.

    What counts is the ratio, and the elements a mesh really has decide it (Celik et al. 2008):
    whole numbers of cells never give exactly the ratio that was asked for.

    Examples
    --------
    >>> by_elements([2.0, 1.0], [100, 441], "axisymmetric")
    [2.1, 1.0]
    """
    if min(elements) <= 0 or len(set(elements)) < len(elements):
        return list(sizes)
    power = 1 / (3 if space == "3d" else 2)
    return [sizes[anchor] * (elements[anchor] / n) ** power for n in elements]


def judged(
    sizes: Sequence[float],
    values: Values,
    formal: float | None,
    tolerance: float = SOLVER_TOLERANCE,
) -> dict[str, ConvergenceResult]:
    """Judge every quantity of a series of at least three meshes.

    Parameters
    ----------
    tolerance : float
        Algebraic error as a fraction of the value.
    """
    return {
        name: grid_convergence(
            sizes, numbers, formal_order=formal, qoi=name, unit=unit,
            tolerance=tolerance * max(abs(v) for v in numbers),
        )
        for name, (numbers, unit) in values.items()
    }  # fmt: skip


def within(results: Mapping[str, ConvergenceResult], accuracy: float) -> dict[str, bool]:
    """Whether the uncertainty of each quantity is at most a fraction of its value.

    A series without an order has no GCI; it settles where thrice the range of its finest three
    meshes is small enough (Eca and Hoekstra 2014 for series that are noise).
    """
    return {name: _bound(r) <= accuracy * abs(r.value[0]) + _NOTHING for name, r in results.items()}


def _bound(result: ConvergenceResult) -> float:
    if result.u_num is not None:
        return result.u_num
    finest = result.value[:3]
    return 3 * (max(finest) - min(finest))


def outlook(series: Series, formal: float | None) -> Outlook:
    """Whether every quantity has the accuracy that its problem asks for, else the size it takes."""
    kept, _ = usable(series.levels)
    if len(kept) < 3 or series.spec.tolerance is None:
        return Outlook(False)
    sizes = representative_sizes(kept, series.config)
    results = judged(sizes, curve_values(kept), formal)
    wanted = series.spec.tolerance
    sizes_needed = [size_needed(r, wanted) for r in results.values()]
    known = [size for size in sizes_needed if size is not None]
    return Outlook(all(within(results, wanted).values()), min(known, default=None))


def document(series: Series, formal: FormalOrder, tolerance: float | None = None) -> dict[str, Any]:
    """Everything that a series says, with the keys of the main quantity on top.

    Parameters
    ----------
    tolerance : float, optional
        Algebraic error of the main quantity, in its unit.
    """
    quantity(series.spec.qoi)
    kept, said = usable(series.levels)
    fraction = SOLVER_TOLERANCE
    if tolerance and kept:
        main = curve_values(kept[-1:])[series.spec.qoi][0][0]
        fraction = tolerance / abs(main) if main else fraction
    facts = {
        "formal_reason": formal.why,
        "levels": dict(series.levels_of),
        "meshes": [level.to_json() for level in reversed(series.levels)],
        "stopped": series.stopped,
    }
    if len(kept) < 3:
        return too_few(series.spec.qoi, kept, formal.order, said) | facts
    sizes = representative_sizes(kept, series.config)
    results = judged(sizes, curve_values(kept), formal.order, fraction)
    made = combined(series.spec.qoi, results, series.spec.tolerance, said) | facts
    made["given_mesh"]["mesh_size"] = kept[0].mesh_size_mm
    return made


def combined(
    qoi: str,
    results: Mapping[str, ConvergenceResult],
    accuracy: float | None,
    said: Sequence[str] = (),
) -> dict[str, Any]:
    """Document of several judged quantities; all of them must settle."""
    main = results[qoi]
    open_ = [name for name, ok in within(results, accuracy or 1.0).items() if not ok]
    if accuracy is None:  # nothing small is asked for, but an uncertainty there must be
        open_ = [name for name, r in results.items() if r.u_num is None]
    warnings = [*said, *main.warnings]
    if accuracy is not None and open_:
        warnings.append(f"not within {100 * accuracy:g} %: {', '.join(open_)}")
    return replace(main, warnings=tuple(dict.fromkeys(warnings))).to_json() | {
        "quantities": {name: result.to_json() for name, result in results.items()},
        "accuracy": accuracy,
        "settled": not open_,
        "given_mesh": _given(main),
        "mesh_size_needed": None if accuracy is None else size_needed(main, accuracy),
    }


def _given(result: ConvergenceResult) -> dict[str, Any]:
    """Value and uncertainty on the problem's own mesh, the coarsest of its series."""
    value, u = result.value[-1], None
    if result.extrapolated is not None and result.factor_of_safety is not None:
        u = result.factor_of_safety * abs(value - result.extrapolated)
    elif result.u_num is not None:
        u = max(result.u_num, abs(value - result.value[0]))
    return {"mesh_size": result.mesh_size[-1], "value": value, "u_num": u}


def size_needed(result: ConvergenceResult, accuracy: float) -> float | None:
    """Mesh size whose uncertainty would be the wanted fraction of the value, by the order used."""
    if result.order_used is None or not result.u_num or result.extrapolated in (None, 0.0):
        return None
    allowed = accuracy * abs(result.extrapolated)
    return float(result.mesh_size[0] * (allowed / result.u_num) ** (1 / result.order_used))


def too_few(
    qoi: str, kept: Sequence[Level], formal: float | None, said: Sequence[str]
) -> dict[str, Any]:
    """Document of a series that has no three meshes."""
    function, unit = QUANTITIES[qoi]
    nothing = dict.fromkeys(
        ("observed_order", "extrapolated", "gci_fine", "factor_of_safety", "u_num",
         "asymptotic_ratio", "order_used", "gci_coarse", "order_interval", "accuracy",
         "mesh_size_needed", "given_mesh")
    )  # fmt: skip
    return {
        **nothing,
        "qoi": qoi,
        "unit": unit,
        "mesh_size": [level.mesh_size_mm for level in reversed(kept)],
        "value": [function(level.curve) for level in reversed(kept)],
        "behaviour": "inconclusive",
        "formal_order": formal,
        "verdict": f"an order needs three meshes with an answer, there are {len(kept)}",
        "warnings": list(said),
        "quantities": {},
        "settled": False,
    }


#: relative error of a fitted constant or a score at the tolerances of fit and solver
TOLERANCE = 1e-6


def documents(
    work: Work, bases: Sequence[CaseJob], finer: Work, records: Mapping[str, Record]
) -> list[dict[str, Any]]:
    """Judge every cell by its base case and the refined ones."""
    return [_document(work, base, finer, records) for base in bases]


def _document(
    work: Work, base: CaseJob, finer: Work, records: Mapping[str, Record]
) -> dict[str, Any]:
    jobs = [base, *(j for j in finer.jobs if j.extra.get("of") == base.case.case_id)]
    good, said = [], []
    for job in jobs:
        record = records.get(job.case.case_id)
        size = base_size_mm(job.case)
        if record is not None and record.converged:
            good.append((size, record))
        else:
            why = "it was not computed" if record is None else record.message
            said.append(f"the mesh of {size:.4g} mm gave no answer: {why}")
    formal, spec = formal_of_case(base), work.design.converge
    facts = {
        "levels": dict(base.case.levels), "block": base.case.block, "formal_reason": formal.why,
    }  # fmt: skip
    values = _values(work, [record for _, record in good])
    if len(good) < 3 or not values:
        return _nothing(spec.qoi, formal, len(good), said) | facts
    qoi = spec.qoi if spec.qoi in values else next(iter(values))
    results = judged(_sizes(good, base), values, formal.order, TOLERANCE)
    return combined(qoi, results, spec.tolerance, said) | facts


def _sizes(good: Sequence[tuple[float, Record]], base: CaseJob) -> list[float]:
    """Sizes by the elements the meshes really have, or as asked where a record has no mesh."""
    elements = [int(record.mesh.get("elements", 0)) for _, record in good]
    return series_sizes([size for size, _ in good], elements, base.case.config)


def _values(work: Work, records: Sequence[Record]) -> dict[str, tuple[list[float], str]]:
    """Quantities of the predicted curve, responses of the study, and fitted constants."""
    columns: dict[str, tuple[list[float], str]] = {}

    def add(name: str, numbers: Sequence[float | None], unit: str) -> None:
        known = [float(v) for v in numbers if v is not None]
        if known and len(known) == len(records):
            columns.setdefault(name, (known, unit))

    curves = [_predicted(record) for record in records]
    for name, (function, unit) in QUANTITIES.items():
        add(name, [None if c is None else function(c) for c in curves], unit)
    for name, unit in work.responses.items():
        if name != "seconds":
            add(name, [r.responses.get(name, {}).get("value") for r in records], unit)
    for name, entry in (records[0].parameters if records else {}).items():
        numbers = [r.parameters.get(name, {}).get("value") for r in records]
        add(name, numbers, str(entry.get("unit", "")))
    return columns


def _predicted(record: Record) -> Curve | None:
    return next((c for name, c in record.curves.items() if name.startswith("predicted")), None)


def _nothing(qoi: str, formal: FormalOrder, count: int, said: Sequence[str]) -> dict[str, Any]:

    known = qoi if qoi in QUANTITIES else "peak_force"
    made = too_few(known, [], formal.order, said)
    verdict = f"an order needs three meshes with an answer, there are {count}"
    return made | {"qoi": qoi, "verdict": verdict}


def stored_convergence(rows: Sequence[Numerical]) -> list[dict[str, Any]]:
    """Judge every stored series of a study.

    Returns
    -------
    list of dict
        The keys of a convergence document, with ``levels`` and ``note``; a series of two
        meshes has no order and says so.
    """
    found = []
    for row in rows:
        cell: dict[str, Any] = {"levels": dict(row.levels), "note": row.note}
        if len(row.series) >= 3:
            judged = grid_convergence(
                row.mesh_size, row.series, formal_order=row.formal_order, qoi=row.response,
                unit=row.unit,
            )  # fmt: skip
            cell |= judged.to_json() | {"formal_reason": row.formal_reason}
        else:
            cell |= {
                "qoi": row.response, "unit": row.unit,
                "mesh_size": list(row.mesh_size)[::-1], "value": list(row.series)[::-1],
                "behaviour": "inconclusive", "observed_order": None, "formal_order": None,
                "extrapolated": None, "gci_fine": None, "factor_of_safety": None,
                "u_num": row.u_num, "asymptotic_ratio": None,
                "verdict": f"{len(row.series)} meshes have no order; u_num is that of the study",
            }  # fmt: skip
        found.append(cell)
    return found
