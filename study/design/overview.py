"""What a design can and cannot tell, before anything runs: the data of ``study plan``."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Hashable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from study.arrays import Array
from study.design.cases import (
    calibration_key,
    case_id,
    excluded,
    physical_key,
    resolve_cell,
    treatments,
)
from study.design.diagnostics import Faults
from study.design.plausibility import plausibility
from study.design.spec import Design, Treatment

Groups = tuple[tuple[Treatment, ...], ...]
Key = Callable[[Treatment], Hashable]


def _grouped(cells: Sequence[Treatment], key: Key) -> Groups:
    groups: dict[Hashable, list[Treatment]] = {}
    for cell in cells:
        groups.setdefault(key(cell), []).append(cell)
    return tuple(tuple(group) for group in groups.values())


def equivalent_groups(design: Design) -> Groups:
    """Cells that must agree physically, grouped: one group is one distinct computation.

    In compression with both faces frictionless the deformation is the same everywhere, so
    that space, order, mesh and element shape cannot matter: those cells are controls.
    """
    return _grouped(treatments(design), physical_key)


def duplicates(design: Design) -> Groups:
    """Find groups of two or more cells with different labels and the same content."""
    groups = _grouped(treatments(design), lambda cell: case_id(cell.config))
    return tuple(group for group in groups if len(group) > 1)


def calibration_groups(design: Design) -> Groups:
    """Cells that share one calibration problem (one fit a block); none where nothing is fitted."""
    cells = [cell for cell in treatments(design) if calibration_key(cell) is not None]
    return _grouped(cells, calibration_key)


def calibration_factors(design: Design) -> tuple[str, ...]:
    """Names of the factors that enter the calibration problem of some cell."""
    cells = treatments(design)
    return tuple(
        f.name for f in design.factors if _separated(design, cells, f.name, calibration_key)
    )


def _others(cell: Treatment, factor: str) -> Hashable:
    return tuple(label for name, label in cell.levels.items() if name != factor)


def _slices(cells: Sequence[Treatment], factor: str) -> Groups:
    """Cells that differ in one factor only, together."""
    return _grouped(cells, lambda cell: _others(cell, factor))


def _separated(design: Design, cells: Sequence[Treatment], factor: str, key: Key) -> int:
    """Count the cells in which the factor changes the key."""
    if design.scheme.rows is not None:
        return sum(_changes(design, cell, factor, key) for cell in cells)
    slices = _slices(cells, factor)
    return sum(len(group) for group in slices if len({key(cell) for cell in group}) > 1)


def _changes(design: Design, cell: Treatment, factor: str, key: Key) -> bool:
    """Whether another level of one factor alone changes the key of a cell.

    A part of the full factorial may hold no two cells that differ in one factor only, so the
    other cell is made for the comparison.
    """
    own = key(cell)
    for other in next(f for f in design.factors if f.name == factor).labels:
        labels = {**cell.levels, factor: other}
        levels = [f.levels[f.labels.index(labels[f.name])] for f in design.factors]
        faults = Faults()
        made = Treatment(labels, resolve_cell(design, levels, faults))
        if not faults and key(made) != own:
            return True
    return False


def inert_cells(design: Design, factor: str) -> int:
    """Count the cells in which a factor cannot change a force: its controls."""
    cells = treatments(design)
    return len(cells) - _separated(design, cells, factor, physical_key)


def describe(design: Design) -> dict[str, Any]:
    """Describe a design in plain values: matrix, exclusions, groups, what each factor can tell.

    Returns
    -------
    dict
        ``study``, ``question``, ``cells``, ``distinct``, ``calibrations`` (numbers);
        ``factors``: ``name``, ``levels``, ``calibrates``, ``inert_cells``, ``note``;
        ``matrix``: ``label``, ``levels``, ``group``, ``calibration``, ``homogeneous`` of each
        cell; ``excluded``: ``label``, ``why``; ``duplicates``: lists of labels;
        ``replicates``: ``kind``, ``count``, ``sentence`` (None without any);
        ``scheme``: ``kind``, ``summary``, ``resolution``, ``defining_relation``, ``aliases``;
        ``warnings``: sentences.
    """
    cells, groups = treatments(design), equivalent_groups(design)
    fitted = calibration_groups(design)
    return {
        "study": design.name,
        "question": design.question,
        "cells": len(cells),
        "distinct": len(groups),
        "calibrations": len(fitted),
        "factors": [_factor(design, cells, i) for i in range(len(design.factors))],
        "matrix": _matrix(cells, groups, fitted),
        "excluded": [{"label": cell.label, "why": why} for cell, why in excluded(design)],
        "scheme": {
            "kind": design.scheme.kind,
            "summary": design.scheme.summary,
            "resolution": design.scheme.resolution,
            "defining_relation": design.scheme.defining_relation,
            "aliases": list(design.scheme.aliases),
        },
        "replicates": replication(design),
        "duplicates": [[cell.label for cell in group] for group in duplicates(design)],
        "warnings": list(warnings(design)),
    }


def replication(design: Design) -> dict[str, Any] | None:
    """Say what is computed several times, and which question that answers."""
    asked = design.replicates
    if asked.mesh_seeds:
        sentence = (
            f"every cell is solved on {asked.mesh_seeds} meshes of its size that differ by a seed: "
            "is an effect larger than the mesh noise at this size? (E3)"
        )
        return {"kind": "mesh-seeds", "count": asked.mesh_seeds, "sentence": sentence}
    if asked.noise:
        sentence = (
            f"every fit is made {asked.noise} times more, to its curve with resampled residuals: "
            "is an effect larger than the noise in the measured data alone would give? (E2)"
        )
        return {"kind": "noise", "count": asked.noise, "sentence": sentence}
    return None


def _factor(design: Design, cells: Sequence[Treatment], index: int) -> dict[str, Any]:
    factor = design.factors[index]
    calibrates = _separated(design, cells, factor.name, calibration_key) > 0
    inert = len(cells) - _separated(design, cells, factor.name, physical_key)
    return {
        "name": factor.name,
        "levels": list(factor.labels),
        "calibrates": calibrates,
        "inert_cells": inert,
        "note": _note(calibrates, inert, len(cells), design.calibration.method != "none"),
    }


def _note(calibrates: bool, inert: int, total: int, fitted: bool) -> str:
    if inert == total:
        return "cannot change any force: every cell is a control"
    parts = []
    if fitted:
        parts.append("enters the fit" if calibrates else "does not enter the fit")
    if inert:
        parts.append(f"cannot matter in {inert} of {total} cells, which are controls")
    return "; ".join(parts)


def _matrix(cells: Sequence[Treatment], groups: Groups, fitted: Groups) -> list[dict[str, Any]]:
    group = {cell.label: i for i, members in enumerate(groups, 1) for cell in members}
    fit = {cell.label: i for i, members in enumerate(fitted, 1) for cell in members}
    return [
        {
            "label": cell.label,
            "levels": dict(cell.levels),
            "group": group[cell.label],
            "calibration": fit.get(cell.label),
            "homogeneous": cell.cell.problem.is_homogeneous,
        }
        for cell in cells
    ]


def warnings(design: Design) -> tuple[str, ...]:
    """Sentences about what is allowed and probably not meant."""
    found: dict[str, None] = {}
    for cell in treatments(design):
        problem = cell.cell.problem
        found.update(dict.fromkeys(plausibility(problem.material)))
        spec = problem.measurements
        if spec is not None and spec.fit is not None and spec.fit == spec.score:
            found["cells are scored on the rows they were fitted to: fit, not prediction"] = None
    for group in duplicates(design):
        labels = " = ".join(cell.label for cell in group)
        found[f"cells with the same content are one computation, no replicates: {labels}"] = None
    unused = set(_preset_sets(design)) - {factor.name for factor in design.factors}
    for name in sorted(unused):
        found[f"the preset set {name!r} is no factor and is not used"] = None
    if design.converge.ratio < 1.3:
        found[f"converge.ratio {design.converge.ratio:g} is below 1.3: orders will be noise"] = None
    return tuple(found)


def _preset_sets(design: Design) -> Sequence[str]:
    presets = design.config.get("presets")
    return list(presets) if isinstance(presets, dict) else []


Word = tuple[int, ...]
ROMAN = ("", "I", "II", "III", "IV", "V", "VI", "VII", "VIII", "IX", "X", "XI", "XII")


@dataclass(frozen=True)
class Alias:
    """Two terms of order 1 or 2 that a design correlates.

    Parameters
    ----------
    term, other : tuple of int
        Columns of the factors in each.
    r : float
        Correlation of their columns; 1 or -1 where nothing tells them apart.
    """

    term: Word
    other: Word
    r: float


def defining_words(runs: Array) -> tuple[Word, ...]:
    """Products of columns that are constant over all runs, shortest first.

    Parameters
    ----------
    runs : ndarray, shape (runs, factors)
        -1 and 1.
    """
    return tuple(word for word in _words(runs.shape[1]) if abs(_column(runs, word).mean()) == 1)


def resolution(runs: Array) -> int | None:
    """Length of the shortest constant product; None where there is none (a full factorial).

    Examples
    --------
    >>> half = np.array([[-1, -1, 1], [-1, 1, -1], [1, -1, -1], [1, 1, 1]], dtype=float)
    >>> resolution(half)
    3
    """
    return next((len(w) for w in _words(runs.shape[1]) if abs(_column(runs, w).mean()) == 1), None)


def aliases(runs: Array) -> tuple[Alias, ...]:
    """Pairs of main effects and two-way interactions with correlated columns."""
    terms = [w for w in _words(runs.shape[1], 2) if len(w) <= 2]
    columns = np.array([_column(runs, word) for word in terms])
    products = columns @ columns.T / len(runs)
    return tuple(
        Alias(terms[i], terms[j], float(products[i, j]))
        for i, j in itertools.combinations(range(len(terms)), 2)
        if abs(products[i, j]) > 1e-12
    )


def _words(count: int, longest: int | None = None) -> Iterator[Word]:
    for length in range(1, (longest or count) + 1):
        yield from itertools.combinations(range(count), length)


def _column(runs: Array, word: Word) -> Array:
    return np.asarray(runs[:, list(word)].prod(axis=1), dtype=float)


def term_name(word: Word, names: Sequence[str]) -> str:
    """Name of a term as an analysis writes it: ``"A"`` or ``"A:B"``."""
    return ":".join(names[i] for i in word)


def defining_relation(runs: Array, names: Sequence[str]) -> str:
    """Write the defining relation, such as ``"I = A:B:C"``; empty for a full factorial."""
    words = defining_words(runs)
    if not words:
        return ""
    signs = ["" if _column(runs, word)[0] > 0 else "-" for word in words]
    return "I = " + " = ".join(s + term_name(w, names) for s, w in zip(signs, words, strict=True))


def sentences(runs: Array, names: Sequence[str]) -> list[str]:
    """Alias table in words: what cannot be told from what, main effects first."""
    partners: dict[Word, list[Alias]] = {}
    for alias in aliases(runs):
        partners.setdefault(alias.term, []).append(alias)
    told: set[Word] = set()
    out = []
    for term, found in partners.items():
        whole = [a for a in found if abs(abs(a.r) - 1) < 1e-12]
        if whole and term not in told:
            told.update(a.other for a in whole)
            others = " or ".join(_words_of(a.other, names) for a in whole)
            out.append(f"{_words_of(term, names)} cannot be told from {others}")
        if len(term) == 1 and len(whole) < len(found):
            part = [a for a in found if a not in whole]
            largest = max(abs(a.r) for a in part)
            out.append(
                f"{_words_of(term, names)} is mixed with a part (up to {largest:.3g}) of "
                f"{len(part)} interactions of two other factors"
            )
    return out


def _words_of(word: Word, names: Sequence[str]) -> str:
    if len(word) == 1:
        return f"the effect of {names[word[0]]}"
    return "the interaction of " + " and ".join(names[i] for i in word)


def clear_order(found: int | None) -> int | None:
    """Highest order of terms that are free of one another at a resolution; None for all.

    Examples
    --------
    >>> clear_order(3), clear_order(4), clear_order(5), clear_order(None)
    (1, 1, 2, None)
    """
    return None if found is None else max(1, (found - 1) // 2)
