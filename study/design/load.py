"""Load and validate the three kinds of files: problem, design, calibration.

Every fault of a file is reported at once, with its key, the rule, the nearest valid name
and how to mend it; a file without faults gives frozen values.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

from study.design import overlay, plausibility, toml_document
from study.design.checks import check_cells
from study.design.diagnostics import Faults
from study.design.factors import Presets, grouped, read_exclusions, read_factors, read_presets
from study.design.layout.schemes import default_model, read_scheme
from study.design.reader import Section
from study.design.resolve import calibration_spec, resolve_problem
from study.design.sections.fitting import read_fitting
from study.design.sections.hypotheses import read_expected
from study.design.sections.measurements import read_measurements_table
from study.design.sections.settings import (
    read_analysis,
    read_converge,
    read_replicates,
    read_report,
    read_responses,
    read_study,
    read_uncertainty,
)
from study.design.spec import Config, Design, Response
from study.design.study_file import Calibration
from study.errors import Fault, InputError
from study.material.registry import constant_names, is_constant_key
from study.measurement.section import MeasurementSpec
from study.setup.quantity import number, shown
from study.setup.section import Bad
from study.setup.text import choice

SCHEMA = 1
_COMMON = ("schema", "study", "specimen", "test", "material", "model", "converge", "report")
TABLES: Mapping[str, tuple[str, ...]] = {
    "problem": (*_COMMON, "uncertainty"),
    "design": (
        *_COMMON,
        *("presets", "factors", "design", "exclude", "measurements", "calibration", "response"),
        *("analysis", "uncertainty", "replicates", "expected"),
    ),
    "calibration": ("schema", "study", "specimen", "material", "model", "tests", "calibration"),
}
MAX_TESTS = 1000


def load(path: str | Path, overrides: Sequence[str] = ()) -> Design:
    """Load a design.

    Parameters
    ----------
    path : str or Path
        TOML file.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.

    Returns
    -------
    Design
        The validated study.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    return loads(toml_document.read_text(path), str(path), overrides)


def loads(text: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()) -> Design:
    """Load a design from a text, or from the bytes of a file; see :func:`load`."""
    text = toml_document.decode(text, source) if isinstance(text, bytes) else text
    tables = _tables(text, source, overrides)
    with _Reading(source, tables, "design") as faults:
        return _design(tables, faults, source, text)


def dump(design: Design) -> str:
    """Canonical TOML of a design, overrides included; :func:`loads` reads the same from it."""
    return toml_document.dump_toml(design.config)


def load_problem(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Load a problem for one forward simulation.

    Returns
    -------
    dict
        ``specimen``, ``test``, ``material``, ``model`` in internal units, and ``converge``.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    return loads_problem(toml_document.read_text(path), str(path), overrides)


def loads_problem(
    text: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()
) -> Config:
    """Load a problem from a text; see :func:`load_problem`."""
    text = toml_document.decode(text, source) if isinstance(text, bytes) else text
    tables = _tables(text, source, overrides)
    with _Reading(source, tables, "problem") as faults:
        read_study(tables.get("study"), faults, default_name(source))
        read_uncertainty(tables.get("uncertainty"), faults)
        read_report(tables.get("report"), faults)
        converge = read_converge(tables.get("converge"), faults)
        config = resolve_problem(tables, faults, converge.ratio)
        del config["measurements"]
        material = config["material"]
        if material["model"] and not material["constants"] and not _about(faults, "material"):
            faults.add("material", "has no constants", 'for example C10 = "5 kPa"')
        plausibility.check_stability(config, faults)
    return {**config, "converge": converge}


def load_calibration(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Load a calibration.

    Returns
    -------
    dict
        ``name``, ``specimen``, ``model``, ``material``, ``calibration`` (see
        :func:`study.design.fitting.read_fitting`) and ``tests``: a list of ``role``, ``test``,
        ``measurements`` (:class:`MeasurementSpec`), ``weight``, ``specimen``, ``model``.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    return loads_calibration(toml_document.read_text(path), str(path), overrides)


def loads_calibration(
    text: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()
) -> Config:
    """Load a calibration from a text; see :func:`load_calibration`."""
    text = toml_document.decode(text, source) if isinstance(text, bytes) else text
    tables = _tables(text, source, overrides)
    with _Reading(source, tables, "calibration") as faults:
        study = read_study(tables.get("study"), faults, default_name(source))
        tests = _tests(tables, faults)
        names = _fitted_names(tests[0]["material"]) if tests and not faults else ()
        fitting = read_fitting(tables.get("calibration"), names, faults)
    first: Config = tests[0]
    shared = {k: first[k] for k in ("specimen", "model", "material")}
    return {"name": study["name"], **shared, "calibration": fitting, "tests": tests}


def _fitted_names(material: Config) -> tuple[str, ...]:
    return tuple(material["constants"] or constant_names(material["model"], material.get("order")))


def file_kind(path: str | Path) -> str:
    """Kind of a file: ``"design"``, ``"calibration"`` or ``"problem"``.

    Raises
    ------
    InputError
        If it is no TOML.
    """
    return _kind(toml_document.parse_toml(toml_document.read_text(path), str(path)))


def default_name(source: str) -> str:
    """Name of a study that has none: that of its file.

    Examples
    --------
    >>> default_name("designs/My study.toml")
    'My-study'
    """
    stem = Path(source).stem if "\0" not in source else ""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", stem).strip("-")[:80] or "study"


def _kind(tables: Mapping[str, Any]) -> str:
    if "factors" in tables or "response" in tables:
        return "design"
    return "calibration" if "tests" in tables else "problem"


class _Reading:
    """Collects the faults of one file and raises them together, each with the file's name."""

    def __init__(self, source: str, tables: Mapping[str, Any], kind: str) -> None:
        self.source, self.faults = source, Faults()
        actual = _kind(tables)
        if actual != kind and (actual != "problem" or kind == "calibration"):
            rule = f"is a {actual}, not a {kind}"
            raise InputError(Fault(source, rule, _VERBS[actual]))
        section = Section(tables, "", self.faults)
        section.take("schema", _schema, mend=f"write schema = {SCHEMA} on the first line")
        section.finish(TABLES[kind])

    def __enter__(self) -> Faults:
        return self.faults

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self.faults and kind is None:
            raise InputError(
                [Fault(f"{self.source}: {f.where}", f.rule, f.mend) for f in self.faults]
            )


_VERBS = {
    "design": "use `study plan` and `study run` with it",
    "problem": "use `study solve` with it, or give it [factors]",
    "calibration": "use `study calibrate` with it",
}


def _schema(value: Any) -> int:
    if value != SCHEMA or isinstance(value, bool):
        raise Bad(f"must be {SCHEMA}, got {shown(value)}", "this version reads schema 1 only")
    return SCHEMA


def _tables(text: str, source: str, overrides: Sequence[str]) -> dict[str, Any]:
    """Tables of a text with dotted keys joined and the overrides laid over."""
    tables = _joined(toml_document.parse_toml(text, source), source)
    for override in overrides:
        path, value = toml_document.parse_override(override)
        if path[0] in ("factors", "uncertainty"):
            path = [path[0], ".".join(path[1:])] if len(path) > 1 else path
        _check_override(tables, path)
        if path[0] in overlay.TABLES and len(path) > 1 and not any("." in part for part in path):
            tables = overlay.lay(tables, {".".join(path): value})
        else:
            toml_document.set_value(tables, path, value)
    return _joined(tables, source)


def _joined(tables: dict[str, Any], source: str) -> dict[str, Any]:
    """Join the dotted keys that TOML nests: ``[factors]``, ``[uncertainty]``, ``when``."""
    try:
        for key in ("factors", "uncertainty"):
            if isinstance(tables.get(key), dict):
                tables[key] = toml_document.flatten(tables[key])
        excluded = tables.get("exclude")
        for row in excluded if isinstance(excluded, list) else ():
            if isinstance(row, dict) and isinstance(row.get("when"), dict):
                row["when"] = toml_document.flatten(row["when"])
    except InputError as error:
        fault = error.faults[0]
        raise InputError(Fault(f"{source}: {fault.where}", fault.rule, fault.mend)) from error
    return tables


def _check_override(tables: Mapping[str, Any], path: Sequence[str]) -> None:
    """Refuse an override that a factor's levels would hide again."""
    key, factors = ".".join(path), tables.get("factors")
    if not isinstance(factors, dict):
        return
    if key in factors:
        mend = f"change the levels: -s 'factors.{key}=[...]'"
        raise InputError(Fault(f"-s {key}", "is a factor: its levels would hide this", mend))
    presets = read_presets(tables.get("presets"), Faults())
    hiding = [
        f"presets.{name}.{label}"
        for name in factors
        for label, preset in presets.get(name, {}).items()
        if key in preset
    ]
    if hiding:
        rule = f"is set by {', '.join(hiding[:3])}, which would hide this"
        raise InputError(Fault(f"-s {key}", rule, f"change it there: -s '{hiding[0]}...=...'"))


def _about(faults: Faults, table: str) -> bool:
    return any(f.where == table or f.where.startswith(f"{table}.") for f in faults)


def _design(tables: dict[str, Any], faults: Faults, source: str, text: str) -> Design:
    study = read_study(tables.get("study"), faults, default_name(source))
    if isinstance(tables.setdefault("study", {}), dict):
        tables["study"].setdefault("name", study["name"])
    presets: Presets = read_presets(tables.get("presets"), faults)
    factors = read_factors(tables.get("factors"), presets, faults)
    declared = list(grouped(tables["factors"])) if isinstance(tables.get("factors"), dict) else []
    factors, scheme = read_scheme(
        tables.get("design"), factors, study["seed"], "exclude" in tables, faults
    )
    analysis = read_analysis(tables.get("analysis"), faults, declared)
    asked = tables.get("analysis")
    if not isinstance(asked, Mapping) or "model" not in asked:
        analysis = default_model(scheme, factors, analysis)
    responses = _responses(tables, faults)
    design = Design(
        **study,
        config=tables,
        factors=factors,
        exclusions=read_exclusions(tables.get("exclude"), factors, declared, faults),
        responses=responses,
        measurements=_base_measurements(tables),
        calibration=_base_calibration(tables),
        analysis=analysis,
        scheme=scheme,
        replicates=read_replicates(tables.get("replicates"), faults),
        expected=read_expected(tables.get("expected"), factors, responses, faults),
        converge=read_converge(tables.get("converge"), faults),
        uncertainty=read_uncertainty(tables.get("uncertainty"), faults),
        report=read_report(tables.get("report"), faults),
        source=source,
        text=text,
    )
    if factors:
        check_cells(design, presets, faults)
    return design


def _responses(tables: Mapping[str, Any], faults: Faults) -> tuple[Response, ...]:
    """Read ``[[response]]``; a mesh study alone, without measurements, needs none."""
    if "response" not in tables and "measurements" not in tables and "converge" in tables:
        return ()
    return read_responses(tables.get("response"), faults)


def _base_measurements(tables: Mapping[str, Any]) -> MeasurementSpec | None:
    """Table ``[measurements]`` as written, before the levels of a cell are laid over it."""
    if "measurements" not in tables:
        return None
    return read_measurements_table(tables["measurements"], Faults())


def _base_calibration(tables: Mapping[str, Any]) -> Calibration:
    """Table ``[calibration]`` as written; its faults are reported by the cells."""
    material = tables.get("material")
    given = [k for k in material if is_constant_key(k)] if isinstance(material, dict) else []
    return calibration_spec(tables.get("calibration"), {"constants": given}, Faults())


def _tests(tables: Mapping[str, Any], faults: Faults) -> list[Config]:
    rows = tables.get("tests")
    if not isinstance(rows, list) or not rows or len(rows) > MAX_TESTS:
        faults.add("tests", f"must be 1 to {MAX_TESTS} tables", "write [[tests]]")
        return []
    found = [_test(tables, row, f"tests[{i}]", faults) for i, row in enumerate(rows)]
    if not any(test["role"] == "fit" for test in found) and not faults:
        faults.add("tests", "has no test with role fit", 'write role = "fit" in one of them')
    return found


def _test(tables: Mapping[str, Any], row: Any, where: str, faults: Faults) -> Config:
    section = Section(row, where, faults)
    role = section.take("role", choice("fit", "held-out"), "fit")
    weight = section.take("weight", _weight, "equal")
    for key in ("test", "measurements"):
        section.take(key, lambda value: value, mend=f"write {key} = {{ ... }}")
    section.finish(("specimen", "model"))
    own = ("test", "measurements", "specimen", "model")
    given = {key: section.table[key] for key in own if key in section}
    places = {key: f"{where}.{key}" for key in given}
    config = resolve_problem({"test": {}, **tables, **given}, faults, places=places)
    return {"role": role, "weight": weight, **config}


def _weight(value: Any) -> str | float:
    if isinstance(value, str):
        return str(choice("scatter", "equal")(value))
    return float(number(0, 1e12)(value))


def template() -> str:
    """Text of a commented, valid design to start from.

    Examples
    --------
    >>> template().startswith("# A study")
    True
    """
    return resources.files("study.design").joinpath("template.toml").read_text(encoding="utf-8")
