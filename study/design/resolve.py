"""Tables as written -> one resolved configuration, with every fault."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from study.design import plausibility
from study.design.diagnostics import Faults, read_table
from study.design.sections.measurements import read_measurements_table
from study.design.sections.problem import read_material, read_model, read_specimen, read_test
from study.design.spec import Config
from study.design.study_file import Calibration, CalibrationProblem
from study.errors import InputError
from study.measurement.section import MeasurementSpec
from study.setup.section import written_keys

TABLES = ("specimen", "test", "material", "model", "measurements")

#: tables that [calibration.problem] may replace
REPLACEABLE = written_keys(CalibrationProblem)


def resolve(tables: Mapping[str, Any], faults: Faults, ratio: float = 1.5) -> Config:
    """Resolve a cell: sections in internal units, the displacement filled from the range.

    Parameters
    ----------
    tables : mapping
        Tables of a problem, or of a design with the levels of one cell laid over.
    faults : Faults
        Where faults go.
    ratio : float
        Refinement ratio between coarse, medium and fine.

    Returns
    -------
    dict
        ``specimen``, ``test``, ``material``, ``model``, ``measurements`` (a
        :class:`MeasurementSpec` or None) and ``calibration``.
    """
    config = resolve_problem(tables, faults, ratio)
    config["calibration"] = _calibration(tables, config, faults, ratio)
    return config


def resolve_problem(
    tables: Mapping[str, Any],
    faults: Faults,
    ratio: float = 1.5,
    places: Mapping[str, str] | None = None,
) -> Config:
    """Resolve specimen, test, material, model and measurements.

    ``places`` says where tables stand that are not at the top of the file.
    """
    at = {name: name for name in TABLES} | dict(places or {})
    specimen = read_specimen(tables.get("specimen", {}), faults, at["specimen"])
    config: Config = {
        "specimen": specimen,
        "test": read_test(tables.get("test", {}), faults, at["test"]),
        "material": read_material(tables.get("material", {}), faults, at["material"]),
        "model": read_model(tables.get("model", {}), faults, specimen["shape"], ratio, at["model"]),
        "measurements": None,
    }
    if "measurements" in tables:
        table = tables["measurements"]
        config["measurements"] = read_measurements_table(table, faults, at["measurements"])
    _fill_displacement(config, "measurements" in tables, tables, faults, at)
    plausibility.check(config, faults, at)
    return config


def _fill_displacement(
    config: Config,
    measured: bool,
    tables: Mapping[str, Any],
    faults: Faults,
    at: Mapping[str, str],
) -> None:
    """Take the end of the range for a displacement left out; both given must agree."""
    test, spec = config["test"], config["measurements"]
    where = f"{at['test']}.displacement"
    written = isinstance(tables.get("test"), Mapping) and "displacement" in tables["test"]
    high = _range_end(spec, config["specimen"], faults, at)
    if test["displacement_mm"] is None:
        test["displacement_mm"] = high
        unread = measured and (spec is None or spec.range is not None)
        if high is None and not written and not unread:
            mend = 'write displacement = "5 mm"' + (", or measurements.range" if measured else "")
            faults.add(where, "is missing", mend)
    elif high is not None and abs(high - test["displacement_mm"]) > 1e-9 * high:
        rule = f"{test['displacement_mm']:g} mm, but measurements.range ends at {high:g} mm"
        faults.add(where, rule, "make them agree, or leave the displacement out")


def _range_end(
    spec: MeasurementSpec | None, specimen: Config, faults: Faults, at: Mapping[str, str]
) -> float | None:
    if spec is None or spec.range is None:
        return None
    height = specimen.get("height_mm")
    if spec.range.kind == "percent" and height is None and specimen["shape"] != "surface":
        return None  # the height itself is faulty, and reported
    try:
        return spec.range.in_mm(height)[1]
    except InputError as error:
        fault = error.faults[0]
        faults.add(f"{at['measurements']}.range", fault.rule, fault.mend)
        return None


def calibration_spec(table: Any, material: Config, faults: Faults) -> Calibration:
    """Read ``[calibration]``; the method is ``auto`` unless the constants are given.

    Parameters
    ----------
    table : mapping or None
        The table as written.
    material : dict
        Resolved material.
    faults : Faults
        Where faults go.
    """
    found = read_table(Calibration, {} if table is None else table, "calibration", faults)
    method = found.method
    if not isinstance(table, Mapping) or "method" not in table:
        method = "none" if material["constants"] else "auto"
    problem = found.problem
    if problem is not None:
        read_table(CalibrationProblem, problem, "calibration.problem", faults)
        problem = problem if isinstance(problem, Mapping) else None
    return replace(found, method=method, problem=problem)


def _calibration(tables: Mapping[str, Any], config: Config, faults: Faults, ratio: float) -> Config:
    spec = calibration_spec(tables.get("calibration"), config["material"], faults)
    problem = None
    if spec.problem is not None:
        own = {k: v for k, v in spec.problem.items() if k in REPLACEABLE}
        places = {k: f"calibration.problem.{k}" for k in own}
        problem = resolve_problem({**tables, **own}, faults, ratio, places)
    _check_method(spec, config, problem or config, faults)
    return {"method": spec.method, "problem": problem, "leave_out": spec.leave_out}


def _check_method(spec: Calibration, config: Config, fitted: Config, faults: Faults) -> None:
    if spec.method == "none":
        if not config["material"]["constants"] and config["material"]["model"]:
            mend = "give them, or let [calibration] find them"
            faults.add("material", "has no constants, and calibration.method is none", mend)
        plausibility.check_stability(config, faults)
        return
    if spec.method is not None and fitted["measurements"] is None:
        if not any("measurements" in f.where for f in faults):
            mend = "add [measurements], or give the constants"
            faults.add("measurements", "is missing: there is nothing to calibrate with", mend)
        return
    readable = None not in (fitted["test"]["kind"], fitted["test"]["interface"])
    if spec.method == "analytic" and readable and not plausibility.is_homogeneous(fitted):
        rule = "analytic needs compression of a cylinder or block with both faces frictionless"
        faults.add("calibration.method", rule, 'write method = "auto" or "inverse-fem"')
