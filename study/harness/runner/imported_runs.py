"""Runs that were made elsewhere become a study with records, for verbs that need no new run."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from study.external.forward_model import TAKEN, is_parameter
from study.ground.arrays import gathered
from study.ground.canonical import digest
from study.ground.errors import Fault, InputError, nearest
from study.ground.files import own_folder
from study.ground.tabular import TYPED_COMMA, CsvTable, label_fault, read_csv
from study.ground.units import agree, is_known, listed, unit_of_column
from study.harness.design.load import dump, from_tables, loads
from study.harness.design.spec import Design, cases, level_label
from study.harness.runner.batch import seeded
from study.record.record import MADE_ELSEWHERE, STATUSES, ManifestDocument, Record, are_imported
from study.record.store import Store
from study.simulation.cell import Case
from study.simulation.problem_file import TABLES, default_name
from study.simulation.provenance import versions
from study.statistics.surfaces.surface_factors import NumericFactor
from study.statistics.surfaces.surface_fitting import settings_run

#: cells of a column of failures that say that nothing failed
_GOOD = ("", "0", "0.0", "no", "false", "ok", "converged", "done", "none")
#: cells of a response that say that there is none
_MISSING = ("", "nan", "na", "n/a", "none", "null", "-")


def write_runs(
    path: str | Path,
    factors: str | Sequence[str],
    responses: str | Sequence[str],
    *,
    numeric: str | Sequence[str] = (),
    failed: str | None = None,
    block: str | None = None,
    name: str | None = None,
    decimal: str = ".",
    practical: str = "",
    results: str | Path,
) -> Path:
    """Write the records of a study of a table of runs, and give its folder."""
    columns, numeric_names = listed(factors), listed(numeric)
    units = _units(responses)
    needed = [*columns, *units, *(c for c in (failed, block) if c is not None)]
    table = read_csv(
        Path(path), required=needed, numbers=list(units), decimal=decimal, declared_by=TYPED_COMMA
    ).without_units(list(units))
    names = _plain_names(table, units, numeric_names)
    table, units = _with_plain_names(table, names, units)
    for column, plain in names.items():
        numeric_names = [
            plain + item.removeprefix(column) if item.startswith(column) else item
            for item in numeric_names
        ]
    ranges = [settings_run(item, table) for item in numeric_names]
    _check(table, columns, units, ranges)
    rows = _rows(table, columns, units, failed, block, ranges)
    sizes = {names.get(name, name): size for name, size in _units(practical).items()}
    if unknown := [k for k in sizes if k not in units]:
        rule = f"{unknown[0]!r} is no response"
        raise InputError(Fault("--practical", rule, nearest(unknown[0], units)))
    name = name or default_name(str(path))
    design = _design(name, columns, ranges, units, sizes, rows, Path(path).name)
    blocks = tuple(dict.fromkeys(row.block for row in rows if row.block is not None))
    records = _records(design, blocks, rows, units, table.sha256)
    store = Store(own_folder(Path(results), design.name))
    with store.lock():
        present = store.read_manifest()
        if present is not None and not are_imported(present["notes"]):
            rule = f"{present['name']!r} is a study that was computed here"
            mend = "give the imported one a name of its own: --name"
            raise InputError(Fault(str(path), rule, mend))
        manifest: ManifestDocument = {
            "name": design.name,
            "design": dump(design),
            "text": dump(design),
            "source": Path(path).name,
            "cases": {record.case_id: record.input_hash for record in records},
            "blocks": list(blocks),
            "unit": block or "",
            "notes": [f"{len(rows)} runs were {MADE_ELSEWHERE} and read from {Path(path).name}"],
            "files": {Path(path).name: table.sha256},
            "virtual": False,
            "truths": {},
            "versions": versions(),
            "timings": {},
        }
        store.begin_run(manifest)
        for record in records:
            store.write(record, followed=record is not records[-1])
        store.finish_run(manifest)
    return store.path


def _units(responses: str | Sequence[str]) -> dict[str, str]:
    """Read the names of responses, each with its unit, which may be left out."""
    pairs = (pair.partition("=") for pair in listed(responses))
    return {name.strip(): unit.strip() for name, _, unit in pairs}


def _plain_names(
    table: CsvTable, units: Mapping[str, str], numeric: Sequence[str]
) -> dict[str, str]:
    """Names in the study of columns that end in a unit in brackets: ``peak`` of ``peak (N)``.

    A factor keeps its unit, ``tip_mm`` of ``tip (mm)``. A name that another column has stays.
    """
    names: dict[str, str] = {}
    for column in table.columns:
        unit = unit_of_column(column)
        if not is_known(unit):
            continue
        title = column.rpartition(unit)[0][:-1] if column in units else column
        plain = re.sub(r"[^\w-]+", "_", title).strip("_")
        is_used = column in units or any(item.startswith(column) for item in numeric)
        if is_used and plain not in (*table.columns, *names.values()):
            names[column] = plain
    return names


def _with_plain_names(
    table: CsvTable, names: Mapping[str, str], units: Mapping[str, str]
) -> tuple[CsvTable, dict[str, str]]:
    """Table with other names of columns, and the units of the responses, of their names too."""
    in_names = {name: unit_of_column(name) for name in names if name in units}
    known_units = {**in_names, **table.units}
    renamed = replace(
        table,
        columns={names.get(name, name): cells for name, cells in table.columns.items()},
        padded={names.get(name, name): cells for name, cells in table.padded.items()},
        units={names.get(name, name): unit for name, unit in known_units.items()},
    )
    return renamed, {names.get(n, n): unit or in_names.get(n, "") for n, unit in units.items()}


def _check(
    table: CsvTable,
    columns: Sequence[str],
    units: Mapping[str, str],
    ranges: Sequence[NumericFactor],
) -> None:
    faults = [
        Fault(
            f"{table.source}: column {name!r}",
            f"the table says {shown}, but {units[name]} is declared",
            f"write {name}={shown}",
        )
        for name, shown in table.units.items()
        if units[name] and not agree(shown, units[name])
    ]
    for factor in ranges:
        if factor.name in (*columns, *units):
            rule = f"{factor.name!r} stands in --numeric and among the factors or responses too"
            mend = (
                f"a factor over its range stands in --numeric alone: leave {factor.name} out there"
            )
            faults.append(Fault(table.source, rule, mend))
        elif not is_parameter(_key(factor)):
            rule = f"{factor.name!r} cannot be the name of a numeric factor"
            mend = "rename the column: letters, digits, - and _ alone, such as mesh_size"
            faults.append(Fault(table.source, rule, mend))
    for name in units:
        if not re.fullmatch(r"[^\W\d][\w-]*", name) or name in TAKEN:
            rule = f"{name!r} is no name of a response"
            mend = "rename the column: letters, digits, - and _ alone, such as peak_force"
            faults.append(Fault(table.source, rule, mend))
    for name in columns:
        if "." in name or name in units or name in TAKEN:
            rule = f"{name!r} cannot be a factor beside the others"
            faults.append(Fault(table.source, rule, "rename the column, without a dot"))
        faults += [
            Fault(table.cell_name(k, name), label_fault(cell) or "is empty", "name the level")
            for k, cell in enumerate(table.text(name))
            if not cell or label_fault(cell)
        ][:20]
    if not (columns or ranges) or not units:
        faults.append(
            Fault(table.source, "needs a factor and a response", "--factors, --responses")
        )
    if faults:
        raise InputError(faults)


@dataclass(frozen=True)
class _Run:
    """One row: its levels, block, values, and why it has no answer."""

    levels: dict[str, str]
    block: str | None
    values: dict[str, float]
    status: str = "converged"
    message: str = ""


def _rows(
    table: CsvTable,
    columns: Sequence[str],
    units: Mapping[str, str],
    failed: str | None,
    block: str | None,
    ranges: Sequence[NumericFactor],
) -> list[_Run]:
    rows = []
    settings = {_key(factor): table.numbers(factor.name).tolist() for factor in ranges}
    answers = {name: table.numbers(name, _MISSING).tolist() for name in units}
    for k in range(len(table.lines)):
        levels = {_factor(name): _label(table.text(name)[k]) for name in columns}
        levels |= {key: level_label(values[k]) for key, values in settings.items()}
        values = {name: v[k] for name, v in answers.items() if not math.isnan(v[k])}
        run = _Run(levels, None if block is None else table.text(block)[k], values)
        word = "" if failed is None else table.text(failed)[k]
        if word.lower() not in _GOOD:
            status = word.lower() if word.lower() in STATUSES else "failed"
            run = replace(run, status=status, message=f"as the column {failed} says: {word}")
        elif missing := [name for name in units if name not in values]:
            message = f"the table has no value of {missing[0]}"
            run = replace(run, status="failed", message=message)
        rows.append(run)
    return rows


def _key(factor: NumericFactor) -> str:
    """Key of a numeric factor, which is also its name in the study."""
    return f"parameters.{factor.name}"


def _factor(column: str) -> str:
    """Name of a factor; a table of the file keeps its own."""
    return f"{column}_" if column in TABLES else column


def _label(cell: str) -> str:
    """Label of a level: numbers that are equal are one level."""
    try:
        return level_label(float(cell))
    except ValueError:
        return level_label(cell)


def _design(
    name: str,
    columns: Sequence[str],
    ranges: Sequence[NumericFactor],
    units: Mapping[str, str],
    practical: Mapping[str, str],
    rows: Sequence[_Run],
    source: str,
) -> Design:
    """Design whose cells are those of some runs."""
    labels = {c: list(dict.fromkeys(row.levels[c] for row in rows)) for c in map(_factor, columns)}
    few = [column for column, levels in labels.items() if len(levels) < 2]
    if few:
        mend = "leave it out: a factor has two levels or more"
        raise InputError(Fault(source, f"{few[0]} is the same in all runs", mend))
    presets: dict[str, object] = {}
    parameters: dict[str, object] = {}
    for index, (column, levels) in enumerate(labels.items()):
        key, numbers = f"factor_{index + 1}", _numbers(levels)
        if numbers:  # numbers stay numbers, in their order
            levels.sort(key=numbers.__getitem__)
        presets[column] = {
            level: {f"parameters.{key}": numbers.get(level, f"level {level}")} for level in levels
        }
        parameters[key] = min(numbers.values()) if numbers else ""
    parameters |= {factor.name: factor.low for factor in ranges}
    spans = {
        _key(factor): {"low": factor.low, "high": factor.high,
                       "scale": "log" if factor.log else "linear"}
        for factor in ranges
    }  # fmt: skip
    cells = [
        {name: float(label) if name in spans else label for name, label in levels}
        for levels in dict.fromkeys(tuple(row.levels.items()) for row in rows)
    ]
    tables: dict[str, object] = {
        "study": {"name": name, "question": f"Runs that were made elsewhere: {source}"},
        "parameters": parameters,
        "forward": {"model": "python"},
        "presets": presets,
        "factors": labels | spans,
        "response": [
            {"name": n, "unit": unit} | ({"practical": practical[n]} if practical.get(n) else {})
            for n, unit in units.items()
        ],
    }
    if spans or 1 < len(cells) < math.prod(map(len, labels.values())):
        tables["design"] = {"kind": "listed", "treatments": cells}
    most = max(Counter(map(_cell, rows)).values())
    if most > 1:
        parameters["replicate_number"] = 1
        tables["replicates"] = {"key": "parameters.replicate_number", "n": most}
    return loads(from_tables(tables), source)


def _numbers(levels: Sequence[str]) -> dict[str, float]:
    """Numbers of the levels of a factor; empty where one of them is none."""
    try:
        numbers = {level: float(level) for level in levels}
    except ValueError:
        return {}
    return numbers if all(map(math.isfinite, numbers.values())) else {}


def _cell(run: _Run | Case) -> tuple[tuple[tuple[str, str], ...], str | None]:
    """Levels and block: the order of the factors is no part of a cell."""
    return tuple(sorted(run.levels.items())), run.block


def _records(
    design: Design,
    blocks: Sequence[str],
    rows: Sequence[_Run],
    units: Mapping[str, str],
    sha256: str,
) -> list[Record]:
    every_case = seeded(cases(design, blocks), design)
    places = gathered((_cell(case), (case, origin)) for case, origin in every_case)
    return [
        Record(
            case.case_id, design.name, dict(case.levels), case.block, row.status, row.message,
            {name: {"value": row.values.get(name) if row.status == "converged" else None,
                    "unit": unit} for name, unit in units.items()},
            versions=versions(),
            input_hash=digest([case.case_id, sha256, row.values, row.status]),
            extra=origin.to_json(),
        )
        for cell, runs in gathered((_cell(row), row) for row in rows).items()
        for row, (case, origin) in zip(runs, places.get(cell, ()), strict=False)
    ]  # fmt: skip
