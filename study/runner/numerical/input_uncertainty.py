"""What the uncertainty of the inputs does: cases computed again with one input moved.

One cell of every combination of the factors that are no discretization, the one that costs
least, in the first block, is computed again for every input of ``[uncertainty]``, calibration
and all; the change is carried to the other discretizations in proportion to their force.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from study.arrays import Array
from study.design.spec import Case
from study.errors import Fault, InputError
from study.measurement.section import Range
from study.record.record import Record
from study.runner.case_task import Origin
from study.runner.cost import Costs
from study.runner.expansion import case_job
from study.runner.job import CaseJob, Work, varied
from study.runner.numerical.case_series import force_at_places
from study.runner.numerical.study_refinement import every_cell
from study.runner.tables import CalibrationTable, measurements_of, value_named
from study.setup.section import table_of, with_table
from study.setup.setup import Tables, known_height_mm

#: levels of the factors that are no discretization
Physics = tuple[tuple[str, str], ...]

PURPOSE: Final = "input"


def input_work(work: Work) -> Work:
    """List the cases with one input moved by its standard uncertainty, as work like any other.

    Parameters
    ----------
    work : Work
        The study.

    Returns
    -------
    Work
        Instead of its own cases one for every cell of :func:`representatives` and every input of
        :func:`moved_inputs`.

    Raises
    ------
    InputError
        If an input has no value in the design that could be moved.
    """
    jobs = []
    for base in representatives(work):
        for key, amount in moved_inputs(work).items():
            case = _moved(base.case, key, amount)
            origin = Origin(purpose=PURPOSE, of=base.case.case_id, input=key)
            jobs.append(case_job(case, work.data, work.design, origin))
    return replace(work, jobs=tuple(jobs))


def moved_inputs(work: Work) -> dict[str, float]:
    """List the uncertain inputs of the simulation; those of the data move no case.

    Parameters
    ----------
    work : Work
        The table ``[uncertainty]`` of its design counts; zeros are left out.

    Returns
    -------
    dict of str to float
        Standard uncertainty in internal units (mm, N, MPa, deg, s), by dotted key.
    """
    return {
        k: float(u)
        for k, u in work.design.uncertainty.items()
        if u and not k.startswith("measurements.")
    }


def representatives(work: Work) -> list[CaseJob]:
    """List the cheapest cell for every combination of the other factors, in the first block.

    Parameters
    ----------
    work : Work
        The study; the other factors are those that are no discretization.
    """
    costs = Costs()
    best: dict[Physics, tuple[float, CaseJob]] = {}
    for job in every_cell(work):
        key = physics_of(job.case.levels)
        price = costs.case_seconds(job)
        if key not in best or price < best[key][0]:
            best[key] = (price, job)
    return [job for _, job in best.values()]


def physics_of(levels: Mapping[str, str]) -> Physics:
    """Levels of the factors that are no discretization.

    Parameters
    ----------
    levels : mapping of str to str
        Label of every factor; ``model`` and ``model.*`` are left out.

    Returns
    -------
    tuple of tuple of str
        Factor and label, sorted.
    """
    return tuple(
        sorted((k, v) for k, v in levels.items() if k != "model" and not k.startswith("model."))
    )


def _moved(case: Case, key: str, amount: float) -> Case:
    """Copy a case with one input moved; the measured points stay where they are."""
    config = shifted(_fixed_range(case.config), key, amount)
    own = CalibrationTable.of(config).problem
    if own and key.split(".")[0] in own:
        inner = shifted(_fixed_range(own), key, amount)
        config = with_table(config, "calibration", problem=inner)
    return varied(case, config, PURPOSE)


def shifted(config: Tables, key: str, amount: float) -> Tables:
    """Copy of a configuration with one value moved, named as in the file.

    Parameters
    ----------
    config : mapping
        Document of a problem, in internal units.
    key : str
        Dotted, without the unit that ends the key of a document; a constant of the material stands
        directly in its table, as in ``"material.C10"``.
    amount : float
        Added to the value, in its internal unit.

    Raises
    ------
    InputError
        If the document holds no such number.

    Examples
    --------
    >>> shifted({"specimen": {"height_mm": 30.0}}, "specimen.height", 0.5)
    {'specimen': {'height_mm': 30.5}}
    """
    path = key.split(".")
    return _shifted(config, path, amount, key)


def _shifted(section: Tables, path: Sequence[str], amount: float, key: str) -> Tables:
    inner = table_of(section, path[0])
    if len(path) > 1 and inner:
        return {**section, path[0]: _shifted(inner, path[1:], amount, key)}
    constants = section.get("constants")
    if isinstance(constants, Mapping) and path[-1] in constants:
        return {**section, "constants": _shifted(constants, path[-1:], amount, key)}
    found = value_named(section, path[-1])
    if found is not None:
        return {**section, found[0]: found[1] + amount}
    rule = "has no value in the design that could be uncertain"
    raise InputError(Fault(f"uncertainty.{key}", rule, "give the input, or leave this out"))


def _fixed_range(config: Tables) -> Tables:
    """Say the measured range in mm, so that another height does not move it."""
    made, height = measurements_of(config), known_height_mm(table_of(config, "specimen"))
    if made is None or height is None or made.range is None:
        return config
    if made.range.kind == "mm":
        return config
    low, high = made.range.in_mm(height)
    return {**config, "measurements": replace(made, range=Range("mm", low, high))}


def input_shares(work: Work, moved: Work, records: Mapping[str, Record]) -> dict[Physics, Array]:
    """Relative standard uncertainty of the force from all inputs, at the places of a series.

    Parameters
    ----------
    work : Work
        The study.
    moved : Work
        Of :func:`input_work`.
    records : mapping of str to Record
        What is computed of both, by case id; a moved case without an answer is left out.

    Returns
    -------
    dict of tuple to ndarray, shape (places,)
        By :func:`physics_of`; a cell without an answer is left out. The places are
        :data:`study.runner.numerical.case_series.PLACES`.
    """
    found: dict[Physics, Array] = {}
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
            found[physics_of(base.case.levels)] = np.sqrt(squares) / np.abs(force)
    return found
