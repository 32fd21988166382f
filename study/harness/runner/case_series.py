"""Cases of one cell that differ in their mesh alone: what the series says of a study's numbers.

Either the cell was refined beside the study, whose own mesh is then the coarsest, or the meshes
are a factor of the study, and the finest of them is what the others are compared with.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Literal

import numpy as np

from study.ground.arrays import Array
from study.ground.curve import Curve
from study.ground.errors import StoreError
from study.harness.runner.batch import has_other_mesh
from study.record.record import Record
from study.simulation.job import CaseJob, fits_of
from study.simulation.problem_file import Converge
from study.simulation.refinement import (
    FEWEST,
    QUANTITIES,
    FormalOrder,
    SeriesJudgement,
    Values,
    base_size_mm,
    given_mesh,
    inconclusive,
    judged,
    promised,
    series_sizes,
)
from study.simulation.tasks import Costs
from study.statistics.convergence.grid_convergence import (
    CAUTIOUS,
    NumericalUncertainty,
    assumed_order,
    grid_convergence,
)

#: Relative error of a fitted constant or a score at the tolerances of fit and solver.
TOLERANCE = 1e-6

#: Responses that tell what a solution costs: they grow with the mesh and converge to nothing.
COSTS = ("seconds", "dofs")

#: Places along a curve where it is compared, from its first measured point to its last.
PLACES = np.linspace(0.0, 1.0, 21)


@dataclass
class CaseSeries:
    """Cases of one cell on several meshes, from coarse to fine, and their records."""

    jobs: tuple[CaseJob, ...]
    #: Ratio of the element sizes that was asked for.
    ratio: float
    study_mesh: Literal["coarsest", "finest"] = "coarsest"
    #: What is computed of them, by case id; None where that failed to give a record.
    records: dict[str, Record | None] = field(default_factory=dict)
    #: The case on another mesh of the study's own size, where a generator chooses among many.
    other: CaseJob | None = None

    @property
    def base(self) -> CaseJob:
        """The case on the coarsest mesh."""
        return self.jobs[0]

    @property
    def every(self) -> tuple[CaseJob, ...]:
        """Cases of the series and that on another mesh."""
        return self.jobs if self.other is None else (*self.jobs, self.other)

    def taking(self, records: Mapping[str, Record]) -> CaseSeries:
        """Take what is computed of its cases, and return it."""
        names = (job.case.case_id for job in self.every)
        self.records |= {name: records[name] for name in names if name in records}
        return self

    @property
    def levels(self) -> dict[str, str]:
        """Levels that all cases share."""
        first, last = self.jobs[0].case.levels, self.jobs[-1].case.levels
        return {name: level for name, level in first.items() if last[name] == level}

    @property
    def formal(self) -> FormalOrder:
        """Order that the elements of the study's mesh promise, or a stranger's solver."""
        return promised(self.base if self.study_mesh == "coarsest" else self.jobs[-1])

    @property
    def good(self) -> list[tuple[CaseJob, Record]]:
        """Cases with an answer on the mesh that is theirs in the series."""
        return [(job, record) for job in self.jobs if (record := self._answer(job)) is not None]

    def _answer(self, job: CaseJob) -> Record | None:
        """Record of a case with an answer on the mesh that is its own."""
        record = self.records.get(job.case.case_id)
        usable = record is not None and record.converged and not has_other_mesh(record)
        return record if usable else None

    def sizes(self, records: Sequence[Record]) -> tuple[float, ...]:
        """Mesh sizes of some records by the elements of their meshes, the first as asked for."""
        job_of = {job.case.case_id: job for job in self.jobs}
        if self.base.case.problem.refinement is not None:
            return tuple(size_of(job_of[record.case_id]) for record in records)
        # another program does not say what its mesh is: it was asked for this one
        sizes = [float(r.mesh.get("mesh_size_mm") or base_size_mm(job_of[r.case_id]))
                 for r in records]  # fmt: skip
        elements = [int(record.mesh.get("elements", 0)) for record in records]
        return tuple(series_sizes(sizes, elements, self.base.case.tested.setup, anchor=0))

    def half_width(
        self, values: Sequence[float], sizes: Sequence[float], formal: float | None
    ) -> tuple[str, float]:
        """Behaviour of some values from coarse to fine, and half-width on the study's mesh."""
        if len(set(sizes)) < len(sizes) or min(sizes) <= 0:  # the meshes do not say theirs
            sizes = [self.ratio**-k for k in range(len(sizes))]
        order = assumed_order(formal) if len(values) == 2 else formal
        result = grid_convergence(sizes, values, formal_order=order)
        bound = result.u_num if self.study_mesh == "finest" else result.bound_of(values[0])
        return result.behaviour, math.inf if bound is None else bound

    def uncertainty(self, response: str, unit: str) -> NumericalUncertainty:
        """Numerical uncertainty of a response on the study's mesh.

        What the size of the elements and the choice of a mesh of that size move is independent,
        and adds up in squares. Thrice the difference of two meshes holds the deviation of one from
        the mean of all in 89 of 100 cases.
        """
        answered = [(job, r, v) for job, r in self.good if (v := r.value(response)) is not None]
        values = tuple(value for _, _, value in answered)
        lacking = self._lacking([job for job, _, _ in answered])
        if lacking:
            first = bool(answered) and answered[0][0] is self.base and self.study_mesh == "coarsest"
            value = values[0] if first else None
            return NumericalUncertainty(
                self.levels, response, value, None, unit, "not available", lacking
            )
        sizes, formal = self.sizes([record for _, record, _ in answered]), self.formal
        behaviour, u = self.half_width(values, sizes, formal.order)
        value = values[0 if self.study_mesh == "coarsest" else -1]
        note = self._note(len(answered))
        if self.other is not None:
            again = None if self._again is None else self._again.value(response)
            if again is None:
                note += "; no other mesh of the study's own size gave an answer"
            else:
                note += f"; another mesh of the study's own size gives {again:.4g} {unit}".rstrip()
                u = math.hypot(u, CAUTIOUS * abs(again - value))
        return NumericalUncertainty(
            self.levels, response, value, u, unit, behaviour, note, sizes, values,
            formal.order, formal.why,
        )  # fmt: skip

    @property
    def _again(self) -> Record | None:
        """Answer on another mesh of the study's own size."""
        return None if self.other is None else self._answer(self.other)

    def _lacking(self, answered: Sequence[CaseJob]) -> str:
        """Why the meshes with an answer are too few; empty if they are enough."""
        if self.study_mesh == "finest":
            few = len(answered) < len(self.jobs)
            return f"{len(answered)} of {len(self.jobs)} meshes gave an answer" if few else ""
        few = len(answered) < 2 or answered[0] is not self.base
        return f"no second mesh gave an answer ({self.base.case.label})" if few else ""

    def _note(self, meshes: int) -> str:
        """Which meshes an uncertainty rests on."""
        refinement = self.base.case.problem.refinement
        if refinement is not None:
            sizes = [f"{size_of(job):.4g}" for job, _ in self.good]
            of = self.base.case.label if self.study_mesh == "coarsest" else "the study's own cells"
            return f"{of}; {refinement.name} = {sizes[0]} to {sizes[-1]} in {meshes} steps"
        ends = (self.good[0][1], self.good[-1][1])
        unknowns = " to ".join(str(int(record.mesh.get("dofs", 0))) for record in ends)
        if self.study_mesh == "finest":
            return f"the study's own {meshes} meshes, {unknowns} unknowns; on the finest"
        label = self.base.case.label
        return f"{label}; {meshes} meshes of ratio {self.ratio:g}, {unknowns} unknowns"

    def shares(self) -> dict[str, Array]:
        """Relative numerical uncertainty of the force at :data:`PLACES`, by case id.

        Of a refined cell that of its own mesh. Where the meshes are a factor a coarser one is
        off by its distance to the finest, and the finest by its own uncertainty: the sum is on
        the safe side. Empty where too few meshes gave an answer.
        """
        good = self.good
        if len(good) < (len(self.jobs) if self.study_mesh == "finest" else 2):
            return {}
        forces = np.array([force_at_places(record) for _, record in good])
        sizes, formal = self.sizes([record for _, record in good]), self.formal.order
        u = np.array([self.half_width(list(by_mesh), sizes, formal)[1] for by_mesh in forces.T])
        if self._again is not None:
            reference = forces[0 if self.study_mesh == "coarsest" else -1]
            u = np.hypot(u, CAUTIOUS * np.abs(force_at_places(self._again) - reference))
        if self.study_mesh == "coarsest":
            return {self.base.case.case_id: u / np.abs(forces[0])}
        return {
            job.case.case_id: (np.abs(force - forces[-1]) + u) / np.abs(force)
            for (job, _), force in zip(good, forces, strict=True)
        }

    def judge(self, spec: Converge, units: Mapping[str, str]) -> SeriesJudgement:
        """Judge curves, responses and constants of the series."""
        records, formal, base = [record for _, record in self.good], self.formal, self.base.case
        warnings, values = tuple(self._unanswered()), quantities(records, units)
        if len(records) < FEWEST or not values:
            unit = QUANTITIES[spec.qoi if spec.qoi in QUANTITIES else "peak_force"][1]
            verdict = f"an order needs three meshes with an answer, there are {len(records)}"
            main = inconclusive(spec.qoi, unit, [], [], formal_order=formal.order, verdict=verdict)
            judgement = SeriesJudgement(main, {}, formal.why, levels=base.levels, block=base.block)
            return judgement.warned(*warnings)
        elements = [int(record.mesh.get("elements", 0)) for record in records]
        sizes = [size_of(job) for job, _ in self.good]
        if base.problem.refinement is None:
            sizes = series_sizes(sizes, elements, base.tested.setup)
        results = judged(sizes, values, formal.order, TOLERANCE)
        main = results[spec.qoi if spec.qoi in values else next(iter(values))]
        return SeriesJudgement(
            replace(main, warnings=(*warnings, *main.warnings)), results, formal.why,
            spec.tolerance, base.levels, given_mesh(main), block=base.block,
        ).noted()  # fmt: skip

    def _unanswered(self) -> Iterable[str]:
        for job in self.jobs:
            if self._answer(job) is not None:
                continue
            record, refinement = self.records.get(job.case.case_id), job.case.problem.refinement
            why = "it was not computed" if record is None else record.message
            if record is not None and record.converged:
                why = "only a finer one did, on a second try"
            unit = "mm" if refinement is None else f"({refinement.name})"
            yield f"the mesh of {size_of(job):.4g} {unit} gave no answer: {why}"


def refine_cases(series: Sequence[CaseSeries], compute: Compute) -> None:
    """Compute what is missing of every series, all of it together."""
    due = [(m, job) for m in series for job in m.every if job.case.case_id not in m.records]
    records = compute([job for _, job in due]) if due else ()
    for (member, job), record in zip(due, records, strict=True):
        member.records[job.case.case_id] = record


def size_of(job: CaseJob) -> float:
    """Size of the mesh of a case in mm, or the value of the parameter that refines it."""
    refinement = job.case.problem.refinement
    return base_size_mm(job) if refinement is None else refinement.size(job.case.problem)


def quantities(records: Sequence[Record], units: Mapping[str, str]) -> Values:
    """Values of the predicted curve, of responses and of constants that every record has."""
    columns: dict[str, tuple[list[float], str]] = {}

    def add(name: str, numbers: Iterable[float | None], unit: str) -> None:
        values = [float(v) for v in numbers if v is not None]
        if values and len(values) == len(records):
            columns.setdefault(name, (values, unit))

    curves = [record.first_prediction() for record in records]
    for name, (function, unit) in QUANTITIES.items():
        add(name, (None if curve is None else function(curve) for curve in curves), unit)
    for name, unit in units.items():
        if name not in COSTS:
            add(name, (record.value(name) for record in records), unit)
    for name, entry in (records[0].parameters if records else {}).items():
        entries = [record.parameters.get(name) for record in records]
        add(name, (None if p is None else p["value"] for p in entries), entry["unit"])
    return columns


def places_of(curve: Curve) -> Array:
    """Displacements of :data:`PLACES` on a curve, mm."""
    d = curve.displacement_mm
    return np.asarray(d[0] + PLACES * (d[-1] - d[0]))


def force_at_places(record: Record) -> Array:
    """Predicted force of the first direction at :data:`PLACES` of the curve it is scored on, N."""
    pair, predicted = record.first_pair(), record.first_prediction()
    if predicted is None:
        raise StoreError(
            f"case {record.case_id}: its record has an answer and no curve; delete its folder "
            "below cases and run the design again"
        )
    return predicted.force_at(places_of(predicted if pair is None else pair[0]))


def stored_convergence(rows: Sequence[NumericalUncertainty]) -> list[dict[str, object]]:
    """Judge every stored series of a study."""
    return [{"levels": dict(row.levels), "note": row.note, **_stored(row)} for row in rows]


def _stored(row: NumericalUncertainty) -> dict[str, object]:
    sizes, values = row.mesh_size, row.series
    if len(values) >= FEWEST:
        result = grid_convergence(
            sizes, values, formal_order=row.formal_order, qoi=row.response, unit=row.unit
        )
        return {**result.to_json(), "formal_reason": row.formal_reason}
    verdict = f"{len(values)} meshes have no order; u_num is that of the study"
    few = inconclusive(row.response, row.unit, sizes, values, u_num=row.u_num, verdict=verdict)
    return few.to_json()


# Refinement within a time budget, mesh by mesh, cheapest cells first.
#
# Before the first mesh a cost is a prediction, which may be off by several times; from then on a
# cell costs what its last mesh took, times the predicted ratio of the two.

Compute = Callable[[Sequence[CaseJob]], Sequence[Record | None]]


def refine_within(
    seconds: float, workers: int, series: Sequence[CaseSeries], compute: Compute
) -> list[CaseSeries]:
    """Refine cells as far as a time budget allows."""
    until, costs, ongoing = time.monotonic() + seconds, Costs(), list(series)
    predicted = {
        job.case.case_id: costs.total_seconds(fits_of([job]).values(), [job], 1)
        for case_series in series
        for job in case_series.jobs
    }
    for level in range(max((len(case_series.jobs) for case_series in series), default=0)):
        left = (until - time.monotonic()) * workers
        prices = [_price(case_series, level, predicted) for case_series in ongoing]
        order = sorted(range(len(ongoing)), key=lambda i: prices[i])
        spent = accumulate(prices[i] for i in order)
        ongoing = [ongoing[i] for i, total in zip(order, spent, strict=True) if total <= left]
        steps = [case_series.jobs[level] for case_series in ongoing]
        answers = compute(steps) if steps else ()
        for refined, step, answer in zip(ongoing, steps, answers, strict=True):
            refined.records[step.case.case_id] = answer
    return ongoing


def _price(case_series: CaseSeries, level: int, predicted: Mapping[str, float]) -> float:
    """Worker seconds of a cell's next mesh, its calibrations too."""
    names = [job.case.case_id for job in case_series.jobs]
    last = case_series.records.get(names[level - 1]) if level else None
    taken = None if last is None else last.timings.get("total")
    if taken is None:
        return predicted[names[level]]
    return taken * predicted[names[level]] / predicted[names[level - 1]]
