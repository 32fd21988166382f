"""What a study's numbers owe to mesh, spaces and inputs: cells on several meshes, and which cells.

Either a cell was refined beside the study, whose own mesh is then the coarsest, or the meshes are a
factor of the study, and the finest of them is what the others are compared with.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from itertools import accumulate
from typing import Final, Literal

import numpy as np

from study.execution.local import Executor
from study.external.forward_model import ForwardCell
from study.ground.arrays import Array, gathered
from study.ground.canonical import digest
from study.ground.curve import Curve
from study.ground.declaration import table_of, with_table
from study.ground.errors import Fault, InputError, StoreError
from study.harness.runner.batch import Progress, Work, case_job, computed, has_other_mesh, run_batch
from study.record.record import Record, SpaceRow
from study.record.store import Store
from study.simulation.cell import Case, Cell, Config, case_id
from study.simulation.job import CaseJob, FormalOrder, Origin, fits_of, varied
from study.simulation.problem_file import Converge
from study.simulation.refinement import (
    FEWEST,
    OTHER_MESH,
    QUANTITIES,
    SeriesJudgement,
    Values,
    given_mesh,
    inconclusive,
    judged,
    series_sizes,
)
from study.simulation.solve_task import SolveResult, SolveTask, by_workers, kept
from study.simulation.tasks import Costs
from study.statistics.convergence.grid_convergence import (
    CAUTIOUS,
    NumericalUncertainty,
    assumed_order,
    compare,
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
        return (self.base if self.study_mesh == "coarsest" else self.jobs[-1]).promised

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
            return tuple(job_of[record.case_id].size for record in records)
        # another program does not say what its mesh is: it was asked for this one
        sizes = [float(r.mesh.get("mesh_size_mm") or job_of[r.case_id].mesh_size_mm)
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
            sizes = [f"{job.size:.4g}" for job, _ in self.good]
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
        sizes = [job.size for job, _ in self.good]
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
            yield f"the mesh of {job.size:.4g} {unit} gave no answer: {why}"


def refine_cases(series: Sequence[CaseSeries], compute: Compute) -> None:
    """Compute what is missing of every series, all of it together."""
    due = [(m, job) for m in series for job in m.every if job.case.case_id not in m.records]
    records = compute([job for _, job in due]) if due else ()
    for (member, job), record in zip(due, records, strict=True):
        member.records[job.case.case_id] = record


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


# Which cells are computed again.
#
# Cells of every kind of discretization are computed again in the first block, calibration and
# all, on finer meshes: a change of the constants and of the score is what a finer mesh would
# have changed in the study. Only cells whose deformation is not homogeneous have a mesh error.
# All of them are refined where that is cheap, and at least two elsewhere: a difference of cells
# is bounded by its own series, or by the scatter of the error over those that were refined.


PURPOSE: Final = "refinement"

#: Seconds below which the solution on a third mesh is predicted to be cheap, so that it is made.
CHEAP_S = 20.0

#: Seconds for which all cells of one discretization may be refined; a few are beyond that.
ALL_CELLS_S = 60.0

#: Cells of one discretization that are refined where all of them would take too long.
FEW_CELLS = 2

#: Cells whose mean cost is taken for that of all: indenters, depths, interfaces may be factors.
PRICED_CELLS = 8

#: Keys of a model that choose its mesh.
_MESH_KEYS = ("mesh", "mesh_size_mm", "mesh_ratio", "mesh_seed")


def study_series(work: Work) -> list[CaseSeries]:
    """Series of the study's own meshes where they are a factor, else of :func:`chosen` cells."""
    return own_series(work) or chosen_series(work)


def chosen_series(work: Work) -> list[CaseSeries]:
    """Series of the cells of :func:`chosen`."""
    costs, series = Costs(), []
    for base in chosen(work):
        if base.case.problem.refinement is not None:
            times = max(2, work.design.converge.levels - 1)
        else:  # two where the second is cheap, one elsewhere
            times = 2 if _refined_seconds(work, base, costs) < CHEAP_S else 1
        series.append(refined_series(work, base, times))
    return series


def refinement_work(work: Work) -> Work:
    """List the refined cases of a study, as work like any other."""
    refined_cases = (job for cell in chosen_series(work) for job in cell.every[1:])
    return replace(work, jobs=tuple(refined_cases))


def refined_series(work: Work, base: CaseJob, times: int) -> CaseSeries:
    """Series of a cell on its own mesh and some finer ones."""
    size, ratio = base.size, work.design.converge.ratio
    finer = [
        _beside(work, base, refined(base.case, size / ratio**level), level)
        for level in range(1, times + 1)
    ]
    return _series(work, (base, *finer))


def every_series(work: Work) -> list[CaseSeries]:
    """Series of all cells, each refined as often as ``[converge] levels`` says."""
    times = max(2, work.design.converge.levels - 1)
    return [refined_series(work, base, times) for base in every_cell(work)]


def own_series(work: Work) -> list[CaseSeries]:
    """Cells of the first block from coarse to fine; empty unless all columns have three meshes."""
    columns = gathered((_column(job), job) for job in meshed_cells(work))
    if any(len(jobs) < FEWEST for jobs in columns.values()):
        return []
    ordered = (sorted(jobs, key=lambda job: -job.size) for jobs in columns.values())
    return [_series(work, tuple(jobs), "finest") for jobs in ordered]


def _series(
    work: Work, jobs: tuple[CaseJob, ...], end: Literal["coarsest", "finest"] = "coarsest"
) -> CaseSeries:
    """Series of some cases; of a surface with another mesh of the study's own size."""
    base, other = jobs[0 if end == "coarsest" else -1], None
    if base.case.problem.is_meshed_freely:
        again = base.case.cell.on_mesh(mesh_seed=OTHER_MESH)
        other = _beside(work, base, varied(base.case, again, PURPOSE))
    return CaseSeries(jobs, work.design.converge.ratio, end, other=other)


def _beside(work: Work, base: CaseJob, case: Case, level: int = 0) -> CaseJob:
    """Job of a case on another mesh than the study's own."""
    return case_job(case, work, Origin(purpose=PURPOSE, of=base.case.case_id, level=level))


def chosen(work: Work) -> list[CaseJob]:
    """Choose cases of every kind of discretization, in the first block, before any result is seen.

    All of a kind where that is cheap; else those of fewest and of most constants, which the mesh
    can move most differently.
    """
    costs, cells = Costs(), list[CaseJob]()
    kinds = ((discretization_key(job.case.problem), job) for job in meshed_cells(work))
    for jobs in gathered(kinds).values():
        ordered = sorted(jobs, key=lambda job: len(job.case.problem.calibrated_names))
        priced = _spread(ordered, PRICED_CELLS)
        finest = [_refined_seconds(work, job, costs) for job in priced]
        cheap = len(jobs) * float(np.mean(finest)) <= ALL_CELLS_S
        cells += jobs if cheap else _spread(ordered, FEW_CELLS)
    return cells


def _spread(jobs: Sequence[CaseJob], count: int) -> list[CaseJob]:
    return [jobs[round(i)] for i in np.linspace(0, len(jobs) - 1, min(count, len(jobs)))]


def every_cell(work: Work) -> list[CaseJob]:
    """List the case of every cell in the first block."""
    return [job for job in work.jobs if job.case.block in (None, *work.blocks[:1])]


def meshed_cells(work: Work) -> list[CaseJob]:
    """List those whose answer depends on a mesh: their deformation is not homogeneous."""
    return [job for job in every_cell(work) if not job.case.problem.is_homogeneous]


def _refined_seconds(work: Work, job: CaseJob, costs: Costs) -> float:
    """Seconds of a case on the second finer mesh; of a stranger's solver those it says."""
    if job.case.problem.refinement is not None:
        return costs.case_seconds(job)
    finer = refined(job.case, job.size / work.design.converge.ratio**2)
    return costs.solve_seconds(finer.tested)


def refined(case: Case, size: float) -> Case:
    """Copy a case with another mesh in mm, or another value of the parameter that refines it."""
    refinement = case.problem.refinement
    if refinement is not None:
        problem = case.problem.with_parameter(refinement.name, size)
        return varied(case, replace(case.cell, problem=problem), PURPOSE)
    cell, other = case.cell.document(), case.cell.fitted_elsewhere
    # a size stands beside no named mesh: the names of records have been made so
    named = with_table(cell, "model", mesh=None, mesh_size_mm=size)
    if other is not None:
        fitted = with_table(other.document(), "model", mesh=None, mesh_size_mm=size)
        named = with_table(named, "calibration", problem=fitted)
    return varied(case, case.cell.on_mesh(mesh_size_mm=size), PURPOSE, named)


def discretization_key(problem: ForwardCell) -> str:
    """Name of a kind of discretization: cells that share it share their mesh error."""
    if problem.refinement:
        return problem.discretization
    apart, model = ("mesh_ratio", "mesh_seed"), table_of(problem.document(), "model")
    return case_id({k: v for k, v in model.items() if k not in apart})


def _column(job: CaseJob) -> str:
    """Name of a column: everything but the mesh, that of the calibration left out too."""
    problem, other = job.case.problem, job.case.cell.fitted_elsewhere
    document = problem.document()
    if problem.refinement is not None:
        return digest(_without(document, "parameters", problem.refinement.name))
    fitted = {} if other is None else _without(other.document(), "model", *_MESH_KEYS)
    return digest([_without(document, "model", *_MESH_KEYS), fitted.get("model")])


def _without(document: Mapping[str, object], table: str, *keys: str) -> Config:
    left = {k: v for k, v in table_of(document, table).items() if k not in keys}
    return {**document, table: left}


# What the uncertainty of the inputs does: cases computed again with one input moved.
#
# One cell of every combination of the factors that are no discretization, the one that costs
# least, in the first block, is computed again for every input of ``[uncertainty]``, calibration
# and all; the change is carried to the other discretizations in proportion to their force.

#: levels of the factors that are no discretization
Physics = tuple[tuple[str, str], ...]

INPUT_PURPOSE: Final = "input"


def input_work(work: Work) -> Work:
    """List the cases with one input moved by its standard uncertainty, as work like any other."""
    uncertain = {
        key: float(amount)
        for key, amount in work.design.uncertainty.items()
        if amount and not key.startswith("measurements.")
    }
    jobs = []
    for base in representatives(work):
        for key, amount in uncertain.items():
            case = varied(base.case, moved_cell(base.case.cell, key, amount), INPUT_PURPOSE)
            origin = Origin(purpose=INPUT_PURPOSE, of=base.case.case_id, input=key)
            jobs.append(case_job(case, work, origin))
    return replace(work, jobs=tuple(jobs))


def moved_cell(cell: Cell, key: str, amount: float) -> Cell:
    """Copy a cell with one input moved in its tests; the measured points stay where they are."""
    fitted = cell.fitted_elsewhere
    if fitted is not None and fitted.value_at(key) is not None:
        fitted = shifted(_fixed_range(fitted), key, amount)
    predicted = shifted(_fixed_range(cell.problem), key, amount)
    return replace(cell, problem=predicted, fitted_elsewhere=fitted)


def representatives(work: Work) -> list[CaseJob]:
    """List the cheapest cell for every combination of the other factors, in the first block."""
    costs = Costs()
    best: dict[Physics, tuple[float, CaseJob]] = {}
    for job in every_cell(work):
        key = physics_of(job.case.levels)
        price = costs.case_seconds(job)
        if key not in best or price < best[key][0]:
            best[key] = (price, job)
    return [job for _, job in best.values()]


def physics_of(levels: Mapping[str, str]) -> Physics:
    """Levels of the factors that are no discretization."""
    return tuple(
        sorted((k, v) for k, v in levels.items() if k != "model" and not k.startswith("model."))
    )


def shifted(problem: ForwardCell, key: str, amount: float) -> ForwardCell:
    """Copy of a problem with one number moved, named as in the file."""
    value = problem.value_at(key)
    if value is None:
        rule = "has no value in the design that could be uncertain"
        raise InputError(Fault(f"uncertainty.{key}", rule, "give the input, or leave this out"))
    return problem.with_value(key, value + amount)


def _fixed_range(problem: ForwardCell) -> ForwardCell:
    """Say the measured range in mm, so that another height does not move it."""
    spec, height = problem.measurements, problem.height_mm
    if spec is None or height is None or spec.range is None or spec.range.kind == "mm":
        return problem
    low, high = spec.range.in_mm(height)
    in_mm = replace(spec.range, kind="mm", low=low, high=high)
    return replace(problem, measurements=replace(spec, range=in_mm))


def input_shares(work: Work, moved: Work, records: Mapping[str, Record]) -> dict[Physics, Array]:
    """Relative standard uncertainty of the force from all inputs, shape (places,)."""
    shares: dict[Physics, Array] = {}
    for base in representatives(work):
        record = records.get(base.case.case_id)
        if record is None or not record.converged:
            continue
        force = force_at_places(record)
        changes = [
            force_at_places(other) - force
            for job in moved.jobs
            if job.origin.of == base.case.case_id
            and (other := records.get(job.case.case_id)) is not None
            and other.converged
        ]
        if changes:
            squares = np.sum([change**2 for change in changes], axis=0)
            shares[physics_of(base.case.levels)] = np.sqrt(squares) / np.abs(force)
    return shares


# The same cylinder in both spaces: what they differ by where the geometry does not.


SPACES = ("axisymmetric", "3d")


#: levels of the factors of a discretization, space left out; tasks in the order of SPACES
SpacePair = tuple[dict[str, str], list[SolveTask]]


def pairs(work: Work, records: Mapping[str, Record]) -> list[SpacePair]:
    """List what to solve for a study that holds both spaces and a block; empty elsewhere."""
    solved_cells = [job for job in in_blocks(work) if _constants(records.get(job.case.case_id))]
    return [
        (levels, [_task(job, _constants(records[job.case.case_id])) for job in chosen])
        for levels, chosen in _chosen(solved_cells)
    ]


def upcoming(work: Work, records: Mapping[str, Record], store: Store) -> list[CaseJob]:
    """List the cells whose cylinder is still to be solved, each at the cost of the cell's own."""

    def is_open(job: CaseJob) -> bool:
        constants = _constants(records.get(job.case.case_id))
        return not constants or store.read_solution(_task(job, constants).key) is None

    hopeful = [
        job
        for job in in_blocks(work)
        if (record := records.get(job.case.case_id)) is None or _constants(record)
    ]
    return [job for _, both in _chosen(hopeful) for job in both if is_open(job)]


def in_blocks(work: Work) -> list[CaseJob]:
    """List the cells whose specimen has no axis, in the first block of the study."""
    ours = (job for job in meshed_cells(work) if job.case.problem.forward is None)
    return [job for job in ours if job.case.tested.specimen.shape == "block"]


def _chosen(cells: Sequence[CaseJob]) -> Iterator[tuple[dict[str, str], tuple[CaseJob, CaseJob]]]:
    """Finest mesh of both spaces for every kind of element, of the material of fewest constants."""
    # levels that name a kind of element: of the model, but for its space and its mesh
    apart = ("model.space", "model.mesh", "model.mesh_size")

    def kind(job: CaseJob) -> tuple[tuple[str, str], ...]:
        levels = job.case.levels.items()
        return tuple((k, v) for k, v in levels if k.startswith("model.") and k not in apart)

    for levels, jobs in gathered((kind(job), job) for job in cells).items():
        flat, solid = (
            [job for job in jobs if job.case.tested.model.space == space] for space in SPACES
        )
        if flat and solid:
            yield dict(levels), (min(flat, key=_preference), min(solid, key=_preference))


def _preference(job: CaseJob) -> tuple[int, str, float]:
    material = job.case.tested.material
    return len(material.calibrated_names), material.model, job.mesh_size_mm


def _task(job: CaseJob, constants: Mapping[str, float]) -> SolveTask:
    problem = job.case.tested.as_cylinder()
    changed = replace(problem, material=replace(problem.material, constants=dict(constants)))
    depth = job.depth_mm if problem.depth_mm is None else problem.depth_mm
    return SolveTask.of(changed.loaded(displacement_mm=depth), job.mesh_size_mm)


def _constants(record: Record | None) -> dict[str, float]:
    """Constants (MPa) of a case's first fit; empty without an answer."""
    if record is None or not record.converged or not record.fits:
        return {}
    return record.fits[0]["values"]


def compared_spaces(pair: SpacePair, flat: SolveResult, solid: SolveResult) -> SpaceRow:
    """Compare the forces of the two spaces, 3D over axisymmetric: at the end, and where deep."""
    levels, tasks = pair
    row: SpaceRow = {
        "levels": levels,
        "unknowns": [flat.dofs, solid.dofs],
        "depth_mm": tasks[0].problem.setup.test.depth_mm,
        "at_end": None,
        "largest": None,
        "message": "",
    }
    failed = [result.message for result in (flat, solid) if not result.converged]
    if failed:
        return {**row, "message": failed[0]}
    # each may have load steps of its own, where its curve bends
    d = solid.curve.displacement_mm
    apart = solid.curve.force_N / flat.curve.force_at(d) - 1
    deep = d >= d.max() / 2
    largest = apart[deep][abs(apart[deep]).argmax()]
    return {**row, "at_end": float(apart[-1]), "largest": float(largest)}


# What a run computes of all this, and what it stores.


def refine(
    work: Work, store: Store, executor: Executor, progress: Callable[[Progress], None]
) -> None:
    """Compute the refined cases and store what they say of every response."""
    series = _taken(study_series(work), store)
    refine_cases(series, partial(computed, work, store, executor, progress))
    with store.lock():
        store.write_rows("numerical", [asdict(row) for row in uncertainties(work, series)])


def _taken(series: Sequence[CaseSeries], store: Store) -> list[CaseSeries]:
    jobs = (job for case_series in series for job in case_series.every)
    records = store.by_case({job.case.case_id: job.input_hash for job in jobs})
    return [case_series.taking(records) for case_series in series]


def uncertainties(work: Work, series: Sequence[CaseSeries]) -> list[NumericalUncertainty]:
    """Numerical uncertainty of every response that a study asks for, by series."""
    names = [response.name for response in work.design.responses if response.name not in COSTS]
    return [
        case_series.uncertainty(name, work.responses[name])
        for case_series in series
        for name in names
    ]


def compare_spaces(
    work: Work, store: Store, executor: Executor, progress: Callable[[Progress], None]
) -> None:
    """Solve the equivalent cylinder of a block in both spaces, where a study holds both."""
    solids = replace(work, jobs=tuple(in_blocks(work)))
    both = pairs(work, store.by_case(solids.input_hashes))
    if not both:
        return
    began, results = time.monotonic(), dict[str, SolveResult]()
    # the solids take longest: all of them first
    tasks = [tasks[k] for k in (1, 0) for _, tasks in both]
    unsolved = {task.key for task in tasks if store.read_solution(task.key) is None}
    for key, result in kept(by_workers(executor), store)(tasks):
        results[key] = result
        if key in unsolved:
            done, seconds = len(unsolved & results.keys()), time.monotonic() - began
            label, share = "one cylinder in both spaces, a control", done / len(unsolved)
            progress(Progress(done, len(unsolved), 0, seconds, label, share=share))
    rows = [compared_spaces(pair, *(results[task.key] for task in pair[1])) for pair in both]
    with store.lock():
        store.write_rows("spaces", rows)


# Comparison with the measurements, E +- u_val, of every case of a study (ASME V&V 20-2009).


def validate(
    work: Work, store: Store, executor: Executor, progress: Callable[[Progress], None]
) -> list[dict[str, object]]:
    """Move the uncertain inputs, compare every case, and store the rows as ``validation``."""
    moved = input_work(work)
    if moved.jobs:
        run_batch(moved, store, executor, progress)
    rows = compared(work, moved, store)
    with store.lock():
        store.write_rows("validation", rows)
    return rows


def compared(work: Work, moved: Work, store: Store) -> list[dict[str, object]]:
    """One row for every case: E and its uncertainty along the curve, places in mm."""
    records = store.by_case({**work.input_hashes, **moved.input_hashes})
    inputs, mesh = input_shares(work, moved, records), _mesh_shares(work, store)
    rows = []
    for job in work.jobs:
        record = records.get(job.case.case_id)
        if record is None or not record.converged:
            continue
        # where the deformation is the same everywhere no mesh matters
        share = np.zeros(PLACES.size) if job.case.problem.is_homogeneous else mesh(job)
        relabeled_record = replace(record, levels=job.case.levels)
        physics = inputs.get(physics_of(job.case.levels))
        rows.append(_row(relabeled_record, share, physics, work.design.uncertainty))
    return rows


def _mesh_shares(work: Work, store: Store) -> Callable[[CaseJob], Array | None]:
    """Look up the relative u_num of a case: of its own column, or of its kind of discretization."""
    series = own_series(work)
    finest = bool(series)

    def key(job: CaseJob) -> object:
        levels = frozenset(job.case.levels.items())  # whatever the block
        return levels if finest else discretization_key(job.case.problem)

    shares: dict[object, Array | None] = {}
    for case_series in _taken(series or chosen_series(work), store):
        share = case_series.shares()
        jobs = case_series.jobs if finest else (case_series.base,)
        shares |= {key(job): share.get(job.case.case_id) for job in jobs}
    return lambda job: shares.get(key(job))


def _row(
    record: Record, mesh: Array | None, inputs: Array | None, uncertainty: Mapping[str, float]
) -> dict[str, object]:
    fact, pair = next(iter(record.scores), None), record.first_pair()
    if fact is None or pair is None:
        raise StoreError(
            f"case {record.case_id}: its record has an answer and no curve beside a measured one; "
            "delete its folder below cases and run the design again"
        )
    measured, predicted = pair
    d = places_of(measured)
    force = predicted.force_at(d)
    u = {
        "numerics": None if mesh is None else mesh * np.abs(force),
        "inputs": None if inputs is None else inputs * np.abs(force),
        "data": _data(measured, d, fact.get("scatter_N"), uncertainty),
    }
    agreement = compare(d, force, measured.force_at(d), u)
    facts = {"case_id": record.case_id, "levels": dict(record.levels), "block": record.block}
    return facts | {"label": fact["score"], "role": fact["role"]} | agreement


def _data(
    measured: Curve,
    d: Array,
    scatter: Sequence[float | None] | None,
    uncertainty: Mapping[str, float],
) -> Array | None:
    """Add up the standard uncertainty of the measured force: single repeats, and the gauges.

    The scatter is that of one repeat, not of their mean: repeats on one specimen are no
    independent evidence.
    """
    parts = []
    if scatter is not None:
        parts.append(np.interp(d, measured.displacement_mm, np.asarray(scatter, float)))
    if uncertainty.get("measurements.force"):
        parts.append(np.full(d.size, float(uncertainty["measurements.force"])))
    if uncertainty.get("measurements.displacement"):
        slope = np.gradient(measured.force_at(d), d)
        parts.append(np.abs(slope) * float(uncertainty["measurements.displacement"]))
    return np.sqrt(np.sum(np.square(parts), axis=0)) if parts else None
