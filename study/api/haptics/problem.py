"""What a verb about one simulation is given: a problem file, a calibration, a case of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import cast

import numpy as np

from study.api.folders import data_root, finished_manifest, results_folder
from study.api.planning.why import why
from study.arrays import Array
from study.bounded_file import UnreadableError, read_json
from study.design import load
from study.design.sections.cell import Config
from study.design.spec import Design
from study.errors import Fault, InputError
from study.material.material import Material
from study.material.registry import is_dimensionless
from study.record.record import Record
from study.record.store import Store
from study.runner import provenance
from study.runner.expansion import cases_by_id
from study.setup.material_section import MaterialSection
from study.setup.setup import Problem, Tables, problem_of

#: Half ranges of calibrated constants over their standard errors.
STANDARD_ERRORS = 2.0
#: Largest half range over the constant itself.
LARGEST_SHARE = 0.5


@dataclass(frozen=True)
class Source:
    """A problem, and what is known of its constants.

    Parameters
    ----------
    name : str
        Of the file, the calibration, or the study and its case.
    problem : Problem
        With constants and displacement.
    half_ranges : mapping of str to float
        Two standard errors of calibrated constants, MPa (exponents plain).
    covariance : ndarray, shape (p, p), optional
        Of calibrated constants, MPa^2.
    """

    name: str
    problem: Problem
    half_ranges: Mapping[str, float] = field(default_factory=dict)
    covariance: Array | None = None


def source_of(path: Path, case: str, test: int, overrides: Sequence[str]) -> Source:
    """Read a problem from whatever holds it; its name and content show what that is.

    Parameters
    ----------
    path : Path
        Problem file, ``calibration.json``, or results of a study.
    case : str
        Case of a study, by the beginning of its id.
    test : int
        Number of the test of a calibration, from 1.
    overrides : sequence of str
        ``key=value`` each, laid over a problem file.

    Raises
    ------
    InputError
        If it is none of these, or not finished.
    """
    if path.suffix == ".json":
        return _calibrated(path, test)
    if path.suffix == ".toml" and path.is_file() and not case:
        return _written(path, overrides)
    return _recorded(path, case)


def material_of(path: Path, case: str, test: int, overrides: Sequence[str]) -> tuple[str, Material]:
    """Read the name and the material of a problem; a calibrated one needs no displacement.

    Parameters
    ----------
    path, case, test, overrides
        As of :func:`source_of`.

    Raises
    ------
    InputError
        If it is none of these, or not finished.
    """
    if path.suffix != ".json":
        found = source_of(path, case, test, overrides)
        return found.name, found.problem.material
    document = _document(path)
    values, _ = _constants(cast("Mapping[str, Mapping[str, object]]", document["parameters"]))
    tables = _test_of(document, path, test)
    return str(document["name"]), MaterialSection.of(tables).material(values)


def _written(path: Path, overrides: Sequence[str]) -> Source:
    """Problem of a file."""
    kind = load.file_kind(path)
    if kind == "calibration":
        rule = "is a calibration that has not been made"
        mend = f"run `study calibrate {path}` and export its calibration.json"
        raise InputError(Fault(str(path), rule, mend))
    if kind == "design":
        mend = "run it and name one: study export results/NAME --case ID"
        raise InputError(Fault(str(path), "is a design of many cases", mend))
    config = load.load_problem(path, overrides)
    config = provenance.located(config, provenance.folders(path, data_root(path)))
    return Source(load.default_name(str(path)), problem_of(config))


def _calibrated(path: Path, number: int) -> Source:
    """Test of a finished calibration, with the constants and their covariance."""
    found = _document(path)
    tables = _test_of(found, path, number)
    values, errors = _constants(cast("Mapping[str, Mapping[str, object]]", found["parameters"]))
    rows = cast("Sequence[Sequence[object]]", found["correlation"])
    correlation = np.array([[_float(value) for value in row] for row in rows])
    size = np.array(list(errors.values()))
    covariance = np.outer(size, size) * correlation
    name = str(found["name"])
    return Source(
        f"{name}-test-{number}" if len(cast("list[object]", found["tests"])) > 1 else name,
        problem_of(tables, values),
        _half_ranges(values, errors),
        covariance if np.isfinite(covariance).all() else None,
    )


def _test_of(found: Mapping[str, object], path: Path, number: int) -> Tables:
    """Tables of a test of a calibration, counted from 1."""
    tests = cast("Sequence[Tables]", found["tests"])
    if not 1 <= number <= len(tests):
        rule = f"there is no test {number} in {path}, which has {len(tests)}"
        raise InputError(Fault("--test", rule, f"1 to {len(tests)}"))
    return tests[number - 1]


def _config_of(record: Record, design: Design, blocks: Sequence[str]) -> Config:
    """Document of the cell that a case is of, or repeats on another mesh."""
    known = cases_by_id(design, blocks).get(record.case_id)
    if known is not None:
        return known.config
    for cell in design.treatments:
        if cell.levels == record.levels:
            return cell.config
    mend = "name another of its cases (see `study why`)"
    raise InputError(Fault(f"--case {record.case_id}", "is of no cell of the design", mend))


def _constants(
    parameters: Mapping[str, Mapping[str, object]],
) -> tuple[dict[str, float], dict[str, float]]:
    """Values and standard errors in MPa (exponents plain) of parameters in kPa."""
    factor = {name: 1.0 if is_dimensionless(name) else 1e-3 for name in parameters}
    values = {n: factor[n] * _float(p["value"]) for n, p in parameters.items()}
    errors = {n: factor[n] * _float(p.get("standard_error")) for n, p in parameters.items()}
    return values, errors


def _half_ranges(values: Mapping[str, float], errors: Mapping[str, float]) -> dict[str, float]:
    """Range of every constant whose error is known; not so wide that the material is another."""
    return {
        name: min(STANDARD_ERRORS * error, LARGEST_SHARE * abs(values[name]))
        for name, error in errors.items()
        if np.isfinite(error) and error > 0
    }


def _float(value: object) -> float:
    """Return a number of a document, NaN for null."""
    return float("nan") if value is None else float(str(value))


def _document(path: Path) -> Mapping[str, object]:
    """Document of a calibration that converged.

    Raises
    ------
    InputError
        If there is none, or it is another one.
    """
    mend = "name the calibration.json that `study calibrate` wrote"
    try:
        found = read_json(path)
    except UnreadableError as error:
        raise InputError(Fault(str(path), error.rule, mend)) from None
    needed = {"status", "name", "parameters", "correlation", "tests"}
    if not isinstance(found, Mapping) or not needed <= set(found):
        raise InputError(Fault(str(path), "is no document of a calibration", mend))
    if found["status"] != "converged":
        rule = f"ended as {found['status']}: its constants are no result"
        raise InputError(Fault(str(path), rule, "see its message"))
    return found


def _recorded(path: Path, case: str) -> Source:
    """Case of a study that was run, with the constants of its fit."""
    folder = results_folder(path)
    if not case:
        mend = "name one of its cases: --case ID (see `study why`)"
        raise InputError(Fault(str(path), "is a study of many cases", mend))
    record = why(case, study=folder)
    manifest = finished_manifest(Store(folder))
    if not record.converged:
        rule = f"the case ended as {record.status}: {record.message}"
        raise InputError(Fault(f"--case {case}", rule, "name one that has an answer"))
    design = load.loads(manifest["design"], manifest["source"])
    config = _config_of(record, design, manifest["blocks"])
    values, errors = _constants(record.parameters)
    fitted = {n: v for n, v in values.items() if n != "mu0"}
    config = provenance.located(config, provenance.folders(design.source, folder))
    problem = problem_of(config, fitted or None)
    return Source(f"{design.name}-{record.case_id[:8]}", problem, _half_ranges(fitted, errors))
