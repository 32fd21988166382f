"""Read a file for ``study require``: a problem with its constants, two sensors, what is asked."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from study.design import toml_document
from study.design.diagnostics import Faults, read_table
from study.design.load import default_name, loads_problem
from study.design.study_file import Study
from study.errors import Fault, InputError
from study.sensors.section import ForceAccuracy, PositionAccuracy, Requirement
from study.setup.setup import Tables

#: Tables that only this verb knows.
OWN = ("position", "force", "requirement", "predict")
#: Tables of the problem that the prediction may replace.
REPLACEABLE = ("specimen", "test", "model")
_SHARED = ("specimen", "test", "material", "model")


@dataclass(frozen=True)
class RequirementFile:
    """What a file for ``study require`` says.

    Parameters
    ----------
    name, question : str
        Of the study.
    seed : int
        Of the Monte Carlo simulations.
    fitted, predicted : mapping
        Resolved tables of the test that gives the constants, and of the one whose force counts.
    position, force : PositionAccuracy, ForceAccuracy
        The sensors.
    asked : Requirement
        Wanted accuracy, and how it is checked.
    """

    name: str
    question: str
    seed: int
    fitted: Tables
    predicted: Tables
    position: PositionAccuracy
    force: ForceAccuracy
    asked: Requirement


def load_requirement(path: str | Path, overrides: Sequence[str] = ()) -> RequirementFile:
    """Load a file for ``study require``.

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
    source = str(path)
    tables = toml_document.parse_toml(toml_document.read_text(path), source)
    rest = []
    for override in overrides:
        keys, value = toml_document.parse_override(override)
        if keys[0] in (*OWN, "study"):
            toml_document.set_value(tables, keys, value)
        else:
            rest.append(override)
    faults = Faults()
    own = {name: tables.pop(name, {}) for name in OWN}
    position = read_table(PositionAccuracy, own["position"], "position", faults)
    force = read_table(ForceAccuracy, own["force"], "force", faults)
    asked = read_table(Requirement, own["requirement"], "requirement", faults)
    if not faults and not _has_errors(position, force):
        mend = 'give one, for example [position] noise = "0.1 mm"'
        faults.add("position, force", "neither sensor has an error: nothing to propagate", mend)
    found = [Fault(f"{source}: {f.where}", f.rule, f.mend) for f in faults]
    fitted = _problem(tables, source, rest, found)
    predicted = _predicted(tables, own["predict"], source, rest, found) if fitted else None
    if found or fitted is None or predicted is None:
        raise InputError(dict.fromkeys(found))
    study = read_table(Study, tables.get("study", {}), "study", Faults())
    name = study.name or default_name(source)
    return RequirementFile(
        name, study.question, study.seed, fitted, predicted, position, force, asked
    )


def _has_errors(position: PositionAccuracy, force: ForceAccuracy) -> bool:
    errors = (position.offset_mm, position.scale, position.noise_mm)
    return any((*errors, force.zero_N, force.scale, force.noise_N))


def _problem(
    tables: Mapping[str, object], source: str, overrides: Sequence[str], faults: list[Fault]
) -> Tables | None:
    """Resolve a problem; None, and its faults, where it has any."""
    try:
        config = loads_problem(toml_document.dump_toml(tables), source, overrides)
    except InputError as error:
        faults += error.faults
        return None
    return {name: config[name] for name in _SHARED}


def _predicted(
    tables: Mapping[str, object],
    table: object,
    source: str,
    overrides: Sequence[str],
    faults: list[Fault],
) -> Tables | None:
    """Problem with the tables that ``[predict]`` replaces whole."""
    if not isinstance(table, Mapping):
        faults.append(Fault(f"{source}: predict", "must be a table", "write [predict.test]"))
        return None
    for key in table:
        if key not in REPLACEABLE:
            mend = f"one of {', '.join(REPLACEABLE)}; the material is the fitted one"
            faults.append(Fault(f"{source}: predict.{key}", "unknown key", mend))
    kept = [one for one in overrides if one.split("=")[0].split(".")[0].strip() not in table]
    before = len(faults)
    found = _problem({**tables, **table}, source, kept, faults)
    for k in range(before, len(faults)):
        one = faults[k]
        faults[k] = Fault(one.where.replace(": ", ": predict.", 1), one.rule, one.mend)
    return found
