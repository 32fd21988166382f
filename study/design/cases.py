"""Design -> cells -> cases: combinations of levels, configurations, names made of content."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import overload

import numpy as np

from study.canonical import Json
from study.design import overlay
from study.design.diagnostics import Faults
from study.design.resolve import resolve
from study.design.sections.cell import Cell, CellProblem, Config
from study.design.spec import Case, Combination, Design, Level, Treatment
from study.errors import Fault, InputError
from study.measurement.section import MeasurementSpec
from study.setup.geometry import Surface

MAX_CASES = 100_000
ID_LENGTH = 16


def combinations(design: Design) -> Iterator[tuple[dict[str, str], tuple[Level, ...]]]:
    """Labels by factor, and the levels, of every cell; the last factor varies fastest."""
    names = [factor.name for factor in design.factors]
    for row in design.scheme.rows or itertools.product(
        *(range(len(factor.levels)) for factor in design.factors)
    ):
        levels = tuple(f.levels[i] for f, i in zip(design.factors, row, strict=True))
        yield {n: level.label for n, level in zip(names, levels, strict=True)}, levels


def _why_excluded(design: Design, labels: Mapping[str, str]) -> str | None:
    return next((e.why for e in design.exclusions if e.matches(labels)), None)


def resolve_cell(design: Design, levels: Sequence[Level], faults: Faults) -> Cell:
    """Resolve one cell; faults name the keys of the merged file."""
    settings = {k: v for level in levels for k, v in level.settings.items()}
    tables = {k: v for k, v in design.config.items() if k in overlay.TABLES}
    return resolve(overlay.lay(tables, settings), faults, design.converge.ratio)


def treatments(design: Design) -> tuple[Treatment, ...]:
    """Cells of the design without those left out.

    Raises
    ------
    InputError
        If a cell is impossible, which :func:`study.design.load` has checked.
    """
    cells, faults = [], Faults()
    for labels, levels in combinations(design):
        if _why_excluded(design, labels) is None:
            cells.append(Treatment(labels, resolve_cell(design, levels, faults)))
    if faults:
        raise InputError(faults)
    return tuple(cells)


def excluded(design: Design) -> tuple[tuple[Combination, str], ...]:
    """Cells left out and why; they are not resolved, for they may be impossible."""
    return tuple(
        (Combination(labels), why)
        for labels, _ in combinations(design)
        if (why := _why_excluded(design, labels)) is not None
    )


def cases(design: Design, blocks: Sequence[str] = ()) -> tuple[Case, ...]:
    """Every cell in every block; one case a cell where there are no blocks.

    Parameters
    ----------
    design : Design
        The study.
    blocks : sequence of str
        Labels of the blocks, as the measurements have them.

    Raises
    ------
    InputError
        If a block stands twice, or there are too many cases.
    """
    if len(set(blocks)) < len(blocks):
        raise InputError(Fault("measurements.block", f"labels must be distinct, got {blocks}"))
    cells = treatments(design)
    if len(cells) * max(1, len(blocks)) > MAX_CASES:
        rule = f"{len(cells)} cells in {len(blocks)} blocks are more than {MAX_CASES} cases"
        raise InputError(Fault("factors", rule, "use fewer levels, or several studies"))
    return tuple(
        Case(cell, block, cell.config, case_id({**cell.config, "block": block}))
        for cell in cells
        for block in (blocks or (None,))
    )


def calibration_config(treatment: Treatment) -> Config | None:
    """Document of the problem whose measured curve gives the constants; None if there is none."""
    cell = treatment.cell
    return cell.fitted.document() if cell.is_calibrated else None


def calibration_key(treatment: Treatment) -> str | None:
    """Name of the calibration problem of a cell: cells with one name share one fit a block."""
    cell = treatment.cell
    if not cell.is_calibrated:
        return None
    return case_id({**physical(cell.fitted), "method": _method(cell)})


def physical(problem: CellProblem) -> Config:
    """Part of a problem that can change its curve.

    In homogeneous compression the closed form is exact: of the specimen its area and
    height count, and nothing of the discretisation.
    """
    kept, specimen = problem.document(), problem.specimen
    if isinstance(specimen, Surface) or not problem.is_homogeneous:
        return kept
    test = {k: v for k, v in kept["test"].items() if k != "steps"}
    area = float(f"{specimen.area_mm2:.12g}")
    reduced = {"area_mm2": area, "height_mm": specimen.height_mm}
    return {**kept, "specimen": reduced, "test": test, "model": None}


def _method(cell: Cell) -> str:
    return "exact" if cell.is_calibrated and cell.fitted.is_homogeneous else cell.method


def physical_key(treatment: Treatment) -> str:
    """Name of what a cell computes: cells with one name must agree physically."""
    cell, other = treatment.cell, treatment.cell.fitted_elsewhere
    calibration = {
        "method": _method(cell),
        "problem": None if other is None else physical(other),
        "leave_out": cell.leave_out,
    }
    return case_id({**physical(cell.problem), "calibration": calibration})


def case_id(content: object) -> str:
    """Name made of content: 16 hex digits of the sha256 of canonical JSON.

    Numbers are coerced first (``1`` and ``1.0`` are one), keys sorted. Labels, names and
    citations are no content.

    Examples
    --------
    >>> case_id({"a": 1, "b": 2.5}) == case_id({"b": 2.5, "a": 1.0})
    True
    """
    text = canonical_json(content)
    return hashlib.sha256(text.encode()).hexdigest()[:ID_LENGTH]


def canonical_json(content: object) -> str:
    """One spelling of JSON for equal content.

    Raises
    ------
    InputError
        For what has no such spelling: nan, infinity, an unknown type.

    Examples
    --------
    >>> canonical_json({"b": (1.0, 2), "a": None})
    '{"a":null,"b":[1,2]}'
    """
    named = without_places(plain(content))
    return json.dumps(named, sort_keys=True, allow_nan=False, separators=(",", ":"))


def without_places(value: Json) -> Json:
    """Content without ``path``: where a file lies on this machine names nothing."""
    if isinstance(value, dict):
        return {k: without_places(v) for k, v in value.items() if k != "path"}
    return [without_places(v) for v in value] if isinstance(value, list) else value


@overload
def plain(value: Mapping[str, object]) -> dict[str, Json]: ...


@overload
def plain(value: object) -> Json: ...


def plain(value: object) -> Json:
    """Plain JSON values of a configuration, numbers coerced.

    Raises
    ------
    InputError
        For nan, infinity or an unknown type.
    """
    return _plain(value)


def _plain(value: object) -> Json:
    if isinstance(value, MeasurementSpec):
        return _plain({k: v for k, v in value.as_dict().items() if k != "citation"})
    if is_dataclass(value) and not isinstance(value, type):
        return _plain(vars(value))
    if isinstance(value, Mapping):
        return {str(k): _plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(v) for v in value]
    if isinstance(value, (np.ndarray, np.generic)):
        return _plain(value.tolist())
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value.is_integer() and abs(value) < 2**53 else value
    raise InputError(Fault("case", f"cannot name the content {value!r}"))
