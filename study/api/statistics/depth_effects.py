"""The same analysis over less of the test, to see whether the answer depends on its depth.

Every case keeps its measured and its predicted curve, so that a response over the first part
of the range costs no simulation. The constants are those of the whole study. Verdicts are held
against numerical uncertainty as the study's own are: where meshes are a factor it is followed
at each depth, elsewhere it is that of the whole test.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from study.api.statistics.records import effects_of_records
from study.curve import Curve
from study.errors import StudyError
from study.runner.response import CURVE_RESPONSES
from study.study_result.report_data import DepthEffect

if TYPE_CHECKING:
    from study.design.spec import Response
    from study.record.record import Record
    from study.study_result.study_result import StudyResult


#: shares of the displacement that are looked at; the last one is the study itself
SHARES = (0.25, 0.5, 0.75, 1.0)

#: measured points that a response needs at least
_FEWEST = 5


def effects_by_depth(study: StudyResult) -> tuple[DepthEffect, ...]:
    """Largest difference of every main effect over the first part of the test.

    Parameters
    ----------
    study : StudyResult
        Responses that compare curves are scored again up to each of :data:`SHARES` of the depth.

    Returns
    -------
    tuple of DepthEffect
        Empty where the tests of the cases differ in depth, or have too few points.
    """
    depth = _common_depth(study.records)
    asked = [r for r in study.design.responses if r.name in CURVE_RESPONSES]
    if depth is None or not asked:
        return ()
    shares = [s for s in SHARES if _points(study.records, s * depth) >= _FEWEST]
    if len(shares) < 2:
        return ()
    return tuple(
        row
        for share in shares
        for response in asked
        for row in _effects(study, response, share * depth)
    )


def _pairs(record: Record) -> Iterator[tuple[Curve, Curve]]:
    for fact in record.scores:
        if (pair := record.pair(fact["score"])) is not None:
            measured, predicted = pair
            yield predicted, measured


def _common_depth(records: Sequence[Record]) -> float | None:
    """Displacement that every scored curve reaches; None where they differ by more than 2 %."""
    ends = [
        float(measured.displacement_mm[-1])
        for record in records
        if record.converged
        for _, measured in _pairs(record)
    ]
    if not ends or max(ends) > 1.02 * min(ends):
        return None
    return min(ends)


def _points(records: Sequence[Record], depth_mm: float) -> int:
    return min(
        int((measured.displacement_mm <= depth_mm * (1 + 1e-9)).sum())
        for record in records
        if record.converged
        for _, measured in _pairs(record)
    )


def _effects(study: StudyResult, response: Response, depth_mm: float) -> Iterator[DepthEffect]:
    records = [_rescored(record, response.name, depth_mm) for record in study.records]
    try:
        found = effects_of_records(study.design, records, response, study.numerical)
    except StudyError:
        return  # the study's own analysis says why
    for e in found:
        if e.is_main and e.range is not None:
            yield DepthEffect(
                response.name, e.term, depth_mm, e.range, e.low, e.high, e.practical, e.verdict,
                e.highest,
            )  # fmt: skip


def _rescored(record: Record, name: str, depth_mm: float) -> Record:
    """Record whose response covers the first part of its curves only."""
    if not record.converged:
        return record
    pairs = [(predicted, _first(measured, depth_mm)) for predicted, measured in _pairs(record)]
    values = [CURVE_RESPONSES[name].between(p, m) for p, m in pairs]
    if not values:
        return record
    entry = record.responses[name].copy()
    entry["value"] = sum(values) / len(values)
    return replace(record, responses={**record.responses, name: entry})


def _first(measured: Curve, depth_mm: float) -> Curve:
    """Part of a measured curve up to a displacement."""
    inside = measured.displacement_mm <= depth_mm * (1 + 1e-9)
    return Curve(measured.displacement_mm[inside], measured.force_N[inside])
