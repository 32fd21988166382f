"""Load and validate the three kinds of files: problem, design, calibration.

Every fault of a file is reported at once, with its key, the rule, the nearest valid name
and how to mend it; a file without faults gives frozen values.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import TypeVar

from study.design import overlay, plausibility, toml_document
from study.design.checks import check_cells
from study.design.diagnostics import Faults, Table, entries, is_about, read_table
from study.design.factors import exclusions_from, factors_from, grouped, presets_from, set_whole
from study.design.layout.schemes import scheme_from
from study.design.resolve import calibration_from, resolve_calibration, resolve_problem
from study.design.sections.calibration_design import CalibrationDesign
from study.design.sections.cell import Config
from study.design.sections.measurements import measurements_from
from study.design.spec import Design
from study.design.statistics.hypotheses import expected_from
from study.design.statistics.model import analysis_from
from study.design.statistics.response import responses_from
from study.design.statistics.uncertainty import uncertainty_from
from study.design.study_file import (
    RESPONSES_MEND,
    CalibrationFile,
    DesignFile,
    ProblemFile,
)
from study.design.toml_document import Tables
from study.errors import Fault, InputError
from study.material.registry import is_constant_key

File = TypeVar("File", ProblemFile, DesignFile, CalibrationFile)

_KINDS: Mapping[type, str] = {
    ProblemFile: "problem",
    DesignFile: "design",
    CalibrationFile: "calibration",
}
_VERBS = {
    "design": "use `study plan` and `study run` with it",
    "problem": "use `study solve` with it, or give it [factors]",
    "calibration": "use `study calibrate` with it",
}


def load(path: str | Path, overrides: Sequence[str] = ()) -> Design:
    """Load a design.

    Parameters
    ----------
    path : str or Path
        TOML file.
    overrides : sequence of str
        ``key=value`` each, laid over the file before it is validated.

    Raises
    ------
    InputError
        With every fault of the file.
    """
    return loads(toml_document.read_text(path), str(path), overrides)


def loads(text: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()) -> Design:
    """Load a design from a text, or from the bytes of a file; see :func:`load`.

    Parameters
    ----------
    text, source, overrides
        TOML, the name of its file for messages, and overrides as of :func:`load`.
    """
    text = toml_document.decode(text, source) if isinstance(text, bytes) else text
    tables = _tables(text, source, overrides)
    file, faults = _read(DesignFile, tables, source)
    design = _design(file, tables, faults, source, text)
    _refuse(faults, source)
    return design


def from_tables(tables: Mapping[str, object]) -> str:
    """Text of a file that holds some tables: its own keys, texts with units or bare numbers.

    Parameters
    ----------
    tables : mapping
        As in a file; bare numbers are in mm, N, MPa, deg and s. ``schema`` may be left out.

    Examples
    --------
    >>> print(from_tables({"specimen": {"shape": "cylinder", "radius": 25.0}}), end="")
    schema = 1
    <BLANKLINE>
    [specimen]
    shape = "cylinder"
    radius = "25.0 mm"
    """
    return toml_document.dump_toml({"schema": 1, **overlay.with_units(tables)})


def dump(design: Design) -> str:
    """Canonical TOML of a design, overrides included; :func:`loads` reads the same from it.

    Parameters
    ----------
    design : Design
        Of a file or of tables.
    """
    return toml_document.dump_toml(design.config)


def load_problem(path: str | Path, overrides: Sequence[str] = ()) -> Config:
    """Load a problem for one forward simulation.

    Parameters
    ----------
    path, overrides
        As of :func:`load`, with the same InputError.

    Returns
    -------
    dict
        ``specimen``, ``test``, ``material``, ``model`` in internal units, and ``converge``.
    """
    return loads_problem(toml_document.read_text(path), str(path), overrides)


def loads_problem(
    text: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()
) -> Config:
    """Load a problem from a text; see :func:`load_problem`.

    Parameters
    ----------
    text, source, overrides
        The file as text or bytes, the name that messages give it, and ``key=value`` each.
    """
    text = toml_document.decode(text, source) if isinstance(text, bytes) else text
    tables = _tables(text, source, overrides)
    file, faults = _read(ProblemFile, tables, source)
    uncertainty_from(file.uncertainty, (), tables, faults)
    problem = resolve_problem(tables, faults, file.converge.ratio)
    material = problem.material
    if (
        material.model
        and not material.constants
        and not any(is_about(f, "material") for f in faults)
    ):
        faults.add("material", "has no constants", 'for example C10 = "5 kPa"')
    plausibility.check_stability(problem, faults)
    _refuse(faults, source)
    document = problem.document()
    del document["measurements"]
    return {**document, "converge": file.converge}


def load_calibration(path: str | Path, overrides: Sequence[str] = ()) -> CalibrationDesign:
    """Load a calibration.

    Parameters
    ----------
    path, overrides
        As of :func:`load`, with the same InputError.

    Returns
    -------
    CalibrationDesign
        Its measured tests, and how the constants are to be found.
    """
    return loads_calibration(toml_document.read_text(path), str(path), overrides)


def loads_calibration(
    text: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()
) -> CalibrationDesign:
    """Load a calibration from a text; see :func:`load_calibration`.

    Parameters
    ----------
    text, source, overrides
        As of :func:`loads_problem`.
    """
    text = toml_document.decode(text, source) if isinstance(text, bytes) else text
    tables = _tables(text, source, overrides)
    file, faults = _read(CalibrationFile, tables, source)
    found = resolve_calibration(file, tables, file.study.name or default_name(source), faults)
    _refuse(faults, source)
    return found


def file_kind(path: str | Path) -> str:
    """Kind of a file: ``"design"``, ``"calibration"`` or ``"problem"``.

    Parameters
    ----------
    path : str or Path
        TOML file; anything else raises InputError.
    """
    return _kind(toml_document.parse_toml(toml_document.read_text(path), str(path)))


def default_name(source: str) -> str:
    """Name of a study that has none: that of its file.

    Parameters
    ----------
    source : str
        Path of the file, or what stands for one.

    Examples
    --------
    >>> default_name("designs/My study.toml")
    'My-study'
    """
    stem = Path(source).stem if "\0" not in source else ""
    return re.sub(r"[^A-Za-z0-9_-]+", "-", stem).strip("-")[:80] or "study"


def _kind(tables: Table) -> str:
    if "factors" in tables or "response" in tables:
        return "design"
    return "calibration" if "tests" in tables else "problem"


def _read(kind: type[File], tables: Table, source: str) -> tuple[File, Faults]:
    """Read the tables of a file that are the same for all of its cells."""
    wanted, actual, faults = _KINDS[kind], _kind(tables), Faults()
    if actual != wanted and (actual != "problem" or wanted == "calibration"):
        raise InputError(Fault(source, f"is a {actual}, not a {wanted}", _VERBS[actual]))
    return read_table(kind, tables, "", faults), faults


def _refuse(faults: Faults, source: str) -> None:
    """Raise the faults of a file together, each with the file's name."""
    if faults:
        raise InputError([Fault(f"{source}: {f.where}", f.rule, f.mend) for f in faults])


def _tables(text: str, source: str, overrides: Sequence[str]) -> Tables:
    """Tables of a text with dotted keys joined and the overrides laid over."""
    tables = _joined(toml_document.parse_toml(text, source), source)
    for override in overrides:
        path, value = toml_document.parse_override(override)
        if path[0] in ("factors", "uncertainty"):
            path = [path[0], ".".join(path[1:])] if len(path) > 1 else path
        _check_override(tables, path)
        own = tables.get(path[0])
        if path[0] in ("factors", "uncertainty") and len(path) > 1 and isinstance(own, dict):
            tables[path[0]] = set_whole(own, path[1], value)
        elif path[0] in overlay.TABLES and len(path) > 1 and not any("." in part for part in path):
            tables = overlay.lay(tables, {".".join(path): value})
        else:
            toml_document.set_value(tables, path, value)
    return _joined(tables, source)


def _joined(tables: Tables, source: str) -> Tables:
    """Join the dotted keys that TOML nests: ``[factors]``, ``[uncertainty]``, ``when``."""
    try:
        for key in ("factors", "uncertainty"):
            table = tables.get(key)
            if isinstance(table, dict):
                tables[key] = toml_document.flatten(table)
        excluded = tables.get("exclude")
        for row in excluded if isinstance(excluded, list) else ():
            if isinstance(row, dict) and isinstance(row.get("when"), dict):
                row["when"] = toml_document.flatten(row["when"])
    except InputError as error:
        fault = error.faults[0]
        raise InputError(Fault(f"{source}: {fault.where}", fault.rule, fault.mend)) from error
    return tables


def _check_override(tables: Table, path: Sequence[str]) -> None:
    """Refuse an override that a factor's levels would hide again."""
    key, factors = ".".join(path), tables.get("factors")
    if not isinstance(factors, dict):
        return
    if key in grouped(factors):
        new = "[...]" if key in factors else "{ low = .., high = .. }"
        mend = f"change it there: -s 'factors.{key}={new}'"
        raise InputError(Fault(f"-s {key}", "is a factor: its levels would hide this", mend))
    presets = presets_from(tables.get("presets"), Faults())
    hiding = [
        f"presets.{name}.{label}"
        for name in factors
        for label, preset in presets.get(name, {}).items()
        if key in preset
    ]
    if hiding:
        rule = f"is set by {', '.join(hiding[:3])}, which would hide this"
        raise InputError(Fault(f"-s {key}", rule, f"change it there: -s '{hiding[0]}...=...'"))


def _design(file: DesignFile, tables: Tables, faults: Faults, source: str, text: str) -> Design:
    name = file.study.name or default_name(source)
    study = tables.setdefault("study", {})
    if isinstance(study, dict):
        study.setdefault("name", name)
    presets = presets_from(file.presets, faults)
    factors = factors_from(file.factors, presets, faults)
    declared = list(grouped(entries(file.factors, "factors", faults)))
    excluding = "exclude" in tables
    factors, scheme = scheme_from(file.design, factors, file.study.seed, excluding, faults)
    responses = responses_from(file.response, faults)
    uncertain, inputs = uncertainty_from(file.uncertainty, factors, tables, faults)
    _check_asked(tables, faults)
    design = Design(
        name=name,
        question=file.study.question,
        seed=file.study.seed,
        assumed=file.study.assumed,
        config=tables,
        factors=factors,
        exclusions=exclusions_from(file.exclude, factors, declared, faults),
        responses=responses,
        measurements=measurements_from(file.measurements, Faults()) if file.measurements else None,
        calibration=calibration_from(tables, _gives_constants(tables), Faults()),
        analysis=analysis_from(file.analysis, factors, declared, scheme, faults),
        scheme=scheme,
        replicates=file.replicates,
        retry=dict(file.execution.retry or ()),  # None where it is faulty
        expected=expected_from(file.expected, factors, responses, faults),
        converge=file.converge,
        uncertainty=uncertain,
        inputs=inputs,
        virtual=file.virtual,
        report=file.report,
        source=source,
        text=text,
    )
    if factors:
        check_cells(design, presets, faults)
    return design


def _gives_constants(tables: Table) -> bool:
    """Whether the table ``[material]`` itself has constants, before any level is laid over it."""
    material = tables.get("material")
    return isinstance(material, dict) and any(is_constant_key(key) for key in material)


def _check_asked(tables: Table, faults: Faults) -> None:
    """Check that something is asked of a design; a mesh study without measurements need not."""
    studied = "converge" in tables and "measurements" not in tables
    if "response" not in tables and not studied:
        faults.add("response", "is missing", RESPONSES_MEND)
    replicates = tables.get("replicates")
    if not isinstance(replicates, Mapping):
        return
    if {"mesh_seeds", "noise"} <= set(replicates):
        rule = "mesh_seeds and noise are two error terms, with different questions"
        faults.add("replicates", rule, "give one of them, and the other in a study of its own")
    elif not replicates:
        faults.add("replicates", "is empty", "write mesh_seeds = 5 or noise = 200")


def template(name: str = "template") -> str:
    """Text of a commented, valid file to start from.

    Parameters
    ----------
    name : {"template", "calibration"}
        A design, or a calibration.

    Examples
    --------
    >>> template().startswith("# A study")
    True
    """
    return resources.files("study.design").joinpath(f"{name}.toml").read_text(encoding="utf-8")
