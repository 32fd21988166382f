"""What the uncertainty of the inputs does: cases computed again with one input moved.

One cell of every combination of the factors that are no discretization, the one that costs
least, in the first block, is computed again for every input of ``[uncertainty]``, calibration
and all; the change is carried to the other discretizations in proportion to their force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from study.analysis.convergence.grid_convergence import grid_convergence
from study.arrays import Array
from study.curve import Curve
from study.design.cases import case_id
from study.design.spec import Case
from study.errors import Fault, InputError
from study.measurement.section import MeasurementSpec, Range
from study.record.record import Record
from study.runner.cost import Costs
from study.runner.expansion import case_job
from study.runner.job import CaseJob, FitJob, Work
from study.runner.numerical.curve_quantities import QUANTITIES
from study.runner.numerical.formal_order import formal_of_case
from study.runner.numerical.judgement import ALGEBRAIC
from study.runner.numerical.refinement import Solver, solve_task
from study.runner.numerical.study_refinement import (
    every_cell,
    fine_uncertainty,
    ratio_of,
    record_sizes,
    series_uncertainty,
    two_mesh_uncertainty,
)
from study.setup.setup import known_height_mm

if TYPE_CHECKING:
    from study.runner.numerical.refinement import Series


def with_sources(made: dict[str, Any], series: Series, solver: Solver) -> dict[str, Any]:
    """Add the table of the three errors to the document of a series."""
    rows, said = other_sources(series.config, series.good[0].mesh_size_mm, solver)
    table = one_table(made, rows)
    return made | {"sources": table, "warnings": [*made["warnings"], *said, *remarks(table)]}


PURPOSE = "input"

#: places along a curve where it is compared, from its first measured point to its last
PLACES = np.linspace(0.0, 1.0, 21)
_SUFFIXES = ("", "_mm", "_MPa", "_deg", "_N", "_s")


def input_work(work: Work) -> Work:
    """List the cases with one input moved by its standard uncertainty, as work like any other.

    Raises
    ------
    InputError
        If an input has no value in the design that could be moved.
    """
    fits: dict[str, FitJob] = {}
    jobs = []
    for base in representatives(work):
        for key, amount in moved_inputs(work).items():
            case = _moved(base.case, key, amount)
            facts = {"purpose": PURPOSE, "of": base.case.case_id, "input": key}
            jobs.append(case_job(case, work.data, fits, work.responses, facts))
    return replace(work, jobs=tuple(jobs), fits=fits)


def moved_inputs(work: Work) -> dict[str, float]:
    """List the uncertain inputs of the simulation; those of the data move no case."""
    return {
        k: float(u)
        for k, u in work.design.uncertainty.items()
        if u and not k.startswith("measurements.")
    }


def representatives(work: Work) -> list[CaseJob]:
    """List the cheapest cell for every combination of the other factors, in the first block."""
    costs = Costs()
    best: dict[Any, tuple[float, CaseJob]] = {}
    for job in every_cell(work):
        key = physics_of(job.case.levels)
        price = costs.case_seconds(job)
        if key not in best or price < best[key][0]:
            best[key] = (price, job)
    return [job for _, job in best.values()]


def physics_of(levels: Mapping[str, str]) -> tuple[tuple[str, str], ...]:
    """Levels of the factors that are no discretization."""
    return tuple(
        sorted((k, v) for k, v in levels.items() if k != "model" and not k.startswith("model."))
    )


def _moved(case: Case, key: str, amount: float) -> Case:
    """Copy a case with one input moved; the measured points stay where they are."""
    config = shifted(_fixed_range(case.config), key, amount)
    own = (config.get("calibration") or {}).get("problem")
    if own and key.split(".")[0] in own:
        inner = shifted(_fixed_range(own), key, amount)
        config["calibration"] = {**config["calibration"], "problem": inner}
    name = case_id({**config, "block": case.block, "purpose": PURPOSE})
    return replace(case, config=config, case_id=name)


def shifted(config: Mapping[str, Any], key: str, amount: float) -> dict[str, Any]:
    """Copy of a configuration with one value moved, named as in the file.

    Examples
    --------
    >>> shifted({"specimen": {"height_mm": 30.0}}, "specimen.height", 0.5)
    {'specimen': {'height_mm': 30.5}}
    """
    path = key.split(".")
    return _shifted(config, path, amount, key)


def _shifted(
    section: Mapping[str, Any], path: Sequence[str], amount: float, key: str
) -> dict[str, Any]:
    if len(path) > 1 and isinstance(section.get(path[0]), Mapping):
        inner = _shifted(section[path[0]], path[1:], amount, key)
        return {**section, path[0]: inner}
    constants = section.get("constants")
    if isinstance(constants, Mapping) and path[-1] in constants:
        return {**section, "constants": _shifted(constants, path[-1:], amount, key)}
    for suffix in _SUFFIXES:
        name = path[-1] + suffix
        if isinstance(section.get(name), (int, float)):
            return {**section, name: float(section[name]) + amount}
    rule = "has no value in the design that could be uncertain"
    raise InputError(Fault(f"uncertainty.{key}", rule, "give the input, or leave this out"))


def _fixed_range(config: Mapping[str, Any]) -> dict[str, Any]:
    """Say the measured range in mm, so that another height does not move it."""
    spec, height = config.get("measurements"), known_height_mm(config.get("specimen") or {})
    if spec is None or height is None:
        return dict(config)
    made = spec if isinstance(spec, MeasurementSpec) else MeasurementSpec.from_dict(spec)
    if made.range is None or made.range.kind == "mm":
        return dict(config)
    low, high = made.range.in_mm(height)
    return {**config, "measurements": replace(made, range=Range("mm", low, high))}


def input_shares(work: Work, moved: Work, records: Mapping[str, Record]) -> dict[Any, Array]:
    """Relative standard uncertainty of the force from all inputs, at :data:`PLACES`.

    Returns
    -------
    dict
        By :func:`physics_of`; a cell without an answer is left out.
    """
    found: dict[Any, Array] = {}
    for base in representatives(work):
        record = records.get(base.case.case_id)
        if record is None or not record.converged:
            continue
        force = _force(record)
        changes = [
            _force(other) - force
            for job in moved.jobs
            if job.extra["of"] == base.case.case_id
            and (other := records.get(job.case.case_id)) is not None
            and other.converged
        ]
        if force is not None and changes:
            squares = np.sum([change**2 for change in changes], axis=0)
            found[physics_of(base.case.levels)] = np.sqrt(squares) / np.abs(force)
    return found


def mesh_shares(
    bases: Sequence[CaseJob], finer: Work, records: Mapping[str, Record], ratio: float
) -> dict[str, Array]:
    """Relative numerical uncertainty of the force at :data:`PLACES`, by name of the base case."""
    found: dict[str, Array] = {}
    for base in bases:
        jobs = [base, *(j for j in finer.jobs if j.extra.get("of") == base.case.case_id)]
        kept = [records.get(job.case.case_id) for job in jobs]
        good = [r for r in kept if r is not None and r.converged]
        forces, sizes = [_force(r) for r in good], record_sizes(good, base) if good else ()
        if len(forces) < 2:
            continue
        columns = np.array(forces).T
        if len(forces) == 2:
            u = [two_mesh_uncertainty(a, b, ratio_of(sizes, ratio)) for a, b in columns]
        else:
            formal = formal_of_case(base).order
            u = [series_uncertainty(list(column), ratio, sizes, formal)[1] for column in columns]
        found[base.case.case_id] = np.array(u) / np.abs(columns[:, 0])
    return found


def column_shares(
    series: Sequence[Sequence[CaseJob]], records: Mapping[str, Record]
) -> dict[str, Array]:
    """Relative numerical uncertainty of the force at :data:`PLACES`, by name of the case.

    A coarser mesh of a column is off by its distance to the finest, and the finest by its own
    uncertainty; the sum is on the safe side.

    Parameters
    ----------
    series : sequence of sequence of CaseJob
        As :func:`study.runner.numerical.study_refinement.columns` gives them. One of which
        a mesh gave no answer is left out.
    """
    found: dict[str, Array] = {}
    for jobs in series:
        kept = [records.get(job.case.case_id) for job in jobs]
        good = [r for r in kept if r is not None and r.converged]
        if len(good) < len(jobs):
            continue
        forces, sizes = np.array([_force(r) for r in good]), record_sizes(good, jobs[0])
        formal = formal_of_case(jobs[-1]).order
        u = np.array([fine_uncertainty(list(place), sizes, formal)[1] for place in forces.T])
        for job, force in zip(jobs, forces, strict=True):
            found[job.case.case_id] = (np.abs(force - forces[-1]) + u) / np.abs(force)
    return found


def places_of(measured: Curve) -> Array:
    """Displacements of :data:`PLACES` on a measured curve, mm."""
    d = measured.displacement_mm
    return np.asarray(d[0] + PLACES * (d[-1] - d[0]))


def _force(record: Record) -> Array:
    """Predicted force of the first direction at the places, N."""
    label = next(k.removeprefix("predicted:") for k in record.curves if k.startswith("predicted:"))
    measured = record.curves[f"measured:{label}"]
    return record.curves[f"predicted:{label}"].force_at(places_of(measured))


#: how many load steps replace one, and how much looser than usual the solver is
STEPS = (1, 2, 4)
LOOSER = (1.0, 10.0, 100.0)


def source_tasks(config: Mapping[str, Any], size_mm: float) -> list[dict[str, Any]]:
    """Solutions that the two studies need, the usual one first."""
    usual = [solve_task(config, size_mm)]
    usual += [solve_task(config, size_mm, more_steps=k) for k in STEPS[1:]]
    return usual + [solve_task(config, size_mm, looser=k) for k in LOOSER[1:]]


def other_sources(
    config: Mapping[str, Any], size_mm: float, solve: Solver
) -> tuple[list[dict[str, Any]], list[str]]:
    """Rows of load steps and tolerance for every quantity, and what failed.

    Returns
    -------
    rows : list of dict
        ``source``, ``quantity``, ``unit``, ``setting`` (finest first), ``value``, ``u`` (in the
        unit) and ``relative``.
    said : list of str
        Solutions without an answer.
    """
    results = solve(source_tasks(config, size_mm))
    count = int(config["test"].get("steps") or 10)
    steps = [(float(count * k), r) for k, r in zip(STEPS, results, strict=False)]
    looser = [(k, r) for k, r in zip(LOOSER, [results[0], *results[len(STEPS) :]], strict=True)]
    rows, said = [], []
    for name, pairs, text in (
        ("load steps", steps[::-1], "{:g} load steps"),
        ("solver tolerance", looser, "a tolerance {:g} times the usual"),
    ):
        good = [(k, r) for k, r in pairs if r["status"] == "converged"]
        said += [
            f"{text.format(k)} gave no answer: {r.get('message', '')}"
            for k, r in pairs
            if r["status"] != "converged"
        ]
        rows += [_row(name, quantity, good) for quantity in QUANTITIES if len(good) > 1]
    return rows, said


def _row(source: str, name: str, good: Sequence[tuple[float, Mapping[str, Any]]]) -> dict[str, Any]:
    function, unit = QUANTITIES[name]
    values = [function(Curve.from_dict(r["curve"])) for _, r in good]
    settings = [k for k, _ in good]
    # steps: what the problem's own number of them is off by; tolerance: what ten times it costs
    own = values[-1] if source == "load steps" else values[1]
    reference = values[0]
    u = _error_of(values) if source == "load steps" else abs(own - reference)
    return {
        "source": source, "quantity": name, "unit": unit, "setting": settings, "value": values,
        "u": u, "relative": u / abs(reference) if reference else None,
    }  # fmt: skip


def _error_of(values: Sequence[float]) -> float:
    """Uncertainty of the last (coarsest) value: the changes of a halved step form a series."""
    change = abs(values[-1] - values[0])
    if len(values) < 3:
        return change
    found = grid_convergence([1.0, 2.0, 4.0], values, tolerance=1e-8 * abs(values[0]))
    if found.extrapolated is None or found.factor_of_safety is None:
        return change
    return max(change, found.factor_of_safety * abs(values[-1] - found.extrapolated))


def one_table(
    document: Mapping[str, Any], rows: Sequence[Mapping[str, Any]]
) -> list[dict[str, Any]]:
    """Set the three sources of error of every quantity side by side."""
    table = []
    for name, result in document["quantities"].items():
        value = result["value"][0]
        mesh = {
            "source": "mesh", "quantity": name, "unit": result["unit"],
            "setting": result["mesh_size"], "value": result["value"], "u": result["u_num"],
            "relative": None if result["u_num"] is None or not value
            else result["u_num"] / abs(value),
        }  # fmt: skip
        table += [mesh, *(dict(row) for row in rows if row["quantity"] == name)]
    return table


def remarks(table: Sequence[Mapping[str, Any]]) -> list[str]:
    """Say where another error is too large beside that of the mesh."""
    found = []
    meshes = {row["quantity"]: row["relative"] for row in table if row["source"] == "mesh"}
    for row in table:
        mesh, own = meshes.get(row["quantity"]), row["relative"]
        if row["source"] == "mesh" or mesh is None or own is None:
            continue
        if row["source"] == "solver tolerance" and own * ALGEBRAIC > max(mesh, 1e-9):
            found.append(
                f"{row['quantity']}: the solver's tolerance moves it by {own:.1g} of its value, "
                f"more than a hundredth of the mesh's {mesh:.1g}"
            )
        if row["source"] == "load steps" and own > mesh:
            found.append(
                f"{row['quantity']}: the load steps are off by {own:.1g} of its value, more than "
                f"the mesh ({mesh:.1g}): raise test.steps before refining"
            )
    return found
