"""Design -> cells -> cases: combinations of levels, configurations, names made of content."""

from __future__ import annotations

import hashlib
import itertools
import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import is_dataclass
from typing import Any

from study.design import overlay, plausibility
from study.design.diagnostics import Faults
from study.design.resolve import resolve
from study.design.spec import Case, Config, Design, Level, Treatment
from study.errors import Fault, InputError
from study.measurement.section import MeasurementSpec

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


def resolve_cell(design: Design, levels: Sequence[Level], faults: Faults) -> Config:
    """Resolve the configuration of one cell; faults name the keys of the merged file."""
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


def excluded(design: Design) -> tuple[tuple[Treatment, str], ...]:
    """Cells left out and why; their configuration is not resolved, for it may be impossible."""
    return tuple(
        (Treatment(labels, {}), why)
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
        Case(cell.levels, block, cell.config, case_id({**cell.config, "block": block}))
        for cell in cells
        for block in (blocks or (None,))
    )


def calibration_config(treatment: Treatment) -> Config | None:
    """Resolve the problem whose measured curve gives the constants; None if there is none.

    Returns
    -------
    dict
        ``specimen``, ``test``, ``material``, ``model`` and ``measurements``.
    """
    config = treatment.config
    if config["calibration"]["method"] == "none":
        return None
    problem: Config = config["calibration"]["problem"] or config
    return {k: problem[k] for k in ("specimen", "test", "material", "model", "measurements")}


def calibration_key(treatment: Treatment) -> str | None:
    """Name of the calibration problem of a cell: cells with one name share one fit a block."""
    config = calibration_config(treatment)
    if config is None:
        return None
    method = treatment.config["calibration"]["method"]
    return case_id({**physical(config), "method": _method(method, config)})


def physical(config: Mapping[str, Any]) -> Config:
    """Part of a problem that can change its curve.

    In homogeneous compression the closed form is exact: of the specimen its area and
    height count, and nothing of the discretisation.
    """
    kept = {k: config[k] for k in ("specimen", "test", "material", "model", "measurements")}
    if not plausibility.is_homogeneous(config):
        return kept
    specimen = config["specimen"]
    radius = specimen.get("radius_mm")
    sides = specimen.get("width_mm"), specimen.get("depth_mm")
    area = math.pi * radius**2 if radius is not None else sides[0] * sides[1]
    test = {k: v for k, v in config["test"].items() if k != "steps"}
    reduced = {"area_mm2": float(f"{area:.12g}"), "height_mm": specimen["height_mm"]}
    return {**kept, "specimen": reduced, "test": test, "model": None}


def _method(method: str, fitted: Mapping[str, Any]) -> str:
    return "exact" if method != "none" and plausibility.is_homogeneous(fitted) else method


def physical_key(treatment: Treatment) -> str:
    """Name of what a cell computes: cells with one name must agree physically."""
    config = treatment.config
    calibration = config["calibration"]
    fitted = calibration["problem"] or config
    return case_id(
        {
            **physical(config),
            "calibration": {
                "method": _method(calibration["method"], fitted),
                "problem": calibration["problem"] and physical(calibration["problem"]),
                "leave_out": calibration["leave_out"],
            },
        }
    )


def case_id(content: Any) -> str:
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


def canonical_json(content: Any) -> str:
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


def without_places(value: Any) -> Any:
    """Content without ``path``: where a file lies on this machine names nothing."""
    if isinstance(value, dict):
        return {k: without_places(v) for k, v in value.items() if k != "path"}
    return [without_places(v) for v in value] if isinstance(value, list) else value


def plain(value: Any) -> Any:
    """Plain JSON values of a configuration, numbers coerced.

    Raises
    ------
    InputError
        For nan, infinity or an unknown type.
    """
    if isinstance(value, MeasurementSpec):
        return plain({k: v for k, v in value.as_dict().items() if k != "citation"})
    if is_dataclass(value) and not isinstance(value, type):
        return plain(vars(value))
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(v) for v in value]
    if hasattr(value, "tolist"):
        return plain(value.tolist())
    if value is None or isinstance(value, (str, bool, int)):
        return value
    if isinstance(value, float) and math.isfinite(value):
        return int(value) if value.is_integer() and abs(value) < 2**53 else value
    raise InputError(Fault("case", f"cannot name the content {value!r}"))
