"""Find, load and validate the three kinds of files: problem, design, calibration.

Every fault of a file is reported at once, with its key, the rule, the nearest valid name
and how to mend it; a file without faults gives frozen values.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from importlib import resources
from pathlib import Path
from typing import Generic, TypeVar

from study.external.forward_model import ValueFile, check_names, checked, overridden, stands_alone
from study.ground import declaration
from study.ground.contrast import sides_of
from study.ground.declaration import (
    Faults,
    Table,
    Tables,
    entries,
    is_about,
    is_known,
    noted,
    quoted_path,
    read_table,
    table_of,
)
from study.ground.errors import Fault, InputError, nearest
from study.harness.design.layouts import scheme_from
from study.harness.design.spec import (
    RESPONSES_MEND,
    Design,
    DesignFile,
    Level,
    Presets,
    analysis_from,
    exclusions_from,
    expected_from,
    factors_from,
    grouped,
    presets_from,
    responses_from,
    set_whole,
    uncertainty_from,
)
from study.record.record import ManifestDocument
from study.record.store import Store
from study.simulation import plausibility
from study.simulation.calibration.calibration_file import (
    CalibrationDesign,
    CalibrationFile,
    resolve_calibration,
)
from study.simulation.cell import Cell, CellProblem
from study.simulation.job import data_root, folders, located
from study.simulation.problem_file import (
    TABLES,
    LoadedProblem,
    ProblemFile,
    default_name,
    identification_from,
    lay,
    resolve_problem,
    with_units,
)
from study.simulation.response import MARKED, RESPONSES, SCORED, is_simulated, simulated_at

# Checks of a whole design: every cell, every response, every replicate.

MAX_FAULTS = 100


def check_cells(design: Design, presets: Presets, faults: Faults) -> None:
    """Check every cell that is not left out; a fault of a level is told where it is written."""
    run, cells = [c for c in design.combinations if c[2] is None], []
    labels_of: dict[Fault, list[str]] = {}
    for cell, levels, _ in run:
        if len(labels_of) > MAX_FAULTS:
            break
        cell_faults = Faults()
        cells.append(design.resolved(levels, cell_faults))
        places = _places(design, levels, presets)
        for fault in cell_faults:
            labels_of.setdefault(_moved(fault, places), []).append(cell.label)
    for fault, labelled in labels_of.items():
        is_general = len(labelled) == len(cells) or fault.where.startswith(("presets.", "factors."))
        more = f" and {len(labelled) - 1} more cells" if len(labelled) > 1 else ""
        where = "" if is_general else f" (in {labelled[0]}{more})"
        faults.add(fault.where, fault.rule + where, fault.mend)
    left = [cell.levels for cell, *_ in run]
    for factor in design.factors:  # the exclusions leave every factor two levels
        count = len({levels[factor.name] for levels in left})
        if count < 2 <= len(factor.levels):
            rule = f"leaves {count} of the {len(factor.levels)} levels of {factor.name!r}"
            faults.add("exclude", rule, "a factor needs two levels; remove it, or exclude less")
    if not faults:  # a level that cannot be read would be missed here once more
        _check_contrasts(design, left, faults)
    if not labels_of and cells:
        _check_course(cells, faults)
        _check_same_names(design, cells, faults)
        _check_responses(design, cells, faults)
        check_replicates(design, cells, faults)


def _check_course(cells: Sequence[Cell], faults: Faults) -> None:
    """Refuse a course in time, of which a design has no response."""
    rule, problems = "has no place in a design", (p for c in cells for p in (c.problem, c.fitted))
    mend = "responses compare curves over displacement: `study solve` follows a course"
    for problem in problems:
        for key in ("test.hold", "test.cycles"):
            if problem.value_at(key) is not None:
                faults.add(key, rule, mend)
        if problem.measurements is not None and problem.measurements.columns.time is not None:
            speed = "give test.speed, or fit the course by `study calibrate`"
            faults.add("measurements.columns.time", rule, speed)


def _check_contrasts(design: Design, left: Sequence[Mapping[str, str]], faults: Faults) -> None:
    """Find differences that are asked for of levels that do not exist, or of cells left out."""
    where = "analysis.contrasts"
    for text in design.analysis.contrasts:
        try:
            sides = sides_of(text, design.lists)
        except InputError as error:
            for fault in error.faults:
                faults.add(where, f"{fault.where}: {fault.rule}", fault.mend)
            continue
        for side in sides:
            if not any(side.items() <= levels_left.items() for levels_left in left):
                named = ", ".join(f"{name}={level}" for name, level in side.items())
                faults.add(where, f"contrast {text!r}: no cell that is run has {named}", "")


def _check_same_names(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that a parameter that a level sets has a value in every cell."""
    names = {name for cell in cells for name in cell.problem.parameters}
    for name in sorted(names):
        few = sum(name not in cell.problem.parameters for cell in cells)
        if few:
            rule = f"has no value in {few} of {len(cells)} cells"
            faults.add(f"parameters.{name}", rule, "give it one in [parameters], or in every level")
    key = design.replicates.key
    if key is not None and key.partition(".")[2] not in names:
        rule = f"names {key}, which no cell has"
        faults.add("replicates.key", rule, "give it a value in [parameters]: seed = 1")


def _places(design: Design, levels: Sequence[Level], presets: Presets) -> dict[str, str]:
    """Dotted key of the merged file -> where the level that sets it is written."""
    places: dict[str, str] = {}
    for factor, level in zip(design.factors, levels, strict=True):
        for key in level.settings:
            places[key] = f"factors.{quoted_path(factor.name)}"
            if factor.name in presets:
                inner = key.removeprefix(f"{factor.name}.")
                places[key] = f"presets.{factor.name}.{quoted_path(level.label)}.{inner}"
    return places


def _moved(fault: Fault, places: Mapping[str, str]) -> Fault:
    for key, moved_key in places.items():
        if fault.where == key or fault.where.startswith((f"{key}.", f"{key}[")):
            return Fault(moved_key + fault.where.removeprefix(key), fault.rule, fault.mend)
    return fault


def _check_responses(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    values = {name for cell in cells if cell.problem.forward for name in cell.problem.forward.units}
    for i, response in enumerate(design.responses):
        where = f"response[{i}].name"
        if design.is_alone:
            _check_value(response.name, where, cells, faults)
        elif response.name in values:
            pass  # of a program; a cell that it does not predict has none
        elif response.name in SCORED and any(c.problem.measurements is None for c in cells):
            rule = f"{response.name} compares with measured curves, and there are none"
            faults.add(where, rule, "add [measurements]")
        elif response.name in MARKED:
            _check_marked(response.name, where, cells, faults)
        elif is_simulated(response.name):
            _check_place(response.name, f"response[{i}].displacement", cells, faults)
        elif response.name and response.name not in RESPONSES:
            names = {n for c in cells for n in c.problem.calibrated_names}
            if response.name not in names:
                rule = f"no material of this design has a constant {response.name}"
                faults.add(where, rule, nearest(response.name, sorted(names)))


def _check_value(name: str, where: str, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that the program of every cell leaves a response; a function may return any."""
    for forward in dict.fromkeys(cell.problem.forward for cell in cells):
        if forward is None or forward.model == "python" or name in ("seconds", ""):
            continue
        if is_simulated(name) and name not in forward.units:
            if forward.curve is None:
                rule = f"{name} is one of a curve, and the program leaves none"
                faults.add(where, rule, "say which: forward.curve = { file, columns, units }")
        elif name not in forward.units:
            mend = nearest(name, forward.units) if forward.units else "forward.values = { .. }"
            faults.add(where, f"no value of the program has the name {name}", mend)


def _check_marked(name: str, where: str, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that there are markers, and some that are left to be predicted."""
    specs = [cell.problem.markers for cell in cells]
    if any(spec is None for spec in specs):
        rule = f"{name} compares with markers inside the specimen, and there are none"
        faults.add(where, rule, "add [markers]")
    elif name == "predicted_marker_error" and not all(spec and spec.fit for spec in specs):
        rule = f"{name} is of markers that did not tell how the plate moved, and all did"
        faults.add(where, rule, "add markers.layer and markers.fit")


def _check_place(name: str, where: str, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that every cell is pressed as far as a response looks."""
    displacement_mm = simulated_at(name)[1]
    depths = [c.problem.depth_mm for c in cells]
    least = min((depth for depth in depths if depth is not None), default=None)
    if displacement_mm is not None and least is not None and displacement_mm > least * (1 + 1e-9):
        rule = f"is {displacement_mm:g} mm, and a cell is pressed {least:g} mm only"
        faults.add(where, rule, "take it inside the test of every cell, or press deeper")


#: responses that a fit alone does not give
_NO_CONSTANT = (*SCORED, *MARKED, "seconds")


def check_replicates(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    """Check that every cell has what its replicates vary."""
    repeats = design.replicates.noise or design.replicates.mesh_seeds or design.replicates.key
    if design.analysis.error == "replicates" and not repeats:
        rule = "is the scatter of replicates, and the design asks for none"
        faults.add("analysis.error", rule, "add [replicates] mesh_seeds = 5 or noise = 200")
    if design.replicates.noise:
        _check_noise(design, cells, faults)
    is_exact = all(cell.problem.is_homogeneous and cell.fitted.is_homogeneous for cell in cells)
    if design.replicates.mesh_seeds and is_exact:
        rule = (
            "every cell is compression between frictionless plates, which is the same on every "
            "mesh: there is no scatter of meshes to learn"
        )
        faults.add("replicates.mesh_seeds", rule, "leave it out, or vary something with a mesh")


def _check_noise(design: Design, cells: Sequence[Cell], faults: Faults) -> None:
    where = "replicates.noise"
    given = sum(not cell.is_calibrated for cell in cells)
    if given:
        rule = (
            "fits again to the measured curve with resampled residuals, but in "
            f"{given} of {len(cells)} cells the constants are given and nothing is fitted"
        )
        faults.add(where, rule, 'write calibration.method = "auto", or use mesh_seeds')
    if not any(is_constant(response.name) for response in design.responses):
        rule = "says how much calibrated constants scatter, and no response is one"
        faults.add(where, rule, 'add [[response]] name = "mu0" (or C10, ...), or use mesh_seeds')


def is_constant(response: str) -> bool:
    """Whether a response is a constant or mu0, which a fit gives without a prediction."""
    return response not in _NO_CONSTANT and not is_simulated(response)


#: verbs of every kind of file, which its tables tell apart
_VERBS = {
    "design": "use `study plan` and `study run` with it",
    "problem": "use `study solve` or `study export` with it, or give it [factors]",
    "calibration": "use `study calibrate` with it",
    "tracker study": "use `study tracking` with it",
    "question to sensors": "use `study require` with it",
    "single measured test": "for `study calibrate` write the test as [[tests]], with "
    "test = { ... } and [tests.measurements]; for `study run` add [factors] and [[response]]",
}
#: kinds by what the key ``kind`` of a file calls them
_DECLARED = {"study": "design", "problem": "problem", "calibration": "calibration"}
_SIMULATED = frozenset({"schema", "study", "specimen", "test", "material", "model", "converge"})


def from_tables(tables: Mapping[str, object]) -> str:
    """Text of a file that holds some tables: its own keys, texts with units or bare numbers."""
    return declaration.dump_toml({"schema": 1, **with_units(tables)})


def dump(design: Design) -> str:
    """Canonical TOML of a design, overrides included; :func:`loads` reads the same from it."""
    return declaration.dump_toml(design.config)


def problem_of(tables: Table, source: str, overrides: Sequence[str] = ()) -> CellProblem:
    """Problem of the tables of a file."""
    return loads_problem(declaration.dump_toml(tables), source, overrides).problem


def file_kind(path: str | Path) -> str:
    """Kind of a file: ``"design"``, ``"calibration"``, ``"problem"``, or that of another verb."""
    return _kind(declaration.parse_toml(declaration.read_text(path), str(path)))


def _kind(tables: Table) -> str:
    """Kind that the key ``kind`` declares; without it the tables decide."""
    if "kind" not in tables:
        return _shape(tables)
    if (declared := str(tables["kind"])) not in _DECLARED:
        raise InputError(Fault("kind", f"no kind {declared!r}", nearest(declared, _DECLARED)))
    return _DECLARED[declared]


def _shape(tables: Table) -> str:
    """Kind whose tables a file has."""
    if "factors" in tables or "response" in tables:
        return "tracker study" if "recording" in tables else "design"
    if "tests" in tables:
        return "calibration"
    if "recording" in tables or "requirement" in tables:
        return "tracker study" if "recording" in tables else "question to sensors"
    return "single measured test" if {"test", "measurements"} <= tables.keys() else "problem"


def _tables(text: str, source: str, overrides: Sequence[str]) -> Tables:
    """Tables of a text with dotted keys joined and the overrides laid over."""
    tables, faults = _joined(declaration.parse_toml(text, source), source), Faults()
    for override in overrides:
        path, value = declaration.parse_override(override)
        if path[0] in ("factors", "uncertainty"):
            path = [path[0], ".".join(path[1:])] if len(path) > 1 else path
        _check_override(tables, path)
        current = tables.get(path[0])
        if path[0] == "parameters" and len(path) == 2 and isinstance(current, dict):
            read = partial(overridden, path[1], table=current)
            value = noted(read, value, f"-s parameters.{path[1]}", faults)
        if path[0] in ("factors", "uncertainty") and len(path) > 1 and isinstance(current, dict):
            tables[path[0]] = set_whole(current, path[1], value)
        elif path[0] in TABLES and len(path) > 1 and not any("." in part for part in path):
            tables = lay(tables, {".".join(path): value})
        else:
            declaration.set_value(tables, path, value)
    if faults:
        raise InputError(list(faults))
    return _joined(tables, source)


def _joined(tables: Tables, source: str) -> Tables:
    """Join the dotted keys that TOML nests: ``[factors]``, ``[uncertainty]``, ``when``."""
    try:
        for key in ("factors", "uncertainty"):
            table = tables.get(key)
            if isinstance(table, dict):
                tables[key] = declaration.flatten(table)
        excluded = tables.get("exclude")
        for row in excluded if isinstance(excluded, list) else ():
            if isinstance(row, dict) and isinstance(row.get("when"), dict):
                row["when"] = declaration.flatten(row["when"])
    except InputError as error:
        fault = error.faults[0]
        raise InputError(Fault(f"{source}: {fault.where}", fault.rule, fault.mend)) from error
    return tables


def _check_override(tables: Table, path: Sequence[str]) -> None:
    """Refuse an override that a factor's levels would hide again."""
    key, factors = ".".join(path), table_of(tables, "factors")
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
    excluding = "exclude" in tables or "constraint" in tables
    factors, scheme = scheme_from(file.design, factors, file.study.seed, excluding, faults)
    alone = stands_alone(tables)
    responses = responses_from(file.response, _declared(tables, presets), alone, faults)
    _check_parameters(file, tables, declared, presets, alone, faults)
    constraints = [
        noted(partial(checked, tables), row, f"constraint[{i}].rule", faults)
        for i, row in enumerate(file.constraint)
        if is_known(row.rule, row.why)
    ]
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
        identification=identification_from(tables),
        analysis=analysis_from(file.analysis, factors, declared, scheme, faults),
        scheme=scheme,
        replicates=file.replicates,
        retry=dict(file.execution.retry or ()),  # None where it is faulty
        expected=expected_from(file.expected, factors, responses, faults),
        converge=file.converge,
        uncertainty=uncertain,
        constraints=tuple(constraint for constraint in constraints if constraint is not None),
        inputs=inputs,
        virtual=file.virtual,
        report=file.report,
        source=source,
        text=text,
    )
    if factors:
        check_cells(design, presets, faults)
    return design


def _declared(tables: Table, presets: Presets) -> dict[str, str]:
    """Units of the values that the programs of a design leave."""
    written = [table_of(tables, "forward").get("values")]
    levels = (level for labels in presets.values() for level in labels.values())
    written += [level.get("forward.values") for level in levels]
    units: dict[str, str] = {}
    for value in written:
        if isinstance(value, Mapping):  # what is wrong with it is told where its cells are read
            units |= read_table(ValueFile, value, "forward.values", Faults()).units
    return units


def _check_parameters(
    file: DesignFile,
    tables: Table,
    declared: Sequence[str],
    presets: Presets,
    alone: bool,
    faults: Faults,
) -> None:
    """Check what is said of parameters: by factors, presets, a series, and seeds."""
    settings = [(key, f"factors.{key}") for key in declared if key not in presets]
    for name, labels in presets.items():
        for label, level in labels.items():
            settings += [(key, f"presets.{name}.{label}.{key}") for key in level]
    check_names(tables, settings, faults)
    converge, replicates = file.converge, file.replicates
    if converge.key is not None and not alone:
        rule = "refines a program of parameters alone; here the mesh of [model] is refined"
        faults.add("converge.key", rule, "leave it out")
    if converge.formal_order is not None and converge.key is None:
        faults.add("converge.formal_order", "is the order in converge.key, which is missing",
                   'write key = "parameters.h"')  # fmt: skip
    if replicates.key is not None and not alone:
        rule = "is the seed of a program of parameters alone; here write mesh_seeds or noise"
        faults.add("replicates.key", rule, "leave it out")


def _check_asked(tables: Table, faults: Faults) -> None:
    """Check that something is asked of a design; a mesh study without measurements need not."""
    studied = "converge" in tables and "measurements" not in tables
    if "response" not in tables and not studied:
        faults.add("response", "is missing", RESPONSES_MEND)
    replicates = table_of(tables, "replicates")
    if {"mesh_seeds", "noise"} <= set(replicates):
        rule = "mesh_seeds and noise are two error terms, with different questions"
        faults.add("replicates", rule, "give one of them, and the other in a study of its own")
    elif "n" in replicates and "key" not in replicates:
        faults.add("replicates.key", "is missing beside n", 'for example key = "parameters.seed"')
    elif tables.get("replicates") == {}:
        faults.add("replicates", "is empty", "write mesh_seeds = 5 or noise = 200")


def _problem(file: ProblemFile, tables: Tables, faults: Faults, *_: str) -> LoadedProblem:
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
    return LoadedProblem(problem, file.converge)


File = TypeVar("File")
Loaded = TypeVar("Loaded")


@dataclass(frozen=True)
class FileKind(Generic[File, Loaded]):
    """One kind of file: its tables, and what is made of them."""

    name: str
    section: type[File]
    #: From the tables read and as written, the faults so far, and the source and text of the file.
    make: Callable[[File, Tables, Faults, str, str], Loaded]

    def load(self, path: str | Path, overrides: Sequence[str] = ()) -> Loaded:
        """Load a file; an override is ``"key=value"``."""
        text = declaration.read_text(path, f"a {self.name}")
        return self.loads(text, str(path), overrides)

    def loads(
        self, raw: str | bytes, source: str = "<string>", overrides: Sequence[str] = ()
    ) -> Loaded:
        """Load a text, or the bytes of a file; see :meth:`load`."""
        text = declaration.decode(raw, source) if isinstance(raw, bytes) else raw
        tables = _tables(text, source, overrides)
        actual, faults = _kind(tables), Faults()
        # of a design that is begun all faults are listed; a whole problem is none
        is_whole = {"test", "material"} <= tables.keys() <= _SIMULATED
        declared = tables.pop("kind", None)
        begun = self.name == "design" and actual == "problem" and not is_whole and declared is None
        if actual != self.name and not begun:
            raise InputError(Fault(source, f"is a {actual}, not a {self.name}", _VERBS[actual]))
        if declared is not None and (looks := _shape(tables)) not in (actual, "problem"):
            rule = f"is {declared!r}, and the tables are those of a {looks}"
            raise InputError(Fault(f"{source}: kind", rule, _VERBS[looks]))
        file = read_table(self.section, tables, "", faults)
        # a text that says something else than what was loaded is no text of it
        value = self.make(file, tables, faults, source, "" if overrides else text)
        faults.refuse(source)
        return value


_DESIGN = FileKind("design", DesignFile, _design)
_PROBLEM = FileKind("problem", ProblemFile, _problem)
CALIBRATION = FileKind("calibration", CalibrationFile, resolve_calibration)

load, loads = _DESIGN.load, _DESIGN.loads
load_problem, loads_problem = _PROBLEM.load, _PROBLEM.loads
load_calibration = CALIBRATION.load


def template(name: str = "template") -> str:
    """Text of a commented, valid file to start from."""
    return (
        resources.files("study.harness.design").joinpath(f"{name}.toml").read_text(encoding="utf-8")
    )


# Where designs, measurements and results are found.

RESULTS = Path("results")
REPORTS = Path("reports")


def load_design(
    design: Design | Mapping[str, object] | str | Path, overrides: Sequence[str] = ()
) -> Design:
    """Load a design from its file, or make it of the tables that a file would have.

    Parameters
    ----------
    design : Design, mapping, str or Path
        A file; or its keys, with texts that have a unit or numbers in mm, N, MPa and deg.
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
    if isinstance(design, Design):
        return design
    if isinstance(design, Mapping):
        return loads(from_tables(design), "design", overrides)
    return load(design, overrides)


def demo_design(overrides: Sequence[str] = ()) -> Design:
    """Design of the embedded study."""
    text = resources.files("study.harness.runner").joinpath("demo.toml").read_text(encoding="utf-8")
    return loads(text, "demo.toml", overrides)


def loaded_problem(
    source: str | Path | Mapping[str, object], overrides: Sequence[str] = ()
) -> LoadedProblem:
    """Read a problem, from its file or from tables as a file has them, and find its surface."""
    if isinstance(source, Mapping):
        if "displacement_mm" in table_of(source, "test"):
            return LoadedProblem(CellProblem.of(source))
        loaded, path = loads_problem(from_tables(source), "problem", overrides), Path("problem")
    else:
        loaded, path = load_problem(source, overrides), Path(source)
    problem = located(loaded.problem, folders(path, data_root(path)))
    return replace(loaded, problem=problem)


def design_root(design: Design, data: str | Path | None = None) -> Path:
    """Folder that the measurement files of a design are relative to."""
    specs = [
        spec
        for cell in design.treatments
        for problem in (cell.cell.problem, cell.cell.fitted_elsewhere)
        if problem is not None and (spec := problem.measurements) is not None
    ]
    return data_root(design.source, data, {(s.file, s.files): s for s in specs}.values())


def calibration_root(
    config: CalibrationDesign, source: str | Path, data: str | Path | None = None
) -> Path:
    """Folder that the measurement files of a calibration are relative to."""
    return data_root(source, data, [test.measurements for test in config.tests])


def finished_manifest(store: Store) -> ManifestDocument:
    """Manifest of the run that is read from."""
    manifest = store.read_manifest()
    if manifest is None:
        raise InputError(f"{store.path}: its manifest is damaged; run the design again")
    return manifest


def results_folder(path: str | Path, results: str | Path = RESULTS) -> Path:
    """Results of a study, named by their folder, by its design file, or by the study's name."""
    given = Path(path)
    candidates = [given, Path(results) / given.name]
    if given.suffix == ".toml" and given.is_file():
        candidates = [Path(results) / load(given).name]
    for folder in candidates:
        if os.path.isfile(folder / "study.json"):  # of what may not be read nothing is known
            return folder
    looked = ", ".join(dict.fromkeys(map(str, candidates)))
    raise InputError(
        Fault(str(path), f"no results of a study there (looked in {looked})",
              "name a folder such as results/NAME, or run the design first")
    )  # fmt: skip
