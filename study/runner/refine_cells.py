"""Records of a refined cell -> every quantity that they hold, judged."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from study.curve import Curve
from study.record import Record
from study.runner.expand import CaseJob, Work
from study.runner.refine import base_size_mm
from study.runner.refine_formal import FormalOrder, formal_of_case
from study.runner.refine_judge import QUANTITIES, combined, judged, series_sizes

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
    from study.runner.refine_judge import too_few

    known = qoi if qoi in QUANTITIES else "peak_force"
    made = too_few(known, [], formal.order, said)
    verdict = f"an order needs three meshes with an answer, there are {count}"
    return made | {"qoi": qoi, "verdict": verdict}
